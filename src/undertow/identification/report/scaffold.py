"""Template effect files: written from the unexplained residual of a diagnosis, or with one example term."""

from __future__ import annotations

import json
import keyword
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from math import ceil, copysign, isfinite, log10, pi
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from jinja2 import Template

from undertow.errors import UndertowError, listed
from undertow.files import templates
from undertow.identification.diagnosis.associations import (
    SETTINGS,
    WAVE,
    Column,
    coefficient_unit,
    command_of,
    is_factor,
    label_of,
    step_time,
    without_bars,
)
from undertow.identification.diagnosis.residual import COMPARED_BETWEEN_RUNS
from undertow.identification.diagnosis.result import BetweenRuns, Dependence, Diagnosis, Remaining, Spectrum
from undertow.model.catalogue import catalogue, load_effects
from undertow.model.effect import Effect
from undertow.model.symbols import DOFS, FORCE, FORCE_UNITS, POSE, VELOCITY, signal_units, signals


@dataclass(frozen=True)
class Timing:
    """A parameter of a time-dependent force: an angular frequency, or the time of a step."""

    name: str
    unit: str
    about: str
    value: float
    resolution: float  # half of what the logs can tell apart: fits also start that far from `value`
    bounds: tuple[float, float]
    sharpness: float = 0.0  # time of a step over its duration

    @property
    def starts(self) -> tuple[float, ...]:
        """Starting points of a fit, within the bounds."""
        low, high = self.bounds
        inner = 0.01 * (high - low)
        points = (self.value - self.resolution, self.value, self.value + self.resolution)
        return tuple(min(max(x, low + inner), high - inner) for x in points)

    def rounded(self, values: Sequence[float]) -> str:
        """Values with the digits that the resolution needs, as text."""
        digits = max(0, ceil(3.0 - log10(self.resolution)))
        return ", ".join(f"{x:.{digits}f}" for x in values)


@dataclass(frozen=True)
class Coefficient:
    """One term of a force: a parameter times factors."""

    name: str
    unit: str
    about: str
    row: int  # which of the six forces and moments it is part of
    # factors as the diagnosis writes them; ("cos",) or ("sin",) of an oscillation with the frequency `timing`
    column: Column
    timing: Timing | None = None
    per_run: bool = False  # whether the parameter has a value in every run


@dataclass(frozen=True)
class Suggestion:
    """The content of an effect file."""

    about: str  # first line of its docstring
    origin: tuple[str, ...]  # paragraphs on where the terms come from
    signature: str  # sign of the effect in a log
    reference: str
    terms: tuple[Coefficient, ...]


def example() -> Suggestion:
    """One example term."""
    column: Column = ("|r|", "u")
    unit = coefficient_unit("N", column)
    return Suggestion(
        about="Surge force that varies with the yaw rate and the speed (an example).",
        origin=("Written by 'undertow effects new' as an example of a term.",),
        signature="speed is lost in turns",
        reference="none yet: name the book or paper that the physics follows",
        terms=(Coefficient(_name("X", column), unit, "surge force per |r| u", 0, column),),
    )


def suggested(diagnosis: Diagnosis, source: str) -> Suggestion:
    """Terms for all that the residuals of a diagnosis, read from the file `source`, correlate with."""
    terms = terms_of(diagnosis.remaining, max((r.duration for r in diagnosis.runs), default=1.0))
    if not terms:
        raise UndertowError(
            f"'{source}' has no term that an effect could state; its verdict is {diagnosis.verdict}: leave "
            "--from out for an empty one"
        )
    described = [f for f in diagnosis.remaining if f.depends_on or f.spectrum or f.between_runs]
    logs = ", ".join(r.name for r in diagnosis.runs)
    added = f" with {listed(diagnosis.effects)} added" if diagnosis.effects else ""
    labels = dict.fromkeys(label for force in described for label in _labels(force))
    return Suggestion(
        about=f"Force that varies with {listed(labels)}.",
        origin=(
            f"Suggested by 'undertow effects new' from {source}: vehicle {diagnosis.vehicle}{added}, "
            f"logs {logs}, undertow {diagnosis.undertow}. On the validation data:",
            *(f"- {force.summary}" for force in described),
        ),
        signature="; ".join(force.summary for force in described),
        reference=f"residual forces in {source}, none yet: name the book or paper that the physics follows",
        terms=terms,
    )


