"""Windows of a few samples, simulated and linearised: what each measures, and what it hands to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions
from undertow.typing import Array

from ..compare.cutting import Windows
from ..output_error.shooting import Shooting


@dataclass(frozen=True)
class LinearWindows:
    """All windows linearised at parameters p and starts, k samples of 2n channels each.

    The state of a window is its start, pose and velocity, and a slow disturbance of the n accelerations: 3n.

    Attributes
    ----------
    error : (b, k, 2n, 1 + n_free) array
        Simulation error, and its derivatives in the free parameters.
    by_start : (b, k, 2n, 3n) array
        Its derivative in the state.
    used : (b, k, 2n) array of bool
        What is measured; a sample that two windows share counts once.
    defect : (b, 3n, 1 + n_free) array
        How far the end of a window is from the start of the next, and its derivatives in the parameters.
    by_end : (b, 3n, 3n) array
        Derivative of the end in the state.
    """

    error: Array
    by_start: Array
    used: NDArray[np.bool_]
    defect: Array
    by_end: Array


class Chained:
    """Windows that follow each other, simulated by one model.

    Parameters
    ----------
    functions : Functions
        The model.
    windows : Windows
        Windows that share their last sample with the next, stretch by stretch.
    free : sequence of str
        Names of the parameters to differentiate by.
    compiled : bool, optional
        As for `Simulator`.
    """

    def __init__(
        self, functions: Functions, windows: Windows, free: tuple[str, ...], compiled: bool | None
    ) -> None:
        self.windows = windows
        size = len(windows.names)
        self._shooting = Shooting(functions, windows, free, np.ones(size), compiled=compiled)
        self._predictor, self._free, self._size = self._shooting.predictor, len(free), size
        #: Windows after which the next one is not the continuation.
        self.last = _last(windows)
        self.used = _counted_once(windows, self.last)

    @property
    def late(self) -> bool:
        """Whether a sensor reports late, so that windows hang together by more than the motion."""
        return self._predictor.lateness.present

    def first_starts(self, p: Array) -> Array:
        """True pose and velocity at the start of every window as measured, shape (b, 2n)."""
        return self._shooting.first_starts(p)

    def linearise(self, p: Array, starts: Array) -> LinearWindows:
        """Simulate every window with sensitivities."""
        shooting, predictor = self._shooting, self._predictor
        start, drive = predictor.start_and_drive(self.windows, p, starts)
        every = predictor.simulator.run_with_sensitivities(
            start, drive.t, drive.held, p, shooting.places, initial=range(self._size)
        )
        x, s = map(drive.at_samples, every)
        reported, slope = shooting.report_slopes(x, s, drive.u, self.windows.t, p)
        end, by_all = x[:, -1, : self._size], s[:, -1, : self._size].copy()
        both = shooting.differences(p, lambda moved: self._reports_and_ends(moved, starts))
        for k, values in both.items():
            slope[..., k], by_all[..., k] = values[:, :-1], values[:, -1]
        return self._assembled(reported, slope, end, by_all, starts)

    def _reports_and_ends(self, p: Array, starts: Array) -> Array:
        """Reports of every window, and as a last row its end, shape (b, k + 1, 2n)."""
        start, drive = self._predictor.start_and_drive(self.windows, p, starts)
        x = drive.at_samples(self._predictor.simulator.run(start, drive.t, drive.held, p))
        reported = self._predictor.reported(x, self.windows.t, drive.u, p)
        return np.concatenate([reported, x[:, -1:, : self._size]], axis=1)

    def _assembled(
        self, reported: Array, slope: Array, end: Array, by_all: Array, starts: Array
    ) -> LinearWindows:
        n, size, count = self._free, self._size, len(end)
        error = np.where(self.used, reported - np.nan_to_num(self.windows.measured), 0.0)
        by_free = np.where(self.used[..., None], slope[..., :n], 0.0)
        following = np.vstack([starts[1:], starts[-1:]])
        defect = np.concatenate([(end - following)[..., None], by_all[..., :n]], axis=2)
        since = self.windows.t - self.windows.t[:, :1]
        first = np.broadcast_to(np.eye(size), (count, size, size))
        ends = np.stack([first, by_all[..., n:]], axis=1)
        by_push = _pushed(ends, since[:, [0, -1]])[:, 1]
        nothing = np.zeros((count, size // 2, size))
        steady = np.broadcast_to(np.eye(size // 2), (count, size // 2, size // 2))
        return LinearWindows(
            error=np.concatenate([error[..., None], by_free], axis=3),
            by_start=np.concatenate([slope[..., n:], _pushed(slope[..., n:], since)], axis=3),
            used=self.used,
            defect=np.concatenate([defect, nothing[..., :1] * np.zeros(n + 1)], axis=1),
            by_end=np.block([[by_all[..., n:], by_push], [nothing, steady]]),
        )


def _pushed(by_start: Array, since: Array) -> Array:
    """Derivative in a steady acceleration from those in the start, (b, k, 2n, n), by the trapezoidal rule."""
    half = by_start.shape[3] // 2
    by_velocity = by_start[..., half:]
    return np.asarray((by_velocity + by_velocity[:, :1]) / 2 * since[:, :, None, None])


def _last(windows: Windows) -> NDArray[np.bool_]:
    following = windows.first + windows.count - 1
    goes_on = (windows.run[1:] == windows.run[:-1]) & (windows.first[1:] == following[:-1])
    return np.append(~(goes_on & (windows.segment[1:] == windows.segment[:-1])), True)


def _counted_once(windows: Windows, last: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Measured samples of every window, its last one only where no window goes on from there."""
    steps = np.arange(windows.t.shape[1])
    own = steps < (windows.count - 1 + last)[:, None]
    return np.asarray(np.isfinite(windows.measured) & own[..., None])
