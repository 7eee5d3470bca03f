"""What the buttons work out: the same numbers as the commands, on the demo's AUV in a current."""

from __future__ import annotations

import json
import math
import tomllib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.workbench.demo_session import DEMO, session_of
from undertow.cli.main import main
from undertow.errors import UndertowError
from undertow.identification.api import read_log
from undertow.identification.logs.mapping import LogMapping, mapping_text
from undertow.model.loading import load_vehicle
from undertow.workbench import tasks
from undertow.workbench.bench import Bench
from undertow.workbench.model_pages import commands, error_steps
from undertow.workbench.session import LogSegment, ModelStep, Workspace
from undertow.workbench.tasks import Job

Make = Callable[..., Job]


def _without_history(path: Path) -> dict[str, Any]:
    content = tomllib.loads(path.read_text())
    content.pop("history")
    return content


def test_results_are_json(worked_out: Workspace) -> None:
    for kind in ("compare", "diagnose"):
        json.dumps(worked_out.result(kind), allow_nan=False)


def test_a_cell_knows_its_times(worked_out: Workspace) -> None:
    found = worked_out.result("compare")
    assert found is not None
    spans = [
        s for name in ("first third", "middle third", "last third") for s in found["stretches"]["yaw"][name]
    ]
    ends = sorted((run, a, b) for run, a, b in spans)
    # The thirds of both logs lie one behind the other and leave nothing out.
    assert [run for run, _, _ in ends] == [0, 0, 0, 1, 1, 1]
    for (run, _, end), (later, start, _) in pairwise(ends):
        assert run != later or math.isclose(end, start, abs_tol=1e-6)
    assert ends[0][1] < 2.0
    assert ends[2][2] > 58.0
    slow = found["stretches"]["yaw"]["slow"]
    covered = sum(b - a for _, a, b in slow) / sum(b - a for _, a, b in ends)
    assert covered == pytest.approx(1 / 3, abs=0.03)  # a third of the test functions is slow


def test_the_current_leads_and_brings_the_error_down_to_noise(worked_out: Workspace) -> None:
    found = worked_out.result("diagnose")
    assert found is not None
    first = found["candidates"][0]
    assert (first["effect"], first["named"]) == ("ocean_current", True)
    assert found["errors"]["force"] > 5.0
    assert first["errors"]["force"] == pytest.approx(1.0, abs=0.1)
    ahead = [name for name in found["errors"] if name.endswith(" s")]
    assert len(ahead) == 3
    assert all(first["errors"][name] < 0.5 * found["errors"][name] for name in ahead[1:])


def test_the_candidate_supplies_what_the_residual_lacks(worked_out: Workspace) -> None:
    """The force that the current adds is the mean residual, in sway, where that is far above the noise."""
    compared, found = worked_out.result("compare"), worked_out.result("diagnose")
    assert compared is not None
    assert found is not None
    profiles = found["candidates"][0]["supplied"]
    own, added = (
        next(p for p in table if (p["dof"], p["variable"]) == ("yaw", "psi"))
        for table in (compared["profiles"], profiles)
    )
    at = np.interp(added["centre"], own["centre"], own["force"])
    inside = slice(1, -1)  # the current is learned from a part of each log: outer bins differ
    left = np.sqrt(np.mean((np.array(added["force"]) - at)[inside] ** 2))
    assert left < 0.5 * np.sqrt(np.mean(at[inside] ** 2))


def test_simulations_go_with_the_measurement(worked_out: Workspace) -> None:
    found = worked_out.result("diagnose")
    assert found is not None
    horizon = list(found["traces"])[-1]

    def misses(runs: list[dict[str, Any]]) -> float:
        sway = next(c for c in runs[0]["channels"] if c["name"] == "v")
        t, y = (np.array(c, dtype=float) for c in sway["simulated"])
        there = np.isfinite(t) & np.isfinite(y)
        measured = np.interp(t[there], *np.array(sway["measured"], dtype=float))
        return float(np.sqrt(np.mean((y[there] - measured) ** 2)))

    with_current = found["candidates"][0]["traces"][horizon]
    assert misses(with_current) < 0.3 * misses(found["traces"][horizon])


