"""The manoeuvre that best tells rival models apart (T-optimality)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undertow import __version__
from undertow.errors import UndertowError
from undertow.model.catalogue import Catalogue, catalogue
from undertow.model.parameter import printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..doctor import refuse_impossible
from ..logs import Run
from .families import Design
from .flight import Flight, Plant, depth_spread
from .parameters import Planned
from .result import Plan, Rival, Separation
from .rivals import RivalModel, RivalSpec, rival_models
from .search import Search, search
from .separation import Separations
from .setting import Ground, Request
from .telling import channels_of, commands_of, extremes_of, finite, parameter_of, safety_remarks

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
