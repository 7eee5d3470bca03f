"""The estimators behind one function: what is fitted by which of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Progress

from .doctor import refuse_impossible
from .fitted import Fitted
from .logs import Run
from .output_error import fit_output_error
from .output_error.descent import LossName
from .prediction_error import fit_prediction_error
from .weak.constraints import Constraints
from .weak.data import prepare
from .weak.fit import fit_weak, free_parameters
from .weak.instrumental import fit_instrumental
from .weak.solution import require_equations
from .weak.spikes import without_spikes
from .weak.testfunctions import boxes, test_functions

Method = Literal["weak", "integral", "instrumental", "output-error", "prediction-error"]
_FAMILIES = {"weak": test_functions, "integral": boxes}


@dataclass(frozen=True)
class Estimator:
    """How parameters are estimated.

    Attributes
    ----------
    method : str
        "weak", "integral" (the weak form with boxes for test functions), "instrumental" (the weak form with
        simulated regressors), "output-error" or "prediction-error" (output error with a disturbance).
    horizon : float or None
        Length of the windows that output error and instrumental variables simulate, s; None for whole
        stretches.
    constraints : Constraints
        What is asked of the parameters.
    loss : str
        "gaussian", or "huber" or "student-t" where there are outliers. Output error then weighs every sample
        by its error; the weak form, whose residuals are sums over many samples, leaves samples out that stand
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
        progress: Progress = lambda done, words: None,
        *,
        trust_log: bool = False,
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
        trust_log : bool
            Take logs as they are, also those that `undertow.identification.doctor.refuse_impossible` refuses.

        Raises
        ------
        UndertowError
            If a channel is missing, a log is too short or cannot be, constraints contradict each other, or
            the method has no such loss.
        """
        refuse_impossible(vehicle, runs, trust_log=trust_log)
        if self.method in _FAMILIES:
            data = prepare(runs, vehicle, family=_FAMILIES[self.method])
            data = data if self.loss == "gaussian" else without_spikes(data)
            model = self.constraints.model(vehicle, free_parameters(vehicle) if free is None else free)
            require_equations(model, data, self.method)
            return fit_weak(model, data)
        if self.method in ("prediction-error", "instrumental"):
            return self._by_squares(vehicle, runs, free, progress)
        return fit_output_error(
            vehicle,
            runs,
            free,
            self.horizon,
            constraints=self.constraints,
            loss=self.loss,
            progress=progress,
        )

    def _by_squares(
        self, vehicle: Vehicle, runs: Sequence[Run], free: Sequence[str] | None, progress: Progress
    ) -> Fitted:
        """Methods that have no other loss."""
        if self.loss != "gaussian":
            raise UndertowError(
                f"loss '{self.loss}' is none of --method {self.method}, which would take outliers for "
                "something else: use output-error, or weak"
            )
        if self.method == "instrumental":
            return fit_instrumental(vehicle, runs, free, self.horizon, constraints=self.constraints)
        return fit_prediction_error(vehicle, runs, free, constraints=self.constraints, progress=progress)
