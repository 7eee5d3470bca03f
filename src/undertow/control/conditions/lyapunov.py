"""Lyapunov candidates, their derivatives along the closed loop, and LaSalle's sets."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from itertools import product
from random import Random
from typing import ClassVar, cast

import sympy as sm

from undertow.control.laws import Law, LawSignals, sliding_surface
from undertow.control.plant import Plant
from undertow.model.composition import function_of
from undertow.model.symbols import symbol

from .result import Lyapunov

IOTA = symbol("iota")


@dataclass(frozen=True)
class ComparisonSettings:
    """How the stated derivative of a candidate is compared with the one worked out from the model."""

    seed: int = 20210405
    points: int = 3  # at least so many random points, and one for each set of signs
    tolerance: float = 1e-9  # relative difference that counts as rounding


COMPARISON = ComparisonSettings()


class Candidate(abc.ABC):
    """A Lyapunov candidate and what its derivative is said to be.

    Errors are q~ = q_d - q as in the paper, so that the integral of a PID law is that of q~.
    """

    V: ClassVar[str]
    V_dot: ClassVar[str]
    equation: ClassVar[str]  # what they are in the paper
    zero_set: ClassVar[str]  # where V_dot is zero
    invariant: ClassVar[str]  # the largest invariant subset of it, if every axis is pushed

    @abc.abstractmethod
    def value(self, s: LawSignals) -> sm.Expr:
        """The candidate."""

    @abc.abstractmethod
    def derivative(self, s: LawSignals) -> sm.Expr:
        """What its derivative along the closed loop is said to be."""


class _PD(Candidate):
    V = "nu' M nu/2 + q~' K_P q~/2"
    V_dot = "-nu' J' K_V J nu - nu' D nu"
    equation = "(24) and (25)"
    zero_set = "nu = 0 with any q~ (the paper prints q~ = 0 as well, which is the invariant subset)"
    invariant = "q~ = 0, nu = 0: elsewhere K_P q~ sets the vehicle in motion"

    def value(self, s: LawSignals) -> sm.Expr:
        return _form(s.plant.nu, s.plant.M) / 2 + _form(s.error, s.K_P) / 2

    def derivative(self, s: LawSignals) -> sm.Expr:
        rate = s.plant.J * s.plant.nu
        return -_form(rate, s.K_V) - _form(s.plant.nu, s.plant.D)


class _PID(_PD):
    V = "nu' M nu/2 + q~' K_P q~/2 - iota q~' M_q q_dot + phi' K_I q~ + iota phi' K_I phi/2"
    V_dot = (
        "-q~' (iota K_P - K_I) q~ + iota q~' K q_dot - q_dot' (K - iota M_q) q_dot - iota q~' C_q' q_dot, "
        "K = K_V + D_q, phi_dot = q~"
    )
    equation = "half of the candidate after (33) with q for q - q_d and the integral of q - q_d for phi"
    zero_set = "q~ = 0, nu = 0 with any phi, where the conditions on V_dot hold"
    invariant = "q~ = 0, nu = 0, phi = 0: elsewhere K_I phi sets the vehicle in motion"

    def value(self, s: LawSignals) -> sm.Expr:
        momentum = s.plant.J_inverse.T * s.plant.M * s.plant.nu
        cross = -IOTA * (s.error.T * momentum)[0] + (s.states.T * s.K_I * s.error)[0]
        return super().value(s) + cross + IOTA * _form(s.states, s.K_I) / 2

    def derivative(self, s: LawSignals) -> sm.Expr:
        """As stated, of q_dot = J nu and q~ = J b: b' D nu is q~' D_q q_dot, and so on, in fewer terms."""
        plant = s.plant
        rate, body = plant.J * plant.nu, plant.J_inverse * s.error
        spring = _form(s.error, IOTA * s.K_P - s.K_I)
        motion = _form(rate, s.K_V) + _form(plant.nu, plant.D - IOTA * plant.M)
        swung = plant.C * body - plant.M * (plant.J_inverse * (plant.J_dot * body))  # J' C_q q~
        cross = (s.error.T * s.K_V * rate)[0] + (body.T * plant.D * plant.nu)[0] - (plant.nu.T * swung)[0]
        return -spring + IOTA * cross - motion


class _Sliding(Candidate):
    V = "S' S/2"
    V_dot = "-sum K_Z |S|"
    equation = "(38) and (39)"
    zero_set = "S = 0"
    invariant = (
        "S = 0 (an invariant set, not an initial condition); there q~_dot = -Lambda q~, so q~ = 0 in the end"
    )

    def value(self, s: LawSignals) -> sm.Expr:
        return _form(sliding_surface(s), sm.eye(len(s.error))) / 2

    def derivative(self, s: LawSignals) -> sm.Expr:
        return -sum((s.K_Z * sliding_surface(s).applyfunc(sm.Abs)), sm.Integer(0))


class _Layer(_Sliding):
    V_dot = "-sum K_Z |S| min(1, |S|/width)"
    equation = "(39), with a boundary layer"

    def derivative(self, s: LawSignals) -> sm.Expr:
        size = sliding_surface(s).applyfunc(sm.Abs)
        share = (s.width.inv() * size).applyfunc(lambda e: sm.Min(1, e))
        return -(size.T * s.K_Z * share)[0]


class _Twisting(_Sliding):
    V = "sum K_2 |S| + twist' twist/2"
    V_dot = "-sum K_1 K_2 sqrt|S|"
    equation = "none of the paper's"
    zero_set = "S = 0 with any twist"
    invariant = "S = 0, twist = 0: elsewhere S_dot = -twist leads away from S = 0"

    def value(self, s: LawSignals) -> sm.Expr:
        size = sliding_surface(s).applyfunc(sm.Abs)
        return sum(s.K_2 * size, sm.Integer(0)) + _form(s.states, sm.eye(len(s.states))) / 2

    def derivative(self, s: LawSignals) -> sm.Expr:
        root = sliding_surface(s).applyfunc(lambda e: sm.sqrt(sm.Abs(e)))
        return -sum(s.K_1 * s.K_2 * root, sm.Integer(0))


CANDIDATES: dict[str, Candidate] = {
    "pd": _PD(),
    "pid": _PID(),
    "sliding-mode": _Sliding(),
    "sliding-mode-boundary-layer": _Layer(),
    "super-twisting": _Twisting(),
}
"""The candidate of each law."""


def _form(x: sm.Matrix, matrix: sm.Matrix) -> sm.Expr:
    return (x.T * matrix * x)[0]


def along_the_loop(value: sm.Expr, law: Law, s: LawSignals) -> sm.Expr:
    """Derivative of an expression along the closed loop of a law that gets the force it asks for.

    The sign of a velocity that switches parameters counts as constant.
    """
    plant = s.plant
    rate = plant.J * plant.nu
    net = law.force(s) - (plant.C + plant.D) * plant.nu - plant.g
    rates = [
        *zip(plant.eta, rate, strict=True),
        *zip(s.error, -rate, strict=True),
        *zip(s.states, law.rates(s), strict=True),
        *zip(plant.nu, plant.M.LUsolve(net), strict=True),
    ]
    return sum((value.diff(x) * v for x, v in rates), sm.Integer(0))


def derivatives(plant: Plant, law: Law) -> tuple[sm.Expr, sm.Expr]:
    """The derivative of a law's candidate worked out from the model, and what it is said to be."""
    candidate, s = CANDIDATES[law.id], LawSignals(plant, law)
    return along_the_loop(candidate.value(s), law, s), candidate.derivative(s)


