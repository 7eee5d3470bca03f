"""What the numbers put into the page on the box in a flow solver."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.results.text import MISSING, listed, number, percent, table

from . import tables
from .calls import Reported
from .cfd import ADDED_MASS


def blocks(n: Reported) -> dict[str, str]:
    """Tables and lists of the page, from the numbers of `cfd.work`."""
    words = [*tables.typed(n), *(c["command"] for c in n["by_hand"] if c["command"])]
    return {
        "first": first(n["diagnoses"][1]),
        "commands": tables.commands(words, "../shared/data/cfd-surge"),
        "compared": tables.compared(n["compared"]),
        "regimes": tables.regimes(n["compared"]["multistep_coarse"]),
        "verdicts": tables.verdicts(n["diagnoses"]),
        "diagnoses": tables.diagnoses(n["diagnoses"]),
        "by_hand": _by_hand(n["by_hand"]),
        "doctor": tables.doctor(n),
        "seconds": tables.seconds(n),
    }


def first(d: Reported) -> str:
    """What the owner can do, from the diagnosis of the longer profile."""
    others = listed(e for s in d["indistinguishable"] for e in s["effects"] if e != "radiation_memory")
    return (
        "To predict how this hull coasts and reverses, add a memory of its wake "
        f"(`undertow add radiation_memory`): the velocity error falls {tables.falls(d)} on a force profile "
        f"that it was not fitted to; run a third profile before you take the memory, and not {others}, for "
        "the cause."
    )


def _by_hand(rows: Sequence[Reported]) -> str:
    head = ("identified → judged", "effect", "5 s ahead", "times the noise", "values, SI")
    low, high = ADDED_MASS
    beside = f"X_udot is to be held against -{low:g} to -{high:g} kg.\n"
    return table(head, [_effect(r) for r in rows], left=2) + "\n" + beside


def _effect(r: Reported) -> list[str]:
    values = ", ".join(f"{k} = {number(v)}" for k, v in r["values"].items())
    noise = number(r["error_after"]) if r["effect"] else MISSING
    return [r["way"], r["effect"] or "none, refitted", percent(r["ahead"]), noise, values]
