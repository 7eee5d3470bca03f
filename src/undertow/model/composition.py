"""Statements of effects, and their composition: relative velocity, actuator states, sum of wrenches."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import sympy as sm

from undertow.errors import UndertowError

from .catalogue import Catalogue, catalogue, lookup
from .effect import Actuation, Effect, Flow, Measurement, Wrench, kinds_of
from .parameter import Parameter, logged
from .symbols import (
    FORCE,
    FORCE_UNITS,
    POSE,
    POSE_UNITS,
    VELOCITY,
    VELOCITY_UNITS,
    Signals,
    column,
    euler_rates,
    pose_jacobian,
    rotation,
    signal_units,
    signals,
    skew,
    spelled_out,
    symbol,
)

_HALF = sm.Rational(1, 2)
# Statements of effects that are remembered: those of a whole catalogue on some vehicles.
_CACHED = 512
Meanings = tuple[tuple[sm.Symbol, sm.Expr], ...]


@lru_cache(maxsize=_CACHED)
def stated(effect: Wrench) -> sm.ImmutableMatrix:
    """Wrench of an effect as stated, abbreviations expanded, shape (6, 1)."""
    s = signals(effect.thrusters, effect.surface_names)
    wrench = effect.wrench(s)
    if getattr(wrench, "shape", None) != (6, 1):
        raise UndertowError(
            f"effect '{effect.id}': wrench() returns no sympy.Matrix of 6 rows and 1 column: correct it"
        )
    return effect.spelled_out(wrench, s).as_immutable()


@lru_cache(maxsize=_CACHED)
def _reduced(effect: Wrench, dofs: tuple[int, ...], meanings: Meanings) -> sm.ImmutableMatrix:
    """Wrench of an effect in the degrees of freedom of a vehicle."""
    # Vehicles that differ by one effect, as the candidates of a diagnosis do, mostly have these in common.
    return stated(effect).extract(list(dofs), [0]).xreplace(dict(meanings))


class Composition:
    """The equations of a set of effects in the chosen degrees of freedom, indices among the six as `dofs`.

    The other arguments are those of a `Vehicle`; `derived` are indices of velocities among the six, too.
    """

    def __init__(
        self,
        effects: tuple[Effect, ...],
        dofs: tuple[int, ...],
        thrusters: tuple[str, ...],
        forces: tuple[str, ...] = (),
        split: tuple[tuple[str, tuple[sm.Symbol, ...]], ...] = (),
        surfaces: tuple[str, ...] = (),
        inputs: tuple[str, ...] = (),
        *,
        velocity_along_earth: bool = False,
        derived: tuple[int, ...] = (),
    ) -> None:
        self.effects, self.dofs, self.thrusters, self.forces = effects, dofs, thrusters, forces
        self.split = dict(split)
        self.surfaces, self.inputs = surfaces, inputs
        self.velocity_along_earth, self.derived = velocity_along_earth, derived
        self.signals: Signals = signals(thrusters, surfaces)

    # --- symbols of the chosen degrees of freedom --------------------------------------------
    @property
    def eta(self) -> sm.Matrix:
        """Pose, shape (n, 1)."""
        return self._rows(self.signals.eta)

    @property
    def nu(self) -> sm.Matrix:
        """Body velocity, shape (n, 1)."""
        return self._rows(self.signals.nu)

    @property
    def nu_dot(self) -> sm.Matrix:
        """Body acceleration, shape (n, 1)."""
        return self._rows(self.signals.nu_dot)

    @property
    def commands(self) -> sm.Matrix:
        """Commands of thrusters and surfaces, known forces, logged inputs, shape (n_commands, 1)."""
        actuators = [f"command_{n}" for n in (*self.thrusters, *self.surfaces)]
        return column([*actuators, *self.forces, *self.inputs])

    @property
    def actuation(self) -> sm.Matrix:
        """What reaches the thrusters, then the angles of the surfaces, shape (n_actuators, 1)."""
        return sm.Matrix.vstack(self.signals.actuation, self.signals.deflection)

    def _rows(self, six: sm.Matrix) -> sm.Matrix:
        return six.extract(list(self.dofs), list(range(six.cols)))

    def of_kind(self, kind: type[Effect]) -> tuple[Effect, ...]:
        """Effects of one kind, actuation and measurement in the order of their chains."""
        found = [e for e in self.effects if isinstance(e, kind)]
        return tuple(sorted(found, key=lambda e: getattr(e, "stage", 0)))

    # --- what is frozen, and what depends on what ---------------------------------------------
    @cached_property
    def locked(self) -> dict[sm.Symbol, sm.Expr]:
        """Zero for motions that the vehicle does not have and forces that the log does not contain."""
        # A motion that is left out of the model may be prescribed: the log holds it as an input.
        s = self.signals
        motions = [m[i] for m in (s.eta, s.nu, s.nu_dot) for i in range(6) if i not in self.dofs]
        motions = [x for x in motions if x.name not in self.inputs]
        forces = [symbol(f"tau_{n}") for n in FORCE if f"tau_{n}" not in self.forces]
        # Parameters that an effect would share if the vehicle had them.
        absent = {i for e in self.effects for i in e.shares} - {e.id for e in self.effects}
        shared = [symbol(p.name) for i in absent for p in catalogue()[i](self.thrusters).parameters]
        return dict.fromkeys([*motions, *forces, *shared], sm.Integer(0))

    @cached_property
    def water(self) -> tuple[sm.Matrix, sm.Matrix]:
        """Velocity of the water where the vehicle is, m/s, and its rate along the path, m/s^2; body axes."""
        s = self.signals
        back = rotation(sm.Matrix(s.eta[3:])).T
        flows = [e for e in self.effects if isinstance(e, Flow)]
        velocity = sum((f.spelled_out(f.velocity(s), s) for f in flows), sm.zeros(3, 1))
        rate = sum((f.spelled_out(f.acceleration(s), s) for f in flows), sm.zeros(3, 1))
        return back * velocity, back * rate

    @cached_property
    def relative_motion(self) -> dict[sm.Symbol, sm.Expr]:
        """Velocity through the water and its rate, in terms of motion over ground and the flow effects."""
        return self.relative_to(*self.water)

    def relative_to(self, water: sm.Matrix, rate: sm.Matrix) -> dict[sm.Symbol, sm.Expr]:
        """Velocity through water that moves like this (shapes (3, 1), body axes), and its rate."""
        # A motion that the vehicle does not have is zero through the water as well: otherwise a beam current
        # would act on a rolling ship without heave differently from its own sway.
        s = self.signals
        omega = sm.Matrix(s.nu[3:])
        velocity = sm.Matrix(s.nu[:3]) - water
        acceleration = sm.Matrix(s.nu_dot[:3]) + skew(omega) * water - rate
        relative = enumerate([*velocity, *acceleration])
        there = [i for i in range(3) if i in self.dofs or VELOCITY[i] in self.inputs]
        seen = [e if i % 3 in there else sm.Integer(0) for i, e in relative]
        return dict(zip([*s.nu_r[:3], *s.nu_r_dot[:3]], seen, strict=True))

    @cached_property
    def directional(self) -> dict[sm.Symbol, sm.Expr]:
        """Coefficients that differ forward and backward, as functions of the relative velocity."""
        motions = {p.name: p.motion for e in self.effects for p in e.parameters}
        found = {}
        for name, (forward, backward) in self.split.items():
            sign = sm.sign(self.signals.nu_r[motions[name]])
            found[symbol(name)] = _HALF * (forward + backward) + _HALF * (forward - backward) * sign
        return found

    def reduce(self, expression: sm.Matrix) -> sm.Matrix:
        """An expression of effects in terms of the vehicle's own motion, commands and parameters."""
        return expression.xreplace(dict(self._meanings))

    @cached_property
    def _meanings(self) -> Meanings:
        return tuple(spelled_out([self.locked, self.relative_motion, self.directional]).items())

    # --- the sums -----------------------------------------------------------------------------
    @cached_property
    def wrenches(self) -> dict[Wrench, sm.Matrix]:
        """Wrench of every effect in the vehicle's degrees of freedom."""
        effects = [e for e in self.effects if isinstance(e, Wrench)]
        return {e: _reduced(e, self.dofs, self._meanings).as_mutable() for e in effects}

    @cached_property
    def residual(self) -> sm.Matrix:
        """Sum of the wrenches, shape (n, 1)."""
        return sum(self.wrenches.values(), sm.zeros(len(self.dofs), 1))

    @cached_property
    def mass_matrix(self) -> sm.Matrix:
        """M = -d(residual)/d(nu_dot), shape (n, n)."""
        return -self.residual.jacobian(self.nu_dot)

    @cached_property
    def forcing(self) -> sm.Matrix:
        """Residual at nu_dot = 0, shape (n, 1)."""
        return self.residual.xreplace(dict.fromkeys(self.nu_dot, sm.Integer(0)))

    @cached_property
    def wrench_states(self) -> dict[sm.Symbol, sm.Expr]:
        """States that wrenches own and that the vehicle's motion can reach, with their rates."""
        return self._reachable(e for e in self.effects if isinstance(e, Wrench))

    def _reachable(self, effects: Iterable[Wrench]) -> dict[sm.Symbol, sm.Expr]:
        used, s = set(self.residual.free_symbols), self.signals
        pairs = ((e.state_symbols, self.reduce(e.spelled_out(e.rates(s), s))) for e in effects)
        rates = {x: rate for pair in pairs for x, rate in zip(*pair, strict=True)}
        while more := {y for x in used & rates.keys() for y in rates[x].free_symbols} - used:
            used |= more  # a state that moves one in use is in use, too
        return {x: rate for x, rate in rates.items() if x in used}

    @cached_property
    def chain(self) -> tuple[sm.Matrix, dict[sm.Symbol, sm.Expr], dict[sm.Symbol, sm.Expr]]:
        """Output of the actuation chain, rates of its states, and the states' values at rest."""
        ways = {of: column([f"command_{n}" for n in names]) for of, names in self._actuator_names.items()}
        rates: dict[sm.Symbol, sm.Expr] = {}
        rest: dict[sm.Symbol, sm.Expr] = {}
        for effect in self.of_kind(Actuation):
            assert isinstance(effect, Actuation)
            states, value = effect.state_symbols, ways[effect.of_surfaces]
            rates.update(zip(states, effect.rates(value, self.signals), strict=True))
            rest.update(zip(states, effect.rest_state(value).xreplace(rest), strict=True))
            ways[effect.of_surfaces] = effect.output(value, self.signals)
        value = sm.Matrix.vstack(*ways.values())
        # A step may feel the flow past the thruster (thrust loss), so it is reduced like a wrench.
        return self.reduce(value), {x: self.reduce(r) for x, r in rates.items()}, rest

    @property
    def _actuator_names(self) -> dict[bool, tuple[str, ...]]:
        """Names of the actuators, thrusters and then surfaces, by `Actuation.of_surfaces`."""
        return {False: self.thrusters, True: self.surfaces}

    @cached_property
    def dead_time(self) -> sm.Expr:
        """Sum of the pure delays between command and thrust, s; none where there is nothing to command."""
        if not any(self._actuator_names.values()):
            return sm.Integer(0)
        return sum((e.dead_time() for e in self.effects if isinstance(e, Actuation)), sm.Integer(0))

    @cached_property
    def pose_rate(self) -> sm.Matrix:
        """d(eta)/dt = J(eta) nu in the vehicle's degrees of freedom."""
        return self._rows(pose_jacobian(self.signals.eta) * self.signals.nu).xreplace(self.locked)

    @cached_property
    def reported(self) -> tuple[sm.Matrix, sm.Matrix]:
        """Pose and velocity that the sensors report."""
        eta, nu = self.signals.eta, self.signals.nu
        for effect in self.of_kind(Measurement):
            assert isinstance(effect, Measurement)
            eta, nu = effect.reported(eta, nu, self.signals)
        true = self.signals.eta
        believed = sm.Matrix([(eta if i in self.dofs else true)[i] for i in (3, 4, 5)])
        if self.velocity_along_earth and believed != true[3:, :]:
            along = rotation(true[3:, :]) * nu[:3, :]
            nu = sm.Matrix([*(rotation(believed).T * along), *nu[3:]])
        if self.derived:
            from_pose = self._velocity_of(sm.Matrix([*eta[:3], *believed]))
            nu = sm.Matrix([(from_pose if i in self.derived else nu)[i] for i in range(6)])
        return self._rows(eta).xreplace(self.locked), self._rows(nu).xreplace(self.locked)

    def _velocity_of(self, eta: sm.Matrix) -> sm.Matrix:
        """Body velocity whose pose is one that is reported, shape (6, 1): what is derived from it."""
        true = self.signals
        if eta == true.eta:
            return true.nu
        rate = eta.jacobian(true.eta) * pose_jacobian(true.eta) * true.nu
        attitude = eta[3:, :]
        turning = true.nu[3:, :] if attitude == true.eta[3:, :] else euler_rates(attitude).inv() * rate[3:, :]
        return sm.Matrix([*(rotation(attitude).T * rate[:3, :]), *turning])

    @cached_property
    def report_age(self) -> sm.Matrix:
        """Age of the sensor readings, pose then velocity, shape (2n, 1), s."""
        effects = [e for e in self.effects if isinstance(e, Measurement)]
        total = sum((e.age() for e in effects), sm.zeros(12, 1))
        return sm.Matrix.vstack(self._rows(total[:6, :]), self._rows(total[6:, :]))

    @cached_property
    def names(self) -> frozenset[str]:
        """Names of all symbols that occur in the equations."""
        chain, rates, _ = self.chain
        parts = [self.residual, chain, *self.reported, sm.Matrix([self.dead_time]), self.report_age]
        parts += [sm.Matrix(list(rates.values()) or [0]), sm.Matrix(list(self.wrench_states.values()) or [0])]
        return frozenset(x.name for part in parts for x in part.free_symbols)

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Parameters that occur in the equations, in the order of the effects; environment last."""
        declared = [p.name for effect in self.effects for p in effect.parameters]
        names = dict.fromkeys(str(half) for n in declared for half in self.split.get(n, (n,)))
        return tuple(n for n in (*names, "rho", "g") if n in self.names)


_NED = ("north", "east", "down")


@dataclass(frozen=True)
class Part:
    """One column of an effect's statement."""

    name: str  # the method it comes from
    matrix: sm.Matrix  # (n, 1): what the method returned, spelled out
    rows: tuple[str, ...]  # what each row is called, for instance "X" or "d(lagged_port)/dt"
    units: tuple[str, ...]  # unit that each row must have
    # (n, 1): what the rows would be without the effect; None where that question has no meaning (rates of
    # states)
    absent: sm.Matrix | None
    usable: frozenset[sm.Symbol]  # signals that the part may be stated in
    # what the method returned, where abbreviations in it have been spelled out in `matrix`
    written: sm.Matrix | None = None


