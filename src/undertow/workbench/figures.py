"""The pictures of the workbench, as plain dictionaries for Plotly; names out of files are escaped."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from html import escape
from io import BytesIO
from typing import Any

import numpy as np

from undertow.figures import unit_text
from undertow.identification.logs.run import UNITS, Run
from undertow.identification.report.page import parameter_text
from undertow.identification.report.pictures import decimated

Figure = dict[str, Any]
Line = list[float | None]


@dataclass(frozen=True)
class FigureSettings:
    """How much is shown, and sizes that were chosen by looking at the pages on a screen of 1400 pixels."""

    shown_channels: int = 12  # at first: more do not fit on a screen
    pixels: int = 1000  # of a channel, with a least and a greatest value each
    row: int = 92  # height of a channel, pixels
    gap: float = 0.12  # share of a row between two
    apart: float = 5.0  # ratio from which what a channel was before has an axis of its own
    darkest: float = 3.0  # decades of residual force over noise from white to the darkest red


SETTINGS = FigureSettings()
COLOURS = {"train": "#1565c0", "judge": "#2e7d32", "out": "#9e9e9e"}
ROLE_WORDS = {"train": "training", "judge": "judging", "out": "left out"}
_MEASURED, _MODEL, _BETTER, _MARK, _BEFORE = "#212121", "#e07b00", "#6a1b9a", "#ffca28", "#9e9e9e"
_FONT = {"family": "Roboto, sans-serif", "size": 12, "color": "#333333"}
_BARE = {"displayModeBar": False, "responsive": True}
_WITH_ZOOM = {
    "displaylogo": False,
    "responsive": True,
    "displayModeBar": True,
    "modeBarButtonsToRemove": ["lasso2d", "autoScale2d", "toImage", "zoomIn2d", "zoomOut2d"],
}


@lru_cache(maxsize=1000)
def typeset(latex: str) -> str | None:
    """An equation as the address of a picture in the page itself; None for what cannot be typeset.

    `latex` is that of the page of the catalogue; it takes a twentieth of a second.
    """
    from matplotlib.mathtext import math_to_image

    stream = BytesIO()
    try:
        math_to_image(f"${latex}$", stream, dpi=72, format="svg", color=_MEASURED)
    except ValueError:
        return None
    return f"data:image/svg+xml;base64,{b64encode(stream.getvalue()).decode()}"


def plain(values: Iterable[float], digits: int = 6) -> Line:
    """Numbers for JSON, in more digits than a screen shows; None where there is none."""
    return [float(f"{v:.{digits}g}") if math.isfinite(v) else None for v in values]


def number(value: float) -> str:
    """A number in three digits, without powers of ten where it is large."""
    return f"{value:.0f}" if 1e3 <= abs(value) < 1e6 else f"{value:.3g}"


def label(name: str, unit: str) -> str:
    """A variable with its unit."""
    shown = unit_text(unit)
    return escape(f"{name} ({shown})" if shown not in ("", "1", "command") else name)


def _figure(data: list[Figure], height: int, **layout: Any) -> Figure:
    base = {
        "height": height,
        "font": _FONT,
        "margin": {"l": 70, "r": 20, "t": 30, "b": 45},
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "#ffffff",
        "showlegend": False,
        "hoverlabel": {"namelength": -1},
        "modebar": {"bgcolor": "rgba(0,0,0,0)", "color": "#9e9e9e", "activecolor": "#0d47a1"},
        "legend": {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0},
    }
    return {"data": data, "layout": {**base, **layout}, "config": _BARE}


def _axis(title: str = "", **more: Any) -> Figure:
    lines = {"gridcolor": "#eeeeee", "zerolinecolor": "#cccccc", "linecolor": "#cccccc", "automargin": True}
    digits = {"exponentformat": "power", "minexponent": 6}  # "20k" beside a unit would be read as one of it
    return {"title": {"text": title, "standoff": 6}, **lines, **digits, **more}


# --- logs ---------------------------------------------------------------------------------------
def channels(
    run: Run,
    names: Sequence[str],
    units: Mapping[str, str],
    *,
    window: tuple[float, float] | None = None,
    spans: Sequence[tuple[float, float, str]] = (),
    marks: Sequence[tuple[float, float]] = (),
    before: Run | None = None,
    doubtful: Mapping[str, str] | None = None,
    selected: tuple[float, float] | None = None,
) -> Figure:
    """Channels of a run one below the other on one time axis, with what is done with its segments.

    `marks` are times to be pointed out, `before` the run as it was read before; `doubtful` has colours for
    the names of channels that something is wrong with; `selected` is the box that was drawn over the plot.
    """
    low, high = window or (float(run.t[0]), float(run.t[-1]))
    data: list[Figure] = []
    apart = [name for name in names if before is not None and _of_another_size(before, run, name)]
    for row, name in enumerate(names, start=1):
        if before is not None and before.has(name):
            own = row + len(names) * (name in apart)
            data.append(_channel(before, name, own, (low, high), _BEFORE, "before"))
        data.append(_channel(run, name, row, (low, high), _MEASURED, name))
    # Plotly offers its box for choosing a segment only where some trace has markers.
    data.append({"type": "scatter", "mode": "markers", "x": [None], "y": [None], "hoverinfo": "skip"})
    rows = len(names)
    height = SETTINGS.row * rows + 80
    shapes = [_band(a, b, COLOURS[role], 0.10) for a, b, role in spans]
    shapes += [_band(a, b, _MARK, 0.45) for a, b in marks]
    shapes += [_box(*selected)] if selected else []
    layout = {
        **_stacked([label(name, UNITS.get(name, units.get(name, ""))) for name in names]),
        "shapes": shapes,
        "dragmode": "select",
        "selectdirection": "h",
        "hovermode": "x",
        "uirevision": escape(run.name),
        "margin": {"l": 80, "r": 15, "t": 28, "b": 45},
    }
    for row, name in enumerate(names, start=1):
        if doubtful and name in doubtful:
            layout[f"yaxis{_nth(row)}"]["title"]["font"] = {"color": doubtful[name]}
        if name in apart:
            beside: Figure = {"overlaying": f"y{_nth(row)}", "side": "right", "showgrid": False}
            ticks = {"nticks": 4, "zeroline": False, "tickfont": {"color": _BEFORE}}
            layout[f"yaxis{row + rows}"] = _axis("", **beside, **ticks)
    figure = _figure(data, height, **layout)
    figure["config"] = _WITH_ZOOM
    return figure


def _stacked(titles: Sequence[str]) -> Figure:
    """Axes of rows one below the other, on one axis of time."""
    rows = len(titles)
    layout = {"xaxis": _axis("time (s)", anchor=f"y{_nth(rows)}")}
    for row, title in enumerate(titles, start=1):
        top = 1.0 - (row - 1) / rows
        domain = [max(top - (1.0 - SETTINGS.gap) / rows, 0.0), top]
        layout[f"yaxis{_nth(row)}"] = _axis(title, domain=domain, nticks=4)
    return layout


def _nth(row: int) -> str:
    """The number of an axis as Plotly has it: that of the first is left out."""
    return str(row) if row > 1 else ""


def _box(begin: float, end: float) -> Figure:
    """The segment that was chosen with the mouse: what Plotly draws itself is gone when the page is drawn."""
    return {
        **_band(begin, end, _MEASURED, 0.25),
        "fillcolor": "rgba(0,0,0,0.15)",
        "line": {"color": _MEASURED, "width": 1, "dash": "dash"},
    }


def _of_another_size(before: Run, run: Run, name: str) -> bool:
    """Whether a channel was so much larger or smaller that one axis would show only one of the two."""
    if not before.has(name):
        return False
    old, new = (float(np.nanmax(np.abs(r.channels[name]), initial=0.0)) for r in (before, run))
    return max(old, new) > SETTINGS.apart * min(old, new)


def _channel(run: Run, name: str, row: int, window: tuple[float, float], colour: str, said: str) -> Figure:
    first, last = np.searchsorted(run.t, window)
    rows = slice(max(int(first) - 1, 0), int(last) + 1)
    t, y = decimated(run.t[rows], run.channels[name][rows], SETTINGS.pixels)
    return _curve(plain(t, 9), plain(y, 7), escape(said), colour, 1, yaxis=f"y{_nth(row)}")


def _curve(x: Sequence[Any], y: Sequence[Any], name: str, colour: str, width: float, **more: Any) -> Figure:
    line = {"width": width, "color": colour}
    return {"type": "scatter", "mode": "lines", "name": name, "x": x, "y": y, "line": line, **more}


def _band(start: float, end: float, colour: str, opacity: float) -> Figure:
    return {
        "type": "rect",
        "xref": "x",
        "yref": "paper",
        "x0": start,
        "x1": end,
        "y0": 0,
        "y1": 1,
        "fillcolor": colour,
        "opacity": opacity,
        "line": {"width": 0},
        "layer": "below",
    }


# --- where it fails -----------------------------------------------------------------------------
def error_map(result: Mapping[str, Any], chosen: tuple[str, str] | None) -> Figure:
    """Residual force over its noise by degree of freedom and regime; the chosen cell is framed."""
    dofs = list(result["dofs"])
    names = list(dict.fromkeys(c["regime"] for c in result["cells"]))
    found = {(c["degree_of_freedom"], c["regime"]): c for c in result["cells"]}
    cells = [[found.get((dof, name)) for name in names] for dof in dofs]
    ratio = [[None if c is None else c["normalised"] for c in row] for row in cells]
    heat = {
        "type": "heatmap",
        "x": list(range(len(names))),
        "y": list(range(len(dofs))),
        "z": [[None if v is None else math.log10(max(v, 1.0)) for v in row] for row in ratio],
        "text": [["" if v is None else number(v) for v in row] for row in ratio],
        "customdata": [["" if c is None else _cell_words(c, result["dofs"]) for c in row] for row in cells],
        "hovertemplate": "%{customdata}<extra></extra>",
        "texttemplate": "%{text}",
        "colorscale": [[0, "#ffffff"], [0.5, "#ffb74d"], [1, "#c62828"]],
        "zmin": 0,
        "zmax": SETTINGS.darkest,
        "xgap": 2,
        "ygap": 2,
        "showscale": False,
    }
    shapes = []
    if chosen is not None and chosen[0] in dofs and chosen[1] in names:
        x, y = names.index(chosen[1]), dofs.index(chosen[0])
        frame = {"x0": x - 0.48, "x1": x + 0.48, "y0": y - 0.46, "y1": y + 0.46}
        shapes = [{"type": "rect", **frame, "line": {"width": 3, "color": "#0d47a1"}}]
    ticks: Figure = {"tickmode": "array", "showgrid": False, "zeroline": False}
    return _figure(
        [heat],
        44 * len(dofs) + 90,
        xaxis=_axis(tickvals=heat["x"], ticktext=[escape(n) for n in names], tickangle=-35, **ticks),
        yaxis=_axis(tickvals=heat["y"], ticktext=dofs, autorange="reversed", **ticks),
        shapes=shapes,
        margin={"l": 70, "r": 20, "t": 5, "b": 20},
    )


def _cell_words(cell: Mapping[str, Any], units: Mapping[str, str]) -> str:
    dof, unit = cell["degree_of_freedom"], unit_text(units[cell["degree_of_freedom"]])
    share = cell["explained_by_noise"]
    return escape(
        f"{dof} {cell['phrase']}: residual {cell['residual_rms']:.3g} {unit}, {cell['normalised']:.3g} times "
        f"its noise ({share:.0%} explained by noise), {cell['samples']} samples"
    )


def residual_in_time(result: Mapping[str, Any], run: int, dof: str, regime: str | None) -> Figure:
    """The force that a model lacks along one run, with its noise, and the times of a regime marked."""
    rows = [i for i, own in enumerate(result["run"]) if own == run]
    t, force, noise = (
        [column[i] for i in rows] for column in (result["t"], result["missing"][dof], result["noise"][dof])
    )
    spans = result["stretches"][dof].get(regime, []) if regime else []
    unit = result["dofs"][dof]
    data = [
        *_ribbon(t, [0.0] * len(t), [1.96 * (n or 0.0) for n in noise], "#90a4ae", "noise of the sensors"),
        _curve(t, force, "residual force", _MODEL, 1.2),
    ]
    return _figure(
        data,
        360,
        xaxis=_axis("time (s)"),
        yaxis=_axis(label(f"residual in {dof}", unit)),
        shapes=[_band(a, b, _MARK, 0.45) for own, a, b in spans if own == run],
        showlegend=True,
        hovermode="x",
    )


def _ribbon(
    x: Sequence[Any], middle: Sequence[Any], half: Sequence[Any], colour: str, name: str
) -> list[Figure]:
    """A band around a line, as two lines with the space between filled."""
    low = [None if m is None or h is None else m - h for m, h in zip(middle, half, strict=True)]
    high = [None if m is None or h is None else m + h for m, h in zip(middle, half, strict=True)]
    line = {"type": "scatter", "mode": "lines", "line": {"width": 0}, "hoverinfo": "skip", "x": list(x)}
    return [
        {**line, "y": low, "showlegend": False},
        {**line, "y": high, "fill": "tonexty", "fillcolor": f"{colour}55", "name": name},
    ]


def residual_against(
    result: Mapping[str, Any],
    dof: str,
    variable: str,
    regime: str | None = None,
    curve: tuple[str, Sequence[Mapping[str, Any]]] | None = None,
) -> Figure:
    """The force that a model lacks against a variable: points, bins with their band, what an effect adds."""
    own, force = result["variables"][variable], result["missing"][dof]
    inside = _inside(result, dof, regime)
    data = [
        _points(own["values"], force, [not i for i in inside], "#b0bec5", "other times" if regime else "")
    ]
    if regime:
        data.append(_points(own["values"], force, inside, "#f9a825", escape(regime)))
    bins = _of(result["profiles"], dof, variable)
    if bins:
        data += _ribbon(bins["centre"], bins["force"], bins["error"], "#1565c0", "95% of the mean")
        data.append(_line(bins, "mean in bins", "#0d47a1", "lines+markers"))
    supplied = _of(curve[1], dof, variable) if curve else None
    if curve and supplied:
        data.append(_line(supplied, escape(f"{curve[0]} would add"), _BETTER, "lines", dash="dash"))
    return _figure(
        data,
        360,
        xaxis=_axis(label(variable, own["unit"])),
        yaxis=_axis(label(f"residual in {dof}", result["dofs"][dof])),
        showlegend=True,
    )


def _inside(result: Mapping[str, Any], dof: str, regime: str | None) -> list[bool]:
    spans = result["stretches"][dof].get(regime, []) if regime else []
    pairs = zip(result["run"], result["t"], strict=True)
    return [any(own == run and a <= t <= b for own, a, b in spans) for run, t in pairs]


def _of(profiles: Sequence[Mapping[str, Any]], dof: str, variable: str) -> Mapping[str, Any] | None:
    return next((p for p in profiles if (p["dof"], p["variable"]) == (dof, variable)), None)


def _points(x: Line, y: Line, kept: Sequence[bool], colour: str, name: str) -> Figure:
    rows = [i for i, k in enumerate(kept) if k]
    return {
        "type": "scattergl" if len(rows) > 5000 else "scatter",
        "mode": "markers",
        "x": [x[i] for i in rows],
        "y": [y[i] for i in rows],
        "name": name,
        "showlegend": bool(name),
        "hoverinfo": "skip",
        "marker": {"size": 4, "color": colour, "opacity": 0.6},
    }


def _line(p: Mapping[str, Any], name: str, colour: str, mode: str, dash: str = "solid") -> Figure:
    line = {"color": colour, "width": 2.5, "dash": dash}
    return {"type": "scatter", "mode": mode, "x": p["centre"], "y": p["force"], "name": name, "line": line}


# --- what is missing ----------------------------------------------------------------------------
def simulation(
    run: Mapping[str, Any], model: str, better: tuple[str, Mapping[str, Any]] | None, horizon: str
) -> Figure:
    """Velocities of a validation run, measured and simulated, by the model and with a candidate in it."""
    rows, data = len(run["channels"]), list[Figure]()
    layout = _stacked([label(channel["name"], channel["unit"]) for channel in run["channels"]])
    for row, channel in enumerate(run["channels"], start=1):
        axis, first = f"y{_nth(row)}", row == 1
        data.append(_trace(channel["measured"], "measured", _MEASURED, axis, first))
        data.append(_trace(channel["simulated"], model, _MODEL, axis, first))
        if better is not None:
            own = better[1]["channels"][row - 1]
            data.append(_trace(own["simulated"], escape(better[0]), _BETTER, axis, first))
    title = f"{run['run']}, simulated every {horizon} from the measured motion"
    layout["xaxis"]["title"]["text"] = escape(f"time (s); {title}")
    return _figure(
        data, 105 * rows + 110, **layout, showlegend=True, hovermode="x", uirevision=escape(run["run"])
    )


def _trace(points: Sequence[Line], name: str, colour: str, axis: str, first: bool) -> Figure:
    return _curve(points[0], points[1], name, colour, 1.3, legendgroup=name, showlegend=first, yaxis=axis)


def waterfall(bars: Sequence[tuple[str, float | None]], unit: str, *, floor: float | None) -> Figure:
    """The error from model to model, on a logarithmic axis where it falls far."""
    shown = [(escape(name), value) for name, value in bars if value is not None]
    values = [value for _, value in shown]
    far = bool(values) and min(values) > 0 and max(values) / min(values) > 8
    last = len(shown) - 1
    bar = {
        "type": "bar",
        "x": list(range(len(shown))),
        "y": values,
        "text": [number(v) for v in values],
        "textposition": "outside",
        "cliponaxis": False,
        "marker": {"color": [_BETTER if i == last and last > 0 else "#90a4ae" for i in range(len(shown))]},
        "hoverinfo": "skip",
    }
    line = {"type": "line", "xref": "paper", "x0": 0, "x1": 1, "y0": floor, "y1": floor}
    shapes = [] if floor is None else [{**line, "line": {"dash": "dot", "color": "#2e7d32"}}]
    scale = {"type": "log", "dtick": 1, "exponentformat": "none"} if far else {"rangemode": "tozero"}
    ticks: Figure = {"tickmode": "array", "tickvals": bar["x"], "ticktext": [_folded(n) for n, _ in shown]}
    return _figure(
        [bar],
        300,
        xaxis=_axis(**ticks, showgrid=False),
        yaxis=_axis(unit, **scale),
        shapes=shapes,
        bargap=0.45,
    )


def _folded(name: str) -> str:
    """A long name in two lines."""
    head, _, tail = name.partition(" ")
    return f"{head}<br>{tail}" if len(name) > 12 and tail else name


# --- parameters ---------------------------------------------------------------------------------
def against_priors(rows: Sequence[Mapping[str, Any]]) -> Figure:
    """Estimates beside what was stated, both over the stated value, with 95% intervals."""
    used = [r for r in rows if r["prior"] and r["estimate"] is not None]
    names = [escape(parameter_text(r["name"])) for r in used]
    stated = _dots(names, [1.0] * len(used), [_over(r["prior_sigma"], r["prior"]) for r in used])
    found = _dots(
        names,
        [r["estimate"] / r["prior"] for r in used],
        [_over(r["standard_error"], r["prior"]) for r in used],
    )
    data = [
        {**stated, "name": "stated", "marker": {"color": "#90a4ae", "size": 9, "symbol": "square"}},
        {**found, "name": "estimated", "marker": {"color": _BETTER, "size": 9}},
    ]
    return _figure(
        data,
        90 + 30 * len(used),
        xaxis=_axis("value over the stated one (bars: 95%)"),
        yaxis=_axis(autorange="reversed"),
        showlegend=True,
    )


def _over(sigma: float | None, value: float) -> float:
    return 0.0 if sigma is None else 1.96 * sigma / abs(value)


def _dots(names: list[str], x: list[float], half: list[float]) -> Figure:
    bars = {"type": "data", "array": half, "thickness": 1.5, "width": 4}
    return {"type": "scatter", "mode": "markers", "y": names, "x": x, "error_x": bars}


def correlations(names: Sequence[str], table: Sequence[Sequence[float]]) -> Figure:
    """Correlation of the errors of the estimates."""
    shown = [escape(n) for n in names]
    heat = {
        "type": "heatmap",
        "x": shown,
        "y": shown,
        "z": [list(row) for row in table],
        "zmin": -1,
        "zmax": 1,
        "colorscale": [[0, "#1565c0"], [0.5, "#ffffff"], [1, "#c62828"]],
        "colorbar": {"title": {"text": "correlation"}, "thickness": 12},
        "text": [[f"{v:.2f}" if abs(v) >= 0.3 else "" for v in row] for row in table],
        "texttemplate": "%{text}",
        "hovertemplate": "%{y}, %{x}: %{z:.2f}<extra></extra>",
        "xgap": 1,
        "ygap": 1,
    }
    side = 130 + 30 * len(shown)
    return _figure(
        [heat],
        side,
        xaxis=_axis(tickangle=-45),
        yaxis=_axis(autorange="reversed"),
        margin={"l": 90, "r": 20, "t": 10, "b": 80},
    )
