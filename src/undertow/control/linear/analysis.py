"""Poles, zeros, margins and curves of linear systems."""

from __future__ import annotations

import cmath
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from math import ceil, inf, isfinite, log2

import control as ct
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import minimize_scalar

from undertow.errors import UndertowError
from undertow.typing import Array


@dataclass(frozen=True)
class AnalysisSettings:
    """Tolerances for zero in linear systems, and ranges of curves."""

    rank: float = 1e-9  # singular values below this part of the largest are rounding
    rounding: float = 1e-14  # entries of a sampled A less the identity up to this are rounding
    reach_tolerance: float = 1e-6  # a state with a smaller part in what is reached is not reached at all
    # Part of a state, beside the largest, in a mode or in what is not reached, from which it is named.
    share: float = 0.1
    at_zero: float = 1e-10  # real parts up to this do not grow, 1/s
    slowest: float = 1e-6  # rates up to this are no decay that a time follows from, 1/s
    usual: float = 10.0  # s, in place of the slowest time constant where nothing decays
    infinite: float = 1e8  # size of a zero that is at infinity, rad/s
    # Gain margins beyond these are at the ends of the frequency axis, from rounding.
    factors: tuple[float, float] = (1e-6, 1e6)
    points: int = 600  # of a curve
    least_pole: float = 1e-4  # rad/s, from which frequencies of curves lie about a pole
    # In place of the slowest and the fastest pole where there is none, rad/s.
    no_poles: tuple[float, float] = (0.1, 10.0)
    locus: tuple[float, float] = (1e-4, 1e4)  # factors on gains that a root locus goes through
    margin_tolerance: float = 1e-9  # of the logarithm of the frequency of a margin
    decades: float = 1.5  # that a frequency response goes beyond the slowest and the fastest pole
    time_constants: float = 5.0  # of the slowest mode that a step response shows
    longest: float = 600.0  # longest step response, s


SETTINGS = AnalysisSettings()


@dataclass(frozen=True)
class Mode:
    """A pole with the properties of its motion."""

    pole: complex  # rad/s, or z if sampled; of a pair the one with the positive imaginary part
    states: tuple[str, ...]  # that take part, the most first
    dt: float = 0.0  # sampling time, s; 0: continuous

    @property
    def rate(self) -> complex:
        """The pole in continuous time, rad/s: itself, or log(z)/dt; minus infinity for a pure delay."""
        return _rate(self.pole, self.dt)

    @property
    def magnitude(self) -> float:
        """Distance of the pole from the origin: of a sampled system, the factor of one sample."""
        return abs(self.pole)

    @property
    def frequency(self) -> float:
        """Natural frequency, rad/s."""
        return abs(self.rate)

    @property
    def damping(self) -> float:
        """Damping ratio: -1 to 1; 0 for a pole at zero."""
        if not isfinite(self.rate.real):
            return 1.0
        return -self.rate.real / abs(self.rate) if self.rate else 0.0

    @property
    def time_constant(self) -> float:
        """Time in which the motion falls (or, if negative, rises) by e, s; infinite at zero."""
        return -1 / self.rate.real if self.rate.real else inf

    @property
    def stable(self) -> bool:
        """Whether it does not grow; a pole at zero (z = 1) is a place or heading that nothing holds."""
        return self.rate.real <= SETTINGS.at_zero


def _rate(pole: complex, dt: float) -> complex:
    if not dt:
        return pole
    return cmath.log(pole) / dt if pole else complex(-inf)


def sampling_time(system: ct.StateSpace) -> float:
    """Sampling time of a system, s; 0 if it is continuous."""
    return float(system.dt or 0.0)


def slopes(system: ct.StateSpace) -> Array:
    """A, or (A - 1)/dt of a sampled system, which has the same subspaces, and rates of change."""
    dt = sampling_time(system)
    return np.asarray((system.A - np.eye(system.nstates)) / dt if dt else system.A)


def at_frequencies(system: ct.StateSpace, omega: Array) -> NDArray[np.complex128]:
    """Where a system is evaluated for frequencies in rad/s: on the axis, or on the unit circle."""
    dt = sampling_time(system)
    return np.asarray(np.exp(1j * omega * dt) if dt else 1j * omega)


def modes(system: ct.StateSpace) -> list[Mode]:
    """Poles with the states that take part, the fastest growing first; pairs once.

    A state that nothing depends on (position, heading) gives a pole at exactly zero.
    """
    names, kept = system.state_labels, list(range(system.nstates))
    found: list[tuple[complex, tuple[str, ...]]] = []
    a, dt = slopes(system), sampling_time(system)
    zero = SETTINGS.rounding / dt if dt else 0.0
    while True:
        idle = [i for i in kept if not np.any(np.abs(a[kept, i]) > zero)]
        if not idle:
            break
        found += [(0j, (names[i],)) for i in idle]
        kept = [i for i in kept if i not in idle]
    found += _modes(a[np.ix_(kept, kept)], [names[i] for i in kept])
    result = [Mode(1 + pole * dt if dt else pole, own, dt) for pole, own in found]
    return sorted(result, key=lambda m: (-m.rate.real, m.frequency))


