"""The identification part of `import undertow`; the commands call the same functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args

from undertow.errors import UndertowError, listed, of_stated_kinds
from undertow.model.catalogue import Catalogue, catalogue, lookup
from undertow.model.vehicle import Vehicle
from undertow.notebook import html
from undertow.typing import Progress

from .comparison import finite
from .diagnose import CombinedFits, roles, save_result, uncertainty
from .diagnose import diagnose as diagnose
from .diagnosis.addition import Addition, AdditionSetup, add_effects, set_up_addition
from .diagnosis.result import ValuesByRun, read_diagnosis, run_info
from .diagnosis.splitting import Runs, normalised, training_and_validation, with_velocities
from .diagnosis.verdict import estimates, values_by_run
from .doctor.examine import refuse_impossible
from .estimation.data import prepare
from .estimation.fitted import Fitted, cramer_rao, notes, remarks, t_values, verdicts
from .estimation.output_error import LossName, final_fit, fit_output_error
from .estimation.prediction_error import fit_prediction_error
from .estimation.predictor import predict_each
from .estimation.residual import without_spikes
from .estimation.step import UNDETERMINED, Constraints, read_equalities, require_equations, written_equalities
from .estimation.test_functions import boxes, test_functions
from .estimation.threads import one_thread
from .estimation.weak_form import (
    adapted,
    fit_instrumental,
    fit_weak_by_run,
    free_parameters,
    in_runs,
    required_free_parameters,
)
from .estimation.windows import Prediction, cut, horizons, possible_horizon, prediction_error
from .logs.chunks import long_logs
from .logs.formats.fieldlog import format_of
from .logs.mapping import LogMapping, read_mapping
from .logs.opening import check_fit
from .logs.opening import save_log as save_log
from .logs.reading import in_vehicle_units
from .logs.reading import read_log as read
from .logs.run import Run
from .long_logs.choosing import beyond_memory, read_in_parts
from .planning.problem import PlanRequest
from .planning.rivals import NONE, Diagnosed, RivalSpec, specs_of
from .planning.search import Planned, plan_parameters, plan_separation
from .report.results import AdditionResult, FitResult, FittedParameter, addition_result, channel_errors

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure


Method = Literal["default", "weak", "integral", "instrumental", "output-error", "prediction-error"]
_FAMILIES = {"default": test_functions, "weak": test_functions, "integral": boxes}


@dataclass(frozen=True)
class Estimator:
    """How parameters are estimated.

    `method` is "default" (the weak form, then output error, or if the residual exceeds the noise the error of
    predictions, over windows from the vehicle's own time constants, as far as that predicts validation data
    no worse), "weak", "integral" (the weak form with boxes for test functions), "instrumental" (the weak form
    with simulated regressors), "output-error" or "prediction-error" (output error with a disturbance).
    `horizon` is the length of the windows that output error and instrumental variables simulate, s; None for
    whole segments. `loss` is "gaussian", or "huber" or "student-t" if there are outliers: output error then
    weights every sample by its error; the weak form, whose residuals are sums over many samples, drops
    samples over five standard deviations from their neighbours.
    """

    method: Method = "default"
    horizon: float | None = 5.0
    constraints: Constraints = field(default_factory=Constraints)
    loss: LossName = "gaussian"

    def __post_init__(self) -> None:
        if self.horizon is not None and not self.horizon > 0:
            raise UndertowError(f"horizon = {self.horizon:g} s is no length of a window: give a positive one")

    def fit(
        self,
        vehicle: Vehicle,
        runs: Sequence[Run],
        free: Sequence[str] | None = None,
        progress: Progress = lambda done, words: None,
        *,
        validation: Sequence[Run] = (),
        trust_log: bool = False,
    ) -> Fitted:
        """Fit the free parameters of a vehicle, by default those that its file marks.

        The default method decides on `validation` (or, if empty, on `runs`) which result to keep. `trust_log`
        takes logs that `undertow.identification.doctor.refuse_impossible` refuses.
        """
        refuse_impossible(vehicle, runs, trust_log=trust_log)
        if self.method in _FAMILIES:
            data = prepare(runs, vehicle, family=_FAMILIES[self.method])
            data = data if self.loss == "gaussian" else without_spikes(data)
            model = self.constraints.model(vehicle, free_parameters(vehicle) if free is None else free)
            require_equations(model, data, self.method)
            weak = fit_weak_by_run(model, data)
            if self.method != "default":
                return weak
            return final_fit(weak, runs, validation or runs, loss=self.loss, progress=progress)
        if self.method in ("prediction-error", "instrumental"):
            return self._fit_gaussian_only(vehicle, runs, free, progress)
        return fit_output_error(
            vehicle, runs, free, self.horizon, constraints=self.constraints, loss=self.loss, progress=progress
        )

    def _fit_gaussian_only(
        self, vehicle: Vehicle, runs: Sequence[Run], free: Sequence[str] | None, progress: Progress
    ) -> Fitted:
        """Methods that have no other loss."""
        if self.loss != "gaussian":
            raise UndertowError(
                f"loss '{self.loss}' does not apply to --method {self.method}, which would mistake outliers "
                "for a disturbance: use output-error, or weak"
            )
        if self.method == "instrumental":
            return fit_instrumental(vehicle, runs, free, self.horizon, constraints=self.constraints)
        return fit_prediction_error(vehicle, runs, free, constraints=self.constraints, progress=progress)


@dataclass(frozen=True, repr=False)
class Refit:
    """A refitted model, evaluated on data that it was not fitted to.

    Attributes
    ----------
    stated : Vehicle
        The model as given.
    fit : Fitted
        The fit.
    estimator : Estimator
        How it was made.
    train, test : list of Run
        Logs that were fitted, and validation logs.
    before, after : Prediction
        Validation logs predicted by the model as given and as refitted.
    """

    stated: Vehicle
    fit: Fitted
    estimator: Estimator
    train: list[Run]
    test: list[Run]
    before: Prediction
    after: Prediction

    @property
    def errors(self) -> tuple[float, float]:
        """Velocity error ahead before and after, as a share of the motion."""
        return prediction_error(self.before), prediction_error(self.after)

    @cached_property
    def ahead(self) -> tuple[dict[str, float], dict[str, float]]:
        """Velocity errors over the vehicle's own horizons, before and after, as shares of the motion."""
        refitted, rest = in_runs(self.fit, self.test)
        as_given = [adapted(self.stated, run)[0] for run in self.test]
        lengths = [float(f"{h:.2g}") for h in horizons(self.stated, rest)]
        parts, names = [cut(rest, self.stated, h) for h in lengths], [f"{h:g} s" for h in lengths]
        before, after = (
            [prediction_error(predict_each(each, p)) for p in parts] for each in (as_given, refitted)
        )
        return dict(zip(names, before, strict=True)), dict(zip(names, after, strict=True))

    @property
    def vehicle(self) -> Vehicle:
        """The refitted model."""
        return self.fit.vehicle

    @property
    def parameters(self) -> pl.DataFrame:
        """One row a parameter, in the units and signs of the vehicle file.

        Columns: parameter, value, standard_error, bound (Cramér-Rao), unit, before, t (magnitude over
        standard error), identified (what these logs determine); null if the logs are uninformative.
        """
        import polars as pl  # whoever fits needs it; whoever reads --help does not

        t, verdicts_by_name, least = t_values(self.fit), verdicts(self.fit), cramer_rao(self.fit)
        found = estimates(self.fit, self.stated)
        return pl.DataFrame(
            {
                "parameter": [e.name for e in found],
                "value": [e.value for e in found],
                "standard_error": [e.standard_error for e in found],
                "bound": [least[e.name] if least[e.name] < UNDETERMINED else None for e in found],
                "unit": [e.unit for e in found],
                "before": [e.prior for e in found],
                "t": [t[e.name] for e in found],
                "identified": [verdicts_by_name[e.name] for e in found],
            },
            schema_overrides=dict.fromkeys(("standard_error", "bound", "before"), pl.Float64),
        )

    def result(self) -> FitResult:
        """The fit as it is written to JSON, with what it does to the error in a sentence."""
        before, after = (finite(error) for error in self.errors)
        return FitResult(
            vehicle=self.stated.name,
            command=self.command,
            method=self.estimator.method,
            runs=[run_info(run, role) for role, run in roles(self.train, self.test)],
            horizon=self.before.windows.horizon or 0.0,
            error_before=before,
            error_after=after,
            ahead_before={h: finite(e) for h, e in self.ahead[0].items()},
            ahead_after={h: finite(e) for h, e in self.ahead[1].items()},
            channels=channel_errors(self.before.relative, self.after.relative),
            parameters=[FittedParameter(**row) for row in self.parameters.iter_rows(named=True)],
            by_run=self.by_run,
            condition=finite(self.fit.condition),
            notes=notes(self.fit),
            remarks=self.remarks,
        )

    @property
    def remarks(self) -> dict[str, list[str]]:
        """Doubts about fitted values, by parameter: not identifiable, at a bound, far from the prior."""
        return {name: words for name, words in remarks(self.fit, self.stated).items() if words}

    @property
    def by_run(self) -> list[ValuesByRun]:
        """Parameters with a value in every run: these values, their mean and spread, in the file's signs."""
        return values_by_run(self.fit, self.stated)

    def summary(self) -> str:
        """Parameters with standard errors, and the error on validation data before and after, as text."""
        rows = self.parameters.iter_rows(named=True)
        lines = [f"{r['parameter']:16} {r['value']:.5g}{_spread(r)} {r['unit']}".rstrip() for r in rows]
        return "\n".join([self._headline, *lines, *map(str, self.by_run)])

    @property
    def _headline(self) -> str:
        before, after = self.errors
        ahead = self.before.windows.horizon
        return (
            f"{self.stated.name} by {self.estimator.method}: velocity error {ahead:.3g} s ahead on "
            f"validation data {before:.3%} of the motion as given, {after:.3%} refitted"
        )

    def plot(self) -> Figure:
        """The error of every velocity on validation data, as given and refitted, as a matplotlib figure."""
        from .report.pictures import before_and_after

        return before_and_after(self.before.relative, self.after.relative)

    def save(self, template: str | Path, out: Path) -> None:
        """Write the vehicle file with the fitted values, in the form of the one that it came from."""
        logs = roles(self.train, self.test)
        save_result(self.vehicle, template, out, self.command, logs, self.errors, uncertainty(self.fit))

    @property
    def command(self) -> str:
        """The command that does the same."""
        e = self.estimator
        parts = [f"undertow fit --method {e.method}", *([] if e.loss == "gaussian" else [f"--loss {e.loss}"])]
        parts += [] if e.horizon in (None, Estimator.horizon) else [f"--horizon {e.horizon:.9g}"]
        parts += [f'--equal "{text}"' for text in written_equalities(e.constraints.equal, self.stated)]
        return " ".join([*parts, *(["--dissipative"] if e.constraints.dissipative else [])])

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        table = self.parameters
        return html(self._headline, table.columns, table.iter_rows())


