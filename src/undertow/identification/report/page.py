"""The report: results of a model on its logs, in one self-contained HTML file."""

from __future__ import annotations

import platform
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from math import floor, isfinite, log10

import numpy as np
from jinja2 import Template
from markupsafe import Markup
from matplotlib.figure import Figure

from undertow.figures import svg, unit_text
from undertow.files import templates
from undertow.identification.comparison import Comparison, Profile
from undertow.identification.diagnosis.result import Diagnosis, Estimate, Ranked, established, explanations
from undertow.identification.estimation.predictor import Predictor, predict, predict_each
from undertow.identification.estimation.weak_form import adapted
from undertow.identification.estimation.windows import Prediction, cut
from undertow.identification.logs.run import UNITS, Run
from undertow.model.symbols import FORCE_UNITS, MOTION_UNITS, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .pictures import (
    Budget,
    ErrorMap,
    Listing,
    ReportData,
    ResidualCurve,
    RunTraces,
    Trace,
    error_map,
    falling_error,
    force_budget,
    measured_vs_simulated,
    ranking,
    residual_against,
)
from .sentences import chance, significance_text


# --- results of a model for a report --------------------------------------------------------------
@dataclass(frozen=True)
class PageSettings:
    """How much a report shows."""

    compared_variables: int = 9  # variables that residual forces of a comparison are drawn against
    # The same on the page of a diagnosis: for each degree of freedom those that the residual follows most.
    page_variables: int = 6
    page_runs: int = 3  # a page with the channels of many runs would take minutes to open


SETTINGS = PageSettings()


def errors_by_regime(before: Comparison, after: Comparison | None = None) -> ErrorMap:
    """Residual force over its noise, by degree of freedom and regime, without regimes that do not occur."""
    rows = tuple(before.result.degrees_of_freedom)
    occurring = {c.regime for c in before.result.cells if c.normalised is not None}
    names = tuple(dict.fromkeys(r.name for r in before.regimes if r.name in occurring))
    other = None if after is None else _map(after, rows, names)
    return ErrorMap(rows, names, _map(before, rows, names), other, quantity="× noise")


def _map(comparison: Comparison, rows: tuple[str, ...], names: tuple[str, ...]) -> Array:
    table = np.full((len(rows), len(names)), np.nan)
    for cell in comparison.result.cells:
        if cell.regime in names and cell.normalised is not None:
            table[rows.index(cell.degree_of_freedom), names.index(cell.regime)] = cell.normalised
    return table


def traces(
    before: Comparison, after: Comparison | None = None, *, free: bool = False, given: Vehicle | None = None
) -> list[RunTraces]:
    """Measured and simulated channels of every run: over windows that start from the measurement, or free.

    `given` is the model before any fit, shown beside the other two.
    """
    models = {"before": before} | ({} if after is None else {"after": after})
    predictions = {name: c.free_run if free else c.ahead for name, c in models.items()}
    found = predictions["before"].windows
    if given is not None:
        predictions["given"] = predict(given, found, compiled=False)
    windows = f"every {before.result.horizon:g} s from the measured motion"
    traced = []
    for i, run in enumerate(found.runs):
        starts = int(np.count_nonzero(found.run == i))
        pieces = f" between gaps, in {starts} pieces that start from the measured motion"
        manner = f"without any correction{pieces if starts > 1 else ''}" if free else windows
        traced.append(RunTraces(run.name, tuple(_traces(i, predictions)), f"simulated {manner}"))
    return traced


def simulated(vehicle: Vehicle, runs: Sequence[Run], horizon: float | None) -> list[RunTraces]:
    """Measured and simulated channels of runs over windows of a length in s (None: up to the next gap).

    Values of each run are estimated from its first third, which is then left out, as in `compare`.
    """
    vehicles, rest = zip(*(adapted(vehicle, run) for run in runs), strict=True)
    found = predict_each(vehicles, cut(rest, vehicle, horizon), Predictor(vehicles[0], compiled=False))
    return [RunTraces(run.name, tuple(_traces(i, {"before": found}))) for i, run in enumerate(rest)]


