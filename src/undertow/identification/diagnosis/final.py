"""The last fit of a model with the effects that were found: its own noise model, small parameters as well."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from ..fitted import SURE
from ..weak.fit import WeakFit, fit_weak, settled
from ..weak.residual import WeakModel
from .candidates import Candidate
from .trial import parameters_that_matter


def last_fit(fit: WeakFit, candidates: Sequence[Candidate]) -> WeakFit:
    """Fit a model once more under the noise that it leaves itself, with what the search was too strict about.

    While effects compete, a parameter has to be far from zero to stay, for there are many that could be there
    by chance. Of an effect that is named, a parameter stays that is more likely there than not: two standard
    errors from zero.

    Parameters
    ----------
    fit : WeakFit
        The model with the effects.
    candidates : sequence of Candidate
        The effects that it got.
    """
    fit = settled(fit)
    names = fit.model.functions.parameter_names
    removable = {n for c in candidates for n in c.removable if n in names}
    left_out = removable - set(fit.model.free)
    if not left_out:
        return fit
    whole = _refitted(fit, (*fit.model.free, *sorted(left_out)))
    kept = parameters_that_matter(whole, tuple(sorted(removable)), SURE)
    free = (*fit.model.free, *(n for n in kept if n in left_out))
    return fit if free == fit.model.free else settled(_refitted(whole, free))


def _refitted(fit: WeakFit, free: Collection[str]) -> WeakFit:
    start = {n: v for n, v in fit.values.items() if n in free}
    return fit_weak(
        WeakModel(fit.model.functions, tuple(free)),
        fit.data,
        start=start,
        whitening=fit.whitening,
        disturbance=fit.disturbance,
    )
