"""A plan as a figure and as the table of commands to be run."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from undertow.figures import AFTER, BEFORE, FAINT, FLOOR, INK, figure, look, plain
from undertow.typing import Array

from .problem import Plan, PlannedParameter
from .search import SEPARATION, Planned

# Lines that stand side by side, told apart by colour and by dashes.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", INK, FAINT)
_DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1.5, 1)), (0, (5, 1, 1, 1)))
_GROUPS = (
    ("velocity [m/s]", ("u", "v", "w"), 1.0),
    ("rate [deg/s]", ("p", "q", "r"), np.degrees(1.0)),
    ("depth [m]", ("z",), 1.0),
    ("position [m]", ("x", "y"), 1.0),
    ("angle [deg]", ("phi", "theta", "psi"), np.degrees(1.0)),
)
_PANEL, _BAR, _BELOW = 1.5, 0.36, 1.1


@dataclass(frozen=True)
class PlanSettings:
    """How standard errors are drawn, and commands are written."""

    # Standard error at which bars end, as a share of the value: beyond it nothing is known.
    longest_bar: float = 10.0
    command_digits: int = 6  # of the largest command in a file, significant


SETTINGS = PlanSettings()


def plan_picture(planned: Planned) -> Figure:
    """Commands and motions over time, and bars of standard errors or of distances between models."""
    plan = planned.plan
    units = list(dict.fromkeys(c.unit for c in plan.commands))
    names = [c.name for c in plan.noise]
    groups = [(label, f, k) for label, wanted, k in _GROUPS if (f := [n for n in wanted if n in names])]
    bars = len(plan.parameters) or len(plan.separations)
    heights = [_PANEL] * (len(units) + len(groups)) + [_BELOW + _BAR * bars]
    with look():
        picture, axes = figure(sum(heights), len(heights), height_ratios=heights)
        over_time = axes[:-1, 0]
        for axis, unit in zip(over_time, units, strict=False):
            _draw_commands(axis, planned, unit)
        for axis, (label, found, factor) in zip(over_time[len(units) :], groups, strict=True):
            columns = planned.manoeuvre.y[0][:, [names.index(n) for n in found]] * factor
            _draw_lines(axis, planned.manoeuvre.t, columns, found, label)
        for axis in over_time[:-1]:
            axis.tick_params(labelbottom=False)
        over_time[-1].set_xlabel("time [s]")
        by = "" if len(plan.rivals) < 2 else f", predicted with {plan.rivals[0].name}"
        axes[0, 0].set_title(plain(f"{plan.vehicle}: {plan.manoeuvre}{by}", 110))
        (_draw_errors if plan.parameters else _draw_distances)(axes[-1, 0], plan)
    return picture


def _draw_commands(axis: Any, planned: Planned, unit: str) -> None:
    plan = planned.plan
    chosen = [i for i, c in enumerate(plan.commands) if c.unit == unit]
    least, most = min(plan.commands[i].least for i in chosen), max(plan.commands[i].limit for i in chosen)
    for bound in (least, most):
        axis.axhline(bound, color=FAINT, linewidth=0.8, linestyle=":")
    label = "command" if unit == "command" else f"command [{unit}]"
    columns, names = planned.manoeuvre.u[:, chosen], [plan.commands[i].name for i in chosen]
    _draw_lines(axis, planned.manoeuvre.t, columns, names, label)


def _draw_lines(axis: Any, t: Array, columns: Array, names: Sequence[str], label: str) -> None:
    for i, name in enumerate(_coincident_names(columns, names)):
        if not name:
            continue
        look_of = {"color": _COLOURS[i % len(_COLOURS)], "linestyle": _DASHES[i % len(_DASHES)]}
        axis.plot(t, columns[:, i], label=plain(name), **look_of)
    axis.set_ylabel(label if len(names) > 1 else label.replace(label.partition(" [")[0], names[0], 1))
    axis.set_xlim(0.0, t[-1])
    axis.grid()
    if "z" in names:
        axis.invert_yaxis()
    if len(names) > 1:
        axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize=8, handlelength=2.4)


def _coincident_names(columns: Array, names: Sequence[str]) -> list[str]:
    """Names of the lines; those that lie on each other are named once, the later ones are empty."""
    same = [np.all(np.isclose(columns, columns[:, [i]], atol=1e-9), axis=0) for i in range(len(names))]
    first = [int(np.argmax(row)) for row in same]
    return [
        ", ".join(n for n, f in zip(names, first, strict=True) if f == i) if first[i] == i else ""
        for i in range(len(names))
    ]


def _draw_errors(axis: Any, plan: Plan) -> None:
    """Standard errors as a share of the value, before and after."""
    rows = np.arange(len(plan.parameters))
    for offset, colour, label, which in (
        (-0.2, BEFORE, "now", "error_now"),
        (0.2, AFTER, "after the manoeuvre", "error_after"),
    ):
        shares = [_share(known, getattr(known, which)) for known in plan.parameters]
        axis.barh(rows + offset, shares, height=0.36, color=colour, label=label)
        for row, known, share in zip(rows, plan.parameters, shares, strict=True):
            text = _percent(share) if getattr(known, which) is not None else "not known"
            axis.annotate(
                text, (share, row + offset), (3, 0), textcoords="offset points", va="center", fontsize=8
            )
    axis.set_yticks(rows, [plain(known.name) for known in plan.parameters])
    axis.set_xscale("log")
    axis.set_xlim(0.5 * min(_share(k, k.error_after) for k in plan.parameters), 3 * SETTINGS.longest_bar)
    axis.xaxis.set_major_formatter(lambda value, _: _percent(value))
    axis.set_xlabel("standard error as a share of the value (expected, if the model is right)")
    _finish(axis)


def _share(known: PlannedParameter, error: float | None) -> float:
    size = abs(known.value) or 1.0
    return SETTINGS.longest_bar if error is None else min(error / size, SETTINGS.longest_bar)


def _percent(share: float) -> str:
    return f"{100 * share:.2g}%" if share < 1 else f"{share:.0%}"


def _draw_distances(axis: Any, plan: Plan) -> None:
    """Standard deviations between the models, before and after."""
    rows = np.arange(len(plan.separations))
    looks = [(0.2, AFTER, "with the manoeuvre", [p.deviations for p in plan.separations])]
    if plan.separations[0].deviations_now is not None:
        looks.insert(0, (-0.2, BEFORE, "these logs", [p.deviations_now or 0.0 for p in plan.separations]))
    for offset, colour, label, values in looks:
        axis.barh(rows + offset, values, height=0.36, color=colour, label=label)
        for row, value in zip(rows, values, strict=True):
            axis.annotate(
                f"{value:.3g}" if value < 100 else f"{value:.0f}",
                (value, row + offset),
                (3, 0),
                textcoords="offset points",
                va="center",
            )
    axis.axvline(
        SEPARATION.separated, color=FLOOR, linestyle="--", label=f"told apart ({SEPARATION.separated:g})"
    )
    axis.set_yticks(rows, ["\n".join(map(plain, p.pair)) for p in plan.separations])
    axis.set_xscale("symlog", linthresh=SEPARATION.separated, linscale=0.5)
    axis.xaxis.set_major_formatter("{x:g}")
    axis.set_xlim(0.0, 1.5 * max(SEPARATION.separated, *(p.deviations for p in plan.separations)))
    axis.set_xlabel("expected distance of the models' predictions after refitting [standard deviations]")
    _finish(axis)


def _finish(axis: Any) -> None:
    axis.invert_yaxis()
    axis.grid(axis="x")
    axis.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, fontsize=9, borderaxespad=0.2)


def command_csv(planned: Planned) -> str:
    """The commands as CSV: t in s, then each command in its unit, named as in the vehicle file.

    Numbers are cut off towards zero, so that none passes its limit.
    """
    commands, manoeuvre = planned.plan.commands, planned.manoeuvre
    columns = [[f"{t:.9g}" for t in manoeuvre.t]]
    for i, command in enumerate(commands):
        places = max(
            SETTINGS.command_digits - 1 - math.floor(math.log10(max(command.limit, -command.least))), 0
        )
        cut = np.trunc(manoeuvre.u[:, i] * 10.0**places) / 10.0**places
        columns.append([f"{value:.{places}f}" for value in (cut + 0.0).tolist()])
    head = ",".join(["t", *(c.name for c in commands)])
    return "\n".join([head, *(",".join(row) for row in zip(*columns, strict=True))]) + "\n"
