"""Logs prepared for the weak form: segments, noise of the channels, and covariances of estimates."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import count, pairwise
from math import comb

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.logs.run import Run, noise_variance, report_noise
from undertow.model.symbols import VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags, Index

from .inputs import held_commands
from .test_functions import (
    Entries,
    Supports,
    TestFunctions,
    banded_sum,
    boxes,
    kink_delay,
    knot_spacing,
    products,
    test_functions,
    weights_and_equation,
)
from .threads import one_thread


# --- covariance of estimates from correlated residuals --------------------------------------------
@dataclass(frozen=True)
class ClusterSettings:
    """Settings that define independent time blocks."""

    correlation_limit: float = 0.3  # autocorrelation below which a series counts as uncorrelated
    white_noise_sigmas: float = 2.0  # the same for short series, in standard deviations of white noise
    cluster_lengths: float = 3.0  # length of an independent cluster in correlation lengths
    fewest: int = 6  # least number of clusters, however long the correlation


CLUSTERS = ClusterSettings()


def inverse_of(information: Array) -> Array:
    """Inverse of an information matrix; a direction that nothing determines gets a very large variance."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), 1e-100))
    scaled = information * np.outer(scale, scale) + 1e-12 * np.eye(len(scale))
    return np.linalg.inv(scaled) * np.outer(scale, scale)


def correlation_length(series: Array) -> int:
    """Lag beyond which a series (K,) is uncorrelated; 1 for white noise."""
    limit = max(CLUSTERS.correlation_limit, CLUSTERS.white_noise_sigmas / np.sqrt(max(len(series), 1)))
    covariance = np.correlate(series, series, "full")[len(series) - 1 :]
    return int(np.argmax(covariance < limit * covariance[0])) or len(series)


def summed_scores(r: Array, J: Array, block: Index) -> Array:
    """J' r of the rows of each block, (blocks, k)."""
    scores = np.zeros((int(block.max(initial=0)) + 1, J.shape[1]))
    np.add.at(scores, block, J * r[:, None])
    return scores


def clustered(information: Array, scores: Array) -> Array:
    """Covariance of an estimate: robust to correlated residuals, and at least that due to noise.

    A sandwich estimator with clusters. `information` is J' J with what priors add; `scores` (groups, k) holds
    J' r of groups of residuals in the order of time. Neighbours are merged into one cluster if their scores
    for a parameter are correlated, as under a slow disturbance.
    """
    inverse = inverse_of(information)
    robust = np.array([_variance(part) for part in (scores @ inverse).T])
    inflation = np.sqrt(np.maximum(1.0, robust / np.maximum(np.diag(inverse), 1e-300)))
    return np.asarray(inverse * np.outer(inflation, inflation))


