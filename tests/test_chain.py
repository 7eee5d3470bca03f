"""The chain from a log to a controller: its tuning, why the first gains fail, and what its page says."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from benchmarks.chain.steps import HERE, without_drag
from benchmarks.chain.tuning import CROSSOVER, LEAST, PHASE_MARGIN, gain_file, surge_of, tuned
from undertow.control import close_loop, find_trim
from undertow.control.conditions.check import derived_conditions_hold
from undertow.control.gains import GainSet, load_gains
from undertow.control.linear.analysis import modes
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle

pytestmark = pytest.mark.docs

PAGE = (Path(__file__).parents[1] / "docs" / "chain.md").read_text()
FITTED = {"X_u": -6.412925342, "Y_v": -6.054575722}  # what the first fit of the page makes of quadratic drag


@pytest.fixture(scope="module")
def truth() -> Vehicle:
    return load_vehicle(HERE / "truth.toml")


@pytest.fixture
def incomplete(tmp_path: Path) -> Vehicle:
    path = tmp_path / "rov.toml"
    path.write_text(without_drag((HERE / "truth.toml").read_text()))
    return load_vehicle(path).with_values({name: Value(value) for name, value in FITTED.items()})


def gains_for(model: Vehicle, folder: Path, vehicle: Vehicle) -> GainSet:
    """Gains tuned on a model, to be used on a vehicle."""
    path = folder / "tuned.toml"
    path.write_text(gain_file(model))
    return load_gains(path, vehicle)


def test_the_tuning_gives_the_loop_that_is_asked_for(incomplete: Vehicle, tmp_path: Path) -> None:
    loop = close_loop(incomplete, gains_for(incomplete, tmp_path, incomplete), find_trim(incomplete))
    surge = loop.margins["force_surge"]
    assert surge.crossover == pytest.approx(CROSSOVER, rel=2e-3)
    assert surge.phase == pytest.approx(PHASE_MARGIN, abs=0.2)


def test_damping_that_a_model_has_is_not_asked_for_twice(truth: Vehicle, incomplete: Vehicle) -> None:
    assert tuned(*surge_of(incomplete))[1] == LEAST
    assert tuned(*surge_of(truth))[1] + surge_of(truth)[1] == pytest.approx(4.1212, rel=1e-4)


def test_first_gains_pass_on_the_model_and_fail_on_the_vehicle(
    truth: Vehicle, incomplete: Vehicle, tmp_path: Path
) -> None:
    first = gains_for(incomplete, tmp_path, incomplete)
    assert derived_conditions_hold(first)
    assert all(m.stable for m in modes(close_loop(incomplete, first).closed))
    on_truth = gains_for(incomplete, tmp_path, truth)
    assert not derived_conditions_hold(on_truth)
    assert sum(not m.stable for m in modes(close_loop(truth, on_truth).closed)) == 2  # surge and sway


def test_gains_for_the_complete_model_pass(truth: Vehicle, tmp_path: Path) -> None:
    second = gains_for(truth, tmp_path, truth)
    assert derived_conditions_hold(second)
    assert all(m.stable for m in modes(close_loop(truth, second).closed))


def test_the_page_tells_the_whole_chain() -> None:
    steps = [
        "undertow fit rov.toml",
        "tuned (pid) on round-rov: all conditions hold",
        "tuned (pid) on round-rov: some conditions fail",
        "Missing: quadratic_damping; what remains is noise",
        "undertow add quadratic_damping",
        "tuned.toml, hovering                           stable  unstable",
        "tuned (pid) on round-rov: all conditions hold",
        "tuned.toml, hovering                           unstable  stable",
        "undertow observe rov.toml",
        "mission 'four-legs': all conditions hold",
        "loop with the observer, linearised at rest: stable",
        "--observer observer.toml --dt 0.1",
        "build/round-rov: written",
    ]
    places = []
    for step in steps:
        places.append(PAGE.index(step, places[-1] if places else 0))
    assert places == sorted(places)
    settled = [line for line in PAGE.splitlines() if line.startswith("    along track")]
    assert ["not settled" in line for line in settled] == [False, True, False]


def test_the_page_has_the_gains_of_the_tuning(incomplete: Vehicle) -> None:
    first, second = re.findall(r"^K_P = .*$", PAGE, re.MULTILINE)
    own = next(line for line in gain_file(incomplete).splitlines() if line.startswith("K_P"))
    assert first == own != second
