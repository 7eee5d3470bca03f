"""The paper's chain on logs of any length: rows are reduced to triangular factors as they come."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import chain

import numpy as np

from undertow.model.vehicle import Vehicle
from undertow.typing import Progress

from ..doctor import refuse_impossible
from ..logs import Run
from ..logs.chunks import LongLog, NeedsWhole, Part, hash_of, outline
from ..triangle import Triangle
from .cases import Case, Edges
from .chain import Estimation, Experiment, estimated_by, experiments

ROWS = 50_000
"""Rows that are in memory at a time."""


def estimate_streaming(
    vehicle: Vehicle,
    logs: Sequence[LongLog],
    cases: Sequence[Case],
    edges: Edges = "interp",
    rows: int = ROWS,
    progress: Progress = lambda done, words: None,
    *,
    trust_log: bool = False,
) -> list[tuple[Experiment, list[Estimation]]]:
    """Estimates of every motion that logs hold, after each case of smoothing, in constant memory.

    Every log is read twice: to see what moves in it, then for the rows of the regression. Parts overlap by
    more than the filters reach, and what a filter makes of the samples at the border of a part is dropped, so
    that the answer is that of the log in one piece. (What a gap is, is told by the median step of a part.)

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    logs : sequence of LongLog
        Logs of forced motion, one motion each.
    cases : sequence of Case
        Ways of smoothing.
    edges : str
        What the filters do at the ends of a log.
    rows : int
        Rows that are read at a time.
    progress : callable
        Told what share is done, and what is being done.
    trust_log : bool
        Take logs as they are, also those that `undertow.identification.doctor.refuse_impossible` refuses.

    Raises
    ------
    NeedsWhole
        If the model depends on the time itself, or a log cannot be read in parts.
    UndertowError
        As for `experiments` and `estimate`.
    """
    overlap = _overlap(cases, edges)
    seen = [_outlined(log, max(rows, 2 * overlap), progress) for log in logs]
    found = experiments(vehicle, seen, trust_log=True)  # outlines only: each part is looked at
    reduced = [{c.name: Triangle(len(e.regression.free)) for c in cases} for e in found]
    for k, (log, outlined) in enumerate(zip(logs, seen, strict=True)):
        progress(0.3 + 0.7 * k / len(logs), f"reducing {log.path.name}")
        place = next(i for i, e in enumerate(found) if any(run is outlined for run in e.runs))
        _refuse_clock(found[place])
        parts = log.parts(max(rows, 3 * overlap), overlap)
        _reduce(found[place], parts, cases, edges, reduced[place], trust_log)
    pairs = zip(found, reduced, strict=True)
    return [(e, [estimated_by(e, c, triangles[c.name]) for c in cases]) for e, triangles in pairs]


def _refuse_clock(experiment: Experiment) -> None:
    if experiment.regression.feels_time:
        raise NeedsWhole(
            f"the {experiment.axis.motion} of '{experiment.axis.vehicle.name}' depends on the time itself, "
            "which parts of a log do not share: leave out --stream"
        )


def _outlined(log: LongLog, rows: int, progress: Progress) -> Run:
    progress(0.0, f"looking through {log.path.name}")
    parts = (part.run for part in log.parts(rows, 0))
    first = next(parts, None)
    whole = parts if first is None else chain([first], parts)
    return outline(whole, log.path.name.split(".")[0], hash_of(log.path))


def _overlap(cases: Sequence[Case], edges: Edges) -> int:
    """Samples on either side of a border that filters reach over, with room for a few that a log lacks."""
    return 4 * max(case.needs(edges) + sum(f.frame for f in case.acceleration) for case in cases)


def _reduce(
    experiment: Experiment,
    parts: Iterator[Part],
    cases: Sequence[Case],
    edges: Edges,
    triangles: Mapping[str, Triangle],
    trust_log: bool,
) -> None:
    """Take the rows of a log into the triangles, one for each case."""
    after, part = -np.inf, next(parts, None)
    while part is not None:
        refuse_impossible(experiment.axis.vehicle, [part.run], trust_log=trust_log)
        following = next(parts, None)
        until = np.inf if following is None else part.border
        for case in cases:
            experiment.regression.take_between(triangles[case.name], part.run, case, edges, after, until)
        after, part = until, following
