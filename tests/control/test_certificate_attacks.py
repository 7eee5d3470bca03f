"""The attacks of `benchmarks.certificates` break what is not so, and do not break what is proved."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.attacks import Attack, BoxTarget, Target
from benchmarks.certificates import Outcome, page_of
from tests.control.test_certificates import law, loaded, sinker
from undertow.control.conditions.full_loop import certify
from undertow.control.conditions.result import Quadratic, Transient

pytest.importorskip("clarabel")
pytestmark = pytest.mark.docs
SPRING = """schema = "undertow/vehicle/1"
name = "spring"
degrees_of_freedom = ["surge"]
signs = "sname"
[effects.rigid_body]
m = 10.0
[[thrusters]]
name = "f1"
wrench = [1, 0, 0, 0, 0, 0]
"""
START = {"x": 0.4, "y": 0.4, "z": 0.4, "psi": 0.4}


def test_an_attack_breaks_false_claims_and_no_proved_one() -> None:
    """Of a third of the speeds, of half of the command's bound, and of a V without ties of its states."""
    gains = law(sinker(16.2), "pid")
    report = certify(gains, forms=["derived"], start=START)
    region, found = report.region, report.region.quadratic
    assert report.ok
    assert found is not None

    def worst(claim: Quadratic, share: float = 1.0) -> float:
        commands = tuple(replace(c, largest=share * c.largest) for c in region.commands)
        wrong = replace(report, region=replace(region, quadratic=claim, commands=commands))
        how = Attack(generations=2, many=8)
        return Target(gains, wrong, 60.0, False, how).worst(np.random.default_rng(5))

    assert 0.5 < worst(found) < 1
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
    assert value[0, 0] == pytest.approx(0.1**2 * found.at(np.pi / 2)[5, 5])


def test_rounding_of_a_simulation_breaks_no_bound() -> None:
    """A command of 3e-14 where 1e-14 is bounded, long after one of 0.5; a hundredth of it there does."""
    target, t = object.__new__(BoxTarget), np.array([0.0, 2.0])
    target.how, one = Attack(), np.ones((2, 1))
    target.transient = Transient(np.array([0.0, 1.0]), one, one, np.array([[1.0], [1e-14]]), 0.1)
    for late, most in ((3e-14, 0.5), (1e-2, 10.0)):
        commands = np.array([[[0.5, late]]])
        assert target._used(t, np.zeros((1, 2, 2)), commands)[1].max() == pytest.approx(most)


def test_a_law_that_is_sampled_breaks_no_bound_of_one_that_is_not() -> None:
    """A mass on a spring: the speed that damping leaves of its first swing, and what a held command adds."""
    k_p, k_v, box = 40.0, 4.0, 0.1
    omega, zeta = np.sqrt(k_p / 10.0), k_v / 2 / np.sqrt(k_p * 10.0)
    root = np.sqrt(1 - zeta**2)
    fastest = box * omega * np.exp(-zeta / root * np.arctan(root / zeta))
    gains = law(loaded(SPRING), "pd", gains={"K_P": {"x": k_p}, "K_V": {"x": k_v}})
    for share, broken in ((1.0001, False), (0.999, True)):
        claim = Transient(
            np.zeros(1), np.full((1, 1), 1.1 * box), np.full((1, 1), share * fastest), np.empty((1, 0)), 0.1
        )
        report = SimpleNamespace(
            region=SimpleNamespace(transient=claim, starts={"x": box}, commands=(), parameters={})
        )
        target = BoxTarget(gains, report, 10.0, False, Attack(generations=1, many=5))  # type: ignore[arg-type]
        assert (target.worst(np.random.default_rng(5)) > 1) == broken
        assert target.shares(np.ones((1, 3))) > 1  # as sampled


def test_the_page_has_shares_with_their_exact_intervals() -> None:
    """Clopper and Pearson: 3 of 4 is 19 to 99%, 2 of 2 from 16%."""
    said = ("certified", "certified", "no proof", "certified", "certified", "certified")
    sizes = (1, 1, 6, 6, 6, 6)
    rows = [
        Outcome(1, k, n, "stable", 0.1 * k, s, 0.9, 2.0, "no proof", 0.0, 3.0)
        for k, (n, s) in enumerate(zip(sizes, said, strict=True))
    ]
    others = [Outcome(1, 7, 6, "limited", 0.2, "not asked", 0.0, 0.0, "not asked", 0.0, 0.0)]
    page = page_of([*rows, *others], 0.1, 9)
    assert "| 1 | 2 | 2 | 100% (16% to 100%) | 0 | 0.9000 | 2.0 | 2.0 |" in page
    assert "| 6 | 4 | 3 | 75% (19% to 99%) |" in page
    assert "| all | 6 | 5 | 83% (36% to 100%) |" in page
    assert "Of 9 cases, 7 are PID loops with a thruster in every\naxis: 6 stable, 1 limited." in page
    assert "| 2 | 6 | 0.200 | no proof | no proof |" in page
    assert "| 1 | 1 | 0.100 | certified | no proof |" in page
    assert "\nNone.\n" in page


def test_the_page_lists_claims_that_attacks_broke() -> None:
    """With the case, and whether it is over parameters."""
    row = Outcome(1, 4, 3, "stable", 0.3, "certified", 0.99, 2.0, "certified", 1.25, 3.0)
    assert "- Case 4, 3 degrees of freedom, over parameters: 1.2500 of a bound." in page_of([row], 0.1, 5)


def test_an_attack_varies_limits_between_the_bound_and_that_of_the_file() -> None:
    """Half of the tries have a limit at either end; a law held at the certified bound keeps its claims."""
    gains = law(sinker(16.2), "pid")
    report = certify(gains, forms=["derived"], start=START)
    target = Target(gains, report, 5.0, False, Attack())
    assert len(target.limited) == len(report.region.commands) > 0
    seen: list[dict[str, np.ndarray]] = []
    run_many = target.loop.run_many
    target.loop.run_many = lambda *a, **k: (seen.append(k["gains"]), run_many(*a, **k))[1]  # type: ignore[assignment, func-returns-value]
    tries = np.full((3, 2 * 4 + 1 + len(target.limited)), 0.1)
    tries[:, 9] = -1.0, 0.0, 1.0
    target.shares(tries)
    first = report.region.commands[0]
    assert seen[0][f"limit_{first.name}"] == pytest.approx(
        [first.largest, 0.5 * (first.largest + first.limit), first.limit]
    )
