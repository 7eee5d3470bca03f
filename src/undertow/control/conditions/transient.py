"""Bounds in time: from a box of starts at rest, how far every motion can go and that it comes back.

By variation of constants z(t) = e^{At} z(0) + integral of e^{A(t-s)} g(z(s)) ds. Bounds B on the signals of
z bound g, and this integral; where what comes out is below B, no motion leaves B. What g comes to at second
order in the start is worked out (`second_order_motion`), and only what is beyond is bounded, by integrals of
|responses|.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array, Flags

from .attitude import enclose, plus_minus
from .definite import SETTINGS as PROOFS
from .motion import (
    Derivatives,
    DrivenMotion,
    PoseLoop,
    QuadraticForm,
    StartBox,
    heading_motion,
    second_order_motion,
)
from .problem import Problem, Span
from .responses import SETTINGS as KERNELS
from .responses import Kernels, Modes, Responses, modes, time_grid
from .result import Transient


@dataclass(frozen=True)
class TransientSettings:
    """How bounds in time are searched for; none of these numbers decides what is proved."""

    # Where gains tell north from east: ranges of the set-points' headings in half a turn, and how often each
    # is cut in two before it is given up.
    ranges: int = 16
    probe_headings: int = 8  # single headings in half a turn that are looked at before any range of them
    cuts: int = 3
    # Angles up to which what is left over is bounded, times those of the start.
    caps: tuple[float, ...] = (0.2, 0.5, 0.8, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0)
    # What counts as the start of an angle at least, so that it may be moved: a part of the largest, and rad.
    least_share: float = 0.1
    least_angle: float = 0.02
    largest_heading: float = np.pi / 2  # error of the heading that is tried at most, rad
    rounds: int = 12  # in which a bound of one piece of time has to be found, and
    growth: float = 1.05  # how much is added in each, relative
    room: float = 1e-6  # in every bound, relative: more than all rounding of sums of positive numbers


SETTINGS = TransientSettings()


class Signals(NamedTuple):
    """Places of the signals."""

    z: slice
    error: slice
    rate: slice
    force: slice
    acceleration: slice
    slope: slice  # of the force in the heading, in the plane
    turning: slice  # the part of the force that turns with the heading, in the plane
    pull: slice  # what a unit of each angle turns of force and damping
    # Sums of those before:
    commands: slice
    second: slice  # as `pull`, of second order, by pair of angles


class Sector:
    """The linear loop of set-points in one range of headings, `half` to either side of its middle."""

    def __init__(
        self, motion: PoseLoop, starts: StartBox, slopes: Derivatives, heading: float, half: float
    ) -> None:
        self.motion, self.starts, self.slopes, self.half = motion, starts, slopes, half
        force, slope, turning = motion.law_matrices(heading)
        self.A = A = motion.system_matrix(force)
        self.modes: Modes = modes(enclose(A))
        self.force, n, size = force, motion.n, len(A)
        share, holding = (np.concatenate(m) for m in motion.command_rows)
        commands = share @ force
        commands[:, size - 2 * n : size - n] += holding
        rate = np.eye(size)[-n:]
        pull = slopes.W @ force - slopes.P @ rate
        pull_second = slopes.W_second @ force - slopes.P_second @ rate
        first, second = motion.angle_pairs
        parts = [np.eye(size), force, A[-n:], slope, turning, pull.reshape(-1, size)]
        parts += [commands, pull_second[first, second].reshape(-1, size)]
        self.rows = np.vstack(parts)
        ends = np.cumsum([len(r) for r in parts])
        spans = [slice(a, b) for a, b in pairwise(ends)]
        self.signals = Signals(slice(0, size), slice(size - 2 * n, size - n), slice(size - n, size), *spans)
        # By how much the heading changes the equation, and bounds on what both parts of `pull` come to.
        self.heading_slope = np.zeros((size, size))
        self.heading_slope[-n:] = motion.inverse[:, motion.plane] @ slope
        self.pull_bound = np.abs(slopes.W) @ np.abs(force) + np.abs(slopes.P) @ rate
        # What the modes miss, and what rounding made of the rows.
        self.residual = self.modes.residual.copy()
        self.residual[-n:] += (
            PROOFS.rounding * motion.magnitudes[0] @ (np.abs(force) + np.abs(motion.forces.D) @ rate)
        )
        self.rounded = PROOFS.rounding * np.abs(force)

    @property
    def base(self) -> Array:
        """Rows of the signals that others are sums of."""
        return self.rows[: self.signals.commands.start]

    @cached_property
    def sums(self) -> Array:
        """Magnitudes of what the others are made of, (others, base)."""
        at, slopes, motion = self.signals, self.slopes, self.motion
        first, second = motion.angle_pairs
        found = np.zeros((len(self.rows) - len(self.base), len(self.base)))
        count = at.commands.stop - at.commands.start
        found[:count, at.force], found[:count, at.error] = (np.concatenate(m) for m in motion.command_rows)
        found[count:, at.force] = slopes.W_second[first, second].reshape(-1, motion.n)
        found[count:, at.rate] = slopes.P_second[first, second].reshape(-1, motion.n)
        return np.abs(found) * (1 + PROOFS.room)

    def start_response(self, responses: Responses) -> Array:
        """Bound on what is left of the start in each piece of time, (pieces, signals)."""
        every, errors = np.arange(len(self.rows)), range(*self.signals.error.indices(len(self.rows)))
        per_error = np.array([responses.pieces(every, np.full(len(every), e)) for e in errors])
        return self.starts.linear(per_error).T * (1 + SETTINGS.room)

    def driven(self, times: Array) -> list[DrivenMotion]:
        """Motion of second order in the start, and of first order in the heading."""
        at, slopes = self.signals, self.slopes
        angles = -np.eye(at.z.stop)[at.error][self.motion.angle_indices]
        pull = self.rows[at.pull].reshape(len(angles), self.motion.n, at.z.stop)
        form = QuadraticForm(angles, pull, slopes.Gamma, self.pull_bound)
        found = [second_order_motion(self.modes, self.A, form, self.rows, self.starts, times)]
        if self.half:
            unit = heading_motion(self.modes, self.A, self.heading_slope, self.rows, self.starts, times)
            found.append(DrivenMotion(*(self.half * m for m in unit)))
        return found


class SignalBounds(NamedTuple):
    """What is known of the signals in one piece of time, by sector."""

    first: Array  # bound on the part that is linear in the start
    rest: Array  # bound on the others
    defect: Array  # push on each state that these miss

    @property
    def total(self) -> Array:
        """Bound on the signals."""
        return self.first + self.rest


class PushBounds:
    """Bounds on what the linear loops of some sectors leave out, from bounds on their signals."""

    def __init__(self, sectors: Sequence[Sector], caps: Array) -> None:
        self.sectors, self.caps = sectors, caps  # caps rise, (caps, angles)
        self.motion, self.at, self.slopes = sectors[0].motion, sectors[0].signals, sectors[0].slopes
        self.inverse, self.D_signs, self.Q, self.Q_signs = self.motion.magnitudes
        self.unit = np.eye(self.motion.n)
        self.half = np.array([s.half for s in sectors])[:, None]
        self.residual = np.array([s.residual for s in sectors])
        self.rounded = np.array([s.rounded for s in sectors])
        self.W, self.P, self.Gamma = (np.abs(m) for m in (self.slopes.W, self.slopes.P, self.slopes.Gamma))

    def angles(self, B: Array) -> Array:
        """Bound on the angles."""
        return np.asarray(B[..., self.at.error][..., self.motion.angle_indices])

    def push(self, known: SignalBounds) -> Array:
        """Bound on the push on each state that is not known, by sector; infinite beyond the caps."""
        at, B, slopes, n = self.at, known.total, self.slopes, self.motion.n
        angles = self.angles(B)
        capped = np.asarray((angles[:, None] <= self.caps).all(axis=-1))
        cap = capped.argmax(axis=1)
        both, (first, second) = angles[:, :, None] * angles[:, None], self.motion.angle_pairs
        products = np.where(first == second, 1.0, 2.0) * both[:, first, second]
        v, turned = B[:, at.rate], self._heading_error(B, B)
        W_error, P_error = (_sector_sums(both, m[cap]) for m in (slopes.W_error, slopes.P_error))
        nonlinear = _sector_sums(products, B[:, at.second].reshape(len(B), -1, n))
        nonlinear = nonlinear + _matvec(W_error, B[:, at.force]) + _matvec(P_error, v)
        changed = (
            _weighted(angles, self.W) + _weighted(products, np.abs(slopes.W_second)[first, second]) + W_error
        )
        nonlinear = nonlinear + _matvec(changed, turned)
        J, Ji = (_sector_sums(angles, m[cap]) + self.unit for m in (slopes.J, slopes.J_inverse))
        nu = _matvec(Ji, v)
        signed = nu @ self.D_signs.T + _bilinear(self.Q_signs, nu, nu)
        pulled = B[:, at.acceleration] + nonlinear + self._second_order(B, B) + turned @ self.inverse.T
        body = _matvec(Ji, pulled) + _bilinear(self.Q, nu, nu) + signed
        nonlinear = nonlinear + _bilinear(_sector_sums(angles, slopes.Gamma_slope[cap]), v, v)
        new = (
            self._second_order(known.rest, B) + self._second_order(known.first, known.rest) + self._rounded(B)
        )
        new = new + (self._heading_error(known.rest, B) + _matvec(self.rounded, B[:, at.z])) @ self.inverse.T
        found = _matvec(self.residual, B[:, at.z]) + known.defect
        found[:, at.rate] += new + nonlinear + _matvec(J, signed + body @ self.motion.inertia_variation.T)
        return np.where(np.asarray(capped.any(axis=1))[:, None], found * (1 + SETTINGS.room), np.inf)

    def _rounded(self, B: Array) -> Array:
        """What rounding of the form of second order comes to, any entry of which may be off."""
        angles, force, v = (B[:, part].sum(axis=1) for part in (self.at.error, self.at.force, self.at.rate))
        W, P, Gamma = (float(m.max(initial=0.0)) for m in (self.W, self.P, self.Gamma))
        found = PROOFS.rounding * len(self.unit) * (angles * (W * force + P * v) + Gamma * v**2)
        return np.asarray(found[:, None])

    def _second_order(self, one: Array, other: Array) -> Array:
        """Bound on the form of second order, of bounds on two sets of signals."""
        at = self.at
        found = _bilinear(self.Gamma, one[:, at.rate], other[:, at.rate])
        for a, b in ((one, other), (other, one)):
            found = found + 0.5 * _sector_sums(
                self.angles(a), b[:, at.pull].reshape(len(b), -1, self.motion.n)
            )
        return np.asarray(found)

    def _heading_error(self, rest: Array, B: Array) -> Array:
        """What the force differs by at the other headings of a sector, but for what `rest` leaves out."""
        found = np.zeros((*B.shape[:-1], self.motion.n))
        turning = 2 * self.half**2 * B[..., self.at.turning]
        found[..., self.motion.plane] = self.half * rest[..., self.at.slope] + turning
        return found

    def speeds(self, B: Array) -> Array:
        """Bound on the body velocities, shape (pieces, sectors, n)."""
        Ji = self.unit + _weighted(self.angles(B), self.slopes.J_inverse[-1])
        return _matvec(Ji, B[..., self.at.rate])

    def commands(self, B: Array) -> Array:
        """Bound on each limited command, shape (pieces, sectors, commands)."""
        at, share = self.at, np.abs(self.motion.commands.B_inverse)
        turned = share @ np.swapaxes(_weighted(self.angles(B), self.slopes.J[-1]), -1, -2)
        force = B[..., at.force] + _matvec(self.rounded, B[..., at.z])
        body = _matvec(turned + PROOFS.room * share, force) + _matvec(
            turned + share, self._heading_error(B, B)
        )
        sides = len(self.motion.command_rows[0])
        linear = B[..., at.commands].reshape(*B.shape[:-1], sides, len(share)).max(axis=-2)
        return np.asarray(linear + body + self.motion.commands.steady() + self._restoring_error(B))

    def _restoring_error(self, B: Array) -> Array:
        """What holding the weight differs by from its tangent."""
        motion, errors = self.motion, B[..., self.at.error].reshape(-1, self.motion.n)
        own = {a: errors[:, motion.names.index(a)] for a in ("phi", "theta") if a in motion.names}
        shape = (*B.shape[:-1], len(motion.commands.limits))
        if not own or not len(motion.commands.limits):
            return np.zeros(shape)
        tangents = motion.commands.restoring_slopes({a: plus_minus(e) for a, e in own.items()})
        difference = (tangents - motion.commands.restoring_slopes({}).middle).magnitude
        angles = np.stack([own.get(a, np.zeros(len(errors))) for a in ("phi", "theta")], axis=-1)
        return (np.einsum("kma,ka->km", difference, angles) * (1 + SETTINGS.room)).reshape(shape)


def _matvec(matrices: Array, vectors: Array) -> Array:
    """Matrices times vectors along the last axes."""
    return np.asarray((matrices @ vectors[..., None])[..., 0])


def _bilinear(forms: Array, one: Array, other: Array) -> Array:
    """Forms in two vectors along the last axes."""
    return _matvec((one[..., None, None, :] @ forms)[..., 0, :], other)


def _sector_sums(weights: Array, matrices: Array) -> Array:
    """Sums of matrices of each sector by its weights, (sectors, many) and (sectors, many, ...)."""
    many, shape = weights[0].size, matrices.shape[weights.ndim :]
    found = weights.reshape(len(weights), 1, many) @ matrices.reshape(len(weights), many, math.prod(shape))
    return np.asarray(found.reshape(len(weights), *shape))


def _weighted(weights: Array, matrices: Array) -> Array:
    """Sums of the same matrices by weights along the last axis."""
    return np.asarray(np.tensordot(weights, matrices, 1))


class Tubes:
    """Bounds on the signals of some sectors, piece by piece of time, whose ends have this ratio."""

    def __init__(self, bounds: PushBounds, ratio: float) -> None:
        sectors, at = bounds.sectors, bounds.at
        self.bounds, self.size, self.ratio = bounds, at.z.stop, ratio
        rates = np.concatenate([s.modes.rates for s in sectors])
        self.rates, self.slowest, self.times = rates, float(rates.real.min()), time_grid(rates, ratio)
        coarse = [Responses(s.modes, s.rows, self.times) for s in sectors]
        self.sums = sectors[0].sums
        self.envelope = np.array([of.envelope[: at.commands.start] for of in coarse])
        driven = [s.driven(self.times) for s in sectors]
        decay = np.exp(-self.slowest * self.times)[:, None, None]
        initial_defect = np.array([sum(d.initial_defect for d in own) for own in driven])
        started = [s.start_response(responses) for s, responses in zip(sectors, coarse, strict=True)]
        self.first = np.array(started).swapaxes(0, 1)
        own = [
            np.array([sum(getattr(d, name) for d in ds) for ds in driven]) for name in ("signals", "defect")
        ]
        self.rest, self.defect = (m.swapaxes(0, 1) for m in own)
        self.rest = self.rest + decay * self._all_signals(_matvec(self.envelope, initial_defect))
        self._kernels()
        many, count = len(self.times) - 1, len(sectors)
        self.rises, self.falls = np.zeros((2, many, count, len(self.states)))  # of the pushes at each piece
        self.lag = np.zeros((count, self.size))  # pushes so far, dying with the slowest mode
        self.last = np.zeros((count, self.size))  # push in the last piece

    def _kernels(self) -> None:
        """What pushes on the rates do to every signal, by kernels where that is anything."""
        n, size, sectors = self.bounds.motion.n, self.size, self.bounds.sectors
        envelope = self.envelope[..., size - n :].max(axis=0)
        matters = envelope > PROOFS.room * envelope.max(axis=1, keepdims=True)
        matters[: size - 2 * n] = False  # integrals of errors stand only beside what modes miss
        self.pairs = self.signals, self.states = np.nonzero(matters)[0], size - n + np.nonzero(matters)[1]
        finer = time_grid(self.rates, self.ratio, KERNELS.refinement, self.times[-1])
        found = [Responses(s.modes, s.base, finer).kernels(*self.pairs) for s in sectors]
        self.kernels = Kernels(finer, *(np.stack([k[j] for k in found], axis=-2) for j in (1, 2)))
        self.tail = self.envelope.copy()  # what the kernels leave out, dying with the slowest mode
        self.tail[:, self.signals, self.states] = 0.0

    def run(self) -> tuple[Array, Flags]:
        """Bounds on the signals by piece, (pieces, sectors, signals), and of which sectors they are any.

        They are none where they grow beyond the caps.
        """
        found, times = [], self.times
        self.valid, self.earlier = np.ones(len(self.bounds.sectors), dtype=bool), self._up_to(0)
        for i, width in enumerate(np.diff(times)):
            B, push = self._bound_piece(i, *self._past(i), self.tail * self._decayed(width))
            if not self.valid.any():
                break
            found.append(B)
            step = (push - self.last)[:, self.states]
            self.rises[i], self.falls[i], self.last = np.maximum(step, 0.0), np.maximum(-step, 0.0), push
            self.lag = np.exp(-self.slowest * width) * self.lag + self._decayed(width) * push
        else:
            # What was pushed so far dies out, and so does what is pushed from then on.
            gain = self._as_matrices(self.kernels.weighted)
            tail = self.tail / ((1 - KERNELS.decay_share) * self.slowest)
            found.append(
                self._bound_piece(-1, _matvec(self.envelope, self.lag), gain, 0 * self.last, tail)[0]
            )
        return np.array(found), self.valid

    def _all_signals(self, base: Array) -> Array:
        """Bounds on all signals from those on the ones that the others are sums of."""
        return np.concatenate([base, base @ self.sums.T], axis=-1)

    def _decayed(self, width: float) -> float:
        return float(-np.expm1(-self.slowest * width) / self.slowest)

    def _as_matrices(self, values: Array) -> Array:
        """Values by pair of the kernels as matrices, (sectors, signals, states)."""
        found = np.zeros_like(self.tail)
        found[:, self.signals, self.states] = values
        return found

    def _up_to(self, i: int) -> Array:
        """Integrals of the kernels from the beginnings of pieces up to time i."""
        return self.kernels.up_to(self.times[i] - self.times[: max(i, 1)])

    def _past(self, i: int) -> tuple[Array, Array, Array]:
        """What the pushes before piece i do in it by kernels, what more in it adds, and the last push.

        The integral of |H(t - s)| times a push that is constant by piece is a sum over its steps at the
        beginnings of pieces, times integrals of |H| since then.
        """
        later, rises, falls = self._up_to(i + 1), self.rises[:i], self.falls[:i]
        own = np.einsum("ihp,ihp->hp", later[:i], rises) - np.einsum("ihp,ihp->hp", self.earlier[:i], falls)
        rounding = len(self.kernels.times) * np.finfo(float).eps  # of integrals: sums over the pieces
        own += rounding * self.kernels.integral[-1] * (rises.sum(axis=0) + falls.sum(axis=0))
        rest = _matvec(self.tail, self.lag)
        np.add.at(rest.T, self.signals, np.maximum(own, 0.0).T)
        self.earlier = later
        return rest * (1 + SETTINGS.room), self._as_matrices(later[i]), self.last

    def _bound_piece(
        self, i: int, rest: Array, gain: Array, since: Array, tail: Array
    ) -> tuple[Array, Array]:
        """Bounds on signals and pushes that what they let happen does not leave; what grows is dropped."""
        most, rest = self.last.copy(), self.rest[i] + self._all_signals(rest)
        for _ in range(SETTINGS.rounds):
            more = _matvec(gain, np.maximum(most - since, 0.0)) + _matvec(tail, most)
            one = SignalBounds(
                self.first[i], rest + self._all_signals(more) * (1 + SETTINGS.room), self.defect[i]
            )
            push = self.bounds.push(one)
            grows = ~(push <= most).all(axis=1)
            self.valid &= np.isfinite(push).all(axis=1)
            if not (grows & self.valid).any():
                break
            most = np.where(self.valid[:, None], np.maximum(most, SETTINGS.growth * push), most)
        self.valid &= ~grows
        return one.total, np.where(self.valid[:, None], push, 0.0)


def bounds_in_time(problem: Problem, start: Mapping[str, float]) -> Transient | None:
    """Bounds on every motion from rest in a box of errors, at any heading of the set-point; None if none."""
    if problem.gains.schedule.order == "yaw-first":
        return None  # its gate opens in motion, and bounds are for motions from rest
    search = TubeSearch(PoseLoop(problem), np.array([start.get(c, 0.0) for c in problem.coordinates]))
    if not problem.heading_matters:
        return search.cover([(0.0, 0.0)], 0)
    # A half turn in the plane changes no bound; nor does a mirror, where port is as starboard.
    turn, share = (0.5 * np.pi, 2) if search.motion.mirror_symmetric else (np.pi, 1)
    probes, ranges = (_ranges(turn, count // share) for count in (SETTINGS.probe_headings, SETTINGS.ranges))
    unbounded = [(h, 0.0) for h, _ in probes]
    for k, ratio in enumerate(KERNELS.ratios):
        unbounded = search.unbounded(unbounded, [], ratio)
        if not unbounded:
            # What coarser pieces of time do not prove of a single heading, they prove of no range around it.
            return search.cover(ranges, SETTINGS.cuts, KERNELS.ratios[k:])
    return None


def _ranges(turn: float, count: int) -> list[Span]:
    """So many ranges, middle and half, in a turn from zero."""
    half = 0.5 * turn / count
    return [((2 * k + 1) * half, half) for k in range(count)]


class Sweep:
    """How a range of headings is gone through: from its lower end on, in parts as wide as have bounds.

    The sizes of parts are powers of two of the narrowest one. The first part is the whole range. Where that
    has no bounds, the next one is a narrowest one: where that has none either, no other need be looked at.
    As long as parts can be cut, that is tried before finer pieces of time.
    """

    def __init__(self, span: Span, cuts: int, ratios: Sequence[float]) -> None:
        self.span, self.count, self.ratios, self.done = span, 2**cuts, list(ratios), 0
        self.widest = self.count  # that may have bounds

    @property
    def size(self) -> int:
        """How many of the narrowest parts the next one is."""
        if not self.done:
            return self.count if self.widest == self.count else 1
        return min(self.widest, self.done & -self.done)  # a part begins at a multiple of its size

    @property
    def part(self) -> Span:
        """The next part, middle and half."""
        middle, half = self.span
        return middle + half * ((2 * self.done + self.size) / self.count - 1), half * self.size / self.count

    def advance(self, bounded: bool) -> None:
        """The next part has bounds, or is to be narrower, or in finer pieces of time."""
        if bounded:
            self.done += self.size
        elif self.size > 1:
            self.widest = self.size // 2
        else:
            self.ratios, self.widest = self.ratios[1:], self.count // 2


class TubeSearch:
    """Bounds for a start box, by ranges of set-points' headings."""

    def __init__(self, motion: PoseLoop, box: Array) -> None:
        self.motion, self.starts = motion, StartBox(box, motion.plane)
        # Caps on the angles, from small to large.
        most = [
            SETTINGS.largest_heading if a == "psi" else motion.problem.attitudes.tilt for a in motion.angles
        ]
        own = box[motion.angle_indices]
        own = np.maximum(own, max(SETTINGS.least_share * own.max(initial=0.0), SETTINGS.least_angle))
        self.caps = np.array([np.minimum(c * own, most) for c in SETTINGS.caps]).reshape(
            len(SETTINGS.caps), -1
        )
        self.slopes = motion.derivatives(self.caps)

    def cover(
        self, ranges: Sequence[Span], cuts: int, ratios: Sequence[float] = KERNELS.ratios
    ) -> Transient | None:
        """Bounds for all of these (middle, half), which are cut in two where there are none; None if none."""
        found: list[Transient] = []
        sweeps = [Sweep(span, cuts, ratios) for span in ranges]
        while sweeps:
            for ratio in {s.ratios[0] for s in sweeps}:
                own = [s for s in sweeps if s.ratios[:1] == [ratio]]  # one may have none left by now
                unbounded = self.unbounded([s.part for s in own], found, ratio)
                for sweep in own:
                    sweep.advance(sweep.part not in unbounded)
            if not all(s.ratios for s in sweeps):
                return None
            sweeps = [s for s in sweeps if s.done < s.count]
        return _merged(found)

    def unbounded(self, ranges: Sequence[Span], found: list[Transient], ratio: float) -> list[Span]:
        """The ranges without bounds in pieces of time of this ratio; those of the others are added."""
        sectors = [
            Sector(self.motion, self.starts, self.slopes, r[0], r[1] * (1 + PROOFS.room)) for r in ranges
        ]
        tubes = Tubes(PushBounds(sectors, self.caps), ratio)
        B, held = tubes.run()
        if held.any():
            largest = tubes.bounds.commands(B)
            held = held & _within_limits(self.motion, largest, held, refuse=ratio == KERNELS.ratios[-1])
            found += _as_transients(tubes, B, largest, held)
        return [r for r, there in zip(ranges, held, strict=True) if not there]


