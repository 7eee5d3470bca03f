"""MOOS: .alog, a text with a line for every value that a process published."""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from pathlib import Path

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Column, Frames, LogMapping
from undertow.identification.logs.table import is_number

from .fieldlog import SETTINGS as UNION
from .fieldlog import FieldLog, Format, Series

# Variables of uSimMarine and the like, and the report of pNodeReporter on its own vehicle; MOOS counts x to
# east and y to north, heading clockwise from north in degrees, depth downwards.
_KNOWN = {
    Column(channel="x"): ("NAV_X", "NODE_REPORT_LOCAL.X"),
    Column(channel="y"): ("NAV_Y", "NODE_REPORT_LOCAL.Y"),
    Column(channel="z", scale=-1.0): ("NAV_DEPTH", "NODE_REPORT_LOCAL.DEP"),  # ENU counts upwards
    Column(channel="psi", unit="deg", wrapped=True): ("NAV_HEADING", "NODE_REPORT_LOCAL.HDG"),
    Column(channel="u"): ("NAV_SPEED", "NODE_REPORT_LOCAL.SPD"),
}
_LAST = "value"
_SYNCHRONOUS = ".slog"  # values of some variables at even times, the last ones held
_NUMBERS = re.compile(r"(?:^|,)\s*([A-Za-z_]\w*)\s*=\s*([-+]?\d*\.?\d+(?:[eE][-+]?\d+)?)\s*(?=,|$)")
"""Numbers in a text such as "NAME=henry,X=1.5,Y=-20"."""
_WHO = re.compile(r"(?:^|,)\s*NAME\s*=\s*([^,]+)")  # reports on other vehicles have the same variable


def _read(path: Path, messages: Path | None) -> FieldLog:
    if path.suffix == _SYNCHRONOUS:
        raise UndertowError(
            f"log {path} is a synchronous MOOS log: give the .alog that was written beside it"
        )
    found: dict[tuple[str, str, str], list[tuple[float, float]]] = defaultdict(list)
    damaged = 0
    with path.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            if line.startswith("%"):
                continue
            words = line.split(None, 3)
            try:
                t, who, numbers = float(words[0]), _WHO.search(words[3]), _numbers(words[3])
            except IndexError:
                damaged += len(words) in (1, 2)  # else an empty text, or the end of one with a line break
            except ValueError:
                continue  # the rest of a text with a line break
            else:
                for key, number in numbers.items():
                    found[words[1], who[1] if who else "", key].append((t, number))
    if not found:
        raise UndertowError(
            f"log {path} has no line of a time, a variable, its source and a number, as a MOOS .alog has: "
            "give it as pLogger wrote it"
        )
    vehicles = Counter(name for name, _ in {(name, who) for name, who, _ in found})
    columns = {
        f"{name}[{who}]{key}" if vehicles[name] > 1 else f"{name}{key}": np.array(rows).T
        for (name, who, key), rows in found.items()
    }
    series = {name: Series(name, t, {_LAST: values}) for name, (t, values) in columns.items()}
    known = {next((n for n in names if n in series), ""): column for column, names in _KNOWN.items()}
    mapping = LogMapping(
        columns={f"{name}.{_LAST}": column for name, column in known.items() if name},
        frames=Frames(position="ENU", body="FRD", attitude="NED"),
    )
    notes = (f"truncated lines left out: {damaged}",) if damaged else ()
    return FieldLog(path, FORMAT.name, series, mapping, notes=notes)


def _numbers(text: str) -> dict[str, float]:
    """The number that was published, or those of a text of several, by their names or by their places."""
    try:
        return {"": float(text)}
    except ValueError:
        named = {f".{name}": float(number) for name, number in _NUMBERS.findall(text)}
    parts = text.split(",")
    # A sentence of NMEA has texts like numbers.
    if named or text.startswith("$") or len(parts) > UNION.widest:
        return named
    return {f"[{k}]": float(part) for k, part in enumerate(parts, 1) if is_number(part)}


def _accepts(path: Path, head: bytes) -> bool:
    return path.suffix in (".alog", _SYNCHRONOUS) or (head.startswith(b"%%%") and b"LOG FILE" in head)


FORMAT = Format(
    "MOOS",
    (".alog",),
    _accepts,
    _read,
    100_000_000,
    "aloggrep LOG NAV_X NAV_Y ... LESS.alog leaves variables out",
)
