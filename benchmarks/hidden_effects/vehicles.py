"""The vehicles by name, and how a real one differs from the drawing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .drawing import Vehicle
from .fleet import DRAWINGS

__all__ = ["GUESS_SPREAD", "NOMINAL", "Vehicle", "real_vehicle"]

#: Largest relative difference of the drawn truth from the nominal value, and of a guess from the truth.
TRUTH_SPREAD, GUESS_SPREAD = 0.2, 0.15

NOMINAL: dict[str, Vehicle] = {v.name: v for v in DRAWINGS}


def real_vehicle(name: str, rng: np.random.Generator) -> Vehicle:
    """The vehicle as built: each nominal hydrodynamic value times 1 +- 20%, the rest as on the drawing."""
    nominal = NOMINAL[name]
    low, high = 1 - TRUTH_SPREAD, 1 + TRUTH_SPREAD
    added, linear, quadratic = (v * rng.uniform(low, high, 6) for v in
                                (nominal.added, nominal.linear, nominal.quadratic))  # fmt: skip
    return replace(nominal, added=added, linear=linear, quadratic=quadratic)
