"""The functions of a closed loop: vehicle, sensors, and a controller that may use another model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from scipy.linalg import expm

from undertow.codegen.functions import Functions
from undertow.control.controller import Controller
from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.observer.design import Design

from .scenario import RUNS

# Cosine of 45 degrees, less what rounding takes off.
_ALIGNED = math.sqrt(0.5) - 1e-9


class Interconnection:
    """Model and controller with the signals of one wired to those of the other by name.

    The vehicle that the controller knows may have fewer degrees of freedom than the one that moves. With an
    observer between sensors and controller, the controller gets the estimate.
    """

    def __init__(self, vehicle: Vehicle, controller: Controller, observer: Design | None = None) -> None:
        self.vehicle, self.controller, self.observer = vehicle, controller, observer
        self.functions = Functions(vehicle)
        known = controller.gains.plant.vehicle
        self._check("degree of freedom", known.degrees_of_freedom, vehicle.degrees_of_freedom)
        self._check("command", controller.command_names, vehicle.command_names)
        self.reported_names = (*vehicle.pose_names, *vehicle.velocity_names)
        wanted = (*known.pose_names, *known.velocity_names)
        self.controller_inputs = [self.reported_names.index(name) for name in wanted]
        self.commanded = [vehicle.command_names.index(name) for name in controller.command_names]
        if observer is not None:
            self._check("sensor of the observer", observer.sensors, self.reported_names)
            self._check("motion of the observer", wanted, observer.process.state_names)

    def _check(self, what: str, needed: tuple[str, ...], present: tuple[str, ...]) -> None:
        missing = [name for name in needed if name not in present]
        if missing:
            raise UndertowError(
                f"vehicle '{self.vehicle.name}' lacks {what} '{missing[0]}', which the controller for "
                f"'{self.controller.gains.plant.vehicle.name}' uses: use a vehicle that has it"
            )

    @cached_property
    def turned_thrusters(self) -> tuple[str, ...]:
        """Thrusters whose thrust direction differs by more than 45 degrees from the controller's model.

        Compared is the wrench of a command of one, in the motions that the controller knows; moments are
        divided by the longest lever arm that it knows.
        """
        known = self.controller.gains.plant.vehicle
        rows, moving = list(known.dof_indices), _unit_wrenches(self.vehicle)
        wrenches = _unit_wrenches(known)
        scale = np.ones(6)
        arms = (abs(w[i]) for w in wrenches.values() for i in rows if i > 2)
        scale[3:] = 1 / (max(arms, default=1.0) or 1.0)  # fins alone have no thrust, and so no arms
        return tuple(
            n for n, w in wrenches.items() if not _aligned((scale * w)[rows], (scale * moving[n])[rows])
        )

    # --- functions ----------------------------------------------------------------------------
    @property
    def dynamics(self) -> ca.Function:
        """`x_dot = dynamics(x, u, p, t)`."""
        return self.functions.dynamics

    @property
    def outputs(self) -> ca.Function:
        """`y = outputs(x, u, p, t)`."""
        return self.functions.outputs

    @cached_property
    def control(self) -> ca.Function:
        """`(u, s_next, tau) = control(y, r, s, k, dt)` in the reports and commands of the vehicle."""
        sampled = self.controller.sampled
        if self.observer is None:
            return self._connected(sampled, "control")
        return self._behind_observer(sampled)

    def first_states(self, start: np.ndarray) -> np.ndarray:
        """Values of s at first for a first pose and velocity, shape (ns,)."""
        own = np.array(self.controller.initial_states())
        if self.observer is None:
            return own
        near = dict(zip(self.reported_names, start, strict=True))
        return np.concatenate([self.observer.first(near), own])

    def estimates(self, s: np.ndarray) -> dict[str, np.ndarray]:
        """What the observer carries to the next sample, by state, of rows of s."""
        names = self.observer.process.state_names if self.observer else ()
        return {name: s[:, i] for i, name in enumerate(names)}

    @cached_property
    def present(self) -> ca.Function:
        """`(u, known, zn, sn, tau) = present(z, step, r, s, k, dt)`: the controller behind an observer.

        The estimate z is corrected by the reports of the present step and drives the law, whose commands then
        carry it ahead; `known` are those that the observer knows.
        """
        observer, sampled = self._filter, self.controller.sampled
        names, process = sampled.name_in()[1:], observer.process
        z, step = ca.SX.sym("z", observer.z_size), ca.SX.sym("step", observer.step_size)
        r, s, k, dt = (ca.SX.sym(n, sampled.size1_in(n)) for n in names)
        estimate = observer.corrected(z, step)
        motion = [process.index(self.reported_names[i]) for i in self.controller_inputs]
        commands, own, tau = sampled(estimate[motion], r, s, k, dt)
        known = ca.SX.zeros(process.u.numel(), 1)
        for i, name in enumerate(self.controller.command_names):
            if name in process.vehicle.command_names:
                known[process.vehicle.command_names.index(name)] = commands[i]
        u = ca.SX.zeros(self.functions.u.numel(), 1)
        u[self.commanded] = commands
        ahead = observer.predicted_z(estimate, ca.vertcat(known, step[known.numel() :]), dt)
        outputs = [ca.densify(o) for o in ca.cse([u, known, ahead, own, tau])]
        given, results = ["z", "step", *names], ["u", "known", "zn", "sn", "tau"]
        return ca.Function("present", [z, step, r, s, k, dt], outputs, given, results)

    @property
    def _filter(self) -> Design:
        assert self.observer is not None
        return self.observer

    @property
    def sensors(self) -> list[int]:
        """Places of the observer's sensors among the reports."""
        return [self.reported_names.index(n) for n in self._filter.sensors]

    def _behind_observer(self, sampled: ca.Function) -> ca.Function:
        """The controller behind an observer, whose states stand before those of the controller."""
        observer, names = self._filter, sampled.name_in()
        kept, size = observer.past_steps, observer.step_size
        kind = ca.MX if kept else ca.SX
        more = {"s": observer.size}
        r, s, k, dt = (kind.sym(n, sampled.size1_in(n) + more.get(n, 0)) for n in names[1:])
        y = kind.sym("y", len(self.reported_names))
        z, oldest, past, ages, own = ca.vertsplit(s, [*observer.cuts, s.numel()])
        there, ages = observer.due(ages, dt)
        steps = ca.horzcat(ca.reshape(past, size, kept), ca.vertcat(kind.zeros(size - 1, 1), 1))
        for i, (sensor, lag) in enumerate(zip(self.sensors, observer.lags, strict=True)):
            reported, which = observer.places(i)
            steps[reported, kept - lag], steps[which, kept - lag] = y[sensor], there[i]
        if kept:
            passed = observer.replayed.mapaccum("passed", kept)(
                oldest, steps[:, :kept], ca.repmat(dt, 1, kept)
            )
            z, oldest = passed[:, kept - 1], passed[:, 0]
        u, known, z, own, tau = self.present(z, steps[:, kept], r, own, k, dt)
        steps[: known.numel(), kept] = known
        following = ca.vertcat(z, oldest, ca.vec(steps[:, 1:]), ages, own)
        outputs = [ca.densify(o) for o in ca.cse([u, following, tau])]
        return ca.Function("control", [y, r, s, k, dt], outputs, names, sampled.name_out())

    @cached_property
    def law(self) -> ca.Function:
        """`(u, s_dot, tau) = law(y, r, s, k)`."""
        return self._connected(self.controller.continuous, "law")

    def _connected(self, function: ca.Function, name: str) -> ca.Function:
        names = function.name_in()
        y = ca.SX.sym("y", len(self.reported_names))
        others = [ca.SX.sym(n, function.size1_in(n)) for n in names[1:]]
        commands, *results = function(y[self.controller_inputs], *others)
        u = ca.SX.zeros(self.functions.u.numel(), 1)
        u[self.commanded] = commands
        outputs = [ca.densify(o) for o in (u, *results)]
        return ca.Function(name, [y, *others], outputs, names, function.name_out())

    # --- numbers ------------------------------------------------------------------------------
    @cached_property
    def parameters(self) -> np.ndarray:
        """Values of p."""
        return np.array(self.functions.values(), dtype=float)

    @property
    def gains(self) -> np.ndarray:
        """Values of k."""
        return np.array(self.controller.gain_values())

    def at_rest(self, start: np.ndarray, p: np.ndarray, u: np.ndarray | None = None) -> np.ndarray:
        """States of vehicles whose commands have been held for long; none by default, (b, nx).

        `start` has pose and velocity, shape (b, 2n), `p` the parameters, (b, np).
        """
        f, runs = self.functions, len(start)
        owned = np.zeros((runs, f.x.numel() - start.shape[1]))
        if f.actuator_states.numel():
            held = np.zeros(f.u.numel()) if u is None else u
            owned[:, f.memory.numel() :] = np.asarray(f.rest.map(runs)(held, p.T, 0.0)).T
        return np.hstack([start, owned])

    def delays(self, p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Dead time of commands, shape (b,), and of each report, (b, ny), for parameters (b, np)."""
        f, b = self.functions, len(p)
        late = ca.Function("late", [f.p], [ca.densify(ca.vertcat(f.dead_time(f.p), f.report_age))])
        if late.jac_sparsity(0, 0).nnz():
            found = np.asarray(late.map(b)(p.T)).T
        else:
            found = np.broadcast_to(np.asarray(late(p[0])).T, (b, late.size1_out(0)))
        return found[:, 0], found[:, 1:]


def _unit_wrenches(vehicle: Vehicle) -> dict[str, np.ndarray]:
    """Force and moment of a positive command of each thruster per newton of thrust, shape (6,), 1 and m."""
    return {t.name: np.sign(t.thrust_per_command.value) * np.array(t.wrench) for t in vehicle.thrusters}


def _aligned(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two directions are within 45 degrees; none is like none."""
    sizes = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(one @ other) >= _ALIGNED * sizes if sizes else not (one.any() or other.any())


# --- how long a sampling interval may be ---------------------------------------------------------------
@dataclass(frozen=True)
class SamplingSettings:
    """Settings of the search for the longest sampling interval, and of the steps of a loop."""

    # Growth that counts as none, 1/s: rounding splits poles at zero (a cross-track error that nothing
    # corrects).
    neutral: float = 1e-4
    intervals: tuple[float, float] = (1e-4, 1e3)  # shortest and longest that are tried, s
    tried: int = 141  # intervals from the one to the other
    halvings: int = 40  # of the space between two of them
    # Both sets of parameters that differ by direction are looked at: this far to either side of rest.
    creep: float = 1e-9
    longest_step: float = 0.05  # longest Runge-Kutta step, s,
    reach: float = 0.5  # and as a part of the fastest time constant (right to 0.1% of its decay)


SETTINGS = SamplingSettings()


class SampledLoop:
    """A closed loop linearised at its set-point, at rest.

    Discontinuous terms, such as the sign of a sliding-mode law, count as constant; dead times are left out.
    The vehicle is taken with either set of direction-dependent parameters, the law with their mean.
    """

    def __init__(self, parts: Interconnection, pose: np.ndarray, desired: np.ndarray) -> None:
        self._parts, self._desired = parts, desired
        self._sides = [self._linear(pose, side) for side in (1, -1)]

    def _linear(self, pose: np.ndarray, side: int) -> tuple[np.ndarray, ...]:
        """A and B of the vehicle, Ky, Ks of the commands, Ry, Rs of the law's rates, C of the reports."""
        parts = self._parts
        states = np.array(parts.controller.initial_states())
        states[-1] = 1.0
        # The law at rest: beside it, the slope of a root would be that of nowhere else.
        y = np.concatenate([pose, np.zeros(len(pose))])
        u = np.asarray(parts.law(y, self._desired, states, parts.gains)[0]).ravel()
        moving = np.concatenate([pose, np.full(len(pose), side * SETTINGS.creep)])
        x = parts.at_rest(moving[None], parts.parameters[None], u)[0]
        a, b = _jacobians(parts.dynamics, ("x", "u"), "x_dot", (x, u, parts.parameters, 0.0))
        (c,) = _jacobians(parts.outputs, ("x",), "y", (x, u, parts.parameters, 0.0))
        point = (y, self._desired, states, parts.gains)
        by_u = _jacobians(parts.law, ("y", "s"), "u", point)
        by_rate = _jacobians(parts.law, ("y", "s"), "s_dot", point)
        return a, b, *by_u, *by_rate, c

    # --- eigenvalues --------------------------------------------------------------------------
    def continuous_rates(self, side: int = 0) -> np.ndarray:
        """Eigenvalues without sampling, 1/s."""
        a, b, ky, ks, ry, rs, c = self._sides[side]
        return np.linalg.eigvals(np.block([[a + b @ ky @ c, b @ ks], [ry @ c, rs]]))

    def sampled_rates(self, dt: float, side: int = 0) -> np.ndarray:
        """Logarithms of the eigenvalues from sample to sample, divided by dt, 1/s."""
        a, b, ky, ks, ry, rs, c = self._sides[side]
        n, m = b.shape
        held = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * dt)
        ad, bd = held[:n, :n], held[:n, n:]
        step = np.block([[ad + bd @ ky @ c, bd @ ks], [dt * ry @ c, np.eye(len(rs)) + dt * rs]])
        with np.errstate(divide="ignore"):
            return np.log(np.linalg.eigvals(step).astype(complex)) / dt

    def keeps_stability(self, dt: float) -> bool:
        """Whether sampling keeps everything stable that is stable without it."""
        return all(
            _unstable_count(self.sampled_rates(dt, side)) <= _unstable_count(self.continuous_rates(side))
            for side in (0, 1)
        )

    def longest_interval(self) -> float:
        """The longest interval with which sampling destabilises nothing, s; infinite if unlimited."""
        grid = np.geomspace(*SETTINGS.intervals, SETTINGS.tried)
        bad = next((i for i, dt in enumerate(grid) if not self.keeps_stability(float(dt))), None)
        if bad is None:
            return np.inf
        low, high = (float(grid[bad - 1]), float(grid[bad])) if bad else (0.0, SETTINGS.intervals[0])
        for _ in range(SETTINGS.halvings):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.keeps_stability(middle) else (low, middle)
        return low

    def substeps(self, dt: float, continuous: bool = False) -> int:
        """Runge-Kutta steps in an interval, so that each is short compared with the fastest motion.

        That is one of the vehicle, as its commands are held, and of the whole loop where they are not.
        """
        longest_step = min(SETTINGS.longest_step, SETTINGS.reach / self.fastest_rate(continuous))
        return max(int(np.ceil(dt / longest_step - 1e-9)), 1)

    def fastest_rate(self, continuous: bool) -> float:
        """Magnitude of the fastest eigenvalue of the vehicle, or of the loop without sampling, 1/s."""
        own = [np.linalg.eigvals(side[0]) for side in self._sides]
        rates = [self.continuous_rates(side) for side in (0, 1)] if continuous else own
        return max(
            float(np.abs(np.concatenate(rates)).max(initial=0.0)), SETTINGS.reach / SETTINGS.longest_step
        )


