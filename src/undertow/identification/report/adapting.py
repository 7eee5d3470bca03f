"""From two comparisons of a model with logs to what a report draws."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import PackageNotFoundError, version

from undertow.model.symbols import VELOCITY

from ..compare.comparison import Comparison
from ..compare.shown import budgets, curves, error_map, leading, traces
from .data import Listing, ReportData, RunTraces
from .words import percent, quantity

# Panels for each degree of freedom: those of the variables that the residual follows most.
_MOST_VARIABLES = 6
_PROGRAMS = ("numpy", "scipy", "casadi", "sympy")


def report_data(
    before: Comparison,
    after: Comparison | None = None,
    *,
    names: tuple[str, str] = ("model as given", "with what is missing"),
    settings: Mapping[str, str] | None = None,
) -> ReportData:
    """What a report shows of a model, and of the same model with something added, on the same logs.

    Parameters
    ----------
    before, after : Comparison
        Comparisons of both models with the same kept-aside logs; without `after` one model is shown.
    names : (str, str)
        What pictures call the two.
    settings : mapping, optional
        Further lines for the record of what was done.
    """
    result = before.result
    both = [c for c in (before, after) if c is not None]
    found = curves(before, after)
    ahead = f"over {result.horizon:g} s, from {result.windows} measured starts"
    return ReportData(
        before=names[0],
        after=names[1],
        headlines=tuple(f"{name}: {c.result.headline}" for name, c in zip(names, both, strict=False)),
        maps=(error_map(before, after),),
        runs=tuple(_velocities_first(run) for run in traces(before, after, free=True)),
        residuals=tuple(c for dof in result.degrees_of_freedom for c in leading(found, dof, _MOST_VARIABLES)),
        budgets=tuple(budgets(both[-1])),
        fits=_fits(before, after),
        settings={"prediction ahead": ahead, **(settings or {})},
        versions=versions(),
    )


def versions() -> dict[str, str]:
    """Versions of Python and of the libraries that work out the numbers."""
    found = {"Python": f"{platform.python_version()} on {platform.system()} {platform.machine()}"}
    for name in _PROGRAMS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # installed without metadata, by a system's own packages
            found[name] = "version unknown"
    return found


def _velocities_first(run: RunTraces) -> RunTraces:
    """The fit looks at the velocities; the pose drifts in a free run."""
    return replace(run, traces=tuple(sorted(run.traces, key=lambda t: t.channel not in VELOCITY)))


def _fits(before: Comparison, after: Comparison | None) -> Listing:
    later = {c.channel: c for c in after.result.channels} if after else {}
    rows = []
    for channel in before.result.channels:
        shown = [channel, *([later[channel.channel]] if channel.channel in later else [])]
        ahead = " → ".join(quantity(c.ahead_rms, channel.unit, 3) for c in shown)
        free = " → ".join(percent(_share(c.free_run_fit)) for c in shown)
        rows.append((channel.channel, quantity(channel.noise, channel.unit, 2), ahead, free))
    ahead = f"error {before.result.horizon:g} s ahead, rms"
    return Listing(("channel", "noise", ahead, "free-run fit (100 % is perfect)"), tuple(rows))


def _share(per_cent: float | None) -> float | None:
    return None if per_cent is None else per_cent / 100.0
