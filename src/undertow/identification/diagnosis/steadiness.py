"""Whether an effect that leaves more than noise has the same size all along the kept-aside data.

A wrong effect can take nearly all of a residual away: a steady force most of that of a weight that was
dropped early in a run. Its size then changes in the course of the run, which that of a constant does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from undertow.model.parameter import Parameter
from undertow.typing import Array

from ..fitted import Fitted
from ..weak.data import WeakData
from ..weak.noise import Whitening
from ..weak.residual import whitened

_STRETCHES = 8
# Standard error of a size from which a stretch says nothing about it.
_POORLY_KNOWN = 0.1
_FEWEST = 3
# Standard deviation of the size over the stretches, and share of what is left that goes with it, from which
# the size is not steady.
_CHANGING, _MOST = 0.25, 0.5


@dataclass(frozen=True)
class Sizes:
    """Size of an effect by stretch of the kept-aside data, in units of the fitted one.

    Attributes
    ----------
    value, error : (k,) array
        Size in every stretch, and its standard error by the noise of the sensors.
    share : float
        Share of what exceeds the noise that goes away when the size is free in every stretch.
    """

    value: Array
    error: Array
    share: float

    @property
    def known(self) -> Array:
        """Sizes in the stretches that show it."""
        return np.asarray(self.value[self.error < _POORLY_KNOWN])

    @property
    def change(self) -> str:
        """How far the size changes, in words; empty where it is steady."""
        known = self.known
        if len(known) < _FEWEST or self.share < _MOST or np.std(known) < _CHANGING:
            return ""
        return f"its size would have to go from {known.min():.0%} to {known.max():.0%} of the fitted one"


def sizes(fit: Fitted, own: Sequence[Parameter], data: WeakData, noise: list[Whitening]) -> Sizes:
    """Size of an effect in stretches of the kept-aside data, all else being as fitted.

    Parameters
    ----------
    fit : Fitted
        The model with the effect.
    own : sequence of Parameter
        What the effect brings in; those that it is linear in make its size. One without such has none.
    data : WeakData
        Data kept aside.
    noise : list of Whitening
        Noise of the sensors alone in them.
    """
    p = np.asarray(fit.p)
    at = whitened(fit.model.linearise(data, p), noise)
    names = {q.name for q in own if q.linear}
    chosen = [k for k, n in enumerate(fit.model.free) if n in names]
    whole = at.J[:, chosen] @ p[[fit.model.places[k] for k in chosen]]
    stretch = _stretches(data)
    power, slope = (np.bincount(stretch, weights=whole * other) for other in (whole, at.r))
    felt = power > 0.0
    power, slope = power[felt], slope[felt]
    excess = float(at.r @ at.r) - len(at.r)
    gained = float(np.sum(slope**2 / power)) - len(power)
    return Sizes(1.0 - slope / power, 1.0 / np.sqrt(power), gained / excess if excess > 0.0 else 0.0)


def _stretches(data: WeakData) -> NDArray[np.intp]:
    """Stretch of every row: blocks of a run that follow each other, alike in number."""
    block = data.block
    return np.asarray(block * _STRETCHES // (int(block.max(initial=0)) + 1))
