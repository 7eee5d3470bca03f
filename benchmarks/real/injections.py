"""Known effects put exactly into real logs: what would have been logged is worked out from what was."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects.plant import rotation
from benchmarks.hidden_effects.world import to_body, to_ned, velocity_at
from benchmarks.trust.verdicts import accepted, holding
from undertow.identification.logs.run import Run
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.vehicle import Vehicle

Array = NDArray[np.float64]
#: Direction of currents, and of levers seen from above, rad: along no axis.
TOWARDS = 0.7
#: Steps of a log may differ by this share where samples are shifted by a time.
_EVEN = 1e-2
Commands = tuple[str, ...]


@dataclass(frozen=True)
class Injection:
    """One kind of change.

    name: its name in the ids of cases.
    answers: ids of the effects of the catalogue that are right.
    scale: size of a log set by which sizes are multiplied; empty for rad and shares.
    sizes: small, medium and large.
    run: the log as it would have been; of a log, a size and the names of the commands.
    file: the vehicle file as it would have been, of a vehicle and a size.
    """

    name: str
    answers: tuple[str, ...]
    scale: str
    sizes: tuple[float, float, float]
    run: Callable[[Run, float, Commands], Run] | None = None
    file: Callable[[Vehicle, float], Vehicle] | None = None

    @property
    def equation(self) -> str:
        """What is done, in one sentence."""
        return " ".join(((self.run or self.file).__doc__ or "").split())

    def value(self, size: float, scales: Mapping[str, float]) -> float:
        """The size in its unit."""
        scale = scales.get(self.scale.removeprefix("1/"), 1.0)
        return size / scale if self.scale.startswith("1/") else size * scale

    def right(self, motions: Sequence[str]) -> list[str]:
        """All right answers for a vehicle with these degrees of freedom."""
        alike = (accepted(a, motions) | holding(a, motions) for a in self.answers)
        return [*self.answers, *sorted(set().union(*alike) - {*self.answers})]

    def applied(self, vehicle: Vehicle, runs: Sequence[Run], value: float) -> tuple[Vehicle, list[Run]]:
        """Vehicle and logs with the change in them."""
        if self.file is not None:
            return self.file(vehicle, value), list(runs)
        assert self.run is not None
        return vehicle, [self.run(run, value, vehicle.command_names) for run in runs]


INJECTIONS: dict[str, Injection] = {}


def _injected(
    name: str, *answers: str, sizes: tuple[float, float, float], scale: str = ""
) -> Callable[[Callable[..., Run]], Callable[..., Run]]:
    """Decorator that puts a change of the log into `INJECTIONS`."""

    def enter(run: Callable[..., Run]) -> Callable[..., Run]:
        INJECTIONS[name] = Injection(name, answers, scale, sizes, run=run)
        return run

    return enter


def _wrong(
    name: str, *answers: str, sizes: tuple[float, float, float], scale: str = ""
) -> Callable[[Callable[..., Vehicle]], Callable[..., Vehicle]]:
    """Decorator that puts a change of the vehicle file into `INJECTIONS`."""

    def enter(file: Callable[..., Vehicle]) -> Callable[..., Vehicle]:
        INJECTIONS[name] = Injection(name, answers, scale, sizes, file=file)
        return file

    return enter


# --- the water, and what the sensors make of the motion -----------------------------------------
@_injected("current", "ocean_current", sizes=(0.1, 0.25, 0.5), scale="speed")
def current(run: Run, speed: float, commands: Commands) -> Run:
    """The ground moves: p + V t, v + R' V; the motion through the water, and so every force, is the same."""
    return _drifting(run, speed, over_ground=True)


@_injected("water-log", "water_speed_log", sizes=(0.1, 0.25, 0.5), scale="speed")
def water_log(run: Run, speed: float, commands: Commands) -> Run:
    """The ground moves, p + V t, and the velocity is still read through the water."""
    return _drifting(run, speed, over_ground=False)


def _drifting(run: Run, speed: float, *, over_ground: bool) -> Run:
    course = TOWARDS if run.has("y") else 0.0
    water = speed * np.array([[np.cos(course)], [np.sin(course)], [0.0]])
    found = dict(zip("xyz", _rows(run, POSE[:3]) + water * (run.t - run.t[0]), strict=True))
    if over_ground:
        moved = _rows(run, VELOCITY[:3]) + to_body(_attitude(run), water)
        found |= dict(zip(VELOCITY[:3], moved, strict=True))
    return _with(run, found)


