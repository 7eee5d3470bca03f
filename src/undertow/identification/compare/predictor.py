"""Simulation of windows by one model, from starts that the measurement gives."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..weak.held import without_gaps
from ..weak.lateness import Lateness
from ..weak.mapping import mapped
from ..weak.pointwise import Pointwise
from .cutting import Windows
from .drive import Drive, arriving
from .inherited import Inherited
from .prediction import Prediction

# Parameters whose starts are kept: one set, and a step up and down in each that acts before a window.
_KEPT = 24


class Predictor:
    """Predicts windows with one model; keeps its compiled code from one call to the next.

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
        self.lateness = Lateness(self.functions)
        self._inherited = Inherited(self.functions, self._points, self.lateness, self.simulated)
        # Bound as one, so that threads with windows of their own do not mix them up.
        self._recent: tuple[Callable[[], Windows | None], dict[bytes, tuple[Array, Array]]]
        self._recent = (lambda: None), {}

    @property
    def values(self) -> Array:
        """Parameters of the vehicle."""
        return np.array(self.functions.values(), dtype=float)

    def predict(self, windows: Windows, p: Array | None = None) -> Prediction:
        """Simulate every window from its measured start, by default with the vehicle's own values."""
        return Prediction(windows, self.reports(windows, self.values if p is None else p))

    def reports(self, windows: Windows, p: Array, motion: Array | None = None) -> Array:
        """What the sensors would report in every window, shape (b, k, 2n); NaN in the padding.

        Parameters
        ----------
        windows : Windows
            What is simulated.
        p : (n_parameters,) array
            Parameters.
        motion : (b, 2n) array, optional
            True pose and velocity at the starts; as measured where not given.
        """
        start, drive = self.start_and_drive(windows, p, motion)
        reported = self.simulated(start, windows.t, drive, p, windows.start)
        reported[~windows.inside] = np.nan
        return reported

    def start_and_drive(self, windows: Windows, p: Array, motion: Array | None = None) -> tuple[Array, Drive]:
        """States at the start of every window, (b, nx), and the commands in it."""
        held = [without_gaps(run.matrix(windows.commands)) for run in windows.runs]
        delay = float(self.functions.dead_time(p))
        drive = arriving(windows, held, delay)
        measured, own = self._found(windows, drive.u, held, delay, p)
        return np.column_stack([measured if motion is None else motion, own]), drive

    def _found(
        self, windows: Windows, u: Array, held: list[Array], delay: float, p: Array
    ) -> tuple[Array, Array]:
        """Measured motion and own states at the starts, kept for the next calls with the same parameters.

        A descent comes back to the same parameters again and again while it moves the starts. Of one set of
        windows only: whoever predicts log after log keeps none of them.
        """
        of, recent = self._recent
        if of() is not windows:
            of, recent = self._recent = weakref.ref(windows), {}
        found = recent.get(key := p.tobytes())
        if found is None:
            measured = self.measured_motion(windows, u, p)
            found = measured, self._inherited.at_starts(windows, measured, held, delay, p)
            if len(recent) >= _KEPT:
                recent.pop(next(iter(recent)), None)
            recent[key] = found
        return found

    def measured_motion(self, windows: Windows, u: Array, p: Array) -> Array:
        """True pose and velocity at the start of every window by what was measured around it, (b, 2n)."""
        f, count = self.functions, len(windows)
        nothing = [np.zeros((count, v.shape[0])) for v in (f.actuation, f.memory)]
        late = self.lateness.present
        start = windows.start_after(self.lateness.seconds(p)) if late else windows.start
        (motion,) = mapped(self._true_motion, [start, *nothing, u[:, 0]], p, windows.t[:, 0])
        return np.asarray(motion[:, :, 0])

    def simulated(self, start: Array, t: Array, drive: Drive, p: Array, before: Array | None = None) -> Array:
        """Simulate, and say what the sensors report, shape (b, k, 2n).

        Parameters
        ----------
        start : (b, nx) array
            States at the starts.
        t : (b, k) array
            Times of the samples, s.
        drive : Drive
            Commands as they arrive.
        p : (n_parameters,) array
            Parameters.
        before : (b, 2n) array, optional
            What sensors that are late report at the starts; without it the vehicle was as at the start.
        """
        states = drive.at_samples(self.simulator.run(start, drive.t, drive.held, p))
        prompt = self.reported(states, t, drive.u, p)
        if not self.lateness.present:
            return prompt
        return reported_late(prompt, t, self.lateness.seconds(p), prompt[:, 0] if before is None else before)

    def reported(self, states: Array, t: Array, u: Array, p: Array) -> Array:
        """What sensors that are not late report of states of shape (b, k, nx)."""
        size = 2 * self._points.size
        if self.sensors_are_true:
            return states[:, :, :size].copy()
        columns = [a.reshape(a.shape[0] * a.shape[1], a.shape[2]) for a in (states, u)]
        (flat,) = mapped(self.functions.outputs, columns, p, t.ravel())
        return np.asarray(flat.reshape(*t.shape, -1))

    @cached_property
    def sensors_are_true(self) -> bool:
        """Whether the sensors report pose and velocity as they are."""
        motion = ca.vertcat(self.functions.eta, self.functions.nu)
        return bool(ca.is_equal(self.functions.reported, motion, 2))

    @cached_property
    def _true_motion(self) -> ca.Function:
        f, points = self.functions, self._points
        inputs = [points.measured, f.actuation, f.memory, f.u, f.p, f.t]
        return ca.Function("true_motion", inputs, [ca.densify(points.true_motion)])


