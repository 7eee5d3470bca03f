"""Which compiled code is trusted, and what happens without a compiler."""

# Private names of `compiler`: what they remember in a process is forgotten, as in a new one.

from __future__ import annotations

import json
import logging
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.codegen.support import functions_of
from undertow import UndertowError
from undertow.codegen import Simulator, compiler
from undertow.codegen.compiler import Compiler, cache_folder, find_compiler, library_for
from undertow.codegen.engine import rollout_source

SOURCE = "double undertow_test_answer(void);\ndouble undertow_test_answer(void) { return 42; }\n"
SEEN = SOURCE.replace("double", '__attribute__((visibility("default"))) double', 1)
posix = pytest.mark.skipif(sys.platform == "win32", reason="permission bits of POSIX")


class Counted(Compiler):
    """A compiler that counts how often it is called."""

    calls = 0

    def build(self, source: Path, library: Path) -> None:
        type(self).calls += 1
        super().build(source, library)


@pytest.fixture
def counted(c_compiler: Compiler, own_cache: Path) -> Counted:
    Counted.calls = 0
    return Counted(c_compiler.command, c_compiler.version)


def _manifest() -> Path:
    return next(cache_folder().glob("*.json"))


# --- trust --------------------------------------------------------------------------------------


def test_a_library_is_compiled_once(counted: Counted) -> None:
    first = library_for(SOURCE, counted)
    assert library_for(SOURCE, counted) == first
    assert counted.calls == 1
    assert not list(cache_folder().glob("build-*"))


def test_another_source_or_compiler_has_its_own_library(counted: Counted) -> None:
    first = library_for(SOURCE, counted)
    assert library_for(SOURCE.replace("42", "43"), counted) != first
    library_for(SOURCE, replace(counted, version="another version"))
    assert counted.calls == 3


def _append_to_library(library: Path) -> None:
    library.write_bytes(library.read_bytes() + b"x")


def _truncate_library(library: Path) -> None:
    library.write_bytes(b"")


def _remove_library(library: Path) -> None:
    library.unlink()


def _library_of_another_source(library: Path) -> None:
    """A library and a manifest that fit each other, but were made from something else."""
    _append_to_library(library)
    found = compiler._sha256(library)
    library.rename(library.with_name(f"{_manifest().stem}-{found[:16]}{library.suffix}"))
    content = json.loads(_manifest().read_text())
    _manifest().write_text(json.dumps({**content, "source": "0" * 64, "library": found}))


def _break_manifest(library: Path) -> None:
    _manifest().write_text("{")


def _empty_manifest(library: Path) -> None:
    _manifest().write_text("[]")


def _point_elsewhere(library: Path) -> None:
    content = json.loads(_manifest().read_text())
    _manifest().write_text(json.dumps({**content, "library": "/../../../evil"}))


DAMAGE = [
    _append_to_library,
    _truncate_library,
    _remove_library,
    _library_of_another_source,
    _break_manifest,
    _empty_manifest,
    _point_elsewhere,
]


@pytest.mark.parametrize("damage", DAMAGE)
def test_what_does_not_fit_is_built_again_and_not_loaded(damage, counted: Counted) -> None:
    library = library_for(SOURCE, counted)
    sound = library.read_bytes()
    damage(library)
    again = library_for(SOURCE, counted)
    assert counted.calls == 2
    assert again.read_bytes() == sound
    assert library_for(SOURCE, counted) == again
    assert counted.calls == 2


def test_processes_may_race(counted: Counted) -> None:
    with ThreadPoolExecutor(4) as pool:
        libraries = list(pool.map(lambda _: library_for(SOURCE, counted), range(4)))
    assert all(path.is_file() for path in libraries)
    assert library_for(SOURCE, counted) in libraries
    assert len(list(cache_folder().glob("*.json"))) == 1


