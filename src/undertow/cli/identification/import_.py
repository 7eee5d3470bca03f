"""Convert a vehicle log into a table, with a mapping file that says how it was read.

    undertow import dive.bin --list
    undertow import dive.bin --vehicle my-rov.toml --out dive.parquet
    undertow import pose.csv imu.csv motors.csv --vehicle my-rov.toml --out dive.parquet

Every command that takes a log reads such files directly. An imported log is read faster, needs no extra
library and can be shared. The mapping file next to it (dive.toml) records which column became which channel;
correct it there: undertow doctor my-rov.toml dive.parquet --map dive.toml. If no column is recognised as a
motion, the table has all of them, and the mapping file asks for their meaning, as undertow map new does.

Tables of one run, each on its own clock, are merged into one, with empty cells where one has no sample.

--list shows the contents of the file: series, their rates and time spans, and the longest gap.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from undertow.errors import UndertowError

from .._options import NewForceOption, new_file
from .._terminal import progress, say, section, table, write_files
from ._logs import MapOption
from .map import show_guesses

if TYPE_CHECKING:
    from polars import DataFrame

    from undertow.identification.logs.formats.fieldlog import Series
    from undertow.identification.logs.mapping import LogMapping

_LOGS = typer.Argument(
    metavar="LOG", help="Vehicle log of any format, or the tables of one run: a folder, or several files."
)
_OUT = typer.Option(metavar="NEW.parquet", help="Table to write: .parquet or .csv.")
_LIST = typer.Option("--list", help="Show what the log contains and write nothing.")
_VEHICLE = typer.Option(
    metavar="VEHICLE", help="Vehicle file or name; its commands are assigned to the motors in order."
)
_MESSAGES = typer.Option(
    metavar="FOLDER",
    help="Folder with definitions that are not in the log: ROS messages (.msg), glider sensors (.cac).",
)
_ELEMENT = re.compile(r"\[(\d+)\](?=[^\[\]]*$)")  # the last index in the name of a column
_HEAD = ("series", "samples", "per second", "from s", "to s", "longest gap s", "columns")


def import_(
    logs: Annotated[list[Path], _LOGS],
    out: Annotated[Path | None, _OUT] = None,
    list_: Annotated[bool, _LIST] = False,
    vehicle: Annotated[str | None, _VEHICLE] = None,
    map: MapOption = None,
    messages: Annotated[Path | None, _MESSAGES] = None,
    force: NewForceOption = False,
) -> None:
    from undertow.identification.logs.formats.by_name import first_mapping
    from undertow.identification.logs.formats.fieldlog import one_run
    from undertow.identification.logs.mapping import LogMapping, mapping_text, read_mapping
    from undertow.identification.logs.opening import columns_read
    from undertow.model.loading import load_vehicle

    if not (out or list_):
        raise UndertowError("nothing to do: give --out NEW.parquet, or --list to see what the log contains")
    target = None if out is None or list_ else new_file(out, force, [*logs, *filter(None, [map])])
    beside = None if target is None else new_file(target.with_suffix(".toml"), force, filter(None, [map]))
    given = read_mapping(map) if map else None
    model = load_vehicle(vehicle) if vehicle else None
    with progress("reading", None):
        found = one_run(logs, messages or (given.messages if given else None))
    for note in found.notes if given else found.read_as:
        say(note, "dim")
    if target is None or beside is None:
        section(
            f"{found.path}: {found.format}", table(_HEAD, [_row(series) for series in found.series.values()])
        )
        return
    guessed = None if given else first_mapping(found, model)
    meaning = guessed.meaning if guessed else given or LogMapping()
    text = guessed.text() if guessed else mapping_text(meaning)
    _write(found.table([*columns_read(meaning), *meaning.ignore]), target, text, beside)
    if not _has_motion(meaning):
        say(f"no column is recognised as a motion: {target} has all of them", "yellow")
    if guessed:
        show_guesses(guessed, found.path)
    say(f"the meaning of the columns is in {beside}: correct it there if it is wrong")
    files = shlex.join([str(vehicle or "VEHICLE"), str(target), "--map", str(beside)])
    say(f"then: undertow doctor {files}")


def _row(series: Series) -> tuple[str, ...]:
    """Name, samples, samples a second, first and last time, longest gap and columns of a series."""
    from numpy import diff, median

    from undertow.identification.logs.formats.fieldlog import rising

    t, names = series.t[rising(series.t)], ", ".join(_elements_together(series.columns))
    steps = diff(t)
    pace = (f"{1 / median(steps):.4g}", f"{steps.max():.3g}") if len(steps) else ("", "")
    span = (f"{t[0]:z.2f}", f"{t[-1]:z.2f}") if len(t) else ("", "")
    return series.name, str(len(series.t)), pace[0], *span, pace[1], names


def _elements_together(columns: Iterable[str]) -> list[str]:
    """Names of columns, the elements of an array as one: control[0], control[1] become control[0-1]."""
    arrays: dict[str, list[str]] = {}
    for name in columns:
        place = _ELEMENT.search(name)
        arrays.setdefault(_ELEMENT.sub("[]", name), []).append(place[1] if place else "")
    ends = {name: "-".join(dict.fromkeys((at[0], at[-1]))) for name, at in arrays.items()}
    return [name.replace("[]", f"[{end}]") for name, end in ends.items()]


def _has_motion(meaning: LogMapping) -> bool:
    from undertow.identification.logs.run import MEASURED

    return bool(MEASURED & {*(column.channel for column in meaning.columns.values()), *meaning.channels})


def _write(rows: DataFrame, out: Path, meaning: str, beside: Path) -> None:
    """Write a table, and beside it the mapping file that says what its columns mean."""
    cells = BytesIO()
    if out.suffix == ".csv":
        rows.write_csv(cells)
    else:
        rows.write_parquet(cells)
    write_files((out, lambda _: cells.getvalue()), (beside, meaning))
