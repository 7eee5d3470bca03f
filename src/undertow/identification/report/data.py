"""What a report shows beside the diagnosis: plain arrays and words, whoever worked them out."""

from __future__ import annotations

from dataclasses import dataclass, field

from undertow.typing import Array


@dataclass(frozen=True)
class Trace:
    """One channel of one run, measured and simulated.

    Attributes
    ----------
    channel, unit : str
        Name and unit of the channel.
    t : (n,) array
        Time, s.
    measured, before, after : (n,) array
        The measurement and the simulations by the two models; NaN breaks the line, None leaves it out.
    """

    channel: str
    unit: str
    t: Array
    measured: Array
    before: Array
    after: Array | None = None


@dataclass(frozen=True)
class RunTraces:
    """All channels of one run; `how` says how they were simulated."""

    run: str
    traces: tuple[Trace, ...]
    how: str = ""


@dataclass(frozen=True)
class ErrorMap:
    """An error by degree of freedom and regime.

    Attributes
    ----------
    rows : tuple of str
        Degrees of freedom.
    regimes : tuple of str
        Columns; a regime may have a unit in its name ("0.2 to 0.4 m/s").
    before, after : (n_rows, n_regimes) array
        The error by both models; NaN where there are no data.
    quantity : str
        What the numbers are, with their unit.
    floor : float, optional
        Value that noise alone gives.
    """

    rows: tuple[str, ...]
    regimes: tuple[str, ...]
    before: Array
    after: Array | None = None
    quantity: str = "error / noise"
    floor: float | None = 1.0


@dataclass(frozen=True)
class ResidualCurve:
    """Mean residual force of one degree of freedom in bins of one variable.

    Attributes
    ----------
    degree_of_freedom, unit : str
        What the force acts on, and its unit (N or N m).
    variable, variable_unit : str
        What it is plotted against.
    centre : (m,) array
        Middle of the bins.
    before, after : (m,) array
        Mean residual in each bin by both models.
    before_error, after_error : (m,) array
        Half the 95 % interval of the mean.
    """

    degree_of_freedom: str
    unit: str
    variable: str
    variable_unit: str
    centre: Array
    before: Array
    before_error: Array
    after: Array | None = None
    after_error: Array | None = None


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
    """Everything that a report draws.

    Attributes
    ----------
    before, after : str
        What the two models are called ("model as given", "with ocean_current").
    headlines : tuple of str
        Where the models fail most, one sentence each.
    maps : tuple of ErrorMap
        Error maps.
    runs : tuple of RunTraces
        Kept-aside runs, the most telling first.
    residuals : tuple of ResidualCurve
        Residual force against the variables.
    budgets : tuple of Budget
        Force budgets of the final model.
    fits : Listing, optional
        Fit and prediction error by channel.
    settings, versions : mapping
        What the diagnosis was told, and the programs that worked it out.
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
