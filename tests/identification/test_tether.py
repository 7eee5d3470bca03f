"""A tether that is paid out wherever the vehicle goes, and one that grows: both are found."""

from __future__ import annotations

from functools import cache

import pytest

from benchmarks.hidden_effects.cases import make_case
from tests.identification.logs_of import runs_of, vehicle_of
from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.scouting import scout
from undertow.identification.diagnosis.trial import Trial, open_bench, try_candidate
from undertow.identification.weak.data import prepare
from undertow.model.catalogue import catalogue

# Seeds of the simulator for which all of the tether is out wherever the vehicle goes, none of it, and part.
ALL, NONE, PART = 36, 1, 0


@cache
def _tried(seed: int) -> tuple[Trial, dict[str, float]]:
    case = make_case("rov", ("tether_drag",), seed, duration=60.0)
    vehicle = vehicle_of(case)
    *shown, aside = runs_of(case)
    train = prepare(shown, vehicle)
    test = prepare([aside], vehicle, sigma=train.sigma)
    bench = open_bench(vehicle, train, test)
    candidate = Candidate(catalogue()["tether_drag"], vehicle)
    begun = try_candidate(candidate, bench, scout(candidate, bench).values)
    sharp = bench.sharpened(begun.full)
    trial = try_candidate(candidate, sharp, begun.full.values)
    return trial, case.truth["values"]["tether_drag"]


@pytest.mark.parametrize("seed", [ALL, NONE, PART], ids=["all", "none", "part"])
def test_a_tether_is_found_with_what_of_it_is_out(seed: int) -> None:
    trial, true = _tried(seed)
    assert trial.score.error == pytest.approx(1.0, abs=0.03), "what is left is noise"
    assert true["c"] or true["c_0"]
    for name, value in {"c_tether": true["c"], "c_paid_out": true["c_0"]}.items():
        assert (name in trial.kept) == (value > 0)
        assert trial.fit.values.get(name, 0.0) == pytest.approx(value, rel=0.02)
    place = [trial.fit.values[f"{axis}_tail"] for axis in "xyz"]
    assert place == pytest.approx([true["x_a"], true["y_a"], true["z_a"]], abs=2e-3)


def test_where_the_winch_is_cannot_show_if_the_tether_is_always_out() -> None:
    (always, _), (grows, _) = _tried(ALL), _tried(NONE)
    winch = {"x_winch", "y_winch", "z_winch"}
    assert winch.isdisjoint(always.fit.values)
    assert [grows.fit.values[n] for n in sorted(winch)] == pytest.approx([0, 0, 0], abs=0.1)
