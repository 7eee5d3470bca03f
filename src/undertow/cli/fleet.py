"""Years of logs from many vehicles: what changed month by month, and how sure simulations are.

The work is spread over processes of this machine, or over any Dask cluster (--scheduler). Needs
pip install "undertow[fleet]".

    undertow fleet diagnose rov.toml 'logs/**/*.parquet' --out fleet-2026
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from undertow.cli._vehicle_and_logs import EffectsOption, FillOption, MapOption, TrustOption
from undertow.errors import UndertowError
from undertow.files import check_writable, together, write_whole
from undertow.fleet.diagnose import PLACE, Store
from undertow.fleet.diagnose import diagnose as diagnose_fleet
from undertow.fleet.engine import Engine
from undertow.fleet.reduction import DAILY, Job
from undertow.fleet.rollouts import Band, RolloutJob
from undertow.fleet.rollouts import rollouts as roll_out
from undertow.fleet.verdicts import FleetReport, Parameter, Period, VehicleReport

from ._terminal import console, progress, section, table, text
from ._vehicle_and_logs import Fill

app = typer.Typer(add_completion=False)

_SCHEDULER = typer.Option(
    "--scheduler",
    metavar="ADDRESS",
    help="Dask scheduler such as tcp://10.0.0.1:8786; it must see the same paths.",
)
_WORKERS = typer.Option(
    "--workers", metavar="N", min=0, help="Processes on this machine; 0: in this process, without Dask.",
    show_default="one for each processor",
)  # fmt: skip
_PATIENCE = typer.Option(
    "--patience", metavar="SECONDS", min=1.0, help="Give up what is left when no worker answers for so long."
)
_LISTEN = typer.Option(
    "--listen",
    metavar="ADDRESS",
    help="Address of this machine that its cluster listens on; whoever reaches it can run code here.",
    show_default="127.0.0.1, for this machine alone",
)
SchedulerOption = Annotated[str | None, _SCHEDULER]
WorkersOption = Annotated[int | None, _WORKERS]
PatienceOption = Annotated[float, _PATIENCE]
ListenOption = Annotated[str | None, _LISTEN]
_FLEET_VEHICLE = typer.Argument(
    metavar="VEHICLE", help="Vehicle file or bundled vehicle; {vehicle} in a path stands for each name."
)
_PATTERNS = typer.Argument(metavar="LOGS", help="Patterns of Parquet files, or folders; quote the patterns.")
_OUT = typer.Option("--out", metavar="FOLDER", help="Folder for the report, and for results to go on from.")
_DAILY = typer.Option(
    "--daily",
    metavar="EFFECT",
    help="Effect that every log has a value of its own for; may be repeated.",
    show_default="ocean_current, net_buoyancy, constant_force",
)
_PASSES = typer.Option(
    "--passes", min=1, max=5, help="Linearise so often, each time at what was found before."
)


@app.callback()
def _fleet() -> None:
    pass


@app.command()
def diagnose(
    vehicle: Annotated[str, _FLEET_VEHICLE],
    logs: Annotated[list[str], _PATTERNS],
    out: Annotated[Path, _OUT] = Path("fleet-results"),
    scheduler: SchedulerOption = None,
    workers: WorkersOption = None,
    daily: Annotated[list[str] | None, _DAILY] = None,
    passes: Annotated[int, _PASSES] = 1,
    patience: PatienceOption = 900.0,
    listen: ListenOption = None,
    map: MapOption = None,
    effects: EffectsOption = None,
    fill: FillOption = None,
    trust_log: TrustOption = False,
) -> int:
    """A table for each vehicle and month: parameters, and which effect grew (fouling, thruster wear).

    Every Parquet file is the log of one vehicle and day: logs/vehicle=V/day=2026-05-01/part.parquet. Without
    such folders, columns `vehicle` and `day` say so, or the folder's name (the vehicle) with a date in the
    file's name or a time that counts from 1970.

    \b
        undertow fleet diagnose rov.toml 'logs/**/*.parquet' --out fleet-2026
        undertow fleet diagnose 'fitted/{vehicle}.toml' logs --scheduler tcp://10.0.0.1:8786

    Each log is reduced to a small table that is kept under --out by the content of the file: a second run
    does what is missing only. A change is named only where it stands out of the scatter from day to day, with
    all that was looked at counted in (1 % for a single false name in the whole report), and where nothing
    else that was tried explains it; else the report says that it cannot tell.

    Exit code 0: all files count; 1: some could not be used, and are named; 2: a mistake in the input.
    """
    from undertow.fleet.engine import engine

    with engine(scheduler, workers, patience, listen) as doing:
        return diagnosed(doing, vehicle, logs, out, daily, passes, map, effects, fill, trust_log)


@app.command()
def rollouts(
    vehicle: Annotated[
        str, typer.Argument(metavar="VEHICLE_FIT", help="Vehicle file that a fit has written.")
    ],
    logs: Annotated[list[Path], typer.Argument(metavar="LOG", help="Logs: CSV, CSV.gz or Parquet.")],
    count: Annotated[
        int, typer.Option("--count", metavar="N", min=10, help="Rollouts of each window.")
    ] = 500,
    horizon: Annotated[
        float, typer.Option("--horizon", metavar="SECONDS", min=0.01, help="Length of a window.")
    ] = 10.0,
    coverage: Annotated[
        float, typer.Option("--coverage", metavar="SHARE", min=0.01, max=0.999, help="Width of the band.")
    ] = 0.9,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the drawn parameters.")] = 0,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.parquet", help="Write the bands of all channels.")
    ] = None,
    scheduler: SchedulerOption = None,
    workers: WorkersOption = None,
    patience: PatienceOption = 900.0,
    listen: ListenOption = None,
    map: MapOption = None,
    effects: EffectsOption = None,
    fill: FillOption = None,
    trust_log: TrustOption = False,
) -> int:
    """Simulate logs many times with parameters drawn from what a fit left open, and hold them to the bands.

    Parameters are drawn from the covariance that a fit wrote into the vehicle file (or stated standard
    deviations), within physical bounds. Every window of a log starts from the measured motion and is driven
    by the logged commands. The table says how much of the measurement lies within the band of the rollouts,
    with the noise of the sensors on top.

    \b
        undertow fit rov.toml run1.csv run2.csv --out fitted.toml
        undertow fleet rollouts fitted.toml run3.csv --count 1000 --horizon 20 --out bands.parquet

    Exit code 0: all rollouts count; 1: some diverged or some logs could not be used, and are named; 2: a
    mistake in the input.
    """
    from undertow.fleet.engine import engine

    with engine(scheduler, workers, patience, listen) as doing:
        return rolled(
            doing, vehicle, logs, count, horizon, coverage, seed, out, map, effects, fill, trust_log
        )


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
        found = diagnose_fleet(logs, job, engine, store, tell, passes=passes)
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
    from undertow.identification.logs.mapping import LogMapping, read_mapping
    from undertow.model.loading import load_vehicle

    files = tuple(str(f.absolute()) for f in effects or ())
    if PLACE not in vehicle:
        load_vehicle(vehicle, effect_files=[Path(f) for f in files])  # before any log is opened
    path = Path(vehicle)
    seen = str(path.absolute()) if PLACE in vehicle or path.is_file() else vehicle
    mapping = LogMapping() if map is None else read_mapping(map)
    if mapping.time.unit == "iso" or mapping.time.every > 1 or any(c.fresh for c in mapping.columns.values()):
        raise UndertowError(
            f"mapping {map}: dates in words, `every` and `fresh` need whole logs, which a fleet does not "
            "read: give the time as a number, and leave out the others"
        )
    chosen = DAILY if daily is None else tuple(daily)
    return Job(seen, files, mapping.model_dump_json(), daily=chosen, fill=fill, trust_log=trust_log)


def show(found: FleetReport) -> None:
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


def _heads(of: VehicleReport) -> list[str]:
    return [*(p.name for p in of.months[-_MONTHS:]), "all days"]


def _estimates(of: VehicleReport) -> Iterator[tuple[str, ...]]:
    """One line for each parameter: its last months, then all days."""
    periods = [*of.months[-_MONTHS:], of.whole]
    for i, one in enumerate(of.whole.parameters):
        yield f"{one.name}, {one.unit}", *(_cell(p.parameters[i]) for p in periods)


def _rows(of: VehicleReport) -> Iterator[tuple[str, ...]]:
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


def _lines(of: VehicleReport) -> Iterator[str]:
    if of.whole.statement is not None:
        yield f"over all days, in proportion to time: {of.whole.statement.words}"
    yield from of.remarks
    likely = [s for s in of.scores if s.p_value < 0.01]
    if likely:
        told = ", ".join(f"{s.effect} ({s.share:.0%} of what is left)" for s in likely)
        yield f"the model may lack {told}: undertow diagnose on some days tells"


def page(found: FleetReport) -> str:
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


_ROLLOUTS_INCOMPLETE = 1


def rolled(
    engine: Engine,
    vehicle: str,
    logs: Sequence[Path],
    count: int,
    horizon: float,
    coverage: float,
    seed: int,
    out: Path | None,
    map: Path | None,
    effects: Sequence[Path] | None,
    fill: Fill | None,
    trust_log: bool,
) -> int:
    """Roll out, print how the logs lie in the bands, write the bands; 1 where something is missing."""
    from undertow.identification.logs.mapping import LogMapping, read_mapping

    files = tuple(str(f.absolute()) for f in effects or ())
    check_writable(out, inputs=[*logs, vehicle, *files])
    missing = next((log for log in logs if not log.is_file()), None)
    if missing is not None:
        raise UndertowError(f"log {missing} does not exist or is not a file: give the path of a log")
    seen = str(Path(vehicle).absolute()) if Path(vehicle).is_file() else vehicle
    mapping = (LogMapping() if map is None else read_mapping(map)).model_dump_json()
    job = RolloutJob(seen, files, mapping, fill, trust_log, horizon, coverage, seed)
    with progress("rolling out") as tell:
        bands, failed, source = roll_out(job, [str(p.absolute()) for p in logs], count, engine, tell)
    heads = ("channel", "within the band, %", "half width at the end", "half width in noise")
    section(
        f"{count} rollouts of {len(bands)} windows of {horizon:g} s; {source}",
        table(heads, _band_rows(bands)),
    )
    diverged = sum(b.diverged for b in bands)
    if diverged:
        of = count * len(bands)
        told = (
            f"  {diverged} of {of} rollouts diverged and are left out: the bands are too narrow without them"
        )
        console().print(text(told, "yellow"), soft_wrap=True)
    _warn(bands, coverage)
    for place, words in failed.items():
        told = words if place.partition(",")[0] in words else f"{place}: {words}"
        console().print(text(f"left out: {told}", "yellow"), soft_wrap=True)
    if out is not None:
        write_whole(out, parquet(bands))
        console().print(text(f"wrote {out}"))
    return _ROLLOUTS_INCOMPLETE if failed or diverged else 0


def shares(bands: Sequence[Band]) -> dict[str, float]:
    """Share of the measurement that lies within the band, by channel that is measured."""
    found = {}
    for i, name in enumerate(bands[0].names):
        inside = [(b.low[1:, i] <= m) & (m <= b.high[1:, i]) for b in bands if _there(m := b.measured[1:, i])]
        if inside:
            found[name] = float(np.mean(np.concatenate(inside)))
    return found


def _there(measured: np.ndarray) -> bool:
    return bool(np.isfinite(measured).all())


def _band_rows(bands: Sequence[Band]) -> Iterator[tuple[str, ...]]:
    for name, share in shares(bands).items():
        i = bands[0].names.index(name)
        end = float(np.mean([b.high[-1, i] - b.low[-1, i] for b in bands])) / 2
        first = float(np.mean([b.high[0, i] - b.low[0, i] for b in bands])) / 2
        yield name, f"{100 * share:.3g}", f"{end:.3g}", f"{end / max(first, 1e-300):.3g}"


def _warn(bands: Sequence[Band], coverage: float) -> None:
    low = [name for name, share in shares(bands).items() if share < 1 - 3 * (1 - coverage)]
    if low:
        console().print(
            text(
                f"  {', '.join(low)}: the logs leave the band of {coverage:.0%} more than three times as "
                "often as they should: the model lacks more than its parameters say (undertow diagnose)",
                "yellow",
            ),
            soft_wrap=True,
        )


def parquet(bands: Sequence[Band]) -> bytes:
    """Bands as a table: log, window, t, and for each channel the measurement, low, median and high."""
    import polars as pl

    parts = []
    for b in bands:
        columns = {"t": b.t}
        for i, name in enumerate(b.names):
            kinds = (("measured", b.measured), ("low", b.low), ("median", b.median), ("high", b.high))
            columns |= {f"{name}_{kind}": values[:, i] for kind, values in kinds}
        told = pl.DataFrame(columns)
        parts.append(told.select(pl.lit(b.log).alias("log"), pl.lit(b.window).alias("window"), pl.all()))
    stream = io.BytesIO()
    pl.concat(parts).write_parquet(stream)
    return stream.getvalue()
