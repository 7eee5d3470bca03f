"""An observer as a module of a C library: predict, and one update for each sensor."""

from __future__ import annotations

from importlib.resources import files
from math import ceil

import numpy as np

from undertow.codegen.manifest import Entry
from undertow.codegen.spelling import Dialect, Part, comment, fill, identifier, slug
from undertow.model.symbols import MOTION_UNITS

from .design import SETTINGS as DESIGN
from .design import Design
from .filters import SETTINGS as FILTER
from .process import AT_REST, longest_step

_WORDS = """\
/* Predict over every interval with the commands that were held in it, then update with each report that has
   come in. */
"""
# What is declared where reports come late, an update in `late.c`, and what uses one.
_LATE = """\
/* Reports of @NAMES@ come late. Earlier steps are kept, so that a report is used when it was true
   and what followed is done again: begin after start, step in place of predict, report in place of update.
   -1 is returned of a report that belongs to no step that is kept: they are enough for steps of @STEP@ s.
   x and P are those of the newest step. */
enum { @UPPER@_KEPT = @KEPT@ };
typedef struct {
  @REAL@ t[@KEPT@]; /* time of each step, s, its length, and the commands that were held in it */
  @REAL@ dt[@KEPT@];
  @REAL@ u[@KEPT@][@COMMANDS@];
  @REAL@ x[@KEPT@][@N@]; /* state and covariance before its reports */
  @REAL@ P[@KEPT@][@N@ * @N@];
  @REAL@ y[@KEPT@][@SENSORS@]; /* its reports, and which there are */
  int there[@KEPT@][@SENSORS@];
  int newest;
  int kept;
} @NAME@_memory;

void @NAME@_begin(@NAME@_memory *m, const @REAL@ *x, const @REAL@ *P, @REAL@ t);
void @NAME@_step(@NAME@_memory *m, @REAL@ *x, @REAL@ *P, const @REAL@ *u, const @NAME@_parameters *p,
    @REAL@ dt);
"""
_REPORTED = """\
    if (m->there[k][@PLACE@] != 0) {
      const @REAL@ nis = @NAME@_update_@SENSOR@(x, P, m->u[k], p, m->t[k], m->y[k][@PLACE@]);
      found = ((k == from) && (sensor == @PLACE@)) ? nis : found;
    }"""
_HEAD = """\
@REAL@ @NAME@_report_@SENSOR@(@NAME@_memory *m, @REAL@ *x, @REAL@ *P, const @NAME@_parameters *p, @REAL@ y)"""
# Body of what uses a report that may come late.
_REPORT = """\
  @REAL@ age[@SENSORS@];
  @NAME@_ages(p, age);
  return @NAME@_late(m, x, P, p, @PLACE@, age[@PLACE@], y);
"""
# Body of the update by one sensor.
_UPDATES = {
    "ekf": """\
  @REAL@ nis;
  @NAME@_with_@SENSOR@(x, P, u, p, t, y, x, P, &nis);
  return nis;
""",
    "ukf": """\
  @REAL@ s[@COUNT@ * @N@];
  @REAL@ z[@COUNT@];
  @NAME@_points(x, P, s);
  for (int k = 0; k < @COUNT@; k++) {
    @NAME@_reported_@SENSOR@(&s[k * @N@], u, p, t, &z[k]);
  }
  return @NAME@_update_by(x, P, s, z, y, p->noise_@SENSOR@ * p->noise_@SENSOR@, p->gate, @ANGLE@);
""",
}


