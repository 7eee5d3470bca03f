"""A run: one stretch of measurement on one clock, in SI, with its gaps left open."""

from __future__ import annotations

import builtins
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.model.symbols import POSE, VELOCITY
from undertow.notebook import html
from undertow.typing import Flags

if TYPE_CHECKING:
    from .mapping import LogMapping


FORCES = ("tau_X", "tau_Y", "tau_Z", "tau_K", "tau_M", "tau_N")
ACCELERATION = tuple(f"{name}_dot" for name in VELOCITY)
UNITS = dict(
    zip(
        POSE + VELOCITY + FORCES + ACCELERATION,
        ["m"] * 3
        + ["rad"] * 3
        + ["m/s"] * 3
        + ["rad/s"] * 3
        + ["N"] * 3
        + ["N m"] * 3
        + ["m/s^2"] * 3
        + ["rad/s^2"] * 3,
        strict=True,
    )
)
MEASURED = frozenset(POSE + VELOCITY + ACCELERATION)
"""Channels that a sensor of the motion reports; all others are held until they change."""


@dataclass(frozen=True)
class GapSettings:
    """How long nothing may be known for."""

    steps: float = 5.0  # times the usual step: a longer step ends a segment
    # s that a simulation goes on across: the shortest time constants of vehicles that carry a computer are
    # three times as long and more, and what they do meanwhile follows from their motion before.
    harmless: float = 0.1


