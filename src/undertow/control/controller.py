"""A control law as it runs on board: sampled, scheduled, allocated, with limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from math import inf, isfinite, pi
from typing import NamedTuple

import casadi as ca
import numpy as np
import sympy as sm

from undertow.codegen.expressions import Converter
from undertow.codegen.functions import solve_symmetric, wrapped
from undertow.errors import UndertowError
from undertow.model.symbols import FORCE, POSE
from undertow.model.units import si_of

from .gains import Allocation, GainSet, allocation_of
from .guidance.reference import DesiredMotion, Kinematics, Reference
from .laws import LawSignals


@dataclass(frozen=True)
class ControllerSettings:
    """The numbers of allocation with limits and of anti-windup."""

    # Added to the Gram matrix of the free thrusters, as a part of the mean of its diagonal: they may be too
    # few for all directions, then least squares is meant.
    damping: float = 1e-8
    rounding: float = 1e-9  # part of the wanted force that counts as rounding and not as a limit


SETTINGS = ControllerSettings()


# --- allocation -------------------------------------------------------------------------------
@dataclass(frozen=True)
class SymbolicAllocation:
    """An allocation as expressions: constants, or symbols whose values the caller has."""

    allocation: Allocation  # what it is made of: its zeros and infinite limits are constants in any case
    # acting, weights, limits: shapes (k, m), (m, 1) and (m, 1)
    allocated: ca.SX
    weights: ca.SX
    limits: ca.SX

    @classmethod
    def of(cls, allocation: Allocation) -> SymbolicAllocation:
        """The numbers of an allocation as constants."""
        allocated = ca.sparsify(ca.SX(ca.DM(allocation.allocated)))
        return cls(allocation, allocated, ca.SX(allocation.weights), ca.SX(allocation.limits))

    @classmethod
    def with_names(
        cls, allocation: Allocation, commands: Sequence[str], forces: Sequence[str]
    ) -> SymbolicAllocation:
        """The same with a symbol for every number that is neither zero nor infinite."""
        named = [
            [_symbol_unless(v, f"{f}_of_{c}", 0.0) for v, c in zip(row, commands, strict=True)]
            for row, f in zip(allocation.allocated, forces, strict=True)
        ]
        weights = [ca.SX.sym(f"weight_{c}") for c in commands]
        limits = [
            _symbol_unless(v, f"limit_{c}", inf) for v, c in zip(allocation.limits, commands, strict=True)
        ]
        allocated = ca.vertcat(*[ca.horzcat(*row) for row in named])
        return cls(allocation, allocated, ca.vertcat(*weights), ca.vertcat(*limits))

    def numbers(self) -> list[tuple[ca.SX, float]]:
        """Symbols and their values."""
        allocation = self.allocation
        values = [*allocation.allocated.ravel(order="F"), *allocation.weights, *allocation.limits]
        entries = [
            e for part in (self.allocated, self.weights, self.limits) for e in ca.vertsplit(ca.vec(part))
        ]
        return [(e, float(v)) for e, v in zip(entries, values, strict=True) if e.is_symbolic()]

    def unlimited(self, wanted: ca.SX) -> ca.SX:
        """Commands without regard to limits, f = W^-1 B' (B W^-1 B')^-1 tau."""
        b, inverse_weights = self.allocated, 1 / self.weights
        return inverse_weights * (b.T @ solve_symmetric(b @ ca.diag(inverse_weights) @ b.T, wanted))


def _symbol_unless(value: float, name: str, constant: float) -> ca.SX:
    return ca.SX(constant) if value == constant else ca.SX.sym(name)


def thruster_commands(symbolic: SymbolicAllocation, force: ca.SX) -> ca.SX:
    """Commands for a wanted force in all degrees of freedom, shape (n, 1) to (m, 1).

    Without limits f = W^-1 B' (B W^-1 B')^-1 tau, the solution with the least f' W f. With limits the same
    step is made as far as the first thruster that reaches its limit; that one stays there, and the free ones
    take over the rest of tau, in the least-squares sense if they are too few. Commands thus never exceed
    their limits, no iteration increases the remaining tau, and within the limits the result is that of the
    pseudo-inverse.
    """
    allocation = symbolic.allocation
    wanted = force[list(allocation.rows)]
    step = symbolic.unlimited(wanted)
    if not allocation.limited:
        return step
    b, m, limits = symbolic.allocated, len(allocation.limits), symbolic.limits
    commands, free = ca.SX.zeros(m, 1), ca.SX.ones(m, 1)
    limited: ca.SX = ca.SX(1)
    for _ in range(int(np.isfinite(allocation.limits).sum()) + 1):
        ratios = [_step_fraction(commands[i], step[i], limits[i]) for i in range(m)]
        share = ca.fmin(1, reduce(ca.fmin, ratios))
        commands = ca.fmax(-limits, ca.fmin(limits, commands + share * step))
        limited = limited * (share < 1)
        free = free * (ca.vertcat(*ratios) > share)
        step = limited * _step(symbolic, b, free, wanted - b @ commands)
    return commands


def _step_fraction(command: ca.SX, step: ca.SX, limit: ca.SX) -> ca.SX:
    """Fraction of a step that a command can make before it reaches its limit."""
    if limit.is_constant() and not isfinite(float(limit)):
        return ca.SX(inf)
    return ca.if_else(step == 0, inf, (limit - ca.sign(step) * command) / ca.fabs(step))


def _step(symbolic: SymbolicAllocation, b: ca.SX, free: ca.SX, remaining: ca.SX) -> ca.SX:
    """Change of the free commands that brings the rest of the force, or as much of it as they can."""
    k, inverse_weights = len(symbolic.allocation.rows), free / symbolic.weights
    gram = b @ ca.diag(inverse_weights) @ b.T
    damping = SETTINGS.damping * ca.trace(b @ ca.diag(1 / symbolic.weights) @ b.T) / k
    return inverse_weights * (b.T @ solve_symmetric(gram + damping * ca.SX.eye(k), remaining))


GATE = "gate"
# What waits for the heading, and the motions that the law does not even brake meanwhile.
_GATED, _UNBRAKED = ("x", "y"), ("u", "v")


class ParametrisedController(NamedTuple):
    """A controller with its numbers p as an input."""

    control: ca.Function  # `(u, s_next, tau) = control(y, r, s, p, dt)`: `Controller.sampled`
    allocate: ca.Function  # `u = allocate(tau, p)`: `thruster_commands`
    # the values of p by name: gains; masses, weight and the like that the law is stated in; matrix, weights
    # and limits of the allocation
    values: Mapping[str, float]


class Controller:
    """A gain set as CasADi functions of what the sensors report.

    y is the reported pose and velocity in the vehicle's degrees of freedom, r the desired pose, s the states
    of the law and a last one for the gate (0 closed, 1 passed), k the gains and then the finite limits of
    the commands, all in SI. With a reference r are the numbers of its mission, and its states stand in s
    between those of the law and the gate.
    """

    def __init__(self, gains: GainSet, reference: Reference | None = None) -> None:
        self.gains, self.reference = gains, reference
        self.allocation: Allocation = allocation_of(gains)
        self._gate_angle = ca.SX(self.gate)
        self._coordinates = gains.plant.vehicle.pose_names
        self._check_schedule()
        self._numbers = {s: ca.SX(float(v)) for s, v in gains.plant.numbers.items()}
        n, n_states = len(self._coordinates), len(self.state_names)
        self._y, self._r = ca.SX.sym("y", 2 * n), ca.SX.sym("r", len(reference.numbers) if reference else n)
        n_reference = len(reference.state_names) if reference else 0
        self._law_states, self._gate_state = ca.SX.sym("s", n_states - 1 - n_reference), ca.SX.sym(GATE)
        self._reference_states = ca.SX.sym("at", n_reference)
        self._k, self._dt = ca.SX.sym("k", len(self.gain_names)), ca.SX.sym("dt")
        named = dict(zip(self.gain_names, ca.vertsplit(self._k), strict=True))
        constant = SymbolicAllocation.of(self.allocation)
        limits = [
            named[self._limits[i]] if i in self._limits else limit
            for i, limit in enumerate(ca.vertsplit(constant.limits))
        ]
        self._symbolic = replace(constant, limits=ca.vertcat(*limits))

    def _check_schedule(self) -> None:
        missing = [c for c in ("x", "psi") if c not in self._coordinates]
        if self._yaw_first and missing:
            raise UndertowError(
                f"[schedule] order = 'yaw-first' needs {missing[0]}, which '{self.gains.plant.vehicle.name}' "
                'does not have: write order = "together"'
            )
        if self._yaw_first and self.reference is not None:
            raise UndertowError(
                "[schedule] order = 'yaw-first' waits for the heading of a set-point, but a mission moves: "
                'write order = "together" (--order together)'
            )
        if not 0 < self.gate <= pi:
            fault = "beyond 180 deg, the largest heading error" if self.gate > pi else "not above zero"
            raise UndertowError(
                f"[schedule] gate = {self.gains.schedule.gate} is {fault}: give an angle of up to 180 deg "
                "(a number without a unit is in rad)"
            )

    # --- names and numbers --------------------------------------------------------------------
    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the entries of s."""
        followed = self.reference.state_names if self.reference else ()
        return (*self.gains.law.state_names(self._coordinates), *followed, GATE)

    @property
    def gain_names(self) -> tuple[str, ...]:
        """Names of the entries of k: K_P_x ... of the law, then limit_f1 ... of commands that have one."""
        own = (str(g.symbol(c)) for g in type(self.gains.law).gains for c in self._coordinates)
        return (*own, *self._limits.values())

    @property
    def _limits(self) -> dict[int, str]:
        """Names of the finite limits, by place of the command."""
        pairs = enumerate(zip(self.command_names, self.allocation.limits, strict=True))
        return {i: f"limit_{c}" for i, (c, limit) in pairs if isfinite(limit)}

    def gain_values(self) -> list[float]:
        """Values of k."""
        limits = {name: float(self.allocation.limits[i]) for i, name in self._limits.items()}
        return [limits[name] if name in limits else self.gains.values[name] for name in self.gain_names]

    def initial_states(self) -> list[float]:
        """Values of s at the start: integrals at zero, the gate closed where there is one."""
        reference = self.reference.initial_states() if self.reference else []
        n_law = len(self.state_names) - 1 - len(reference)
        return [*[0.0] * n_law, *reference, 0.0 if self._yaw_first else 1.0]

    @property
    def mission_numbers(self) -> list[float]:
        """Values of r where there is a reference."""
        return [n.value for n in self.reference.numbers] if self.reference else []

    @property
    def command_names(self) -> tuple[str, ...]:
        """Names of the commands."""
        return self.gains.plant.vehicle.command_names

    @cached_property
    def gate(self) -> float:
        """Error of the heading that opens the gate, rad."""
        return si_of("[schedule] gate", self.gains.schedule.gate, "rad")

    @property
    def _yaw_first(self) -> bool:
        return self.gains.schedule.order == "yaw-first"

    # --- functions ----------------------------------------------------------------------------
    @cached_property
    def sampled(self) -> ca.Function:
        """`(u, s_next, tau) = control(y, r, s, k, dt)`: one sample, its commands held for dt.

        tau is the force that the law asks for, in body axes; an integral advances by dt times its rate.
        """
        return self._function("control", [self._dt], self._sample(), ["u", "s_next", "tau"])

    def _sample(self) -> list[ca.SX]:
        """Commands, states of the next sample, and the force asked for."""
        gate = self._gate()
        commands, rates, force = self._law_outputs(gate)
        at = self._reference_states
        if self.reference is not None:
            at = self.reference.advance(self._r, at, self._kinematics, self._dt)
        return [commands, ca.vertcat(self._law_states + self._dt * rates, at, gate), force]

    @cached_property
    def continuous(self) -> ca.Function:
        """`(u, s_dot, tau) = law(y, r, s, k)`: commands and rates in continuous time, the gate as in s."""
        commands, rates, force = self._law_outputs(self._gate_state)
        # The time goes on; a reference that has more is sampled.
        at = ca.SX.ones(self._reference_states.shape)
        return self._function("law", [], [commands, ca.vertcat(rates, at, 0), force], ["u", "s_dot", "tau"])

    def parametrised(self) -> ParametrisedController:
        """The controller with every number of the files as an input."""
        other, vehicle = copy(self), self.gains.plant.vehicle
        plant = [(s, ca.SX.sym(str(s)), float(v)) for s, v in self.gains.plant.numbers.items()]
        other._numbers = {s: e for s, e, _ in plant}
        rows = [f"tau_{FORCE[vehicle.dof_indices[i]]}" for i in self.allocation.rows]
        other._symbolic = symbolic = SymbolicAllocation.with_names(self.allocation, self.command_names, rows)
        other._gate_angle = ca.SX.sym(GATE)
        gains = [ca.SX.sym(name) for name in self.gain_names]
        known = [
            *zip(gains, self.gain_values(), strict=True),
            *((e, v) for _, e, v in plant),
            *symbolic.numbers(),
            (other._gate_angle, self.gate),
        ]
        tau = ca.SX.sym("tau", len(self._coordinates))
        asked = ca.substitute(other._sample(), [self._k], [ca.vertcat(*gains)])
        results = [ca.densify(o) for o in (*ca.cse(asked), thruster_commands(symbolic, tau))]
        used = {e.element_hash() for e in ca.symvar(ca.vertcat(*map(ca.vec, results)))}
        used_entries = [(e, v) for e, v in known if e.element_hash() in used]
        p = ca.vertcat(*[e for e, _ in used_entries])
        states = ca.vertcat(self._law_states, self._reference_states, self._gate_state)
        signature = [self._y, self._r, states, p, self._dt], results[:3]
        control = ca.Function("control", *signature, ["y", "r", "s", "p", "dt"], ["u", "s_next", "tau"])
        allocate = ca.Function("allocate", [tau, p], results[3:], ["tau", "p"], ["u"])
        return ParametrisedController(control, allocate, {e.name(): v for e, v in used_entries})

    def _function(self, name: str, more: list[ca.SX], outputs: list[ca.SX], names: list[str]) -> ca.Function:
        states = ca.vertcat(self._law_states, self._reference_states, self._gate_state)
        inputs = [self._y, self._r, states, self._k, *more]
        input_names = ["y", "r", "s", "k", *["dt", "m"][: len(more)]]
        return ca.Function(name, inputs, [ca.densify(o) for o in ca.cse(outputs)], input_names, names)

    # --- the reference ----------------------------------------------------------------------------
    @cached_property
    def _kinematics(self) -> Kinematics:
        plant, n = self.gains.plant, len(self._coordinates)
        seen = zip([*plant.eta, *plant.nu], ca.vertsplit(self._y), strict=True)
        convert = Converter(dict(seen))
        J = (convert.matrix(m) for m in (plant.J_inverse, plant.J_dot))
        return Kinematics(self._coordinates, self._y[:n], self._y[n:], *J)

    @cached_property
    def _desired(self) -> DesiredMotion:
        """What is followed: the pose of r, at rest, where there is no reference."""
        if self.reference is None:
            still = ca.SX(len(self._coordinates), 1)
            return DesiredMotion(self._r, still, still)
        return self.reference.desired(self._r, self._reference_states, self._kinematics)

    # --- the law --------------------------------------------------------------------------------
    @cached_property
    def _error(self) -> ca.SX:
        """Desired less reported pose, angles within half a turn."""
        n = len(self._coordinates)
        named = zip(self._coordinates, ca.vertsplit(self._desired.eta_d - self._y[:n]), strict=True)
        return ca.vertcat(*[wrapped(e) if POSE.index(c) >= 3 else e for c, e in named])

    def _gate(self) -> ca.SX:
        """The latch: once the heading has come within the gate, it stays open."""
        if not self._yaw_first:
            return ca.SX(1)
        heading = self._error[self._coordinates.index("psi")]
        return ca.fmax(self._gate_state, ca.fabs(heading) <= self._gate_angle)

    def _law_outputs(self, gate: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Commands, rates of the law's states, and the force asked for."""
        law, signals = self.gains.law, self._signals
        # For every coordinate, whether it is driven: those that wait only when the gate is open.
        enabled = ca.vertcat(
            *[gate if self._yaw_first and c in _GATED else ca.SX(1) for c in self._coordinates]
        )
        open_states = ca.vertcat(*[enabled] * len(law.states)) if law.states else ca.SX(0, 1)
        states = open_states * self._law_states
        convert = self._converter(enabled * self._error, states, gate)
        # A force that nothing gives is left out where it is asked for, so that it counts as no limit.
        force, asked = ca.SX(len(self._coordinates), 1), convert.matrix(law.force(signals))
        for i in self.allocation.rows:
            force[i] = asked[i]
        commands = thruster_commands(self._symbolic, force)
        early = self.gains.schedule.integrators == "start"
        rates = self._converter(self._error, self._law_states, ca.SX(1)) if early else convert
        state_rates = rates.matrix(law.rates(signals)) if law.states else ca.SX(0, 1)
        state_rates = state_rates if early else open_states * state_rates
        return commands, self._anti_windup(state_rates, force, commands, convert), force

    def _anti_windup(self, rates: ca.SX, force: ca.SX, commands: ca.SX, convert: Converter) -> ca.SX:
        """Rates of the law's states, zero for one that would ask for more of what the thrusters lack."""
        allocation, signals = self.allocation, self._signals
        if not (allocation.limited and rates.numel() and self.gains.allocation.anti_windup == "hold"):
            return rates
        rows = list(allocation.rows)
        lacking = force[rows] - self._symbolic.allocated @ commands
        short = ca.sumsqr(lacking) > SETTINGS.rounding**2 * ca.sumsqr(force[rows])
        slope = convert.matrix(self.gains.law.force(signals).jacobian(signals.states))[rows, :]
        pushes = (slope.T @ lacking) * rates > 0
        return rates * (1 - short * pushes)

    @property
    def _signals(self) -> LawSignals:
        return self.gains.signals if self.reference is None else self.gains.tracking

    @property
    def _feed_forward(self) -> list[tuple[sm.Matrix, ca.SX]]:
        """Symbols of a reference that moves with what they are."""
        if self.reference is None:
            return []
        signals, course = self._signals, self._desired
        return [(signals.nu_r, course.nu_r), (signals.nu_r_dot, course.nu_r_dot)]

    def _converter(self, error: ca.SX, states: ca.SX, gate: ca.SX) -> Converter:
        plant, signals = self.gains.plant, self._signals
        idle = self._yaw_first and not gate.is_one()
        uncontrolled = self.reference.uncontrolled if self.reference else ()
        seen = [
            ca.SX(0) if str(v) in uncontrolled else gate * y if idle and str(v) in _UNBRAKED else y
            for v, y in zip([*plant.eta, *plant.nu], ca.vertsplit(self._y), strict=True)
        ]
        gains = [sm.Symbol(name, real=True) for name in self.gain_names]
        groups = (
            ([*plant.eta, *plant.nu], ca.vertcat(*seen)),
            (signals.error, error),
            (signals.states, states),
            (gains, self._k),
            *self._feed_forward,
        )
        known = {
            s: e for symbols, vector in groups for s, e in zip(symbols, ca.vertsplit(vector), strict=False)
        }
        return Converter(known | self._numbers)
