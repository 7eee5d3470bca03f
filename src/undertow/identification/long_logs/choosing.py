"""Long logs: read in parts, decimated, their most informative segments, and errors over the rest."""

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
from undertow.identification.logs.opening import refuse_duplicates, with_distinct_names
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import MEASURABLE, Run
from undertow.identification.logs.table import WHOLE, size_of, too_many_cells
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from .decimation import Band, Segment, Spool, band, decimated, joined, merged, segments, without


@dataclass(frozen=True)
class Budget:
    """Samples of long logs, after decimation, that a command uses."""

    work: int
    validation: int = 0  # none: the command does not validate
    raw: bool = False  # whether they count before decimation: a check of the sensors needs every row
    whole: int = MEASURABLE.samples  # logs of so many samples are used as they are


#: On two processors and in six degrees of freedom, 12,000 samples are fitted in 25 s.
FIT = Budget(12_000, 4_000)
#: A search fits some forty candidates, several times: 8,000 samples take it a minute, 51,000 of a real log
#: took 330 s of one processor.
SEARCH = Budget(6_000, 2_000, whole=100_000)
#: Pictures and tables of a model as it is, or a plan.
LOOK = Budget(20_000)
#: An examination of logs: clocks, sensors and units, at the rate at which they were logged.
EXAMINE = Budget(60_000, raw=True)


@dataclass(frozen=True)
class CuttingSettings:
    """Numbers by which long logs are read, cut and divided."""

    rows: int = 100_000  # in memory at a time, when a log is read
    # Samples times channels of logs that are read as a whole: 300,000 rows in six degrees of freedom.
    whole_cells: int = 6_300_000
    fewest_segments: int = 24  # segments that logs are cut into, however slow the vehicle
    most_segments: int = 5_000  # that are examined; of longer logs, some that are spread evenly
    segments_in_budget: int = 4  # segments that the budget has room for, at least
    samples: int = 50  # of a segment, at least: else the weak form has hardly a row
    # Of several logs, one in so many is kept for validation, the last first.
    kept_logs: int = 4
    # A single log is divided into so many parts; every third is for validation, but for segments at its ends.
    parts: int = 24
    kept_parts: int = 3
    # Share of the number of lines by which that of the samples can be off: lines differ in length.
    estimate: float = 0.7


CUTTING = CuttingSettings()


def too_long(logs: Sequence[LongLog], most: int) -> bool:
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
    """Rows and columns; none of what is no table, which is refused when it is read."""
    try:
        return log.size
    except UndertowError:
        return 0, 0


def read_in_parts(log: LongLog) -> Run:
    """A log of which a short part is used, as `read_log` reads it, from a file of any size."""
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
    refuse_duplicates(runs)
    return with_distinct_names(runs)


def at_full_rate(chosen: Chosen, logs: Sequence[LongLog]) -> list[Run]:
    """The segments that were chosen, with every row of the log; the logs are read once more."""
    found = []
    for i, log in enumerate(logs):
        spool = chosen.spools[i]
        spans = [spool.times(s.first, s.stop) for s in merged(chosen.used) if s.log == i]
        pieces: list[list[Run]] = [[] for _ in spans]
        for run in (part.run for part in log.parts(CUTTING.rows, 0)):
            for of_span, (start, end) in zip(pieces, spans, strict=True):
                if np.any((run.t >= start) & (run.t <= end)):
                    of_span.append(run.slice(start, end))
        runs = [reduce(joined, of_span) for of_span in pieces]
        whole, named = spool.template, []
        for run, (start, end) in zip(runs, spans, strict=True):
            name = f"{whole.name} [{start:.0f}-{end:.0f} s]"
            named.append(replace(run, name=name, part_of=whole.origin, sha256=whole.sha256, dropped=0))
        found += [replace(named[0], dropped=spool.dropped), *named[1:]] if named else []
    return [velocities_from_pose(run, chosen.vehicle.degrees_of_freedom) for run in found]


@dataclass(frozen=True)
class Chosen:
    """The segments of long logs that a command uses."""

    vehicle: Vehicle
    runs: list[Run]  # segments to work on, decimated
    validation: list[Run]  # segments for validation
    result: LongLogs
    spools: list[Spool]  # all of the logs, decimated
    used: list[Segment]  # those of `runs` and `validation`


