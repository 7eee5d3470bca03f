"""The pages of the file formats: generated from the schemas, with examples that can be read."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs._ext.formats_page import EXAMPLES, KINDS, PAGES, page
from undertow.control.guidance.mission import load_mission
from undertow.identification.logs.mapping import read_mapping
from undertow.model.loading import load_vehicle

DOCS = Path(__file__).parents[1] / "docs"


@pytest.mark.parametrize("name", PAGES)
def test_the_page_is_up_to_date(name: str) -> None:
    text = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    assert text == page(name), f"docs/{name}.md is out of date; run: python docs/_ext/formats_page.py docs"


@pytest.mark.parametrize("name", ["vehicle-file", "mapping-file", "mission-file"])
def test_every_key_of_a_file_has_a_meaning(name: str) -> None:
    rows = [line for line in page(name).splitlines() if line.startswith("| `")]
    assert len(rows) > 15
    assert not [row for row in rows if row.endswith("|  |")]


@pytest.mark.parametrize("kind", KINDS)
def test_the_examples_are_files_that_fit_each_other(kind: str) -> None:
    vehicle = load_vehicle(EXAMPLES / f"{kind}.toml")
    mapping = read_mapping(EXAMPLES / f"{kind}-log.toml")
    assert load_mission(EXAMPLES / f"{kind}-mission.toml").points.shape[1] == 3
    channels = {column.channel for column in mapping.columns.values()}
    assert channels >= set(vehicle.command_names)
    assert any(value.estimate for value in vehicle.values.values())
