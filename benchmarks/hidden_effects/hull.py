"""Hidden effects of the hull: inertia and damping."""

from __future__ import annotations

import numpy as np

from .registry import COUPLED, TURNING, Draw, Values, hidden
from .world import Moment, World, derivative, quadratic_name, rigid_mass


def _coupled_pairs(world: World, draw: Draw) -> list[tuple[int, int]]:
    """A random part of the couplings that the vehicle can have."""
    options = world.vehicle.couplings
    return [options[i] for i in draw.some(range(len(options)))]


@hidden("added_mass_coupling", COUPLED)
def added_mass_coupling(world: World, draw: Draw) -> Values:
    """M_A[i, j] = M_A[j, i] = f sqrt(M_A[i, i] M_A[j, j]), e.g. Y_rdot = -M_A[1, 5]; Coriolis included."""
    values = {}
    for i, j in _coupled_pairs(world, draw):
        share = draw.signed(0.25, 0.7, 0.8)
        world.added_mass[i, j] = world.added_mass[j, i] = share * np.sqrt(
            world.added_mass[i, i] * world.added_mass[j, j]
        )
        values[derivative(i, j, mark="dot")] = -float(world.added_mass[i, j])
    return values


@hidden("added_mass_coriolis", TURNING)
def added_mass_coriolis(world: World, draw: Draw) -> Values:
    """C_A(nu_r) nu_r (with the Munk moment) acts on the hull; the prior model lacks it.

    Nothing is drawn, and no strength but zero changes it: it follows from the added mass.
    """
    world.added_coriolis = float(draw.strength > 0.0)
    world.left_out.add("added_mass_coriolis")
    return {}


@hidden("entrained_water")
def entrained_water(world: World, draw: Draw) -> Values:
    """M_RB (and C_RB) gains neutrally buoyant water: mass m_w at x_w, I_w = m_w (x_w^2 + (0.12 m)^2)."""
    mass, x_w = draw.size(0.1, 0.8) * world.vehicle.mass, draw.shape(-0.1, 0.1)
    gyration = 0.12
    inertia = mass * (x_w**2 * np.array([0.0, 1.0, 1.0]) + gyration**2)
    world.rigid_mass += rigid_mass(mass, inertia, np.array([x_w, 0.0, 0.0]))
    return {"m_w": mass, "x_w": x_w, "I_z_w": float(inertia[2])}


@hidden("linear_damping_coupling", COUPLED)
def linear_damping_coupling(world: World, draw: Draw) -> Values:
    """tau_i = D_ij nu_r_j, tau_j = D_ji nu_r_i (N_v, Y_r, ...), |D_ij| <= 0.7 sqrt(D_ii D_jj)."""
    values, pace = {}, world.vehicle.pace
    for i, j in _coupled_pairs(world, draw):
        bound = np.sqrt(world.vehicle.drag_at_pace(i) / pace[i] * world.vehicle.drag_at_pace(j) / pace[j])
        bound = min(bound, np.sqrt(world.linear[i, i] * world.linear[j, j]))
        for row, column in ((i, j), (j, i)):
            world.linear[row, column] = draw.signed(0.2, 0.7, 0.8) * bound
            values[derivative(row, column)] = float(world.linear[row, column])
    return values


@hidden("quadratic_damping")
def quadratic_damping(world: World, draw: Draw) -> Values:
    """tau_i = Q_i |nu_r_i| nu_r_i in some degrees of freedom for which the prior model has none."""
    values = {}
    for i in draw.some(_quadratic_rows(world)):
        if world.quadratic[i, i]:
            world.quadratic[i, i] *= draw.size(0.4, 2.0)
            world.left_out.add(quadratic_name(i))
        else:
            world.quadratic[i, i] = world.linear[i, i] / world.vehicle.pace[i] * draw.size(0.2, 2.0)
        values[quadratic_name(i)] = float(world.quadratic[i, i])
    return values


def _quadratic_rows(world: World) -> list[int]:
    """Rows that may lack quadratic drag: those without any if there are such, else all."""
    bare = [i for i in world.dofs if not world.quadratic[i, i]]
    return bare or list(world.dofs)


