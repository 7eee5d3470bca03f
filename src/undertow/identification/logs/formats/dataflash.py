"""ArduPilot DataFlash: .bin, messages of fixed length each, described by the FMT messages in the file.

Columns that this reader adds, with what they come from:

- ``phi, theta, psi`` (rad) of ``XKQ``/``NKQ``: the quaternion, turned by AHRS_TRIM from the axes of the
  autopilot to those of the vehicle, as XKF1 and ATT are (which have hundredths of a degree only);
- ``p, q, r`` (rad/s) of ``IMU``: gyros less the biases of the estimator, turned likewise;
- ``u, v, w`` (m/s) of ``VISO``: steps over their time;
- ``altitude`` (m) of ``RFND``: where the range finder looks down and calls its range good.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from undertow.identification.logs.mapping import ANGLES, Column, Frames, LogMapping
from undertow.typing import Array, Flags

from .ardupilot import SETTINGS, Parameters, actuators, by_name, outputs, shorter_by_pymavlink
from .dataflash_records import FMT, HEAD, Columns, Records, open_records
from .fieldlog import FieldLog, Format, Stretch, armed_stretches, named, outputs_of, runs_of, used_stretches

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation


def _read(path: Path, messages: Path | None) -> FieldLog:
    with warnings.catch_warnings():  # casts of damaged numbers
        warnings.simplefilter("ignore", RuntimeWarning)
        return _understood(path, open_records(path))


def _understood(path: Path, file: Records) -> FieldLog:
    parameters = _parameters(file)
    firmware = next((text for text in file.texts("MSG", "Message") if re.match(r"Ardu\w+ V", text)), "")
    known = _Navigation(file, parameters)
    columns = known.columns()
    columns |= _sensors(file, known)
    driven, more = actuators(parameters, outputs(file.series, _OUTPUTS, r"C(\d+)"), firmware)
    stretches, left_out = _stretches(file, known, outputs_of(file.series, driven))
    mapping = LogMapping(columns=columns, frames=Frames(velocity=known.velocity_axes))
    notes = (*([firmware] if firmware else []), *file.notes, *known.notes, *more, *left_out)
    return FieldLog(path, FORMAT.name, file.series, mapping, driven, parameters, stretches, notes)


def _parameters(file: Records) -> Parameters:
    found = file.messages.get("PARM")
    return {} if found is None else by_name(found.texts("Name"), found.numbers("Value"))


_OUTPUTS = ("RCOU", "RCO2", "RCO3")


class _Navigation:
    """Which estimator, of which core, says where the vehicle is, and what of it can be believed."""

    def __init__(self, file: Records, parameters: Mapping[str, float | str]) -> None:
        self._file, self._parameters = file, parameters
        self.notes: list[str] = []
        families = ("NKF", "XKF") if parameters.get("AHRS_EKF_TYPE") == 2.0 else ("XKF", "NKF")
        there = [f for f in families if self._cores(f"{f}1")]
        self.family = there[0] if there else ""
        self.core = self._primary() if there else 0
        self.held = self._held()
        self.velocity_axes: Literal["NED", "body"] = "NED" if self._moves() else "body"

    def _cores(self, name: str) -> list[int]:
        numbered = re.compile(rf"{name}(?:\[(\d+)\])?")
        found = (numbered.fullmatch(series) for series in self._file.series)
        return sorted(int(match[1] or 0) for match in found if match)

    def series(self, name: str, instance: int | None = None) -> str:
        """Name of the series of a kind for an instance, by default for the core; "" if none is there."""
        number = self.core if instance is None else instance
        return next((n for n in (f"{name}[{number}]", name) if n in self._file.series), "")

    def _rows(self, name: str, *columns: str) -> list[Array] | None:
        return self._file.rows(self.series(name), *columns)

    def _primary(self) -> int:
        """The core that was primary for most of the log."""
        cores = self._cores(f"{self.family}1")
        for name in (f"{self.family}4[{cores[0]}]", f"{self.family}4"):
            rows = self._file.rows(name, "PI")
            if rows is not None and len(cores) > 1:
                most = max(cores, key=lambda core: int(np.sum(rows[1] == core)))
                self.notes.append(f"core {most} of {self.family}1 is read, the primary one")
                return most
        return cores[0]

    def _held(self) -> list[tuple[float, float]]:
        """When the estimator held its place for want of aid."""
        rows = self._rows(f"{self.family}4", "SS") if self.family else None
        return [] if rows is None else runs_of(rows[0], rows[1].astype(np.int64) & SETTINGS.held != 0)

    def _moves(self) -> bool:
        """Whether the estimator has places and velocities, and did not hold its place all the time."""
        rows = self._rows(f"{self.family}1", "PN", "PE", "PD", "VN", "VE", "VD") if self.family else None
        if rows is None:
            return False
        still = all(np.ptp(place) == 0.0 for place in rows[1:3])
        return not still and sum(b - a for a, b in self.held) < 0.95 * float(np.ptp(rows[0]))

    def columns(self) -> dict[str, Column]:
        """Position, velocity, attitude and rates."""
        return {**self._position(), **self._attitude(), **self._rates()}

    def _position(self) -> dict[str, Column]:
        name = self.series(f"{self.family}1") if self.family else ""
        if self.velocity_axes == "NED":
            return named(name, {"PN": "x", "PE": "y", "PD": "z", "VN": "u", "VE": "v", "VD": "w"})
        found = named(name, {"PD": "z"}) if name and "PD" in self._file.series[name].columns else {}
        if name:
            self.notes.append(f"{name} has no horizontal aid: its position and velocity are not used")
        return {**found, **self._by_vision(bool(found))}

    def _by_vision(self, has_depth: bool) -> dict[str, Column]:
        """Place and velocity that were sent to the autopilot, where its estimator has none."""
        found: dict[str, Column] = {}
        if self._file.rows("VISP", "PX", "PY", "PZ") is not None:
            found |= named("VISP", {"PX": "x", "PY": "y"} | ({} if has_depth else {"PZ": "z"}))
        rows = self._file.rows("VISO", "dt", "PosDX", "PosDY", "PosDZ")
        if rows is not None:
            # Firmware says seconds, units of some versions say microseconds.
            step = rows[1] * (1e-6 if np.median(rows[1]) > 100.0 else 1.0)
            step = np.where(step > 0, step, np.nan)
            columns = self._file.series["VISO"].columns
            _computed(columns, "uvw", lambda: [moved / step for moved in rows[2:]])
            found |= named("VISO", {"u": "u", "v": "v", "w": "w"})
        return found

    def _trim(self) -> Rotation:
        """From the axes of the autopilot to those of the vehicle (AHRS_TRIM)."""
        from scipy.spatial.transform import Rotation  # slow to import, and every log is asked for its format

        angles = [self._parameters.get(f"AHRS_TRIM_{axis}", 0.0) for axis in "ZYX"]
        return Rotation.from_euler("ZYX", [a if isinstance(a, float) else 0.0 for a in angles])

    def _attitude(self) -> dict[str, Column]:
        name = self.series(f"{self.family[:2]}Q") if self.family else ""
        rows = self._file.rows(name, "Q1", "Q2", "Q3", "Q4")
        if rows is not None:
            return self._by_quaternion(name, rows)
        angles = {"Roll": "phi", "Pitch": "theta", "Yaw": "psi"}
        one = self.series(f"{self.family}1") if self.family else ""
        name = next((n for n in (one, "ATT", "AHR2") if self._file.rows(n, *angles) is not None), "")
        return named(name, angles, unit="deg") if name else {}

    def _by_quaternion(self, name: str, rows: list[Array]) -> dict[str, Column]:
        from scipy.spatial.transform import Rotation

        def angles() -> Array:
            q = np.column_stack(rows[1:])
            sound = np.abs(np.linalg.norm(q, axis=1) - 1.0) < _ROUNDED
            turned = Rotation.from_quat(np.where(sound[:, None], q, [1.0, 0, 0, 0]), scalar_first=True)
            euler = (turned * self._trim().inv()).as_euler("ZYX")[:, ::-1]
            return np.where(sound[:, None], euler, np.nan).T

        _computed(self._file.series[name].columns, ANGLES, angles)
        return named(name, {"phi": "phi", "theta": "theta", "psi": "psi"})

    def _rates(self) -> dict[str, Column]:
        chosen = self._rows(f"{self.family}FS", "GI") if self.family else None
        number = int(np.median(chosen[1])) if chosen is not None and len(chosen[1]) else 0
        name = self.series("IMU", number) or self.series("IMU", 0)
        rows = self._file.rows(name, "GyrX", "GyrY", "GyrZ")
        if rows is None:
            return {}

        def rates() -> Array:
            gyros = np.column_stack(rows[1:])
            if self._file.series[name].units.get("GyrX") == "deg/s":
                gyros = np.radians(gyros)
            return self._trim().apply(gyros - self._bias(rows[0])).T

        _computed(self._file.series[name].columns, "pqr", rates)
        return named(name, {"p": "p", "q": "q", "r": "r"})

    def _bias(self, t: Array) -> Array:
        """Bias of the gyros, rad/s, (n, 3): what the estimator said last."""
        rows = self._rows(f"{self.family}1", "GX", "GY", "GZ") if self.family else None
        if rows is None:
            return np.zeros((len(t), 3))
        latest = np.clip(np.searchsorted(rows[0], t, side="right") - 1, 0, len(rows[0]) - 1)
        return np.radians(np.column_stack(rows[1:])[latest])

    def resets(self) -> list[float]:
        """Times, s, at which the estimator was reset or another one took over."""
        found: list[float] = []
        rows = self._rows(f"{self.family}4", "OFN", "OFE", "PI") if self.family else None
        if rows is not None:
            changed = np.any([np.diff(column) != 0 for column in rows[1:]], axis=0)
            found += rows[0][1:][changed].tolist()
        events = self._file.rows("EV", "Id")
        found += events[0][np.isin(events[1], _RESET_EVENTS)].tolist() if events else []
        times, texts = self._file.rows("MSG"), self._file.texts("MSG", "Message")
        if times is not None and len(times[0]) == len(texts):
            found += [float(t) for t, text in zip(times[0], texts, strict=True) if _RESET.search(text)]
        return found


_ROUNDED = 1e-2  # how far the norm of a quaternion may be from one
_RESET_EVENTS = (60, 62)  # of altitude and of yaw
_RESET = re.compile(
    r"EKF[23] (IMU\d+ (forced reset|.*yaw (re-?)?align|.*reset|is using|stopped aiding|started)|lane switch)"
    r"|EKF primary changed"
)


def _computed(
    columns: Mapping[str, Array], names: Sequence[str], make: Callable[[], Sequence[Array] | Array]
) -> None:
    """Add columns that are made together, once one of them is asked for."""
    assert isinstance(columns, Columns)
    made = cache(make)
    for k, name in enumerate(names):
        columns.makers[name] = partial(lambda k: made()[k], k)


_DOWN, _GOOD = 25, 4  # orientation of a range finder, and its status


def _sensors(file: Records, known: _Navigation) -> dict[str, Column]:
    """Voltage of the battery and height above ground."""
    battery = known.series("BAT", 0) or known.series("CURR", 0)
    seen = bool(battery) and "Volt" in file.series[battery].columns
    return (named(battery, {"Volt": "voltage"}, unit="V") if seen else {}) | _height(file)


def _height(file: Records) -> dict[str, Column]:
    """Height above ground, by the first range finder that looks down."""
    for name in file.series:
        rows = file.rows(name, "Dist") if re.match(r"RFND\b", name) else None
        if rows is None:
            continue
        columns, every = file.series[name].columns, np.ones(len(rows[1]))
        looks = columns.get("Orient", _DOWN * every) == _DOWN
        if looks.any():
            good = looks & (columns.get("Stat", columns.get("Status", _GOOD * every)) == _GOOD)
            _computed(columns, ("altitude",), partial(_where, good, rows[1]))
            return named(name, {"altitude": "altitude"})
    return {}


def _where(good: Flags, values: Array) -> list[Array]:
    return [np.where(good, values, np.nan)]


_ARMED_EVENT, _DISARMED_EVENT = 10, 11


def _stretches(
    file: Records, known: _Navigation, outputs: tuple[Array, Array] | None
) -> tuple[tuple[Stretch, ...], list[str]]:
    end = max(float(series.t.max()) for series in file.series.values() if len(series.t))
    span = (0.0, end)
    events: list[tuple[float, bool]] = []
    states, marks = file.rows("ARM", "ArmState"), file.rows("EV", "Id")
    if states is not None:
        events += [(float(t), bool(on)) for t, on in zip(*states, strict=True)]
    elif marks is not None:
        armed_by = {_ARMED_EVENT: True, _DISARMED_EVENT: False}
        events += [(float(t), armed_by[int(k)]) for t, k in zip(*marks, strict=True) if int(k) in armed_by]
    return used_stretches(span, armed_stretches(events, span), outputs, known.resets(), known.held)


def _accepts(path: Path, head: bytes) -> bool:
    begins = head.startswith(bytes([*HEAD, FMT]))
    return begins or (path.suffix.lower() == ".bin" and bytes(HEAD) in head)


FORMAT = Format("ArduPilot DataFlash", (".bin",), _accepts, _read, shorter=shorter_by_pymavlink(".bin"))