def _spread(row: Mapping[str, Any]) -> str:
    return "" if row["standard_error"] is None else f" ± {row['standard_error']:.2g}"


@of_stated_kinds
def read_log(
    path: str | Path | Sequence[str | Path],
    mapping: str | Path | LogMapping | None = None,
    *,
    vehicle: Vehicle | None = None,
    window: tuple[float | None, float | None] = (None, None),
    commands: Sequence[str] = (),
) -> Run:
    """Read a log: CSV, CSV.gz or Parquet, or as its vehicle wrote it.

    Parameters
    ----------
    path : path or sequence of paths
        The log; a folder or several paths are tables of one run, each on its own clock.
    mapping : path or Mapping, optional
        Meaning of the columns; without it they must have the channel names and SI units of undertow.
    vehicle : Vehicle, optional
        The vehicle that wrote the log: its commands must be in it, unless a rig holds motions, and
        revolutions of propellers are converted to the unit in which the vehicle counts them (rad/s without
        it).
    window : (t_min, t_max)
        Part of the log that is used, s.
    commands : sequence of str
        Names of commands that must be in the log; by default those of the vehicle, if one is given.

    Returns
    -------
    Run
        In SI, NED and forward-starboard-down axes; gaps are NaN.

    Raises
    ------
    UndertowError
        If a file cannot be read or is not a valid log or mapping.

    Examples
    --------
    >>> from pathlib import Path
    >>> import undertow as ut
    >>> demo = Path(ut.__file__).parent / "demo_data" / "auv"
    >>> run = ut.read_log(demo / "train_1.csv.gz", vehicle=ut.load_vehicle(demo / "vehicle.toml"))
    >>> run.t.shape
    (1200,)
    """
    meaning = read_mapping(mapping) if isinstance(mapping, str | Path) else mapping
    also: Sequence[str] = ()
    if vehicle is not None:
        meaning = meaning and in_vehicle_units(meaning, vehicle, f"log {path}")
        if meaning and meaning.held:  # by a rig: such a log needs no commands
            also = vehicle.command_names
        else:
            commands = commands or vehicle.command_names
    if isinstance(path, str | Path) and Path(path).is_file() and format_of(Path(path)) is None:
        parts = long_logs(Path(path), meaning, tuple(commands), window, required=True)
        if len(parts) == 1 and beyond_memory(parts):
            return read_in_parts(parts[0])
    return read(path, meaning, commands, window=window, also=also)


