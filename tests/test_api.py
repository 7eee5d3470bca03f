"""The public names of `import undertow`: few, documented, and their examples run."""

from __future__ import annotations

import doctest
import inspect
import json
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import undertow as ut
from undertow import control
from undertow.control.gains import GainTable, gains_from_table

GAINS = {"schema": "undertow/gains/1", "name": "hull", "law": "pd", "gains": {"K_P": 20, "K_V": 80}}
DOCS = Path(__file__).parents[1] / "docs"
DEMO = Path(ut.__file__).parent / "demo_data" / "auv"
FUNCTIONS = [
    "add_effect", "catalogue", "check_gains", "compile", "diagnose", "fit", "linearize",
    "load_vehicle", "read_log",
]  # fmt: skip


@pytest.fixture(scope="module")
def vehicle() -> ut.Vehicle:
    return ut.load_vehicle(DEMO / "vehicle.toml")


@pytest.fixture(scope="module")
def run(vehicle: ut.Vehicle) -> ut.Run:
    return ut.read_log(DEMO / "train_1.csv.gz", commands=vehicle.command_names)


def test_there_are_at_most_twenty_names() -> None:
    assert len(ut.__all__) <= 20
    for name in ut.__all__:
        assert getattr(ut, name) is not None


@pytest.mark.docs
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


@pytest.mark.slow
def test_checked_gains_say_what_holds() -> None:
    found = ut.check_gains(ut.load_vehicle("mini-auv"), "paper-pid")
    held = sum(row.verdict == "holds" for row in found.rows)
    assert f"not certified; {held} of {len(found.rows)} conditions hold" in repr(found)
    table = found._repr_html_()
    assert repr(found) in table
    assert table.count("<td>holds</td>") == held


def test_a_vehicle_shows_its_parameters_in_a_notebook(vehicle: ut.Vehicle) -> None:
    assert repr(vehicle).startswith(
        "Vehicle mini-auv: surge, sway, heave, yaw; thrusters f1, f2, f3, f4; effects rigid_body, "
    )
    row = ["X_u", "-0.6445", "kg/s", "0.0967", "yes", "guess, good to 15%"]
    assert "".join(f"<td>{cell}</td>" for cell in row) in vehicle._repr_html_()


def test_a_run_shows_its_channels_in_a_notebook(run: ut.Run) -> None:
    assert repr(run).startswith("Run train_1: 1200 samples, 0 to 59.95 s; channels x, y, z, ")
    heading = run.channels["psi"]
    row = ["psi", "rad", "1200", *(f"{x:.5g}" for x in (heading.min(), heading.mean(), heading.max()))]
    assert "".join(f"<td>{cell}</td>" for cell in row) in run._repr_html_()


def test_a_diagnosis_shows_the_error_of_each_model_in_a_notebook(vehicle: ut.Vehicle, run: ut.Run) -> None:
    current = {"ocean_current": ut.catalogue()["ocean_current"]}
    found = ut.diagnose(vehicle, [run.slice(0.0, 30.0)], known=current)
    assert repr(found).startswith("missing_effect: Adding ocean_current lowers ")
    assert repr(found).endswith("Missing: ocean_current; what remains is noise.")
    assert f"<td>ocean_current</td><td>{found.diagnosis.steps[-1].error:.5g}</td>" in found._repr_html_()


def test_what_is_shown_in_a_notebook_is_text() -> None:
    run = ut.Run("<b>dive & drift</b>", np.arange(3.0), {"u": np.full(3, np.nan)})
    assert "<p>Run &lt;b&gt;dive &amp; drift&lt;/b&gt;: 3 samples, 0 to 2 s;" in run._repr_html_()
    assert "<td>u</td><td>m/s</td><td>0</td><td></td>" in run._repr_html_()


def test_an_effect_says_what_it_is(vehicle: ut.Vehicle) -> None:
    damping = next(e for e in vehicle.effects if e.id == "linear_damping")
    assert repr(damping) == f"linear_damping: {damping.about()}"


def test_the_same_log_for_fit_and_validation_is_refused(vehicle: ut.Vehicle, run: ut.Run) -> None:
    with pytest.raises(ut.UndertowError, match="have the same content: give each only once"):
        ut.fit(vehicle, [run], [run])


def test_one_run_needs_no_list(vehicle: ut.Vehicle, run: ut.Run) -> None:
    alone, listed = (ut.fit(vehicle, runs, method="weak") for runs in (run, [run]))
    assert alone.errors == listed.errors


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ([], "there is no training log"),
        (["dive.csv"], r"runs\[0\] is given as str \('dive.csv'\): read it with undertow.read_log first"),
        ("dive.csv", r"runs is given as str \('dive.csv'\): read it with undertow.read_log first or a list"),
    ],
)
def test_logs_that_are_none_are_refused(vehicle: ut.Vehicle, given: list[ut.Run], message: str) -> None:
    for call in (ut.fit, ut.diagnose, partial(ut.add_effect, effect="ocean_current")):
        with pytest.raises(ut.UndertowError, match=message):
            call(vehicle, runs=given)


