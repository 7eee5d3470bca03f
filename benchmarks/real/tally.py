"""What is right: first, named, named wrongly, and what is named in addition that was not named before."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

from benchmarks.trust.goals import Goal, at_least, at_most
from benchmarks.trust.measure import Record
from benchmarks.trust.tally import Share, share
from benchmarks.trust.verdicts import NAMING, Answer

from .logs import SETS

#: Least fall of the error of the longest simulation for an effect to count: less does not matter to its
#: owner.
WORTH = 0.15
#: Effects that a set may contain in addition to the right one.
BESIDE = 1
#: Ours over the best grey box.
AS_GOOD = 0.95
#: Models of ours in a record of the log as it is, as the page has them.
STAGES = {
    "stated": "as stated",
    "refitted": "refitted",
    "found": "with what was named",
    "helped": "with all that improves predictions",
}


def answer(record: Record) -> Answer:
    """What the diagnosis said."""
    return Answer(**record["answer"])


def causes(said: Answer) -> set[str]:
    """What is said to be the cause of an error, alone or in a set."""
    return said.reported if said.verdict in NAMING else set()


@dataclass(frozen=True)
class Graded:
    """One case beside the answer for the log as it is.

    record: one line of the file.
    as_logged: what was said of the log as it is; None where that was not run.
    helped: effects that improved predictions of the log as it is, established as its cause or not.
    """

    record: Record
    as_logged: Answer | None
    helped: frozenset[str] = frozenset()

    @cached_property
    def answer(self) -> Answer:
        """What was said."""
        return answer(self.record)

    @cached_property
    def right(self) -> set[str]:
        """Right answers."""
        return set(self.record["truth"])

    @property
    def fall(self) -> float:
        """Share of the error of the longest simulation that goes when what is true is added."""
        errors = self.record.get("errors", {})
        before, after = (errors.get(k, [None])[-1] for k in ("refitted", "true"))
        if after is None:
            return 0.0
        return 1.0 if before is None else 1.0 - after / before

    @property
    def counts(self) -> bool:
        """Whether the effect matters for the longest simulation."""
        return self.fall >= WORTH

    @property
    def place(self) -> int:
        """Place of a right answer in the ranking, 0 for none."""
        return self.answer.place(self.right) or 0

    @property
    def first(self) -> bool:
        """Ranked first."""
        return self.place == 1

    @property
    def behind_known(self) -> bool:
        """Whether what is ranked before it was missing in the log as it is, too."""
        known = self.helped | (causes(self.as_logged) if self.as_logged else set())
        return not self.first and {*self.answer.ranking[:1]} <= known

    @property
    def group(self) -> set[str]:
        """What cannot be told from a right answer, with it."""
        sets = [set(s) for s in self.answer.sets if self.right & set(s)]
        return min(sets, key=len, default=self.right & causes(self.answer))

    @property
    def named(self) -> bool:
        """Named alone, or in a set of two."""
        return bool(self.right & causes(self.answer)) and len(self.group - self.right) <= BESIDE

    @property
    def new(self) -> set[str]:
        """What is named, not right, in no set of two with it, and neither named for the log as it is nor
        documented of the vehicle.
        """
        logs = SETS.get(self.record["vehicle"])
        known = (causes(self.as_logged) if self.as_logged else set()) | {*(logs.documented if logs else ())}
        return causes(self.answer) - self.right - known - (self.group if self.named else set())

    @property
    def wrong(self) -> bool:
        """A cause is named that is none, and the right one is not."""
        return bool(self.new) and not self.right & causes(self.answer)

    @property
    def failed(self) -> bool:
        """Whether this case is listed among the failures."""
        return bool(self.new) or (self.counts and not (self.first and self.named))


def graded(records: Iterable[Record]) -> list[Graded]:
    """All cases in which something was taken out or put in, in the order of their ids."""
    ran = [r for r in records if "failure" not in r]
    plain = {r["vehicle"]: (answer(r), frozenset(r.get("helps", ()))) for r in ran if r["kind"] == "baseline"}
    changed = [r for r in ran if r["kind"] in ("removal", "injection")]
    found = [Graded(r, *plain.get(r["vehicle"], (None,))) for r in changed]
    return sorted(found, key=lambda case: (case.record["kind"] != "removal", case.record["id"]))


def goals(cases: Sequence[Graded]) -> list[Goal]:
    """The goals of the page, held against what was measured."""
    counting = [c for c in cases if c.counts]
    return [
        at_least("ranked first, where it counts", share(counting, lambda c: c.first), 0.92),
        at_least("named alone or in a set of two, where it counts", share(counting, lambda c: c.named), 0.88),
        at_most("a wrong cause named", share(cases, lambda c: c.wrong), 0.02),
        at_least("nothing new named beside it", share(cases, lambda c: not c.new), 0.90),
    ]


# --- prediction ---------------------------------------------------------------------------------
@dataclass(frozen=True)
class Predicted:
    """Errors over one length of windows of one log set, as shares of the motion; None: diverged or not there.

    ours: by the names of `STAGES`. grey, black: by the names of the methods.
    """

    logs: str
    horizon: float
    ours: dict[str, float | None]
    grey: dict[str, float | None]
    black: dict[str, float | None]

    @property
    def error(self) -> float:
        """Error of the model with all that helps to predict; older records have that with what was named."""
        return _least([self.ours.get("helped", self.ours.get("found"))])

    def over(self, others: dict[str, float | None]) -> float:
        """Our error over the best of others; NaN where either is not there."""
        least = _least(others.values())
        return self.error / least if least < float("inf") and self.error < float("inf") else float("nan")

    @property
    def met(self) -> bool:
        """Whether ours is at most `AS_GOOD` of the best grey box."""
        return self.error <= AS_GOOD * _least(self.grey.values())


def _least(errors: Iterable[float | None]) -> float:
    return min((e for e in errors if e is not None), default=float("inf"))


def predictions(records: Iterable[Record], grey: Iterable[str], black: Iterable[str]) -> list[Predicted]:
    """Every log set at every horizon where the peers were run; ours may have no errors yet."""
    ran = {(r["kind"], r["vehicle"]): r for r in records if "failure" not in r and "errors" in r}
    found = []
    for (kind, logs), peers in ran.items():
        if kind != "prediction":
            continue
        own = ran.get(("baseline", logs), {"errors": {}})
        for i, horizon in enumerate(peers["horizons"]):
            of = [{k: e[i] for k in names if (e := errors.get(k))} for errors, names in (
                (own["errors"], STAGES), (peers["errors"], grey), (peers["errors"], black))]  # fmt: skip
            found.append(Predicted(logs, horizon, *of))
    return sorted(found, key=lambda p: (p.logs, p.horizon))


def prediction_goal(found: Sequence[Predicted]) -> Goal:
    """Ours against the best grey box, on every log and horizon."""
    known = [p for p in found if p.ours and _least(p.grey.values()) < float("inf")]
    return at_least(f"our error ≤ {AS_GOOD:g} × the best grey box", share(known, lambda p: p.met), 1.0)


def share_of(cases: Sequence[Graded], what: str) -> Share:
    """How many of the cases have a property."""
    return share(cases, lambda c: bool(getattr(c, what)))
