"""Instructions, flash and stack of exported C on a Cortex-M4, run under QEMU; the table of docs/export.md.

python -m benchmarks.embedded             # prints the table
python -m benchmarks.embedded --page docs/export.md
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.shell import in_page
from undertow.codegen.library import Library
from undertow.control.gains import load_gains
from undertow.control.guidance.mission import load_mission
from undertow.control.update import library_of
from undertow.files import write_whole
from undertow.model.loading import load_vehicle
from undertow.observer.design import ObserverTable, design

from . import board

ROOT = Path(__file__).parents[2]
MISSIONS = ROOT / "examples" / "missions"
BEGIN, END = "<!-- made by python -m benchmarks.embedded -->\n", "<!-- end of what is made -->\n"
SENSORS = {
    "x": {"noise": "5 cm", "period": "1 s"},
    "y": {"noise": "5 cm", "period": "1 s"},
    "z": {"noise": "1 cm", "period": "0.2 s"},
    "psi": {"noise": "0.5 deg", "period": "0.1 s"},
}
DISTURBANCE = {"u": 0.01, "v": 0.01, "w": 0.01, "r": 0.02}


@dataclass(frozen=True)
class Call:
    """A call that is measured."""

    words: str  # what it is, for the table
    library: str  # by name in `libraries`
    part: str  # the module
    call: str  # with @ for the prefix of the module's functions and names
    also: tuple[str, ...] = ()  # other modules that it links
    before: str = ""  # statements before the first call


_STEP = "{}_vehicle_step(x, u, &{}_parameters_default, 0, (real)0.02);"
_JACOBIANS = "{}_jacobians(x, u, &{}_parameters_default, 0, a, b, c, d);"
_LAW = "@_step(y, r, s, &@_parameters_default, (real)0.02, u, s, tau);"
_ON_A_WAY = _LAW.replace("y, r,", "y, &@_mission_default,")
_PREDICT = "@_predict(x, P, u, &@_parameters_default, 0, (real)0.1, a, b);"
_UPDATE = "@_update_psi(x, P, u, &@_parameters_default, 0, (real)0.1);"
_RESTS, _KNOWS = "@_start(s);", "@_start(x, P, &@_parameters_default);"
_AUV, _ROV, _TORPEDO = "mini_auv", "bluerov2", "remus100"
CALLS = (
    Call("mini-auv (4): one Runge-Kutta step", _AUV, "vehicle", _STEP.replace("{}", _AUV)),
    Call("its Jacobians", _AUV, "jacobians", _JACOBIANS.replace("{}", _AUV), ("vehicle",)),
    Call("thrust to command, one thruster", _AUV, "thrusters", "a[0] = mini_auv_command(0, 1, &@_default);"),
    Call("PID with gate and allocation, one sample", _AUV, "paper_pid", _LAW, before=_RESTS),
    Call("extended Kalman filter, prediction", _AUV, "usbl_ekf", _PREDICT, before=_KNOWS),
    Call("the same, one report", _AUV, "usbl_ekf", _UPDATE, before=_KNOWS),
    Call("unscented Kalman filter, prediction", _AUV, "usbl_ukf", _PREDICT, before=_KNOWS),
    Call("the same, one report", _AUV, "usbl_ukf", _UPDATE, before=_KNOWS),
    Call("remus100 (6): one Runge-Kutta step", _TORPEDO, "vehicle", _STEP.replace("{}", _TORPEDO)),
    Call("ILOS and PID with fins, one sample", _TORPEDO, "remus100_pid", _ON_A_WAY, before=_RESTS),
    Call("bluerov2 (6): one Runge-Kutta step", _ROV, "vehicle", _STEP.replace("{}", _ROV)),
    Call("its Jacobians", _ROV, "jacobians", _JACOBIANS.replace("{}", _ROV), ("vehicle",)),
    Call("PD on a spline, eight thrusters with limits", _ROV, "bluerov2_pd", _ON_A_WAY, before=_RESTS),
)


@dataclass(frozen=True)
class Cost:
    """What a call costs on the board: instructions, bytes of flash of its module, bytes of stack."""

    instructions: int
    flash: int
    stack: int


def libraries() -> dict[str, Library]:
    """The exported libraries."""
    auv = load_vehicle("mini-auv")
    content = {"schema": "undertow/observer/1", "sensors": SENSORS, "disturbance": DISTURBANCE}
    tables = [{**content, "name": f"usbl {kind}", "filter": kind} for kind in ("ekf", "ukf")]
    observers = [design(ObserverTable.model_validate(table), auv) for table in tables]
    found = {_AUV: library_of(auv, [load_gains("paper-pid", auv)], observers)}
    for name, way in ((_ROV, "spline"), (_TORPEDO, "survey")):
        vehicle = load_vehicle(name)
        gains = load_gains(MISSIONS / f"{name}-gains.toml", vehicle)
        found[name] = library_of(vehicle, [gains], [], load_mission(MISSIONS / f"{name}-{way}.toml"))
    return found


def program(call: Call) -> str:
    """C that measures a call, with numbers that are all within their range."""
    prefix = f"{call.library}_{call.part}"
    names = ("x", "u", "y", "r", "s", "tau", "a", "b", "c", "d", "P")
    arrays = ", ".join(f"{name}[ROOM]" for name in names)
    text = f"""\
