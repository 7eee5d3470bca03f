"""Commands of undertow as a user types them, and what they said, for pages that show them."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).parents[1]
WIDTH = 108
NOISE = {**dict.fromkeys("xyz", 0.01), **dict.fromkeys(("psi", "u", "v", "w", "r"), 0.005)}
"""Standard deviations of the sensors of a flight, m, rad, m/s and rad/s."""


def in_page(page: str, made: str, begin: str, end: str) -> str:
    """A page with what a program made between two marks, in place of what stood there."""
    before, rest = page.split(begin)
    return f"{before}{begin}{made}{end}{rest.split(end)[1]}"


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

    def fly(self, flights: Mapping[str, str]) -> list[Said]:
        """Log the true vehicle on its way to the set-point of each flight, with noise in every sensor."""
        noise = [word for name, size in NOISE.items() for word in ("--noise", f"{name}={size}")]
        said = []
        for seed, (name, to) in enumerate(flights.items(), start=1):
            words = ["simulate", "truth.toml", "survey.toml", f"--to={to}", "--for", "40", "--dt", "0.02"]
            files = ["--seed", str(seed), "--log", "0.1", "--out", f"{name}.csv"]
            said.append(self.undertow(*words, *noise, *files))
        return said


def aloud(words: str) -> None:
    """Say on stderr what is being done."""
    print(words, file=sys.stderr, flush=True)


@contextmanager
def folders(program: str, about: str | None, arguments: Sequence[str] | None) -> Iterator[tuple[Path, Path]]:
    """Command line of a program that makes a page: where its commands run, and where the page goes."""
    parser = argparse.ArgumentParser(prog=f"python -m {program}", description=about)
    parser.add_argument("--out", type=Path, default=Path("docs"), help="default: %(default)s")
    parser.add_argument("--keep", type=Path, help="folder for the files of the way, which are kept")
    options = parser.parse_args(arguments)
    with TemporaryDirectory() as passing:
        work = options.keep or Path(passing)
        for folder in (work, options.out / "images"):
            folder.mkdir(parents=True, exist_ok=True)
        yield work, options.out


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
