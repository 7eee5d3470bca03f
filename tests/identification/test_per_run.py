"""Parameters with a value in every run: found, tested, written, and adapted to a run that was not fitted."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hidden_effects import Case, make_case
from benchmarks.trust.cases import Planned
from benchmarks.trust.material import simulated, written_to_memory
from benchmarks.trust.sizing import sized
from tests.identification.logs_of import runs_of, true_vehicle, vehicle_of, with_effect
from tests.quick import first_quick
from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.identification.api import Estimator, fit
from undertow.identification.comparison import compare
from undertow.identification.diagnose import diagnose
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.weak_form import adapted, fit_weak, fit_weak_by_run
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.saving import save_vehicle
from undertow.model.vehicle import Value, Vehicle

CURRENTS = {"steps": (0.2, 0.1), "cruise": (-0.15, 0.1), "multisine": (0.05, -0.25), "holdout": (-0.1, -0.2)}
PER_RUN = ("ocean_current", "wind", "waves", "net_buoyancy", "trim_offset", "supply_droop")


def in_current(run: Run, north: float, east: float) -> Run:
    """The run in a uniform current: seen from water that moves, nothing is different."""
    channels = dict(run.channels)
    (cf, ct, cp), (sf, st, sp) = (
        [f(channels[name]) for name in ("phi", "theta", "psi")] for f in (np.cos, np.sin)
    )
    to_ned = [
        [cp * ct, -sp * cf + cp * st * sf, sp * sf + cp * cf * st],
        [sp * ct, cp * cf + sf * st * sp, -cp * sf + st * sp * cf],
    ]
    for name, n, e in zip("uvw", *to_ned, strict=True):
        channels[name] = channels[name] + north * n + east * e
    elapsed = run.t - run.t[0]
    channels |= {"x": channels["x"] + north * elapsed, "y": channels["y"] + east * elapsed}
    return replace(run, channels=channels)


@cache
def _case(seed: int, noise: float = 1.0) -> Case:
    return make_case("usv", (), seed, duration=60.0, noise=noise)


def _dives(case: Case, currents: dict[str, tuple[float, float]]) -> list[Run]:
    return [in_current(run, *currents[run.name]) for run in runs_of(case) if run.name in currents]


def _vehicle(case: Case) -> Vehicle:
    return with_effect(vehicle_of(case), "ocean_current", V_N=0.0, V_E=0.0)


def _assert_found(found: Fitted) -> None:
    for table, place in zip(found.between_runs, (0, 1), strict=True):
        for run, value in table.values.items():
            assert abs(value - CURRENTS[run][place]) < 3.0 * table.standard_errors[run]
        assert table.p_value < 1e-12


# --- estimation -----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", first_quick(["weak", "output-error"]))
def test_a_current_of_its_own_is_found_for_every_run(method: str) -> None:
    case = _case(3, noise=2.0)
    runs = _dives(case, {n: CURRENTS[n] for n in ("steps", "cruise", "multisine")})
    found = Estimator(method=method).fit(_vehicle(case), runs)  # type: ignore[arg-type]
    _assert_found(found)
    truth = true_vehicle(case)
    shared = [n for n in found.model.free if "@" not in n]
    far = [abs(found.values[n] - truth.value_of(n).value) / found.standard_errors[n] for n in shared]
    assert np.sqrt(np.mean(np.square(far))) < 2.0
    north = found.between_runs[0]
    assert north.spread == pytest.approx(np.std([0.2, -0.15, 0.05], ddof=1), rel=0.3)
    value = found.vehicle.value_of("V_N")
    assert (value.value, value.per_run) == (pytest.approx(0.1 / 3, abs=0.01), True)
    assert value.sigma == pytest.approx(north.spread, rel=0.3)


def test_segments_evaluated_at_once_are_as_one_by_one() -> None:
    vehicle = with_effect(_vehicle(_case(3)), "radiation_memory", X_memu=-10.0, T_memory=2.0)
    data = prepare(_dives(_case(3), {n: CURRENTS[n] for n in ("steps", "cruise")}), vehicle)
    model = WeakModel(
        Functions(vehicle),
        ["N_r", "X_memu", "T_memory", *(f"{n}@{r}" for n in ("V_N", "V_E") for r in CURRENTS)],
    )
    p = model.initial_p({f"V_N@{run}": north for run, (north, _) in CURRENTS.items()})
    whole = model.linearise(data, p)
    assert len(whole) == len(data.segments) > len(data.batches)
    for part, segment in zip(whole, data.segments, strict=True):
        (alone,) = model.linearise(replace(data, segments=(segment,)), p)
        for name in ("r", "J", "start"):
            np.testing.assert_array_equal(getattr(part, name), getattr(alone, name), err_msg=name)


@pytest.mark.slow
def test_prediction_error_has_values_by_run_too() -> None:
    dives = _dives(_case(4), {n: CURRENTS[n] for n in ("steps", "multisine")})
    runs = [run.slice(0.0, 20.0) for run in dives]
    _assert_found(Estimator(method="prediction-error").fit(_vehicle(_case(4)), runs))


@pytest.mark.slow
@pytest.mark.parametrize("seed", first_quick(range(5, 11)))
def test_runs_in_the_same_current_share_one_value(seed: int) -> None:
    runs = _dives(_case(seed), dict.fromkeys(("steps", "cruise", "multisine"), (0.15, -0.1)))
    vehicle = _vehicle(_case(seed))
    data = prepare(runs, vehicle)
    together, plain = fit_weak_by_run(vehicle, data), fit_weak(vehicle, data)
    assert not together.between_runs
    assert together.values == plain.values
    assert together.values["V_N"] == pytest.approx(0.15, abs=3 * together.standard_errors["V_N"])


def test_the_file_may_ask_for_values_by_run_and_deny_them() -> None:
    vehicle = _vehicle(_case(5))
    same = _dives(_case(5), dict.fromkeys(("steps", "cruise"), (0.15, -0.1)))
    asked = replace(vehicle.value_of("V_N"), per_run=True)
    found = fit_weak_by_run(vehicle.with_values({"V_N": asked}), prepare(same, vehicle))
    assert [t.parameter for t in found.between_runs] == ["V_N"]
    assert found.between_runs[0].p_value > 0.01
    denied = {n: replace(vehicle.value_of(n), per_run=False) for n in ("V_N", "V_E")}
    differing = _dives(_case(5), {n: CURRENTS[n] for n in ("steps", "cruise")})
    assert not fit_weak_by_run(vehicle.with_values(denied), prepare(differing, vehicle)).between_runs


@pytest.mark.slow
def test_a_payload_of_every_dive_keeps_its_mass_positive() -> None:
    vehicle = load_vehicle("cybership2")
    own = replace(vehicle.value_of("X_udot"), per_run=True)
    vehicle = vehicle.with_values({"X_udot": own})
    loads = {"empty": -2.0, "loaded": -9.0}
    runs = [_simulated(vehicle, name, i, 1.0, {"X_udot": x}) for i, (name, x) in enumerate(loads.items())]
    (table,) = Estimator(method="output-error").fit(vehicle, runs).between_runs
    for name, true in loads.items():
        assert abs(table.values[name] - true) < 3.5 * table.standard_errors[name]


# --- runs that were not fitted --------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_that_was_not_fitted_teaches_its_own_current_by_its_first_third(tmp_path: Path) -> None:
    runs = _dives(_case(5), CURRENTS)
    vehicle = _vehicle(_case(5))
    done = fit(vehicle, runs[:3], runs[3:])
    own, rest = adapted(done.vehicle, runs[3])
    assert (rest.t[0], rest.t[-1]) == (pytest.approx(20.0, abs=0.1), runs[3].t[-1])
    for name, true in zip(("V_N", "V_E"), CURRENTS["holdout"], strict=True):
        assert own.value_of(name).value == pytest.approx(true, abs=0.003)
    # What judges does not change the value.
    late = {n: np.where(runs[3].t > 20.0, -x, x) for n, x in runs[3].channels.items()}
    again, _ = adapted(done.vehicle, replace(runs[3], channels=late))
    assert again.value_of("V_N").value == own.value_of("V_N").value
    assert done.errors[1] < 0.3 * done.errors[0]
    beside = compare(done.vehicle, runs[3:]).result
    assert beside.prediction_error == pytest.approx(done.errors[1], rel=0.1)
    assert "V_N, V_E from the run up to 19.98 s" in beside.runs[0].notes[-1]
    assert adapted(vehicle, runs[3]) == (vehicle, runs[3])


def test_the_file_has_the_mean_and_its_history_the_values_by_run(tmp_path: Path) -> None:
    template, out = tmp_path / "template.toml", tmp_path / "fitted.toml"
    given = {n: Value(0.0, estimate=True) for n in ("V_N", "V_E")}
    save_vehicle(
        load_vehicle("cybership2").with_effect(catalogue()["ocean_current"], given), "cybership2", template
    )
    model = load_vehicle(template)
    runs = [_simulated(model, f"dive{i}", i, 1.0, {"V_N": v}) for i, v in enumerate((0.1, -0.1))]
    done = fit(model, runs, [_simulated(model, "dive2", 2, 1.0)])
    done.save(template, out)
    text, again = out.read_text(encoding="utf-8"), load_vehicle(out)
    value = again.value_of("V_N")
    assert (value.per_run, value.estimate) == (True, True)
    assert value.value == pytest.approx(done.vehicle.value_of("V_N").value, rel=1e-8)
    assert "per_run = true" in text
    assert "fit to dive0, dive1 (mean of the runs) on" in text
    assert '{run = "dive1", value = -0.1' in text.replace("-0.09", "-0.10")
    assert str(done.by_run[0]) in done.summary()


# --- diagnosis ------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("holdout", [True, False])
def test_a_current_that_differs_between_runs_is_named_with_its_values(holdout: bool) -> None:
    runs = _dives(_case(5), CURRENTS)
    vehicle = vehicle_of(_case(5))
    train, test = (runs[:3], runs[3:]) if holdout else (runs[:3], [])
    d = diagnose(vehicle, train, test).diagnosis
    assert (d.verdict, d.effects) == ("missing_effect", ["ocean_current"])
    for table, place in zip(d.by_run, (0, 1), strict=True):
        for run, value in table.values.items():
            assert abs(value - CURRENTS[run][place]) < 3.0 * table.standard_errors[run]


def _simulated(
    vehicle: Vehicle, name: str, seed: int, size: float, values: dict[str, float] | None = None
) -> Run:
    """A minute of random steps of the commands, with noise on all sensors."""
    rng, functions = np.random.default_rng(seed), Functions(vehicle)
    t, count = np.arange(600) / 10.0, len(vehicle.command_names)
    u = np.repeat(size * rng.uniform(-1, 1, (15, count)), 40, axis=0)
    pairs = zip(functions.parameter_names, functions.values(), strict=True)
    p = np.array([(values or {}).get(n, v) for n, v in pairs])
    names = (*vehicle.pose_names, *vehicle.velocity_names)
    start = np.zeros(functions.x.shape[0])
    start[: len(names)] = [5.0 if n == "z" else 0.5 * (n == "psi") for n in names]
    x = Simulator(functions, compiled=False).run(start, t, u, p, max_step=0.05)
    noise = [0.02 if n in "xyz" else 0.01 if n in "uvw" else 0.002 for n in names]
    measured = x[:, : len(names)] + noise * rng.standard_normal((len(t), len(names)))
    channels = dict(zip(names, measured.T, strict=True)) | dict(zip(vehicle.command_names, u.T, strict=True))
    return Run(name, t, channels, sha256=name)


def _without(vehicle: Vehicle, effect: str) -> Vehicle:
    gone = {n for n in vehicle.values for e in vehicle.effects if e.id == effect for p in e.parameters
            if n.startswith(p.name)}  # fmt: skip
    effects = tuple(e for e in vehicle.effects if e.id != effect)
    return replace(
        vehicle, effects=effects, values={n: v for n, v in vehicle.values.items() if n not in gone}
    )


STRUCTURAL = [
    ("box-hull", 3.0, "quadratic_damping", {}),
    ("cybership2", 1.0, "quadratic_damping", {}),
    ("cybership2", 1.0, "lift", {"Y_uv": -20.0, "N_ur": -4.0, "Y_ur": 6.0}),
    ("cybership2", 1.0, "thruster_gain", {"gain_error_T1": -0.35}),
    ("mini-auv", 1.0, "quadratic_damping", {}),
    ("mini-auv", 1.0, "lift", {"Y_uv": -60.0, "N_uv": 8.0}),
    ("bluerov2", 8.0, "quadratic_damping", {}),
]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "size", "effect", "values"), first_quick(STRUCTURAL))
def test_values_by_run_do_not_absorb_what_a_structural_effect_explains(
    name: str, size: float, effect: str, values: dict[str, float]
) -> None:
    whole = load_vehicle(name)
    lacking = whole if values else _without(whole, effect)
    if values:
        whole = whole.with_effect(catalogue()[effect], {n: Value(v) for n, v in values.items()})
    runs = [_simulated(whole, f"dive{i}", i, share * size) for i, share in enumerate((1.0, 0.6, 0.8, 1.0))]
    known = {i: catalogue()[i] for i in (effect, *PER_RUN)}
    d = diagnose(lacking, runs[:3], runs[3:], known=known, trust_log=True).diagnosis
    assert (d.verdict, d.effects, d.by_run) == ("missing_effect", [effect], [])


@pytest.mark.slow
def test_waves_with_another_phase_in_every_run_are_found() -> None:
    case = make_case("usv", ("waves_per_run",), 3, duration=60.0)
    runs, true = runs_of(case), case.truth["values"]["waves_per_run"]
    known = {i: catalogue()[i] for i in ("waves", "radiation_memory", "constant_force", "sensor_bias")}
    d = diagnose(vehicle_of(case), runs[:3], runs[3:], known=known).diagnosis
    assert (d.verdict, d.effects) == ("missing_effect", ["waves"])
    cos, sin, direction = d.by_run
    for run in ("steps", "cruise", "multisine"):
        assert np.hypot(cos.values[run], sin.values[run]) == pytest.approx(true["amplitude"], rel=0.01)
        off = direction.values[run] - true["direction"]
        assert np.angle(np.exp(1j * off)) == pytest.approx(
            0.0, abs=0.02
        )  # a whole turn is the same direction


@pytest.mark.slow
def test_values_that_only_noise_makes_differ_between_runs_do_not_rule_out_an_effect() -> None:
    """A list of 1 mm under triple noise: the weak form finds three values, with which it predicts worse."""
    case = simulated(sized(Planned.read("ship:trim_offset:r1.27:n3:open:plain:30413423")))
    found = diagnose(*written_to_memory(case)).diagnosis
    assert found.indistinguishable[0].effects == ["trim_offset", "constant_force"]
