"""How far thinning moves estimates: a BlueROV2 in steps and sines of all motions, a tenth of the noise."""

from __future__ import annotations

from collections.abc import Iterator
from functools import reduce

import numpy as np

from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.logs.run import Run
from undertow.identification.long_logs.decimation import decimated, joined
from undertow.model.loading import load_vehicle

from .made import VEHICLE, Dive, columns, truth

BY = (1, 3, 5, 7, 9, 13)
_SECONDS, _SHIFT = 600, 2  # rows by which blocks and commands are out of step


def biases() -> Iterator[tuple[int, float, str, float]]:
    """Rows that became one; errors of the parameters, rms and the worst one, %."""
    vehicle, dive = load_vehicle(VEHICLE), Dive(hovering=0.0, cruising=0.0, current=(0.0, 0.0), noise=0.1)
    table = columns(_SECONDS, dive, 0)
    run = Run("dive", table.pop("t")[:-_SHIFT], {n: a[_SHIFT:] for n, a in table.items()})
    true = {n: v for n, v in truth(dive, 0).items() if not n.startswith("V_")}
    for by in BY:
        thin = reduce(joined, decimated([run], by, 1 / dive.rate, vehicle.command_names))
        values = fit_weak(vehicle, prepare([thin], vehicle)).values
        errors = {n: 100 * (values[n] / v - 1) for n, v in true.items()}
        worst = max(errors, key=lambda n: abs(errors[n]))
        yield by, float(np.sqrt(np.mean(np.square(list(errors.values()))))), worst, errors[worst]
