"""Prediction of logs over windows: from the measured start on, driven by the logged commands alone."""

from __future__ import annotations

from collections.abc import Sequence

from undertow.codegen.functions import Functions
from undertow.identification.logs import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .cutting import Windows, cut
from .prediction import Prediction, prediction_error
from .predictor import Predictor


def predict(
    model: Vehicle | Functions | Predictor,
    runs: Sequence[Run] | Windows,
    horizon: float | None = 5.0,
    *,
    p: Array | None = None,
    overlap: float = 0.0,
    compiled: bool | None = None,
) -> Prediction:
    """Predict logs window by window.

    Parameters
    ----------
    model : Vehicle, Functions or Predictor
        The model; a Predictor keeps its compiled code from one call to the next.
    runs : sequence of Run, or Windows
        Logs, or logs that are cut already (then horizon and overlap are theirs).
    horizon : float or None
        Length of a window in s; None: each stretch without gaps from its first sample to its end.
    p : (n_parameters,) array, optional
        Parameters; those of the vehicle by default.
    overlap : float
        Share of a window that the next one repeats.
    compiled : bool, optional
        As for `Simulator`.

    Raises
    ------
    UndertowError
        If a channel is missing, or no stretch without gaps is as long as the horizon.
    """
    predictor = model if isinstance(model, Predictor) else Predictor(model, compiled=compiled)
    vehicle = predictor.functions.vehicle
    windows = runs if isinstance(runs, Windows) else cut(runs, vehicle, horizon, overlap=overlap)
    return predictor.predict(windows, p)


__all__ = ["Prediction", "Predictor", "Windows", "cut", "predict", "prediction_error"]
