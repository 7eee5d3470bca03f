"""The complete diagnosis: split the data, search, check by simulation, report; logs from a rig."""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from undertow.errors import UndertowError, listed, of_stated_kinds
from undertow.files import write_whole
from undertow.model.catalogue import Catalogue, catalogue
from undertow.model.saving import save_vehicle
from undertow.model.symbols import DOFS, FORCE, POSE, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.notebook import html
from undertow.typing import Array, Progress

from .comparison import compare
from .diagnosis.bench import noise_ratio
from .diagnosis.grading import ONLY_TOGETHER, doubt_of_companion
from .diagnosis.parallel import in_background
from .diagnosis.result import Diagnosis, Role, RunInfo, ValuesByRun, run_info
from .diagnosis.search import Search, search
from .diagnosis.selection import Selection, least_useful, select, selected
from .diagnosis.settings import DEFAULT, Settings
from .diagnosis.splitting import Runs, normalised, training_and_validation, with_velocities
from .diagnosis.validation import SimulationValidator
from .diagnosis.verdict import values_by_run
from .doctor.dynamics import without_refuted
from .doctor.examine import examine
from .estimation.data import inverse_of, prepare
from .estimation.fitted import SIGNIFICANT_T, Fitted
from .estimation.step import estimated, follower_errors, followers
from .estimation.threads import one_thread
from .estimation.weak_form import WeakFit
from .findings import Examination
from .logs.run import Run
from .report.sentences import summarised
from .result_builder import ResultBuilder

if TYPE_CHECKING:
    from .report.pictures import ReportData


# Share of the time that the search takes: nine tenths where little is left (docs/profile.md), else less.
_SEARCH = 0.7
_log = logging.getLogger("undertow.diagnosis")


def _builder(
    vehicle: Vehicle, found: Search, validator: SimulationValidator, known: Catalogue, report: Progress
) -> ResultBuilder:
    """The result of the search or, if that leaves a residual above the noise, of the selection."""
    if not _far_from_noise(found, validator):
        report(_SEARCH, "checking the result by simulation")
        builder = ResultBuilder(vehicle, found, validator, known)
        if builder.judgement.verdict != "unexplained":
            return builder
    report(_SEARCH, "adding effects while predictions improve")
    rest = 0.99 - _SEARCH
    selection = select(found, validator, known, lambda done, words: report(_SEARCH + rest * done, words))
    return _confirmed(vehicle, found, validator, known, selection)


def _far_from_noise(found: Search, validator: SimulationValidator) -> bool:
    """Whether neither the effects found nor their rivals can bring the residual down to the noise."""
    limit = validator.settings.output_error_reach
    sets = [found.effect_set, *(s for rivals in found.rivals for s in rivals)]

    def far(fit: WeakFit) -> bool:
        least = np.nanmax(noise_ratio(fit, found.bench.test))
        return bool(least > limit and not np.mean(validator.squares(fit)) < limit)

    return all(far(s.fit) for s in sets)


