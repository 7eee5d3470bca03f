"""Natural sizes of parameters: what a vehicle's mass, inertia and length allow them to be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf, isfinite, sqrt

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.model.effect import VehicleSize
from undertow.model.parameter import Limits, Parameter
from undertow.model.units import dimension
from undertow.model.vehicle import Vehicle
from undertow.typing import Array


@dataclass(frozen=True)
class ScaleSettings:
    """Numbers by which the size of a vehicle becomes a weak prior of its parameters."""

    # Standard deviation of the default prior, as a share of the largest value that counts as possible: 0.6
    # for added mass in units of the inertia. Like a stated one it is widened by `StepSettings.prior_width`:
    # what data determine moves by a hundredth of its standard error or less.
    deviation: float = 0.06


SETTINGS = ScaleSettings()
_LIMITS = Limits()


def largest_values(functions: Functions, names: Sequence[str]) -> Array:
    """Largest magnitude of parameters that a vehicle of this size allows, SI; infinite where it says nothing.

    That is `Parameter.within` times the natural size: the product of powers of the vehicle's mass, length
    and the time sqrt(length / g) that has the parameter's unit. The length is the edge of a cube of water as
    heavy as the vehicle or its radius of gyration, whichever is larger; for a coefficient of moments alone
    the square of the length is that of the radius of gyration about these axes. A stated value that is larger
    counts as the size itself; one that a fit has found does not, lest every fit go ten times as far as the
    last.
    """
    vehicle = functions.vehicle
    known = {n: v.value for n, v in vehicle.values.items()} | dict(vehicle.environment)
    size = next((b for e in vehicle.effects if (b := e.vehicle_size(known)) is not None), None)
    if size is None or not names:
        return np.full(len(names), inf)
    acts = _acts(functions, names)
    return np.array([_largest(vehicle, n, size, known, rows) for n, rows in zip(names, acts, strict=True)])


def scale_directions(functions: Functions, names: Sequence[str], p: Array) -> dict[str, Array]:
    """By degree of freedom, the change of free parameters that makes all of its forces larger by one share.

    Its inertia grows with them, so that the motion stays the same, unless a force in it is known. Degrees of
    freedom whose inertia is known are left out. Entries of a direction (k,) are in the order of `names`.
    """
    f = functions
    places = [f.parameter_names.index(n) for n in names]
    acts = _acts(f, names) if names else []
    inertia = ca.diag(f.mass_matrix)
    at_rest = [ca.SX.zeros(x.shape) for x in (f.eta, f.nu, f.t)]
    inertia = ca.substitute(inertia, ca.vertcat(f.eta, f.nu, f.t), ca.vertcat(*at_rest))
    outputs = [ca.densify(inertia), ca.densify(ca.jacobian(inertia, f.p))]
    mass, slope = (np.asarray(v) for v in ca.Function("inertia", [f.p], outputs)(p))
    found = {}
    for i, (dof, place) in enumerate(zip(f.vehicle.degrees_of_freedom, f.vehicle.dof_indices, strict=True)):
        own = np.array([rows == {place} for rows in acts], dtype=float)
        share = slope[i, places] * own
        if np.any(share):
            still = np.where(share != 0.0, 0.0, p[places]) * own
            found[dof] = still + share * mass[i, 0] / float(share @ share)
    return found


def _acts(functions: Functions, names: Sequence[str]) -> list[set[int]]:
    """Which motions, of the six, each parameter acts on directly."""
    free = ca.vertcat(*[functions.p[functions.parameter_names.index(n)] for n in names])
    pattern = ca.jacobian_sparsity(functions.residual, free)
    found: list[set[int]] = [set() for _ in names]
    for row, column in zip(pattern.row(), pattern.get_col(), strict=True):
        found[column].add(functions.vehicle.dof_indices[row])
    return found


def _largest(
    vehicle: Vehicle, name: str, size: VehicleSize, known: dict[str, float], rows: set[int]
) -> float:
    parameter, stated = vehicle.declaration(name), abs(vehicle.value_of(name).value)
    natural = _natural_size(parameter, size, known, rows)
    if not natural or not isfinite(stated):
        return inf
    within = _LIMITS.farthest if parameter.arm_of else parameter.within
    return max(within * natural, stated) if name in vehicle.fitted_to else within * max(natural, stated)


def _natural_size(parameter: Parameter, size: VehicleSize, known: dict[str, float], rows: set[int]) -> float:
    """Natural size of a parameter; zero where the vehicle says nothing of it."""
    length = max(size.length, size.gyration)
    if parameter.arm_of:
        return length * (1.0 if parameter.arm_of == "1" else known.get(parameter.arm_of, 0.0))
    # What has a place to begin a search, or two bounds, is a shape, whose declaration says all there is.
    if not parameter.linear or all(map(isfinite, parameter.bounds)):
        return 0.0
    powers = {str(base): float(str(power)) for base, power in dimension(parameter.unit).items()}
    if set(powers) - {"[mass]", "[length]", "[time]"}:
        return 0.0
    seconds = sqrt(length / known["g"])
    mass, arm, time = (powers.get(f"[{base}]", 0.0) for base in ("mass", "length", "time"))
    whole = size.mass**mass * length**arm * seconds**time
    return whole * (_gyration(size.mass, known, rows) / length) ** 2 if rows and min(rows) > 2 else whole


def _gyration(mass: float, known: dict[str, float], rows: set[int]) -> float:
    """Largest radius of gyration about the axes of these moments, m."""
    return sqrt(max(known.get(f"I_{'xyz'[row - 3]}", 0.0) for row in rows) / mass)
