"""What a model leaves in each degree of freedom: how much, against the noise, and with what it goes."""

from __future__ import annotations

import numpy as np

from undertow.model.symbols import FORCE_UNITS

from ..fitted import Fitted
from ..weak.data import WeakData
from .associations.wording import sentence
from .characterise import Characteriser
from .result import Remaining


def remaining(fit: Fitted, known: WeakData, aside: WeakData) -> list[Remaining]:
    """Residual force of every degree of freedom on kept-aside data.

    Parameters
    ----------
    fit : Fitted
        The model.
    known, aside : WeakData
        Data that it was fitted to, and data kept aside.

    Returns
    -------
    list of Remaining
        In the order of the vehicle's degrees of freedom. The rms is that of the force averaged under the
        test functions, in N or N m; the normalised error weighs slow parts, where there is little noise, as
        heavily as they deserve.
    """
    characteriser = Characteriser(fit, known, aside)
    return [_left(characteriser, fit, i) for i in range(len(fit.model.functions.vehicle.dof_indices))]


def _left(characteriser: Characteriser, fit: Fitted, i: int) -> Remaining:
    vehicle, row, loud = fit.model.functions.vehicle, characteriser.rows[i], characteriser.is_loud(i)
    error = float(np.sqrt(row.ratio))
    left = Remaining(
        degree_of_freedom=vehicle.degrees_of_freedom[i],
        normalised_error=error,
        residual_rms=row.rms,
        noise_rms=row.noise_rms,
        unit=FORCE_UNITS[vehicle.dof_indices[i]],
        excess_rms=row.excess_rms if loud else 0.0,
        note=f"{error:.1f} times what the noise explains" if loud else "explained by the noise",
    )
    if loud:
        for name, found in vars(characteriser.of(i)).items():
            setattr(left, name, found)
    left.summary = sentence(left, loud)
    return left
