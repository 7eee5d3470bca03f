"""Body velocities for logs that have only pose, by a Rauch-Tung-Striebel smoother."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from math import factorial

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.model.symbols import DOFS, POSE, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags

from .mapping import to_body
from .run import SERIES, UNITS, Run, with_reports

ORDER = 3  # position, velocity, acceleration


@dataclass(frozen=True)
class SmootherSettings:
    """How pose is smoothed."""

    # Variance of the state before the first sample, in squared standard deviations of the noise.
    diffuse: float = 1e10
    # Samples at the start of a lane that depend more on `diffuse` than on the ratio.
    burn_in: int = 2 * ORDER
    # Decades of ratio that are searched. Above the last the noise is negligible beside the motion of one
    # step.
    lowest_decade: float = -13.0
    highest_decade: float = 3.0
    # Share by which every predicted variance is raised: more than the rounding errors where one wide step
    # after a diffuse start leaves all three variances in one direction, and little beside the noise.
    rounding: float = 1e-14
    outlying: float = 100.0  # squared innovation, over the typical one, that counts in full
    lost: float = 0.5  # s without a sample after which tracking is lost: the motion in between is unknown
    lost_steps: float = 4.0  # or this many usual steps, for slow logs
    core: int = 1000  # samples of a lane that are kept
    likely_lanes: int = 6  # lanes of which the likelihood is computed
    # Ratios that are tried in the two decades about the likeliest one; how many times the lanes of which the
    # likelihood is computed the long pieces are that they are spread over.
    fine: int = 17
    pieces_per_lane: int = 4
    # Samples by which pieces overlap: time constants of the smoother, and limits.
    overlap: int = 12
    overlaps: tuple[int, int] = (30, 1000)
    informative: float = 1e-6  # share of a variance that is no rounding
    small: float = 0.01  # share of the median change between samples: a negligible error
    limit: float = 6.0  # robust standard deviations beyond which a sample is an outlier
    rounds: int = 40  # of the removal of outliers
    separation: int = 3  # smallest distance, in samples, of outliers and jumps that one round finds
    # That distance in time constants of the smoother, and the largest, in smallest ones.
    separation_constants: int = 4
    separations: int = 20
    # Single outliers before anything is smoothed: usual steps in which a sample and its four neighbours lie,
    # how many times `limit` they stand out, how many median changes, by which factor from their neighbours.
    gross_steps: float = 6.0
    gross: float = 5.0
    gross_changes: float = 2.0
    gross_factor: float = 1.25
    least_own: float = 1e-3  # variance of a residual, in that of the noise, at least
    estimates: int = 6  # of the noise, again after the removal of outliers
    # Share of samples that may be outliers or shifts. Every one that is removed lowers the estimate of the
    # noise, so that more stand out: beyond this share they are the noise, not exceptions to it.
    exceptions: float = 0.1
    lanes_at_once: int = 96
    uncertain: float = 10.0  # times the median standard deviation: such a rate is discarded
    fewest: int = 10  # samples of a pose channel
    still: float = 1e-9  # change of a channel, as a share of its size, that is rounding
    # Standard deviations that a rate exceeds in some share of the samples where a channel shows motion: noise
    # alone exceeds 2.3 of them in that share.
    shown: float = 3.0
    shown_share: float = 0.02


SETTINGS = SmootherSettings()


@dataclass(frozen=True)
class Lanes:
    """Intervals of samples side by side, the short ones padded with missing samples."""

    y: Array  # (n, lanes) measured values, NaN where there is none
    step: Array  # (n, lanes) time since the sample before, in units of the usual step
    # (n, lanes) where the value may have been shifted, by any amount, since the sample before (its
    # derivatives carry on).
    jump: NDArray[np.bool_]


@dataclass(frozen=True)
class States:
    """Value and its first two derivatives per step."""

    mean: Array  # (n, lanes, 3) estimates
    covariance: Array  # (n, lanes, 3, 3) covariance of `mean`, divided by the noise variance


def _transition(step: Array) -> Array:
    """Return the (..., 3, 3) transition over `step`."""
    result = np.zeros((*step.shape, ORDER, ORDER))
    for row in range(ORDER):
        for column in range(row, ORDER):
            result[..., row, column] = step ** (column - row) / factorial(column - row)
    return result


def _process(step: Array, ratio: Array) -> Array:
    """Return the (..., 3, 3) covariance that white jerk adds over `step`."""
    result = np.empty((*step.shape, ORDER, ORDER))
    for row in range(ORDER):
        for column in range(ORDER):
            power = 2 * ORDER - 1 - row - column
            size = power * factorial(ORDER - 1 - row) * factorial(ORDER - 1 - column)
            result[..., row, column] = ratio * step**power / size
    return result


@dataclass(frozen=True)
class _Filtered:
    """The filter's state after each sample and before it, its innovations and their variances."""

    after: States
    before: States
    innovation: Array
    variance: Array


