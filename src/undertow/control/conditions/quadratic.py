"""A quadratic V for PD and PID loops, found by a semidefinite program and proved without trusting it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cached_property
from typing import NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array, Flags

from .attitude import Interval, count_of, enclose, plus_minus
from .commands import Commands
from .definite import SETTINGS as PROOFS
from .definite import MatrixBudget, bounded, sums_positive
from .embedding import Boxes, Embedding, corners_of, halved, proved_positive_definite
from .problem import Problem
from .program import SETTINGS, Key, Program, Proposal, SpeedBox, spare_thrust
from .result import Quadratic, merge_headings

_TOO_LONG = "no quadratic V was found within the time that the search may take"


class _Step(NamedTuple):
    """What the program of one box of speeds came to."""

    bounds: SpeedBox
    program: Program
    found: Proposal | None

    @property
    def start(self) -> float:
        """The start's level; infinite where there is no V."""
        return np.inf if self.found is None else self.found.start


class _LevelModel:
    """Tangents of the logarithm of the start's level over the logarithms of speeds.

    Their maximum stands in for the level, which has kinks where other corners become the worst (Kelley 1960,
    The cutting-plane method for solving convex programs). Where it is not convex, steps are only worse.
    """

    def __init__(self) -> None:
        self._steps: list[tuple[_Step, Array]] = []  # the slope, and the value at the origin

    def add(self, step: _Step) -> None:
        """Take what a program came to at some speeds; one that was left early bounds the level, too."""
        if step.found is not None:
            place, slope = np.log(step.bounds.speeds), step.found.slopes / step.start
            self._steps.append((step, np.append(slope, np.log(step.start) - slope @ place)))

    def step(self, best: _Step, radius: float) -> Array | None:
        """The change of each logarithm, up to the radius, that brings the maximum down most; None if hardly.

        Where the level is not convex, tangents from elsewhere cut away what is better: then only those at
        the best speeds count.
        """
        from scipy.optimize import linprog

        for steps in (self._steps, [pair for pair in self._steps if pair[0] is best]):
            rows = np.array([row for _, row in steps])
            place, n = np.log(best.bounds.speeds), len(best.bounds.speeds)
            left = np.column_stack([rows[:, :n], -np.ones(len(rows))])
            cost, limits = np.append(np.zeros(n), 1.0), [(-radius, radius)] * n + [(None, None)]
            found = linprog(cost, left, -(rows[:, n] + rows[:, :n] @ place), bounds=limits)
            change, level = (
                (np.asarray(found.x[:n]), float(found.x[n])) if found.success else (np.zeros(n), np.inf)
            )
            if level <= np.log(best.start) - SETTINGS.least_decrease:
                return change
        return None


