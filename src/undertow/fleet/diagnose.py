"""A fleet's logs: found, reduced unless already done, summarised for each vehicle and month."""

from __future__ import annotations

import hashlib
import io
import re
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from undertow.errors import UndertowError
from undertow.files import check_folder, make_folder, write_whole
from undertow.identification.estimation.step import bounds_of, nearest_physical
from undertow.model.parameter import printed
from undertow.model.units import short_unit
from undertow.typing import Progress

from .changes import (
    Change,
    ChangeTests,
    Day,
    FleetReport,
    LeastSquares,
    Parameter,
    Period,
    Score,
    Shift,
    SpanTest,
    Statement,
    VehicleReport,
    by_month,
    days_of,
    selection,
    shift,
    solve,
    statements,
    trend,
    two_sided_p,
)
from .engine import Engine, Failure
from .partitions import Partition, duplicates, find
from .reduction import Job, Panel, Reduced, identify_log, panel_of, reduce_log, with_fingerprint

Vehicles = Mapping[str, tuple[Panel, Sequence[Day]]]


@dataclass(frozen=True)
class DiagnosisSettings:
    """What is said of the values of a vehicle, and how many effects are shown."""

    # Relative change of an added mass from which one linear step is not exact enough.
    largest_linear_change: float = 0.25
    shown_effects: int = 5  # those with the largest share of the residual


SETTINGS = DiagnosisSettings()


@dataclass(frozen=True)
class _Draft:
    """A vehicle with its results, before the verdicts."""

    name: str
    changes: ChangeTests
    days: Sequence[Day]
    asked: tuple[SpanTest, ...]


def summary(vehicles: Vehicles) -> FleetReport:
    """Tables and statements of all vehicles; those of one count all that were looked at."""
    drafts = [_draft(name, ChangeTests(panel), days) for name, (panel, days) in vehicles.items()]
    verdicts = iter(statements([a for d in drafts for a in d.asked]))
    reports = tuple(_vehicle_report(d, list(islice(verdicts, len(d.asked)))) for d in drafts)
    unscored = dict.fromkeys(n for d in drafts for n in d.changes.panel.unscored)
    return FleetReport(reports, unscored=tuple(unscored))


def _draft(name: str, changes: ChangeTests, days: Sequence[Day]) -> _Draft:
    months = list(by_month(days).values())
    spans = [trend(days), *(shift(months[0], later) for later in months[1:])]
    return _Draft(
        name, changes, days, tuple(SpanTest(changes, span, tuple(changes.over(span))) for span in spans)
    )


def _vehicle_report(draft: _Draft, verdicts: Sequence[Statement]) -> VehicleReport:
    months = by_month(draft.days)
    rest: list[tuple[Sequence[Change], Statement | None]] = [((), None)]
    rest += [(a.changes, s) for a, s in zip(draft.asked[1:], verdicts[1:], strict=True)]
    periods = [
        _period(draft.changes, name, own, changes, statement)
        for (name, own), (changes, statement) in zip(months.items(), rest, strict=True)
    ]
    whole = _period(draft.changes, "all", draft.days, draft.asked[0].changes, verdicts[0])
    scores = _scores(draft.changes, draft.days)
    return VehicleReport(draft.name, whole, tuple(periods), scores, tuple(_remarks(draft)))


def _period(
    changes: ChangeTests, name: str, days: Sequence[Day], found: Sequence[Change], statement: Statement | None
) -> Period:
    panel = changes.panel
    solved = _fitted(changes, days)
    total, entries = sum(float(d.gram[-1, -1]) for d in days), sum(d.entries for d in days)
    return Period(
        name=name,
        days=len(days),
        samples=sum(d.samples for d in days),
        seconds=sum(d.seconds for d in days),
        misfit=float(np.sqrt(max(total - solved.reduction, 0.0) / entries)),
        parameters=tuple(_parameter(panel, i, solved) for i in range(len(panel.free))),
        # Inertia is free by itself there, which only says how wear would look as added mass.
        changes=tuple(_shift(c) for c in found if c.direction.kind != "inertia"),
        statement=statement,
    )


def _fitted(changes: ChangeTests, days: Sequence[Day], beside: Sequence[str] = ()) -> LeastSquares:
    """The free parameters of some days, and those of an effect beside them."""
    wanted = [*changes.panel.free, *beside]
    design = selection(changes.names, wanted)
    return solve(days, [design] * len(days), changes.prior.beside(len(beside)))


def _parameter(panel: Panel, place: int, solved: LeastSquares) -> Parameter:
    name, vehicle = panel.free[place], panel.vehicle
    declared = vehicle.declaration(name)
    error = float(solved.errors[place])
    unit = short_unit(declared.unit)
    if not np.isfinite(error):
        return Parameter(name, unit, None, None)
    value = vehicle.value_of(name).value + float(solved.theta[place])
    return Parameter(name, unit, printed(declared, value, vehicle.signs), error)


