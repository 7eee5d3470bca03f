"""A quadratic V for PD and PID loops, found by a semidefinite program and proved without trusting it."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .attitude import enclose
from .commands import Commands
from .definite import Work
from .embedding import Embedding
from .problem import Problem
from .program import SETTINGS, Bounds, Key, Program, Proposal, thrust_left
from .proof import proved
from .result import Quadratic, together

_TOO_LONG = "no quadratic V was found within the time that the search may take"


class _Step(NamedTuple):
    """What the program of one box of speeds came to."""

    bounds: Bounds
    program: Program
    found: Proposal | None

    @property
    def start(self) -> float:
        """The start's level; infinite where there is no V."""
        return np.inf if self.found is None else self.found.start


class _Slopes:
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
        for steps in (self._steps, [pair for pair in self._steps if pair[0] is best]):
            change, level = _lowest(np.array([row for _, row in steps]), best, radius)
            if level <= np.log(best.start) - SETTINGS.least_fall:
                return change
        return None


def _lowest(rows: Array, best: _Step, radius: float) -> tuple[Array, float]:
    from scipy.optimize import linprog

    place, n = np.log(best.bounds.speeds), len(best.bounds.speeds)
    left = np.column_stack([rows[:, :n], -np.ones(len(rows))])
    cost, limits = np.append(np.zeros(n), 1.0), [(-radius, radius)] * n + [(None, None)]
    found = linprog(cost, left, -(rows[:, n] + rows[:, :n] @ place), bounds=limits)
    return (np.asarray(found.x[:n]), float(found.x[n])) if found.success else (np.zeros(n), np.inf)


class Search:
    """The search for a proved V whose level set holds all errors up to `start` at rest, integrals zero.

    Products of velocities are read in one way, which is quicker, or in every way. An error says that the
    model has no form that the method covers, or that the solver is not installed.
    """

    def __init__(self, problem: Problem, start: Mapping[str, float], every_reading: bool = True) -> None:
        self.problem, self.loop, self.every_reading = problem, Embedding(problem), every_reading
        self.commands = Commands(problem)
        self.forms = 0  # what the solver was given so far
        self.work = Work(0)  # what is left for proofs
        self.chosen: set[Key] = set()  # corners that the programs so far were about
        self.centre = 0.0  # heading in the middle of those of the set-point, rad
        self.start = self._mixed(np.array([start.get(c, 0.0) for c in problem.coordinates]))

    def _mixed(self, start: Array) -> Array:
        """The box with the radius of its corners in coordinates that the frame mixes."""
        found = start.copy()
        for group in self.loop.groups:
            found[group] = np.sqrt(np.sum(start[group] ** 2)) * (1 + 1e-12)
        return found

    @property
    def _start_tilts(self) -> dict[str, float]:
        """What is bounded of the start: roll, pitch, and the heading where A depends on it."""
        starts = self._tilted(self.filled(self.start))
        return {a: self._tilt(a, e) for a, e in starts.items()}

    # --- boxes of speeds --------------------------------------------------------------------------
    def found(self) -> Quadratic | None:
        """The first V that is proved and holds the start, for every range of headings of the set-point."""
        self._require_thrust()
        bounds, proofs = self._first(), []
        for centre in self.centres:
            self.centre, self.forms = centre, 0
            self.work = Work(int(SETTINGS.most * min(12 / self.loop.size, 1.0) ** SETTINGS.work_power))
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
        best: _Step | None = None
        least = SETTINGS.least_speed * bounds.speeds
        slopes, radius = _Slopes(), SETTINGS.first_step
        for _ in range(SETTINGS.tries):
            program = Program(self, bounds)
            if program.rate <= 0:
                raise UndertowError("the loop at rest is not stable at every attitude")
            step = _Step(bounds, program, program.solve(np.inf if best is None else best.start))
            if step.found is not None and step.start < 1:
                proof = proved(program, step.found, self.work)
                if proof is not None:
                    return bounds, proof
                if self.work.left <= 0:
                    raise UndertowError(_TOO_LONG)
            if best is None and not 1 <= step.start < np.inf:
                bounds = self._smaller(bounds)
                if (bounds.speeds < least).all():
                    return None
                continue
            better = best is None or step.start < best.start
            radius *= 1.0 if best is None else 1.5 if better else 0.5
            slopes.add(step)
            best = step if best is None or better else best
            radius = min(radius, np.log(SETTINGS.most_more))
            change = None if radius < SETTINGS.least_step else slopes.step(best, radius)
            if change is None:
                return None
            bounds = self._moved(best, change, radius)
        return None

    def spend(self, forms: int) -> None:
        """Count what the solver is given."""
        self.forms += forms
        if self.forms > SETTINGS.most_forms:
            raise UndertowError(_TOO_LONG)

    def _smaller(self, bounds: Bounds) -> Bounds:
        least = self._tilted(self.filled(self.start) * (1 + SETTINGS.slack))
        tilts = {a: max(SETTINGS.smaller * t, self._tilt(a, least[a])) for a, t in bounds.tilts.items()}
        return Bounds(SETTINGS.smaller * bounds.speeds, tilts)

    def _moved(self, best: _Step, change: Array, radius: float) -> Bounds:
        """Speeds changed by these logarithms, and tilts that the start asks for, at most by the radius."""
        assert best.found is not None
        bounds, asked = best.bounds, best.program.asked(best.found, SETTINGS.more - 1).tilts
        most = {a: v * float(np.exp(radius)) for a, v in bounds.tilts.items()}
        tilts = {a: self._tilt(a, min(v, most[a])) for a, v in asked.items()}
        return Bounds(bounds.speeds * np.exp(change), self._held(tilts))

    def _held(self, tilts: dict[str, float]) -> dict[str, float]:
        """Roll and pitch at which thrusters hold the weight with something left, or those of the start."""
        least = {a: e for a, e in self._start_tilts.items() if a != "psi"}
        while any(tilts[a] > e for a, e in least.items()):
            with suppress(UndertowError):
                thrust_left(self.problem, self.commands, tilts)
                return tilts
            tilts = tilts | {a: max(SETTINGS.smaller * tilts[a], e) for a, e in least.items()}
        return tilts

    def _require_thrust(self) -> None:
        """Refuse a start at which the law asks for more than a thruster has, on an even keel."""
        if not len(self.commands.limits):
            return
        thrust_left(self.problem, self.commands, self._start_tilts)  # refuses where nothing is
        level = {a: enclose(np.zeros(1)) for a in self.loop.angles}
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
        return Bounds(speeds, self._held(tilts))

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
