"""docs/gains.md: every line of output on the page is one that the program prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from undertow.cli.main import main

pytestmark = pytest.mark.docs

PAGE = (Path(__file__).parents[2] / "docs" / "gains.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```\n\$ undertow (.*?)\n(.*?)```", PAGE, re.DOTALL)


def test_the_page_shows_output() -> None:
    assert len(BLOCKS) == 4


@pytest.mark.parametrize(("command", "shown"), BLOCKS, ids=[command for command, _ in BLOCKS])
def test_lines_on_the_page_are_printed(
    command: str, shown: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "300")
    assert main(command.split()) in (0, 1)
    printed = " \n ".join(" ".join(line.split()) for line in capsys.readouterr().out.splitlines())
    missing = [line for line in shown.splitlines() if " ".join(line.split()) not in printed]
    assert missing == []


def test_factors_in_the_text() -> None:
    """17 and 29 times K_V, 0.65 and 0.41 times K_I, from the numbers of the output."""
    factors = [round(0.0859646 / 0.005), round(0.144785 / 0.005)]
    assert f"{factors[0]} times (forward) or {factors[1]} times" in PAGE
    assert f"{1.93594 / 3:.2f} or {1.22172 / 3:.2f} times the K_I" in PAGE
