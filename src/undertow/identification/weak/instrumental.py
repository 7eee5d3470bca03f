"""Instrumental variables on the weak form: regressors of the simulated motion instead of the measured one.

A measured velocity brings its noise into the regressors. Products of that noise with itself do not average
out: least squares is drawn towards zero, and |u|u of a noisy u is too large by the variance of the noise.
Regressors of the motion that the model itself simulates know nothing of the noise; used as instruments they
leave the first bias out. The second, of the residual, is subtracted: the curvature of the equations tells it.

Simulated regressors as instruments: Janot, Vandanjon and Gautier, A Generic Instrumental Variable Approach
for Industrial Robot Identification, IEEE Transactions on Control Systems Technology 22 (2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..compare.cutting import Windows, cut
from ..compare.predictor import Predictor
from .constraints import Constraints
from .data import Segment, WeakData, prepare
from .disturbance import disturbed
from .fit import WeakFit, fit_weak, free_parameters
from .residual import Linearised, WeakModel, whitened
from .solution import require_equations
from .step import bounds_of, limited_step, prior_of

_MAX_ITERATIONS = 25
# Length of a step, in standard deviations, with which a search ends.
_ENOUGH = 1e-3
# Nodes of a three-point Gauss-Hermite rule, in standard deviations, and the weight of the outer ones.
_NODE, _WEIGHT = np.sqrt(3.0), 1.0 / 6.0
_PLAIN = Constraints()


def fit_instrumental(
    vehicle: Vehicle,
    runs: Sequence[Run],
    free: Sequence[str] | None = None,
    horizon: float | None = None,
    *,
    compiled: bool | None = None,
    constraints: Constraints = _PLAIN,
) -> WeakFit:
    """Fit the free parameters of a vehicle by the weak form with simulated regressors as instruments.

    Parameters
    ----------
    vehicle : Vehicle
        Model with starting values and priors.
    runs : sequence of Run
        Logs with the velocities and commands of the vehicle.
    free : sequence of str, optional
        Names of the parameters to fit; by default those that the vehicle marks with `estimate`.
    horizon : float or None
        Length of the windows that are simulated from the measured motion at their start, s; None: each
        stretch without gaps is one.
    compiled : bool, optional
        As for `Simulator`.
    constraints : Constraints
        What else is asked of the parameters.

    Raises
    ------
    UndertowError
        If a channel is missing, a log is too short, or the simulation diverges.
    """
    model = constraints.model(vehicle, free_parameters(vehicle) if free is None else free)
    data = prepare(runs, vehicle)
    require_equations(model, data, "instrumental")
    plain = fit_weak(model, data)
    return _Instruments(model, plain, cut(runs, vehicle, horizon), compiled).fit()


class _Instruments:
    """Solves J_s' W (r - e) = 0, J_s the regressor of the simulated motion, e the excess by noise."""

    def __init__(self, model: WeakModel, plain: WeakFit, windows: Windows, compiled: bool | None) -> None:
        self._model, self._plain, self._windows = model, plain, windows
        self._predictor = Predictor(model.functions, compiled=compiled)

    def fit(self) -> WeakFit:
        model, plain = self._model, self._plain
        p, places = plain.p.copy(), list(model.places)
        bounds, prior = bounds_of(model), prior_of(model)
        taken = 0
        while taken < _MAX_ITERATIONS:
            taken += 1
            at = self._at(p)
            step = limited_step(model, at, p, bounds, prior)
            p[places] = np.clip(p[places] + step, *bounds)
            if np.linalg.norm(at.J @ step) < _ENOUGH:
                break
        return replace(plain, p=p, at=self._at(p), iterations=taken)

    def _at(self, p: Array) -> Linearised:
        """Whitened residual of the measured motion less its excess, and the instruments."""
        data = self._plain.data
        simulated = self._simulated(p)
        # Weights by the measured motion would know of its noise as well.
        quiet = self._model.whitening(simulated, p)
        whitening = disturbed(quiet, self._plain.disturbance, simulated)
        smooth = self._model.linearise(simulated, p)
        excess = self._excess(simulated, [part.r for part in smooth], p)
        measured = self._model.linearise(data, p)
        parts = [
            replace(s, r=m.r - e, known=m.known) for s, m, e in zip(smooth, measured, excess, strict=True)
        ]
        return whitened(parts, whitening)

    def _simulated(self, p: Array) -> WeakData:
        """The data with the simulated motion for the measured one, where a window covers it."""
        windows, data = self._windows, self._plain.data
        reports = self._predictor.reports(windows, p)
        if not np.isfinite(reports[windows.inside]).all():
            raise UndertowError(
                "the simulation diverges with the values of the weak form: give a shorter horizon, or use "
                "--method weak"
            )
        motion = [np.full((len(run.t), len(data.names)), np.nan) for run in data.runs]
        for run, rows, inside, values in zip(
            windows.run, windows.samples, windows.inside, reports, strict=True
        ):
            motion[run][rows[inside]] = values[inside]
        return replace(data, segments=tuple(_replaced(s, motion[s.run]) for s in data.segments))

    def _excess(self, simulated: WeakData, smooth: list[Array], p: Array) -> list[Array]:
        """Mean of the residual over the noise of the channels, less the residual without noise."""
        found = [np.zeros(len(r)) for r in smooth]
        for channel in np.flatnonzero(self._plain.data.sigma > 0):
            for sign in (_NODE, -_NODE):
                moved = self._model.linearise(_shifted(simulated, int(channel), sign), p)
                for total, part, r in zip(found, moved, smooth, strict=True):
                    total += _WEIGHT * (part.r - r)
        return found


def _replaced(segment: Segment, motion: Array) -> Segment:
    own = motion[segment.samples]
    return replace(segment, measured=np.where(np.isfinite(own), own, segment.measured))


def _shifted(data: WeakData, channel: int, sigmas: float) -> WeakData:
    move = np.zeros(len(data.sigma))
    move[channel] = sigmas * data.sigma[channel]
    return replace(data, segments=tuple(replace(s, measured=s.measured + move) for s in data.segments))
