"""Rows of a model that is linear in its parameters, reduced to a triangle; in one pass where that is safe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from undertow.codegen.compiler import compiled_or_virtual
from undertow.codegen.functions import Functions
from undertow.codegen.gram import CompiledRows, RowSource, Sums, VirtualRows, layout
from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import Triangle
from undertow.typing import Array

# Condition number of the scaled regressor up to which a Cholesky factor of the products is good to 1e-10.
_WELL_CONDITIONED = 300.0
# Samples in a block of rows, which then has less than a quarter of a megabyte for six rows of thirty.
_BLOCK = 128


class LinearFit:
    """Rows H theta = target of a model at the samples of logs, for parameters `names` that enter linearly.

    `needed` are the channels that the rows depend on: states, accelerations ("u_dot"), commands, "t".
    """

    def __init__(self, functions: Functions, names: Sequence[str], *, compiled: bool | None = None) -> None:
        self.names = tuple(names)
        self._p = np.array(functions.values(), dtype=float)
        rows = layout(functions, [functions.parameter_names.index(n) for n in names])
        vehicle = functions.vehicle
        rates = (f"{n}_dot" for n in vehicle.velocity_names)
        inputs = (*functions.state_names, *rates, *vehicle.command_names, "t")
        self.needed = tuple(inputs[i] for i in rows.needed)
        self._rows: RowSource = compiled_or_virtual(
            compiled, lambda c: _source(CompiledRows(rows, c)), lambda: _source(VirtualRows(rows))
        )

    def triangle(self, samples: Mapping[str, Array]) -> tuple[Array, int]:
        """Few rows with the same products as those of all samples without a gap, and the count of these.

        The last of the k + 1 columns is that of the target. It is good to 1e-10 whatever the condition.
        """
        columns = self._columns(samples)
        sums = Sums(np.zeros((len(self.names) + 1, len(self.names) + 1)))
        self._rows.gram(columns, self._p, sums)
        factor = _cholesky(sums.total)
        if factor is not None and _condition(factor) <= _WELL_CONDITIONED:
            return factor, sums.count
        return self._by_reflections(columns)

    def _columns(self, samples: Mapping[str, Array]) -> list[Array]:
        missing = [n for n in self.needed if n not in samples]
        if missing:
            raise UndertowError(f"the samples lack channel '{missing[0]}', which the rows depend on: add it")
        columns = [np.ascontiguousarray(samples[n], dtype=float) for n in self.needed]
        if len({c.shape for c in columns}) > 1:
            raise UndertowError(f"the columns {', '.join(self.needed)} differ in length: give equal ones")
        return columns

    def _by_reflections(self, columns: list[Array]) -> tuple[Array, int]:
        triangle = Triangle(len(self.names))
        for first in range(0, len(columns[0]) if columns else 0, _BLOCK):
            triangle.add(*self._rows.build([c[first : first + _BLOCK] for c in columns], self._p))
        return triangle.factor, triangle.count


def _source(rows: RowSource) -> RowSource:
    return rows


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
