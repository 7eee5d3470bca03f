"""Planned manoeuvres: what they promise is what fits find, and limits hold whatever is planned."""

from __future__ import annotations

import re
import tomllib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.identification.surge import surge_vehicle
from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification import result_builder
from undertow.identification.diagnosis.result import Indistinguishable
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.weak_form import fit_under_noise, fit_weak, free_parameters
from undertow.identification.logs.run import Run
from undertow.identification.planning.manoeuvres import (
    REVERSAL,
    Design,
    MotionLimits,
    Start,
    can_be_planned,
    command_limits,
    control_effectiveness,
    extremes,
    motion_axes,
    trim,
)
from undertow.identification.planning.picture import command_csv
from undertow.identification.planning.problem import (
    Manoeuvre,
    PlanningProblem,
    PlanRequest,
    Plant,
    Separation,
    gram_along,
    stated_knowledge,
)
from undertow.identification.planning.rivals import RivalSpec, rival_models
from undertow.identification.planning.search import (
    Planned,
    Separations,
    _SeparationSearch,  # for distances that no log here has
    plan_parameters,
    plan_separation,
    suggest,
)
from undertow.identification.result_builder import ResultBuilder
from undertow.model.catalogue import catalogue
from undertow.model.effect import Curve
from undertow.model.loading import VehicleTable, load_vehicle, resolve_vehicle, vehicle_from_table
from undertow.model.vehicle import Value, Vehicle

SIGMA = 0.01
SHORT = PlanRequest(duration=40.0, rate=10.0, limits={"": 1.0}, noise={"u": SIGMA, "x": np.inf}, tries=40)
LINEAR_OR_QUADRATIC = [RivalSpec("linear_damping", {}), RivalSpec("quadratic_damping", {})]


def test_thrusters_with_a_curve_are_planned_with() -> None:
    """A T200 does nothing about zero: it balances the weight all the same, and every motion can be driven."""
    table = tomllib.loads(resolve_vehicle("bluerov2").read_text(encoding="utf-8"))
    table["thrusters"] = [{**one, "curve": "t200-16v"} for one in table["thrusters"]]
    vehicle = vehicle_from_table(VehicleTable.model_validate(table), catalogue())
    functions, limits = Functions(vehicle), command_limits(vehicle, {"": 1.0}, ())
    effectiveness = control_effectiveness(functions, limits, Start())
    held = trim(functions, limits, effectiveness, Start())
    assert held.unbalanced == {}
    assert np.all(np.abs(held.commands[4:]) > 0.07)  # out of the dead band of each vertical thruster
    assert [axis.name for axis in motion_axes(vehicle, effectiveness, limits.value)] == list(
        vehicle.degrees_of_freedom
    )


SHIP = {"propeller": 18.0, "rudder": 0.5}


@pytest.mark.slow
def test_a_rudder_is_planned_with_though_it_does_nothing_at_rest() -> None:
    vehicle = load_vehicle("kvlcc2")
    request = PlanRequest(duration=150.0, rate=5.0, limits=SHIP, tries=150)
    plan = plan_parameters(vehicle, (), request).plan
    assert plan.undetermined == []
    errors = {p.name: (p.error_after or np.inf) / abs(p.value) for p in plan.parameters}
    for name in ("Y_vdot", "N_rdot", "Y_uv", "Y_ur", "N_ur", "C_N_rudder"):
        assert errors[name] < 0.1
    rudder = next(c for c in plan.commands if c.name == "rudder")
    assert min(-rudder.lowest, rudder.highest) > 0.1


def test_a_manoeuvre_may_begin_under_way() -> None:
    """What holds the speed at the start does hold it."""
    request = PlanRequest(duration=60.0, rate=5.0, limits=SHIP, speed=1.2, tries=1)
    problem = PlanningProblem(request, load_vehicle("kvlcc2"), [Plant.of(load_vehicle("kvlcc2"))], ())
    assert problem.trim.unbalanced == {}
    still = problem.manoeuvres([np.tile(problem.trim.commands, (len(problem.t), 1))])[0].y[0]
    np.testing.assert_allclose(still[:, problem.names.index("u")], 1.2, rtol=1e-3)
    assert any(axis.name == "rudder" for family in problem.families for axis in family.axes)


