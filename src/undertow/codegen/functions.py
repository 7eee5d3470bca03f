"""The CasADi functions of a vehicle: dynamics, Jacobians, regressor, residual, outputs, and their parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isclose

import casadi as ca
import sympy as sm

from undertow.model.composition import stated
from undertow.model.effect import ACTUATORS, Curve, Flow, Number, Propeller, Surface, Wrench
from undertow.model.symbols import column, symbol
from undertow.model.vehicle import Thruster, Vehicle
from undertow.typing import Array

from .expressions import Collector, Converter, Inertia, find_inertia, is_galilean, kirchhoff


def _with_tied(vehicle: Vehicle, equal: Mapping[str, tuple[str, float]]) -> dict[str, tuple[str, float]]:
    """Equalities with what the vehicle ties itself, in terms of parameters that follow no other."""
    found = dict(equal)
    for name, (other, factor) in vehicle.tied.items():
        leader, share = equal.get(other, (other, 1.0))
        found.setdefault(name, (leader, factor * share))
    return found


class Functions:
    """Everything numeric that follows from a vehicle, as CasADi expressions and functions.

    The state is x = (pose, velocity, states that effects own) in the vehicle's degrees of freedom, u the
    commands (thrusters, surfaces, known forces, logged inputs), p the parameters as in `parameter_names`, t
    the time in s. `equal` has parameters that are a multiple of another one: name to (name of the other,
    factor), SNAME signs, what the vehicle's file leaves to another one among them; their own entry of p has
    no effect.

    With `named`, for code that others use, the numbers of the hardware are parameters, too, which follow p
    where functions are given p, and no parameter follows another one.
    """

    def __init__(
        self, vehicle: Vehicle, equal: Mapping[str, tuple[str, float]] | None = None, *, named: bool = False
    ) -> None:
        self.equal = {} if named else _with_tied(vehicle, equal or {})
        self.vehicle, hardware = with_names(vehicle) if named else (vehicle, ())
        composition = self.vehicle.composition
        self.hardware = tuple(n for n in hardware if n.name in composition.names)
        self._actuator_output, self._actuator_rates, self._actuator_rest = composition.chain
        self._memory = composition.wrench_states
        self.eta, self.nu, self.nu_dot = (
            ca.SX.sym(name, len(getattr(composition, name))) for name in ("eta", "nu", "nu_dot")
        )
        self.memory = ca.SX.sym("memory", len(self._memory))
        self.actuator_states = ca.SX.sym("actuator", len(self._actuator_rates))
        self.u = ca.SX.sym("u", len(composition.commands))
        self.p = ca.SX.sym("p", len(self.parameter_names))
        self._places = ca.SX.sym("hardware", len(self.hardware))
        self.t = ca.SX.sym("t")
        self.actuation = ca.SX.sym("actuation", len(composition.actuation))
        self.convert = Converter(self._environment())
        self._define_relations({n.symbol: sm.Float(n.value) for n in hardware})

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the entries of p."""
        return self.vehicle.parameter_names

    def followers(self, name: str) -> dict[str, float]:
        """Parameters that are multiples of one, with their factors."""
        return {follower: factor for follower, (other, factor) in self.equal.items() if other == name}

    @property
    def numbers(self) -> ca.SX:
        """What functions are given as p: the parameters, and then the numbers of the hardware."""
        return ca.vertcat(self.p, self._places)

    @property
    def number_names(self) -> tuple[str, ...]:
        """Names of its entries."""
        return (*self.parameter_names, *(n.name for n in self.hardware))

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the entries of x."""
        owned = (*map(str, self._memory), *map(str, self._actuator_rates))
        return (*self.vehicle.pose_names, *self.vehicle.velocity_names, *owned)

    @property
    def x(self) -> ca.SX:
        """The state."""
        return ca.vertcat(self.eta, self.nu, self.memory, self.actuator_states)

    def _environment(self) -> dict[sm.Symbol, ca.SX]:
        composition = self.vehicle.composition
        names = [symbol(n) for n in self.parameter_names]
        groups = (
            (composition.eta, self.eta),
            (composition.nu, self.nu),
            (composition.nu_dot, self.nu_dot),
            (composition.commands, self.u),
            (composition.actuation, self.actuation),
            (list(self._memory), self.memory),
            (list(self._actuator_rates), self.actuator_states),
            (names, self._own_or_tied() if self.equal else self.p),
            ([n.symbol for n in self.hardware], self._places),
            ([composition.signals.t], self.t),
        )
        known = {
            s: e for symbols, vector in groups for s, e in zip(symbols, ca.vertsplit(vector), strict=False)
        }
        return known | {s: ca.SX(0) for s in composition.locked}

    def _own_or_tied(self) -> ca.SX:
        """Every parameter in the equations: its own entry of p, or a multiple of another one."""
        names = self.parameter_names
        tied = [self.equal.get(name, (name, 1.0)) for name in names]
        return ca.vertcat(*[factor * self.p[names.index(other)] for other, factor in tied])

    def _define_relations(self, hardware: Mapping[sm.Symbol, sm.Expr]) -> None:
        composition = self.vehicle.composition
        states = [x for e in composition.effects for x in e.state_symbols]
        parameters = [symbol(n) for n in self.vehicle.declared_parameters]
        known = {symbol(n) for n in self.parameter_names}
        directional = {x: e for x, e in composition.directional.items() if e.free_symbols & known}
        kept = {*self._memory, *self._actuator_rates, *known, *directional}
        # What the degrees of freedom cannot show is multiplied by a locked motion, that is by zero.
        self.convert.define({x: sm.Integer(0) for x in [*states, *parameters] if x not in kept})
        # It may be divided by what is constant in the world, so that this is no zero.
        world = {symbol(n): sm.Float(v) for n, v in self.vehicle.environment.items()} | dict(hardware)
        known |= {n.symbol for n in self.hardware}
        self.convert.define({x: value for x, value in world.items() if x not in known})
        self._define_water()
        self.convert.define(directional)

    def _define_water(self) -> None:
        composition = self.vehicle.composition
        symbols = [column([f"{what}_{axis}" for axis in "xyz"]) for what in ("water", "rate")]
        relative = composition.relative_to(*symbols)
        felt = {x for e in relative.values() for x in e.free_symbols}
        meaning = zip([*symbols[0], *symbols[1]], sm.Matrix.vstack(*composition.water), strict=True)
        # Water that moves along a locked axis alone may do so with parameters that no equation has.
        self.convert.define({x: e if x in felt else sm.Integer(0) for x, e in meaning})
        self.convert.define(relative)
        self.water_rate = self.convert.matrix(symbols[1])

    # --- expressions --------------------------------------------------------------------------
    @cached_property
    def wrenches(self) -> dict[str, ca.SX]:
        """Wrench of every effect by id in the vehicle's degrees of freedom, from `actuation` and `nu_dot`."""
        rows = list(self.vehicle.dof_indices)
        return {i: self.convert.matrix(w.extract(rows, [0])) for i, w in self.stated.items()}

    @cached_property
    def stated(self) -> dict[str, sm.Matrix]:
        """Wrench of every effect by id as it states it, shape (6, 1)."""
        return {e.id: stated(e).as_mutable() for e in self.vehicle.all_effects if isinstance(e, Wrench)}

    @cached_property
    def residual(self) -> ca.SX:
        """Sum of the wrenches, N and N m, from `actuation` and `nu_dot`."""
        return sum(self.wrenches.values(), ca.SX(len(self.vehicle.dof_indices), 1))

    @cached_property
    def control_force(self) -> ca.SX:
        """Force of thrusters, propellers, rudders and known forces, from `actuation`, N and N m."""
        acting = (e.id for e in self.vehicle.all_effects if isinstance(e, Wrench) and e.family == "actuation")
        return sum((self.wrenches[i] for i in acting), ca.SX(len(self.vehicle.dof_indices), 1))

    @cached_property
    def mass_matrix(self) -> ca.SX:
        """M = -d(residual)/d(nu_dot)."""
        return -ca.jacobian(self.residual, self.nu_dot)

    @cached_property
    def forcing(self) -> ca.SX:
        """Residual at rest of the acceleration, from `actuation`."""
        return ca.cse(ca.substitute(self.residual, self.nu_dot, ca.SX.zeros(self.nu_dot.shape)))

    @cached_property
    def actuator_output(self) -> ca.SX:
        """What reaches the thrusters, in units of the command, from u and the actuator states."""
        return self.convert.matrix(self._actuator_output)

    @cached_property
    def actuator_rates(self) -> ca.SX:
        """Time derivative of the actuator states."""
        return self.convert.matrix(sm.Matrix(list(self._actuator_rates.values()) or sm.zeros(0, 1)))

    @cached_property
    def actuator_rest(self) -> ca.SX:
        """Actuator states that belong to commands held for a long time."""
        values = [v.xreplace(self._actuator_rest) for v in self._actuator_rest.values()]
        return self.convert.matrix(sm.Matrix(values or sm.zeros(0, 1)))

    @cached_property
    def memory_rates(self) -> ca.SX:
        """Time derivative of the states that wrenches own."""
        s = self.vehicle.composition.signals
        rates = {
            x: rate
            for e in self.vehicle.all_effects
            if isinstance(e, Wrench)
            for x, rate in zip(e.state_symbols, e.spelled_out(e.rates(s), s), strict=True)
        }
        return self.convert.matrix(sm.Matrix([rates[x] for x in self._memory] or sm.zeros(0, 1)))

    @cached_property
    def pose_rate(self) -> ca.SX:
        """d(eta)/dt = J(eta) nu."""
        return self.convert.matrix(self.vehicle.composition.pose_rate)

    @cached_property
    def reported(self) -> ca.SX:
        """Pose and velocity as the sensors report them."""
        eta, nu = self.vehicle.composition.reported
        return ca.vertcat(self.convert.matrix(eta), self.convert.matrix(nu))

    @cached_property
    def report_age(self) -> ca.SX:
        """How old pose and velocity are when the sensors report them, shape (2n,), s."""
        return self.convert.matrix(self.vehicle.composition.report_age)

    @cached_property
    def x_dot(self) -> ca.SX:
        """Time derivative of the state, from x, u, p, t; M is solved for, never inverted symbolically."""
        return ca.cse(self.with_acceleration(solve_symmetric(self.mass_matrix, self._driven_forcing)))

    @property
    def _driven_forcing(self) -> ca.SX:
        """Residual at rest of the acceleration, as the commands drive it."""
        return ca.substitute(self.forcing, self.actuation, self.actuator_output)

    def with_acceleration(self, rows: ca.SX) -> ca.SX:
        """x_dot with these in the rows of the acceleration."""
        return ca.vertcat(self.pose_rate, rows, self._own_rates)

    @property
    def _own_rates(self) -> ca.SX:
        """Rates of the states that effects own, as the commands drive them."""
        memory = ca.substitute(self.memory_rates, self.actuation, self.actuator_output)
        return ca.vertcat(memory, self.actuator_rates)

    @property
    def acceleration_rows(self) -> slice:
        """Rows of x_dot that hold the acceleration."""
        n = self.nu_dot.numel()
        return slice(n, 2 * n)

    @cached_property
    def balance(self) -> ca.SX:
        """x_dot with the residual in the rows of the acceleration: one equation for each state."""
        return self.with_acceleration(self.driven_residual)

    @property
    def _slopes_at_rest(self) -> ca.SX:
        """d(nu_dot)/d(nu) at rest, 1/s."""
        slopes = solve_symmetric(self.mass_matrix, ca.densify(ca.jacobian(self._driven_forcing, self.nu)))
        return ca.substitute(slopes, self.nu, ca.SX.zeros(self.nu.shape))

    # --- functions ----------------------------------------------------------------------------
    @property
    def _inputs(self) -> list[ca.SX]:
        return [self.x, self.u, self.numbers, self.t]

    def _function(self, name: str, outputs: list[ca.SX], output_names: list[str]) -> ca.Function:
        return ca.Function(
            name, self._inputs, [ca.densify(o) for o in outputs], ["x", "u", "p", "t"], output_names
        )

    @cached_property
    def dynamics(self) -> ca.Function:
        """`x_dot = dynamics(x, u, p, t)`."""
        return self._function("dynamics", [self.x_dot], ["x_dot"])

    @cached_property
    def quickest(self) -> ca.Function:
        """`slopes = quickest(x, u, p, t)`: how fast velocities are at rest, where friction is stiffest, and
        the states that effects own.

        d(rates)/d(states) in 1/s, in one block for the velocities and one for the states.
        """
        slopes = ca.jacobian(self._own_rates, ca.vertcat(self.memory, self.actuator_states))
        return self._function("quickest", [ca.cse(ca.diagcat(self._slopes_at_rest, slopes))], ["slopes"])

    @cached_property
    def motion_slopes(self) -> ca.Function:
        """`slopes = motion_slopes(x, u, p, t)`: d(rates)/d(states) of pose and velocity, 1/s, with actuators
        at rest and without memory.
        """
        motion = slice(2 * self.nu_dot.numel())
        slopes = ca.jacobian(self.x_dot[motion], self.x[motion])
        slopes = ca.substitute(slopes, self.actuator_states, self.actuator_rest)
        slopes = ca.substitute(slopes, self.memory, ca.SX.zeros(self.memory.shape))
        return self._function("motion_slopes", [ca.cse(slopes)], ["slopes"])

    @cached_property
    def prepared(self) -> Prepared:
        """`q = prepare(p)` once, then `x_dot = dynamics(x, u, q, t)` with few operations."""
        return prepared(self)

    def tangents(self, *with_respect_to: str) -> ca.Function:
        """`(x_dot, W, R_a, R_b ...) = tangents(x, u, p, t)` for a, b ... among x, u, p, numbers; sparse R.

        d(x_dot)/da is R_a = d(balance)/da at the acceleration, with the rows of the acceleration multiplied
        by W, the inverse of M. That is what differentiating M a = f gives; it costs far less than the
        derivative of a solution.
        """
        acceleration = self.x_dot[self.acceleration_rows]
        inverse = solve_symmetric(self.mass_matrix, ca.SX.eye(self.nu_dot.numel()))
        by = {"x": self.x, "u": self.u, "p": self.p, "numbers": self.numbers}
        jacobians = [ca.jacobian(self.balance, by[v]) for v in with_respect_to]
        slopes = [ca.substitute(j, self.nu_dot, acceleration) for j in jacobians]
        outputs = ca.cse([ca.densify(self.x_dot), ca.densify(inverse), *slopes])
        names = ["x_dot", "W", *(f"R_{v}" for v in with_respect_to)]
        return ca.Function("tangents", self._inputs, outputs, ["x", "u", "p", "t"], names)

    @cached_property
    def jacobians(self) -> ca.Function:
        """`(x_dot, A, B, P) = jacobians(x, u, p, t)`: derivatives in state, input and parameters."""
        return self.jacobians_by("p")

    def jacobians_by(self, parameters: str) -> ca.Function:
        """The same in "p", or in all "numbers" that functions are given as p."""
        inputs = [ca.MX.sym(n, s.shape) for n, s in zip("xupt", self._inputs, strict=True)]
        x_dot, inverse, *slopes = self.tangents("x", "u", parameters)(*inputs)
        rows = self.acceleration_rows
        solved = [ca.vertcat(r[: rows.start, :], inverse @ r[rows, :], r[rows.stop :, :]) for r in slopes]
        names = ["x", "u", "p", "t"], ["x_dot", "A", "B", "P"]
        return ca.Function("jacobians", inputs, [x_dot, *map(ca.densify, solved)], *names)

    @cached_property
    def outputs(self) -> ca.Function:
        """`y = outputs(x, u, p, t)`: reported pose and velocity."""
        return self._function("outputs", [self.reported], ["y"])

    @cached_property
    def rest(self) -> ca.Function:
        """`z = rest(u, p, t)`: states of the actuation that belong to commands held for long."""
        return ca.Function("rest", [self.u, self.numbers, self.t], [ca.densify(self.actuator_rest)])

    @cached_property
    def dead_time(self) -> ca.Function:
        """`s = dead_time(p)`: delay between command and thrust, s."""
        return ca.Function("dead_time", [self.numbers], [self.convert(self.vehicle.composition.dead_time)])

    def late(self, values: Sequence[float] | Array | None = None) -> tuple[float, dict[str, float]]:
        """Dead time of the inputs, and of the outputs that come late by name, s.

        For values of the parameters, the vehicle's unless given.
        """
        p = self.values() if values is None else values
        age = ca.Function("report_age", [self.numbers], [ca.densify(self.report_age)])
        ages = age(p).full().ravel().tolist()
        names = (*self.vehicle.pose_names, *self.vehicle.velocity_names)
        return float(self.dead_time(p)), {n: s for n, s in zip(names, ages, strict=True) if s}

    @cached_property
    def residual_function(self) -> ca.Function:
        """`r = residual(x, nu_dot, u, p, t)`, N and N m."""
        return self._with_acceleration("residual", self.driven_residual, "r")

    @cached_property
    def regressor(self) -> ca.Function:
        """`Y = regressor(x, nu_dot, u, p, t)` = d(residual)/dp, shape (n, n_parameters)."""
        return self._with_acceleration("regressor", ca.jacobian(self.driven_residual, self.p), "Y")

    @property
    def driven_residual(self) -> ca.SX:
        """Sum of the wrenches as the commands drive them, N and N m."""
        return ca.substitute(self.residual, self.actuation, self.actuator_output)

    def _with_acceleration(self, name: str, output: ca.SX, output_name: str) -> ca.Function:
        inputs = [self.x, self.nu_dot, self.u, self.numbers, self.t]
        return ca.Function(name, inputs, [ca.densify(output)], ["x", "nu_dot", "u", "p", "t"], [output_name])

    def values(self) -> list[float]:
        """Values in the vehicle of what functions are given as p."""
        own = [self.vehicle.value_of(n).value for n in self.parameter_names]
        return [*own, *(n.value for n in self.hardware)]