def test_the_path_of_a_vehicle_is_no_vehicle(run: ut.Run) -> None:
    diagnose, check = partial(ut.diagnose, runs=[run]), partial(ut.check_gains, gains="paper-pd")
    for call in (diagnose, check, ut.linearize, ut.compile, partial(ut.read_log, "dive.csv")):
        with pytest.raises(ut.UndertowError, match=r"given as str .*: read it with undertow\.load_vehicle"):
            call(vehicle="vehicle.toml")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": {"x": "0.5 m"}}, r"start: x is given as str \('0.5 m'\): give a number in SI"),
        ({"start": {"phi": 0.1}}, "start: 'phi' is not a coordinate of the pose of 'box-hull'"),
        ({"uncertain": {"m": "5%"}}, r"m is given as str \('5%'\): give a number"),
        ({"covariance": (["X_u"], np.eye(2))}, r"covariance of 1 parameters has shape \(2, 2\)"),
        ({"covariance": (["X_u"], [[np.nan]])}, "covariance of X_u is not finite"),
        ({"covariance": (["X_u"], [[-1.0]])}, "its variance is negative"),
        ({"covariance": (["X_u"], [["a"]])}, "covariance is given as list: give an array of numbers"),
        ({"covariance": (["X_u"],)}, r"covariance is given as tuple \(.*\): give 2 values"),
        ({"confidence": "95%"}, r"confidence is given as str \('95%'\): give a number in SI"),
        ({"start": ["x"]}, r"start is given as list \(\['x'\]\): give a mapping by name"),
        (
            {"uncertain": np.zeros(2)},
            "given as ndarray .*: give a number in SI or a mapping by name or 'stated'",
        ),
        ({"forms": "printed"}, r"forms is given as str \('printed'\): give a list"),
        ({"tilt": None}, r"tilt is given as NoneType \(None\): give a number in SI"),
        ({"progress": 1}, r"progress is given as int \(1\): give a function"),
    ],
)
def test_what_gains_cannot_be_checked_over_is_refused(options: dict[str, Any], message: str) -> None:
    vehicle = ut.load_vehicle("box-hull")
    gains = gains_from_table(GainTable.model_validate(GAINS), vehicle)
    with pytest.raises(ut.UndertowError, match=message):
        ut.check_gains(vehicle, gains, **options)


def test_gains_that_were_read_for_another_vehicle_are_refused(vehicle: ut.Vehicle) -> None:
    gains = gains_from_table(GainTable.model_validate(GAINS), ut.load_vehicle("box-hull"))
    with pytest.raises(ut.UndertowError, match="gains 'hull' are for 'box-hull' with other values"):
        ut.check_gains(vehicle, gains)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda v, _: ut.linearize(v, {"u": "0.5"}), r"at: u is given as str \('0.5'\): give a number in SI"),
        (lambda v, _: ut.linearize(v, ["u"]), r"at is given as list \(\['u'\]\): give a mapping by name"),
        (lambda v, _: ut.linearize(v, pade="3"), r"pade is given as str \('3'\): give a whole number"),
        (lambda v, _: ut.linearize(v, pade=1.5), r"pade is given as float \(1.5\): give a whole number"),
        (lambda v, _: ut.linearize(v, dt=1e300), r"sampled every 1e\+300 s the motion has no finite numbers"),
        (lambda v, _: control.find_trim(v, free="w"), r"free is given as str \('w'\): give a list"),
        (lambda v, _: control.in_current(v, "0.3", 0.0), r"north is given as str \('0.3'\): give a number"),
        (lambda v, _: control.family(v, {}, -1), "a family with -1 drawn vehicles"),
        (lambda *_: ut.load_vehicle(None), r"source is given as NoneType \(None\): give a text or a path"),
        (
            lambda *_: ut.load_vehicle("otter", effect_files=3),
            r"effect_files is given as int \(3\): give a list",
        ),
        (lambda *_: ut.load_vehicle("otter", effect_files=["x.py"]), "effect file 'x.py' does not exist"),
        (
            lambda *_: ut.read_log(None),
            r"path is given as NoneType \(None\): give a text or a path or a list",
        ),
        (lambda *_: ut.read_log([]), "no log is given"),
        (
            lambda *_: ut.read_log("dive.csv", {"t": "time"}),
            "mapping is given as dict .*: give a text or a path",
        ),
        (lambda *_: ut.read_log("dive.csv", window=("a", "b")), r"window\[0\] is given as str \('a'\)"),
        (
            lambda *_: ut.read_log("dive.csv", window=(1,)),
            r"window is given as tuple \(\(1,\)\): give 2 values",
        ),
        (lambda v, run: ut.fit(v, run, loss="l1"), r"loss is given as str .*: give 'gaussian' or 'huber'"),
        (lambda v, run: ut.fit(v, run, horizon=-1.0), "horizon = -1 s is no length of a window"),
        (
            lambda v, run: ut.fit(v, run, trust_log="no"),
            r"trust_log is given as str \('no'\): give True or Fal",
        ),
        (lambda v, run: ut.add_effect(v, [], run), "no effect is named"),
        (lambda *_: ut.Run("dive", np.zeros((2, 1)), {}), r"run 'dive': t has shape \(2, 1\)"),
        (
            lambda *_: ut.Run("dive", "x", {}),
            "run 'dive': could not convert .*: give t as an array of numbers",
        ),
        (lambda *_: ut.Run("dive", [0, 1], [0, 1]), "run 'dive': .*, channels as arrays by name"),
    ],
)
def test_arguments_of_other_kinds_are_refused(
    vehicle: ut.Vehicle, run: ut.Run, call: Callable[[ut.Vehicle, ut.Run], object], message: str
) -> None:
    with pytest.raises(ut.UndertowError, match=message):
        call(vehicle, run)


