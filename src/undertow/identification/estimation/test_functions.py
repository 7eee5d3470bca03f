"""Test functions of the weak form: cubic B-splines, quadrature, sums over windows and their noise."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib.resources import files

import casadi as ca
import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cholesky_banded
from scipy.linalg.lapack import dtbtrs
from scipy.sparse import csr_array, dia_array, diags_array, eye_array, kron, tril

from undertow.codegen.compiler import Compiler, compiled_or_virtual, library_for, loaded, pointer
from undertow.codegen.source import EXPORTED, with_entries
from undertow.typing import Array, Index


# --- the samples that a test function sees --------------------------------------------------------
@dataclass(frozen=True)
class Supports:
    """Supports of one width W for K test functions."""

    first: Index  # (K,) first sample of each window; none begins before the one in front of it
    samples: int  # Number of samples; a window may reach beyond the last one, with weights of zero
    weights: Array  # (kinds, K, W) weights of every kind

    @classmethod
    def of(cls, kinds: Sequence[csr_array]) -> Supports:
        """Supports around what every test function sees with any kind of weights (K, N)."""
        parts = [w.tocoo() for w in kinds]
        count, samples = kinds[0].shape
        first, last = np.full(count, samples - 1), np.zeros(count, dtype=np.intp)
        for part in parts:
            np.minimum.at(first, part.row, part.col)
            np.maximum.at(last, part.row, part.col)
        first = np.ascontiguousarray(np.minimum.accumulate(first[::-1])[::-1])
        width = max(int(np.max(last - first)), 0) + 1
        weights = np.zeros((len(parts), count, width))
        for kind, part in zip(weights, parts, strict=True):
            kind[part.row, part.col - first[part.row]] = part.data
        return cls(first, samples, weights)

    @classmethod
    def joined(cls, parts: Sequence[Supports]) -> Supports:
        """The windows of segments of which one follows the other."""
        if len(parts) == 1:
            return parts[0]
        width = max(p.weights.shape[2] for p in parts)
        wide = [np.pad(p.weights, ((0, 0), (0, 0), (0, width - p.weights.shape[2]))) for p in parts]
        before = np.cumsum([0, *(p.samples for p in parts)])
        first = np.concatenate([p.first + n for p, n in zip(parts, before, strict=False)])
        return cls(first, int(before[-1]), np.concatenate(wide, axis=1))

    def part(self, which: slice) -> Supports:
        """Some of the windows."""
        return Supports(self.first[which], self.samples, self.weights[:, which])

    @property
    def index(self) -> Index:
        """Sample at each place of each window, shape (K, W); beyond the last one, that one again."""
        return np.minimum(self.first[:, None] + np.arange(self.weights.shape[2]), self.samples - 1)


DEGREE = 3


@dataclass(frozen=True)
class SplineSettings:
    """How far apart the knots of test functions are, and how much of an operation is done at once."""

    # Samples between two knots: a few, so that all that the sampling resolves is used.
    samples_per_knot: int = 5
    sides_together: int = 8  # right-hand sides that go through an operation together
    rank_tolerance: float = 1e-9  # of moments of the samples under a function, relative
    # What is added to variances so that they can be factorised where a log has no noise, as a share of each
    # and of the largest: far below any noise that a sensor has.
    floor: float = 1e-10
    floor_of_largest: float = 1e-14


SETTINGS = SplineSettings()


@dataclass(frozen=True)
class TestFunctions:
    """Quadrature weights of K test functions phi over the N samples of a segment."""

    value: csr_array  # Weights for the integral of phi times a smooth signal
    rate: csr_array  # Weights for the integral of d(phi)/dt times a smooth signal
    # Integrals of phi over [t_i, t_i+1), for the mean of a signal over this interval; with `rate` they
    # give exactly zero for such a signal and its integral, whatever its jumps and the spacing of
    # samples
    held: csr_array
    centre: Array  # (K,) middle of each support, s

    __test__ = False  # not a pytest class

    @cached_property
    def supports(self) -> Supports:
        """The weights of value, rate and held, as windows."""
        return Supports.of([self.value, self.rate, self.held])

    @property
    def count(self) -> int:
        """Number of test functions."""
        return len(self.centre)


# Which of them a block of pointwise rows meets: velocity, acceleration, pose, pose rate, held acceleration.
_WEIGHTS_OF_BLOCK = np.array([1, 0, 1, 0, 2])


def weights_and_equation(row: Index, n: int) -> tuple[Index, Index]:
    """Kind of weights that each of the 5n pointwise rows meets, and the equation (of 2n) it is part of."""
    block = row // n
    return _WEIGHTS_OF_BLOCK[block], row % n + np.where((block == 2) | (block == 3), n, 0)


def knot_spacing(t: Array) -> float:
    """Spacing of knots for given times: a few samples, so that all that the sampling resolves is used."""
    return float(SETTINGS.samples_per_knot * np.median(np.diff(t)))


def test_functions(t: Array, spacing: float) -> TestFunctions | None:
    """B-splines, `spacing` s between knots, whose support lies in the segment; None if it is too short."""
    count = int((t[-1] - t[0]) / spacing + 1e-9) - DEGREE
    if count < 1:
        return None
    place = (t - t[0]) / spacing
    weight = _trapezoid(t)
    value = _banded(lambda s, i: _PHI(s) * weight[i], place, count)
    rate = _banded(lambda s, i: _PHI_RATE(s) * weight[i] / spacing, place, count)
    exact = _exact_for_cubics(value, place)
    rate = exact(rate, _RATE_MOMENTS)
    return TestFunctions(
        value=exact(value, spacing * _VALUE_MOMENTS),
        rate=rate,
        held=_held(rate, t),
        centre=t[0] + spacing * (np.arange(count) + (DEGREE + 1) / 2),
    )


test_functions.__test__ = False  # type: ignore[attr-defined]


def boxes(t: Array, spacing: float) -> TestFunctions | None:
    """Boxes of about `spacing` s, one from every sample on: with them the weak form is the integral form.

    A box has no derivative but a peak at either end, so that its residual is the change of velocity less the
    integral of the acceleration, of position less that of velocity. Boxes overlap; generalised least squares
    knows how they are correlated. Signals are integrated by the cubic through the four samples around each.
    """
    width = max(round(spacing / float(np.median(np.diff(t)))), 1)
    count = len(t) - width
    if count < 1 or len(t) < 4:
        return None
    first = np.repeat(np.arange(count), width)
    inside = csr_array((np.ones(count * width), (first, first + np.tile(np.arange(width), count))))
    inside.resize(count, len(t) - 1)
    step = np.diff(t)
    place = np.arange(count)
    ends = (np.concatenate([place, place]), np.concatenate([place, place + width]))
    jumps = np.repeat([1.0, -1.0], count)
    return TestFunctions(
        value=csr_array(inside @ _interval_integrals(t)),
        rate=csr_array((jumps, ends), shape=(count, len(t))),
        held=csr_array(
            (inside.data * step[inside.indices], inside.indices, inside.indptr), shape=(count, len(t))
        ),
        centre=(t[width:] + t[:count]) / 2,
    )


def _interval_integrals(t: Array) -> csr_array:
    """Weights for the integral from each sample to the next by the cubic through four, (N - 1, N)."""
    count = len(t) - 1
    first = np.clip(np.arange(count) - 1, 0, len(t) - 4)
    index = first[:, None] + np.arange(4)
    step = np.diff(t)[:, None]
    place = (t[index] - t[:-1, None]) / step
    moments = 1.0 / np.arange(1.0, 5.0)
    powers = np.swapaxes(place[:, :, None] ** np.arange(4), 1, 2)
    weight = np.linalg.solve(powers, np.broadcast_to(moments[:, None], (count, 4, 1)))[..., 0] * step
    rows = np.repeat(np.arange(count), 4)
    return csr_array((weight.ravel(), (rows, index.ravel())), shape=(count, len(t)))


_SUPPORT = np.arange(DEGREE + 2.0)
_PHI = BSpline.basis_element(_SUPPORT, extrapolate=False)
_PHI_RATE = _PHI.derivative()
# Integrals of phi and of its derivative times 1, s, s^2, s^3, with s counted in knots from the middle.
_VALUE_MOMENTS = np.array([1.0, 0.0, 1 / 3, 0.0])
_RATE_MOMENTS = np.array([0.0, -1.0, 0.0, -1.0])


def _banded(entry: Callable[[Array, Index], Array], place: Array, count: int) -> csr_array:
    """Sparse (count, N) matrix of entry(s, i), s = place_i - k, for samples in the support of k."""
    rows, columns, values = [], [], []
    first = np.floor(place).astype(np.intp)
    for offset in range(DEGREE + 1):
        k = first - offset
        index = np.flatnonzero((k >= 0) & (k < count))
        rows.append(k[index])
        columns.append(index)
        values.append(np.nan_to_num(entry(place[index] - k[index], index)))
    shape = (count, len(place))
    return csr_array((np.concatenate(values), (np.concatenate(rows), np.concatenate(columns))), shape=shape)


def _exact_for_cubics(near: csr_array, place: Array) -> Callable[[csr_array, Array], csr_array]:
    """Function that gives weights the right integrals of cubics (`moments`), by `near` times a cubic.

    Sums over even samples have them already. Over uneven ones not even a constant would integrate to zero
    with the derivative, and a position far from zero would drown all else.
    """
    at = near.tocoo()
    powers = (place[at.col] - at.row - (DEGREE + 1) / 2)[:, None] ** np.arange(2 * DEGREE + 1)

    def sums(data: Array, most: int) -> Array:
        return np.column_stack([np.bincount(at.row, data * s, near.shape[0]) for s in powers.T[: most + 1]])

    gram = sums(at.data, 2 * DEGREE)[:, np.add.outer(np.arange(DEGREE + 1), np.arange(DEGREE + 1))]
    inverse = np.linalg.pinv(gram, rcond=SETTINGS.rank_tolerance, hermitian=True)

    def exact(weights: csr_array, moments: Array) -> csr_array:
        cubic = np.einsum("kij,kj->ki", inverse, moments - sums(weights.data, DEGREE))
        change = at.data * np.sum(cubic[at.row] * powers[:, : DEGREE + 1], axis=1)
        return csr_array((weights.data + change, weights.indices, weights.indptr), shape=weights.shape)

    return exact


def _held(rate: csr_array, t: Array) -> csr_array:
    """Weights of interval means with which summation by parts is exact: the integral changes by mean times
    step from sample to sample, so that each step counts as much as all weights of `rate` up to it.
    """
    rate.sort_indices()
    begin = rate.indptr[:-1]
    total = np.cumsum(rate.data)
    earlier = np.concatenate([[0.0], total])[begin]
    total -= np.repeat(earlier, np.diff(rate.indptr))
    step = np.append(np.diff(t), 0.0)
    return csr_array((total * step[rate.indices], rate.indices, rate.indptr), shape=rate.shape)


def kink_delay(t: Array) -> Array:
    """How much later, s, than at its sample a signal with a kink has to be read for its quadrature to hold.

    Over even steps that is a twelfth of a step: of the jump of the slope, trapezoids miss h^2/12.
    """
    step = np.diff(t)
    before, after = np.append(step[:1], step), np.append(step, step[-1:])
    return np.asarray((before**2 + after**2) / (before + after) / 12)


def _trapezoid(t: Array) -> Array:
    weight = np.zeros_like(t)
    step = np.diff(t)
    weight[:-1] += step / 2
    weight[1:] += step / 2
    return weight


@dataclass(frozen=True)
class Entries:
    """Entries of a matrix at N samples."""

    row: Index  # (E,) place of every entry; the same place may occur more than once, its entries add up
    column: Index
    data: Array  # (N, E) values at the samples
    width: int  # Columns of the whole matrix

    @classmethod
    def of(cls, data: Array, pattern: ca.Sparsity, first: int) -> Entries:
        """Nonzeros of a CasADi matrix, its first column at `first`."""
        row, column = _places(pattern)
        return cls(row, first + column, data, first + pattern.size2())

    @classmethod
    def chained(cls, data: Array, pattern: ca.Sparsity, slope: Array, first: int) -> Entries:
        """Chain rule: nonzeros (rows by k) times `slope` (N, k, m), its first column at `first`."""
        row, through = _places(pattern)
        width = slope.shape[2]
        sensitivity = np.argwhere(np.any(slope, axis=0)) if slope.size else np.zeros((0, 2), dtype=np.intp)
        pairs = [(e, j) for i, j in sensitivity for e in np.flatnonzero(through == i)]
        table = np.empty((len(data), len(pairs)))
        for k, (e, j) in enumerate(pairs):
            np.multiply(data[:, e], slope[:, through[e], j], out=table[:, k])
        places = np.array(pairs, dtype=np.intp).reshape(-1, 2)
        return cls(row[places[:, 0]], first + places[:, 1], table, first + width)

    def moved_down(self, rows: int) -> Entries:
        """The same entries so many rows further down."""
        return replace(self, row=self.row + rows)


def _places(pattern: ca.Sparsity) -> tuple[Index, Index]:
    return np.array(pattern.row(), dtype=np.intp), np.array(pattern.get_col(), dtype=np.intp)


_NAMES = ("tested", "products", "solved")


class _Supports(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_int64) for name in ("count", "width", "samples")),
        ("first", ctypes.c_void_p),
        ("weights", ctypes.c_void_p),
    )


class SumsInC:
    """The sums in C."""

    def __init__(self, compiler: Compiler) -> None:
        source, prefix = sums_source()
        library = loaded(library_for(source, compiler.for_this_machine()))
        self._call = {n: getattr(library, prefix + n) for n in _NAMES}
        for entry in self._call.values():
            entry.restype = None

    def weighted(self, windows: Supports, part: Entries, kind: Index, target: Index, table: Array) -> None:
        chosen = np.flatnonzero(target >= 0)
        runs = np.ascontiguousarray(_adjacent_runs(chosen, kind))
        data = np.ascontiguousarray(part.data)
        count, width = windows.weights.shape[1:]
        first, places = (np.ascontiguousarray(a, dtype=np.int64) for a in (windows.first, target))
        sums = np.empty(data.shape[1])
        about = _Supports(count, width, windows.samples, first.ctypes.data, windows.weights.ctypes.data)
        self._call["tested"](
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

    def products(self, first: Index, sensitivity: Array, bands: Array) -> None:
        count, rows, width, channels = sensitivity.shape
        sizes = map(ctypes.c_int64, (count, rows, width * channels, channels))
        begin = np.ascontiguousarray(first, dtype=np.int64)
        self._call["products"](*sizes, pointer(begin), pointer(sensitivity), pointer(bands))

    def solved(self, factor: Array, right: Array) -> Array:
        together = SETTINGS.sides_together
        columns = -(-right.shape[1] // together) * together
        found = np.zeros((len(right), columns))
        found[:, : right.shape[1]] = right
        by_column = np.ascontiguousarray(factor.T)
        sizes = map(ctypes.c_int64, (len(factor), len(right), columns))
        self._call["solved"](*sizes, pointer(by_column), pointer(found))
        return found[:, : right.shape[1]]


class SumsInNumPy:
    """The same without a compiler."""

    def weighted(self, windows: Supports, part: Entries, kind: Index, target: Index, table: Array) -> None:
        index, flat = windows.index, table.reshape(len(table), -1)
        for e in np.flatnonzero(target >= 0):
            weights = windows.weights[kind[e]]
            # Samples outside the support have no weight, even if they are not finite.
            flat[:, target[e]] += np.sum(np.where(weights == 0, 0.0, weights * part.data[index, e]), axis=1)

    def products(self, first: Index, sensitivity: Array, bands: Array) -> None:
        count, rows, width, channels = sensitivity.shape
        flat = sensitivity.reshape(count, rows, width * channels)
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
def _sums() -> SumsInC | SumsInNumPy:
    return compiled_or_virtual(None, SumsInC, SumsInNumPy)


def sums_source() -> tuple[str, str]:
    """C source of the sums, and what the names of its entry points begin with: they carry its hash."""
    text = (files("undertow.identification.estimation") / "sums.c").read_text(encoding="utf-8")
    return with_entries(f"{EXPORTED}\n{text}", *_NAMES)


def _adjacent_runs(chosen: Index, kind: Index) -> Index:
    """Stretches of neighbours of one kind among the chosen signals: begin, end, kind."""
    if not len(chosen):
        return np.zeros((0, 3), dtype=np.int64)
    last = np.append((np.diff(chosen) > 1) | (np.diff(kind[chosen]) != 0), True)
    begin = chosen[np.concatenate([[True], last[:-1]])]
    return np.column_stack([begin, chosen[last] + 1, kind[begin]]).astype(np.int64)


def weighted_sums(
    windows: Supports, parts: Sequence[Entries], kind: Sequence[Index], target: Sequence[Index], size: int
) -> Array:
    """Sums over each of K windows of weight times signal, (K, size), gathered in the places of the signals.

    `kind` and `target` say for every signal of every part which weights it meets, and its place; -1 for none.
    """
    table = np.zeros((len(windows.first), size))
    for part, weights, places in zip(parts, kind, target, strict=True):
        _sums().weighted(windows, part, weights, places, table)
    return table


def products(first: Index, sensitivity: Array) -> Array:
    """Products of all pairs of rows (K, rows, W, channels) whose windows overlap, in LAPACK's lower bands.

    Ordered by window, then by row; `first` holds the first sample of every window, in ascending order.
    """
    count, rows, width, _ = sensitivity.shape
    reach = int(np.max(np.searchsorted(first, first + width) - np.arange(count)))
    bands = np.zeros((reach * rows, count * rows))
    _sums().products(first, sensitivity, bands)
    used = np.flatnonzero(np.any(bands, axis=1))
    return bands[: used[-1] + 1] if len(used) else bands[:1]


def solved(factor: Array, right: Array) -> Array:
    """Solution of L z = r for a lower factor in LAPACK's bands, shape (b, m), and r of shape (m, k)."""
    return _sums().solved(factor, np.asarray(right, dtype=float))


