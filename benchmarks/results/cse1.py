"""C/S Enterprise I: identified on one run, judged on another, held against towing and bollard tests."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from undertow.identification.compare.comparison import compare
from undertow.identification.diagnose import diagnose
from undertow.identification.diagnosis.result import Diagnosis
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.run import Run
from undertow.identification.report.data import RunTraces
from undertow.identification.report.tables import traces
from undertow.model.loading import load_vehicle

from .additions import Addition, added
from .basin import Array, Basin, at, dead_band, drag, thrust
from .reading import Report, read
from .text import RANKING_HEAD, VERDICT_HEAD, chance, listed, number, percent, ranked, table
from .words import DELAY, DRAG, FALLING, THRUST

EXAMPLE = Path(__file__).parents[2] / "examples" / "cse1"
RUNS = ("manual_random_run1", "manual_random_run3")
#: Dead time that the providers of the data found by hand (README of the data), s.
DELAY_BY_HAND = 0.30
CHAINS = (
    ("thruster_deadband",),
    ("actuation_delay",),
    ("thruster_deadband", "actuation_delay"),
)
SURGE_SPEEDS = np.array([-0.4, -0.3, -0.2, -0.1, 0.1, 0.2, 0.3, 0.4])
SWAY_SPEEDS = np.array([-0.2, -0.15, -0.1, -0.05, 0.05, 0.1, 0.15, 0.2])
SETPOINTS = np.array([-1.0, -0.6, -0.3, -0.1, 0.1, 0.3, 0.6, 1.0])
_SHOWN = 5


@dataclass(frozen=True)
class Direction:
    """One way round.

    Attributes
    ----------
    train, test : Run
        What was fitted to, and what was judged by.
    diagnosis : Diagnosis
    additions : list of Addition
        The model as it is and with the chains of effects.
    """

    train: Run
    test: Run
    diagnosis: Diagnosis
    additions: list[Addition]

    @property
    def best(self) -> Addition:
        """The addition with the lowest error on the kept-aside run."""
        return min(self.additions, key=lambda a: a.error)

    @property
    def title(self) -> str:
        """Which run was fitted to."""
        return f"{self.train.name} → {self.test.name}"


def run_both(data: Path, report: Report) -> list[Direction]:
    """Identify on one run and judge on the other, both ways."""
    vehicle = load_vehicle(str(EXAMPLE / "vehicle.toml"))
    mapping = read_mapping(EXAMPLE / "log.toml")
    runs = read([data / "freerun" / f"{name}.csv" for name in RUNS], vehicle, mapping)
    found = []
    for i, (train, test) in enumerate([runs, runs[::-1]]):
        at_share = lambda done, words, i=i: report((i + 0.7 * done) / 2, words)  # noqa: E731
        diagnosis = diagnose(vehicle, [train], [test], report=at_share).diagnosis
        report((i + 0.7) / 2, "adding dead band and delay by hand")
        found.append(Direction(train, test, diagnosis, added(vehicle, [train], [test], CHAINS)))
    return found


# --- tables -----------------------------------------------------------------------------------
def section(directions: list[Direction], basin: Basin) -> str:
    """All tables."""
    parts = [
        _verdicts(directions),
        *(_ranking(d) for d in directions),
        FALLING,
        *(_falling(d) for d in directions),
        *_truth(directions, basin),
    ]
    return "\n".join(parts)


def _verdicts(directions: list[Direction]) -> str:
    return table(VERDICT_HEAD, [_verdict(d) for d in directions], left=3)


def _verdict(d: Direction) -> list[str]:
    g = d.diagnosis
    left = [f"{r.degree_of_freedom} {number(r.residual_rms, 2)} {r.unit} rms" for r in g.remaining]
    errors = " → ".join(number(s.error) for s in g.steps)
    ahead = " → ".join(percent(s.prediction) for s in g.steps)
    tried = listed(g.effects) if g.effects else f"none (tried: {listed(g.steps[-1].added)})"
    return [d.title, g.verdict, tried, errors, ahead, "; ".join(left), number(g.seconds, 2)]


def _ranking(d: Direction) -> str:
    rows = [ranked(r) for r in d.diagnosis.ranking if r.parameters]
    rest = len(d.diagnosis.ranking) - len(rows)
    if not rows:
        return f"Candidates, {d.title}: none of {rest} helps.\n"
    title = f"Candidates, {d.title} ({rest} more do not help):\n\n"
    return title + table(RANKING_HEAD, rows[:_SHOWN], left=2)


def _falling(d: Direction) -> str:
    names = [f"{n} / noise" for n in ("surge", "sway", "yaw")]
    head = ("model", "kept-aside error", *names, "5 s ahead", "p", "dead band", "delay [s]")
    return f"{d.title}:\n\n" + table(head, [_step(a) for a in d.additions])


def _step(a: Addition) -> list[str]:
    parts = [number(p) for p in a.parts]
    p = chance(a.p_value) if a.effects else ""
    own = [a.value(n) or ("0" if e in a.effects else "") for n, e in _OWN]
    return [" + ".join(["model", *a.effects]), number(a.error), *parts, percent(a.ahead), p, *own]


_OWN = (("deadband_width", "thruster_deadband"), ("delay", "actuation_delay"))


def _truth(directions: list[Direction], basin: Basin) -> list[str]:
    best = [d.best.vehicle for d in directions]
    named = [f"on {d.train.name}, with {' + '.join(d.best.effects) or 'nothing added'}" for d in directions]
    surge = _forces("u [m/s]", SURGE_SPEEDS, basin.surge, [drag(v, "u", SURGE_SPEEDS) for v in best], named)
    sway = _forces("v [m/s]", SWAY_SPEEDS, basin.sway, [drag(v, "v", SWAY_SPEEDS) for v in best], named)
    both, port, bow = ("u1", "u3"), ("u2",), ("u5",)
    pushes = [
        _forces("set-point", SETPOINTS, basin.vsp_surge, [thrust(v, both, SETPOINTS) for v in best], named),
        _forces("set-point", SETPOINTS, basin.vsp_sway, [thrust(v, port, SETPOINTS) for v in best], named),
        _forces("set-point", _BOW, basin.bow, [thrust(v, bow, _BOW) for v in best], named),
    ]
    return [
        "### Drag against the towing tests\n",
        _drag_in_words(directions, basin),
        "Surge force X(u), N:\n",
        surge,
        "Sway force Y(v), N:\n",
        sway,
        "### Thrust against the bollard tests\n",
        _thrust_in_words(directions, basin),
        "Both Voith Schneider propellers together, surge, N:\n",
        pushes[0],
        "Port propeller, sway, N:\n",
        pushes[1],
        "Bow thruster, N:\n",
        pushes[2],
        "### Dead band, slope and delay\n",
        _numbers(directions, basin),
        DELAY,
    ]


def _drag_in_words(directions: list[Direction], basin: Basin) -> str:
    """How identified drag compares, as ratios over the speeds of the tables."""
    lines = []
    for motion, axis, points, speeds in (
        ("surge", "u", basin.surge, SURGE_SPEEDS),
        ("sway", "v", basin.sway, SWAY_SPEEDS),
    ):
        found = [drag(d.best.vehicle, axis, speeds) for d in directions]
        lines += _ratios(motion, directions, found, points, speeds, "towing force", "m/s")
    return "\n".join([*lines, "", DRAG])


def _thrust_in_words(directions: list[Direction], basin: Basin) -> str:
    """How identified thrust compares, as ratios over the larger set-points."""
    lines = []
    large = np.array([0.6, 0.8, 1.0])
    for name, thrusters, points in (
        ("both propellers, surge ahead", ("u1", "u3"), basin.vsp_surge),
        ("port propeller, sway to starboard", ("u2",), basin.vsp_sway),
        ("bow thruster", ("u5",), basin.bow),
    ):
        found = [thrust(d.best.vehicle, thrusters, large) for d in directions]
        lines += _ratios(name, directions, found, points, large, "bollard force", "of the set-point")
    return "\n".join([*lines, "", THRUST])


def _ratios(
    name: str,
    directions: list[Direction],
    found: list[Array],
    measured: Array,
    values: Array,
    force: str,
    unit: str,
) -> Iterator[str]:
    where = f"over {abs(values).min():g} to {abs(values).max():g} {unit}"
    for d, forces in zip(directions, found, strict=True):
        ratio = forces / at(measured, values)
        times = f"{ratio.min():.1f} to {ratio.max():.1f} times the {force}"
        yield f"- {name}, identified on {d.train.name}: {times} {where}."


_BOW = np.array([0.2, 0.4, 0.6, 0.8, 1.0])


def _forces(what: str, values, measured, models, names) -> str:  # type: ignore[no-untyped-def]
    columns = [at(measured, values), *models]
    rows = [[f"{v:g}", *(f"{c[i]:.2f}" for c in columns)] for i, v in enumerate(values)]
    return table((what, "measured", *names), rows, left=0)


def _numbers(directions: list[Direction], basin: Basin) -> str:
    curves = {
        "surge (each propeller)": (basin.vsp_surge, ("u1", "u3")),
        "port sway": (basin.vsp_sway, ("u2",)),
        "bow": (basin.bow, ("u5",)),
    }
    rows = []
    for name, (curve, thrusters) in curves.items():
        slope, width = dead_band(curve)
        found = [" / ".join(_thrust_value(d.best, t) for t in thrusters) for d in directions]
        rows.append([f"slope, {name} [N per set-point]", number(slope / len(thrusters)), *found])
        rows.append([f"dead band, {name}", number(width), *_values(directions, "deadband_width")])
    rows.append(["delay [s]", f"{DELAY_BY_HAND:.2f} (by hand)", *_values(directions, "delay")])
    measured = "bollard tests, line through set-points 0.3 to 0.9"
    head = ("", measured, *(f"identified on {d.train.name}" for d in directions))
    return table(head, rows)


def _values(directions: list[Direction], name: str) -> list[str]:
    return [d.best.value(name) or "not in the model" for d in directions]


def _thrust_value(a: Addition, thruster: str) -> str:
    return a.value(f"thrust_{thruster}") or number(a.vehicle.value_of(f"thrust_{thruster}").value)


# --- pictures ---------------------------------------------------------------------------------
def shown_run(d: Direction) -> RunTraces:
    """The kept-aside run, measured and simulated over windows by the model before and after the additions."""
    first, best = d.additions[0].vehicle, d.best.vehicle
    found = traces(compare(first, [d.test]), compare(best, [d.test]))[0]
    velocities = tuple(t for t in found.traces if t.channel in best.velocity_names)
    return RunTraces(found.run, velocities, found.how)
