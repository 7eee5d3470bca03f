"""Depths from pressures."""

from __future__ import annotations

from dataclasses import dataclass

from undertow.identification.logs.mapping import Column


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
    told = f"{SETTINGS.density:g} kg/m^3 and {above:g} Pa at the surface"
    return column, f"{told}: for other water change `scale` in a mapping file"
