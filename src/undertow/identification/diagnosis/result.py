"""The result of a diagnosis, as it is written to JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError, field_validator

from undertow.errors import UndertowError
from undertow.files import json_ready, read_json
from undertow.identification.findings import Finding, LongLogs, ResultTable
from undertow.identification.logs.run import Run

SCHEMA = "undertow/diagnosis/1"
Verdict = Literal[
    "adequate", "missing_effect", "indistinguishable", "helps_prediction", "unexplained", "not_identifiable"
]
Content = TypeVar("Content", bound=BaseModel)
Role = Literal["train", "holdout", "blocks"]

#: What is said if the residual exceeds the noise and nothing was found.
NO_EVIDENCE = (
    "Unexplained: the residual of the refitted model exceeds the sensor noise, and the validation data do "
    "not support any effect in the catalogue."
)


class RunInfo(ResultTable):
    """A log and its role."""

    name: str  # name of the run
    source: str  # path of the file
    sha256: str  # of the file
    role: Role  # fitted (train), a validation run (holdout), or validated on blocks of it (blocks)
    samples: int
    duration: float  # s
    notes: list[str]  # what the reader did with the log


def run_info(run: Run, role: Role) -> RunInfo:
    """The entry of a run in the result."""
    return RunInfo(
        name=run.name,
        source=run.source,
        sha256=run.sha256,
        role=role,
        samples=len(run.t),
        duration=float(run.t[-1] - run.t[0]),
        notes=[*run.notes, *run.reader_notes],
    )


class Estimate(ResultTable):
    """A parameter after the fit, in the sign convention of the vehicle file."""

    name: str  # of the parameter
    effect: str  # effect that the parameter belongs to
    value: float
    standard_error: float | None  # null if the logs do not determine the parameter
    unit: str
    about: str  # meaning of the parameter
    prior: float | None = None  # value stated in the vehicle file
    prior_sigma: float | None = None  # its stated standard deviation

    def __str__(self) -> str:
        error = "" if self.standard_error is None else f" ± {self.standard_error:.1g}"
        return f"{self.name} = {self.value:.4g}{error} {self.unit}".rstrip()


class ValuesByRun(ResultTable):
    """A parameter with a value in every run, in the sign convention of the vehicle file."""

    parameter: str
    unit: str
    values: dict[str, float]  # by run
    standard_errors: dict[str, float]  # by run
    mean: float  # weighted by the precision of each run
    spread: float  # standard deviation between the runs, beyond their errors
    q: float  # Cochran's Q
    chance: float  # probability of so large a Q if all runs agree

    def __str__(self) -> str:
        shown = (f"{v:.3g} ± {self.standard_errors[run]:.1g} in {run}" for run, v in self.values.items())
        summary = f"mean {self.mean:.3g}, spread {self.spread:.2g} {self.unit}".rstrip()
        return f"{self.parameter}: {', '.join(shown)}; {summary}; chance if all agree {self.chance:.1g}"


class Ranked(ResultTable):
    """A candidate effect, and how adding it changes the error on validation data.

    Significance is tested with a noise model that includes a disturbance; the errors are multiples of the
    sensor noise alone. `sure` combines both.
    """

    effect: str
    family: str  # group in the catalogue
    about: str  # meaning of the effect
    parameters: list[Estimate]  # fitted values
    error_before: float  # normalised error without the effect (1 is the noise floor)
    error_after: float  # normalised error with it
    explained: float  # share of the excess over the noise floor that it removes
    improvement: float  # mean fall of the mean square over the blocks of the validation data
    interval: tuple[float, float]  # 95% interval of `improvement`
    significant: bool  # whether it helps by more than chance
    # Probability that the best of all candidates looks as good when nothing is missing; null for idle
    # candidates.
    p_value: float | None = None
    # Share of resamples of the blocks in which this candidate is the best; null for idle candidates.
    inclusion: float | None = None
    not_named: str = ""  # why a significant candidate is not named
    # Relative fall of the prediction error by horizon, for candidates that were simulated; if given, it
    # decides the order.
    falls: dict[str, float] = Field(default_factory=dict)

    @property
    def sure(self) -> str:
        """ "yes" or "no", or "in part" if the effect is significant but the error does not fall."""
        return "no" if not self.significant else "yes" if self.error_after < self.error_before else IN_PART

    @property
    def share_of_error(self) -> float:
        """Share of the excess over the noise floor that is removed, by the errors alone."""
        return share_of_excess(self.error_before, self.error_after)


def share_of_excess(before: float, after: float) -> float:
    """Share of the excess over the noise floor that is removed, from errors in units of the noise."""
    return (before**2 - after**2) / max(before**2 - 1.0, 1e-12)


IN_PART = "in part"
IN_PART_MEANS = (
    f"{IN_PART[0].upper()}{IN_PART[1:]}: significant with a disturbance in the noise model, but with all "
    "equations weighted equally the error does not fall."
)
EXPLAINS_MEANS = (
    "Explains: mean over the equations above the noise, with a disturbance in the noise model of the best "
    "candidate; the error weights all equations equally, by the sensor noise alone, and may tell otherwise."
)
NO_MEANS = (
    "No, in spite of a small chance: with the noise model of the best candidate the error does not fall, or "
    "predictions need none of them."
)
_SAME_SHARE = 0.1  # difference up to which two shares tell the same


def explanations(shown: Sequence[Ranked], false_alarms: float) -> list[str]:
    """What columns mean that contradict each other in some row of a table of candidates."""
    otherwise = any(abs(r.explained - max(r.share_of_error, 0.0)) > _SAME_SHARE for r in shown)
    small = any(not r.significant and r.p_value is not None and r.p_value < false_alarms for r in shown)
    meanings = {
        IN_PART_MEANS: any(r.sure == IN_PART for r in shown),
        EXPLAINS_MEANS: otherwise,
        NO_MEANS: small,
    }
    return [words for words, needed in meanings.items() if needed]


class Step(ResultTable):
    """The model with one more effect, on validation data."""

    added: list[str]  # effects added to the model
    error: float  # error of the weak form, normalised (1 is the noise floor)
    prediction: float | None = None  # error of velocities 5 s ahead, as a share of their rms
    # the same for each velocity; null if it diverges
    channels: dict[str, float | None] = Field(default_factory=dict)
    # error of simulated windows of 5 s with estimated initial states, as a multiple of the noise
    simulation: float | None = None
    # as `prediction`, by horizon, and over the whole run
    ahead: dict[str, float] = Field(default_factory=dict)
    position: dict[str, float] = Field(default_factory=dict)  # error of the position by horizon, m
    # parameters fixed in the vehicle file that were fitted here
    freed: list[str] = Field(default_factory=list)

    @field_validator("ahead", "position", mode="before")
    @classmethod
    def _without_diverging(cls, errors: Mapping[str, float]) -> dict[str, float]:
        return {horizon: error for horizon, error in errors.items() if math.isfinite(error)}

    @property
    def changes(self) -> list[str]:
        """Changes of the model relative to the given one, in words."""
        return [*(["other values"] if self.freed else []), *self.added]


class Indistinguishable(ResultTable):
    """Effects that these data cannot tell apart."""

    effects: list[str]
    reason: str  # why
    separated_by: str = ""  # manoeuvre that would tell them apart
    separable: bool | None = None  # whether a run is known that would; null if none was looked for


def established(effects: Iterable[str], sets: Iterable[Indistinguishable]) -> list[str]:
    """The named effects that no other effect could replace."""
    alike = {e for s in sets for e in s.effects}
    return [e for e in effects if e not in alike]


class Equivalent(ResultTable):
    """Parameters that moved far from their stated values, and effects that would explain the data as well."""

    parameters: list[str]
    effects: list[str]
    reason: str  # why
    separated_by: str = ""  # what would tell the explanations apart


class Dependence(ResultTable):
    """A term that a residual force correlates with: an association, not a cause."""

    term: str
    columns: list[list[str]]  # factors of the product, one list for each coefficient
    coefficients: list[float]
    standard_errors: list[float]
    units: list[str]  # of the coefficients
    # share of the excess over sensor noise on validation data that the term removes, of what other values of
    # the model's parameters leave
    share: float
    chance: float  # probability that the best of all terms does as much when the residual depends on none
    alike: list[str]  # terms that these data hardly tell from it


class Spectrum(ResultTable):
    """A period that stands out in a residual force."""

    period: float  # s
    amplitude: float  # N or N m
    share: float  # share of the excess over noise
    chance: float  # probability of so high a line in noise
    in_step: bool  # whether its phase is the same in every run


class Trend(ResultTable):
    """Change of a coefficient of a residual force with time."""

    of: str  # what changes
    change: float  # in 100 s of a run
    unit: str
    share: float  # share of the excess over noise


class BetweenRuns(ResultTable):
    """A residual force that differs from run to run."""

    of: str  # what differs
    values: dict[str, list[float]]  # coefficients by run
    unit: str
    chance: float  # probability of so large a difference if all runs agree


class Predictability(ResultTable):
    """How much of a residual force a flexible function of the logged signals predicts on validation data.

    Shares are shares of the mean square.
    """

    degree_of_freedom: str
    unit: str
    averaged_over: float  # time over which the force is averaged, s
    residual_rms: float  # rms of the averaged force, N or N m
    share: float  # predicted share, beyond what other values of the model's parameters would predict
    # 95% interval of `share`, from blocks of the validation data; it ends no lower than the least share that
    # the training data could show
    interval: tuple[float, float]
    significant: bool  # whether `share` is significant and large enough to report
    noise_share: float  # share of sensor noise
    disturbance_rms: float  # rms of what nothing explains
    relative_to_inertia: float  # mean square of the residual over that of inertia times acceleration
    # Signals that the prediction needs, largest first: part of the residual lost without each.
    variables: dict[str, float]

    @property
    def at_most(self) -> float:
        """Share that may be predictable: the upper end of the interval, or the share predicted, if larger."""
        reached = 1.0 - self.noise_share - (self.disturbance_rms / max(self.residual_rms, 1e-300)) ** 2
        return max(self.interval[1], reached)


class ChannelNoise(ResultTable):
    """Noise of a measured channel."""

    channel: str
    unit: str
    sigma: float  # standard deviation
    stated: bool  # whether it is stated in the mapping file; otherwise estimated
    # frequency above which the channel was filtered before logging, Hz; its noise is then unknown
    cut_off: float | None = None


class DisturbanceLevel(ResultTable):
    """Residual of one force above sensor noise."""

    degree_of_freedom: str
    unit: str
    rms: float  # N or N m
    # of first-order noise with the same autocorrelation, s; null if sensor noise explains the residual
    correlation_time: float | None
    stated: float | None = None  # expected rms, if stated in the mapping file


class Floors(ResultTable):
    """Sensor noise and disturbance."""

    sensors: list[ChannelNoise]
    disturbances: list[DisturbanceLevel]


class Remaining(ResultTable):
    """Residual of the final model in one degree of freedom on validation data."""

    degree_of_freedom: str
    normalised_error: float  # multiple of the noise
    residual_rms: float  # rms of the residual force, averaged under the test functions
    noise_rms: float  # rms of its noise
    unit: str
    note: str
    excess_rms: float = 0.0  # rms beyond the noise, averaged over as long as it takes to see it
    depends_on: list[Dependence] = Field(default_factory=list)
    spectrum: Spectrum | None = None
    trend: Trend | None = None
    between_runs: list[BetweenRuns] = Field(default_factory=list)
    summary: str = ""  # all of this in one sentence


class AddedEffect(ResultTable):
    """An effect that was added if the residual exceeds the noise."""

    effect: str
    # Relative fall, by horizon, of the error of predicted velocities (for an effect of the sensors, of
    # velocities and pose).
    falls: dict[str, float]
    doubt: str  # why the effect is not established as the cause; empty if it is


class Diagnosis(ResultTable):
    """Outcome of `undertow diagnose`."""

    schema_id: str = SCHEMA
    undertow: str  # version
    vehicle: str
    degrees_of_freedom: list[str]
    signs: str  # sign convention of the vehicle file
    runs: list[RunInfo]
    verdict: Verdict
    headline: str  # the verdict in words
    command: str = ""  # what to run next, with the same files
    effects: list[str]  # effects that are named
    # effects that lower the error of predictions without being established as the cause
    helps: list[str] = Field(default_factory=list)
    added: list[AddedEffect] = Field(default_factory=list)  # gain and doubts of each effect that was added
    ranking: list[Ranked]  # all candidates: those that were chosen as they were found, then the others
    steps: list[Step]  # errors as effects are added
    indistinguishable: list[Indistinguishable]  # sets that these data cannot tell apart
    equivalent: list[Equivalent] = Field(default_factory=list)
    warnings: list[str]
    doctor: list[Finding] = Field(default_factory=list)  # findings of the doctor
    remaining: list[Remaining]  # residual forces of the final model
    parameters: list[Estimate]  # of the final model
    by_run: list[ValuesByRun] = Field(default_factory=list)  # parameters with a value in every run
    false_alarm_rate: float
    noise: dict[str, float]  # standard deviation by channel, SI
    floors: Floors | None = None
    predictable: list[Predictability] = Field(default_factory=list)
    seconds: float  # time that the diagnosis took
    # How long logs were decimated and which segments were used; null for logs that fit as a whole.
    long_logs: LongLogs | None = None

    @property
    def freed(self) -> list[str]:
        """Values that the vehicle file holds fixed and that were also fitted."""
        return self.steps[-1].freed if self.steps else []

    @property
    def stopped_at_zero(self) -> list[str]:
        """Fitted damping and inertia, stated otherwise, that are zero: beyond it they would be unphysical."""
        return [p.name for p in self.parameters if p.value == 0.0 and p.prior]

    @property
    def last_step(self) -> Step:
        """The final model: with the named effects, or with none of those tried."""
        return [s for s in self.steps if set(s.added) <= set(self.effects)][-1]


def read_diagnosis(path: Path, kind: type[Content]) -> Content:
    """Read what `undertow diagnose --json` wrote: a `Diagnosis`, or the part of it that `kind` describes."""
    try:
        found = kind.model_validate_json(read_json(path, "diagnosis"))
        content = found.model_dump(mode="json")
        if content["schema_id"] != SCHEMA:
            why = f"its schema is '{content['schema_id']}', not '{SCHEMA}'"
        elif content == json_ready(content):
            return found
        else:
            why = "a number in it is infinite or missing"
    except ValidationError as error:
        first = error.errors()[0]
        why = ": ".join(filter(None, (".".join(map(str, first["loc"])), first["msg"])))
    raise UndertowError(
        f"'{path}' is not a diagnosis ({why}): give the file that 'undertow diagnose --json FILE' wrote"
    )
