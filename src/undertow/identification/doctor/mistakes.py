"""The usual mistakes in how a log is read: units, axes, signs, angles; and how each is undone."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import product

import numpy as np

from undertow.identification.findings import Finding
from undertow.identification.logs.guess_names import position_axes
from undertow.identification.logs.guess_rows import is_time_of_day, seconds_of_day
from undertow.identification.logs.mapping import (
    FLIPPED_BODY,
    SECONDS,
    Column,
    Edit,
    Edits,
    LogMapping,
    attitude_of,
    column_edit,
    column_of,
    edited,
    frames_edits,
    metres_per_degree,
    reassigned,
    swap_attitude,
    swap_body,
    swap_position,
    turned_name,
    velocity_to_body,
    velocity_to_earth,
)
from undertow.identification.logs.run import (
    JUMPS,
    Run,
    across_jump,
    far_from_usual,
    unwrapped,
    upright,
    with_reports,
    without_jumps,
)
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.units import scale_offset
from undertow.typing import Array

from .kinematics import Kinematics, changes, measured

Channels = dict[str, Array]
Undo = Callable[[Run], Run]


@dataclass(frozen=True)
class Mistake:
    """A mistake in how a log is read."""

    id: str  # name of the kind
    clause: str  # what is wrong, as a clause: "the heading is in degrees, read as radians"
    undo: Undo  # takes a run with the mistake and returns it as it would be without
    # Takes the mapping that the log was read by and returns what to change in it.
    edits: Callable[[LogMapping], Edits]
    # Number of single mistakes in it: of two explanations the simpler one is preferred.
    count: int = 1
    vehicle: str = ""  # what to change in the vehicle file to the same end; empty where nothing there can
    combined: tuple[Mistake, ...] = ()  # the two that it is made of, if it is


@dataclass(frozen=True)
class Explanation:
    """A mistake that explains what is wrong with logs."""

    mistake: Mistake
    text: str  # the mistake and the evidence for it, in one line
    evidence: dict[str, float]
    rivals: list[Mistake] = field(default_factory=list)  # others that explain it as well


def with_channels(run: Run, channels: Mapping[str, Array]) -> Run:
    """A run with some channels replaced."""
    return replace(run, channels={**run.channels, **channels})


def scaling(factors: Mapping[str, float]) -> Undo:
    """Multiply channels by factors, and what is known of their noise."""

    def undo(run: Run) -> Run:
        sigma = {n: abs(f) * run.sigma[n] for n, f in factors.items() if n in run.sigma}
        scaled = {n: f * run.channels[n] for n, f in factors.items() if run.has(n)}
        return replace(with_channels(run, scaled), sigma={**run.sigma, **sigma})

    return undo


def rescaled(
    kind: str, clause: str, factors: Mapping[str, float], count: int = 1, vehicle: str = ""
) -> Mistake:
    """Channels that have to be multiplied by factors."""

    def edits(mapping: LogMapping) -> Edits:
        return tuple(column_edit(mapping, n, times=f) for n, f in factors.items())

    return Mistake(kind, clause, scaling(factors), edits, count, vehicle)


def in_units(units: Mapping[str, str]) -> Callable[[LogMapping], Edits]:
    """State other units of channels."""
    return lambda mapping: tuple(column_edit(mapping, n, unit=unit) for n, unit in units.items())


def exchanged(kind: str, clause: str, places: Mapping[str, tuple[str, float]], vehicle: str = "") -> Mistake:
    """Columns that stand for other channels: channel to (channel that it stands for now, sign)."""

    def undo(run: Run) -> Run:
        return with_channels(run, {n: sign * run.channels[source] for n, (source, sign) in places.items()})

    return Mistake(kind, clause, undo, lambda m: reassigned(m, places), vehicle=vehicle)


def changed_axes(swap: Callable[[Mapping[str, Array]], Channels]) -> Undo:
    """Apply a change of axes to all channels."""
    return lambda run: replace(run, channels=swap(run.channels))


def combined(first: Mistake, second: Mistake) -> Mistake:
    """Two mistakes at once."""

    def edits(mapping: LogMapping) -> Edits:
        before = first.edits(mapping)
        return (*before, *second.edits(edited(mapping, before)))

    return Mistake(
        f"{first.id}+{second.id}",
        f"{first.clause}, and {second.clause}",
        lambda run: second.undo(first.undo(run)),
        edits,
        first.count + second.count,
        combined=(first, second),
    )


@dataclass(frozen=True)
class PlausibilitySettings:
    """Thresholds beyond which a log is not only suspicious but impossible.

    Each stands several times farther out than anything in the sound logs of the benchmarks (ten vehicles,
    every effect of the catalogue hidden at up to twice its usual size, currents up to 1 m/s) and in four real
    data sets, and well below the factors of the units that it is to find.
    """

    # Share of the motion (mean square) by which pose rates and velocities disagree, if one usual mistake
    # explains it. Misaligned sensors reach 0.12, a current as fast as the vehicle is recognised as one.
    contradiction: float = 0.3
    # The same where a unit explains it: a factor is no matter of frames or angles. Knots make 0.19, the
    # largest scale error of a sensor (see `scale`) 0.09.
    other_unit: float = 0.12
    # Share of the motion by which the two may still disagree once a mistake is undone: beyond a half they
    # have more apart than in common, and a motion that is scaled away agrees with anything.
    agreement: float = 0.5
    # weakest, strongest: force that the motion needs over the one commanded. Simulated logs stay within 0.3
    # and 3, lags included; a work-class ROV answers in yaw with 0.08 of what its file has. Degrees make 57,
    # cm/s 100, the usual pulse widths 0.02 and less.
    weakest: float = 0.025
    strongest: float = 20.0
    # Force that the motion needs over the one commanded from which the doctor asks for the unit; weak
    # thrusters and added mass that is held too small stay below.
    doubtful: float = 2.5
    stated: float = 2.0  # standard deviations by which inertia and thrust in the vehicle file may be off
    unit_tolerance: float = 1.25  # factor within which a unit must explain that
    near: float = 4.0  # factor within which the two must agree once a mistake is undone
    errors: float = 8.0  # standard errors by which a gain stands out of its scatter
    # Of the motion, beside what other forces explain, that commands must explain to be evidence. With a gain
    # below `weakest`, commands of a sound log explain a hundredth of that.
    share: float = 0.3
    # Speed over sqrt(g V^(1/3)), V the volume of the mass in water: torpedoes reach 11, fast ships 4.
    froude: float = 12.0
    # slowest, fastest: that limit is never taken below or above these speeds, m/s: small racing boats, and
    # the fastest hulls.
    slowest: float = 10.0
    fastest: float = 75.0
    # Centripetal acceleration at V^(1/3) from the axis, in g: small vehicles on the spot reach 0.2.
    turning: float = 1.0
    exceeding: float = 0.05  # share of the samples that exceed what is taken for the speed of a log
    small_step: float = 0.5  # change of an angle from sample to sample beside a jump, rad
    # Pitch ends upright: beyond that, in more than such a share of the samples, it is none, rad.
    pitch: float = 1.05 * np.pi / 2
    pitch_share: float = 0.01
    # Rms of a command over its limit in the vehicle file. Controllers that wind up log a few times the limit;
    # thousandths and pulse widths (1500) are far beyond.
    limit: float = 10.0
    limit_undone: float = 1.5  # the same up to which a unit explains it
    # Factor within which a scale of commands is taken for a power of ten.
    power_of_ten: float = 2.5
    # beyond, often: command over its limit that counts as beyond it, and the share of such samples from which
    # it is said. A limit is stated to two or three digits.
    over_limit: float = 1.02
    over_limit_share: float = 0.01
    # Normalised command beyond full power, and share of such samples from which commands are not normalised;
    # an output that is switched off reads 0.
    beyond_full: float = 1.5
    beyond_full_share: float = 0.5
    # Rms of the angle of a rudder or fin, rad: a right angle, at which it would be a wall; 2 degrees make 2.
    angle: float = 1.571
    # Share of its reading by which a velocity sensor may be wrong in scale; knots read as m/s are 0.49.
    scale: float = 0.35
    # Share by which pose rates over velocities may differ from the factor of a unit: scales and currents do
    # less, and neighbouring units of time are farther apart.
    ratio: float = 0.3
    # Factor beyond which no unit of a command is off: kN, percent, microseconds and rpm are within.
    command: float = 2e4
    samples: int = 4000  # samples that are looked at, the most_active: more would only cost time


PLAUSIBLE = PlausibilitySettings()


# Units that people log in, the likelier first; the unit of a velocity stands below that of its position.
_LENGTHS = {"m": "m/s", "mm": "mm/s", "cm": "cm/s", "ft": "ft/s"}
_SPEEDS = ("m/s", "mm/s", "cm/s", "knot", "km/h", "ft/s")
POSITIONS, SPEEDS = ("x", "y", "z"), ("u", "v", "w")
UNITS_OF_MOTION = frozenset({"length_unit", "speed_unit", "motion_unit"})
"""Ids of the mistakes in units of position and velocity."""


# --- time ---------------------------------------------------------------------------------------
def other_time_unit(kinematics: Kinematics, runs: Sequence[Run], mapping: LogMapping) -> Mistake | None:
    """The unit of the time column in which pose rates and velocities have the same size."""
    # Where only positions, or only angles, can be compared with velocities, a unit of those explains the
    # same: a usual step that is far too short or too long is then evidence for the time.
    if not kinematics or any(run.derived for run in runs):
        return None
    ratio = _pose_rate_over_velocity(kinematics, runs)
    linear = {*kinematics.rows} & {*POSITIONS}
    linear_and_angular = bool(linear) and len(linear) < len(kinematics.rows)
    units = _time_units(mapping) if linear_and_angular else likely_time_units(runs, mapping)
    found = next(((m, f) for m, f in units if abs(ratio / f - 1.0) < PLAUSIBLE.ratio), None)
    # A minute has 60 seconds, a radian 57.3 degrees: of angles alone the nearer of them is meant.
    degrees = [] if linear else [180 / np.pi, np.pi / 180]
    if found is None or any(abs(np.log(ratio / d)) < abs(np.log(ratio / found[1])) for d in degrees):
        return None
    return found[0]


def times_of_day(runs: Sequence[Run], mapping: LogMapping) -> Explanation | None:
    """Hours, minutes and seconds side by side, where a minute seems to last a hundred seconds."""
    offset, plain = mapping.time.offset, mapping.time.unit == "s" and mapping.time.interval is None
    clocks = [run.t - offset for run in runs]
    if not plain or not all(t[0] >= 10_000.0 and is_time_of_day(t) for t in clocks):
        return None
    mistake = Mistake(
        "time_unit",
        "the times are hours, minutes and seconds side by side (hhmmss), read as s",
        lambda run: replace(run, t=seconds_of_day(run.t - offset) + offset),
        lambda m: (Edit("time", "unit", "iso"),),
    )
    last = max(range(len(runs)), key=lambda k: float(np.max(np.diff(clocks[k]))))
    at = int(np.argmax(np.diff(clocks[last])))
    text = f"{clocks[last][at]:.9g} is followed by {clocks[last][at + 1]:.9g}"
    return Explanation(mistake, f"{mistake.clause}: {text}", {})


def likely_time_units(runs: Sequence[Run], mapping: LogMapping) -> Iterator[tuple[Mistake, float]]:
    """Units of the time column in which logs have a step that is usual, or nearer to that than as read."""
    step = float(np.median(np.concatenate([np.diff(run.t) for run in runs])))
    as_read = far_from_usual(step)
    yield from ((m, factor) for m, factor in _time_units(mapping) if far_from_usual(factor * step) < as_read)


def _time_units(mapping: LogMapping) -> Iterator[tuple[Mistake, float]]:
    """Every other unit of the time column, and what it multiplies times by."""
    if mapping.time.interval is not None:  # no clock was read
        return
    unit = mapping.time.unit
    for other, seconds in SECONDS.items():
        if unit in SECONDS and other != unit:
            factor = seconds / SECONDS[unit]
            yield (
                Mistake(
                    "time_unit",
                    f"the times are in {other}, read as {unit}",
                    lambda run, factor=factor: _with_clock_factor(run, factor),  # type: ignore[misc]
                    lambda m, other=other: (Edit("time", "unit", other),),  # type: ignore[misc]
                ),
                factor,
            )


def _with_clock_factor(run: Run, factor: float) -> Run:
    """A run whose clock goes by a factor; what was derived from its pose is slower by it."""
    moved = with_channels(run, {n: run.channels[n] / factor for n in run.derived})
    return replace(moved, t=factor * run.t, resolution=factor * run.resolution)


def _pose_rate_over_velocity(kinematics: Kinematics, runs: Sequence[Run]) -> float:
    """Ratio of the rms of both, the same for every pose rate; NaN where they differ in it."""
    rates = kinematics.rates(runs)
    pose, velocity = (np.sqrt(np.mean(a**2, axis=0)) for a in (rates.pose, rates.velocity))
    ratios = pose / np.maximum(velocity, 1e-30)
    middle = float(np.median(ratios))
    return middle if np.all(np.abs(ratios / middle - 1.0) < PLAUSIBLE.ratio) else float("nan")


# --- lengths and speeds -------------------------------------------------------------------------
def other_units_of_motion(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """Velocities, positions or both in another unit; all of a kind, or some of them."""
    for names in _present_groups((SPEEDS, *((n,) for n in SPEEDS)), moving):
        yield from (_in_unit("speed_unit", mapping, names, unit, unit) for unit in _SPEEDS)
    for names in _present_groups((POSITIONS, ("x", "y"), ("z",)), moving):
        yield from (_in_unit("length_unit", mapping, names, unit, unit) for unit in _LENGTHS)
    positions, speeds = (tuple(n for n in group if n in moving) for group in (POSITIONS, SPEEDS))
    if positions and speeds:
        names = (*positions, *speeds)
        yield from (_in_unit("motion_unit", mapping, names, *units) for units in _LENGTHS.items())


def _present_groups(groups: Sequence[tuple[str, ...]], moving: set[str]) -> Iterator[tuple[str, ...]]:
    """What there is of each group, each set once."""
    found = (tuple(n for n in group if n in moving) for group in groups)
    yield from dict.fromkeys(names for names in found if names)


def _in_unit(kind: str, mapping: LogMapping, names: tuple[str, ...], length: str, speed: str) -> Mistake:
    """Some channels in a unit of length, or of speed, that the mapping does not say."""
    units = {n: length if n in POSITIONS else speed for n in names}
    read_as = {n: column_of(mapping, n)[1].unit or ("m" if n in POSITIONS else "m/s") for n in names}
    factors = {n: scale_offset(units[n], read_as[n])[0] for n in names}
    clause = " and ".join(dict.fromkeys(units.values()))
    was = " and ".join(dict.fromkeys(read_as.values()))
    what = f"{names_with_verb(names)} in {clause}, read as {was}"
    return Mistake(kind, what, scaling(factors), in_units(units))


def degrees_of_the_globe(mapping: LogMapping, runs: Sequence[Run]) -> Iterator[Mistake]:
    """Latitude and longitude in degrees, read as metres; either of them as x."""
    columns = [column_of(mapping, n) for n in "xy"]
    if not (measured(runs, "x") and measured(runs, "y")):
        return
    if any(n in mapping.channels or c != Column(channel=c.channel, unit=c.unit) for n, c in columns):
        return
    for names in (("x", "y"), ("y", "x")):
        logged = [np.concatenate([run.channels[n] for run in runs]) for n in names]
        first = [float(values[np.isfinite(values)][0]) for values in logged]
        if np.nanmax(np.abs(logged[0])) > 90.0 or np.nanmax(np.abs(logged[1])) > 360.0:
            continue
        places = [*zip("xy", names, first, metres_per_degree(first[0]), strict=True)]

        def undo(run: Run, places: list[tuple[str, str, float, float]] = places) -> Run:
            return with_channels(run, {n: (run.channels[f] - d) * s for n, f, d, s in places})

        def edits(m: LogMapping, places: list[tuple[str, str, float, float]] = places) -> Edits:
            position = m.frames.position
            return tuple(
                Edit(
                    "columns",
                    column_of(m, f)[0],
                    {"channel": turned_name(n, position), "scale": s, "offset": -d * s},
                )
                for n, f, d, s in places
            )

        which = f"{names[0]} is the latitude and {names[1]} the longitude"
        yield Mistake("length_unit", f"{which} in degrees, read as m", undo, edits)


ANGLES, RATES = ("phi", "theta", "psi"), ("p", "q", "r")
_SWAPS: dict[str, Callable[[Mapping[str, Array]], Channels]] = {
    "position": swap_position,
    "body": swap_body,
    "attitude": swap_attitude,
}
_OTHER = {"NED": "ENU", "ENU": "NED", "FRD": "FLU", "FLU": "FRD"}
_UPWARDS = {"z": "z is positive upwards (height; undertow's z is depth)"}


def reading_mistakes(mapping: LogMapping, runs: Sequence[Run]) -> list[Mistake]:
    """All of them, the likelier ones first, as far as channels that move can show them.

    Left out are mistakes without which a log would lack a channel that it has, as one with x but no y, and
    radians in which no vehicle can have the angles that were logged.
    """
    moving = {n for n in (*POSE, *VELOCITY) if measured(runs, n) and changes(runs, n)}
    # North taken for east leaves no north where only one of them was logged: that cannot be tried.
    few = [run.head(2) for run in runs]
    known = [mistake for kind in KINDS for mistake in kind(mapping, moving)]
    known += degrees_of_the_globe(mapping, runs)
    complete = [m for m in known if all(m.undo(run).channels.keys() >= run.channels.keys() for run in few)]
    return [m for m in complete if m.id != "radians_for_degrees" or not _upside_down(m, runs)]


def _upside_down(mistake: Mistake, runs: Sequence[Run]) -> bool:
    """Whether the vehicle pitches beyond upright once a mistake is undone."""
    return any(_tilted(_present_angles(mistake.undo(run), "theta")) for run in runs)


def _tilted(pitch: Array) -> bool:
    """Whether pitch is too large to be in radians."""
    return bool(len(pitch) and np.mean(np.abs(pitch) > PLAUSIBLE.pitch) > PLAUSIBLE.pitch_share)


# --- units ------------------------------------------------------------------------------------
def read_in_degrees(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """Angles, rates or both in degrees and read as radians, or the other way round."""
    tilt, turn = (("phi", "theta"), ("p", "q")), (("psi",), ("r",))
    both = ((*angles, *rates) for angles, rates in (tilt, turn))
    groups = [(*ANGLES, *RATES), ANGLES, RATES, *both, *tilt, *turn]
    for names in _present_groups(groups, moving):
        deg = any("deg" in (column_of(mapping, n)[1].unit or "") for n in names)
        is_in, read_as = ("radians", "degrees") if deg else ("degrees", "radians")
        factor = 180 / np.pi if deg else np.pi / 180
        units = {n: ("rad" if deg else "deg") + ("/s" if n in RATES else "") for n in names}
        yield Mistake(
            "radians_for_degrees" if deg else "degrees_for_radians",
            f"{names_with_verb(names)} in {is_in}, read as {read_as}",
            _rescaled(names, factor, np.pi / 2 if attitude_of(mapping) == "ENU" else 0.0),
            in_units(units),
        )


def _rescaled(names: tuple[str, ...], factor: float, heading_zero: float) -> Undo:
    """Rescale angles as the log has them, and unwrap them afterwards."""

    def undo(run: Run) -> Run:
        new = scaling(dict.fromkeys(names, factor))(run)
        if "psi" in names and run.has("psi"):
            given = run.wrapped.get("psi", run.channels["psi"])
            new = with_reports(new, {"psi": unwrapped(heading_zero + factor * (given - heading_zero))})
        return new

    return undo


# --- axes -------------------------------------------------------------------------------------
def other_frames(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """ENU for NED and FLU for FRD, for position, attitude and body axes apart or together."""
    spec = mapping.frames
    now = {"position": spec.position, "body": spec.body, "attitude": attitude_of(mapping)}
    bodies = (False, True) if moving & {*FLIPPED_BODY} else (False,)
    choices = [c for c in product((False, True), bodies, (False, True)) if any(c)]
    named = position_axes(mapping) == spec.position
    for chosen in sorted(choices, key=sum):
        wrong = [key for key, yes in zip(now, chosen, strict=True) if yes]
        meant = {key: _OTHER[value] if key in wrong else value for key, value in now.items()}
        # ENU with FLU is a convention of its own (ROS): taking it for NED and FRD is one mistake. Names of
        # columns that say what they are read as would be another.
        together = len(wrong) == 3
        misnamed = named and "position" in wrong
        yield Mistake(
            "frame",
            _frames_clause(wrong, meant),
            _turned_axes(wrong, spec.velocity),
            lambda m, meant=meant: frames_edits(m, **meant),  # type: ignore[misc]
            (1 if together else len(wrong)) + misnamed,
        )


_FRAMES = {
    "NED": "x, y, z are north, east, down (NED), read as east, north, up",
    "ENU": "x, y, z are east, north, up (ENU), read as north, east, down",
    "FRD": "body axes are forward, starboard, down (FRD), read as forward, left, up",
    "FLU": "body axes are forward, left, up (FLU), read as forward, starboard, down",
}
_HEADINGS = {
    "NED": "the heading is measured clockwise from north (NED), read as anticlockwise from east",
    "ENU": "the heading is measured anticlockwise from east (ENU), read as clockwise from north",
}


def _frames_clause(wrong: list[str], meant: dict[str, str]) -> str:
    if len(wrong) == 3:
        read = "NED and FRD" if meant["body"] == "FLU" else "ENU and FLU"
        return f"the log is in {meant['position']} and {meant['body']} axes, read as {read}"
    return ", and ".join((_HEADINGS if key == "attitude" else _FRAMES)[meant[key]] for key in wrong)


def _turned_axes(keys: list[str], velocity: str) -> Undo:
    """Turn some of position, body and attitude; velocities along the earth go with the position."""

    def turn(channels: Mapping[str, Array]) -> Channels:
        return reduce(lambda found, key: _SWAPS[key](found), keys, dict(channels))

    def turn_along_the_earth(channels: Mapping[str, Array]) -> Channels:
        earth = velocity_to_earth(channels)
        turned = swap_position(earth) if "position" in keys else earth
        linear = {n: turned[axis] for n, axis in zip("uvw", "xyz", strict=True) if n in channels}
        return velocity_to_body({**turn(channels), **linear}, "NED")

    return changed_axes(turn if velocity == "body" else turn_along_the_earth)


def velocity_along_the_earth(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """Velocities north, east, down (or east, north, up) given as body velocities."""
    if mapping.frames.velocity != "body" or not {"u", "v", "psi"} <= moving:
        return
    flu = mapping.frames.body == "FLU"
    for axes, clause in (("NED", "north, east, down"), ("ENU", "east, north, up")):

        def swap(channels: Mapping[str, Array], axes: str = axes) -> Channels:
            given = swap_body(channels) if flu else channels
            linear = {n: given[n] for n in ("u", "v", "w") if n in given}
            return velocity_to_body({**channels, **linear}, axes)

        yield Mistake(
            "velocity_in_ned",
            f"u, v, w are velocities {clause}, read as velocities along body axes",
            changed_axes(swap),
            lambda m, axes=axes: (Edit("frames", "velocity", axes),),  # type: ignore[misc]
        )


def swapped_position(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """East and north in each other's place, with depth as it should be."""
    if {"x", "y"} <= moving:
        yield exchanged("swapped_position", "x and y are swapped (x is north, y is east)", _EAST_NORTH)


