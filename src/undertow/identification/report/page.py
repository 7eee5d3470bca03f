"""The report: one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from undertow.model.symbols import POSE, VELOCITY, VELOCITY_UNITS

from ..diagnosis.result import IN_PART_MEANS, Diagnosis
from . import words
from .data import ReportData
from .pictures import (
    error_map,
    falling_error,
    force_budget,
    measured_vs_simulated,
    ranking,
    residual_against,
)
from .style import svg, unit_text

# A page with the channels of many runs would take minutes to open.
_MOST_RUNS = 3
_CHANNEL_UNITS = dict(zip((*POSE, *VELOCITY), (*("m",) * 3, *("rad",) * 3, *VELOCITY_UNITS), strict=True))


def render_report(diagnosis: Diagnosis, data: ReportData | None = None) -> str:
    """One self-contained HTML page: no script, and nothing is loaded from anywhere.

    Names out of files are escaped, in the text and inside the pictures.

    Parameters
    ----------
    diagnosis : Diagnosis
        Outcome of a diagnosis.
    data : ReportData, optional
        What the pictures of the comparison show; a section without data says so.
    """
    shown = data or ReportData()
    return _template().render(
        d=diagnosis,
        data=shown,
        meaning=words.meaning(diagnosis),
        in_part_means=IN_PART_MEANS,
        runs=shown.runs[:_MOST_RUNS],
        units=_CHANNEL_UNITS,
        left_out=[run.run for run in shown.runs[_MOST_RUNS:]],
        pictures=_Pictures(diagnosis, shown),
    )


@cache
def _template() -> Any:
    environment = Environment(
        loader=PackageLoader("undertow.identification.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    tools: list[Callable[..., str]] = [
        words.estimate_text,
        words.parameter_text,
        words.percent,
        words.prior_text,
        words.quantity,
        words.with_error,
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
        return self._inline(falling_error(self._diagnosis.steps))

    def ranking(self) -> Markup:
        return self._inline(ranking(self._diagnosis.ranking))

    def maps(self) -> Iterator[Markup]:
        return (self._inline(error_map(m, self._names)) for m in self._data.maps)

    def run(self, place: int) -> Markup:
        return self._inline(measured_vs_simulated(self._data.runs[place], self._names))

    def residuals(self) -> Iterator[Markup]:
        """One picture for each degree of freedom."""
        for dof in dict.fromkeys(c.degree_of_freedom for c in self._data.residuals):
            curves = [c for c in self._data.residuals if c.degree_of_freedom == dof]
            yield self._inline(residual_against(curves, self._names))

    def budgets(self) -> Markup:
        return self._inline(force_budget(self._data.budgets))

    def _inline(self, picture: Figure) -> Markup:
        self._count += 1
        # matplotlib escapes the names that it draws, so this is markup of our own.
        return Markup(svg(picture, f"p{self._count}"))
