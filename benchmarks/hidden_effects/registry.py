"""The one dictionary of hidden effects, and the dice their sizes are drawn with."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .drawing import Vehicle
from .vehicles import NOMINAL
from .world import World


def those(able: Callable[[Vehicle], bool]) -> tuple[str, ...]:
    """Names of the vehicles for which something holds."""
    return tuple(name for name, vehicle in NOMINAL.items() if able(vehicle))


def with_motions(*needed: int) -> tuple[str, ...]:
    """Names of the vehicles that have all these degrees of freedom (0 surge ... 5 yaw)."""
    return those(lambda vehicle: set(needed) <= set(vehicle.dofs))


ALL = tuple(NOMINAL)
SUBMERGED = with_motions(2)
SURGING = with_motions(0)
TURNING = with_motions(0, 1, 5)
COUPLED = those(lambda vehicle: bool(vehicle.couplings))
TILTING = those(lambda vehicle: vehicle.tilts)


@dataclass(frozen=True)
class Draw:
    """Random values of one effect; `strength` multiplies sizes, never shapes (angles, periods, positions)."""

    rng: np.random.Generator
    strength: float

    def size(self, low: float, high: float, most: float = np.inf) -> float:
        """Strength times a log-uniform value, at most `most`: weak, medium and strong are equally likely."""
        drawn = float(np.exp(self.rng.uniform(np.log(low), np.log(high))))
        return min(self.strength * drawn, max(most, drawn))

    def signed(self, low: float, high: float, most: float = np.inf) -> float:
        """A size of either sign."""
        value = self.size(low, high, most)
        return value if self.rng.random() < 0.5 else -value

    def shape(self, low: float, high: float) -> float:
        """A uniform value that strength does not touch."""
        return float(self.rng.uniform(low, high))

    def pick(self, options: Sequence[int]) -> int:
        """One of the options."""
        return int(options[int(self.rng.integers(len(options)))])

    def some(self, options: Sequence[int]) -> list[int]:
        """A random, never empty part of the options, in their order."""
        kept = self.rng.permutation(len(options))[: self.rng.integers(1, len(options) + 1)]
        return [int(options[i]) for i in sorted(kept)]


#: Kinds of effects with which nothing is missing in the prior model.
NOTHING_HIDDEN = ("prior", "disturbance")
Values = dict[str, float]
Apply = Callable[[World, Draw], Values]


@dataclass(frozen=True)
class HiddenEffect:
    """One effect: name, id in the catalogue (None: in none), vehicles, and what it does to a world.

    `kind` is "library" (in the catalogue), "alien" (in none), or one of `NOTHING_HIDDEN`: "prior" (a guess is
    wrong) and "disturbance" (random forces that no model foretells).
    """

    name: str
    catalogue: str | None
    kind: str
    vehicles: tuple[str, ...]
    apply: Apply

    @property
    def equation(self) -> str:
        """First paragraph of the docstring: the physics in a sentence."""
        first = inspect.cleandoc(self.apply.__doc__ or "").split("\n\n")[0]
        return " ".join(first.split())


EFFECTS: dict[str, HiddenEffect] = {}


def hidden(
    name: str, vehicles: tuple[str, ...] = ALL, *, kind: str = "library", catalogue: str | None = None
) -> Callable[[Apply], Apply]:
    """Decorator that puts a function `apply(world, draw) -> values` into `EFFECTS`."""

    def enter(apply: Apply) -> Apply:
        listed = (catalogue or name) if kind == "library" else None
        EFFECTS[name] = HiddenEffect(name, listed, kind, vehicles, apply)
        return apply

    return enter
