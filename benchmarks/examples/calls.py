"""Calls of undertow, run as a user would and shown as a user would type them."""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from undertow.errors import UndertowError

ROOT = Path(__file__).parents[2]
#: Stands for the folder of the logs, in commands and on the pages.
DATA = "$DATA"
Reported = dict[str, Any]


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
        File names in the data folder; without a holdout, stretches of the logs are for validation.
    window : (from, to)
        Part of every log that is used, s.
    """

    title: str
    vehicle: str
    mapping: str
    logs: tuple[str, ...]
    holdout: tuple[str, ...] = ()
    window: tuple[float | None, float | None] = (None, None)

    def words(self, command: str, *first: str) -> list[str]:
        """The command line behind `undertow`."""
        held = ["--validation", *(f"{DATA}/{name}" for name in self.holdout)] if self.holdout else []
        logs = [f"{DATA}/{name}" for name in self.logs]
        return [command, *first, self.vehicle, *logs, *held, *self.options()]

    def options(self) -> list[str]:
        """Mapping and window."""
        since, until = self.window
        found = ["--map", self.mapping]
        found += [] if since is None else ["--from", f"{since:g}"]
        found += [] if until is None else ["--to", f"{until:g}"]
        return found


@dataclass
class Caller:
    """Runs undertow from the root of the repository.

    Attributes
    ----------
    data : Path
        Folder of the logs.
    scratch : Path
        Folder for what is written on the way.
    report : callable
        Given every command before it runs.
    """

    data: Path
    scratch: Path
    report: Callable[[str], None] = lambda words: None

    def compare(self, what: Judged) -> Reported:
        """Compare a vehicle with the logs of `what`, and return the result."""
        (out,) = self._once(what.words("compare"), {"--json": "json"})
        return {
            "command": self._plain(shown(what.words("compare"))),
            **json.loads(out.read_text(encoding="utf-8")),
        }

    def diagnose(self, what: Judged) -> tuple[Reported, Path]:
        """Diagnose, and return the answer, with what was run and what to run next, and the vehicle file."""
        words = what.words("diagnose")
        out, better = self._once(words, {"--json": "json", "--apply": "toml"})
        reported = json.loads(out.read_text(encoding="utf-8"))
        advice = self._plain(reported["command"].replace(str(out), "diagnosis.json"))
        return {**reported, "command": self._plain(shown(words)), "next": advice, "title": what.title}, better

    def add(self, effect: str, what: Judged) -> tuple[Reported, Path]:
        """Add an effect by hand whatever it does, and return how the error changed, and the vehicle file."""
        words = what.words("add", effect)
        (better,) = self._once([*words, "--no-codegen", "--force"], {"--out": "toml"})
        history = tomllib.loads(better.read_text(encoding="utf-8"))["history"][-1]
        kept = {k: history[k] for k in ("added", "helps", "error_before", "error_after")}
        return {"command": self._plain(shown([*words, "--out", "better.toml"])), **kept}, better

    def fit(self, what: Judged, horizon: float | None = None) -> Path:
        """Fit a vehicle by output error over a horizon (s), or by the default; the file, whatever it does."""
        how = [] if horizon is None else ["--method", "output-error", "--horizon", f"{horizon:g}"]
        (out,) = self._once([*what.words("fit"), *how, "--force"], {"--out": "toml"})
        return out

    def _once(self, words: Sequence[str], outputs: Mapping[str, str]) -> list[Path]:
        """Run a command, unless what it writes is there already: a long run that broke off goes on."""
        written = [Path(w).read_text(encoding="utf-8") for w in words if w.startswith(str(self.scratch))]
        key = hashlib.sha256("\n".join([str(self.data), *words, *written]).encode()).hexdigest()[:16]
        paths = [self.scratch / f"{key}.{ending}" for ending in outputs.values()]
        if not all(path.exists() for path in paths):
            places = [w for option, path in zip(outputs, paths, strict=True) for w in (option, str(path))]
            self._run([*words, *places])
        return paths

    def _plain(self, line: str) -> str:
        """A command without the paths of this machine."""
        return line.replace(f"{self.scratch}/", "").replace(str(self.data), DATA)

    def _run(self, words: Sequence[str]) -> None:
        self.report(shown(words))
        line = [sys.executable, "-m", "undertow", *(w.replace(DATA, str(self.data)) for w in words)]
        done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            why = done.stderr.strip().splitlines()[-1:] or done.stdout.strip().splitlines()[-1:]
            raise UndertowError(f"{shown(words)}: exit code {done.returncode}: {' '.join(why)}")


def shown(words: Sequence[str]) -> str:
    """A command as it is typed."""
    return " ".join(["undertow", *words])
