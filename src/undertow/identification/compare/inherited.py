"""States that effects own, at the start of windows: what came before a window has set them.

Actuators follow the commands and fluid memory the measured motion, both since the log began. What they were
then no log says: it is estimated from how the first window goes on, together with the motion at its start.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.typing import Array, Index

from ..weak.carried import Carried, Inputs
from ..weak.held import shifted_mean
from ..weak.lateness import Lateness
from ..weak.pointwise import Pointwise
from .cutting import Windows
from .drive import Drive, arriving

Simulate = Callable[[Array, Array, Drive, Array, Array], Array]
# Seconds of the first window that its beginning is estimated from.
_LOOK = 10.0
# Standard deviation in which the motion at the start is sought, relative to the noise of a sample.
_MOTION = 3.0
_FINEST = 1e-6


class Inherited:
    """Own states of a model at the start of windows.

    Parameters
    ----------
    functions : Functions
        The model.
    points : Pointwise
        Its true motion in terms of the measured one.
    lateness : Lateness
        How late its sensors are.
    simulate : callable
        Reports (b, k, 2n) from start (b, nx), t, commands, p and what was reported at the start (b, 2n).
    """

    def __init__(
        self, functions: Functions, points: Pointwise, lateness: Lateness, simulate: Simulate
    ) -> None:
        self._functions, self._points, self._simulate = functions, points, simulate
        self._lateness = lateness
        self.size = functions.memory.shape[0] + functions.actuator_states.shape[0]

    def at_starts(
        self, windows: Windows, motion: Array, held: Sequence[Array], delay: float, p: Array
    ) -> Array:
        """Memory and actuator states at the start of every window, shape (b, size).

        Parameters
        ----------
        windows : Windows
            The windows.
        motion : (b, 2n) array
            True pose and velocity at the starts.
        held : sequence of (N, n_commands) arrays
            Commands of every run, without gaps.
        delay : float
            How late they arrive, s.
        p : (n_parameters,) array
            Parameters.
        """
        own = np.zeros((len(windows), self.size))
        if self.size == 0:
            return own
        stretches = _stretches(windows)
        first = np.array([rows[0] for rows in stretches])
        look = _opening(windows, first)
        drive = arriving(look, held, delay)
        drives = [
            shifted_mean(run.t, u, delay) if delay else u for run, u in zip(windows.runs, held, strict=True)
        ]
        rest = self._at_rest(drive.u[:, 0], look.t[:, 0], p)
        scale = self._scale(
            [self._along(windows, rows, drives, rest[i], p) for i, rows in enumerate(stretches)]
        )
        begin = self._begun(look, np.column_stack([motion[first], rest]), drive, scale, _noise(windows), p)
        for rows, state in zip(stretches, begin, strict=True):
            along = self._along(windows, rows, drives, state, p)
            own[rows] = along[windows.first[rows] - windows.first[rows[0]]]
        return own

    # --- along the log ------------------------------------------------------------------------
    def _at_rest(self, u: Array, t: Array, p: Array) -> Array:
        """Memory without a past, actuators as if the first command had been held for long, by stretch."""
        rest = self._functions.rest
        actuator = [np.asarray(rest(commands, p, now)).ravel() for commands, now in zip(u, t, strict=True)]
        return np.column_stack([np.zeros((len(u), self._functions.memory.shape[0])), np.array(actuator)])

    @staticmethod
    def _scale(along: list[Array]) -> Array:
        """How large the states become, which is how far off a beginning may be."""
        largest = np.max([np.max(np.abs(a), axis=0) for a in along], axis=0)
        return np.where(largest > 0, largest, 1.0)

    def _along(self, windows: Windows, rows: Index, drives: list[Array], start: Array, p: Array) -> Array:
        """States from the first to the last start in a stretch, shape (N, size)."""
        run, first = int(windows.run[rows[0]]), int(windows.first[rows[0]])
        piece = slice(first, int(windows.first[rows[-1]]) + 1)
        log = windows.runs[run]
        t, u = log.t[piece], drives[run][piece]
        count = len(t) - 1
        if count == 0:
            return start[None]
        reach = slice(first, piece.stop - 1 + int(windows.count[rows[-1]]))
        measured = self._measured(windows, run, reach, p)[: count + 1]
        columns = [measured[:-1], measured[1:], u[:-1]]
        return self._carried.states(start, columns, p, t[:-1], np.diff(t))

    def _measured(self, windows: Windows, run: int, piece: slice, p: Array) -> Array:
        """Pose and velocity as reported in part of a run, each at the time that it was true."""
        log = windows.runs[run]
        zero = np.zeros(len(log.t))
        measured = np.column_stack([log.channels.get(n, zero)[piece] for n in windows.names])
        return self._lateness.at_its_time(log.t[piece], measured, p)

    @cached_property
    def _carried(self) -> Carried:
        """Own states from sample to sample: the motion is linear in between, the command is held."""
        f, measured = self._functions, self._points.measured
        after, dt, rate = ca.SX.sym("after", measured.shape[0]), ca.SX.sym("dt"), self._rates
        nothing = ca.SX(0, 1)

        def at(state: ca.SX, share: float) -> ca.SX:
            return rate(state, measured + share * (after - measured), f.u, f.p, f.t + share * dt)

        inputs = Inputs([measured, after, f.u], f.p, f.t, dt)
        return Carried(ca.vertcat(f.memory, f.actuator_states), inputs, nothing, at, lambda *_: nothing)

    @cached_property
    def _rates(self) -> ca.Function:
        f, points = self._functions, self._points
        driven = ca.substitute(f.memory_rates, f.actuation, f.chain_output)
        rates = ca.substitute(ca.vertcat(driven, f.chain_rates), ca.vertcat(f.eta, f.nu), points.true_motion)
        own = ca.vertcat(f.memory, f.actuator_states)
        return ca.Function("rates", [own, points.measured, f.u, f.p, f.t], [ca.densify(rates)])

    # --- at its beginning ---------------------------------------------------------------------
    def _begun(
        self, look: Windows, start: Array, drive: Drive, scale: Array, noise: Array, p: Array
    ) -> Array:
        """Own states at the beginning of every stretch."""

        def report(trials: Array) -> Array:
            rows = np.repeat(np.arange(len(look)), len(trials) // len(look))
            return self._simulate(trials, look.t[rows], drive[rows], p, look.start[rows]) / noise

        measured = np.where(np.isfinite(look.measured), look.measured / noise, np.nan)
        width = np.concatenate([_MOTION * noise, scale])
        return best_start(report, measured, start, width)[:, -self.size :]


def _opening(windows: Windows, first: Index) -> Windows:
    """The first seconds of the first window of every stretch."""
    step = float(np.median(np.diff(windows.runs[0].t)))
    return windows.take(first, max(int(_LOOK / step), 3))


def _stretches(windows: Windows) -> list[Index]:
    """Windows of every stretch without gaps, in order of time."""
    pairs = np.column_stack([windows.run, windows.segment])
    number = np.unique(pairs, axis=0, return_inverse=True)[1].ravel()
    return [np.flatnonzero(number == i) for i in range(number.max() + 1)]


def _noise(windows: Windows) -> Array:
    """Noise of the channels, with a floor for logs that have none."""
    there = np.isfinite(windows.measured)
    size = np.sqrt(
        np.sum(np.where(there, windows.measured, 0.0) ** 2, axis=(0, 1))
        / np.maximum(there.sum(axis=(0, 1)), 1)
    )
    return np.maximum(np.maximum(windows.sigma, _FINEST * size), _FINEST)


# --- the state at the beginning, by how the log goes on -------------------------------------------
_ROUNDS = 12
_SECANT = 1e-6
_SHARES = np.array([1.0, 0.3, 0.1, 0.03, 0.0])
# Fall of the sum of squares below which the search ends.
_ENOUGH = 1e-6
_LOST = 1e300


def best_start(report: Callable[[Array], Array], measured: Array, start: Array, width: Array) -> Array:
    """Starts that explain best what follows, drawn to the given ones by a prior.

    Parameters
    ----------
    report : callable
        What follows, in units of the noise, shape (b r, k, c), of b r starts: r trials for each log in turn.
    measured : (b, k, c) array
        What was measured, in units of the noise; NaN where nothing was.
    start : (b, m) array
        Where the search begins, and the centre of the prior.
    width : (m,) array
        Standard deviation of the prior.

    Returns
    -------
    (b, m) array
    """
    used = np.isfinite(measured)[:, None]
    known = np.where(used, measured[:, None], 0.0)

    def residual(moved: Array) -> Array:
        """Measured minus reported for trials of shape (b, r, m), shape (b, r, k c)."""
        b, r, m = moved.shape
        y = report((start[:, None] + moved * width).reshape(b * r, m))
        return np.where(used, known - y.reshape(b, r, *y.shape[1:]), 0.0).reshape(b, r, -1)

    moved = np.zeros_like(start)
    for _ in range(_ROUNDS):
        step = _gauss_newton(residual, moved)
        trials = moved[:, None] + _SHARES[:, None] * step[:, None]
        with np.errstate(over="ignore"):
            cost = np.sum(residual(trials) ** 2, axis=2) + np.sum(trials**2, axis=2)
        cost = np.nan_to_num(cost, nan=_LOST, posinf=_LOST)
        best = np.argmin(cost, axis=1)
        moved = trials[np.arange(len(best)), best]
        gained = cost[:, -1] - cost[np.arange(len(best)), best]
        if not np.any(gained > _ENOUGH):
            break
    return start + moved * width


def _gauss_newton(residual: Callable[[Array], Array], moved: Array) -> Array:
    """Step in units of the prior, shape (b, m); zero where a simulation diverged."""
    m = moved.shape[1]
    r = residual(moved[:, None] + np.vstack([np.zeros(m), _SECANT * np.eye(m)]))
    slope = (r[:, :1] - r[:, 1:]) / _SECANT
    gram = slope @ np.swapaxes(slope, 1, 2) + np.eye(m)
    right = (slope @ r[:, 0, :, None])[:, :, 0] - moved
    good = np.isfinite(right).all(axis=1) & np.isfinite(gram).all(axis=(1, 2))
    step = np.zeros_like(moved)
    step[good] = np.linalg.solve(gram[good], right[good][:, :, None])[:, :, 0]
    return step
