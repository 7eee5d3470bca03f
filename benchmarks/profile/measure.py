"""Diagnoses whose processor time is looked at, stage by stage."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from undertow.errors import UndertowError
from undertow.identification import diagnose as module
from undertow.identification.diagnosis import rounds, search
from undertow.identification.diagnosis.candidates import candidates
from undertow.identification.doctor import examine
from undertow.identification.estimation import data
from undertow.model.catalogue import Catalogue, catalogue

from .case import HIDDEN, Material, material
from .clock import OTHER, Place, processor_seconds, sampled

SIZES = (5, 10, 20)
_ACTIONS = (
    (examine, "examine", "doctor: signs, frames, clocks, units"),
    (rounds, "_screened", "search: every effect, tried in the weak form"),
    (rounds, "_tried", "search: promising effects, fitted"),
    (rounds, "_final", "search: leading effects, judged under their noise"),
    (search, "_rivals", "search: alternatives"),
    (search, "search", "search: the model as it is, and effects together"),
    (data, "prepare", "reading out velocities, weak form, noise"),
    (module, "diagnose", "judging and wording the result, by simulation"),
)


@dataclass(frozen=True)
class Profile:
    """What one diagnosis took.

    Attributes
    ----------
    modules : dict
        CPU seconds by module of undertow and stage.
    named : list of str
        What was found missing.
    """

    modules: dict[Place, float]
    named: list[str]

    @property
    def stages(self) -> dict[str, float]:
        """CPU seconds by stage, the longest first."""
        found: dict[str, float] = defaultdict(float)
        for (_, stage), seconds in self.modules.items():
            found[stage] += seconds
        return dict(sorted(found.items(), key=lambda one: -one[1]))

    @property
    def by_module(self) -> list[tuple[str, dict[str, float]]]:
        """Seconds of every module by stage, the busiest module first."""
        found: dict[str, dict[str, float]] = defaultdict(dict)
        for (name, stage), seconds in self.modules.items():
            found[name][stage] = seconds
        return sorted(found.items(), key=lambda one: -sum(one[1].values()))


@cache
def warmed_up() -> None:
    """Compile what the case needs, so that the cache holds it."""
    found(subset(1))


def stages() -> dict[Place, str]:
    """Functions of the diagnosis that are stages of it, the innermost first."""
    for where, name, _ in _ACTIONS:
        if not hasattr(where, name):
            raise UndertowError(f"{where.__name__} has no {name}: say in benchmarks/profile what it is now")
    return {(w.__name__.removeprefix("undertow."), name): words for w, name, words in _ACTIONS}


def profiled(known: Catalogue) -> Profile:
    """Diagnose the case with these effects; what helper processes do is not seen."""
    vehicle, train, test = material()
    with sampled(stages()) as modules:
        outcome = module.diagnose(vehicle, train, test, known=known)
    inside = {place: t for place, t in modules.items() if place[1] != OTHER}
    return Profile(inside, list(outcome.diagnosis.effects))


def found(known: Catalogue, logs: Callable[[], Material] = material) -> list[str]:
    """What a diagnosis with these effects names."""
    vehicle, train, test = logs()
    return list(module.diagnose(vehicle, train, test, known=known).diagnosis.effects)


def seconds(known: Catalogue) -> float:
    """Processor time of a diagnosis with these effects, without a profiler."""
    began = processor_seconds()
    found(known)
    return processor_seconds() - began


def subset(size: int) -> Catalogue:
    """So many effects that can be tried, the hidden one among them, with all that the vehicle has."""
    everything, possible = catalogue(), effects_to_try()
    chosen = [HIDDEN, *(e for e in possible if e != HIDDEN)][:size]
    return {i: cls for i, cls in everything.items() if i in chosen or i not in possible}


def effects_to_try() -> list[str]:
    """Ids of all effects that the model may lack."""
    return [c.id for c in candidates(material()[0], catalogue())]


def sizes() -> list[int]:
    """Numbers of effects: 5, 10 and so on, at last all of them."""
    return [*(n for n in SIZES if n < len(effects_to_try())), len(effects_to_try())]


def growth() -> dict[int, float]:
    """Processor seconds against the number of effects tried."""
    return {size: seconds(subset(size)) for size in sizes()}
