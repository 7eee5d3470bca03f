"""Pictures of closed loops: coordinates and commands over time, and the control strategy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch
from scipy.ndimage import binary_closing, maximum_filter1d, minimum_filter1d

from undertow.figures import COLOURS, FAINT, INK, figure, look, plain, spanning, with_unit
from undertow.typing import Array

from .record import CommandRange, Record

_STYLES = ("-", "--", "-.", ":")
_TITLES = {
    "x": "Position to the north",
    "y": "Position to the east",
    "z": "Depth",
    "phi": "Roll",
    "theta": "Pitch",
    "psi": "Heading",
}

# Numbers of the same pictures in the mini-AUV paper.
_IN_PAPER = {"strategy": 13, "x": 14, "y": 15, "psi": 16, "z": 17}
_PAPERS_VEHICLE = "mini-auv"


@dataclass(frozen=True)
class BandSettings:
    """When a command is drawn as a band instead of unresolvable lines."""

    bins: int = 300  # parts of the picture's width, each a few pixels wide
    # Way to and fro in a segment, in heights of it, from which it is a band; a smooth motion turns once.
    travel: float = 3.0
    height: float = 0.02  # least height of a band, as a part of the range of the command
    gap: int = 7  # segments over which a band is closed and its edges are taken: six are 2% of the width


BAND = BandSettings()


@dataclass(frozen=True)
class SpanSettings:
    """Least spans of axes: less than anyone measures, and far above rounding errors."""

    metres: float = 1e-3
    degrees: float = 0.1
    command: float = 1e-3  # as a part of the largest command of that unit

    def of(self, unit: str) -> float:
        """The span of an axis in "m" or "deg"."""
        return self.degrees if unit == "deg" else self.metres


SPAN = SpanSettings()


def pictures(records: Sequence[Record]) -> dict[str, Figure]:
    """Pictures of some runs by name: coordinates, track, commands, the strategy if it has a gate."""
    names = [n for n in _TITLES if all(n in r.result.to for r in records)]
    if all(r.followed is not None for r in records):
        drawn = {"track": track(records), "errors": errors(records)}
    else:
        drawn = {name: coordinate(records, name) for name in names}
        if {"x", "y"} <= set(names):
            drawn["track"] = track(records)
    drawn["commands"] = commands(records)
    if all(r.result.gate_passed is not None for r in records):
        drawn["strategy"] = strategy(_title_prefix(records, "strategy"))
    return drawn


def _title_prefix(records: Sequence[Record], name: str) -> str:
    """What a title begins with: the number in the paper, of the vehicle that is the paper's."""
    known = name in _IN_PAPER and records[0].result.vehicle == _PAPERS_VEHICLE
    return f"As Figure {_IN_PAPER[name]} of the paper: " if known else ""


def coordinate(records: Sequence[Record], name: str) -> Figure:
    """One coordinate of several runs over time, with the set-point."""
    angle = records[0].result.of(name).unit == "rad"
    scale, unit = (180 / np.pi, "deg") if angle else (1.0, "m")
    with look():
        picture, axes = figure(3.6)
        axis = axes[0, 0]
        goal = scale * records[0].result.to[name]
        axis.axhline(
            goal, color=INK, linewidth=0.9, linestyle=(0, (1, 2)), label=f"set-point {goal:.4g} {unit}"
        )
        for i, record in enumerate(records):
            axis.plot(
                record.t, scale * record.state[name], label=plain(record.result.controller), **_line_style(i)
            )
            if record.result.gate_passed is not None and name in "xy":
                height = scale * record.result.start[name]
                axis.plot(record.result.gate_passed, height, "o", color=_line_style(i)["color"], markersize=4)
        number = _title_prefix(records, name)
        axis.set_title(f"{number}{_TITLES[name]} of {plain(records[0].result.vehicle)}")
        axis.set_xlabel("time [s]")
        axis.set_ylabel(f"{_TITLES[name].lower()} {name} [{unit}]")
        spanning(axis, SPAN.of(unit))
        axis.grid()
        axis.legend(loc="best")
    return picture


