"""What commands print and write of a diagnosis."""

from __future__ import annotations

from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from undertow.identification.diagnosis.diagnose import Outcome
    from undertow.identification.diagnosis.result import Diagnosis, Estimate
    from undertow.identification.report.data import ReportData

_SHOWN = 6


def show(outcome: Outcome, console: Console | None = None) -> None:
    """Print verdict, ranking, the falling error and warnings."""
    console = console or Console()
    diagnosis = outcome.diagnosis
    console.print(f"[bold]{diagnosis.verdict}[/bold]: {escape(diagnosis.headline)}")
    console.print(_ranking(diagnosis))
    console.print(_steps(diagnosis))
    for left in diagnosis.remaining:
        console.print(escape(left.summary or f"{left.degree_of_freedom}: {left.note}"), highlight=False)
    if any(left.depends_on or left.spectrum for left in diagnosis.remaining):
        console.print("[dim]an effect made of it: undertow effects new ID --from (the file of --json)[/dim]")
    for warning in diagnosis.warnings:
        console.print(f"[yellow]warning[/yellow]: {escape(warning)}")
    console.print(
        f"[dim]{diagnosis.seconds:.0f} s; held to {diagnosis.false_alarm_rate:.0%} false alarms[/dim]"
    )


def _ranking(diagnosis: Diagnosis) -> Table:
    table = Table(
        title="Candidates, judged on kept-aside data (error 1 = noise of the sensors)", title_justify="left"
    )
    table.add_column("effect", no_wrap=True)
    for name in ("before", "after", "explains"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("sure", no_wrap=True)
    table.add_column("parameters")
    helping = [r for r in diagnosis.ranking if r.parameters or r.significant][:_SHOWN]
    for r in helping:
        text = ", ".join(_value(p) for p in r.parameters[:4]) + (" ..." if len(r.parameters) > 4 else "")
        cells = (
            f"{r.error_before:.3g}",
            f"{r.error_after:.3g}",
            f"{r.explained:.0%}",
            "yes" if r.significant else "no",
        )
        table.add_row(r.effect, *cells, escape(text))
    rest = len(diagnosis.ranking) - len(helping)
    table.caption = f"{rest} more effects were tried and do not help" if rest else ""
    return table


def _value(p: Estimate) -> str:
    error = "" if p.standard_error is None else f" ± {p.standard_error:.1g}"
    return f"{p.name} = {p.value:.4g}{error} {p.unit}".rstrip()


def _steps(diagnosis: Diagnosis) -> Table:
    table = Table(title="Error on kept-aside data against effects added", title_justify="left")
    table.add_column("model")
    table.add_column("normalised error (noise floor 1)", justify="right")
    table.add_column("velocity error 5 s ahead", justify="right")
    for step in diagnosis.steps:
        ahead = "" if step.prediction is None else f"{step.prediction:.1%}"
        table.add_row(" + ".join(["model", *step.added]), f"{step.error:.3g}", ahead)
    return table


def write_outcome(
    outcome: Outcome, template: Path, *, json: Path | None, report: Path | None, apply: Path | None
) -> None:
    """Write what was asked for, each file whole, and say where it is."""
    from undertow.files import write_whole

    # Everything is prepared before anything is written, so that a failure leaves no file behind.
    texts = {}
    if json is not None:
        texts[json] = outcome.diagnosis.model_dump_json(indent=1) + "\n"
    if report is not None:
        texts[report] = page(outcome)
    if apply is not None:
        write_vehicle(outcome, template, apply, "undertow diagnose")
    for path, text in texts.items():
        write_whole(path, text)
    for written in filter(None, (json, report, apply)):
        Console().print(f"wrote {escape(str(written))}")


def page(outcome: Outcome) -> str:
    """The report of a diagnosis as one HTML page."""
    from undertow.identification.report.page import render_report

    return render_report(outcome.diagnosis, pictures_data(outcome))


def pictures_data(outcome: Outcome) -> ReportData:
    """Comparison of the refitted model with the kept-aside runs, before and after."""
    from undertow.identification.compare.comparison import compare
    from undertow.identification.report import report_data

    before = compare(outcome.before, outcome.test)
    after = compare(outcome.after, outcome.test) if outcome.diagnosis.effects else None
    names = ("model refitted", " ".join(["with", " and ".join(outcome.diagnosis.effects) or "nothing added"]))
    return report_data(before, after, names=names)


def write_vehicle(outcome: Outcome, template: Path, out: Path, command: str) -> None:
    """Write the vehicle file with what was found, and how it came about."""
    from undertow.model.saving import save_vehicle

    d = outcome.diagnosis
    free = outcome.fit.model.free
    history = {
        "command": command,
        "date": date.today().isoformat(),
        "added": d.effects,
        "logs": [{"name": r.name, "sha256": r.sha256, "role": r.role} for r in d.runs],
        "error_before": d.steps[0].error,
        "error_after": d.steps[-1 if d.effects else 0].error,
        "covariance": {"parameters": list(free), "matrix": outcome.fit.covariance.tolist()},
    }
    save_vehicle(outcome.after, template, out, history=history)
