"""The manoeuvre that best determines parameters, or best tells rival models apart, by random search."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from undertow.errors import UndertowError
from undertow.files import json_ready
from undertow.identification.doctor.examine import refuse_impossible
from undertow.identification.estimation.data import WeakData, prepare
from undertow.identification.estimation.fitted import undetermined
from undertow.identification.estimation.residual import Linearised, WeakModel, whitened
from undertow.identification.estimation.step import bounded_step, bounds_of, search_prior, squared
from undertow.identification.estimation.test_functions import Whitening
from undertow.identification.estimation.weak_form import required_free_parameters
from undertow.identification.logs.run import Run
from undertow.model.catalogue import Catalogue, catalogue
from undertow.model.parameter import printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array
from undertow.version import __version__

from .manoeuvres import Design
from .problem import SETTINGS as PLANNING
from .problem import (
    Knowledge,
    Manoeuvre,
    Plan,
    PlanningProblem,
    PlanRequest,
    Plant,
    Rival,
    Separation,
    commands_of,
    depth_spread,
    extremes_of,
    gram_along,
    knowledge,
    log_determinant,
    noise_of,
    parameters_of,
    remarks_on,
    safety_remarks,
)
from .rivals import RivalModel, RivalSpec, rival_models


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
    again: float = 3.0  # the first change is so many times smaller where the best one is refined once more
    # Numbers that are changed at a time, on average, and their least share of all.
    changed: float = 2.0
    changed_share: float = 0.1
    # Share of the numbers drawn anew by the first changes, so that a sign or an order of levels can change.
    redrawn: float = 0.25


SEARCH = SearchSettings()


class PlanSearch(ABC):
    """Random search for the best manoeuvre, and refinement; the same seed finds the same manoeuvre."""

    def __init__(self, problem: PlanningProblem, plant: Plant, known: Knowledge, tries: int) -> None:
        self.problem, self._tries = problem, tries
        self.plant, self.known = plant, known  # the model that predicts the uncertainty of the depth
        self.value = -np.inf
        # Highest value by name of the family; -inf where no manoeuvre of it was safe.
        self.by_family: dict[str, float] = {}
        self._best: tuple[Design, Manoeuvre] | None = None
        self._gentlest: Manoeuvre | None = None
        self._leaders: dict[str, tuple[float, Design]] = {}
        self._count = 0
        self._rng = np.random.default_rng(problem.request.seed)

    @abstractmethod
    def objective(self, manoeuvre: Manoeuvre) -> float:
        """Objective of a safe manoeuvre; -inf if it cannot be computed."""

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
            duration=problem.duration,
            rate=problem.rate,
            speed=problem.speed,
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
        exploring = max(round(SEARCH.exploring * self._tries), len(families))
        for i in range(exploring):
            family = families[i % len(families)]
            self._evaluate(Design(family, self._rng.random(family.size)), "searching for a manoeuvre")
        leaders = sorted(self._leaders.values(), key=lambda pair: -pair[0])[: SEARCH.short_list]
        # A quarter of the remaining tries for the leader, an eighth for the next; all others for the best.
        for rank, (value, design) in enumerate(leaders):
            self._refine(design, value, (self._tries - exploring) // 2 ** (rank + 2), SEARCH.first_change)
        if self._best is not None:
            rest = self._tries - self._count
            self._refine(self._best[0], self.value, rest, SEARCH.first_change / SEARCH.again)

    def _evaluate(self, design: Design, words: str) -> float:
        value = self._value(design)
        self._count += 1
        self.problem.request.report(min(self._count / max(self._tries, 1), 1.0), words)
        name = design.family.name
        self.by_family[name] = max(value, self.by_family.get(name, -np.inf))
        if np.isfinite(value) and value > self._leaders.get(name, (-np.inf,))[0]:
            self._leaders[name] = (value, design)
        return value

    def _value(self, design: Design) -> float:
        manoeuvre = self.problem.simulated(design)
        if not manoeuvre.safe:
            if self._gentlest is None or manoeuvre.limit_ratio < self._gentlest.limit_ratio:
                self._gentlest = manoeuvre
            return -np.inf
        value = self.objective(manoeuvre)
        if value > self.value:
            self.value, self._best = value, (design, manoeuvre)
        return value

    def _refine(self, design: Design, value: float, tries: int, first: float) -> None:
        """Change a few numbers at a time, by less and less, and keep what is better."""
        for i in range(tries):
            size = first * (SEARCH.last_change / first) ** (i / max(tries - 1, 1))
            changed = Design(design.family, self._perturbed(design.numbers, size))
            changed_value = self._evaluate(changed, f"refining {design.family.name}")
            if changed_value > value:
                design, value = changed, changed_value

    def _perturbed(self, numbers: Array, size: float) -> Array:
        rng = self._rng
        chosen = rng.random(len(numbers)) < max(SEARCH.changed / len(numbers), SEARCH.changed_share)
        chosen[rng.integers(len(numbers))] = True
        changed = numbers + size * rng.standard_normal(len(numbers))
        changed = np.abs(1.0 - np.abs(1.0 - changed))
        redrawn = rng.random(len(numbers)) < SEARCH.redrawn * size / SEARCH.first_change
        changed = np.where(redrawn, rng.random(len(numbers)), changed)
        return np.clip(np.where(chosen, changed, numbers), 0.0, 1.0)


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
    Optimum Experimental Designs): that of the weak form of the simulated log, as for `fit_weak`, together
    with stated priors and the logs. `only` names the parameters of interest, by default all that are marked
    `estimate`; the others are still estimated.
    """
    refuse_impossible(vehicle, runs, trust_log=trust_log)
    request = request or PlanRequest()
    free = required_free_parameters(vehicle)
    for name in only:
        if name not in free:
            raise UndertowError(
                f"'{name}' is not to be estimated in '{vehicle.name}': there are {', '.join(free)}"
            )
    known = knowledge(vehicle, free, runs)
    plant = Plant.of(known.vehicle, compiled=request.compiled)
    problem = PlanningProblem(request, vehicle, [plant], runs)
    wanted = [free.index(n) for n in only] if only else list(range(len(free)))
    return _ParameterSearch(problem, plant, known, wanted).planned()


