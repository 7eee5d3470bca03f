"""The vehicle as a system of python-control, and a control law closed around it."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite

import casadi as ca
import control as ct
import numpy as np
from scipy.linalg import matrix_balance

from undertow.codegen.compiler import Evaluator
from undertow.codegen.manifest import whole_samples
from undertow.control.controller import Controller
from undertow.control.gains import GainSet
from undertow.control.laws import DISCONTINUOUS
from undertow.control.plant import Plant
from undertow.errors import UndertowError, of_stated_kinds
from undertow.model.vehicle import Vehicle
from undertow.observer.design import SETTINGS as DESIGN
from undertow.observer.design import Design
from undertow.observer.process import process_of
from undertow.typing import Array

from .analysis import Margins, margins, minimal, multiloop_disk_margin, sampling_time
from .numeric import Numeric, in_direction
from .trim import Trim, find_trim

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class DelaySettings:
    """Limits for approximating dead times, and for filters to converge."""

    # Order of Padé's approximation: from 9 on its polynomials lose all their digits for a delay of 10 ms.
    max_pade: int = 8
    max_samples: int = 1000  # of a delay, each of which is a state for every signal that comes late
    # Of the iteration for a filter beside them: rounds at most, and the relative change that is rounding.
    rounds: int = 100
    relative_change: float = 1e-13


SETTINGS = DelaySettings()


@of_stated_kinds
def linearize(
    vehicle: Vehicle, trim: Trim | Mapping[str, float], *, pade: int = 0, dt: float = 0.0, units: bool = False
) -> ct.StateSpace:
    """The vehicle near a steady motion, as a linear system with names.

    States are deviations from the trim: pose (m, rad, NED), velocity (m/s, rad/s, body), then states of the
    vehicle's effects. Inputs are deviations of the commands, outputs of the reported pose and velocity. In a
    turn x and y are left out: their slopes change with the heading.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    trim : Trim or mapping
        The steady motion, or what it holds (see `find_trim`).
    pade : int
        Order of the approximation of dead times between command and thrust and of reports; 0 leaves them out.
    dt : float
        Sampling time, s: the system from commands that are held for it (zero-order hold) to samples of what
        is reported, exact but for dead times, which are rounded to whole samples. 0 is continuous time.
    units : bool
        Whether labels are "u [m/s]" instead of "u".

    Raises
    ------
    UndertowError
        If there is no such steady motion, the trim is of another vehicle, or dt is negative.
    """
    found = trim if isinstance(trim, Trim) else find_trim(vehicle, trim)
    numeric = Numeric(in_direction(vehicle, found.direction))
    if tuple(found.states) != numeric.states or tuple(found.commands) != numeric.commands:
        raise UndertowError(
            f"the trim is of a different vehicle from '{vehicle.name}': find it again for this one"
        )
    system = linear_with_delays(numeric, found, int(pade), float(dt))
    return with_units(system, numeric.units) if units else system


def linear_with_delays(
    numeric: Numeric, trim: Trim, pade: int, dt: float = 0.0, p: Array | None = None
) -> ct.StateSpace:
    """The linear system at a trim, sampled with its dead times in whole samples, or with Padé's."""
    _check_sampling(dt, pade)
    system = linear_at(numeric, trim, p)
    system = system.sample(dt, name=system.name) if dt else system  # behind a zero-order hold
    if not (np.isfinite(system.A).all() and np.isfinite(system.B).all()):
        raise UndertowError(f"sampled every {dt:g} s the motion has no finite numbers: shorten dt")
    dead, late = numeric.functions.late(p)
    late = {n: s for n, s in late.items() if n in system.output_labels}
    if not dead and not late:
        return system
    if not (pade or dt):
        acting = [f"commands act {dead:g} s late"] if dead else []
        _log.warning(
            "%s of '%s'; the linear system is without it, --pade 3 (pade=3) has it approximately",
            ", ".join(acting + [f"{name} is reported {age:g} s late" for name, age in late.items()]),
            numeric.vehicle.name,
        )
        return system
    inputs, outputs = system.input_labels, system.output_labels
    if dead:
        delays, own = _delays(inputs, dict.fromkeys(inputs, dead), pade, dt)
        system = named(system * delays, (*own, *system.state_labels), inputs, outputs, system.name)
    if late:
        delays, own = _delays(outputs, late, pade, dt)
        system = named(delays * system, (*system.state_labels, *own), inputs, outputs, system.name)
    return system


