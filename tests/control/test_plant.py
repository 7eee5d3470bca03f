"""Matrices of a plant against the sum of the effects, and the laws on them."""

from __future__ import annotations

import pytest
import sympy as sm

from tests.quick import quick_if
from undertow.control.gains import bundled_gains, load_gains
from undertow.control.laws import LAWS, LawSignals
from undertow.control.plant import Plant
from undertow.model.catalogue import catalogue
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.symbols import symbol
from undertow.model.vehicle import Value, Vehicle

VEHICLES = sorted(bundled_vehicles())
QUICK = ("box-hull", "cybership2", "kvlcc2", "mini-auv")  # one, three and four degrees of freedom; a rudder
SIX = ("surge", "sway", "heave", "roll", "pitch", "yaw")


def at_a_point(expression: sm.Matrix) -> sm.Matrix:
    """Numbers for every symbol, other ones for each, so that an identity holds by no accident."""
    symbols = sorted(expression.free_symbols, key=str)
    return expression.subs({x: sm.Rational(3 * i + 2, 7 * i + 5) for i, x in enumerate(symbols)})


def as_stated(plant: Plant) -> sm.Matrix:
    """Sum of the wrenches of the effects, without parameters that the file does not mention."""
    vehicle = plant.vehicle
    absent = {n for n in vehicle.parameter_names if n not in vehicle.values and not vehicle.value_of(n).value}
    wrenches = vehicle.composition.wrenches.items()
    kept = sum((w for e, w in wrenches if e.id not in plant.left_out), sm.zeros(len(plant.nu), 1))
    return kept.xreplace({symbol(n): sm.Integer(0) for n in absent})


@pytest.mark.parametrize("name", quick_if(QUICK.__contains__, VEHICLES))
def test_matrices_add_up_to_the_effects(name: str) -> None:
    plant = Plant(load_vehicle(name))
    nu_dot = plant.vehicle.composition.nu_dot
    total = -plant.M * nu_dot - (plant.C + plant.D) * plant.nu - plant.g + plant.B * plant.inputs
    # Rudders and propellers: forces that depend on commands and on the motion together.
    assert set(plant.left_out) <= {"rudder_force", "rudder", "propellers"}
    difference = at_a_point(total - as_stated(plant))
    assert max(abs(sm.N(e)) for e in difference) < sm.Float("1e-12")


@pytest.mark.parametrize("name", quick_if(QUICK.__contains__, VEHICLES))
def test_power_balances(name: str) -> None:
    """C is skew, and d(M_q)/dt - 2 C_q is skew in pose coordinates."""
    plant = Plant(load_vehicle(name))
    assert (plant.C + plant.C.T).applyfunc(sm.expand) == sm.zeros(*plant.C.shape)
    if len(plant.nu) == 6:
        return  # the inverse of six Euler angles takes long; the identity is the one of four
    q_dot, back = plant.vehicle.composition.pose_rate, plant.J_inverse
    M_q = back.T * plant.M * back
    C_q = back.T * (plant.C - plant.M * back * plant.J_dot) * back
    rate = sum((M_q.diff(q) * v for q, v in zip(plant.eta, q_dot, strict=True)), sm.zeros(*plant.M.shape))
    balance = rate - 2 * C_q
    assert max(abs(sm.N(e)) for e in at_a_point(balance + balance.T)) < sm.Float("1e-12")


@pytest.mark.parametrize("cls", [c for i, c in catalogue().items() if not c.built_in], ids=lambda c: c.id)
def test_every_effect_has_a_place_or_a_reason(cls: type) -> None:
    """What is in the matrices is the whole effect; what is not is named."""
    needed = [catalogue()[i](("f1", "f2")) for i in cls.requires if i != "thrusters"]
    effect = cls(("f1", "f2"))
    from undertow.model.vehicle import Thruster

    pods = tuple(Thruster(n, (1.0, 0, 0, 0, 0, y)) for n, y in (("f1", -0.2), ("f2", 0.2)))
    names = {p.name: Value(p.effective_default or 0.3) for e in (*needed, effect) for p in e.parameters}
    vehicle = Vehicle("with one effect", SIX, (*needed, effect), names, pods)
    plant = Plant(vehicle)
    if effect.id in plant.left_out:
        return
    nu_dot = vehicle.composition.nu_dot
    total = -plant.M * nu_dot - (plant.C + plant.D) * plant.nu - plant.g + plant.B * plant.inputs
    difference = at_a_point(total - as_stated(plant))
    assert max(abs(sm.N(e)) for e in difference) < sm.Float("1e-9")


# --- laws ---
@pytest.mark.parametrize("law_id", [i for i in LAWS if "sliding" in i or "twist" in i])
def test_sliding_laws_give_the_surface_the_rate_they_declare(law_id: str) -> None:
    plant = Plant(load_vehicle("mini-auv"))
    law = LAWS[law_id]()
    s = LawSignals(plant, law)
    driven = plant.M.inv() * (law.force(s) - (plant.C + plant.D) * plant.nu - plant.g)
    moving = -plant.J_dot * plant.nu - plant.J * driven - s.Lambda * plant.J * plant.nu
    difference = at_a_point((moving + law.reaching_rate(s)).xreplace(plant.numbers))
    assert max(abs(sm.N(e)) for e in difference) < 1e-12


def test_pd_and_pid_keep_the_weight_and_nothing_else_at_the_set_point() -> None:
    for name in ("paper-pd", "paper-pid"):
        gains = load_gains(name, load_vehicle("mini-auv"))
        s = gains.signals
        rest = dict.fromkeys([*s.error, *s.states, *s.plant.nu], sm.Integer(0))
        assert gains.law.force(s).xreplace(rest) == s.plant.g


def test_bundled_gains_are_table_5() -> None:
    vehicle = load_vehicle("mini-auv")
    pid, smc = load_gains("paper-pid", vehicle), load_gains("paper-smc", vehicle)
    assert pid.matrix("K_I") == sm.diag(0.0003, 0.0003, 0.0005, 0.00005)
    assert pid.matrix("K_V") == sm.diag(0.005, 0.005, 3.0, 0.5)
    assert smc.matrix("Lambda") == sm.diag(0.7, 0.7, 0.07, 0.15)
    assert set(bundled_gains()) == {"paper-pd", "paper-pid", "paper-smc"}
