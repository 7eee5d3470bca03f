"""One partition reduced to a triangular factor of derivatives of the weak residual."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.files import sha256_of
from undertow.identification.diagnosis.candidates import Candidate, candidates
from undertow.identification.doctor.examine import refuse_impossible
from undertow.identification.estimation.data import WeakData, prepare
from undertow.identification.estimation.fitted import TriangularFactor
from undertow.identification.estimation.residual import Linearised, WeakModel, whitened
from undertow.identification.estimation.test_functions import Whitening
from undertow.identification.estimation.weak_form import (
    fit_under_noise,
    initial_disturbance,
    matched_disturbance,
    required_free_parameters,
    with_process_noise,
)
from undertow.identification.logs.chunks import long_logs
from undertow.identification.logs.mapping import CommandPolicy, LogMapping
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run
from undertow.model.catalogue import Catalogue, with_effects
from undertow.model.effect import Effect, Measurement
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .partitions import Partition, content_of, digest, partition_of

#: Effects that differ from day to day and say nothing of the vehicle: water, ballast, payload.
DAILY = ("ocean_current", "net_buoyancy", "constant_force")


class Panel:
    """The columns computed from every log of a vehicle.

    The model is linearised where its file has it, with every effect of the catalogue at the value at which
    it changes nothing. The columns are those of the effects that differ from day to day, then the free
    parameters of the model, then what other effects would add: their score test needs no fit.
    """

    def __init__(self, vehicle: Vehicle, known: Catalogue, daily: Sequence[str] = DAILY) -> None:
        self.vehicle = vehicle
        self.free = required_free_parameters(vehicle)
        simple = {name: effect for name, effect in known.items() if _has_a_score(effect)}
        scored = candidates(vehicle, simple)
        _refuse_unknown(daily, known, scored)
        self.candidates = (
            *(c for c in scored if c.id in daily),
            *(c for c in scored if c.id not in daily),
        )
        self.unscored = tuple(n for n, effect in known.items() if n not in simple and self._could_be(effect))
        self.daily = tuple(n for c in scored if c.id in daily for n in _names(c))

    def _could_be(self, effect: type[Effect]) -> bool:
        vehicle = self.vehicle
        present = any(e.id == effect.id for e in vehicle.all_effects)
        possible = not (effect.built_in or present or vehicle.lacks(effect))
        return possible and effect.observable_in(vehicle.degrees_of_freedom)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the columns that are kept, free parameters first."""
        rest = (n for c in self.candidates for n in _names(c))
        return tuple(dict.fromkeys((*self.free, *(n for n in rest if n not in self.daily))))

    @cached_property
    def own(self) -> dict[str, tuple[str, ...]]:
        """Columns of every effect that is scored, those that differ from day to day left out."""
        return {c.id: _names(c) for c in self.candidates if not set(_names(c)) & set(self.daily)}

    @cached_property
    def base(self) -> WeakModel:
        """The model as it is."""
        return WeakModel(Functions(self.vehicle), self.free)

    @cached_property
    def _extended(self) -> list[WeakModel]:
        """Models with effects added: forces all at once, sensors one by one, where equations stay short."""
        sensors = [c for c in self.candidates if issubclass(c.effect, Measurement)]
        forces = [c for c in self.candidates if c not in sensors]
        together = self.vehicle
        for c in forces:
            together = together.with_effect(c.effect, {})
        own = tuple(dict.fromkeys((*self.free, *(n for c in forces for n in _names(c)))))
        return [WeakModel(Functions(together), own), *(c.model(_names(c)) for c in sensors)]

    @property
    def models(self) -> tuple[WeakModel, ...]:
        """The models that the columns are made from, the one as it is first."""
        return (self.base, *self._extended)

    def table(self, run: Run) -> Linearised:
        """Rows of a log in units of their noise; the columns that differ from day to day come first."""
        data = prepare([run], self.vehicle)
        p = _values(self.base)
        noise = self._noise(data, p)
        columns = self._columns(data)
        parts = self.base.linearise(data, p)
        wide = [Linearised(a.r, c, a.start, a.known) for a, c in zip(parts, columns, strict=True)]
        return whitened(wide, noise)

    def _noise(self, data: WeakData, p: Array) -> list[Whitening]:
        """Noise of the sensors, and on top what the model leaves after one step of its own."""
        first = initial_disturbance(self.base, data, p)
        sensor_noise = self.base.whitening(data, p)
        fit = fit_under_noise(
            self.base, data, {}, with_process_noise(sensor_noise, first, data), first, steps=1
        )
        return with_process_noise(sensor_noise, matched_disturbance(fit, sensor_noise), data)

    def _columns(self, data: WeakData) -> list[Array]:
        found: list[dict[str, Array]] = [{} for _ in data.segments]
        for model in self._extended:
            for known, part in zip(found, model.linearise(data, _values(model)), strict=True):
                known.update(zip(model.free, part.J.T, strict=True))
        order = (*self.daily, *self.names)
        return [np.column_stack([known[n] for n in order]) for known in found]


