"""A vehicle with uncertain parameters: a family of linear systems."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import casadi as ca
import control as ct
import numpy as np

from undertow.control.gains import GainSet
from undertow.errors import UndertowError, of_stated_kinds
from undertow.model.loading import last_covariance, read_vehicle_table, resolve_vehicle
from undertow.model.vehicle import Vehicle
from undertow.observer.design import Design
from undertow.typing import Array

from .analysis import Mode, modes
from .numeric import Numeric, in_direction, motion_of
from .systems import LinearLoop, law_for, linear_at, linear_with_delays, with_commands
from .trim import Balance, Trim, at_parameters, find_trim


@dataclass(frozen=True)
class FamilySettings:
    """How the members of a family are chosen, and how many are drawn."""

    corner_distance: float = 2.0  # from the stated values, standard deviations
    # Draws that are no vehicle, for each that is wanted, with which the family is refused.
    most_refused_draws: int = 50
    difference_step: float = 1e-3  # of finite differences, standard deviations
    # Relative difference of entries up to which a corner changes nothing, and the same in their units.
    same: float = 1e-9
    same_entry: float = 1e-12
    most_drawn: int = 120  # members of which pictures have curves, the stated vehicle included


SETTINGS = FamilySettings()


@dataclass(frozen=True)
class Spread:
    """Uncertainty of parameters."""

    names: tuple[str, ...]  # parameters, in the order of the covariance
    covariance: Array  # SI and SNAME signs, shape (k, k)
    source: str  # where the covariance comes from


@dataclass(frozen=True)
class Member:
    """One system of a family."""

    name: str  # "stated", "draw 7" or "X_u + 2 sigma"
    values: Mapping[str, float]  # parameters that differ from the stated ones, SI and SNAME signs
    modes: tuple[Mode, ...]
    system: ct.StateSpace
    loop: LinearLoop | None = None  # where a law closes the loop

    @property
    def stable(self) -> bool:
        """Whether no mode grows."""
        return all(m.stable for m in self.modes)


@dataclass(frozen=True)
class Family:
    """The linear systems within the uncertainty of an identification."""

    spread: Spread  # what they are drawn from
    members: tuple[Member, ...]  # the stated one, then corners, then draws
    refused: int  # draws that no vehicle can have (a negative mass, say) or without such a trim; redrawn

    @property
    def unstable(self) -> list[Member]:
        """Members with a mode that grows."""
        return [m for m in self.members if not m.stable]


def spread_of(vehicle: Vehicle, source: str | Path | None = None) -> Spread:
    """Uncertainty of the parameters of a vehicle.

    Its stated standard deviations (sigma) count as independent. The covariance of the last fit in the history
    of its file, `source`, replaces them for what was fitted.
    """
    names, matrix = ((), np.zeros((0, 0))) if source is None else _last_covariance(vehicle, source)
    stated = {n: v.sigma for n, v in vehicle.values.items() if v.sigma and n not in names}
    used = {n: s for n, s in stated.items() if n in vehicle.parameter_names and np.isfinite(s)}
    if not names and not used:
        raise UndertowError(
            f"no parameter of '{vehicle.name}' has a standard deviation: write, for instance, "
            'X_u = { value = ..., sigma = "..." }, or fit it to logs'
        )
    total = np.zeros((len(names) + len(used),) * 2)
    total[: len(names), : len(names)] = matrix
    total[len(names) :, len(names) :] = np.diag(np.square(list(used.values())))
    words = [f"covariance of the last fit for {len(names)}"] if names else []
    words += [f"stated standard deviations of {len(used)}"] if used else []
    return Spread((*names, *used), total, " and ".join(words) + " parameters")


def _last_covariance(vehicle: Vehicle, source: str | Path) -> tuple[tuple[str, ...], Array]:
    """Parameters and covariance of the last fit that the history of a file tells of; none if it has none."""
    names, matrix = last_covariance(read_vehicle_table(resolve_vehicle(source)).history, vehicle)
    kept = [i for i, n in enumerate(names) if n in vehicle.parameter_names]
    total = np.array(matrix, dtype=float).reshape(len(names), len(names))
    return tuple(names[i] for i in kept), total[np.ix_(kept, kept)]


@of_stated_kinds
def family(
    vehicle: Vehicle,
    trim: Trim | Mapping[str, float],
    size: int,
    *,
    gains: GainSet | None = None,
    observer: Design | None = None,
    pade: int = 0,
    source: str | Path | None = None,
    seed: int = 0,
) -> Family:
    """Linear systems over the uncertainty of the parameters.

    First the stated vehicle, then corners (each parameter by itself, and all together in the way that slows
    the slowest mode down most, `corner_distance` away but within physical bounds), then seeded
    draws. Each member has its own trim. With gains each is a closed loop whose law knows the stated vehicle.

    Parameters
    ----------
    vehicle, trim
        As for `linearize`.
    size : int
        Number of draws.
    gains : GainSet, optional
        A law that closes the loop.
    observer, pade
        As for `close_loop`.
    source : str or Path, optional
        The vehicle's file, for the covariance of its last fit.
    seed : int
        Of the draws.
    """
    if size < 0:
        raise UndertowError(f"a family with {size} drawn vehicles is impossible: give zero or more")
    found = trim if isinstance(trim, Trim) else find_trim(vehicle, trim)
    factory, spread = (_MemberFactory(vehicle, found, gains, observer, pade), spread_of(vehicle, source))
    stated = factory.member("stated", np.array([]), ())
    if stated is None:  # no parameter differs, so the trim holds
        raise UndertowError(f"'{vehicle.name}' does not have the given trim: find it again for this vehicle")
    corners = [factory.member(name, shift, spread.names) for name, shift in _corners(spread, factory, stated)]
    made = [m for m in corners if m is not None and not _equals_stated(m, stated)]
    draws, refused = _draws(spread, factory, size, np.random.default_rng(seed))
    return Family(spread, (stated, *made, *draws), refused)


def _draws(
    spread: Spread, factory: _MemberFactory, size: int, random: np.random.Generator
) -> tuple[list[Member], int]:
    draws: list[Member] = []
    refused = 0
    while len(draws) < size:
        shift = random.multivariate_normal(np.zeros(len(spread.names)), spread.covariance, method="eigh")
        member = factory.member(f"draw {len(draws) + 1}", shift, spread.names, clip=False)
        if member is not None:
            draws.append(member)
            continue
        refused += 1
        if refused > SETTINGS.most_refused_draws * size:
            raise UndertowError(
                f"hardly any draw of the parameters of '{factory.vehicle.name}' is a vehicle: the standard "
                "deviations are too large for the values; fit them to logs, or state smaller ones"
            )
    return draws, refused


def _equals_stated(member: Member, stated: Member) -> bool:
    """Whether a corner changes nothing: a parameter of the other direction of motion."""
    pairs = ((member.system.A, stated.system.A), (member.system.B, stated.system.B))
    share, entry = SETTINGS.same, SETTINGS.same_entry
    return all(a.shape == b.shape and np.allclose(a, b, rtol=share, atol=entry) for a, b in pairs)


def _corners(spread: Spread, factory: _MemberFactory, stated: Member) -> Iterator[tuple[str, Array]]:
    sigmas = np.sqrt(np.diag(spread.covariance))
    for i, name in enumerate(spread.names):
        for sign, word in ((1, "+"), (-1, "-")):
            shift = np.zeros(len(sigmas))
            shift[i] = sign * SETTINGS.corner_distance * sigmas[i]
            yield f"{name} {word} {SETTINGS.corner_distance:g} sigma", shift
    slope = _slope_of_slowest(spread, factory, stated, sigmas)
    for sign, word in ((1, "slowest"), (-1, "quickest")):
        if np.any(slope):
            yield f"all together, {word}", sign * SETTINGS.corner_distance * sigmas * np.sign(slope)


def _slope_of_slowest(spread: Spread, factory: _MemberFactory, stated: Member, sigmas: Array) -> Array:
    """Change of the real part of the slowest mode that is not at zero, per standard deviation."""
    slope = np.zeros(len(sigmas))
    for i in range(len(sigmas)):
        small = np.zeros(len(sigmas))
        small[i] = SETTINGS.difference_step * sigmas[i]
        member = factory.member("", small, spread.names)
        if member is not None:
            slope[i] = (_slowest(member) - _slowest(stated)) / SETTINGS.difference_step
    return slope


def _slowest(member: Member) -> float:
    return max((m.pole.real for m in member.modes if m.pole), default=0.0)


class _MemberFactory:
    """Makes members of a family around a trim, with the same values held for every member.

    The law, if there is one, knows the stated vehicle.
    """

    def __init__(
        self, vehicle: Vehicle, trim: Trim, gains: GainSet | None, observer: Design | None, pade: int
    ) -> None:
        self.vehicle, self._trim = vehicle, trim
        self._observer, self._pade = observer, pade
        self._numeric = Numeric(in_direction(vehicle, trim.direction))
        self._balance = Balance(self._numeric, trim.request)
        self._law = None if gains is None else law_for(gains, vehicle, trim.direction)
        f = self._numeric.functions
        self._mass = ca.Function("mass", [f.x, f.p, f.t], [ca.densify(f.mass_matrix)])

    def member(self, name: str, shift: Array, names: tuple[str, ...], *, clip: bool = True) -> Member | None:
        """A member with shifted parameters, or None where they are no vehicle or it has no such trim.

        Parameters beyond their physical bounds give no vehicle, unless they are clipped.
        """
        values = {n: self.vehicle.value_of(n).value + float(d) for n, d in zip(names, shift, strict=True)}
        inside = {n: self._clipped(n, v) for n, v in values.items()}
        if inside != values and not clip:
            return None
        p = self._parameters(inside)
        if np.min(np.linalg.eigvalsh(self._mass(self._trim.x, p, 0.0).full())) <= 0:
            return None
        found = at_parameters(self._balance, p, self._trim.x, self._trim.u)
        if found is None:
            return None
        states, commands = self._trim.states, self._trim.commands
        trim = replace(
            self._trim,
            states=dict(zip(states, found[0], strict=True)),
            commands=dict(zip(commands, found[1], strict=True)),
            reports=self._numeric.reports(*found, p),
        )
        plant = self._plant(trim, p)
        if self._law is None:
            return Member(name, inside, tuple(modes(plant)), plant)
        loop = LinearLoop(
            with_commands(plant, self._law.commands), self._law, trim, self._observer, self._pade
        )
        return Member(name, inside, tuple(modes(loop.closed)), loop.closed, loop)

    def _plant(self, trim: Trim, p: Array) -> ct.StateSpace:
        """Without dead time where no approximation is asked for, as the stated vehicle, which says so."""
        if not self._pade:
            return linear_at(self._numeric, trim, p)
        return linear_with_delays(self._numeric, trim, self._pade, p=p)

    def _clipped(self, name: str, value: float) -> float:
        low, high = self.vehicle.declaration(name).bounds
        return min(max(value, low), high)

    def _parameters(self, values: Mapping[str, float]) -> Array:
        """The vector p; a value of one direction stands for both where the trim has chosen it."""
        names, p = self._numeric.functions.parameter_names, self._numeric.p.copy()
        for name, value in values.items():
            split = name in self.vehicle.sides
            sign = self._trim.direction.get(motion_of(self.vehicle, name) or "") if split else None
            for other in [name] if sign is None else _both_directions(self.vehicle, name, sign):
                p[names.index(other)] = value
        return p


def _both_directions(vehicle: Vehicle, name: str, sign: int) -> list[str]:
    """Parameters replaced by one of direction `sign` if that is taken for both."""
    parameter, own = vehicle.sides[name]
    chosen = own == ("forward" if sign > 0 else "backward")
    return [n for n, (p, _) in vehicle.sides.items() if p is parameter] if chosen else []
