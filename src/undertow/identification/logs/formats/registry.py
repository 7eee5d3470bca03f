"""Which format a log is of, and reading it."""

from __future__ import annotations

import json
import pkgutil
import signal
import sys
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path

from undertow.errors import UndertowError
from undertow.identification.logs.helper import Helper
from undertow.identification.logs.table import refuse_no_file

from .fieldlog import FieldLog, Format, in_order

_HEAD = 512  # bytes from the start of a file that tell its format
TABLES = ("CSV (.csv, .csv.gz)", "Parquet (.parquet)")
"""Formats that are tables already."""


@dataclass(frozen=True)
class TrialSettings:
    """How long reading a file may take that could hang its reader, s of a processor."""

    # Importing the libraries takes two, and unpacking a megabyte of numbers 0.05.
    least: float = 20.0
    per_megabyte: float = 1.0


TRIAL = TrialSettings()


@cache
def formats() -> tuple[Format, ...]:
    """All formats that vehicles write, one from every module of this package that declares one."""
    folder = Path(__file__).parent
    modules = (import_module(f"{__package__}.{m.name}") for m in pkgutil.iter_modules([str(folder)]))
    return tuple(m.FORMAT for m in modules if hasattr(m, "FORMAT"))


def format_of(path: Path) -> Format | None:
    """The format that a vehicle wrote a log in; None for tables, and for what is not there."""
    try:
        with path.open("rb") as stream:
            head = stream.read(_HEAD)
    except IsADirectoryError:
        head = b""
    except OSError:
        return None
    return next((one for one in formats() if one.accepts(path, head)), None)


def open_field_log(path: Path, messages: Path | None = None) -> FieldLog | None:
    """Read a log as its vehicle wrote it; None for tables, and for what is not there.

    `messages` is a folder with definitions of messages, for formats that need them.
    """
    found = format_of(path)
    if found is None:
        return None
    size = path.stat().st_size if path.is_file() else 0
    if size > found.largest:
        raise UndertowError(
            f"log {path} has {size / 1e6:.0f} MB, at most {found.largest / 1e6:.0f} MB of {found.name} can "
            f"be read: {found.shorter}"
        )
    if found.hangs and not _TRIES.answer([str(path.absolute()), _seconds(size)], True, False):
        raise UndertowError(
            f"log {path} cannot be read as {found.name}: its reader fails, or takes more than "
            f"{_seconds(size):.0f} s: copy it again"
        )
    try:
        return in_order(found.read(path, messages))
    except (UndertowError, MemoryError):
        raise
    except Exception as error:  # whatever a library makes of a damaged file
        words = str(error).split("\n")[0] or type(error).__name__
        raise UndertowError(f"log {path} cannot be read as {found.name}: {words}: copy it again") from error


def answer_whether_files_can_be_read() -> None:
    """Read one file after the other, as a process of its own that may break down or be ended."""
    for line in sys.stdin:
        path, seconds = json.loads(line)
        if hasattr(signal, "setitimer"):  # it ends a process that hangs in a library, too
            signal.setitimer(signal.ITIMER_PROF, seconds)
        with suppress(Exception):  # of what can be told, reading it tells
            found = format_of(Path(path))
            log = found.read(Path(path), None) if found else None
            for series in log.series.values() if log else ():
                list(series.columns.values())
        print(json.dumps(True), flush=True)


def _seconds(size: int) -> float:
    """Seconds of a processor that a file of so many bytes may take."""
    return TRIAL.least + TRIAL.per_megabyte * size / 1e6


_TRIES = Helper(f"from {__name__} import answer_whether_files_can_be_read as answer\nanswer()")


def read_field_log(path: Path, messages: Path | None = None) -> FieldLog:
    """The same, of what has to be such a log."""
    found = open_field_log(path, messages)
    if found is None:
        refuse_no_file(path)
    if found is None and path.suffix in (".csv", ".gz", ".parquet"):
        raise UndertowError(
            f"log {path} is a table, which every command reads directly; undertow map new {path} writes a "
            "first mapping file for its columns"
        )
    if found is None:
        raise UndertowError(f"log {path} has an unknown format: {readable()}")
    return found


def readable() -> str:
    """The formats that can be read, in words."""
    known = [f"{one.name} ({', '.join(one.suffixes)})" for one in formats()]
    return f"undertow reads {', '.join([*TABLES, *known])}"
