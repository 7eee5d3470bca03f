"""The hand-written model of `hand.c`: its parameters, and how it is compiled."""

from __future__ import annotations

import ctypes
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from undertow.codegen.compiler import find_compiler
from undertow.model.symbols import FORCE, VELOCITY

from . import vehicle

SOURCE = Path(__file__).with_name("hand.c")
# What somebody who wants speed asks of the compiler; it may use fused multiply-add.
FLAGS = ("-std=gnu99", "-O3", "-march=native", "-fno-math-errno", "-fPIC", "-shared", "-w")
_ROWS = 8


@cache
def parameters() -> np.ndarray:
    """The values of the vehicle as `HandParameters`."""
    value = {n: vehicle.vehicle().value_of(n).value for n in vehicle.functions().parameter_names}
    mass = _rigid_body(value) - _derivatives(value, "{}_{}dot", symmetric=True)
    quadratic = [value[f"{f}_{m}abs{m}"] for f, m in zip(FORCE, VELOCITY, strict=True)]
    thrust = [value[f"thrust_{t.name}"] for t in vehicle.vehicle().thrusters]
    allocation = np.array([t.wrench for t in vehicle.vehicle().thrusters]).T * thrust
    parts: list[ArrayLike] = [
        *(_columns(m) for m in (mass, np.linalg.inv(mass), _derivatives(value, "{}_{}"), allocation)),
        _padded(quadratic, _ROWS),
        _padded([value["S_x"], value["S_y"], value["S_z"]], 4),
        [value["W"] - value["B"]],
        [value["V_N"], value["V_E"], 0.0],
    ]
    return _aligned(np.concatenate(parts))


def _aligned(values: np.ndarray) -> np.ndarray:
    """A copy that begins with a cache line, so that no vector of eight crosses one."""
    block = np.empty(values.size + _ROWS)
    first = -block.ctypes.data % (8 * _ROWS) // 8
    block[first : first + values.size] = values
    return block[first : first + values.size]


def _rigid_body(value: dict[str, float]) -> np.ndarray:
    x, y, z = (value[f"m{a}_g"] for a in "xyz")
    arm = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    xy, xz, yz = (-value[f"I_{a}"] for a in ("xy", "xz", "yz"))
    tensor = np.array([[value["I_x"], xy, xz], [xy, value["I_y"], yz], [xz, yz, value["I_z"]]])
    return np.block([[value["m"] * np.eye(3), -arm], [arm, tensor]])


def _derivatives(value: dict[str, float], name: str, *, symmetric: bool = False) -> np.ndarray:
    """A matrix of SNAME derivatives; of a symmetric one the upper half has names."""
    full = np.array([[value.get(name.format(f, m), 0.0) for m in VELOCITY] for f in FORCE])
    return np.triu(full) + np.triu(full, 1).T if symmetric else full


def _columns(matrix: np.ndarray) -> np.ndarray:
    return np.pad(matrix.T, ((0, 0), (0, _ROWS - matrix.shape[0]))).ravel()


def _padded(values: list[float], size: int) -> list[float]:
    return [*values, *[0.0] * (size - len(values))]


def library(source: str, folder: Path, name: str, *flags: str) -> ctypes.CDLL:
    """C source compiled the way hand-written code is, with more options if it needs them."""
    compiler = find_compiler()
    assert compiler is not None
    (folder / f"{name}.c").write_text(source, encoding="utf-8")
    files = [f"{name}.c", "-o", f"{name}.so", "-lm"]
    command = [*compiler.command, *FLAGS, *flags, f"-I{SOURCE.parent}", *files]
    subprocess.run(command, check=True, cwd=folder)
    return ctypes.CDLL(str(folder / f"{name}.so"))
