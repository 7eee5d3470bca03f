"""The dive as ArduSub and a ground station log it: .bin and .tlog, packed by pymavlink.

Before it lies the vehicle on deck, then it is armed with its motors at rest; afterwards it is disarmed.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from undertow.model.loading import load_vehicle, resolve_vehicle
from undertow.model.vehicle import Vehicle

from .dive import FULL, Dive, dive

Array = NDArray[np.float64]

ARMED, DIVES, DISARMED, END = 10.0, 15.0, 75.0, 80.0
"""When, s from the start of the log, the vehicle is armed, begins to move, is disarmed, and its log ends."""
BOOTED = 265.6  # s that the autopilot has run when the log begins
STEP = 0.05
OUTPUT_OF_MOTOR = (3, 1, 2, 4, 5, 6, 8, 7)
TRIM = (0.02, -0.03, 0.0)  # roll, pitch, yaw of the vehicle from the axes of the autopilot, rad
BIAS = np.radians([0.25, -0.5, 0.75])  # of the gyros, rad/s; XKF1 has hundredths of a degree
DIRECTIONS = (-1, -1, -1, -1, -1, 1, 1, -1)  # those with which the motors push as in the bundled file
PARAMETERS: dict[str, float] = {
    "FRAME_CONFIG": 2.0, "AHRS_EKF_TYPE": 3.0, "AHRS_TRIM_X": TRIM[0], "AHRS_TRIM_Y": TRIM[1],
    **{f"MOT_{k}_DIRECTION": float(way) for k, way in enumerate(DIRECTIONS, 1)},
    **{f"SERVO{n}_FUNCTION": 32.0 + k for k, n in enumerate(OUTPUT_OF_MOTOR, 1)},
    **{f"SERVO{n}_TRIM": 1500.0 for n in OUTPUT_OF_MOTOR}, "SERVO9_FUNCTION": 59.0,
}  # fmt: skip


def vehicle_for(folder: Path) -> tuple[Path, Vehicle]:
    """The vehicle of the dive with commands from -1 to 1, as logs of autopilots have them."""
    text = resolve_vehicle("bluerov2").read_text(encoding="utf-8")
    path = folder / "rov.toml"
    path.write_text(text.replace("[[thrusters]]", f'[[thrusters]]\nthrust_per_command = "{FULL:g} N"'))
    return path, load_vehicle(path)


def whole() -> tuple[Array, Dive, Array]:
    """Times, s, what the sensors reported, and pulses of the motors, before, in and after the dive."""
    d = dive()
    t = STEP * np.arange(round(END / STEP) + 1, dtype=float)
    row = np.clip(np.round((t - DIVES) / STEP).astype(int), 0, len(d.t) - 1)
    on = (t >= DIVES - 1e-9) & (t < DISARMED - 1e-9)
    pwm = np.where(on[:, None], d.pwm[row], 1500.0)
    at = Dive(t, d.pose[row], d.quaternion[row], d.velocity_ned[row], d.rates[row], d.thrust[row])
    return t, at, pwm


# --- .bin -----------------------------------------------------------------------------------------
# Name, format, columns, units and multipliers as ArduSub 4.1 has them.
KINDS = {
    "FMT": (128, "BBnNZ", "Type,Length,Name,Format,Columns", "-b---", "-----"),
    "UNIT": (178, "QbZ", "TimeUS,Id,Label", "s--", "F--"),
    "MULT": (179, "Qbd", "TimeUS,Id,Mult", "s--", "F--"),
    "FMTU": (177, "QBNN", "TimeUS,FmtType,UnitIds,MultIds", "s---", "F---"),
    "PARM": (64, "QNf", "TimeUS,Name,Value", "s--", "F--"),
    "MSG": (91, "QZ", "TimeUS,Message", "s-", "F-"),
    "ARM": (203, "QBIBB", "TimeUS,ArmState,ArmChecks,Forced,Method", "s----", "F----"),
    "XKF1": (76, "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH",
             "s#ddhnnnnmmmkkkm", "F-BBB0000000BBBB"),
    "XKF4": (79, "QBcccccfffHBIHb", "TimeUS,C,SV,SP,SH,SM,SVT,errRP,OFN,OFE,FS,TS,SS,GPS,PI",
             "s#------mm-----", "F-------00-----"),
    "XKQ": (84, "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4", "s#????", "F-????"),
    "IMU": (162, "QBffffffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz",
            "s#EEEooo--O--zz", "F-000000-----00"),
    "RCOU": (94, "QHHHHHHHHHHHHHH", "TimeUS,C1,C2,C3,C4,C5,C6,C7,C8,C9,C10,C11,C12,C13,C14",
             "sYYYYYYYYYYYYYY", "F--------------"),
    "BAT": (115, "QBfffffcfB", "TimeUS,Instance,Volt,VoltR,Curr,CurrTot,EnrgTot,Temp,Res,RemPct",
            "s#vvAaXOw%", "F-000C0?00"),
    "VISO": (189, "Qffffffff", "TimeUS,dt,AngDX,AngDY,AngDZ,PosDX,PosDY,PosDZ,conf",
             "ssrrrmmm-", "FF000000-"),
    "ATT": (100, "QccccCCCCB", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw,ErrRP,ErrYaw,AEKF",
            "sddddhhdh-", "FBBBBBBBB-"),
    "NKF1": (66, "QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH",
             "s#ddhnnnnmmmkkkm", "F-BBB0000000BBBB"),
    "RFND": (175, "QBCBB", "TimeUS,Instance,Dist,Stat,Orient", "s#m--", "F-B--"),
}  # fmt: skip
_UNITS = {"s": "s", "#": "instance", "d": "deg", "h": "degheading", "n": "m/s", "m": "m", "k": "deg/s",
          "E": "rad/s", "o": "m/s/s", "O": "degC", "z": "Hz", "Y": "us", "v": "V", "A": "A"}  # fmt: skip
_FACTORS = {"-": 0.0, "?": 1.0, "0": 1.0, "B": 0.01, "C": 0.001, "F": 1e-6}


class BinWriter:
    """Messages of .bin, packed by pymavlink."""

    def __init__(self) -> None:
        self._reader = pytest.importorskip("pymavlink.DFReader")
        self._formats = {name: self._format(name) for name in KINDS}

    def _format(self, name: str) -> Any:
        number, cells, columns, *_ = KINDS[name]
        length = 3 + struct.calcsize("<" + "".join(self._reader.FORMAT_TO_STRUCT[c][0] for c in cells))
        return self._reader.DFFormat(number, name, length, cells, columns)

    def message(self, name: str, *cells: Any) -> bytes:
        """One message, its cells in their units."""
        made = self._formats[name]
        ready = [cell.encode() if isinstance(cell, str) else cell for cell in cells]
        return bytes(self._reader.DFMessage(made, ready, False, None).get_msgbuf())

    def head(self, us: int) -> bytes:
        """Descriptions and units."""
        formats = [
            self.message("FMT", f.type, f.len, name, f.format, ",".join(f.columns))
            for name, f in self._formats.items()
        ]
        units = [self.message("UNIT", us, ord(k), label) for k, label in _UNITS.items()]
        factors = [self.message("MULT", us, ord(k), factor) for k, factor in _FACTORS.items()]
        fields = [self.message("FMTU", us, KINDS[n][0], *KINDS[n][3:]) for n in KINDS]
        return b"".join([*formats, *units, *factors, *fields])


Cells = list[Any]
Change = Callable[[float, Cells], Cells]


@cache
def _packed() -> tuple[list[tuple[str, float, Cells, bytes]], BinWriter]:
    """Name, time, cells and bytes of every message, without the head."""
    writer, (t, at, pwm) = BinWriter(), whole()
    stated: list[tuple[str, float, Cells]] = [("PARM", 0.0, list(pair)) for pair in PARAMETERS.items()]
    said = [("MSG", 0.0, ["ArduSub V4.1.0 (89639005)"])]
    timed = [(name, now, c) for k, now in enumerate(t.tolist()) for name, c in _messages(k, now, at, pwm)]
    every = [*stated, *said, *timed]
    return [(name, now, c, writer.message(name, _us(now), *c)) for name, now, c in every], writer


def write_bin(path: Path, changes: Mapping[str, Change] | None = None, more: Sequence[Any] = ()) -> Path:
    """The dive as ArduSub logs it.

    `changes` alter the cells after the time, by name of the message, or drop it (no cells); `more` are
    further messages, each a name, a time and cells.
    """
    messages, writer = _packed()
    added = [(name, now, cells, writer.message(name, _us(now), *cells)) for name, now, cells in more]
    out = [writer.head(_us(0.0))]
    for name, now, cells, packed in sorted([*messages, *added], key=lambda message: message[1]):
        if changes and name in changes:
            changed = changes[name](now, list(cells))
            out += [writer.message(name, _us(now), *changed)] if changed else []
        else:
            out.append(packed)
    path.write_bytes(b"".join(out))
    return path


def _us(t: float) -> int:
    return round((BOOTED + t) * 1e6)


def _messages(k: int, now: float, at: Dive, pwm: Array) -> Iterator[tuple[str, list[Any]]]:
    """Names and cells, after their times, of the messages of one moment."""
    for moment, state in ((ARMED, 1), (DISARMED, 0)):
        if abs(now - moment) < STEP / 2:
            yield "ARM", [state, 0, 0, 1]
    trim = Rotation.from_euler("ZYX", TRIM[::-1])
    roll, pitch, yaw = np.degrees(at.pose[k, 3:])
    bias = np.degrees(BIAS).tolist()
    place, moved = at.pose[k, :3].tolist(), at.velocity_ned[k].tolist()
    yield "XKF1", [0, roll, pitch, yaw % 360.0, *moved, moved[2], *place, *bias, 0.0]
    yield "XKF4", [0, *[0.0] * 8, 0, 0, 831, 0, 0]
    turned = Rotation.from_quat(at.quaternion[k], scalar_first=True) * trim
    yield "XKQ", [0, *turned.as_quat(scalar_first=True).tolist()]
    yield "IMU", [0, *(trim.apply(at.rates[k], inverse=True) + BIAS).tolist(), 0.0, 0.0, -9.8,
                  0, 0, 40.0, 1, 1, 8000, 4000]  # fmt: skip
    yield "RCOU", [*pulses(pwm[k]), *[0] * 6]
    if k % 2 == 0:
        yield "BAT", [0, 15.9, 0.0, 5.0, 0.0, 0.0, 0.0, 0.0, 99]
    if k % 4 == 0:
        yield "RFND", [0, 10.0 - place[2], 4, 25]


def pulses(by_motor: Array) -> list[int]:
    """Pulses in the order of the outputs."""
    return [int(by_motor[OUTPUT_OF_MOTOR.index(n)]) for n in range(1, 9)]


# --- .tlog ----------------------------------------------------------------------------------------


def write_tlog(path: Path, *, local: bool = True, aided: bool = True) -> Path:
    """The dive as a ground station hears it: with itself, and a camera, in between."""
    mavlink = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega")
    own, camera, ground = (mavlink.MAVLink(None, *who) for who in ((1, 1), (1, 100), (255, 190)))
    t, at, pwm = whole()
    out: list[bytes] = []

    def send(now: float, link: Any, message: Any) -> None:
        # It arrives a little later, and in bursts; the first two bits name the link.
        late = 0.03 + STEP * 2 * np.ceil(now / (STEP * 2)) - now
        out.append(struct.pack(">Q", round((1.683e9 + now + late) * 1e6)) + message.pack(link))

    parameters = [(n.encode(), v) for n, v in PARAMETERS.items()]
    for k, (name, value) in enumerate(parameters):
        send(0.0, own, mavlink.MAVLink_param_value_message(name, value, 9, len(parameters), k))
    for k, now in enumerate(t.tolist()):
        boot = round((BOOTED + now) * 1e3)
        angles, rates = at.pose[k, 3:].tolist(), at.rates[k].tolist()
        send(now, own, mavlink.MAVLink_attitude_message(boot, *angles, *rates))
        place, moved = at.pose[k, :3].tolist(), at.velocity_ned[k].tolist()
        if local:
            send(now, own, mavlink.MAVLink_local_position_ned_message(boot, *place, *moved))
        fix = _fix(place) if aided else [0, 0, 0, _fix(place)[3]]
        send(now, own, mavlink.MAVLink_global_position_int_message(boot, *fix, *_whole(moved), 0))
        out_of = [*pulses(pwm[k]), 0, *[0] * 7]
        us = _us(now) % 2**32
        send(now, own, mavlink.MAVLink_servo_output_raw_message(us, 0, *out_of))
        if k % 20 == 0:
            mode = 81 + 128 * (ARMED <= now < DISARMED)
            send(now, own, mavlink.MAVLink_heartbeat_message(12, 3, mode, 19, 4, 3))
            send(now, camera, mavlink.MAVLink_heartbeat_message(30, 8, 128, 0, 3, 3))
            send(now, ground, mavlink.MAVLink_heartbeat_message(6, 8, 192, 0, 4, 3))
            send(now, ground, mavlink.MAVLink_attitude_message(boot, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0))
            send(now, own, mavlink.MAVLink_sys_status_message(0, 0, 0, 200, 15900, 500, 99, *[0] * 6))
    path.write_bytes(b"".join(out))
    return path


LATITUDE, LONGITUDE = 48.386142, -124.630573


def _fix(place: list[float]) -> list[int]:
    """Latitude, longitude, altitudes in the units of GLOBAL_POSITION_INT, of a sphere's small patch."""
    bend = 1 - 6.69437999014e-3 * np.sin(np.radians(LATITUDE)) ** 2
    north, east = 6378137.0 * (1 - 6.69437999014e-3) / bend**1.5, 6378137.0 / np.sqrt(bend)
    lat = LATITUDE + np.degrees(place[0] / north)
    lon = LONGITUDE + np.degrees(place[1] / (east * np.cos(np.radians(LATITUDE))))
    return [round(lat * 1e7), round(lon * 1e7), round(-place[2] * 1e3), round(-place[2] * 1e3)]


def _whole(moved: list[float]) -> list[int]:
    return [round(100 * speed) for speed in moved]
