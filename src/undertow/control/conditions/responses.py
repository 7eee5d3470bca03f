"""What a linear loop makes of its start, its heading and of pushes, bounded piece by piece of time.

Motion that the loop drives is of second order in the start, and of first order in the heading. With z_1 = sum
of V_j e^{l_j t} (C_j s) for a start s, z_2' = A z_2 + q(z_1, z_1) has the solution

    z_2 = sum over j, k of Z_jk (C_j s)(C_k s) e^{(l_j + l_k) t} + sum over m of Y_m(s) e^{l_m t},

and z_h' = A z_h + B z_1, by which motion changes with the heading of the set-point, the solution

    z_h = sum over j of (Z_j + t Y_j)(s) e^{l_j t}.

Nothing of either has to be exact: what it misses of the equation is bounded and pushes what is left.
"""

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
    # Of the ends of a piece of time: what the first does not prove, in a third of the time, is tried again.
    ratios: tuple[float, ...] = (1.12, 1.04)
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


def grid(rates: Array, ratio: float, finer: int = 1, until: float = 0.0) -> Array:
    """Ends of the pieces of time for the modes of a loop, s, the last not before `until`."""
    first, last = SETTINGS.first / finer / np.abs(rates).max(), max(SETTINGS.last / rates.real.min(), until)
    ratio **= 1 / finer
    # As wide as the first one while that is wider than by the ratio.
    steady = np.arange(0.0, first / (ratio - 1), first)
    count = int(np.ceil(np.log(last / steady[-1]) / np.log(ratio))) + 1
    return np.concatenate([steady, steady[-1] * ratio ** np.arange(1, max(count, 2))])


# --- of second order in the start, of first order in the heading --------------------------------
class Form(NamedTuple):
    """q(z, z): of each angle times what it turns, and of products of rates."""

    angles: Array  # rows on z, (angles, states)
    pull: Array  # what a unit of each angle turns, rows on z, (angles, n, states)
    Gamma: Array  # (n, n, n)
    # The same of magnitudes: nothing that cancels in `pull` does here.
    size: Array


class Driven(NamedTuple):
    """Bounds on a motion that the linear loop drives, and on what is missed of its equation."""

    signals: Array  # (pieces, signals)
    missed: Array  # at any time of a piece, (pieces, states)
    begun: Array  # bound on the motion at the start, which should be zero, by state


class Complex(NamedTuple):
    """The modes as z = sum of V_j e^{l_j t} (C_j z(0)), one of each pair that is conjugate."""

    exponents: Array
    V: Array  # (states, modes)
    C: Array  # (modes, states)
    radius: Array  # of C
    weights: Array  # one, or two where it stands for a pair


class Starts(NamedTuple):
    """A box of errors, of which those in the plane stand in any frame: there it is a disc."""

    box: Array
    plane: list[int]

    @property
    def reach(self) -> Array:
        """The largest of each error in any frame."""
        found = self.box.astype(float).copy()
        if self.plane:
            found[self.plane] = np.hypot(*self.box[self.plane])
        return found * (1 + PROOFS.room)

    def linear(self, of: Array) -> Array:
        """The largest sum over errors of a share of each, of magnitudes along the first axis."""
        reach = self.reach
        rest = [c for c in range(len(reach)) if c not in self.plane]
        found = np.tensordot(reach[rest], of[rest], 1)
        if self.plane:
            found = found + np.hypot(*of[self.plane]) * reach[self.plane[0]]
        return np.asarray(found)

    def squares(self, of: Array) -> Array:
        """The largest sum over pairs p <= q of errors, as `linear`, along the first axis (by `pairs`)."""
        p, q = self.pairs
        reach = self.reach
        found = of * (reach[p] * reach[q]).reshape(-1, *[1] * (of.ndim - 1))
        if not self.plane:
            return np.asarray(found.sum(axis=0))
        x, y = self.plane
        place = {(int(a), int(b)): k for k, (a, b) in enumerate(zip(p, q, strict=True))}
        xx, yy, xy = (found[place[pair]] for pair in ((x, x), (y, y), (x, y)))
        total = 0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), 0.5 * xy)
        rest = [c for c in range(len(reach)) if c not in self.plane]
        for c in rest:
            total = total + np.hypot(*(found[place[min(a, c), max(a, c)]] for a in self.plane))
            total = total + sum(found[place[c, d]] for d in rest if d >= c)
        return np.asarray(total)

    @property
    def pairs(self) -> tuple[Index, Index]:
        """Places of the first and of the second error of each pair."""
        return np.triu_indices(len(self.box))


