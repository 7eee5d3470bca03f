"""A dive of the bundled BlueROV2 in a current that its file does not have, for the tests of field logs.

Simulated once in a session. Every test writes it with the library of its format and reads it back.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle

Array = NDArray[np.float64]

MISSING, CURRENT = "ocean_current", {"V_N": 0.25, "V_E": -0.15}
"""The effect that the vehicle file lacks, and its values, m/s."""
STEP, DURATION = 0.05, 60.0  # s
PWM_PER_NEWTON, PWM_AT_REST = 10.0, 1500.0
"""Commands are multiples of 0.1 N, so that a whole number of microseconds has them without rounding."""
FULL = 40.0  # N at the full output of a motor, +1
_POSE, _VELOCITY = ("x", "y", "z", "phi", "theta", "psi"), ("u", "v", "w", "p", "q", "r")
_NOISE = {"x": 0.01, "y": 0.01, "z": 0.005, **dict.fromkeys(("phi", "theta", "psi", "p", "q", "r"), 0.001)}
_VELOCITY_NOISE = 0.005  # m/s, of each component north, east, down


@dataclass(frozen=True, eq=False)
class Dive:
    """What the sensors of the dive reported, n samples.

    Attributes
    ----------
    t : (n,) array
        s, from zero in even steps.
    pose : (n, 6) array
        x, y, z (NED, m), roll, pitch, yaw (rad, yaw within half a turn).
    quaternion : (n, 4) array
        w, x, y, z of the rotation from FRD body axes to NED; the same attitude as in `pose`.
    velocity_ned : (n, 3) array
        Velocity over ground north, east, down, m/s.
    rates : (n, 3) array
        p, q, r, rad/s.
    thrust : (n, 8) array
        Commands f1 … f8 of the vehicle file, N, held until the next.
    """

    t: Array
    pose: Array
    quaternion: Array
    velocity_ned: Array
    rates: Array
    thrust: Array

    @property
    def pwm(self) -> Array:
        """Commands as servo pulses, microseconds, (n, 8): whole numbers."""
        return np.round(PWM_AT_REST + PWM_PER_NEWTON * self.thrust)

    @property
    def output(self) -> Array:
        """Commands as outputs of motors from -1 to 1, (n, 8)."""
        return self.thrust / FULL

    @property
    def velocity(self) -> Array:
        """Velocity over ground in body axes: u, v, w, m/s, (n, 3)."""
        return Rotation.from_quat(self.quaternion, scalar_first=True).apply(self.velocity_ned, inverse=True)

    @property
    def run(self) -> Run:
        """The dive as a run, as a reader should give it; yaw without jumps."""
        pose = np.unwrap(self.pose, axis=0)
        names = (*_POSE, *_VELOCITY, *self.vehicle.command_names)
        columns = np.hstack([pose, self.velocity, self.rates, self.thrust]).T
        return Run("dive", self.t, dict(zip(names, columns, strict=True)), sha256="dive")

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle as its file has it: without the current."""
        return load_vehicle("bluerov2")


@cache
def dive() -> Dive:
    """The dive; always the same."""
    vehicle, rng = load_vehicle("bluerov2"), np.random.default_rng(23)
    values = {name: Value(value) for name, value in CURRENT.items()}
    functions = Functions(vehicle.with_effect(catalogue()[MISSING], values))
    simulator, p = Simulator(functions, compiled=False), np.array(functions.values())
    t = STEP * np.arange(round(DURATION / STEP) + 1, dtype=float)
    aims = _aims(rng, t)
    allocation = np.linalg.pinv(np.array([thruster.wrench for thruster in vehicle.thrusters]).T)
    states, thrust = np.zeros((len(t), 12)), np.zeros((len(t), 8))
    states[0, 2] = 3.0  # m, below the surface
    for k in range(len(t) - 1):
        thrust[k] = np.round(np.clip(allocation @ _pilot(aims[k], states[k]), -FULL, FULL), 1)
        states[k + 1] = simulator.run(states[k], t[k : k + 2], thrust[[k, k]], p)[1]
    thrust[-1] = thrust[-2]
    return _sensed(t, states, thrust, rng)


def _aims(rng: np.random.Generator, t: Array) -> Array:
    """Forces ahead, to starboard and down, N, and roll, pitch and yaw to be steered for, rad, (n, 6)."""
    most = np.array([25.0, 25.0, 10.0, 0.25, 0.25, 1.5])
    steps = most * rng.uniform(-1.0, 1.0, (len(t) // 60 + 1, 6))
    return np.repeat(steps, 60, axis=0)[: len(t)]


def _pilot(aim: Array, state: Array) -> Array:
    """Forces and moments of an autopilot that steers for an attitude; it keeps off the surface."""
    off, rates = aim[3:] - state[3:6], state[9:12]
    moments = 4.0 * off - 1.5 * rates
    return np.array([aim[0], aim[1], aim[2] + 3.0 * (3.0 - state[2]), *moments])


def _sensed(t: Array, states: Array, thrust: Array, rng: np.random.Generator) -> Dive:
    noise = np.array([_NOISE.get(name, 0.0) for name in (*_POSE, *_VELOCITY)])
    seen = states + noise * rng.standard_normal(states.shape)
    attitude = Rotation.from_euler("ZYX", seen[:, [5, 4, 3]])
    over_ground = Rotation.from_euler("ZYX", states[:, [5, 4, 3]]).apply(states[:, 6:9])
    velocity_ned = over_ground + _VELOCITY_NOISE * rng.standard_normal(over_ground.shape)
    yaw = (seen[:, 5] + np.pi) % (2 * np.pi) - np.pi
    pose = np.column_stack([seen[:, :5], yaw])
    return Dive(t, pose, attitude.as_quat(scalar_first=True), velocity_ned, seen[:, 9:12], thrust)
