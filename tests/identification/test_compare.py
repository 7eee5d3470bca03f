"""Comparison: the force that a model lacks, regimes, whiteness, budget, and the sentence at the end."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden_effects import Case, make_case
from tests.identification.logs_of import runs_of, true_vehicle, vehicle_of
from tests.identification.surge import TRUTH, surge_run, surge_vehicle, true_surge
from undertow.identification.comparison import (
    Cell,
    Comparison,
    ComparisonResult,
    Forces,
    Regime,
    compare,
    correlation,
    headline,
    profiles,
    regimes,
    residual_forces,
    whiteness,
)
from undertow.identification.estimation.data import channel_noise
from undertow.identification.report.page import (
    budgets,
    curves,
    errors_by_regime,
    informativeness,
    leading,
    traces,
)


@pytest.fixture(scope="module")
def case() -> Case:
    return make_case("mini-auv", (), 5, duration=60.0, runs=("steps", "cruise"))


@pytest.fixture(scope="module")
def complete(case: Case) -> Comparison:
    return compare(true_vehicle(case), runs_of(case))


@pytest.fixture(scope="module")
def lacking() -> Comparison:
    case = make_case("usv", ("lift",), 6, duration=60.0, runs=("steps", "multisine"))
    return compare(true_vehicle(case), runs_of(case))


def _sigma(forces: Forces, case: Case) -> np.ndarray:
    vehicle = vehicle_of(case)
    return channel_noise(runs_of(case), (*vehicle.pose_names, *vehicle.velocity_names))


# --- residual force ---------------------------------------------------------------------------------------


def test_a_force_that_the_log_leaves_out_is_the_residual_force() -> None:
    run = surge_run()
    missing = 0.1 * np.sin(0.5 * run.t)
    reported = replace(run, channels={**run.channels, "tau_X": run.channels["tau_X"] - missing})
    forces = residual_forces(true_surge(), [reported])
    np.testing.assert_allclose(forces.missing[:, 0], 0.1 * np.sin(0.5 * forces.t), atol=0.012)


def test_the_residual_of_the_true_model_is_noise_and_white(complete: Comparison) -> None:
    for dof in complete.result.dofs:
        assert dof.normalised == pytest.approx(1.0, abs=0.2)
        assert dof.explained_by_noise > 0.7
        assert dof.p_value > 1e-4
        assert max(abs(v) for v in dof.inputs.values()) < 0.15


def test_forces_of_the_effects_and_the_residual_add_up_to_nothing(complete: Comparison) -> None:
    forces = complete.forces
    total = sum(forces.wrenches.values()) + forces.missing
    scale = np.sqrt(np.mean(forces.control**2, axis=0)) + np.sqrt(np.mean(forces.missing**2, axis=0))
    assert np.all(np.sqrt(np.mean(total**2, axis=0)) < 0.05 * scale)


def test_noise_of_the_force_grows_with_the_noise_of_the_channels() -> None:
    spread = [residual_forces(true_surge(), [surge_run(level, 1)]).noise.mean() for level in (0.01, 0.04)]
    assert spread[1] / spread[0] == pytest.approx(4.0, rel=0.25)


# --- whiteness --------------------------------------------------------------------------------------------


def test_white_noise_passes_and_correlated_noise_does_not() -> None:
    rng = np.random.default_rng(0)
    one = np.zeros(600, dtype=np.intp)
    passed = [whiteness(rng.standard_normal(600), one).p_value for _ in range(100)]
    assert 0.3 < np.mean(passed) < 0.7
    assert np.mean(np.array(passed) < 0.05) < 0.15
    white = rng.standard_normal(601)
    test = whiteness(white[1:] + 0.5 * white[:-1], one)
    assert test.autocorrelation[0] == pytest.approx(0.4, abs=0.1)
    assert test.p_value < 1e-6


def test_lags_do_not_reach_across_gaps() -> None:
    r = np.tile([1.0, -1.0], 50)
    assert whiteness(r, np.arange(100)).statistic == 0.0
    assert whiteness(r, np.zeros(100, dtype=np.intp)).autocorrelation[0] == pytest.approx(-0.99)


def test_a_constant_correlates_with_nothing() -> None:
    assert correlation(np.ones(5), np.arange(5.0)) == 0.0
    assert correlation(np.arange(5.0), -np.arange(5.0)) == pytest.approx(-1.0)
    assert whiteness(np.ones(40), np.zeros(40, dtype=np.intp)).p_value == 1.0


# --- regimes ----------------------------------------------------------------------------------------------


def _found(forces: Forces, case: Case) -> dict[str, Regime]:
    return {r.name: r for r in regimes(forces, vehicle_of(case), _sigma(forces, case))}


def test_regimes_are_what_their_names_say(complete: Comparison, case: Case) -> None:
    forces = complete.forces
    found = _found(forces, case)
    speed = np.linalg.norm(forces.velocity[:, :3], axis=1)
    bands = [found[n].inside[:, 0] for n in ("slow", "medium", "fast")]
    np.testing.assert_array_equal(sum(b.astype(int) for b in bands), 1)
    assert speed[bands[0]].max() <= speed[bands[2]].min()
    rate = np.abs(forces.velocity[:, 3])
    assert rate[found["turning"].inside[:, 3]].min() > rate[found["straight"].inside[:, 3]].max()
    assert (
        forces.pose[found["shallow"].inside[:, 0], 2].max()
        <= forces.pose[found["deep"].inside[:, 0], 2].min()
    )
    for name, sign in (("control force positive", 1), ("control force negative", -1)):
        assert np.all(sign * forces.control[found[name].inside] > 0)


def test_a_reversal_is_near_a_change_of_sign(complete: Comparison, case: Case) -> None:
    forces = complete.forces
    inside = _found(forces, case)["reversing"].inside
    changes = np.flatnonzero(np.diff(np.sign(forces.velocity[:, 3])) != 0)
    for k in np.flatnonzero(inside[:, 3]):
        assert np.min(np.abs(changes - k)) <= 3


def test_start_up_and_coasting_are_told_by_the_commands() -> None:
    run = surge_run(0.01)
    silent = np.where((run.t > 10) & (run.t < 20), 0.0, np.abs(run.channels["tau_X"]) + 0.1)
    forces = residual_forces(true_surge(), [replace(run, channels={**run.channels, "tau_X": silent})])
    found = {r.name: r.inside[:, 0] for r in regimes(forces, surge_vehicle(), np.array([0.0, 0.01]))}
    coasting, starting = forces.t[found["coasting"]], forces.t[found["start-up"]]
    assert coasting.min() > 10
    assert coasting.max() < 20
    assert starting.min() > 18
    assert starting.max() < 30


def test_thirds_are_thirds_of_every_run(complete: Comparison, case: Case) -> None:
    forces = complete.forces
    found = _found(forces, case)
    for run in (0, 1):
        shares = [
            found[f"{n} third"].inside[forces.run == run, 0].mean() for n in ("first", "middle", "last")
        ]
        np.testing.assert_allclose(shares, 1 / 3, atol=0.03)


# --- the error map and the sentence -----------------------------------------------------------------------


def test_a_complete_model_fails_nowhere(complete: Comparison) -> None:
    assert complete.result.headline.startswith("no residual clearly exceeds the noise")
    assert complete.result.prediction_error is not None
    assert complete.result.prediction_error < 0.1


def test_a_lacking_model_fails_where_its_effect_acts(lacking: Comparison) -> None:
    worst = lacking.result.worst
    assert worst is not None
    assert worst.degree_of_freedom in ("sway", "yaw")
    assert lacking.result.headline == headline(worst)
    assert lacking.result.headline.startswith(f"fails most in {worst.degree_of_freedom} ")
    unit = "N" if worst.degree_of_freedom == "sway" else "N m"
    assert f"{worst.residual_rms:.3g} {unit}, noise explains" in lacking.result.headline
    assert worst.normalised == max(c.normalised for c in lacking.result.cells if c.normalised is not None)


def test_a_field_with_few_samples_is_empty(complete: Comparison) -> None:
    for cell in complete.result.cells:
        assert (cell.normalised is None) == (cell.samples < 20)


def test_without_samples_nothing_is_claimed() -> None:
    empty = Cell(degree_of_freedom="surge", group="speed", regime="slow", phrase="at low speed", samples=3)
    assert headline(None) == headline(empty) == "too few samples to say where the model fails"


def test_the_result_survives_json(lacking: Comparison) -> None:
    text = lacking.result.to_json()
    assert ComparisonResult.model_validate_json(text) == lacking.result
    assert json.loads(text)["schema_id"] == "undertow/comparison/1"


def test_numbers_that_do_not_exist_are_null() -> None:
    vehicle = true_surge()
    wild = vehicle.with_values({"X_uabsu": replace(vehicle.value_of("X_uabsu"), value=5e4)})
    result = compare(wild, [surge_run(0.02)]).result
    assert result.diverged == 1
    assert result.channels[0].free_run_fit is None
    assert "Infinity" not in result.model_dump_json()


def test_a_short_log_is_predicted_over_half_of_it() -> None:
    result = compare(true_surge(), [surge_run(0.02).slice(0.0, 8.0)]).result
    assert result.horizon == pytest.approx(4.0)
    assert result.windows == 2


# --- tables for pictures ----------------------------------------------------------------------------------


def test_a_variable_that_tells_comes_first() -> None:
    vehicle = true_surge()
    without = vehicle.with_values({"X_uabsu": replace(vehicle.value_of("X_uabsu"), value=0.0)})
    forces = residual_forces(without, [surge_run(0.01, s) for s in range(3)])
    found = sorted(profiles(forces, without, ()), key=informativeness, reverse=True)
    assert found[0].variable == "u"
    drag = -TRUTH["X_uabsu"] * np.abs(found[0].centre) * found[0].centre
    np.testing.assert_allclose(found[0].force, drag, atol=0.06)


def test_pictures_get_what_they_show(lacking: Comparison, complete: Comparison) -> None:
    table = errors_by_regime(lacking)
    order = [r.name for r in lacking.regimes]
    assert [*table.regimes] == sorted(table.regimes, key=order.index)
    assert table.before.shape == (3, len(table.regimes))
    assert np.nanmax(table.before) == lacking.result.worst.normalised  # type: ignore[union-attr]
    for found, whole in ((traces(lacking), 0.9), (traces(lacking, free=True), 0.95)):
        assert [t.channel for t in found[0].traces] == ["x", "y", "psi", "u", "v", "r"]
        assert np.isfinite(found[0].traces[3].before).mean() > whole
    assert {c.before.degree_of_freedom for c in curves(lacking)} == {"surge", "sway", "yaw"}
    assert all(c.before.degree_of_freedom == "yaw" for c in leading(curves(lacking), "yaw"))
    assert list(budgets(complete)[0].shares)[-1] == "unexplained"


def test_a_model_with_values_by_run_stands_beside_one_without(case: Case, complete: Comparison) -> None:
    """It is judged by the last two thirds of every run, and drawn at their times."""
    vehicle = true_vehicle(case)
    name = next(n for n in vehicle.values if n.startswith("X_u") and not n.endswith("dot"))
    own = replace(vehicle.value_of(name), per_run=True, estimate=True, sigma=1.0)
    by_run = compare(vehicle.with_values({name: own}), runs_of(case))
    for one, other in ((complete, by_run), (by_run, complete)):
        for run, log in zip(traces(one, other, free=True), runs_of(case), strict=True):
            for trace in run.traces:
                assert (
                    len(trace.t) == len(trace.measured) == len(trace.before) == len(trace.after) == len(log.t)
                )
            psi = next(t for t in run.traces if t.channel == "psi")
            late = psi.after if other is by_run else psi.before
            assert np.isnan(late[psi.t < psi.t[0] + 0.3 * np.ptp(psi.t)]).all()
            assert np.nanmax(np.abs(late - psi.measured)) < 0.3


def test_a_free_run_across_gaps_is_called_pieces() -> None:
    whole = surge_run(0.01, 1)
    rows = np.ones(len(whole.t), dtype=bool)
    rows[[*range(40, 60), *range(90, 110)]] = False
    broken = replace(whole, t=whole.t[rows], channels={n: v[rows] for n, v in whole.channels.items()})
    one, three = (traces(compare(true_surge(), [run]), free=True)[0].caption for run in (whole, broken))
    assert one == "simulated without any correction"
    assert three.startswith("simulated without any correction between gaps, in 3 pieces")


def test_shares_of_the_budget_add_up_to_one(lacking: Comparison) -> None:
    for dof in lacking.result.degrees_of_freedom:
        shares = [s.share for s in lacking.result.budget if s.degree_of_freedom == dof]
        assert sum(shares) == pytest.approx(1.0)


def test_two_models_share_a_picture(case: Case, complete: Comparison) -> None:
    guess = compare(vehicle_of(case), runs_of(case))
    table = errors_by_regime(guess, complete)
    assert table.after is not None
    assert np.nanmedian(table.before) > np.nanmedian(table.after)
    both = traces(guess, complete)[0].traces[0]
    assert both.after is not None
    assert curves(guess, complete)[0].after is not None
