"""Vehicles, random points, and the model evaluated by SymPy and mpmath alone."""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache

import mpmath
import numpy as np
import sympy as sm

from undertow.codegen.functions import Functions
from undertow.model.catalogue import catalogue
from undertow.model.effect import Curve, Propeller, Surface
from undertow.model.loading import load_vehicle
from undertow.model.symbols import DOFS, symbol
from undertow.model.vehicle import Thruster, Vehicle

DIGITS = 50
BASE = ("rigid_body", "added_mass", "linear_damping")
EFFECTS = sorted(e for e, cls in catalogue().items() if not cls.built_in)
RUDDER = Surface("rudder", (-0.8, 0.1, -0.05), (0.0, 0.6, -0.8), 0.02, 0.6, "T1", 0.2)
# Of all degrees of freedom and hardware; what the other bundled vehicles add, the vehicle "full" has.
BUNDLED = ["bluerov2", "box-hull", "cybership2", "mini-auv"]
# `make test` compares the dynamics of every effect, and what is derived from them alike for these.
SPREAD = EFFECTS[::6]


# --- vehicles -----------------------------------------------------------------------------------


def vehicle_with(*ids: str, dofs: tuple[str, ...] = DOFS, thrusters: int = 6) -> Vehicle:
    """A vehicle with base effects, the given ones and what these require."""
    rng = random.Random(7)
    hardware = tuple(
        Thruster(f"T{k}", tuple(round(rng.uniform(-1, 1), 3) for _ in range(6)))
        for k in range(1, thrusters + 1)
    )
    names = tuple(t.name for t in hardware)
    # What the hardware brings in by itself (the thrusters) is there already.
    required = [r for e in ids for r in catalogue()[e].requires if not catalogue()[r].built_in]
    wanted = [*BASE, *required, *ids]
    steered = any("control_surfaces" in catalogue()[e].requires for e in ids)
    surfaces = (RUDDER,) if steered and thrusters else ()
    if steered and thrusters > 2:  # by revolutions ahead of the rudder, and by a curve
        laws = (Propeller(0.2, 1.0), Curve.through([(-2.0, -1.0), (-0.1, 0.0), (0.1, 0.0), (2.0, 3.0)]))
        hardware = (*(replace(t, law=law) for t, law in zip(hardware, laws, strict=False)), *hardware[2:])
    effects = tuple(catalogue()[e](names, surfaces) for e in dict.fromkeys(wanted))
    forces = ("tau_X", "tau_N")
    return Vehicle("test vehicle", dofs, effects, {}, hardware, forces, surfaces=surfaces)


@cache
def full_vehicle() -> Vehicle:
    """Six degrees of freedom and every effect of the catalogue."""
    return vehicle_with(*EFFECTS)


@cache
def named_vehicle(name: str) -> Vehicle:
    """A bundled vehicle, the vehicle with every effect ("full"), or the base with one effect."""
    if name == "full":
        return full_vehicle()
    return load_vehicle(name) if name in BUNDLED else vehicle_with(name)


@cache
def functions_of(name: str) -> Functions:
    """The functions of a `named_vehicle`."""
    return Functions(named_vehicle(name))


# --- random points ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Point:
    """Where a model is evaluated; every entry is a double."""

    x: np.ndarray
    nu_dot: np.ndarray
    u: np.ndarray
    p: np.ndarray
    t: float


def random_point(functions: Functions, seed: int) -> Point:
    """State, input and parameters of a plausible vehicle: a positive definite mass matrix, damped motion."""
    rng = random.Random(seed)
    return Point(
        x=np.array([rng.uniform(-1.2, 1.2) for _ in functions.state_names]),
        nu_dot=np.array([rng.uniform(-1, 1) for _ in functions.vehicle.dof_indices]),
        u=np.array([rng.uniform(-1, 1) for _ in functions.vehicle.command_names]),
        p=random_parameters(functions, seed),
        t=rng.uniform(0, 10),
    )


def random_parameters(functions: Functions, seed: int) -> np.ndarray:
    """Parameters of a plausible vehicle; its hardware is that of the file."""
    rng = random.Random(1000 + seed)
    own = [_plausible(functions.vehicle, n, rng) for n in functions.parameter_names]
    return np.array([*own, *(n.value for n in functions.hardware)])


