"""Logs made ready for the weak form: segments without gaps, test functions on them, noise of the channels."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import count

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.identification.logs import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .noise import white_noise
from .polynomial import smooth_rate
from .testfunctions import TestFunctions, boxes, knot_spacing, test_functions

Family = Callable[[Array, float], TestFunctions | None]
# Velocities that a smoother derived from pose have correlated errors; wider functions average over them.
_WIDER_FOR_DERIVED = 2.0
# Knots this many time constants of the smoother apart see next to nothing of what it smooths away: there a
# cubic B-spline has its first zero in frequency.
_KNOTS_PER_RESOLUTION = 2 * np.pi
_BLOCKS = 24
_LONGEST_BLOCK = 5.0
_SHORTEST_BLOCK = 1.0
# Quadrature over samples is not exact, so no channel counts as better known than this share of its change
# in 1 s.
_FINEST = 2e-3
# Standard deviation of a doubted sample, in those of the others: it weighs a thousandth, and the covariance
# of the residual stays well conditioned.
DOUBT = 30.0


@dataclass(frozen=True)
class Segment:
    """A stretch of a run without gaps.

    Attributes
    ----------
    run : int
        Place of the run among the runs.
    first : int
        Index of the first sample in the run.
    t : (N,) array
        Time, s.
    measured : (N, 2n) array
        Pose and velocity of the degrees of freedom; pose that the log lacks is zero.
    u : (N, n_commands) array
        Commands.
    functions : TestFunctions
        Test functions on the segment.
    doubted : (N, 2n) array of bool or None
        Samples that count as hardly known.
    """

    run: int
    first: int
    t: Array
    measured: Array
    u: Array
    functions: TestFunctions
    doubted: NDArray[np.bool_] | None = None

    @property
    def samples(self) -> slice:
        """Where the segment stands in its run."""
        return slice(self.first, self.first + len(self.t))

    @cached_property
    def rate(self) -> Array:
        """Derivative of `measured`, shape (N, 2n), per s; smoothed as far as the noise allows."""
        return smooth_rate(self.t, self.measured)


@dataclass(frozen=True)
class WeakData:
    """Runs prepared for a vehicle's degrees of freedom and commands.

    Attributes
    ----------
    runs : tuple of Run
        The logs.
    segments : tuple of Segment
        Their usable stretches.
    sigma : (2n,) array
        Noise of the channels, in their units.
    rows : tuple of int
        Equations in use, among the 2n: forces (0 to n-1), then pose rates (n to 2n-1).
    names : tuple of str
        Names of the 2n channels.
    commands : tuple of str
        Names of the command columns.
    """

    runs: tuple[Run, ...]
    segments: tuple[Segment, ...]
    sigma: Array
    rows: tuple[int, ...]
    names: tuple[str, ...]
    commands: tuple[str, ...]

    @cached_property
    def derived(self) -> tuple[int, ...]:
        """Velocities among the 2n channels that were taken from the pose, whose noise is known."""
        size = len(self.names) // 2
        taken = [i for i in range(size, 2 * size) if any(self.names[i] in r.derived for r in self.runs)]
        return tuple(i for i in taken if self.sigma[i - size] > 0)

    @property
    def velocities_derived(self) -> bool:
        """Whether all velocities were taken from the pose: no sensor measured them."""
        return len(self.derived) == len(self.names) // 2

    @cached_property
    def equation(self) -> NDArray[np.intp]:
        """Equation of every residual entry."""
        return np.concatenate([np.tile(self.rows, s.functions.count) for s in self.segments])

    @cached_property
    def time(self) -> Array:
        """Middle of the test function of every residual entry, s."""
        return np.concatenate([np.repeat(s.functions.centre, len(self.rows)) for s in self.segments])

    @cached_property
    def run_of(self) -> NDArray[np.intp]:
        """Run of every residual entry."""
        return np.concatenate([np.full(s.functions.count * len(self.rows), s.run) for s in self.segments])

    @cached_property
    def block_seconds(self) -> float:
        """Length of blocks: long against the memory of vehicles, short enough that there are many."""
        total = sum(float(s.t[-1] - s.t[0]) for s in self.segments)
        return float(np.clip(total / _BLOCKS, _SHORTEST_BLOCK, _LONGEST_BLOCK))

    @cached_property
    def block(self) -> NDArray[np.intp]:
        """Number of the time block that every residual entry belongs to; blocks never span two runs."""
        seconds = self.block_seconds
        start = np.array([r.t[0] for r in self.runs])[self.run_of]
        within = ((self.time - start) // seconds).astype(np.intp)
        pairs = np.column_stack([self.run_of, within])
        return np.unique(pairs, axis=0, return_inverse=True)[1].ravel()


def prepare(
    runs: Sequence[Run], vehicle: Vehicle, sigma: Array | None = None, family: Family = test_functions
) -> WeakData:
    """Cut runs into segments and put test functions on them.

    Parameters
    ----------
    runs : sequence of Run
        Logs with the body velocities (and, as far as there, the pose) of the vehicle's degrees of freedom.
    vehicle : Vehicle
        Whose degrees of freedom and commands are wanted.
    sigma : (2n,) array, optional
        Noise of the channels; estimated from the runs where it is not given.
    family : callable
        Makes the test functions on a segment from its times and their spacing: B-splines, or boxes for the
        integral form.

    Raises
    ------
    UndertowError
        If a velocity or a command is missing, or no stretch is long enough.
    """
    names = (*vehicle.pose_names, *vehicle.velocity_names)
    for run in runs:
        _require(run, [*vehicle.velocity_names, *vehicle.command_names], vehicle.name)
    measured_pose = tuple(n for n in vehicle.pose_names if all(r.has(n) for r in runs))
    segments = [
        s for i, run in enumerate(runs) for s in _segments(i, run, names, measured_pose, vehicle, family)
    ]
    if not segments:
        raise UndertowError(_too_short(runs, family))
    derived = any(r.derived for r in runs)
    size = len(vehicle.dof_indices)
    kinematic = [] if derived else [size + i for i, n in enumerate(vehicle.pose_names) if n in measured_pose]
    noise = _floored(channel_noise(runs, names), runs, names) if sigma is None else sigma
    return WeakData(
        tuple(runs), tuple(segments), noise, (*range(size), *kinematic), names, vehicle.command_names
    )


def _too_short(runs: Sequence[Run], family: Family) -> str:
    spacing = max((_spacing(r) for r in runs if len(r.t) > 1), default=0.0)
    step = min((float(np.median(np.diff(r.t))) for r in runs if len(r.t) > 1), default=1.0)
    lengths = ", ".join(f"'{r.name}' {len(r.t)} samples" for r in runs)
    enough = (n for n in count(2) if family(step * np.arange(n, dtype=float), spacing) is not None)
    needed = next(enough) if spacing else 2
    blurred = any(_spacing(r) > knot_spacing(r.t) * _WIDER_FOR_DERIVED for r in runs if len(r.t) > 1)
    form = "integral form" if family is boxes else "weak form"
    why = (
        "; the velocities were taken from a pose that tells nothing of faster motion: "
        "give longer runs, or measured velocities"
    )
    return (
        f"no stretch without gaps is long enough for the {form} (of {lengths}): {needed} samples are "
        f"needed without a gap{why if blurred else ''}"
    )


def _require(run: Run, names: list[str], vehicle: str) -> None:
    for name in names:
        if not run.has(name):
            raise UndertowError(
                f"run '{run.name}' has no channel '{name}', which vehicle '{vehicle}' needs; it has "
                f"{', '.join(run.channels)}; name the column in a mapping file (--map)"
            )


def _segments(
    index: int,
    run: Run,
    names: tuple[str, ...],
    pose: tuple[str, ...],
    vehicle: Vehicle,
    family: Family,
) -> list[Segment]:
    needed = [n for n in names if n in pose or n in vehicle.velocity_names]
    commands = run.matrix(vehicle.command_names)
    spacing = _spacing(run) if len(run.t) > 1 else 1.0
    found = []
    for piece in run.segments([*needed, *vehicle.command_names]):
        t = run.t[piece]
        functions = family(t, spacing) if len(t) > 1 else None
        if functions is not None:
            columns = [run.channels[n][piece] if n in needed else np.zeros(len(t)) for n in names]
            found.append(Segment(index, piece.start, t, np.column_stack(columns), commands[piece], functions))
    return found


def _spacing(run: Run) -> float:
    """Distance of the knots, s."""
    plain = knot_spacing(run.t)
    return max(_WIDER_FOR_DERIVED * plain, _KNOTS_PER_RESOLUTION * run.resolution) if run.derived else plain


def channel_noise(runs: Sequence[Run], names: Sequence[str]) -> Array:
    """Standard deviation of the noise of channels, in their units; zero for a channel that no run has."""
    return np.array([_channel_noise([r for r in runs if r.has(n)], n) for n in names])


def _channel_noise(present: Sequence[Run], name: str) -> float:
    known = [r.sigma[name] for r in present if name in r.sigma]
    found = known or [white_noise(r.t, r.channels[name]) for r in present]
    return float(np.median(found or [0.0]))


def _floored(noise: Array, runs: Sequence[Run], names: Sequence[str]) -> Array:
    """Noise, but at least what the quadrature over samples resolves."""
    change = [[_change_in_a_second(r, n) for r in runs if r.has(n)] for n in names]
    return np.maximum(noise, [_FINEST * float(np.median(c or [0.0])) for c in change])


def _change_in_a_second(run: Run, name: str) -> float:
    """Rms change of a channel from one second to the next."""
    step = float(np.median(np.diff(run.t)))
    lag = int(np.clip(round(1.0 / step), 1, len(run.t) - 1))
    change = run.channels[name][lag:] - run.channels[name][:-lag]
    known = change[np.isfinite(change)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