@_injected("compass", "attitude_bias", sizes=(0.05, 0.15, 0.35))
def compass(run: Run, bias: float, commands: Commands) -> Run:
    """The heading reads too much by a constant: psi + b."""
    wrapped = {"psi": _turned(run.wrapped["psi"] + bias)} if "psi" in run.wrapped else {}
    return _with(replace(run, wrapped={**run.wrapped, **wrapped}), {"psi": run.channels["psi"] + bias})


@_injected("inclinometer", "attitude_bias", "constant_force", "trim_offset", sizes=(0.005, 0.015, 0.04))
def inclinometer(run: Run, bias: float, commands: Commands) -> Run:
    """The roll angle reads too much by a constant, phi + b; in free roll a steady moment does the same."""
    return _with(run, {"phi": run.channels["phi"] + bias})


@_injected("antenna", "position_lever_arm", sizes=(0.05, 0.15, 0.4), scale="length")
def antenna(run: Run, lever: float, commands: Commands) -> Run:
    """The position is that of a point off the origin: p + R r."""
    place = np.broadcast_to(_arm(lever), (3, len(run.t)))
    return _with(run, dict(zip("xyz", _rows(run, POSE[:3]) + to_ned(_attitude(run), place), strict=True)))


@_injected("lever-arm", "velocity_lever_arm", sizes=(0.05, 0.15, 0.4), scale="length")
def lever_arm(run: Run, lever: float, commands: Commands) -> Run:
    """The velocity is that of a point off the origin: v + omega x r, with the logged turning rates."""
    moved = velocity_at(_arm(lever).ravel(), _rows(run, VELOCITY))
    return _with(run, dict(zip(VELOCITY[:3], moved, strict=True)))


@_injected("misalignment", "velocity_misalignment", sizes=(0.05, 0.15, 0.35))
def misalignment(run: Run, angle: float, commands: Commands) -> Run:
    """The velocity sensor is turned about z: (c u + s v, c v - s u)."""
    u, v = _rows(run, VELOCITY[:2])
    c, s = np.cos(angle), np.sin(angle)
    return _with(run, {"u": c * u + s * v, "v": c * v - s * u})


@_injected("bias", "sensor_bias", sizes=(0.03, 0.1, 0.25), scale="speed")
def bias(run: Run, size: float, commands: Commands) -> Run:
    """The velocities read too much by a constant each: u + b, v - b / 2."""
    u, v = _rows(run, VELOCITY[:2])
    return _with(run, {"u": u + size, "v": v - size / 2})


@_injected("gyro", "sensor_bias", sizes=(0.05, 0.15, 0.4), scale="rate")
def gyro(run: Run, size: float, commands: Commands) -> Run:
    """The turning rate reads too much by a constant: r + b."""
    return _with(run, {"r": run.channels["r"] + size})


@_injected("scale", "sensor_scale", sizes=(0.05, 0.15, 0.35))
def scale(run: Run, error: float, commands: Commands) -> Run:
    """The velocities read too large by a factor: (1 + s) (u, v, w)."""
    return _with(run, dict(zip(VELOCITY[:3], (1.0 + error) * _rows(run, VELOCITY[:3]), strict=True)))


@_injected("sensor-delay", "sensor_delay", sizes=(0.4, 0.8, 1.6), scale="time")
def sensor_delay(run: Run, delay: float, commands: Commands) -> Run:
    """The velocities are those of a while ago, a whole number of samples: u(t - d)."""
    late = _samples(run, delay)
    old = {n: np.roll(run.channels[n], late) for n in VELOCITY[:3] if run.has(n)}
    return _with(run, old).slice(t_min=run.t[late])


# --- commands -----------------------------------------------------------------------------------
@_injected("gain", "thruster_gain", sizes=(0.15, 0.3, 0.6))
def gain(run: Run, error: float, commands: Commands) -> Run:
    """The last thruster gives (1 + e) c: its command was the logged one over 1 + e."""
    return _with(run, {commands[-1]: run.channels[commands[-1]] / (1.0 + error)})


@_injected("dead-band", "thruster_deadband", sizes=(0.05, 0.15, 0.4), scale="command")
def dead_band(run: Run, width: float, commands: Commands) -> Run:
    """Commands c give c - w sgn(c), none below w: they were the logged ones plus w sgn(c)."""
    return _distorted(run, commands, lambda c: c + width * np.sign(c))


@_injected("asymmetry", "thruster_asymmetry", sizes=(0.15, 0.3, 0.5))
def asymmetry(run: Run, loss: float, commands: Commands) -> Run:
    """Commands astern give (1 - b) c: they were the logged ones over 1 - b."""
    return _distorted(run, commands, lambda c: np.where(c < 0.0, c / (1.0 - loss), c))


