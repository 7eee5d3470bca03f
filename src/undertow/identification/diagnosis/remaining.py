"""What a model leaves unexplained in each degree of freedom, in newtons and against the noise."""

from __future__ import annotations

import numpy as np
import sympy as sm
from numpy.typing import NDArray

from undertow.model.symbols import FORCE_UNITS, symbol
from undertow.model.vehicle import Vehicle

from ..weak.data import WeakData
from ..weak.fit import WeakFit, mean_square
from .result import Remaining
from .trial import noise_ratio, only_noise

Array = NDArray[np.float64]


def remaining(fit: WeakFit, data: WeakData) -> list[Remaining]:
    """Residual of every force equation on kept-aside data.

    The rms is that of the force averaged under the test functions; the normalised error weighs slow
    parts, where there is little noise, as heavily as they deserve.
    """
    vehicle = fit.vehicle
    ratio = noise_ratio(fit, data)
    width = float(np.mean(np.concatenate([s.functions.held.sum(axis=1) for s in data.segments])))
    raw = np.concatenate([part.r for part in fit.model.linearise(data, fit.p)]) / width
    rms = np.sqrt(mean_square(raw, data))
    return [
        _left(vehicle, i, float(ratio[i]), float(rms[i]), _acceleration_noise(data, i, width))
        for i in range(len(vehicle.degrees_of_freedom))
    ]


def _left(vehicle: Vehicle, i: int, ratio: float, acceleration: float, noise: float) -> Remaining:
    inertia = _inertia(vehicle, i)
    quiet = only_noise(np.array([ratio]))
    return Remaining(
        degree_of_freedom=vehicle.degrees_of_freedom[i],
        normalised_error=float(np.sqrt(ratio)),
        residual_rms=inertia * acceleration,
        noise_rms=inertia * noise,
        unit=FORCE_UNITS[vehicle.dof_indices[i]],
        note="explained by the noise" if quiet else f"{np.sqrt(ratio):.1f} times what the noise explains",
    )


def _inertia(vehicle: Vehicle, i: int) -> float:
    values = {symbol(n): vehicle.value_of(n).value for n in vehicle.parameter_names}
    entry = vehicle.mass_matrix[i, i].xreplace(values)
    # What is left are motions inside sign functions, where added mass differs forward and backward.
    return abs(float(entry.xreplace(dict.fromkeys(entry.free_symbols, sm.Integer(1)))))


def _acceleration_noise(data: WeakData, i: int, width: float) -> float:
    """Rms that the noise of the velocity gives to the mean acceleration under a test function."""
    weights = data.segments[0].functions.rate
    size = len(data.names) // 2
    return float(data.sigma[size + i] * np.sqrt(weights.multiply(weights).sum(axis=1).mean()) / width)
