"""The public names of `import undertow`: few, documented, and their examples run."""

from __future__ import annotations

import doctest
import inspect
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import undertow as ut

DEMO = Path(ut.__file__).parent / "demo_data" / "auv"
FUNCTIONS = [
    "add_effect", "check_gains", "compile", "diagnose", "fit", "linearize", "load_vehicle", "read_log",
]  # fmt: skip


def test_there_are_at_most_twenty_names() -> None:
    assert len(ut.__all__) <= 20
    for name in ut.__all__:
        assert getattr(ut, name) is not None


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_example_of_a_function_does_what_it_says(name: str) -> None:
    function = getattr(ut, name)
    (found,) = doctest.DocTestFinder(recurse=False).find(function, name)
    assert found.examples
    assert all(p.annotation is not p.empty for p in inspect.signature(function).parameters.values())
    assert doctest.DocTestRunner(verbose=False).run(found).failed == 0


def test_the_example_of_an_effect_of_ones_own_runs() -> None:
    (found,) = doctest.DocTestFinder(recurse=False).find(ut.Wrench, "Wrench")
    assert doctest.DocTestRunner(verbose=False).run(found) == (0, 4)


def test_checked_gains_say_what_holds() -> None:
    found = ut.check_gains(ut.load_vehicle("mini-auv"), "paper-pid")
    held = sum(row.verdict == "holds" for row in found.rows)
    assert f"not certified; {held} of {len(found.rows)} conditions hold" in repr(found)
    assert repr(found) in found._repr_html_()


@pytest.fixture(scope="module")
def vehicle() -> ut.Vehicle:
    return ut.load_vehicle(DEMO / "vehicle.toml")


@pytest.fixture(scope="module")
def run(vehicle: ut.Vehicle) -> ut.Run:
    return ut.read_log(DEMO / "train_1.csv.gz", commands=vehicle.command_names)


def test_the_same_log_for_fit_and_validation_is_refused(vehicle: ut.Vehicle, run: ut.Run) -> None:
    with pytest.raises(ut.UndertowError, match="have the same content: give each once"):
        ut.fit(vehicle, [run], [run])


def test_a_velocity_that_never_changes_is_refused(vehicle: ut.Vehicle, run: ut.Run) -> None:
    still = replace(run, channels={**run.channels, "v": np.zeros_like(run.t)})
    with pytest.raises(ut.UndertowError, match="v = 0 over all 1200 samples"):
        ut.diagnose(vehicle, [still])


def test_a_fit_says_what_it_found(vehicle: ut.Vehicle, run: ut.Run) -> None:
    other = ut.read_log(DEMO / "train_2.csv.gz", commands=vehicle.command_names)
    fit = ut.fit(vehicle, [run], [other])
    table = fit.parameters
    assert table["parameter"].to_list() == list(fit.fit.model.free)
    assert table.filter(table["t"] > 5)["standard_error"].null_count() == 0
    assert fit.errors[1] < fit.errors[0]
    assert all(name in fit.summary() for name in table["parameter"])
    assert repr(fit) == fit.summary()
    assert "<table" in fit._repr_html_()
    bars = fit.plot().axes[0].patches
    heights = [100 * share for part in (fit.before, fit.after) for share in part.relative.values()]
    np.testing.assert_allclose([bar.get_height() for bar in bars], heights)


def test_a_method_that_is_not_known_is_refused(vehicle: ut.Vehicle, run: ut.Run) -> None:
    with pytest.raises(ut.UndertowError, match="method 'ols' is not known: choose one of weak, integral"):
        ut.fit(vehicle, [run], method="ols")


def test_a_simulation_is_held_between_samples() -> None:
    model = ut.compile(ut.load_vehicle("mini-auv"))
    u = np.zeros((21, len(model.inputs)))
    u[10:] = 1.0
    x = model.simulate(np.zeros(len(model.states)), u, dt=0.1)
    calm = model.simulate(np.zeros(len(model.states)), 0 * u, dt=0.1)
    np.testing.assert_array_equal(x[:11], calm[:11])
    assert np.abs(x[11:] - calm[11:]).max() > 1e-6
    with pytest.raises(ut.UndertowError, match=r"dt = 0 s"):
        model.simulate(np.zeros(len(model.states)), u, dt=0)
