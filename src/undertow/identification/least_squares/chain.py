"""Ordinary least squares on smoothed samples, (16) and (17) of the paper, for each motion and direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..base_parameters import base_parameters, undetermined
from ..doctor import refuse_impossible
from ..logs import Run
from ..triangle import Triangle
from .axis import Axis, axis_of, moving
from .cases import Case, Edges
from .rows import Regression

# Condition number of the scaled regressor from which rounding alone decides the estimates.
_CONDITION = 1e7


@dataclass(frozen=True)
class Experiment:
    """Logs of one motion in one direction.

    Attributes
    ----------
    regression : Regression
        Its regressor, generated from the model.
    runs : tuple of Run
        The logs.
    """

    regression: Regression
    runs: tuple[Run, ...]

    @property
    def axis(self) -> Axis:
        """The motion."""
        return self.regression.axis


@dataclass(frozen=True)
class Estimation:
    """Least squares after one case of smoothing.

    Attributes
    ----------
    case : Case
        How the motion was smoothed.
    names : tuple of str
        Parameters.
    theta : (k,) array
        Their estimates, SI and SNAME signs; (16) of the paper.
    covariance : (k, k) array
        Residual variance times the inverse of H'H; (17) of the paper. It takes samples as independent, which
        smoothed ones are not: the errors it gives are too small.
    residual_variance : float
        Sum of squares of the residual over samples less parameters, N^2 or (N m)^2; (17) of the paper, which
        calls it a standard deviation.
    samples : int
        Rows of the regression.
    condition : float
        Condition number of H with its columns scaled to unit length.
    inertia : (float, float)
        Mass with added mass, and its standard error.
    inertial : tuple of str
        Parameters that are part of it.
    impossible : tuple of str
        Parameters that lie outside what is physical: added mass or damping of the wrong sign.
    """

    case: Case
    names: tuple[str, ...]
    theta: Array
    covariance: Array
    residual_variance: float
    samples: int
    condition: float
    inertia: tuple[float, float]
    inertial: tuple[str, ...]
    impossible: tuple[str, ...]

    @property
    def values(self) -> dict[str, float]:
        """Estimates by name."""
        return dict(zip(self.names, self.theta.tolist(), strict=True))

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard errors by name; (16) of the paper, which calls them variances."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def valid(self) -> bool:
        """Whether all estimates are physical: the mass exceeds that of the body, damping takes energy."""
        return not self.impossible


def experiments(vehicle: Vehicle, runs: Sequence[Run], *, trust_log: bool = False) -> list[Experiment]:
    """Sort logs by the motion and the direction that they hold.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    runs : sequence of Run
        Logs of one motion each.
    trust_log : bool
        Take logs as they are, also those that `undertow.identification.doctor.refuse_impossible` refuses.

    Raises
    ------
    UndertowError
        If a log holds no motion of the vehicle with its force, or more than one, or cannot be.
    """
    found: dict[tuple[str, str, tuple[str, ...]], Experiment] = {}
    for run in runs:
        axis = axis_of(vehicle, _motion(vehicle, run), run)
        refuse_impossible(axis.vehicle, [run], trust_log=trust_log)
        # A log with the force and one with thrusters are experiments of their own.
        key = (axis.motion, axis.direction, axis.vehicle.command_names)
        known = found.get(key) or Experiment(Regression(axis), ())
        found[key] = replace(known, runs=(*known.runs, run))
    order = list(vehicle.degrees_of_freedom)
    return sorted(found.values(), key=lambda e: (order.index(e.axis.motion), e.axis.direction == "backward"))


def _motion(vehicle: Vehicle, run: Run) -> str:
    motions = moving(vehicle, run)
    if len(motions) == 1:
        return motions[0]
    forces = ", ".join(f"tau_{f}" for f in "XYZKMN")
    if not motions:
        raise UndertowError(
            f"run '{run.name}' holds no velocity of '{vehicle.name}' that changes with the force that drives "
            f"it ({forces}, or every thruster); it has {', '.join(run.channels)}: name its columns in a "
            "mapping file (--map)"
        )
    raise UndertowError(
        f"run '{run.name}' moves in {' and '.join(motions)}, but the paper's chain takes one motion at a "
        "time: give logs of forced motion in one of them, or use undertow fit"
    )


def estimate(experiment: Experiment, case: Case, edges: Edges = "interp") -> Estimation:
    """Estimates of one motion after one case of smoothing.

    Parameters
    ----------
    experiment : Experiment
        Motion and logs.
    case : Case
        How velocity and acceleration are smoothed; the force is left as it is, as in the paper.
    edges : str
        What the filters do at the ends of a log.

    Raises
    ------
    UndertowError
        If there are fewer samples than parameters, or the samples leave a combination of them open.
    """
    triangle = Triangle(len(experiment.regression.free))
    for run in experiment.runs:
        experiment.regression.take(triangle, run, case, edges)
    return estimated_by(experiment, case, triangle)


def estimated_by(experiment: Experiment, case: Case, triangle: Triangle) -> Estimation:
    """Estimates from the rows of one case that a triangle holds.

    Raises
    ------
    UndertowError
        As for `estimate`.
    """
    regression = experiment.regression
    H, target = triangle.split()
    size = np.linalg.norm(H, axis=0)
    _enough(experiment.axis, regression.free, H, triangle.count, case)
    scaled = H / size
    condition = float(np.linalg.cond(scaled))
    if condition > _CONDITION:
        raise UndertowError(_open(experiment.axis, regression.free, H, triangle.count, case))
    theta = np.linalg.lstsq(scaled, target, rcond=None)[0] / size
    residual = target - H @ theta
    variance = float(residual @ residual) / (triangle.count - len(theta))
    inverse = np.linalg.inv(scaled.T @ scaled) / np.outer(size, size)
    covariance = variance * inverse
    return Estimation(
        case=case,
        names=regression.free,
        theta=theta,
        covariance=covariance,
        residual_variance=variance,
        samples=triangle.count,
        condition=condition,
        inertia=regression.inertia(theta, covariance),
        inertial=regression.inertial,
        impossible=_impossible(experiment.axis, dict(zip(regression.free, theta.tolist(), strict=True))),
    )


def _enough(axis: Axis, names: Sequence[str], H: Array, count: int, case: Case) -> None:
    silent = [n for n, column in zip(names, H.T, strict=True) if not column.any()]
    if silent:
        raise UndertowError(
            f"these logs do not feel {silent[0]} of {axis} (case {case.name}): state it as known, or log a "
            "motion that does"
        )
    if count <= len(names):
        raise UndertowError(
            f"{count} samples of {axis} are too few for {len(names)} parameters (case {case.name}): give "
            "longer logs"
        )


def _open(axis: Axis, names: Sequence[str], H: Array, count: int, case: Case) -> str:
    """What to say where samples determine sums of parameters only."""
    gram, nothing = H.T @ H, 1.0 / _CONDITION**2
    tied = {n for group in undetermined(gram, names, nothing) for n in group}
    seen = [*(n for n in names if n not in tied), *map(str, base_parameters(gram, names, nothing))]
    return (
        f"{count} samples of {axis} do not determine {', '.join(names)} one by one (case {case.name}), "
        f"only {', '.join(seen)}: log other speeds and accelerations, or state one as known"
    )


def _impossible(axis: Axis, values: dict[str, float]) -> tuple[str, ...]:
    declared = axis.vehicle.declared_parameters
    return tuple(n for n, v in values.items() if not declared[n].bounds[0] <= v <= declared[n].bounds[1])


# --- which estimate is taken ----------------------------------------------------------------------
RULE = "of the cases whose estimates are all physical, the one with the least residual variance"


def selected(found: Sequence[Estimation]) -> Estimation | None:
    """The estimate that `RULE` takes; None where no case is physical."""
    return min((e for e in found if e.valid), key=lambda e: e.residual_variance, default=None)
