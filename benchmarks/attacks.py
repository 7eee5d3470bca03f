"""Attacks on certified PID loops: an evolution looks for what breaks the claim."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import differential_evolution

from undertow.control.closed_loop.scenario import Scenario
from undertow.control.closed_loop.simulate import ClosedLoop
from undertow.control.conditions.attitude import Attitudes, Interval, enclose
from undertow.control.conditions.result import Quadratic, Report, Transient
from undertow.control.gains import GainSet

Array = np.ndarray
TURNS = ("phi", "theta", "psi")


@dataclass(frozen=True)
class Attack:
    """What an evolution looks through."""

    generations: int = 5
    many: int = 16  # tries in a generation
    headings: int = 4  # of the set-point, spread over a turn
    level: float = 0.98  # of V at the start; the claim ends at one
    left: float = 0.05  # part of the largest certified error that may be left at the end
    alive: float = 1e-3  # part of its first value above which V has to fall
    moved: float = 0.1  # part of its first value that a bound in time has to have moved by to count
    lag: float = 0.02  # part of the run after which V has to be lower
    step: float = 0.02  # s, of the simulations
    # Whether the law acts without sampling, as certificates have it; what seems broken is attacked anew so.
    continuous: bool = False


class Target:
    """A certified loop, its claims, and how far a try comes towards breaking one."""

    def __init__(self, gains: GainSet, report: Report, duration: float, settles: bool, how: Attack) -> None:
        self.gains, self.how, self.duration, self.settles = gains, how, duration, settles
        self.report = report
        vehicle = gains.plant.vehicle
        self.names, self.velocities = vehicle.pose_names, vehicle.velocity_names
        self.span = self._claimed()
        self.commands = {c.name: c.largest for c in report.region.commands}
        self.limited = [c for c in report.region.commands if np.isfinite(c.limit)]
        self.loop = ClosedLoop(gains)
        self.shifts = [i for i, d in enumerate(vehicle.dof_indices) if d < 3]

    def _claimed(self) -> Array:
        """The largest errors and speeds that are claimed."""
        found = self.report.region.quadratic
        assert found is not None
        self.quadratic: Quadratic = found
        return np.concatenate([found.errors, found.speeds])

    def worst(self, rng: np.random.Generator) -> float:
        """The largest share of a claim that an evolution reaches: above one it is broken."""
        size = 2 * len(self.names) + 1 + len(self.limited) + len(self.report.region.parameters)
        first = rng.uniform(-1, 1, (self.how.many, size))
        found = differential_evolution(
            lambda tries: -self.shares(tries.T), [(-1.0, 1.0)] * size, init=first, rng=rng, tol=0.0,
            maxiter=self.how.generations - 1, polish=False, vectorized=True, updating="deferred",
        )  # fmt: skip
        worst = float(-found.fun)
        if worst <= 1 or self.how.continuous:
            return worst
        # A held command acts half a step late, and the law's integral, summed in steps, is off by up to half
        # a step of the error: bounds that are nearly reached are exceeded then, and V has a floor.
        exact = replace(self.how, continuous=True)
        return type(self)(self.gains, self.report, self.duration, self.settles, exact).worst(rng)

    def shares(self, tries: Array) -> Array:
        """How far each try comes: start's direction, heading, limits and parameters are in (-1, 1)."""
        directions, turns, *rest = np.split(tries, self._ends, axis=1)
        found, count = np.zeros(len(tries)), self.how.headings
        turn = np.floor(0.5 * (turns[:, 0] + 1) * count * (1 - 1e-12))
        for t in np.unique(turn):
            own, heading = turn == t, float(t) * 2 * np.pi / count + 0.3
            found[own] = self._at(heading, directions[own], *(part[own] for part in rest))
        return found

    @property
    def _ends(self) -> Array:
        """Where the numbers of a try change their meaning."""
        return np.cumsum([2 * len(self.names), 1, len(self.limited)])

    def _at(self, heading: float, directions: Array, limits: Array, off: Array) -> Array:
        place = np.array([heading if c == "psi" else 0.0 for c in self.names])
        states = self._begun(place, directions)
        n = len(self.names)
        first = np.concatenate([place - states[:, :n], states[:, n:]], axis=1)
        spans = self.report.region.parameters.items()
        runs = self.loop.run_many(
            Scenario(tuple(place), self.duration, self.how.step, continuous=self.how.continuous),
            starts=dict(zip((*self.names, *self.velocities), first.T, strict=True)),
            gains={
                f"limit_{c.name}": c.largest + np.clip(0.5 + s, 0, 1) * (c.limit - c.largest)
                for c, s in zip(self.limited, limits.T, strict=True)
            },
            parameters={
                name: 0.5 * (low + high) + 0.5 * (high - low) * o
                for (name, (low, high)), o in zip(spans, np.clip(2 * off, -1, 1).T, strict=True)
            },
        )
        seen = np.concatenate([place - runs.states[..., :n], runs.states[..., n : 2 * n]], axis=-1)
        commands = [np.abs(runs.command(c)) for c in self.commands]
        found = self._used(runs.t, seen, np.array(commands).reshape(-1, *seen.shape[:2]))
        if self.settles:
            found.append(np.abs(seen[:, -1, :n]).max(axis=1) / (self.how.left * self.span[:n].max()))
        found += self._slowest_fall(runs.t, seen, place)
        return np.nan_to_num(np.max(found, axis=0), nan=np.inf)

    def _begun(self, place: Array, directions: Array) -> Array:
        """States scaled onto the level; the frame of V turns with the attitude, so that it takes turns."""
        states = directions * self.span
        for _ in range(5):
            heights = self.value(states[:, None], 0 * states[:, None, : len(place)], place)[:, 0]
            states = states * np.sqrt(self.how.level / np.maximum(heights, 1e-12))[:, None]
        return states

    def _used(self, t: Array, seen: Array, commands: Array) -> list[Array]:
        """By run, the largest share of what is claimed of states and of commands (commands, runs, rows)."""
        pairs = zip(commands, self.commands.values(), strict=True)
        return [np.abs(seen / self.span).max(axis=(1, 2)), *(c.max(axis=-1) / most for c, most in pairs)]

    def _slowest_fall(self, t: Array, seen: Array, place: Array) -> list[Array]:
        """By run, the largest ratio of V a while later to V."""
        error = seen[..., : len(place)]
        steps = 0.5 * (error[:, 1:] + error[:, :-1]) * np.diff(t)[:, None]
        integral = np.concatenate([0 * error[:, :1], np.cumsum(steps, axis=1)], axis=1)
        heights = self.value(seen, integral, place)
        later = max(1, round(self.how.lag * len(t)))
        before, after = heights[:, :-later], heights[:, later:]
        living = before > self.how.alive * heights[:, :1]
        return [np.where(living, after / np.maximum(before, 1e-300), 0.0).max(axis=1)]

    @cached_property
    def _attitudes(self) -> Attitudes:
        return Attitudes(self.gains.plant, np.pi / 3)

    def value(self, states: Array, integral: Array, place: Array) -> Array:
        """V of errors and velocities (runs, rows, 2 n), with integrals of the errors (runs, rows, n)."""
        n, shape = len(place), states.shape[:2]
        pose = (place - states[..., :n]).reshape(-1, n)
        angles = {c: enclose(pose[:, i]) for i, c in enumerate(self.names) if c in TURNS}
        R, G = self._turns(angles, len(pose)), np.tile(np.eye(n), (len(pose), 1, 1))
        if self.quadratic.frame == "body":
            G = R
        error, nu = states[..., :n].reshape(-1, n), states[..., n:].reshape(-1, n)
        parts = [integral.reshape(-1, n), error, np.einsum("kij,kj->ki", R, nu)]
        z = np.concatenate([np.einsum("kji,kj->ki", G, part) for part in parts], axis=1)
        P = self.quadratic.at(float(place[self.names.index("psi")]) if "psi" in self.names else 0.0)
        z = z[:, -P.shape[-1] :]
        return np.asarray(np.einsum("ki,ij,kj->k", z, P, z)).reshape(shape)

    def _turns(self, angles: dict[str, Interval], count: int) -> Array:
        """The rotation of the translations, and nothing of the rotations."""
        J = np.broadcast_to(self._attitudes.forward(angles).middle, (count, len(self.names), len(self.names)))
        found, own = (
            np.tile(np.eye(len(self.names)), (count, 1, 1)),
            np.ix_(range(count), self.shifts, self.shifts),
        )
        found[own] = J[own]
        return found


