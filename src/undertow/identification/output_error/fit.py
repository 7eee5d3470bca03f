"""Fitting parameters to simulations of many windows, with the start of each estimated, too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from ..compare.cutting import cut
from ..weak.constraints import Constraints
from ..weak.data import prepare
from ..weak.fit import fit_weak, free_parameters
from ..weak.residual import WeakModel
from ..weak.step import bounds_of, physical
from .descent import LOSSES, Descent, LossName, OutputErrorFit

HORIZON = 5.0
_PLAIN = Constraints()


def fit_output_error(
    vehicle: Vehicle,
    runs: Sequence[Run],
    free: Sequence[str] | None = None,
    horizon: float | None = HORIZON,
    *,
    start: Mapping[str, float] | None = None,
    compiled: bool | None = None,
    constraints: Constraints = _PLAIN,
    loss: LossName = "gaussian",
    progress: Progress = lambda done, words: None,
) -> OutputErrorFit:
    """Fit the free parameters of a vehicle to several logs at once by the error of their simulation.

    The logs are cut into windows. The parameters are shared, and the true motion at the start of every window
    is estimated with them. Channels are weighted by their noise, and by what the model leaves beyond it.

    Parameters
    ----------
    vehicle : Vehicle
        Model with priors.
    runs : sequence of Run
        Logs with the velocities and commands of the vehicle; velocities that were derived from a pose take no
        part, the pose itself does.
    free : sequence of str, optional
        Names of the parameters to fit; by default those that the vehicle marks with `estimate`.
    horizon : float or None
        Length of a window in s; None: each stretch without gaps is one.
    start : mapping, optional
        Starting values; by default those of a weak-form fit.
    compiled : bool, optional
        As for `Simulator`.
    constraints : Constraints
        What else is asked of the parameters.
    loss : str
        "gaussian" squares every error; "huber" and "student-t" let no outlier pull without limit, by weights
        for each sample, worked out anew until they settle.
    progress : callable
        Told what share is done, and what is being done.

    Raises
    ------
    UndertowError
        If a channel is missing, no stretch is as long as the horizon, or the simulation diverges.
    """
    names = free_parameters(vehicle) if free is None else tuple(free)
    progress(0.0, "weak-form fit")
    model = constraints.model(vehicle, names)
    p = started(model, weak_start(model, runs) if start is None else start)
    windows = cut(runs, vehicle, horizon)
    descent = Descent(model, windows, compiled, progress)
    return descent.fit(p) if loss == "gaussian" else descent.fit_robust(p, LOSSES[loss])


def weak_start(model: WeakModel, runs: Sequence[Run]) -> dict[str, float]:
    """Values that a weak-form fit gives the free parameters; none where the runs are too short for one."""
    try:
        data = prepare(runs, model.functions.vehicle)
    except UndertowError:  # too short for test functions; the values of the file have to do
        return {}
    return fit_weak(model, data).values


def started(model: WeakModel, start: Mapping[str, float]) -> Array:
    """All parameters at the start of a search: the vehicle's, some replaced, made physical."""
    p = np.array(model.functions.values(), dtype=float)
    for name, value in start.items():
        p[model.functions.parameter_names.index(name)] = value
    places, bounds = list(model.places), bounds_of(model)
    p[places] = np.clip(p[places], *bounds)
    return physical(model, p, bounds)
