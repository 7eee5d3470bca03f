"""Added mass of a box, from a table of panel computations."""

from __future__ import annotations

from functools import cache
from importlib.resources import files

import numpy as np
from scipy.interpolate import RectBivariateSpline

from undertow.errors import UndertowError
from undertow.typing import Array

from .bodies import AddedMass, ellipsoid, positive
from .mesh import Mesh

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


# --- simple bodies in place of a hull -------------------------------------------------------------
_FILL_OF_ELLIPSOID = np.pi / 6
# Cylinders and torpedoes are within this part of the distance from box to ellipsoid, a cone is not
# everywhere (docs/shape.md).
_PART = 0.25
# The same of an ellipsoid that had to be stretched because the table of boxes ends.
_STRETCHED = 0.4
_BODY_LIMITS = "simple bodies of the same extents in place of the hull, in ideal fluid"


def equivalent(mesh: Mesh, density: float = 1000.0, form: str | None = None) -> AddedMass:
    """Added mass of a box or an ellipsoid with the extents of a hull, about the origin of its mesh.

    Parameters
    ----------
    mesh : Mesh
        The hull.
    density : float
        Of the water, kg/m^3.
    form : {"box", "ellipsoid"}, optional
        By default between both, by how much of its bounding box the hull fills: an ellipsoid 52 %, a box all.

    Raises
    ------
    UndertowError
        If a box is asked for and the table does not have it.
    """
    length, beam, height = mesh.extents.tolist()
    fill = mesh.volume / (length * beam * height)
    round_ = ellipsoid(length / 2, beam / 2, height / 2, density).matrix
    try:
        full = box(length, beam, height, density).matrix
    except UndertowError:
        if form == "box":
            raise
        full = None
    between, error, told = _between(round_, full, fill)
    chosen = {"box": full, "ellipsoid": round_}.get(form or "", between)
    assert chosen is not None
    extents = f"{length:.4g} x {beam:.4g} x {height:.4g} m"
    source = f"{form or told} of the extents of the hull, {extents}, of which it fills {fill:.0%}"
    error = np.maximum(error, np.abs(chosen - between))
    return AddedMass(chosen, source, _BODY_LIMITS, error).placed(np.eye(3), mesh.centroid)


def _between(round_: Array, full: Array | None, fill: float) -> tuple[Array, Array, str]:
    """Added mass for a hull that fills so much of its bounding box, its error, and how it was found."""
    if full is None:
        stretched = round_ * max(1.0, fill / _FILL_OF_ELLIPSOID)
        return stretched, _STRETCHED * stretched, "an ellipsoid, stretched to the volume,"
    share = float(np.clip((fill - _FILL_OF_ELLIPSOID) / (1 - _FILL_OF_ELLIPSOID), 0.0, 1.0))
    if share > 0.99:
        return full, 0.02 * full, "box"
    told = f"{1 - share:.0%} ellipsoid and {share:.0%} box"
    return round_ + share * (full - round_), _PART * np.abs(full - round_), told
