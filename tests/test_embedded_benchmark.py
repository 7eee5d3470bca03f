"""Exported C on an emulated Cortex-M4: its numbers against ours, what is counted, the table of the page."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.embedded import board
from benchmarks.embedded.__main__ import BEGIN, CALLS, END, Call, libraries, measured, table
from benchmarks.shell import in_page
from tests.quick import first_quick
from undertow.codegen import Functions, Simulator
from undertow.codegen.library import Library

PAGE = Path(__file__).parents[1] / "docs" / "export.md"
SINGLE = "-DMINI_AUV_SINGLE"
emulated = pytest.mark.skipif(
    bool(board.missing()), reason=f"needs {', '.join(board.missing())}: apt-get install {board.PACKAGES}"
)


@cache
def _auv() -> Library:
    return libraries()["mini_auv"]


def _sources(part: str) -> list[str]:
    own = [f"src/mini_auv_{p}.c" for p in {part, *(["vehicle"] if part == "jacobians" else [])}]
    return [f"examples/{part}/main.c", *own]


@emulated
@pytest.mark.parametrize(("flags", "digits"), first_quick([((), 1e-10), ((SINGLE,), 2e-4)]))
def test_the_example_on_the_board_moves_the_vehicle_as_the_simulator_does(
    flags: tuple[str, ...], digits: float, tmp_path: Path
) -> None:
    folder = _auv().write(tmp_path).folder
    head, *rows = board.run(board.build(folder, _sources("vehicle"), *flags)).split()
    f, t = Functions(_auv().vehicle), 0.02 * np.arange(501)
    assert head.split(",") == ["t", *f.state_names]
    found = np.array([row.split(",") for row in rows], dtype=float)
    u = np.tile([1, 0.5, 0.333, 0.25], (t.size, 1))
    x = Simulator(f, compiled=False).run(np.zeros(f.x.numel()), t, u, np.array(f.values()))[::25]
    np.testing.assert_allclose(found[:, 1:], x, rtol=digits, atol=digits * np.abs(x).max())
    assert np.abs(x[-1]).max() > 1.0


@emulated
@pytest.mark.slow
@pytest.mark.parametrize("part", ["jacobians", "thrusters", "paper_pid", "usbl_ekf", "usbl_ukf"])
def test_every_example_prints_on_the_board_what_it_prints_here(part: str, tmp_path: Path) -> None:
    folder = _auv().write(tmp_path).folder
    for flags, digits in (((), 1e-7), ((SINGLE,), 1e-3)):  # of nine that are printed
        command = ["cc", "-std=c99", "-ffp-contract=off", *flags, "-Isrc", *_sources(part), "-lm", "-o", part]
        subprocess.run(command, cwd=folder, check=True)
        here = subprocess.run([f"./{part}"], cwd=folder, check=True, capture_output=True, text=True).stdout
        there = board.run(board.build(folder, _sources(part), *flags))
        expected, found = (np.array(said.split(), dtype=float) for said in (here, there))
        np.testing.assert_allclose(found, expected, rtol=digits, atol=digits * np.abs(expected).max())


@emulated
def test_instructions_and_stack_are_counted(tmp_path: Path) -> None:
    """A thousand that do nothing, and a kilobyte that is written."""
    folder = _auv().write(tmp_path).folder
    call = Call("", "mini_auv", "real", "__asm__ volatile(" + '"nop\\n"' * 1000 + ");")
    (folder / "src/mini_auv_real.c").write_text('#include "mini_auv_real.h"\nint unused;\n')
    assert measured(call, folder).instructions == pytest.approx(1000, abs=3)
    writes = "volatile char bytes[1024]; for (int i = 0; i < 1024; i++) { bytes[i] = 0; }"
    assert 1024 <= measured(Call("", "mini_auv", "real", writes), folder).stack < 1200


@emulated
@pytest.mark.slow
def test_float_takes_less_than_double(tmp_path: Path) -> None:
    folder, call = _auv().write(tmp_path).folder, CALLS[0]
    single, double = measured(call, folder, SINGLE), measured(call, folder)
    assert single.instructions < double.instructions / 10
    assert single.flash < double.flash
    assert single.stack < double.stack
    assert table([(call, single, double)]).splitlines()[2].startswith(f"| {call.words} | ")


@pytest.mark.docs
def test_the_page_has_a_row_for_every_call() -> None:
    page = PAGE.read_text(encoding="utf-8")
    made = page.partition(BEGIN)[2].partition(END)[0]
    words = [line.split(" | ")[0].removeprefix("| ") for line in made.splitlines()[2:]]
    assert words == [call.words for call in CALLS]
    assert in_page(page, made, BEGIN, END) == page
