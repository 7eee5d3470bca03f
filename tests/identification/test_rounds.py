"""One step of the search: what is fitted again under the noise model of the leading candidate."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from undertow.identification.diagnosis.evidence import FoundEffect, as_good, too_fast_to_distinguish
from undertow.identification.diagnosis.rounds import far_behind
from undertow.identification.diagnosis.search import much_simpler, possible_rivals
from undertow.identification.diagnosis.settings import DEFAULT
from undertow.model.catalogue import catalogue
from undertow.model.effect import Wrench

_BENCH = SimpleNamespace(test=SimpleNamespace(block=np.arange(400) // 10), settings=DEFAULT)


def _score(size: float, seed: int = 1) -> SimpleNamespace:
    return SimpleNamespace(r=size * np.random.default_rng(seed).standard_normal(400), error=size)


def _effect(name: str, parameters: int = 1, error: float = 1.0) -> FoundEffect:
    own = [SimpleNamespace(name=f"{name}_{i}") for i in range(parameters)]
    fit = SimpleNamespace(model=SimpleNamespace(free=[p.name for p in own]))
    candidate = SimpleNamespace(parameters=own, effect=Wrench)
    trial = SimpleNamespace(score=_score(error), fit=fit, candidate=candidate, id=name)
    return FoundEffect(trial, None, 1.0, 0.0, True)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("left", "a_step_on", "behind"), [(1.5, 1.5, False), (3.0, 2.5, True), (3.0, 1.1, False)]
)
def test_what_a_step_brings_near_the_best_is_not_far_behind(
    left: float, a_step_on: float, behind: bool
) -> None:
    """Cubic drag that was left with one of four coefficients must not lose to square drag for that, nor
    square drag, that was fitted roughly, to a cable.
    """
    assert far_behind(left, 1.0, lambda: a_step_on) is behind


@pytest.mark.parametrize(("effects", "expected"), [(("tether", "friction"), ["trim"]), (("tether",), [])])
def test_what_may_stand_for_one_effect_of_a_pair_is_tried_beside_the_other(
    effects: tuple[str, ...], expected: list[str]
) -> None:
    """Alone it does worse than both of the pair: that says nothing of it beside the other one."""
    found = {n: _effect(n, error=1.0 + i) for i, n in enumerate(("tether", "friction", "trim"))}
    effect_set = SimpleNamespace(findings=[found[n] for n in effects], score=_score(1.0))
    rounds = [SimpleNamespace(findings=list(found.values()))]
    tried = possible_rivals(effect_set, 0, rounds, _BENCH)  # type: ignore[arg-type]
    assert [f.id for f in tried if f.id not in effects] == expected


@pytest.mark.parametrize(
    ("delay", "lag", "explained", "alike"),
    [(0.009, 0.01, 0.92, True), (0.009, 0.01, 0.5, False), (0.06, 0.08, 0.92, False)],
)
def test_within_a_fraction_of_a_sample_a_lag_is_a_dead_time(
    delay: float, lag: float, explained: float, *, alike: bool
) -> None:
    """At 20 Hz: unless the one explains less than an effect must, or both last longer than a sample."""
    known = catalogue()

    def found(effect: str, value: float, share: float) -> FoundEffect:
        own = known[effect](("port",))
        (name,) = (p.name for p in own.parameters)
        fit = SimpleNamespace(model=SimpleNamespace(free=[name]), values={name: value})
        candidate = SimpleNamespace(parameters=own.parameters, effect=known[effect])
        trial = SimpleNamespace(fit=fit, candidate=candidate, id=effect)
        return FoundEffect(trial, None, share, 0.0, True)  # type: ignore[arg-type]

    data = SimpleNamespace(segments=[SimpleNamespace(t=np.arange(100) / 20.0)])
    bench = SimpleNamespace(test=data, settings=DEFAULT)
    one, other = found("actuation_delay", delay, 0.95), found("thruster_lag", lag, explained)
    assert too_fast_to_distinguish(one, other, bench) is alike  # type: ignore[arg-type]
    assert too_fast_to_distinguish(other, one, bench) is alike  # type: ignore[arg-type]
    assert not too_fast_to_distinguish(one, found("thruster_gain", 0.01, 0.95), bench)  # type: ignore[arg-type]


@pytest.mark.parametrize(("parameters", "expected"), [(3, ["trim"]), (6, [])])
def test_a_plain_effect_is_looked_at_again_beside_one_with_many_parameters(
    parameters: int, expected: list[str]
) -> None:
    tether, trim = _effect("tether", 8, 1.06), _effect("trim", parameters, 1.1)
    assert [f.id for f in much_simpler(tether, 1.06, [tether, trim])] == expected


@pytest.mark.parametrize(("size", "expected"), [(1.0, True), (3.0, False)])
def test_models_are_as_good_unless_one_leaves_more_by_more_than_chance(size: float, expected: bool) -> None:
    assert as_good(_score(1.0, 7), _score(size, 8), _BENCH) is expected  # type: ignore[arg-type]
