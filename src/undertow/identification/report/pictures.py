"""Report contents other than the diagnosis, as plain arrays and words, and their figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from undertow.errors import UndertowError
from undertow.figures import (
    AFTER,
    BEFORE,
    COLOURS,
    FAINT,
    FLOOR,
    INK,
    figure,
    in_powers,
    look,
    plain,
    with_unit,
)
from undertow.identification.comparison import Profile
from undertow.identification.diagnosis.result import Ranked, Step
from undertow.identification.doctor.examine import Examined
from undertow.identification.doctor.kinematics import Kinematics
from undertow.identification.findings import percent
from undertow.identification.logs.formats.fieldlog import FieldLog
from undertow.identification.logs.run import UNITS, Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array


# --- what is shown --------------------------------------------------------------------------------
@dataclass(frozen=True)
class Trace:
    """One channel of one run, measured and simulated by two models, (n,) each; NaN breaks a line."""

    channel: str
    unit: str
    t: Array
    measured: Array
    before: Array
    after: Array | None = None
    given: Array | None = None  # simulated by the model before any fit


@dataclass(frozen=True)
class RunTraces:
    """All channels of one run."""

    run: str
    traces: tuple[Trace, ...]
    caption: str = ""  # how they were simulated


@dataclass(frozen=True)
class ErrorMap:
    """An error of two models by degree of freedom and regime, (n_rows, n_regimes); NaN without data."""

    rows: tuple[str, ...]
    regimes: tuple[str, ...]
    before: Array
    after: Array | None = None
    quantity: str = "error / noise"  # what the numbers are, with their unit
    floor: float | None = 1.0  # what noise alone gives


@dataclass(frozen=True)
class ResidualCurve:
    """Mean residual force, in `unit`, of one degree of freedom in bins of one variable, by two models."""

    unit: str
    before: Profile
    after: Profile | None = None


@dataclass(frozen=True)
class Budget:
    """Root mean square of every effect's force in one degree of freedom, by effect id, in `unit`."""

    degree_of_freedom: str
    unit: str
    shares: dict[str, float]


