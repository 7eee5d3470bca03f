"""An effect of which the vehicle file states only some coefficients, beside another one that is missing."""

from __future__ import annotations

from dataclasses import replace

import pytest

import undertow as ut
from tests.identification.logs_of import simulated_runs
from undertow.model.vehicle import Value


def test_a_coefficient_that_a_stated_effect_lacks_is_found() -> None:
    whole, known = ut.load_vehicle("cybership2"), ut.catalogue()
    runs = simulated_runs(whole, 2, 40.0, seed=3, size=2.0, hold=40, noise=0.002)
    file = replace(whole, values={n: v for n, v in whole.values.items() if n != "Y_vabsv"})
    found = ut.diagnose(file, runs[:1], runs[1:], known={"quadratic_damping": known["quadratic_damping"]})
    assert found.diagnosis.verdict == "missing_effect"
    assert found.effects == ["quadratic_damping"]
    (drag,) = [p for p in found.diagnosis.parameters if p.name == "Y_vabsv"]
    assert abs(drag.value + 36.47) < 3.0 * max(drag.standard_error, 1.0)


@pytest.mark.slow
def test_what_frees_a_coefficient_of_a_stated_effect_is_found_once_and_the_next_effect_beside_it() -> None:
    whole, known = ut.load_vehicle("cybership2"), ut.catalogue()
    force = known["constant_force"]
    pushed = whole.with_effect(force, {n: Value(0.1 * (n == "Y_0")) for n in ("X_0", "Y_0", "N_0")})
    runs = simulated_runs(pushed, 4, 120.0, seed=3, size=2.0, hold=40, noise=0.002, unlogged=0.01)
    file = replace(whole, values={n: v for n, v in whole.values.items() if n != "Y_vabsv"})
    effects = {n: known[n] for n in ("quadratic_damping", "constant_force")}
    found = ut.diagnose(file, runs[:3], runs[3:], known=effects).diagnosis
    assert found.effects == ["quadratic_damping"]
    assert found.verdict == "missing_effect"
    assert [a.effect for a in found.added] == ["quadratic_damping", "constant_force"]
    (drag,) = [p for p in found.parameters if p.name == "Y_vabsv"]
    assert abs(drag.value + 36.47) < 3.0 * max(drag.standard_error, 1.0)
