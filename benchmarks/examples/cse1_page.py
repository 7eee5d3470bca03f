"""What the numbers put into the page on C/S Enterprise I."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.results.text import number, percent, table

from . import tables
from .calls import Reported
from .cse1 import BAND, CURVED, WAYS


def blocks(n: Reported) -> dict[str, str]:
    """Tables and lists of the page, from the numbers of `cse1.work`."""
    found = n["diagnoses"]
    return {
        "first": first(n["by_hand"]),
        "commands": tables.commands(tables.typed(n), "../shared/data/ntnu-cse1/freerun"),
        "compared": tables.compared(n["compared"]),
        "regimes_joystick": tables.regimes(n["compared"]["manual_random_run1"]),
        "regimes_positioning": tables.regimes(n["compared"]["dp_dptest1"]),
        "verdicts": tables.verdicts(found),
        "tally": tables.tally(found),
        "diagnoses": tables.diagnoses(found),
        "by_hand": _by_hand(n["by_hand"]),
        "waves": _waves(n),
        "doctor": tables.doctor(n),
        "seconds": tables.seconds(n),
    }


def first(rows: Sequence[Reported]) -> str:
    """What the owner can do, from the models by hand on the joystick logs."""
    found = {(r["way"], r["model"]): r for r in rows}
    pairs = [(found[way.title, "model"], found[way.title, CURVED]) for way in WAYS[:2]]
    lowered = " and ".join(f"from {percent(a['ahead'])} to {percent(b['ahead'])}" for a, b in pairs)
    delays = sorted(b["values"]["delay"][0] for _, b in pairs)
    return (
        "Put a curve of thrust over set-point (`thruster_curve`) and a delay of "
        f"{delays[0]:.2f} to {delays[1]:.2f} s (`actuation_delay`) into the file of this ship, which lowers "
        f"the velocity error 5 s ahead {lowered} on joystick logs that were not fitted, and record steps of "
        "one propeller at a time, which would fix the curve."
    )


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