@one_thread()
@of_stated_kinds
def fit(
    vehicle: Vehicle,
    runs: Runs,
    validation: Runs = (),
    *,
    method: str = "default",
    horizon: float = 5.0,
    loss: LossName = "gaussian",
    equal: Sequence[str] = (),
    dissipative: bool = False,
    report: Progress = lambda done, words: None,
    trust_log: bool = False,
) -> Refit:
    """Refit the parameters that a vehicle marks as estimated, and judge them on validation data.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    runs, validation : Run or sequence of Run
        Logs to fit to and to validate on; without `validation`, parts of `runs` are set aside for it.
    method : str
        "default" (the weak form, then output error), "weak", "integral", "instrumental", "output_error" or
        "prediction_error".
    horizon : float
        Length of the simulated windows, s; the default method derives it from the vehicle's time constants.
    loss : str
        "gaussian"; "huber" or "student-t" resist outliers.
    equal : sequence of str
        Parameters that are tied to one another, or to a multiple: "M_q = 0.9 N_r".
    dissipative : bool
        Constrain linear damping to dissipate energy in every motion.
    report : callable
        Called with the fraction done, 0 to 1, and a description of the current step.
    trust_log : bool
        Use logs even if their channels contradict each other or the vehicle (wrong units).

    Returns
    -------
    Refit
        `summary()`, `parameters` (a data frame), `plot()`, `errors` on validation data, and `vehicle`.

    Raises
    ------
    UndertowError
        If there is no such method, nothing is to be estimated, or a log cannot be used.

    Examples
    --------
    >>> from pathlib import Path
    >>> import undertow as ut
    >>> demo = Path(ut.__file__).parent / "demo_data" / "auv"
    >>> vehicle = ut.load_vehicle(demo / "vehicle.toml")
    >>> run = ut.read_log(demo / "train_1.csv.gz", commands=vehicle.command_names)
    >>> fit = ut.fit(vehicle, [run])
    >>> fit.parameters.columns[:3]
    ['parameter', 'value', 'standard_error']
    """
    constraints = Constraints(read_equalities(equal, vehicle), dissipative)
    estimator = Estimator(_method(method), horizon, constraints, loss)
    vehicle, runs, validation = normalised(vehicle, runs, validation)
    required_free_parameters(vehicle)
    train, test = training_and_validation(vehicle, runs, validation, trust_log=trust_log)
    report(0.0, "fitting")
    # Whole logs have been looked at: what is left of them without the validation data need not be.
    found = estimator.fit(
        vehicle,
        train,
        progress=lambda done, words: report(0.8 * done, words),
        validation=test,
        trust_log=True,
    )
    report(0.8, "predicting validation data")
    refitted, rest = in_runs(found, test)
    windows = cut(rest, vehicle, possible_horizon(vehicle, rest, horizon))
    as_given = [adapted(vehicle, run)[0] for run in test]
    before, after = (predict_each(each, windows) for each in (as_given, refitted))
    return Refit(vehicle, found, estimator, train, test, before, after)


