"""A log in parts, decimated to the rate that a vehicle needs: motion and commands without delay or alias."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from weakref import finalize

import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.estimation.windows import time_constants_by_run
from undertow.identification.logs.chunks import LongLog
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run, with_reports
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags, Index


@dataclass(frozen=True)
class BandSettings:
    """Numbers by which a vehicle's time constants become a rate of samples."""

    # Samples in the fastest time constant. With 2.5 the values of the bundled BlueROV2 come out within
    # 0.5% of the truth, with 1.5 within 1.6%, where the noise leaves 0.01% (docs/long-logs.md).
    per_time_constant: float = 2.5
    # Rate where the model has no time constant, and the fastest that the lag of an actuator needs, Hz: a lag
    # that is shorter than a step is a delay to the motion.
    usual: float = 20.0
    quick_motions: float = 0.05  # share of the motions in a log that may be faster
    # Shortest step, s: a faster time constant is no vehicle in water, but a wrong unit.
    shortest: float = 0.02
    longest: float = 0.5  # longest step, s: delays and lags that a ship's file lacks must still be visible
    # Excerpts of a log, and their rows, by which the time constants are known before it is read.
    excerpts: int = 40
    rows: int = 200
    gap: float = 5.0  # longer steps, in units of the usual one, are gaps, over which nothing is averaged


BAND = BandSettings()


@dataclass(frozen=True)
class Band:
    """The time constants of a vehicle in logs, and the rate that they need."""

    fastest: float  # time constant, s; infinite where nothing decays
    slowest: float  # time constant, s; infinite where nothing decays
    step: float  # usual step of the log, s
    factor: int  # rows of the log that become one, an odd number


