"""A quadratic V for PD and PID loops, found by a semidefinite program and proved without trusting it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array, Flags

from .attitude import Interval, enclose
from .commands import Commands
from .embedding import Boxes, Embedding, Vertices, certainly_positive
from .problem import Problem
from .result import Quadratic


@dataclass(frozen=True)
class QuadraticSettings:
    """How a quadratic V is searched for."""

    # V has to fall at this part of the slowest rate of the loop at rest: room for rounding and for attitudes
    # between those of the program.
    decay: float = 0.3
    # Room in every bound of the program, relative: what the solver leaves and what boxes of angles add.
    slack: float = 0.05
    headings: int = 12  # headings in the program; the proof has every one
    # Boxes of angles are halved so often until the proof succeeds or is given up.
    halvings: int = 6
    most: float = 1.5e8  # size^3 of all matrices that one proof may look at: seconds
    batch: int = 1024  # matrices at a time: memory
    most_in_program: int = 25_000  # corners with all attitudes: memory
    rounds: int = 12  # of the program, each with the worst corners of the last one added
    added: int = 8  # how many
    tries: int = 7  # boxes of speeds that are tried
    first_speed: float = 2.0  # factor on the speeds that an undamped or an overdamped axis would reach
    smaller: float = 0.6  # factor on speeds for which there is no V
    # Factors on speeds that a V asks for which does not hold the start: a little more, and at most so much.
    more: float = 1.15
    most_more: float = 8.0
    # Least part of the largest start error that counts for coordinates with none, so that they may be moved.
    least_share: float = 0.1
    tilt: float = 2.0  # roll and pitch that are allowed for, times those of the start
    # Degrees of freedom up to which P is a full matrix. Beyond, it has a block for each axis, as gains have:
    # the program takes seconds then instead of minutes.
    most_full: int = 4


SETTINGS = QuadraticSettings()


class Proposal(NamedTuple):
    """What the program came to in scaled states."""

    P: Array
    start: float  # V of the worst corner of the start box; the level is one


class Bounds(NamedTuple):
    """A box that the level set V < 1 has to stay in."""

    speeds: Array  # body velocities, shape (n,)
    tilts: dict[str, float]  # roll and pitch, rad


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

    def __init__(self, problem: Problem, start: Mapping[str, float], loop: Embedding | None = None) -> None:
        self.problem, self.loop = problem, loop or Embedding(problem)
        self.commands = Commands(problem)
        self.chosen: set[int] = set()  # corners that the programs so far were about
        self.start = self._mixed(np.array([start.get(c, 0.0) for c in problem.coordinates]))

    def _mixed(self, start: Array) -> Array:
        """The box with the radius of its corners in coordinates that the frame mixes."""
        found = start.copy()
        for group in self.loop.groups:
            found[group] = np.sqrt(np.sum(start[group] ** 2)) * (1 + 1e-12)
        return found

    # --- boxes of speeds --------------------------------------------------------------------------
    def found(self) -> Quadratic | None:
        """The first V that is proved and holds the start."""
        self._require_thrust()
        bounds: Bounds | None = self._first()
        for _ in range(SETTINGS.tries):
            if bounds is None:
                return None
            program = Program(self, bounds)
            if program.rate <= 0:
                raise UndertowError("the loop at rest is not stable at every attitude")
            proposal = program.solve()
            if proposal is not None and proposal.start < 1:
                proof = program.proof(proposal)
                if proof is not None:
                    return proof
            bounds = self._next(bounds, program, proposal)
        return None

    def _require_thrust(self) -> None:
        """Refuse a start at which the law asks for more than a thruster has, on an even keel."""
        if not len(self.commands.limits):
            return
        level = {a: _point(np.zeros(1)) for a in self.loop.angles}
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
        tilts = {a: self._tilt(SETTINGS.tilt * e) for a, e in self._tilted(self._filled(self.start)).items()}
        return Bounds(speeds, tilts)

    def _tilted(self, values: Array) -> dict[str, float]:
        pairs = zip(self.problem.coordinates, values, strict=True)
        return {c: float(v) for c, v in pairs if c in ("phi", "theta")}

    def _tilt(self, angle: float) -> float:
        return min(angle, self.problem.attitudes.tilt)

    def _filled(self, values: Array) -> Array:
        """At least a share of the largest among translations, and among rotations."""
        found = values.copy()
        for kind in (self.loop.shifts, self.loop.turns):
            if kind:
                found[kind] = np.maximum(found[kind], SETTINGS.least_share * found[kind].max())
        if not found.any():
            raise UndertowError("the start box has no error at all: state one, as x=0.5 m")
        return np.maximum(found, 1e-3 * found.max())

    def _next(self, bounds: Bounds, program: Program, proposal: Proposal | None) -> Bounds | None:
        """Smaller speeds where there is no V; those that the start asks for where V does not hold it."""
        if proposal is None or proposal.start < 1:
            least = self._tilted(self._filled(self.start) * (1 + SETTINGS.slack))
            tilts = {a: max(SETTINGS.smaller * t, self._tilt(least[a])) for a, t in bounds.tilts.items()}
            return Bounds(SETTINGS.smaller * bounds.speeds, tilts)
        growth = np.sqrt(proposal.start) * SETTINGS.more
        reach, speeds = program.reach(proposal) * growth, program.speeds(proposal) * growth
        most = np.minimum(speeds, SETTINGS.most_more * bounds.speeds)
        tilts = {a: self._tilt(v) for a, v in self._tilted(reach).items()}
        return Bounds(np.maximum(most, bounds.speeds / SETTINGS.most_more), tilts)


class Program:
    """The semidefinite program of one box of speeds and tilts, and the proof of what it finds."""

    def __init__(self, search: Search, bounds: Bounds) -> None:
        self.search, self.bounds, self.loop = search, bounds, search.loop
        self.vertices = self.loop.vertices(bounds.speeds)
        self.count = len(self.vertices.inverse.lo)
        self.samples = self._samples()
        self._require_few()
        self._scale = self._scaling()

    def _samples(self) -> Boxes:
        """Attitudes in the program: an even keel and the extremes of roll and pitch, at every heading."""
        ends = self.bounds.tilts
        tilts = [dict(zip(ends, s, strict=True)) for s in product((-1.0, 0.0, 1.0), repeat=len(ends))]
        tilts = [t for t in tilts if 0.0 not in t.values() or not any(t.values())]
        count = SETTINGS.headings if "psi" in self.loop.angles else 1
        headings = np.linspace(-np.pi, np.pi, count, endpoint=False)
        rows = [{a: t[a] * ends[a] for a in ends} | {"psi": float(h)} for t in tilts for h in headings]
        return {a: _point(np.array([r[a] for r in rows])) for a in self.loop.angles}

    def _require_few(self) -> None:
        total = self.count * max(_count(self.samples), 1)
        if total > SETTINGS.most_in_program:
            raise UndertowError(
                f"a quadratic V would have to fall at {total} corners of speeds and attitudes, and the "
                f"limit is {SETTINGS.most_in_program}: give x, y and z the same gains, so that the heading "
                "drops out"
            )

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
    @cached_property
    def basis(self) -> Array:
        """Symmetric matrices that P is a sum of: blocks of the axes if many or uncoupled, (k, size, size)."""
        n, size = self.loop.n, self.loop.size
        one = self.search.problem.decoupled or n > SETTINGS.most_full
        pairs = [(i, j) for i in range(size) for j in range(i, size) if not one or i % n == j % n]
        found = np.zeros((len(pairs), size, size))
        for k, (i, j) in enumerate(pairs):
            found[k, i, j] = found[k, j, i] = 1.0
        return found

    @cached_property
    def loops(self) -> Array:
        """A at every sample and vertex, scaled, shape (samples, vertices, size, size)."""
        return np.asarray(self._scaled(self.loop.loop(self.vertices, self.samples)).middle)

    @cached_property
    def rate(self) -> float:
        """The decay that is asked for, 1/s."""
        rest = self.loop.vertices(0 * self.bounds.speeds)
        found = self._scaled(self.loop.loop(rest, self.samples)).middle
        slowest = -float(np.max(np.linalg.eigvals(found).real))
        return SETTINGS.decay * slowest

    def solve(self) -> Proposal | None:
        """P by cutting planes: corners come in as they are violated."""
        loops = self.loops.reshape(-1, self.loop.size, self.loop.size)
        loops = loops + self.rate * np.eye(self.loop.size)
        step = max(1, len(loops) // SETTINGS.added)
        chosen = self.search.chosen or set(range(0, len(loops), step))
        self.search.chosen = chosen
        for _ in range(SETTINGS.rounds):
            proposal = self._solved(loops[sorted(chosen)])
            if proposal is None:
                return None
            worst = self._violated(loops, proposal.P)
            if set(worst) <= chosen:
                return proposal
            chosen |= set(worst)
        return None

    def _violated(self, loops: Array, P: Array) -> list[int]:
        """The corners at which V falls too slowly, worst first, some of them."""
        held = P @ loops
        values = np.linalg.eigvalsh(held + np.swapaxes(held, -1, -2))[:, -1]
        limit = 0.5 * self.rate * float(np.linalg.eigvalsh(P)[0])  # half of the decay is the proof's
        order = np.argsort(-values)[: SETTINGS.added]
        return [int(i) for i in order if values[i] > limit]

    def _solved(self, loops: Array) -> Proposal | None:
        B, n = self.basis, self.loop.n
        k, size = len(B), self.loop.size
        groups, start = self.loop.groups, self.search.start / self._scale[size - 2 * n : size - n]
        cost = np.concatenate([np.zeros(k), [float(np.sum(start[g][:1] ** 2)) for g in groups]])
        zero = np.zeros((size, size))
        forms = [_Form(zero, self._with_groups(-(B @ A + np.swapaxes(A, -1, -2) @ B))) for A in loops]
        forms += [_Form(-1e-6 * np.eye(size), self._with_groups(B))]
        for row, bound in self._rows():
            forms.append(self._within(row, bound))
        errors = slice(size - 2 * n, size - n)
        slots = np.zeros((len(groups), n, n))
        for s, g in zip(slots, groups, strict=True):
            s[g, g] = 1.0
        forms.append(_Form(np.zeros((n, n)), np.concatenate([-B[:, errors, errors], slots])))
        x = solved(cost, forms)
        if x is None:
            return None
        return Proposal(np.tensordot(x[:k], B, 1), float(cost @ x))

    def _with_groups(self, forms: Array) -> Array:
        return np.concatenate([forms, np.zeros((len(self.loop.groups), *forms.shape[1:]))])

    def _within(self, row: Array, bound: float) -> _Form:
        """[P, row; row', bound^2] >= 0 on the states that belong to the row: |row z| < bound on V < 1."""
        B = self.basis
        touched: Flags = row != 0
        for _ in range(2):
            touched = touched | (np.abs(B).sum(axis=0)[touched].sum(axis=0) > 0)
        own = np.flatnonzero(touched)
        m = len(own)
        forms = np.zeros((len(B), m + 1, m + 1))
        forms[:, :m, :m] = B[:, own[:, None], own]
        constant = np.zeros((m + 1, m + 1))
        # Divided by the bound, so that numbers are near one.
        constant[:m, m] = constant[m, :m] = row[own] / bound
        constant[m, m] = (1 - SETTINGS.slack) ** 2
        return _Form(constant, self._with_groups(forms))

    def _rows(self) -> list[tuple[Array, float]]:
        """What has to stay within its bound: speeds, tilts, half a turn, commands."""
        found: list[tuple[Array, float]] = list(self._fixed_rows())
        for speeds in self._speed_rows:
            found += zip(speeds, self.bounds.speeds, strict=True)
        for commands in self._command_rows:
            found += zip(commands, self.left, strict=True)
        kept: dict[bytes, tuple[Array, float]] = {}
        for row, bound in found:
            kept.setdefault(np.round(np.abs(row) / bound, 9).tobytes(), (row, bound))
        return [(r, b) for r, b in kept.values() if np.any(r != 0)]

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
        rest = self.commands.at_rest(self.search.problem.attitudes.boxes(self.bounds.tilts))
        left = self.commands.limits - rest
        if len(left) and left.min() <= 0:
            raise UndertowError(
                "holding the weight at the roll and pitch of the start takes all of a thruster"
            )
        return left

    def _fixed_rows(self) -> list[tuple[Array, float]]:
        n, size = self.loop.n, self.loop.size
        ends = self.bounds.tilts | {"psi": np.pi}
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
        weights = self._start_weights(P)
        if weights is None or not self._everywhere(P):
            return None
        return self._stated(P, proposal, weights)

    def _fixed_proved(self, P: Array) -> bool:
        return all(
            _bounded(P, enclose(row[None, None]), np.array([b])).all() for row, b in self._fixed_rows()
        )

    def _start_weights(self, P: Array) -> Array | None:
        """S diagonal with S > P_EE, proved, and E' S E < 1 on the start box; None if there is none."""
        n, size = self.loop.n, self.loop.size
        own = P[size - 2 * n : size - n, size - 2 * n : size - n]
        weights = np.zeros(n)
        off = np.abs(own).sum(axis=1) - np.diag(own) if not self.search.problem.decoupled else np.zeros(n)
        for group in self.loop.groups:
            weights[group] = np.max((np.diag(own) + off)[group]) * (1 + 1e-9)
        if not certainly_positive(enclose((np.diag(weights) - own)[None] + 1e-12 * np.diag(weights))):
            return None
        scaled = self.search.start / self._scale[size - 2 * n : size - n]
        total = sum(weights[g[0]] * scaled[g[0]] ** 2 for g in self.loop.groups)
        return weights if total * (1 + 1e-9) < 1 else None

    def _everywhere(self, P: Array) -> bool:
        """Whether V falls and all bounds hold at every attitude: boxes of angles are halved until it does."""
        if not self._halving(P, self._within_bounds, 1):
            return False
        if self._halving(P, partial(self._falls, vertices=self.vertices.hull), 1):
            return True
        return self._halving(P, partial(self._falls, vertices=self.vertices), self.count)

    def _halving(self, P: Array, holds: Callable[[Array, Boxes], Flags], each: int) -> bool:
        boxes = self.loop.boxes(self.bounds.tilts, {"phi": 2, "theta": 2, "psi": 2 * SETTINGS.headings})
        looked = 0.0
        for _ in range(SETTINGS.halvings * max(len(boxes), 1)):
            looked += each * _count(boxes) * 2 ** len(boxes) * self.loop.size**3
            if looked > SETTINGS.most:
                return False
            open_ = ~holds(P, boxes)
            if not open_.any():
                return True
            if not boxes:
                return False
            boxes = _halved({a: Interval(v.lo[open_], v.hi[open_]) for a, v in boxes.items()})
            if open_.all():
                boxes = _halved(boxes)
        return False

    def _within_bounds(self, P: Array, boxes: Boxes) -> Flags:
        """Speeds and commands, at every attitude in each box."""
        speeds = _bounded(P, self._by(self.loop.speeds_of(boxes)), self.bounds.speeds)
        if not len(self.left):
            return speeds
        return speeds & _bounded(P, self._by(self.loop.commands_of(self.commands, boxes)), self.left)

    def _falls(self, P: Array, boxes: Boxes, vertices: Vertices) -> Flags:
        """Whether V falls at every vertex, or in the one interval around all, at every attitude in each box.

        A(angles) differs from what its values at the corners of the box interpolate by h^2/8 times the second
        derivative along each side h at most.
        """
        batches = min(_count(boxes), -(-_count(boxes) * len(vertices.inverse.lo) // SETTINGS.batch))
        parts = np.array_split(np.arange(_count(boxes)), batches)
        some = [{a: Interval(v.lo[p], v.hi[p]) for a, v in boxes.items()} for p in parts]
        return np.concatenate([self._falls_in(each, P, vertices) for each in some])

    def _falls_in(self, boxes: Boxes, P: Array, vertices: Vertices) -> Flags:
        ratio = self._scale[None, :] / self._scale[:, None]
        missed = np.zeros((_count(boxes), self.loop.size, self.loop.size))
        for angle, side in boxes.items():
            width = (side.hi - side.lo)[:, None, None]
            missed += 1.001 * width**2 / 8 * self.loop.bend(self.vertices, boxes, angle) * ratio
        around = Interval(-missed[:, None], missed[:, None])
        held = np.ones(_count(boxes), dtype=bool)
        for corner in product(*(("lo", "hi") for _ in boxes)):
            at = {a: _point(getattr(v, side)) for (a, v), side in zip(boxes.items(), corner, strict=True)}
            fall = P @ (self._scaled(self.loop.loop(vertices, at)) + around)
            held &= _positive(-(fall + fall.T))
        return held

    def _by(self, rows: Interval) -> Interval:
        return Interval(rows.lo * self._scale, rows.hi * self._scale)

    def _stated(self, P: Array, proposal: Proposal, weights: Array) -> Quadratic:
        """The proof's result in the units of the states."""
        n, size = self.loop.n, self.loop.size
        inverse = 1 / self._scale
        largest = np.zeros(0)
        if len(self.commands.limits):
            moves = self._largest(P, self._command_rows).max(axis=0) * (1 + SETTINGS.slack)
            largest = np.minimum(self.commands.limits - self.left + moves, self.commands.limits)
        own = weights * inverse[size - 2 * n : size - n] ** 2
        return Quadratic(
            P=P * np.outer(inverse, inverse),
            frame=self.loop.frame_name,
            errors=self.reach(proposal),
            speeds=self.bounds.speeds,
            starts=1 / np.sqrt(own),
            commands=largest,
            start=float(proposal.start),
            matrices=self.count,
        )


def _point(value: Array) -> Interval:
    return Interval(value, value)


def _count(boxes: Boxes) -> int:
    return len(next(iter(boxes.values())).lo) if boxes else 1


def _halved(boxes: Boxes) -> Boxes:
    """Two boxes of each, cut across the side that is longest."""
    longest = max(boxes, key=lambda a: float((boxes[a].hi - boxes[a].lo).max()))
    middle = boxes[longest].middle
    lower = boxes | {longest: Interval(boxes[longest].lo, middle)}
    upper = boxes | {longest: Interval(middle, boxes[longest].hi)}
    join = np.concatenate
    return {a: Interval(join([lower[a].lo, upper[a].lo]), join([lower[a].hi, upper[a].hi])) for a in boxes}


def _positive(matrices: Interval) -> Flags:
    """By row of a stack, whether all of its matrices are positive definite, proved."""
    rows = zip(matrices.lo, matrices.hi, strict=True)
    return np.array([certainly_positive(Interval(lo, hi)) for lo, hi in rows])


def _bounded(P: Array, rows: Interval, bounds: Array) -> Flags:
    """By box, whether |row z| < bound on z' P z < 1, proved: bound^2 P - row row' is positive definite."""
    rows = rows * enclose(bounds[:, None]).reciprocal()
    outer = Interval(rows.lo[..., :, None], rows.hi[..., :, None]) * Interval(
        rows.lo[..., None, :], rows.hi[..., None, :]
    )
    return _positive(P - outer)


# --- the solver -----------------------------------------------------------------------------------
class _Form(NamedTuple):
    """constant + sum x_k forms_k has to be positive semidefinite."""

    constant: Array
    forms: Array


def solved(cost: Array, forms: Sequence[_Form]) -> Array | None:
    """x of least cost' x for which every form is positive semidefinite, or None where there is none."""
    clarabel = _solver()
    from scipy.sparse import csc_matrix

    rows = [_packed(f.forms).T for f in forms]
    A = csc_matrix(-np.concatenate(rows))
    b = np.concatenate([_packed(f.constant[None])[0] for f in forms])
    cones = [clarabel.PSDTriangleConeT(len(f.constant)) for f in forms]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 80
    settings.max_threads = 1
    none = csc_matrix((len(cost), len(cost)))
    solution = clarabel.DefaultSolver(none, cost, A, b, cones, settings).solve()
    if str(solution.status) not in ("Solved", "AlmostSolved"):
        return None
    return np.array(solution.x)


def _packed(matrices: Array) -> Array:
    """Upper triangles column by column with sqrt 2 off the diagonal, as the solver takes them."""
    n = matrices.shape[-1]
    j, i = np.tril_indices(n)
    return np.asarray(matrices[:, i, j] * np.where(i == j, 1.0, np.sqrt(2)))


def _solver() -> Any:
    try:
        import clarabel
    except ImportError:
        raise UndertowError(
            "searching for V needs a solver of semidefinite programs, which is not installed: "
            "pip install 'undertow[certificates]'"
        ) from None
    return clarabel
