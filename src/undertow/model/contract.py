"""The contract: properties that an effect must have to be used in a model, tested at random points."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from random import Random

import sympy as sm

from undertow.errors import UndertowError

from .catalogue import Catalogue, catalogue
from .composition import Statement, function_of, statement_of
from .effect import KINDS, Effect, Wrench
from .parameter import DIRECTIONS, Parameter
from .symbols import (
    DOFS,
    ENVIRONMENT,
    POSE,
    VELOCITY,
    failing_pivot,
    pose_jacobian,
    signal_units,
    signals,
    symbol,
)
from .units import dimension, require_unit

# --- what a declaration has to state, and which names it may use ----------------------------------
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
# Where a vehicle may have been, to see what an effect makes of it; one that only turns has been nowhere.
_SOMEWHERE = {"x": (90.0, 130.0), "y": (-60.0, -40.0), "z": (7.0, 9.0), "psi": (-3.0, 3.0)}


def complaints_of(cls: type[Effect], known: Catalogue) -> Iterator[tuple[str, str, Iterator[str]]]:
    """Id of each check, the property that it tests, and the complaints."""
    yield "id", "is an identifier of its own", _id_complaints(cls, known)
    yield "documentation", "meaning, family, reference and signature are stated", _text_complaints(cls)
    yield "requires", "the effects that it shares parameters of exist", _requires_complaints(cls, known)
    yield (
        "shared_quantities",
        "what it takes from other effects can be stated there",
        _shared_complaints(cls, known),
    )
    yield "names", "parameter names are identifiers of their own", _name_complaints(cls, known)
    yield "bounds", "bounds, defaults and search starts fit each other", _bounds_complaints(cls)
    both = issubclass(cls, Wrench) and cls.workless and cls.dissipative
    claims = ["declared workless and dissipative: keep one of the two"] if both else []
    yield "claims", "claims about power do not contradict each other", iter(claims)


def _id_complaints(cls: type[Effect], known: Catalogue) -> Iterator[str]:
    if not issubclass(cls, tuple(KINDS.values())):
        yield f"{cls.__name__} is of no kind: derive it from Wrench, Flow, Actuation or Measurement"
    if not isinstance(getattr(cls, "id", None), str):
        yield "id is missing: give the class an attribute id = 'my_effect'"
    elif not _NAME.fullmatch(cls.id):
        yield f"id '{cls.id}' is not an identifier: use letters, digits and underscores"
    elif known.get(cls.id, cls) is not cls:
        yield f"id '{cls.id}' belongs to {known[cls.id].__name__} already: choose another"


def _text_complaints(cls: type[Effect]) -> Iterator[str]:
    # A docstring is inherited by nobody: it has to be the class's own.
    if not (vars(cls).get("__doc__") or "").strip():
        yield "the meaning is missing: write it as the first line of the docstring"
    for what, remedy in (
        ("family", "name the group of the catalogue"),
        ("reference", "name the book or paper that the physics follows"),
        ("signature", "say what in a log would give the effect away"),
    ):
        if not str(getattr(cls, what, "")).strip():
            yield f"{what} is missing: {remedy}"


def _requires_complaints(cls: type[Effect], known: Catalogue) -> Iterator[str]:
    for what, ids in (("requires", cls.requires), ("shares", cls.shares), ("series_of", cls.series_of)):
        if not isinstance(ids, tuple):
            yield f"{what} is {ids!r}: write a tuple, such as ('added_mass',)"
            return
        for beside in ids:
            if beside not in known:
                yield f"{what} '{beside}', which is not a known effect: correct the id"


def _keys(effect: Effect) -> dict[str, str]:
    """Units of all keys that the table of an effect may have."""
    return {p.name: p.unit for p in effect.parameters} | effect.file_units()


def _shared_complaints(cls: type[Effect], known: Catalogue) -> Iterator[str]:
    own = _keys(cls.specimen())
    for quantity in cls.shared_quantities:
        key = quantity.key
        if quantity.owner not in known:
            yield f"'{key}' is taken from '{quantity.owner}', which is not a known effect: correct the id"
            continue
        units = {"rho": "kg/m^3", "g": "m/s^2", **_keys(known[quantity.owner].specimen())}
        for unknown in sorted({key, *quantity.unless} - own.keys()):
            yield f"shared_quantities names '{unknown}', which is not a key of the effect's table: correct it"
        for unknown in sorted({str(x) for f in quantity.formulas for x in f.free_symbols} - units.keys()):
            yield f"'{key}' is taken from '{unknown}', not a key of '{quantity.owner}': correct the formula"


def _name_complaints(cls: type[Effect], known: Catalogue) -> Iterator[str]:
    specimen = cls.specimen()
    names = _names_of(specimen)
    taken = _taken_names(cls, known)
    for name in names:
        if not _NAME.fullmatch(name):
            yield f"'{name}' is not an identifier: use letters, digits and underscores"
        elif name in taken:
            yield f"'{name}' is taken by {taken[name]}: choose another name"
        elif names.count(name) > 1:
            yield f"'{name}' is declared twice: rename one"
    s = signals(specimen.thrusters, specimen.surface_names)
    for name in map(str, specimen.abbreviations(s)):
        if name in names or name in map(str, signal_units(s)):
            yield f"abbreviation '{name}' is also a parameter, a state or a signal: choose another name"


def _names_of(specimen: Effect) -> list[str]:
    """Names of parameters, with both directions of those that may differ, and of states."""
    parameters = specimen.parameters
    sides = (f"{p.name}_{direction}" for p in parameters for direction in DIRECTIONS if p.motion is not None)
    return [*(p.name for p in parameters), *sides, *specimen.states]


def _taken_names(cls: type[Effect], known: Catalogue) -> dict[str, str]:
    taken = {str(x): "a signal" for x in signal_units(signals())}
    for other in known.values():
        if other is not cls and other.id != getattr(cls, "id", None):
            specimen = other.specimen()
            taken |= dict.fromkeys(_names_of(specimen), f"effect '{other.id}'")
    return taken


def _bounds_complaints(cls: type[Effect]) -> Iterator[str]:
    parameters = {p.name: p for p in cls.specimen().parameters}
    for p in parameters.values():
        yield from _parameter_complaints(p)
    points = [point for seen in (_SOMEWHERE, {}) for point in cls.starts_near(seen)]
    for name, value in {entry for point in points for entry in point.items()}:
        if name not in parameters or parameters[name].linear:
            yield f"starts_near() gives '{name}', which is not a shape parameter of the effect: leave it out"
        elif not parameters[name].bounds[0] <= value <= parameters[name].bounds[1]:
            yield f"starts_near() gives {value:g} for '{name}', outside its bounds: correct it"


def _parameter_complaints(p: Parameter) -> Iterator[str]:
    low, high = p.bounds
    if not low < high:
        yield f"bounds of '{p.name}' are {low:g} to {high:g}: the first must be the smaller one"
    if not p.about.strip():
        yield f"parameter '{p.name}' has no meaning: say in one line what it is"
    if not p.linear and p.default is None and not p.starts:
        yield f"shape parameter '{p.name}' has neither starts nor a default: say where a search begins"
    stated = [("default", p.default)] if p.default is not None else []
    for what, value in (*stated, *(("start", v) for v in p.starts)):
        if not (math.isfinite(value) and low <= value <= high):
            yield f"{what} {value:g} of '{p.name}' is outside its bounds {low:g} to {high:g}: correct it"
    try:
        dimension(p.unit)
    except UndertowError as error:
        yield f"parameter '{p.name}': {error}"


# --- the contract ---------------------------------------------------------------------------------
Point = dict[sm.Symbol, float]
Values = Callable[[Mapping[sm.Symbol, float]], list[float]]


@dataclass(frozen=True)
class Trials:
    """Points at which an effect is tested; magnitudes vary widely, so that a kink is met on both sides."""

    seed: int = 20210405
    points: int = 200  # for bounds and power
    identity: int = 12  # points, for what has to be zero everywhere
    linearity: int = 40  # lines, for what has to be affine along them
    angle: float = 1.4  # largest, rad: clear of the singularity of the Euler angles
    signals: tuple[float, float] = (-2.0, 1.0)  # decades of their magnitude
    parameters: tuple[float, float] = (-2.0, 2.0)  # the same
    rounding: float = 1e-9  # of a sum, as a share of its terms


_TRIALS = Trials()


class RandomPoints:
    """Draws points for the symbols of a statement: signals of every size, parameters within their bounds."""

    def __init__(self, statement: Statement) -> None:
        self._random = Random(_TRIALS.seed)
        self._inputs = statement.inputs
        self._parameters = {**statement.parameters, **statement.logged}

    def point(self) -> Point:
        """A value for every symbol."""
        return {x: self.draw(x) for x in (*self._inputs, *self._parameters)}

    def moved(self, point: Point, symbols: Iterable[sm.Symbol]) -> Point:
        """The point with new values for some symbols."""
        return point | {x: self.draw(x) for x in symbols}

    def draw(self, x: sm.Symbol) -> float:
        """A value for one symbol."""
        if x in self._parameters:
            return self._within(self._parameters[x])
        unit, name = self._inputs[x], x.name
        if name in ("rho", "g"):
            return ENVIRONMENT.density if name == "rho" else ENVIRONMENT.gravity
        if unit == "rad":
            return self._random.uniform(-_TRIALS.angle, _TRIALS.angle)
        return abs(self._any_size(_TRIALS.signals)) if unit == "s" else self._any_size(_TRIALS.signals)

    def _any_size(self, decades: tuple[float, float]) -> float:
        return self._random.choice((-1.0, 1.0)) * 10 ** self._random.uniform(*decades)

    def _within(self, parameter: Parameter) -> float:
        low, high = parameter.bounds
        step = self._any_size(_TRIALS.parameters)
        if math.isinf(low) and math.isinf(high):
            return step
        if math.isinf(high):
            return low + abs(step)
        if math.isinf(low):
            return high - abs(step)
        # Bounds may be far wider than any value of interest: half of the draws are of ordinary size.
        ordinary = self._random.random() < 0.5 and low <= step <= high
        return step if ordinary else self._random.uniform(low, high)


def compiled(expressions: Sequence[sm.Expr]) -> Values:
    """A function from a point to the values of expressions; NaN where they are not defined."""
    rows = [sm.sympify(e, strict=True) for e in expressions]
    names = sorted({x for e in rows for x in e.free_symbols}, key=str)
    function = function_of(names, rows)

    def values(point: Mapping[sm.Symbol, float]) -> list[float]:
        try:
            return [float(v) for v in function(*(point[x] for x in names))]
        except (ArithmeticError, ValueError):
            return [math.nan] * len(rows)

    return values


def nonzero_row(matrix: sm.Matrix, statement: Statement) -> int | None:
    """Index of the first row that is not identically zero, or None."""
    # Expansion proves most identities; the rest is tested at random points.
    for i, row in enumerate(matrix):
        expanded = sm.expand(row)
        if expanded != 0 and not _vanishes(expanded, statement):
            return i
    return None


def _vanishes(expression: sm.Expr, statement: Statement) -> bool:
    values = compiled([expression, *sm.Add.make_args(expression)])
    probe = RandomPoints(statement)
    for _ in range(_TRIALS.identity):
        whole, *terms = values(probe.point())
        if not math.isnan(whole) and abs(whole) > _TRIALS.rounding * sum(map(abs, terms)):
            return False
    return True


def nonlinear_row(values: Values, along: Sequence[sm.Symbol], statement: Statement) -> int | None:
    """Index of the first of `compiled` rows not affine in the symbols `along` taken together, or None."""
    # Affine means that the value half-way between any two points is the mean of the values there, so that a
    # kink (dead band, dry friction) counts as not affine although its second derivative is zero.
    probe = RandomPoints(statement)
    for _ in range(_TRIALS.linearity):
        start = probe.point()
        end = probe.moved(start, along)
        middle = start | {x: (start[x] + end[x]) / 2 for x in along}
        for i, (a, b, half) in enumerate(zip(*map(values, (start, end, middle)), strict=True)):
            if abs(half - (a + b) / 2) > _TRIALS.rounding * (abs(a) + abs(b) + abs(half)):
                return i
    return None


# --- symbols and units ------------------------------------------------------------------------
def only_known_symbols(s: Statement) -> Iterator[str]:
    """No symbol but signals that the part may use, parameters, own states and numbers of the hardware."""
    common = {*s.parameters, *s.effect.state_symbols, *s.effect.constants}
    for part in s.parts:
        for x in sorted(part.matrix.free_symbols - common - part.usable, key=str):
            if x in s.inputs:
                yield f"{part.name}() uses the signal '{x}', which does not exist at that place of the model"
            else:
                yield (
                    f"{part.name}() uses '{x}', neither a signal nor a parameter: declare it, or name "
                    f"the effect that has it in requires"
                )


def parameters_used(s: Statement) -> Iterator[str]:
    """Every declared parameter occurs in the statement."""
    for p in s.own:
        if symbol(p.name) not in s.free_symbols:
            yield f"parameter '{p.name}' does not occur in the physics: use it or remove it"


def units_fit(s: Statement) -> Iterator[str]:
    """Dimensional analysis of every row."""
    for part in s.parts:
        for row, expression, unit in zip(part.rows, part.matrix, part.units, strict=True):
            try:
                require_unit(expression, unit, s.units)
            except UndertowError as error:
                yield f"{row}: {error}"


# --- what is left when the parameters say that the effect is absent -----------------------------
def absent_at_neutral(s: Statement) -> Iterator[str]:
    """With its parameters at their neutral values the effect changes nothing."""
    neutral, states = _neutral_values(s), s.effect.state_symbols
    # A step of the actuation chain may be slow; its response to a constant command counts.
    rest = s.part("rest_state") if "actuation" in s.kinds else states
    resting = dict(zip(states, rest, strict=True))
    for part in s.parts:
        if part.absent is None:
            continue
        left = (part.matrix - part.absent).xreplace(resting).subs(neutral)
        if left.has(sm.nan, sm.zoo, sm.oo):
            yield (
                f"{part.name}() is not defined {_settings(neutral)}: declare the neutral value of the "
                f"parameter in question (neutral=None if it cannot switch the effect off)"
            )
            continue
        row = nonzero_row(left, s)
        if row is not None:
            yield f"{part.rows[row]} does not vanish {_settings(neutral)}: {_short(left[row])} is left"


def _neutral_values(s: Statement) -> dict[sm.Symbol, sm.Expr]:
    # Where a log says that there is nothing, there is nothing.
    parameters = (*(s.own or s.shared), *s.logged.values())
    values = {symbol(p.name): _exact(p.neutral) for p in parameters if p.neutral is not None}
    if s.effect.built_in:  # hardware hands on what the log holds: nothing in, nothing out
        values |= dict.fromkeys(s.signals.generalised_force, sm.Integer(0))
    return values


def _exact(number: float) -> sm.Expr:
    return sm.oo * int(math.copysign(1, number)) if math.isinf(number) else sm.Rational(number)


def _settings(values: dict[sm.Symbol, sm.Expr]) -> str:
    listed = [f"{x} = {v}" for x, v in values.items()]
    if not listed:
        return "although no parameter can switch the effect off"
    more = f" and {len(listed) - 3} more are neutral" if len(listed) > 3 else ""
    return f"where {', '.join(listed[:3])}{more}"


def rests_at_rest(s: Statement) -> Iterator[str]:
    """States at their declared rest values do not move."""
    resting = dict(zip(s.effect.state_symbols, s.part("rest_state"), strict=True))
    row = nonzero_row(s.part("rates").xreplace(resting), s)
    if row is not None:
        yield f"state '{s.effect.states[row]}' still moves at the value that rest_state() gives it"


# --- linearity --------------------------------------------------------------------------------
def linearity_as_declared(s: Statement) -> Iterator[str]:
    """Parameters declared linear are regressor columns, together; the others are not."""
    own = [p for p in s.own if symbol(p.name) in s.free_symbols]
    linear = [p for p in own if p.linear]
    moved = [kind for kind in s.kinds if kind in ("flow", "measurement")]
    if moved:
        for p in linear:
            yield (
                f"parameter '{p.name}' of a {moved[0]} effect is not a regressor column: declare linear=False"
            )
        return
    main = compiled(list(s.parts[0].matrix))
    hidden = {x for part in s.parts[1:] for x in part.matrix.free_symbols}
    found = [complaint for p in linear for complaint in _not_linear(p, main, hidden, s)]
    yield from found
    together = [symbol(p.name) for p in linear]
    if not found and nonlinear_row(main, together, s) is not None:
        names = ", ".join(f"'{p.name}'" for p in linear)
        yield f"the linear parameters {names} multiply each other: declare all but one linear=False"
    for p in (p for p in own if not p.linear and symbol(p.name) not in hidden):
        if nonlinear_row(main, [*together, symbol(p.name)], s) is None:
            yield f"parameter '{p.name}' enters linearly although declared linear=False: declare linear=True"


def _not_linear(p: Parameter, main: Values, hidden: set[sm.Symbol], s: Statement) -> Iterator[str]:
    if symbol(p.name) in hidden:
        yield f"parameter '{p.name}' acts through a state or a delay, so not linearly: declare linear=False"
    elif (row := nonlinear_row(main, [symbol(p.name)], s)) is not None:
        yield f"{s.parts[0].rows[row]} is not linear in '{p.name}', as it is declared: declare linear=False"


def affine_in_motion(s: Statement) -> Iterator[str]:
    """Reported attitude is affine in the attitude, all else in position and velocity at a given attitude."""
    place, attitude = [*s.signals.eta[:3], *s.signals.nu], list(s.signals.eta[3:])
    pose, velocity = s.part("reported pose"), s.part("reported velocity")
    turned = pose[3:, :]
    for matrix, names, along in (
        (pose[:3, :], POSE[:3], place),
        (turned, POSE[3:], attitude),
        (velocity, VELOCITY, place),
    ):
        row = nonlinear_row(compiled(list(matrix)), along, s)
        if row is not None:
            what = "attitude" if along is attitude else "position and velocity"
            yield f"reported {names[row]} is not affine in {what}: {_short(matrix[row])}"
    for name, angle in zip(POSE[3:], turned, strict=True):
        if angle.free_symbols & set(place):
            yield f"reported {name} depends on more than the attitude: {_short(angle)}"


def dead_time_positive(s: Statement) -> Iterator[str]:
    """Nothing acts or is reported before its time, for parameters within bounds."""
    parts = [p for p in s.parts if p.name in ("dead_time", "age")]
    rows = [(name, seconds) for p in parts for name, seconds in zip(p.rows, p.matrix, strict=True)]
    values, probe = compiled([seconds for _, seconds in rows]), RandomPoints(s)
    for _ in range(_TRIALS.points):
        early = [row for row, seconds in zip(rows, values(probe.point()), strict=True) if seconds < 0]
        if early:
            yield f"{early[0][0]} can be negative within the bounds: {_short(early[0][1])}"
            return


# --- inertia ------------------------------------------------------------------------------------
def inertia_of(s: Statement) -> sm.Matrix:
    """The effect's own part of the mass matrix, shape (6, 6)."""
    return -s.in_still_water(s.part("wrench")).jacobian(s.signals.nu_dot)


