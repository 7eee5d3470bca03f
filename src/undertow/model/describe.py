"""An effect in words and formulas, for lists, help texts and reports."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Iterator, Set
from dataclasses import asdict, dataclass
from typing import Any

import sympy as sm
from sympy.printing.str import StrPrinter

from .catalogue import Catalogue, catalogue
from .composition import Composition, Part, Statement, statement_of
from .effect import Actuation, Effect, kind_of
from .parameter import Parameter, PerSurface, PerThruster, declared, logged
from .symbols import FORCE, VELOCITY
from .units import short_unit

_GREEK = ("phi", "theta", "psi", "tau", "rho", "eta", "nu")


@dataclass(frozen=True)
class Equation:
    """One row of an effect's statement."""

    left: str  # what it gives: "X" for the surge force, "d(lagged_port)/dt" for the rate of a state
    plain: str  # right-hand side as SymPy text, with ``|u|`` for the magnitude
    latex: str  # the whole equation for LaTeX


@dataclass(frozen=True)
class ParameterNote:
    """A parameter for display; limits are None if there are none."""

    name: str  # id in vehicle files; ``<thruster>`` stands for the name of a thruster
    unit: str  # SI unit
    # low, high: bounds in SNAME signs
    low: float | None
    high: float | None
    linear: bool  # whether a regression gives it, or a search
    required: bool
    default: float | None  # value where a vehicle file is silent
    directional: bool
    per_run: bool  # whether nature changes it between runs
    about: str


@dataclass(frozen=True)
class Description:
    """Everything that ``undertow effects show`` prints of an effect."""

    id: str
    kind: str
    family: str
    about: str
    details: str
    equations: tuple[Equation, ...]
    legend: dict[str, str]
    parameters: tuple[ParameterNote, ...]
    also_in_files: dict[str, str]
    from_logs: dict[str, str]
    requires: tuple[str, ...]
    shares: tuple[str, ...]
    claims: tuple[str, ...]
    built_in: bool
    reference: str
    signature: str

    def as_dict(self) -> dict[str, Any]:
        """The description as plain lists and dictionaries."""
        return asdict(self)


def describe(cls: type[Effect], known: Catalogue | None = None) -> Description:
    """Describe an effect; equations are as on a vehicle with two thrusters called port and starboard."""
    statement = statement_of(cls.specimen(), catalogue() if known is None else known)
    about, _, details = inspect.cleandoc(cls.__doc__ or "").partition("\n")
    return Description(
        id=cls.id,
        kind=kind_of(cls),
        family=cls.family,
        about=about,
        details=" ".join(details.split()),
        equations=tuple(_equations(statement)),
        legend=dict(_legend(statement)),
        parameters=tuple(
            _parameter_note(p, {t.key for t in cls.shared_quantities}) for p in _as_declared(cls)
        ),
        also_in_files=cls.file_units(),
        from_logs={d.name: f"{d.about}, {short_unit(d.unit)}" for d in logged(cls)},
        requires=cls.requires,
        shares=cls.shares,
        claims=tuple(c for c in ("dissipative", "workless") if getattr(cls, c, False)),
        built_in=cls.built_in,
        reference=cls.reference,
        signature=cls.signature,
    )


# --- parameters ----------------------------------------------------------------------------------
def _as_declared(cls: type[Effect]) -> Iterator[Parameter]:
    """Scalar parameters, those of thrusters and surfaces once for all of them."""
    for declaration in declared(cls):
        if isinstance(declaration, PerThruster):
            kind = "surface" if isinstance(declaration, PerSurface) else "thruster"
            yield declaration.of(kind, f"<{kind}>")
        else:
            yield from declaration.expand(())


def _parameter_note(p: Parameter, stated_elsewhere: Set[str]) -> ParameterNote:
    low, high = (None if math.isinf(b) else b for b in p.bounds)
    about = p.about + (f" (unless the log has {p.without_log})" if p.without_log else "")
    return ParameterNote(
        name=p.name,
        unit=short_unit(p.unit),
        low=low,
        high=high,
        linear=p.linear,
        required=p.must_be_given and p.name not in stated_elsewhere,
        default=p.default,
        directional=p.motion is not None,
        per_run=p.per_run,
        about=about + (f" (where the log has {p.with_log})" if p.with_log else ""),
    )


