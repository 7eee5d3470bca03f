"""The logs that a command works on: the options that say how they are read, and the reading of them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NamedTuple, cast

import typer

from undertow.errors import UndertowError, nearest
from undertow.files import read_toml

from .._options import EffectsOption, words
from .._terminal import progress, say

if TYPE_CHECKING:
    from undertow.identification.findings import LongLogs
    from undertow.identification.logs.chunks import LongLog
    from undertow.identification.logs.formats.fieldlog import FieldLog
    from undertow.identification.logs.mapping import Held, LogMapping
    from undertow.identification.logs.opening import FieldLogs
    from undertow.identification.logs.run import Run
    from undertow.identification.long_logs.choosing import Budget, Chosen
    from undertow.identification.report.sentences import CommandLine
    from undertow.model.catalogue import Catalogue
    from undertow.model.vehicle import Vehicle
    from undertow.typing import Progress

Fill = Literal["refuse", "hold", "gap"]


def ordered_logs(context: typer.Context, logs: list[Path] | None) -> list[Path] | None:
    """The logs, refused where a log stands in the place of the vehicle."""
    given = context.params.get("vehicle")
    if given is None or not _is_log(given):
        return logs
    swapped = next((path for path in logs or () if _is_vehicle(path)), None)
    also = f", and '{swapped}' a vehicle in the place of a log" if swapped is not None else ""
    arguments = (p.metavar for p in context.command.params if p.param_type_name == "argument")
    order = " ".join([context.command_path, *filter(None, arguments)])
    raise UndertowError(f"'{given}' is a log in the place of the vehicle{also}: the order is {order}")


def _is_log(given: str) -> bool:
    """Whether a file in the place of the vehicle is none: no text in TOML."""
    from undertow.model.tables import is_file

    path = Path(given)
    if path.suffix == ".toml" or not is_file(path):
        return False
    try:
        read_toml(path, "vehicle file")
    except UndertowError:
        return True
    return False


def refuse_vehicle_as_effect(effect: str, vehicle: str, known: Mapping[str, object]) -> None:
    """Refuse a vehicle in the place of an effect, with the order of the arguments."""
    if effect not in known and _is_vehicle(Path(effect)):
        also = f", and '{vehicle}' an effect in the place of the vehicle" if vehicle in known else ""
        raise UndertowError(
            f"'{effect}' is a vehicle in the place of the effect{also}: the order is undertow add EFFECT "
            "VEHICLE LOG"
        )


def _is_vehicle(path: Path) -> bool:
    from undertow.model.loading import bundled_vehicles

    return str(path) in bundled_vehicles() or path.suffix == ".toml"


LogsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="LOG",
        help="Logs: tables (CSV, Parquet), or vehicle logs in their own format.",
        callback=ordered_logs,
    ),
]
ValidationOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--validation",
        "--holdout",
        metavar="LOG",
        help="Logs for validation, up to the next option.",
    ),
]
MapOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Mapping file: columns, units and frames of the logs.")
]
FillOption = Annotated[
    Fill | None,
    typer.Option(
        help="If a command sample is missing: refuse the log, hold the last value, or leave a gap.",
        show_default="as in the mapping file, else refuse",
    ),
]
TrustOption = Annotated[
    bool,
    typer.Option("--trust-log", help="Use logs that would be refused (wrong units, contradictory channels)."),
]


class Loaded(NamedTuple):
    """What a command works on."""

    vehicle: Vehicle
    runs: list[Run]
    validation: list[Run]
    chosen: Chosen | None = None  # where the logs were too long, which segments of them these are
    field_logs: Sequence[FieldLog] = ()  # those that are as a vehicle wrote them

    def checked(self, models: Mapping[str, Vehicle] | None = None) -> LongLogs | None:
        """What was done with logs that were too long, with the errors of models over the rest of them."""
        if self.chosen is None or not models:
            return None if self.chosen is None else self.chosen.result
        from undertow.identification.long_logs.choosing import with_errors_on_rest

        with progress("checking the rest of the logs") as report:
            return with_errors_on_rest(self.chosen, models, progress=report)


def _print_notes(notes: Mapping[str, Iterable[str]]) -> None:
    """Print the notes of the readers of vehicles' own logs by the path of the log, the same note once."""
    sources: dict[str, list[str]] = {}
    for source, lines in notes.items():
        for line in dict.fromkeys(lines):
            sources.setdefault(line, []).append(source)
    for line, (first, *others) in sources.items():
        say(f"{first}{f' and {len(others)} more' if others else ''}: {line}", "dim")


