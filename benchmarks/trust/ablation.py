"""The effect of each number of the diagnosis: a fixed sample diagnosed with each of them switched off."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

from benchmarks.results.text import table
from undertow.identification.diagnose import diagnose
from undertow.identification.diagnosis.settings import Settings, Threshold
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

from .cases import HARD, OTHER_FORMS, Planned, plan
from .material import simulated, written_to_memory
from .measure import Record, answer_of
from .run import Job, Work, records, run

Data = tuple[Vehicle, Sequence[Run], Sequence[Run]]
#: Every so many cases of the first round of the plan, without those whose size has to be searched for.
EVERY = 3
INTRODUCTION = """\
# The numbers that decide a verdict

All of them are in `undertow.identification.diagnosis.settings.Settings`. The command below switches each of
them off in turn, if possible, and repeats the diagnosis of a fixed sample of cases of the [trust
benchmark](trust.md), and of the [real logs](real.md) with one degree of freedom. The table counts the answers
(verdict, effects named, sets) that differ from those of the default settings. A diagnosis that never reads a
number would give the same answer without it; such cases are not run. After the first answer that changes, a
number has been shown to matter, and no more cases are run. A number that is read and makes no difference on
the whole sample should be removed; if few cases read it, no difference is little evidence. "not run": no case
read it, or it cannot be switched off, and it rests only on "chosen by". A number with * was added for one
case of a benchmark.

"""
HOW = """
    python -m benchmarks.trust ablate --source ablation.jsonl --out docs/ablation.md
    python -m benchmarks.trust ablate --source ablation.jsonl --number named_share --cases 5
    python -m benchmarks.real ablate --source benchmarks/results/ablation-real.jsonl
    python -m benchmarks.trust ablate --source benchmarks/results/ablation.jsonl --cases 0 \\
        --beside benchmarks/results/ablation-real.jsonl --out docs/ablation.md
