"""What goes with a parameter that is left out: the winch of a tether that is always out, and not a width."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import sympy as sm

from benchmarks.hidden_effects import Case, make_case
from tests.identification.logs_of import prepared, runs_of, vehicle_of
from tests.quick import first_quick
from undertow.identification.diagnosis.bench import open_bench
from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.trial import Trial, best_start, screen, try_candidate
from undertow.model.catalogue import catalogue
from undertow.model.effect import Effect, Wrench
from undertow.model.parameter import Parameter
from undertow.model.symbols import Signals

# Seeds of the simulator for which all of the tether is out wherever the vehicle goes, none of it, and part.
ALL, NONE, PART = 36, 1, 0


@cache
def _tried(seed: int) -> tuple[Trial, dict[str, float]]:
    case = make_case("rov", ("tether_drag",), seed, duration=60.0)
    return _of(catalogue()["tether_drag"], case), case.truth["values"]["tether_drag"]


def _of(effect: type[Effect], case: Case) -> Trial:
    """An effect fitted to a case, under the noise model of a first fit of it."""
    vehicle, runs = vehicle_of(case), runs_of(case)
    bench = open_bench(vehicle, *prepared(vehicle, runs[:-1], runs[-1:]))
    candidate = Candidate(effect, vehicle)
    start = best_start(candidate, bench, [look.values for look in screen(candidate, bench)])
    first = try_candidate(candidate, bench, start)
    return try_candidate(candidate, bench.with_noise_model_of(first.full), first.full.values)


@pytest.mark.slow
@pytest.mark.parametrize("seed", first_quick([ALL, NONE, PART]), ids=["all", "none", "part"])
def test_a_tether_is_found_with_what_of_it_is_out(seed: int) -> None:
    trial, true = _tried(seed)
    assert trial.score.error == pytest.approx(1.0, abs=0.03), "what is left is noise"
    assert true["c"] or true["c_0"]
    for name, value in {"c_tether": true["c"], "c_paid_out": true["c_0"]}.items():
        assert (name in trial.kept) == (value > 0)
        assert trial.fit.values.get(name, 0.0) == pytest.approx(value, rel=0.02)
    place = [trial.fit.values[f"{axis}_tail"] for axis in "xyz"]
    assert place == pytest.approx([true["x_a"], true["y_a"], true["z_a"]], abs=2e-3)


@pytest.mark.slow
def test_where_the_winch_is_cannot_show_if_the_tether_is_always_out() -> None:
    (always, _), (grows, _) = _tried(ALL), _tried(NONE)
    winch = {"x_winch", "y_winch", "z_winch"}
    assert winch.isdisjoint(always.fit.values)
    assert [grows.fit.values[n] for n in sorted(winch)] == pytest.approx([0, 0, 0], abs=0.1)


class TwoFrictions(Wrench):
    """Two frictions that have nothing to do with each other."""

    id = "two_frictions"
    family = "damping"
    reference = "none: for a test"

    F_x = Parameter("N", "friction in surge", (-100, 100))
    F_y = Parameter("N", "friction in sway", (-100, 100))
    fade_x = Parameter("m/s", "its width", (0.01, 1), linear=False, starts=(0.1,), neutral=None)
    fade_y = Parameter("m/s", "its width", (0.01, 1), linear=False, starts=(0.1,), neutral=None)

    def wrench(self, s: Signals) -> sm.Matrix:
        u, v = s.nu[:2]
        return sm.Matrix(
            [-self.F_x * sm.tanh(u / self.fade_x), -self.F_y * sm.tanh(v / self.fade_y), 0, 0, 0, 0]
        )


def test_a_width_that_cannot_be_zero_keeps_a_value_without_its_friction() -> None:
    trial = _of(TwoFrictions, make_case("usv", (), 3, duration=40.0))
    assert len(trial.kept) == 1, "there is none: the weaker is left out"
    assert {"fade_x", "fade_y"} <= set(trial.fit.values)
    assert trial.score.error == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_a_winch_is_found_on_its_side_of_the_motion() -> None:
    """In nearly level motion a winch as far below explains much: only fits from both sides tell."""
    case = make_case("micro-auv", ("tether_drag", "constant_force"), 89518168, closed_loop=True)
    vehicle, runs = vehicle_of(case), runs_of(case)
    bench = open_bench(vehicle, *prepared(vehicle, runs[:-1], runs[-1:]))
    candidate = Candidate(catalogue()["tether_drag"], vehicle)
    starts = [look.values for look in screen(candidate, bench)]
    heights = [bench.fit(candidate.model(), start=start).values["z_winch"] for start in starts]
    assert max(heights) > 5.0, "one of them ends below"
    assert best_start(candidate, bench, starts)["z_winch"] == pytest.approx(0.0, abs=0.5)


def test_a_start_from_which_states_grow_without_bound_is_none() -> None:
    """At a sample every two seconds, the steps of integration cannot follow a lag of a tenth of one."""
    case = make_case("box", ("thruster_lag",), 3, duration=120.0, runs=("steps", "multisine"))
    vehicle = vehicle_of(case)
    slow = [
        replace(r, t=r.t[::40], channels={n: c[::40] for n, c in r.channels.items()}) for r in runs_of(case)
    ]
    bench = open_bench(vehicle, *prepared(vehicle, slow[:-1], slow[-1:]))
    candidate = Candidate(catalogue()["thruster_lag"], vehicle)
    assert 0.1 in [p for start in candidate.starts(1.0, {}) for p in start.values()]
    found = screen(candidate, bench)
    assert found
    assert all(np.isfinite([look.cost, *look.values.values()]).all() for look in found)