def _modes(a: Array, names: list[str]) -> list[tuple[complex, tuple[str, ...]]]:
    if not names:
        return []
    poles, right = np.linalg.eig(a)
    participation = np.abs(right * np.linalg.pinv(right).T)
    participation = participation / participation.max(axis=0, initial=SETTINGS.rank)
    scale = float(np.max(np.abs(poles)))
    result = []
    for k, pole in enumerate(poles):
        if pole.imag < -SETTINGS.rank * scale:
            continue
        order = sorted(range(len(names)), key=lambda i: -participation[i, k])
        states = tuple(names[i] for i in order if participation[i, k] > SETTINGS.share)
        result.append((_rounded_off(complex(pole), scale), states))
    return result


def _rounded_off(pole: complex, scale: float) -> complex:
    """A pole without the noise of rounding."""
    real, imaginary = (0.0 if abs(v) < SETTINGS.rank * scale / 10 else v for v in (pole.real, pole.imag))
    return complex(real, imaginary)


# --- what can be moved and seen --------------------------------------------------------------
@dataclass(frozen=True)
class Subspace:
    """The controllable subspace, or, for the transposed system, the observable one."""

    rank: int  # dimension of what can be reached
    of: int  # number of states
    missing: tuple[str, ...]  # states that are not reached at all
    mixed: tuple[str, ...]  # states that are reached only together with others
    horizon: float  # time over which `singular` is taken, s
    singular: tuple[float, ...]  # singular values of the Gramian over that time, the largest first, SI


def controllability(system: ct.StateSpace) -> Subspace:
    """States that the inputs can move."""
    return _subspace(system, slopes(system), system.B)


def observability(system: ct.StateSpace) -> Subspace:
    """States that the outputs show."""
    return _subspace(system, slopes(system).T, system.C.T)


def _subspace(system: ct.StateSpace, a: Array, b: Array) -> Subspace:
    names, dt = system.state_labels, sampling_time(system)
    basis = reachable(a, b)
    others = np.eye(len(names)) - basis @ basis.T
    missing = [
        n for n, row in zip(names, basis, strict=True) if np.linalg.norm(row) < SETTINGS.reach_tolerance
    ]
    mixed_states = [n for n, row in zip(names, others, strict=True) if np.linalg.norm(row) > SETTINGS.share]
    # The slowest time constant that decays, s.
    rates = [_rate(p, sampling_time(system)).real for p in np.linalg.eigvals(system.A)]
    decaying = [-1 / r for r in rates if r < -SETTINGS.slowest]
    horizon = float(max(decaying, default=SETTINGS.usual))
    W = sampled_gramian(np.eye(len(a)) + a * dt, b, horizon / dt) if dt else gramian(a, b, horizon)
    singular = np.linalg.svd(W, compute_uv=False)
    mixed = tuple(n for n in mixed_states if n not in missing)
    return Subspace(basis.shape[1], len(names), tuple(missing), mixed, horizon, tuple(map(float, singular)))


def reachable(a: Array, b: Array) -> Array:
    """An orthonormal basis of the states that inputs can reach, shape (n, rank)."""
    scale = np.linalg.norm(a) or 1.0
    new = basis = _range_basis(b / (np.linalg.norm(b) or 1.0))
    while new.shape[1] and basis.shape[1] < len(a):
        ahead = a @ new / scale
        for _ in range(2):  # once is not enough for the last digits
            ahead = ahead - basis @ (basis.T @ ahead)
        new = _range_basis(ahead)
        basis = np.hstack([basis, new])
    return basis


def _range_basis(columns: Array) -> Array:
    left, singular, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, singular > SETTINGS.rank]


def gramian(a: Array, b: Array, horizon: float) -> Array:
    """Integral of exp(A t) B B' exp(A' t) over the horizon, shape (n, n).

    By Van Loan's exponential over a short time, which loses its digits over a long one, and doubling.
    """
    n = len(a)
    doublings = max(0, ceil(log2(max(float(np.linalg.norm(a)) * horizon, 1e-300))))
    short = horizon / 2**doublings
    result = expm(np.block([[-a, b @ b.T], [np.zeros((n, n)), a.T]]) * short)
    ahead = result[n:, n:].T
    total = ahead @ result[:n, n:]
    for _ in range(doublings):
        total, ahead = total + ahead @ total @ ahead.T, ahead @ ahead
    return total


