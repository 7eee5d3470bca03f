"""Logs that are too short for a method are refused with its own number, not fitted to nonsense."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.identification.long_surge import simulated, steps
from tests.identification.surge import INTERVAL, surge_run, surge_vehicle
from undertow.errors import UndertowError
from undertow.identification.api import Estimator, Method, fit
from undertow.identification.diagnosis.validation import SimulationValidator
from undertow.identification.estimation.data import channel_noise
from undertow.identification.estimation.windows import cut, longest_segment, possible_horizon
from undertow.identification.logs.run import Run

VEHICLE = surge_vehicle()
_NOISE = 0.005 * np.random.default_rng(0).standard_normal(60)
_WHOLE = simulated(steps(60, 1, hold=10, size=2.0), _NOISE)


def first(samples: int) -> Run:
    return Run("short", _WHOLE.t[:samples], {n: a[:samples] for n, a in _WHOLE.channels.items()})


@pytest.mark.parametrize(
    ("method", "samples", "needed", "form"),
    [
        ("weak", 20, 21, "weak form"),
        ("integral", 5, 6, "integral form"),
        ("instrumental", 20, 21, "weak form"),
    ],
)
def test_the_least_number_of_samples_is_that_of_the_method(
    method: Method, samples: int, needed: int, form: str
) -> None:
    with pytest.raises(
        UndertowError,
        match=rf"for the {form}: .* {samples} \(of {samples} in 'short'\), and {needed} are needed",
    ):
        Estimator(method, None).fit(VEHICLE, [first(samples)])
    with pytest.raises(UndertowError, match=f"are too short for --method {method}: 3 parameters need"):
        Estimator(method, None).fit(VEHICLE, [first(needed)])


def test_pieces_that_are_too_short_tell_to_give_a_run_for_validation() -> None:
    with pytest.raises(UndertowError, match=r"longer stretch, or a run for validation, .* \(--validation\)"):
        Estimator("weak", None).fit(VEHICLE, [replace(first(20), part_of="whole")])


@pytest.mark.parametrize(
    ("method", "samples", "equations"),
    [("weak", 30, 2), ("integral", 8, 3), ("instrumental", 30, 2), ("prediction-error", 4, 2)],
)
def test_as_many_parameters_as_equations_are_refused(method: Method, samples: int, equations: int) -> None:
    said = f"'short' {samples} samples.* --method {method}: 3 parameters .* they make {equations}:"
    with pytest.raises(UndertowError, match=said):
        Estimator(method, None).fit(VEHICLE, [first(samples)])


def test_a_parameter_with_a_prior_needs_no_equation() -> None:
    stated = {
        n: replace(VEHICLE.value_of(n), value=v, sigma=0.1 * abs(v))
        for n, v in (("X_u", -0.3), ("X_uabsu", -4.0))
    }
    fit = Estimator("weak").fit(VEHICLE.with_values(stated), [first(30)])
    assert fit.values["X_u"] == pytest.approx(-0.3, abs=0.2)


@pytest.mark.parametrize("method", ["weak", "integral", "instrumental", "prediction-error"])
def test_a_longer_log_is_fitted(method: Method) -> None:
    fit = Estimator(method, None).fit(VEHICLE, [first(60)])
    assert fit.values["X_udot"] == pytest.approx(-1.1, abs=1.5)


def test_validation_logs_full_of_gaps_are_predicted_as_far_as_they_go() -> None:
    """Windows of 5 s fit into none of their stretches, which last 2.8 s, though the log lasts 30 s."""
    run = surge_run(0.01)
    u = np.where(np.arange(len(run.t)) % 15 == 14, np.nan, run.channels["u"])
    gappy = replace(surge_run(0.01, 1), channels={**run.channels, "u": u})
    stretch = longest_segment(VEHICLE, gappy)
    assert stretch == pytest.approx(13 * INTERVAL)
    done = fit(VEHICLE, [run], [gappy], method="weak")
    assert done.before.windows.horizon == pytest.approx(0.5 * stretch)
    assert len(done.before.windows) == 20
    judge = SimulationValidator(VEHICLE, [run], [gappy], channel_noise([gappy], ("x", "u")))
    assert judge.windows.horizon == pytest.approx(stretch)
    assert all(horizon <= stretch for horizon in judge.horizons)


def test_a_slow_log_is_predicted_over_samples_that_it_has() -> None:
    """A glider reports every 20 s: 5 s ahead there is nothing to compare with, in 2 h of log."""
    t = np.arange(0.0, 7200.0, 20.0)
    run = Run("glider", t, {"u": np.sin(0.01 * t), "tau_X": np.cos(0.01 * t)})
    assert possible_horizon(VEHICLE, [run], 5.0) == 40.0
    assert len(cut([run], VEHICLE, 40.0)) == 179
    with pytest.raises(UndertowError, match=r"5 s hold fewer than 3 samples of 'glider': .* 40 s or more"):
        cut([run], VEHICLE, 5.0)
    judge = SimulationValidator(VEHICLE, [run], [run], channel_noise([run], ("x", "u")))
    assert judge.windows.horizon == 380.0  # 20 samples


def test_short_holes_of_a_fast_log_end_no_window() -> None:
    """At 200 Hz, 60 ms without a sample are twelve steps, and nothing for a vehicle of this mass."""
    t = np.arange(0.0, 20.0, 0.005)
    t = t[t % 2.0 >= 0.06]
    run = Run("fast", t, {"u": np.sin(t), "tau_X": np.cos(t)})
    assert longest_segment(VEHICLE, run) == pytest.approx(20.0, abs=0.1)
    assert len(run.segments(["u"])) == 10
    assert len(cut([run], VEHICLE, 5.0)) == 4
