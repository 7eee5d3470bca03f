"""What the doctor says about logs, as it is written to JSON."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict

SCHEMA = "undertow/doctor/1"
Severity = Literal["mistake", "warning", "note"]
SEVERITIES: tuple[Severity, ...] = ("mistake", "warning", "note")


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Finding(_Table):
    """One thing that the logs show.

    Attributes
    ----------
    id : str
        What kind of thing; stable from version to version.
    severity : "mistake", "warning" or "note"
        A mistake spoils every result and is certain; a warning may; a note is good to know.
    text : str
        One line with the numbers.
    evidence : dict
        The numbers behind it, SI.
    mapping : str
        Lines for the mapping file that mend it, in TOML; empty where none can.
    vehicle : str
        What to change in the vehicle file to the same end; empty where nothing there can mend it.
    alternatives : list of str
        Other explanations that these logs do not exclude.
    """

    id: str
    severity: Severity
    text: str
    evidence: dict[str, float] = {}
    mapping: str = ""
    vehicle: str = ""
    alternatives: list[str] = []


class Excited(_Table):
    """What happened in one degree of freedom.

    Attributes
    ----------
    degree_of_freedom, velocity, unit : str
        Which one, the channel of its velocity, and the unit of that.
    rms, noise : float
        Of the velocity.
    moving : float
        Share of the time in which it stands out of its noise and exceeds a tenth of its usual largest value.
    positive : float
        Share of that time in the positive direction.
    reversals : int
        Changes of direction.
    command_range : float or None
        Span of the force that the commands ask for, over the largest that they could; None: no limit is known
        or nothing acts there.
    cannot : list of str
        What cannot be identified from it.
    """

    degree_of_freedom: str
    velocity: str
    unit: str
    rms: float
    noise: float
    moving: float
    positive: float
    reversals: int
    command_range: float | None
    cannot: list[str]


class Examination(_Table):
    """Outcome of `undertow doctor`.

    Attributes
    ----------
    findings : list of Finding
        The most serious first.
    excitation : list of Excited
        One for each degree of freedom of the vehicle.
    seconds : float
        Time that it took.
    """

    schema_id: str = SCHEMA
    undertow: str
    vehicle: str
    runs: list[str]
    findings: list[Finding]
    excitation: list[Excited]
    seconds: float

    @property
    def mistakes(self) -> list[Finding]:
        """The findings that are mistakes."""
        return [f for f in self.findings if f.severity == "mistake"]


def percent(share: float) -> str:
    """A share in percent, with two digits where that says something."""
    if share < 1e-4:
        return "< 0.01 %"
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def most_serious_first(findings: list[Finding]) -> list[Finding]:
    """Findings by severity; their order is kept otherwise."""
    return sorted(findings, key=lambda f: SEVERITIES.index(f.severity))
