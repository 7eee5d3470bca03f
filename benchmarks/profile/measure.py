"""Diagnoses with a clock in them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache

from undertow.identification import diagnose as module
from undertow.identification.diagnosis import rounds
from undertow.identification.diagnosis.candidates import candidates
from undertow.model.catalogue import Catalogue, catalogue

from .case import HIDDEN, material
from .clock import Clock, processor_seconds, sampled

SIZES = (5, 10, 20)
ACTIONS = {
    (module, "prepare"): "reading out velocities, weak form, noise",
    (module, "check_excitation"): "is anything moved?",
    (module, "examine"): "doctor: signs, frames, clocks, units",
    (module, "SimulationValidator"): "setting up simulations",
    (rounds, "_screened"): "search: every effect, tried in the weak form",
    (rounds, "_tried"): "search: promising effects, fitted",
    (rounds, "_final"): "search: leading effects, judged under their noise",
}
"""Stages that are functions of a module, by its name for them."""
TOLD = {
    "fitting the model as it is": "search: the model as it is",
    "looking at all effects together": "search: all effects together",
    "judging the result by simulation": "judging and wording the result, by simulation",
}
"""What the diagnosis reports, and the stage that begins with it."""


_FIRST, _THEN = ([stage for (where, _), stage in ACTIONS.items() if where is one] for one in (module, rounds))
_AS_IT_IS, *_LAST = TOLD.values()
_ORDER = (*_FIRST, _AS_IT_IS, *_THEN, *_LAST)


@dataclass(frozen=True)
class Profile:
    """What one diagnosis took.

    Attributes
    ----------
    wall, cpu : dict
        Seconds by stage, in order.
    modules : dict
        Seconds of the processor by module of undertow and stage.
    named : list of str
        What was found missing.
    """

    wall: dict[str, float]
    cpu: dict[str, float]
    modules: dict[tuple[str, str], float]
    named: list[str]


@cache
def warmed_up() -> None:
    """Compile what the case needs, so that the cache holds it."""
    profiled(subset(1))


def profiled(known: Catalogue) -> Profile:
    """Diagnose the case with these effects; what helper processes do is not seen."""
    clock = Clock()
    with _stages(clock), sampled(clock) as modules:
        vehicle, train, test = material()
        clock.begin("other")
        outcome = module.diagnose(
            vehicle, train, test, known=known, report=lambda _, words: _begin(clock, words)
        )
        clock.begin("")
    del clock.wall[""], clock.cpu[""]
    order = [s for s in (*_ORDER, "other") if s in clock.wall]
    wall, cpu = ({s: t[s] for s in order} for t in (clock.wall, clock.cpu))
    return Profile(wall, cpu, {k: v for k, v in modules.items() if k[1]}, list(outcome.diagnosis.effects))


def found(known: Catalogue) -> list[str]:
    """What a diagnosis with these effects names."""
    vehicle, train, test = material()
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


def _begin(clock: Clock, words: str) -> None:
    if words in TOLD:
        clock.begin(TOLD[words])


@contextmanager
def _stages(clock: Clock) -> Iterator[None]:
    """Functions of the diagnosis that tell the clock when they begin and end."""
    originals = {place: getattr(*place) for place in ACTIONS}
    for place, action in originals.items():
        setattr(*place, clock.during(ACTIONS[place], action))
    try:
        yield
    finally:
        for place, action in originals.items():
            setattr(*place, action)
