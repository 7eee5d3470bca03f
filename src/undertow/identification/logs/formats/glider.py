"""Files of Slocum gliders: .dbd, .ebd, .sbd, .tbd and their like, by dbdreader.

dbdreader is under the GPL. It is therefore not part of undertow and not imported: if installed, it is run as
a separate program. All sensors of a file are one series, blank where a sensor has no new value. Files whose
list of sensors is kept apart need it (.cac): from the folder of the log, one called cac or cache in it, or
the one that is named by --messages. Added columns: ``north`` and ``east`` of the fixes, m.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Column, Frames, LogMapping, depth, north_east
from undertow.typing import Array

from .fieldlog import TRIAL, FieldLog, Format, Series

KNOWN = {
    "m_depth": Column(channel="z", unit="m"),
    "m_roll": Column(channel="phi", unit="rad"),
    "m_pitch": Column(channel="theta", unit="rad"),
    "m_heading": Column(channel="psi", unit="rad", wrapped=True),
    "m_altitude": Column(channel="altitude", unit="m"),
    "m_battery": Column(channel="voltage", unit="V"),
    "north": Column(channel="x", unit="m"),
    "east": Column(channel="y", unit="m"),
}
"""Sensors of Slocum gliders: roll to starboard, nose up and a heading clockwise from north are positive."""

# Of the CTD, in the files of the science computer (.ebd, .tbd) in place of m_depth; zero at the surface.
_PRESSURE, _BAR = "sci_water_pressure", 1e5
_PROGRAM = """
import sys
import numpy, dbdreader
log, definitions, found = sys.argv[1:]
try:
    file = dbdreader.DBD(log, cacheDir=definitions)
    clock = file.timeVariable
    names = [clock, *(name for name in file.parameterNames if name != clock)]
    read = file.get(*names, return_nans=True, discardBadLatLon=False)
    t = read[0][0]
    columns = {name: v for name, (_, v) in zip(names[1:], read[1:]) if numpy.isfinite(v).any()}
except Exception as error:
    sys.exit(f"{error or type(error).__name__}")
units = [str(file.parameterUnits.get(name, "")) for name in columns]
numpy.savez(found, t=t, names=list(columns), units=units, values=list(columns.values()))
"""


def _read(path: Path, messages: Path | None) -> FieldLog:
    if find_spec("dbdreader") is None:
        raise UndertowError(
            f"log {path} of a glider needs the program dbdreader (GPL): pip install dbdreader"
        )
    t, columns, units = _sensors(path, messages)
    if len(t) < 2:
        raise UndertowError(f"log {path} has {len(t)} records: check that the copy is complete")
    fixes = [columns.get(name) for name in ("m_gps_lat", "m_gps_lon")]
    notes = []
    if fixes[0] is not None and fixes[1] is not None:
        fixed = np.abs(fixes[0]) <= 90.0  # without a fix Slocum writes 69696969
        columns["north"], columns["east"] = north_east(np.where(fixed, fixes[0], np.nan), fixes[1])
        notes.append(
            "positions are the satellite fixes; m_x_lmc and m_y_lmc are dead reckoning and are not used"
        )
    name = path.suffix[1:].lower() or "glider"
    series = Series(name, t - t[0], columns, units)
    known = {f"{name}.{column}": one for column, one in KNOWN.items() if column in columns}
    pressure = columns.get(_PRESSURE)
    if "m_depth" not in columns and pressure is not None:
        known[f"{name}.{_PRESSURE}"], water = depth(_BAR, absolute=False)
        notes.append(f"depth is that of {_PRESSURE} in bar, with {water}")
    mapping = LogMapping(columns=known, frames=Frames())
    return FieldLog(path, FORMAT.name, {name: series}, mapping, notes=tuple(notes))


def _sensors(path: Path, messages: Path | None) -> tuple[Array, dict[str, Array], dict[str, str]]:
    """Times, s since 1970, and what the sensors of a file reported."""
    with TemporaryDirectory() as folder:
        for file in _definitions(path, messages):  # a copy, since dbdreader may add to them
            shutil.copy(file, folder)
        found = Path(folder) / "found.npz"
        command = [sys.executable, "-c", _PROGRAM, str(path.resolve()), folder, str(found)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=TRIAL.subprocess, check=False)
        if not found.exists():
            said = (done.stderr or done.stdout).strip().split("\n")[-1][:300] or "no reason given"
            folder_needed = "ache" in said  # of "cache"
            remedy = "give the folder of its .cac: --messages FOLDER" if folder_needed else "copy it again"
            raise UndertowError(f"log {path} cannot be read by dbdreader: {said.rstrip('. ')}: {remedy}")
        with np.load(found) as kept:
            names, units = kept["names"].tolist(), kept["units"].tolist()
            values = np.asarray(kept["values"], dtype=float)
            return kept["t"], dict(zip(names, values, strict=True)), dict(zip(names, units, strict=True))


def _definitions(path: Path, messages: Path | None) -> list[Path]:
    """Lists of sensors for the file."""
    beside = [d for d in path.parent.iterdir() if d.is_dir() and d.name.lower() in ("cac", "cache")]
    folders = [messages] if messages else [path.parent, *beside]
    return [
        file for folder in folders for file in folder.iterdir() if file.suffix.lower() in (".cac", ".ccc")
    ]


def _accepts(path: Path, head: bytes) -> bool:
    return head.startswith(b"dbd_label:") or (path.suffix.lower() in FORMAT.suffixes and bool(head))


_PLAIN = (".dbd", ".ebd", ".sbd", ".tbd", ".mbd", ".nbd")
_COMPRESSED = tuple(f"{end[:2]}cd" for end in _PLAIN)  # the same, by LZ4
FORMAT = Format("Slocum glider", (*_PLAIN, *_COMPRESSED), _accepts, _read)