def _values(model: WeakModel) -> Array:
    return np.array(model.functions.values(), dtype=float)


def _names(candidate: Candidate) -> tuple[str, ...]:
    """Parameters that one step can find; those that need a search are as the catalogue has them."""
    return tuple(p.name for p in candidate.parameters if not p.assumed)


def _has_a_score(effect: type[Effect]) -> bool:
    """Whether one linear step from its neutral value determines an effect.

    Not for effects that need a search (a delay, a dead band), or that have states.
    """
    own = effect.specimen()
    sought = [p for p in own.parameters if not p.assumed]
    return not own.states and all(p.linear or set(p.starts) == {0.0} for p in sought)


def _refuse_unknown(daily: Sequence[str], known: Catalogue, scored: Sequence[Candidate]) -> None:
    for name in daily:
        if name not in known:
            raise UndertowError(f"'{name}' is not an effect of the catalogue: undertow effects lists them")
        if name not in {c.id for c in scored} and name not in DAILY:
            raise UndertowError(
                f"'{name}' cannot have a value for each day: it is in the model already, does not show in "
                f"its degrees of freedom, or needs a search; possible are {', '.join(c.id for c in scored)}"
            )


@dataclass(frozen=True)
class ReductionSettings:
    """How logs are reduced to factors."""

    rows: int = 20_000  # of a log that are in memory at a time
    # Models that one process holds ready: in a fleet, neighbours in the queue are often of the same vehicle.
    panels: int = 4
    # Stiffness of a value for one day, as a share of the information: it only keeps the factor regular.
    daily_stiffness: float = 1e-6


SETTINGS = ReductionSettings()
# Raised when what is stored changes its meaning.
_FORMAT = 2


@dataclass(frozen=True)
class LogJob:
    """Logs of a vehicle and how they are read; plain data, so that it can be sent to any machine."""

    vehicle: str  # path of the vehicle file as workers see it, or name of a bundled vehicle
    effects: tuple[str, ...] = ()  # paths of files with effects of the user
    mapping: str = "{}"  # the mapping file's content as JSON; an empty one for none
    fill: CommandPolicy | None = None  # what to do where a command has no sample
    trust_log: bool = False  # whether physically impossible logs count

    @cached_property
    def log_mapping(self) -> LogMapping | None:
        """What the columns of the logs mean."""
        return LogMapping.model_validate_json(self.mapping) if json.loads(self.mapping) else None


@dataclass(frozen=True)
class Job(LogJob):
    """What is done with every log of a vehicle."""

    values: tuple[tuple[str, float], ...] = ()  # that differ from the file's, SI and SNAME signs
    daily: tuple[str, ...] = DAILY  # effects that every log has a value of its own for
    rows: int = SETTINGS.rows  # rows that are read at a time
    fingerprint: str = ""  # hash of all that decides what comes out; empty where it is not known yet


@dataclass(frozen=True)
class Reduced:
    """All that is kept of a partition."""

    names: tuple[str, ...]  # columns of the panel
    # (k + 1, k + 1): upper triangular factor of the whitened rows; the last column is what the stated model
    # leaves. What differs from day to day is projected out
    factor: Array
    samples: int  # rows of the log that were read
    seconds: float  # time that they cover, s
    entries: int  # rows of the regression


def panel_of(job: Job) -> Panel:
    """The columns of a job; the same object for all logs that one process reduces."""
    key = job.fingerprint
    if key not in _PANELS:
        panel = _made(job)
        if fingerprint(job, panel) != key:
            raise UndertowError(
                f"this worker reads a different '{job.vehicle}' or has a different version of undertow: "
                "give workers the same files and versions"
            )
        _keep(key, panel)
    return _PANELS[key]


