"""The manoeuvre that best tells rival models apart (T-optimality)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.doctor.examine import refuse_impossible
from undertow.identification.estimation.data import WeakData, Whitening, prepare
from undertow.identification.estimation.residual import Linearised, WeakModel, whitened
from undertow.identification.estimation.step import bounded_step, bounds_of, prior_of
from undertow.identification.logs.run import Run
from undertow.model.catalogue import Catalogue, catalogue
from undertow.model.parameter import printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array
from undertow.version import __version__

from .flight import Airspace, Flight, Ground, Plant, Request, depth_spread
from .manoeuvres import Design
from .parameters import Planned, Search, search
from .result import (
    Plan,
    Rival,
    Separation,
    channels_of,
    commands_of,
    extremes_of,
    finite,
    parameter_of,
    safety_remarks,
)
from .rivals import RivalModel, RivalSpec, rival_models

_ROUNDS = 6
_SHARES = (1.0, 0.5, 0.2)
# A fall of the sum of squares that changes no judgement.
_ENOUGH = 0.01


class Refit:
    """Refits one rival to what another one predicts.

    Parameters
    ----------
    rival : RivalModel
        The model that gives way.
    truth : RivalModel
        The model that is taken for true.
    with_logs : bool
        Whether the rival has to keep fitting the logs that it was fitted to.
    """

    def __init__(self, rival: RivalModel, truth: RivalModel, *, with_logs: bool) -> None:
        self._model, self._p = rival.model, rival.plant.p
        self._truth, self._true_p = WeakModel(truth.plant.functions, ()), truth.plant.p
        self._bounds, self._prior = bounds_of(rival.model), prior_of(rival.model)
        size = len(rival.known.free)
        logs = rival.known.logs if with_logs else np.zeros((size, size))
        values, vectors = np.linalg.eigh(logs) if size else (np.zeros(0), np.zeros((0, 0)))
        self._root = np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T
        self._places = list(rival.model.places)

    @property
    def vehicle(self) -> Vehicle:
        """The model that gives way."""
        return self._model.functions.vehicle

    def distance(self, data: WeakData, start: Array | None = None, rounds: int = 1) -> tuple[float, Array]:
        """Sum of squares that no refit of the rival takes away, in units of the noise, and the refit.

        The residual that the true model leaves itself (quadrature, and noise in a real log) does not count.

        Parameters
        ----------
        data : WeakData
            A log that the true model predicts, or a real one.
        start : (n_parameters,) array, optional
            Values that the refit begins with.
        rounds : int
            Steps of Gauss and Newton; one alone is the linearised problem, as searches use it.
        """
        p = (self._p if start is None else start).copy()
        own = self._truth.linearise(data, self._true_p)
        noise = self._model.whitening(data, p)
        at = self._at(data, p, own, noise)
        for left in range(rounds, 0, -1):
            if not (np.isfinite(at.r).all() and np.isfinite(at.J).all()):
                return 0.0, p
            step = bounded_step(at, p[self._places], self._bounds, self._prior)
            promised = _squares(at.r + at.J @ step)
            if left == 1 or _squares(at.r) - promised < _ENOUGH:
                return min(promised, _squares(at.r)), p
            p, at = self._moved(data, p, step, at, own, noise)
        return 0.0, p

    def _moved(
        self,
        data: WeakData,
        p: Array,
        step: Array,
        at: Linearised,
        own: list[Linearised],
        noise: list[Whitening],
    ) -> tuple[Array, Linearised]:
        for share in _SHARES:
            tried = p.copy()
            tried[self._places] = np.clip(p[self._places] + share * step, *self._bounds)
            there = self._at(data, tried, own, noise)
            if _squares(there.r) < _squares(at.r):
                return tried, there
        return p, at

    def _at(self, data: WeakData, p: Array, own: list[Linearised], noise: list[Whitening]) -> Linearised:
        """The linearised problem; below the prediction stands what the logs hold against a change."""
        parts = [_apart(a, b) for a, b in zip(self._model.linearise(data, p), own, strict=True)]
        seen = whitened(parts, noise)
        moved = self._root @ (p[self._places] - self._p[self._places])
        both, slopes = np.concatenate([seen.r, moved]), np.vstack([seen.J, self._root])
        return Linearised(both, slopes, np.zeros((len(both), 0)))


def _apart(rival: Linearised, truth: Linearised) -> Linearised:
    """Difference of two residuals; neither knows the first states of its effects."""
    known = [k for k in (rival.known, truth.known) if k is not None]
    return replace(
        rival,
        r=rival.r - truth.r,
        start=np.hstack([rival.start, truth.start]),
        known=min(known, default=None),
    )


def _squares(r: Array) -> float:
    return float(np.sum(r**2))


class Separations:
    """Distances between all pairs of rivals.

    Parameters
    ----------
    rivals : sequence of RivalModel
        The models.
    spread : float
        How many times wider than by noise alone errors are.
    with_logs : bool
        As for `Refit`.
    """

    def __init__(self, rivals: Sequence[RivalModel], spread: float, *, with_logs: bool) -> None:
        self._spread, self._count = spread, len(rivals)
        self.pairs = list(combinations(range(len(rivals)), 2))
        # A model cannot be told from one that holds it: only the other way round there is a difference.
        self._ways = [
            [(i, j) for i, j in (pair, pair[::-1]) if not rivals[i].parts < rivals[j].parts]
            for pair in self.pairs
        ]
        ways = [way for ways in self._ways for way in ways]
        self._refits = {(i, j): Refit(rivals[j], rivals[i], with_logs=with_logs) for i, j in ways}
        self._last: dict[tuple[int, int], Array] = {}

    def quick(self, space: Airspace, flight: Flight) -> Array:
        """Chi-square of every pair along a flight, refits being linearised about the last careful ones."""
        return self._apart(self._along(space, flight), rounds=1)

    def careful(self, space: Airspace, flight: Flight) -> Array:
        """Chi-square of every pair along a flight with thorough refits."""
        return self._apart(self._along(space, flight), _ROUNDS)

    def on_logs(self, runs: Sequence[Run], sigma: Array) -> Array:
        """Chi-square of every pair along the motions of logs; sigma is the noise of their 2n channels."""
        data = prepare(runs, self._refits[self._ways[0][0]].vehicle, sigma=sigma)
        return self._apart([data] * self._count, _ROUNDS)

    def _along(self, space: Airspace, flight: Flight) -> list[WeakData]:
        return [space.data(flight, i) for i in range(self._count)]

    def _apart(self, predicted: Sequence[WeakData], rounds: int) -> Array:
        """The smaller of both ways round, for every pair."""
        found = [min(self._way(way, predicted[way[0]], rounds) for way in ways) for ways in self._ways]
        return np.array(found) / self._spread**2

    def _way(self, way: tuple[int, int], data: WeakData, rounds: int) -> float:
        """One model refitted to another; thorough refits are where the next one begins."""
        near, p = self._refits[way].distance(data, self._last.get(way), rounds)
        if rounds > 1:
            self._last[way] = p
        return near


# Models nearer than this are the same for whoever flies the manoeuvre.
SEPARATED = 3.0
# Thorough refits add about as many calls as searching makes.
_THOROUGH = 2


def plan_separation(
    vehicle: Vehicle,
    specs: Sequence[RivalSpec],
    runs: Sequence[Run] = (),
    request: Request | None = None,
    *,
    known: Catalogue | None = None,
    trust_log: bool = False,
) -> Planned:
    """Find the manoeuvre that best tells models apart.

    What counts is the difference between the predictions of two models after the parameters of the one have
    been refitted to the other, in units of the noise (T-optimality; Atkinson and Fedorov, 1975, Biometrika
    62), in the weak form, by which `undertow diagnose` judges. While searching, refits are linearised.

    Parameters
    ----------
    vehicle : Vehicle
        The model without the effects in question.
    specs : sequence of RivalSpec
        At least two models.
    runs : sequence of Run
        Logs that exist already; the rivals are fitted to them, and have to keep fitting them.
    request : Request, optional
        Duration, limits and the like.
    known : mapping, optional
        Effects by id.
    trust_log : bool
        Take logs as they are, also those that `undertow.identification.doctor.refuse_impossible` refuses.

    Raises
    ------
    UndertowError
        If there are fewer than two models, an effect is unknown or adds nothing, a limit is missing, or no
        manoeuvre is within the limits.
    """
    refuse_impossible(vehicle, runs, trust_log=trust_log)
    request, known = request or Request(), known or catalogue()
    names = [s.name for s in specs]
    if len(set(names)) < 2:
        raise UndertowError(
            "fewer than two models are to be told apart: name two effects, or an effect and 'none'"
        )
    if len(set(names)) < len(names):
        twice = next(n for n in names if names.count(n) > 1)
        raise UndertowError(f"'{twice}' is named twice: name each model once")
    first = Ground(request, vehicle, [Plant.of(vehicle, compiled=request.compiled)], runs)
    rivals = rival_models(
        vehicle, specs, known, runs, (first.space, first.families), compiled=request.compiled
    )
    ground = Ground(request, vehicle, [r.plant for r in rivals], runs)
    return _Separating(ground, rivals).planned()


@dataclass
class _Best:
    value: float = -np.inf
    flight: Flight | None = None
    strained: Flight | None = None


class _Separating:
    """The search."""

    def __init__(self, ground: Ground, rivals: Sequence[RivalModel]) -> None:
        self.ground, self.rivals = ground, rivals
        # The model that explains the logs best says how far beyond noise they are.
        self.spread = min(r.known.misfit for r in rivals)
        self.separations = Separations(rivals, self.spread, with_logs=bool(ground.runs))
        self.best = _Best()

    def judge(self, design: Design) -> float:
        """Standard deviations between the models, a mean over the pairs in which close ones weigh most."""
        flight, best = self.ground.space.fly(design), self.best
        if not flight.safe:
            if best.strained is None or flight.strain < best.strained.strain:
                best.strained = flight
            return -np.inf
        value = _mean(self.separations.quick(self.ground.space, flight))
        if value > best.value:
            # What looks best by linearised refits has to be so by thorough ones.
            value = _mean(self.separations.careful(self.ground.space, flight))
        if value > best.value:
            best.value, best.flight = value, flight
        return value

    def planned(self) -> Planned:
        """Search and tell."""
        ground = self.ground
        others, states = len(self.rivals) - 1, 2 * len(ground.vehicle.dof_indices)
        columns = others * sum(len(r.known.free) + states for r in self.rivals)
        tries = ground.tries(columns, calls=_THOROUGH * others * len(self.rivals))
        found = search(ground.families, self.judge, tries, ground.request.seed, ground.request.report)
        if self.best.flight is None:
            ground.refuse_unsafe(self.best.strained)
        assert self.best.flight is not None
        return Planned(self._told(found, self.best.flight), self.best.flight)

    def _told(self, found: Search, flight: Flight) -> Plan:
        assert found.best is not None
        ground, request, first = self.ground, self.ground.request, self.rivals[0]
        spread = depth_spread(ground.space, first.plant, first.known, flight)
        pairs = self._pairs(flight)
        return Plan(
            undertow=__version__,
            vehicle=ground.vehicle.name,
            signs=ground.vehicle.signs,
            goal="separate",
            seed=request.seed,
            tries=found.tries,
            duration=request.duration,
            rate=request.rate,
            manoeuvre=found.best.family.name,
            criterion=min(p.deviations for p in pairs),
            families=finite(found.by_family),
            commands=commands_of(ground, flight),
            noise=channels_of(ground),
            extremes=extremes_of(ground, flight),
            limits=finite(request.motion.as_dict()),
            depth_spread=spread,
            parameters=[],
            undetermined=[],
            rivals=[_told_rival(r, ground.vehicle.signs) for r in self.rivals],
            separations=pairs,
            logs=[r.name for r in ground.runs],
            remarks=[*self._remarks(pairs), *safety_remarks(ground, flight, spread)],
        )

    def _pairs(self, flight: Flight) -> list[Separation]:
        runs, space = self.ground.runs, self.ground.space
        plan = self.separations.careful(space, flight)
        now: list[float] | None = None
        if runs:
            apart = Separations(self.rivals, self.spread, with_logs=False)
            now = apart.on_logs(runs, self.ground.noise.finite).tolist()
        found = []
        for k, (i, j) in enumerate(self.separations.pairs):
            before = None if now is None else now[k]
            total = float(plan[k]) + (before or 0.0)
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
            f"no manoeuvre that was tried tells {' and '.join(p.pair)} apart: the best leaves them "
            f"{p.deviations:.2g} standard deviations from each other"
            for p in pairs
            if p.deviations < SEPARATED
        ]
        now = [p.deviations_now for p in pairs]
        if all(d is not None and d > SEPARATED for d in now):
            lines.append(
                "the logs tell all of these models apart as it is: undertow diagnose says which is right"
            )
        assumed = [r.name for r in self.rivals if r.source == "typical size"]
        if assumed:
            lines.append(
                f"nothing is known of the size of {' and '.join(assumed)}: planned with a tenth of the "
                "actuators' force, or of the velocities; a diagnosis or logs would say more"
            )
        if self.spread > 1.5:
            lines.append(
                "even the best of the models leaves more than noise on the logs: distances are counted as if "
                f"the noise were {self.spread:.2g} times larger"
            )
        return lines


def _mean(chi_square: Array) -> float:
    """Of one pair its standard deviations; of several a mean in which a hopeless pair hides no other."""
    return float(np.sqrt(np.expm1(np.mean(np.log1p(chi_square)))))


def _told_rival(rival: RivalModel, signs: str) -> Rival:
    vehicle = rival.plant.functions.vehicle
    declared = {n: parameter_of(vehicle, n) for n in rival.own}
    return Rival(
        name=rival.name,
        values={n: printed(p, vehicle.value_of(n).value, signs) for n, p in declared.items()},
        units={n: "" if p.unit == "1" else p.unit for n, p in declared.items()},
        source=rival.source,
    )


# Little: a look at every family and some refinement of the best.
_TRIES = 60


def suggest(
    vehicle: Vehicle,
    ids: Sequence[str],
    runs: Sequence[Run],
    values: Mapping[str, Mapping[str, float]] | None = None,
    *,
    known: Catalogue | None = None,
    tries: int = _TRIES,
) -> str:
    """Say which kind of manoeuvre would tell effects apart, within the commands and motions of the logs.

    Parameters
    ----------
    vehicle : Vehicle
        The model without the effects.
    ids : sequence of str
        Effects (joined by + where a model has several); "none" is the model without any.
    runs : sequence of Run
        Logs that cannot tell.
    values : mapping, optional
        Values found for the parameters of each effect, by id, SNAME signs: where the fits begin.
    known : mapping, optional
        Effects by id.
    tries : int
        Manoeuvres that are looked at.

    Raises
    ------
    UndertowError
        If there are fewer than two models, or no manoeuvre is within the limits.
    """
    specs = [RivalSpec(name, (values or {}).get(name, {})) for name in ids]
    plan = plan_separation(vehicle, specs, runs, Request(tries=tries), known=known).plan
    apart = min(plan.separations, key=lambda s: s.deviations)
    between = " and ".join(apart.pair)
    if apart.deviations < SEPARATED:
        return (
            f"No manoeuvre of {plan.duration:g} s that was tried would tell {between} apart: the best leaves "
            f"them {apart.deviations:.2g} standard deviations from each other."
        )
    now = "" if apart.deviations_now is None else f" (these logs: {_plainly(apart.deviations_now)})"
    return (
        f"{plan.manoeuvre[0].upper()}{plan.manoeuvre[1:]} for {plan.duration:g} s would set {between} "
        f"{_plainly(apart.deviations)} standard deviations apart{now}; write it with undertow plan "
        f"--goal separate --between {','.join(ids)}."
    )


def _plainly(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"
