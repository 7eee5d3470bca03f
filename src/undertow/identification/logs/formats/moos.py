"""MOOS: .alog, a text with a line for every value that a process published."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import Column, Frames, LogMapping

from .fieldlog import FieldLog, Format, Series

# Variables of pNodeReporter and uSimMarine; MOOS counts x to east and y to north, heading clockwise from
# north in degrees, depth downwards.
_KNOWN = {
    "NAV_X": Column(channel="x"),
    "NAV_Y": Column(channel="y"),
    "NAV_DEPTH": Column(channel="z", scale=-1.0),  # ENU counts upwards
    "NAV_HEADING": Column(channel="psi", unit="deg", wrapped=True),
    "NAV_SPEED": Column(channel="u"),
}
_LAST = "value"


def _read(path: Path, messages: Path | None) -> FieldLog:
    found: dict[str, list[tuple[float, float]]] = defaultdict(list)
    damaged = 0
    with path.open(encoding="utf-8", errors="replace") as lines:
        for line in lines:
            if line.startswith("%"):
                continue
            words = line.split(None, 3)
            try:
                sample = float(words[0]), float(words[3])
            except IndexError:
                damaged += len(words) in (1, 2)  # else an empty text, or the end of one with a line break
            except ValueError:
                continue  # a text, which no channel can be
            else:
                found[words[1]].append(sample)
    if not found:
        raise UndertowError(f"log {path} contains no numbers: check that it is complete")
    columns = {name: np.array(rows).T for name, rows in found.items()}
    series = {name: Series(name, t, {_LAST: values}) for name, (t, values) in columns.items()}
    mapping = LogMapping(
        columns={f"{n}.{_LAST}": column for n, column in _KNOWN.items() if n in series},
        frames=Frames(position="ENU", body="FRD", attitude="NED"),
    )
    notes = (f"truncated lines left out: {damaged}",) if damaged else ()
    return FieldLog(path, FORMAT.name, series, mapping, notes=notes)


def _accepts(path: Path, head: bytes) -> bool:
    return path.suffix == ".alog" or (head.startswith(b"%%%") and b"LOG FILE" in head)


FORMAT = Format(
    "MOOS",
    (".alog",),
    _accepts,
    _read,
    100_000_000,
    "aloggrep LOG NAV_X NAV_Y ... LESS.alog leaves variables out",
)