@dataclass(frozen=True)
class Listing:
    """A table in words: first row of `head`, then `rows`; every number in it carries its unit."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class ReportData:
    """Everything that a report draws of two models, `before` and `after`, on the validation runs."""

    before: str = "model as given"
    after: str = "with what is missing"
    headlines: tuple[str, ...] = ()  # where the models fail most
    maps: tuple[ErrorMap, ...] = ()
    runs: tuple[RunTraces, ...] = ()
    residuals: tuple[ResidualCurve, ...] = ()
    budgets: tuple[Budget, ...] = ()  # those of the final model
    fits: Listing | None = None
    settings: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)


# --- pictures -------------------------------------------------------------------------------------
_UNEXPLAINED = "unexplained"
# Few enough colours that the colour bar is drawn as lines and not put into the page as an image.
_HEAT = colormaps["YlOrRd"].resampled(40)


@dataclass(frozen=True)
class PictureSettings:
    """How much pictures show, and where lines and axes end."""

    candidates: int = 12
    gap: float = 3.0  # times the median interval between samples: a longer one breaks the line
    # A simulation is cut off where it is outside the range of the measurement by more than this many times
    # it.
    simulated_range: float = 1.0
    buckets: int = 250  # of a line, each a pixel or two wide
    points: int = 1500  # of a panel
    outliers: float = 0.002  # share of the points at either end that the axes of a panel leave out


SETTINGS = PictureSettings()


def _plain_number(value: float, _: int) -> str:
    return f"{value:g}".replace("-", "\N{MINUS SIGN}")


def before_and_after(before: Mapping[str, float], after: Mapping[str, float]) -> Figure:
    """The error of every velocity as a share of the motion, by the model as given and refitted."""
    with look():
        picture, axes = figure(3.4)
        axis = axes[0, 0]
        for shift, name, shares in ((-0.2, "as given", before), (0.2, "refitted", after)):
            heights = [100 * share for share in shares.values()]
            axis.bar([i + shift for i in range(len(heights))], heights, 0.4, label=name)
        axis.set_xticks(range(len(before)), list(before))
        axis.set_ylabel("error, % of the motion")
        axis.legend()
    return picture


def falling_error(steps: Sequence[Step], first: str = "model as given") -> Figure:
    """The error on validation data against the effects added, down to the noise floor, and of predictions.

    `first` says what the first step is.
    """
    horizons = list(dict.fromkeys(h for step in steps for h in step.ahead))
    added = ("\n".join(f"+ {plain(name, 24)}" for name in step.changes) for step in steps)
    names = [name or ("refitted" if i else first) for i, name in enumerate(added)]
    with look():
        picture, axes = figure(3.4, 1, 2 if horizons else 1)
        if horizons:
            _predictions(axes[0, 1], steps, horizons, names)
        axis = axes[0, 0]
        errors = [step.error for step in steps]
        axis.axhline(1.0, color=FLOOR, linestyle="--")
        above = {"ha": "left", "va": "bottom", "transform": axis.get_yaxis_transform()}
        axis.text(0.01, 1.02, "noise floor", color=FLOOR, **above)
        axis.plot(range(len(errors)), errors, color=FAINT, zorder=1)
        colours = [BEFORE, *[AFTER] * (len(errors) - 1)]
        axis.scatter(range(len(errors)), errors, color=colours[: len(errors)], s=64, zorder=2)
        for i, error in enumerate(errors):
            axis.annotate(f"{error:.3g}", (i, error), (8, 6), textcoords="offset points")
        axis.set_xticks(range(len(errors)), names)
        axis.set_xlim(-0.4, max(len(errors) - 0.4, 1.0))
        _log_axis(axis, [*errors, 1.0])
        axis.set_ylabel("validation error [times noise]")
        axis.grid(axis="y")
    return picture


def _predictions(axis: Any, steps: Sequence[Step], horizons: Sequence[str], names: Sequence[str]) -> None:
    """Error of predicted velocities by horizon, a gap where a prediction diverges."""
    for horizon, colour in zip(horizons, COLOURS, strict=False):
        errors = [100 * step.ahead.get(horizon, np.nan) for step in steps]
        axis.plot(range(len(errors)), errors, color=colour, marker="o", label=horizon)
    axis.set_xticks(range(len(names)), names)
    axis.set_xlim(-0.4, max(len(names) - 0.4, 1.0))
    axis.set_ylim(bottom=0.0)
    axis.set_ylabel("velocity error ahead [% of motion]")
    axis.legend(title="ahead", fontsize=9)
    axis.grid(axis="y")


def _log_axis(axis: Any, values: Sequence[float]) -> None:
    finite = [v for v in values if np.isfinite(v) and v > 0]
    axis.set_yscale("log")
    axis.set_ylim(min(finite) / 1.25, max(finite) * 1.5)
    ticks = [t for t in _TICKS if min(finite) / 1.25 <= t <= max(finite) * 1.5]
    axis.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axis.minorticks_off()


_TICKS = [m * 10.0**e for e in range(-3, 7) for m in (1, 2, 5)]


def ranking(ranked: Sequence[Ranked]) -> Figure:
    """The leading candidates: fall of the mean square on validation data, with 95% intervals."""
    shown = list(ranked)[: SETTINGS.candidates]
    with look():
        picture, axes = figure(1.1 + 0.32 * max(len(shown), 1))
        axis = axes[0, 0]
        axis.set_xscale("symlog", linthresh=0.1)  # before anything is drawn: it sets the margins
        axis.xaxis.get_major_locator().set_params(numticks=7)
        for i, candidate in enumerate(shown):
            colour = AFTER if candidate.significant else FAINT
            if np.isfinite(candidate.interval).all():
                axis.plot(candidate.interval, [i, i], color=colour, linewidth=3, alpha=0.5)
            face = colour if candidate.significant else "none"
            axis.scatter([candidate.improvement], [i], s=46, color=colour, facecolor=face, zorder=3)
        axis.axvline(0.0, color=INK, linewidth=0.8)
        axis.xaxis.set_major_formatter(_plain_number)
        axis.set_yticks(range(len(shown)), [plain(c.effect) for c in shown])
        axis.invert_yaxis()
        axis.set_xlabel("fall of the validation mean square [times noise variance]; filled: more than chance")
        axis.grid(axis="x")
    return picture


def error_map(errors: ErrorMap, names: tuple[str, str] = ("before", "after")) -> Figure:
    """Error by degree of freedom and regime, of one model or of two below each other."""
    tables = [t for t in (errors.before, errors.after) if t is not None]
    rows = len(errors.rows)
    with look():
        picture, axes = figure(1.3 + len(tables) * (0.45 + 0.34 * rows), len(tables), sharex=True)
        image = None
        for axis, table, name in zip(axes[:, 0], tables, names, strict=False):
            image = _heat(axis, table, errors)
            axis.set_title(plain(name))
            axis.set_yticks(np.arange(rows) + 0.5, [plain(r) for r in errors.rows])
        columns = [plain(r, 30) for r in errors.regimes]
        places = np.arange(len(columns)) + 0.5
        axes[-1, 0].set_xticks(places, columns, rotation=35, ha="right", rotation_mode="anchor")
        bar = picture.colorbar(image, ax=list(axes[:, 0]), shrink=0.9, pad=0.02)
        bar.set_label(plain(errors.quantity))
        bar.ax.yaxis.set_major_formatter(_plain_number)
        bar.ax.yaxis.set_minor_formatter(LogFormatter())  # labels few where there are many
    return picture


def _heat(axis: Any, table: Array, errors: ErrorMap) -> Any:
    both = np.concatenate([t.ravel() for t in (errors.before, errors.after) if t is not None])
    both = both[np.isfinite(both) & (both > 0)]
    low = errors.floor if errors.floor is not None else float(both.min(initial=1.0))
    norm = LogNorm(low, max(float(both.max(initial=low)), 3 * low))
    image = axis.pcolormesh(np.ma.masked_invalid(table), norm=norm, cmap=_HEAT, edgecolors="none")
    axis.invert_yaxis()
    axis.spines[:].set_visible(False)
    axis.tick_params(length=0)
    for (i, j), value in np.ndenumerate(table):
        there = np.isfinite(value)
        # On the filled cells the text has a colour of its own; an empty cell shows the page.
        colour = ("white" if norm(value) > 0.6 else "#202020") if there else FAINT
        number = (f"{value:.2g}" if value < 99.5 else f"{value:.0f}") if there else "–"
        axis.text(j + 0.5, i + 0.5, number, ha="center", va="center", color=colour, fontsize=8.5)
    return image


def measured_vs_simulated(run: RunTraces, names: tuple[str, str] = ("before", "after")) -> Figure:
    """Every channel of a run: the measurement, and the models with the same commands."""
    with look():
        picture, axes = figure(0.8 + 1.45 * len(run.traces), max(len(run.traces), 1), sharex=True)
        for axis, trace in zip(axes[:, 0], run.traces, strict=False):
            _draw_trace(axis, trace, names)
        axes[-1, 0].set_xlabel("time [s]")
        handles, labels = axes[0, 0].get_legend_handles_labels()
        picture.legend(handles, labels, loc="outside upper left", ncols=4)
    return picture


def _draw_trace(axis: Any, trace: Trace, names: tuple[str, str]) -> None:
    lines: list[tuple[Any, str, dict[str, Any]]] = [
        (trace.given, "model as given", {"color": FAINT, "linewidth": 0.8, "alpha": 0.7}),
        (trace.measured, "measured", {"color": INK, "linewidth": 0.9}),
        (trace.before, plain(names[0]), {"color": BEFORE, "linestyle": (0, (4, 2))}),
        (trace.after, plain(names[1]), {"color": AFTER}),
    ]
    for values, label, style in lines:
        if values is not None:
            # Samples that a line cannot join, as those of a sensor slower than its log.
            there = np.concatenate([[False], np.isfinite(values), [False]])
            isolated = np.any(there[1:-1] & ~there[:-2] & ~there[2:])
            dots = {"marker": ".", "markersize": 2.0} if isolated else {}
            shown = _without_blanks(trace.t, values) if values is trace.measured else (trace.t, values)
            axis.plot(*decimated(*shown), label=label, **style, **dots)
    _limits(axis, trace)
    axis.margins(x=0.01)
    axis.set_ylabel(with_unit(trace.channel, trace.unit))
    axis.grid()


def _without_blanks(t: Array, values: Array) -> tuple[Array, Array]:
    """Samples without the blank rows between them; the line breaks where samples are lost."""
    at = np.flatnonzero(np.isfinite(values))
    apart = np.diff(t[at])
    gaps = np.flatnonzero(apart > SETTINGS.gap * (np.median(apart) if len(apart) else 0.0)) + 1
    return np.insert(t[at], gaps, t[at][gaps]), np.insert(values[at], gaps, np.nan)


def _limits(axis: Any, trace: Trace) -> None:
    """A diverging simulation, above all of the given model, must not flatten everything else."""
    finite = trace.measured[np.isfinite(trace.measured)]
    if not len(finite):
        return
    low, high = float(finite.min()), float(finite.max())
    margin = SETTINGS.simulated_range * max(high - low, 1e-6 * max(abs(low), abs(high)), 1e-12)
    fitted = [v[np.isfinite(v)] for v in (trace.before, trace.after) if v is not None]
    ends = np.concatenate([finite, *fitted])
    low, high = max(ends.min(), low - margin), min(ends.max(), high + margin)
    room = 0.05 * max(high - low, margin / SETTINGS.simulated_range)
    axis.set_ylim(low - room, high + room)


def decimated(t: Array, values: Array, buckets: int = SETTINGS.buckets) -> tuple[Array, Array]:
    """Two points per bucket for plotting: its least and largest value at their own times, gaps kept."""
    if len(t) <= 2 * buckets:
        return t, values
    kept = []
    for bucket in np.array_split(np.arange(len(t)), buckets):
        finite = bucket[np.isfinite(values[bucket])]
        if len(finite):
            gap = bucket[~np.isfinite(values[bucket])][:1]
            kept += sorted({finite[np.argmin(values[finite])], finite[np.argmax(values[finite])], *gap})
        else:
            kept.append(bucket[0])
    return t[kept], values[kept]


def residual_against(curves: Sequence[ResidualCurve], names: tuple[str, str] = ("before", "after")) -> Figure:
    """Mean residual force in bins of the variables, with the 95% interval of every mean."""
    with look():
        picture, axes = _panels(len(curves), 2.1, 0.7)
        for axis, curve in zip(axes, curves, strict=False):
            _draw_curve(axis, curve, names)
        handles, labels = axes[0].get_legend_handles_labels()
        picture.legend(handles, labels, loc="outside upper left", ncols=2)
    return picture


def _panels(count: int, height: float, more: float = 0.0) -> tuple[Figure, Any]:
    """A figure with so many panels of a height, three in a row, and its axes; `more` height for a legend."""
    columns = min(3, max(count, 1))
    rows = -(-max(count, 1) // columns)
    picture, axes = figure(more + height * rows, rows, columns)
    for axis in axes.ravel()[count:]:
        axis.set_visible(False)
    return picture, axes.ravel()


def _draw_curve(axis: Any, curve: ResidualCurve, names: tuple[str, str]) -> None:
    axis.axhline(0.0, color=INK, linewidth=0.8)
    stated = curve.before
    for one, name, colour, marker in ((stated, names[0], BEFORE, "o"), (curve.after, names[1], AFTER, "s")):
        if one is not None:
            style = {"color": colour, "marker": marker, "markersize": 4, "linewidth": 1.0, "capsize": 2}
            axis.errorbar(one.centre, one.force, yerr=1.96 * one.error, label=plain(name), **style)
    axis.locator_params(axis="x", nbins=4)
    axis.set_xlabel(with_unit(stated.variable, stated.unit))
    axis.set_ylabel(with_unit(f"{stated.degree_of_freedom} residual", curve.unit))
    axis.grid()


def force_budget(budgets: Sequence[Budget]) -> Figure:
    """Root mean square of every effect's share, one panel for each degree of freedom."""
    longest = max((len(b.shares) for b in budgets), default=1)
    with look():
        picture, axes = _panels(len(budgets), 0.8 + 0.26 * longest)
        for axis, budget in zip(axes, budgets, strict=False):
            shares = sorted(budget.shares.items(), key=lambda item: item[1])
            colours = [BEFORE if name == _UNEXPLAINED else AFTER for name, _ in shares]
            scale, unit = in_powers(max(budget.shares.values(), default=0.0), budget.unit)
            axis.barh([plain(name, 26) for name, _ in shares], [v / scale for _, v in shares], color=colours)
            axis.set_xlabel(with_unit(f"{budget.degree_of_freedom}, rms", unit))
            axis.locator_params(axis="x", nbins=4)
            axis.grid(axis="x")
    return picture


