"""Find which physical effect a model lacks, and write it to a new vehicle file.

Every effect in the catalogue is added to the model in turn, and the model is refitted. It is the error on
validation data that counts: the logs given with --validation, or segments of the logs if none is given. The
answer is one of: nothing is missing (adequate), a missing effect with its parameters (missing_effect), a set
of effects that these data cannot tell apart (indistinguishable, or not_identifiable if there are many), an
effect that improves predictions without being established as the cause (helps_prediction), or unexplained.

No model of a real vehicle reduces the residual to sensor noise alone. If more remains, an effect has to
reduce the simulation error over the vehicle's own time constants by --worth, be the best one in nine of ten
resamples, and have about the same size in all runs and at all speeds (within half of it).

Values that are fixed in the vehicle file (all without estimate = true) are tried as well: if correcting them
explains more than any effect, the answer names them, and they are fitted in the output file. Mass, inertia,
weight, buoyancy and their centres are taken as known; errors in them show as an effect: entrained_water,
net_buoyancy, trim_offset.

Logs in which a towing carriage or a planar motion mechanism holds some motions (--held, or `held` in the
mapping files) are grouped by their free motions, and each group is diagnosed separately. --apply writes one
file with the findings of all groups; --json and --report write a file per group, with its free motions in the
name.

On Linux all cores share the work, which does not change the result; UNDERTOW_JOBS=1 in the environment uses
one core.

    undertow diagnose rov.toml run1.csv run2.csv --validation run3.csv --report page.html --apply better.toml
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._options import JsonFileOption, VehicleArgument, bundled
from .._terminal import console, progress, say, section, show_finding, table
from ._logs import LogsArgument, RigOptions, ValidationOption, of_experiment, say_long

if TYPE_CHECKING:
    from undertow.identification.diagnose import DiagnosisResult, Experiment
    from undertow.identification.diagnosis.result import Diagnosis, Estimate
    from undertow.identification.diagnosis.settings import Settings
    from undertow.identification.report.sentences import CommandLine
    from undertow.model.vehicle import Vehicle

    from ._logs import Loaded

_FALSE_ALARMS = typer.Option(
    metavar="CHANCE", help="Probability of naming an effect when nothing is missing, 0.005 to 0.2."
)
_WORTH = typer.Option(
    metavar="SHARE",
    help="If the residual exceeds the noise: fraction by which an effect has to "
    "reduce the error of long predictions.",
)
_REPORT = typer.Option(metavar="OUT.html", help="Write a report: one HTML file with all figures.")
# --out as well, which it is in all other commands that write a vehicle file.
_APPLY = typer.Option(
    "--apply",
    "--out",
    metavar="OUT.toml",
    help="Write a new vehicle file: with the effects that were found, or only refitted values.",
)


@bundled
def diagnose(
    vehicle: VehicleArgument,
    logs: LogsArgument,
    options: RigOptions,
    validation: ValidationOption = None,
    false_alarms: Annotated[float, _FALSE_ALARMS] = 0.01,
    worth: Annotated[float, _WORTH] = 0.1,
    json: JsonFileOption = None,
    report: Annotated[Path | None, _REPORT] = None,
    apply: Annotated[Path | None, _APPLY] = None,
) -> None:
    from undertow.files import check_writable
    from undertow.identification.diagnose import experiments, on_rig
    from undertow.identification.diagnosis.settings import Settings
    from undertow.identification.long_logs.choosing import SEARCH

    settings = Settings(false_alarm_rate=false_alarms, worth=worth)
    check_writable(json, report, apply, inputs=[vehicle, *logs, *(validation or []), *options.files])
    loaded = options.load(vehicle, logs, validation, to_fit=True, on_rig=True, budget=SEARCH, out=apply)
    parts = experiments(loaded.vehicle, loaded.runs, loaded.validation)
    rig = on_rig(loaded.vehicle, [*loaded.runs, *loaded.validation])
    written: list[tuple[DiagnosisResult, Path | None, Path | None]] = []
    for part in parts:
        own = partial(of_experiment, name=part.name if len(parts) > 1 else "")
        line = options.line(vehicle, logs, validation, own(json))
        outcome = _diagnosed(part, loaded, line, settings, options)
        if rig:
            say(str(part), "bold")
        show(outcome, own(json), options.map)
        say_long(outcome.diagnosis.long_logs)
        written.append((outcome, own(json), own(report)))
    _write(written, loaded.vehicle, vehicle, apply, rig)


def _diagnosed(
    part: Experiment, loaded: Loaded, line: CommandLine, settings: Settings, options: RigOptions
) -> DiagnosisResult:
    """The diagnosis of one experiment (without a rig the only one), with the command to go on with."""
    from undertow.identification.diagnose import diagnose as run
    from undertow.identification.planning.manoeuvres import can_be_planned
    from undertow.identification.report.sentences import next_command

    where = f" in {part.name}" if part.held or part.moved else ""
    with progress(f"looking for what is missing{where}") as bar:
        outcome = run(
            part.vehicle,
            part.train,
            part.test,
            known=options.known,
            report=bar,
            settings=settings,
            trust_log=options.trust_log,
        )
    # The models of a diagnosis by what they are called; the last is the one that it hands on.
    models = {"as given": part.vehicle, "refitted": outcome.before}
    added = " and ".join(outcome.effects)
    long = loaded.checked({**models, f"with {added}": outcome.after} if added else models)
    command = next_command(outcome.diagnosis, line, plannable=can_be_planned(part.vehicle))
    changes = {"command": command, "long_logs": long}
    return replace(outcome, diagnosis=outcome.diagnosis.model_copy(update=changes))


def _write(
    written: Sequence[tuple[DiagnosisResult, Path | None, Path | None]],
    model: Vehicle,
    template: str,
    apply: Path | None,
    rig: bool,
) -> None:
    """Write the files of all experiments, and one vehicle file with what was found in any of them."""
    from undertow.files import together, write_whole
    from undertow.identification.diagnose import combine_diagnoses, save_diagnosis

    outcomes = [outcome for outcome, *_ in written]
    with progress("writing", None), together():
        for outcome, json, report in written:
            if json is not None:
                write_whole(json, outcome.diagnosis.to_json())
            if report is not None:
                outcome.report(report)
        if apply is not None and rig:
            named = list(dict.fromkeys(e for outcome in outcomes for e in outcome.effects))
            combine_diagnoses(model, outcomes).save(template, apply, "undertow diagnose", added=named)
        elif apply is not None:
            save_diagnosis(outcomes[0], template, apply)
    for path in (path for _, *files in written for path in files if path is not None):
        say(f"wrote {path}")
    if apply is not None:
        contents = "; ".join(dict.fromkeys(_content(outcome.diagnosis) for outcome in outcomes))
        say(f"wrote {apply}: {contents}")


_SHOWN = 6


def show(outcome: DiagnosisResult, written: Path | None = None, map: Path | None = None) -> None:
    """Print verdict, ranking, the falling error and warnings.

    `written` is the file of --json, `map` the mapping file in use.
    """
    diagnosis = outcome.diagnosis
    for finding in diagnosis.doctor:
        if finding.severity == "mistake":
            show_finding(finding, map)
    say(f"{diagnosis.verdict}: {diagnosis.headline}", "bold")
    if diagnosis.command:
        say(f"run: {diagnosis.command}", "bold")
    _show_ranking(diagnosis)
    _show_steps(diagnosis)
    for values in diagnosis.by_run:
        say(str(values))
    for equals in diagnosis.indistinguishable:
        if equals.separated_by:
            say(f"to tell {' and '.join(equals.effects)} apart: {equals.separated_by}")
    for entry in diagnosis.ranking:
        if entry.not_named:
            say(f"not named: {entry.effect}: {entry.not_named}")
    _show_predictable(diagnosis)
    for left in diagnosis.remaining:
        say(left.summary or f"{left.degree_of_freedom}: {left.note}")
    if any(left.depends_on or left.spectrum for left in diagnosis.remaining):
        say(
            f"to turn it into an effect: undertow effects new ID --from {written or '(the file of --json)'}",
            "dim",
        )
    shown = {f"mistake: {f.text}" for f in diagnosis.doctor}
    for warning in (w for w in diagnosis.warnings if w not in shown):
        say(f"warning: {warning}", "yellow")
    doubts = [f.clause([r.name for r in diagnosis.runs]) for f in diagnosis.doctor if f.severity == "warning"]
    if doubts:
        say(f"undertow doctor warns, and says what to do: {'; '.join(doubts)}", "yellow")
    say(f"{diagnosis.seconds:.0f} s; false alarm rate {diagnosis.false_alarm_rate:.0%}", "dim")


def _show_predictable(diagnosis: Diagnosis) -> None:
    """How much of what the final model leaves over the longest horizon can be predicted."""
    from undertow.identification.diagnosis.floors import predictable_in_words

    horizons = [name for name in diagnosis.last_step.ahead if name != "free run"]
    if not diagnosis.predictable or not horizons:
        return
    steps = (diagnosis.last_step, diagnosis.steps[-1])
    left, lowered = (step.ahead.get(horizons[-1], inf) for step in steps)
    helps = diagnosis.helps if lowered < left else []
    correlates = any(r.depends_on or r.spectrum for r in diagnosis.remaining)
    limits = diagnosis.stopped_at_zero
    said = predictable_in_words(left, diagnosis.predictable, limits, helps, lowered, correlates=correlates)
    say(f"Over the longest horizon {said}.")


def _show_ranking(diagnosis: Diagnosis) -> None:
    from undertow.identification.diagnosis.result import explanations
    from undertow.identification.report.sentences import chance

    before = diagnosis.ranking[0].error_before if diagnosis.ranking else 1.0
    model = "model with other values" if diagnosis.freed else "refitted model"
    longest = next((list(r.falls)[-1] for r in diagnosis.ranking if r.falls), None)
    helping = [r for r in diagnosis.ranking if r.parameters or r.significant][:_SHOWN]
    rest = len(diagnosis.ranking) - len(helping)
    if rest and not helping:
        say(f"{rest} effects were tried, and none of them improves predictions.", "dim")
        return
    heads = ("effect", *([f"{longest} error"] if longest else []), "error", "explains", "chance", "sure")
    numbers = (
        [r.effect]
        + ([_change(-r.falls[longest]) if r.falls else ""] if longest else [])
        + [f"{r.error_after:.3g}", f"{r.explained:.0%}", chance(r.p_value), r.sure]
        for r in helping
    )
    section(
        f"Candidates on validation data (error of the {model} {before:.3g}, noise 1)", table(heads, numbers)
    )
    more = f"{rest} more effects were tried and rank lower. " if rest else ""
    meanings = " ".join(["", *explanations(helping, diagnosis.false_alarm_rate)])
    later = len(diagnosis.effects) + len(diagnosis.helps) > 1
    beside = " Effects chosen later were fitted with those chosen earlier in the model." if later else ""
    say(
        f"{more}Chance: the probability that the best of all candidates looks as good when nothing is "
        f"missing.{beside}{meanings}",
        "dim",
    )
    fitted = [(r.effect, _values(r.parameters, 4 if i == 0 else 1)) for i, r in enumerate(helping)]
    console().print(table(("effect", "fitted values"), [row for row in fitted if row[1]]))


def _values(parameters: Sequence[Estimate], most: int) -> str:
    return ", ".join(map(str, parameters[:most])) + (" ..." if len(parameters) > most else "")


def _change(share: float) -> str:
    from undertow.identification.diagnosis.prediction_gain import WORDING

    most = WORDING.diverges
    return f"> +{most:.0%}" if share > most else f"{share:+.0%}"


def _show_steps(diagnosis: Diagnosis) -> None:
    horizons = list(dict.fromkeys(h for step in diagnosis.steps for h in step.ahead))
    rows = []
    for step in diagnosis.steps:
        simulated = "diverges" if step.simulation is None else f"{step.simulation:.3g}"
        ahead = [f"{step.ahead[h]:.1%}" if h in step.ahead else "diverges" for h in horizons]
        rows.append([" + ".join(["model", *step.changes]), f"{step.error:.3g}", simulated, *ahead])
    title = "Error on validation data against effects added (noise floor 1); error of predicted velocities"
    section(title, table(("model", "error", "simulated", *horizons), rows))


def _content(diagnosis: Diagnosis) -> str:
    """What a vehicle file with the outcome of a diagnosis has that the given one had not."""
    freed = f", including {', '.join(diagnosis.freed)}, which were fixed" if diagnosis.freed else ""
    if not diagnosis.effects:
        return f"the same effects with refitted values{freed}; none was added, since none was established"
    summary = f"{' and '.join(diagnosis.effects)} added, values refitted{freed}"
    for equals in diagnosis.indistinguishable:
        chosen = next((e for e in equals.effects if e in diagnosis.effects), None)
        others = [e for e in equals.effects if e != chosen]
        if chosen and others:
            summary += f"; {chosen} stands for a set: it could equally be {' or '.join(others)}"
    return summary
