"""Added mass of a box, from a table of panel computations."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np
from scipy.interpolate import RectBivariateSpline

from undertow.errors import UndertowError
from undertow.typing import Array

from .bodies import AddedMass, positive

_MOTIONS = 6
#: Largest relative error of the table, its interpolation included.
BOX_ERROR = 0.02
_SOURCE = "table of 36 boxes computed by a panel method (capytaine, direct method), interpolated"
_LIMITS = (
    f"sharp edges, smooth closed sides; within {BOX_ERROR:.0%} in ideal fluid far from bottom and surface; "
    "water that separates at the edges in large motions is not in it"
)


def box(length: float, beam: float, height: float, density: float = 1000.0) -> AddedMass:
    """Added mass of a rectangular box about its centre.

    Parameters
    ----------
    length, beam, height : float
        Sides along x, y and z, m.
    density : float
        Of the fluid, kg/m^3.

    Raises
    ------
    UndertowError
        If a number is not positive, or a side is so much longer than the next one that the table ends before.

    Notes
    -----
    Cubic splines of the logarithms of the coefficients over the logarithms of both ratios of sides.
    """
    positive(length=length, beam=beam, height=height, density=density)
    sides = np.array([length, beam, height])
    order = np.argsort(-sides, kind="stable")
    longest, middle, shortest = sides[order]
    ratios = np.array([longest / middle, middle / shortest])
    most = _table()[0][-1]
    if (ratios > most * (1 + 1e-6)).any():
        raise UndertowError(
            f"a box of {length:g} x {beam:g} x {height:g} m has sides in the ratio {ratios.max():.3g}, the "
            f"table ends at {most:.3g} between one side and the next: take an ellipsoid, or a panel method"
        )
    coefficients = np.array([float(np.exp(s(*np.log(np.minimum(ratios, most)))[0, 0])) for s in _splines()])
    squares = sides**2
    scale = density * sides.prod() * np.concatenate([np.ones(3), (squares.sum() - squares) / 12])
    own = np.empty(_MOTIONS)
    own[order], own[order + 3] = coefficients[:3], coefficients[3:]
    matrix = np.diag(own * scale)
    source = f"box of {length:g} x {beam:g} x {height:g} m; {_SOURCE}"
    return AddedMass(matrix, source, _LIMITS, BOX_ERROR * matrix)


@cache
def _table() -> tuple[Array, Array]:
    """Ratios of the sides, and coefficients, shape (ratios, ratios, 6)."""
    text = (files("undertow.identification.shape") / "box_table.csv").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith(("#", "L/B"))]
    rows = np.array([[float(x) for x in line.split(",")] for line in lines])
    ratios = np.unique(rows[:, 0])
    return ratios, rows[:, 2 : 2 + _MOTIONS].reshape(len(ratios), len(ratios), _MOTIONS)


@cache
def _splines() -> tuple[RectBivariateSpline, ...]:
    ratios, values = _table()
    places = np.log(ratios)
    return tuple(RectBivariateSpline(places, places, np.log(values[..., i])) for i in range(_MOTIONS))
