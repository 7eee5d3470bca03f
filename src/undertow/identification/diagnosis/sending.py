"""Trials as plain data: what one process worked out, put together again in another."""

from __future__ import annotations

from dataclasses import dataclass

from undertow.typing import Array

from ..weak.fit import WeakFit
from ..weak.noise import Whitening
from ..weak.residual import Linearised
from .candidates import Candidate
from .trial import Bench, Score, Trial


@dataclass(frozen=True)
class _Fit:
    """A fit without its model; no whitening where it is the bench's."""

    free: tuple[str, ...]
    p: Array
    whitening: list[Whitening] | None
    at: Linearised
    disturbance: Array
    iterations: int


@dataclass(frozen=True)
class Sent:
    """A trial without its models; no fits where it was rejected, one where nothing was thinned out."""

    full: _Fit | None
    fit: _Fit | None
    kept: tuple[str, ...]
    score: Score


def sent(trial: Trial, bench: Bench) -> Sent:
    """The trial as plain data."""
    if trial.full is bench.base:
        return Sent(None, None, trial.kept, trial.score)
    thin = None if trial.fit is trial.full else _bare(trial.fit, bench)
    return Sent(_bare(trial.full, bench), thin, trial.kept, trial.score)


def _bare(fit: WeakFit, bench: Bench) -> _Fit:
    whitening = None if fit.whitening is bench.train_whitening else fit.whitening
    return _Fit(fit.model.free, fit.p, whitening, fit.at, fit.disturbance, fit.iterations)


def received(found: Sent, candidate: Candidate, bench: Bench) -> Trial:
    """The trial of a candidate from plain data."""
    full = bench.base if found.full is None else _whole(found.full, candidate, bench)
    fit = full if found.fit is None else _whole(found.fit, candidate, bench)
    return Trial(candidate, full, fit, found.kept, found.score)


def _whole(bare: _Fit, candidate: Candidate, bench: Bench) -> WeakFit:
    whitening = bench.train_whitening if bare.whitening is None else bare.whitening
    model = candidate.model(bare.free)
    return WeakFit(model, bare.p, bench.train, whitening, bare.at, bare.disturbance, bare.iterations)
