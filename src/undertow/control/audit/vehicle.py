"""The equations of a vehicle: power, symmetry, dissipation, inertia, and what its file leaves open."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import sympy as sm

from undertow.control.conditions.case import SignSet, sign_sets
from undertow.control.plant import Plant
from undertow.model.effect import Wrench
from undertow.model.evaluation import function_of
from undertow.model.hints import hints
from undertow.model.symbols import symbol
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .discrepancy import OPEN, WRONG, Discrepancy

_TRIALS, _SEED, _ROUNDING = 200, 20210405, 1e-9


def audit_vehicle(vehicle: Vehicle) -> list[Discrepancy]:
    """Everything that does not fit in the equations of a vehicle, and what its file leaves open.

    Parameters
    ----------
    vehicle : Vehicle
        A vehicle as its file has it.

    Raises
    ------
    UndertowError
        If its mass matrix is not positive definite.
    """
    plant = Plant(vehicle)
    return [
        *_symmetry(plant),
        *_skew(plant),
        *_definite(plant),
        *_power(vehicle),
        *(
            Discrepancy(OPEN, "vehicle file", hint, "what the file states and what it does not")
            for hint in hints(vehicle)
        ),
        *(Discrepancy(OPEN, i, "is in none of the matrices", reason) for i, reason in plant.left_out.items()),
    ]


def _symmetry(plant: Plant) -> Iterator[Discrepancy]:
    difference = (plant.M - plant.M.T).applyfunc(sm.expand)
    if not difference.is_zero_matrix:
        yield Discrepancy(WRONG, "M", "the mass matrix is not symmetric", f"M - M' has {_first(difference)}")


def _skew(plant: Plant) -> Iterator[Discrepancy]:
    """With C skew-symmetric, d(M_q)/dt - 2 C_q is so as well, whatever J."""
    total = (plant.C + plant.C.T).applyfunc(sm.expand)
    if not total.is_zero_matrix:
        yield Discrepancy(
            WRONG, "C", "no skew-symmetric C gives the Coriolis force", f"C + C' has {_first(total)}"
        )


def _first(matrix: sm.Matrix) -> str:
    i, j = next((i, j) for i in range(matrix.rows) for j in range(matrix.cols) if matrix[i, j] != 0)
    return f"{matrix[i, j]} in row {i + 1}, column {j + 1}"


def _definite(plant: Plant) -> Iterator[Discrepancy]:
    for one in sign_sets(plant):
        yield from _damping(plant, one)


def _damping(plant: Plant, one: SignSet) -> Iterator[Discrepancy]:
    symmetric = 0.5 * (one.damping + one.damping.T)
    values, vectors = np.linalg.eigh(symmetric)
    if values[0] < -_ROUNDING * max(1.0, abs(values[-1])):
        of = f" ({one.name})" if one.name else ""
        along = ", ".join(
            f"{v} = {x:.3g}" for v, x in zip(plant.nu, vectors[:, 0], strict=True) if abs(x) > 1e-3
        )
        yield Discrepancy(
            WRONG,
            "D",
            f"damping at rest{of} feeds energy into a motion",
            f"nu' D nu = {values[0]:.4g} for {along}",
        )


def _power(vehicle: Vehicle) -> Iterator[Discrepancy]:
    """Power of each effect at random states: none where it is workless, none above zero if dissipative."""
    powers = vehicle.power()
    for effect in vehicle.effects:
        if not isinstance(effect, Wrench) or not (effect.workless or effect.dissipative):
            continue
        values = _at_random(powers[effect.id], vehicle)
        values = values[np.isfinite(values)]
        limit = _ROUNDING * max(1.0, float(np.abs(values).max(initial=0.0)))
        if effect.workless and np.abs(values).max(initial=0.0) > _ROUNDING * 1e3:
            worst = float(values[np.abs(values).argmax()])
            yield Discrepancy(
                WRONG, effect.id, "claims to do no work but does", f"{worst:.4g} W at a random state"
            )
        if effect.dissipative and values.max(initial=0.0) > limit:
            yield Discrepancy(
                WRONG,
                effect.id,
                "claims to take energy but feeds it in with the values of the file",
                f"{float(values.max()):.4g} W at a random state, of {_TRIALS}",
            )


def _at_random(power: sm.Expr, vehicle: Vehicle) -> Array:
    known = {symbol(n): sm.Float(vehicle.value_of(n).value) for n in vehicle.parameter_names}
    filled = power.xreplace(known)
    names = sorted(filled.free_symbols, key=str)
    if not names:
        return np.array([float(filled)])
    generator = np.random.default_rng(_SEED)
    function = function_of(names, filled, "numpy")
    with np.errstate(all="ignore"):
        found = function(*generator.uniform(-1.0, 1.0, (len(names), _TRIALS)))
    return np.atleast_1d(np.asarray(found, dtype=float))
