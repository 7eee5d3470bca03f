"""A control law as it runs aboard: sampled, scheduled, allocated, with limits; and its C code."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from math import pi
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
from undertow.model.loading import Quantity
from undertow.model.symbols import FORCE, FORCE_UNITS, POSE, VELOCITY, VELOCITY_UNITS
from undertow.model.units import to_si
from undertow.version import __version__

from .gains import GainSet

_INF = float("inf")
# Of the mean of the diagonal: free thrusters may be too few for all directions, then least squares is meant.
_DAMPING = 1e-8


@dataclass(frozen=True)
class Allocation:
    """The inverse of B f = tau for the degrees of freedom that the thrusters push in.

    Without limits f = W^-1 B' (B W^-1 B')^-1 tau, the solution with the least f' W f. With limits the same
    step is made as far as the first thruster that reaches its limit; that one stays there, and the free ones
    take over what is left of tau, in the least-squares sense where they are too few. So commands never exceed
    their limits, no round leaves more of tau than the one before, and within the limits the result is that of
    the pseudo-inverse.

    Attributes
    ----------
    matrix : ndarray, shape (n, m)
        Body-frame force of a unit of each command, N and N m.
    rows : tuple of int
        Degrees of freedom that are allocated; the others are left out.
    weights : ndarray, shape (m,)
        Price of the squared command of each.
    limits : ndarray, shape (m,)
        Largest magnitude of each command; infinite where there is none.
    """

    matrix: np.ndarray
    rows: tuple[int, ...]
    weights: np.ndarray
    limits: np.ndarray

    @property
    def limited(self) -> bool:
        """Whether any command has a limit."""
        return bool(np.isfinite(self.limits).any())

    @property
    def acting(self) -> np.ndarray:
        """Rows of the matrix that are allocated, shape (k, m)."""
        return self.matrix[list(self.rows)]

    @property
    def pseudo_inverse(self) -> np.ndarray:
        """Commands of a unit of each allocated force without limits, shape (m, k)."""
        b, cheap = self.acting, 1 / self.weights[:, None]
        inverse = cheap * b.T @ np.linalg.inv(b @ (cheap * b.T))
        return np.where(np.abs(inverse) < 1e-14 * np.abs(inverse).max(), 0.0, inverse)

    def commands(self, force: ca.SX) -> ca.SX:
        """Commands for a wanted force in all degrees of freedom, shape (n, 1) to (m, 1)."""
        wanted = force[list(self.rows)]
        first = ca.sparsify(ca.SX(ca.DM(self.pseudo_inverse))) @ wanted
        return self._within_limits(wanted, first) if self.limited else first

    def delivered(self, commands: ca.SX) -> ca.SX:
        """Force of commands in all degrees of freedom, shape (m, 1) to (n, 1)."""
        return ca.sparsify(ca.SX(ca.DM(self.matrix))) @ commands

    def __call__(self, force: Sequence[float]) -> np.ndarray:
        """Commands for a wanted force as numbers."""
        wanted = ca.SX.sym("force", len(self.matrix))
        found = ca.Function("allocate", [wanted], [self.commands(wanted)])(force)
        return np.asarray(ca.densify(found)).ravel()

    # --- with limits --------------------------------------------------------------------------
    def _within_limits(self, wanted: ca.SX, step: ca.SX) -> ca.SX:
        b = ca.sparsify(ca.SX(ca.DM(self.acting)))
        commands, free = ca.SX.zeros(len(self.limits), 1), ca.SX.ones(len(self.limits), 1)
        short: ca.SX = ca.SX(1)
        for _ in range(int(np.isfinite(self.limits).sum()) + 1):
            ratios = [self._room(commands[i], step[i], i) for i in range(len(self.limits))]
            share = ca.fmin(1, _least(ratios))
            limits = ca.DM(self.limits)
            commands = ca.fmax(-limits, ca.fmin(limits, commands + share * step))
            short = short * (share < 1)
            free = free * (ca.vertcat(*ratios) > share)
            step = short * self._step(b, free, wanted - b @ commands)
        return commands

    def _room(self, command: ca.SX, step: ca.SX, i: int) -> ca.SX:
        """Which part of a step a command can make before it is at its limit."""
        room = self.limits[i] - ca.sign(step) * command
        return (
            ca.if_else(step == 0, _INF, room / ca.fabs(step)) if np.isfinite(self.limits[i]) else ca.SX(_INF)
        )

    def _step(self, b: ca.SX, free: ca.SX, left: ca.SX) -> ca.SX:
        """Change of the free commands that brings the rest of the force, or as much of it as they can."""
        cheap = free / ca.DM(self.weights)
        gram = b @ ca.diag(cheap) @ b.T
        damping = _DAMPING * np.trace(self.acting @ (self.acting / self.weights).T) / len(self.rows)
        multipliers = solve_symmetric(gram + damping * ca.SX.eye(len(self.rows)), left)
        return cheap * (b.T @ multipliers)


def _least(values: list[ca.SX]) -> ca.SX:
    least = values[0]
    for value in values[1:]:
        least = ca.fmin(least, value)
    return least


def allocation_of(gains: GainSet) -> Allocation:
    """The allocation that a gain set asks for on the vehicle that it knows.

    Raises
    ------
    UndertowError
        If a limit is none, or the thrusters push in nothing that the law uses, or not independently.
    """
    plant, vehicle = gains.plant, gains.plant.vehicle
    matrix = np.array(plant.B.xreplace(plant.numbers).tolist(), dtype=float).reshape(plant.B.shape)
    dofs = vehicle.degrees_of_freedom
    rows = tuple(i for i, d in enumerate(dofs) if d not in gains.unactuated)
    if not rows:
        raise UndertowError(
            f"a controller has nothing to command: no thruster of '{vehicle.name}' pushes in "
            f"{', '.join(dofs)}; add [[thrusters]] to the vehicle file"
        )
    if np.linalg.matrix_rank(matrix[list(rows)]) < len(rows):
        raise UndertowError(
            f"thrusters of '{vehicle.name}' cannot push in {', '.join(dofs[i] for i in rows)} independently: "
            "name in unactuated, in the gain file, what is to be left out"
        )
    own = {t.name: t.limit for t in vehicle.thrusters}
    stated = {name: _limit(name, limit) for name, limit in gains.allocation.limits.items()}
    names = vehicle.command_names
    limits = [stated.get(n, own.get(n)) for n in names]
    weights = np.array([gains.allocation.weights.get(n, 1.0) for n in names])
    return Allocation(matrix, rows, weights, np.array([_INF if v is None else v for v in limits]))


def _limit(name: str, stated: Quantity) -> float:
    """A limit as vehicle files state it: in N where the command is the thrust itself."""
    try:
        value = to_si(stated, "N" if isinstance(stated, str) and "N" in stated else "command")
    except UndertowError as error:
        raise UndertowError(f"[allocation] limit of thruster '{name}': {error}") from error
    if value <= 0:
        raise UndertowError(f"[allocation] limit of thruster '{name}' is {stated}: give one above zero")
    return value


GATE = "gate"
# Parts of the wanted force that count as rounding and not as a limit.
_ROUNDING = 1e-9
# What waits for the heading, and the motions that the law does not even brake meanwhile.
_WAITING, _IDLE = ("x", "y"), ("u", "v")


class Controller:
    """A gain set as CasADi functions of what the sensors report.

    y is the reported pose and velocity in the vehicle's degrees of freedom, r the desired pose, s the states
    of the law and a last one for the gate (0 closed, 1 passed), k the gains, all in SI.

    Parameters
    ----------
    gains : GainSet
        The law with its gains, on the vehicle that it knows.

    Raises
    ------
    UndertowError
        If the thrusters cannot give the force, or the schedule needs an axis that the vehicle lacks.

    Attributes
    ----------
    gains : GainSet
        As given.
    allocation : Allocation
        How forces become commands.
    """

    def __init__(self, gains: GainSet) -> None:
        self.gains = gains
        self.allocation: Allocation = allocation_of(gains)
        self._coordinates = gains.plant.vehicle.pose_names
        self._check_schedule()
        n, n_states = len(self._coordinates), len(self.state_names)
        self._y, self._desired = ca.SX.sym("y", 2 * n), ca.SX.sym("r", n)
        self._own, self._passed = ca.SX.sym("s", n_states - 1), ca.SX.sym(GATE)
        self._k, self._dt = ca.SX.sym("k", len(self.gain_names)), ca.SX.sym("dt")

    def _check_schedule(self) -> None:
        missing = [c for c in ("x", "psi") if c not in self._coordinates]
        if self._by_turns and missing:
            raise UndertowError(
                f"[schedule] order = 'yaw-first' needs {missing[0]}, which '{self.gains.plant.vehicle.name}' "
                'does not have: write order = "together"'
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
        return (*self.gains.law.state_names(self._coordinates), GATE)

    @property
    def gain_names(self) -> tuple[str, ...]:
        """Names of the entries of k."""
        return tuple(str(g.symbol(c)) for g in type(self.gains.law).gains for c in self._coordinates)

    def gain_values(self) -> list[float]:
        """Values of k."""
        return [self.gains.values[name] for name in self.gain_names]

    def initial_states(self) -> list[float]:
        """Values of s at the start: integrals at zero, the gate closed where there is one."""
        return [*[0.0] * (len(self.state_names) - 1), 0.0 if self._by_turns else 1.0]

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
        gate = self._gate()
        commands, rates, force = self._law(gate)
        following = ca.vertcat(self._own + self._dt * rates, gate)
        return self._function("control", [self._dt], [commands, following, force], ["u", "s_next", "tau"])

    @cached_property
    def continuous(self) -> ca.Function:
        """`(u, s_dot, tau) = law(y, r, s, k)`: commands and rates in continuous time, the gate as in s."""
        commands, rates, force = self._law(self._passed)
        return self._function("law", [], [commands, ca.vertcat(rates, 0), force], ["u", "s_dot", "tau"])

    def _function(self, name: str, more: list[ca.SX], outputs: list[ca.SX], names: list[str]) -> ca.Function:
        states = ca.vertcat(self._own, self._passed)
        inputs = [self._y, self._desired, states, self._k, *more]
        input_names = ["y", "r", "s", "k", *["dt"] * len(more)]
        return ca.Function(name, inputs, [ca.densify(o) for o in ca.cse(outputs)], input_names, names)

    # --- the law --------------------------------------------------------------------------------
    @cached_property
    def _error(self) -> ca.SX:
        """Desired less reported pose, angles within half a turn."""
        n = len(self._coordinates)
        named = zip(self._coordinates, ca.vertsplit(self._desired - self._y[:n]), strict=True)
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
        law, signals = self.gains.law, self.gains.signals
        opened = self._open(gate, self._coordinates)
        open_states = ca.vertcat(*[opened] * len(law.states)) if law.states else ca.SX(0, 1)
        states = open_states * self._own
        convert = self._converter(opened * self._error, states, gate)
        # A force that nothing gives is left out where it is asked for, so that it counts as no limit.
        force = _only(convert.matrix(law.force(signals)), self.allocation.rows)
        commands = self.allocation.commands(force)
        early = self.gains.schedule.integrators == "start"
        rates = self._converter(self._error, self._own, ca.SX(1)) if early else convert
        moving = rates.matrix(law.rates(signals)) if law.states else ca.SX(0, 1)
        moving = moving if early else open_states * moving
        return commands, self._held(moving, force, commands, states, convert), force

    def _held(self, rates: ca.SX, force: ca.SX, commands: ca.SX, states: ca.SX, convert: Converter) -> ca.SX:
        """Rates of the law's states, zero for one that would ask for more of what the thrusters lack."""
        allocation, signals = self.allocation, self.gains.signals
        if not (allocation.limited and rates.numel() and self.gains.allocation.anti_windup == "hold"):
            return rates
        rows = list(allocation.rows)
        lacking = (force - allocation.delivered(commands))[rows]
        short = ca.sumsqr(lacking) > _ROUNDING**2 * ca.sumsqr(force[rows])
        asked = convert.matrix(self.gains.law.force(signals).jacobian(signals.states))[rows, :]
        pushes = (asked.T @ lacking) * rates > 0
        return rates * (1 - short * pushes)

    def _converter(self, error: ca.SX, states: ca.SX, gate: ca.SX) -> Converter:
        plant, signals = self.gains.plant, self.gains.signals
        idle = self._by_turns and not gate.is_one()
        seen = [
            gate * y if idle and str(v) in _IDLE else y
            for v, y in zip([*plant.eta, *plant.nu], ca.vertsplit(self._y), strict=True)
        ]
        gains = [sm.Symbol(name, real=True) for name in self.gain_names]
        groups = (
            ([*plant.eta, *plant.nu], ca.vertcat(*seen)),
            (signals.error, error),
            (signals.states, states),
            (gains, self._k),
        )
        known = {
            s: e for symbols, vector in groups for s, e in zip(symbols, ca.vertsplit(vector), strict=False)
        }
        return Converter(known | {s: ca.SX(float(v)) for s, v in plant.numbers.items()})


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
_POSE_UNITS = ("m",) * 3 + ("rad",) * 3
_UNITS = dict(
    zip(
        (*POSE, *VELOCITY, *(f"tau_{f}" for f in FORCE)),
        (*_POSE_UNITS, *VELOCITY_UNITS, *FORCE_UNITS),
        strict=True,
    )
)
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
    """The generated files of a controller.

    Parameters
    ----------
    controller : Controller
        The controller.

    Raises
    ------
    UndertowError
        If the name of the vehicle or of the gains gives no folder name, or that of the pictures.

    Attributes
    ----------
    folder : Path
        Where the files go, under the folder of all that is generated.
    """

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

    def write(self, out: Path) -> Report:
        """Write controller.c and controller.h to a folder of their own in that of the vehicle.

        Raises
        ------
        UndertowError
            If the folder cannot be written.
        """
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
            "desired": [Entry(n, _UNITS[n]) for n in pose],
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
        return {**named, **titles, **sizes, **lists, "HEADING_DECLARED": declared}

    @property
    def _plane(self) -> bool:
        return {"x", "y", "psi"} <= set(self._vehicle.pose_names)

    # --- the source -------------------------------------------------------------------------------
    def _source(self) -> str:
        name, entries = self._name, self._entries()
        gains = self._controller.gains
        head = f"/* Controller '{comment(gains.name)}', generated by undertow; see controller.h. */"
        named = ("report", "state", "gain", "command")
        lines = [head, '#include "controller.h"', "", "#include <math.h>", ""]
        lines += [strings(f"{name}_{what}_names", entries[what]) for what in named]
        lines += [f"const double {name}_gains[] = {{{_numbers(self._controller.gain_values())}}};", ""]
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


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(map(repr, values))


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return ""
