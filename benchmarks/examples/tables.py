"""What the commands answered, as Markdown; nothing here decides what is true."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from benchmarks.results.text import (
    MISSING,
    errors,
    estimate,
    lengths,
    listed,
    number,
    percent,
    remaining_of,
    table,
    within_runs,
)
from undertow.identification.diagnosis.result import Diagnosis, Estimate

from .calls import Reported

_CANDIDATES = 6
_PARAMETERS = 4
_KEPT = (
    "command", "next", "title", "verdict", "headline", "effects", "helps", "added", "steps",
    "indistinguishable", "equivalent", "parameters", "seconds", "degrees_of_freedom",
)  # fmt: skip


# --- what is kept -----------------------------------------------------------------------------
def diagnosis_kept(reported: Reported) -> Reported:
    """What a page needs of a diagnosis, without paths of this machine."""
    kept = {k: reported[k] for k in _KEPT}
    kept["ranking"] = reported["ranking"][: 2 * _CANDIDATES]
    kept["candidates"] = len(reported["ranking"])
    kept["doctor"] = [{k: f[k] for k in ("severity", "text")} for f in reported["doctor"]]
    whole = Diagnosis.model_validate({k: v for k, v in reported.items() if k in Diagnosis.model_fields})
    return rounded(kept | remaining_of(whole))


def comparison_kept(reported: Reported) -> Reported:
    """What a page needs of a comparison."""
    kept = {k: reported[k] for k in ("command", "seconds", "headline", "prediction_error", "horizon")}
    kept["dofs"] = [
        {k: d[k] for k in ("degree_of_freedom", "unit", "residual_rms")} for d in reported["dofs"]
    ]
    kept["cells"] = [
        {k: c[k] for k in ("degree_of_freedom", "regime", "residual_rms")}
        for c in reported["cells"]
        if c["normalised"] is not None
    ]
    return rounded(kept)


def rounded(value: Any) -> Any:
    """The same with six significant digits: more would change with every machine."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, Mapping):
        return {k: rounded(v) for k, v in value.items()}
    return [rounded(v) for v in value] if isinstance(value, list | tuple) else value


# --- comparisons ------------------------------------------------------------------------------
def compared(comparisons: Mapping[str, Reported]) -> str:
    """One row for each comparison: the force that the model lacks, and how well it predicts."""
    first = next(iter(comparisons.values()))
    horizon = f"{first['horizon']:g} s ahead"
    rows = [
        [
            name,
            *(number(d["residual_rms"], 2) for d in reported["dofs"]),
            percent(reported["prediction_error"]),
        ]
        for name, reported in comparisons.items()
    ]
    note = f"Force that the model lacks, rms, and error of the velocities {horizon}, in % of their rms.\n\n"
    lines = [f"- {name}: {reported['headline']}." for name, reported in comparisons.items()]
    return note + table(("log", *_dofs(first), horizon), rows) + "\n" + "\n".join(lines) + "\n"


def _dofs(reported: Reported) -> list[str]:
    return [f"{d['degree_of_freedom']} [{d['unit']}]" for d in reported["dofs"]]


def regimes(reported: Reported) -> str:
    """The error map of a comparison: force that the model lacks by regime and degree of freedom."""
    cells = {(c["regime"], c["degree_of_freedom"]): c["residual_rms"] for c in reported["cells"]}
    dofs = [d["degree_of_freedom"] for d in reported["dofs"]]
    rows = [
        [name, *(number(cells.get((name, dof)), 2) for dof in dofs)]
        for name in dict.fromkeys(c["regime"] for c in reported["cells"])
    ]
    return table(("regime", *_dofs(reported)), rows)


# --- diagnoses --------------------------------------------------------------------------------
def verdicts(diagnoses: Iterable[Reported]) -> str:
    """One row for each diagnosis: its errors before and after every effect that was added."""
    head = (
        "identified on → judged on", "verdict", "named or helping", "s ahead", "velocity error",
        "times the noise", "seconds",
    )  # fmt: skip
    return table(head, [_verdict(d) for d in diagnoses], left=3)


def _verdict(d: Reported) -> list[str]:
    ahead = [within_runs(step["ahead"]) for step in d["steps"]]
    falling = " → ".join(errors([one.get(h) for h in ahead[0]]) for one in ahead)
    noise = " → ".join(number(step["error"]) for step in d["steps"])
    return [d["title"], d["verdict"], found(d), lengths(ahead[0]), falling, noise, number(d["seconds"], 2)]


def found(d: Reported) -> str:
    """The effects that are named, with those that the data cannot tell from them, and those that help."""
    alike = {s["effects"][0]: s["effects"][1:] for s in d["indistinguishable"]}
    named = [f"{e} (or {listed(alike[e])})" if e in alike else e for e in d["effects"]]
    return listed([*named, *(f"{e} (helps)" for e in d["helps"])])


def falls(d: Reported) -> str:
    """How the error over the longest horizon falls, in a clause."""
    first, last = (within_runs(d["steps"][k]["ahead"]) for k in (0, -1))
    horizon = list(first)[-1]
    return f"{horizon} ahead from {percent(first[horizon])} to {percent(last[horizon])}"


