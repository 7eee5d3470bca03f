"""The rate of the pose against the body velocities of a log, without a model of the forces.

For test functions phi with compact support, the integral of phi d(eta)/dt + ... = 0 reads, by parts,
-int phi' eta dt = int phi J(eta) nu dt. No signal is differentiated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.stats import chi2

from undertow.identification.estimation.data import white_noise
from undertow.identification.estimation.test_functions import TestFunctions, knot_spacing, test_functions
from undertow.identification.logs.mapping import to_body
from undertow.identification.logs.run import Run
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags


@dataclass(frozen=True)
class KinematicsSettings:
    """How pose rates are compared with velocities."""

    samples: int = 4000  # samples that are looked at, all runs together: more would only cost time
    # Widths of test functions that are tried, in the narrowest that the sampling allows.
    widths: tuple[int, ...] = (1, 2, 4, 8)
    overlap: float = 2.0  # test functions that share the noise of a sample, about
    kept: float = 0.7  # share of the motion that wider test functions must keep
    fewest: int = 16  # and how many of them there must be: two clusters of neighbours (`sensors.SETTINGS`)
    # Mean square by which any log may disagree: quadrature over samples is not exact.
    quadrature: float = 1e-4
    # Share of all translation or rotation (mean square) below which a block hardly moves: that a vehicle that
    # floats upright rolls by a tenth of what it turns, or less, and not as its gyros say, spoils nothing.
    hardly: float = 0.01


SETTINGS = KinematicsSettings()


BLOCKS = (("x", "y"), ("z",), ("phi",), ("theta",), ("psi",))
"""Pose rates that are judged together: a mistake in a frame exchanges north and east."""


@dataclass(frozen=True)
class Segment:
    """Samples of a run without gaps, at times (n,), with test functions on them."""

    run: int
    piece: slice
    times: Array
    functions: TestFunctions

    @property
    def length(self) -> Array:
        """Integral of every test function, s, shape (K,)."""
        return np.asarray(self.functions.value.sum(axis=1)).ravel()


@dataclass(frozen=True)
class Samples:
    """Pose and velocity, (n, 6) each, and J(eta), (n, 6, 6)."""

    pose: Array
    velocity: Array
    jacobian: Array

    def variance(self, noise: Array) -> Array:
        """Variance of J(eta) nu at every sample, (n, 6), from the noise of pose and velocity, (12,)."""
        straight = np.einsum("nij,j->ni", self.jacobian**2, noise[6:] ** 2)
        # An error of the attitude turns the velocity.
        straight[:, :3] += np.sum(self.velocity[:, :3] ** 2, axis=1)[:, None] * np.max(noise[3:6] ** 2)
        return straight


@dataclass(frozen=True)
class Rates:
    """Means over test functions, shape (K, n_rows): pose rate, J(eta) nu, and the variance that noise gives
    their difference.
    """

    pose: Array
    velocity: Array
    variance: Array

    @property
    def weight(self) -> Array:
        """What their difference is multiplied with for noise of one."""
        return 1.0 / np.sqrt(self.variance + 1e-12 * np.mean(self.pose**2 + self.velocity**2, axis=0))


@dataclass(frozen=True)
class Mismatch:
    """How far pose rates and velocities are apart, for each block of `Kinematics.blocks`."""

    # (b,) mean square of the difference over the sum of both mean squares: 0 where they agree, 1 where they
    # have nothing to do with each other, 2 where they are opposite.
    share: Array
    floor: Array  # (b,) what noise makes of it
    moves: Flags  # (b,) whether it has a part in the translation or rotation that is worth a look

    @property
    def excess(self) -> Array:
        """The part that noise does not explain, shape (b,)."""
        return np.maximum(self.share - self.floor, 0.0)

    @property
    def total(self) -> float:
        """Sum over the blocks."""
        return float(np.sum(self.excess))


class Kinematics:
    """Where and how pose rates are compared with velocities; the same for a log as given and as mended."""

    def __init__(self, runs: Sequence[Run], vehicle: Vehicle, most: int = SETTINGS.samples) -> None:
        self.most = most
        self._known_noise: dict[bytes, float] = {}
        self.rows = _rows(runs, vehicle)
        self.blocks = [found for b in BLOCKS if (found := [self.rows.index(n) for n in b if n in self.rows])]
        self.channels = _channels(runs, vehicle, self.rows)
        self.segments: list[Segment] = []
        if self.rows:
            self._widen(runs)

    def __bool__(self) -> bool:
        """Whether there is anything to compare."""
        return bool(self.segments)

    def _widen(self, runs: Sequence[Run]) -> None:
        """Take test functions as wide as the motion allows: they average noise away."""
        reference = 0.0
        for width in SETTINGS.widths:
            wider = [s for i, run in enumerate(runs) for s in self._segments(i, run, width, len(runs))]
            if not wider or (width > 1 and sum(len(s.length) for s in wider) < SETTINGS.fewest):
                break
            before, self.segments = self.segments, wider
            power = float(np.mean(self.rates(runs).velocity ** 2))
            reference = reference or power
            if power < SETTINGS.kept * reference:
                self.segments = before
                break

    def _segments(self, index: int, run: Run, width: int, count: int) -> list[Segment]:
        result = []
        active = most_active(run, self.channels, self.most // count)
        for piece in run.segments(self.channels):
            part = slice(max(piece.start, active.start), min(piece.stop, active.stop))
            t = run.t[part]
            functions = cached_test_functions(t, width * knot_spacing(run.clock)) if len(t) > 2 else None
            if functions is not None:
                result.append(Segment(index, part, t, functions))
        return result

    def rates(self, runs: Sequence[Run]) -> Rates:
        """Weak pose rates and velocities of runs, the given ones or what was made of them."""
        parts = [self._rates(runs[s.run], s) for s in self.segments]
        return Rates(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def samples(self, run: Run, s: Segment) -> Samples:
        """Pose, velocity and J(eta) at the samples of a segment."""
        pose = self.table(run, POSE)[s.piece]
        return Samples(pose, self.table(run, VELOCITY)[s.piece], jacobian(pose))

    @property
    def places(self) -> list[int]:
        """Places of the rows among the six."""
        return [POSE.index(n) for n in self.rows]

    def _rates(self, run: Run, s: Segment) -> tuple[Array, Array, Array]:
        at, f, places = self.samples(run, s), s.functions, self.places
        pose_rate = np.einsum("nij,nj->ni", at.jacobian, at.velocity)[:, places]
        names = (*POSE, *VELOCITY)
        noise = np.array([self._noise_of(run, n) if n in self.channels else 0.0 for n in names])
        pose_variance = np.broadcast_to(noise[places] ** 2, pose_rate.shape)
        variance = f.rate.power(2) @ pose_variance + f.value.power(2) @ at.variance(noise)[:, places]
        length = s.length[:, None]
        return -(f.rate @ at.pose[:, places]) / length, (f.value @ pose_rate) / length, variance / length**2

    def table(self, run: Run, names: tuple[str, ...]) -> Array:
        """Six columns; what the run lacks, or does not matter, is zero."""
        zero = np.zeros(len(run.t))
        return np.column_stack([run.channels[n] if n in self.channels else zero for n in names])

    def _noise_of(self, run: Run, name: str) -> float:
        """Noise of a channel; most channels stay as they are when a mistake is undone."""
        if name in run.sigma:
            return run.sigma[name] * float(np.sqrt(run.rows_per_report(name)))
        key = run.channels[name].tobytes()
        if key not in self._known_noise:
            self._known_noise[key] = white_noise(run.t, run.channels[name])
        return self._known_noise[key]

    def chance(self, runs: Sequence[Run], limit: float) -> float:
        """P-value of the row that noise explains least, with all its rows taken into account.

        `limit` is the mean square, in units of the noise, up to which the noise may have been underestimated.
        """
        rates = self.rates(runs)
        square = np.mean((rates.pose - rates.velocity) ** 2 / rates.variance, axis=0)
        count = len(rates.pose) / SETTINGS.overlap
        return float(min(1.0, len(square) * chi2.sf(count * square.max() / limit, count)))

    def mismatch(self, runs: Sequence[Run]) -> Mismatch:
        """How far pose rates and velocities of runs are apart."""
        return self.mismatch_of(self.rates(runs))

    def mismatch_of(self, rates: Rates) -> Mismatch:
        """The same for rates that are known."""
        square = [np.mean(a, axis=0) for a in ((rates.pose - rates.velocity) ** 2, rates.variance)]
        power = np.mean(rates.pose**2 + rates.velocity**2, axis=0)
        total = np.array([max(float(np.sum(power[b])), 1e-30) for b in self.blocks])
        share, floor = (
            np.array([np.sum(s[b]) / p for b, p in zip(self.blocks, total, strict=True)]) for s in square
        )
        turns = np.array([self.rows[b[0]] in POSE[3:] for b in self.blocks])
        of_kind = np.where(turns, total[turns].sum(), total[~turns].sum())
        moves = np.asarray(total > SETTINGS.hardly * of_kind)
        return Mismatch(share, np.maximum(floor, SETTINGS.quadrature), moves)

    def changed(self, first: Rates, second: Rates) -> Array:
        """How much of the motion of every block differs between two sets of rates, (b,), as of `Mismatch`."""
        change = (second.pose - first.pose) ** 2 + (second.velocity - first.velocity) ** 2
        power = first.pose**2 + first.velocity**2
        return np.array([change[:, b].sum() / max(power[:, b].sum(), 1e-30) for b in self.blocks])

    def still(self, first: Rates, second: Rates) -> Flags:
        """Whether a block moves in the first rates, and hardly in the second, by pose and velocity, (b,)."""
        before, after = map(self.powers, (first, second))
        return np.asarray(np.all(after < SETTINGS.hardly * before, axis=0))

    def powers(self, rates: Rates) -> Array:
        """Mean squares of pose rates and of velocities in every block, (2, b)."""
        tables = (rates.pose, rates.velocity)
        return np.array([[np.sum(np.mean(a[:, b] ** 2, axis=0)) for b in self.blocks] for a in tables])


def jacobian(pose: Array) -> Array:
    """J(eta) with d(eta)/dt = J(eta) nu, from (n, 6) poses, shape (n, 6, 6) (Fossen 2021, chapter 2)."""
    phi, theta, psi = pose[:, 3:].T
    result = np.zeros((len(pose), 6, 6))
    result[:, :3, :3] = to_body(phi, theta, psi).transpose(2, 1, 0)
    (sf, cf), tan, cos = (np.sin(phi), np.cos(phi)), np.tan(theta), np.cos(theta)
    result[:, 3, 3] = 1.0
    result[:, 3, 4], result[:, 3, 5] = sf * tan, cf * tan
    result[:, 4, 4], result[:, 4, 5] = cf, -sf
    result[:, 5, 4], result[:, 5, 5] = sf / cos, cf / cos
    return result


def rms(table: Array) -> float:
    """Root of the mean square length of rows."""
    return float(np.sqrt(np.mean(np.sum(table**2, axis=1))))


def measured(runs: Sequence[Run], name: str) -> bool:
    """Whether every run has a channel of its own."""
    return all(r.has(name) and name not in r.derived for r in runs)


def changes(runs: Sequence[Run], name: str) -> bool:
    """Whether a channel has more than one value in some run."""
    return any(np.nanmax(r.channels[name]) > np.nanmin(r.channels[name]) for r in runs)


def _rows(runs: Sequence[Run], vehicle: Vehicle) -> list[str]:
    """Pose coordinates whose rate can be compared with a velocity of its own."""
    pairs = dict(zip(vehicle.pose_names, vehicle.velocity_names, strict=True))
    if {"u", "r"} <= {*vehicle.velocity_names}:
        pairs = {"x": "u", "y": "u"} | pairs  # surge and a heading give both, with or without sway
    # A velocity that never changes while the pose does is compared, too: nothing was measured.
    found = [p for p, v in pairs.items() if measured(runs, p) and measured(runs, v) and changes(runs, p)]
    turns = "yaw" in vehicle.degrees_of_freedom and not all(r.has("psi") for r in runs)
    return [n for n in found if not (turns and n in ("x", "y"))]


def _channels(runs: Sequence[Run], vehicle: Vehicle, rows: list[str]) -> list[str]:
    """Channels that take part: of the rows, velocities of the vehicle, and the attitude."""
    # Roll and pitch only where they are whole, for they are small; but without a heading that is sometimes
    # missing north would be taken for ahead.
    there = [n for n in ("phi", "theta", "psi") if all(r.has(n) for r in runs)]
    whole = [n for n in there if all(bool(np.isfinite(r.channels[n]).all()) for r in runs)]
    attitude = [n for n in there if n in whole or (n == "psi" and {"x", "y"} & {*rows})]
    own = [n for n in vehicle.velocity_names if all(r.has(n) for r in runs)]
    return [n for n in (*POSE, *VELOCITY) if n in {*rows, *own, *attitude}]


def most_active(run: Run, names: Sequence[str], most: int) -> slice:
    """The `most` samples in a row in which velocities are largest."""
    if len(run.t) <= most:
        return slice(0, len(run.t))
    moving = [np.nan_to_num(run.channels[n]) for n in names if n in VELOCITY]
    power = sum(((m / (np.std(m) or 1.0)) ** 2 for m in moving), np.zeros(len(run.t)))
    total = np.concatenate([[0.0], np.cumsum(power)])
    first = int(np.argmax(total[most:] - total[:-most]))
    return slice(first, first + most)


def cached_test_functions(t: Array, spacing: float) -> TestFunctions | None:
    """Cached test functions over the samples of a segment, which is compared for every possible mistake."""
    return _weights_over(t.tobytes(), spacing)


@lru_cache(maxsize=16)
def _weights_over(t: bytes, spacing: float) -> TestFunctions | None:
    return test_functions(np.frombuffer(t), spacing)