def rates_picture(examined: Examined, vehicle: Vehicle, logs: Sequence[FieldLog] = ()) -> Figure:
    """One row for each pose coordinate: rate of the pose against the rate from the velocities.

    Above them, a row for each of the vehicle's own logs: when its motors drove, and which parts are used.
    """
    kinematics = Kinematics(examined.given, vehicle)
    names = kinematics.rows if kinematics else []
    if not names and not logs:
        raise UndertowError(
            f"no picture: the logs of '{vehicle.name}' have no pose with a measured velocity beside it"
        )
    pairs = [("as given", examined.given, BEFORE)]
    if examined.edits:
        pairs.append(("mistakes corrected", examined.mended, AFTER))
    with look():
        count = len(logs) + len(names)
        picture, axes = figure(2.5 * count + 0.5, count, len(pairs))
        for row, log in enumerate(logs):
            _used_panel(axes[row, 0], log)
            for axis in axes[row, 1:]:
                axis.set_axis_off()
        for column, (title, runs, colour) in enumerate(pairs):
            below = dict(zip(names, axes[len(logs) :, column], strict=True))
            _rates_column(below, Kinematics(runs, vehicle), runs, title, colour)
    return picture


def _rates_column(
    axes: Mapping[str, Any], kinematics: Kinematics, runs: Sequence[Run], title: str, colour: str
) -> None:
    """A panel for each pose coordinate; once corrected, a log has it at other times, or not at all."""
    rates = kinematics.rates(runs) if kinematics else None
    for name, axis in axes.items():
        if rates is None or name not in kinematics.rows:
            axis.set_axis_off()
            continue
        row = kinematics.rows.index(name)
        block = next(i for i, b in enumerate(kinematics.blocks) if row in b)
        heading = f"{title}: mismatch {percent(kinematics.mismatch_of(rates).share[block])}"
        _panel(axis, (rates.velocity[:, row], rates.pose[:, row]), name, heading, colour)


