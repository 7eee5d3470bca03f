"""Commands of undertow as a user types them, and what they said, for pages that show them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
WIDTH = 108


@dataclass(frozen=True)
class Said:
    """A command and its answer.

    Attributes
    ----------
    words : list of str
        The command without `undertow`.
    code : int
        Its exit code.
    text : str
        What it printed.
    """

    words: list[str]
    code: int
    text: str


class Shell:
    """Runs undertow in a folder.

    Parameters
    ----------
    folder : Path
        Where files are written.
    tell : callable
        Is told what is being done.
    """

    def __init__(self, folder: Path, tell: Callable[[str], None] = lambda words: None) -> None:
        self.folder, self._tell = folder, tell

    def undertow(self, *words: str, expect: int = 0) -> Said:
        """Run a command, which has to end with a certain code."""
        self._tell(" ".join(("undertow", *words)))
        path = os.pathsep.join([str(ROOT / "src"), os.environ.get("PYTHONPATH", "")])
        done = subprocess.run(
            [sys.executable, "-m", "undertow", *words],
            cwd=self.folder,
            env={**os.environ, "COLUMNS": str(WIDTH), "PYTHONPATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode != expect:
            raise RuntimeError(f"undertow {' '.join(words)} ended with {done.returncode}: {done.stderr}")
        lines = [line.rstrip() for line in done.stdout.strip("\n").splitlines()]
        return Said(list(words), done.returncode, "\n".join(lines))


def block(said: Said, most: int = 80) -> str:
    """A command and the first lines of its answer; below zero the first and the last ones."""
    lines = said.text.splitlines()
    shown = [*lines[:most], *(["..."] if len(lines) > most else [])]
    if most < 0:
        shown = [lines[0], "...", *lines[most:]]
    status = f" (exit code {said.code})" if said.code else ""
    return code("\n".join([f"$ undertow {' '.join(said.words)}{status}", *shown]))


def code(text: str) -> str:
    """Text in a block of code."""
    return f"```\n{text.rstrip()}\n```\n"