def _delays(
    names: Sequence[str], seconds: Mapping[str, float], order: int, dt: float
) -> tuple[ct.StateSpace, list[str]]:
    """Delays of signals, whole samples or Padé's, those without one straight through, and their states."""
    straight = ct.ss([], [], [], 1.0, dt=dt)
    made = {n: _sample_delay(s, dt) if dt else _pade(s, order) for n, s in seconds.items()}
    each = [made.get(n, straight) for n in names]
    states = [f"late_{n}_{k}" for n, own in zip(names, each, strict=True) for k in range(own.nstates)]
    return ct.append(*each), states


def _pade(seconds: float, order: int) -> ct.StateSpace:
    """Padé's approximation, its states scaled alike: where they span decades, a filter loses its digits."""
    found = ct.ss(ct.tf(*ct.pade(seconds, order)))
    whole = np.block([[found.A, found.B], [found.C, np.zeros((1, 1))]])
    *scale, last = np.diag(matrix_balance(whole, permute=False)[1])
    by = np.array(scale) / last
    return ct.ss(found.A * by / by[:, None], found.B / by[:, None], found.C * by, found.D)


def _sample_delay(seconds: float, dt: float) -> ct.StateSpace:
    """A delay of the whole samples that are nearest."""
    k = whole_samples(seconds, dt)
    if k > SETTINGS.max_samples:
        raise UndertowError(
            f"a dead time of {seconds:g} s has {k} samples of {dt:g} s, but {SETTINGS.max_samples} is the "
            "limit: lengthen dt"
        )
    if not k:
        return ct.ss([], [], [], 1.0, dt=dt)
    first, last = np.eye(k)[:, [0]], np.eye(k)[[-1]]
    return ct.ss(np.eye(k, k=-1), first, last, 0.0, dt=dt)


def _check_sampling(dt: float, pade: int) -> None:
    if not (isfinite(dt) and dt >= 0):
        raise UndertowError(f"sampling time dt = {dt:g} s is impossible: give a time above zero")
    if not 0 <= pade <= SETTINGS.max_pade:
        raise UndertowError(
            f"pade = {pade} is not an order of approximation for dead times: give 0 to {SETTINGS.max_pade}"
        )
    if dt and pade:
        raise UndertowError(
            f"dt = {dt:g} s takes dead times as whole samples, and pade = {pade} would approximate them: "
            "leave out one of the two"
        )


def with_units(system: ct.InputOutputSystem, units: Mapping[str, str]) -> ct.InputOutputSystem:
    """The same system, whose labels say units, as in "u [m/s]"; what has no unit keeps its name."""
    system.set_states([_labelled(n, units) for n in system.state_labels])
    system.set_inputs([_labelled(n, units) for n in system.input_labels])
    system.set_outputs([_labelled(n, units) for n in system.output_labels])
    return system


def _labelled(name: str, units: Mapping[str, str]) -> str:
    return f"{name} [{units[name]}]" if name in units else name


def linear_at(numeric: Numeric, trim: Trim, p: Array | None = None) -> ct.StateSpace:
    """The linear system at a trim for values of the parameters, without dead time."""
    _, a, b, _ = numeric.slopes(trim.x, trim.u, p)
    c, d = numeric.report_slopes(trim.x, trim.u, p)
    omitted = ("x", "y") if trim.turning else ()
    kept = [i for i, name in enumerate(numeric.states) if name not in omitted]
    shown = [i for i, name in enumerate(numeric.outputs) if name not in omitted]
    return ct.ss(
        a[np.ix_(kept, kept)] + 0.0,  # no -0.0
        b[kept],
        c[np.ix_(shown, kept)],
        d[shown],
        states=[numeric.states[i] for i in kept],
        inputs=list(numeric.commands),
        outputs=[numeric.outputs[i] for i in shown],
        name=_name(numeric.vehicle),
    )


