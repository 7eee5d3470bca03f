"""A short case for the tests of commands: a surface vehicle with a current that its model lacks."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from benchmarks.hidden_effects import Case, make_case
from benchmarks.hidden_effects.files import toml_text
from benchmarks.shape.hulls import box_mesh, spheroid_mesh, stl
from tests.cli.bad import SURGE, Undertow, contents, surge_log, text_of
from undertow.cli.main import main
from undertow.model.loading import bundled_vehicles


@pytest.fixture(scope="session")
def simulated() -> Case:
    """Two runs of 20 s at 20 Hz."""
    return make_case("usv", ("ocean_current",), 1, duration=20.0, runs=("multisine", "holdout"))


@pytest.fixture(scope="session")
def _texts(simulated: Case) -> dict[str, str]:
    return {
        "train.csv": text_of(simulated.runs["multisine"]),
        "holdout.csv": text_of(simulated.runs["holdout"]),
        "usv.toml": toml_text(simulated.vehicle),
    }


@pytest.fixture
def case(_texts: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder, the current one, with train.csv, holdout.csv and usv.toml."""
    for name, text in _texts.items():
        (tmp_path / name).write_text(text)
    monkeypatch.chdir(tmp_path)
    assert len(contents(tmp_path)) == len(_texts)
    return tmp_path


@pytest.fixture
def quick(case: Path) -> Path:
    """The folder `case` with a hull that only surges: a diagnosis takes a second."""
    (case / "usv.toml").write_text(SURGE)
    surge_log(1500).write_csv(case / "train.csv")
    return case


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, the current one, on a wide terminal."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


@pytest.fixture
def undertow(here: Path, capsys: pytest.CaptureFixture[str]) -> Undertow:
    """Run a command in the folder `here`; return its exit code and what it wrote to stdout and stderr."""

    def run(*words: object) -> tuple[int, str, str]:
        code = main([str(w) for w in words])
        out, err = capsys.readouterr()
        return code, out, err

    return run


@pytest.fixture
def folder(here: Path) -> Path:
    """The folder `here` with auv.toml, a copy of the mini-AUV."""
    (here / "auv.toml").write_text(bundled_vehicles()["mini-auv"].read_text())
    return here


@pytest.fixture
def hulls(here: Path) -> Path:
    """The folder `here` with box.stl in mm and spheroid.stl in m, both about the origin."""
    stl(box_mesh(), here / "box.stl", 1000.0)
    stl(spheroid_mesh(1.2, 0.4, 3), here / "spheroid.stl")
    return here


@pytest.fixture
def no_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if undertow[bem] were not installed."""
    monkeypatch.setitem(sys.modules, "capytaine", None)
    monkeypatch.setattr("undertow.shape.mesh.find_spec", lambda name: None)
