"""Errors in variables: what noise and an unknown current in the velocity do to each estimator."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from undertow.identification.api import Estimator
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value, Vehicle
from undertow.paper.least_squares import estimate, experiments
from undertow.paper.regression import CASES
from undertow.typing import Progress

from .profile import EXACT, MASS, vehicle

Array = NDArray[np.float64]
DURATION, INTERVAL, HOLD, FORCE, FINE = 300.0, 0.1, 4.0, 0.6, 4
NOISES, CURRENTS, CURRENT_NOISE = (0.02, 0.05, 0.10, 0.20), (0.1, 0.2), 0.02
SQUARES, SMOOTHED = "least squares, case 1", "least squares, case 11"
KNOWN = "the model with ocean_current"
_FITS: dict[str, Estimator] = {
    "weak form": Estimator("weak"),
    "instrumental variables": Estimator("instrumental", None),
    "output error": Estimator("output-error", None),
}
METHODS = (SQUARES, SMOOTHED, *_FITS)


@dataclass(frozen=True)
class Bias:
    """What one estimator makes of many draws.

    Attributes
    ----------
    noise, current : float
        Noise of the velocity in shares of its rms, and velocity of the water along the motion, m/s.
    method : str
        Estimator.
    off : (draws, 3) array
        Error of m_x, X_u and X_u|u|, % of the truth.
    """

    noise: float
    current: float
    method: str
    off: Array

    @property
    def mean(self) -> Array:
        """Bias, %."""
        return np.asarray(np.mean(self.off, axis=0))

    @property
    def unsure(self) -> Array:
        """Standard error of the bias by the number of draws, %."""
        return np.asarray(np.std(self.off, axis=0) / np.sqrt(len(self.off)))


def run(noise: float, seed: int, current: float = 0.0) -> Run:
    """Five minutes in surge at 10 Hz under forces that jump every four seconds; velocity over ground."""
    rng = np.random.default_rng([seed, round(1e4 * noise), round(1e3 * current)])
    t = np.arange(0.0, DURATION, INTERVAL)
    force = steps(rng, len(t), FORCE)
    u = driven(force, current)
    sigma = noise * float(np.sqrt(np.mean(u**2)))
    return Run("steps", t, {"u": u + sigma * rng.standard_normal(len(t)), "tau_X": force})


def steps(rng: np.random.Generator, count: int, size: float) -> Array:
    """A force that jumps every four seconds, N."""
    every = round(HOLD / INTERVAL)
    return np.repeat(rng.uniform(-size, size, count // every + 1), every)[:count]


def driven(force: Array, current: float) -> Array:
    """Velocity over ground at the samples, by the classical Runge-Kutta method."""
    step, u, path = INTERVAL / FINE, current, []
    mass, linear, quadratic = EXACT.tolist()

    def rate(u: float, push: float) -> float:
        through = u - current
        return float((push - linear * through - quadratic * abs(through) * through) / mass)

    for push in force.tolist():
        path.append(u)
        for _ in range(FINE):
            k1 = rate(u, push)
            k2 = rate(u + step / 2 * k1, push)
            k3 = rate(u + step / 2 * k2, push)
            u += step / 6 * (k1 + 2 * k2 + 2 * k3 + rate(u + step * k3, push))
    return np.array(path)


def with_current() -> Vehicle:
    """The model with a current to be found."""
    return vehicle().with_effect(catalogue()["ocean_current"], {"V_N": Value(0.0, estimate=True)})


def biases(draws: int, report: Progress) -> list[Bias]:
    """All noise levels, then all currents without and with the current in the model."""
    settings = [(n, 0.0) for n in NOISES] + [(CURRENT_NOISE, c) for c in CURRENTS]
    found = []
    for k, (noise, current) in enumerate(settings):
        report(k / len(settings), f"errors in variables: noise {noise:.0%}, current {current:g} m/s")
        runs = [run(noise, seed, current) for seed in range(draws)]
        for method, found_values in _all(runs, known=current != 0.0):
            found.append(Bias(noise, current, method, 100 * (found_values - EXACT) / EXACT))
    return found


def _all(runs: list[Run], *, known: bool) -> Iterator[tuple[str, Array]]:
    plain = vehicle()
    for method, case in ((SQUARES, "1"), (SMOOTHED, "11")):
        parts = [experiments(plain, [r])[0] for r in runs]
        yield method, np.array([numbers(estimate(e, CASES[case]).values) for e in parts])
    for method, estimator in _FITS.items():
        yield method, np.array([numbers(estimator.fit(plain, [r]).values) for r in runs])
    if known:
        model = with_current()
        for method, estimator in _FITS.items():
            found = np.array([numbers(estimator.fit(model, [r]).values) for r in runs])
            yield f"{method}, {KNOWN}", found


def numbers(values: dict[str, float]) -> Array:
    """m_x, X_u and X_u|u| of estimates."""
    return np.array([MASS, 0.0, 0.0]) - [values[n] for n in ("X_udot", "X_u", "X_uabsu")]