class _ParameterSearch(PlanSearch):
    """The objective is the log of the mean factor by which standard errors of wanted parameters fall."""

    def __init__(self, problem: PlanningProblem, plant: Plant, known: Knowledge, wanted: list[int]) -> None:
        columns = len(known.free) + 2 * len(problem.vehicle.dof_indices)
        super().__init__(problem, plant, known, problem.tries(columns))
        self._wanted, self._model = wanted, WeakModel(plant.functions, known.free)
        self._now = log_determinant(known.now, wanted)
        self._pooled = np.zeros_like(known.now)

    def _gram(self, manoeuvre: Manoeuvre) -> Array | None:
        return gram_along(self._model, self.problem.data(manoeuvre, 0), self.plant.p)

    def objective(self, manoeuvre: Manoeuvre) -> float:
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


# --- models told apart (T-optimality) -------------------------------------------------------------
@dataclass(frozen=True)
class SeparationSettings:
    """How models are refitted to each other."""

    rounds: int = 6  # Gauss-Newton steps of a thorough refit
    shares: tuple[float, ...] = (1.0, 0.5, 0.2)  # of a step, tried in turn
    tolerance: float = 0.01  # fall of the sum of squares that is negligible
    separated: float = 3.0  # models nearer than this, in standard deviations, are the same in practice
    thorough: int = 2  # thorough refits add about as many calls as searching makes
    suggested: int = 60  # tries of a suggestion: for a few of every family and some refinement of the best


SEPARATION = SeparationSettings()


