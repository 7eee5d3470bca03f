"""NMEA 0183: a text with a sentence on every line, as receivers, compasses and loggers of ships write it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
import polars as pl

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Column, LogMapping, north_east
from undertow.identification.logs.table import seconds, through_midnight

from .fieldlog import FieldLog, Format, Series

# What a sentence tells, by its last three letters, and in which of its fields.
_FIELDS = {
    "RMC": {"latitude": 3, "longitude": 5, "sog_kn": 7, "cog_deg": 8},
    "GGA": {"latitude": 2, "longitude": 4},
    "GLL": {"latitude": 1, "longitude": 3},
    "VTG": {"cog_deg": 1, "sog_kn": 5},
    "HDT": {"heading_deg": 1},
    "THS": {"heading_deg": 1},
    "HDG": {"heading_deg": 1, "variation_deg": 4},
    "HDM": {"heading_deg": 1},
    "ROT": {"rot_deg_min": 1},
    "VHW": {"stw_kn": 5},
    "RSA": {"rudder": 1, "port_rudder": 3},
    "RPM": {"propeller": 3},
}
# Fields with the time of day, and with a letter without which, or with which, a sentence has no fix.
_CLOCKS = {"RMC": 1, "GGA": 1, "GLL": 5, "ZDA": 1}
_VALID = {"RMC": (2, "A"), "GLL": (6, "A"), "GGA": (6, "12345678"), "RSA": (2, "A")}
_SENTENCE = re.compile(r"^([^$,;]*[,;\s])?\$([A-Z]{2})([A-Z]{3}),([^*]*)(?:\*([0-9A-Fa-f]{2}))?\s*$")
_WHOLE = re.compile(rb"(?m)^[^$,;\n]*[$][A-Z]{5},[^\n]*\*[0-9A-Fa-f]{2}\s*$")
# Beside the time, programs that log write the module and the importance of a message.
_DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(\.\d+)?(Z|[+-]\d\d:?\d\d)?")
_BEGIN = 4096  # bytes by which a file is recognised, since its first lines may be the logger's
# Likelier first; the first that is there is read.
_HEADINGS = ("HDT", "THS", "HDG", "HDM")
_POSITIONS = ("RMC", "GGA", "GLL")
Sentence = tuple[str, list[str], str]
"""Its type, its fields with the type in front, and what a logger wrote before it."""


def _read(path: Path, messages: Path | None) -> FieldLog:
    found, damaged = _sentences(path)
    times = _times(found, path)
    times = times - np.nanmin(times, initial=np.inf)
    kinds = sorted({kind for kind, _, _ in found if kind[:3] in _FIELDS})
    columns = {kind: _columns(kind[:3], [f for k, f, _ in found if k == kind]) for kind in kinds}
    own = {kind: times[[k == kind for k, _, _ in found]] for kind in kinds}
    series = [Series(k, own[k], c) for k, c in columns.items() if c and np.isfinite(own[k]).any()]
    named = {one.name: one for one in series}
    known: dict[str, Column] = {}
    if place := next((k for k in _POSITIONS if k in named), ""):
        known |= {f"{place}.north": Column(channel="x"), f"{place}.east": Column(channel="y")}
    if heading := next((k for k in _HEADINGS if k in named), ""):
        known[f"{heading}.heading_deg"] = Column(channel="psi", unit="deg", wrapped=True)
    if "ROT" in named:
        known["ROT.rot_deg_min"] = Column(channel="r", unit="deg/min")
    if not named:
        raise UndertowError(f"log {path} has no NMEA sentence with a motion: check that it is complete")
    notes = (f"sentences that are cut off or have a wrong checksum left out: {damaged}",) if damaged else ()
    magnetic = heading in ("HDG", "HDM") and "variation_deg" not in named[heading].columns
    remarks = ("the heading is magnetic: state [compass] A, the variation",) * magnetic
    shafts = [name for name in named if name.startswith("RPM")]
    driven = {
        f"{name}.propeller": Column(channel=f"propeller{k}" if len(shafts) > 1 else "propeller", unit="rpm")
        for k, name in enumerate(shafts, 1)
    }
    driven |= {"RSA.rudder": Column(channel="rudder", unit="deg")} if "RSA" in named else {}
    mapping, motors = LogMapping(columns=known), tuple(driven.items())
    return FieldLog(path, FORMAT.name, named, mapping, motors, notes=notes, remarks=remarks)


def _sentences(path: Path) -> tuple[list[Sentence], int]:
    """The sentences of a file, and how many are damaged; AIS messages of others begin with another sign."""
    found, bare, damaged = list[Sentence](), list[Sentence](), 0
    with path.open(encoding="ascii", errors="replace") as lines:
        for line in lines:
            match = _SENTENCE.match(line)
            if match is None:
                damaged += "$" in line
                continue
            before, talker, kind, text, checksum = match.groups()
            sum_ = reduce(xor, f"{talker}{kind},{text}".encode())
            if checksum is not None and int(checksum, 16) != sum_:
                damaged += 1
            elif kind in _FIELDS or kind in _CLOCKS:
                fields = [kind, *text.split(",")]
                name = f"RPM[{fields[2]}]" if kind == "RPM" and len(fields) > 2 else kind  # by shaft
                part = found if checksum else bare
                part.append((name, fields, (before or "").strip(" ,;\t")))
    return (found, damaged + len(bare)) if found else (bare, damaged)  # one without is cut off


def _columns(kind: str, rows: Sequence[list[str]]) -> dict[str, np.ndarray]:
    """The columns of the sentences of one kind; those that hold nothing are left out."""
    place, letters = _VALID.get(kind, (0, kind))
    sound = np.array([len(f) > place and f[place] != "" and f[place] in letters for f in rows], dtype=bool)
    columns = {
        name: np.where(sound, [_number(f, at, name) for f in rows], np.nan)
        for name, at in _FIELDS[kind].items()
    }
    if "latitude" in columns:
        north, east = north_east(columns["latitude"], columns["longitude"])
        columns |= {"north": north, "east": east}
    known = {name: values for name, values in columns.items() if np.isfinite(values).any()}
    if "variation_deg" in known and "heading_deg" in known:  # not every sentence may state it
        known["heading_deg"] = known["heading_deg"] + np.nanmedian(known["variation_deg"])
    return known


def _number(fields: Sequence[str], at: int, name: str) -> float:
    """A field as a number; degrees and minutes as degrees, to the south and west negative."""
    try:
        value = float(fields[at])
    except (ValueError, IndexError):
        return float("nan")
    if name in ("latitude", "longitude"):
        value = value // 100.0 + value % 100.0 / 60.0
    return -value if fields[at + 1 : at + 2] in (["S"], ["W"]) else value


# --- times ----------------------------------------------------------------------------------------
def _times(found: Sequence[Sentence], path: Path) -> np.ndarray:
    """Times, s: those of the logger where every line has one, else those in the sentences."""
    stamps = [before for _, _, before in found]
    if found and all(stamps):
        dates = [date[0] if (date := _DATE.search(stamp)) else stamp for stamp in stamps]
        return seconds(pl.DataFrame({"t": dates}), "t", f"log {path}")[0]
    own = np.array([_time_of_day(kind, fields) for kind, fields, _ in found])
    there = np.isfinite(own)
    if not there.any():
        raise UndertowError(
            f"log {path} has no sentence with a time (RMC, GGA, GLL, ZDA): let the logger write the time "
            "before each sentence"
        )
    own = through_midnight(own - own[there][0])
    return np.array([*_spread([kind for kind, _, _ in found], own)])


def _time_of_day(kind: str, fields: Sequence[str]) -> float:
    digits = fields[_CLOCKS[kind]] if kind in _CLOCKS and len(fields) > _CLOCKS[kind] else ""
    if not re.fullmatch(r"\d{6}(\.\d*)?", digits):
        return float("nan")
    return 3600.0 * float(digits[:2]) + 60.0 * float(digits[2:4]) + float(digits[4:])


def _spread(kinds: Sequence[str], own: np.ndarray) -> Iterator[float]:
    """Times of all sentences: one without has that before it, several of a kind are spread up to the next."""
    last = np.maximum.accumulate(np.where(np.isfinite(own), np.arange(len(own)), -1))
    epochs = np.where(last >= 0, own[last], np.nan)
    steps = np.diff(np.unique(epochs[np.isfinite(epochs)]))
    usual = float(np.median(steps)) if len(steps) else 0.0
    several = Counter(zip(kinds, epochs, strict=True))
    seen = Counter[tuple[str, float]]()
    for kind, time, stated in zip(kinds, epochs, np.isfinite(own), strict=True):
        whole = stated or np.isnan(time)
        yield time if whole else time + usual * seen[kind, time] / several[kind, time]
        seen[kind, time] += 1


def _accepts(path: Path, head: bytes) -> bool:
    if not _WHOLE.search(head):
        return False
    with path.open("rb") as stream:
        begin = stream.read(_BEGIN)
    return 2 * len(_WHOLE.findall(begin)) > begin.count(b"\n") > 0


FORMAT = Format("NMEA 0183", (".nmea", ".txt"), _accepts, _read, 100_000_000)
