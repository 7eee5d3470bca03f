"""A short case for the tests of commands: a surface vehicle with a current that its model lacks."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.hidden_effects import Case, make_case
from benchmarks.hidden_effects.files import toml_text
from tests.cli.bad import contents, text_of


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
