"""`undertow doctor`: exit codes, what it prints, and the files it writes."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import pytest

from benchmarks.hidden_effects import Case, make_case
from benchmarks.hidden_effects.files import toml_text
from tests.cli.bad import contents, refusal, text_of
from tests.quick import first_quick
from undertow.cli.main import main
from undertow.identification.diagnosis.result import Diagnosis
from undertow.identification.findings import Examination

LOG = ["doctor", "usv.toml", "train.csv"]


@cache
def _box() -> Case:
    return make_case("box", (), 4, duration=25.0, runs=("multisine",))


def _lines(capsys: pytest.CaptureFixture[str]) -> list[str]:
    return [line.strip() for line in capsys.readouterr().out.splitlines()]


def _reverse_sway(case: Path) -> None:
    """v with the opposite sign."""
    head, *rows = (case / "train.csv").read_text().splitlines()
    place = head.split(",").index("v")
    cells = [row.split(",") for row in rows]
    turned = [[*c[:place], repr(-float(c[place])), *c[place + 1 :]] for c in cells]
    (case / "train.csv").write_text("\n".join([head, *(",".join(c) for c in turned)]) + "\n")


def test_a_log_without_a_mistake_is_fine(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(case)
    assert main(LOG) == 0
    out = _lines(capsys)
    assert out[-1].startswith("no mistake found in how the logs are read")
    assert any(line.startswith("surge (u)") for line in out)
    assert contents(case) == before


def test_a_mistake_comes_first_with_the_line_that_mends_it(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _reverse_sway(case)
    words = [*LOG, "--json", "out.json", "--mend", "mended.toml", "--plot", "rates.png"]
    assert main(words) == 1
    out = _lines(capsys)
    assert out[0].startswith(
        "mistake: v has the opposite sign: when corrected, the mismatch between pose rate and velocity"
    )
    assert out[2:4] == ["[columns]", 'v = { channel = "v", scale = -1.0 }']
    assert any(line.startswith("1 mistake") and "v has the opposite sign" in line for line in out)
    result = Examination.model_validate_json(Path("out.json").read_text())
    assert result.findings[0] == result.mistakes[0]
    assert (case / "rates.png").read_bytes().startswith(b"\x89PNG")
    assert [line for line in out if line.startswith("wrote")] == [
        "wrote out.json",
        "wrote mended.toml",
        "wrote rates.png",
    ]
    assert main([*LOG, "--map", "mended.toml"]) == 0
    capsys.readouterr()


def test_a_mapping_file_is_mended_with_its_comments(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _reverse_sway(case)
    (case / "log.toml").write_text(
        '# of the boat\nschema = "undertow/mapping/1"\n\n[columns]\nv = "v" # doppler\n'
    )
    assert main([*LOG, "--map", "log.toml", "--mend", "mended.toml"]) == 1
    mended = (case / "mended.toml").read_text()
    assert mended.startswith('# of the boat\nschema = "undertow/mapping/1"\n\n[columns]\n')
    assert 'v = { channel = "v", scale = -1.0 }' in mended
    assert "in log.toml:" in _lines(capsys)


def test_rows_out_of_order_are_reported_and_not_refused(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    head, *rows = (case / "train.csv").read_text().splitlines()
    (case / "train.csv").write_text("\n".join([head, *rows[:100], rows[50], rows[99], *rows[100:]]) + "\n")
    assert main([*LOG, "--mend", "mended.toml"]) == 1
    out = _lines(capsys)
    assert out[0].startswith("mistake: train: 2 of 402 rows are not later than an earlier row")
    text = (case / "mended.toml").read_text()
    assert text == 'schema = "undertow/mapping/1"\n\n[time]\ndisorder = "drop"\n'
    assert main(["compare", *LOG[1:], "--map", "mended.toml"]) == 0
    assert main(["compare", *LOG[1:]]) == 2
    capsys.readouterr()


def test_a_part_of_the_log_and_several_logs(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*LOG, "holdout.csv", "--from", "5", "--to", "15", "--json", "out.json"]) == 0
    assert json.loads(Path("out.json").read_text())["runs"] == ["train", "holdout"]
    capsys.readouterr()


@pytest.mark.parametrize(
    ("words", "reported"),
    [
        (["doctor", "usv.toml", "none.csv"], "none.csv does not exist"),
        (["doctor", "none.toml", "train.csv"], "none"),
        ([*LOG, "--map", "none.toml"], "mapping file none.toml"),
        ([*LOG, "--json", "train.csv"], "'train.csv' is the input"),
        ([*LOG, "--plot", "no/where.png"], "folder 'no' does not exist"),
    ],
)
def test_bad_input_is_one_line(
    case: Path, capsys: pytest.CaptureFixture[str], words: list[str], reported: str
) -> None:
    assert reported in refusal(words, capsys, case)


def test_the_help_teaches_by_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--help"]) == 0
    out = "\n".join(_lines(capsys))
    assert "undertow doctor rov.toml run1.csv run2.csv --map log.toml --mend mended.toml" in out
    assert 'heading = { channel = "psi", unit = "deg" }' in out


@pytest.mark.slow
def test_diagnose_tells_the_mistake_before_it_blames_physics(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    columns = _box().runs["multisine"]
    Path("box.toml").write_text(toml_text(_box().vehicle))
    Path("log.csv").write_text(text_of({**columns, "u": -columns["u"]}))
    assert main(["diagnose", "box.toml", "log.csv", "--json", "out.json"]) == 2
    assert "u has the opposite sign" in capsys.readouterr().err
    assert main(["diagnose", "box.toml", "log.csv", "--json", "out.json", "--trust-log"]) == 0
    captured = capsys.readouterr()
    assert captured.err.startswith("warning: u has the opposite sign")
    out = [line.strip() for line in captured.out.splitlines()]
    assert out[0].startswith("mistake: u has the opposite sign")
    assert 'u = { channel = "u", scale = -1.0 }' in out[:5]
    diagnosis = Diagnosis.model_validate_json(Path("out.json").read_text())
    assert diagnosis.doctor[0].id == "flipped_axis"
    assert diagnosis.warnings[0] == f"mistake: {diagnosis.doctor[0].text}"


FITTING = [
    ["fit", "box.toml", "log.csv"],
    ["add", "thruster_lag", "box.toml", "log.csv"],
    ["diagnose", "box.toml", "log.csv"],
    ["compare", "box.toml", "log.csv"],
    ["identify", "box.toml", "log.csv"],
    ["identify", "box.toml", "log.csv", "--stream"],
    ["plan", "box.toml", "log.csv"],
]


@pytest.mark.parametrize(
    "words", first_quick(FITTING, 3), ids=[f"{w[0]}{w[3] if w[-1] == '--stream' else ''}" for w in FITTING]
)
def test_every_command_that_fits_refuses_what_cannot_be(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    columns = _box().runs["multisine"]
    Path("box.toml").write_text(toml_text(_box().vehicle))
    Path("log.csv").write_text(
        text_of({n: columns[n] for n in ("t", "u", "f1", "f2")} | {"u": 1e3 * columns["u"]})
    )
    line = refusal(words, capsys, tmp_path)
    assert "is impossible: u is in mm/s, read as m/s: the surge of the log needs" in line
    assert 'write [columns] u = { channel = "u", unit = "mm/s" } into the mapping file' in line
    assert "--trust-log" in line


@pytest.mark.parametrize(
    "words", ["fit", "add", "diagnose", "compare", "identify", "plan", "fleet diagnose", "fleet rollouts"]
)
def test_every_command_that_fits_can_be_told_to_trust(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*words.split(), "--help"]) == 0
    assert "--trust-log" in capsys.readouterr().out
