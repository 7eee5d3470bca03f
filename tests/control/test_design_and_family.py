"""Quadratic designs and families of uncertain vehicles."""

from __future__ import annotations

from pathlib import Path

import control as ct
import numpy as np
import pytest

from undertow.control import close_loop, family, find_trim, linearize, lqg, lqr
from undertow.control.gains import GainSet, load_gains
from undertow.control.linear.analysis import modes
from undertow.control.linear.family import SETTINGS, spread_of
from undertow.control.linear.report import analyse
from undertow.errors import UndertowError
from undertow.model.effects.actuation_delay import ActuationDelay
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.vehicle import Value, Vehicle

ERROR = {"x": 0.5, "z": 0.2, "psi": 0.2}
FORCE = {"surge": 1.0, "heave": 2.0, "yaw": 0.1}


@pytest.fixture(scope="module")
def auv() -> Vehicle:
    return load_vehicle("mini-auv")


# --- LQR ------------------------------------------------------------------------------------------
def test_lqr_of_one_mass_in_closed_form(auv: Vehicle) -> None:
    """Per channel the Riccati equation gives K_P = F/e and (K_V + D)^2 = D^2 + 2 M K_P."""
    design = lqr(auv, ERROR, FORCE)
    values = design.gains.values
    assert values["K_P_x"] == pytest.approx(1 / 0.5, rel=1e-5)
    mass, drag = 9.130825, 0.142306
    assert values["K_V_x"] == pytest.approx(np.sqrt(drag**2 + 2 * mass * 2.0) - drag, rel=1e-5)
    assert design.gains.unactuated == ("sway",)
    assert design.coupling < 1e-6
    assert design.certified is None
    assert all(m.stable for m in design.modes)


def test_lqr_with_an_integral_holds_a_coupled_vehicle() -> None:
    rov = load_vehicle("bluerov2")
    names = dict.fromkeys(rov.pose_names, 0.2), dict.fromkeys(rov.degrees_of_freedom, 5.0)
    design = lqr(rov, *names, law="pid")
    assert design.gains.law.id == "pid"
    assert 0.1 < design.coupling < 1.0  # roll with sway, pitch with surge: what a diagonal law leaves out
    assert max(m.pole.real for m in design.modes) < -0.1


def test_the_integral_is_slowed_until_the_conditions_hold(auv: Vehicle) -> None:
    asked: list[GainSet] = []

    def slow_enough(gains: GainSet) -> bool:
        asked.append(gains)
        return gains.values["K_I_x"] < 0.1

    design = lqr(auv, ERROR, FORCE, law="pid", conditions=slow_enough)
    assert design.certified
    assert design.slowed == len(asked) - 1 > 0
    integrals = [g.values["K_I_x"] for g in asked]
    assert integrals == sorted(integrals, reverse=True)
    assert integrals[-1] < 0.1 <= integrals[-2]
    with pytest.raises(UndertowError, match="meets the conditions"):
        lqr(auv, ERROR, FORCE, law="pid", conditions=lambda gains: False)


@pytest.mark.parametrize(
    ("error", "force", "law", "words"),
    [
        ({**ERROR, "x": 0.0}, FORCE, "pd", "error of x is 0"),
        ({**ERROR, "y": 1.0}, FORCE, "pd", "error of y has no effect"),
        (ERROR, {**FORCE, "surge": float("inf")}, "pd", "force of surge is inf"),
        (ERROR, FORCE, "sliding-mode", "has no quadratic design"),
    ],
)
def test_weights_that_cannot_be_are_refused(
    auv: Vehicle, error: dict[str, float], force: dict[str, float], law: str, words: str
) -> None:
    with pytest.raises(UndertowError, match=words):
        lqr(auv, error, force, law=law)


# --- LQG ------------------------------------------------------------------------------------------
def test_lqg_separates() -> None:
    """The poles of the loop are those of the feedback and those of the observer."""
    rov = load_vehicle("bluerov2")
    trim = find_trim(rov, {"u": 0.5})
    plant = linearize(rov, trim)
    weights = dict.fromkeys(plant.state_labels, 0.5)
    force = dict.fromkeys(plant.input_labels, 5.0)
    disturbance = dict.fromkeys(("u", "v", "w", "p", "q", "r"), 0.1)
    noise = dict.fromkeys(("x", "y", "z", "phi", "theta", "psi"), 0.01)
    law = lqg(rov, trim, weights, force, disturbance, noise)
    assert law.input_labels == list(noise)
    assert law.output_labels == plant.input_labels
    seen = plant.C[:6]
    whole = np.block([[plant.A, plant.B @ law.C], [law.B @ seen, law.A]])
    gain, observer = -law.C, law.B
    parts = [np.linalg.eigvals(plant.A - plant.B @ gain), np.linalg.eigvals(plant.A - observer @ seen)]
    assert max(p.real.max() for p in parts) < 0
    found, expected = (
        np.sort_complex(np.round(e, 5)) for e in (np.linalg.eigvals(whole), np.concatenate(parts))
    )
    np.testing.assert_allclose(found, expected, atol=1e-3)
    optimal = ct.lqr(plant.A, plant.B, np.eye(12) / 0.25, np.eye(8) / 25)[0]
    np.testing.assert_allclose(gain, optimal, rtol=1e-8, atol=1e-10)


