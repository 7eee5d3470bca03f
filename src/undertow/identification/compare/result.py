"""What a comparison says, as it is written to JSON."""

from __future__ import annotations

from math import isfinite

from pydantic import BaseModel, ConfigDict

SCHEMA = "undertow/comparison/1"


class Table(BaseModel):
    """A table of the result; numbers that do not exist (a simulation that diverged) are null."""

    model_config = ConfigDict(extra="forbid")


class ComparedRun(Table):
    """A log and what was done with it."""

    name: str
    source: str
    sha256: str
    samples: int
    duration: float
    notes: list[str]


class ChannelResult(Table):
    """One measured channel: error of the prediction over the horizon and of the free run.

    `normalised` is the error over the noise, `relative` (velocities only) over the rms of the measurement,
    and `fit` the share in % of the variation that is predicted (NRMSE; 100 is perfect, below 0 is worse than
    a mean).
    """

    channel: str
    unit: str
    noise: float
    ahead_rms: float | None
    ahead_normalised: float | None
    ahead_relative: float | None
    free_run_rms: float | None
    free_run_fit: float | None


class DofResult(Table):
    """One degree of freedom: the force that the model lacks, N or N m.

    `explained_by_noise` is the share of its mean square that the noise of the channels accounts for,
    `normalised` its rms over that of the noise; `inputs` holds its correlation with every command.
    """

    degree_of_freedom: str
    unit: str
    residual_rms: float
    noise_rms: float
    explained_by_noise: float
    normalised: float | None
    autocorrelation: list[float]
    ljung_box: float
    p_value: float
    inputs: dict[str, float]


class Cell(Table):
    """One field of the error map; without numbers where there are too few samples."""

    degree_of_freedom: str
    group: str
    regime: str
    phrase: str
    samples: int
    residual_rms: float | None = None
    noise_rms: float | None = None
    explained_by_noise: float | None = None
    normalised: float | None = None


class BudgetShare(Table):
    """Part of one effect in the forces of one degree of freedom: rms along the logs, and share of all."""

    degree_of_freedom: str
    effect: str
    rms: float
    share: float


class ComparisonResult(Table):
    """Outcome of `undertow compare`."""

    schema_id: str = SCHEMA
    undertow: str
    vehicle: str
    degrees_of_freedom: list[str]
    runs: list[ComparedRun]
    horizon: float
    headline: str
    prediction_error: float | None
    windows: int
    diverged: int
    channels: list[ChannelResult]
    dofs: list[DofResult]
    cells: list[Cell]
    worst: Cell | None
    budget: list[BudgetShare]
    seconds: float


def finite(value: float | None) -> float | None:
    """The number, or None where it is none."""
    return float(value) if value is not None and isfinite(value) else None