@hidden("cubic_damping")
def cubic_damping(world: World, draw: Draw) -> Values:
    """tau_i = K_i nu_r_i^3, which at the typical speed is 0.1 to 1.5 times the other drag."""
    values = {}
    for i in draw.some(world.dofs):
        world.cubic[i, i] = -draw.size(0.1, 1.5) * world.vehicle.drag_at_pace(i) / world.vehicle.pace[i] ** 3
        values[derivative(i, i, i, i)] = float(world.cubic[i, i])
    return values


@hidden("lift", TURNING)
def lift(world: World, draw: Draw) -> Values:
    """Y = (Y_uv v + Y_ur r) u, N = (N_uv v + N_ur r) u, nu_r; with pitch also Z_uw, Z_uq, M_uw, M_uq."""
    values, pace = {}, world.vehicle.pace
    planes = [(1, 5)] + ([(2, 4)] if 4 in world.dofs else [])
    for across, turn in planes:
        for row in (across, turn):
            for column in (across, turn):
                # As a share of the row's own drag, so that backward motion (u < 0) stays stable.
                size = draw.size(0.1, 0.7) * world.vehicle.drag_at_pace(row) / (pace[0] * pace[column])
                sign = -1.0 if row == column else draw.rng.choice([-1.0, 1.0])
                world.products[row, 0, column] = sign * size
                values[derivative(row, 0, column)] = float(sign * size)
    return values


@hidden("drag_asymmetry")
def drag_asymmetry(world: World, draw: Draw) -> Values:
    """Drag (linear + quadratic) is (1 + a_i) times as large for nu_r_i < 0, in surge, sway or heave."""
    row = world.vehicle.main
    if draw.shape(0, 1) >= 0.7:
        row = draw.pick([i for i in (0, 1, 2) if i in world.dofs])
    excess = draw.size(0.15, 1.2) if draw.shape(0, 1) < 0.7 else -draw.size(0.1, 0.5, 0.7)
    linear, quadratic = excess * world.linear[row, row], excess * world.quadratic[row, row]

    def wrench(now: Moment) -> np.ndarray:
        back = np.minimum(now.nu_r[row], 0.0)
        out = np.zeros_like(now.nu)
        out[row] = linear * back - quadratic * back**2
        return out

    world.wrenches.append(wrench)
    return {f"backward_over_forward_{'XYZKMN'[row]}": 1.0 + excess}


@hidden("dry_friction")
def dry_friction(world: World, draw: Draw) -> Values:
    """tau_i = F_i sgn(nu_i), F_i < 0, over ground; in fact F_i tanh(nu_i / e), e = 0.005 m/s, 0.01 rad/s."""
    friction, values = np.zeros((6, 1)), {}
    for i in draw.some([i for i in world.dofs if world.vehicle.reach[i] > 0]):
        friction[i] = -draw.size(0.03, 0.25) * world.vehicle.reach[i]
        values[f"{derivative(i, i)[:2]}sign{derivative(i, i)[2:]}"] = float(friction[i, 0])
    edge = np.array([0.005, 0.005, 0.005, 0.01, 0.01, 0.01])[:, None]
    world.wrenches.append(lambda now: friction * np.tanh(now.nu / edge))
    return values


@hidden("crossflow_drag", TURNING)
def crossflow_drag(world: World, draw: Draw) -> Values:
    """Y = -c int |v + x r| (v + x r) dx, N = -c int x |v + x r| (v + x r) dx over x_0 -+ L/2.

    c = rho T C_d / 2 in N s^2/m^3; velocities relative to the water.
    """
    length, centre = world.vehicle.length, draw.shape(-0.15, 0.15)
    pace, row = world.vehicle.pace, 1
    per_metre = draw.size(0.1, 2.0) * world.vehicle.drag_at_pace(row) / (length * pace[row] ** 2)
    nodes, weights = np.polynomial.legendre.leggauss(10)
    x = (centre + nodes / 2) * length
    shares = -per_metre * length / 2 * np.stack([weights, weights * x])

    def wrench(now: Moment) -> np.ndarray:
        speed = now.nu_r[1] + x[:, None] * now.nu_r[5]
        out = np.zeros_like(now.nu)
        out[[1, 5]] = shares @ (np.abs(speed) * speed)
        return out

    world.wrenches.append(wrench)
    return {"c": per_metre, "L": length, "x_0": centre * length}
