"""What an effect states, in one form for all four kinds: columns with the units and symbols they may have."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import sympy as sm

from undertow.errors import UndertowError

from .catalogue import Catalogue, lookup
from .effect import Actuation, Effect, Flow, Measurement, Wrench, kinds_of
from .parameter import Parameter
from .symbols import (
    FORCE,
    FORCE_UNITS,
    POSE,
    VELOCITY,
    VELOCITY_UNITS,
    Signals,
    column,
    signal_units,
    signals,
    symbol,
)

_POSE_UNITS = ("m",) * 3 + ("rad",) * 3
_NED = ("north", "east", "down")


@dataclass(frozen=True)
class Part:
    """One column of an effect's statement.

    Attributes
    ----------
    name : str
        The method it comes from.
    matrix : Matrix, shape (n, 1)
        What the method returned, spelled out.
    rows : tuple of str
        What each row is called, for instance "X" or "d(lagged_port)/dt".
    units : tuple of str
        Unit that each row must have.
    absent : Matrix, shape (n, 1), or None
        What the rows would be without the effect; None where that question has no meaning (rates of states).
    usable : frozenset of Symbol
        Signals that the part may be stated in.
    written : Matrix, optional
        What the method returned, where abbreviations in it have been spelled out in `matrix`.
    """

    name: str
    matrix: sm.Matrix
    rows: tuple[str, ...]
    units: tuple[str, ...]
    absent: sm.Matrix | None
    usable: frozenset[sm.Symbol]
    written: sm.Matrix | None = None


@dataclass(frozen=True)
class Statement:
    """An effect's parts together with the symbols that they may contain.

    Attributes
    ----------
    effect : Effect
        The effect, as on a vehicle with two thrusters.
    signals : Signals
        Signals of that vehicle.
    parts : tuple of Part
        What the effect states.
    shared : tuple of Parameter
        Parameters of the effects that it requires or shares with.
    """

    effect: Effect
    signals: Signals
    parts: tuple[Part, ...]
    shared: tuple[Parameter, ...]

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
    def inputs(self) -> dict[sm.Symbol, str]:
        """Units of all symbols that are no parameters: signals, commands, states, numbers of the hardware."""
        effect = self.effect
        states = dict(zip(effect.state_symbols, effect.state_units, strict=True))
        commands = dict.fromkeys(commands_of(effect), "command")
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
    """Ask an effect for everything that it states.

    Raises
    ------
    UndertowError
        If the effect cannot state it, or a part is no column of the right length.
    """
    signal_set = signals(effect.thrusters)
    beside = (*effect.requires, *effect.shares)
    shared = tuple(p for r in beside for p in lookup(r, known)(effect.thrusters).parameters)
    try:
        parts = tuple(p for kind in kinds_of(effect) for p in _BUILDERS[kind](effect, signal_set))
    except Exception as error:  # whatever the author's code raises is the author's to mend
        raise UndertowError(f"the physics cannot be stated: {type(error).__name__}: {error}") from error
    for part in parts:
        _require_column(part)
    return Statement(effect, signal_set, parts, shared)


def _require_column(part: Part) -> None:
    shape = getattr(part.matrix, "shape", None)
    if not isinstance(part.matrix, sm.MatrixBase):
        raise UndertowError(f"{part.name}() returns {type(part.matrix).__name__}: return a sympy.Matrix")
    if shape != (len(part.units), 1):
        raise UndertowError(f"{part.name}() has the shape {shape}: return a column of {len(part.units)} rows")


def commands_of(effect: Effect) -> sm.Matrix:
    """Symbols of what reaches an actuation effect, shape (n_thrusters, 1)."""
    return column([f"command_{n}" for n in effect.thrusters])


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
    place = _usable(s.eta, s.t, s.rho, s.g)
    rows = tuple(f"water {way}" for way in _NED), tuple(f"d(water {way})/dt" for way in _NED)
    return _spelled_out(
        effect,
        s,
        Part("velocity", effect.velocity(s), rows[0], ("m/s",) * 3, sm.zeros(3, 1), place),
        Part(
            "acceleration",
            effect.acceleration(s),
            rows[1],
            ("m/s^2",) * 3,
            sm.zeros(3, 1),
            place | _usable(s.nu),
        ),
    )


def _actuation(effect: Actuation, s: Signals) -> tuple[Part, ...]:
    commands = commands_of(effect)
    usable = _usable(s.eta, s.nu, s.nu_r, s.t, s.rho, s.g, commands)
    rest = effect.rest_state(commands)
    names = tuple(f"output_{n}" for n in effect.thrusters)
    rest_rows = tuple(f"{x} at rest" for x in effect.states)
    return (
        Part("output", effect.output(commands, s), names, ("command",) * len(names), commands, usable),
        _rates(effect, effect.rates(commands, s), usable),
        Part("rest_state", rest, rest_rows, effect.state_units, None, usable),
        Part(
            "dead_time", sm.Matrix([effect.dead_time()]), ("dead time",), ("s",), sm.zeros(1, 1), frozenset()
        ),
    )


def _measurement(effect: Measurement, s: Signals) -> tuple[Part, ...]:
    usable = _usable(s.eta, s.nu, s.t, s.rho, s.g)
    pose, velocity = effect.reported(s.eta, s.nu, s)
    return (
        Part("reported pose", pose, tuple(f"reported {n}" for n in POSE), _POSE_UNITS, s.eta, usable),
        Part(
            "reported velocity",
            velocity,
            tuple(f"reported {n}" for n in VELOCITY),
            VELOCITY_UNITS,
            s.nu,
            usable,
        ),
        Part(
            "age",
            effect.age(),
            tuple(f"age of reported {n}" for n in (*POSE, *VELOCITY)),
            ("s",) * 12,
            sm.zeros(12, 1),
            frozenset(),
        ),
    )


_BUILDERS: dict[str, Callable[..., tuple[Part, ...]]] = {
    "wrench": _wrench,
    "flow": _flow,
    "actuation": _actuation,
    "measurement": _measurement,
}
