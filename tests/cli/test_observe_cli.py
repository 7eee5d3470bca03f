"""`undertow observe`, and the commands that take its files."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import undertow
from benchmarks.observer_log import auv, log
from undertow.cli.main import main
from undertow.observer.design import load_observer


@pytest.fixture(scope="module")
def dive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Positions and headings of fifteen seconds."""
    run, _, _ = log(auv(), 15.0, 1, {"x": 1, "y": 1, "z": 1, "psi": 1})
    path = tmp_path_factory.mktemp("dive") / "dive.csv"
    pl.DataFrame({"t": run.t, **run.channels}).write_csv(path)
    return path


def test_a_log_gets_velocities_with_deviations(dive: Path, tmp_path: Path, capsys) -> None:
    out, save, picture = (tmp_path / n for n in ("smoothed.csv", "observer.toml", "observed.png"))
    files = ["--out", str(out), "--save", str(save), "--plot", str(picture)]
    assert main(["observe", "mini-auv", str(dive), *files]) == 0
    assert "NIS" in capsys.readouterr().out
    table = pl.read_csv(out)
    assert {"t", "x", "u", "r", "f1", "sd_x", "sd_u"} <= set(table.columns)
    assert table["sd_u"].max() < 1.0
    assert picture.stat().st_size > 10_000
    assert main(["compare", "mini-auv", str(out)]) == 0


@pytest.mark.slow
def test_json_has_the_numbers_and_the_file_the_current(dive: Path, tmp_path: Path, capsys) -> None:
    save = tmp_path / "observer.toml"
    words = ["--process", "model", "--current", "--json", "--save", str(save)]
    assert main(["observe", "mini-auv", str(dive), *words]) == 0
    saved = load_observer(save, undertow.load_vehicle("mini-auv"))
    assert saved.process.estimated == ("V_N", "V_E")
    content = json.loads(capsys.readouterr().out)
    assert content["parameters"]["V_N"]["sigma"] > 0
    assert abs(content["parameters"]["V_N"]["value"]) < 4 * content["parameters"]["V_N"]["sigma"]
    assert np.isfinite(content["nis"][-1]["mean"])


@pytest.mark.slow
def test_the_chain_from_a_log_to_a_loop_and_to_c(dive: Path, tmp_path: Path, capsys) -> None:
    save = tmp_path / "observer.toml"
    assert main(["observe", "mini-auv", str(dive), "--process", "model", "--save", str(save)]) == 0
    loop = ["simulate", "mini-auv", "paper-pd", "--to=0,0,0.2,0.1", "--for", "2", "--dt", "0.1"]
    assert main([*loop, "--observer", str(save)]) == 0
    assert main(["linearize", "mini-auv", "--gains", "paper-pid", "--observer", str(save)]) == 0
    capsys.readouterr()
    assert (
        main(["gains", "mini-auv", "paper-pd", "--form", "derived", "--observer", str(save), "--json"]) == 0
    )
    assert json.loads(capsys.readouterr().out)["loop_with_observer"]["verdict"] == "stable"
    assert main(["export", "c", "mini-auv", "--observer", str(save), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "mini-auv" / "src" / "mini_auv_observer.c").is_file()
    assert main(["export", "c", "mini-auv", "--observer", str(save), "--out", str(tmp_path), "--check"]) == 0


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["--current"], "does not show in kinematics"),
        (["--process", "model", "--out", "made.csv"], "--trust-model"),
        (["--bias", "q"], "does not occur"),
    ],
)
def test_what_makes_no_sense_is_refused(dive: Path, words, complaint, capsys, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["observe", "mini-auv", str(dive), *words]) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert "Traceback" not in error
    assert not (tmp_path / "made.csv").exists()


def test_an_observer_without_a_law_is_refused(tmp_path: Path, capsys) -> None:
    assert main(["linearize", "mini-auv", "--observer", str(tmp_path / "none.toml")]) == 2
    assert "--gains" in capsys.readouterr().err


@pytest.mark.slow
def test_a_diagnosis_of_smoothed_velocities_names_the_hidden_current(tmp_path: Path, capsys) -> None:
    """The demo, whose velocities are taken away first: positions and heading alone are left."""
    demo = Path(undertow.__file__).parent / "demo_data" / "auv"
    vehicle = str(demo / "vehicle.toml")
    smoothed = {}
    for name in ("train_1", "train_2", "train_3", "holdout"):
        table = pl.read_csv(demo / f"{name}.csv.gz", infer_schema_length=None)
        table.drop(["u", "v", "w", "p", "q", "r"]).write_csv(tmp_path / f"{name}.csv")
        smoothed[name] = str(tmp_path / f"{name}-smoothed.csv")
        assert main(["observe", vehicle, str(tmp_path / f"{name}.csv"), "--out", smoothed[name]]) == 0
    capsys.readouterr()
    *fitted, kept = smoothed.values()
    assert main(["diagnose", vehicle, *fitted, "--validation", kept]) == 0
    assert "Missing: ocean_current" in " ".join(capsys.readouterr().out.split())