def _traces(run: int, models: Mapping[str, Prediction]) -> Iterator[Trace]:
    # A model with values by run estimates them from the first part of a log, and predicts only the rest.
    log = max((m.windows.runs[run] for m in models.values()), key=lambda r: len(r.t))
    simulated = {which: _at_samples(prediction, run, log) for which, prediction in models.items()}
    for i, name in enumerate(models["before"].names):
        if log.has(name):
            measured = log.channels[name]
            lines = {k: _wrapped_like(values[:, i], measured, name) for k, values in simulated.items()}
            yield Trace(name, UNITS[name], log.t, log.reports(name), **lines)


def _at_samples(prediction: Prediction, run: int, log: Run) -> Array:
    """Predictions at the samples of a log; NaN outside the windows, and at the end of every window."""
    windows = prediction.windows
    result = np.full((len(log.t), len(windows.names)), np.nan)
    first = int(np.searchsorted(log.t, windows.runs[run].t[0]))  # the run is a part of the log
    # A window ends where the next one begins: its last sample is left out, which breaks the line.
    for k in np.flatnonzero(windows.run == run).tolist():
        inside = windows.inside[k]
        rows = first + windows.samples[k][inside]
        result[rows[:-1]] = prediction.predicted[k][inside][:-1]
        result[rows[-1]] = np.nan
    return result


def _wrapped_like(simulated: Array, measured: Array, name: str) -> Array:
    """A simulated angle, wrapped as the measured one."""
    if UNITS[name] != "rad":
        return simulated
    turns = np.nan_to_num(np.round((simulated - measured) / (2 * np.pi)))
    wrapped = np.asarray(simulated - 2 * np.pi * turns)
    wrapped[1:][np.diff(turns) != 0] = np.nan  # no line across the picture
    return wrapped


def curves(before: Comparison, after: Comparison | None = None) -> list[ResidualCurve]:
    """Residual force against every variable, the most informative of each degree of freedom first."""
    other = {(p.degree_of_freedom, p.variable): p for p in (after.profiles if after else ())}
    found = []
    for i, dof in enumerate(before.result.degrees_of_freedom):
        unit = FORCE_UNITS[before.vehicle.dof_indices[i]]
        profiles = (p for p in before.profiles if p.degree_of_freedom == dof)
        ordered = sorted(profiles, key=informativeness, reverse=True)
        found += [ResidualCurve(unit, p, other.get((dof, p.variable))) for p in ordered]
    return found


def informativeness(profile: Profile) -> float:
    """Mean square of the binned residual force over its standard error: about 1 where it is noise."""
    valid = profile.error > 0
    return float(np.mean((profile.force[valid] / profile.error[valid]) ** 2)) if valid.any() else 0.0


def budgets(comparison: Comparison) -> list[Budget]:
    """Rms force of every effect by degree of freedom; that of the residual is named unexplained."""
    result = comparison.result
    return [
        Budget(
            dof,
            FORCE_UNITS[comparison.vehicle.dof_indices[i]],
            {share.effect: share.rms for share in result.budget if share.degree_of_freedom == dof},
        )
        for i, dof in enumerate(result.degrees_of_freedom)
    ]


def leading(
    found: Sequence[ResidualCurve], dof: str, most: int = SETTINGS.compared_variables
) -> list[ResidualCurve]:
    """The most informative variables of one degree of freedom."""
    return [c for c in found if c.before.degree_of_freedom == dof][:most]


def comparison_pictures(comparison: Comparison) -> dict[str, Figure]:
    """All pictures of one model on its logs, by a name that a file may have."""
    names, found, errors = (comparison.result.vehicle, ""), curves(comparison), errors_by_regime(comparison)
    drawn = {"error_map": error_map(errors, names)} if errors.regimes else {}
    drawn["force_budget"] = force_budget(budgets(comparison))
    for dof in comparison.result.degrees_of_freedom:
        drawn[f"residual_{dof}"] = residual_against(leading(found, dof), names)
    for kind, free in (("ahead", False), ("free_run", True)):
        for i, run in enumerate(traces(comparison, free=free), start=1):
            name = re.sub(r"[^A-Za-z0-9_.-]", "_", run.run)[:60]
            drawn[f"{kind}_{i}_{name}"] = measured_vs_simulated(run, names)
    return drawn


_PROGRAMS = ("numpy", "scipy", "casadi", "sympy")


