"""The planning problem: prior knowledge, models, actuators and limits; and the result of a plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.files import json_ready
from undertow.identification.estimation.data import WeakData, inverse_of, prepare
from undertow.identification.estimation.predictor import Predictor
from undertow.identification.estimation.residual import WeakModel, whitened
from undertow.identification.estimation.step import prior_of
from undertow.identification.estimation.weak_form import WeakFit, fit_weak
from undertow.identification.estimation.windows import delayed_series
from undertow.identification.findings import LongLogs, ResultTable
from undertow.identification.logs.run import Run
from undertow.model.parameter import printed
from undertow.model.symbols import DOFS
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from . import manoeuvres
from .manoeuvres import Axis, Design, Family, Limit, MotionLimits, Start


@dataclass(frozen=True)
class PlanningSettings:
    """Settings of planning."""

    unknown_sigma: float = 100.0  # prior of a parameter of which nothing is known, in units of its size
    unknown: float = 0.3  # it counts as unknown as long as its standard error is this share of that prior
    badly_known: float = 0.3  # so is one with a standard error above this share of its value
    # A manoeuvre determines a parameter whose error it brings below this share of what it was.
    determined: float = 0.3
    remarked: float = 1.5  # factor by which errors exceed those of noise alone from which on a remark says so
    # From this factor on fitted values make up for what is missing: those of the vehicle file are better.
    misfit: float = 5.0
    # Shares of the excitation, and deflections of an axis, that are tried, the largest first.
    shares: tuple[float, ...] = (0.85, 0.7, 0.55, 0.4, 0.28, 0.18, 0.1)
    reaches: tuple[float, ...] = (1.0, 0.7, 0.5, 0.35, 0.25, 0.17, 0.12, 0.08, 0.05, 0.03, 0.02, 0.01)
    # How often axes that make a motion too large are reduced, to which share of the limit, how far at once.
    corrections: int = 4
    limit_share: float = 0.95
    least_share: float = 0.2
    held: float = 12.0  # how long an axis is deflected to predict the motion that it causes, s
    # Length, s, and samples per second of a manoeuvre without logs to take them from, and the longest that is
    # taken from logs.
    duration: float = 60.0
    rate: float = 20.0
    longest: float = 1200.0
    enough_samples: int = 4000  # above which the rate is lower than that of the logs
    fewest_samples: int = 50
    most_samples: int = 50_000
    beginning: int = 20  # one of this many equal parts of a log is its beginning
    moving: float = 0.5  # share of its rms speed above which a vehicle is under way there
    assumed_error: float = 0.3  # error of a value without a stated one, as a share of it, for the depth
    step: float = 1e-2  # of the differences of the depth, as a share of a parameter's size
    # Work of a search by default, in seconds of a usual machine: the number of manoeuvres follows from the
    # sizes alone, so that it is the same everywhere.
    seconds: float = 9.0
    per_call: float = 6e-3
    per_number: float = 8e-8
    fewest_tries: int = 60
    most_tries: int = 600


SETTINGS = PlanningSettings()


@dataclass(frozen=True)
class Knowledge:
    """Knowledge of the free parameters before a manoeuvre."""

    vehicle: Vehicle  # the model at the values that are planned with
    free: tuple[str, ...]  # parameters to be determined
    prior: Array  # (k, k) information of the stated standard deviations
    logs: Array  # (k, k) information in the logs, as far as what the model leaves in them allows
    inflation: Array  # (k,) factor by which errors on the logs exceed those of noise alone, at least 1

    @property
    def misfit(self) -> float:
        """Median of the inflation."""
        return float(np.median(self.inflation)) if len(self.inflation) else 1.0

    @cached_property
    def scale(self) -> Array:
        """Size of every parameter: its value, else what is stated of its error, else one."""
        values = [self.vehicle.value_of(n) for n in self.free]
        return np.array([abs(v.value) or v.sigma or 1.0 for v in values])

    @cached_property
    def now(self) -> Array:
        """Information before the manoeuvre, (k, k), finite also where nothing is known."""
        return self.prior + self.logs + np.diag((SETTINGS.unknown_sigma * self.scale) ** -2.0)

    def after(self, gram: Array) -> Array:
        """Information after a manoeuvre with the information `gram` by noise alone, shape (k, k)."""
        return np.asarray(self.now + gram / np.outer(self.inflation, self.inflation))

    def errors(self, information: Array) -> Array:
        """Standard errors, shape (k,); inf for a parameter that is not known."""
        found = np.sqrt(np.diag(inverse_of(information)))
        return np.where(found < SETTINGS.unknown * SETTINGS.unknown_sigma * self.scale, found, np.inf)


def knowledge(vehicle: Vehicle, free: Sequence[str], runs: Sequence[Run]) -> Knowledge:
    """Knowledge from the vehicle file and logs.

    With logs, the model is fitted to them and planned with at the fitted values, unless these compensate for
    a missing effect.
    """
    if not runs:
        return stated_knowledge(vehicle, free)
    known = knowledge_from_fit(fit_weak(vehicle, prepare(runs, vehicle), free), runs)
    return replace(known, vehicle=vehicle) if known.misfit >= SETTINGS.misfit else known


def stated_knowledge(vehicle: Vehicle, free: Sequence[str]) -> Knowledge:
    """Knowledge from the vehicle file alone."""
    no_logs = np.zeros((len(free), len(free)))
    return Knowledge(vehicle, tuple(free), _prior(vehicle, free), no_logs, np.ones(len(free)))


def knowledge_from_fit(fit: WeakFit, runs: Sequence[Run]) -> Knowledge:
    """Knowledge from a fit to logs, with the priors of the vehicle file unless they come from that fit."""
    logs, inflation = _information_of_logs(fit)
    before = fit.model.functions.vehicle
    new = [n if not _fitted_to(before, n, runs) else None for n in fit.model.free]
    return Knowledge(fit.vehicle, fit.model.free, _prior(before, new), logs, inflation)


def _prior(vehicle: Vehicle, names: Sequence[str | None]) -> Array:
    sigma = [None if n is None else vehicle.value_of(n).sigma for n in names]
    return np.diag([0.0 if not s else s**-2.0 for s in sigma])


def remarks_on(known: Knowledge, runs: Sequence[Run]) -> list[str]:
    """Remarks on the numbers before a manoeuvre."""
    if not runs:
        return ["no logs are given: present knowledge is what the vehicle file states"]
    remarks = []
    twice = [n for n in known.free if _fitted_to(known.vehicle, n, runs)]
    if twice:
        names = ", ".join(twice)
        remarks.append(f"stated errors of {names} come from a fit to these logs and are not counted twice")
    worst = float(np.max(known.inflation, initial=1.0))
    if known.misfit >= SETTINGS.misfit:
        remarks.append(
            "the model fits these logs too poorly to estimate from them: planned with the values in its file"
        )
    if worst > SETTINGS.remarked:
        remarks.append(
            f"the model leaves a residual above the noise on these logs: errors are up to {worst:.2g} times "
            "as large as from noise alone, now and after the manoeuvre; undertow diagnose looks for what is "
            "missing"
        )
    return remarks


def _fitted_to(vehicle: Vehicle, name: str, runs: Sequence[Run]) -> bool:
    """Whether a value in the vehicle file comes from a fit to one of these logs."""
    source, _, _ = vehicle.value_of(name).source.partition("; before: ")
    return source.startswith("fit to ") and any(run.name in source for run in runs)


def _information_of_logs(fit: WeakFit) -> tuple[Array, Array]:
    """Information of logs, and the factor by which errors exceed those due to noise alone."""
    weak_prior = np.diag(prior_of(fit.model)[1] ** 2)
    robust = np.sqrt(np.diag(fit.covariance) / np.maximum(np.diag(inverse_of(fit.information)), 1e-300))
    logs = fit.gram / np.outer(robust, robust)
    by_noise = np.diag(inverse_of(fit.noise_gram + weak_prior))
    inflation = np.sqrt(np.diag(inverse_of(logs + weak_prior)) / np.maximum(by_noise, 1e-300))
    return logs, np.maximum(inflation, 1.0)


def gram_along(model: WeakModel, data: WeakData, p: Array) -> Array | None:
    """Information that a log will hold on the free parameters by noise alone, (k, k).

    `data` is the log as predicted, with the noise levels to come; None where the residual is not finite.
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


