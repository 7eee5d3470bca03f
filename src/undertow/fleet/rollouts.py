"""Logs simulated many times with parameters drawn from their uncertainty: bands of trajectories."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import polars as pl
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.files import sha256_of
from undertow.identification.doctor.examine import refuse_impossible
from undertow.identification.estimation.predictor import Predictor
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.windows import Windows, cut
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.model.loading import load_vehicle
from undertow.typing import Array, Progress

from .engine import Engine, Failure
from .partitions import files_digest
from .reduction import LogJob


@dataclass(frozen=True)
class RolloutLimits:
    """How rollouts are drawn, and how many may be."""

    # standard deviation of a start in that of the sensors: a parabola through five samples has 0.70
    start: float = 0.7
    bytes: int = 1_000_000_000  # that the rollouts of one window may take
    # share of the draws without a positive mass matrix at which the covariance is refused
    refused: float = 0.5


_LIMITS = RolloutLimits()


@dataclass(frozen=True)
class RolloutJob(LogJob):
    """What is simulated."""

    horizon: float = 10.0  # length of a window, s
    coverage: float = 0.9  # share of the rollouts within the band
    seed: int = 0  # of all that is drawn
    # hash of the vehicle file and the effects, by which workers see that they have the same; empty where it
    # is not known yet
    files: str = ""


@dataclass(frozen=True)
class Source:
    """A log, and the SHA-256 of its bytes by which workers see that they have the same."""

    log: str
    sha256: str


@dataclass(frozen=True)
class Band:
    """The rollouts of one window."""

    log: str  # path of the log
    window: int  # its place in the log
    names: tuple[str, ...]
    t: Array  # (k,): time, s
    # measured, low, median, high: (k, c), measurement and quantiles of the rollouts, sensor noise
    # included; SI
    measured: Array
    low: Array
    median: Array
    high: Array
    # rollouts that are left out since they diverged: they are no numbers any more, or none that a vehicle in
    # water can have
    diverged: int


def draw_parameters(source: str, effects: Sequence[str], count: int, seed: int) -> tuple[Array, str]:
    """Parameters drawn from the uncertainty of a fit, shape (count, n_parameters), and its source."""
    from undertow.codegen.functions import Functions
    from undertow.control.linear.family import spread_of

    vehicle = load_vehicle(source, effect_files=[Path(f) for f in effects])
    uncertainty = spread_of(vehicle, source)
    model = WeakModel(Functions(vehicle), uncertainty.names)
    places = list(model.places)
    low, high = np.array([vehicle.declaration(n).bounds for n in uncertainty.names]).T
    centre = np.array(model.functions.values(), dtype=float)
    random = np.random.default_rng(seed)
    found: list[Array] = []
    most = int(count / _LIMITS.refused)
    for _ in range(most):
        shift = random.multivariate_normal(np.zeros(len(places)), uncertainty.covariance, method="eigh")
        p = centre.copy()
        p[places] = np.clip(centre[places] + shift, low, high)
        if not model.limits.violated(p):
            found.append(p)
        if len(found) == count:
            return np.array(found), uncertainty.source
    raise UndertowError(
        f"{most - len(found)} of {most} vehicles drawn from the {uncertainty.source} have no positive mass "
        "matrix: fit the vehicle to better logs"
    )


def windows_of(job: RolloutJob, source: Source) -> int:
    """How many windows a log has."""
    return len(_cut(job, source))


def simulate_window(job: RolloutJob, source: Source, window: int, place: int, p: Array) -> Band:
    """The band of one window.

    `p` (count, n_parameters): parameters of the rollouts.
    """
    chosen = _cut(job, source).take(np.array([window]), np.iinfo(np.int64).max)
    count, samples = len(p), int(chosen.count[0])
    predictor = _predictor(job.vehicle, job.effects, job.files)
    size = 8 * count * samples * len(predictor.functions.state_names)
    if size > _LIMITS.bytes:
        raise UndertowError(
            f"{count} rollouts of {samples} samples take {size / 1e9:.1f} GB at a time, at most "
            f"{_LIMITS.bytes / 1e9:g}: use fewer (--count) or shorter ones (--horizon)"
        )
    random = np.random.default_rng([job.seed, place])
    sigma = chosen.sigma
    paths = _paths(predictor, chosen, p, _LIMITS.start * sigma * random.standard_normal((count, len(sigma))))
    good = _plausible(paths, chosen.t[0])
    if not good.any():
        raise UndertowError(f"{source.log}, window {window}: all rollouts diverge")
    noisy = paths[good] + sigma * random.standard_normal(paths[good].shape)
    tail = (1 - job.coverage) / 2
    low, median, high = np.quantile(noisy, [tail, 0.5, 1 - tail], axis=0)
    t, measured = chosen.t[0], chosen.measured[0]
    return Band(source.log, window, chosen.names, t, measured, low, median, high, int(np.sum(~good)))


def _plausible(paths: Array, t: Array) -> NDArray[np.bool_]:
    """Which rollouts stay what a vehicle in water can do, shape (count,); of paths (count, k, 2n) of pose and
    velocities."""
    from undertow.control.closed_loop.measures import implausible

    start = paths[:, 0, : paths.shape[2] // 2]
    return np.asarray(~implausible(paths, start, t - t[0]).any(axis=(1, 2)))


def _paths(predictor: Predictor, window: Windows, p: Array, shift: Array) -> Array:
    """Reported trajectories, shape (count, k, 2n)."""
    prompt = not predictor.sensor_delay.present and predictor.ideal_sensors
    if not prompt or len(predictor.functions.state_names) > len(window.names):
        return np.concatenate([_path(predictor, window, one, by) for one, by in zip(p, shift, strict=True)])
    start, drive = predictor.start_and_commands(window, p[0])
    states = predictor.simulator.run(start + shift, drive.t[0], drive.held[0], p)
    return drive.at_samples(states)[:, :, : len(window.names)]


def _path(predictor: Predictor, window: Windows, p: Array, shift: Array) -> Array:
    """The same for one vehicle whose sensors or own states depend on the parameters."""
    _, drive = predictor.start_and_commands(window, p)
    motion = predictor.measured_motion(window, drive.u, p) + shift
    return predictor.reports(window, p, motion)


@lru_cache(maxsize=2)
def _predictor(vehicle: str, effects: tuple[str, ...], files: str) -> Predictor:
    predictor = Predictor(load_vehicle(vehicle, effect_files=[Path(f) for f in effects]))
    if files_digest(vehicle, effects) != files:
        raise UndertowError(
            f"this worker reads a different '{vehicle}' or different effects, or has a different version of "
            "undertow: give workers the same files and versions, and do not change files during the run"
        )
    return predictor


@lru_cache(maxsize=4)
def _cut(job: RolloutJob, source: Source) -> Windows:
    vehicle = _predictor(job.vehicle, job.effects, job.files).functions.vehicle
    run = read_log(source.log, job.log_mapping, vehicle.command_names, missing_commands=job.fill)
    if run.sha256 != source.sha256:
        raise UndertowError(
            f"{source.log} is different for this worker, or was changed during the run: try again"
        )
    run = velocities_from_pose(run, vehicle.degrees_of_freedom)
    refuse_impossible(vehicle, [run], trust_log=job.trust_log)
    return cut([run], vehicle, job.horizon)


def rollouts(
    job: RolloutJob,
    logs: Sequence[str],
    count: int,
    engine: Engine,
    report: Progress = lambda done, words: None,
) -> tuple[list[Band], dict[str, str], str]:
    """Bands of all windows of all logs in order, what failed and why, and where the uncertainty is from.

    The same numbers come out for any engine and any number of workers.
    """
    job = replace(job, files=files_digest(job.vehicle, job.effects))
    p, source = draw_parameters(job.vehicle, job.effects, count, job.seed)
    sources = [Source(log, sha256_of(log)) for log in logs]
    found = dict(engine.results(windows_of, [(job, one) for one in sources]))
    failed = {log: found[i].words for i, log in enumerate(logs) if isinstance(found[i], Failure)}
    if len(failed) == len(logs):
        raise UndertowError(next(iter(failed.values())))
    items = [(s, w) for i, s in enumerate(sources) if s.log not in failed for w in range(found[i])]
    work = [(job, one, window, place, p) for place, (one, window) in enumerate(items)]
    bands: dict[int, Band] = {}
    for done, (place, answer) in enumerate(engine.results(simulate_window, work), start=1):
        log, window = items[place][0].log, items[place][1]
        report(done / len(work), f"{Path(log).name}, window {window}")
        if isinstance(answer, Failure):
            failed[f"{log}, window {window}"] = answer.words
        else:
            bands[place] = answer
    if not bands:
        raise UndertowError(next(iter(failed.values())))
    return [bands[place] for place in sorted(bands)], failed, source


def shares_within(bands: Sequence[Band]) -> dict[str, float]:
    """Share of the measurement that lies within the band, by channel that is measured."""
    found = {}
    for i, name in enumerate(bands[0].names):
        inside = [
            ((b.low[1:, i] <= m) & (m <= b.high[1:, i]))[np.isfinite(m)]
            for b in bands
            if np.isfinite(m := b.measured[1:, i]).any()
        ]
        if inside:
            found[name] = float(np.mean(np.concatenate(inside)))
    return found


def to_parquet(bands: Sequence[Band]) -> bytes:
    """Bands as a table: log, window, t, and for each channel the measurement, low, median and high."""
    parts = []
    for b in bands:
        columns = {"t": b.t}
        for i, name in enumerate(b.names):
            kinds = (("measured", b.measured), ("low", b.low), ("median", b.median), ("high", b.high))
            columns |= {f"{name}_{kind}": values[:, i] for kind, values in kinds}
        of_window = pl.DataFrame(columns)
        parts.append(of_window.select(pl.lit(b.log).alias("log"), pl.lit(b.window).alias("window"), pl.all()))
    stream = io.BytesIO()
    pl.concat(parts).write_parquet(stream)
    return stream.getvalue()
