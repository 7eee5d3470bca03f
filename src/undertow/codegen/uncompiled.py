"""Simulation with a model that is not compiled: the driver in C runs its instructions over runs side by side.

Compiling a model takes longer than simulating it once or twice, as a judge of many models does.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache

import numpy as np

from .cache import library_for
from .compiler import Compiler
from .driver import loaded, simulate
from .functions import Functions
from .problem import Problem
from .tape import Tape, TapeData, tape_source

# Runs side by side: enough that what an instruction is takes less time than to do it.
_RUNS = 16
# Columns and rows of R_x and R_p where no sensitivities are wanted.
_NONE: list[tuple[list[int], list[int]]] = [([], [])] * 2


class _Model(ctypes.Structure):
    """A model as driver.c takes it."""

    _fields_ = (
        ("tape", TapeData),
        *((name, ctypes.c_int64) for name in ("nx", "nu", "nd")),
        *((name, ctypes.c_void_p) for name in ("rx_column", "rx_row", "rp_column", "rp_row")),
        *((name, ctypes.c_int64) for name in ("rx_nonzeros", "rp_nonzeros")),
    )


class UncompiledStepper:
    """The driver around the instructions of a model.

    Parameters
    ----------
    functions : Functions
        The model.
    compiler : Compiler
        For the driver itself, which is the same for all models.
    sensitivities : bool
        Whether to carry derivatives along.
    """

    def __init__(self, functions: Functions, compiler: Compiler, *, sensitivities: bool) -> None:
        self._simulate = _driver(compiler.for_this_machine())
        function = functions.tangents("x", "p") if sensitivities else functions.dynamics
        self._tape = Tape(function)
        slopes = [function.sparsity_out(n).get_ccs() for n in ("R_x", "R_p") if sensitivities]
        self._patterns = [np.array(a, dtype=np.int64) for pair in slopes or _NONE for a in pair]
        self._model = _Model(
            self._tape.data,
            functions.x.numel(),
            functions.u.numel(),
            functions.nu_dot.numel() if sensitivities else 0,
            *(a.ctypes.data for a in self._patterns),
            *(len(rows) for rows in self._patterns[1::2]),
        )

    def advance(self, problem: Problem, first: int, last: int) -> None:
        simulate(self._simulate, problem, first, last, ctypes.byref(self._model))


@cache
def _driver(compiler: Compiler) -> Callable[..., int]:
    source, name = uncompiled_source()
    run = getattr(loaded(library_for(source, compiler)), name)
    run.restype = ctypes.c_int
    return run


def uncompiled_source() -> tuple[str, str]:
    """C source of the driver over instructions, and the name of its entry point."""
    return tape_source("driver.c", "SIMULATE", "interpreted", _RUNS, "#define INTERPRETED")