@_injected("curve", "thruster_curve", sizes=(0.15, 0.5, 1.5), scale="1/command")
def curve(run: Run, square: float, commands: Commands) -> Run:
    """Commands give c + a |c| c: they were the roots of that."""
    return _distorted(
        run, commands, lambda c: np.sign(c) * (np.sqrt(1.0 + 4.0 * square * np.abs(c)) - 1.0) / (2.0 * square)
    )


@_injected("droop", "supply_droop", sizes=(0.1, 0.25, 0.5), scale="1/duration")
def droop(run: Run, rate: float, commands: Commands) -> Run:
    """Commands give (1 - d t) c: they were the logged ones over 1 - d t, t in the middle of their steps."""
    middle = run.t + 0.5 * float(np.median(np.diff(run.t)))
    return _distorted(run, commands, lambda c: c / (1.0 - rate * middle))


@_injected("command-delay", "actuation_delay", sizes=(0.2, 0.6, 1.0), scale="time")
def command_delay(run: Run, delay: float, commands: Commands) -> Run:
    """Commands act late, by a whole number of samples: c(t + d) had been given."""
    ahead = _samples(run, delay)
    early = {n: np.roll(run.channels[n], -ahead) for n in commands}
    return _with(run, early).slice(t_max=run.t[-1 - ahead])


# --- the vehicle file ---------------------------------------------------------------------------
@_wrong("mass", "entrained_water", sizes=(0.1, 0.25, 0.5))
def mass(vehicle: Vehicle, share: float) -> Vehicle:
    """The file has too little mass: (1 - s) m."""
    return _with_values(vehicle, ("m", "mx_g", "my_g", "mz_g"), lambda value: (1.0 - share) * value)


@_wrong("centre", "added_mass_coupling", "entrained_water", sizes=(0.05, 0.1, 0.2), scale="length")
def centre(vehicle: Vehicle, shift: float) -> Vehicle:
    """The file has the centre of gravity too far forward: x_g + s."""
    moment = shift * vehicle.value_of("m").value
    return _with_values(vehicle, ("mx_g",), lambda value: value + moment)


@_wrong("buoyancy", "net_buoyancy", sizes=(0.005, 0.015, 0.05))
def buoyancy(vehicle: Vehicle, share: float) -> Vehicle:
    """The file has too little buoyancy and the right moment: (1 - s) B."""
    return _with_values(vehicle, ("B",), lambda value: (1.0 - share) * value)


@_wrong("righting-arm", "trim_offset", sizes=(0.2, 0.4, 0.6))
def righting_arm(vehicle: Vehicle, share: float) -> Vehicle:
    """The file has the centre of buoyancy too low, and so too small a righting moment: (1 - s) S_z."""
    return _with_values(vehicle, ("S_z",), lambda value: (1.0 - share) * value)


def _with_values(vehicle: Vehicle, names: Sequence[str], change: Callable[[float], float]) -> Vehicle:
    """The vehicle with those of the values changed that it has."""
    known = {n: vehicle.values[n] for n in names if n in vehicle.values}
    return vehicle.with_values({n: replace(v, value=change(v.value)) for n, v in known.items()})


# --- channels -----------------------------------------------------------------------------------
def _rows(run: Run, names: Sequence[str]) -> Array:
    """Channels as rows; zero for those that a log lacks."""
    return np.array([run.channels.get(n, np.zeros(len(run.t))) for n in names])


def _attitude(run: Run) -> Array:
    """Rotations from body to NED, (3, 3, n), by the angles that were logged."""
    return rotation(_rows(run, POSE[3:]))


def _arm(length: float) -> Array:
    return length * np.array([[np.cos(TOWARDS)], [-np.sin(TOWARDS)], [0.0]])


def _with(run: Run, found: Mapping[str, Array]) -> Run:
    """The log with other values in channels that it has."""
    return replace(run, channels={n: found.get(n, old) for n, old in run.channels.items()})


def _distorted(run: Run, commands: Commands, undo: Callable[[Array], Array]) -> Run:
    return _with(run, {name: undo(run.channels[name]) for name in commands})


def _samples(run: Run, seconds: float) -> int:
    """Samples of a time, where they come at even intervals."""
    steps = np.diff(run.t)
    usual = float(np.median(steps))
    if np.max(np.abs(steps - usual)) > _EVEN * usual:
        raise ValueError(f"run {run.name!r} has uneven steps: a delay cannot be put into it exactly")
    return max(round(seconds / usual), 1)


def _turned(angle: Array) -> Array:
    return np.asarray((angle + np.pi) % (2.0 * np.pi) - np.pi)