def diagnosis(d: Reported) -> str:
    """Everything a diagnosis said: headline, what to run next, candidates, what remains, warnings."""
    parts = [f"**{d['title']}**: `{d['verdict']}`. {d['headline']}\n", _next(d), ranking(d), _remarks(d)]
    return "\n".join(p for p in parts if p)


def diagnoses(several: Iterable[Reported]) -> str:
    """All of them."""
    return "\n".join(diagnosis(d) for d in several)


def _next(d: Reported) -> str:
    return f"To run next: `{d['next']}`\n" if d["next"] else ""


def ranking(d: Reported) -> str:
    """Candidates beyond chance: what each does to the error of long simulations, and why it is not named."""
    named = _named(d)
    kept = {*named, *_helping(d)}
    shown = [r for r in d["ranking"] if r["significant"] or r["effect"] in kept][:_CANDIDATES]
    if not shown:
        return f"None of {d['candidates']} candidates does more than chance.\n"
    longest = next((list(r["falls"])[-1] for r in shown if r["falls"]), None)
    rows = [
        [
            r["effect"],
            _values(r["parameters"]),
            _standing(r, d),
            f"{-100 * r['falls'][longest]:+.0f}%" if r["falls"] else MISSING,
            f"{100 * r['explained']:.0f}%",
        ]
        for r in shown
    ]
    head = (
        "candidate",
        "parameters",
        "named?",
        f"error {longest} ahead" if longest else "error ahead",
        "explains",
    )
    return table(head, rows, left=3) + f"\n{d['candidates'] - len(shown)} further candidates.\n"


def _standing(r: Reported, d: Reported) -> str:
    """Whether a candidate is named, or why not."""
    if any(r["effect"] in s["effects"] for s in d["indistinguishable"]):
        return "one of a set"
    if r["effect"] in d["effects"]:
        return "yes"
    helps = "helps to predict; " if r["effect"] in d["helps"] else ""
    return helps + (r["not_named"] or "no")


def _values(parameters: Sequence[Reported]) -> str:
    shown = ", ".join(estimate(Estimate(**p)) for p in parameters[:_PARAMETERS])
    return shown + (", …" if len(parameters) > _PARAMETERS else "") or MISSING


def _remarks(d: Reported) -> str:
    """What is left, what would tell explanations apart, and parameters that make up for something absent."""
    lines = [f"what remains in {left}" for left in d["remaining"]]
    lines += [f"over the longest horizon {d['predictable']}"] if d["predictable"] else []
    lines += [f"to tell them apart: {words}" for words in d["tell"]]
    lines += [f"warning: {words}" for words in d["warnings"]]
    lines += [
        f"{', '.join(e['parameters'])} moved far from what was stated; {listed(e['effects'])} would do the "
        f"same: {e['reason']}"
        for e in d["equivalent"]
    ]
    return "\n".join(f"- {line}" for line in lines) + "\n" if lines else ""


def tally(diagnoses: Iterable[Reported]) -> str:
    """How often every candidate helped beyond chance, helped to predict and was named, over all diagnoses."""
    every = list(diagnoses)
    counts = {
        effect: [sum(effect in names(d) for d in every) for names in (_beyond_chance, _helping, _named)]
        for effect in sorted({r["effect"] for d in every for r in d["ranking"]})
    }
    order = sorted(counts, key=lambda e: (*(-n for n in counts[e][::-1]), e))
    rows = [[e, *map(str, counts[e])] for e in order if any(counts[e])]
    return table((f"candidate, of {len(every)}", "more than chance", "helps to predict", "named"), rows)


def _beyond_chance(d: Reported) -> set[str]:
    return {r["effect"] for r in d["ranking"] if r["significant"]}


def _helping(d: Reported) -> set[str]:
    return set(d["helps"])


def _named(d: Reported) -> set[str]:
    return {*d["effects"], *(e for s in d["indistinguishable"] for e in s["effects"])}


# --- commands, logs and time --------------------------------------------------------------------
def commands(words: Iterable[str], data: str) -> str:
    """Commands as they are typed at the root of the repository."""
    return "\n".join(["```sh", f"DATA={data}", *words, "```", ""])


def doctor(n: Reported) -> str:
    """Mistakes and warnings about the logs, each once."""
    said = {(f["severity"], f["text"]): None for d in n["diagnoses"] for f in d["doctor"]}
    lines = [f"- {severity}: {text}" for severity, text in said if severity != "note"]
    return "\n".join(lines or ["No mistake in how the logs are read, and no warning."]) + "\n"


def typed(n: Reported) -> list[str]:
    """The commands of all comparisons and diagnoses of a page."""
    return [reported["command"] for reported in (*n["compared"].values(), *n["diagnoses"])]


def seconds(n: Reported) -> str:
    """Time taken."""
    slow, quick = ([r["seconds"] for r in several] for several in (n["diagnoses"], n["compared"].values()))
    return (
        f"Diagnoses took {number(min(slow), 2)} to {number(max(slow), 2)} s each, comparisons "
        f"{number(min(quick), 2)} to {number(max(quick), 2)} s.\nThe machine had two cores and other work: "
        "these are upper limits.\n"
    )