@dataclass(frozen=True)
class Statement:
    """An effect's parts together with the symbols that they may contain."""

    effect: Effect  # the effect, as on a vehicle with two thrusters
    signals: Signals  # signals of that vehicle
    parts: tuple[Part, ...]  # what the effect states
    shared: tuple[Parameter, ...]  # parameters of the effects that it requires or shares with

    @property
    def kinds(self) -> tuple[str, ...]:
        """Which of the four kinds the effect is."""
        return kinds_of(self.effect)

    @cached_property
    def own(self) -> tuple[Parameter, ...]:
        """The effect's own parameters."""
        return self.effect.parameters

    @cached_property
    def parameters(self) -> dict[sm.Symbol, Parameter]:
        """Own and shared parameters by symbol."""
        return {symbol(p.name): p for p in (*self.shared, *self.own)}

    @cached_property
    def logged(self) -> dict[sm.Symbol, Parameter]:
        """Quantities that the log holds for the effect, by symbol."""
        return {symbol(d.name): d for d in logged(type(self.effect)) if d.name in self.effect.inputs}

    @cached_property
    def inputs(self) -> dict[sm.Symbol, str]:
        """Units of all symbols that are no parameters: signals, commands, states, numbers of the hardware."""
        effect = self.effect
        states = dict(zip(effect.state_symbols, effect.state_units, strict=True))
        commands = dict.fromkeys(commands_of(effect), getattr(effect, "command_unit", "command"))
        return {**signal_units(self.signals), **commands, **states, **effect.constants}

    @cached_property
    def units(self) -> dict[sm.Symbol, str]:
        """Units of every symbol that the statement may contain."""
        return {**self.inputs, **{x: p.unit for x, p in self.parameters.items()}}

    @cached_property
    def free_symbols(self) -> set[sm.Symbol]:
        """Every symbol that the statement contains."""
        return {x for part in self.parts for x in part.matrix.free_symbols}

    def part(self, name: str) -> sm.Matrix:
        """The matrix of one part."""
        return next(p.matrix for p in self.parts if p.name == name)

    def in_still_water(self, expression: sm.Matrix) -> sm.Matrix:
        """The expression where the velocity through the water is the velocity over ground."""
        s = self.signals
        moving = zip([*s.nu_r[:3], *s.nu_r_dot[:3]], [*s.nu[:3], *s.nu_dot[:3]], strict=True)
        return expression.xreplace(dict(moving))


