"""Velocities computed as differences of the pose over the time steps of a jittering clock.

Such a velocity carries no information beyond the pose, and where a stamp is late by a fraction of a step the
quotient is wrong by as much: on average too large, and at short steps by any factor.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from undertow.identification.findings import Finding, Severity, percent
from undertow.identification.logs.run import Run
from undertow.model.symbols import POSE, VELOCITY
from undertow.typing import Array

from .kinematics import Kinematics, jacobian
from .sampling import SETTINGS as SAMPLING
from .sampling import jitter_of


@dataclass(frozen=True)
class QuotientSettings:
    """When a velocity counts as a quotient of the pose."""

    median_width: int = 11  # samples in the median from which deviations of a quotient are taken
    same: float = 0.1  # share of that deviation by which the velocity may differ from the quotient
    rows: float = 0.8  # share of the rows in which it must be that close
    fewest: int = 50  # rows that show it
    most: int = 20_000  # rows examined
    least_mismatch: float = 2e-3  # with the pose, as a share of the motion, from which it is reported
    gross: float = 0.05  # mismatch from which a fit is refused


SETTINGS = QuotientSettings()


def quotients_of_pose(run: Run, kinematics: Kinematics) -> tuple[str, ...]:
    """Velocities of a run that are differences of its pose over jittering time steps."""
    if jitter_of(run.clock) < SAMPLING.jitter or len(run.t) < SETTINGS.fewest:
        return ()
    run = run.head(SETTINGS.most)
    pose = kinematics.table(run, POSE)
    quotients = [np.linalg.solve(jacobian(pose), rate[:, :, None])[:, :, 0] for rate in _rates(run.t, pose)]
    own = [n for n in VELOCITY if n in kinematics.channels and _compared(n, kinematics.rows)]
    return tuple(n for n in own if any(_follows(run.channels[n], q[:, VELOCITY.index(n)]) for q in quotients))


def _compared(velocity: str, rows: Sequence[str]) -> bool:
    """Whether the pose of a velocity was measured."""
    places = ("x", "y") if velocity in ("u", "v") else (POSE[VELOCITY.index(velocity)],)
    return {*places} <= {*rows}


def _rates(t: Array, pose: Array) -> Iterator[Array]:
    """Backward, forward and central differences of the pose, and those of a parabola, per second."""
    step = np.diff(t)[:, None]
    quotient = np.diff(pose, axis=0) / step
    nothing = np.full((1, pose.shape[1]), np.nan)
    behind, ahead = np.concatenate([nothing, quotient]), np.concatenate([quotient, nothing])
    yield behind
    yield ahead
    two = (pose[2:] - pose[:-2]) / (t[2:] - t[:-2])[:, None]
    yield np.concatenate([nothing, two, nothing])
    weight = step[1:] / (step[1:] + step[:-1])  # the parabola through three samples, as numpy.gradient has it
    yield np.concatenate([nothing, weight * quotient[:-1] + (1.0 - weight) * quotient[1:], nothing])


def _follows(velocity: Array, quotient: NDArray[np.floating]) -> bool:
    """Whether a velocity follows the deviations of a quotient from its local median."""
    there = np.isfinite(velocity) & np.isfinite(quotient)
    v, q = velocity[there], quotient[there]
    if len(q) < SETTINGS.fewest:
        return False
    deviations = np.abs(q - median_filter(q, SETTINGS.median_width))
    far = deviations > max(float(np.median(deviations)), 1e-12)
    return bool(far.any() and np.mean(np.abs(v - q)[far] < SETTINGS.same * deviations[far]) > SETTINGS.rows)


def finding_on_quotients(
    runs: Sequence[Run], kinematics: Kinematics
) -> tuple[Finding | None, tuple[str, ...]]:
    """The finding on velocities that are quotients in any run, and their names; None without any."""
    names = tuple(dict.fromkeys(n for run in runs for n in quotients_of_pose(run, kinematics)))
    excess = float(np.max(kinematics.mismatch(runs).excess)) if names else 0.0
    if excess < SETTINGS.least_mismatch:
        return None, ()
    pose = ", ".join(kinematics.rows)
    text = (
        f"{', '.join(names)} are differences of {pose} over single time steps, which vary by "
        f"{max(jitter_of(run.clock) for run in runs):.0%}: they add no information, and disagree with the "
        f"pose by {percent(excess)} of the motion (mean square) where stamps are late; leave them out "
        "(move their columns in the mapping file to `ignore`); they are then derived from the pose over "
        "many steps"
    )
    severity: Severity = "mistake" if excess > SETTINGS.gross else "warning"
    evidence = {"mismatch": excess}
    return Finding(id="divided_by_jitter", severity=severity, text=text, evidence=evidence), names
