"""The CFD box: identified on one force profile, judged on the other."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import undertow
from undertow.identification.compare.comparison import regimes
from undertow.identification.compare.forces import residual_forces
from undertow.identification.diagnose import diagnose
from undertow.identification.diagnosis.result import Diagnosis
from undertow.identification.estimation.data import prepare
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

from .additions import Addition, added
from .reading import Report, read
from .text import MISSING, RANKING_HEAD, VERDICT_HEAD, chance, number, percent, ranked, table

PROFILES = ("step", "multistep")
BEGINNING = "first 3 s, from rest"
REGIMES = (BEGINNING, "start-up", "coasting", "reversing", "thrust positive", "thrust negative")
_BEGINNING = 3.0
#: Added by hand, whatever the verdict; the last is the one that the README of the data suspects.
CHAINS = (("constant_force",), ("drag_asymmetry",), ("radiation_memory",))
MAPPING = Path(undertow.__file__).parent / "demo_data" / "cfd-surge" / "log.toml"


@dataclass(frozen=True)
class Failure:
    """Force that a model lacks in a regime, and that noise alone gives, N rms; number of test functions."""

    force: float
    noise: float
    count: int


@dataclass(frozen=True)
class Way:
    """One way round: what the diagnosis said, and where the refitted model and the best one fail."""

    title: str
    diagnosis: Diagnosis
    before: dict[str, Failure]
    after: dict[str, Failure] | None
    additions: list[Addition]
    memory: dict[str, Failure]


def run_both(data: Path, report: Report) -> list[Way]:
    """Identify on one profile and judge on the other, both ways."""
    vehicle = load_vehicle("box-hull")
    mapping = read_mapping(MAPPING)
    runs = read([data / f"surge_{name}_coarse.csv" for name in PROFILES], vehicle, mapping)
    found = []
    for i, (train, test) in enumerate([runs, runs[::-1]]):
        reported = lambda done, words, i=i: report((i + done) / 2, words)  # noqa: E731
        outcome = diagnose(vehicle, [train], [test], report=reported)
        before = failures(outcome.before, test)
        after = failures(outcome.after, test) if outcome.diagnosis.effects else None
        more = added(vehicle, [train], [test], CHAINS)
        memory = failures(more[-1].vehicle, test)
        title = f"{PROFILES[i]} → {PROFILES[1 - i]}"
        found.append(Way(title, outcome.diagnosis, before, after, more, memory))
    return found


def failures(vehicle: Vehicle, run: Run) -> dict[str, Failure]:
    """Where a model fails on a run, also in regimes too short for the error map of `undertow compare`."""
    data = prepare([run], vehicle)
    forces = residual_forces(vehicle, [run], data)
    inside = {r.name: r.inside[:, 0] for r in regimes(forces, vehicle, data.sigma)}
    inside[BEGINNING] = forces.t < run.t[0] + _BEGINNING
    return {
        name: Failure(_rms(forces.missing[mask, 0]), _rms(forces.noise[mask, 0]), int(mask.sum()))
        for name, mask in inside.items()
        if mask.any()
    }


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def section(ways: list[Way]) -> str:
    """All tables."""
    parts = [table(VERDICT_HEAD, [_verdict(w) for w in ways], left=3)]
    parts += [*(f"- {w.title}: {w.diagnosis.headline}" for w in ways), "", *(_ranking(w) for w in ways)]
    parts.append("Effects added by hand with all their parameters, whatever the verdict:\n")
    parts += [_falling(w) for w in ways]
    head = ("regime of the kept-aside profile", *_columns(ways))
    parts.append(
        "Force that the model lacks on the kept-aside profile, N rms (in brackets: times what the noise of "
        "the channels alone gives; number of test functions):\n\n" + table(head, list(_regimes(ways)))
    )
    return "\n".join(parts)


def _verdict(w: Way) -> list[str]:
    d = w.diagnosis
    remains = "; ".join(f"{number(r.residual_rms, 2)} {r.unit} rms, {r.note}" for r in d.remaining)
    errors = " → ".join(number(s.error) for s in d.steps)
    ahead = " → ".join(percent(s.prediction) for s in d.steps)
    tried = d.steps[-1].added
    named = ", ".join(d.effects) or f"none (tried: {', '.join(tried) or 'nothing helps'})"
    return [w.title, d.verdict, named, errors, ahead, remains, number(d.seconds, 2)]


def _ranking(w: Way) -> str:
    rows = [ranked(r) for r in w.diagnosis.ranking]
    return f"Every candidate, {w.title}:\n\n" + table(RANKING_HEAD, rows, left=2)


def _falling(w: Way) -> str:
    head = ("model", "parameters", "kept-aside error of the force", "5 s ahead", "p")
    return f"{w.title}:\n\n" + table(head, [_step(a) for a in w.additions], left=2)


def _step(a: Addition) -> list[str]:
    names = [f"{n} = {a.value(n)}" for n in a.fit.values]
    p = chance(a.p_value) if a.effects else ""
    return [" + ".join(["model", *a.effects]), ", ".join(names), number(a.error), percent(a.ahead), p]


def _columns(ways: list[Way]) -> Iterator[str]:
    for w in ways:
        yield f"{w.title}: refitted"
        if w.after is not None:
            yield f"{w.title}: with {' + '.join(w.diagnosis.effects)}"
        yield f"{w.title}: with {' + '.join(CHAINS[-1])}"


def _regimes(ways: list[Way]) -> Iterator[list[str]]:
    for regime in REGIMES:
        tables = [t for w in ways for t in (w.before, w.after, w.memory) if t is not None]
        yield [regime, *(_cell(t, regime) for t in tables)]


def _cell(table: dict[str, Failure], regime: str) -> str:
    if regime not in table:
        return MISSING
    f = table[regime]
    return f"{number(f.force)} ({number(f.force / f.noise)}; {f.count})"
