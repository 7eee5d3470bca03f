"""The residual force against a variable: means over bins with their standard errors."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from undertow.identification.logs.run import UNITS
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .forces import Forces

BINS = 12
_FEWEST = 12
# Sum of the correlations between test functions under a white disturbance.
CORRELATED = 2.1


@dataclass(frozen=True)
class Profile:
    """Mean residual force over bins of one variable.

    Attributes
    ----------
    degree_of_freedom, variable, unit : str
        What is plotted against what; `unit` is the variable's.
    centre : (bins,) array
        Mean of the variable in each bin.
    force, error : (bins,) array
        Mean residual force and its standard error, N or N m.
    count : (bins,) array
        Test functions in each bin.
    """

    degree_of_freedom: str
    variable: str
    unit: str
    centre: Array
    force: Array
    error: Array
    count: NDArray[np.intp]


def profiles(forces: Forces, vehicle: Vehicle, measured_pose: tuple[str, ...]) -> list[Profile]:
    """Residual force of every degree of freedom against every variable that varies.

    Parameters
    ----------
    forces : Forces
        Averages over test functions.
    vehicle : Vehicle
        Whose degrees of freedom are meant.
    measured_pose : tuple of str
        Pose channels that the logs have.
    """
    known = list(_variables(forces, vehicle, measured_pose))
    return [
        _profile(dof, name, unit, forces.missing[:, i], value)
        for i, dof in enumerate(vehicle.degrees_of_freedom)
        for name, unit, value in known
        if len(value) >= _FEWEST and np.ptp(value) > 0
    ]


def _variables(
    forces: Forces, vehicle: Vehicle, measured_pose: tuple[str, ...]
) -> Iterator[tuple[str, str, Array]]:
    for i, name in enumerate(vehicle.velocity_names):
        yield name, UNITS[name], forces.velocity[:, i]
    for i, name in enumerate(vehicle.pose_names):
        if name in measured_pose and name not in ("x", "y"):
            yield (
                name,
                UNITS[name],
                _principal(forces.pose[:, i]) if UNITS[name] == "rad" else forces.pose[:, i],
            )
    for i, name in enumerate(vehicle.command_names):
        yield name, UNITS.get(name, "command"), forces.commands[:, i]
    yield "t", "s", forces.t


def _principal(angle: Array) -> Array:
    """The angle between -pi and pi: a force depends on the heading, not on how often it went round."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _profile(dof: str, name: str, unit: str, force: Array, value: Array) -> Profile:
    bins = min(BINS, len(value) // _FEWEST)
    limits = np.unique(np.quantile(value, np.linspace(0, 1, bins + 1)[1:-1]))
    band = np.searchsorted(limits, value, side="right")
    groups = [np.flatnonzero(band == i) for i in range(len(limits) + 1)]
    groups = [g for g in groups if len(g) > 1]
    return Profile(
        dof,
        name,
        unit,
        np.array([value[g].mean() for g in groups]),
        np.array([force[g].mean() for g in groups]),
        np.array([force[g].std(ddof=1) * np.sqrt(CORRELATED / len(g)) for g in groups]),
        np.array([len(g) for g in groups], dtype=np.intp),
    )
