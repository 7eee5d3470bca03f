"""Covariance of the weak residual from the noise of the channels: windows of samples, products in bands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.sparse import csr_array, dia_array, tril

from undertow.typing import Array, Index

from .entries import Entries
from .sums import products
from .testfunctions import TestFunctions, Windows, meeting

# What rows feel is laid out for as many windows at a time as fit in this.
_BYTES = 32_000_000


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
    n, entries = sigma.shape[-1] // 2, _by_equation(slopes, sigma.shape[-1] // 2)
    # The noise of a rate is that of its pose.
    direct = {c: sigma[..., c] for c in range(2 * n) if c not in derived}
    bands = _in_pieces(functions.windows, rows, direct, lambda w: (w.first, _felt(w, entries, rows, direct)))
    if derived and t is not None:
        levels = {c: sigma[..., c - n] for c in derived}
        rates = _in_pieces(
            functions.windows,
            rows,
            levels,
            lambda w: (w.first - 1, _differenced(_felt(w, entries, rows, levels), w, t)),
        )
        bands = banded_sum(bands, rates)
    return bands


def _in_pieces(
    windows: Windows,
    rows: Sequence[int],
    levels: Mapping[int, Array],
    felt: Callable[[Windows], tuple[Index, Array]],
) -> Array:
    """Products of the rows of all windows, a few windows and those that they overlap at a time."""
    count, width = windows.weights.shape[1:]
    each = 8 * len(rows) * (width + 2) * max(len(levels), 1)
    reach = int(np.max(np.searchsorted(windows.first, windows.first + width + 2) - np.arange(count)))
    piece = max(_BYTES // each - reach, reach)
    found = []
    for begin in range(0, count, piece):
        bands = products(*felt(windows.part(slice(begin, begin + piece + reach))))
        found.append(bands[:, : len(rows) * piece])
    deepest = max(map(len, found))
    return np.hstack([np.pad(bands, ((0, deepest - len(bands)), (0, 0))) for bands in found])


def _by_equation(slopes: Entries, n: int) -> list[tuple[int, int, int, Array]]:
    """Which weights, equation and channel each entry belongs to, and its values at the samples."""
    kind, equation = meeting(slopes.row, n)
    return list(zip(kind, equation, slopes.column, np.ascontiguousarray(slopes.data.T), strict=True))


def _felt(
    windows: Windows,
    entries: list[tuple[int, int, int, Array]],
    rows: Sequence[int],
    levels: Mapping[int, Array],
) -> Array:
    """What each row feels of a unit of each channel's noise at each sample, (K, rows, W, channels)."""
    row, channel = ({x: i for i, x in enumerate(them)} for them in (rows, levels))
    index = windows.index
    table = np.zeros((len(row), len(channel), *index.shape))
    for kind, i, j, values in entries:
        if i in row and j in channel:
            weights = windows.weights[kind]
            table[row[i], channel[j]] += np.where(weights == 0, 0.0, weights * values[index])
    for j, level in levels.items():
        known = np.where(level > 0, level, 0.0)
        table[:, channel[j]] *= known[index] if known.ndim else known
    return np.ascontiguousarray(table.transpose(2, 0, 3, 1))


def _differenced(felt: Array, windows: Windows, t: Array) -> Array:
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
