"""What the numbers put into the page on the box in a flow solver."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.results.text import number, percent, table

from . import telling
from .calls import Reported
from .cfd import ADDED_MASS


def blocks(n: Reported) -> dict[str, str]:
    """Tables and lists of the page, from the numbers of `cfd.work`."""
    words = [*telling.typed(n), *(c["command"] for c in n["by_hand"])]
    return {
        "commands": telling.commands(words, "../shared/data/cfd-surge"),
        "compared": telling.compared(n["compared"]),
        "regimes": telling.regimes(n["compared"]["multistep_coarse"]),
        "verdicts": telling.verdicts(n["diagnoses"]),
        "diagnoses": telling.diagnoses(n["diagnoses"]),
        "by_hand": _by_hand(n["by_hand"]),
        "doctor": telling.doctor(n),
        "seconds": telling.seconds(n),
    }


def _by_hand(rows: Sequence[Reported]) -> str:
    head = ("identified → judged", "effect", "kept-aside error", "5 s ahead", "values, SI")
    low, high = ADDED_MASS
    beside = f"X_udot is to be held against -{low:g} to -{high:g} kg.\n"
    return table(head, [_effect(r) for r in rows], left=2) + "\n" + beside


def _effect(r: Reported) -> list[str]:
    errors = f"{number(r['error_before'])} → {number(r['error_after'])}"
    values = ", ".join(f"{k} = {number(v)}" for k, v in r["values"].items())
    return [r["way"], r["effect"], errors, percent(r["ahead"]), values]
