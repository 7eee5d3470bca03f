"""The page of tables, made from the records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence

from benchmarks.results.text import table

from .cases import COMPLETE, HARD, OTHER_FORMS
from .failures import HEAD, failures, row
from .goals import goals, seconds_by_motions
from .grade import HIDDEN
from .measure import Record
from .tally import OURS, VISIBLE, Scored, expressible, methods, of_kind, scored, share
from .words import DEFINITIONS, EXPRESSIBLE, FAILURES, HARDER, INTRODUCTION, NO_PEERS, PEERS

_SECONDS = ("degrees of freedom", "cases", "median s", "longest s", "median CPU time, s")
_SINGLE: tuple[tuple[str, Callable[[Scored], bool]], ...] = (
    ("truth ranked first", lambda c: c.first),
    ("in the top three", lambda c: c.in_three),
    ("in the reported set", lambda c: c.reported),
    ("named and nothing else", lambda c: c.only),
)


def page(records: Iterable[Record]) -> str:
    """The whole page, Markdown."""
    kept = list(records)
    cases = scored(kept)
    parts = [
        INTRODUCTION,
        _counts(kept, cases),
        "## Goals\n",
        goal_table(kept),
        "## One hidden effect, by how much it shows\n",
        _by_grade(kept),
        "## Complete models\n",
        _complete(kept),
        "## Effects outside the catalogue and pairs\n",
        _uncatalogued(cases),
        _pairs(kept),
        "## As hard as real logs\n",
        HARDER,
        _hard(cases),
        "## Every effect\n",
        _by_effect(cases),
        "## Seconds\n",
        table(_SECONDS, seconds_by_motions(cases), left=0),
        "## Failures\n",
        FAILURES,
        table(HEAD, [row(c) for c in failures(cases)], left=4) if failures(cases) else "None.\n",
        _not_run(kept),
        DEFINITIONS,
    ]
    return "\n".join(parts)


def goal_table(records: Iterable[Record]) -> str:
    """Goals beside what was measured."""
    return table(("", "measured (95% interval)", "goal", ""), [g.row for g in goals(scored(records))])


def _counts(records: Sequence[Record], cases: Sequence[Scored]) -> str:
    kinds = Counter(c.kind for c in cases)
    commits = ", ".join(sorted({str(r.get("commit", "unknown")) for r in records}))
    counted = ", ".join(f"{kinds[kind]} {words}" for kind, words in _KINDS.items())
    lost = len(records) - len(cases)
    return f"{len(records)} cases: {counted}; {lost} did not run. Commits: {commits}.\n"


_KINDS = {
    "single": "with one effect hidden",
    "pair": "with two",
    "complete": "complete models",
    "uncatalogued": "with an effect that no catalogue lists",
    "hard": "with one effect and as hard as real logs",
}


def _by_grade(records: Sequence[Record]) -> str:
    if len(methods(records)) == 1:
        return _graded(records) + "\n" + NO_PEERS
    like = [r for r in records if expressible(r)]
    return "\n".join([_graded(records), PEERS, EXPRESSIBLE, _graded(like)])


def _graded(records: Sequence[Record]) -> str:
    names = methods(records)
    rows = []
    for grade in (*VISIBLE, HIDDEN):
        for words, right in _SINGLE:
            rows.append([grade, words, *(str(share(_single(records, n, grade), right)) for n in names)])
    rows.append([HIDDEN, "something else named", *(_wrong(records, n) for n in names)])
    return table(("grade", "", *names), rows, left=2)


def _single(records: Sequence[Record], who: str, grade: str) -> list[Scored]:
    return of_kind(scored(records, who), "single", grade)


def _wrong(records: Sequence[Record], who: str) -> str:
    return str(share(_single(records, who, HIDDEN), lambda c: c.false_claim))


def _complete(records: Sequence[Record]) -> str:
    names = methods(records)
    by_method = {name: of_kind(scored(records, name), "complete") for name in names}
    rows = []
    for label in (*COMPLETE, *HARD, "all"):
        own = {n: [c for c in of if label in ("all", c.record["label"])] for n, of in by_method.items()}
        adequate = share(own[OURS], lambda c: c.answer.verdict == "adequate")
        alarms = [str(share(of, lambda c: c.answer.claims)) for of in own.values()]
        rows.append([label, str(adequate), *alarms])
    return table(("complete model", "adequate", *(f"false alarms, {n}" for n in names)), rows)


def _uncatalogued(cases: Sequence[Scored]) -> str:
    rows = []
    for grade in (*VISIBLE, HIDDEN):
        uncatalogued, pairs = of_kind(cases, "uncatalogued", grade), of_kind(cases, "pair", grade)
        verdicts = Counter(c.answer.verdict for c in uncatalogued)
        said = ", ".join(f"{n} {verdict}" for verdict, n in verdicts.most_common()) or "–"
        claims = str(share(uncatalogued, lambda c: c.answer.claims))
        both = str(share(pairs, lambda c: c.reported))
        exact = str(share(pairs, lambda c: c.only))
        rows.append([grade, said, claims, both, exact])
    outside, pairs_head = "outside the catalogue", ("pairs: both found", "pairs: both and nothing else")
    head = ("grade", f"{outside}: verdicts", f"{outside}: an effect claimed", *pairs_head)
    return table(head, rows, left=2)


def _pairs(records: Sequence[Record]) -> str:
    """Both found, by method; nothing where there is only one method."""
    names = methods(records)
    by_method = {n: of_kind(scored(records, n), "pair", *VISIBLE) for n in names}
    rows = [[n, str(share(of, lambda c: c.reported)), str(share(of, lambda c: c.only))]
            for n, of in by_method.items()]  # fmt: skip
    head = ("pairs of which both show", "both found", "both and nothing else")
    return table(head, rows) if len(names) > 1 else ""


def _hard(cases: Sequence[Scored]) -> str:
    """One row for each hardship: of the visible cases how often the truth is found, of all wrong names."""
    rows = []
    for label in (*HARD, *OTHER_FORMS):
        own = [c for c in cases if c.kind == "hard" and c.record["label"] == label]
        visible = [c for c in own if c.grade in VISIBLE]
        wrong = str(share(own, lambda c: c.false_claim))
        rows.append([label, *(str(share(visible, right)) for _, right in _SINGLE), wrong])
    return table(("", *(words for words, _ in _SINGLE), "something else named"), rows)


def _by_effect(cases: Sequence[Scored]) -> str:
    singles = of_kind(cases, "single")
    effects = sorted({c.record["truth"][0] for c in singles})
    rows = []
    for effect in effects:
        own = [c for c in singles if c.record["truth"][0] == effect]
        seen = [c for c in own if c.grade in VISIBLE]
        counts = [sum(right(c) for c in seen) for _, right in _SINGLE]
        mistaken = Counter(e for c in own if c.false_claim for e in c.answer.named)
        others = ", ".join(f"{e} ({n})" for e, n in mistaken.most_common(3)) or "–"
        rows.append([effect, str(len(own)), str(len(seen)), *map(str, counts), others])
    head = ("effect", "cases", "visible", *(words for words, _ in _SINGLE), "named instead")
    return table(head, rows)


def _not_run(records: Sequence[Record]) -> str:
    lost = [r for r in records if "failure" in r]
    if not lost:
        return ""
    rows = [[f"`{r['id']}`", r["failure"]] for r in lost]
    return "Cases that did not run:\n\n" + table(("case", "error"), rows, left=2)
