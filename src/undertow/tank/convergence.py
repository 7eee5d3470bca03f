"""What the grid leaves open: Richardson extrapolation and the grid convergence index."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import copysign, log

from undertow.errors import UndertowError


@dataclass(frozen=True)
class GciRules:
    """How a grid convergence index is computed; factors are those of Roache."""

    three: float = 1.25  # factor of safety where three grids show the order
    two: float = 3.0  # the same where the order is assumed
    assumed: float = 1.0  # order where it is: limiters and turbulence are of first order
    least: float = 0.5  # a lower observed order would make the index grow without bound
    most: float = 2.0  # the schemes have no higher order; a higher observed one is chance
    one: float = 0.10  # share of a value that a single grid leaves open
    rounds: int = 50  # of the iteration for the order
    ceiling: float = 20.0  # of the observed order: values that agree to rounding have any


_RULES = GciRules()


@dataclass(frozen=True)
class Convergence:
    """How far a value is from that of an infinitely fine grid."""

    value: float  # on the finest grid
    extrapolated: float  # by Richardson; the value itself where it does not converge
    order: float  # as observed, or assumed; 0 where values run apart
    index: float  # grid convergence index of the finest grid times the value: a band of about 95 %
    kind: str  # "monotone", "oscillating", "running apart", "two grids", "one grid"


def observed_order(values: Sequence[float], sizes: Sequence[float]) -> float:
    """Order of convergence of three values, finest grid first, by the fixed-point iteration of Celik et al.

    `sizes`: of their cells, rising. Source: Celik et al. (2008), Procedure for estimation and reporting of
    uncertainty due to discretization in CFD applications, J. Fluids Eng. 130, 078001. At most 20, also
    if the two finer values agree.
    """
    one, two = values[1] - values[0], values[2] - values[1]
    if not one:
        return _RULES.ceiling
    if not two:
        return 0.0
    fine, coarse = sizes[1] / sizes[0], sizes[2] / sizes[1]
    sign, order = copysign(1.0, two / one), 1.0
    for _ in range(_RULES.rounds):
        uneven = (fine**order - sign) / (coarse**order - sign)
        order = min(abs(log(abs(two / one)) + log(uneven)) / log(fine), _RULES.ceiling) or 1e-9
    return order


def convergence(values: Sequence[float], sizes: Sequence[float]) -> Convergence:
    """Richardson extrapolation and grid convergence index (Roache) of values on grids, finest first.

    `values`: of one to four grids, of which the three finest count; `sizes`: of their cells, rising. Where
    values run apart the index is three times their spread. Source: Roache (1994), Perspective: a method for
    uniform reporting of grid refinement studies, J. Fluids Eng. 116, 405-413.
    """
    if not values or len(values) != len(sizes) or any(b <= a for a, b in pairwise(sizes)):
        raise UndertowError("grid convergence: give a value for each grid, finest first, with rising sizes")
    value = values[0]
    if len(values) == 1:
        return Convergence(value, value, 0.0, _RULES.one * abs(value), "one grid")
    change, ratio = value - values[1], sizes[1] / sizes[0]
    if len(values) == 2:
        step = change / (ratio**_RULES.assumed - 1)
        return Convergence(value, value + step, _RULES.assumed, _RULES.two * abs(step), "two grids")
    order = observed_order(values[:3], sizes[:3])
    before = values[1] - values[2]
    if abs(change) >= abs(before) and change:
        spread = max(values[:3]) - min(values[:3])
        return Convergence(value, value, 0.0, _RULES.two * spread, "running apart")
    used = min(max(order, _RULES.least), _RULES.most)
    step = change / (ratio**used - 1)
    if change * before < 0:
        spread = max(values[:3]) - min(values[:3])
        return Convergence(value, value, order, max(_RULES.three * abs(step), spread / 2), "oscillating")
    return Convergence(value, value + step, order, _RULES.three * abs(step), "monotone")