# --- what sensors report late ---------------------------------------------------------------------
def reported_late(values: Array, t: Array, seconds: Array, before: Array) -> Array:
    """What is reported at each sample where every channel comes late by a time of its own.

    A window knows nothing of what was before it but what was reported at its start: from there a late channel
    goes in a straight line to the first value of the simulation, where its own time reaches the window.

    Parameters
    ----------
    values : (b, k, c, ...) array
        What would be reported at once, or derivatives of that.
    t : (b, k) array
        Time, s; not decreasing.
    seconds : (c,) array
        Delay of each channel, s.
    before : (b, c, ...) array
        What is reported at the start.

    Returns
    -------
    (b, k, c, ...) array
    """
    late = values.copy()
    rest = (1,) * (values.ndim - 3)
    for delay in np.unique(seconds[seconds > 0]):
        columns = np.flatnonzero(seconds == delay)
        index, share = _places(t, t - delay)
        old = values[:, :, columns]
        at, after = (np.take_along_axis(old, i.reshape(*t.shape, 1, *rest), 1) for i in (index, index + 1))
        with np.errstate(over="ignore", invalid="ignore"):  # a simulation on its way to infinity
            inside = at + share.reshape(*t.shape, 1, *rest) * (after - at)
        line = np.clip((t - t[:, :1]) / delay, 0.0, 1.0).reshape(*t.shape, 1, *rest)
        start = before[:, None, columns]
        early = (t - t[:, :1] < delay).reshape(*t.shape, 1, *rest)
        late[:, :, columns] = np.where(early, start + line * (old[:, :1] - start), inside)
    return late


def _places(t: Array, when: Array) -> tuple[NDArray[np.intp], Array]:
    """Interval of each row of t that an instant lies in, and the share of it that is over."""
    last = t.shape[1] - 2
    pairs = zip(t, when, strict=True)
    index = np.clip([np.searchsorted(own, w, side="right") - 1 for own, w in pairs], 0, last)
    begin, end = (np.take_along_axis(t, i, 1) for i in (index, index + 1))
    length = np.where(end > begin, end - begin, 1.0)
    return index, np.clip((when - begin) / length, 0.0, 1.0)
