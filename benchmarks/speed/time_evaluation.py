"""What one evaluation of the dynamics costs in C, and how that grows with the model."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import sympy as sm

from undertow.codegen import Functions
from undertow.codegen.compiler import LANES, find_compiler, plain_c
from undertow.codegen.engine import LANES_HEADER
from undertow.model.catalogue import catalogue
from undertow.model.effect import Measurement
from undertow.model.symbols import DOFS, symbol
from undertow.model.vehicle import Thruster, Vehicle

from . import hand, vehicle
from .conftest import Speed
from .goals import EVALUATION, OURS

EXACT = 1e-12
STATES = 2048
_GROWTH_EFFECTS = "one evaluation of f in C, by number of effects, 6 DOF"
_GROWTH_DOFS = "one evaluation of f in C, by degrees of freedom"
_LOOP = """
#if defined(__GNUC__)
__attribute__((visibility("default"), noinline))
#endif
void over_states(long n, const double *x, const double *u, const double *p, double *x_dot) {
  for (long k = 0; k < n; k++) %s;
}
"""
# A function of its own: inlined into the loop it is slower.
_BY_HAND = """
static __attribute__((noinline))
void by_hand(const double *x, const double *u, const void *p, double *x_dot) {
  hand_dynamics(x, u, p, x_dot);
}
"""
_BY_HAND += _LOOP % "by_hand(x + 12 * k, u, p, x_dot + 12 * k)"
Loop = Callable[[], np.ndarray]


# --- who evaluates --------------------------------------------------------------------------------


def _loop(library: ctypes.CDLL, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> Loop:
    """Evaluates at every state in one call."""
    result = np.empty_like(x)
    addresses = [ctypes.c_void_p(a.ctypes.data) for a in (x, u, p, result)]

    def run() -> np.ndarray:
        library.over_states(ctypes.c_long(len(x)), *addresses)
        return result

    run.kept = x, u, p  # type: ignore[attr-defined]
    return run


def _ours(functions: Functions, folder: Path, x: np.ndarray, u: np.ndarray, p: np.ndarray) -> Loop:
    """The prepared form, compiled as simulations are."""
    compiler = find_compiler()
    assert compiler is not None
    f, n = functions.prepared.dynamics, x.shape[1]
    call = _LOOP % f"dynamics(x + {n} * k, u, p, 0.0, x_dot + {n} * k)"
    model = plain_c(f, "dynamics", prefix="static SEPARATE ", words=LANES, shared=("t",))
    (folder / "ours.c").write_text(f"{LANES_HEADER}\n{model}{call}", encoding="utf-8")
    compiler.for_this_machine().build(folder / "ours.c", folder / "ours.so")
    q = np.array(functions.prepared.prepare(p)).ravel()
    return _loop(ctypes.CDLL(str(folder / "ours.so")), x, u, q)


def _by_hand(folder: Path, x: np.ndarray, u: np.ndarray) -> Loop:
    source = hand.SOURCE.read_text(encoding="utf-8") + _BY_HAND
    return _loop(hand.library(source, folder, "by_hand"), x, u, hand.parameters())


@cache
def _in_python(modules: str) -> Callable[..., np.ndarray]:
    """x_dot(x, u, p) as SymPy prints it for NumPy, M solved for in every call."""
    functions = vehicle.functions()
    c = functions.vehicle.composition
    chain, _, _ = c.chain
    rest = dict.fromkeys(c.nu_dot, sm.Integer(0))
    mass = -c.residual.jacobian(c.nu_dot)
    forcing = c.residual.xreplace(rest).xreplace(dict(zip(c.signals.actuation, chain, strict=True)))
    groups = [[*c.eta, *c.nu], list(c.commands), [symbol(n) for n in functions.parameter_names]]
    evaluate = sm.lambdify(groups, [mass, forcing, c.pose_rate], modules=modules, cse=True)

    def x_dot(x: np.ndarray, u: np.ndarray, p: np.ndarray) -> np.ndarray:
        m, f, pose = evaluate(x, u, p)
        return np.concatenate([pose[:, 0], np.linalg.solve(m, f)[:, 0]])

    return x_dot


# --- beside others --------------------------------------------------------------------------------


def _data() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """States, one command, parameters, and x_dot by CasADi's virtual machine."""
    functions = vehicle.functions()
    x, u, p = vehicle.states(STATES), vehicle.commands(1)[0], np.array(functions.values())
    expected = np.array(functions.dynamics.map(STATES)(x.T, u, p, 0.0)).T
    return x, u, p, expected


