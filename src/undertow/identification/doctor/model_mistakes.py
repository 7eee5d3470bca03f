"""The usual mistakes in a vehicle file: dry mass for wet mass, and a square without its sign."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import sympy as sm

from undertow.model.effect import Effect, Wrench
from undertow.model.symbols import FORCE, VELOCITY, Signals
from undertow.model.vehicle import Vehicle

from ..fitted import MORE_THAN_CHANCE
from ..weak.fit import WeakFit
from .dynamics import Dynamics, Gain

_TRANSLATION = ("X_udot", "Y_vdot", "Z_wdot")
# Another mass is believed between these factors of the one in the file, and only from a tenth on.
_LIGHTEST, _HEAVIEST, _LEAST = 0.6, 2.5, 0.1
# Standard errors by themselves, and where added masses that were far off come home with another mass.
_SURE, _SURE_BESIDE = 3.0, 1.0
# Standard deviations of its prior: within two, an added mass is where it should be; one must be far beyond.
_HOME, _FAR = 2.0, 4.0


@dataclass(frozen=True)
class OtherMass:
    """The mass that logs ask for.

    Attributes
    ----------
    stated, found, error : float
        In the file, from the logs, and its standard error, kg.
    gain : Gain
        What refitting it does to the equations of motion.
    moved : dict
        Added masses that have left their stated values, in standard deviations, and come back with this mass.
    """

    stated: float
    found: float
    error: float
    gain: Gain
    moved: dict[str, float]


def other_mass(at: Dynamics) -> OtherMass | None:
    """The mass that the logs ask for; None where it is no other, or they cannot tell.

    With added masses that are free and have no stated spread, nothing can be told: they take up any mass. Nor
    can it where an added mass that is held fixed explains as much with another value.
    """
    known = at.vehicle.values.get("m")
    if known is None or known.estimate or "m" not in at.vehicle.parameter_names:
        return None
    fit = at.refitted(free=("m",))
    if fit is None:
        return None
    found, error = fit.values["m"], fit.standard_errors["m"]
    ratio = found / known.value
    if not (_LIGHTEST < ratio < _HEAVIEST and abs(ratio - 1) > _LEAST):
        return None
    gain = at.gain(fit)
    moved = _come_home(at.fit, fit) if gain.explained else {}
    # What added masses and mass share is poorly known; that added masses are where they should be is not.
    sure = abs(found - known.value) > (_SURE_BESIDE if moved else _SURE) * error
    if not sure or not (moved or gain.decisive) or _added_mass_instead(at, fit):
        return None
    return OtherMass(known.value, found, error, gain, moved)


def _added_mass_instead(at: Dynamics, with_mass: WeakFit) -> bool:
    """Whether another value of one fixed added mass explains as much as another mass."""
    values = {n: at.vehicle.values[n] for n in _TRANSLATION if n in at.vehicle.values}
    tried = (at.refitted(free=(n,)) for n, v in values.items() if not v.estimate)
    return any(fit is not None and fit.cost < with_mass.cost + MORE_THAN_CHANCE for fit in tried)


def _come_home(before: WeakFit, after: WeakFit) -> dict[str, float]:
    """Added masses that were several standard deviations off in the same sense, and no longer are."""
    off, home = (_standardised(f) for f in (before, after))
    moved = {n: z for n, z in off.items() if abs(z) > _HOME}
    same_sense = len(moved) >= 2 and len({np.sign(z) for z in moved.values()}) == 1
    far = max(map(abs, moved.values()), default=0.0) > _FAR
    return moved if same_sense and far and all(abs(z) < _HOME for z in home.values()) else {}


def _standardised(fit: WeakFit) -> dict[str, float]:
    vehicle = fit.model.functions.vehicle
    priors = {n: vehicle.value_of(n) for n in _TRANSLATION if n in fit.values}
    return {n: (fit.values[n] - v.value) / v.sigma for n, v in priors.items() if v.sigma}


# --- squares ----------------------------------------------------------------------------------
@dataclass(frozen=True)
class LostSign:
    """An effect whose force is even in its own velocity.

    Attributes
    ----------
    effect : str
        Its id.
    terms : list of str
        Such as "X: u^2".
    vehicle : Vehicle
        The vehicle with |u| u in its place.
    """

    effect: str
    terms: list[str]
    vehicle: Vehicle


def lost_signs(vehicle: Vehicle) -> Iterator[LostSign]:
    """Effects with the square of a velocity in the force along it: drag that pushes when moving astern."""
    for effect in vehicle.effects:
        if isinstance(effect, Wrench):
            terms = _squares(effect, vehicle)
            if terms:
                mended = _with_signs(effect)
                others = tuple(mended if e is effect else e for e in vehicle.effects)
                yield LostSign(effect.id, terms, replace(vehicle, effects=others))


def _squares(effect: Wrench, vehicle: Vehicle) -> list[str]:
    signals = vehicle.composition.signals
    wrench = effect.wrench(signals)
    return [
        f"{FORCE[i]}: {VELOCITY[i]}^2"
        for i in vehicle.dof_indices
        if any(wrench[i].has(v**2) for v in (signals.nu[i], signals.nu_r[i]))
    ]


def _with_signs(effect: Wrench) -> Effect:
    """The same effect with |v| v for v^2 along each motion."""
    kind = type(effect)

    def wrench(self: Wrench, s: Signals) -> sm.Matrix:
        found = kind.wrench(self, s)
        rows = [_signed(found[i], (s.nu[i], s.nu_r[i])) for i in range(6)]
        return sm.Matrix(rows)

    # The contract of an effect is kept: only its statement changes.
    return type(kind.__name__, (kind,), {"wrench": wrench, "__doc__": kind.__doc__})(effect.thrusters)


def _signed(force: sm.Expr, velocities: tuple[sm.Symbol, ...]) -> sm.Expr:
    return sm.sympify(force, strict=True).xreplace({v**2: sm.Abs(v) * v for v in velocities})
