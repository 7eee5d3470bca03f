"""Manoeuvres as the models predict them, and what they tell of the parameters (Fisher information)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.estimation.data import WeakData, prepare
from undertow.identification.estimation.predictor import Predictor
from undertow.identification.estimation.residual import WeakModel, whitened
from undertow.identification.estimation.step import inverse_of, prior_of
from undertow.identification.estimation.weak_form import WeakFit, fit_weak
from undertow.identification.estimation.windows import late_by
from undertow.identification.logs.run import Run
from undertow.model.symbols import DOFS
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from .manoeuvres import (
    Axis,
    ChannelNoise,
    CommandLimits,
    Design,
    Family,
    MotionLimits,
    Trim,
    command_limits,
    every_axis,
    exceeded,
    families,
    planned_noise,
    trim,
)

# A parameter of which nothing is known may be off by this many times its size.
_VAGUE = 100.0
# It counts as unknown as long as its standard error is a good part of that.
_UNKNOWN = 0.3
# Errors so many times wider than by noise alone are worth a remark.
_WIDE = 1.5
# Beyond this, fitted values make up for what is missing, and those of the vehicle file are better ones.
_MISFIT = 5.0


@dataclass(frozen=True)
class Knowledge:
    """What is known of the free parameters before a manoeuvre.

    Attributes
    ----------
    vehicle : Vehicle
        The model at the values that are planned with.
    free : tuple of str
        Parameters to be determined.
    prior : (k, k) array
        Information of the stated standard deviations.
    logs : (k, k) array
        Information in the logs, as far as what the model leaves in them allows.
    spread : (k,) array
        How many times wider errors were on the logs than noise alone would make them, at least 1.
    """

    vehicle: Vehicle
    free: tuple[str, ...]
    prior: Array
    logs: Array
    spread: Array

    @property
    def misfit(self) -> float:
        """Median of the spread."""
        return float(np.median(self.spread)) if len(self.spread) else 1.0

    @cached_property
    def scale(self) -> Array:
        """Size of every parameter: its value, else what is stated of its error, else one."""
        values = [self.vehicle.value_of(n) for n in self.free]
        return np.array([abs(v.value) or v.sigma or 1.0 for v in values])

    @cached_property
    def vague(self) -> Array:
        """Information that keeps what nothing determines finite, shape (k, k)."""
        return np.diag((_VAGUE * self.scale) ** -2.0)

    @cached_property
    def now(self) -> Array:
        """Information before the manoeuvre, shape (k, k)."""
        return self.prior + self.logs + self.vague

    def after(self, gram: Array) -> Array:
        """Information after a manoeuvre with the information `gram` by noise alone, shape (k, k)."""
        return np.asarray(self.now + gram / np.outer(self.spread, self.spread))

    def errors(self, information: Array) -> Array:
        """Standard errors, shape (k,); inf for a parameter that is not known."""
        found = np.sqrt(np.diag(inverse_of(information)))
        return np.where(found < _UNKNOWN * _VAGUE * self.scale, found, np.inf)


def knowledge(vehicle: Vehicle, free: Sequence[str], runs: Sequence[Run]) -> Knowledge:
    """What the vehicle file and logs say.

    With logs, the model is fitted to them and planned with at the fitted values, unless these make up for
    something that the model lacks.

    Raises
    ------
    UndertowError
        If the logs do not fit the vehicle or are too short.
    """
    if not runs:
        return stated(vehicle, free)
    known = knowledge_of(fit_weak(vehicle, prepare(runs, vehicle), free), runs)
    return replace(known, vehicle=vehicle) if known.misfit >= _MISFIT else known


def stated(vehicle: Vehicle, free: Sequence[str]) -> Knowledge:
    """What the vehicle file says."""
    nothing = np.zeros((len(free), len(free)))
    return Knowledge(vehicle, tuple(free), _prior(vehicle, free), nothing, np.ones(len(free)))


def knowledge_of(fit: WeakFit, runs: Sequence[Run]) -> Knowledge:
    """What a fit to logs says, with the priors of the vehicle file as far as these are no such fit."""
    logs, spread = _told_by(fit)
    before = fit.model.functions.vehicle
    new = [n if not _fitted_to(before, n, runs) else None for n in fit.model.free]
    return Knowledge(fit.vehicle, fit.model.free, _prior(before, new), logs, spread)


def _prior(vehicle: Vehicle, names: Sequence[str | None]) -> Array:
    sigma = [None if n is None else vehicle.value_of(n).sigma for n in names]
    return np.diag([0.0 if not s else s**-2.0 for s in sigma])


def remarks_on(known: Knowledge, runs: Sequence[Run]) -> list[str]:
    """What to know about the numbers before a manoeuvre."""
    if not runs:
        return ["no logs are given: what is known now is what the vehicle file states"]
    remarks = []
    twice = [n for n in known.free if _fitted_to(known.vehicle, n, runs)]
    if twice:
        names = ", ".join(twice)
        remarks.append(f"stated errors of {names} come from a fit to these logs and do not count again")
    widest = float(np.max(known.spread, initial=1.0))
    if known.misfit >= _MISFIT:
        remarks.append(
            "the model misses too much of these logs to fit it: planned with the values of its file"
        )
    if widest > _WIDE:
        remarks.append(
            f"the model leaves more than noise on these logs: errors are up to {widest:.2g} times as wide as "
            "by noise alone, now and after the manoeuvre; undertow diagnose looks for what is missing"
        )
    return remarks


def _fitted_to(vehicle: Vehicle, name: str, runs: Sequence[Run]) -> bool:
    """Whether the file says that a value comes from a fit to one of these logs."""
    told, _, _ = vehicle.value_of(name).source.partition("; before: ")
    return told.startswith("fit to ") and any(run.name in told for run in runs)


def _told_by(fit: WeakFit) -> tuple[Array, Array]:
    """Information of logs, and how much wider than by noise alone the errors are."""
    weak_prior = np.diag(prior_of(fit.model)[1] ** 2)
    robust = np.sqrt(np.diag(fit.covariance) / np.maximum(np.diag(inverse_of(fit.information)), 1e-300))
    logs = fit.gram / np.outer(robust, robust)
    parts = fit.model.linearise(fit.data, fit.p)
    quiet = whitened(parts, fit.model.whitening(fit.data, fit.p)).J
    best = np.diag(inverse_of(quiet.T @ quiet + weak_prior))
    spread = np.sqrt(np.diag(inverse_of(logs + weak_prior)) / np.maximum(best, 1e-300))
    return logs, np.maximum(spread, 1.0)


def gram_along(model: WeakModel, data: WeakData, p: Array) -> Array | None:
    """Information that a log will hold on the free parameters by noise alone, shape (k, k).

    Parameters
    ----------
    model : WeakModel
        The model and its free parameters.
    data : WeakData
        The log as it is predicted, without noise but with the noise that its channels will have.
    p : (n_parameters,) array
        All parameters.

    Returns
    -------
    (k, k) array or None
        None where the residual is not finite.
    """
    at = whitened(model.linearise(data, p), model.whitening(data, p))
    return np.asarray(at.J.T @ at.J) if np.isfinite(at.J).all() else None


def log_determinant(information: Array, wanted: Sequence[int]) -> float:
    """Logarithm of the determinant of the information on some parameters, the others being free, too."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-300))
    scaled = information * np.outer(scale, scale)
    others = [i for i in range(len(scale)) if i not in wanted]
    whole = np.linalg.slogdet(scaled)[1] - 2 * np.sum(np.log(scale))
    if not others:
        return float(whole)
    rest = np.linalg.slogdet(scaled[np.ix_(others, others)])[1] - 2 * np.sum(np.log(scale[others]))
    return float(whole - rest)


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


