"""Verdicts over the uncertainty of parameters; the region of the local result; coupled axes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
import sympy as sm

from tests.control.test_lyapunov import closed_loop_derivative
from tests.quick import first_quick
from undertow.control.conditions.by_law import CANDIDATES, IOTA, numeric_plant
from undertow.control.conditions.channels import coupled, coupled_roots, zero_dynamics
from undertow.control.conditions.full_loop import certify
from undertow.control.conditions.problem import ALL, NOMINAL, SOME, Problem, Uncertainty
from undertow.control.conditions.region import region
from undertow.control.gains import GainSet, GainTable, ScheduleTable, gains_from_table, load_gains
from undertow.control.laws import LawSignals
from undertow.control.linear.systems import close_loop
from undertow.control.plant import Plant
from undertow.model.loading import last_covariance, load_vehicle
from undertow.model.symbols import symbol
from undertow.model.vehicle import Value, Vehicle


# --- uncertainty ------------------------------------------------------------------------------------
def surge(sigma_mass: float, sigma_drag: float, k_v: float) -> tuple[GainSet, Vehicle]:
    vehicle = load_vehicle("mini-auv")
    values = {
        f"X_udot_{w}": replace(vehicle.values[f"X_udot_{w}"], sigma=sigma_mass)
        for w in ("forward", "backward")
    } | {f"X_u_{w}": replace(vehicle.values[f"X_u_{w}"], sigma=sigma_drag) for w in ("forward", "backward")}
    known = {n: replace(v, sigma=None) for n, v in vehicle.values.items()}
    vehicle = vehicle.with_values(known | values)
    gains = load_gains("paper-pid", vehicle)
    return replace(gains, values={**gains.values, "K_V_x": k_v, "K_V_y": k_v}), vehicle


@pytest.mark.parametrize(("k_v", "box"), first_quick([(0.05, NOMINAL), (0.095, SOME), (0.30, ALL)]))
def test_routh_over_intervals_and_ellipsoid(k_v: float, box: str) -> None:
    """k_v > M k_i/k_p - X_u = 0.0859646 at the values of the file, plus what the deviations add to it."""
    gains, vehicle = surge(0.1, 0.01, k_v)
    found = certify(gains, Uncertainty(vehicle), forms=["derived"])
    (row,) = [r for r in found.rows if (r.condition, r.scope, r.signs) == ("Routh", "x", "forward")]
    assert row.box is not None
    assert row.ellipsoid is not None
    assert (row.box.verdict, row.ellipsoid.verdict) == (box, box)
    if box == SOME:
        reported = row.box.counterexample
        inertia, drag = 7.5 + reported["X_udot_forward"], reported["X_u_forward"]
        assert (k_v + drag) * 0.012 < inertia * 0.0003
        assert reported["X_udot_forward"] == pytest.approx(1.630825 + 1.959964 * 0.1, rel=1e-6)


@pytest.mark.slow
def test_ellipsoid_is_exact_where_the_margin_is_linear() -> None:
    """Support function: margin - sqrt(chi2) * sqrt(c' Sigma c) changes its sign at the verdict."""
    reach = 2.4477468306808161  # root of the 95% quantile of chi-square with 2 degrees of freedom
    for share, verdict in ((0.98, SOME), (1.02, ALL)):
        spread = np.hypot(0.012 * 0.01, 0.0003 * 0.1) * reach
        k_v = 0.0859646 + share * spread / 0.012
        gains, vehicle = surge(0.1, 0.01, k_v)
        found = certify(gains, Uncertainty(vehicle), forms=["derived"])
        (row,) = [r for r in found.rows if (r.condition, r.scope, r.signs) == ("Routh", "x", "forward")]
        assert row.ellipsoid is not None
        assert row.ellipsoid.verdict == verdict


@pytest.mark.slow
def test_correlation_of_a_fit_counts() -> None:
    """The margin falls with mass and rises with drag: errors that go together cancel in it."""
    verdicts = {}
    for correlation in (-0.99, 0.99):
        gains, vehicle = surge(0.1, 0.01, 0.0859646 + 0.030)
        names = ["X_udot_forward", "X_u_forward"]
        covariance = [[0.01, correlation * 0.001], [correlation * 0.001, 0.0001]]
        fit = {"covariance": {"parameters": names, "matrix": covariance}}
        known = Uncertainty(vehicle, covariance=last_covariance([fit], vehicle))
        found = certify(gains, known, forms=["derived"])
        (row,) = [r for r in found.rows if (r.condition, r.scope, r.signs) == ("Routh", "x", "forward")]
        assert row.ellipsoid is not None
        verdicts[correlation] = row.ellipsoid.verdict
    assert verdicts == {-0.99: SOME, 0.99: ALL}


# --- region, coupled axes ---------------------------------------------------------------------------
def thick_water(gains: dict[str, float], drag: float) -> Problem:
    """PID gains on the mini-AUV with this quadratic damping of surge, kg/m, all axes driven together."""
    vehicle = load_vehicle("mini-auv")
    changed = {f"X_uabsu_{way}": Value(-drag) for way in ("forward", "backward")}
    found = load_gains("paper-pid", vehicle.with_values(changed))
    return Problem(replace(found, values={**found.values, **gains}, schedule=ScheduleTable()))


STRONG = {
    **{f"K_P_{c}": 1.0 for c in "xyz"},
    **{f"K_I_{c}": 0.05 for c in "xyz"},
    **{f"K_V_{c}": 3.5 for c in "xyz"},
    **{"K_P_psi": 10.0, "K_V_psi": 5.0},
}


def loop_of(problem: Problem, iota: float) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
    """V and V_dot by (psi, error, integral, nu), worked out from the model; all parameters forward."""
    law = problem.gains.law
    s = LawSignals(numeric_plant(problem.plant), law)
    value = CANDIDATES["pid"].value(s)
    numbers = {**problem.gains.numbers, IOTA: sm.Float(iota)}
    numbers |= {symbol(f"sign_{v}"): sm.Integer(1) for v in problem.plant.nu}
    pair = [e.xreplace(numbers) for e in (value, closed_loop_derivative(value, law, s))]
    names = [symbol("psi"), *s.error, *s.states, *s.plant.nu]
    return cast("Callable[..., tuple[np.ndarray, np.ndarray]]", sm.lambdify(names, pair, "numpy", cse=True))


def test_states_beyond_the_damping_of_the_region_rise() -> None:
    """What the level is for: with thick water V_dot is positive at a state that damping at rest allows."""
    of = loop_of(thick_water(STRONG, 50.0), 0.11576)
    state = dict.fromkeys(range(12), 0.0) | {0: 8.5, 4: -8.5 / 0.11576, 8: 0.8}
    height, fall = of(0.0, *state.values())
    assert fall > 0
    assert height < 49


def test_coupled_axes_are_judged_together() -> None:
    vehicle = load_vehicle("cybership2")
    plant = Plant(vehicle)
    n = len(plant.nu)
    gains = {"K_P": np.full(n, 5.0), "K_V": np.full(n, 20.0)}
    zero = Value(0.0)
    assert vehicle.value_of("m").value > zero.value
    from undertow.control.conditions.problem import sign_sets

    one = sign_sets(plant)[0]
    found = coupled_roots(gains, one.inertia, one.damping, np.eye(n), np.zeros((n, n)))
    for root in found:
        matrix = one.inertia * root**2 + (np.diag(gains["K_V"]) + one.damping) * root + np.diag(gains["K_P"])
        assert abs(np.linalg.det(matrix)) < 1e-6 * abs(np.linalg.det(one.inertia)) * max(1, abs(root)) ** (
            2 * n
        )


def pitch_left_alone(size: float = 1.0) -> GainSet:
    """BlueROV2 with six thrusters, whose level ones pitch it by their arm; weight under the origin."""
    vehicle = load_vehicle("bluerov2-6").with_values({"mz_g": Value(0.23)})
    sizes = {"x": 20.0, "y": 20.0, "z": 20.0, "phi": 5.0, "psi": 5.0}
    table = {
        "schema": "undertow/gains/1",
        "name": "pitch alone",
        "law": "pd",
        "unactuated": ["pitch"],
        "gains": {gain: {c: size * v for c, v in sizes.items()} for gain in ("K_P", "K_V")},
    }
    return gains_from_table(GainTable.model_validate(table), vehicle)


def test_roots_of_coupled_axes_contain_what_weight_and_thrust_do_to_an_axis_left_alone() -> None:
    """They are the poles of the linear loop that the equations of motion themselves give."""
    gains = pitch_left_alone()
    (found,) = coupled(Problem(gains)).values()
    poles = np.linalg.eigvals(close_loop(gains.plant.vehicle, gains).closed.A)
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(poles), rtol=1e-6, atol=1e-9)
    assert max(abs(root.imag) for root in found) > 6  # pitch swings; without its weight it would not


def test_zero_dynamics_are_what_ever_larger_gains_lead_to() -> None:
    gains = pitch_left_alone(1e7)
    alone = zero_dynamics(gains)
    assert alone is not None
    poles = np.linalg.eigvals(close_loop(gains.plant.vehicle, gains).closed.A)
    near = [poles[np.argmin(np.abs(poles - p))] for p in alone.poles]
    np.testing.assert_allclose(alone.poles, near, rtol=1e-4)


def test_damping_that_turns_into_its_opposite_limits_the_region() -> None:
    """Backward X_|u|u > 0 feeds power in: K_V + X_u is outweighed at |u| = (K_V + X_u)/X_|u|u."""
    vehicle = load_vehicle("mini-auv")
    gains = load_gains("paper-pd", vehicle)
    assert region(Problem(gains), True).kind == "everywhere"
    odd = load_gains("paper-pd", vehicle.with_values({"X_uabsu_backward": Value(5.0)}))
    found = region(Problem(odd), True)
    assert found.kind == "level"
    damping = gains.values["K_V_x"] - vehicle.value_of("X_u_backward").value
    assert 0.9 * damping / 5.0 < found.speeds["u"] < damping / 5.0
