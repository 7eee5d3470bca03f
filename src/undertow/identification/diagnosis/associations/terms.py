"""What a residual force may go with: products of motions, angles, commands and time.

A factor is a short text (``u``, ``|r|``, ``sin(2 psi)``, ``z``, ``t``, ``command f1``), a column is a product
of factors, and a term is one column, or a sine and a cosine that belong together.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from undertow.identification.logs.run import UNITS
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

Column = tuple[str, ...]
_COMMAND = "command "
_ANGLES = ("psi", "phi", "theta")
WAVE = re.compile(r"(sin|cos)\((2 )?(psi|phi|theta)\)")


@dataclass(frozen=True)
class Term:
    """Columns that are judged together.

    Attributes
    ----------
    label : str
        What the term is called.
    columns : tuple of Column
        Factors of each column.
    """

    label: str
    columns: tuple[Column, ...]


def terms_of(vehicle: Vehicle, pose: tuple[str, ...]) -> list[Term]:
    """Every term that the motions, the measured pose and the commands of a vehicle give."""
    velocities, commands = vehicle.velocity_names, [_COMMAND + n for n in vehicle.command_names]
    columns: list[Column] = [(), ("t",)]
    for a in velocities:
        columns += [(a,), (f"|{a}|", a), (a, a), ("t", a), ("t", f"|{a}|", a)]
    columns += combinations(velocities, 2)
    columns += [(f"|{a}|", b) for a, b in permutations(velocities, 2)]
    columns += _by_commands(commands, velocities)
    columns += [(n,) for n in pose if n in ("x", "y", "z")] + [
        (f"sin({n})",) for n in pose if n in _ANGLES[1:]
    ]
    turns = [_heading("psi"), _heading("2 psi")] if "psi" in pose else []
    if {"psi", "z"} <= set(pose):
        turns.append(_heading("psi", "z"))
    return [*(Term(label_of(c), (c,)) for c in columns), *turns]


def _by_commands(commands: list[str], velocities: tuple[str, ...]) -> Iterator[Column]:
    for c in commands:
        yield from ((c,), (f"|{c}|", c), (c, c))
        yield from ((c, a) for a in velocities)
        yield from ((f"|{c}|", a) for a in velocities)
    for c, d in combinations(commands, 2):
        yield from ((c, d), (f"|{c}|", f"|{d}|"))


def _heading(angle: str, *factors: str) -> Term:
    both = tuple((*factors, f"{f}({angle})") for f in ("sin", "cos"))
    return Term(" ".join([*factors, f"sin and cos of {angle}"]), both)


def label_of(column: Column) -> str:
    """A column as people write it: ``|r| u``, ``t |u| u``."""
    return " ".join(f.replace(_COMMAND, "") for f in column) or "a constant"


def plain_of(factor: str) -> str:
    """A factor without its bars: ``|r|`` gives ``r``."""
    return factor[1:-1] if factor.startswith("|") and factor.endswith("|") else factor


def command_of(factor: str) -> str | None:
    """Name of the command in a factor, or None where it is none."""
    plain = plain_of(factor)
    return plain.removeprefix(_COMMAND) if plain.startswith(_COMMAND) else None


def unit_of(factor: str) -> str:
    """SI unit of a factor; that of a thruster's command is ``command``.

    Raises
    ------
    KeyError
        If the text is no factor.
    """
    name = command_of(factor)
    if name is not None:
        return UNITS.get(name, "command")
    if WAVE.fullmatch(factor):
        return "1"
    plain = plain_of(factor)
    return "s" if factor == "t" else {**UNITS, "t": ""}[plain]


def coefficient_unit(force: str, column: Column) -> str:
    """Unit of what multiplies a column to give a force in `force`: ``N/((m/s)^2 s)``."""
    count = Counter(u for u in map(unit_of, column) if u != "1")
    below = " ".join(_power(f"({u})" if "/" in u or " " in u else u, n) for u, n in count.items())
    return f"{force}/({below})" if len(count) > 1 else f"{force}/{below}" if count else force


def _power(unit: str, exponent: int) -> str:
    return unit if exponent == 1 else f"{unit}^{exponent}"


@dataclass(frozen=True)
class Along:
    """Motion and commands at N samples, from which columns are worked out.

    Attributes
    ----------
    values : dict of (N,) arrays
        Velocities through the water, pose and time.
    commands : dict of (N,) arrays
        What reaches each thruster, and known forces; held between samples.
    """

    values: dict[str, Array]
    commands: dict[str, Array]

    def smooth(self, column: Column) -> Array:
        """Product of the factors that are no commands, shape (N,)."""
        factors = [self._value(f) for f in column if command_of(f) is None]
        return np.prod([np.ones_like(self.values["t"]), *factors], axis=0)

    def held(self, column: Column) -> Array | None:
        """Product of the factors that are commands, shape (N,); None where there is none."""
        names = [(f, command_of(f)) for f in column]
        found = [
            np.abs(self.commands[n]) if f[0] == "|" else self.commands[n] for f, n in names if n is not None
        ]
        return np.prod(found, axis=0) if found else None

    def _value(self, factor: str) -> Array:
        wave = WAVE.fullmatch(factor)
        if wave:
            angle = (2 if wave[2] else 1) * self.values[wave[3]]
            return np.asarray(np.sin(angle) if wave[1] == "sin" else np.cos(angle))
        value = self.values[plain_of(factor)]
        return np.abs(value) if factor.startswith("|") else value


def is_factor(text: str) -> bool:
    """Whether a text is a factor."""
    return bool(WAVE.fullmatch(text)) or text in ("t", *POSE[:3]) or _is_motion(text)


def _is_motion(text: str) -> bool:
    return plain_of(text) in VELOCITY or command_of(text) is not None
