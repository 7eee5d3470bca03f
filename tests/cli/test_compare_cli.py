"""`undertow compare` and `undertow fit` on a short case: what they print, write and leave alone."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from tests.cli.bad import SURGE, surge_log
from tests.quick import first_quick
from undertow.cli.main import each_named, main
from undertow.identification.comparison import ComparisonResult
from undertow.model.loading import load_vehicle

LOG = ["usv.toml", "train.csv"]


def _lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return capsys.readouterr().out.splitlines()


# --- compare ----------------------------------------------------------------------------------------------


def test_compare_ends_with_where_the_model_fails(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", *LOG, "--json", "out.json"]) == 0
    out = _lines(capsys)
    result = ComparisonResult.model_validate_json(Path("out.json").read_text())
    assert out[-1] == f"usv: {result.headline}"
    assert "fails most in" in result.headline
    assert any("noise explains" in line for line in out)
    assert any("velocity error 5 s ahead" in line for line in out)
    assert [r.name for r in result.runs] == ["train"]


def test_compare_takes_several_logs_and_a_part_of_them(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "compare",
        *LOG,
        "holdout.csv",
        "--from",
        "2",
        "--to",
        "12",
        "--horizon",
        "2",
        "--json",
        "out.json",
    ]
    assert main(words) == 0
    result = json.loads(Path("out.json").read_text())
    assert [r["samples"] for r in result["runs"]] == [201, 201]
    assert result["horizon"] == 2.0
    assert result["windows"] == 10


@pytest.mark.slow
def test_compare_draws_what_it_found(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["compare", *LOG, "--plots", "pictures"]) == 0
    drawn = sorted(p.name for p in Path("pictures").iterdir())
    assert drawn == [
        "ahead_1_train.png",
        "error_map.png",
        "force_budget.png",
        "free_run_1_train.png",
        "residual_surge.png",
        "residual_sway.png",
        "residual_yaw.png",
    ]
    assert all((Path("pictures") / n).read_bytes().startswith(b"\x89PNG") for n in drawn)
    assert "7 pictures in pictures" in _lines(capsys)


@pytest.mark.slow
def test_what_is_unexplained_comes_last_in_the_budget(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Also below effects that only act in a later motion."""
    usv = Path("usv.toml")
    usv.write_text(usv.read_text() + "\n[effects.linear_damping_coupling]\nN_v = 1.0\n")
    assert main(["compare", *LOG]) == 0
    lines = [line.split() for line in _lines(capsys)]
    first = [words[0] if words else "" for words in lines]
    begin = lines.index(["Force", "budget,", "%", "of", "all", "rms"])
    rows = first[begin + 2 : first.index("velocity", begin)]
    assert "linear_damping_coupling" in rows
    assert rows[-1] == "unexplained"


def test_logs_of_the_same_name_are_told_apart(case: Path) -> None:
    (case / "other").mkdir()
    (case / "other" / "train.csv").write_text((case / "holdout.csv").read_text())
    assert main(["compare", *LOG, "other/train.csv", "--json", "out.json"]) == 0
    names = [r["name"] for r in json.loads(Path("out.json").read_text())["runs"]]
    assert names == [f"{case.name}/train", "other/train"]


# --- fit --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "method", first_quick(["weak", "output-error", "integral", "instrumental", "prediction-error"], 2)
)
def test_fit_writes_what_it_found(case: Path, capsys: pytest.CaptureFixture[str], method: str) -> None:
    words = ["fit", *LOG, "--validation", "holdout.csv", "--method", method, "--out", "new.toml", "--force"]
    assert main(words) == 0
    out = "\n".join(_lines(capsys))
    assert "condition number" in out
    assert "wrote new.toml" in out
    before, after = load_vehicle("usv.toml"), load_vehicle("new.toml")
    assert after.value_of("X_udot").value != before.value_of("X_udot").value
    assert after.value_of("X_udot").estimate
    reported = tomllib.loads(Path("new.toml").read_text())["history"][0]
    assert reported["command"] == f"undertow fit --method {method}"
    assert [log["role"] for log in reported["logs"]] == ["train", "holdout"]
    assert reported["error_after"] != reported["error_before"]
    assert len(reported["covariance"]["matrix"]) == len(reported["covariance"]["parameters"]) == 9


