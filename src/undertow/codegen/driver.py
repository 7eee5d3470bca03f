"""Simulation with sensitivities by the compiled driver: one call for all samples of all runs."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import casadi as ca
import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .cache import library_for
from .compiler import Compiler
from .functions import Functions
from .lanes import LANES_HEADER, defines
from .plain import plain_c
from .problem import Problem
from .source import EXPORTED, integers, with_entry


class CompiledStepper:
    """The driver in C around the generated tangents: one call for all samples of all runs."""

    def __init__(self, functions: Functions, compiler: Compiler) -> None:
        source, name = driver_source(functions)
        self.library: Path = library_for(source, compiler.for_this_machine())
        self._simulate = getattr(loaded(self.library), name)
        self._simulate.restype = ctypes.c_int

    def advance(self, problem: Problem, first: int, last: int) -> None:
        simulate(self._simulate, problem, first, last)


def simulate(run: Callable[..., int], problem: Problem, first: int, last: int, *model: object) -> None:
    """Call the driver from sample `first` to sample `last`, with the model where that is data.

    Raises
    ------
    UndertowError
        If there is no memory.
    """
    b, n, _ = problem.x.shape
    failed = run(
        *model,
        *map(ctypes.c_int64, (b, n, first, last)),
        *shared(problem.t),
        pointer(problem.steps),
        *shared(problem.u),
        *shared(problem.p),
        pointer(problem.wrt),
        ctypes.c_int64(problem.wrt.size),
        pointer(problem.x),
        pointer(problem.s),
    )
    if failed:
        raise UndertowError(f"no memory for {problem.wrt.size} sensitivities: ask for fewer at a time")


def loaded(library: Path) -> ctypes.CDLL:
    """A compiled library, ready to be called.

    Raises
    ------
    UndertowError
        If the system cannot load it.
    """
    try:
        return ctypes.CDLL(str(library))
    except OSError as error:
        raise UndertowError(f"compiled code cannot be loaded: {error}; set UNDERTOW_NO_COMPILER=1") from error


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Address of a contiguous array."""
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


def shared(array: Array) -> tuple[ctypes.c_void_p, ctypes.c_int64]:
    """Address of an array and the distance from run to run, zero where the runs share it."""
    return pointer(array), ctypes.c_int64(0 if array.shape[0] == 1 else array[0].size)


def driver_source(functions: Functions) -> tuple[str, str]:
    """C source of a simulation with sensitivities and the name of its entry point.

    The entry point carries the hash of the source, so that no other library in the process has the same one.
    """
    function = functions.tangents("x", "p")
    sizes = {"NX": functions.x.numel(), "NU": functions.u.numel(), "ND": functions.nu_dot.numel()}
    patterns = _pattern("RX", function.sparsity_out("R_x")) + _pattern("RP", function.sparsity_out("R_p"))
    # Compiled into its only caller, a large model takes almost twice as long to compile and runs no faster.
    model = plain_c(function, "tangents", packed=("R_x", "R_p"), prefix="static SEPARATE ")
    driver = (files("undertow.codegen") / "driver.c").read_text(encoding="utf-8")
    text = "\n".join([defines(sizes.items()), EXPORTED, LANES_HEADER, *patterns, model, driver])
    return with_entry(text, "SIMULATE", "simulate")


def _pattern(name: str, sparsity: ca.Sparsity) -> list[str]:
    column, row = sparsity.get_ccs()
    return [
        f"#define {name}_NONZEROS {len(row)}",
        integers(f"{name}_COLUMN", column),
        integers(f"{name}_ROW", row),
    ]
