"""Long logs: read in parts, decimated, the segments of them that tell most, and errors over the rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial, reduce
from heapq import heappop, heappush
from itertools import chain, islice
from pathlib import Path

import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.files import json_ready
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.predictor import Predictor, predict_each
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.weak_form import adapted, free_parameters
from undertow.identification.estimation.windows import HORIZONS, Prediction, cut, geometric_mean
from undertow.identification.findings import ChosenSegment, LongLogs, ModelOnTheRest, Rest, Role, WholeLog
from undertow.identification.logs.chunks import LongLog
from undertow.identification.logs.opening import refuse_twins, with_distinct_names
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import MEASURABLE, Run
from undertow.identification.logs.table import WHOLE, size_of, too_many_cells
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from .decimation import Band, Segment, Spool, band, decimated, joined, merged, segments, without


@dataclass(frozen=True)
class Budget:
    """Samples of long logs, after decimation, that a command works on and judges by."""

    work: int
    judge: int = 0  # none: the command does not judge
    raw: bool = False  # whether they count before decimation: what looks at the sensors needs every row


#: On two processors and in six degrees of freedom, 12,000 samples are fitted in 25 s.
FIT = Budget(12_000, 4_000)
#: A search fits some forty candidates, several times: 8,000 samples take it a minute.
SEARCH = Budget(6_000, 2_000)
#: Pictures and tables of a model as it is, or a plan.
LOOK = Budget(20_000)
#: An examination of logs: clocks, sensors and units, at the rate at which they were logged.
EXAMINE = Budget(60_000, raw=True)
#: Samples times channels of logs that are looked at as a whole: 300,000 rows in six degrees of freedom.
WHOLE_CELLS = 6_300_000


@dataclass(frozen=True)
class CuttingSettings:
    """Numbers by which long logs are read, cut and divided."""

    rows: int = 100_000  # that are in memory at a time, when a log is read
    fewest: int = 24  # segments that logs are cut into, however slow the vehicle
    # Segments that are looked at; of longer logs, some that are spread evenly.
    most: int = 5_000
    of_budget: int = 4  # segments that the budget has room for, at least
    samples: int = 50  # of a segment, at least: else the weak form has hardly a row
    # Of several logs, one in so many is kept for validation, the last first.
    kept_logs: int = 4
    # A single log is divided into so many parts; every third judges, but for a segment at either end.
    parts: int = 24
    kept_parts: int = 3
    # Share of the number of lines by which that of the samples can be off: lines differ in length.
    estimate: float = 0.7


CUTTING = CuttingSettings()


def too_long(logs: Sequence[LongLog], most: int = MEASURABLE.samples) -> bool:
    """Tell whether logs have more than `most` samples; nothing of them is kept in memory."""
    estimated = sum(_size(log)[0] / log.mapping.time.every for log in logs)
    if estimated <= CUTTING.estimate * most:
        return False
    counted = 0
    for part in chain.from_iterable(log.parts(CUTTING.rows, 0) for log in logs):
        counted += len(part.run.t)
        if counted > most:
            return True
    return False


def beyond_memory(logs: Sequence[LongLog]) -> bool:
    """Tell whether a file is larger than is read as a whole, however little of it is used."""
    return any(rows * columns > WHOLE.cells for rows, columns in map(_size, logs)) or any(
        size_of(log.path) > WHOLE.text for log in logs if not log.in_memory
    )


def _size(log: LongLog) -> tuple[int, int]:
    """Rows and columns; none of what is no table, of which reading it says more."""
    try:
        return log.size
    except UndertowError:
        return 0, 0


def read_in_parts(log: LongLog) -> Run:
    """A log of which the part that is used is short: as it would be read, but from a file of any size."""
    parts: list[Run] = []
    for part in log.parts(CUTTING.rows, 0):
        parts.append(part.run)
        rows, columns = sum(len(run.t) for run in parts), len(part.run.channels)
        if rows * columns > WHOLE.cells:
            raise UndertowError(too_many_cells(f"log {log.path}", rows, columns, WHOLE.cells))
    if not parts:
        raise UndertowError(f"log {log.path} has no two samples in the time window: widen it")
    lost = sum(part.dropped for part in parts)
    return replace(reduce(joined, parts), sha256=log.sha256, dropped=lost)


def short_parts(vehicle: Vehicle, logs: Sequence[LongLog]) -> list[Run]:
    """The same for the logs of a vehicle, with velocities, each with a name of its own."""
    runs = [velocities_from_pose(read_in_parts(log), vehicle.degrees_of_freedom) for log in logs]
    refuse_twins(runs)
    return with_distinct_names(runs)


def at_full_rate(chosen: Chosen, logs: Sequence[LongLog]) -> list[Run]:
    """The segments that were chosen, with every row of the log; the logs are read once more."""
    found = []
    for i, log in enumerate(logs):
        spool = chosen.spools[i]
        spans = [spool.times(s.first, s.stop) for s in merged(chosen.used) if s.log == i]
        pieces: list[list[Run]] = [[] for _ in spans]
        for run in (part.run for part in log.parts(CUTTING.rows, 0)):
            for own, (start, end) in zip(pieces, spans, strict=True):
                if np.any((run.t >= start) & (run.t <= end)):
                    own.append(run.slice(start, end))
        runs = [reduce(joined, own) for own in pieces]
        named = [_segment_of(run, spool, span) for run, span in zip(runs, spans, strict=True)]
        found += [replace(named[0], dropped=spool.dropped), *named[1:]] if named else []
    return [velocities_from_pose(run, chosen.vehicle.degrees_of_freedom) for run in found]


def _segment_of(run: Run, spool: Spool, span: tuple[float, float]) -> Run:
    name = f"{spool.like.name} [{span[0]:.0f}-{span[1]:.0f} s]"
    return replace(run, name=name, part_of=spool.like.origin, sha256=spool.like.sha256, dropped=0)


@dataclass(frozen=True)
class Chosen:
    """What a command works on of long logs."""

    vehicle: Vehicle
    runs: list[Run]  # segments to work on, decimated
    validation: list[Run]  # segments for validation
    result: LongLogs
    spools: list[Spool]  # all of the logs, decimated
    used: list[Segment]  # what `runs` and `validation` are of them


def choose(
    vehicle: Vehicle,
    logs: Sequence[LongLog],
    holdout: Sequence[LongLog] = (),
    budget: Budget = FIT,
    progress: Progress = lambda done, words: None,
) -> Chosen:
    """Choose the segments of long logs that tell most of a vehicle's estimated (or else all) parameters.

    The logs are read once, in parts. They are decimated to the rate that the vehicle's fastest time constant
    asks for and cut into segments long enough for its slowest one. The segments that make the determinant
    of the information largest, equation by equation, are taken until the budget is used up. Without
    `holdout`, and where the budget has room for validation, one log in four is kept for validation, the last
    first; of a single one every third part.
    """
    every = [*logs, *holdout]
    progress(0.0, "finding the bandwidth of the vehicle")
    found = band(vehicle, every)
    spools = _spooled(vehicle, every, found, progress)
    regressor = Regressor(vehicle)
    samples = (budget.work // (found.thin if budget.raw else 1), budget.judge)
    cut = _cut(spools, found, samples[0])
    cut = cut[:: -(-len(cut) // min(CUTTING.most, regressor.most_segments()))]
    kept = _kept([log.path for log in logs], len(holdout), budget)
    progress(0.6, "computing the information of each segment")
    pools = _pools(cut, kept, budget)
    choices = [_chosen(regressor, pool, spools, n) for pool, n in zip(pools, samples, strict=True)]
    progress(0.95, "extracting segments")
    taken = [[pool[k] for k in choice.places] for pool, choice in zip(pools, choices, strict=True)]
    runs, validation = ([_run(vehicle, spools, s) for s in merged(own)] for own in taken)
    result = _result(vehicle, spools, found, cut, kept, pools, choices)
    return Chosen(vehicle, runs, validation, result, spools, [*taken[0], *taken[1]])


def _spooled(vehicle: Vehicle, logs: Sequence[LongLog], found: Band, progress: Progress) -> list[Spool]:
    spools = []
    for i, log in enumerate(logs):
        progress(0.6 * i / len(logs), f"reading {log.path.name}")
        thin = partial(decimated, by=found.thin, step=found.step, commands=vehicle.command_names)
        spool = Spool((part.run for part in log.parts(CUTTING.rows, 0)), thin)
        if not spool.rows:
            raise UndertowError(f"log {log.path} has no two samples in the time window: widen it")
        spool.like = replace(spool.like, sha256=log.sha256)
        spools.append(spool)
    refuse_twins([spool.like for spool in spools])
    for spool, like in zip(spools, with_distinct_names([s.like for s in spools]), strict=True):
        spool.like = like
    return spools


def _cut(spools: Sequence[Spool], found: Band, budget: int) -> list[Segment]:
    """Segments of four slowest time constants, as far as that leaves a choice."""
    step, total = found.step * found.thin, sum(spool.rows for spool in spools)
    wanted = HORIZONS.multiples[-1] * found.slowest / HORIZONS.longest / step if step else np.inf
    longest = max(total // CUTTING.fewest, CUTTING.samples)
    rows = int(max(min(wanted, longest, budget // CUTTING.of_budget), CUTTING.samples))
    return segments(spools, rows)


def _kept(files: Sequence[Path], holdout: int, budget: Budget) -> set[int]:
    """Places of the logs that are kept for validation as a whole; segments of one file stay together."""
    if not budget.judge:
        return set()
    if holdout:
        return set(range(len(files), len(files) + holdout))
    from_last = {path: k for k, path in enumerate(dict.fromkeys(reversed(files)))}
    if len(from_last) == 1:
        return set()
    return {i for i, path in enumerate(files) if from_last[path] % CUTTING.kept_logs == 0}


def _pools(cut: list[Segment], kept: set[int], budget: Budget) -> tuple[list[Segment], list[Segment]]:
    """Segments to work on, and those to judge by."""
    if kept or not budget.judge:
        return [s for s in cut if s.log not in kept], [s for s in cut if s.log in kept]
    size = max(len(cut) // CUTTING.parts, CUTTING.kept_parts)
    judging = [(k // size) % CUTTING.kept_parts == 1 for k in range(len(cut))]
    inside = [
        own and all(judging[max(k - 1, 0) : k + 2]) for k, own in enumerate(judging)
    ]  # a segment beside one to work on would be known to it
    chosen = [s for s, own in zip(cut, judging, strict=True) if not own]
    return chosen, [s for s, own in zip(cut, inside, strict=True) if own]


def _chosen(regressor: Regressor, pool: list[Segment], spools: Sequence[Spool], budget: int) -> Choice:
    if not pool:
        none = np.ones(regressor.equations)
        return Choice([], np.zeros((0, len(none))), none, 1.0)
    information = regressor.information(spools[s.log].run(s.first, s.stop) for s in pool)
    return most_informative(information, [s.samples for s in pool], budget)


def _run(vehicle: Vehicle, spools: Sequence[Spool], s: Segment) -> Run:
    return velocities_from_pose(spools[s.log].run(s.first, s.stop), vehicle.degrees_of_freedom)


def _result(
    vehicle: Vehicle,
    spools: Sequence[Spool],
    found: Band,
    cut: Sequence[Segment],
    kept: set[int],
    pools: Sequence[list[Segment]],
    choices: Sequence[Choice],
) -> LongLogs:
    motions, work = vehicle.degrees_of_freedom, choices[0]
    roles: tuple[Role, Role] = ("train", "holdout")
    tables = zip(pools, choices, roles, strict=True)
    usual = float(np.median([s.samples for s in cut])) * found.step * found.thin
    return LongLogs(
        logs=[_whole(spool, i in kept) for i, spool in enumerate(spools)],
        every=found.thin,
        rate=1.0 / (found.step * found.thin),
        fastest=json_ready(found.fastest),
        slowest=json_ready(found.slowest),
        stretches=len(cut),
        seconds=usual,
        chosen=[s for pool, choice, role in tables for s in _segments(spools, pool, choice, role, motions)],
        information_share=work.whole,
        information_share_by_motion=dict(zip(motions, work.held.tolist(), strict=True)),
    )


def _whole(spool: Spool, holdout: bool) -> WholeLog:
    like, (first, last) = spool.like, spool.span
    return WholeLog(
        name=like.name,
        source=like.source,
        sha256=like.sha256,
        samples=spool.samples,
        seconds=last - first,
        dropped=spool.dropped,
        gaps=spool.gaps,
        longest_gap=spool.longest_gap,
        missing=spool.missing,
        holdout=holdout,
    )


def _segments(
    spools: Sequence[Spool], pool: list[Segment], choice: Choice, role: Role, motions: Sequence[str]
) -> list[ChosenSegment]:
    return [
        _segment(spools[pool[k].log], pool[k], gain, role, motions)
        for k, gain in zip(choice.places, choice.gain, strict=True)
    ]


def _segment(spool: Spool, s: Segment, gain: Array, role: Role, motions: Sequence[str]) -> ChosenSegment:
    start, end = spool.times(s.first, s.stop)
    return ChosenSegment(
        log=spool.like.name,
        start=start,
        end=end,
        samples=s.samples,
        role=role,
        information_gain=float(gain.sum()),
        motion=motions[int(np.argmax(gain))],
    )


# --- what segments tell -------------------------------------------------------------------------------
@dataclass(frozen=True)
class InformationSettings:
    """Numbers by which information is counted."""

    together: int = 20  # segments whose regressor is computed in one call
    bytes: int = 200_000_000  # that the information of all segments may take
    # Directions of which all segments together know less than this share of what they know of the best one
    # (columns scaled to alike size) are not determined by the logs, and do not count.
    known: float = 1e-9
    # Information that is there before any segment is chosen, as a share of that of all: the logarithm has to
    # begin somewhere.
    before: float = 1e-6


SETTINGS = InformationSettings()


class Regressor:
    """The weak form's regressor of a vehicle: derivatives of its residual in the parameters."""

    def __init__(self, vehicle: Vehicle) -> None:
        names = free_parameters(vehicle) or vehicle.parameter_names
        self._vehicle, self._model = vehicle, WeakModel(Functions(vehicle), names)
        self.names, self._p = self._model.free, self._model.initial_p({})
        self.equations = len(vehicle.dof_indices)

    def most_segments(self) -> int:
        """How many segments' information memory is meant for."""
        return int(SETTINGS.bytes // (8 * self.equations * max(len(self.names), 1) ** 2))

    def information(self, runs: Iterator[Run]) -> Array:
        """A^T A of every run by equation of motion, shape (runs, equations, parameters, parameters).

        A segment in which nothing can be computed tells nothing.
        """
        found = []
        while group := list(islice(runs, SETTINGS.together)):
            found.append(self._of(group))
        return np.concatenate(found)

    def _of(self, runs: Sequence[Run]) -> Array:
        count = len(self.names)
        found = np.zeros((len(runs), self.equations, count, count))
        try:
            moving = [velocities_from_pose(run, self._vehicle.degrees_of_freedom) for run in runs]
            data = prepare(moving, self._vehicle, np.ones(2 * self.equations))
            # A model keeps what it computed of all data that it has seen.
            parts = self._model.with_known_values({}).linearise(data, self._p)
        except UndertowError:
            if len(runs) == 1:
                return found
            return np.concatenate([self._of([run]) for run in runs])
        for part, segment in zip(parts, data.segments, strict=True):
            table = part.J.reshape(-1, len(data.rows), count)[:, : self.equations]
            if np.isfinite(table).all():
                found[segment.run] += np.einsum("kei,kej->eij", table, table)
        return found


@dataclass(frozen=True)
class Choice:
    """Segments in the order in which they were chosen."""

    places: list[int]
    gain: Array  # (chosen, equations) what each adds to the log determinant
    # (equations,) what those chosen know, as a share of what all do: the geometric mean over the directions
    # in which the parameters can differ; 1 where an equation has none.
    held: Array
    whole: float  # the same over all equations


def most_informative(information: Array, samples: Sequence[int], budget: int) -> Choice:
    """Choose segments so that the determinant of the information grows most, equation by equation.

    The sum over the equations of log det(A^T A) is submodular: taking what adds most for a sample, again and
    again, comes close to the best choice there is, and what a segment adds only falls as others are taken, so
    that most need not be looked at again. `information` is of every segment and equation, shape (S, E, n, n);
    `budget` is how many samples all those chosen may have.
    """
    parts = [_as_shares(information[:, e]) for e in range(information.shape[1])]
    state = [SETTINGS.before * np.eye(part.shape[1]) for part in parts]
    gains, order, left = [], [], budget

    def gain(k: int) -> Array:
        pairs = zip(state, parts, strict=True)
        return np.array([_log_det(now + part[k]) - _log_det(now) for now, part in pairs])

    heap = [(-np.inf, k) for k in range(len(samples))]
    while heap:
        _, best = heappop(heap)
        if samples[best] > left:
            continue
        adds = gain(best)
        now = -float(adds.sum()) / samples[best]
        if heap and now > heap[0][0]:  # another one may add more
            heappush(heap, (now, best))
            continue
        order.append(best)
        gains.append(adds)
        left -= samples[best]
        state = [s + part[best] for s, part in zip(state, parts, strict=True)]
    return _choice(order, np.array(gains).reshape(len(order), len(parts)), state)


def _choice(order: list[int], gain: Array, state: list[Array]) -> Choice:
    size = np.array([len(s) for s in state])
    known = np.array([_log_det(s) for s in state])
    # Of the directions that nothing has told of, only what was there before counts.
    held = np.exp(known / np.maximum(size, 1))
    whole = float(np.exp(known.sum() / max(size.sum(), 1)))
    return Choice(order, gain, np.minimum(held, 1.0), min(whole, 1.0))


def _as_shares(information: Array) -> Array:
    """Information (S, n, n) in directions (S, d, d) in which that of all segments is one."""
    total = information.sum(axis=0)
    size = np.sqrt(np.diag(total))
    used = np.flatnonzero(size > 0)
    scale = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh((total / np.outer(scale, scale))[np.ix_(used, used)])
    kept = values > SETTINGS.known * np.max(values, initial=0.0)
    basis = vectors[:, kept] / np.sqrt(values[kept]) / scale[used, None]
    return np.asarray(basis.T @ information[:, used[:, None], used] @ basis)


def _log_det(matrix: Array) -> float:
    return float(np.linalg.slogdet(matrix)[1]) if len(matrix) else 0.0


# --- the errors of models over all that was not chosen, a piece at a time ------------------------------
@dataclass(frozen=True)
class CheckSettings:
    """Numbers of the check of models over what was not chosen."""

    rows: int = 20_000  # of a piece; what is in memory at a time
    horizon: float = 5.0  # s that are predicted from each measured start, as by `undertow compare`


CHECK = CheckSettings()


@dataclass
class _Tally:
    """Squares of the errors of one model, by piece and velocity."""

    predictor: Predictor
    squares: list[Array] = field(default_factory=list)
    counts: list[Array] = field(default_factory=list)
    diverged: int = 0

    def add(self, prediction: Prediction) -> None:
        """Take a piece up."""
        residual = _velocities(prediction, prediction.residual)
        whole = np.isfinite(prediction.predicted).all(axis=2) | ~prediction.windows.inside
        good = whole.all(axis=1)
        self.diverged += int(np.sum(~good))
        self.squares.append(np.nansum(residual[good] ** 2, axis=(0, 1)))
        self.counts.append(np.isfinite(residual[good]).sum(axis=(0, 1)))


def checked(
    chosen: Chosen, models: Mapping[str, Vehicle], *, progress: Progress = lambda done, words: None
) -> LongLogs:
    """The result of a choice, with the errors of models, by name, over all that was not chosen.

    What belongs to each run (``per_run = true``) is estimated from the first third of every piece.
    """
    tallies = {name: _Tally(Predictor(Functions(vehicle))) for name, vehicle in models.items()}
    motion: list[tuple[Array, Array]] = []
    seconds, samples, windows = 0.0, 0, 0
    pieces = list(without(chosen.spools, chosen.used, CHECK.rows))
    for done, piece in enumerate(pieces):
        progress(done / len(pieces), "checking the rest")
        try:
            run = velocities_from_pose(
                chosen.spools[piece.log].run(piece.first, piece.stop), chosen.vehicle.degrees_of_freedom
            )
            predictions = _predicted(run, models, tallies)
        except UndertowError:  # a piece too short or too full of gaps to be simulated
            continue
        for name, prediction in predictions.items():
            tallies[name].add(prediction)
        first = next(iter(predictions.values()))
        measured = _velocities(first, first.windows.measured)
        motion.append((np.nansum(measured**2, axis=(0, 1)), np.isfinite(measured).sum(axis=(0, 1))))
        seconds, samples = seconds + float(run.t[-1] - run.t[0]), samples + len(run.t)
        windows += len(first.windows)
    if not motion:
        return chosen.result
    size = _rms(*(np.sum(column, axis=0) for column in zip(*motion, strict=True)))
    names = chosen.vehicle.velocity_names
    rest = Rest(
        seconds=seconds,
        samples=samples,
        horizon=CHECK.horizon,
        windows=windows,
        models=[_errors(name, tally, size, names) for name, tally in tallies.items()],
    )
    return chosen.result.model_copy(update={"rest": rest})


def _predicted(
    run: Run, models: Mapping[str, Vehicle], tallies: Mapping[str, _Tally]
) -> dict[str, Prediction]:
    """Windows of a piece predicted by every model."""
    own = {name: adapted(vehicle, run) for name, vehicle in models.items()}
    begin = max(float(rest.t[0]) for _, rest in own.values())
    windows = cut([run.slice(begin)], next(iter(models.values())), CHECK.horizon)
    return {
        name: predict_each([vehicle], windows, tallies[name].predictor) for name, (vehicle, _) in own.items()
    }


def _velocities(prediction: Prediction, values: Array) -> Array:
    """Values of the velocities, without the samples that the windows begin with."""
    return values[:, 1:, len(prediction.names) // 2 :]


def _errors(name: str, tally: _Tally, motion: Array, names: tuple[str, ...]) -> ModelOnTheRest:
    whole = _rms(np.sum(tally.squares, axis=0), np.sum(tally.counts, axis=0)) / motion
    pieces = [
        _mean(_rms(square, count) / motion)
        for square, count in zip(tally.squares, tally.counts, strict=True)
        if np.any(count)
    ]
    return ModelOnTheRest(
        model=name,
        error=json_ready(_mean(whole)),
        channels={n: json_ready(float(e)) for n, e in zip(names, whole, strict=True)},
        diverged=tally.diverged,
        lowest=json_ready(min(pieces, default=np.nan)),
        highest=json_ready(max(pieces, default=np.nan)),
    )


def _rms(squares: Array, counts: Array) -> Array:
    """Root mean squares; NaN of nothing."""
    return np.sqrt(np.divide(squares, counts, out=np.full(len(squares), np.nan), where=counts > 0))


def _mean(shares: Array) -> float:
    """Geometric mean of the errors of the velocities that there are."""
    return geometric_mean(shares[np.isfinite(shares)])