def effect_of(remaining: Sequence[Remaining], seconds: float) -> type[Effect]:
    """The effect that `undertow effects new` would write of residual forces, of logs as long as `seconds`."""
    labels = listed([*dict.fromkeys(label for force in remaining for label in _labels(force))])
    words = ("a force that varies with " + labels, (), labels, "residual forces, none yet")
    with TemporaryDirectory() as folder:
        file = Path(folder) / "what_remains.py"
        file.write_text(effect_file(file.stem, file.name, Suggestion(*words, terms_of(remaining, seconds))))
        return load_effects(file)[0]


def _labels(force: Remaining) -> Iterator[str]:
    yield from (found.term for found in force.depends_on)
    if force.spectrum is not None:
        yield f"a period of {force.spectrum.period:.3g} s"
    if force.between_runs:
        yield "the run"


# --- terms ------------------------------------------------------------------------------------
def terms_of(remaining: Iterable[Remaining], seconds: float) -> tuple[Coefficient, ...]:
    """Terms for all that residual forces were found to correlate with, of logs as long as `seconds`."""
    return tuple(_distinct([t for force in remaining for t in _terms(force, seconds)]))


def _terms(force: Remaining, seconds: float) -> Iterator[Coefficient]:
    if force.degree_of_freedom not in DOFS:
        raise UndertowError(f"'{force.degree_of_freedom}' is not a degree of freedom: is this a diagnosis?")
    row = DOFS.index(force.degree_of_freedom)
    by_run = [t for found in force.between_runs for t in _between_runs(found, row)]
    known = {t.column for t in by_run}
    for found in force.depends_on:
        yield from (t for t in _dependent(found, row, seconds) if t.column not in known)
    if force.spectrum is not None:
        yield from _periodic(force.spectrum, row, seconds)
    yield from by_run


def _dependent(dependence: Dependence, row: int, seconds: float) -> Iterator[Coefficient]:
    what = f"{DOFS[row]} {'force' if row < 3 else 'moment'}"
    d = dependence
    for factors, value, error in zip(d.columns, d.coefficients, d.standard_errors, strict=False):
        for factor in factors:
            if not is_factor(factor):
                raise UndertowError(f"'{factor[:40]}' is not a factor of a term: is this a diagnosis?")
        column = tuple(factors)
        time = step_time(column)
        per = "per" if time is None else "of"
        about = f"{what} {per} {label_of(column)}" if column else what
        unit = coefficient_unit(FORCE_UNITS[row], column)
        found = f"{about}; found {value:.3g} with standard error {error:.1g}"
        timing = None if time is None else _step(time, FORCE[row], seconds)
        yield Coefficient(_name(FORCE[row], column), unit, found, row, column, timing)


def _step(found: str, force: str, seconds: float) -> Timing:
    """Time of a step, between the neighbours of the one that fits best among those examined."""
    time, apart = float(found), seconds / SETTINGS.step_times
    low, high = sorted((0.1 * time, time + copysign(apart, time)))
    bounds = max(low, time - apart), min(high, time + apart)
    name, sharpness = f"t_{force}_{identifier(found)}", abs(time) / (SETTINGS.step_width * apart)
    return Timing(name, "s", "time of the step", time, 0.5 * apart, bounds, sharpness)


def _periodic(spectrum: Spectrum, row: int, seconds: float) -> Iterator[Coefficient]:
    if not (isfinite(spectrum.period) and spectrum.period > 0):
        raise UndertowError(f"a period of {spectrum.period} s is impossible: is this a diagnosis?")
    omega = 2 * pi / spectrum.period
    name, bounds = f"omega_{FORCE[row]}", (0.5 * omega, 2 * omega)
    timing = Timing(name, "rad/s", "angular frequency", omega, pi / (2 * seconds), bounds)
    what = f"{DOFS[row]} {'force' if row < 3 else 'moment'}"
    for part in ("cos", "sin"):
        about = f"{what}, {part} part; found an amplitude of {spectrum.amplitude:.3g}"
        name = f"{FORCE[row]}_{part}"
        yield Coefficient(name, FORCE_UNITS[row], about, row, (part,), timing, not spectrum.in_step)