def _used_panel(axis: Any, log: FieldLog) -> None:
    """The largest command of any motor over time, and the segments that are used."""
    drive = log.drive()
    if drive is not None:
        axis.plot(drive[0], np.abs(drive[1]).max(axis=1), color=AFTER, linewidth=0.8)
    for first, last in log.intervals:
        axis.axvspan(first, last, color=FLOOR, alpha=0.2, linewidth=0)
    axis.set_title(f"{log.path.name}: {'the shaded part' if log.intervals else 'all of it'} is used")
    axis.set_xlabel("time [s]")
    axis.set_ylabel("largest command")


def _panel(axis: Any, points: tuple[Array, Array], name: str, title: str, colour: str) -> None:
    step = max(1, len(points[0]) // SETTINGS.points)
    x, y = (p[::step] for p in points)
    low, high = (
        float(np.quantile(np.concatenate([x, y]), q)) for q in (SETTINGS.outliers, 1 - SETTINGS.outliers)
    )
    margin = 0.05 * (high - low) or 1.0
    ends = (low - margin, high + margin)
    axis.plot(ends, ends, color=FAINT, linestyle="--", zorder=1)
    axis.scatter(x, y, s=5, color=colour, alpha=0.5, linewidths=0, zorder=2)
    axis.set_xlim(*ends)
    axis.set_ylim(*ends)
    unit = f"{UNITS[name]}/s"
    axis.set_xlabel(f"from the velocities [{unit}]")
    axis.set_ylabel(f"rate of {plain(name)} [{unit}]")
    axis.set_title(title)
    axis.grid(visible=True)