class Refit:
    """Refits one rival to what another one predicts."""

    def __init__(self, rival: RivalModel, truth: RivalModel, *, with_logs: bool) -> None:
        self._model, self._p = rival.model, rival.plant.p
        self._truth, self._true_p = WeakModel(truth.plant.functions, ()), truth.plant.p
        self._bounds, self._prior = bounds_of(rival.model), search_prior(rival.model)
        size = len(rival.known.free)
        logs = rival.known.logs if with_logs else np.zeros((size, size))
        values, vectors = np.linalg.eigh(logs) if size else (np.zeros(0), np.zeros((0, 0)))
        self._root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        self._places = list(rival.model.places)

    @property
    def vehicle(self) -> Vehicle:
        """The model that is refitted."""
        return self._model.functions.vehicle

    def distance(self, data: WeakData, start: Array | None = None, rounds: int = 1) -> tuple[float, Array]:
        """Sum of squares that remains after the refit, in units of the noise, and the values of the refit.

        The residual of the true model (quadrature, and noise in a real log) is subtracted.
        """
        p = (self._p if start is None else start).copy()
        truth = self._truth.linearise(data, self._true_p)
        noise = self._model.whitening(data, p)
        at = self._at(data, p, truth, noise)
        for left in range(rounds, 0, -1):
            if not (np.isfinite(at.r).all() and np.isfinite(at.J).all()):
                return 0.0, p
            step = bounded_step(at, p[self._places], self._bounds, self._prior)
            predicted = squared(at.r + at.J @ step)
            if left == 1 or squared(at.r) - predicted < SEPARATION.tolerance:
                return min(predicted, squared(at.r)), p
            for share in SEPARATION.shares:
                tried = p.copy()
                tried[self._places] = np.clip(p[self._places] + share * step, *self._bounds)
                there = self._at(data, tried, truth, noise)
                if squared(there.r) < squared(at.r):
                    p, at = tried, there
                    break
        return 0.0, p

    def _at(self, data: WeakData, p: Array, truth: list[Linearised], noise: list[Whitening]) -> Linearised:
        """The problem linearised at p: the difference of the residuals, and that to the fit to the logs."""
        parts = []
        for rival, true in zip(self._model.linearise(data, p), truth, strict=True):
            # In both the first states of the effects are unknown.
            start = np.hstack([rival.start, true.start])
            known = min((k for k in (rival.known, true.known) if k is not None), default=None)
            parts.append(replace(rival, r=rival.r - true.r, start=start, known=known))
        predicted = whitened(parts, noise)
        to_logs = self._root @ (p[self._places] - self._p[self._places])
        r, slopes = np.concatenate([predicted.r, to_logs]), np.vstack([predicted.J, self._root])
        return Linearised(r, slopes, np.zeros((len(r), 0)))


class Separations:
    """Distances between all pairs of rivals."""

    def __init__(self, rivals: Sequence[RivalModel], inflation: float, *, with_logs: bool) -> None:
        self._inflation, self._count = inflation, len(rivals)
        self.pairs = list(combinations(range(len(rivals)), 2))
        # A model that contains another fits its predictions exactly: only the refit of the other one counts.
        self._directions = [
            [(i, j) for i, j in (pair, pair[::-1]) if not rivals[i].parts < rivals[j].parts]
            for pair in self.pairs
        ]
        directions = [direction for directions in self._directions for direction in directions]
        self._refits = {(i, j): Refit(rivals[j], rivals[i], with_logs=with_logs) for i, j in directions}
        self._last: dict[tuple[int, int], Array] = {}

    def along(self, problem: PlanningProblem, manoeuvre: Manoeuvre, rounds: int = SEPARATION.rounds) -> Array:
        """Chi-square of every pair along a manoeuvre, by thorough refits.

        With one round, refits are linearised about the last thorough ones.
        """
        return self._chi_square([problem.data(manoeuvre, i) for i in range(self._count)], rounds)

    def on_logs(self, runs: Sequence[Run], sigma: Array) -> Array:
        """Chi-square of every pair along the motions of logs; sigma is the noise of their 2n channels."""
        data = prepare(runs, self._refits[self._directions[0][0]].vehicle, sigma=sigma)
        return self._chi_square([data] * self._count, SEPARATION.rounds)

    def _chi_square(self, predicted: Sequence[WeakData], rounds: int) -> Array:
        """The smaller one of the two directions of every pair."""
        found = [min(self._distance(d, predicted[d[0]], rounds) for d in both) for both in self._directions]
        return np.array(found) / self._inflation**2

    def _distance(self, direction: tuple[int, int], data: WeakData, rounds: int) -> float:
        """Distance in one direction; the next refit starts from the values of the last thorough one."""
        distance, p = self._refits[direction].distance(data, self._last.get(direction), rounds)
        if rounds > 1:
            self._last[direction] = p
        return distance


