"""What one run of a closed loop needs and fills, as compiled code and the virtual machine both take it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .parts import Parts


@dataclass
class LoopProblem:
    """A run at the sample that it has come to.

    Attributes
    ----------
    dt : float
        Sampling interval, s.
    substeps : int
        Runge-Kutta steps in it.
    continuous : bool
        Whether the law acts at every stage of a step instead of being sampled.
    p, r, k : ndarray
        Parameters, desired pose of the controller, gains.
    x, s : ndarray
        States of vehicle and controller; the first ones are given.
    input_delay : int
        Samples from a command to its thrust.
    output_delay : ndarray of int64, shape (ny,)
        Samples from a motion to its report.
    commands, reports : ndarray
        Those of the last samples, one row for each, in a ring.
    """

    dt: float
    substeps: int
    continuous: bool
    p: np.ndarray
    r: np.ndarray
    k: np.ndarray
    x: np.ndarray
    s: np.ndarray
    input_delay: int
    output_delay: np.ndarray
    commands: np.ndarray
    reports: np.ndarray


@dataclass
class Rows:
    """What is recorded of a number of samples, a row for each.

    Attributes
    ----------
    x, y, u, s, tau : ndarray
        True state, what the controller was told, its commands, its states after the sample, and the force
        that the law asked for.
    """

    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    s: np.ndarray
    tau: np.ndarray

    @classmethod
    def empty(cls, parts: Parts, samples: int) -> Rows:
        """Rows to be filled."""
        f, control = parts.functions, parts.control
        sizes = (f.x.numel(), len(parts.reported_names), f.u.numel(), *map(control.size1_out, (1, 2)))
        return cls(*(np.full((samples, size), np.nan) for size in sizes))


class LoopStepper(Protocol):
    """Runs a closed loop from sample `first` on, as many samples as `noise` and `extra` have rows."""

    def run(self, problem: LoopProblem, first: int, noise: np.ndarray, extra: np.ndarray) -> Rows: ...


def problem_of(
    parts: Parts, start: np.ndarray, desired: np.ndarray, dt: float, substeps: int, continuous: bool
) -> LoopProblem:
    """A run from its first sample on.

    Parameters
    ----------
    parts : Parts
        Model and controller.
    start : ndarray
        First pose and velocity of the vehicle.
    desired : ndarray
        Desired pose in the coordinates of the controller.
    dt : float
        Sampling interval, s.
    substeps : int
        Runge-Kutta steps in it.
    continuous : bool
        Whether the law is not sampled.
    """
    late, ages = parts.late
    delay, delays = round(late / dt), np.rint(ages / dt).astype(np.int64)
    return LoopProblem(
        dt,
        substeps,
        continuous,
        parts.parameters,
        np.array(desired, dtype=float),
        parts.gains,
        parts.at_rest(start[: len(start) // 2], velocity=start[len(start) // 2 :]),
        np.array(parts.controller.initial_states()),
        delay,
        delays,
        np.zeros((delay + 1, parts.functions.u.numel())),
        np.zeros((int(delays.max(initial=0)) + 1, len(ages))),
    )
