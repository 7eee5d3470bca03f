"""What the commands that work on a vehicle and logs share: their options, and the reading of both."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from undertow.errors import UndertowError

from ._terminal import Report, progress

if TYPE_CHECKING:
    from undertow.identification.logs.chunks import LongLog
    from undertow.identification.logs.mapping import LogMapping
    from undertow.identification.logs.run import Run
    from undertow.identification.logs.table import LogLimits
    from undertow.model.vehicle import Vehicle

MOST_SAMPLES = 300_000
"""Samples that a fit takes: four hours at 20 Hz. In surge alone, 10^6 take five minutes and 1.4 GB."""
# Lines of a file per sample, at most: some are blank or comments. Only used to stop reading early.
_ROWS_OF_A_SAMPLE = 2

Fill = Literal["refuse", "hold", "gap"]
Window = tuple[float | None, float | None]
VehicleArgument = Annotated[
    str, typer.Argument(metavar="VEHICLE", help="Vehicle file (TOML), or the name of a bundled vehicle.")
]
LogsArgument = Annotated[list[Path], typer.Argument(metavar="LOG", help="Logs: CSV, CSV.gz or Parquet.")]
HoldoutOption = Annotated[
    list[Path] | None,
    typer.Option("--holdout", metavar="LOG", help="Logs kept aside for judging, up to the next option."),
]
MapOption = Annotated[
    Path | None,
    typer.Option("--map", metavar="FILE", help="Mapping file: columns, units and frames of the logs."),
]
EffectsOption = Annotated[
    list[Path] | None,
    typer.Option("--effects", metavar="FILE", help="Python file with effects of your own; it is executed."),
]
FromOption = Annotated[
    float | None, typer.Option("--from", metavar="SECONDS", help="Leave out what is earlier in the logs.")
]
ToOption = Annotated[
    float | None, typer.Option("--to", metavar="SECONDS", help="Leave out what is later in the logs.")
]
FillOption = Annotated[
    Fill | None,
    typer.Option(
        "--fill",
        help="Where a command has no sample: refuse the log, hold the last value, or leave a gap.",
        show_default="refuse, or what the mapping file says",
    ),
]
TrustOption = Annotated[
    bool,
    typer.Option("--trust-log", help="Go on with logs that cannot be: wrong units, contradicting channels."),
]
OutOption = Annotated[
    Path | None, typer.Option("--out", metavar="NEW.toml", help="Write a new vehicle file.")
]
InPlaceOption = Annotated[bool, typer.Option("--in-place", help="Change the vehicle file itself.")]


@dataclass(frozen=True)
class Loaded:
    """A vehicle with its logs.

    Attributes
    ----------
    vehicle : Vehicle
        The model.
    path : Path
        The file it was read from.
    train, holdout : list of Run
        Logs to work on, and logs kept aside; where a log has only pose, velocities are derived from it.
    """

    vehicle: Vehicle
    path: Path
    train: list[Run]
    holdout: list[Run]


def load(
    vehicle: str,
    logs: Sequence[Path],
    holdout: Sequence[Path] | None = None,
    *,
    map: Path | None = None,
    effects: Sequence[Path] | None = None,
    window: Window = (None, None),
    fill: Fill | None = None,
    to_fit: bool = False,
    in_any_order: bool = False,
    one_motion: bool = False,
) -> Loaded:
    """Read a vehicle and logs that are driven by its commands, with a progress bar.

    Parameters
    ----------
    vehicle : str
        Path of a vehicle file, or name of a bundled vehicle.
    logs, holdout : sequence of Path
        Logs to work on, and logs kept aside.
    map : Path, optional
        Mapping file for all of the logs.
    effects : sequence of Path, optional
        Files with effects of the user; they are executed.
    window : (t_min, t_max)
        Part of every log that is used, s.
    fill : "refuse", "hold" or "gap", optional
        What to do where a command has no sample.
    to_fit : bool
        Whether parameters are going to be fitted: logs with too many samples, or with a velocity that never
        changes in those to work on, are refused then.
    in_any_order : bool
        Whether rows that are out of order are dropped instead of refused.
    one_motion : bool
        Whether a log may hold some of the motions and commands only, as one of a towing tank does.

    Raises
    ------
    UndertowError
        If a file cannot be read or does not fit the vehicle, a log is given twice, or a fit would be
        in vain.
    """
    from undertow.identification.logs.mapping import LogMapping, read_mapping
    from undertow.model.loading import load_vehicle, resolve_vehicle

    model = load_vehicle(vehicle, effect_files=effects or ())
    mapping = LogMapping() if map is None else read_mapping(map)
    if in_any_order:
        mapping = mapping.model_copy(update={"time": mapping.time.model_copy(update={"disorder": "drop"})})
    paths = [*logs, *(holdout or ())]
    with progress("reading logs", total=len(paths)) as report:
        runs = _runs(
            paths, one_motion, model, mapping, window, fill, MOST_SAMPLES if to_fit else None, report
        )
    _refuse_twins(runs)
    if to_fit:
        _refuse_dead(runs[: len(logs)], model)
    runs = _distinct(runs)
    return Loaded(model, resolve_vehicle(vehicle), runs[: len(logs)], runs[len(logs) :])


def load_in_parts(
    vehicle: str,
    logs: Sequence[Path],
    *,
    map: Path | None = None,
    effects: Sequence[Path] | None = None,
    window: Window = (None, None),
    fill: Fill | None = None,
) -> tuple[Vehicle, Path, list[LongLog]]:
    """A vehicle, its file, and logs that are read in parts, later.

    Parameters
    ----------
    vehicle, logs, map, effects, window, fill
        As for `load`.

    Raises
    ------
    UndertowError
        If a file cannot be read, or a log is given twice.
    """
    from undertow.identification.logs.chunks import LongLog
    from undertow.identification.logs.mapping import LogMapping, read_mapping
    from undertow.model.loading import load_vehicle, resolve_vehicle

    model = load_vehicle(vehicle, effect_files=effects or ())
    mapping = LogMapping() if map is None else read_mapping(map)
    twice = [path for path, count in Counter(p.resolve() for p in logs).items() if count > 1]
    if twice:
        raise UndertowError(f"log {twice[0]} is given twice: give each once")
    found = [LongLog(path, mapping, model.command_names, window, fill) for path in logs]
    return model, resolve_vehicle(vehicle), found


def _runs(
    paths: list[Path],
    one_motion: bool,
    vehicle: Vehicle,
    mapping: LogMapping,
    window: Window,
    fill: Fill | None,
    most: int | None,
    report: Report,
) -> list[Run]:
    from undertow.identification.logs.pose_velocity import velocities_from_pose
    from undertow.identification.logs.reading import read_log

    needed, also = ((), vehicle.command_names) if one_motion else (vehicle.command_names, ())
    limits = _limits(most, mapping, window)
    runs: list[Run] = []
    for done, path in enumerate(paths):
        report(done, f"reading {path.name}")
        run = read_log(path, mapping, needed, also=also, window=window, missing_commands=fill, limits=limits)
        _refuse_too_many(sum(len(r.t) for r in (*runs, run)), most, path)
        runs.append(run if one_motion else velocities_from_pose(run, vehicle.degrees_of_freedom))
    return runs


def _limits(most: int | None, mapping: LogMapping, window: Window) -> LogLimits:
    """How large logs may be if so many samples of them can be taken; most of a longer one may be left out."""
    from undertow.identification.logs.table import WHOLE

    if most is None or window != (None, None) or mapping.time.disorder == "drop":
        return WHOLE
    return replace(WHOLE, rows=_ROWS_OF_A_SAMPLE * mapping.time.every * most)


def _refuse_too_many(samples: int, most: int | None, path: Path) -> None:
    if most is not None and samples > most:
        raise UndertowError(
            f"log {path}: with it there are {samples} samples, a fit takes at most {most}: take a part "
            "of the logs with --from and --to, or thin them out (10 to 20 samples per second are enough)"
        )


def _refuse_dead(runs: list[Run], vehicle: Vehicle) -> None:
    """A velocity that never changes would be explained by parameters that make the vehicle heavy or stiff."""
    from undertow.identification.logs.checks import constant_channels, refuse_constant

    dead = [constant_channels(run, vehicle.velocity_names) for run in runs]
    refuse_constant(runs[0], [name for name in dead[0] if all(name in found for found in dead)])


def _refuse_twins(runs: list[Run]) -> None:
    """The same data twice would be judged by what it was fitted to, or weigh double."""
    seen: dict[str, str] = {}
    for run in runs:
        if run.sha256 in seen:
            raise UndertowError(
                f"logs {seen[run.sha256]} and {run.source} have the same content: give each once, either to "
                "work on or to keep aside"
            )
        seen[run.sha256] = run.source


def _distinct(runs: list[Run]) -> list[Run]:
    """Runs with names that tell them apart: the folder is added where file names are the same."""
    count = Counter(run.name for run in runs)
    longer = [_with_folder(run) if count[run.name] > 1 else run for run in runs]
    again = Counter(run.name for run in longer)
    return [
        replace(r, name=f"{r.name} ({i})") if again[r.name] > 1 else r for i, r in enumerate(longer, start=1)
    ]


def _with_folder(run: Run) -> Run:
    return replace(run, name=f"{Path(run.source).resolve().parent.name}/{run.name}")
