"""Common parts of ArduPilot logs: motors and frame from parameters."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.resources import files
from typing import NamedTuple

import numpy as np
import tomlkit
from tomlkit.items import Table

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Column
from undertow.model.loading import resolve_vehicle
from undertow.model.tables import bundled_curves
from undertow.model.units import PULSES
from undertow.typing import Array

from .fieldlog import OFF, FieldLog, Series, switched_off

Parameters = Mapping[str, float | str]


@dataclass(frozen=True)
class AutopilotSettings:
    """Conversion of pulses to commands, and status flags of the estimator."""

    # Largest distance of a trim from the neutral pulse, microseconds, that a thruster can have: others are
    # of lights and grippers, which rest at one end.
    trim: float = 100.0
    # The last bit of `solution status` with which an estimator holds its position for lack of aiding.
    held: int = 1 << 7


SETTINGS = AutopilotSettings()


def shorter_by_pymavlink(suffix: str) -> str:
    """How to reduce a log with a program that comes with pymavlink."""
    return f"mavlogdump.py -q -p --nottypes KIND,KIND -o LESS{suffix} LOG (of pymavlink) leaves messages out"


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


def outputs(series: Mapping[str, Series], names: Iterable[str], pattern: str) -> dict[int, tuple[str, Array]]:
    """Column and pulses of every output in some series, by the number that the pattern finds in its name."""
    return {
        int(match[1]): (f"{name}.{column}", series[name].columns[column])
        for name in names
        if name in series
        for column in series[name].columns
        if (match := re.fullmatch(pattern, column))
    }


def actuators(
    parameters: Parameters, outputs: Mapping[int, tuple[str, Array]], firmware: str = ""
) -> tuple[tuple[tuple[str, Column], ...], list[str]]:
    """Outputs of motors as commands from -1 to 1, in the order of the motors, and notes.

    `outputs` has the name of the column and the pulses, microseconds, by the number of the output; `firmware`
    is such as ArduSub V4.1.0, empty if the log does not say.
    """
    found, notes = [], []
    by_motor = {motor: output for motor, output in motors(parameters).items() if output in outputs}
    if not by_motor:
        return (), ["no SERVOn_FUNCTION says which outputs drive motors: name them in a mapping file (--map)"]
    for motor, output in by_motor.items():
        name, pulses = outputs[output]
        rest, travel = _rest(parameters.get(f"SERVO{output}_TRIM"), pulses), PULSES.span
        if rest != PULSES.neutral:
            notes.append(f"motor {motor} rests at {rest:g} µs, the trim of output {output}")
        if parameters.get(f"SERVO{output}_REVERSED") == 1.0:
            # AP_Motors of ArduSub writes pulses, which pass by SERVOn_REVERSED; other programs write scaled
            # outputs, which it turns.
            reverses = not firmware.startswith("ArduSub")
            travel *= -1.0 if reverses else 1.0
            remark = "the command is turned" if reverses else "ArduSub ignores it for motors"
            notes.append(f"SERVO{output}_REVERSED is set for motor {motor}: {remark}")
        off = OFF if np.any(pulses == OFF) else None
        column = Column(channel=f"motor{motor}", scale=1.0 / travel, offset=-rest / travel, off=off)
        found.append((name, column))
    return tuple(found), [*notes, *switched_off(outputs[output][1] for output in by_motor.values())]


def _rest(trim: float | str | None, pulses: Array) -> float:
    """The neutral pulse of a motor: the trim, unless the output rests in the middle."""
    if not isinstance(trim, float) or abs(trim - PULSES.neutral) > SETTINGS.trim:
        return PULSES.neutral
    at_trim, at_middle = (int(np.sum(pulses == value)) for value in (trim, PULSES.neutral))
    return trim if at_trim >= at_middle else PULSES.neutral


# --- the vehicle ----------------------------------------------------------------------------------
def vehicle_text(log: FieldLog, name: str) -> str:
    """A vehicle file for the frame, directions of the motors and battery that an ArduSub log states."""
    frame = _frame(log)
    document = tomlkit.parse(resolve_vehicle(frame.base).read_text(encoding="utf-8"))
    curve, why = _curve(log)
    document["name"] = name
    of_log = f"motors as in the parameters of {log.path.name} (frame {frame.name})"
    hull = "" if frame.bundled else "hull, mass and hydrodynamics only to begin with: "
    document["description"] = f"{hull}{document['description']}; {of_log}"
    tables = document["thrusters"]
    while len(tables) > len(frame.motors):
        tables.pop()
    for motor, (table, factors) in enumerate(zip(tables, frame.motors, strict=True), 1):
        if frame.bundled:
            table["source"] = f"places as in {table['source']}"
        else:
            table["position"] = [f"{metres:g} m" for metres in factors.place(ARMS)]
            table["source"] = f"side by frame {frame.name}, distance as in {frame.base}: measure it"
            table.comment(f"motor {motor}")
        _turn(table, factors.direction, log.parameters.get(f"MOT_{motor}_DIRECTION"), motor)
        table["curve"] = curve
        table["source"] = f"{table['source']}; {why}"
    text = tomlkit.dumps(document)
    # Comments of the bundled file on the positions are not true of other frames.
    return text if frame.bundled else re.sub(r"(?m)(^#.*\n)+(?=\[\[thrusters\]\])", "", text, count=1)


def _frame(log: FieldLog) -> Frame:
    """The frame that a log states."""
    number = log.parameters.get("FRAME_CONFIG")
    if number in FRAMES:
        return FRAMES[int(number)]
    stated = "no FRAME_CONFIG" if number is None else f"FRAME_CONFIG {number:g}"
    stated += " (Custom)" if number == CUSTOM else ""
    known = ", ".join(f"{k} {frame.name}" for k, frame in FRAMES.items())
    raise UndertowError(
        f"log {log.path} states {stated}, and motors are known for {known}: begin with undertow vehicle new "
        "--type rov6 or --mesh, and state its thrusters"
    )


def _turn(table: Table, way: Vector, direction: float | str | None, motor: int) -> None:
    sign = -1.0 if direction == -1.0 else 1.0
    logged = f"MOT_{motor}_DIRECTION {sign:g}"
    remark = "direction of the motor not logged" if direction is None else logged
    table["direction"] = [sign * axis + 0.0 for axis in way]
    table["source"] = f"{table['source']}; {remark}"


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


# --- frames of ArduSub ---------------------------------------------------------------------------------
Vector = tuple[float, float, float]


class Factors(NamedTuple):
    """Contribution of a motor to each motion."""

    roll: float
    pitch: float
    yaw: float
    throttle: float
    forward: float
    lateral: float

    @property
    def direction(self) -> Vector:
        """Thrust direction at a positive command: forward, starboard, down."""
        pushed = np.array([self.forward, self.lateral, -self.throttle])
        x, y, z = (pushed / np.linalg.norm(pushed)).tolist()
        return x, y, z

    def place(self, arms: Vector) -> Vector:
        """Position that gives the signs of its moments, with arms of these lengths (r x F)."""
        x_push, y_push, z_push = np.sign(self.direction).tolist()
        ahead = self.yaw * y_push - self.pitch * z_push
        aside = self.roll * z_push - self.yaw * x_push
        below = self.pitch * x_push - self.roll * y_push
        x, y, z = (np.sign([ahead, aside, below]) * arms + 0.0).tolist()
        return x, y, z


@dataclass(frozen=True)
class Frame:
    """A frame of ArduSub."""

    name: str
    base: str  # bundled vehicle whose hull is taken
    motors: tuple[Factors, ...]
    bundled: bool = False  # whether that vehicle has this frame, and so its positions


_STATED = (files("undertow.identification.logs.formats") / "ardusub_frames.toml").read_text("utf-8")
FRAMES = {
    int(number): Frame(**(table | {"motors": tuple(Factors(*m) for m in table["motors"])}))
    for number, table in tomllib.loads(_STATED).items()
}
"""By FRAME_CONFIG."""
CUSTOM = 7
"""FRAME_CONFIG of a frame whose motors are in the firmware of its builder only."""
ARMS: Vector = (0.156, 0.111, 0.085)
"""m: how far the level thrusters of the bundled BlueROV2 sit ahead, aside and below."""
