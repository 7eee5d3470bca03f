"""Counting: records with what they are worth, shares with their confidence intervals."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np

from .grade import GRADES
from .measure import Record
from .verdicts import Answer, accepted, holding

T = TypeVar("T")
OURS = "undertow"
#: Grades in which the truth is to be found.
VISIBLE = tuple(name for name, _ in GRADES)
_Z = 1.959964  # 97.5% quantile of the normal distribution


@dataclass(frozen=True)
class Share:
    """k of n, with Wilson's 95% confidence interval."""

    k: int
    n: int

    @property
    def value(self) -> float:
        """k / n; NaN of nothing."""
        return self.k / self.n if self.n else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's score interval: keeps its level for shares near 0 and 1 and few cases."""
        if not self.n:
            return (0.0, 1.0)
        p, n, square = self.value, self.n, _Z**2
        middle = (p + square / (2 * n)) / (1 + square / n)
        half = _Z / (1 + square / n) * np.sqrt(p * (1 - p) / n + square / (4 * n * n))
        return (max(0.0, round(float(middle - half), 9)), min(1.0, round(float(middle + half), 9)))

    def __str__(self) -> str:
        if not self.n:
            return "no cases"
        low, high = (f"{100 * bound:.3g}" for bound in self.interval)
        return f"{self.k} of {self.n}: {100 * self.value:.3g}% ({low} to {high})"


def share(cases: Iterable[T], right: Callable[[T], bool]) -> Share:
    """How many of the cases are right."""
    answers = [right(case) for case in cases]
    return Share(sum(answers), len(answers))


@dataclass(frozen=True)
class Scored:
    """A record with the answer of one method.

    record: one line of the file.
    answer: what the method said.
    """

    record: Record
    answer: Answer

    @property
    def kind(self) -> str:
        """`complete`, `single`, `pair`, `hard` or `uncatalogued`; `uncatalogued`: no catalogue lists it."""
        kind = str(self.record["kind"])
        return kind if kind in ("complete", "hard") or self.record["known"] else "uncatalogued"

    @property
    def grade(self) -> str:
        """How much the truth helps."""
        return str(self.record.get("grade", ""))

    @cached_property
    def accepted(self) -> list[set[str]]:
        """For each true effect, the ids that stand for the same equations."""
        r = self.record
        return [accepted(effect, r["motions"], r["values"]) for effect in r["truth"]]

    @property
    def place(self) -> int:
        """Place of the truth in the ranking; large where it has none."""
        return self.answer.place(set().union(*self.accepted)) or 999

    @property
    def first(self) -> bool:
        """Truth ranked first."""
        return self.place == 1

    @property
    def in_three(self) -> bool:
        """Truth among the first three."""
        return self.place <= 3

    @property
    def reported(self) -> bool:
        """Every true effect is named, alone or in a set."""
        return all(one & self.answer.reported for one in self.accepted)

    @property
    def only(self) -> bool:
        """The truth is named and nothing else but, in a set with it, what it is a special case of."""
        r = self.record
        beside = (holding(effect, r["motions"]) for effect in r["truth"])
        return self.reported and self.answer.only(set().union(*self.accepted, *beside))

    @property
    def false_claim(self) -> bool:
        """An effect is said to be missing, and none of what is reported is true."""
        return self.answer.claims and not any(one & self.answer.reported for one in self.accepted)

    @property
    def cost(self) -> float:
        """Error after adding what is named, over that of the oracle refit; NaN where there is no such."""
        r = self.record
        return float(r["after"] / r["oracle"]) if "after" in r else float("nan")


def scored(records: Iterable[Record], who: str = OURS) -> list[Scored]:
    """The records that have an answer of a method."""
    found = []
    for record in records:
        said = record.get("answer") if who == OURS else record.get("peers", {}).get(who)
        if "failure" not in record and said and "verdict" in said:
            known = {k: said[k] for k in ("verdict", "named", "sets", "ranking")}
            found.append(Scored(record, Answer(**known)))
    return found


def expressible(record: Record) -> bool:
    """Whether the other methods have terms for all that is hidden."""
    said = record.get("peers", {}).values()
    return bool(said) and all(set(record["truth"]) <= set(one.get("expressible", ())) for one in said)


def methods(records: Iterable[Record]) -> list[str]:
    """undertow and the other methods that were run."""
    return list(dict.fromkeys([OURS, *(name for r in records for name in r.get("peers", {}))]))


def of_kind(cases: Iterable[Scored], kind: str, *grades: str) -> list[Scored]:
    """Cases of a kind, of these grades if any are given."""
    return [c for c in cases if c.kind == kind and (not grades or c.grade in grades)]