@dataclass(frozen=True)
class Plant:
    """A model that can be simulated."""

    functions: Functions
    p: Array  # (n_parameters,) values of its parameters
    predictor: Predictor

    @classmethod
    def of(cls, vehicle: Vehicle, *, compiled: bool | None = None) -> Plant:
        """The vehicle with its own values."""
        functions = Functions(vehicle)
        values = np.array(functions.values(), dtype=float)
        return cls(functions, values, Predictor(functions, compiled=compiled))

    def outputs(self, t: Array, u: Array, motion: Array, p: Array | None = None) -> Array:
        """Outputs of the sensors without noise, (b, n, 2n_dof), for commands u of shape (b, n, k).

        The first commands have been held for long; `motion` (2n_dof,) is the pose and velocity at the start.
        NaN where the simulation diverges.
        """
        p = self.p if p is None else p
        delay = float(self.functions.dead_time(p))
        rest = [np.array(self.functions.rest(one[0], p, 0.0)).ravel() for one in u]
        memory = np.zeros((len(u), self.functions.memory.numel()))
        start = np.column_stack([np.tile(motion, (len(u), 1)), memory, np.array(rest)])
        with np.errstate(over="ignore", invalid="ignore"):
            return self.predictor.simulated(start, np.tile(t, (len(u), 1)), delayed_series(delay, t, u), p)


