"""What may be commanded: axes, limits, noise of the log to come, shapes of commands and their families."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np
from scipy.optimize import lsq_linear

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError, listed
from undertow.identification.doctor.forces import allocation
from undertow.identification.estimation.data import channel_noise
from undertow.identification.logs.run import UNITS, Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array


@dataclass(frozen=True)
class ManoeuvreSettings:
    """What manoeuvres are made of, and the noise of sensors where nothing is known of it."""

    levels: int = 8  # of steps
    bits: int = 24  # of random binary steps
    pulses: int = 3  # before coast-downs
    astern: float = 0.2  # least size of a reversal, of that ahead
    # Ranges of free numbers, as the least value and what is added to it: the unit of a 3-2-1-1 input, where
    # it begins again and how large it is then; time ahead in a period of a reversal; time of thrust in a
    # pulse. Times are shares of the manoeuvre, or of the period.
    unit: tuple[float, float] = (0.02, 0.05)
    again: tuple[float, float] = (0.5, 0.1)
    again_size: tuple[float, float] = (0.3, 0.7)
    ahead: tuple[float, float] = (0.3, 0.4)
    thrust: tuple[float, float] = (0.2, 0.5)
    least_sine: float = 1e-3  # size of each sine of a multisine
    # Nothing faster than this, Hz: thrusters do not follow, and a log at 10 Hz would not show it.
    fastest: float = 1.0
    taper: float = 2.0  # length of the smooth beginning and end, s
    taper_share: float = 0.1  # the most that each may take of the manoeuvre
    pure: float = 1e-6  # share of a wrench that a pure motion may have in the other degrees of freedom
    rounding: float = 1e-9  # of commands that make it, as a share of the largest, and of their equations
    # Steps towards the commands that balance the weight: a thruster with a dead band leaves it step by step.
    trim_rounds: int = 60
    balanced: float = 1e-6  # N or N m: less is rounding
    balanced_share: float = 1e-3  # share of what the actuators can do that counts as none beside it
    rest: float = 1e-6  # share of its limit below which a command is zero
    trim_share: float = 0.95  # of the limit of an actuator that balancing the weight may take
    # Share of half the range of a command that it may go to either side of rest; with less, its mean is the
    # middle of its range instead: a propeller that cannot reverse has nothing below rest.
    room: float = 0.05
    harmonics: tuple[int, ...] = (1, 2, 3, 5, 8, 13)  # periods of the sines of a multisine
    # Standard deviation by unit where nothing is known: a small vehicle with DVL, gyro and acoustic position.
    assumed_noise: tuple[tuple[str, float], ...] = (
        ("m", 0.02),
        ("rad", 0.01),
        ("m/s", 0.01),
        ("rad/s", 0.005),
    )
    under_way: float = 1.0  # m/s at which a command without effect at rest is examined


SETTINGS = ManoeuvreSettings()


@dataclass(frozen=True)
class Shape:
    """A kind of signal."""

    name: str
    size: int  # how many numbers it takes
    signal: Callable[[Array, float, Array], Array]  # the signal from (share of time, length in s, numbers)


def _within(ends: tuple[float, float], q: float) -> float:
    """A free number in its range."""
    return ends[0] + ends[1] * q


def _steps(share: Array, length: float, q: Array) -> Array:
    """Steps between levels, each held for as long: a coast-down or a reversal where the levels say so."""
    return np.asarray((2 * q - 1)[(share * SETTINGS.levels).astype(int)])


def _binary_steps(share: Array, length: float, q: Array) -> Array:
    """Full one way or the other, changing at random instants (pseudo-random binary sequence)."""
    return np.where(q[(share * SETTINGS.bits).astype(int)] > 0.5, 1.0, -1.0)


def _doublet(share: Array, length: float, q: Array) -> Array:
    """The 3-2-1-1 input of flight tests, once each way."""
    unit = _within(SETTINGS.unit, q[0])
    pattern = np.array([1, 1, 1, -1, -1, 1, -1, 0.0])
    first = pattern[np.minimum((share / unit).astype(int), 7)]
    begin = _within(SETTINGS.again, q[1])
    later = pattern[np.clip(((share - begin) / unit).astype(int), 0, 7)] * (share >= begin)
    return np.asarray(np.where(share < begin, first, -later * _within(SETTINGS.again_size, q[2])))


def _multisine(share: Array, length: float, q: Array) -> Array:
    """Sines with 1 to 13 periods, sizes and phases free, scaled to the full deflection."""
    size, phase = np.split(q, 2)
    angle = 2 * np.pi * (share[:, None] * np.array(SETTINGS.harmonics) + phase)
    wave = np.sin(angle) @ (size + SETTINGS.least_sine)
    return np.asarray(wave / np.max(np.abs(wave)))


def _chirp(share: Array, length: float, q: Array) -> Array:
    """A sine of growing frequency, from 1 to 3 periods per length up to at most 1 Hz."""
    first = (1 + 2 * q[0]) / length
    last = max(first * (SETTINGS.fastest / first) ** q[1], first)
    growth = np.log(last / first) + 1e-9
    return np.asarray(np.sin(2 * np.pi * first * length * np.expm1(growth * share) / growth))


def _reversal(share: Array, length: float, q: Array) -> Array:
    """Ahead and astern in turn, the two with their own size: with nothing astern it would be no reversal."""
    periods = 1 + np.floor(5.99 * q[0])
    ahead = (share * periods) % 1.0 < _within(SETTINGS.ahead, q[1])
    return np.where(ahead, 1.0, -(SETTINGS.astern + (1 - SETTINGS.astern) * q[2]))


def _coast(share: Array, length: float, q: Array) -> Array:
    """Pulses of thrust, each followed by a segment without, in which the vehicle coasts down."""
    pulse = (share * SETTINGS.pulses).astype(int)
    on = (share * SETTINGS.pulses) % 1.0 < _within(SETTINGS.thrust, q[-1])
    return np.where(on, (2 * q - 1)[pulse], 0.0)


def _sweep(share: Array, length: float, q: Array) -> Array:
    """Slowly up and down through all speeds, both ways."""
    cycles = 1 + np.floor(2.99 * q[0])
    ramp = 1 - 4 * np.abs((share * cycles + 0.25) % 1.0 - 0.5)
    return np.asarray(np.sign(ramp) * np.abs(ramp) ** (0.5 + q[1]))


def _steady(share: Array, length: float, q: Array) -> Array:
    """Held, with another level in the second half."""
    return np.where(share < 0.5, 1.0, 2 * q[0] - 1)


STEPS = Shape("steps", SETTINGS.levels, _steps)
BINARY_STEPS = Shape("random binary steps", SETTINGS.bits, _binary_steps)
DOUBLET = Shape("doublets (3-2-1-1)", 3, _doublet)
MULTISINE = Shape("multisine", 2 * len(SETTINGS.harmonics), _multisine)
CHIRP = Shape("chirp", 2, _chirp)
REVERSAL = Shape("reversals", 3, _reversal)
COAST = Shape("pulses and coast-downs", SETTINGS.pulses + 1, _coast)
SWEEP = Shape("slow sweeps", 2, _sweep)
STEADY = Shape("steady", 1, _steady)
SHAPES = (STEPS, BINARY_STEPS, DOUBLET, MULTISINE, CHIRP, REVERSAL, COAST, SWEEP)


@dataclass(frozen=True)
class Axis:
    """One direction in the space of commands."""

    name: str  # a degree of freedom, or a command
    pattern: Array  # (k,) commands at full deflection


@dataclass(frozen=True)
class Start:
    """Where a manoeuvre begins: at a depth, m, and going ahead at a speed, m/s."""

    depth: float = 0.0
    speed: float = 0.0

    def motion(self, vehicle: Vehicle) -> Array:
        """Pose and velocity, (2n_dof,)."""
        known = {"z": self.depth, "u": self.speed}
        return np.array([known.get(n, 0.0) for n in (*vehicle.pose_names, *vehicle.velocity_names)])


def control_effectiveness(functions: Functions, limits: CommandLimits, start: Start) -> Array:
    """Force or moment per unit of every command in every degree of freedom, (n, k), at the start.

    That of a thruster with a curve or a propeller law, and of everything under way, is the mean slope from
    the lowest to the highest command: about zero many do nothing.
    """
    table, net_force = allocation(functions.vehicle), _net_force(functions, start)
    laws = [thruster.law for thruster in functions.vehicle.thrusters]
    for i in range(table.shape[1]):
        if start.speed or (i < len(laws) and laws[i] is not None):
            one = np.arange(len(limits.low)) == i
            change = net_force(one * limits.high) - net_force(one * limits.low)
            table[:, i] = change / max(limits.high[i] - limits.low[i], 1e-12)
    return table


def steering(functions: Functions, limits: CommandLimits, start: Start, effectiveness: Array) -> list[Axis]:
    """Full deflections of commands that do nothing at the start and something under way: rudders, fins."""
    vehicle = functions.vehicle
    if "surge" not in vehicle.degrees_of_freedom or start.speed:
        return []
    moving = control_effectiveness(functions, limits, replace(start, speed=SETTINGS.under_way))
    new = ~np.any(effectiveness != 0, axis=0) & np.any(np.abs(moving) > SETTINGS.balanced, axis=0)
    units = np.diag(limits.value)
    return [Axis(n, units[i]) for i, n in enumerate(vehicle.command_names) if new[i]]


def motion_axes(vehicle: Vehicle, effectiveness: Array, room: Array) -> list[Axis]:
    """For every degree of freedom that the actuators can excite alone: the commands that do so."""
    forces = effectiveness * room
    scale = np.max(np.abs(forces), axis=1)
    found = []
    for i, name in enumerate(vehicle.degrees_of_freedom):
        pattern = _pure_motion(forces, scale, i)
        if pattern is not None:
            found.append(Axis(name, room * pattern))
    return found


def _pure_motion(forces: Array, scale: Array, i: int) -> Array | None:
    if not scale[i] > 0:
        return None
    rows = np.flatnonzero(scale > 0)
    scaled = forces[rows] / scale[rows, None]
    target = (rows == i).astype(float)
    pattern = np.linalg.lstsq(scaled, target, rcond=SETTINGS.rounding)[0]
    if np.linalg.norm(scaled @ pattern - target) > SETTINGS.pure:
        return None
    pattern[np.abs(pattern) < SETTINGS.rounding * np.max(np.abs(pattern))] = 0.0
    return np.asarray(pattern / np.max(np.abs(pattern)))


@dataclass(frozen=True)
class Trim:
    """Commands that hold a vehicle at rest against weight and buoyancy."""

    commands: Array
    unbalanced: dict[str, float]  # force or moment left by the actuators, by degree of freedom, N or N m


def trim(functions: Functions, bounds: CommandLimits, table: Array, start: Start) -> Trim:
    """Balance heave, roll and pitch, and surge under way, at the start, with no force in other directions."""
    vehicle, limits = functions.vehicle, bounds.value
    balanced = ("heave", "roll", "pitch", *(("surge",) if start.speed else ()))
    rows = [i for i, d in enumerate(vehicle.degrees_of_freedom) if d in balanced]
    commands = np.zeros(len(limits))
    if not rows or not len(limits):
        return Trim(commands, {})
    net_force = _net_force(functions, start)
    size = np.maximum(np.abs(table) @ limits, 1e-12)
    scaled = table * limits / size[:, None]
    box = tuple(SETTINGS.trim_share * edge / limits for edge in (bounds.low, bounds.high))
    # Under way the slope of a propeller is up to twice its mean: half a step does not swing to and fro.
    step = 0.5 if start.speed else 1.0
    for _ in range(SETTINGS.trim_rounds):
        wanted = np.zeros(len(table))
        wanted[rows] = (table @ commands - net_force(commands))[rows] / size[rows]
        commands = commands + step * (lsq_linear(scaled, wanted, box).x * limits - commands)
    commands[np.abs(commands) < SETTINGS.rest * limits] = 0.0
    rest = net_force(commands)
    least = np.maximum(SETTINGS.balanced_share * size, SETTINGS.balanced)
    unbalanced = {vehicle.degrees_of_freedom[i]: float(rest[i]) for i in rows if abs(rest[i]) > least[i]}
    return Trim(commands, unbalanced)


def _net_force(functions: Functions, start: Start) -> Callable[[Array], Array]:
    """Net force and moment at the start, level, with commands that have been held for long."""
    f = functions
    u = ca.MX.sym("u", f.u.numel())
    motion = np.concatenate([start.motion(f.vehicle), np.zeros(f.memory.numel())])
    p = np.array(f.values(), dtype=float)
    state = ca.vertcat(ca.DM(motion), f.rest(u, p, 0.0))
    force = ca.Function("force", [u], [f.residual_function(state, np.zeros(f.nu.numel()), u, p, 0.0)])
    return lambda commands: np.array(force(commands)).ravel()


@dataclass(frozen=True)
class Family:
    """Manoeuvres of one kind."""

    name: str
    axes: tuple[Axis, ...]  # what is driven
    shapes: tuple[Shape, ...]  # the shape on every axis
    reach: Array  # (n_axes,) largest useful deflection of every axis, 0 to 1
    in_turn: bool = False  # whether the axes are driven one after the other

    @property
    def size(self) -> int:
        """How many numbers between 0 and 1 a manoeuvre of the family takes."""
        return sum(1 + s.size for s in self.shapes)

    def excitation(self, t: Array, numbers: Array, sizes: Array | float = 1.0) -> Array:
        """Commands beside the trim, (n, k), at times from 0; smooth ends, may exceed what actuators can do.

        `numbers` (size,) are between 0 and 1, `sizes` (n_axes,) the share of every axis that is kept.
        """
        duration = float(t[-1] + (t[1] - t[0]))
        of_axes = np.split(numbers, np.cumsum([1 + s.size for s in self.shapes])[:-1])
        waves = [self._wave(t / duration, duration, i, q) for i, q in enumerate(of_axes)]
        patterns = np.array([a.pattern for a in self.axes]) * np.reshape(sizes, (-1, 1))
        return np.asarray(taper(t)[:, None] * (np.column_stack(waves) @ patterns))

    def _wave(self, share: Array, duration: float, i: int, q: Array) -> Array:
        count = len(self.axes) if self.in_turn else 1
        local = share * count - (i if self.in_turn else 0)
        inside = (local >= 0) & (local < 1)
        wave = self.shapes[i].signal(np.clip(local, 0.0, 1.0 - 1e-9), duration / count, q[1:])
        return np.asarray(np.where(inside, wave, 0.0) * q[0] * self.reach[i])


def taper(t: Array) -> Array:
    """From 0 to 1 and back to 0 without a jump, at times from 0."""
    duration = float(t[-1] + (t[1] - t[0]))
    length = min(SETTINGS.taper, SETTINGS.taper_share * duration)
    nearest = np.clip(np.minimum(t, t[-1] - t) / length, 0.0, 1.0)
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * nearest))


@dataclass(frozen=True)
class Design:
    """One manoeuvre: its family and its numbers between 0 and 1."""

    family: Family
    numbers: Array


def every_axis(vehicle: Vehicle, effectiveness: Array, room: Array) -> tuple[list[Axis], list[Axis]]:
    """Axes of motions, and of single actuators where these differ; commands may go `room` (k,) from rest."""
    motions, units = motion_axes(vehicle, effectiveness, room), np.diag(room)
    moves = np.any(effectiveness != 0, axis=0)
    actuators = [Axis(n, units[i]) for i, n in enumerate(vehicle.command_names) if moves[i]]
    if len(motions) == len(actuators) and all(np.count_nonzero(a.pattern) == 1 for a in motions):
        return motions, []
    return motions, actuators


Group = tuple[list[Axis], Array]
"""Axes with the reach of each."""


def families(bases: Sequence[Group], steered: Sequence[Axis] = ()) -> list[Family]:
    """Every family for axes that come in groups; rudders and fins, `steered`, need a speed ahead."""
    found = [family for axes, reach in bases if axes for family in _families_of(axes, reach)]
    return [*found, *(_steered_families(*bases[0], steered) if bases and steered else ())]


def _families_of(axes: list[Axis], reach: Array) -> Iterator[Family]:
    names, several = listed([a.name for a in axes]), len(axes) > 1
    for shape in SHAPES:
        shapes = (shape,) * len(axes)
        yield Family(f"{shape.name} of {names}{' together' * several}", tuple(axes), shapes, reach)
        if several:
            yield Family(f"{shape.name} of {names} in turn", tuple(axes), shapes, reach, in_turn=True)
    yield from _turning(axes, reach)


def _steered_families(axes: list[Axis], reach: Array, steered: Sequence[Axis]) -> Iterator[Family]:
    """Rudders and fins in every shape, with the vehicle going ahead at one speed or at several."""
    ahead = next((i for i, a in enumerate(axes) if a.name == "surge"), None)
    if ahead is None:
        return
    both, reaches = (axes[ahead], *steered), np.append(reach[ahead], np.ones(len(steered)))
    names = listed([a.name for a in steered])
    for speed, surge in ((STEADY, "steady surge"), (STEPS, "steps of surge")):
        for shape in (*SHAPES, STEADY):
            shapes = (speed, *(shape,) * len(steered))
            yield Family(f"{surge} with {shape.name} of {names}", both, shapes, reaches)


def _turning(axes: list[Axis], reach: Array) -> Iterator[Family]:
    """Circles and zigzags, for what can go ahead and turn."""
    ahead = next((i for i, a in enumerate(axes) if a.name == "surge"), None)
    turn = next((i for i, a in enumerate(axes) if a.name == "yaw"), None)
    if ahead is None or turn is None:
        return
    pair = (axes[ahead], axes[turn])
    both = reach[[ahead, turn]]
    yield Family("circles (steady surge, yaw one way and the other)", pair, (STEADY, STEADY), both)
    yield Family("circles with steps of surge", pair, (STEPS, STEADY), both)
    yield Family("zigzag (steady surge, yaw to and fro)", pair, (STEADY, REVERSAL), both)


@dataclass(frozen=True)
class MotionLimits:
    """Bounds on the predicted motion, seen from where the manoeuvre starts; inf where there is none."""

    speed: float = np.inf  # magnitude of the linear velocity, m/s
    rate: float = np.radians(60.0)  # magnitude of every angular velocity, rad/s
    depth: float = 5.0  # change of depth, m
    tilt: float = np.radians(45.0)  # magnitude of roll and of pitch, rad
    distance: float = np.inf  # horizontal distance from the start, m

    def __post_init__(self) -> None:
        for name, value in self.as_dict().items():
            if not value > 0:
                raise UndertowError(f"largest {name} = {value:g} leaves no motion: give a positive value")

    def as_dict(self) -> dict[str, float]:
        """The limits by name."""
        return {name: float(getattr(self, name)) for name in ("speed", "rate", "depth", "tilt", "distance")}


@dataclass(frozen=True)
class CommandLimits:
    """Lowest and highest value of every command, in its unit; zero is between them."""

    low: Array  # (k,), zero of what cannot reverse
    high: Array  # (k,)
    source: tuple[str, ...]  # where each comes from

    @property
    def value(self) -> Array:
        """Largest magnitudes, (k,)."""
        return np.maximum(self.high, -self.low)

    def bias_and_room(self, rest: Array) -> tuple[Array, Array]:
        """Mean of the commands, seen from rest, and how far they may go to either side of it, (k,) each.

        The mean is rest itself, or the middle of the range where rest is at its edge.
        """
        room, half = np.minimum(self.high - rest, rest - self.low), (self.high - self.low) / 2
        edge = room < SETTINGS.room * half
        return np.where(edge, (self.high + self.low) / 2 - rest, 0.0), np.where(edge, half, room)


def can_be_planned(vehicle: Vehicle) -> bool:
    """Whether a manoeuvre can be chosen: something is commanded, and nothing else drives the vehicle."""
    return bool(vehicle.command_names) and not vehicle.inputs


Limit = float | tuple[float, float]
"""The largest magnitude of a command, or the lowest and the highest value that it may have."""
Bounds = tuple[float, float]


def command_limits(vehicle: Vehicle, asked: Mapping[str, Limit], runs: Sequence[Run]) -> CommandLimits:
    """Limits of commands: asked for, else of the vehicle file, of the logs, or at the ends of curves.

    The key "" stands for all that are not named; a limit of the vehicle file may be lowered, never raised.
    """
    if vehicle.inputs:
        raise UndertowError(
            f"a plan cannot choose {', '.join(vehicle.inputs)}: plan with a vehicle file without inputs"
        )
    for name, value in asked.items():
        if name not in ("", *vehicle.command_names):
            have = ", ".join(vehicle.command_names)
            raise UndertowError(f"--limit names the command '{name}', which is not there: there are {have}")
        low, high = value if isinstance(value, tuple) else (-value, value)
        if not (low <= 0 <= high and low < high and np.isfinite([low, high]).all()):
            raise UndertowError(
                f"--limit {name or 'of all'} = {limit_text((low, high))} is not a limit: give a positive "
                "value, or LOWEST:HIGHEST with zero between them"
            )
    found = [_limit(n, vehicle, asked.get(n, asked.get("")), runs) for n in vehicle.command_names]
    lows, highs = np.array([bounds for bounds, _ in found]).reshape(-1, 2).T
    return CommandLimits(lows, highs, tuple(s for _, s in found))


def limit_text(bounds: Bounds) -> str:
    """A limit in words: one number where it is the same both ways."""
    low, high = bounds
    return f"{high:.3g}" if low == -high else f"{low:.3g} to {high:.3g}"


def _limit(name: str, vehicle: Vehicle, given: Limit | None, runs: Sequence[Run]) -> tuple[Bounds, str]:
    """The range of a command, and its source."""
    stated, end = vehicle.command_limits.get(name), vehicle.largest_commands.get(name)
    lowest = vehicle.lowest_commands.get(name, -np.inf)
    if given is not None:
        most = np.inf if stated is None else stated
        low, high = given if isinstance(given, tuple) else (max(-given, lowest), given)
        if high > most or low < lowest:
            of_file = limit_text((lowest, most))
            raise UndertowError(
                f"--limit {limit_text((low, high))} for '{name}' is beyond its limit in the vehicle file, "
                f"{of_file}"
            )
        return (low, high), "asked for"
    if stated is not None:
        return (lowest, stated), "vehicle file"
    logged = [run.channels[name] for run in runs if run.has(name)]
    seen = (
        min((float(np.nanmin(command, initial=0.0)) for command in logged), default=0.0),
        max((float(np.nanmax(command, initial=0.0)) for command in logged), default=0.0),
    )
    if end is not None and seen == (0.0, 0.0):
        return (lowest, end), "end of its curve"
    if seen == (0.0, 0.0):
        raise UndertowError(
            f"no limit is known for the command '{name}': give --limit {name}=VALUE (or --limit "
            "VALUE for all), or write limit = ... into the vehicle file"
        )
    most = max(seen[1], -seen[0])
    if name in {t.name for t in vehicle.thrusters} - {*vehicle.angle_names} and 0.0 in seen:
        return seen, "range in the logs"
    return (max(-most, lowest), most), "largest in the logs"


def nearest_limit(y: Array, names: Sequence[str], limits: MotionLimits) -> tuple[str, float]:
    """The limit that a motion comes nearest to, and its ratio to it (at most 1 is allowed); y is (n, 2n)."""
    if not np.isfinite(y).all():
        return "speed", float("inf")
    bounds = limits.as_dict()
    ratios = {what: size / bounds[what] for what, size in extremes(y, names).items()}
    nearest = max(ratios, key=lambda what: ratios[what], default="speed")
    return nearest, ratios.get(nearest, 0.0)


def extremes(y: Array, names: Sequence[str]) -> dict[str, float]:
    """Largest speed, rate, change of depth, tilt and distance of a motion, in SI; only what it has."""
    columns, moved = dict(zip(names, y.T, strict=True)), dict(zip(names, (y - y[0]).T, strict=True))
    groups = {
        "speed": [columns[n] for n in ("u", "v", "w") if n in columns],
        "distance": [moved[n] for n in ("x", "y") if n in moved],
        "rate": [columns[n] for n in ("p", "q", "r") if n in columns],
        "tilt": [columns[n] for n in ("phi", "theta") if n in columns],
        "depth": [moved[n] for n in ("z",) if n in moved],
    }
    found = {}
    for what, group in groups.items():
        if group:
            together = what in ("speed", "distance")  # components of one vector
            sizes = np.linalg.norm(np.column_stack(group), axis=1) if together else np.abs(group)
            found[what] = float(np.max(sizes))
    return found


@dataclass(frozen=True)
class ChannelNoise:
    """Noise of the 2n channels of a vehicle."""

    names: tuple[str, ...]  # pose, then velocity
    # (2n,) standard deviation of the white noise of a sample, SI; inf for a channel that is not measured.
    sigma: Array
    source: tuple[str, ...]  # where each comes from
    derived: frozenset[str] = frozenset()  # velocities that will be taken from the pose

    @property
    def finite(self) -> Array:
        """The noise; what is assumed where nothing is measured."""
        assumed = [_assumed_noise(n) for n in self.names]
        return np.where(np.isfinite(self.sigma), self.sigma, assumed)


def planned_noise(vehicle: Vehicle, asked: Mapping[str, float], runs: Sequence[Run]) -> ChannelNoise:
    """Noise of every channel of a log to come: as asked (inf: not measured), else as in the logs.

    A pose that the logs lack counts as not measured; derived velocities stay derived.
    """
    names = (*vehicle.pose_names, *vehicle.velocity_names)
    for name, value in asked.items():
        if name not in names:
            raise UndertowError(
                f"--noise names '{name}', which is not a channel: there are {', '.join(names)}"
            )
        if not value > 0:
            raise UndertowError(
                f"--noise {name} = {value:g} is not a noise: give a positive standard deviation"
            )
    found = [_noise(n, asked, runs) for n in names]
    sigma = np.array([s for s, _ in found])
    for name in vehicle.velocity_names:
        if not np.isfinite(sigma[names.index(name)]):
            raise UndertowError(
                f"--noise {name}=none: a plan needs velocities; give the noise of '{name}' derived from the "
                "pose, or logs that hold only the pose"
            )
    derived = frozenset(name for run in runs for name in run.derived)
    return ChannelNoise(names, sigma, tuple(source for _, source in found), derived)


def _assumed_noise(name: str) -> float:
    return dict(SETTINGS.assumed_noise)[UNITS[name]]


def _noise(name: str, asked: Mapping[str, float], runs: Sequence[Run]) -> tuple[float, str]:
    if name in asked:
        return asked[name], "as given" if np.isfinite(asked[name]) else "not measured"
    with_it = [r for r in runs if r.has(name)]
    if runs and not with_it:
        return float("inf"), "not in the logs"
    estimated = float(channel_noise(with_it, [name])[0])
    if not estimated > 0:
        return _assumed_noise(name), "assumed"
    taken = any(name in r.derived for r in with_it)
    return estimated, "taken from the pose" if taken else "from the logs"