@of_stated_kinds
def as_nlsys(
    vehicle: Vehicle, *, direction: Mapping[str, int] | None = None, units: bool = False
) -> ct.NonlinearIOSystem:
    """The vehicle as a nonlinear system that calls the equations of motion.

    States, inputs and outputs are those of `linearize`, but absolute values instead of deviations. The
    parameter ``p`` of the system replaces the values of the vehicle's parameters. A dead time is left out.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    direction : mapping, optional
        1 or -1 by velocity: one set of parameters for both ways, so that the equations are smooth there.
    units : bool
        Whether labels are "u [m/s]" instead of "u"; `as_controller` connects by them if it has them, too.
    """
    numeric = Numeric(in_direction(vehicle, direction or {}))
    if late := numeric.functions.late()[0]:
        _log.warning("commands of '%s' act %g s late; as_nlsys is without it", vehicle.name, late)

    system = ct.nlsys(
        lambda t, x, u, params: numeric.rate(t, x, u, params.get("p")),
        lambda t, x, u, params: numeric.report(t, x, u, params.get("p")),
        states=list(numeric.states),
        inputs=list(numeric.commands),
        outputs=list(numeric.outputs),
        name=_name(vehicle),
    )
    return with_units(system, numeric.units) if units else system


def _name(vehicle: Vehicle) -> str:
    """The vehicle's name without the dot, which python-control puts between a system and its signals."""
    return vehicle.name.replace(".", "_")


def named(
    system: ct.StateSpace, states: Sequence[str], inputs: Sequence[str], outputs: Sequence[str], name: str
) -> ct.StateSpace:
    """The same system with these names."""
    labels = {"states": list(states), "inputs": list(inputs), "outputs": list(outputs)}
    return ct.ss(system.A, system.B, system.C, system.D, dt=system.dt, name=name, **labels)


_GATE_PASSED = 1.0


