"""One bounded least-squares step, with what limits it: physical bounds and stated priors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from undertow.model.parameter import Parameter, bare_name

from .residual import Linearised, WeakModel

Array = NDArray[np.float64]
# A stated prior only holds what the data leave open: at five of its standard deviations it does not bias.
_PRIOR_WIDTH = 5.0
# Times its own size, its starts, or one SI unit, that a parameter which is not linear moves in one step.
_REACH = 10.0
# The same as a share of all that is physical: a tether may come from far away.
_REACH_OF_BOUNDS = 0.02
# Square of a derivative, in units of the noise per SI unit, below which there is none but rounding.
_UNFELT = 1e-24


def bounds_of(model: WeakModel) -> tuple[Array, Array]:
    """Physical bounds of the free parameters, SNAME signs."""
    vehicle = model.functions.vehicle
    pairs = []
    for name in model.free:
        low, high = vehicle.declared_parameters[bare_name(name)].bounds
        value = vehicle.value_of(name).value
        # A value that the user allowed against its sign keeps its freedom.
        pairs.append((min(low, value) if value else low, max(high, value) if value else high))
    table = np.array(pairs).reshape(-1, 2)
    return table[:, 0], table[:, 1]


def prior_of(model: WeakModel) -> tuple[Array, Array]:
    """Where stated priors are and how much they weigh."""
    values = [model.functions.vehicle.value_of(n) for n in model.free]
    # A value without a stated error is no prior, and may be infinite (a limit that is not there).
    centre = np.array([0.0 if v.sigma is None else v.value for v in values])
    weight = np.array([0.0 if v.sigma is None else 1.0 / (_PRIOR_WIDTH * v.sigma) for v in values])
    return centre, weight


def reach_of(model: WeakModel) -> Array:
    """How far each free parameter moves at least in one step; without end for one that is linear.

    Where the data hardly feel one, a place far off say, the linearised problem would send it to its bound.
    """
    declared = model.functions.vehicle.declared_parameters
    return np.array([_reach(declared[bare_name(n)]) for n in model.free])


def _reach(parameter: Parameter) -> float:
    if parameter.linear:
        return np.inf
    span = parameter.bounds[1] - parameter.bounds[0]
    wide = _REACH_OF_BOUNDS * span if np.isfinite(span) else 0.0
    return max(_REACH * max(1.0, *map(abs, parameter.starts), 0.0), wide)


def within_reach(bounds: tuple[Array, Array], now: Array, reach: Array) -> tuple[Array, Array]:
    """Bounds of the next step: a parameter moves no farther than its reach, or some times its own size."""
    reach = np.maximum(reach, _REACH * np.abs(now))
    return np.maximum(bounds[0], now - reach), np.minimum(bounds[1], now + reach)


def bounded_step(
    at: Linearised, now: Array, bounds: tuple[Array, Array], prior: tuple[Array, Array]
) -> Array:
    """Bounded least-squares step of the linearised problem; what the data do not feel stays where it is."""
    felt = np.sum(at.J**2, axis=0) + prior[1] ** 2 > _UNFELT
    step = np.zeros(len(now))
    if felt.any():
        chosen = Linearised(at.r, at.J[:, felt], at.start)
        step[felt] = _step(chosen, now[felt], *((a[felt], b[felt]) for a, b in (bounds, prior)))
    return step


def _step(at: Linearised, now: Array, bounds: tuple[Array, Array], prior: tuple[Array, Array]) -> Array:
    centre, stiffness = prior
    gram = at.J.T @ at.J + np.diag(stiffness**2)
    slope = at.J.T @ at.r + stiffness**2 * (now - centre)
    scale = 1.0 / np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram * np.outer(scale, scale) + 1e-11 * np.eye(len(now))
    factor = np.linalg.cholesky(scaled).T
    target = np.linalg.solve(factor.T, -slope * scale)
    low, high = ((b - now) / scale for b in bounds)
    if np.all(np.isinf(low)) and np.all(np.isinf(high)):
        return np.linalg.solve(factor, target) * scale
    return lsq_linear(factor, target, bounds=(low - 1e-12, high + 1e-12), method="bvls", tol=1e-12).x * scale


def inverse_of(information: Array) -> Array:
    """Inverse of an information matrix; a direction that nothing determines gets a very large variance."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-100))
    scaled = information * np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
    return np.linalg.inv(scaled) * np.outer(scale, scale)
