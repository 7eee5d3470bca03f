"""The usual mistakes in how a log is read that show in its kinematics: units, axes and signs.

One function yields one kind of mistake. To add a kind, write such a function and put it into `KINDS`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product

import numpy as np

from undertow.typing import Array

from ..logs import Mapping as LogMapping
from ..logs import Run, frames
from ..logs.run import POSE, VELOCITY
from .mending import Edit, Edits, attitude_of, column_edit, column_of, frames_edits, reassigned
from .mistake import Channels, Mistake, Undo, scaling, turning, with_channels
from .units import other_units_of_motion

ANGLES, RATES = ("phi", "theta", "psi"), ("p", "q", "r")
_SWAPS: dict[str, Callable[[Mapping[str, Array]], Channels]] = {
    "position": frames.swap_position,
    "body": frames.swap_body,
    "attitude": frames.swap_attitude,
}
_OTHER = {"NED": "ENU", "ENU": "NED", "FRD": "FLU", "FLU": "FRD"}
_UPWARDS = {"z": "z counts upwards (it is height, and undertow's z is depth)"}


def reading_mistakes(mapping: LogMapping, runs: Sequence[Run]) -> list[Mistake]:
    """All of them, the likelier ones first.

    Parameters
    ----------
    mapping : Mapping
        How the log was read: what it says may itself be the mistake.
    runs : sequence of Run
        Logs; channels that they lack, or that never change, are left out, and so are mistakes without which
        a log would lack a channel that it has, as one with x but no y in other axes.
    """
    moving = {
        n
        for n in (*POSE, *VELOCITY)
        if all(r.has(n) and n not in r.derived for r in runs) and any(_changes(r, n) for r in runs)
    }
    # North taken for east leaves no north where only one of them was logged: that cannot be tried.
    few = [run.head(2) for run in runs]
    known = (mistake for kind in KINDS for mistake in kind(mapping, moving))
    return [m for m in known if all(m.undo(run).channels.keys() >= run.channels.keys() for run in few)]


def _changes(run: Run, name: str) -> bool:
    return bool(np.nanmax(run.channels[name]) > np.nanmin(run.channels[name]))


# --- units ------------------------------------------------------------------------------------
def in_degrees(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """Angles, rates or both in degrees and read as radians, or the other way round."""
    tilt, turn = (("phi", "theta"), ("p", "q")), (("psi",), ("r",))
    groups = [
        (*ANGLES, *RATES),
        ANGLES,
        RATES,
        *((*angles, *rates) for angles, rates in (tilt, turn)),
        *tilt,
        *turn,
    ]
    found = (tuple(n for n in group if n in moving) for group in groups)
    for names in filter(None, dict.fromkeys(found)):
        deg = any("deg" in (column_of(mapping, n)[1].unit or "") for n in names)
        is_in, read_as = ("radians", "degrees") if deg else ("degrees", "radians")
        factor = 180 / np.pi if deg else np.pi / 180
        yield Mistake(
            "radians_for_degrees" if deg else "degrees_for_radians",
            f"{_listed(names)} in {is_in}, read as {read_as}",
            _rescaled(names, factor, np.pi / 2 if attitude_of(mapping) == "ENU" else 0.0),
            lambda m, names=names, deg=deg: _unit_edits(m, names, "rad" if deg else "deg"),  # type: ignore[misc]
        )


def _rescaled(names: tuple[str, ...], factor: float, heading_zero: float) -> Undo:
    """Rescale angles as the log has them, and unwrap them afterwards."""

    def undo(run: Run) -> Run:
        new = scaling(dict.fromkeys(names, factor))(run)
        if "psi" in names and run.has("psi"):
            given = run.wrapped.get("psi", run.channels["psi"])
            new = with_channels(new, {"psi": unwrapped(heading_zero + factor * (given - heading_zero))})
        return new

    return undo


def unwrapped(angle: Array) -> Array:
    """An angle without jumps by turns; missing samples stay missing."""
    there, result = np.isfinite(angle), angle.copy()
    result[there] = np.unwrap(angle[there])
    return result


def _unit_edits(mapping: LogMapping, names: tuple[str, ...], unit: str) -> Edits:
    return tuple(column_edit(mapping, n, unit=unit + ("/s" if n in RATES else "")) for n in names)


# --- axes -------------------------------------------------------------------------------------
def other_frames(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """ENU for NED and FLU for FRD, for position, attitude and body axes apart or together."""
    spec = mapping.frames
    now = {"position": spec.position, "body": spec.body, "attitude": attitude_of(mapping)}
    bodies = (False, True) if moving & {*frames.FLIPPED_BODY} else (False,)
    choices = [c for c in product((False, True), bodies, (False, True)) if any(c)]
    for chosen in sorted(choices, key=sum):
        wrong = [key for key, yes in zip(now, chosen, strict=True) if yes]
        meant = {key: _OTHER[value] if key in wrong else value for key, value in now.items()}
        # ENU with FLU is a convention of its own (ROS): taking it for NED and FRD is one mistake.
        together = len(wrong) == 3
        yield Mistake(
            "frame",
            _frames_told(wrong, meant),
            _turned([_SWAPS[key] for key in wrong]),
            lambda m, meant=meant: frames_edits(m, **meant),  # type: ignore[misc]
            1 if together else len(wrong),
        )


_FRAMES = {
    "NED": "x, y, z are north, east, down (NED), read as east, north, up",
    "ENU": "x, y, z are east, north, up (ENU), read as north, east, down",
    "FRD": "body axes are forward, starboard, down (FRD), read as forward, left, up",
    "FLU": "body axes are forward, left, up (FLU), read as forward, starboard, down",
}
_HEADINGS = {
    "NED": "the heading counts from north clockwise (NED), read as from east anticlockwise",
    "ENU": "the heading counts from east anticlockwise (ENU), read as from north clockwise",
}


def _frames_told(wrong: list[str], meant: dict[str, str]) -> str:
    if len(wrong) == 3:
        read = "NED and FRD" if meant["body"] == "FLU" else "ENU and FLU"
        return f"the log is in {meant['position']} and {meant['body']} axes, read as {read}"
    return ", and ".join((_HEADINGS if key == "attitude" else _FRAMES)[meant[key]] for key in wrong)


def _turned(swaps: list[Callable[[Mapping[str, Array]], Channels]]) -> Undo:
    def swap(channels: Mapping[str, Array]) -> Channels:
        result = dict(channels)
        for one in swaps:
            result = one(result)
        return result

    return turning(swap)


def velocity_along_the_earth(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """Velocities north, east, down (or east, north, up) given as body velocities."""
    if mapping.frames.velocity != "body" or not {"u", "v", "psi"} <= moving:
        return
    flu = mapping.frames.body == "FLU"
    for axes, told in (("NED", "north, east, down"), ("ENU", "east, north, up")):

        def swap(channels: Mapping[str, Array], axes: str = axes) -> Channels:
            given = frames.swap_body(channels) if flu else channels
            linear = {n: given[n] for n in ("u", "v", "w") if n in given}
            return frames.velocity_to_body({**channels, **linear}, axes)

        yield Mistake(
            "velocity_in_ned",
            f"u, v, w are velocities {told}, read as velocities along body axes",
            turning(swap),
            lambda m, axes=axes: (Edit("frames", "velocity", axes),),  # type: ignore[misc]
        )


def swapped_position(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """East and north in each other's place, with depth as it should be."""
    if {"x", "y"} <= moving:
        yield _moved(
            "swapped_position", "x and y are in each other's place (x is north, y is east)", _EAST_NORTH
        )


