"""Markdown: tables and numbers."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from undertow.identification.diagnosis.floors import predictable_in_words
from undertow.identification.diagnosis.result import Diagnosis, Estimate

MISSING = "–"
_FREE_RUN = "free run"


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
    return MISSING if value is None else f"{100 * value:.2g}%" if value < 0.1 else f"{100 * value:.0f}%"


def errors(values: Sequence[float | None] | None) -> str:
    """Errors at several horizons, in % of the motion."""
    return " / ".join(percent(v) for v in values) if values else MISSING


def within_runs(ahead: Mapping[str, float]) -> dict[str, float]:
    """The errors of a step at its horizons ("5.3 s"), without that of the simulation from start to end."""
    return {horizon: error for horizon, error in ahead.items() if horizon != _FREE_RUN}


def lengths(ahead: Mapping[str, float]) -> str:
    """The horizons of `within_runs`, s."""
    return " / ".join(horizon.removesuffix(" s") for horizon in ahead) or MISSING


def chance(p: float) -> str:
    """A p value."""
    return "< 0.001" if p < 1e-3 else f"{p:.2g}"


def estimate(p: Estimate) -> str:
    """A fitted parameter with standard error and unit."""
    spread = "" if p.standard_error is None else f" ± {p.standard_error:.1g}"
    return f"{p.name} = {p.value:.4g}{spread} {p.unit}".rstrip()


def listed(names: Iterable[str]) -> str:
    """Names in one cell."""
    return ", ".join(names) or MISSING


def remaining_of(found: Diagnosis) -> dict[str, Any]:
    """What the last model leaves, what could be predicted of it, and what would tell more, in words."""
    ahead = list(within_runs(found.last_step.ahead).values())
    return {
        "remaining": [left.summary or f"{left.degree_of_freedom}: {left.note}" for left in found.remaining],
        "predictable": predictable_in_words(ahead[-1], found.predictable)
        if ahead and found.predictable
        else "",
        "tell": [s.separated_by for s in found.indistinguishable if s.separated_by],
        "warnings": found.warnings,
    }
