"""Findings in logs, and the segments used of long ones, as written to JSON."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class ResultTable(BaseModel):
    """A table of a result that is written to JSON, with null for missing numbers."""

    model_config = ConfigDict(extra="forbid")

    def to_json(self) -> str:
        """Text of a file with the result."""
        return self.model_dump_json(indent=1) + "\n"


# --- long logs ------------------------------------------------------------------------------------
Role = Literal["train", "holdout"]


class WholeLog(ResultTable):
    """A log as it was read, in parts."""

    name: str
    source: str
    sha256: str
    samples: int  # rows that were used
    seconds: float
    dropped: int  # rows left out because they were not later than an earlier one
    gaps: int  # steps longer than five usual ones
    longest_gap: float  # s
    missing: dict[str, float]  # share of the rows without a value, of channels that lack some
    # Whether it was used only for validation; of a single log, parts are.
    holdout: bool


class ChosenSegment(ResultTable):
    """A segment that was used; listed in the order of choice."""

    log: str
    start: float  # s
    end: float  # s
    samples: int  # after the log was decimated
    role: Role
    information_gain: float  # Increase of the logarithm of its determinant; zero if all segments were used
    motion: str  # The one whose equation gained most; empty if all segments were used


class ModelOnTheRest(ResultTable):
    """Errors of a model over the unused data; null if a prediction diverges."""

    model: str
    error: float | None  # error of the velocities, a share of the motion, geometric mean over the velocities
    channels: dict[str, float | None]
    diverged: int  # diverging windows, which are left out of the errors
    lowest: float | None  # lowest error of a piece of the rest
    highest: float | None  # highest error of a piece of the rest


class Rest(ResultTable):
    """The check on all the data that was not used."""

    seconds: float
    samples: int
    horizon: float  # how far ahead is predicted, s
    windows: int
    models: list[ModelOnTheRest]

    def sentence(self) -> str:
        """The errors in words."""
        errors = [f"{m.model} {_percent(m.error)}{_between(m)}" for m in self.models]
        return (
            f"checked on the rest, {_time(self.seconds)}: velocity error {self.horizon:.3g} s ahead, % of "
            f"the motion: {', '.join(errors)}"
        )


class LongLogs(ResultTable):
    """How long logs were decimated, and which segments of them were used."""

    logs: list[WholeLog]
    every: int  # number of rows averaged into one
    rate: float  # rows per second after decimation
    fastest: float | None  # time constants of the vehicle in these logs, s
    slowest: float | None
    stretches: int  # number of segments
    seconds: float  # length of a segment, s
    chosen: list[ChosenSegment]
    # Share of the information on the parameters in the chosen segments: ratio of the determinants to the
    # power of 1 / number of parameter directions.
    information_share: float
    information_share_by_motion: dict[str, float]
    rest: Rest | None = None

    @property
    def everything(self) -> bool:
        """Whether all segments were used."""
        return len(self.chosen) == self.stretches

    def sentences(self) -> list[str]:
        """What was done, in words."""
        lines = [self._decimated(), *([] if self.everything else [self._chosen()])]
        validation = [log.name for log in self.logs if log.holdout]
        own = self._of("holdout")
        if validation:
            lines.append(f"used only for validation: {', '.join(validation)}; {self._span(own)} of it used")
        elif own:
            lines.append(f"{self._span(own)} in addition, for validation")
        return lines + ([self.rest.sentence()] if self.rest else [])

    def _of(self, role: Role) -> list[ChosenSegment]:
        return [s for s in self.chosen if s.role == role]

    @staticmethod
    def _span(chosen: list[ChosenSegment]) -> str:
        return f"{len(chosen)} segments, {_time(sum(s.end - s.start for s in chosen))},"

    def _decimated(self) -> str:
        samples = sum(log.samples for log in self.logs)
        span = sum(log.seconds for log in self.logs)
        why = f"the fastest time constant is {self.fastest:.2g} s" if self.fastest else "no motion decays"
        done = f"decimated by {self.every}, to {self.rate:.3g} Hz, because {why}"
        return (
            f"{samples} samples, {_time(span)}; {done if self.every > 1 else 'not decimated, because ' + why}"
        )

    def _chosen(self) -> str:
        used = self._of("train")
        shares = self.information_share_by_motion
        least = min(shares, key=lambda n: shares[n])
        reasons = Counter(s.motion for s in used)
        tell = ", ".join(f"{motion} {count}" for motion, count in reasons.most_common())
        whole = sum(log.seconds for log in self.logs)
        return (
            f"{len(used)} of {self.stretches} segments of {self.seconds:.3g} s, "
            f"{_time(sum(s.end - s.start for s in used))} of {_time(whole)}, contain "
            f"{self.information_share:.0%} of the information on the parameters (least in {least}: "
            f"{shares[least]:.0%}); chosen for the information that they add, on {tell}"
        )


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _percent(share: float | None) -> str:
    return "diverged" if share is None else f"{100 * share:.3g}%"


def _between(model: ModelOnTheRest) -> str:
    if model.lowest is None or model.highest is None:
        return ""
    lost = f", {model.diverged} windows diverged" if model.diverged else ""
    return f" ({100 * model.lowest:.3g} to {100 * model.highest:.3g}%{lost})"


# --- what the doctor finds ------------------------------------------------------------------------
EXAMINATION_SCHEMA = "undertow/doctor/1"
Severity = Literal["mistake", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("mistake", "warning", "note")


class Finding(ResultTable):
    """One thing that the logs show."""

    id: str  # kind of finding; stable between versions
    # A mistake is certain and spoils every result; a warning may; a note is for information.
    severity: Severity
    text: str  # one line with the numbers
    evidence: dict[str, float] = Field(default_factory=dict)  # the numbers behind it, SI
    mapping: str = ""  # lines for the mapping file that correct it, in TOML; empty if none can
    # Alternative correction in the vehicle file; empty if there is none.
    vehicle: str = ""
    alternatives: list[str] = Field(default_factory=list)  # other explanations that these logs do not exclude

    def clause(self, runs: Iterable[str] = ()) -> str:
        """What is wrong, without the evidence and without the name of the run."""
        parts = [part for part in self.text.split(": ") if part not in runs]
        return parts[0].partition(":")[0]


class DofExcitation(ResultTable):
    """What happened in one degree of freedom."""

    # degree_of_freedom, velocity, unit: which one, the channel of its velocity, and the unit of that.
    degree_of_freedom: str
    velocity: str
    unit: str
    # rms, noise: of the velocity.
    rms: float
    noise: float
    # Share of the time in which it stands out of its noise and exceeds a tenth of its usual largest value.
    moving: float
    positive: float  # share of that time in the positive direction
    reversals: int  # changes of direction
    # Span of the force that the commands ask for, over the largest that they could; None: no limit is known
    # or nothing acts there.
    command_range: float | None
    cannot: list[str]  # what cannot be identified from it


class Examination(ResultTable):
    """Outcome of `undertow doctor`."""

    schema_id: str = EXAMINATION_SCHEMA
    undertow: str
    vehicle: str
    runs: list[str]
    findings: list[Finding]  # the most serious first
    excitation: list[DofExcitation]
    seconds: float
    # How logs were decimated that are longer than this takes, and which segments were used; null of others.
    long_logs: LongLogs | None = None

    @property
    def mistakes(self) -> list[Finding]:
        """The findings that are mistakes."""
        return [f for f in self.findings if f.severity == "mistake"]


def percent(share: float) -> str:
    """A share in percent, with two digits if they are meaningful."""
    if share < 1e-4:
        return "< 0.01%"
    return f"{share:.0%}" if share >= 0.1 else f"{100 * share:.2g}%"
