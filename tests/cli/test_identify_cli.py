"""`undertow identify` and `undertow audit-tables` on the command line."""

from __future__ import annotations

import gzip
import json
import tomllib
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from tests.identification.test_least_squares import profile_p
from undertow.cli.main import main
from undertow.identification.logs.chunks import LongLog
from undertow.model.loading import load_vehicle
from undertow.paper.figures import figures
from undertow.paper.least_squares import experiments

Capture = pytest.CaptureFixture[str]


@pytest.fixture
def logs(here: Path) -> Path:
    for name, sign in (("ahead", 1.0), ("astern", -1.0)):
        run = profile_p(0.2, sign)
        pl.DataFrame({"t": run.t, **run.channels}).write_csv(here / f"{name}.csv")
    return here


def test_all_cases_of_both_directions_in_tables(logs: Path, capsys: Capture) -> None:
    assert main(["identify", "mini-auv", "ahead.csv", "astern.csv", "--cases", "2,8,10,11"]) == 0
    out = capsys.readouterr().out
    assert out.index("surge, forward (ahead; 150 samples)") < out.index(
        "surge, backward (astern; 150 samples)"
    )
    assert "m_x, kg (|t|)" in out
    assert "X_uabsu, kg/m (|t|)" in out
    rows = [line.split() for line in out.splitlines() if line.startswith("  8 ")]
    assert len(rows) == 2
    for row in rows:
        assert float(row[1]) == pytest.approx(9.866323, abs=6e-6)
        assert float(row[5]) == pytest.approx(-0.102889, abs=6e-7)
        assert " ".join(row[-2:]) == "no: X_u"
    assert (
        out.count("selected: case 2 (velocity (1, 3), acceleration (1, 3)); of the cases whose estimates are")
        == 2
    )
    assert out.count("X_u is not determined by this experiment: |t| = 0.") == 2
    assert "no vehicle file was written" in out
    assert sorted(p.name for p in logs.iterdir()) == ["ahead.csv", "astern.csv"]


def test_the_figures_of_the_paper_show_the_filtered_signals(logs: Path, capsys: Capture) -> None:
    words = ["identify", "mini-auv", "ahead.csv", "--cases", "2", "--figures"]
    assert main([*words, "pictures"]) == 0
    assert {p.name for p in (logs / "pictures").iterdir()} == {f"figure-{n}.png" for n in range(6, 13)}
    assert main([*words, "more", "--stream"]) == 2
    assert "--figures needs logs that are read whole" in capsys.readouterr().err
    vehicle = load_vehicle("mini-auv")
    drawn = figures(experiments(vehicle, [profile_p(0.2, 1.0), profile_p(0.25, 1.0)]), "interp")
    # Case 1 is as logged, the double filter leaves less from sample to sample, two runs two panels.
    assert len(drawn["figure-6"].axes) == 2
    logged = drawn["figure-6"].axes[0].lines[0].get_ydata()
    np.testing.assert_array_equal(logged, profile_p(0.2, 1.0).channels["u"])
    once, twice = (drawn[f"figure-{n}"].axes[0].lines[i].get_ydata() for n, i in ((7, 1), (9, 0)))
    assert np.abs(np.diff(twice, 2)).sum() < np.abs(np.diff(once, 2)).sum()
    assert [line.get_label() for line in drawn["figure-10"].axes[0].lines] == [
        f"{run.name}, {run.t.size} samples" for run in (profile_p(0.2, 1.0), profile_p(0.25, 1.0))
    ]


