"""What all fits have in common: free parameters of a model with their covariance."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .constraints import active, fitted_vehicle
from .data import WeakData
from .residual import WeakModel
from .step import inverse_of, prior_of


class Solution(ABC):
    """Values of the free parameters of a model, found by least squares.

    Attributes
    ----------
    model : WeakModel
        Model and names of the free parameters.
    p : (n_parameters,) array
        All parameters.
    """

    model: WeakModel
    p: Array

    @property
    @abstractmethod
    def gram(self) -> Array:
        """J' J of the weighted residual, shape (n_free, n_free)."""

    @property
    @abstractmethod
    def covariance(self) -> Array:
        """Covariance of the free parameters."""

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle with the fitted values and their standard errors."""
        return fitted_vehicle(self.model, self.values, self.standard_errors)

    @property
    def values(self) -> dict[str, float]:
        """Fitted values of the free parameters, SI and SNAME signs."""
        return {n: float(self.p[k]) for n, k in zip(self.model.free, self.model.places, strict=True)}

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard error of every free parameter."""
        return dict(zip(self.model.free, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def condition(self) -> float:
        """Condition number of the scaled regressor."""
        scale = np.sqrt(np.maximum(np.diag(self.gram), 1e-300))
        return float(np.sqrt(np.linalg.cond(self.gram / np.outer(scale, scale)))) if len(scale) else 1.0

    @property
    def active(self) -> list[str]:
        """Constraints that hold the estimates back, by name."""
        return active(self.model, self.p)


def clustered(information: Array, scores: Array) -> Array:
    """Covariance of an estimate: never less than noise alone gives, and robust to what hangs together.

    Parameters
    ----------
    information : (k, k) array
        J' J of the weighted residual, with what priors add.
    scores : (groups, k) array
        J' r of groups of residuals that count as independent of each other.
    """
    inverse = inverse_of(information)
    robust = np.diag(inverse @ (scores.T @ scores) @ inverse)
    inflation = np.sqrt(np.maximum(1.0, robust / np.maximum(np.diag(inverse), 1e-300)))
    return np.asarray(inverse * np.outer(inflation, inflation))


# --- more equations than parameters ---------------------------------------------------------------
def require_equations(model: WeakModel, data: WeakData, method: str) -> None:
    """Refuse logs that are too short for the parameters of a model, by their weak equations of motion.

    Raises
    ------
    UndertowError
        If there are no more equations than parameters without a prior.
    """
    count = int(np.count_nonzero(data.equation < len(data.names) // 2))
    require_rows(model, count, data.runs, method)


def require_rows(model: WeakModel, count: int, runs: Sequence[Run], method: str) -> None:
    """Refuse as many equations as there are parameters without a prior, or fewer.

    Raises
    ------
    UndertowError
        Naming the runs, what they give, and what is sought.
    """
    sought = int(np.count_nonzero(prior_of(model)[1] == 0.0))
    if sought and count <= sought:
        lengths = ", ".join(f"'{run.name}' {len(run.t)} samples" for run in runs)
        raise UndertowError(
            f"these logs ({lengths}) are too short for --method {method}: {sought} parameters need more than "
            f"{sought} equations, and they make {count}: give longer logs, or state parameters as known"
        )