def _method(name: str) -> Method:
    methods: dict[str, Method] = {m.replace("-", "_"): m for m in get_args(Method)}
    if name.replace("-", "_") not in methods:
        raise UndertowError(f"method '{name}' is not known: choose one of {', '.join(methods)}")
    return methods[name.replace("-", "_")]


@of_stated_kinds
def add_effect(
    vehicle: Vehicle, effect: str | Sequence[str], runs: Runs, validation: Runs = (), *, force: bool = False
) -> Vehicle:
    """Add an effect to a model, or several, and refit the model.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    effect : str or sequence of str
        Id of an effect of the catalogue, or ids of several, in the order in which they are added.
    runs, validation : Run or sequence of Run
        Logs to fit to and to validate on; without `validation`, parts of `runs` are set aside for it.
    force : bool
        Add them even if this does not reduce the error on validation data.

    Returns
    -------
    Vehicle
        The refitted model with the effects.

    Raises
    ------
    UndertowError
        If there is no such effect, the model has it already, or the error is not reduced and `force` is not
        given.

    Examples
    --------
    >>> from pathlib import Path
    >>> import undertow as ut
    >>> demo = Path(ut.__file__).parent / "demo_data" / "auv"
    >>> vehicle = ut.load_vehicle(demo / "vehicle.toml")
    >>> run = ut.read_log(demo / "train_1.csv.gz", commands=vehicle.command_names)
    >>> better = ut.add_effect(vehicle, "ocean_current", [run])
    >>> "ocean_current" in [effect.id for effect in better.all_effects]
    True
    """
    done = try_effect(vehicle, effect, runs, validation)[1]
    if not (done.helps or force):
        raise UndertowError(
            f"adding {listed(done.effects)} does not lower the error on validation data "
            f"({done.before.error:.3g} without, {done.after.error:.3g} with): force=True adds it anyway"
        )
    return done.fit.vehicle


