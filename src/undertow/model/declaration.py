"""What the declaration of an effect has to state, and which names it may use."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator

from undertow.errors import UndertowError

from .catalogue import Catalogue
from .effect import KINDS, Effect, Wrench
from .parameter import WAYS, Parameter
from .symbols import signal_units, signals
from .units import dimension

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
# Where a vehicle may have been, to see what an effect makes of it; one that only turns has been nowhere.
_SOMEWHERE = {"x": (90.0, 130.0), "y": (-60.0, -40.0), "z": (7.0, 9.0), "psi": (-3.0, 3.0)}


def complaints_of(cls: type[Effect], known: Catalogue) -> Iterator[tuple[str, str, Iterator[str]]]:
    """Id of each check, what it holds where it passes, and the complaints."""
    yield "id", "is an identifier of its own", _id_complaints(cls, known)
    yield "documentation", "meaning, family, reference and signature are stated", _text_complaints(cls)
    yield "requires", "the effects that it shares parameters of exist", _requires_complaints(cls, known)
    yield "taken", "what it takes from other effects can be stated there", _taken_complaints(cls, known)
    yield "names", "parameter names are identifiers of their own", _name_complaints(cls, known)
    yield "bounds", "bounds, defaults and search starts fit each other", _bounds_complaints(cls)
    yield "claims", "claims about power do not contradict each other", _claim_complaints(cls)


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


def _taken_complaints(cls: type[Effect], known: Catalogue) -> Iterator[str]:
    own = _keys(cls.specimen())
    for taken in cls.taken:
        key = taken.key
        if taken.owner not in known:
            yield f"'{key}' is taken from '{taken.owner}', which is not a known effect: correct the id"
            continue
        units = {"rho": "kg/m^3", "g": "m/s^2", **_keys(known[taken.owner].specimen())}
        for unknown in sorted({key, *taken.unless} - own.keys()):
            yield f"taken names '{unknown}', which is not a key of the effect's table: correct it"
        for unknown in sorted({str(x) for f in taken.formulas for x in f.free_symbols} - units.keys()):
            yield f"'{key}' is taken from '{unknown}', not a key of '{taken.owner}': correct the formula"


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
    sides = (f"{p.name}_{way}" for p in parameters for way in WAYS if p.motion is not None)
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
