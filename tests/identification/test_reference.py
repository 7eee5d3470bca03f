"""How much of what a model leaves could be predicted: a missing term, a disturbance, noise alone."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import prepared, runs_of, vehicle_of
from tests.identification.surge import INTERVAL, M_X, TRUTH, surge_vehicle
from undertow.identification.diagnosis.bench import noise_in_more_equations
from undertow.identification.diagnosis.floors import noise_floors, predictable_in_words
from undertow.identification.diagnosis.predictability import (
    detectable_share,
    is_disturbance,
    predictable,
    share_of_predictable,
)
from undertow.identification.diagnosis.result import Predictability
from undertow.identification.diagnosis.settings import DEFAULT
from undertow.identification.diagnosis.verdict import only_disturbance, without_damping
from undertow.identification.estimation.data import WeakData
from undertow.identification.estimation.weak_form import WeakFit, fit_weak
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value, Vehicle

NOISE = 1e-3  # m/s
STEPS = 20  # of the simulation between samples


def surge_run(seed: int, rms: float, memory: float, duration: float = 100.0) -> Run:
    """Surge under steps of the force, and a disturbance of `rms` N that is correlated over `memory` s."""
    rng, count = np.random.default_rng(seed), round(duration / INTERVAL)
    command = np.repeat(rng.uniform(-0.5, 0.5, 1 + count // 60), 60)[:count]
    keep, u, force = np.exp(-INTERVAL / memory), np.zeros(count), rms * rng.standard_normal()
    for i in range(count - 1):
        u[i + 1] = u[i]
        for _ in range(STEPS):
            drag = TRUTH["X_u"] * u[i + 1] + TRUTH["X_uabsu"] * abs(u[i + 1]) * u[i + 1]
            u[i + 1] += INTERVAL / STEPS * (command[i] + force - drag) / M_X
        force = keep * force + rms * np.sqrt(1 - keep**2) * rng.standard_normal()
    t = INTERVAL * np.arange(count)
    return Run(
        f"{seed}", t, {"u": u + NOISE * rng.standard_normal(count), "tau_X": command}, sha256=f"{seed}"
    )


def _split(vehicle: Vehicle, runs: list[Run]) -> tuple[WeakFit, WeakData]:
    train, aside = prepared(vehicle, runs[:-1], runs[-1:])
    return fit_weak(vehicle, train), aside


@cache
def _ship(*effects: str) -> tuple[WeakFit, WeakData]:
    case = make_case("usv", effects, 1, duration=40.0)
    return _split(vehicle_of(case), runs_of(case))


def _by_motion(*effects: str, variables: tuple[str, ...] | None = None) -> dict[str, Predictability]:
    fit, aside = _ship(*effects)
    return {p.degree_of_freedom: p for p in predictable(fit, fit.data, aside, variables)}


def test_noise_cannot_be_predicted() -> None:
    for found in _by_motion().values():
        assert not found.significant
        assert found.noise_share > 0.85
        assert found.variables == {}


def test_a_missing_lift_can_nearly_all_be_predicted_and_mostly_from_its_own_variables() -> None:
    assert _by_motion("lift")["yaw"].share > 0.8
    own = _by_motion("lift", variables=("u", "v", "r"))["yaw"]
    # The refit without it took up some of it with other values, of the gains of thrusters, too.
    assert own.share > 0.5
    assert set(own.variables) == {"u", "v", "r"}
    assert not _by_motion("lift", variables=("psi",))["yaw"].significant


@pytest.mark.parametrize("memory", [0.5, 5.0])
def test_a_disturbance_is_none_of_the_signals(memory: float) -> None:
    fit, aside = _split(surge_vehicle(), [surge_run(seed, 0.05, memory) for seed in range(4)])
    (found,) = predictable(fit, fit.data, aside)
    assert not found.significant
    assert found.share < 0.02
    # Some of it is averaged away, some goes into the parameters.
    assert 0.02 < found.disturbance_rms < 0.06


@pytest.mark.parametrize("durations", [(5.0, 30.0), (8.0, 30.0), (30.0, 5.0), (30.0, 8.0)])
def test_the_force_of_a_short_log_is_averaged_over_what_it_has(durations: tuple[float, float]) -> None:
    """Noise alone, which longer averages never exceed; one of the logs has no room for them."""
    fit, aside = _split(
        surge_vehicle(), [surge_run(i, 0.0, 1.0, seconds) for i, seconds in enumerate(durations)]
    )
    (found,) = predictable(fit, fit.data, aside)
    assert np.isfinite(found.residual_rms)
    assert 0.0 < found.averaged_over < min(durations)
    assert not found.significant


def test_logs_that_determine_no_damping_do_not_show_that_nothing_is_missing() -> None:
    """At one speed without a force, a body that coasts without drag explains all of it."""
    steered = [surge_run(seed, 0.05, 2.0) for seed in range(4)]
    rng = np.random.default_rng(0)
    steady = [
        replace(r, channels={"u": 0.3 + NOISE * rng.standard_normal(len(r.t)), "tau_X": np.zeros(len(r.t))})
        for r in steered
    ]
    assert without_damping(_split(surge_vehicle(), steered)[0]) == []
    undamped = without_damping(_split(surge_vehicle(), steady)[0])
    assert undamped == ["surge"]
    found = only_disturbance([], 0.0, undamped)
    assert found.verdict == "adequate"
    assert "But these logs determine no damping in surge, and would not show another" in found.headline
    assert "no damping" not in only_disturbance([], 0.0).headline


# --- two floors -------------------------------------------------------------------------------------
@pytest.mark.parametrize(("rms", "memory"), [(0.02, 0.5), (0.1, 2.0)])
def test_a_disturbance_has_a_size_and_a_memory(rms: float, memory: float) -> None:
    fit, _ = _split(surge_vehicle(), [surge_run(seed, rms, memory) for seed in range(4)])
    floors = noise_floors(fit, fit.data)
    (found,) = floors.disturbances
    assert found.rms == pytest.approx(rms, rel=0.25)
    assert found.correlation_time == pytest.approx(memory, rel=0.5)
    (sensor,) = floors.sensors
    assert sensor.sigma == pytest.approx(NOISE, rel=0.25)
    assert (sensor.channel, sensor.unit, sensor.stated, sensor.cut_off) == ("u", "m/s", False, None)


def test_noise_is_no_disturbance_and_what_is_stated_is_shown() -> None:
    stated = {"columns": {"speed": {"channel": "u", "noise": 0.001}}, "disturbance": {"X": "0.4 N"}}
    mapping = LogMapping.model_validate(stated)
    runs = [replace(surge_run(s, 0.0, 1.0), sigma={"u": 0.001}, mapping=mapping) for s in range(4)]
    fit, _ = _split(surge_vehicle(), runs)
    floors = noise_floors(fit, fit.data)
    (found,) = floors.disturbances
    assert (found.rms, found.correlation_time, found.stated) == (0.0, None, 0.4)
    assert floors.sensors[0].stated
    # That of a series on a clock of its own is estimated from its reports, before the fit.
    estimated = [replace(run, mapping=LogMapping(disturbance={"X": "0.4 N"})) for run in runs]
    fit, _ = _split(surge_vehicle(), estimated)
    assert not noise_floors(fit, fit.data).sensors[0].stated


def test_the_sentence_says_what_can_be_predicted_and_what_cannot() -> None:
    left = _predictability("surge", share=0.2, interval=(0.1, 0.31), significant=True)
    noise = _predictability("yaw", share=0.0, interval=(0.0, 0.2), significant=False)
    assert predictable_in_words(0.44, [left, noise]) == (
        "an error of 44% remains; of that at most 31% in surge can be predicted from the logged signals; "
        "the rest is disturbance: 0.4 N rms in surge and 0.4 N rms in yaw"
    )
    pinned = predictable_in_words(0.44, [noise], ["N_rdot"])
    assert pinned.endswith("disturbance, or what drove N_rdot to a physical limit: 0.4 N rms in yaw")
    alone = predictable_in_words(0.44, [noise])
    assert alone.startswith("an error of 44% remains; the logged signals predict no more")


def test_the_sentence_does_not_deny_what_effects_that_are_not_named_predict() -> None:
    """Buoyancy that varies with depth: no position is among the signals, and the effect halves the error."""
    silent = _predictability("heave", share=0.0, interval=(0.0, 0.2), significant=False)
    assert predictable_in_words(0.19, [silent], [], ["hull_compressibility"], 0.102) == (
        "an error of 19% remains (10% with hull_compressibility, not established as the cause); "
        "velocities, attitude and commands predict no more of it than chance; the rest is disturbance, or "
        "hull_compressibility: 0.4 N rms in heave"
    )


def test_the_sentence_compares_errors_in_digits_that_differ_and_denies_no_correlation() -> None:
    """A step in time is no signal, and no disturbance either."""
    silent = _predictability("heave", share=0.0, interval=(0.0, 0.2), significant=False)
    said = predictable_in_words(0.0546, [silent], [], ["lift"], 0.0509, correlates=True)
    assert said.startswith("an error of 5.5% remains (5.1% with lift, not established")
    assert said.endswith("disturbance, or lift and what the residual correlates with: 0.4 N rms in heave")


def _predictability(motion: str, **found: object) -> Predictability:
    size = {
        "unit": "N",
        "averaged_over": 1.0,
        "residual_rms": 1.0,
        "noise_share": 0.64,
        "disturbance_rms": 0.4,
    }
    given = {"degree_of_freedom": motion, "relative_to_inertia": 0.1, "variables": {}, **size, **found}
    return Predictability.model_validate(given)


@pytest.mark.parametrize(
    ("high", "significant", "noisy", "said"),
    [
        (0.10, False, (), True),
        (0.25, False, (), False),  # the logs are too short to say that nothing hides there
        (0.25, False, ("pitch",), True),  # but nothing can hide where the sensors' noise explains all
        (0.10, True, ("pitch",), False),
    ],
)
def test_nothing_hides_in_the_noise_of_the_sensors(
    high: float, *, significant: bool, noisy: tuple[str, ...], said: bool
) -> None:
    common = {"unit": "N m", "averaged_over": 1.0, "residual_rms": 1.0, "share": 0.0, "variables": {}}
    rest = {"noise_share": 0.8, "disturbance_rms": 0.3, "relative_to_inertia": 0.01}
    found = [
        Predictability(degree_of_freedom="heave", interval=(0.0, 0.02), significant=False, **common, **rest),
        Predictability(
            degree_of_freedom="pitch", interval=(0.0, high), significant=significant, **common, **rest
        ),
    ]
    assert is_disturbance(found, noisy) == said


def test_an_effect_that_leaves_the_forces_as_they_are_is_judged_by_what_is_left_of_them() -> None:
    """A sensor that is off may improve only predictions: no force was missing that it could explain."""
    for effects, share in (((), 1.0), (("lift",), 0.0)):
        fit, aside = _ship(*effects)
        assert share_of_predictable(fit, fit, fit.data, aside, ("u", "v", "r")) == share


def test_the_missing_effect_leaves_noise_in_equations_in_which_the_model_without_it_does_not() -> None:
    without, aside = _ship("lift")
    lift = dict.fromkeys(("Y_uv", "N_uv", "Y_ur", "N_ur"), Value(0.0, estimate=True))
    vehicle = without.model.functions.vehicle.with_effect(catalogue()["lift"], lift)
    with_it = fit_weak(vehicle, without.data)
    assert noise_in_more_equations(with_it, without, aside, DEFAULT)
    assert not noise_in_more_equations(without, with_it, aside, DEFAULT)
    assert not noise_in_more_equations(with_it, with_it, aside, DEFAULT)


@pytest.mark.parametrize(("blocks", "correlation"), [(5, 0.878), (10, 0.632), (30, 0.361), (102, 0.195)])
def test_the_least_share_that_can_be_shown_is_that_of_the_critical_correlation(
    blocks: int, correlation: float
) -> None:
    """Two-sided at 5%, as tables of Pearson's correlation have it."""
    assert np.sqrt(detectable_share(blocks)) == pytest.approx(correlation, abs=1e-3)
    assert detectable_share(2) == 1.0