def test_libraries_without_use_are_forgotten(counted: Counted) -> None:
    library, foreign = library_for(SOURCE, counted), cache_folder() / "notes.txt"
    foreign.write_text("not ours")
    for path in (library, _manifest(), foreign):
        os.utime(path, (0, 0))
    compiler._remove_old.cache_clear()
    library_for(SOURCE.replace("42", "43"), counted)
    assert not library.exists()
    assert foreign.exists()


_KILLED = """
import os, signal, sys
from pathlib import Path
from undertow.codegen.compiler import library_for
from undertow.codegen.compiler import Compiler

class Killed(Compiler):
    def build(self, source, library):
        library.write_bytes(b"half")
        if sys.argv[2] == "killed":
            os.kill(os.getpid(), signal.SIGKILL)
        print("building", flush=True)
        sys.stdin.read()

library_for("int undertow_test_slow;", Killed(("cc",), "none"), Path(sys.argv[1]))
"""


def _building(folder: Path, how: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", _KILLED, str(folder), how]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


@posix
def test_what_a_killed_build_left_goes_after_an_hour(counted: Counted) -> None:
    """And what another process is building stays."""
    folder = cache_folder()
    with _building(folder, "killed") as dead:
        dead.communicate()
    (left,) = folder.glob("build-*")
    assert (left / "model.c").is_file()
    with _building(folder, "waiting") as alive:
        assert alive.stdout is not None
        assert alive.stdout.readline() == "building\n"
        (running,) = set(folder.glob("build-*")) - {left}
        hour_ago = time.time() - 3700.0
        os.utime(left, (hour_ago, hour_ago))
        compiler._remove_old.cache_clear()  # it is looked once in a process
        library_for(SOURCE, counted)
        assert list(folder.glob("build-*")) == [running]
        alive.communicate()
    assert not list(folder.glob("build-*"))


# --- the folder ---------------------------------------------------------------------------------


@posix
def test_the_cache_belongs_to_the_user_alone(own_cache: Path) -> None:
    before = os.umask(0)
    try:
        assert cache_folder() == own_cache
    finally:
        os.umask(before)
    assert stat.S_IMODE(own_cache.stat().st_mode) == 0o700


def _private(reason: str, caplog: pytest.LogCaptureFixture) -> Path:
    """The folder in use, after making sure that it is private and that the reason is told once."""
    folder = cache_folder()
    assert cache_folder() == folder
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert [reason in record.getMessage() for record in caplog.records] == [True]
    return folder


@posix
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o1777])
def test_a_folder_that_others_can_write_is_refused(
    mode: int, own_cache: Path, c_compiler: Compiler, caplog: pytest.LogCaptureFixture
) -> None:
    own_cache.mkdir(parents=True)
    own_cache.chmod(mode)
    folder = _private("written by others", caplog)
    assert library_for(SOURCE, c_compiler).parent == folder
    assert not list(own_cache.iterdir())


