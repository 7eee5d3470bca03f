"""A value that the vehicle file holds fixed and that is wrong is told from a missing effect; the rate of
false alarms that evidence is held to.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import pytest

import undertow as ut
from benchmarks.hidden_effects import Case, make_case
from tests.identification.logs_of import prepared, runs_of, true_vehicle, vehicle_of
from tests.quick import first_quick
from undertow.errors import UndertowError
from undertow.identification.diagnose import DiagnosisResult, diagnose
from undertow.identification.diagnosis.bench import Bench, open_bench
from undertow.identification.diagnosis.rounds import Round, other_values, try_all
from undertow.identification.diagnosis.settings import Settings
from undertow.identification.report.page import render_report
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Vehicle

KNOWN = (
    "constant_force", "cubic_damping", "drag_asymmetry", "lift", "thruster_gain", "thruster_lag",
)  # fmt: skip
SEED = 20261123


@cache
def _case(*hidden: str, duration: float = 40.0) -> Case:
    return make_case("usv", hidden, SEED, duration=duration)


def _fixed(case: Case, factors: dict[str, float]) -> Vehicle:
    """The user's model with some values fixed, at a factor times the truth."""
    vehicle, true = vehicle_of(case), true_vehicle(case)
    return vehicle.with_values(
        {n: replace(true.value_of(n), value=k * true.value_of(n).value, estimate=False, sigma=None)
         for n, k in factors.items()}
    )  # fmt: skip


@cache
def _diagnosed(hidden: tuple[str, ...], factors: tuple[tuple[str, float], ...]) -> DiagnosisResult:
    case = _case(*hidden, duration=25.0)
    runs = runs_of(case)
    known = {i: catalogue()[i] for i in KNOWN}
    return diagnose(_fixed(case, dict(factors)), runs[:-1], runs[-1:], known=known)


def _bench(factors: dict[str, float]) -> Bench:
    case = _case()
    vehicle, runs = _fixed(case, factors), runs_of(case)
    return open_bench(vehicle, *prepared(vehicle, runs[:-1], runs[-1:]))


@cache
def _round() -> Round:
    known = {i: catalogue()[i] for i in KNOWN}
    return try_all(_bench({"Y_v": 2.5}), known, lambda done, words: None)


@pytest.mark.parametrize("name", first_quick(["N_r", "X_u", "X_udot"]))
def test_a_wrong_fixed_value_is_no_missing_effect(name: str) -> None:
    found = _diagnosed((), ((name, 2.0),)).diagnosis
    true = true_vehicle(_case()).value_of(name).value
    value = next(e for e in found.parameters if e.name == name)
    assert found.verdict == "adequate"
    assert not found.effects
    assert found.freed == [name]
    assert value.standard_error is not None
    assert value.value == pytest.approx(true, abs=4 * value.standard_error + 0.02 * abs(true))
    assert value.prior == pytest.approx(2.0 * true)
    assert "No effect is missing, but fixed values in the vehicle file do not fit" in found.headline
    assert not [f for f in found.doctor if f.severity == "mistake"]


def test_the_error_falls_from_the_model_as_given_to_noise() -> None:
    found = _diagnosed((), (("N_r", 2.0),)).diagnosis
    given, other = found.steps
    assert (given.freed, other.freed) == ([], ["N_r"])
    assert given.error > 2.0
    assert other.error == pytest.approx(1.0, abs=0.15)
    assert found.last_step is other


def test_the_report_says_what_it_does_and_does_not_mean() -> None:
    found = _diagnosed((), (("N_r", 2.0),)).diagnosis
    page = " ".join(render_report(found).split())
    assert "No effect is missing, but fixed values do not fit" in page
    assert "Nothing is missing" not in page
    assert "other values of <code>N_r</code>" in page


def test_what_is_handed_on_has_the_other_value() -> None:
    outcome = _diagnosed((), (("N_r", 2.0),))
    true = true_vehicle(_case()).value_of("N_r").value
    given, after = outcome.before.value_of("N_r"), outcome.after.value_of("N_r")
    assert given.value == pytest.approx(2.0 * true)
    assert not given.estimate
    assert after.value == pytest.approx(true, rel=0.05)
    assert after.estimate


@pytest.mark.slow
def test_a_wrong_fixed_value_beside_a_missing_effect() -> None:
    found = _diagnosed(("thruster_lag",), (("N_r", 2.0),)).diagnosis
    assert (found.effects, found.freed) == (["thruster_lag"], ["N_r"])
    assert "In addition, fixed values in the vehicle file do not fit the logs: N_r" in found.headline


@pytest.mark.slow
def test_a_right_fixed_value_stays_where_it_is_and_takes_no_effect_away() -> None:
    found = _diagnosed(("thruster_lag",), (("Y_v", 1.0), ("N_r", 1.0))).diagnosis
    assert (found.verdict, found.effects, found.freed) == ("missing_effect", ["thruster_lag"], [])


@pytest.mark.slow
def test_fixed_values_that_fit_are_left_alone() -> None:
    found = _diagnosed((), (("Y_v", 1.0), ("N_r", 1.0))).diagnosis
    assert (found.verdict, found.freed) == ("adequate", [])


def test_values_that_do_the_same_are_reported() -> None:
    """Inertia and added inertia in yaw only show as their sum."""
    found = other_values(_bench({"N_rdot": 3.0}))
    assert found is not None
    assert found.alike == {"N_rdot": ("I_z",)}


def test_what_is_weighed_is_not_called_wrong() -> None:
    """A wrong mass has effects of its own in the catalogue."""
    case = _case()
    vehicle, runs = vehicle_of(case), runs_of(case)
    heavier = vehicle.with_values(
        {"m": replace(vehicle.value_of("m"), value=1.3 * vehicle.value_of("m").value)}
    )
    assert other_values(open_bench(heavier, *prepared(heavier, runs[:-1], runs[-1:]))) is None


@pytest.mark.parametrize(("rate", "enough"), [(0.005, False), (0.01, False), (0.05, True), (0.2, True)])
def test_evidence_is_held_to_the_rate_of_false_alarms_that_is_asked_for(rate: float, enough: bool) -> None:
    """The same fall of the error, that happens by chance in 2 of 100 searches among as many candidates."""
    evidence = _round().findings[0].evidence
    among = round(0.02 / evidence.p_value)
    assert among * evidence.p_value == pytest.approx(0.02, rel=0.05)
    assert evidence.beyond_chance(Settings(false_alarm_rate=rate), among) is enough


@pytest.mark.parametrize("rate", [0.0, 0.001, 0.5, float("nan")])
def test_a_rate_of_false_alarms_that_cannot_be_held_to_is_refused(rate: float) -> None:
    case = _case()
    with pytest.raises(UndertowError, match=r"choose one between 0.005 and 0.2"):
        ut.diagnose(vehicle_of(case), runs_of(case), false_alarms=rate)