class LawSystem:
    """A gain set in continuous time, with its gate open.

    `references`, `measured`, `states` and `forces` name set-points, pose and velocity, the law's own states
    and the forces it asks for; `actuated` are the places of the degrees of freedom that commands push in;
    `B_inverse`, shape (nu, n), has the commands for a unit of each force, without limits.
    """

    def __init__(self, gains: GainSet) -> None:
        self.gains, self._controller = gains, Controller(gains)
        vehicle = gains.plant.vehicle
        self.references = [f"{name}_ref" for name in vehicle.pose_names]
        self.measured = [*vehicle.pose_names, *vehicle.velocity_names]
        self.states = list(self._controller.state_names[:-1])
        self.forces = [f"force_{name}" for name in vehicle.degrees_of_freedom]
        allocation = self._controller.allocation
        self.actuated = allocation.rows
        self.B_inverse = allocation.B_inverse
        self.commands = self._controller.command_names
        self._k = np.array(self._controller.gain_values())

    @property
    def units(self) -> dict[str, str]:
        """Unit of every set-point, report, integral of an error, and command."""
        own = Numeric(self.gains.plant.vehicle).units
        references = {f"{n}_ref": own[n] for n in self.gains.plant.vehicle.pose_names}
        integrals = {f"integral_{n}": f"{own[n]} s" for n in self.gains.plant.vehicle.pose_names}
        return own | references | integrals

    def outputs(self, ref: Array, y: Array, z: Array) -> tuple[Array, Array, Array]:
        """Commands, rates of the law's states, and the forces it asks for."""
        state = np.append(z, _GATE_PASSED)
        u, rates, force = (part[:, 0] for part in self._continuous(y, ref, state, self._k))
        return u, rates[:-1], force

    @cached_property
    def _continuous(self) -> Evaluator:
        return Evaluator(self._controller.continuous)

    @cached_property
    def _slopes(self) -> Evaluator:
        n = len(self.references)
        ref, y, z = ca.SX.sym("ref", n), ca.SX.sym("y", 2 * n), ca.SX.sym("z", len(self.states))
        _, rates, force = self._controller.continuous(y, ref, ca.vertcat(z, _GATE_PASSED), self._k)
        slope = ca.jacobian(ca.vertcat(force, rates), ca.vertcat(ref, y, z))
        return Evaluator(ca.Function("law_slopes", [ref, y, z], [ca.densify(slope)]))

    # --- systems ------------------------------------------------------------------------------
    def nonlinear(self) -> ct.NonlinearIOSystem:
        """References, pose and velocity to commands."""
        n = len(self.references)

        def outputs(z: Array, inputs: Array) -> tuple[Array, Array, Array]:
            return self.outputs(inputs[:n], inputs[n:], z)

        return ct.nlsys(
            (lambda t, z, inputs, params: outputs(z, inputs)[1]) if self.states else None,
            lambda t, z, inputs, params: outputs(z, inputs)[0],
            states=self.states or None,
            inputs=[*self.references, *self.measured],
            outputs=list(self._controller.command_names),
            name="law",
        )

    def linear(self, trim: Trim) -> ct.StateSpace:
        """The law at a trim that it keeps: references, pose and velocity to forces."""
        n, nz = len(self.references), len(self.states)
        (slope,) = self._slopes(*self.operating_point(trim))
        force, rates = slope[:n], slope[n : n + nz]  # the last row is the gate's
        return ct.ss(
            rates[:, 3 * n :].reshape(nz, nz),
            rates[:, : 3 * n].reshape(nz, 3 * n),
            force[:, 3 * n :].reshape(n, nz),
            force[:, : 3 * n],
            states=self.states,
            inputs=[*self.references, *self.measured],
            outputs=self.forces,
            name="law",
        )

    def operating_point(self, trim: Trim) -> tuple[Array, Array, Array]:
        """Reference, reported motion and law states for which the law asks for the forces of a trim.

        Integrals supply what the trim needs; a law without them keeps a steady-state error.
        """
        law = self.gains.law
        if law.id in DISCONTINUOUS:
            raise UndertowError(
                f"law '{law.id}' of '{self.gains.name}' is discontinuous at its set-point, so it has no "
                "linearisation there: use 'sliding-mode-boundary-layer', or simulate it"
            )
        if trim.turning:
            raise UndertowError(
                f"'{self.gains.name}' holds a pose and cannot hold a turn: use a trim without r"
            )
        n = len(self.references)
        y = trim.y
        ref, z, rows = y[:n].copy(), np.zeros(len(self.states)), list(self.actuated)
        commands = np.array([trim.commands[n] for n in self._controller.command_names])
        target = self._controller.allocation.allocated @ commands
        for _ in range(20):  # Newton; laws are nearly linear, so that a few would do
            missing = target - self.outputs(ref, y, z)[2][rows]
            slope = self._slopes(ref, y, z)[0][rows]
            if self.states:
                z = z + np.linalg.pinv(slope[:, 3 * n :]) @ missing
            else:
                ref = ref + np.linalg.pinv(slope[:, :n]) @ missing
        return ref, y, z


@of_stated_kinds
def as_controller(gains: GainSet, *, units: bool = False) -> ct.NonlinearIOSystem:
    """A gain set as a nonlinear system: references (x_ref ...), pose and velocity to commands.

    Its signals are named so that ``control.interconnect([as_nlsys(vehicle), as_controller(gains)], ...)``
    closes the loop by itself. It is the law in continuous time with its allocation and limits; a gate in its
    schedule counts as open.

    Parameters
    ----------
    gains : GainSet
        The law and the vehicle that it knows.
    units : bool
        Whether labels are "u [m/s]" instead of "u", as those of `as_nlsys` with ``units=True``.
    """
    law = LawSystem(gains)
    return with_units(law.nonlinear(), law.units) if units else law.nonlinear()


def forces_of(vehicle: Vehicle) -> tuple[list[str], Array]:
    """Names of the body-frame forces that commands give, and commands for a unit of each, shape (nu, k)."""
    plant = Plant(vehicle)
    matrix = plant.thrust_matrix
    rows = [i for i, row in enumerate(matrix) if np.any(row)]
    # Surfaces and inputs of the log have no part in it.
    places = [vehicle.command_names.index(name) for name in plant.vehicle.command_names]
    inverse = np.zeros((len(vehicle.command_names), len(rows)))
    inverse[places] = np.linalg.pinv(matrix[rows], rcond=1e-10)
    return [f"force_{vehicle.degrees_of_freedom[i]}" for i in rows], inverse