def sampled_gramian(a: Array, b: Array, samples: float) -> Array:
    """Sum of A^k B B' A'^k over so many samples, shape (n, n); by doubling along their binary digits."""
    total, ahead = np.zeros_like(a), np.eye(len(a))
    for digit in f"{max(ceil(samples), 1):b}":
        total, ahead = total + ahead @ total @ ahead.T, ahead @ ahead
        if digit == "1":
            total, ahead = a @ total @ a.T + b @ b.T, a @ ahead
    return total


def minimal(system: ct.StateSpace) -> ct.StateSpace:
    """The controllable and observable part of a system, in other states."""
    by_rate = slopes(system)
    basis = reachable(by_rate, system.B)
    shown = basis @ reachable(basis.T @ by_rate.T @ basis, basis.T @ system.C.T)
    a, b, c = shown.T @ system.A @ shown, shown.T @ system.B, system.C @ shown
    return ct.ss(a, b, c, system.D, dt=system.dt)


# --- one channel ------------------------------------------------------------------------------
def channel(system: ct.StateSpace, output: str, source: str) -> ct.StateSpace:
    """The minimal system from one input to one output."""
    return minimal(system[output, source])


def zeros_of(system: ct.StateSpace) -> list[complex]:
    """Zeros of a minimal system with one input and one output, rad/s or z, by real part."""
    if not system.nstates:
        return []
    found = [complex(z) for z in system.zeros() if isfinite(abs(z)) and abs(z) < SETTINGS.infinite]
    return sorted((_rounded_off(z, max(abs(z), 1.0)) for z in found), key=lambda z: (z.real, z.imag))


@dataclass(frozen=True)
class Margins:
    """Stability margins of a loop closed by negative feedback."""

    stable: bool  # whether the closed loop is; if not, the margins say what would have to change
    gain: float  # factor on the loop gain, the nearest to one, that leads to the border; infinite without
    phase: float  # that leads to the border, degrees: the least by magnitude
    delay: float  # dead time that may be added, s; zero where the loop is unstable
    distance: float  # least one of the Nyquist curve from -1
    crossover: float  # highest frequency at which the loop gain is one, rad/s; nan where it never is
    # Disk margin without skew: gain and phase may vary together within the disk of this size; zero where the
    # loop is unstable. Its gain margin is (2 + disk)/(2 - disk) both ways, its phase margin 2 atan(disk/2).
    disk: float = 2.0


_NO_LOOP = Margins(True, inf, inf, inf, 1.0, float("nan"))


def margins(loop: ct.StateSpace) -> Margins:
    """Margins of a loop L(s), or L(z), that is closed by negative feedback."""
    if not loop.nstates or not np.any(loop.B):
        return _NO_LOOP
    gains, phases, distances, crossings = _crossings(loop)
    stable = _closes_stably(loop)
    low, high = SETTINGS.factors
    factors = [float(g) for g in gains if low < abs(g) < high]
    delays = [np.radians(p % 360.0) / w for p, w in zip(phases, crossings, strict=True) if w > 0]
    return Margins(
        stable,
        min(factors, key=lambda g: abs(np.log(abs(g))), default=inf),
        min(map(float, phases), key=abs, default=inf),
        float(min(delays, default=inf)) if stable else 0.0,
        float(min(1.0, *distances)) if len(distances) else 1.0,
        float(max(crossings, default=float("nan"))),
        _disk_margin(loop) if stable else 0.0,
    )


def _crossings(loop: ct.StateSpace) -> tuple[Array, Array, Array, Array]:
    """Gains, phases and distances where one of them is least, and frequencies of the phases, rad/s."""
    dt = sampling_time(loop)
    if not dt:
        gains, phases, distances, _, crossings, _ = ct.stability_margins(loop, returnall=True)
        return gains, phases, distances, crossings
    curve = ct.frd(loop, frequencies([loop])[:-1], smooth=True)  # polynomials in z lose their digits
    gains, phases, distances, _, crossings, _ = ct.stability_margins(curve, returnall=True)
    end = float(np.real(np.squeeze(loop(-1.0 + 0j))))  # real at half the sampling frequency
    if end < 0:
        gains = np.append(gains, -1 / end)
    return gains, phases, np.append(distances, abs(1 + end)), crossings


def _closes_stably(loop: ct.StateSpace) -> bool:
    closed = ct.feedback(loop, np.eye(loop.noutputs))
    return all(_rate(complex(p), sampling_time(loop)).real <= SETTINGS.at_zero for p in closed.poles())