def inertia_symmetric(s: Statement) -> Iterator[str]:
    """M = M', and the wrench is linear in the acceleration."""
    inertia = inertia_of(s)
    if inertia.free_symbols & set(s.signals.nu_dot):
        yield "the wrench is not linear in the acceleration, so it has no mass matrix"
        return
    for i in range(6):
        for j in range(i):
            difference = sm.Matrix([inertia[i, j] - inertia[j, i]])
            if nonzero_row(difference, s) is not None:
                yield (
                    f"inertia is not symmetric: M[{DOFS[i]}, {DOFS[j]}] = {_short(inertia[i, j])} but "
                    f"M[{DOFS[j]}, {DOFS[i]}] = {_short(inertia[j, i])}"
                )


def inertia_positive(s: Statement) -> Iterator[str]:
    """M is positive semidefinite for parameters within bounds; pure couplings are left at zero."""
    # Couplings (products of inertia, static moments) have no bounds of their own: how large they may be
    # depends on the diagonal. Loading a vehicle checks the whole matrix at its values.
    inertia = inertia_of(s)
    diagonal = inertia.diagonal().free_symbols
    couplings = {x: sm.Integer(0) for x in s.parameters if x not in diagonal}
    entries, probe = compiled(list(inertia.subs(couplings))), RandomPoints(s)
    for _ in range(_TRIALS.points):
        values = entries(probe.point())
        rows = [values[6 * i : 6 * i + 6] for i in range(6)]
        for i in range(6):
            if rows[i][i] < 0:
                yield f"inertia in {DOFS[i]} can be negative within the bounds: M = {_short(inertia[i, i])}"
                return
        if not positive_semidefinite(rows):
            yield "its mass matrix is not positive semidefinite for all parameters within their bounds"
            return


