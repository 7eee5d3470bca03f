"""The gain of predictions by an effect, and its size over all parts of the logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from tests.identification.logs_of import prepared, simulated_runs
from tests.identification.surge import surge_run, surge_vehicle
from undertow.identification.diagnosis.bench import open_bench
from undertow.identification.diagnosis.candidates import Candidate, possible
from undertow.identification.diagnosis.consistency import (
    SizeByPart,
    own_variables,
    undetermined,
    vanished_inertia,
    with_effect_zero,
)
from undertow.identification.diagnosis.evidence import FoundEffect
from undertow.identification.diagnosis.grading import (
    Graded,
    Grading,
    Predictions,
    added_mass_doubt,
    dominated,
    substitutes,
    undetermined_by_fits,
)
from undertow.identification.diagnosis.prediction_gain import (
    PredictionGain,
    best_in_resamples,
    gain_of_effects,
    improved_velocities,
)
from undertow.identification.diagnosis.rounds import try_all
from undertow.identification.diagnosis.selection import (
    Selection,
    least_useful,
    merged,
    without_rivals_found_later,
)
from undertow.identification.diagnosis.settings import DEFAULT
from undertow.identification.diagnosis.validation import SimulationValidator
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.weak_form import fit_weak
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle
from undertow.typing import Array


def test_motions_that_an_effect_explains() -> None:
    before = {1.0: np.full((20, 3), 0.04), 10.0: np.full((20, 3), 0.25)}
    after = {1.0: before[1.0] * [0.25, 0.25, 1.0], 10.0: before[10.0] * [0.25, 0.9, 1.5]}
    assert improved_velocities(before, after, 0.1) == [0]


def test_prediction_gain_is_the_fall_of_the_error_over_each_horizon() -> None:
    before = {1.0: np.full((20, 2), 0.04), 10.0: np.full((20, 2), 0.25)}
    after = {1.0: before[1.0] * [1.0, 0.81], 10.0: before[10.0] * [1.0, 0.25]}
    gain = PredictionGain.of(before, after)
    assert gain.falls[1.0] == pytest.approx(1.0 - 0.9**0.5)
    assert gain.falls[10.0] == pytest.approx(1.0 - 0.5**0.5)
    assert gain.largest[10.0] == pytest.approx(0.5)
    assert gain.worse == ()
    assert gain.suffices(0.4)
    assert not gain.suffices(0.6)


def test_what_makes_predictions_over_any_horizon_worse_is_not_worth_adding() -> None:
    rng = np.random.default_rng(1)
    before = {h: rng.uniform(0.5, 1.5, (30, 3)) for h in (1.0, 4.0, 16.0)}
    after = {1.0: before[1.0] * 1.2, 4.0: before[4.0] * 0.3, 16.0: before[16.0] * 0.3}
    gain = PredictionGain.of(before, after)
    assert gain.worse == (1.0,)
    assert gain.helps(0.1)
    assert not gain.suffices(0.1)


@pytest.mark.parametrize(
    ("falls", "worse", "harms"),
    [((0.2, -0.05), (), False), ((0.2, -1.09), (), True), ((0.2, 0.3), (4.0,), True)],
)
def test_what_makes_predictions_worse_is_no_error_of_a_sensor_either(
    falls: tuple[float, float], worse: tuple[float, ...], *, harms: bool
) -> None:
    by_horizon = dict(zip((4.0, 17.0), falls, strict=True))
    assert PredictionGain(by_horizon, by_horizon, worse).harms(DEFAULT.worth) is harms


def test_what_is_lacking_is_said_of_the_horizon_that_it_lacks() -> None:
    falls, largest = {1.0: 0.1, 4.0: -0.03, 16.0: 0.2}, {1.0: 0.2, 4.0: 0.3, 16.0: 0.45}
    words = PredictionGain(falls, largest, ()).shortfall(0.1)
    assert words == "increases the prediction error over 4 s by 3%"
    assert PredictionGain({**falls, 4.0: 0.01}, largest, ()).shortfall(0.1) == ""
    little = PredictionGain({**falls, 4.0: 0.01}, dict.fromkeys(falls, 0.05), ()).shortfall(0.1)
    assert little == "reduces the error of no velocity over 16 s by 10% (5% at most)"


def test_a_gain_that_hangs_on_a_few_windows_is_not_worth_adding() -> None:
    rng = np.random.default_rng(4)
    before = {h: rng.uniform(0.5, 1.5, (8, 2)) for h in (1.0, 4.0, 16.0)}
    some = np.ones((8, 1))
    some[0] = 0.1  # in one window alone the error falls, but for a little
    lucky = PredictionGain.of(
        before, {h: squares * np.where(some < 1, some, 1.02) for h, squares in before.items()}
    )
    assert lucky.largest[16.0] > 0.05
    assert lucky.falls[16.0] > 0.0
    assert not lucky.suffices(0.05)
    assert "of the resamples" in lucky.shortfall(0.05)
    steady = PredictionGain.of(before, {h: squares * 0.8 for h, squares in before.items()})
    assert steady.better[0] == 1.0
    assert steady.suffices(0.05)


def _effect(name: str) -> FoundEffect:
    return cast(FoundEffect, SimpleNamespace(id=name))


def _gain(fall: float) -> PredictionGain:
    return PredictionGain({1.0: fall, 5.0: fall}, {1.0: fall, 5.0: fall}, ())


def _graded(chosen: str, *rivals: str, doubt: str = "") -> Graded:
    return Graded(_effect(chosen), [_effect(r) for r in rivals], _gain(0.2), doubt)


def test_an_effect_may_raise_the_error_of_the_shortest_simulations_by_less_than_matters() -> None:
    """Sensor noise alone moves that error a little; one that rises from 48 to 66% is no improvement."""
    largest = {4.0: 0.0, 8.0: 0.2, 16.0: 0.1}
    little, much = (PredictionGain({4.0: -r, 8.0: 0.12, 16.0: 0.07}, largest, ()) for r in (0.05, 0.37))
    assert little.suffices(0.1)
    assert not much.suffices(0.1)
    assert much.shortfall(0.1) == "increases the prediction error over 4 s by 37%"


def test_of_the_effects_that_improve_predictions_too_little_the_least_useful_is_dropped_first() -> None:
    assert least_useful([_gain(0.2), _gain(0.3)], 0.1) is None
    assert least_useful([], 0.1) is None
    assert least_useful([_gain(0.05), _gain(0.3), _gain(-0.2)], 0.1) == 2


@pytest.mark.parametrize(
    ("clearly", "gain", "doubted"), [(0.95, 0.0, True), (0.95, 0.4, False), (0.6, 0.0, False)]
)
def test_what_is_worth_nothing_beside_a_better_effect_in_doubt_is_not_established(
    clearly: float, gain: float, *, doubted: bool
) -> None:
    """Of two effects as good, a doubt about the one does not speak against the other."""
    best, other = map(_effect, ("best", "other"))
    assert bool(dominated(best, [other], lambda *_: clearly, lambda *_: _gain(gain))) is doubted


def test_an_alternative_takes_over_what_an_effect_gains() -> None:
    """One beside which it gains as much as alone explains something else."""
    chosen, *rivals = map(_effect, ("chosen", "same", "other"))
    beside = {"same": _gain(0.2), "other": _gain(0.7)}
    found = substitutes(chosen, _gain(0.8), rivals, lambda first, _: beside[first.id])
    assert found == rivals[:1]
    assert _gain(0.5).log_fall == pytest.approx(np.log(2.0))


@pytest.mark.parametrize(("doubt", "left"), [("", ["drag"]), ("varies", ["buoyancy", "force", "drag"])])
def test_what_is_needed_beside_an_effect_is_no_rival_of_it(doubt: str, left: list[str]) -> None:
    """Nor is what stands for that; what is in doubt may still be the other explanation."""
    angle = _graded("angle", "buoyancy", "force", "drag")
    first, second = without_rivals_found_later([angle, _graded("buoyancy", "force", doubt=doubt)])
    assert [r.id for r in first.rivals] == left
    assert [r.id for r in second.rivals] == ["force"]


def test_an_effect_that_is_found_in_two_parts_is_one() -> None:
    """What does as well in place of its second part only is no rival of the whole."""
    parts = [_graded("munk", "lift", doubt="varies"), _graded("mass"), _graded("munk", "lift", "drag")]
    whole, mass = merged(parts)
    assert (whole.chosen.id, mass.chosen.id) == ("munk", "mass")
    assert whole.chosen is parts[2].chosen
    assert [r.id for r in whole.rivals] == ["lift"]
    assert whole.doubt == "varies"


def test_runs_as_short_as_the_shortest_horizon_have_that_one_only() -> None:
    assert PredictionGain({2.0: 0.3}, {2.0: 0.4}, ()).suffices(0.1)
    assert "over 2 s by 30%" in PredictionGain({2.0: -0.3}, {2.0: 0.4}, ()).shortfall(0.1)


def test_resamples_share_the_lead_between_candidates_that_differ_by_chance_only() -> None:
    rng = np.random.default_rng(2)
    errors = rng.uniform(0.5, 1.5, (3, 40, 2))
    errors[2] *= 3.0
    share = best_in_resamples([{5.0: e} for e in errors])
    assert share.sum() == pytest.approx(1.0)
    assert share[2] == 0.0
    alone = best_in_resamples([{5.0: errors[0]}, {5.0: 0.8 * errors[0]}])
    assert alone.tolist() == [0.0, 1.0]


@pytest.mark.parametrize("spread", [0.0, 0.7])
def test_spread_between_parts_is_recovered(spread: float) -> None:
    rng = np.random.default_rng(3)
    error = rng.uniform(0.02, 0.1, 2000)
    value = 1.0 + spread * rng.standard_normal(2000) + error * rng.standard_normal(2000)
    found = SizeByPart("runs", value, error)
    assert found.spread == pytest.approx(spread, abs=0.02)
    assert bool(found.doubt()) is (spread > DEFAULT.size_spread)


def test_parts_that_are_hardly_known_do_not_speak_against_an_effect() -> None:
    assert SizeByPart("runs", np.array([0.5, 1.6, 1.0]), np.array([0.45, 0.45, 0.1])).doubt() == ""
    assert "5% to 160%" in SizeByPart("runs", np.array([0.05, 1.6, 1.0]), np.full(3, 0.1)).doubt()


def test_variables_of_an_effect_are_those_of_its_equations() -> None:
    vehicle = load_vehicle("bluerov2")
    found = {
        c.id: own_variables(c, c.base, c.vehicle)
        for c in possible(vehicle, catalogue())
        if not c.adds_nothing
    }
    assert found["constant_force"] == ()
    assert set(found["cubic_damping"]) == set(vehicle.velocity_names)
    assert "psi" in found["ocean_current"]
    assert set(found["thruster_deadband"]) <= {*vehicle.command_names, *vehicle.velocity_names}
    assert found["velocity_lever_arm"] == vehicle.velocity_names
    assert not {"x", "y"} & set(found["radiation_memory"])


def test_what_the_file_states_of_an_effect_is_not_what_a_candidate_adds() -> None:
    """A surge drag that was fitted to zero says nothing against the sway drag that is added to it."""
    candidate = Candidate(catalogue()["quadratic_damping"], load_vehicle("kvlcc2"))
    added = candidate.parameters
    assert {p.name for p in added} == {"Y_vabsv", "N_rabsr"}
    assert {"v", "r"} <= set(own_variables(candidate, candidate.base, candidate.vehicle)) <= {"u", "v", "r"}
    values = {"X_uabsu": 0.0, "Y_vabsv": -50.0}
    assert undetermined(added, values, _covariance([1.0, 1.0])) == ""
    assert "X_uabsu = 0 is at its bound" in undetermined(
        candidate.effect(()).parameters, values, _covariance([1.0, 1.0])
    )


def _covariance(errors: Sequence[float]) -> Array:
    """Of independent parameters with these standard errors."""
    return np.diag(np.square(errors))


@pytest.mark.parametrize(("stiffness", "known"), [(5.7, False), (30.0, True)])
def test_a_tether_of_which_only_a_product_is_known_is_not_named(stiffness: float, known: bool) -> None:
    """A soft spring to a far point with stiffness times length known pulls like a constant force."""
    values = {"k_tension": stiffness, "L_slack": 3457.0, "z_anchor": -3507.0, "x_eye": -2.28}
    errors = [3.1, 4739.0, 4710.0, 0.05]
    words = undetermined(catalogue()["tether_tension"](()).parameters, values, _covariance(errors))
    assert words == "" if known else "k_tension = 5.7 ± 3.1 N/m is not determined" in words


@pytest.mark.parametrize(("error", "known"), [(0.014, True), (0.5, False)])
def test_a_fading_that_is_known_needs_no_size_at_the_boundary(error: float, known: bool) -> None:
    """Far from the boundary the rise and its distance are one factor; that it fades shows in the motion."""
    values = {"boundary_rise": 0.02, "fade_D": 0.74, "fade_0": 12.2}
    boundary = catalogue()["boundary_proximity"](())
    words = undetermined(boundary.parameters, values, _covariance([24.0, error, 1270.0]))
    assert words == "" if known else "boundary_rise = 0.02 ± 24 is not determined" in words


def test_a_length_that_cannot_be_zero_determines_no_size() -> None:
    values = {"T_cross": 6.4e-7, "L_cross": 15.0, "x_cross": -0.014}
    crossflow = catalogue()["crossflow_drag"](())
    words = undetermined(crossflow.parameters, values, _covariance([8e-7, 4.0, 0.001]))
    assert "T_cross = 6.4e-07 ± 8e-07 m is not determined" in words


@pytest.mark.parametrize(("error", "said"), [(0.8, "is not determined by these logs"), (0.1, "")])
def test_a_limit_of_the_commands_that_may_be_any_is_not_named(error: float, said: str) -> None:
    effect = catalogue()["thruster_saturation"](())
    words = undetermined(effect.parameters, {"saturation_limit": 0.66}, _covariance([error]))
    assert words.endswith(said)
    assert bool(words) is bool(said)


@pytest.mark.parametrize(
    ("weak", "predicts", "established", "alternative"),
    [
        ((0.2, 0.05), (0.2, 0.05), True, True),
        ((0.8, 1.2), (0.2, 0.05), False, True),
        ((0.2, 0.05), (0.8, 1.2), False, False),
    ],
)
def test_an_alternative_is_excluded_only_by_the_fit_that_predicts(
    weak: tuple[float, float], predicts: tuple[float, float], *, established: bool, alternative: bool
) -> None:
    """A dead band that the simulation determines, but not the residual force, may be the cause."""

    def fit(value: float, error: float) -> Fitted:
        known = {"values": {"deadband_width": value}, "covariance": np.array([[error**2]])}
        model = SimpleNamespace(free=("deadband_width",))
        return cast(Fitted, SimpleNamespace(model=model, **known))

    effect = catalogue()["thruster_deadband"]
    candidate = SimpleNamespace(effect=effect, parameters=effect(()).parameters)
    trial = SimpleNamespace(candidate=candidate, fit=fit(*weak))
    finding = cast(FoundEffect, SimpleNamespace(trial=trial))
    assert (not undetermined_by_fits(finding, fit(*predicts))) is established
    assert (not undetermined_by_fits(finding, fit(*predicts), alternative=True)) is alternative


@pytest.mark.parametrize("name", ["X_udot", "X_udot_forward"])
@pytest.mark.parametrize(
    ("without", "beside", "value"), [(-5.0, 0.0, -5.0), (-5.0, -1.0, 0.0), (0.0, 0.0, -2.0)]
)
def test_added_mass_that_falls_to_zero_beside_an_effect_is_seen(
    name: str, without: float, beside: float, value: float
) -> None:
    """Beside it, or without it already: then the stated one is what it should be."""
    vehicle = load_vehicle("box-hull" if name == "X_udot" else "mini-auv")
    stated = cast(Vehicle, SimpleNamespace(values={name: Value(-2.0)}))
    fits = [
        cast(
            Fitted, SimpleNamespace(vehicle=vehicle, model=SimpleNamespace(free=(name, "X_u")), values=values)
        )
        for values in ({name: without, "X_u": -1.0}, {name: beside, "X_u": 0.0})
    ]
    assert vanished_inertia(*fits, stated) == ({name: value} if value else {})
    # One that the effect itself brings is not in the vehicle without it.
    assert vanished_inertia(*fits, cast(Vehicle, SimpleNamespace(values={}))) == {}


@pytest.mark.parametrize("alone", [0.4, 0.02])
def test_an_effect_that_is_worth_adding_beside_the_inertia_does_not_replace_it(alone: float) -> None:
    """A current in the log of a simulator without added mass, and a thrust that only trades against it."""
    words = added_mass_doubt(
        ["Y_vdot"], PredictionGain(falls={1.0: alone, 8.0: alone}, largest={1.0: alone, 8.0: alone}, worse=())
    )
    assert words == (
        "" if alone > 0.1 else "with it, Y_vdot would be zero, which is unphysical for added mass"
    )


def test_a_force_whose_direction_is_estimated_is_tested_as_a_vector() -> None:
    """2.2 standard errors of its length are not significant at the level of one parameter at 2."""
    wind = catalogue()["wind"](())
    values = {"area_frontal": 241.0, "wind_from": 0.56}
    said = undetermined(wind.parameters, values, _covariance([110.0, 0.7]))
    assert said == (
        "its size area_frontal = 241 ± 1.1e+02 m^2 is not determined by these logs: any direction was "
        "possible"
    )
    assert undetermined(wind.parameters, values, _covariance([90.0, 0.7])) == ""


def test_a_memory_without_a_time_of_its_own_is_not_named() -> None:
    memory = catalogue()["radiation_memory"](())
    values = {"X_memu": 2.0, "T_memory": 0.4}

    def said(error: float) -> str:
        return undetermined(memory.parameters, values, _covariance([0.1, error]), has_states=True)

    assert "T_memory" in said(0.3)
    assert said(0.1) == ""


def test_a_fit_with_an_effect_set_to_zero_is_the_vehicle_without_it() -> None:
    """The comparison that shows whether predictions are better by the effect or by another local minimum."""
    vehicle, runs = surge_vehicle(), [surge_run(0.01, seed) for seed in (1, 2)]
    data = prepare(runs, vehicle)
    candidate = Candidate(catalogue()["constant_force"], vehicle)
    fit = fit_weak(candidate.model(), data)
    finding = cast(FoundEffect, SimpleNamespace(trial=SimpleNamespace(candidate=candidate)))
    without = with_effect_zero(finding, fit)
    assert without is not None
    assert without.values == fit.values | {"X_0": 0.0}
    plain = fit_weak(vehicle, data, [n for n in fit.model.free if n != "X_0"])
    p = np.array(plain.p)
    p[list(plain.model.places)] = [fit.values[n] for n in plain.model.free]
    validator = SimulationValidator(vehicle, runs[:1], runs[1:], data.sigma)
    squares = (validator.squares_ahead(f) for f in (without, plain.with_parameters(p)))
    for same in zip(*(each.values() for each in squares), strict=True):
        assert same[0] == pytest.approx(same[1], rel=1e-9)


@pytest.mark.parametrize("turn", [0.0, 0.4, 0.8, 1.2])
def test_a_current_is_known_or_unknown_whatever_way_north_is(turn: float) -> None:
    """Of a current only the component along a short line is known: the same in all axes."""
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    covariance = axes @ np.diag([0.1**2, 0.01**2]) @ axes.T
    current = catalogue()["ocean_current"](())

    def said(along: float) -> str:
        north, east = axes @ [0.1, along]
        return undetermined(current.parameters, {"V_N": float(north), "V_E": float(east)}, covariance)

    assert said(0.03) == ""
    assert "are not determined by these logs" in said(0.015)


def test_of_a_current_both_components_are_estimated() -> None:
    """Its axes are not those of the vehicle: that one is zero is no simpler model."""

    def removable(effect: str) -> tuple[str, ...]:
        return Candidate(catalogue()[effect], load_vehicle("cybership2")).removable

    assert removable("ocean_current") == removable("water_speed_log") == ()
    assert Candidate(catalogue()["ocean_current"], load_vehicle("cybership2")).sizes == ("V_N", "V_E")
    assert removable("constant_force") == ("X_0", "Y_0", "N_0")


@pytest.mark.parametrize(
    ("frequency", "error", "said"),
    [
        (0.1, 0.01, "is at its bound"),
        (0.3, 0.2, "frequency"),
        (30.0, 0.1, "is at its bound"),
        (2.0, 0.1, ""),
    ],
)
def test_a_mass_that_swings_has_a_frequency_of_its_own(frequency: float, error: float, said: str) -> None:
    """Slower than any tank it is a drift, quicker a stiff part of the hull."""
    values = {"m_slosh": 9.0, "slosh_frequency": frequency, "slosh_damping": 0.1}
    errors = [1.0, error, 0.01]
    slosh = catalogue()["slosh"](())
    words = undetermined(slosh.parameters, values, _covariance(errors), has_states=True)
    assert said in words if said else words == ""


def test_sensors_are_compared_by_the_pose_and_forces_by_the_velocities() -> None:
    before = {h: np.full((20, 5), 0.04) for h in (1.0, 4.0, 16.0)}  # three velocities, then x and y
    after = {h: squares * [1.0, 1.0, 1.0, 0.25, 0.25] for h, squares in before.items()}
    validator = SimpleNamespace(
        settings=DEFAULT, velocities=lambda squares: {h: each[:, :3] for h, each in squares.items()}
    )
    sensor, force = (cast(FoundEffect, SimpleNamespace(of_sensors=own)) for own in (True, False))
    assert gain_of_effects(before, after, [sensor], validator).largest[16.0] == pytest.approx(0.5)
    assert gain_of_effects(before, after, [force], validator).largest[16.0] == 0.0
    assert gain_of_effects(before, after, [force, sensor], validator).suffices(DEFAULT.worth)


def test_effects_in_doubt_come_after_the_others() -> None:
    selection = Selection([_graded("force", doubt="varies"), _graded("bias")], [], {}, {})
    assert [g.chosen.id for g in selection.established] == ["bias"]
    assert [g.chosen.id for g in selection.established_first.graded] == ["bias", "force"]


def test_an_effect_whose_force_is_not_significant_may_improve_predictions_but_is_not_established() -> None:
    whole, known = load_vehicle("cybership2"), catalogue()
    pushed = whole.with_effect(
        known["constant_force"], {"X_0": Value(0.0), "Y_0": Value(0.2), "N_0": Value(0.0)}
    )
    runs = simulated_runs(pushed, 3, 50.0, seed=3, size=2.0, hold=40, noise=0.002, unlogged=0.01)
    bench = open_bench(whole, *prepared(whole, runs[:2], runs[2:]))
    current = try_all(bench, {"constant_force": known["constant_force"]}, lambda done, words: None)
    predictions = Predictions(
        SimulationValidator(whole, runs[:2], runs[2:], bench.train.sigma), lambda done, words: None
    )
    found = Grading(current, [], predictions).best()
    assert found is not None
    assert found.doubt == ""
    assert Grading(current, [], predictions, significant=False).best() is None  # each is tried once
    hidden = replace(current, findings=[replace(f, p_value=0.5) for f in current.findings])
    assert Grading(hidden, [], predictions).best() is None
    weak = Grading(hidden, [], predictions, significant=False).best()
    assert weak is not None
    assert weak.doubt == "the residual alone does not show its force (p = 0.5)"
    assert weak.gain == found.gain
