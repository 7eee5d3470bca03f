"""Pictures of what each effect does, drawn from its declaration when the site is built.

One principle serves all effects. An effect without memory is drawn over the variable that changes its output
most, for three values of the variable that bends this curve most. One with states of its own or a delay is
drawn over time, while one variable is switched on and off. Parameters have a typical value (`typical`), all
other signals their nominal one (`Signal`). The output is a force or moment, the velocity of the water, what
reaches the thruster, or what the sensors report; the output without the effect is dashed where there is one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Any

import numpy as np
import sympy as sm
from matplotlib.figure import Figure
from numpy.typing import NDArray

from undertow.figures import FAINT, look, svg, unit_text
from undertow.figures import figure as new_figure
from undertow.model.catalogue import catalogue
from undertow.model.composition import Statement, commands_of, function_of, statement_of
from undertow.model.effect import Actuation, Effect
from undertow.model.parameter import Parameter
from undertow.model.symbols import DOFS, FORCE, FORCE_UNITS, rotation, signals
from undertow.model.units import short_unit

Values = dict[sm.Symbol, float | NDArray[np.float64]]
_NAMES = {n: f"{DOFS[i]} {'force' if i < 3 else 'moment'} {n}" for i, n in enumerate(FORCE)}
_TIME = np.linspace(0.0, 12.0, 601)
_SWITCHED = (1.0, 5.0, 0.2)  # on, off, length of the ramps, s
_TIE = 0.95  # of two variables that change the output as much, the first in the order of the signals is taken
_LISTED = 8  # parameters in the caption
_BENDS = 0.1  # share of the output's range by which a second variable has to bend the curve to be drawn


@dataclass(frozen=True)
class Signal:
    """Where a signal is held, and over what range it is swept, SI."""

    nominal: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Row:
    """One output of an effect, with and without it."""

    name: str
    unit: str
    given: sm.Expr
    absent: sm.Expr
    delay: sm.Expr

    @property
    def change(self) -> sm.Expr:
        """What the effect adds to the output."""
        return self.given - self.absent


@dataclass(frozen=True)
class Panel:
    """One pair of axes: curves by label, and the output without the effect where there is one."""

    x_label: str
    y_label: str
    x: NDArray[np.float64]
    curves: dict[str, NDArray[np.float64]]
    absent: NDArray[np.float64] | None = None
    switched: str = ""
    parameters: dict[str, str] = field(default_factory=dict)


# --- values at which the picture is drawn -----------------------------------------------------------
def typical(p: Parameter) -> float:
    """A value at which the effect shows: default, start of a search, or a step from the neutral value."""
    if p.assumed:
        return float(p.default or 0.0)
    if starts := [s for s in p.starts if s not in (0.0, p.neutral)]:
        return float(starts[len(starts) // 2])
    if p.neutral is None:
        return float(p.starts[0]) if p.starts else p.effective_default
    ways = ((bound - p.neutral) / 2 for bound in reversed(p.bounds))
    way = next(w for w in ways if w)
    return p.neutral + math.copysign(min(1.0 if p.linear else 0.5, abs(way)), way)


def _signals(effect: Effect) -> dict[sm.Symbol, Signal]:
    """Signals that an effect may depend on, in the order in which they are tried."""
    s = signals(effect.thrusters, effect.surface_names)
    ahead, *others = s.nu
    found = {ahead: Signal(1.0, -1.5, 1.5, "m/s")}
    found |= {x: Signal(0.0, -1.0, 1.0, "m/s" if i < 2 else "rad/s") for i, x in enumerate(others)}
    found |= {x: Signal(0.0, -1.0, 1.0, "m/s²" if i < 3 else "rad/s²") for i, x in enumerate(s.nu_dot)}
    found |= {x: Signal(0.0, 0.0, 20.0, "m") for x in s.eta[:3]}
    found |= {
        x: Signal(0.0, -turn, turn, "rad") for x, turn in zip(s.eta[3:], (1.2, 1.2, math.pi), strict=True)
    }
    found |= {x: Signal(0.2, -0.6, 0.6, "rad") for x in s.deflection}
    steered = isinstance(effect, Actuation) and effect.of_surfaces
    commands = {x: Signal(0.2, -0.6, 0.6, "rad") for x in commands_of(effect)} if steered else {}
    for thrusters in (s.actuation, *([] if steered else [commands_of(effect)])):  # one of them turns
        found |= {x: Signal(1.0 if i == 0 else 0.0, -1.5, 1.5, "command") for i, x in enumerate(thrusters)}
    found |= commands
    found |= {x: Signal(0.0, -1.0, 1.0, u) for x, u in zip(s.generalised_force, FORCE_UNITS, strict=True)}
    return {**found, s.t: Signal(0.0, 0.0, 20.0, "s")}


def _nominal(statement: Statement) -> Values:
    """A value for every symbol of a statement."""
    s, effect = statement.signals, statement.effect
    # What deflects across the hull has its drag from that; all else pushes ahead.
    way = "e_y" if "rudder_force" in effect.requires else "e_x"
    hardware = {x: 1.0 if str(x).startswith(way) else 0.0 for x in effect.constants}
    # A rudder of 0.02 m^2 a metre behind the origin, in the slipstream of a propeller of 0.2 m.
    sizes = {"area": 0.02, "place_x": -1.0, "diameter": 0.2, "turns": 1.0}
    hardware |= {x: v for x in hardware for name, v in sizes.items() if str(x).startswith(name)}
    # Two thrusters that push ahead, one to each side.
    arms = {x: 0.2 if str(x).endswith("port") else -0.2 for x in hardware if str(x).startswith("lever_z")}
    values: Values = {x: signal.nominal for x, signal in _signals(effect).items()}
    values |= {x: typical(p) for x, p in statement.parameters.items()}
    return {
        **values,
        **hardware,
        **arms,
        s.rho: 1000.0,
        s.g: 9.81,
        **dict.fromkeys(effect.state_symbols, 0.0),
    }


# --- outputs ----------------------------------------------------------------------------------------
def _rows(statement: Statement) -> Iterator[Row]:
    """Outputs of an effect, in still water."""
    for part in statement.parts:
        if part.absent is None or part.name in ("acceleration", "dead_time", "age"):
            continue
        names, given, units = part.rows, statement.in_still_water(part.matrix), part.units
        if part.name == "velocity":  # of the water, as the vehicle meets it
            given = rotation(sm.Matrix(statement.signals.eta[3:])).T * given
            names = tuple(f"water moving {way}" for way in ("ahead", "to starboard", "down"))
        delays = _delays(statement, part.name)
        for i, name in enumerate(names):
            yield Row(_NAMES.get(name) or _words(name), units[i], given[i], part.absent[i], delays[i])


def _delays(statement: Statement, part: str) -> sm.Matrix:
    if part == "output":
        return sm.Matrix([statement.part("dead_time")[0]] * len(commands_of(statement.effect)))
    if part.startswith("reported"):
        return statement.part("age")[slice(0, 6) if part.endswith("pose") else slice(6, 12), 0]
    return sm.zeros(6, 1)


@cache
def _function(expression: sm.Expr) -> tuple[list[sm.Symbol], Callable[..., list[Any]]]:
    names = sorted(expression.free_symbols, key=str)
    return names, function_of(names, [expression], "numpy")


def _evaluated(expression: sm.Expr, at: Values) -> NDArray[np.float64]:
    names, function = _function(expression)
    (value,) = function(*(at[x] for x in names))
    shape = np.broadcast_shapes(*(np.shape(v) for v in at.values()))
    return np.broadcast_to(np.asarray(value, dtype=float), shape)


def _range(values: NDArray[np.float64]) -> float:
    return float(np.ptp(values))


def _largest(values: NDArray[np.float64]) -> float:
    return float(np.abs(values).max())


def _best(scores: dict[sm.Symbol, float]) -> sm.Symbol | None:
    """The first variable that is as good as any; None where none does anything."""
    most = max(scores.values(), default=0.0)
    return next(x for x, score in scores.items() if score >= _TIE * most) if most > 1e-9 else None


# --- without memory: over a variable ----------------------------------------------------------------
def _static(row: Row, statement: Statement) -> tuple[Panel, float]:
    ranges, nominal = _signals(statement.effect), _nominal(statement)
    candidates = [x for x in ranges if x in row.change.free_symbols]
    swept = {x: nominal | {x: np.linspace(ranges[x].low, ranges[x].high, 241)} for x in ranges}
    x = _best({c: _range(_evaluated(row.change, swept[c])) for c in candidates})
    own = [y for y in ranges if y in row.absent.free_symbols]
    x = x or (own or list(ranges))[0]
    at = swept[x]
    curves = _family(row, x, at, ranges) or {"": _evaluated(row.given, at)}
    absent = _evaluated(row.absent, at) if own else None
    label, y_label = _labelled(_short(x), ranges[x].unit), _labelled(row.name, row.unit)
    size = _largest(_evaluated(row.change, at))
    return Panel(label, y_label, at[x], curves, absent, parameters=_shown(row.given, statement)), size


def _family(
    row: Row, x: sm.Symbol, at: Values, ranges: dict[sm.Symbol, Signal]
) -> dict[str, NDArray[np.float64]]:
    """Curves for three values of the variable that bends the curve most; none where no variable does."""

    def curve(z: sm.Symbol, value: float) -> NDArray[np.float64]:
        return _evaluated(row.given, at | {z: value})

    kinds = {"m/s", "rad/s", "m", "s", "command"} - ({"command"} if ranges[x].unit == "command" else set())
    others = [z for z in ranges if z != x and z in row.given.free_symbols and ranges[z].unit in kinds]
    bends = {z: _range(curve(z, ranges[z].high) - curve(z, ranges[z].high / 3)) for z in others}
    z = _best(bends)
    if z is None or bends[z] < _BENDS * _range(_evaluated(row.given, at)):
        return {}
    values = [ranges[z].high * share for share in (1 / 3, 2 / 3, 1)]
    return {_held(z, value, ranges[z].unit): curve(z, value) for value in values}


# --- with memory or delay: over time ----------------------------------------------------------------
def _dynamic(row: Row, statement: Statement) -> tuple[Panel, float]:
    still: Values = _nominal(statement) | {x: 0.0 for x in _signals(statement.effect)}
    rates = sum(statement.part("rates"), sm.Integer(0)) if statement.effect.states else sm.Integer(0)
    used = statement.in_still_water(sm.Matrix([rates + row.given])).free_symbols
    kinds = ("m/s", "rad/s", "command", *(["rad"] if len(statement.effect.surfaces) else []))
    ranges = {x: r for x, r in _signals(statement.effect).items() if r.unit in kinds and x in used}
    ranges = ranges or dict(list(_signals(statement.effect).items())[:1])
    at = {x: _simulated(statement, still | {x: _switch()}) for x in ranges}
    delay = float(_evaluated(row.delay, still))
    given = {x: np.interp(_TIME - delay, _TIME, _evaluated(row.given, v)) for x, v in at.items()}
    absent = {x: _evaluated(row.absent, v) for x, v in at.items()}
    sizes = {x: _largest(given[x] - absent[x]) for x in ranges}
    x = _best(sizes) or next(iter(ranges))
    shown = {n: v for e in (row.given, row.delay, rates) for n, v in _shown(e, statement).items()}
    label = _held(x, 1.0, ranges[x].unit)
    reference = absent[x] if row.absent.free_symbols else None
    y_label = _labelled(row.name, row.unit)
    return Panel("t [s]", y_label, _TIME, {"": given[x]}, reference, label, shown), sizes[x]


def _switch() -> NDArray[np.float64]:
    on, off, ramp = _SWITCHED
    return np.interp(_TIME, [on, on + ramp, off, off + ramp], [0.0, 1.0, 1.0, 0.0])


def _simulated(statement: Statement, at: Values) -> Values:
    """The signals with the states of the effect, by the rule of Euler: a picture needs no more."""
    states = list(statement.effect.state_symbols)
    if not states:
        return at
    rates = statement.in_still_water(statement.part("rates"))
    names = sorted(rates.free_symbols, key=str)
    rate = function_of(names, list(rates), "numpy")
    histories, x = [], np.zeros(len(states))
    for i, step in enumerate(np.diff(_TIME, append=_TIME[-1])):
        histories.append(x)
        now = {n: v if np.ndim(v) == 0 else v[i] for n, v in at.items()} | dict(zip(states, x, strict=True))
        x = x + step * np.array(rate(*(now[n] for n in names)), dtype=float)
    return at | dict(zip(states, np.transpose(histories), strict=True))


# --- words ------------------------------------------------------------------------------------------
def _short(x: sm.Symbol) -> str:
    name = str(x)
    if name.endswith("_dot"):
        return f"d{name[:-4]}/dt"
    return _words(name)


def _words(name: str) -> str:
    """A name of a signal or an output for readers."""
    what, _, whose = name.partition("_")
    if what in ("actuation", "command", "output"):
        return f"{'output' if what == 'output' else 'command'} of {whose}"
    greek = {"phi": "φ", "theta": "θ", "psi": "ψ"}
    return " ".join(greek.get(word, word) for word in name.replace("_", " ").split())


def _held(x: sm.Symbol, value: float, unit: str) -> str:
    return f"{_short(x)} = {value:.2g} {'' if unit == 'command' else unit}".rstrip()


def _labelled(name: str, unit: str) -> str:
    return name if unit in ("1", "command") else f"{name} [{unit_text(short_unit(unit))}]"


def _shown(expression: sm.Expr, statement: Statement) -> dict[str, str]:
    """Parameters in an expression, with the values at which it is drawn."""
    known = {x: p for x, p in statement.parameters.items() if x in expression.free_symbols}
    units = {x: "" if p.unit == "1" else " " + unit_text(short_unit(p.unit)) for x, p in known.items()}
    return {p.name: f"{typical(p):.3g}{units[x]}" for x, p in known.items() if typical(p)}


# --- the picture ------------------------------------------------------------------------------------
def panels(cls: type[Effect]) -> list[Panel]:
    """At most two outputs of an effect: of each unit the one that it changes most."""
    statement = statement_of(cls.specimen(), catalogue())
    delays = any(row.delay != 0 for row in _rows(statement))
    draw = partial(_dynamic if statement.effect.states or delays else _static, statement=statement)
    found: dict[str, tuple[Panel, float]] = {}
    for row in _rows(statement):
        panel, size = draw(row)
        if size > max(1e-9, found[row.unit][1] / _TIE if row.unit in found else 0.0):
            found[row.unit] = panel, size
    return [panel for panel, _ in found.values()][:2]


def picture(cls: type[Effect]) -> tuple[str, str]:
    """The signature of an effect as an SVG element, and the values at which it is drawn in words."""
    drawn = panels(cls)
    values = {name: value for panel in drawn for name, value in panel.parameters.items()}
    listed = ", ".join(f"{name} = {value}" for name, value in list(values.items())[:_LISTED])
    listed += ", …" if len(values) > _LISTED else ""
    return svg(figure(drawn), f"signature-{cls.id}"), listed


def figure(drawn: list[Panel]) -> Figure:
    """Panels side by side."""
    with look():
        result, axes = new_figure(2.5, 1, 2)
        for axis, panel in zip(axes[0], drawn, strict=False):
            _draw(axis, panel)
        for axis in axes[0][len(drawn) :]:
            axis.set_axis_off()
    return result


def _draw(axis: Any, panel: Panel) -> None:
    axis.grid()
    if panel.switched:
        axis.axvspan(*_SWITCHED[:2], color=FAINT, alpha=0.2, linewidth=0, label=panel.switched)
    if panel.absent is None:
        axis.axhline(0.0, color=FAINT, linewidth=0.8)
    else:
        axis.plot(panel.x, panel.absent, color=FAINT, linestyle="--", label="without the effect")
    for label, curve in panel.curves.items():
        axis.plot(panel.x, curve, label=label or ("with it" if panel.absent is not None else None))
    axis.set_xlabel(panel.x_label)
    axis.set_ylabel(panel.y_label)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=8)
