"""The text of docs/closed-loops.md."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import casadi
import numpy

from undertow import __version__
from undertow.control.closed_loop import LoopResult, Record

from ..results.text import table
from .runs import Read, predicted_cycle, tilt

_TEXT = Path(__file__).parent / "page.md"
_NAMES = {"paper-pd": "PD", "paper-pid": "PID", "paper-smc": "SM"}
NONE = "-"


@dataclass(frozen=True)
class Material:
    """Everything the page tells of.

    Attributes
    ----------
    run : list of Record
        The three controllers.
    long : Record
        The PID loop over 3000 s.
    readings : list of Read
        The other readings.
    signs : list
        Interval, set of parameters at rest, and result of sliding mode.
    six : list
        Words and runs for every variant in six degrees of freedom.
    """

    run: Sequence[Record]
    long: Record
    readings: Sequence[Read]
    signs: Sequence[tuple[float, str, LoopResult]]
    six: Sequence[tuple[str, Sequence[Record]]]


def page(m: Material) -> str:
    """The whole page."""
    text = _TEXT.read_text(encoding="utf-8")
    fields = {**_facts(m), "run": run_table([r.result for r in m.run]), "table": _readings(m.readings)}
    fields |= {"signs": _signs(m.signs), "six": _six(m.six), "made": _made()}
    for name, value in fields.items():
        text = text.replace(f"{{{name}}}", value.rstrip())
    return text.rstrip() + "\n"


# --- numbers in sentences ---------------------------------------------------------------------------
def _facts(m: Material) -> dict[str, str]:
    results = [r.result for r in m.run]
    cycle = m.long.result.of("along track").cycle
    assert cycle is not None
    assert not any(r.as_the_paper_says for r in m.readings)
    by_words = {r.words: r.results for r in m.readings}
    better = by_words["K_P of the PID heading 0.1 instead of the printed 0.01"][1].of("psi").settling
    wound = Read.overshoot(by_words["integrals begin at t = 0"][1])
    facts = {f"{_NAMES[r.controller].lower()}_overshoot": f"{Read.overshoot(r):.2g}%" for r in results}
    facts["pid_overshoot"] = f"{Read.overshoot(results[1]):.0f}%"
    facts |= {f"psi_{_NAMES[r.controller].lower()}": _seconds(r.of("psi").settling) for r in results}
    facts["psi_pid"] = f"{m.long.result.of('psi').settling:.0f} s"
    amplitude, period = predicted_cycle()
    facts |= {"predicted_amplitude": f"{amplitude:.2f} m", "predicted_period": f"{period:.1f} s"}
    return facts | {
        "cycle_amplitude": f"±{cycle.amplitude:.2f} m",
        "cycle_period": f"{cycle.period:.1f} s",
        "readings": str(len(m.readings)),
        "cross": f"{1000 * abs(results[2].of('cross track').final_error):.0f} mm",
        "psi_better": f"{better:.2f} s",
        "wide": f"{1000 * abs(by_words['gate of 5°'][0].of('cross track').final_error):.0f} mm",
        "narrow": f"{1000 * abs(results[0].of('cross track').final_error):.0f} mm",
        "wound": f"{wound:.0f}%",
        "pid_along": f"{results[1].of('along track').overshoot:.0f}%",
        "chatter": f"{sum(c.variation for c in results[2].commands) / 1000:.0f} kN",
        "left": f"{1000 * results[2].of('z').sampling_offset:.1f} mm",
    }


def _seconds(value: float | None) -> str:
    return NONE if value is None else f"{value:.2f} s"


# --- tables -----------------------------------------------------------------------------------------
def run_table(results: Sequence[LoopResult]) -> str:
    """The measures of the paper's run."""
    head = ("", "gate", "coordinate", "t2%", "overshoot", "error at the end", "effort", "changes per s")
    return table(head, (row for r in results for row in _rows(r)))


def _rows(result: LoopResult) -> Iterator[Sequence[str]]:
    effort = sum(c.effort for c in result.commands)
    changes = sum(c.variation for c in result.commands)
    first = (_NAMES[result.controller], _gate(result)), (f"{effort:.4g} N s", f"{changes:.3g} N")
    for i, c in enumerate(c for c in result.coordinates if c.move):
        before, after = first if i == 0 else (("", ""), ("", ""))
        error = f"{c.final_error:+.2e} {c.unit}"
        yield (*before, c.name, _seconds(c.settling), f"{c.overshoot:.2f}%", error, *after)


def _gate(result: LoopResult) -> str:
    return NONE if result.gate_passed is None else f"{result.gate_passed:.3f} s"


def _readings(readings: Sequence[Read]) -> str:
    head = ("interpretation", *(f"{n}: overshoot, t2%" for n in _NAMES.values()), "as the paper says")
    rows = []
    for r in readings:
        cells = [f"{Read.overshoot(x):.2g}%, {_seconds(Read.settling(x))}" for x in r.results]
        cells[1] = f"{Read.overshoot(r.results[1]):.0f}%, {_seconds(Read.settling(r.results[1]))}"
        rows.append((r.words, *cells, "yes" if r.as_the_paper_says else "no"))
    return table(head, rows)


def _signs(signs: Sequence[tuple[float, str, LoopResult]]) -> str:
    rows = [
        (
            f"{1000 * dt:g} ms",
            at_rest,
            f"{1000 * r.of('z').sampling_offset:.3g} mm",
            _seconds(r.of("z").settling),
        )
        for dt, at_rest, r in signs
    ]
    return table(("dt", "set at rest", "K_Z dt / lambda in z", "t2% of z"), rows)


def _six(six: Sequence[tuple[str, Sequence[Record]]]) -> str:
    head = (
        "vehicle",
        "law",
        "t2% of x and y",
        "t2% of z",
        "overshoot of x and y",
        "largest roll",
        "largest pitch",
    )
    rows = []
    for words, records in six:
        for i, record in enumerate(records):
            r, (roll, pitch) = record.result, tilt(record)
            stuck = "gate never opens" if r.gate_passed is None else f"{Read.overshoot(r):.3g}%"
            law = _NAMES[r.controller]
            times = (_seconds(Read.settling(r)), _seconds(r.of("z").settling))
            rows.append((words if i == 0 else "", law, *times, stuck, _degrees(roll), _degrees(pitch)))
    return table(head, rows, left=2)


def _degrees(value: float) -> str:
    return NONE if value == 0 else f"{value:.2g}°" if value >= 1e-3 else "< 0.001°"


def _made() -> str:
    versions = f"undertow {__version__}; CasADi {casadi.__version__}, NumPy {numpy.__version__}"
    command = "    python -m benchmarks.closed_loops"
    return f"## How it was made\n\n{command}\n\n{versions}, Python {platform.python_version()}.\n"
