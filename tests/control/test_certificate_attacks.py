"""The attacks of `benchmarks.certificates` break what is not so, and do not break what is proved."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.attacks import Attack, Target
from tests.control.test_certificates import law, sinker
from undertow.control.conditions.result import Quadratic
from undertow.control.conditions.whole import certify

pytest.importorskip("clarabel")
pytestmark = pytest.mark.docs
START = {"x": 0.4, "y": 0.4, "z": 0.4, "psi": 0.4}


def test_an_attack_breaks_false_claims_and_no_proved_one() -> None:
    """Of a third of the speeds, of half of the command's bound, and of a V without ties of its states."""
    gains = law(sinker(16.2), "pid")
    report = certify(gains, forms=["derived"], start=START)
    region, found = report.region, report.region.quadratic
    assert report.ok
    assert found is not None

    def worst(claim: Quadratic, share: float = 1.0, drift: float = 0.0) -> float:
        commands = tuple(replace(c, largest=share * c.largest) for c in region.commands)
        wrong = replace(report, region=replace(region, quadratic=claim, commands=commands))
        how = Attack(generations=2, many=8, drift=drift)
        return Target(gains, wrong, 60.0, False, how).worst(np.random.default_rng(5))

    assert 0.5 < worst(found) < 1
    assert 0.5 < worst(found, drift=0.05) < 1.2
    assert worst(replace(found, speeds=found.speeds / 3)) > 1
    assert worst(found, share=0.5) > 1
    untied = found.P * np.eye(found.P.shape[-1])
    assert worst(replace(found, P=untied, errors=100 * found.errors, speeds=100 * found.speeds), 100.0) > 1


def test_v_of_a_state_is_that_of_its_turned_frame() -> None:
    """An error of 0.1 m north at a heading of 90 degrees is one to port in the body frame, at its own P."""
    gains = law(sinker(), "pid")
    report = certify(gains, forms=["derived"], start=START)
    found = report.region.quadratic
    assert found is not None
    assert found.frame == "body"
    state, place = np.zeros((1, 1, 8)), np.array([0.0, 0.0, 0.0, np.pi / 2])
    state[..., 0] = 0.1
    value = Target(gains, report, 1.0, False, Attack()).value(state, state[..., :4] * 0, place)
    assert value[0, 0] == pytest.approx(0.1**2 * found.at(np.pi / 2)[0, 5, 5])