@dataclass(frozen=True)
class Manoeuvre:
    """Commands and the motions that the models predict for them."""

    t: Array  # (n,) time, s
    u: Array  # (n, k) commands
    y: tuple[Array, ...]  # reported pose and velocity, (n, 2n_dof) for each model
    limit_ratio: float  # largest motion over its limit; at most 1 where the manoeuvre is safe
    limit: str  # which limit that is

    @property
    def safe(self) -> bool:
        """Whether every predicted motion stays within the limits."""
        return self.limit_ratio <= 1.0


@dataclass(frozen=True)
class PlanRequest:
    """The request for a plan."""

    duration: float | None = None  # length, s; by default that of the logs, or 60
    # Samples per second, of the commands and of the log to come; by default those of the logs, 20 at most.
    rate: float | None = None
    # Largest commands, or lowest and highest ones, by name; "" for all that are not named.
    limits: Mapping[str, Limit] = field(default_factory=dict)
    # Standard deviation of the noise by channel, SI; inf for one that is not measured.
    noise: Mapping[str, float] = field(default_factory=dict)
    motion: MotionLimits = field(default_factory=MotionLimits)  # largest motions
    depth: float | None = None  # depth at the start, m; by default that of the logs, or 0
    speed: float | None = None  # speed ahead at the start, m/s; by default that of the logs there, or 0
    seed: int = 0
    tries: int | None = None  # manoeuvres to be simulated; by default as many as take some ten seconds
    compiled: bool | None = None  # as for `Simulator`
    report: Progress = lambda done, words: None  # receives the share that is done, and what is being done

    def sampling(self, runs: Sequence[Run]) -> tuple[float, float]:
        """Length, s, and samples per second; what is not stated is that of the logs, two digits of it."""
        duration, rate = SETTINGS.duration, SETTINGS.rate
        if runs:
            duration = min(float(np.median([r.t[-1] - r.t[0] for r in runs])), SETTINGS.longest)
            rate = min(1.0 / float(np.median([r.step for r in runs])), rate)
        duration = float(f"{duration:.2g}") if self.duration is None else self.duration
        rate = min(rate, SETTINGS.enough_samples / max(duration, 1e-9)) if runs else rate
        rate = float(f"{rate:.2g}") if self.rate is None else self.rate
        if not (duration > 0 and rate > 0 and np.isfinite(duration * rate)):
            raise UndertowError(
                f"a manoeuvre of {duration:g} s at {rate:g} samples/s is impossible: give positive numbers"
            )
        samples = round(duration * rate)
        if not SETTINGS.fewest_samples <= samples <= SETTINGS.most_samples:
            raise UndertowError(
                f"{duration:g} s at {rate:g} samples/s are {samples} samples: give a --duration and a "
                f"--rate that make {SETTINGS.fewest_samples} to {SETTINGS.most_samples}"
            )
        return duration, rate


# Axes that a motion depends on.
_CAUSES = {
    "speed": {"surge", "sway", "heave"},
    "rate": {"roll", "pitch", "yaw"},
    "depth": {"heave", "roll", "pitch"},
    "tilt": {"roll", "pitch"},
    "distance": {"surge", "sway"},
}