def report_data(
    before: Comparison,
    after: Comparison | None = None,
    *,
    names: tuple[str, str] = ("model as given", "with what is missing"),
    given: Vehicle | None = None,
) -> ReportData:
    """Results of a model, and of the same model with something added, on the same logs.

    `names` are those of the two in pictures; `given` is the unfitted model.
    """
    result = before.result
    both = [c for c in (before, after) if c is not None]
    found = curves(before, after)
    # The velocities come first, which are fitted; the pose drifts in a free run.
    runs = [
        replace(run, traces=tuple(sorted(run.traces, key=lambda t: t.channel not in VELOCITY)))
        for run in traces(before, after, free=True, given=given)
    ]
    ahead = f"over {result.horizon:g} s, from {result.windows} measured starts"
    return ReportData(
        before=names[0],
        after=names[1],
        headlines=tuple(f"{name}: {c.result.headline}" for name, c in zip(names, both, strict=False)),
        maps=(errors_by_regime(before, after),),
        runs=tuple(runs),
        residuals=tuple(
            c for dof in result.degrees_of_freedom for c in leading(found, dof, SETTINGS.page_variables)
        ),
        budgets=tuple(budgets(both[-1])),
        fits=_fits(before, after),
        settings={"prediction ahead": ahead},
        versions=versions(),
    )


def versions() -> dict[str, str]:
    """Versions of Python and of the numerical libraries."""
    found = {"Python": f"{platform.python_version()} on {platform.system()} {platform.machine()}"}
    for name in _PROGRAMS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # installed without metadata, by a system's own packages
            found[name] = "version unknown"
    return found


def _fits(before: Comparison, after: Comparison | None) -> Listing:
    later = {c.channel: c for c in after.result.channels} if after else {}
    rows = []
    for channel in before.result.channels:
        shown = [channel, *([later[channel.channel]] if channel.channel in later else [])]
        ahead = " → ".join(quantity(c.ahead_rms, channel.unit, 3) for c in shown)
        free = " → ".join(percent(None if c.free_run_fit is None else c.free_run_fit / 100.0) for c in shown)
        rows.append((channel.channel, quantity(channel.noise, channel.unit, 2), ahead, free))
    ahead = f"error {before.result.horizon:g} s ahead, rms"
    return Listing(("channel", "noise", ahead, "free-run fit (100% is perfect)"), tuple(rows))


# --- the page -------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Meaning:
    """A verdict explained: its title, what it means, and what it does not."""

    title: str
    says: str
    not_shown: tuple[str, ...]


@cache
def meanings() -> dict[str, Meaning]:
    """Every verdict explained; as ``other_values`` one that names values instead of effects, and as
    ``one_of_several_too`` one that names an effect beside a set; as ``only_disturbance`` an adequate model
    that leaves more than noise.
    """
    text = (files("undertow.identification.report") / "templates" / "verdicts.toml").read_text("utf-8")
    tables = tomllib.loads(text)
    always = tables.pop("always")["not_shown"]
    return {
        verdict: Meaning(m["title"], m["says"], (*filter(None, [m.get("not_shown")]), *always))
        for verdict, m in tables.items()
    }


def meaning(diagnosis: Diagnosis) -> Meaning:
    """What the verdict of a diagnosis means, and what it does not."""
    key = str(diagnosis.verdict)
    if key == "adequate" and diagnosis.freed:
        key = "other_values"
    elif key == "adequate" and diagnosis.predictable:  # only looked for where more than noise remains
        key = "only_disturbance"
    elif key == "indistinguishable" and established(diagnosis.effects, diagnosis.indistinguishable):
        key = "one_of_several_too"
    found = meanings()[key]
    if not any(run.role == "blocks" for run in diagnosis.runs):
        return found
    more = (
        "How the model does on another day: the validation data are blocks of the same runs, not whole "
        "runs (give some with --validation)."
    )
    return replace(found, not_shown=(*found.not_shown, more))


def parameter_text(name: str) -> str:
    """A parameter as tables print it: ``X_uabsu`` gives ``X_u|u|``."""
    return re.sub(r"^([XYZKMN]_\w)abs(\w)", r"\1|\2|", name)


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """A number with its unit; an en dash where there is none."""
    if value is None:
        return "–"
    number = f"{value:.{digits}g}" if isfinite(value) else "not finite"
    shown = unit_text(unit)
    return (number if shown in ("", "1") else f"{number} {shown}").replace("-", "−", 1 if value < 0 else 0)


