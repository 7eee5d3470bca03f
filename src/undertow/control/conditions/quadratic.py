"""A quadratic V for PD and PID loops, found by a semidefinite program and proved without trusting it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .commands import Commands
from .embedding import Embedding, point
from .problem import Problem
from .program import SETTINGS, Bounds, Key, Program, Proposal, thrust_left
from .proof import proved
from .result import Quadratic, together


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


def search(problem: Problem, start: Mapping[str, float]) -> Quadratic | None:
    """A proved V whose level set holds every error up to `start` at rest, integrals at zero; None if none.

    Products of velocities are read in one way first: where that does, it is several times as quick. Last
    comes a full P where the heading alone couples the axes at rest: gains tell north from east.

    Raises
    ------
    UndertowError
        If the solver is not installed, or the model has no form that the method covers.
    """
    with suppress(UndertowError):
        if (found := Search(problem, start, every_reading=False).found()) is not None:
            return found
    last = Search(problem, start)
    if "psi" in last.loop.angles and problem.decoupled and last.loop.n <= SETTINGS.most_full:
        with suppress(UndertowError):
            if (found := last.found()) is not None:
                return found
        last = Search(problem, start, coupled=True)
    return last.found()


class Search:
    """The search for one start box.

    every_reading: whether products of velocities may be read in every way (`identities`).
    coupled: whether P may couple axes that are coupled by motion and heading alone.
    """

    def __init__(
        self,
        problem: Problem,
        start: Mapping[str, float],
        *,
        every_reading: bool = True,
        coupled: bool = False,
    ) -> None:
        self.problem, self.loop = problem, Embedding(problem)
        self.every_reading, self.coupled = every_reading, coupled
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
        least = SETTINGS.least_speed * bounds.speeds
        slopes, radius = _Slopes(), SETTINGS.first_step
        for _ in range(SETTINGS.tries):
            program = Program(self, bounds)
            if program.rate <= 0:
                raise UndertowError("the loop at rest is not stable at every attitude")
            proposal = program.solve(np.inf if best is None else best[2].start)
            if proposal is not None and proposal.start < 1:
                proof = proved(program, proposal)
                if proof is not None:
                    return bounds, proof
            if best is None and (proposal is None or proposal.start < 1):
                bounds = self._smaller(bounds)
                if (bounds.speeds < least).all():
                    return None
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
            bounds = self._moved(*best, step, radius)
        return None

    def spend(self, forms: int) -> None:
        """Count what the solver is given."""
        self.forms += forms
        if self.forms > SETTINGS.most_forms:
            raise UndertowError("no quadratic V was found within the time that the search may take")

    def _smaller(self, bounds: Bounds) -> Bounds:
        least = self._tilted(self.filled(self.start) * (1 + SETTINGS.slack))
        tilts = {a: max(SETTINGS.smaller * t, self._tilt(a, least[a])) for a, t in bounds.tilts.items()}
        return Bounds(SETTINGS.smaller * bounds.speeds, tilts)

    def _moved(
        self, bounds: Bounds, program: Program, proposal: Proposal, step: Array, radius: float
    ) -> Bounds:
        """Speeds changed by these logarithms, and tilts that the start asks for, at most by the radius."""
        reach = program.reach(proposal) * np.sqrt(proposal.start) * SETTINGS.more
        most = {a: v * float(np.exp(radius)) for a, v in bounds.tilts.items()}
        tilts = {a: self._tilt(a, min(v, most[a])) for a, v in self._tilted(reach).items()}
        return Bounds(bounds.speeds * np.exp(step), tilts)

    def _require_thrust(self) -> None:
        """Refuse a start at which the law asks for more than a thruster has, on an even keel."""
        if not len(self.commands.limits):
            return
        tilts = {a: self._tilt(a, e) for a, e in self._tilted(self.filled(self.start)).items()}
        thrust_left(self.problem, self.commands, tilts)  # refuses where nothing is
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
        speeds = SETTINGS.first_speed * self.filled(rate * self.start)
        for group in self.loop.groups:
            speeds[group] = speeds[group].max()
        angles = self._tilted(self.filled(self.start))
        tilts = {a: self._tilt(a, SETTINGS.tilt * e) for a, e in angles.items()}
        return Bounds(speeds, tilts)

    def _tilted(self, values: Array) -> dict[str, float]:
        pairs = zip(self.problem.coordinates, values, strict=True)
        bounded = {"phi", "theta"} | ({"psi"} & set(self.loop.angles))
        return {c: float(v) for c, v in pairs if c in bounded}

    def _tilt(self, name: str, angle: float) -> float:
        return min(angle, np.pi / 2 if name == "psi" else self.problem.attitudes.tilt)

    def filled(self, values: Array) -> Array:
        """At least a share of the largest among translations, and among rotations."""
        found = values.copy()
        for kind in (self.loop.shifts, self.loop.turns):
            if kind:
                found[kind] = np.maximum(found[kind], SETTINGS.least_share * found[kind].max())
        if not found.any():
            raise UndertowError("the start box has no error at all: state one, as x=0.5 m")
        return np.maximum(found, 1e-3 * found.max())
