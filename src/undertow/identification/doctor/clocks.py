"""Clock differences within a log: sources or commands that are late relative to the rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from undertow.identification.estimation.residual import whitened
from undertow.identification.estimation.weak_form import with_reestimated_noise
from undertow.identification.findings import Finding
from undertow.identification.logs.mapping import Edits, LogMapping, as_toml, delay_edit
from undertow.identification.logs.run import Run
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .dynamics import SETTINGS as EVIDENCE
from .dynamics import Dynamics, dynamics_of
from .kinematics import Kinematics, Samples, Segment, rms
from .mistakes import Undo, names_with_verb, with_channels
from .sensors import (
    LATE_COURSE,
    Sensor,
    clustered_least_squares,
    fit_sensor,
    regressor_of,
    sensors,
    spoils,
)
from .sensors import SETTINGS as SENSORS

_SOURCES = (POSE[:3], POSE[3:], VELOCITY[:3], VELOCITY[3:])
"""Channels that one sensor reports: a position fix, a compass or gyroscope, a Doppler log, a gyroscope."""


@dataclass(frozen=True)
class ClockSettings:
    """Thresholds for clock differences."""

    rounds: int = 8  # Gauss-Newton steps for sources
    converged: float = 0.02  # change, in sampling steps, that ends them
    certain: float = 5.0  # standard errors of a shift of a source
    steps: float = 0.5  # sampling steps below which such a shift does not matter
    longest: float = 1.0  # s that a step may change a shift by, of a source and of commands
    command_rounds: int = 8  # steps for commands
    command_converged: float = 0.2  # change, in sampling steps, that ends them
    command_certain: float = 6.0  # the same as for a source
    command_steps: float = 3.0
    # delays of commands to begin with, s
    starts: tuple[float, ...] = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0)
    # Standard errors by which a motion before its commands contradicts a choice of which source is late.
    acausal: float = 3.0
    known: float = 1.0  # standard error of a delay, s, from which it is not determined
    least_explained: float = 0.1  # share of the misfit that a drift of commands must explain


SETTINGS = ClockSettings()


@dataclass(frozen=True)
class Latency:
    """Delay of a source relative to the one against which it is most certain; early if negative."""

    names: tuple[str, ...]
    against: tuple[str, ...]
    # delay, error: and its standard error, s.
    delay: float
    error: float

    def clear(self, step: float) -> bool:
        """Whether the delay is certain, and matters at a sampling step of so many s."""
        return abs(self.delay) > max(SETTINGS.certain * self.error, SETTINGS.steps * step)


def latencies(kinematics: Kinematics, runs: Sequence[Run]) -> list[Latency]:
    """Delay of every source that is later than another, as far as d(eta)/dt = J(eta) nu shows it.

    A sensor may be late, but never early: the earlier of two is taken as prompt. Sources that are not clearly
    late are treated as one.
    """
    channels = kinematics.channels
    sources = [own for group in _SOURCES if (own := tuple(n for n in group if n in channels))]
    found = _latencies(kinematics, runs, sources)
    late = [one.names for one in found if one.clear(runs[0].step)]
    prompt = tuple(n for names in sources if names not in late for n in names)
    beside = [one for one in found if one.names not in late]
    again = [one for one in _latencies(kinematics, runs, [prompt, *late]) if one.names in late]
    return [*_confirmed(kinematics, runs, again), *beside]


def _confirmed(kinematics: Kinematics, runs: Sequence[Run], found: list[Latency]) -> list[Latency]:
    """Latencies whose removal makes pose rates and velocities agree clearly better, given the rest."""
    # Gauss-Newton on a non-existent delay may end where it explains a different error. If rates and
    # velocities are hardly related even without it, no clock is to blame.
    clear = [one for one in found if one.clear(runs[0].step)]
    weight = kinematics.rates(runs).weight
    before = kinematics.mismatch(runs)
    choices, misfits = [], []
    for chosen in (c for size in range(len(clear) + 1) for c in combinations(clear, size)):
        rates = kinematics.rates(without_latencies(runs, chosen))
        # A heading that is late is late for the position, too: agreement there says that it is not.
        if not chosen or not np.any(spoils(before, kinematics.mismatch_of(rates))):
            choices.append(chosen)
            misfits.append(float(np.sum(((rates.pose - rates.velocity) * weight) ** 2)))
    left = np.array(misfits)
    each = SETTINGS.certain**2 * max(1.0, float(left.min()) / weight.size)
    best = choices[int(np.argmin(left + each * np.array([len(c) for c in choices])))]
    after = kinematics.mismatch(without_latencies(runs, best))
    if np.all((after.excess > EVIDENCE.unreadable) | ~after.moves):
        best = ()
    return [one for one in found if one in best or one not in clear]


def _latencies(kinematics: Kinematics, runs: Sequence[Run], sources: list[tuple[str, ...]]) -> list[Latency]:
    """Each source against the one that it comes after most certainly."""
    if len(sources) < 2:
        return []
    value, error = _delays(kinematics, runs, sources)
    certainty = np.where(np.isfinite(error) & (error > 0), value / np.where(error > 0, error, 1.0), -np.inf)
    other = np.argmax(certainty, axis=1)
    return [
        Latency(names, sources[j], float(value[i, j]), float(error[i, j]))
        for i, (names, j) in enumerate(zip(sources, other.tolist(), strict=True))
        if certainty[i, j] > 0
    ]


def _delays(
    kinematics: Kinematics, runs: Sequence[Run], sources: list[tuple[str, ...]]
) -> tuple[Array, Array]:
    """Delay of each source against each by Gauss-Newton, (k, k), and its error; infinite where none shows."""
    # Other sensor errors are fitted at the same time: in a steady turn a late position looks like that of a
    # sensor away from the origin.
    weight = kinematics.rates(runs).weight
    step, count, size = runs[0].step, len(sources), SENSORS.cluster * len(kinematics.rows)

    def left(shift: Array) -> Array:
        rates = kinematics.rates([_advanced(run, sources, shift) for run in runs])
        return np.asarray(((rates.pose - rates.velocity) * weight).ravel())

    def table(shift: Array) -> Array:
        slopes = [(left(shift + d) - left(shift - d)) / (2 * step) for d in step * np.eye(count)]
        moved = [_advanced(run, sources, shift) for run in runs]
        kinds = [s for s in sensors(kinematics) if s.id not in ("sensor_delay", LATE_COURSE)]
        others = [regressor_of(kinematics, moved, s) for s in kinds]
        return np.column_stack([*slopes, *((o * weight[:, :, None]).reshape(-1, o.shape[2]) for o in others)])

    found = np.zeros(count)
    for _ in range(SETTINGS.rounds):
        here, slopes = left(found), table(found)
        # A delay that the motion does not show stays as small as those of sensors are: it would run away, and
        # take with it those that do show.
        held = np.eye(count - 1, slopes.shape[1] - 1) * (rms(here[:, None]) / SENSORS.delay)
        both = np.vstack([slopes[:, 1:], held]), np.append(-here, -held[:, : count - 1] @ found[1:])
        change = clustered_least_squares(*both, size)[0][: count - 1]
        # All of them by one factor: cut one by one, delays that change together would come apart.
        change = change / max(1.0, float(np.max(np.abs(change))) / SETTINGS.longest)
        if np.all(np.abs(change) < SETTINGS.converged * step):
            break
        found[1:] += change
    value, error = np.zeros((count, count)), np.zeros((count, count))
    for j in range(count):  # the one that does not move
        free = [i for i in range(count) if i != j]
        change, spread = clustered_least_squares(np.delete(slopes, j, axis=1), -here, size)
        value[free, j] = found[free] - found[j] + change[: count - 1]
        # Where the search has not ended, the step that it would still take is a measure of the error.
        error[free, j] = np.hypot(spread, change)[: count - 1]
    # The time between two sources is the same whichever of them is moved.
    return value, np.maximum(error, error.T)


def _advanced(run: Run, sources: Sequence[tuple[str, ...]], delays: Array) -> Run:
    """A run whose sources report so many seconds, (k,), earlier."""
    moved = {}
    for names, delay in zip(sources, delays, strict=True):
        for name in names if delay else ():
            there = np.isfinite(run.channels[name])
            moved[name] = np.interp(run.t + delay, run.t[there], run.channels[name][there])
    return with_channels(run, moved)


def without_latencies(runs: Sequence[Run], found: Sequence[Latency]) -> list[Run]:
    """Runs corrected for the sources that are clearly late."""
    late = [one for one in found if one.clear(runs[0].step)]
    return [
        _advanced(run, [one.names for one in late], np.array([one.delay for one in late])) for run in runs
    ]


@dataclass(frozen=True)
class Shift:
    """Delay of velocities relative to the rate of the pose, in addition to the latencies found."""

    names: tuple[str, ...]
    poses: tuple[str, ...]  # against whose rates
    delay: float  # in the middle of the runs, s
    drift: float  # from the first to the last sample of a run, s
    drift_error: float


def shifts(kinematics: Kinematics, runs: Sequence[Run]) -> Iterator[Shift]:
    """Shift of linear and of angular velocities, as far as the channels show it."""
    for velocities, poses in zip(_SOURCES[2:], _SOURCES[:2], strict=True):
        names = tuple(n for n in velocities if n in kinematics.channels)
        if names and any(p in kinematics.rows for p in poses):
            yield _shift(kinematics, list(runs), names, poses)


def _shift(kinematics: Kinematics, runs: list[Run], names: tuple[str, ...], poses: tuple[str, ...]) -> Shift:
    """Gauss-Newton on delay and drift; velocities are read earlier or later by what is found."""
    # Steady offsets are fitted at the same time: that of a gyroscope would make a delay that drifts.
    found = np.zeros(2)
    step = runs[0].step
    delayed = Sensor("sensor_delay", ("delay s", "drift s"), _delay_columns(names, runs))
    offsets = [s for s in sensors(kinematics) if s.id == "sensor_bias"]
    for _ in range(SETTINGS.rounds):
        moved = [_velocities_advanced(run, names, found) for run in runs]
        fit = fit_sensor(kinematics, moved, kinematics.rates(moved), delayed, offsets)
        change = np.clip(fit.value, -SETTINGS.longest, SETTINGS.longest)
        found = found + change
        if np.all(np.abs(change) < SETTINGS.converged * step):
            break
    return Shift(names, poses, float(found[0]), float(found[1]), float(fit.error[1]))


def _run_share(t: Array) -> Array:
    """Time as a share of the run, from -1/2 to 1/2."""
    return (t - t[0]) / max(t[-1] - t[0], 1e-9) - 0.5


def _two_clocks(who: str, how: str, delay: float, drift: float, error: float) -> Finding:
    """A delay that drifts; `how` has places for the delays at the beginning and at the end of a run."""
    delays = how.format(delay - drift / 2, delay + drift / 2)
    return Finding(
        id="two_clocks",
        severity="warning",
        text=f"{who} are on two clocks: {delays} (drift {drift:+.2f} ± {error:.1g} s); time-stamp "
        "both with the same clock",
        evidence={"delay": delay, "drift": drift},
    )


def _velocities_advanced(run: Run, names: tuple[str, ...], shift: Array) -> Run:
    """Velocities of a while later, at the times that they belong to."""
    at = run.t + shift[0] + shift[1] * _run_share(run.t)
    return with_channels(run, {n: np.interp(at, run.t, run.channels[n]) for n in names})


def _delay_columns(names: tuple[str, ...], runs: Sequence[Run]):  # type: ignore[no-untyped-def]
    places = [VELOCITY.index(n) for n in names]

    def columns(at: Samples, s: Segment) -> Array:
        change = np.gradient(at.velocity[:, places], s.times, axis=0)
        late = np.einsum("nij,nj->ni", at.jacobian[:, :, places], change)
        share = _run_share(runs[s.run].t)[s.piece]
        return np.stack([late, late * share[:, None]], axis=2)

    return columns


def clock_findings(
    kinematics: Kinematics, runs: Sequence[Run], found: Sequence[Latency], mapping: LogMapping
) -> Iterator[Finding]:
    """Sources that are late, and clocks that drift apart."""
    step = runs[0].step
    late = {n: one.delay for one in found if one.clear(step) for n in one.names}
    drifting: set[str] = set()
    for one in shifts(kinematics, without_latencies(runs, found)):
        if abs(one.drift) > max(SETTINGS.certain * one.drift_error, step):
            late_by = f"{names_with_verb(one.names)} {{:+.2f}} s late"
            how = f"{late_by} at the beginning of a run and {{:+.2f}} s at its end"
            drifting |= {*one.names, *one.poses}
            delay = one.delay + late.get(one.names[0], 0.0) - max(late.get(n, 0.0) for n in one.poses)
            yield _two_clocks(f"{', '.join(one.names)} and the pose", how, delay, one.drift, one.drift_error)
    steady = [one for one in found if one.error < SETTINGS.known and not drifting & {*one.names}]
    yield from (late_source(one, mapping) for one in steady if one.clear(step))
    if steady and any(run.reported for run in runs):
        sizes = (
            f"{', '.join(one.names)} {one.delay:.3f} ± {one.error:.1g} s after {', '.join(one.against)}"
            for one in steady
        )
        yield Finding(
            id="latencies",
            severity="note",
            text=f"time stamps of the sources: {'; '.join(sizes)}",
            evidence={one.names[0]: one.delay for one in steady},
        )


def late_source(latency: Latency, mapping: LogMapping) -> Finding:
    """The finding on a source that is late, and the lines of the mapping file that correct it."""
    early = latency.delay < 0
    described = {*latency.names} <= {*VELOCITY[:3]} and not early
    effect = ", or the effect sensor_delay can model it" if described else ""
    when = "early against" if early else "late against"
    why = " (if those were late, the motion would precede the commands)" if early else ""
    return Finding(
        id="late_velocity" if latency.names[0] in VELOCITY else "late_pose",
        severity="warning",
        text=f"{names_with_verb(latency.names)} {abs(latency.delay):.3f} ± {latency.error:.1g} s {when} "
        f"{', '.join(latency.against)}{why}; a `delay` in the mapping file corrects it{effect}",
        evidence={"delay": latency.delay, "error": latency.error},
        mapping=as_toml(delay_edits(latency, mapping)),
    )


def delay_edits(latency: Latency, mapping: LogMapping) -> Edits:
    """Changes of a mapping file by which a source is no longer late."""
    return tuple(delay_edit(mapping, n, latency.delay) for n in latency.names)


def command_clock(at: Dynamics, mapping: LogMapping) -> Finding | None:
    """Delay of the motion after the commands, or its drift along the logs.

    None if there is neither, unless commands are a series with its own time stamps, and the delay is known. A
    constant delay is an effect (actuation_delay), which real vehicles have; a motion before its command, or a
    drifting delay, is a clock error.
    """
    step = at.runs[0].step
    refitted, delay = _refitted_with_delay(at)
    constant = _constant_delay(refitted, delay)
    both = None if constant is None else _search(refitted, constant[0], drifts=True)
    if constant is None or both is None:
        return None
    # A drift is judged beside the best constant delay: alone it would take a share of that, too.
    (found, error), (drift, spread) = constant[:2], (both[0][1], both[1][1])
    beyond = max(SETTINGS.command_certain * spread, SETTINGS.command_steps * step)
    if both[2] < (1 - SETTINGS.least_explained) * constant[2] and abs(drift) > beyond:
        follows = "the motion follows the commands by {:+.2f} s at the beginning of a run"
        how = f"{follows} and by {{:+.2f}} s at its end"
        return _two_clocks("commands and motion", how, float(both[0][0]), float(drift), float(spread))
    delay, sigma = float(found[0]), float(error[0])
    certainty = abs(delay) > max(SETTINGS.command_certain * sigma, SETTINGS.command_steps * step)
    acausal = _acausal(delay, sigma, step)
    explains = (certainty or acausal) and _explains(at, delay)
    if certainty and explains:
        return _late_commands(at, delay, sigma, mapping)
    known = sigma < SETTINGS.known and any(run.reported for run in at.runs)
    if acausal or known:
        return _latency_note(delay, sigma, acausal=acausal, shifted=acausal and explains)
    return None


def _refitted_with_delay(at: Dynamics) -> tuple[Dynamics, float]:
    """The model refitted with commands of a delay, s, near the best one, where Gauss-Newton can begin."""
    # The fit to commands that are many samples off may have reduced their force to zero, and would then not
    # show their delay; and its residual is then not noise.
    step = at.runs[0].step
    tried = np.unique([0.0, *(sign * max(late, step) for late in SETTINGS.starts for sign in (1, -1))])
    delay = float(max(tried, key=lambda late: at.predicted_reduction(_delayed(late, 0.0)) or 0.0))
    fit = at.refitted(undo=_delayed(delay, 0.0)) if delay else None
    return (at, 0.0) if fit is None else (replace(at, fit=with_reestimated_noise(fit)), delay)


def _constant_delay(at: Dynamics, start: float) -> tuple[Array, Array, float] | None:
    found = _search(at, np.array([start, 0.0]), drifts=False)
    return found if found and np.isfinite(found[1][0]) else None  # infinite without a command


def _acausal(delay: float, error: float, step: float) -> bool:
    """Whether a motion comes before its commands, by more than an error and a sampling step."""
    return delay < -max(SETTINGS.acausal * error, step)


def _explains(at: Dynamics, delay: float) -> bool:
    """Whether the refitted model explains decisively more with commands that are that much later."""
    # Only that makes a negative delay a clock error. In feedback control the commands respond to the missing
    # effect and so correlate with it: with commands shifted ahead every such log is explained a little
    # better, but nearly all of the residual remains. With a true clock error it vanishes.
    fit = at.refitted(undo=_delayed(delay, 0.0))
    return fit is not None and at.gain(fit).decisive


def _latency_note(delay: float, error: float, *, acausal: bool, shifted: bool) -> Finding:
    why = ""
    if shifted:
        why = ", which is impossible: compare the clocks of commands and sensors"
    elif acausal:
        why = (
            ", which explains little of the model's residual and proves no clock error: a controller that "
            "responds to what the model lacks looks the same"
        )
    return Finding(
        id="command_latency",
        severity="warning" if shifted else "note",
        text=f"the motion follows the commands by {delay:+.3f} ± {error:.1g} s{why}",
        evidence={"delay": delay, "error": error},
    )


def causal(vehicle: Vehicle, runs: Sequence[Run], found: Sequence[Latency]) -> list[Latency]:
    """Latencies with which no motion precedes its commands, as far as the commands show."""
    # Pose rates and velocities show how far sources are apart, not which of them is wrong: if corrected
    # velocities clearly precede the commands, and those of the log do not, the rest is early.
    step = runs[0].step
    late = [one for one in found if one.clear(step)]
    turned = [one for one in late if {*one.names} & {*VELOCITY}]
    at = dynamics_of(vehicle, without_latencies(runs, late)) if turned else None
    constant = None if at is None else _constant_delay(*_refitted_with_delay(at))
    if at is None or constant is None:
        return list(found)
    delay, error = float(constant[0][0]), float(constant[1][0])
    weight = np.array([one.error**-2 for one in late])
    common = float(weight @ [one.delay for one in late] / weight.sum())
    if not _acausal(delay, error, step) or _acausal(delay + common, error, step) or not _explains(at, delay):
        return list(found)
    names = tuple(n for one in late for n in one.names)
    prompt = tuple(dict.fromkeys(n for one in late for n in one.against if n not in names))
    early = Latency(prompt, names, -common, float(weight.sum() ** -0.5))
    return [early, *(one for one in found if one not in late and not {*one.names} & {*prompt})]


def _search(at: Dynamics, start: Array, drifts: bool) -> tuple[Array, Array, float] | None:
    """Delay, and drift if free, by Gauss-Newton, their errors, and the misfit that is left."""
    step, found, error, left = at.runs[0].step, start, np.full(2, np.inf), np.inf
    for _ in range(SETTINGS.command_rounds):
        stepped = _newton_step(at, found, 2 * step, drifts)
        if stepped is None:
            return None
        change, error, left = stepped
        found = found + np.clip(change, -SETTINGS.longest, SETTINGS.longest)
        if np.all(np.abs(change) < SETTINGS.command_converged * step):
            break
    return found, error, left


def _late_commands(at: Dynamics, delay: float, error: float, mapping: LogMapping) -> Finding:
    """A delay for which the refitted model is decisively better."""
    size = f"{abs(delay):.2f} ± {error:.1g} s"
    if delay > 0:
        clause = (
            f"the motion follows the commands by {size}: thrusters with a dead time or a lag (undertow add "
            "actuation_delay or thruster_lag), or commands that are logged too early"
        )
    else:
        clause = f"the motion precedes the commands by {size}, which is impossible: they are logged too late"
    return Finding(
        id="late_commands",
        severity="warning" if delay > 0 else "mistake",
        text=f"{clause}; if it is the log, a `delay` of {-delay:+.2f} s in the mapping file corrects it",
        evidence={"delay": delay, "error": error},
        mapping=as_toml(delay_edit(mapping, n, -delay) for n in at.fit.vehicle.command_names),
    )


def _newton_step(at: Dynamics, shift: Array, small: float, drifts: bool) -> tuple[Array, Array, float] | None:
    """Gauss-Newton step of delay and drift with all free parameters, its errors, and what it would leave."""
    # None if a missing command would enter the data.
    here, moved = (_residual(at, _delayed(*s)) for s in (shift, shift + np.array([small, 0.0])))
    if here is None or moved is None:
        return None
    late = (moved - here) / small
    table = np.column_stack([at.fit.at.J, late, *([late * _place_in_run(at)] if drifts else [])])
    rows = len(at.data.rows)
    value, error = clustered_least_squares(table, -here, SENSORS.cluster * rows)
    known = at.fit.at.J.shape[1]
    unmoved = np.zeros(1 - int(drifts))
    left = float(np.sum((here + table @ value) ** 2))
    return np.append(value[known:], unmoved), np.append(error[known:], unmoved), left


def _residual(at: Dynamics, undo: Undo) -> Array | None:
    data = at.undone(undo)
    return None if data is None else whitened(at.fit.model.linearise(data, at.fit.p), at.fit.whitening).r


def _place_in_run(at: Dynamics) -> Array:
    """Time of every residual as a share of its run, from -1/2 to 1/2."""
    ends = np.array([(r.t[0], r.t[-1]) for r in at.runs])[at.data.run_of]
    return (at.data.time - ends[:, 0]) / (ends[:, 1] - ends[:, 0]) - 0.5


def _delayed(delay: float, drift: float) -> Undo:
    """Commands as they would be logged that much later."""

    def undo(run: Run) -> Run:
        then = run.t - delay - drift * _run_share(run.t)
        held = np.clip(np.searchsorted(run.t, then + 1e-9, side="right") - 1, 0, len(run.t) - 1)
        others = {*run.channels} - {*POSE, *VELOCITY}
        return with_channels(run, {n: run.channels[n][held] for n in others})

    return undo