class PlanningProblem:
    """A request made concrete for a vehicle and its logs: time, actuators, limits, noise and models."""

    # Of several models of the vehicle, a manoeuvre must be safe by all, and the first one is held in trim.

    def __init__(
        self, request: PlanRequest, vehicle: Vehicle, plants: Sequence[Plant], runs: Sequence[Run]
    ) -> None:
        self.duration, self.rate = request.sampling(runs)
        self.request, self.vehicle, self.runs = request, vehicle, tuple(runs)
        self.plants, self.motion = tuple(plants), request.motion
        self.limits = manoeuvres.command_limits(vehicle, request.limits, runs)
        if not len(self.limits.value):
            raise UndertowError(
                f"'{vehicle.name}' has no thruster and no known force, so nothing can be planned"
            )
        self.noise = manoeuvres.planned_noise(vehicle, request.noise, runs)
        start, functions = Start(self.depth, self.speed), plants[0].functions
        self.effectiveness = manoeuvres.control_effectiveness(functions, self.limits, start)
        self.trim = manoeuvres.trim(functions, self.limits, self.effectiveness, start)
        self.steered = manoeuvres.steering(functions, self.limits, start, self.effectiveness)
        self.bias, self._room = self.limits.bias_and_room(self.trim.commands)
        self.t = np.arange(round(self.duration * self.rate)) / self.rate
        self.names = (*vehicle.pose_names, *vehicle.velocity_names)
        self._start = start.motion(vehicle)

    @property
    def depth(self) -> float:
        """Depth at the start, m."""
        if self.request.depth is not None:
            return self.request.depth
        seen = [float(np.nanmedian(r.channels["z"])) for r in self.runs if r.has("z")]
        return float(np.median(seen)) if seen else 0.0

    @property
    def speed(self) -> float:
        """Speed ahead at the start, m/s: that at which the logs begin, if they begin under way."""
        if self.request.speed is not None or "surge" not in self.vehicle.degrees_of_freedom:
            return self.request.speed or 0.0
        ahead = [r.channels["u"] for r in self.runs if r.has("u")]
        if not ahead:
            return 0.0
        start = float(np.median([np.nanmedian(u[: max(len(u) // SETTINGS.beginning, 1)]) for u in ahead]))
        rms = float(np.sqrt(np.nanmean(np.concatenate(ahead) ** 2)))
        return start if abs(start) > SETTINGS.moving * rms else 0.0

    def without_drift(self) -> PlanningProblem:
        """The same without limits on depth and distance."""
        without = copy(self)
        without.motion = replace(self.motion, depth=np.inf, distance=np.inf)
        return without

    @cached_property
    def families(self) -> list[Family]:
        """All manoeuvres that can be carried out."""
        motions, actuators = manoeuvres.every_axis(self.vehicle, self.effectiveness, self._room)
        groups = [(axes, self.reach(axes)) for axes in (motions, actuators) if axes]
        return manoeuvres.families(groups, self.steered)

    def tries(self, columns: int, calls: int = 1) -> int:
        """How many manoeuvres to simulate, when each takes so many sensitivities in so many calls."""
        if self.request.tries is not None:
            return self.request.tries
        states, s = 2 * len(self.vehicle.degrees_of_freedom), SETTINGS
        seconds = s.per_call * calls + s.per_number * len(self.t) * states * columns
        return int(np.clip(s.seconds / seconds, s.fewest_tries, s.most_tries))

    def refuse_unsafe(self, gentlest: Manoeuvre | None) -> None:
        """Raise an error: no manoeuvre stays within the limits, and which one the gentlest exceeds."""
        name = "speed" if gentlest is None else gentlest.limit
        option = {"depth": "--max-depth-change"}.get(name, f"--max-{name}")
        why = "".join(
            f"; the actuators cannot balance {value:.3g} N (or N m) in {dof} at the start"
            for dof, value in self.trim.unbalanced.items()
        )
        raise UndertowError(
            f"no manoeuvre of {self.duration:g} s stays within the limits; {option} is exceeded "
            f"most{why}: raise it, or plan a shorter manoeuvre"
        )

    # --- manoeuvres ---------------------------------------------------------------------------
    def commands(self, excitation: Array) -> Array:
        """Trim and excitation, the latter shrunk as a whole until no command exceeds its limit.

        What rests at its limit stays there rather.
        """
        at_rest, low, high = self.trim.commands, self.limits.low, self.limits.high
        room = np.where(excitation > 0, high - at_rest, at_rest - low)
        held = (self.bias != 0.0) & (excitation * self.bias < 0.0)
        ratio = np.max(np.abs(excitation) / np.where(held, np.inf, np.maximum(room, 1e-300)), initial=1.0)
        return np.clip(at_rest + excitation / ratio, low, high)

    def excitation(self, design: Design, sizes: Array) -> Array:
        """Commands of a manoeuvre beyond the trim, with their bias, (n, k)."""
        bias = np.min(sizes) * manoeuvres.taper(self.t)[:, None] * self.safe_bias
        return bias + design.family.excitation(self.t, design.numbers, sizes)

    def simulated(self, design: Design) -> Manoeuvre:
        """The manoeuvre, reduced until the motion is within its limits: first on the axes that cause it."""
        family, s = design.family, SETTINGS
        sizes = np.ones(len(family.axes))
        for _ in range(s.corrections):
            u = self.commands(self.excitation(design, sizes))
            manoeuvre = self.manoeuvres([u])[0]
            if manoeuvre.safe:
                return manoeuvre
            # Most motions grow about in proportion to their cause, but not one that diverges.
            ratio = manoeuvre.limit_ratio
            share = max(s.limit_share / ratio, s.least_share) if np.isfinite(ratio) else s.least_share
            # A single actuator drives everything.
            causes = [a.name not in DOFS or a.name in _CAUSES[manoeuvre.limit] for a in family.axes]
            sizes = np.where(causes, share * sizes, sizes)
        excitation = self.excitation(design, sizes)
        smaller = self.manoeuvres([self.commands(share * excitation) for share in s.shares])
        return next((manoeuvre for manoeuvre in smaller if manoeuvre.safe), smaller[-1])

    def manoeuvres(self, commands: Sequence[Array]) -> list[Manoeuvre]:
        """The manoeuvres that commands of shape (n, k) make, safe or not."""
        motions = [self.predicted(plant, self.t, commands) for plant in self.plants]
        found = []
        for u, *y in zip(commands, *motions, strict=True):
            nearest = (manoeuvres.nearest_limit(one, self.names, self.motion) for one in y)
            limit, ratio = max(nearest, key=lambda pair: pair[1])
            found.append(Manoeuvre(self.t, u, tuple(y), ratio, limit))
        return found

    def predicted(self, plant: Plant, t: Array, commands: Sequence[Array], p: Array | None = None) -> Array:
        """Outputs of the sensors without noise, from the start, (b, n, 2n_dof); NaN where it diverges."""
        return plant.outputs(t, np.stack(commands), self._start, p)

    # --- the log to come ----------------------------------------------------------------------
    def data(self, manoeuvre: Manoeuvre, model: int) -> WeakData:
        """A manoeuvre as the log that the estimators get; noise is what the channels will have."""
        (segment,) = self._log_at_rest.segments
        u, measured = manoeuvre.u, np.where(np.isfinite(self.noise.sigma), manoeuvre.y[model], 0.0)
        segments = (replace(segment, measured=measured, u=u),)
        return replace(self._log_at_rest, runs=(self._run(u, measured),), segments=segments)

    @cached_property
    def _log_at_rest(self) -> WeakData:
        """A log of the same length at rest; prepared once for all manoeuvres."""
        rest = np.zeros((len(self.t), len(self.limits.value))), np.zeros((len(self.t), len(self.names)))
        return prepare([self._run(*rest)], self.plants[0].functions.vehicle, sigma=self.noise.finite)

    def _run(self, u: Array, measured: Array) -> Run:
        columns = {self.names[i]: measured[:, i] for i in np.flatnonzero(np.isfinite(self.noise.sigma))}
        commands = dict(zip(self.vehicle.command_names, u.T, strict=True))
        return Run("plan", self.t, columns | commands, derived=self.noise.derived)

    # --- reach --------------------------------------------------------------------------------
    def reach(self, axes: Sequence[Axis]) -> Array:
        """Largest deflection of every axis, held for a while, that keeps speed, rate and tilt in bounds."""
        return np.array([self._reach(axis.pattern, self.safe_bias) for axis in axes])

    @cached_property
    def safe_bias(self) -> Array:
        """Mean of the commands, (k,): as much of the bias as keeps the motion in bounds."""
        return self.bias * self._reach(self.bias, 0.0 * self.bias) if np.any(self.bias) else self.bias

    def _reach(self, pattern: Array, bias: Array) -> float:
        """Largest share of a deflection either way, held around a bias, that is in bounds."""
        t = self.t[: max(int(np.searchsorted(self.t, SETTINGS.held)), 3)]
        bounds, shares = self.without_drift().motion, SETTINGS.reaches
        held = [min(2 * share, 1.0) * bias + sign * share * pattern for share in shares for sign in (1, -1)]
        u = [np.tile(self.commands(one[None]), (len(t), 1)) for one in held]
        ratios = np.zeros(len(u))
        for plant in self.plants:
            y = self.predicted(plant, t, u)
            ratios = np.maximum(ratios, [manoeuvres.nearest_limit(one, self.names, bounds)[1] for one in y])
        safe = ratios.reshape(-1, 2).max(axis=1) <= 1.0
        return float(shares[np.argmax(safe)] if safe.any() else shares[-1])


# --- uncertainty of the predicted depth -----------------------------------------------------------
def depth_spread(
    problem: PlanningProblem, plant: Plant, known: Knowledge, manoeuvre: Manoeuvre
) -> float | None:
    """Two standard deviations of the largest error of the predicted depth, m; None without a depth.

    A parameter without a stated error counts as known to 30%.
    """
    if "z" not in problem.names or not known.free:
        return None
    information = known.prior + known.logs
    without_error = np.diag(information) <= 0
    assumed = np.diag(without_error * (SETTINGS.assumed_error * known.scale) ** -2.0)
    scales = zip(known.free, known.scale, strict=True)
    slopes = np.array([_slope(problem, plant, manoeuvre, name, scale) for name, scale in scales])
    variance = np.einsum("it,ij,jt->t", slopes, inverse_of(information + assumed), slopes)
    return float(2 * np.sqrt(np.max(np.nan_to_num(variance, nan=0.0))))


def _slope(problem: PlanningProblem, plant: Plant, manoeuvre: Manoeuvre, name: str, scale: float) -> Array:
    """Derivative of the depth along a manoeuvre, shape (n,)."""
    place, column = plant.functions.parameter_names.index(name), problem.names.index("z")
    depths = []
    for sign in (1.0, -1.0):
        p = plant.p.copy()
        p[place] += sign * SETTINGS.step * scale
        depths.append(problem.predicted(plant, manoeuvre.t, [manoeuvre.u], p)[0][:, column])
    return np.asarray((depths[0] - depths[1]) / (2 * SETTINGS.step * scale))


# --- the result of a plan, as it is written to JSON -----------------------------------------------
SCHEMA = "undertow/plan/1"
Goal = Literal["parameters", "separate"]


class PlannedCommand(ResultTable):
    """A command: its limit and where that comes from, its value at rest, and what the plan uses."""

    name: str
    unit: str
    limit: float
    least: float  # the lowest value that it may have, minus `limit` unless it is one-sided
    limit_from: str
    trim: float
    lowest: float
    highest: float


class PlannedNoise(ResultTable):
    """Noise of a channel that the plan counts with, SI; None for one that is not measured."""

    name: str
    sigma: float | None
    source: str


class PlannedParameter(ResultTable):
    """A parameter, in the sign convention of the vehicle file, and how well it is known."""

    name: str
    unit: str
    about: str
    value: float
    error_now: float | None  # standard errors; None where nothing determines the parameter
    error_after: float | None
    verdict: Literal["", "badly known", "not determined"]


class Separation(ResultTable):
    """How far the predictions of two models are apart once each has been refitted to the other."""

    pair: tuple[str, str]
    chi_square: float  # the smaller of the two ways round, in units of the noise
    deviations: float  # its root
    chi_square_now: float | None  # the same of the logs; None without logs
    deviations_now: float | None


class Rival(ResultTable):
    """One of the models to be told apart, and the values that its effects were planned with."""

    name: str
    values: dict[str, float]
    units: dict[str, str]
    source: str


class Plan(ResultTable):
    """Outcome of `undertow plan`."""

    schema_id: str = SCHEMA
    undertow: str
    vehicle: str
    signs: str
    goal: Goal
    seed: int
    tries: int
    duration: float
    rate: float
    speed: float  # ahead, at the start, m/s
    manoeuvre: str
    # Of "parameters" the mean factor by which standard errors fall (geometric mean); of "separate" the
    # standard deviations between the two models that are hardest to tell apart.
    criterion: float
    families: dict[str, float | None]  # of the best manoeuvre of every kind; None without one in the limits
    commands: list[PlannedCommand]
    noise: list[PlannedNoise]
    extremes: dict[str, float]
    limits: dict[str, float | None]
    depth_spread: float | None
    parameters: list[PlannedParameter]
    undetermined: list[list[str]]
    rivals: list[Rival]
    separations: list[Separation]
    logs: list[str]
    remarks: list[str]
    # How logs were decimated that are longer than this takes, and which segments were used; null of others.
    long_logs: LongLogs | None = None


def commands_of(problem: PlanningProblem, manoeuvre: Manoeuvre) -> list[PlannedCommand]:
    """Every command with its limit, and its range in the manoeuvre."""
    return [
        PlannedCommand(
            name=name,
            unit=problem.vehicle.input_units[name],
            limit=float(problem.limits.high[i]),
            least=float(problem.limits.low[i]),
            limit_from=problem.limits.source[i],
            trim=float(problem.trim.commands[i]),
            lowest=float(manoeuvre.u[:, i].min()),
            highest=float(manoeuvre.u[:, i].max()),
        )
        for i, name in enumerate(problem.vehicle.command_names)
    ]


def noise_of(problem: PlanningProblem) -> list[PlannedNoise]:
    """Noise of every channel that the plan counts with."""
    n = problem.noise
    return [
        PlannedNoise(name=name, sigma=json_ready(s), source=source)
        for name, s, source in zip(n.names, n.sigma, n.source, strict=True)
    ]


def extremes_of(problem: PlanningProblem, manoeuvre: Manoeuvre) -> dict[str, float]:
    """Largest motions by any of the models, SI."""
    found = [manoeuvres.extremes(y, problem.names) for y in manoeuvre.y]
    return {what: max(one[what] for one in found) for what in found[0]}


def parameters_of(
    known: Knowledge, signs: str, after: Array, undetermined: list[list[str]]
) -> list[PlannedParameter]:
    """Every free parameter with its standard errors before and after."""
    now, then = known.errors(known.now), known.errors(after)
    names = {name for group in undetermined for name in group}
    return [
        _planned_parameter(known.vehicle, signs, name, float(now[i]), float(then[i]), name in names)
        for i, name in enumerate(known.free)
    ]


def _planned_parameter(
    vehicle: Vehicle, signs: str, name: str, now: float, then: float, undetermined: bool
) -> PlannedParameter:
    parameter, value = vehicle.declaration(name), vehicle.value_of(name).value
    # Where the manoeuvre adds nothing to the prior, the error is that of the prior.
    undetermined = undetermined and not then < SETTINGS.determined * now
    badly_known = not then < SETTINGS.badly_known * abs(value)
    verdict = "not determined" if undetermined else "badly known" if badly_known else ""
    return PlannedParameter(
        name=name,
        unit=parameter.shown_unit,
        about=parameter.about,
        value=printed(parameter, value, signs),
        error_now=json_ready(now),
        error_after=json_ready(then),
        verdict=verdict,  # type: ignore[arg-type]
    )


def safety_remarks(problem: PlanningProblem, manoeuvre: Manoeuvre, spread: float | None) -> list[str]:
    """Precautions before the manoeuvre is carried out."""
    lines = [
        f"the actuators cannot balance {value:.3g} {'N' if dof in ('surge', 'heave') else 'N m'} in {dof} at "
        f"the start: the vehicle does not hold its {'speed' if dof == 'surge' else 'depth and attitude'}"
        for dof, value in problem.trim.unbalanced.items()
    ]
    rise, column = 0.0, problem.names.index("z") if "z" in problem.names else None
    if column is not None:
        rise = max(float(np.max(y[0, column] - y[:, column])) for y in manoeuvre.y)
    if rise > problem.depth:
        lines.append(f"the vehicle rises up to {rise:.2g} m above its start: begin deeper than that")
    depth = extremes_of(problem, manoeuvre).get("depth", 0.0)
    if spread is not None and depth + spread > problem.motion.depth:
        lines.append(
            f"in open loop, the depth may differ by {spread:.2g} m from the prediction by the end, given "
            "what is known now: hold it by hand or with a controller, and log the commands"
        )
    return lines