@pytest.mark.parametrize("number", [np.float32(0.5), np.float64(0.5), np.int64(1), 1])
def test_numbers_of_every_library_are_numbers(vehicle: ut.Vehicle, number: float) -> None:
    assert ut.linearize(vehicle, {"u": number}, dt=number).dt == number


@pytest.mark.parametrize("place", [0, 5])
def test_a_run_whose_time_stands_still_is_refused(vehicle: ut.Vehicle, run: ut.Run, place: int) -> None:
    t = run.t.copy()
    t[place + 1] = t[place]
    with pytest.raises(ut.UndertowError, match=f"time does not increase after {t[place]:g} s"):
        ut.fit(vehicle, replace(run, t=t), method="weak")


def test_what_cannot_be_simulated_is_refused(vehicle: ut.Vehicle) -> None:
    model = ut.compile(vehicle)
    x0, u = np.zeros(len(model.states)), np.zeros((3, len(model.inputs)))
    for start, inputs, message in (
        (x0 * np.nan, u, "x0 holds values that are not finite"),
        (x0, u + np.inf, "u holds values that are not finite"),
        (x0, "u", "u is given as str: give an array of numbers"),
        (x0, 3.0, r"u has shape \(1,\): give "),
        (x0[1:], u, "x0 has shape"),
        (x0, u[:, 1:], "u has shape"),
    ):
        with pytest.raises(ut.UndertowError, match=message):
            model.simulate(start, inputs, 0.1)
    for dt in (0, -1.0, np.nan, np.inf, 1e9, "0.1", None):
        with pytest.raises(ut.UndertowError, match=r"dt = .* s cannot be the time between 3 samples: give"):
            model.simulate(x0, u, dt)  # type: ignore[arg-type]


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
    assert fit.plot()._repr_html_().count("<svg") == 1


def test_a_method_that_is_not_known_is_refused(vehicle: ut.Vehicle, run: ut.Run) -> None:
    with pytest.raises(
        ut.UndertowError, match="method 'ols' is not known: choose one of default, weak, integral"
    ):
        ut.fit(vehicle, [run], method="ols")


def test_a_simulation_is_held_between_samples() -> None:
    model = ut.compile(ut.load_vehicle("mini-auv"))
    u = np.zeros((21, len(model.inputs)))
    u[10:] = 1.0
    x = model.simulate(np.zeros(len(model.states)), u, dt=0.1)
    calm = model.simulate(np.zeros(len(model.states)), 0 * u, dt=0.1)
    np.testing.assert_array_equal(x[:11], calm[:11])
    assert np.abs(x[11:] - calm[11:]).max() > 1e-6


# --- tutorial.ipynb ---------------------------------------------------------------------------------
def _cells() -> list[dict[str, Any]]:
    cells: list[dict[str, Any]] = json.loads((DOCS / "tutorial.ipynb").read_text(encoding="utf-8"))["cells"]
    return cells


def test_the_notebook_stores_no_outputs() -> None:
    assert [c["id"] for c in _cells() if c.get("outputs") or c.get("execution_count")] == []


@pytest.mark.slow
def test_the_notebook_does_what_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its code, run as one program: an error, or a warning, in any cell fails."""
    monkeypatch.setenv("MPLBACKEND", "agg")
    code = ["".join(c["source"]) for c in _cells() if c["cell_type"] == "code"]
    assert {w for c in code for w in re.findall(r"undertow[\w.]*", c)} == {"undertow"}
    there: dict[str, Any] = {}
    exec(compile("\n\n".join(code), "tutorial.ipynb", "exec"), there)
    there["plt"].close("all")
    assert there["result"].effects == ["ocean_current"]
    for name in ("u", "v", "r"):
        before, after = (there["rms_error"](there[m], name) for m in ("refitted", "with_current"))
        assert after < before / 10
    assert there["better"].value_of("V_N").value == pytest.approx(0.12, abs=0.005)
    assert there["checks"].conditions_hold
    assert not there["checks"].ok
    assert max(there["system"].poles().real) > 0.2