def multiloop_disk_margin(loop: ct.StateSpace) -> float:
    """Disk margin without skew of all loops at once: each may vary within a disk of this size by itself.

    python-control takes the upper bound of the structured singular value from SLICOT. Zero where the closed
    loop is unstable.
    """
    if not loop.issiso() and find_spec("slycot") is None:
        raise UndertowError(
            f"the disk margin of {loop.ninputs} loops at once needs slycot: pip install 'undertow[slycot]'"
        )
    if not _closes_stably(loop):
        return 0.0
    return _least_disk(loop, lambda omega: float(multiloop_disks(loop, np.array([omega]))[0]))


def multiloop_disks(loop: ct.StateSpace, omega: Array) -> Array:
    """The disk at each frequency, rad/s, whose minimum is `multiloop_disk_margin`."""
    return np.atleast_1d(ct.disk_margins(loop, omega, returnall=True)[0])


def disks(gain: NDArray[np.complex128]) -> Array:
    """Size of the disk in which loop gains L may vary up to the stability limit: 2 |1 + L| / |1 - L|.

    Seiler, Packard, Gahinet (2020), An introduction to disk margins: 1/(|S - T|/2) for zero skew.
    """
    return np.asarray(2 * np.abs(1 + gain) / np.maximum(np.abs(1 - gain), 1e-300))


def _disk_margin(loop: ct.StateSpace) -> float:
    """The least disk over all frequencies."""
    return _least_disk(
        loop, lambda omega: float(disks(np.squeeze(loop(at_frequencies(loop, np.array(omega))))))
    )


def _least_disk(loop: ct.StateSpace, disk: Callable[[float], float]) -> float:
    """The least disk over all frequencies; far beyond the last one it is 2."""
    omega = frequencies([loop, ct.feedback(loop, np.eye(loop.noutputs))])  # crossovers are at its poles

    def at(logarithm: float) -> float:
        return disk(float(np.exp(logarithm)))

    values = [at(w) for w in np.log(omega)]
    k = int(np.clip(np.argmin(values), 1, len(omega) - 2))
    ends = float(np.log(omega[k - 1])), float(np.log(omega[k + 1]))
    found = minimize_scalar(at, bounds=ends, method="bounded", options={"xatol": SETTINGS.margin_tolerance})
    return min(float(found.fun), *values, 2.0)


@dataclass(frozen=True)
class Curve:
    """One curve, of shape (n,)."""

    name: str
    x: Array  # rad/s, or s
    y: NDArray[np.complex128]  # complex values, or values


def frequencies(systems: list[ct.StateSpace]) -> Array:
    """Frequencies around the poles of systems, rad/s, shape (n,)."""
    sizes = [abs(_rate(complex(p), sampling_time(s))) for s in systems for p in s.poles()]
    sizes = [size for size in sizes if SETTINGS.least_pole < size < inf]
    slow, fast = SETTINGS.no_poles
    low, high = min(sizes, default=slow), max(sizes, default=fast)
    # From half the sampling frequency on the response repeats; rounding may not go beyond it.
    half = [(1 - SETTINGS.rank) * np.pi / sampling_time(s) for s in systems if sampling_time(s)]
    end = min(half, default=high * 10**SETTINGS.decades)
    return np.geomspace(min(low, end) * 10**-SETTINGS.decades, end, SETTINGS.points)


def response(name: str, system: ct.StateSpace, omega: Array) -> Curve:
    """The frequency response of a system with one input and one output."""
    return Curve(name, omega, np.asarray(system(at_frequencies(system, omega))).ravel())


def singular_values(system: ct.StateSpace, omega: Array) -> Array:
    """Singular values of the frequency response, largest first, shape (min(outputs, inputs), n)."""
    matrices = np.moveaxis(np.asarray(system(at_frequencies(system, omega), squeeze=False)), -1, 0)
    return np.asarray(np.linalg.svd(matrices, compute_uv=False).T)


def duration(systems: list[ct.StateSpace]) -> float:
    """Duration of a step response: a few of the slowest time constants, s."""
    reals = [abs(m.rate.real) for s in systems for m in modes(s) if SETTINGS.slowest < abs(m.rate.real) < inf]
    return float(min(SETTINGS.time_constants / min(reals, default=1.0), SETTINGS.longest))


def step(name: str, system: ct.StateSpace, seconds: float) -> Curve:
    """The unit step response of a system with one input and one output."""
    dt = sampling_time(system)
    times = np.arange(ceil(seconds / dt) + 1) * dt if dt else np.linspace(0.0, seconds, SETTINGS.points)
    t, y = ct.step_response(system, times, squeeze=True)
    return Curve(name, np.asarray(t), np.asarray(y).ravel())


def locus(system: ct.StateSpace) -> NDArray[np.complex128]:
    """Poles (n, order) of a loop closed with n gains times the system."""
    gains = np.concatenate([[0.0], np.geomspace(*SETTINGS.locus, 2 * SETTINGS.points)])
    return np.asarray(ct.root_locus_map(system, gains=gains).loci)
