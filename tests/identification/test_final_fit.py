"""What every fit ends with: the same optimum from all commands, no runaway, no prior counted twice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import undertow as ut
from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import runs_of, simulated_runs, true_vehicle, vehicle_of
from tests.identification.surge import M_X, MASS, TRUTH, surge_vehicle
from tests.quick import first_quick
from undertow.codegen.functions import Functions
from undertow.identification.api import Estimator, try_effect
from undertow.identification.diagnosis.addition import add_effects, best_predicting, set_up_addition
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import held_by_default_prior, notes, unknown_scales
from undertow.identification.estimation.output_error import (
    OutputErrorFit,
    final_fit,
    fit_output_error,
    horizon_error,
)
from undertow.identification.estimation.pointwise import largest_values
from undertow.identification.estimation.weak_form import fit_weak
from undertow.model.vehicle import Value, Vehicle

BUNDLED = ("box-hull", "cybership2", "mini-auv", "bluerov2")
STEP = 0.1


def _logs(name: str) -> list[ut.Run]:
    """Two runs of a bundled vehicle, with noise."""
    vehicle = ut.load_vehicle(name)
    size = 0.1 * vehicle.value_of("m").value
    return simulated_runs(vehicle, 2, 60.0, seed=7, size=size, hold=20, noise=0.005)


def _guessed(vehicle: Vehicle) -> Vehicle:
    """The vehicle with its free parameters a third larger than they are."""
    free = [n for n, v in vehicle.values.items() if v.estimate and v.value]
    return vehicle.with_values(
        {n: replace(vehicle.value_of(n), value=1.3 * vehicle.value_of(n).value) for n in free}
    )


@pytest.mark.parametrize("name", first_quick(BUNDLED))
def test_fit_add_and_diagnose_end_at_the_same_optimum(name: str) -> None:
    vehicle, (train, test) = _guessed(ut.load_vehicle(name)), _logs(name)
    done = ut.fit(vehicle, [train], [test])
    fit = done.fit
    setup = set_up_addition(vehicle, [train], [test])
    added = add_effects([ut.catalogue()["constant_force"]], setup)
    known = {"constant_force": ut.catalogue()["constant_force"]}
    diagnosed = ut.diagnose(vehicle, [train], [test], known=known).before
    again = ut.fit(fit.vehicle, [train], [test]).fit
    ahead = setup.validator.ahead(done.vehicle)[0]
    assert added.before.ahead == pytest.approx({h: ahead[h] for h in added.before.ahead}, rel=1e-3)
    for parameter, value in fit.values.items():
        error = fit.standard_errors[parameter]
        assert setup.validator.final(setup.bench.base).values[parameter] == pytest.approx(value, abs=1e-9)
        assert diagnosed.value_of(parameter).value == pytest.approx(value, abs=0.2 * error)
        # From fitted values time constants, and so the windows, are a little different.
        assert again.values[parameter] == pytest.approx(value, abs=error)


def test_output_error_begins_at_the_stated_values_where_the_weak_forms_let_simulations_diverge() -> None:
    """Near an incomplete model the weak form may end at a coupling that makes the vehicle unstable."""
    vehicle, (train, test) = _guessed(ut.load_vehicle("cybership2")), _logs("cybership2")
    setup = set_up_addition(vehicle, [train], [test])
    weak = setup.bench.base
    p = np.array(weak.p)
    p[[weak.model.functions.parameter_names.index(n) for n in ("Y_r", "N_v")]] = 4000.0
    unstable = replace(weak, p=p)
    assert not horizon_error([unstable], setup.test)[0] < 100.0
    fits = [final_fit(f, setup.train, setup.test) for f in (weak, unstable)]
    right, found = horizon_error(fits, setup.test)
    assert found == pytest.approx(right, rel=0.05)


def test_of_parameters_left_out_or_not_those_are_added_that_predict_better() -> None:
    """With half of them held at wrong values predictions are worse; of two as good the first is taken."""
    vehicle, (train, test) = _guessed(ut.load_vehicle("box-hull")), _logs("box-hull")
    setup = set_up_addition(vehicle, [train], [test])
    whole = setup.bench.base
    half = fit_weak(whole.model.with_free(whole.model.free[:1]), whole.data)
    for fits in ([half, whole], [whole, half]):
        assert best_predicting(setup, fits)[0] is whole
    same = fit_weak(whole.model, whole.data)
    assert best_predicting(setup, [whole, same])[0] is whole


@pytest.mark.slow
def test_the_refitted_model_is_the_same_for_all_commands_if_the_model_lacks_an_effect() -> None:
    source = Path(ut.__file__).parent / "demo_data" / "auv"
    vehicle = ut.load_vehicle(source / "vehicle.toml")
    train, test = (
        ut.read_log(source / f"{name}.csv.gz", commands=vehicle.command_names)
        for name in ("train_1", "holdout")
    )
    current = ut.catalogue()["ocean_current"]
    added = add_effects([current], set_up_addition(vehicle, [train], [test]))
    diagnosed = ut.diagnose(vehicle, [train], [test], known={current.id: current})
    assert diagnosed.effects == [current.id]
    for step, same in zip(added.steps[1:], diagnosed.diagnosis.steps, strict=True):
        assert same.error == pytest.approx(step.error, rel=1e-4)
        assert same.prediction == pytest.approx(step.prediction, rel=1e-4)
        assert same.ahead == pytest.approx(step.ahead, rel=1e-4)
    fit = ut.fit(vehicle, [train], [test])
    for name in fit.fit.values:
        value = fit.vehicle.value_of(name).value
        assert diagnosed.before.value_of(name).value == pytest.approx(value, rel=1e-6, abs=1e-9)


def test_a_fit_is_no_prior_for_another_fit_to_the_same_logs(tmp_path: Path) -> None:
    source = Path(ut.__file__).parent / "demo_data" / "auv"
    vehicle = ut.load_vehicle(source / "vehicle.toml")
    runs = [ut.read_log(source / f"train_{i}.csv.gz", commands=vehicle.command_names) for i in (1, 2)]
    first = ut.fit(vehicle, runs[:1], runs[1:], method="weak")
    first.save(source / "vehicle.toml", tmp_path / "fitted.toml")
    written = ut.load_vehicle(tmp_path / "fitted.toml")
    (name, *_) = first.fit.model.free
    assert written.value_of(name).sigma is not None
    same, other = (written.without_priors_from([run.sha256]) for run in runs)
    assert same.value_of(name).sigma is None
    assert same.value_of(name).value == written.value_of(name).value
    assert other.value_of(name).sigma == written.value_of(name).sigma
    second = ut.fit(written, runs[:1], runs[1:], method="weak")
    assert second.stated.value_of(name).sigma is None


# --- what pose and velocity say about a sensor ------------------------------------------------------------
_BIASED = """
schema = "undertow/vehicle/1"
name = "box"
degrees_of_freedom = ["surge"]
signs = "magnitudes"
generalised_forces = ["tau_X"]
[effects.rigid_body]
m = "10 kg"
[effects.added_mass]
X_udot = { value = 4.0, estimate = true }
[effects.linear_damping]
X_u = { value = 4.0, estimate = true }
[effects.sensor_bias]
b_u = { value = 0.0, estimate = true }
"""


def _run_with_a_slow_wake(name: str, bias: float, seed: int) -> ut.Run:
    """A box that drags water along, 14 u' = X - 4 u - w and 3 w' = 6 u - w; its velocity reads too much."""
    rng, h, held = np.random.default_rng(seed), 0.01, 300
    force = np.repeat(rng.uniform(-3.0, 3.0, 60 * 100 // held), held)
    x = np.zeros((len(force), 3))
    for i in range(len(force) - 1):
        _, u, w = x[i]
        x[i + 1] = x[i] + h * np.array([u, (force[i] - 4.0 * u - w) / 14.0, (6.0 * u - w) / 3.0])
    x = x[::10] + 1e-4 * rng.standard_normal((len(x[::10]), 3))
    channels = {"x": x[:, 0], "u": x[:, 1] + bias, "tau_X": force[::10]}
    return ut.Run(name, 0.1 * np.arange(len(x)), channels, sha256=name)


def test_a_model_that_lacks_an_effect_does_not_bend_what_pose_and_velocity_say(tmp_path: Path) -> None:
    """Predicted velocities alone would take a false bias for the wake that the model does not have."""
    (tmp_path / "box.toml").write_text(_BIASED)
    runs = [_run_with_a_slow_wake(f"run {k}", 0.02, k) for k in (1, 2)]
    fit = ut.fit(ut.load_vehicle(tmp_path / "box.toml"), runs[:1], runs[1:]).fit
    assert isinstance(fit, OutputErrorFit)
    assert np.any(fit.known)
    assert fit.values["b_u"] == pytest.approx(0.02, abs=2e-4)
    assert fit.standard_errors["b_u"] < 2e-4


# --- the size of a vehicle ----------------------------------------------------------------------------------
@pytest.mark.parametrize("vehicle", first_quick(("mini-auv", "usv", "rov")))
def test_the_default_prior_does_not_move_what_data_determine(vehicle: str) -> None:
    case = make_case(vehicle, (), 3, duration=60.0)
    stated, runs = vehicle_of(case), runs_of(case)[:3]
    data = prepare(runs, stated)
    fit = fit_weak(stated, data)
    free = {n: replace(stated.value_of(n), sigma=1e9) for n in fit.model.free}
    without = fit_weak(stated.with_values(free), data)
    for name, value in without.values.items():
        assert fit.values[name] == pytest.approx(value, abs=0.1 * without.standard_errors[name])
    assert held_by_default_prior(fit) == []
    assert notes(fit) == []


def test_a_model_that_lacks_the_righting_moment_does_not_run_away() -> None:
    case = make_case("rov", (), 5, duration=30.0)
    vehicle, runs = true_vehicle(case), runs_of(case)[:2]
    level = vehicle.with_values({"S_z": replace(vehicle.value_of("S_z"), value=0.0)})
    values = fit_weak(level, prepare(runs, level)).values
    for name, inertia in (("K_pdot", "I_x"), ("M_qdot", "I_y")):
        assert abs(values[name]) <= 10.001 * vehicle.value_of(inertia).value
    for name in ("K_p", "M_q"):
        # By which a rate dies away within a millisecond.
        assert abs(values[name]) < 1e3 * vehicle.value_of("I_x").value


def _coasting() -> ut.Run:
    """Surge that dies away, m_x u' = -X_u u, with no force on it."""
    t = np.arange(0.0, 60.0, STEP)
    u = np.exp(-TRUTH["X_u"] / M_X * t) + 1e-3 * np.random.default_rng(1).standard_normal(len(t))
    return ut.Run("coasting", t, {"u": u, "tau_X": np.zeros(len(t))}, sha256="c")


