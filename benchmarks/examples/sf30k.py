"""SUB-fighter 30k at sea: a published model that fails, and what is missing as far as one log can tell."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from undertow.identification.comparison import Comparison, compare
from undertow.identification.logs.run import Run

from . import tables
from .calls import Caller, Judged, Reported
from .variants import Tables, runs_of, variant, vehicle_of

Array = NDArray[np.float64]
FOLDER = "ntnu-rov-sf30k"
SIX, FOUR = "examples/sf30k/vehicle.toml", "examples/sf30k/vehicle-4dof.toml"
MAPPING = "examples/sf30k/log.toml"
LOG = "sf30k_20150518_1829.csv"
WINDOW = (720.0, 1330.0)
WAYS = tuple(
    Judged(f"{motions} degrees of freedom, validation on stretches", vehicle, MAPPING, (LOG,), (), WINDOW)
    for motions, vehicle in (("six", SIX), ("four", FOUR))
)
#: Where Neptune.xml puts the Doppler log, m; the vehicle files do not say so.
DOPPLER_LOG = {"x_s": 0.54, "y_s": -0.56, "z_s": 0.0}
#: What a second look takes for granted: the sensor where it is published to be, and a buoyancy of its own.
SECOND: Tables = {
    "velocity_lever_arm": {n: f"{place:g} m" for n, place in DOPPLER_LOG.items()},
    "net_buoyancy": {"B_net": 0.0},
}
THRUSTERS = ("lateral", "vertical", "port", "starboard")
_REVERSE: Tables = {"thruster_asymmetry": {"reverse_loss": 0.2}}
_GAINS: Tables = {"thruster_gain": {f"gain_error_{n}": 0.0 for n in THRUSTERS}}
#: Models fitted by hand.
BY_HAND: dict[str, Tables] = {
    "second look": SECOND,
    "with reverse loss": {**SECOND, **_REVERSE},
    "with gains": {**SECOND, **_GAINS},
    "with gains and reverse loss": {**SECOND, **_GAINS, **_REVERSE},
}
#: Time constant over which commands and motion are compared as steady, s.
STEADY = 20.0
_FEWEST = 6  # means that make a line


def work(call: Caller, images: Path) -> Reported:
    """Everything that takes time."""
    compared = {
        name: tables.comparison_kept(call.compare(way))
        for name, way in zip(("six", "four"), WAYS, strict=True)
    }
    found = [call.diagnose(way) for way in (*WAYS, second_look(call.scratch))]
    hand = [by_hand(call, name) for name in BY_HAND]
    from . import sf30k_pictures

    models = [vehicle_of(WAYS[1].vehicle), vehicle_of(hand[-1][1])]
    run = runs_of(WAYS[1], call.data, models[0])[0]
    before, after = (compare(model, [run]) for model in models)
    sf30k_pictures.draw(before, after, run, images)
    return {
        "compared": compared,
        "diagnoses": [tables.diagnosis_kept(reported) for reported, _ in found],
        "by_hand": tables.rounded([reported for reported, _ in hand]),
        "checks": tables.rounded({"arm": lever_arm(run), "slopes": slopes(before)}),
    }


def second_look(scratch: Path) -> Judged:
    """Four degrees of freedom with what the first look and the publication say of sensor and buoyancy."""
    file = variant(FOUR, SECOND, scratch / "second-look.toml")
    return replace(WAYS[1], title="four degrees of freedom, second look", vehicle=str(file))


def by_hand(call: Caller, name: str) -> tuple[Reported, Path]:
    """A model fitted (`undertow fit`): what its parameters are, before and after, and how it predicts."""
    stated = variant(FOUR, BY_HAND[name], call.scratch / "by-hand.toml")
    before, file = vehicle_of(stated), call.fit(replace(WAYS[1], vehicle=str(stated)))
    after = vehicle_of(file)
    ahead = tomllib.loads(file.read_text(encoding="utf-8"))["history"][-1]["error_after"]
    free = [n for n, v in before.values.items() if v.estimate]
    values = {n: [before.values[n].value, after.values[n].value, after.values[n].sigma] for n in free}
    return {"model": name, "ahead": ahead, "values": values}, file


# --- evidence that needs no model -------------------------------------------------------------
def lever_arm(run: Run) -> Reported:
    """Place of the Doppler log by kinematics alone, from how its excess goes with the yaw rate, m."""
    yaw, ahead, aside = excess(run)
    across = _slope(yaw, ahead)
    return {"x_s": _slope(yaw, aside), "y_s": {**across, "value": -across["value"]}}


def excess(run: Run) -> tuple[Array, Array, Array]:
    """Yaw rate, and what the Doppler log reads beyond the rate of the position fixes, as means over 4 s.

    For a sensor at (x, y) in a vehicle that yaws, the excess is -r y ahead and r x to starboard.
    """
    t, c = run.t, run.channels
    north, east, yaw = (_means(t, np.gradient(c[n], t), 4.0) for n in ("x", "y", "psi"))
    heading = _means(t, c["psi"], 4.0)
    ahead = np.cos(heading) * north + np.sin(heading) * east
    aside = -np.sin(heading) * north + np.cos(heading) * east
    return yaw, _means(t, c["u"], 4.0) - ahead, _means(t, c["v"], 4.0) - aside


def _means(t: Array, values: Array, width: float) -> Array:
    """Means over pieces of time; NaN where a piece is not full."""
    usual = width / float(np.median(np.diff(t)))
    pieces = [values[(t >= a) & (t < a + width)] for a in np.arange(t[0], t[-1], width)]
    return np.array([np.mean(p) if len(p) >= 0.8 * usual else np.nan for p in pieces])


def line(x: Array, y: Array) -> tuple[float, float]:
    """Slope and offset of the best line."""
    good = np.isfinite(x) & np.isfinite(y)
    slope, offset = np.polyfit(x[good], y[good], 1)
    return float(slope), float(offset)


def _slope(x: Array, y: Array) -> Reported:
    """Slope of y over x with its standard error; pieces far off the line are left out."""
    good = np.isfinite(x) & np.isfinite(y)
    for _ in range(3):
        slope, offset = line(x[good], y[good])
        rest = y - slope * x - offset
        good = np.isfinite(rest) & (np.abs(rest) < 4 * 1.4826 * np.median(np.abs(rest[good])))
    error = np.std(rest[good]) / (np.std(x[good]) * np.sqrt(good.sum()))
    return {"value": slope, "standard_error": float(error), "pieces": int(good.sum())}


def steady(comparison: Comparison, i: int) -> tuple[Array, Array]:
    """Commanded force, and the force that the motion needs by the model, as slow means, N or N m."""
    forces = comparison.forces
    drive = forces.wrenches["thrusters"][:, i]
    return _means(forces.t, drive, STEADY), _means(forces.t, drive + forces.missing[:, i], STEADY)


def slopes(comparison: Comparison) -> dict[str, Reported]:
    """Share of the commanded force that the motion shows, 1 if all of it arrives; also by its sign."""
    dofs = comparison.result.degrees_of_freedom
    return {dof: _by_side(*steady(comparison, i)) for i, dof in enumerate(dofs)}


def _by_side(drive: Array, needed: Array) -> Reported:
    sides = {"all": np.isfinite(drive), "positive": drive > 0, "negative": drive < 0}
    enough = {side: inside for side, inside in sides.items() if inside.sum() >= _FEWEST}
    return {side: _slope(drive[inside], needed[inside]) for side, inside in enough.items()}
