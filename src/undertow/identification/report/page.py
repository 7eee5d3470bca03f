"""The report: one HTML file that needs nothing else, in words for somebody who has to decide something."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from importlib.resources import files
from math import floor, isfinite, log10

from jinja2 import Template
from markupsafe import Markup
from matplotlib.figure import Figure

from undertow.figures import svg, unit_text
from undertow.files import templates
from undertow.identification.diagnosis.result import IN_PART_MEANS, Diagnosis, Estimate, Ranked
from undertow.model.symbols import MOTION_UNITS

from .data import ReportData
from .pictures import (
    error_map,
    falling_error,
    force_budget,
    measured_vs_simulated,
    ranking,
    residual_against,
)
from .sentences import chance, sure_in_words


@dataclass(frozen=True)
class Meaning:
    """A verdict explained: its title, what it says, and what it does not."""

    title: str
    says: str
    not_shown: tuple[str, ...]


@cache
def meanings() -> dict[str, Meaning]:
    """Every verdict explained, and as ``other_values`` one that names values instead of effects."""
    text = (files("undertow.identification.report") / "templates" / "verdicts.toml").read_text("utf-8")
    tables = tomllib.loads(text)
    always = tables.pop("always")["not_shown"]
    return {
        verdict: Meaning(m["title"], m["says"], (*filter(None, [m.get("not_shown")]), *always))
        for verdict, m in tables.items()
    }


def meaning(diagnosis: Diagnosis) -> Meaning:
    """What the verdict of a diagnosis says, and what it does not."""
    changed = diagnosis.verdict == "adequate" and diagnosis.freed
    found = meanings()["other_values" if changed else diagnosis.verdict]
    if not any(run.role == "blocks" for run in diagnosis.runs):
        return found
    more = (
        "How the model does on another day: the validation data are blocks of the same runs, not whole "
        "runs (give some with --holdout)."
    )
    return replace(found, not_shown=(*found.not_shown, more))


def parameter_text(name: str) -> str:
    """A parameter as tables print it: ``X_uabsu`` gives ``X_u|u|``."""
    return re.sub(r"^([XYZKMN]_\w)abs(\w)", r"\1|\2|", name)


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """A number with its unit; an en dash where there is none."""
    if value is None:
        return "–"
    number = f"{value:.{digits}g}" if isfinite(value) else "not finite"
    shown = unit_text(unit)
    return (number if shown in ("", "1") else f"{number} {shown}").replace("-", "−", 1 if value < 0 else 0)


def with_error(value: float, error: float | None, unit: str) -> str:
    """A value and its standard error, which has two digits: ``5.124 ± 0.012 kg``."""
    if error is None or not isfinite(error) or not isfinite(value) or error <= 0:
        return quantity(value, unit)
    places = max(0, 1 - floor(log10(error)))
    if places > 8 or error >= 1e5:
        number = f"{value:.4g} ± {error:.2g}"
    else:
        number = f"{value:.{places}f} ± {error:.{places}f}"
    shown = unit_text(unit)
    return (number if shown in ("", "1") else f"({number}) {shown}").replace("-", "−")


def estimate_text(estimate: Estimate) -> str:
    """A parameter with value, standard error and unit."""
    number = with_error(estimate.value, estimate.standard_error, estimate.unit)
    return f"{parameter_text(estimate.name)} = {number}"


def prior_text(estimate: Estimate) -> str:
    """The value that the vehicle file states."""
    if estimate.prior is None:
        return "–"
    return with_error(estimate.prior, estimate.prior_sigma, estimate.unit)


def percent(share: float | None) -> str:
    """A share as per cent."""
    if share is None or not isfinite(share):
        return "–"
    return f"{100 * share:.3g} %".replace("-", "−")


# A page with the channels of many runs would take minutes to open.
_MOST_RUNS = 3


def render_report(diagnosis: Diagnosis, data: ReportData | None = None) -> str:
    """One self-contained HTML page: no script, and nothing is loaded from anywhere.

    Names out of files are escaped, in the text and inside the pictures. A section without data says so.
    """
    shown = data or ReportData()
    return _template().render(
        d=diagnosis,
        data=shown,
        meaning=meaning(diagnosis),
        in_part_means=IN_PART_MEANS,
        runs=shown.runs[:_MOST_RUNS],
        units=MOTION_UNITS,
        helping=[c for c in diagnosis.ranking if helps(c, diagnosis)],
        idle=[c for c in diagnosis.ranking if not helps(c, diagnosis)],
        left_out=[run.run for run in shown.runs[_MOST_RUNS:]],
        pictures=_Pictures(diagnosis, shown),
    )


def helps(candidate: Ranked, diagnosis: Diagnosis) -> bool:
    """Whether a candidate does anything, in the search or in the verdict; the others are folded away."""
    named = {*diagnosis.effects, *(e for s in diagnosis.indistinguishable for e in s.effects)}
    return bool(candidate.parameters) or candidate.significant or candidate.effect in named


@cache
def _template() -> Template:
    environment = templates("undertow.identification.report", html=True)
    tools: list[Callable[..., str]] = [
        chance,
        estimate_text,
        parameter_text,
        percent,
        prior_text,
        quantity,
        sure_in_words,
        with_error,
        unit_text,
    ]
    environment.filters |= {tool.__name__: tool for tool in tools}
    return environment.get_template("report.html")


class _Pictures:
    """The pictures as the template asks for them; each gets ids that no other has."""

    def __init__(self, diagnosis: Diagnosis, data: ReportData) -> None:
        self._diagnosis, self._data = diagnosis, data
        self._names = (data.before, data.after)
        self._count = 0

    def falling(self) -> Markup:
        return self._inline(falling_error(self._diagnosis.steps, "refitted"))

    def ranking(self) -> Markup:
        d = self._diagnosis
        return self._inline(ranking([c for c in d.ranking if helps(c, d)]))

    def maps(self) -> Iterator[Markup]:
        return (self._inline(error_map(m, self._names)) for m in self._data.maps)

    def run(self, place: int) -> Markup:
        return self._inline(measured_vs_simulated(self._data.runs[place], self._names))

    def residuals(self) -> Iterator[Markup]:
        """One picture for each degree of freedom."""
        for dof in dict.fromkeys(c.before.degree_of_freedom for c in self._data.residuals):
            curves = [c for c in self._data.residuals if c.before.degree_of_freedom == dof]
            yield self._inline(residual_against(curves, self._names))

    def budgets(self) -> Markup:
        return self._inline(force_budget(self._data.budgets))

    def _inline(self, picture: Figure) -> Markup:
        self._count += 1
        # matplotlib escapes the names that it draws, so this is markup of our own.
        return Markup(svg(picture, f"p{self._count}"))
