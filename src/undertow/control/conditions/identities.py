"""Forms z' N(nu) z that are zero whatever the motion: what V_dot leaves open.

A product of velocities can be read as a velocity times a form of the others in more than one way, as
u (v r) = v (u r) = r (u v), and e_x (u r) = e_x (r u). A(nu) takes one of them; at a corner of a box of
speeds the others are worth more or less. So every N with sum over k of nu_k z' N_k z = 0 may be added to the
condition that V falls (annihilators: Trofino and Dezuo 2014, LMI stability conditions for uncertain rational
nonlinear systems, Int. J. Robust Nonlinear Control 24).
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from undertow.typing import Array

from .embedding import Corners

Axes = tuple[int, ...]
_NOTHING = 1e-100  # what outward rounding makes of zero is below it
Way = tuple[int, int, int]
"""A velocity, and the places in z of the two states that it multiplies."""


def identities(corners: Corners, n: int, size: int) -> Array:
    """Independent N that vanish, for z = (..., nu) of so many states, shape (m, n, size, size)."""
    found = [_form(*pair, n, size) for axes in _coupled(corners) for pair in _pairs(axes, n, size)]
    return np.array(found).reshape(-1, n, size, size)


def _coupled(corners: Corners) -> list[Axes]:
    """Three axes, two of which may be one, that meet in a product: the velocity, the row and the column."""
    found = set()
    for k, end in enumerate(corners.ends):
        size = end.moving.size.max(axis=0) + end.turning.size.max(axis=0)
        found |= {tuple(sorted((k, int(i), int(j)))) for i, j in np.argwhere(size > _NOTHING)}
    return sorted(axes for axes in found if len(set(axes)) > 1)


def _pairs(axes: Axes, n: int, size: int) -> Iterator[tuple[Way, Way]]:
    """Two ways of reading one product: of three velocities, or of two and a state of the third axis."""
    last = size - n
    for i in sorted(set(axes)):
        one, other = _without(axes, i)
        if one != other:
            yield from (((one, p + i, last + other), (other, p + i, last + one)) for p in range(0, last, n))
    first, *others = sorted(set(axes))
    for k in others:
        yield _read(axes, first, last), _read(axes, k, last)


def _without(axes: Axes, one: int) -> Axes:
    place = axes.index(one)
    return axes[:place] + axes[place + 1 :]


def _read(axes: Axes, k: int, last: int) -> Way:
    i, j = _without(axes, k)
    return k, last + i, last + j


def _form(one: Way, other: Way, n: int, size: int) -> Array:
    found = np.zeros((n, size, size))
    for (k, i, j), sign in ((one, 1.0), (other, -1.0)):
        found[k, i, j] += sign
        found[k, j, i] += sign
    return found
