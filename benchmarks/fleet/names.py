"""How often the name is right: craft with known drifts, all that was said of them counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from undertow.fleet.changes import (
    ChangeTests,
    Day,
    SpanTest,
    Statement,
    by_month,
    days_of,
    shift,
    statements,
    trend,
)
from undertow.fleet.reduction import Job, Panel, reduce_runs, with_fingerprint

from .made import THRUSTERS, days, folder_with_vehicle, fouling, run

_SEED = 1000


class Drift(NamedTuple):
    """What changes by the end, and how it may be called."""

    words: str
    end: Mapping[str, float]
    right: tuple[str, ...]


DRIFTS = (
    Drift("nothing", {}, ()),
    Drift("all drag +20%", fouling(0.2), ("fouling", "drag")),
    Drift("all drag +50%", fouling(0.5), ("fouling", "drag")),
    Drift("port thruster -10%", {"gain_error_port": -0.1}, ("thruster wear",)),
    Drift("all thrusters -15%", {f"gain_error_{n}": -0.15 for n in THRUSTERS}, ("thruster wear",)),
    Drift(
        "all drag +30%, bow thruster -20%",
        fouling(0.3) | {"gain_error_bow": -0.2},
        ("fouling", "drag", "thruster wear"),
    ),
    Drift("3 kg of water in the hull of 20 kg", {"m_w": 3.0}, ("added mass", "entrained_water")),
    Drift("velocity sensor +8%", {"scale_velocity": 0.08}, ("sensor_scale",)),
    Drift("drag in yaw +40%", {"N_r": 0.4}, ("drag",)),
    Drift("quadratic drag in surge +40%", {"X_uabsu": 0.4}, ("drag",)),
    Drift("added mass in sway +20%", {"Y_vdot": 0.2}, ("added mass",)),
)


def counted(seeds: int = 4) -> dict[str, Counter[str]]:
    """For each drift how often the name was right, wrong, or none was given."""
    with TemporaryDirectory() as name:
        craft = folder_with_vehicle(Path(name))
        panel = with_fingerprint(Job(str(craft)))[1]
        found = {}
        for drift in DRIFTS:
            said = (_said(panel, craft, drift, _SEED + seed) for seed in range(seeds))
            found[drift.words] = Counter(_grade(s, drift) for own in said for s in own)
        return found


def _grade(statement: Statement, drift: Drift) -> str:
    if statement.answer != "grew":
        return statement.answer
    return "right" if set(statement.effects) <= set(drift.right) else "wrong"


def _said(panel: Panel, craft: Path, drift: Drift, seed: int) -> list[Statement]:
    return statements(asked(panel, logged(panel, craft, drift.end, seed)))


def logged(
    panel: Panel, craft: Path, end: Mapping[str, float], seed: int, months: int = 3, each: int = 4
) -> list[Day]:
    """Days on which a drift grows in proportion to time, to `end` on the last."""
    random, dates = np.random.default_rng(seed), days(months, each)
    length = (dates[-1] - dates[0]).days
    shares = [(day - dates[0]).days / length for day in dates]
    runs = [run(craft, {n: v * share for n, v in end.items()}, random) for share in shares]
    return days_of((d, reduce_runs([r], panel, "day")) for d, r in zip(dates, runs, strict=True))


def asked(panel: Panel, own: list[Day]) -> list[SpanTest]:
    """All days, then every month against the first."""
    changes, months = ChangeTests(panel), list(by_month(own).values())
    spans = [trend(own), *(shift(months[0], later) for later in months[1:])]
    return [SpanTest(changes, span, tuple(changes.over(span))) for span in spans]


def table(found: Mapping[str, Counter[str]]) -> str:
    """As Markdown."""
    kinds = ("right", "cannot tell", "none seen", "wrong")
    rows = [f"| {words} | {' | '.join(str(own[k]) for k in kinds)} |" for words, own in found.items()]
    return "\n".join([f"| what drifts | {' | '.join(kinds)} |", "| --- | ---: | ---: | ---: | ---: |", *rows])