# Work that a search takes by default, in seconds of a usual machine: the number of manoeuvres follows from
# the sizes alone, so that it is the same everywhere.
_SECONDS, _PER_CALL, _PER_NUMBER = 9.0, 6e-3, 8e-8
_FEWEST_TRIES, _MOST_TRIES = 60, 600


@dataclass(frozen=True)
class Request:
    """What is asked of a plan.

    Attributes
    ----------
    duration : float
        Length, s.
    rate : float
        Samples per second, of the commands and of the log to come.
    limits : mapping
        Largest commands by name; "" for all that are not named.
    noise : mapping
        Standard deviation of the noise by channel, SI; inf for one that is not measured.
    motion : MotionLimits
        Largest motions.
    depth : float, optional
        Depth at the start, m; by default that of the logs, or 0.
    seed : int
        Of the random numbers.
    tries : int, optional
        Manoeuvres to be judged; by default as many as take some ten seconds.
    compiled : bool, optional
        As for `Simulator`.
    report : callable
        Told what share is done, and what is being done.
    """

    duration: float = 60.0
    rate: float = 20.0
    limits: Mapping[str, float] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    motion: MotionLimits = field(default_factory=MotionLimits)
    depth: float | None = None
    seed: int = 0
    tries: int | None = None
    compiled: bool | None = None
    report: Progress = lambda done, words: None