def choose(
    vehicle: Vehicle,
    logs: Sequence[LongLog],
    validation: Sequence[LongLog] = (),
    budget: Budget = FIT,
    progress: Progress = lambda done, words: None,
) -> Chosen:
    """Choose the most informative segments of long logs for a vehicle's estimated (or else all) parameters.

    The logs are read once, in parts. They are decimated to the rate that the vehicle's fastest time constant
    needs and cut into segments long enough for its slowest one. The segments with the largest determinant
    of the information, equation by equation, are chosen until the budget is used up. Without `validation`,
    and where the budget has room for it, one log in four is kept for validation, the last first; of a single
    one every third part.
    """
    every = [*logs, *validation]
    progress(0.0, "finding the bandwidth of the vehicle")
    found = band(vehicle, every)
    spools = _spooled(vehicle, every, found, progress)
    regressor = Regressor(vehicle)
    samples = (budget.work // (found.factor if budget.raw else 1), budget.validation)
    cut = _cut(spools, found, samples[0])
    cut = cut[:: -(-len(cut) // min(CUTTING.most_segments, regressor.most_segments()))]
    kept = _validation_logs([log.path for log in logs], len(validation), budget)
    progress(0.6, "computing the information of each segment")
    pools = _divided(cut, kept, budget)
    choices = [_chosen(regressor, pool, spools, n) for pool, n in zip(pools, samples, strict=True)]
    progress(0.95, "extracting segments")
    taken = [[pool[k] for k in choice.places] for pool, choice in zip(pools, choices, strict=True)]
    cut_out = [[spools[s.log].run(s.first, s.stop) for s in merged(own)] for own in taken]
    runs, held = ([velocities_from_pose(run, vehicle.degrees_of_freedom) for run in own] for own in cut_out)
    result = _result(vehicle, spools, found, cut, kept, pools, choices)
    return Chosen(vehicle, runs, held, result, spools, [*taken[0], *taken[1]])


def _spooled(vehicle: Vehicle, logs: Sequence[LongLog], found: Band, progress: Progress) -> list[Spool]:
    spools = []
    for i, log in enumerate(logs):
        progress(0.6 * i / len(logs), f"reading {log.path.name}")
        decimate = partial(decimated, by=found.factor, step=found.step, commands=vehicle.command_names)
        spool = Spool((part.run for part in log.parts(CUTTING.rows, 0)), decimate)
        if not spool.rows:
            raise UndertowError(f"log {log.path} has no two samples in the time window: widen it")
        spool.template = replace(spool.template, sha256=log.sha256)
        spools.append(spool)
    refuse_duplicates([spool.template for spool in spools])
    for spool, template in zip(spools, with_distinct_names([s.template for s in spools]), strict=True):
        spool.template = template
    return spools


def _cut(spools: Sequence[Spool], found: Band, budget: int) -> list[Segment]:
    """Segments as long as four times the slowest time constant, or shorter, so that there is a choice."""
    step, total = found.step * found.factor, sum(spool.rows for spool in spools)
    wanted = HORIZONS.multiples[-1] * found.slowest / HORIZONS.longest / step if step else np.inf
    longest = max(total // CUTTING.fewest_segments, CUTTING.samples)
    rows = int(max(min(wanted, longest, budget // CUTTING.segments_in_budget), CUTTING.samples))
    return segments(spools, rows)


def _validation_logs(files: Sequence[Path], given: int, budget: Budget) -> set[int]:
    """Indices of the logs that are kept for validation as a whole; segments of one file stay together."""
    if not budget.validation:
        return set()
    if given:
        return set(range(len(files), len(files) + given))
    from_last = {path: k for k, path in enumerate(dict.fromkeys(reversed(files)))}
    if len(from_last) == 1:
        return set()
    return {i for i, path in enumerate(files) if from_last[path] % CUTTING.kept_logs == 0}


def _divided(cut: list[Segment], kept: set[int], budget: Budget) -> tuple[list[Segment], list[Segment]]:
    """Segments to work on, and those for validation."""
    if kept or not budget.validation:
        return [s for s in cut if s.log not in kept], [s for s in cut if s.log in kept]
    size = max(len(cut) // CUTTING.parts, CUTTING.kept_parts)
    validation = [(k // size) % CUTTING.kept_parts == 1 for k in range(len(cut))]
    # Not those next to one to work on, with which they correlate.
    inside = [all(validation[max(k - 1, 0) : k + 2]) for k in range(len(cut))]
    work = [s for s, excluded in zip(cut, validation, strict=True) if not excluded]
    return work, [s for s, included in zip(cut, inside, strict=True) if included]


def _chosen(regressor: Regressor, pool: list[Segment], spools: Sequence[Spool], budget: int) -> Choice:
    if not pool:
        none = np.ones(regressor.equations)
        return Choice([], np.zeros((0, len(none))), none, 1.0)
    information = regressor.information(spools[s.log].run(s.first, s.stop) for s in pool)
    return most_informative(information, [s.samples for s in pool], budget)


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
    chosen = [
        _segment(spools[pool[k].log], pool[k], gain, role, motions)
        for pool, choice, role in zip(pools, choices, roles, strict=True)
        for k, gain in zip(choice.places, choice.gain, strict=True)
    ]
    seconds = float(np.median([s.samples for s in cut])) * found.step * found.factor
    return LongLogs(
        logs=[_whole(spool, i in kept) for i, spool in enumerate(spools)],
        every=found.factor,
        rate=1.0 / (found.step * found.factor),
        fastest=json_ready(found.fastest),
        slowest=json_ready(found.slowest),
        stretches=len(cut),
        seconds=seconds,
        chosen=chosen,
        information_share=work.total_share,
        information_share_by_motion=dict(zip(motions, work.share.tolist(), strict=True)),
    )


def _whole(spool: Spool, holdout: bool) -> WholeLog:
    template, (first, last) = spool.template, spool.span
    return WholeLog(
        name=template.name,
        source=template.source,
        sha256=template.sha256,
        samples=spool.samples,
        seconds=last - first,
        dropped=spool.dropped,
        gaps=spool.gaps,
        longest_gap=spool.longest_gap,
        missing=spool.missing,
        holdout=holdout,
    )


def _segment(spool: Spool, s: Segment, gain: Array, role: Role, motions: Sequence[str]) -> ChosenSegment:
    start, end = spool.times(s.first, s.stop)
    return ChosenSegment(
        log=spool.template.name,
        start=start,
        end=end,
        samples=s.samples,
        role=role,
        information_gain=float(gain.sum()),
        motion=motions[int(np.argmax(gain))],
    )


# --- the information of segments ----------------------------------------------------------------------
@dataclass(frozen=True)
class InformationSettings:
    """Numbers for the information of segments."""

    batch: int = 20  # segments whose regressor is computed in one call
    bytes: int = 200_000_000  # that the information of all segments may take
    # Directions with less than this share of the information in the best one, over all segments (columns
    # scaled to equal size), are not determined by the logs, and do not count.
    tolerance: float = 1e-9
    prior: float = 1e-6  # information before any segment is chosen, as a share of that of all


SETTINGS = InformationSettings()


class Regressor:
    """The weak form's regressor of a vehicle: derivatives of its residual in the parameters."""

    def __init__(self, vehicle: Vehicle) -> None:
        names = free_parameters(vehicle) or vehicle.parameter_names
        self._vehicle, self._model = vehicle, WeakModel(Functions(vehicle), names)
        self.names, self._p = self._model.free, self._model.initial_p({})
        self.equations = len(vehicle.dof_indices)

    def most_segments(self) -> int:
        """Number of segments whose information fits into memory."""
        return int(SETTINGS.bytes // (8 * self.equations * max(len(self.names), 1) ** 2))

    def information(self, runs: Iterator[Run]) -> Array:
        """A^T A of every run by equation of motion, shape (runs, equations, parameters, parameters).

        It is zero for a segment in which it cannot be computed.
        """
        found = []
        while group := list(islice(runs, SETTINGS.batch)):
            found.append(self._of_group(group))
        return np.concatenate(found)

    def _of_group(self, runs: Sequence[Run]) -> Array:
        count = len(self.names)
        found = np.zeros((len(runs), self.equations, count, count))
        try:
            with_velocities = [velocities_from_pose(r, self._vehicle.degrees_of_freedom) for r in runs]
            data = prepare(with_velocities, self._vehicle, np.ones(2 * self.equations))
            # A copy: a model caches the results of all its data.
            parts = self._model.with_known_values({}).linearise(data, self._p)
        except UndertowError:
            if len(runs) == 1:
                return found
            return np.concatenate([self._of_group([run]) for run in runs])
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
    # (equations,) information of those chosen, as a share of that of all: the geometric mean over the
    # directions in parameter space; 1 where an equation has none.
    share: Array
    total_share: float  # the same over all equations


def most_informative(information: Array, samples: Sequence[int], budget: int) -> Choice:
    """Choose segments so that the determinant of the information grows most, equation by equation.

    The sum over the equations of log det(A^T A) is submodular: the greedy choice of the largest gain per
    sample is close to the best one, and the gain of a segment only falls as others are chosen, so that most
    are evaluated once. `information` is of every segment and equation, shape (S, E, n, n); `budget` is the
    largest number of samples of all those chosen.
    """
    parts = [_normalised(information[:, e]) for e in range(information.shape[1])]
    state = [SETTINGS.prior * np.eye(part.shape[1]) for part in parts]
    gains, order, remaining = [], [], budget

    def gain(k: int) -> Array:
        pairs = zip(state, parts, strict=True)
        return np.array([_log_det(now + part[k]) - _log_det(now) for now, part in pairs])

    heap = [(-np.inf, k) for k in range(len(samples))]
    while heap:
        _, best = heappop(heap)
        if samples[best] > remaining:
            continue
        gained = gain(best)
        priority = -float(gained.sum()) / samples[best]
        if heap and priority > heap[0][0]:  # another one may add more
            heappush(heap, (priority, best))
            continue
        order.append(best)
        gains.append(gained)
        remaining -= samples[best]
        state = [s + part[best] for s, part in zip(state, parts, strict=True)]
    return _choice(order, np.array(gains).reshape(len(order), len(parts)), state)


def _choice(order: list[int], gain: Array, state: list[Array]) -> Choice:
    size = np.array([len(s) for s in state])
    log_det = np.array([_log_det(s) for s in state])  # of the prior alone, where no segment has information
    share = np.exp(log_det / np.maximum(size, 1))
    total = float(np.exp(log_det.sum() / max(size.sum(), 1)))
    return Choice(order, gain, np.minimum(share, 1.0), min(total, 1.0))


def _normalised(information: Array) -> Array:
    """Information (S, n, n) in directions (S, d, d) in which that of all segments is the identity."""
    total = information.sum(axis=0)
    size = np.sqrt(np.diag(total))
    used = np.flatnonzero(size > 0)
    scale = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh((total / np.outer(scale, scale))[np.ix_(used, used)])
    kept = values > SETTINGS.tolerance * np.max(values, initial=0.0)
    basis = vectors[:, kept] / np.sqrt(values[kept]) / scale[used, None]
    return np.asarray(basis.T @ information[:, used[:, None], used] @ basis)


def _log_det(matrix: Array) -> float:
    return float(np.linalg.slogdet(matrix)[1]) if len(matrix) else 0.0


# --- the errors of models over the rest of the logs, a piece at a time ---------------------------------
@dataclass(frozen=True)
class CheckSettings:
    """Numbers of the check of models over the rest of the logs."""

    rows: int = 20_000  # of a piece, in memory at a time
    horizon: float = 5.0  # s that are predicted from each measured start, as by `undertow compare`


CHECK = CheckSettings()


@dataclass
class _ErrorSums:
    """Sums of the squared errors of one model, by piece and velocity."""

    predictor: Predictor
    squares: list[Array] = field(default_factory=list)
    counts: list[Array] = field(default_factory=list)
    diverged: int = 0

    def add(self, prediction: Prediction) -> None:
        residual = _velocities(prediction, prediction.residual)
        finite = np.isfinite(prediction.predicted).all(axis=2) | ~prediction.windows.inside
        stable = finite.all(axis=1)
        self.diverged += int(np.sum(~stable))
        self.squares.append(np.nansum(residual[stable] ** 2, axis=(0, 1)))
        self.counts.append(np.isfinite(residual[stable]).sum(axis=(0, 1)))


def with_errors_on_rest(
    chosen: Chosen, models: Mapping[str, Vehicle], *, progress: Progress = lambda done, words: None
) -> LongLogs:
    """The result of a choice, with the errors of models, by name, over the rest of the logs.

    Values by run (``per_run = true``) are estimated from the first third of every piece.
    """
    sums = {name: _ErrorSums(Predictor(Functions(vehicle))) for name, vehicle in models.items()}
    motions: list[tuple[Array, Array]] = []
    seconds, samples, windows = 0.0, 0, 0
    pieces = list(without(chosen.spools, chosen.used, CHECK.rows))
    for done, piece in enumerate(pieces):
        progress(done / len(pieces), "checking the rest")
        try:
            run = velocities_from_pose(
                chosen.spools[piece.log].run(piece.first, piece.stop), chosen.vehicle.degrees_of_freedom
            )
            predictions = _predicted(run, models, sums)
        except UndertowError:  # a piece too short or too full of gaps to be simulated
            continue
        for name, prediction in predictions.items():
            sums[name].add(prediction)
        first = next(iter(predictions.values()))
        measured = _velocities(first, first.windows.measured)
        motions.append((np.nansum(measured**2, axis=(0, 1)), np.isfinite(measured).sum(axis=(0, 1))))
        seconds, samples = seconds + float(run.t[-1] - run.t[0]), samples + len(run.t)
        windows += len(first.windows)
    if not motions:
        return chosen.result
    size = _rms(*(np.sum(column, axis=0) for column in zip(*motions, strict=True)))
    names = chosen.vehicle.velocity_names
    rest = Rest(
        seconds=seconds,
        samples=samples,
        horizon=CHECK.horizon,
        windows=windows,
        models=[_errors(name, own, size, names) for name, own in sums.items()],
    )
    return chosen.result.model_copy(update={"rest": rest})


def _predicted(
    run: Run, models: Mapping[str, Vehicle], sums: Mapping[str, _ErrorSums]
) -> dict[str, Prediction]:
    """Windows of a piece predicted by every model."""
    fitted = {name: adapted(vehicle, run) for name, vehicle in models.items()}
    begin = max(float(rest.t[0]) for _, rest in fitted.values())
    windows = cut([run.slice(begin)], next(iter(models.values())), CHECK.horizon)
    return {
        name: predict_each([vehicle], windows, sums[name].predictor) for name, (vehicle, _) in fitted.items()
    }


def _velocities(prediction: Prediction, values: Array) -> Array:
    """Values of the velocities, without the first samples of the windows."""
    return values[:, 1:, len(prediction.names) // 2 :]


def _errors(name: str, sums: _ErrorSums, motion: Array, names: tuple[str, ...]) -> ModelOnTheRest:
    whole = _rms(np.sum(sums.squares, axis=0), np.sum(sums.counts, axis=0)) / motion
    pieces = [
        _mean(_rms(square, count) / motion)
        for square, count in zip(sums.squares, sums.counts, strict=True)
        if np.any(count)
    ]
    return ModelOnTheRest(
        model=name,
        error=json_ready(_mean(whole)),
        channels={n: json_ready(float(e)) for n, e in zip(names, whole, strict=True)},
        diverged=sums.diverged,
        lowest=json_ready(min(pieces, default=np.nan)),
        highest=json_ready(max(pieces, default=np.nan)),
    )


def _rms(squares: Array, counts: Array) -> Array:
    """Root mean squares; NaN without samples."""
    return np.sqrt(np.divide(squares, counts, out=np.full(len(squares), np.nan), where=counts > 0))


def _mean(shares: Array) -> float:
    """Geometric mean of the errors of the velocities that there are."""
    return geometric_mean(shares[np.isfinite(shares)])