def complex_modes(found: Modes) -> Complex:
    """One of each pair of modes that are conjugate, and those that are real."""
    first, pair = found.starts, found.rates.imag != 0
    T, left, around = found.T.lo, found.inverse.middle, found.inverse.radius
    V = T[:, first].astype(complex)
    V[:, pair] = 0.5 * (T[:, first[pair]] - 1j * T[:, first[pair] + 1])
    C, radius = left[first].astype(complex), around[first].copy()
    C[pair] += 1j * left[first[pair] + 1]
    radius[pair] += around[first[pair] + 1]
    return Complex(-found.rates.real + 1j * found.rates.imag, V, C, radius, np.where(pair, 2.0, 1.0))


def _with_conjugates(of: Complex) -> tuple[Array, Array, Array]:
    """Exponents, V and C of every mode."""
    twins = np.flatnonzero(of.weights == 2)
    exponents = np.concatenate([of.exponents, of.exponents[twins].conj()])
    V = np.concatenate([of.V, of.V[:, twins].conj()], axis=1)
    return exponents, V, np.concatenate([of.C, of.C[twins].conj()])


def products(form: Form, V: Array) -> Array:
    """q of each pair of vectors, shape (n, modes, modes)."""
    n, v = len(form.Gamma), V[-len(form.Gamma) :]
    turned = np.einsum("aj,aik->ijk", form.angles @ V, form.pull @ V)
    both = np.einsum("ipk,pj->ijk", (form.Gamma.reshape(n * n, n) @ v).reshape(n, n, -1), v)
    return np.asarray(0.5 * (turned + turned.swapaxes(1, 2)) + both)


def absolute(form: Form) -> Form:
    """The form that bounds |q| of vectors by their magnitudes."""
    return Form(np.abs(form.angles), form.size, np.abs(form.Gamma), form.size)


def second_order(found: Modes, A: Array, form: Form, rows: Array, starts: Starts, times: Array) -> Driven:
    """z_2 of starts in a box of errors."""
    n, size = len(form.Gamma), len(A)
    of = complex_modes(found)
    exponents, V, C = _with_conjugates(of)
    errors = slice(size - 2 * n, size - n)
    around = np.concatenate([of.radius, of.radius[of.weights == 2]])[:, errors]
    C = C[:, errors]
    j, k = np.triu_indices(len(exponents))
    upper = (exponents[j] + exponents[k]).imag >= 0  # the others are conjugate to these
    j, k = j[upper], k[upper]
    both = exponents[j] + exponents[k]
    weights = np.where(j == k, 1.0, 2.0) * np.where(both.imag > 0, 2.0, 1.0)
    q = np.zeros((len(j), size), dtype=complex)
    q[:, -n:] = (products(form, V)[:, j, k] * weights).T
    system = both[:, None, None] * np.eye(size) - A
    Z = np.asarray(np.linalg.solve(system, q[..., None]))[..., 0]
    p, r = starts.pairs
    same = np.where(p == r, 0.5, 1.0)
    coefficient = (C[j][:, p] * C[k][:, r] + C[k][:, p] * C[j][:, r]) * same  # (l, pairs)
    total = (coefficient.T @ Z).real  # of z_2 at the start without Y, (pairs, states)
    Y = -of.V.T[:, None] * (np.linalg.inv(V)[: len(of.V.T)] @ total.T)[..., None] * of.weights[:, None, None]
    # What is missed: of the equation by rounding and by the modes, of the start, and of the rows C.
    reach, size_Z = starts.reach, np.abs(Z)
    wrong = np.abs(np.einsum("lst,lt->ls", system, Z) - q) + size_Z @ found.off.T
    wrong += PROOFS.rounding * (size_Z @ np.abs(A).T + np.abs(both)[:, None] * size_Z + np.abs(q))
    own = np.abs(C) @ reach
    loose = around @ reach + PROOFS.rounding * own
    missed = (wrong * (own[j] * own[k])[:, None]).sum(axis=0)
    magnitudes = products(absolute(form), np.abs(V)).real
    missed[-n:] += (magnitudes @ (own + loose)) @ (own + loose) - (magnitudes @ own) @ own
    size_Y = np.abs(Y)
    begun = np.abs(total + Y.sum(axis=0).real)
    begun += PROOFS.rounding * (np.abs(coefficient).T @ size_Z + size_Y.sum(axis=0))
    # Modes that Y stands for are not quite those of A.
    missed += found.off @ (size_Y.sum(axis=0).T @ (reach[p] * reach[r]))
    every = np.concatenate([both, of.exponents])
    signals = starts.squares(_signals(rows, Z, coefficient, Y, every, times))
    decay = np.exp(-found.rates.real.min() * times)[:, None]
    return Driven(signals.T, decay * missed, begun.T @ (reach[p] * reach[r]))


