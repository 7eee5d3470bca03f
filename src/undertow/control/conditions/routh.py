"""The Routh array of any polynomial, and the linearised channels of a law."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import sympy as sm

from undertow.control.plant import Plant
from undertow.typing import Array


def routh_array(coefficients: Sequence[Any]) -> list[list[Any]]:
    """The Routh array of a polynomial, numbers or symbols.

    Parameters
    ----------
    coefficients : sequence
        Highest power first; the first is not zero.

    Returns
    -------
    list of list
        One row for each power. A row of zeros is replaced by the derivative of the row above it, and a zero
        at the beginning of a row by a small positive symbol-free number times the largest coefficient.
    """
    terms = list(coefficients)
    width = (len(terms) + 1) // 2
    rows = [_padded(terms[0::2], width), _padded(terms[1::2], width)]
    for power in range(len(terms) - 3, -1, -1):
        above, last = rows[-2], rows[-1]
        if all(c == 0 for c in last):
            last = rows[-1] = [c * max(power + 2 - 2 * k, 0) for k, c in enumerate(above)]
        if last[0] == 0:
            last[0] = 1e-12 * max(abs(c) for c in terms)
        rows.append(
            _padded(
                [(last[0] * above[k + 1] - above[0] * last[k + 1]) / last[0] for k in range(width - 1)], width
            )
        )
    return rows[: len(terms)]


def unstable_roots(coefficients: Sequence[float]) -> int:
    """Number of roots in the open right half-plane: sign changes in the first column of the Routh array."""
    first = [row[0] for row in routh_array(coefficients)]
    return sum(a * b < 0 for a, b in pairwise(first))


def _padded(row: list[Any], width: int) -> list[Any]:
    return row + [0] * (width - len(row))


def channel_polynomial(gains: dict[str, float], inertia: float, damping: float) -> list[float] | None:
    """Characteristic polynomial of a linearised channel, highest power first; None for sliding laws."""
    if "K_P" not in gains:
        return None
    polynomial = [inertia, gains["K_V"] + damping, gains["K_P"]]
    return [*polynomial, gains["K_I"]] if "K_I" in gains else polynomial


def roots(coefficients: Sequence[float]) -> list[complex]:
    """Roots of a polynomial, those that grow fastest first."""
    found = [complex(r) for r in np.roots(np.array(coefficients))]
    return sorted(found, key=lambda r: (-r.real, -r.imag))


def coupled_roots(
    gains: dict[str, Array], inertia: Array, damping: Array, plant: Plant, J: Array | None = None
) -> list[complex]:
    """Eigenvalues of the loop linearised at rest, all axes together.

    What no thruster can push keeps its own dynamics.

    Parameters
    ----------
    gains : dict of array
        Diagonals of the gain matrices by name, pose coordinates.
    inertia, damping : array, shape (n, n)
        M and D(0), body frame.
    plant : Plant
        What is pushed.
    J : array, shape (n, n), optional
        The attitude; heading north on an even keel unless given.
    """
    n = len(inertia)
    J = np.eye(n) if J is None else J
    pushed = np.diag([float(any(row)) for row in plant.B.tolist()])
    zero, one = np.zeros((n, n)), np.eye(n)
    push = np.linalg.inv(inertia) @ pushed @ J.T
    own = np.linalg.inv(inertia) @ damping
    integral = np.diag(gains.get("K_I", np.zeros(n)))
    rows = [
        [zero, J, zero],
        [-push @ np.diag(gains["K_P"]), -push @ np.diag(gains["K_V"]) @ J - own, -push @ integral],
        [one, zero, zero],
    ]
    matrix = np.block(rows)
    if "K_I" not in gains:
        matrix = matrix[: 2 * n, : 2 * n]
    return sorted((complex(v) for v in np.linalg.eigvals(matrix)), key=lambda r: (-r.real, -r.imag))


def routh_symbols() -> sm.Expr:
    """The third entry of the first column for M s^3 + K s^2 + k_p s + k_i, symbolically."""
    M, K, p, i = sm.symbols("M K k_p k_i", positive=True)
    return sm.simplify(routh_array([M, K, p, i])[2][0])
