"""Markdown: tables and numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from undertow.identification.diagnosis.result import Estimate, Ranked

MISSING = "–"
RANKING_HEAD = ("candidate", "parameters", "error before", "error after", "significant")
VERDICT_HEAD = (
    "identified on → judged on",
    "verdict",
    "named",
    "kept-aside error",
    "5 s ahead",
    "what remains",
    "seconds",
)


def table(head: Sequence[str], rows: Iterable[Sequence[str]], left: int = 1) -> str:
    """A Markdown table; the first `left` columns are aligned left, the others right."""
    rule = ["---"] * left + ["---:"] * (len(head) - left)
    lines = [head, rule, *rows]
    return "\n".join("| " + " | ".join(_cell(c) for c in line) + " |" for line in lines) + "\n"


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits, never in powers of ten."""
    if value is None or value != value:
        return MISSING
    if abs(value) >= 10 ** (digits - 1):
        return f"{value:.0f}"
    text = f"{value:.{digits}g}"
    return text if "e" not in text else f"{value:.{digits + 3}f}"


def percent(value: float | None) -> str:
    """A share in %, with two significant digits below ten."""
    return MISSING if value is None else f"{100 * value:.2g} %" if value < 0.1 else f"{100 * value:.0f} %"


def chance(p: float) -> str:
    """A p value."""
    return "< 0.001" if p < 1e-3 else f"{p:.2g}"


def estimate(p: Estimate) -> str:
    """A fitted parameter with standard error and unit."""
    spread = "" if p.standard_error is None else f" ± {p.standard_error:.1g}"
    return f"{p.name} = {p.value:.4g}{spread} {p.unit}".rstrip()


def ranked(r: Ranked) -> list[str]:
    """A candidate as a row under `RANKING_HEAD`."""
    found = ", ".join(estimate(p) for p in r.parameters) or MISSING
    errors = [number(r.error_before), number(r.error_after)]
    return [r.effect, found, *errors, "yes" if r.significant else "no"]


def listed(names: Iterable[str]) -> str:
    """Names in one cell."""
    return ", ".join(names) or MISSING
