"""The manoeuvre that best determines parameters (D-optimality), by random search and refinement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.doctor.examine import refuse_impossible
from undertow.identification.estimation.fitted import undetermined
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.weak_form import free_parameters
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress
from undertow.version import __version__

from .flight import (
    Flight,
    Ground,
    Knowledge,
    Plant,
    Request,
    depth_spread,
    gram_along,
    knowledge,
    log_determinant,
    remarks_on,
)
from .manoeuvres import Design, Family
from .result import Plan, channels_of, commands_of, extremes_of, finite, safety_remarks, table_of

Judge = Callable[[Design], float]
# Share of the tries spent on looking around.
_EXPLORING = 0.45
_SHORT_LIST = 3
# Size of a change at the beginning and at the end of the refinement, numbers being between 0 and 1.
_CHANGES = (0.35, 0.04)
# Some changes give a number any value at all, so that a sign or an order of levels can turn.
_ANEW = 0.25


@dataclass
class Search:
    """The outcome of a search.

    Attributes
    ----------
    best : Design
        The manoeuvre with the highest value, or None if no manoeuvre has one.
    value : float
        Its value.
    by_family : dict
        Highest value by name of the family; -inf where no manoeuvre of it was safe.
    tries : int
        Manoeuvres looked at.
    """

    best: Design | None = None
    value: float = -np.inf
    by_family: dict[str, float] = field(default_factory=dict)
    tries: int = 0


def search(
    families: Sequence[Family],
    judge: Judge,
    tries: int,
    seed: int,
    report: Progress = lambda done, words: None,
) -> Search:
    """Find a manoeuvre of high value.

    Parameters
    ----------
    families : sequence of Family
        Where to look.
    judge : callable
        Value of a manoeuvre; -inf for one that is not allowed.
    tries : int
        How many manoeuvres are judged.
    seed : int
        Of the random numbers: the same seed finds the same manoeuvre.
    report : callable
        Told what share is done, and what is being done.
    """
    return _Searching(judge, tries, np.random.default_rng(seed), report).over(families)


class _Searching:
    def __init__(self, judge: Judge, tries: int, rng: np.random.Generator, report: Progress) -> None:
        self._judge, self._tries, self._rng, self._report = judge, tries, rng, report
        self.found = Search()
        self._leaders: dict[str, tuple[float, Design]] = {}

    def over(self, families: Sequence[Family]) -> Search:
        if not families:
            return self.found
        exploring = max(round(_EXPLORING * self._tries), len(families))
        for i in range(exploring):
            family = families[i % len(families)]
            self._try(Design(family, self._rng.random(family.size)), "looking for a manoeuvre")
        leaders = sorted(self._leaders.values(), key=lambda pair: -pair[0])[:_SHORT_LIST]
        # A quarter of what is left for the leader, an eighth for the next; then all the rest for the best.
        for rank, (value, design) in enumerate(leaders):
            self._refine(design, value, (self._tries - exploring) // 2 ** (rank + 2))
        if self.found.best is not None:
            self._refine(self.found.best, self.found.value, self._tries - self.found.tries, late=True)
        return self.found

    def _try(self, design: Design, words: str) -> float:
        value = self._judge(design)
        found = self.found
        found.tries += 1
        self._report(min(found.tries / max(self._tries, 1), 1.0), words)
        name = design.family.name
        found.by_family[name] = max(value, found.by_family.get(name, -np.inf))
        if value > found.value:
            found.best, found.value = design, value
        if np.isfinite(value) and value > self._leaders.get(name, (-np.inf,))[0]:
            self._leaders[name] = (value, design)
        return value

    def _refine(self, design: Design, value: float, tries: int, late: bool = False) -> None:
        """Change a few numbers at a time, less and less, and keep what is better."""
        first, last = _CHANGES if not late else (_CHANGES[0] / 3, _CHANGES[1])
        for i in range(tries):
            size = first * (last / first) ** (i / max(tries - 1, 1))
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
        anew = rng.random(len(numbers)) < _ANEW * size / _CHANGES[0]
        moved = np.where(anew, rng.random(len(numbers)), moved)
        return np.clip(np.where(chosen, moved, numbers), 0.0, 1.0)


@dataclass(frozen=True)
class Planned:
    """A plan with its flight.

    Attributes
    ----------
    plan : Plan
        What is written to JSON.
    flight : Flight
        Commands and predicted motions.
    """

    plan: Plan
    flight: Flight


def plan_parameters(
    vehicle: Vehicle,
    runs: Sequence[Run] = (),
    request: Request | None = None,
    only: Sequence[str] = (),
    *,
    trust_log: bool = False,
) -> Planned:
    """Find the manoeuvre after which the parameters are known best.

    The criterion is the determinant of the information on them (D-optimality; Atkinson, Donev and Tobias,
    Optimum Experimental Designs): that of the weak form of the simulated log, as `fit_weak` sees it, together
    with stated priors and the logs.

    Parameters
    ----------
    vehicle : Vehicle
        The model; parameters marked `estimate` count.
    runs : sequence of Run
        Logs that exist already.
    request : Request, optional
        Duration, limits and the like.
    only : sequence of str
        The parameters that matter; the others are still to be estimated. All by default.
    trust_log : bool
        Take logs as they are, also those that `undertow.identification.doctor.refuse_impossible` refuses.

    Raises
    ------
    UndertowError
        If nothing is to be estimated, a limit is missing, or no manoeuvre is within the limits.
    """
    refuse_impossible(vehicle, runs, trust_log=trust_log)
    request = request or Request()
    free = free_parameters(vehicle)
    _refuse(vehicle, free, only)
    known = knowledge(vehicle, free, runs)
    plant = Plant.of(known.vehicle, compiled=request.compiled)
    ground = Ground(request, vehicle, [plant], runs)
    wanted = [free.index(n) for n in only] if only else list(range(len(free)))
    return _Parameters(ground, plant, known, wanted).planned()


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


class _Parameters:
    """The search, and the sums that it keeps."""

    def __init__(self, ground: Ground, plant: Plant, known: Knowledge, wanted: list[int]) -> None:
        self.ground, self.plant, self.known, self.wanted = ground, plant, known, wanted
        self.model = WeakModel(plant.functions, known.free)
        self.base = log_determinant(known.now, wanted)
        self.pooled = np.zeros_like(known.now)
        self.strained: Flight | None = None
        self.best = -np.inf
        self.flight: Flight | None = None
        self.gram = self.pooled

    def judge(self, design: Design) -> float:
        """Mean factor by which the standard errors of the wanted parameters fall, as a logarithm."""
        flight = self.ground.space.fly(design)
        if not flight.safe:
            if self.strained is None or flight.strain < self.strained.strain:
                self.strained = flight
            return -np.inf
        gram = gram_along(self.model, self.ground.space.data(flight, 0), self.plant.p)
        if gram is None:
            return -np.inf
        self.pooled = self.pooled + gram
        value = (log_determinant(self.known.after(gram), self.wanted) - self.base) / (2 * len(self.wanted))
        if value > self.best:
            self.best, self.flight, self.gram = value, flight, gram
        return value

    def planned(self) -> Planned:
        """Search and tell."""
        ground, columns = self.ground, len(self.known.free) + 2 * len(self.ground.vehicle.dof_indices)
        request = ground.request
        found = search(ground.families, self.judge, ground.tries(columns), request.seed, request.report)
        if self.flight is None:
            ground.refuse_unsafe(self.strained)
        assert self.flight is not None
        return Planned(self._told(found, self.flight), self.flight)

    def _told(self, found: Search, flight: Flight) -> Plan:
        assert found.best is not None
        ground, request, known = self.ground, self.ground.request, self.known
        hopeless = undetermined(self.pooled, known.free)
        spread = depth_spread(ground.space, self.plant, known, flight)
        return Plan(
            undertow=__version__,
            vehicle=ground.vehicle.name,
            signs=ground.vehicle.signs,
            goal="parameters",
            seed=request.seed,
            tries=found.tries,
            duration=request.duration,
            rate=request.rate,
            manoeuvre=found.best.family.name,
            criterion=float(np.exp(found.value)),
            families=finite(
                {n: float(np.exp(v)) if np.isfinite(v) else v for n, v in found.by_family.items()}
            ),
            commands=commands_of(ground, flight),
            noise=channels_of(ground),
            extremes=extremes_of(ground, flight),
            limits=finite(request.motion.as_dict()),
            depth_spread=spread,
            parameters=table_of(known, ground.vehicle, known.after(self.gram), hopeless),
            undetermined=hopeless,
            rivals=[],
            separations=[],
            logs=[r.name for r in ground.runs],
            remarks=[*remarks_on(known, ground.runs), *safety_remarks(ground, flight, spread)],
        )
