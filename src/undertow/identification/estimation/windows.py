"""Runs cut into windows: the motion at their start, the commands in them, predictions over them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from undertow.codegen.engine import mapped
from undertow.codegen.functions import Functions
from undertow.codegen.simulate import LONGEST_STEP
from undertow.errors import UndertowError
from undertow.identification.logs.run import GAPS, Run, unwrapped
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags, Index

from .data import channel_noise, local_polynomial, samples_around
from .inputs import held_commands

_ANGLES = ("phi", "psi")


@dataclass(frozen=True)
class WindowSettings:
    """Numbers by which logs are cut into windows, and the motion at their start is smoothed."""

    fewest: int = 3  # samples of a window
    # The last window may lack this share, so that a log of 100 s but for one sample gives 20 windows of 5 s.
    lacking: float = 0.1
    slack: float = 1e-3  # share of a sampling interval by which a window may be too short
    # Half-widths in samples of the fits that are tried, from narrow to wide; for what is left of an angle
    # once its rate is integrated, a line over a long time.
    widths: tuple[int, ...] = (2, 3, 5)
    widths_of_angles: tuple[int, ...] = (2, 3, 5, 10, 20, 40)
    # A fit that misses its samples by more than noise does in one of a hundred cases is not used.
    misfit_level: float = 0.01
    # A sample further off than this many ranges of its neighbours is an outlier.
    outlier: float = 3.0
    # Share of a sampling interval by which an arrival may miss a sample and still count as one with it.
    same_time: float = 1e-6
    # Runge-Kutta steps: the longest, s, and how far the fastest motion of a vehicle gets in one, in time
    # constants. With 0.15 the error is 6e-7 of the motion in a step, and 4e-6 in a time constant.
    longest_step: float = 0.5
    reach: float = 0.15
    poles: int = 100  # samples of all segments at which that is computed
    fewest_poles: int = 3  # and of each segment, at least


SETTINGS = WindowSettings()


@dataclass(frozen=True)
class Windows:
    """Windows of several runs, side by side; those with fewer samples than others are padded."""

    runs: tuple[Run, ...]
    # Length of a window in s, of the longest where runs differ; None: as long as there is no gap
    horizon: float | None
    names: tuple[str, ...]  # Names of the 2n channels, pose then velocity of the degrees of freedom
    commands: tuple[str, ...]  # Names of the command columns
    sigma: Array  # (2n,) noise of the channels, in their units
    run: Index  # (b,) run of every window
    first: Index  # (b,) sample of the run at which a window starts
    # (b,) sample of the run at which the segment without gaps starts that a window lies in
    segment: Index
    count: Index  # (b,) samples of every window
    t: Array  # (b, k) time, s; the padding repeats the last
    # (b, k, 2n) pose and velocity as reported; NaN in the padding and for pose that the log lacks
    measured: Array
    # (b, 2n) reported pose and velocity at the start, smoothed locally; zero for pose that the log
    # lacks
    start: Array
    segments: tuple[Segment, ...]  # Parts of the runs without gaps that the windows were cut from

    @property
    def samples(self) -> Index:
        """Index in its run of every sample, shape (b, k); the padding repeats the last."""
        steps = np.minimum(np.arange(self.t.shape[1]), self.count[:, None] - 1)
        return self.first[:, None] + steps

    @property
    def inside(self) -> Flags:
        """Which samples are not padding, shape (b, k)."""
        return np.asarray(np.arange(self.t.shape[1]) < self.count[:, None])

    @cached_property
    def rms(self) -> Array:
        """Root mean square of the reports of every channel, (2n,); zero for one without."""
        count = np.isfinite(self.measured).sum(axis=(0, 1))
        return np.sqrt(np.nansum(self.measured**2, axis=(0, 1)) / np.maximum(count, 1))

    @cached_property
    def held(self) -> list[Array]:
        """Commands in every run, as `held_commands` gives them."""
        return held_commands(self.runs, self.commands)

    @cached_property
    def motion(self) -> list[Array]:
        """Pose and velocity in every run, (N, 2n); zero for a channel that it lacks."""
        return [run.known(self.names) for run in self.runs]

    @cached_property
    def undelayed_commands(self) -> WindowCommands:
        """The commands of the windows, which arrive at once."""
        return WindowCommands.undelayed(self.t, _by_window(self, self.held, self.samples))

    def __len__(self) -> int:
        return len(self.run)

    def take(self, rows: Index, most: int) -> Windows:
        """Some of the windows, each with its first `most` samples."""
        chosen = {name: getattr(self, name)[rows] for name in ("run", "first", "segment", "start")}
        kept = {name: getattr(self, name)[rows][:, :most] for name in ("t", "measured")}
        some = replace(self, count=np.minimum(self.count[rows], most), **chosen, **kept)
        vars(some)["held"] = self.held  # it is of the same runs
        return some

    def of_run(self, run: int) -> tuple[Index, Windows]:
        """Places of the windows of one run, and these windows."""
        rows = np.flatnonzero(self.run == run)
        return rows, self.take(rows, self.t.shape[1])

    def start_after(self, seconds: Array) -> Array:
        """`start` (b, 2n), but each channel as reported some seconds (2n,) later, within its segment."""
        found = self.start.copy()
        places = {(s.run, s.first): s for s in self.segments}
        for pair in np.unique(np.column_stack([self.run, self.segment]), axis=0):
            rows = np.flatnonzero((self.run == pair[0]) & (self.segment == pair[1]))
            segment = places[int(pair[0]), int(pair[1])]
            for delay in np.unique(seconds[seconds > 0]):
                columns = np.flatnonzero(seconds == delay)
                values = segment.smoothed(self.t[rows, 0] + delay)
                found[np.ix_(rows, columns)] = values[:, columns]
        return found


@dataclass(frozen=True)
class Segment:
    """Part of a run without gaps, and the windows in it, as counted from its first sample."""

    run: int
    first: int
    t: Array
    measured: Array  # (N, 2n) with curves through the reports of a channel that is slower
    reported: Array  # (N, 2n) without them: NaN there
    names: tuple[str, ...]
    sigma: Array  # (2n,) noise of the channels
    starts: Index
    stops: Index

    def smoothed(self, when: Array) -> Array:
        """Reported pose and velocity at some instants, smoothed locally, shape (k, 2n)."""
        left = np.clip(np.searchsorted(self.t, when, side="right") - 1, 0, len(self.t) - 2)
        share = np.clip((when - self.t[left]) / (self.t[left + 1] - self.t[left]), 0.0, 1.0)[:, None]
        before, after = self.values(left), self.values(left + 1)
        return before + share * (after - before)

    def values(self, at: Index) -> Array:
        """The same at some samples."""
        known, values = self._smoothed_samples
        new = np.unique(at[~known[at]])
        if len(new):
            values[new] = start_values(self.t, self.measured, self.names, self.sigma, new, self.reported)
            known[new] = True
        return values[at]

    @cached_property
    def _smoothed_samples(self) -> tuple[Flags, Array]:
        """Which samples were smoothed already, (N,), and their values, (N, 2n).

        A fit of a sensor delay asks for the same ones at every step.
        """
        return np.zeros(len(self.t), dtype=bool), np.zeros(self.measured.shape)


def cut(
    runs: Sequence[Run],
    vehicle: Vehicle,
    horizon: float | None,
    *,
    sigma: Array | None = None,
    skip: float = 0.0,
) -> Windows:
    """Cut runs into windows and take the motion at each start from the measurement.

    `horizon` is the length of a window in s; None makes one window of every gap-free segment. `sigma`,
    shape (2n,), is the noise of the channels, estimated where it is not given. No window covers the first
    `skip` s of a run.
    """
    if horizon is not None and not horizon > 0:
        raise UndertowError(f"horizon = {horizon:g} s: give a positive time")
    sigma = _noise(runs, vehicle) if sigma is None else sigma
    segments = [s for i, run in enumerate(runs) for s in _segments(i, run, vehicle, sigma, horizon, skip)]
    if not any(len(s.starts) for s in segments):
        _refuse(runs, segments, horizon)
    return _windows_of(runs, vehicle, horizon, sigma, segments)


def cut_by_samples(runs: Sequence[Run], vehicle: Vehicle, intervals: int) -> Windows:
    """Cut every run into windows of a number of its own sampling intervals."""
    lengths, sigma = [intervals * run.step for run in runs], _noise(runs, vehicle)
    found = [_segments(i, run, vehicle, sigma, lengths[i]) for i, run in enumerate(runs)]
    for run, length, own in zip(runs, lengths, found, strict=True):
        if not any(len(s.starts) for s in own):
            _refuse([run], own, length)
    return _windows_of(runs, vehicle, max(lengths), sigma, [s for own in found for s in own])


def _noise(runs: Sequence[Run], vehicle: Vehicle) -> Array:
    return channel_noise(runs, (*vehicle.pose_names, *vehicle.velocity_names))


def _refuse(runs: Sequence[Run], segments: list[Segment], horizon: float | None) -> None:
    longest = max((s.t[-1] - s.t[0] for s in segments), default=0.0)
    if horizon is not None and horizon < (least := shortest_horizon(runs)):
        raise UndertowError(
            f"{horizon:g} s hold fewer than {SETTINGS.fewest} samples of "
            f"{', '.join(repr(r.name) for r in runs)}: give a horizon of {least:.3g} s or more"
        )
    wanted = f"{SETTINGS.fewest} samples" if horizon is None else f"{horizon:g} s"
    raise UndertowError(
        f"no gap-free segment is long enough to predict over {wanted}: the longest in "
        f"{', '.join(repr(r.name) for r in runs)} lasts {longest:g} s; give a longer log or a shorter horizon"
    )


def _segments(
    index: int, run: Run, vehicle: Vehicle, sigma: Array, horizon: float | None, skip: float = 0.0
) -> list[Segment]:
    pose = [n for n in vehicle.pose_names if run.has(n)]
    needed = [*pose, *vehicle.velocity_names]
    names = (*vehicle.pose_names, *vehicle.velocity_names)
    found = []
    for piece in run.segments([*needed, *vehicle.command_names], across=GAPS.harmless):
        t = run.t[piece]
        measured = np.column_stack([_column(run.channels, n, piece) for n in names])
        own = {n: run.reports(n) for n in run.reported}
        reported = np.column_stack([_column({**run.channels, **own}, n, piece) for n in names])
        late = int(np.searchsorted(t, run.t[0] + skip)) if skip else 0
        edges = (late + edge for edge in _windows(t[late:], horizon))
        found.append(Segment(index, piece.start, t, measured, reported, names, sigma, *edges))
    return found


def _column(channels: Mapping[str, Array], name: str, piece: slice) -> Array:
    if name not in channels:
        return np.full(piece.stop - piece.start, np.nan)
    values = channels[name][piece]
    return unwrapped(values) if name in _ANGLES else values


def _windows(t: Array, horizon: float | None) -> tuple[Index, Index]:
    """First sample, and one after the last sample, of every window; a window ends where the next starts."""
    if len(t) < SETTINGS.fewest:
        return _columns([])
    if horizon is None:
        return _columns([(0, len(t))])
    slack = SETTINGS.slack * float(np.median(np.diff(t)))
    found, first = [], 0
    while t[first] + (1.0 - SETTINGS.lacking) * horizon <= t[-1]:
        stop = min(int(np.searchsorted(t, t[first] + horizon - slack)), len(t) - 1)
        if stop + 1 - first >= SETTINGS.fewest:
            found.append((first, stop + 1))
        following = int(np.searchsorted(t, t[first] + horizon - slack))
        first = min(max(following, first + 1), len(t) - 1)
        if stop == len(t) - 1:
            break
    return _columns(found)


def _columns(pairs: list[tuple[int, int]]) -> tuple[Index, Index]:
    table = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def _windows_of(
    runs: Sequence[Run], vehicle: Vehicle, horizon: float | None, sigma: Array, segments: list[Segment]
) -> Windows:
    """The windows of all segments side by side, padded to the longest."""
    names = (*vehicle.pose_names, *vehicle.velocity_names)
    count = np.concatenate([s.stops - s.starts for s in segments])
    most = int(count.max())
    pick = [np.minimum(s.starts[:, None] + np.arange(most), s.stops[:, None] - 1) for s in segments]
    measured = np.concatenate([s.reported[i] for s, i in zip(segments, pick, strict=True)])
    measured[np.arange(most) >= count[:, None]] = np.nan
    return Windows(
        runs=tuple(runs),
        horizon=horizon,
        names=names,
        commands=vehicle.command_names,
        sigma=sigma,
        run=np.concatenate([np.full(len(s.starts), s.run) for s in segments]),
        first=np.concatenate([s.first + s.starts for s in segments]),
        segment=np.concatenate([np.full(len(s.starts), s.first) for s in segments]),
        count=count,
        t=np.concatenate([s.t[i] for s, i in zip(segments, pick, strict=True)]),
        measured=measured,
        start=np.concatenate([s.values(s.starts) for s in segments]),
        segments=tuple(segments),
    )


# --- the measured motion at one instant -----------------------------------------------------------


def start_values(
    t: Array, measured: Array, names: Sequence[str], sigma: Array, at: Index, reported: Array | None = None
) -> Array:
    """Pose and velocity (k, 2n) at some samples of a segment without gaps; zero for a channel not measured.

    Velocities and positions are smoothed over a few samples. Angles are smoothed over more, as what differs
    from the integral of the measured angular rates: that is kinematics and holds for every model. If some
    samples are not reports, NaN in `reported`, only the others are smoothed; for a channel with reports only
    before and after the segment, the curve through them is.
    """
    value = np.zeros((len(at), len(names)))
    there = np.isfinite(measured).all(axis=0)
    integrated = _integrated_angles(t, dict(zip(names, measured.T, strict=True)))
    for i in np.flatnonzero(there).tolist():
        known = integrated.get(names[i], np.zeros(len(t)))
        widths, degree = (
            (SETTINGS.widths, 2) if names[i] not in integrated else (SETTINGS.widths_of_angles, 1)
        )
        rest = measured[:, i] - known
        own = np.flatnonzero(np.isfinite(rest if reported is None else reported[:, i]))
        own = own if len(own) else np.arange(len(t))
        smooth = partial(local_value, t[own], rest[own], sigma=float(sigma[i]), widths=widths, degree=degree)
        value[:, i] = known[at] + (smooth(at) if len(own) == len(t) else _in_between(t, own, smooth, at))
    return value


def _in_between(t: Array, own: Index, smooth: Callable[[Index], Array], at: Index) -> Array:
    """Smoothed values at samples, from those at the reports before and after."""
    after = np.clip(np.searchsorted(own, at), min(1, len(own) - 1), len(own) - 1)
    before = np.maximum(after - 1, 0)
    low, high = t[own[before]], t[own[after]]
    share = np.clip((t[at] - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)
    return np.asarray((1.0 - share) * smooth(before) + share * smooth(after))


def _integrated_angles(t: Array, channels: dict[str, Array]) -> dict[str, Array]:
    """Integral of the measured Euler rates along a segment, for the angles whose rates are measured."""
    zero = np.zeros(len(t))
    phi, theta, p, q, r = (np.nan_to_num(channels.get(n, zero)) for n in ("phi", "theta", "p", "q", "r"))
    around = np.sin(phi) * q + np.cos(phi) * r
    rates = {
        "phi": p + np.tan(theta) * around,
        "theta": np.cos(phi) * q - np.sin(phi) * r,
        "psi": around / np.cos(theta),
    }
    step = np.diff(t)
    return {n: np.append(0.0, np.cumsum(0.5 * step * (x[1:] + x[:-1]))) for n, x in rates.items()}


def local_value(
    t: Array, y: Array, at: Index, sigma: float, widths: Sequence[int] = SETTINGS.widths, degree: int = 2
) -> Array:
    """Value of a noisy signal (N,) at some of its samples (k,).

    A polynomial is fitted to the samples around each instant, to as many of them as it fits within the noise.
    A kink or a jump thus narrows the fit instead of biasing it, down to the sample itself.
    """
    value = _without_outlier(y, at, sigma)
    for width in widths:
        if len(t) < 2 * width + 1:
            break
        fitted, _, misfit = local_polynomial(t, y[:, None], at, width, degree)
        good = misfit[:, 0] <= sigma**2 * chdtri(2 * width - degree, SETTINGS.misfit_level)
        value = np.where(good, fitted[:, 0], value)
    return value


def _without_outlier(y: Array, at: Index, sigma: float) -> Array:
    """The samples themselves; one that stands far off all of its neighbours is replaced by their median."""
    if len(y) < 2 * SETTINGS.widths[0] + 1:
        return np.asarray(y[at])
    near = samples_around(at, SETTINGS.widths[0], len(y))
    # Each row without its own sample; NumPy's functions for NaN take five times as long.
    neighbours = np.sort(y[near][near != at[:, None]].reshape(len(at), 2 * SETTINGS.widths[0]), axis=1)
    low, high = neighbours[:, 0], neighbours[:, -1]
    margin = SETTINGS.outlier * (high - low + 2 * sigma)
    outlying = (y[at] < low - margin) | (y[at] > high + margin)
    return np.where(outlying, np.median(neighbours, axis=1), y[at])


S = TypeVar("S", bound=np.generic)


@dataclass(frozen=True)
class WindowCommands:
    """Commands of windows, side by side."""

    u: Array  # (b, k, n_commands) commands at work from each sample on
    # (b, m) instants from which on a command is held, s: the samples, and what arrives between them;
    # the padding repeats the last
    t: Array
    held: Array  # (b, m, n_commands) commands at work from each instant on
    samples: Index | None = None  # (b, k) which instants are the samples; None: all are
    longest_step: float = LONGEST_STEP  # longest Runge-Kutta step that resolves the motion, s

    @classmethod
    def undelayed(cls, t: Array, u: Array) -> WindowCommands:
        """Commands that arrive when they are given: times (b, k) in s and commands (b, k, n_commands)."""
        return cls(u, t, u)

    def __getitem__(self, rows: slice | Index) -> WindowCommands:
        """The commands of some of the windows."""
        samples = None if self.samples is None else self.samples[rows]
        return WindowCommands(self.u[rows], self.t[rows], self.held[rows], samples, self.longest_step)

    def at_samples(self, values: Array) -> Array:
        """Values computed for every instant, (b, m, ...), at the samples alone, (b, k, ...)."""
        if self.samples is None:
            return values
        rest = (1,) * (values.ndim - 2)
        return np.take_along_axis(values, self.samples.reshape(*self.samples.shape, *rest), axis=1)

    def zero_filled(self, values: Array) -> Array:
        """What there is at the samples, (b, k, ...), with zeros at all other instants, (b, m, ...).

        Where padding repeats the last sample, the first of these keeps its value.
        """
        if self.samples is None:
            return values
        found = np.zeros((*self.t.shape, *values.shape[2:]))
        rows = np.arange(len(found))[:, None]
        found[rows, self.samples[:, ::-1]] = values[:, ::-1]
        return found


def delayed_commands(windows: Windows, delay: float) -> WindowCommands:
    """Commands of windows that arrive `delay` s late; before a run, its first ones."""
    if delay == 0.0:
        return windows.undelayed_commands
    instants, places, arrived = zip(*(_switching_times(run.t, delay) for run in windows.runs), strict=True)
    samples = _by_window(windows, places, windows.samples)
    first, last = samples[:, :1], samples[:, -1:]
    steps = np.minimum(first + np.arange(np.max(last - first) + 1), last)
    late = _by_window(windows, [u[i] for u, i in zip(windows.held, arrived, strict=True)], steps)
    samples = samples - first
    u = np.take_along_axis(late, samples[:, :, None], axis=1)
    return WindowCommands(u, _by_window(windows, instants, steps), late, samples)


def delayed_series(delay: float, t: Array, u: Array) -> WindowCommands:
    """Commands (b, k, n_commands) of the same times (k,) in s that arrive late; before, the first of each."""
    times = np.tile(t, (len(u), 1))
    if delay == 0.0:
        return WindowCommands.undelayed(times, u)
    instants, places, arrived = _switching_times(t, delay)
    late = u[:, arrived]
    return WindowCommands(late[:, places], np.tile(instants, (len(u), 1)), late, np.tile(places, (len(u), 1)))


def _by_window(windows: Windows, of_runs: Sequence[NDArray[S]], rows: Index) -> NDArray[S]:
    """What there is of every run, in the rows that belong to each window."""
    return np.stack([of_runs[run][row] for run, row in zip(windows.run, rows, strict=True)])


def _switching_times(t: Array, delay: float) -> tuple[Array, Index, Index]:
    """Samples and arrivals in order of time, s; which of them are the samples; and what arrived by then."""
    slack = SETTINGS.same_time * float(np.median(np.diff(t)))
    late = t + delay
    near = t[np.clip(np.searchsorted(t, late - slack), 0, len(t) - 1)]
    between = late[(late < t[-1]) & (np.abs(near - late) > slack)]
    instants = np.sort(np.concatenate([t, between]))
    arrived = np.maximum(np.searchsorted(late, instants + slack, side="right") - 1, 0)
    return instants, np.searchsorted(instants, t), arrived


@dataclass(frozen=True)
class Prediction:
    """Predictions of a model over windows, with the measurements."""

    windows: Windows  # The windows, with the measurement
    # (b, k, 2n) reported pose and velocity by the model; NaN in the padding and from where a
    # simulation diverged
    predicted: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 2n channels, pose then velocity."""
        return self.windows.names

    @cached_property
    def residual(self) -> Array:
        """Measured minus predicted, shape (b, k, 2n); NaN where there is nothing to compare."""
        return self.windows.measured - self.predicted

    @cached_property
    def diverged(self) -> int:
        """Number of windows in which the simulation diverged."""
        lost = ~np.isfinite(self.predicted).all(axis=2) & self.windows.inside
        return int(lost.any(axis=1).sum())

    @cached_property
    def rms(self) -> dict[str, float]:
        """Root mean square of the residual by channel, in its unit; inf if a window diverged."""
        return self._by_channel(np.inf if self.diverged else _rms(self.residual[:, 1:]))

    @cached_property
    def normalised(self) -> dict[str, float]:
        """`rms` over the noise of the channel: 1 is as good as can be."""
        noise = np.maximum(self.windows.sigma, 1e-300)
        pairs = zip(self.rms.items(), noise[self._measured_channels].tolist(), strict=True)
        return {name: rms / sigma for (name, rms), sigma in pairs}

    @cached_property
    def relative(self) -> dict[str, float]:
        """`rms` over the root mean square of the measurement, for the velocities: 0.05 is five per cent."""
        size = _rms(self.windows.measured[:, 1:])
        half = len(self.names) // 2
        sizes = dict(zip(self.names[half:], size[half:], strict=True))
        return {n: self.rms[n] / float(s) for n, s in sizes.items() if s > 0}

    @cached_property
    def fit(self) -> dict[str, float]:
        """Share of the variation that is predicted, by channel, %: 100 is perfect, 0 is as a mean."""
        centred = self.windows.measured[:, 1:].copy()
        for run in np.unique(self.windows.run):
            inside = self.windows.run == run
            centred[inside] -= _mean(centred[inside])
        size = self._by_channel(_rms(centred))
        return {n: 100.0 * (1.0 - self.rms[n] / s) for n, s in size.items() if s > 0}

    @cached_property
    def _measured_channels(self) -> Index:
        return np.flatnonzero(np.isfinite(self.windows.measured).any(axis=(0, 1)))

    def _by_channel(self, values: Array | float) -> dict[str, float]:
        table = np.broadcast_to(values, len(self.names))
        return {self.names[i]: float(table[i]) for i in self._measured_channels}


