"""A model compared with logs: the force it lacks, where and in which regime it fails, how much is noise."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import isfinite
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import bsr_array, csr_array

from undertow.codegen.engine import mapped
from undertow.codegen.functions import Functions
from undertow.model.symbols import FORCE_UNITS
from undertow.model.vehicle import Vehicle
from undertow.observer.consistency import LjungBox, ljung_box
from undertow.typing import Array, Flags, Index, Progress
from undertow.version import __version__

from .doctor.examine import refuse_impossible
from .estimation.data import Segment, WeakData, measured_pose, prepare
from .estimation.inputs import ActuatorStates, Memory
from .estimation.pointwise import Pointwise
from .estimation.predictor import Predictor, predict_each
from .estimation.residual import SensorDelay, WeakModel, value_name, whitened
from .estimation.threads import one_thread
from .estimation.weak_form import adapted, per_run_parameters
from .estimation.windows import Prediction, cut, possible_horizon, prediction_error
from .findings import LongLogs, ResultTable
from .logs.pose_velocity import as_reported
from .logs.run import UNITS, Run


# --- what a model leaves unexplained, as a force --------------------------------------------------
@dataclass(frozen=True)
class Forces:
    """Force that the motion requires and the model lacks, averaged with K test functions."""

    run: Index  # (K,) run that a test function belongs to
    segment: Index  # (K,) segment without gaps that it belongs to
    t: Array  # (K,) its middle, s
    missing: Array  # (K, n) force to be added to the model, body axes, N and N m
    noise: Array  # (K, n) standard deviation of `missing` from the noise of the channels alone
    # (K, n) `missing` in units of its noise, free of the correlation that the noise brings in
    whitened: Array
    pose: Array  # (K, n) measured motion, averaged likewise
    velocity: Array
    commands: Array  # (K, n_commands) commands, averaged likewise
    wrenches: dict[str, Array]  # Force of every effect along the measured motion, by effect id, N and N m
    control: Array  # (K, n) control force: that of thrusters, propellers, rudders and known forces

    def __len__(self) -> int:
        return len(self.t)


def residual_forces(
    model: Vehicle | Functions,
    runs: Sequence[Run],
    data: WeakData | None = None,
    vehicles: Sequence[Vehicle] | None = None,
) -> Forces:
    """Forces that act in logs and that a model lacks.

    `data` are the same logs if they are prepared already; `vehicles` the model with its values in each run,
    where these differ.
    """
    functions = model if isinstance(model, Functions) else Functions(model)
    data = prepare(runs, functions.vehicle) if data is None else data
    return _Evaluation(functions, data, vehicles or [functions.vehicle] * len(data.runs)).forces()


class _Evaluation:
    """One model along prepared logs."""

    def __init__(self, functions: Functions, data: WeakData, vehicles: Sequence[Vehicle]) -> None:
        self.functions, self.data = functions, data
        self.size = len(functions.vehicle.dof_indices)
        self.p = np.array(functions.values(), dtype=float)
        known = {
            value_name(name, run.origin): vehicle.value_of(name).value
            for run, vehicle in zip(data.runs, vehicles, strict=True)
            for name in per_run_parameters(vehicle)
        }
        self._weak = WeakModel(functions, (), known=known)
        self._run_parameters = [self._weak.values.of_run(self.p, run) for run in data.runs]
        self._points = Pointwise(functions, ())
        self._chain = ActuatorStates(functions, ())
        self._sensor_delay = SensorDelay(functions)
        self._memory = Memory(functions, (), self._points.measured, self._points.true_motion)

    def forces(self) -> Forces:
        self._weak.require_defined(self.data, self.p)
        parts = self._weak.linearise(self.data, self.p)
        noise = self._weak.whitening(self.data, self.p)
        white = self._by_segment(-whitened(parts, noise).r)
        commands = [r.matrix(self.data.commands) for r in self.data.runs]
        actuation = [
            self._chain.along(r.t, u, p).value
            for r, u, p in zip(self.data.runs, commands, self._run_parameters, strict=True)
        ]
        pieces = []
        for i, reported in enumerate(self.data.segments):
            p = self._run_parameters[reported.run]
            s = self._sensor_delay.in_time(reported, p)
            mass, averages = self._averages(s, actuation[s.run][s.samples], p)
            # The weak residual is the acceleration of the model minus the measured one.
            acceleration = -self._table(parts[i].r) / _weight(s)[:, None]
            averages["missing"] = np.einsum("kij,kj->ki", mass, acceleration)
            averages["noise"] = self._standard_deviation(noise[i].covariance, mass) / _weight(s)[:, None]
            pieces.append(averages | {"whitened": white[i]} | _places(i, s))
        return _concatenated(pieces)

    def _by_segment(self, r: Array) -> list[Array]:
        ends = np.cumsum([s.functions.count * len(self.data.rows) for s in self.data.segments])
        return [self._table(part) for part in np.split(r, ends[:-1])]

    def _table(self, r: Array) -> Array:
        """Entries of the force equations, shape (K, n)."""
        return r.reshape(-1, len(self.data.rows))[:, : self.size]

    def _standard_deviation(self, covariance: csr_array, mass: Array) -> Array:
        """Standard deviation of the force times the weight of the test function, shape (K, n)."""
        count, rows = len(mass), len(self.data.rows)
        blocks = np.concatenate([mass, np.zeros((count, self.size, rows - self.size))], axis=2)
        to_force = bsr_array((blocks, np.arange(count), np.arange(count + 1)))
        variance = (to_force @ covariance).multiply(to_force).sum(axis=1)
        return np.sqrt(np.asarray(variance).reshape(-1, self.size))

    def _averages(self, s: Segment, actuation: Array, p: Array) -> tuple[Array, dict[str, Any]]:
        """Mass matrix at every test function, shape (K, n, n), and averages of all else."""
        memory = self._memory.along(s.t, s.measured, actuation, s.u, p).value
        (motion,) = mapped(self._points.true_motion_at, [s.measured, actuation, memory, s.u], p, s.t)
        smooth, held = (_rows_to_one(w) for w in (s.functions.value, s.functions.held))
        mean = smooth @ motion[:, :, 0]
        rate = -(s.functions.rate @ motion[:, self.size :, 0]) / _weight(s)[:, None]
        columns = [mean, rate, held @ actuation, smooth @ memory, held @ s.u]
        mass, control, *values = mapped(self._wrenches, columns, p, s.functions.centre)
        measured = smooth @ s.measured
        return mass, {
            "pose": measured[:, : self.size],
            "velocity": measured[:, self.size :],
            "commands": held @ s.u,
            "wrenches": {k: v[:, :, 0] for k, v in zip(self.functions.wrenches, values, strict=True)},
            "control": control[:, :, 0],
        }

    @cached_property
    def _wrenches(self) -> ca.Function:
        f = self.functions
        inputs = [ca.vertcat(f.eta, f.nu), f.nu_dot, f.actuation, f.memory, f.u, f.p, f.t]
        outputs = [f.mass_matrix, f.control_force, *f.wrenches.values()]
        return ca.Function("wrenches", inputs, [ca.densify(w) for w in outputs])


def _weight(s: Segment) -> Array:
    """Integral of every test function, s."""
    return np.asarray(s.functions.held.sum(axis=1)).ravel()


def _rows_to_one(weights: csr_array) -> csr_array:
    """Weights that average a signal with each test function."""
    return csr_array(weights.multiply(1.0 / weights.sum(axis=1)[:, None]))


def _places(index: int, s: Segment) -> dict[str, Any]:
    count = s.functions.count
    return {"run": np.full(count, s.run), "segment": np.full(count, index), "t": s.functions.centre}


def _concatenated(pieces: list[dict[str, Any]]) -> Forces:
    columns: dict[str, Any] = {}
    for name in pieces[0]:
        values = [piece[name] for piece in pieces]
        if name == "wrenches":
            columns[name] = {k: np.concatenate([v[k] for v in values]) for k in values[0]}
        else:
            columns[name] = np.concatenate(values)
    return Forces(**columns)


# --- the result -----------------------------------------------------------------------------------
SCHEMA = "undertow/comparison/1"


class ComparedRun(ResultTable):
    """A log and what was done with it."""

    name: str
    source: str
    sha256: str
    samples: int
    duration: float
    notes: list[str]


class ChannelResult(ResultTable):
    """One measured channel: error of the prediction over the horizon and of the free run.

    `normalised` is the error over the noise, `relative` (velocities only) over the rms of the measurement,
    and `fit` the share in % of the variation that is predicted (NRMSE; 100 is perfect, below 0 worse than a
    mean).
    """

    channel: str
    unit: str
    noise: float
    ahead_rms: float | None
    ahead_normalised: float | None
    ahead_relative: float | None
    free_run_rms: float | None
    free_run_fit: float | None


class DofResult(ResultTable):
    """One degree of freedom: the force that the model lacks, N or N m.

    `explained_by_noise` is the share of its mean square that the noise of the channels accounts for,
    `normalised` its rms over that of the noise; `inputs` holds its correlation with every command.
    """

    degree_of_freedom: str
    unit: str
    residual_rms: float
    noise_rms: float
    explained_by_noise: float
    normalised: float | None
    autocorrelation: list[float]
    ljung_box: float
    p_value: float
    inputs: dict[str, float]


class Cell(ResultTable):
    """One cell of the error map; without numbers if there are too few samples."""

    degree_of_freedom: str
    group: str
    regime: str
    phrase: str
    samples: int
    residual_rms: float | None = None
    noise_rms: float | None = None
    explained_by_noise: float | None = None
    normalised: float | None = None


class BudgetShare(ResultTable):
    """Part of one effect in the forces of one degree of freedom: rms along the logs, and share of all."""

    degree_of_freedom: str
    effect: str
    rms: float
    share: float


class ComparisonResult(ResultTable):
    """Outcome of `undertow compare`."""

    schema_id: str = SCHEMA
    undertow: str
    vehicle: str
    degrees_of_freedom: list[str]
    runs: list[ComparedRun]
    horizon: float
    headline: str
    prediction_error: float | None
    windows: int
    diverged: int
    channels: list[ChannelResult]
    dofs: list[DofResult]
    cells: list[Cell]
    worst: Cell | None
    budget: list[BudgetShare]
    seconds: float
    # How long logs were decimated and which segments were used; null for logs that fit as a whole.
    long_logs: LongLogs | None = None


def finite(value: float | None) -> float | None:
    """The number, or None if it is not finite."""
    return float(value) if value is not None and isfinite(value) else None


@dataclass(frozen=True)
class ComparisonSettings:
    """Numbers of the comparison of a model with logs."""

    horizon: float = 5.0  # s
    no_command: float = 0.01  # share of the largest command below which a command counts as none
    # Test functions after the first command that count as starting up: four make one width of a function.
    starting: int = 8
    fast_turn: float = 0.7  # quantile of the turning rate from which a turn is fast
    # A velocity counts as reversed when it passes this many standard deviations of its noise on both sides.
    reversed: float = 3.0
    bins: int = 12  # of a profile
    fewest_in_bin: int = 12  # test functions
    fewest_in_cell: int = 20  # test functions
    # Standard deviations by which the mean square of a cell must exceed that of noise to be called a failure.
    failure: float = 4.0
    # Sum of the correlations between test functions under white process noise.
    correlation_sum: float = 2.1
    lags: int = 20  # of the autocorrelation of the residual


SETTINGS = ComparisonSettings()


@dataclass(frozen=True)
class Regime:
    """One part of the logs."""

    group: str  # What it is one part of: speed, reversal, turning, depth, control force, commands, time
    name: str
    phrase: str  # How a sentence names it: "when turning"
    inside: Flags  # (K, n) test functions that belong to it, for each degree of freedom


def regimes(forces: Forces, vehicle: Vehicle, sigma: Array) -> list[Regime]:
    """All regimes that the vehicle's degrees of freedom and commands distinguish; noise `sigma` (2n,)."""
    size = len(vehicle.dof_indices)
    parts = [_speeds, _reversal, _turning, _depths, _control_force, _commands, _thirds]
    found = [r for part in parts for r in part(forces, vehicle, sigma)]
    return [
        Regime(g, n, phrase, np.broadcast_to(m if m.ndim == 2 else m[:, None], (len(forces), size)))
        for g, n, phrase, m in found
    ]


