"""One step of the search: what is tried again under the noise model of the leading candidate."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from undertow.identification.diagnosis import rounds, search
from undertow.identification.diagnosis.evidence import FoundEffect


@dataclass(frozen=True)
class _Trial:
    """A trial by the mean square that its thinned and its full fit leave."""

    fit: float
    full: SimpleNamespace
    candidate: str = ""
    score: object = None


def _trial(thinned: float, full: float) -> _Trial:
    return _Trial(thinned, SimpleNamespace(left=full, values={}))


@pytest.mark.parametrize(
    ("thinned", "full", "a_step_on", "again"),
    [(20.0, 1.5, 1.5, True), (20.0, 3.0, 2.5, False), (20.0, 3.0, 1.1, True)],
)
def test_what_the_coarse_noise_model_hid_does_not_put_an_effect_out_of_reach(
    thinned: float, full: float, a_step_on: float, again: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cubic drag that was left with one of four coefficients must not lose to square drag for that, nor
    square drag, that was fitted roughly, to a cable.
    """

    def judged(fit: float | SimpleNamespace) -> SimpleNamespace:
        left = fit.left if isinstance(fit, SimpleNamespace) else fit
        return SimpleNamespace(r=np.sqrt(np.full(10, left)))

    monkeypatch.setattr(rounds, "try_candidate", lambda *_: "fitted again")
    monkeypatch.setattr(rounds, "Scouted", lambda *_: SimpleNamespace(cost=10.0 * a_step_on))
    rows = SimpleNamespace(at=SimpleNamespace(r=np.zeros(10)))
    sharp, best = SimpleNamespace(judge=judged, base=rows), _trial(1.0, 1.0)
    found = rounds._again(_trial(thinned, full), sharp, best)
    assert (found == "fitted again") is again
    if not again:
        assert np.mean(found.score.r**2) == pytest.approx(thinned)


@pytest.mark.parametrize(("effects", "asked"), [(("tether", "friction"), ["trim"]), (("tether",), [])])
def test_what_may_stand_for_one_effect_of_a_pair_is_tried_beside_the_other(
    effects: tuple[str, ...], asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Alone it does worse than both of the pair: that says nothing of it beside the other one."""
    findings = {
        n: SimpleNamespace(id=n, significant=True, trial=SimpleNamespace(score=n))
        for n in ("trim", "tether", "friction")
    }
    tried: list[str] = []
    monkeypatch.setattr(search, "as_good", lambda *_: False)
    monkeypatch.setattr(
        search, "alternatives", lambda _v, _c, _p, others, _b: tried.extend(o.id for o in others)
    )
    chain = SimpleNamespace(findings=[findings[n] for n in effects], score="best")
    found = SimpleNamespace(findings=list(findings.values()))
    search._rivals(None, chain, 0, [found], SimpleNamespace(test=None))
    assert [n for n in tried if n not in effects] == asked


@pytest.mark.parametrize(
    ("plain_size", "settled_error", "expected"),
    [(3, 1.0, ["trim"]), (3, 3.0, []), (6, 1.0, [])],
)
def test_a_plain_effect_is_looked_at_again_beside_one_with_many_parameters(
    plain_size: int, settled_error: float, expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Behind under a noise model with room for a disturbance, level under its own: the simulation decides."""

    def score(size: float, seed: int) -> SimpleNamespace:
        return SimpleNamespace(r=size * np.random.default_rng(seed).standard_normal(400), error=size)

    def chain(name: str, parameters: int, error: float, after: float) -> SimpleNamespace:
        own = [SimpleNamespace(name=f"{name}_{i}") for i in range(parameters)]
        fit = SimpleNamespace(model=SimpleNamespace(free=[p.name for p in own]), after=after)
        trial = SimpleNamespace(
            score=score(error, 1), fit=fit, candidate=SimpleNamespace(parameters=own), id=name
        )
        finding = FoundEffect(trial, None, 1.0, 0.0, True)
        return SimpleNamespace(findings=(finding,), fit=fit, score=trial.score)

    tether, trim = chain("tether", 8, 1.06, 1.0), chain("trim", plain_size, 1.1, settled_error)
    known = {"tether": tether, "trim": trim}
    monkeypatch.setattr(search, "fitted", lambda vehicle, found, bench: known[found[0].id])
    monkeypatch.setattr(search, "settled", lambda fit: fit)
    data = SimpleNamespace(block=np.arange(400) // 10)
    bench = SimpleNamespace(test=data, judge=lambda fit: score(fit.after, 7))
    current = SimpleNamespace(findings=[tether.findings[0], trim.findings[0]])
    found = search._plain_ones(None, tether, [current], bench)
    assert [c.findings[0].id for c in found] == expected
