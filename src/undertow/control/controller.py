"""A control law as it runs aboard: sampled, scheduled, allocated, with limits; and its C code."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cached_property, reduce
from importlib.resources import files
from math import inf, isfinite, pi
from pathlib import Path

import casadi as ca
import numpy as np
import sympy as sm

from undertow.codegen.convert import Converter
from undertow.codegen.export import Entry, Report, comment, filled, identifier, listing, slug, strings
from undertow.codegen.functions import solve_symmetric
from undertow.codegen.plain import plain_c
from undertow.errors import UndertowError
from undertow.files import make_folder, together, write_whole
from undertow.model.symbols import FORCE, FORCE_UNITS, POSE, VELOCITY, VELOCITY_UNITS
from undertow.model.units import to_si
from undertow.version import __version__

from .allocation import Allocation, allocation_of
from .gains import GainSet
from .guidance.signals import Course, Kinematics, Reference
from .laws import LawSignals


@dataclass(frozen=True)
class ControllerSettings:
    """The numbers of allocation with limits and of anti-windup."""

    # Added to the Gram matrix of the free thrusters, as a part of the mean of its diagonal: they may be too
    # few for all directions, then least squares is meant.
    damping: float = 1e-8
    rounding: float = 1e-9  # part of the wanted force that counts as rounding and not as a limit


SETTINGS = ControllerSettings()


# --- allocation -------------------------------------------------------------------------------
def thruster_commands(allocation: Allocation, force: ca.SX) -> ca.SX:
    """Commands for a wanted force in all degrees of freedom, shape (n, 1) to (m, 1).

    Without limits f = W^-1 B' (B W^-1 B')^-1 tau, the solution with the least f' W f. With limits the same
    step is made as far as the first thruster that reaches its limit; that one stays there, and the free ones
    take over what is left of tau, in the least-squares sense where they are too few. So commands never exceed
    their limits, no round leaves more of tau than the one before, and within the limits the result is that of
    the pseudo-inverse.
    """
    wanted = force[list(allocation.rows)]
    step = _constant(allocation.pseudo_inverse) @ wanted
    if not allocation.limited:
        return step
    b, m = _constant(allocation.acting), len(allocation.limits)
    limits = ca.DM(allocation.limits)
    commands, free = ca.SX.zeros(m, 1), ca.SX.ones(m, 1)
    short: ca.SX = ca.SX(1)
    for _ in range(int(np.isfinite(allocation.limits).sum()) + 1):
        ratios = [_room(commands[i], step[i], float(allocation.limits[i])) for i in range(m)]
        share = ca.fmin(1, reduce(ca.fmin, ratios))
        commands = ca.fmax(-limits, ca.fmin(limits, commands + share * step))
        short = short * (share < 1)
        free = free * (ca.vertcat(*ratios) > share)
        step = short * _step(allocation, b, free, wanted - b @ commands)
    return commands


def _constant(matrix: np.ndarray) -> ca.SX:
    return ca.sparsify(ca.SX(ca.DM(matrix)))


def _room(command: ca.SX, step: ca.SX, limit: float) -> ca.SX:
    """Which part of a step a command can make before it is at its limit."""
    if not isfinite(limit):
        return ca.SX(inf)
    return ca.if_else(step == 0, inf, (limit - ca.sign(step) * command) / ca.fabs(step))


def _step(allocation: Allocation, b: ca.SX, free: ca.SX, left: ca.SX) -> ca.SX:
    """Change of the free commands that brings the rest of the force, or as much of it as they can."""
    acting, weights, k = allocation.acting, allocation.weights, len(allocation.rows)
    cheap = free / ca.DM(weights)
    gram = b @ ca.diag(cheap) @ b.T
    damping = SETTINGS.damping * np.trace(acting @ (acting / weights).T) / k
    return cheap * (b.T @ solve_symmetric(gram + damping * ca.SX.eye(k), left))


GATE = "gate"
# What waits for the heading, and the motions that the law does not even brake meanwhile.
_WAITING, _IDLE = ("x", "y"), ("u", "v")


class Controller:
    """A gain set as CasADi functions of what the sensors report.

    y is the reported pose and velocity in the vehicle's degrees of freedom, r the desired pose, s the states
    of the law and a last one for the gate (0 closed, 1 passed), k the gains, all in SI. With a reference r
    are the numbers of its mission, and its states stand in s between those of the law and the gate.
    """

    def __init__(self, gains: GainSet, reference: Reference | None = None) -> None:
        self.gains, self.reference = gains, reference
        self.allocation: Allocation = allocation_of(gains)
        self._coordinates = gains.plant.vehicle.pose_names
        self._check_schedule()
        self._numbers = {s: ca.SX(float(v)) for s, v in gains.plant.numbers.items()}
        n, n_states = len(self._coordinates), len(self.state_names)
        self._y, self._r = ca.SX.sym("y", 2 * n), ca.SX.sym("r", len(reference.numbers) if reference else n)
        followed = len(reference.state_names) if reference else 0
        self._own, self._passed = ca.SX.sym("s", n_states - 1 - followed), ca.SX.sym(GATE)
        self._at = ca.SX.sym("at", followed)
        self._k, self._dt = ca.SX.sym("k", len(self.gain_names)), ca.SX.sym("dt")

    def _check_schedule(self) -> None:
        missing = [c for c in ("x", "psi") if c not in self._coordinates]
        if self._by_turns and missing:
            raise UndertowError(
                f"[schedule] order = 'yaw-first' needs {missing[0]}, which '{self.gains.plant.vehicle.name}' "
                'does not have: write order = "together"'
            )
        if self._by_turns and self.reference is not None:
            raise UndertowError(
                "[schedule] order = 'yaw-first' waits for the heading of a set-point, and a mission moves: "
                'write order = "together" (--order together)'
            )
        if not 0 < self.gate <= pi:
            fault = "beyond 180 deg, which no error of the heading is" if self.gate > pi else "not above zero"
            raise UndertowError(
                f"[schedule] gate = {self.gains.schedule.gate} is {fault}: give an angle of up to 180 deg "
                "(a number without a unit is in rad)"
            )

    # --- names and numbers --------------------------------------------------------------------
    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the entries of s."""
        followed = self.reference.state_names if self.reference else ()
        return (*self.gains.law.state_names(self._coordinates), *followed, GATE)

    @property
    def gain_names(self) -> tuple[str, ...]:
        """Names of the entries of k."""
        return tuple(str(g.symbol(c)) for g in type(self.gains.law).gains for c in self._coordinates)

    def gain_values(self) -> list[float]:
        """Values of k."""
        return [self.gains.values[name] for name in self.gain_names]

    def initial_states(self) -> list[float]:
        """Values of s at the start: integrals at zero, the gate closed where there is one."""
        followed = self.reference.initial_states() if self.reference else []
        own = len(self.state_names) - 1 - len(followed)
        return [*[0.0] * own, *followed, 0.0 if self._by_turns else 1.0]

    @property
    def mission_numbers(self) -> list[float]:
        """Values of r where there is a reference."""
        return [n.value for n in self.reference.numbers] if self.reference else []

    @property
    def command_names(self) -> tuple[str, ...]:
        """Names of the commands."""
        return self.gains.plant.vehicle.command_names

    @cached_property
    def gate(self) -> float:
        """Error of the heading that opens the gate, rad."""
        try:
            return to_si(self.gains.schedule.gate, "rad")
        except UndertowError as error:
            raise UndertowError(f"[schedule] gate: {error}") from error

    @property
    def _by_turns(self) -> bool:
        return self.gains.schedule.order == "yaw-first"

    # --- functions ----------------------------------------------------------------------------
    @cached_property
    def sampled(self) -> ca.Function:
        """`(u, s_next, tau) = control(y, r, s, k, dt)`: one sample, its commands held for dt.

        tau is the force that the law asks for, in body axes; an integral advances by dt times its rate.
        """
        return self._function("control", [self._dt], self._sample(), ["u", "s_next", "tau"])

    def _sample(self) -> list[ca.SX]:
        """Commands, states of the next sample, and the force asked for."""
        gate = self._gate()
        commands, rates, force = self._law(gate)
        at = self._at
        if self.reference is not None:
            at = self.reference.advance(self._r, at, self._kinematics, self._dt)
        return [commands, ca.vertcat(self._own + self._dt * rates, at, gate), force]

    @cached_property
    def continuous(self) -> ca.Function:
        """`(u, s_dot, tau) = law(y, r, s, k)`: commands and rates in continuous time, the gate as in s."""
        commands, rates, force = self._law(self._passed)
        at = ca.SX.ones(self._at.shape)  # the time goes on; a reference that has more is sampled
        return self._function("law", [], [commands, ca.vertcat(rates, at, 0), force], ["u", "s_dot", "tau"])

    def with_numbers(self) -> tuple[ca.Function, dict[str, float]]:
        """`(u, s_next, tau) = control(y, r, s, k, dt, m)`: as `sampled`, with the plant's numbers as m.

        Also the values of m, by name: masses, weight and the like that the law is stated in.
        """
        other, numbers = copy(self), self.gains.plant.numbers
        m = ca.SX.sym("m", len(numbers))
        other._numbers = dict(zip(numbers, ca.vertsplit(m), strict=True))
        results = other._sample()
        used = [i for i in range(m.numel()) if any(ca.depends_on(e, m[i]) for e in results)]
        names = [str(n) for n in numbers]
        kept = ca.SX.sym("m", len(used))
        results = ca.substitute(results, [m[i] for i in used], ca.vertsplit(kept))
        function = self._function("control", [self._dt, kept], results, ["u", "s_next", "tau"])
        return function, {names[i]: float(numbers[list(numbers)[i]]) for i in used}

    def _function(self, name: str, more: list[ca.SX], outputs: list[ca.SX], names: list[str]) -> ca.Function:
        states = ca.vertcat(self._own, self._at, self._passed)
        inputs = [self._y, self._r, states, self._k, *more]
        input_names = ["y", "r", "s", "k", *["dt", "m"][: len(more)]]
        return ca.Function(name, inputs, [ca.densify(o) for o in ca.cse(outputs)], input_names, names)

    # --- the reference ----------------------------------------------------------------------------
    @cached_property
    def _kinematics(self) -> Kinematics:
        plant, n = self.gains.plant, len(self._coordinates)
        seen = zip([*plant.eta, *plant.nu], ca.vertsplit(self._y), strict=True)
        convert = Converter(dict(seen))
        J = (convert.matrix(m) for m in (plant.J_inverse, plant.J_dot))
        return Kinematics(self._coordinates, self._y[:n], self._y[n:], *J)

    @cached_property
    def _course(self) -> Course:
        """What is followed: the pose of r, at rest, where there is no reference."""
        if self.reference is None:
            still = ca.SX(len(self._coordinates), 1)
            return Course(self._r, still, still)
        return self.reference.course(self._r, self._at, self._kinematics)

    # --- the law --------------------------------------------------------------------------------
    @cached_property
    def _error(self) -> ca.SX:
        """Desired less reported pose, angles within half a turn."""
        n = len(self._coordinates)
        named = zip(self._coordinates, ca.vertsplit(self._course.eta_d - self._y[:n]), strict=True)
        return ca.vertcat(*[_wrapped(e) if _is_angle(c) else e for c, e in named])

    def _gate(self) -> ca.SX:
        """The latch: once the heading has come within the gate, it stays open."""
        if not self._by_turns:
            return ca.SX(1)
        heading = self._error[self._coordinates.index("psi")]
        return ca.fmax(self._passed, ca.fabs(heading) <= self.gate)

    def _open(self, gate: ca.SX, coordinates: tuple[str, ...]) -> ca.SX:
        """For every coordinate, whether it is driven: those that wait only when the gate is open."""
        return ca.vertcat(*[gate if self._by_turns and c in _WAITING else ca.SX(1) for c in coordinates])

    def _law(self, gate: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Commands, rates of the law's states, and the force asked for."""
        law, signals = self.gains.law, self._signals
        opened = self._open(gate, self._coordinates)
        open_states = ca.vertcat(*[opened] * len(law.states)) if law.states else ca.SX(0, 1)
        states = open_states * self._own
        convert = self._converter(opened * self._error, states, gate)
        # A force that nothing gives is left out where it is asked for, so that it counts as no limit.
        force = _only(convert.matrix(law.force(signals)), self.allocation.rows)
        commands = thruster_commands(self.allocation, force)
        early = self.gains.schedule.integrators == "start"
        rates = self._converter(self._error, self._own, ca.SX(1)) if early else convert
        moving = rates.matrix(law.rates(signals)) if law.states else ca.SX(0, 1)
        moving = moving if early else open_states * moving
        return commands, self._anti_windup(moving, force, commands, states, convert), force

    def _anti_windup(
        self, rates: ca.SX, force: ca.SX, commands: ca.SX, states: ca.SX, convert: Converter
    ) -> ca.SX:
        """Rates of the law's states, zero for one that would ask for more of what the thrusters lack."""
        allocation, signals = self.allocation, self._signals
        if not (allocation.limited and rates.numel() and self.gains.allocation.anti_windup == "hold"):
            return rates
        rows = list(allocation.rows)
        lacking = (force - _constant(allocation.matrix) @ commands)[rows]
        short = ca.sumsqr(lacking) > SETTINGS.rounding**2 * ca.sumsqr(force[rows])
        slope = convert.matrix(self.gains.law.force(signals).jacobian(signals.states))[rows, :]
        pushes = (slope.T @ lacking) * rates > 0
        return rates * (1 - short * pushes)

    @property
    def _signals(self) -> LawSignals:
        return self.gains.signals if self.reference is None else self.gains.tracking

    @property
    def _feed_forward(self) -> list[tuple[sm.Matrix, ca.SX]]:
        """Symbols of a reference that moves with what they are."""
        if self.reference is None:
            return []
        signals, course = self._signals, self._course
        return [(signals.nu_r, course.nu_r), (signals.nu_r_dot, course.nu_r_dot)]

    def _converter(self, error: ca.SX, states: ca.SX, gate: ca.SX) -> Converter:
        plant, signals = self.gains.plant, self._signals
        idle = self._by_turns and not gate.is_one()
        unheld = self.reference.unheld if self.reference else ()
        seen = [
            ca.SX(0) if str(v) in unheld else gate * y if idle and str(v) in _IDLE else y
            for v, y in zip([*plant.eta, *plant.nu], ca.vertsplit(self._y), strict=True)
        ]
        gains = [sm.Symbol(name, real=True) for name in self.gain_names]
        groups = (
            ([*plant.eta, *plant.nu], ca.vertcat(*seen)),
            (signals.error, error),
            (signals.states, states),
            (gains, self._k),
            *self._feed_forward,
        )
        known = {
            s: e for symbols, vector in groups for s, e in zip(symbols, ca.vertsplit(vector), strict=False)
        }
        return Converter(known | self._numbers)


def _only(force: ca.SX, rows: tuple[int, ...]) -> ca.SX:
    """A force with the rows that are not allocated at zero."""
    result = ca.SX(*force.shape)
    for i in rows:
        result[i] = force[i]
    return result


def _is_angle(coordinate: str) -> bool:
    return POSE.index(coordinate) >= 3


def _wrapped(angle: ca.SX) -> ca.SX:
    """The same angle between minus and plus half a turn."""
    return angle - 2 * ca.pi * ca.floor((angle + ca.pi) / (2 * ca.pi))


PICTURES = "figures"
_NAMES = (*POSE, *VELOCITY, *(f"tau_{f}" for f in FORCE))
_UNITS = dict(zip(_NAMES, (*("m",) * 3, *("rad",) * 3, *VELOCITY_UNITS, *FORCE_UNITS), strict=True))
_HEADING = """\
/* Desired heading from where the vehicle begins to the set-point, rad. */
double @LOWER@_heading(double x_0, double y_0, double x_d, double y_d)"""
_RULES = {
    "atan2": "  return atan2(y_d - y_0, x_d - x_0);",
    "atan": """\
  if (x_d == x_0) return y_d > y_0 ? acos(0.0) : y_d < y_0 ? -acos(0.0) : 0.0;
  return atan((y_d - y_0) / (x_d - x_0));""",
}


class ControllerExport:
    """The generated files of a controller, in `folder` under the folder of all that is generated."""

    def __init__(self, controller: Controller) -> None:
        self._controller = controller
        self._vehicle = controller.gains.plant.vehicle
        self.folder = Path(slug(self._vehicle.name)) / slug(controller.gains.name)
        if self.folder.name == PICTURES:
            raise UndertowError(
                f"gain set '{controller.gains.name}' would have the folder '{PICTURES}', which is that of "
                "the pictures: give it another name"
            )
        self._name = identifier("-".join(self.folder.parts))
        self._mission = controller.reference.numbers if controller.reference else []

    def write(self, out: Path) -> Report:
        """Write controller.c and controller.h to a folder of their own in that of the vehicle."""
        report = self.check(out)
        with together():
            make_folder(report.folder)
            for name, text in self.texts.items():
                write_whole(report.folder / name, text)
        return report

    def check(self, out: Path) -> Report:
        """Compare what lies in `out` with the controller; without changes it is current."""
        folder = out / self.folder
        found = {name: _text(folder / name) for name in self.texts}
        changed = [
            f"{name} is not as it would be generated" for name in found if found[name] != self.texts[name]
        ]
        first = not any(found.values())
        return Report(folder, first, () if first else tuple(changed))

    @cached_property
    def texts(self) -> dict[str, str]:
        """Text of each file by name."""
        template = files("undertow.control") / "templates" / "controller.h"
        header = filled(template.read_text(encoding="utf-8"), self._fields)
        return {"controller.c": self._source(), "controller.h": header}

    # --- the entries ------------------------------------------------------------------------------
    def _entries(self) -> dict[str, list[Entry]]:
        controller, law = self._controller, type(self._controller.gains.law)
        pose, velocity = self._vehicle.pose_names, self._vehicle.velocity_names
        units = {str(g.symbol(c)): g.unit(c) for g in law.gains for c in pose}
        gains = zip(controller.gain_names, controller.gain_values(), strict=True)
        forces = [f"tau_{FORCE[i]}" for i in self._vehicle.dof_indices]
        return {
            "report": [Entry(n, _UNITS[n]) for n in (*pose, *velocity)],
            "desired": [Entry(n.name, n.unit, n.value) for n in self._mission]
            or [Entry(n, _UNITS[n]) for n in pose],
            "state": [Entry(n, "") for n in controller.state_names],
            "gain": [Entry(n, units[n], value) for n, value in gains],
            "command": [Entry(n, _UNITS.get(n, "command")) for n in controller.command_names],
            "force": [Entry(n, _UNITS[n]) for n in forces],
        }

    @cached_property
    def _fields(self) -> dict[str, object]:
        entries = self._entries()
        sizes = dict(zip(("NY", "NR", "NS", "NK", "NU", "NT"), map(len, entries.values()), strict=True))
        words = ("REPORTS", "DESIRED", "STATES", "GAINS", "COMMANDS", "FORCES")
        lists = dict(zip(words, map(listing, entries.values()), strict=True))
        gains = self._controller.gains
        named = {"LOWER": self._name, "UPPER": self._name.upper(), "VERSION": __version__}
        titles = {"TITLE": comment(gains.name), "VEHICLE": comment(self._vehicle.name), "LAW": gains.law.id}
        declared = f"\n{filled(_HEADING, named)};\n" if self._plane else ""
        followed = {"WANTED": "desired pose", "R": "r", "MISSION_DECLARED": ""}
        if self._mission:
            own = f"{self._name}_mission"
            followed = {"WANTED": f"numbers of the mission ({own} has those of its file)", "R": own}
            followed["MISSION_DECLARED"] = (
                f"\n/* The mission: values of r. */\nextern const double {own}[];\n"
            )
        return {**named, **titles, **sizes, **lists, **followed, "HEADING_DECLARED": declared}

    @property
    def _plane(self) -> bool:
        return {"x", "y", "psi"} <= set(self._vehicle.pose_names) and not self._mission

    # --- the source -------------------------------------------------------------------------------
    def _source(self) -> str:
        name, entries = self._name, self._entries()
        gains = self._controller.gains
        head = f"/* Controller '{comment(gains.name)}', generated by undertow; see controller.h. */"
        named = ("report", "state", "gain", "command")
        lines = [head, '#include "controller.h"', "", "#include <math.h>", ""]
        lines += [strings(f"{name}_{what}_names", entries[what]) for what in named]
        values = ", ".join(map(repr, self._controller.gain_values()))
        lines += [f"const double {name}_gains[] = {{{values}}};", ""]
        if self._mission:
            numbers = ", ".join(repr(n.value) for n in self._mission)
            lines += [f"const double {name}_mission[] = {{{numbers}}};", ""]
        lines += [plain_c(self._controller.sampled, f"{name}_sample", prefix="static "), self._functions()]
        return "\n".join(lines)

    def _functions(self) -> str:
        name, start = self._name, self._controller.initial_states()
        states = "\n".join(f"  s[{i}] = {value!r};" for i, value in enumerate(start))
        arguments = (
            "const double *y, const double *r, const double *k, double dt, double *s, double *u, double *tau"
        )
        parts = [
            f"void {name}_start(double *s) {{\n{states}\n}}",
            f"void {name}_step({arguments}) {{\n  {name}_sample(y, r, s, k, &dt, u, s, tau);\n}}",
        ]
        if self._plane:
            rule = _RULES[self._controller.gains.schedule.heading]
            parts.append(f"{filled(_HEADING, {'LOWER': name})} {{\n{rule}\n}}")
        return "\n\n".join(parts) + "\n"


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""
