"""The page of tables, made from the records."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from statistics import median

from benchmarks.results.text import MISSING, errors, listed, number, percent, table
from benchmarks.trust.measure import Record, spent

from .cases import Case
from .injections import INJECTIONS
from .peers import BLACK, GREY
from .tally import (
    STAGES,
    WORTH,
    Graded,
    Predicted,
    answer,
    causes,
    goals,
    graded,
    prediction_goal,
    predictions,
    share_of,
)

_GOALS = ("", "measured (95% interval)", "goal", "")
_CASE = ("case", "right answers", "size", "error before → with the truth", "rank", "verdict", "named", "s")


def page(
    records: Iterable[Record],
    earlier: Iterable[Record] = (),
    planned: Sequence[Case] = (),
    improved: Iterable[Record] = (),
) -> str:
    """The whole page, Markdown; answers for unmodified logs are shown with those of an earlier run.

    Of cases that are planned, and have no record, it says how many there are. `improved` are the same cases
    with vehicle files that have what was found in the unmodified logs.
    """
    kept = list(records)
    cases, ahead = graded(kept), predictions(kept, GREY, BLACK)
    parts = [
        INTRODUCTION,
        _counts(kept, cases),
        _how_much(kept, planned),
        "## Goals\n",
        table(_GOALS, [g.row for g in [*goals(cases), prediction_goal(ahead)]]),
        _behind_known(cases),
        "## Unmodified logs\n",
        _as_logged(kept, earlier),
        "## Terms removed\n",
        REMOVAL,
        _table([c for c in cases if c.record["kind"] == "removal"]),
        "## Effects injected\n",
        INJECTION,
        _by_change(cases),
        _by_logs(cases),
        _with_improved(list(improved)),
        "## Prediction\n",
        PREDICTION,
        _prediction(ahead),
        _not_applicable(kept),
        "## Failures\n",
        FAILURES,
        _failures(cases),
        _not_run(kept),
        "## All cases\n",
        _table([c for c in cases if c.record["kind"] == "injection"]),
        seconds(kept),
        MAKING,
    ]
    return "\n".join(parts)


def _counts(records: Sequence[Record], cases: Sequence[Graded]) -> str:
    kinds = {kind: sum(c.record["kind"] == kind for c in cases) for kind in ("removal", "injection")}
    logs = len({r["vehicle"] for r in records})
    commits = ", ".join(sorted({str(r.get("commit", "unknown")) for r in records}))
    return (
        f"{logs} sets of real logs; {kinds['removal']} cases with a term removed, {kinds['injection']} "
        f"with an effect injected, of which {sum(c.counts for c in cases)} count. Commits: {commits}.\n"
    )


def _behind_known(cases: Sequence[Graded]) -> str:
    """How many of the cases that are not ranked first come after what the log as it is lacks already."""
    later = [c for c in cases if c.counts and not c.first]
    known = sum(c.behind_known for c in later)
    return (
        f"In {known} of the {len(later)} cases that count and are not ranked first, the effect ranked first "
        "was named for the unmodified log, or improved its predictions: it is missing there, too.\n"
    )


def _how_much(records: Sequence[Record], planned: Sequence[Case]) -> str:
    """How much of the plan was run; empty where all was, or nothing was planned."""
    ran = {r["id"] for r in records if "failure" not in r}
    whole, done = Counter(c.kind for c in planned), Counter(c.kind for c in planned if c.id in ran)
    if whole == done:
        return ""
    parts = ", ".join(f"{done[kind]} of {n} ({kind})" for kind, n in whole.items())
    return f"**Not all planned cases were run**: {parts}; the shares below are of those that were.\n"


# --- the log as it is ---------------------------------------------------------------------------
def _as_logged(records: Sequence[Record], earlier: Iterable[Record]) -> str:
    own = _baselines(records)
    before = {r["vehicle"]: _before(r) for r in _baselines(earlier)}
    head = ("logs", "verdict", "named", "before", "s ahead", *STAGES.values(), "s")
    rows = [
        [
            f"{r['vehicle']} ({r['title']})", r["answer"]["verdict"], _named(r),
            before.get(r["vehicle"], MISSING), _lengths(r),
            *(errors(r.get("errors", {}).get(stage)) for stage in STAGES), number(spent(r)),
        ]
        for r in own
    ]  # fmt: skip
    said = "\n".join(f"- {r['vehicle']}: {r['headline']}{_source(r)}" for r in own)
    return AS_LOGGED + table(head, rows, left=5) + "\nHeadlines of the diagnosis:\n\n" + said + "\n"


def _source(record: Record) -> str:
    """Where an answer was taken over from."""
    return f" (From {record['source']}.)" if "source" in record else ""


def _baselines(records: Iterable[Record]) -> list[Record]:
    own = (r for r in records if r["kind"] == "baseline" and "failure" not in r)
    return sorted(own, key=lambda r: str(r["vehicle"]))


def _before(record: Record) -> str:
    """Verdict, names and seconds of an earlier run."""
    return f"{record['answer']['verdict']}, {_named(record)}, {number(record['seconds'])} s"


def _lengths(record: Record) -> str:
    return " / ".join(f"{h:g}" for h in record.get("horizons", ())) or MISSING


def _named(record: Record) -> str:
    said = answer(record)
    if not causes(said):
        return MISSING
    sets = {effect: f" (or {', '.join(e for e in s if e != effect)})" for s in said.sets for effect in s[:1]}
    return listed(effect + sets.get(effect, "") for effect in said.named)


# --- cases --------------------------------------------------------------------------------------
def _table(cases: Sequence[Graded]) -> str:
    return table(_CASE, [_row(c) for c in cases], left=2) if cases else "None yet.\n"


def _row(case: Graded) -> list[str]:
    r = case.record
    found = r.get("errors", {})
    change = f"{errors(found.get('refitted'))} → {errors(found.get('true'))}" + " *" * case.counts
    size = f"{r['value']:.3g}" if r.get("value") else MISSING
    place = str(case.place or MISSING)
    right, verdict = " or ".join(r["truth"]), r["answer"]["verdict"]
    return [f"`{r['id']}`", right, size, change, place, verdict, _named(r), number(spent(r))]


def _with_improved(records: Sequence[Record]) -> str:
    """The section on vehicle files that have what was found already; empty if there are no such records."""
    cases = graded(records)
    if not cases:
        return ""
    return "\n".join(
        [
            "## With what was found already in the vehicle file\n",
            IMPROVED,
            table(_GOALS, [g.row for g in goals(cases)]),
            _by_logs(cases),
            _failures(cases),
        ]
    )


_GRADES = {"first": "ranked first", "named": "named", "wrong": "wrong cause", "new": "also named"}


def _by_change(cases: Sequence[Graded]) -> str:
    rows = []
    for name, injection in INJECTIONS.items():
        own = [c for c in cases if c.record["label"] == name]
        if own:
            rows.append([name, injection.equation, " or ".join(own[0].record["truth"]), *_shares(own)])
    return table(("", "what is done", "right answers", "cases", *_GRADES.values()), rows, left=3)


def _by_logs(cases: Sequence[Graded]) -> str:
    names = dict.fromkeys(c.record["vehicle"] for c in cases)
    rows = [[name, *_shares([c for c in cases if c.record["vehicle"] == name])] for name in names]
    return table(("logs, both kinds of cases", "cases", *_GRADES.values()), rows)


def _shares(cases: Sequence[Graded]) -> list[str]:
    """Cases (those that count); of these first and named; of all a wrong cause and something new."""
    counting = [c for c in cases if c.counts]
    of = {"first": counting, "named": counting, "wrong": cases, "new": cases}
    found = (share_of(own, what) for what, own in of.items())
    return [f"{len(cases)} ({len(counting)})", *(f"{s.k} of {s.n}" if s.n else MISSING for s in found)]


# --- prediction ---------------------------------------------------------------------------------
def _prediction(found: Sequence[Predicted]) -> str:
    names = [*STAGES.values(), *GREY, *BLACK]
    rows = [
        [
            f"{p.logs}, {p.horizon:g} s",
            *(percent(p.ours.get(stage)) for stage in STAGES),
            *(percent(p.grey.get(name)) for name in GREY),
            *(percent(p.black.get(name)) for name in BLACK),
            number(p.over(p.grey)) + ("" if p.met or not p.ours else " **>**"),
            number(p.over(p.black)),
        ]
        for p in found
    ]
    wins = [p for p in found if p.over(p.black) > 1.0]
    lines = [
        f"- {p.logs}, {p.horizon:g} s: {min((e, n) for n, e in p.black.items() if e is not None)[1]} leaves "
        f"{percent(p.error / p.over(p.black))}, ours {percent(p.error)}.\n"
        for p in wins
    ]
    reported = (
        "\nWhere a black box wins, which shows what is still missing:\n\n" + "".join(lines) if wins else ""
    )
    return table(("logs", *names, "ours / best grey", "ours / best black"), rows) + reported


def _not_applicable(records: Sequence[Record]) -> str:
    lines = [
        f"- {r['vehicle']}: no {name}: {why}.\n"
        for r in records
        for name, why in r.get("not_applicable", {}).items()
    ]
    return "".join(lines)


# --- failures -----------------------------------------------------------------------------------
def _failures(cases: Sequence[Graded]) -> str:
    rows = [[*_row(c)[:-1], why(c)] for c in cases if c.failed]
    return table((*_CASE[:-1], "why it is here"), rows, left=3) if rows else "None.\n"


def why(case: Graded) -> str:
    """What is wrong with an answer."""
    beside = f"{listed(sorted(case.new))} named, though not for the unmodified log"
    found = [beside] if case.new else []
    if case.counts and not case.named:
        found.append("not named" if not case.right & causes(case.answer) else "named among too many")
    if case.counts and not case.first:
        leader = next(iter(case.answer.ranking), "nothing")
        found.append(f"{leader} is first")
    return "; ".join(found)


def _not_run(records: Sequence[Record]) -> str:
    lost = [r for r in records if "failure" in r]
    lines = "".join(f"- `{r['id']}`: {r['failure']}\n" for r in lost)
    reported = f"\nCases that did not run:\n\n{lines}" if lost else ""
    refused = [r for r in records if r.get("not_added")]
    lines = "".join(f"- `{r['id']}`: {'; '.join(r['not_added'])}\n" for r in refused)
    return reported + (
        f"\nTrue effects that could not be added, so that nothing could be measured with them:\n\n{lines}"
        if lines
        else ""
    )


def seconds(records: Iterable[Record]) -> str:
    """Median and longest time of a diagnosis."""
    each = [spent(r) for r in records if r["kind"] != "prediction" and "seconds" in r]
    return f"Median {number(median(each))} s, longest {number(max(each))} s.\n" if each else ""


INTRODUCTION = """\
# Real logs