class QuadraticSearch:
    """The search for a proved V whose level set holds all errors up to `start` at rest, integrals zero.

    Products of velocities are read in one way, which is quicker, or in every way. An error says that the
    model has no form that the method covers, or that the solver is not installed.
    """

    def __init__(self, problem: Problem, start: Mapping[str, float], all_identities: bool = True) -> None:
        self.problem, self.loop, self.all_identities = problem, Embedding(problem), all_identities
        self.commands = Commands(problem)
        self.inequalities = 0  # what the solver was given so far
        self.budget = MatrixBudget(0)  # what is left for proofs
        self.active_corners: set[Key] = set()  # corners that the programs so far were about
        self.heading_centre = 0.0  # heading in the middle of those of the set-point, rad
        # The box with the radius of its corners in coordinates that the frame mixes.
        self.start = np.array([start.get(c, 0.0) for c in problem.coordinates])
        for group in self.loop.groups:
            self.start[group] = np.sqrt(np.sum(self.start[group] ** 2)) * (1 + 1e-12)

    @property
    def _start_tilts(self) -> dict[str, float]:
        """What is bounded of the start: roll, pitch, and the heading where A depends on it."""
        starts = self._angles(self.with_floor(self.start))
        return {a: self._clipped(a, e) for a, e in starts.items()}

    # --- boxes of speeds --------------------------------------------------------------------------
    def run(self) -> Quadratic | None:
        """The first V that is proved and holds the start, for every range of headings of the set-point."""
        self._require_thrust()
        bounds, proofs = self._first_box(), []
        for heading_centre in self.centres:
            self.heading_centre, self.inequalities = heading_centre, 0
            share = SETTINGS.share(self.loop.size, SETTINGS.matrices_power)
            # Each uncertain parameter is one more sum in every matrix, as each velocity is, and one more that
            # is cut in two where all of them together are too large: in vain, if that takes long.
            sums = 1 + len(self.problem.parameter_box) / self.loop.n
            self.budget = MatrixBudget(int(SETTINGS.max_matrices * share / sums**2))
            self.active_corners.clear()
            proof = self._search_sector(bounds)
            if proof is None:
                return None
            bounds, quadratic = proof
            proofs.append(quadratic)
        return merge_headings(proofs, self.loop.half_turn)

    @property
    def centres(self) -> Array:
        """The middle of each range of set-points' headings; the second half of a turn is as the first."""
        if "psi" not in self.loop.angles:
            return np.zeros(1)
        return (np.arange(SETTINGS.sectors) + 0.5) * np.pi / SETTINGS.sectors

    def _search_sector(self, bounds: SpeedBox) -> tuple[SpeedBox, Quadratic] | None:
        """V is searched for on smaller speeds until there is one, then on those that its start asks for."""
        best: _Step | None = None
        least = SETTINGS.least_speed * bounds.speeds
        slopes, radius = _LevelModel(), SETTINGS.first_step
        for _ in range(SETTINGS.max_speed_boxes):
            program = Program(self, bounds)
            if program.rate <= 0:
                raise UndertowError("the loop at rest is not stable at every attitude")
            step = _Step(bounds, program, program.solve(np.inf if best is None else best.start))
            if step.found is not None and step.start < 1:
                proof = prove(program, step.found, self.budget)
                if proof is not None:
                    return bounds, proof
                if self.budget.remaining <= 0:
                    raise UndertowError(_TOO_LONG)
            if best is None and not 1 <= step.start < np.inf:
                bounds = self._shrunk(bounds)
                if (bounds.speeds < least).all():
                    return None
                continue
            better = best is None or step.start < best.start
            radius *= 1.0 if best is None else SETTINGS.longer if better else SETTINGS.shorter
            slopes.add(step)
            best = step if best is None or better else best
            radius = min(radius, np.log(SETTINGS.max_growth))
            change = None if radius < SETTINGS.least_step else slopes.step(best, radius)
            if change is None:
                return None
            bounds = self._stepped(best, change, radius)
        return None

    def count_inequalities(self, inequalities: int) -> None:
        """Count what the solver is given."""
        self.inequalities += inequalities
        if self.inequalities > SETTINGS.max_lmis * SETTINGS.share(self.loop.size, SETTINGS.lmi_power):
            raise UndertowError(_TOO_LONG)

    def _shrunk(self, bounds: SpeedBox) -> SpeedBox:
        least = self._angles(self.with_floor(self.start) * (1 + SETTINGS.slack))
        tilts = {a: max(SETTINGS.shrink * t, self._clipped(a, least[a])) for a, t in bounds.tilts.items()}
        return SpeedBox(SETTINGS.shrink * bounds.speeds, tilts)

    def _stepped(self, best: _Step, change: Array, radius: float) -> SpeedBox:
        """Speeds changed by these logarithms, and tilts that the start asks for, at most by the radius."""
        assert best.found is not None
        bounds, asked = best.bounds, best.program.required_box(best.found, SETTINGS.growth - 1).tilts
        most = {a: v * float(np.exp(radius)) for a, v in bounds.tilts.items()}
        tilts = {a: self._clipped(a, min(v, most[a])) for a, v in asked.items()}
        return SpeedBox(bounds.speeds * np.exp(change), self._holdable_tilts(tilts))

    def _holdable_tilts(self, tilts: dict[str, float]) -> dict[str, float]:
        """Roll and pitch at which thrusters hold the weight with something left, or those of the start."""
        least = {a: e for a, e in self._start_tilts.items() if a != "psi"}
        while any(tilts[a] > e for a, e in least.items()):
            with suppress(UndertowError):
                spare_thrust(self.problem, self.commands, tilts)
                return tilts
            tilts = tilts | {a: max(SETTINGS.shrink * tilts[a], e) for a, e in least.items()}
        return tilts

    def _require_thrust(self) -> None:
        """Refuse a start at which the law asks for more than a thruster has, on an even keel."""
        if not len(self.commands.limits):
            return
        spare_thrust(self.problem, self.commands, self._start_tilts)  # refuses where nothing is
        level = {a: enclose(np.zeros(1)) for a in self.loop.angles}
        springs = np.abs(self.commands.B_inverse) @ (self.problem.values["K_P"] * self.start)
        rows = self.loop.commands_of(self.commands, level).middle[0]
        own = rows[:, self.loop.size - 2 * self.loop.n : self.loop.size - self.loop.n]
        asked = np.minimum(np.max(np.abs(own) * self.start, axis=1), springs) + self.commands.steady()
        worst = int(np.argmax(asked / self.commands.limits))
        if asked[worst] >= self.commands.limits[worst]:
            raise UndertowError(
                f"the start asks {asked[worst]:.4g} of {self.commands.names[worst]}, whose limit is "
                f"{self.commands.limits[worst]:.4g}: state smaller errors or lower K_P"
            )

    def _first_box(self) -> SpeedBox:
        K_P, K_V = (self.problem.values[g] for g in ("K_P", "K_V"))
        M = np.min([np.diag(signs.inertia) for signs in self.problem.sets], axis=0)
        D = np.min([np.diag(signs.damping) for signs in self.problem.sets], axis=0)
        rate = np.minimum(np.sqrt(K_P / M), K_P / np.maximum(K_V + D, 1e-12))
        speeds = SETTINGS.first_speed * self.with_floor(rate * self.start)
        for group in self.loop.groups:
            speeds[group] = speeds[group].max()
        angles = self._angles(self.with_floor(self.start))
        tilts = {a: self._clipped(a, SETTINGS.tilt_factor * e) for a, e in angles.items()}
        return SpeedBox(speeds, self._holdable_tilts(tilts))

    def _angles(self, values: Array) -> dict[str, float]:
        pairs = zip(self.problem.coordinates, values, strict=True)
        bounded = {"phi", "theta"} | ({"psi"} & set(self.loop.angles))
        return {c: float(v) for c, v in pairs if c in bounded}

    def _clipped(self, name: str, angle: float) -> float:
        return min(angle, np.pi / 2 if name == "psi" else self.problem.attitudes.tilt)

    def with_floor(self, values: Array) -> Array:
        """At least a share of the largest among translations, and among rotations."""
        found = values.copy()
        for kind in (self.loop.translations, self.loop.rotations):
            if kind:
                found[kind] = np.maximum(found[kind], SETTINGS.least_share * found[kind].max())
        if not found.any():
            raise UndertowError("the start box has no error at all: state one, as x=0.5 m")
        return np.maximum(found, SETTINGS.least_of_all * found.max())


