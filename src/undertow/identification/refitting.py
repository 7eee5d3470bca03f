"""Refitting the parameters of a vehicle, and the error on kept-aside data before and after."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.notebook import html
from undertow.typing import Progress

from .compare.windows import Prediction, cut, predict, prediction_error
from .diagnosis.estimates import estimates
from .diagnosis.excitation import check_excitation
from .diagnosis.split import keep_blocks_aside
from .doctor import refuse_impossible
from .estimators import Estimator
from .fitted import Fitted, cramer_rao, t_values, verdicts
from .logs import Run
from .weak.data import channel_noise
from .weak.estimated import NOTHING_SAID
from .weak.fit import free_parameters

if TYPE_CHECKING:
    import polars as pl
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Refit:
    """A refitted model, judged on data that it was not fitted to.

    Attributes
    ----------
    stated : Vehicle
        The model as given.
    fit : Fitted
        The fit.
    estimator : Estimator
        How it was made.
    train, test : list of Run
        Logs that were fitted, and logs kept aside.
    before, after : Prediction
        Kept-aside logs predicted by the model as given and as refitted.
    """

    stated: Vehicle
    fit: Fitted
    estimator: Estimator
    train: list[Run]
    test: list[Run]
    before: Prediction
    after: Prediction

    @property
    def errors(self) -> tuple[float, float]:
        """Velocity error ahead before and after, as a share of the motion."""
        return prediction_error(self.before), prediction_error(self.after)

    @property
    def vehicle(self) -> Vehicle:
        """The refitted model."""
        return self.fit.vehicle

    @property
    def parameters(self) -> pl.DataFrame:
        """One row a parameter, in the units and signs of the vehicle file.

        Columns: parameter, value, standard_error, bound (Cramér-Rao), unit, before, t (magnitude over
        standard error), identified (what these logs determine); null where the logs say nothing.
        """
        import polars as pl  # whoever fits needs it; whoever reads --help does not

        t, said, least = t_values(self.fit), verdicts(self.fit), cramer_rao(self.fit)
        found = estimates(self.fit, self.stated)
        return pl.DataFrame(
            {
                "parameter": [e.name for e in found],
                "value": [e.value for e in found],
                "standard_error": [e.standard_error for e in found],
                "bound": [least[e.name] if least[e.name] < NOTHING_SAID else None for e in found],
                "unit": [e.unit for e in found],
                "before": [e.prior for e in found],
                "t": [t[e.name] for e in found],
                "identified": [said[e.name] for e in found],
            },
            schema_overrides=dict.fromkeys(("standard_error", "bound", "before"), pl.Float64),
        )

    def summary(self) -> str:
        """Parameters with standard errors, and the error on validation data before and after, as text."""
        rows = self.parameters.iter_rows(named=True)
        lines = [f"{r['parameter']:16} {r['value']:.5g}{_spread(r)} {r['unit']}".rstrip() for r in rows]
        return "\n".join([self._headline, *lines])

    @property
    def _headline(self) -> str:
        before, after = self.errors
        ahead = self.before.windows.horizon
        return (
            f"{self.stated.name} by {self.estimator.method}: velocity error {ahead:.3g} s ahead on "
            f"validation data {before:.3%} of the motion as given, {after:.3%} refitted"
        )

    def plot(self) -> Figure:
        """The error of every velocity on validation data, as given and refitted, as a matplotlib figure."""
        from .report.pictures import before_and_after

        return before_and_after(self.before.relative, self.after.relative)

    def __repr__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        table = self.parameters
        return html(self._headline, table.columns, table.iter_rows())


def _spread(row: Mapping[str, Any]) -> str:
    return "" if row["standard_error"] is None else f" ± {row['standard_error']:.2g}"


def refit(
    vehicle: Vehicle,
    runs: Sequence[Run],
    holdout: Sequence[Run],
    estimator: Estimator,
    horizon: float,
    tell: Progress = lambda done, words: None,
    *,
    trust_log: bool = False,
) -> Refit:
    """Fit what the vehicle marks as estimated; without kept-aside logs, stretches of the logs are kept aside.

    Raises
    ------
    UndertowError
        If nothing is to be estimated, a channel is missing, a log is too short, or nothing moves.
    """
    if not free_parameters(vehicle):
        raise UndertowError(
            f"no parameter of '{vehicle.name}' is to be estimated: write, for instance, "
            "X_u = { value = ..., estimate = true }"
        )
    refuse_impossible(vehicle, [*runs, *holdout], trust_log=trust_log)
    train, test = (list(runs), list(holdout)) if holdout else keep_blocks_aside(runs)
    check_excitation(vehicle, train, channel_noise(train, (*vehicle.pose_names, *vehicle.velocity_names)))
    tell(0.0, "fitting")
    # Whole logs have been looked at: what is left of them after some was kept aside need not be.
    fit = estimator.fit(vehicle, train, progress=lambda done, words: tell(0.8 * done, words), trust_log=True)
    tell(0.8, "predicting kept-aside data")
    longest = max(float(r.t[-1] - r.t[0]) for r in test)
    windows = cut(test, vehicle, min(horizon, 0.9 * longest))
    before, after = (predict(v, windows) for v in (vehicle, fit.vehicle))
    return Refit(vehicle, fit, estimator, train, test, before, after)
