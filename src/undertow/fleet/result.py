"""What a fleet's logs said, as plain data."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from .verdicts import Statement


@dataclass(frozen=True)
class Parameter:
    """A parameter over some days.

    Attributes
    ----------
    value, error : float or None
        Estimate and standard error, SI, in the sign convention of the vehicle's file; None where the days do
        not determine it.
    """

    name: str
    unit: str
    value: float | None
    error: float | None


@dataclass(frozen=True)
class Shift:
    """How much something changed against the first month, or over all days.

    Attributes
    ----------
    of : str
        "drag in surge", "thrust of f1" ...
    percent, error : float or None
        Change and standard error, %; None where the days do not determine it.
    p_value : float
        Chance of so much by the scatter of the days, before what many tests ask for.
    """

    of: str
    percent: float | None
    error: float | None
    p_value: float


@dataclass(frozen=True)
class Period:
    """A month of one vehicle, or all its days.

    Attributes
    ----------
    name : str
        Month, or "all".
    days, samples : int
        How many.
    seconds : float
        Time that the logs cover, s.
    misfit : float
        Root mean square of what the parameters of these days leave, in units of what was counted as noise.
    parameters : tuple of Parameter
        Estimates.
    changes : tuple of Shift
        Against the first month; over all days for "all".
    statement : Statement, optional
        What is said of the changes; None for the first month.
    """

    name: str
    days: int
    samples: int
    seconds: float
    misfit: float
    parameters: tuple[Parameter, ...]
    changes: tuple[Shift, ...]
    statement: Statement | None


@dataclass(frozen=True)
class Score:
    """What one linear step of an effect that the model lacks would take off what the model leaves.

    Attributes
    ----------
    effect : str
        Id.
    share : float
        Share of the squares.
    p_value : float
        Chance of its most certain parameter by the scatter of the days, times the number of parameters that
        were looked at.
    """

    effect: str
    share: float
    p_value: float


@dataclass(frozen=True)
class Of:
    """All that is said of one vehicle.

    Attributes
    ----------
    vehicle : str
        Name.
    whole : Period
        All its days.
    months : tuple of Period
        Its months.
    scores : tuple of Score
        What its model lacks, the best first.
    remarks : tuple of str
        What speaks against the numbers.
    """

    vehicle: str
    whole: Period
    months: tuple[Period, ...]
    scores: tuple[Score, ...]
    remarks: tuple[str, ...]


@dataclass(frozen=True)
class Fleet:
    """The report of a fleet.

    Attributes
    ----------
    vehicles : tuple of Of
        By name.
    failed : dict of str
        Files that nothing is known of, and why.
    twins : dict of str
        Files that were left out because another one has the same content, and that one.
    done, found : int
        Partitions that the report stands on, and that there are.
    worked : int
        Partitions that were worked out in this run; the others were known.
    unscored : tuple of str
        Effects that one linear step says nothing of.
    """

    vehicles: tuple[Of, ...]
    failed: dict[str, str] = field(default_factory=dict)
    twins: dict[str, str] = field(default_factory=dict)
    done: int = 0
    found: int = 0
    worked: int = 0
    unscored: tuple[str, ...] = ()

    @property
    def whole(self) -> bool:
        """Whether nothing is missing."""
        return not self.failed

    def plain(self) -> dict[str, Any]:
        """As JSON takes it."""
        return asdict(self)