@of_stated_kinds
def close_loop(
    vehicle: Vehicle,
    gains: GainSet,
    trim: Trim | Mapping[str, float] | None = None,
    *,
    pade: int = 0,
    dt: float = 0.0,
    observer: Design | None = None,
) -> LinearLoop:
    """A law that keeps a vehicle at a trim, as linear systems.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    gains : GainSet
        The law, which knows the same vehicle.
    trim : Trim or mapping
        The steady motion, or what it holds (see `find_trim`).
    pade : int
        Order of the approximation of dead times, of those that the observer knows, too.
    dt : float
        Sampling time, s: the law runs as its C code does, its commands are held; 0 is continuous time.
    observer : Design, optional
        Gives the law an estimate in place of the reports: its steady-state Kalman filter at this trim.

    Raises
    ------
    UndertowError
        If there is no such trim, or the law is not linearisable there, or a filter is to be sampled.
    """
    if dt and observer is not None:
        raise UndertowError(
            f"the filter of an observer has no sampled form here (dt = {dt:g} s): leave out one of the two"
        )
    found = trim if isinstance(trim, Trim) else find_trim(vehicle, trim)
    law = law_for(gains, vehicle, found.direction)
    plant = with_commands(linearize(vehicle, found, pade=pade, dt=dt), law.commands)
    return LinearLoop(plant, law, found, observer, pade)


def with_commands(plant: ct.StateSpace, commands: Sequence[str]) -> ct.StateSpace:
    """The linear vehicle with the commands of a law alone: without surfaces and inputs of the log."""
    if tuple(plant.input_labels) == tuple(commands):
        return plant
    system = plant[:, list(commands)]
    return named(system, plant.state_labels, commands, plant.output_labels, plant.name)


def law_for(gains: GainSet, vehicle: Vehicle, direction: Mapping[str, int]) -> LawSystem:
    """A law that knows a vehicle, with the set of parameters of a direction of motion."""
    return LawSystem(replace(gains, plant=Plant(in_direction(vehicle, direction), gains.plant.speed)))


class LinearLoop:
    """A law that keeps a vehicle at a trim, linear; `close_loop` makes it.

    `plant` leads from commands to reported pose and velocity, `law` from references, pose and velocity to
    forces.
    """

    def __init__(
        self,
        plant: ct.StateSpace,
        system: LawSystem,
        trim: Trim,
        observer: Design | None = None,
        pade: int = 0,
    ) -> None:
        self.plant, self._system, self.trim = plant, system, trim
        self.law = _sampled(system.linear(trim), sampling_time(plant))
        if observer is not None:
            self.law = _with_filter(self.law, system, SteadyStateFilter(observer, trim, pade))

    @cached_property
    def _reference(self) -> Array:
        """The set-point that the law keeps this trim for."""
        return self._system.operating_point(self.trim)[0]

    @property
    def pose_offset(self) -> dict[str, float]:
        """True pose at the trim less the set-point, m and rad."""
        offset = self.trim.x[: len(self._reference)] - self._reference
        return dict(zip(self._system.measured, map(float, offset), strict=False))

    @property
    def references(self) -> list[str]:
        """Names of the set-points of the coordinates that commands push."""
        return [self._system.references[i] for i in self._system.actuated]

    @property
    def forces(self) -> list[str]:
        """Names of the forces that commands give."""
        return [self._system.forces[i] for i in self._system.actuated]

    @cached_property
    def closed(self) -> ct.StateSpace:
        """References to pose, velocity and commands."""
        whole = _closed(self.plant, self._system.B_inverse * self.law)
        names = (*self.plant.state_labels, *self.law.state_labels)
        outputs = [*self.plant.output_labels, *self.plant.input_labels]
        return named(whole, names, self._system.references, outputs, "closed")

    @cached_property
    def open_loop(self) -> ct.StateSpace:
        """The loop cut at the forces: forces to minus the forces of the law."""
        n = len(self._system.references)
        names = self._system.forces
        answer = -self.law[:, self.law.input_labels[n:]] * (self.plant * self._system.B_inverse)
        return named(answer, answer.state_labels, names, names, "opened")

    def single_loop(self, force: str) -> ct.StateSpace:
        """The loop of one force with the others closed, minimal."""
        i = self._system.forces.index(force)
        others = np.eye(len(self._system.forces))
        others[i, i] = 0.0
        others_closed = ct.feedback(self.open_loop, ct.ss([], [], [], others))
        return minimal(others_closed[i, i])

    @cached_property
    def actuated_loop(self) -> ct.StateSpace:
        """The loop cut at the forces that commands give, minimal."""
        return minimal(self.open_loop[self.forces, self.forces])

    @cached_property
    def disk(self) -> float:
        """Disk margin of the loops of all forces at once, which `multiloop_disk_margin` describes."""
        return multiloop_disk_margin(self.actuated_loop)

    @cached_property
    def margins(self) -> dict[str, Margins]:
        """Margins of the loop of each force that commands give, with the others closed."""
        return {force: margins(self.single_loop(force)) for force in self.forces}


