"""Products for Gauss-Newton steps: windows simulated with sensitivities, nothing but sums kept."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files

import casadi as ca
import numpy as np

from undertow.typing import Array, Integers

from .cache import library_for
from .compiler import Compiler
from .driver import loaded, pointer, shared
from .functions import Functions, solve_symmetric
from .lanes import in_threads, shares
from .plain import plain_c
from .problem import Problem
from .source import EXPORTED, SEPARATE, integers, with_entry

# Doubles side by side in a vector; the compiler splits it where the processor has narrower ones.
_LANES = 8
_VECTORS = f"""\
#if defined(__GNUC__)
typedef double V __attribute__((vector_size({8 * _LANES})));
#define LANES {_LANES}
#else
typedef double V;
#define LANES 1
#endif
"""


@dataclass(frozen=True)
class Products:
    """Sums of products of weighted errors and their derivatives, by window and group of samples.

    Attributes
    ----------
    table : (b, groups, m + 1, m + 1) array
        Products of the m derivatives (parameters, then initial values of pose and velocity) and, as the last
        row and column, the error.
    squares : (b, 2n) array
        Sum of squares of the weighted errors by channel.
    diverged : bool
        Whether a simulation left the finite numbers; the sums then mean nothing.
    """

    table: Array
    squares: Array
    diverged: bool


def products_of(value: Array, slope: Array, measured: Array, weight: Array, group: Integers) -> Products:
    """The same sums from what was simulated.

    Parameters
    ----------
    value : (b, n, 2 dof) array
        Pose and velocity, or what the sensors report of them.
    slope : (b, n, 2 dof, m) array
        Derivatives of it.
    measured, weight, group : arrays
        As for `Simulator.products`.
    """
    used, measured = weight != 0, np.where(weight == 0, 0.0, measured)
    with np.errstate(over="ignore", invalid="ignore"):  # a run that diverges is told as such
        error = np.where(used, (value - measured) * weight, 0.0)
        rows = np.where(used[..., None], slope * weight[..., None], 0.0)
        squares = np.sum(error**2, axis=1)
    b, groups, m = len(value), int(group.max(initial=0)) + 1, slope.shape[3]
    found = Products(np.zeros((b, groups, m + 1, m + 1)), squares, diverged=False)
    if not (np.isfinite(value).all() and np.isfinite(squares).all() and np.isfinite(rows).all()):
        return Products(found.table, found.squares, diverged=True)
    both = np.concatenate([rows, error[..., None]], axis=3)
    for g in range(groups):
        part = np.where((group == g)[:, :, None, None], both, 0.0).reshape(b, -1, m + 1)
        with np.errstate(over="ignore", invalid="ignore"):
            found.table[:, g] = np.swapaxes(part, 1, 2) @ part
    return Products(found.table, squares, diverged=not np.isfinite(found.table).all())


class CompiledProducts:
    """Simulation of windows in C, compiled for one choice of parameters.

    Parameters
    ----------
    functions : Functions
        The model.
    places : sequence of int
        Indices of the parameters to differentiate by.
    compiler : Compiler
        Compiler to use.
    """

    def __init__(self, functions: Functions, places: Sequence[int], compiler: Compiler) -> None:
        source, name = _source(functions, places)
        library = loaded(library_for(source, compiler.for_this_machine()))
        self._products = getattr(library, name)
        self._products.restype = ctypes.c_int64
        self._size = len(places) + 2 * functions.nu_dot.numel()

    def __call__(self, problem: Problem, measured: Array, weight: Array, group: Integers) -> Products:
        """Sums over the samples of every window; `group` says of which sum of its window a sample is part."""
        b, _, channels = measured.shape
        groups = int(group.max(initial=0)) + 1
        found = Products(
            np.zeros((b, groups, self._size + 1, self._size + 1)), np.zeros((b, channels)), diverged=False
        )
        arrays: Sequence[np.ndarray] = (
            problem.x[:, 0].copy(),
            measured,
            weight,
            group,
            found.table,
            found.squares,
        )
        diverged: list[int] = []

        def work(rows: slice) -> None:
            diverged.append(self._called(problem, rows, groups, [a[rows] for a in arrays]))

        # Every derivative is carried along like a state.
        steps = float(problem.steps.sum(axis=1).max(initial=1)) * self._size
        in_threads(work, shares(b, steps, None, _LANES), None)
        if any(diverged) or not np.isfinite(found.table).all():
            return Products(found.table, found.squares, diverged=True)
        lower = np.tril_indices(self._size + 1, -1)
        found.table[:, :, lower[0], lower[1]] = found.table[:, :, lower[1], lower[0]]
        return found

    def _called(self, problem: Problem, rows: slice, groups: int, arrays: Sequence[np.ndarray]) -> int:
        given: Sequence[np.ndarray] = (problem.t, problem.steps, problem.u, problem.p)
        t, steps, u, p = (_of(a, rows) for a in given)
        return int(
            self._products(
                *map(ctypes.c_int64, (len(arrays[0]), problem.t.shape[1], groups)),
                *shared(t),
                pointer(steps),
                *shared(u),
                *shared(p),
                *map(pointer, arrays),
            )
        )


def _of(array: np.ndarray, rows: slice) -> np.ndarray:
    return array if len(array) == 1 else array[rows]


def _source(functions: Functions, places: Sequence[int]) -> tuple[str, str]:
    """C source of the simulation, and the name of its entry point, which carries the hash of the source."""
    inverse, slopes, steady = _parts(functions, places)
    sizes = {
        "NX": functions.x.numel(),
        "NU": functions.u.numel(),
        "ND": functions.nu_dot.numel(),
        "NF": len(places),
    }
    lines = [f"#define {k} {v}" for k, v in sizes.items()]
    lines += ["#define SLOPES slopes", "#define INVERSE inverse"]
    lines += ["#define STEADY"] if steady else []
    for name, output in (("RX", "R_x"), ("RP", "R_p")):
        lines += _by_rows(name, slopes.sparsity_out(output))
    prefix = "static SEPARATE "
    model = plain_c(inverse, "inverse", prefix=prefix)
    model += plain_c(slopes, "slopes", packed=("R_x", "R_p"), prefix=prefix)
    driver = (files("undertow.codegen") / "gauss_newton.c").read_text(encoding="utf-8")
    headers = "#include <math.h>\n#include <stdint.h>\n"
    text = "\n".join([*lines, SEPARATE, EXPORTED, _VECTORS, headers, model, driver])
    return with_entry(text, "PRODUCTS", "products")


def _parts(functions: Functions, places: Sequence[int]) -> tuple[ca.Function, ca.Function, bool]:
    """W(x, u, p, t); (x_dot, R_x, R_p) from x, u, p, t, W as for `Functions.tangents`; is W of p alone?"""
    f = functions
    size = f.nu_dot.numel()
    W = ca.SX.sym("W", size, size)
    inputs, names = [f.x, f.u, f.p, f.t], ["x", "u", "p", "t"]
    mass = f.mass_matrix
    inverse = ca.densify(ca.cse(solve_symmetric(mass, ca.SX.eye(size))))
    rows = f.acceleration_rows
    at_rest = ca.substitute(f.balance, f.nu_dot, ca.SX.zeros(size))
    acceleration = W @ at_rest[rows]
    x_dot = ca.vertcat(at_rest[: rows.start], acceleration, at_rest[rows.stop :])
    slopes = [ca.jacobian(f.balance, f.x), ca.jacobian(f.balance, f.p)[:, list(places)]]
    outputs = [ca.densify(x_dot), *(ca.substitute(s, f.nu_dot, acceleration) for s in slopes)]
    steady = not ca.depends_on(mass, ca.vertcat(f.x, f.u, f.t))
    return (
        ca.Function("inverse", inputs, [inverse], names, ["W"]),
        ca.Function("slopes", [*inputs, W], ca.cse(outputs), [*names, "W"], ["x_dot", "R_x", "R_p"]),
        steady,
    )


def _by_rows(name: str, sparsity: ca.Sparsity) -> list[str]:
    """Nonzeros row by row, and where each stands in an output stored by columns."""
    rows, columns = sparsity.get_triplet()
    order = sorted(range(len(rows)), key=lambda k: (rows[k], columns[k]))
    start = [sum(r < i for r in rows) for i in range(sparsity.size1() + 1)]
    return [
        f"#define {name}_NONZEROS {len(rows)}",
        integers(f"{name}_START", start),
        integers(f"{name}_COLUMN", [columns[k] for k in order]),
        integers(f"{name}_PLACE", order),
    ]
