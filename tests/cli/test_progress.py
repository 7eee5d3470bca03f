"""Progress where stderr is no terminal: a line from time to time."""

from __future__ import annotations

import pytest

from undertow.cli import _terminal


def test_who_follows_a_file_sees_how_far_the_work_is(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line in half a minute, with the share of what there is to do."""
    clock = iter([0.0, 1.0, 31.0, 31.0, 40.0])
    monkeypatch.setattr(_terminal, "monotonic", lambda: next(clock))
    with _terminal.progress("reading logs", total=4.0) as report:
        report(1.0, "")
        report(2.0, "reading dive2.bin")
        report(3.0, "")
    captured = capsys.readouterr()
    assert captured.err == "reading dive2.bin: 50%\n"
    assert captured.out == ""