def position_error(prediction: Prediction) -> float:
    """Root mean square of the distance from predicted to measured position, m; NaN where none is measured."""
    squares = [prediction.rms[n] ** 2 for n in ("x", "y", "z") if n in prediction.rms]
    return float(np.sqrt(sum(squares))) if squares else float("nan")


def prediction_error(prediction: Prediction) -> float:
    """One number: geometric mean over the degrees of freedom of the relative error of the velocities.

    0.05 is five per cent; including sensor noise. `Prediction.relative` holds the parts.
    """
    return geometric_mean(np.array(list(prediction.relative.values())))


def geometric_mean(parts: Array) -> float:
    """Geometric mean of errors; NaN of none."""
    return float(np.exp(np.mean(np.log(np.maximum(parts, 1e-12))))) if len(parts) else float("nan")


def _mean(values: Array) -> Array:
    """Mean of each channel over what there is; NaN for a channel with nothing."""
    there = np.isfinite(values)
    count = there.sum(axis=(0, 1))
    total = np.sum(np.where(there, values, 0.0), axis=(0, 1))
    return np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)


def _rms(values: Array) -> Array:
    with np.errstate(over="ignore"):  # a simulation on its way to infinity
        return np.sqrt(_mean(values**2))


# --- how long windows have to be ------------------------------------------------------------------
@dataclass(frozen=True)
class HorizonSettings:
    """Settings that derive window lengths from a vehicle's time constants."""

    # Multiples of the slowest time constant. After a quarter of it an error of a force still grows with
    # time, after four of them the motion at the start is forgotten (e^-4 is 2%).
    multiples: tuple[float, float, float] = (0.25, 1.0, 4.0)
    # Shares of the record where nothing in the model is known to die away.
    shares: tuple[float, float, float] = (0.02, 0.1, 0.4)
    fewest_samples: int = 20  # of the shortest windows: fewer show noise only
    least_ratio: float = 2.0  # least ratio of one length to the next
    fewest_windows: int = 4  # that the logs together make of the longest
    longest: float = 0.9  # share of a usual segment without gaps that a window may have
    samples: int = 400  # of each run that the damping is averaged over
    # Time constants beyond this many records are as good as infinite: their damping is not seen.
    undamped: float = 10.0