def _within_limits(motion: PoseLoop, largest: Array, held: Flags, *, refuse: bool) -> Flags:
    """For which sectors all commands stay below their limits; or an error, always if the start is beyond."""
    limits = motion.commands.limits
    for k, limit in enumerate(limits):
        own = largest[:, held, k].max(axis=1)
        if own[0] >= limit or (refuse and own.max() >= limit):
            word = "the start asks" if own[0] >= limit else "bounds in time let the law ask"
            raise UndertowError(
                f"{word} {own.max():.4g} of {motion.commands.names[k]}, whose limit is {limit:.4g}: state "
                "smaller errors or lower K_P"
            )
    return np.asarray((largest.max(axis=0) < limits).all(axis=1))


def _as_transients(tubes: Tubes, B: Array, largest: Array, held: Flags) -> list[Transient]:
    """Bounds on the signals as statements, in the coordinates of the earth."""
    bounds, motion = tubes.bounds, tubes.bounds.motion
    errors = B[..., bounds.at.error].copy()
    if motion.plane:
        errors[..., motion.plane] = np.hypot(*np.moveaxis(errors[..., motion.plane], -1, 0))[..., None]
    speeds = bounds.speeds(B)
    rate = KERNELS.decay_share * tubes.slowest
    return [
        Transient(tubes.times, errors[:, k], speeds[:, k], largest[:, k], rate) for k in np.flatnonzero(held)
    ]


def _merged(found: Sequence[Transient]) -> Transient:
    """One statement for the headings of several, on the pieces of time of the first."""
    first = found[0]
    ends = np.append(first.times[1:], np.inf)
    pieces = [[f.between(a, b) for f in found] for a, b in zip(first.times, ends, strict=True)]

    def largest(name: str) -> Array:
        return np.array([np.max([getattr(p, name) for p in parts], axis=0) for parts in pieces])

    rate = min(f.rate for f in found)
    return Transient(first.times, largest("errors"), largest("speeds"), largest("commands"), rate)
