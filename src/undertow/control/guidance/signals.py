"""What a controller and its reference tell each other: the interface that every reference has."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import ClassVar

import casadi as ca
import numpy as np


@dataclass(frozen=True)
class Number:
    """A number of a mission as generated code holds it."""

    name: str
    unit: str
    value: float


@dataclass(frozen=True)
class Kinematics:
    """The reported motion, in the coordinates of the vehicle.

    Attributes
    ----------
    names : tuple of str
        Pose coordinates.
    eta, nu : casadi.SX, shape (n, 1)
        Reported pose (NED) and body velocity, SI.
    J_inverse, J_dot : casadi.SX, shape (n, n)
        Kinematics there.
    """

    names: tuple[str, ...]
    eta: ca.SX
    nu: ca.SX
    J_inverse: ca.SX
    J_dot: ca.SX

    def place(self, name: str) -> int:
        """Where a coordinate stands."""
        return self.names.index(name)


@dataclass(frozen=True)
class Course:
    """What a reference asks for at a sample.

    Attributes
    ----------
    eta_d : casadi.SX, shape (n, 1)
        Desired pose, m and rad.
    nu_r, nu_r_dot : casadi.SX, shape (n, 1)
        Reference velocity and its rate, body frame, SI.
    """

    eta_d: ca.SX
    nu_r: ca.SX
    nu_r_dot: ca.SX


@dataclass(frozen=True)
class Followed:
    """A reference beside a run, rows over time.

    Attributes
    ----------
    desired : dict of ndarray, shape (n,)
        What was desired, by pose coordinate.
    errors : dict of ndarray, shape (n,)
        Desired less true, by coordinate; "cross track" and "depth" (m) for legs.
    arrived : ndarray of bool, shape (n,)
        Where the end of the mission has been reached.
    way : ndarray, shape (k, 2)
        Where it leads in the plane, north and east, m: way-points, or the curve over the rows.
    """

    desired: dict[str, np.ndarray]
    errors: dict[str, np.ndarray]
    arrived: np.ndarray
    way: np.ndarray


class Reference(abc.ABC):
    """A reference with states of its own, stated once in CasADi for simulation and for C.

    Attributes
    ----------
    state_names : tuple of str
        Its states, a part of those of the controller.
    continuous : bool
        Whether its states have rates, so that a law may act without sampling.
    start, end : ndarray, shape (n,)
        Pose where it begins and where it ends, m and rad.
    unheld : tuple of str
        Velocities that the law takes as zero: nothing pushes there, and in a current they are the water's.
    """

    state_names: ClassVar[tuple[str, ...]]
    continuous: ClassVar[bool] = False
    unheld: tuple[str, ...] = ()
    start: np.ndarray
    end: np.ndarray

    @property
    @abc.abstractmethod
    def numbers(self) -> list[Number]:
        """The numbers of the mission, r of the controller."""

    @abc.abstractmethod
    def initial_states(self) -> list[float]:
        """States at the start."""

    @abc.abstractmethod
    def course(self, r: ca.SX, s: ca.SX, kin: Kinematics) -> Course:
        """What is asked for in these states."""

    @abc.abstractmethod
    def advance(self, r: ca.SX, s: ca.SX, kin: Kinematics, dt: ca.SX) -> ca.SX:
        """The states dt seconds on."""

    @abc.abstractmethod
    def followed(self, t: np.ndarray, state: dict[str, np.ndarray], s: np.ndarray) -> Followed:
        """The reference beside rows of a run: times, true motion by name, and these states."""