def _confirmed(
    vehicle: Vehicle, found: Search, validator: SimulationValidator, known: Catalogue, selection: Selection
) -> ResultBuilder:
    """The result with those selected effects that also improve predictions in the final fits.

    Established effects come first; one that improves them only with effects in doubt is in doubt, too.
    """
    ordered = selection.established_first
    builder = ResultBuilder(vehicle, selected(found, ordered), validator, known, ordered)
    place = builder.superfluous
    if place is not None:
        rest = selection.without(ordered.graded[place])
        return _confirmed(vehicle, found, validator, known, rest)
    gains, least = builder.gains(), builder.settings.worth
    small = [k for k, gain in enumerate(gains) if not gain.suffices(least)]
    for k in small:
        # On top of those before it alone, the fit may end elsewhere than where it was found.
        gains[k] = builder.gain_within_all(k)
    place = least_useful(gains, least)
    if place is not None:
        worst = ordered.graded[place]
        beside = "" if worst.doubt else selection.doubted_before(worst)
        rest = selection.with_doubt(worst, doubt_of_companion(beside)) if beside else selection.without(worst)
        return _confirmed(vehicle, found, validator, known, rest)
    dependent = next((ordered.graded[k] for k in small if not ordered.graded[k].doubt), None)
    if dependent is not None:
        return _confirmed(vehicle, found, validator, known, selection.with_doubt(dependent, ONLY_TOGETHER))
    builder.regrade(gains)
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
        Training and validation logs.
    fit : Fitted
        The fit of `after`.
    given, helped : Vehicle, optional
        The model before any fit, and with all effects that improve predictions, for the report.
    tried : dict of Fitted
        The refitted model with each candidate that has an influence, by the id of the effect.
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
        from undertow.identification.report.page import (
            render_report,  # brings matplotlib, which only a report needs
        )

        write_whole(Path(out), render_report(self.diagnosis, self.comparison()))

    def comparison(self, *, compiled: bool | None = None) -> ReportData:
        """The refitted model beside the validation runs, without and with what was added, for a report."""
        from undertow.identification.report.page import report_data

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
@of_stated_kinds
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
        Called with the fraction done, 0 to 1, and a description of the current step.
    false_alarms : float, optional
        Probability of naming an effect when nothing is missing, 0.005 to 0.2; by default that of `settings`.
    settings : Settings
        The decision thresholds, see `undertow.identification.diagnosis.settings`.
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
        _log_mistakes(examined())
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


def _log_mistakes(examined: Examination) -> None:
    """Warn of mistakes in the logs before a search that takes minutes; it continues all the same."""
    for finding in examined.mistakes:
        _log.warning("%s (undertow doctor says how to correct it; the search continues)", finding.text)