#include "{prefix}.h"
#include "measure.h"
typedef {call.library}_real real;
enum {{ ROOM = 8192 }};
static real {arrays};
static void called(void) {{
  {call.call}
}}
int main(void) {{
  for (int i = 0; i < ROOM; i++) {{
    x[i] = y[i] = (real)0.1 + (real)0.01 * (real)(i % 12);
    r[i] = u[i] = (real)0.5;
  }}
  {call.before}
  measure("it", called);
  return 0;
}}
"""
    return text.replace("@", prefix)


def measured(call: Call, folder: Path, *flags: str) -> Cost:
    """The cost of a call of a library that was written to a folder."""
    (folder / "bench.c").write_text(program(call))
    own, *others = (f"src/{call.library}_{part}.c" for part in (call.part, *call.also))
    said = board.run(board.build(folder, ["bench.c", own, *others], *flags)).split()
    return Cost(int(said[1]), board.flash(folder, own, *flags), int(said[2]))


def costs(folder: Path) -> Iterator[tuple[Call, Cost, Cost]]:
    """Every call in float and in double."""
    written = {name: library.write(folder).folder for name, library in libraries().items()}
    for call in CALLS:
        place = written[call.library]
        single = measured(call, place, f"-D{call.library.upper()}_SINGLE")
        yield call, single, measured(call, place)


def table(found: list[tuple[Call, Cost, Cost]]) -> str:
    """The table in Markdown."""
    two = "float: instructions | flash | stack | double: instructions | flash | stack"
    lines = [f"| one call | {two} |", "|---|--:|--:|--:|--:|--:|--:|"]
    for call, *both in found:
        counts = (f"{c.instructions:,}".replace(",", " ") for c in both)
        cells = (f"{n} | {c.flash / 1000:.1f} kB | {c.stack} B" for n, c in zip(counts, both, strict=True))
        lines.append(f"| {call.words} | {' | '.join(cells)} |")
    return "\n".join([*lines, ""])


def main(arguments: list[str] | None = None) -> int:
    """Measure, and print the table or write it into a page."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.embedded", description=__doc__)
    parser.add_argument(
        "--page", type=Path, help="page to write the table into; printed where it is not given"
    )
    page: Path | None = parser.parse_args(arguments).page
    if lacks := board.missing():
        print(f"needs {', '.join(lacks)}: apt-get install {board.PACKAGES}")
        return 1
    found: list[tuple[Call, Cost, Cost]] = []
    with TemporaryDirectory() as folder:
        for row in costs(Path(folder)):
            found.append(row)
            print(row[0].words, *row[1:], flush=True)
    made = table(found)
    if page is None:
        print(made)
    else:
        write_whole(page, in_page(page.read_text(encoding="utf-8"), made, BEGIN, END))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