HORIZONS = HorizonSettings()


def horizons(vehicle: Vehicle, runs: Sequence[Run]) -> tuple[float, float, float]:
    """Short, middle and long window for a vehicle's logs, s: 1/4, 1 and 4 of its slowest time constants.

    If the record is too short for that, the long windows are as long as it allows, and the others at most
    half of the next longer. If the model has no time constant (undamped or unstable), they are fractions of
    the record. Short windows have twenty samples at least, as far as the record allows.
    """
    segments = [longest_segment(vehicle, run) for run in runs]
    record = float(np.sum(segments))
    limit = min(HORIZONS.longest * float(np.median(segments)), record / HORIZONS.fewest_windows)
    known = time_constants(vehicle, runs)
    known = known[known < HORIZONS.undamped * record]
    wanted = HORIZONS.multiples if len(known) else HORIZONS.shares
    short, middle, long = (m * (float(known[-1]) if len(known) else limit) for m in wanted)
    sample = max(run.step for run in runs)
    short = max(short, HORIZONS.fewest_samples * sample)
    middle = max(middle, HORIZONS.least_ratio * short)
    long = min(max(long, HORIZONS.least_ratio * middle), limit)
    middle = min(middle, long / HORIZONS.least_ratio)
    return min(short, middle / HORIZONS.least_ratio), middle, long


