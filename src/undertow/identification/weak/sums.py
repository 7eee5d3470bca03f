"""Sums over windows of samples and solutions of banded systems, in C where there is a compiler."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Protocol

import numpy as np
from scipy.linalg.lapack import dtbtrs

from undertow.codegen.cache import library_for
from undertow.codegen.compiler import Compiler, compiled_or_virtual
from undertow.codegen.driver import loaded, pointer
from undertow.codegen.source import EXPORTED, digest
from undertow.typing import Array, Index

from .entries import Entries
from .testfunctions import Windows

# Right-hand sides that go through an operation together.
_SIDE = 8
_NAMES = ("TESTED", "PRODUCTS", "SOLVED")


class _Windows(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("count", "width", "samples")),
        ("first", ctypes.c_void_p),
        ("weights", ctypes.c_void_p),
    )


class _Sums(Protocol):
    def tested(self, windows: Windows, part: Entries, kind: Index, target: Index, table: Array) -> None: ...

    def products(self, first: Index, felt: Array, bands: Array) -> None: ...

    def solved(self, factor: Array, right: Array) -> Array: ...


class SumsInC:
    """The sums in C."""

    def __init__(self, compiler: Compiler) -> None:
        source, prefix = sums_source()
        library = loaded(library_for(source, compiler.for_this_machine()))
        self._call = {n: getattr(library, prefix + n.lower()) for n in _NAMES}
        for entry in self._call.values():
            entry.restype = None

    def tested(self, windows: Windows, part: Entries, kind: Index, target: Index, table: Array) -> None:
        chosen = np.flatnonzero(target >= 0)
        runs = np.ascontiguousarray(_runs(chosen, kind))
        data = np.ascontiguousarray(part.data)
        count, width = windows.weights.shape[1:]
        first, places = (np.ascontiguousarray(a, dtype=np.int64) for a in (windows.first, target))
        sums = np.empty(data.shape[1])
        about = _Windows(count, width, windows.samples, first.ctypes.data, windows.weights.ctypes.data)
        self._call["TESTED"](
            ctypes.byref(about),
            ctypes.c_int64(data.shape[1]),
            pointer(data),
            ctypes.c_int64(len(runs)),
            pointer(runs),
            pointer(places),
            ctypes.c_int64(table[0].size),
            pointer(sums),
            pointer(table),
        )

    def products(self, first: Index, felt: Array, bands: Array) -> None:
        count, rows, width, channels = felt.shape
        sizes = map(ctypes.c_int64, (count, rows, width * channels, channels))
        begin = np.ascontiguousarray(first, dtype=np.int64)
        self._call["PRODUCTS"](*sizes, pointer(begin), pointer(felt), pointer(bands))

    def solved(self, factor: Array, right: Array) -> Array:
        columns = -(-right.shape[1] // _SIDE) * _SIDE
        found = np.zeros((len(right), columns))
        found[:, : right.shape[1]] = right
        by_column = np.ascontiguousarray(factor.T)
        sizes = map(ctypes.c_int64, (len(factor), len(right), columns))
        self._call["SOLVED"](*sizes, pointer(by_column), pointer(found))
        return found[:, : right.shape[1]]


class SumsInNumPy:
    """The same without a compiler."""

    def tested(self, windows: Windows, part: Entries, kind: Index, target: Index, table: Array) -> None:
        index, flat = windows.index, table.reshape(len(table), -1)
        for e in np.flatnonzero(target >= 0):
            weights = windows.weights[kind[e]]
            # What lies outside the support counts for nothing, whatever it is.
            flat[:, target[e]] += np.sum(np.where(weights == 0, 0.0, weights * part.data[index, e]), axis=1)

    def products(self, first: Index, felt: Array, bands: Array) -> None:
        count, rows, width, channels = felt.shape
        flat = felt.reshape(count, rows, width * channels)
        for apart in range(len(bands) // rows):
            blocks = _shifted_products(flat, first[apart:] - first[: count - apart], channels)
            for a in range(rows):
                for b in range(0 if apart else a, rows):
                    bands[apart * rows + b - a, a::rows][: count - apart] = blocks[:, b, a]

    def solved(self, factor: Array, right: Array) -> Array:
        solution, info = dtbtrs(factor, right, uplo="L")
        assert info == 0
        return np.asarray(solution)


def _shifted_products(flat: Array, shift: Index, channels: int) -> Array:
    """Blocks (rows, rows) between windows and those that begin `shift` samples before them."""
    apart = len(flat) - len(shift)
    blocks = np.zeros((len(shift), flat.shape[1], flat.shape[1]))
    for samples in np.unique(shift):
        far = int(samples) * channels
        if far >= flat.shape[2]:
            continue
        here = np.flatnonzero(shift == samples)
        later = flat[here + apart][:, :, : flat.shape[2] - far]
        blocks[here] = later @ flat[here][:, :, far:].swapaxes(1, 2)
    return blocks


@cache
def _sums() -> _Sums:
    def compiled(compiler: Compiler) -> _Sums:
        return SumsInC(compiler)

    return compiled_or_virtual(None, compiled, SumsInNumPy)


def sums_source() -> tuple[str, str]:
    """C source of the sums, and what the names of its entry points begin with: they carry its hash."""
    text = (files("undertow.identification.weak") / "sums.c").read_text(encoding="utf-8")
    prefix = f"undertow_{digest(EXPORTED + text)[:16]}_"
    names = [f"#define {n} {prefix}{n.lower()}" for n in _NAMES]
    return "\n".join([*names, EXPORTED, text]), prefix


def _runs(chosen: Index, kind: Index) -> Index:
    """Stretches of neighbours of one kind among the chosen signals: begin, end, kind."""
    if not len(chosen):
        return np.zeros((0, 3), dtype=np.int64)
    last = np.append((np.diff(chosen) > 1) | (np.diff(kind[chosen]) != 0), True)
    begin = chosen[np.concatenate([[True], last[:-1]])]
    return np.column_stack([begin, chosen[last] + 1, kind[begin]]).astype(np.int64)


def tested(
    windows: Windows, parts: Sequence[Entries], kind: Sequence[Index], target: Sequence[Index], size: int
) -> Array:
    """Sums over each window of weight times signal, gathered in the places that the signals belong to.

    Parameters
    ----------
    windows : Windows
        K windows over N samples.
    parts : sequence of Entries
        Signals.
    kind, target : sequences of arrays of int
        For every signal of every part which weights it meets, and its place; -1 for none.
    size : int
        Number of places.

    Returns
    -------
    (K, size) array
    """
    table = np.zeros((len(windows.first), size))
    for part, weights, places in zip(parts, kind, target, strict=True):
        _sums().tested(windows, part, weights, places, table)
    return table


def products(first: Index, felt: Array) -> Array:
    """Products of all pairs of rows whose windows overlap, in LAPACK's banded storage.

    Parameters
    ----------
    first : (K,) array of int
        First sample of every window, in ascending order.
    felt : (K, rows, W, channels) array
        Rows of every window.

    Returns
    -------
    (b, K rows) array
        Lower half, ordered by window, then by row.
    """
    count, rows, width, _ = felt.shape
    reach = int(np.max(np.searchsorted(first, first + width) - np.arange(count)))
    bands = np.zeros((reach * rows, count * rows))
    _sums().products(first, felt, bands)
    used = np.flatnonzero(np.any(bands, axis=1))
    return bands[: used[-1] + 1] if len(used) else bands[:1]


def solved(factor: Array, right: Array) -> Array:
    """Solution of L z = r for a lower factor in LAPACK's bands, shape (b, m), and r of shape (m, k)."""
    return _sums().solved(factor, np.asarray(right, dtype=float))
