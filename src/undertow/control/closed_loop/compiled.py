"""A closed loop in compiled code: one call for many samples."""

from __future__ import annotations

import ctypes
from importlib.resources import files

import numpy as np

from undertow.codegen.cache import library_for
from undertow.codegen.compiler import Compiler
from undertow.codegen.driver import SEPARATE, loaded
from undertow.codegen.plain import plain_c
from undertow.codegen.source import digest

from .parts import Parts
from .problem import LoopProblem, Rows

_POINTER = ctypes.c_void_p


class _Loop(ctypes.Structure):
    _fields_ = (
        ("dt", ctypes.c_double),
        *((name, ctypes.c_int64) for name in ("substeps", "continuous", "input_delay")),
        *((name, _POINTER) for name in ("output_delay", "p", "r", "k", "x", "s", "commands", "reports")),
        ("report_ring", ctypes.c_int64),
    )


class _Record(ctypes.Structure):
    _fields_ = tuple((name, _POINTER) for name in ("x", "y", "u", "s", "tau"))


class CompiledLoop:
    """Model, sensors, controller, allocation, schedule and integrator in one library."""

    def __init__(self, parts: Parts, compiler: Compiler) -> None:
        self._parts = parts
        source, name = loop_source(parts)
        self._run = getattr(loaded(library_for(source, compiler)), name)
        self._run.restype = None

    def run(self, problem: LoopProblem, first: int, noise: np.ndarray, extra: np.ndarray) -> Rows:
        rows = Rows.empty(self._parts, len(noise))
        loop, record = _loop(problem), _Record(*map(_address, vars(rows).values()))
        counts = map(ctypes.c_int64, (first, len(noise)))
        self._run(ctypes.byref(loop), ctypes.byref(record), *counts, _address(noise), _address(extra))
        return rows


def _loop(problem: LoopProblem) -> _Loop:
    arrays = ("output_delay", "p", "r", "k", "x", "s", "commands", "reports")
    return _Loop(
        problem.dt,
        problem.substeps,
        problem.continuous,
        problem.input_delay,
        *(_address(getattr(problem, name)) for name in arrays),
        len(problem.reports),
    )


def _address(array: np.ndarray) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


def loop_source(parts: Parts) -> tuple[str, str]:
    """C source of a closed loop and the name of its entry point, which carries the hash of the source."""
    functions = [parts.dynamics, parts.outputs, parts.control, parts.law]
    sizes = {
        "NX": parts.dynamics.size1_in("x"),
        "NU": parts.dynamics.size1_in("u"),
        "NS": parts.control.size1_in("s"),
        "NR": parts.control.size1_in("r"),
        "NY": parts.control.size1_in("y"),
        "NT": parts.control.size1_out("tau"),
    }
    defines = [f"#define {name} {size}" for name, size in sizes.items()]
    model = [plain_c(f, f.name(), prefix="static SEPARATE ") for f in functions]
    loop = (files("undertow.control.closed_loop") / "loop.c").read_text(encoding="utf-8")
    text = "\n".join([*defines, SEPARATE, "#include <math.h>", "", *model, loop])
    name = f"undertow_{digest(text)[:16]}_run"
    return f"#define RUN {name}\n{text}", name
