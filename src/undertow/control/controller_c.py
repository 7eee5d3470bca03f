"""A controller as a module of a C library: one step, and the allocation of a force alone."""

from __future__ import annotations

from undertow.codegen.manifest import UNITS, Entry
from undertow.codegen.spelling import Dialect, Part, comment, fill, identifier, slug
from undertow.codegen.vehicle_c import EXAMPLE
from undertow.model.symbols import FORCE, FORCE_UNITS

from .controller import Controller

_HEADING = "@REAL@ @LOWER@_heading(@REAL@ x_0, @REAL@ y_0, @REAL@ x_d, @REAL@ y_d)"
_RULES = {
    "atan2": "  return @CALL@(atan2)(y_d - y_0, x_d - x_0);",
    "atan": """\
  const @REAL@ north = x_d - x_0;
  const @REAL@ east = y_d - y_0;
  const @REAL@ zero = (@REAL@)0;
  @REAL@ heading = (east > zero) ? @CALL@(acos)(zero) : ((east < zero) ? -@CALL@(acos)(zero) : zero);
  if ((north < zero) || (north > zero)) {
    heading = @CALL@(atan)(east / north);
  }
  return heading;""",
}


def controller_c(controller: Controller, c: Dialect) -> Part:
    """The part of a controller."""
    return _ControllerC(controller, c).part()


class _ControllerC:
    def __init__(self, controller: Controller, c: Dialect) -> None:
        self._controller, self._c = controller, c
        self._vehicle = controller.gains.plant.vehicle
        self._name = f"{c.library}_{identifier(slug(controller.gains.name))}"
        self._parametrised = controller.parametrised()
        self._structs = {"p": c.struct(f"{self._name}_parameters", self._parameters())}
        if controller.reference is not None:
            mission = [Entry(n.name, n.unit, n.value) for n in controller.reference.numbers]
            self._structs["r"] = c.struct(f"{self._name}_mission", mission)

    def part(self) -> Part:
        gains = self._controller.gains
        what = f"controller {comment(gains.name)}, law {gains.law.id}"
        return Part(what, self._notes(), self._declarations(), self._definitions(), self._example())

    def _parameters(self) -> list[Entry]:
        law, pose = type(self._controller.gains.law), self._vehicle.pose_names
        units = {str(g.symbol(coordinate)): g.unit(coordinate) for g in law.gains for coordinate in pose}
        units |= {p.name: p.unit for p in self._vehicle.declared_parameters.values()}
        return [Entry(n, units.get(n, ""), v) for n, v in self._parametrised.values.items()]

    def _notes(self) -> dict[str, list[Entry]]:
        pose, velocity = self._vehicle.pose_names, self._vehicle.velocity_names
        commands = self._controller.command_names
        desired = {} if "r" in self._structs else {"r, desired pose": [Entry(n, UNITS[n]) for n in pose]}
        return {
            "y, what the sensors report": [Entry(n, UNITS[n]) for n in (*pose, *velocity)],
            **desired,
            "s, states of the controller": [Entry(n, "") for n in self._controller.state_names],
            "u, commands, to be held until the next step": [
                Entry(n, UNITS.get(n, "command")) for n in commands
            ],
            "tau, force that the law asks for, body frame; at its limits u gives less": [
                Entry(f"tau_{FORCE[i]}", FORCE_UNITS[i]) for i in self._vehicle.dof_indices
            ],
        }

    @property
    def _has_heading_rule(self) -> bool:
        return {"x", "y", "psi"} <= set(self._vehicle.pose_names) and "r" not in self._structs

    @property
    def _heading(self) -> str:
        rule = _RULES[self._controller.gains.schedule.heading]
        words = {"REAL": self._c.real, "LOWER": self._name, "CALL": self._c.call}
        return fill(f"{_HEADING} {{\n{rule}\n}}\n", words)

    def _declarations(self) -> list[str]:
        name, c, f = self._name, self._c, self._parametrised
        counts = {"REPORTS": 2 * len(self._vehicle.dof_indices), "STATES": len(self._controller.state_names)}
        counts |= {"COMMANDS": f.control.numel_out("u"), "FORCES": f.control.numel_out("tau")}
        sizes = ", ".join(f"{name.upper()}_{what} = {size}" for what, size in counts.items())
        lines = [
            f"enum {{ {sizes} }};\n",
            *(struct.declarations for struct in self._structs.values()),
            "/* States at the start: integrals at zero, the gate of the schedule closed if there is one. */",
            f"void {name}_start({c.real} *s);\n",
            "/* One sample: commands u, states after dt seconds (s_next may be s) and force tau. */",
            c.prototype(f.control, f"{name}_step", self._structs),
            "\n/* Commands of a wanted force alone. */",
            c.prototype(f.allocate, f"{name}_allocate", {"p": self._structs["p"]}),
            "",
        ]
        if self._has_heading_rule:
            heading = self._heading
            lines += ["/* Desired heading from where the vehicle begins to the set-point, rad. */"]
            lines += [heading[: heading.index(" {\n")] + ";\n"]
        return lines

    def _definitions(self) -> list[str]:
        name, c, f = self._name, self._c, self._parametrised
        start = enumerate(self._controller.initial_states())
        states = "\n".join(f"  s[{i}] = {c.constant(value)};" for i, value in start)
        lines = [
            *(struct.definitions for struct in self._structs.values()),
            f"void {name}_start({c.real} *s) {{\n{states}\n}}\n",
            c.definition(f.control, f"{name}_step", self._structs),
            c.definition(f.allocate, f"{name}_allocate", {"p": self._structs["p"]}),
        ]
        return [*lines, self._heading] if self._has_heading_rule else lines

    def _example(self) -> str:
        n, upper, real, c = self._name, self._name.upper(), self._c.real, self._c
        desired = f"const {n}_mission r = {n}_mission_default;"
        given = "&r"
        if "r" not in self._structs:
            desired = f"const {real} r[{len(self._vehicle.dof_indices)}] = {{{c.constant(1)}}};"
            given = "r"
        return f"""\
  const {n}_parameters p = {n}_parameters_default; /* change what differs on your vehicle */
  {desired}
  const {real} y[{upper}_REPORTS] = {{0}};
  {real} s[{upper}_STATES], u[{upper}_COMMANDS], tau[{upper}_FORCES];
  {n}_start(s);
  {n}_step(y, {given}, s, &p, {c.constant(EXAMPLE.step)}, u, s, tau);
  for (int i = 0; i < {upper}_COMMANDS; i++) {{
    printf("%.9g\\n", (double)u[i]);
  }}"""
