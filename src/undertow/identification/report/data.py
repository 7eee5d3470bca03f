"""What a report shows beside the diagnosis: plain arrays and words, whoever worked them out."""

from __future__ import annotations

from dataclasses import dataclass, field

from undertow.identification.compare.comparison import Profile
from undertow.typing import Array


@dataclass(frozen=True)
class Trace:
    """One channel of one run, measured and simulated by two models; arrays of shape (n,).

    `given` is simulated by the model before any fit. NaN breaks a line, None leaves it out.
    """

    channel: str
    unit: str
    t: Array
    measured: Array
    before: Array
    after: Array | None = None
    given: Array | None = None


@dataclass(frozen=True)
class RunTraces:
    """All channels of one run; `how` says how they were simulated."""

    run: str
    traces: tuple[Trace, ...]
    how: str = ""


@dataclass(frozen=True)
class ErrorMap:
    """An error of two models by degree of freedom and regime, arrays of shape (n_rows, n_regimes).

    NaN where there are no data. `quantity` is what the numbers are, with their unit; `floor` what noise alone
    gives.
    """

    rows: tuple[str, ...]
    regimes: tuple[str, ...]
    before: Array
    after: Array | None = None
    quantity: str = "error / noise"
    floor: float | None = 1.0


@dataclass(frozen=True)
class ResidualCurve:
    """Mean residual force, in `unit`, of one degree of freedom in bins of one variable, by two models."""

    unit: str
    before: Profile
    after: Profile | None = None


@dataclass(frozen=True)
class Budget:
    """Root mean square of every effect's force in one degree of freedom, by effect id, in `unit`."""

    degree_of_freedom: str
    unit: str
    shares: dict[str, float]


@dataclass(frozen=True)
class Listing:
    """A table in words: first row of `head`, then `rows`; every number in it carries its unit."""

    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class ReportData:
    """Everything that a report draws of two models, `before` and `after`, on the validation runs.

    `headlines` say where the models fail most, `budgets` are those of the final model, `settings` and
    `versions` record how it was worked out.
    """

    before: str = "model as given"
    after: str = "with what is missing"
    headlines: tuple[str, ...] = ()
    maps: tuple[ErrorMap, ...] = ()
    runs: tuple[RunTraces, ...] = ()
    residuals: tuple[ResidualCurve, ...] = ()
    budgets: tuple[Budget, ...] = ()
    fits: Listing | None = None
    settings: dict[str, str] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)
