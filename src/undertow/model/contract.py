"""The contract of effects: everything that must be true of one before a model is built from it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from undertow.errors import UndertowError

from . import laws
from .catalogue import Catalogue, catalogue
from .dimensions import dimension
from .effect import KINDS, Effect, Wrench
from .parameter import WAYS, Parameter
from .statement import Statement, statement_of
from .symbols import signal_units, signals

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
# Where a vehicle may have been, to see what an effect makes of it; one that only turns has been nowhere.
_SOMEWHERE = {"x": (90.0, 130.0), "y": (-60.0, -40.0), "z": (7.0, 9.0), "psi": (-3.0, 3.0)}


@dataclass(frozen=True)
class ContractCheck:
    """Result of one check.

    Attributes
    ----------
    check : str
        Id of the check.
    ok : bool
        Whether the effect passes.
    message : str
        What holds, or what does not and how to mend it; one line.
    """

    check: str
    ok: bool
    message: str


@dataclass(frozen=True)
class _Law:
    check: str
    holds: str
    complaints: Callable[[Statement], Iterator[str]]
    applies: Callable[[Statement], bool] = lambda s: True


def _is(*kinds: str) -> Callable[[Statement], bool]:
    return lambda s: any(kind in s.kinds for kind in kinds)


_LAWS = (
    _Law(
        "symbols",
        "stated in signals, own and shared parameters, and own states only",
        laws.only_known_symbols,
    ),
    _Law("parameters", "every parameter occurs in the physics", laws.parameters_used),
    _Law("units", "every term of every row has the right unit", laws.units_fit),
    _Law("zero", "changes nothing where its parameters are neutral", laws.absent_at_neutral),
    _Law("rest", "states are at rest where rest_state() says so", laws.rests_at_rest, _is("actuation")),
    _Law(
        "linearity", "linear parameters are linear together, the others are not", laws.linearity_as_declared
    ),
    _Law(
        "affine",
        "what is reported is affine in the motion at a given attitude",
        laws.affine_in_motion,
        _is("measurement"),
    ),
    _Law(
        "dead_time",
        "no dead time can be negative",
        laws.dead_time_positive,
        _is("actuation", "measurement"),
    ),
    _Law("rate", "acceleration is the derivative of velocity", laws.rate_is_derivative, _is("flow")),
    _Law("symmetry", "its part of the mass matrix is symmetric", laws.inertia_symmetric, laws.accelerates),
    _Law("inertia", "its part of the mass matrix is positive", laws.inertia_positive, laws.has_own_inertia),
    _Law("workless", "its power is identically zero", laws.no_work, lambda s: laws.claims(s, "workless")),
    _Law("dissipative", "it never feeds power in", laws.never_feeds, lambda s: laws.claims(s, "dissipative")),
)


def check_effect(cls: type[Effect], known: Catalogue | None = None) -> list[ContractCheck]:
    """Check an effect class against the contract.

    Parameters
    ----------
    cls : type of Effect
        A concrete effect class.
    known : mapping, optional
        The other effects that it will stand beside; the catalogue when not given.

    Returns
    -------
    list of ContractCheck
        One finding for every check that passes, and one for every complaint of those that fail. Without
        a usable statement only the checks of the declaration are there.
    """
    beside = catalogue() if known is None else known
    findings = [
        f for check, holds, complaints in _declaration(cls, beside) for f in _found(check, holds, complaints)
    ]
    if not all(f.ok for f in findings):
        return findings
    try:
        statement = statement_of(cls.specimen(), beside)
    except UndertowError as error:
        return [*findings, ContractCheck("shape", False, str(error))]
    findings.append(ContractCheck("shape", True, "every part is a column of the right length"))
    symbols = _law_findings(_LAWS[0], statement)
    if not symbols[0].ok:  # unknown symbols have no value, so the laws cannot be tried
        return [*findings, *symbols]
    rest = [f for law in _LAWS[1:] if law.applies(statement) for f in _law_findings(law, statement)]
    return [*findings, *symbols, *rest]


def _law_findings(law: _Law, statement: Statement) -> list[ContractCheck]:
    return _found(law.check, law.holds, law.complaints(statement))


def _found(check: str, holds: str, complaints: Iterator[str]) -> list[ContractCheck]:
    findings: list[ContractCheck] = []
    try:
        findings.extend(ContractCheck(check, False, c) for c in complaints)
    except Exception as error:  # what SymPy or the author's code cannot do must not hide the other findings
        why = " ".join(str(error).split())
        findings.append(ContractCheck(check, False, f"cannot be worked out: {type(error).__name__}: {why}"))
    return findings or [ContractCheck(check, True, holds)]


# --- the declaration ------------------------------------------------------------------------------
def _declaration(cls: type[Effect], known: Catalogue) -> Iterator[tuple[str, str, Iterator[str]]]:
    yield "id", "is an identifier of its own", _id_complaints(cls, known)
    yield "documentation", "meaning, family, reference and signature are stated", _text_complaints(cls)
    yield "requires", "the effects that it shares parameters of exist", _requires_complaints(cls, known)
    yield "taken", "what it takes from other effects can be told there", _taken_complaints(cls, known)
    yield "names", "parameter names are identifiers of their own", _name_complaints(cls, known)
    yield "bounds", "bounds, defaults and search starts fit each other", _bounds_complaints(cls)
    yield "claims", "claims about power do not contradict each other", _claim_complaints(cls)


def _id_complaints(cls: type[Effect], known: Catalogue) -> Iterator[str]:
    if not issubclass(cls, tuple(KINDS.values())):
        yield f"{cls.__name__} is of no kind: derive it from Wrench, Flow, Actuation or Measurement"
    if not isinstance(getattr(cls, "id", None), str):
        yield "id is missing: give the class an attribute id = 'my_effect'"
    elif not _NAME.fullmatch(cls.id):
        yield f"id '{cls.id}' is no identifier: use letters, digits and underscores"
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
    for what, ids in (("requires", cls.requires), ("shares", cls.shares)):
        if not isinstance(ids, tuple):
            yield f"{what} is {ids!r}: write a tuple, such as ('added_mass',)"
            return
        for beside in ids:
            if beside not in known:
                yield f"{what} '{beside}', which is no known effect: correct the id"


def _keys(effect: Effect) -> dict[str, str]:
    """Units of all keys that the table of an effect may have."""
    return {p.name: p.unit for p in effect.parameters} | effect.file_units()


def _taken_complaints(cls: type[Effect], known: Catalogue) -> Iterator[str]:
    own = _keys(cls.specimen())
    for taken in cls.taken:
        key = taken.key
        if taken.owner not in known:
            yield f"'{key}' is taken from '{taken.owner}', which is no known effect: correct the id"
            continue
        units = {"rho": "kg/m^3", "g": "m/s^2", **_keys(known[taken.owner].specimen())}
        for unknown in sorted({key, *taken.unless} - own.keys()):
            yield f"taken names '{unknown}', which is no key of the effect's table: correct it"
        for unknown in sorted({str(x) for f in taken.formulas for x in f.free_symbols} - units.keys()):
            yield f"'{key}' is taken from '{unknown}', no key of '{taken.owner}': correct the formula"


def _name_complaints(cls: type[Effect], known: Catalogue) -> Iterator[str]:
    specimen = cls.specimen()
    names = _names(specimen)
    taken = _taken_names(cls, known)
    for name in names:
        if not _NAME.fullmatch(name):
            yield f"'{name}' is no identifier: use letters, digits and underscores"
        elif name in taken:
            yield f"'{name}' is taken by {taken[name]}: choose another name"
        elif names.count(name) > 1:
            yield f"'{name}' is declared twice: rename one"
    s = signals(specimen.thrusters)
    for name in map(str, specimen.abbreviations(s)):
        if name in names or name in map(str, signal_units(s)):
            yield f"abbreviation '{name}' is also a parameter, a state or a signal: choose another name"


def _names(specimen: Effect) -> list[str]:
    """Names of parameters, with both directions of those that may differ, and of states."""
    parameters = specimen.parameters
    sides = (f"{p.name}_{way}" for p in parameters for way in WAYS if p.motion is not None)
    return [*(p.name for p in parameters), *sides, *specimen.states]


def _taken_names(cls: type[Effect], known: Catalogue) -> dict[str, str]:
    taken = {str(x): "a signal" for x in signal_units(signals())}
    for other in known.values():
        if other is not cls and other.id != getattr(cls, "id", None):
            specimen = other.specimen()
            taken |= dict.fromkeys(_names(specimen), f"effect '{other.id}'")
    return taken


def _bounds_complaints(cls: type[Effect]) -> Iterator[str]:
    parameters = {p.name: p for p in cls.specimen().parameters}
    for p in parameters.values():
        yield from _parameter_complaints(p)
    points = [point for seen in (_SOMEWHERE, {}) for point in cls.starts_near(seen)]
    for name, value in {entry for point in points for entry in point.items()}:
        if name not in parameters or parameters[name].linear:
            yield f"starts_near() gives '{name}', which is no shape parameter of the effect: leave it out"
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
    for what, value in (
        *(("default", v) for v in [p.default] if v is not None),
        *(("start", v) for v in p.starts),
    ):
        if not (math.isfinite(value) and low <= value <= high):
            yield f"{what} {value:g} of '{p.name}' is outside its bounds {low:g} to {high:g}: correct it"
    try:
        dimension(p.unit)
    except UndertowError as error:
        yield f"parameter '{p.name}': {error}"


def _claim_complaints(cls: type[Effect]) -> Iterator[str]:
    if issubclass(cls, Wrench) and cls.workless and cls.dissipative:
        yield "declared workless and dissipative: keep one of the two"
