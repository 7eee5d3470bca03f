"""The directions in which a manoeuvre may drive a vehicle: its motions, or its actuators one by one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from scipy.optimize import lsq_linear

from undertow.codegen.functions import Functions
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

# A pure motion counts as possible when what is left of the wrench is this share of it.
_PURE = 1e-6
_TRIM_ROUNDS = 8
# Share of the limit of an actuator that balancing the weight may take.
_TRIM_SHARE = 0.95
_VERTICAL = ("heave", "roll", "pitch")


@dataclass(frozen=True)
class Axis:
    """One direction in the space of commands.

    Attributes
    ----------
    name : str
        A degree of freedom, or a command.
    pattern : (k,) array
        Commands at full deflection.
    """

    name: str
    pattern: Array


def allocation(vehicle: Vehicle) -> Array:
    """Wrench of one unit of every command in the vehicle's degrees of freedom, shape (n, k), nominal."""
    rows = list(vehicle.dof_indices)
    columns = [np.array(t.wrench)[rows] * t.thrust_per_command.value for t in vehicle.thrusters]
    for channel in vehicle.force_channels:
        columns.append(np.eye(6)["XYZKMN".index(channel[-1])][rows])
    return np.array(columns).T.reshape(len(rows), -1)


def motion_axes(vehicle: Vehicle, room: Array) -> list[Axis]:
    """For every degree of freedom that the actuators can push alone: the commands that do so."""
    table = allocation(vehicle) * room
    scale = np.max(np.abs(table), axis=1)
    found = []
    for i, name in enumerate(vehicle.degrees_of_freedom):
        pattern = _alone(table, scale, i)
        if pattern is not None:
            found.append(Axis(name, room * pattern))
    return found


def _alone(table: Array, scale: Array, i: int) -> Array | None:
    if not scale[i] > 0:
        return None
    rows = np.flatnonzero(scale > 0)
    scaled = table[rows] / scale[rows, None]
    target = (rows == i).astype(float)
    pattern = np.linalg.lstsq(scaled, target, rcond=1e-9)[0]
    if np.linalg.norm(scaled @ pattern - target) > _PURE:
        return None
    pattern[np.abs(pattern) < 1e-9 * np.max(np.abs(pattern))] = 0.0
    return np.asarray(pattern / np.max(np.abs(pattern)))


def actuator_axes(vehicle: Vehicle, room: Array) -> list[Axis]:
    """Every command that acts on a motion of the vehicle, on its own."""
    moves = np.any(allocation(vehicle) != 0, axis=0)
    units = np.diag(room)
    return [Axis(n, units[i]) for i, n in enumerate(vehicle.command_names) if moves[i]]


@dataclass(frozen=True)
class Trim:
    """Commands that hold a vehicle at rest against weight and buoyancy.

    Attributes
    ----------
    commands : (k,) array
        In the unit of the commands.
    left : dict of float
        Force or moment that the actuators cannot balance, by degree of freedom, N or N m.
    """

    commands: Array
    left: dict[str, float]


def trim(functions: Functions, limits: Array, depth: float = 0.0) -> Trim:
    """Balance heave, roll and pitch at rest and level, without pushing any other way.

    Parameters
    ----------
    functions : Functions
        The model, with the vehicle's values.
    limits : (k,) array
        Largest commands.
    depth : float
        Depth at which the vehicle rests, m.
    """
    vehicle = functions.vehicle
    rows = [i for i, d in enumerate(vehicle.degrees_of_freedom) if d in _VERTICAL]
    commands = np.zeros(len(limits))
    if not rows or not len(limits):
        return Trim(commands, {})
    at_rest, table = _at_rest(functions, depth), allocation(vehicle)
    size = np.maximum(np.abs(table) @ limits, 1e-12)
    scaled = table * limits / size[:, None]
    for _ in range(_TRIM_ROUNDS):
        wanted = np.zeros(len(table))
        wanted[rows] = (table @ commands - at_rest(commands))[rows] / size[rows]
        commands = lsq_linear(scaled, wanted, (-_TRIM_SHARE, _TRIM_SHARE)).x * limits
    commands[np.abs(commands) < 1e-6 * limits] = 0.0
    rest = at_rest(commands)
    free = {vehicle.degrees_of_freedom[i]: float(rest[i]) for i in rows if abs(rest[i]) > 1e-3 * size[i]}
    return Trim(commands, free)


def _at_rest(functions: Functions, depth: float) -> Callable[[Array], Array]:
    """Force and moment left over at rest, level, with commands that have been held for long."""
    f = functions
    u = ca.MX.sym("u", f.u.numel())
    motion = np.zeros(f.eta.numel() + f.nu.numel() + f.memory.numel())
    if "z" in f.vehicle.pose_names:
        motion[f.vehicle.pose_names.index("z")] = depth
    p = np.array(f.values(), dtype=float)
    state = ca.vertcat(ca.DM(motion), f.rest(u, p, 0.0))
    force = ca.Function("force", [u], [f.residual_function(state, np.zeros(f.nu.numel()), u, p, 0.0)])
    return lambda commands: np.array(force(commands)).ravel()
