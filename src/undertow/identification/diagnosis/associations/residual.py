"""Which variables a residual goes with: found on the data of a fit, judged on data kept aside.

A term is fitted to the residual beside the parameters that the model has, so that what those could take over
does not count. Chance is measured by turning the sign of the residual in whole blocks of time: that destroys
what it has to do with any variable, and leaves its size and its memory within a block as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from undertow.typing import Array, Index

from ...weak.step import inverse_of
from .terms import Term

_PATTERNS = 1999
# Share of a column's sum of squares that has to be left beside the model's own columns for it to be news.
_NEWS = 1e-4
# Terms that gain this share of what the best one does are told with it.
_ALIKE = 0.9


@dataclass(frozen=True)
class Sample:
    """A residual in units of its noise.

    Attributes
    ----------
    r : (m,) array
        Residual.
    own : (m, k) array
        Its derivative in what the model may adjust.
    columns : (m, q) array
        Its derivative in the coefficients of all terms, side by side.
    block : (m,) array of int
        Block of time of each entry.
    """

    r: Array
    own: Array
    columns: Array
    block: Index

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.block.max(initial=-1)) + 1

    @property
    def square(self) -> float:
        """Sum of squares."""
        return float(np.sum(self.r**2))

    def by_block(self, products: Array) -> Array:
        """Sums over blocks, shape (blocks, ...)."""
        total = np.zeros((self.blocks, *products.shape[1:]))
        np.add.at(total, self.block, products)
        return total


@dataclass(frozen=True)
class Samples:
    """The same residual three times.

    Attributes
    ----------
    fitted, aside : Sample
        On the data of the fit, and on data kept aside, with what is left counted as noise.
    shown : Sample
        On data kept aside, in units of the noise of the sensors alone.
    """

    fitted: Sample
    aside: Sample
    shown: Sample

    def mapped(self, change: Callable[[Sample], Sample]) -> Samples:
        """All three changed alike."""
        return Samples(change(self.fitted), change(self.aside), change(self.shown))


@dataclass(frozen=True)
class Found:
    """A term with what the data say of it.

    Attributes
    ----------
    term : Term
        The term.
    coefficients, errors : (k,) array
        Coefficient of each of its columns, and standard errors.
    gain : float
        Fall of the sum of squares on kept-aside data.
    chance : float
        Share of sign patterns with which the best of all terms gains as much.
    alike : tuple of str
        Labels of terms that gain nearly as much.
    """

    term: Term
    coefficients: Array
    errors: Array
    gain: float
    chance: float
    alike: tuple[str, ...]


@dataclass(frozen=True)
class _Tried:
    """One term: products of its columns with the residual in each block, and with each other."""

    term: Term
    fitted: Array
    aside: Array
    inverse: Array
    gram: Array

    def gain(self, fitted: Array, aside: Array) -> Array:
        """Fall of the kept-aside sum of squares for signs of the blocks, (patterns, blocks) each."""
        step = -(fitted @ self.fitted) @ self.inverse
        quadratic = np.einsum("si,ij,sj->s", step, self.gram, step)
        return np.asarray(-2 * np.einsum("si,si->s", step, aside @ self.aside) - quadratic)


@dataclass(frozen=True)
class Association:
    """A residual from which terms are taken one by one.

    Attributes
    ----------
    terms : tuple of Term
        What it may go with; their columns stand side by side in the samples.
    samples : Samples
        The residual.
    stiffness : (k, k) array
        What else (other equations, priors) says about the model's own parameters, as information.
    taken : frozenset of str
        Labels of the terms that were taken out.
    """

    terms: tuple[Term, ...]
    samples: Samples
    stiffness: Array
    taken: frozenset[str] = frozenset()

    def strongest(self) -> Found | None:
        """The term that takes most of the kept-aside residual away; None where none takes any."""
        tried = self._tried
        counts = self.samples.fitted.blocks, self.samples.aside.blocks
        gains = np.array([t.gain(*(np.ones((1, n)) for n in counts))[0] for t in tried])
        if not np.any(gains > 0):
            return None
        rng = np.random.default_rng(0)
        signs = [rng.choice([-1.0, 1.0], size=(_PATTERNS, n)) for n in counts]
        by_chance = np.max([t.gain(*signs) for t in tried], axis=0)
        order = np.argsort(-gains)
        best = float(gains[order[0]])
        alike = tuple(tried[i].term.label for i in order[1:] if gains[i] > _ALIKE * best)
        chance = (1 + int(np.sum(by_chance >= best))) / (1 + _PATTERNS)
        return self._told(tried[order[0]], best, chance, alike)

    def without(self, found: Found) -> Association:
        """What is left when a term is taken out; its coefficients stay free to adjust."""
        place = self.places[found.term.label]
        rest = self.samples.mapped(lambda s: self._moved(s, place, found.coefficients))
        more = len(found.coefficients)
        stiffness = np.pad(self.stiffness, ((0, more), (0, more)))
        return replace(self, samples=rest, stiffness=stiffness, taken=self.taken | {found.term.label})

    def _moved(self, s: Sample, place: slice, coefficients: Array) -> Sample:
        own = np.column_stack([s.own, s.columns[:, place]])
        return replace(s, r=s.r + self._beside(s)[:, place] @ coefficients, own=own)

    def _beside(self, sample: Sample) -> Array:
        """The columns together with the answer of the model's own parameters to them."""
        return sample.columns - sample.own @ self._answer

    @cached_property
    def _answer(self) -> Array:
        own, columns = self.samples.fitted.own, self.samples.fitted.columns
        return np.asarray(inverse_of(own.T @ own + self.stiffness) @ (own.T @ columns))

    @cached_property
    def places(self) -> dict[str, slice]:
        """Where the columns of each term stand."""
        places, first = {}, 0
        for term in self.terms:
            places[term.label] = slice(first, first := first + len(term.columns))
        return places

    @cached_property
    def _tried(self) -> list[_Tried]:
        fitted, aside = self.samples.fitted, self.samples.aside
        first, second = self._beside(fitted), self._beside(aside)
        gram, whole = first.T @ fitted.columns, np.sum(fitted.columns**2, axis=0)
        a, b = fitted.by_block(first * fitted.r[:, None]), aside.by_block(second * aside.r[:, None])
        news = np.diag(gram) > _NEWS * whole
        return [
            _Tried(t, a[:, c], b[:, c], inverse_of(gram[c, c]), second[:, c].T @ second[:, c])
            for t in self.terms
            for c in [self.places[t.label]]
            if t.label not in self.taken and np.all(news[c])
        ]

    def _told(self, t: _Tried, gain: float, chance: float, alike: tuple[str, ...]) -> Found:
        fitted = self.samples.fitted
        coefficients = -t.inverse @ t.fitted.sum(axis=0)
        column = self._beside(fitted)[:, self.places[t.term.label]]
        scores = fitted.by_block(column * (fitted.r + column @ coefficients)[:, None])
        spread = t.inverse @ (scores.T @ scores) @ t.inverse
        return Found(t.term, coefficients, np.sqrt(np.diag(spread)), gain, chance, alike)