def _unstable_count(rates: np.ndarray) -> int:
    return int((rates.real > SETTINGS.neutral).sum())


def _jacobians(function: ca.Function, by: tuple[str, ...], of: str, point: tuple) -> list[np.ndarray]:
    """Derivatives of one output at a point; infinite ones (the root of a sign) count as zero."""
    symbols = [ca.SX.sym(n, function.size1_in(n)) for n in function.name_in()]
    output = function(*symbols)
    value = (output if isinstance(output, tuple) else (output,))[function.name_out().index(of)]
    wanted = [symbols[function.name_in().index(n)] for n in by]
    found = ca.Function("slopes", symbols, [ca.densify(ca.jacobian(value, v)) for v in wanted]).call(
        list(point)
    )
    return [np.nan_to_num(np.asarray(m), nan=0.0, posinf=0.0, neginf=0.0) for m in found]


# --- refusing ----------------------------------------------------------------------------------
def sampling_offsets(parts: Interconnection, dt: float) -> dict[str, float]:
    """Estimate of the distance from the set-point that a sampled jump may leave, m and rad, by coordinate."""
    gains = parts.controller.gains
    rows = gains.law.offset(gains.signals).xreplace(gains.numbers)
    names = gains.plant.vehicle.pose_names
    power = dt**gains.law.offset_order
    return {name: float(row) * power for name, row in zip(names, rows, strict=True) if row}