def _with_doctor(diagnosis: Diagnosis, examined: Examination, *, explained: bool) -> Diagnosis:
    """The diagnosis in words, with what the doctor found; mistakes come first among the warnings.

    explained: whether only noise remains in the logs as they were read.
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


# --- vehicle files with the result, and its history -----------------------------------------------
def roles(train: Sequence[Run], test: Sequence[Run]) -> list[tuple[Role, Run]]:
    """Logs with their roles: training or validation."""
    names: tuple[Role, Role] = ("train", "holdout")
    return [(role, run) for role, runs in zip(names, (train, test), strict=True) for run in runs]


def uncertainty(fit: Fitted) -> tuple[tuple[str, ...], Array, list[ValuesByRun]]:
    """Names and covariance of the parameters of a fit, and the values by run."""
    return (*fit.vehicle_covariance, values_by_run(fit, fit.model.functions.vehicle))


def save_result(
    vehicle: Vehicle,
    template: str | Path,
    out: Path,
    command: str,
    logs: Sequence[tuple[str, Run | RunInfo]],
    errors: tuple[float, float],
    known: tuple[Sequence[str], Array, Sequence[ValuesByRun]],
    **more: object,
) -> None:
    """Write a vehicle in the form of the file that it came from, with a history of its values.

    `errors` are those before and after, `known` is as by `uncertainty`, and `more` goes into the history.
    """
    names, covariance, by_run = known
    entry = {
        "command": command,
        "date": date.today().isoformat(),
        **more,
        "logs": [{"name": r.name, "sha256": r.sha256, "role": role} for role, r in logs],
        "error_before": errors[0],
        "error_after": errors[1],
        **({"by_run": list(map(_history_of, by_run))} if by_run else {}),
        "covariance": {"parameters": list(names), "matrix": covariance.tolist()},
    }
    save_vehicle(vehicle, template, out, history=entry)


def _history_of(table: ValuesByRun) -> dict[str, object]:
    """Values by run for a vehicle file."""
    errors = table.standard_errors
    runs = [{"run": run, "value": value, "sigma": errors[run]} for run, value in table.values.items()]
    return {"parameter": table.parameter, "runs": runs, "spread": table.spread, "q": table.q}


def save_diagnosis(
    result: DiagnosisResult, template: str | Path, out: Path, command: str = "undertow diagnose"
) -> None:
    """Write the vehicle file with the result of a diagnosis."""
    d = result.diagnosis
    logs, errors = [(r.role, r) for r in d.runs], (d.steps[0].error, d.last_step.error)
    save_result(result.after, template, out, command, logs, errors, uncertainty(result.fit), added=d.effects)


# --- logs of a rig: an experiment for each set of free motions ------------------------------------
# Channels of a prescribed motion that enter the equations: depth and attitude, and all velocities.
_PRESCRIBED_CHANNELS = dict(zip(DOFS, zip((None, None, *POSE[2:]), VELOCITY, strict=True), strict=True))


@dataclass(frozen=True)
class Experiment:
    """Logs in which the same motions are free."""

    vehicle: Vehicle  # the vehicle with these motions only
    moved: tuple[str, ...]  # channels of motions that the rig moves as logged
    held: tuple[str, ...]  # motions of the whole vehicle that are at rest
    pushed: bool  # whether the rig drives what is free; else the vehicle's own actuators do
    # train, test: logs to fit to and to judge by
    train: list[Run] = field(default_factory=list)
    test: list[Run] = field(default_factory=list)

    @property
    def name(self) -> str:
        """A unique name for files: free and prescribed motions, and whether forces are given."""
        return "-".join([*self.vehicle.degrees_of_freedom, *self.moved, *(["forced"] if self.pushed else [])])

    def __str__(self) -> str:
        logs = ", ".join(run.name for run in (*self.train, *self.test))
        parts = [f"{listed(self.vehicle.degrees_of_freedom)} free"]
        parts += [f"{listed(self.held)} held at rest"] if self.held else []
        parts += [f"{listed(self.moved)} as logged"] if self.moved else []
        parts += ["driven by external forces"] if self.pushed else []
        return f"{'; '.join(parts)} ({logs})"


def on_rig(vehicle: Vehicle, runs: Sequence[Run]) -> bool:
    """Whether a rig holds or moves a motion of the vehicle in any of the logs."""
    return any(set(run.held) & set(vehicle.degrees_of_freedom) for run in runs)


def experiments(vehicle: Vehicle, runs: Sequence[Run], validation: Sequence[Run] = ()) -> list[Experiment]:
    """Sort the logs by their free motions."""
    found: dict[tuple[object, ...], Experiment] = {}
    for role, logs in (("train", runs), ("test", validation)):
        for run in logs:
            experiment = _experiment(vehicle, run)
            key = (experiment.vehicle.degrees_of_freedom, experiment.moved, experiment.pushed)
            getattr(found.setdefault(key, experiment), role).append(run)
    for experiment in found.values():
        if not experiment.train:
            raise UndertowError(
                f"no training log has the free motions of this validation log: {experiment}: leave it out"
            )
    return list(found.values())


def _experiment(vehicle: Vehicle, run: Run) -> Experiment:
    held = [d for d in vehicle.degrees_of_freedom if d in run.held]
    free = [d for d in vehicle.degrees_of_freedom if d not in run.held]
    if not free:
        raise UndertowError(
            f"run '{run.name}' has no free motion of '{vehicle.name}': held are {', '.join(held)}: "
            "leave the log out, or add its motion to the vehicle"
        )
    moved = {d: [n for n in _PRESCRIBED_CHANNELS[d] if n and run.has(n)] for d in held}
    channels = tuple(n for names in moved.values() for n in names)
    pushed = bool(held) and _pushed(vehicle, free, run)
    reduced = vehicle.constrained(free, channels, pushed=pushed) if held else vehicle
    still = tuple(d for d in held if not moved[d])
    return Experiment(reduced, channels, still, pushed)


def _pushed(vehicle: Vehicle, free: Sequence[str], run: Run) -> bool:
    """Whether the log has the forces on all free motions instead of commands."""
    forces = [f"tau_{FORCE[DOFS.index(d)]}" for d in free]
    commands = [n for n in vehicle.actuator_names if not run.has(n)]
    lacking = [n for n in forces if not run.has(n)]
    if lacking and (commands or not vehicle.actuator_names):
        without = f"the commands {', '.join(commands)} nor " if commands else ""
        raise UndertowError(
            f"run '{run.name}' has neither {without}the forces {', '.join(lacking)} of what is free "
            f"({', '.join(free)}): map their columns"
        )
    return not lacking and bool(commands or not vehicle.actuator_names)


# --- combination ----------------------------------------------------------------------------------
@dataclass(frozen=True)
class CombinedFits:
    """Fits of several experiments combined, weighted by their information."""

    stated: Vehicle  # the whole vehicle as given
    fits: tuple[Fitted, ...]  # a fit for each experiment
    logs: Sequence[tuple[Role, Run | RunInfo]]  # what they were fitted to and judged by
    shares: Sequence[tuple[float, float]]  # the error of each experiment on validation data before and after

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Parameters that any experiment fitted."""
        return tuple(dict.fromkeys(n for fit in self.fits for n in fit.vehicle_covariance[0]))

    @cached_property
    def covariance(self) -> Array:
        """Covariance of their errors: experiments are independent, so their information adds up."""
        return inverse_of(np.sum([self._information(fit)[0] for fit in self.fits], axis=0))

    @cached_property
    def values(self) -> dict[str, float]:
        """Values by generalised least squares, in SI and SNAME signs."""
        found = self.covariance @ np.sum([self._information(fit)[1] for fit in self.fits], axis=0)
        return dict(zip(self.names, found.tolist(), strict=True))

    def _information(self, fit: Fitted) -> tuple[Array, Array]:
        """Information of a fit, (k, k), and that times its values, (k,), in the order of `names`."""
        own, covariance = fit.vehicle_covariance
        places = np.array([self.names.index(n) for n in own])
        table, weighted_values = np.zeros((len(self.names), len(self.names))), np.zeros(len(self.names))
        information = inverse_of(covariance)
        table[np.ix_(places, places)] = information
        weighted_values[places] = information @ np.array([fit.values[n] for n in own])
        return table, weighted_values

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors of the values."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def vehicle(self) -> Vehicle:
        """The whole vehicle with the values of all experiments."""
        values, errors = self.values, self.errors
        for fit in self.fits:
            own = {n: self.values[n] for n in fit.vehicle_covariance[0]}
            values = values | followers(fit.model, own)
            errors = errors | follower_errors(fit.model, {n: self.errors[n] for n in own})
        return estimated(self.stated, values, errors)

    def save(self, template: str | Path, out: Path, command: str, **more: object) -> None:
        """Write the whole vehicle, in the form of its file; errors are root mean squares."""
        before, after = np.sqrt(np.mean(np.square(self.shares), axis=0)).tolist()
        known = self.names, self.covariance, ()
        save_result(self.vehicle, template, out, command, self.logs, (before, after), known, **more)

    def disagreements(self) -> Iterator[str]:
        """Parameters whose estimates in two experiments contradict each other."""
        for first, other in combinations(self.fits, 2):
            for name in (n for n in first.values if n in other.values):
                difference = abs(first.values[name] - other.values[name])
                spread = float(np.hypot(first.standard_errors[name], other.standard_errors[name]))
                if difference > SIGNIFICANT_T * spread:
                    places = [listed(f.model.functions.vehicle.degrees_of_freedom) for f in (first, other)]
                    yield (
                        f"{name} is {first.values[name]:.4g} by {places[0]} and {other.values[name]:.4g} by "
                        f"{places[1]} (SNAME signs), {difference / spread:.1f} standard errors apart: one of "
                        "them lacks an effect"
                    )


def combine_diagnoses(vehicle: Vehicle, outcomes: Sequence[DiagnosisResult]) -> CombinedFits:
    """The whole vehicle with the effects named in any of its experiments."""
    for outcome in outcomes:
        for effect in (e for e in outcome.after.effects if e.id in outcome.effects):
            new = {n: v for n, v in outcome.after.values.items() if n not in vehicle.values}
            vehicle = vehicle.with_effect(type(effect), new)
    logs = [(r.role, r) for outcome in outcomes for r in outcome.diagnosis.runs]
    errors = [(d.steps[0].error, d.last_step.error) for d in (outcome.diagnosis for outcome in outcomes)]
    return CombinedFits(vehicle, tuple(outcome.fit for outcome in outcomes), logs, errors)
