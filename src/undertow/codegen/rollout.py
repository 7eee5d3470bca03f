"""Simulation without sensitivities by compiled code: runs side by side in lanes."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from undertow.typing import Array

from .cache import library_for
from .compiler import Compiler
from .driver import loaded, pointer
from .functions import Functions
from .lanes import LANES_HEADER, defines, lanes_for, packed, unpacked
from .plain import LANES, plain_c
from .problem import Problem
from .source import c_file, with_entry

_GROUP_ARRAYS = ("t", "count", "u", "p")


class _RolloutLogs(ctypes.Structure):
    _fields_ = (
        ("samples", ctypes.c_int64),
        *((f"{name}_step", ctypes.c_int64) for name in _GROUP_ARRAYS),
        *((name, ctypes.c_void_p) for name in (*_GROUP_ARRAYS, "x")),
    )


class Entries:
    """Entry points of a loop for different numbers of lanes, each compiled when it is first asked for."""

    def __init__(self, source: Callable[[int], tuple[str, str]], compiler: Compiler) -> None:
        # What is a vector is so already; others that the compiler makes up cost a twentieth.
        self._source, self._compiler = source, compiler.for_this_machine("-fno-tree-vectorize")
        self._known: dict[int, Callable[..., None]] = {}
        self.libraries: dict[int, Path] = {}
        self._building = Lock()

    def __call__(self, lanes: int) -> Callable[..., None]:
        """The entry point for so many lanes."""
        with self._building:
            if lanes not in self._known:
                source, name = self._source(lanes)
                self.libraries[lanes] = library_for(source, self._compiler)
                entry: Any = getattr(loaded(self.libraries[lanes]), name)
                entry.restype = None
                self._known[lanes] = entry
        return self._known[lanes]


class CompiledRollout:
    """Runge-Kutta around the generated dynamics: one call for many samples of many runs."""

    parallel = True

    def __init__(self, functions: Functions, compiler: Compiler) -> None:
        self.lanes = compiler.lanes
        self._entries = Entries(lambda lanes: rollout_source(functions, lanes), compiler)
        self._entries(1)

    @property
    def library(self) -> Path:
        """The library for one lane."""
        return self._entries.libraries[1]

    def advance(self, problem: Problem, first: int, last: int) -> None:
        lanes, runs = lanes_for(len(problem.x), self.lanes), len(problem.x)
        arrays = {
            "t": packed(problem.t[:, first : last + 1], lanes),
            "count": packed(problem.steps[:, first:last].astype(float), lanes),
            "u": packed(problem.u[:, first:last], lanes),
            "p": packed(problem.p, lanes),
        }
        x = packed(problem.x[:, first : last + 1], lanes)
        steps = (0 if len(a) < len(x) else a[0].size for a in arrays.values())
        logs = _RolloutLogs(last + 1 - first, *steps, *map(_address, [*arrays.values(), x]))
        self._entries(lanes)(ctypes.byref(logs), ctypes.c_int64(len(x)))
        problem.x[:, first + 1 : last + 1] = unpacked(x, runs)[:, 1:]


def _address(array: Array) -> ctypes.c_void_p:
    assert array.dtype == np.float64
    return pointer(array)


def rollout_source(functions: Functions, lanes: int) -> tuple[str, str]:
    """C source of a simulation and the name of its entry point, which carries the hash of the source."""
    model = model_source(functions)
    text = "\n".join([defines([("LANES", lanes)]), LANES_HEADER, model, c_file("rollout.c")])
    return with_entry(text, "RUN", "simulate")


def model_source(functions: Functions) -> str:
    """C source of the prepared form, for any number of lanes, with its sizes."""
    form = functions.prepared
    sizes = {
        "NX": functions.x.numel(),
        "NU": functions.u.numel(),
        "NP": functions.p.numel(),
        "NQ": form.prepare.size1_out("q"),
        "NW": form.hold.size1_out("w"),
    }
    steps = form.prepare, form.hold, form.held_dynamics
    model = [plain_c(f, f.name(), prefix="static SEPARATE ", words=LANES) for f in steps]
    return "\n".join([defines(sizes.items()), *model])
