"""Hidden effects of weight, buoyancy and constant forces."""

from __future__ import annotations

import numpy as np

from .registry import SUBMERGED, TILTING, Draw, Values, hidden
from .world import Moment, World, skew


@hidden("net_buoyancy", SUBMERGED)
def net_buoyancy(world: World, draw: Draw) -> Values:
    """Force -B_net along z of NED (buoyancy minus weight, up), through the body origin."""
    b_net = draw.signed(0.01, 0.2) * world.vehicle.reach[2]
    world.gravity_wrench[:3] -= b_net * np.eye(3)
    return {"B_net": b_net}


@hidden("restoring", TILTING)
def restoring(world: World, draw: Draw) -> Values:
    """Moment (W r_G - B r_B) x k with W = B, z_G > z_B; the prior model has no righting moment at all."""
    weight, lever = world.vehicle.weight, draw.size(0.03, 0.1)
    r_b = world.vehicle.r_g - np.array([0.0, 0.0, lever])
    world.gravity_wrench[3:] -= weight * skew(r_b - world.vehicle.r_b)
    world.left_out.add("restoring")
    return {"W": weight, "B": weight, "z_g": float(world.vehicle.r_g[2]), "z_b": float(r_b[2])}


@hidden("trim_offset", TILTING)
def trim_offset(world: World, draw: Draw) -> Values:
    """The centre of buoyancy lies at r_B + (dx_B, dy_B, dz_B): moment -B dr x k."""
    shift = np.array([draw.signed(0.001, 0.02), draw.signed(0.001, 0.02), draw.signed(0.001, 0.01)])
    # Sized for the righting lever of the rov: others come to rest at like angles.
    shift *= min((world.vehicle.r_g - world.vehicle.r_b)[2] / 0.06, 1.0)
    world.gravity_wrench[3:] -= world.vehicle.weight * skew(shift)
    return dict(zip(("dx_B", "dy_B", "dz_B"), map(float, shift), strict=True))


@hidden("constant_force")
def constant_force(world: World, draw: Draw) -> Values:
    """tau_i = tau_0i in body axes, constant, in some degrees of freedom."""
    bias, values = np.zeros((6, 1)), {}
    for i in draw.some(world.dofs):
        bias[i] = draw.signed(0.02, 0.25) * _usual_force(world, i)
        values[f"{'XYZKMN'[i]}_0"] = float(bias[i, 0])
    world.wrenches.append(lambda now: bias)
    return values


def _usual_force(world: World, row: int) -> float:
    """What the thrusters give there, or the drag at the typical speed where there are none (N, N m)."""
    return float(world.vehicle.reach[row] or world.vehicle.drag_at_pace(row))


@hidden("hull_compressibility", SUBMERGED)
def hull_compressibility(world: World, draw: Draw) -> Values:
    """Buoyancy falls with depth: force kappa (z - z_0) along z of NED, z_0 the starting depth."""
    # The depth is unstable: deviations grow by a factor e in drag / kappa = 40 to 250 s.
    kappa = draw.size(0.004, 0.025) * world.vehicle.drag_at_pace(2) / world.vehicle.pace[2]
    start = world.vehicle.depth

    def wrench(now: Moment) -> np.ndarray:
        out = np.zeros_like(now.nu)
        out[:3] = kappa * (now.eta[2] - start) * now.turn[2]
        return out

    world.wrenches.append(wrench)
    return {"dB_dz": -kappa, "z_0": start}