def _filter(lanes: Lanes, ratio: Array) -> _Filtered:
    n, count = lanes.y.shape
    there = np.isfinite(lanes.y)
    measured = np.where(there, lanes.y, 0.0)
    before, after = (
        States(np.empty((n, count, ORDER)), np.empty((n, count, ORDER, ORDER))) for _ in range(2)
    )
    mean = np.zeros((count, ORDER))
    mean[:, 0] = measured[np.argmax(there, axis=0), np.arange(count)]
    covariance = np.broadcast_to(SETTINGS.diffuse * np.eye(ORDER), (count, ORDER, ORDER))
    transition, process = _transition(lanes.step), _process(lanes.step, ratio)
    process[..., 0, 0] += np.where(lanes.jump, SETTINGS.diffuse, 0.0)
    for k in range(n):
        if k:
            mean = (transition[k] @ mean[..., None])[..., 0]
            covariance = transition[k] @ covariance @ transition[k].swapaxes(-1, -2) + process[k]
            covariance = covariance * (1.0 + SETTINGS.rounding * np.eye(ORDER))
        before.mean[k], before.covariance[k] = mean, covariance
        variance = covariance[:, 0, 0] + 1.0
        gain = covariance[:, :, 0] * (there[k] / variance)[:, None]
        mean = mean + gain * (measured[k] - mean[:, 0])[:, None]
        seen = covariance[:, 0] * np.where(there[k], 1.0 / variance, 1.0)[:, None]
        covariance = covariance - gain[:, :, None] * gain[:, None, :] * variance[:, None, None]
        # The same numbers without cancellation: after a jump it would be the difference of two 1e10.
        covariance[:, 0], covariance[:, :, 0] = seen, seen
        after.mean[k], after.covariance[k] = mean, covariance
    return _Filtered(after, before, lanes.y - before.mean[..., 0], before.covariance[..., 0, 0] + 1.0)


def smooth(lanes: Lanes, ratio: Array) -> tuple[States, Array]:
    """Return the states given all samples of their lane, and the evidence for a jump at each, (n, lanes).

    The latter is the estimated jump since the sample before over its standard error, times the standard
    deviation of the noise (de Jong and Penzer, J. Am. Stat. Assoc. 93, 1998, 796-806). `ratio` (lanes,) is
    jerk intensity * step^5 / noise variance.
    """
    filtered = _filter(lanes, ratio)
    after, before = filtered.after, filtered.before
    transition = _transition(lanes.step)[1:]
    # gain = P F' inv(P before next); solved for its transpose because both covariances are symmetric
    gain = np.linalg.solve(before.covariance[1:], transition @ after.covariance[:-1]).swapaxes(-1, -2)
    mean, covariance = after.mean.copy(), after.covariance.copy()
    for k in range(len(mean) - 2, -1, -1):
        mean[k] += (gain[k] @ (mean[k + 1] - before.mean[k + 1])[..., None])[..., 0]
        covariance[k] += gain[k] @ (covariance[k + 1] - before.covariance[k + 1]) @ gain[k].swapaxes(-1, -2)
    smoothed = States(mean, covariance)
    return smoothed, _jump_statistics(before, smoothed)