def _shift(change: Change) -> Shift:
    if not np.isfinite(change.error):
        return Shift(change.direction.name, None, None, 1.0)
    return Shift(change.direction.name, 100 * change.value, 100 * change.error, change.p_value)


def _scores(changes: ChangeTests, days: Sequence[Day]) -> tuple[Score, ...]:
    """Reduction of the residual by effects that the model lacks, one by one."""
    panel = changes.panel
    plain = _fitted(changes, days)
    left = sum(float(d.gram[-1, -1]) for d in days) - plain.reduction
    count, found = sum(len(own) for own in panel.own.values()), []
    for effect, own in panel.own.items():
        solved = _fitted(changes, days, own)
        places = range(len(panel.free), len(panel.free) + len(own))
        chances = [two_sided_p(solved.theta[i], solved.errors[i], len(days) - 1) for i in places]
        share = max(solved.reduction - plain.reduction, 0.0) / max(left, 1e-300)
        found.append(Score(effect, float(share), min(1.0, count * min(chances, default=1.0))))
    return tuple(sorted(found, key=lambda s: -s.share)[: SETTINGS.shown_effects])


def _remarks(draft: _Draft) -> list[str]:
    panel, found = draft.changes.panel, []
    solved = _fitted(draft.changes, draft.days)
    low, high = bounds_of(panel.base)
    inertia = [d for d in draft.changes.directions if d.kind == "inertia"]
    inertial = {n for d in inertia for n, c in zip(panel.names, d.coefficients, strict=True) if c}
    for i, name in enumerate(panel.free):
        stated, moved = panel.vehicle.value_of(name).value, float(solved.theta[i])
        if not low[i] <= stated + moved <= high[i]:
            found.append(f"{name} has an unphysical value: something else is missing in the model")
        elif name in inertial and abs(moved) > SETTINGS.largest_linear_change * abs(stated):
            found.append(
                f"{name} is {moved / stated:+.0%} from the file's value, too far for one linear step: "
                "use --passes 2"
            )
    return [*found, *(f"no change of {what} can be estimated" for what in draft.changes.unseen)]


# What reading a damaged file raises: its packing, its list of contents, or a flag for what is not supported.
_DAMAGED = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    RuntimeError,  # of a zip file that is encrypted, or packed in a way that Python does not read
    zipfile.BadZipFile,
    zlib.error,
)


class Store:
    """A folder with one small file for each partition that is done.

    Its name comes from the hash of the log's bytes and of all that decides what is made of them: a log that
    was moved or renamed is found again, one that was changed is not.
    """

    def __init__(self, folder: Path) -> None:
        check_folder(folder)
        self.folder = folder / "partitions"
        make_folder(self.folder)

    def _path(self, fingerprint: str, sha256: str) -> Path:
        return self.folder / f"{hashlib.sha256(f'{fingerprint}{sha256}'.encode()).hexdigest()}.npz"

    def get(self, fingerprint: str, sha256: str) -> Reduced | None:
        """What is known of a log; None where nothing is, or the file is damaged."""
        path = self._path(fingerprint, sha256)
        try:
            return _read(path.read_bytes()) if path.is_file() else None
        except _DAMAGED:
            return None

    def put(self, fingerprint: str, sha256: str, reduced: Reduced) -> None:
        """Keep what was worked out of a log."""
        stream = io.BytesIO()
        content: dict[str, Any] = {name: np.array(value) for name, value in vars(reduced).items()}
        np.savez_compressed(stream, **content)
        write_whole(self._path(fingerprint, sha256), stream.getvalue())


def _read(data: bytes) -> Reduced | None:
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        if packed.testzip() is not None:  # NumPy reads on without the checksum
            return None
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:
        samples, seconds, entries = (stored[name].item() for name in ("samples", "seconds", "entries"))
        names = tuple(str(n) for n in stored["names"])
        return Reduced(names, stored["factor"], samples, seconds, entries)


PLACE = "{vehicle}"
# What may stand for a vehicle in the path of its file: it leads to no other folder.
_NAME = re.compile(r"(?!\.\.?$)[^/\\\0]+")
_NO_NAME = "'{}' is not a valid file name: rename the vehicle, or give one file for all vehicles"


@dataclass
class _Known:
    """What is known of the files so far."""

    partitions: dict[Partition, str] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    worked: set[Path] = field(default_factory=set)


