"""The numbers of thrusters, propellers and surfaces by name, for code that takes them as parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import isclose

import sympy as sm

from .effect import ACROSS, Curve, Number, Propeller, Surface
from .symbols import symbol
from .vehicle import Thruster, Vehicle

_AXES = "xyz"
# Of a moment and that of the position and direction beside it, which are then the same: rounding.
_SAME = 1e-9


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
    e = [names.of(f"e_x_{name}", "1", ahead, abs(ahead) >= ACROSS)]
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
    return all(isclose(a, b, rel_tol=_SAME, abs_tol=_SAME) for a, b in zip(wrench[3:], moment, strict=True))


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
