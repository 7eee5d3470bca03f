"""What the numbers put into the page on C/S Enterprise I."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.results.text import number, percent, table

from . import telling
from .calls import Reported
from .cse1 import BAND


def blocks(n: Reported) -> dict[str, str]:
    """Tables and lists of the page, from the numbers of `cse1.work`."""
    found = n["diagnoses"]
    return {
        "commands": telling.commands(telling.typed(n), "../shared/data/ntnu-cse1/freerun"),
        "compared": telling.compared(n["compared"]),
        "regimes_joystick": telling.regimes(n["compared"]["manual_random_run1"]),
        "regimes_positioning": telling.regimes(n["compared"]["dp_dptest1"]),
        "verdicts": telling.verdicts(found),
        "tally": telling.tally(found),
        "diagnoses": telling.diagnoses(found),
        "by_hand": _by_hand(n["by_hand"]),
        "waves": _waves(n),
        "doctor": telling.doctor(n),
        "seconds": telling.seconds(n),
    }


def _by_hand(rows: Sequence[Reported]) -> str:
    cells = [[r["way"], r["model"], percent(r["ahead"]), _values(r["values"])] for r in rows]
    return table(("identified on → judged on", "model", "5 s ahead", "found"), cells, left=2)


def _values(values: Reported) -> str:
    return ", ".join(
        f"{n} = {number(v)}" + ("" if s is None else f" ± {s:.1g}") for n, (v, s) in values.items()
    )


def _waves(n: Reported) -> str:
    calm, rough = n["waves"]["calm"], n["waves"]["waves"]
    rows = [_channel(name, calm[name], rough[name]) for name in rough]
    head = ("pose", "calm, rms", "in waves, rms", "ratio", "peak in waves [Hz]")
    still, moved = (n["compared"][f"dp_dptest3_waves, {part}"]["dofs"] for part in ("calm part", "in waves"))
    forces = [_force(a, b) for a, b in zip(still, moved, strict=True)]
    return (
        f"Motion between {BAND[0]:g} and {BAND[1]:g} Hz:\n\n{table(head, rows)}\n"
        f"Force that the stated model lacks, calm → waves: {', '.join(forces)}.\n"
    )


def _channel(name: str, calm: Reported, rough: Reported) -> list[str]:
    ratio = number(rough["rms"] / calm["rms"], 2)
    return [
        f"{name} [{rough['unit']}]",
        f"{calm['rms']:.2g}",
        f"{rough['rms']:.2g}",
        ratio,
        f"{rough['peak']:.2f}",
    ]


def _force(calm: Reported, rough: Reported) -> str:
    before, after = (number(d["residual_rms"], 2) for d in (calm, rough))
    return f"{calm['degree_of_freedom']} {before} → {after} {calm['unit']}"