# --- equations -----------------------------------------------------------------------------------
def equations_on(vehicle: Composition, effect: Effect) -> tuple[Equation, ...]:
    """Equations of an effect of a vehicle, as by `describe`, in the degrees of freedom of this vehicle."""
    known = {**catalogue(), **{e.id: type(e) for e in vehicle.effects}}
    return tuple(_equations(statement_of(effect, known), vehicle))


def _equations(statement: Statement, vehicle: Composition | None = None) -> Iterator[Equation]:
    """Rows in which the effect acts, then the abbreviations used in them."""
    short = statement.effect.abbreviations(statement.signals)
    names = {x: latex_name(str(x)) for x in (*statement.units, *statement.free_symbols, *short)}
    none = {} if vehicle is None else _missing_on(vehicle)
    for row, written in (*_stated_rows(statement), *((str(x), e) for x, e in short.items())):
        left, right = latex_row(row), written.xreplace(none)
        right = right.xreplace({x: sm.Float(x, _DIGITS) for x in right.atoms(sm.Float)})
        if sm.Symbol(row) not in none and not (none and right == 0):
            yield Equation(row, _Plain().doprint(right), f"{left} = {sm.latex(right, symbol_names=names)}")


_DIGITS = 4  # of numbers in equations: levers of thrusters and the like


def _missing_on(vehicle: Composition) -> dict[sm.Basic, sm.Expr]:
    """Motions that a vehicle does not have, over ground and through the water, and forces along them."""
    s, away = vehicle.signals, [i for i in range(6) if i not in vehicle.dofs]
    water = [m[i] for m in (s.nu_r, s.nu_r_dot) for i in away if str(s.nu[i]) not in vehicle.inputs]
    forces = [sm.Symbol(FORCE[i]) for i in away]
    return {**vehicle.locked, **dict.fromkeys([*water, *forces], sm.Integer(0))}


def _stated_rows(statement: Statement) -> Iterator[tuple[str, sm.Expr]]:
    """Active rows as the effect states them, abbreviations not expanded."""
    for part in statement.parts:
        written = dict(zip(part.rows, part.matrix if part.written is None else part.written, strict=True))
        yield from ((row, written[row]) for row, _ in _active_rows(part))


def _active_rows(part: Part) -> Iterator[tuple[str, sm.Expr]]:
    if part.name == "rest_state":
        return
    absent = part.absent if part.absent is not None else sm.zeros(*part.matrix.shape)
    for row, right, without in zip(part.rows, part.matrix, absent, strict=True):
        if right != without:
            yield row, right


_LEGEND = (
    (("x", "y", "z"), "position, north, east and down, m"),
    (("phi", "theta", "psi"), "roll, pitch and yaw angle, rad"),
    (("u", "v", "w"), "velocity over ground along the body axes, m/s"),
    (("u_r", "v_r", "w_r"), "velocity through the water along the body axes, m/s"),
    (("p", "q", "r"), "angular velocity about the body axes, rad/s"),
    (tuple(f"{n}_dot" for n in VELOCITY), "rates of the velocity over ground, m/s^2 and rad/s^2"),
    (("u_r_dot", "v_r_dot", "w_r_dot"), "rates of the velocity through the water, m/s^2"),
    (tuple(f"tau_{n}" for n in FORCE), "forces and moments that the log holds, N and N m"),
    (("t",), "time since the start of the run, s"),
    (("rho",), "density of the water, kg/m^3"),
    (("g",), "gravity, m/s^2"),
)


_OF_SURFACES = (
    ("deflection_", "angle of the control surface, rad"),
    ("area_", "its area, m^2"),
    ("place_x_", "where it stands, forward, m; place_y and place_z likewise"),
    ("diameter_", "diameter of the propeller ahead of it, m"),
)