def _between_runs(found: BetweenRuns, row: int) -> Iterator[Coefficient]:
    """A coefficient per run for each column in which a force differs between runs."""
    what = f"{DOFS[row]} {'force' if row < 3 else 'moment'}"
    for column in COMPARED_BETWEEN_RUNS.get(found.of, ()):
        about = f"{what} per {label_of(column)}" if column else what
        unit = FORCE_UNITS[row]
        yield Coefficient(_name(FORCE[row], column), unit, f"{about}, by run", row, column, per_run=True)


def _name(force: str, column: Column) -> str:
    """Name of a coefficient: ``X_absr_u``."""
    parts = [_name_part(f) for f in column] or ["constant"]
    return f"{force}_{'_'.join(parts)}"


def _name_part(factor: str) -> str:
    if (time := step_time((factor,))) is not None:
        return f"step_{identifier(time)}"
    size = "abs" if factor.startswith("|") else ""
    name = command_of(factor)
    return size + identifier(factor if name is None else name)


def _distinct(terms: list[Coefficient]) -> Iterator[Coefficient]:
    """Terms with names that are unique, in the catalogue and in the file."""
    used: set[str] = set()
    for term in terms:
        name, count = term.name, 2
        while name in used or name in taken_names():
            name, count = f"{term.name}_{count}", count + 1
        used.add(name)
        yield replace(term, name=name)


# --- words ----------------------------------------------------------------------------------------
_ID = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", re.ASCII)
# Names that the file uses otherwise.
_RESERVED = {"Wrench", "Parameter", "Signals", "UndertowError"}


@dataclass(frozen=True)
class TextLimits:
    """Longest texts of a new effect, characters."""

    effect_id: int = 60
    text: int = 400


_LIMITS = TextLimits()


def check_id(effect_id: str) -> None:
    """Refuse an id that is not in snake case, is a word of Python, or has an effect of the catalogue."""
    if not _ID.fullmatch(effect_id) or len(effect_id) > _LIMITS.effect_id or keyword.iskeyword(effect_id):
        raise UndertowError(
            f"'{effect_id[: 2 * _LIMITS.effect_id]}' cannot be an id: write small letters, digits and single "
            f"underscores, at most {_LIMITS.effect_id} of them, such as 'turning_drag'"
        )
    if effect_id in catalogue():
        raise UndertowError(f"effect '{effect_id}' is in the catalogue already: choose another id")


def class_name(effect_id: str) -> str:
    """Name of the class of an effect: ``turning_drag`` gives ``TurningDrag``."""
    name = "".join(part.capitalize() for part in effect_id.split("_"))
    return f"{name}Effect" if name in _RESERVED or keyword.iskeyword(name) else name


@cache
def taken_names() -> frozenset[str]:
    """Names of signals, and of parameters and states of the catalogue."""
    specimens = [cls.specimen() for cls in catalogue().values()]
    names = {n for e in specimens for n in (*(p.name for p in e.parameters), *e.states)}
    return frozenset(names | {str(x) for x in signal_units(signals())})


def safe_text(text: str) -> str:
    """Text that is safe in a docstring: printable, on one line, without quotes and backslashes."""
    line = " ".join(text.split()).replace('"', "'").replace("\\", "/")
    return "".join(c if c.isprintable() else "?" for c in line)[: _LIMITS.text]


def literal(text: str) -> str:
    """A text as a Python literal in double quotes."""
    return json.dumps(safe_text(text), ensure_ascii=False)


def identifier(text: str) -> str:
    """Letters, digits and underscores of a text."""
    return re.sub(r"[^A-Za-z0-9_]", "", text)


_WIDTH = 100
_USED = {"s", "sm", "self", "t", *POSE, *VELOCITY, *DOFS}


def effect_file(effect_id: str, file: str, suggestion: Suggestion) -> str:
    """Text of a Python file, which will be called `file`, with one effect."""
    return str(_template().render(**_content(effect_id, file, suggestion))).rstrip() + "\n"


