"""One partition reduced to a triangular factor, whatever its length."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from undertow.errors import UndertowError
from undertow.files import sha256_of
from undertow.identification.doctor import refuse_impossible
from undertow.identification.logs import Mapping, Run, velocities_from_pose
from undertow.identification.logs.chunks import LongLog, hash_of
from undertow.identification.logs.mapping import CommandPolicy
from undertow.identification.triangle import Triangle
from undertow.model.catalogue import catalogue, load_effects, merge
from undertow.model.loading import load_vehicle
from undertow.typing import Array

from .fingerprint import content_of, digest
from .panel import DAILY, Panel
from .partitions import Partition, partition_of

ROWS = 20_000
"""Rows of a log that are in memory at a time."""
# Models that one process holds ready: in a fleet, neighbours in the queue are often of the same vehicle.
_MOST_PANELS = 4
# Raised when what is stored changes its meaning.
_FORMAT = 2
# Stiffness of a value for one day, as a share of the information: it only keeps the factor regular.
_LOOSE = 1e-6


@dataclass(frozen=True)
class Job:
    """What is done with every log of a vehicle; plain data, so that it can be sent to any machine.

    Attributes
    ----------
    vehicle : str
        Path of the vehicle file as workers see it, or name of a bundled vehicle.
    effects : tuple of str
        Paths of files with effects of the user.
    mapping : str
        The mapping file's content as JSON.
    values : tuple of (str, float)
        Values of parameters that differ from the file's, SI and SNAME signs.
    daily : tuple of str
        Effects that every log has a value of its own for.
    rows : int
        Rows that are read at a time.
    fill : str, optional
        What to do where a command has no sample.
    trust_log : bool
        Whether logs count that cannot be.
    fingerprint : str
        Hash of all that decides what comes out; empty where it is not known yet.
    """

    vehicle: str
    effects: tuple[str, ...] = ()
    mapping: str = "{}"
    values: tuple[tuple[str, float], ...] = ()
    daily: tuple[str, ...] = DAILY
    rows: int = ROWS
    fill: CommandPolicy | None = None
    trust_log: bool = False
    fingerprint: str = ""

    @cached_property
    def log_mapping(self) -> Mapping:
        """What the columns of the logs mean."""
        return Mapping.model_validate_json(self.mapping)


@dataclass(frozen=True)
class Reduced:
    """All that is kept of a partition.

    Attributes
    ----------
    names : tuple of str
        Columns of the panel.
    factor : (k + 1, k + 1) array
        Upper triangular factor of the whitened rows; the last column is what the stated model leaves. What
        differs from day to day is projected out.
    samples : int
        Rows of the log that were read.
    seconds : float
        Time that they cover, s.
    entries : int
        Rows of the regression.
    """

    names: tuple[str, ...]
    factor: Array
    samples: int
    seconds: float
    entries: int


def panel_of(job: Job) -> Panel:
    """The columns of a job; the same object for all logs that one process reduces.

    Raises
    ------
    UndertowError
        If this machine has another vehicle file or another version of undertow than the one that asks.
    """
    key = job.fingerprint
    if key not in _PANELS:
        panel = _made(job)
        if fingerprint(job, panel) != key:
            raise UndertowError(
                f"this worker reads another '{job.vehicle}' or has another version of undertow: give workers "
                "the same files and versions"
            )
        _keep(key, panel)
    return _PANELS[key]


_PANELS: dict[str, Panel] = {}


def _keep(key: str, panel: Panel) -> None:
    while len(_PANELS) >= _MOST_PANELS:
        del _PANELS[next(iter(_PANELS))]
    _PANELS[key] = panel


def marked(job: Job) -> tuple[Job, Panel]:
    """A job with its fingerprint, and its columns."""
    panel = _made(job)
    done = replace(job, fingerprint=fingerprint(job, panel))
    _keep(done.fingerprint, panel)
    return done, panel


def _made(job: Job) -> Panel:
    files = [Path(f) for f in job.effects]
    known = merge(catalogue(), [cls for f in files for cls in load_effects(f)])
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


def looked_at(path: str, mapping: str) -> tuple[Partition, str]:
    """Whose and which day's log a file is, and the SHA-256 of its bytes.

    Raises
    ------
    UndertowError
        If it cannot be read, or does not say whose and which day's log it is.
    """
    try:
        sha256 = hash_of(Path(path))
    except OSError as error:
        raise UndertowError(f"{path} cannot be read: {error.strerror or error}") from error
    return partition_of(Path(path), Mapping.model_validate_json(mapping)), sha256


def reduce_log(job: Job, path: str, sha256: str = "") -> Reduced:
    """Reduce a log, some rows at a time.

    Parameters
    ----------
    job : Job
        What is done.
    path : str
        Parquet file.
    sha256 : str
        Of its bytes, where it is known.

    Raises
    ------
    UndertowError
        If the file cannot be read, is another by now, does not fit the vehicle, or has no stretch that is
        long enough.
    """
    panel = panel_of(job)
    log = LongLog(Path(path), job.log_mapping, panel.vehicle.command_names, (None, None), job.fill)
    reduced = reduce_runs((part.run for part in log.parts(job.rows, 0)), panel, path, trust_log=job.trust_log)
    if sha256 and sha256_of(path) != sha256:  # after it was read: it may still be written to
        raise UndertowError(f"{path} was changed while it was read, or is another for this worker: run again")
    return reduced


def reduce_runs(runs: Iterable[Run], panel: Panel, where: str, *, trust_log: bool = False) -> Reduced:
    """Reduce the parts of a log; one that cannot be is refused, unless it is trusted."""
    triangle, samples, seconds, refusal = Triangle(len(panel.daily) + len(panel.names)), 0, 0.0, ""
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
    loose[:, :daily] = np.diag(np.where(size > 0, _LOOSE * size, 1.0))
    square = np.zeros((width - daily, width - daily))
    whole = np.asarray(np.linalg.qr(np.vstack([factor, loose]), mode="r"))
    rest = whole[daily:, daily:]
    square[: len(rest)] = rest
    return square