class BoxTarget(Target):
    """A loop with bounds in time: starts at rest in a box, and every bound at the time that it is for."""

    def _claimed(self) -> Array:
        found = self.report.region.transient
        assert found is not None
        self.transient: Transient = found
        return np.concatenate([found.errors.max(axis=0), found.speeds.max(axis=0)])

    def _begun(self, place: Array, directions: Array) -> Array:
        """Starts in the box, most of them near a corner of it."""
        box = np.array([self.report.region.starts[c] for c in self.names])
        errors = np.clip(2 * directions[:, : len(box)], -1, 1) * box
        return np.concatenate([errors, 0 * errors], axis=1)

    def _used(self, t: Array, seen: Array, commands: Array) -> list[Array]:
        found = self.transient
        piece = np.maximum(np.searchsorted(found.times, t, "right") - 1, 0)
        both = np.concatenate([found.errors, found.speeds], axis=1)
        most = np.maximum(both, self.how.alive * both.max(axis=0))[piece]
        share = np.abs(seen / most)
        # Errors begin at their bounds: within them they say nothing until these have moved.
        still = np.abs(most - both[0]) < self.how.moved * both[0]
        used = [np.where((share <= 1) & still, 0.0, share).max(axis=(1, 2))]
        floor = self.how.alive * found.commands.max(
            axis=0
        )  # rounding of simulations is below it, as of states
        largest = np.maximum(found.commands, floor)[piece].T[:, None]
        return [*used, *(c.max(axis=-1) for c in commands / largest)]

    def _slowest_fall(self, t: Array, seen: Array, place: Array) -> list[Array]:
        """Nothing has to fall."""
        return []


def target_of(gains: GainSet, report: Report, duration: float, settles: bool, how: Attack) -> Target | None:
    """What there is to attack of a certified loop, or None."""
    region = report.region
    kind = Target if region.quadratic is not None else BoxTarget if region.transient is not None else None
    return kind and kind(gains, report, duration, settles, how)
