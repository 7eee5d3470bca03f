"""Pictures of docs/closed-loops.md."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.figure import Figure

from undertow.control.closed_loop import Record
from undertow.control.closed_loop.pictures import coordinate, strategy
from undertow.figures import AFTER, INK, figure, look, save_png

NAMES = {
    "13-strategy": "",
    "14-x": "x",
    "15-y": "y",
    "16-psi": "psi",
    "17-z": "z",
    "limit-cycle": "",
}


def draw(run: Sequence[Record], long: Record, folder: Path) -> None:
    """Write all of them into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    special = {"13-strategy": strategy, "limit-cycle": lambda: limit_cycle(long)}
    for name, shown in NAMES.items():
        picture = coordinate(run, shown) if shown else special[name]()
        save_png(picture, folder / f"closed-loops-{name}.png")


def limit_cycle(record: Record) -> Figure:
    """Distance to go along the track, and the amplitude that it ends at."""
    cycle = record.result.of("along track").cycle
    assert cycle is not None
    error = record.errors["along track"]
    last = error[record.t > 0.8 * record.t[-1]]
    middle = 0.5 * (last.max() + last.min())
    with look():
        picture, axes = figure(3.4)
        axis = axes[0, 0]
        axis.plot(record.t, error, color=AFTER, label="distance to go")
        for side in (-1, 1):
            height = middle + side * cycle.amplitude
            label = f"limit cycle: ±{cycle.amplitude:.2f} m, {cycle.period:.1f} s" if side > 0 else None
            axis.axhline(height, color=INK, linewidth=0.9, linestyle=(0, (4, 3)), label=label)
        axis.set_title("PID of Table 5: it never comes to rest")
        axis.set_xlabel("time [s]")
        axis.set_ylabel("distance to go along the track [m]")
        axis.grid()
        axis.legend(loc="upper right", ncols=2)
    return picture