# --- the dynamics in two steps --------------------------------------------------------------------
@dataclass(frozen=True)
class Prepared:
    """The dynamics for many evaluations with the same parameters."""

    # `q = prepare(p)`: coefficients, with the inverse of M where it depends on parameters alone
    prepare: ca.Function
    dynamics: ca.Function  # `x_dot = dynamics(x, u, q, t)`
    # `w = hold(u, q)`: what follows from q and inputs, for many evaluations with the same inputs
    hold: ca.Function
    held_dynamics: ca.Function  # `x_dot = held_dynamics(x, w, q, t)`


def prepared(functions: Functions) -> Prepared:
    """The dynamics of a vehicle in two steps."""
    x, u, p, t = functions.x, functions.u, functions.p, functions.t
    by_parameters = Collector(p, ca.vertcat(x, u, t), ready=ca.SX(0, 1), name="q")
    rates = by_parameters.rewrite(functions.with_acceleration(acceleration(functions)))
    q = by_parameters.symbols
    by_inputs = Collector(ca.vertcat(u, q), ca.vertcat(x, t), ready=q, name="w")
    held_rates = by_inputs.rewrite(rates)
    w = by_inputs.symbols
    return Prepared(
        ca.Function("prepare", [p], [by_parameters.coefficients], ["p"], ["q"]),
        ca.Function("dynamics", [x, u, q, t], [rates], ["x", "u", "q", "t"], ["x_dot"]),
        ca.Function("hold", [u, q], [by_inputs.coefficients], ["u", "q"], ["w"]),
        ca.Function("held_dynamics", [x, w, q, t], [held_rates], ["x", "w", "q", "t"], ["x_dot"]),
    )


