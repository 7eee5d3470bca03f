"""The pages about the data: the logs with the doctor's findings, and where the model fails."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from nicegui import ui

from undertow.identification.logs.run import UNITS, Run
from undertow.typing import Array

from . import figures
from .session import ROLES, LogChoice, Remedy, Role, seconds
from .view import View, action, heading, lines, stale

_TOGGLE = "unelevated toggle-color=blue-grey-6 color=grey-3 text-color=black"
_NAMES = {"mistake": "#c62828", "warning": "#ff8f00"}
_VERBS: dict[Role, str] = {"train": "Train on it", "judge": "Judge by it", "out": "Leave it out"}
_SEVERITY = {"mistake": "red", "warning": "amber-10", "note": "grey"}


# --- Log ----------------------------------------------------------------------------------------
def log_page(view: View) -> None:
    """Channels on linked time axes, what is done with their segments, and the doctor beside them."""
    bench = view.bench
    if not bench.runs:
        words = "reading the logs ..." if bench.reading else "The logs could not be read."
        ui.label(words).mark("reading")
        if not bench.reading:
            ui.button("Read them again", on_click=bench.read).props("dense no-caps padding='4px 12px'")
            _remedies(view)
        return
    view.log = min(view.log, len(bench.runs) - 1)
    with ui.row().classes("w-full no-wrap items-start gap-4"):
        with ui.column().classes("grow gap-2").style("min-width: 0"):
            _logs(view)
            _channels(view)
        with ui.column().classes("gap-2").style("width: 380px; flex: none"):
            _doctor(view)


def _logs(view: View) -> None:
    """What is done with each log."""
    heading("Logs", "Choose the data to fit, the data for validation, and what to leave out.")
    words = {role: figures.ROLE_WORDS[role] for role in ROLES}
    for i, (choice, run) in enumerate(zip(view.bench.session.logs, view.bench.runs, strict=True)):
        with ui.row().classes("items-center gap-3"):
            ui.button(run.name, on_click=lambda i=i: _show_log(view, i)).props(
                f"dense no-caps align=left padding='2px 10px' {'' if i == view.log else 'outline'}"
            ).classes("w-48 overflow-hidden").mark(f"log-{i}")
            mixed = bool(choice.stretches)
            ui.toggle(
                words,
                value=None if mixed else choice.role,
                on_change=lambda e, i=i: view.bench.choose(i, e.value) if e.value else None,
            ).props(f"dense no-caps size=sm padding='2px 10px' {_TOGGLE}").mark(f"role-{i}")
            ui.label(_about(run, choice)).classes("text-sm text-grey-8")
    _notes(view.bench.runs[view.log])


def _notes(run: Run) -> None:
    """What the reader of a log said: what it left out, cut, converted and took for granted."""

    def say(notes: Sequence[str]) -> None:
        with ui.column().classes("gap-0 w-full"):
            for note in notes:
                ui.label(note).classes("text-xs text-grey-8").style("overflow-wrap: anywhere")

    say(run.reader_notes)
    if run.notes:
        more = ui.expansion(f"How the channels of {run.name} were read").mark("notes")
        with more.props("dense header-class='text-xs text-grey-8 q-px-none'").classes("w-full"):
            say(run.notes)


def _about(run: Run, choice: LogChoice) -> str:
    length = float(run.t[-1] - run.t[0])
    text = f"{len(run.t)} samples, {seconds(length)} s"
    if not choice.stretches:
        return text
    spans = choice.spans(float(run.t[0]), float(run.t[-1]))
    parts = (f"{seconds(s.start)}-{seconds(s.end)} s {figures.ROLE_WORDS[s.role]}" for s in spans)
    return f"{text}: {', '.join(parts)}"


def _show_log(view: View, log: int) -> None:
    view.log, view.zoom, view.selected = log, None, None
    view.draw()


def _channels(view: View) -> None:
    """The channels of one log, and buttons for the segment that the mouse chose."""
    run = view.bench.runs[view.log]
    known = _in_order(view)
    moving = [n for n in known if np.ptp(_present_samples(run.channels[n])) > 0]
    view.channels = (
        [n for n in known if n in view.channels] or moving[: figures.SETTINGS.shown_channels] or known[:1]
    )
    select = ui.select(known, multiple=True, value=view.channels, label="channels")
    select.props("dense use-chips options-dense").classes("w-full").mark("channels")
    with ui.row().classes("items-center gap-2"):
        chosen = ui.label().classes("text-sm").mark("selected")
        for role in ROLES:
            ui.button(_VERBS[role], on_click=lambda role=role: _choose(view, role)).props(
                "dense no-caps outline size=sm padding='2px 10px'"
            ).style(f"color: {figures.COLOURS[role]} !important").mark(f"choose-{role}")
        if view.cell is not None and _marks(view, run):
            ui.label(f"yellow: {', '.join(view.cell)}").classes("text-sm bg-amber-2 px-2 rounded").mark(
                "marked"
            )
            ui.button("clear", on_click=lambda: _unmark(view)).props("dense flat no-caps size=sm")
    plot = ui.plotly(_log_figure(view)).classes("w-full").mark("channels-plot")

    def say() -> None:
        span = view.selected
        hint = "Drag over a plot to choose a segment; the magnifier above it zooms."
        chosen.set_text(hint if span is None else f"chosen: {seconds(span[0])} to {seconds(span[1])} s")

    def zoomed(window: tuple[float, float] | None) -> None:
        view.zoom = window
        plot.update_figure(_log_figure(view))

    def marked(span: tuple[float, float] | None) -> None:
        if span is not None and span != view.selected:  # Plotly reports none when the plot is drawn again
            view.selected = span
            say()
            plot.update_figure(_log_figure(view))

    def shown(names: list[str]) -> None:
        view.channels = names or known[:1]
        plot.update_figure(_log_figure(view))

    say()
    select.on_value_change(lambda e: shown(list(e.value)))
    plot.on("plotly_relayout", lambda e: _zoom(e.args, zoomed))
    plot.on("plotly_selected", lambda e: marked(_span(e.args)), args=["range"])


def _in_order(view: View) -> list[str]:
    """Channels of a log: what the model is about first, then the commands, then all others."""
    run, vehicle = view.bench.runs[view.log], view.bench.vehicle
    first = (
        *_mended(view),
        *vehicle.velocity_names,
        *vehicle.command_names,
        *vehicle.pose_names,
        *run.channels,
    )
    return [n for n in dict.fromkeys(first) if run.has(n)]


def _unmark(view: View) -> None:
    view.cell = None
    view.draw()


def _choose(view: View, role: Role) -> None:
    if view.selected is not None:
        span, view.selected = view.selected, None
        view.bench.choose(view.log, role, span)


def _zoom(event: Mapping[str, Any], then: Any) -> None:
    """Send a zoomed segment with as many points as the whole log had."""
    if "xaxis.range[0]" in event:
        then((float(event["xaxis.range[0]"]), float(event["xaxis.range[1]"])))
    elif event.get("xaxis.autorange"):
        then(None)


def _span(event: Mapping[str, Any]) -> tuple[float, float] | None:
    """The times of a box that was drawn over a plot."""
    found = next((v for k, v in (event.get("range") or {}).items() if k.startswith("x")), None)
    return None if found is None else (float(min(found)), float(max(found)))


def _log_figure(view: View) -> figures.Figure:
    bench, run = view.bench, view.bench.runs[view.log]
    choice = bench.session.logs[view.log]
    spans = [(s.start, s.end, s.role) for s in choice.spans(float(run.t[0]), float(run.t[-1]))]
    before = bench.before[view.log] if len(bench.before) == len(bench.runs) else None
    figure = figures.channels(
        run,
        view.channels,
        bench.vehicle.command_units,
        window=view.zoom,
        spans=spans,
        marks=_marks(view, run),
        before=before,
        doubtful=_doubtful(view, run),
        selected=view.selected,
    )
    if view.zoom is not None:
        figure["layout"]["xaxis"]["range"] = list(view.zoom)
    return figure


def _doubtful(view: View, run: Run) -> dict[str, str]:
    """Channels that the doctor has a mistake or a warning about, with the colour of the finding."""
    found, current = view.bench.place.last_result("examine")
    if found is None or not current:
        return {}
    serious = [f for f in reversed(found["findings"]) if f["severity"] in _NAMES]
    return {name: _NAMES[f["severity"]] for f in serious for name in _concerned(run, f)}


def _marks(view: View, run: Run) -> list[tuple[float, float]]:
    """Times of the cell of the error map that was clicked on, in this log."""
    found = view.bench.place.last_result("compare")[0]
    if view.cell is None or found is None:
        return []
    dof, regime = view.cell
    own = [i for i, name in enumerate(found["runs"]) if name == run.name or name.startswith(f"{run.name} [")]
    return [(a, b) for i, a, b in found["stretches"].get(dof, {}).get(regime, []) if i in own]


def _doctor(view: View) -> None:
    """What the doctor found, with buttons that apply its remedies."""
    heading("Doctor", "Is anything wrong with the logs, or with how they are read?")
    action("Examine the logs", view, "examine")
    _remedies(view)
    found, current = view.bench.place.last_result("examine")
    if found is None:
        return
    if not current:
        stale()
    if not any(f["severity"] == "mistake" for f in found["findings"]):
        ui.label("No mistake found in how the logs are read.").classes("text-green-9")
    for i, finding in enumerate(found["findings"]):
        _finding(view, finding, i, current)
    _excitation(found["excitation"])


def _finding(view: View, finding: Mapping[str, Any], place: int, current: bool) -> None:
    with ui.card().classes("w-full gap-1 p-2").props("flat bordered"):
        with ui.row().classes("items-center gap-2"):
            ui.badge(finding["severity"]).props(f"color={_SEVERITY[finding['severity']]}")
            for name in _concerned(view.bench.runs[view.log], finding):
                ui.button(name, on_click=lambda n=name: _focus(view, n)).props("dense flat size=sm no-caps")
        ui.label(finding["text"]).classes("text-sm")
        if finding["mapping"]:
            lines(finding["mapping"])
            remedy = Remedy(id=finding["id"], lines=finding["mapping"])
            ui.button("Apply this remedy", on_click=lambda: view.bench.apply_remedy(remedy)).props(
                "dense no-caps size=sm padding='2px 10px'"
            ).mark(f"remedy-{place}").set_enabled(current)
        for other in finding["alternatives"]:
            ui.label(f"not excluded: {other}").classes("text-xs text-grey-8")
        if finding["vehicle"]:
            ui.label(f"in the vehicle file: {finding['vehicle']}").classes("text-xs text-grey-8")


def _concerned(run: Run, finding: Mapping[str, Any]) -> list[str]:
    """Channels that a finding speaks of."""
    words = set(re.findall(r"[A-Za-z_]\w*", f"{finding['text']} {finding['mapping']}"))
    return [name for name in run.channels if name in words]


def _focus(view: View, name: str) -> None:
    view.channels = [name]
    view.draw()


def _remedies(view: View) -> None:
    """The remedies that were taken, and what they did."""
    taken = view.bench.session.remedies
    if not taken:
        return
    with ui.card().classes("w-full gap-1 p-2 bg-green-1").props("flat bordered").mark("remedies"):
        ui.label(f"Corrected: {', '.join(r.id for r in taken)}").classes("font-medium")
        for text in _mended(view).values():
            ui.label(text).classes("text-sm")
        ui.label("Grey lines are the channels before the last remedy.").classes("text-xs text-grey-8")
        ui.button("Undo the last one", on_click=view.bench.undo_remedy).props(
            "dense flat no-caps size=sm"
        ).mark("undo-remedy")


def changes(old: Run, new: Run) -> dict[str, str]:
    """What a remedy did to the channels of a log: their spans before and after, by name."""
    found = {}
    for name, data in new.channels.items():
        if not old.has(name):
            found[name] = f"{name}: {_range(data, name)}, absent before"
        elif not np.array_equal(old.channels[name], data, equal_nan=True):
            found[name] = f"{name}: {_range(old.channels[name], name)} → {_range(data, name)}"
    return found


def _mended(view: View) -> dict[str, str]:
    """The same for the log that is shown; nothing where no remedy was taken."""
    before, after = view.bench.before, view.bench.runs
    return changes(before[view.log], after[view.log]) if len(before) == len(after) > view.log else {}


def _range(data: Array, name: str) -> str:
    there = _present_samples(data)
    return f"{there.min():.3g} to {there.max():.3g} {UNITS.get(name, '')}".rstrip()


def _present_samples(data: Array) -> Array:
    """The samples that are not missing; a zero where none is there."""
    found = data[np.isfinite(data)]
    return found if len(found) else np.zeros(1)


def _excitation(rows: Sequence[Mapping[str, Any]]) -> None:
    columns = [
        {"name": n, "label": words, "field": n, "align": "left" if n == "motion" else "right"}
        for n, words in (("motion", "motion"), ("rms", "rms"), ("moving", "moving"), ("turns", "reversals"))
    ]
    table = [
        {
            "motion": f"{r['degree_of_freedom']} ({r['velocity']})",
            "rms": f"{r['rms']:.3g} {r['unit']}",
            "moving": f"{r['moving']:.0%}",
            "turns": r["reversals"],
        }
        for r in rows
    ]
    ui.table(columns=columns, rows=table, title="Excitation").props("dense flat").classes("w-full")


# --- Where it fails -----------------------------------------------------------------------------
def fails_page(view: View) -> None:
    """The error map; a click on a cell marks its times and shows the residual force against a variable."""
    with ui.row().classes("w-full items-center gap-4"):
        heading(
            "Where it fails", f"The model {view.bench.session.steps[-1].what}, compared with all logs in use."
        )
        action("Compare the model with the logs", view, "compare")
    found, current = view.bench.place.last_result("compare")
    if found is None:
        ui.label("Not compared yet.").classes("text-grey-8")
        return
    if not current:
        stale()
    ui.label(f"{found['headline'][:1].upper()}{found['headline'][1:]}.").classes("text-base").mark("headline")
    ui.label(
        "Residual force over its noise, by motion and regime: 1 is what the sensors alone would show. "
        "Click on a cell to see when and against what it fails."
    ).classes("text-sm text-grey-8")
    if view.cell is None and found["worst"]:
        view.cell = found["worst"]["degree_of_freedom"], found["worst"]["regime"]
    plot = ui.plotly(figures.error_map(found, view.cell)).classes("w-full").mark("error-map")
    details = ui.column().classes("w-full gap-1")

    def clicked(place: Sequence[int]) -> None:
        names = list(dict.fromkeys(c["regime"] for c in found["cells"]))
        view.cell = list(found["dofs"])[int(place[1])], names[int(place[0])]
        plot.update_figure(figures.error_map(found, view.cell))
        show()

    def show() -> None:
        details.clear()
        with details:
            _residual(view, found, show)

    plot.on("plotly_click", lambda e: clicked(e.args), js_handler="(e) => emit(e.points[0].x, e.points[0].y)")
    show()


def _residual(view: View, found: Mapping[str, Any], again: Any) -> None:
    """What one cell of the map is made of."""
    if view.cell is None or view.cell[0] not in found["dofs"]:
        return
    dof, regime = view.cell
    candidates = _with_force(view)
    variables = [p["variable"] for p in found["profiles"] if p["dof"] == dof] or list(found["variables"])
    view.variable = view.variable if view.variable in found["variables"] else variables[0]
    view.run = min(view.run, len(found["runs"]) - 1)
    view.curve = view.curve if view.curve in candidates else next(iter(candidates), "")

    def chosen(name: str, value: Any) -> None:
        setattr(view, name, value)
        again()

    with ui.row().classes("items-end gap-4"):
        ui.label(f"{dof}, {regime}").classes("text-base font-medium").mark("cell")
        runs = dict(enumerate(found["runs"]))
        ui.select(runs, value=view.run, label="log", on_change=lambda e: chosen("run", e.value)).classes(
            "w-48"
        )
        ui.select(
            variables, value=view.variable, label="against", on_change=lambda e: chosen("variable", e.value)
        ).classes("w-32").mark("variable")
        if candidates:
            ui.select(
                [*candidates, ""],
                value=view.curve,
                label="candidate",
                on_change=lambda e: chosen("curve", e.value),
            ).classes("w-48").mark("curve")
        else:
            ui.label("Curves of candidates appear here after 'What is missing' was run.").classes(
                "text-xs text-grey-8"
            )
    curve = (view.curve, candidates[view.curve]) if view.curve else None
    with ui.row().classes("w-full no-wrap gap-2"):
        ui.plotly(figures.residual_in_time(found, view.run, dof, regime)).classes("w-1/2")
        against = figures.residual_against(found, dof, view.variable, regime, curve)
        ui.plotly(against).classes("w-1/2").mark("residual-against")


def _with_force(view: View) -> dict[str, Any]:
    """Candidates whose force was worked out, the best first."""
    found, current = view.bench.place.last_result("diagnose")
    if not current:  # that of another model would be drawn over the residual of this one
        return {}
    return {c["effect"]: c["supplied"] for c in (found or {}).get("candidates", []) if c["supplied"]}