# --- noise of these sums ---------------------------------------------------------------------------
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


class Whitening:
    """Turns residuals into ones of unit variance, by a banded Cholesky factor.

    Rows are ordered by test function, then by equation. `covariance` (b, m) is that from the noise of the
    channels, and `overlap` (b, m) the products of test functions of one equation, the covariance of a white
    disturbance; lower halves in LAPACK's banded storage. `intensity` (m,) is that of the disturbance: the
    residual above the noise.
    """

    def __init__(self, covariance: Array, overlap: Array, intensity: Array) -> None:
        self._bands = covariance, overlap
        self._factorise(intensity)

    def _factorise(self, intensity: Array) -> None:
        """Cholesky factor with a disturbance."""
        measured, white = self._bands
        if not np.any(intensity):
            self._factor = _cholesky(measured)
            return
        spread, disturbance = np.sqrt(intensity), np.zeros_like(white)
        for offset, diagonal in enumerate(white):
            last = len(spread) - offset
            disturbance[offset, :last] = spread[offset:] * diagonal[:last] * spread[:last]
        self._factor = _cholesky(banded_sum(measured, disturbance))

    @cached_property
    def covariance(self) -> csr_array:
        """Covariance of the residual from the noise of the channels alone, in the order of its rows."""
        return unbanded(self._bands[0])

    def with_disturbance(self, intensity: Array) -> Whitening:
        """The same noise with another disturbance."""
        other = copy(self)
        other._factorise(intensity)
        return other

    def __call__(self, right: Array) -> Array:
        """Whitened residuals or Jacobian columns, shape (m,) or (m, k)."""
        table = np.asarray(right)
        return solved(self._factor, table.reshape(len(table), -1)).reshape(table.shape)

    def noise_sample(self, rng: np.random.Generator) -> Array:
        """Whitened channel noise alone: one draw, shape (m,)."""
        factor = _cholesky(self._bands[0])
        draw = np.asarray(rng.standard_normal(factor.shape[1]))
        return self(_times(factor, draw))


def _cholesky(bands: Array) -> Array:
    """Lower Cholesky factor of a banded matrix in LAPACK's banded storage."""
    banded = bands.copy()
    # A noise-free log has a singular covariance.
    banded[0] += SETTINGS.floor * banded[0] + SETTINGS.floor_of_largest * banded[0].max() + 1e-30
    return np.asarray(cholesky_banded(banded, lower=True, check_finite=False))


def _times(factor: Array, vector: Array) -> Array:
    """Product of a lower banded factor and a vector."""
    size = factor.shape[1]
    result = np.zeros(size)
    for offset, diagonal in enumerate(factor):
        result[offset:] += diagonal[: size - offset] * vector[: size - offset]
    return result


def overlap(functions: TestFunctions, t: Array, equations: int) -> Array:
    """Covariance of the weak residual under a white disturbance of unit intensity, in bands."""
    step = np.append(np.diff(t), 1.0)
    gram = functions.held @ diags_array(1.0 / step) @ functions.held.T
    return banded(csr_array(kron(gram, eye_array(equations))))
