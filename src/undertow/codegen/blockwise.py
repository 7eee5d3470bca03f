"""A function at many samples without compiling it: its instructions run over blocks of samples.

One library, compiled once for all models, is several times as fast as CasADi's virtual machine, which goes
through the instructions anew for every sample.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache, lru_cache

import casadi as ca
import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .cache import library_for
from .compiler import Compiler, compiled_or_virtual
from .driver import loaded
from .tape import Tape, tape_source

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