def acceleration(functions: Functions) -> ca.SX:
    """d(nu)/dt from x, u, p, t, with the inertial wrenches stated by their momentum."""
    f, rows = functions, functions.vehicle.dof_indices
    composition = f.vehicle.composition
    inertia = find_inertia(f.stated, composition.signals, f.convert, f.p, rows, composition.inputs)
    others = sum((w for i, w in f.wrenches.items() if i not in inertia.ids), ca.SX(len(rows), 1))
    others = ca.substitute(others, f.actuation, f.actuator_output)
    other_mass = -ca.jacobian(others, f.nu_dot)
    still = ca.substitute(others, f.nu_dot, ca.SX.zeros(f.nu_dot.shape))
    mass = (inertia.mass + inertia.water_mass)[list(rows), list(rows)] + other_mass
    force, drift = _inertial_force(f, inertia)
    force, drift = force[list(rows)], drift[list(rows)]
    return solution(mass, still + force + other_mass @ drift, ca.vertcat(f.x, f.u, f.t)) - drift


def _inertial_force(f: Functions, inertia: Inertia) -> tuple[ca.SX, ca.SX]:
    """Inertial forces where nu_dot is the negative of a drift of the water, and that drift; shapes (6, 1)."""
    composition = f.vehicle.composition
    s, flows = composition.signals, composition.of_kind(Flow)
    nu, nu_r, nu_r_dot = map(f.convert.matrix, (s.nu, s.nu_r, s.nu_r_dot))
    drift = ca.substitute(nu_r_dot, f.nu_dot, ca.SX.zeros(f.nu_dot.shape))
    if flows and not is_galilean(inertia, f.p, composition.dofs):
        force = inertia.water_mass @ drift + kirchhoff(inertia.water_momentum, nu_r)
        return -force - kirchhoff(inertia.momentum, nu), ca.SX(6, 1)
    # A steady flow may as well be at rest, with the vehicle moving through it; its rate remains.
    momentum = inertia.momentum + inertia.water_momentum
    return -inertia.mass[:, :3] @ f.water_rate - kirchhoff(momentum, nu_r), drift