def longest_segment(vehicle: Vehicle, run: Run) -> float:
    """Length of the longest part of a run without gaps, s."""
    wanted = (*vehicle.pose_names, *vehicle.velocity_names, *vehicle.command_names)
    names = [n for n in wanted if run.has(n)]  # what `cut` wants without gaps
    return max(
        (float(run.t[s.stop - 1] - run.t[s.start]) for s in run.segments(names, across=GAPS.harmless)),
        default=0.0,
    )


def possible_horizon(vehicle: Vehicle, runs: Sequence[Run], horizon: float) -> float:
    """The horizon, s, or half of the longest segment without gaps; three samples at least."""
    longest = max(longest_segment(vehicle, run) for run in runs)
    return max(min(horizon, longest / 2), shortest_horizon(runs))


def shortest_horizon(runs: Sequence[Run], samples: int = SETTINGS.fewest) -> float:
    """Length of a window, s, with so many samples of the run that has the most of them."""
    return (samples - 1) * min(run.step for run in runs)


def time_constants(vehicle: Vehicle, runs: Sequence[Run]) -> Array:
    """Time constants of a vehicle's velocities, s, the fastest first; of decaying motions only.

    They are those of M^-1 d(forcing)/d(nu), averaged over the motion in the logs: for quadratic damping that
    is the damping at the speeds seen. An undamped or growing motion has none.
    """
    return _decay_times(np.mean(_mean_jacobians(vehicle, runs), axis=0))