def statement_of(effect: Effect, known: Catalogue) -> Statement:
    """Ask an effect for everything that it states."""
    signal_set = signals(effect.thrusters, effect.surface_names)
    beside = (*effect.requires, *effect.shares)
    shared = tuple(p for r in beside for p in lookup(r, known)(effect.thrusters, effect.surfaces).parameters)
    try:
        parts = tuple(p for kind in kinds_of(effect) for p in _BUILDERS[kind](effect, signal_set))
    except UndertowError:  # says already which line of a file it is
        raise
    except Exception as error:  # whatever the author's code raises is the author's to mend
        raise UndertowError(f"the physics cannot be stated: {type(error).__name__}: {error}") from error
    for part in parts:
        matrix, rows = part.matrix, len(part.units)
        if not isinstance(matrix, sm.MatrixBase):
            raise UndertowError(f"{part.name}() returns {type(matrix).__name__}: return a sympy.Matrix")
        if matrix.shape != (rows, 1):
            raise UndertowError(f"{part.name}() has the shape {matrix.shape}: return a column of {rows} rows")
    return Statement(effect, signal_set, parts, shared)


def commands_of(effect: Effect) -> sm.Matrix:
    """Symbols of what reaches an actuation effect, shape (n_thrusters, 1) or (n_surfaces, 1)."""
    names = effect.acts_on if isinstance(effect, Actuation) else effect.thrusters
    return column([f"command_{n}" for n in names])


