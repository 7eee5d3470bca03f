"""C libraries for boards: vehicle, controller and allocation, float or double, parameters in structs."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from math import isinf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import casadi as ca
import numpy as np

from undertow.codegen.export import Entry, comment, describe, filled, identifier, listing, slug
from undertow.codegen.functions import Functions
from undertow.codegen.plain import Structs, Words, plain_c, signature
from undertow.codegen.source import CALLS, FORMS, TWO_OPERANDS
from undertow.control.allocation import Allocation, allocation_of
from undertow.control.controller import Controller, thruster_commands
from undertow.control.gains import GainSet
from undertow.errors import UndertowError
from undertow.files import make_folder, together, write_whole
from undertow.model.hardware import Curve, Propeller
from undertow.model.symbols import FORCE, FORCE_UNITS
from undertow.model.vehicle import Thruster, Vehicle
from undertow.version import __version__

# Words of C and names of the library that no member of a struct may have.
_TAKEN = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if inline int
    long register return short signed sizeof static struct switch typedef union unsigned void volatile while
    restrict""".split()  # noqa: SIM905
)
_COMPARED = {"OP_LT": "<", "OP_LE": "<=", "OP_EQ": "==", "OP_NE": "!="}


@dataclass(frozen=True)
class LibrarySettings:
    """Numbers of the library.

    Attributes
    ----------
    points : int
        Points of the table from thrust to command of a thruster with a curve: 33 keep the T200 to 1 %.
    neutral, span : float
        Servo pulse without thrust and from there to full thrust, microseconds: that of common motor
        controllers, 1100 to 1900.
    step : float
        Step of the examples, s.
    """

    points: int = 33
    neutral: float = 1500.0
    span: float = 400.0
    step: float = 0.02


class Size(NamedTuple):
    """Bytes of stack of one function."""

    function: str
    stack: int