def time_constants_by_run(vehicle: Vehicle, runs: Sequence[Run]) -> list[Array]:
    """The same for every run by itself."""
    return [_decay_times(rates) for rates in _mean_jacobians(vehicle, runs)]


def _mean_jacobians(vehicle: Vehicle, runs: Sequence[Run]) -> list[Array]:
    """M^-1 d(forcing)/d(nu), averaged over the motion in each run, 1/s."""
    functions = Functions(vehicle)
    n, p = functions.nu_dot.numel(), np.array(functions.values(), dtype=float)
    names = vehicle.pose_names, vehicle.velocity_names, vehicle.command_names

    def mean(run: Run) -> Array:
        rows = _spread(len(run.t), HORIZONS.samples)
        *motion, u = (np.nan_to_num(run.known(kind)[rows]) for kind in names)
        return np.mean(_motion_slopes(functions, np.hstack(motion), u, run.t[rows], p), axis=0)

    return [rates[n:, n:] for rates in map(mean, runs)]


def _decay_times(rates: Array) -> Array:
    """Time constants of decaying modes, s, the fastest first."""
    poles = np.linalg.eigvals(rates).real
    return np.sort(-1.0 / poles[poles < 0.0])


def _spread(count: int, most: int) -> Index:
    """Some of so many rows, spread evenly."""
    return np.unique(np.linspace(0, count - 1, most).astype(np.intp))


