"""Clocks that differ in one log: velocities or commands that are late against the rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.identification.estimation.residual import whitened
from undertow.identification.logs.run import Run
from undertow.model.symbols import POSE, VELOCITY
from undertow.typing import Array

from .dynamics import Dynamics
from .findings import Finding
from .kinematics import Kinematics, Samples, Stretch
from .mistakes import Undo, with_channels
from .sensors import Sensor, clustered_least_squares, fit_sensor

_GROUPS = {
    "linear": (("u", "v", "w"), ("x", "y", "z")),
    "angular": (("p", "q", "r"), ("phi", "theta", "psi")),
}


@dataclass(frozen=True)
class ClockSettings:
    """From where on clocks differ."""

    rounds: int = 5  # Gauss-Newton steps for velocities
    converged: float = 0.02  # change, in sampling steps, that ends them
    sure: float = 5.0  # standard errors of a shift of velocities
    steps: float = 0.5  # sampling steps below which such a shift does not matter
    command_rounds: int = 8  # the same for commands
    command_sure: float = 6.0
    command_steps: float = 3.0
    cluster: int = 8  # neighbouring test functions that count as one
    starts: tuple[float, ...] = (0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 1.5)  # delays of commands to begin with, s
    gained: float = 0.1  # share of the misfit that a delay or drift of commands must explain


SETTINGS = ClockSettings()


@dataclass(frozen=True)
class Shift:
    """How late velocities are against the rate of the pose."""

    names: tuple[str, ...]
    # delay, delay_error: in the middle of the runs, s.
    delay: float
    delay_error: float
    # drift, drift_error: from the first to the last sample of a run, s.
    drift: float
    drift_error: float


def shifts(kinematics: Kinematics, runs: Sequence[Run]) -> Iterator[Shift]:
    """Shift of linear and of angular velocities, as far as the channels show it."""
    for velocities, poses in _GROUPS.values():
        names = tuple(n for n in velocities if n in kinematics.channels)
        if names and any(p in kinematics.rows for p in poses):
            yield _shift(kinematics, list(runs), names)


def _shift(kinematics: Kinematics, runs: list[Run], names: tuple[str, ...]) -> Shift:
    """Gauss-Newton on delay and drift; velocities are read earlier or later by what is found."""
    found = np.zeros(2)
    step = float(np.median(np.diff(runs[0].t)))
    sensor = Sensor("sensor_delay", ("delay s", "drift s"), _columns(names, runs))
    for _ in range(SETTINGS.rounds):
        moved = [_moved(run, names, found) for run in runs]
        fit = fit_sensor(kinematics, moved, kinematics.rates(moved), sensor)
        change = np.clip(fit.value, -1.0, 1.0)
        found = found + change
        if np.all(np.abs(change) < SETTINGS.converged * step):
            break
    return Shift(names, float(found[0]), float(fit.error[0]), float(found[1]), float(fit.error[1]))


def _along(t: Array) -> Array:
    """Time as a share of the run, from -1/2 to 1/2."""
    return (t - t[0]) / max(t[-1] - t[0], 1e-9) - 0.5


def _two_clocks(who: str, how: str, delay: float, drift: float, error: float) -> Finding:
    """A delay that drifts; `how` has places for the delays at the beginning and at the end of a run."""
    delays = how.format(delay - drift / 2, delay + drift / 2)
    return Finding(
        id="two_clocks",
        severity="warning",
        text=f"{who} are on two clocks: {delays} (drift {drift:+.2f} ± {error:.1g} s); write both with the "
        "stamps of one clock",
        evidence={"delay": delay, "drift": drift},
    )


def _moved(run: Run, names: tuple[str, ...], shift: Array) -> Run:
    """Velocities of a while later, at the times that they belong to."""
    at = run.t + shift[0] + shift[1] * _along(run.t)
    present = {n: run.channels[n] for n in names}
    return with_channels(run, {n: np.interp(at, run.t, data) for n, data in present.items()})


def _columns(names: tuple[str, ...], runs: Sequence[Run]):  # type: ignore[no-untyped-def]
    places = [VELOCITY.index(n) for n in names]

    def columns(at: Samples, s: Stretch) -> Array:
        change = np.gradient(at.velocity[:, places], s.times, axis=0)
        late = np.einsum("nij,nj->ni", at.jacobian[:, :, places], change)
        share = _along(runs[s.run].t)[s.piece]
        return np.stack([late, late * share[:, None]], axis=2)

    return columns


def clock_findings(kinematics: Kinematics, runs: Sequence[Run]) -> Iterator[Finding]:
    """Velocities that are late or early, and clocks that drift apart."""
    step = float(np.median(np.diff(runs[0].t)))
    for one in shifts(kinematics, runs):
        names = ", ".join(one.names)
        verb = "is" if len(one.names) == 1 else "are"
        if abs(one.drift) > max(SETTINGS.sure * one.drift_error, step):
            how = f"{names} {verb} {{:+.2f}} s late at the beginning of a run and {{:+.2f}} s at its end"
            yield _two_clocks(f"{names} and the pose", how, one.delay, one.drift, one.drift_error)
        elif abs(one.delay) > max(SETTINGS.sure * one.delay_error, SETTINGS.steps * step):
            way = "late" if one.delay > 0 else "early"
            yield Finding(
                id="late_velocity",
                severity="warning",
                text=f"{names} {verb} {abs(one.delay):.3f} ± {one.delay_error:.1g} s {way} against the pose; "
                + _remedy(one),
                evidence={"delay": one.delay, "drift": one.drift},
            )


def _remedy(one: Shift) -> str:
    """What describes late velocities: the effect delays linear ones, and none comes before its time."""
    if one.delay > 0 and set(one.names) <= set(_GROUPS["linear"][0]):
        return "the effect sensor_delay describes it"
    return f"add {-one.delay:+.3f} s to their stamps, and interpolate them to those of the pose"


def command_clock(at: Dynamics) -> Finding | None:
    """Tell how late the motion follows the commands, or whether that grows or shrinks along the logs.

    None where it does neither. A constant delay is an effect of its own (actuation_delay), which real
    vehicles have; a motion before its command, or a delay that drifts, is a matter of the clocks.
    """
    step = float(np.median(np.diff(at.runs[0].t)))
    start = float(np.sum(at.fit.at.r**2))
    constant = _search(at, step, np.array([_nearest(at, step), 0.0]), drifts=False)
    both = None if constant is None else _search(at, step, constant[0], drifts=True)
    if constant is None or both is None:
        return None
    # A drift is judged beside the best constant delay: alone it would take a share of that, too.
    (found, error), (drift, spread) = constant[:2], (both[0][1], both[1][1])
    if both[2] < (1 - SETTINGS.gained) * min(constant[2], start) and abs(drift) > max(
        SETTINGS.command_sure * spread, SETTINGS.command_steps * step
    ):
        follows = "the motion follows the commands by {:+.2f} s at the beginning of a run"
        how = f"{follows} and by {{:+.2f}} s at its end"
        return _two_clocks("commands and motion", how, float(both[0][0]), float(drift), float(spread))
    if constant[2] < (1 - SETTINGS.gained) * start and abs(found[0]) > max(
        SETTINGS.command_sure * float(error[0]), SETTINGS.command_steps * step
    ):
        return _late(at, float(found[0]), float(error[0]))
    return None


def _nearest(at: Dynamics, step: float) -> float:
    """The delay to begin with: of commands that step, Gauss-Newton does not find one of many samples, s."""
    tried = np.unique([0.0, *(sign * max(late, step) for late in SETTINGS.starts for sign in (1, -1))])
    return float(min(tried, key=lambda late: _misfit(at, late)))


def _misfit(at: Dynamics, late: float) -> float:
    """What the refitted model leaves with commands that much later; infinite where one is missing."""
    here = _residual(at, _later(late, 0.0))
    if here is None:
        return np.inf
    value, *_ = np.linalg.lstsq(at.fit.at.J, -here, rcond=None)
    return float(np.sum((here + at.fit.at.J @ value) ** 2))


def _search(at: Dynamics, step: float, start: Array, drifts: bool) -> tuple[Array, Array, float] | None:
    """Delay, and drift if free, by Gauss-Newton, their errors, and the misfit that is left."""
    found, error, left = start, np.full(2, np.inf), np.inf
    for _ in range(SETTINGS.command_rounds):
        stepped = _step(at, found, 2 * step, drifts)
        if stepped is None:
            return None
        change, error, left = stepped
        found = found + np.clip(change, -1.0, 1.0)
        if np.all(np.abs(change) < 0.2 * step):
            break
    return found, error, left


def _late(at: Dynamics, delay: float, error: float) -> Finding | None:
    """A delay, where the refitted model is decisively better for it."""
    fit = at.refitted(undo=_later(delay, 0.0))
    if fit is None or not at.gain(fit).decisive:
        return None
    size = f"{abs(delay):.2f} ± {error:.1g} s"
    if delay > 0:
        clause = (
            f"the motion follows the commands by {size}: thrusters with a dead time or a lag (undertow add "
            "actuation_delay or thruster_lag), or commands that are logged too early"
        )
    else:
        clause = (
            f"the motion comes {size} before the commands, which no vehicle does: they are logged too late"
        )
    return Finding(
        id="late_commands",
        severity="warning" if delay > 0 else "mistake",
        text=f"{clause}; if it is the log, add {delay:+.2f} s to the stamps of the commands",
        evidence={"delay": delay, "error": error},
    )


def _step(at: Dynamics, shift: Array, small: float, drifts: bool) -> tuple[Array, Array, float] | None:
    """Gauss-Newton step of delay and drift with all free parameters, its errors, and what it would leave.

    None where a command that is missing would come into the data.
    """
    here, moved = (_residual(at, _later(*s)) for s in (shift, shift + np.array([small, 0.0])))
    if here is None or moved is None:
        return None
    late = (moved - here) / small
    table = np.column_stack([at.fit.at.J, late, *([late * _place_in_run(at)] if drifts else [])])
    rows = len(at.data.rows)
    value, error = clustered_least_squares(table, -here, SETTINGS.cluster * rows)
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


def _later(delay: float, drift: float) -> Undo:
    """Commands as they would be logged that much later."""

    def undo(run: Run) -> Run:
        then = run.t - delay - drift * _along(run.t)
        held = np.clip(np.searchsorted(run.t, then + 1e-9, side="right") - 1, 0, len(run.t) - 1)
        others = {*run.channels} - {*POSE, *VELOCITY}
        return with_channels(run, {n: run.channels[n][held] for n in others})

    return undo
