"""Fitted parameters as a user reads them: in the vehicle file's sign convention, beside what was stated."""

from __future__ import annotations

from undertow.model.parameter import Parameter, printed
from undertow.model.vehicle import Vehicle

from ..fitted import Fitted
from ..weak.estimated import NOTHING_SAID
from .result import Estimate


def estimates(fit: Fitted, stated: Vehicle) -> list[Estimate]:
    """All free parameters of a fit."""
    return [estimate(fit, name, stated) for name in fit.model.free]


def estimate(fit: Fitted, name: str, stated: Vehicle) -> Estimate:
    """One free parameter of a fit; `stated` is the vehicle as the user gave it."""
    vehicle = fit.model.functions.vehicle
    parameter = vehicle.declaration(name)
    prior = stated.values.get(name)
    return Estimate(
        name=name,
        effect=_owner(vehicle, parameter.name),
        value=printed(parameter, fit.values[name], stated.signs),
        standard_error=_known(fit.standard_errors[name]),
        unit=_unit(parameter),
        about=parameter.about,
        prior=None if prior is None else printed(parameter, prior.value, stated.signs),
        prior_sigma=None if prior is None else prior.sigma,
    )


def _owner(vehicle: Vehicle, name: str) -> str:
    return next(e.id for e in vehicle.all_effects if any(p.name == name for p in e.parameters))


def _unit(parameter: Parameter) -> str:
    return "" if parameter.unit == "1" else parameter.unit


def _known(standard_error: float) -> float | None:
    """A standard error, unless the data say nothing at all of the parameter."""
    return standard_error if standard_error < NOTHING_SAID else None