def wrapped(angle: ca.SX) -> ca.SX:
    """The same angle between minus and plus half a turn."""
    return angle - 2 * ca.pi * ca.floor((angle + ca.pi) / (2 * ca.pi))


# --- systems of linear equations, symbolically ----------------------------------------------------
def solve_symmetric(matrix: ca.SX, right: ca.SX) -> ca.SX:
    """Solution of a symmetric positive definite system by L D L', keeping structural zeros."""
    if matrix.shape == (1, 1):
        return right / matrix
    d, lt, permutation = ca.ldl(matrix)
    return ca.ldl_solve(right, d, lt, permutation)


def solution(matrix: ca.SX, right: ca.SX, moving: ca.SX) -> ca.SX:
    """Solution of such a system, by the inverse of the matrix if no `moving` symbol is in it."""
    if ca.depends_on(matrix, moving):
        return solve_symmetric(matrix, right)
    return solve_symmetric(matrix, ca.SX.eye(matrix.shape[0])) @ right


# --- numbers of thrusters, propellers and surfaces by name, for code that takes them as parameters ---------
_AXES = "xyz"


@dataclass(frozen=True)
class HardwareNumber:
    """A number that a vehicle file states of its hardware."""

    name: str
    unit: str  # SI; "command" stands for the unit of a thruster's command
    value: float
    symbol: sm.Symbol  # what stands for it in equations


