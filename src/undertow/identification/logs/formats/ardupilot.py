"""What logs of ArduPilot have in common: motors and frame by its parameters, stretches that move."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import tomlkit
from tomlkit.items import Table

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Column
from undertow.model.actuators import bundled_curves
from undertow.model.loading import resolve_vehicle
from undertow.typing import Array, Flags

from .fieldlog import FieldLog, cut_at

Stretch = tuple[float, float]
Parameters = Mapping[str, float | str]


@dataclass(frozen=True)
class MotionSettings:
    """When a vehicle counts as moving by itself, and how pulses become commands."""

    # Share of full output by which a motor leaves its rest: the dead band of a T200 with its speed controller
    # reaches to 0.07 at 16 V and 0.09 at 12 V, and pilots' sticks rest within half of that.
    off_rest: float = 0.04
    coast: float = 5.0  # s that are kept after the last motor stopped: drag without thrust is worth having
    shortest: float = 2.0  # s; a shorter stretch has nothing to tell
    told: float = 0.1  # s; a shorter part that is left out is not worth a word
    travel: float = 400.0  # microseconds from rest to full output; ArduSub has 1100 to 1900
    rest: float = 1500.0  # microseconds
    # Largest distance of a trim from `rest`, microseconds, that a thruster can have: others are of lights and
    # grippers, which rest at one end.
    trim: float = 100.0
    # The last bit of `solution status` with which an estimator says that it holds its place for want of aid.
    held: int = 1 << 7


SETTINGS = MotionSettings()


# --- motors ---------------------------------------------------------------------------------------
# SERVOn_FUNCTION of motors 1 … 8 and 9 … 12.
_MOTORS = {**{33 + k: k + 1 for k in range(8)}, **{82 + k: k + 9 for k in range(4)}}


def motors(parameters: Parameters) -> dict[int, int]:
    """Number of the output that drives each motor, by the number of the motor."""
    found = {}
    for name, value in parameters.items():
        output = re.fullmatch(r"SERVO(\d+)_FUNCTION", name)
        if output and isinstance(value, float) and value in _MOTORS:
            found[_MOTORS[int(value)]] = int(output[1])
    return dict(sorted(found.items()))


def actuators(
    parameters: Parameters, outputs: Mapping[int, tuple[str, Array]], firmware: str = ""
) -> tuple[tuple[tuple[str, Column], ...], list[str]]:
    """Outputs of motors as commands from -1 to 1.

    Parameters
    ----------
    parameters : mapping
        Of the autopilot.
    outputs : mapping of (str, array)
        Name of the column and pulses, microseconds, by the number of the output.
    firmware : str
        Its name, such as ArduSub V4.1.0; empty if the log does not say.

    Returns
    -------
    actuators : tuple of (str, Column)
        In the order of the motors.
    notes : list of str
    """
    found, notes = [], []
    by_motor = {motor: output for motor, output in motors(parameters).items() if output in outputs}
    if not by_motor:
        return (), ["no SERVOn_FUNCTION says which outputs drive motors: name them in a mapping file (--map)"]
    for motor, output in by_motor.items():
        name, pulses = outputs[output]
        rest, travel = _rest(parameters.get(f"SERVO{output}_TRIM"), pulses), SETTINGS.travel
        if rest != SETTINGS.rest:
            notes.append(f"motor {motor} rests at {rest:g} µs, the trim of output {output}")
        if parameters.get(f"SERVO{output}_REVERSED") == 1.0:
            # AP_Motors of ArduSub writes pulses, which pass by SERVOn_REVERSED; other programs write scaled
            # outputs, which it turns.
            heeded = not firmware.startswith("ArduSub")
            travel *= -1.0 if heeded else 1.0
            told = "the command is turned" if heeded else "ArduSub does not heed it for motors"
            notes.append(f"SERVO{output}_REVERSED is set for motor {motor}: {told}")
        column = Column(channel=f"motor{motor}", scale=1.0 / travel, offset=-rest / travel)
        found.append((name, column))
    return tuple(found), notes


def _rest(trim: float | str | None, pulses: Array) -> float:
    """The pulse at which a motor stands: the trim, unless the output rests in the middle all the same."""
    if not isinstance(trim, float) or abs(trim - SETTINGS.rest) > SETTINGS.trim:
        return SETTINGS.rest
    at_trim, at_middle = (int(np.sum(pulses == value)) for value in (trim, SETTINGS.rest))
    return trim if at_trim >= at_middle else SETTINGS.rest


# --- stretches ------------------------------------------------------------------------------------


def armed_stretches(events: Iterable[tuple[float, bool]], span: Stretch) -> list[Stretch]:
    """Parts of a span in which the vehicle is armed, by the times at which that changed.

    Before the first event it was what that event ended; without events it is taken to be armed.
    """
    ordered = sorted(events)
    if not ordered:
        return [span]
    states = [(span[0], not ordered[0][1]), *ordered, (span[1], False)]
    parts = [(a[0], b[0]) for a, b in pairwise(states) if a[1] and b[0] > a[0]]
    joined: list[Stretch] = []
    for first, last in parts:
        if joined and joined[-1][1] == first:
            first = joined.pop()[0]
        joined.append((first, last))
    return joined


def used_stretches(
    span: Stretch,
    armed: Sequence[Stretch],
    outputs: tuple[Array, Array] | None,
    resets: Iterable[float],
    held: Sequence[Stretch] = (),
) -> tuple[tuple[Stretch, ...], list[str]]:
    """The parts of a log to be used, cut where the estimator was reset, and what is said of the others.

    Parameters
    ----------
    span : (float, float)
        First and last time of the log, s.
    armed : sequence of (float, float)
    outputs : (n,) and (n, motors) arrays, optional
        Times, s, and commands of motors from -1 to 1.
    resets : iterable of float
        Times, s.
    held : sequence of (float, float)
        When the estimator held its place for want of aid.
    """
    moving = [part for stretch in armed for part in _moving(stretch, outputs)]
    notes = []
    if not armed:
        notes.append("the vehicle is never armed: all of the log is used")
    elif not moving:
        notes.append("armed, but no motor leaves its rest: all of it that is armed is used")
    kept = _long_enough(moving or armed or [span])
    inside = [r for r in resets if any(a < r < b for a, b in kept)]
    notes += [f"cut at {_times(inside)} s, where the estimator was reset"] if inside else []
    pieces = _long_enough(cut_at(kept, [*inside, *(edge for stretch in held for edge in stretch)]))
    aided = [p for p in pieces if not _within(sum(p) / 2, held)]
    if len(aided) < len(pieces) and aided:
        notes.append("left out where the estimator held its place for want of aid")
    pieces = aided or _long_enough(cut_at(kept, inside))
    return tuple(pieces), [*notes, *_left_out(span, pieces, armed)]


def _long_enough(stretches: Iterable[Stretch]) -> list[Stretch]:
    return [s for s in stretches if s[1] - s[0] >= SETTINGS.shortest]


def _moving(stretch: Stretch, outputs: tuple[Array, Array] | None) -> list[Stretch]:
    if outputs is None:
        return [stretch]
    t, commands = outputs
    off = np.any(np.abs(commands) > SETTINGS.off_rest, axis=1) & (t >= stretch[0]) & (t <= stretch[1])
    if not off.any():
        return []
    return [(float(t[off][0]), min(float(t[off][-1]) + SETTINGS.coast, stretch[1]))]


def _within(t: float, stretches: Iterable[Stretch]) -> bool:
    return any(a <= t <= b for a, b in stretches)


def _left_out(span: Stretch, used: Sequence[Stretch], armed: Sequence[Stretch]) -> list[str]:
    """One line on the parts of a span that are not used."""
    edges = [span[0], *(edge for stretch in used for edge in stretch), span[1]]
    told = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        switched = [edge for stretch in armed for edge in stretch if first < edge < last]
        for a, b in pairwise([first, *switched, last]):
            why = "motors at rest, or estimator without aid" if _within((a + b) / 2, armed) else "disarmed"
            told += [f"{a:.1f} to {b:.1f} s ({why})"] if b - a >= SETTINGS.told else []
    return [f"left out: {', '.join(told)}"] if told else []


def _times(moments: Sequence[float]) -> str:
    return ", ".join(f"{t:.1f}" for t in moments)


def runs_of(t: Array, flags: Flags) -> list[Stretch]:
    """From where to where flags of samples are set, s."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [(float(t[a]), float(t[min(b, len(t) - 1)])) for a, b in edges.reshape(-1, 2)]


