"""The rows of a linear regression at the samples of logs, and sums of their products, by compiled code."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import casadi as ca
import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .compiler import LANES, Compiler, library_for, loaded, plain_c, pointer
from .engine import LANES_HEADER, SETTINGS, at_samples, entry_point
from .functions import Functions
from .source import c_file, integers, with_entries

# As many samples as fit in one instruction.
_LANES = """\
#if defined(__AVX512F__)
#define LANES 8
#elif defined(__GNUC__)
#define LANES 4
#else
#define LANES 1
#endif
"""


@dataclass(frozen=True)
class Layout:
    """The rows of a model that is linear in what is sought."""

    function: ca.Function  # `rows(x, nu_dot, u, p, t)`: of every row the structural nonzeros, then the target
    # row, column: where each of these stands; the target in the last column
    row: tuple[int, ...]
    column: tuple[int, ...]
    size: int  # number of parameters that are sought
    used_inputs: tuple[int, ...]  # which of x, nu_dot, u and t, in this order, the rows depend on

    @property
    def degrees(self) -> int:
        """Rows at one sample."""
        return int(self.function.numel_in(1))

    @property
    def starts(self) -> list[int]:
        """First entry of every row, and the end of the last."""
        return [sum(r < i for r in self.row) for i in range(self.degrees + 1)]


def layout(functions: Functions, places: Sequence[int]) -> Layout:
    """The rows H theta = target of a model: forces by what is sought (`places` in p), and what is left."""
    f, chosen = functions, list(places)
    sought = f.p[chosen]
    slope = ca.jacobian(f.driven_residual, f.p)[:, chosen]
    for k, place in enumerate(chosen):
        if ca.depends_on(slope, sought[k]):
            raise UndertowError(
                f"{f.parameter_names[place]} does not enter the equations linearly, which least squares "
                "needs: state it as known, or use undertow fit"
            )
    target = -ca.substitute(f.driven_residual, sought, ca.SX.zeros(len(chosen)))
    table = ca.horzcat(slope, ca.densify(target))
    rows, columns = table.sparsity().get_triplet()
    order = sorted(range(len(rows)), key=lambda k: (rows[k], columns[k]))
    entries = ca.cse(ca.vertcat(*[table.nz[k] for k in order]))
    inputs = [f.x, f.nu_dot, f.u, f.p, f.t]
    function = ca.Function("rows", inputs, [entries], ["x", "nu_dot", "u", "p", "t"], ["rows"])
    varying = ca.vertcat(f.x, f.nu_dot, f.u, f.t)
    felt = ca.which_depends(entries, varying)
    used_inputs = tuple(k for k, used in enumerate(felt) if used)
    return Layout(
        function, tuple(rows[k] for k in order), tuple(columns[k] for k in order), len(chosen), used_inputs
    )


@dataclass
class Sums:
    """Sums over the samples of logs, with what rounding takes from them kept beside."""

    value: Array
    compensation: Array = field(init=False)  # what rounding took
    count: int = 0  # samples that were taken in; those with gaps are not

    def __post_init__(self) -> None:
        self.compensation = np.zeros_like(self.value)

    @property
    def total(self) -> Array:
        """The sums."""
        return np.asarray(self.value + self.compensation)


class CompiledRows:
    """Passes over the data in C."""

    def __init__(self, rows: Layout, compiler: Compiler) -> None:
        self._layout = rows
        source, prefix = gram_source(rows)
        library = loaded(library_for(source, compiler.for_this_machine()))
        self._entry = {name: entry_point(library, f"{prefix}{name}") for name in ("gram", "build")}

    def gram(self, columns: list[Array], p: Array, sums: Sums) -> None:
        """Add products of rows and target, upper triangle."""
        sums.count += self._called("gram", columns, p, sums.value, sums.compensation)

    def build(self, columns: list[Array], p: Array) -> tuple[Array, int]:
        """Rows and target as a matrix; zero where a sample has gaps."""
        n = _length(columns)
        matrix = np.empty((n * self._layout.degrees, self._layout.size + 1))
        return matrix, self._called("build", columns, p, matrix)

    def _called(self, name: str, columns: list[Array], p: Array, *results: Array) -> int:
        n = ctypes.c_int64(_length(columns))
        return int(self._entry[name](n, _pointers(columns), pointer(p), *map(pointer, results)))


def _pointers(columns: list[Array]) -> ctypes.Array[ctypes.c_void_p]:
    return (ctypes.c_void_p * max(len(columns), 1))(*(c.ctypes.data for c in columns))


def _length(columns: list[Array]) -> int:
    return len(columns[0]) if columns else 0


def gram_source(rows: Layout) -> tuple[str, str]:
    """C source of the passes, and the prefix of their names, which carries the hash of the source."""
    f, starts = rows.function, rows.starts
    sizes = {"NX": f.numel_in(0), "ND": f.numel_in(1), "NU": f.numel_in(2), "NF": rows.size}
    sizes |= {"ENTRIES": len(rows.row), "NEEDS": len(rows.used_inputs), "TABLE": _tiles(starts)}
    lines = [_LANES, LANES_HEADER, "#include <string.h>", "#define ROWS entries_of_rows"]
    lines += [f"#define {k} {v}" for k, v in sizes.items()]
    for name, values in (("START", starts), ("COLUMN", rows.column), ("NEEDED", rows.used_inputs)):
        lines.append(integers(name, values))
    lines.append(plain_c(f, "entries_of_rows", words=LANES, shared=("p",), prefix="static SEPARATE "))
    lines.append(c_file("gram.c"))
    return with_entries("\n".join(lines), "gram", "build")


def _tiles(starts: list[int]) -> int:
    """Tiles of the products of all rows, at the smallest size that a tile has."""
    sizes = [-(-(b - a) // 3) for a, b in pairwise(starts)]
    return sum(n * (n + 1) // 2 for n in sizes)


class VirtualRows:
    """The same passes where the rows are not compiled."""

    def __init__(self, rows: Layout) -> None:
        self._layout = rows

    def gram(self, columns: list[Array], p: Array, sums: Sums) -> None:
        """Add products of rows and target, upper triangle."""
        for table, count in self._chunks(columns, p):
            sums.value += np.triu(table.T @ table)
            sums.count += count

    def build(self, columns: list[Array], p: Array) -> tuple[Array, int]:
        """Rows and target as a matrix; zero where a sample has gaps."""
        parts = [*self._chunks(columns, p)]
        nothing = np.zeros((0, self._layout.size + 1))
        return np.vstack([nothing, *(table for table, _ in parts)]), sum(count for _, count in parts)

    def _chunks(self, columns: list[Array], p: Array) -> Iterator[tuple[Array, int]]:
        for first in range(0, _length(columns), SETTINGS.chunk):
            rows = slice(first, first + SETTINGS.chunk)
            yield self._chunk(np.stack([c[rows] for c in columns]), p)

    def _chunk(self, columns: Array, p: Array) -> tuple[Array, int]:
        """Rows and target at some samples, and how many of these have no gap."""
        known, count, f = self._layout, columns.shape[1], self._layout.function
        sizes = [f.numel_in(i) for i in (0, 1, 2)] + [1]
        inputs = np.zeros((count, sum(sizes)))
        inputs[:, list(known.used_inputs)] = columns.T
        whole = np.asarray(np.isfinite(inputs).all(axis=1))
        x, nu_dot, u, t = np.split(np.where(whole[:, None], inputs, 0.0), np.cumsum(sizes)[:-1], axis=1)
        (entries,) = at_samples(f, [x, nu_dot, u, p, t], count)
        table = np.zeros((count, known.degrees, known.size + 1))
        table[:, list(known.row), list(known.column)] = entries
        table[~whole] = 0.0
        return table.reshape(-1, known.size + 1), int(whole.sum())