def _jump_statistics(before: States, smoothed: States) -> Array:
    pull = np.linalg.solve(before.covariance, np.eye(ORDER)[:, :1])[..., 0]
    shock = (pull * (smoothed.mean - before.mean)).sum(axis=-1)
    variance = pull[..., 0] - (pull * (smoothed.covariance @ pull[..., None])[..., 0]).sum(axis=-1)
    # The rest is rounding: no information since the sample before.
    known = variance > SETTINGS.informative * pull[..., 0]
    return np.divide(shock, np.sqrt(np.where(known, variance, 1.0)), where=known, out=np.zeros_like(shock))


def most_likely_ratio(lanes: Lanes) -> tuple[float, float]:
    """Return the ratio most likely for lanes of one signal, and the noise variance that goes with it."""
    decades = np.arange(SETTINGS.lowest_decade, SETTINGS.highest_decade + 1.0)
    coarse = _profile(lanes, decades)
    best = decades[np.argmin(coarse[0])]
    fine = np.linspace(best - 1.0, best + 1.0, SETTINGS.fine)
    cost, variance = _profile(lanes, np.minimum(fine, SETTINGS.highest_decade))
    at = int(np.argmin(cost))
    return float(10.0 ** min(fine[at], SETTINGS.highest_decade)), float(variance[at])


def _profile(lanes: Lanes, decades: Array) -> tuple[Array, Array]:
    """Return -2 log likelihood, and the noise variance, at each ratio, all ratios filtered side by side."""
    grid, count = len(decades), lanes.y.shape[1]
    tiled = Lanes(np.tile(lanes.y, grid), np.tile(lanes.step, grid), np.tile(lanes.jump, grid))
    filtered = _filter(tiled, np.repeat(10.0**decades, count))
    seen = np.cumsum(np.isfinite(tiled.y), axis=0)
    use = np.isfinite(tiled.y) & (seen > SETTINGS.burn_in)
    new = use & (np.diff(tiled.y, axis=0, prepend=np.nan) != 0.0)
    if SETTINGS.fewest * grid <= np.sum(new) < np.sum(use) / 2:  # few digits, mostly at rest: where it is new
        use = new
    square = np.where(use, filtered.innovation**2 / filtered.variance, np.nan).reshape(-1, grid, count)
    typical = np.nanmedian(square, axis=(0, 2)) / 0.455
    square = np.nansum(np.minimum(square, SETTINGS.outlying * typical[:, None]), axis=(0, 2))
    spread = np.where(use, np.log(filtered.variance), 0.0).reshape(-1, grid, count).sum(axis=(0, 2))
    number = max(int(use[:, :count].sum()), 1)
    variance = np.maximum(square / number, np.finfo(float).tiny)
    return number * np.log(variance) + spread, variance


Interval = tuple[int, int]


