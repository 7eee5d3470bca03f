"""The instructions of a CasADi function as data for a library that is the same for all models."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from typing import Any

import casadi as ca
import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .compiler import Bound, Compiler, compiled_or_virtual, library_for, loaded, pointer
from .source import INSTRUCTIONS, engine_file, engine_source

# Making a map costs time in proportion to its length; one of this length serves any number of samples.
_CHUNK = 128
_NUMBER = {code: INSTRUCTIONS[name] for name, code in vars(ca).items() if name in INSTRUCTIONS}


class TapeData(ctypes.Structure):
    """A tape as tape.c takes it."""

    _fields_ = (
        ("length", ctypes.c_int64),
        ("slots", ctypes.c_int64),
        ("code", ctypes.c_void_p),
        ("constants", ctypes.c_void_p),
    )


class Tape:
    """The instructions of a CasADi function of scalars, ready to run.

    Compiled code is given `data`, which points into this object: that has to live as long.
    """

    def __init__(self, function: ca.Function) -> None:
        count = function.n_instructions()
        self._code = np.zeros((count, 4), dtype=np.int32)
        self._constants = np.zeros(count)
        for k in range(count):
            operation = function.instruction_id(k)
            if operation not in _NUMBER:
                raise UndertowError(
                    f"operation {operation} of a model has no counterpart in C: restate the effect"
                )
            self._set(k, operation, function.instruction_output(k), function.instruction_input(k))
            if operation == ca.OP_CONST:
                self._constants[k] = function.instruction_constant(k)
        self.slots = function.sz_w() + 1
        self.data = TapeData(count, self.slots, self._code.ctypes.data, self._constants.ctypes.data)

    def _set(self, k: int, operation: int, into: list[int], operands: list[int]) -> None:
        if operation == ca.OP_OUTPUT:  # from a register to an entry of an output
            self._code[k] = _NUMBER[operation], into[0], operands[0], into[1]
        else:
            self._code[k, :2] = _NUMBER[operation], into[0]
            self._code[k, 2 : 2 + len(operands)] = operands


# --- the library ----------------------------------------------------------------------------------
class Engine:
    """Entry points of the library that runs tapes."""

    def __init__(self, library: ctypes.CDLL, prefix: str) -> None:
        self.at_samples: Callable[..., int] = _entry(library, f"{prefix}at_samples", ctypes.c_int)
        self.carry: Callable[..., int] = _entry(library, f"{prefix}carry", ctypes.c_int)
        self.simulate: Callable[..., int] = _entry(library, f"{prefix}simulate", ctypes.c_int64)


def _entry(library: ctypes.CDLL, name: str, result: Any) -> Callable[..., int]:
    entry = getattr(library, name)
    entry.restype = result
    return entry


def engine() -> Engine | None:
    """The engine, compiled once for all models, or that of the wheel; None where there is neither."""

    def compiled(compiler: Compiler) -> Engine | None:
        return _compiled(compiler.for_this_machine())

    return compiled_or_virtual(None, compiled, _prebuilt)


@cache
def _compiled(compiler: Compiler) -> Engine:
    source, prefix = engine_source()
    return Engine(loaded(library_for(source, compiler)), prefix)


@cache
def _prebuilt() -> Engine | None:
    """The engine that the wheel brings along, if that is of this version and for this machine."""
    if not engine_file().is_file():
        return None
    try:
        return Engine(loaded(engine_file()), engine_source()[1])
    except (UndertowError, AttributeError):
        return None


# --- a function at many samples -------------------------------------------------------------------
class Blockwise:
    """A CasADi function of scalars, run over blocks of samples: several times as fast as sample by sample."""

    def __init__(self, function: ca.Function, run: Engine) -> None:
        self._engine, self._tape = run, Tape(function)
        self._outputs = [function.nnz_out(i) for i in range(function.n_out())]

    def __call__(self, arguments: Sequence[Array], count: int) -> list[Array]:
        """Structural nonzeros of the outputs at `count` samples, each of shape (count, nnz)."""
        inputs = [np.ascontiguousarray(a, dtype=float) for a in arguments]
        assert all(a.ndim == 1 or len(a) == count for a in inputs)
        results = [np.zeros((count, size)) for size in self._outputs]
        strides = [a.shape[1] if a.ndim > 1 else 0 for a in inputs]
        failed = self._engine.at_samples(
            ctypes.c_int64(count),
            ctypes.byref(self._tape.data),
            *_table(inputs, strides),
            *_table(results, self._outputs),
        )
        self._check(failed)
        return results

    def carry(self, state: Array, arguments: Sequence[Array]) -> None:
        """Fill in a state (steps + 1, chains, n) from its first row; arguments are (steps, chains, k)."""
        whole = ((a, a.shape[2] < 2 or a.strides[2] == a.itemsize) for a in (state[:-1], *arguments))
        inputs = [a if together else a.copy() for a, together in whole]
        strides = [[a.strides[axis] // a.itemsize for a in inputs] for axis in (1, 0)]
        failed = self._engine.carry(
            *map(ctypes.c_int64, arguments[0].shape[:2]),
            ctypes.byref(self._tape.data),
            ctypes.c_int64(len(inputs)),
            *_table(inputs, strides[0]),
            (ctypes.c_int64 * len(inputs))(*strides[1]),
            pointer(state),
            ctypes.c_int64(state.shape[2]),
        )
        self._check(failed)

    def _check(self, failed: int) -> None:
        if failed:
            raise UndertowError(
                f"no memory for {self._tape.slots} registers of a block of samples: close other programs"
            )


def _table(arrays: Sequence[Array], strides: Sequence[int]) -> tuple[ctypes.Array, ctypes.Array]:
    """Addresses of arrays, and the distances from sample to sample in them."""
    addresses = (ctypes.c_void_p * len(arrays))(*(a.ctypes.data for a in arrays))
    return addresses, (ctypes.c_int64 * len(strides))(*strides)


@lru_cache(maxsize=256)
def blockwise(function: ca.Function) -> Blockwise | None:
    """The function block by block; None where there is no engine, or where it is no function of scalars."""
    if not function.is_a("SXFunction"):
        return None
    run = engine()
    return None if run is None else Blockwise(function, run)


def at_samples(function: ca.Function, arguments: Sequence[Array], count: int) -> list[Array]:
    """Structural nonzeros of the outputs of a function at `count` samples, each of shape (count, nnz).

    Arguments are (count, k) where they differ from sample to sample, (k,) where they are the same for all.
    """
    run = blockwise(function)
    return _in_chunks(function, arguments, count) if run is None else run(arguments, count)


def carried(function: ca.Function, start: Array, arguments: Sequence[Array], steps: int) -> Array:
    """All states of `state = function(state, *arguments)` from a start (chains, n), (steps + 1, chains, n).

    Arguments are as (steps, chains, k), where they are not the same in all steps or chains.
    """
    state = np.empty((steps + 1, *start.shape))
    state[0] = start
    every = [np.broadcast_to(np.asarray(a, dtype=float), (steps, len(start), a.shape[-1])) for a in arguments]
    run = blockwise(function)
    if run is not None:
        run.carry(state, every)
        return state
    for i, begin in enumerate(start if steps else ()):
        (flat,) = call(_accumulated(function, steps), [begin, *(a[:, i] for a in every)])
        state[1:, i] = flat.reshape(steps, -1)
    return state


@lru_cache(maxsize=64)
def _accumulated(function: ca.Function, steps: int) -> ca.Function:
    return function.mapaccum("accumulated", steps)


def mapped(function: ca.Function, columns: Sequence[Array], p: Array, t: Array) -> list[Array]:
    """Values at N samples of `function(*columns, p, t)`, each (N, rows, columns); `columns` are (N, k).

    The function's outputs have to be dense.
    """
    flat = at_samples(function, [*columns, p, t[:, None]], len(t))
    shapes = [function.size_out(i) for i in range(function.n_out())]
    # CasADi is column-major: a sample's matrix lies transposed in the flat result.
    return [f.reshape(len(t), c, r).transpose(0, 2, 1) for f, (r, c) in zip(flat, shapes, strict=True)]


# --- by the virtual machine -----------------------------------------------------------------------
def _in_chunks(function: ca.Function, arguments: Sequence[Array], count: int) -> list[Array]:
    """What `at_samples` gives."""
    bound = Bound(function, _CHUNK)
    results = [np.zeros((count, a.shape[1])) for a in bound.outputs]
    for first in range(0, count, _CHUNK):
        here = min(_CHUNK, count - first)
        for array, given in zip(bound.inputs, arguments, strict=True):
            array[:here] = given[first : first + here] if given.ndim > 1 else given
        bound.run()
        for result, array in zip(results, bound.outputs, strict=True):
            result[first : first + here] = array[:here]
    return results


def call(function: ca.Function, arguments: Sequence[Array]) -> list[Array]:
    """Call a function once; arguments and results are flat, column-major, dense."""
    bound = Bound(function)
    for array, given in zip(bound.inputs, arguments, strict=True):
        array[0] = np.ravel(given)
    bound.run()
    return [array[0] for array in bound.outputs]