def track(records: Sequence[Record]) -> Figure:
    """The track of several runs in the plane, north up, with the mission or the set-point."""
    first = records[0]
    with look():
        picture, axes = figure(5.0)
        axis = axes[0, 0]
        if first.followed is not None:
            axis.plot(first.followed.path[:, 1], first.followed.path[:, 0], ":", color=INK, label="mission")
        for i, record in enumerate(records):
            kept, name = _before_arrival(record), plain(record.result.controller)
            axis.plot(record.state["y"][kept], record.state["x"][kept], label=name, **_line_style(i))
        axis.plot(first.state["y"][0], first.state["x"][0], "o", color=INK, fillstyle="none", label="start")
        if {"x", "y"} <= set(first.result.to):
            goal = first.result.to
            words = "end" if first.followed else "set-point"
            axis.plot(goal["y"], goal["x"], "*", color=INK, markersize=9, label=words)
        axis.set_title(f"Track of {plain(first.result.vehicle)} in the plane")
        axis.set(xlabel="position to the east y [m]", ylabel="position to the north x [m]")
        spanning(axis, SPAN.metres, "x")
        spanning(axis, SPAN.metres)
        axis.set_aspect("equal", adjustable="datalim")
        axis.grid()
        axis.legend(loc="best")
    return picture


def errors(records: Sequence[Record]) -> Figure:
    """Errors along a mission over time, one panel for metres and one for angles."""
    units = {"m": 1.0, "deg": 180 / np.pi}
    with look():
        found = [(r, _errors_by_unit(r)) for r in records]
        shown = [u for u in units if any(by[u] for _, by in found)]
        picture, axes = figure(1.1 + 2.0 * len(shown), len(shown), 1, sharex=True)
        for axis, unit in zip(axes[:, 0], shown, strict=True):
            for record, by in found:
                for i, (name, values) in enumerate(by[unit].items()):
                    label = name if len(records) == 1 else f"{name}, {plain(record.result.controller)}"
                    axis.plot(record.t, units[unit] * values, label=label, **_line_style(i))
            axis.set_ylabel(f"desired less true [{unit}]")
            spanning(axis, SPAN.of(unit))
            axis.grid()
            axis.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)  # above: the errors fill it
        axes[-1, 0].set_xlabel("time [s]")
    return picture


def _before_arrival(record: Record) -> np.ndarray:
    """Rows up to the end of the mission, which is not always held after it; all without one."""
    followed = record.result.followed
    return np.asarray(record.t <= ((followed.arrived if followed else None) or record.t[-1]))


def _errors_by_unit(record: Record) -> dict[str, dict[str, np.ndarray]]:
    assert record.followed is not None
    kept = _before_arrival(record)
    by: dict[str, dict[str, np.ndarray]] = {"m": {}, "deg": {}}
    for name, values in record.followed.errors.items():
        by["deg" if name in ("phi", "theta", "psi") else "m"][name] = np.where(kept, values, np.nan)
    return by


def _line_style(i: int) -> dict[str, Any]:
    return {"color": COLOURS[i % len(COLOURS)], "linestyle": _STYLES[i % len(_STYLES)]}


def band(t: Array, values: Array, swing: CommandRange) -> tuple[Array, ...] | None:
    """Times, mean, lower and upper edge of a command that chatters, or None for one that is drawn as a line.

    Where it does not chatter the edges are the mean.
    """
    if len(t) < BAND.bins:
        return None
    parts = np.array_split(np.arange(len(t)), BAND.bins)
    given: list[tuple[Callable[[Array], Any], Array]] = [
        (np.mean, t),
        (np.mean, values),
        (np.min, swing.low),
        (np.max, swing.high),
        (np.sum, swing.travel),
    ]
    times, mean, low, high, travel = (np.array([f(a[p]) for p in parts]) for f, a in given)
    height = high - low
    chatters = (travel >= BAND.travel * height) & (height > BAND.height * (high.max() - low.min()))
    if not chatters.any():
        return None
    # Where the switching slows down for a moment the band goes on.
    closed = binary_closing(chatters, np.ones(BAND.gap)) | chatters
    low, high = minimum_filter1d(low, BAND.gap), maximum_filter1d(high, BAND.gap)
    return times, mean, np.where(closed, low, mean), np.where(closed, high, mean)


def _draw(axis: Any, record: Record, name: str, i: int) -> None:
    """A command as a line, or as its mean with the band that it fills."""
    t, values, words = record.t, record.commands[name], plain(record.result.controller)
    edges = band(t, values, record.command_ranges[name])
    if edges is None:
        axis.plot(t, values, label=words, **_line_style(i))
        return
    times, mean, low, high = edges
    axis.fill_between(times, low, high, color=_line_style(i)["color"], alpha=0.35, linewidth=0)
    axis.plot(times, mean, label=f"{words} (band: chatters)", **_line_style(i))


def commands(records: Sequence[Record]) -> Figure:
    """The commands of several runs over time, one panel for each."""
    names = list(records[0].commands)
    units = {c.name: c.unit for c in records[0].result.commands}
    with look():
        picture, axes = figure(1.1 + 1.4 * len(names), len(names), 1, sharex=True)
        for axis, name in zip(axes[:, 0], names, strict=True):
            for i, record in enumerate(records):
                if name in record.commands:
                    _draw(axis, record, name, i)
            axis.set_ylabel(with_unit(name, units[name]))
            largest = (c.peak for r in records for c in r.result.commands if c.unit == units[name])
            spanning(axis, SPAN.command * max(largest))
            axis.grid()
        axes[0, 0].set_title("Commands, mean from row to row")
        axes[-1, 0].set_xlabel("time [s]")
        picture.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
    return picture


