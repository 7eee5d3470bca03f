"""Candidate terms for other methods: the catalogue as columns of a regression on smoothed signals.

The regression is that of the acceleration on terms in the state and the commands. Regressing forces on
measured accelerations would do worse: their noise draws inertia, and with it all else, towards zero.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from undertow.codegen.functions import Functions
from undertow.identification.diagnosis.candidates import Candidate, candidates
from undertow.identification.estimation.weak_form import free_parameters
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.effect import kinds_of
from undertow.model.vehicle import Vehicle

Array = NDArray[np.float64]
#: Savitzky-Golay window (s) and order.
WINDOW, ORDER = 1.0, 3
#: One smoothed sample in so many is kept: they are not independent.
EVERY = 4
_EDGE = 1.0  # s that are left out at both ends of a run
_NOTHING = 1e-9
_STEPS = 3


@dataclass(frozen=True)
class Terms:
    """The regression that all other methods face: y = base @ a + columns @ b, one row per sample and motion.

    columns: (m, k), candidate terms, without the part that the parameters of the model can make up for.
    y: (m,), what the model leaves, without that part, too; every motion in units of its own rms.
    aside_columns, aside_y: the same on validation data, with the coefficients of the fit.
    effect: effect that each column belongs to.
    base: number of parameters of the model.
    """

    columns: Array
    y: Array
    aside_columns: Array
    aside_y: Array
    effect: tuple[str, ...]
    base: int

    @property
    def effects(self) -> list[str]:
        """The candidates that can be expressed."""
        return list(dict.fromkeys(self.effect))

    def of(self, effects: Sequence[str]) -> list[int]:
        """Places of the columns of some effects."""
        return [i for i, e in enumerate(self.effect) if e in effects]

    def aside(self, coefficients: Array) -> float:
        """Mean square that is left on the validation data."""
        return float(np.mean((self.aside_y - self.aside_columns @ coefficients) ** 2))


def make_terms(vehicle: Vehicle, train: Sequence[Run], test: Sequence[Run]) -> Terms:
    """Smooth the logs, differentiate, and evaluate every candidate that is linear in its parameters."""
    usable = [c for c in candidates(vehicle, catalogue()) if _expressible(c)]
    full, owner = _with_all(vehicle, usable)
    regression = _Regression(full, free_parameters(vehicle), list(owner))
    regression.settle(train)
    fit, aside = regression.on(train), regression.on(test)
    scale = np.sqrt(np.mean(fit.y.reshape(-1, regression.size) ** 2, axis=0)) + 1e-12
    fit, aside = fit.over(scale), aside.over(scale)
    # Frisch-Waugh-Lovell: regressing on the rest of the base is regressing with the base.
    own, *_ = np.linalg.lstsq(fit.base, np.column_stack([fit.y, fit.columns]), rcond=None)
    left = np.column_stack([fit.y, fit.columns]) - fit.base @ own
    left_aside = np.column_stack([aside.y, aside.columns]) - aside.base @ own
    size = np.sqrt(np.mean(left[:, 1:] ** 2, axis=0))
    whole = np.sqrt(np.mean(fit.columns**2, axis=0))
    keep = np.isfinite(size) & (size > 1e-6 * whole) & (size > _NOTHING)
    names = tuple(effect for effect, kept in zip(owner.values(), keep, strict=True) if kept)
    columns, aside_columns = left[:, 1:][:, keep] / size[keep], left_aside[:, 1:][:, keep] / size[keep]
    return Terms(columns, left[:, 0], aside_columns, left_aside[:, 0], names, fit.base.shape[1])


def _expressible(candidate: Candidate) -> bool:
    """Whether an effect is a sum of terms in measured signals, be it to first order."""
    effect = candidate.vehicle.effects[-1]
    first_order = any(p.linear or p.neutral == 0.0 for p in candidate.parameters)
    return "measurement" not in kinds_of(candidate.effect) and not effect.states and first_order


def _with_all(vehicle: Vehicle, usable: Sequence[Candidate]) -> tuple[Vehicle, dict[str, str]]:
    """One model with all candidates at values that change nothing, and whose each parameter is."""
    owner: dict[str, str] = {}
    for candidate in usable:
        linear = [p.name for p in candidate.parameters if p.linear]
        # Without linear parameters: the first derivative where the effect is absent.
        own = linear or [p.name for p in candidate.parameters if p.neutral == 0.0]
        vehicle = vehicle.with_effect(candidate.effect, {})
        owner |= {name: candidate.id for name in own if name not in owner}
    return vehicle, owner


@dataclass(frozen=True)
class _Data:
    y: Array
    base: Array
    columns: Array

    def over(self, scale: Array) -> _Data:
        """All rows in units of the size of their motion."""
        rows = np.tile(scale, len(self.y) // len(scale))
        return _Data(self.y / rows, self.base / rows[:, None], self.columns / rows[:, None])


class _Regression:
    """Residual and regressor of a model at smoothed samples."""

    def __init__(self, vehicle: Vehicle, base: Sequence[str], names: Sequence[str]) -> None:
        self.vehicle, self.functions = vehicle, Functions(vehicle)
        self.size = len(vehicle.dof_indices)
        self.base = [vehicle.parameter_names.index(n) for n in base]
        known = [n for n in names if n in vehicle.parameter_names]
        self.names = [vehicle.parameter_names.index(n) for n in known]
        self.missing = [i for i, n in enumerate(names) if n not in known]
        self.p = np.array([self._value(n) for n in vehicle.parameter_names])

    def _value(self, name: str) -> float:
        """Prior values; for the shape of an effect whose size is zero, the middle of its starts."""
        parameter = next((p for e in self.vehicle.effects for p in e.parameters if p.name == name), None)
        value = float(self.vehicle.value_of(name).value)
        if parameter is None or name in self.vehicle.values or parameter.linear or parameter.neutral == 0.0:
            return value
        if parameter.starts:
            return float(parameter.starts[len(parameter.starts) // 2])
        return value if isfinite(value) else 1e9

    def settle(self, runs: Sequence[Run]) -> None:
        """Fit the parameters of the incomplete model, by Gauss-Newton steps from their prior values."""
        for _ in range(_STEPS):
            data = self.on(runs)
            step, *_ = np.linalg.lstsq(data.base, data.y, rcond=None)
            self.p[self.base] += step

    def on(self, runs: Sequence[Run]) -> _Data:
        pieces = [self._piece(run) for run in runs]
        return _Data(*(np.concatenate(parts) for parts in zip(*pieces, strict=True)))

    def _piece(self, run: Run) -> tuple[Array, Array, Array]:
        """Acceleration that the model leaves (n motions per sample), and its derivatives in parameters."""
        x, nu_dot, u, t = smoothed(run, self.vehicle)
        x = np.hstack([x, np.zeros((len(x), self.functions.x.numel() - x.shape[1]))])
        inverse = np.linalg.inv(self._mass(x, u, t))
        model = self._residual(x, 0 * nu_dot, u, t) @ inverse.T
        slope = self._mapped(self.functions.regressor, x, model, u, t)
        slope = slope.reshape(self.size, len(x), -1).transpose(1, 0, 2)
        wide = np.einsum("ij,njk->nik", inverse, slope).reshape(len(x) * self.size, -1)
        columns = np.insert(wide[:, self.names], [i - n for n, i in enumerate(self.missing)], 0.0, axis=1)
        return (nu_dot - model).ravel(), wide[:, self.base], columns

    def _mass(self, x: Array, u: Array, t: Array) -> Array:
        """Mass matrix: what one unit of each acceleration takes away from the residual."""
        unit = np.vstack([np.zeros(self.size), np.eye(self.size)])
        first = [np.repeat(a[:1], self.size + 1, axis=0) for a in (x, u, t)]
        residual = self._residual(first[0], unit, first[1], first[2])
        return (residual[0] - residual[1:]).T

    def _residual(self, x: Array, nu_dot: Array, u: Array, t: Array) -> Array:
        return self._mapped(self.functions.residual_function, x, nu_dot, u, t).T

    def _mapped(self, function: Callable[..., Any], x: Array, nu_dot: Array, u: Array, t: Array) -> Array:
        p = np.tile(self.p[:, None], len(x))
        return np.asarray(function.map(len(x))(x.T, nu_dot.T, u.T, p, t[None]))  # type: ignore[attr-defined]


def filled(run: Run, names: Sequence[str]) -> Array:
    """Channels of a run, straight lines where one has a gap, which no filter stands."""
    columns = []
    for values in run.matrix(tuple(names)).T:
        known = np.isfinite(values)
        columns.append(np.interp(run.t, run.t[known], values[known]))
    return np.column_stack(columns) if columns else np.empty((len(run.t), 0))


def smoothed(run: Run, vehicle: Vehicle) -> tuple[Array, Array, Array, Array]:
    """State (pose, velocity), acceleration, commands and time of a run, smoothed and thinned out."""
    step = float(np.median(np.diff(run.t)))
    window = 2 * round(WINDOW / step / 2) + 1

    def smooth(names: Sequence[str]) -> Array:
        values = filled(run, names)
        return np.asarray(savgol_filter(values, window, ORDER, axis=0)) if names else values

    state, commands = smooth((*vehicle.pose_names, *vehicle.velocity_names)), smooth(vehicle.command_names)
    # The derivative of what was smoothed, so that accelerations and commands went through the same filter.
    rate = np.gradient(state[:, -len(vehicle.velocity_names) :], step, axis=0)
    edge = round(_EDGE / step)
    keep = slice(edge, len(run.t) - edge, EVERY)
    return state[keep], rate[keep], commands[keep], np.asarray(run.t[keep])
