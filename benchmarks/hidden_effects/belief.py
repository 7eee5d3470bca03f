"""What a user believes beforehand: the vehicle file of a case, as a plain dictionary."""

from __future__ import annotations

from typing import Any

import numpy as np

from .drawing import MOTIONS, Vehicle
from .vehicles import GUESS_SPREAD
from .world import World, derivative, quadratic_name

Table = dict[str, Any]


def hydrodynamic_values(world: World) -> dict[str, dict[str, float]]:
    """True added mass and damping that the prior model may hold: effect -> parameter -> value (SNAME)."""
    dofs, vehicle = world.dofs, world.vehicle
    return {
        "added_mass": {derivative(i, i, mark="dot"): -world.added_mass[i, i] for i in dofs},
        "linear_damping": {derivative(i, i): world.linear[i, i] for i in dofs},
        "quadratic_damping": {quadratic_name(i): world.quadratic[i, i] for i in dofs if vehicle.quadratic[i]},
    }


def prior_vehicle(world: World, rng: np.random.Generator) -> Table:
    """The prior model: rigid body, restoring and allocation exact, added mass and damping good to 15%.

    What is in `world.left_out` is absent; guesses in `world.misjudged` are wrong by that factor.
    """
    effects = {"rigid_body": rigid_body_table(world.vehicle), "rigid_body_coriolis": {}}
    for name, values in hydrodynamic_values(world).items():
        effects[name] = {p: _guess(p, v, world, rng) for p, v in values.items()}
        if name == "added_mass":
            effects["added_mass_coriolis"] = {}
    effects["restoring"] = restoring_table(world.vehicle)
    return vehicle_table(world.vehicle, _without(effects, world.left_out))


def _guess(name: str, true: float, world: World, rng: np.random.Generator) -> Table:
    """A value to be refitted, with the standard deviation a user would state for it."""
    value = true * rng.uniform(1 - GUESS_SPREAD, 1 + GUESS_SPREAD) * world.misjudged.get(name, 1.0)
    return estimated(float(value))


def estimated(value: float) -> Table:
    """An entry that is to be refitted from a guess good to 15%."""
    value = float(f"{value:.4g}")
    sigma = float(f"{GUESS_SPREAD * abs(value):.3g}")
    return {"value": value, "estimate": True, "sigma": sigma, "source": "guess, good to 15%"}


def _without(effects: dict[str, Table], left_out: set[str]) -> dict[str, Table]:
    """The effects without what is left out; an effect that loses all its parameters goes too."""
    kept = {}
    for name, table in effects.items():
        rest = {key: value for key, value in table.items() if key not in left_out}
        if name not in left_out and (rest or not table):
            kept[name] = rest
    return kept


def rigid_body_table(vehicle: Vehicle) -> Table:
    """Mass (kg), centre of gravity (m), moments of inertia (kg m^2, about the origin) that matter to it."""
    table = {"m": vehicle.mass, "x_g": float(vehicle.r_g[0]), "y_g": float(vehicle.r_g[1])}
    if vehicle.tilts:
        table["z_g"] = float(vehicle.r_g[2])
    return table | {
        f"I_{'xyz'[i - 3]}": float(vehicle.inertia[i - 3]) for i in (3, 4, 5) if i in vehicle.dofs
    }


def restoring_table(vehicle: Vehicle) -> Table:
    """Buoyancy (N) and its centre (m); nothing for a vehicle that neither heaves nor tilts.

    Weight and centre of gravity are those of the rigid body.
    """
    if not {2, 3, 4} & set(vehicle.dofs):
        return {"absent": True}
    return {"B": vehicle.weight} | {f"{a}_b": float(r) for a, r in zip("xyz", vehicle.r_b, strict=True)}


def vehicle_table(vehicle: Vehicle, effects: dict[str, Table]) -> Table:
    """The whole vehicle file."""
    rotors = zip(vehicle.thrusters, vehicle.allocation.T, strict=True)
    return {
        "schema": "undertow/vehicle/1",
        "name": vehicle.name,
        "degrees_of_freedom": [MOTIONS[i] for i in vehicle.dofs],
        "signs": "sname",
        "effects": {name: table for name, table in effects.items() if "absent" not in table},
        "thrusters": [
            {
                "name": name,
                "wrench": column.tolist(),
                "limit": vehicle.command_limit,
            }
            for name, column in rotors
        ],
    }
