"""Random search over families of manoeuvres, then refinement of the best, repeatable for a seed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from undertow.typing import Array, Progress

from .families import Design, Family

Judge = Callable[[Design], float]
# Share of the tries spent on looking around.
_EXPLORING = 0.45
_SHORT_LIST = 3
# Size of a change at the beginning and at the end of the refinement, numbers being between 0 and 1.
_CHANGES = (0.35, 0.04)
# Some changes give a number any value at all, so that a sign or an order of levels can turn.
_ANEW = 0.25


@dataclass
class Search:
    """The outcome of a search.

    Attributes
    ----------
    best : Design
        The manoeuvre with the highest value, or None if no manoeuvre has one.
    value : float
        Its value.
    by_family : dict
        Highest value by name of the family; -inf where no manoeuvre of it was safe.
    tries : int
        Manoeuvres looked at.
    """

    best: Design | None = None
    value: float = -np.inf
    by_family: dict[str, float] = field(default_factory=dict)
    tries: int = 0


def search(
    families: Sequence[Family],
    judge: Judge,
    tries: int,
    seed: int,
    report: Progress = lambda done, words: None,
) -> Search:
    """Find a manoeuvre of high value.

    Parameters
    ----------
    families : sequence of Family
        Where to look.
    judge : callable
        Value of a manoeuvre; -inf for one that is not allowed.
    tries : int
        How many manoeuvres are judged.
    seed : int
        Of the random numbers: the same seed finds the same manoeuvre.
    report : callable
        Told what share is done, and what is being done.
    """
    return _Searching(judge, tries, np.random.default_rng(seed), report).over(families)


class _Searching:
    def __init__(self, judge: Judge, tries: int, rng: np.random.Generator, report: Progress) -> None:
        self._judge, self._tries, self._rng, self._report = judge, tries, rng, report
        self.found = Search()
        self._leaders: dict[str, tuple[float, Design]] = {}

    def over(self, families: Sequence[Family]) -> Search:
        if not families:
            return self.found
        exploring = max(round(_EXPLORING * self._tries), len(families))
        for i in range(exploring):
            family = families[i % len(families)]
            self._try(Design(family, self._rng.random(family.size)), "looking for a manoeuvre")
        leaders = sorted(self._leaders.values(), key=lambda pair: -pair[0])[:_SHORT_LIST]
        # A quarter of what is left for the leader, an eighth for the next; then all the rest for the best.
        for rank, (value, design) in enumerate(leaders):
            self._refine(design, value, (self._tries - exploring) // 2 ** (rank + 2))
        if self.found.best is not None:
            self._refine(self.found.best, self.found.value, self._tries - self.found.tries, late=True)
        return self.found

    def _try(self, design: Design, words: str) -> float:
        value = self._judge(design)
        found = self.found
        found.tries += 1
        self._report(min(found.tries / max(self._tries, 1), 1.0), words)
        name = design.family.name
        found.by_family[name] = max(value, found.by_family.get(name, -np.inf))
        if value > found.value:
            found.best, found.value = design, value
        if np.isfinite(value) and value > self._leaders.get(name, (-np.inf,))[0]:
            self._leaders[name] = (value, design)
        return value

    def _refine(self, design: Design, value: float, tries: int, late: bool = False) -> None:
        """Change a few numbers at a time, less and less, and keep what is better."""
        first, last = _CHANGES if not late else (_CHANGES[0] / 3, _CHANGES[1])
        for i in range(tries):
            size = first * (last / first) ** (i / max(tries - 1, 1))
            changed = Design(design.family, self._changed(design.numbers, size))
            got = self._try(changed, f"refining {design.family.name}")
            if got > value:
                design, value = changed, got

    def _changed(self, numbers: Array, size: float) -> Array:
        rng = self._rng
        chosen = rng.random(len(numbers)) < max(2.0 / len(numbers), 0.1)
        chosen[rng.integers(len(numbers))] = True
        moved = numbers + size * rng.standard_normal(len(numbers))
        moved = np.abs(1.0 - np.abs(1.0 - moved))
        anew = rng.random(len(numbers)) < _ANEW * size / _CHANGES[0]
        moved = np.where(anew, rng.random(len(numbers)), moved)
        return np.clip(np.where(chosen, moved, numbers), 0.0, 1.0)
