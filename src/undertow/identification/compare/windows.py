"""Prediction of logs over windows: from the measured start on, driven by the logged commands alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.identification.logs import Run
from undertow.model.vehicle import Vehicle

from ..weak.drive import Chain, Memory, shifted_mean
from ..weak.pointwise import Pointwise, mapped
from .cutting import Windows, cut

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Prediction:
    """What a model predicts over windows, beside what was measured.

    Attributes
    ----------
    windows : Windows
        The windows, with the measurement.
    predicted : (b, k, 2n) array
        Reported pose and velocity by the model; NaN in the padding and from where a simulation diverged.
    """

    windows: Windows
    predicted: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the 2n channels, pose then velocity."""
        return self.windows.names

    @cached_property
    def residual(self) -> Array:
        """Measured minus predicted, shape (b, k, 2n); NaN where there is nothing to compare."""
        return self.windows.measured - self.predicted

    @cached_property
    def diverged(self) -> int:
        """Number of windows in which the simulation diverged."""
        lost = ~np.isfinite(self.predicted).all(axis=2) & self.windows.inside
        return int(lost.any(axis=1).sum())

    @cached_property
    def rms(self) -> dict[str, float]:
        """Root mean square of the residual by channel, in its unit; inf if a window diverged."""
        return self._by_channel(np.inf if self.diverged else _rms(self.residual[:, 1:]))

    @cached_property
    def normalised(self) -> dict[str, float]:
        """`rms` over the noise of the channel: 1 is as good as can be."""
        noise = np.maximum(self.windows.sigma, 1e-300)
        pairs = zip(self.rms.items(), noise[self._there].tolist(), strict=True)
        return {name: rms / sigma for (name, rms), sigma in pairs}

    @cached_property
    def relative(self) -> dict[str, float]:
        """`rms` over the root mean square of the measurement, for the velocities: 0.05 is five per cent."""
        size = _rms(self.windows.measured[:, 1:])
        half = len(self.names) // 2
        sizes = dict(zip(self.names[half:], size[half:], strict=True))
        return {n: self.rms[n] / float(s) for n, s in sizes.items() if s > 0}

    @cached_property
    def fit(self) -> dict[str, float]:
        """Share of the variation that is predicted, by channel, %: 100 is perfect, 0 is as a mean."""
        centred = self.windows.measured[:, 1:].copy()
        for run in np.unique(self.windows.run):
            inside = self.windows.run == run
            centred[inside] -= _mean(centred[inside])
        size = self._by_channel(_rms(centred))
        return {n: 100.0 * (1.0 - self.rms[n] / s) for n, s in size.items() if s > 0}

    @cached_property
    def _there(self) -> NDArray[np.intp]:
        return np.flatnonzero(np.isfinite(self.windows.measured).any(axis=(0, 1)))

    def _by_channel(self, values: Array | float) -> dict[str, float]:
        table = np.broadcast_to(values, len(self.names))
        return {self.names[i]: float(table[i]) for i in self._there}


def prediction_error(prediction: Prediction) -> float:
    """One number: geometric mean over the degrees of freedom of the relative error of the velocities.

    0.05 is five per cent; the noise of the sensors is in it. `Prediction.relative` holds the parts.
    """
    parts = np.array(list(prediction.relative.values()))
    return float(np.exp(np.mean(np.log(np.maximum(parts, 1e-12))))) if len(parts) else float("nan")


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
    return predictor.predict(windows, predictor.values if p is None else p)


