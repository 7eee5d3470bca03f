"""Roll decay of a tanker model: linear damping, what the diagnosis makes of it, and damping laws by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from undertow.identification.comparison import compare
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

from . import tables
from .calls import Caller, Judged, Reported
from .variants import Tables, runs_of, variant, vehicle_of

Array = NDArray[np.float64]
FOLDER = "kvlcc2-rolldecay-sspa"
VEHICLE = "examples/kvlcc2/vehicle.toml"
MAPPING = "examples/kvlcc2/log.toml"
STILL, AGAIN, UNDER_WAY = "model_test_21337.csv", "model_test_21338.csv", "model_test_21340.csv"
WINDOW = (25.0, 91.0)
UNDER_WAY_WINDOW = (25.0, 76.0)
#: Righting moment of vertical sides.
SIDES: Tables = {"nonlinear_restoring": {"BM": 0.1}}
#: Models tried by hand: effects with start values.
MODELS: dict[str, Tables] = {
    "linear": {},
    "linear + quadratic": {"quadratic_damping": {"K_pabsp": -10.0}},
    "linear + cubic": {"cubic_damping": {"K_ppp": -20.0}},
    "linear, wall-sided": SIDES,
    "linear + quadratic, wall-sided": {"quadratic_damping": {"K_pabsp": -10.0}, **SIDES},
    "linear + cubic, wall-sided": {"cubic_damping": {"K_ppp": -20.0}, **SIDES},
}
BEST = "linear + quadratic, wall-sided"
HORIZON = 20.0


def judged(log: str, held: str, window: tuple[float, float] = WINDOW) -> Judged:
    """Identify on one test, judge on another."""
    return Judged(f"{log[-9:-4]} → {held[-9:-4]}", VEHICLE, MAPPING, (log,), (held,), window)


#: One test by itself: zero heel is the same throughout.
ALONE = Judged("21338, validation on stretches", VEHICLE, MAPPING, (AGAIN,), (), (25.0, 190.0))
PAIRS = (judged(AGAIN, STILL), judged(STILL, AGAIN))
WAYS = (*PAIRS, ALONE)
SPEED_WAYS = (judged(AGAIN, UNDER_WAY, UNDER_WAY_WINDOW), judged(UNDER_WAY, AGAIN, UNDER_WAY_WINDOW))


def work(call: Caller, images: Path) -> Reported:
    """Everything that takes time."""
    logs = {
        name: Judged("", VEHICLE, MAPPING, (name,), (), UNDER_WAY_WINDOW)
        for name in (STILL, AGAIN, UNDER_WAY)
    }
    compared = {name[:-4]: tables.comparison_kept(call.compare(what)) for name, what in logs.items()}
    ways = (*WAYS, *SPEED_WAYS)
    diagnoses = [tables.diagnosis_kept(call.diagnose(way)[0]) for way in ways]
    hand, vehicles = by_hand(call)
    pictures(call, vehicles, images)
    return {"compared": compared, "diagnoses": diagnoses, "by_hand": hand, "speed": at_speed(call)}


# --- models by hand ---------------------------------------------------------------------------
def by_hand(call: Caller) -> tuple[list[Reported], dict[str, Vehicle]]:
    """Every model fitted to one test by output error and judged on the other, both ways."""
    rows, vehicles = [], {}
    for way in PAIRS:
        for name, effects in MODELS.items():
            fitted = _fitted(call, way, effects)
            rows.append(
                {"way": way.title, "model": name, **_values(fitted), **_errors(fitted, way, call.data)}
            )
            vehicles[f"{way.title}: {name}"] = fitted
    return tables.rounded(rows), vehicles


def at_speed(call: Caller) -> list[Reported]:
    """Linear damping at zero speed and under way, over the same time after the release."""
    rows = []
    for log in (STILL, AGAIN, UNDER_WAY):
        held = AGAIN if log == STILL else STILL
        way = Judged("", VEHICLE, MAPPING, (log,), (held,), UNDER_WAY_WINDOW)
        for name in ("linear, wall-sided", BEST):
            found = _values(_fitted(call, way, MODELS[name]))
            rows.append({"test": log[:-4], "model": name, **found})
    return tables.rounded(rows)


def _fitted(call: Caller, way: Judged, tables: Tables) -> Vehicle:
    file = variant(VEHICLE, tables, call.scratch / "variant.toml")
    return vehicle_of(call.fit(replace(way, vehicle=str(file)), HORIZON))


def _values(vehicle: Vehicle) -> Reported:
    found = {
        n: vehicle.value_of(n) for n in ("K_pdot", "K_p", "K_pabsp", "K_ppp", "BM") if n in vehicle.values
    }
    return {n: {"value": v.value, "sigma": v.sigma} for n, v in found.items()}


def _errors(vehicle: Vehicle, way: Judged, data: Path) -> Reported:
    result = compare(vehicle, runs_of(way, data, vehicle, held=True)).result
    roll = {c.channel: c for c in result.channels}
    return {"ahead": result.prediction_error, "fit": roll["phi"].free_run_fit}


# --- amplitude and period ---------------------------------------------------------------------
def swings(run: Run) -> tuple[Array, Array, Array]:
    """Time (s), amplitude (rad) and period (s) of every full swing of a roll decay."""
    t, phi = run.t, run.channels["phi"] - np.nanmean(run.channels["phi"])
    turns = np.flatnonzero((phi[:-1] <= 0) & (phi[1:] > 0))
    cross = t[turns] - phi[turns] * np.diff(t)[turns] / (phi[turns + 1] - phi[turns])
    spans = [slice(a, b) for a, b in pairwise(turns)]
    height = np.array([(phi[s].max() - phi[s].min()) / 2 for s in spans])
    return (cross[1:] + cross[:-1]) / 2, height, np.diff(cross)


def period(vehicle: Vehicle, amplitude: Array) -> Array:
    """Period of free roll at an amplitude, s, from the energy: the moment integrated over a quarter swing."""
    inertia = vehicle.value_of("I_x").value - vehicle.value_of("K_pdot").value
    stiffness = vehicle.value_of("S_z").value
    breadth = vehicle.value_of("BM").value * vehicle.value_of("W").value if "BM" in vehicle.values else 0.0
    return np.array([_period(inertia, stiffness, breadth / 2, a) for a in amplitude])


def _period(inertia: float, stiffness: float, sides: float, amplitude: float) -> float:
    # phi = A sin(s) takes the singularity out of the integral of dphi / speed.
    s = (np.arange(400) + 0.5) / 400 * np.pi / 2
    phi = amplitude * np.sin(s)
    energy = lambda x: -stiffness * np.cos(x) + sides * (1 / np.cos(x) + np.cos(x))  # noqa: E731
    speed = np.sqrt(2 * (energy(amplitude) - energy(phi)) / inertia)
    return float(4 * np.mean(amplitude * np.cos(s) / speed) * np.pi / 2)


# --- pictures ---------------------------------------------------------------------------------
def pictures(call: Caller, vehicles: dict[str, Vehicle], images: Path) -> None:
    """Write the pictures of the page."""
    from . import kvlcc2_pictures

    kvlcc2_pictures.draw(call.data, vehicles, images)


def read(names: Sequence[str], data: Path, window: tuple[float, float]) -> list[Run]:
    """Tests as undertow reads them."""
    what = Judged("", VEHICLE, MAPPING, tuple(names), (), window)
    return runs_of(what, data, vehicle_of(VEHICLE))
