"""Second part of the demo: a box hull in a flow solver, which inertia and drag do not explain."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from undertow.cli._outcome import write_vehicle
from undertow.cli._progress import progress
from undertow.cli._vehicle_and_logs import load
from undertow.identification.compare.comparison import compare
from undertow.identification.compare.forces import Forces, residual_forces
from undertow.identification.compare.shown import traces
from undertow.identification.diagnosis.addition import (
    Addition,
    Ground,
    add_effect,
    lay_ground,
    visible_effects,
)
from undertow.identification.diagnosis.diagnose import Outcome, diagnose
from undertow.identification.diagnosis.trial import T_KEEP
from undertow.identification.diagnosis.verdict import NAMED_SHARE
from undertow.identification.report import ErrorMap, error_map, measured_vs_simulated, render_report
from undertow.identification.report.style import unit_text
from undertow.model.catalogue import catalogue
from undertow.model.loading import resolve_vehicle
from undertow.model.vehicle import Vehicle

from .scene import DATA, Scene, report_data_of

_FOLDER = DATA / "cfd-surge"
_VEHICLE = "box-hull"
_PROFILES = ("step", "multistep")
# Share of an error by which it must change to be worth a word.
_FELT = 0.05
_START = 3.0
_NO_PUSH = 0.01


@dataclass(frozen=True)
class Way:
    """One way round: identified on one force profile, judged on the other.

    Attributes
    ----------
    profile, other : str
        Profile that was fitted to, and profile that judges.
    ground : Ground
        Logs and the fitted model of inertia and drag.
    outcome : Outcome
        The diagnosis.
    additions : dict of Addition
        Every effect that these logs could show, put into the model, by its id.
    """

    profile: str
    other: str
    ground: Ground
    outcome: Outcome
    additions: dict[str, Addition]

    @property
    def name(self) -> str:
        """How tables call it."""
        return f"{self.profile} → {self.other}"

    @cached_property
    def plain(self) -> Vehicle:
        """The fitted model of inertia and drag."""
        return self.ground.bench.base.vehicle

    @cached_property
    def without(self) -> float:
        """Velocity error ahead of the model of inertia and drag."""
        return self.ground.ahead(self.plain)

    def ahead(self, effect: str) -> float:
        """Velocity error ahead with an effect in the model."""
        return self.additions[effect].after.prediction or 0.0

    def missing(self, vehicle: Vehicle) -> Forces:
        """Force that a model lacks on the profile that judges."""
        return residual_forces(vehicle, self.ground.test)


def tell_hull(scene: Scene) -> None:
    """Where inertia and drag fail, which effects lower the error both ways round, and what remains."""
    scene.title("2. A box hull in a flow solver")
    scene.say(
        "A Navier-Stokes solver pushed a box hull through water: no formula made these data. The "
        "model is inertia with linear and quadratic drag. It is identified on one profile of the push and "
        "judged on the other, then the other way round."
    )
    with progress("both ways round") as report:
        report(0.0, "step, judged on multistep")
        first = _way(*_PROFILES)
        report(0.5, "multistep, judged on step")
        ways = (first, _way(*reversed(_PROFILES)))
    _where(scene, ways)
    _verdicts(scene, ways)
    best = _effects(scene, ways)
    if best:
        _most(scene, ways, best)
    _files(scene, ways)


def _way(profile: str, other: str) -> Way:
    logs = [_FOLDER / f"surge_{name}_coarse.csv.gz" for name in (profile, other)]
    loaded = load(_VEHICLE, logs[:1], logs[1:], map=_FOLDER / "log.toml")
    ground = lay_ground(loaded.vehicle, loaded.train, loaded.holdout)
    additions = [add_effect(cls, ground) for cls in visible_effects(ground, catalogue())]
    outcome = diagnose(loaded.vehicle, loaded.train, loaded.holdout)
    return Way(profile, other, ground, outcome, {a.effect: a for a in additions})


# --- where the model fails ------------------------------------------------------------------------
def _where(scene: Scene, ways: tuple[Way, Way]) -> None:
    found = [_phases(way.missing(way.plain)) for way in ways]
    rows = [
        (phase, *(f"{f[phase]:.2f} N" if phase in f else "–" for f in found)) for phase in found[0] | found[1]
    ]
    push = max(float(np.max(np.abs(r.channels["tau_X"]))) for way in ways for r in way.ground.test)
    scene.say(f"Force that the fitted model lacks on the other profile (rms; the push reaches {push:.2g} N):")
    scene.table(("phase", *(way.name for way in ways)), rows)
    for way, forces in zip(ways, found, strict=True):
        worst = max(forces, key=lambda phase: forces[phase])
        scene.say(f"Fitted to {way.profile} and judged on {way.other} it fails most in: {worst}.")


def _phases(forces: Forces) -> dict[str, float]:
    push, speed = forces.commands[:, 0], forces.velocity[:, 0]
    coasting = np.abs(push) <= _NO_PUSH * np.max(np.abs(push))
    against = ~coasting & (push * speed < 0)
    start = ~coasting & ~against & (forces.t < forces.t.min() + _START)
    masks = {
        "start-up (first 3 s)": start,
        "pushed along": ~coasting & ~against & ~start,
        "coasting": coasting,
        "reversal (push against the motion)": against,
    }
    return {name: _rms(forces.missing[mask, 0]) for name, mask in masks.items() if mask.any()}


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


# --- what is said about it ------------------------------------------------------------------------
def _verdicts(scene: Scene, ways: tuple[Way, Way]) -> None:
    for way in ways:
        scene.say(
            f"Diagnosis, identified on {way.profile}, judged on {way.other}: {way.outcome.diagnosis.headline}"
        )


def _effects(scene: Scene, ways: tuple[Way, Way]) -> str:
    """Say what each effect does both ways round; the one that lowers the error most, or nothing."""
    tried = [i for i in ways[0].additions if i in ways[1].additions]
    ids = [i for i in tried if any(abs(way.ahead(i) / way.without - 1.0) > _FELT for way in ways)]
    ids.sort(key=lambda i: sum(way.ahead(i) / way.without for way in ways))
    rows = [(i, *(f"{way.ahead(i):.1%}" for way in ways)) for i in ids]
    scene.say(
        "What each effect does to the velocity error 5 s ahead on the profile that it was not fitted to:"
    )
    plain = ("inertia and drag alone", *(f"{way.without:.1%}" for way in ways))
    scene.table(("with", *(way.name for way in ways)), [plain, *rows])
    if len(ids) < len(tried):
        scene.say(f"{len(tried) - len(ids)} more change it by less than {_FELT:.0%}.")
    scene.picture("hull/effects.png", _chart(ways, ids), "velocity error 5 s ahead on the other profile, %")
    lower = [i for i in ids if all(way.ahead(i) < (1.0 - _FELT) * way.without for way in ways)]
    clear = [i for i in lower if all(way.additions[i].helps for way in ways)]
    scene.say(f"Lower both ways round: {', '.join(lower) or 'none'}.")
    scene.say(f"Lower beyond chance, by the residual force of both profiles: {', '.join(clear) or 'none'}.")
    return lower[0] if lower else ""


def _chart(ways: tuple[Way, Way], ids: list[str]) -> Any:
    table = [[way.without for way in ways], *([way.ahead(i) for way in ways] for i in ids)]
    rows = ("inertia and drag alone", *ids)
    regimes = tuple(way.name for way in ways)
    chart = ErrorMap(rows, regimes, 100 * np.array(table), quantity="velocity error [%]", floor=None)
    return error_map(chart, ("fitted to one profile → judged on the other", ""))


def _most(scene: Scene, ways: tuple[Way, Way], best: str) -> None:
    """What the effect that lowers the error most does to the parameters, and what remains with it."""
    prior = ways[0].ground.vehicle.value_of("X_udot")
    plain = " and ".join(f"{-way.plain.value_of('X_udot').value:.1f}" for way in ways)
    fits = [way.additions[best].fit for way in ways]
    helped = " and ".join(f"{-fit.values['X_udot']:.1f}" for fit in fits)
    scene.say(
        f"Without {best} the two profiles give {plain} kg of added mass for the same hull, with it {helped} "
        f"kg; potential theory, which the fits take as a prior, gives {-prior.value:.1f} kg."
    )
    for name in ways[0].additions[best].kept:
        told = [
            f"{fit.values[name]:.2f} ± {fit.standard_errors[name]:.1g}" for fit in fits if name in fit.values
        ]
        scene.say(f"{best}, {name}: {' and '.join(told)} {_unit(fits[0].vehicle, name)}")
    left = [_rms(w.missing(fit.vehicle).missing[:, 0]) for w, fit in zip(ways, fits, strict=True)]
    before = [_rms(w.missing(w.plain).missing[:, 0]) for w in ways]
    falls = " and ".join(f"from {b:.2f} to {a:.2f} N" for b, a in zip(before, left, strict=True))
    scene.say(f"With it the force that is missing falls {falls} rms.")
    if not all(best in way.outcome.diagnosis.effects for way in ways):
        scene.say(_unnamed(ways, best))
    scene.say("What is left is not noise, for these logs have next to none: it stays unexplained.")
    _runs(scene, ways, best)


def _unit(vehicle: Vehicle, name: str) -> str:
    return unit_text(vehicle.declared_parameters[name].unit)


def _unnamed(ways: tuple[Way, Way], best: str) -> str:
    """Why a lower error alone does not make the diagnosis name an effect."""
    listed = [r for way in ways for r in way.outcome.diagnosis.ranking if r.effect == best]
    text = f"All the same {best} is not what the diagnosis names as missing both ways round"
    if any(not r.parameters for r in listed):
        reason = f"it does not help, or none of its parameters is {T_KEEP:g} standard errors from zero"
        return f"{text}: by the force on one of the other profiles {reason}."
    return f"{text}: it wants the effect to explain {NAMED_SHARE:.0%} of what exceeds the noise."


def _runs(scene: Scene, ways: tuple[Way, Way], best: str) -> None:
    for way in ways:
        models = (way.plain, way.additions[best].fit.vehicle)
        before, after = (compare(v, way.ground.test, compiled=False) for v in models)
        picture = measured_vs_simulated(
            traces(before, after, free=True)[0], ("inertia and drag", f"with {best}")
        )
        what = f"{way.other}, simulated from its push alone by models fitted to {way.profile}"
        scene.picture(f"hull/{way.other}.png", picture, what)


def _files(scene: Scene, ways: tuple[Way, Way]) -> None:
    for way in ways:
        d, name = way.outcome.diagnosis, f"hull/{way.profile}-to-{way.other}"
        text = render_report(d, report_data_of(way.outcome))
        scene.text(f"{name}.html", text, f"full report: fitted to {way.profile}, judged on {way.other}")
        scene.text(f"{name}.json", d.model_dump_json(indent=1) + "\n", "the same for programs")
        if d.effects:
            write_vehicle(way.outcome, resolve_vehicle(_VEHICLE), scene.path(f"{name}.toml"), "undertow demo")
            scene.mention(f"{name}.toml", f"the vehicle file with {' and '.join(d.effects)}")
