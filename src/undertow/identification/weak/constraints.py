"""What a user asks of the parameters of a fit beyond their bounds, and what came of it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.model.parameter import printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .estimated import estimated
from .residual import WeakModel
from .step import at_bounds, bounds_of, check_known_leaders, physical

_NUMBER = r"[-+]?[\d.]+(?:[eE][-+]?\d+)?"
_EQUALITY = re.compile(rf"\s*(\w+)\s*=\s*(?:({_NUMBER})(?:\s*\*\s*|\s+))?([A-Za-z]\w*)\s*")


@dataclass(frozen=True)
class Constraints:
    """Demands on the parameters of a fit. That its mass matrix is positive is asked for in any case.

    Attributes
    ----------
    equal : mapping
        Parameters that are a multiple of another one: name to (name of the other, factor), SNAME signs.
    dissipative : bool
        Whether linear damping has to take energy from every motion, D + D' >= 0.
    """

    equal: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    dissipative: bool = False

    def model(self, vehicle: Vehicle, free: Sequence[str]) -> WeakModel:
        """The model of a vehicle with its free parameters, without those that follow others.

        Raises
        ------
        UndertowError
            If an equality names what is no parameter of the equations, leads in a circle, or leaves no
            physical model.
        """
        equal = _resolved(self.equal, vehicle)
        kept = [n for n in free if n not in equal]
        model = WeakModel(Functions(vehicle, equal), kept, dissipative=self.dissipative)
        if equal:
            check_known_leaders(model)
            _must_be_physical(model)
        return model


def _must_be_physical(model: WeakModel) -> None:
    """Refuse equalities after which no values of the free parameters give a physical model."""
    p, bounds = np.array(model.functions.values(), dtype=float), bounds_of(model)
    places = list(model.places)
    p[places] = np.clip(p[places], *bounds)
    broken = model.limits.impossible(physical(model, p, bounds))
    if broken:
        tied = ", ".join(f"{n} = {factor:g} {other}" for n, (other, factor) in model.functions.equal.items())
        raise UndertowError(
            f"{tied} (SNAME signs) leaves no {broken[0]}: check the factors and their signs, or the known "
            "values"
        )


def _resolved(equal: Mapping[str, tuple[str, float]], vehicle: Vehicle) -> dict[str, tuple[str, float]]:
    """Every equality in terms of a parameter that follows no other."""
    found = {}
    for name in equal:
        other, factor = equal[name]
        for _ in equal:
            if other in equal:
                other, factor = equal[other][0], factor * equal[other][1]
        for one in (name, other):
            _must_be_there(one, vehicle)
        if other in equal or not factor or not np.isfinite(factor):
            raise UndertowError(
                f"{name} = {equal[name][1]:g} {equal[name][0]} ties a parameter to itself or to nothing: "
                "give each parameter once on the left side, with a finite factor that is not zero"
            )
        found[name] = (other, factor)
    return found


def _must_be_there(name: str, vehicle: Vehicle) -> None:
    if name not in vehicle.parameter_names:
        known = ", ".join(vehicle.parameter_names)
        raise UndertowError(
            f"'{name}' is no parameter in the equations of '{vehicle.name}': they have {known}"
        )


def read_equalities(texts: Sequence[str], vehicle: Vehicle) -> dict[str, tuple[str, float]]:
    """Equalities as a user writes them, such as ``Y_vdot = Z_wdot`` or ``N_r = 0.5 M_q``.

    Parameters
    ----------
    texts : sequence of str
        One equality each, in the sign convention of the vehicle's file.
    vehicle : Vehicle
        Whose parameters they are.

    Raises
    ------
    UndertowError
        If a text is no equality, or names what the vehicle does not have.
    """
    found: dict[str, tuple[str, float]] = {}
    for text in texts:
        name, other, factor = _read(text)
        for one in (name, other):
            _must_be_there(one, vehicle)
        if name in found:
            raise UndertowError(f"{text!r}: {name} is on the left side twice")
        found[name] = (other, factor * _sign(other, vehicle) / _sign(name, vehicle))
    return found


def written(equal: Mapping[str, tuple[str, float]], vehicle: Vehicle) -> list[str]:
    """Equalities as `read_equalities` takes them."""
    signs = {n: _sign(other, vehicle) / _sign(n, vehicle) for n, (other, _) in equal.items()}
    return [f"{n} = {factor * signs[n]:.9g} {other}" for n, (other, factor) in equal.items()]


def _read(text: str) -> tuple[str, str, float]:
    match = _EQUALITY.fullmatch(text)
    if match is None:
        raise UndertowError(
            f"{text!r} is no equality between two parameters: write Y_vdot = Z_wdot, or N_r = 0.5 M_q"
        )
    try:
        factor = float(match[2] or 1.0)
    except ValueError as error:
        raise UndertowError(f"{text!r}: {match[2]} is no number") from error
    if not (np.isfinite(factor) and factor):
        raise UndertowError(f"{text!r}: the factor is {factor:g}: give one that is finite and not zero")
    return match[1], match[3], factor


def _sign(name: str, vehicle: Vehicle) -> float:
    """Sign of a parameter inside, where it is positive in the vehicle's file."""
    parameter = vehicle.parameter_of(name)
    return 1.0 if parameter is None else printed(parameter, 1.0, vehicle.signs)


def followers(model: WeakModel, values: Mapping[str, float]) -> dict[str, float]:
    """Values of the parameters that are tied to others, from those of the free ones."""
    f = model.functions
    known = {n: f.vehicle.value_of(n).value for n in f.parameter_names} | dict(values)
    return {name: factor * known[other] for name, (other, factor) in f.equal.items()}


def follower_errors(model: WeakModel, errors: Mapping[str, float]) -> dict[str, float]:
    """Standard errors of the parameters that are tied to others; zero where those are known."""
    tied = model.functions.equal.items()
    return {name: abs(factor) * errors.get(other, 0.0) for name, (other, factor) in tied}


def fitted_vehicle(model: WeakModel, values: Mapping[str, float], errors: Mapping[str, float]) -> Vehicle:
    """The vehicle of a model with the fitted values of its free parameters, and of those tied to them."""
    whole = {**values, **followers(model, values)}
    return estimated(model.functions.vehicle, whole, {**errors, **follower_errors(model, errors)})


def active(model: WeakModel, p: Array) -> list[str]:
    """Names of the constraints that hold a fit back: bounds, then matrices that are at their limit."""
    bounds = [f"{name} at its bound {bound:g}" for name, bound in at_bounds(model, p).items()]
    return [*bounds, *model.limits.active(p)]
