"""A control law as it runs aboard: sampled, scheduled, allocated, with its integrals held at limits."""

from __future__ import annotations

from functools import cached_property
from math import pi

import casadi as ca
import sympy as sm

from undertow.codegen.convert import Converter
from undertow.errors import UndertowError
from undertow.model.symbols import POSE
from undertow.model.units import to_si

from .allocation import Allocation, allocation_of
from .gains import GainSet

GATE = "gate"
# Parts of the wanted force that count as rounding and not as a limit.
_ROUNDING = 1e-9
# What waits for the heading, and the motions that the law does not even brake meanwhile.
_WAITING, _IDLE = ("x", "y"), ("u", "v")


class Controller:
    """A gain set as CasADi functions of what the sensors report.

    y is the reported pose and velocity in the vehicle's degrees of freedom, r the desired pose, s the states
    of the law and a last one for the gate (0 closed, 1 passed), k the gains, all in SI.

    Parameters
    ----------
    gains : GainSet
        The law with its gains, on the vehicle that it knows.

    Raises
    ------
    UndertowError
        If the thrusters cannot give the force, or the schedule needs an axis that the vehicle lacks.

    Attributes
    ----------
    gains : GainSet
        As given.
    allocation : Allocation
        How forces become commands.
    """

    def __init__(self, gains: GainSet) -> None:
        self.gains = gains
        self.allocation: Allocation = allocation_of(gains)
        self._coordinates = gains.plant.vehicle.pose_names
        self._check_schedule()
        n, n_states = len(self._coordinates), len(self.state_names)
        self._y, self._desired = ca.SX.sym("y", 2 * n), ca.SX.sym("r", n)
        self._own, self._passed = ca.SX.sym("s", n_states - 1), ca.SX.sym(GATE)
        self._k, self._dt = ca.SX.sym("k", len(self.gain_names)), ca.SX.sym("dt")

    def _check_schedule(self) -> None:
        missing = [c for c in ("x", "psi") if c not in self._coordinates]
        if self._by_turns and missing:
            raise UndertowError(
                f"[schedule] order = 'yaw-first' needs {missing[0]}, which '{self.gains.plant.vehicle.name}' "
                'does not have: write order = "together"'
            )
        if not 0 < self.gate <= pi:
            fault = "beyond 180 deg, which no error of the heading is" if self.gate > pi else "not above zero"
            raise UndertowError(
                f"[schedule] gate = {self.gains.schedule.gate} is {fault}: give an angle of up to 180 deg "
                "(a number without a unit is in rad)"
            )

    # --- names and numbers --------------------------------------------------------------------
    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the entries of s."""
        return (*self.gains.law.state_names(self._coordinates), GATE)

    @property
    def gain_names(self) -> tuple[str, ...]:
        """Names of the entries of k."""
        return tuple(str(g.symbol(c)) for g in type(self.gains.law).gains for c in self._coordinates)

    def gain_values(self) -> list[float]:
        """Values of k."""
        return [self.gains.values[name] for name in self.gain_names]

    def initial_states(self) -> list[float]:
        """Values of s at the start: integrals at zero, the gate closed where there is one."""
        return [*[0.0] * (len(self.state_names) - 1), 0.0 if self._by_turns else 1.0]

    @property
    def command_names(self) -> tuple[str, ...]:
        """Names of the commands."""
        return self.gains.plant.vehicle.command_names

    @cached_property
    def gate(self) -> float:
        """Error of the heading that opens the gate, rad."""
        try:
            return to_si(self.gains.schedule.gate, "rad")
        except UndertowError as error:
            raise UndertowError(f"[schedule] gate: {error}") from error

    @property
    def _by_turns(self) -> bool:
        return self.gains.schedule.order == "yaw-first"

    # --- functions ----------------------------------------------------------------------------
    @cached_property
    def sampled(self) -> ca.Function:
        """`(u, s_next, tau) = control(y, r, s, k, dt)`: one sample, its commands held for dt.

        tau is the force that the law asks for, in body axes; an integral advances by dt times its rate.
        """
        gate = self._gate()
        commands, rates, force = self._law(gate)
        following = ca.vertcat(self._own + self._dt * rates, gate)
        return self._function("control", [self._dt], [commands, following, force], ["u", "s_next", "tau"])

    @cached_property
    def continuous(self) -> ca.Function:
        """`(u, s_dot, tau) = law(y, r, s, k)`: commands and rates in continuous time, the gate as in s."""
        commands, rates, force = self._law(self._passed)
        return self._function("law", [], [commands, ca.vertcat(rates, 0), force], ["u", "s_dot", "tau"])

    def _function(self, name: str, more: list[ca.SX], outputs: list[ca.SX], names: list[str]) -> ca.Function:
        states = ca.vertcat(self._own, self._passed)
        inputs = [self._y, self._desired, states, self._k, *more]
        input_names = ["y", "r", "s", "k", *["dt"] * len(more)]
        return ca.Function(name, inputs, [ca.densify(o) for o in ca.cse(outputs)], input_names, names)

    # --- the law --------------------------------------------------------------------------------
    @cached_property
    def _error(self) -> ca.SX:
        """Desired less reported pose, angles within half a turn."""
        n = len(self._coordinates)
        named = zip(self._coordinates, ca.vertsplit(self._desired - self._y[:n]), strict=True)
        return ca.vertcat(*[_wrapped(e) if _is_angle(c) else e for c, e in named])

    def _gate(self) -> ca.SX:
        """The latch: once the heading has come within the gate, it stays open."""
        if not self._by_turns:
            return ca.SX(1)
        heading = self._error[self._coordinates.index("psi")]
        return ca.fmax(self._passed, ca.fabs(heading) <= self.gate)

    def _open(self, gate: ca.SX, coordinates: tuple[str, ...]) -> ca.SX:
        """For every coordinate, whether it is driven: those that wait only when the gate is open."""
        return ca.vertcat(*[gate if self._by_turns and c in _WAITING else ca.SX(1) for c in coordinates])

    def _law(self, gate: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Commands, rates of the law's states, and the force asked for."""
        law, signals = self.gains.law, self.gains.signals
        opened = self._open(gate, self._coordinates)
        open_states = ca.vertcat(*[opened] * len(law.states)) if law.states else ca.SX(0, 1)
        states = open_states * self._own
        convert = self._converter(opened * self._error, states, gate)
        # A force that nothing gives is left out where it is asked for, so that it counts as no limit.
        force = _only(convert.matrix(law.force(signals)), self.allocation.rows)
        commands = self.allocation.commands(force)
        early = self.gains.schedule.integrators == "start"
        rates = self._converter(self._error, self._own, ca.SX(1)) if early else convert
        moving = rates.matrix(law.rates(signals)) if law.states else ca.SX(0, 1)
        moving = moving if early else open_states * moving
        return commands, self._held(moving, force, commands, states, convert), force

    def _held(self, rates: ca.SX, force: ca.SX, commands: ca.SX, states: ca.SX, convert: Converter) -> ca.SX:
        """Rates of the law's states, zero for one that would ask for more of what the thrusters lack."""
        allocation, signals = self.allocation, self.gains.signals
        if not (allocation.limited and rates.numel() and self.gains.allocation.anti_windup == "hold"):
            return rates
        rows = list(allocation.rows)
        lacking = (force - allocation.delivered(commands))[rows]
        short = ca.sumsqr(lacking) > _ROUNDING**2 * ca.sumsqr(force[rows])
        asked = convert.matrix(self.gains.law.force(signals).jacobian(signals.states))[rows, :]
        pushes = (asked.T @ lacking) * rates > 0
        return rates * (1 - short * pushes)

    def _converter(self, error: ca.SX, states: ca.SX, gate: ca.SX) -> Converter:
        plant, signals = self.gains.plant, self.gains.signals
        idle = self._by_turns and not gate.is_one()
        seen = [
            gate * y if idle and str(v) in _IDLE else y
            for v, y in zip([*plant.eta, *plant.nu], ca.vertsplit(self._y), strict=True)
        ]
        gains = [sm.Symbol(name, real=True) for name in self.gain_names]
        groups = (
            ([*plant.eta, *plant.nu], ca.vertcat(*seen)),
            (signals.error, error),
            (signals.states, states),
            (gains, self._k),
        )
        known = {
            s: e for symbols, vector in groups for s, e in zip(symbols, ca.vertsplit(vector), strict=False)
        }
        return Converter(known | {s: ca.SX(float(v)) for s, v in plant.numbers.items()})


def _only(force: ca.SX, rows: tuple[int, ...]) -> ca.SX:
    """A force with the rows that are not allocated at zero."""
    result = ca.SX(*force.shape)
    for i in rows:
        result[i] = force[i]
    return result


def _is_angle(coordinate: str) -> bool:
    return POSE.index(coordinate) >= 3


def _wrapped(angle: ca.SX) -> ca.SX:
    """The same angle between minus and plus half a turn."""
    return angle - 2 * ca.pi * ca.floor((angle + ca.pi) / (2 * ca.pi))
