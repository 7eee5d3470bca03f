"""State estimates of a log by an observer and its smoother, with consistency tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from undertow.errors import UndertowError
from undertow.model.symbols import MOTION_UNITS
from undertow.model.vehicle import Vehicle
from undertow.observer.consistency import Normalised, Whiteness, nis, whiteness
from undertow.observer.design import SCHEMA
from undertow.observer.filters import SEARCH, Estimate, Method, Observer, Reports, most_likely, smoothed
from undertow.observer.nees import Nees, Truth, nees
from undertow.observer.process import BIASES, CURRENT, UNKNOWN, Kind, Process, longest_step, process_of
from undertow.typing import Array, Flags, Index, Progress

from .estimation.inputs import without_gaps
from .estimation.threads import one_thread
from .logs.run import Run, report_noise
from .reference import truth_at

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class ObserveSettings:
    """Settings for observing a log."""

    # Random walk of a parameter, standard deviation in an hour: tides turn currents, heat moves biases.
    current_walk: float = 0.2  # m/s
    bias_walk: float = 0.02  # m/s, rad/s
    # First guess of the noise on an acceleration, m/s^1.5, or on its rate, m/s^2.5; also rad.
    first_model: float = 0.02
    first_kinematics: float = 0.1
    # Least noise of a report, as a share of the channel's spread: a log without noise has a solution, too.
    least: float = 1e-5
    same_time: float = 1e-9  # s by which times may differ that are one
    fewest: int = 10  # reports of all channels
    # Share of the reports of a channel that is rejected by a filter which has lost its track: the gate of an
    # honest one rejects one in a million, and outliers are rarer than this.
    lost: float = 0.1
    hour: float = 3600.0
    averaged_reports: int = 50  # normalised squared innovations of which the picture shows the mean


SETTINGS = ObserveSettings()


@dataclass(frozen=True)
class Observed:
    """A log with its estimated states."""

    run: Run  # pose, velocities and commands at the rows of the log, in order to be read by every command
    process: Kind  # "model" or "kinematics"
    estimate: Estimate  # smoothed states at the rows of the filter
    filtered: Estimate  # the same given the past alone, with the innovations
    noise: dict[str, float]  # standard deviation of a report by channel
    # root of the spectral density of the noise on the rate of each driven state, unit of the rate times s^0.5
    disturbance: dict[str, float]
    # nis, white: tests of the innovations
    nis: tuple[Normalised, ...]
    white: tuple[Whiteness, ...]
    # smoothed value at the end of each estimated parameter, and its standard deviation
    parameters: dict[str, tuple[float, float]]
    rejected: dict[str, int]  # reports beyond the gate by channel
    truth: Truth | None = None  # true states at the rows of the filter, of a reference

    @property
    def consistent(self) -> bool:
        """Whether innovations are consistent with the filter, white, and from nearly all reports."""
        return self.nis[-1].consistent and all(one.white for one in self.white) and not self.lost

    @cached_property
    def nees(self) -> tuple[Nees, ...]:
        """Test of the errors of the filter by group of states; empty without true states."""
        return nees([(self.filtered, self.truth)]) if self.truth else ()

    @property
    def lost(self) -> dict[str, int]:
        """Reports beyond the gate of channels of which it rejects many."""
        return _often_rejected(self.nis, self.rejected)

    def content(self) -> dict[str, object]:
        """The numbers, for JSON."""
        return {
            "process": self.process,
            "rows": len(self.run.t),
            "noise": self.noise,
            "disturbance": self.disturbance,
            "parameters": {n: {"value": v, "sigma": s} for n, (v, s) in self.parameters.items()},
            **_tests(self.nis, self.white, self.nees),
            "rejected": self.rejected,
        }


@dataclass(frozen=True)
class ObservedLogs:
    """Several logs with their estimated states, and the tests over all of them.

    Attributes
    ----------
    each : tuple of Observed
        By log.
    nis, white : tuple
        Tests of the innovations of all logs together.
    """

    each: tuple[Observed, ...]
    nis: tuple[Normalised, ...]
    white: tuple[Whiteness, ...]

    @cached_property
    def nees(self) -> tuple[Nees, ...]:
        """Test of the errors of the filter by group of states, over all logs with true states."""
        return nees([(one.filtered, one.truth) for one in self.each if one.truth])

    @property
    def process(self) -> Kind:
        """ "model" or "kinematics"."""
        return self.each[0].process

    @property
    def consistent(self) -> bool:
        """The same of all logs together."""
        return self.nis[-1].consistent and all(one.white for one in self.white) and not self.lost

    @property
    def noise(self) -> dict[str, float]:
        """Root mean square over the logs of the standard deviation of a report, by channel."""
        return _root_mean_squares([one.noise for one in self.each])

    @property
    def disturbance(self) -> dict[str, float]:
        """The same of the noise on rates."""
        return _root_mean_squares([one.disturbance for one in self.each])

    @property
    def rejected(self) -> dict[str, int]:
        """Reports beyond the gate by channel, of all logs."""
        names = dict.fromkeys(n for one in self.each for n in one.rejected)
        return {n: sum(one.rejected.get(n, 0) for one in self.each) for n in names}

    @property
    def lost(self) -> dict[str, int]:
        """Reports beyond the gate of channels of which it rejects many."""
        return _often_rejected(self.nis, self.rejected)

    def content(self) -> dict[str, object]:
        """The numbers, for JSON: those of the log where it is one, else by log and over all."""
        if len(self.each) == 1:
            return self.each[0].content()
        return {
            "process": self.process,
            "logs": {one.run.name: one.content() for one in self.each},
            "noise": self.noise,
            "disturbance": self.disturbance,
            **_tests(self.nis, self.white, self.nees),
            "rejected": self.rejected,
        }


def _root_mean_squares(each: Sequence[Mapping[str, float]]) -> dict[str, float]:
    names = dict.fromkeys(n for one in each for n in one)
    return {n: float(np.sqrt(np.mean([one[n] ** 2 for one in each if n in one]))) for n in names}


def _often_rejected(nis: Sequence[Normalised], rejected: Mapping[str, int]) -> dict[str, int]:
    used = {one.name: one.count for one in nis}
    return {n: k for n, k in rejected.items() if k > SETTINGS.lost * (k + used.get(n, 0))}


def _tests(nis: Sequence[Normalised], white: Sequence[Whiteness], nees: Sequence[Nees]) -> dict[str, object]:
    found: dict[str, object] = {
        "nis": [vars(one) | {"honest": one.consistent} for one in nis],
        "whiteness": [vars(one) | {"white": one.white} for one in white],
    }
    return found | ({"nees": [vars(one) | {"honest": one.consistent} for one in nees]} if nees else {})


def observe_logs(
    vehicle: Vehicle,
    runs: Sequence[Run],
    *,
    process: Kind = "kinematics",
    estimated: Sequence[str] = (),
    method: Method | None = None,
    references: Sequence[Sequence[Run]] = (),
    progress: Progress = lambda done, words: None,
) -> ObservedLogs:
    """`observe` for each of several logs, with NIS, NEES and whiteness over all of them.

    Noise, the disturbance and estimated parameters are those of each log. `references` are the segments of
    the logs of true states, by run.
    """
    found = []
    for k, run in enumerate(runs):

        def part(done: float, words: str, k: int = k, name: str = run.name) -> None:
            progress((k + done) / len(runs), f"{name}: {words}" if len(runs) > 1 else words)

        one = observe(vehicle, run, process=process, estimated=estimated, method=method, progress=part)
        true = truth_at(one.filtered, run, references[k]) if references else None
        found.append(replace(one, truth=true))
    channels = process_of(vehicle, estimated, process).channels
    filtered = [one.filtered for one in found]
    return ObservedLogs(tuple(found), nis(filtered, channels), whiteness(filtered, channels))


@one_thread()
def observe(
    vehicle: Vehicle,
    run: Run,
    *,
    process: Kind = "kinematics",
    estimated: Sequence[str] = (),
    method: Method | None = None,
    disturbance: Mapping[str, float] | None = None,
    progress: Progress = lambda done, words: None,
) -> Observed:
    """Estimate pose and velocity from the reports that a log has.

    Kinematics alone (the default) uses no forces: a smooth motion with white noise on the rate of its
    acceleration. Its velocities may be used for a diagnosis. With the model the estimate is more accurate if
    the model is right, and biased towards it if it is wrong: it is for control and for currents, and a
    diagnosis of it would only confirm its own model.

    Parameters
    ----------
    estimated : sequence of str
        V_N, V_E (with the model), b_u ... b_r.
    method : str
        "ekf" or "ukf"; by default "ukf" with the model, else "ekf". Initial velocity and current are unknown,
        and quadratic drag linearised there misleads an extended filter for minutes, but not sigma points.
    disturbance : mapping, optional
        Root of the spectral density of the noise on driven states by name; values not stated are estimated by
        maximum likelihood.
    """
    what = process_of(vehicle, estimated, process)
    reports, rows = reports_of(run, what)
    mean, covariance = first_guess(what, reports)
    densities, free = _first_densities(what, disturbance or {})
    if free.any():
        part = reports.first(SEARCH.rows)
        densities = most_likely(what, part, mean, covariance, densities, free, progress)
    chosen: Method = method or ("ukf" if process == "model" else "ekf")
    filtered = Observer(what, densities).run(reports, mean, covariance, chosen, progress)
    found = smoothed(filtered)
    last = (found.mean[-1], found.deviation[-1])
    known: Flags = np.asarray(reports.present.any(axis=0))
    rejected = reports.present & ~filtered.used
    return Observed(
        _as_run(run, what, found, rows),
        process,
        found,
        filtered,
        {n: float(np.sqrt(reports.variance[i])) for i, n in enumerate(what.channels) if known[i]},
        dict(zip(what.driven_names, np.sqrt(densities).tolist(), strict=True)),
        nis([filtered], what.channels),
        whiteness([filtered], what.channels),
        {n: (float(last[0][what.index(n)]), float(last[1][what.index(n)])) for n in estimated},
        {n: int(c) for n, c in zip(what.channels, rejected.sum(axis=0), strict=True) if c},
    )


# --- what a log reports ---------------------------------------------------------------------------
def reports_of(run: Run, process: Process) -> tuple[Reports, Index]:
    """Reports at the times of measurement, and the rows that correspond to those of the log.

    A report with a known delay is put where it belongs, so that reports are ordered by time of measurement.
    """
    own = [name if run.has(name) and name not in run.derived else "" for name in process.channels]
    late = np.where([bool(name) for name in own], process.late, 0.0)
    times = np.concatenate([run.t - age for age in {0.0, *late.tolist()}])
    t = _filled(_distinct(np.sort(times[times >= run.t[0] - SETTINGS.same_time])), longest_step(process))
    y = np.full((len(t), len(own)), np.nan)
    for i, name in enumerate(own):
        if name:
            at, reports = run.t - late[i], run.reports(name)
            good = np.isfinite(reports) & (at >= t[0] - SETTINGS.same_time)
            y[_nearest(t, at[good]), i] = reports[good]
    count = int(np.isfinite(y).sum())
    if count < SETTINGS.fewest:
        raise UndertowError(
            f"run {run.name!r} has {count} reports of {', '.join(process.channels)}, but {SETTINGS.fewest} "
            "are needed: map its columns (--map)"
        )
    variance = np.array([_noise(run, name, y[:, i], t) ** 2 for i, name in enumerate(process.channels)])
    return Reports(t, _commands(run, process, t), y, variance), _nearest(t, run.t)


def _noise(run: Run, name: str, reports: Array, t: Array) -> float:
    """Standard deviation of a report: stated, or from differences; meaningless if there is none."""
    there = np.isfinite(reports)
    if not there.any():
        return 1.0
    stated = run.sigma.get(name)
    found = report_noise(t[there], reports[there]) if stated is None else stated
    return float(max(found, SETTINGS.least * (np.std(reports[there]) or 1.0)))


def _distinct(t: Array) -> Array:
    return t[np.concatenate([[True], np.diff(t) > SETTINGS.same_time])]


def _filled(t: Array, longest: float) -> Array:
    """Times with more of them in between, so that no step is too long."""
    parts = np.ceil(np.diff(t) / longest - 1e-9).astype(int)
    pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(t[:-1], t[1:], parts, strict=True)]
    return np.concatenate([*pieces, t[-1:]])


def _nearest(t: Array, wanted: Array) -> Index:
    after = np.clip(np.searchsorted(t, wanted), 1, max(len(t) - 1, 1))
    return np.where(wanted - t[after - 1] <= t[after] - wanted, after - 1, after)


def _commands(run: Run, process: Process, t: Array) -> Array:
    """Commands that act at each time, held from sample to sample; missing ones keep the last value."""
    names = process.vehicle.command_names
    if process.kind == "kinematics":
        return np.zeros((len(t), len(names)))
    missing = [n for n in names if not run.has(n) and not n.startswith("tau_")]
    if missing:
        raise UndertowError(
            f"run {run.name!r} has no command {missing[0]!r}, which the model needs: map its column, or "
            "estimate with kinematics (--process kinematics)"
        )
    at = np.searchsorted(run.t, t - process.dead_time + SETTINGS.same_time, side="right") - 1
    return without_gaps(run.known(names))[np.maximum(at, 0)]


# --- first guesses --------------------------------------------------------------------------------
def first_guess(process: Process, reports: Reports) -> tuple[Array, Array]:
    """Mean and covariance before the first report: its values, with very large variances."""
    mean = np.zeros(len(process.state_names))
    for i, name in enumerate(process.channels):
        found = np.flatnonzero(np.isfinite(reports.y[:, i]))
        if len(found):
            mean[process.index(name)] = reports.y[found[0], i]
    return mean, UNKNOWN.covariance(process)


def _first_densities(process: Process, stated: Mapping[str, float]) -> tuple[Array, Flags]:
    """Spectral densities, and which of them are to be found."""
    s = SETTINGS
    first = s.first_model if process.kind == "model" else s.first_kinematics
    walk = {n: s.current_walk / np.sqrt(s.hour) for n in CURRENT}
    walk |= {n: s.bias_walk / np.sqrt(s.hour) for n in BIASES}
    unknown = [n for n in stated if n not in process.driven_names]
    if unknown:
        raise UndertowError(
            f"a disturbance of '{unknown[0]}' is stated, but process noise drives "
            f"{', '.join(process.driven_names)}"
        )
    known = walk | dict(stated)
    roots = [known.get(n, first) for n in process.driven_names]
    return np.array(roots) ** 2, np.array([n not in known for n in process.driven_names])


def _as_run(run: Run, process: Process, found: Estimate, rows: Index) -> Run:
    """Smoothed pose and velocities at the rows of the log, with its commands."""
    names = process.channels
    states = {n: found.mean[rows, process.index(n)] for n in names}
    deviation = found.deviation[rows]
    sigma = {n: float(np.median(deviation[:, process.index(n)])) for n in names}
    others = {n: c for n, c in run.channels.items() if n not in MOTION_UNITS}
    channels = {**states, **others}
    note = f"pose and velocities smoothed ({process.kind})"
    kept = replace(run, channels=channels, reported={}, wrapped={}, derived=frozenset(), sigma=sigma)
    return kept.with_notes(note)


def deviations(observed: Observed) -> dict[str, Array]:
    """Standard deviation of every pose and velocity at the rows of the log, by name."""
    at = _nearest(observed.estimate.t, observed.run.t)
    names = [n for n in observed.estimate.names if n in MOTION_UNITS]
    found = observed.estimate.deviation
    return {n: found[at, observed.estimate.names.index(n)] for n in names}


def csv(observed: Observed) -> str:
    """A log as undertow reads it: t, pose, velocities, commands, and standard deviations (sd_x ...)."""
    import polars as pl

    extra = {f"sd_{n}": d for n, d in deviations(observed).items()}
    columns = {"t": observed.run.t, **observed.run.channels, **extra}
    return pl.DataFrame(columns).fill_nan(None).write_csv()


def observer_file(
    observed: Observed | ObservedLogs, runs: Sequence[Run], name: str, method: Method = "ekf"
) -> str:
    """An observer file (TOML): the sensors of logs with noise and rates, and the noise that was found.

    Of several logs, root mean squares of the noise, and the median of the rates.
    """
    import tomlkit

    document = tomlkit.document()
    document.update({"schema": SCHEMA, "name": name, "process": observed.process, "filter": method})
    first = observed.each[0] if isinstance(observed, ObservedLogs) else observed
    document["estimate"] = list(first.parameters)
    sensors = tomlkit.table()
    for channel, sigma in observed.noise.items():
        row = tomlkit.inline_table()
        period = np.median([run.period(channel) for run in runs if run.has(channel)])
        row.update({"noise": f"{sigma:.4g} {MOTION_UNITS[channel]}", "period": f"{period:.4g} s"})
        sensors[channel] = row
    document["sensors"] = sensors
    document["disturbance"] = {n: float(f"{v:.4g}") for n, v in observed.disturbance.items()}
    return tomlkit.dumps(document)


def observed_picture(found: Observed, run: Run) -> Figure:
    """Every pose and velocity with a band of two standard deviations and its reports, then the NIS over time.

    The NIS is the mean of fifty normalised squared innovations that follow each other, with its 95% band.
    """
    names = [n for n in found.estimate.names if n in MOTION_UNITS]
    from undertow.figures import figure, look, with_unit

    with look():
        picture, axes = figure(1.5 * len(names) / 2 + 2.5, len(names) // 2 + 1, 2)
        for axis, name in zip(axes[:-1].T.ravel(), names, strict=True):
            _state_panel(axis, found, run, name)
            axis.set_ylabel(with_unit(name, MOTION_UNITS[name]))
        _nis_panel(axes[-1, 0], found)
        for axis in (axes[-1, 0], axes[-2, 1]):  # the lowest of each column
            axis.set_xlabel("time [s]")
        axes[-1, 1].set_axis_off()
        drawn = [pair for a in axes.ravel() for pair in zip(*a.get_legend_handles_labels(), strict=True)]
        axes[-1, 1].legend(handles=list({label: line for line, label in drawn}.values()), loc="center")
    return picture


def _state_panel(axis: Any, found: Observed, run: Run, name: str) -> None:
    from undertow.figures import AFTER, FAINT

    estimate, i = found.estimate, found.estimate.names.index(name)
    mean, spread = estimate.mean[:, i], 2 * estimate.deviation[:, i]
    axis.plot(estimate.t, mean, color=AFTER, label="estimate, smoothed")
    axis.fill_between(
        estimate.t,
        mean - spread,
        mean + spread,
        color=AFTER,
        alpha=0.25,
        lw=0,
        label="two standard deviations",
    )
    if run.has(name) and name not in run.derived:
        axis.plot(run.t, run.reports(name), ".", color=FAINT, ms=1.5, zorder=0, label="reports of the sensor")


def _nis_panel(axis: Any, found: Observed) -> None:
    from undertow.figures import FLOOR, INK

    used = found.filtered.used
    square = (found.filtered.innovation**2 / found.filtered.variance)[used]
    t = np.broadcast_to(found.filtered.t[:, None], used.shape)[used]
    k = min(SETTINGS.averaged_reports, max(len(square) // 4, 1))
    low, high = chi2.ppf([0.025, 0.975], k) / k
    mean = np.convolve(square, np.full(k, 1 / k), "valid")
    axis.plot(t[k - 1 :], mean, color=INK, lw=0.8, label=f"NIS, mean of {k} reports")
    axis.axhspan(low, high, color=FLOOR, alpha=0.2, lw=0, label="95% of such means if all is as stated")
    axis.set_ylabel("NIS")
