"""What `import undertow` gives of identification; the commands call the same functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import get_args

from undertow.errors import UndertowError
from undertow.files import write_whole
from undertow.model.catalogue import Catalogue, catalogue, lookup
from undertow.model.vehicle import Vehicle
from undertow.notebook import html
from undertow.typing import Progress

from .compare.comparison import compare
from .diagnosis.addition import add_effect as added
from .diagnosis.addition import lay_ground
from .diagnosis.diagnose import Outcome
from .diagnosis.diagnose import diagnose as diagnosed
from .diagnosis.trial import FALSE_ALARM_RATE
from .estimators import Estimator, Method
from .logs import Mapping, Run, read_mapping, velocities_from_pose
from .logs.reading import read_log as read
from .output_error.descent import LossName
from .refitting import Refit, refit
from .report.data import ReportData
from .weak.constraints import Constraints, read_equalities


class Diagnosed(Outcome):
    """A diagnosis with its models, ready to be read, shown in a notebook and written as a report."""

    @property
    def verdict(self) -> str:
        """adequate, missing_effect, indistinguishable, unexplained or not_identifiable."""
        return self.diagnosis.verdict

    @property
    def effects(self) -> list[str]:
        """Ids of the effects that are named; empty where none is."""
        return self.diagnosis.effects

    def report(self, out: str | Path) -> None:
        """Write the report: one HTML page with all pictures.

        Raises
        ------
        UndertowError
            If the file cannot be written.
        """
        write_whole(Path(out), _page(self))

    def __repr__(self) -> str:
        return f"{self.verdict}: {self.diagnosis.headline}"

    def _repr_html_(self) -> str:
        head = ("model", "error on validation data (1: noise of the sensors)")
        steps = enumerate(self.diagnosis.steps)
        rows = ((" and ".join(s.changes) or ("refitted" if i else "as given"), s.error) for i, s in steps)
        return html(repr(self), head, rows)


def read_log(
    path: str | Path,
    mapping: str | Path | Mapping | None = None,
    *,
    window: tuple[float | None, float | None] = (None, None),
    commands: Sequence[str] = (),
) -> Run:
    """Read a log: CSV, CSV.gz or Parquet.

    Parameters
    ----------
    path : path
        The log.
    mapping : path or Mapping, optional
        What the columns mean; without it they must have the channel names and SI units of undertow.
    window : (t_min, t_max)
        Part of the log that is used, s.
    commands : sequence of str
        Names of the commands of the vehicle; each must be in the log.

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
    >>> run = ut.read_log(demo / "train_1.csv.gz", commands=["f1", "f2", "f3", "f4"])
    >>> run.t.shape
    (1200,)
    """
    meaning = read_mapping(mapping) if isinstance(mapping, str | Path) else mapping
    return read(path, meaning, commands, window=window)


def fit(
    vehicle: Vehicle,
    runs: Sequence[Run],
    validation: Sequence[Run] = (),
    *,
    method: str = "weak",
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
    runs, validation : sequence of Run
        Logs to fit to and to judge by; without `validation`, parts of `runs` are left out of the fit.
    method : str
        "weak", "integral", "instrumental", "output_error" or "prediction_error".
    horizon : float
        Length of the simulated windows, s.
    loss : str
        "gaussian", or "huber" or "student-t" where there are outliers.
    equal : sequence of str
        Parameters that are fitted as one, or as a multiple: "M_q = 0.9 N_r".
    dissipative : bool
        Let linear damping take energy from every motion.
    report : callable
        Called with the share of the work that is done, 0 to 1, and with what is being done, in words.
    trust_log : bool
        Use logs even where their channels contradict each other or the vehicle (wrong units).

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
    logs, kept = _moving(vehicle, runs), _moving(vehicle, validation)
    return refit(vehicle, logs, kept, estimator, horizon, report, trust_log=trust_log)


def _method(name: str) -> Method:
    methods: dict[str, Method] = {m.replace("-", "_"): m for m in get_args(Method)}
    if name.replace("-", "_") not in methods:
        raise UndertowError(f"method '{name}' is not known: choose one of {', '.join(methods)}")
    return methods[name.replace("-", "_")]


def _moving(vehicle: Vehicle, runs: Sequence[Run]) -> list[Run]:
    """Logs with the velocities that they have a pose for only."""
    return [velocities_from_pose(run, vehicle.degrees_of_freedom) for run in runs]


def diagnose(
    vehicle: Vehicle,
    runs: Sequence[Run],
    validation: Sequence[Run] = (),
    *,
    known: Catalogue | None = None,
    report: Progress = lambda done, words: None,
    false_alarms: float = FALSE_ALARM_RATE,
    trust_log: bool = False,
) -> Diagnosed:
    """Find out which effect a model lacks, judged on validation data.

    Parameters
    ----------
    vehicle : Vehicle
        The model; parameters marked `estimate` are refitted.
    runs, validation : sequence of Run
        Logs to fit to and to judge by; without `validation`, parts of `runs` are left out of the fit.
    known : mapping, optional
        Effects that may be missing, by id; the whole catalogue by default.
    report : callable
        Called with the share of the work that is done, 0 to 1, and with what is being done, in words.
    false_alarms : float
        Chance of naming an effect where nothing is missing, 0.005 to 0.2.
    trust_log : bool
        Use logs even where their channels contradict each other or the vehicle (wrong units).

    Returns
    -------
    Diagnosed
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
    done = diagnosed(
        vehicle,
        _moving(vehicle, runs),
        _moving(vehicle, validation),
        known=known,
        report=report,
        false_alarms=false_alarms,
        trust_log=trust_log,
    )
    return Diagnosed(**{f.name: getattr(done, f.name) for f in fields(done)})


def add_effect(
    vehicle: Vehicle,
    effect: str,
    runs: Sequence[Run],
    validation: Sequence[Run] = (),
    *,
    force: bool = False,
) -> Vehicle:
    """Add an effect to a model and refit the model.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    effect : str
        Id of an effect of the catalogue.
    runs, validation : sequence of Run
        Logs to fit to and to judge by; without `validation`, parts of `runs` are left out of the fit.
    force : bool
        Add it even if it does not lower the error on validation data.

    Returns
    -------
    Vehicle
        The refitted model with the effect.

    Raises
    ------
    UndertowError
        If there is no such effect, the model has it already, or it does not help and `force` is not given.

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
    wanted = lookup(effect, catalogue())
    done = added(wanted, lay_ground(vehicle, _moving(vehicle, runs), _moving(vehicle, validation)))
    if not (done.helps or force):
        raise UndertowError(
            f"effect '{effect}' does not lower the error on validation data ({done.before.error:.3g} "
            f"without, {done.after.error:.3g} with it): force=True puts it in all the same"
        )
    return done.fit.vehicle


def _page(outcome: Outcome) -> str:
    """The report of a diagnosis as one HTML page."""
    from .report import render_report  # brings matplotlib, which only a report needs

    return render_report(outcome.diagnosis, _pictures_data(outcome))


def _pictures_data(outcome: Outcome) -> ReportData:
    """Comparison of the refitted model with the kept-aside runs, before and after."""
    from .report import report_data

    before = compare(outcome.before, outcome.test)
    added = outcome.diagnosis.last_step.changes
    after = compare(outcome.after, outcome.test) if added else None
    names = ("model refitted", " ".join(["with", " and ".join(added) or "nothing added"]))
    return report_data(before, after, names=names)