def _motion_slopes(functions: Functions, motion: Array, u: Array, t: Array, p: Array) -> Array:
    """d(rates)/d(states) of pose and velocity at some samples, (k, 2n, 2n), where they are finite, 1/s."""
    own = functions.x.numel() - motion.shape[1]
    x = np.hstack([motion, np.zeros((len(motion), own))])
    (slopes,) = mapped(functions.motion_slopes, [x, u], p, t)
    good = np.isfinite(slopes).all(axis=(1, 2))
    return np.asarray(slopes[good] if good.any() else np.zeros((1, *slopes.shape[1:])))


def resolving_step(functions: Functions, windows: Windows, p: Array) -> float:
    """Longest Runge-Kutta step that resolves the motion of a vehicle in windows, s.

    It follows the fastest pole anywhere along the logs from which the windows were cut.
    """
    fastest, each = 0.0, max(SETTINGS.poles // len(windows.segments), SETTINGS.fewest_poles)
    for s in windows.segments:
        rows = _spread(len(s.t), each)
        u = windows.held[s.run][s.first + rows]
        slopes = _motion_slopes(functions, np.nan_to_num(s.measured[rows]), u, s.t[rows], p)
        fastest = max(fastest, float(np.abs(np.linalg.eigvals(slopes)).max()))
    limits = LONGEST_STEP, SETTINGS.longest_step
    return float(np.clip(SETTINGS.reach / max(fastest, 1e-9), *limits))
