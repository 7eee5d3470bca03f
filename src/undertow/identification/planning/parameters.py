"""The manoeuvre that best determines parameters (D-optimality), by random search and refinement."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from undertow.errors import UndertowError
from undertow.files import json_ready
from undertow.identification.doctor.examine import refuse_impossible
from undertow.identification.estimation.fitted import undetermined
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.weak_form import free_parameters
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array
from undertow.version import __version__

from .manoeuvres import Design
from .problem import (
    Knowledge,
    Manoeuvre,
    PlanningProblem,
    PlanRequest,
    Plant,
    depth_spread,
    gram_along,
    knowledge,
    log_determinant,
    remarks_on,
)
from .result import Plan, commands_of, extremes_of, noise_of, parameters_of, safety_remarks


@dataclass(frozen=True)
class Planned:
    """A plan with its manoeuvre."""

    plan: Plan  # what is written to JSON
    manoeuvre: Manoeuvre  # commands and predicted motions


@dataclass(frozen=True)
class SearchSettings:
    """How manoeuvres are searched."""

    exploring: float = 0.45  # share of the tries that are random
    short_list: int = 3  # families whose best manoeuvre is refined
    # Size of a change at the beginning and at the end of a refinement, numbers being between 0 and 1.
    first_change: float = 0.35
    last_change: float = 0.04
    # Some changes give a number any value at all, so that a sign or an order of levels can turn.
    anew: float = 0.25


SETTINGS = SearchSettings()


class PlanSearch(ABC):
    """Random search for the best manoeuvre, and refinement; the same seed finds the same manoeuvre.

    `plant` and `known` are the model by which the spread of the depth is predicted.
    """

    def __init__(self, problem: PlanningProblem, plant: Plant, known: Knowledge, tries: int) -> None:
        self.problem, self.plant, self.known, self._tries = problem, plant, known, tries
        self.value = -np.inf
        # Highest value by name of the family; -inf where no manoeuvre of it was safe.
        self.by_family: dict[str, float] = {}
        self._best: tuple[Design, Manoeuvre] | None = None
        self._gentlest: Manoeuvre | None = None
        self._leaders: dict[str, tuple[float, Design]] = {}
        self._count = 0
        self._rng = np.random.default_rng(problem.request.seed)

    @abstractmethod
    def worth(self, manoeuvre: Manoeuvre) -> float:
        """What a safe manoeuvre is worth; -inf where that cannot be computed."""

    @abstractmethod
    def outcome(self, manoeuvre: Manoeuvre) -> dict[str, Any]:
        """Fields of the plan that depend on its goal, for the best manoeuvre."""

    def planned(self) -> Planned:
        """Search, and describe what was found."""
        self._search()
        if self._best is None:
            self.problem.refuse_unsafe(self._gentlest)
        assert self._best is not None
        (design, manoeuvre), problem, request = self._best, self.problem, self.problem.request
        spread = depth_spread(problem, self.plant, self.known, manoeuvre)
        outcome = self.outcome(manoeuvre)
        outcome["remarks"] += safety_remarks(problem, manoeuvre, spread)
        plan = Plan(
            undertow=__version__,
            vehicle=problem.vehicle.name,
            signs=problem.vehicle.signs,
            seed=request.seed,
            tries=self._count,
            duration=request.duration,
            rate=request.rate,
            manoeuvre=design.family.name,
            commands=commands_of(problem, manoeuvre),
            noise=noise_of(problem),
            extremes=extremes_of(problem, manoeuvre),
            limits=json_ready(request.motion.as_dict()),
            depth_spread=spread,
            logs=[r.name for r in problem.runs],
            **outcome,
        )
        return Planned(plan, manoeuvre)

    def _search(self) -> None:
        families = self.problem.families
        if not families:
            return
        exploring = max(round(SETTINGS.exploring * self._tries), len(families))
        for i in range(exploring):
            family = families[i % len(families)]
            self._try(Design(family, self._rng.random(family.size)), "searching for a manoeuvre")
        leaders = sorted(self._leaders.values(), key=lambda pair: -pair[0])[: SETTINGS.short_list]
        # A quarter of what is left for the leader, an eighth for the next; then all the rest for the best.
        for rank, (value, design) in enumerate(leaders):
            self._refine(design, value, (self._tries - exploring) // 2 ** (rank + 2), SETTINGS.first_change)
        if self._best is not None:
            rest = self._tries - self._count
            self._refine(self._best[0], self.value, rest, SETTINGS.first_change / 3)

    def _try(self, design: Design, words: str) -> float:
        value = self._judged(design)
        self._count += 1
        self.problem.request.report(min(self._count / max(self._tries, 1), 1.0), words)
        name = design.family.name
        self.by_family[name] = max(value, self.by_family.get(name, -np.inf))
        if np.isfinite(value) and value > self._leaders.get(name, (-np.inf,))[0]:
            self._leaders[name] = (value, design)
        return value

    def _judged(self, design: Design) -> float:
        manoeuvre = self.problem.simulated(design)
        if not manoeuvre.safe:
            if self._gentlest is None or manoeuvre.strain < self._gentlest.strain:
                self._gentlest = manoeuvre
            return -np.inf
        value = self.worth(manoeuvre)
        if value > self.value:
            self.value, self._best = value, (design, manoeuvre)
        return value

    def _refine(self, design: Design, value: float, tries: int, first: float) -> None:
        """Change a few numbers at a time, less and less, and keep what is better."""
        for i in range(tries):
            size = first * (SETTINGS.last_change / first) ** (i / max(tries - 1, 1))
            changed = Design(design.family, self._changed(design.numbers, size))
            got = self._try(changed, f"refining {design.family.name}")
            if got > value:
                design, value = changed, got

    def _changed(self, numbers: Array, size: float) -> Array:
        rng = self._rng
        chosen = rng.random(len(numbers)) < max(2.0 / len(numbers), 0.1)
        chosen[rng.integers(len(numbers))] = True
        moved = numbers + size * rng.standard_normal(len(numbers))
        moved = np.abs(1.0 - np.abs(1.0 - moved))
        anew = rng.random(len(numbers)) < SETTINGS.anew * size / SETTINGS.first_change
        moved = np.where(anew, rng.random(len(numbers)), moved)
        return np.clip(np.where(chosen, moved, numbers), 0.0, 1.0)


def plan_parameters(
    vehicle: Vehicle,
    runs: Sequence[Run] = (),
    request: PlanRequest | None = None,
    only: Sequence[str] = (),
    *,
    trust_log: bool = False,
) -> Planned:
    """Find the manoeuvre after which the parameters are known best.

    The criterion is the determinant of the information on them (D-optimality; Atkinson, Donev and Tobias,
    Optimum Experimental Designs): that of the weak form of the simulated log, as `fit_weak` sees it, together
    with stated priors and the logs. `only` names the parameters that matter, by default all that are marked
    `estimate`; the others are still estimated.
    """
    refuse_impossible(vehicle, runs, trust_log=trust_log)
    request = request or PlanRequest()
    free = free_parameters(vehicle)
    _refuse(vehicle, free, only)
    known = knowledge(vehicle, free, runs)
    plant = Plant.of(known.vehicle, compiled=request.compiled)
    problem = PlanningProblem(request, vehicle, [plant], runs)
    wanted = [free.index(n) for n in only] if only else list(range(len(free)))
    return _ParameterSearch(problem, plant, known, wanted).planned()


def _refuse(vehicle: Vehicle, free: Sequence[str], only: Sequence[str]) -> None:
    if not free:
        raise UndertowError(
            f"no parameter of '{vehicle.name}' is to be estimated: write, for instance, "
            "X_u = { value = ..., estimate = true }"
        )
    for name in only:
        if name not in free:
            raise UndertowError(
                f"'{name}' is not to be estimated in '{vehicle.name}': there are {', '.join(free)}"
            )


class _ParameterSearch(PlanSearch):
    """Worth is the mean factor by which standard errors of the wanted parameters fall, as a logarithm."""

    def __init__(self, problem: PlanningProblem, plant: Plant, known: Knowledge, wanted: list[int]) -> None:
        columns = len(known.free) + 2 * len(problem.vehicle.dof_indices)
        super().__init__(problem, plant, known, problem.tries(columns))
        self._wanted, self._model = wanted, WeakModel(plant.functions, known.free)
        self._now = log_determinant(known.now, wanted)
        self._pooled = np.zeros_like(known.now)

    def _gram(self, manoeuvre: Manoeuvre) -> Array | None:
        return gram_along(self._model, self.problem.data(manoeuvre, 0), self.plant.p)

    def worth(self, manoeuvre: Manoeuvre) -> float:
        gram = self._gram(manoeuvre)
        if gram is None:
            return -np.inf
        self._pooled = self._pooled + gram
        after = log_determinant(self.known.after(gram), self._wanted)
        return (after - self._now) / (2 * len(self._wanted))

    def outcome(self, manoeuvre: Manoeuvre) -> dict[str, Any]:
        gram, known, problem = self._gram(manoeuvre), self.known, self.problem
        assert gram is not None
        lost = undetermined(self._pooled, known.free)
        return {
            "goal": "parameters",
            "criterion": float(np.exp(self.value)),
            "families": json_ready(
                {n: float(np.exp(v)) if np.isfinite(v) else v for n, v in self.by_family.items()}
            ),
            "parameters": parameters_of(known, problem.vehicle.signs, known.after(gram), lost),
            "undetermined": lost,
            "rivals": [],
            "separations": [],
            "remarks": remarks_on(known, problem.runs),
        }