_PANELS: dict[str, Panel] = {}


def _keep(key: str, panel: Panel) -> None:
    while len(_PANELS) >= SETTINGS.panels:
        del _PANELS[next(iter(_PANELS))]
    _PANELS[key] = panel


def with_fingerprint(job: Job) -> tuple[Job, Panel]:
    """A job with its fingerprint, and its columns."""
    panel = _made(job)
    done = replace(job, fingerprint=fingerprint(job, panel))
    _keep(done.fingerprint, panel)
    return done, panel


def _made(job: Job) -> Panel:
    files = [Path(f) for f in job.effects]
    known = with_effects(files)
    vehicle = load_vehicle(job.vehicle, effect_files=files)
    changed = {n: replace(vehicle.value_of(n), value=v) for n, v in job.values}
    return Panel(vehicle.with_values(changed), known, job.daily)


def fingerprint(job: Job, panel: Panel) -> str:
    """Hash of all that decides what a log is reduced to, the log itself left out."""
    content = {
        "format": _FORMAT,
        "models": [content_of(model) for model in panel.models],
        "effects": [sha256_of(f) for f in job.effects],
        "environment": dict(panel.vehicle.environment),
        "columns": [*panel.daily, *panel.names],
        "mapping": json.loads(job.mapping),
        "reading": [job.rows, job.fill, job.trust_log],
    }
    return digest(content)


def identify_log(path: str, mapping: str) -> tuple[Partition, str]:
    """Whose and which day's log a file is, and the SHA-256 of its bytes."""
    sha256 = sha256_of(path)
    return partition_of(Path(path), LogMapping.model_validate_json(mapping)), sha256


def runs_of(job: Job, path: str, commands: Sequence[str]) -> Iterator[Run]:
    """Parts of a log as a job reads it, of one segment after the other."""
    for log in long_logs(Path(path), job.log_mapping, commands, missing_commands=job.fill):
        yield from (part.run for part in log.parts(job.rows, 0))


def reduce_log(job: Job, path: str, sha256: str = "") -> Reduced:
    """Reduce a log, some rows at a time.

    `sha256`: of its bytes, where it is known.
    """
    panel = panel_of(job)
    runs = runs_of(job, path, panel.vehicle.command_names)
    reduced = reduce_runs(runs, panel, path, trust_log=job.trust_log)
    if sha256 and sha256_of(path) != sha256:  # after it was read: it may still be written to
        raise UndertowError(
            f"{path} was changed while it was read, or is different for this worker: run again"
        )
    return reduced


def reduce_runs(runs: Iterable[Run], panel: Panel, where: str, *, trust_log: bool = False) -> Reduced:
    """Reduce the parts of a log; an impossible one is refused, unless it is trusted."""
    triangle, samples, seconds, refusal = TriangularFactor(len(panel.daily) + len(panel.names)), 0, 0.0, ""
    for run in runs:
        samples, seconds = samples + len(run.t), seconds + float(run.t[-1] - run.t[0])
        try:
            part = velocities_from_pose(run, panel.vehicle.degrees_of_freedom)
            table = panel.table(part)
        except UndertowError as error:  # the last few rows of a log may be too few
            refusal = str(error)
            continue
        refuse_impossible(panel.vehicle, [part], trust_log=trust_log)
        triangle.add(np.column_stack([table.J, -table.r]), len(table.r))
    if not triangle.count:
        raise UndertowError(f"{where}: {refusal or 'it has fewer than two rows'}")
    factor = _without(triangle.factor, len(panel.daily))
    if not np.isfinite(factor).all():
        raise UndertowError(f"{where}: its numbers overflow: check units and outliers (undertow doctor)")
    return Reduced(panel.names, factor, samples, seconds, triangle.count)


def _without(factor: Array, daily: int) -> Array:
    """Project out the first columns; what is left is square."""
    width = factor.shape[1]
    size = np.linalg.norm(factor[:, :daily], axis=0)
    loose = np.zeros((daily, width))
    loose[:, :daily] = np.diag(np.where(size > 0, SETTINGS.daily_stiffness * size, 1.0))
    square = np.zeros((width - daily, width - daily))
    whole = np.asarray(np.linalg.qr(np.vstack([factor, loose]), mode="r"))
    rest = whole[daily:, daily:]
    square[: len(rest)] = rest
    return square
