"""Process models of an observer: the vehicle's equations, or kinematics alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.codegen.manifest import Entry, numbers_of
from undertow.errors import UndertowError, refuse_unknown
from undertow.model.catalogue import catalogue
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags

Kind = Literal["model", "kinematics"]
CURRENT = ("V_N", "V_E")
BIASES = tuple(f"b_{name}" for name in VELOCITY)
_EFFECT_OF = dict.fromkeys(CURRENT, "ocean_current") | dict.fromkeys(BIASES, "sensor_bias")


@dataclass(frozen=True, eq=False)
class Process:
    """Rates and reports of an augmented state, symbolically.

    The state is x = (what moves, parameters that are estimated as random walks).
    """

    vehicle: Vehicle  # the model, with the effects that the estimated parameters belong to
    # "model": pose, velocity and the states of effects move as the vehicle's equations say, and white noise
    # drives the accelerations. "kinematics": pose, velocity and acceleration, and white noise drives the rate
    # of the acceleration; no force is in it, so that commands do not matter.
    kind: Kind
    # state_names, channels: entries of x; what sensors can report (pose and velocity)
    state_names: tuple[str, ...]
    channels: tuple[str, ...]
    driven: tuple[int, ...]  # entries of x whose rate white noise is added to
    # x, u, p, t: state, commands, parameters (entries that are estimated have no effect), time
    x: ca.SX
    u: ca.SX
    p: ca.SX
    t: ca.SX
    # rates, reports: dx/dt, shape (n,), and what sensors report, shape (m,)
    rates: ca.SX
    reports: ca.SX
    values: Array  # values of p in the vehicle
    late: Array  # (m,): age of each report, s
    dead_time: float  # delay between command and thrust, s
    numbers: tuple[Entry, ...] = ()  # entries of p, with their units
    ages: ca.SX = field(default_factory=lambda: ca.SX(0, 1))  # (m,): age of each report, s, from p

    @property
    def driven_names(self) -> tuple[str, ...]:
        """Names of the states whose rates white noise is added to."""
        return tuple(self.state_names[i] for i in self.driven)

    @property
    def angles(self) -> Flags:
        """Which channels are angles, the same again after a turn, shape (m,)."""
        return np.array([name in POSE[3:] for name in self.channels])

    @property
    def estimated(self) -> tuple[str, ...]:
        """Parameters among the states."""
        return tuple(n for n in self.state_names if n in self.vehicle.parameter_names)

    @cached_property
    def system(self) -> ca.Function:
        """`(x_dot, A, y, H) = system(x, u, p, t)`: rates, reports and their Jacobians in x."""
        outputs = [self.rates, ca.jacobian(self.rates, self.x), self.reports]
        outputs += [ca.jacobian(self.reports, self.x)]
        inputs, names = [self.x, self.u, self.p, self.t], ["x_dot", "A", "y", "H"]
        return ca.Function("system", inputs, ca.cse(outputs), ["x", "u", "p", "t"], names)

    def index(self, name: str) -> int:
        """Place of a state."""
        return self.state_names.index(name)


def process_of(
    vehicle: Vehicle, estimated: Sequence[str] = (), kind: Kind = "model", *, named: bool = False
) -> Process:
    """The process of a vehicle.

    `estimated` are parameters that become states: V_N, V_E (current, m/s), b_u ... b_r (biases of velocity
    sensors); they need not be in the vehicle. With `named` p holds the numbers of the hardware, too, as
    `Functions` says.
    """
    grown = _with_effects(vehicle, estimated, kind)
    f = Functions(grown, named=named and kind == "model")
    missing = [name for name in estimated if name not in f.parameter_names]
    if missing:
        raise UndertowError(
            f"'{missing[0]}' does not occur in the equations of '{vehicle.name}' "
            f"({', '.join(vehicle.degrees_of_freedom)}): leave it out"
        )
    theta = ca.vertcat(*[ca.SX.sym(name) for name in estimated])
    moving, rates, names, noisy = _moving(f, kind)
    at = [f.parameter_names.index(name) for name in estimated]
    own = ca.vertsplit(f.p)
    p = ca.vertcat(*[theta[at.index(i)] if i in at else own[i] for i in range(len(own))])
    exchanged = ca.substitute([rates, ca.SX(f.reported)], [f.p], [p]) if at else [rates, f.reported]
    if kind == "kinematics" and ca.depends_on(f.reported, ca.vertcat(f.memory, f.actuator_states, f.u)):
        raise UndertowError(
            f"reports of '{vehicle.name}' depend on its forces: estimate with the model (--process model)"
        )
    n, k, ages = moving.numel(), len(estimated), ca.densify(f.report_age)
    return Process(
        grown,
        kind,
        (*names, *estimated),
        (*grown.pose_names, *grown.velocity_names),
        (*noisy, *range(n, n + k)),
        ca.vertcat(moving, theta),
        f.u,
        f.numbers,
        f.t,
        ca.vertcat(exchanged[0], ca.SX.zeros(k, 1)),
        exchanged[1],
        np.array(f.values(), dtype=float),
        np.asarray(ca.Function("late", [f.numbers], [ages])(f.values()), dtype=float).ravel(),
        float(f.dead_time(f.values())),
        numbers_of(f),
        ages,
    )


def _with_effects(vehicle: Vehicle, estimated: Sequence[str], kind: Kind) -> Vehicle:
    """The vehicle with the effects that the parameters belong to."""
    refuse_unknown(estimated, _EFFECT_OF, "", " cannot be estimated as a state", "these can:")
    for name in estimated:
        if name in vehicle.inputs:
            raise UndertowError(f"'{name}' is an input that logs of '{vehicle.name}' hold: leave it out")
        if name in CURRENT and kind == "kinematics":
            raise UndertowError(
                "a current does not show in kinematics over ground: estimate it with the model "
                "(--process model)"
            )
    for effect in dict.fromkeys(_EFFECT_OF[name] for name in estimated):
        vehicle = vehicle.with_effect(catalogue()[effect], {})
    return vehicle


def _moving(f: Functions, kind: Kind) -> tuple[ca.SX, ca.SX, tuple[str, ...], tuple[int, ...]]:
    """What moves, its rates, names, and the entries that noise drives."""
    n, vehicle = f.nu.numel(), f.vehicle
    if kind == "model":
        rows = f.acceleration_rows
        return f.x, f.x_dot, f.state_names, tuple(range(rows.start, rows.stop))
    a = ca.SX.sym("a", n)
    names = (*vehicle.pose_names, *vehicle.velocity_names, *(f"{v}_dot" for v in vehicle.velocity_names))
    return (
        ca.vertcat(f.eta, f.nu, a),
        ca.vertcat(f.pose_rate, a, ca.SX.zeros(n, 1)),
        names,
        tuple(range(2 * n, 3 * n)),
    )


@dataclass(frozen=True)
class Prior:
    """Standard deviations before the first report, around what it says or zero."""

    # position, angle, velocity, rate, acceleration, current, bias, effect_state: m, rad, m/s, rad/s, m/s^2
    # and rad/s^2, m/s, m/s and rad/s, and the own unit of a lag or fluid memory
    position: float = 100.0
    angle: float = 3.0
    velocity: float = 3.0
    rate: float = 1.0
    acceleration: float = 1.0
    current: float = 1.0
    bias: float = 0.3
    effect_state: float = 1.0

    def covariance(self, process: Process) -> Array:
        """Of the state of a process, shape (nx, nx)."""
        return np.diag([self._of(name) ** 2 for name in process.state_names])

    def _of(self, name: str) -> float:
        kinds = (
            (POSE[:3], self.position),
            (POSE[3:], self.angle),
            (VELOCITY[:3], self.velocity),
            (VELOCITY[3:], self.rate),
            (CURRENT, self.current),
            (BIASES, self.bias),
            (tuple(f"{v}_dot" for v in VELOCITY), self.acceleration),
        )
        return next((size for names, size in kinds if name in names), self.effect_state)


UNKNOWN = Prior()
"""Far beyond what vehicles do, so that reports decide: for logs."""
AT_REST = Prior(velocity=0.05, rate=0.05, acceleration=0.05, current=0.3, bias=0.05, effect_state=0.1)
"""A vehicle that is switched on where it lies: for filters on board."""


@dataclass(frozen=True)
class StepSettings:
    """How long a step of a filter may be."""

    longest: float = 0.25  # s
    reach: float = 0.5  # of the fastest time constant of the vehicle at rest
    # The same for filters that step once a sample: one of Runge-Kutta of fourth order grows from 2.78 on.
    stable: float = 2.5


STEP = StepSettings()


def longest_step(process: Process) -> float:
    """Longest step of a filter, s: short beside the fastest motion at rest."""
    return min(STEP.longest, STEP.reach / max(_fastest(process), STEP.reach / STEP.longest))


def require_stable_step(process: Process, dt: float) -> None:
    """Refuse a sampling interval over which a prediction in one step grows by itself."""
    fastest = _fastest(process)
    if dt * fastest > STEP.stable:
        raise UndertowError(
            f"dt = {dt:g} s is too long for the observer of '{process.vehicle.name}', which predicts in one "
            f"step and has a time constant of {1 / fastest:.3g} s: stay below {STEP.stable / fastest:.3g} s, "
            "or leave what is as fast (a lag of thrusters, say) out of the vehicle that it knows"
        )


def _fastest(process: Process) -> float:
    """Magnitude of the fastest eigenvalue at rest, 1/s."""
    zero = np.zeros(process.x.numel())
    slopes = process.system(zero, np.zeros(process.u.numel()), process.values, 0.0)[1]
    return float(np.abs(np.linalg.eigvals(np.nan_to_num(np.asarray(slopes)))).max(initial=0.0))
