"""Derivatives of the Lyapunov functions along the closed loop, proved symbolically."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest
import sympy as sm

from tests.quick import first_quick
from undertow.control.conditions.by_law import (
    CANDIDATES,
    IOTA,
    derivative_difference,
    derivative_parts,
    equilibria_without_thrust,
    substituted,
)
from undertow.control.laws import LAWS, Law, LawSignals, sliding_surface
from undertow.control.plant import Plant
from undertow.model.loading import load_vehicle
from undertow.model.symbols import symbol

PSI = symbol("psi")
CORIOLIS = ("rigid_body_coriolis", "added_mass_coriolis")


@cache
def plant(*without: str) -> Plant:
    vehicle = load_vehicle("mini-auv")
    return Plant(replace(vehicle, effects=tuple(e for e in vehicle.effects if e.id not in without)))


def one_direction(p: Plant) -> Plant:
    """A plant with every switched parameter at its forward value."""
    return substituted(p, {sm.sign(v): sm.Integer(1) for v in p.reversing})


def closed_loop_derivative(value: sm.Expr, law: Law, s: LawSignals) -> sm.Expr:
    """Derivative of an expression along the closed loop of a law that gets the force it asks for."""
    moved, slope, net = derivative_parts(value, law, s)
    return moved + (slope * s.plant.M.LUsolve(net))[0]


def derivatives(plant: Plant, law: Law) -> tuple[sm.Expr, sm.Expr]:
    """The derivative of a law's candidate worked out from the model, and what it is said to be."""
    candidate, s = CANDIDATES[law.id], LawSignals(plant, law)
    return closed_loop_derivative(candidate.value(s), law, s), candidate.derivative(s)


def assert_zero(expression: sm.Expr) -> None:
    """With s = sin and c = cos it is a polynomial (over inertias) that vanishes where s^2 = 1 - c^2."""
    s, c = sm.symbols("s c")
    numerator = sm.fraction(sm.together(expression.xreplace({sm.sin(PSI): s, sm.cos(PSI): c})))[0]
    assert sm.expand(sm.rem(sm.Poly(sm.expand(numerator), s), sm.Poly(s**2 + c**2 - 1, s)).as_expr()) == 0


@pytest.mark.parametrize("without", [(), CORIOLIS], ids=["with Coriolis", "model (9)"])
def test_25_follows_from_24(without: tuple[str, ...]) -> None:
    worked, stated = derivatives(one_direction(plant(*without)), LAWS["pd"]())
    assert_zero(worked - stated)
    assert stated != 0


def test_24_and_25_are_those_of_the_paper() -> None:
    s = LawSignals(plant(), LAWS["pd"]())
    nu, J = s.plant.nu, s.plant.J
    candidate = CANDIDATES["pd"]
    assert candidate.value(s) == sm.Rational(1, 2) * (
        (nu.T * s.plant.M * nu)[0] + (s.error.T * s.K_P * s.error)[0]
    )
    printed = -(nu.T * J.T * s.K_V * J * nu)[0] - (nu.T * s.plant.D * nu)[0]
    assert_zero(candidate.derivative(s) - printed)


@pytest.mark.parametrize("without", [(), CORIOLIS], ids=["with Coriolis", "model (9)"])
def test_derivative_of_the_pid_candidate(without: tuple[str, ...]) -> None:
    """In numbers for the parameters, so that every coefficient is a polynomial in motion and gains."""
    p = plant(*without)
    worked, stated = derivatives(one_direction(p), LAWS["pid"]())
    numbers = {x: sm.Rational(7 * k + 3, 5 * k + 4) for k, x in enumerate(sorted(p.numbers, key=str))}
    assert_zero(sm.expand((worked - stated).xreplace(numbers)))


