"""The paper's chain: exact values on its surge profile, every motion, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from tests.identification.surge import INTERVAL, M_X, TRUTH, surge_vehicle
from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import t_values
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import VehicleTable, load_vehicle, vehicle_from_table
from undertow.model.vehicle import Value, Vehicle
from undertow.paper.least_squares import Estimation, combined, estimate, experiments, selected
from undertow.paper.regression import CASES, Smoother, chosen_cases

Array = NDArray[np.float64]
_STEP = 0.01


def force_p(t: Array) -> Array:
    """Profile P, N: the jumps belong to the earlier level."""
    return np.select([t <= 0.65, t <= 18.45, t <= 21.95], [0.0, 0.32, -0.48], 0.22)


def drag(u: Array | float) -> Array | float:
    return TRUTH["X_u"] * u + TRUTH["X_uabsu"] * np.abs(u) * u


def profile_p(dt: float, sign: float = 1.0) -> Run:
    """Profile P without noise, by the classical Runge-Kutta method at 0.01 s, with the true acceleration."""
    count = round(30.0 / _STEP)
    u = np.zeros(count + 1)
    middle = (np.arange(count) + 0.5) * _STEP
    for i, force in enumerate(force_p(middle)):
        rate = lambda v, force=force: (force - drag(v)) / M_X  # noqa: E731
        k1 = rate(u[i])
        k2 = rate(u[i] + _STEP / 2 * k1)
        k3 = rate(u[i] + _STEP / 2 * k2)
        u[i + 1] = u[i] + _STEP / 6 * (k1 + 2 * k2 + 2 * k3 + rate(u[i] + _STEP * k3))
    places = np.arange(round(dt / _STEP), count + 1, round(dt / _STEP))
    t, u = places * _STEP, u[places]
    force = force_p(t)
    channels = {"u": u, "u_dot": (force - drag(u)) / M_X, "tau_X": force}
    return Run("P", t, {name: sign * data for name, data in channels.items()})


@pytest.fixture(scope="module")
def runs() -> dict[float, Run]:
    return {dt: profile_p(dt) for dt in (0.2, 0.25)}


def coefficients(found: Estimation) -> list[float]:
    """m_x, X_u, X_u|u| as the paper prints them."""
    return [found.inertia[0], -found.values["X_u"], -found.values["X_uabsu"]]


# Independent values: shared/PAPER.md, "Identification baseline".
BASELINE = [
    ("1", 0.2, (9.130825, 0.142306, 5.153776)),
    ("2", 0.2, (9.276339, 0.102813, 5.349356)),
    ("8", 0.2, (9.866323, -0.102889, 6.385157)),
    ("10", 0.2, (9.061870, 0.127672, 5.300062)),
    ("11", 0.2, (9.468722, 0.000785, 5.921382)),
    ("11", 0.25, (9.813733, -0.015580, 5.825397)),
]


@pytest.mark.parametrize(("case", "dt", "values"), BASELINE)
def test_baseline_values(case: str, dt: float, values: tuple[float, ...], runs: dict[float, Run]) -> None:
    (surge,) = experiments(surge_vehicle(), [runs[dt]])
    assert coefficients(estimate(surge, CASES[case])) == pytest.approx(values, abs=6e-7)


def test_the_eleven_cases_are_those_of_the_tables() -> None:
    assert list(CASES) == [str(n) for n in range(1, 12)]
    assert [str(CASES[n]) for n in ("1", "5", "7", "10", "11")] == [
        "nothing filtered",
        "velocity (3, 7), acceleration (3, 7)",
        "velocity (1, 5), acceleration (1, 5) then (1, 7)",
        "velocity (4, 11), acceleration from it",
        "velocity (4, 11), acceleration from it, acceleration (1, 7)",
    ]
    assert [c.name for c in chosen_cases("11, 2,11")] == ["11", "2"]
    with pytest.raises(UndertowError, match=r"'12' is not a case; give all, or some of 1, 2"):
        chosen_cases("2,12")


def test_dropped_edges_leave_out_half_a_frame_and_nothing_else_changes() -> None:
    signal = np.random.default_rng(3).standard_normal(40)
    whole, inner = (Smoother(4, 11)(signal, edges) for edges in ("interp", "drop"))
    assert np.isnan(inner[[0, 4, -5, -1]]).all()
    np.testing.assert_array_equal(inner[5:-5], whole[5:-5])
    np.testing.assert_array_equal(whole, savgol_filter(signal, 11, 4))


def test_dropped_edges_shorten_the_regression(runs: dict[float, Run]) -> None:
    (surge,) = experiments(surge_vehicle(), [runs[0.2]])
    found = {n: estimate(surge, CASES[n], "drop").samples for n in ("1", "3", "11")}
    # The second filter of case 11 loses three samples more at either end.
    assert found == {"1": 150, "3": 146, "11": 134}


def test_covariance_and_residual_variance_are_those_of_the_normal_equations(runs: dict[float, Run]) -> None:
    run = runs[0.2]
    (surge,) = experiments(surge_vehicle(), [run])
    found = estimate(surge, CASES["4"])
    u, rate = (savgol_filter(run.channels[n], 7, 1) for n in ("u", "u_dot"))
    H = np.column_stack([rate, u, np.abs(u) * u])
    theta = np.linalg.solve(H.T @ H, H.T @ run.channels["tau_X"])
    left = run.channels["tau_X"] - H @ theta
    variance = left @ left / (len(left) - 3)
    assert coefficients(found) == pytest.approx(theta)
    assert found.residual_variance == pytest.approx(variance)
    assert found.samples == 150
    expected = np.sqrt(np.diag(variance * np.linalg.inv(H.T @ H)))
    assert list(found.standard_errors.values()) == pytest.approx(expected)
    assert found.inertia[1] == pytest.approx(expected[0])
    assert t_values(found)["X_u"] == pytest.approx(abs(theta[1]) / expected[1])


@pytest.mark.slow
def test_errors_are_those_of_repeated_experiments_where_nothing_is_filtered(runs: dict[float, Run]) -> None:
    run, rng = runs[0.2], np.random.default_rng(8)
    estimates = []
    for _ in range(200):
        noisy = run.channels["tau_X"] + 0.02 * rng.standard_normal(len(run.t))
        (surge,) = experiments(surge_vehicle(), [replace(run, channels={**run.channels, "tau_X": noisy})])
        found = estimate(surge, CASES["1"])
        estimates.append(coefficients(found))
    spread = np.std(estimates, axis=0)
    assert list(found.standard_errors.values()) == pytest.approx(spread, rel=0.2)
    away = np.mean(estimates, axis=0) - [M_X, TRUTH["X_u"], TRUTH["X_uabsu"]]
    assert np.all(np.abs(away) < 3.5 * spread / np.sqrt(200))


def test_what_is_not_physical_is_marked_and_not_taken(runs: dict[float, Run]) -> None:
    (surge,) = experiments(surge_vehicle(), [runs[0.2]])
    found = [estimate(surge, case) for case in CASES.values()]
    bad = {e.case.name: e.impossible for e in found if not e.valid}
    assert bad == dict.fromkeys(("6", "7", "8", "9"), ("X_u",))
    taken = selected(found)
    assert taken is not None
    assert taken.case.name == "1"
    assert selected([e for e in found if not e.valid]) is None


def test_forward_and_backward_logs_give_their_own_values(runs: dict[float, Run]) -> None:
    auv = load_vehicle("mini-auv")
    logs = [profile_p(0.2, sign=-1.0), runs[0.2]]
    found = experiments(auv, logs)
    assert [str(e.axis) for e in found] == ["surge, forward", "surge, backward"]
    assert [e.runs for e in found] == [(logs[1],), (logs[0],)]
    picks = [(e, estimate(e, CASES["2"])) for e in found]
    assert coefficients(picks[0][1]) == pytest.approx(coefficients(picks[1][1]))
    result = combined(auv, picks)
    ways = [f"{n}_{way}" for way in ("forward", "backward") for n in ("X_udot", "X_u", "X_uabsu")]
    assert result.names == tuple(ways)
    np.testing.assert_array_equal(result.covariance[:3, 3:], 0.0)
    new = result.vehicle(auv)
    assert new.value_of("X_udot_forward").value == pytest.approx(-9.276339 + 7.5, abs=1e-6)
    assert new.value_of("X_udot_backward").sigma == pytest.approx(picks[1][1].standard_errors["X_udot"])
    assert new.value_of("Z_wdot_forward") == auv.value_of("Z_wdot_forward")


def _heave(auv: Vehicle, sign: float, buoyancy: float) -> Run:
    """Heave at the stated values, but for the net buoyancy, N."""
    way = "forward" if sign > 0 else "backward"
    added, damping = (auv.value_of(f"{n}_{way}").value for n in ("Z_wdot", "Z_w"))
    t = np.arange(0.0, 20.0, INTERVAL)
    w = sign * 0.2 * (1.0 + 0.5 * np.sin(t))
    w_dot = sign * 0.1 * np.cos(t)
    force = (7.5 - added) * w_dot - damping * w + buoyancy
    noise = 1e-3 * np.random.default_rng(5).standard_normal(len(t))
    return Run(f"heave {way}", t, {"w": w, "w_dot": w_dot, "tau_Z": force + noise})


def test_heave_gives_its_inertia_damping_and_buoyancy() -> None:
    auv = load_vehicle("mini-auv")
    run = _heave(auv, 1.0, auv.value_of("B_net").value)
    (heave,) = experiments(auv, [run])
    found = estimate(heave, CASES["1"])
    assert found.names == ("Z_wdot", "Z_w", "B_net")
    stated = [auv.value_of(n).value for n in ("Z_wdot_forward", "Z_w_forward", "B_net")]
    assert list(found.values.values()) == pytest.approx(stated, rel=1e-2)
    assert found.inertia[0] == pytest.approx(7.5 - stated[0], rel=1e-3)


def test_what_both_directions_share_is_weighted_and_a_contradiction_is_reported() -> None:
    auv = load_vehicle("mini-auv")
    value = auv.value_of("B_net").value
    both = experiments(auv, [_heave(auv, 1.0, value), _heave(auv, -1.0, value)])
    agree = combined(auv, [(e, estimate(e, CASES["1"])) for e in both])
    assert agree.names.count("B_net") == 1
    assert agree.contradictions == ()
    place = agree.names.index("B_net")
    assert agree.values[place] == pytest.approx(value, abs=4 * np.sqrt(agree.covariance[place, place]))
    apart = experiments(auv, [_heave(auv, 1.0, value), _heave(auv, -1.0, value + 1.9)])
    reported = combined(auv, [(e, estimate(e, CASES["1"])) for e in apart]).contradictions
    assert len(reported) == 1
    assert reported[0].startswith("B_net is ")
    assert " by heave, forward and " in reported[0]


def test_yaw_is_the_same_both_ways() -> None:
    auv = load_vehicle("mini-auv")
    t = np.arange(0.0, 20.0, INTERVAL)
    r, r_dot = 0.4 * np.sin(t), 0.4 * np.cos(t)
    moment = (0.251 + 0.0240417) * r_dot + 0.013791 * r
    (yaw,) = experiments(auv, [Run("yaw", t, {"r": r, "r_dot": r_dot, "tau_N": moment})])
    assert str(yaw.axis) == "yaw"
    found = estimate(yaw, CASES["1"])
    assert found.values == pytest.approx({"N_rdot": -0.0240417, "N_r": -0.013791})
    assert found.inertia[0] == pytest.approx(0.2750417)


def test_the_regressor_follows_the_model(runs: dict[float, Run]) -> None:
    """A term more in the vehicle file is a column more in the regression."""
    cubic = surge_vehicle().with_effect(catalogue()["cubic_damping"], {"X_uuu": Value(0.0, estimate=True)})
    (surge,) = experiments(cubic, [runs[0.2]])
    found = estimate(surge, CASES["1"])
    assert set(found.names) == {"X_udot", "X_u", "X_uabsu", "X_uuu"}
    assert found.values["X_uuu"] == pytest.approx(0.0, abs=1e-6)
    assert found.values["X_uabsu"] == pytest.approx(-TRUTH["X_uabsu"])


def test_without_a_logged_acceleration_the_velocity_is_differentiated(runs: dict[float, Run]) -> None:
    run = runs[0.2]
    bare = replace(run, channels={n: c for n, c in run.channels.items() if n != "u_dot"})
    (surge,) = experiments(surge_vehicle(), [bare])
    assert coefficients(estimate(surge, CASES["10"])) == pytest.approx(BASELINE[3][2], abs=6e-7)
    by_differences = replace(run, channels={**run.channels, "u_dot": np.gradient(run.channels["u"], run.t)})
    (same,) = experiments(surge_vehicle(), [by_differences])
    assert coefficients(estimate(surge, CASES["2"])) == pytest.approx(
        coefficients(estimate(same, CASES["2"]))
    )


def test_gaps_are_not_filtered_over(runs: dict[float, Run]) -> None:
    run = runs[0.2]
    u = run.channels["u"].copy()
    u[70:73] = np.nan
    (surge,) = experiments(surge_vehicle(), [replace(run, channels={**run.channels, "u": u})])
    assert estimate(surge, CASES["1"]).samples == 147
    halves = [run.slice(None, run.t[69]), run.slice(run.t[73], None)]
    (parts,) = experiments(surge_vehicle(), halves)
    assert coefficients(estimate(surge, CASES["11"])) == pytest.approx(
        coefficients(estimate(parts, CASES["11"]))
    )


def _without(run: Run, *names: str) -> Run:
    return replace(run, channels={n: c for n, c in run.channels.items() if n not in names})


def test_what_cannot_be_estimated_is_refused(runs: dict[float, Run]) -> None:
    run, vehicle = runs[0.2], surge_vehicle()
    uneven = replace(run, t=run.t + 0.05 * np.sin(np.arange(len(run.t))))
    moving = load_vehicle("mini-auv")
    two = replace(run, channels={**run.channels, "w": run.channels["u"], "tau_Z": run.channels["tau_X"]})
    constant = replace(run, channels={**run.channels, "u": np.full(150, 0.2), "u_dot": np.zeros(150)})
    refused = [
        (vehicle, _without(run, "tau_X"), "holds no velocity of 'surge' that changes with the force"),
        (vehicle, constant, "holds no velocity"),
        (vehicle, uneven, "sampled unevenly .* resample it"),
        (vehicle, run.slice(0.0, 2.0), "no stretch without gaps in u, tau_X has the 11 samples that case 11"),
        (moving, two, "moves in surge and heave, but the paper's method takes one motion at a time"),
    ]
    for model, log, words in refused:
        with pytest.raises(UndertowError, match=words):
            estimate(experiments(model, [log])[0], CASES["11"])


def test_a_motion_at_one_speed_leaves_combinations_open(runs: dict[float, Run]) -> None:
    t = runs[0.2].t
    u = 0.2 + 1e-12 * np.sin(t)
    run = Run("steady", t, {"u": u, "u_dot": np.sin(3 * t), "tau_X": np.ones_like(t)})
    (surge,) = experiments(surge_vehicle(), [run])
    with pytest.raises(
        UndertowError, match=r"do not determine X_udot, .* only X_udot, X_u \+ 0.2 X_uabsu: log other"
    ):
        estimate(surge, CASES["1"])


def test_mass_and_added_mass_are_one_number(runs: dict[float, Run]) -> None:
    vehicle = surge_vehicle()
    both = vehicle.with_values({"m": replace(vehicle.value_of("m"), estimate=True)})
    (surge,) = experiments(both, [runs[0.2]])
    with pytest.raises(UndertowError, match="only X_u, X_uabsu, m - X_udot: log other speeds"):
        estimate(surge, CASES["1"])


def test_dropped_edges_need_longer_stretches(runs: dict[float, Run]) -> None:
    (surge,) = experiments(surge_vehicle(), [runs[0.2].slice(3.0, 5.7)])
    assert len(surge.runs[0].t) == 14
    assert estimate(surge, CASES["11"]).samples == 14
    with pytest.raises(UndertowError, match="has the 17 samples that case 11 needs"):
        estimate(surge, CASES["11"], "drop")
    with pytest.raises(UndertowError, match="3 samples of surge are too few for 3 parameters"):
        estimate(experiments(surge_vehicle(), [runs[0.2].slice(3.0, 3.5)])[0], CASES["1"])


def test_cases_ask_only_for_what_they_use(runs: dict[float, Run]) -> None:
    run = runs[0.2]
    rate = run.channels["u_dot"].copy()
    rate[::5] = np.nan
    holed = replace(run, channels={**run.channels, "u_dot": rate})
    whole, gappy = (experiments(surge_vehicle(), [r])[0] for r in (run, holed))
    assert estimate(gappy, CASES["11"]).values == estimate(whole, CASES["11"]).values
    with pytest.raises(UndertowError, match="without gaps in u, tau_X, u_dot has the 7 samples"):
        estimate(gappy, CASES["4"])
    uneven = replace(run, t=run.t + 0.05 * np.sin(np.arange(len(run.t))))
    (bent,) = experiments(surge_vehicle(), [uneven])
    assert estimate(bent, CASES["1"]).values == pytest.approx(estimate(whole, CASES["1"]).values)


def test_a_log_of_both_directions_is_refused_where_they_differ(runs: dict[float, Run]) -> None:
    t = np.arange(0.0, 30.0, INTERVAL)
    u, rate = 0.3 * np.sin(0.7 * t), 0.21 * np.cos(0.7 * t)
    run = Run("swing", t, {"u": u, "u_dot": rate, "tau_X": M_X * rate + drag(u)})
    with pytest.raises(UndertowError, match=r"goes forward for 5\d% of its way in u and backward"):
        experiments(load_vehicle("mini-auv"), [run])
    (surge,) = experiments(surge_vehicle(), [run])
    assert coefficients(estimate(surge, CASES["1"])) == pytest.approx([M_X, TRUTH["X_u"], TRUTH["X_uabsu"]])


def _rolling() -> tuple[Vehicle, Run]:
    """Roll with a righting moment, K = (I - K_pdot) p_dot - K_p p + 0.05 B sin phi, along a sine."""
    effects = {
        "rigid_body": {"m": 10.0, "I_x": 2.0},
        "restoring": {"W": 98.1, "B": 98.1, "z_g": 0.0, "z_b": -0.05},
        "added_mass": {"K_pdot": {"value": -0.5, "estimate": True}},
        "linear_damping": {"K_p": {"value": -0.5, "estimate": True}},
    }
    table = {
        "schema": "undertow/vehicle/1", "name": "roll", "degrees_of_freedom": ["roll"],
        "signs": "sname", "generalised_forces": ["tau_K"], "effects": effects,
    }  # fmt: skip
    vehicle = vehicle_from_table(VehicleTable.model_validate(table), catalogue())
    t = np.arange(0.0, 20.0, 0.05)
    phi, p, p_dot = 0.4 * np.sin(1.3 * t), 0.52 * np.cos(1.3 * t), -0.676 * np.sin(1.3 * t)
    moment = 2.7 * p_dot + 0.8 * p + 98.1 * 0.05 * np.sin(phi)
    channels = {"phi": phi, "p": p, "p_dot": p_dot, "tau_K": moment}
    return vehicle, Run("roll", t, channels)


def test_the_pose_is_used_where_the_model_feels_it_and_asked_for() -> None:
    vehicle, run = _rolling()
    (roll,) = experiments(vehicle, [run])
    assert estimate(roll, CASES["1"]).values == pytest.approx({"K_pdot": -0.7, "K_p": -0.8})
    (blind,) = experiments(vehicle, [_without(run, "phi")])
    with pytest.raises(UndertowError, match="has no channel 'phi', which the roll of 'roll' depends on"):
        estimate(blind, CASES["1"])


def test_thrust_that_comes_late_is_refused() -> None:
    auv = load_vehicle("mini-auv")
    late = auv.with_effect(catalogue()["actuation_delay"], {"delay": Value(1.0)})
    t = np.arange(0.0, 20.0, INTERVAL)
    channels = dict.fromkeys(("f1", "f3"), np.zeros_like(t)) | dict.fromkeys(("f2", "f4"), 1.0 + np.sin(t))
    run = Run("thrust", t, {"u": 0.2 + 0.1 * np.sin(t), "u_dot": 0.1 * np.cos(t), **channels})
    assert estimate(experiments(auv, [run])[0], CASES["1"]).samples == len(t)
    with pytest.raises(
        UndertowError, match="responds to its commands 1 s late, which least squares on samples"
    ):
        experiments(late, [run])


def test_logs_with_a_force_and_with_thrusters_are_experiments_of_their_own(runs: dict[float, Run]) -> None:
    t = runs[0.2].t
    half = runs[0.2].channels["tau_X"] / 2
    thrust = {"f1": np.zeros_like(t), "f3": np.zeros_like(t), "f2": half, "f4": half}
    by_thrust = Run("thrust", t, {n: runs[0.2].channels[n] for n in ("u", "u_dot")} | thrust)
    auv = load_vehicle("mini-auv")
    found = [estimate(e, CASES["4"]) for e in experiments(auv, [runs[0.2], by_thrust])]
    assert len(found) == 2
    assert coefficients(found[0]) == pytest.approx(coefficients(found[1]))