def test_several_logs_have_numbered_files_and_common_tests(dive: Path, tmp_path: Path, capsys) -> None:
    second = tmp_path / "second.csv"
    pl.read_csv(dive).with_columns(pl.col("x") + 1.0).write_csv(second)
    command = ["observe", "mini-auv", str(dive), str(second), "--out", str(tmp_path / "smoothed.csv")]
    assert main(command) == 0
    reported = " ".join(capsys.readouterr().out.split())
    assert "Innovations of all 2 logs" in reported
    first, other = (pl.read_csv(tmp_path / f"smoothed-{k}.csv") for k in (1, 2))
    np.testing.assert_allclose(other["x"] - first["x"], 1.0, atol=1e-3)
    assert not (tmp_path / "smoothed.csv").exists()


# --- errors against true states ---------------------------------------------------------------------
@pytest.fixture(scope="module")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A simulated log, and the true states of it."""
    folder = tmp_path_factory.mktemp("simulated")
    log_file, states = folder / "log.csv", folder / "states.csv"
    noise = [f"--noise={n}={s}" for n, s in {"x": 0.02, "y": 0.02, "z": 0.02, "psi": 0.01}.items()]
    noise += [f"--noise={n}={s}" for n, s in {"u": 0.01, "v": 0.01, "w": 0.01, "r": 0.01}.items()]
    words = ["--to=1,1,0.5", "--for=20", "--dt=0.1", "--log=0.1", "--seed=3"]
    files = ["--out", str(log_file), "--states", str(states)]
    assert main(["simulate", "mini-auv", "paper-pd", *words, *noise, *files]) == 0
    return log_file, states


def test_errors_against_the_true_states_of_a_simulation_are_tested(simulated, capsys) -> None:
    log_file, states = simulated
    true, seen = (pl.read_csv(path, infer_schema_length=None) for path in (states, log_file))
    assert true.columns == ["t", "x", "y", "z", "psi", "u", "v", "w", "r"]
    assert (true["x"] - seen["x"]).std() == pytest.approx(0.02, rel=0.2)
    capsys.readouterr()
    command = ["observe", "mini-auv", str(log_file), "--reference", str(states)]
    assert main([*command, "--json"]) == 0
    groups = {one["name"]: one for one in json.loads(capsys.readouterr().out)["nees"]}
    assert list(groups) == ["position", "attitude", "velocity", "rates", "all"]
    assert groups["velocity"]["states"] == ["u", "v", "w"]
    for one in groups.values():
        assert one["low"] < 1 < one["high"]
        assert one["honest"] == (one["low"] <= one["mean"] <= one["high"])
        assert one["independent"] < one["count"]
    assert main(command) == 0
    reported = " ".join(capsys.readouterr().out.split())
    assert "Errors of the filter" in reported
    assert f"{groups['all']['mean']:.3f}" in reported


@pytest.mark.parametrize(
    ("columns", "complaint"),
    [
        ({"t": [0.0, 0.1, 0.2], "temperature": [1.0, 2.0, 3.0]}, "name its columns in a mapping file"),
        ({"t": [900.0, 900.1], "x": [0.0, 0.0]}, "put both on one clock"),
        ({"t": [0.05, 2.05], "x": [0.0, 0.0]}, "0.1 s is the limit between rows of the log"),
        (None, "is the log"),
    ],
)
def test_a_reference_that_says_nothing_is_refused(
    simulated, tmp_path: Path, columns, complaint, capsys
) -> None:
    log_file = reference = tmp_path / "log.csv"
    pl.read_csv(simulated[0], infer_schema_length=None).head(30).write_csv(log_file)
    if columns is not None:
        reference = tmp_path / "reference.csv"
        pl.DataFrame(columns).write_csv(reference)
    assert main(["observe", "mini-auv", str(log_file), "--reference", str(reference)]) == 2
    error = capsys.readouterr().err
    assert complaint in " ".join(error.split())
    assert "Traceback" not in error


def test_every_log_needs_its_reference(simulated, dive: Path, capsys) -> None:
    log_file, states = simulated
    assert main(["observe", "mini-auv", str(log_file), str(dive), "--reference", str(states)]) == 2
    assert "names 1 files, but there are 2 logs" in " ".join(capsys.readouterr().err.split())


def test_states_of_several_runs_do_not_go_into_one_file(tmp_path: Path, capsys) -> None:
    words = ["--to=1,0,0", "--states", str(tmp_path / "states.csv")]
    assert main(["simulate", "mini-auv", "paper-pd", "paper-pid", *words]) == 2
    assert "--states" in capsys.readouterr().err