# --- the vehicle ----------------------------------------------------------------------------------
_SIN = 0.7071067811865476
_LEVEL = ((-_SIN, _SIN, 0), (-_SIN, -_SIN, 0), (_SIN, _SIN, 0), (_SIN, -_SIN, 0))
# FRAME_CONFIG of ArduSub: the bundled vehicle of that frame, and which way each motor pushes at a positive
# command where MOT_n_DIRECTION is 1 (AP_Motors6DOF; its throttle counts upwards). The places of the motors
# are those of the file, in the same order.
_FRAMES = {
    1: ("bluerov2-6", (*_LEVEL, (0, 0, 1), (0, 0, 1))),
    2: ("bluerov2", (*_LEVEL, (0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, 1))),
}


def vehicle_text(log: FieldLog, name: str) -> str:
    """A vehicle file for the frame, the directions of the motors and the battery that a log states.

    Parameters
    ----------
    log : FieldLog
        Of ArduSub.
    name : str
        Of the vehicle.

    Raises
    ------
    UndertowError
        If the log does not state a frame, or one whose thrusters are not known.
    """
    frame = log.parameters.get("FRAME_CONFIG")
    if frame not in _FRAMES:
        stated = "no FRAME_CONFIG" if frame is None else f"FRAME_CONFIG {frame:g}"
        raise UndertowError(
            f"log {log.path} states {stated}, and thrusters are known for 1 (vectored, six) and 2 (vectored, "
            "eight): begin with undertow vehicle new --type rov6 or --mesh, and state its thrusters"
        )
    base, ways = _FRAMES[int(frame)]
    document = tomlkit.parse(resolve_vehicle(base).read_text(encoding="utf-8"))
    curve, why = _curve(log)
    document["name"] = name
    document["description"] = f"{document['description']}; motors as in the parameters of {log.path.name}"
    for motor, (table, way) in enumerate(zip(document["thrusters"], ways, strict=True), 1):
        _turn(table, way, log.parameters.get(f"MOT_{motor}_DIRECTION"), motor)
        table["curve"] = curve
        table["source"] = f"{table['source']}; {why}"
    return tomlkit.dumps(document)


def _turn(table: Table, way: tuple[float, float, float], direction: float | str | None, motor: int) -> None:
    sign = -1.0 if direction == -1.0 else 1.0
    told = f"MOT_{motor}_DIRECTION {sign:g}" if direction is not None else "direction of the motor not logged"
    table["direction"] = [sign * axis + 0.0 for axis in way]
    table["source"] = f"places as in {table['source']}; {told}"


def _curve(log: FieldLog) -> tuple[str, str]:
    """The curve of the T200 that is nearest to the voltage of the battery, and why it was taken."""
    found = [log.series[n.rpartition(".")[0]].columns[n.rpartition(".")[2]] * c.scale
             for n, c in log.mapping.columns.items() if c.channel == "voltage"]  # fmt: skip
    volts = float(np.nanmedian(found[0])) if found and np.isfinite(found[0]).any() else None
    known = {int(name[5:-1]): name for name in bundled_curves() if name.startswith("t200-")}
    if volts is None or not min(known) - 1.0 <= volts <= max(known) + 1.0:
        return known[16], "T200 at 16 V, assumed"
    nearest = min(known, key=lambda v: abs(v - volts))
    return known[nearest], f"T200 at {nearest} V, battery at {volts:.1f} V"