def _refuse_rig(model: Vehicle, runs: Iterable[Run]) -> None:
    for run in runs:
        if held := [d for d in model.degrees_of_freedom if d in run.held]:
            raise UndertowError(
                f"log {run.source}: a rig holds {', '.join(held)} of '{model.name}': undertow fit and "
                "diagnose take such a log, this command one in which all motions are free"
            )


def say_long(found: LongLogs | None) -> None:
    """Print which segments of long logs were used, and why."""
    for line in found.sentences() if found is not None else ():
        say(line)


@dataclass(frozen=True)
class ReadOptions:
    """How the logs of a command are read."""

    map: MapOption = None
    effects: EffectsOption = None
    since: Annotated[
        float | None, typer.Option("--from", metavar="SECONDS", help="Ignore everything before this time.")
    ] = None
    until: Annotated[
        float | None, typer.Option("--to", metavar="SECONDS", help="Ignore everything after this time.")
    ] = None
    fill: FillOption = None

    @property
    def files(self) -> list[str | Path]:
        """Files that are read, besides the vehicle and the logs."""
        return [*(self.effects or ()), *filter(None, [self.map])]

    @property
    def mapping(self) -> LogMapping | None:
        """What the columns of the logs mean; None where their format is to say so."""
        from undertow.identification.logs.mapping import read_mapping

        return None if self.map is None else read_mapping(self.map)

    @property
    def known(self) -> Catalogue:
        """The catalogue with the effects of the user."""
        from undertow.model.catalogue import with_effects

        return with_effects(self.effects or [])

    def load(
        self,
        vehicle: str,
        logs: Sequence[Path],
        validation: Sequence[Path] | None = None,
        *,
        to_fit: bool = False,
        in_any_order: bool = False,
        one_motion: bool = False,
        on_rig: bool = False,
        budget: Budget | None = None,
        out: Path | None = None,
    ) -> Loaded:
        """The vehicle, its logs and those for validation, with a progress bar.

        `to_fit` refuses more samples than a fit takes as soon as they are read; `in_any_order` drops rows
        that are out of order; `one_motion` takes logs of some of the motions and commands (towing tank),
        `on_rig` those in which a rig holds motions of the vehicle.
        With a `budget`, the most informative segments of logs that are too long are taken.
        `out`: the vehicle file that is to be written after the work; what forbids that is refused now.
        """
        from undertow.identification.logs.reading import read_logs
        from undertow.model.loading import load_vehicle
        from undertow.model.saving import rewritten

        with progress("reading the vehicle", None):
            model = load_vehicle(vehicle, effect_files=self.effects or ())
            if out is not None:
                rewritten(model, vehicle, out)
        opened: FieldLogs = {}
        paths = [*logs, *(validation or ())]
        meanings = [self.meaning(path, model) for path in paths]
        if budget is not None and not any(m.held for m in meanings if m is not None):
            taken = self._of_any_length(
                model, logs, validation or (), budget, opened, to_fit=to_fit, in_any_order=in_any_order
            )
            if taken is not None:
                return taken._replace(field_logs=tuple(opened.values()))
        with progress("reading logs", total=len(paths)) as report:
            runs = read_logs(
                paths,
                model,
                self.mapping,
                window=(self.since, self.until),
                missing_commands=self.fill,
                held=self.rig,
                to_fit=to_fit,
                one_motion=one_motion,
                in_any_order=in_any_order,
                field_logs=opened,
                progress=report,
            )
        _print_notes({run.source: run.reader_notes for run in runs})
        if not (on_rig or one_motion):
            _refuse_rig(model, runs)
        first = sum(run.source in set(map(str, logs)) for run in runs)
        return Loaded(model, runs[:first], runs[first:], field_logs=tuple(opened.values()))

    def _of_any_length(
        self,
        model: Vehicle,
        logs: Sequence[Path],
        validation: Sequence[Path],
        budget: Budget,
        opened: FieldLogs,
        *,
        to_fit: bool,
        in_any_order: bool,
    ) -> Loaded | None:
        """Stretches of logs that are too long; None where they are not. Vehicles' own logs are `opened`."""
        from undertow.identification.long_logs import choosing

        with progress("reading logs", total=len(logs) + len(validation)) as report:
            work, held = (
                self.in_parts(model, paths, opened, report, in_any_order=in_any_order, required=True)
                for paths in (logs, validation)
            )
        long = [*work, *held]
        most = budget.whole
        if not to_fit:
            most = choosing.CUTTING.whole_cells // (1 + 2 * len(model.dof_indices) + len(model.command_names))
        with progress("reading logs") as report:
            if choosing.too_long(long, most):
                _print_notes({str(log.path): log.reader_notes for log in long})
                chosen = choosing.choose(model, work, held, budget, report)
                runs = choosing.at_full_rate(chosen, long) if budget.raw else chosen.runs
                return Loaded(model, runs, chosen.validation, chosen)
            if choosing.beyond_memory(long):
                runs = choosing.short_parts(model, long)
                _print_notes({run.source: run.reader_notes for run in runs})
                return Loaded(model, runs[: len(work)], runs[len(work) :])
        return None

    def in_parts(
        self,
        model: Vehicle,
        logs: Sequence[Path],
        opened: FieldLogs | None = None,
        report: Progress = lambda done, words: None,
        *,
        in_any_order: bool = False,
        required: bool = False,
    ) -> list[LongLog]:
        """Logs, each of their segments by itself, that are read in parts, later."""
        from undertow.identification.logs.chunks import long_logs
        from undertow.identification.logs.opening import dropping_disorder

        found: list[LongLog] = []
        for done, path in enumerate(logs):
            report(done, f"reading {path.name}")
            found += long_logs(
                path,
                self.meaning(path, model),
                model.command_names,
                (self.since, self.until),
                self.fill,
                required=required,
                field_logs=opened,
            )
        if not in_any_order:
            return found
        return [replace(log, mapping=dropping_disorder(log.mapping)) for log in found]

    def meaning(self, path: Path, model: Vehicle) -> LogMapping | None:
        """What the columns of a log mean: by --map, or by the mapping file of its name beside it."""
        from undertow.identification.logs.reading import mapping_for

        return mapping_for(path, self.mapping, model, self.rig)

    @property
    def rig(self) -> Held:
        """Motions that a rig holds in all logs; commands that cannot take such logs have no option for it."""
        return ()