What the diagnosis says about real logs, and how well its models predict. Nobody knows what is missing in a
model of a real vehicle. Two experiments with a known answer are therefore made: a term of the model is
removed from its vehicle file, and a known effect is injected exactly into the log, by computing what would
have been logged with it. The answer for the original log is shown for comparison.
"""
AS_LOGGED = """\
Errors here and below are of simulated velocities on the validation runs, in % of the motion (geometric mean
over the degrees of freedom), from the measured state at regular intervals. The first third of these runs is
not scored, so that values specific to a run can be estimated from it. A dash means that the simulation
diverged, or that there is no such model. Before: answers of the previous version. Seconds are those of one
processor core; of the few cases in which two worked, those of the clock.

"""
REMOVAL = f"""\
The error of the refitted model before and after the true effect is added by `undertow add`. With * it counts:
the error of the longest simulation falls by {100 * WORTH:g}% or more. If another effect has the same
equation for this vehicle, both names are right.
"""
INJECTION = f"""\
Each effect is injected at three sizes, into every log whose channels can show it. A current is equivalent to
moving ground: nothing in the water changes, so it is exact. So are the others, except where values come from
noisy channels (a lever arm with the logged yaw rate). The table counts cases (in brackets those that count:
adding the right effect lowers the error of the longest simulation by {100 * WORTH:g}% or more); of those
that count, how often the effect is ranked first, and named alone or in a set of two; of all, how often a
wrong cause, or also an effect not named for the original log, is named (of the SUB-fighter 30k the place of
its Doppler log is documented, and counts as neither).
"""
IMPROVED = """\
The logs of most vehicles show that something is missing before anything is injected, so that what is
injected can at best come second. Here the same effects are injected after those found in the unmodified
logs have been added to the vehicle files, named or only improving predictions, as a user would do first.
Commands: `python -m benchmarks.real run --improved --out FILE`, and the page with `--improved FILE`. The
injections into all logs with one degree of freedom were run, and a few into those of the model ship, the
tanker and the ROV.
"""
PREDICTION = """\
All methods are fitted to the same training runs and scored on the same windows of the same runs. In the last
columns, ours is the model with all effects that the diagnosis found to improve predictions, named or not. The
effects, and the windows over which ours is fitted, are chosen on the validation runs; parameters and peers
are not. Grey boxes: least squares on smoothed accelerations with linear thrusters, the best delay of the
commands and products of two velocities; the polynomial of Abkowitz with products of three; STLSQ of PySINDy.
Black boxes: gradient-boosted trees, and a linear state-space model (N4SID of nfoursid, on the longest
training segment only, since it takes one). **>** marks where ours is not below 0.95 of the best grey box.
"""
FAILURES = """\
Every case that counts and whose effect is not both ranked first and named, and every name that is neither
right nor given to the original log. One command repeats a case with all details:

    python -m benchmarks.real one CASE
"""
MAKING = """\
## How it was made

    python -m benchmarks.real run --data ../shared/data --kvlcc2 FOLDER --esso FREE_RUNS --jobs 2
    python -m benchmarks.real page --out docs/real.md

`FOLDER` has the zigzags of the KVLCC2 tanker (HSVA, SIMMAN 2008; repository
martinlarsalbert/System-identification-of-Vessel-Manoeuvring-Models), whose licence is not stated: they are
not part of this project; only the numbers are here. `FREE_RUNS` is the folder data of a clone of
NAOE-5thLab/FRT-DS-ESSO (Esso Osaka, 3 m, in a pond; CC BY-NC 4.0). Cases that ran in parallel had one core
each, and the machine was also busy with other work: times are upper limits.
"""
