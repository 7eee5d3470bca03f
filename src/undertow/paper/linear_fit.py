"""Least squares on a model that is linear in its parameters, in one pass where that is safe."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from undertow.codegen.compiler import compiled_or_virtual
from undertow.codegen.functions import Functions
from undertow.codegen.gram import CompiledRows, RowSource, Sums, VirtualRows, layout
from undertow.errors import UndertowError
from undertow.typing import Array

Samples = Mapping[str, Array]
PLAIN = 300.0
"""Condition number of the scaled regressor up to which normal equations are good to 1e-10."""
REFINED = 1e6
"""The same up to which one or two corrections mend them."""
_CORRECTIONS = 5
# What a correction leaves of the one before, at most; and one after which the next would not matter.
_FALL = 0.1
_SETTLED = 1e-9
# Samples in a block of rows, which then has less than a quarter of a megabyte for six rows of thirty.
_BLOCK = 128


@dataclass(frozen=True)
class LinearSolution:
    """Estimates of least squares.

    Attributes
    ----------
    names : tuple of str
        Parameters.
    theta : (k,) array
        Their estimates, SI.
    factor : (k, k) array
        Upper triangular; factor' factor = H' W H.
    squares : float
        Weighted sum of squares of what is left.
    count : int
        Samples that were taken in.
    condition : float
        Condition number of the regressor with its columns scaled to unit length.
    way : str
        "normal", "refined" or "triangular".
    """

    names: tuple[str, ...]
    theta: Array
    factor: Array
    squares: float
    count: int
    condition: float
    way: Literal["normal", "refined", "triangular"]


class LinearFit:
    """Least squares on H theta = target, the rows of a model at the samples of logs.

    Parameters
    ----------
    functions : Functions
        The model.
    names : sequence of str
        Parameters that are sought; they have to enter linearly.
    compiled : bool, optional
        As for `Simulator`.

    Attributes
    ----------
    needed : tuple of str
        Channels that the rows depend on: states, accelerations ("u_dot"), commands, "t".

    Raises
    ------
    UndertowError
        If a parameter does not enter linearly.
    """

    def __init__(self, functions: Functions, names: Sequence[str], *, compiled: bool | None = None) -> None:
        self.names = tuple(names)
        self._places = [functions.parameter_names.index(n) for n in names]
        self._p = np.array(functions.values(), dtype=float)
        self._layout = rows = layout(functions, self._places)
        vehicle = functions.vehicle
        rates = (f"{n}_dot" for n in vehicle.velocity_names)
        inputs = (*functions.state_names, *rates, *vehicle.command_names, "t")
        self.needed = tuple(inputs[i] for i in rows.needed)
        self._rows: RowSource = compiled_or_virtual(
            compiled, lambda c: _source(CompiledRows(rows, c)), lambda: _source(VirtualRows(rows))
        )

    def solve(
        self, logs: Sequence[Samples], weights: Sequence[Array] | Array | None = None
    ) -> LinearSolution:
        """Estimates from the samples of all logs; samples with a gap in what is needed do not count.

        Parameters
        ----------
        logs : sequence of mapping
            Columns of each log by name, (n,) each; they are read in place, two or more times where the
            regressor is ill conditioned.
        weights : array of shape (dof,), or one of shape (dof, n) for each log, optional
            Weight of the square of every row's residual.

        Raises
        ------
        UndertowError
            If a channel is missing, a weight is negative, or the samples leave a parameter open.
        """
        parts = [self._part(log, _weights_of(weights, i)) for i, log in enumerate(logs)]
        k = len(self.names)
        sums = Sums(np.zeros((k + 1, k + 1)))
        for columns, factors in parts:
            self._rows.gram(columns, self._p, factors, sums)
        factor = _cholesky(sums.total)
        condition = np.inf if factor is None else _condition(factor[:, :-1])
        if factor is not None and condition <= PLAIN and _condition(factor) <= PLAIN:
            return self._solution(factor, sums.count, "normal")
        if factor is not None and condition <= REFINED:
            found = self._refined(factor, parts, sums.count)
            if found is not None:
                return found
        return self._solution(*self._triangle(parts), "triangular")

    def triangle(self, samples: Samples, weights: Array | None = None) -> tuple[Array, int]:
        """Few rows with the same products as those of all samples, shape (k + 1, k + 1), and their count.

        The last column is that of the target. The factor is good to 1e-10 whatever the condition.

        Raises
        ------
        UndertowError
            If a channel is missing or a weight is negative.
        """
        part = self._part(samples, weights)
        sums = Sums(np.zeros((len(self.names) + 1, len(self.names) + 1)))
        self._rows.gram(part[0], self._p, part[1], sums)
        factor = _cholesky(sums.total)
        if factor is not None and _condition(factor) <= PLAIN:
            return factor, sums.count
        return self._triangle([part])

    def _part(self, samples: Samples, weights: Array | None) -> tuple[list[Array], list[Array] | None]:
        missing = [n for n in self.needed if n not in samples]
        if missing:
            raise UndertowError(f"the samples lack channel '{missing[0]}', which the rows depend on: add it")
        columns = [np.ascontiguousarray(samples[n], dtype=float) for n in self.needed]
        count = len(columns[0]) if columns else 0
        if any(c.shape != (count,) for c in columns):
            raise UndertowError(f"the columns {', '.join(self.needed)} differ in length: give equal ones")
        return columns, None if weights is None else self._factors(weights, count)

    def _factors(self, weights: Array, count: int) -> list[Array]:
        table = np.ascontiguousarray(weights, dtype=float)
        table = table[:, None] if table.ndim == 1 else table
        degrees = self._layout.degrees
        if table.shape not in ((degrees, 1), (degrees, count)):
            raise UndertowError(
                f"weights have shape {np.shape(weights)}: give ({degrees},) or ({degrees}, {count})"
            )
        if table.size and not (table.min() >= 0 and table.max() < np.inf):
            raise UndertowError("a weight is negative or not finite: give weights of squares, from zero on")
        return list(table)

    def _refined(
        self, factor: Array, parts: list[tuple[list[Array], list[Array] | None]], count: int
    ) -> LinearSolution | None:
        """The solution of normal equations, corrected until it moves no more; None if it does not settle."""
        k, before = len(self.names), np.inf
        triangle, size = factor[:k, :k], np.linalg.norm(factor[:k, :k], axis=0)
        theta: Array = np.asarray(np.linalg.solve(triangle, factor[:k, k]), dtype=float)
        for _ in range(_CORRECTIONS):
            left = Sums(np.zeros(k + 1))
            for columns, factors in parts:
                self._rows.residual(columns, self._p, factors, theta, left)
            step = np.linalg.solve(triangle, np.linalg.solve(triangle.T, left.total[:k]))
            moved = float(np.linalg.norm(size * step)) / max(float(np.linalg.norm(size * theta)), 1e-300)
            if moved > _FALL * before and moved > _SETTLED:
                return None
            theta, before = np.asarray(theta + step), moved
            if moved <= _SETTLED:
                squares = float(left.total[k])
                condition = _condition(triangle)
                return LinearSolution(self.names, theta, triangle, squares, count, condition, "refined")
        return None

    def _triangle(self, parts: list[tuple[list[Array], list[Array] | None]]) -> tuple[Array, int]:
        width, total = len(self.names) + 1, 0
        factor = np.zeros((0, width))
        for columns, weights in parts:
            for rows in _blocks(len(columns[0]) if columns else 0):
                own = [c[rows] for c in columns]
                of_block = None if weights is None else [w if len(w) == 1 else w[rows] for w in weights]
                block, count = self._rows.build(own, self._p, of_block)
                factor = np.asarray(np.linalg.qr(np.vstack([factor, block]), mode="r"), dtype=float)
                total += count
        missing = width - len(factor)
        return np.vstack([factor, np.zeros((missing, width))]) if missing > 0 else factor, total

    def _solution(self, factor: Array, count: int, way: Literal["normal", "triangular"]) -> LinearSolution:
        k = len(self.names)
        triangle = factor[:k, :k]
        size = np.linalg.norm(triangle, axis=0)
        condition = _condition(triangle)
        if not condition < 1.0 / np.finfo(float).eps:
            raise UndertowError(
                f"{count} samples do not determine {', '.join(self.names)} one by one: log other motions, or "
                "state one as known"
            )
        theta = np.linalg.lstsq(triangle / size, factor[:k, k], rcond=None)[0] / size
        squares = float(factor[k, k] ** 2)
        return LinearSolution(self.names, theta, triangle, squares, count, condition, way)


def _source(rows: RowSource) -> RowSource:
    return rows


def _blocks(count: int) -> Iterable[slice]:
    return (slice(i, min(i + _BLOCK, count)) for i in range(0, count, _BLOCK))


def _weights_of(weights: Sequence[Array] | Array | None, log: int) -> Array | None:
    if weights is None or (isinstance(weights, np.ndarray) and weights.ndim == 1):
        return weights
    return weights[log]


def _cholesky(upper: Array) -> Array | None:
    """The triangular factor of a matrix of products by its upper triangle; None if there is none."""
    size = np.sqrt(np.diag(upper))
    if not (np.isfinite(upper).all() and (size > 0).all()):
        return None
    scaled = upper / np.outer(size, size)
    try:
        return np.asarray(np.linalg.cholesky(np.triu(scaled) + np.triu(scaled, 1).T).T * size)
    except np.linalg.LinAlgError:
        return None


def _condition(factor: Array) -> float:
    """Condition number with columns scaled to unit length."""
    size = np.linalg.norm(factor, axis=0)
    return float(np.linalg.cond(factor / size)) if size.all() and np.isfinite(size).all() else np.inf
