"""A comparison, or two of the same logs by two models, as the tables that pictures are drawn from."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from matplotlib.figure import Figure

from undertow.identification.compare.comparison import Comparison, Profile
from undertow.identification.estimation.predictor import Predictor, predict, predict_each
from undertow.identification.estimation.weak_form import adapted
from undertow.identification.estimation.windows import Prediction, cut
from undertow.identification.logs.run import UNITS, Run
from undertow.model.symbols import FORCE_UNITS, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from . import pictures
from .data import Budget, ErrorMap, Listing, ReportData, ResidualCurve, RunTraces, Trace
from .page import percent, quantity

# Bins in which the mean residual force may leave the noise by chance do not make a variable telling.
_CURVES = 9


def error_map(before: Comparison, after: Comparison | None = None) -> ErrorMap:
    """Residual force over its noise, by degree of freedom and regime, without regimes that do not occur."""
    rows = tuple(before.result.degrees_of_freedom)
    names = tuple(dict.fromkeys(c.regime for c in before.result.cells if c.normalised is not None))
    other = None if after is None else _map(after, rows, names)
    return ErrorMap(rows, names, _map(before, rows, names), other, quantity="residual force / noise")


def _map(comparison: Comparison, rows: tuple[str, ...], names: tuple[str, ...]) -> Array:
    table = np.full((len(rows), len(names)), np.nan)
    for cell in comparison.result.cells:
        if cell.regime in names and cell.normalised is not None:
            table[rows.index(cell.degree_of_freedom), names.index(cell.regime)] = cell.normalised
    return table


def traces(
    before: Comparison,
    after: Comparison | None = None,
    *,
    free: bool = False,
    given: Vehicle | None = None,
) -> list[RunTraces]:
    """Measured and simulated channels of every run: over windows that start from the measurement, or free.

    `given` is the model before any fit, shown beside the other two.
    """
    models = {"before": before} | ({} if after is None else {"after": after})
    shown = {name: c.free_run if free else c.ahead for name, c in models.items()}
    found = shown["before"].windows
    if given is not None:
        shown["given"] = predict(given, found, compiled=False)
    windows = f"every {before.result.horizon:g} s from the measured motion"
    starts = np.bincount(found.run, minlength=len(found.runs))
    hows = [_without_correction(int(count)) if free else windows for count in starts]
    return [
        RunTraces(run.name, tuple(_traces(i, shown)), f"simulated {how}")
        for i, (run, how) in enumerate(zip(found.runs, hows, strict=True))
    ]


def _without_correction(starts: int) -> str:
    if starts < 2:
        return "without any correction"
    return f"without any correction between gaps, in {starts} pieces that start from the measured motion"


def simulated(vehicle: Vehicle, runs: Sequence[Run], horizon: float | None) -> list[RunTraces]:
    """Measured and simulated channels of runs over windows of a length in s (None: up to the next gap).

    What belongs to each run is estimated from its first third, which is then left out, as `compare` does.
    """
    vehicles, rest = zip(*(adapted(vehicle, run) for run in runs), strict=True)
    found = predict_each(vehicles, cut(rest, vehicle, horizon), Predictor(vehicles[0], compiled=False))
    return [RunTraces(run.name, tuple(_traces(i, {"before": found}))) for i, run in enumerate(rest)]


def _traces(run: int, models: Mapping[str, Prediction]) -> Iterator[Trace]:
    # A model with values by run has the first part of a log for them: it is judged by the rest alone.
    log = max((m.windows.runs[run] for m in models.values()), key=lambda own: len(own.t))
    simulated = {which: _on_clock(prediction, run, log) for which, prediction in models.items()}
    for i, name in enumerate(models["before"].names):
        if log.has(name):
            along = log.channels[name]
            lines = {which: _like(values[:, i], along, name) for which, values in simulated.items()}
            yield Trace(name, UNITS[name], log.t, log.reports(name), **lines)


def _on_clock(prediction: Prediction, run: int, log: Run) -> Array:
    """Predictions at the samples of a log; NaN where none reaches, and at the end of every window."""
    windows = prediction.windows
    result = np.full((len(log.t), len(windows.names)), np.nan)
    before = int(
        np.searchsorted(log.t, windows.runs[run].t[0])
    )  # samples of the log, of which the run is a part
    inside = windows.inside.copy()
    # A window ends where the next begins; that sample shows the new start, and one before it breaks the line.
    for k in np.flatnonzero(windows.run == run).tolist():
        rows = before + windows.samples[k][inside[k]]
        result[rows[:-1]] = prediction.predicted[k][inside[k]][:-1]
        result[rows[-1]] = np.nan
    return result


def _like(simulated: Array, measured: Array, name: str) -> Array:
    """A heading that was unwrapped for the simulation is brought back to the turn of the log."""
    if UNITS[name] != "rad":
        return simulated
    turns = np.nan_to_num(np.round((simulated - measured) / (2 * np.pi)))
    there = np.asarray(simulated - 2 * np.pi * turns)
    there[1:][np.diff(turns) != 0] = np.nan  # a line across the picture would be no motion
    return there


def curves(before: Comparison, after: Comparison | None = None) -> list[ResidualCurve]:
    """Residual force against every variable, the most telling variables of each degree of freedom first."""
    other = {(p.degree_of_freedom, p.variable): p for p in (after.profiles if after else ())}
    found = []
    for i, dof in enumerate(before.result.degrees_of_freedom):
        unit = FORCE_UNITS[before.vehicle.dof_indices[i]]
        own = sorted((p for p in before.profiles if p.degree_of_freedom == dof), key=telling, reverse=True)
        found += [ResidualCurve(unit, p, other.get((dof, p.variable))) for p in own]
    return found


def telling(profile: Profile) -> float:
    """Mean square of the binned residual force over its standard error: about 1 where it is noise."""
    sure = profile.error > 0
    return float(np.mean((profile.force[sure] / profile.error[sure]) ** 2)) if sure.any() else 0.0


def budgets(comparison: Comparison) -> list[Budget]:
    """Rms force of every effect by degree of freedom; the residual is called unexplained."""
    result = comparison.result
    return [
        Budget(
            dof,
            FORCE_UNITS[comparison.vehicle.dof_indices[i]],
            {share.effect: share.rms for share in result.budget if share.degree_of_freedom == dof},
        )
        for i, dof in enumerate(result.degrees_of_freedom)
    ]


def leading(found: Sequence[ResidualCurve], dof: str, most: int = _CURVES) -> list[ResidualCurve]:
    """The most telling variables of one degree of freedom."""
    return [c for c in found if c.before.degree_of_freedom == dof][:most]


def comparison_pictures(comparison: Comparison) -> dict[str, Figure]:
    """All pictures of one model on its logs, by a name that a file may have."""
    names, found = (comparison.result.vehicle, ""), curves(comparison)
    drawn = {
        "error_map": pictures.error_map(error_map(comparison), names),
        "force_budget": pictures.force_budget(budgets(comparison)),
    }
    for dof in comparison.result.degrees_of_freedom:
        drawn[f"residual_{dof}"] = pictures.residual_against(leading(found, dof), names)
    for kind, free in (("ahead", False), ("free_run", True)):
        for i, run in enumerate(traces(comparison, free=free), start=1):
            drawn[f"{kind}_{i}_{_safe(run.run)}"] = pictures.measured_vs_simulated(run, names)
    return drawn


def _safe(name: str) -> str:
    return "".join(c if (c.isalnum() and c.isascii()) or c in "-_." else "_" for c in name)[:60]


# Panels for each degree of freedom: those of the variables that the residual follows most.
_MOST_VARIABLES = 6
_PROGRAMS = ("numpy", "scipy", "casadi", "sympy")


def report_data(
    before: Comparison,
    after: Comparison | None = None,
    *,
    names: tuple[str, str] = ("model as given", "with what is missing"),
    given: Vehicle | None = None,
) -> ReportData:
    """What a report shows of a model, and of the same model with something added, on the same logs.

    Without `after` one model is shown; pictures call the two by their `names`; `given` is the model before
    any fit.
    """
    result = before.result
    both = [c for c in (before, after) if c is not None]
    found = curves(before, after)
    ahead = f"over {result.horizon:g} s, from {result.windows} measured starts"
    return ReportData(
        before=names[0],
        after=names[1],
        headlines=tuple(f"{name}: {c.result.headline}" for name, c in zip(names, both, strict=False)),
        maps=(error_map(before, after),),
        runs=tuple(_velocities_first(run) for run in traces(before, after, free=True, given=given)),
        residuals=tuple(c for dof in result.degrees_of_freedom for c in leading(found, dof, _MOST_VARIABLES)),
        budgets=tuple(budgets(both[-1])),
        fits=_fits(before, after),
        settings={"prediction ahead": ahead},
        versions=versions(),
    )


def versions() -> dict[str, str]:
    """Versions of Python and of the libraries that work out the numbers."""
    found = {"Python": f"{platform.python_version()} on {platform.system()} {platform.machine()}"}
    for name in _PROGRAMS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # installed without metadata, by a system's own packages
            found[name] = "version unknown"
    return found


def _velocities_first(run: RunTraces) -> RunTraces:
    """The fit looks at the velocities; the pose drifts in a free run."""
    return replace(run, traces=tuple(sorted(run.traces, key=lambda t: t.channel not in VELOCITY)))


def _fits(before: Comparison, after: Comparison | None) -> Listing:
    later = {c.channel: c for c in after.result.channels} if after else {}
    rows = []
    for channel in before.result.channels:
        shown = [channel, *([later[channel.channel]] if channel.channel in later else [])]
        ahead = " → ".join(quantity(c.ahead_rms, channel.unit, 3) for c in shown)
        free = " → ".join(percent(None if c.free_run_fit is None else c.free_run_fit / 100.0) for c in shown)
        rows.append((channel.channel, quantity(channel.noise, channel.unit, 2), ahead, free))
    ahead = f"error {before.result.horizon:g} s ahead, rms"
    return Listing(("channel", "noise", ahead, "free-run fit (100 % is perfect)"), tuple(rows))