_EAST_NORTH = {"x": ("y", 1.0), "y": ("x", 1.0)}


# --- signs and quarter turns ------------------------------------------------------------------
def flipped_axes(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """One channel with the opposite sign."""
    for name in (*POSE, *VELOCITY):
        if name not in moving or (name == "psi" and attitude_of(mapping) == "ENU"):
            continue  # a heading from east does not count from zero inside
        yield rescaled("flipped_axis", _UPWARDS.get(name, f"{name} has the opposite sign"), {name: -1.0})


def turned_heading(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """A heading that counts from another direction than north, by a quarter or half turn."""
    yield from (heading_off_by(q * np.pi / 2, mapping) for q in (1, -1, 2) if "psi" in moving)


def heading_off_by(angle: float, mapping: LogMapping) -> Mistake:
    """A heading from which such an angle is missing, rad."""
    sign = -1.0 if attitude_of(mapping) == "ENU" else 1.0

    def undo(run: Run) -> Run:
        return with_channels(run, {"psi": run.channels["psi"] + angle})

    def edits(m: LogMapping) -> Edits:
        column = column_of(m, "psi")[1]
        shift = sign * (np.degrees(angle) if column.unit == "deg" else angle)
        return (column_edit(m, "psi", offset=column.offset + round(shift, 6)),)

    return Mistake("heading_offset", f"psi is off by {np.degrees(angle):+.3g} degrees", undo, edits)


def turned_velocity(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """A velocity sensor mounted a quarter or half turn about the vertical from the body axes."""
    turns = {
        "90 degrees clockwise": {"u": ("v", -1.0), "v": ("u", 1.0)},
        "90 degrees anticlockwise": {"u": ("v", 1.0), "v": ("u", -1.0)},
        "by half a turn": {"u": ("u", -1.0), "v": ("v", -1.0)},
    }
    for how, places in turns.items() if {"u", "v"} <= moving else ():
        yield exchanged(
            "turned_velocity", f"u and v come from a sensor that is mounted rotated {how}", places
        )


def swapped_velocity(mapping: LogMapping, moving: set[str]) -> Iterator[Mistake]:
    """Velocities ahead and sideways in each other's place, each with its sign."""
    if {"u", "v"} <= moving:
        clause = "u and v are swapped (u is sideways, v is ahead)"
        yield exchanged("swapped_velocity", clause, {"u": ("v", 1.0), "v": ("u", 1.0)})


def names_with_verb(names: tuple[str, ...]) -> str:
    """The names of channels with "is" or "are"."""
    return f"{', '.join(names)} {'is' if len(names) == 1 else 'are'}"


KINDS: tuple[Callable[[LogMapping, set[str]], Iterator[Mistake]], ...] = (
    read_in_degrees,
    other_units_of_motion,
    other_frames,
    velocity_along_the_earth,
    swapped_position,
    flipped_axes,
    turned_heading,
    turned_velocity,
    swapped_velocity,
)


def wrapped_angles(runs: Sequence[Run]) -> Iterator[Explanation]:
    """Angles that jump by a whole turn."""
    for name in ANGLES:
        count = sum(_full_turns(run, name) for run in runs)
        if count:
            mistake = Mistake(
                "wrapped_angle",
                f"{name} jumps by a full turn {count} times",
                lambda run, name=name: _unwrapped(run, name),  # type: ignore[misc]
                lambda m, name=name: (column_edit(m, name, wrapped=True),),  # type: ignore[misc]
            )
            text = f"{mistake.clause}: no vehicle turns so fast"
            yield Explanation(mistake, text, {"times": float(count)})


def in_degrees(runs: Sequence[Run], mapping: LogMapping, names: Sequence[str]) -> Explanation | None:
    """Pitch that is too large, or a heading that turns too fast, to be in radians."""
    pitch = [_present_angles(run, "theta") for run in runs if "theta" in names]
    tilted = any(_tilted(p) for p in pitch)
    turn = max((_turned_in_a_second(run) for run in runs if "psi" in names), default=0.0)
    if not tilted and turn < JUMPS.fastest:
        return None
    known = [m for m in reading_mistakes(mapping, runs) if m.id == "degrees_for_radians"]
    wanted = {n for n in (ANGLES if tilted else ("psi",)) if runs[0].has(n)}
    found = next((m for m in known if changed_channels(m, runs[0]) == wanted), None)
    if found is None:
        return None
    reason = f"psi changes by {turn:.3g} in an ordinary second"
    if tilted:
        reason = f"theta reaches {max(np.abs(p).max() for p in pitch):.3g} in the log"
    return Explanation(found, f"{found.clause}: {reason}, which no vehicle can have in radians", {})


def changed_channels(mistake: Mistake, run: Run) -> set[str]:
    """Channels that undoing a mistake changes."""
    after = mistake.undo(run)
    return {n for n in run.channels if not np.array_equal(after.channels[n], run.channels[n], equal_nan=True)}


def _turned_in_a_second(run: Run) -> float:
    """Median change of the heading in a second, as it is in the log: jumps of a wrapped angle are few."""
    given = run.wrapped.get("psi", run.channels.get("psi", np.zeros(0)))
    there = np.flatnonzero(np.isfinite(given))
    if len(there) < 3:
        return 0.0
    t, psi = run.t[there], given[there]
    later = np.searchsorted(t, t + 1.0)
    inside = later < len(t)
    return float(np.median(np.abs(psi[later[inside]] - psi[inside]))) if np.any(inside) else 0.0


def _unwrapped(run: Run, name: str) -> Run:
    if not run.has(name):
        return run
    angle = run.reports(name) if name == "psi" else upright(run.reports(name))
    return with_reports(run, {name: without_jumps(run.t, angle)})


def _full_turns(run: Run, name: str) -> int:
    """Steps by a turn between small ones: where those beside them are large, too, it only turns fast."""
    step = np.abs(np.diff(_present_angles(run, name)))
    beside = np.pad(step, 1)
    alone = np.maximum(beside[:-2], beside[2:]) < 2 * PLAUSIBLE.small_step
    return int(np.sum((np.abs(step - 2 * np.pi) < JUMPS.tolerance) & alone))


def _present_angles(run: Run, name: str) -> Array:
    """Reports of an angle: curves between those of a slow one go through its jumps."""
    data = run.reports(name) if run.has(name) else np.zeros(0)
    return data[np.isfinite(data)]


def angles_across_jumps(runs: Sequence[Run]) -> Iterator[Finding]:
    """An angle that was interpolated, or averaged, across its jump by a turn."""
    logged = ((run, name) for run, name in product(runs, ANGLES) if run.has(name))
    for run, name in logged:
        count = int(np.sum(across_jump(run.t, run.wrapped.get(name, run.reports(name)))))
        if not count:
            continue
        left_out = name in run.wrapped
        yield Finding(
            id="angle_across_its_jump",
            severity="note" if left_out else "warning",
            text=f"{run.name}: {name} was interpolated or averaged across its jump by a turn; "
            f"{count} of its samples are {'left out' if left_out else 'wrong: unwrap it before resampling'}",
            evidence={"samples": float(count)},
        )