@dataclass
class _Names:
    """Symbols that stand for numbers, and these."""

    taken: set[str]
    numbers: list[HardwareNumber] = field(default_factory=list)

    def of(self, name: str, unit: str, value: Number, nonzero: bool | None = None) -> sm.Symbol:
        """A symbol for a number."""
        while name in self.taken:
            name += "_"
        self.taken.add(name)
        own = sm.Symbol(name, real=True, nonzero=True) if nonzero else symbol(name)
        self.numbers.append(HardwareNumber(name, unit, float(value), own))
        return own

    def row(self, what: str, owner: str, unit: str, values: Sequence[Number]) -> tuple[sm.Symbol, ...]:
        """Symbols for the components of a vector."""
        return tuple(self.of(f"{what}_{a}_{owner}", unit, v) for a, v in zip(_AXES, values, strict=True))


def with_names(vehicle: Vehicle) -> tuple[Vehicle, tuple[HardwareNumber, ...]]:
    """The vehicle with a symbol in the place of every number of its hardware, and what they stand for."""
    # Its equations are derived from the same effects as those of the vehicle itself, into which numbers are
    # put first, so that zeros and ones vanish. Thrusters with the same curve have its symbols in common.
    states = (name for effect in vehicle.all_effects for name in effect.states)
    names = _Names(
        {*vehicle.declared_parameters, *vehicle.sides, *vehicle.inputs, *vehicle.environment, *states}
    )
    curves: dict[Curve, Curve] = {}
    thrusters = tuple(_thruster(t, names, curves) for t in vehicle.thrusters)
    surfaces = tuple(_surface(s, names) for s in vehicle.surfaces)
    return replace(vehicle, thrusters=thrusters, surfaces=surfaces), tuple(names.numbers)


