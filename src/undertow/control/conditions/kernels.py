"""What a linear loop makes of a push, bounded piece by piece of time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array, Index

from .attitude import Interval, enclose
from .definite import SETTINGS as PROOFS


@dataclass(frozen=True)
class KernelSettings:
    """How responses are bounded; none of these numbers decides what is proved."""

    first: float = 0.05  # of the time in which the fastest mode changes: the first piece of time
    ratio: float = 1.04  # of the ends of a piece of time
    finer: int = 4  # pieces of what a push does later, in one of these
    last: float = 20.0  # slowest time constants, after which one bound serves for all time
    dies: float = 0.02  # part of the slowest mode's rate at which everything dies out at last


SETTINGS = KernelSettings()


class Modes(NamedTuple):
    """z = T x with x_dot = L x, L in blocks [[-s, w], [-w, -s]] or -s; `off` is |A - T L T^-1|."""

    T: Interval
    inverse: Interval
    starts: Array  # first place of each block
    rates: Array  # s - i w, by block, w zero where it has one row
    off: Array


def modes(A: Interval) -> Modes:
    """The modes of a loop, with a bound on what they miss of it.

    Raises
    ------
    UndertowError
        If the loop is not stable, or its modes are too close to one another.
    """
    values, vectors = np.linalg.eig(A.middle)
    columns: list[Array] = []
    starts, rates = [], []
    for value, vector in zip(values, vectors.T, strict=True):
        if value.imag < 0:
            continue
        starts.append(len(columns))
        rates.append(complex(-value.real, -value.imag))
        columns += [vector.real, vector.imag] if value.imag > 0 else [vector.real]
    if min(r.real for r in rates) <= 0:
        raise UndertowError("the loop at rest is not stable at every attitude")
    T = enclose(np.array(columns).T)
    inverse = _inverse(T)
    block = np.zeros(A.lo.shape)
    for place, rate in zip(starts, rates, strict=True):
        s, w = rate.real, -rate.imag
        size = 2 if w else 1
        block[place : place + size, place : place + size] = [[-s, w], [-w, -s]] if w else -s
    off = (A - T @ enclose(block) @ inverse).size
    return Modes(T, inverse, np.array(starts), np.array(rates), off)


def _inverse(T: Interval) -> Interval:
    """The inverse of a matrix of numbers, enclosed: its columns are scaled to norm one."""
    near = np.linalg.inv(T.lo)
    n = len(near)
    left = (enclose(np.eye(n)) - near @ T).size.sum(axis=-1).max() * (1 + PROOFS.room)
    if not left < 0.5:
        raise UndertowError("modes of the loop are too close to one another for bounds in time")
    radius = np.broadcast_to(2 * left * np.abs(near).max(axis=0), near.shape)
    return Interval(near - radius, near + radius)


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

    def __init__(self, found: Modes, rows: Array, times: Array) -> None:
        self.found, self.times = found, times
        left, right = enclose(rows) @ found.T, found.inverse
        first, pair = found.starts, found.rates.imag != 0
        second = np.where(pair, first + 1, first)

        def product(i: Array, j: Array) -> Interval:
            return left.T[i][:, :, None] * right[j][:, None]

        cosine = product(first, first) + product(second, second) * pair[:, None, None].astype(float)
        sine = (product(first, second) - product(second, first)) * pair[:, None, None].astype(float)
        self.amplitude = cosine.middle - 1j * sine.middle  # (modes, signals, states)
        self.size = (np.abs(self.amplitude) + cosine.radius + sine.radius) * (1 + PROOFS.room)
        self.radius = cosine.radius + sine.radius + PROOFS.level * self.size

    @property
    def _exponents(self) -> Array:
        return np.asarray(-self.found.rates.real - 1j * self.found.rates.imag)

    @property
    def envelope(self) -> Array:
        """Bound on each response at any time, times the decay of the slowest mode, (signals, states)."""
        return np.asarray(self.size.sum(axis=0))

    def kernels(self, signals: Index, states: Index) -> Kernels:
        """The integrals over time of some |responses|."""
        within, widths = self.pieces(signals, states), np.diff(self.times)
        slowest = self.found.rates.real.min()
        growth = np.exp(SETTINGS.dies * slowest * self.times)
        rest = within[:, -1:] / ((1 - SETTINGS.dies) * slowest)
        integral = np.cumsum(np.insert(within[:, :-1] * widths, 0, 0.0, axis=1), axis=1)
        weighted = (within[:, :-1] * widths) @ growth[1:] + rest[:, 0] * growth[-1]
        return Kernels(self.times, integral.T, weighted * (1 + PROOFS.level))

    def pieces(self, signals: Index, states: Index) -> Array:
        """Bounds on some responses in each piece of time, the last of which has no end, (pairs, pieces)."""
        own = Amplitudes(*(m[:, signals, states].T for m in (self.amplitude, self.size, self.radius)))
        return bounds_within(own, self._exponents, self.times)


class Amplitudes(NamedTuple):
    """Of each exponential in a sum: a number, a bound on its magnitude, and how much it may be off."""

    value: Array
    size: Array
    radius: Array


def bounds_within(of: Amplitudes, exponents: Array, times: Array, growing: Amplitudes | None = None) -> Array:
    """Bounds on |Re sum of a e^(exponent t)| in each piece of time, the last without end, (rows, pieces).

    With `growing` the sum is of (a + t b) e^(exponent t); then the last piece has to begin after the slowest
    time constant.
    """
    decay = np.exp(np.outer(exponents.real, times))
    turned = decay * np.exp(1j * np.outer(exponents.imag, times))
    value, spread, bend = of.value @ turned, of.radius @ decay, (of.size * np.abs(exponents) ** 2) @ decay
    envelope = of.size @ decay
    if growing is not None:
        later, rate = np.append(times[1:], times[-1]), np.abs(exponents)
        value = value + growing.value @ (turned * times)
        spread = spread + growing.radius @ (decay * times)
        bend = bend + (growing.size * rate**2) @ (decay * later) + 2 * (growing.size * rate) @ decay
        envelope = envelope + growing.size @ (decay * later)
    at = np.abs(value.real) + spread
    within = np.maximum(at[:, :-1], at[:, 1:]) + bend[:, :-1] * np.diff(times) ** 2 / 8
    found = np.concatenate([np.minimum(within, envelope[:, :-1]), envelope[:, -1:]], axis=1)
    return np.asarray(found * (1 + PROOFS.level))


def grid(rates: Array, finer: int = 1, until: float = 0.0) -> Array:
    """Ends of the pieces of time for the modes of a loop, s, the last not before `until`."""
    first, last = SETTINGS.first / finer / np.abs(rates).max(), max(SETTINGS.last / rates.real.min(), until)
    ratio = SETTINGS.ratio ** (1 / finer)
    # As wide as the first one while that is wider than by the ratio.
    steady = np.arange(0.0, first / (ratio - 1), first)
    count = int(np.ceil(np.log(last / steady[-1]) / np.log(ratio))) + 1
    return np.concatenate([steady, steady[-1] * ratio ** np.arange(1, max(count, 2))])
