"""What undertow said, as Markdown; nothing here decides what is true."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from benchmarks.results.text import MISSING, listed, number, percent, table
from benchmarks.results.text import chance as chance_of
from undertow.identification.diagnosis.result import IN_PART, IN_PART_MEANS, how_sure

from .calls import Reported

_CANDIDATES = 6
_PARAMETERS = 4
_KEPT = (
    "command", "title", "verdict", "headline", "effects", "steps", "indistinguishable", "warnings",
    "equivalent", "remaining", "parameters", "false_alarm_rate", "seconds", "degrees_of_freedom",
)  # fmt: skip


# --- what is kept -----------------------------------------------------------------------------
def diagnosis_kept(reported: Reported) -> Reported:
    """What a page needs of a diagnosis, without paths of this machine."""
    kept = {k: reported[k] for k in _KEPT if k in reported}
    kept["ranking"] = reported["ranking"][: 2 * _CANDIDATES]
    kept["runs"] = [{k: r[k] for k in ("name", "role", "samples", "duration")} for r in reported["runs"]]
    kept["candidates"] = len(reported["ranking"])
    kept["doctor"] = [{k: f[k] for k in ("severity", "text")} for f in reported.get("doctor", [])]
    return rounded(kept)


def comparison_kept(reported: Reported) -> Reported:
    """What a page needs of a comparison."""
    kept = {
        k: reported[k]
        for k in ("command", "seconds", "headline", "prediction_error", "horizon", "channels", "worst")
    }
    inputs = {d["degree_of_freedom"]: d["inputs"] for d in reported["dofs"]}
    wanted = ("degree_of_freedom", "unit", "residual_rms", "noise_rms", "normalised")
    kept["dofs"] = [
        {k: d[k] for k in wanted} | {"inputs": inputs[d["degree_of_freedom"]]} for d in reported["dofs"]
    ]
    kept["cells"] = [
        {k: c[k] for k in ("degree_of_freedom", "group", "regime", "residual_rms", "normalised")}
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
    """One row for each comparison: the force that the model lacks, and the prediction 5 s ahead."""
    first = next(iter(comparisons.values()))
    names = [f"{d['degree_of_freedom']} [{d['unit']}]" for d in first["dofs"]]
    rows = [
        [name, *(_lacking(d) for d in reported["dofs"]), percent(reported["prediction_error"])]
        for name, reported in comparisons.items()
    ]
    head = ("log", *names, "5 s ahead")
    note = "Force that the model lacks, rms (in brackets: times the noise); velocity error 5 s ahead.\n\n"
    lines = [f"- {name}: {reported['headline']}." for name, reported in comparisons.items()]
    return note + table(head, rows) + "\n" + "\n".join(lines) + "\n"


def _lacking(d: Reported) -> str:
    times = MISSING if d["normalised"] is None else number(d["normalised"], 2)
    return f"{number(d['residual_rms'], 2)} ({times})"


def regimes(reported: Reported) -> str:
    """The error map of a comparison: residual force over its noise by regime and degree of freedom."""
    dofs = [d["degree_of_freedom"] for d in reported["dofs"]]
    cells = {(c["regime"], c["degree_of_freedom"]): c for c in reported["cells"]}
    rows = [
        [name, *(_cell(cells.get((name, dof))) for dof in dofs)]
        for name in dict.fromkeys(c["regime"] for c in reported["cells"])
    ]
    return table(("regime", *dofs), rows)


def _cell(cell: Reported | None) -> str:
    return MISSING if cell is None else number(cell["normalised"], 2)


# --- diagnoses --------------------------------------------------------------------------------
def verdicts(diagnoses: Iterable[Reported]) -> str:
    """One row for each diagnosis."""
    head = ("identified on → judged on", "verdict", "named", "kept-aside error", "5 s ahead", "seconds")
    return table(head, [_verdict(d) for d in diagnoses], left=3)


def _verdict(d: Reported) -> list[str]:
    errors = " → ".join(number(s["error"]) for s in d["steps"])
    ahead = " → ".join(percent(s["prediction"]) for s in d["steps"])
    tried = d["steps"][-1]["added"]
    sets = [" or ".join(s["effects"]) for s in d["indistinguishable"]]
    named = listed([*d["effects"], *sets]) if d["effects"] or sets else f"none (tried: {listed(tried)})"
    return [d["title"], d["verdict"], named, errors, ahead, number(d["seconds"], 2)]


def diagnosis(d: Reported) -> str:
    """Everything a diagnosis said: headline, candidates, what remains, warnings."""
    parts = [f"**{d['title']}**: {d['headline']}\n", ranking(d), horizons(d), remaining(d), alarms(d)]
    return "\n".join(p for p in parts if p)


def diagnoses(several: Iterable[Reported]) -> str:
    """All of them."""
    return "\n".join(diagnosis(d) for d in several)


def ranking(d: Reported) -> str:
    """The leading candidates."""
    helping = [r for r in d["ranking"] if r["parameters"]][:_CANDIDATES]
    rows = [
        [
            r["effect"],
            _values(r["parameters"]),
            f"{number(r['error_before'])} → {number(r['error_after'])}",
            f"{100 * r['explained']:.0f} %",
            _chance(r.get("p_value")),
            how_sure(r["significant"], r["error_before"], r["error_after"]),
        ]
        for r in helping
    ]
    rest = d["candidates"] - len(helping)
    head = ("candidate", "parameters", "kept-aside error", "explains", "p", "more than chance")
    shown = table(head, rows, left=2) if rows else ""
    shown += f"\n{IN_PART_MEANS}\n" if any(row[-1] == IN_PART for row in rows) else ""
    return shown + f"\n{rest} further candidates help less or not at all.\n"


def _chance(p: float | None) -> str:
    return MISSING if p is None else chance_of(p)


def horizons(d: Reported) -> str:
    """Velocity error ahead over several times, with every effect that was tried."""
    lengths = list(d["steps"][0].get("ahead") or {})
    if not lengths:
        return ""
    rows = [
        [" + ".join(["model", *s["added"]]), *(percent(s["ahead"].get(h)) for h in lengths)]
        for s in d["steps"]
    ]
    return table(("velocity error on kept-aside data", *lengths), rows)


def _values(parameters: Sequence[Reported]) -> str:
    shown = ", ".join(value(p) for p in parameters[:_PARAMETERS])
    return shown + (", …" if len(parameters) > _PARAMETERS else "") or MISSING


def value(p: Reported) -> str:
    """A fitted parameter with standard error and unit."""
    spread = "" if p["standard_error"] is None else f" ± {p['standard_error']:.1g}"
    return f"{p['name']} = {p['value']:.4g}{spread} {p['unit']}".rstrip()


def remaining(d: Reported) -> str:
    """What is left in each degree of freedom."""
    lines = [f"- what remains in {r['degree_of_freedom']}: {_left(r)}" for r in d["remaining"]]
    return "\n".join(lines) + "\n"


def _left(r: Reported) -> str:
    reported = f"{number(r['residual_rms'], 2)} {r['unit']} rms, {r['note']}"
    # The sentence that describes the rest begins with the same number.
    _, _, more = r.get("summary", "").partition("; ")
    return f"{reported}; {more}" if more else reported


def alarms(d: Reported) -> str:
    """Parameters that make up for something absent, and effects that act like changed parameters."""
    reported = [f"- warning: {w}" for w in d["warnings"]]
    reported += [
        f"- {', '.join(e['parameters'])} moved far from what was stated; {listed(e['effects'])} would do the "
        f"same: {e['reason']}"
        for e in d.get("equivalent", [])
    ]
    return "\n".join(reported) + "\n" if reported else ""


def tally(diagnoses: Iterable[Reported]) -> str:
    """How often every candidate helped beyond chance, and how often it was named, over all diagnoses."""
    found = list(diagnoses)
    sure: dict[str, int] = {}
    named: dict[str, int] = {}
    for d in found:
        for r in d["ranking"]:
            sure[r["effect"]] = sure.get(r["effect"], 0) + int(r["significant"])
        for effect in {*d["effects"], *(e for s in d["indistinguishable"] for e in s["effects"])}:
            named[effect] = named.get(effect, 0) + 1
    order = sorted(sure, key=lambda e: (-named.get(e, 0), -sure[e], e))
    rows = [[e, str(sure[e]), str(named.get(e, 0))] for e in order if sure[e] or named.get(e)]
    return table(("candidate", f"more than chance, of {len(found)}", f"named, of {len(found)}"), rows)


def commands(words: Iterable[str], data: str) -> str:
    """Commands as they are typed at the root of the repository."""
    return "\n".join(["```sh", f"DATA={data}", *words, "```", ""])


def doctor(n: Reported) -> str:
    """Mistakes and warnings about the logs, each once."""
    asked = [d for d in n["diagnoses"] if "doctor" in d]
    if not asked:
        return (
            "The diagnoses of this page are older than that: `undertow doctor` tells it for the same logs.\n"
        )
    found = {(f["severity"], f["text"]): None for d in asked for f in d["doctor"]}
    lines = [f"- {severity}: {text}" for severity, text in found if severity != "note"]
    return "\n".join(lines or ["No mistake in how the logs are read, and no warning."]) + "\n"


def typed(n: Reported) -> list[str]:
    """The commands of all comparisons and diagnoses of a page."""
    return [reported["command"] for reported in (*n["compared"].values(), *n["diagnoses"])]


def seconds(n: Reported) -> str:
    """Time taken."""
    slow = [d["seconds"] for d in n["diagnoses"]]
    quick = [c.get("seconds", c.get("wall", 0.0)) for c in n["compared"].values()]
    return (
        f"Diagnoses took {number(min(slow), 2)} to {number(max(slow), 2)} s each, comparisons "
        f"{number(min(quick), 2)} to {number(max(quick), 2)} s.\nThe machine had two cores and other work: "
        "these are upper limits.\n"
    )
