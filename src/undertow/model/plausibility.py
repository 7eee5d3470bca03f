"""What must hold for a vehicle as a whole, once its file has been read."""

from __future__ import annotations

import sympy as sm

from undertow.errors import UndertowError

from .laws import failing_pivot
from .symbols import DOFS, FORCE, POSE, VELOCITY, symbol
from .vehicle import Vehicle

CHANNELS = {"t", *POSE, *VELOCITY, *(f"tau_{f}" for f in FORCE)}
_ROUNDING = 1e-12


def check_vehicle(vehicle: Vehicle) -> None:
    """Refuse a vehicle that cannot be.

    Raises
    ------
    UndertowError
        If thrusters share a name with another or with a log channel, a known force acts on a motion that the
        vehicle does not have, a value is missing that no vehicle lacks, density or gravity are not
        positive, or the mass matrix is not positive definite at the values of the file.
    """
    _check_names(vehicle)
    _check_environment(vehicle)
    _check_forces(vehicle)
    _check_complete(vehicle)
    _check_inertia(vehicle)


def _check_names(vehicle: Vehicle) -> None:
    names = [t.name for t in vehicle.thrusters]
    for name in names:
        if names.count(name) > 1:
            raise UndertowError(f"two thrusters are called '{name}': rename one")
        if name in CHANNELS:
            raise UndertowError(f"thruster '{name}' has the name of a measured channel: rename it")


def _check_environment(vehicle: Vehicle) -> None:
    for key, name in (("water_density", "rho"), ("gravity", "g")):
        value = vehicle.environment[name]
        if value <= 0:
            raise UndertowError(f"{key} = {value:g} cannot be: give a positive value")


def _check_forces(vehicle: Vehicle) -> None:
    for channel in vehicle.force_channels:
        dof = DOFS[FORCE.index(channel.removeprefix("tau_"))]
        if dof not in vehicle.degrees_of_freedom:
            raise UndertowError(
                f"generalised_forces has {channel}, but {dof} is no degree of freedom: add {dof} or remove it"
            )


def _check_complete(vehicle: Vehicle) -> None:
    for name in vehicle.parameter_names:
        parameter = vehicle.declared_parameters.get(name)
        if parameter is not None and parameter.required and name not in vehicle.values:
            owner = next(e.id for e in vehicle.effects if any(p.name == name for p in e.parameters))
            raise UndertowError(
                f"[effects.{owner}] lacks {name} ({parameter.about}): give it in {parameter.unit}"
            )
    if not vehicle.mass_matrix.free_symbols:
        raise UndertowError("the vehicle has no inertia: add [effects.rigid_body]")


def _check_inertia(vehicle: Vehicle) -> None:
    """Static moments and products of inertia have no bounds of their own; the whole matrix has."""
    for direction, way in ((1, "forward"), (-1, "backward")):
        rows = mass_matrix_at(vehicle, direction)
        trace = sum(rows[i][i] for i in range(len(rows)))
        pivot = failing_pivot(rows, -_ROUNDING * abs(trace))
        if pivot is not None:
            dof, value = vehicle.degrees_of_freedom[pivot], rows[pivot][pivot]
            if value == 0:
                raise UndertowError(
                    f"nothing has inertia in {dof}: add it to [effects.rigid_body] or leave {dof} out"
                )
            raise UndertowError(
                f"the mass matrix is not positive definite in {way} motion: its entry for {dof}, {value:g}, "
                f"is too little for its couplings; check centre of gravity, inertias and added mass"
            )


def mass_matrix_at(vehicle: Vehicle, direction: int = 1) -> list[list[float]]:
    """Mass matrix at the vehicle's values, upright, moving at `direction` m/s (rad/s) along every axis.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    direction : int
        1 for forward, -1 for backward values of coefficients that differ.

    Returns
    -------
    list of list of float, shape (n, n)
        kg, kg m and kg m^2.
    """
    matrix = vehicle.mass_matrix
    values = {symbol(n): sm.Float(vehicle.value_of(n).value) for n in vehicle.parameter_names}
    values |= dict.fromkeys(vehicle.composition.nu, sm.Integer(direction))
    values |= {x: sm.Integer(0) for x in matrix.free_symbols if x not in values}
    return [[float(matrix[i, j].subs(values)) for j in range(matrix.cols)] for i in range(matrix.rows)]