class SteadyStateFilter:
    """The steady-state Kalman filter of an observer at a trim, in continuous time.

    Reports every T s with variance r are equivalent to a continuous report with spectral density r T (Simon
    2006, section 8.1); a sensor without a period counts as one of `USUAL_PERIOD`. Deviations from
    the trim follow dx/dt = a x + b u, with reports c x; `gain`, shape (nx, k), is that of the innovations.
    With late reports, the states of Padé's approximation of their delay are included.
    """

    def __init__(self, observer: Design, trim: Trim, pade: int = 0) -> None:
        own = observer.process
        process = process_of(in_direction(own.vehicle, trim.direction), own.estimated, own.kind)
        self.observer, self.names = observer, process.state_names
        known = {**trim.states, **dict(zip(process.vehicle.parameter_names, process.values, strict=True))}
        x = np.array([known.get(name, 0.0) for name in self.names])
        u = np.array([trim.commands.get(name, 0.0) for name in process.vehicle.command_names])
        _, a, _, c = (np.nan_to_num(m) for m in map(np.asarray, process.system(x, u, process.values, 0.0)))
        slope = ca.Function(
            "by_u",
            [process.x, process.u, process.p, process.t],
            [ca.densify(ca.jacobian(process.rates, process.u))],
        )
        self.a, self.b, self.c = a, np.asarray(slope(x, u, process.values, 0.0)), c[list(observer.channels)]
        if observer.late:
            self._add_delays(pade)
        noise = np.zeros_like(self.a)
        noise[process.driven, process.driven] = observer.densities
        r = np.diag(observer.variance * np.where(observer.period > 0, observer.period, DESIGN.sample))
        self.gain = self._steady_gain(noise, r)

    def _add_delays(self, order: int) -> None:
        name, age = next(iter(self.observer.late.items()))
        if not order:
            raise UndertowError(
                f"{name} is reported {age:g} s late, and a filter in continuous time has that approximately: "
                "give the order of Padé's approximation, --pade 3 (pade=3)"
            )
        delays, own = _delays(self.observer.sensors, self.observer.late, order, 0.0)
        lacking = np.zeros((len(self.a), len(own)))
        self.a = np.block([[self.a, lacking], [delays.B @ self.c, delays.A]])
        self.b = np.vstack([self.b, np.zeros((len(own), self.b.shape[1]))])
        self.c = np.hstack([delays.D @ self.c, delays.C])
        self.names = (*self.names, *own)

    def _steady_gain(self, noise: Array, r: Array) -> Array:
        try:
            gain = np.linalg.solve(r, self.c @ _steady_covariance(self.a, self.c, noise, r)).T
            converges = bool((np.linalg.eigvals(self.a - gain @ self.c).real < 0).all())
        except np.linalg.LinAlgError:
            converges = False
        if not converges:
            sensors = ", ".join(self.observer.sensors)
            raise UndertowError(
                f"observer '{self.observer.name}' does not converge: its sensors ({sensors}) do not observe "
                "everything that drifts; add one, or estimate less"
            )
        return gain