@one_thread()
def try_effect(
    vehicle: Vehicle,
    effect: str | Sequence[str],
    runs: Runs,
    validation: Runs = (),
    *,
    known: Catalogue | None = None,
    keep_all: bool = False,
    report: Progress = lambda done, words: None,
    trust_log: bool = False,
) -> tuple[AdditionSetup, Addition]:
    """Fit a model with and without effects; return the data used and the change in error.

    Parameters and exceptions are those of `add_effect`; `keep_all` keeps parameters that turn out to be zero.
    """
    effects = catalogue() if known is None else known
    wanted = [lookup(name, effects) for name in ([effect] if isinstance(effect, str) else effect)]
    if not wanted:
        raise UndertowError("no effect is named: give the id of one ('undertow effects' lists them)")
    report(0.0, "fitting the model as given")
    setup = set_up_addition(vehicle, runs, validation, trust_log=trust_log)
    report(0.3, f"fitting it with {listed([w.id for w in wanted])}")
    return setup, add_effects(wanted, setup, keep_all=keep_all)


def result_of(setup: AdditionSetup, addition: Addition) -> AdditionResult:
    """An addition as it is written to JSON."""
    runs = [run_info(run, role) for role, run in roles(setup.train, setup.test)]
    return addition_result(addition, setup.vehicle, runs)


def save_addition(setup: AdditionSetup, addition: Addition, template: str | Path, out: Path) -> None:
    """Write the vehicle file with effects that were added, in the form of the one that it came from."""
    save_result(
        addition.fit.vehicle,
        template,
        out,
        "undertow add",
        roles(setup.train, setup.test),
        (addition.before.error, addition.after.error),
        uncertainty(addition.fit),
        added=[*addition.effects],
        helps=addition.helps,
    )


@one_thread()
def plan(
    vehicle: Vehicle,
    runs: Sequence[Run],
    request: PlanRequest,
    *,
    only: Sequence[str] = (),
    between: Sequence[str] = (),
    diagnosis: Path | None = None,
    known: Catalogue | None = None,
    trust_log: bool = False,
) -> Planned:
    """Plan the manoeuvre that best determines parameters (`only` these), or tells models apart.

    The models are the vehicle with each of the effects in `between` (one alone against the model as it is),
    or those that the file of a `diagnosis` could not tell apart.
    """
    if runs:
        runs = with_velocities(vehicle, runs)
        check_fit(runs, (), vehicle)
    if not between and diagnosis is None:
        return plan_parameters(vehicle, runs, request, only, trust_log=trust_log)
    effects = catalogue() if known is None else known
    if diagnosis is not None:
        specs = specs_of(read_diagnosis(diagnosis, Diagnosed), vehicle, effects)
    else:
        specs = [RivalSpec(name, {}) for name in (between if len(between) > 1 else [*between, NONE])]
    return plan_separation(vehicle, specs, runs, request, known=effects, trust_log=trust_log)


def combine_fits(vehicle: Vehicle, fits: Sequence[Refit]) -> CombinedFits:
    """The whole vehicle from the fits of its experiments."""
    logs = [pair for one in fits for pair in roles(one.train, one.test)]
    return CombinedFits(vehicle, tuple(one.fit for one in fits), logs, [one.errors for one in fits])