class Predictor:
    """Predicts windows with one model.

    Parameters
    ----------
    model : Vehicle or Functions
        The model.
    compiled : bool, optional
        As for `Simulator`.
    """

    def __init__(self, model: Vehicle | Functions, *, compiled: bool | None = None) -> None:
        self.functions = model if isinstance(model, Functions) else Functions(model)
        self.simulator = Simulator(self.functions, compiled=compiled)
        self._points = Pointwise(self.functions, ())
        self._chain = Chain(self.functions, ())
        self._memory = Memory(self.functions, (), self._points.measured, self._points.true_motion)

    @property
    def values(self) -> Array:
        """Parameters of the vehicle."""
        return np.array(self.functions.values(), dtype=float)

    def predict(self, windows: Windows, p: Array) -> Prediction:
        """Simulate every window from its measured start."""
        commands = self.commands(windows, p)
        u = gather(commands, windows)
        states = self.simulator.run(self.start(windows, commands, p), windows.t, u, p)
        return Prediction(windows, self.reports(windows, states, u, p))

    def commands(self, windows: Windows, p: Array) -> list[Array]:
        """Commands of every run as they arrive: held where missing, late by the dead time of the model."""
        held = [_held(run.matrix(windows.commands)) for run in windows.runs]
        delay = float(self._dead_time(p))
        if delay == 0.0:
            return held
        return [shifted_mean(run.t, u, delay) for run, u in zip(windows.runs, held, strict=True)]

    def start(self, windows: Windows, commands: list[Array], p: Array) -> Array:
        """States at the start of every window, shape (b, nx)."""
        f = self.functions
        count = len(windows)
        actuator = [self._chain.states(r.t, u, p) for r, u in zip(windows.runs, commands, strict=True)]
        own = np.zeros((count, f.memory.shape[0]))
        inputs = [
            windows.start,
            np.zeros((count, f.actuation.shape[0])),
            own,
            gather(commands, windows)[:, 0],
        ]
        (motion,) = mapped(self._true_motion, inputs, p, windows.t[:, 0])
        if own.size:
            own = self._remembered(windows, commands, p)
        first = [actuator[run][i] for run, i in zip(windows.run, windows.first, strict=True)]
        return np.column_stack([motion[:, :, 0], own, np.reshape(first, (count, -1))])

    def reports(self, windows: Windows, states: Array, u: Array, p: Array) -> Array:
        """What the sensors report of simulated states, shape (b, k, 2n); NaN in the padding."""
        if self.sensors_are_true:
            reported = states[:, :, : len(windows.names)].copy()
        else:
            columns = [a.reshape(-1, a.shape[2]) for a in (states, u)]
            (flat,) = mapped(self.functions.outputs, columns, p, windows.t.ravel())
            reported = flat.reshape(*windows.t.shape, -1)
        reported[~windows.inside] = np.nan
        return reported

    def _remembered(self, windows: Windows, commands: list[Array], p: Array) -> Array:
        """Memory at the start of every window, along the measured motion since the last gap."""
        own = np.zeros((len(windows), self.functions.memory.shape[0]))
        for key in {*zip(windows.run, windows.segment, strict=True)}:
            inside = np.flatnonzero((windows.run == key[0]) & (windows.segment == key[1]))
            last = int(windows.first[inside].max()) + 1
            if last - key[1] > 1:
                along = self._along(windows, commands, int(key[0]), slice(int(key[1]), last), p)
                own[inside] = along[windows.first[inside] - key[1]]
        return own

    def _along(self, windows: Windows, commands: list[Array], run: int, piece: slice, p: Array) -> Array:
        log = windows.runs[run]
        zero = np.zeros(len(log.t))
        measured = np.column_stack([log.channels.get(n, zero)[piece] for n in windows.names])
        actuation = self._chain.along(log.t, commands[run], p).value[piece]
        return self._memory.along(log.t[piece], measured, actuation, commands[run][piece], p).value

    @cached_property
    def _dead_time(self) -> ca.Function:
        f = self.functions
        return ca.Function("dead_time", [f.p], [f.convert(f.vehicle.composition.dead_time)])

    @cached_property
    def _true_motion(self) -> ca.Function:
        f, points = self.functions, self._points
        inputs = [points.measured, f.actuation, f.memory, f.u, f.p, f.t]
        return ca.Function("true_motion", inputs, [ca.densify(points.true_motion)])

    @cached_property
    def sensors_are_true(self) -> bool:
        """Whether the sensors report pose and velocity as they are."""
        motion = ca.vertcat(self.functions.eta, self.functions.nu)
        return bool(ca.is_equal(self.functions.reported, motion, 2))


def _held(u: Array) -> Array:
    """Commands with the last known value where one is missing; windows do not reach into such gaps."""
    known = np.where(np.isfinite(u), np.arange(len(u))[:, None], 0)
    filled = np.take_along_axis(u, np.maximum.accumulate(known, axis=0), axis=0)
    return np.nan_to_num(filled, nan=0.0)


def gather(commands: list[Array], windows: Windows) -> Array:
    """Commands of every window, shape (b, k, n_commands)."""
    samples = windows.samples
    return np.stack([commands[run][row] for run, row in zip(windows.run, samples, strict=True)])


def _mean(values: Array) -> Array:
    """Mean of each channel over what there is; NaN for a channel with nothing."""
    there = np.isfinite(values)
    count = there.sum(axis=(0, 1))
    total = np.sum(np.where(there, values, 0.0), axis=(0, 1))
    return np.divide(total, count, out=np.full(count.shape, np.nan), where=count > 0)


def _rms(values: Array) -> Array:
    return np.sqrt(_mean(values**2))


__all__ = ["Prediction", "Predictor", "Windows", "cut", "predict", "prediction_error"]
