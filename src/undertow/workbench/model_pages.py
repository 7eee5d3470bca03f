"""The pages about the model: what is missing in it, its parameters, and what is written out."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

from nicegui import ui

from undertow.figures import unit_text
from undertow.identification.diagnosis.result import Diagnosis
from undertow.identification.report.page import meaning, parameter_text
from undertow.identification.report.sentences import SETTINGS as SENTENCES
from undertow.identification.report.sentences import CommandLine
from undertow.model.describe import equations_on
from undertow.model.effect import Effect
from undertow.model.parameter import printed
from undertow.model.units import short_unit
from undertow.model.vehicle import Vehicle

from . import figures
from .session import FORCE, REFITTED, ModelStep, Workspace, shown_path
from .view import View, action, button, equation, heading, lines, measure_words, shown, stale


# --- What is missing ------------------------------------------------------------------------------
def missing_page(view: View) -> None:
    """Candidates by what they do to the error, their simulations, and the waterfall of the error."""
    with ui.row().classes("w-full items-center gap-4"):
        heading("What is missing", f"in the model {view.bench.session.steps[-1].what}")
        action("Look for what is missing", view, "diagnose")
        _undo(view)
    found, current = view.bench.place.last_result("diagnose")
    with ui.row().classes("w-full no-wrap items-start gap-4"):
        with ui.column().classes("w-1/2 gap-2").style("min-width: 0"):
            if found is None:
                ui.label("No search yet. It takes up to a minute for a few minutes of logs.").classes(
                    "text-grey-8"
                )
            else:
                _verdict(found, current)
                _measure(view, found)
                _candidates(view, found)
                _remaining(view, found)
        with ui.column().classes("w-1/2 gap-2").style("min-width: 0"):
            _waterfall(view)
            if found is not None:
                _simulation(view, found)


def _undo(view: View) -> None:
    steps = view.bench.session.steps
    if len(steps) > 1:
        words = steps[-1].what
        button(f"Undo: {words[:40]}", view, view.bench.undo, "undo", flat=True)


def _verdict(found: Mapping[str, Any], current: bool) -> None:
    if not current:
        stale()
    diagnosis = found["diagnosis"]
    title = meaning(Diagnosis.model_validate(diagnosis)).title
    ui.label(title).classes("text-base font-medium").mark("verdict")
    ui.label(diagnosis["headline"]).classes("text-sm")
    for text in diagnosis["warnings"]:
        ui.label(text).classes("text-sm text-amber-900 bg-amber-1 px-2 rounded")


def _measure(view: View, found: Mapping[str, Any]) -> None:
    """Which error counts, on this page and in every window."""
    session = view.bench.session
    names = [FORCE, *(name for name in found["errors"] if name != FORCE)]
    session.measure = session.measure if session.measure in names else FORCE

    def chosen(name: str) -> None:
        session.measure = name
        view.bench.changed()

    options = {name: measure_words(name) for name in names}
    ui.select(
        options, value=session.measure, label="error of the", on_change=lambda e: chosen(e.value)
    ).classes("w-64").mark("measure")


def _candidates(view: View, found: Mapping[str, Any]) -> None:
    """The candidates, the one that leaves the smallest error first."""
    measure = view.bench.session.measure
    before = found["errors"].get(measure)
    ranked = sorted(found["candidates"], key=lambda c: c["errors"].get(measure, float("inf")))
    ui.label(
        f"Refitted without any of them: {shown(measure, before)}. Point at one to see its simulation. "
        "Values are ± one standard error."
    ).classes("text-sm text-grey-8")
    since = {step.effect for step in view.bench.session.steps[found["step"] + 1 :]}
    for candidate in ranked:
        _candidate(view, candidate, measure, before, since)
    if found["idle"]:
        with ui.expansion(f"{len(found['idle'])} more were tried and do not improve predictions").classes(
            "text-sm text-grey-8"
        ):
            ui.label(", ".join(found["idle"])).classes("text-sm")


def _candidate(view: View, c: Mapping[str, Any], measure: str, before: float | None, since: Set[str]) -> None:
    """One candidate; `since` are the effects that were added after it was tried."""

    def pointed() -> None:
        if view.hovered != c["effect"]:
            view.hovered = c["effect"]
            view.show_simulation()

    after = c["errors"].get(measure)
    card = ui.card().classes("w-full gap-1 p-2").props("flat bordered").mark(f"candidate-{c['effect']}")
    card.on("mouseenter", pointed)
    with card:
        with ui.row().classes("w-full items-center gap-2 no-wrap"):
            ui.label(c["effect"]).classes("font-medium")
            if c["named"]:
                ui.badge("named").props("color=purple-9")
            elif c["sure"] != "yes":
                ui.badge("could be chance" if c["sure"] == "no" else "in part").props("color=grey")
            ui.space()
            ui.label(f"{shown(measure, before)} → {shown(measure, after)}").classes(
                "text-sm whitespace-nowrap"
            )
            _add(view, c["effect"], since)
        share = 1.0 if after is None or not before else min(after / before, 1.0)
        ui.linear_progress(share, show_value=False, size="5px").props(
            "color=purple-9 track-color=grey-4 instant-feedback"
        )
        ui.label(", ".join(c["parameters"])).classes("text-sm")
        _details(view, c)


def _add(view: View, effect: str, there: Set[str]) -> None:
    """The button that adds an effect, or a word that it is there."""
    if effect in there:
        ui.badge("in the model").props("color=green-9")
    else:
        action("Add", view, "add", effect=effect).mark(f"add-{effect}")


def _details(view: View, c: Mapping[str, Any]) -> None:
    details = ui.expansion("equation, confused with").mark(f"details-{c['effect']}")
    with details.props("dense").classes("w-full text-sm"):
        ui.label(c["about"]).classes("text-sm")
        place = ui.column().classes("w-full gap-1")
        written = zip_longest(c["equations"], c.get("typeset", ()))
        details.on_value_change(lambda: _equations(place, written))
        if c["not_named"]:
            ui.label(f"not named: {c['effect']}: {c['not_named']}").classes("text-sm")
        ui.label(f"It explains {c['explained']:.0%} of the excess over noise.{_chance(c['chance'])}").classes(
            "text-sm"
        )
        if not c["confused"]:
            if c["named"]:
                ui.label("No other effect does as well on these logs.").classes("text-sm")
            return
        ui.label(f"These logs hardly distinguish it from {', '.join(c['confused'])}.").classes("text-sm")
        if c["tell"]:
            ui.label(f"To tell them apart: {c['tell']}").classes("text-sm")
        between = ",".join([c["effect"], *c["confused"]])
        line = view.bench.place.line()
        lines(line.on_logs(["plan"], "--goal", "separate", "--between", between, "--out", "plan.csv"))


def _equations(place: Any, written: Iterable[tuple[str, str | None]]) -> None:
    """Equations, as text and for LaTeX, typeset when they are first looked at; else as text."""
    if place.default_slot.children:
        return
    with place:
        for plain, latex in written:
            equation(plain, None if latex is None else figures.typeset(latex))


def _chance(p: float | None) -> str:
    if p is None:
        return ""
    least = SENTENCES.least_probability
    rate = f"fewer than {100 * least:g}%" if p < least else f"{p:.1%}"
    return f" Chance does as well in {rate} of cases."


def _remaining(view: View, found: Mapping[str, Any]) -> None:
    """What no effect of the catalogue explains, and an effect made of it."""
    left = [r for r in found["diagnosis"]["remaining"] if r["depends_on"] or r["spectrum"]]
    own = [Path(path).stem for path in view.bench.session.effects]
    with ui.card().classes("w-full gap-1 p-2").props("flat bordered").mark("remaining"):
        ui.label("What remains").classes("font-medium")
        for r in found["diagnosis"]["remaining"]:
            ui.label(r["summary"] or f"{r['degree_of_freedom']}: {r['note']}").classes("text-sm")
        if left:
            with ui.row().classes("items-end gap-2"):
                name = ui.input("id of a new effect", value="my_force").props("dense").mark("effect-id")

                def invent() -> None:
                    key = view.bench.session.latest.get("diagnose")
                    view.bench.start("invent", effect=name.value, key=key)

                button("Turn it into an effect", view, invent, "invent", flat=True)
        for effect in own:
            with ui.row().classes("items-center gap-2"):
                ui.label(f"effect of your own: {effect}").classes("text-sm")
                _add(view, effect, {step.effect for step in view.bench.session.steps})
        if view.bench.refused:
            action(
                f"Add {view.bench.refused} anyway",
                view,
                "add",
                flat=True,
                effect=view.bench.refused,
                force=True,
            )


def _waterfall(view: View) -> None:
    """The error from model to model."""
    session = view.bench.session
    measure = session.measure
    bars = list(error_steps(session.steps, measure))
    if sum(value is not None for _, value in bars) < 2:
        ui.label(
            "The error of each model is drawn here after an effect is added or the model is refitted."
        ).classes("text-sm text-grey-8")
        return
    scale = 1.0 if measure == FORCE else 100.0
    drawn = [(name, None if value is None else scale * value) for name, value in bars]
    unit = "error of the force / noise" if measure == FORCE else f"error of the velocity, {measure} ahead (%)"
    ui.label("Error on validation data, from model to model").classes("font-medium")
    ui.plotly(figures.waterfall(drawn, unit, floor=1.0 if measure == FORCE else None)).classes("w-full").mark(
        "waterfall"
    )


def error_steps(steps: Sequence[ModelStep], measure: str) -> Iterator[tuple[str, float | None]]:
    """Name and error of every model, with the refit between two where it was worked out."""
    last = ""
    for step in steps:
        if measure in step.refitted and last != REFITTED:  # a refit of a refit is the same
            yield REFITTED, step.refitted[measure]
        yield step.what, step.errors.get(measure)
        last = step.what


def _simulation(view: View, found: Mapping[str, Any]) -> None:
    """The candidate that is pointed at, over the measurement."""
    measure = view.bench.session.measure
    horizons = list(found["traces"])
    horizon = measure if measure in horizons else horizons[-1]
    runs = found["traces"][horizon]
    known = {c["effect"]: c for c in found["candidates"]}
    if view.hovered not in known:
        view.hovered = next((c["effect"] for c in found["candidates"]), "")
    title = ui.label().classes("font-medium").mark("simulation-title")
    plot = ui.plotly({"data": [], "layout": {"height": 100}}).classes("w-full").mark("simulation")

    def show() -> None:
        c = known.get(view.hovered)
        better = None if c is None else (f"with {c['effect']}", c["traces"][horizon][0])
        title.set_text(f"Simulated on validation data{'' if c is None else f', with {view.hovered}'}")
        plot.update_figure(figures.simulation(runs[0], "model refitted", better, horizon))

    view.show_simulation = show
    show()


# --- Parameters -----------------------------------------------------------------------------------
def parameters_page(view: View) -> None:
    """Stated values beside estimates, how the errors hang together, and edits."""
    with ui.row().classes("w-full items-center gap-4"):
        heading("Parameters", f"of the model {view.bench.session.steps[-1].what}, signs as in its file")
        action("Refit", view, "fit")
        button("Apply changes", view, lambda: _apply(view), "apply", flat=True)
        _undo(view)
    found, current = view.bench.place.last_result("fit")
    rows = parameter_rows(view, found if current else None)
    with ui.row().classes("w-full no-wrap items-start gap-6"):
        with ui.column().classes("gap-1").style("flex: none"):
            _table(view, rows)
            _model(view.bench.vehicle)
        with ui.column().classes("grow gap-2").style("min-width: 0"):
            if found is None:
                ui.label("Refit to see how far these logs determine each parameter.").classes("text-grey-8")
            else:
                _fitted(found, rows, current)


def parameter_rows(view: View, found: Mapping[str, Any] | None) -> list[dict[str, Any]]:
    """One row for every parameter of the present model, in the signs of its file."""
    vehicle, stated = view.bench.vehicle, view.bench.given
    fitted = {} if found is None else {row["parameter"]: row for row in found["parameters"]}
    rows = []
    for name in [n for n in vehicle.values if vehicle.parameter_of(n) is not None]:
        declaration, value = vehicle.declaration(name), vehicle.value_of(name)
        old = stated.values.get(name)
        own = fitted.get(name, {})
        rows.append(
            {
                "name": name,
                "about": declaration.about,
                "unit": unit_text(short_unit(declaration.unit)),
                "prior": None if old is None else printed(declaration, old.value, vehicle.signs),
                "prior_sigma": None if old is None else old.sigma,
                "value": printed(declaration, value.value, vehicle.signs),
                "estimate": printed(declaration, value.value, vehicle.signs) if value.estimate else None,
                "standard_error": own.get("standard_error", value.sigma),
                "identified": own.get("identified", ""),
                "free": value.estimate,
            }
        )
    return rows


_VERDICT_COLOURS = {"identified": "green-9", "weakly identified": "amber-10", "not identifiable": "red"}


def _table(view: View, rows: Sequence[Mapping[str, Any]]) -> None:
    view.edits = {}
    with ui.grid(columns="auto auto auto auto auto auto").classes("items-center gap-x-4 gap-y-0"):
        for head in ("parameter", "stated", "value", "unit", "estimated", "these logs"):
            ui.label(head).classes("text-sm text-grey-8")
        for row in rows:
            _row(view, row)


def _row(view: View, row: Mapping[str, Any]) -> None:
    name = row["name"]

    def changed(key: str, wanted: Any) -> None:
        edit = view.edits.setdefault(name, {"value": row["value"], "estimate": row["free"]})
        edit[key] = wanted

    with ui.label(parameter_text(name)).classes("font-mono text-sm"):
        ui.tooltip(row["about"])
    ui.label(_with_error(row["prior"], row["prior_sigma"])).classes("text-sm")
    with ui.row().classes("items-center gap-1 no-wrap"):
        ui.number(
            value=float(f"{row['value']:.6g}"), format="%.6g", on_change=lambda e: changed("value", e.value)
        ).props("dense borderless input-class='text-right' hide-bottom-space").classes("w-24").mark(
            f"value-{name}"
        )
        if row["standard_error"] is not None and row["free"]:
            ui.label(f"± {row['standard_error']:.2g}").classes("text-sm")
    ui.label(row["unit"]).classes("text-sm")
    ui.checkbox(value=row["free"], on_change=lambda e: changed("estimate", e.value)).props("dense").mark(
        f"free-{name}"
    )
    if row["identified"]:
        ui.badge(row["identified"]).props(f"color={_VERDICT_COLOURS[row['identified']]}")
    else:
        ui.label("held fixed" if not row["free"] else "").classes("text-sm text-grey-6")


def _model(vehicle: Vehicle) -> None:
    """The effects of the model, each with the equations that its parameters stand in."""
    ui.label("Their equations: the forces are the sum of these").classes("font-medium pt-4")
    for effect in vehicle.all_effects:
        details = ui.expansion(effect.id).mark(f"effect-{effect.id}")
        with details.props("dense").classes("w-full text-sm"):
            ui.label(effect.about())
            place = ui.column().classes("w-full gap-1")
        details.on_value_change(partial(_equations, place, _written(vehicle, effect)))


def _written(vehicle: Vehicle, effect: Effect) -> Iterator[tuple[str, str]]:
    """Equations of an effect of the model, found when they are asked for."""
    for one in equations_on(vehicle.composition, effect):
        yield f"{one.left} = {one.plain}", one.latex


def _with_error(value: float | None, sigma: float | None) -> str:
    if value is None:
        return "added"
    return f"{value:.4g}" if sigma is None else f"{value:.4g} ± {sigma:.2g}"


def _apply(view: View) -> None:
    """Make the changes; a cell that was emptied stays as it was."""
    edits = {name: edit for name, edit in view.edits.items() if edit["value"] is not None}
    if edits:
        view.bench.start("edit", values=edits)


def _fitted(found: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], current: bool) -> None:
    if not current:
        stale()
    ui.label(found["sentence"]).classes("text-sm").mark("fit-sentence")
    ui.label("Estimates over stated values").classes("font-medium")
    ui.plotly(figures.against_priors(rows)).classes("w-full")
    for name, remarks in found["remarks"].items():
        ui.label(f"{parameter_text(name)}: {'; '.join(remarks)}").classes("text-sm text-amber-900")
    for note in found["notes"]:
        ui.label(note).classes("text-sm text-amber-900")
    if found["combinations"]:
        ui.label(f"The logs determine only these combinations: {'; '.join(found['combinations'])}.").classes(
            "text-sm text-amber-900"
        )
    ui.label(
        f"Correlation of the errors of the estimates (condition number {found['condition']:.3g})"
    ).classes("font-medium")
    names = [parameter_text(n) for n in found["names"]]
    ui.plotly(figures.correlations(names, found["correlation"])).classes("w-full").mark("correlations")


# --- Out ------------------------------------------------------------------------------------------
def output_page(view: View) -> None:
    """Vehicle file, report, C code, and the command lines that would do the same."""
    bench = view.bench
    stem = Path(bench.session.vehicle).stem
    heading("Out", f"The model that is written is {bench.session.steps[-1].what}.")
    with ui.grid(columns="12rem 28rem auto").classes("items-center gap-x-4 gap-y-1"):
        _output(view, "Vehicle file", "vehicle", f"{stem}-better.toml")
        _output(
            view, "Report (HTML)", "report", f"{stem}-report.html", key=bench.session.latest.get("diagnose")
        )
        _output(view, "C code (folder)", "code", "build")
    heading("The same from a command line", "to repeat what was clicked")
    if bench.place.in_pieces and not bench.session.written:
        ui.label("Commands take whole logs: first write the chosen segments as separate logs.").classes(
            "text-sm"
        )
        action("Write the segments", view, "logs")
        return
    text = "\n".join(commands(bench.place))
    lines(text)
    ui.button("Copy", on_click=lambda: ui.clipboard.write(text)).props("dense flat no-caps")
    with ui.expansion("The models of this session").classes("text-sm"):
        for i, step in enumerate(bench.session.steps):
            ui.label(f"{step.what}: {bench.place.vehicle_file(i)}").classes("text-sm")


def _output(view: View, title: str, task: str, name: str, **args: Any) -> None:
    ui.label(title)
    path = ui.input(value=name).props("dense").mark(f"path-{task}")
    button("Write", view, lambda: view.bench.start(task, out=path.value, **args), f"write-{task}")


def commands(place: Workspace) -> list[str]:
    """The command lines that do what was done at the workbench, in its order."""
    session, found, name, own = place.session, list[str](), shown_path(place.session.vehicle), list[str]()
    for step in session.steps:
        if step.command:
            found.append(place.line(name, own).with_validation(step.command.split(), "--out", step.file))
        elif step.file:
            found.append(f"# edit {shlex.quote(name)}: {step.what}; save it as {step.file}")
        name = step.file or name
        for task in step.asked:
            word, _, effect = task.partition(" ")
            own += [f"{effect}.py"] if effect else []
            found.append(_asked(word, effect, place.line(name, own)))
    return [*found, f"undertow export c {shlex.quote(name)}"]


def _asked(task: str, effect: str, line: CommandLine) -> str:
    """The command that asks what a button asked."""
    if task == "diagnose":
        return line.with_validation(["diagnose"], "--json", "diagnosis.json", "--report", "report.html")
    if task == "invent":
        return f"undertow effects new {effect} --from diagnosis.json"
    return line.on_logs([{"examine": "doctor"}.get(task, task)])