def _variance(series: Array) -> float:
    """Variance of the sum of a series, from uncorrelated clusters of neighbours."""
    longer = int(CLUSTERS.cluster_lengths * (correlation_length(series) - 1))
    size = max(1, min(longer, len(series) // CLUSTERS.fewest))
    return float(np.sum(np.add.reduceat(series, np.arange(0, len(series), size)) ** 2))


# --- segments and noise ---------------------------------------------------------------------------
@dataclass(frozen=True)
class NoiseSettings:
    """Settings for estimating noise and distinguishing it from motion."""

    # Orders of the differences that white noise is taken from, and samples for each order that a log needs.
    orders: tuple[int, ...] = (3, 4, 5, 6, 7, 8)
    samples_for_order: int = 4
    fewest: int = 10  # differences that a standard deviation is taken from
    even: float = 0.2  # share of the usual step by which a step may be another and count as the same
    # Differences of the lowest order over such steps that give a standard deviation to a tenth; of a
    # short log half of them do.
    consecutive: int = 100
    # Standard errors, in units of 1 / sqrt(samples), by which a higher order has to be lower.
    order_margin: float = 4.0
    # Least noise of a channel, as a share of its change in 1 s: quadrature over samples is not exact.
    least: float = 2e-3
    # Standard deviation of a downweighted sample, in those of the others: its weight is a thousandth, and the
    # covariance of the residual stays well conditioned.
    downweighting: float = 30.0


@dataclass(frozen=True)
class RateSettings:
    """Settings of the local cubics used to estimate rates."""

    widths: tuple[int, ...] = (3, 5, 8, 13, 20, 32)  # half-widths in samples, from narrow to wide
    degree: int = 3
    places: int = 300  # samples at which the widths are tried
    # Square of what a fit leaves, relative to what noise leaves, from which it bends the signal.
    misfit_limit: float = 1.2


@dataclass(frozen=True)
class BlockSettings:
    """Settings for dividing logs: knots of test functions, and independent blocks."""

    # Velocities that a smoother derived from pose have correlated errors; wider functions average over them.
    wider_for_derived: float = 2.0
    # Knots this many time constants of the smoother apart see next to nothing of what it smooths away: there
    # a cubic B-spline has its first zero in frequency.
    knots_per_resolution: float = 2 * np.pi
    # Knots this many times between reports of the slowest velocity apart: values between
    # reports carry no information, and over two of them their noise is nearly white.
    knots_per_report: float = 2.0
    blocks: int = 24
    longest: float = 5.0  # s
    shortest: float = 1.0  # s
    # Bytes that the noise of as many windows as are computed at a time may take.
    bytes: int = 32_000_000
    # Samples of several segments that are evaluated at once: with a thousand numbers each, 32 MB.
    samples: int = 4_000


NOISE, RATES, BLOCKS = NoiseSettings(), RateSettings(), BlockSettings()


def residual_covariance(
    functions: TestFunctions,
    slopes: Entries,
    sigma: Array,
    rows: Sequence[int],
    derived: Sequence[int] = (),
    t: Array | None = None,
) -> Array:
    """Covariance of the weak residual from noise on the measured channels.

    Its lower half in LAPACK's banded storage, (b, K len(rows)), ordered by test function, then by equation.
    `slopes` is the derivative of the 5n pointwise rows in the 2n measured channels, `sigma` their standard
    deviations, (2n,) or (N, 2n), and `rows` the equations in use (forces first, then kinematics). The noise
    of the `derived` channels is that of the pose, differentiated over `t`.
    """
    n, entries = sigma.shape[-1] // 2, _by_equation(slopes, sigma.shape[-1] // 2)
    # The noise of a rate is that of its pose.
    direct = {c: sigma[..., c] for c in range(2 * n) if c not in derived}
    bands = _in_batches(
        functions.supports, rows, direct, lambda w: (w.first, _sensitivity(w, entries, rows, direct))
    )
    if derived and t is not None:
        levels = {c: sigma[..., c - n] for c in derived}
        rates = _in_batches(
            functions.supports,
            rows,
            levels,
            lambda w: (w.first - 1, _differenced(_sensitivity(w, entries, rows, levels), w, t)),
        )
        bands = banded_sum(bands, rates)
    return bands


def _in_batches(
    windows: Supports,
    rows: Sequence[int],
    levels: Mapping[int, Array],
    sensitivity: Callable[[Supports], tuple[Index, Array]],
) -> Array:
    """Products of the rows of all windows, a few windows and those that they overlap at a time."""
    count, width = windows.weights.shape[1:]
    each = 8 * len(rows) * (width + 2) * max(len(levels), 1)
    reach = int(np.max(np.searchsorted(windows.first, windows.first + width + 2) - np.arange(count)))
    piece = max(BLOCKS.bytes // each - reach, reach)
    found = []
    for begin in range(0, count, piece):
        bands = products(*sensitivity(windows.part(slice(begin, begin + piece + reach))))
        found.append(bands[:, : len(rows) * piece])
    deepest = max(map(len, found))
    return np.hstack([np.pad(bands, ((0, deepest - len(bands)), (0, 0))) for bands in found])


def _by_equation(slopes: Entries, n: int) -> list[tuple[int, int, int, Array]]:
    """Which weights, equation and channel each entry belongs to, and its values at the samples."""
    kind, equation = weights_and_equation(slopes.row, n)
    return list(zip(kind, equation, slopes.column, np.ascontiguousarray(slopes.data.T), strict=True))


def _sensitivity(
    windows: Supports,
    entries: list[tuple[int, int, int, Array]],
    rows: Sequence[int],
    levels: Mapping[int, Array],
) -> Array:
    """Sensitivity of each row to the noise of each channel at each sample, (K, rows, W, channels)."""
    row, channel = ({x: i for i, x in enumerate(them)} for them in (rows, levels))
    index = windows.index
    table = np.zeros((len(row), len(channel), *index.shape))
    for kind, i, j, values in entries:
        if i in row and j in channel:
            weights = windows.weights[kind]
            table[row[i], channel[j]] += np.where(weights == 0, 0.0, weights * values[index])
    for j, level in levels.items():
        known = np.where(level > 0, level, 0.0)
        table[:, channel[j]] *= known[index] if known.ndim else known
    return np.ascontiguousarray(table.transpose(2, 0, 3, 1))


def _differenced(sensitivity: Array, windows: Supports, t: Array) -> Array:
    """Sensitivity to a pose from that to its central differences; windows begin a sample earlier."""
    count = len(t)
    after, before = np.minimum(np.arange(count) + 1, count - 1), np.maximum(np.arange(count) - 1, 0)
    step = 1.0 / (t[after] - t[before])
    rate = sensitivity * step[windows.index][:, None, :, None]
    # At its ends a log has no sample on the other side: the last one is used.
    first, last = (np.where(windows.index == end, 1.0, 0.0)[:, None, :, None] for end in (0, count - 1))
    size = list(rate.shape)
    size[2] += 2
    total = np.zeros(size)
    total[:, :, 2:] += rate * (1.0 - last)
    total[:, :, 1:-1] += rate * (last - first)
    total[:, :, :-2] -= rate * (1.0 - first)
    return total


def white_noise(t: Array, y: Array) -> float:
    """Standard deviation of the white noise on a smooth signal, robust to kinks and jumps.

    A difference of order k amplifies white noise by sqrt(binomial(2k, k)) and suppresses smooth parts. The
    lowest order is used, which has the least variance, unless a higher one gives clearly less: then the lower
    one mistakes a fast signal for noise.
    """
    known = noise_by_order(t, y)
    order_margin = 1.0 + NOISE.order_margin / np.sqrt(len(y))
    return next((f for f in known if f <= order_margin * min(known)), 0.0)


def noise_by_order(t: Array, y: Array) -> list[float]:
    """Standard deviation of white noise by differences of increasing order; empty for too few samples.

    Where a clock has hardly two steps alike in a row, by divided differences.
    """
    orders = [k for k in NOISE.orders if len(y) > NOISE.samples_for_order * k]
    if not orders:
        return []
    steps, there = np.diff(t), np.isfinite(y)
    even = np.abs(steps - np.median(steps)) < NOISE.even * np.median(steps)
    if np.count_nonzero(_over_even_steps(even, orders[0])) < min(NOISE.consecutive, len(y) // 2):
        return [report_noise(t[there], y[there], k) for k in orders]
    found = [_by_difference(y, even, k) for k in orders]
    return [f for f in found if np.isfinite(f)]


def _over_even_steps(even: Flags, order: int) -> Flags:
    """Which differences of an order are over even steps."""
    return np.convolve(even, np.ones(order), mode="valid") > order - 0.5


def _by_difference(y: Array, even: Flags, order: int) -> float:
    difference = np.diff(y, n=order)
    kept = difference[_over_even_steps(even, order) & np.isfinite(difference)]
    if len(kept) < NOISE.fewest:
        return np.inf
    return float(np.sqrt(noise_variance(kept) / comb(2 * order, order)))


def samples_around(at: Index, width: int, count: int) -> Index:
    """Indices of the 2 width + 1 samples around each instant, moved inwards at the ends of the signal."""
    first = np.clip(at - width, 0, count - 2 * width - 1)
    return np.asarray(first[:, None] + np.arange(2 * width + 1))


def local_polynomial(t: Array, y: Array, at: Index, width: int, degree: int) -> tuple[Array, Array, Array]:
    """Least squares fit of a polynomial to the 2 width + 1 samples around some samples of a signal.

    `t` (N,) in s, `y` (N, c) without gaps, `at` (k,). Returns values, rates per s and sums of squared errors
    there, each (k, c).
    """
    near = samples_around(at, width, len(t))
    span = t[near[:, -1]] - t[near[:, 0]]
    place = (t[near] - t[at][:, None]) / span[:, None]
    design = place[:, :, None] ** np.arange(degree + 1)
    across = np.swapaxes(design, 1, 2)
    # Around the sample itself, so that a large offset (a position) costs no digits.
    samples = y[near] - y[at][:, None]
    coefficients = np.linalg.solve(across @ design, across @ samples)
    misfit = np.sum((samples - design @ coefficients) ** 2, axis=1)
    return y[at] + coefficients[:, 0], coefficients[:, 1] / span[:, None], misfit


def smooth_rate(t: Array, y: Array) -> Array:
    """Derivative (N, c), per s, of noisy signals by cubics over as many samples as fit within the noise."""
    if len(t) <= 2 * RATES.widths[0]:
        return np.gradient(y, t, axis=0)
    rate, every = np.empty_like(y), np.arange(len(t))
    width = _widest_fit(t, y)
    for chosen in np.unique(width).tolist():
        columns = np.flatnonzero(width == chosen)
        rate[:, columns] = local_polynomial(t, y[:, columns], every, chosen, RATES.degree)[1]
    return rate


def _widest_fit(t: Array, y: Array) -> Index:
    """Half-width of the widest fits that leave only noise at most instants, by signal."""
    noise = np.array([white_noise(t, column) for column in y.T])
    some = np.unique(np.linspace(0, len(t) - 1, RATES.places).astype(np.intp))
    found = np.full(y.shape[1], RATES.widths[0])
    for width in (w for w in RATES.widths if 2 * w < len(t)):
        misfit = local_polynomial(t, y, some, width, RATES.degree)[2]
        found[np.median(misfit, axis=0) <= RATES.misfit_limit * noise**2 * (2 * width - RATES.degree)] = width
    return found


Family = Callable[[Array, float], TestFunctions | None]


@dataclass(frozen=True)
class Segment:
    """A segment of a run without gaps."""

    run: int  # Place of the run among the runs
    first: int  # Index of the first sample in the run
    t: Array  # (N,) time, s
    measured: Array  # (N, 2n) pose and velocity of the degrees of freedom; pose that the log lacks is zero
    u: Array  # (N, n_commands) commands
    functions: TestFunctions  # Test functions on the segment
    downweighted: Flags | None = None  # (N, 2n) samples with a larger standard deviation
    reported: Flags | None = None  # (N, 2n) samples that were measured; None: all

    @property
    def samples(self) -> slice:
        """Where the segment stands in its run."""
        return slice(self.first, self.first + len(self.t))

    def reports(self, channel: int) -> Index:
        """Samples in which a channel was measured."""
        return np.arange(len(self.t)) if self.reported is None else np.flatnonzero(self.reported[:, channel])

    def noise(self, sigma: Array) -> Array:
        """White noise in every sample equivalent, in means, to noise `sigma` (2n,) of the reports.

        Values between reports carry no information. Shape (2n,), or (N, 2n) if samples are down-weighted.
        """
        if self.reported is not None:
            sigma = sigma * np.sqrt(len(self.t) / np.maximum(np.count_nonzero(self.reported, axis=0), 1))
        flags = self.downweighted
        return sigma if flags is None else np.where(flags, NOISE.downweighting, 1.0) * sigma

    @cached_property
    def kink_delay(self) -> Array:
        """How much later than at its sample a signal with a kink has to be read, (N, 1), s."""
        return kink_delay(self.t)[:, None]

    @cached_property
    def rate(self) -> Array:
        """Derivative of `measured`, shape (N, 2n), per s; smoothed as far as the noise allows."""
        return smooth_rate(self.t, self.measured)


@dataclass(frozen=True)
class WeakData:
    """Runs prepared for a vehicle's degrees of freedom and commands."""

    runs: tuple[Run, ...]
    segments: tuple[Segment, ...]  # Their usable segments
    sigma: Array  # (2n,) noise of the channels, in their units
    rows: tuple[int, ...]  # Equations in use, among the 2n: forces (0 to n-1), then pose rates (n to 2n-1)
    names: tuple[str, ...]  # Names of the 2n channels
    commands: tuple[str, ...]  # Names of the command columns

    @cached_property
    def derived(self) -> tuple[int, ...]:
        """Velocities among the 2n channels that were derived from the pose, with known noise."""
        size = len(self.names) // 2
        taken = [i for i in range(size, 2 * size) if any(self.names[i] in r.derived for r in self.runs)]
        return tuple(i for i in taken if self.sigma[i - size] > 0)

    @property
    def derived_names(self) -> tuple[str, ...]:
        """Velocities derived from the pose, which no sensor measured."""
        return tuple(self.names[i] for i in self.derived)

    @property
    def names_without_pose(self) -> tuple[str, ...]:
        """Velocities whose pose coordinate was not measured."""
        size = len(self.names) // 2
        pairs = zip(self.names[:size], self.names[size:], strict=True)
        return tuple(v for pose, v in pairs if not all(r.has(pose) for r in self.runs))

    @cached_property
    def held(self) -> list[Array]:
        """Commands in every run, as `held_commands` gives them."""
        return held_commands(self.runs, self.commands)

    @cached_property
    def batches(self) -> list[tuple[slice, Supports]]:
        """Neighbouring segments that are evaluated at once, and their test functions in one row."""
        before = np.cumsum([0, *(len(s.t) for s in self.segments)])
        edges = [0]
        for i in range(1, len(self.segments)):
            if before[i + 1] - before[edges[-1]] > BLOCKS.samples:
                edges.append(i)
        parts = [slice(i, j) for i, j in pairwise([*edges, len(self.segments)])]
        return [(p, Supports.joined([s.functions.supports for s in self.segments[p]])) for p in parts]

    @cached_property
    def equation(self) -> Index:
        """Equation of every residual entry."""
        return np.concatenate([np.tile(self.rows, s.functions.count) for s in self.segments])

    @cached_property
    def time(self) -> Array:
        """Middle of the test function of every residual entry, s."""
        return np.concatenate([np.repeat(s.functions.centre, len(self.rows)) for s in self.segments])

    @cached_property
    def run_of(self) -> Index:
        """Run of every residual entry."""
        return np.concatenate([np.full(s.functions.count * len(self.rows), s.run) for s in self.segments])

    @cached_property
    def seconds(self) -> float:
        """Length of all segments together."""
        return sum(float(s.t[-1] - s.t[0]) for s in self.segments)

    @cached_property
    def block_seconds(self) -> float:
        """Length of blocks: long compared with time constants of vehicles, short enough for many blocks."""
        return float(np.clip(self.seconds / BLOCKS.blocks, BLOCKS.shortest, BLOCKS.longest))

    @cached_property
    def block(self) -> Index:
        """Number of the time block that every residual entry belongs to; blocks never span two runs."""
        return self.blocks_of(self.block_seconds)

    def blocks_of(self, seconds: float) -> Index:
        """The same with blocks of another length."""
        start = np.array([r.t[0] for r in self.runs])[self.run_of]
        return blocks_of_time(self.time - start, seconds, self.run_of)

    def uncorrelated_seconds(self, series: Array) -> float:
        """Length of blocks, s, between which a series (K,) by test function is uncorrelated, if there are
        enough of them.
        """
        steps = np.diff(self.time[:: len(self.rows)])
        step = float(np.median(steps)) if len(steps) else 0.0  # a single value is correlated with none
        seconds = CLUSTERS.cluster_lengths * correlation_length(series) * step
        return min(max(self.block_seconds, seconds), self.seconds / CLUSTERS.fewest)


def group_numbers(*columns: Index | Array) -> Index:
    """Number of the group of each row, rows that are the same in all columns being one group."""
    order = np.lexsort(columns[::-1])
    differs = np.any([np.diff(np.asarray(c)[order]) != 0 for c in columns], axis=0)
    found = np.empty(len(order), dtype=np.intp)
    found[order] = np.concatenate([[0], np.cumsum(differs)])[: len(order)]
    return found


def blocks_of_time(since: Array, seconds: float, *piece: Index | Array) -> Index:
    """Number of the block of time of each entry, by the time since its piece began, s; no block spans two."""
    return group_numbers(*piece, since // seconds)


def measured_pose(vehicle: Vehicle, runs: Sequence[Run]) -> tuple[str, ...]:
    """Pose channels of a vehicle that all runs have."""
    return tuple(n for n in vehicle.pose_names if all(r.has(n) for r in runs))


@one_thread()
def prepare(
    runs: Sequence[Run], vehicle: Vehicle, sigma: Array | None = None, family: Family = test_functions
) -> WeakData:
    """Cut runs into segments and place test functions on them: B-splines, or boxes for the integral form.

    `sigma`, shape (2n,), is the noise of the channels, estimated from the runs if not given.
    """
    names = (*vehicle.pose_names, *vehicle.velocity_names)
    for run in runs:
        _require_channels(run, [*vehicle.velocity_names, *vehicle.command_names], vehicle.name)
    pose = measured_pose(vehicle, runs)
    segments = [s for i, run in enumerate(runs) for s in _segments(i, run, names, pose, vehicle, family)]
    if not segments:
        channels = [*pose, *vehicle.velocity_names, *vehicle.command_names]
        raise UndertowError(_too_short(runs, channels, family))
    derived = any(r.derived for r in runs)
    size = len(vehicle.dof_indices)
    kinematic = [] if derived else [size + i for i, n in enumerate(vehicle.pose_names) if n in pose]
    noise = _floored(channel_noise(runs, names), runs, names) if sigma is None else sigma
    return WeakData(
        tuple(runs), tuple(segments), noise, (*range(size), *kinematic), names, vehicle.command_names
    )


def _too_short(runs: Sequence[Run], names: Sequence[str], family: Family) -> str:
    """Why runs, without a gap in these channels, hold no test function, with what they have and need."""
    spacing = max((_spacing(r) for r in runs if len(r.t) > 1), default=0.0)
    step = min((r.step for r in runs if len(r.t) > 1), default=1.0)
    enough = (n for n in count(2) if family(step * np.arange(n, dtype=float), spacing) is not None)
    needed = next(enough) if spacing else 2
    gap_free = [
        (int(np.count_nonzero((r.clock >= t[0]) & (r.clock <= t[-1]))), r)
        for r in runs
        for t in (*(r.t[p] for p in r.segments([*names])), np.array([np.inf]))
    ]
    longest, run = max(gap_free, key=lambda stretch: stretch[0])
    form = "integral form" if family is boxes else "weak form"
    why, remedy = "", ""
    if any(_spacing(r) > knot_spacing(r.clock) * BLOCKS.wider_for_derived for r in runs if len(r.t) > 1):
        slowest = max(r.resolution for r in runs)
        late = max(r.period(n) for r in runs for n in VELOCITY if n in r.channels)
        why = (
            f", since velocities were derived from the pose with a time constant of {slowest:.3g} s"
            if any(r.derived for r in runs)
            else f", since velocities are reported every {late:.3g} s"
        )
        remedy = ", or measured velocities" if any(r.derived for r in runs) else ""
    if run.part_of:
        remedy += ", or a run for validation, for which part of this one is set aside (--validation)"
    return (
        f"too few samples without a gap for the {form}: the longest stretch has {longest} (of "
        f"{len(run.clock)} in '{run.name}'), and {needed} are needed ({step * (needed - 1):.3g} s{why}): "
        f"give a log with a longer stretch{remedy}"
    )


def _require_channels(run: Run, names: list[str], vehicle: str) -> None:
    for name in names:
        if not run.has(name):
            raise UndertowError(
                f"run '{run.name}' has no channel '{name}', which vehicle '{vehicle}' needs; the run has "
                f"{', '.join(run.channels)}; name the column in a mapping file (--map), or, from Python, "
                "give read_log commands=vehicle.command_names"
            )


def _segments(
    index: int, run: Run, names: tuple[str, ...], pose: tuple[str, ...], vehicle: Vehicle, family: Family
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
            cut = Segment(index, piece.start, t, np.column_stack(columns), commands[piece], functions)
            found.append(replace(cut, reported=_reported(run, names, piece)))
    return found


def _reported(run: Run, names: Sequence[str], piece: slice) -> Flags | None:
    """Which samples of channels are reports; None if all are."""
    if not any(n in run.reported for n in names):
        return None
    every = np.ones(len(run.t), dtype=bool)
    return np.column_stack([run.reported.get(n, every)[piece] for n in names])


def _spacing(run: Run) -> float:
    """Distance of the knots, s."""
    plain = knot_spacing(run.clock)
    slowest = max((run.period(n) for n in VELOCITY if n in run.reported), default=0.0)
    plain = max(plain, BLOCKS.knots_per_report * slowest)
    if not run.derived:
        return plain
    return max(BLOCKS.wider_for_derived * plain, BLOCKS.knots_per_resolution * run.resolution)


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
    return np.maximum(noise, [NOISE.least * float(np.median(c or [0.0])) for c in change])


def _change_in_a_second(run: Run, name: str) -> float:
    """Rms change of a channel from one second to the next."""
    step = float(np.median(np.diff(run.t)))
    lag = int(np.clip(round(1.0 / step), 1, len(run.t) - 1))
    change = run.channels[name][lag:] - run.channels[name][:-lag]
    known = change[np.isfinite(change)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