def test_length_rate_and_speed_are_those_of_the_logs() -> None:
    t, vehicle = np.arange(0.0, 500.0, 0.5), load_vehicle("kvlcc2")
    columns = {"x": t, "y": 0 * t, "psi": 0 * t, "u": 1.0 + 0.1 * np.sin(t), "v": 0 * t, "r": 0 * t}
    log = Run("log", t, columns | {"propeller": 10 + 0 * t, "rudder": 0.3 * np.sin(t / 9)}, sha256="log")
    begun = PlanningProblem(PlanRequest(tries=1), vehicle, [Plant.of(vehicle)], [log])
    assert (begun.duration, begun.rate) == (500.0, 2.0)
    assert begun.speed == pytest.approx(1.0, abs=0.05)
    still = replace(log, channels=log.channels | {"u": np.clip(0.01 * t, 0.0, 1.0)})
    assert PlanningProblem(PlanRequest(tries=1), vehicle, [Plant.of(vehicle)], [still]).speed == 0.0
    assert PlanRequest().sampling(()) == (60.0, 20.0)


def _vehicle(dofs: list[str], effects: dict[str, dict[str, object]], forces: list[str]) -> Vehicle:
    table = {
        "schema": "undertow/vehicle/1",
        "name": "body",
        "degrees_of_freedom": dofs,
        "signs": "magnitudes",
        "generalised_forces": forces,
        "effects": effects,
    }
    return vehicle_from_table(VehicleTable.model_validate(table), catalogue())


def _free(value: float) -> dict[str, object]:
    return {"value": value, "estimate": True}


def _without_drag() -> Vehicle:
    effects = {"rigid_body": {"m": 7.5}, "added_mass": {"X_udot": _free(1.6)}}
    return _vehicle(["surge"], effects, ["tau_X"])


def _log(manoeuvre: Manoeuvre, model: int, seed: int) -> Run:
    """A manoeuvre in surge as it would be logged."""
    noise = SIGMA * np.random.default_rng(seed).standard_normal(len(manoeuvre.t))
    channels = {"u": manoeuvre.y[model][:, 1] + noise, "tau_X": manoeuvre.u[:, 0]}
    return Run(f"log{seed}", manoeuvre.t, channels, sha256=str(seed))


def _errors(planned: Planned) -> dict[str, float]:
    return {p.name: p.error_after or np.inf for p in planned.plan.parameters}


@pytest.fixture(scope="module")
def surge_plan() -> Planned:
    return plan_parameters(surge_vehicle(), (), SHORT)


# --- parameters -------------------------------------------------------------------------------------------


def test_expected_errors_are_those_of_fits_to_the_flown_manoeuvre(surge_plan: Planned) -> None:
    vehicle = surge_vehicle()
    expected = np.array(list(_errors(surge_plan).values()))
    fits = [fit_weak(vehicle, prepare([_log(surge_plan.manoeuvre, 0, seed)], vehicle)) for seed in range(16)]
    reported = np.mean([list(fit.standard_errors.values()) for fit in fits], axis=0)
    np.testing.assert_allclose(reported, expected, rtol=0.3)
    truth = np.array([vehicle.value_of(n).value for n in _errors(surge_plan)])
    scatter = np.sqrt(np.mean((np.array([list(f.values.values()) for f in fits]) - truth) ** 2, axis=0))
    # 16 draws know a standard deviation to 18%.
    np.testing.assert_allclose(scatter, expected, rtol=0.5)


def test_the_plan_beats_a_constant_step_and_a_weak_multisine(surge_plan: Planned) -> None:
    vehicle = surge_vehicle()
    plant = Plant.of(vehicle)
    problem = PlanningProblem(SHORT, vehicle, [plant], ())
    known = stated_knowledge(vehicle, free_parameters(vehicle))
    model = WeakModel(plant.functions, known.free)
    t = problem.t
    by_hand = [np.full((len(t), 1), 1.0), 0.3 * np.sin(2 * np.pi * t / 10.0)[:, None]]
    planned = np.array(list(_errors(surge_plan).values()))
    for manoeuvre in problem.manoeuvres(by_hand):
        gram = gram_along(model, problem.data(manoeuvre, 0), plant.p)
        assert gram is not None
        assert np.prod(planned) < 0.3 * np.prod(known.errors(known.after(gram)))