@dataclass(frozen=True)
class LogOptions(ReadOptions):
    """The same, with the option that takes logs as they are."""

    trust_log: TrustOption = False

    @property
    def _named(self) -> dict[str, object]:
        """Options that were given, by name."""
        return {"--map": self.map, "--from": self.since, "--to": self.until, "--fill": self.fill}

    def line(
        self,
        vehicle: str,
        logs: Sequence[Path],
        validation: Sequence[Path] | None,
        written: Path | None = None,
    ) -> CommandLine:
        """What a command named, for the command that it proposes; `written` is the JSON of a diagnosis."""
        from undertow.identification.report.sentences import CommandLine

        pairs = [*self._named.items(), *(("--effects", path) for path in self.effects or ())]
        options = [str(word) for name, value in pairs if value is not None for word in (name, value)]
        options += ["--trust-log"] if self.trust_log else []
        kept, held = (tuple(map(str, paths or ())) for paths in (logs, validation))
        return CommandLine(vehicle, kept, held, tuple(options), str(written or ""))


@dataclass(frozen=True)
class RigOptions(LogOptions):
    """The same, with the option that says which motions a rig holds."""

    held: Annotated[
        str | None,
        typer.Option(
            metavar="unlogged|NAME,NAME",
            help="Motions held at rest by a rig (towing carriage), or moved as logged; unlogged: all "
            "without a column.",
            show_default="as in the mapping file",
        ),
    ] = None

    @property
    def rig(self) -> Held:
        """Motions that a rig holds in all logs."""
        from undertow.model.symbols import DOFS

        names = words([self.held or ""]) if self.held else []
        if names == ["unlogged"]:
            return "unlogged"
        for name in names:
            if name not in DOFS:
                raise UndertowError(
                    f"--held {name} is no motion{nearest(name, DOFS)}: name some of {', '.join(DOFS)}, or "
                    "unlogged"
                )
        return cast("Held", tuple(names))

    @property
    def _named(self) -> dict[str, object]:
        return {**super()._named, "--held": self.held}


def of_experiment(path: Path | None, name: str) -> Path | None:
    """File for one of several experiments: out.json becomes out-surge.json; without a name itself."""
    return path.with_stem(f"{path.stem}-{name}") if path and name else path
