"""What a call of f from Python costs, as `undertow linearize` makes it."""

from __future__ import annotations

import numpy as np

from undertow.codegen.compiler import Evaluator

from . import vehicle
from .conftest import Speed
from .goals import CALL, OURS

EXACT = 1e-12


def _point() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return vehicle.states(1)[0], vehicle.commands(1)[0], np.array(vehicle.functions().values())


def _apart(found: np.ndarray) -> float:
    x, u, p = _point()
    expected = np.array(vehicle.functions().dynamics(x, u, p, 0.0)).ravel()
    return float(np.abs(found - expected).max() / np.abs(expected).max())


def time_evaluator_call(speed: Speed) -> None:
    evaluator = Evaluator(vehicle.functions().dynamics)
    x, u, p = _point()
    found = evaluator(x, u, p, 0.0)[0].ravel()
    speed(CALL, OURS, lambda: evaluator(x, u, p, 0.0), apart=_apart(found), limit=EXACT)


def time_function_call(speed: Speed) -> None:
    dynamics = vehicle.functions().dynamics
    x, u, p = _point()
    found = np.array(dynamics(x, u, p, 0.0)).ravel()
    speed(
        CALL,
        "CasADi Function.__call__",
        lambda: dynamics(x, u, p, 0.0),
        apart=_apart(found),
        limit=EXACT,
    )