def test_a_scale_that_no_force_fixes_is_said_and_stays() -> None:
    stated = surge_vehicle()
    vehicle = stated.with_values({"X_uabsu": replace(stated.value_of("X_uabsu"), value=0.0, estimate=False)})
    fit = fit_weak(vehicle, prepare([_coasting()], vehicle))
    assert unknown_scales(fit) == {"surge": ["X_udot", "X_u"]}
    assert "determines the scale of the forces in surge: X_udot, X_u are known up to a" in " ".join(
        notes(fit)
    )
    inertia = MASS - fit.values["X_udot"]
    assert -fit.values["X_u"] / inertia == pytest.approx(TRUTH["X_u"] / M_X, rel=0.02)
    assert fit.values["X_udot"] == pytest.approx(vehicle.value_of("X_udot").value, abs=0.5)


# --- the end of a fit ---------------------------------------------------------------------------------------
def test_output_error_is_kept_where_it_predicts_no_worse() -> None:
    case = make_case("usv", ("lift",), 4, duration=30.0)
    vehicle, (*train, test) = vehicle_of(case), runs_of(case)
    weak = fit_weak(vehicle, prepare(train, vehicle))
    final = final_fit(weak, train, [test])
    before, after = (float(horizon_error([fit], [test])[0]) for fit in (weak, final))
    assert after <= 1.01 * before
    default = Estimator().fit(vehicle, train, validation=[test])
    assert default.values == pytest.approx(final.values)


