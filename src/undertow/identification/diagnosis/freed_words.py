"""What is said of values that the vehicle file holds fixed and that the data want to be others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from undertow.model.vehicle import Vehicle

from ..fitted import Fitted
from .estimates import estimate
from .verdict import Judgement


def changed_values(stated: Vehicle, fit: Fitted, freed: Mapping[str, Sequence[str]]) -> str:
    """The values as fitted beside those of the file, in its signs; empty where there are none.

    Parameters
    ----------
    stated : Vehicle
        The vehicle as the user gave it.
    fit : Fitted
        The fit with these values free.
    freed : mapping
        Their names, each with fixed values that would do the same in its place.
    """
    return ", ".join(_value(stated, fit, name, alike) for name, alike in freed.items())


def _value(stated: Vehicle, fit: Fitted, name: str, alike: Sequence[str]) -> str:
    found = estimate(fit, name, stated)
    error = "" if found.standard_error is None else f" ± {found.standard_error:.1g}"
    unit = f" {found.unit}" if found.unit else ""
    before = "" if found.prior is None else f" where it has {found.prior:.4g}"
    same = f" ({' or '.join(alike)} would do the same)" if alike else ""
    return f"{name} = {found.value:.4g}{error}{unit}{before}{same}"


def with_values(judgement: Judgement, values: str, quiet: bool) -> str:
    """The headline of a verdict with what is to be said of the values.

    Parameters
    ----------
    judgement : Judgement
        The verdict on effects.
    values : str
        The values, as `changed_values` tells them.
    quiet : bool
        Whether nothing but noise is left with them.
    """
    said = judgement.headline
    if not values:
        return said
    if judgement.verdict == "adequate":
        return (
            "No effect is missing, but values that the vehicle file holds fixed do not fit. With others what "
            f"is left is the noise of the sensors: {values}."
        )
    if quiet and judgement.effects:
        return f"{said} Beside it, values that the vehicle file holds fixed do not fit: {values}."
    return f"{said} Values that the vehicle file holds fixed were fitted with the rest: {values}."