def test_information_adds_up(surge_plan: Planned) -> None:
    vehicle = surge_vehicle()
    manoeuvre = surge_plan.manoeuvre
    model = WeakModel(Plant.of(vehicle).functions, free_parameters(vehicle))
    p = np.array(model.functions.values())
    noise = np.array([1.0, SIGMA])
    runs = [_log(manoeuvre, 0, seed) for seed in range(2)]
    grams = [gram_along(model, prepare(r, vehicle, sigma=noise), p) for r in ([runs[0]], [runs[1]], runs)]
    assert all(g is not None for g in grams)
    np.testing.assert_allclose(grams[0] + grams[1], grams[2], rtol=1e-9)  # type: ignore[operator]


def test_logs_and_priors_count_before_the_manoeuvre(surge_plan: Planned) -> None:
    vehicle = surge_vehicle()
    assert all(p.error_now is None for p in surge_plan.plan.parameters)
    log = _log(surge_plan.manoeuvre, 0, 1)
    again = plan_parameters(vehicle, [log], replace(SHORT, noise={})).plan
    fit = fit_weak(vehicle, prepare([log], vehicle))
    for known in again.parameters:
        assert known.error_now == pytest.approx(fit.standard_errors[known.name], rel=0.02)
        assert known.error_after is not None
        assert known.error_after < known.error_now
    assert again.criterion > 1.3
    assert again.noise[0].sigma is None
    assert again.noise[1].sigma == pytest.approx(SIGMA, rel=0.2)
    stated_error = vehicle.with_values({"X_u": replace(vehicle.value_of("X_u"), sigma=1e-4)})
    sure = plan_parameters(stated_error, (), replace(SHORT, tries=8)).plan
    assert sure.parameters[1].error_now == pytest.approx(1e-4, rel=1e-3)


def test_errors_of_a_fit_to_the_same_log_do_not_count_twice(surge_plan: Planned) -> None:
    vehicle, log = surge_vehicle(), _log(surge_plan.manoeuvre, 0, 1)
    fit = fit_weak(vehicle, prepare([log], vehicle))
    values = {n: replace(fit.vehicle.value_of(n), source="fit to log1 on 2026-01-01") for n in fit.model.free}
    plan = plan_parameters(fit.vehicle.with_values(values), [log], replace(SHORT, noise={}, tries=8)).plan
    for known in plan.parameters:
        assert known.error_now == pytest.approx(fit.standard_errors[known.name], rel=0.05)
    assert any("are not counted twice" in line for line in plan.remarks)


def test_what_matters_more_gets_better_known() -> None:
    everything = plan_parameters(surge_vehicle(), (), replace(SHORT, tries=80))
    inertia = plan_parameters(surge_vehicle(), (), replace(SHORT, tries=80), only=["X_udot"])
    assert _errors(inertia)["X_udot"] < _errors(everything)["X_udot"]


def test_a_seed_is_a_plan(surge_plan: Planned) -> None:
    again = plan_parameters(surge_vehicle(), (), SHORT)
    assert again.plan == surge_plan.plan
    np.testing.assert_array_equal(again.manoeuvre.u, surge_plan.manoeuvre.u)
    other = plan_parameters(surge_vehicle(), (), replace(SHORT, seed=1))
    assert not np.array_equal(other.manoeuvre.u, surge_plan.manoeuvre.u)


# --- what no manoeuvre determines -------------------------------------------------------------------------


def test_sway_without_sway_thrust_is_named() -> None:
    effects = {
        "rigid_body": {"m": 7.5},
        "linear_damping": {"X_u": _free(2.0), "Y_v": _free(3.0)},
    }
    vehicle = _vehicle(["surge", "sway"], effects, ["tau_X"])
    plan = plan_parameters(vehicle, (), replace(SHORT, noise={}, tries=10)).plan
    assert plan.undetermined == [["Y_v"]]
    verdicts = {p.name: (p.verdict, p.error_after) for p in plan.parameters}
    assert verdicts["Y_v"] == ("not determined", None)
    assert verdicts["X_u"][0] == ""


def test_mass_and_added_mass_are_one_number_in_surge() -> None:
    effects = {
        "rigid_body": {"m": _free(7.5)},
        "added_mass": {"X_udot": _free(1.6)},
        "linear_damping": {"X_u": _free(2.0)},
    }
    plan = plan_parameters(_vehicle(["surge"], effects, ["tau_X"]), (), replace(SHORT, tries=10)).plan
    assert plan.undetermined == [["m", "X_udot"]]


