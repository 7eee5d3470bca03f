"""Two effects of which neither shows alone: named where they leave only noise and nothing else does."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from undertow.identification.diagnosis import search

_BLOCKS, _PER_BLOCK = 40, 10
_ROWS = _BLOCKS * _PER_BLOCK


def _score(size: float, seed: int) -> SimpleNamespace:
    r = size * np.random.default_rng(seed).standard_normal(_ROWS)
    return SimpleNamespace(r=r, error=float(np.sqrt(np.mean(r**2))))


def _round(sizes: list[float], base: float, monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """A round in which pair i leaves `sizes[i]` times the noise, and the model alone `base` times."""
    chains = {i: SimpleNamespace(fit=size, score=_score(size, i), pair=i) for i, size in enumerate(sizes)}
    monkeypatch.setattr(search, "promising_pairs", lambda *_: [(i, i) for i in chains])
    monkeypatch.setattr(search, "fitted", lambda vehicle, pair, bench: chains[pair[0]])
    model = SimpleNamespace(functions=SimpleNamespace(vehicle=None))
    bench = SimpleNamespace(
        base=SimpleNamespace(model=model, size=base),
        base_score=_score(base, 99),
        test=SimpleNamespace(block=np.arange(_ROWS) // _PER_BLOCK),
        false_alarms=0.01,
    )
    return SimpleNamespace(bench=bench, findings=[None] * 20, winner=None)


def _quiet(fit: object, data: object) -> bool:
    size = fit if isinstance(fit, float) else fit.size  # type: ignore[attr-defined]
    return bool(size < 1.1)


@pytest.mark.parametrize(
    ("sizes", "base", "named"),
    [
        ([1.0, 2.5, 2.8], 3.0, 0),
        ([2.5, 1.0], 3.0, 1),
        ([1.0, 1.0], 3.0, None),  # two pairs do equally well: neither is in evidence
        ([1.5, 2.5], 3.0, None),  # the best of them leaves more than noise
        ([1.0, 2.5], 1.05, None),  # nothing is missing
        ([1.0, 1.4], 1.11, None),  # so small a fall the best of 190 pairs makes by chance
    ],
)
def test_a_pair_is_named_where_it_alone_leaves_only_noise(
    sizes: list[float], base: float, named: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = search.lone_pair(_round(sizes, base, monkeypatch), _quiet)
    assert (None if found is None else found.pair) == named