"""


@dataclass(frozen=True)
class Ablated:
    """A case that is diagnosed with one number switched off, or none where `number` is empty."""

    case: Job
    number: str = ""

    @property
    def id(self) -> str:
        """The case and the number, as one word."""
        return f"{self.case.id}:{self.number or 'default'}"

    @property
    def kind(self) -> str:
        """That of the case."""
        return self.case.kind

    @property
    def label(self) -> str:
        """Special feature of the case."""
        return self.case.label

    @property
    def vehicle(self) -> str:
        """What the case is about."""
        return self.case.vehicle

    @property
    def settings(self) -> Settings:
        """The settings without that number."""
        off = {self.number: Settings.about()[self.number].off} if self.number else {}
        return replace(Settings(), **off)  # type: ignore[arg-type]


def sample() -> list[Planned]:
    """The fixed cases: effects, pairs, complete models and effects outside the catalogue."""
    usual = (case for case in plan(1) if case.label not in (*HARD, *OTHER_FORMS))
    return [case for case in usual if not case.aim][::EVERY]


def switchable() -> list[str]:
    """Numbers that can be switched off."""
    return [name for name, about in Settings.about().items() if about.off is not None]


def chosen(numbers: Sequence[str] = ()) -> Sequence[str]:
    """These numbers, by default all that can be switched off."""
    for name in numbers:
        if name not in switchable():
            raise ValueError(f"--number {name!r} cannot be switched off: choose of {', '.join(switchable())}")
    return numbers or switchable()


def still_to_run(case: Job, numbers: Iterable[str], known: Sequence[Record]) -> list[Ablated]:
    """A case with defaults; then with each number off that was read then and has changed no answer so far.

    `known` are the records of before.
    """
    plain = Ablated(case)
    default = next((r for r in known if r["id"] == plain.id and "read" in r), None)
    if default is None:
        return [plain]
    matter = {n for n in default["read"] if any(a != b for _, a, b in _pairs(n, known))}
    return [Ablated(case, n) for n in numbers if n in {*default["read"]} - matter]


def ablate(
    cases: Sequence[Job],
    numbers: Sequence[str],
    source: Path,
    work: Work,
    *,
    minutes: float | None,
    **how: Any,
) -> int:
    """Diagnose cases with defaults and with numbers switched off, and append the records.

    Returns how many failed.
    """
    end = time.monotonic() + 60 * (float("inf") if minutes is None else minutes)
    failed, numbers = 0, chosen(numbers)
    for case in [one for one in cases for _ in ("with defaults", "with each number off")]:
        todo = still_to_run(case, numbers, records(source))
        failed += run(todo, source, work, minutes=(end - time.monotonic()) / 60, **how)
    return failed


def answering(data: Callable[[Any], Data]) -> Work:
    """What is done with an ablation: the answer of the diagnosis to the vehicle and logs of its case."""

    def answered(one: Ablated) -> Record:
        given = data(one.case)
        began = time.perf_counter()
        settings = recording(one.settings)
        answer = answer_of(diagnose(*given, settings=settings).diagnosis)
        said = {name: getattr(answer, name) for name in ("verdict", "named", "sets")}
        found = {"id": one.id, "number": one.number, "answer": said, "seconds": time.perf_counter() - began}
        return found if one.number else found | {"read": sorted(Recording.seen & {*switchable()})}

    return answered


class Recording(Settings):
    """Settings of which, and of copies of which, it is known what was read.

    There is one diagnosis at a time in a process.
    """

    seen: ClassVar[set[str]] = set()

    def __getattribute__(self, name: str) -> Any:
        """As usual; the name of what is read is kept."""
        Recording.seen.add(name)
        return super().__getattribute__(name)


def recording(settings: Settings) -> Recording:
    """The same settings, of which nothing has been read so far."""
    same = Recording(**{name: getattr(settings, name) for name in Settings.about()})
    Recording.seen.clear()
    return same


def of_simulation(case: Planned) -> Data:
    """Vehicle and logs of a case of the trust benchmark."""
    return written_to_memory(simulated(case))


def ablation_page(records: Iterable[Record]) -> str:
    """The page of numbers, Markdown."""
    kept = [r for r in records if "failure" not in r]
    commits = ", ".join(sorted({str(r.get("commit", "unknown")) for r in kept})) or "none"
    whole = len(sample())
    run = (
        f"The sample has {whole} simulated cases, and those of real logs. "
        f"Diagnoses so far: {len(kept)}, with commit {commits}.\n"
    )
    head = (
        "number",
        "meaning",
        "value",
        "off",
        "chosen by",
        "cases run",
        "without reading it",
        "answers changed",
    )
    rows = [_row(name, about, kept) for name, about in Settings.about().items()]
    changed = [line for name in switchable() for line in _changes(name, kept)]
    parts = [INTRODUCTION, run, HOW, "\n", table(head, rows, left=5)]
    return "".join([*parts, *(["\n## Answers that changed\n\n", *changed] if changed else [])])


def _row(name: str, about: Threshold, records: Sequence[Record]) -> list[str]:
    value, unit = getattr(Settings(), name), "" if about.unit == "1" else f" {about.unit}"
    off = "–" if about.off is None else f"{about.off:g}"
    pairs = _pairs(name, records)
    idle = str(sum(name not in r["read"] for r in records if "read" in r)) if about.off is not None else "–"
    changed = str(sum(a != b for _, a, b in pairs)) if pairs else "not run"
    counts = [str(len(pairs)) if pairs else "–", idle, changed]
    source = f"{about.source} ({about.one_case})" if about.one_case else about.source
    return [f"`{name}`{'*' * bool(about.one_case)}", about.meaning, f"{value}{unit}", off, source, *counts]


def _changes(name: str, records: Sequence[Record]) -> list[str]:
    changed = [(case, a, b) for case, a, b in _pairs(name, records) if a != b]
    return [f"- `{name}` off, `{case}`: {_words(a)} becomes {_words(b)}\n" for case, a, b in changed]


def _words(answer: dict[str, Any]) -> str:
    sets = "".join(f", set of {' or '.join(s)}" for s in answer["sets"])
    return f"{answer['verdict']} {' + '.join(answer['named'])}".strip() + sets


def _pairs(name: str, records: Sequence[Record]) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Cases with their answers by the default settings and without a number, where there are both."""
    by_id = {r["id"]: r["answer"] for r in records}
    own = [r["id"].rpartition(":")[0] for r in records if r["number"] == name]
    found = ((case, by_id.get(f"{case}:default"), by_id[f"{case}:{name}"]) for case in own)
    return [(case, a, b) for case, a, b in found if a is not None]