def with_error(value: float, error: float | None, unit: str) -> str:
    """A value and its standard error, which has two digits: ``5.124 ± 0.012 kg``."""
    if error is None or not isfinite(error) or not isfinite(value) or error <= 0:
        return quantity(value, unit)
    places = max(0, 1 - floor(log10(error)))
    number = f"{value:.{places}f} ± {error:.{places}f}"
    if places > 8 or error >= 1e5:
        number = f"{value:.4g} ± {error:.2g}"
    shown = unit_text(unit)
    return (number if shown in ("", "1") else f"({number}) {shown}").replace("-", "−")


def estimate_text(estimate: Estimate) -> str:
    """A parameter with value, standard error and unit."""
    number = with_error(estimate.value, estimate.standard_error, estimate.unit)
    return f"{parameter_text(estimate.name)} = {number}"


def prior_text(estimate: Estimate) -> str:
    """The value that the vehicle file states."""
    if estimate.prior is None:
        return "–"
    return with_error(estimate.prior, estimate.prior_sigma, estimate.unit)


def percent(share: float | None) -> str:
    """A share as per cent."""
    if share is None or not isfinite(share):
        return "–"
    return f"{100 * share:.3g}%".replace("-", "−")


def render_report(diagnosis: Diagnosis, data: ReportData | None = None) -> str:
    """One self-contained HTML page: no script, and nothing is loaded from anywhere.

    Names out of files are escaped, in the text and inside the pictures. A section without data says so.
    """
    shown = data or ReportData()
    return _template().render(
        d=diagnosis,
        data=shown,
        meaning=meaning(diagnosis),
        explanations=explanations(diagnosis.ranking, diagnosis.false_alarm_rate),
        runs=shown.runs[: SETTINGS.page_runs],
        units=MOTION_UNITS,
        influential=[c for c in diagnosis.ranking if has_influence(c, diagnosis)],
        without_influence=[c for c in diagnosis.ranking if not has_influence(c, diagnosis)],
        left_out=[run.run for run in shown.runs[SETTINGS.page_runs :]],
        pictures=_Pictures(diagnosis, shown),
    )


def has_influence(candidate: Ranked, diagnosis: Diagnosis) -> bool:
    """Whether a candidate matters in the search or in the verdict; the others are collapsed."""
    named = {*diagnosis.effects, *(e for s in diagnosis.indistinguishable for e in s.effects)}
    return bool(candidate.parameters) or candidate.significant or candidate.effect in named


@cache
def _template() -> Template:
    environment = templates("undertow.identification.report", html=True)
    tools: list[Callable[..., str]] = [chance, estimate_text, parameter_text, percent, prior_text, quantity]
    tools += [significance_text, with_error, unit_text]
    environment.filters |= {tool.__name__: tool for tool in tools}
    return environment.get_template("report.html")


class _Pictures:
    """The pictures of the template, each with unique ids."""

    def __init__(self, diagnosis: Diagnosis, data: ReportData) -> None:
        self._diagnosis, self._data = diagnosis, data
        self._names = (data.before, data.after)
        self._count = 0

    def falling(self) -> Markup:
        return self._inline(falling_error(self._diagnosis.steps, "refitted"))

    def ranking(self) -> Markup:
        d = self._diagnosis
        return self._inline(ranking([c for c in d.ranking if has_influence(c, d)]))

    def maps(self) -> Iterator[Markup]:
        return (self._inline(error_map(m, self._names)) for m in self._data.maps if m.regimes)

    def run(self, place: int) -> Markup:
        return self._inline(measured_vs_simulated(self._data.runs[place], self._names))

    def residuals(self) -> Iterator[Markup]:
        """One picture for each degree of freedom."""
        for dof in dict.fromkeys(c.before.degree_of_freedom for c in self._data.residuals):
            curves = [c for c in self._data.residuals if c.before.degree_of_freedom == dof]
            yield self._inline(residual_against(curves, self._names))

    def budgets(self) -> Markup:
        return self._inline(force_budget(self._data.budgets))

    def _inline(self, picture: Figure) -> Markup:
        self._count += 1
        # matplotlib escapes the names that it draws, so this is markup of our own.
        return Markup(svg(picture, f"p{self._count}"))
