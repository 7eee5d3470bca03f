"""`undertow fleet` on the command line: reports, going on, partial answers, mistakes in the input."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from scipy.io import savemat

from benchmarks.fleet.made import log
from undertow.cli.main import main
from undertow.fleet import rollouts as predicted
from undertow.fleet.partitions import partition_of
from undertow.fleet.reduction import Job, reduce_log, with_fingerprint
from undertow.identification.logs.mapping import LogMapping
from undertow.model.symbols import FASTEST

Capture = pytest.CaptureFixture[str]
DIAGNOSE = ["fleet", "diagnose", "craft.toml", "logs/**/*.parquet", "--workers", "0", "--out", "report"]


@pytest.fixture
def small(fleet: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four days of bravo, the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    shutil.copy(fleet / "craft.toml", tmp_path)
    for source in sorted((fleet / "logs" / "vehicle=bravo").iterdir())[:4]:
        shutil.copytree(source, tmp_path / "logs" / "vehicle=bravo" / source.name)
    return tmp_path


def report() -> dict[str, object]:
    return json.loads(Path("report/report.json").read_text())


def test_a_second_run_does_what_is_missing_only(small: Path, capsys: Capture) -> None:
    assert main(DIAGNOSE) == 0
    out, first = capsys.readouterr().out, report()
    assert "4 of 4 files were used (4 computed now, 0 reused)" in out
    assert "X_uabsu" in out
    assert "cannot tell: 3 days before and 1 in this month, at least 3 are needed" in out
    days = sorted((small / "logs/vehicle=bravo").iterdir())
    days[0].rename(small / "logs/vehicle=bravo/day=2026-01-31")  # moved, but the same log
    table = pl.read_parquet(days[3] / "part.parquet")
    table.head(400).write_parquet(days[3] / "part.parquet")  # changed
    assert main(DIAGNOSE) == 0
    assert "4 of 4 files were used (1 computed now, 3 reused)" in capsys.readouterr().out
    assert report() != first
    assert "## bravo" in Path("report/report.md").read_text()


def test_what_cannot_be_used_is_named_and_the_rest_counts(small: Path, capsys: Capture) -> None:
    days = sorted((small / "logs/vehicle=bravo").iterdir())
    (days[0] / "part.parquet").write_bytes(b"PAR1 cut off")
    pl.read_parquet(days[1] / "part.parquet").drop("port").write_parquet(days[1] / "part.parquet")
    (days[2] / "copy.parquet").write_bytes((days[3] / "part.parquet").read_bytes())
    assert main(DIAGNOSE) == 1
    out, found = capsys.readouterr().out, report()
    assert "2 of 5 files were used" in out
    assert "'port'" in out
    assert [Path(p).parent.name for p in found["failed"]] == [days[0].name, days[1].name]
    assert len(found["twins"]) == 1
    assert str(days[0]) in Path("report/report.md").read_text()


def test_own_logs_of_vehicles_count_as_tables_do(small: Path) -> None:
    """A day as a .mat file, of which the path says the vehicle and the day."""
    day = min((small / "logs/vehicle=bravo").iterdir())
    table = pl.read_parquet(day / "part.parquet")
    own = small / "own" / "bravo" / f"{day.name.removeprefix('day=')}.mat"
    own.parent.mkdir(parents=True)
    savemat(own, {name: table[name].to_numpy() for name in table.columns if table[name].dtype.is_numeric()})
    job = with_fingerprint(Job("craft.toml"))[0]
    assert partition_of(own, LogMapping()).day == partition_of(day / "part.parquet", LogMapping()).day
    first, second = (reduce_log(job, str(path)) for path in (day / "part.parquet", own))
    assert second.samples == first.samples
    grams = (one.factor.T @ one.factor for one in (first, second))
    np.testing.assert_allclose(*grams, rtol=1e-9)
    words = ["fleet", "diagnose", "craft.toml", str(own), "--workers", "0", "--out", "report"]
    assert main(words) == 0
    assert report()["vehicles"][0]["vehicle"] == "bravo"


@pytest.mark.slow
def test_each_vehicle_may_have_a_file_of_its_own(small: Path, capsys: Capture) -> None:
    (small / "own").mkdir()
    shutil.copy("craft.toml", "own/bravo.toml")
    words = ["fleet", "diagnose", "own/{vehicle}.toml", "logs", "--workers", "0", "--passes", "2"]
    assert main(words) == 0
    assert Path("fleet-results/report.md").exists()
    assert "4 of 4 files were used (4 computed now, 0 reused)" in capsys.readouterr().out
    (small / "own/bravo.toml").unlink()
    assert main(words) == 2
    assert "neither a file nor a bundled vehicle" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["craft.toml", "nothing/*.parquet"], "no file matches 'nothing/*.parquet'"),
        (["craft.tom", "logs"], "'craft.tom' is neither a file nor a bundled vehicle"),
        (["craft.toml", "craft.toml"], "neither a Parquet file nor a vehicle log"),
        (["mini-auv", "logs"], "none of 4 files could be used"),
        (["craft.toml", "logs", "--daily", "lag"], "'lag' is not an effect"),
        (["craft.toml", "logs", "--out", "craft.toml"], "is not a folder"),
        (["craft.toml", "logs", "--map", "none.toml"], "none.toml"),
        (["{vehicle}.toml", "outside"], "'../craft' is not a valid file name"),
    ],
)
def test_mistakes_are_reported_in_one_line(
    small: Path, capsys: Capture, words: list[str], complaint: str
) -> None:
    outside = Path("outside/vehicle=..%2Fcraft/2026-02-03.parquet")
    outside.parent.mkdir(parents=True)
    shutil.copy(next(Path("logs").rglob("*.parquet")), outside)
    assert main(["fleet", "diagnose", *words, "--workers", "0"]) == 2
    error = capsys.readouterr().err
    assert complaint in error
    assert error.count("\n") == 1


@pytest.mark.slow
def test_what_is_no_address_leaves_one_line() -> None:
    """Also when the process ends and throws away what is left of Dask."""
    pytest.importorskip("distributed", reason="Dask is not installed: pip install undertow[fleet]")
    command = [sys.executable, "-m", "undertow", "fleet", "diagnose", "mini-auv", "logs"]
    done = subprocess.run(
        [*command, "--scheduler", "nonsense"],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "missing port number in address 'nonsense'" in done.stderr
    assert done.stderr.count("\n") == 1


def test_without_dask_it_says_what_to_install(
    small: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setattr("undertow.fleet.engine.find_spec", lambda name: None)
    assert main(["fleet", "diagnose", "craft.toml", "logs"]) == 2
    assert 'pip install "undertow[fleet]"' in capsys.readouterr().err


def test_rollouts_that_diverge_are_counted_and_end_with_one(
    small: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two of sixty leave what a vehicle in water can do, with finite numbers."""
    pl.DataFrame(log(small / "craft.toml", {}, np.random.default_rng(1), current=0.0)).write_parquet(
        "s.parquet"
    )
    rolled = predicted._paths  # where the trajectories come from: some of them are sent off

    def off(*args: object) -> np.ndarray:
        paths = rolled(*args)
        paths[:2, -1, -1] = 2 * FASTEST
        return paths

    monkeypatch.setattr(predicted, "_paths", off)
    words = ["fleet", "rollouts", "craft.toml", "s.parquet", "--workers", "0", "--count", "60"]
    assert main([*words, "--horizon", "50"]) == 1
    assert "2 of 60 rollouts diverged and are left out" in capsys.readouterr().out