@np.errstate(all="ignore")  # what does not converge is no filter
def _steady_covariance(a: Array, c: Array, noise: Array, r: Array) -> Array:
    """Steady-state covariance of a filter, by the sign of its Hamiltonian matrix (Roberts 1980).

    Ordered Schur forms fail where eigenvalues are as close to one another as those of delays are.
    """
    n, identity = len(a), np.eye(len(a))
    sign = np.block([[a.T, -c.T @ np.linalg.solve(r, c)], [-noise, -a]])
    for _ in range(SETTINGS.rounds):
        scale = np.exp(-np.linalg.slogdet(sign)[1] / (2 * n))
        before, sign = sign, 0.5 * (scale * sign + np.linalg.inv(sign) / scale)
        if np.linalg.norm(sign - before, 1) <= SETTINGS.relative_change * np.linalg.norm(sign, 1):
            break
    left = np.vstack([sign[:n, n:], sign[n:, n:] + identity])
    right = np.vstack([sign[:n, :n] + identity, sign[n:, :n]])
    found = np.linalg.lstsq(left, -right, rcond=None)[0]
    return np.asarray((found + found.T) / 2)


def _sampled(law: ct.StateSpace, dt: float) -> ct.StateSpace:
    """A law as its C code runs it: an integral advances by dt times its rate (Euler)."""
    if not dt:
        return law
    a, names = np.eye(law.nstates) + dt * law.A, (law.state_labels, law.input_labels, law.output_labels)
    return named(ct.ss(a, dt * law.B, law.C, law.D, dt=dt), *names, law.name)


def _with_filter(law: ct.StateSpace, system: LawSystem, filter: SteadyStateFilter) -> ct.StateSpace:
    """A law that gets the estimate: references and reports to forces, the estimate among the states."""
    n, names, measured = len(system.references), filter.names, system.measured
    take = np.zeros((2 * n, len(names)))
    take[np.arange(2 * n), [names.index(m) for m in measured]] = 1.0
    given = np.zeros((len(filter.observer.sensors), 2 * n))
    given[np.arange(len(given)), [measured.index(m) for m in filter.observer.sensors]] = 1.0
    commands = filter.observer.process.vehicle.command_names
    push = filter.b[:, [commands.index(c) for c in system.commands]] @ system.B_inverse
    b_ref, b_y, d_ref, d_y = law.B[:, :n], law.B[:, n:] @ take, law.D[:, :n], law.D[:, n:] @ take
    a = np.block([[law.A, b_y], [push @ law.C, filter.a - filter.gain @ filter.c + push @ d_y]])
    b = np.block([[b_ref, np.zeros((law.nstates, 2 * n))], [push @ d_ref, filter.gain @ given]])
    d = np.hstack([d_ref, np.zeros((law.noutputs, 2 * n))])
    states = [*law.state_labels, *(f"estimate_{m}" for m in names)]
    whole = ct.ss(a, b, np.hstack([law.C, d_y]), d)
    return named(whole, states, law.input_labels, law.output_labels, "law behind observer")


def _closed(plant: ct.StateSpace, law: ct.StateSpace) -> ct.StateSpace:
    """References to (outputs, commands), by elimination: the plant passes no command straight through."""
    ny = plant.noutputs
    n = law.ninputs - ny
    b_ref, b_y = law.B[:, :n], law.B[:, n:]
    d_ref, d_y = law.D[:, :n], law.D[:, n:]
    a = np.block([[plant.A + plant.B @ d_y @ plant.C, plant.B @ law.C], [b_y @ plant.C, law.A]])
    b = np.vstack([plant.B @ d_ref, b_ref])
    c = np.block([[plant.C, np.zeros((ny, law.nstates))], [d_y @ plant.C, law.C]])
    d = np.vstack([np.zeros((ny, n)), d_ref])
    return ct.ss(a, b, c, d, dt=plant.dt)


def with_forces(
    plant: ct.StateSpace, forces: tuple[list[str], Array], commands: bool = False
) -> ct.StateSpace:
    """The linear vehicle with the inputs of `forces_of`, on demand beside its commands."""
    names, pushed = forces
    if commands:
        names, pushed = [*plant.input_labels, *names], np.hstack([np.eye(plant.ninputs), pushed])
    return named(plant * pushed, plant.state_labels, names, plant.output_labels, plant.name)
