"""A quadratic V for PD and PID loops, found by a semidefinite program and proved without trusting it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array, Flags

from .attitude import Interval, enclose
from .commands import Commands
from .definite import SETTINGS as PROOFS
from .definite import (
    Work,
    along,
    bounded,
    doubled,
    flat,
    rows_of,
    sums_positive,
    touched,
)
from .embedding import Boxes, Corners, Embedding, certainly_positive, corners_of, count_of, halved, point
from .problem import Problem
from .result import Quadratic, together
from .semidefinite import Form, solved


@dataclass(frozen=True)
class QuadraticSettings:
    """How a quadratic V is searched for."""

    # V has to fall at this part of the slowest rate of the loop at rest: room for rounding and for attitudes
    # between those of the program.
    decay: float = 0.3
    # Room in every bound of the program, relative: what the solver leaves and what boxes of angles add.
    slack: float = 0.05
    # Where A depends on the heading: a P for each of so many ranges of set-points in half a turn.
    sectors: int = 6
    # Boxes of angles are halved so often until the proof succeeds or is given up.
    halvings: int = 6
    most: int = 400_000  # matrices that one proof may look at: seconds
    batch: int = 256  # boxes of attitudes and signs at a time: memory
    looked_at: int = 512  # attitudes and signs whose worst corner a round of the program looks for
    starts: int = 3  # eigenvectors from which that corner is looked for, and
    steps: int = 4  # turns between the corner and its eigenvector
    most_forms: int = 2000  # matrix inequalities that the solver is given in one search: seconds
    rounds: int = 12  # of the program, each with the worst corners of the last one added
    added: int = 8  # how many
    idle: float = 1e-3  # corners with a dual below this part of the largest one are left out again
    rise: float = 0.02  # of the start's level from a round to the next, below which the level is known
    tries: int = 40  # boxes of speeds that are tried
    first_step: float = 0.7  # of a speed, as a logarithm; half as much again while it helps, else half
    first_speed: float = 2.0  # factor on the speeds that an undamped or an overdamped axis would reach
    smaller: float = 0.6  # factor on speeds for which there is no V
    # Factors on speeds that a V asks for which does not hold the start: a little more, and at most so much.
    more: float = 1.15
    most_more: float = 8.0
    least_fall: float = 0.003  # of the logarithm of the start's level that a step has to promise
    least_step: float = 0.03  # change of speeds, relative, below which no better ones are looked for
    # Least part of the largest start error that counts for coordinates with none, so that they may be moved.
    least_share: float = 0.1
    tilt: float = 2.0  # roll and pitch that are allowed for, times those of the start
    # Degrees of freedom up to which P is a full matrix. Beyond, it has a block for each axis, as gains have:
    # the program takes seconds then instead of minutes.
    most_full: int = 4


SETTINGS = QuadraticSettings()


Key = tuple[int, int, tuple[int, ...]]
"""A corner: its attitude, its case of the signs, and the end of each velocity."""


class Proposal(NamedTuple):
    """What the program came to in scaled states."""

    P: Array
    start: float  # V of the worst corner of the start box; the level is one
    slopes: Array  # derivative of `start` by the logarithm of each speed of the box
    active: set[Key]  # corners that keep it from being lower


class Row(NamedTuple):
    """A sum of states that has to stay below its bound."""

    states: Array
    bound: float
    velocity: int | None = None  # which one, if it is one


class _Slopes:
    """Tangents of the logarithm of the start's level over the logarithms of speeds.

    Their maximum stands in for the level, which has kinks where other corners become the worst (Kelley 1960,
    The cutting-plane method for solving convex programs). Where it is not convex, steps are only worse.
    """

    def __init__(self) -> None:
        self._rows: list[Array] = []  # slope and value at the origin

    def add(self, place: Array, found: Proposal) -> None:
        """Take what a program came to at some speeds; one that was left early bounds the level, too."""
        slope = found.slopes / found.start
        self._rows.append(np.append(slope, np.log(found.start) - slope @ place))

    def step(self, place: Array, radius: float) -> tuple[Array, float]:
        """The change of each logarithm, up to the radius, that brings the maximum down most, and to what."""
        from scipy.optimize import linprog

        rows, n = np.array(self._rows), len(place)
        left = np.column_stack([rows[:, :n], -np.ones(len(rows))])
        cost, limits = np.append(np.zeros(n), 1.0), [(-radius, radius)] * n + [(None, None)]
        found = linprog(cost, left, -(rows[:, n] + rows[:, :n] @ place), bounds=limits)
        if not found.success:
            return -radius * np.sign(rows[-1, :n]), -np.inf
        return np.asarray(found.x[:n]), float(found.x[n])


class Bounds(NamedTuple):
    """A box that the level set V < 1 has to stay in."""

    speeds: Array  # body velocities, shape (n,)
    tilts: dict[str, float]  # roll and pitch, and the error of the heading where A depends on it, rad


def search(problem: Problem, start: Mapping[str, float]) -> Quadratic | None:
    """A proved V whose level set holds every error up to `start` at rest, integrals at zero; None if none.

    Raises
    ------
    UndertowError
        If the solver is not installed, or the model has no form that the method covers.
    """
    return Search(problem, start).found()


class Search:
    """The search for one start box."""

    def __init__(self, problem: Problem, start: Mapping[str, float]) -> None:
        self.problem, self.loop = problem, Embedding(problem)
        self.commands = Commands(problem)
        self.forms = 0  # what the solver was given so far
        self.chosen: set[Key] = set()  # corners that the programs so far were about
        self.centre = 0.0  # heading in the middle of those of the set-point, rad
        self.start = self._mixed(np.array([start.get(c, 0.0) for c in problem.coordinates]))

    def _mixed(self, start: Array) -> Array:
        """The box with the radius of its corners in coordinates that the frame mixes."""
        found = start.copy()
        for group in self.loop.groups:
            found[group] = np.sqrt(np.sum(start[group] ** 2)) * (1 + 1e-12)
        return found

    # --- boxes of speeds --------------------------------------------------------------------------
    def found(self) -> Quadratic | None:
        """The first V that is proved and holds the start, for every range of headings of the set-point."""
        self._require_thrust()
        bounds, proofs = self._first(), []
        for centre in self.centres:
            self.centre, self.forms = centre, 0
            self.chosen.clear()
            proof = self._in_sector(bounds)
            if proof is None:
                return None
            bounds, one = proof
            proofs.append(one)
        return together(proofs, self.loop.half_turn)

    @property
    def centres(self) -> Array:
        """The middle of each range of set-points' headings; the second half of a turn is as the first."""
        if "psi" not in self.loop.angles:
            return np.zeros(1)
        return (np.arange(SETTINGS.sectors) + 0.5) * np.pi / SETTINGS.sectors

    def _in_sector(self, bounds: Bounds) -> tuple[Bounds, Quadratic] | None:
        """V is searched for on smaller speeds until there is one, then on those that its start asks for."""
        best: tuple[Bounds, Program, Proposal] | None = None
        slopes, radius = _Slopes(), SETTINGS.first_step
        for _ in range(SETTINGS.tries):
            program = Program(self, bounds)
            if program.rate <= 0:
                raise UndertowError("the loop at rest is not stable at every attitude")
            proposal = program.solve(np.inf if best is None else best[2].start)
            if proposal is not None and proposal.start < 1:
                proof = program.proof(proposal)
                if proof is not None:
                    return bounds, proof
            if best is None and (proposal is None or proposal.start < 1):
                bounds = self._smaller(bounds)
                continue
            better = proposal is not None and (best is None or proposal.start < best[2].start)
            radius *= 1.0 if best is None else 1.5 if better else 0.5
            if proposal is not None:
                slopes.add(np.log(bounds.speeds), proposal)
                best = (bounds, program, proposal) if better else best
            if best is None or radius < SETTINGS.least_step:
                return None
            radius = min(radius, np.log(SETTINGS.most_more))
            step, level = slopes.step(np.log(best[0].speeds), radius)
            if level > np.log(best[2].start) - SETTINGS.least_fall:
                return None
            bounds = self._moved(*best, step)
        return None

    def _smaller(self, bounds: Bounds) -> Bounds:
        least = self._tilted(self._filled(self.start) * (1 + SETTINGS.slack))
        tilts = {a: max(SETTINGS.smaller * t, self._tilt(a, least[a])) for a, t in bounds.tilts.items()}
        return Bounds(SETTINGS.smaller * bounds.speeds, tilts)

    def _moved(self, bounds: Bounds, program: Program, proposal: Proposal, step: Array) -> Bounds:
        """Speeds changed by these logarithms, and tilts that the start asks for."""
        reach = program.reach(proposal) * np.sqrt(proposal.start) * SETTINGS.more
        tilts = {a: self._tilt(a, v) for a, v in self._tilted(reach).items()}
        return Bounds(bounds.speeds * np.exp(step), tilts)

    def _require_thrust(self) -> None:
        """Refuse a start at which the law asks for more than a thruster has, on an even keel."""
        if not len(self.commands.limits):
            return
        tilts = {a: self._tilt(a, e) for a, e in self._tilted(self._filled(self.start)).items()}
        _left(self.problem, self.commands, tilts)  # refuses where nothing is
        level = {a: point(np.zeros(1)) for a in self.loop.angles}
        springs = np.abs(self.commands.share) @ (self.problem.values["K_P"] * self.start)
        rows = self.loop.commands_of(self.commands, level).middle[0]
        own = rows[:, self.loop.size - 2 * self.loop.n : self.loop.size - self.loop.n]
        asked = np.minimum(np.max(np.abs(own) * self.start, axis=1), springs) + self.commands.steady()
        worst = int(np.argmax(asked / self.commands.limits))
        if asked[worst] >= self.commands.limits[worst]:
            raise UndertowError(
                f"the start asks {asked[worst]:.4g} of {self.commands.names[worst]}, whose limit is "
                f"{self.commands.limits[worst]:.4g}: state smaller errors or lower K_P"
            )

    def _first(self) -> Bounds:
        K_P, K_V = (self.problem.values[g] for g in ("K_P", "K_V"))
        M = np.min([np.diag(one.inertia) for one in self.problem.sets], axis=0)
        D = np.min([np.diag(one.damping) for one in self.problem.sets], axis=0)
        rate = np.minimum(np.sqrt(K_P / M), K_P / np.maximum(K_V + D, 1e-12))
        speeds = SETTINGS.first_speed * self._filled(rate * self.start)
        for group in self.loop.groups:
            speeds[group] = speeds[group].max()
        angles = self._tilted(self._filled(self.start))
        tilts = {a: self._tilt(a, SETTINGS.tilt * e) for a, e in angles.items()}
        return Bounds(speeds, tilts)

    def _tilted(self, values: Array) -> dict[str, float]:
        pairs = zip(self.problem.coordinates, values, strict=True)
        bounded = {"phi", "theta"} | ({"psi"} & set(self.loop.angles))
        return {c: float(v) for c, v in pairs if c in bounded}

    def _tilt(self, name: str, angle: float) -> float:
        return min(angle, np.pi / 2 if name == "psi" else self.problem.attitudes.tilt)

    def _filled(self, values: Array) -> Array:
        """At least a share of the largest among translations, and among rotations."""
        found = values.copy()
        for kind in (self.loop.shifts, self.loop.turns):
            if kind:
                found[kind] = np.maximum(found[kind], SETTINGS.least_share * found[kind].max())
        if not found.any():
            raise UndertowError("the start box has no error at all: state one, as x=0.5 m")
        return np.maximum(found, 1e-3 * found.max())


