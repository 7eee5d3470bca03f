"""Manoeuvres as the models predict them, shrunk until they stay within the limits."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.model.symbols import DOFS
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..compare.drive import late_by
from ..compare.predictor import Predictor
from ..logs import Run
from ..weak.data import WeakData, prepare
from ..weak.step import inverse_of
from .axes import Axis
from .families import Design
from .information import Knowledge
from .limits import MotionLimits, exceeded
from .noise import ChannelNoise

# Shares of the excitation that are tried, largest first.
_SHARES = np.array([0.85, 0.7, 0.55, 0.4, 0.28, 0.18, 0.1])
_REACHES = np.array([1.0, 0.7, 0.5, 0.35, 0.25, 0.17, 0.12, 0.08, 0.05, 0.03, 0.02, 0.01])
# Times that the axes to blame for too large a motion are made smaller; aim inside the limits, least share.
_CORRECTIONS, _INSIDE, _LEAST = 4, 0.95, 0.2
_CAUSES = {
    "speed": {"surge", "sway", "heave"},
    "rate": {"roll", "pitch", "yaw"},
    "depth": {"heave", "roll", "pitch"},
    "tilt": {"roll", "pitch"},
    "distance": {"surge", "sway"},
}
# How long an axis is held to see where it leads, s, and what share of the limits it may use.
_HELD = 12.0
_MOST_SAMPLES = 50_000


@dataclass(frozen=True)
class Plant:
    """A model that can be flown.

    Attributes
    ----------
    functions : Functions
        The model.
    p : (n_parameters,) array
        Values of its parameters.
    predictor : Predictor
        Its simulator.
    """

    functions: Functions
    p: Array
    predictor: Predictor

    @classmethod
    def of(cls, vehicle: Vehicle, *, compiled: bool | None = None) -> Plant:
        """The vehicle with its own values."""
        functions = Functions(vehicle)
        return cls(
            functions, np.array(functions.values(), dtype=float), Predictor(functions, compiled=compiled)
        )

    def reports(self, t: Array, u: Array, motion: Array, p: Array | None = None) -> Array:
        """What the sensors report without noise, shape (b, n, 2n_dof); NaN where it diverges.

        Parameters
        ----------
        t : (n,) array
            Time, s.
        u : (b, n, k) array
            Commands; the first of each have been held for long.
        motion : (2n_dof,) array
            Pose and velocity at the start, without a past.
        p : (n_parameters,) array, optional
            Parameters, by default those of the model.
        """
        p = self.p if p is None else p
        delay = float(self.functions.dead_time(p))
        rest = [np.array(self.functions.rest(one[0], p, 0.0)).ravel() for one in u]
        memory = np.zeros((len(u), self.functions.memory.numel()))
        start = np.column_stack([np.tile(motion, (len(u), 1)), memory, np.array(rest)])
        with np.errstate(over="ignore", invalid="ignore"):
            return self.predictor.simulated(start, np.tile(t, (len(u), 1)), late_by(delay, t, u), p)


@dataclass(frozen=True)
class Flight:
    """A manoeuvre and the motions that the models predict for it.

    Attributes
    ----------
    t : (n,) array
        Time, s.
    u : (n, k) array
        Commands.
    y : tuple of (n, 2n_dof) array
        Reported pose and velocity, one array for each model.
    strain : float
        Largest motion over its limit; at most 1 where the manoeuvre is safe.
    limit : str
        Which limit that is.
    """

    t: Array
    u: Array
    y: tuple[Array, ...]
    strain: float
    limit: str

    @property
    def safe(self) -> bool:
        """Whether every predicted motion stays within the limits."""
        return self.strain <= 1.0


class Airspace:
    """Where manoeuvres are flown: time, actuators, limits, and the models that predict.

    Parameters
    ----------
    plants : sequence of Plant
        Models of the same vehicle; a manoeuvre must be safe by all of them.
    duration, rate : float
        Length of a manoeuvre, s, and samples per second.
    trim : (k,) array
        Commands at rest.
    limits : (k,) array
        Largest commands.
    motion : MotionLimits
        Largest motions.
    noise : ChannelNoise
        Of the log to come.
    depth : float
        Depth at the start, m.
    """

    def __init__(
        self,
        plants: Sequence[Plant],
        duration: float,
        rate: float,
        trim: Array,
        limits: Array,
        motion: MotionLimits,
        noise: ChannelNoise,
        depth: float = 0.0,
    ) -> None:
        self.plants, self.trim, self.limits, self.motion = tuple(plants), trim, limits, motion
        self.noise = noise
        self.t = np.arange(round(duration * rate)) / rate
        self.vehicle = plants[0].functions.vehicle
        self.names = (*self.vehicle.pose_names, *self.vehicle.velocity_names)
        self._start = np.array([depth if n == "z" else 0.0 for n in self.names])

    def without_drift(self) -> Airspace:
        """The same without limits on depth and distance."""
        wide = copy(self)
        wide.motion = replace(self.motion, depth=np.inf, distance=np.inf)
        return wide

    # --- commands -----------------------------------------------------------------------------
    def commands(self, excitation: Array) -> Array:
        """Trim and excitation, the latter shrunk as a whole until no command exceeds its limit."""
        up, down = self.limits - self.trim, self.limits + self.trim
        room = np.where(excitation > 0, up, down)
        strain = np.max(np.abs(excitation) / room, initial=1.0)
        return np.clip(self.trim + excitation / strain, -self.limits, self.limits)

    # --- motions ------------------------------------------------------------------------------
    def fly(self, design: Design) -> Flight:
        """The manoeuvre, as large as the limits of the motion allow: first the axes to blame give way."""
        family = design.family
        sizes = np.ones(len(family.axes))
        for _ in range(_CORRECTIONS):
            flight = self._flown(family.excitation(self.t, design.numbers, sizes))
            if flight.safe:
                return flight
            # Most motions grow about as their cause; one that runs away says little about its cause.
            share = max(_INSIDE / flight.strain, _LEAST) if np.isfinite(flight.strain) else _LEAST
            to_blame = np.array([_drives(axis.name, flight.limit) for axis in family.axes])
            sizes = np.where(to_blame, share * sizes, sizes)
        return self._smaller(family.excitation(self.t, design.numbers, sizes))

    def _smaller(self, excitation: Array) -> Flight:
        u = [self.commands(share * excitation) for share in _SHARES]
        flights = self.flights(u)
        return next((flight for flight in flights if flight.safe), flights[-1])

    def _flown(self, excitation: Array) -> Flight:
        return self.flights([self.commands(excitation)])[0]

    def flights(self, commands: Sequence[Array]) -> list[Flight]:
        """What follows from commands of shape (n, k), whatever they are."""
        motions = [self.predicted(plant, self.t, commands) for plant in self.plants]
        return [self._judged(u, tuple(y[i] for y in motions)) for i, u in enumerate(commands)]

    def _judged(self, u: Array, y: tuple[Array, ...]) -> Flight:
        worst = max((exceeded(one, self.names, self.motion) for one in y), key=lambda pair: pair[1])
        return Flight(self.t, u, y, worst[1], worst[0])

    def predicted(self, plant: Plant, t: Array, commands: Sequence[Array], p: Array | None = None) -> Array:
        """What the sensors report without noise, from rest, shape (b, n, 2n_dof); NaN where it diverges."""
        return plant.reports(t, np.stack(commands), self._start, p)

    # --- the log to come ----------------------------------------------------------------------
    def data(self, flight: Flight, model: int) -> WeakData:
        """A predicted flight as the estimators see a log; noise is what its channels will have."""
        (segment,) = self._still.segments
        measured = np.where(self._seen, flight.y[model], 0.0)
        run = self._run(flight.u, measured)
        return replace(self._still, runs=(run,), segments=(replace(segment, measured=measured, u=flight.u),))

    @cached_property
    def _seen(self) -> NDArray[np.bool_]:
        return np.isfinite(self.noise.sigma)

    @cached_property
    def _still(self) -> WeakData:
        """A log of the same length in which nothing happens: its preparation is always the same."""
        nothing = np.zeros((len(self.t), len(self.limits))), np.zeros((len(self.t), len(self.names)))
        return prepare([self._run(*nothing)], self.vehicle, sigma=self.noise.finite)

    def _run(self, u: Array, measured: Array) -> Run:
        seen = [i for i, known in enumerate(self._seen) if known]
        columns = {self.names[i]: measured[:, i] for i in seen}
        commands = dict(zip(self.vehicle.command_names, u.T, strict=True))
        return Run("plan", self.t, columns | commands, derived=self.noise.derived)

    # --- reach --------------------------------------------------------------------------------
    def reach(self, axes: Sequence[Axis]) -> Array:
        """Largest deflection of every axis, held for a while, that keeps speed, rate and tilt in bounds."""
        t = self.t[: max(int(np.searchsorted(self.t, _HELD)), 3)]
        bounds = self.without_drift().motion
        return np.array([self._reach(axis, t, bounds) for axis in axes])

    def _reach(self, axis: Axis, t: Array, bounds: MotionLimits) -> float:
        signs = (1.0, -1.0)
        shares = [(share, sign) for share in _REACHES for sign in signs]
        u = [np.tile(self.commands(sign * share * axis.pattern[None]), (len(t), 1)) for share, sign in shares]
        strain = np.zeros(len(u))
        for plant in self.plants:
            y = self.predicted(plant, t, u)
            strain = np.maximum(strain, [exceeded(one, self.names, bounds)[1] for one in y])
        fits = strain.reshape(-1, 2).max(axis=1) <= 1.0
        return float(_REACHES[np.argmax(fits)] if fits.any() else _REACHES[-1])


def _drives(axis: str, limit: str) -> bool:
    """Whether an axis is to blame for a motion; a single actuator drives everything."""
    return axis not in DOFS or axis in _CAUSES[limit]


def refuse_samples(duration: float, rate: float) -> None:
    """Refuse lengths and rates that make no manoeuvre.

    Raises
    ------
    UndertowError
        If there are too few or too many samples.
    """
    if not (duration > 0 and rate > 0 and np.isfinite(duration * rate)):
        raise UndertowError(
            f"a manoeuvre of {duration:g} s at {rate:g} samples/s is none: give positive numbers"
        )
    samples = round(duration * rate)
    if not 50 <= samples <= _MOST_SAMPLES:
        raise UndertowError(
            f"{duration:g} s at {rate:g} samples/s are {samples} samples: give a --duration and a --rate "
            f"that make 50 to {_MOST_SAMPLES}"
        )


# --- how far off the predicted depth may be -------------------------------------------------------
# What a value without a stated error may be off by, as a share of it.
_LOOSE = 0.3
# Step of the differences, as a share of a parameter's size.
_STEP = 1e-2


def depth_spread(space: Airspace, plant: Plant, known: Knowledge, flight: Flight) -> float | None:
    """Two standard deviations of the largest error of the predicted depth, m; None without a depth.

    A parameter without a stated error counts as known to 30 %.
    """
    if "z" not in space.names or not known.free:
        return None
    stated = known.prior + known.logs
    silent = np.diag(stated) <= 0
    covariance = inverse_of(stated + np.diag(silent * (_LOOSE * known.scale) ** -2.0))
    table = np.array(
        [_slope(space, plant, flight, n, s) for n, s in zip(known.free, known.scale, strict=True)]
    )
    variance = np.einsum("it,ij,jt->t", table, covariance, table)
    return float(2 * np.sqrt(np.max(np.nan_to_num(variance, nan=0.0))))


def _slope(space: Airspace, plant: Plant, flight: Flight, name: str, scale: float) -> Array:
    """Derivative of the depth along a flight, shape (n,)."""
    place, column = plant.functions.parameter_names.index(name), space.names.index("z")
    ends = []
    for sign in (1.0, -1.0):
        p = plant.p.copy()
        p[place] += sign * _STEP * scale
        ends.append(space.predicted(plant, flight.t, [flight.u], p)[0][:, column])
    return np.asarray((ends[0] - ends[1]) / (2 * _STEP * scale))
