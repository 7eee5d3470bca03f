"""Refitting the parameters of a vehicle, and the error on kept-aside data before and after."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle

from .compare.windows import Prediction, cut, predict, prediction_error
from .diagnosis.excitation import check_excitation
from .diagnosis.split import keep_blocks_aside
from .doctor import refuse_impossible
from .estimators import Estimator, Report
from .fitted import Fitted
from .logs import Run
from .weak.data import channel_noise
from .weak.fit import free_parameters


@dataclass(frozen=True)
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


def refit(
    vehicle: Vehicle,
    runs: Sequence[Run],
    holdout: Sequence[Run],
    estimator: Estimator,
    horizon: float,
    tell: Report = lambda done, words: None,
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
