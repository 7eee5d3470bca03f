"""What a program for a quadratic V found, proved without trusting the solver."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cached_property

import numpy as np

from undertow.typing import Array, Flags

from .attitude import Interval, count_of, enclose, within
from .definite import SETTINGS as PROOFS
from .definite import Work, bounded, sums_positive
from .embedding import Boxes, certainly_positive, corners_of, halved
from .program import SETTINGS, Program, Proposal
from .result import Quadratic


def proved(program: Program, found: Proposal, work: Work) -> Quadratic | None:
    """V with everything that was asked of it proved in interval arithmetic, or None.

    What the start needs of the level set is proved first, with the work that is left for it. Where that
    succeeds, the whole of it is tried, with not much more.
    """
    narrow = Proof(*program.narrowed(found), work.left)
    needed = narrow.result()
    if needed is None:
        work.left -= narrow.used
        return None
    return Proof(program, found, SETTINGS.whole * narrow.used).result() or needed


class Proof:
    """The proof of one proposal, on the box of speeds and tilts of its program."""

    def __init__(self, program: Program, proposal: Proposal, most: int) -> None:
        self.program, self.loop, self.proposal = program, program.loop, proposal
        self.P = 0.5 * (proposal.P + proposal.P.T)
        # Forms that vanish exactly are within this.
        around = PROOFS.sum * np.abs(proposal.free)
        self.free = Interval(proposal.free - around, proposal.free + around)
        self.scale, self.corners = program.scale, program.corners
        self._most, self._work = most, Work(most)

    @property
    def used(self) -> int:
        """How many matrices the last part of the proof looked at, or would have."""
        return self._most - self._work.left

    def result(self) -> Quadratic | None:
        """The V, or None where something of it is not proved."""
        if not (certainly_positive(enclose(self.P[None])) and self._fixed_proved()):
            return None
        weights, start = self._start_weights()
        if not start < 1 or not (self._halving(self._within_bounds) and self._halving(self._falls)):
            return None
        return self._stated(weights, start)

    def _fixed_proved(self) -> bool:
        return all(
            bounded(self.P, enclose(row[None, None]), np.array([b])).all()
            for row, b in self.program.fixed_rows()
        )

    def _start_weights(self) -> tuple[Array, float]:
        """S diagonal with S > P_EE, proved, and a bound on E' S E on the start box, infinite if not."""
        n, size = self.loop.n, self.loop.size
        errors = slice(size - 2 * n, size - n)
        own, first = self.P[errors, errors], [group[0] for group in self.loop.groups]
        squares = (self.program.search.start / self.scale[errors])[first] ** 2
        found = [(weights, float(weights[first] @ squares * (1 + 1e-9))) for weights in self._weights(own)]
        held = [(w, t) for w, t in found if certainly_positive(enclose((np.diag(w) - own)[None]))]
        return min(held, key=lambda pair: pair[1], default=(np.zeros(n), np.inf))

    def _weights(self, own: Array) -> Iterator[Array]:
        """Diagonals above a matrix: sums of its rows, and what the program came to, raised to be."""
        sums, stated = np.abs(own).sum(axis=1), np.zeros(len(own))
        for group, level in zip(self.loop.groups, self.proposal.levels, strict=True):
            sums[group], stated[group] = sums[group].max(), level
        yield sums * (1 + PROOFS.level)
        if (stated > 0).all():
            root = np.sqrt(stated)
            yield stated * np.linalg.eigvalsh(own / np.outer(root, root))[-1] * (1 + PROOFS.level)

    def _halving(self, holds: Callable[[Boxes], Flags]) -> bool:
        boxes = self.loop.boxes(self.program.ranges)
        self._work = Work(self._most)
        for _ in range(SETTINGS.halvings * max(len(boxes), 1)):
            open_ = ~holds(boxes)
            if not open_.any():
                return True
            if not boxes or self._work.left < 0:
                return False
            boxes = halved({a: v[open_] for a, v in boxes.items()})
            if open_.all():
                boxes = halved(boxes)
        return False

    def _within_bounds(self, boxes: Boxes) -> Flags:
        """Speeds and commands, at every attitude in each box."""
        self._work.left -= count_of(boxes)
        held = bounded(self.P, self._by(self.loop.speeds_of(boxes)), self.program.bounds.speeds)
        if len(self._moves):
            commands = self.loop.commands_of(self.program.commands, boxes)
            held &= bounded(self.P, self._by(commands), self._moves)
        return held

    @cached_property
    def _moves(self) -> Array:
        """What is claimed of each command beside that at rest."""
        moves = self.program.moves(self.proposal) * (1 + SETTINGS.stated)
        return np.asarray(np.minimum(moves, self.program.left))

    def _falls(self, boxes: Boxes) -> Flags:
        """Whether V falls at every corner of velocities at every attitude in each box.

        A(angles) differs from what its values at the corners of the box interpolate by h^2/8 times the second
        derivative along each side h at most.
        """
        batches = -(-count_of(boxes) * self.corners.cases // SETTINGS.batch)
        parts = np.array_split(np.arange(count_of(boxes)), min(count_of(boxes), batches))
        some = [{a: v[p] for a, v in boxes.items()} for p in parts]
        return np.concatenate(
            [self._falls_in(each) if self._work.left >= 0 else _none(each) for each in some]
        )

    def _falls_in(self, boxes: Boxes) -> Flags:
        at, place = corners_of(boxes)
        falls = -_doubled(self.P @ self.program.scaled(self.loop.rest(self.corners, at)))
        size = self.loop.size
        rows = (falls[place] + self._missed(boxes)).reshape(-1, size, size)
        # Attitudes and cases in one row.
        ends = [e.reshape(-1, *e.lo.shape[2:]) for e in self._ends(at)]
        own = place[..., None] * self.corners.cases + np.arange(self.corners.cases)
        box = np.broadcast_to(np.arange(count_of(boxes))[:, None], own.shape).ravel()
        # Ends are the same at all attitudes, or not.
        return sums_positive(rows, own.ravel() % len(ends[0]), ends, box, self._work)

    def _missed(self, boxes: Boxes) -> Interval:
        """What interpolating between the corners of boxes misses, shape (boxes, 1, size, size)."""
        own = np.zeros((count_of(boxes), self.loop.size, self.loop.size))
        free = own.copy()
        for angle, side in boxes.items():
            share = 1.001 * (side.hi - side.lo)[:, None, None] ** 2 / 8
            own += share * self.loop.bend(self.corners, boxes, angle) * self.scale / self.scale[:, None]
            turn = self.loop.body_jet(boxes, angle) * self._turn_ratio
            for N, value in zip(self._free_of, self.program.values, strict=True):
                free += share * np.abs(value).max() * (turn @ N @ turn.T).bend.size[:, 0]
        return (_doubled(self.P @ within(own)) + within(free))[:, None]

    def _ends(self, at: Boxes) -> Iterator[Interval]:
        """What the ends of each velocity add to the fall of V, (attitudes, cases, ends, size, size)."""
        turn = self.loop.body(at) * self._turn_ratio
        added = self.loop.added(self.corners, at)
        for end, N, value in zip(added, self._free_of, self.program.values, strict=True):
            turned = turn @ N @ turn.T
            every = turned[:, :, None] * value[..., None, None]
            yield -(_doubled(self.P @ self.program.scaled(end)) + every)

    @property
    def _free_of(self) -> list[Interval]:
        """The forms that vanish, by velocity."""
        return [self.free[i] for i in range(len(self.free))]

    @property
    def _turn_ratio(self) -> Array:
        return np.asarray(self.scale[:, None] / self.scale)

    def _by(self, rows: Interval) -> Interval:
        return Interval(rows.lo * self.scale, rows.hi * self.scale)

    def _stated(self, weights: Array, start: float) -> Quadratic:
        """The proof's result in the units of the states."""
        program, n, size = self.program, self.loop.n, self.loop.size
        inverse = 1 / self.scale
        own = weights * inverse[size - 2 * n : size - n] ** 2
        return Quadratic(
            P=(self.P * np.outer(inverse, inverse))[None],
            frame=self.loop.frame_name,
            errors=program.reach(self.proposal),
            speeds=program.bounds.speeds,
            starts=1 / np.sqrt(own),
            commands=program.commands.limits - program.left + self._moves,
            start=start,
        )


def _none(boxes: Boxes) -> Flags:
    return np.zeros(count_of(boxes), dtype=bool)


def _doubled(held: Interval) -> Interval:
    return held + held.T