def _signals(rows: Array, Z: Array, coefficient: Array, Y: Array, exponents: Array, times: Array) -> Array:
    """Bounds on rows on z_2 for each pair of starts of one, (pairs, signals, pieces)."""
    first, second = rows @ Z.T, rows @ Y.swapaxes(0, 1).swapaxes(1, 2)  # (signals, l), (pairs, signals, m)
    sizes = np.abs(rows) @ np.abs(Z).T
    more = np.abs(rows) @ np.abs(Y).swapaxes(0, 1).swapaxes(1, 2)
    amplitude = np.concatenate([first * coefficient.T[:, None], second], axis=-1)
    size = np.concatenate([sizes * np.abs(coefficient).T[:, None], more], axis=-1)
    whole = size.sum(axis=-1)
    # What hardly matters to a signal is not followed in time.
    matters = whole > PROOFS.level * whole.max(axis=0)
    found = whole[..., None] * np.exp(exponents.real.max() * times)
    own = size[matters]
    found[matters] = bounds_within(Amplitudes(amplitude[matters], own, PROOFS.level * own), exponents, times)
    return np.asarray(found * (1 + PROOFS.level))


def by_heading(found: Modes, A: Array, B: Array, rows: Array, starts: Starts, times: Array) -> Driven:
    """z_h of starts in a box of errors, for a heading that is one radian off."""
    n, size = len(starts.box), len(A)
    of = complex_modes(found)
    exponents, V, C = _with_conjugates(of)
    C, radius = C[:, size - 2 * n : size - n], of.radius[:, size - 2 * n : size - n]
    half, G = len(of.exponents), np.linalg.inv(V) @ B @ V
    apart = exponents[None, :] - exponents[:, None]
    np.fill_diagonal(apart, 1.0)
    N = G / np.where(apart == 0, np.inf, apart)
    np.fill_diagonal(N, 0.0)
    own, weights = C[:half], of.weights[:, None, None]
    Z = (V @ N)[:, :half].T[:, :, None] * own[:, None] - of.V.T[:, :, None] * (N @ C)[:half, None]
    Y = of.V.T[:, :, None] * (np.diag(G)[:half, None] * own)[:, None]
    pushed = (B @ of.V).T[:, :, None] * own[:, None]  # each (modes, states, starts)
    at = of.exponents[:, None, None]
    size_Z, size_Y, size_A = np.abs(Z), np.abs(Y), np.abs(A) + np.abs(at) * np.eye(size)
    constant = np.abs(at * Z + Y - A @ Z - pushed) + found.off @ size_Z
    constant += PROOFS.rounding * (
        size_A @ size_Z + size_Y + np.abs(B) @ np.abs(of.V).T[:, :, None] * np.abs(own)[:, None]
    )
    constant += (np.abs(B) @ np.abs(of.V)).T[:, :, None] * (radius + PROOFS.rounding * np.abs(own))[:, None]
    growing = np.abs(at * Y - A @ Y) + found.off @ size_Y + PROOFS.rounding * (size_A @ size_Y)
    missed, more = (np.tensordot((m * weights).sum(axis=0), starts.reach, 1) for m in (constant, growing))
    begun = np.abs((Z * weights).sum(axis=0).real) + PROOFS.rounding * (size_Z * weights).sum(axis=0)
    decay, later = np.exp(-found.rates.real.min() * times), np.append(times[1:], times[-1])
    parts = [np.tensordot(rows, m * weights, ([1], [1])).transpose(2, 0, 1) for m in (Z, Y)]
    sizes = [np.tensordot(np.abs(rows), np.abs(m) * weights, ([1], [1])).transpose(2, 0, 1) for m in (Z, Y)]
    shape = (n * len(rows), half)
    pieces = [
        Amplitudes(*(m.reshape(shape) for m in (a, s, PROOFS.level * s)))
        for a, s in zip(parts, sizes, strict=True)
    ]
    signals = bounds_within(pieces[0], of.exponents, times, pieces[1]).reshape(n, len(rows), -1)
    return Driven(
        starts.linear(signals).T, decay[:, None] * (missed + later[:, None] * more), begun @ starts.reach
    )
