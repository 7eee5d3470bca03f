"""Logs as people would have written them: one usual mistake each, on columns of a clean log."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

Columns = dict[str, np.ndarray]
Break = Callable[[Mapping[str, np.ndarray]], Columns]


def _with(columns: Mapping[str, np.ndarray], **changed: np.ndarray) -> Columns:
    return {**columns, **changed}


def scaled(*names: str, by: float, plus: float = 0.0) -> Break:
    """Some columns times a factor, plus an offset."""
    return lambda c: _with(c, **{n: by * c[n] + plus for n in names})


def in_degrees(*names: str) -> Break:
    """Angles or rates in degrees; a heading runs from 0 to 360."""

    def write(c: Mapping[str, np.ndarray]) -> Columns:
        found = {n: np.degrees(c[n]) for n in names}
        if "psi" in found:
            found["psi"] = found["psi"] % 360.0
        return _with(c, **found)

    return write


def on_the_globe(latitude: str, longitude: str) -> Break:
    """Latitude and longitude, degrees, as x and y in one order or the other."""
    return lambda c: _with(c, **{latitude: 63.4 + c["x"] / 111_468, longitude: 10.4 + c["y"] / 49_978})


def time_of_day(c: Mapping[str, np.ndarray]) -> Columns:
    """Times from 12:59:40 on as hours, minutes and seconds in six digits."""
    t = 46_780.0 + c["t"]
    return _with(c, t=10_000.0 * (t // 3600.0) + 100.0 * (t % 3600.0 // 60.0) + t % 60.0)


def enu_position(c: Mapping[str, np.ndarray]) -> Columns:
    """East, north, up."""
    return _with(c, x=c["y"], y=c["x"], z=-c["z"])


def enu_attitude(c: Mapping[str, np.ndarray]) -> Columns:
    """Heading from east, anticlockwise."""
    return _with(c, psi=np.pi / 2 - c["psi"], theta=-c["theta"])


def flu_body(c: Mapping[str, np.ndarray]) -> Columns:
    """Forward, left, up."""
    return _with(c, **{n: -c[n] for n in ("v", "w", "q", "r")})


def ros(c: Mapping[str, np.ndarray]) -> Columns:
    """All of it, as ROS has it."""
    return flu_body(enu_attitude(enu_position(c)))


def swapped(one: str, other: str) -> Break:
    """Two columns in each other's place."""
    return lambda c: _with(c, **{one: c[other], other: c[one]})


def north_east_velocity(c: Mapping[str, np.ndarray]) -> Columns:
    """u and v as velocities north and east (a vehicle that does not tilt)."""
    cos, sin = np.cos(c["psi"]), np.sin(c["psi"])
    return _with(c, u=cos * c["u"] - sin * c["v"], v=sin * c["u"] + cos * c["v"])


def through_water(north: float, east: float) -> Break:
    """u and v relative to water that moves (a vehicle that does not tilt)."""

    def write(c: Mapping[str, np.ndarray]) -> Columns:
        cos, sin = np.cos(c["psi"]), np.sin(c["psi"])
        return _with(c, u=c["u"] - cos * north - sin * east, v=c["v"] + sin * north - cos * east)

    return write


def late(seconds: float, drift: float = 0.0, names: tuple[str, ...] = ("u", "v", "w")) -> Break:
    """Velocities of a while ago; the while grows by `drift` over the log."""

    def write(c: Mapping[str, np.ndarray]) -> Columns:
        t = c["t"]
        then = t - seconds - drift * ((t - t[0]) / (t[-1] - t[0]) - 0.5)
        return _with(c, **{n: np.interp(then, t, c[n]) for n in names})

    return write


def both(*breaks: Break) -> Break:
    """Several mistakes."""

    def write(c: Mapping[str, np.ndarray]) -> Columns:
        for one in breaks:
            c = one(c)
        return dict(c)

    return write
