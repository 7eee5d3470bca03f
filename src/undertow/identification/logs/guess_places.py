"""Latitude and longitude among the columns of a log."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.typing import Array

from .guess_frames import in_degrees, least_unexplained_shares, place_of
from .guess_names import Name, latitude_and_longitude, places_called_so, rows_by_number
from .guess_rows import are_degrees
from .mapping import metres_per_degree


@dataclass(frozen=True)
class PlaceSettings:
    """Settings for telling latitude from longitude, and whether two places are the same."""

    pole: float = 90.0  # degrees
    globe: float = 180.0  # no latitude or longitude is larger, degrees
    polar_latitude: float = 72.0  # degrees, beyond which few vehicles are
    # Two places contradict each other if they are farther apart than this share of the way, and than fixes
    # scatter, m.
    least_separation_share: float = 0.2
    scatter_of_fixes: float = 10.0
    rows: float = 0.9  # share of the rows in which they may be nearer


SETTINGS = PlaceSettings()


def fixes_in(
    motion: dict[str, Name], data: Mapping[str, Array], dead: set[str], t: Array
) -> tuple[dict[str, Name], Sequence[str], dict[str, tuple[str, Array]]]:
    """Columns of latitude and longitude, rather ones that move, and the place that they give, if any.

    First the columns of the other motions: those of x and y only where they are no latitude and longitude.
    """
    globe: Sequence[str] = _globe_called_xy(motion, data, t)
    motion = {c: n for c, n in motion.items() if n.column not in globe}
    if not globe and not {"x", "y"} & {*motion}:
        globe = latitude_and_longitude([c for c in data if c not in dead]) or latitude_and_longitude(data)
    place = place_of(*((n, data[n]) for n in globe)) if {*globe} - dead else {}
    return motion, globe if place else (), place


def _globe_called_xy(motion: Mapping[str, Name], data: Mapping[str, Array], t: Array) -> tuple[str, ...]:
    """Columns of latitude and longitude in degrees that are called x and y, as heading and speed have it."""
    x, y = (motion[c].column if c in motion and not motion[c].unit else "" for c in "xy")
    if not (x and y and are_degrees(t, {"x": data[x], "y": data[y]})):
        return ()
    known = {c: data[motion[c].column] for c in ("psi", "u", "v") if c in motion}
    turns = [known.get("psi", 0.0 * t), np.radians(known.get("psi", 0.0 * t))]

    def unlikely(globe: tuple[str, str]) -> tuple[float, bool]:
        place = {c: values for c, (_, values) in place_of(*((n, data[n]) for n in globe)).items()}
        shares = [least_unexplained_shares(t, {**known, **place, "psi": psi}) for psi in turns if place]
        polar = float(np.nanmax(np.abs(data[globe[0]]))) > SETTINGS.polar_latitude
        return min((share for one in shares for share in one.values()), default=np.inf), polar

    return min(((y, x), (x, y)), key=unlikely)


def two_places(
    used: tuple[Mapping[str, Array], Mapping[str, Name], Sequence[str]],
    data: Mapping[str, Array],
    dead: set[str],
) -> list[str]:
    """Questions where columns give another place than those that are used.

    These are x and y in metres, columns by the channels that they mean, and latitude and longitude.
    """
    known, motion, globe = used
    by_number = _beside_number(motion, data, dead)
    return [*_beside_metres(known, data, dead), *_beside_globe(globe, data, dead), *by_number]


def no_degrees(data: Mapping[str, Array]) -> tuple[str, ...]:
    """Latitude and longitude, where one of them is beyond half a turn."""
    found = latitude_and_longitude(data)
    return found if any(np.nanmax(np.abs(data[n]), initial=0.0) > SETTINGS.globe for n in found) else ()


def _beside_metres(known: Mapping[str, Array], data: Mapping[str, Array], dead: set[str]) -> list[str]:
    """A question where x and y (m) lead elsewhere than latitude and longitude of the same log."""
    globe = latitude_and_longitude([c for c in data if c not in dead])
    other = place_of(*((n, data[n]) for n in globe)) if globe and {"x", "y"} <= known.keys() else {}
    places = [known["x"], known["y"], *(values for _, values in other.values())] if other else []
    there = np.all(np.isfinite(places), axis=0)
    if not places or not there.any():
        return []
    # How far it is from the first, for the axes of x and y may be any.
    x, y, north, east = (values[there] - values[there][0] for values in places)
    far = np.hypot(x, y), np.hypot(north, east)
    least = max(SETTINGS.scatter_of_fixes, SETTINGS.least_separation_share * float(np.max(far)))
    if float(np.quantile(np.abs(far[0] - far[1]), SETTINGS.rows)) < least:
        return []
    sizes = f"up to {np.max(far[0]):.3g} m, {' and '.join(globe)} up to {np.max(far[1]):.3g} m"
    return [
        f"x and y lead away from their first place by {sizes}: in what unit are they, and which is right?"
    ]


def _beside_globe(globe: Sequence[str], data: Mapping[str, Array], dead: set[str]) -> list[str]:
    """A question where other columns of latitude and longitude are farther away than fixes scatter."""
    away = {}
    for pair in places_called_so(c for c in data if c not in dead) if globe else []:
        far = 0.0 if {*pair} & {*globe} else _apart(globe, pair, data)
        if far > SETTINGS.scatter_of_fixes:
            away[pair] = far
    if not away:
        return []
    others = "; ".join(f"{' and '.join(pair)}, {far:.3g} m away" for pair, far in away.items())
    return [_WHICH.format(" and ".join(globe), others)]


def _apart(globe: Sequence[str], other: Sequence[str], data: Mapping[str, Array]) -> float:
    """Median distance of two places, m; 0 where they are nowhere known both."""
    (lat, lon), (north, east) = (in_degrees(*((n, data[n]) for n in pair)) for pair in (globe, other))
    known = np.isfinite(lat) & np.isfinite(lon) & np.isfinite(north) & np.isfinite(east)
    if not known.any() or not np.nanmax(np.abs([lat[known], north[known]])) <= SETTINGS.pole:
        return 0.0
    sizes = metres_per_degree(float(lat[known][0]))
    return float(np.median(np.hypot((north - lat)[known] * sizes[0], (east - lon)[known] * sizes[1])))


def _beside_number(motion: Mapping[str, Name], data: Mapping[str, Array], dead: set[str]) -> list[str]:
    """A question where x and y that differ from those that are used by a number alone lead elsewhere."""
    if not {"x", "y"} <= motion.keys():
        return []
    x, y = (motion[channel].column for channel in "xy")
    rows = rows_by_number(c for c in data if c not in dead)
    several = [next((row for row in rows if own in row), []) for own in (x, y)]
    way = max(float(np.nanmax(data[own]) - np.nanmin(data[own])) for own in (x, y))
    others = []
    for pair in zip(*several, strict=False):
        apart = np.hypot(data[pair[0]] - data[x], data[pair[1]] - data[y])
        known = apart[np.isfinite(apart)]
        if len(known) and float(np.median(known)) > SETTINGS.least_separation_share * way:
            others.append(f"{pair[0]} and {pair[1]}")
    return [_WHICH.format(f"{x} and {y}", "; ".join(others))] if others else []


_WHICH = "{} give the place; so do {}: which are those of the vehicle?"
