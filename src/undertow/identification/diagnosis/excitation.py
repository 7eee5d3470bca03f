"""Whether anything happened in the logs that a model could be fitted to."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle

from ..logs import Run

# Noise alone has a standard deviation of once its own; a velocity below this many times that was not moved.
_EXCITED = 2.0


def check_excitation(vehicle: Vehicle, runs: Sequence[Run], sigma: NDArray[np.float64]) -> None:
    """Refuse logs in which no velocity of the vehicle stands out of its noise.

    Parameters
    ----------
    vehicle : Vehicle
        Whose velocities are looked at.
    runs : sequence of Run
        Logs that hold them.
    sigma : (2n,) array
        Noise of the channels, pose then velocity of the degrees of freedom, in their units.

    Raises
    ------
    UndertowError
        If nothing moves; the velocities are told with their noise.
    """
    noise = dict(zip((*vehicle.pose_names, *vehicle.velocity_names), sigma, strict=True))
    largest = {n: max(float(np.nanstd(r.channels[n])) for r in runs) for n in vehicle.velocity_names}
    if all(largest[n] < _EXCITED * noise[n] or largest[n] == 0.0 for n in largest):
        seen = ", ".join(f"{n} {v:.2g} (noise {noise[n]:.2g})" for n, v in largest.items())
        raise UndertowError(
            f"nothing moves in these logs: standard deviation of {seen}; "
            "log a manoeuvre in which the vehicle moves"
        )
