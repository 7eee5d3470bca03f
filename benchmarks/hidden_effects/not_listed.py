"""Effects that no catalogue lists (the honest verdict is "unexplained"), and guesses that are badly wrong."""

from __future__ import annotations

import numpy as np

from .registry import SURGING, TURNING, Draw, Values, hidden, with_motions
from .world import Memory, Moment, World, derivative, quadratic_name, to_body


def _row_force(world: World, row: int, low: float, high: float, draw: Draw) -> float:
    """A force or moment as a share of the drag at the typical speed."""
    return draw.size(low, high) * world.vehicle.drag_at_pace(row)


def _only(now: Moment, row: int, force: np.ndarray) -> np.ndarray:
    """(6, R) with one row filled."""
    out = np.zeros_like(now.nu)
    out[row] = force
    return out


@hidden("growing_drag", kind="alien")
def growing_drag(world: World, draw: Draw) -> Values:
    """Damping is multiplied by 1 + g t (fouling in fast motion: 0.3 to 3 times more after 100 s)."""
    rate = draw.size(0.3, 3.0) / 100.0
    world.wrenches.append(lambda now: rate * now.t * now.drag)
    return {"rate": rate}


@hidden("turning_drag", TURNING, kind="alien")
def turning_drag(world: World, draw: Draw) -> Values:
    """X = -k |r| u_r: surge drag that depends on the yaw rate."""
    pace = world.vehicle.pace
    k = _row_force(world, 0, 0.3, 3.0, draw) / (pace[0] * pace[5])
    world.wrenches.append(lambda now: _only(now, 0, -k * np.abs(now.nu[5]) * now.nu_r[0]))
    return {"k": k}


@hidden("periodic_side_force", with_motions(1), kind="alien")
def periodic_side_force(world: World, draw: Draw) -> Values:
    """Y = A sin(2 pi t / P) in body axes, as from a swinging arm."""
    force, period = _row_force(world, 1, 0.2, 2.0, draw), draw.shape(3.0, 12.0)
    world.wrenches.append(lambda now: _only(now, 1, force * np.sin(2 * np.pi * now.t / period)))
    return {"A": force, "P": period}


@hidden("sheared_current", with_motions(0, 2), kind="alien")
def sheared_current(world: World, draw: Draw) -> Values:
    """The water moves north with g (z - z_0): a current that depends on depth."""
    gradient, start = draw.signed(0.1, 0.8) * world.vehicle.pace[0], world.vehicle.depth
    north = np.array([[1.0], [0.0], [0.0]])
    world.flows.append(
        lambda t, eta, moving: (north * gradient * (eta[2] - start), north * gradient * moving[2])
    )
    return {"gradient": gradient}


@hidden("heading_force", TURNING, kind="alien")
def heading_force(world: World, draw: Draw) -> Values:
    """Y = A sin(2 (psi - psi_0)): a side force that depends on the heading, twice per turn."""
    force, angle = _row_force(world, 1, 0.2, 2.0, draw), draw.shape(0.0, np.pi)
    world.wrenches.append(lambda now: _only(now, 1, force * np.sin(2 * (now.eta[5] - angle))))
    return {"A": force, "psi_0": angle}


@hidden("heading_moment", TURNING, kind="alien")
def heading_moment(world: World, draw: Draw) -> Values:
    """N = A sin(psi - psi_0): a moment towards a heading, without a force, as of a cable that is twisted."""
    moment, angle = _row_force(world, 5, 0.2, 2.0, draw), draw.shape(-np.pi, np.pi)
    world.wrenches.append(lambda now: _only(now, 5, moment * np.sin(now.eta[5] - angle)))
    return {"A": moment, "psi_0": angle}


@hidden("damping_by_thrust", TURNING, kind="alien")
def damping_by_thrust(world: World, draw: Draw) -> Values:
    """N = -k r sum |f_i|: turning is damped more the more the thrusters push, by their slipstream."""
    pace = world.vehicle.pace
    k = _row_force(world, 5, 0.3, 3.0, draw) / (pace[5] * world.vehicle.peak_command)
    world.wrenches.append(lambda now: _only(now, 5, -k * np.abs(now.thrust).sum(axis=0) * now.nu[5]))
    return {"k": k}


@hidden("sinking_in_turns", with_motions(2, 5), kind="alien")
def sinking_in_turns(world: World, draw: Draw) -> Values:
    """Z = k r^2: the vehicle is drawn down in turns."""
    k = _row_force(world, 2, 0.2, 2.0, draw) / world.vehicle.pace[5] ** 2
    world.wrenches.append(lambda now: _only(now, 2, k * now.nu[5] ** 2))
    return {"k": k}


@hidden("failing_thruster", SURGING, kind="alien")
def failing_thruster(world: World, draw: Draw) -> Values:
    """From t_0 on the first thruster gives a share s less: a blade broke, or weed got into it."""
    share, when = draw.size(0.1, 0.8, most=0.9), draw.shape(20.0, 60.0)

    def wrench(now: Moment) -> np.ndarray:
        lost = -share * np.outer(world.allocation[:, 0], now.thrust[0])
        return lost if now.t >= when else 0.0 * lost

    world.wrenches.append(wrench)
    return {"s": share, "t_0": when}


