"""What the tests of bad input share: a small case, and running a command that must refuse."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from undertow.cli.main import commands, main

Columns = dict[str, np.ndarray]
Refused = Callable[..., str]
Undertow = Callable[..., tuple[int, str, str]]

LOG_COMMANDS = [name for name in ("compare", "diagnose", "add", "fit") if name in commands()]
VEHICLE_COMMANDS = [*LOG_COMMANDS, "export"]


def each_once(commands: Sequence[str], faults: Iterable[str]) -> list[tuple[str, str]]:
    """Every fault with the first command (or place), the first fault with the others: the code is shared."""
    known = list(faults)
    return [(commands[0], fault) for fault in known] + [(command, known[0]) for command in commands[1:]]


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


# --- a hull that only surges: a diagnosis of it takes a second ------------------------------------
SURGE = """\
schema = "undertow/vehicle/1"
name = "hull"
degrees_of_freedom = ["surge"]
signs = "sname"
generalised_forces = ["tau_X"]
[effects.rigid_body]
m = 100
[effects.linear_damping]
X_u = { value = -25, estimate = true }
"""


def surge_log(samples: int) -> pl.DataFrame:
    """First-order answer to a force that steps fifty times a log or every 10 s, at 50 Hz."""
    t, rng = np.arange(samples) * 0.02, np.random.default_rng(0)
    each = min(samples // 50, 500)
    force = np.repeat(rng.uniform(-50, 50, samples // each), each)
    a, speed, u = np.exp(-0.02 * 25 / 100), 0.0, np.empty(samples)
    for i, push in enumerate((force / 25).tolist()):
        u[i] = speed
        speed = push + a * (speed - push)
    return pl.DataFrame({"t": t, "u": u + 0.005 * rng.standard_normal(samples), "tau_X": force})
