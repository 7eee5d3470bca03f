"""NetCDF: .nc, by netCDF4; among others the files of gliders (OG1, EGO, Slocum by name).

Every dimension along which a variable counts the time is a series; so is that of a group. Units are those
that the file states. Variables are known by their standard_name (CF), then by the names that gliders have for
them; what is left is guessed from names. Values that are flagged as bad, missing or interpolated (NAME_QC of
4, 9 and 8, as in Argo) are blank. Added columns: ``north`` and ``east`` of latitudes and longitudes, m.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.guess_names import is_time
from undertow.identification.logs.mapping import Column, north_east
from undertow.model.units import scale_offset
from undertow.typing import Array

from .by_name import fits, guessed, names_of_columns
from .fieldlog import SETTINGS as UNION
from .fieldlog import FieldLog, Format, Series, library
from .glider import KNOWN as SLOCUM

_HDF5 = b"\x89HDF\r\n\x1a\n"
_CLASSIC = (b"CDF\x01", b"CDF\x02", b"CDF\x05")
_SUFFIXES = (".nc", ".nc4", ".cdf", ".netcdf")
_PHONY = "phony_dim"
_BAD = (4, 8, 9)  # flags of quality: bad, interpolated, missing
# Names of CF, and the sign by which they are ours: NED and forward-starboard-down.
_STANDARD = {
    "depth": ("z", 1.0),
    "platform_roll": ("phi", 1.0),
    "platform_roll_starboard_down": ("phi", 1.0),
    "platform_roll_starboard_up": ("phi", -1.0),
    "platform_pitch": ("theta", 1.0),
    "platform_pitch_fore_up": ("theta", 1.0),
    "platform_pitch_fore_down": ("theta", -1.0),
    "platform_orientation": ("psi", 1.0),
    "platform_yaw": ("psi", 1.0),
    "platform_yaw_fore_starboard": ("psi", 1.0),
    "platform_roll_rate": ("p", 1.0),
    "platform_pitch_rate": ("q", 1.0),
    "platform_yaw_rate": ("r", 1.0),
    "height_above_sea_floor": ("altitude", 1.0),
}
# Names without a standard name, in small letters.
_NAMES = {
    **{name: (one.channel, 1.0) for name, one in SLOCUM.items()},
    **dict.fromkeys(("roll", "eng_rollang", "glider_roll"), ("phi", 1.0)),
    **dict.fromkeys(("pitch", "eng_pitchang", "glider_pitch"), ("theta", 1.0)),
    **dict.fromkeys(("heading", "eng_head", "glider_heading"), ("psi", 1.0)),
    **dict.fromkeys(("depth", "ctd_depth", "glider_depth"), ("z", 1.0)),
}
_LATITUDE, _LONGITUDE = ("latitude", "lat", "latitude_gps"), ("longitude", "lon", "longitude_gps")


@dataclass(frozen=True)
class _Variable:
    """A variable along a dimension of time."""

    name: str
    values: Array
    standard: str
    unit: str


def _read(path: Path, messages: Path | None) -> FieldLog:
    library_ = library("netCDF4", "a file of NetCDF")
    with library_.Dataset(path) as file:
        found = list(_along_time(file, ""))
    if not found:
        raise UndertowError(
            f"log {path} has no time variable along a dimension: give one the units 'seconds "
            "since ...' or the standard_name 'time'"
        )
    begin = min(start for _, (start, _), _ in found)
    series: dict[str, Series] = {}
    known: dict[str, Column] = {}
    for name, (start, since), variables in found:
        units = {v.name: v.unit for v in variables if v.unit}
        series[name] = Series(name, since + (start - begin), {v.name: v.values for v in variables}, units)
        for variable in variables:
            meant = _meaning(variable)
            if meant and meant.channel not in {column.channel for column in known.values()}:
                known[f"{name}.{variable.name}"] = meant
    mapping, actuators, questions = guessed(path, list(series.values()), known)
    by_name = not known and not any(one.units for one in series.values())
    asked = tuple(questions)
    return FieldLog(path, FORMAT.name, series, mapping, actuators, remarks=asked, by_name=by_name)


# --- from the file to variables -------------------------------------------------------------------
def _along_time(group: Any, prefix: str) -> Iterator[tuple[str, tuple[float, Array], list[_Variable]]]:
    """Dimensions of time of a group and those in it: name, its clock, variables."""
    for name in group.dimensions:
        along = [v for v in group.variables.values() if v.dimensions[:1] == (name,)]
        clock = min((v for v in along if _counts(v)), key=lambda v: _rank(v, name), default=None)
        if clock is not None and len(clock) > 1:
            variables = [one for v in along if v is not clock for one in _variables(v, group)]
            # Plain HDF5 has no names of dimensions.
            called = prefix.rstrip("/") if prefix and name.startswith(_PHONY) else f"{prefix}{name}"
            yield called, _seconds(clock), [*variables, *_fixes(variables)]
    for name, inner in group.groups.items():
        yield from _along_time(inner, f"{prefix}{name}/")


def _counts(variable: Any) -> bool:
    """Whether a variable counts the time."""
    if variable.ndim != 1 or variable.dtype.kind not in "biuf":
        return False
    since = " since " in str(getattr(variable, "units", ""))
    return since or getattr(variable, "standard_name", "") == "time" or is_time(variable.name)


def _rank(variable: Any, dimension: str) -> tuple[bool, bool, bool]:
    """How far a variable is from being the clock of a dimension; the least is."""
    since = " since " in str(getattr(variable, "units", ""))
    return variable.name != dimension, getattr(variable, "standard_name", "") != "time", not since


def _seconds(variable: Any) -> tuple[float, Array]:
    """When a clock starts, s, since 1970 where its units name a date, and the times from there."""
    # Apart, since their sum would round the times to a quarter of a microsecond.
    import cftime

    counted = np.ma.filled(np.ma.asarray(variable[:]).astype(np.float64), np.nan)
    unit, since, _ = str(getattr(variable, "units", "s")).partition(" since ")
    scale = scale_offset(_unit(unit) or "s", "s", of=f"units of {variable.name!r}")[0]
    first = float(next(iter(counted[np.isfinite(counted)]), 0.0))
    start, times = first * scale, (counted - first) * scale
    if since:
        calendar = getattr(variable, "calendar", "standard")
        date = cftime.num2date(0, variable.units, calendar, only_use_cftime_datetimes=True)
        start += float(cftime.date2num(date, "seconds since 1970-01-01", calendar))
    return start, times


def _variables(variable: Any, group: Any) -> Iterator[_Variable]:
    """The columns of a variable, blank where it has no value."""
    if variable.dtype.kind not in "biuf" or variable.ndim > 2:
        return
    if variable.ndim == 2 and variable.shape[1] > UNION.widest:
        return
    values = np.ma.filled(np.ma.asarray(variable[:]).astype(np.float64), np.nan)
    flags = [group.variables.get(variable.name + end) for end in ("_QC", "_qc")]
    flag = next((one for one in flags if one is not None), None)
    if flag is not None and flag.dtype.kind in "iu" and flag.shape == variable.shape:
        values = np.where(np.isin(np.ma.filled(flag[:], 9), _BAD), np.nan, values)
    standard, unit = str(getattr(variable, "standard_name", "")), _unit(str(getattr(variable, "units", "")))
    if values.ndim == 1:
        yield _Variable(variable.name, values, standard, unit)
        return
    for name, column in zip(names_of_columns(variable.name, values.shape[1]), values.T, strict=True):
        yield _Variable(name, column, standard, unit)


def _unit(text: str) -> str:
    """A unit of UDUNITS as undertow writes it; "" for none, and for what has no unit."""
    powers = re.sub(r"([A-Za-z])\*{0,2}\^?(-?\d)\b", r"\1^\2", text.strip())
    plain = re.sub(r"degrees?_?(true|north|east|n|e|t)\b", "deg", powers, flags=re.IGNORECASE)
    spelled = re.sub(r"\bvolts?\b", "V", re.sub(r"\bdegrees?\b", "deg", plain), flags=re.IGNORECASE)
    return "" if spelled in ("1", "-", "nodim", "timestamp", "enum", "bool") else spelled.replace(".", " ")


def _fixes(variables: list[_Variable]) -> list[_Variable]:
    """Metres north and east, where there are latitudes and longitudes."""
    named = {v.name.lower(): v for v in variables}
    standard = {v.standard: v for v in reversed(variables)}
    latitude = standard.get("latitude") or next((named[n] for n in _LATITUDE if n in named), None)
    longitude = standard.get("longitude") or next((named[n] for n in _LONGITUDE if n in named), None)
    if latitude is None or longitude is None or {"north", "east"} & named.keys():
        return []
    north, east = north_east(latitude.values, longitude.values)
    return [_Variable("north", north, "", "m"), _Variable("east", east, "", "m")]


# --- from variables to channels -------------------------------------------------------------------
def _meaning(variable: _Variable) -> Column | None:
    """The channel of a variable that is known, with the unit that it has."""
    channel, sign = _STANDARD.get(variable.standard) or _NAMES.get(variable.name.lower(), ("", 1.0))
    if not channel or not np.any(np.isfinite(variable.values)):
        return None
    unit = variable.unit or next((one.unit for n, one in SLOCUM.items() if n == variable.name.lower()), None)
    return Column(channel=channel, unit=unit, scale=sign) if fits(unit, channel) else None


def _accepts(path: Path, head: bytes) -> bool:
    if head.startswith(_CLASSIC):
        return True
    return head.startswith(_HDF5) and (path.suffix.lower() in _SUFFIXES or path.suffix.lower() != ".mat")


FORMAT = Format("NetCDF", _SUFFIXES, _accepts, _read, hangs=True)