def _plausible(vehicle: Vehicle, name: str, rng: random.Random) -> float:
    known = {"m": (20, 30), "I_x": (6, 9), "I_y": (6, 9), "I_z": (6, 9), "rho": (990, 1030), "g": (9.7, 9.9)}
    if name in known:
        return rng.uniform(*known[name])
    low, high = vehicle.declaration(name).bounds
    if low == 0:
        return rng.uniform(0.1, min(high, 0.9))
    return rng.uniform(max(low, -0.9), min(high, 0.9) if high > 0 else -0.1)


# --- the reference ------------------------------------------------------------------------------


class Reference:
    """The model by SymPy's own printer and mpmath: shares nothing with the conversion to CasADi."""

    def __init__(self, functions: Functions) -> None:
        vehicle = functions.vehicle
        c = vehicle.composition
        chain, rates, _ = c.chain
        delivered = dict(zip(c.actuation, chain, strict=True))
        self.n = len(vehicle.dof_indices)
        states = [*c.eta, *c.nu, *c.wrench_states, *rates]
        assert tuple(map(str, states)) == functions.state_names
        parameters = [symbol(n) for n in functions.parameter_names]
        groups = [states, list(c.nu_dot), list(c.commands), parameters, [c.signals.t]]
        residual = c.residual.xreplace(delivered)
        mass = -residual.jacobian(c.nu_dot)
        memory = [r.xreplace(delivered) for r in c.wrench_states.values()]
        at_rest = dict.fromkeys(c.nu_dot, sm.Integer(0))
        parts = [mass, residual.xreplace(at_rest), c.pose_rate, sm.Matrix([*memory, *rates.values()])]
        self._parts = _lambdify(groups, [list(part) for part in parts])
        self._residual = _lambdify(groups, list(residual))
        self._outputs = _lambdify(groups, [e for part in c.reported for e in part])

    def x_dot(self, *point: Sequence[mpmath.mpf]) -> list[mpmath.mpf]:
        mass, forcing, pose_rate, owned = self._parts(*point)
        acceleration = mpmath.lu_solve(_square(mass, self.n), mpmath.matrix(forcing))
        return [*pose_rate, *acceleration, *owned]

    def residual(self, *point: Sequence[mpmath.mpf]) -> list[mpmath.mpf]:
        return self._residual(*point)

    def outputs(self, *point: Sequence[mpmath.mpf]) -> list[mpmath.mpf]:
        return self._outputs(*point)


def _square(entries: list[mpmath.mpf], n: int) -> mpmath.matrix:
    return mpmath.matrix([entries[i * n : (i + 1) * n] for i in range(n)])


def _lambdify(groups: list[list[sm.Symbol]], expressions: list) -> Callable[..., list]:
    return sm.lambdify(groups, expressions, modules="mpmath", cse=True)


@cache
def reference_of(name: str) -> Reference:
    """The reference of a `named_vehicle`."""
    return Reference(functions_of(name))


def exact(point: Point) -> list[list[mpmath.mpf]]:
    """The point for a `Reference`."""
    return [
        [mpmath.mpf(float(v)) for v in np.atleast_1d(a)]
        for a in (point.x, point.nu_dot, point.u, point.p, point.t)
    ]


def derivative(function: Callable[..., list], point: list[list[mpmath.mpf]], group: int) -> np.ndarray:
    """Central differences with 50 digits: exact to far more than a double, away from kinks."""
    h = mpmath.mpf(10) ** -20
    columns = []
    for k in range(len(point[group])):
        moved = [[*point[group][:k], point[group][k] + d, *point[group][k + 1 :]] for d in (h, -h)]
        up, down = (function(*point[:group], m, *point[group + 1 :]) for m in moved)
        columns.append([float((a - b) / (2 * h)) for a, b in zip(up, down, strict=True)])
    return np.array(columns, dtype=float).T.reshape(-1, len(columns))


def doubles(values: Sequence[mpmath.mpf]) -> np.ndarray:
    """Rounded to doubles."""
    return np.array([float(v) for v in values])


def assert_close(found: np.ndarray, expected: np.ndarray, tolerance: float = 1e-12) -> None:
    """Equal relative to the largest entry of a row (terms cancel, so single entries may not be)."""
    found, expected = np.asarray(found, dtype=float), np.asarray(expected, dtype=float)
    assert found.shape == expected.shape
    scale = (
        np.abs(expected).max(axis=-1, keepdims=True, initial=0)
        if expected.ndim > 1
        else np.abs(expected).max(initial=0)
    )
    error = np.abs(found - expected)
    assert (error <= tolerance * np.maximum(scale, 1e-2)).all(), f"differs by {error.max():.2e}"