def positive_semidefinite(rows: Sequence[Sequence[float]]) -> bool:
    """Whether a symmetric matrix has no negative eigenvalue, but for rounding."""
    trace = sum(abs(rows[i][i]) for i in range(len(rows)))
    return failing_pivot(rows, _TRIALS.rounding * (trace or 1.0)) is None


# --- energy -------------------------------------------------------------------------------------
def power_terms(s: Statement) -> list[sm.Expr]:
    """Power of each row of the wrench in still water, W."""
    wrench = s.in_still_water(s.part("wrench"))
    return [v * f for v, f in zip(s.signals.nu, wrench, strict=True)]


def no_work(s: Statement) -> Iterator[str]:
    """nu' tau = 0 identically."""
    power = sm.Matrix([sum(power_terms(s))])
    if nonzero_row(power, s) is not None:
        yield f"declared workless, but its power is {_short(sm.expand(power[0]))}"


def dissipates(s: Statement) -> Iterator[str]:
    """nu' tau <= 0 at every point tried."""
    terms, probe = compiled(power_terms(s)), RandomPoints(s)
    for _ in range(_TRIALS.points):
        point = probe.point()
        powers = terms(point)
        if sum(powers) > _TRIALS.rounding * sum(map(abs, powers)):
            speeds = ", ".join(
                f"{n} = {point[symbol(n)]:.3g}" for n, p in zip(VELOCITY, powers, strict=True) if p > 0
            )
            yield f"declared dissipative, but it feeds {sum(powers):.3g} W into the vehicle at {speeds}"
            return


