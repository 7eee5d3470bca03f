"""Prediction error: multiple shooting in which the motion may leave the model a little, at every window."""

from .fit import PredictionErrorFit, fit_prediction_error

__all__ = ["PredictionErrorFit", "fit_prediction_error"]
