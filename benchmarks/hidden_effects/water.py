"""Hidden effects of the water around the hull and of a tether."""

from __future__ import annotations

import numpy as np

from .drawing import GRAVITY
from .registry import ALL, SUBMERGED, SURGING, Draw, Values, hidden, those
from .world import Memory, Moment, World, force_at, to_body, to_ned, velocity_at


@hidden("ocean_current", SURGING)
def ocean_current(world: World, draw: Draw) -> Values:
    """The water moves with V = (V_N, V_E, 0): nu_r = nu - R^T V, nu_r_dot = nu_dot + omega x R^T V."""
    speed, towards = draw.size(0.1, 0.9) * world.vehicle.pace[0], draw.shape(-np.pi, np.pi)
    velocity = speed * np.array([[np.cos(towards)], [np.sin(towards)], [0.0]])
    world.flows.append(lambda t, eta, over_ground: (velocity, np.zeros((3, 1))))
    return {"V_N": float(velocity[0, 0]), "V_E": float(velocity[1, 0])}


@hidden("waves")
def waves(world: World, draw: Draw) -> Values:
    """Regular deep-water wave: orbital velocity a w exp(-k z) (cos p along, -sin p down), p = k s - w t.

    w^2 = g k; s = position of the vehicle along the wave. The wave's pressure acts on the displaced mass
    (Froude-Krylov force rho V Du/Dt), so that a neutrally buoyant hull is carried along.
    """
    return add_wave(world, draw, np.zeros(1))


