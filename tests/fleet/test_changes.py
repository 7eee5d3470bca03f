"""Which effect grew: on days with known drifts, and when it must not be said."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import cast

import numpy as np
import pytest

from benchmarks.fleet.made import folder_with_vehicle, fouling
from benchmarks.fleet.names import asked, logged
from undertow.fleet.changes import (
    Change,
    ChangeTests,
    Direction,
    Kind,
    Span,
    SpanTest,
    Statement,
    holm,
    statements,
    two_sided_p,
)
from undertow.fleet.diagnose import summary
from undertow.fleet.reduction import Job, Panel, with_fingerprint

Drift = Mapping[str, float]


@pytest.fixture(scope="module")
def craft(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return folder_with_vehicle(tmp_path_factory.mktemp("craft"))


@pytest.fixture(scope="module")
def panel(craft: Path) -> Panel:
    return with_fingerprint(Job(str(craft)))[1]


def said(panel: Panel, craft: Path, drift: Drift, seed: int, **more: int) -> list[Statement]:
    return statements(asked(panel, logged(panel, craft, drift, seed, **more)))


@pytest.mark.slow
def test_fouling_is_named_with_its_size(panel: Panel, craft: Path) -> None:
    own = asked(panel, logged(panel, craft, fouling(0.4), 1))
    statement = statements(own)[0]
    assert (statement.answer, statement.effects) == ("grew", ("fouling",))
    grown = {c.direction.name: c for c in own[0].changes}
    for motion in ("surge", "sway", "yaw"):
        change = grown[f"drag in {motion}"]
        assert change.value == pytest.approx(0.4, abs=4 * change.error)
        assert change.error < 0.04


@pytest.mark.slow
def test_wear_of_one_thruster_is_named_with_the_thruster(panel: Panel, craft: Path) -> None:
    for statement in said(panel, craft, {"gain_error_port": -0.2}, 2):
        assert (statement.answer, statement.effects) == ("grew", ("thruster wear",))
        assert "thrust of port -" in statement.words
        assert "starboard" not in statement.words


@pytest.mark.slow
def test_of_both_at_once_what_is_sure_is_named(panel: Panel, craft: Path) -> None:
    statement = said(panel, craft, fouling(0.4) | {"gain_error_bow": -0.3}, 3)[0]
    assert statement.answer == "grew"
    assert "thruster wear" in statement.effects
    assert "thrust of bow -" in statement.words
    assert "fouling" in statement.words


def test_nothing_is_named_where_nothing_changes(panel: Panel, craft: Path) -> None:
    own = logged(panel, craft, {}, 4)
    of = summary({"it": (panel, own)}).vehicles[0]
    assert {p.statement.answer for p in (*of.months[1:], of.whole)} == {"none seen"}
    for parameter in of.whole.parameters:
        stated = panel.vehicle.value_of(parameter.name).value
        assert parameter.value == pytest.approx(stated, abs=4.5 * parameter.error)
    assert all(score.p_value > 0.01 for score in of.scores)


@pytest.mark.slow
@pytest.mark.parametrize(
    "drift",
    [
        pytest.param({"m_w": 5.0}, id="water in the hull"),
        pytest.param({"scale_velocity": 0.15}, id="a velocity sensor that drifts", marks=pytest.mark.slow),
        pytest.param({"N_r": 0.4}, id="a bent fin: drag in yaw alone", marks=pytest.mark.slow),
        pytest.param(fouling(-0.3), id="a hull that was cleaned", marks=pytest.mark.slow),
    ],
)
def test_what_is_neither_is_called_neither(panel: Panel, craft: Path, drift: Drift) -> None:
    found = said(panel, craft, drift, 5)
    for statement in found:
        sure = statement.effects if statement.answer == "grew" else ()
        assert not {"fouling", "thruster wear"} & set(sure), statement
    assert found[0].answer != "none seen"


def test_two_days_a_month_tell_nothing(panel: Panel, craft: Path) -> None:
    statement = said(panel, craft, fouling(0.3), 6, months=2, each=2)[1]
    assert statement.answer == "cannot tell"
    assert "at least 3" in statement.words


def test_more_vehicles_ask_for_more() -> None:
    """What is significant alone need not be among a hundred."""
    assert holm([0.004, 0.5], 0.01) >= 0.004
    assert holm([0.004, *[0.5] * 100], 0.01) < 0.004
    assert holm([1e-9, 0.004, *[0.5] * 100], 0.01) == pytest.approx(0.01 / 101)


@pytest.mark.slow
def test_a_false_name_is_rare(panel: Panel, craft: Path) -> None:
    """Days of an unchanged craft in random order, a hundred reports: two false ones at the most."""
    own, random = logged(panel, craft, {}, 8, months=2, each=5), np.random.default_rng(0)
    names = 0
    for _ in range(100):
        order = random.permutation(len(own))
        mixed = [replace(own[i], day=d.day) for d, i in zip(own, order, strict=True)]
        names += any(s.answer == "grew" for s in statements(asked(panel, mixed)))
    assert names <= 2


def reported(*changes: tuple[Kind, str, float, float]) -> Statement:
    """What is said of changes of kind, place, value and error five days against five, among many others."""
    own = tuple(
        Change(Direction(kind, of, np.zeros(1)), value, error, 8.0, two_sided_p(value, error, 8.0))
        for kind, of, value, error in changes
    )
    still = tuple(Change(Direction("inertia", "surge", np.zeros(1)), 0.0, 1.0, 8.0, 1.0) for _ in range(500))
    span = Span((), lambda day: 0.0, (5, 5))
    return statements(
        [SpanTest(cast("ChangeTests", None), span, own), SpanTest(cast("ChangeTests", None), span, still)]
    )[0]


def test_none_seen_is_said_of_what_would_have_shown() -> None:
    """A narrow direction does not speak for another kind, nor for one that is nearly sure."""
    good: tuple[Kind, str, float, float] = ("thrust", "port", 0.001, 0.01)
    calm = reported(good, ("drag", "surge", 0.0, 0.02))
    assert calm.answer == "none seen"
    assert "smallest detectable changes, %: drag in surge 20, thrust of port 9.8" in calm.words
    likely = reported(good, ("drag", "surge", 0.41, 0.06))
    assert likely.answer == "cannot tell"
    assert "drag in surge +41 ± 6% may be a change, but is not significant" in likely.words
    blind = reported(good, ("drag", "surge", 0.0, 0.3))
    assert blind.answer == "cannot tell"
    assert "a change of drag in surge below" in blind.words
    assert "otherwise no change seen; smallest detectable changes, %: thrust of port" in blind.words
    none = reported(good, ("drag", "surge", 0.0, np.inf))
    assert none.words.startswith("cannot tell: these days do not determine drag; otherwise no change seen")