@cache
def _template() -> Template:
    # Python, not HTML: `safe_text` escapes every text.
    return templates("undertow.identification.report").get_template("effect.txt")


def _content(effect_id: str, file: str, suggestion: Suggestion) -> dict[str, Any]:
    factors = (command_of(factor) for term in suggestion.terms for factor in term.column)
    commands = list(dict.fromkeys(name for name in factors if name is not None))
    variables = _variables(commands)
    rows = [[t for t in suggestion.terms if t.row == i] for i in range(6)]
    return {
        "id": effect_id,
        "file": safe_text(file),
        "cls": class_name(effect_id),
        "about": _wrapped(suggestion.about, "    ").strip(),
        "origin": [_wrapped(line, "    ") for line in suggestion.origin],
        "reference": _split(suggestion.reference),
        "signature": _split(suggestion.signature),
        "parameters": [(t.name, literal(t.unit), _split(t.about), t.per_run) for t in suggestion.terms],
        "timings": list({t.timing.name: t.timing for t in suggestion.terms if t.timing}.values()),
        "commands": [literal(c) for c in commands if not _is_force(c)],
        "signals": list(_signals(suggestion.terms, variables)),
        "forces": [(DOFS[i], [_code(t, variables) for t in row]) for i, row in enumerate(rows) if row],
        "rows": ", ".join(DOFS[i] if row else "0" for i, row in enumerate(rows)),
    }


def _wrapped(text: str, indent: str) -> str:
    more = f"{indent}  " if text.startswith("- ") else indent
    return textwrap.fill(safe_text(text), _WIDTH, initial_indent=indent, subsequent_indent=more)


def _split(text: str) -> list[str]:
    """A long text as literals that Python joins."""
    lines = textwrap.wrap(safe_text(text), _WIDTH - 20, drop_whitespace=False) or [""]
    return [f'"{line}"' for line in lines]  # blanks at the ends are kept


# --- code -------------------------------------------------------------------------------------
def _is_force(command: str) -> bool:
    return command in {f"tau_{f}" for f in FORCE}


def _variables(commands: list[str]) -> dict[str, str]:
    """The variable of each command in the code."""
    found: dict[str, str] = {}
    for i, name in enumerate(commands, start=1):
        short = identifier(name)
        usable = short == name and short.isidentifier() and short not in _USED
        found[name] = short if usable else f"command_{i}"
    return found


def _signals(terms: tuple[Coefficient, ...], variables: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Names that the terms use, with their definitions."""
    names = {without_bars(m[3] if (m := WAVE.fullmatch(f)) else f) for t in terms for f in t.column}
    yield from ((n, f"s.nu_r[{i}]") for i, n in enumerate(VELOCITY) if n in names)
    yield from ((n, f"s.eta[{i}]") for i, n in enumerate(POSE) if n in names)
    for name, variable in variables.items():
        force = f"s.generalised_force[{FORCE.index(name[-1])}]" if _is_force(name) else ""
        yield variable, force or f"self._command(s, {literal(name)})"


def _code(term: Coefficient, variables: dict[str, str]) -> str:
    timing, factors = term.timing, [_factor(f, variables) for f in term.column]
    if timing is not None and timing.sharpness:
        # x / sqrt(1 + x^2) has a slope in its time also far from the step, unlike tanh.
        step = f"(1 + sm.sin(sm.atan({timing.sharpness:.4g} * (s.t / self.{timing.name} - 1)))) / 2"
        factors = [*factors[1:], step]
    elif timing is not None:
        factors = [f"sm.{term.column[0]}(self.{timing.name} * s.t)"]
    return " * ".join([f"self.{term.name}", *factors])


def _factor(factor: str, variables: dict[str, str]) -> str:
    wave = WAVE.fullmatch(factor)
    if wave:
        return f"sm.{wave[1]}({'2 * ' if wave[2] else ''}{wave[3]})"
    command = command_of(factor)
    name = "s.t" if factor == "t" else without_bars(factor) if command is None else variables[command]
    return f"sm.Abs({name})" if factor.startswith("|") else name
