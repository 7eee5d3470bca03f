"""Responses of a stable linear loop to its start and to pushes, bounded piece by piece of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array, Index

from .attitude import Interval, enclose
from .definite import SETTINGS as PROOFS


@dataclass(frozen=True)
class ResponseSettings:
    """How responses are bounded; none of these numbers decides what is proved."""

    first_piece: float = 0.05  # of the time in which the fastest mode changes: the first piece of time
    # Of the ends of a piece of time: what the first does not prove, in a third of the time, is tried again.
    ratios: tuple[float, ...] = (1.12, 1.08, 1.04)
    refinement: int = 4  # pieces of what a push does later, in one of these
    last_time_constants: float = 20.0  # slowest time constants, after which one bound serves for all time
    decay_share: float = 0.02  # part of the slowest mode's rate at which everything dies out at last


SETTINGS = ResponseSettings()


class Modes(NamedTuple):
    """z = T x with x_dot = L x, L in blocks [[-s, w], [-w, -s]] or -s; `residual` is |A - T L T^-1|."""

    T: Interval
    inverse: Interval
    block_starts: Array  # first place of each block
    rates: Array  # s - i w, by block, w zero where it has one row
    residual: Array


def modes(A: Interval) -> Modes:
    """The modes of a loop that is stable, with a bound on what they miss of it."""
    values, vectors = np.linalg.eig(A.middle)
    columns: list[Array] = []
    block_starts, rates = [], []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag < 0:
            continue
        block_starts.append(len(columns))
        rates.append(complex(-value.real, -value.imag))
        columns += [vector.real, vector.imag] if value.imag > 0 else [vector.real]
    if min(r.real for r in rates) <= 0:
        raise UndertowError("the loop at rest is not stable at every attitude")
    T = enclose(np.array(columns).T)
    # The inverse of a matrix of numbers, enclosed: its columns are scaled to norm one.
    near = np.linalg.inv(T.lo)
    n = len(near)
    left = (enclose(np.eye(n)) - near @ T).magnitude.sum(axis=-1).max() * (1 + PROOFS.room)
    if not left < 0.5:
        raise UndertowError("modes of the loop are too close to one another for bounds in time")
    radius = np.broadcast_to(2 * left * np.abs(near).max(axis=0), near.shape)
    inverse = Interval(near - radius, near + radius)
    block = np.zeros(A.lo.shape)
    for row, rate in zip(block_starts, rates, strict=True):
        s, w = rate.real, -rate.imag
        size = 2 if w else 1
        block[row : row + size, row : row + size] = [[-s, w], [-w, -s]] if w else -s
    residual = (A - T @ enclose(block) @ inverse).magnitude
    return Modes(T, inverse, np.array(block_starts), np.array(rates), residual)


class Kernels(NamedTuple):
    """Integrals over time of bounds, constant by piece, on |responses|."""

    times: Array
    integral: Array  # up to each time, (times, ...)
    weighted: Array  # over all time with a slow growth beside the response

    def up_to(self, lags: Array) -> Array:
        """The integrals up to other times, (lags, ...)."""
        after = np.clip(np.searchsorted(self.times, lags), 1, len(self.times) - 1)
        start, end = self.times[after - 1], self.times[after]
        share = np.clip((lags - start) / (end - start), 0.0, 1.0)
        low, high = self.integral[after - 1], self.integral[after]
        return np.asarray(low + share.reshape(-1, *[1] * (low.ndim - 1)) * (high - low))


class Responses:
    """Responses of signals (rows on z) to pushes of unit impulse on each state, piece by piece of time."""

    def __init__(self, modes: Modes, rows: Array, times: Array) -> None:
        self.modes, self.times = modes, times
        left, right = enclose(rows) @ modes.T, modes.inverse
        first, pair = modes.block_starts, modes.rates.imag != 0
        second = np.where(pair, first + 1, first)

        def product(i: Array, j: Array) -> Interval:
            return left.T[i][:, :, None] * right[j][:, None]

        cosine = product(first, first) + product(second, second) * pair[:, None, None].astype(float)
        sine = (product(first, second) - product(second, first)) * pair[:, None, None].astype(float)
        self.amplitude = cosine.middle - 1j * sine.middle  # (modes, signals, states)
        self.magnitude = (np.abs(self.amplitude) + cosine.radius + sine.radius) * (1 + PROOFS.room)
        self.radius = cosine.radius + sine.radius + PROOFS.level * self.magnitude

    @property
    def envelope(self) -> Array:
        """Bound on each response at any time, times the decay of the slowest mode, (signals, states)."""
        return np.asarray(self.magnitude.sum(axis=0))

    def kernels(self, signals: Index, states: Index) -> Kernels:
        """The integrals over time of some |responses|."""
        within, widths = self.pieces(signals, states), np.diff(self.times)
        slowest = self.modes.rates.real.min()
        growth = np.exp(SETTINGS.decay_share * slowest * self.times)
        rest = within[:, -1:] / ((1 - SETTINGS.decay_share) * slowest)
        integral = np.cumsum(np.insert(within[:, :-1] * widths, 0, 0.0, axis=1), axis=1)
        weighted = (within[:, :-1] * widths) @ growth[1:] + rest[:, 0] * growth[-1]
        return Kernels(self.times, integral.T, weighted * (1 + PROOFS.level))

    def pieces(self, signals: Index, states: Index) -> Array:
        """Bounds on some responses in each piece of time, the last of which has no end, (pairs, pieces)."""
        amplitudes = Amplitudes(
            *(m[:, signals, states].T for m in (self.amplitude, self.magnitude, self.radius))
        )
        return bounds_within(
            amplitudes, np.asarray(-self.modes.rates.real - 1j * self.modes.rates.imag), self.times
        )


class Amplitudes(NamedTuple):
    """Of each exponential in a sum: a number, a bound on its magnitude, and how much it may be off."""

    value: Array
    magnitude: Array
    radius: Array


def bounds_within(
    amplitudes: Amplitudes, exponents: Array, times: Array, growing: Amplitudes | None = None
) -> Array:
    """Bounds on |Re sum of a e^(exponent t)| in each piece of time, the last without end, (rows, pieces).

    With `growing` the sum is of (a + t b) e^(exponent t); then the last piece has to begin after the slowest
    time.
    """
    count, rate = len(times), np.abs(exponents)[:, None]
    decay, angle = np.exp(np.outer(exponents.real, times)), np.outer(exponents.imag, times)
    waves = np.concatenate([decay * np.cos(angle), -decay * np.sin(angle)])
    # Both bounds in one product of matrices.
    both = amplitudes.magnitude @ np.concatenate([decay, rate**2 * decay], axis=1)
    value, radius = _parts(amplitudes.value) @ waves, amplitudes.radius @ decay
    envelope, curvature = both[:, :count], both[:, count:]
    if growing is not None:
        later = np.append(times[1:], times[-1])
        both = growing.magnitude @ np.concatenate([decay * later, rate * decay * (rate * later + 2)], axis=1)
        value, radius = (
            value + _parts(growing.value) @ (waves * times),
            radius + growing.radius @ (decay * times),
        )
        envelope, curvature = envelope + both[:, :count], curvature + both[:, count:]
    at = np.abs(value) + radius
    between_times = np.maximum(at[:, :-1], at[:, 1:]) + curvature[:, :-1] * np.diff(times) ** 2 / 8
    found = np.concatenate([np.minimum(between_times, envelope[:, :-1]), envelope[:, -1:]], axis=1)
    return np.asarray(found * (1 + PROOFS.level))


def _parts(values: Array) -> Array:
    """Real parts beside imaginary ones."""
    return np.concatenate([values.real, values.imag], axis=-1)


def time_grid(rates: Array, ratio: float, refinement: int = 1, until: float = 0.0) -> Array:
    """Ends of the pieces of time for the modes of a loop, s, the last not before `until`."""
    first, last = (
        SETTINGS.first_piece / refinement / np.abs(rates).max(),
        max(SETTINGS.last_time_constants / rates.real.min(), until),
    )
    ratio **= 1 / refinement
    # As wide as the first one while that is wider than by the ratio.
    steady = np.arange(0.0, first / (ratio - 1), first)
    count = int(np.ceil(np.log(last / steady[-1]) / np.log(ratio))) + 1
    return np.concatenate([steady, steady[-1] * ratio ** np.arange(1, max(count, 2))])
