"""Eighty columns: a narrow terminal shows every number whole, and leaves nothing out."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.quick import quick_if
from undertow.cli._terminal import console, table, text, wrapped  # what all commands print with
from undertow.cli.main import main
from undertow.model.loading import bundled_vehicles

Capture = pytest.CaptureFixture[str]
NARROW, WIDE = 80, 400
GAINS = ("paper-pd", "paper-pid", "paper-smc")
AUV = Path(__file__).parents[2] / "src" / "undertow" / "demo_data" / "auv"
LOG = f"{AUV / 'vehicle.toml'} {AUV / 'train_1.csv.gz'}"

# Too buoyant or with too few thrusters to hover.
_STEADY = {"remus100": " --at u=1.5", "glider": " --free u --free w"}


def _commands() -> Iterator[str]:
    for vehicle in bundled_vehicles():
        yield from (f"gains {vehicle} {g}" for g in GAINS)
        yield from (f"{command} {vehicle}" for command in ("vehicles show", "audit"))
        yield f"linearize {vehicle}{_STEADY.get(vehicle, '')}"
    yield from (
        "vehicles",
        "effects",
        "effects show added_mass",
        "effects show lift",
        "audit",
        "audit-tables",
    )
    yield "gains mini-auv paper-pid --repair literal"
    yield "simulate mini-auv paper-pd paper-pid paper-smc --to -1,1,1 --for 2 --dt 0.01"
    yield "linearize mini-auv --gains paper-pd"
    yield f"compare {LOG}"
    yield f"doctor {LOG}"


def printed(words: str, columns: int, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setenv("COLUMNS", str(columns))
    capsys.readouterr()
    assert main(words.split()) in (
        (0, 1, 2) if words.startswith("gains") else (0, 1)
    )  # 2: gains of another vehicle
    return re.sub(r"\([\d.]+ s\)", "(time taken)", capsys.readouterr().out)


def numbers(out: str) -> Counter[str]:
    return Counter(re.findall(r"(?<![\w.])[-+]?\d[\d.]*(?:e[-+]?\d+)?i?(?!\w)", out))


# Of another vehicle, or what the longest of the kind prints, too.
_MORE = bundled_vehicles().keys() - {"mini-auv"}
_LIKE = (
    *(
        f"gains mini-auv {law}"
        for law in ("paper-pd", "paper-pid", "paper-smc", "paper-pid --repair literal")
    ),
    *("linearize mini-auv", "audit mini-auv", "effects show lift"),
    *("linearize mini-auv --gains paper-pd", "audit", f"compare {LOG}", f"doctor {LOG}"),
)


@pytest.mark.parametrize(
    "words",
    quick_if(lambda words: words not in _LIKE and not _MORE & {*words.split()}, _commands()),
    ids=lambda w: w.replace(str(AUV), "auv"),
)
def test_no_number_is_cut_at_80_columns(words: str, capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    """All numbers of a wide terminal are there in a narrow one, too; columns stay within it."""
    narrow, wide = (printed(words, columns, capsys, monkeypatch) for columns in (NARROW, WIDE))
    assert "…" not in narrow
    lost = numbers(wide) - numbers(narrow)
    assert not lost, f"cut or broken: {dict(lost)}"
    assert not re.search(r"(\+-|±|[<>=≻])\s*\n", narrow), "a line ends before the number it announces"


def test_columns_that_do_not_fit_stand_below_each_other(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    rows = [("surge", "-1.234567890123", "+0.003198 +- 0.038054i, -0.022529", "0.000594394")]
    console().print(table(("channel", "margin", "roots, 1/s", "bound"), rows))
    lines = capsys.readouterr().out.splitlines()
    assert lines == [
        "  channel",
        "  surge",
        "    margin: -1.234567890123",
        "    roots, 1/s: +0.003198 +- 0.038054i, -0.022529",
        "    bound: 0.000594394",
    ]


def test_words_of_one_column_are_wrapped_and_numbers_are_not(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    about = "largest value of the drag along the keel with roots at +0.003198 +- 0.038054i in all"
    console().print(table(("name", "value", "meaning"), [("X_u", "-0.142306", about)]))
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith("  X_u   -0.142306  largest value of")
    assert all(len(line) <= 60 for line in lines)
    assert any("+0.003198 +- 0.038054i" in line for line in lines)


def test_a_word_wider_than_the_terminal_is_left_whole(
    capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "30")
    long = "/a/path/of/a/log/that/is/far/longer/than/the/terminal/0.000594394.csv"
    console().print(table(("log", "rows"), [(long, "12")]))
    console().print(text(f"wrote {long}"))
    assert capsys.readouterr().out.count(long) == 2


@pytest.mark.parametrize("piece", ["0.514 > 0", "0.5 ± 0.01", "ι < 0.000594394", "+0.1 +- 0.2i"])
def test_what_belongs_to_a_number_stays_with_it(piece: str) -> None:
    for width in range(len(piece), 40):
        lines = wrapped(f"some words and {piece} and some more words", width)
        assert any(piece in line for line in lines), lines
