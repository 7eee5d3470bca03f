"""Ordinary least squares on smoothed samples, (16) and (17) of the paper, for each motion and direction."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from functools import cached_property
from itertools import chain, combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from undertow.errors import UndertowError
from undertow.identification.doctor.examine import refuse_impossible
from undertow.identification.estimation.fitted import TriangularFactor, base_parameters, undetermined
from undertow.identification.estimation.step import estimated
from undertow.identification.logs.chunks import LogPart, LongLog, NeedsWhole, outline
from undertow.identification.logs.run import Run
from undertow.model.saving import save_vehicle
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from .regression import Axis, Case, Edges, Regression, axis_of, chosen_cases, moving


@dataclass(frozen=True)
class EstimationSettings:
    """Limits of estimates, and how much of a log is held at once."""

    # Condition number of the scaled regressor from which rounding alone decides the estimates.
    largest_condition: float = 1e7
    # Standard deviations between two estimates of one parameter from which they contradict each other.
    contradiction: float = 3.0
    rows: int = 50_000  # that are in memory at a time


SETTINGS = EstimationSettings()


@dataclass(frozen=True)
class Experiment:
    """Logs of one motion in one direction."""

    regression: Regression  # its regressor, generated from the model
    runs: tuple[Run, ...]

    @property
    def axis(self) -> Axis:
        """The motion."""
        return self.regression.axis


@dataclass(frozen=True)
class Estimation:
    """Least squares after one case of smoothing."""

    case: Case  # how the motion was smoothed
    names: tuple[str, ...]
    theta: Array  # (k,): their estimates, SI and SNAME signs; (16) of the paper
    # (k, k): residual variance times the inverse of H'H; (17) of the paper. It takes samples as independent,
    # which smoothed ones are not: the errors it gives are too small
    covariance: Array
    # sum of squares of the residual over samples less parameters, N^2 or (N m)^2; (17) of the paper, which
    # calls it a standard deviation
    residual_variance: float
    samples: int  # rows of the regression
    condition: float  # condition number of H with its columns scaled to unit length
    inertia: tuple[float, float]  # mass with added mass, and its standard error
    inertial: tuple[str, ...]  # parameters that are part of it
    # parameters that lie outside what is physical: added mass or damping of the wrong sign
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
    """Sort logs by the motion and the direction that they hold."""
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
        f"run '{run.name}' moves in {' and '.join(motions)}, but the paper's method takes one motion at a "
        "time: give logs of forced motion in one of them, or use undertow fit"
    )


def estimate(experiment: Experiment, case: Case, edges: Edges = "interp") -> Estimation:
    """Estimates of one motion after one case of smoothing."""
    triangle = TriangularFactor(len(experiment.regression.free))
    for run in experiment.runs:
        experiment.regression.add_run(triangle, run, case, edges)
    return estimated_by(experiment, case, triangle)


def estimated_by(experiment: Experiment, case: Case, triangle: TriangularFactor) -> Estimation:
    """Estimates from the rows of one case that a triangle holds."""
    regression = experiment.regression
    H, target = triangle.split()
    size = np.linalg.norm(H, axis=0)
    _check_samples(experiment.axis, regression.free, H, triangle.count, case)
    scaled = H / size
    condition = float(np.linalg.cond(scaled))
    if condition > SETTINGS.largest_condition:
        raise UndertowError(_open(experiment.axis, regression.free, H, triangle.count, case))
    theta = np.linalg.lstsq(scaled, target, rcond=None)[0] / size
    residual = target - H @ theta
    variance = float(residual @ residual) / (triangle.count - len(theta))
    inverse = np.linalg.inv(scaled.T @ scaled) / np.outer(size, size)
    covariance = variance * inverse
    declared = experiment.axis.vehicle.declared_parameters
    limits = [(n, v, declared[n].bounds) for n, v in zip(regression.free, theta.tolist(), strict=True)]
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
        impossible=tuple(n for n, v, (low, high) in limits if not low <= v <= high),
    )


def _check_samples(axis: Axis, names: Sequence[str], H: Array, count: int, case: Case) -> None:
    silent = [n for n, column in zip(names, H.T, strict=True) if not column.any()]
    if silent:
        raise UndertowError(
            f"these logs contain no information on {silent[0]} of {axis} (case {case.name}): state it as "
            "known, or log a motion that does"
        )
    if count <= len(names):
        raise UndertowError(
            f"{count} samples of {axis} are too few for {len(names)} parameters (case {case.name}): give "
            "longer logs"
        )


def _open(axis: Axis, names: Sequence[str], H: Array, count: int, case: Case) -> str:
    """What to say where samples determine sums of parameters only."""
    gram, nothing = H.T @ H, 1.0 / SETTINGS.largest_condition**2
    tied = {n for group in undetermined(gram, names, nothing) for n in group}
    seen = [*(n for n in names if n not in tied), *map(str, base_parameters(gram, names, nothing))]
    return (
        f"{count} samples of {axis} do not determine {', '.join(names)} one by one (case {case.name}), "
        f"only {', '.join(seen)}: log other speeds and accelerations, or state one as known"
    )


# --- which estimate is taken ----------------------------------------------------------------------
RULE = "of the cases whose estimates are all physical, the one with the least residual variance"


def selected(found: Sequence[Estimation]) -> Estimation | None:
    """The estimate that `RULE` takes; None where no case is physical."""
    return min((e for e in found if e.valid), key=lambda e: e.residual_variance, default=None)


@dataclass(frozen=True)
class CombinedEstimates:
    """Values for a vehicle file."""

    names: tuple[str, ...]  # parameters of the whole vehicle
    values: Array  # (k,): SI and SNAME signs
    covariance: Array  # (k, k): of the values; zero between motions, which were logged apart
    # what motions or directions say differently of a parameter that they share, one line each
    contradictions: tuple[str, ...]

    def vehicle(self, stated: Vehicle) -> Vehicle:
        """The vehicle with these values and their standard errors."""
        errors = np.sqrt(np.diag(self.covariance)).tolist()
        return estimated(
            stated,
            dict(zip(self.names, self.values.tolist(), strict=True)),
            dict(zip(self.names, errors, strict=True)),
        )


def combined(stated: Vehicle, found: Sequence[tuple[Experiment, Estimation]]) -> CombinedEstimates:
    """Put the estimates of several motions together.

    What several motions or directions share is weighted by the inverse of its variances.
    """
    pairs = [(n, e.axis.name_of(n)) for e, estimation in found for n in estimation.names]
    labels = [own if own in stated.values else name for name, own in pairs]
    theta = np.concatenate([estimation.theta for _, estimation in found])
    covariance = block_diag(*(estimation.covariance for _, estimation in found))
    names = tuple(dict.fromkeys(labels))
    weights = np.array([[float(label == n) for label in labels] for n in names]) / np.diag(covariance)
    weights /= weights.sum(axis=1, keepdims=True)
    axes = [str(e.axis) for e, estimation in found for _ in estimation.names]
    contradictions = [line for n in names if (line := _contradictions(n, labels, axes, theta, covariance))]
    return CombinedEstimates(names, weights @ theta, weights @ covariance @ weights.T, tuple(contradictions))


def _contradictions(
    name: str, labels: Sequence[str], axes: Sequence[str], theta: Array, covariance: Array
) -> str | None:
    places = [i for i, label in enumerate(labels) if label == name]
    if len(places) < 2:
        return None

    def away(pair: tuple[int, int]) -> float:
        i, j = pair
        return float(abs(theta[i] - theta[j]) / np.sqrt(covariance[i, i] + covariance[j, j]))

    i, j = worst = max(combinations(places, 2), key=away)
    if away(worst) <= SETTINGS.contradiction:
        return None
    return (
        f"{name} is {theta[i]:.6g} by {axes[i]} and {theta[j]:.6g} by {axes[j]}, {away(worst):.1f} standard "
        "deviations apart: one value cannot be right for both"
    )


def estimate_streaming(
    vehicle: Vehicle,
    logs: Sequence[LongLog],
    cases: Sequence[Case],
    edges: Edges = "interp",
    rows: int = SETTINGS.rows,
    progress: Progress = lambda done, words: None,
    *,
    trust_log: bool = False,
) -> list[tuple[Experiment, list[Estimation]]]:
    """Estimates of every motion that logs hold, after each case of smoothing, in constant memory.

    Every log is read twice: to see what moves in it, then for the rows of the regression. Parts overlap by
    more than the filters reach, and what a filter makes of the samples at the border of a part is dropped, so
    that the answer is that of the log in one piece. (The median step of a part defines what a gap is.)
    """
    overlap = 4 * max(case.needs(edges) + sum(f.frame for f in case.acceleration) for case in cases)
    seen = [_outline(log, max(rows, 2 * overlap), progress) for log in logs]
    found = experiments(vehicle, seen, trust_log=True)  # outlines only: each part is looked at
    reduced = [{c.name: TriangularFactor(len(e.regression.free)) for c in cases} for e in found]
    for k, (log, outlined) in enumerate(zip(logs, seen, strict=True)):
        progress(0.3 + 0.7 * k / len(logs), f"reducing {log.path.name}")
        place = next(i for i, e in enumerate(found) if any(run is outlined for run in e.runs))
        _refuse_clock(found[place])
        parts = log.parts(max(rows, 3 * overlap), overlap)
        _reduce(found[place], parts, cases, edges, reduced[place], trust_log)
    pairs = zip(found, reduced, strict=True)
    return [(e, [estimated_by(e, c, triangles[c.name]) for c in cases]) for e, triangles in pairs]


def _refuse_clock(experiment: Experiment) -> None:
    if experiment.regression.depends_on_time:
        raise NeedsWhole(
            f"the {experiment.axis.motion} of '{experiment.axis.vehicle.name}' depends on the time itself, "
            "which parts of a log do not share: leave out --stream"
        )


def _outline(log: LongLog, rows: int, progress: Progress) -> Run:
    progress(0.0, f"looking through {log.path.name}")
    parts = (part.run for part in log.parts(rows, 0))
    first = next(parts, None)
    whole = parts if first is None else chain([first], parts)
    return outline(whole, log.name, log.sha256)


def _reduce(
    experiment: Experiment,
    parts: Iterator[LogPart],
    cases: Sequence[Case],
    edges: Edges,
    triangles: Mapping[str, TriangularFactor],
    trust_log: bool,
) -> None:
    """Take the rows of a log into the triangles, one for each case."""
    after, part = -np.inf, next(parts, None)
    while part is not None:
        refuse_impossible(experiment.axis.vehicle, [part.run], trust_log=trust_log)
        following = next(parts, None)
        until = np.inf if following is None else part.border
        for case in cases:
            experiment.regression.add_part(triangles[case.name], part.run, case, edges, after, until)
        after, part = until, following


# --- all motions of a vehicle ---------------------------------------------------------------------
@dataclass(frozen=True)
class Identified:
    """Estimates of all motions."""

    stated: Vehicle  # the vehicle as given
    # for each motion and direction its estimates, one for each case
    found: list[tuple[Experiment, list[Estimation]]]
    edges: str  # what the filters did at the ends

    @property
    def taken(self) -> list[tuple[Experiment, Estimation]]:
        """What the rule takes, motions without a physical case left out."""
        picks = ((e, selected(estimations)) for e, estimations in self.found)
        return [(e, pick) for e, pick in picks if pick is not None]

    @cached_property
    def chosen(self) -> CombinedEstimates | None:
        """The values of the whole vehicle; None where no case of any motion is physical."""
        return combined(self.stated, self.taken) if self.taken else None

    def to_json(self) -> str:
        """All numbers as JSON, SI and SNAME signs."""
        motions = [
            {
                "motion": experiment.axis.motion,
                "direction": experiment.axis.direction,
                "logs": [{"name": r.name, "sha256": r.sha256} for r in experiment.runs],
                "selected": pick.case.name if (pick := selected(estimations)) else None,
                "cases": [_case(e) for e in estimations],
            }
            for experiment, estimations in self.found
        ]
        content = {"vehicle": self.stated.name, "edges": self.edges, "rule": RULE, "motions": motions}
        return json.dumps(content, indent=1, allow_nan=False) + "\n"

    def save(self, template: str | Path, out: Path) -> None:
        """Write the vehicle file with what the rule takes and its covariance, in the form of the template."""
        if self.chosen is None:
            raise UndertowError(f"{out} is not written: no case of any motion is physical")
        cases = ", ".join(f"{e.axis}: case {pick.case.name}" for e, pick in self.taken)
        runs = [run for experiment, _ in self.taken for run in experiment.runs]
        history = {
            "command": f"undertow identify --method sg-ls --edges {self.edges} ({cases})",
            "date": date.today().isoformat(),
            "logs": [{"name": r.name, "sha256": r.sha256, "role": "train"} for r in runs],
            "covariance": {"parameters": list(self.chosen.names), "matrix": self.chosen.covariance.tolist()},
        }
        save_vehicle(self.chosen.vehicle(self.stated), template, out, history=history)


def _case(estimation: Estimation) -> dict[str, Any]:
    return {
        "case": estimation.case.name,
        "estimates": estimation.values,
        "standard_errors": estimation.standard_errors,
        "covariance": estimation.covariance.tolist(),
        "inertia": dict(zip(("value", "standard_error"), estimation.inertia, strict=True)),
        "residual_variance": estimation.residual_variance,
        "samples": estimation.samples,
        "condition": estimation.condition,
        "physical": estimation.valid,
    }


def identify(
    vehicle: Vehicle, runs: Sequence[Run], cases: str, edges: Edges = "interp", *, trust_log: bool = False
) -> Identified:
    """Estimates of every motion that the logs hold, after each of the `cases` ("all", or "1,4")."""
    wanted = chosen_cases(cases)
    found = [
        (e, [estimate(e, case, edges) for case in wanted])
        for e in experiments(vehicle, runs, trust_log=trust_log)
    ]
    return Identified(vehicle, found, edges)


def identify_in_parts(
    vehicle: Vehicle,
    logs: Sequence[LongLog],
    cases: str,
    edges: Edges = "interp",
    *,
    progress: Progress = lambda done, words: None,
    trust_log: bool = False,
) -> Identified:
    """The same from logs that are read in parts, each given once."""
    parts = [(log.path.resolve(), log.stretch) for log in logs]
    twice = [path for path, stretch in parts if parts.count((path, stretch)) > 1]
    if twice:
        raise UndertowError(f"log {twice[0]} is given twice: give each once")
    found = estimate_streaming(
        vehicle, logs, chosen_cases(cases), edges, progress=progress, trust_log=trust_log
    )
    return Identified(vehicle, found, edges)