class Library:
    """A vehicle, and its controller and allocation where gains are given, as a C library.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    gains : GainSet, optional
        Gains of a controller for it; allocation is that of the gain file.

    Raises
    ------
    UndertowError
        If a curve of a thruster does not rise everywhere: its inverse is not a function.
    """

    def __init__(
        self, vehicle: Vehicle, gains: GainSet | None = None, settings: LibrarySettings | None = None
    ) -> None:
        self.vehicle, self.gains, self.settings = vehicle, gains, settings or LibrarySettings()
        self._functions = Functions(vehicle)
        self._manifest = describe(self._functions)
        self.name = identifier(slug(vehicle.name))
        self._real = f"{self.name}_real"
        self._words = _words(self.name)

    def write(self, folder: Path) -> None:
        """Write all files into a folder of the library's own, or none of them."""
        with together():
            for name, text in self.texts.items():
                make_folder((folder / name).parent)
                write_whole(folder / name, text)

    @cached_property
    def texts(self) -> dict[str, str]:
        """Text of each file by name."""
        parts = {"vehicle": self._vehicle()}
        if self.gains is not None:
            parts |= {"controller": self._controller(self.gains), "allocation": self._allocation(self.gains)}
        sources = {f"src/{self.name}_{part}.{end}": text for part, (h, c) in parts.items()
                   for end, text in (("h", h), ("c", c))}  # fmt: skip
        examples = {f"examples/{part}/main.c": self._example(part) for part in parts}
        listed = " ".join(name for name in sources if name.endswith(".c"))
        more = {"SOURCES": listed, "EXAMPLES": " ".join(parts)}
        return {
            **sources,
            **examples,
            f"src/{self.name}_real.h": self._filled("real.h"),
            "CMakeLists.txt": self._filled("library.cmake", more),
            "library.properties": self._properties(parts),
            "README.md": self._readme(parts),
        }

    def _filled(self, template: str, more: Mapping[str, object] | None = None) -> str:
        text = (files("undertow.export") / "templates" / template).read_text(encoding="utf-8")
        fields = {"TITLE": comment(self.vehicle.name), "VERSION": __version__}
        return filled(text, {**fields, "LOWER": self.name, "UPPER": self.name.upper(), **(more or {})})

    # --- pieces -------------------------------------------------------------------------------
    def _header(self, part: str, what: str, lists: Mapping[str, Sequence[Entry]], lines: list[str]) -> str:
        told = "".join(f"\n   {name}:\n{listing(entries)}\n" for name, entries in lists.items())
        fields = {"WHAT": what, "LISTS": told, "DECLARATIONS": "\n".join(lines)}
        return self._filled("library.h", {**fields, "GUARD": f"{self.name}_{part}".upper()})

    def _source(self, part: str, pieces: Iterable[str]) -> str:
        head = f"/* {comment(self.vehicle.name)}: see {self.name}_{part}.h; generated by undertow. */"
        return "\n".join([head, f'#include "{self.name}_{part}.h"', "", *pieces])

    def _struct(self, name: str, entries: Sequence[Entry]) -> tuple[list[str], str]:
        """Lines that declare a struct with its defaults, and the definition of these."""
        members = _members(e.name for e in entries) or ("unused",)
        units = [comment(e.unit) for e in entries] or [""]
        values = [_constant(e.value or 0.0, self._real) for e in entries] or [f"({self._real})0"]
        of = f"{self.name}_{name}"
        declared = [
            f"  {self._real} {m};" + (f" /* {u} */" if u else "") for m, u in zip(members, units, strict=True)
        ]
        lines = [
            f"typedef struct {{\n{chr(10).join(declared)}\n}} {of};",
            f"extern const {of} {of}_default;",
            "",
        ]
        return lines, f"const {of} {of}_default = {{{', '.join(values)}}};\n"

    def _c(self, function: ca.Function, name: str, structs: Structs, *, static: bool = False) -> str:
        return plain_c(function, name, words=self._words, structs=structs, prefix="static " if static else "")

    # --- vehicle ------------------------------------------------------------------------------
    def _vehicle(self) -> tuple[str, str]:
        m, upper = self._manifest, self.name.upper()
        structs = {"p": (f"{self.name}_parameters", _members(e.name for e in m.parameters))}
        declared, defaults = self._struct("parameters", m.parameters)
        sizes = f"enum {{ {upper}_STATES = {len(m.states)}, {upper}_INPUTS = {len(m.inputs)} }};\n"
        made = {
            f"{self.name}_dynamics": self._functions.dynamics,
            f"{self.name}_outputs": self._functions.outputs,
        }
        heads = [signature(f, n, words=self._words, structs=structs) + ";" for n, f in made.items()]
        step = self._filled("vehicle.c")
        head = step[step.index("void") : step.index(" {\n")]
        words = [
            "/* Rates of the states; pose and velocity as reported; one Runge-Kutta step of h seconds. */"
        ]
        lists = {"x, state": m.states, "u, input, held": m.inputs}
        header = self._header("vehicle", "model", lists, [sizes, *declared, *words, *heads, f"{head};"])
        pieces = [defaults, *(self._c(f, n, structs) for n, f in made.items()), step]
        return header, self._source("vehicle", pieces)

    # --- controller -----------------------------------------------------------------------------
    def _controller(self, gains: GainSet) -> tuple[str, str]:
        controller = Controller(gains)
        function, numbers = controller.with_numbers()
        gain_entries = [
            Entry(n, "", v) for n, v in zip(controller.gain_names, controller.gain_values(), strict=True)
        ]
        plant = [Entry(n, "", v) for n, v in numbers.items()]
        structs = {
            "k": (f"{self.name}_gains", _members(e.name for e in gain_entries)),
            "m": (f"{self.name}_plant", _members(numbers)),
        }
        tables = [self._struct("gains", gain_entries), self._struct("plant", plant)]
        upper, real = self.name.upper(), self._real
        sizes = f"enum {{ {upper}_MEMORY = {len(controller.state_names)} }};\n"
        name = f"{self.name}_control"
        start = f"void {self.name}_control_start({real} *s)"
        heads = [signature(function, name, words=self._words, structs=structs) + ";", f"{start};"]
        words = ["/* Commands u for dt[0] seconds, memory and force asked for; s_next may be s. */"]
        reported = [Entry(n, "") for n in (*self.vehicle.pose_names, *self.vehicle.velocity_names)]
        lists = {
            "y, what the sensors report": reported,
            "r, desired pose": [Entry(n, "") for n in self.vehicle.pose_names],
            "s, memory": [Entry(n, "") for n in controller.state_names],
            "u, commands": [Entry(n, "") for n in controller.command_names],
        }
        lines = [sizes, *(line for declared, _ in tables for line in declared), *words, *heads]
        states = "\n".join(
            f"  s[{i}] = {_constant(v, real)};" for i, v in enumerate(controller.initial_states())
        )
        begin = f"{start} {{\n{states}\n}}\n"
        what = f"controller {comment(gains.name)}, law {gains.law.id}"
        return self._header("controller", what, lists, lines), self._source(
            "controller", [*(text for _, text in tables), self._c(function, name, structs), begin]
        )

    # --- allocation -----------------------------------------------------------------------------
    def _allocation(self, gains: GainSet) -> tuple[str, str]:
        allocation: Allocation = allocation_of(gains)
        tau = ca.SX.sym("tau", len(self.vehicle.degrees_of_freedom))
        function = ca.Function(
            "allocate", [tau], [ca.densify(thruster_commands(allocation, tau))], ["tau"], ["u"]
        )
        full = max((t.limit for t in self.vehicle.thrusters if t.limit is not None), default=1.0)
        pulses = [
            Entry("neutral", "microseconds", self.settings.neutral),
            Entry("span", "microseconds to full thrust", self.settings.span),
            Entry("full_command", "command of full thrust", full),
        ]
        fields, default = self._struct("pulses", pulses)
        tail = self._filled("allocation.c")
        heads = [signature(function, f"{self.name}_allocate", words=self._words) + ";"]
        heads += [h + ";" for h in re.findall(rf"^({self._real} \w+\([^)]*\)) {{$", tail, re.MULTILINE)]
        dofs = self.vehicle.dof_indices
        lists = {
            "tau, wanted force": [Entry(f"tau_{FORCE[i]}", FORCE_UNITS[i]) for i in dofs],
            "u, commands, and the thrusters": [Entry(n, "") for n in self.vehicle.command_names],
        }
        words = ["/* Commands of a wanted force; command of a thrust in N; servo pulse of a command. */"]
        header = self._header("allocation", "thrust allocation", lists, [*fields, *words, *heads])
        pieces = [default, self._tables(), self._c(function, f"{self.name}_allocate", {}), tail]
        return header, self._source("allocation", pieces)

    def _tables(self) -> str:
        """Thrust and command of each thruster at the points of its inverse curve."""
        points = [_inverse(t, self.settings.points) for t in self.vehicle.thrusters]
        size = max((len(x) for x, _ in points), default=2)
        rows = []
        for name, column in (("thrusts", 0), ("commands", 1)):
            padded = [np.pad(p[column], (0, size - len(p[column])), mode="edge") for p in points]
            body = ",\n  ".join(
                "{" + ", ".join(_constant(v, self._real) for v in row) + "}" for row in padded
            )
            rows.append(
                f"static const {self._real} {name}[{max(len(points), 1)}][POINTS] = {{\n  {body}}};\n"
            )
        return f"enum {{ POINTS = {size} }};\n\n" + "\n".join(rows)

    # --- what goes along ------------------------------------------------------------------------
    def _example(self, part: str) -> str:
        n, upper, h = self.name, self.name.upper(), f"({self._real}){self.settings.step!r}"
        bodies = {
            "vehicle": f"""\
  {n}_real x[{upper}_STATES] = {{0}}, u[{max(len(self._manifest.inputs), 1)}] = {{(({n}_real)1)}};
  {n}_parameters p = {n}_parameters_default; /* change what differs on your vehicle */
  for (int k = 0; k < 500; k++) {{
    {n}_vehicle_step(x, u, &p, (({n}_real)k) * {h}, {h});
  }}
  for (int i = 0; i < {upper}_STATES; i++) {{
    printf("%.9g\\n", (double)x[i]);
  }}""",
            "controller": self._example_of_controller(),
            "allocation": f"""\
  {n}_real tau[{len(self.vehicle.dof_indices)}] = {{({n}_real)1}}, u[{len(self.vehicle.command_names)}];
  {n}_allocate(tau, u);
  for (int i = 0; i < {len(self.vehicle.thrusters)}; i++) {{
    const {n}_real command = {n}_command(i, u[i]);
    printf("%.9g %.9g\\n", (double)u[i], (double){n}_pulse(command, &{n}_pulses_default));
  }}""",
        }
        head = f"/* {comment(self.vehicle.name)}: how the {part} is used; this file is yours to change. */"
        includes = f'#include <stdio.h>\n\n#include "{n}_{part}.h"'
        return f"{head}\n{includes}\n\nint main(void) {{\n{bodies[part]}\n  return 0;\n}}\n"

    def _example_of_controller(self) -> str:
        n, upper, dofs = self.name, self.name.upper(), len(self.vehicle.dof_indices)
        commands = len(self.vehicle.command_names)
        return f"""\
  {n}_real y[{2 * dofs}] = {{0}}, r[{dofs}] = {{({n}_real)1}}, s[{upper}_MEMORY], u[{commands}], tau[{dofs}];
  const {n}_real dt = ({n}_real){self.settings.step!r};
  {n}_control_start(s);
  {n}_control(y, r, s, &{n}_gains_default, &dt, &{n}_plant_default, u, s, tau);
  for (int i = 0; i < {commands}; i++) {{
    printf("%.9g\\n", (double)u[i]);
  }}"""

    def _properties(self, parts: Iterable[str]) -> str:
        # Arduino and PlatformIO read this; a version has three numbers there.
        includes = ",".join(f"{self.name}_{part}.h" for part in parts)
        return (
            f"name={self.name}\nversion={__version__}\nauthor=undertow\nmaintainer=undertow\n"
            f"sentence={comment(self.vehicle.name)} in C\nparagraph=Generated from a vehicle file.\n"
            f"category=Device Control\nurl=\narchitectures=*\nincludes={includes}\n"
        )

    def _readme(self, parts: Iterable[str]) -> str:
        listed = "\n".join(f"- `src/{self.name}_{part}.h`, `examples/{part}/main.c`" for part in parts)
        delay = self._manifest.input_delay
        late = f"\nThe inputs act {delay:g} s late, which the caller has to provide.\n" if delay else ""
        more = {"PARTS": listed, "LATE": late}
        return self._filled("library.md", more)


