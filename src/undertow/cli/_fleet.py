"""What `undertow fleet diagnose` does, shows and writes."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from undertow.cli._progress import progress
from undertow.cli._show import console, section, table, text
from undertow.cli._vehicle_and_logs import Fill
from undertow.errors import UndertowError
from undertow.files import together, write_whole
from undertow.fleet.diagnose import PLACE, Question
from undertow.fleet.diagnose import diagnose as diagnose_fleet
from undertow.fleet.engine import Engine
from undertow.fleet.panel import DAILY
from undertow.fleet.reduction import Job
from undertow.fleet.result import Fleet, Of, Parameter, Period
from undertow.fleet.store import Store

_INCOMPLETE = 1
_SHOWN = 20
# Months that a terminal has room for; report.md has all.
_MONTHS = 4


def diagnosed(
    engine: Engine,
    vehicle: str,
    logs: Sequence[str],
    out: Path,
    daily: Sequence[str] | None,
    passes: int,
    map: Path | None,
    effects: Sequence[Path] | None,
    fill: Fill | None,
    trust_log: bool,
) -> int:
    """Diagnose a fleet, print and write the report; 1 where files are missing in it."""
    job = _job(vehicle, daily, map, effects, fill, trust_log)
    store = Store(out)
    with progress("looking at files") as tell:
        found = diagnose_fleet(Question(logs, job, passes), engine, store, tell)
    show(found)
    with together():
        write_whole(out / "report.json", json.dumps(found.plain(), indent=1, allow_nan=False) + "\n")
        write_whole(out / "report.md", page(found))
    console().print(text(f"wrote {out / 'report.md'} and report.json"))
    return 0 if found.whole else _INCOMPLETE


def _job(
    vehicle: str,
    daily: Sequence[str] | None,
    map: Path | None,
    effects: Sequence[Path] | None,
    fill: Fill | None,
    trust_log: bool,
) -> Job:
    from undertow.identification.logs import Mapping, read_mapping
    from undertow.model.loading import load_vehicle

    files = tuple(str(f.absolute()) for f in effects or ())
    if PLACE not in vehicle:
        load_vehicle(vehicle, effect_files=[Path(f) for f in files])  # before any log is opened
    path = Path(vehicle)
    seen = str(path.absolute()) if PLACE in vehicle or path.is_file() else vehicle
    mapping = Mapping() if map is None else read_mapping(map)
    if mapping.time.unit == "iso" or mapping.time.every > 1 or any(c.fresh for c in mapping.columns.values()):
        raise UndertowError(
            f"mapping {map}: dates in words, `every` and `fresh` need whole logs, which a fleet does not "
            "read: give the time as a number, and leave out the others"
        )
    chosen = DAILY if daily is None else tuple(daily)
    return Job(seen, files, mapping.model_dump_json(), daily=chosen, fill=fill, trust_log=trust_log)


def show(found: Fleet) -> None:
    """Print what is said of every vehicle, then what is missing."""
    out = console()
    for of in found.vehicles:
        section(of.vehicle, table(("parameter", *_heads(of)), _estimates(of)))
        out.print(table(("month", "days", "hours", "misfit", "", "against the first month"), _rows(of)))
        for line in _lines(of):
            out.print(text(f"  {line}"), soft_wrap=True)
    out.print()
    worked = f"{found.worked} worked out now, {found.done - found.worked} known before"
    out.print(text(f"{found.done} of {found.found} files count ({worked})"))
    for path, words in [*found.failed.items()][:_SHOWN]:
        out.print(
            text(f"left out: {words if path in words else f'{path}: {words}'}", "yellow"), soft_wrap=True
        )
    if len(found.failed) > _SHOWN:
        out.print(text(f"and {len(found.failed) - _SHOWN} more, all in report.json", "yellow"))
    for path, other in found.twins.items():
        out.print(text(f"left out: {path} has the content of {other}", "yellow"), soft_wrap=True)


def _failed(path: str, words: str) -> str:
    return words if path in words else f"{path}: {words}"


def _heads(of: Of) -> list[str]:
    return [*(p.name for p in of.months[-_MONTHS:]), "all days"]


def _estimates(of: Of) -> Iterator[tuple[str, ...]]:
    """One line for each parameter: its last months, then all days."""
    periods = [*of.months[-_MONTHS:], of.whole]
    for i, one in enumerate(of.whole.parameters):
        yield f"{one.name}, {one.unit}", *(_cell(p.parameters[i]) for p in periods)


def _rows(of: Of) -> Iterator[tuple[str, ...]]:
    for period in of.months:
        said = period.statement
        answer, words = ("", "the first") if said is None else (said.answer, said.words)
        yield (
            period.name,
            f"{period.days}",
            f"{period.seconds / 3600:.3g}",
            f"{period.misfit:.3g}",
            answer,
            words,
        )


def _lines(of: Of) -> Iterator[str]:
    if of.whole.statement is not None:
        yield f"over all days, in proportion to time: {of.whole.statement.words}"
    yield from of.remarks
    likely = [s for s in of.scores if s.p_value < 0.01]
    if likely:
        told = ", ".join(f"{s.effect} ({s.share:.0%} of what is left)" for s in likely)
        yield f"the model may lack {told}: undertow diagnose on some days tells"


def page(found: Fleet) -> str:
    """The report as Markdown."""
    parts = ["# Fleet\n", f"{found.done} of {found.found} files count.\n"]
    parts += [_section(of) for of in found.vehicles]
    if found.failed:
        lines = [f"- {_failed(path, words)}" for path, words in found.failed.items()]
        parts.append("\n".join(["## Left out\n", *lines, ""]))
    if found.unscored:
        parts.append(f"Not looked at, since they have to be searched for: {', '.join(found.unscored)}.\n")
    return "\n".join([*parts, _HOW])


_HOW = """\
A change is told where it stands out of the scatter from day to day (jackknife over days, Student's t, Holm's
rule over all vehicles, months and effects: 1 % for a single false one in this report), and is named where no
other cause that was tried explains all of it. Values are one linear step from those of the vehicle file, with
thrust as the file states it: where a thruster wears, drag and added mass of a month make up for it. ± is one
standard error by the scatter of the days, or by the noise where that is more; days count as independent.
"""


def _section(of: Of) -> str:
    names = [p.name for p in of.whole.parameters]
    units = [p.unit for p in of.whole.parameters]
    heads = ["month", "days", "hours", *(f"{n}, {u}" for n, u in zip(names, units, strict=True))]
    estimates = [
        [p.name, str(p.days), f"{p.seconds / 3600:.3g}", *map(_cell, p.parameters)] for p in _all(of)
    ]
    changed = [s.of for s in of.whole.changes]
    moves = [[p.name, *_moves(p, changed), _words(p)] for p in _all(of)]
    parts = [f"## {of.vehicle}\n", _grid(heads, estimates)]
    parts.append(_grid(["month", *(f"{c}, %" for c in changed), "against the first month"], moves))
    parts += [f"- {line}" for line in _lines(of)]
    return "\n".join([*parts, ""])


def _all(of: Of) -> list[Period]:
    return [*of.months, of.whole]


def _words(period: Period) -> str:
    return period.statement.words if period.statement is not None else "the first"


def _moves(period: Period, names: Sequence[str]) -> list[str]:
    known = {s.of: s for s in period.changes}
    return [_percent(known[n].percent, known[n].error) if n in known else "" for n in names]


def _percent(value: float | None, error: float | None) -> str:
    return "not determined" if value is None else f"{value:+.3g} ± {error:.2g}"


def _cell(parameter: Parameter) -> str:
    if parameter.value is None:
        return "not determined"
    return f"{parameter.value:.4g} ± {parameter.error:.2g}"


def _grid(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines: list[Any] = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"
