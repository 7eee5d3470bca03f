"""Verdicts over the uncertainty of parameters; the region of the local result; coupled axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from undertow.control.conditions.check import check
from undertow.control.conditions.problem import Problem
from undertow.control.conditions.region import region
from undertow.control.conditions.routh import coupled_roots
from undertow.control.conditions.speed import damping_at_speed
from undertow.control.conditions.uncertain import ALL, NOMINAL, SOME, Uncertainty
from undertow.control.gains import GainSet, load_gains
from undertow.control.plant import Plant
from undertow.model.history import last_covariance
from undertow.model.loading import load_vehicle
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


@pytest.mark.parametrize(
    ("k_v", "box"),
    [(0.05, NOMINAL), (0.095, SOME), (0.30, ALL)],
)
def test_routh_over_intervals_and_ellipsoid(k_v: float, box: str) -> None:
    """k_v > M k_i/k_p - X_u = 0.0859646 at the values of the file, plus what the deviations add to it."""
    gains, vehicle = surge(0.1, 0.01, k_v)
    found = check(gains, Uncertainty(vehicle), forms=["derived"])
    (row,) = [r for r in found.rows if (r.condition, r.scope, r.signs) == ("Routh", "x", "forward")]
    assert row.box is not None
    assert row.ellipsoid is not None
    assert (row.box.verdict, row.ellipsoid.verdict) == (box, box)
    if box == SOME:
        told = row.box.counterexample
        inertia, drag = 7.5 + told["X_udot_forward"], told["X_u_forward"]
        assert (k_v + drag) * 0.012 < inertia * 0.0003
        assert told["X_udot_forward"] == pytest.approx(1.630825 + 1.959964 * 0.1, rel=1e-6)


def test_ellipsoid_is_exact_where_the_margin_is_linear() -> None:
    """Support function: margin - sqrt(chi2) * sqrt(c' Sigma c) changes its sign at the verdict."""
    reach = 2.4477468306808161  # root of the 95 % quantile of chi-square with 2 degrees of freedom
    for share, verdict in ((0.98, SOME), (1.02, ALL)):
        spread = np.hypot(0.012 * 0.01, 0.0003 * 0.1) * reach
        k_v = 0.0859646 + share * spread / 0.012
        gains, vehicle = surge(0.1, 0.01, k_v)
        found = check(gains, Uncertainty(vehicle), forms=["derived"])
        (row,) = [r for r in found.rows if (r.condition, r.scope, r.signs) == ("Routh", "x", "forward")]
        assert row.ellipsoid is not None
        assert row.ellipsoid.verdict == verdict


def test_correlation_of_a_fit_counts() -> None:
    """The margin falls with mass and rises with drag: errors that go together cancel in it."""
    verdicts = {}
    for correlation in (-0.99, 0.99):
        gains, vehicle = surge(0.1, 0.01, 0.0859646 + 0.030)
        names = ["X_udot_forward", "X_u_forward"]
        covariance = [[0.01, correlation * 0.001], [correlation * 0.001, 0.0001]]
        fit = {"covariance": {"parameters": names, "matrix": covariance}}
        known = Uncertainty(vehicle, covariance=last_covariance([fit], vehicle))
        found = check(gains, known, forms=["derived"])
        (row,) = [r for r in found.rows if (r.condition, r.scope, r.signs) == ("Routh", "x", "forward")]
        assert row.ellipsoid is not None
        verdicts[correlation] = row.ellipsoid.verdict
    assert verdicts == {-0.99: SOME, 0.99: ALL}


# --- region, coupled axes ---------------------------------------------------------------------------
def test_region_of_the_local_result_is_the_closed_form_of_a_level_vehicle() -> None:
    """|q~_psi| < 2 sqrt(s_x s_y)/(iota |m_x - m_y|) with s the Schur complements of surge and sway."""
    gains = load_gains("paper-pid", load_vehicle("mini-auv"))
    better = {
        **gains.values,
        **{f"K_P_{c}": 5.0 for c in "xyz"},
        "K_P_psi": 0.1,
        **{f"K_V_{c}": 4.0 for c in "xy"},
    }
    problem = Problem(replace(gains, values=better))
    iota = 0.05
    found = region(problem, (iota, iota))
    limits = []
    for inertia, damping in ((9.130825, 0.142306), (9.432838, 0.091036)):
        left = []
        for m, d in ((inertia, damping), (10.088308, 7.157339)):
            K = 4.0 + d
            left.append(K - iota * m - (iota * K / 2) ** 2 / (iota * 5.0 - 0.0003))
        limits.append(2 * np.sqrt(left[0] * left[1]) / (iota * abs(inertia - 10.088308)))
    assert found.angle == pytest.approx(min(limits), rel=1e-6)
    assert found.level is not None
    spring = 0.1 - 0.00005 / iota - iota**2 * 0.2750417
    assert found.level == pytest.approx(spring * min(found.angle, np.pi) ** 2 / 2, rel=1e-6)


def test_coupled_axes_are_judged_together() -> None:
    vehicle = load_vehicle("cybership2")
    plant = Plant(vehicle)
    n = len(plant.nu)
    gains = {"K_P": np.full(n, 5.0), "K_V": np.full(n, 20.0)}
    zero = Value(0.0)
    assert vehicle.value_of("m").value > zero.value
    from undertow.control.conditions.case import sign_sets

    one = sign_sets(plant)[0]
    found = coupled_roots(gains, one.inertia, one.damping, plant)
    for root in found:
        matrix = one.inertia * root**2 + (np.diag(gains["K_V"]) + one.damping) * root + np.diag(gains["K_P"])
        assert abs(np.linalg.det(matrix)) < 1e-6 * abs(np.linalg.det(one.inertia)) * max(1, abs(root)) ** (
            2 * n
        )


def test_damping_at_speed_is_proved_or_refuted() -> None:
    vehicle = load_vehicle("mini-auv")
    assert damping_at_speed(Problem(load_gains("paper-pd", vehicle))).startswith("never less")
    odd = vehicle.with_values({"X_uabsu_backward": Value(5.0)})
    assert "u = -" in damping_at_speed(Problem(load_gains("paper-pd", odd)))
