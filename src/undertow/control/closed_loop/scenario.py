"""The task of a closed loop: start and goal, duration, sampling, and disturbances."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from undertow.errors import UndertowError, refuse_unknown
from undertow.model.symbols import FASTEST, FORCE_UNITS, MOTION_UNITS
from undertow.model.tables import Quantity
from undertow.model.units import si_of


@dataclass(frozen=True)
class RunSettings:
    """How many samples a run may have, and how they are simulated."""

    most_samples: int = 50_000_000  # of a run, or steps of one without sampling
    samples_per_call: int = 20_000  # that are simulated at a time
    rows: int = 5000  # that are recorded, about, where no interval is stated


RUNS = RunSettings()


@dataclass(frozen=True)
class Push:
    """A force on the vehicle that the controller does not know of."""

    axis: str  # X, Y, Z, K, M or N, body frame
    value: float  # N or N m
    # begin, end: when it acts, s
    begin: float = 0.0
    end: float = math.inf

    def __post_init__(self) -> None:
        if not (math.isfinite(self.value) and self.begin < self.end):
            raise UndertowError(
                f"push {self.axis} = {self.value:g} from {self.begin:g} to {self.end:g} s is not finite or "
                "ends before it begins: give a finite value, and the earlier time first"
            )


@dataclass(frozen=True)
class Scenario:
    """One run of a closed loop."""

    # Desired position and, if wanted, heading, or the whole desired pose; in the order of the vehicle's pose
    # coordinates, numbers in SI or quantities such as "135 deg". Missions have their own.
    to: Sequence[Quantity] = ()
    duration: float = 240.0  # length of the run, s
    dt: float = 0.001  # sampling interval of the controller, s
    start: Sequence[Quantity] = ()  # where the vehicle begins, as `to`; missing coordinates are zero
    # Body velocities that it begins with, SI, by name; at rest by default. Of parameters that differ by
    # direction the mean holds at exactly zero velocity.
    moving: Mapping[str, float] = field(default_factory=dict)
    # whether the law acts without sampling, at every stage of the integration with steps of at most dt
    continuous: bool = False
    # standard deviation of what a sensor adds to each sample, SI, by channel (x ... psi, u ... r)
    noise: Mapping[str, float] = field(default_factory=dict)
    seed: int = 0  # of the noise
    pushes: tuple[Push, ...] = ()  # forces that disturb
    log_interval: float | None = None  # interval of the recorded rows, s; by default about 5000 rows

    def __post_init__(self) -> None:
        for name, value in (("length of the run", self.duration), ("dt", self.dt)):
            if not 0 < value < math.inf:
                raise UndertowError(f"{name} = {value:g} s is too short: give a time above zero")
        if self.duration < self.dt:
            raise UndertowError(
                f"dt = {self.dt:g} s is longer than the run of {self.duration:g} s: shorten it"
            )
        if self.duration / self.dt > RUNS.most_samples:
            raise UndertowError(
                f"{self.duration:g} s at dt = {self.dt:g} s are {self.duration / self.dt:.3g} samples, but "
                f"{RUNS.most_samples:.0e} is the limit: shorten the run or lengthen dt"
            )
        if self.log_interval is not None and not self.dt <= self.log_interval <= self.duration:
            raise UndertowError(
                f"interval of the log = {self.log_interval:g} s: give one from dt = {self.dt:g} s to the "
                f"length of the run, {self.duration:g} s"
            )
        if self.continuous and any(self.noise.values()):
            raise UndertowError("noise needs a sampled law: leave out the noise or --continuous")
        if self.seed < 0:
            raise UndertowError(f"seed {self.seed} is below zero: give a whole number from 0 on")

    @property
    def samples(self) -> int:
        """Number of samples, the one at the end included."""
        return round(self.duration / self.dt) + 1

    @property
    def stride(self) -> int:
        """Samples from one recorded row to the next."""
        if self.log_interval is None:
            return max((self.samples - 1) // RUNS.rows, 1)
        return max(round(self.log_interval / self.dt), 1)

    def pose(self, values: Sequence[Quantity], names: tuple[str, ...], what: str) -> dict[str, float]:
        """Coordinates by name; which ones a number of values stands for follows from the vehicle."""
        upright = [n for n in names if n not in ("phi", "theta")]
        flat = [n for n in upright if n != "psi"]
        for known in (flat, upright, list(names)):
            if len(values) == len(known):
                units = (MOTION_UNITS[n] for n in known)
                return {n: si_of(f"{what} {n}", v, u) for n, v, u in zip(known, values, units, strict=True)}
        raise UndertowError(
            f"{what} has {len(values)} values: give {len(flat)} ({','.join(flat)}), or {len(upright)} with "
            f"the heading ({','.join(upright)})"
        )

    def velocity(self, names: tuple[str, ...]) -> np.ndarray:
        """First body velocity, shape (n,)."""
        refuse_unknown(self.moving, names, "the vehicle has no velocity ", "", "it has")
        for name, value in self.moving.items():
            if not abs(value) <= FASTEST:
                raise UndertowError(
                    f"first {name} = {value:g} {MOTION_UNITS[name]}: that is impossible in water; stay "
                    f"within {FASTEST:g}"
                )
        return np.array([self.moving.get(n, 0.0) for n in names])

    def noise_of(self, names: tuple[str, ...]) -> np.ndarray:
        """Standard deviation for each of the channels of a vehicle, shape (n,)."""
        refuse_unknown(self.noise, names, "noise for ", ", which is not reported", "channels are")
        for name, value in self.noise.items():
            if not 0 <= value < math.inf:
                raise UndertowError(f"noise of {name} = {value:g}: give a standard deviation, zero or above")
        return np.array([self.noise.get(name, 0.0) for name in names])


def force_unit(axis: str) -> str:
    """Unit of a force or moment: X, Y, Z in N, K, M, N in N m."""
    return FORCE_UNITS["XYZKMN".index(axis)]


def heading(rule: str, start: Mapping[str, float], to: Mapping[str, float]) -> float:
    """Heading from the start to the set-point, rad: (42) of the mini-AUV paper, or its four-quadrant form.

    If there is no distance in the plane, the initial heading is kept.
    """
    north, east = to["x"] - start["x"], to["y"] - start["y"]
    if not (north or east):
        return start["psi"]
    if rule == "atan2":
        return math.atan2(east, north)
    return math.atan(east / north) if north else math.copysign(math.pi / 2, east)