def diagnose(
    patterns: Sequence[str],
    job: Job,
    engine: Engine,
    store: Store,
    report: Progress = lambda done, words: None,
    *,
    passes: int = 1,
) -> FleetReport:
    """Estimates, changes and scores of every vehicle whose Parquet files fit one of the patterns.

    A file that cannot be used, or whose worker is lost, is named in the answer; all others count. What was
    worked out is kept in the store, and only what is missing there is done. `{vehicle}` in the vehicle file
    of the job stands for the name of each vehicle. The model is linearised `passes` times, each time at what
    was found before.
    """
    paths = find(patterns)
    known = _identified(paths, job, engine, report)
    same = duplicates(known.partitions.items())
    for partition in same:
        del known.partitions[partition]
    jobs = _jobs(job, sorted({p.vehicle for p in known.partitions}))
    done: Vehicles = {}
    for turn in range(passes):
        report(0.05, f"reducing, pass {turn + 1} of {passes}")
        done = _reduced(jobs, known, engine, store, lambda share, words: report(0.05 + 0.9 * share, words))
        if turn + 1 < passes:
            jobs = {v: _relinearised(jobs[v], *done[v]) for v in done}
    _refuse_nothing(done, known, len(paths))
    report(0.95, "combining months")
    found = summary(done)
    return replace(
        found,
        failed=dict(sorted(known.failed.items())),
        twins={str(p.path): str(other.path) for p, other in same.items()},
        done=len(known.partitions),
        found=len(paths),
        worked=sum(p.path in known.worked for p in known.partitions),
    )


def _identified(paths: Sequence[Path], job: Job, engine: Engine, report: Progress) -> _Known:
    known = _Known()
    items = [(str(p), job.mapping) for p in paths]
    for count, (place, answer) in enumerate(engine.results(identify_log, items), start=1):
        report(0.05 * count / len(paths), "checking files")
        if isinstance(answer, Failure):
            known.failed[str(paths[place])] = answer.words
        else:
            partition, sha256 = answer
            if PLACE in job.vehicle and not _NAME.fullmatch(partition.vehicle):
                known.failed[str(partition.path)] = _NO_NAME.format(partition.vehicle)
            else:
                known.partitions[partition] = sha256
    known.partitions = dict(sorted(known.partitions.items()))
    return known


def _jobs(job: Job, vehicles: Sequence[str]) -> dict[str, Job]:
    """The job of every vehicle, with the fingerprint of its model."""
    found: dict[str, Job] = {}
    by_source: dict[str, Job] = {}
    for vehicle in vehicles:
        source = job.vehicle.replace(PLACE, vehicle)
        if source not in by_source:
            by_source[source] = with_fingerprint(replace(job, vehicle=source))[0]
        found[vehicle] = by_source[source]
    return found


def _reduced(
    jobs: Mapping[str, Job], known: _Known, engine: Engine, store: Store, report: Progress
) -> Vehicles:
    """Work out what is not known yet; then all that is known, in the order of vehicles, days and files."""
    missing = [
        (p, h) for p, h in known.partitions.items() if store.get(jobs[p.vehicle].fingerprint, h) is None
    ]
    items = [(jobs[p.vehicle], str(p.path), sha256) for p, sha256 in missing]
    for count, (place, answer) in enumerate(engine.results(reduce_log, items), start=1):
        partition, sha256 = missing[place]
        report(count / len(missing), f"{count} of {len(missing)}: {partition.name}")
        if isinstance(answer, Failure):
            known.failed[str(partition.path)] = answer.words
            del known.partitions[partition]
        else:
            store.put(jobs[partition.vehicle].fingerprint, sha256, answer)
            known.worked.add(partition.path)
    left = {p.vehicle for p in known.partitions}
    return {v: (panel_of(job), _days(v, job, known, store)) for v, job in jobs.items() if v in left}


def _days(vehicle: str, job: Job, known: _Known, store: Store) -> list[Day]:
    parts = []
    for partition, sha256 in known.partitions.items():
        if partition.vehicle == vehicle:
            reduced = store.get(job.fingerprint, sha256)
            if reduced is None:
                raise UndertowError(
                    f"'{store.folder}' loses files that are written to it: choose another folder"
                )
            parts.append((partition.day, reduced))
    return days_of(parts)


def _relinearised(job: Job, panel: Panel, days: Sequence[Day]) -> Job:
    """The job linearised at what all days of a vehicle say."""
    found = _fitted(ChangeTests(panel), days)
    model = panel.base
    p, places, bounds = np.array(model.functions.values(), dtype=float), list(model.places), bounds_of(model)
    p[places] = np.clip(p[places] + found.theta, *bounds)
    p = nearest_physical(model, p, bounds)
    values: tuple[tuple[str, Any], ...] = tuple(zip(panel.free, p[places].tolist(), strict=True))
    return with_fingerprint(replace(job, values=values))[0]


def _refuse_nothing(done: Vehicles, known: _Known, count: int) -> None:
    if done:
        return
    path, words = next(iter(sorted(known.failed.items())))
    text = words if path in words else f"{path}: {words}"
    raise UndertowError(f"none of {count} files could be used; {text}" if count > 1 else text)
