"""What the weak form adds of its own: the true model without noise, where commands jump or are late."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden_effects import make_case
from tests.identification.logs_of import runs_of, vehicle_of
from tests.quick import first_quick
from undertow.codegen.functions import Functions
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.residual import WeakModel, whitened
from undertow.identification.estimation.test_functions import boxes, kink_delay
from undertow.identification.estimation.test_functions import test_functions as functions_on
from undertow.identification.estimation.weak_form import free_parameters, mean_square
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value

FAINT = 0.3  # of the usual noise: the least that a case of the benchmark has
NEXT_TO_NONE = 1e-3
KNOWN = {
    "": {},
    "actuation_delay": {"delay": "delay"},
    "thruster_lag": {"T": "T_lag"},
    "thruster_deadband": {"width": "deadband_width"},
    "ocean_current": {"V_N": "V_N", "V_E": "V_E"},
}


def _squares(vehicle: str, effect: str, *, closed_loop: bool = False) -> np.ndarray:
    """Mean square of the true model's residual without noise, in units of a faint one, for each equation."""
    effects = (effect,) if effect else ()
    options = {"duration": 40.0, "closed_loop": closed_loop}
    noisy, quiet = (make_case(vehicle, effects, 5, noise=noise, **options) for noise in (FAINT, NEXT_TO_NONE))
    model = vehicle_of(quiet)
    sigma = prepare(runs_of(noisy), model).sigma
    if effect:
        model = model.with_effect(catalogue()[effect], {})
    data = prepare(runs_of(quiet), model, sigma)
    hidden = quiet.truth["values"].get(effect, {})
    true = quiet.truth["parameters"] | {KNOWN[effect][n]: v for n, v in hidden.items()}
    weak = WeakModel(Functions(model), free_parameters(model))
    p = np.array([true.get(n, model.value_of(n).value) for n in weak.functions.parameter_names])
    return mean_square(whitened(weak.linearise(data, p), weak.whitening(data, p)).r, data)


@pytest.mark.parametrize("closed_loop", first_quick([False, True]))
@pytest.mark.parametrize("vehicle", first_quick(["usv", "rov"]))
def test_the_error_of_quadrature_is_far_below_a_faint_noise(vehicle: str, closed_loop: bool) -> None:
    assert np.max(_squares(vehicle, "", closed_loop=closed_loop)) < 0.02


@pytest.mark.parametrize("effect", first_quick(e for e in KNOWN if e))
def test_so_it_is_with_effects_that_act_on_the_commands(effect: str) -> None:
    """A dead time falls between samples, and what was commanded before the log is not known."""
    assert np.max(_squares("usv", effect)) < 0.05


# --- the parts ------------------------------------------------------------------------------------------

EVEN = np.arange(0.0, 20.001, 0.05)
UNEVEN = np.sort(np.random.default_rng(1).permutation(EVEN)[:330])


@pytest.mark.parametrize("make", [functions_on, boxes])
@pytest.mark.parametrize("t", [EVEN, UNEVEN])
def test_summation_by_parts_is_exact_where_a_signal_is_held(t: np.ndarray, make) -> None:
    functions = make(t, 0.25)
    held = np.random.default_rng(2).standard_normal(len(t))
    ramp = np.concatenate([[7.0], 7.0 + np.cumsum(held[:-1] * np.diff(t))])
    np.testing.assert_allclose(functions.rate @ ramp, -(functions.held @ held), atol=1e-13)


def _missed(step: float, moment: float) -> float:
    """Error of the weights for the integral of a function with a kink of slope 1 at 5 s, read at `moment`."""
    t = np.arange(0.0, 10.0 + step / 2, step)
    functions = functions_on(t, 0.5)
    exact = functions_on(np.arange(0.0, 10.0005, 0.001), 0.5)
    kink = np.maximum(t - 5.0, 0.0) + np.where(np.isclose(t, 5.0), moment, 0.0)
    true = exact.value @ np.maximum(np.arange(0.0, 10.0005, 0.001) - 5.0, 0.0)
    return float(np.max(np.abs(functions.value @ kink - true)))


def test_a_kink_read_a_twelfth_of_a_step_later_is_integrated_to_fourth_order() -> None:
    np.testing.assert_allclose(kink_delay(EVEN), 0.05 / 12)
    plain = [_missed(h, 0.0) for h in (0.1, 0.05)]
    later = [_missed(h, h / 12) for h in (0.1, 0.05)]
    assert 3.5 < plain[0] / plain[1] < 4.5
    assert later[0] / later[1] > 10
    assert later[1] < 0.02 * plain[1]


def test_rows_that_feel_commands_from_before_the_log_count_for_nothing() -> None:
    case = make_case("usv", (), 5, duration=30.0)
    late = {"delay": Value(0.6, estimate=True)}
    model = vehicle_of(case).with_effect(catalogue()["actuation_delay"], late)
    data = prepare(runs_of(case)[:1], model)
    weak = WeakModel(Functions(model), ("X_u", "delay"))
    p = np.array(weak.functions.values())
    (part,), noise, (segment,) = weak.linearise(data, p), weak.whitening(data, p), data.segments
    feels = segment.t[segment.functions.supports.first] < segment.t[0] + 0.6
    forces = np.tile(np.arange(len(data.rows)) < 3, len(feels)) & np.repeat(feels, len(data.rows))
    assert 0 < np.count_nonzero(forces) == part.start.shape[1]
    changed = replace(part, r=part.r + 50.0 * forces)
    np.testing.assert_allclose(whitened([changed], noise).r, whitened([part], noise).r, atol=1e-6)
    moved = replace(part, r=part.r + 1e-3 * ~forces)
    assert np.max(np.abs(whitened([moved], noise).r - whitened([part], noise).r)) > 1e-2