def check_interval(loop: SampledLoop, parts: Interconnection, dt: float, moves: dict[str, float]) -> None:
    """Refuse a sampling interval that is too long for the law."""
    name, order = parts.controller.gains.name, parts.controller.gains.law.offset_order
    if not loop.keeps_stability(dt):
        raise UndertowError(
            f"dt = {dt:g} s is too long for '{name}' on '{parts.vehicle.name}': the loop is stable in "
            f"continuous time but unstable with this sampling; the limit is {loop.longest_interval():.3g} s"
        )
    for coordinate, left in sampling_offsets(parts, dt).items():
        move = abs(moves[coordinate])
        if 0 < move <= left:
            raise UndertowError(
                f"dt = {dt:g} s is too long for '{name}': the sampled sign of its surface is estimated to "
                f"leave {left:.3g} in {coordinate} on a way of {move:.3g}; it must be below "
                f"{dt * (move / left) ** (1 / order):.3g} s"
            )


def check_steps(loop: SampledLoop, parts: Interconnection, dt: float, samples: int) -> None:
    """Refuse a loop that cannot be integrated without sampling."""
    if any(parts.functions.late()):
        raise UndertowError("dead times need a sampled law: leave out --continuous")
    steps = float(samples) * loop.substeps(dt, continuous=True)
    if steps > RUNS.most_samples:
        raise UndertowError(
            f"'{parts.controller.gains.name}' on '{parts.vehicle.name}' is as fast as "
            f"{loop.fastest_rate(continuous=True):.3g} 1/s: without sampling that takes {steps:.3g} steps, "
            f"but {RUNS.most_samples:.0e} is the limit; shorten the run, or leave out --continuous"
        )
