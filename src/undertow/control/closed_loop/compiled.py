"""Closed loops in compiled code: one call for many samples of many runs."""

from __future__ import annotations

import ctypes

import numpy as np

from undertow.codegen.compiler import Compiler
from undertow.codegen.driver import pointer
from undertow.codegen.lanes import LANES_HEADER, defines, lanes_for, packed, unpacked
from undertow.codegen.plain import LANES, plain_c
from undertow.codegen.rollout import Entries
from undertow.codegen.source import c_file, with_entry

from .parts import Parts
from .problem import ALL, Block, LoopProblem, Rows

_POINTER = ctypes.c_void_p
_PER_RUN = ("p", "r", "k")
_CHANGED = ("x", "s", "command", "commands", "reports")


class _Loop(ctypes.Structure):
    _fields_ = (
        ("dt", ctypes.c_double),
        *((name, ctypes.c_int64) for name in ("substeps", "continuous", "input_delay", "report_ring")),
        ("output_delay", _POINTER),
        *((name, ctypes.c_int64) for name in ("stride", "rows", *(f"{n}_step" for n in _PER_RUN))),
        *((name, _POINTER) for name in (*_PER_RUN, *_CHANGED, "noise", "extra")),
        ("record", _POINTER * len(ALL)),
    )


class CompiledLoop:
    """Model, sensors, controller, allocation, schedule and integrator in a library for each lane count."""

    parallel = True

    def __init__(self, parts: Parts, compiler: Compiler) -> None:
        self._parts, self.lanes = parts, compiler.lanes
        self._entries = Entries(lambda lanes: loop_source(parts, lanes), compiler)
        self._entries(1)

    def run(self, problem: LoopProblem, block: Block) -> Rows:
        lanes = lanes_for(problem.runs, self.lanes)
        arrays = {name: packed(getattr(problem, name), lanes) for name in (*_PER_RUN, *_CHANGED)}
        noise = None if block.noise is None else packed(block.noise, lanes)
        groups = len(arrays["x"])
        record = vars(block.rows(self._parts, groups, lanes)).values()
        loop = _Loop(
            *(problem.dt, problem.substeps, problem.continuous, problem.input_delay),
            *(problem.reports.shape[1], _address(problem.output_delay), block.stride, len(block.recorded)),
            *(arrays[name][0].size for name in _PER_RUN),
            *map(_address, [*arrays.values(), noise, block.extra]),
            (_POINTER * len(ALL))(*(_address(array if array.size else None) for array in record)),
        )
        span = map(ctypes.c_int64, (0, groups, block.first, block.samples))
        self._entries(lanes)(ctypes.byref(loop), *span)
        for name in _CHANGED:
            getattr(problem, name)[:] = unpacked(arrays[name], problem.runs)
        return Rows(*(unpacked(array, problem.runs) for array in record))


def _address(array: np.ndarray | None) -> ctypes.c_void_p:
    return ctypes.c_void_p(None) if array is None else pointer(array)


def loop_source(parts: Parts, lanes: int = 1) -> tuple[str, str]:
    """C source of closed loops and the name of the entry point, which carries the hash of the source."""
    form = parts.functions.prepared
    functions = [form.prepare, form.hold, form.held_dynamics, parts.outputs, parts.control, parts.law]
    sizes = {
        "LANES": lanes,
        "NX": parts.dynamics.size1_in("x"),
        "NU": parts.dynamics.size1_in("u"),
        "NP": parts.dynamics.size1_in("p"),
        "NQ": form.prepare.size1_out("q"),
        "NW": form.hold.size1_out("w"),
        "NS": parts.control.size1_in("s"),
        "NR": parts.control.size1_in("r"),
        "NK": parts.control.size1_in("k"),
        "NY": parts.control.size1_in("y"),
        "NT": parts.control.size1_out("tau"),
    }
    short = {form.hold.name(), parts.outputs.name()}
    model = [
        plain_c(
            f,
            f.name(),
            prefix="INLINE " if f.name() in short else "static SEPARATE ",
            words=LANES,
            shared=("t", "dt"),
        )
        for f in functions
    ]
    loop = c_file("loop.c", "undertow.control.closed_loop")
    text = "\n".join([defines(sizes.items()), LANES_HEADER, *model, loop])
    return with_entry(text, "RUN", "run")
