"""Control laws as systems of python-control: nonlinear, and linear at a trim."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import control as ct
import numpy as np

from undertow.codegen.convert import Converter
from undertow.control.gains import GainSet
from undertow.control.laws.sliding_mode import SlidingMode, SuperTwisting
from undertow.control.plant import Plant
from undertow.errors import UndertowError
from undertow.model.symbols import POSE

from .numeric import Array
from .trim import Trim

_ROUNDS = 20


def allocation(plant: Plant) -> Array:
    """Body-frame force of a unit of each command, shape (n, nu), N and N m for a command of one."""
    return np.array(plant.B.xreplace(plant.numbers).tolist(), dtype=float)


def actuated(plant: Plant) -> tuple[int, ...]:
    """Places of the degrees of freedom that commands push in."""
    return tuple(int(i) for i in np.flatnonzero(np.any(allocation(plant), axis=1)))


def share(plant: Plant, weights: dict[str, float]) -> Array:
    """Commands for a unit of each body-frame force, shape (nu, n): the least weighted sum of squares.

    A force that no command gives is left out.
    """
    names = plant.vehicle.command_names
    price = np.array([weights.get(name, 1.0) for name in names])
    scaled = allocation(plant) / np.sqrt(price)
    return np.linalg.pinv(scaled, rcond=1e-10) / np.sqrt(price)[:, None]


class LawSystem:
    """A gain set as functions of references and reported motion: forces, commands, rates of its own states.

    Without limits of commands, schedule and sampling: the law itself.

    Parameters
    ----------
    gains : GainSet
        The law with its numbers and the model that it knows.
    """

    def __init__(self, gains: GainSet) -> None:
        self.gains, self.plant = gains, gains.plant
        vehicle = self.plant.vehicle
        self.references = [f"{name}_ref" for name in vehicle.pose_names]
        self.measured = [*vehicle.pose_names, *vehicle.velocity_names]
        self.states = [str(s) for s in gains.signals.states]
        self.forces = [f"force_{name}" for name in vehicle.degrees_of_freedom]
        self.share = share(self.plant, dict(gains.allocation.weights))
        self._define()

    def _define(self) -> None:
        signals, n = self.gains.signals, len(self.references)
        self._ref, self._y = ca.SX.sym("ref", n), ca.SX.sym("y", 2 * n)
        self._z = ca.SX.sym("z", len(self.states))
        error = self._ref - self._y[:n]
        for i, name in enumerate(signals.coordinates):
            if name in POSE[3:]:
                error[i] = ca.atan2(ca.sin(error[i]), ca.cos(error[i]))
        plant = self.plant
        symbols = [*plant.eta, *plant.nu, *signals.error, *signals.states]
        entries = [
            *ca.vertsplit(self._y),
            *ca.vertsplit(error),
            *(ca.vertsplit(self._z) if self.states else []),
        ]
        numbers = {s: ca.SX(float(v)) for s, v in (plant.numbers | self.gains.numbers).items()}
        convert = Converter(dict(zip(symbols, entries, strict=True)) | numbers)
        law = self.gains.law
        self._force = ca.densify(convert.matrix(law.force(signals)))
        self._rates = ca.densify(convert.matrix(law.rates(signals)))

    @cached_property
    def functions(self) -> ca.Function:
        """`(force, rates) = law(ref, y, z)`."""
        return ca.Function("law", [self._ref, self._y, self._z], [self._force, self._rates])

    @cached_property
    def slopes(self) -> ca.Function:
        """Slopes of force and rates in (ref, y, z), shape (n + nz, 3 n + nz)."""
        inputs = [self._ref, self._y, self._z]
        slope = ca.jacobian(ca.vertcat(self._force, self._rates), ca.vertcat(*inputs))
        return ca.Function("law_slopes", inputs, [ca.densify(slope)])

    # --- systems ------------------------------------------------------------------------------
    def nonlinear(self) -> ct.NonlinearIOSystem:
        """The law with its allocation: references, pose and velocity to commands."""
        n, function = len(self.references), self.functions

        def rate(t: float, z: Array, inputs: Array, params: object) -> Array:
            return function(inputs[:n], inputs[n:], z)[1].full().ravel()

        def commands(t: float, z: Array, inputs: Array, params: object) -> Array:
            return self.share @ function(inputs[:n], inputs[n:], z)[0].full().ravel()

        return ct.nlsys(
            rate if self.states else None,
            commands,
            states=self.states or None,
            inputs=[*self.references, *self.measured],
            outputs=list(self.plant.vehicle.command_names),
            name="law",
        )

    def linear(self, trim: Trim) -> ct.StateSpace:
        """The law at a trim that it keeps: references, pose and velocity to forces."""
        n, nz = len(self.references), len(self.states)
        slope = self.slopes(*self.keeping(trim)).full()
        force, rates = slope[:n], slope[n:]
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
        self._check_smooth(trim)
        y = trim.x[: len(self.measured)]
        ref, z = y[: len(self.references)].copy(), np.zeros(len(self.states))
        rows = list(actuated(self.plant))
        target = (allocation(self.plant) @ trim.u)[rows]
        for _ in range(_ROUNDS):
            lacking = target - self.functions(ref, y, z)[0].full().ravel()[rows]
            slope = self.slopes(ref, y, z).full()[rows]
            if self.states:
                z = z + np.linalg.pinv(slope[:, 3 * len(ref) :]) @ lacking
            else:
                ref = ref + np.linalg.pinv(slope[:, : len(ref)]) @ lacking
        return ref, y, z

    def _check_smooth(self, trim: Trim) -> None:
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
    closes the loop by itself. It is the continuous law with its allocation, without limits, schedule and
    sampling.
    """
    return LawSystem(gains).nonlinear()
