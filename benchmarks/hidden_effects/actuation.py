"""Hidden effects between a command and the force it makes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .drawing import Vehicle
from .registry import TURNING, Draw, Values, hidden, those
from .world import Moment, World


def _in_steps(delay: float) -> float:
    """The delay as a whole number of simulation steps (1/80 s), so that command edges fall between steps."""
    return round(delay * 80) / 80


@hidden("thruster_gain")
def thruster_gain(world: World, draw: Draw) -> Values:
    """f_i = (1 + e) c_i for one thruster, e from -0.6 to 0.3."""
    which = draw.pick(range(world.allocation.shape[1]))
    error = -draw.size(0.05, 0.6, 0.9) if draw.shape(0, 1) < 0.75 else draw.size(0.05, 0.3, 0.6)
    gain = np.ones((world.allocation.shape[1], 1))
    gain[which] += error
    world.stages.append(lambda f, t: gain * f)
    return {f"gain_error_{world.vehicle.thrusters[which]}": error}


@hidden("thruster_deadband")
def thruster_deadband(world: World, draw: Draw) -> Values:
    """f = 0 for |c| <= w, else c - w sgn(c): continuous; the same for all thrusters."""
    width = draw.size(0.02, 0.25, 0.5) * world.vehicle.peak_command
    world.stages.append(lambda f, t: f - np.clip(f, -width, width))
    return {"width": width}


@hidden("thruster_deadband_jump", catalogue="thruster_deadband")
def thruster_deadband_jump(world: World, draw: Draw) -> Values:
    """f = 0 for |c| <= w, else c: jumps by w at the edge; the same for all thrusters."""
    width = draw.size(0.05, 0.35, 0.5) * world.vehicle.peak_command
    world.stages.append(lambda f, t: np.where(np.abs(f) > width, f, 0.0))
    return {"width": width}


@hidden("thruster_saturation")
def thruster_saturation(world: World, draw: Draw) -> Values:
    """f = clip(c, -L, L), L below the largest command."""
    limit = world.vehicle.peak_command / (1.0 + draw.size(0.4, 4.0, 5.0))
    world.stages.append(lambda f, t: np.clip(f, -limit, limit))
    return {"limit": limit}


@hidden("thruster_curve")
def thruster_curve(world: World, draw: Draw) -> Values:
    """f = (1 - a) c + a c |c| / c_peak: the propeller law shows through; the same for all thrusters."""
    bend, peak = draw.size(0.1, 0.9, 0.95), world.vehicle.peak_command
    world.stages.append(lambda f, t: f * (1.0 - bend + bend * np.abs(f) / peak))
    return {"a": bend, "c_peak": peak}


@hidden("thruster_asymmetry")
def thruster_asymmetry(world: World, draw: Draw) -> Values:
    """f = (1 - b) c for c < 0, else c: reverse thrust is weaker; the same for all thrusters."""
    loss = draw.size(0.05, 0.6, 0.8)
    world.stages.append(lambda f, t: f - loss * np.minimum(f, 0.0))
    return {"reverse_over_forward": 1.0 - loss}


@hidden("supply_droop")
def supply_droop(world: World, draw: Draw) -> Values:
    """f = (1 - d t) c: all thrusters fade, by 5 to 50% in 100 s, each run starting fresh."""
    rate = draw.size(0.05, 0.5, 0.8) / 100.0
    world.stages.append(lambda f, t: f * (1.0 - rate * t))
    return {"rate": rate}


@hidden("thruster_lag")
def thruster_lag(world: World, draw: Draw) -> Values:
    """T df/dt = c - f for every thruster, after the static stages."""
    # Below one tenth of an RK4 step the lag is no lag: the simulation would only become stiff.
    time = draw.size(0.08, 1.2, 2.0)
    world.lag = time if time > 1e-3 else 0.0
    return {"T": world.lag}


@hidden("actuation_delay")
def actuation_delay(world: World, draw: Draw) -> Values:
    """f(t) = c(t - delay); a whole number of 1/80 s; before the first command has arrived f = 0."""
    world.command_delay = _in_steps(draw.size(0.05, 0.8, 1.5))
    return {"delay": world.command_delay}


@hidden("thrust_loss")
def thrust_loss(world: World, draw: Draw) -> Values:
    """f_i = c_i - k sqrt(|c_i|) v_i, v_i = speed of the thruster through the water along its own thrust."""
    pushing = np.linalg.norm(world.allocation[:3], axis=0) > 0
    made_for = world.vehicle.pace[world.vehicle.main]
    k = draw.size(0.1, 0.8) * np.sqrt(0.5 * world.vehicle.peak_command) / made_for
    share = k * pushing[:, None]
    # A thruster's column of the allocation, [d; r x d], gives its speed too (principle of virtual power).
    inward = world.allocation.T.copy()
    world.inflow.append(_loss(share, inward))
    return {"k": k}


def _loss(share: np.ndarray, inward: np.ndarray) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    return lambda f, nu_r: f - share * np.sqrt(np.abs(f)) * (inward @ nu_r)


def _feels_torque(vehicle: Vehicle) -> bool:
    """Whether every thruster has an axis, and some axis lies along a rotation of the vehicle."""
    axes, turns = vehicle.allocation[:3], [i - 3 for i in vehicle.dofs if i > 2]
    return bool(np.all(np.any(axes, axis=0)) and np.any(axes[turns]))


@hidden("reaction_torque", those(_feels_torque))
def reaction_torque(world: World, draw: Draw) -> Values:
    """Each thruster also gives the moment d f_i along its own axis (all propellers turn the same way)."""
    lever = draw.signed(0.003, 0.05)
    axes = world.allocation[:3] / np.linalg.norm(world.allocation[:3], axis=0)
    world.allocation[3:] += lever * axes
    return {"d": lever}


@hidden("propeller_walk", TURNING)
def propeller_walk(world: World, draw: Draw) -> Values:
    """Y = a F + b min(F, 0), N = c F + d min(F, 0), F = thrust along the hull (single screw going astern)."""
    pushing, length = world.allocation[0].copy(), world.vehicle.length
    side, astern = draw.signed(0.03, 0.3), draw.signed(0.03, 0.3)
    turn, turn_astern = (draw.signed(0.01, 0.1) * length for _ in range(2))

    def wrench(now: Moment) -> np.ndarray:
        along = pushing @ now.thrust
        out = np.zeros_like(now.nu)
        out[1] = side * along + astern * np.minimum(along, 0.0)
        out[5] = turn * along + turn_astern * np.minimum(along, 0.0)
        return out

    world.wrenches.append(wrench)
    names = ("Y_walk", "Y_walk_back", "N_walk", "N_walk_back")
    return dict(zip(names, (side, astern, turn, turn_astern), strict=True))


def _across(vehicle: Vehicle) -> list[int]:
    """Actuators that push across the hull, as a rudder or a stern plane."""
    return [i for i, ahead in enumerate(vehicle.allocation[0]) if abs(ahead) < 1e-9]


@hidden("rudder_force", those(lambda vehicle: 0 in vehicle.dofs and bool(_across(vehicle))))
def rudder_force(world: World, draw: Draw) -> Values:
    """F_i = c |u_r| u_r f_i along the column of one actuator: what it gives grows with the speed ahead."""
    which = draw.pick(_across(world.vehicle))
    gain = draw.size(0.1, 1.0) / world.vehicle.pace[0] ** 2
    column = world.allocation[:, [which]].copy()

    def wrench(now: Moment) -> np.ndarray:
        return gain * np.abs(now.nu_r[0]) * now.nu_r[0] * now.thrust[which] * column

    world.wrenches.append(wrench)
    return {f"rudder_{world.vehicle.thrusters[which]}": gain}