def _thruster(thruster: Thruster, names: _Names, curves: dict[Curve, Curve]) -> Thruster:
    """Direction and place, or force and moment of a unit of thrust where the file states them."""
    name, law = thruster.name, thruster.law
    ahead, *others = thruster.wrench[:3]
    # Which thrusters push across the hull, as rudders do, is no number: it stays as in the file.
    e = [names.of(f"e_x_{name}", "1", ahead, abs(ahead) >= ACTUATORS.largest_part_ahead)]
    e += [names.of(f"e_{a}_{name}", "1", v) for a, v in zip("yz", others, strict=True)]
    if thruster.position is None or not _same(thruster.wrench, thruster.position):
        moment = sm.Matrix(names.row("lever", name, "m", thruster.wrench[3:]))
    else:
        moment = sm.Matrix(names.row("place", name, "m", thruster.position)).cross(sm.Matrix(e))
    if isinstance(law, Propeller):
        law = Propeller(
            names.of(f"diameter_{name}", "m", law.diameter),
            names.of(f"turns_{name}", "1/(s command)", law.per_command),
        )
    elif isinstance(law, Curve):
        law = curves[law] = curves.get(law) or _curve(name, law, names)
    return replace(thruster, wrench=(*e, *moment), law=law)


def _same(wrench: Sequence[float], position: Sequence[float]) -> bool:
    """Whether the moment is that of the force at the position; who replaces one may leave the other."""
    moment = sm.Matrix(position).cross(sm.Matrix(wrench[:3]))
    rounding = ACTUATORS.same_moment
    pairs = zip(wrench[3:], moment, strict=True)
    return all(isclose(a, b, rel_tol=rounding, abs_tol=rounding) for a, b in pairs)


