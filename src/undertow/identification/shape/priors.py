"""Added mass and radiation damping as priors of a vehicle."""

from __future__ import annotations

import numpy as np

from undertow.model.effects.added_mass import AddedMass as AddedMassEffect
from undertow.model.effects.added_mass_coupling import AddedMassCoupling
from undertow.model.effects.linear_damping import LinearDamping
from undertow.model.symbols import FORCE, VELOCITY
from undertow.model.vehicle import Value, Vehicle
from undertow.typing import Array

from .bodies import AddedMass
from .panels import Radiation

#: What potential flow and an ideal shape leave open, as a share of the added mass.
FLOOR = 0.10
# What waves at one frequency say of linear damping at all others, as a share.
_DAMPING_FLOOR = 0.5
# Couplings that are smaller than this share of the two motions they couple are left out.
_SMALL = 0.01
# What moves no ideal fluid moves some real water: this share of the largest of its kind stands for it.
_LEAST = 0.02


def sigma_of(added: AddedMass, floor: float = FLOOR) -> Array:
    """Standard deviations of a prior, shape (6, 6): its error, and a share of the two motions it couples."""
    return np.hypot(added.error, floor * _scales(added.matrix))


def _scales(matrix: Array) -> Array:
    own = np.maximum(np.diag(matrix), 0.0)
    least = _LEAST * np.repeat(own.reshape(2, 3).max(axis=1), 3)
    root = np.sqrt(np.maximum(own, np.maximum(least, 1e-12)))
    return np.asarray(np.outer(root, root))


def coupled(matrix: Array) -> list[tuple[int, int]]:
    """Places above the diagonal of couplings that matter."""
    scales = _scales(matrix)
    return [(i, j) for i in range(6) for j in range(i + 1, 6) if abs(matrix[i, j]) > _SMALL * scales[i, j]]


def entry(added: AddedMass, i: int, j: int) -> float:
    """An entry of the matrix; what rounding has made negative on the diagonal is zero."""
    value = float(added.matrix[i, j])
    return max(value, 0.0) if i == j else value


def derivative(i: int, j: int) -> str:
    """SNAME name of an entry of the added mass: `derivative(0, 0)` is X_udot."""
    return f"{FORCE[i]}_{VELOCITY[j]}dot"


def with_added_mass(vehicle: Vehicle, added: AddedMass, *, floor: float = FLOOR) -> Vehicle:
    """The vehicle with this added mass as prior: `X_udot` and so on to be estimated, with their sigma.

    Parameters
    ----------
    vehicle : Vehicle
        What it had before for these is replaced, also where that differed forward and backward.
    added : AddedMass
        About the origin of the vehicle.
    floor : float
        Share of the values by which the prior may be off at least.
    """
    sigma, own = sigma_of(added, floor), vehicle.dof_indices
    diagonal = {derivative(i, i): (i, i) for i in own}
    pairs = {(i, j) for i, j in coupled(added.matrix) if i in own and j in own}
    stated = {(i, j) for i in own for j in own if i < j and derivative(i, j) in vehicle.values}
    off = {derivative(i, j): (i, j) for i, j in sorted(pairs | stated)}
    for cls, names, estimate in ((AddedMassEffect, diagonal, True), (AddedMassCoupling, off, False)):
        values = {
            key: _prior(entry(added, *at), estimate, float(sigma[at]), added.source)
            for name, at in names.items()
            for key in _keys(vehicle, name)
        }
        vehicle = vehicle.with_effect(cls, values) if values else vehicle
    return vehicle


def _prior(added: float, estimate: bool, sigma: float, source: str) -> Value:
    """A sphere that spins moves nothing, and there is nothing to be estimated."""
    return Value(0.0 - added, estimate, sigma, source) if added or sigma > 1e-9 else Value(0.0, source=source)


def with_radiation(vehicle: Vehicle, radiation: Radiation, source: str) -> Vehicle:
    """The vehicle with radiation damping at one frequency as prior of its linear damping."""
    damping = np.diag(radiation.damping)
    names = {f"{FORCE[i]}_{VELOCITY[i]}": i for i in vehicle.dof_indices if damping[i] > 0}
    told = f"radiation damping at {radiation.omega:g} rad/s; {source}"
    values = {
        key: Value(
            -float(damping[i]),
            True,
            float(np.hypot(radiation.error[i, i], _DAMPING_FLOOR * damping[i])),
            told,
        )
        for name, i in names.items()
        for key in _keys(vehicle, name)
    }
    return vehicle.with_effect(LinearDamping, values)


def _keys(vehicle: Vehicle, name: str) -> list[str]:
    ways = [f"{name}_{way}" for way in ("forward", "backward")]
    return ways if ways[0] in vehicle.values else [name]