# --- spelling -------------------------------------------------------------------------------------
def _words(name: str) -> Words:
    """C in which every constant has the type of the numbers: no conversion is left to the compiler."""
    real, call = f"{name}_real", f"{name.upper()}_CALL"
    one, zero = f"({real})1", f"({real})0"
    calls = {k: f"{call}({v})({'{0}, {1}' if k in TWO_OPERANDS else '{0}'})" for k, v in CALLS.items()}
    truth = {k: f"({{0}} {sign} {{1}}) ? {one} : {zero}" for k, sign in _COMPARED.items()}
    forms = {
        **{k: FORMS[k] for k in ("OP_ADD", "OP_SUB", "OP_MUL", "OP_DIV", "OP_NEG", "OP_SQ")},
        **calls,
        **truth,
        "OP_TWICE": f"({real})2 * {{0}}",
        "OP_INV": f"{one} / {{0}}",
        "OP_NOT": f"({{0}} == {zero}) ? {one} : {zero}",
        "OP_AND": f"(({{0}} != {zero}) && ({{1}} != {zero})) ? {one} : {zero}",
        "OP_OR": f"(({{0}} != {zero}) || ({{1}} != {zero})) ? {one} : {zero}",
        "OP_SIGN": f"({{0}} > {zero}) ? {one} : (({{0}} < {zero}) ? ({real})-1 : {{0}})",
        "OP_IF_ELSE_ZERO": f"({{0}} != {zero}) ? {{1}} : {zero}",
    }
    return Words(real, f"({real}){{}}", forms, together=False)


