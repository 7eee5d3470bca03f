"""What the tests of bad input share: a small case, and running a command that must refuse."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest

from undertow.cli.main import commands, main

Columns = dict[str, np.ndarray]
Refused = Callable[..., str]

LOG_COMMANDS = [name for name in ("compare", "diagnose", "add", "fit") if name in commands()]
VEHICLE_COMMANDS = [*LOG_COMMANDS, "codegen"]


def text_of(columns: Columns) -> str:
    """Columns as CSV; NaN is an empty cell."""
    rows = zip(*(column.tolist() for column in columns.values()), strict=True)
    lines = [",".join("" if value != value else repr(value) for value in row) for row in rows]
    return "\n".join([",".join(columns), *lines]) + "\n"


def contents(*folders: Path) -> dict[str, bytes]:
    """Every file in folders, hidden ones too, and every folder."""
    paths = [path for folder in folders for path in folder.rglob("*")]
    return {str(path): path.read_bytes() if path.is_file() else b"" for path in paths}


def refusal(
    words: Sequence[object], capsys: pytest.CaptureFixture[str], *folders: Path, code: int = 2
) -> str:
    """Run a command that must end in one line on stderr, and change nothing in folders; return the line."""
    before = contents(*folders)
    capsys.readouterr()
    got = main([str(word) for word in words])
    err = capsys.readouterr().err
    assert got == code, err
    assert contents(*folders) == before
    (line,) = err.splitlines()
    assert line == "interrupted" if code == 130 else line.startswith("error: ")
    assert line.isprintable()
    return line
