"""Two clocks in one log: velocities that are late against the pose, by a constant or a growing time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.typing import Array

from ..logs import Run
from ..logs.run import VELOCITY
from .findings import Finding
from .kinematics import Kinematics, Samples, Stretch
from .mistake import with_channels
from .sensors import Sensor, fit_sensor

_GROUPS = {
    "linear": (("u", "v", "w"), ("x", "y", "z")),
    "angular": (("p", "q", "r"), ("phi", "theta", "psi")),
}
_ROUNDS = 5
_SETTLED = 0.02  # of a sampling step
_SURE = 5.0  # standard errors
_STEPS = 0.5  # sampling steps below which a shift does not matter


@dataclass(frozen=True)
class Shift:
    """How late velocities are against the rate of the pose.

    Attributes
    ----------
    names : tuple of str
        The velocities.
    delay, delay_error : float
        In the middle of the runs, s.
    drift, drift_error : float
        From the first to the last sample of a run, s.
    """

    names: tuple[str, ...]
    delay: float
    delay_error: float
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
    for _ in range(_ROUNDS):
        moved = [_moved(run, names, found) for run in runs]
        fit = fit_sensor(kinematics, moved, kinematics.rates(moved), sensor)
        change = np.clip(fit.value, -1.0, 1.0)
        found = found + change
        if np.all(np.abs(change) < _SETTLED * step):
            break
    return Shift(names, float(found[0]), float(fit.error[0]), float(found[1]), float(fit.error[1]))


def _along(t: Array) -> Array:
    """Time as a share of the run, from -1/2 to 1/2."""
    return (t - t[0]) / max(t[-1] - t[0], 1e-9) - 0.5


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
        evidence = {"delay": one.delay, "drift": one.drift}
        if abs(one.drift) > max(_SURE * one.drift_error, step):
            start, end = one.delay - one.drift / 2, one.delay + one.drift / 2
            yield Finding(
                id="two_clocks",
                severity="warning",
                text=f"{names} and the pose are on two clocks: {names} {verb} {start:+.2f} s late at the "
                f"beginning of a run and {end:+.2f} s at its end (drift {one.drift:+.2f} ± "
                f"{one.drift_error:.1g} s); write both with the stamps of one clock",
                evidence=evidence,
            )
        elif abs(one.delay) > max(_SURE * one.delay_error, _STEPS * step):
            way = "late" if one.delay > 0 else "early"
            yield Finding(
                id="late_velocity",
                severity="warning",
                text=f"{names} {verb} {abs(one.delay):.3f} ± {one.delay_error:.1g} s {way} against the pose; "
                + _remedy(one),
                evidence=evidence,
            )


def _remedy(one: Shift) -> str:
    """What describes late velocities: the effect delays linear ones, and none comes before its time."""
    if one.delay > 0 and set(one.names) <= set(_GROUPS["linear"][0]):
        return "the effect sensor_delay describes it"
    return f"add {-one.delay:+.3f} s to their stamps, and interpolate them to those of the pose"