@pytest.mark.slow
def test_add_makes_the_file_that_the_command_makes(
    place: Workspace, job: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    result = tasks.add(job(effect="ocean_current"))
    assert result["helps"]
    assert result["errors"]["force"] < 0.2 * result["refitted"]["force"] < result["given"]["force"]
    place.session.steps.append(ModelStep.model_validate(result["step"]))
    monkeypatch.chdir(tmp_path)
    line = next(line for line in commands(place) if line.startswith("undertow add"))
    words = line.split()[1:]
    assert main([*words, "--no-codegen"]) == 0
    made = tmp_path / words[words.index("--out") + 1]
    assert _without_history(made) == _without_history(place.vehicle_file())


@pytest.mark.slow
def test_an_effect_that_does_not_help_needs_a_second_word(place: Workspace, job: Make) -> None:
    found = tasks.add(job(effect="dry_friction"))
    assert not found["helps"]
    assert "step" not in found
    assert not list(place.folder.glob("model-*.toml"))


@pytest.mark.slow
def test_the_second_word_puts_it_in(job: Make) -> None:
    forced = tasks.add(job(effect="dry_friction", force=True))
    assert not forced["helps"]
    assert forced["step"]["file"] == "model-1.toml"


@pytest.mark.slow
def test_a_refit_says_what_the_logs_determine(place: Workspace, job: Make) -> None:
    found = tasks.fit(job())
    table = np.array(found["correlation"])
    assert np.allclose(np.diag(table), 1.0)
    assert np.allclose(table, table.T)
    assert [row["parameter"] for row in found["parameters"]] == found["names"]
    assert found["step"]["errors"]["force"] < found["given"]["force"]  # two bars of the waterfall
    fitted = load_vehicle(place.folder / found["step"]["file"])
    heave = next(row for row in found["parameters"] if row["parameter"] == "Z_w")
    assert fitted.value_of("Z_w").value == pytest.approx(heave["value"], rel=1e-6)


def test_values_are_edited_fixed_and_freed(place: Workspace, job: Make) -> None:
    wanted = {"X_u": {"value": -1.5, "estimate": False}, "m": {"value": 8.0, "estimate": True}}
    step = tasks.edit(job(values=wanted))["step"]
    edited = load_vehicle(place.folder / step["file"])
    assert (edited.value_of("X_u").value, edited.value_of("X_u").estimate) == (-1.5, False)
    assert (edited.value_of("m").value, edited.value_of("m").estimate) == (8.0, True)
    assert edited.value_of("Y_v") == load_vehicle(place.vehicle_file(0)).value_of("Y_v")
    assert step["what"] == "X_u = -1.5 fixed, m = 8 estimated"


def test_a_vehicle_that_cannot_be_is_refused(job: Make) -> None:
    with pytest.raises(UndertowError, match="m = "):
        tasks.edit(job(values={"m": {"value": -8.0, "estimate": False}}))


def test_stretches_are_written_as_logs_of_their_own(place: Workspace, job: Make) -> None:
    place.session.logs[0].stretches.append(LogSegment(start=20.0, end=30.0, role="out"))
    assert place.in_pieces
    place.session.written = tasks.write_logs(job())["logs"]
    names = [Path(name).name for name in place.session.written]
    assert names == ["train-1.csv", "train-2.csv", "judge-1.csv"]
    whole = read_log(DEMO / "train_1.csv.gz", commands=["f1"])
    parts = [read_log(path, commands=["f1"]) for path in place.session.written[:2]]
    inside = (whole.t < 20.0) | (whole.t >= 30.0)
    assert np.array_equal(np.concatenate([p.t for p in parts]), whole.t[inside])
    assert np.array_equal(np.concatenate([p.channels["u"] for p in parts]), whole.channels["u"][inside])
    assert "--map" not in place.line().options
    noisy = LogMapping.model_validate({"columns": {"u": {"channel": "u", "noise": "1 cm/s"}}})
    (place.folder / "noise.toml").write_text(mapping_text(noisy), encoding="utf-8")
    place.session.mapping = str(place.folder / "noise.toml")
    place.session.written = tasks.write_logs(job())["logs"]
    option, beside = place.line().options[:2]
    assert (option, Path(beside).name) == ("--map", "train-1.toml")
    part = read_log(place.session.written[0], place.folder / "train-1.toml", commands=["f1"])
    assert part.sigma == {"u": pytest.approx(0.01)}


@pytest.mark.slow
def test_stretches_of_one_log_may_train_and_judge(place: Workspace, job: Make) -> None:
    place.session.logs = place.session.logs[:1]
    place.session.logs[0].stretches.append(LogSegment(start=40.0, end=60.0, role="judge"))
    train, judge = job().to_fit
    assert [r.origin for r in (*train, *judge)] == ["train_1"] * 2
    assert math.isfinite(tasks.fit(job())["step"]["errors"]["free run"])


def test_outputs_replace_no_input(place: Workspace, job: Make) -> None:
    for task in (tasks.write_vehicle, tasks.write_report):
        with pytest.raises(UndertowError, match=r"is the input .*choose another name"):
            task(job(out=place.session.vehicle))


@pytest.mark.slow
def test_report_and_code_are_written(place: Workspace, job: Make, tmp_path: Path) -> None:
    tasks.write_report(job(out=str(tmp_path / "report.html")))
    assert "ocean_current" in (tmp_path / "report.html").read_text()
    (folder,) = tasks.write_code(job(out=str(tmp_path / "code")))["written"]
    assert list(Path(folder).rglob("*_vehicle.c"))


def test_an_effect_is_made_of_what_remains(place: Workspace, job: Make) -> None:
    found = place.result("diagnose")
    assert found is not None
    left = found["diagnosis"]["remaining"][0]
    left["depends_on"] = [
        {
            "term": "|u|u", "columns": [["|u|", "u"]], "coefficients": [2.0], "standard_errors": [0.1],
            "units": ["kg/m"], "share": 0.5, "chance": 0.001, "alike": [],
        }
    ]  # fmt: skip
    place.keep("diagnose", place.key, found)
    made = tasks.invent(job(effect="my_force"))
    assert "per |u| u" in made["terms"][0]
    place.take_effect(made["file"])
    known = Job(place, {}, lambda done, words: None).known
    assert known["my_force"].family
    with pytest.raises(UndertowError, match="is there already"):
        tasks.invent(job(effect="my_force"))


def test_the_waterfall_has_the_refit_between_two_models() -> None:
    steps = [ModelStep(what="as given", errors={"force": 53.0})]
    steps.append(ModelStep(what="with lift", errors={"force": 1.0, "5 s": 0.02}, refitted={"force": 13.0}))
    assert list(error_steps(steps, "force")) == [("as given", 53.0), ("refitted", 13.0), ("with lift", 1.0)]
    assert list(error_steps(steps, "5 s")) == [("as given", None), ("with lift", 0.02)]


def test_work_is_done_in_another_process_and_can_be_cancelled(tmp_path: Path) -> None:
    bench = Bench.open(tmp_path / "kept", session_of(tmp_path))
    try:
        bench.start("edit", values={"X_u": {"value": -1.0, "estimate": True}})
        _until(lambda: bench.work is None)
        assert bench.failure == ""
        assert [s.what for s in bench.session.steps] == ["as given", "X_u = -1 estimated"]
        bench.start("diagnose")
        process = bench.worker._process  # private: whether it is gone
        assert process.pid != 0
        bench.start("compare")
        assert "is still running" in bench.failure
        bench.cancel()
        assert bench.work is None
        assert not process.is_alive()
        bench.undo()
        assert bench.vehicle.value_of("X_u").value == pytest.approx(-0.6445)
        bench.start("edit", values={"m": {"value": -1.0, "estimate": True}})
        _until(lambda: bench.work is None)
        assert "m = " in bench.failure
        assert len(bench.session.steps) == 1
    finally:
        bench.close()


def _until(done: Callable[[], bool], patience: float = 60.0) -> None:
    from threading import Event

    tick = Event()
    for _ in range(int(patience / 0.02)):
        if done():
            return
        tick.wait(0.02)
    raise AssertionError(f"not done after {patience:g} s")
