"""The text of an effect file."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from undertow.model.symbols import DOFS, FORCE, POSE, VELOCITY

from ..diagnosis.associations.terms import WAVE, command_of, plain_of
from .suggestion import Coefficient, Suggestion, class_name, identifier, literal, plain

_WIDTH = 100
_USED = {"s", "sm", "self", "t", *POSE, *VELOCITY, *DOFS}


def effect_file(effect_id: str, file: str, suggestion: Suggestion) -> str:
    """Text of a Python file with one effect.

    Parameters
    ----------
    effect_id : str
        Id of the effect.
    file : str
        Name that the file will have.
    suggestion : Suggestion
        Terms of the effect, and where they come from.
    """
    return str(_template().render(**_content(effect_id, file, suggestion))).rstrip() + "\n"


@cache
def _template() -> Any:
    environment = Environment(
        loader=PackageLoader("undertow.identification.scaffold"),
        autoescape=False,  # Python, not HTML: every text is made harmless by `plain`
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    return environment.get_template("effect.txt")


def _content(effect_id: str, file: str, suggestion: Suggestion) -> dict[str, Any]:
    commands = _commands(suggestion.terms)
    variables = _variables(commands)
    rows = [[t for t in suggestion.terms if t.row == i] for i in range(6)]
    return {
        "id": effect_id,
        "file": plain(file),
        "cls": class_name(effect_id),
        "about": _wrapped(suggestion.about, "    ").strip(),
        "origin": [_wrapped(line, "    ") for line in suggestion.origin],
        "left_out": [_wrapped(f"- {line}", "    ") for line in suggestion.left_out],
        "reference": _split(suggestion.reference),
        "signature": _split(suggestion.signature),
        "parameters": [(t.name, literal(t.unit), _split(t.about)) for t in suggestion.terms],
        "waves": list({t.wave.name: t.wave for t in suggestion.terms if t.wave is not None}.values()),
        "commands": [literal(c) for c in commands if not _is_force(c)],
        "signals": list(_signals(suggestion.terms, variables)),
        "forces": [(DOFS[i], [_code(t, variables) for t in row]) for i, row in enumerate(rows) if row],
        "rows": ", ".join(DOFS[i] if row else "0" for i, row in enumerate(rows)),
    }


def _wrapped(text: str, indent: str) -> str:
    more = f"{indent}  " if text.startswith("- ") else indent
    return textwrap.fill(plain(text), _WIDTH, initial_indent=indent, subsequent_indent=more)


def _split(text: str) -> list[str]:
    """A long text as literals that Python joins."""
    lines = textwrap.wrap(plain(text), _WIDTH - 20, drop_whitespace=False) or [""]
    return [literal_kept(line) for line in lines]


def literal_kept(line: str) -> str:
    """A literal that keeps blanks at its ends."""
    return f'"{line}"'


# --- code -------------------------------------------------------------------------------------
def _commands(terms: tuple[Coefficient, ...]) -> list[str]:
    names = (command_of(f) for t in terms for f in t.column)
    return list(dict.fromkeys(n for n in names if n is not None))


def _is_force(command: str) -> bool:
    return command in {f"tau_{f}" for f in FORCE}


def _variables(commands: list[str]) -> dict[str, str]:
    """What each command is called in the code."""
    found: dict[str, str] = {}
    for i, name in enumerate(commands, start=1):
        short = identifier(name)
        usable = short == name and short.isidentifier() and short not in _USED
        found[name] = short if usable else f"command_{i}"
    return found


def _signals(terms: tuple[Coefficient, ...], variables: dict[str, str]) -> Iterator[tuple[str, str]]:
    """Names that the terms use, with what they stand for."""
    names = {plain_of(m[3] if (m := WAVE.fullmatch(f)) else f) for t in terms for f in t.column}
    yield from ((n, f"s.nu_r[{i}]") for i, n in enumerate(VELOCITY) if n in names)
    yield from ((n, f"s.eta[{i}]") for i, n in enumerate(POSE) if n in names)
    for name, variable in variables.items():
        force = f"s.generalised_force[{FORCE.index(name[-1])}]" if _is_force(name) else ""
        yield variable, force or f"self._command(s, {literal(name)})"


def _code(term: Coefficient, variables: dict[str, str]) -> str:
    if term.wave is not None:
        return f"self.{term.name} * sm.{term.column[0]}(self.{term.wave.name} * s.t)"
    return " * ".join([f"self.{term.name}", *(_factor(f, variables) for f in term.column)])


def _factor(factor: str, variables: dict[str, str]) -> str:
    wave = WAVE.fullmatch(factor)
    if wave:
        return f"sm.{wave[1]}({'2 * ' if wave[2] else ''}{wave[3]})"
    command = command_of(factor)
    name = "s.t" if factor == "t" else plain_of(factor) if command is None else variables[command]
    return f"sm.Abs({name})" if factor.startswith("|") else name