@hidden("gusts", SURGING, kind="alien")
def gusts(world: World, draw: Draw) -> Values:
    """A random force to the north: 12 sines between 0.01 and 0.3 Hz, other phases in every run."""
    rms = _row_force(world, 0, 0.15, 1.5, draw)
    omega = 2 * np.pi * np.exp(draw.rng.uniform(np.log(0.01), np.log(0.3), (12, 1)))
    phase = draw.rng.uniform(0, 2 * np.pi, (12, 1))

    def wrench(now: Moment) -> np.ndarray:
        run = 997.0 * np.arange(now.nu.shape[1])  # far apart in time: other phases
        north = rms * np.sqrt(2 / 12) * np.sin(omega * (now.t + run) + phase).sum(axis=0)
        force = np.stack([north, 0 * north, 0 * north])
        return np.concatenate([to_body(now.turn, force), np.zeros_like(force)])

    world.wrenches.append(wrench)
    return {"rms": rms}


@hidden("thruster_interference", TURNING, kind="alien")
def thruster_interference(world: World, draw: Draw) -> Values:
    """X = -k |f_1 f_2| / c_peak: the first two thrusters blow on the hull together."""
    k, peak = (
        draw.size(0.2, 2.0) * world.vehicle.reach[0] / world.vehicle.peak_command,
        world.vehicle.peak_command,
    )
    world.wrenches.append(lambda now: _only(now, 0, -k * np.abs(now.thrust[0] * now.thrust[1]) / peak))
    return {"k": k}


@hidden("falling_thrust", SURGING, kind="alien")
def falling_thrust(world: World, draw: Draw) -> Values:
    """f_i = c_i (1 - k v_i): thrust falls with the speed v_i of the thruster along it, at any load alike."""
    k = draw.size(0.1, 0.8) / world.vehicle.pace[0]
    inward = world.allocation.T.copy()
    world.inflow.append(lambda f, nu_r: f - k * f * (inward @ nu_r))
    return {"k": k}


@hidden("dropped_weight", with_motions(2), kind="alien")
def dropped_weight(world: World, draw: Draw) -> Values:
    """From t_0 on the vehicle is lighter by dW: force -dW down."""
    weight, when = draw.signed(0.06, 0.5) * world.vehicle.reach[2], draw.shape(20.0, 60.0)

    def wrench(now: Moment) -> np.ndarray:
        out = np.zeros_like(now.nu)
        if now.t >= when:
            out[:3] = -weight * now.turn[2]
        return out

    world.wrenches.append(wrench)
    return {"dW": weight, "t_0": when}


@hidden("vortex_shedding", TURNING, kind="alien")
def vortex_shedding(world: World, draw: Draw) -> Values:
    """Y = A u_r^2 sin p, N = 0.1 m Y, dp/dt = 2 pi |u_r| / l: a side force that beats with the speed."""
    gain = _row_force(world, 1, 0.4, 4.0, draw) / world.vehicle.pace[0] ** 2
    length = draw.shape(0.8, 2.0)

    def wrench(now: Moment, phase: np.ndarray) -> np.ndarray:
        out = _only(now, 1, gain * now.nu_r[0] ** 2 * np.sin(phase[0]))
        out[5] = 0.1 * out[1]
        return out

    world.memories.append(Memory(1, lambda now, phase: 2 * np.pi * np.abs(now.nu_r[:1]) / length, wrench))
    return {"A": gain, "l": length}


def _misjudge(world: World, draw: Draw, names: list[str]) -> Values:
    """The prior value of one parameter is 2 times too large or too small (times 2^strength)."""
    name = names[draw.pick(range(len(names)))]
    factor = float(2.0 ** (draw.strength * draw.rng.choice([-1.0, 1.0])))
    world.misjudged[name] = factor
    return {name: factor}


@hidden("wrong_drag", kind="prior")
def wrong_drag(world: World, draw: Draw) -> Values:
    """Nothing is hidden, but the prior value of one damping parameter is 2 or 1/2 times the guess."""
    names = [derivative(i, i) for i in world.dofs]
    names += [quadratic_name(i) for i in world.dofs if world.vehicle.quadratic[i]]
    return _misjudge(world, draw, names)


@hidden("wrong_added_mass", kind="prior")
def wrong_added_mass(world: World, draw: Draw) -> Values:
    """Nothing is hidden, but the prior value of one added mass is 2 or 1/2 times the guess."""
    return _misjudge(world, draw, [derivative(i, i, mark="dot") for i in world.dofs])


@hidden("wrong_all", kind="prior")
def wrong_all(world: World, draw: Draw) -> Values:
    """Nothing is hidden, but every prior value of damping and added mass is 2 or 1/2 times the guess."""
    names = [derivative(i, i, mark="dot") for i in world.dofs] + [derivative(i, i) for i in world.dofs]
    names += [quadratic_name(i) for i in world.dofs if world.vehicle.quadratic[i]]
    values = {name: float(2.0 ** (draw.strength * draw.rng.choice([-1.0, 1.0]))) for name in names}
    world.misjudged |= values
    return values
