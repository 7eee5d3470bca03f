"""Thinned rows of a log, kept in a temporary file, and the stretches that they are cut into."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from weakref import finalize

import numpy as np

from undertow.identification.logs.run import Run
from undertow.identification.logs.series import with_reports
from undertow.typing import Array, Index

from .thinning import BAND


class Spool:
    """A log after it was thinned: rows in a temporary file, of which any can be had back as a run."""

    like: Run  # one row, with the name, source and notes of the log

    def __init__(self, parts: Iterable[Run], thin: Callable[[Iterable[Run]], Iterator[Run]]) -> None:
        self._file = tempfile.TemporaryFile(prefix="undertow-")  # noqa: SIM115 - it lives as long as this
        finalize(self, self._file.close)
        self.rows = self.samples = self.dropped = self.gaps = 0
        self.longest_gap, self.span = 0.0, (np.inf, -np.inf)
        self._names: tuple[str, ...] = ()
        self._slow: set[str] = set()  # channels that do not report in every row
        self._missing: Counter[str] = Counter()
        for run in thin(map(self._counted, parts)):
            self._add(run)

    def _counted(self, run: Run) -> Run:
        """Count what is in a part of the log before it is thinned."""
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
            self._names, self.like = tuple(run.channels), replace(run.head(1), dropped=0)
        np.column_stack([run.t, *map(run.reports, self._names)]).tofile(self._file)
        self._slow |= {*run.reported}
        self.like = replace(self.like, sigma={**self.like.sigma, **run.sigma})
        self.rows += len(run.t)

    def run(self, first: int, stop: int) -> Run:
        """Some rows as a run that is a stretch of the log."""
        table = self._table(first, stop)
        channels = dict(zip(self._names, table[:, 1:].T, strict=True))
        name = f"{self.like.name} [{table[0, 0]:.0f}-{table[-1, 0]:.0f} s]"
        slow = {n: channels[n] for n in self._slow}
        reported = {n: np.isfinite(data) for n, data in slow.items()}
        rows = replace(self.like, name=name, t=table[:, 0], channels=channels, reported=reported)
        return with_reports(replace(rows, part_of=self.like.origin), slow)

    def times(self, first: int, stop: int) -> tuple[float, float]:
        """When some rows begin and end, s."""
        return float(self._table(first, first + 1)[0, 0]), float(self._table(stop - 1, stop)[0, 0])

    def _table(self, first: int, stop: int) -> Array:
        width = 1 + len(self._names)
        self._file.flush()
        self._file.seek(8 * width * first)
        return np.fromfile(self._file, count=width * (stop - first)).reshape(-1, width)

    def ranges(self, rows: int) -> list[tuple[int, int]]:
        """Ranges of so many rows one after the other; the last takes what is left over."""
        edges = [*range(0, max(self.rows - rows + 1, 1), rows), self.rows]
        if len(edges) > 2 and edges[-1] - edges[-2] >= rows + rows // 2:
            edges.insert(-1, edges[-2] + rows)
        return list(pairwise(edges))


@dataclass(frozen=True)
class Stretch:
    """Some rows of a spool."""

    log: int  # which one
    first: int
    stop: int

    @property
    def samples(self) -> int:
        """How many rows it has."""
        return self.stop - self.first


def stretches(spools: Sequence[Spool], rows: int) -> list[Stretch]:
    """All stretches of so many rows, in order."""
    return [Stretch(i, a, b) for i, spool in enumerate(spools) for a, b in spool.ranges(rows)]


def merged(chosen: Iterable[Stretch]) -> list[Stretch]:
    """Stretches that follow each other as one, in order."""
    found: list[Stretch] = []
    for one in sorted(chosen, key=lambda s: (s.log, s.first)):
        if found and (found[-1].log, found[-1].stop) == (one.log, one.first):
            found[-1] = replace(found[-1], stop=one.stop)
        else:
            found.append(one)
    return found


def without(spools: Sequence[Spool], taken: Iterable[Stretch], rows: int) -> Iterator[Stretch]:
    """What is left of the spools, in pieces of at most so many rows."""
    used = merged(taken)
    for i, spool in enumerate(spools):
        edges: Index = np.array([0, *(e for s in used if s.log == i for e in (s.first, s.stop)), spool.rows])
        for first, stop in edges.reshape(-1, 2).tolist():
            for begin in range(first, stop, rows):
                yield Stretch(i, begin, min(begin + rows, stop))
