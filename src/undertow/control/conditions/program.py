"""The semidefinite program for a quadratic V on one box of speeds and tilts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple, Protocol

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .attitude import Interval, enclose
from .commands import Commands
from .definite import LMI, coupled_states, lyapunov_operator, quadratic_values, solve_sdp
from .definite import SETTINGS as PROOFS
from .embedding import Corners, Embedding
from .problem import Problem


@dataclass(frozen=True)
class QuadraticSettings:
    """How a quadratic V is searched for."""

    # V has to fall at this part of the slowest rate of the loop at rest: room for rounding and for attitudes
    # between those of the program.
    decay: float = 0.3
    # Room in every bound of the program, relative: what the solver leaves and what boxes of angles add, which
    # are halved until they add less.
    slack: float = 0.01
    command_slack: float = 0.05  # room in what is stated of commands below their limits, relative
    # Where A depends on the heading: a V for each of so many ranges of set-points in half a turn.
    sectors: int = 6
    # Boxes of angles are halved so often until the proof succeeds or is given up.
    halvings: int = 6
    rows: int = 12  # of the matrices by which work is counted
    # Matrices of so many rows that the proofs of one search may look at in vain: seconds. There are fewer of
    # larger ones, as this power of the rows: with their ends, those of 18 rows take 25 times as long.
    max_matrices: int = 100_000
    matrices_power: float = 8.0
    full_proof_factor: int = 4  # matrices of the proof of the whole, times those of what the start needs
    batch: int = 256  # boxes of attitudes and signs at a time: memory
    attitudes: tuple[int, ...] = (1, 7, 3, 3)  # in the program along each angle, by the number of angles
    sampled_corners: int = 512  # attitudes and signs whose worst corner a round of the program looks for
    eigenvectors: int = 3  # eigenvectors from which that corner is looked for, and
    alternations: int = 4  # turns between the corner and its eigenvector
    # Matrix inequalities of as many rows that the solver is given in one search: seconds. There are fewer of
    # larger ones, as this power of the number of rows.
    max_lmis: int = 3000
    lmi_power: float = 7.0
    rounds: int = 12  # of the program, each with the worst corners of the last one added
    added_corners: int = 8  # how many
    inactive_dual: float = 1e-3  # corners with a dual below this part of the largest one are left out again
    lowest_start_level: float = 0.5  # the start's level is not lowered further: V has room for other things
    level_tolerance: float = 0.02  # rise of the start's level in a round below which it is known
    max_speed_boxes: int = 40  # boxes of speeds that are tried
    first_step: float = 0.7  # of a speed, as a logarithm
    longer: float = 1.5  # factor on a step that helped
    shorter: float = 0.5  # factor on one that did not
    first_speed: float = 2.0  # factor on the speeds that an undamped or an overdamped axis would reach
    shrink: float = 0.6  # factor on speeds for which there is no V
    least_speed: float = 1e-3  # of the first speeds, below which none is looked for: no error would move
    # Factors on speeds that a V asks for which does not hold the start: a little more, and at most so much.
    growth: float = 1.15
    max_growth: float = 8.0
    least_decrease: float = 0.003  # of the logarithm of the start's level that a step has to promise
    least_step: float = 0.03  # change of speeds, relative, below which no better ones are looked for
    # Least part of the largest start error that counts for coordinates with none, so that they may be moved.
    least_share: float = 0.1
    least_of_all: float = 1e-3  # the same of translations beside rotations, and the other way round
    least_form: float = 1e-6  # eigenvalue that P has at least, in scaled coordinates
    curvature_room: float = 1.001  # factor on what interpolation misses, for rounding
    tilt_factor: float = 2.0  # roll and pitch that are allowed for, times those of the start
    # Degrees of freedom up to which P may be a full matrix. Beyond, it has a block for each axis, as gains
    # have: the search takes seconds then instead of minutes.
    max_full_dofs: int = 4
    rounded_zero: float = 1e-100  # what outward rounding makes of zero is below it

    def share(self, size: int, power: float) -> float:
        """Which part of the work for matrices of `rows` rows is for those of `size` rows."""
        return float(min(self.rows / size, 1.0) ** power)


SETTINGS = QuadraticSettings()

Key = tuple[int, int, tuple[int, ...]]
"""A corner: its attitude, its case of the signs, and the end of each velocity and uncertain parameter."""


class Proposal(NamedTuple):
    """What the program came to in scaled states."""

    P: Array
    free: Array  # N of scaled states and body velocities: sum over k of nu_k z' N_k z = 0, (n, size, size)
    levels: Array  # of V by group of errors: it is below the sum of these times squares of the errors
    start: float  # V of the worst corner of the start box; the level is one
    slopes: Array  # derivative of `start` by the logarithm of each speed of the box
    active: set[Key]  # corners that keep it from being lower


class StateBound(NamedTuple):
    """A sum of states that has to stay below its bound."""

    states: Array
    bound: float
    velocity: int | None = None  # which one, if it is one


class SpeedBox(NamedTuple):
    """A box that the level set V < 1 has to stay in."""

    speeds: Array  # body velocities, shape (n,)
    tilts: dict[str, float]  # roll and pitch, and the error of the heading where A depends on it, rad


def spare_thrust(problem: Problem, commands: Commands, tilts: Mapping[str, float]) -> Array:
    """What the limits leave beside the weight, within the tilts."""
    remaining = commands.limits - commands.at_rest(problem.attitudes.boxes(dict(tilts)))
    if len(remaining) and remaining.min() <= 0:
        raise UndertowError("holding the weight at the roll and pitch of the start takes all of a thruster")
    return np.asarray(remaining)


class SearchContext(Protocol):
    """What programs of one search share."""

    problem: Problem
    loop: Embedding
    commands: Commands
    start: Array  # largest errors to begin with
    all_identities: bool  # products of velocities may be read in every way (`identities`)
    active_corners: set[Key]  # corners that the programs so far were about
    heading_centre: float  # heading in the middle of those of the set-point, rad

    def with_floor(self, values: Array) -> Array:
        """At least a share of the largest of a kind."""

    def count_inequalities(self, inequalities: int) -> None:
        """Count what the solver is given."""


class Program:
    """The semidefinite program of one box of speeds and tilts."""

    def __init__(self, search: SearchContext, bounds: SpeedBox) -> None:
        self.search, self.bounds, self.loop = search, bounds, search.loop
        self.commands = search.commands  # those with limits
        # P has a block for each axis: V is the same with the signs of an axis turned round.
        self._blockwise = search.problem.decoupled or self.loop.n > SETTINGS.max_full_dofs
        self.corners: Corners = self.loop.corners(bounds.speeds)
        # Attitudes in the program: the middle and the ends of each angle, more where angles are few.
        count = SETTINGS.attitudes[len(self.loop.angles)]
        ends = [np.linspace(*self.ranges[a], count) for a in self.loop.angles]
        rows = np.array(list(product(*ends)))
        self.samples = {a: enclose(rows[:, i]) for i, a in enumerate(self.loop.angles)}
        # Sizes of the states: errors of the start, speeds of the box, integrals by what they hold.
        s, n = self.search, self.loop.n
        error = s.with_floor(s.start)
        speed = self.bounds.speeds.copy()
        for group in self.loop.groups:
            speed[group] = speed[group].max()
        parts = [error, speed]
        if self.loop.integral:
            K_P, K_I = (s.problem.values[g] for g in ("K_P", "K_I"))
            parts.insert(0, error * np.maximum(K_P, 1e-12) / np.maximum(K_I, 1e-9 * np.maximum(K_P, 1e-12)))
        # Powers of two scale without rounding.
        self.scale = np.asarray(2.0 ** np.round(np.log2(np.concatenate(parts)))).reshape(-1)[
            : self.loop.size + n
        ]

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Roll and pitch, and headings near those of the set-point."""
        found = {a: (-t, t) for a, t in self.bounds.tilts.items()}
        if "psi" in found:
            half = self.bounds.tilts["psi"] + 0.5 * np.pi / SETTINGS.sectors * (1 + PROOFS.room)
            found["psi"] = (self.search.heading_centre - half, self.search.heading_centre + half)
        return found

    def scaled(self, A: Interval) -> Interval:
        """A of z_dot = A z for scaled states."""
        ratio = self.scale[None, :] / self.scale[:, None]
        return Interval(A.lo * ratio, A.hi * ratio)

    # --- the program ----------------------------------------------------------------------------
    @cached_property
    def basis(self) -> Array:
        """Symmetric matrices that P is a sum of: blocks of the axes if many or uncoupled, (k, size, size)."""
        n, size = self.loop.n, self.loop.size
        pairs = [(i, j) for i in range(size) for j in range(i, size) if not self._blockwise or i % n == j % n]
        found = np.zeros((len(pairs), size, size))
        for k, (i, j) in enumerate(pairs):
            found[k, i, j] = found[k, j, i] = 1.0
        return found

    @cached_property
    def _system_matrices(self) -> tuple[Array, list[Array]]:
        """A at rest (samples, cases, size, size) and what each velocity adds (samples, cases, ends, ...)."""
        rest = self.scaled(self.loop.rest(self.corners, self.samples)).middle
        ends = [self.scaled(e).middle for e in self.loop.added(self.corners, self.samples)]
        return rest, [np.broadcast_to(e, (len(rest), *e.shape[1:])) for e in ends]

    def _corner_matrix(self, key: Key) -> Array:
        rest, ends = self._system_matrices
        sample, case, vertices = key
        return np.asarray(
            rest[sample, case] + sum(e[sample, case, p] for e, p in zip(ends, vertices, strict=True))
        )

    @cached_property
    def values(self) -> list[Array]:
        """By velocity its value at its ends in units of its scale, shape (cases, ends)."""
        return [v / s for v, s in zip(self.corners.values, self.scale[-self.loop.n :], strict=True)]

    @cached_property
    def identities(self) -> Array:
        """Forms of scaled states and body velocities that vanish, shape (m, n, size, size)."""
        n, size = self.loop.n, self.loop.size
        every = self.search.all_identities
        return identities(self.corners, n, size) if every else np.zeros((0, n, size, size))

    @cached_property
    def _to_body(self) -> Array:
        """T of body velocities from scaled states at every sample, shape (samples, size, size)."""
        T = self.loop.body(self.samples).middle[:, 0] * self.scale[:, None] / self.scale
        return np.broadcast_to(T, (len(self._system_matrices[0]), *T.shape[1:]))

    def _velocity_terms(self, P: Array, free: Array, samples: Any, cases: Any) -> list[Array]:
        """What each velocity, then each parameter, adds to V_dot in these rows, (rows, ends, size, size)."""
        T = self._to_body[samples][:, None]
        free_terms = T @ free @ np.swapaxes(T, -1, -2)
        found = [lyapunov_operator(P, e[samples, cases]) for e in self._system_matrices[1]]
        for i, v in enumerate(self.values):
            found[i] = found[i] + v[cases][..., None, None] * free_terms[:, i, None]
        return found

    @cached_property
    def rate(self) -> float:
        """The decay that is asked for, 1/s."""
        slowest = -float(np.max(np.linalg.eigvals(self._system_matrices[0]).real))
        return SETTINGS.decay * slowest

    def solve(self, best: float = np.inf) -> Proposal | None:
        """P by cutting planes: corners come in as they are violated, and go where they do not matter.

        Corners only raise the start's level, so that a program that comes above `best` has said enough, and
        one above one, too, once the corners that matter are among them.
        """
        warm = bool(self.search.active_corners)  # by the programs of other speeds
        active_corners, level = self.search.active_corners or self._first_corners(), 0.0
        for seed in range(SETTINGS.rounds):
            proposal = self._solve(sorted(active_corners))
            if proposal is None or proposal.start >= best:
                return proposal
            worst = set(self._violated(proposal, seed))
            rises = proposal.start > level * (1 + SETTINGS.level_tolerance)
            active = proposal.active if rises else active_corners
            self.search.active_corners = active | worst
            if worst <= active_corners or (proposal.start > 1 and (warm or not rises)):
                return proposal
            active_corners, level = self.search.active_corners, proposal.start
        return None

    def _first_corners(self) -> set[Key]:
        """Corners here and there."""
        rest, ends = self._system_matrices
        rng = np.random.default_rng(0)
        return {
            (int(i), int(rng.integers(rest.shape[1])), tuple(int(rng.integers(e.shape[2])) for e in ends))
            for i in np.linspace(0, len(rest) - 1, SETTINGS.added_corners)
        }

    def _violated(self, proposal: Proposal, seed: int) -> list[Key]:
        """The corners at which V falls too slowly, worst first, some of them.

        V_dot along x is a sum over the velocities, so the worst corner for a direction x is known, and
        the worst direction of a corner is an eigenvector: they are taken in turns.
        """
        P, rest = proposal.P, self._system_matrices[0]
        pairs = np.stack(np.unravel_index(np.arange(rest.shape[0] * rest.shape[1]), rest.shape[:2]), 1)
        if len(pairs) > SETTINGS.sampled_corners:
            pairs = np.random.default_rng(seed).permutation(pairs)[: SETTINGS.sampled_corners]
        at_rest = lyapunov_operator(P, rest[pairs[:, 0], pairs[:, 1]] + self.rate * np.eye(self.loop.size))
        added = self._velocity_terms(P, proposal.free, *pairs.T)
        _, vectors = np.linalg.eigh(at_rest)
        limit = 0.5 * self.rate * float(np.linalg.eigvalsh(P)[0])  # half of the decay is the proof's
        found: dict[Key, float] = {}
        for k in range(1, SETTINGS.eigenvectors + 1):
            worst, values = _worst_vertices(at_rest, added, vectors[..., -k])
            for (i, case), vertices, value in zip(pairs, worst, values, strict=True):
                if value > limit:
                    found[(int(i), int(case), tuple(map(int, vertices)))] = float(value)
        return sorted(found, key=lambda key: -found[key])[: SETTINGS.added_corners]

    @cached_property
    def _balancing(self) -> tuple[Array, Array]:
        """Columns T with T' P_0 T = I, and C with C' (P_0 A + A' P_0) C = -I, of the loop at rest.

        Rates of one loop are far apart; in these states the program is well conditioned, and P is near I.
        """
        from scipy.linalg import solve_continuous_lyapunov, sqrtm

        pattern = np.abs(self.basis).sum(axis=0) > 0
        A = self._system_matrices[0].mean(axis=(0, 1)) * pattern
        unit = np.eye(len(A))
        W = np.real(sqrtm(A.T @ A))
        try:
            P = solve_continuous_lyapunov(A.T, -W)
            T, C = (np.linalg.inv(np.linalg.cholesky(0.5 * (m + m.T))).T * pattern for m in (P, W))
            return T, C
        except np.linalg.LinAlgError:
            return unit, unit

    def _solve(self, keys: Sequence[Key]) -> Proposal | None:
        (T, C), size, n = self._balancing, self.loop.size, self.loop.n
        T_inverse = np.linalg.inv(T)
        B = T_inverse.T @ self.basis @ T_inverse  # of P; the program's own unknown is Q = T' P T
        groups, start = self.loop.groups, self.search.start / self.scale[size - 2 * n : size - n]
        k, g, m = self._unknown_counts
        level = np.zeros(k + g + m)
        level[k : k + g] = [float(np.sum(start[group][:1] ** 2)) for group in groups]
        rows = self._state_bounds()
        inequalities = self._decreases(keys, B, C)
        inequalities += [LMI(-SETTINGS.least_form * np.eye(size), self._coefficients(self.basis))]
        inequalities += [self._row_inequality(r.states @ T, r.bound) for r in rows]
        errors = slice(size - 2 * n, size - n)
        slots = np.zeros((g, n, n))
        for s, group in zip(slots, groups, strict=True):
            s[group, group] = 1.0
        inequalities.append(LMI(np.zeros((n, n)), self._coefficients(-B[:, errors, errors], slots)))
        # The start's level, where it can be brought below, stays there: V has room then.
        inequalities.append(LMI(np.array([[-SETTINGS.lowest_start_level]]), level[:, None, None]))
        self.search.count_inequalities(len(inequalities))
        solution = solve_sdp(level, inequalities)
        if solution is None:
            return None
        P = np.tensordot(solution.x[:k], B, 1)
        if np.linalg.eigvalsh(P)[0] <= 0:  # the solver came to its border, and no further
            return None
        free = np.tensordot(solution.x[k + g :], self.identities, 1)
        slopes = self._decrease_slopes(P, free, C, keys, solution.duals)
        for row, dual in zip(rows, solution.duals[len(keys) + 1 :], strict=False):
            if row.velocity is not None:
                states = row.states @ T
                slopes[row.velocity] += (
                    2 * float(dual[-1, :-1] @ states[coupled_states(B, states)]) / row.bound
                )
        sizes = np.array([np.abs(dual).max() for dual in solution.duals[: len(keys)]])
        active = {
            key for key, size in zip(keys, sizes, strict=True) if size > SETTINGS.inactive_dual * sizes.max()
        }
        return Proposal(P, free, solution.x[k : k + g], float(level @ solution.x), slopes, active)

    def _decreases(self, keys: Sequence[Key], B: Array, C: Array) -> list[LMI]:
        """V falls at these corners."""
        found, shift = [], self.rate * np.eye(self.loop.size)
        for key in keys:
            sample, case, vertices = key
            nu = np.array([v[case, p] for v, p in zip(self.values, vertices, strict=False)])
            T = C.T @ self._to_body[sample]
            free = T @ np.tensordot(nu, self.identities, (0, 1)) @ T.T
            minus_V_dot = -(C.T @ lyapunov_operator(B, self._corner_matrix(key) + shift) @ C)
            found.append(LMI(np.zeros_like(shift), self._coefficients(minus_V_dot, free=-free)))
        return found

    def _decrease_slopes(
        self, P: Array, free: Array, C: Array, keys: Sequence[Key], duals: Sequence[Array]
    ) -> Array:
        """What the fall of V adds to the slopes of the start's level: what a speed adds grows with it."""
        found = np.zeros(self.loop.n)
        samples, cases = np.array([key[:2] for key in keys]).T
        for i, added in enumerate(self._velocity_terms(P, free, samples, cases)[: self.loop.n]):
            moved = _beyond_rest(added, i in self.corners.switching)
            for row, (key, dual) in enumerate(zip(keys, duals, strict=False)):
                found[i] += np.sum(dual * (C.T @ moved[row, key[2][i]] @ C))
        return found

    @property
    def _unknown_counts(self) -> tuple[int, int, int]:
        """How many: of P, levels of the start's groups, and forms that vanish."""
        return len(self.basis), len(self.loop.groups), len(self.identities)

    def _coefficients(self, of_P: Array, levels: Array | None = None, free: Array | None = None) -> Array:
        """What each unknown adds to a form; nothing unless it is given."""
        _, g, m = self._unknown_counts
        none = [np.zeros((count, *of_P.shape[1:])) for count in (g, m)]
        return np.concatenate(
            [of_P, none[0] if levels is None else levels, none[1] if free is None else free]
        )

    def _row_inequality(self, row: Array, bound: float) -> LMI:
        """[P, row; row', bound^2] >= 0 on the states that belong to the row: |row z| < bound on V < 1."""
        B = self.basis
        states = coupled_states(B, row)
        m = len(states)
        coefficients = np.zeros((len(B), m + 1, m + 1))
        coefficients[:, :m, :m] = B[:, states[:, None], states]
        constant = np.zeros((m + 1, m + 1))
        # Divided by the bound, so that numbers are near one.
        constant[:m, m] = constant[m, :m] = row[states] / bound
        constant[m, m] = (1 - SETTINGS.slack) ** 2
        return LMI(constant, self._coefficients(coefficients))

    def _state_bounds(self) -> list[StateBound]:
        """What has to stay within its bound: speeds, tilts, half a turn, commands."""
        found = [StateBound(row, bound) for row, bound in self.fixed_rows()]
        for speeds in self.speed_rows:
            found += [
                StateBound(row, bound, i)
                for i, (row, bound) in enumerate(zip(speeds, self.bounds.speeds, strict=True))
            ]
        for commands in self.command_rows:
            found += [StateBound(row, left) for row, left in zip(commands, self.spare_thrust, strict=True)]
        distinct: dict[bytes, StateBound] = {}
        for row in found:
            distinct.setdefault(np.round(self._canonical_row(row.states) / row.bound, 9).tobytes(), row)
        return [r for r in distinct.values() if np.any(r.states != 0)]

    def _canonical_row(self, row: Array) -> Array:
        """The row with its first number positive, and that of each axis where this leaves V as it is."""
        columns = row.reshape(-1, self.loop.n) if self._blockwise else row[:, None]
        first = np.argmax(columns != 0, axis=0)
        signs = np.where(columns[first, np.arange(len(first))] < 0, -1.0, 1.0)
        return np.asarray((columns * signs).ravel() + 0.0)  # no zero with a sign

    @cached_property
    def speed_rows(self) -> Array:
        """Rows of the body velocities at every sample, shape (samples, n, size)."""
        return np.asarray(self.loop.speeds_of(self.samples).middle * self.scale)

    @cached_property
    def command_rows(self) -> Array:
        if not len(self.commands.limits):
            return np.zeros((0, 0, self.loop.size))
        return np.asarray(self.loop.commands_of(self.commands, self.samples).middle * self.scale)

    @cached_property
    def spare_thrust(self) -> Array:
        """What the limits leave beside the weight, within the tilts."""
        return spare_thrust(self.search.problem, self.commands, self.bounds.tilts)

    def fixed_rows(self) -> Iterator[tuple[Array, float]]:
        """Tilts and half a turn."""
        n, size = self.loop.n, self.loop.size
        ends = {"psi": np.pi} | self.bounds.tilts
        for i, c in enumerate(self.search.problem.coordinates):
            if c in ends:
                row = np.zeros(size)
                row[size - 2 * n + i] = self.scale[size - 2 * n + i]
                yield row, ends[c]

    # --- what V allows ----------------------------------------------------------------------------
    def _largest(self, P: Array, rows: Array) -> Array:
        return np.asarray(np.sqrt(np.einsum("...i,...i->...", rows @ np.linalg.inv(P), rows)))

    def reach(self, proposal: Proposal) -> Array:
        """Largest error of each coordinate on V < 1."""
        n, size = self.loop.n, self.loop.size
        errors = self._largest(proposal.P, np.diag(self.scale)[size - 2 * n : size - n])
        for group in self.loop.groups:
            errors[group] = errors[group].max()
        return errors

    def speeds(self, proposal: Proposal) -> Array:
        """Largest body velocities on V < 1, over the samples."""
        return np.asarray(self._largest(proposal.P, self.speed_rows).max(axis=0))

    def command_changes(self, proposal: Proposal) -> Array:
        """Largest of what each limited command adds to that at rest on V < 1, over the samples."""
        return np.asarray(self._largest(proposal.P, self.command_rows).max(axis=0, initial=0.0))

    def required_box(self, found: Proposal, room: float) -> SpeedBox:
        """The box that the start needs, with some room."""
        size = np.sqrt(found.start * (1 + room)) * (1 + room)
        reach = dict(zip(self.search.problem.coordinates, size * self.reach(found), strict=True))
        return SpeedBox(size * self.speeds(found), {a: float(reach[a]) for a in self.bounds.tilts})

    def narrowed(self, found: Proposal) -> tuple[Program, Proposal]:
        """The same V, of whose level set only as much is claimed as the start needs, on the box of that."""
        box = self.required_box(found, SETTINGS.slack)
        tilts = {a: min(t, box.tilts[a]) for a, t in self.bounds.tilts.items()}
        other = Program(self.search, SpeedBox(np.minimum(box.speeds, self.bounds.speeds), tilts))
        level = found.start * (1 + SETTINGS.slack)
        ratio = other.scale / self.scale
        both = np.outer(ratio, ratio)
        free = found.free * ratio[-self.loop.n :, None, None] * both / level
        errors = ratio[self.loop.size - 2 * self.loop.n : -self.loop.n]
        levels = found.levels * errors[[g[0] for g in self.loop.groups]] ** 2 / level
        P, start = found.P * both / level, found.start / level
        return other, found._replace(P=P, free=free, levels=levels, start=start)


