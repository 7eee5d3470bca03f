"""Analyse years of logs from many vehicles: what changed, month by month, and how uncertain simulations are.

The work is spread over the processors of this machine, or over a Dask cluster (--scheduler). Needs pip
install "undertow[fleet]".

    undertow fleet diagnose rov.toml 'logs/**/*.parquet' --out fleet-2026
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .._options import EffectsOption, bundled
from .._terminal import console, progress, say, section, table, text, write_files
from ._logs import FillOption, LogsArgument, MapOption, TrustOption

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from undertow.fleet.changes import FleetReport, Parameter, Period, VehicleReport
    from undertow.fleet.engine import Engine
    from undertow.fleet.rollouts import Band

app = typer.Typer(add_completion=False)

_SCHEDULER = typer.Option(
    metavar="ADDRESS",
    help="Dask scheduler, such as tcp://10.0.0.1:8786; its workers must see the same paths.",
)
_WORKERS = typer.Option(
    metavar="N",
    min=0,
    help="Processes on this machine; 0: in this process, without Dask.",
    show_default="one per processor",
)
_PATIENCE = typer.Option(
    metavar="SECONDS", min=1.0, help="Give up on the remaining work when no worker answers for this long."
)
_LISTEN = typer.Option(
    metavar="ADDRESS",
    help="Address on which the local cluster listens; anyone who can reach it can run code here.",
    show_default="127.0.0.1: this machine only",
)
_FLEET_VEHICLE = typer.Argument(
    metavar="VEHICLE",
    help="Vehicle file or bundled vehicle; {vehicle} in the path is replaced by the name of each vehicle.",
)
_PATTERNS = typer.Argument(
    metavar="LOGS",
    help="Patterns of log files (Parquet or vehicle logs; quote them), or folders of Parquet files.",
)
_OUT = typer.Option(
    metavar="FOLDER",
    help="Folder for the report and for intermediate results, from which a later run resumes.",
)
_DAILY = typer.Option(
    metavar="EFFECT",
    help="Effect whose values may differ in every log; may be repeated.",
    show_default="ocean_current, net_buoyancy, constant_force",
)
_PASSES = typer.Option(min=1, max=5, help="Number of linearisations, each at the previous result.")


@dataclass(frozen=True)
class FleetOptions:
    """Where the work is done, and how the logs are read."""

    scheduler: Annotated[str | None, _SCHEDULER] = None
    workers: Annotated[int | None, _WORKERS] = None
    patience: Annotated[float, _PATIENCE] = 900.0
    listen: Annotated[str | None, _LISTEN] = None
    map: MapOption = None
    effects: EffectsOption = None
    fill: FillOption = None
    trust_log: TrustOption = False

    def engine(self) -> AbstractContextManager[Engine]:
        """What does the work."""
        from undertow.fleet.engine import engine

        return engine(self.scheduler, self.workers, self.patience, self.listen)

    @property
    def files(self) -> tuple[str, ...]:
        """Files with effects as workers see them."""
        return tuple(str(f.absolute()) for f in self.effects or ())

    @property
    def mapping(self) -> str:
        """What the columns of the logs mean."""
        from undertow.identification.logs.mapping import read_mapping

        return "{}" if self.map is None else read_mapping(self.map).model_dump_json()


@app.command()
@bundled
def diagnose(
    vehicle: Annotated[str, _FLEET_VEHICLE],
    logs: Annotated[list[str], _PATTERNS],
    options: FleetOptions,
    out: Annotated[Path, _OUT] = Path("fleet-results"),
    daily: Annotated[list[str] | None, _DAILY] = None,
    passes: Annotated[int, _PASSES] = 1,
) -> int:
    """Tabulate parameters by vehicle and month, and find which effect grew (fouling, thruster wear).

    Every file is the log of one vehicle and day: logs/vehicle=V/day=2026-05-01/part.parquet. Without such
    folders, vehicle and day come from columns `vehicle` and `day`, or from the name of the folder (the
    vehicle) and a date in the file name or a time that counts from 1970. A vehicle log (.bin, .ulg, ...) has
    folders or a date in its name.

    \b
        undertow fleet diagnose rov.toml 'logs/**/*.parquet' --out fleet-2026
        undertow fleet diagnose 'fitted/{vehicle}.toml' logs --scheduler tcp://10.0.0.1:8786

    Each log is reduced to a small table, which is kept under --out by the content of the file: a second run
    computes only what is missing. A change is named only if it exceeds the day-to-day scatter, corrected for
    all tests (1% chance of a single false name in the whole report), and if nothing else that was tried
    explains it; otherwise the report says that it cannot tell.

    Exit code 0: all files were used; 1: some could not be used, and are named; 2: a mistake in the input.
    """
    import json

    from undertow.files import together, write_whole
    from undertow.fleet.diagnose import Store
    from undertow.fleet.diagnose import diagnose as diagnose_fleet
    from undertow.fleet.reduction import DAILY, Job
    from undertow.model.loading import load_vehicle

    with options.engine() as engine:
        seen = _seen(vehicle)
        if seen is not None:
            load_vehicle(vehicle, effect_files=[Path(f) for f in options.files])  # before any log is opened
        job = Job(
            seen or str(Path(vehicle).absolute()),
            options.files,
            options.mapping,
            daily=DAILY if daily is None else tuple(daily),
            fill=options.fill,
            trust_log=options.trust_log,
        )
        store = Store(out)
        with progress("checking files") as report:
            found = diagnose_fleet(logs, job, engine, store, report, passes=passes)
        show(found)
        with together():
            write_whole(out / "report.json", json.dumps(found.plain(), indent=1, allow_nan=False) + "\n")
            write_whole(out / "report.md", page(found))
        say(f"wrote {out / 'report.md'} and report.json")
        return 0 if found.whole else 1


def _seen(vehicle: str) -> str | None:
    """A vehicle as workers see it; None where each vehicle has a file of its own."""
    from undertow.fleet.diagnose import PLACE

    return None if PLACE in vehicle else _whole_path(vehicle)


def _whole_path(vehicle: str) -> str:
    """The whole path of a vehicle file, or the name of a bundled vehicle."""
    return str(Path(vehicle).absolute()) if Path(vehicle).is_file() else vehicle


@app.command()
@bundled
def rollouts(
    vehicle: Annotated[
        str, typer.Argument(metavar="VEHICLE_FIT", help="Vehicle file that a fit has written.")
    ],
    logs: LogsArgument,
    options: FleetOptions,
    count: Annotated[int, typer.Option(metavar="N", min=10, help="Number of rollouts per window.")] = 500,
    horizon: Annotated[float, typer.Option(metavar="SECONDS", min=0.01, help="Length of a window.")] = 10.0,
    coverage: Annotated[
        float, typer.Option(metavar="SHARE", min=0.01, max=0.999, help="Coverage of the band.")
    ] = 0.9,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the parameter draws.")] = 0,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.parquet", help="Write the bands of all channels.")
    ] = None,
) -> int:
    """Simulate logs many times with parameters drawn from their uncertainty, and compare with the
    measurement.

    Parameters are drawn from the covariance that a fit wrote into the vehicle file (or from stated standard
    deviations), within physical bounds. Every window of a log starts from the measured motion and is driven
    by the logged commands. The table gives the fraction of the measurement that lies within the band of the
    rollouts plus sensor noise.

    \b
        undertow fit rov.toml run1.csv run2.csv --out fitted.toml
        undertow fleet rollouts fitted.toml run3.csv --count 1000 --horizon 20 --out bands.parquet

    Exit code 0: all rollouts were used; 1: some diverged or some logs could not be used, and are named; 2: a
    mistake in the input.
    """
    from undertow.files import check_writable
    from undertow.fleet.rollouts import RolloutJob, to_parquet
    from undertow.fleet.rollouts import rollouts as roll_out
    from undertow.identification.logs.table import refuse_no_file

    with options.engine() as engine:
        check_writable(out, inputs=[*logs, vehicle, *options.files])
        for log in logs:
            refuse_no_file(log)
        seen, mapping = _whole_path(vehicle), options.mapping
        job = RolloutJob(
            seen, options.files, mapping, options.fill, options.trust_log, horizon, coverage, seed
        )
        with progress("rolling out") as report:
            paths = [str(p.absolute()) for p in logs]
            bands, failed, source = roll_out(job, paths, count, engine, report)
        diverged = _show_bands(bands, count, horizon, coverage, source)
        for place, words in failed.items():
            say(f"left out: {words if place.partition(',')[0] in words else f'{place}: {words}'}", "yellow")
        write_files((out, lambda _: to_parquet(bands)))
        return 1 if failed or diverged else 0


def _show_bands(bands: Sequence[Band], count: int, horizon: float, coverage: float, source: str) -> int:
    """Print how the logs lie in the bands; how many rollouts diverged."""
    from undertow.fleet.rollouts import shares_within

    heads = ("channel", "within the band, %", "half width at the end", "half width in noise")
    title = f"{count} rollouts of {len(bands)} windows of {horizon:g} s; {source}"
    section(title, table(heads, _band_rows(bands)))
    diverged = sum(b.diverged for b in bands)
    if diverged:
        of = count * len(bands)
        say(
            f"  {diverged} of {of} rollouts diverged and are left out: the bands are too narrow without them",
            "yellow",
        )
    low = [
        name for name, share in shares_within(bands).items() if share < 1 - _LIMITS.outside * (1 - coverage)
    ]
    if low:
        say(
            f"  {', '.join(low)}: the measurement leaves the {coverage:.0%} band more than three times as "
            "often as it should: parameter uncertainty alone does not explain this (undertow diagnose)",
            "yellow",
        )
    return diverged


def _band_rows(bands: Sequence[Band]) -> Iterator[tuple[str, ...]]:
    import numpy as np

    from undertow.fleet.rollouts import shares_within

    for name, share in shares_within(bands).items():
        i = bands[0].names.index(name)
        end = float(np.mean([b.high[-1, i] - b.low[-1, i] for b in bands])) / 2
        first = float(np.mean([b.high[0, i] - b.low[0, i] for b in bands])) / 2
        yield name, f"{100 * share:.3g}", f"{end:.3g}", f"{end / max(first, 1e-300):.3g}"


@dataclass(frozen=True)
class TerminalLimits:
    """How much a terminal has room for, and what it says; report.md has all months, report.json all files."""

    failed_files: int = 20
    months: int = 4
    # Times the share of samples that should be outside a band from which parameters do not explain them, and
    # p-value below which a missing effect is mentioned.
    outside: float = 3.0
    chance: float = 0.01


_LIMITS = TerminalLimits()


def show(found: FleetReport) -> None:
    """Print the results for every vehicle, then what is missing."""
    out = console()
    for of in found.vehicles:
        section(of.vehicle, table(("parameter", *_heads(of)), _estimates(of)))
        out.print(table(("month", "days", "hours", "misfit", "", "against the first month"), _rows(of)))
        for line in _lines(of):
            say(f"  {line}")
    out.print()
    worked = f"{found.worked} computed now, {found.done - found.worked} reused"
    out.print(text(f"{found.done} of {found.found} files were used ({worked})"))
    most = _LIMITS.failed_files
    for path, words in [*found.failed.items()][:most]:
        say(f"left out: {_failed(path, words)}", "yellow")
    if len(found.failed) > most:
        out.print(text(f"and {len(found.failed) - most} more, all in report.json", "yellow"))
    for path, other in found.twins.items():
        say(f"left out: {path} has the content of {other}", "yellow")


def _failed(path: str, words: str) -> str:
    return words if path in words else f"{path}: {words}"


def _heads(of: VehicleReport) -> list[str]:
    return [*(p.name for p in of.months[-_LIMITS.months :]), "all days"]


def _estimates(of: VehicleReport) -> Iterator[tuple[str, ...]]:
    """One line for each parameter: its last months, then all days."""
    periods = [*of.months[-_LIMITS.months :], of.whole]
    for i, one in enumerate(of.whole.parameters):
        yield f"{one.name}, {one.unit}", *(_cell(p.parameters[i]) for p in periods)


def _rows(of: VehicleReport) -> Iterator[tuple[str, ...]]:
    for period in of.months:
        verdict = period.statement
        answer, words = ("", "the first") if verdict is None else (verdict.answer, verdict.words)
        yield (
            period.name,
            f"{period.days}",
            f"{period.seconds / 3600:.3g}",
            f"{period.misfit:.3g}",
            answer,
            words,
        )


def _lines(of: VehicleReport) -> Iterator[str]:
    if of.whole.statement is not None:
        yield f"over all days, in proportion to time: {of.whole.statement.words}"
    yield from of.remarks
    likely = [s for s in of.scores if s.p_value < _LIMITS.chance]
    if likely:
        names = ", ".join(f"{s.effect} ({s.share:.0%} of what is left)" for s in likely)
        yield f"the model may lack {names}: run undertow diagnose on some days"


def page(found: FleetReport) -> str:
    """The report as Markdown."""
    parts = ["# Fleet\n", f"{found.done} of {found.found} files were used.\n"]
    parts += [_section(of) for of in found.vehicles]
    if found.failed:
        lines = [f"- {_failed(path, words)}" for path, words in found.failed.items()]
        parts.append("\n".join(["## Left out\n", *lines, ""]))
    if found.unscored:
        parts.append(f"Not tested, because they need a search: {', '.join(found.unscored)}.\n")
    return "\n".join([*parts, _HOW])


_HOW = """\
A change is reported where it exceeds the day-to-day scatter (jackknife over days, Student's t,
Holm's rule over all vehicles, months and effects: 1% for a single false report), and a cause is named
where no other cause that was tried explains all of it. Values are one linear step from those of the vehicle
file, with thrust as stated in the file: where a thruster wears, drag and added mass of a month compensate for
it. ± is one standard error, from the scatter of the days, or from the noise if that is more; days count as
independent.
"""


def _section(of: VehicleReport) -> str:
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


def _all(of: VehicleReport) -> list[Period]:
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
