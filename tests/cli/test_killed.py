"""Killed in the middle of writing: what stands there is the old or the new, and the next run works."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.quick import first_quick
from undertow.codegen.compiler import find_compiler

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes and signals of POSIX")

# One process has loaded everything; each run is a copy of it, which is cheap. A run is killed by a signal
# that nothing can catch: as soon as it asks the system for a change of a file, counted from its beginning, or
# after so many seconds.
DRIVER = """
import ctypes, json, os, shutil, signal, sys, tempfile
from contextlib import redirect_stdout
from undertow.cli.main import main
from undertow.codegen.compiler import library_for
from undertow.codegen.compiler import find_compiler
import casadi, numpy, polars, rich.table, scipy.linalg, scipy.optimize, scipy.stats, tomlkit
import undertow.cli.identification.add, undertow.cli.identification.fit
import undertow.codegen.library, undertow.identification.api
import undertow.identification.report.pictures, undertow.model.saving
with tempfile.TemporaryDirectory() as name, redirect_stdout(sys.stderr):  # what is loaded late is loaded now
    main(["export", "c", "box-hull", "--out", name])
    main(["export", "c", "box-hull", "--out", name, "--check"])

SOURCE = \"\"\"#include <math.h>
__attribute__((visibility("default"))) double answer(void) { return 42.0; }
\"\"\"

def build():
    "0 where a library was compiled, or found, that does what its source says."
    answer = ctypes.CDLL(str(library_for(SOURCE, find_compiler()))).answer
    answer.restype = ctypes.c_double
    return int(answer() != 42.0)

CHANGES = {"os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.link", "os.chmod", "os.utime", "os.truncate"}
CHANGES |= {"subprocess.Popen", "os.posix_spawn"}

def changes(event, args):
    if event == "open":
        named = isinstance(args[0], str) and not args[0].startswith("/dev/") and ".pyc" not in args[0]
        return named and args[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
    return event in CHANGES

def run(words, folder, own_cache, at=None, seconds=None):
    "Exit code (minus the signal) and number of changes of a run."
    reader, writer = os.pipe()
    child = os.fork()
    if child:
        os.close(writer)
        counted = os.read(reader, 100)
        os.close(reader)
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), int(counted or 0)
    os.close(reader)
    os.chdir(folder)
    if own_cache:
        os.environ["XDG_CACHE_HOME"] = os.path.join(folder, "cache")
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1), os.dup2(null, 2)
    number = 0
    def seen(event, args):
        nonlocal number
        if not changes(event, args):
            return
        number += 1
        if at is not None and number > at:
            os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(seen)
    if seconds is not None:
        signal.setitimer(signal.ITIMER_REAL, seconds)  # whose signal ends a process as SIGKILL does
    code = 99
    try:
        code = build() if words == ["build"] else main(words)
    finally:
        os.write(writer, str(number).encode())
        os._exit(code)

def texts(folder):
    found = {}
    for base, folders, files in os.walk(folder):
        folders[:] = [f for f in folders if f != "cache"]
        for name in files:
            with open(os.path.join(base, name), encoding="utf-8", errors="replace") as stream:
                found[os.path.relpath(os.path.join(base, name), folder)] = stream.read()
    return found

for line in sys.stdin:
    asked = json.loads(line)
    shutil.copytree(asked["base"], asked["folder"])
    where = asked["folder"], asked["own_cache"]
    code, count = run(asked["words"], *where, asked.get("at"), asked.get("seconds"))
    after = texts(asked["folder"])
    then = [run(words, *where)[0] for words in asked["then"]]
    last = texts(asked["folder"])
    print(json.dumps({"code": code, "count": count, "after": after, "then": then, "last": last}), flush=True)
