"""Long logs in surge in plain NumPy: forces that jump, noise of any colour, feedback, a disturbance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tests.identification.surge import M_X, TRUTH
from undertow.identification.logs.run import Run

EXACT = -np.array(list(TRUTH.values()))
"""X_udot, X_u, X_uabsu."""

_NOTHING = lambda i, u: 0.0  # noqa: E731


def steps(count: int, seed: int, hold: int = 25, size: float = 0.5) -> np.ndarray:
    """A force that jumps every `hold` samples, N."""
    levels = np.random.default_rng([seed, 7]).uniform(-size, size, count // hold + 1)
    return np.repeat(levels, hold)[:count]


def simulated(
    force: np.ndarray | Callable[[int, float], float],
    reading: np.ndarray,
    dt: float = 0.1,
    disturbance: Callable[[int, float], float] = _NOTHING,
    fine: int = 4,
) -> Run:
    """Surge driven by a force, N, that may feed back what is read; `reading` is the noise, m/s."""
    given = force if callable(force) else lambda i, u: force[i]
    count, u = len(reading), 0.0
    logged, measured = np.zeros(count), np.zeros(count)
    for i in range(count):
        measured[i] = u + reading[i]
        logged[i] = given(i, measured[i])
        push, h = logged[i] + disturbance(i, u), dt / fine
        for _ in range(fine):
            k1 = _rate(u, push)
            k2 = _rate(u + h * k1 / 2, push)
            k3 = _rate(u + h * k2 / 2, push)
            u += h / 6 * (k1 + 2 * k2 + 2 * k3 + _rate(u + h * k3, push))
    return Run("long", dt * np.arange(count), {"u": measured, "tau_X": logged})


def _rate(u: float, push: float) -> float:
    return (push - TRUTH["X_u"] * u - TRUTH["X_uabsu"] * abs(u) * u) / M_X


def coloured(count: int, sigma: float, pole: float, rng: np.random.Generator) -> np.ndarray:
    """First-order autoregressive noise of a given standard deviation."""
    from scipy.signal import lfilter

    white = rng.standard_normal(count + 200) * sigma * np.sqrt(1 - pole**2)
    return np.asarray(lfilter([1.0], [1.0, -pole], white)[200:])
