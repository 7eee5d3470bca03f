"""The estimators behind one function: what is fitted by which of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from undertow.model.vehicle import Vehicle

from .fitted import Fitted
from .logs import Run
from .output_error import fit_output_error
from .output_error.losses import LossName
from .weak.constraints import Constraints
from .weak.data import prepare
from .weak.fit import fit_weak
from .weak.spikes import without_spikes

Report = Callable[[float, str], None]
Method = Literal["weak", "output-error"]


@dataclass(frozen=True)
class Estimator:
    """How parameters are estimated.

    Attributes
    ----------
    method : str
        "weak" or "output-error".
    horizon : float or None
        Length of the windows that output error simulates, s; None for whole stretches.
    constraints : Constraints
        What is asked of the parameters.
    loss : str
        "gaussian", or "huber" or "student-t" where there are outliers. Output error then weighs every sample by
        its error; the weak form, whose residuals are sums over many samples, leaves samples out that stand
        more than five standard deviations off their neighbours.
    """

    method: Method = "weak"
    horizon: float | None = 5.0
    constraints: Constraints = field(default_factory=Constraints)
    loss: LossName = "gaussian"

    def fit(
        self,
        vehicle: Vehicle,
        runs: Sequence[Run],
        free: Sequence[str] | None = None,
        progress: Report = lambda done, words: None,
    ) -> Fitted:
        """Fit the free parameters of a vehicle, by default those that its file marks.

        Parameters
        ----------
        vehicle : Vehicle
            Model with starting values and priors.
        runs : sequence of Run
            Logs with the velocities and commands of the vehicle.
        free : sequence of str, optional
            Names of the parameters to fit.
        progress : callable
            Told what share is done, and what is being done.

        Raises
        ------
        UndertowError
            If a channel is missing, a log is too short, or constraints contradict each other.
        """
        if self.method == "weak":
            data = prepare(runs, vehicle)
            data = data if self.loss == "gaussian" else without_spikes(data)
            return fit_weak(vehicle, data, free, constraints=self.constraints)
        asked = {"constraints": self.constraints, "progress": progress}
        return fit_output_error(vehicle, runs, free, self.horizon, loss=self.loss, **asked)