# --- limits -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def auv() -> PlanningProblem:
    vehicle = load_vehicle("mini-auv")
    motion = MotionLimits(speed=0.8, rate=np.radians(45.0), depth=2.0, distance=6.0)
    request = PlanRequest(duration=20.0, rate=10.0, limits={"": 9.0, "f2": 3.0}, motion=motion)
    return PlanningProblem(request, vehicle, [Plant.of(vehicle)], ())


def test_the_vehicle_is_held_against_its_weight(auv: PlanningProblem) -> None:
    weight = -auv.vehicle.value_of("B_net").value
    np.testing.assert_allclose(auv.trim.commands, [-weight / 2, 0.0, -weight / 2, 0.0], atol=1e-6)
    assert not auv.trim.unbalanced
    (still,) = auv.manoeuvres([np.tile(auv.trim.commands, (len(auv.t), 1))])
    np.testing.assert_allclose(still.y[0], 0.0, atol=1e-6)


def test_a_thruster_that_rested_may_go_to_the_end_of_its_curve() -> None:
    vehicle = load_vehicle("bluerov2")
    first, *others = vehicle.thrusters
    curve = Curve.through([(-0.9, -40.0), (0.0, 0.0), (1.1, 50.0)])
    vehicle = replace(vehicle, thrusters=(replace(first, law=curve), *others))
    commands = {n: np.array([0.5, 0.0, -0.1]) for n in vehicle.command_names}
    moved = command_limits(vehicle, {}, [Run("dive", np.arange(3.0), commands)])
    rested = Run("dive", np.arange(3.0), {**commands, first.name: np.zeros(3)})
    known = command_limits(vehicle, {}, [rested])
    assert (moved.value[0], moved.source[0]) == (0.5, "largest in the logs")
    assert (known.value[0], known.source[0]) == (1.1, "end of its curve")
    with pytest.raises(UndertowError, match=f"'{others[0].name}': give --limit"):
        command_limits(vehicle, {}, [])


def _with_propellers(lowest: float | None, limit: float | None = 9.0) -> Vehicle:
    """The mini-AUV, its horizontal thrusters with a lowest command."""
    vehicle = load_vehicle("mini-auv")
    sides = [replace(t, lowest=lowest, limit=limit) if t.wrench[0] else t for t in vehicle.thrusters]
    vehicle = replace(vehicle, thrusters=tuple(sides))
    return vehicle.with_values({"B_net": Value(0.0)})


def test_what_cannot_reverse_goes_about_the_middle_of_its_range() -> None:
    vehicle = _with_propellers(0.0)
    request = PlanRequest(duration=20.0, rate=10.0, limits={"f1": 2.0, "f3": 2.0}, motion=MotionLimits(0.8))
    problem = PlanningProblem(request, vehicle, [Plant.of(vehicle)], ())
    assert problem.limits.low.tolist() == [-2.0, 0.0, -2.0, 0.0]
    assert problem.limits.high.tolist() == [2.0, 9.0, 2.0, 9.0]
    np.testing.assert_allclose(problem.bias, [0.0, 4.5, 0.0, 4.5])
    rng, turns = np.random.default_rng(5), 0.0
    for family in problem.families:
        manoeuvre = problem.simulated(Design(family, rng.random(family.size)))
        assert np.all(manoeuvre.u >= problem.limits.low)
        assert np.all(manoeuvre.u <= problem.limits.high)
        np.testing.assert_allclose(manoeuvre.u[[0, -1]], 0.0, atol=1e-9)
        assert manoeuvre.safe
        assert np.ptp(manoeuvre.u[:, 1]) > 0.1
        rate = manoeuvre.y[0][:, problem.names.index("r")]
        turns = max(turns, float(np.max(np.abs(rate))))
    assert turns > 0.3


def test_one_sided_limits_come_from_the_file_the_logs_or_the_request() -> None:
    vehicle = _with_propellers(0.0)
    known = command_limits(vehicle, {"": 3.0, "f4": (0.0, 5.0)}, ())
    assert (known.low.tolist(), known.high.tolist()) == ([-3, 0, -3, 0], [3, 3, 3, 5])
    with pytest.raises(
        UndertowError, match="--limit 3 for 'f2' is beyond its limit in the vehicle file, 0 to 9"
    ):
        command_limits(vehicle, {"": 3.0, "f2": (-3.0, 3.0)}, ())
    with pytest.raises(UndertowError, match="--limit f1 = 2 to 3 is not a limit"):
        command_limits(vehicle, {"": 3.0, "f1": (2.0, 3.0)}, ())
    vehicle = _with_propellers(None, None)
    ahead, both = np.linspace(0.0, 4.0, 5), np.linspace(-1.0, 4.0, 5)
    log = Run("dive", np.arange(5.0), {"f1": both, "f2": ahead, "f3": both, "f4": ahead})
    seen = command_limits(vehicle, {}, [log])
    assert (seen.low.tolist(), seen.high.tolist()) == ([-4, 0, -4, 0], [4, 4, 4, 4])
    assert seen.source[:2] == ("largest in the logs", "range in the logs")


