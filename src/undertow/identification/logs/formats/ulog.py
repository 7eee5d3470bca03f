"""PX4: .ulg, by pyulog.

Every message is a series, one of several instances with its number in brackets (``battery_status[1]``).
Times are those at which a sensor or the estimator was true (timestamp_sample) where PX4 says so. Values that
the estimator flags as invalid (xy_valid and the like) are blank. Besides the columns of the file,
vehicle_attitude has phi, theta, psi of its quaternion, rad.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import ANGLES, Column, Frames, LogMapping, angles
from undertow.typing import Array

from .fieldlog import (
    OFF,
    FieldLog,
    Format,
    Interval,
    Series,
    armed_intervals,
    library,
    outputs_of,
    switched_off,
    used_intervals,
)

_SIGNATURE = b"ULog\x01\x12\x35"
_ARMED = 2  # vehicle_status.arming_state
_POSITION, _ATTITUDE, _RATE = "vehicle_local_position", "vehicle_attitude", "vehicle_angular_velocity"
_SAMPLED = (_POSITION, _ATTITUDE, _RATE)
# Flags of vehicle_local_position, and the columns that mean nothing where they are not set.
_VALID_FLAGS = {"xy_valid": ("x", "y"), "z_valid": ("z",), "v_xy_valid": ("vx", "vy"), "v_z_valid": ("vz",)}
# The estimator of PX4 gives all in NED and forward-right-down axes, velocities along north, east, down.
_KNOWN = {
    _POSITION: {"x": "x", "y": "y", "z": "z", "vx": "u", "vy": "v", "vz": "w"},
    _ATTITUDE: {name: name for name in ANGLES},
    _RATE: {"xyz[0]": "p", "xyz[1]": "q", "xyz[2]": "r"},
    "battery_status": {"voltage_v": "voltage"},
}
_UNITS = {"x": "m", "y": "m", "z": "m", "vx": "m/s", "vy": "m/s", "vz": "m/s", "voltage_v": "V"}
_UNITS |= {**dict.fromkeys(ANGLES, "rad"), **{f"xyz[{k}]": "rad/s" for k in range(3)}}
_FRAMES = Frames(position="NED", body="FRD", velocity="NED")


def _read(path: Path, messages: Path | None) -> FieldLog:
    pyulog, output = library("pyulog", "a log of PX4"), StringIO()
    with redirect_stdout(output), path.open("rb") as stream:  # pyulog prints what it finds damaged
        log = pyulog.ULog(stream)
    if not log.data_list:
        raise UndertowError(f"log {path} has no data: check that it is complete")
    # Of several instances, those after the first are called with their number.
    names = [f"{data.name}[{data.multi_id}]" if data.multi_id else str(data.name) for data in log.data_list]
    found = {name: data.data for name, data in zip(names, log.data_list, strict=True)}
    begin = log.start_timestamp
    series = {name: _series(name, data, begin) for name, data in found.items()}
    known = {
        f"{name}.{column}": Column(channel=channel, unit=_UNITS.get(column))
        for name, meaning in _KNOWN.items()
        for column, channel in meaning.items()
        if column in series.get(name, _NOTHING).columns and _has_values(series[name].columns[column])
    }
    notes = [f"damaged: {line}" for line in output.getvalue().splitlines()[:1]]
    lost = sum(dropout.duration for dropout in log.dropouts) / 1000
    if log.dropouts:
        notes.append(f"the logger dropped data {len(log.dropouts)} times, for {lost:.3g} s in all")
    actuators = _actuators(series)
    pieces, cuts = _intervals(series, actuators)
    return FieldLog(
        path,
        FORMAT.name,
        series,
        LogMapping(columns=known, frames=_FRAMES),
        actuators,
        {name: value for name, value in log.initial_parameters.items() if isinstance(value, (int, float))},
        pieces,
        (*notes, *_note_on_pulses(series, actuators), *cuts),
    )


_NOTHING = Series("", np.zeros(0), {})
_PULSES = "actuator_outputs"


def _series(name: str, data: Mapping[str, Array], begin: int) -> Series:
    stamps = data["timestamp"]
    sampled = data.get("timestamp_sample")
    if name in _SAMPLED and sampled is not None:
        stamps = np.where(sampled > 0, sampled, stamps)
    t = (stamps.astype(np.int64) - begin).astype(np.float64) * 1e-6
    columns = dict(data)
    if name == _POSITION:
        columns |= _valid_only(columns)
    if name == _ATTITUDE:
        columns |= angles(*(columns[f"q[{k}]"].astype(float) for k in range(4)))
    return Series(name, t, columns, {n: unit for n, unit in _UNITS.items() if n in columns})


def _valid_only(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Position and velocity, blank where the estimator flags them as invalid."""
    return {
        name: np.where(columns[flag] > 0, columns[name], np.nan)
        for flag, names in _VALID_FLAGS.items()
        for name in names
        if flag in columns and name in columns
    }


