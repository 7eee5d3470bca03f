"""Noise of the channels that a planned log will have: as stated, as in the logs, or assumed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Run
from ..logs.run import UNITS
from ..weak.data import channel_noise

ASSUMED = {"m": 0.02, "rad": 0.01, "m/s": 0.01, "rad/s": 0.005}
"""Standard deviation by unit where nothing is known: a small vehicle with DVL, gyro and acoustic position."""


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of the 2n channels of a vehicle.

    Attributes
    ----------
    names : tuple of str
        Pose, then velocity.
    sigma : (2n,) array
        Standard deviation of the white noise of a sample, SI; inf for a channel that is not measured.
    source : tuple of str
        Where each comes from.
    derived : frozenset of str
        Velocities that will be taken from the pose.
    """

    names: tuple[str, ...]
    sigma: Array
    source: tuple[str, ...]
    derived: frozenset[str] = frozenset()

    @property
    def finite(self) -> Array:
        """The noise; what is assumed where nothing is measured."""
        assumed = [ASSUMED[UNITS[n]] for n in self.names]
        return np.where(np.isfinite(self.sigma), self.sigma, assumed)


def planned_noise(vehicle: Vehicle, asked: Mapping[str, float], runs: Sequence[Run]) -> ChannelNoise:
    """Noise of every channel of a log to come.

    Parameters
    ----------
    vehicle : Vehicle
        Whose channels these are.
    asked : mapping
        Standard deviations by name of the channel, SI; inf for one that is not measured.
    runs : sequence of Run
        Logs; a pose that they lack counts as not measured, and velocities are taken from the pose if they
        were in the logs.

    Raises
    ------
    UndertowError
        If a channel is unknown, its noise is not positive, or a velocity is not measured.
    """
    names = (*vehicle.pose_names, *vehicle.velocity_names)
    for name, value in asked.items():
        if name not in names:
            raise UndertowError(f"--noise names '{name}', which is no channel: there are {', '.join(names)}")
        if not value > 0:
            raise UndertowError(f"--noise {name} = {value:g} is no noise: give a positive standard deviation")
    found = [_noise(n, asked, runs) for n in names]
    sigma = np.array([s for s, _ in found])
    for name in vehicle.velocity_names:
        if not np.isfinite(sigma[names.index(name)]):
            raise UndertowError(
                f"--noise {name}=none: no plan without velocities; give the noise of '{name}' as it is taken "
                "from the pose, or logs that hold the pose alone"
            )
    derived = frozenset(name for run in runs for name in run.derived)
    return ChannelNoise(names, sigma, tuple(source for _, source in found), derived)


def _noise(name: str, asked: Mapping[str, float], runs: Sequence[Run]) -> tuple[float, str]:
    if name in asked:
        return asked[name], "as given" if np.isfinite(asked[name]) else "not measured"
    with_it = [r for r in runs if r.has(name)]
    if runs and not with_it:
        return float("inf"), "not in the logs"
    estimated = float(channel_noise(with_it, [name])[0])
    if not estimated > 0:
        return ASSUMED[UNITS[name]], "assumed"
    taken = any(name in r.derived for r in with_it)
    return estimated, "taken from the pose" if taken else "from the logs"
