"""The contract of a control law: its gains and one symbolic statement of the force it asks for."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import ClassVar

import sympy as sm

from undertow.control.plant import Plant
from undertow.model.symbols import POSE, symbol


@dataclass(frozen=True)
class GainMatrix:
    """A diagonal matrix of gains, one for each pose coordinate.

    Attributes
    ----------
    name : str
        Name in gain files, such as K_P.
    force : str
        Unit for a position (x, y, z).
    moment : str
        Unit for an angle (phi, theta, psi); radians are left out.
    meaning : str
        What it multiplies.
    positive : bool
        Whether zero is refused: without it the law is no such law.
    """

    name: str
    force: str
    moment: str
    meaning: str
    positive: bool = True

    def unit(self, coordinate: str) -> str:
        """Unit of the gain of a pose coordinate."""
        return self.force if POSE.index(coordinate) < 3 else self.moment

    def symbol(self, coordinate: str) -> sm.Symbol:
        """Symbol of the gain of a pose coordinate, such as K_P_x."""
        return symbol(f"{self.name}_{coordinate}")


class LawSignals:
    """What a law may use, in the degrees of freedom of a plant.

    Parameters
    ----------
    plant : Plant
        The model that the law knows.
    law : Law
        The law: its gains and states become symbols here.

    Attributes
    ----------
    error : Matrix, shape (n, 1)
        Desired less present pose, m and rad; angles within half a turn.
    states : Matrix, shape (n_states * n, 1)
        The law's own states, one block of n for each of its `states`.
    """

    def __init__(self, plant: Plant, law: Law) -> None:
        self.plant, self._law = plant, law
        self.coordinates = tuple(str(q) for q in plant.eta)
        self.error = sm.Matrix([symbol(f"error_{c}") for c in self.coordinates])
        self.states = sm.Matrix([symbol(n) for n in law.state_names(self.coordinates)])

    def __getattr__(self, name: str) -> sm.Matrix:
        """A gain matrix by its name, diagonal, shape (n, n)."""
        found = [g for g in type(self._law).gains if g.name == name]
        if not found:
            raise AttributeError(f"law '{self._law.id}' declares no gain '{name}'")
        return sm.diag(*[found[0].symbol(c) for c in self.coordinates])


class Law(abc.ABC):
    """A law that drives the pose to a constant set-point.

    Attributes
    ----------
    id : str
        Name in gain files.
    reference : str
        Where it is from.
    gains : tuple of GainMatrix
        Its gain matrices.
    states : tuple of str
        Names of its own states; each is one number for every pose coordinate.
    offset_order : int
        Power of the sampling interval with which `offset` grows.
    """

    id: ClassVar[str]
    reference: ClassVar[str]
    gains: ClassVar[tuple[GainMatrix, ...]]
    states: ClassVar[tuple[str, ...]] = ()
    offset_order: ClassVar[int] = 1

    @abc.abstractmethod
    def force(self, s: LawSignals) -> sm.Matrix:
        """Generalised force that the law asks for, body frame, shape (n, 1), N and N m."""

    def rates(self, s: LawSignals) -> sm.Matrix:
        """Time derivative of the law's states, shape (n_states * n, 1)."""
        return sm.zeros(len(s.states), 1)

    def offset(self, s: LawSignals) -> sm.Matrix:
        """Distance from the set-point that sampling the law may leave, by estimate, shape (n, 1).

        In m and rad, divided by the interval in s to the power of `offset_order`; zero for laws without a
        jump.
        """
        return sm.zeros(len(s.coordinates), 1)

    @classmethod
    def state_names(cls, coordinates: tuple[str, ...]) -> list[str]:
        """Names of the states for these pose coordinates, such as integral_x."""
        return [f"{name}_{c}" for name in cls.states for c in coordinates]

    @classmethod
    def about(cls) -> str:
        """The first line of its docstring."""
        return (cls.__doc__ or "").strip().split("\n")[0]