def test_lqg_refuses_what_it_cannot_hold(auv: Vehicle) -> None:
    plant = linearize(auv, find_trim(auv))
    force = dict.fromkeys(plant.input_labels, 5.0)
    with pytest.raises(UndertowError, match="y, v are not controllable or not observable"):
        lqg(auv, find_trim(auv), {"x": 1.0}, force, {"u": 0.1}, dict.fromkeys(auv.pose_names, 0.1))
    with pytest.raises(UndertowError, match="'a' is not an output"):
        lqg(auv, find_trim(auv), {"x": 1.0}, force, {"u": 0.1}, {"a": 0.1})
    with pytest.raises(UndertowError, match="weight of 'surge', which is not a state"):
        lqg(auv, find_trim(auv), {"x": 1.0, "surge": 0.1}, force, {"u": 0.1}, {"x": 0.1})
    with pytest.raises(UndertowError, match=r"disturbance of u is -0\.1"):
        lqg(auv, find_trim(auv), {"x": 1.0}, force, {"u": -0.1}, {"x": 0.1})


# --- families -------------------------------------------------------------------------------------
@pytest.mark.slow
def test_members_of_a_family_have_the_dead_time_and_the_observer_of_the_loop(
    auv: Vehicle, tmp_path: Path
) -> None:
    """Commands 3 s late make the loop grow, and so its first member, which is the stated vehicle."""
    late = auv.with_effect(ActuationDelay, {"delay": Value(3.0)})
    sensors = "".join(f"[sensors.{c}]\nnoise = 0.01\n" for c in auv.pose_names)
    drive = "".join(f"{v} = 0.01\n" for v in auv.velocity_names)
    path = tmp_path / "filter.toml"
    path.write_text(f'schema = "undertow/observer/1"\nname = "f"\n{sensors}[disturbance]\n{drive}')
    found = analyse(late, gains="paper-pd", observer=path, pade=3, family_of=1, source="mini-auv")
    assert found.family is not None
    stated = found.family.members[0]
    assert not stated.stable
    np.testing.assert_allclose(
        [m.pole for m in stated.modes], [m.pole for m in found.modes], rtol=1e-6, atol=1e-9
    )


@pytest.mark.slow
def test_a_family_is_repeatable_and_spreads_as_stated(auv: Vehicle) -> None:
    one, same, other = (family(auv, {"u": 0.5}, 40, seed=s) for s in (3, 3, 4))
    draws = [m for m in one.members if m.name.startswith("draw")]
    assert len(draws) == 40
    assert [m.values for m in one.members] == [m.values for m in same.members]
    assert [m.values for m in one.members] != [m.values for m in other.members]
    thrust = np.array(
        [m.values["B_net"] for m in family(auv, {"u": 0.5}, 400, seed=1).members if "draw" in m.name]
    )
    assert thrust.std() == pytest.approx(0.41, rel=0.12)
    assert all(m.values["X_u_forward"] <= 0 for m in draws)  # drag never drives
    assert one.refused > 0


def test_corners_are_the_vehicle_with_one_value_moved(auv: Vehicle) -> None:
    found = family(auv, {"u": 0.5}, 0)
    corners = {m.name: m for m in found.members}
    assert found.members[0].name == "stated"
    assert not any("backward" in name for name in corners)  # it goes forward
    drag = corners[f"X_uabsu_forward - {SETTINGS.corner_distance:g} sigma"]
    (surge,) = [m.pole.real for m in drag.modes if m.states == ("u",)]
    slope = 0.142306 + 2 * (5.153776 + SETTINGS.corner_distance * 1.0) * 0.5
    assert surge == pytest.approx(-slope / 9.130825, rel=1e-9)
    slowest = [max(m.pole.real for m in corners[n].modes if m.pole) for n in corners]
    together = max(m.pole.real for m in corners["all together, slowest"].modes if m.pole)
    assert together == pytest.approx(max(slowest))


def test_a_loop_family_keeps_the_law(auv: Vehicle) -> None:
    gains = load_gains("paper-pd", auv)
    found = family(auv, find_trim(auv, direction={"u": -1}), 5, gains=gains)
    assert not found.unstable
    heavier = next(m for m in found.members if m.name == "X_udot_backward - 2 sigma")
    (surge,) = [m for m in heavier.modes if set(m.states) == {"x", "u"} and m.pole.imag]
    assert surge.frequency == pytest.approx(
        np.sqrt(0.2 / (9.432838 + SETTINGS.corner_distance * 0.28)), rel=1e-6
    )
    expected = close_loop(auv, gains, find_trim(auv, direction={"u": -1})).closed
    np.testing.assert_allclose(found.members[0].system.A, expected.A)


def test_the_covariance_of_the_last_fit_is_used(auv: Vehicle, tmp_path: Path) -> None:
    text = bundled_vehicles()["mini-auv"].read_text()
    history = """
[[history]]
command = "undertow fit"
[history.covariance]
parameters = ["N_r", "X_uabsu_forward"]
matrix = [[1e-6, 2e-4], [2e-4, 0.25]]
"""
    path = tmp_path / "fitted.toml"
    path.write_text(text + history)
    found = spread_of(load_vehicle(path), path)
    assert found.names[:2] == ("N_r", "X_uabsu_forward")
    np.testing.assert_allclose(found.covariance[:2, :2], [[1e-6, 2e-4], [2e-4, 0.25]])
    assert found.covariance[0, 2:].tolist() == [0.0] * (len(found.names) - 2)
    assert len(found.names) == len(spread_of(auv).names)
    assert "covariance of the last fit for 2" in found.source


def test_nothing_is_drawn_without_a_spread() -> None:
    with pytest.raises(UndertowError, match="no parameter of 'cybership2' has a standard deviation"):
        family(load_vehicle("cybership2"), {"u": 0.3}, 5)


def test_modes_of_the_stated_member_are_those_of_the_vehicle(auv: Vehicle) -> None:
    stated = family(auv, {"u": 0.5}, 0).members[0]
    own = [m.pole for m in modes(linearize(auv, {"u": 0.5}))]
    np.testing.assert_allclose([m.pole for m in stated.modes], own, rtol=1e-9, atol=1e-12)
