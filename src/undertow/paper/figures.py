"""Figures 6 to 12 of the paper: velocities and accelerations as the filters leave them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from undertow.figures import COLOURS, figure, look, plain, unit_text
from undertow.identification.logs.run import Run
from undertow.model.symbols import VELOCITY_UNITS

from .least_squares import Experiment
from .regression import CASES, Edges

# Runs that are drawn: the paper compares two (of 120 and of 150 samples).
_MOST_RUNS = 4


class _Plan(NamedTuple):
    """One figure: its cases, whether velocity and acceleration are drawn, and runs apart or together."""

    number: int
    title: str
    cases: tuple[int, ...]
    velocity: bool
    acceleration: bool
    in_one_figure: bool = False


_PLANS = (
    _Plan(6, "filtered velocity, cases 1 to 5", (1, 2, 3, 4, 5), True, False),
    _Plan(7, "filtered acceleration, cases 1 to 5", (1, 2, 3, 4, 5), False, True),
    _Plan(8, "case 3 of each run", (3,), True, True, in_one_figure=True),
    _Plan(9, "acceleration filtered twice, cases 6 to 9", (6, 7, 8, 9), False, True),
    _Plan(10, "case 8 of each run", (8,), False, True, in_one_figure=True),
    _Plan(11, "velocity by the Savitzky-Golay method, and as logged", (1, 10), True, False),
    _Plan(12, "acceleration by the Savitzky-Golay method, cases 10 and 11", (10, 11), False, True),
)


def figures(experiments: Sequence[Experiment], edges: Edges) -> dict[str, Figure]:
    """The pictures by file name, those of several motions with the motion in it."""
    several = len(experiments) > 1
    return {
        f"{str(e.axis).replace(', ', '-') + '-' if several else ''}figure-{plan.number}": _figure(
            e, plan, edges
        )
        for e in experiments
        for plan in _PLANS
    }


def _figure(experiment: Experiment, plan: _Plan, edges: Edges) -> Figure:
    runs = experiment.runs[:_MOST_RUNS]
    kinds = [k for k, wanted in (("velocity", plan.velocity), ("acceleration", plan.acceleration)) if wanted]
    panels = [
        (kind, group) for kind in kinds for group in ([runs] if plan.in_one_figure else [[r] for r in runs])
    ]
    with look():
        picture, axes = figure(1.2 + 2.4 * len(panels), len(panels), sharex=True)
        for axis, (kind, group) in zip(axes[:, 0], panels, strict=True):
            _panel(axis, experiment, plan, kind, group, edges)
        axes[-1, 0].set_xlabel("time [s]")
        title = f"As Figure {plan.number} of the paper, {experiment.axis}: {plan.title}"
        picture.suptitle(plain(title, 110), x=0.01, ha="left", fontsize=10)
    return picture


def _panel(
    axis: Any, experiment: Experiment, plan: _Plan, kind: str, runs: Sequence[Run], edges: Edges
) -> None:
    lines = [(run, case) for run in runs for case in plan.cases]
    for i, (run, case) in enumerate(lines):
        t, *signals = experiment.regression.signals(run, CASES[str(case)], edges)
        words = f"{run.name}, {run.t.size} samples" if plan.in_one_figure else f"case {case}"
        colour = COLOURS[i % len(COLOURS)]
        axis.plot(t, signals[kind == "acceleration"], color=colour, label=plain(words), linewidth=1.1)
    unit = VELOCITY_UNITS[experiment.axis.place]
    name = experiment.axis.velocity
    label = f"{name} [{unit_text(unit)}]" if kind == "velocity" else f"d{name}/dt [{unit_text(unit + '^2')}]"
    axis.set_ylabel(label)
    if not plan.in_one_figure:
        axis.set_title(plain(f"{runs[0].name}, {runs[0].t.size} samples"))
    axis.grid()
    axis.legend(loc="best")
