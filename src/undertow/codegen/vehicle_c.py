"""The vehicle's own modules of a C library: the model that is stepped, and its Jacobians."""

from __future__ import annotations

import re
from dataclasses import dataclass
from importlib.resources import files

import numpy as np

from undertow.errors import UndertowError
from undertow.model.effect import Curve, Propeller
from undertow.model.symbols import FORCE, FORCE_UNITS
from undertow.model.units import PULSES
from undertow.model.vehicle import Thruster, Vehicle
from undertow.typing import Array

from .functions import Functions
from .manifest import Entry, Manifest
from .spelling import Dialect, Part, Struct, comment, fill


@dataclass(frozen=True)
class ExampleSettings:
    """The runs of the examples."""

    step: float = 0.02  # of the simulation, and the sample of a controller, s
    steps: int = 500
    steps_between_rows: int = 25  # that it prints


EXAMPLE = ExampleSettings()


def _parameters(c: Dialect, manifest: Manifest) -> Struct:
    return c.struct(f"{c.library}_parameters", manifest.parameters)


def vehicle_c(c: Dialect, functions: Functions, manifest: Manifest) -> Part:
    """The part that steps the model: dynamics, outputs, one Runge-Kutta step."""
    n, upper = c.library, c.library.upper()
    p = _parameters(c, manifest)
    made = {f"{n}_dynamics": functions.dynamics, f"{n}_outputs": functions.outputs}
    sizes = {"STATES": len(manifest.states), "INPUTS": len(manifest.inputs)}
    sizes |= {"PARAMETERS": len(functions.parameter_names)}
    sizes["DOF"] = len(functions.vehicle.degrees_of_freedom)
    counts = ", ".join(f"{upper}_{what} = {size}" for what, size in sizes.items())
    template = (files("undertow.codegen") / "templates" / "vehicle.c").read_text(encoding="utf-8")
    step = fill(template, {"LOWER": n, "UPPER": upper})
    declared = [
        f"enum {{ {counts} }};\n",
        p.declarations,
        "/* Time derivative of the state at time t: x_dot (STATES). */",
        c.prototype(functions.dynamics, f"{n}_dynamics", {"p": p}),
        "\n/* Pose and body velocity as the sensors report them: y (2 DOF). */",
        c.prototype(functions.outputs, f"{n}_outputs", {"p": p}),
        "\n/* One fourth-order Runge-Kutta step of h seconds from t, u held. */",
        step[step.index("void") : step.index(" {\n")] + ";\n",
    ]
    defined = [p.definitions, *(c.definition(f, name, {"p": p}) for name, f in made.items()), step]
    notes = {"x, state": manifest.states, "u, input, held by the caller": manifest.inputs}
    return Part("model", notes, declared, defined, _example(c, manifest), about_model=True)


def jacobians_c(c: Dialect, functions: Functions, manifest: Manifest) -> Part:
    """The part with derivatives of the model, for filters, predictive control and identification."""
    n = c.library
    p = _parameters(c, manifest)
    made = {
        f"{n}_jacobians": functions.jacobians,
        f"{n}_residual": functions.residual_function,
        f"{n}_regressor": functions.regressor,
    }
    words = (
        "/* Dynamics, and derivatives in the state A (STATES x STATES), the input B (STATES x INPUTS) and\n"
        "   the parameters P (STATES x PARAMETERS: the first members of the struct, without those of the\n"
        "   hardware, which follow); matrices row by row. */",
        "\n/* Sum of forces and moments, N and N m, at an acceleration nu_dot: zero at the true one. */",
        "\n/* Derivative of the residual in the parameters: Y (DOF x PARAMETERS). */",
    )
    heads = [c.prototype(f, name, {"p": p}) for name, f in made.items()]
    declared = [
        f'#include "{n}_vehicle.h"\n',
        *(x for both in zip(words, heads, strict=True) for x in both),
        "",
    ]
    defined = [c.definition(f, name, {"p": p}) for name, f in made.items()]
    dofs = functions.vehicle.dof_indices
    notes = {"r, rows": [Entry(f"tau_{FORCE[i]}", FORCE_UNITS[i]) for i in dofs]}
    what, example = "Jacobians, residual and regressor", _example_of_jacobians(c, functions)
    return Part(what, notes, declared, defined, example, about_model=True)


def _example(c: Dialect, manifest: Manifest) -> str:
    """Steps the model for 10 s from rest under constant inputs and prints the states as CSV."""
    n, upper, real = c.library, c.library.upper(), c.real
    u = ", ".join(c.constant(float(f"{1 / (i + 1):.3g}")) for i in range(len(manifest.inputs))) or c.constant(
        0
    )
    head = ",".join(["t", *(comment(e.name) for e in manifest.states)])
    return f"""\
  const {real} h = {c.constant(EXAMPLE.step)}, u[] = {{{u}}};
  const {n}_parameters p = {n}_parameters_default; /* change what differs on your vehicle */
  {real} x[{upper}_STATES] = {{0}};
  printf("{head}\\n");
  for (int k = 0; k <= {EXAMPLE.steps}; k++) {{
    if (k % {EXAMPLE.steps_between_rows} == 0) {{
      printf("%.17g", (double)(({real})k * h));
      for (int i = 0; i < {upper}_STATES; i++) {{
        printf(",%.17g", (double)x[i]);
      }}
      printf("\\n");
    }}
    {n}_vehicle_step(x, u, &p, ({real})k * h, h);
  }}"""


def _example_of_jacobians(c: Dialect, functions: Functions) -> str:
    n, upper, real = c.library, c.library.upper(), c.real
    outs = functions.jacobians.name_out()
    sizes = [functions.jacobians.numel_out(name) for name in outs]
    arrays = ", ".join(f"{name}[{max(size, 1)}]" for name, size in zip(outs, sizes, strict=True))
    return f"""\
  const {real} x[{upper}_STATES] = {{0}}, u[{max(functions.u.numel(), 1)}] = {{0}};
  static {real} {arrays};
  {n}_jacobians(x, u, &{n}_parameters_default, {c.constant(0)}, {", ".join(outs)});
  for (int i = 0; i < {upper}_STATES; i++) {{
    printf("%.9g\\n", (double)A[i]);
  }}"""


# --- thrusters -----------------------------------------------------------------------------------------
@dataclass(frozen=True)
class ThrusterSettings:
    """Numbers of thrusters in C."""

    # points of the table from thrust to command of a thruster with a curve: 33 keep the T200 to 1%
    points: int = 33
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
    tail = fill(template, {"LOWER": n, "UPPER": n.upper()})
    numbers = {
        "neutral": (PULSES.neutral, "microseconds without thrust"),
        "span": (PULSES.span, "microseconds from there to full thrust"),
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
    return Part("commands of thrusts, and servo pulses", notes, declared, defined, _example_of_thrusters(c))


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


def _example_of_thrusters(c: Dialect) -> str:
    n, upper, one = c.library, c.library.upper(), c.constant(1)
    return f"""\
  const {n}_thrusters h = {n}_thrusters_default;
  for (int i = 0; i < {upper}_THRUSTERS; i++) {{
    const {c.real} command = {n}_command(i, {one}, &h);
    printf("%.9g %.9g\\n", (double)command, (double){n}_pulse(command, &h));
  }}"""