def _apart(found: np.ndarray, expected: np.ndarray) -> float:
    scale = np.abs(expected).max(axis=1, keepdims=True)
    return float((np.abs(found - expected) / scale).max())


@pytest.mark.parametrize("who", [OURS, "hand-written C"])
def time_evaluation(speed: Speed, who: str, tmp_path: Path) -> None:
    x, u, p, expected = _data()
    run = _ours(vehicle.functions(), tmp_path, x, u, p) if who == OURS else _by_hand(tmp_path, x, u)
    speed(EVALUATION, who, run, calls=STATES, apart=_apart(run(), expected), limit=EXACT, rounds=4000)


def time_evaluation_in_python(speed: Speed) -> None:
    x, u, p, expected = _data()
    few, rates = 20, _in_python("numpy")
    found = np.array([rates(row, u, p) for row in x[:few]])
    apart = _apart(found, expected[:few])
    speed(EVALUATION, "SymPy lambdify, NumPy", lambda: rates(x[0], u, p), apart=apart, limit=EXACT)


def time_evaluation_in_the_virtual_machine(speed: Speed) -> None:
    x, u, p, expected = _data()
    mapped = vehicle.functions().dynamics.map(STATES)
    buffer, call = mapped.buffer()
    result = np.empty_like(x)
    given = [x, np.tile(u, (STATES, 1)), np.tile(p, (STATES, 1)), np.zeros(STATES)]
    for i, array in enumerate(given):
        buffer.set_arg(i, memoryview(array.data))
    buffer.set_res(0, memoryview(result.data))
    call()
    apart = _apart(result, expected)
    speed(EVALUATION, "CasADi virtual machine", call, calls=STATES, apart=apart, limit=EXACT, rounds=50)


# --- growth ---------------------------------------------------------------------------------------


def _of_size(effects: int, dofs: tuple[str, ...]) -> Vehicle:
    """A vehicle with the first so many effects of the catalogue that change how it moves."""
    rng = np.random.default_rng(3)
    thrusters = tuple(Thruster(f"T{k}", tuple(rng.uniform(-1, 1, 6).round(3))) for k in range(1, 9))
    names = tuple(t.name for t in thrusters)
    known = catalogue()
    first = ("rigid_body", "rigid_body_coriolis", "added_mass", "linear_damping", "restoring")
    others = [
        i
        for i, cls in known.items()
        if i not in first
        and not (cls.built_in or issubclass(cls, Measurement) or "control_surfaces" in cls.requires)
    ]
    chosen = [*first, *others][:effects]
    return Vehicle("grown", dofs, tuple(known[i](names) for i in chosen), {}, thrusters)


def _values(functions: Functions) -> np.ndarray:
    """A heavy, damped vehicle."""
    declared = functions.vehicle.declared_parameters
    names = [n for n in functions.parameter_names if n in declared]
    known = {n: -0.5 if declared[n].bounds[1] == 0 else 0.05 for n in names}
    heavy = {"m": 25.0, "I_x": 7.0, "I_y": 8.0, "I_z": 9.0, "rho": 1000.0, "g": 9.81, "T_lag": 0.5}
    return np.array([(known | heavy | {"T_memory": 2.0})[n] for n in functions.parameter_names])


def _time_growth(speed: Speed, what: str, model: Vehicle, size: int, folder: Path) -> None:
    functions = Functions(model)
    p = _values(functions)
    x = np.random.default_rng(4).uniform(-0.5, 0.5, (STATES, len(functions.state_names)))
    u = np.linspace(-1, 1, functions.u.numel())
    run = _ours(functions, folder, x, u, p)
    expected = np.array(functions.dynamics.map(STATES)(x.T, u, p, 0.0)).T
    speed(what, OURS, run, calls=STATES, apart=_apart(run(), expected), limit=EXACT, size=size, rounds=50)


@pytest.mark.parametrize("effects", [5, 10, 20, 30, 40])
def time_evaluation_by_effects(speed: Speed, effects: int, tmp_path: Path) -> None:
    model = _of_size(effects, DOFS)
    _time_growth(speed, _GROWTH_EFFECTS, model, len(model.effects), tmp_path)


@pytest.mark.parametrize("dofs", [DOFS[:1], (*DOFS[:2], DOFS[5]), (*DOFS[:3], DOFS[5]), DOFS], ids=len)
def time_evaluation_by_degrees_of_freedom(speed: Speed, dofs: tuple[str, ...], tmp_path: Path) -> None:
    model = replace(vehicle.vehicle(), degrees_of_freedom=dofs)
    _time_growth(speed, _GROWTH_DOFS, model, len(dofs), tmp_path)
