"""One log simulated: the compiled driver, and the same steps in NumPy."""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Protocol

import casadi as ca
import numpy as np

from undertow.errors import UndertowError

from .buffers import Evaluator
from .cache import library_for
from .compiler import Compiler
from .functions import Functions
from .source import c_source, with_unique_symbols
from .tangents import acceleration_rows, tangents

Array = np.ndarray


@dataclass
class Problem:
    """Arrays of a simulation; where runs share t, u or p, its leading size is one.

    Attributes
    ----------
    t : ndarray, shape (b or 1, n)
        Times of the samples, s.
    steps : ndarray of int64, shape (b or 1, n - 1)
        Runge-Kutta steps from sample to sample.
    u : ndarray, shape (b or 1, n, nu)
        Inputs, held from their sample to the next.
    p : ndarray, shape (b or 1, np)
        Parameters.
    x : ndarray, shape (b, n, nx)
        States; the first sample is given, the others are written.
    wrt : ndarray of int64, shape (m,)
        Parameter of every sensitivity column, -1 for columns of an initial state.
    s : ndarray, shape (b, n, nx, m), optional
        Sensitivities; the first sample is given.
    """

    t: Array
    steps: Array
    u: Array
    p: Array
    x: Array
    wrt: Array
    s: Array | None = None


class Stepper(Protocol):
    """Advances a problem from sample `first` to sample `last`."""

    def advance(self, problem: Problem, first: int, last: int) -> None: ...


# --- compiled -----------------------------------------------------------------------------------


class CompiledStepper:
    """The driver in C around the generated dynamics or tangents: one call for all samples of all runs."""

    def __init__(self, functions: Functions, compiler: Compiler, *, sensitivities: bool) -> None:
        function = tangents(functions) if sensitivities else functions.dynamics
        source, name = driver_source(function, functions.nu_dot.numel())
        self.library: Path = library_for(source, compiler)
        self._simulate = getattr(_loaded(self.library), name)
        self._simulate.restype = ctypes.c_int

    def advance(self, problem: Problem, first: int, last: int) -> None:
        b, n, _ = problem.x.shape
        failed = self._simulate(
            *map(ctypes.c_int64, (b, n, first, last)),
            *_shared(problem.t),
            _pointer(problem.steps),
            *_shared(problem.u),
            *_shared(problem.p),
            _pointer(problem.wrt),
            ctypes.c_int64(problem.wrt.size),
            _pointer(problem.x),
            None if problem.s is None else _pointer(problem.s),
        )
        if failed:
            raise UndertowError(f"no memory for {problem.wrt.size} sensitivities: ask for fewer parameters at a time")


def _loaded(library: Path) -> ctypes.CDLL:
    try:
        return ctypes.CDLL(str(library))
    except OSError as error:
        raise UndertowError(f"compiled code cannot be loaded: {error}; set UNDERTOW_NO_COMPILER=1") from error


def _pointer(array: Array) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


def _shared(array: Array) -> tuple[ctypes.c_void_p, ctypes.c_int64]:
    """Address of an array and the distance from run to run, zero where the runs share it."""
    return _pointer(array), ctypes.c_int64(0 if array.shape[0] == 1 else array[0].size)


def driver_source(function: ca.Function, n_dof: int) -> tuple[str, str]:
    """C source of a simulation around `function` (dynamics or tangents), and the name of its entry point."""
    sizes = {"NX": function.size1_in(0), "NU": function.size1_in(1), "NP": function.size1_in(2), "ND": n_dof}
    defines = [f"#define {k} {v}" for k, v in sizes.items()]
    defines += [f"#define {function.name().upper()} {function.name()}", "#define SIMULATE simulate"]
    if function.name() == "tangents":
        defines += [line for k, name in ((2, "RX"), (3, "RP")) for line in _pattern(name, function.sparsity_out(k))]
    driver = (files("undertow.codegen") / "driver.c").read_text(encoding="utf-8")
    text = "\n".join([c_source(function), *defines, "", driver])
    source, prefix = with_unique_symbols(text, [function.name(), "simulate"])
    return source, f"{prefix}simulate"


