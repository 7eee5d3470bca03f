"""The hull of a small AUV, made by rule: 0.60 m long, 7.5 kg, no mirror image of itself along or upright."""

from __future__ import annotations

import numpy as np

from benchmarks.shape.hulls import revolved
from undertow.shape.mesh import Mesh
from undertow.typing import Array

LENGTH, BEAM, HEIGHT = 0.60, 0.18, 0.12  # m; beam and height before the volume is set
MASS = 7.5  # kg, that of the vehicle in the paper
VOLUME = MASS / 1000.0  # m^3: it floats where it is put
_NOSE, _TAIL, _TRANSOM = 0.15, 0.18, 0.45  # m, m, and the share of the section that the stern ends with
_FLAT = 4.0  # exponent of the superellipse of the lower half: a flat bottom


def fullness(x: Array) -> Array:
    """Size of the section over that amidships at places along the hull, m, from -0.3 to 0.3."""
    ahead = np.clip((x - (LENGTH / 2 - _NOSE)) / _NOSE, 0.0, 1.0)
    aft = np.clip(-(x + LENGTH / 2 - _TAIL) / _TAIL, 0.0, 1.0)
    return np.asarray(np.sqrt(1 - ahead**2) * (1 - (1 - _TRANSOM) * aft**2 * (3 - 2 * aft)))


def auv_hull(around: int = 64) -> Mesh:
    """A half-ellipse above a flat bottom, an elliptic nose, a tapered stern with a flat end; m, z down."""
    nose = LENGTH / 2 - _NOSE + _NOSE * np.sin(np.linspace(0.0, np.pi / 2, 15))
    x = np.concatenate([np.linspace(-LENGTH / 2, LENGTH / 2 - _NOSE, 25)[:-1], nose])
    stations = [(-LENGTH / 2, 0.0), *zip(x.tolist(), fullness(x).tolist(), strict=True)]
    round_ = revolved(stations, around)
    along, across, down = round_.vertices.T
    size = np.hypot(across, down)
    c, s = np.divide([across, down], size, out=np.zeros((2, len(size))), where=size > 0)
    flat = s > 1e-12
    c = np.where(flat, np.sign(c) * np.abs(c) ** (2 / _FLAT), c)
    s = np.where(flat, np.abs(s) ** (2 / _FLAT), s)
    # Of the height seven parts in twelve lie above the widest place.
    half = np.where(flat, 5 / 12, 7 / 12) * HEIGHT
    hull = Mesh(np.stack([along, BEAM / 2 * size * c, half * size * s], axis=1), round_.faces)
    scale = np.sqrt(VOLUME / hull.volume)
    return Mesh(hull.vertices * np.array([1.0, scale, scale]), hull.faces)
