"""What a diagnosis says, as it is written to JSON."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError, field_validator

from undertow.errors import UndertowError
from undertow.files import json_ready, read_json
from undertow.identification.doctor.findings import Finding
from undertow.identification.logs.run import Run
from undertow.identification.long_logs.result import LongLogs, ResultTable

SCHEMA = "undertow/diagnosis/1"
Verdict = Literal[
    "adequate",
    "missing_effect",
    "indistinguishable",
    "helps_prediction",
    "unexplained",
    "not_identifiable",
]
Content = TypeVar("Content", bound=BaseModel)
Role = Literal["train", "holdout", "blocks"]


class RunInfo(ResultTable):
    """A log and what was done with it."""

    name: str
    source: str
    sha256: str
    role: Role
    samples: int
    duration: float
    notes: list[str]


def run_info(run: Run, role: Role) -> RunInfo:
    """What is written of a run."""
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

    name: str
    effect: str
    value: float
    standard_error: float | None
    unit: str
    about: str
    prior: float | None = None
    prior_sigma: float | None = None


class ValuesByRun(ResultTable):
    """A parameter with a value in every run, in the sign convention of the vehicle file.

    `mean` is weighted by how well each run knows it; `spread` is the standard deviation between the runs
    beyond the errors; `chance` is that of so large a difference (Cochran's `q`) if all runs agree.
    """

    parameter: str
    unit: str
    values: dict[str, float]
    standard_errors: dict[str, float]
    mean: float
    spread: float
    q: float
    chance: float

    def __str__(self) -> str:
        shown = (f"{v:.3g} ± {self.standard_errors[run]:.1g} in {run}" for run, v in self.values.items())
        summary = f"mean {self.mean:.3g}, spread {self.spread:.2g} {self.unit}".rstrip()
        return f"{self.parameter}: {', '.join(shown)}; {summary}; chance if all agree {self.chance:.1g}"


class Ranked(ResultTable):
    """A candidate: what it would add and what that does to the error on validation data.

    `error_before` and `error_after` are normalised (1 is the noise floor); `explained` is the share of what
    exceeds the floor that goes away; `improvement` is the mean fall of the mean square over the blocks of the
    validation data with its 95 % interval. `p_value` is the chance that the best of all candidates looks as
    good when nothing is missing; `inclusion` how often this one is the best when the blocks of the logs are
    drawn anew. Both are absent for candidates that do not help.

    Whether a candidate helps by more than chance is judged under a noise model with room for what the best
    model leaves; the errors are in units of the noise of the sensors alone. `sure` puts both together.
    `not_named` says why a candidate beyond chance is not named. `falls`, of candidates that were simulated,
    is the fall of the error of prediction by horizon, as a share of it; where it is given, it decides the
    order.
    """

    effect: str
    family: str
    about: str
    parameters: list[Estimate]
    error_before: float
    error_after: float
    explained: float
    improvement: float
    interval: tuple[float, float]
    significant: bool
    p_value: float | None = None
    inclusion: float | None = None
    not_named: str = ""
    falls: dict[str, float] = Field(default_factory=dict)

    @property
    def sure(self) -> str:
        """How sure it is that the candidate helps, see `how_sure`."""
        return how_sure(self.significant, self.error_before, self.error_after)


IN_PART = "in part"
IN_PART_MEANS = (
    f"{IN_PART[0].upper()}{IN_PART[1:]}: more than chance where a disturbance is allowed for, while the "
    "error, in which all equations count alike, does not fall."
)


def how_sure(significant: bool, before: float, after: float) -> str:
    """ "yes" or "no", or "in part" where an effect helps by more than chance and the error does not fall."""
    return "no" if not significant else "yes" if after < before else IN_PART


class Step(ResultTable):
    """The model with one more effect, on validation data.

    `error` is that of the weak form, normalised (1 is the noise floor); `simulation` that of simulated
    windows of 5 s whose starts are estimated, in units of the noise; `prediction` the error of velocities 5 s
    ahead in shares of their rms, `channels` that of each (None: it diverges), and `ahead` the same as
    `prediction` over several horizons and over the whole run; `position` is that of the position, in m.
    `freed` are values that the vehicle file holds fixed, fitted here with the rest.
    """

    added: list[str]
    error: float
    prediction: float | None = None
    channels: dict[str, float | None] = Field(default_factory=dict)
    simulation: float | None = None
    ahead: dict[str, float] = Field(default_factory=dict)
    position: dict[str, float] = Field(default_factory=dict)
    freed: list[str] = Field(default_factory=list)

    @field_validator("ahead", "position", mode="before")
    @classmethod
    def _without_diverging(cls, errors: Mapping[str, float]) -> dict[str, float]:
        return {horizon: error for horizon, error in errors.items() if math.isfinite(error)}

    @property
    def changes(self) -> list[str]:
        """What the model has beside what was given, in words."""
        return [*(["other values"] if self.freed else []), *self.added]


class Indistinguishable(ResultTable):
    """Effects that these data cannot tell apart, why, and which manoeuvre would.

    `separable` says whether a run is known that would; null where none was looked for.
    """

    effects: list[str]
    reason: str
    separated_by: str = ""
    separable: bool | None = None


class Equivalent(ResultTable):
    """Parameters that moved far from what was stated, effects that would do the same, and why that is so.

    `separated_by` says what would tell the explanations apart.
    """

    parameters: list[str]
    effects: list[str]
    reason: str
    separated_by: str = ""


class Dependence(ResultTable):
    """A term that a residual force correlates with: an association, not a cause.

    `columns` are the factors that are multiplied, one list for each coefficient; `share` is the share of what
    exceeds the noise of the sensors on validation data that goes away with the term; `chance` is how often
    the best of all terms does as much when the residual has nothing to do with any; `alike` are terms that
    these data hardly tell from it.
    """

    term: str
    columns: list[list[str]]
    coefficients: list[float]
    standard_errors: list[float]
    units: list[str]
    share: float
    chance: float
    alike: list[str]


class Spectrum(ResultTable):
    """A period (s) that stands out of a residual force; `in_step` if its phase is the same in every run."""

    period: float
    amplitude: float
    share: float
    chance: float
    in_step: bool


class Trend(ResultTable):
    """How much the coefficient of a residual force changes in 100 s of a run; `of` says of what."""

    of: str
    change: float
    unit: str
    share: float


class BetweenRuns(ResultTable):
    """A residual force that differs from run to run: its coefficients by run."""

    of: str
    values: dict[str, list[float]]
    unit: str
    chance: float


class Predictability(ResultTable):
    """How much of a residual force a flexible function of the logged signals predicts on validation data.

    Shares are of `residual_rms`, squared: the force averaged over `averaged_over` s, N or N m. `share` is
    what is predicted beyond what other values of the model's parameters would predict, with its 95 % interval
    from blocks of the validation data; `something` says whether that is more than chance and worth a name.
    `noise_share` is that of the noise of the sensors, `disturbance_rms` what nothing explains. `of_motion` is
    the residual's mean square over that of inertia times acceleration. `variables` are the signals that the
    prediction needs: the part of the residual that is lost without each of them, the largest first.
    """

    degree_of_freedom: str
    unit: str
    averaged_over: float
    residual_rms: float
    share: float
    interval: tuple[float, float]
    something: bool
    noise_share: float
    disturbance_rms: float
    of_motion: float
    variables: dict[str, float]

    @property
    def at_most(self) -> float:
        """Share that may be predictable: the end of the interval, or all that anything predicted if more."""
        reached = 1.0 - self.noise_share - (self.disturbance_rms / max(self.residual_rms, 1e-300)) ** 2
        return max(self.interval[1], reached)


class ChannelNoise(ResultTable):
    """Noise of a measured channel: standard deviation, in its unit, as estimated or as `stated`.

    `cut_off` is the frequency, Hz, above which the channel was filtered before it was logged; its noise is
    then unknown.
    """

    channel: str
    unit: str
    sigma: float
    stated: bool
    cut_off: float | None = None


class DisturbanceLevel(ResultTable):
    """What a model leaves in one force beyond the noise of the sensors, N or N m rms.

    `correlation_time` (s) is that of first-order noise with the same autocorrelation, None where the noise of
    the sensors explains what is left; `stated` is what the mapping file says is to be expected.
    """

    degree_of_freedom: str
    unit: str
    rms: float
    correlation_time: float | None
    stated: float | None = None


class Floors(ResultTable):
    """Noise of the sensors and disturbance of the motion, apart."""

    sensors: list[ChannelNoise]
    disturbances: list[DisturbanceLevel]


class Remaining(ResultTable):
    """What the final model leaves in one degree of freedom on validation data.

    `residual_rms` and `noise_rms` are those of the force averaged under the test functions, `excess_rms` is
    what is left beyond the noise, averaged over as long as it takes to see it; `summary` says all of it in a
    sentence.
    """

    degree_of_freedom: str
    normalised_error: float
    residual_rms: float
    noise_rms: float
    unit: str
    note: str
    excess_rms: float = 0.0
    depends_on: list[Dependence] = Field(default_factory=list)
    spectrum: Spectrum | None = None
    trend: Trend | None = None
    between_runs: list[BetweenRuns] = Field(default_factory=list)
    summary: str = ""


class AddedEffect(ResultTable):
    """An effect that was added where more than noise is left.

    `falls` is the fall of the error of predicted velocities by horizon, as a share of it, of an effect of the
    sensors that of velocities and pose; `doubt` says why the effect is not established as the cause, and is
    empty where it is.
    """

    effect: str
    falls: dict[str, float]
    doubt: str


class Diagnosis(ResultTable):
    """Outcome of `undertow diagnose`.

    `effects` are those that are named, `helps` those that lower the error of predictions without being
    established as the cause; `added` says of both what they are worth. `command` is what to run next, with
    the files that were given.
    """

    schema_id: str = SCHEMA
    undertow: str
    vehicle: str
    degrees_of_freedom: list[str]
    signs: str
    runs: list[RunInfo]
    verdict: Verdict
    headline: str
    command: str = ""
    effects: list[str]
    helps: list[str] = Field(default_factory=list)
    added: list[AddedEffect] = Field(default_factory=list)
    ranking: list[Ranked]
    steps: list[Step]
    indistinguishable: list[Indistinguishable]
    equivalent: list[Equivalent] = Field(default_factory=list)
    warnings: list[str]
    doctor: list[Finding] = Field(default_factory=list)
    remaining: list[Remaining]
    parameters: list[Estimate]
    by_run: list[ValuesByRun] = Field(default_factory=list)
    false_alarm_rate: float
    noise: dict[str, float]
    floors: Floors | None = None
    predictable: list[Predictability] = Field(default_factory=list)
    seconds: float
    # How logs were thinned that are longer than this takes, and which stretches were used; null of others.
    long_logs: LongLogs | None = None

    @property
    def freed(self) -> list[str]:
        """Values that the vehicle file holds fixed and that were fitted with the rest."""
        return self.steps[-1].freed if self.steps else []

    @property
    def last_step(self) -> Step:
        """The model as it is handed on: with the effects that are named, or with none of those tried."""
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
            why = "a number in it is infinite or none"
    except ValidationError as error:
        first = error.errors()[0]
        why = ": ".join(filter(None, (".".join(map(str, first["loc"])), first["msg"])))
    raise UndertowError(
        f"'{path}' is not a diagnosis ({why}): give the file that 'undertow diagnose --json FILE' wrote"
    )
