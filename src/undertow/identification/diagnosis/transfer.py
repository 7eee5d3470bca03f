"""A fitted model on other data: its parameters are only known to within the errors of the fit.

Kept-aside runs may lead where those of the fit hardly went, nearer to the sea bed, say, or faster. There a
standard error of a parameter may come to many times the noise, and says nothing against the model.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from undertow.typing import Array

from ..output_error.descent import OutputErrorFit
from ..output_error.shooting import Shooting
from ..weak.step import bounds_of, prior_of

# How often errors of the fit may be larger by chance than what parameters are moved by here.
_BY_CHANCE = 1e-3
_STEPS = 3


def within_errors(fit: OutputErrorFit, shooting: Shooting, starts: Array) -> tuple[Array, Array] | None:
    """The parameters that simulate other windows best, held by how well the fit knows them.

    The sum of squares over these windows and the squared distance from the fit, in units of its errors, are
    least together, as if both data had been fitted at once.

    Parameters
    ----------
    fit : OutputErrorFit
        The fit; its errors are those that the noise of the sensors gives, whatever else it leaves.
    shooting : Shooting
        The other windows, with derivatives in the free parameters of the fit.
    starts : (b, 2n) array
        Start of every window to begin with.

    Returns
    -------
    (array, array) or None
        All parameters and the starts; None if the fit rules such parameters out, or a simulation diverges.
    """
    places, fitted = list(fit.model.places), np.asarray(fit.p)
    information = fit.noise_gram + np.diag(prior_of(fit.model)[1] ** 2)
    p = fitted.copy()
    for _ in range(_STEPS):
        at = shooting.linearise(p, starts)
        if not np.isfinite(at.cost):
            return None
        moved = p[places] - fitted[places]
        slope = at.J.T @ at.r + information @ moved
        step = np.linalg.lstsq(at.J.T @ at.J + information, -slope, rcond=None)[0]
        step = np.clip(p[places] + step, *bounds_of(fit.model)) - p[places]
        starts = starts + at.start_step + at.start_slope @ step
        p[places] += step
    moved = p[places] - fitted[places]
    likely = moved @ information @ moved < chi2.isf(_BY_CHANCE, max(len(moved), 1))
    return (p, starts) if likely else None