def _usable(*groups: sm.Matrix | sm.Symbol) -> frozenset[sm.Symbol]:
    return frozenset(x for g in groups for x in (g if isinstance(g, sm.MatrixBase) else [g]))


def _rates(effect: Effect, matrix: sm.Matrix, usable: frozenset[sm.Symbol]) -> Part:
    rows = tuple(f"d({x})/dt" for x in effect.states)
    return Part("rates", matrix, rows, tuple(f"{u}/s" for u in effect.state_units), None, usable)


def _wrench(effect: Wrench, s: Signals) -> tuple[Part, ...]:
    usable = frozenset(signal_units(s))
    wrench = Part("wrench", effect.wrench(s), FORCE, FORCE_UNITS, sm.zeros(6, 1), usable)
    return _spelled_out(effect, s, wrench, _rates(effect, effect.rates(s), usable))


def _spelled_out(effect: Effect, s: Signals, *parts: Part) -> tuple[Part, ...]:
    return tuple(replace(p, matrix=effect.spelled_out(p.matrix, s), written=p.matrix) for p in parts)


def _flow(effect: Flow, s: Signals) -> tuple[Part, ...]:
    place, still = _usable(s.eta, s.t, s.rho, s.g), sm.zeros(3, 1)
    rows = tuple(f"water {way}" for way in _NED), tuple(f"d(water {way})/dt" for way in _NED)
    velocity = Part("velocity", effect.velocity(s), rows[0], ("m/s",) * 3, still, place)
    usable = place | _usable(s.nu)
    acceleration = Part("acceleration", effect.acceleration(s), rows[1], ("m/s^2",) * 3, still, usable)
    return _spelled_out(effect, s, velocity, acceleration)


