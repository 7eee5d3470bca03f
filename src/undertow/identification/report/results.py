"""Results of `undertow fit` and `undertow add`, as written to JSON."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, isfinite, log, log1p
from statistics import fmean
from typing import Literal

from pydantic import Field

from undertow.errors import listed
from undertow.identification.comparison import finite
from undertow.identification.diagnosis.addition import Addition
from undertow.identification.diagnosis.result import Estimate, RunInfo, Step, ValuesByRun
from undertow.identification.diagnosis.settings import DEFAULT
from undertow.identification.diagnosis.verdict import estimates
from undertow.identification.estimation.output_error import NO_WORSE
from undertow.identification.findings import LongLogs, ResultTable
from undertow.model.vehicle import Vehicle
from undertow.version import __version__

from .sentences import as_stated, both, changes, rises, step_changes, useless


class FittedParameter(ResultTable):
    """A parameter after the fit, in the units and signs of the vehicle file; null for what is not known."""

    parameter: str
    value: float
    standard_error: float | None
    bound: float | None  # the error that sensor noise alone would leave (Cramér-Rao)
    unit: str
    before: float | None
    t: float  # magnitude over the standard error
    identified: str  # what the logs determine of it


class ChannelError(ResultTable):
    """Error of a predicted velocity as a share of its motion; null if the prediction diverges."""

    velocity: str
    before: float | None  # with the model as given
    after: float | None  # with the refitted model


class FitResult(ResultTable):
    """Outcome of `undertow fit`: errors of predicted velocities on the validation data, as shares."""

    schema_id: Literal["undertow/fit/1"] = "undertow/fit/1"
    undertow: str = __version__
    vehicle: str
    command: str
    method: str
    runs: list[RunInfo]
    horizon: float  # s
    error_before: float | None  # `horizon` s ahead, with the model as given; null if it diverges
    error_after: float | None  # the same with the refitted model
    ahead_before: dict[str, float | None]  # by the vehicle's own horizons, as given
    ahead_after: dict[str, float | None]  # the same, refitted
    channels: list[ChannelError]  # by velocity, `horizon` s ahead
    parameters: list[FittedParameter]
    by_run: list[ValuesByRun] = Field(default_factory=list)
    condition: float | None
    # What determined the values where the data do not.
    notes: list[str] = Field(default_factory=list)
    # Doubts about values, by parameter: not identifiable, at a bound, far from the prior.
    remarks: dict[str, list[str]] = Field(default_factory=dict)
    # How long logs were decimated and which segments were used; null for logs that fit as a whole.
    long_logs: LongLogs | None = None

    @property
    def worse(self) -> bool:
        """Whether the refitted model predicts worse, on average over the horizons and in digits shown."""
        pairs = [(before, self.ahead_after[h]) for h, before in self.ahead_before.items()]
        columns = zip(*pairs, strict=True)
        before, after = (fmean(log(inf if e is None else max(e, 1e-12)) for e in c) for c in columns)
        visible = any(rises(*pair) for pair in pairs)
        return visible and (before < after - log1p(NO_WORSE) or (isfinite(before) and not isfinite(after)))

    def sentence(self) -> str:
        """How the fit changes the error, worded by the numbers."""
        known = ({h: e for h, e in a.items() if e is not None} for a in (self.ahead_before, self.ahead_after))
        before, after = known
        change = f"Refitting {changes(before, after) or 'changes nothing'} on the validation data."
        return f"{change} {useless({c.velocity: c.after for c in self.channels})}".strip()


def channel_errors(before: Mapping[str, float], after: Mapping[str, float]) -> list[ChannelError]:
    """Errors of every velocity before and after a fit."""
    return [ChannelError(velocity=n, before=finite(before[n]), after=finite(after[n])) for n in before]


class AdditionResult(ResultTable):
    """Outcome of `undertow add`."""

    schema_id: Literal["undertow/addition/1"] = "undertow/addition/1"
    undertow: str = __version__
    vehicle: str
    effect: str  # id of the effect, or ids with commas between them
    effects: list[str]  # ids in the order in which they were added
    helps: bool
    sentence: str
    runs: list[RunInfo]
    steps: list[Step]  # the model as given, refitted without the effects, and with them
    fall: float  # mean fall of the mean square over the blocks of the validation data
    interval: tuple[float | None, float | None]  # of 95%, of the fall
    p_value: float  # chance of so consistent a fall where the effects do nothing
    parameters: list[Estimate]
    dropped: list[str]
    # How long logs were decimated and which segments were used; null for logs that fit as a whole.
    long_logs: LongLogs | None = None


def addition_result(addition: Addition, stated: Vehicle, runs: list[RunInfo]) -> AdditionResult:
    """Additions to a vehicle, as they are written to JSON."""
    low, high = addition.evidence.interval
    return AdditionResult(
        vehicle=stated.name,
        effect=",".join(addition.effects),
        effects=[*addition.effects],
        helps=addition.helps,
        sentence=addition_sentence(addition),
        runs=runs,
        steps=addition.steps,
        fall=addition.evidence.mean,
        interval=(finite(low), finite(high)),
        p_value=addition.evidence.p_value,
        parameters=estimates(addition.fit, stated),
        dropped=list(addition.dropped),
    )


def addition_sentence(addition: Addition) -> str:
    """How effects and the file's own values change the error, and whether the model is useful."""
    stated = as_stated(addition.given, addition.after, f"refitted with {listed(addition.effects)}")
    return f"{_change(addition)} {stated} {useless(addition.after.channels)}".strip()


def _change(addition: Addition) -> str:
    ahead = step_changes(addition.before, addition.after)
    change = f"Adding {listed(addition.effects)} {ahead or 'changes no prediction'} on the validation data"
    if addition.helps:
        return f"{change}."
    before, after = addition.ahead
    verb = "rises" if rises(before, after) else "falls" if rises(after, before) else ""
    first, last = both(before, after)
    moves = f"{verb} from {first} to" if verb else "stays at"
    errors = f"over all horizons together the error {moves} {last}%"
    if rises(before, after):
        return f"{change}; {errors}, so it does not improve predictions enough to be added."
    old, new = addition.before.error, addition.after.error
    force = "falls, which may be chance" if new < old else "does not fall"
    return (
        f"{change}; {errors}, and it has to fall by {DEFAULT.worth:.0%}; the error of "
        f"the force {force} ({old:.4g} to {new:.4g} times the noise)."
    )