def _legend(statement: Statement) -> Iterator[tuple[str, str]]:
    """Meaning of the signals, states and shared parameters that occur in the equations."""
    found = {str(x) for part in statement.parts for _, e in _active_rows(part) for x in e.free_symbols}
    for names, meaning in _LEGEND:
        if present := [n for n in names if n in found]:
            yield ", ".join(present), meaning
    steered = isinstance(statement.effect, Actuation) and statement.effect.of_surfaces
    unit = "rad" if steered else "in units of the command"
    for start, meaning in (
        ("command_", f"what reaches the step, {unit}"),
        ("actuation_", "what reaches the thruster, in units of its command"),
        ("e_x_", "direction of a thruster, forward; e_y and e_z likewise"),
        ("lever_x_", "moment about the x axis per newton of its thrust, m; lever_y and lever_z likewise"),
    ):
        if any(n.startswith(start) for n in found):
            yield f"{start}<{'surface' if steered else 'thruster'}>", meaning
    numbers = {str(x) for x in (*statement.signals.deflection, *statement.effect.constants)}
    for start, meaning in _OF_SURFACES:
        if any(n.startswith(start) for n in found & numbers):
            yield f"{start}<surface>", meaning
    states = statement.effect.states
    if states:
        yield ", ".join(states), "states of the effect itself"
    for p in statement.shared:
        if p.name in found:
            yield p.name, f"{p.about}, {short_unit(p.unit)}"


class _Plain(StrPrinter):
    """SymPy's text with magnitude bars."""

    def _print_Abs(self, expr: sm.Expr) -> str:
        return f"|{self._print(expr.args[0])}|"


def latex_name(name: str) -> str:
    """LaTeX of a parameter, signal or state: ``X_uabsu`` gives ``X_{|u|u}``, ``u_dot`` a dotted u."""
    if match := re.fullmatch(r"([a-z])(_r)?_dot", name):
        return rf"\dot{{{match[1]}}}" + ("_{r}" if match[2] else "")
    if match := re.fullmatch(r"([md])([xyz])_([gB])", name):  # a static moment, a shift
        return rf"{'m' if match[1] == 'm' else chr(92) + 'Delta'} {match[2]}_{{{match[3]}}}"
    head, _, tail = name.partition("_")
    if head in FORCE and tail:
        return f"{head}_{{{_derivative(tail)}}}"
    symbol = head if len(head) == 1 else rf"\{head}" if head in _GREEK else rf"\mathrm{{{head}}}"
    if not tail:
        return symbol
    subscript = tail if re.fullmatch("[xyz]{2}|.", tail) else rf"\mathrm{{{_escaped(tail)}}}"
    return f"{symbol}_{{{subscript}}}"


def _derivative(tail: str) -> str:
    """Subscript of a SNAME derivative."""
    motion = "".join(VELOCITY)
    if match := re.fullmatch(f"([{motion}])dot", tail):
        return rf"\dot{{{match[1]}}}"
    if match := re.fullmatch(f"([{motion}])abs([{motion}])(_back)?", tail):
        return f"|{match[1]}|{match[2]}" + (r",\mathrm{back}" if match[3] else "")
    if match := re.fullmatch(f"(sign|mem)([{motion}])", tail):
        return rf"\mathrm{{{match[1]}}}\,{match[2]}"
    if match := re.fullmatch(f"([{motion}])_back", tail):
        return rf"{match[1]},\mathrm{{back}}"
    return tail if re.fullmatch(f"[{motion}0]+", tail) else rf"\mathrm{{{_escaped(tail)}}}"


def latex_row(row: str) -> str:
    """LaTeX of the left-hand side of a row."""
    if match := re.fullmatch(r"d\((.*)\)/dt", row):
        return rf"\frac{{d}}{{dt}} {latex_row(match[1])}"
    if " " in row:
        return rf"\mathrm{{{_escaped(row).replace(' ', chr(92) + ' ')}}}"
    return latex_name(row)


def _escaped(text: str) -> str:
    return text.replace("_", r"\_")