def _has_values(column: Array) -> bool:
    return bool(np.any(np.isfinite(column)))


def _actuators(series: Mapping[str, Series]) -> tuple[tuple[str, Column], ...]:
    """Outputs of the motors that the vehicle has: of the allocation, or as pulses of the first output."""
    for name, column in (("actuator_motors", "control[{}]"), (_PULSES, "output[{}]")):
        data = series.get(name, _NOTHING).columns
        count = int(np.max(data["noutputs"])) if "noutputs" in data else 16
        there = [n for k in range(count) if (n := column.format(k)) in data and _has_values(data[n])]
        if there:
            off = OFF if name == _PULSES else None
            return tuple(
                (f"{name}.{n}", Column(channel=f"motor{k}", off=off)) for k, n in enumerate(there, 1)
            )
    return ()


def _note_on_pulses(series: Mapping[str, Series], actuators: tuple[tuple[str, Column], ...]) -> list[str]:
    """Note on outputs that are pulses, whose neutral only the vehicle's builder knows."""
    names = [name.removeprefix(f"{_PULSES}.") for name, _ in actuators if name.startswith(f"{_PULSES}.")]
    if not names:
        return []
    note = (
        f"commands are those of {_PULSES} as logged: for pulses that are neutral at 1500 µs, give each "
        "scale = 0.0025 and offset = -3.75 in the mapping file that undertow import writes"
    )
    return [note, *switched_off(series[_PULSES].columns[name] for name in names)]


def _intervals(
    series: Mapping[str, Series], actuators: tuple[tuple[str, Column], ...]
) -> tuple[tuple[Interval, ...], list[str]]:
    """Intervals in which the vehicle was armed and moved, cut where the estimator was reset, and notes."""
    clocks = [series[name].t for name in _SAMPLED if name in series] or [s.t for s in series.values()]
    span = min(float(t[0]) for t in clocks), max(float(t[-1]) for t in clocks)
    jumps = {t for name in (_POSITION, _ATTITUDE) for t in _resets(series.get(name, _NOTHING))}
    known = any(name.startswith("actuator_motors.") for name, _ in actuators)  # pulses have no known rest
    outputs = outputs_of(series, actuators) if known else None
    armed = _armed(series.get("vehicle_status", _NOTHING), span)
    used, notes = used_intervals(span, armed, outputs, sorted(jumps))
    return (() if used == (span,) else used), notes


def _armed(status: Series, span: tuple[float, float]) -> list[tuple[float, float]]:
    """Intervals in which the vehicle was armed; the whole log if that is not logged."""
    if "arming_state" not in status.columns or not len(status.t):
        return [span]
    on = status.columns["arming_state"] == _ARMED
    changed = np.flatnonzero(np.diff(on.astype(int))) + 1
    events = [(float(status.t[k]), bool(on[k])) for k in changed]
    return armed_intervals([(min(span[0], float(status.t[0])), bool(on[0])), *events], span)


def _resets(estimate: Series) -> list[float]:
    """Times of the first samples after the estimator jumped."""
    counters = [column for name, column in estimate.columns.items() if name.endswith("reset_counter")]
    return [float(estimate.t[k + 1]) for c in counters for k in np.flatnonzero(np.diff(c.astype(int)))]


def _accepts(path: Path, head: bytes) -> bool:
    return head.startswith(_SIGNATURE) or path.suffix == ".ulg"


FORMAT = Format(
    "PX4 ULog", (".ulg",), _accepts, _read, 800_000_000,
    "ulog2csv -m TOPIC,TOPIC LOG (part of pyulog) writes the needed topics as tables",
)  # fmt: skip
