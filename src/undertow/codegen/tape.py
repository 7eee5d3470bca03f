"""The instructions of a CasADi function as data for compiled loops, without compiling the function."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache, lru_cache
from importlib.resources import files

import casadi as ca
import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .cache import library_for
from .compiler import Compiler, compiled_or_virtual
from .driver import loaded
from .plain import operation_forms
from .source import EXPORTED, with_entry

_SPECIAL = {"INPUT": ca.OP_INPUT, "OUTPUT": ca.OP_OUTPUT, "CONSTANT": ca.OP_CONST}


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

    Parameters
    ----------
    function : casadi.Function
        An SX function.

    Attributes
    ----------
    slots : int
        Number of registers.
    data : TapeData
        What compiled code is given; it points into this object, which has to live as long.

    Raises
    ------
    UndertowError
        If the function has an operation that C lacks.
    """

    def __init__(self, function: ca.Function) -> None:
        known = {*operation_forms(), *_SPECIAL.values(), ca.OP_ASSIGN}
        count = function.n_instructions()
        self._code = np.zeros((count, 4), dtype=np.int32)
        self._constants = np.zeros(count)
        for k in range(count):
            operation = function.instruction_id(k)
            if operation not in known:
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
            self._code[k] = operation, into[0], operands[0], into[1]
        else:
            self._code[k, :2] = operation, into[0]
            self._code[k, 2 : 2 + len(operands)] = operands


def tape_source(loop: str, macro: str, ending: str, block: int, *others: str) -> tuple[str, str]:
    """C source of a loop over tapes, and the name of its entry point, which carries the hash of the source.

    Parameters
    ----------
    loop : str
        File with the loop.
    macro, ending : str
        What the loop calls its entry point, and how the entry point's name ends.
    block : int
        Samples that go through an instruction side by side.
    *others : str
        Lines that stand before all.
    """
    defines = [f"#define {name} {code}" for name, code in {"BLOCK": block, **_SPECIAL}.items()]
    forms = {ca.OP_ASSIGN: "{0}", **operation_forms()}
    cases = " ".join(
        f"case {code}: for (int l = 0; l < BLOCK; l++) r[l] = {form.format('a[l]', 'b[l]')}; break;"
        for code, form in forms.items()
    )
    folder = files("undertow.codegen")
    parts = [(folder / name).read_text(encoding="utf-8") for name in ("tape.c", loop)]
    return with_entry(
        "\n".join([*defines, *others, EXPORTED, f"#define CASES {cases}", *parts]), macro, ending
    )


# --- the tape over blocks of samples --------------------------------------------------------------
# One library, compiled once for all models, is several times as fast as CasADi's virtual machine, which goes
# through the instructions anew for every sample.
# Samples in a block: the registers of a large model (a thousand) stay in the second-level cache.
_BLOCK = 64


class Blockwise:
    """A CasADi function of scalars, its instructions ready to run.

    Parameters
    ----------
    function : casadi.Function
        An SX function.
    run : ctypes function
        The compiled loop.

    Raises
    ------
    UndertowError
        If the function has an operation that C lacks.
    """

    def __init__(self, function: ca.Function, run: Callable[..., int]) -> None:
        self._run, self._tape = run, Tape(function)
        self._outputs = [function.nnz_out(i) for i in range(function.n_out())]

    def __call__(self, arguments: Sequence[Array], count: int) -> list[Array]:
        """Structural nonzeros of the outputs at `count` samples, each of shape (count, nnz).

        Parameters
        ----------
        arguments : sequence of ndarray
            (count, k) for what differs from sample to sample, (k,) for what is the same for all.
        count : int
            Number of samples.

        Raises
        ------
        UndertowError
            If there is no memory.
        """
        inputs = [np.ascontiguousarray(a, dtype=float) for a in arguments]
        assert all(a.ndim == 1 or len(a) == count for a in inputs)
        results = [np.zeros((count, size)) for size in self._outputs]
        strides = [a.shape[1] if a.ndim > 1 else 0 for a in inputs]
        failed = self._run(
            ctypes.c_int64(count),
            ctypes.byref(self._tape.data),
            *_table(inputs, strides),
            *_table(results, self._outputs),
        )
        if failed:
            raise UndertowError(
                f"no memory for {self._tape.slots} registers of {_BLOCK} samples: close other programs"
            )
        return results


def _table(arrays: Sequence[Array], strides: Sequence[int]) -> tuple[ctypes.Array, ctypes.Array]:
    """Addresses of arrays, and the distances from sample to sample in them."""
    addresses = (ctypes.c_void_p * len(arrays))(*(a.ctypes.data for a in arrays))
    return addresses, (ctypes.c_int64 * len(strides))(*strides)


@lru_cache(maxsize=256)
def blockwise(function: ca.Function) -> Blockwise | None:
    """The function block by block; None where there is no compiler, or where it is no function of scalars."""
    if not function.is_a("SXFunction"):
        return None
    run = compiled_or_virtual(None, _compiled, lambda: None)
    return None if run is None else Blockwise(function, run)


@cache
def _compiled(compiler: Compiler) -> Callable[..., int]:
    source, name = loop_source()
    run = getattr(loaded(library_for(source, compiler)), name)
    run.restype = ctypes.c_int
    return run


def loop_source() -> tuple[str, str]:
    """C source of the loop, and the name of its entry point."""
    return tape_source("blockwise.c", "RUN", "blockwise", _BLOCK)
