"""CasADi functions at many samples: block by block in compiled code, or in chunks through their buffers."""

from __future__ import annotations

from functools import lru_cache

import casadi as ca
import numpy as np

from undertow.codegen.tape import blockwise
from undertow.typing import Array

# Making a map costs time in proportion to its length; one of this length serves segments of any length.
_CHUNK = 128


def mapped(function: ca.Function, columns: list[Array], p: Array, t: Array) -> list[Array]:
    """Values at N samples of `function(*columns, p, t)`, each (N, rows, columns); `columns` are (N, k).

    The function's outputs have to be dense.
    """
    flat = nonzeros(function, [*columns, p, t[:, None]], len(t))
    shapes = [function.size_out(i) for i in range(function.n_out())]
    # CasADi is column-major: a sample's matrix lies transposed in the flat result.
    return [f.reshape(len(t), c, r).transpose(0, 2, 1) for f, (r, c) in zip(flat, shapes, strict=True)]


def nonzeros(function: ca.Function, arguments: list[Array], count: int) -> list[Array]:
    """Structural nonzeros of the outputs at `count` samples, each of shape (count, nnz).

    Parameters
    ----------
    function : casadi.Function
        Function of one sample.
    arguments : list of arrays
        (count, k) for what differs from sample to sample, (k,) for what is the same for all.
    count : int
        Number of samples.
    """
    run = blockwise(function)
    return _in_chunks(function, arguments, count) if run is None else run(arguments, count)


def _in_chunks(function: ca.Function, arguments: list[Array], count: int) -> list[Array]:
    """The same by CasADi's virtual machine, where there is no compiler."""
    chunks = -(-count // _CHUNK)
    inputs = [_padded(a, chunks) if a.ndim > 1 else np.tile(a, (_CHUNK, 1)) for a in arguments]
    results = [np.zeros((chunks * _CHUNK, function.nnz_out(i))) for i in range(function.n_out())]
    buffer, evaluate = map_over(function, _CHUNK).buffer()
    for i, a in enumerate(inputs):
        if arguments[i].ndim == 1:
            buffer.set_arg(i, _view(a))
    for chunk in range(chunks):
        rows = slice(chunk * _CHUNK, (chunk + 1) * _CHUNK)
        for i, a in enumerate(inputs):
            if arguments[i].ndim > 1:
                buffer.set_arg(i, _view(a[rows]))
        for i, a in enumerate(results):
            buffer.set_res(i, _view(a[rows]))
        evaluate()
    return [a[:count] for a in results]


def _padded(column: Array, chunks: int) -> Array:
    """The samples, the last repeated until the last chunk is full."""
    missing = chunks * _CHUNK - len(column)
    table = np.concatenate([column, np.repeat(column[-1:], missing, axis=0)]) if missing else column
    return np.ascontiguousarray(table, dtype=float)


def _view(array: Array) -> memoryview:
    return memoryview(array.reshape(-1).data)


def call(function: ca.Function, arguments: list[Array]) -> list[Array]:
    """Call a function once through its buffers; arguments and results are flat, column-major, dense."""
    buffer, evaluate = function.buffer()
    inputs = [np.ascontiguousarray(a, dtype=float) for a in arguments]
    results = [np.zeros(function.nnz_out(i)) for i in range(function.n_out())]
    for i, array in enumerate(inputs):
        buffer.set_arg(i, _view(array))
    for i, array in enumerate(results):
        buffer.set_res(i, _view(array))
    evaluate()
    return results


@lru_cache(maxsize=256)
def map_over(function: ca.Function, count: int) -> ca.Function:
    """The function over `count` samples in one call; made once."""
    return function.map(count)
