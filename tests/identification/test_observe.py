"""States of logs: rates and delays of sensors, biases, currents, and smoothing with a wrong model."""

from __future__ import annotations

import tomllib
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.observer_log import BIAS, CURRENT, DRIVE, NOISE, auv, log
from undertow.errors import UndertowError
from undertow.identification.logs.run import Run
from undertow.identification.observe import (
    deviations,
    observe,
    observe_logs,
    observed_picture,
    observer_file,
    reports_of,
)
from undertow.observer.design import ObserverTable, design
from undertow.observer.process import process_of

EVERY = {"x": 10, "y": 10, "z": 5, "psi": 1, "u": 2, "v": 2, "w": 2, "r": 1}
WALKS = {"V_N": 1e-4, "V_E": 1e-4, "b_r": 1e-5}


def test_slow_late_and_biased_sensors_give_motion_current_and_bias() -> None:
    late = 0.3
    truth = auv(**CURRENT, **BIAS, velocity_delay=late)
    run, x, names = log(truth, 60.0, 2, EVERY, late)
    known = auv(velocity_delay=late)
    found = observe(
        known, run, process="model", estimated=["V_N", "V_E", "b_r"], disturbance=DRIVE | WALKS, method="ukf"
    )
    for name, true in {**CURRENT, **BIAS}.items():
        value, sigma = found.parameters[name]
        assert abs(value - true) < 3 * sigma, name
        assert sigma < 0.03
    spread, inner = deviations(found), slice(50, -20)
    for name in ("x", "y", "u", "v", "w", "psi", "r"):
        error = (found.run.channels[name] - x[:, names.index(name)])[inner] / spread[name][inner]
        assert 0.4 < np.sqrt(np.mean(error**2)) < 1.6, name
    ignorant = observe(
        auv(), run, process="model", estimated=["V_N", "V_E", "b_r"], disturbance=DRIVE | WALKS, method="ekf"
    )
    assert found.filtered.log_likelihood > ignorant.filtered.log_likelihood + 20


def test_reports_stand_at_the_time_when_they_were_true() -> None:
    vehicle = auv(velocity_delay=0.25)
    t = 0.1 * np.arange(100)
    run = Run("late", t, {"u": t - 0.25, "x": t, **{f"f{i}": np.zeros(100) for i in range(1, 5)}})
    given, rows = reports_of(run, process_of(vehicle, (), "kinematics"))
    u = given.y[:, 4]
    there = np.isfinite(u)
    np.testing.assert_allclose(u[there], given.t[there], atol=1e-9)
    np.testing.assert_allclose(given.t[rows], t, atol=1e-9)
    assert np.isnan(given.y[rows[0], 4]) or given.y[rows[0], 4] == pytest.approx(0.0, abs=1e-9)


def test_a_filter_that_lost_its_track_is_not_honest() -> None:
    run, _, _ = log(auv(), 10.0, 2, EVERY)
    still = dict.fromkeys(("u_dot", "v_dot", "w_dot", "r_dot"), 1e-5)
    stiff = observe(auv(), run, disturbance=still)
    assert "r" in stiff.lost
    assert not stiff.consistent
    assert not observe(auv(), run).lost


@pytest.mark.slow
def test_kinematics_is_honest_where_the_model_leans_towards_itself() -> None:
    """A tenth of the buoyancy is missing in the model, and no velocity is measured."""
    right = auv()
    buoyancy = right.value_of("B_net")
    wrong = right.with_values({"B_net": replace(buoyancy, value=0.9 * buoyancy.value)})
    run, x, names = log(right, 60.0, 3, {"x": 1, "y": 1, "z": 1, "psi": 1})
    true, inner = x[:, names.index("w")], slice(50, -50)
    pulls = {}
    for process, noise in (("kinematics", None), ("model", dict.fromkeys(DRIVE, 0.003))):
        found = observe(wrong, run, process=process, disturbance=noise, method="ekf")
        pulls[process] = (found.run.channels["w"] - true)[inner] / deviations(found)["w"][inner]
    # Steps of the thrusters are no white noise, so that kinematics is a little too sure, too.
    assert 0.5 < np.sqrt(np.mean(pulls["kinematics"] ** 2)) < 2
    assert np.sqrt(np.mean(pulls["model"] ** 2)) > 4


@pytest.mark.slow
def test_the_noise_that_drives_the_motion_is_found() -> None:
    run, _, _ = log(auv(), 60.0, 4, {"x": 1, "y": 1, "z": 1, "psi": 1, "u": 1, "v": 1, "w": 1, "r": 1})
    found = observe(auv(), run, process="model", method="ekf")
    for name, true in DRIVE.items():
        assert found.disturbance[name] == pytest.approx(true, rel=0.35)
    assert found.nis[-1].consistent
    assert found.noise["x"] == NOISE["x"]
    table = observer_file(found, [run], "found")
    again = design(ObserverTable.model_validate(tomllib.loads(table)), auv())
    assert again.noise["psi"] == pytest.approx(NOISE["psi"])
    assert again.period == pytest.approx(np.full(8, 0.1))


def test_a_picture_has_units_time_and_a_legend() -> None:
    run, _, _ = log(auv(), 5.0, 1, {"x": 1, "y": 1, "z": 1, "psi": 1})
    *panels, below = observed_picture(observe(auv(), run), run).axes
    labels = ["x [m]", "u [m/s]", "y [m]", "v [m/s]", "z [m]", "w [m/s]", "psi [rad]", "r [rad/s]", "NIS"]
    assert [axis.get_ylabel() for axis in panels] == labels
    assert [axis.get_xlabel() for axis in panels] == 7 * [""] + 2 * ["time [s]"]
    words = [text.get_text() for text in below.get_legend().get_texts()]
    assert words[:3] == ["estimate, smoothed", "two standard deviations", "reports of the sensor"]
    assert words[3].startswith("NIS, mean of ")
    assert len(words) == 5


def test_too_few_reports_and_missing_commands_are_refused() -> None:
    t = 0.1 * np.arange(50)
    with pytest.raises(UndertowError, match="0 reports"):
        observe(auv(), Run("empty", t, {"f1": t}))
    with pytest.raises(UndertowError, match="no command 'f1'"):
        observe(auv(), Run("no commands", t, {"x": t}), process="model")


def test_several_logs_are_tested_together() -> None:
    """NIS is the mean over all reports, sums of Ljung and Box add up, the file takes the mean noise."""
    runs = [log(auv(), 5.0, seed, {"x": 1, "y": 1, "z": 1, "psi": 1})[0] for seed in (1, 2)]
    one, other = (observe(auv(), run) for run in runs)
    both = observe_logs(auv(), runs)
    for single, other_one, pooled in zip(one.nis, other.nis, both.nis, strict=True):
        assert pooled.count == single.count + other_one.count
        total = single.mean * single.count + other_one.mean * other_one.count
        assert pooled.mean == pytest.approx(total / pooled.count)
        assert pooled.high < single.high
    for single, other_one, pooled in zip(one.white, other.white, both.white, strict=True):
        assert pooled.statistic == pytest.approx(single.statistic + other_one.statistic)
        assert pooled.lags == single.lags + other_one.lags
    noise = np.sqrt((one.noise["x"] ** 2 + other.noise["x"] ** 2) / 2)
    table = tomllib.loads(observer_file(both, runs, "both"))
    assert float(table["sensors"]["x"]["noise"].split()[0]) == pytest.approx(noise, rel=1e-3)
    assert list(both.content()["logs"]) == [run.name for run in runs]