def test_pid_candidate_is_half_of_the_one_printed_after_33() -> None:
    """[kappa, q, phi] with q - q_d = -q~ and phi the integral of that."""
    s = LawSignals(plant(CORIOLIS[0], CORIOLIS[1]), LAWS["pid"]())
    n, p = 4, s.plant
    M_q = p.J * p.M * p.J.T
    kappa = M_q * p.J * p.nu
    x = sm.Matrix([*kappa, *(-s.error), *(-s.states)])
    M_inverse = p.J * p.M.inv() * p.J.T
    zero, one = sm.zeros(n), sm.eye(n)
    rows = [[M_inverse, IOTA * one, zero], [IOTA * one, s.K_P, s.K_I], [zero, s.K_I, IOTA * s.K_I]]
    printed = (x.T * sm.Matrix(sm.BlockMatrix(rows).as_explicit()) * x)[0]
    numbers = {v: sm.Rational(k + 2, k + 5) for k, v in enumerate(sorted(p.numbers, key=str))}
    forward = {sm.sign(v): sm.Integer(1) for v in p.nu}
    difference = (printed - 2 * CANDIDATES["pid"].value(s)).xreplace(forward).xreplace(numbers)
    assert_zero(sm.expand(difference))


def _with_symbols(surface: sm.Matrix) -> dict[sm.Expr, sm.Expr]:
    """One symbol for the sign of each entry, also where SymPy keeps it as that of minus the entry."""
    found = {}
    for i, e in enumerate(surface):
        own = symbol(f"sign_{i}")
        found |= {sm.sign(e): own, sm.sign(-e): -own, sm.Abs(e): own * e}
    return found


@pytest.mark.parametrize("law_id", ["sliding-mode", "super-twisting"])
def test_39_with_38_and_the_super_twisting_function(law_id: str) -> None:
    worked, stated = derivatives(one_direction(plant()), LAWS[law_id]())
    s = LawSignals(plant(), LAWS[law_id]())
    surface = sliding_surface(s)
    roots = {sm.sqrt(sm.Abs(e)): symbol(f"root_{i}") for i, e in enumerate(surface)}
    difference = (worked - stated).xreplace(roots).xreplace(_with_symbols(surface))
    for i in range(4):
        difference = sm.expand(difference).xreplace({symbol(f"sign_{i}") ** 2: sm.Integer(1)})
    assert not difference.atoms(sm.Derivative, sm.DiracDelta)
    assert_zero(difference)


@pytest.mark.parametrize("law_id", first_quick(LAWS, 3))
@pytest.mark.parametrize("vehicle", ["cybership2", "box-hull"])
def test_other_vehicles_at_random_points(law_id: str, vehicle: str) -> None:
    assert derivative_difference(Plant(load_vehicle(vehicle)), LAWS[law_id]()) < 1e-12


def test_the_comparison_sees_a_wrong_derivative(monkeypatch: pytest.MonkeyPatch) -> None:
    right = CANDIDATES["pd"].derivative
    monkeypatch.setattr(type(CANDIDATES["pd"]), "derivative", lambda self, s: 1.01 * right(s))
    assert derivative_difference(plant(), LAWS["pd"]()) > 1e-3


def test_the_comparison_sees_a_fault_of_backward_motion(monkeypatch: pytest.MonkeyPatch) -> None:
    """Damping that is right forward only: |u| taken for u."""
    right, u = CANDIDATES["pd"].derivative, symbol("u")
    monkeypatch.setattr(
        type(CANDIDATES["pd"]), "derivative", lambda self, s: right(s).xreplace({sm.Abs(u): u})
    )
    assert derivative_difference(plant(), LAWS["pd"]()) > 1e-3


def test_all_rest_states_have_v_dot_zero_but_only_the_set_point_stays() -> None:
    """LaSalle: the set of (25) is gamma = 0 with any error; its largest invariant subset is the origin."""
    law = LAWS["pd"]()
    s = LawSignals(plant(), law)
    rest = dict.fromkeys(s.plant.nu, sm.Integer(0))
    assert derivatives(plant(), law)[0].xreplace(rest) == 0
    net = (law.force(s) - s.plant.g).xreplace(rest)
    assert sm.simplify(net.jacobian(s.error).det()) == s.K_P.det()


def test_without_sway_thrust_a_line_of_errors_stays() -> None:
    law = LAWS["pd"]()
    s = LawSignals(plant(), law)
    reported = equilibria_without_thrust(plant(), law)
    assert "(x: -sin(psi), y: cos(psi))" in reported
    stuck = s.K_P.inv() * sm.Matrix([-sm.sin(PSI), sm.cos(PSI), 0, 0])
    rest = dict.fromkeys(s.plant.nu, sm.Integer(0)) | dict(zip(s.error, stuck, strict=True))
    net = (law.force(s) - s.plant.g).xreplace(rest).applyfunc(sm.trigsimp)
    assert [e == 0 for e in net] == [True, False, True, True]