def test_every_manoeuvre_stays_within_its_limits(auv: PlanningProblem) -> None:
    rng = np.random.default_rng(3)
    bounds, safe = auv.request.motion.as_dict(), 0
    for family in auv.families:
        for _ in range(3):
            manoeuvre = auv.simulated(Design(family, rng.random(family.size)))
            assert np.all(np.abs(manoeuvre.u) <= auv.limits.value)
            np.testing.assert_allclose(manoeuvre.u[[0, -1]], np.tile(auv.trim.commands, (2, 1)), atol=1e-9)
            if manoeuvre.safe:
                safe += 1
                found = extremes(manoeuvre.y[0], auv.names)
                assert all(found[what] <= bounds[what] for what in found)
    assert safe > 2 * len(auv.families)


def test_reversals_reverse() -> None:
    rng, share = np.random.default_rng(5), np.linspace(0.0, 1.0, 2000, endpoint=False)
    for numbers in (np.zeros(3), *rng.uniform(size=(50, 3))):
        wave = REVERSAL.signal(share, 60.0, numbers)
        assert wave.max() == 1.0
        assert wave.min() <= -0.2


def test_motions_and_actuators_are_driven(auv: PlanningProblem) -> None:
    driven = {tuple(a.name for a in f.axes) for f in auv.families}
    assert driven == {("surge", "heave", "yaw"), ("f1", "f2", "f3", "f4"), ("surge", "yaw")}


def test_written_commands_do_not_pass_the_limits(surge_plan: Planned) -> None:
    rows = command_csv(surge_plan).splitlines()
    assert rows[0] == "t,tau_X"
    table = np.array([[float(cell) for cell in row.split(",")] for row in rows[1:]])
    np.testing.assert_allclose(np.diff(table[:, 0]), 0.1, rtol=1e-6)
    assert np.max(np.abs(table[:, 1])) <= 1.0
    np.testing.assert_allclose(table[:, 1], surge_plan.manoeuvre.u[:, 0], atol=1e-5)


def test_a_sinking_vehicle_that_cannot_be_held_is_refused() -> None:
    request = PlanRequest(duration=30.0, rate=10.0, limits={"": 3.0}, tries=5)
    with pytest.raises(
        UndertowError, match=r"--max-depth-change is exceeded.*cannot balance 8.61 N.* in heave"
    ):
        plan_parameters(load_vehicle("mini-auv"), (), request)


# --- telling models apart ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def drag_plan() -> Planned:
    return plan_separation(_without_drag(), LINEAR_OR_QUADRATIC, (), SHORT)


def test_linear_and_quadratic_drag_need_different_speeds(drag_plan: Planned) -> None:
    vehicle = _without_drag()
    problem = PlanningProblem(SHORT, vehicle, [Plant.of(vehicle)], ())
    rivals = rival_models(vehicle, LINEAR_OR_QUADRATIC, catalogue(), problem)
    between = PlanningProblem(SHORT, vehicle, [r.plant for r in rivals], ())
    # At a constant speed one drag does what the other does: ahead at it, from a slow start.
    slowly = np.minimum(between.t / 20.0, 1.0)[:, None]
    (constant,) = between.manoeuvres([0.5 * slowly])
    apart = Separations(rivals, 1.0, with_logs=False).along(between, constant)
    (planned,) = drag_plan.plan.separations
    assert planned.chi_square > 4 * apart[0]
    assert planned.deviations > 5


