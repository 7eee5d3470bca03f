"""The vehicle that speed is measured on: six degrees of freedom, full added mass and damping."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from undertow.codegen import Functions
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle

MORE = ("added_mass_coupling", "linear_damping_coupling", "ocean_current")
_SEED = 0
# Share of the geometric mean of two diagonal entries that an entry between them has at most.
_COUPLED = 0.05


@cache
def vehicle() -> Vehicle:
    """BlueROV2 with every entry of M_A and D filled in, in a current."""
    base = load_vehicle("bluerov2")
    names = tuple(t.name for t in base.thrusters)
    more = tuple(catalogue()[i](names) for i in MORE)
    random = np.random.default_rng(_SEED)
    values = dict(base.values)
    for effect in more:
        for name in (p.name for p in effect.parameters):
            values[name] = Value(float(random.uniform(-_COUPLED, _COUPLED)))
    return replace(base, name="full", effects=(*base.effects, *more), values=values)


@cache
def functions() -> Functions:
    """Its CasADi functions."""
    return Functions(vehicle())


def states(n: int) -> np.ndarray:
    """Random states well inside what the vehicle does, shape (n, 12): m, rad, m/s, rad/s."""
    return np.random.default_rng(_SEED + 1).uniform(-0.5, 0.5, (n, len(functions().state_names)))


def commands(n: int) -> np.ndarray:
    """Random commands, shape (n, 8)."""
    return np.random.default_rng(_SEED + 2).uniform(-10, 10, (n, functions().u.numel()))
