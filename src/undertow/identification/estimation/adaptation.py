"""A vehicle in a run that it was not fitted to: what belongs to each run comes from the first part of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags, Index

from .by_run import run_of, value_name
from .data import WeakData, prepare
from .fitted import Fitted
from .residual import WeakModel
from .weak_form import fit_weak


@dataclass(frozen=True)
class AdaptationSettings:
    """Numbers of the adaptation to a run."""

    # Share of a run from which what belongs to it is estimated; the rest judges. A current or a trim takes
    # a few manoeuvres to show, and what judges should be the larger part.
    share: float = 1.0 / 3.0


SETTINGS = AdaptationSettings()


def of_each_run(vehicle: Vehicle) -> tuple[str, ...]:
    """Parameters that have a value in every run: those with ``per_run = true`` that may be estimated."""
    values = ((n, vehicle.value_of(n)) for n in vehicle.parameter_names)
    return tuple(n for n, value in values if value.per_run and value.estimate)


def adapted(vehicle: Vehicle, run: Run) -> tuple[Vehicle, Run]:
    """A vehicle as it is in a run, and the part of the run by which it may be judged.

    What belongs to each run (current, trim: ``per_run = true``) is estimated by the weak form from the first
    part of the run, all else being as stated; the stated value with its sigma, the mean and the spread of the
    runs that were fitted, holds what this part leaves open. Nothing is estimated from what judges. Where
    nothing belongs to each run, or nothing of it may be estimated, vehicle and run are returned as they are.
    """
    names = of_each_run(vehicle)
    if not names:
        return vehicle, run
    end = end_of_first_part(run)
    first, rest = run.slice(None, end), run.slice(end, None)
    rest = rest.with_notes(f"{', '.join(names)} from the run up to {end:.4g} s; the rest is for validation")
    try:
        return fit_weak(vehicle, prepare([first], vehicle), names).vehicle, rest
    except UndertowError:  # too short for the weak form, or without a finite force: the mean has to do
        return vehicle, rest


def end_of_first_part(run: Run) -> float:
    """When the part of a run ends from which what belongs to it is estimated, s (see `adapted`)."""
    return float(run.t[0]) + SETTINGS.share * float(run.t[-1] - run.t[0])


def first_part(run: Run, vehicle: Vehicle, sigma: Array | None = None) -> WeakData | None:
    """That part, prepared for the weak form; None where it is too short."""
    try:
        return prepare([run.slice(None, end_of_first_part(run))], vehicle, sigma)
    except UndertowError:
        return None


def values_in(fit: Fitted, first_parts: Sequence[WeakData]) -> dict[str, float]:
    """Values in runs that a fit was not fitted to, by names such as V_N@dive2, from their first parts."""
    found: dict[str, float] = {}
    names = list(fit.model.values.by_run)
    for data in first_parts:
        own = fit_weak(WeakModel(fit.model.functions, names), data, start=fit.values).values
        found |= {value_name(name, data.runs[0].origin): own[name] for name in names}
    return found


def in_run(fit: Fitted, run: Run) -> tuple[Vehicle, Run]:
    """A fitted vehicle in a run, and the part of the run by which it may be judged (see `adapted`).

    A run that was fitted, or a stretch of one, has the values found for it, and all of it judges.
    """
    if run.origin in fit.runs_with_values:
        return fit.vehicle_in(run), run
    if run.origin in {run_of(name) for name in fit.model.values.known}:
        return fit.vehicle_in(run), run.slice(end_of_first_part(run), None)
    return adapted(fit.vehicle, run)


def learned_from(fit: Fitted, runs: Sequence[Run], run: Index, time: Array) -> Flags:
    """Which rows or windows, of these runs and at these times, a fit has learned values of the run from."""
    known = {run_of(name) for name in fit.model.values.known}
    ends = np.array([end_of_first_part(r) if r.origin in known else -np.inf for r in runs])
    return np.asarray(time < ends[run])


def factor_of_the_rest(squares: Array, first: Flags, group: Index) -> Array:
    """Factor by which squares in what was learned from count as those of the rest do, never less than 1.

    squares: (m,) or (m, n), by row or window and quantity.
    first: (m,), what was learned from.
    group: (m,), groups that count by themselves, such as runs.
    """
    factor = np.ones(squares.shape)
    for number in np.unique(group[first]):
        learned, rest = ((group == number) & rows for rows in (first, ~first))
        if rest.any():
            means = [np.mean(squares[rows], axis=0) for rows in (learned, rest)]
            factor[learned] = np.maximum(means[1] / np.maximum(means[0], 1e-300), 1.0)
    return factor


def in_runs(fit: Fitted, runs: Sequence[Run]) -> tuple[list[Vehicle], list[Run]]:
    """The same for several runs: a vehicle for each, and what is left of each to judge by."""
    pairs = [in_run(fit, run) for run in runs]
    return [vehicle for vehicle, _ in pairs], [rest for _, rest in pairs]