def test_where_more_than_noise_is_left_the_error_of_predictions_is_what_is_fitted() -> None:
    case = make_case("usv", ("thruster_lag",), 4, duration=60.0)
    vehicle, train = vehicle_of(case), runs_of(case)[:-1]
    weak = fit_weak(vehicle, prepare(train, vehicle))
    final = final_fit(weak, train, train)
    assert isinstance(final, OutputErrorFit)
    free = fit_output_error(vehicle, train, horizon=final.windows.horizon, start=weak.values)
    known, taken = (
        float(np.sqrt(np.nanmean(((fit.starts - fit.windows.measured[:, 0]) / fit.windows.sigma) ** 2)))
        for fit in (final, free)
    )
    # Starts that are free take up what the model lacks, and its parameters predict no better.
    assert known < 2.0 < 5.0 < taken
    predicted, otherwise = horizon_error([final, free], train)
    assert predicted < 1.01 * otherwise


def test_where_only_noise_is_left_the_end_is_sharper_than_the_weak_form_and_right() -> None:
    case = make_case("usv", (), 4, duration=40.0)
    vehicle, (*train, test) = vehicle_of(case), runs_of(case)
    weak = fit_weak(vehicle, prepare(train, vehicle))
    final = final_fit(weak, train, [test])
    for name, value in final.values.items():
        # Over windows of a time constant, each with a start of its own, errors are ten times as large.
        assert final.standard_errors[name] < weak.standard_errors[name]
        assert value == pytest.approx(case.truth["parameters"][name], abs=4.0 * final.standard_errors[name])