# --- the control strategy ---------------------------------------------------------------------------
_BOXES = {
    "goal": (0.2, 2.8, 1.6, 0.9, "set-point\nx, y, z"),
    "heading": (2.7, 4.2, 2.2, 0.9, "heading to\nthe goal, (42)"),
    "gate": (2.7, 2.8, 2.2, 0.9, "gate: opens once\nheading is reached"),
    "yaw": (6.4, 4.2, 1.9, 0.9, "heading control"),
    "plane": (6.4, 2.8, 1.9, 0.9, "x-y control"),
    "depth": (6.4, 1.4, 1.9, 0.9, "depth control"),
    "allocation": (9.3, 2.8, 1.9, 0.9, "thrust allocation\n(4), (5)"),
    "vehicle": (12.0, 2.8, 1.4, 0.9, "vehicle"),
}
# From the side of one box to that of another (right, left, above or below), words, and where they stand.
_ARROWS = (
    ("goal", "above", "heading", "left", "", 0.0),
    ("goal", "right", "gate", "left", "x, y", 2.25),
    ("goal", "below", "depth", "left", "z", 4.0),
    ("heading", "right", "yaw", "left", "desired psi", 5.5),
    ("heading", "below", "gate", "above", "", 0.0),
    ("gate", "right", "plane", "left", "", 0.0),
    ("yaw", "right", "allocation", "above", "yaw moment", 9.4),
    ("plane", "right", "allocation", "left", "force", 8.95),
    ("depth", "right", "allocation", "below", "heave force", 9.4),
    ("allocation", "right", "vehicle", "left", "", 0.0),
)
_LAW = (6.1, 1.1, 2.5, 4.3)


def strategy(number: str = "") -> Figure:
    """Block diagram of the schedule: first the heading, then x and y; depth all the time."""
    with look():
        picture, axes = figure(3.6)
        axis = axes[0, 0]
        axis.set_xlim(0, 13.6)
        axis.set_ylim(0, 5.6)
        axis.axis("off")
        axis.set_title(f"{number}Control strategy: heading first, then x and y; depth in parallel")
        _box(axis, *_LAW, "", edgecolor=FAINT, linestyle="--")
        for box in _BOXES.values():
            _box(axis, *box, edgecolor=INK)
        for arrow in _ARROWS:
            _arrow(axis, *arrow)
        low, law = 0.45, _LAW[0] + _LAW[2] / 2
        right, bottom = _side("vehicle", "below")
        _path(axis, [(right, bottom), (right, low), (law, low), (law, _LAW[1])])
        words = "measured pose and velocity, to all of the law and to the gate"
        axis.text((law + right) / 2, low - 0.08, words, ha="center", va="top", fontsize=8)
    return picture


def _box(axis: Any, x: float, y: float, width: float, height: float, words: str, **style: Any) -> None:
    round_off = "round,pad=0,rounding_size=0.1"
    axis.add_patch(FancyBboxPatch((x, y), width, height, boxstyle=round_off, facecolor="white", **style))
    axis.text(x + width / 2, y + height / 2, words, ha="center", va="center", fontsize=8.5)


def _side(name: str, side: str) -> tuple[float, float]:
    x, y, width, height, _ = _BOXES[name]
    places = {"left": (0, 0.5), "right": (1, 0.5), "above": (0.5, 1), "below": (0.5, 0)}
    across, up = places[side]
    return x + across * width, y + up * height


def _arrow(axis: Any, source: str, leaves: str, target: str, enters: str, words: str, middle: float) -> None:
    begin, end = _side(source, leaves), _side(target, enters)
    corner = (begin[0], end[1]) if leaves in ("above", "below") else (end[0], begin[1])
    _path(axis, list(dict.fromkeys([begin, corner, end])))
    height = begin[1] if begin[1] == corner[1] else end[1]
    axis.text(middle, height + 0.08, words, ha="center", va="bottom", fontsize=7.5)


def _path(axis: Any, points: Sequence[tuple[float, float]]) -> None:
    axis.plot(*zip(*points[:-1], strict=True), color=INK, linewidth=1)
    arrow = {"arrowstyle": "-|>", "color": INK, "shrinkA": 0, "shrinkB": 0, "linewidth": 1}
    axis.annotate("", points[-1], points[-2], arrowprops=arrow)