def test_fit_keeps_stretches_aside_and_writes_nothing_unasked(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = (case / "usv.toml").read_bytes()
    assert main(["fit", *LOG]) == 0
    assert "nothing was written" in _lines(capsys)[-1]
    assert sorted(p.name for p in case.iterdir()) == ["holdout.csv", "train.csv", "usv.toml"]
    assert (case / "usv.toml").read_bytes() == before


def test_fit_prints_the_correlation_matrix_that_its_covariance_has(
    case: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert (
        main(["fit", *LOG, "--validation", "holdout.csv", "--correlation", "--out", "new.toml", "--force"])
        == 0
    )
    lines = _lines(capsys)
    covariance = tomllib.loads(Path("new.toml").read_text())["history"][0]["covariance"]
    matrix, names = np.array(covariance["matrix"]), covariance["parameters"]
    spread = np.sqrt(np.diag(matrix))
    start = next(i for i, line in enumerate(lines) if "Correlation of the errors" in line)
    for k, name in enumerate(names):
        row = next(line.split() for line in lines[start + 2 :] if line.split()[:1] == [name])
        np.testing.assert_allclose([float(c) for c in row[1:]], matrix[k] / spread[k] / spread, atol=0.0051)


def test_fit_in_place_changes_the_file(case: Path) -> None:
    old = load_vehicle("usv.toml")
    assert main(["fit", *LOG, "--validation", "holdout.csv", "--in-place", "--force"]) == 0
    assert load_vehicle("usv.toml").value_of("Y_v").value != old.value_of("Y_v").value


def test_fit_prints_values_in_the_signs_of_the_file(
    case: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    text = (case / "usv.toml").read_text().replace('"sname"', '"magnitudes"')
    text = text.replace("value = -", "value = ")
    (case / "positive.toml").write_text(text)
    assert main(["fit", "positive.toml", "train.csv", "--holdout", "holdout.csv"]) == 0
    (line,) = [line for line in _lines(capsys) if line.split()[:1] == ["Y_vdot"]]
    assert float(line.split()[1]) > 0


def test_fit_needs_something_to_estimate(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (case / "usv.toml").read_text().replace("estimate = true", "estimate = false")
    (case / "known.toml").write_text(text)
    assert main(["fit", "known.toml", "train.csv"]) == 2
    assert "no parameter of 'usv' is marked for estimation" in capsys.readouterr().err


def test_an_unknown_method_is_refused(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["fit", *LOG, "--method", "magic"]) == 2
    assert "'magic'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        ("v a --validation b c --out o", "v a --validation b --validation c --out o"),
        ("v a --validation b --validation c d", "v a --validation b --validation c --validation d"),
        ("v a --validation b --out o c", "v a --validation b --out o c"),
        ("v a --validation b -- c", "v a --validation b -- c"),
        ("v a --holdout b c", "v a --holdout b --holdout c"),
        ("v a --in-place", "v a --in-place"),
    ],
)
def test_every_log_after_the_option_is_for_validation(words: str, meant: str) -> None:
    assert each_named(words.split()) == meant.split()


@pytest.mark.slow
def test_two_logs_kept_aside_are_both_kept_aside(case: Path) -> None:
    rows = (case / "holdout.csv").read_text().splitlines(keepends=True)
    (case / "more.csv").write_text("".join(rows[:300]))
    assert main(["fit", *LOG, "--force", "--out", "new.toml", "--validation", "holdout.csv", "more.csv"]) == 0
    logs = tomllib.loads(Path("new.toml").read_text())["history"][0]["logs"]
    assert [(log["name"], log["role"]) for log in logs] == [
        ("train", "train"),
        ("holdout", "holdout"),
        ("more", "holdout"),
    ]


@pytest.mark.slow
def test_an_equality_is_fitted_told_and_written(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["fit", *LOG, "--validation", "holdout.csv", "--equal", "Y_vdot = 1.5 X_udot", "--dissipative"]
    assert main([*words, "--out", "new.toml", "--force"]) == 0
    out = "\n".join(_lines(capsys))
    assert "tied to X_udot" in out
    after = load_vehicle("new.toml")
    assert after.value_of("Y_vdot").value == pytest.approx(1.5 * after.value_of("X_udot").value, rel=1e-6)
    reported = tomllib.loads(Path("new.toml").read_text())["history"][0]
    assert reported["command"] == 'undertow fit --method default --equal "Y_vdot = 1.5 X_udot" --dissipative'
    assert "Y_vdot" not in reported["covariance"]["parameters"]
    assert main(["fit", *LOG, "--equal", "Y_vdot = 1.5 Q_x"]) == 2
    assert "'Q_x' is not a parameter in the equations of 'usv'" in capsys.readouterr().err


@pytest.mark.slow
def test_the_command_of_the_history_fits_the_same_again(case: Path) -> None:
    words = [*LOG, "--validation", "holdout.csv"]
    chosen = ["--method", "output-error", "--horizon", "2.5"]
    assert main(["fit", *words, *chosen, "--out", "new.toml", "--force"]) == 0
    reported = tomllib.loads(Path("new.toml").read_text())["history"][0]
    assert reported["command"] == "undertow fit --method output-error --horizon 2.5"
    again = reported["command"].split()[2:]
    assert main(["fit", *words, *again, "--out", "again.toml", "--force"]) == 0
    repeated = tomllib.loads(Path("again.toml").read_text())["history"][0]
    for number in ("error_before", "error_after"):
        assert repeated[number] == pytest.approx(reported[number], rel=1e-9)


def test_a_robust_loss_is_one_of_output_error_and_the_weak_form(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["fit", *LOG, "--validation", "holdout.csv", "--loss", "huber"]
    assert main([*words, "--method", "output-error", "--out", "new.toml", "--force"]) == 0
    reported = tomllib.loads(Path("new.toml").read_text())["history"][0]
    assert reported["command"] == "undertow fit --method output-error --loss huber"
    assert main([*words, "--method", "prediction-error"]) == 2
    assert "'huber' does not apply to --method prediction-error" in capsys.readouterr().err


def test_a_fit_that_predicts_worse_is_not_written_without_force(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = sorted(p.name for p in case.iterdir())
    words = ["fit", *LOG, "--validation", "holdout.csv", "--method", "weak", "--json", "fit.json"]
    assert main([*words, "--out", "new.toml"]) == 1
    out, err = capsys.readouterr()
    assert sorted(p.name for p in case.iterdir()) == sorted([*before, "fit.json"])
    written = json.loads(Path("fit.json").read_text())
    assert written["schema_id"] == "undertow/fit/1"
    assert written["error_after"] > 1.2 * written["error_before"]
    # What the screen says of values is in the file, too.
    words_of = {name: f"  {name}: {'; '.join(said)}" for name, said in written["remarks"].items()}
    assert all(line in out.splitlines() for line in words_of.values())
    assert all(note in " ".join(out.split()) for note in written["notes"])
    assert written["remarks"] or written["notes"]
    longest = list(written["ahead_before"])[-1]
    percent = [f"{100 * written[f'ahead_{when}'][longest]:.0f}" for when in ("before", "after")]
    said = out.splitlines()[0]
    assert said.startswith("Refitting raises the ")
    assert f"{longest.replace(' ', '-')} error from {percent[0]} to {percent[1]}%" in said
    assert err == f"{said} No vehicle file was written; --force writes it\n"
    assert main([*words, "--out", "new.toml", "--force"]) == 0
    value = load_vehicle("new.toml").value_of("X_udot").value
    assert value == pytest.approx(written["parameters"][0]["value"], rel=1e-6)


def test_a_model_that_is_pushed_the_wrong_way_is_called_worse_than_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """With the sign of the force turned, the hull is predicted to go backward at the speed it goes ahead."""
    monkeypatch.chdir(tmp_path)
    Path("hull.toml").write_text(SURGE)
    log = surge_log(1500)
    log.write_csv("right.csv")
    log.with_columns(-log["tau_X"]).write_csv("wrong.csv")
    for name, said in (("right", 0), ("wrong", 1)):
        for command in (["compare"], ["fit"]):
            assert main([*command, "hull.toml", f"{name}.csv", "--trust-log"]) == 0
            out = " ".join(capsys.readouterr().out.split())
            assert out.count("Worse than no model at all in surge") == said, (command, name)
