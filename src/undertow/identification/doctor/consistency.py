"""Whether pose rates and velocities agree in a log that is read rightly, and what a sensor does if not."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Mapping, Run, frames
from ..logs.run import UNITS, VELOCITY
from .findings import Finding
from .kinematic_search import DECISIVE, Explained, inconsistent
from .kinematics import Kinematics, Mismatch, Rates, Samples
from .mending import Edit, Edits
from .mistake import Mistake, turning
from .sensors import Sensor, SensorFit, fit_sensor, regressor_of, sensors

# A parameter of a sensor is believed from this many standard errors on.
_SURE = 6.0
# ... where it explains this share of what exceeds the noise, and that is worth a word.
_EXPLAINS, _WORTH = 0.5, 5e-4
_WATER_WORTH = 2e-3
_AS_GOOD = 2.0
_REST = 0.05


def sensor_fits(kinematics: Kinematics, runs: Sequence[Run]) -> list[SensorFit]:
    """Every kind of deviation of a sensor, fitted alone; the one that leaves least comes first."""
    rates = kinematics.rates(runs)
    fits = [fit_sensor(kinematics, runs, rates, s) for s in sensors(kinematics)]
    return sorted((f for f in fits if f.plausible), key=lambda f: f.after.total)


def as_good_as(explained: Explained, fits: Sequence[SensorFit]) -> list[SensorFit]:
    """Sensors' deviations that explain a mismatch as well as a mistake does, wherever that explains it."""
    before, after = explained.before.excess, explained.after.excess
    gone = inconsistent(explained.before) & (after <= before / DECISIVE)
    limit = _AS_GOOD * after + 0.02 * before
    return [f for f in fits if f.sensor.id != "water" and np.all((f.after.excess <= limit)[gone])]


# --- through the water ------------------------------------------------------------------------
def through_water(kinematics: Kinematics, before: Mismatch, fits: Sequence[SensorFit]) -> Explained | None:
    """Velocities through the water: a mismatch that is constant north and east."""
    if kinematics.rows[0] != "x":
        return None
    water = next((f for f in fits if f.sensor.id == "water"), None)
    if water is None or before.excess[0] < _WATER_WORTH or before.share[0] < 4 * before.floor[0]:
        return None
    sure = np.max(np.abs(water.value) / water.error) > _SURE
    if not sure or water.after.excess[0] > before.excess[0] / DECISIVE:
        return None
    return Explained(_in_water(water.value), [], before, water.after)


def _in_water(current: Array) -> Mistake:
    speeds = tuple(round(float(v), 4) for v in [*current, 0.0, 0.0][:3])

    def edits(mapping: Mapping) -> Edits:
        given = mapping.water.velocity if mapping.water else (0.0, 0.0, 0.0)
        return (Edit("water", "velocity", [round(a + b, 4) for a, b in zip(given, speeds, strict=True)]),)

    return Mistake(
        "velocity_through_water",
        "u, v, w are velocities through the water, read as velocities over ground: the water moves with "
        f"{speeds[0]:+.3g} m/s north and {speeds[1]:+.3g} m/s east",
        turning(lambda channels: frames.over_ground(channels, speeds)),
        edits,
        vehicle="[effects.water_speed_log] describes velocities through the water as they are",
    )


# --- what a sensor does -----------------------------------------------------------------------
def sensor_findings(kinematics: Kinematics, runs: Sequence[Run]) -> Iterator[Finding]:
    """Deviations of velocity sensors that explain a mismatch, and what no deviation explains."""
    rates = kinematics.rates(runs)
    known = [s for s in sensors(kinematics) if s.id not in ("water", "sensor_delay")]
    for _ in known:
        before = kinematics.of_rates(rates)
        fits = [f for s in known if (f := fit_sensor(kinematics, runs, rates, s)).plausible]
        best = min(fits, key=lambda f: f.after.total, default=None)
        if best is None or not _believed(best, before):
            break
        yield _told(best, before)
        rates = _corrected(kinematics, runs, rates, best)
    left = kinematics.of_rates(rates)
    for block, excess in zip(kinematics.blocks, left.excess, strict=True):
        if excess > _REST:
            names = ", ".join(kinematics.rows[i] for i in block)
            yield Finding(
                id="inconsistent",
                severity="warning",
                text=f"the rate of {names} and the velocities disagree by {excess:.0%} of the motion (mean "
                "square), and no usual mistake nor flaw of a sensor explains it",
                evidence={"share": float(excess)},
            )