def plan_separation(
    vehicle: Vehicle,
    specs: Sequence[RivalSpec],
    runs: Sequence[Run] = (),
    request: PlanRequest | None = None,
    *,
    known: Catalogue | None = None,
    trust_log: bool = False,
) -> Planned:
    """Find the manoeuvre that best tells models apart.

    The criterion is the difference between the predictions of two models after the parameters of the one have
    been refitted to the other, in units of the noise (T-optimality; Atkinson and Fedorov, 1975, Biometrika
    62), in the weak form, as in `undertow diagnose`. While searching, refits are linearised. The
    rivals are fitted to the logs, and have to keep fitting them; `vehicle` is the model without the effects.
    """
    refuse_impossible(vehicle, runs, trust_log=trust_log)
    request, known = request or PlanRequest(), known or catalogue()
    names = [s.name for s in specs]
    if len(set(names)) < 2:
        raise UndertowError("fewer than two models to tell apart: name two effects, or an effect and 'none'")
    if len(set(names)) < len(names):
        twice = next(n for n in names if names.count(n) > 1)
        raise UndertowError(f"'{twice}' is named twice: name each model once")
    first = PlanningProblem(request, vehicle, [Plant.of(vehicle, compiled=request.compiled)], runs)
    rivals = rival_models(vehicle, specs, known, first)
    problem = PlanningProblem(request, vehicle, [r.plant for r in rivals], runs)
    return _SeparationSearch(problem, rivals).planned()


class _SeparationSearch(PlanSearch):
    """The objective is the standard deviations between models: a mean over pairs, dominated by close ones."""

    def __init__(self, problem: PlanningProblem, rivals: Sequence[RivalModel]) -> None:
        others, states = len(rivals) - 1, 2 * len(problem.vehicle.dof_indices)
        columns = others * sum(len(r.known.free) + states for r in rivals)
        tries = problem.tries(columns, calls=SEPARATION.thorough * others * len(rivals))
        super().__init__(problem, rivals[0].plant, rivals[0].known, tries)
        self.rivals = rivals
        self.inflation = min(r.known.misfit for r in rivals)  # by the model that fits the logs best
        self.separations = Separations(rivals, self.inflation, with_logs=bool(problem.runs))

    def objective(self, manoeuvre: Manoeuvre) -> float:
        value = _mean(self.separations.along(self.problem, manoeuvre, rounds=1))
        if value > self.value:
            # The best one by linearised refits is evaluated by thorough ones.
            value = _mean(self.separations.along(self.problem, manoeuvre))
        return value

    def outcome(self, manoeuvre: Manoeuvre) -> dict[str, Any]:
        pairs = self._pairs(manoeuvre)
        return {
            "goal": "separate",
            "criterion": min(p.deviations for p in pairs),
            "families": json_ready(self.by_family),
            "parameters": [],
            "undetermined": [],
            "rivals": [_planned_rival(r, self.problem.vehicle.signs) for r in self.rivals],
            "separations": pairs,
            "remarks": self._remarks(pairs),
        }

    def _pairs(self, manoeuvre: Manoeuvre) -> list[Separation]:
        runs, pairs = self.problem.runs, self.separations.pairs
        plan = self.separations.along(self.problem, manoeuvre)
        now: list[float | None] = [None] * len(pairs)
        if runs:
            separations = Separations(self.rivals, self.inflation, with_logs=False)
            now = separations.on_logs(runs, self.problem.noise.finite).tolist()
        found = []
        for (i, j), more, before in zip(pairs, plan.tolist(), now, strict=True):
            total = more + (before or 0.0)
            found.append(
                Separation(
                    pair=(self.rivals[i].name, self.rivals[j].name),
                    chi_square=total,
                    deviations=float(np.sqrt(total)),
                    chi_square_now=before,
                    deviations_now=None if before is None else float(np.sqrt(before)),
                )
            )
        return found

    def _remarks(self, pairs: Sequence[Separation]) -> list[str]:
        lines = [
            f"no manoeuvre that was tried tells {' and '.join(p.pair)} apart: with the best they differ by "
            f"only {p.deviations:.2g} standard deviations"
            for p in pairs
            if p.deviations < SEPARATION.separated
        ]
        now = [p.deviations_now for p in pairs]
        if all(d is not None and d > SEPARATION.separated for d in now):
            lines.append(
                "by the noise of the sensors alone, the existing logs tell all of these models apart: "
                "undertow diagnose says which is right, or that they still predict the validation data "
                "equally well"
            )
        assumed = [r.name for r in self.rivals if r.source == "typical size"]
        if assumed:
            lines.append(
                f"nothing is known about the size of {' and '.join(assumed)}: planned with a tenth of the "
                "actuators' force, or of the velocities; a diagnosis or logs would say more"
            )
        if self.inflation > PLANNING.remarked:
            lines.append(
                "even the best of the models leaves a residual above the noise on the logs: distances are "
                f"computed as if the noise were {self.inflation:.2g} times larger"
            )
        return lines


