"""What every plan needs to be told, and the ground it is made on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Progress

from ..logs import Run
from .axes import Trim, trim
from .families import Family, every_axis, families
from .flight import Airspace, Flight, Plant, refuse_samples
from .limits import CommandLimits, MotionLimits, command_limits
from .noise import ChannelNoise, planned_noise

# Work that a search takes by default, in seconds of a usual machine: the number of manoeuvres follows from
# the sizes alone, so that it is the same everywhere.
_SECONDS, _PER_CALL, _PER_NUMBER = 9.0, 6e-3, 8e-8
_FEWEST_TRIES, _MOST_TRIES = 60, 600


@dataclass(frozen=True)
class Request:
    """What is asked of a plan.

    Attributes
    ----------
    duration : float
        Length, s.
    rate : float
        Samples per second, of the commands and of the log to come.
    limits : mapping
        Largest commands by name; "" for all that are not named.
    noise : mapping
        Standard deviation of the noise by channel, SI; inf for one that is not measured.
    motion : MotionLimits
        Largest motions.
    depth : float, optional
        Depth at the start, m; by default that of the logs, or 0.
    seed : int
        Of the random numbers.
    tries : int, optional
        Manoeuvres to be judged; by default as many as take some ten seconds.
    compiled : bool, optional
        As for `Simulator`.
    report : callable
        Told what share is done, and what is being done.
    """

    duration: float = 60.0
    rate: float = 20.0
    limits: Mapping[str, float] = field(default_factory=dict)
    noise: Mapping[str, float] = field(default_factory=dict)
    motion: MotionLimits = field(default_factory=MotionLimits)
    depth: float | None = None
    seed: int = 0
    tries: int | None = None
    compiled: bool | None = None
    report: Progress = lambda done, words: None


class Ground:
    """A request made concrete for a vehicle and its logs.

    Parameters
    ----------
    request : Request
        What is asked.
    vehicle : Vehicle
        The model without rivals.
    plants : sequence of Plant
        The models that predict; the first holds the actuators in trim.
    runs : sequence of Run
        Logs.
    """

    def __init__(
        self, request: Request, vehicle: Vehicle, plants: Sequence[Plant], runs: Sequence[Run]
    ) -> None:
        refuse_samples(request.duration, request.rate)
        self.request, self.vehicle, self.runs = request, vehicle, tuple(runs)
        self.commands: CommandLimits = command_limits(vehicle, request.limits, runs)
        if not len(self.commands.value):
            raise UndertowError(
                f"'{vehicle.name}' has no thruster and no known force: nothing can be planned"
            )
        self.noise: ChannelNoise = planned_noise(vehicle, request.noise, runs)
        self.trim: Trim = trim(plants[0].functions, self.commands.value, self.depth)
        self.space = Airspace(
            plants,
            request.duration,
            request.rate,
            self.trim.commands,
            self.commands.value,
            request.motion,
            self.noise,
            self.depth,
        )

    @property
    def depth(self) -> float:
        """Depth at the start, m."""
        if self.request.depth is not None:
            return self.request.depth
        seen = [float(np.nanmedian(r.channels["z"])) for r in self.runs if r.has("z")]
        return float(np.median(seen)) if seen else 0.0

    @cached_property
    def families(self) -> list[Family]:
        """All manoeuvres that can be flown."""
        motions, actuators = every_axis(self.vehicle, self.commands.value - np.abs(self.trim.commands))
        return families([(axes, self.space.reach(axes)) for axes in (motions, actuators) if axes])

    def tries(self, columns: int, calls: int = 1) -> int:
        """How many manoeuvres to judge, when each takes so many sensitivities in so many calls."""
        if self.request.tries is not None:
            return self.request.tries
        states = 2 * len(self.vehicle.degrees_of_freedom)
        seconds = _PER_CALL * calls + _PER_NUMBER * len(self.space.t) * states * columns
        return int(np.clip(_SECONDS / seconds, _FEWEST_TRIES, _MOST_TRIES))

    def refuse_unsafe(self, strained: Flight | None) -> None:
        """Say that no manoeuvre stays within the limits.

        Raises
        ------
        UndertowError
            Always; the limit that the gentlest manoeuvre exceeds is named.
        """
        name = "speed" if strained is None else strained.limit
        option = {"depth": "--max-depth-change"}.get(name, f"--max-{name}")
        why = "".join(
            f"; the actuators cannot balance {value:.3g} N (or N m) in {dof} at rest"
            for dof, value in self.trim.left.items()
        )
        raise UndertowError(
            f"no manoeuvre of {self.request.duration:g} s stays within the limits, {option} is exceeded "
            f"most{why}: raise it, or plan a shorter manoeuvre"
        )
