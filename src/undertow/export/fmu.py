"""Functional mock-up units (FMI 2.0 and 3.0): C sources and description of a vehicle in one archive."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from io import BytesIO
from math import isinf
from typing import Literal, NamedTuple
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import casadi as ca

from undertow.codegen.compiler import plain_c
from undertow.codegen.functions import Functions
from undertow.codegen.manifest import Entry, describe
from undertow.codegen.simulate import LONGEST_STEP, longest_step
from undertow.codegen.spelling import comment, fill, identifier, slug
from undertow.model.effect import Measurement
from undertow.model.symbols import FORCE, FORCE_UNITS
from undertow.model.units import base_exponents
from undertow.model.vehicle import Vehicle
from undertow.version import __version__

from .body import filled

Version = Literal["2.0", "3.0"]
# An archive says when its files were made; the same vehicle is to give the same bytes.
_NO_DATE = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class FmuSettings:
    """What a unit does unless its user says otherwise."""

    # Longest Runge-Kutta step of co-simulation, s; that of `undertow simulate`. Lags that are quicker shorten
    # it at the export.
    max_step: float = LONGEST_STEP
    # stop_time, communication_step: default experiment, s
    stop_time: float = 10.0
    communication_step: float = 0.05


SETTINGS = FmuSettings()


class Variable(NamedTuple):
    """One variable of a unit; its value reference is its place."""

    name: str
    unit: str
    causality: str
    variability: str
    initial: str | None = None
    start: float | None = None
    derivative_of: int | None = None
    limits: tuple[float, float] | None = None  # lowest and highest value
    meaning: str = ""

    @property
    def attributes(self) -> dict[str, object]:
        """What the description says of its kind; None is left out."""
        found = {"causality": self.causality, "variability": self.variability, "initial": self.initial}
        return {**found, "description": self.meaning or None}

    def numbers(self, first: int) -> dict[str, object]:
        """What the description says of its values; `first`: what it counts the first variable as."""
        low, high = self.limits or (None, None)
        return {
            "unit": self.unit or None,
            "derivative": None if self.derivative_of is None else self.derivative_of + first,
            "min": low,
            "max": high,
            "start": None if self.start is None else _double(self.start),
        }


class Fmu:
    """A vehicle as a functional mock-up unit for model exchange and co-simulation.

    Inputs are the commands, outputs are pose, velocity and the force of the actuators (body frame), states
    start at zero unless they are set, and every parameter of the model is one of the unit. All are SI, NED
    and forward-starboard-down. Co-simulation integrates as `undertow.codegen.simulate.Simulator` does.

    Modelica Association, Functional Mock-up Interface, versions 2.0 and 3.0, https://fmi-standard.org.
    """

    def __init__(self, vehicle: Vehicle, version: Version = "3.0") -> None:
        self.vehicle, self.version = vehicle, version
        self._functions = f = Functions(vehicle, named=True)
        self._inputs = [f.x, f.u, f.numbers, f.t]
        self._manifest = describe(self._functions)
        self.name = identifier(slug(vehicle.name))

    # --- variables ----------------------------------------------------------------------------
    @cached_property
    def variables(self) -> list[Variable]:
        """All variables in the order of their value references: time, x, x_dot, u, p, step, forces."""
        states, lowest = self._manifest.states, self.vehicle.lowest_commands
        limits = {n: (lowest[n], most) for n, most in self.vehicle.command_limits.items()}
        seen = (*self.vehicle.pose_names, *self.vehicle.velocity_names)
        taken = {*seen, *(p.name for p in self._manifest.parameters)}
        inputs = [(f"command_{e.name}" if e.name in taken else e.name, e) for e in self._manifest.inputs]
        step = longest_step(self._functions, SETTINGS.max_step)
        return [
            Variable("time", "s", "independent", "continuous"),
            *(
                Variable(e.name, e.unit, "output" if e.name in seen else "local", "continuous", "exact", 0.0)
                for e in states
            ),
            *(_rate(e, i) for i, e in enumerate(states, start=1)),
            *(
                Variable(name, e.unit, "input", "continuous", None, 0.0, None, limits.get(e.name))
                for name, e in inputs
            ),
            *(
                Variable(e.name, e.unit, "parameter", "fixed", "exact", e.value)
                for e in self._manifest.parameters
            ),
            Variable("max_step", "s", "parameter", "fixed", "exact", step, meaning="longest step"),
            *(
                Variable(f"actuators_{FORCE[i]}", FORCE_UNITS[i], "output", "continuous", "calculated",
                         meaning="force or moment of the actuators, body frame")
                for i in self.vehicle.dof_indices
            ),
        ]  # fmt: skip

    @property
    def losses(self) -> list[str]:
        """What the model has and the unit has not."""
        found = []
        if self._manifest.input_delay:
            found.append(
                f"the commands act {self._manifest.input_delay:g} s late: delay the inputs of the unit"
            )
        late = sorted(set(self._manifest.output_delay.values()))
        found += [f"some outputs are reported {s:g} s late: delay the outputs of the unit" for s in late]
        ids = ", ".join(e.id for e in self.vehicle.all_effects if isinstance(e, Measurement))
        if ids:
            found.append(f"the outputs are the true motion, not what the sensors report ({ids})")
        return found

    # --- the archive --------------------------------------------------------------------------
    def archive(self) -> bytes:
        """The unit as a zip file; the same for the same vehicle."""
        stream = BytesIO()
        with ZipFile(stream, "w", ZIP_DEFLATED) as archive:
            for name, text in self.texts.items():
                archive.writestr(ZipInfo(name, _NO_DATE), text, ZIP_DEFLATED)
        return stream.getvalue()

    @cached_property
    def texts(self) -> dict[str, str]:
        """Text of every file of the unit by name."""
        folder = files("undertow.export") / "templates"
        wrapper = f"fmi{self.version[0]}.c"
        own = (folder / wrapper).read_text(encoding="utf-8")
        core = fill((folder / "fmu.h").read_text(encoding="utf-8"), self._fields)
        texts = {"modelDescription.xml": self._description()}
        if self.version == "3.0":
            texts["sources/buildDescription.xml"] = filled("fmi3_build.xml", name=self.name)
        page = filled("fmu.html", title=self.vehicle.name, losses=self.losses)
        return {
            **texts,
            f"sources/{wrapper}": own,
            "sources/fmu.h": core,
            "documentation/index.html": page,
        }

    @cached_property
    def token(self) -> str:
        """What ties the description to the sources."""
        content = repr((__version__, self.version, self.variables, self._source))
        return hashlib.sha256(content.encode()).hexdigest()

    @property
    def _fields(self) -> dict[str, object]:
        starts = [v.start if v.start is not None else 0.0 for v in self.variables]
        f = self._functions
        return {
            "TITLE": comment(self.vehicle.name),
            "VERSION": __version__,
            "NX": f.x.numel(),
            "NU": f.u.numel(),
            "NP": f.numbers.numel(),
            "NF": f.nu.numel(),
            "TOKEN": self.token,
            "START": ", ".join(repr(v).replace("inf", "INFINITY") for v in starts),
            "SOURCE": self._source,
        }

    @cached_property
    def _source(self) -> str:
        functions = {"dynamics": self._functions.dynamics, "forces": self._forces, "slopes": self._slopes}
        return "\n".join(plain_c(f, name, prefix="static ") for name, f in functions.items())

    @cached_property
    def _forces(self) -> ca.Function:
        """`tau = forces(x, u, p, t)`: what the actuators give, without what moving water takes from it."""
        f = self._functions
        driven = ca.substitute(f.control_force, f.actuation, f.actuator_output)
        still = ca.substitute(driven, f.nu_dot, ca.SX.zeros(f.nu_dot.shape))
        return ca.Function("forces", self._inputs, [ca.densify(still)], ["x", "u", "p", "t"], ["tau"])

    @cached_property
    def _slopes(self) -> ca.Function:
        """`s = slopes(x, u, p, t)`: x_dot and the forces by x, u and p, shape (nx + n, nx + nu + np)."""
        inputs = [ca.MX.sym(n, v.shape) for n, v in zip("xupt", self._inputs, strict=True)]
        f, forces = self._functions, self._forces(*self._inputs)
        by = ca.jacobian(forces, ca.vertcat(f.x, f.u, f.numbers))
        rows = ca.Function("force_slopes", self._inputs, [ca.densify(by)])
        matrix = ca.vertcat(ca.horzcat(*f.jacobians_by("numbers")(*inputs)[1:]), rows(*inputs))
        return ca.Function("slopes", inputs, [matrix], ["x", "u", "p", "t"], ["s"])

    # --- the description ------------------------------------------------------------------------
    def _description(self) -> str:
        variables = self.variables
        return filled(
            f"fmi{self.version[0]}.xml",
            fmi=self.version,
            title=self.vehicle.name,
            name=self.name,
            token=self.token,
            settings=SETTINGS,
            units={unit: _base(unit) for unit in sorted({v.unit for v in variables if v.unit})},
            variables=variables,
            # what the outputs and the derivatives depend on, and what is known only after initialisation
            needs=self._dependencies,
            outputs=[i for i, v in enumerate(variables) if v.causality == "output"],
            rates=[i for i, v in enumerate(variables) if v.derivative_of is not None],
            calculated=[i for i, v in enumerate(variables) if v.initial == "calculated"],
        )

    @cached_property
    def _dependencies(self) -> dict[int, list[int]]:
        """References of the states, inputs and time that a derivative or an output depends on."""
        f, nx, nu = self._functions, self._functions.x.numel(), self._functions.u.numel()
        moving = ca.vertcat(f.t, f.x, f.u)
        rows = ca.vertcat(f.x_dot, self._forces(*self._inputs))
        pattern = ca.jacobian_sparsity(rows, moving)
        places = [0, *range(1, 1 + nx), *range(1 + 2 * nx, 1 + 2 * nx + nu)]
        last = len(self.variables)
        references = [*range(1 + nx, 1 + 2 * nx), *range(last - f.nu.numel(), last)]
        found: dict[int, list[int]] = {i: [i] for i in range(1, 1 + nx)} | {i: [] for i in references}
        for k, j in zip(*pattern.get_triplet(), strict=True):
            found[references[k]].append(places[j])
        return {reference: sorted(needs) for reference, needs in found.items()}


# --- variables ------------------------------------------------------------------------------------
def _rate(entry: Entry, state: int) -> Variable:
    unit = f"({entry.unit})/s" if "/" in entry.unit else f"{entry.unit or '1'}/s"
    return Variable(f"der({entry.name})", unit, "local", "continuous", "calculated", None, state)


def _double(value: float) -> str:
    return ("-INF" if value < 0 else "INF") if isinf(value) else repr(float(value))


def _base(unit: str) -> dict[str, object] | None:
    """Exponents of a unit in the base units; None where it counts commands."""
    if "command" in unit:
        return None
    scale, exponents = base_exponents(unit)
    return {**exponents, "factor": None if scale == 1.0 else scale}