@dataclass(frozen=True)
class Track:
    """A smoothed signal."""

    # value, rate: (n,) the signal and its time derivative; the rate is NaN where tracking was lost.
    value: Array
    rate: Array
    # value_sd, rate_sd: (n,) standard deviations of both.
    value_sd: Array
    rate_sd: Array
    outlier: Flags  # (n,) samples that were rejected
    # (n,) samples where the signal was shifted since the sample before (a change of camera, a new
    # satellite).
    jump: Flags
    lost: list[tuple[float, float]]  # start and end in s of the times without samples
    noise: float  # standard deviation of the measurement noise
    # Time constant of the smoother in s: its gain for a sine of angular frequency w is 1 / (1 + (w
    # resolution)^6).
    resolution: float
    signal: _Signal  # the samples that were smoothed

    @property
    def shows_motion(self) -> bool:
        """Whether the rate stands out of its own uncertainty."""
        known = np.isfinite(self.rate)
        if not known.any():
            return False
        size = np.abs(self.rate[known]) / np.maximum(self.rate_sd[known], np.finfo(float).tiny)
        return bool(np.quantile(size, 1.0 - SETTINGS.shown_share) > SETTINGS.shown)

    def no_slower(self, resolution: float, y: Array) -> Track:
        """The same of samples y with a time constant of at most so many s, and more noise in the rate."""
        if not self.resolution > resolution:
            return self
        ratio = (_median_step(self.signal.t) / resolution) ** (2 * ORDER)
        return _track_of(self.signal, y, ratio, self.noise**2, self.signal.smoothed(ratio)[0])

    def shifts(self, t: Array, reports: Array) -> Array:
        """Size of every shift, and the seconds since the report before, (k, 2)."""
        at, seen = np.flatnonzero(self.jump), np.flatnonzero(np.isfinite(reports))
        before = seen[np.maximum(np.searchsorted(seen, at) - 1, 0)]
        return np.column_stack([np.abs(self.value[at] - self.value[at - 1]), t[at] - t[before]])