def test_expected_distance_is_what_fits_find(drag_plan: Planned) -> None:
    specs = [spec.candidate(_without_drag(), catalogue()) for spec in LINEAR_OR_QUADRATIC]
    models = [WeakModel(Plant.of(c.vehicle).functions, c.free()) for c in specs if c]
    found = []
    for truth, rival in ((0, 1), (1, 0)):
        excess = []
        for seed in range(8):
            log = _log(drag_plan.manoeuvre, truth, seed)
            data = prepare([log], _without_drag(), sigma=np.array([1.0, SIGMA]))
            p = np.array(models[truth].functions.values())
            noise = models[truth].whitening(data, p)
            fits = [fit_under_noise(m, data, {}, noise, np.zeros(2)) for m in models]
            excess.append(fits[rival].cost - fits[truth].cost)
        found.append(np.mean(excess))
    assert min(found) == pytest.approx(drag_plan.plan.separations[0].chi_square, rel=0.3)


def test_a_model_is_told_from_the_one_without_the_effect() -> None:
    specs = [RivalSpec("cubic_damping", {"X_uuu": -20.0}), RivalSpec("none", {})]
    plan = plan_separation(surge_vehicle(), specs, (), SHORT).plan
    assert plan.separations[0].deviations > 5
    assert plan.rivals[0].values == {"X_uuu": 20.0}
    assert plan.rivals[0].source == "diagnosis"


@pytest.mark.slow
def test_what_is_the_same_thing_is_reported() -> None:
    effects = {"rigid_body": {"m": 7.5}, "linear_damping": {"Z_w": _free(3.0)}}
    vehicle = _vehicle(["heave"], effects, ["tau_Z"])
    specs = [RivalSpec("net_buoyancy", {"B_net": -0.2}), RivalSpec("constant_force", {"Z_0": 0.2})]
    request = replace(SHORT, noise={}, tries=12)
    plan = plan_separation(vehicle, specs, (), request).plan
    assert plan.separations[0].deviations < 0.1
    assert plan.remarks[0].startswith(
        "no manoeuvre that was tried tells net_buoyancy and constant_force apart"
    )


def test_logs_count_in_the_distance(drag_plan: Planned) -> None:
    log = _log(drag_plan.manoeuvre, 0, 5)
    plan = plan_separation(
        _without_drag(), LINEAR_OR_QUADRATIC, [log], replace(SHORT, noise={}, tries=12)
    ).plan
    (found,) = plan.separations
    assert {r.source for r in plan.rivals} == {"fitted to the logs"}
    assert found.chi_square_now is not None
    assert found.chi_square_now == pytest.approx(drag_plan.plan.separations[0].chi_square, rel=0.5)
    assert found.chi_square > found.chi_square_now


def test_typical_sizes_are_physical(drag_plan: Planned) -> None:
    linear, quadratic = drag_plan.plan.rivals
    assert linear.source == quadratic.source == "typical size"
    # The file prints magnitudes: positive is drag.
    assert 0 < linear.values["X_u"] < 5
    assert 0 < quadratic.values["X_uabsu"] < 20


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["cubic_damping"], "fewer than two"),
        (["cubic_damping", "cubic_damping"], "fewer than two"),
        (["cubic_damping", "none", "none"], "named twice"),
        (["cubic_dampin", "none"], "did you mean 'cubic_damping'"),
        (["quadratic_damping", "none"], "adds no parameter"),
        (["thrusters", "none"], "belongs to the actuators"),
    ],
)
def test_rivals_that_make_no_sense_are_refused(names: list[str], words: str) -> None:
    with pytest.raises(UndertowError, match=words):
        plan_separation(surge_vehicle(), [RivalSpec(n, {}) for n in names], (), SHORT)


def test_a_sentence_for_a_diagnosis(drag_plan: Planned) -> None:
    log = _log(drag_plan.manoeuvre, 0, 5).slice(0.0, 12.0)
    said, apart = suggest(_without_drag(), ["linear_damping", "quadratic_damping"], [log], tries=10)
    assert apart
    assert "linear_damping and quadratic_damping" in said
    assert re.search(r"would put .* apart,? [\d.]+ times as far as these logs do; ", said)
    assert said.endswith("undertow plan --goal separate --between linear_damping,quadratic_damping.")


@pytest.mark.slow
def test_rivals_beside_a_force_that_differs_between_runs_have_one_value_of_it(drag_plan: Planned) -> None:
    """The run that is planned is none of those that the logs hold."""
    effects = {"rigid_body": {"m": 7.5}, "added_mass": {"X_udot": _free(1.6)}}
    pushed = {"constant_force": {"X_0": {"value": 0.1, "estimate": True, "per_run": True}}}
    vehicle = _vehicle(["surge"], effects | pushed, ["tau_X"])
    logs = [_log(drag_plan.manoeuvre, 0, seed) for seed in (5, 6)]
    problem = PlanningProblem(SHORT, vehicle, [Plant.of(vehicle)], logs)
    rivals = rival_models(vehicle, LINEAR_OR_QUADRATIC, catalogue(), problem)
    assert [r.known.free for r in rivals] == [("X_udot", "X_0", "X_u"), ("X_udot", "X_0", "X_uabsu")]


