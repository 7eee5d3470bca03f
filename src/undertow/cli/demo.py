"""Tell the whole story on shipped logs: where models fail, what is missing, and the error falling.

First an AUV whose model lacks something, then a box hull in a flow solver that no simple model explains.
Pictures, reports and vehicle files go into a folder; index.html there has it all.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from jinja2 import Environment, StrictUndefined
from numpy.typing import NDArray
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from undertow.files import write_whole
from undertow.identification.compare.comparison import compare
from undertow.identification.compare.forces import Forces, residual_forces
from undertow.identification.diagnose import DiagnosisResult, diagnose
from undertow.identification.diagnosis.addition import (
    Addition,
    AdditionSetup,
    add_effect,
    set_up_addition,
    visible_effects,
)
from undertow.identification.diagnosis.settings import Settings
from undertow.identification.figures import unit_text
from undertow.identification.report.data import ErrorMap
from undertow.identification.report.page import render_report
from undertow.identification.report.pictures import (
    error_map,
    falling_error,
    measured_vs_simulated,
    residual_against,
)
from undertow.identification.report.tables import traces
from undertow.model.catalogue import catalogue
from undertow.model.loading import resolve_vehicle
from undertow.model.symbols import VELOCITY
from undertow.model.vehicle import Vehicle

from ._terminal import progress
from ._vehicle_and_logs import load
from .diagnose import write_vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undertow.identification.diagnose import DiagnosisResult
    from undertow.identification.report.data import ReportData, RunTraces

    from ._vehicle_and_logs import Loaded


_OUT = typer.Option("--out", metavar="FOLDER", help="Folder for what is written; it is made.")


def demo(out: Annotated[Path, _OUT] = Path("demo-output")) -> None:
    from undertow.files import check_folder

    check_folder(out)
    scene = Scene(out)
    tell_auv(scene)
    tell_hull(scene)
    scene.end()


DATA = Path(str(files("undertow") / "demo_data"))


def report_data_of(outcome: DiagnosisResult) -> ReportData:
    """What a report draws, without a compiler: for a minute of data compiling takes longer than it saves."""
    from undertow.identification.compare.comparison import compare
    from undertow.identification.report.tables import report_data

    before = compare(outcome.before, outcome.test, compiled=False)
    after = compare(outcome.after, outcome.test, compiled=False) if outcome.diagnosis.effects else None
    return report_data(before, after, names=("refitted", " ".join(["with", *outcome.diagnosis.effects])))


@dataclass
class Part:
    """One part of the story, in the order in which it was told: (kind, content)."""

    title: str
    told: list[tuple[str, Any]] = field(default_factory=list)


class Scene:
    """Tells, and writes files into one folder.

    Parameters
    ----------
    folder : Path
        Where files go; it is made.
    console : Console, optional
        The terminal.
    """

    def __init__(self, folder: Path, console: Console | None = None) -> None:
        self.folder = folder
        self._console = console or Console(highlight=False)
        self._parts: list[Part] = []

    def title(self, text: str) -> None:
        """Begin a part."""
        self._parts.append(Part(text))
        self._console.print(f"\n[bold]{escape(text)}[/bold]")

    def say(self, text: str) -> None:
        """A plain sentence or two."""
        self._parts[-1].told.append(("text", text))
        self._console.print(escape(text))

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
        """A table in words; the first column is its side."""
        self._parts[-1].told.append(("table", (head, rows)))
        table = Table()
        for i, name in enumerate(head):
            table.add_column(escape(name), justify="right" if i else "left")
        for row in rows:
            table.add_row(*map(escape, row))
        self._console.print(table)

    def picture(self, name: str, picture: Figure, what: str) -> None:
        """Write a picture (PNG) that the page shows."""
        from undertow.identification.figures import save_png

        save_png(picture, self._place(name))
        self._parts[-1].told.append(("picture", (name, what)))

    def text(self, name: str, content: str, what: str) -> None:
        """Write a file that the page refers to."""
        write_whole(self._place(name), content)
        self.mention(name, what)

    def mention(self, name: str, what: str) -> None:
        """Refer to a file that has been written."""
        self._parts[-1].told.append(("file", (name, what)))

    def path(self, name: str) -> Path:
        """Where a file of this name goes."""
        return self._place(name)

    def end(self) -> None:
        """Write the page that has it all, and say where things are."""
        environment = Environment(
            autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
        )
        page = environment.from_string(_PAGE).render(parts=self._parts)
        write_whole(self._place("index.html"), page)
        self._console.print(
            f"\n[bold]All of this, with pictures: {escape(str(self.folder / 'index.html'))}[/bold]"
        )
        for name, what in self._written():
            place = escape(str(self.folder / name))
            self._console.print(f"  {place}  [dim]{escape(what)}[/dim]", soft_wrap=True)

    def _written(self) -> list[Any]:
        return [content for part in self._parts for kind, content in part.told if kind in ("file", "picture")]

    def _place(self, name: str) -> Path:
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        return path


_PAGE = """\
<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>undertow demo</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
       color: #1a1c1e; background: #fff; }