"""


class Killed(NamedTuple):
    """What a run left behind, and what the runs after it did."""

    code: int
    count: int
    after: dict[str, str]
    then: list[int]
    last: dict[str, str]


class Driver:
    """Runs of commands in copies of a folder."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self._process, self._folder, self._runs = process, folder, 0

    def run(
        self, base: Path, words: str, then: list[str] | None = None, own_cache: bool = False, **moment: float
    ) -> Killed:
        """One run that is killed at a moment, if one is given, and those after it."""
        self._runs += 1
        asked: dict[str, Any] = {"base": str(base), "folder": str(self._folder / f"{self._runs}"), **moment}
        asked |= {
            "words": words.split(),
            "then": [line.split() for line in then or []],
            "own_cache": own_cache,
        }
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        print(json.dumps(asked), file=self._process.stdin, flush=True)
        return Killed(**json.loads(self._process.stdout.readline()))


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory):
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "src"), "OMP_NUM_THREADS": "1"}
    environment["XDG_CACHE_HOME"] = str(tmp_path_factory.mktemp("cache"))
    with subprocess.Popen(
        [sys.executable, "-c", DRIVER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
        text=True,
    ) as process:
        yield Driver(process, tmp_path_factory.mktemp("killed"))
        assert process.stdin is not None
        process.stdin.close()


KILLED = -signal.SIGKILL


def moments(count: int, most: int, seed: int) -> list[int]:
    """Changes of files before which a run is killed: all, or that many of them."""
    return sorted(random.Random(seed).sample(range(count), min(count, most)))


def half_written(found: dict[str, str], *sound: dict[str, str]) -> list[str]:
    """Files that are neither what they were nor what they are to be; leftovers under names of their own."""
    return [
        name
        for name, text in found.items()
        if not Path(name).name.startswith(".undertow-") and text not in [known.get(name) for known in sound]
    ]


@pytest.fixture
def older(case: Path, driver: Driver) -> Path:
    """A folder with the code of a vehicle, whose file has been edited since."""
    done = driver.run(case, "export c usv.toml --out out")
    for name in done.after.keys() - {"usv.toml", "train.csv", "holdout.csv"}:
        (case / name).parent.mkdir(parents=True, exist_ok=True)
        (case / name).write_text(done.after[name])
    text = (case / "usv.toml").read_text()
    assert "I_z = 1.76" in text
    (case / "usv.toml").write_text(text.replace("I_z = 1.76", "I_z = 1.9"))
    return case


def before(folder: Path) -> dict[str, str]:
    """Texts of a folder."""
    return {str(p.relative_to(folder)): p.read_text() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("most", first_quick([3, 8]))
def test_the_code_of_a_vehicle_is_old_or_new_file_by_file(older: Path, driver: Driver, most: int) -> None:
    words, check = "export c usv.toml --out out", "export c usv.toml --out out --check"
    whole, old = driver.run(older, words), before(older)
    assert whole.code == 0
    assert whole.after["out/usv/src/usv_vehicle.c"] != old["out/usv/src/usv_vehicle.c"]
    for at in moments(whole.count, most, seed=1):
        killed = driver.run(older, words, [check, words], at=at)
        assert killed.code == KILLED, at
        assert not half_written(killed.after, old, whole.after), at
        current = all(killed.after[n] == text for n, text in whole.after.items())
        assert killed.then == [0 if current else 1, 0], at  # --check knows
        assert not half_written(killed.last, whole.last), at
        assert whole.last.keys() <= killed.last.keys()


@pytest.mark.slow
def test_a_fitted_vehicle_is_old_or_new(case: Path, driver: Driver) -> None:
    words = "fit usv.toml train.csv --in-place"
    whole, old = driver.run(case, words), before(case)
    assert whole.code == 0
    assert whole.after["usv.toml"] != old["usv.toml"]
    for at in moments(whole.count, 3, seed=2):
        killed = driver.run(case, words, [words], at=at)
        assert killed.code == KILLED, at
        assert not half_written(killed.after, old, whole.after), at
        assert killed.then == [0], at


@pytest.mark.parametrize(("most", "while_compiling"), first_quick([(2, 1), (1000, 4)]))
def test_compiled_code_is_whole_or_built_again(
    most: int, while_compiling: int, driver: Driver, tmp_path: Path
) -> None:
    """Killed before any change of the cache, or while the compiler runs."""
    if find_compiler() is None:
        pytest.skip("no C compiler on this machine")
    whole = driver.run(tmp_path, "build", ["build"], own_cache=True)
    assert (whole.code, whole.then) == (0, [0])
    for at in moments(whole.count, most, seed=4):
        killed = driver.run(tmp_path, "build", ["build", "build"], own_cache=True, at=at)
        assert (killed.code, killed.then) == (KILLED, [0, 0]), at
    clock = random.Random(3)
    for _ in range(while_compiling):
        killed = driver.run(tmp_path, "build", ["build"], own_cache=True, seconds=clock.uniform(0.002, 0.08))
        assert killed.code in (0, -signal.SIGALRM)
        assert killed.then == [0]
