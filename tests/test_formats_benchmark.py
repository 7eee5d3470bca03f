"""The table of commands and formats in docs/field-logs.md: it stands there as made, and still holds."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

# Private: the commands that are quick, in place of all.
from benchmarks.formats.__main__ import BEGIN, COMMANDS, END, RESULTS, _tried, real_table, table
from benchmarks.formats.made import KINDS

PAGE = Path(__file__).parents[1] / "docs" / "field-logs.md"


@pytest.mark.docs
def test_the_page_has_what_the_commands_said() -> None:
    known = json.loads(RESULTS.read_text(encoding="utf-8"))
    assert {kind.name for kind in KINDS} < {*known}
    assert all({*known[kind.name]} == {command.title for command in COMMANDS} for kind in KINDS)
    made = PAGE.read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
    assert made == table(known) + real_table(known["real"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dive-2026-05-01.bin", "dive-2026-05-01.nc", "dive-2026-05-01.alog"])
def test_commands_still_say_so(tmp_path: Path, name: str) -> None:
    known = json.loads(RESULTS.read_text(encoding="utf-8"))
    (kind,) = (one for one in KINDS if one.name == name)
    quick = [c for c in COMMANDS if c.title not in ("`diagnose`", "`plan`", "`add`")]
    said = _tried(kind, tmp_path, quick)
    assert said == {c.title: known[name][c.title] for c in quick}
