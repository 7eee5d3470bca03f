"""docs/closed-loops.md: its first table is what the program gives now, and the rest is there."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.closed_loops.page import run_table
from benchmarks.closed_loops.pictures import NAMES
from benchmarks.closed_loops.runs import READINGS, SIX, paper_run
from undertow.model.loading import load_vehicle

pytestmark = pytest.mark.docs

PAGE = Path(__file__).parents[2] / "docs" / "closed-loops.md"


@pytest.fixture(scope="module")
def page() -> str:
    return PAGE.read_text(encoding="utf-8")


def cells(table: str) -> list[list[str]]:
    return [[c.strip() for c in line.split("|")[1:-1]] for line in table.splitlines() if line.startswith("|")]


def test_the_table_of_the_paper_s_run_is_current(page: str) -> None:
    """All but the last digits: what is left of PD after 240 s, 1e-12 of the move, is rounding."""
    now, shown = cells(run_table([r.result for r in paper_run()])), cells(page)
    begin = shown.index(now[0])
    for row, there in zip(now, shown[begin:], strict=False):
        assert [c for i, c in enumerate(row) if i != 5] == [c for i, c in enumerate(there) if i != 5]
        if row[5].endswith((" m", " rad")):
            assert float(row[5].split()[0]) == pytest.approx(float(there[5].split()[0]), abs=1e-5)


def test_every_reading_is_reported_and_none_is_as_the_paper_says(page: str) -> None:
    rows = {row[0]: row for row in cells(page)}
    assert [r.words for r in READINGS if r.words not in rows] == []
    assert {rows[r.words][-1] for r in READINGS} == {"no"}
    assert page.count("not reproduced") >= 4


def test_the_pictures_are_there_and_nothing_is_left_to_fill_in(page: str) -> None:
    shown = [line.partition("](")[2].rstrip(")") for line in page.splitlines() if line.startswith("![")]
    assert sorted(shown) == sorted(f"images/closed-loops-{name}.png" for name in NAMES)
    assert [name for name in shown if not (PAGE.parent / name).is_file()] == []
    assert "{" not in page


def test_what_is_assumed_of_six_degrees_of_freedom_is_marked() -> None:
    vehicle = load_vehicle(SIX)
    assumed = {name for name, value in vehicle.values.items() if value.assumed}
    assert assumed == {"Y_vdot", "Y_v", "K_pdot", "M_qdot", "K_p", "M_q", "S_z"}
    assert vehicle.degrees_of_freedom == ("surge", "sway", "heave", "roll", "pitch", "yaw")