def _mean(chi_square: Array) -> float:
    """Standard deviations, for several pairs a mean that is not zero if only one of them is."""
    return float(np.sqrt(np.expm1(np.mean(np.log1p(chi_square)))))


def _planned_rival(rival: RivalModel, signs: str) -> Rival:
    vehicle = rival.plant.functions.vehicle
    declared = {n: vehicle.declaration(n) for n in rival.added}
    return Rival(
        name=rival.name,
        values={n: printed(p, vehicle.value_of(n).value, signs) for n, p in declared.items()},
        units={n: p.shown_unit for n, p in declared.items()},
        source=rival.source,
    )


def suggest(
    vehicle: Vehicle,
    ids: Sequence[str],
    runs: Sequence[Run],
    values: Mapping[str, Mapping[str, float]] | None = None,
    *,
    known: Catalogue | None = None,
    tries: int = SEPARATION.suggested,
) -> tuple[str, bool]:
    """The kind of manoeuvre that would tell effects apart, in words, and whether any does.

    It keeps within the commands of the logs. Effects of one model are joined by +; "none" is the model
    without any. Fits start from `values`, by id of the effect and name of the parameter, SNAME signs.
    """
    specs = [RivalSpec(name, (values or {}).get(name, {})) for name in ids]
    plan = plan_separation(vehicle, specs, runs, PlanRequest(tries=tries), known=known).plan
    # These logs do not tell them apart: only the contribution of the manoeuvre counts.
    closest = min(plan.separations, key=_added_deviations)
    then, now, between = _added_deviations(closest), closest.deviations_now or 0.0, " and ".join(closest.pair)
    tried = f"manoeuvre of {plan.duration:g} s that was tried"
    if then < SEPARATION.separated:
        words = f"with the best they differ by only {then:.2g} standard deviations."
        return f"No {tried} would tell {between} apart: {words}", False
    if then < now:
        return f"No {tried} would put {between} farther apart than these logs do.", False
    # Standard deviations are of sensor noise: where more is left, even many of them have told nothing apart.
    many = now >= SEPARATION.separated
    apart = "apart" if many else f"{then:.{'2g' if then < 10 else '0f'}} standard deviations apart"
    farther = f"{' ' if many else ', '}{then / now:.1f} times as far as these logs do" if now else ""
    words = (
        f"{plan.manoeuvre[0].upper()}{plan.manoeuvre[1:]} for {plan.duration:g} s would put {between} "
        f"{apart}{farther}; write it with undertow plan "
        f"--goal separate --between {','.join(ids)}."
    )
    return words, True


def _added_deviations(separation: Separation) -> float:
    return float(np.sqrt(max(separation.chi_square - (separation.chi_square_now or 0.0), 0.0)))
