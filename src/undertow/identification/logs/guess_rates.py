"""Units and signs of turning rates, as the angles change."""

from __future__ import annotations

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from undertow.model.symbols import POSE, VELOCITY
from undertow.model.units import scale_offset
from undertow.typing import Array

from .guess_frames import Axes, Guess, change, rows_in, summed
from .guess_names import RATES, Name


@dataclass(frozen=True)
class RateSettings:
    """Settings for guessing turning rates."""

    over: float = 1.0  # s over which a rate and the change of its angle are compared
    correlation_limit: float = 0.9  # correlation of the two
    fewest: int = 20  # rows with both that show it
    still: float = 7e-5  # rad/s; no turning rate stays below that of the earth
    # A rate that would turn a vehicle by this within so long, and back, is in degrees a second.
    overturning: tuple[float, float] = (np.pi, 5.0)  # rad, s


SETTINGS = RateSettings()
UPSIDE_DOWN = "in radians the vehicle would be upside down: is it in deg?"
_AGAINST = "its sign is reversed here, so that it is the rate of the heading in these axes: is that right?"
_OVER = "in rad/s it would turn the vehicle over: is it in deg/s?"


def with_rates(
    read: Sequence[Guess],
    names: Sequence[Name],
    data: Mapping[str, Array],
    angles: tuple[Array, Mapping[str, Array]],
    axes: Axes,
) -> list[Guess]:
    """The guesses with units of turning rates, and the sign of that of yaw, as angles (times, rad) change.

    Rates that no angle decides follow the others of their vector where one of these is in degrees.
    """
    t, known = angles
    found, decided = _by_heading(read, names, data, (t, known.get("psi")), axes)
    stated = {n.column for n in names if n.unit}
    doubted = {g.channel for g in found if g.doubt}
    decided -= {"r"} if "psi" in doubted else set()
    for k, guess in enumerate(found):
        if guess.channel not in ("p", "q") or guess.is_formula or guess.column in stated:
            continue
        angle = POSE[VELOCITY.index(guess.channel)]
        if angle in known:
            column, factor = _rate_of(known[angle], {guess.column: data[guess.column]}, t)
            unit = _nearest_unit(factor)
            # As many degrees as degrees a second look like radians. Only radians make more of these.
            if column and (unit == "deg/s" or angle not in doubted):
                found[k] = replace(guess, entry={**guess.entry, "unit": unit}, doubt="")
                decided.add(guess.channel)
        elif guess.entry["unit"] == "rad/s" and _turns_over(data[guess.column], t):
            found[k] = replace(guess, entry={**guess.entry, "unit": "deg/s"}, doubt=_OVER)
    return with_common_units(found, names, decided)


def _turns_over(rate: Array, t: Array) -> bool:
    """Whether a rate of roll or pitch in rad/s would turn a vehicle over and back."""
    there = np.isfinite(rate) & np.isfinite(t)
    turn, seconds = SETTINGS.overturning
    swings = summed(rate[there] - np.mean(rate[there]), t[there]) if there.any() else np.zeros(0)
    turned = change(swings, rows_in(seconds, t[there]))
    return len(turned) > 0 and bool(np.max(turned) > turn and np.min(turned) < -turn)


def _nearest_unit(factor: float) -> str:
    return min(RATES, key=lambda u: abs(np.log(abs(factor) / scale_offset(u, "rad/s")[0])))


def _by_heading(
    read: Sequence[Guess],
    names: Sequence[Name],
    data: Mapping[str, Array],
    heading: tuple[Array, Array | None],
    axes: Axes,
) -> tuple[list[Guess], set[str]]:
    """The guesses with column, unit and sign of the yaw rate as the heading changes (times, rad).

    Also "r" where that decides.
    """
    guessed, (t, psi) = next((g.column for g in read if g.channel == "r"), ""), heading
    if psi is None or len(t) == 0 or not guessed:
        return [*read], set()
    turning = {n.column: data[n.column] for n in names if n.motion() in VELOCITY[3:]}
    rates = {n: c for n, c in turning.items() if np.nanmax(np.abs(c), initial=0.0) >= SETTINGS.still}
    own = {n: c for n, c in rates.items() if n == guessed}
    column, factor = _rate_of(psi, own, t)
    if not column:
        column, factor = _rate_of(psi, rates, t)
    if not column:
        return [*read], set()
    # Where axes of the body and of the attitude differ in hand, turns to starboard count the other way.
    attitude, body = axes.entry.get("attitude", axes.entry["position"]), axes.entry["body"]
    against = (factor < 0) != ((attitude == "NED") != (body == "FRD"))
    entry = {"channel": "r", "unit": _nearest_unit(factor)} | ({"scale": -1} if against else {})
    kept = []
    for guess in read:
        if guess.channel == "r":
            other = f"the heading changes like '{column}', not like '{guess.column}': which is the yaw rate?"
            asked = [other] * (column != guess.column) + [_AGAINST] * against
            guess = Guess(column, entry, " ".join(asked))
        kept.append(guess)
    return [g for g in kept if g.channel == "r" or g.column != column], {"r"}


def _rate_of(angle: Array, rates: Mapping[str, Array], t: Array) -> tuple[str, float]:
    """The column of the derivative of an angle, and rad/s in one of its units; ("", 1) for none."""
    found, best = ("", 1.0), SETTINGS.correlation_limit
    for name, rate in rates.items():
        finite = np.isfinite(angle) & np.isfinite(rate) & np.isfinite(t)
        if finite.sum() < SETTINGS.fewest or np.ptp(rate[finite]) == 0.0:
            continue
        step = rows_in(SETTINGS.over, t[finite])
        turned = change(np.unwrap(angle[finite]), step)
        expected = change(summed(rate[finite], t[finite]), step)
        size = float(np.sum(expected**2) * np.sum(turned**2)) ** 0.5
        correlation = abs(float(np.sum(expected * turned))) / size if size > 0 else 0.0
        if correlation > best:
            best, found = correlation, (name, float(np.sum(expected * turned) / np.sum(expected**2)))
    return found


def with_common_units(
    read: Sequence[Guess], names: Sequence[Name], decided: Container[str] = ()
) -> list[Guess]:
    """The guesses with one unit for the angles of a vector, and one for its rates: degrees if any is.

    Channels whose unit is `decided` keep it.
    """
    # A small roll alone may be in either unit; with a heading in degrees from the same sensor it is in
    # degrees.
    unstated = {n.column: n.stem for n in names if not n.unit}
    kinds = {c: 0 for c in POSE[3:]} | {c: 1 for c in VELOCITY[3:]}
    degrees = {
        (unstated[g.column], kinds[g.channel]): g.entry["unit"]
        for g in read
        if g.column in unstated and g.channel in kinds and g.entry["unit"] in ("deg", "deg/s")
    }
    of = {g.column: (unstated.get(g.column), kinds.get(g.channel)) for g in read}
    sure = {of[g.column] for g in read if not g.doubt and g.entry.get("unit") == "deg"}
    found = []
    for guess in read:
        unit = degrees.get((unstated.get(guess.column, ()), kinds.get(guess.channel, -1)))
        alike = unit is not None and guess.entry["unit"] != unit and guess.channel not in decided
        known = guess.doubt == UPSIDE_DOWN and of[guess.column] in sure
        entry = {**guess.entry, "unit": unit} if alike else guess.entry
        found.append(replace(guess, entry=entry, doubt="") if alike or known else guess)
    return found