def _members(names: Iterable[str]) -> tuple[str, ...]:
    """Names as members of a struct, each once."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"\W", "_", name, flags=re.ASCII)
        plain = f"p_{plain}" if plain in _TAKEN or not plain[:1].isalpha() else plain
        while plain in found:
            plain += "_"
        found.append(plain)
    return tuple(found)


def _constant(value: float, real: str) -> str:
    if isinf(value):
        return f"({real}){'-' if value < 0 else ''}INFINITY"
    return f"({real}){float(value)!r}"


def _inverse(thruster: Thruster, points: int) -> tuple[np.ndarray, np.ndarray]:
    """Thrusts that rise, and the commands that give them."""
    if isinstance(thruster.law, Propeller):
        raise UndertowError(
            f"thruster '{thruster.name}' is commanded by its revolutions: the inverse needs a curve"
        )
    scale = thruster.thrust_per_command.value
    if not isinstance(thruster.law, Curve):
        reach = thruster.limit or 1e6  # beyond any thrust: the line goes on
        return np.array([-reach, reach]) * scale, np.array([-reach, reach])
    curve = thruster.law
    ends = curve.pieces[0][0], curve.pieces[-1][1]
    least, most = (curve.at(e) for e in ends)
    # Zero is a point of its own: the dead band of a curve is left at its middle.
    thrusts = np.unique(
        np.concatenate([np.linspace(least, 0, points // 2), np.linspace(0, most, points // 2)])
    )
    return thrusts * scale, np.array([curve.inverse(float(v)) for v in thrusts])


# --- sizes ----------------------------------------------------------------------------------------
def sizes(library: Library, compiler: str, *flags: str) -> tuple[dict[str, int], list[Size]]:
    """Bytes of code and constants of each module, and of stack of each function, with -Os.

    Raises
    ------
    UndertowError
        If the compiler is not there or fails.
    """
    if shutil.which(compiler) is None:
        raise UndertowError(f"compiler '{compiler}' is not there: install it (Debian: gcc-arm-none-eabi)")
    with TemporaryDirectory() as place:
        folder = Path(place)
        library.write(folder)
        modules: dict[str, int] = {}
        stacks: list[Size] = []
        for source in sorted((folder / "src").glob("*.c")):
            command = [compiler, "-std=c99", "-Os", "-fstack-usage", *flags, "-c", source.name]
            done = subprocess.run(command, cwd=source.parent, capture_output=True, text=True, check=False)
            if done.returncode:
                raise UndertowError(
                    f"{compiler} fails on {source.name}: {done.stderr.strip().splitlines()[0]}"
                )
            modules[source.name] = _flash(compiler, source.with_suffix(".o"))
            for line in source.with_suffix(".su").read_text().splitlines():
                where, size, _ = line.split("\t")
                stacks.append(Size(where.rpartition(":")[2], int(size)))
    return modules, stacks


def _flash(compiler: str, module: Path) -> int:
    """Bytes of code and constants of an object file."""
    tool = f"{compiler.removesuffix('gcc')}size" if compiler.endswith("gcc") else "size"
    done = subprocess.run([tool, str(module)], capture_output=True, text=True, check=True)
    text, data = done.stdout.splitlines()[1].split()[:2]
    return int(text) + int(data)
