"""Closed loops: commands that oppose a disturbance are no evidence of an effect of commands."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from tests.control.test_certificates import loaded
from tests.identification.logs_of import prepared
from tests.identification.test_evidence import NO_EVIDENCE
from tests.quick import first_quick
from undertow.identification.diagnosis.bench import Bench, open_bench
from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.evidence import (
    FoundEffect,
    compare_scores,
    p_value_by_prediction_error,
)
from undertow.identification.diagnosis.grading import feedback_doubt
from undertow.identification.diagnosis.prediction_gain import PredictionGain
from undertow.identification.diagnosis.trial import try_candidate
from undertow.identification.doctor.dynamics import dynamics_of, reversed_commands
from undertow.identification.estimation.prediction_error import AutoregressiveNoise
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue

STEP = 0.1
MASS, DRAG = 18.0, 6.0  # kg with added mass, kg/s
RMS, LASTING = 4.0, 8.0  # of the disturbance, N and s
VEHICLE = """
schema = "undertow/vehicle/1"
name = "float"
degrees_of_freedom = ["surge"]
signs = "sname"

[effects.rigid_body]
m = "12 kg"

[effects.added_mass]
X_udot = { value = -6.0, estimate = true, sigma = 1.0 }

[effects.linear_damping]
X_u = { value = -6.0, estimate = true, sigma = 2.0 }

[[thrusters]]
name = "jet"
position = ["0 m", "0 m", "0 m"]
direction = [1, 0, 0]
limit = "40 N"
"""


def _run(seed: int, dead: float, *, held: bool, seconds: float = 80.0) -> Run:
    """A vehicle in a slow disturbance; it is held in place by what is logged, or driven by steps.

    dead: dead band of the thruster, N.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, STEP)
    x, u, d = np.zeros((3, len(t)))
    command = np.repeat(rng.uniform(-6.0, 6.0, len(t) // 30 + 1), 30)[: len(t)]
    noise = np.array([[0.01], [0.005]]) * rng.standard_normal((2, len(t)))
    stay = np.exp(-STEP / LASTING)
    for i in range(len(t) - 1):
        if held:
            at, rate = np.array([x[i], u[i]]) + noise[:, i]
            command[i] = np.clip(-30.0 * at - 40.0 * rate, -40.0, 40.0)
        thrust = np.sign(command[i]) * max(abs(command[i]) - dead, 0.0)
        u[i + 1] = u[i] + STEP / MASS * (thrust + d[i] - DRAG * u[i])
        x[i + 1] = x[i] + STEP * 0.5 * (u[i] + u[i + 1])
        d[i + 1] = stay * d[i] + RMS * np.sqrt(1.0 - stay**2) * rng.standard_normal()
    channels = {"x": x + noise[0], "u": u + noise[1], "jet": command}
    return Run(f"{seed}", t, channels, sha256=f"{seed}")


@cache
def _candidate(
    effect: str, value: float, *, dead: float, held: bool, seconds: float = 80.0
) -> tuple[FoundEffect, Bench]:
    """An effect fitted to half of the runs, from this value."""
    vehicle, runs = loaded(VEHICLE), [_run(seed, dead, held=held, seconds=seconds) for seed in range(4)]
    bench = open_bench(vehicle, *prepared(vehicle, runs[:2], runs[2:]))
    candidate = Candidate(catalogue()[effect], vehicle)
    start = bench.base.values | {p.name: value for p in candidate.parameters}
    return FoundEffect(try_candidate(candidate, bench, start), *NO_EVIDENCE), bench


@pytest.mark.parametrize(
    ("effect", "start"), first_quick([("thruster_deadband", 2.0), ("actuation_delay", 0.3)])
)
def test_a_controller_that_opposes_a_disturbance_is_no_effect(effect: str, start: float) -> None:
    """Its commands look like thrust that is lost, or late."""
    finding, bench = _candidate(effect, start, dead=0.0, held=True)
    usual = compare_scores(bench.base_score, finding.trial.score, bench.test)
    assert usual.p_value < 0.01
    assert p_value_by_prediction_error(finding, bench) > 0.1
    assert "oppose a disturbance" in feedback_doubt(finding, bench, among=1)


def test_inertia_is_found_with_process_noise() -> None:
    """Without, thrust that does not move a vehicle is thrust on a much heavier one."""
    _, bench = _candidate("thruster_deadband", 2.0, dead=0.0, held=True)
    assert bench.base.values["X_udot"] < -60.0
    assert bench.base_by_prediction_error.values["X_udot"] == pytest.approx(-6.0, abs=2.0)


@pytest.mark.slow
def test_a_dead_band_shows_with_process_noise() -> None:
    finding, bench = _candidate("thruster_deadband", 2.0, dead=4.0, held=False, seconds=150.0)
    assert finding.trial.fit.values["deadband_width"] == pytest.approx(4.0, rel=0.25)
    assert p_value_by_prediction_error(finding, bench) < 2e-3
    assert feedback_doubt(finding, bench, among=4) == ""


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_reversed_commands_are_distinguished_from_a_controller(sign: float) -> None:
    runs = [_run(0, 0.0, held=True)]
    wired = [replace(r, channels=r.channels | {"jet": sign * r.channels["jet"]}) for r in runs]
    vehicle = loaded(VEHICLE)
    at = dynamics_of(vehicle, wired)
    assert at is not None
    assert at.predicted_better(reversed_commands(vehicle)[0]) == (sign < 0)


def test_what_makes_a_vehicle_respond_less_is_no_better_prediction() -> None:
    """With commands that oppose an unknown force, a simulation is worse than no motion at all."""
    before = {h: np.full((20, 2), 3.6) for h in (2.0, 4.0, 14.0)}
    gain = PredictionGain.of(before, {h: 0.7 * squares for h, squares in before.items()})
    assert gain.useless == (2.0, 4.0, 14.0)
    assert not gain.suffices(0.1)
    assert not gain.helps(0.1)
    assert "worse than no motion" in gain.shortfall(0.1)
    assert PredictionGain.of(before, {h: 0.2 * squares for h, squares in before.items()}).suffices(0.1)


@pytest.mark.parametrize("waves", [False, True])
def test_one_step_predictions_leave_white_noise(waves: bool) -> None:
    """A slow force, or narrow-band waves."""
    e = np.random.default_rng(6).standard_normal((2, 2000))
    true = [2.0 * 0.97 * np.cos(0.5), -(0.97**2)] if waves else [0.9]
    series = lfilter([1.0], [1.0, *(-c for c in true)], e)
    found = AutoregressiveNoise.of([*series])
    assert found.coefficients == pytest.approx(true, abs=0.05)
    errors = found.innovations(series[1])[len(true) :]
    assert np.mean(errors**2) == pytest.approx(1.0, rel=0.1)
    assert np.mean(errors[1:] * errors[:-1]) == pytest.approx(0.0, abs=0.07)