def _worst_vertices(at_rest: Array, added: Sequence[Array], x: Array) -> tuple[Array, Array]:
    """The worst end of each velocity by row, from a direction on, and the largest eigenvalue with them."""
    rows, unit = np.arange(len(at_rest)), np.eye(at_rest.shape[-1])
    for _ in range(SETTINGS.alternations):
        worst = [np.argmax(quadratic_values(unit, e, x), axis=-1) for e in added]
        total = at_rest + sum(e[rows, w] for e, w in zip(added, worst, strict=True))
        values, vectors = np.linalg.eigh(total)
        x = vectors[..., -1]
    return np.array(worst).T, values[:, -1]


def _beyond_rest(added: Array, switched: bool) -> Array:
    """What each end adds beyond rest, which grows with the speed, shape (rows, ends, size, size)."""
    last = added.shape[1] - 1
    if switched:
        return np.asarray(added - added[:, -1:])
    if last == 1:  # one end is the other turned round
        return np.asarray(added - added.mean(axis=1, keepdims=True))
    return np.asarray(added - added[:, np.clip(np.arange(last + 1), 1, last - 1)])


# --- forms that vanish ------------------------------------------------------------------------------
Axes = tuple[int, ...]
Monomial = tuple[int, int, int]
"""A velocity, and the places in z of the two states that it multiplies."""