class Ground:
    """A request made concrete for a vehicle and its logs.

    Parameters
    ----------
    request : Request
        What is asked.
    vehicle : Vehicle
        The model without rivals.
    plants : sequence of Plant
        The models that predict; the first holds the actuators in trim.
    runs : sequence of Run
        Logs.
    """

    def __init__(
        self, request: Request, vehicle: Vehicle, plants: Sequence[Plant], runs: Sequence[Run]
    ) -> None:
        refuse_samples(request.duration, request.rate)
        self.request, self.vehicle, self.runs = request, vehicle, tuple(runs)
        self.commands: CommandLimits = command_limits(vehicle, request.limits, runs)
        if not len(self.commands.value):
            raise UndertowError(
                f"'{vehicle.name}' has no thruster and no known force: nothing can be planned"
            )
        self.noise: ChannelNoise = planned_noise(vehicle, request.noise, runs)
        self.trim: Trim = trim(plants[0].functions, self.commands.value, self.depth)
        self.space = Airspace(
            plants,
            request.duration,
            request.rate,
            self.trim.commands,
            self.commands.value,
            request.motion,
            self.noise,
            self.depth,
        )

    @property
    def depth(self) -> float:
        """Depth at the start, m."""
        if self.request.depth is not None:
            return self.request.depth
        seen = [float(np.nanmedian(r.channels["z"])) for r in self.runs if r.has("z")]
        return float(np.median(seen)) if seen else 0.0

    @cached_property
    def families(self) -> list[Family]:
        """All manoeuvres that can be flown."""
        motions, actuators = every_axis(self.vehicle, self.commands.value - np.abs(self.trim.commands))
        return families([(axes, self.space.reach(axes)) for axes in (motions, actuators) if axes])

    def tries(self, columns: int, calls: int = 1) -> int:
        """How many manoeuvres to judge, when each takes so many sensitivities in so many calls."""
        if self.request.tries is not None:
            return self.request.tries
        states = 2 * len(self.vehicle.degrees_of_freedom)
        seconds = _PER_CALL * calls + _PER_NUMBER * len(self.space.t) * states * columns
        return int(np.clip(_SECONDS / seconds, _FEWEST_TRIES, _MOST_TRIES))

    def refuse_unsafe(self, strained: Flight | None) -> None:
        """Say that no manoeuvre stays within the limits.

        Raises
        ------
        UndertowError
            Always; the limit that the gentlest manoeuvre exceeds is named.
        """
        name = "speed" if strained is None else strained.limit
        option = {"depth": "--max-depth-change"}.get(name, f"--max-{name}")
        why = "".join(
            f"; the actuators cannot balance {value:.3g} N (or N m) in {dof} at rest"
            for dof, value in self.trim.left.items()
        )
        raise UndertowError(
            f"no manoeuvre of {self.request.duration:g} s stays within the limits, {option} is exceeded "
            f"most{why}: raise it, or plan a shorter manoeuvre"
        )
