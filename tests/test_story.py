"""The page of the story and that of hulls at the surface say what was measured."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from benchmarks.shape.floating import RESULTS
from benchmarks.shape.floating import page as floating_page
from benchmarks.story.page import TEXT

pytestmark = pytest.mark.docs
DOCS = Path(__file__).parents[1] / "docs"


def test_the_story_has_every_step_and_its_words() -> None:
    reported = (DOCS / "story.md").read_text(encoding="utf-8")
    for words in re.split(r"\{[a-z ]+\}", TEXT.read_text(encoding="utf-8")):
        assert words.strip() in reported
    commands = re.findall(r"^\$ undertow (\S+)", reported, re.MULTILINE)
    expected = (
        "added-mass tank tank vehicle design gains simulate simulate diagnose add gains "
        "design gains simulate export"
    )
    assert commands == expected.split()
    assert "UNSTABLE" in reported
    assert "all come back" in reported


def test_the_page_of_hulls_at_the_surface_says_what_was_measured() -> None:
    stored = json.loads(RESULTS.read_text(encoding="utf-8"))
    assert floating_page(stored) == (DOCS / "floating.md").read_text(encoding="utf-8")
    # A cylinder against WAMIT: panels err at its sharp edge.
    for row in stored["cylinder"]:
        assert row["values"][0] == pytest.approx(
            row["wamit"][0], rel=0.015 if row["motion"] == "surge" else 0.07
        )