def band(vehicle: Vehicle, logs: Sequence[LongLog]) -> Band:
    """The band of a vehicle in logs, by excerpts from all along them."""
    count = max(BAND.excerpts // len(logs), 2)
    excerpts = (run for log in logs for run in log.excerpts(count, BAND.rows))
    runs = [_with_velocities(vehicle, run) for run in excerpts if np.all(np.diff(run.t) > 0)]
    if not runs:
        return Band(np.inf, np.inf, 0.0, 1)
    step = float(np.median([np.median(np.diff(run.t)) for run in runs]))
    motions = [constants for constants in time_constants_by_run(vehicle, runs) if len(constants)]
    fastest = float(np.quantile([c[0] for c in motions], BAND.quick_motions)) if motions else np.inf
    slowest = float(np.median([c[-1] for c in motions])) if motions else np.inf
    usual = BAND.per_time_constant / BAND.usual
    lag = max(_quickest_lag(vehicle), usual) if motions else usual
    wanted = np.clip(min(fastest, lag) / BAND.per_time_constant, BAND.shortest, BAND.longest)
    factor = int(wanted / step * (1 + 1e-9)) if step > 0 else 1
    # An odd number of rows has one in its middle, to which their mean belongs.
    return Band(fastest, slowest, step, max(factor - (factor % 2 == 0), 1))


def _with_velocities(vehicle: Vehicle, run: Run) -> Run:
    """A run with velocities, if they can be derived from its pose."""
    try:
        return velocities_from_pose(run, vehicle.degrees_of_freedom)
    except UndertowError:
        return run


def _quickest_lag(vehicle: Vehicle) -> float:
    """Shortest time constant of the states of effects, at rest, s; infinite where there are none."""
    functions = Functions(vehicle)
    count = functions.memory.shape[0] + functions.actuator_states.shape[0]
    if not count:
        return np.inf
    x, u = np.zeros(functions.x.shape[0]), np.zeros(functions.u.shape[0])
    slopes = np.array(functions.quickest(x, u, functions.values(), 0.0))[-count:, -count:]
    poles = np.linalg.eigvals(np.where(np.isfinite(slopes), slopes, 0.0)).real
    return float(np.min(-1.0 / poles[poles < 0.0], initial=np.inf))


def decimated(runs: Iterable[Run], by: int, step: float, commands: Sequence[str]) -> Iterator[Run]:
    """Parts of a log that follow each other, decimated.

    A measurement becomes the mean of `by` rows, at the mean of their times: with an odd number there is no
    delay, what is faster than the new rate is averaged out, and the noise stays white. Where some of these
    rows are empty, the mean of the others is extrapolated to that time with the slope of adjacent means. A
    command, which is held from row to row, is averaged likewise, and over the time until the next of the new
    rows: it then gives exactly the change of the mean velocity from one of them to the next. Steps much
    longer than the usual `step`, s, are gaps, over which nothing is averaged.
    """
    rest: Run | None = None
    for run in runs:
        whole = run if rest is None else joined(rest, run)
        if by == 1:
            yield whole.slice(run.t[0])
            rest = whole.slice(run.t[-1])
            continue
        blocks = _blocks(whole.t, by, step)
        if len(blocks) < 2:
            rest = whole
            continue
        # The last block is needed for the time for which the command before it is held.
        yield _averaged(whole, blocks, by, step, commands).head(len(blocks) - 1)
        rest = whole.slice(whole.t[blocks[-1]])
    if rest is not None and by > 1 and len(blocks := _blocks(rest.t, by, step)):
        yield _averaged(rest, blocks, by, step, commands)


def joined(one: Run, other: Run) -> Run:
    """Two parts that follow each other, with angles continuous between them."""
    channels = {n: np.concatenate([a, _continued(n, a, other)]) for n, a in one.channels.items()}
    reported = {
        n: np.concatenate([r.reported.get(n, np.ones(len(r.t), dtype=bool)) for r in (one, other)])
        for n in {*one.reported, *other.reported}
    }
    t = np.concatenate([one.t, other.t])
    both = replace(other, t=t, channels=channels, wrapped={}, reported=reported)
    return with_reports(both, {n: both.reports(n) for n in reported})


def _continued(name: str, before: Array, run: Run) -> Array:
    """A channel of the next part; an unwrapped angle is shifted by whole turns to be continuous."""
    data = run.channels[name]
    last, first = (a[np.isfinite(a)] for a in (before, data))
    if not (run.mapping or LogMapping()).jumps(name) or not len(last) or not len(first):
        return data
    return np.asarray(data + 2 * np.pi * np.round((last[-1] - first[0]) / (2 * np.pi)))


def _blocks(t: Array, by: int, step: float) -> Index:
    """First rows of all whole blocks of `by` rows; a gap begins a new one."""
    edges = np.flatnonzero(np.diff(t) > BAND.gap * step) + 1
    starts, stops = np.append(0, edges), np.append(edges, len(t))
    found = [np.arange(a, b - by + 1, by) for a, b in zip(starts, stops, strict=True)]
    return np.concatenate(found).astype(np.intp)


def _averaged(run: Run, blocks: Index, by: int, step: float, commands: Sequence[str]) -> Run:
    rows = blocks[:, None] + np.arange(by)
    t = run.t[rows].mean(axis=1)
    channels, sigma = {}, dict(run.sigma)
    for name in run.channels:
        data = run.reports(name)
        if name in commands:
            channels[name] = _held(run.t, data, rows, t, by * step)
            continue
        channels[name], count = _means(run.t[rows], data[rows], t)
        if name in sigma:
            sigma[name] /= float(np.sqrt(max(count, 1.0)))
    slow = {name: channels[name] for name in run.reported}
    reported = {name: np.isfinite(data) for name, data in slow.items()}
    fewer = replace(run, t=t, channels=channels, sigma=sigma, wrapped={}, reported=reported)
    return with_reports(fewer, slow)


def _means(times: Array, values: Array, t: Array) -> tuple[Array, float]:
    """Means of blocks (K, by) at the times t (K,), and how many values a mean is of, on average."""
    finite = np.isfinite(values)
    count = finite.sum(axis=1)
    some = np.flatnonzero(count)
    mean = np.full(len(t), np.nan)
    if not len(some):
        return mean, 0.0
    known, inside = values[some], finite[some]
    # Sums of equal numbers are not exact: a constant channel must stay constant.
    low = np.min(np.where(inside, known, np.inf), axis=1)
    high = np.max(np.where(inside, known, -np.inf), axis=1)
    mean[some] = np.clip(np.where(inside, known, 0.0).sum(axis=1) / count[some], low, high)
    if np.any(count[some] < values.shape[1]) and len(some) > 1:
        at = np.where(inside, times[some], 0.0).sum(axis=1) / count[some]
        mean[some] += np.gradient(mean[some], at) * (t[some] - at)
    return mean, float(np.mean(count[some]))


def _held(times: Array, values: Array, rows: Index, t: Array, usual: float) -> Array:
    """A signal that is held from row to row, decimated: blocks `rows` (K, by) at the times t (K,)."""
    # Its integral is decimated like a velocity, whose rate it is: the decimated command then gives exactly
    # the change of the mean velocity from one block to the next. At the end and before a gap it is a block's
    # mean.
    known = np.where(np.isfinite(values), values, 0.0)
    total = np.append(0.0, np.cumsum((known[:-1] - known[0]) * np.diff(times)))
    mean = known[rows].mean(axis=1)
    adjacent = np.diff(t) <= BAND.gap * usual
    change = np.diff(total[rows].mean(axis=1))
    mean[:-1] = np.where(adjacent, known[0] + change / np.diff(t), mean[:-1])
    # Differences of sums are not exact: a constant command must stay constant.
    low, high = (_with_next(f(known[rows], axis=1), adjacent, f) for f in (np.min, np.max))
    missing = _with_next(np.any(~np.isfinite(values[rows]), axis=1), adjacent, np.max)
    return np.where(missing, np.nan, np.clip(mean, low, high))


def _with_next(values: Array, adjacent: Flags, of: Callable[..., Array]) -> Array:
    """The least or greatest of each value and the next one, where that is adjacent."""
    after = np.where(np.append(adjacent, False), np.append(values[1:], values[-1:]), values)
    return np.asarray(of(np.column_stack([values, after]), axis=1))


# --- decimated rows in a file ----------------------------------------------------------------------------
class Spool:
    """A log after decimation: rows in a temporary file, of which any can be read as a run."""

    template: Run  # one row, with the name, source and notes of the log

    def __init__(self, parts: Iterable[Run], decimate: Callable[[Iterable[Run]], Iterator[Run]]) -> None:
        self._file = tempfile.TemporaryFile(prefix="undertow-")  # noqa: SIM115 - it lives as long as this
        finalize(self, self._file.close)
        self.rows = self.samples = self.dropped = self.gaps = 0
        self.longest_gap, self.span = 0.0, (np.inf, -np.inf)
        self._names: tuple[str, ...] = ()
        self._slow: set[str] = set()  # channels that do not report in every row
        self._missing: Counter[str] = Counter()
        for run in decimate(map(self._counted, parts)):
            self._add(run)

    def _counted(self, run: Run) -> Run:
        """Count what is in a part of the log before it is decimated."""
        last = self.span[1] if self.samples else run.t[0]
        step = np.diff(run.t, prepend=last)
        gaps = step[step > BAND.gap * np.median(step)]
        self.gaps += len(gaps)
        self.longest_gap = float(np.max(gaps, initial=self.longest_gap))
        self.samples, self.dropped = self.samples + len(run.t), self.dropped + run.dropped
        self.span = (min(self.span[0], float(run.t[0])), float(run.t[-1]))
        self._missing.update({n: int(np.isnan(a).sum()) for n, a in run.channels.items()})
        return run

    @property
    def missing(self) -> dict[str, float]:
        """Share of the rows without a value, by channel; those that have all are left out."""
        return {n: count / self.samples for n, count in self._missing.items() if count}

    def _add(self, run: Run) -> None:
        if not self._names:
            self._names, self.template = tuple(run.channels), replace(run.head(1), dropped=0)
        np.column_stack([run.t, *map(run.reports, self._names)]).tofile(self._file)
        self._slow |= {*run.reported}
        self.template = replace(self.template, sigma={**self.template.sigma, **run.sigma})
        self.rows += len(run.t)

    def run(self, first: int, stop: int) -> Run:
        """Some rows as a run that is a segment of the log."""
        table = self._table(first, stop)
        channels = dict(zip(self._names, table[:, 1:].T, strict=True))
        name = f"{self.template.name} [{table[0, 0]:.0f}-{table[-1, 0]:.0f} s]"
        slow = {n: channels[n] for n in self._slow}
        reported = {n: np.isfinite(data) for n, data in slow.items()}
        rows = replace(self.template, name=name, t=table[:, 0], channels=channels, reported=reported)
        return with_reports(replace(rows, part_of=self.template.origin), slow)

    def times(self, first: int, stop: int) -> tuple[float, float]:
        """When some rows begin and end, s."""
        return float(self._table(first, first + 1)[0, 0]), float(self._table(stop - 1, stop)[0, 0])

    def _table(self, first: int, stop: int) -> Array:
        width = 1 + len(self._names)
        self._file.flush()
        self._file.seek(8 * width * first)
        return np.fromfile(self._file, count=width * (stop - first)).reshape(-1, width)

    def ranges(self, rows: int) -> list[tuple[int, int]]:
        """Consecutive ranges of so many rows; the last takes the remainder."""
        edges = [*range(0, max(self.rows - rows + 1, 1), rows), self.rows]
        if len(edges) > 2 and edges[-1] - edges[-2] >= rows + rows // 2:
            edges.insert(-1, edges[-2] + rows)
        return list(pairwise(edges))


@dataclass(frozen=True)
class Segment:
    """Some rows of a spool."""

    log: int  # which one
    first: int
    stop: int

    @property
    def samples(self) -> int:
        """How many rows it has."""
        return self.stop - self.first


def segments(spools: Sequence[Spool], rows: int) -> list[Segment]:
    """All segments of so many rows, in order."""
    return [Segment(i, a, b) for i, spool in enumerate(spools) for a, b in spool.ranges(rows)]


def merged(chosen: Iterable[Segment]) -> list[Segment]:
    """Segments that follow each other as one, in order."""
    found: list[Segment] = []
    for one in sorted(chosen, key=lambda s: (s.log, s.first)):
        if found and (found[-1].log, found[-1].stop) == (one.log, one.first):
            found[-1] = replace(found[-1], stop=one.stop)
        else:
            found.append(one)
    return found


def without(spools: Sequence[Spool], taken: Iterable[Segment], rows: int) -> Iterator[Segment]:
    """The rest of the spools, in pieces of at most so many rows."""
    used = merged(taken)
    for i, spool in enumerate(spools):
        edges: Index = np.array([0, *(e for s in used if s.log == i for e in (s.first, s.stop)), spool.rows])
        for first, stop in edges.reshape(-1, 2).tolist():
            for begin in range(first, stop, rows):
                yield Segment(i, begin, min(begin + rows, stop))
