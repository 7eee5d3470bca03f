"""Control laws as systems of python-control: nonlinear, and linear at a trim."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import control as ct
import numpy as np

from undertow.control.controller import Controller
from undertow.control.gains import GainSet
from undertow.control.laws.sliding_mode import SlidingMode, SuperTwisting
from undertow.control.plant import Plant
from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .trim import Trim

_ROUNDS = 20
_OPEN = 1.0


class LawSystem:
    """A gain set as it is in continuous time, its gate passed.

    Parameters
    ----------
    gains : GainSet
        The law with its numbers and the model that it knows.

    Attributes
    ----------
    references, measured, states, forces : list of str
        Names of set-points, of pose and velocity, of the law's own states, and of the forces it asks for.
    acting : tuple of int
        Places of the degrees of freedom that commands push in.
    share : ndarray, shape (nu, n)
        Commands for a unit of each force, without limits.
    """

    def __init__(self, gains: GainSet) -> None:
        self.gains, self._controller = gains, Controller(gains)
        vehicle = gains.plant.vehicle
        self.references = [f"{name}_ref" for name in vehicle.pose_names]
        self.measured = [*vehicle.pose_names, *vehicle.velocity_names]
        self.states = list(self._controller.state_names[:-1])
        self.forces = [f"force_{name}" for name in vehicle.degrees_of_freedom]
        allocation = self._controller.allocation
        self.acting = allocation.rows
        self.share = np.zeros((len(vehicle.command_names), len(self.forces)))
        self.share[:, list(self.acting)] = allocation.pseudo_inverse
        self._k = self._controller.gain_values()

    def asked(self, ref: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        """Commands, rates of the law's states, and the forces it asks for."""
        u, rates, force = self._controller.continuous(y, ref, [*z, _OPEN], self._k)
        return u.full().ravel(), rates.full().ravel()[:-1], force.full().ravel()

    @cached_property
    def _slopes(self) -> ca.Function:
        n = len(self.references)
        ref, y, z = ca.SX.sym("ref", n), ca.SX.sym("y", 2 * n), ca.SX.sym("z", len(self.states))
        _, rates, force = self._controller.continuous(y, ref, ca.vertcat(z, _OPEN), self._k)
        slope = ca.jacobian(ca.vertcat(force, rates), ca.vertcat(ref, y, z))
        return ca.Function("law_slopes", [ref, y, z], [ca.densify(slope)])

    # --- systems ------------------------------------------------------------------------------
    def nonlinear(self) -> ct.NonlinearIOSystem:
        """References, pose and velocity to commands."""
        n = len(self.references)

        def rate(t: float, z: Array, inputs: Array, params: object) -> Array:
            return self.asked(inputs[:n], inputs[n:], z)[1]

        def commands(t: float, z: Array, inputs: Array, params: object) -> Array:
            return self.asked(inputs[:n], inputs[n:], z)[0]

        return ct.nlsys(
            rate if self.states else None,
            commands,
            states=self.states or None,
            inputs=[*self.references, *self.measured],
            outputs=list(self._controller.command_names),
            name="law",
        )

    def linear(self, trim: Trim) -> ct.StateSpace:
        """The law at a trim that it keeps: references, pose and velocity to forces."""
        n, nz = len(self.references), len(self.states)
        slope = self._slopes(*self.keeping(trim)).full()
        force, rates = slope[:n], slope[n : n + nz]  # the last row is the gate's
        return ct.ss(
            rates[:, 3 * n :].reshape(nz, nz),
            rates[:, : 3 * n].reshape(nz, 3 * n),
            force[:, 3 * n :].reshape(n, nz),
            force[:, : 3 * n],
            states=self.states,
            inputs=[*self.references, *self.measured],
            outputs=self.forces,
            name="law",
        )

    def keeping(self, trim: Trim) -> tuple[Array, Array, Array]:
        """Reference, reported motion and law states for which the law asks for the forces of a trim.

        Integrals carry what the trim needs; a law without them keeps it with an error that stays.
        """
        self._check(trim)
        n = len(self.references)
        y = trim.y
        ref, z, rows = y[:n].copy(), np.zeros(len(self.states)), list(self.acting)
        target = self._controller.allocation.acting @ trim.u
        for _ in range(_ROUNDS):
            lacking = target - self.asked(ref, y, z)[2][rows]
            slope = self._slopes(ref, y, z).full()[rows]
            if self.states:
                z = z + np.linalg.pinv(slope[:, 3 * n :]) @ lacking
            else:
                ref = ref + np.linalg.pinv(slope[:, :n]) @ lacking
        return ref, y, z

    def _check(self, trim: Trim) -> None:
        law = self.gains.law
        if isinstance(law, SlidingMode | SuperTwisting):
            raise UndertowError(
                f"law '{law.id}' of '{self.gains.name}' jumps at its set-point, so it has no linear form "
                "there: take 'sliding-mode-boundary-layer', or simulate it"
            )
        if trim.turning:
            raise UndertowError(
                f"'{self.gains.name}' holds a pose and cannot keep a turn: take a trim without r"
            )


def as_controller(gains: GainSet) -> ct.NonlinearIOSystem:
    """A gain set as a nonlinear system: references (x_ref ...), pose and velocity to commands.

    Its signals are named so that ``control.interconnect([as_nlsys(vehicle), as_controller(gains)], ...)``
    closes the loop by itself. It is the law in continuous time with its allocation and limits; a gate in its
    schedule counts as passed.
    """
    return LawSystem(gains).nonlinear()


def forces_of(vehicle: Vehicle) -> tuple[list[str], Array]:
    """Names of the body-frame forces that commands give, and commands for a unit of each, shape (nu, k)."""
    plant = Plant(vehicle)
    matrix = np.array(plant.B.xreplace(plant.numbers).tolist(), dtype=float).reshape(plant.B.shape)
    rows = [i for i, row in enumerate(matrix) if np.any(row)]
    inverse = np.linalg.pinv(matrix[rows], rcond=1e-10)
    return [f"force_{vehicle.degrees_of_freedom[i]}" for i in rows], inverse
