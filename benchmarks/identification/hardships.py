"""Outliers, and forces that nobody logs: what each estimator makes of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from undertow.identification.api import Estimator
from undertow.identification.logs.run import Run
from undertow.typing import Progress

from .profile import EXACT, vehicle
from .variables import INTERVAL, driven, numbers, steps

Array = NDArray[np.float64]
SAMPLES, NOISE, FORCE = 600, 0.005, 2.0
NOTHING, OUTLIERS, WHITE, WALK = (
    "noise only",
    "outliers of 20 standard deviations in 1%",
    "a white force of 0.3 N",
    "a force that wanders by 0.08 N in 10 s",
)
ESTIMATORS = {
    "weak form": Estimator("weak"),
    "weak form, without spikes": Estimator("weak", loss="huber"),
    "integral form": Estimator("integral"),
    "output error": Estimator("output-error", None),
    "output error, Huber": Estimator("output-error", None, loss="huber"),
    "output error, Student's t": Estimator("output-error", None, loss="student-t"),
    "prediction error": Estimator("prediction-error"),
}
#: Of no use but against outliers.
ROBUST = [name for name, estimator in ESTIMATORS.items() if estimator.loss != "gaussian"]


@dataclass(frozen=True)
class Hardship:
    """What one estimator makes of many draws.

    Attributes
    ----------
    what, method : str
        What is wrong with the log, and the estimator.
    off, claimed : (draws, 3) arrays
        Error of m_x, X_u and X_u|u| and the standard error that was stated, % of the truth.
    """

    what: str
    method: str
    off: Array
    claimed: Array

    @property
    def rmse(self) -> Array:
        """Root mean square error, %."""
        return np.asarray(np.sqrt(np.mean(self.off**2, axis=0)))

    @property
    def honest(self) -> float:
        """Root mean square of the errors in units of the standard errors that were stated."""
        return float(np.sqrt(np.mean((self.off / self.claimed) ** 2)))


def log(what: str, seed: int) -> Run:
    """One minute in surge at 10 Hz, 0.005 m/s of noise."""
    rng = np.random.default_rng([seed, 11])
    force = steps(rng, SAMPLES, FORCE)
    noise, white = NOISE * rng.standard_normal(SAMPLES), rng.standard_normal(SAMPLES)
    push = {WHITE: 0.3 * white, WALK: 0.008 * np.cumsum(white)}.get(what, 0.0 * white)
    hit = (rng.random(SAMPLES) < 0.01) * (what == OUTLIERS)
    spikes = hit * 20 * NOISE * rng.choice([-1.0, 1.0], SAMPLES)
    reading = driven(force + push, 0.0) + noise + spikes
    return Run("steps", INTERVAL * np.arange(SAMPLES, dtype=float), {"u": reading, "tau_X": force})


def hardships(draws: int, report: Progress) -> list[Hardship]:
    """All estimators in all that is wrong."""
    kinds = (NOTHING, OUTLIERS, WHITE, WALK)
    found = []
    for k, what in enumerate(kinds):
        runs = [log(what, seed) for seed in range(draws)]
        for j, (method, estimator) in enumerate(ESTIMATORS.items()):
            report((k + j / len(ESTIMATORS)) / len(kinds), f"{what}: {method}")
            found.append(_of(what, method, estimator, runs))
    return found


def _of(what: str, method: str, estimator: Estimator, runs: list[Run]) -> Hardship:
    model = vehicle()
    fits = [estimator.fit(model, [run]) for run in runs]
    off = np.array([numbers(fit.values) - EXACT for fit in fits])
    names = ("X_udot", "X_u", "X_uabsu")
    claimed = np.array([[fit.standard_errors[n] for n in names] for fit in fits])
    return Hardship(what, method, 100 * off / EXACT, 100 * claimed / EXACT)
