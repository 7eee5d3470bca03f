"""What formats of logs state in other ways: quaternions, latitudes and longitudes, pressures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from undertow.typing import Array

from .mapping import Column

ANGLES = ("phi", "theta", "psi")
SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "day": 86400.0}
"""Seconds in the units that clocks count, the likelier first."""


def angles(w: Array, x: Array, y: Array, z: Array) -> dict[str, Array]:
    """Roll, pitch and yaw, rad, of quaternions from body to earth axes (Fossen 2021, section 2.2).

    Quaternions may have any length; one of no length gives NaN.
    """
    square = w**2 + x**2 + y**2 + z**2
    length = np.where(square > 0.0, square, np.nan)
    phi = np.arctan2(2.0 * (w * x + y * z) / length, 1.0 - 2.0 * (x**2 + y**2) / length)
    theta = np.arcsin(np.clip(2.0 * (w * y - z * x) / length, -1.0, 1.0))
    psi = np.arctan2(2.0 * (w * z + x * y) / length, 1.0 - 2.0 * (y**2 + z**2) / length)
    return dict(zip(ANGLES, (phi, theta, psi), strict=True))


_RADIUS, _FLATTENING = 6_378_137.0, 1.0 / 298.257223563  # WGS 84: m at the equator


def north_east(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """Distances from the first fix on the plane that touches the ellipsoid there, m.

    Ten kilometres away they are wrong by some metres. Degrees are NaN where there is no fix.
    """
    there = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))
    if not len(there):
        return np.full(len(latitude), np.nan), np.full(len(latitude), np.nan)
    lat0, lon0 = latitude[there[0]], longitude[there[0]]
    north, east = metres_per_degree(lat0)
    return north * (latitude - lat0), east * ((longitude - lon0 + 180.0) % 360.0 - 180.0)


def metres_per_degree(latitude: float) -> tuple[float, float]:
    """Metres to the north in a degree of latitude, and to the east in one of longitude, at a latitude."""
    lat, square = np.radians(latitude), _FLATTENING * (2.0 - _FLATTENING)
    across = _RADIUS / np.sqrt(1.0 - square * np.sin(lat) ** 2)
    along = across * (1.0 - square) / (1.0 - square * np.sin(lat) ** 2)
    return float(np.radians(along)), float(np.radians(across * np.cos(lat)))


@dataclass(frozen=True)
class PressureSettings:
    """How a pressure becomes a depth."""

    density: float = 1025.0  # kg/m^3: sea water; in fresh water a depth is 2.5 % more
    gravity: float = 9.81  # m/s^2
    surface: float = 101325.0  # Pa: the standard atmosphere


SETTINGS = PressureSettings()


def depth(pascal: float, *, absolute: bool, down: float = 1.0) -> tuple[Column, str]:
    """What makes depth of a pressure, and what is to be said of it.

    `pascal` is Pa in one of its unit, `absolute` whether it has the air above the water in it, `down` 1 where
    z counts downwards in the log and -1 where it counts upwards.
    """
    metre = SETTINGS.density * SETTINGS.gravity
    above = SETTINGS.surface if absolute else 0.0
    column = Column(
        channel="z", unit="m", scale=down * pascal / metre, offset=-down * above / metre if above else 0.0
    )
    assumed = f"{SETTINGS.density:g} kg/m^3 and {above:g} Pa at the surface"
    return column, f"{assumed}: for other water change `scale` in a mapping file"