def test_a_bound_does_not_grow_with_every_fit() -> None:
    """From the stated -23 kg m^2 a fit may go to ten times that; from there the next may not."""
    otter = ut.load_vehicle("otter")
    stated = abs(otter.value_of("N_rdot").value)
    first = float(largest_values(Functions(otter), ["N_rdot"])[0])
    assert first == pytest.approx(10.0 * stated)

    far = otter.with_values({"N_rdot": replace(otter.value_of("N_rdot"), value=-0.9 * first)})
    fitted = replace(far, fitted_to={"N_rdot": frozenset({"log"})})
    again, edited = (float(largest_values(Functions(v), ["N_rdot"])[0]) for v in (fitted, far))
    assert 0.9 * first <= again <= first
    assert edited == pytest.approx(9.0 * first)  # what a user writes is stated


def test_a_place_stays_aboard_wherever_a_fit_has_put_it() -> None:
    """The Otter is 2 m long; the next fit of an arm begins where the last one ended."""
    otter = ut.load_vehicle("otter")
    model = replace(otter, effects=(*otter.effects, ut.catalogue()["wind"](otter.command_names)))

    def reach(x: float) -> float:
        at = model.with_values({"x_wind": Value(x, estimate=True)})
        return float(largest_values(Functions(at), ["x_wind"])[0])

    assert 2.0 < reach(0.0) < 20.0
    assert reach(0.9 * reach(0.0)) == reach(0.0)
    assert reach(50.0) == 50.0  # what a user states is possible


def test_a_slow_disturbance_moves_no_mass_far_from_what_is_stated() -> None:
    """Forces of 20 to 200 s, ten times the noise: their samples say the same again and again.

    Counted one by one they had moved X_udot by 43 standard deviations.
    """
    case = make_case("usv", ("slow_force_10",), 2)
    vehicle, runs = vehicle_of(case), runs_of(case)
    stated = {n: v for n, v in vehicle.values.items() if v.estimate and v.value}
    vehicle = vehicle.with_values({n: replace(v, sigma=0.1 * abs(v.value)) for n, v in stated.items()})
    found = ut.fit(vehicle, runs[:2], validation=runs[3:]).vehicle.values
    apart = {n: abs(found[n].value - v.value) / (0.1 * abs(v.value)) for n, v in stated.items()}
    assert max(apart[n] for n in ("X_udot", "Y_vdot", "N_rdot")) < 10.0


def test_effects_added_in_one_step_end_where_they_end_one_by_one() -> None:
    case = make_case("box", ("quadratic_damping", "constant_force"), 12, duration=60.0)
    vehicle, (first, second, *_) = vehicle_of(case), runs_of(case)
    together = try_effect(vehicle, ["quadratic_damping", "constant_force"], [first], [second])[1]
    drag = try_effect(vehicle, "quadratic_damping", [first], [second])[1]
    then = try_effect(drag.fit.vehicle, "constant_force", [first], [second])[1]
    assert together.effects == ("quadratic_damping", "constant_force")
    assert set(together.kept) == {"X_uabsu", "X_0"}
    assert together.after.error == pytest.approx(then.after.error, rel=0.02)
    assert together.after.prediction == pytest.approx(then.after.prediction, rel=0.02)
    assert together.before.ahead == drag.before.ahead
    errors = together.fit.standard_errors
    for name, value in then.fit.values.items():
        assert abs(together.fit.values[name] - value) < 0.1 * errors[name], name
