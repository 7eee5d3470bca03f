"""An observer as a module of a C library: predict, and one update for each sensor."""

from __future__ import annotations

import numpy as np

from undertow.codegen.manifest import Entry
from undertow.codegen.spelling import Dialect, Part, comment, identifier, slug
from undertow.model.symbols import MOTION_UNITS

from .design import Design
from .process import AT_REST, longest_step

_WORDS = """\
/* Predict over every interval with the commands that were held in it, then update with each report that has
   come in. A report that is late belongs to the time when it was true: keep x, P and the commands from that
   time on (a ring of as many as the delay has intervals), update the old x and P, and predict them to the
   present again. */
"""


def observer_c(design: Design, c: Dialect) -> Part:
    """The part of an observer.

    Raises
    ------
    UndertowError
        If the model cannot be stated in C.
    """
    process = design.process
    what = f"observer {comment(design.name)}, an extended Kalman filter"
    notes = {
        "x, the state, and P, its covariance, row by row": [
            Entry(n, MOTION_UNITS.get(n, "")) for n in process.state_names
        ],
        "u, commands of the vehicle": [Entry(n, unit) for n, unit in process.vehicle.command_units.items()],
        "y, reports, with the standard deviation of their noise": [
            Entry(n, MOTION_UNITS[n], sigma) for n, sigma in design.noise.items()
        ],
    }
    return Part(what, notes, *_code(design, c), _example(design, c))


def _code(design: Design, c: Dialect) -> tuple[list[str], list[str]]:
    """Lines of header and source."""
    process, numbered = design.process, design.numbered()
    name, n, real = _name(design, c), process.x.numel(), c.real
    spread = np.sqrt(np.diagonal(AT_REST.covariance(process)))
    first = {f"initial_{s}": float(v) for s, v in zip(process.state_names, spread, strict=True)}
    values = {**numbered.values, **first}
    units = process.vehicle.declared_parameters
    entries = [Entry(k, units[k].unit if k in units else "", v) for k, v in values.items()]
    # What stands for a start is no number of the functions: the struct has it behind theirs.
    struct = c.struct(f"{name}_parameters", entries)
    given = {"p": struct}
    updates = {f"{name}_update_{s}": (f"{name}_with_{s}", f) for s, f in numbered.updates.items()}
    u, v = name.upper(), f"const {struct.type} *p"
    arguments = f"{real} *x, {real} *P, const {real} *u, {v}, {real} t, {real} y"
    start = f"void {name}_start({real} *x, {real} *P, {v})"
    declared = [
        _WORDS,
        f"enum {{ {u}_NX = {n}, {u}_NU = {len(process.vehicle.command_names)} }};\n",
        struct.declared,
        "/* Switched on at rest at an unknown place; set what is known of x before the first update. */",
        f"{start};\n",
        f"/* From t to t + dt, s; keep dt below {longest_step(process):.2g} s, by several calls if need be;\n"
        "   xn and Pn may be x and P. */",
        c.head(numbered.predict, f"{name}_predict", given),
        "\n/* A report y, SI. Returned is the squared innovation over its variance: beyond p->gate y was\n"
        "   not believed. */",
        *(f"{real} {update}({arguments});" for update in updates),
        "",
    ]
    defined = [
        struct.defined,
        _start(start, struct.members[-n:], c),
        c.body(numbered.predict, f"{name}_predict", given),
    ]
    for update, (inner, function) in updates.items():
        call = f"  {real} nis;\n  {inner}(x, P, u, p, t, y, x, P, &nis);\n  return nis;"
        defined += [
            c.body(function, inner, given, static=True),
            f"{real} {update}({arguments}) {{\n{call}\n}}\n",
        ]
    return declared, defined


def _name(design: Design, c: Dialect) -> str:
    return f"{c.library}_{identifier(slug(design.name))}"


def _start(head: str, members: tuple[str, ...], c: Dialect) -> str:
    n, zero = len(members), c.constant(0)
    lines = [f"  for (int i = 0; i < {n}; i++) {{\n    x[i] = {zero};\n  }}"]
    lines += [f"  for (int i = 0; i < {n * n}; i++) {{\n    P[i] = {zero};\n  }}"]
    lines += [f"  P[{i * n + i}] = p->{m} * p->{m};" for i, m in enumerate(members)]
    return f"{head} {{\n" + "\n".join(lines) + "\n}\n"


def _example(design: Design, c: Dialect) -> str:
    n, upper, real = _name(design, c), _name(design, c).upper(), c.real
    step, zero = c.constant(longest_step(design.process) / 2), c.constant(0)
    return f"""\
  const {n}_parameters p = {n}_parameters_default; /* change what differs on your vehicle */
  const {real} u[{max(len(design.process.vehicle.command_names), 1)}] = {{0}};
  static {real} x[{upper}_NX], P[{upper}_NX * {upper}_NX];
  {n}_start(x, P, &p);
  {n}_predict(x, P, u, &p, {zero}, {step}, x, P);
  const {real} nis = {n}_update_{design.sensors[0]}(x, P, u, &p, {step}, {zero});
  printf("%.9g\\n", (double)nis);
  for (int i = 0; i < {upper}_NX; i++) {{
    printf("%.9g\\n", (double)x[i]);
  }}"""