def test_the_chosen_set_goes_into_a_vehicle_file_with_its_covariance(logs: Path, capsys: Capture) -> None:
    words = ["identify", "mini-auv", "ahead.csv", "astern.csv", "--cases", "2,10", "--out", "new.toml"]
    assert main([*words, "--json", "all.json"]) == 0
    new, old = load_vehicle("new.toml"), load_vehicle("mini-auv")
    assert new.value_of("X_udot_forward").value == pytest.approx(7.5 - 9.276339, abs=1e-6)
    assert new.value_of("X_uabsu_backward").value == pytest.approx(-5.349356, abs=1e-6)
    assert new.value_of("Z_w_forward") == old.value_of("Z_w_forward")
    (history,) = tomllib.loads((logs / "new.toml").read_text())["history"]
    found = {c["case"]: c for c in json.loads((logs / "all.json").read_text())["motions"][0]["cases"]}
    assert list(found) == ["2", "10"]
    matrix = np.array(history["covariance"]["matrix"])
    assert matrix.shape == (6, 6)
    np.testing.assert_allclose(matrix[:3, :3], found["2"]["covariance"], rtol=1e-5)
    errors = found["2"]["standard_errors"]
    assert new.value_of("X_u_forward").sigma == pytest.approx(errors["X_u"])
    assert [entry["name"] for entry in history["logs"]] == ["ahead", "astern"]
    assert "surge, backward: case 2" in history["command"]


def test_logs_in_parts_give_the_same_tables(logs: Path, capsys: Capture) -> None:
    words = ["identify", "mini-auv", "ahead.csv", "astern.csv"]
    assert main([*words, "--json", "whole.json", "--out", "whole.toml"]) == 0
    whole = capsys.readouterr().out
    assert main([*words, "--json", "parts.json", "--out", "parts.toml", "--stream"]) == 0
    assert capsys.readouterr().out.replace("parts.toml", "whole.toml") == whole
    assert (logs / "parts.toml").read_text() == (logs / "whole.toml").read_text()
    assert main([*words, "ahead.csv", "--stream"]) == 2
    assert "ahead.csv is given twice" in capsys.readouterr().err


def test_a_long_log_is_read_in_parts_where_that_can_be_done(
    logs: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    packed = logs / "ahead.csv.gz"
    packed.write_bytes(gzip.compress((logs / "ahead.csv").read_bytes()))
    (logs / "every.toml").write_text('schema = "undertow/mapping/1"\n[time]\ncolumn = "t"\nevery = 2\n')
    whole = ["identify", "mini-auv", packed.name]
    assert main([*whole, "--map", "every.toml"]) == 0
    thinned = capsys.readouterr().out
    read = []
    parts = LongLog.parts
    monkeypatch.setattr(LongLog, "parts", lambda log, *more: (read.append(log.path), parts(log, *more))[1])
    # Shorter than that as it is packed, longer as it is read.
    monkeypatch.setattr("undertow.cli.identification.identify._LONG", packed.stat().st_size)
    assert main(whole) == 0
    assert read == [Path(packed.name)] * 2
    capsys.readouterr()
    assert main([*whole, "--map", "every.toml"]) == 0
    assert capsys.readouterr().out == thinned
    assert main([*whole, "--map", "every.toml", "--stream"]) == 0
    assert capsys.readouterr().out == thinned


def test_mistakes_are_one_line(logs: Path, capsys: Capture) -> None:
    (logs / "still.csv").write_text("t,u,tau_X\n0,0,1\n0.2,0,1\n0.4,0,1\n")
    for words, said in (
        (["ahead.csv", "--cases", "12"], "'12' is not a case"),
        (["still.csv"], "holds no velocity of 'mini-auv' that changes"),
        (["missing.csv"], "missing.csv"),
        (["ahead.csv", "--cases", "8", "--out", "new.toml"], "no case of any motion is physical"),
    ):
        assert main(["identify", "mini-auv", *words]) == 2
        err = capsys.readouterr().err
        assert err.startswith("error: ")
        assert said in err
        assert len(err.splitlines()) == 1
    assert not (logs / "new.toml").exists()


def test_the_audit_prints_every_kind_of_remark(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["audit-tables"]) == 1
    out = capsys.readouterr().out
    for said in (
        "A6, cases 5 and 9: all 5 numbers",
        "A2, case 11, X_uabsu: -5.153776644 in the table, 5.153776 in Table 4",
        "17.7 standard deviations away",
        "case 6 has 0.006110739",
        "0.023659776, but Table 4 has 0.0240417",
        "t = 0.47",
        "A2: 11 of 11 cases as printed",
        "22 remarks on 6 tables",
    ):
        assert said in out
    assert main(["audit-tables", "--json"]) == 1
    assert len(json.loads(capsys.readouterr().out)) == 22