def compare(plant: Plant, law: Law) -> float:
    """Largest relative difference of the two with the numbers of the vehicle, in every sign set.

    Points are random, with random signs of pose, error and motion; gains are positive.
    """
    worked, stated = derivatives(in_numbers(plant), law)
    s = LawSignals(plant, law)
    names = sorted(worked.free_symbols | stated.free_symbols, key=str)
    function = function_of(names, [worked, stated])
    signed = {*plant.eta, *plant.nu, *s.error, *s.states}
    random, worst = Random(COMPARISON.seed), 0.0
    for way in _ways(plant):
        signs = {x: random.choice((-1.0, 1.0)) if x in signed else 1.0 for x in names} | way
        values = {x: signs[x] * random.uniform(0.2, 1.2) for x in names}
        values |= {_switch(v): sign for v, sign in way.items()}
        one, other = function(*(values[x] for x in names))
        worst = max(worst, abs(one - other) / max(abs(one), abs(other), 1e-12))
    return worst


def _ways(plant: Plant) -> list[dict[sm.Symbol, float]]:
    """Signs of the velocities that switch parameters: all of them, and some points at least."""
    ways = [
        dict(zip(plant.reversing, w, strict=True)) for w in product((1.0, -1.0), repeat=len(plant.reversing))
    ]
    return ways * max(1, -(-COMPARISON.points // len(ways)))


def _switch(velocity: sm.Symbol) -> sm.Symbol:
    """The sign of a velocity as a number of its own, so that it counts as constant."""
    return symbol(f"sign_{velocity}")


def lyapunov(plant: Plant, law: Law, equilibria: str) -> Lyapunov:
    """The candidate of a law with the comparison, and the equilibria of what is not pushed."""
    candidate = CANDIDATES[law.id]
    difference = compare(plant, law)
    agrees = "equal" if difference < COMPARISON.tolerance else "NOT equal"
    points = f"{len(_ways(plant))} random points, {difference:.0e} apart"
    return Lyapunov(
        candidate.V,
        candidate.V_dot,
        candidate.equation,
        f"{agrees} to V_dot worked out from the model ({points})",
        candidate.zero_set,
        equilibria or candidate.invariant,
    )


class _Filled:
    def __init__(self, plant: Plant, *values: Mapping[sm.Expr, sm.Expr]) -> None:
        self._plant, self._values = plant, values

    def __getattr__(self, name: str) -> sm.Matrix:
        found = getattr(self._plant, name)
        return (
            reduce(lambda m, v: m.xreplace(v), self._values, found) if hasattr(found, "xreplace") else found
        )


def filled(plant: Plant, *values: Mapping[sm.Expr, sm.Expr]) -> Plant:
    """A plant whose matrices have values put in for symbols, one mapping after another."""
    return cast(Plant, _Filled(plant, *values))


def in_numbers(plant: Plant) -> Plant:
    """A plant with numbers for the parameters, and symbols for the signs that switch them."""
    switches = {sm.sign(v): _switch(v) for v in plant.reversing}
    return filled(plant, switches, plant.numbers)


def equilibria_without_thrust(plant: Plant, law: Law) -> str:
    """Where the loop comes to rest beside the set-point because no thruster pushes, or nothing.

    At rest the force beyond weight is J' w with w = K_P q~ (and K_I phi); it is zero in every pushed axis for
    w along J^-T times the axes that nothing pushes.
    """
    if not plant.unactuated:
        return ""
    dofs, coordinates = plant.vehicle.degrees_of_freedom, plant.vehicle.pose_names
    lacking = ", ".join(dofs[i] for i in plant.unactuated)
    if "K_P" not in [g.name for g in type(law).gains]:
        return f"not only S = 0: nothing drives S to zero along {lacking}, which no thruster pushes"
    lines = []
    for column in (plant.J_inverse.T[:, i] for i in plant.unactuated):
        parts = ", ".join(f"{c}: {v}" for c, v in zip(coordinates, column, strict=True) if v != 0)
        lines.append(f"({parts})")
    return (
        f"not only q~ = 0: at rest with K_P q~ along {' and '.join(lines)} nothing moves, because no "
        f"thruster acts in {lacking}; that error is never corrected"
    )
