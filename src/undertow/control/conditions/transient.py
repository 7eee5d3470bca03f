"""Bounds in time: from a box of starts at rest, how far every motion can go and that it comes back.

By variation of constants z(t) = e^{At} z(0) + integral of e^{A(t-s)} g(z(s)) ds. Bounds B on the signals of
z bound g, and this integral; where what comes out is below B, no motion leaves B. What g comes to at second
order in the start is worked out (`second`), and only what is beyond is bounded, by integrals of |responses|
(`kernels`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .attitude import Interval, enclose
from .definite import SETTINGS as PROOFS
from .kernels import SETTINGS as KERNELS
from .kernels import Kernels, Modes, Responses, grid, modes
from .motion import Leftover, Motion
from .problem import Problem
from .result import Transient
from .second import Form, Second, second_order


@dataclass(frozen=True)
class TransientSettings:
    """How bounds in time are searched for; none of these numbers decides what is proved."""

    # Where gains tell north from east: how often the set-points' headings of half a turn are cut in two at
    # first, and before they are given up.
    coarse: int = 2
    cuts: int = 7
    looks: int = 8  # single headings of half a turn that are looked at before any range of them
    # Angles up to which what is left over is bounded, times those of the start.
    caps: tuple[float, ...] = (0.2, 0.5, 0.8, 1.0, 1.2, 1.5, 2.0, 3.0, 5.0)
    # What counts as the start of an angle at least, so that it may be moved: a part of the largest, and rad.
    least_share: float = 0.1
    least_angle: float = 0.02
    largest_heading: float = np.pi / 2  # error of the heading that is tried at most, rad
    rounds: int = 12  # in which a bound of one piece of time has to be found, and
    more: float = 1.05  # how much is added in each, relative
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
    commands: slice


class Sector:
    """The linear loop of set-points in one range of headings, `half` to either side of its middle."""

    def __init__(self, motion: Motion, start: Array, heading: float, half: float) -> None:
        self.motion, self.start, self.heading, self.half = motion, start, heading, half
        force, slope, turning = motion.law(heading)
        A = motion.linear(force)
        self.modes: Modes = modes(enclose(A))
        commands = motion.commands.share @ force
        commands[:, len(A) - 2 * motion.n : len(A) - motion.n] += motion.holding
        rows = [np.eye(len(A)), force, A[-motion.n :], slope, turning, commands]
        self.rows = np.vstack(rows)
        n, ends = motion.n, np.cumsum([len(r) for r in rows])
        spans = [slice(a, b) for a, b in pairwise(ends)]
        size = len(A)
        self.signals = Signals(slice(0, size), slice(size - 2 * n, size - n), slice(size - n, size), *spans)
        # What the modes miss, and what rounding made of the rows.
        self.off = self.modes.off.copy()
        inverse = motion.magnitudes[0]
        pulled = np.abs(force) + np.hstack([np.zeros((n, size - n)), np.abs(motion.forces.D)])
        self.off[size - n :] += PROOFS.rounding * inverse @ pulled
        self.rounded = PROOFS.rounding * np.abs(force)

    @cached_property
    def times(self) -> Array:
        """Ends of the pieces of time, s; the last piece has no end."""
        return grid(self.modes.rates)

    @cached_property
    def _responses(self) -> Responses:
        return Responses(self.modes, self.rows, self.times)

    @cached_property
    def begun(self) -> Array:
        """Bound on what is left of the start in each piece of time, (pieces, signals)."""
        motion, errors = self.motion, range(*self.signals.error.indices(len(self.rows)))
        of = self._responses
        every = np.arange(len(self.rows))
        own = {c: of.pieces(every, np.full(len(every), e)) for c, e in enumerate(errors)}
        found = sum(own[c] * self.start[c] for c in own if c not in motion.plane)
        if motion.plane:
            found = found + self._in_plane(own)
        return np.asarray(found).T * (1 + SETTINGS.room)

    def _in_plane(self, own: Mapping[int, Array]) -> Array:
        """The same of a start in the plane, which stands in the frame of the set-point."""
        x, y = self.motion.plane
        return np.asarray(np.hypot(own[x], own[y]) * np.hypot(*self.start[[x, y]]))

    @property
    def envelope(self) -> Array:
        """Bound on what a start at each state comes to, (signals, states)."""
        return self._responses.envelope

    def second(self, left: Leftover) -> Second:
        """Motion of second order in the start."""
        motion, at = self.motion, self.signals
        rows = np.eye(at.z.stop)
        angles = -rows[at.error][motion.places]
        form = Form(angles, self.rows[at.force], left.W, left.P, left.Gamma)
        A = self.motion.linear(self.rows[at.force])
        return second_order(self.modes, A, form, self.rows, self.start, motion.plane, self.times)

    @cached_property
    def kernels(self) -> Kernels:
        """What pushes on the rates do to every signal, where that is anything."""
        size, first = self.signals.z.stop, self.signals.error.start
        envelope = self.envelope[:, size - self.motion.n :]
        matters = envelope > PROOFS.room * envelope.max(axis=1, keepdims=True)
        matters[:first] = False  # integrals of errors stand only beside what modes miss
        signals, places = np.nonzero(matters)
        finer = Responses(self.modes, self.rows, grid(self.modes.rates, KERNELS.finer, self.times[-1]))
        return finer.kernels(signals, size - self.motion.n + places)

    @cached_property
    def crude(self) -> Array:
        """What pushes do to every signal that the kernels leave out, at most, dying with the slowest mode."""
        found = self.envelope.copy()
        found[self.kernels.signals, self.kernels.states] = 0.0
        return found


class Known(NamedTuple):
    """What is known of the signals in one piece of time."""

    first: Array  # bound on the part that is linear in the start
    rest: Array  # bound on the others
    missed: Array  # push on each state that the second order misses

    @property
    def whole(self) -> Array:
        """Bound on the signals."""
        return self.first + self.rest


class Bounds:
    """Bounds on what the linear loop of one sector leaves out, from bounds on its signals."""

    def __init__(self, sector: Sector, caps: Array, lefts: Sequence[Leftover]) -> None:
        self.sector, self.caps, self.lefts = sector, caps, lefts  # caps rise, (caps, angles)
        motion, left = sector.motion, lefts[0]
        self.inverse, self.D_signs, self.Q, self.Q_signs = motion.magnitudes
        self.unit = np.eye(motion.n)
        self.W, self.P, self.Gamma = (np.abs(m) for m in (left.W, left.P, left.Gamma))

    def _form(self, form: Array, v: Array) -> Array:
        return np.asarray((form @ v) @ v)

    def push(self, known: Known) -> Array:
        """Bound on the push on each state beyond the second order; infinite beyond the caps."""
        at, sector, B = self.sector.signals, self.sector, known.whole
        angles = B[at.error][sector.motion.places]
        within = np.flatnonzero((angles <= self.caps).all(axis=1))
        if not len(within):
            return np.full(at.z.stop, np.inf)
        left = self.lefts[within[0]]
        force, v, turned = B[at.force], B[at.rate], self._turned(B) + sector.rounded @ B[at.z]
        both = np.outer(angles, angles)
        bend = np.tensordot(both, left.W_bend, 2) @ force + np.tensordot(both, left.P_bend, 2) @ v
        bend = (
            bend
            + (np.tensordot(angles, self.W, 1) + np.tensordot(both, left.W_bend, 2) + self.inverse) @ turned
        )
        second = self._second(B, B)
        J, Ji = (np.tensordot(angles, m, 1) + self.unit for m in (left.J, left.J_inverse))
        nu = Ji @ v
        signed = self.D_signs @ nu + self._form(self.Q_signs, nu)
        body = Ji @ (B[at.acceleration] + bend + second) + self._form(self.Q, nu) + signed
        bend = bend + self._form(np.tensordot(angles, left.Gamma_slope, 1), v)
        new = self._second(known.rest, B) + self._second(known.first, known.rest) + self._rounded(B)
        found = sector.off @ B[at.z] + known.missed
        found[at.rate] += new + bend + J @ (signed + sector.motion.inertia_off @ body)
        return np.asarray(found * (1 + SETTINGS.room))

    def _rounded(self, B: Array) -> float:
        """What rounding of the form of second order comes to, any entry of which may be off."""
        at = self.sector.signals
        angles, force, v = (float(B[part].sum()) for part in (at.error, at.force, at.rate))
        W, P, Gamma = (float(m.max(initial=0.0)) for m in (self.W, self.P, self.Gamma))
        return PROOFS.rounding * len(self.unit) * (angles * (W * force + P * v) + Gamma * v**2)

    def _second(self, one: Array, other: Array) -> Array:
        """Bound on the form of second order, of bounds on two sets of signals."""
        at, places = self.sector.signals, self.sector.motion.places
        found = self.Gamma @ one[at.rate] @ other[at.rate]
        for a, b in ((one, other), (other, one)):
            pulled = self.W @ b[at.force] + self.P @ b[at.rate]
            found = found + 0.5 * a[at.error][places] @ pulled
        return np.asarray(found)

    def _turned(self, B: Array) -> Array:
        """What the force differs by at the other headings of the sector."""
        at, half = self.sector.signals, self.sector.half
        found = np.zeros(self.sector.motion.n)
        if half:
            found[self.sector.motion.plane] = half * B[at.slope] + 2 * half**2 * B[at.turning]
        return found

    def speeds(self, B: Array) -> Array:
        """Bound on the body velocities."""
        angles = B[..., self.sector.signals.error][..., self.sector.motion.places]
        Ji = self.unit + np.tensordot(angles, self.lefts[-1].J_inverse, 1)
        return np.asarray(np.einsum("...ij,...j->...i", Ji, B[..., self.sector.signals.rate]))

    def commands(self, B: Array) -> Array:
        """Bound on each limited command, shape (pieces, commands)."""
        at, motion = self.sector.signals, self.sector.motion
        angles = B[..., at.error][..., motion.places]
        turned = np.abs(motion.commands.share) @ np.swapaxes(
            np.tensordot(angles, self.lefts[-1].J, 1), -1, -2
        )
        whole = turned + PROOFS.room * np.abs(motion.commands.share)
        extra = np.zeros((*B.shape[:-1], motion.n))
        if self.sector.half:
            half = self.sector.half
            extra[..., motion.plane] = half * B[..., at.slope] + 2 * half**2 * B[..., at.turning]
        force = B[..., at.force] + B[..., at.z] @ self.sector.rounded.T
        body = np.einsum("...mj,...j->...m", whole, force)
        body += np.einsum("...mj,...j->...m", turned + np.abs(motion.commands.share), extra)
        return np.asarray(B[..., at.commands] + body + motion.commands.steady() + self._held(B))

    def _held(self, B: Array) -> Array:
        """What holding the weight differs by from its tangent."""
        motion, errors = self.sector.motion, B[..., self.sector.signals.error]
        own = {a: errors[:, motion.names.index(a)] for a in ("phi", "theta") if a in motion.names}
        if not own or not len(motion.commands.limits):
            return np.zeros((len(B), len(motion.commands.limits)))
        slopes = motion.commands.holding_slopes({a: Interval(-e, e) for a, e in own.items()})
        off = (slopes - motion.commands.holding_slopes({}).middle).size
        angles = np.stack([own.get(a, np.zeros(len(B))) for a in ("phi", "theta")], axis=-1)
        return np.asarray(np.einsum("kma,ka->km", off, angles) * (1 + SETTINGS.room))


class Tube:
    """Bounds on the signals of one sector, piece by piece of time."""

    def __init__(self, sector: Sector, bounds: Bounds) -> None:
        self.sector, self.bounds, self.kernels = sector, bounds, sector.kernels
        self.slowest = sector.modes.rates.real.min()
        second, dies = sector.second(bounds.lefts[0]), np.exp(-self.slowest * sector.times)[:, None]
        begun = second.signals + dies * (sector.envelope @ second.begun)
        self.known = [Known(*p) for p in zip(sector.begun, begun, dies * second.missed, strict=True)]
        size = sector.signals.z.stop
        self.steps = np.zeros((len(sector.times) - 1, size))  # of the pushes from piece to piece
        self.lag = np.zeros(size)  # pushes so far, dying with the slowest mode
        self.last = np.zeros(size)  # push in the last piece

    def found(self) -> Array | None:
        """Bounds on the signals by piece, shape (pieces, signals); None where they grow beyond the caps."""
        found, times = [], self.sector.times
        for i, known in enumerate(self.known[:-1]):
            width = times[i + 1] - times[i]
            B = self._held(known, *self._so_far(i), self.sector.crude * self._filled(width))
            if B is None:
                return None
            found.append(B[0])
            self.steps[i], self.last = B[1] - self.last, B[1]
            self.lag = np.exp(-self.slowest * width) * self.lag + self._filled(width) * self.last
        # What was pushed so far dies out, and so does what is pushed from then on.
        rest = self.sector.envelope @ self.lag
        gain = np.zeros_like(self.sector.crude)
        gain[self.kernels.signals, self.kernels.states] = self.kernels.weighted
        crude = self.sector.crude / ((1 - KERNELS.dies) * self.slowest)
        B = self._held(self.known[-1], rest, gain, 0 * self.last, crude)
        return None if B is None else np.array([*found, B[0]])

    def _filled(self, width: float) -> float:
        return float(-np.expm1(-self.slowest * width) / self.slowest)

    def _so_far(self, i: int) -> tuple[Array, Array, Array]:
        """What the pushes before piece i do in it by kernels, what more in it adds, and the last push.

        The integral of |H(t - s)| times a push that is constant by piece is a sum over its steps at the
        beginnings of pieces, times integrals of |H| since then.
        """
        times, kernels = self.sector.times, self.kernels
        steps = self.steps[:i, kernels.states].T
        later, sooner = (kernels.up_to(times[i + k] - times[: i + k]) for k in (1, 0))
        own = np.einsum("pi,pi->p", later[:, :i], np.maximum(steps, 0.0))
        own -= np.einsum("pi,pi->p", sooner, np.maximum(-steps, 0.0))
        rounding = len(kernels.times) * np.finfo(float).eps  # of integrals, which are sums over the pieces
        own += rounding * kernels.integral[:, -1] * np.abs(steps).sum(axis=1)
        rest = self.sector.crude @ self.lag
        np.add.at(rest, kernels.signals, np.maximum(own, 0.0))
        gain = np.zeros_like(self.sector.crude)
        gain[kernels.signals, kernels.states] = later[:, i]
        return rest * (1 + SETTINGS.room), gain, self.last

    def _held(
        self, known: Known, rest: Array, gain: Array, since: Array, crude: Array
    ) -> tuple[Array, Array] | None:
        """Bounds on signals and pushes that what they let happen does not leave."""
        most, first = self.last.copy(), known.rest + rest
        for _ in range(SETTINGS.rounds):
            more = (gain @ np.maximum(most - since, 0.0) + crude @ most) * (1 + SETTINGS.room)
            one = known._replace(rest=first + more)
            push = self.bounds.push(one)
            if not np.isfinite(push).all():
                return None
            if (push <= most).all():
                return one.whole, push
            most = np.maximum(most, SETTINGS.more * push)
        return None


def bounds_in_time(problem: Problem, start: Mapping[str, float]) -> Transient | None:
    """Bounds on every motion from rest in a box of errors, at any heading of the set-point; None if none.

    Raises
    ------
    UndertowError
        If the model has no form that the method covers, or a thruster is not proved to suffice.
    """
    if problem.gains.schedule.order == "yaw-first":
        return None  # its gate opens in motion, and bounds are for motions from rest
    motion = Motion(problem)
    box = np.array([start.get(c, 0.0) for c in problem.coordinates])
    caps, lefts = _leftovers(motion, box)
    counts = problem.heading_counts
    looked_at = (np.arange(SETTINGS.looks if counts else 0) + 0.5) * np.pi / SETTINGS.looks
    if any(_in_sector(motion, box, float(h), 0.0, caps, lefts) is None for h in looked_at):
        return None
    whole = (0.0, 0.5 * np.pi, 0) if counts else (0.0, 0.0, SETTINGS.cuts)
    pending, found, fine = [whole], [], SETTINGS.coarse
    while pending:
        heading, half, cuts = pending.pop()
        if cuts >= fine or not half:  # not finer than what has been enough, nor coarser
            one = _in_sector(motion, box, heading, half * (1 + PROOFS.room), caps, lefts)
            if one is not None:
                found.append(one)
                continue
            if cuts == SETTINGS.cuts:
                return None
            fine = cuts + 1
        pending += [(heading + side * half / 2, half / 2, cuts + 1) for side in (-1, 1)]
    return _together(found)


def _leftovers(motion: Motion, box: Array) -> tuple[Array, list[Leftover]]:
    """Caps on the angles from small to large, with what is left over up to each."""
    most = [SETTINGS.largest_heading if a == "psi" else motion.problem.attitudes.tilt for a in motion.angles]
    own = box[motion.places]
    own = np.maximum(own, max(SETTINGS.least_share * own.max(initial=0.0), SETTINGS.least_angle))
    caps = np.array([np.minimum(c * own, most) for c in SETTINGS.caps]).reshape(len(SETTINGS.caps), -1)
    return caps, [motion.leftover(c) for c in caps]


def _in_sector(
    motion: Motion, box: Array, heading: float, half: float, caps: Array, lefts: Sequence[Leftover]
) -> Transient | None:
    sector = Sector(motion, box, heading, half)
    bounds = Bounds(sector, caps, lefts)
    B = Tube(sector, bounds).found()
    return None if B is None else _stated(sector, bounds, B)


def _stated(sector: Sector, bounds: Bounds, B: Array) -> Transient:
    """Bounds on the signals as a statement, in the coordinates of the earth."""
    motion, commands = sector.motion, sector.motion.commands
    errors = B[:, sector.signals.error].copy()
    if motion.plane:
        errors[:, motion.plane] = np.hypot(*errors[:, motion.plane].T)[:, None]
    largest = bounds.commands(B)
    for name, own, limit in zip(commands.names, largest.T, commands.limits, strict=True):
        if own.max() >= limit:
            word = "the start asks" if own[0] >= limit else "bounds in time let the law ask"
            raise UndertowError(
                f"{word} {own.max():.4g} of {name}, whose limit is {limit:.4g}: state smaller errors or "
                "lower K_P"
            )
    rate = KERNELS.dies * sector.modes.rates.real.min()
    return Transient(sector.times, errors, bounds.speeds(B), largest, float(rate))


def _together(found: Sequence[Transient]) -> Transient:
    """One statement for the headings of several, on the pieces of time of the first."""
    first = found[0]
    ends = np.append(first.times[1:], np.inf)
    pieces = [[f.between(a, b) for f in found] for a, b in zip(first.times, ends, strict=True)]

    def largest(name: str) -> Array:
        return np.array([np.max([getattr(p, name) for p in parts], axis=0) for parts in pieces])

    rate = min(f.rate for f in found)
    return Transient(first.times, largest("errors"), largest("speeds"), largest("commands"), rate)