def test_no_run_is_proposed_that_separates_less_than_the_logs_that_did_not(drag_plan: Planned) -> None:
    logs = [_log(drag_plan.manoeuvre, 0, seed) for seed in range(5, 9)]
    said, apart = suggest(_without_drag(), ["linear_damping", "quadratic_damping"], logs, tries=10)
    assert not apart
    assert said.endswith("would put linear_damping and quadratic_damping farther apart than these logs do.")


@pytest.mark.slow
def test_two_effects_are_told_from_one_of_them() -> None:
    specs = [RivalSpec("cubic_damping+dry_friction", {}), RivalSpec("cubic_damping", {})]
    plan = plan_separation(surge_vehicle(), specs, (), replace(SHORT, tries=10)).plan
    both, one = plan.rivals
    assert set(both.values) == {"X_uuu", "X_signu", "friction_speed"}
    assert both.values["friction_speed"] == 0.02
    assert both.values["X_uuu"] == one.values["X_uuu"] > 0
    assert plan.separations[0].deviations > 1


def test_a_model_that_misses_the_logs_is_planned_with_as_stated(surge_plan: Planned) -> None:
    vehicle = surge_vehicle()
    manoeuvre = surge_plan.manoeuvre
    pushed = {"u": manoeuvre.y[0][:, 1], "tau_X": manoeuvre.u[:, 0] + 0.3 * np.sin(manoeuvre.t)}
    noise = SIGMA * np.random.default_rng(0).standard_normal(len(manoeuvre.t))
    log = Run("pushed", manoeuvre.t, pushed | {"u": pushed["u"] + noise}, sha256="0")
    plan = plan_parameters(vehicle, [log], replace(SHORT, noise={}, tries=8)).plan
    assert "planned with the values in its file" in plan.remarks[0]
    assert [p.value for p in plan.parameters] == [1.0, 0.3, 4.0]
    fit = fit_weak(vehicle, prepare([log], vehicle))
    for known in plan.parameters:
        assert known.error_now == pytest.approx(fit.standard_errors[known.name], rel=0.1)


def test_only_what_is_commanded_can_be_planned() -> None:
    """A hull held in waves has no command, and a wind that the log has is chosen by nobody."""
    otter = load_vehicle("otter")
    assert can_be_planned(otter)
    assert not can_be_planned(replace(otter, thrusters=()))
    assert not can_be_planned(replace(otter, inputs={"wind_speed": "m/s"}))


def test_logs_that_tell_models_apart_do_not_deny_a_diagnosis_that_could_not() -> None:
    """The command comes from a diagnosis that found them equally good: noise alone does not decide."""
    pair = Separation(
        pair=("a", "b"), chi_square=200.0, deviations=14.0, chi_square_now=59.0, deviations_now=7.7
    )
    search = SimpleNamespace(rivals=[], inflation=1.0)
    (remark,) = _SeparationSearch._remarks(search, [pair])  # type: ignore[arg-type]
    assert remark.startswith("by the noise of the sensors alone, the existing logs tell all of these models")
    assert remark.endswith("or that they still predict the validation data equally well")


def test_no_plan_is_recommended_that_would_be_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise UndertowError("'section' has no thruster and no known force: nothing can be planned")

    monkeypatch.setattr(result_builder, "suggest", refuse)
    fit = SimpleNamespace(values={})
    one = SimpleNamespace(findings=[SimpleNamespace(id="lift", trial=SimpleNamespace(fit=fit))])
    found = SimpleNamespace(winners=[], effect_set=one, rivals=[[]], vehicle=load_vehicle("otter"))
    settings, validator = SimpleNamespace(manoeuvres=4), SimpleNamespace(train=[])
    builder = SimpleNamespace(found=found, validator=validator, settings=settings, _known=None)
    equals = Indistinguishable(effects=["lift", "wind"], reason="")
    words, separable = ResultBuilder._separating(builder, 0, equals)  # type: ignore[arg-type]
    assert "nothing can be planned" in words
    assert separable is False
