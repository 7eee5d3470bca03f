"""Hidden effects between the state and its reading, (12, R): x y z phi theta psi u v w p q r."""

from __future__ import annotations

import numpy as np

from .actuation import _in_steps
from .plant import rotation
from .registry import SURGING, TURNING, Draw, Values, hidden, those, with_motions
from .world import World, to_body, to_ned, velocity_at


def _own_speeds(world: World) -> list[int]:
    """Indices among u, v, w that the vehicle has."""
    return [i for i in (0, 1, 2) if i in world.dofs]


@hidden("velocity_lever_arm", those(lambda vehicle: max(vehicle.dofs) > 2))
def velocity_lever_arm(world: World, draw: Draw) -> Values:
    """The velocity sensor sits at r_s: it reads v + omega x r_s."""
    arm = np.array([draw.signed(0.03, 0.4), draw.signed(0.02, 0.2), draw.signed(0.02, 0.2)])
    if not world.vehicle.tilts:
        arm[2] = 0.0  # without roll and pitch a height difference shows nowhere
    rows = _own_speeds(world)

    def read(reading: np.ndarray) -> np.ndarray:
        out = reading.copy()
        out[[6 + i for i in rows]] = velocity_at(arm, reading[6:])[rows]
        return out

    world.sensors.append(read)
    return dict(zip(("x_s", "y_s", "z_s"), map(float, arm), strict=True))


@hidden("velocity_misalignment", with_motions(0, 1))
def velocity_misalignment(world: World, draw: Draw) -> Values:
    """The velocity sensor is turned by alpha about z: it reads (c u + s v, -s u + c v, w)."""
    alpha = draw.signed(0.03, 0.35, 0.6)
    c, s = np.cos(alpha), np.sin(alpha)

    def read(reading: np.ndarray) -> np.ndarray:
        out = reading.copy()
        out[6], out[7] = c * reading[6] + s * reading[7], c * reading[7] - s * reading[6]
        return out

    world.sensors.append(read)
    return {"alpha": alpha}


@hidden("sensor_bias")
def sensor_bias(world: World, draw: Draw) -> Values:
    """u, v, w and r read too much by a constant each (m/s, rad/s)."""
    bias, values = np.zeros((12, 1)), {}
    for i in draw.some([i for i in world.dofs if i in (0, 1, 2, 5)]):
        bias[6 + i] = draw.signed(0.05, 0.4) * world.vehicle.pace[i] * (0.3 if i == 5 else 1.0)
        values["b_" + "uvwpqr"[i]] = float(bias[6 + i, 0])
    world.sensors.append(lambda reading: reading + bias)
    return values


@hidden("sensor_scale")
def sensor_scale(world: World, draw: Draw) -> Values:
    """u, v, w are read (1 + s) times too large, e.g. for a wrong speed of sound."""
    error = draw.signed(0.03, 0.35, 0.5)
    factor = np.ones((12, 1))
    factor[[6 + i for i in _own_speeds(world)]] += error
    world.sensors.append(lambda reading: reading * factor)
    return {"s": error}


@hidden("sensor_delay")
def sensor_delay(world: World, draw: Draw) -> Values:
    """u, v, w are those of `delay` seconds ago (a whole number of 1/80 s); pose and gyro are not late."""
    world.velocity_delay = _in_steps(draw.size(0.08, 1.0, 1.5))
    return {"delay": world.velocity_delay}


@hidden("attitude_bias", with_motions(5))
def attitude_bias(world: World, draw: Draw) -> Values:
    """psi reads too much by a constant; where the vehicle tilts, phi and theta by smaller ones."""
    bias, values = np.zeros((12, 1)), {}
    for i, name, low, high in (
        (5, "b_psi", 0.03, 0.3),
        (3, "b_phi", 0.005, 0.05),
        (4, "b_theta", 0.005, 0.05),
    ):
        if i in world.dofs:
            bias[i] = draw.signed(low, high, 2 * high)
            values[name] = float(bias[i, 0])
    world.sensors.append(lambda reading: reading + bias)
    return values


@hidden("position_lever_arm", TURNING)
def position_lever_arm(world: World, draw: Draw) -> Values:
    """x, y (and z) are those of an antenna at r_f: it reads p + R r_f."""
    arm = np.array([draw.signed(0.05, 0.6), draw.signed(0.03, 0.3), draw.signed(0.03, 0.3)])
    if not world.vehicle.tilts:
        arm[2] = 0.0  # without roll and pitch a height difference shows nowhere
    rows = [i for i in (0, 1, 2) if i in world.dofs]

    def read(reading: np.ndarray) -> np.ndarray:
        out = reading.copy()
        held = np.broadcast_to(arm[:, None], reading[:3].shape)
        out[rows] += to_ned(rotation(reading[3:6]), held)[rows]
        return out

    world.sensors.append(read)
    return dict(zip(("x_fix", "y_fix", "z_fix"), map(float, arm), strict=True))


@hidden("water_speed_log", SURGING)
def water_speed_log(world: World, draw: Draw) -> Values:
    """The water moves with V = (V_N, V_E, 0), and u, v, w are read relative to it: v - R^T V."""
    speed, towards = draw.size(0.1, 0.9) * world.vehicle.pace[0], draw.shape(-np.pi, np.pi)
    water = speed * np.array([[np.cos(towards)], [np.sin(towards)], [0.0]])
    rows = _own_speeds(world)

    def read(reading: np.ndarray) -> np.ndarray:
        out = reading.copy()
        out[[6 + i for i in rows]] -= to_body(rotation(reading[3:6]), water)[rows]
        return out

    world.flows.append(lambda t, eta, over_ground: (water, np.zeros((3, 1))))
    world.sensors.append(read)
    return {"V_N_log": float(water[0, 0]), "V_E_log": float(water[1, 0])}
