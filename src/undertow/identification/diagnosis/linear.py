"""A candidate linearised at a point, as far as chance and resampling need it."""

from __future__ import annotations

from ..weak.fit import WeakFit
from ..weak.residual import Linearised, whitened
from ..weak.step import prior_of
from .blocks import Blocks
from .chance import Linear
from .trial import Bench


def linear(at: WeakFit, bench: Bench, on_test: Linearised | None = None) -> Linear:
    """Linearise a model with a candidate where a fit of it stands, beside the model without it."""
    base = bench.base
    own = len(at.model.free) - len(base.model.free)
    train = at.at
    if at.whitening is not bench.train_whitening:
        train = whitened(at.model.linearise(bench.train, at.p), bench.train_whitening)
    test = bench.on_test(at) if on_test is None else on_test
    return Linear(
        Blocks.of(train.J, train.r - base.at.r, base.at.r, bench.train.block),
        Blocks.of(test.J, test.r - bench.base_score.r, bench.base_score.r, bench.test.block),
        own,
        prior_of(at.model)[1],
    )