def _pattern(name: str, sparsity: ca.Sparsity) -> list[str]:
    column, row = sparsity.get_ccs()
    return [
        f"#define {name}_NONZEROS {len(row)}",
        f"static const int {name}_COLUMN[] = {{{', '.join(map(str, column))}}};",
        # C has no empty arrays.
        f"static const int {name}_ROW[] = {{{', '.join(map(str, row or [0]))}}};",
    ]


# --- NumPy --------------------------------------------------------------------------------------


class VirtualStepper:
    """The same steps in NumPy; CasADi's virtual machine evaluates all runs of a batch at once."""

    def __init__(self, functions: Functions, *, sensitivities: bool) -> None:
        self._function = tangents(functions) if sensitivities else functions.dynamics
        self._rows = acceleration_rows(functions)
        self._evaluators: dict[int, Evaluator] = {}

    def advance(self, problem: Problem, first: int, last: int) -> None:
        with np.errstate(all="ignore"):
            for i in range(first, last):
                self._interval(problem, i)

    def _interval(self, problem: Problem, i: int) -> None:
        """From sample i to i + 1; runs with fewer steps than others wait, runs that diverged are NaN."""
        interval, count = problem.t[:, i + 1] - problem.t[:, i], problem.steps[:, i]
        x, s = problem.x[:, i].copy(), None if problem.s is None else problem.s[:, i].copy()
        h = interval / count
        for k in range(count.max()):
            running = (k < count) & np.isfinite(x).all(axis=1)
            x_new, s_new = self._step(problem, i, problem.t[:, i] + k * h, h, x, s)
            x = np.where(running[:, None], x_new, x)
            s = None if s is None else np.where(running[:, None, None], s_new, s)
        lost = ~np.isfinite(x).all(axis=1)
        x[lost] = np.nan
        problem.x[:, i + 1] = x
        if s is not None and problem.s is not None:
            s[lost] = np.nan
            problem.s[:, i + 1] = s

    def _step(
        self, problem: Problem, i: int, t: Array, h: Array, x: Array, s: Array | None
    ) -> tuple[Array, Array | None]:
        stage, z = x, s
        total = np.zeros_like(x)
        sum_ = None if s is None else np.zeros_like(s)
        h1, h2 = np.broadcast_to(h, len(x))[:, None], np.broadcast_to(h, len(x))[:, None, None]
        for reach, weight, ahead in ((0.0, 1, 0.5), (0.5, 2, 0.5), (0.5, 2, 1.0), (1.0, 1, 0.0)):
            f, dz = self._rates(stage, problem.u[:, i], problem.p, t + reach * h, z, problem.wrt)
            total += weight * f
            stage = x + (ahead * h1) * f
            if s is not None and sum_ is not None and dz is not None:
                sum_ += weight * dz
                z = s + (ahead * h2) * dz
        return x + h1 / 6 * total, None if s is None or sum_ is None else s + h2 / 6 * sum_

    def _rates(
        self, x: Array, u: Array, p: Array, t: Array, z: Array | None, wrt: Array
    ) -> tuple[Array, Array | None]:
        evaluator = self._evaluators.get(len(x))
        if evaluator is None:
            evaluator = self._evaluators[len(x)] = Evaluator(self._function, len(x))
        outputs = evaluator(x, u, p, t[:, None])
        f = outputs[0][:, :, 0]
        return f, None if z is None else self._tangent_rate(outputs[1:], z, wrt)

    def _tangent_rate(self, slopes: list[Array], z: Array, wrt: Array) -> Array:
        inverse, r_x, r_p = slopes
        rate = r_x @ z
        known = wrt >= 0
        rate[:, :, known] += r_p[:, :, wrt[known]]
        rate[:, self._rows] = inverse @ rate[:, self._rows]
        return rate
