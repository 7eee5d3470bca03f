"""The report of a diagnosis: one HTML page, and the pictures in it.

Names are loaded on first use: whoever needs the tables only does not wait for matplotlib.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .adapting import report_data
    from .data import Budget, ErrorMap, Listing, ReportData, ResidualCurve, RunTraces, Trace
    from .page import render_report
    from .pictures import (
        error_map,
        falling_error,
        force_budget,
        measured_vs_simulated,
        ranking,
        residual_against,
    )
    from .style import save_png

_HOMES = {
    "adapting": ("report_data",),
    "data": ("Budget", "ErrorMap", "Listing", "ReportData", "ResidualCurve", "RunTraces", "Trace"),
    "page": ("render_report",),
    "pictures": (
        "error_map",
        "falling_error",
        "force_budget",
        "measured_vs_simulated",
        "ranking",
        "residual_against",
    ),
    "style": ("save_png",),
}

__all__ = [
    "Budget",
    "ErrorMap",
    "Listing",
    "ReportData",
    "ResidualCurve",
    "RunTraces",
    "Trace",
    "error_map",
    "falling_error",
    "force_budget",
    "measured_vs_simulated",
    "ranking",
    "render_report",
    "report_data",
    "residual_against",
    "save_png",
]


def __getattr__(name: str) -> Any:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
