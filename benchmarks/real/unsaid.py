"""What could not be said of real logs, and why: answers for logs as they are, and which data would help."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from benchmarks.results.text import errors, listed
from benchmarks.trust.measure import Record

from .measure import REFUSED
from .tally import STAGES, answer, causes

#: Of each vehicle what is known from elsewhere, and what would tell more: by hand.
KNOWN = Path(__file__).with_name("unsaid.toml")
_FIRST = re.compile(r"(?<=\.) (?=[A-Z])")
_NOTHING = "no effect of the catalogue is beyond chance on the validation data"


def unsaid_page(records: Iterable[Record], earlier: Iterable[Record] = ()) -> str:
    """The whole page, Markdown; where a log has no new answer, an earlier one stands for it and says so."""
    found, before = ({r["vehicle"]: r for r in rs if r["kind"] == "baseline"} for rs in (records, earlier))
    known = tomllib.loads(KNOWN.read_text(encoding="utf-8"))
    commits = listed(sorted({str(r.get("commit", "unknown")) for r in found.values()}))
    parts = [_section(text, found, before) for text in known.values()]
    return "\n".join([INTRODUCTION, _tally(found, before), *parts, MAKING.format(commits=commits)])


def _tally(found: Mapping[str, Record], before: Mapping[str, Record]) -> str:
    ran = [r for r in found.values() if "failure" not in r]
    verdicts = [r["answer"]["verdict"] for r in ran]
    counted = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
    old = len(before.keys() - found.keys())
    rest = f" {old} more were not rerun: their earlier answers are given here." if old else ""
    return f"Answers to {len(ran)} sets of logs: {counted}.{rest}\n"


def _section(text: Mapping[str, str], found: Mapping[str, Record], before: Mapping[str, Record]) -> str:
    """One vehicle: what is known of it, each of its sets of logs, and which data would help."""
    own = sorted(logs for logs in found.keys() | before.keys() if logs.startswith(text["logs"]))
    reported = [_answer(found[logs]) if logs in found else _earlier(before[logs]) for logs in own]
    answers = "\n".join(reported) or "Not run.\n"
    return (
        f"## {text['title']}\n\n{text['known'].strip()}\n\n{answers}\n"
        f"**What data would help.** {text['tells'].strip()}\n"
    )


def _answer(record: Record) -> str:
    head = f"### {record['vehicle']}: {record.get('title', '')}\n\n"
    if "failure" in record:
        return f"{head}Not answered: {record['failure']}.\n"
    facts = [*_ahead(record), *_remains(record), *_unnamed(record), *_advice(record)]
    return f"{head}{first_sentence(record)}\n\n" + "".join(f"- {fact}\n" for fact in facts)


def _earlier(record: Record) -> str:
    """The answer of a version before this one, which kept no reasons."""
    said = f"**{record['answer']['verdict']}**: {record['headline']}"
    source = record.get("source", "an earlier run")
    return f"### {record['vehicle']}: {record['title']}\n\nNot rerun. Earlier ({source}): {said}\n"


def first_sentence(record: Record) -> str:
    """The verdict and the first sentence of the report."""
    return f"**{record['answer']['verdict']}**: {_FIRST.split(record['headline'])[0]}"


def _ahead(record: Record) -> list[str]:
    found = record.get("errors", {})
    horizons = " / ".join(f"{h:g}" for h in record["horizons"])
    each = ", ".join(f"{words} {errors(found[key])}" for key, words in STAGES.items() if key in found)
    return [f"Error of velocities {horizons} s ahead: {each}."] if each else []


def _remains(record: Record) -> list[str]:
    left = [f"What remains: {_closed(words)}" for words in record.get("remaining", ())]
    share = record.get("predictable")
    return left + ([f"Over the longest horizon {_closed(share)}"] if share else [])


def _unnamed(record: Record) -> list[str]:
    """Why effects that were tried have no name, with those that only improve predictions first."""
    if record["answer"]["verdict"] == REFUSED:
        return []
    named, reasons = causes(answer(record)), record.get("not_named", {})
    helps: Sequence[str] = record.get("helps", ())
    order = [*helps, *(e for e in reasons if e not in helps)]
    reported = [f"Not named: `{e}`: {_closed(reasons[e])}" for e in order if e in reasons and e not in named]
    return reported or ([] if named else [f"Not named: {_NOTHING}."])


def _advice(record: Record) -> list[str]:
    return [f"To tell them apart: {_closed(words)}" for words in record.get("tell", ())]


def _closed(words: str) -> str:
    return words if words.endswith(".") else f"{words}."


INTRODUCTION = """\
# What it could not say, and why

For every set of real logs, unmodified: the first sentence of the diagnosis, the residual of its final model,
why the effects that were tried are not named, and which data would help. The answers and numbers are those of
the program; what is known about a vehicle from other sources, and which data would help, is written by hand.
How well the models predict compared with other methods: [Real logs](real.md). Each data set in detail:
[Examples](examples/README.md).

Errors are those of simulated velocities on the validation runs, in % of the motion (geometric mean over the
degrees of freedom). `helps_prediction` means that an effect significantly reduces the error, but is not
established as the cause; the reason is given.
"""
MAKING = """\
## How this page was made

    python -m benchmarks.real run --kind baseline --data ../shared/data --kvlcc2 FOLDER \\
        --esso FREE_RUNS
    python -m benchmarks.real unsaid --out docs/what-it-could-not-say.md \\
        --before benchmarks/results/real-before.jsonl

Commits: {commits}. The logs are not part of the project; the [examples](examples/README.md) say where they
are from.
"""
