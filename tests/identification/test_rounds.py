"""One step of the search: what is tried again under the noise model of the leading candidate."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from undertow.identification.diagnosis import rounds, search


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
