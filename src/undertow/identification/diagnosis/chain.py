"""Several effects together: which of them are still needed, and which could be another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from undertow.model.vehicle import Vehicle

from ..weak.fit import WeakFit, free_parameters
from .evidence import as_good
from .finding import Finding
from .trial import Bench, Score


@dataclass(frozen=True)
class Chain:
    """Effects added to a model, fitted together.

    Attributes
    ----------
    findings : tuple of Finding
        The effects, in the order in which they were found.
    fit : WeakFit
        The model with all of them.
    score : Score
        How it does on the kept-aside data.
    """

    findings: tuple[Finding, ...]
    fit: WeakFit
    score: Score


def with_effects(vehicle: Vehicle, findings: Sequence[Finding]) -> Vehicle:
    """The model with effects in it, at the values at which they were found."""
    for finding in findings:
        vehicle = finding.trial.candidate.on(vehicle).adopted(finding.trial.fit.values)
    return vehicle


def fitted(vehicle: Vehicle, findings: Sequence[Finding], bench: Bench) -> Chain:
    """Fit a model with effects together and judge it."""
    grown = with_effects(vehicle, findings)
    free = free_parameters(grown)
    known = findings[-1].trial.fit.values if findings else bench.base.values
    own = set(free_parameters(vehicle))
    fit = bench.fit(grown, free, {n: v for n, v in known.items() if n in own})
    return Chain(tuple(findings), fit, bench.judge(fit))


def thinned(vehicle: Vehicle, chain: Chain, bench: Bench) -> Chain:
    """The chain without effects that those found later make superfluous."""
    for finding in chain.findings[:-1]:
        shorter = fitted(vehicle, [f for f in chain.findings if f is not finding], bench)
        if as_good(chain.score, shorter.score, bench.test):
            return thinned(vehicle, shorter, bench)
    return chain


def alternatives(
    vehicle: Vehicle, chain: Chain, place: int, rivals: Sequence[Finding], bench: Bench
) -> list[Chain]:
    """Chains with another effect in one place that do as well or better, the best first."""
    found = []
    for rival in rivals:
        others = list(chain.findings)
        if rival.id not in {f.id for f in others}:
            others[place] = rival
            tried = fitted(vehicle, others, bench)
            if as_good(chain.score, tried.score, bench.test):
                found.append(tried)
    return sorted(found, key=lambda c: c.score.error)
