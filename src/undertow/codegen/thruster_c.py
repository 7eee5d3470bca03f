"""The module of a C library from newtons to commands and servo pulses."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from undertow.errors import UndertowError
from undertow.model.hardware import Curve, Propeller
from undertow.model.vehicle import Thruster, Vehicle
from undertow.typing import Array

from .manifest import Entry
from .spelling import Dialect, Part, filled


@dataclass(frozen=True)
class ThrusterSettings:
    """Numbers of thrusters in C."""

    # points of the table from thrust to command of a thruster with a curve: 33 keep the T200 to 1 %
    points: int = 33
    # neutral, span: servo pulse without thrust and from there to full thrust, microseconds: that of common
    # motor controllers, 1100 to 1900
    neutral: float = 1500.0
    span: float = 400.0
    # command up to which a thruster without curve and limit follows its line: beyond any thrust
    reach: float = 1e6


SETTINGS = ThrusterSettings()


def has_inverse(thruster: Thruster) -> bool:
    """Whether a thrust belongs to one command: not where it depends on the speed, or falls somewhere."""
    if isinstance(thruster.law, Curve):
        try:
            thruster.law.inverse(0.0)
        except UndertowError:
            return False
    return not isinstance(thruster.law, Propeller)


def thrusters_c(c: Dialect, vehicle: Vehicle) -> Part:
    """The part of thrusters that `has_inverse`."""
    n, real, count = c.library, c.real, len(vehicle.thrusters)
    tables = [_inverse(t) for t in vehicle.thrusters]
    size = max(len(x) for x, _ in tables)
    full = max((t.limit for t in vehicle.thrusters if t.limit is not None), default=1.0)
    template = (files("undertow.codegen") / "templates" / "thrusters.c").read_text(encoding="utf-8")
    tail = filled(template, {"LOWER": n, "UPPER": n.upper()})
    numbers = {
        "neutral": (SETTINGS.neutral, "microseconds without thrust"),
        "span": (SETTINGS.span, "microseconds from there to full thrust"),
        "full_command": (full, "command of full thrust"),
    }
    members = "".join(f"  {real} {name}; /* {words} */\n" for name, (_, words) in numbers.items())
    upper = n.upper()
    declared = [
        f"enum {{ {upper}_THRUSTERS = {count}, {upper}_POINTS = {size} }};\n",
        "/* Thrusts, N, that rise, and the commands that give them, for each thruster; the servo's pulse. */",
        f"typedef struct {{\n  {real} thrusts[{count}][{size}];",
        f"  {real} commands[{count}][{size}];\n{members}"
        f"}} {n}_thrusters;\nextern const {n}_thrusters {n}_thrusters_default;\n",
        "/* Command of a thrust in N; width of the servo pulse of a command, microseconds. */",
        *(f"{h};" for h in re.findall(rf"^({real} \w+\([^)]*\)) {{$", tail, re.MULTILINE)),
        "",
    ]
    rows = ",\n".join(_rows(c, [t[k] for t in tables], size) for k in (0, 1))
    values = ", ".join(c.constant(value) for value, _ in numbers.values())
    defined = [f"const {n}_thrusters {n}_thrusters_default = {{\n{rows},\n  {values}}};\n", tail]
    notes = {"thrusters, by their commands": [Entry(t.name, t.command_unit) for t in vehicle.thrusters]}
    return Part("commands of thrusts, and servo pulses", notes, declared, defined, _example(c))


def _rows(c: Dialect, columns: list[Array], size: int) -> str:
    """One table; shorter rows go on with their last value."""
    padded = [np.pad(column, (0, size - len(column)), mode="edge") for column in columns]
    lines = ",\n    ".join("{" + ", ".join(c.constant(v) for v in row) + "}" for row in padded)
    return f"  {{\n    {lines}}}"


def _inverse(thruster: Thruster) -> tuple[Array, Array]:
    """Thrusts that rise, and the commands that give them."""
    scale = thruster.thrust_per_command.value
    if isinstance(thruster.law, Curve):
        curve, half = thruster.law, SETTINGS.points // 2 + 1
        least, most = (curve.at(e) for e in (curve.pieces[0][0], curve.pieces[-1][1]))
        # Zero is a point of its own: the dead band of a curve is left at its middle.
        forces = np.unique(np.concatenate([np.linspace(least, 0, half), np.linspace(0, most, half)]))
        commands = np.array([curve.inverse(float(v)) for v in forces])
    else:
        forces = commands = np.array([-1.0, 1.0]) * (thruster.limit or SETTINGS.reach)
    order = np.argsort(forces * scale)  # one that is mounted backwards pushes back where its curve rises
    return (forces * scale)[order], commands[order]


def _example(c: Dialect) -> str:
    n, upper, one = c.library, c.library.upper(), c.constant(1)
    return f"""\
  const {n}_thrusters h = {n}_thrusters_default;
  for (int i = 0; i < {upper}_THRUSTERS; i++) {{
    const {c.real} command = {n}_command(i, {one}, &h);
    printf("%.9g %.9g\\n", (double)command, (double){n}_pulse(command, &h));
  }}"""