def observer_c(design: Design, c: Dialect) -> Part:
    """The part of an observer."""
    design = design.with_names()
    process = design.process
    kind = {"ekf": "extended", "ukf": "unscented"}[design.method]
    what = f"observer {comment(design.name)}, an {kind} Kalman filter"
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
    process, numbered = design.process, design.parametrised()
    name, n, real = _name(design, c), process.x.numel(), c.real
    spread = np.sqrt(np.diagonal(AT_REST.covariance(process)))
    first = {f"initial_{s}": float(v) for s, v in zip(process.state_names, spread, strict=True)}
    values = {**numbered.values, **first}
    units = {e.name: e.unit for e in process.numbers}
    entries = [Entry(k, units.get(k, ""), v) for k, v in values.items()]
    # What stands for a start is no number of the functions: the struct has it behind theirs.
    struct = c.struct(f"{name}_parameters", entries)
    given = {"p": struct}
    u, v = name.upper(), f"const {struct.type} *p"
    predict = (
        f"void {name}_predict(const {real} *x, const {real} *P, const {real} *u, {v}, "
        f"{real} t, {real} dt, {real} *xn, {real} *Pn)"
    )
    update = f"{real} {name}_update_{{}}({real} *x, {real} *P, const {real} *u, {v}, {real} t, {real} y)"
    start = f"void {name}_start({real} *x, {real} *P, {v})"
    declared = [
        _WORDS,
        f"enum {{ {u}_NX = {n}, {u}_NU = {len(process.vehicle.command_names)} }};\n",
        struct.declarations,
        "/* Switched on at rest at an unknown place; set what is known of x before the first update. */",
        f"{start};\n",
        f"/* From t to t + dt, s; keep dt below {longest_step(process):.2g} s, by several calls if need be;\n"
        "   xn and Pn may be x and P. */",
        f"{predict};",
        "\n/* A report y, SI. Returned is the squared innovation over its variance: beyond p->gate y was\n"
        "   rejected. */",
        *(f"{update.format(sensor)};" for sensor in design.sensors),
        "",
    ]
    bodies = [
        c.definition(f, f"{name}_{k}", given, static=k != "predict") for k, f in numbered.functions.items()
    ]
    fields = _fields(name, n, c)
    if design.method == "ukf":
        template = (files("undertow.observer") / "unscented.c").read_text(encoding="utf-8")
        bodies.append(fill(template, fields))
    for sensor in design.sensors:
        fields |= {"SENSOR": sensor, "ANGLE": int(process.angles[process.channels.index(sensor)])}
        bodies.append(f"{update.format(sensor)} {{\n{fill(_UPDATES[design.method], fields)}}}\n")
    defined = [struct.definitions, _start(start, struct.members[-n:], c), *bodies]
    kept = _kept(design, fields) if design.late else ([], [])
    return declared + kept[0], defined + kept[1]


def _kept(design: Design, fields: dict[str, object]) -> tuple[list[str], list[str]]:
    """Lines of header and source where reports come late."""
    periods = [float(p) for p in design.period if p > 0] or [DESIGN.sample]
    step, longest = min(*periods, longest_step(design.process)), max(design.late.values())
    own = fields | {
        **{"NAMES": ", ".join(design.late), "STEP": f"{step:.4g}", "UPPER": str(fields["NAME"]).upper()},
        **{"KEPT": ceil(longest / step * (1 - 1e-9)) + 2, "SENSORS": len(design.sensors)},
        "COMMANDS": max(len(design.process.vehicle.command_names), 1),
    }
    each = [own | {"PLACE": i, "SENSOR": name} for i, name in enumerate(design.sensors)]
    template = (files("undertow.observer") / "late.c").read_text(encoding="utf-8")
    declared, defined = (
        [fill(_LATE, own)],
        [fill(template, own | {"UPDATES": "\n".join(fill(_REPORTED, one) for one in each)})],
    )
    for one in each:
        head = fill(_HEAD, one)
        declared.append(f"{head};")
        defined.append(f"{head} {{\n{fill(_REPORT, one)}}}\n")
    return [*declared, ""], defined


def _fields(name: str, n: int, c: Dialect) -> dict[str, object]:
    """What the C of a filter of n states is filled with."""
    centre, share, spread = FILTER.weights(n)
    numbers = {
        **{"ZERO": 0, "HALF": 0.5, "ONE": 1, "TURN": 2 * np.pi, "ROUNDING": FILTER.rounding},
        **{"REACH": np.sqrt(FILTER.reach(n)), "SHARE": share, "CENTRE": centre, "SPREAD": spread},
    }
    words = {"NAME": name, "REAL": c.real, "CALL": c.call, "N": n, "COUNT": 2 * n + 1}
    return words | {k: c.constant(v) for k, v in numbers.items()}


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