@dataclass
class _Signal:
    """The samples that are accepted so far, and the jumps found."""

    t: Array
    y: Array
    jump: Flags

    def _breaks(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        index = np.flatnonzero(np.isfinite(self.y))
        step = np.diff(self.t[index])
        return index, np.flatnonzero(step > max(SETTINGS.lost, SETTINGS.lost_steps * float(np.median(step))))

    def lost(self) -> list[tuple[float, float]]:
        """Return the times without a sample for too long, at the ends of the signal too."""
        index, breaks = self._breaks()
        spells = [(float(self.t[index[k]]), float(self.t[index[k + 1]])) for k in breaks]
        ends = [(float(self.t[0]), float(self.t[index[0]])), (float(self.t[index[-1]]), float(self.t[-1]))]
        before, after = ([spell] if spell[1] - spell[0] > SETTINGS.lost else [] for spell in ends)
        return before + spells + after

    def intervals(self) -> list[Interval]:
        """Return the intervals between them, without those too short for a rate."""
        index, breaks = self._breaks()
        parts = [part for part in np.split(index, breaks + 1) if len(part) > 2 * ORDER]
        if not parts:
            raise ValueError(
                f"no {2 * ORDER + 1} samples without a gap of more than {SETTINGS.lost:g} s between them"
            )
        return [(int(part[0]), int(part[-1]) + 1) for part in parts]

    def lanes(self, cuts: list[Interval]) -> Lanes:
        step = np.diff(self.t, prepend=self.t[0]) / _median_step(self.t)
        shape = (max(stop - start for start, stop in cuts), len(cuts))
        result = Lanes(np.full(shape, np.nan), np.ones(shape), np.zeros(shape, dtype=bool))
        for lane, (start, stop) in enumerate(cuts):
            for part, whole in ((result.y, self.y), (result.step, step), (result.jump, self.jump)):
                part[: stop - start, lane] = whole[start:stop]
        return result

    def likely(self) -> tuple[float, float]:
        """Return ratio and noise variance, from some long pieces spread over the signal."""
        cuts = sorted(_cut(self.intervals(), SETTINGS.core), key=lambda cut: cut[0] - cut[1])[
            : SETTINGS.pieces_per_lane * SETTINGS.likely_lanes
        ]
        spread = np.linspace(0, len(cuts) - 1, min(SETTINGS.likely_lanes, len(cuts))).round().astype(int)
        return most_likely_ratio(self.lanes([cuts[k] for k in spread]))

    def smoothed(self, ratio: float) -> tuple[States, Array]:
        """Smooth all intervals, long ones in pieces that overlap by many time constants of the smoother."""
        overlap = int(np.clip(SETTINGS.overlap * ratio ** (-1 / (2 * ORDER)), *SETTINGS.overlaps))
        cores = [
            (core, interval)
            for interval in self.intervals()
            for core in _cut([interval], max(SETTINGS.core, 2 * overlap))
        ]
        wide = [
            (max(low, start - overlap), min(high, stop + overlap)) for (start, stop), (low, high) in cores
        ]
        n = len(self.y)
        mean, covariance, shock = (np.full(shape, np.nan) for shape in ((n, ORDER), (n, ORDER, ORDER), (n,)))
        for first in range(0, len(cores), SETTINGS.lanes_at_once):
            group = range(first, min(first + SETTINGS.lanes_at_once, len(cores)))
            state, shocks = smooth(self.lanes([wide[k] for k in group]), np.full(len(group), ratio))
            for lane, k in enumerate(group):
                (start, stop), skip = cores[k][0], wide[k][0]
                for whole, part in ((mean, state.mean), (covariance, state.covariance), (shock, shocks)):
                    whole[start:stop] = part[start - skip : stop - skip, lane]
        return States(mean, covariance), shock


def track(t: Array, y: Array) -> Track:
    """Smooth a signal and take its rate."""
    signal = _Signal(t, y.copy(), np.zeros(len(y), dtype=bool))
    signal.y[_gross_outliers(t, y)] = np.nan
    for _ in range(SETTINGS.estimates):
        ratio, variance = signal.likely()
        changed, state = _cleaned(
            signal, ratio, max(float(np.sqrt(variance)), SETTINGS.small * _median_change(y))
        )
        if np.sum(np.isnan(signal.y) & np.isfinite(y) | signal.jump) > SETTINGS.exceptions * len(y):
            signal = _Signal(t, y.copy(), np.zeros(len(y), dtype=bool))
            ratio, variance = signal.likely()
            state = signal.smoothed(ratio)[0]
            break
        if not changed:
            break
    return _track_of(signal, y, ratio, variance, state)


def _track_of(signal: _Signal, y: Array, ratio: float, variance: float, state: States) -> Track:
    """What is known of samples y once the accepted ones of them are smoothed."""
    step = _median_step(signal.t)
    spread = np.sqrt(variance * np.maximum(np.diagonal(state.covariance, axis1=-2, axis2=-1), 0.0))
    rate, rate_sd = state.mean[:, 1] / step, spread[:, 1] / step
    unknown = ~(rate_sd <= SETTINGS.uncertain * np.nanmedian(rate_sd))
    rate[unknown] = rate_sd[unknown] = np.nan
    outlier = np.isnan(signal.y) & np.isfinite(y)
    return Track(
        state.mean[:, 0],
        rate,
        spread[:, 0],
        rate_sd,
        outlier,
        signal.jump,
        signal.lost(),
        float(np.sqrt(variance)),
        step * ratio ** (-1 / (2 * ORDER)),
        signal,
    )


def _median_step(t: Array) -> float:
    return float(np.median(np.diff(t)))


def _median_change(y: Array) -> float:
    return float(np.median(np.abs(np.diff(y[np.isfinite(y)]))))


def _gross_outliers(t: Array, y: Array) -> Flags:
    """Find single gross outliers by comparing each sample with the cubic through its four neighbours."""
    # They would spoil the likelihood. A shift deviates equally on either side and is not one of them.
    index = np.flatnonzero(np.isfinite(y))
    seen, result = y[index], np.zeros(len(y), dtype=bool)
    if len(seen) < 2 * ORDER:
        return result
    close = t[index[4:]] - t[index[:-4]] < SETTINGS.gross_steps * _median_step(t[index])
    deviation = np.zeros(len(seen))
    deviation[2:-2] = np.abs(seen[2:-2] - (4 * (seen[1:-3] + seen[3:-1]) - seen[:-4] - seen[4:]) / 6) * close
    usual = SERIES.gaussian_mad * float(np.median(deviation[2:-2]))
    limit = max(SETTINGS.gross * SETTINGS.limit * usual, SETTINGS.gross_changes * _median_change(y))
    neighbours = np.maximum(np.roll(deviation, 1), np.roll(deviation, -1))
    alone = deviation > SETTINGS.gross_factor * neighbours
    result[index[_peaks(deviation, limit, SETTINGS.separation) & alone]] = True
    return result


def _peaks(size: Array, limit: float, separation: int) -> Flags:
    """Entries above the limit that are the largest among `separation` neighbours on either side."""
    padded = np.pad(size, separation, constant_values=-np.inf)
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * separation + 1).max(axis=-1)
    return (size > limit) & (size >= around) & (limit > 0)