def _curve(owner: str, law: Curve, names: _Names) -> Curve:
    """Ends of the pieces and coefficients; a piece begins where the one before ends."""
    start = names.of(f"curve_{owner}", "N", law.start)
    begin = names.of(f"curve_begin_{owner}", "command", law.pieces[0][0])
    pieces = []
    for k, (_, end, coefficients) in enumerate(law.pieces, 1):
        own = tuple(
            names.of(f"curve_{k}_{power}_{owner}", f"N/command^{power}", c)
            for power, c in enumerate(coefficients, 1)
        )
        after = names.of(f"curve_end_{k}_{owner}", "command", end)
        pieces.append((begin, after, own))
        begin = after
    return Curve(start, tuple(pieces))


def _surface(surface: Surface, names: _Names) -> Surface:
    """Place, axis, which lies across the hull, area, and limit and propeller where there are any."""
    name, limit = surface.name, surface.limit
    axis = (names.of(f"axis_{a}_{name}", "1", v) for a, v in zip("yz", surface.axis[1:], strict=True))
    return replace(
        surface,
        position=names.row("place", name, "m", surface.position),
        axis=(sm.Integer(0), *axis),
        area=names.of(f"area_{name}", "m^2", surface.area),
        limit=None if limit is None else names.of(f"limit_{name}", "rad", limit),
        diameter=names.of(f"propeller_{name}", "m", surface.diameter) if surface.propeller else 0.0,
    )
