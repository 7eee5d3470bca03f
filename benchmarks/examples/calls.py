"""Calls of undertow, run as a user would and shown as a user would type them."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from undertow.errors import UndertowError

ROOT = Path(__file__).parents[2]
#: Stands for the folder of the logs, in commands and on the pages.
DATA = "$DATA"
Told = dict[str, Any]


@dataclass(frozen=True)
class Judged:
    """What is asked of a diagnosis: a vehicle, logs to identify on and logs to judge by.

    Attributes
    ----------
    title : str
        What the page calls it.
    vehicle : str
        Vehicle file from the root of the repository, or bundled vehicle.
    mapping : str
        Mapping file from the root of the repository.
    logs, holdout : tuple of str
        File names in the data folder; without a holdout, stretches of the logs are kept aside.
    window : (from, to)
        Part of every log that is used, s.
    effects : tuple of str
        Files with effects of one's own.
    """

    title: str
    vehicle: str
    mapping: str
    logs: tuple[str, ...]
    holdout: tuple[str, ...] = ()
    window: tuple[float | None, float | None] = (None, None)
    effects: tuple[str, ...] = ()

    def words(self, command: str, *first: str) -> list[str]:
        """The command line behind `undertow`."""
        held = ["--holdout", *(f"{DATA}/{name}" for name in self.holdout)] if self.holdout else []
        logs = [f"{DATA}/{name}" for name in self.logs]
        return [command, *first, self.vehicle, *logs, *held, *self.options()]

    def options(self) -> list[str]:
        """Mapping, window and effects."""
        since, until = self.window
        found = ["--map", self.mapping]
        found += [] if since is None else ["--from", f"{since:g}"]
        found += [] if until is None else ["--to", f"{until:g}"]
        return found + [word for file in self.effects for word in ("--effects", file)]


@dataclass
class Caller:
    """Runs undertow from the root of the repository.

    Attributes
    ----------
    data : Path
        Folder of the logs.
    scratch : Path
        Folder for what is written on the way.
    tell : callable
        Told every command before it runs.
    """

    data: Path
    scratch: Path
    tell: Callable[[str], None] = lambda words: None
    _count: int = field(default=0, init=False)

    def compare(self, what: Judged) -> Told:
        """Compare a vehicle with the logs of `what`, and return the result."""
        words, out = what.words("compare"), self._next("json")
        seconds = self._run([*words, "--json", str(out)])
        return {"command": shown(words), "wall": seconds, **json.loads(out.read_text(encoding="utf-8"))}

    def diagnose(self, what: Judged) -> tuple[Told, Path]:
        """Diagnose, and return what is said and the vehicle file that results."""
        words = what.words("diagnose")
        name = hashlib.sha256(" ".join([str(self.data), *words]).encode()).hexdigest()[:16]
        out, better = (self.scratch / f"{name}.{ending}" for ending in ("json", "toml"))
        began = time.perf_counter()
        if not (out.exists() and better.exists()):  # a long run that broke off goes on where it was
            self._run([*words, "--json", str(out), "--apply", str(better)])
        seconds = time.perf_counter() - began
        told = json.loads(out.read_text(encoding="utf-8"))
        line = shown(words).replace(f"{self.scratch}/", "")
        return {"command": line, "title": what.title, "wall": seconds, **told}, better

    def add(self, effect: str, what: Judged) -> tuple[Told, Path]:
        """Add an effect by hand whatever it does, and return how the error changed, and the vehicle file."""
        words, better = what.words("add", effect), self._next("toml")
        seconds = self._run([*words, "--no-codegen", "--force", "--out", str(better)])
        history = tomllib.loads(better.read_text(encoding="utf-8"))["history"][-1]
        kept = {k: history[k] for k in ("added", "helps", "error_before", "error_after")}
        return {"command": shown([*words, "--out", "better.toml"]), "wall": seconds, **kept}, better

    def fit(self, what: Judged, horizon: float | None = None) -> Path:
        """Fit a vehicle, by output error over a horizon (s) or by the weak form, and return the file."""
        out = self._next("toml")
        how = [] if horizon is None else ["--method", "output-error", "--horizon", f"{horizon:g}"]
        self._run([*what.words("fit"), *how, "--out", str(out)])
        return out

    def _next(self, ending: str) -> Path:
        self._count += 1
        return self.scratch / f"{self._count:03d}.{ending}"

    def _run(self, words: Sequence[str]) -> float:
        self.tell(shown(words))
        began = time.perf_counter()
        line = [sys.executable, "-m", "undertow", *(w.replace(DATA, str(self.data)) for w in words)]
        done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            why = done.stderr.strip().splitlines()[-1:] or done.stdout.strip().splitlines()[-1:]
            raise UndertowError(f"{shown(words)}: exit code {done.returncode}: {' '.join(why)}")
        return time.perf_counter() - began


def shown(words: Sequence[str]) -> str:
    """A command as it is typed."""
    return " ".join(["undertow", *words])
