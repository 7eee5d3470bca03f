"""What a controller and its reference exchange: the interface that every reference has."""

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
    """The reported motion, in the coordinates of the vehicle."""

    names: tuple[str, ...]  # pose coordinates
    # eta, nu: (n, 1): reported pose (NED) and body velocity, SI
    eta: ca.SX
    nu: ca.SX
    # J_inverse, J_dot: (n, n): kinematics there
    J_inverse: ca.SX
    J_dot: ca.SX

    def place(self, name: str) -> int:
        """Where a coordinate stands."""
        return self.names.index(name)


@dataclass(frozen=True)
class Course:
    """What a reference asks for at a sample."""

    eta_d: ca.SX  # (n, 1): desired pose, m and rad
    # nu_r, nu_r_dot: (n, 1): reference velocity and its rate, body frame, SI
    nu_r: ca.SX
    nu_r_dot: ca.SX


@dataclass(frozen=True)
class Followed:
    """A reference beside a run, rows over time."""

    desired: dict[str, np.ndarray]  # (n,): what was desired, by pose coordinate
    # (n,): desired less true, by coordinate; "cross track" and "depth" (m) for legs
    errors: dict[str, np.ndarray]
    arrived: np.ndarray  # (n,): where the end of the mission has been reached
    # (k, 2): where it leads in the plane, north and east, m: way-points, or the curve over the rows
    way: np.ndarray


class Reference(abc.ABC):
    """A reference with states of its own, stated once in CasADi for simulation and for C."""

    state_names: ClassVar[tuple[str, ...]]  # its states, a part of those of the controller
    # whether its states have rates, so that a law may act without sampling
    continuous: ClassVar[bool] = False
    # velocities that the law takes as zero: nothing pushes there, and in a current they are the water's
    unheld: tuple[str, ...] = ()
    # start, end: (n,): pose where it begins and where it ends, m and rad
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
