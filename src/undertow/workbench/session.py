"""What was chosen and found at the workbench, kept in a folder: a file of choices, models, results."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from pydantic import ConfigDict, Field, ValidationError

from undertow.errors import UndertowError
from undertow.files import make_folder, read_json, read_text, sha256_of, write_whole
from undertow.identification.findings import ResultTable
from undertow.identification.logs.mapping import (
    CommandPolicy,
    LogMapping,
    into_file,
    mapping_text,
    place_beside,
    read_edits,
    read_mapping,
)
from undertow.identification.logs.run import MEASURABLE, Run
from undertow.identification.report.sentences import CommandLine
from undertow.model.loading import load_vehicle, resolve_vehicle

SCHEMA: Literal["undertow/workbench/1"] = "undertow/workbench/1"
Role = Literal["train", "judge", "out"]
ROLES: tuple[Role, ...] = get_args(Role)
FORCE = "force"  # the measure of an error that is not one of a prediction
REFITTED = "refitted"  # what a model is called that has other values only
_FILE = "session.json"


class LogSegment(ResultTable):
    """What is done with a part of a log; times in s."""

    start: float
    end: float
    role: Role


class LogChoice(ResultTable):
    """A log and what is done with it and with segments of it; of segments that overlap the last counts.

    `part` numbers the runs of a file that holds several.
    """

    path: str
    part: int = 0
    role: Role = "train"
    stretches: list[LogSegment] = Field(default_factory=list)

    @classmethod
    def within(cls, path: Path, role: Role, span: tuple[float | None, float | None]) -> LogChoice:
        """A log of which what lies before and after a span is left out."""
        ever, (since, until) = MEASURABLE.largest, span
        early = [] if since is None else [LogSegment(start=-ever, end=since, role="out")]
        late = [] if until is None else [LogSegment(start=until, end=ever, role="out")]
        return cls(path=str(path), role=role, stretches=[*early, *late])

    @property
    def roles(self) -> set[Role]:
        """All that is done with it or with parts of it."""
        return {self.role, *(s.role for s in self.stretches)}

    def spans(self, first: float, last: float) -> list[LogSegment]:
        """The log from its first to its last time, cut where what is done with it changes."""
        inner = (t for s in self.stretches for t in (s.start, s.end) if first < t < last)
        edges = sorted({first, last, *inner})
        found: list[LogSegment] = []
        for a, b in pairwise(edges):
            role = self._role_at((a + b) / 2)
            if found and found[-1].role == role:
                found[-1] = found[-1].model_copy(update={"end": b})
            else:
                found.append(LogSegment(start=a, end=b, role=role))
        return found

    def _role_at(self, t: float) -> Role:
        return next((s.role for s in reversed(self.stretches) if s.start <= t < s.end), self.role)

    def parts(self, run: Run) -> Iterator[tuple[Role, Run]]:
        """The run, or its segments as runs of their own, with what is done with them."""
        spans = self.spans(float(run.t[0]), float(run.t[-1]))
        if len(spans) == 1:
            yield spans[0].role, run
            return
        for i, span in enumerate(spans):
            # The sample on an edge belongs to the segment that begins there.
            end = span.end if i == len(spans) - 1 else float(np.nextafter(span.end, -np.inf))
            yield span.role, _part(run.slice(span.start, end), run, span)


def seconds(t: float) -> str:
    """A time in a log, as "49999.9" where four digits would be 5e+04."""
    return f"{t:.4g}" if abs(t) < 1e4 else f"{t:.1f}"


def _part(piece: Run, run: Run, span: LogSegment) -> Run:
    name = f"{run.name} [{seconds(span.start)}-{seconds(span.end)} s]"
    return replace(piece, name=name, part_of=run.origin)


class Remedy(ResultTable):
    """A change of the mapping that the doctor proposed and the user took."""

    id: str
    lines: str


class ModelStep(ResultTable):
    """One version of the vehicle.

    `file` is a vehicle file in the folder of the session ("" for the one given), `effect` what was added,
    `command` what the command line would do the same with, with {vehicle}, {logs}, {options} and {out} to be
    filled in. `errors` are those on validation data by measure: "force" (1 is the noise), "1.6 s" ... (shares
    of the motion); `refitted` those of the model before it, refitted without the effect. `asked` is what was
    asked about it: tasks in their order.
    """

    what: str
    file: str = ""
    effect: str = ""
    command: str = ""
    errors: dict[str, float] = Field(default_factory=dict)
    refitted: dict[str, float] = Field(default_factory=dict)
    asked: list[str] = Field(default_factory=list)


class Session(ResultTable):
    """All that was chosen, and the names of what was found."""

    schema_: Literal["undertow/workbench/1"] = Field(alias="schema", default=SCHEMA)
    vehicle: str
    vehicle_sha256: str = ""
    logs: list[LogChoice]
    effects: list[str] = Field(default_factory=list)
    mapping: str = ""
    remedies: list[Remedy] = Field(default_factory=list)
    fill: CommandPolicy | None = None
    trust_log: bool = False
    measure: str = FORCE
    steps: list[ModelStep] = Field(default_factory=lambda: [ModelStep(what="as given")])
    latest: dict[str, str] = Field(default_factory=dict)
    written: list[str] = Field(default_factory=list)

    model_config = ConfigDict(extra="forbid", populate_by_name=True)

    @property
    def paths(self) -> list[Path]:
        """The files with logs."""
        return [Path(path) for path in dict.fromkeys(log.path for log in self.logs)]

    def chosen(self, runs: Sequence[Run]) -> list[LogChoice]:
        """What is done with each of the runs that were read; new runs of a file are used as its first."""
        known = {(str(Path(log.path)), log.part): log for log in self.logs}
        parts, found = Counter[str](), []
        for run in runs:
            part = parts[run.source]
            first = known[run.source, 0]
            new = LogChoice(path=run.source, part=part, role=first.role)
            found.append(known.get((run.source, part), new))
            parts[run.source] += 1
        return found


@dataclass
class Workspace:
    """A session and the folder that it is kept in."""

    folder: Path
    session: Session

    @classmethod
    def open(cls, folder: Path, wanted: Session) -> Workspace:
        """The session of a folder, which is made where there is none."""
        path = folder / _FILE
        if not path.exists():
            wanted = wanted.model_copy(update={"vehicle_sha256": sha256_of(resolve_vehicle(wanted.vehicle))})
            load_vehicle(wanted.vehicle, effect_files=wanted.effects)  # before a folder is made
            make_folder(folder)
            place = cls(folder, wanted)
            place.save()
            return place
        session = _read(path)
        if resolve_vehicle(session.vehicle) != resolve_vehicle(wanted.vehicle):
            raise UndertowError(
                f"session '{folder}' is about vehicle '{session.vehicle}', not '{wanted.vehicle}': "
                "name another folder with --session"
            )
        known = {Path(log.path).resolve() for log in session.logs}
        new = [log for log in wanted.logs if Path(log.path).resolve() not in known]
        place = cls(folder, session.model_copy(update={"logs": [*session.logs, *new]}))
        place.save()
        return place

    def save(self) -> None:
        """Write the choices down."""
        write_whole(self.folder / _FILE, self.session.model_dump_json(by_alias=True, indent=1) + "\n")

    @property
    def vehicle_changed(self) -> bool:
        """Whether the vehicle file given was edited, or has gone, since the session began."""
        try:
            return sha256_of(resolve_vehicle(self.session.vehicle)) != self.session.vehicle_sha256
        except (UndertowError, OSError):
            return True

    # --- models ---------------------------------------------------------------------------------
    def vehicle_file(self, step: int = -1) -> Path:
        """The vehicle file of a model, by default of the present one."""
        name = self.session.steps[step].file
        return self.folder / name if name else resolve_vehicle(self.session.vehicle)

    def new_file(self, stem: str, suffix: str = ".toml") -> Path:
        """A file of the folder that is not there yet."""
        count = 1
        while (self.folder / f"{stem}-{count}{suffix}").exists():
            count += 1
        return self.folder / f"{stem}-{count}{suffix}"

    # --- logs -----------------------------------------------------------------------------------
    @property
    def mapping_file(self) -> Path | None:
        """The mapping file in use: the one given, or that with what the doctor had mended."""
        if self.session.remedies:
            return self.folder / "mapping.toml"
        return Path(self.session.mapping) if self.session.mapping else None

    def mapping(self, *, mended: bool = True) -> LogMapping | None:
        """What the columns of the logs mean, None where nothing says so; without `mended`, before the last
        remedy.
        """
        given, remedies = self.session.mapping, self.session.remedies
        if mended and remedies:
            return read_mapping(self.folder / "mapping.toml")
        if len(remedies) > 1:
            path = self.folder / "mapping-before.toml"
            write_whole(path, self._mapping_text(remedies[:-1]))
            return read_mapping(path)
        return read_mapping(given) if given else None

    def state_mapping(self, used: LogMapping | None) -> None:
        """Write down what the format of the logs means, to be mended, where no mapping file says it."""
        if self.session.mapping or used is None or not used.columns:
            return
        out = self.folder / "mapping-given.toml"
        write_whole(out, mapping_text(used))
        self.session.mapping = str(out.absolute())

    def write_mapping(self) -> None:
        """Write the mapping file with the remedies, where there are any."""
        if self.session.remedies:
            write_whole(self.folder / "mapping.toml", self._mapping_text(self.session.remedies))

    def _mapping_text(self, remedies: Sequence[Remedy]) -> str:
        given = self.session.mapping
        text = read_text(given, "mapping file") if given else mapping_text(LogMapping())
        for remedy in remedies:
            text = into_file(text, read_edits(remedy.lines))
        return text

    # --- results --------------------------------------------------------------------------------
    @property
    def key(self) -> str:
        """What results are worked out for: the present model, the logs and how they are read."""
        s = self.session
        # Name, size and time, since logs of gigabytes cannot be hashed at every look.
        chosen = [{**log.model_dump(), "path": _seen(Path(log.path))} for log in s.logs]
        mappings = [Path(s.mapping)] if s.mapping else map(place_beside, s.paths)
        small = [self.vehicle_file(), *map(Path, s.effects), *mappings]
        files = [sha256_of(path) for path in small if path.exists()]
        said = json.dumps([files, chosen, [r.lines for r in s.remedies], s.fill, s.trust_log])
        return hashlib.sha256(said.encode()).hexdigest()[:12]

    def keep(self, kind: str, key: str, content: dict[str, Any]) -> None:
        """Write a result down."""
        self.session.latest[kind] = key
        make_folder(self.folder / "results")
        write_whole(self.folder / "results" / f"{kind}-{key}.json", json.dumps(content, allow_nan=False))

    def result(self, kind: str, key: str | None = None) -> dict[str, Any] | None:
        """What was found for the present model and logs; None where nothing was."""
        path = self.folder / "results" / f"{kind}-{key or self.key}.json"
        if not path.exists():
            return None
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return found

    def take_effect(self, path: str) -> None:
        """Use one more file with effects; what was found for the present model holds as before."""
        before, kinds = self.key, ("examine", "compare", "diagnose", "fit")
        found = {kind: self.result(kind) for kind in kinds if self.session.latest.get(kind) == before}
        self.session.effects.append(path)
        for kind, result in found.items():
            if result is not None:
                self.keep(kind, self.key, result)

    def last_result(self, kind: str) -> tuple[dict[str, Any] | None, bool]:
        """The newest result of a kind, and whether it is about the present model and logs."""
        found = self.result(kind)
        if found is not None:
            return found, True
        key = self.session.latest.get(kind)
        return (self.result(kind, key) if key else None), False

    # --- command lines --------------------------------------------------------------------------
    def line(self, vehicle: str | None = None, own: Sequence[str] = ()) -> CommandLine:
        """The words of a command line for the vehicle, the logs and how they are read, with effects `own`."""
        s, mapping = self.session, self.mapping_file
        if s.written:
            beside = Path(s.written[0]).with_suffix(".toml")
            mapping = beside if beside.exists() else None
        options = ["--map", shown_path(mapping)] if mapping else []
        given = [shown_path(path) for path in s.effects if Path(path).parent != self.folder.absolute()]
        options += [word for path in (*given, *own) for word in ("--effects", path)]
        options += ["--fill", s.fill] if s.fill and not s.written else []
        options += ["--trust-log"] if s.trust_log else []
        train, judge = (self.log_names(role) for role in ("train", "judge"))
        return CommandLine(vehicle or shown_path(s.vehicle), tuple(train), tuple(judge), tuple(options))

    def log_names(self, role: str) -> list[str]:
        """Files with what is fitted to ("train") or judged by ("judge")."""
        if self.session.written:
            return [shown_path(name) for name in self.session.written if Path(name).name.startswith(role)]
        return list(dict.fromkeys(shown_path(log.path) for log in self.session.logs if log.role == role))

    @property
    def in_pieces(self) -> bool:
        """Whether segments of logs were chosen, which command lines can name as files of their own only."""
        roles = {log.path: log.role for log in self.session.logs}
        used = ((log.path, role) for log in self.session.logs for role in log.roles)
        return any(role != roles[path] for path, role in used)


def _seen(path: Path) -> list[str | int]:
    return [path.name, path.stat().st_size, path.stat().st_mtime_ns] if path.exists() else [path.name]


def shown_path(path: str | Path) -> str:
    """A path as somebody in the present folder would write it; the name of a bundled vehicle stays."""
    place = Path(path)
    return str(place.relative_to(Path.cwd())) if place.is_relative_to(Path.cwd()) else str(path)


def _read(path: Path) -> Session:
    try:
        return Session.model_validate_json(read_json(path, "session of the workbench"))
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        place = ".".join(map(str, fault["loc"]))
        raise UndertowError(
            f"{path}: {place}: {fault['msg'].lower()}: correct it, or name another folder with --session"
        ) from error
