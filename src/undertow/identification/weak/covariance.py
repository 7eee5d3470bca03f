"""Covariance of the weak residual from the noise of the channels: windows of samples, products in bands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, dia_array, tril

from .entries import Entries
from .testfunctions import TestFunctions

Array = NDArray[np.float64]
Index = NDArray[np.intp]
# Which test weights (value, rate, held) a block of pointwise rows meets.
_WEIGHTS = (1, 0, 1, 0, 2)


@dataclass(frozen=True)
class _Windows:
    """The samples that each of K test functions sees, as dense windows of one width W.

    Attributes
    ----------
    first : (K,) array of int
        First sample of each window; none begins before the one in front of it.
    index : (K, W) array of int
        Samples; beyond the last one, that one again, with weights of zero.
    weights : tuple of three (K, W) arrays
        Weights of value, rate and held.
    """

    first: Index
    index: Index
    weights: tuple[Array, ...]

    @classmethod
    def of(cls, functions: TestFunctions) -> _Windows:
        parts = [w.tocoo() for w in (functions.value, functions.rate, functions.held)]
        samples = functions.value.shape[1]
        first = np.full(functions.count, samples - 1)
        last = np.zeros(functions.count, dtype=np.intp)
        for part in parts:
            np.minimum.at(first, part.row, part.col)
            np.maximum.at(last, part.row, part.col)
        first = np.minimum.accumulate(first[::-1])[::-1]
        width = max(int(np.max(last - first)), 0) + 1
        dense = []
        for part in parts:
            table = np.zeros((functions.count, width))
            table[part.row, part.col - first[part.row]] = part.data
            dense.append(table)
        index = np.minimum(first[:, None] + np.arange(width), samples - 1)
        return cls(first, index, tuple(dense))


def residual_covariance(
    functions: TestFunctions,
    slopes: Entries,
    sigma: Array,
    rows: Sequence[int],
    derived: Sequence[int] = (),
    t: Array | None = None,
) -> Array:
    """Covariance of the weak residual from noise on the measured channels.

    Parameters
    ----------
    functions : TestFunctions
        K test functions over N samples.
    slopes : Entries
        Derivative of the 5n pointwise rows in the 2n measured poses and velocities, at the samples.
    sigma : (2n,) or (N, 2n) array
        Standard deviations of the measured channels, the same at all samples or not.
    rows : sequence of int
        Equations that are used, among the 2n (forces first, then kinematics).
    derived : sequence of int
        Channels that are the time derivative of a pose: their noise is that of the pose, differentiated.
    t : (N,) array, optional
        Time of the samples, s; needed with `derived`.

    Returns
    -------
    (b, K len(rows)) array
        Its lower half in LAPACK's banded storage, ordered by test function, then by equation.
    """
    n, windows = sigma.shape[-1] // 2, _Windows.of(functions)
    # The noise of a rate is that of its pose.
    direct = {c: sigma[..., c] for c in range(2 * n) if c not in derived}
    bands = _products(windows.first, _felt(windows, _by_equation(slopes, n), rows, direct))
    if derived and t is not None:
        levels = {c: sigma[..., c - n] for c in derived}
        rates = _differenced(_felt(windows, _by_equation(slopes, n), rows, levels), windows, t)
        bands = banded_sum(bands, _products(windows.first - 1, rates))
    return bands


def _by_equation(slopes: Entries, n: int) -> list[tuple[int, int, int, Array]]:
    """Which weights, equation and channel each entry belongs to, and its values at the samples."""
    block = slopes.row // n
    equation = slopes.row % n + np.where((block == 2) | (block == 3), n, 0)
    weights = [_WEIGHTS[b] for b in block]
    return list(zip(weights, equation, slopes.column, np.ascontiguousarray(slopes.data.T), strict=True))


def _felt(
    windows: _Windows,
    entries: list[tuple[int, int, int, Array]],
    rows: Sequence[int],
    levels: Mapping[int, Array],
) -> Array:
    """What each row feels of a unit of each channel's noise at each sample, (K, rows, W, channels)."""
    row, channel = ({x: i for i, x in enumerate(them)} for them in (rows, levels))
    table = np.zeros((len(row), len(channel), *windows.index.shape))
    for weights, i, j, values in entries:
        if i in row and j in channel:
            table[row[i], channel[j]] += windows.weights[weights] * values[windows.index]
    for j, level in levels.items():
        known = np.where(level > 0, level, 0.0)
        table[:, channel[j]] *= known[windows.index] if known.ndim else known
    return np.ascontiguousarray(table.transpose(2, 0, 3, 1))


def _differenced(felt: Array, windows: _Windows, t: Array) -> Array:
    """What is felt of a pose whose central differences are felt like this; windows begin a sample earlier."""
    count = len(t)
    after, before = np.minimum(np.arange(count) + 1, count - 1), np.maximum(np.arange(count) - 1, 0)
    step = 1.0 / (t[after] - t[before])
    rate = felt * step[windows.index][:, None, :, None]
    # At its ends a log has no sample on the other side: the one there stands for it.
    first, last = (np.where(windows.index == end, 1.0, 0.0)[:, None, :, None] for end in (0, count - 1))
    size = list(rate.shape)
    size[2] += 2
    total = np.zeros(size)
    total[:, :, 2:] += rate * (1.0 - last)
    total[:, :, 1:-1] += rate * (last - first)
    total[:, :, :-2] -= rate * (1.0 - first)
    return total


def _products(first: Index, felt: Array) -> Array:
    """Products of all pairs of rows whose windows overlap, in LAPACK's banded storage."""
    count, rows, width, channels = felt.shape
    flat = felt.reshape(count, rows, width * channels)
    reach = int(np.max(np.searchsorted(first, first + width) - np.arange(count))) - 1
    bands = np.zeros(((reach + 1) * rows, count * rows))
    for apart in range(reach + 1):
        blocks = _shifted_products(flat, first[apart:] - first[: count - apart], channels)
        for a in range(rows):
            for b in range(0 if apart else a, rows):
                bands[apart * rows + b - a, a::rows][: count - apart] = blocks[:, b, a]
    felt_at_all = np.flatnonzero(np.any(bands, axis=1))
    return bands[: felt_at_all[-1] + 1] if len(felt_at_all) else bands[:1]


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


def banded(matrix: csr_array) -> Array:
    """Lower half of a symmetric banded matrix in LAPACK's storage: a row for each diagonal."""
    coordinates = matrix.tocoo()
    offset = coordinates.row - coordinates.col
    bands = np.zeros((int(np.max(offset, initial=0)) + 1, matrix.shape[0]))
    lower = offset >= 0
    bands[offset[lower], coordinates.col[lower]] = coordinates.data[lower]
    return bands


def banded_sum(one: Array, other: Array) -> Array:
    """Sum of two symmetric banded matrices in LAPACK's storage."""
    total = np.zeros((max(len(one), len(other)), one.shape[1]))
    total[: len(one)] = one
    total[: len(other)] += other
    return total


def unbanded(bands: Array) -> csr_array:
    """The whole symmetric matrix of LAPACK's banded storage."""
    size = bands.shape[1]
    lower = dia_array((bands, -np.arange(len(bands))), shape=(size, size)).tocsr()
    lower.eliminate_zeros()
    return csr_array(lower + tril(lower, -1).T)