_EAST_NORTH = {"x": ("y", 1.0), "y": ("x", 1.0)}


def _moved(kind: str, told: str, places: dict[str, tuple[str, float]]) -> Mistake:
    """Columns that stand for other channels: channel to (channel that it stands for now, sign)."""

    def undo(run: Run) -> Run:
        return with_channels(run, {n: sign * run.channels[source] for n, (source, sign) in places.items()})

    return Mistake(kind, told, undo, lambda m: reassigned(m, places))


# --- signs and quarter turns ------------------------------------------------------------------
def flipped(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """One channel with the opposite sign."""
    for name in (*POSE, *VELOCITY):
        if name not in moving or (name == "psi" and attitude_of(mapping) == "ENU"):
            continue  # a heading from east does not count from zero inside
        yield Mistake(
            "flipped_axis",
            _UPWARDS.get(name, f"{name} has the opposite sign"),
            scaling({name: -1.0}),
            lambda m, name=name: (column_edit(m, name, times=-1.0),),  # type: ignore[misc]
        )


def turned_heading(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """A heading that counts from another direction than north, by a quarter or half turn."""
    sign = -1.0 if attitude_of(mapping) == "ENU" else 1.0
    for quarters in (1, -1, 2) if "psi" in moving else ():
        angle = quarters * np.pi / 2

        def undo(run: Run, angle: float = angle) -> Run:
            return with_channels(run, {"psi": run.channels["psi"] + angle})

        def edits(m: LogMapping, angle: float = angle) -> Edits:
            column = column_of(m, "psi")[1]
            shift = sign * (np.degrees(angle) if column.unit == "deg" else angle)
            return (column_edit(m, "psi", offset=column.offset + round(shift, 6)),)

        yield Mistake("heading_offset", f"psi is off by {90 * quarters:+d} degrees", undo, edits)


def turned_velocity(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """A velocity sensor mounted a quarter or half turn about the vertical from the body axes."""
    turns = {
        "90 degrees clockwise": {"u": ("v", -1.0), "v": ("u", 1.0)},
        "90 degrees anticlockwise": {"u": ("v", 1.0), "v": ("u", -1.0)},
        "by half a turn": {"u": ("u", -1.0), "v": ("v", -1.0)},
    }
    for how, places in turns.items() if {"u", "v"} <= moving else ():
        yield _moved("turned_velocity", f"u and v are of a sensor that is mounted turned {how}", places)


def _listed(names: tuple[str, ...]) -> str:
    verb = "is" if len(names) == 1 else "are"
    return f"{', '.join(names)} {verb}"


KINDS: tuple[Callable[[LogMapping, set[str]], Iterator[Mistake]], ...] = (
    in_degrees,
    other_units_of_motion,
    other_frames,
    velocity_along_the_earth,
    swapped_position,
    flipped,
    turned_heading,
    turned_velocity,
)