GAPS = GapSettings()


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """One log on one clock.

    Attributes
    ----------
    name : str
        Name of the run in reports.
    t : (n,) array
        Time in s, strictly increasing, in general not evenly spaced.
    channels : dict of (n,) arrays
        SI values by channel name (``x y z phi theta psi u v w p q r``, ``u_dot`` …, thruster names,
        ``tau_X`` …);
        NED and forward-starboard-down axes; NaN where a sample is missing. Arrays are read-only.
    reported : dict of (n,) bool arrays
        Rows in which a channel was measured, for channels that do not report in all of them. In the other
        rows `channels` has interpolated values: regressors may use them, errors are never judged by them.
    source, sha256 : str
        The file the run was read from, and the hash of its bytes.
    notes : tuple of str
        What was converted, dropped or looked odd, one line each.
    reader_notes : tuple of str
        Notes of the reader of a vehicle log, beginning with the name of the format; empty for a table.
    sigma : dict of float
        Known standard deviations of the noise of a report, in the unit of the channel.
    derived : frozenset of str
        Names of channels computed from others (velocities from pose).
    resolution : float
        Time constant in s of the smoother of the `derived` channels; faster changes are smoothed out.
    mapping : Mapping, optional
        How the columns of the file were read; None where the run was not read from a file.
    wrapped : dict of (n,) arrays
        Angles that jump by full turns in the log, as logged; in `channels` they are unwrapped.
    held : tuple of str
        Motions held at rest, or moved as logged, by a rig.
    part_of : str
        Name of the run that this is a stretch of; empty for a whole run.
    outliers : dict of int
        Samples of the pose that were taken out because the others contradict them.
    dropped : int
        Rows of the file that were left out because their time was not later than that of an earlier row.
    """

    name: str
    t: NDArray[np.float64]
    channels: Mapping[str, NDArray[np.float64]]
    source: str = ""
    sha256: str = ""
    notes: tuple[str, ...] = ()
    sigma: Mapping[str, float] = field(default_factory=dict)
    derived: frozenset[str] = frozenset()
    resolution: float = 0.0
    mapping: LogMapping | None = None
    wrapped: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    outliers: Mapping[str, int] = field(default_factory=dict)
    dropped: int = 0
    part_of: str = ""
    reported: Mapping[str, Flags] = field(default_factory=dict)
    reader_notes: tuple[str, ...] = ()
    held: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "t", _frozen(self.t))
        for field_name in ("channels", "wrapped"):
            tables = {name: _frozen(data) for name, data in getattr(self, field_name).items()}
            object.__setattr__(self, field_name, tables)
        for name, data in (*self.channels.items(), *self.reported.items()):
            if data.shape != self.t.shape:
                raise UndertowError(
                    f"run {self.name!r}: channel {name!r} has shape {data.shape}, t has {self.t.shape}: "
                    "give one sample per time"
                )

    def __repr__(self) -> str:
        span = f"{self.t[0]:g} to {self.t[-1]:g} s" if len(self.t) else "no time"
        return (
            f"Run {self.name}: {len(self.t)} samples, {span}; channels {', '.join(self.channels) or 'none'}"
        )

    def _repr_html_(self) -> str:
        head = ("channel", "unit", "samples", "least", "mean", "greatest")
        return html(repr(self), head, (_shown(name, data) for name, data in self.channels.items()))

    @property
    def origin(self) -> str:
        """Name of the run that this is, or is a stretch of: what differs between runs is the same in it."""
        return self.part_of or self.name

    def has(self, name: str) -> bool:
        """Tell whether the run has a channel of this name."""
        return name in self.channels

    def matrix(self, names: Iterable[str]) -> NDArray[np.float64]:
        """Return channels side by side.

        Parameters
        ----------
        names : iterable of str
            k channel names.

        Returns
        -------
        (n, k) array

        Raises
        ------
        UndertowError
            If the run lacks one of them.
        """
        wanted = list(names)
        for name in wanted:
            if not self.has(name):
                have = ", ".join(self.channels) or "no channel"
                raise UndertowError(f"run {self.name!r} has no channel {name!r}: it has {have}")
        return self.known(wanted)

    def known(self, names: Sequence[str]) -> NDArray[np.float64]:
        """Return channels side by side, shape (n, k); zero for one that the run lacks."""
        zero = np.zeros(len(self.t))
        columns = [self.channels.get(name, zero) for name in names]
        return np.column_stack(columns) if columns else np.empty((len(self.t), 0))

    def reports(self, name: str) -> NDArray[np.float64]:
        """Return a channel with NaN in the rows in which it was not measured, shape (n,)."""
        there = self.reported.get(name)
        return self.channels[name] if there is None else np.where(there, self.channels[name], np.nan)

    def rows_per_report(self, name: str) -> float:
        """Return how many rows there are for each report of a channel; 1 where every row is one."""
        there = self.reported.get(name)
        return 1.0 if there is None else len(self.t) / max(int(np.count_nonzero(there)), 1)

    def period(self, name: str) -> float:
        """Return the usual time, s, between reports of a channel."""
        there = self.reported.get(name)
        few = there is None or np.count_nonzero(there) < 2
        return float(np.median(np.diff(self.t if few else self.t[there])))

    @property
    def clock(self) -> NDArray[np.float64]:
        """Times, s, of the measured channel that reports most often: all rows unless each lacks some."""
        every = np.ones(len(self.t), dtype=bool)
        most = max(self.reported.values(), key=np.count_nonzero, default=every)
        whole = not {*self.reported} >= MEASURED.intersection(self.channels)
        return self.t if whole or np.count_nonzero(most) < 2 else self.t[most]

    @cached_property
    def step(self) -> float:
        """Usual time between rows of the clock, s."""
        return float(np.median(np.diff(self.clock)))

    def slice(self, t_min: float | None = None, t_max: float | None = None) -> Run:
        """Return the samples with ``t_min <= t <= t_max`` as a run of its own (None: no limit).

        Raises
        ------
        UndertowError
            If no sample is left.
        """
        low, high = (-np.inf if t_min is None else t_min), (np.inf if t_max is None else t_max)
        keep = (self.t >= low) & (self.t <= high)
        if not keep.any():
            raise UndertowError(
                f"run {self.name!r} has no sample in the time window {low:g} to {high:g} s: "
                f"it lasts from {self.t[0]:g} to {self.t[-1]:g} s"
            )
        return self._rows(keep)

    def head(self, count: int) -> Run:
        """Return the first samples as a run of its own."""
        return self._rows(builtins.slice(count))

    def _rows(self, rows: Flags | builtins.slice) -> Run:
        channels, wrapped = (
            {name: data[rows] for name, data in table.items()} for table in (self.channels, self.wrapped)
        )
        reported = {name: there[rows] for name, there in self.reported.items()}
        return replace(self, t=self.t[rows], channels=channels, wrapped=wrapped, reported=reported)

    def segments(self, names: Iterable[str] = (), *, across: float = 0.0) -> list[builtins.slice]:
        """Return index slices without a time step longer than five usual steps.

        Parameters
        ----------
        names : iterable of str
            If given, a sample where one of these channels is missing also ends a segment.
        across : float
            Time step, s, that ends none, however many usual steps it is.

        Returns
        -------
        list of slice
            In order of time; each holds at least one sample.
        """
        whole = np.asarray(np.isfinite(self.matrix(names)).all(axis=1))
        step = np.diff(self.t)
        usual = max(float(np.median(step)), self.step) if len(step) else 0.0
        together = step <= max(GAPS.steps * usual, across)
        joined = np.concatenate([[False], together & whole[1:] & whole[:-1], [False]])
        starts, stops = np.flatnonzero(whole & ~joined[:-1]), np.flatnonzero(whole & ~joined[1:]) + 1
        return [builtins.slice(int(start), int(stop)) for start, stop in zip(starts, stops, strict=True)]

    def with_notes(self, *notes: str) -> Run:
        """Return the run with lines added to its notes."""
        return replace(self, notes=(*self.notes, *notes))


def _shown(name: str, data: NDArray[np.float64]) -> tuple[object, ...]:
    """Row of a channel for a notebook."""
    there = data[np.isfinite(data)]
    span = tuple(float(x) for x in (there.min(), there.mean(), there.max())) if len(there) else (None,) * 3
    return name, UNITS.get(name, ""), len(there), *span


def unwrapped(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    """An angle without jumps by turns; missing samples stay missing."""
    result, there = angle.copy(), np.isfinite(angle)
    result[there] = np.unwrap(angle[there])
    return result


def _frozen(data: object) -> NDArray[np.float64]:
    array = np.array(data, dtype=float)
    array.setflags(write=False)
    return array