_Found = Iterator[tuple[str, str, str, Flags]]


def _speeds(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    linear = [i for i, dof in enumerate(vehicle.dof_indices) if dof < 3]
    chosen = linear or list(range(len(vehicle.dof_indices)))
    speed = np.linalg.norm(forces.velocity[:, chosen], axis=1)
    phrases = ("at low speed", "at medium speed", "at high speed")
    yield from _bands("speed", ("slow", "medium", "fast"), phrases, speed)


def _bands(group: str, names: tuple[str, ...], phrases: tuple[str, ...], value: Array) -> _Found:
    """Parts of a variable with equally many test functions each."""
    limits = np.quantile(value, np.linspace(0, 1, len(names) + 1)[1:-1])
    band = np.searchsorted(limits, value, side="right")
    for i, (name, phrase) in enumerate(zip(names, phrases, strict=True)):
        yield group, name, phrase, band == i


def _reversal(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    clear = SETTINGS.reversed * sigma[len(vehicle.dof_indices) :]
    low, high = forces.velocity.copy(), forces.velocity.copy()
    for step in (1, 2):
        for ahead, behind in (
            (slice(step, None), slice(None, -step)),
            (slice(None, -step), slice(step, None)),
        ):
            near = (forces.segment[ahead] == forces.segment[behind])[:, None]
            other = forces.velocity[behind]
            low[ahead] = np.where(near, np.minimum(low[ahead], other), low[ahead])
            high[ahead] = np.where(near, np.maximum(high[ahead], other), high[ahead])
    yield "reversal", "reversing", "when the motion reverses", (low < -clear) & (high > clear)


def _turning(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    if "r" not in vehicle.velocity_names:
        return
    rate = np.abs(forces.velocity[:, vehicle.velocity_names.index("r")])
    fast = rate > max(np.quantile(rate, SETTINGS.fast_turn), SETTINGS.reversed * sigma[-1])
    yield "turning", "turning", "when turning", fast
    yield "turning", "straight", "when going straight", rate <= np.quantile(rate, 1 - SETTINGS.fast_turn)


def _depths(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    if "z" not in vehicle.pose_names:
        return
    place = vehicle.pose_names.index("z")
    depth = forces.pose[:, place]
    if np.ptp(depth) > 2 * SETTINGS.reversed * sigma[place]:
        phrases = ("near its least depth", "at middle depth", "near its greatest depth")
        yield from _bands("depth", ("shallow", "middle", "deep"), phrases, depth)


def _control_force(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    force = forces.control
    least = SETTINGS.no_command * np.max(np.abs(force), axis=0, initial=0.0)
    for name, side in (("positive", force > least), ("negative", force < -least)):
        if side.any():
            yield "control force", f"control force {name}", f"under {name} control force", side


def _commands(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    if forces.commands.size == 0:
        return
    largest = np.max(np.abs(forces.commands), axis=0)
    idle = np.all(np.abs(forces.commands) <= SETTINGS.no_command * largest, axis=1)
    started = np.zeros(len(idle), dtype=bool)
    for step in range(1, SETTINGS.starting + 1):
        started[step:] |= idle[:-step] & (forces.segment[step:] == forces.segment[:-step])
    yield "commands", "start-up", "when starting up", started & ~idle
    yield "commands", "coasting", "when coasting", idle


def _thirds(forces: Forces, vehicle: Vehicle, sigma: Array) -> _Found:
    third = np.zeros(len(forces), dtype=int)
    for run in np.unique(forces.run):
        inside = forces.run == run
        first, last = forces.t[inside].min(), forces.t[inside].max()
        third[inside] = np.clip(3 * (forces.t[inside] - first) / max(last - first, 1e-12), 0, 2)
    for i, name in enumerate(("first", "middle", "last")):
        yield "time", f"{name} third", f"in the {name} third of the runs", third == i


@dataclass(frozen=True)
class Profile:
    """Mean residual force over bins of one variable."""

    degree_of_freedom: str  # What is plotted against what; `unit` is the variable's
    variable: str
    unit: str
    centre: Array  # (bins,) mean of the variable in each bin
    force: Array  # (bins,) mean residual force and its standard error, N or N m
    error: Array
    count: Index  # (bins,) test functions in each bin


def profiles(forces: Forces, vehicle: Vehicle, pose: tuple[str, ...]) -> list[Profile]:
    """Residual force of every degree of freedom against every variable that varies."""
    known = list(_variables(forces, vehicle, pose))
    return [
        _profile(dof, name, unit, forces.missing[:, i], value)
        for i, dof in enumerate(vehicle.degrees_of_freedom)
        for name, unit, value in known
        if len(value) >= SETTINGS.fewest_in_bin and np.ptp(value) > 0
    ]


def _variables(
    forces: Forces, vehicle: Vehicle, measured: tuple[str, ...]
) -> Iterator[tuple[str, str, Array]]:
    for i, name in enumerate(vehicle.velocity_names):
        yield name, UNITS[name], forces.velocity[:, i]
    for i, name in enumerate(vehicle.pose_names):
        if name in measured and name not in ("x", "y"):
            pose = forces.pose[:, i]
            yield name, UNITS[name], _principal(pose) if UNITS[name] == "rad" else pose
    for i, name in enumerate(vehicle.command_names):
        yield name, vehicle.command_units[name], forces.commands[:, i]
    yield "t", "s", forces.t


def _principal(angle: Array) -> Array:
    """The angle between -pi and pi: a force depends on the heading, not on the number of full turns."""
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)


def _profile(dof: str, name: str, unit: str, force: Array, value: Array) -> Profile:
    bins = min(SETTINGS.bins, len(value) // SETTINGS.fewest_in_bin)
    limits = np.unique(np.quantile(value, np.linspace(0, 1, bins + 1)[1:-1]))
    band = np.searchsorted(limits, value, side="right")
    groups = [np.flatnonzero(band == i) for i in range(len(limits) + 1)]
    groups = [g for g in groups if len(g) > 1]
    return Profile(
        dof,
        name,
        unit,
        np.array([value[g].mean() for g in groups]),
        np.array([force[g].mean() for g in groups]),
        np.array([force[g].std(ddof=1) * np.sqrt(SETTINGS.correlation_sum / len(g)) for g in groups]),
        np.array([len(g) for g in groups], dtype=np.intp),
    )


@dataclass(frozen=True)
class Comparison:
    """A comparison with what its pictures are drawn from."""

    result: ComparisonResult
    vehicle: Vehicle
    ahead: Prediction  # Predictions over the horizon, and over whole segments without gaps
    free_run: Prediction
    forces: Forces  # Force that the model lacks, along the logs
    profiles: list[Profile]  # The same against every variable
    regimes: list[Regime]  # The parts of the logs that the error map tells apart

    def stretches(self, degree_of_freedom: str, regime: str) -> list[tuple[int, float, float]]:
        """When a field of the error map applies: number of the run, begin and end in s of each segment."""
        place = self.result.degrees_of_freedom.index(degree_of_freedom)
        inside = next(r.inside[:, place] for r in self.regimes if r.name == regime)
        forces, found = self.forces, list[tuple[int, float, float]]()
        for segment in np.unique(forces.segment):
            rows = np.flatnonzero(forces.segment == segment)
            half = float(np.median(np.diff(forces.t[rows]))) / 2 if len(rows) > 1 else 0.0
            edges = np.flatnonzero(np.diff(np.concatenate([[False], inside[rows], [False]]).astype(int)))
            for first, end in edges.reshape(-1, 2):
                t = forces.t[rows[first:end]]
                found.append((int(forces.run[rows[0]]), float(t[0]) - half, float(t[-1]) + half))
        return found

    @property
    def variables(self) -> dict[str, tuple[str, Array]]:
        """What the residual force may correlate with: unit and values (K,) of every variable, by name."""
        found = _variables(self.forces, self.vehicle, self.measured_pose)
        return {name: (unit, value) for name, unit, value in found}

    @property
    def measured_pose(self) -> tuple[str, ...]:
        """Names of the pose coordinates that all logs have."""
        return measured_pose(self.vehicle, self.ahead.windows.runs)


@one_thread()
def compare(
    vehicle: Vehicle,
    runs: Sequence[Run],
    *,
    horizon: float = SETTINGS.horizon,
    compiled: bool | None = None,
    progress: Progress = lambda done, words: None,
    trust_log: bool = False,
) -> Comparison:
    """Compare a model, as given, with logs, predicted `horizon` s ahead from measured states.

    Parameters with a value per run (``per_run = true``) are estimated from its first third, and the model is
    compared with the rest. `trust_log` takes logs that `undertow.identification.doctor.refuse_impossible`
    refuses.
    """
    began = time.perf_counter()
    refuse_impossible(vehicle, runs, trust_log=trust_log)
    vehicle = as_reported(vehicle, runs)
    functions = Functions(vehicle)
    progress(0.0, "residual force")
    vehicles, runs = zip(*(adapted(vehicle, run) for run in runs), strict=True)
    data = prepare(runs, vehicle)
    forces = residual_forces(functions, runs, data, vehicles)
    progress(0.4, "simulating")
    predictor = Predictor(functions, compiled=compiled)
    horizon = possible_horizon(vehicle, runs, horizon)
    ahead = predict_each(vehicles, cut(runs, vehicle, horizon), predictor)
    free_run = predict_each(vehicles, cut(runs, vehicle, None), predictor)
    progress(0.9, "error map")
    pose = measured_pose(vehicle, runs)
    found = regimes(forces, vehicle, data.sigma)
    rows = range(len(vehicle.dof_indices))
    cells = [_cell(forces, vehicle, i, r) for i in rows for r in found]
    judged = (c for c in cells if c.normalised is not None)
    worst = max(judged, key=lambda c: c.normalised or 0.0, default=None)
    result = ComparisonResult(
        undertow=__version__,
        vehicle=vehicle.name,
        degrees_of_freedom=list(vehicle.degrees_of_freedom),
        runs=[_compared(r) for r in runs],
        horizon=horizon,
        headline=headline(worst),
        prediction_error=finite(prediction_error(ahead)),
        windows=len(ahead.windows),
        diverged=free_run.diverged,
        channels=_channels(ahead, free_run),
        dofs=[_dof(forces, vehicle, i) for i in rows],
        cells=cells,
        worst=worst,
        budget=_budget(forces, vehicle),
        seconds=time.perf_counter() - began,
    )
    return Comparison(result, vehicle, ahead, free_run, forces, profiles(forces, vehicle, pose), found)


def supplied(vehicle: Vehicle, better: Vehicle, runs: Sequence[Run]) -> list[Profile]:
    """The force by which another model fits the logs better than this one, against every variable.

    Parameters with a value per run are estimated for the other model as in `compare`.
    """
    vehicles, rest = zip(*(adapted(better, run) for run in runs), strict=True)
    lacking = residual_forces(vehicle, rest)
    left = residual_forces(Functions(better), rest, prepare(rest, better), vehicles)
    difference = replace(lacking, missing=lacking.missing - left.missing)
    return profiles(difference, vehicle, measured_pose(vehicle, rest))


def _compared(run: Run) -> ComparedRun:
    return ComparedRun(
        name=run.name,
        source=run.source,
        sha256=run.sha256,
        samples=len(run.t),
        duration=float(run.t[-1] - run.t[0]),
        notes=[*run.notes, *run.reader_notes],
    )


# --- channels ---------------------------------------------------------------------------------
def _channels(ahead: Prediction, free_run: Prediction) -> list[ChannelResult]:
    noise = dict(zip(ahead.names, ahead.windows.sigma, strict=True))
    fits = free_run.fit
    return [
        ChannelResult(
            channel=name,
            unit=UNITS[name],
            noise=float(noise[name]),
            ahead_rms=finite(rms),
            ahead_normalised=finite(ahead.normalised[name]) if noise[name] > 0 else None,
            ahead_relative=finite(ahead.relative.get(name)),
            free_run_rms=finite(free_run.rms[name]),
            free_run_fit=finite(fits.get(name)),
        )
        for name, rms in ahead.rms.items()
    ]


# --- degrees of freedom -----------------------------------------------------------------------
def _dof(forces: Forces, vehicle: Vehicle, i: int) -> DofResult:
    test = whiteness(forces.whitened[:, i], forces.segment)
    inputs = zip(vehicle.command_names, forces.commands.T, strict=True)
    return DofResult(
        degree_of_freedom=vehicle.degrees_of_freedom[i],
        unit=FORCE_UNITS[vehicle.dof_indices[i]],
        **_against_noise(forces.missing[:, i], forces.noise[:, i]),
        autocorrelation=test.autocorrelation.tolist(),
        ljung_box=test.statistic,
        p_value=test.p_value,
        inputs={name: correlation(forces.missing[:, i], u) for name, u in inputs},
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _against_noise(residual: Array, sigma: Array) -> dict[str, Any]:
    """Size of a residual force beside that of its noise."""
    missing, noise = _rms(residual), _rms(sigma)
    return {
        "residual_rms": missing,
        "noise_rms": noise,
        "explained_by_noise": min(1.0, (noise / missing) ** 2) if missing > 0 else 1.0,
        "normalised": finite(missing / noise) if noise > 0 else None,
    }


# --- error map --------------------------------------------------------------------------------
def _cell(forces: Forces, vehicle: Vehicle, i: int, regime: Regime) -> Cell:
    inside = regime.inside[:, i]
    cell = Cell(
        degree_of_freedom=vehicle.degrees_of_freedom[i],
        group=regime.group,
        regime=regime.name,
        phrase=regime.phrase,
        samples=int(inside.sum()),
    )
    if cell.samples < SETTINGS.fewest_in_cell:
        return cell
    return cell.model_copy(update=_against_noise(forces.missing[inside, i], forces.noise[inside, i]))


def headline(worst: Cell | None) -> str:
    """One sentence: where the model fails most, or that it does not fail."""
    if worst is None or worst.normalised is None or worst.explained_by_noise is None:
        return "too few samples to say where the model fails"
    unit = "N" if worst.degree_of_freedom in ("surge", "sway", "heave") else "N m"
    percent = 100 * worst.explained_by_noise
    explained = "under 1" if percent < 1 else f"{percent:.0f}"
    share = f"residual {worst.residual_rms:.3g} {unit}, noise explains {explained}%"
    place = f"in {worst.degree_of_freedom} {worst.phrase}"
    if worst.normalised**2 < 1.0 + SETTINGS.failure * np.sqrt(2 * SETTINGS.correlation_sum / worst.samples):
        return f"no residual clearly exceeds the noise; the largest is {place}: {share}"
    return f"fails most {place}: {share}"


# --- force budget -----------------------------------------------------------------------------
def _budget(forces: Forces, vehicle: Vehicle) -> list[BudgetShare]:
    rows = []
    for i, dof in enumerate(vehicle.degrees_of_freedom):
        sizes = {k: _rms(w[:, i]) for k, w in forces.wrenches.items()}
        sizes["unexplained"] = _rms(forces.missing[:, i])
        total = sum(sizes.values()) or 1.0
        parts = {k: size for k, size in sizes.items() if size > 0}
        rows += [
            BudgetShare(degree_of_freedom=dof, effect=k, rms=size, share=size / total)
            for k, size in parts.items()
        ]
    return rows


# --- whether what is left is noise ----------------------------------------------------------------
def whiteness(r: Array, segment: Index, lags: int = SETTINGS.lags) -> LjungBox:
    """Test a series (K,) for whiteness over at most a quarter of it; products never reach across a gap."""
    return ljung_box(r - r.mean(), min(lags, len(r) // 4), segment)


def correlation(a: Array, b: Array) -> float:
    """Correlation coefficient of two series; zero where one is constant."""
    x, y = a - a.mean(), b - b.mean()
    power = float(np.sqrt(np.sum(x**2) * np.sum(y**2)))
    return float(np.sum(x * y)) / power if power > 0 else 0.0