def add_wave(world: World, draw: Draw, shifts: np.ndarray) -> Values:
    """A wave whose phase is shifted by an angle of its own in each run (or the same in all)."""
    period, towards = draw.shape(4.0, 7.0), draw.shape(-np.pi, np.pi)
    omega = 2 * np.pi / period
    k = omega**2 / GRAVITY
    orbital = draw.size(0.08, 0.8) * world.vehicle.pace[world.vehicle.main]
    amplitude = orbital / omega * np.exp(k * world.vehicle.depth)
    along = np.array([[np.cos(towards)], [np.sin(towards)], [0.0]])
    down = np.array([[0.0], [0.0], [1.0]])

    def flow(t: float, eta: np.ndarray, moving: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phase = k * (eta[0] * along[0] + eta[1] * along[1]) - omega * t + shifts[: eta.shape[1]]
        speed = amplitude * omega * np.exp(-k * np.maximum(eta[2], 0.0))
        cosine, sine = speed * np.cos(phase), speed * np.sin(phase)
        turning = k * (moving[0] * along[0] + moving[1] * along[1]) - omega
        fading = -k * moving[2]
        velocity = along * cosine - down * sine
        return velocity, along * (fading * cosine - turning * sine) - down * (
            fading * sine + turning * cosine
        )

    def pressure(now: Moment) -> np.ndarray:
        # Du/Dt follows the water, not the hull; the hull is small against the wave.
        water = flow(now.t, now.eta, now.nu[:3])[0]
        here = flow(now.t, now.eta, water)[1]
        out = np.zeros_like(now.nu)
        out[:3] = world.vehicle.mass * to_body(now.turn, here)
        return out

    world.flows.append(flow)
    world.wrenches.append(pressure)
    return {"amplitude": amplitude, "period": period, "direction": towards}


@hidden("boundary_proximity", tuple(v for v in ALL if v != "box"))
def boundary_proximity(world: World, draw: Draw) -> Values:
    """Damping times 1 + a exp(-h / L), h = distance to the bottom z = z_w (ships: to the wall y = y_w)."""
    excess, length = draw.size(0.3, 4.0), draw.shape(0.5, 1.5)
    axis = 2 if 2 in world.dofs else 1
    place = world.vehicle.depth + draw.shape(0.5, 2.0)

    def wrench(now: Moment) -> np.ndarray:
        gap = np.maximum(place - now.eta[axis], 0.0)
        return excess * np.exp(-gap / length) * now.drag

    world.wrenches.append(wrench)
    return {"a": excess, "L": length, "zy"[axis == 1] + "_w": place}


@hidden("tether_drag", SUBMERGED)
def tether_drag(world: World, draw: Draw) -> Values:
    """Force -(c_0 + c l) |v_a| v_a at point r_a, v_a = its velocity in the water, l = distance to (0, 0, 0).

    Part of the tether is out wherever the vehicle goes: none of it, all of it, or anything between.
    """
    point, depth, main = world.vehicle.tether, world.vehicle.depth, world.vehicle.main
    at_depth = draw.size(0.05, 1.5) * world.vehicle.drag_at_pace(main) / world.vehicle.pace[main] ** 2
    out = at_depth * float(np.clip(draw.shape(-0.5, 1.5), 0.0, 1.0))
    per_metre = (at_depth - out) / depth

    def wrench(now: Moment) -> np.ndarray:
        speed = velocity_at(point, now.nu_r)
        length = np.sqrt(np.sum(now.eta[:3] ** 2, axis=0))
        return force_at(point, -(out + per_metre * length) * np.sqrt(np.sum(speed**2, axis=0)) * speed)

    world.wrenches.append(wrench)
    return {"c": per_metre, "c_0": out, **dict(zip(("x_a", "y_a", "z_a"), map(float, point), strict=True))}


@hidden("tether_tension", SUBMERGED)
def tether_tension(world: World, draw: Draw) -> Values:
    """Force k max(0, d - L_0) at body point r_a towards a winch at (0, 0, z_0 - 2 m) of NED; d = distance."""
    point, stiffness = world.vehicle.tether, draw.size(0.02, 0.3) * world.vehicle.reach[world.vehicle.main]
    slack = draw.shape(2.1, 3.0)
    winch = np.array([[0.0], [0.0], [world.vehicle.depth - 2.0]])

    def wrench(now: Moment) -> np.ndarray:
        reach = now.eta[:3] + to_ned(now.turn, np.broadcast_to(point[:, None], now.nu[:3].shape)) - winch
        distance = np.sqrt(np.sum(reach**2, axis=0))
        pull = stiffness * np.maximum(distance - slack, 0.0) / np.maximum(distance, 1e-9)
        return force_at(point, to_body(now.turn, -pull * reach))

    world.wrenches.append(wrench)
    return {
        "k": stiffness,
        "L_0": slack,
        "winch_z": float(winch[2, 0]),
        **dict(zip(("x_a", "y_a", "z_a"), map(float, point), strict=True)),
    }


@hidden("radiation_memory")
def radiation_memory(world: World, draw: Draw) -> Values:
    """tau_i = X_m,i s_i, T_m ds_i/dt = nu_r_i - s_i: drag that lags the motion (steady value X_m nu_r)."""
    rows = np.array(draw.some(world.dofs))
    drag = np.array([world.vehicle.drag_at_pace(i) / world.vehicle.pace[i] for i in rows])
    gains = -drag * np.array([draw.size(0.3, 2.0) for _ in rows])
    time = draw.shape(0.5, 4.0)

    def wrench(now: Moment, state: np.ndarray) -> np.ndarray:
        out = np.zeros_like(now.nu)
        out[rows] = gains[:, None] * state
        return out

    world.memories.append(Memory(len(rows), lambda now, state: (now.nu_r[rows] - state) / time, wrench))
    return {"T_m": time, **{f"{'XYZKMN'[i]}_m": float(g) for i, g in zip(rows, gains, strict=True)}}


@hidden("wind", those(lambda v: 2 not in v.dofs and 5 in v.dofs))
def wind(world: World, draw: Draw) -> Values:
    """F = R^T (W_N, W_E, 0), X = F_x, Y = a F_y, at (x_w, 0, z_w): a steady wind above the water."""
    force, towards = draw.size(0.15, 1.5) * world.vehicle.drag_at_pace(0), draw.shape(-np.pi, np.pi)
    blow = force * np.array([[np.cos(towards)], [np.sin(towards)], [0.0]])
    aspect = draw.shape(1.0, 4.0)
    x_w, z_w = draw.shape(-0.2, 0.2) * world.vehicle.length, -draw.shape(0.02, 0.1) * world.vehicle.length

    def wrench(now: Moment) -> np.ndarray:
        ahead, across, _ = to_body(now.turn, blow)
        out = np.zeros_like(now.nu)
        out[0], out[1] = ahead, aspect * across
        out[3], out[4], out[5] = -z_w * out[1], z_w * out[0], x_w * out[1]
        return out

    world.wrenches.append(wrench)
    sizes = {"W_N": float(blow[0, 0]), "W_E": float(blow[1, 0])}
    return sizes | {"wind_aspect": aspect, "x_wind": x_w, "z_wind": z_w}


@hidden("slosh", those(lambda v: bool({0, 1} & set(v.dofs))))
def slosh(world: World, draw: Draw) -> Values:
    """A mass m_s on a spring (w, damping ratio d) swings along and across the hull; it pulls where it is.

    Its place (x, y) and speed over ground (u, v), in body axes that turn with r: dx/dt = u - u_hull + r y,
    du/dt = a_x + r v, a = -w^2 (x, y) - 2 d w d(x, y)/dt; the hull feels -m_s a.
    """
    mass, omega = draw.size(0.05, 0.5) * world.vehicle.mass, draw.shape(0.8, 3.0)
    ratio = draw.shape(0.03, 0.15)

    def swing(now: Moment, s: np.ndarray) -> np.ndarray:
        r = now.nu[5]
        return np.array([s[2] - now.nu[0] + r * s[1], s[3] - now.nu[1] - r * s[0]])

    def pull(now: Moment, s: np.ndarray) -> np.ndarray:
        return -(omega**2) * s[:2] - 2 * ratio * omega * swing(now, s)

    def rate(now: Moment, s: np.ndarray) -> np.ndarray:
        turning = now.nu[5] * np.array([s[3], -s[2]])
        return np.concatenate([swing(now, s), pull(now, s) + turning])

    def wrench(now: Moment, s: np.ndarray) -> np.ndarray:
        out = np.zeros_like(now.nu)
        out[:2] = -mass * pull(now, s)
        out[5] = s[0] * out[1] - s[1] * out[0]
        return out

    world.memories.append(Memory(4, rate, wrench))
    return {"m_slosh": mass, "slosh_frequency": omega, "slosh_damping": ratio}
