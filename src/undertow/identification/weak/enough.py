"""Whether there are more equations than parameters to be told by them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs import Run

from .data import WeakData
from .residual import WeakModel
from .step import prior_of


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
