"""Parameters that make up for what is missing: named with the effect that brings them back, or not at all."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from tests.identification.logs_of import prepared
from undertow.identification.diagnosis.bench import Bench, open_bench
from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.evidence import compare_scores
from undertow.identification.diagnosis.trial import screen, try_candidate
from undertow.identification.diagnosis.verdict import ImprovedModel, compensation_warnings
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import VehicleTable, load_vehicle, vehicle_from_table
from undertow.model.vehicle import Value, Vehicle

MASS, ADDED, DRAG, BUOYANCY = 10.0, 8.0, 6.0, 3.0


@dataclass(frozen=True)
class Fit:
    """What `compensation_warnings` needs of a fit."""

    vehicle: Vehicle
    values: dict[str, float]
    standard_errors: dict[str, float]

    @property
    def model(self) -> SimpleNamespace:
        """The model, of which only the names of its parameters are asked."""
        return SimpleNamespace(values=SimpleNamespace(names=tuple(self.values)))


def _fit(vehicle: Vehicle, **values: float) -> Fit:
    fitted = vehicle.with_values({n: replace(vehicle.value_of(n), value=v) for n, v in values.items()})
    return Fit(fitted, values, dict.fromkeys(values, 0.01))


def _box(**values: Value) -> Vehicle:
    return load_vehicle("box-hull").with_values(values)


# --- a vehicle that sinks and is too buoyant -------------------------------------------------------
def _float() -> Vehicle:
    guess = {"estimate": True, "source": "guess"}
    table = {
        "schema": "undertow/vehicle/1",
        "name": "float",
        "degrees_of_freedom": ["heave"],
        "signs": "sname",
        "generalised_forces": ["tau_Z"],
        "effects": {
            "rigid_body": {"m": MASS},
            "added_mass": {"Z_wdot": {"value": -ADDED, "sigma": 0.8, **guess}},
            "linear_damping": {"Z_w": {"value": -1.05 * DRAG, "sigma": 0.6, **guess}},
        },
    }
    return vehicle_from_table(VehicleTable.model_validate(table), catalogue())


def _descent(seed: int) -> Run:
    """60 s at 10 Hz, pushed downwards most of the time, so that buoyancy looks like drag."""
    rng, step = np.random.default_rng(seed), 0.1
    force = np.repeat(rng.uniform(4.0, 7.0, 20), 30)
    w = np.zeros(len(force))
    decay = np.exp(-DRAG / (MASS + ADDED) * step)
    for i in range(len(w) - 1):
        end = (force[i] - BUOYANCY) / DRAG
        w[i + 1] = end + (w[i] - end) * decay
    noisy = w + 0.003 * rng.standard_normal(len(w))
    return Run(f"descent {seed}", step * np.arange(len(w)), {"w": noisy, "tau_Z": force}, sha256=str(seed))


@cache
def _bench() -> Bench:
    vehicle = _float()
    return open_bench(vehicle, *prepared(vehicle, [_descent(1), _descent(2)], [_descent(3)]))


def _relief(effect: str) -> tuple[ImprovedModel, float]:
    candidate = Candidate(catalogue()[effect], _float())
    trial = try_candidate(candidate, _bench(), screen(candidate, _bench())[0].values)
    chance = compare_scores(_bench().base_score, trial.score, _bench().test).p_value
    return ImprovedModel((effect,), trial.fit.values, trial.score.error), chance


def test_drag_that_absorbs_buoyancy_is_reported_with_what_brings_it_back() -> None:
    helpers = [_relief(e) for e in ("net_buoyancy", "constant_force")]
    assert all(chance < 1e-3 for _, chance in helpers)
    base = _bench().base
    lines = compensation_warnings(_float(), base, [helper for helper, _ in helpers])
    line = next(x for x in lines if "Z_w " in x)
    ratio = base.values["Z_w"] / (-1.05 * DRAG)
    assert ratio > 1.8
    assert line.startswith(f"linear damping: Z_w is {ratio:.3g} times its prior (")
    # Without roll and pitch the two are the same thing, and no name is preferred.
    assert ": it is absorbing net_buoyancy or constant_force; with net_buoyancy it returns to 0.95" in line


def test_no_effect_is_named_where_none_is_held_to_be_there() -> None:
    lines = compensation_warnings(_float(), _bench().base, [])
    doubt = "either the prior is wrong, or it compensates for something that is missing"
    assert lines
    assert all(line.endswith(doubt) and "absorbing" not in line for line in lines)


# --- the rules ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("after", "back"), [(1.1, True), (3.0, True), (0.01, False), (-0.0, False), (-1.0, False)]
)
def test_a_value_that_an_effect_brings_down_to_nothing_has_not_come_back(after: float, *, back: bool) -> None:
    """Sixteen times its prior, and with a thruster that gives nothing a hundredth of it."""
    vehicle = _float()
    helper = ImprovedModel(("thruster_gain",), {"Z_wdot": -ADDED * after}, 1.0)
    line = compensation_warnings(vehicle, _fit(vehicle, Z_wdot=-16 * ADDED), [helper])[0]
    assert ("it is absorbing thruster_gain" in line) == back


def test_a_parameter_near_its_prior_is_not_told() -> None:
    box = _box(X_u=Value(-5.0, estimate=True, sigma=1.0))
    assert compensation_warnings(box, _fit(box, X_u=-6.0), []) == []


@pytest.mark.parametrize(("value", "reported"), [(-10.0, False), (-14.0, False), (-16.0, True), (-1.5, True)])
def test_a_value_stated_without_a_deviation_is_reported_from_three_times_on(
    value: float, reported: bool
) -> None:
    box = _box(X_u=Value(-5.0, estimate=True))
    lines = compensation_warnings(box, _fit(box, X_u=value), [])
    assert bool(lines) is reported
    assert not reported or f"is {value / -5:.3g} times its stated value (no standard deviation is" in lines[0]
    # Where the data hardly tell, it may have gone anywhere.
    loose = replace(_fit(box, X_u=value), standard_errors={"X_u": 4.0})
    assert compensation_warnings(box, loose, []) == []


def test_what_the_data_cannot_tell_from_a_changed_parameter_is_said_beside_it() -> None:
    box = _box(X_u=Value(-5.0, estimate=True, sigma=1.0))
    (line,) = compensation_warnings(box, _fit(box, X_u=-15.0), [], {"X_u": ["tether_drag"]})
    assert line.endswith("either the prior is wrong, or it compensates for tether_drag")


def test_only_leading_effects_can_be_what_is_absorbed() -> None:
    box = _box(X_u=Value(-5.0, estimate=True, sigma=1.0))
    good, poor = ImprovedModel(("lift",), {"X_u": -15.0}, 1.0), ImprovedModel(("waves",), {"X_u": -5.0}, 2.0)
    (line,) = compensation_warnings(box, _fit(box, X_u=-15.0), [good, poor])
    assert "X_u is 3 times its prior (10.0 standard deviations)" in line
    assert "waves" not in line
    pair = ImprovedModel(("lift", "waves"), {"X_u": -5.25}, 0.5)
    (line,) = compensation_warnings(box, _fit(box, X_u=-15.0), [good, poor, pair])
    assert "it is absorbing lift and waves; with lift and waves it returns to 1.05 times" in line


def test_a_parameter_pushed_onto_its_bound_is_reported_even_without_a_prior() -> None:
    box = _box(X_u=Value(-5.0, estimate=True))
    (line,) = compensation_warnings(box, _fit(box, X_u=0.0), [])
    assert "X_u is at its bound 0, 500.0 standard deviations from -5" in line


def test_a_prior_of_zero_has_no_ratio() -> None:
    box = _box(X_u=Value(0.0, estimate=True, sigma=0.5))
    (line,) = compensation_warnings(box, _fit(box, X_u=-4.0), [ImprovedModel(("lift",), {"X_u": -0.1}, 1.0)])
    assert "X_u is -4 with a prior of 0 (8.0 standard deviations)" in line
    assert line.endswith("with lift it returns to -0.1")


def test_a_refit_that_no_vehicle_can_be_is_reported() -> None:
    auv = load_vehicle("mini-auv")
    impossible = _fit(auv, m=-40.0)
    assert any(
        "the refitted vehicle is impossible" in line for line in compensation_warnings(auv, impossible, [])
    )


@pytest.mark.parametrize(
    "helper", [ImprovedModel(("lift",), {}, 1.0), ImprovedModel(("lift",), {"X_u": -11.0}, 1.0)]
)
def test_a_parameter_that_hardly_comes_back_is_not_absorbed(helper: ImprovedModel) -> None:
    box = _box(X_u=Value(-5.0, estimate=True, sigma=1.0))
    (line,) = compensation_warnings(box, _fit(box, X_u=-15.0), [helper])
    assert "lift" not in line
