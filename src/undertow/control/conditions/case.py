"""A plant in numbers: inertia and damping at rest for each set of parameters, as functions of these."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np
import sympy as sm

from undertow.control.plant import Plant
from undertow.errors import UndertowError
from undertow.typing import Array


@dataclass(frozen=True)
class Affine:
    """A matrix that depends on parameters: constant + sum of theta_j slopes_j.

    Attributes
    ----------
    constant : array, shape (n, n)
        The part without parameters.
    slopes : array, shape (n_parameters, n, n)
        Derivative in each parameter.
    """

    constant: Array
    slopes: Array

    def at(self, theta: Array) -> Array:
        """The matrix for parameters of shape (..., n_parameters)."""
        return self.constant + np.tensordot(theta, self.slopes, axes=1)


@dataclass(frozen=True)
class SignSet:
    """The plant at rest while every velocity that switches parameters keeps one sign.

    Attributes
    ----------
    name : str
        "forward", "backward", or the signs of the velocities where they are mixed.
    way : mapping
        1 or -1 by velocity.
    names : tuple of str
        Parameters that M and D depend on here.
    theta : array, shape (n_parameters,)
        Their values, SI, SNAME signs.
    M, D : Affine
        Inertia and damping at rest, body frame, shape (n, n).
    """

    name: str
    way: Mapping[sm.Symbol, int]
    names: tuple[str, ...]
    theta: Array
    M: Affine
    D: Affine

    @property
    def inertia(self) -> Array:
        """M with the values of the file."""
        return self.M.at(self.theta)

    @property
    def damping(self) -> Array:
        """D at rest with the values of the file."""
        return self.D.at(self.theta)


def sign_sets(plant: Plant) -> list[SignSet]:
    """All sign sets of a plant: all forward and all backward first, then the mixed ones.

    Raises
    ------
    UndertowError
        If M is not positive definite, or D is not finite at rest.
    """
    ways = [dict(zip(plant.reversing, w, strict=True)) for w in product((1, -1), repeat=len(plant.reversing))]
    ways.sort(key=lambda way: len(set(way.values())) > 1)
    found = [_sign_set(plant, way) for way in ways]
    for one in found:
        _check(one, plant)
    return found


def _sign_set(plant: Plant, way: Mapping[sm.Symbol, int]) -> SignSet:
    rest = dict.fromkeys(plant.nu, sm.Integer(0))
    M, D = (plant.one_way(m, way).xreplace(rest).applyfunc(sm.expand) for m in (plant.M, plant.D))
    symbols = sorted((M.free_symbols | D.free_symbols) & set(plant.numbers), key=str)
    theta = np.array([float(plant.numbers[x]) for x in symbols])
    names = tuple(map(str, symbols))
    return SignSet(
        _name(way), way, names, theta, _affine(M, symbols, plant.numbers), _affine(D, symbols, plant.numbers)
    )


def _name(way: Mapping[sm.Symbol, int]) -> str:
    signs = set(way.values())
    if len(signs) > 1:
        return ", ".join(f"{v} {'>' if s > 0 else '<'} 0" for v, s in way.items())
    return {1: "forward", -1: "backward"}.get(next(iter(signs), 0), "")


def _affine(matrix: sm.Matrix, symbols: list[sm.Symbol], numbers: Mapping[sm.Symbol, sm.Expr]) -> Affine:
    """Slopes at the values of the file; parameters enter linearly nearly always, else this is the tangent."""
    slopes = [_numbers(matrix.diff(x), numbers) for x in symbols]
    value = _numbers(matrix, numbers)
    theta = [float(numbers[x]) for x in symbols]
    constant = value - sum((t * s for t, s in zip(theta, slopes, strict=True)), np.zeros_like(value))
    return Affine(constant, np.array(slopes).reshape(len(symbols), *value.shape))


def _numbers(matrix: sm.Matrix, numbers: Mapping[sm.Symbol, sm.Expr]) -> Array:
    filled = matrix.xreplace(numbers)
    if filled.free_symbols:
        names = ", ".join(sorted(map(str, filled.free_symbols)))
        raise UndertowError(f"inertia or damping at rest depends on {names}: conditions need constant ones")
    return np.array(filled.evalf().tolist(), dtype=float)


def _check(one: SignSet, plant: Plant) -> None:
    of = f" ({one.name})" if one.name else ""
    dofs = plant.vehicle.degrees_of_freedom
    if not np.isfinite(one.damping).all():
        raise UndertowError(f"damping at rest{of} is not finite: conditions need it; check [effects]")
    values, vectors = np.linalg.eigh(one.inertia)
    if values[0] <= 1e-12 * max(values[-1], 1e-300):
        worst = dofs[int(np.argmax(np.abs(vectors[:, 0])))]
        raise UndertowError(
            f"the mass matrix of '{plant.vehicle.name}'{of} is singular or not positive definite, about "
            f"{worst}: give {worst} inertia in [effects.rigid_body] or leave it out"
        )
