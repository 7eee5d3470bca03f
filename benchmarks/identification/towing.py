"""Towing tests of a model ship: what they determine, and what free runs make of the same drag."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import polars as pl

from benchmarks.results.reading import read
from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.api import Estimator, Method
from undertow.identification.estimation.fitted import Fitted, verdicts
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle

SPEEDS = np.array([0.2, 0.4])
_SHIP = Path(__file__).parents[2] / "examples" / "cse1"
_FREE_RUN = "manual_random_run1"
_NAMES = ("X_u", "X_uabsu")


@dataclass(frozen=True)
class Towed:
    """What one method makes of the drag.

    Attributes
    ----------
    source, method : str
        Which tests, and what was done with them.
    values, errors : tuple of float
        X_u and X_u|u| as magnitudes, kg/s and kg/m, and their standard errors.
    known : tuple of str
        Verdict on each, where the method gives one.
    drag : array of shape (2,)
        Force at `SPEEDS`, N.
    """

    source: str
    method: str
    values: tuple[float, ...]
    errors: tuple[float, ...]
    known: tuple[str, ...]
    drag: np.ndarray


@dataclass(frozen=True)
class Towing:
    """Everything about the towing tests.

    Attributes
    ----------
    measured : array of shape (2,)
        Mean force at `SPEEDS`, both ways, N.
    runs : int
        Number of towing runs.
    mass : str
        What the weak form says of the added mass, were it to be estimated from them.
    rows : list of Towed
    """

    measured: np.ndarray
    runs: int
    mass: str
    rows: list[Towed]


def towing(folder: Path, methods: Sequence[Method] = ("weak", "prediction-error")) -> Towing:
    """Surge drag of C/S Enterprise I by towing, and from a free run.

    Parameters
    ----------
    folder : Path
        The data.
    methods : sequence of str
        What the towing runs are fitted by, beside least squares.

    Raises
    ------
    UndertowError
        If a file cannot be used.
    """
    u_mean, x_mean = _mean_forces(folder / "towing" / "surge_runs.csv")
    measured = np.array([np.mean(np.abs(np.interp([-v, v], u_mean, x_mean))) for v in SPEEDS])
    ship, runs = _ship(), traces(folder / "towing" / "surge_raw_10Hz.csv")
    with_mass = ship.with_values({"X_udot": Value(-1.2, estimate=True)})
    mass = verdicts(Estimator("weak").fit(with_mass, runs))["X_udot"]
    source = f"{len(runs)} towing runs, every sample"
    u, force = (np.concatenate([r.channels[n] for r in runs]) for n in ("u", "tau_X"))
    means = f"{len(u_mean)} towing runs, their means"
    rows = [_steady(means, u_mean, -x_mean), _steady(source, u, force)]
    rows += [_fitted(source, m, Estimator(m).fit(ship, runs)) for m in methods]
    return Towing(measured, len(runs), mass, [*rows, *_free_run(folder / "freerun" / f"{_FREE_RUN}.csv")])


def _ship() -> Vehicle:
    """The hull alone: surge, a known force, its drag to be found."""
    stated = load_vehicle(str(_SHIP / "vehicle.toml"))
    return Vehicle(
        name="cse1-towed",
        degrees_of_freedom=("surge",),
        effects=tuple(e for e in stated.effects if e.id in _EFFECTS),
        values={n: v for n, v in stated.values.items() if n in _VALUES} | {"X_udot": Value(-1.2)},
        force_channels=("tau_X",),
    )


_EFFECTS = ("rigid_body", "added_mass", "linear_damping", "quadratic_damping")
_VALUES = ("m", *_NAMES)


def traces(path: Path) -> list[Run]:
    """Every towing run: the carriage's speed, and the force that the hull needs to keep it."""
    table = pl.read_csv(path)
    return [_trace(str(name), part) for (name,), part in table.group_by("run", maintain_order=True)]


def _trace(name: str, part: pl.DataFrame) -> Run:
    speed = part["carriage_speed_mps"].to_numpy()
    t = part["t_s"].to_numpy()
    # Front minus rear cell is the force of the water; what holds the hull against it is the opposite.
    force = (part["F8113_N"] - part["F8111_N"]).to_numpy()
    return Run(name, t, {"u": speed, "tau_X": force})


def _mean_forces(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Speeds, m/s, and the force of the water on the hull at each, N."""
    speeds, forces = pl.read_csv(path).select("u_mps", "X_hydro_N").sort("u_mps").to_numpy().T
    return speeds, forces


def _drag(vehicle: Vehicle, speeds: np.ndarray) -> np.ndarray:
    """Steady surge force of all damping effects at these speeds ahead alone, N."""
    f = Functions(vehicle)
    place = vehicle.velocity_names.index("u")
    force = sum((f.wrenches[e.id][place] for e in vehicle.effects if e.family == "damping"), ca.SX(0))
    others = [f.eta, f.nu_dot, f.memory, f.actuation, f.u, f.t]
    steady = ca.Function("drag", [*others, f.nu, f.p], [force])
    velocity = np.zeros((len(vehicle.velocity_names), len(speeds)))
    velocity[place] = speeds
    still = [ca.DM.zeros(s.shape) for s in others]
    return np.array([float(steady(*still, v, f.values())) for v in velocity.T])


def _steady(source: str, u: np.ndarray, force: np.ndarray) -> Towed:
    """The paper's (16) and (17) where nothing accelerates: plain least squares of the force, no filter."""
    columns = np.column_stack([u, np.abs(u) * u])
    values, *_ = np.linalg.lstsq(columns, force, rcond=None)
    spread = np.sum((force - columns @ values) ** 2) / (len(u) - 2)
    errors = np.sqrt(np.diag(spread * np.linalg.inv(columns.T @ columns)))
    return _row(source, "least squares", values, errors, ())


def _free_run(log: Path) -> list[Towed]:
    ship = load_vehicle(str(_SHIP / "vehicle.toml"))
    (run,) = read([log], ship, read_mapping(_SHIP / "log.toml"))
    found = []
    for method in ("weak", "output-error"):
        fit = Estimator(method).fit(ship, [run])
        found.append(_fitted("free run, pose and commands", method, fit))
    return found


def _fitted(source: str, method: str, fit: Fitted) -> Towed:
    known = verdicts(fit)
    words = {"weak": "weak form"}.get(method, method.replace("-", " "))
    row = _named(source, words, fit.values, fit.standard_errors, tuple(known[n] for n in _NAMES))
    return Towed(row.source, row.method, row.values, row.errors, row.known, -_drag(fit.vehicle, SPEEDS))


def _named(
    source: str, method: str, values: Mapping[str, float], errors: Mapping[str, float], known: tuple[str, ...]
) -> Towed:
    if missing := [n for n in _NAMES if n not in values]:
        raise UndertowError(f"{method}: no estimate of {missing[0]}, got {', '.join(values)}")
    return _row(source, method, [-values[n] for n in _NAMES], [errors[n] for n in _NAMES], known)


def _row(
    source: str, method: str, values: Iterable[float], errors: Iterable[float], known: tuple[str, ...]
) -> Towed:
    linear, quadratic = (float(v) for v in values)
    force = linear * SPEEDS + quadratic * SPEEDS**2
    return Towed(source, method, (linear, quadratic), tuple(float(e) for e in errors), known, force)
