"""What runs of a closed loop need and fill, as compiled code and the virtual machine both take it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from undertow.errors import UndertowError

from .parts import Parts

_OF_RUNS = ("p", "r", "k", "x", "s", "command", "commands", "reports")


@dataclass
class LoopProblem:
    """Runs at the sample that they have come to.

    Attributes
    ----------
    dt : float
        Sampling interval, s.
    substeps : int
        Runge-Kutta steps in it.
    continuous : bool
        Whether the law acts at every stage of a step instead of being sampled.
    input_delay : int
        Samples from a command to its thrust.
    output_delay : ndarray of int64, shape (ny,)
        Samples from a motion to its report.
    p, r, k : ndarray, shape (b, n)
        Parameters, desired pose of the controller, gains.
    x, s : ndarray, shape (b, n)
        States of vehicle and controller; the first ones are given.
    command : ndarray, shape (b, nu)
        The last command.
    commands, reports : ndarray, shape (b, ring, n)
        Those of the last samples, one row for each, in a ring.
    """

    dt: float
    substeps: int
    continuous: bool
    input_delay: int
    output_delay: np.ndarray
    p: np.ndarray
    r: np.ndarray
    k: np.ndarray
    x: np.ndarray
    s: np.ndarray
    command: np.ndarray
    commands: np.ndarray
    reports: np.ndarray

    @property
    def runs(self) -> int:
        """How many runs there are."""
        return len(self.x)

    def part(self, runs: slice) -> LoopProblem:
        """Some of the runs, in the same memory."""
        return replace(self, **{name: getattr(self, name)[runs] for name in _OF_RUNS})


@dataclass
class Rows:
    """What is recorded of samples, a row for each; what is not wanted has none.

    Attributes
    ----------
    x, y, u, s, tau : ndarray, shape (b, rows, n)
        True state, what the controller was told, its commands, its states after the sample, and the force
        that the law asked for.
    """

    x: np.ndarray
    y: np.ndarray
    u: np.ndarray
    s: np.ndarray
    tau: np.ndarray

    def of(self, run: int) -> Rows:
        """The rows of one run, arrays of shape (rows, n)."""
        return Rows(*(array[run] for array in vars(self).values()))

    def first(self, count: int) -> Rows:
        """The first rows of one run."""
        return Rows(*(array[:count] for array in vars(self).values()))


ALL = ("x", "y", "u", "s", "tau")


@dataclass(frozen=True)
class Block:
    """Samples of one call, and what is recorded of them.

    Attributes
    ----------
    first, samples : int
        The first sample and how many.
    stride : int
        Recorded is every sample that this divides.
    noise : ndarray, shape (b, samples, ny), optional
        What the sensors add.
    extra : ndarray, shape (samples, nu), optional
        Forces from outside.
    wanted : tuple of str
        What is recorded.
    """

    first: int
    samples: int
    stride: int = 1
    noise: np.ndarray | None = None
    extra: np.ndarray | None = None
    wanted: tuple[str, ...] = ALL

    @property
    def recorded(self) -> range:
        """The samples that are recorded."""
        begin = -(-self.first // self.stride) * self.stride
        return range(begin, self.first + self.samples, self.stride)

    def rows(self, parts: Parts, groups: int, *lanes: int) -> Rows:
        """Rows to be filled, of so many runs or groups of runs in lanes."""
        f, control = parts.functions, parts.control
        sizes = (f.x.numel(), len(parts.reported_names), f.u.numel(), *map(control.size1_out, (1, 2)))
        count = len(self.recorded)
        counts = (count if name in self.wanted else 0 for name in ALL)
        return Rows(*(np.empty((groups, c, n, *lanes)) for c, n in zip(counts, sizes, strict=True)))


class LoopStepper(Protocol):
    """Runs closed loops over the samples of a block."""

    lanes: int
    parallel: bool

    def run(self, problem: LoopProblem, block: Block) -> Rows: ...


def problem_of(
    parts: Parts,
    start: np.ndarray,
    desired: np.ndarray,
    dt: float,
    substeps: int,
    continuous: bool,
    p: np.ndarray | None = None,
    k: np.ndarray | None = None,
) -> LoopProblem:
    """Runs from their first sample on."""
    runs = len(start)
    p = np.tile(parts.parameters, (runs, 1)) if p is None else p
    k = np.tile(parts.gains, (runs, 1)) if k is None else k
    delay, delays = _delays(parts, p, dt)
    return LoopProblem(
        dt,
        substeps,
        continuous,
        delay,
        delays,
        p,
        np.tile(np.asarray(desired, dtype=float), (runs, 1)),
        k,
        _at_rest(parts, start, p),
        np.tile(np.array(parts.controller.initial_states()), (runs, 1)),
        np.zeros((runs, parts.functions.u.numel())),
        np.zeros((runs, delay + 1, parts.functions.u.numel())),
        np.zeros((runs, int(delays.max(initial=0)) + 1, len(delays))),
    )


def _at_rest(parts: Parts, start: np.ndarray, p: np.ndarray) -> np.ndarray:
    """First states: commands of zero have been held for long."""
    runs, f = len(start), parts.functions
    owned = np.zeros((runs, f.x.numel() - start.shape[1]))
    if f.actuator_states.numel():
        at_zero = (np.zeros(f.u.numel()), p.T, 0.0)
        owned[:, f.memory.numel() :] = np.asarray(f.rest.map(runs)(*_columns(at_zero, runs))).T
    return np.hstack([start, owned])


def _delays(parts: Parts, p: np.ndarray, dt: float) -> tuple[int, np.ndarray]:
    """Samples that commands and each report are late, the same in all runs."""
    late, ages = parts.lateness(p)
    samples = np.rint(np.column_stack([late, ages]) / dt).astype(np.int64)
    other = np.flatnonzero((samples != samples[0]).any(axis=1))
    if other.size:
        raise UndertowError(
            f"run {other[0]} has other dead times than run 0, in samples of {dt:g} s: simulate runs with "
            "equal dead times together"
        )
    return int(samples[0, 0]), np.ascontiguousarray(samples[0, 1:])


def _columns(values: tuple[np.ndarray | float, ...], runs: int) -> list[np.ndarray]:
    """Each value as a matrix with a column for every run."""
    found = [np.atleast_1d(np.asarray(v, dtype=float)) for v in values]
    return [v if v.ndim == 2 else np.tile(v[:, None], (1, runs)) for v in found]
