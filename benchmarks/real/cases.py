"""The plan: every log as it is, for the peers, with a term of its model taken out, with an effect put in."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

from benchmarks.trust.cases import mixed, seeded_generator
from undertow.model.vehicle import Vehicle

from .injections import INJECTIONS
from .logs import LogSet

#: A number that was not used while the program was developed.
BASE_SEED = 90417
KINDS = ("baseline", "prediction", "removal", "injection")
_AS_LOGGED, _PEERS, _WITHOUT = "as-logged", "peers", "without"


@dataclass(frozen=True)
class Case:
    """One case: the log set, what is changed, and by how much (in units of the scale of the log set)."""

    logs: str
    change: str
    size: float = 0.0

    @property
    def id(self) -> str:
        """All that makes the case, as one word."""
        return f"{self.logs}:{self.change}" + (f":{self.size:g}" if self.size else "")

    @property
    def kind(self) -> str:
        """One of `KINDS`."""
        own = {_AS_LOGGED: "baseline", _PEERS: "prediction"}
        return own.get(self.change, "removal" if self.removed else "injection")

    @property
    def removed(self) -> str:
        """Id of the effect that is taken out of the vehicle file; empty where none is."""
        return self.change.partition("-")[2] if self.change.startswith(f"{_WITHOUT}-") else ""

    @property
    def label(self) -> str:
        """What is changed."""
        return self.change

    @property
    def vehicle(self) -> str:
        """The log set, for records of cases that failed."""
        return self.logs

    @classmethod
    def read(cls, word: str, sets: Mapping[str, LogSet]) -> Case:
        """The case of an id."""
        logs, _, rest = word.partition(":")
        change, _, size = rest.partition(":")
        case = cls(logs, change, float(size or 0))
        known = logs in sets and (change in INJECTIONS or case.kind != "injection")
        if not known or case.id != word:
            raise ValueError(f"{word!r} is no case: ids look like cse1-joystick:current:0.25 (see list)")
        return case


def as_logged(logs: str) -> Case:
    """The log set as it is."""
    return Case(logs, _AS_LOGGED)


def plan(sets: Mapping[str, LogSet], seed: int = BASE_SEED) -> list[Case]:
    """Baselines, peers, removals, and injections so ordered that every beginning is a fair sample of them."""
    first = [as_logged(name) for name in sets] + [Case(name, _PEERS) for name in sets]
    removals = [Case(name, f"{_WITHOUT}-{effect}") for name, s in sets.items() for effect in s.removals]
    injections = [
        Case(name, change, size)
        for name, s in sets.items()
        for change in s.injections
        for size in INJECTIONS[change].sizes
    ]
    others = mixed([removals, injections], seeded_generator(seed, "real", 0))
    return first + [c for c in others if c.removed] + _balanced([c for c in others if not c.removed])


def ablated(sets: Mapping[str, LogSet]) -> list[Case]:
    """Every fifth case of the logs with one degree of freedom, whose diagnoses take seconds."""
    quick = [case for case in plan(sets) if case.logs.startswith(("box-", "roll-"))]
    return [case for case in quick if case.kind != "prediction"][::5]


def _balanced(injections: list[Case]) -> list[Case]:
    """Injections one by one, next the one whose kind of change, logs and size came least often so far.

    A kind counts twice, since there are twice as many of them as of logs.
    """
    left, came, found = list(injections), Counter[str](), list[Case]()
    while left:
        case = min(left, key=lambda c: (2 * came[c.change] + came[c.logs], came[_place(c)]))
        left.remove(case)
        came.update((case.change, case.logs, _place(case)))
        found.append(case)
    return found


def _place(case: Case) -> str:
    return str(INJECTIONS[case.change].sizes.index(case.size))


def without(vehicle: Vehicle, effect: str) -> Vehicle:
    """The vehicle without an effect, and without those that need it."""
    kept = tuple(e for e in vehicle.effects if e.id != effect and effect not in e.requires)
    if len(kept) == len(vehicle.effects):
        raise ValueError(f"vehicle {vehicle.name!r} has no effect {effect!r}: it has {[e.id for e in kept]}")
    left = {p.name for e in kept for p in e.parameters}
    gone = {p.name for e in vehicle.effects for p in e.parameters} - left
    sides = {name for name, (parameter, _) in vehicle.sides.items() if parameter.name in gone}
    values = {name: v for name, v in vehicle.values.items() if name not in gone | sides}
    return replace(vehicle, effects=kept, values=values)
