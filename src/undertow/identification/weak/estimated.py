"""A vehicle with the values that a fit found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from undertow.model.vehicle import Vehicle

#: Standard error from which the data say nothing of a parameter, in its SI unit.
NOTHING_SAID = 1e12


def estimated(vehicle: Vehicle, values: Mapping[str, float], errors: Mapping[str, float]) -> Vehicle:
    """The vehicle with fitted values and their standard errors.

    Parameters
    ----------
    vehicle : Vehicle
        The model before the fit.
    values, errors : mapping
        Value and standard error of every free parameter, SI and SNAME signs. What the data say nothing of
        keeps the error that was stated for it, if any.
    """
    found = {}
    for name, value in values.items():
        known = vehicle.value_of(name)
        sigma = errors[name] if errors[name] < NOTHING_SAID else known.sigma
        found[name] = replace(known, value=value, sigma=sigma, estimate=True)
    return vehicle.with_values(found)
