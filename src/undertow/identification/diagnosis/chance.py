"""What chance does: how good the best of all candidates looks when none of them is in the data."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undertow.typing import Array

from ..weak.step import inverse_of
from .blocks import Blocks

DRAWS = 1000
_RESAMPLES = 200
_SEED = 20150518


@dataclass(frozen=True)
class Linear:
    """A candidate linearised where it was fitted, on the data for the fit and on those kept aside.

    Attributes
    ----------
    train, test : Blocks
        The model's own parameters first, the candidate's last.
    own : int
        How many of the columns belong to the candidate.
    stiffness : (k,) array
        Weight of the stated priors.
    """

    train: Blocks
    test: Blocks
    own: int
    stiffness: Array

    def falls(self, train_signs: Array, test_signs: Array) -> Array:
        """Fall of the kept-aside mean square by the candidate when both models are refitted, (draws,)."""
        without = Linear(
            self.train.without(self.own), self.test.without(self.own), 0, self.stiffness[: -self.own or None]
        )
        before = without._squares(train_signs, test_signs)
        return np.asarray((before - self._squares(train_signs, test_signs)) / self.test.rows)

    def _squares(self, train_signs: Array, test_signs: Array) -> Array:
        delta = -self.train.slope(train_signs) @ _inverse(self.train.gram, self.stiffness)
        return self.test.squares(test_signs, delta)

    def resampled(self, train_weight: Array, test_weight: Array) -> Array:
        """Kept-aside sum of squares after a refit to weighted blocks, shape (draws,)."""
        return np.array(
            [self._weighted(a, b) for a, b in zip(train_weight, test_weight, strict=True)], dtype=float
        )

    def _weighted(self, train: Array, test: Array) -> float:
        fitted, judged = (np.tensordot(w, b.table, 1) for w, b in ((train, self.train), (test, self.test)))
        k = len(self.stiffness)
        ones = np.ones(2)
        slope = fitted[:k, k:] @ ones
        delta = -_inverse(fitted[:k, :k], self.stiffness) @ slope
        whole = np.concatenate([delta, ones])
        return float(whole @ judged @ whole)


def _inverse(gram: Array, stiffness: Array) -> Array:
    """Inverse of the information; a parameter that the data do not feel at all stays where it is."""
    felt = np.diag(gram) > 0.0
    inverse = np.zeros_like(gram)
    inverse[np.ix_(felt, felt)] = inverse_of((gram + np.diag(stiffness**2))[np.ix_(felt, felt)])
    return inverse


def best_by_chance(candidates: Sequence[Linear]) -> Array:
    """Largest fall of the kept-aside error over all candidates in draws where nothing is missing, (DRAWS,).

    The residual of the model without any candidate keeps its size and its correlation within blocks; the sign
    of every block is drawn at random (wild bootstrap), which undoes whatever the blocks have in common.
    """
    if not candidates:
        return np.zeros(DRAWS)
    rng = np.random.default_rng(_SEED)
    first = candidates[0]
    train, test = (rng.choice([-1.0, 1.0], (DRAWS, b.count)) for b in (first.train, first.test))
    return np.asarray(np.max([c.falls(train, test) for c in candidates], axis=0))


def p_value(fall: float, by_chance: Array) -> float:
    """Chance that the best candidate lowers the error by at least this much when nothing is missing."""
    return float((1 + np.count_nonzero(by_chance >= fall)) / (1 + len(by_chance)))


def inclusion(candidates: Sequence[Linear]) -> Array:
    """How often each candidate is the best one when the blocks are drawn anew, shape (len(candidates),)."""
    if not candidates:
        return np.zeros(0)
    rng = np.random.default_rng(_SEED)
    first = candidates[0]
    train, test = (
        rng.multinomial(b.count, np.full(b.count, 1.0 / b.count), _RESAMPLES).astype(float)
        for b in (first.train, first.test)
    )
    squares = np.array([c.resampled(train, test) for c in candidates])
    return np.bincount(np.argmin(squares, axis=0), minlength=len(candidates)) / _RESAMPLES
