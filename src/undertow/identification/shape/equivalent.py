"""Simple bodies that stand for a hull where no panel method is at hand."""

from __future__ import annotations

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .bodies import AddedMass, ellipsoid
from .boxes import box
from .mesh import Mesh

_FILL_OF_ELLIPSOID = np.pi / 6
# Cylinders and torpedoes are within this part of the distance from box to ellipsoid, a cone is not
# everywhere (docs/shape.md).
_PART = 0.25
# The same of an ellipsoid that had to be stretched because the table of boxes ends.
_STRETCHED = 0.4
_LIMITS = "simple bodies of the same extents in place of the hull, in ideal fluid"


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
    return AddedMass(chosen, source, _LIMITS, error).placed(np.eye(3), mesh.centroid)


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