def _cleaned(signal: _Signal, ratio: float, noise: float) -> tuple[bool, States]:
    """Remove samples that cannot be motion, the worst of each neighbourhood first, until none stands out."""
    # An outlier or a shift changes the smoothed signal on both sides, over the time constant of the smoother.
    least, constant = SETTINGS.separation, ratio ** (-1 / (2 * ORDER))
    separation = int(np.clip(SETTINGS.separation_constants * constant, least, SETTINGS.separations * least))
    changed = False
    for _ in range(SETTINGS.rounds):
        state, shock = signal.smoothed(ratio)
        outlier, jump = _outliers_and_jumps(signal, state, shock, noise, separation)
        if not (outlier | jump).any():
            break
        changed = True
        signal.y[outlier] = np.nan
        signal.jump |= jump
    return changed, state


def _outliers_and_jumps(
    signal: _Signal, state: States, shock: Array, noise: float, separation: int
) -> tuple[Flags, Flags]:
    """Outliers and jumps: at each peak, the one of the two that explains more."""
    residual = np.nan_to_num(signal.y - state.mean[:, 0])
    # the residual of a sample has variance 1 - P; over its square root it is the deletion residual,
    # standardised
    own = np.nan_to_num(1.0 - state.covariance[:, 0, 0], nan=1.0)
    deletion_residual = np.abs(residual) / np.sqrt(np.maximum(own, SETTINGS.least_own))
    shift = np.where(signal.jump, 0.0, np.abs(np.nan_to_num(shock)))
    typical = SERIES.gaussian_mad * float(np.median(deletion_residual[np.isfinite(signal.y)]))
    limit = SETTINGS.limit * max(noise, typical)
    peak = _peaks(np.maximum(deletion_residual, shift), limit, separation)
    return peak & (deletion_residual >= shift) & np.isfinite(signal.y), peak & (shift > deletion_residual)


def _cut(intervals: list[Interval], length: int) -> list[Interval]:
    return [(at, min(at + length, stop)) for start, stop in intervals for at in range(start, stop, length)]


def as_reported(vehicle: Vehicle, runs: Sequence[Run]) -> Vehicle:
    """The vehicle whose velocities are reported along the earth, or derived from the pose, as in all logs."""
    along = bool(runs) and all(r.mapping is not None and r.mapping.frames.velocity != "body" for r in runs)
    lacking = (n for n in vehicle.velocity_names if all(n in r.derived or not r.has(n) for r in runs))
    derived = tuple(lacking) if runs else ()
    if (along, derived) == (vehicle.velocity_along_earth, vehicle.derived_velocities):
        return vehicle
    return replace(vehicle, velocity_along_earth=along, derived_velocities=derived)