# --- flow -----------------------------------------------------------------------------------------
def rate_is_derivative(s: Statement) -> Iterator[str]:
    """acceleration() is the time derivative of velocity() along the vehicle's path."""
    velocity, eta = s.part("velocity"), s.signals.eta
    along = velocity.jacobian(eta) * pose_jacobian(eta) * s.signals.nu + velocity.diff(s.signals.t)
    row = nonzero_row(s.part("acceleration") - along, s)
    if row is not None:
        yield f"acceleration() is not the rate of velocity() in row {row + 1}: return {_short(along[row])}"


def accelerates(s: Statement) -> bool:
    """Whether the effect has a part in the mass matrix."""
    return "wrench" in s.kinds and bool(
        s.in_still_water(s.part("wrench")).free_symbols & set(s.signals.nu_dot)
    )


def has_own_inertia(s: Statement) -> bool:
    """Whether the effect has inertia of its own, and not only couplings."""
    inertia = inertia_of(s) if accelerates(s) else sm.zeros(6)
    return any(inertia.diagonal()) and not inertia.free_symbols & set(s.signals.nu_dot)


def claims(s: Statement, what: str) -> bool:
    """Whether the effect makes a claim about its power."""
    return isinstance(s.effect, Wrench) and bool(getattr(s.effect, what))


