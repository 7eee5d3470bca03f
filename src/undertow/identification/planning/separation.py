"""How far apart the predictions of two models stay once each has been refitted to the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Run
from ..weak.data import WeakData, prepare
from ..weak.noise import Whitening
from ..weak.residual import Linearised, WeakModel, whitened
from ..weak.step import bounded_step, bounds_of, prior_of
from .flight import Airspace, Flight
from .rivals import RivalModel

_ROUNDS = 6
_SHARES = (1.0, 0.5, 0.2)
# A fall of the sum of squares that changes no judgement.
_ENOUGH = 0.01


class Refit:
    """Refits one rival to what another one predicts.

    Parameters
    ----------
    rival : RivalModel
        The model that gives way.
    truth : RivalModel
        The model that is taken for true.
    with_logs : bool
        Whether the rival has to keep fitting the logs that it was fitted to.
    """

    def __init__(self, rival: RivalModel, truth: RivalModel, *, with_logs: bool) -> None:
        self._model, self._p = rival.model, rival.plant.p
        self._truth, self._true_p = WeakModel(truth.plant.functions, ()), truth.plant.p
        self._bounds, self._prior = bounds_of(rival.model), prior_of(rival.model)
        size = len(rival.known.free)
        logs = rival.known.logs if with_logs else np.zeros((size, size))
        values, vectors = np.linalg.eigh(logs) if size else (np.zeros(0), np.zeros((0, 0)))
        self._root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        self._places = list(rival.model.places)

    @property
    def vehicle(self) -> Vehicle:
        """The model that gives way."""
        return self._model.functions.vehicle

    def distance(self, data: WeakData, start: Array | None = None, rounds: int = 1) -> tuple[float, Array]:
        """Sum of squares that no refit of the rival takes away, in units of the noise, and the refit.

        The residual that the true model leaves itself (quadrature, and noise in a real log) does not count.

        Parameters
        ----------
        data : WeakData
            A log that the true model predicts, or a real one.
        start : (n_parameters,) array, optional
            Values that the refit begins with.
        rounds : int
            Steps of Gauss and Newton; one alone is the linearised problem, as searches use it.
        """
        p = (self._p if start is None else start).copy()
        own = self._truth.linearise(data, self._true_p)
        noise = self._model.whitening(data, p)
        at = self._at(data, p, own, noise)
        for left in range(rounds, 0, -1):
            if not (np.isfinite(at.r).all() and np.isfinite(at.J).all()):
                return 0.0, p
            step = bounded_step(at, p[self._places], self._bounds, self._prior)
            promised = _squares(at.r + at.J @ step)
            if left == 1 or _squares(at.r) - promised < _ENOUGH:
                return min(promised, _squares(at.r)), p
            p, at = self._moved(data, p, step, at, own, noise)
        return 0.0, p

    def _moved(
        self,
        data: WeakData,
        p: Array,
        step: Array,
        at: Linearised,
        own: list[Linearised],
        noise: list[Whitening],
    ) -> tuple[Array, Linearised]:
        for share in _SHARES:
            tried = p.copy()
            tried[self._places] = np.clip(p[self._places] + share * step, *self._bounds)
            there = self._at(data, tried, own, noise)
            if _squares(there.r) < _squares(at.r):
                return tried, there
        return p, at

    def _at(self, data: WeakData, p: Array, own: list[Linearised], noise: list[Whitening]) -> Linearised:
        """The linearised problem; below the prediction stands what the logs hold against a change."""
        parts = [_apart(a, b) for a, b in zip(self._model.linearise(data, p), own, strict=True)]
        seen = whitened(parts, noise)
        moved = self._root @ (p[self._places] - self._p[self._places])
        both, slopes = np.concatenate([seen.r, moved]), np.vstack([seen.J, self._root])
        return Linearised(both, slopes, np.zeros((len(both), 0)))


def _apart(rival: Linearised, truth: Linearised) -> Linearised:
    """Difference of two residuals; neither knows the first states of its effects."""
    known = [k for k in (rival.known, truth.known) if k is not None]
    return replace(
        rival,
        r=rival.r - truth.r,
        start=np.hstack([rival.start, truth.start]),
        known=min(known, default=None),
    )


def _squares(r: Array) -> float:
    return float(np.sum(r**2))


class Separations:
    """Distances between all pairs of rivals.

    Parameters
    ----------
    rivals : sequence of RivalModel
        The models.
    spread : float
        How many times wider than by noise alone errors are.
    with_logs : bool
        As for `Refit`.
    """

    def __init__(self, rivals: Sequence[RivalModel], spread: float, *, with_logs: bool) -> None:
        self._spread, self._count = spread, len(rivals)
        self.pairs = list(combinations(range(len(rivals)), 2))
        # A model cannot be told from one that holds it: only the other way round there is a difference.
        self._ways = [
            [(i, j) for i, j in (pair, pair[::-1]) if not rivals[i].parts < rivals[j].parts]
            for pair in self.pairs
        ]
        ways = [way for ways in self._ways for way in ways]
        self._refits = {(i, j): Refit(rivals[j], rivals[i], with_logs=with_logs) for i, j in ways}
        self._last: dict[tuple[int, int], Array] = {}

    def quick(self, space: Airspace, flight: Flight) -> Array:
        """Chi-square of every pair along a flight, refits being linearised about the last careful ones."""
        return self._apart(self._along(space, flight), rounds=1)

    def careful(self, space: Airspace, flight: Flight) -> Array:
        """Chi-square of every pair along a flight with thorough refits."""
        return self._apart(self._along(space, flight), _ROUNDS)

    def on_logs(self, runs: Sequence[Run], sigma: Array) -> Array:
        """Chi-square of every pair along the motions of logs; sigma is the noise of their 2n channels."""
        data = prepare(runs, self._refits[self._ways[0][0]].vehicle, sigma=sigma)
        return self._apart([data] * self._count, _ROUNDS)

    def _along(self, space: Airspace, flight: Flight) -> list[WeakData]:
        return [space.data(flight, i) for i in range(self._count)]

    def _apart(self, predicted: Sequence[WeakData], rounds: int) -> Array:
        """The smaller of both ways round, for every pair."""
        found = [min(self._way(way, predicted[way[0]], rounds) for way in ways) for ways in self._ways]
        return np.array(found) / self._spread**2

    def _way(self, way: tuple[int, int], data: WeakData, rounds: int) -> float:
        """One model refitted to another; thorough refits are where the next one begins."""
        near, p = self._refits[way].distance(data, self._last.get(way), rounds)
        if rounds > 1:
            self._last[way] = p
        return near
