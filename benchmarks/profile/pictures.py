"""CPU seconds by module, stacked by stage."""

from __future__ import annotations

from pathlib import Path

from matplotlib import colormaps
from matplotlib.figure import Figure

from undertow.figures import figure, look, save_png

from .measure import Profile
from .page import SHOWN

_LEAST = 0.005  # share of all below which a stage is not drawn


def draw(profile: Profile, target: Path) -> None:
    """The picture as PNG."""
    target.parent.mkdir(parents=True, exist_ok=True)
    save_png(stacked(profile), target)


def stacked(profile: Profile) -> Figure:
    """A bar for every module that takes much, the busiest on top."""
    modules, used = profile.by_module[:SHOWN], profile.stages
    stages = [s for s, t in used.items() if t > _LEAST * sum(used.values())]
    names = [name for name, _ in modules]
    with look():
        picture, axes = figure(4.4, 1, 1)
        axis, left = axes[0, 0], [0.0] * len(modules)
        for stage, colour in zip(stages, colormaps["tab10"].colors, strict=False):
            widths = [found.get(stage, 0.0) for _, found in modules]
            label = f"{stage} ({used[stage]:.1f} s in all)"
            axis.barh(names, widths, left=left, color=colour, label=label)
            left = [a + b for a, b in zip(left, widths, strict=True)]
        for place, total in enumerate(left):
            axis.text(total, place, f" {total:.1f} s", va="center")
        axis.invert_yaxis()
        axis.set_xlim(0, 1.12 * max(left))
        axis.set_xlabel("processor time, s, by module of undertow")
        axis.legend(loc="lower right")
        axis.grid(axis="x")
    return picture
