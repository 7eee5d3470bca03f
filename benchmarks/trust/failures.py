"""The failures, one by one, each with what the numbers say about why."""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from benchmarks.results.text import listed, number

from .tally import VISIBLE, Scored

#: Explanations by hand, case id -> text.
NOTES = Path(__file__).with_name("notes.toml")
#: A model that is worse than the oracle refit by less predicts as well as the truth.
_AS_GOOD = 1.02
HEAD = ("case", "hidden", "verdict", "named", "ratio", "after / oracle", "what the numbers say")


def failures(cases: Sequence[Scored]) -> list[Scored]:
    """Cases whose answer is not what it should be."""
    return [case for case in cases if not right(case)]


def right(case: Scored) -> bool:
    """Whether an answer is what it should be, as far as the data can show it."""
    if case.kind == "complete":
        return not case.answer.claims
    if case.grade not in VISIBLE:
        return not case.false_claim
    if case.kind == "uncatalogued":
        return case.answer.verdict == "unexplained" and not case.answer.claims
    if case.kind == "pair":
        return case.reported
    return case.reported if case.grade == "weak" else case.only


def row(case: Scored) -> list[str]:
    """Cells of the table of failures."""
    r, answer = case.record, case.answer
    others = sorted(answer.reported - set(answer.named))
    named = listed(answer.named) + (f" (or {', '.join(others)})" if others else "")
    hidden = listed(r["truth"]) if r["truth"] else r["label"]
    numbers = [number(r.get("ratio")), number(case.cost)]
    return [f"`{r['id']}`", hidden, answer.verdict, named, *numbers, _notes().get(r["id"]) or why(case)]


def why(case: Scored) -> str:
    """What the recorded numbers say about a failure."""
    if case.kind == "complete":
        return f"false alarm on a complete model ({case.record['label']})"
    if case.kind == "uncatalogued":
        claimed = "the effects it names explain enough to pass"
        return claimed if case.answer.claims else _MEANING.get(case.answer.verdict, case.answer.verdict)
    if case.false_claim and case.cost <= _AS_GOOD:
        return "what it names predicts the validation data as well as the truth does: they cannot tell"
    if case.grade not in VISIBLE:
        return "the truth is hidden in the noise, and something else is named"
    if not case.answer.claims:
        return _missed(case)
    if case.reported:
        return "the truth is named, with something beside it"
    if case.kind == "pair":
        return "one of the two is found" if not case.false_claim else "neither is found"
    return f"something else is named; the truth stands at place {_place(case)}"


_MEANING = {
    "adequate": "taken for noise or a disturbance",
    "helps_prediction": "nothing is named; an effect is said to help predictions only",
}


def _missed(case: Scored) -> str:
    if case.answer.verdict == "adequate":
        return _MEANING["adequate"]
    return f"nothing is named; the truth stands at place {_place(case)}"


def _place(case: Scored) -> str:
    return str(case.place) if case.place < 999 else "–"


@cache
def _notes() -> dict[str, str]:
    if not NOTES.is_file():
        return {}
    return {str(k): str(v) for k, v in tomllib.loads(NOTES.read_text(encoding="utf-8")).items()}