img { max-width: 100%; height: auto; }
figure { margin: 1.5rem 0; }
figcaption { color: #555; }
table { border-collapse: collapse; margin: 1rem 0; }
th, td { border-bottom: 1px solid #ccc; padding: .25rem .75rem; text-align: right; }
th:first-child, td:first-child { text-align: left; }
</style>
<h1>undertow demo</h1>
{% for part in parts %}
<h2>{{ part.title }}</h2>
{% for kind, content in part.told %}
{% if kind == "text" %}
<p>{{ content }}</p>
{% elif kind == "table" %}
<table>
<tr>{% for cell in content[0] %}<th>{{ cell }}</th>{% endfor %}</tr>
{% for row in content[1] %}
<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}
</table>
{% elif kind == "picture" %}
<figure><img src="{{ content[0] }}" alt="{{ content[1] }}"><figcaption>{{ content[1] }}</figcaption></figure>
{% else %}
<p><a href="{{ content[0] }}">{{ content[0] }}</a>: {{ content[1] }}</p>
{% endif %}
{% endfor %}
{% endfor %}
</html>
"""


_FOLDER = DATA / "auv"


def tell_auv(scene: Scene) -> None:
    """Where the model fails, what it lacks, and how the error falls."""
    scene.title("1. An AUV whose model lacks something")
    runs = [_FOLDER / f"train_{i}.csv.gz" for i in (1, 2, 3)]
    loaded = load(str(_FOLDER / "vehicle.toml"), runs, [_FOLDER / "holdout.csv.gz"])
    scene.say(
        "A small AUV with four thrusters was logged in three runs of a minute; a fourth run is kept aside. "
        "Its vehicle file has mass, added mass, damping and restoring, with guesses good to 15 %."
    )
    comparison = compare(loaded.vehicle, loaded.holdout, compiled=False)
    scene.say(f"Where the model fails on the kept-aside run: it {comparison.result.headline}.")
    with progress("looking for what is missing") as report:
        outcome = diagnose(loaded.vehicle, loaded.train, loaded.holdout, report=report)
    _verdict(scene, outcome)
    _pictures(scene, outcome)
    if outcome.diagnosis.effects:
        _added(scene, loaded, outcome)
    _truth(scene)


def _verdict(scene: Scene, outcome: DiagnosisResult) -> None:
    d = outcome.diagnosis
    scene.say(
        f"Every effect of the catalogue that could be added was tried ({len(d.ranking)} of them), each "
        f"refitted with the rest of the model. Verdict: {d.headline}"
    )
    for p in d.parameters:
        if p.effect in d.effects:
            error = "" if p.standard_error is None else f" ± {p.standard_error:.1g}"
            scene.say(f"{p.effect}: {p.name} = {p.value:.4f}{error} {p.unit}")
    for warning in d.warnings:
        scene.say(f"Without it, the fit had bent the model: {warning}.")
    scene.text("auv/diagnosis.json", d.model_dump_json(indent=1) + "\n", "the diagnosis, for programs")


def _pictures(scene: Scene, outcome: DiagnosisResult) -> None:
    data = report_data_of(outcome)
    names = (data.before, data.after)
    scene.text("auv/report.html", render_report(outcome.diagnosis, data), "the full report")
    drawn = {
        "error-map": (error_map(data.maps[0], names), "where force is missing, by motion and regime"),
        "measured-vs-simulated": (
            measured_vs_simulated(_velocities(data.runs[0]), names),
            "the kept-aside run, simulated from its commands alone",
        ),
        "residual-force": (_sway(data, names), "force that the model lacks in sway, against the variables"),
    }
    for name, (picture, what) in drawn.items():
        scene.picture(f"auv/{name}.png", picture, what)


def _velocities(run: RunTraces) -> RunTraces:
    return replace(run, traces=tuple(t for t in run.traces if t.channel in VELOCITY))


def _sway(data: ReportData, names: tuple[str, str]) -> Any:
    return residual_against([c for c in data.residuals if c.degree_of_freedom == "sway"], names)


def _added(scene: Scene, loaded: Loaded, outcome: DiagnosisResult) -> None:
    """The effect goes into a new vehicle file, and the error falls."""
    d = outcome.diagnosis
    write_vehicle(outcome, loaded.path, scene.path("auv/vehicle.toml"), "undertow demo")
    scene.mention("auv/vehicle.toml", f"the vehicle file with {' and '.join(d.effects)} in it")
    setup = set_up_addition(loaded.vehicle, loaded.train, loaded.holdout)
    addition = add_effect(catalogue()[d.effects[0]], setup)
    names = ("model as given", "refitted", f"with {addition.effect}")
    rows = [
        (name, f"{step.error:.3g}", f"{step.prediction or 0.0:.1%}")
        for name, step in zip(names, addition.steps, strict=True)
    ]
    scene.say("The error on the kept-aside run falls (1 is the noise of the sensors):")
    scene.table(("model", "error / noise", "velocity error 5 s ahead"), rows)
    scene.picture("auv/falling-error.png", falling_error(addition.steps), "the error on the kept-aside run")


def _truth(scene: Scene) -> None:
    """What was hidden, read only now that all has been said."""
    values = json.loads((_FOLDER / "truth.json").read_text(encoding="utf-8"))["values"]
    hidden = "; ".join(
        f"{effect} with {', '.join(f'{name} = {value:.4f}' for name, value in own.items())}"
        for effect, own in values.items()
    )
    scene.say(f"To check: the log was simulated, apart from undertow's own models, with {hidden} (m/s).")


_HULL_FOLDER = DATA / "cfd-surge"
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
    setup : AdditionSetup
        Logs and the fitted model of inertia and drag.
    outcome : DiagnosisResult
        The diagnosis.
    additions : dict of Addition
        Every effect that these logs could show, put into the model, by its id.
    """

    profile: str
    other: str
    setup: AdditionSetup
    outcome: DiagnosisResult
    additions: dict[str, Addition]

    @property
    def name(self) -> str:
        """How tables call it."""
        return f"{self.profile} → {self.other}"

    @cached_property
    def plain(self) -> Vehicle:
        """The fitted model of inertia and drag."""
        return self.setup.bench.base.vehicle

    @cached_property
    def without(self) -> float:
        """Velocity error ahead of the model of inertia and drag."""
        return self.setup.ahead(self.plain)

    def ahead(self, effect: str) -> float:
        """Velocity error ahead with an effect in the model."""
        return self.additions[effect].after.prediction or 0.0

    def missing(self, vehicle: Vehicle) -> Forces:
        """Force that a model lacks on the profile that judges."""
        return residual_forces(vehicle, self.setup.test)


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
    logs = [_HULL_FOLDER / f"surge_{name}_coarse.csv.gz" for name in (profile, other)]
    loaded = load(_VEHICLE, logs[:1], logs[1:], map=_HULL_FOLDER / "log.toml")
    setup = set_up_addition(loaded.vehicle, loaded.train, loaded.holdout)
    additions = [add_effect(cls, setup) for cls in visible_effects(setup, catalogue())]
    outcome = diagnose(loaded.vehicle, loaded.train, loaded.holdout)
    return Way(profile, other, setup, outcome, {a.effect: a for a in additions})


# --- where the model fails ------------------------------------------------------------------------
def _where(scene: Scene, ways: tuple[Way, Way]) -> None:
    found = [_phases(way.missing(way.plain)) for way in ways]
    rows = [
        (phase, *(f"{f[phase]:.2f} N" if phase in f else "–" for f in found)) for phase in found[0] | found[1]
    ]
    push = max(float(np.max(np.abs(r.channels["tau_X"]))) for way in ways for r in way.setup.test)
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
    prior = ways[0].setup.vehicle.value_of("X_udot")
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
        t = Settings().t_in_search
        reason = f"it does not help, or none of its parameters is {t:g} standard errors from zero"
        return f"{text}: by the force on one of the other profiles {reason}."
    return f"{text}: it wants the effect to explain {Settings().named_share:.0%} of what exceeds the noise."


def _runs(scene: Scene, ways: tuple[Way, Way], best: str) -> None:
    for way in ways:
        models = (way.plain, way.additions[best].fit.vehicle)
        before, after = (compare(v, way.setup.test, compiled=False) for v in models)
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
