"""A vehicle and a control law closed to a linear loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property

import control as ct
import numpy as np

from undertow.control.gains import GainSet
from undertow.control.plant import Plant
from undertow.model.vehicle import Vehicle

from .analysis import Margins, margins, minimal
from .law_system import LawSystem, forces_of
from .numeric import in_direction
from .systems import linearize, named
from .trim import Trim, find_trim


def close_loop(
    vehicle: Vehicle,
    gains: GainSet,
    trim: Trim | Mapping[str, float] | None = None,
    *,
    pade: int = 0,
    nominal: Vehicle | None = None,
) -> LinearLoop:
    """A law that keeps a vehicle at a trim, as linear systems.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    gains : GainSet
        The law; it knows the same vehicle unless `nominal` says otherwise.
    trim : Trim or mapping
        The steady motion, or what it holds (see `find_trim`).
    pade : int
        Order of the approximation of a dead time between command and thrust.
    nominal : Vehicle, optional
        What the law takes for the vehicle.

    Raises
    ------
    UndertowError
        If there is no such trim, or the law has no linear form there.
    """
    found = trim if isinstance(trim, Trim) else find_trim(vehicle, trim)
    law = law_for(gains, nominal or vehicle, found.direction)
    return LinearLoop(linearize(vehicle, found, pade=pade), law, found)


def law_for(gains: GainSet, vehicle: Vehicle, direction: Mapping[str, int]) -> LawSystem:
    """A law that knows a vehicle, with the set of parameters of a direction of motion."""
    return LawSystem(replace(gains, plant=Plant(in_direction(vehicle, direction))))


class LinearLoop:
    """A law that keeps a vehicle at a trim, linear; `close_loop` makes it.

    Attributes
    ----------
    trim : Trim
        The steady motion.
    plant, law : StateSpace
        Commands to reported pose and velocity; references, pose and velocity to forces.
    """

    def __init__(self, plant: ct.StateSpace, system: LawSystem, trim: Trim) -> None:
        self.plant, self._system, self.trim = plant, system, trim
        self.law = system.linear(trim)

    @cached_property
    def _kept(self) -> tuple[np.ndarray, np.ndarray]:
        """The set-point that the law keeps this trim for, and the pose that it is told."""
        ref, y, _ = self._system.keeping(self.trim)
        return ref, y[: len(ref)]

    @property
    def offset(self) -> dict[str, float]:
        """Set-point less reported pose at the trim, m and rad: what a law without integrals leaves."""
        ref, told = self._kept
        return dict(zip(self._system.measured, map(float, ref - told), strict=False))

    @property
    def rest(self) -> dict[str, float]:
        """True pose at the trim less the set-point, m and rad."""
        ref, _ = self._kept
        return dict(zip(self._system.measured, map(float, self.trim.x[: len(ref)] - ref), strict=False))

    @property
    def references(self) -> list[str]:
        """Names of the set-points of the coordinates that commands push."""
        return [self._system.references[i] for i in self._system.acting]

    @property
    def forces(self) -> list[str]:
        """Names of the forces that commands give."""
        return [self._system.forces[i] for i in self._system.acting]

    @cached_property
    def closed(self) -> ct.StateSpace:
        """References to pose, velocity and commands."""
        to_commands = self._system.share
        law = ct.ss(self.law.A, self.law.B, to_commands @ self.law.C, to_commands @ self.law.D)
        whole = _closed(self.plant, law)
        names = (*self.plant.state_labels, *self.law.state_labels)
        outputs = [*self.plant.output_labels, *self.plant.input_labels]
        return named(whole, names, self._system.references, outputs, "closed")

    @cached_property
    def opened(self) -> ct.StateSpace:
        """The loop cut at the forces: forces to minus the forces that the law answers with."""
        n = len(self._system.references)
        plant, by_force, names = self.plant, self._system.share, self._system.forces
        pushed = ct.ss(plant.A, plant.B @ by_force, plant.C, plant.D @ by_force)
        answer = ct.ss(self.law.A, self.law.B[:, n:], -self.law.C, -self.law.D[:, n:]) * pushed
        return named(answer, answer.state_labels, names, names, "opened")

    def cut(self, force: str) -> ct.StateSpace:
        """The loop of one force with the others closed, minimal."""
        i = self._system.forces.index(force)
        others = np.eye(len(self._system.forces))
        others[i, i] = 0.0
        rest = ct.feedback(self.opened, ct.ss([], [], [], others))
        return minimal(ct.ss(rest.A, rest.B[:, [i]], rest.C[[i]], rest.D[[i]][:, [i]]))

    @cached_property
    def margins(self) -> dict[str, Margins]:
        """Margins of the loop of each force that commands give, with the others closed."""
        return {force: margins(self.cut(force)) for force in self.forces}


def _closed(plant: ct.StateSpace, law: ct.StateSpace) -> ct.StateSpace:
    """References to (outputs, commands), by elimination: the plant passes no command straight through."""
    ny = plant.noutputs
    n = law.ninputs - ny
    b_ref, b_y = law.B[:, :n], law.B[:, n:]
    d_ref, d_y = law.D[:, :n], law.D[:, n:]
    a = np.block([[plant.A + plant.B @ d_y @ plant.C, plant.B @ law.C], [b_y @ plant.C, law.A]])
    b = np.vstack([plant.B @ d_ref, b_ref])
    c = np.block([[plant.C, np.zeros((ny, law.nstates))], [d_y @ plant.C, law.C]])
    d = np.vstack([np.zeros((ny, n)), d_ref])
    return ct.ss(a, b, c, d)


def with_forces(vehicle: Vehicle, plant: ct.StateSpace) -> ct.StateSpace:
    """The linear vehicle with body-frame forces as inputs, shared among the commands."""
    inputs, by_force = forces_of(vehicle)
    return named(
        ct.ss(plant.A, plant.B @ by_force, plant.C, plant.D @ by_force),
        plant.state_labels,
        inputs,
        plant.output_labels,
        plant.name,
    )
