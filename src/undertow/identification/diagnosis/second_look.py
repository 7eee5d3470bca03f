"""A second look where nothing was found although more than noise is left: the noise of the sensors alone.

What an incomplete model leaves is first taken for a disturbance. Under a noise model with room for one, a
small steady force, say, is no evidence of anything. That another round of tests follows adds next to nothing
to the false alarms: it takes a model that leaves more than noise, which a complete one does once in thousands
of times, and effects that bring it down to noise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..weak.data import WeakData
from ..weak.fit import WeakFit
from .evidence import explained
from .trial import Bench, noise_ratio, only_noise, told_apart

Quiet = Callable[[WeakFit, WeakData], bool]
# Share of what exceeds the noise that effects must take away beside leaving only noise: a model that is just
# above the limit of noise may get below it by chance.
_MOST = 0.5
# Mean square in units of the sensors' noise from which no second look is worth its time: what is so far off
# hardly comes down to noise by what the first look has not found.
_FAR_OFF = 1000.0


def hidden_by_disturbance(bench: Bench) -> bool:
    """Whether a model leaves a little more than noise, which its noise model takes for a disturbance.

    By the weak form, also where the simulation of windows finds nothing but noise: their estimated starts
    take up part of a small steady force. Whether what is found is needed is for the simulation to say again.

    Parameters
    ----------
    bench : Bench
        Data, noise model and the model.
    """
    if not np.any(bench.base.disturbance) or only_noise(bench.base, bench.test):
        return False
    return bool(np.nanmax(noise_ratio(bench.base, bench.test)) < _FAR_OFF)


def explains_all(bare: Bench, fit: WeakFit, quiet: Quiet) -> bool:
    """Whether nothing but noise is left with effects that were found without room for a disturbance.

    Parameters
    ----------
    bare : Bench
        Data, the noise of the sensors and the model without the effects.
    fit : WeakFit
        The model with them.
    quiet : callable
        Whether a model leaves only noise of the kept-aside data.
    """
    share = explained(*told_apart(bare.base_score, bare.judge(fit), bare.test), bare.noise_level)
    return share >= _MOST and quiet(fit, bare.test)
