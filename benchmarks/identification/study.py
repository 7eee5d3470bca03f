"""Many draws of the experiment, and what each estimator makes of them."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import Fitted, cramer_rao, verdicts
from undertow.identification.estimation.output_error import fit_output_error
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.paper.least_squares import Experiment, estimate, experiments, selected
from undertow.paper.regression import CASES
from undertow.typing import Progress

from ..progress import part_of
from .profile import EXACT, MASS, NOISES, logs, spread, vehicle

Array = NDArray[np.float64]
RULE, WEAK, OUTPUT = "case by the rule", "weak form", "output error"
METHODS = (*(f"case {name}" for name in CASES), RULE, WEAK, OUTPUT)


@dataclass(frozen=True)
class Level:
    """All draws at one noise.

    Attributes
    ----------
    noise : float
        Share of the rms of the velocity.
    estimates : dict of (draws, 3) arrays
        m_x, X_u, X_u|u| by method; NaN where it gave none.
    bound : (3,) array
        Cramér-Rao standard deviations.
    known : dict of float
        How often output error called each parameter identified.
    """

    noise: float
    estimates: dict[str, Array]
    bound: Array
    known: dict[str, float]

    def rmse(self, method: str) -> Array:
        """Root mean square error, % of the truth."""
        return np.asarray(100 * np.sqrt(np.nanmean((self.estimates[method] - EXACT) ** 2, axis=0)) / EXACT)

    def bias(self, method: str) -> Array:
        """Mean error over the standard deviation."""
        found = self.estimates[method]
        return np.asarray((np.nanmean(found, axis=0) - EXACT) / np.nanstd(found, axis=0))

    def silent(self, method: str) -> float:
        """Share of the draws in which a method gave no estimate."""
        return float(np.mean(np.isnan(self.estimates[method][:, 0])))

    def best_case(self) -> Array:
        """Least error of the eleven cases for each parameter, % of the truth."""
        return np.min([self.rmse(f"case {name}") for name in CASES], axis=0)


def study(draws: int, report: Progress) -> list[Level]:
    """All noise levels."""
    return [_level(noise, draws, part_of(report, i, len(NOISES))) for i, noise in enumerate(NOISES)]


def _level(noise: float, draws: int, report: Progress) -> Level:
    model = vehicle()
    (surge,) = experiments(model, [logs(noise, 0, False)[0]])
    found: dict[str, list[Array]] = {method: [] for method in METHODS}
    said: list[dict[str, str]] = []
    for seed in range(draws):
        report(seed / draws, f"noise {noise:.1%}: draw {seed + 1} of {draws}")
        sampled, held = logs(noise, seed, mirrored=seed % 2 == 1)
        for name, values in _chain(surge, sampled).items():
            found[name].append(values)
        for name, fit in _fits(model, held).items():
            found[name].append(np.full(3, np.nan) if fit is None else _numbers(fit.values))
            if name == OUTPUT and fit is not None:
                said.append(dict(verdicts(fit)))
    known = {n: float(np.mean([one[n] == "identified" for one in said])) for n in said[0]}
    return Level(noise, {name: np.array(rows) for name, rows in found.items()}, _bound(model, noise), known)


def _numbers(values: dict[str, float]) -> Array:
    return np.array([MASS, 0.0, 0.0]) - [values[n] for n in ("X_udot", "X_u", "X_uabsu")]


def _chain(surge: Experiment, run: Run) -> dict[str, Array]:
    one = replace(surge, runs=(run,))
    tried = [estimate(one, case) for case in CASES.values()]
    found = {f"case {e.case.name}": _numbers(e.values) for e in tried}
    pick = selected(tried)
    return found | {RULE: np.full(3, np.nan) if pick is None else _numbers(pick.values)}


def _fits(model: Vehicle, run: Run) -> dict[str, Fitted | None]:
    weak = fit_weak(model, prepare([run], model))
    output: Fitted | None = None
    with suppress(UndertowError):
        output = fit_output_error(model, [run], horizon=None, start=weak.values)
    return {WEAK: weak, OUTPUT: output}


def _bound(model: Vehicle, noise: float) -> Array:
    """Cramér-Rao standard deviations at the truth, with the noise known and the start free."""
    _, held = logs(0.0, 0, False)
    run = Run("P", held.t, held.channels, sigma={"u": spread(noise)})
    fit = fit_output_error(model, [run], horizon=None)
    return np.array([cramer_rao(fit)[n] for n in ("X_udot", "X_u", "X_uabsu")])
