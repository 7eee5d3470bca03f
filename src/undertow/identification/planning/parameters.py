"""The manoeuvre that best determines parameters (D-optimality)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from undertow import __version__
from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle

from ..base_parameters import undetermined
from ..doctor import refuse_impossible
from ..logs import Run
from ..weak.fit import free_parameters
from ..weak.residual import WeakModel
from .families import Design
from .flight import Flight, Plant, depth_spread
from .information import Knowledge, gram_along, knowledge, log_determinant, remarks_on
from .result import Plan
from .search import Search, search
from .setting import Ground, Request
from .telling import channels_of, commands_of, extremes_of, finite, safety_remarks, table_of


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
