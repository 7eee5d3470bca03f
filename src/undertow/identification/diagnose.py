"""The whole diagnosis: split the data, search, judge by simulation, and put it into words and numbers."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from undertow.files import write_whole
from undertow.identification.diagnosis.parallel import in_background, one_thread
from undertow.identification.diagnosis.splitting import (
    Runs,
    normalised,
    training_and_validation,
    with_velocities,
)
from undertow.identification.doctor.dynamics import without_refuted
from undertow.identification.doctor.examine import examine
from undertow.identification.doctor.findings import Examination
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.weak_form import WeakFit
from undertow.identification.logs.run import Run
from undertow.model.catalogue import Catalogue, catalogue
from undertow.model.vehicle import Vehicle
from undertow.notebook import html
from undertow.typing import Progress

from .compare.comparison import compare
from .diagnosis.bench import noise_ratio
from .diagnosis.result import (
    Diagnosis,
    Role,
    run_info,
)
from .diagnosis.search import Search, search
from .diagnosis.selection import Selection, select, selected
from .diagnosis.settings import DEFAULT, Settings
from .diagnosis.validation import SimulationValidator
from .report.data import ReportData
from .report.sentences import summarised
from .result_builder import ResultBuilder

# Share of the time that the search takes: nine tenths where little is left (docs/profile.md), else less.
_SEARCH = 0.7


def _builder(
    vehicle: Vehicle, found: Search, validator: SimulationValidator, known: Catalogue, report: Progress
) -> ResultBuilder:
    """The result of the search, or where it leaves more than noise, of the selection."""
    if not _far_from_noise(found, validator):
        report(_SEARCH, "judging the result by simulation")
        builder = ResultBuilder(vehicle, found, validator, known)
        if builder.judgement.verdict != "unexplained":
            return builder
    report(_SEARCH, "adding effects as long as predictions get better")
    rest = 0.99 - _SEARCH
    selection = select(found, validator, known, lambda done, words: report(_SEARCH + rest * done, words))
    return _confirmed(vehicle, found, validator, known, selection)


def _far_from_noise(found: Search, validator: SimulationValidator) -> bool:
    """Whether neither what was found nor what does as well in its place could be fitted down to the noise."""
    limit = validator.settings.output_error_reach
    sets = [found.effect_set, *(s for rivals in found.rivals for s in rivals)]

    def far(fit: WeakFit) -> bool:
        least = np.nanmax(noise_ratio(fit, found.bench.test))
        return bool(least > limit and not np.mean(validator.squares(fit)) < limit)

    return all(far(s.fit) for s in sets)


def _confirmed(
    vehicle: Vehicle, found: Search, validator: SimulationValidator, known: Catalogue, selection: Selection
) -> ResultBuilder:
    """The result with those selected effects that are worth adding in the last fits of all models, too."""
    builder = ResultBuilder(vehicle, selected(found, selection), validator, known, selection)
    worth = builder.worth()
    least = builder.settings.worth
    lacking = next((i for i, w in enumerate(worth) if not w.enough(least)), None)
    if lacking is not None:
        return _confirmed(vehicle, found, validator, known, selection.without(lacking))
    builder.regrade(worth)
    return builder


@dataclass(frozen=True, repr=False)
class DiagnosisResult:
    """A diagnosis with the models it is about.

    Attributes
    ----------
    diagnosis : Diagnosis
        What is written to JSON.
    before, after : Vehicle
        The refitted model as it was, and with the named effects (the same where none is named).
    train, test : list of Run
        What was fitted to, and what was judged by.
    fit : Fitted
        The fit of `after`.
    given, helped : Vehicle, optional
        The model before any fit, and with all that helps to predict: what a report shows beside the others.
    tried : dict of Fitted
        The refitted model with each of the candidates that do something, by the id of the effect.
    """

    diagnosis: Diagnosis
    before: Vehicle
    after: Vehicle
    train: list[Run]
    test: list[Run]
    fit: Fitted
    given: Vehicle | None = None
    helped: Vehicle | None = None
    tried: Mapping[str, Fitted] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        """adequate, missing_effect, indistinguishable, unexplained or not_identifiable."""
        return self.diagnosis.verdict

    @property
    def effects(self) -> list[str]:
        """Ids of the effects that are named; empty where none is."""
        return self.diagnosis.effects

    def report(self, out: str | Path) -> None:
        """Write the report: one HTML page with all pictures."""
        from .report.page import render_report  # brings matplotlib, which only a report needs

        write_whole(Path(out), render_report(self.diagnosis, self.comparison()))

    def comparison(self, *, compiled: bool | None = None) -> ReportData:
        """The refitted model beside the validation runs, without and with what was added, for a report."""
        from .report.tables import report_data

        before = compare(self.before, self.test, compiled=compiled)
        d, helped = self.diagnosis, bool(self.diagnosis.helps and self.helped)
        added = (d.steps[-1] if helped else d.last_step).changes
        better = self.helped if self.helped is not None and helped else self.after
        after = compare(better, self.test, compiled=compiled) if added else None
        names = ("model refitted", " ".join(["with", " and ".join(added) or "nothing added"]))
        return report_data(before, after, names=names, given=self.given)

    def __repr__(self) -> str:
        return f"{self.verdict}: {self.diagnosis.headline}"

    def _repr_html_(self) -> str:
        head = ("model", "error on validation data (1: sensor noise)")
        rows = ((" and ".join(s.changes) or "refitted", s.error) for s in self.diagnosis.steps)
        return html(repr(self), head, rows)


@one_thread()
def diagnose(
    vehicle: Vehicle,
    runs: Runs,
    validation: Runs = (),
    *,
    known: Catalogue | None = None,
    report: Progress = lambda done, words: None,
    false_alarms: float | None = None,
    settings: Settings = DEFAULT,
    trust_log: bool = False,
) -> DiagnosisResult:
    """Find out which effect a model lacks, judged on validation data.

    Parameters
    ----------
    vehicle : Vehicle
        The model; parameters marked `estimate` are refitted.
    runs, validation : Run or sequence of Run
        Logs to fit to and to validate on; without `validation`, parts of `runs` are set aside for it.
    known : mapping, optional
        Effects that may be missing, by id; the whole catalogue by default.
    report : callable
        Called with the fraction done, 0 to 1, and a description of the present work.
    false_alarms : float, optional
        Probability of naming an effect when nothing is missing, 0.005 to 0.2; by default that of `settings`.
    settings : Settings
        The numbers that decide, see `undertow.identification.diagnosis.settings`.
    trust_log : bool
        Use logs even if their channels contradict each other or the vehicle (wrong units).

    Returns
    -------
    DiagnosisResult
        `verdict`, `effects`, the models `before` and `after` adding them, and `report(path)`.

    Raises
    ------
    UndertowError
        If a channel is missing, a log is too short or contradicts itself, or nothing moved in it.

    Examples
    --------
    >>> from pathlib import Path
    >>> import undertow as ut
    >>> demo = Path(ut.__file__).parent / "demo_data" / "auv"
    >>> vehicle = ut.load_vehicle(demo / "vehicle.toml")
    >>> run = ut.read_log(demo / "train_1.csv.gz", commands=vehicle.command_names)
    >>> current = {"ocean_current": ut.catalogue()["ocean_current"]}
    >>> ut.diagnose(vehicle, [run], known=current).effects
    ['ocean_current']
    """
    if false_alarms is not None:
        settings = replace(settings, false_alarm_rate=false_alarms)
    began = time.perf_counter()
    vehicle, *both = normalised(vehicle, runs, validation)
    logs, judges = (with_velocities(vehicle, given) for given in both)
    train, test = training_and_validation(vehicle, logs, judges, settings, trust_log=trust_log)
    data = prepare(train, vehicle)
    with in_background(lambda: examine(vehicle, [*logs, *judges]).result) as examined:
        validator = SimulationValidator(vehicle, train, test, data.sigma, settings)
        effects = known or catalogue()
        found = search(
            vehicle,
            data,
            prepare(test, vehicle, sigma=data.sigma),
            effects,
            lambda done, words: report(_SEARCH * done, words),
            validator.residual_is_noise,
            settings,
        )
        builder = _builder(vehicle, found, validator, effects, report)
        roles: tuple[Role, Role] = ("train", "holdout") if judges else ("blocks", "blocks")
        infos = [run_info(r, roles[0]) for r in logs] + [run_info(r, roles[1]) for r in judges]
        diagnosis = builder.build(infos, time.perf_counter() - began)
        diagnosis = _with_doctor(diagnosis, examined(), explained=builder.leaves_only_noise)
    return DiagnosisResult(
        diagnosis,
        builder.given.vehicle,
        builder.after.vehicle,
        train,
        test,
        builder.after,
        vehicle,
        builder.fits[-1].vehicle,
        builder.tried,
    )


def _with_doctor(diagnosis: Diagnosis, examined: Examination, *, explained: bool) -> Diagnosis:
    """The diagnosis in words, with what the doctor found; mistakes come first among the warnings.

    explained: whether the logs as they are read leave only noise.
    """
    if explained:
        examined = without_refuted(examined)
    diagnosis = summarised(diagnosis.model_copy(update={"doctor": examined.findings}))
    mistakes = [f"{f.severity}: {f.text}" for f in examined.mistakes]
    wrong = "; ".join(f.clause(examined.runs) for f in examined.mistakes)
    first = [f"First correct the mistakes in the logs or the vehicle file: {wrong}."] if mistakes else []
    return diagnosis.model_copy(
        update={
            "warnings": [*mistakes, *diagnosis.warnings],
            "headline": " ".join([*first, diagnosis.headline]),
        }
    )