def velocities_from_pose(run: Run, degrees_of_freedom: Iterable[str] = ("surge", "sway", "yaw")) -> Run:
    """Add the body velocities that a run lacks, from its pose.

    Each pose channel is smoothed: noise and smoothness are estimated from the data, outliers are dropped,
    shifts of the origin are bridged, and where tracking was lost for more than 0.5 s the velocities are NaN.
    Roll and pitch are taken as zero unless they are degrees of freedom.

    Velocities that were there are kept. The names of those that are added are in `derived` of the run, the
    medians of their standard deviations in `sigma`; outliers in the pose become NaN.
    """
    wanted = list(degrees_of_freedom)
    lacking = [VELOCITY[DOFS.index(name)] for name in wanted if not run.has(VELOCITY[DOFS.index(name)])]
    if not lacking:
        return run
    tracks = _all_tracked(run, _needed_pose(run, wanted, lacking))
    rates, spread = _body_rates(run, tracks)
    pose = {name: np.where(one.outlier, np.nan, run.reports(name)) for name, one in tracks.items()}
    run = with_reports(run, pose)
    found = {name: rates[VELOCITY.index(name)] for name in lacking}
    sigma = {name: float(np.nanmedian(spread[VELOCITY.index(name)])) for name in lacking}
    accuracy = ", ".join(f"{name} +- {value:.2g} {UNITS[name]}" for name, value in sigma.items())
    return replace(
        run,
        channels={**run.channels, **found},
        sigma={**run.sigma, **sigma},
        derived=run.derived | set(lacking),
        outliers={name: int(one.outlier.sum()) for name, one in tracks.items()},
        shifts={name: one.shifts(run.t, run.reports(name)) for name, one in tracks.items() if one.jump.any()},
        resolution=max((tracks[n].resolution for n in tracks if _moves(run.channels[n])), default=0.0),
    ).with_notes(
        f"velocities from pose {', '.join(tracks)} by a Kalman smoother: {accuracy} (median)",
        *(_note(run, name, one) for name, one in tracks.items()),
    )


def _needed_pose(run: Run, wanted: list[str], lacking: list[str]) -> list[str]:
    """Pose that the velocities which a run lacks are taken from, and what else of the pose it has."""
    of_asked = {POSE[DOFS.index(name)] for name in wanted}
    needed = {POSE[VELOCITY.index(name)] for name in lacking} | of_asked & set(POSE[3:])
    # A vehicle that only surges along x, say a towed hull, may do without a heading; with one, x and y are
    # turned by it.
    if needed & {"x", "y"} and ("psi" in needed or all(run.has(name) for name in ("x", "y", "psi"))):
        needed |= {"x", "y", "psi"}
    missing = [name for name in POSE if name in needed and not run.has(name)]
    if missing:
        # x or y is of no use without the other, and neither without the heading that turns it
        across = {"x", "y"} if {"x", "y", "psi"} & {*missing} else set()
        blind = [n for n in lacking if POSE[VELOCITY.index(n)] in across.union(missing)] or lacking
        raise UndertowError(
            f"run {run.name!r} has neither {', '.join(blind)} nor the pose {', '.join(missing)} for "
            f"{', '.join(DOFS[VELOCITY.index(n)] for n in blind)}: map these columns, leave "
            f"{'it' if len(blind) == 1 else 'them'} out of degrees_of_freedom in the vehicle file, or say "
            'which motions a rig holds (held = ["sway"] in a mapping file)'
        )
    return [name for name in POSE if name in needed or (name in of_asked and run.has(name))]


def _all_tracked(run: Run, names: Iterable[str]) -> dict[str, Track]:
    """Tracks of pose channels; those that show no motion are smoothed no longer than the others."""
    # The likeliest smoother of mere noise is as slow as it gets, and would decide what a log with it can
    # show of the motion of the others. What it might hide is in the uncertainty of a quicker one.
    tracks = {name: _tracked(run, name) for name in names}
    still = [n for n, one in tracks.items() if _moves(run.channels[n]) and not one.shows_motion]
    slowest = max((one.resolution for one in tracks.values() if one.shows_motion), default=np.inf)
    return tracks | {name: tracks[name].no_slower(slowest, run.reports(name)) for name in still}


