"""What benchmarks/size.py counts."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.size import SMALL, code_lines, measure

pytestmark = pytest.mark.docs

PYTHON = '''"""Of two
lines."""

import math  # with a remark

# alone


def area(
    radius: float,
) -> float:
    """What it is."""
    return math.pi * radius**2
'''


def test_comments_docstrings_and_blank_lines_are_no_code() -> None:
    assert code_lines(PYTHON) == 5


def test_a_package_is_measured(tmp_path: Path) -> None:
    package = tmp_path / "undertow"
    commands, laws = package / "cli" / "identification", package / "cli" / "control"
    commands.mkdir(parents=True)
    laws.mkdir()
    (package / "model" / "effects").mkdir(parents=True)
    for folder in (
        package,
        package / "cli",
        commands,
        laws,
        package / "model",
        package / "model" / "effects",
    ):
        (folder / "__init__.py").write_text("")
    (package / "model" / "effects" / "lift.py").write_text("A = 1\n")
    (package / "model" / "vehicle.py").write_text("from .effects import lift\n" * (SMALL + 1))
    (laws / "gains.py").write_text(PYTHON)
    (commands / "diagnose.py").write_text(
        "def late():\n    from undertow.model import vehicle\n    from undertow.cli.control import gains\n"
    )
    logs, diagnosis = (package / "identification" / name for name in ("logs", "diagnosis"))
    for folder in (logs, diagnosis, package / "control" / "conditions"):
        folder.mkdir(parents=True)
        (folder.parent / "__init__.py").write_text("")
        (folder / "__init__.py").write_text("")
    (logs / "reading.py").write_text("")
    (diagnosis / "verdict.py").write_text("from undertow.model import vehicle\n")
    (package / "control" / "conditions" / "check.py").write_text("from undertow.model import vehicle\n")
    (package / "loop.c").write_text("/* two\n   lines */\n\nint answer; // here\n// alone\n")
    found = measure(tmp_path)
    assert found["lines, C included"] == 1 + (SMALL + 1) + len(PYTHON.splitlines()) + 3 + 1 + 1 + 5
    assert found["lines of code"] == 1 + (SMALL + 1) + 5 + 3 + 1 + 1 + 1
    assert found["modules"] == 18
    assert found["the same without effects and __init__"] == 5
    # reading, verdict, vehicle; the effect does not count.
    assert found["modules from a log column to its verdict"] == 3
    # diagnose, vehicle, gains
    assert found["modules from a log column to all that `diagnose` prints"] == 3
    assert found["modules from a gain to its conditions"] == 2
    assert found["modules from a gain to all that `gains` prints"] == 1


def test_a_log_column_and_a_gain_pass_no_more_modules_than_the_architecture_says() -> None:
    found = measure(Path(__file__).parents[1] / "src")
    assert found["modules from a log column to its verdict"] <= 60
    assert found["modules from a gain to its conditions"] <= 30