# --- the proof --------------------------------------------------------------------------------------
def prove(program: Program, found: Proposal, budget: MatrixBudget) -> Quadratic | None:
    """V with everything that was asked of it proved in interval arithmetic, or None.

    What the start needs of the level set is proved first, with the work that is left for it. Where that
    succeeds, the whole of it is tried, with not much more.
    """
    narrow = Proof(*program.narrowed(found), budget.remaining)
    needed = narrow.result()
    if needed is None:
        budget.remaining -= narrow.matrices_used
        return None
    return Proof(program, found, SETTINGS.full_proof_factor * narrow.matrices_used).result() or needed


class Proof:
    """The proof of one proposal, on the box of speeds and tilts of its program."""

    def __init__(self, program: Program, proposal: Proposal, most: int) -> None:
        self.program, self.loop, self.proposal = program, program.loop, proposal
        self.P = 0.5 * (proposal.P + proposal.P.T)
        # Forms that vanish, by velocity: exactly they are within this.
        around = PROOFS.sum_rounding * np.abs(proposal.free)
        self.free = [Interval(N - e, N + e) for N, e in zip(proposal.free, around, strict=True)]
        self.scale, self.corners = program.scale, program.corners
        self._scale_ratio = self.scale[:, None] / self.scale
        self._max_matrices, self._budget = most, MatrixBudget(most)

    @property
    def matrices_used(self) -> int:
        """How many matrices the last part of the proof looked at, or would have."""
        return self._max_matrices - self._budget.remaining

    def result(self) -> Quadratic | None:
        """The V, or None where something of it is not proved."""
        if not (
            proved_positive_definite(enclose(self.P[None]))
            and all(
                bounded(self.P, enclose(row[None, None]), np.array([b])).all()
                for row, b in self.program.fixed_rows()
            )
        ):
            return None
        weights, start = self._start_weights()
        if not start < 1 or not (self._everywhere(self._within_bounds) and self._everywhere(self._decreases)):
            return None
        program, n, size = self.program, self.loop.n, self.loop.size
        inverse = 1 / self.scale
        own = weights * inverse[size - 2 * n : size - n] ** 2
        return Quadratic(
            P=(self.P * np.outer(inverse, inverse))[None],
            frame=self.loop.frame_name,
            errors=program.reach(self.proposal),
            speeds=program.bounds.speeds,
            starts=1 / np.sqrt(own),
            commands=program.commands.limits - program.spare_thrust + self._command_changes,
            start=start,
        )

    def _start_weights(self) -> tuple[Array, float]:
        """S diagonal with S > P_EE, proved, and a bound on E' S E on the start box, infinite if not."""
        n, size = self.loop.n, self.loop.size
        errors = slice(size - 2 * n, size - n)
        own, first = self.P[errors, errors], [group[0] for group in self.loop.groups]
        squares = (self.program.search.start / self.scale[errors])[first] ** 2
        found = [(weights, float(weights[first] @ squares * (1 + 1e-9))) for weights in self._weights(own)]
        held = [(w, t) for w, t in found if proved_positive_definite(enclose((np.diag(w) - own)[None]))]
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

    def _everywhere(self, holds: Callable[[Boxes], Flags]) -> bool:
        boxes = self.loop.boxes(self.program.ranges)
        self._budget = MatrixBudget(self._max_matrices)
        for _ in range(SETTINGS.halvings * max(len(boxes), 1)):
            unproved = ~holds(boxes)
            if not unproved.any():
                return True
            if not boxes or self._budget.remaining < 0:
                return False
            boxes = halved({a: v[unproved] for a, v in boxes.items()})
            if unproved.all():
                boxes = halved(boxes)
        return False

    def _within_bounds(self, boxes: Boxes) -> Flags:
        """Speeds and commands, at every attitude in each box."""
        self._budget.remaining -= count_of(boxes)
        held = bounded(self.P, self._scaled(self.loop.speeds_of(boxes)), self.program.bounds.speeds)
        if len(self._command_changes):
            commands = self.loop.commands_of(self.program.commands, boxes)
            held &= bounded(self.P, self._scaled(commands), self._command_changes)
        return held

    @cached_property
    def _command_changes(self) -> Array:
        """What is claimed of each command beside that at rest."""
        command_changes = self.program.command_changes(self.proposal) * (1 + SETTINGS.command_slack)
        return np.asarray(np.minimum(command_changes, self.program.spare_thrust))

    def _decreases(self, boxes: Boxes) -> Flags:
        """Whether V falls at every corner of velocities at every attitude in each box.

        A(angles) differs from what its values at the corners of the box interpolate by h^2/8 times the second
        derivative along each side h at most.
        """
        batches = -(-count_of(boxes) * self.corners.cases // SETTINGS.batch)
        found = np.zeros(count_of(boxes), dtype=bool)
        for part in np.array_split(np.arange(len(found)), min(len(found), batches)):
            if self._budget.remaining >= 0:
                found[part] = self._decreases_in({a: v[part] for a, v in boxes.items()})
        return found

    def _decreases_in(self, boxes: Boxes) -> Flags:
        at, place = corners_of(boxes)
        falls = -_plus_transpose(self.P @ self.program.scaled(self.loop.rest(self.corners, at)))
        size = self.loop.size
        rows = (falls[place] + self._interpolation_error(boxes)).reshape(-1, size, size)
        # Attitudes and cases in one row.
        ends = [e.reshape(-1, *e.lo.shape[2:]) for e in self._velocity_terms(at)]
        own = place[..., None] * self.corners.cases + np.arange(self.corners.cases)
        box = np.broadcast_to(np.arange(count_of(boxes))[:, None], own.shape).ravel()
        # Ends are the same at all attitudes, or not.
        return sums_positive(rows, own.ravel() % len(ends[0]), ends, box, self._budget)

    def _interpolation_error(self, boxes: Boxes) -> Interval:
        """What interpolating between the corners of boxes misses, shape (boxes, 1, size, size)."""
        own = np.zeros((count_of(boxes), self.loop.size, self.loop.size))
        free = own.copy()
        for angle, side in boxes.items():
            share = SETTINGS.curvature_room * (side.hi - side.lo)[:, None, None] ** 2 / 8
            own += share * self.loop.curvature(self.corners, boxes, angle) * self.scale / self.scale[:, None]
            turn = self.loop.body_jet(boxes, angle) * self._scale_ratio
            for N, value in zip(self.free, self.program.values, strict=True):
                free += share * np.abs(value).max() * (turn @ N @ turn.T).curvature.magnitude[:, 0]
        return (_plus_transpose(self.P @ plus_minus(own)) + plus_minus(free))[:, None]

    def _velocity_terms(self, at: Boxes) -> Iterator[Interval]:
        """What each velocity and parameter adds to the fall of V, (attitudes, cases, ends, size, size)."""
        turn = self.loop.body(at) * self._scale_ratio
        added = self.loop.added(self.corners, at)
        for end, N, value in zip(added, self.free, self.program.values, strict=False):
            turned = turn @ N @ turn.T
            every = turned[:, :, None] * value[..., None, None]
            yield -(_plus_transpose(self.P @ self.program.scaled(end)) + every)
        yield from (-_plus_transpose(self.P @ self.program.scaled(end)) for end in added[self.loop.n :])

    def _scaled(self, rows: Interval) -> Interval:
        return Interval(rows.lo * self.scale, rows.hi * self.scale)


def _plus_transpose(held: Interval) -> Interval:
    return held + held.T
