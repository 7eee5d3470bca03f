"""Wind on what stands out of the water."""

from math import atan2, hypot, inf

import sympy as sm

from undertow.model.effect import LoggedOnly, Parameter, Signals, Wrench, column
from undertow.model.symbols import rotation

_AIR_X, _AIR_Y = column(["air_x", "air_y"])
_HALF = sm.Rational(1, 2)
_SPEED, _DENSITY = 10.0, 1.225


class Wind(Wrench):
    """Force of the wind on the frontal and the lateral area of a surface vessel.

    Included because every log of a surface vessel outdoors contains it, and it differs from a current, which
    carries the vessel along so that its force vanishes. Areas contain their drag coefficients. Where the log
    holds the wind, over ground or as it is felt aboard, they are all that has to be found. Without it the
    wind is steady, and only the products of areas and pressure
    show: the areas are then those for `wind_speed`, and the vessel's own speed counts as little beside it. It
    acts x_wind ahead of the origin and z_wind below it (above: negative).
    """

    id = "wind"
    family = "water"
    reference = (
        "Fossen (2021), chapter 10 (wind forces, C_X with the cosine and C_Y with the sine of the angle, C_N "
        "with the sine of twice the angle)"
    )
    former_keys = ("W_N", "W_E", "wind_aspect")
    signature = "a force on surface vessels in a fixed direction over ground, the same at all speeds"

    area_frontal = Parameter("m^2", "frontal area times its drag coefficient", (0, inf))
    area_lateral = Parameter("m^2", "lateral area times its drag coefficient", (0, inf))
    moment_wind = Parameter(
        "m^3", "yaw moment coefficient (of the sine of twice the angle) times lateral area and length"
    )
    wind_from = Parameter.with_starts(
        "rad",
        "wind direction (where it comes from), from north clockwise",
        (-7, 7),
        (0.0, 1.6, 3.1, -1.6),
        logged=True,
        without_log="apparent_wind_speed",
    )
    wind_speed = Parameter.with_default(
        "m/s",
        "speed of the wind over ground",
        (0, 100),
        _SPEED,
        logged=True,
        without_log="apparent_wind_speed",
    )
    apparent_wind_speed = LoggedOnly("m/s", "apparent wind speed", (0, 100))
    apparent_wind_angle = LoggedOnly(
        "rad", "apparent wind direction, from the bow to starboard", with_log="apparent_wind_speed"
    )
    air_density = Parameter.with_default("kg/m^3", "density of the air", (0.5, 2), _DENSITY)
    wind_least = Parameter.with_default(
        "m/s", "speed below which the force fades", (1e-9, 1.0), 1e-3, with_log="wind_speed"
    )
    x_wind = Parameter.with_starts("m", "where it acts, forward", (-200, 200), (0,), arm_of="1")
    z_wind = Parameter.with_starts("m", "where it acts, down", (-100, 10), (0,), arm_of="1")

    @classmethod
    def observable_in(cls, dofs: tuple[str, ...]) -> bool:
        # Without yaw it cannot be told from a constant force.
        return "heave" not in dofs and "yaw" in dofs and bool({"surge", "sway"} & set(dofs))

    @classmethod
    def file_units(cls) -> dict[str, str]:
        return {"W_N": "N", "W_E": "N", "wind_aspect": "1"}

    @classmethod
    def from_file(cls, entries: dict[str, float]) -> dict[str, float]:
        if not cls.file_units().keys() & entries.keys():
            return entries
        kept = {n: v for n, v in entries.items() if n not in cls.file_units()}
        north, east = entries.get("W_N", 0.0), entries.get("W_E", 0.0)
        density, speed = entries.get("air_density", _DENSITY), entries.get("wind_speed", _SPEED)
        area = hypot(north, east) / (density * speed**2 / 2)
        lateral = area * entries.get("wind_aspect", 1.0)
        return kept | {
            "area_frontal": area,
            "area_lateral": lateral,
            "wind_from": atan2(-east, -north) if area else 0.0,
        }

    def wrench(self, s: Signals) -> sm.Matrix:
        pressure = _HALF * self.air_density * self._speed
        ahead, across = pressure * self.area_frontal * _AIR_X, pressure * self.area_lateral * _AIR_Y
        # q c_z A L sin 2 gamma, with the components of the air along the vessel.
        turning = self.air_density * self.moment_wind * _AIR_X * _AIR_Y
        yaw = self.x_wind * across + turning
        return sm.Matrix([ahead, across, 0, -self.z_wind * across, self.z_wind * ahead, yaw])

    @property
    def _speed(self) -> sm.Expr:
        """Speed of the air past the vessel, m/s."""
        if "apparent_wind_speed" in self.inputs:
            return self.apparent_wind_speed
        if "wind_speed" in self.inputs:
            return sm.sqrt(_AIR_X**2 + _AIR_Y**2 + self.wind_least**2)
        return self.wind_speed

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        if "apparent_wind_speed" in self.inputs:
            speed, angle = self.apparent_wind_speed, self.apparent_wind_angle
            return {_AIR_X: -speed * sm.cos(angle), _AIR_Y: -speed * sm.sin(angle)}
        over_ground = -self.wind_speed * sm.Matrix([sm.cos(self.wind_from), sm.sin(self.wind_from), 0])
        air = rotation(sm.Matrix([0, 0, s.eta[5]])).T * over_ground
        if "wind_speed" in self.inputs:
            air -= sm.Matrix(s.nu[:3])
        return {_AIR_X: air[0], _AIR_Y: air[1]}