def _left(problem: Problem, commands: Commands, tilts: Mapping[str, float]) -> Array:
    """What the limits leave beside the weight, within the tilts."""
    left = commands.limits - commands.at_rest(problem.attitudes.boxes(dict(tilts)))
    if len(left) and left.min() <= 0:
        raise UndertowError("holding the weight at the roll and pitch of the start takes all of a thruster")
    return np.asarray(left)


class Program:
    """The semidefinite program of one box of speeds and tilts, and the proof of what it finds."""

    def __init__(self, search: Search, bounds: Bounds) -> None:
        self.search, self.bounds, self.loop = search, bounds, search.loop
        self.corners: Corners = self.loop.corners(bounds.speeds)
        self.samples = self._samples()
        self._work = Work(SETTINGS.most)
        self._scale = self._scaling()

    @property
    def _ranges(self) -> dict[str, tuple[float, float]]:
        """Roll and pitch, and headings near those of the set-point."""
        found = {a: (-t, t) for a, t in self.bounds.tilts.items()}
        if "psi" in found:
            half = self.bounds.tilts["psi"] + 0.5 * np.pi / SETTINGS.sectors * (1 + PROOFS.room)
            found["psi"] = (self.search.centre - half, self.search.centre + half)
        return found

    def _samples(self) -> Boxes:
        """Attitudes in the program: the middle and the ends of each angle."""
        ends = [np.linspace(*self._ranges[a], 3) for a in self.loop.angles]
        rows = np.array(list(product(*ends)))
        return {a: point(rows[:, i]) for i, a in enumerate(self.loop.angles)}

    def _scaling(self) -> Array:
        """Sizes of the states: errors of the start, speeds of the box, integrals by what they hold."""
        s, n = self.search, self.loop.n
        error = s._filled(s.start)
        speed = self.bounds.speeds.copy()
        for group in self.loop.groups:
            speed[group] = speed[group].max()
        parts = [error, speed]
        if self.loop.integral:
            K_P, K_I = (s.problem.values[g] for g in ("K_P", "K_I"))
            parts.insert(0, error * np.maximum(K_P, 1e-12) / np.maximum(K_I, 1e-9 * np.maximum(K_P, 1e-12)))
        # Powers of two scale without rounding.
        return np.asarray(2.0 ** np.round(np.log2(np.concatenate(parts)))).reshape(-1)[: self.loop.size + n]

    def _scaled(self, A: Interval) -> Interval:
        ratio = self._scale[None, :] / self._scale[:, None]
        return Interval(A.lo * ratio, A.hi * ratio)

    # --- the program ----------------------------------------------------------------------------
    @property
    def _apart(self) -> bool:
        """Whether P has a block for each axis, so that V is the same with the signs of an axis turned round."""
        return self.search.problem.decoupled or self.loop.n > SETTINGS.most_full

    @cached_property
    def basis(self) -> Array:
        """Symmetric matrices that P is a sum of: blocks of the axes if many or uncoupled, (k, size, size)."""
        n, size = self.loop.n, self.loop.size
        pairs = [(i, j) for i in range(size) for j in range(i, size) if not self._apart or i % n == j % n]
        found = np.zeros((len(pairs), size, size))
        for k, (i, j) in enumerate(pairs):
            found[k, i, j] = found[k, j, i] = 1.0
        return found

    @cached_property
    def _pieces(self) -> tuple[Array, list[Array]]:
        """A at rest (samples, cases, size, size) and what each velocity adds (samples, cases, ends, ...)."""
        rest = self._scaled(self.loop.rest(self.corners, self.samples)).middle
        ends = [self._scaled(e).middle for e in self.loop.added(self.corners, self.samples)]
        return rest, [np.broadcast_to(e, (len(rest), *e.shape[1:])) for e in ends]

    def _corner(self, key: Key) -> Array:
        rest, ends = self._pieces
        sample, case, places = key
        return np.asarray(
            rest[sample, case] + sum(e[sample, case, p] for e, p in zip(ends, places, strict=True))
        )

    @cached_property
    def rate(self) -> float:
        """The decay that is asked for, 1/s."""
        slowest = -float(np.max(np.linalg.eigvals(self._pieces[0]).real))
        return SETTINGS.decay * slowest

    def solve(self, best: float = np.inf) -> Proposal | None:
        """P by cutting planes: corners come in as they are violated, and go where they do not matter.

        Corners only raise the start's level, so that a program that comes above `best` has said enough, and
        one above one, too, once the corners that matter are among them.
        """
        known = bool(self.search.chosen)  # by the programs of other speeds
        chosen, last = self.search.chosen or self._first_corners(), 0.0
        for turn in range(SETTINGS.rounds):
            proposal = self._solved(sorted(chosen))
            if proposal is None or proposal.start >= best:
                return proposal
            worst = set(self._violated(proposal.P, turn))
            rises = proposal.start > last * (1 + SETTINGS.rise)
            active = proposal.active if rises else chosen
            self.search.chosen = active | worst
            if worst <= chosen or (proposal.start > 1 and (known or not rises)):
                return proposal
            chosen, last = self.search.chosen, proposal.start
        return None

    def _first_corners(self) -> set[Key]:
        """Corners here and there."""
        rest, ends = self._pieces
        rng = np.random.default_rng(0)
        return {
            (int(i), int(rng.integers(rest.shape[1])), tuple(int(rng.integers(e.shape[2])) for e in ends))
            for i in np.linspace(0, len(rest) - 1, SETTINGS.added)
        }

    def _violated(self, P: Array, turn: int) -> list[Key]:
        """The corners at which V falls too slowly, worst first, some of them.

        x' (P A + A' P) x is a sum over the velocities, so the worst corner for a direction x is known, and
        the worst direction of a corner is an eigenvector: they are taken in turns.
        """
        rest, ends = self._pieces
        places = np.stack(np.unravel_index(np.arange(rest.shape[0] * rest.shape[1]), rest.shape[:2]), 1)
        if len(places) > SETTINGS.looked_at:
            places = np.random.default_rng(turn).permutation(places)[: SETTINGS.looked_at]
        own = rest[places[:, 0], places[:, 1]] + self.rate * np.eye(self.loop.size)
        added = [e[places[:, 0], places[:, 1]] for e in ends]
        _, vectors = np.linalg.eigh(doubled(P, own))
        limit = 0.5 * self.rate * float(np.linalg.eigvalsh(P)[0])  # half of the decay is the proof's
        found: dict[Key, float] = {}
        for k in range(1, SETTINGS.starts + 1):
            x = vectors[..., -k]
            for _ in range(SETTINGS.steps):
                worst = [np.argmax(along(P, e, x), axis=-1) for e in added]
                rows = np.arange(len(own))
                whole = own + sum(e[rows, w] for e, w in zip(added, worst, strict=True))
                values, turned = np.linalg.eigh(doubled(P, whole))
                x = turned[..., -1]
            for (i, case), ways, value in zip(places, np.array(worst).T, values[:, -1], strict=True):
                if value > limit:
                    found[(int(i), int(case), tuple(map(int, ways)))] = float(value)
        return sorted(found, key=lambda key: -found[key])[: SETTINGS.added]

    @cached_property
    def _balance(self) -> tuple[Array, Array]:
        """Columns T with T' P_0 T = I, and C with C' (P_0 A + A' P_0) C = -I, of the loop at rest.

        Rates of one loop are far apart; in these states the program is well conditioned, and P is near I.
        """
        from scipy.linalg import solve_continuous_lyapunov, sqrtm

        together = np.abs(self.basis).sum(axis=0) > 0
        A = self._pieces[0].mean(axis=(0, 1)) * together
        unit = np.eye(len(A))
        W = np.real(sqrtm(A.T @ A))
        try:
            P = solve_continuous_lyapunov(A.T, -W)
            T, C = (np.linalg.inv(np.linalg.cholesky(0.5 * (m + m.T))).T * together for m in (P, W))
            return T, C
        except np.linalg.LinAlgError:
            return unit, unit

    def _solved(self, keys: Sequence[Key]) -> Proposal | None:
        loops = np.array([self._corner(key) for key in keys]) + self.rate * np.eye(self.loop.size)
        (T, C), size, n = self._balance, self.loop.size, self.loop.n
        back = np.linalg.inv(T)
        B = back.T @ self.basis @ back  # of P; the program's own unknown is Q = T' P T
        k = len(B)
        groups, start = self.loop.groups, self.search.start / self._scale[size - 2 * n : size - n]
        cost = np.concatenate([np.zeros(k), [float(np.sum(start[g][:1] ** 2)) for g in groups]])
        zero = np.zeros((size, size))
        rows = self._rows()
        falls = (-(C.T @ (B @ A + np.swapaxes(A, -1, -2) @ B) @ C) for A in loops)
        forms = [Form(zero, self._with_groups(fall)) for fall in falls]
        forms += [Form(-1e-6 * np.eye(size), self._with_groups(self.basis))]
        forms += [self._within(r.states @ T, r.bound) for r in rows]
        errors = slice(size - 2 * n, size - n)
        slots = np.zeros((len(groups), n, n))
        for s, g in zip(slots, groups, strict=True):
            s[g, g] = 1.0
        forms.append(Form(np.zeros((n, n)), np.concatenate([-B[:, errors, errors], slots])))
        self.search.forms += len(forms)
        if self.search.forms > SETTINGS.most_forms:
            raise UndertowError("no quadratic V was found within the time that the search may take")
        solution = solved(cost, forms)
        if solution is None:
            return None
        P = np.tensordot(solution.x[:k], B, 1)
        slopes = self._slopes(P, C, keys, solution.duals)
        for row, dual in zip(rows, solution.duals[len(keys) + 1 :], strict=False):
            if row.velocity is not None:
                own = row.states @ T
                slopes[row.velocity] += 2 * float(dual[-1, :-1] @ own[touched(B, own)]) / row.bound
        sizes = np.array([np.abs(dual).max() for dual in solution.duals[: len(keys)]])
        active = {k for k, size in zip(keys, sizes, strict=True) if size > SETTINGS.idle * sizes.max()}
        return Proposal(P, float(cost @ solution.x), slopes, active)

    def _slopes(self, P: Array, C: Array, keys: Sequence[Key], duals: Sequence[Array]) -> Array:
        """What the fall of V adds to the slopes of the start's level: what a speed adds grows with it."""
        found = np.zeros(self.loop.n)
        for (sample, case, places), dual in zip(keys, duals, strict=False):
            for i, (ends, place) in enumerate(zip(self._pieces[1], places, strict=True)):
                last = ends.shape[2] - 1
                still = last - place if last == 1 else min(max(place, 1), last - 1)
                twice = last == 1 and i not in self.corners.switching  # from one end to the other
                moved = (ends[sample, case, place] - ends[sample, case, still]) / (2 if twice else 1)
                found[i] += np.sum(dual * (C.T @ doubled(P, moved) @ C))
        return found

    def _with_groups(self, forms: Array) -> Array:
        return np.concatenate([forms, np.zeros((len(self.loop.groups), *forms.shape[1:]))])

    def _within(self, row: Array, bound: float) -> Form:
        """[P, row; row', bound^2] >= 0 on the states that belong to the row: |row z| < bound on V < 1."""
        B = self.basis
        own = touched(B, row)
        m = len(own)
        forms = np.zeros((len(B), m + 1, m + 1))
        forms[:, :m, :m] = B[:, own[:, None], own]
        constant = np.zeros((m + 1, m + 1))
        # Divided by the bound, so that numbers are near one.
        constant[:m, m] = constant[m, :m] = row[own] / bound
        constant[m, m] = (1 - SETTINGS.slack) ** 2
        return Form(constant, self._with_groups(forms))

    def _rows(self) -> list[Row]:
        """What has to stay within its bound: speeds, tilts, half a turn, commands."""
        found = [Row(row, bound) for row, bound in self._fixed_rows()]
        for speeds in self._speed_rows:
            found += map(Row, speeds, self.bounds.speeds, range(self.loop.n))
        for commands in self._command_rows:
            found += map(Row, commands, self.left)
        kept: dict[bytes, Row] = {}
        for row in found:
            kept.setdefault(np.round(self._upright(row.states) / row.bound, 9).tobytes(), row)
        return [r for r in kept.values() if np.any(r.states != 0)]

    def _upright(self, row: Array) -> Array:
        """The row with its first number positive, and that of each axis where this leaves V as it is."""
        columns = row.reshape(-1, self.loop.n) if self._apart else row[:, None]
        first = np.argmax(columns != 0, axis=0)
        signs = np.where(columns[first, np.arange(len(first))] < 0, -1.0, 1.0)
        return np.asarray((columns * signs).ravel() + 0.0)  # no zero with a sign

    @cached_property
    def _speed_rows(self) -> Array:
        """Rows of the body velocities at every sample, shape (samples, n, size)."""
        return np.asarray(self.loop.speeds_of(self.samples).middle * self._scale)

    @cached_property
    def _command_rows(self) -> Array:
        if not len(self.commands.limits):
            return np.zeros((0, 0, self.loop.size))
        return np.asarray(self.loop.commands_of(self.commands, self.samples).middle * self._scale)

    @property
    def commands(self) -> Commands:
        """The commands with limits."""
        return self.search.commands

    @cached_property
    def left(self) -> Array:
        """What the limits leave beside the weight, within the tilts."""
        return _left(self.search.problem, self.commands, self.bounds.tilts)

    def _fixed_rows(self) -> list[tuple[Array, float]]:
        n, size = self.loop.n, self.loop.size
        ends = {"psi": np.pi} | self.bounds.tilts
        found = []
        for i, c in enumerate(self.search.problem.coordinates):
            if c in ends:
                row = np.zeros(size)
                row[size - 2 * n + i] = self._scale[size - 2 * n + i]
                found.append((row, ends[c]))
        return found

    # --- what V allows ----------------------------------------------------------------------------
    def _largest(self, P: Array, rows: Array) -> Array:
        return np.asarray(np.sqrt(np.einsum("...i,...i->...", rows @ np.linalg.inv(P), rows)))

    def reach(self, proposal: Proposal) -> Array:
        """Largest error of each coordinate on V < 1."""
        n, size = self.loop.n, self.loop.size
        each = self._largest(proposal.P, np.diag(self._scale)[size - 2 * n : size - n])
        for group in self.loop.groups:
            each[group] = each[group].max()
        return each

    def speeds(self, proposal: Proposal) -> Array:
        """Largest body velocities on V < 1, over the samples."""
        return np.asarray(self._largest(proposal.P, self._speed_rows).max(axis=0))

    # --- the proof --------------------------------------------------------------------------------
    def proof(self, proposal: Proposal) -> Quadratic | None:
        """The V with everything that was asked of it proved in interval arithmetic, or None."""
        P = 0.5 * (proposal.P + proposal.P.T)
        if not (certainly_positive(enclose(P[None])) and self._fixed_proved(P)):
            return None
        weights, start = self._start_weights(P)
        if not start < 1 or not self._everywhere(P):
            return None
        return self._stated(P, proposal, weights, start)

    def _fixed_proved(self, P: Array) -> bool:
        return all(bounded(P, enclose(row[None, None]), np.array([b])).all() for row, b in self._fixed_rows())

    def _start_weights(self, P: Array) -> tuple[Array, float]:
        """S diagonal with S > P_EE, proved, and a bound on E' S E on the start box, infinite if not."""
        n, size = self.loop.n, self.loop.size
        own = P[size - 2 * n : size - n, size - 2 * n : size - n]
        weights = np.zeros(n)
        off = np.abs(own).sum(axis=1) - np.diag(own) if not self.search.problem.decoupled else np.zeros(n)
        for group in self.loop.groups:
            weights[group] = np.max((np.diag(own) + off)[group]) * (1 + 1e-9)
        if not certainly_positive(enclose((np.diag(weights) - own)[None] + 1e-12 * np.diag(weights))):
            return weights, np.inf
        scaled = self.search.start / self._scale[size - 2 * n : size - n]
        total = sum(weights[g[0]] * scaled[g[0]] ** 2 for g in self.loop.groups)
        return weights, float(total * (1 + 1e-9))

    def _everywhere(self, P: Array) -> bool:
        """Whether V falls and all bounds hold at every attitude: boxes of angles are halved until it does."""
        return self._halving(P, self._within_bounds) and self._halving(P, self._falls)

    def _halving(self, P: Array, holds: Callable[[Array, Boxes], Flags]) -> bool:
        boxes = self.loop.boxes(self._ranges)
        self._work = Work(SETTINGS.most)
        for _ in range(SETTINGS.halvings * max(len(boxes), 1)):
            open_ = ~holds(P, boxes)
            if not open_.any():
                return True
            if not boxes or self._work.left < 0:
                return False
            boxes = halved({a: Interval(v.lo[open_], v.hi[open_]) for a, v in boxes.items()})
            if open_.all():
                boxes = halved(boxes)
        return False

    def _within_bounds(self, P: Array, boxes: Boxes) -> Flags:
        """Speeds and commands, at every attitude in each box."""
        speeds = bounded(P, self._by(self.loop.speeds_of(boxes)), self.bounds.speeds)
        if not len(self.left):
            return speeds
        return speeds & bounded(P, self._by(self.loop.commands_of(self.commands, boxes)), self.left)

    def _falls(self, P: Array, boxes: Boxes) -> Flags:
        """Whether V falls at every corner of velocities at every attitude in each box.

        A(angles) differs from what its values at the corners of the box interpolate by h^2/8 times the second
        derivative along each side h at most.
        """
        batches = -(-count_of(boxes) * self.corners.cases // SETTINGS.batch)
        parts = np.array_split(np.arange(count_of(boxes)), min(count_of(boxes), batches))
        some = [{a: Interval(v.lo[p], v.hi[p]) for a, v in boxes.items()} for p in parts]
        return np.concatenate([self._falls_in(each, P) for each in some])

    def _falls_in(self, boxes: Boxes, P: Array) -> Flags:
        ratio = self._scale[None, :] / self._scale[:, None]
        missed = np.zeros((count_of(boxes), self.loop.size, self.loop.size))
        for angle, side in boxes.items():
            width = (side.hi - side.lo)[:, None, None]
            missed += 1.001 * width**2 / 8 * self.loop.bend(self.corners, boxes, angle) * ratio
        around = _doubled(P @ Interval(-missed, missed))
        at, place = corners_of(boxes)
        falls = -_doubled(P @ self._scaled(self.loop.rest(self.corners, at)))
        ends = [flat(-_doubled(P @ self._scaled(e))) for e in self.loop.added(self.corners, at)]
        rows = rows_of(falls, place) + Interval(around.lo[:, None], around.hi[:, None])
        own = place[..., None] * self.corners.cases + np.arange(self.corners.cases)
        box = np.broadcast_to(np.arange(len(missed))[:, None], own.shape).ravel()
        # Ends are the same at all attitudes, or not.
        return sums_positive(flat(flat(rows)), own.ravel() % len(ends[0].lo), ends, box, self._work)

    def _by(self, rows: Interval) -> Interval:
        return Interval(rows.lo * self._scale, rows.hi * self._scale)

    def _stated(self, P: Array, proposal: Proposal, weights: Array, start: float) -> Quadratic:
        """The proof's result in the units of the states."""
        n, size = self.loop.n, self.loop.size
        inverse = 1 / self._scale
        largest = np.zeros(0)
        if len(self.commands.limits):
            moves = self._largest(P, self._command_rows).max(axis=0) * (1 + SETTINGS.slack)
            largest = np.minimum(self.commands.limits - self.left + moves, self.commands.limits)
        own = weights * inverse[size - 2 * n : size - n] ** 2
        return Quadratic(
            P=(P * np.outer(inverse, inverse))[None],
            frame=self.loop.frame_name,
            errors=self.reach(proposal),
            speeds=self.bounds.speeds,
            starts=1 / np.sqrt(own),
            commands=largest,
            start=start,
        )


def _doubled(held: Interval) -> Interval:
    return held + held.T