def test_bands_of_rollouts_hold_what_was_measured(small: Path, capsys: Capture) -> None:
    still = log(small / "craft.toml", {}, np.random.default_rng(1), current=0.0)
    pl.DataFrame(still).write_parquet("still.parquet")
    words = [
        "fleet",
        "rollouts",
        "craft.toml",
        "still.parquet",
        "--workers",
        "0",
        "--count",
        "60",
        "--horizon",
        "5",
    ]
    assert main([*words, "--out", "bands.parquet"]) == 0
    assert "stated standard deviations of 7 parameters" in capsys.readouterr().out
    bands = pl.read_parquet("bands.parquet")
    assert bands["window"].unique().len() == 10
    for name in ("u", "psi", "x"):
        inside = bands.select(pl.col(f"{name}_measured").is_between(f"{name}_low", f"{name}_high").mean())
        assert inside.item() > 0.85
        assert bands.select((pl.col(f"{name}_low") < pl.col(f"{name}_median")).all()).item()
    assert main(["fleet", "rollouts", "craft.toml", "none.csv", "--workers", "0"]) == 2
    assert "none.csv does not exist" in capsys.readouterr().err
    words[2] = "mini-auv-known.toml"
    known = re.sub(r", sigma = [0-9.]+", "", Path("craft.toml").read_text())
    Path("mini-auv-known.toml").write_text(known)
    assert main(words) == 2
    assert "has a standard deviation" in capsys.readouterr().err