def _tracked(run: Run, name: str) -> Track:
    reports = run.reports(name)
    count = int(np.isfinite(reports).sum())
    if count < SETTINGS.fewest:
        raise UndertowError(
            f"run {run.name!r}: channel {name!r} has {count} samples, at least {SETTINGS.fewest} are needed "
            f"to derive a velocity from it: give a longer log, map a measured velocity, or leave {name} out, "
            "with the motion that needs it (degrees_of_freedom in the vehicle file)"
        )
    try:
        return track(run.t, reports)
    except ValueError as error:
        raise UndertowError(f"run {run.name!r}: no velocity from channel {name!r}: {error}") from error


def _moves(channel: Array) -> bool:
    """Whether a channel changes; the smoother of a constant one has no finite time constant."""
    size = float(np.nanmax(np.abs(channel)))
    return bool(np.nanmax(channel) - np.nanmin(channel) > SETTINGS.still * max(size, 1.0))


def _body_rates(run: Run, tracks: dict[str, Track]) -> tuple[Array, Array]:
    """Return u … r and their standard deviations, (6, n) each; pose without a track counts as zero."""
    zero = np.zeros(len(run.t))
    value, value_sd, rate, rate_sd = (
        np.array([getattr(tracks[name], what) if name in tracks else zero for name in POSE])
        for what in ("value", "value_sd", "rate", "rate_sd")
    )
    value_var, rate_var = value_sd**2, rate_sd**2
    rotation, euler = _to_body(*value[3:])
    linear, angular = np.einsum("ijn,jn->in", rotation, rate[:3]), np.einsum("ijn,jn->in", euler, rate[3:])
    # An attitude error rotates the velocity: velocity x error.
    turned = [(linear[(i + 1) % 3] ** 2 * value_var[3 + (i + 2) % 3]) for i in range(3)]
    turned = [one + linear[(i + 2) % 3] ** 2 * value_var[3 + (i + 1) % 3] for i, one in enumerate(turned)]
    linear_var = np.einsum("ijn,jn->in", rotation**2, rate_var[:3]) + turned
    angular_var = np.einsum("ijn,jn->in", euler**2, rate_var[3:])
    return np.concatenate([linear, angular]), np.sqrt(np.concatenate([linear_var, angular_var]))


def _to_body(phi: Array, theta: Array, psi: Array) -> tuple[Array, Array]:
    """Return R^T (NED to body) and T^-1 (Euler to body rates), (3, 3, n) each (Fossen 2021, section 2.2)."""
    (cf, sf), (ct, st) = ((np.cos(angle), np.sin(angle)) for angle in (phi, theta))
    one, zero = np.ones_like(phi), np.zeros_like(phi)
    euler = np.array([[one, zero, -st], [zero, cf, ct * sf], [zero, -sf, ct * cf]])
    return to_body(phi, theta, psi), euler


def _note(run: Run, name: str, one: Track) -> str:
    parts = [f"{name}: noise {one.noise:.2g} {UNITS[name]}"]
    if one.outlier.any():
        parts.append(f"{one.outlier.sum()} outliers dropped ({_times(run.t[one.outlier])})")
    if one.jump.any():
        sizes = one.shifts(run.t, run.reports(name))[:, 0]
        parts.append(
            f"{len(sizes)} shifts of up to {np.nanmax(sizes):.2g} {UNITS[name]} bridged "
            f"({_times(run.t[one.jump])})"
        )
    if one.lost:
        spells = ", ".join(f"{start:g}-{stop:g}" for start, stop in one.lost)
        parts.append(f"not tracked for more than {SETTINGS.lost:g} s at t = {spells} s, no velocity there")
    return "; ".join(parts)


def _times(t: Array, most: int = 6) -> str:
    return "t = " + ", ".join(f"{time:g}" for time in t[:most]) + (" … s" if len(t) > most else " s")
