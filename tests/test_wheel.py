"""The wheel: with the engine compiled where there is a compiler, else pure Python; what runs from it."""

from __future__ import annotations

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from undertow.codegen import Simulator
from undertow.codegen.compiler import find_compiler
from undertow.codegen.functions import Functions
from undertow.codegen.source import engine_file
from undertow.model.loading import load_vehicle

ROOT = Path(__file__).parents[1]
SIMULATES = """
import logging, sys
import numpy as np
from undertow.codegen import Functions, Simulator
from undertow.model.loading import load_vehicle
functions = Functions(load_vehicle("mini-auv"))
x0, t, u = np.zeros(len(functions.state_names)), np.arange(9.0), np.full((9, functions.u.numel()), 0.2)
p = np.array(functions.values())
x, s = Simulator(functions).run_with_sensitivities(x0, t, u, p, [0, 1], initial=[0])
np.savez(sys.argv[1], x=x, s=s)
"""


def _wheel(folder: Path, compiler: str) -> Path:
    """The wheel built with this compiler."""
    pytest.importorskip("hatchling", reason="hatchling is not installed")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, env={**os.environ, "CC": compiler}, check=True, capture_output=True)
    (wheel,) = folder.glob("*.whl")
    return wheel


def test_without_a_compiler_the_wheel_is_pure_python(tmp_path: Path) -> None:
    wheel = _wheel(tmp_path, "no-such-compiler-anywhere")
    assert wheel.name.endswith("-py3-none-any.whl")
    names = zipfile.ZipFile(wheel).namelist()
    assert "undertow/codegen/tangents.c" in names
    assert f"undertow/codegen/{engine_file().name}" not in names


@pytest.mark.skipif(sys.platform == "win32", reason="compiles with options of cc")
def test_the_engine_of_the_wheel_simulates_where_there_is_no_compiler(tmp_path: Path) -> None:
    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler on this machine")
    wheel = _wheel(tmp_path / "dist", " ".join(compiler.command))
    assert not wheel.name.endswith("-any.whl")
    installed = tmp_path / "installed"
    zipfile.ZipFile(wheel).extractall(installed)
    assert (installed / "undertow" / "codegen" / engine_file().name).is_file()
    environment = {**os.environ, "PYTHONPATH": str(installed), "UNDERTOW_NO_COMPILER": "1"}
    command = [sys.executable, "-c", SIMULATES, str(tmp_path / "found.npz")]
    done = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True)
    assert "The engine of this installation runs simulations" in done.stderr
    functions = Functions(load_vehicle("mini-auv"))
    x0, t, u = np.zeros(len(functions.state_names)), np.arange(9.0), np.full((9, functions.u.numel()), 0.2)
    x, s = Simulator(functions, compiled=False).run_with_sensitivities(
        x0, t, u, np.array(functions.values()), [0, 1], initial=[0]
    )
    found = np.load(tmp_path / "found.npz")
    np.testing.assert_allclose(found["x"], x, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(found["s"], s, rtol=1e-12, atol=1e-14)
    assert np.abs(x[-1]).max() > 0.1