def _short(e: sm.Basic) -> str:
    text = str(e)
    return text if len(text) <= 90 else f"{text[:90]}..."


@dataclass(frozen=True)
class ContractCheck:
    """Result of one check."""

    check: str  # id of the check
    ok: bool  # whether the effect passes
    message: str  # what holds, or what does not and how to mend it; one line


@dataclass(frozen=True)
class _Law:
    check: str
    holds: str
    complaints: Callable[[Statement], Iterator[str]]
    applies: Callable[[Statement], bool] = lambda s: True


def _is(*kinds: str) -> Callable[[Statement], bool]:
    return lambda s: not set(kinds).isdisjoint(s.kinds)


_LAWS = (
    _Law("symbols", "stated in signals, own and shared parameters, and own states only", only_known_symbols),
    _Law("parameters", "every parameter occurs in the physics", parameters_used),
    _Law("units", "every term of every row has the right unit", units_fit),
    _Law("zero", "changes nothing where its parameters are neutral", absent_at_neutral),
    _Law("rest", "states are at rest where rest_state() says so", rests_at_rest, _is("actuation")),
    _Law("linearity", "linear parameters are linear together, the others are not", linearity_as_declared),
    _Law(
        "affine",
        "what is reported is affine in the motion at a given attitude",
        affine_in_motion,
        _is("measurement"),
    ),
    _Law("dead_time", "no dead time can be negative", dead_time_positive, _is("actuation", "measurement")),
    _Law("rate", "acceleration is the derivative of velocity", rate_is_derivative, _is("flow")),
    _Law("symmetry", "its part of the mass matrix is symmetric", inertia_symmetric, accelerates),
    _Law("inertia", "its part of the mass matrix is positive", inertia_positive, has_own_inertia),
    _Law("workless", "its power is identically zero", no_work, lambda s: claims(s, "workless")),
    _Law("dissipative", "it never feeds power in", dissipates, lambda s: claims(s, "dissipative")),
)


