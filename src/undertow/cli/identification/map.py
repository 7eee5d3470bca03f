"""Draft a mapping file for a log: guesses, and questions about what cannot be inferred from the log.

    undertow map new run1.csv --vehicle rov.toml --out log.toml

Channels are guessed from the names of the columns, units from names and ranges (degrees or radians,
milliseconds or seconds), axes from whether position, heading and velocity agree. Every line with '# ?' in
the file is a question; `undertow doctor VEHICLE LOG --map log.toml` then tries the usual mistakes on the log.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._options import NewForceOption, new_file
from .._terminal import progress, say, section, table

if TYPE_CHECKING:
    from undertow.identification.logs.guess_frames import GuessedMapping

app = typer.Typer(add_completion=False)

_LOGS = typer.Argument(
    metavar="LOG",
    help="The log: a table, a vehicle log, or the tables of one run (a folder, or several files).",
)
_VEHICLE = typer.Option(
    metavar="VEHICLE", help="Vehicle file or name; its commands are searched for in the log."
)
_INTERVAL = typer.Option(
    metavar="SECONDS",
    help='Sampling interval of a table without times, such as "0.05 s": its rows are that far apart.',
)


@app.command()
def new(
    logs: Annotated[list[Path], _LOGS],
    vehicle: Annotated[str | None, _VEHICLE] = None,
    interval: Annotated[str | None, _INTERVAL] = None,
    out: Annotated[Path, typer.Option(metavar="NEW.toml", help="Output file.")] = Path("log.toml"),
    force: NewForceOption = False,
) -> None:
    """Guess what the columns of a log mean, and write a mapping file with open questions."""
    from undertow.errors import UndertowError
    from undertow.files import write_whole
    from undertow.identification.logs.formats.by_name import first_mapping
    from undertow.identification.logs.formats.fieldlog import format_of, one_run
    from undertow.identification.logs.guess import guess_mapping
    from undertow.model.loading import load_vehicle

    new_file(out, force, [*logs, *([vehicle] if vehicle else [])])
    model = load_vehicle(vehicle) if vehicle else None
    with progress("reading"):
        own = one_run(logs) if len(logs) > 1 or format_of(logs[0]) else None
        if own and interval is not None:
            raise UndertowError(
                f"--interval {interval} is for one table without times: {own.path} has a clock"
            )
        guessed = first_mapping(own, model) if own else guess_mapping(logs[0], model, interval)
    for note in own.read_as if own else ():
        say(note, "dim")
    write_whole(out, guessed.text())
    show_guesses(guessed, own.path if own else logs[0])
    if not guessed.columns:
        say(f"no column looks like a motion or a command: give theirs a channel in {out}", "yellow")
    left = sum(len(names) for names in guessed.ignored.values())
    check = "; check every line with '# ?'" if guessed.asked else ""
    say(f"wrote {out}: {len(guessed.columns)} columns read, {left} left out{check}")
    files, map_file = shlex.join(map(str, logs)), shlex.quote(str(out))
    if len(logs) > 1:
        say(f"then: undertow import {files} --map {map_file} --out NEW.parquet")
    else:
        say(f"then: undertow doctor {shlex.quote(vehicle or 'VEHICLE')} {files} --map {map_file}")


def show_guesses(guessed: GuessedMapping, log: Path) -> None:
    """The columns of a log that were understood, and what is asked of them and of the others."""
    rows = [(g.column, g.channel, str(g.entry.get("unit", ""))) for g in guessed.columns]
    if rows:
        section(f"{log}: guesses", table(("column", "channel", "unit"), rows))
    if guessed.asked:
        section("Questions", table(("",), ((question,) for question in guessed.asked)))
