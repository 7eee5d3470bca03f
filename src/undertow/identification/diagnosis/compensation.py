"""Parameters that a fit pushed away to make up for what is missing, and the effect that brings them back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.errors import UndertowError
from undertow.model.parameter import printed
from undertow.model.plausibility import check_vehicle
from undertow.model.vehicle import Vehicle

from ..fitted import Fitted
from .finding import Finding

# Standard deviations of prior and fit together from which a value is far from what was stated.
_FAR = 3.0
# Share of its way that a parameter must come back.
_BACK = 0.5
# Times the error of the leading candidate up to which another does as well.
_AS_GOOD = 1.05
_SHOWN_OTHERS = 2
_ON_BOUND = 1e-6
# Factor from which a value is far from one that was stated without a standard deviation.
_MANY_TIMES = 3.0


@dataclass(frozen=True)
class Relief:
    """The model with effects added that lower the kept-aside error by more than chance.

    Attributes
    ----------
    effects : tuple of str
        Ids of the effects.
    values : mapping
        Fitted values of the parameters, SNAME signs.
    error : float
        Kept-aside error.
    """

    effects: tuple[str, ...]
    values: Mapping[str, float]
    error: float

    @property
    def name(self) -> str:
        """The effects in words."""
        return " and ".join(self.effects)


@dataclass(frozen=True)
class _Pushed:
    """A parameter far from what was stated, in standard deviations of prior and fit together."""

    name: str
    value: float
    prior: float
    distance: float
    bound: float | None

    @property
    def change(self) -> float:
        return self.value - self.prior


def reliefs(findings: Iterable[Finding]) -> list[Relief]:
    """What candidates of a ranking would do to the parameters; only those that are held to be there count."""
    found = (f for f in findings if f.significant)
    return [Relief((f.id,), f.trial.fit.values, f.trial.score.error) for f in found]


def absorbing(
    vehicle: Vehicle, fit: Fitted, helpers: Sequence[Relief], alike: Mapping[str, Sequence[str]] | None = None
) -> list[str]:
    """Warnings for parameters that a fit pushed far from what was stated, or to where they cannot be.

    Parameters
    ----------
    vehicle : Vehicle
        The model as the user gave it; `sigma` of its values are the stated priors.
    fit : Fitted
        The refitted model without further effects.
    helpers : sequence of Relief
        Models with effects added.
    alike : mapping, optional
        For parameters, ids of effects that the data cannot tell from what these were changed by.

    Returns
    -------
    list of str
        One line for each parameter. An effect is only named where it, or one that does as well, leads the
        ranking and the parameter comes back with it.
    """
    least = min((h.error for h in helpers), default=0.0)
    leading = [h for h in helpers if h.error <= _AS_GOOD * least]
    lines = [
        _line(vehicle, pushed, leading, (alike or {}).get(pushed.name, ()))
        for pushed in _pushed(vehicle, fit)
    ]
    return [*lines, *_impossible(vehicle, fit.vehicle)]


def _pushed(vehicle: Vehicle, fit: Fitted) -> list[_Pushed]:
    errors, found = fit.standard_errors, []
    for name, value in fit.values.items():
        stated, bound = vehicle.value_of(name), _bound(vehicle, name, value)
        if stated.sigma is None and bound is None and not _many_times(value, stated.value):
            continue
        spread = float(np.hypot(stated.sigma or 0.0, errors[name]))
        distance = abs(value - stated.value) / spread if spread > 0 else np.inf
        if distance > _FAR:
            found.append(_Pushed(name, value, stated.value, distance, bound))
    return found


def _many_times(value: float, stated: float) -> bool:
    ratio = value / stated if stated else 1.0
    return not 1.0 / _MANY_TIMES < ratio < _MANY_TIMES


def _bound(vehicle: Vehicle, name: str, value: float) -> float | None:
    """The physical bound that a value lies on or beyond, or None."""
    low, high = vehicle.declaration(name).bounds
    slack = _ON_BOUND * max(abs(vehicle.value_of(name).value), abs(value))
    return low if value <= low + slack else high if value >= high - slack else None


# --- words ------------------------------------------------------------------------------------
def _line(vehicle: Vehicle, pushed: _Pushed, leading: Sequence[Relief], alike: Sequence[str]) -> str:
    bare = vehicle.declaration(pushed.name).name
    owner = next(e.id for e in vehicle.all_effects if any(p.name == bare for p in e.parameters))
    line = f"{owner.replace('_', ' ')}: {pushed.name} {_where(vehicle, pushed)}"
    helping = [h for h in leading if _comes_back(pushed, h)]
    if not helping:
        missing = " or ".join(alike) or "something that is missing"
        return f"{line}: either the prior is wrong, or it makes up for {missing}"
    best, after = helping[0].name, helping[0].values[pushed.name]
    others = [h.name for h in helping[1:] if not {*helping[0].effects} & {*h.effects}][:_SHOWN_OTHERS]
    back = f"{after / pushed.prior:.3g} times" if pushed.prior else _number(vehicle, pushed.name, after)
    return f"{line}: it is absorbing {' or '.join([best, *others])}; with {best} it returns to {back}"


def _where(vehicle: Vehicle, pushed: _Pushed) -> str:
    far = f"{pushed.distance:.1f} standard deviations"
    prior = _number(vehicle, pushed.name, pushed.prior)
    if pushed.bound is not None:
        return f"is at its bound {_number(vehicle, pushed.name, pushed.bound)}, {far} from {prior}"
    if pushed.prior and vehicle.value_of(pushed.name).sigma is None:
        return (
            f"is {pushed.value / pushed.prior:.3g} times its stated value (no standard deviation is stated)"
        )
    if pushed.prior:
        return f"is {pushed.value / pushed.prior:.3g} times its prior ({far})"
    return f"is {_number(vehicle, pushed.name, pushed.value)} against a prior of 0 ({far})"


def _number(vehicle: Vehicle, name: str, value: float) -> str:
    """A value in the sign convention of the vehicle file."""
    return f"{printed(vehicle.declaration(name), value, vehicle.signs):.3g}"


def _comes_back(pushed: _Pushed, helper: Relief) -> bool:
    after = helper.values.get(pushed.name)
    return after is not None and abs(after - pushed.prior) < _BACK * abs(pushed.change)


def _impossible(stated: Vehicle, fitted: Vehicle) -> list[str]:
    """What the fit did that no vehicle can be, such as a mass matrix that is not positive definite."""
    complaint = _complaint(fitted)
    return [f"the refitted vehicle cannot be: {complaint}"] if complaint and not _complaint(stated) else []


def _complaint(vehicle: Vehicle) -> str:
    try:
        check_vehicle(vehicle)
    except UndertowError as error:
        return str(error)
    return ""