def check_effect(
    cls: type[Effect], known: Catalogue | None = None, inputs: tuple[str, ...] = ()
) -> list[ContractCheck]:
    """Check an effect class against the contract, beside other effects, the catalogue if not given.

    One finding for every check that passes, and one for every complaint of those that fail. Without a usable
    statement only the checks of the declaration are there.
    """
    beside = catalogue() if known is None else known
    findings = [
        f for check, holds, complaints in complaints_of(cls, beside) for f in _found(check, holds, complaints)
    ]
    if not all(f.ok for f in findings):
        return findings
    try:
        # A specimen of the author's own need not know of logged inputs.
        specimen = cls.specimen(inputs) if inputs else cls.specimen()
        statement = statement_of(specimen, beside)
    except UndertowError as error:
        return [*findings, ContractCheck("shape", False, str(error))]
    findings.append(ContractCheck("shape", True, "every part is a column of the right length"))
    symbols = _found(_LAWS[0].check, _LAWS[0].holds, only_known_symbols(statement))
    if not symbols[0].ok:  # unknown symbols have no value, so the laws cannot be tried
        return [*findings, *symbols]
    laws = [law for law in _LAWS[1:] if law.applies(statement)]
    rest = [f for law in laws for f in _found(law.check, law.holds, law.complaints(statement))]
    return [*findings, *symbols, *rest]


def _found(check: str, holds: str, complaints: Iterator[str]) -> list[ContractCheck]:
    findings: list[ContractCheck] = []
    try:
        findings.extend(ContractCheck(check, False, c) for c in complaints)
    except UndertowError as error:  # says already which line of a file it is
        findings.append(ContractCheck(check, False, str(error)))
    except Exception as error:  # what SymPy or the author's code cannot do must not hide the other findings
        why = " ".join(str(error).split())
        findings.append(ContractCheck(check, False, f"cannot be worked out: {type(error).__name__}: {why}"))
    return findings or [ContractCheck(check, True, holds)]
