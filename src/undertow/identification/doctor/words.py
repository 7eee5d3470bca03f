"""Mistakes in words, with the numbers that speak for them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Run
from .dynamic_search import Explanation
from .dynamics import Gain
from .findings import Finding, percent
from .kinematic_search import Explained, inconsistent
from .kinematics import Kinematics
from .mistake import Mistake
from .model_mistakes import LostSign, OtherMass
from .units import POSITIONS, UNITS_OF_MOTION


def kinematic_text(
    kinematics: Kinematics, found: Explained, chosen: Mistake, runs: Sequence[Run]
) -> tuple[str, dict[str, float]]:
    """One line on a mistake that shows in the kinematics of runs, and its evidence."""
    names = [", ".join(kinematics.rows[i] for i in block) for block in kinematics.blocks]
    before, after = found.before, found.after
    rows = np.flatnonzero(inconsistent(before) | (after.excess < before.excess / 2))
    parts = [f"of {names[i]} {percent(before.share[i])} → {percent(after.share[i])}" for i in rows]
    sizes = _sizes(kinematics, found, runs) if chosen.id in UNITS_OF_MOTION else ""
    mismatch = f"the mismatch of pose rate and velocity {', '.join(parts)} of the motion"
    text = f"{chosen.told}: {sizes}undone, {mismatch}"
    evidence = {f"mismatch_{names[i].replace(', ', '')}": float(before.share[i]) for i in rows}
    evidence |= {f"{k}_undone": float(after.share[i]) for k, i in zip(list(evidence), rows, strict=True)}
    return f"{text} (mean square; noise {percent(float(np.max(before.floor[rows])))})", evidence


def _sizes(kinematics: Kinematics, found: Explained, runs: Sequence[Run]) -> str:
    """How fast the position changes where that contradicts the velocities most, by both."""
    linear = [i for i, block in enumerate(kinematics.blocks) if kinematics.rows[block[0]] in POSITIONS]
    block = kinematics.blocks[max(linear, key=lambda i: found.before.excess[i])]
    rates = kinematics.rates(runs)
    pose, velocity = (_rms(a[:, block]) for a in (rates.pose, rates.velocity))
    names = ", ".join(kinematics.rows[i] for i in block)
    verb = "change" if len(block) > 1 else "changes"
    return f"{names} {verb} by {pose:.3g} m/s rms, and the velocities say {velocity:.3g} m/s; "


def _rms(table: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(table**2, axis=1))))


def dynamic_text(vehicle: Vehicle, found: Explanation) -> tuple[str, dict[str, float]]:
    """One line on a mistake that shows in the fit of the model, and its evidence."""
    return f"{found.mistake.told}: undone, {_gained(vehicle, found.gain)}", _evidence(vehicle, found.gain)


def _gained(vehicle: Vehicle, gain: Gain) -> str:
    parts = [
        f"{dof} {b:.3g} → {a:.3g}"
        for dof, b, a, f in zip(
            vehicle.degrees_of_freedom, gain.before, gain.after, gain.factors, strict=True
        )
        if f > 2
    ]
    return f"the refitted model leaves {', '.join(parts)} times the noise (mean square)"


def _evidence(vehicle: Vehicle, gain: Gain) -> dict[str, float]:
    rows = zip(vehicle.degrees_of_freedom, gain.before.tolist(), gain.after.tolist(), strict=True)
    return {f"{dof}{when}": v for dof, b, a in rows for when, v in (("", b), ("_undone", a))}


def sign_finding(vehicle: Vehicle, lost: LostSign, gain: Gain) -> Finding:
    """A square without its sign."""
    terms = ", ".join(lost.terms)
    return Finding(
        id="lost_sign",
        severity="mistake",
        text=f"effect {lost.effect} has a square without its sign ({terms}), which pushes when moving "
        f"astern: with |u| u for u^2, {_gained(vehicle, gain)}",
        evidence=_evidence(vehicle, gain),
        vehicle=f"effect {lost.effect}: write sm.Abs(u) * u where it has u**2 ({terms})",
    )


def mass_finding(vehicle: Vehicle, mass: OtherMass) -> Finding:
    """A mass that is not that of the vehicle in the water."""
    known = not mass.moved
    which = "dry" if mass.found > mass.stated else "wrong"
    if known:
        reason = f"with it, {_gained(vehicle, mass.gain)}"
    else:
        moved = ", ".join(f"{n} {z:+.1f}" for n, z in mass.moved.items())
        reason = f"with m as stated the added masses leave their stated values ({moved} standard deviations)"
    return Finding(
        id="dry_mass",
        severity="mistake" if known else "warning",
        text=f"m = {mass.stated:.4g} kg looks like the {which} mass: the logs ask for {mass.found:.4g} ± "
        f"{mass.error:.2g} kg; {reason}",
        evidence={"stated": mass.stated, "found": mass.found, "error": mass.error},
        vehicle=f'[effects.rigid_body] m = "{mass.found:.4g} kg" (the mass with the water inside)',
        alternatives=["water that moves along but weighs nothing: undertow add entrained_water"],
    )
