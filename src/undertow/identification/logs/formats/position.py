"""Metres north and east of a first fix, of the latitudes and longitudes that vehicles log."""

from __future__ import annotations

import numpy as np

from undertow.typing import Array

_RADIUS, _FLATTENING = 6_378_137.0, 1.0 / 298.257223563  # WGS 84: m at the equator


def north_east(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """Distances from the first fix on the plane that touches the ellipsoid there, m.

    Ten kilometres away they are wrong by some metres. Degrees are NaN where there is no fix.
    """
    there = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))
    if not len(there):
        return np.full(len(latitude), np.nan), np.full(len(latitude), np.nan)
    lat, lon = np.radians(latitude), np.radians(longitude)
    lat0, lon0 = lat[there[0]], lon[there[0]]
    square = _FLATTENING * (2.0 - _FLATTENING)
    across = _RADIUS / np.sqrt(1.0 - square * np.sin(lat0) ** 2)
    along = across * (1.0 - square) / (1.0 - square * np.sin(lat0) ** 2)
    turned = (lon - lon0 + np.pi) % (2.0 * np.pi) - np.pi
    return along * (lat - lat0), across * np.cos(lat0) * turned
