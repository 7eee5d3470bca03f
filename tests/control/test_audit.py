"""What the audit finds in the equations of the paper and of vehicles, and not in sound ones."""

from __future__ import annotations

from dataclasses import replace

import pytest
import sympy as sm

from tests.quick import first_quick
from undertow.control.conditions.by_law import CONDITIONS
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.vehicle import Value, Vehicle
from undertow.paper import equations
from undertow.paper.equations import audit_paper, audit_vehicle


def wrong(vehicle: Vehicle) -> list[str]:
    return [f.where for f in audit_vehicle(vehicle) if f.kind == "wrong"]


def test_every_erratum_of_the_equations_is_found() -> None:
    found = {(f.where, f.text): f.evidence for f in audit_paper()}
    words = {
        "C_q has the wrong sign": "-J M_a J_dot'",
        "d(M_q)/dt - 2 C_q is not skew-symmetric, so energy comes from nowhere in turns": "-1.914966",
        "even with the sign of (11) fixed, (8) is not (9) in the inertial frame": "(-m*r*v, m*r*u, 0, 0)",
        "the Munk moment is absent from both, and the Coriolis forces from (9)": "-u*v*(X_udot - Y_vdot)",
        "the units of K_V > M do not fit": "K_V is in kg/s, M in kg",
        "Y_vdot, Y_v are in the matrices, but the paper prints no value": "assumed",
    }
    for text, evidence in words.items():
        (shown,) = [e for (_, t), e in found.items() if t == text]
        assert evidence in shown
    assert len(found) == 9


def test_a_paper_with_the_sign_fixed_and_the_mass_added_is_not_blamed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """C_q = J M_gamma J_dot' instead of (11): what is left are the Munk moment and the text."""

    def right(self: equations._Equations) -> sm.Matrix:
        return self.plant.J * self.mass * self.J_rate.T

    monkeypatch.setattr(equations._Equations, "printed", property(right))
    found = equations._Equations()
    assert [*found.coriolis_sign(), *found.power()] == []
    # Of (8) with this matrix and the sign turned as the audit does, the difference is twice the term.
    assert len(list(found.frames())) == 1


def test_units_of_derived_and_mended_conditions_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    printed = [c for c in CONDITIONS["pid"] if c.form == "printed"]
    assert len(list(equations.condition_units())) == 3
    from undertow.control.conditions.by_law import Quantities
    from undertow.model.symbols import symbol

    units = {"K_P": "N/m", "K_V": "N s/m", "K_I": "N/(m s)", "M": "kg", "D": "kg/s", "iota": "1/s"}
    s = Quantities({n: symbol(n) for n in units})
    by_symbol = {symbol(n): u for n, u in units.items()}
    for condition in CONDITIONS["pid"]:
        if condition not in printed and condition.id != "V_dot":
            # Private: the audit itself speaks of what does not fit only.
            assert equations._mismatch(condition.left(s), condition.right(s), by_symbol) == "", (
                condition.statement
            )


@pytest.mark.parametrize("name", first_quick(sorted(set(bundled_vehicles()) - {"cybership2"}), 3))
def test_nothing_is_wrong_in_bundled_vehicles(name: str) -> None:
    assert wrong(load_vehicle(name)) == []


def test_identified_damping_that_feeds_energy_is_found() -> None:
    """The couplings of the published CyberShip II are larger than its damping of sway and yaw allows."""
    (found,) = [f for f in audit_vehicle(load_vehicle("cybership2")) if f.kind == "wrong"]
    assert found.where == "D"
    assert "v = " in found.evidence
    assert "r = " in found.evidence


def test_what_a_vehicle_lacks_is_open() -> None:
    vehicle = load_vehicle("mini-auv")
    bare = replace(vehicle, effects=tuple(e for e in vehicle.effects if "coriolis" not in e.id))
    reported = [f.text for f in audit_vehicle(bare) if f.kind == "open"]
    assert sum("_coriolis is absent although the vehicle turns" in t for t in reported) == 2
    assert any("Y_vdot" in t for t in reported)


def test_an_effect_that_feeds_energy_in_is_found() -> None:
    vehicle = load_vehicle("mini-auv")
    broken = vehicle.with_values({"X_uabsu_forward": Value(50.0)})
    assert "quadratic_damping" in wrong(broken)


def test_the_largest_ships_are_not_accused_of_rounding() -> None:
    """Coriolis forces of 3e10 kg are powers that cancel to microwatts."""
    vehicle = load_vehicle("kvlcc2")
    inertial = [n for n in vehicle.parameter_names if n.endswith("dot") or n in ("m", "I_z")]
    larger = vehicle.with_values({n: Value(1e7 * vehicle.value_of(n).value) for n in inertial})
    assert wrong(larger) == wrong(vehicle) == []