def _actuation(effect: Actuation, s: Signals) -> tuple[Part, ...]:
    commands = commands_of(effect)
    usable = _usable(s.eta, s.nu, s.nu_r, s.t, s.rho, s.g, commands)
    rest, dead_time = effect.rest_state(commands), sm.Matrix([effect.dead_time()])
    names = tuple(f"output_{n}" for n in effect.acts_on)
    units = (effect.command_unit,) * len(names)
    rest_rows = tuple(f"{x} at rest" for x in effect.states)
    return (
        Part("output", effect.output(commands, s), names, units, commands, usable),
        _rates(effect, effect.rates(commands, s), usable),
        Part("rest_state", rest, rest_rows, effect.state_units, None, usable),
        Part("dead_time", dead_time, ("dead time",), ("s",), sm.zeros(1, 1), frozenset()),
    )


def _measurement(effect: Measurement, s: Signals) -> tuple[Part, ...]:
    usable = _usable(s.eta, s.nu, s.t, s.rho, s.g)
    pose, velocity = effect.reported(s.eta, s.nu, s)
    rows = [f"reported {n}" for n in (*POSE, *VELOCITY)]
    ages = tuple(f"age of {row}" for row in rows)
    return (
        Part("reported pose", pose, tuple(rows[:6]), POSE_UNITS, s.eta, usable),
        Part("reported velocity", velocity, tuple(rows[6:]), VELOCITY_UNITS, s.nu, usable),
        Part("age", effect.age(), ages, ("s",) * 12, sm.zeros(12, 1), frozenset()),
    )


_BUILDERS: dict[str, Callable[..., tuple[Part, ...]]] = {
    "wrench": _wrench,
    "flow": _flow,
    "actuation": _actuation,
    "measurement": _measurement,
}


def function_of(
    names: Sequence[sm.Symbol], expressions: Any, functions: str | Mapping[str, Callable[..., Any]] = "math"
) -> Callable[..., Any]:
    """A function of the named symbols that returns the values of expressions, nested as they are."""
    _check([*names, expressions])
    modules = functions if isinstance(functions, str) else [dict(functions)]
    found: Callable[..., Any] = sm.lambdify(list(names), expressions, modules, cse=modules == "math")
    return found


def _check(found: Any) -> None:
    if isinstance(found, list | tuple):
        for part in found:
            _check(part)
    elif not isinstance(found, sm.Basic):
        raise TypeError(f"{found!r} is not an expression of SymPy")
