"""The hidden-effect cases: is what was hidden found, and is nothing found where nothing was hidden?"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.hidden_effects.conversion import convert_vehicles
from undertow.identification.diagnose import diagnose
from undertow.identification.diagnosis.result import Diagnosis
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.typing import Progress

from .reading import quiet, read
from .text import MISSING, errors, estimate, lengths, listed, number, table, within_runs

CASES = (
    "auv-null", "rov-null", "auv-current", "auv-deadband", "auv-heave-yaw-quadratic", "auv-lag",
    "rov-dvl-lever-arm", "rov-tether-drag", "rov-trim", "rov-weak-thruster", "usv-lift",
    "usv-current-and-wrong-drag", "rov-unlisted",
)  # fmt: skip
TRAINING = ("train_1.csv", "train_2.csv", "train_3.csv")


@dataclass(frozen=True)
class CaseResult:
    """One case after its diagnosis.

    Attributes
    ----------
    name : str
    kind : str
        `library`, `null` or `alien`, as in truth.json.
    truth : tuple of str
        What is hidden.
    diagnosis : Diagnosis
    """

    name: str
    kind: str
    truth: tuple[str, ...]
    diagnosis: Diagnosis

    @property
    def ranks(self) -> list[int]:
        """Places in the ranking of what is hidden, from 1; empty where the catalogue does not have it."""
        order = [r.effect for r in self.diagnosis.ranking]
        return [order.index(effect) + 1 for effect in self.truth if effect in order]

    @property
    def known(self) -> bool:
        """Whether the catalogue has all that is hidden."""
        return set(self.truth) <= set(catalogue())

    @property
    def judged(self) -> str:
        """`right`, `among the set` or `wrong`."""
        if self.kind == "null":
            return _said(self.diagnosis.verdict == "adequate")
        if not self.known:
            return _said(self.diagnosis.verdict == "unexplained")
        sets = [set(s.effects) for s in self.diagnosis.indistinguishable]
        named = set(self.diagnosis.effects)
        if any(set(self.truth) & s for s in sets):
            return "among the set"
        return _said(set(self.truth) == named)


def _said(right: bool) -> str:
    return "right" if right else "wrong"


def run_case(data: Path, name: str, report: Progress = quiet) -> CaseResult:
    """Diagnose one case.

    Parameters
    ----------
    data : Path
        Folder of the data set, with vehicles.json and one folder per case.
    name : str
        The case.
    report : callable
        Given what share is done, and what is being done.
    """
    truth = json.loads((data / name / "truth.json").read_text(encoding="utf-8"))
    with TemporaryDirectory() as folder:
        convert_vehicles(data / "vehicles.json", folder)
        vehicle = load_vehicle(str(Path(folder) / f"{truth['vehicle']}.toml"))
    train = read([data / name / log for log in TRAINING], vehicle)
    holdout = read([data / name / "holdout.csv"], vehicle)
    found = diagnose(vehicle, train, holdout, report=report).diagnosis
    # What is in no catalogue has no id: there the truth is described among the values.
    hidden = truth["effects"] or [text.partition(" (")[0] for text in truth["values"]]
    return CaseResult(name, truth["class"], tuple(hidden), found)


HEAD = (
    "case", "hidden", "verdict", "named or helping", "", "rank of the truth", "s ahead", "velocity error",
    "times the noise", "seconds",
)  # fmt: skip
WORDS = """\
## Simulated logs with one hidden effect

Thirteen cases of an independent simulator: 3 × 100 s to identify, 100 s to validate. The vehicle files have
exact rigid body and allocation, and guesses of added mass and damping good to 15%. `null`: nothing is
hidden, and `adequate` is right. An effect outside the catalogue should end in `unexplained`;
`helps_prediction` names no cause, but counts as wrong here.

Before → after the named effects (in brackets: after effects that were tried and not named), on the validation
run. Velocity error: of simulations from the measured state over horizons derived from the time constants of
the vehicle, in % of the motion. Times the noise: the residual force; 1 is the noise of the sensors.
"""


def section(results: Sequence[CaseResult]) -> str:
    """The table, the tally and what else was said."""
    right = sum(r.judged != "wrong" for r in results)
    parts = [
        WORDS,
        f"{right} of {len(results)} verdicts are right.\n",
        table(HEAD, [_row(r) for r in results], left=5),
        "In its own words:\n",
        "\n".join(f"- {r.name}: {r.diagnosis.headline}" for r in results) + "\n",
        _found_values(results),
    ]
    return "\n".join(p for p in parts if p)


def _row(r: CaseResult) -> list[str]:
    d = r.diagnosis
    first, last = d.steps[0], d.steps[-1]
    before, after = (within_runs(step.ahead) for step in (first, last))
    ahead = _change(errors(list(before.values())), errors([after.get(h) for h in before]), d)
    noise = _change(number(first.error), number(last.error), d)
    ranks = MISSING if not r.truth else ", ".join(map(str, r.ranks)) or "not in the catalogue"
    named = listed([*d.effects, *(f"{e} (helps)" for e in d.helps)])
    said = [r.name, listed(r.truth), d.verdict, named, r.judged, ranks]
    return [*said, lengths(before), ahead, noise, number(d.seconds, 2)]


def _change(before: str, after: str, d: Diagnosis) -> str:
    if len(d.steps) == 1:
        return before
    return f"{before} → {after}" if d.effects else f"{before} (→ {after})"


def _found_values(results: Sequence[CaseResult]) -> str:
    rows = []
    for r in results:
        wanted = set(r.diagnosis.effects)
        found = [p for p in r.diagnosis.parameters if p.effect in wanted and p.prior is None]
        if found:
            rows.append([r.name, ", ".join(estimate(p) for p in found)])
    return "Parameters of the named effects:\n\n" + table(("case", "found"), rows, left=2) if rows else ""