def identities(corners: Corners, n: int, size: int) -> Array:
    """Independent N with z' N(nu) z = 0, for z = (..., nu) of so many states, shape (m, n, size, size).

    A product of velocities can be read as a velocity times a form of the others in more than one way, as
    u (v r) = v (u r) = r (u v), and e_x (u r) = e_x (r u). A(nu) takes one of them; at a corner of a box of
    speeds the others are worth more or less. So every N with sum over k of nu_k z' N_k z = 0 may be added to
    the condition that V falls (annihilators: Trofino and Dezuo 2014, LMI stability conditions for uncertain
    rational nonlinear systems, Int. J. Robust Nonlinear Control 24).
    """
    found = [
        _identity_form(*pair, n, size)
        for axes in _coupled_axes(corners)
        for pair in _equal_monomials(axes, n, size)
    ]
    return np.array(found).reshape(-1, n, size, size)


def _coupled_axes(corners: Corners) -> list[Axes]:
    """Three axes, two of which may be one, that meet in a product: the velocity, the row and the column."""
    found = set()
    for k, end in enumerate(corners.ends):
        size = end.velocity.magnitude.max(axis=0) + end.skew.magnitude.max(axis=0)
        found |= {tuple(sorted((k, int(i), int(j)))) for i, j in np.argwhere(size > SETTINGS.rounded_zero)}
    return sorted(axes for axes in found if len(set(axes)) > 1)


def _equal_monomials(axes: Axes, n: int, size: int) -> Iterator[tuple[Monomial, Monomial]]:
    """Two ways of reading one product: of three velocities, or of two and a state of the third axis."""
    last = size - n
    for i in sorted(set(axes)):
        one, other = _without(axes, i)
        if one != other:
            yield from (((one, p + i, last + other), (other, p + i, last + one)) for p in range(0, last, n))
    first, *others = sorted(set(axes))
    for k in others:
        yield _monomial(axes, first, last), _monomial(axes, k, last)


def _without(axes: Axes, one: int) -> Axes:
    place = axes.index(one)
    return axes[:place] + axes[place + 1 :]


def _monomial(axes: Axes, k: int, last: int) -> Monomial:
    i, j = _without(axes, k)
    return k, last + i, last + j


def _identity_form(one: Monomial, other: Monomial, n: int, size: int) -> Array:
    found = np.zeros((n, size, size))
    for (k, i, j), sign in ((one, 1.0), (other, -1.0)):
        found[k, i, j] += sign
        found[k, j, i] += sign
    return found