@posix
def test_a_folder_below_one_that_everybody_can_write_is_refused(
    own_cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    own_cache.parent.mkdir()
    own_cache.parent.chmod(0o777)
    assert _private("is world-writable", caplog) != own_cache


@posix
def test_a_folder_of_somebody_else_is_refused(
    own_cache: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    assert _private("belongs to user", caplog) != own_cache


@posix
def test_a_link_in_place_of_the_folder_is_refused(own_cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    own_cache.parent.mkdir()
    (own_cache.parent / "elsewhere").mkdir(mode=0o700)
    own_cache.symlink_to(own_cache.parent / "elsewhere")
    assert _private("not a folder of its own", caplog) != own_cache


@posix
def test_a_cache_that_cannot_be_made_is_replaced(own_cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    own_cache.parent.write_text("a file where a folder should be")
    assert _private("cannot be used", caplog) != own_cache


@posix
def test_a_folder_that_really_belongs_to_somebody_else_is_refused(
    own_cache: Path, c_compiler: Compiler, caplog: pytest.LogCaptureFixture
) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can give a folder away")
    own_cache.mkdir(parents=True, mode=0o700)
    os.chown(own_cache, OTHER, OTHER)
    folder = _private(f"belongs to user {OTHER}", caplog)
    assert library_for(SOURCE, c_compiler).parent == folder
    assert not list(own_cache.iterdir())


@posix
def test_a_link_on_the_way_is_followed_once(own_cache: Path, c_compiler: Compiler) -> None:
    """A cache on another disk is all right, and who moves the link afterwards has moved nothing."""
    link, there = own_cache.parent, own_cache.parent.with_name("another-disk")
    there.mkdir(mode=0o700)
    link.symlink_to(there)
    folder = cache_folder()
    assert folder == there / "undertow"
    link.unlink()
    link.symlink_to("/nowhere")
    assert library_for(SOURCE, c_compiler, folder).parent == there / "undertow"


@posix
def test_a_link_to_where_everybody_can_write_is_refused(
    own_cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The folder that the link names is ours, but one above it could be replaced."""
    everybody = own_cache.parent.with_name("scratch")
    (everybody / "mine").mkdir(parents=True, mode=0o700)
    everybody.chmod(0o777)
    own_cache.parent.symlink_to(everybody / "mine")
    assert _private("is world-writable", caplog) != everybody / "mine" / "undertow"


@posix
def test_a_link_to_itself_is_refused(own_cache: Path, caplog: pytest.LogCaptureFixture) -> None:
    own_cache.parent.symlink_to(own_cache.parent)
    _private("cannot be used", caplog)


@posix
@pytest.mark.parametrize("home", [None, "somewhere"])
def test_a_user_without_a_home_has_a_private_folder(
    home: str | None, own_cache: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("HOME")
    if home is not None:
        monkeypatch.setenv("HOME", home)
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)
    _private("no home", caplog)


@posix
def test_without_any_place_for_compiled_code_one_line_says_what_to_do(
    own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own_cache.parent.write_text("a file where a folder should be")
    monkeypatch.setattr("tempfile.tempdir", str(own_cache))
    with pytest.raises(UndertowError, match=r"no temporary folder .*XDG_CACHE_HOME or TMPDIR"):
        cache_folder()


OTHER = 54321  # a user that there is not
AS_ANOTHER = f"""
import ctypes, os, sys
from undertow.codegen.compiler import library_for
from undertow.codegen.compiler import find_compiler
compiler = find_compiler()
if os.getuid() == 0:  # to whom nothing is write-protected
    os.setgroups([]), os.setgid({OTHER}), os.setuid({OTHER})
for _ in range(2):
    library = library_for(sys.argv[1], compiler)
loaded = ctypes.CDLL(str(library))
loaded.undertow_test_answer.restype = ctypes.c_double
print(library.parent, loaded.undertow_test_answer())
"""


@posix
def test_a_home_that_is_write_protected_costs_one_line(c_compiler: Compiler) -> None:
    """Also where the user is root, who becomes somebody else before the cache is asked for."""
    with tempfile.TemporaryDirectory() as name:  # the folders of pytest are for their owner alone
        home, temporary = Path(name, "home"), Path(name, "tmp")
        home.mkdir(mode=0o555)
        temporary.mkdir()
        for path, mode in ((Path(name), 0o755), (home, 0o555), (temporary, 0o1777)):
            path.chmod(mode)
        done = _python(AS_ANOTHER, SEEN, HOME=str(home), XDG_CACHE_HOME="", TMPDIR=str(temporary))
        assert done.stdout.startswith(str(temporary))
        assert done.stdout.endswith(" 42.0\n")
        (line,) = done.stderr.splitlines()
        assert f"cache folder '{home}/.cache/undertow' cannot be used (Permission denied)" in line
        assert not [*home.iterdir(), *temporary.iterdir()]  # the private folder has gone again


# --- processes ------------------------------------------------------------------------------------

# A compiler that begins when two processes have called it: they do build at the same time.
TOGETHER = """#!/bin/sh
[ "$1" = --version ] && exec cc "$@"
touch "$MEETING/$$"
turns=0
while [ "$(ls "$MEETING" | wc -l)" -lt 2 ] && [ $turns -lt 20000 ]; do turns=$((turns + 1)); done
exec cc "$@"
"""
BUILD = """
import ctypes, sys
from undertow.codegen.compiler import library_for
from undertow.codegen.compiler import find_compiler
library = library_for(sys.argv[1], find_compiler())
print(library)
loaded = ctypes.CDLL(str(library))
loaded.undertow_test_answer.restype = ctypes.c_double
assert loaded.undertow_test_answer() == 42.0
"""


@pytest.mark.slow
@posix
def test_two_processes_build_the_same_at_once(
    c_compiler: Compiler, own_cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if shutil.which("cc") is None:
        pytest.skip("no command cc on this machine")
    script, meeting = tmp_path / "cc-together", tmp_path / "meeting"
    script.write_text(TOGETHER)
    script.chmod(0o755)
    meeting.mkdir()
    monkeypatch.setenv("UNDERTOW_CC", str(script))
    with ThreadPoolExecutor(2) as pool:
        done = [pool.submit(_python, BUILD, SEEN, MEETING=str(meeting)) for _ in range(2)]
    assert len(list(meeting.iterdir())) == 2
    libraries = {Path(one.result().stdout.strip()) for one in done}
    (manifest,) = own_cache.glob("*.json")
    kept = own_cache / f"{manifest.stem}-{json.loads(manifest.read_text())['library'][:16]}.so"
    assert kept in libraries
    assert {*own_cache.iterdir()} == {manifest, *libraries}
    assert _python(BUILD, SEEN, MEETING=str(tmp_path / "nowhere")).stdout.strip() == str(kept)


# --- symbols ------------------------------------------------------------------------------------

TRAP = """
#include <stdlib.h>
double dynamics(void) { abort(); }
double tangents(void) { abort(); }
double step(void) { abort(); }
double advance(void) { abort(); }
double evaluate(void) { abort(); }
double simulate(void) { abort(); }
double undertow_model_sq(void) { abort(); }
double undertow_model_sign(void) { abort(); }
double undertow_model_fabs(void) { abort(); }
"""
TRAPPED = """
import ctypes, sys
import numpy as np
ctypes.CDLL(sys.argv[1], mode=ctypes.RTLD_GLOBAL)
from tests.codegen.support import functions_of
from undertow.codegen import Simulator
from undertow.codegen.compiler import find_compiler, load
for name in ("mini-auv", "box-hull"):
    functions = functions_of(name)
    x, u, p = np.ones(len(functions.state_names)), np.ones((9, functions.u.numel())), functions.values()
    Simulator(functions, compiled=True).run_with_sensitivities(x, np.arange(9.0), u, p, [0])
    assert load(functions.dynamics, find_compiler())(x, u[0], p, 0).shape == (x.size, 1)
print("alive")
"""


@pytest.mark.slow
@posix
def test_functions_of_other_libraries_are_not_called(c_compiler: Compiler, tmp_path: Path) -> None:
    """A library in the process that has functions of the same names does not get into the way."""
    (tmp_path / "trap.c").write_text(TRAP)
    c_compiler.build(tmp_path / "trap.c", tmp_path / "trap.so")
    (tmp_path / "visible.c").write_text(TRAP)
    subprocess.run(
        [*c_compiler.command, "-shared", "-fPIC", "-o", "visible.so", "visible.c"], cwd=tmp_path, check=True
    )
    done = _python(TRAPPED, str(tmp_path / "visible.so"))
    assert done.stdout.strip() == "alive"


def _python(program: str, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        check=True,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[2],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(["src", "."]), **environment},
    )


HASHES = """
from tests.codegen.support import functions_of
from undertow.codegen.engine import tangents_source
from undertow.codegen.engine import rollout_source
from undertow.codegen.source import c_source, digest
for name in ("bluerov2", "full"):
    functions = functions_of(name)
    print(rollout_source(functions, 1)[1])
    print(tangents_source(functions, [0, 1, -1])[1])
    print(digest(c_source(functions.regressor)))
"""


@pytest.mark.slow
def test_the_same_model_is_the_same_source_in_every_process() -> None:
    first, second = (_python(HASHES, PYTHONHASHSEED=seed).stdout for seed in ("1", "2"))
    assert first == second
    here = functions_of("bluerov2")
    assert rollout_source(here, 1)[1] == first.split()[0]


# --- no compiler --------------------------------------------------------------------------------


@pytest.fixture
def no_compiler(own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNDERTOW_NO_COMPILER", "1")


def test_without_a_compiler_the_virtual_machine_runs_and_one_line_says_so(
    no_compiler: None, caplog: pytest.LogCaptureFixture
) -> None:
    functions = functions_of("box-hull")
    for _ in range(2):
        simulator = Simulator(functions)
        assert not simulator.compiled
    x, _ = simulator.run_with_sensitivities(
        np.zeros(2), np.arange(3.0), np.ones((3, 1)), np.array(functions.values()), [0]
    )
    assert x[2, 1] > 0
    assert [r.levelno for r in caplog.records] == [logging.WARNING]
    assert "no C compiler" in caplog.text
    assert "The CasADi virtual machine runs" in caplog.text


def test_a_demand_for_compiled_code_that_cannot_be_met_is_reported(no_compiler: None) -> None:
    with pytest.raises(UndertowError, match="no C compiler found"):
        Simulator(functions_of("box-hull"), compiled=True)


@posix
def test_a_path_without_compilers(own_cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delenv("UNDERTOW_CC", raising=False)
    assert find_compiler() is None


def test_a_compiler_that_is_named_is_used(c_compiler: Compiler, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNDERTOW_CC", f"{c_compiler.command[0]} -g0")
    found = find_compiler()
    assert found is not None
    assert found.command == (c_compiler.command[0], "-g0")


@pytest.mark.parametrize("wanted", ["no-such-compiler-anywhere", " "])
def test_a_named_compiler_that_does_not_run_is_reported(wanted: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNDERTOW_CC", wanted)
    with pytest.raises(UndertowError, match="UNDERTOW_CC"):
        find_compiler()


@posix
def test_a_broken_compiler_is_reported_and_replaced(
    own_cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    script = tmp_path / "broken-cc"
    version = '[ "$1" = --version ] && echo "broken 1.0" && exit 0'
    script.write_text(f'#!/bin/sh\n{version}\necho "math.h: no such file" >&2\nexit 1\n')
    script.chmod(0o755)
    monkeypatch.setenv("UNDERTOW_CC", str(script))
    functions = functions_of("box-hull")
    with pytest.raises(UndertowError, match=r"failed, code 1: math\.h: no such file"):
        Simulator(functions, compiled=True)
    assert not Simulator(functions).compiled
    assert "math.h" in caplog.text
    assert not list(cache_folder().iterdir())


# --- the processor ------------------------------------------------------------------------------


def test_a_library_for_this_processor_has_a_key_of_its_own(
    c_compiler: Compiler, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = c_compiler.for_this_machine()
    if here == c_compiler:
        pytest.skip("this compiler does not tell what the processor can do")
    compiler._processor.cache_clear()
    monkeypatch.setattr(compiler, "_processor", lambda command: "#define __ANOTHER__ 1")
    there = c_compiler.for_this_machine()
    assert len({c.identity for c in (c_compiler, here, there)}) == 3
    assert "-march=native" in here.identity
    assert "-march=native" not in c_compiler.identity
