"""What makes real logs harder: disturbances, values of each run, and laws a little different."""

from __future__ import annotations

import numpy as np

from .drawing import Vehicle
from .plant import RATE
from .registry import ALL, SURGING, TURNING, Apply, Draw, Values, hidden
from .simulation import NOISE
from .water import add_wave
from .world import Moment, World

#: Runs for which values are drawn, whether or not there are so many.
MOST_RUNS = 8
#: Times the noise of the velocity sensors by which a disturbance changes the velocities in `WITHIN` seconds.
TIMES = (1, 3, 10)
WITHIN = 2.0
_SINES, _SLOWEST, _QUICKEST = 8, 0.005, 0.05  # number and frequencies of slow disturbances, Hz


def _accelerations(vehicle: Vehicle, times: float) -> np.ndarray:
    """(6, 1) acceleration that changes each velocity by so many times its noise in `WITHIN`."""
    own = np.isin(np.arange(6), vehicle.dofs)
    return (own * times * NOISE[6:] / WITHIN)[:, None]


def white(times: float) -> Apply:
    """Accelerations drawn anew every 1/20 s, so that velocities wander as they would by a steady one."""

    def apply(world: World, draw: Draw) -> Values:
        """White forces on the hull: velocities wander by a multiple of their sensors' noise in 2 s."""
        # So many independent steps as WITHIN has add up to their square root only.
        size = draw.strength * np.sqrt(RATE * WITHIN) * _accelerations(world.vehicle, times)
        seed, inertia = int(draw.rng.integers(2**31)), world.rigid_mass + world.added_mass

        def wrench(now: Moment) -> np.ndarray:
            step = int(now.t * RATE + 1e-6)
            drawn = np.random.default_rng([seed, step]).standard_normal((6, MOST_RUNS))
            return np.asarray(inertia @ (size * drawn[:, : now.nu.shape[1]]))

        world.wrenches.append(wrench)
        return {"times": times}

    return apply


def slow(times: float) -> Apply:
    """Accelerations of eight sines with phases of their own in every run."""

    def apply(world: World, draw: Draw) -> Values:
        """Slow forces on the hull: eight sines of 20 to 200 s, with other phases in each run."""
        size = draw.strength * _accelerations(world.vehicle, times) * np.sqrt(2.0 / _SINES)
        inertia = world.rigid_mass + world.added_mass
        turn = 2 * np.pi * np.exp(draw.rng.uniform(np.log(_SLOWEST), np.log(_QUICKEST), (_SINES, 6, 1)))
        phase = draw.rng.uniform(0, 2 * np.pi, (_SINES, 6, MOST_RUNS))

        def wrench(now: Moment) -> np.ndarray:
            waves = np.sin(turn * now.t + phase[:, :, : now.nu.shape[1]]).sum(axis=0)
            return np.asarray(inertia @ (size * waves))

        world.wrenches.append(wrench)
        return {"times": times}

    return apply


for _times in TIMES:
    hidden(f"white_force_{_times}", kind="disturbance")(white(_times))
    hidden(f"slow_force_{_times}", kind="disturbance")(slow(_times))


@hidden("ocean_current_per_run", SURGING, catalogue="ocean_current")
def ocean_current_per_run(world: World, draw: Draw) -> Values:
    """The water moves with V = (V_N, V_E, 0), another in every run: nu_r = nu - R^T V."""
    speed = draw.size(0.1, 0.9) * world.vehicle.pace[0] * draw.rng.uniform(0.5, 1.5, MOST_RUNS)
    towards = draw.rng.uniform(-np.pi, np.pi, MOST_RUNS)
    velocity = speed * np.stack([np.cos(towards), np.sin(towards), np.zeros(MOST_RUNS)])
    world.flows.append(lambda t, eta, moving: (velocity[:, : eta.shape[1]], np.zeros((3, 1))))
    return {"V_N": float(velocity[0, 0]), "V_E": float(velocity[1, 0])}


@hidden("waves_per_run", catalogue="waves")
def waves_per_run(world: World, draw: Draw) -> Values:
    """The same regular wave in all runs, with another phase in each."""
    return add_wave(world, draw, draw.rng.uniform(0, 2 * np.pi, MOST_RUNS))


@hidden("thrust_loss_straight", TURNING, catalogue="thrust_loss")
def thrust_loss_straight(world: World, draw: Draw) -> Values:
    """f_i = c_i - k sqrt(|c_i|) v_i, v_i = speed along the thrust without the share of the rotation."""
    made_for = world.vehicle.pace[world.vehicle.main]
    k = draw.size(0.1, 0.8) * np.sqrt(0.5 * world.vehicle.peak_command) / made_for
    ahead = np.concatenate([world.allocation[:3], np.zeros_like(world.allocation[3:])]).T
    world.inflow.append(lambda f, nu_r: f - k * np.sqrt(np.abs(f)) * (ahead @ nu_r))
    return {"k": k}


@hidden("no_added_mass", ALL, catalogue="added_mass")
def no_added_mass(world: World, draw: Draw) -> Values:
    """M_A nu_r_dot and C_A(nu_r) nu_r act on the hull; the prior model lacks both."""
    world.added_mass *= float(draw.strength > 0.0)
    world.left_out |= {"added_mass", "added_mass_coriolis"}
    return {}


@hidden("no_rigid_body_coriolis", TURNING, catalogue="rigid_body_coriolis")
def no_rigid_body_coriolis(world: World, draw: Draw) -> Values:
    """C_RB(nu) nu acts on the hull; the prior model lacks it."""
    world.rigid_coriolis = float(draw.strength > 0.0)
    world.left_out.add("rigid_body_coriolis")
    return {}
