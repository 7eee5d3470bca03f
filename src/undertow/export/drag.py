"""Damping and lift of a vehicle as terms of first and second order in its velocities."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import combinations_with_replacement, product

import numpy as np

from undertow.typing import Array

from .body import Body


@dataclass(frozen=True)
class DragSettings:
    """Numbers of the fit."""

    rounding: float = 1e-9  # part of the largest force below which a misfit or a coefficient is rounding
    digits: int = 12  # of a coefficient
    points: int = 200  # velocities at which forces are compared: more than the 69 terms
    seed: int = 1  # of these velocities


SETTINGS = DragSettings()


@dataclass(frozen=True)
class Drag:
    """Terms of damping and lift, body frame of undertow, SNAME signs."""

    # (6, 6): force i per velocity j
    linear: Array = field(default_factory=lambda: np.zeros((6, 6)))
    # (6, 6, 6): force i per velocity j times the magnitude of velocity k
    absolute: Array = field(default_factory=lambda: np.zeros((6, 6, 6)))
    # (6, 6, 6): force i per velocity j times velocity k, j not after k
    plain: Array = field(default_factory=lambda: np.zeros((6, 6, 6)))

    def __add__(self, other: Drag) -> Drag:
        return Drag(self.linear + other.linear, self.absolute + other.absolute, self.plain + other.plain)

    @property
    def diagonal(self) -> Array:
        """Linear and quadratic terms of each velocity against itself, shape (2, 6)."""
        return np.array([np.diag(self.linear), np.einsum("iii->i", self.absolute)])

    @property
    def size(self) -> int:
        """Number of terms."""
        return sum(map(np.count_nonzero, (self.linear, self.absolute, self.plain)))


def fit(body: Body) -> dict[str, Drag]:
    """Terms of every effect of damping; what has no such terms is added to the losses of the body."""
    terms = _terms()
    rng = np.random.default_rng(SETTINGS.seed)
    nu = rng.uniform(-1, 1, (SETTINGS.points, 6))
    nu[:, [i for i in range(6) if i not in body.rows]] = 0.0
    table = np.array([term(nu) for _, term in terms]).T
    drags = {}
    for effect in body.effects("damping"):
        force = body.wrench((effect.id,), nu, np.zeros_like(nu))
        found = np.linalg.lstsq(table, force, rcond=None)[0]
        largest = SETTINGS.rounding * max(float(np.abs(force).max()), 1e-300)
        if np.abs(table @ found - force).max() > largest:
            body.losses.append(f"{effect.id} is left out: it has no terms of second order in {body.program}")
            continue
        found[np.abs(found) <= largest] = 0.0
        found = np.array([float(f"{v:.{SETTINGS.digits}g}") for v in found.flat]).reshape(found.shape)
        even = [k for k, (place, _) in enumerate(terms) if place[0] == "magnitude"]
        if found[even].any():
            body.losses.append(f"{effect.id} differs forward and backward: its mean is taken")
        drags[effect.id] = drag = Drag()
        for ((kind, *place), _), column in zip(terms, found, strict=True):
            if kind != "magnitude":
                getattr(drag, str(kind))[(..., *place)] += column
    return drags


def on_the_diagonal(body: Body, drags: Mapping[str, Drag], rows: int) -> Array:
    """Linear and quadratic terms of the first rows against their own velocity, shape (2, rows).

    What else there is, is added to the losses of the body.
    """
    for name, drag in drags.items():
        kept = np.count_nonzero(drag.diagonal[:, :rows])
        if not kept:
            body.losses.append(f"{name} is left out")
        elif kept < drag.size:
            body.losses.append(f"{name}: terms that {body.program} has no place for are left out")
    return sum(drags.values(), Drag()).diagonal[:, :rows]


def _terms() -> list[tuple[tuple[str | int, ...], Callable[[Array], Array]]]:
    """Names and functions of all terms, and of |v|, in which a force differs forward and backward."""
    one = {("linear", j): lambda v, j=j: v[:, j] for j in range(6)}
    size = {("magnitude", j): lambda v, j=j: np.abs(v[:, j]) for j in range(6)}
    drag = {
        ("absolute", j, k): lambda v, j=j, k=k: v[:, j] * np.abs(v[:, k])
        for j, k in product(range(6), repeat=2)
    }
    pairs = combinations_with_replacement(range(6), 2)
    lift = {("plain", j, k): lambda v, j=j, k=k: v[:, j] * v[:, k] for j, k in pairs}
    return [*one.items(), *size.items(), *drag.items(), *lift.items()]