def _believed(fit: SensorFit, before: Mismatch) -> bool:
    sure = np.max(np.abs(fit.value) / fit.error) > _SURE
    return bool(before.total > _WORTH and sure and fit.after.total < _EXPLAINS * before.total)


def _corrected(kinematics: Kinematics, runs: Sequence[Run], rates: Rates, fit: SensorFit) -> Rates:
    change = regressor_of(kinematics, runs, fit.sensor) @ fit.value
    return Rates(rates.pose, rates.velocity + change, rates.variance)


def _told(fit: SensorFit, before: Mismatch) -> Finding:
    return Finding(
        id="velocity_sensor",
        severity="warning",
        text=f"pose rates and velocities disagree by {before.total:.1%} of the motion (mean square), as they "
        f"would with {fit.told()}; undertow add {' or '.join(fit.sensor.effects)} puts it into the model",
        evidence=dict(
            zip(
                (n.split(" ")[0] for n in fit.sensor.names),
                fit.sensor.parameters(fit.value).tolist(),
                strict=True,
            )
        ),
    )


# --- what was not looked at ---------------------------------------------------------------------
def not_compared(kinematics: Kinematics, vehicle: Vehicle) -> Iterator[Finding]:
    """Degrees of freedom whose pose rate and velocity were not both measured: a frame or sign shows less."""
    pairs = zip(vehicle.pose_names, vehicle.velocity_names, strict=True)
    alone = [f"{v} with the rate of {p}" for p, v in pairs if p not in kinematics.rows]
    if not alone:
        return
    what = "no pose rate could be compared" if not kinematics.rows else f"not compared: {', '.join(alone)}"
    yield Finding(
        id="not_compared",
        severity="note",
        text=f"{what} (pose and velocity were not both measured, or one never changes): units, frames and "
        "signs there can only be judged by how the model fits",
        evidence={"degrees_of_freedom": float(len(alone))},
    )


# --- agreement --------------------------------------------------------------------------------
def agreement(kinematics: Kinematics, runs: Sequence[Run]) -> Finding:
    """Scale and offset of every velocity against the rate of the pose, in numbers."""
    names = [n for n in VELOCITY if n in kinematics.channels and _shows(kinematics, n)]
    fit = fit_sensor(kinematics, runs, kinematics.rates(runs), _scale_and_offset(names))
    size = len(names)
    scale, offset = 1.0 + fit.value[:size], fit.value[size:]
    lines = [
        f"{n} {s:.3f} ± {e:.1g}, offset {o:+.2g} {UNITS[n]}"
        for n, s, e, o in zip(names, scale, fit.error, offset, strict=False)
    ]
    return Finding(
        id="agreement",
        severity="note",
        text=f"pose rate over velocity: {'; '.join(lines)}",
        evidence=dict(zip((f"scale_{n}" for n in names), scale.tolist(), strict=True))
        | dict(zip((f"offset_{n}" for n in names), offset.tolist(), strict=True)),
    )


def _shows(kinematics: Kinematics, velocity: str) -> bool:
    linear, rows = VELOCITY.index(velocity) < 3, set(kinematics.rows)
    return bool(rows & ({"x", "y", "z"} if linear else {"phi", "theta", "psi"}))


def _scale_and_offset(names: list[str]) -> Sensor:
    places = [VELOCITY.index(n) for n in names]

    def columns(at: Samples, _: object) -> Array:
        j = at.jacobian[:, :, places]
        return np.concatenate([j * at.velocity[:, None, places], j], axis=2)

    return Sensor("agreement", tuple(f"{kind}_{n}" for kind in ("scale", "offset") for n in names), columns)
