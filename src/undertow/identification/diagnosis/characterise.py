"""What the residual force of each degree of freedom goes with."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from undertow.model.symbols import FORCE_UNITS
from undertow.typing import Array

from ..fitted import Fitted
from ..weak.data import WeakData
from ..weak.step import prior_of
from .associations.clock import Clock
from .associations.force_rows import ForceRow, ForceRows, measured_pose
from .associations.portrait import Character, Portrait, Sitting
from .associations.residual import Association, Sample, Samples
from .associations.terms import terms_of

# Mean square in units of the noise from which something is left; for short logs, spreads of that of noise.
_LOUD = 1.3
_SPREADS = 5.0
_FEWEST_BLOCKS = 6
# A residual has forgotten what is this little correlated with it; blocks are that many times as long.
_FORGOTTEN = 0.3
_MEMORIES = 3.0


class Characteriser:
    """Residual forces of a fitted model, on the data of the fit and on data kept aside.

    Parameters
    ----------
    fit : Fitted
        The model.
    known, aside : WeakData
        Logs that it was fitted to, and logs that it was not.
    """

    def __init__(self, fit: Fitted, known: WeakData, aside: WeakData) -> None:
        vehicle = fit.model.functions.vehicle
        self._units = [FORCE_UNITS[i] for i in vehicle.dof_indices]
        self._fitted, self._aside = ForceRows(fit, known), ForceRows(fit, aside)
        self._terms = tuple(terms_of(vehicle, measured_pose(aside)))
        self._prior = prior_of(fit.model)[1]

    @cached_property
    def rows(self) -> list[ForceRow]:
        """Force equations on the kept-aside data."""
        return [self._aside.row(i) for i in range(len(self._units))]

    def is_loud(self, dof: int) -> bool:
        """Whether more is left in a degree of freedom than the noise explains."""
        row = self.rows[dof]
        count = sum(len(p.r) for p in row.parts)
        return row.ratio > max(_LOUD, 1.0 + _SPREADS * float(np.sqrt(2.0 / count)))

    def of(self, dof: int) -> Character:
        """Describe what is left in a degree of freedom, by its place among those of the vehicle."""
        fitted, aside = self._fitted_rows[dof], self.rows[dof]
        rows = (self._fitted, fitted, fitted.disturbance), (self._aside, aside, fitted.disturbance)
        sitting = Sitting(
            self._association(dof), self._clocks, (*rows, (self._aside, aside, 0.0)), self._units[dof]
        )
        return Portrait(sitting).drawn()

    def _association(self, dof: int) -> Association:
        level, own = self._fitted_rows[dof].disturbance, len(self._prior)
        first, second = self._columns
        tables = [
            self._fitted_rows[dof].whitened(level, first),
            self.rows[dof].whitened(level, second),
            self.rows[dof].whitened(0.0, second),
        ]
        seconds = self._block_seconds(tables[0].r)
        blocks = [c.blocks(seconds) for c in (*self._clocks, self._clocks[1])]
        samples = [Sample(t.r, t.J[:, :own], t.J[:, own:], b) for t, b in zip(tables, blocks, strict=True)]
        return Association(self._terms, Samples(*samples), self._stiffness(dof))

    def _block_seconds(self, r: Array) -> float:
        """Blocks that forget each other, but enough of them on the kept-aside data."""
        covariance = np.correlate(r, r, "full")[len(r) - 1 :]
        memory = self._clocks[0].step * int(np.argmax(covariance < _FORGOTTEN * covariance[0]))
        data = self._aside.data
        total = sum(float(s.t[-1] - s.t[0]) for s in data.segments)
        return min(max(data.block_seconds, _MEMORIES * memory), total / _FEWEST_BLOCKS)

    def _stiffness(self, dof: int) -> Array:
        """What priors and the equations of the other motions say about the parameters, as information."""
        others = [self._information[i] for i in range(len(self._units)) if i != dof]
        return np.asarray(np.diag(self._prior**2) + sum(others, np.zeros((len(self._prior),) * 2)))

    @cached_property
    def _fitted_rows(self) -> list[ForceRow]:
        return [self._fitted.row(i) for i in range(len(self._units))]

    @cached_property
    def _clocks(self) -> tuple[Clock, Clock]:
        return Clock.of(self._fitted.data), Clock.of(self._aside.data)

    @cached_property
    def _information(self) -> list[Array]:
        jacobians = [row.whitened(row.disturbance).J for row in self._fitted_rows]
        return [J.T @ J for J in jacobians]

    @cached_property
    def _columns(self) -> tuple[list[Array], list[Array]]:
        """What each term adds to a row, on the data of the fit and on those kept aside."""
        columns = [c for t in self._terms for c in t.columns]
        return self._fitted.columns(columns), self._aside.columns(columns)
