"""Velocities that were divided by steps of a clock that jitters: named as such, and as nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.hidden_effects import Case, make_case
from tests.identification.logs_of import run_of, vehicle_of
from undertow.errors import UndertowError
from undertow.identification.doctor.examine import examine, refuse_impossible
from undertow.identification.logs.run import Run

MATTERS = {"speed_unit", "inconsistent", "measures_nothing", "divided_by_jitter", "degrees_for_radians"}


@pytest.fixture(scope="module")
def usv() -> Case:
    return make_case("usv", (), 4, duration=25.0, runs=("multisine",))


def _stamped(case: Case, late: float) -> Run:
    """A run at 250 samples a second whose stamps are late by up to so many steps, and noise of 0.2 mm."""
    (columns,) = case.runs.values()
    run, rng = run_of("dive", columns), np.random.default_rng(8)
    t = np.arange(run.t[0], run.t[-1], 0.004)
    channels = {n: np.interp(t, run.t, data) for n, data in run.channels.items()}
    channels |= {n: channels[n] + 2e-4 * rng.standard_normal(len(t)) for n in ("x", "y", "psi")}
    return Run("dive", t + 0.004 * late * rng.random(len(t)), channels)


def _divided(run: Run) -> Run:
    """The same, its velocities the differences of its pose over each step."""
    pose = {n: np.gradient(run.channels[n], run.t) for n in ("x", "y", "psi")}
    body = (pose["x"] + 1j * pose["y"]) * np.exp(-1j * run.channels["psi"])
    return replace(run, channels=run.channels | {"u": body.real, "v": body.imag, "r": pose["psi"]})


def test_steps_that_jitter_are_no_divisors(usv: Case) -> None:
    """A logger that divides by them has speeds of 1/dt: no other unit, and the pose has it all."""
    vehicle, run = vehicle_of(usv), _divided(_stamped(usv, 0.99))
    examined = examine(vehicle, [run])
    (finding,) = [f for f in examined.result.findings if f.id in MATTERS]
    assert (finding.id, finding.severity) == ("divided_by_jitter", "mistake")
    assert finding.text.startswith("u, v, r are changes of x, y, psi divided by single steps of the clock")
    (anew,) = examined.mended
    assert {"u", "v", "r"} <= anew.derived
    true = _stamped(usv, 0.0).channels
    for name in ("u", "v", "r"):
        before, after = (np.std(one.channels[name] - true[name]) for one in (run, anew))
        assert after < 0.05 * before
    with pytest.raises(UndertowError, match=r"u, v, r are changes of x, y, psi .+ put them into its `ignore`"):
        refuse_impossible(vehicle, [run])
    refuse_impossible(vehicle, [run], trust_log=True)


@pytest.mark.parametrize("kind", ["measured", "even"])
def test_what_was_measured_or_divided_by_even_steps_is_left_alone(usv: Case, kind: str) -> None:
    """Stamps that jitter spoil no velocity that a sensor reported; even steps spoil none at all."""
    run = _stamped(usv, 0.99) if kind == "measured" else _divided(_stamped(usv, 0.0))
    examined = examine(vehicle_of(usv), [run])
    assert [f.text for f in examined.result.findings if f.id in MATTERS] == []
    assert not examined.mended[0].derived
