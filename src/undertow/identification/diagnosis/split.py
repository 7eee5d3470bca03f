"""Keeping data aside where no run is given for it: stretches of every run, with gaps between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

from undertow.errors import UndertowError

from ..logs import Run

_PIECES = 6
_ASIDE = (1, 4)
_GAP_SECONDS = 1.0
# Samples of a run with fewer than which some of its pieces may hold none.
_FEWEST = 10


def keep_blocks_aside(runs: Sequence[Run]) -> tuple[list[Run], list[Run]]:
    """Cut every run into six pieces and keep the second and the fifth aside.

    Returns
    -------
    (list of Run, list of Run)
        What models are fitted to, and what they are judged by.

    Raises
    ------
    UndertowError
        If a run is too short to be cut.
    """
    for run in runs:
        if len(run.t) < _FEWEST:
            raise UndertowError(
                f"run {run.name!r} has {len(run.t)} samples, too few to keep stretches of it aside "
                f"({_FEWEST} at the very least): give longer logs, or another run to judge by with --holdout"
            )
    pieces = [(i, piece) for run in runs for i, piece in enumerate(_pieces(run))]
    train = [piece for i, piece in pieces if i not in _ASIDE]
    return train, [piece for i, piece in pieces if i in _ASIDE]


def _pieces(run: Run) -> list[Run]:
    start, length = float(run.t[0]), float(run.t[-1] - run.t[0]) / _PIECES
    edges = [start + i * length for i in range(_PIECES + 1)]
    gap = min(_GAP_SECONDS, 0.1 * length)
    return [
        replace(run.slice(a, b if i == _PIECES - 1 else b - gap), name=f"{run.name} [{a:.0f}-{b:.0f} s]")
        for i, (a, b) in enumerate(pairwise(edges))
    ]
