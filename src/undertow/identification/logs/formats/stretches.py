"""The stretches of a log that are used: armed and moving, cut where the estimator was reset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from undertow.typing import Array, Flags

Stretch = tuple[float, float]


@dataclass(frozen=True)
class MotionSettings:
    """When a vehicle counts as moving by itself."""

    # Share of full output by which a motor leaves its rest: the dead band of a T200 with its speed controller
    # reaches to 0.07 at 16 V and 0.09 at 12 V, and pilots' sticks rest within half of that.
    off_rest: float = 0.04
    coast: float = 5.0  # s that are kept after the last motor stopped: drag without thrust is worth having
    shortest: float = 2.0  # s; a shorter stretch has nothing to tell
    reported: float = 0.1  # s; a shorter part that is left out is not worth a word


SETTINGS = MotionSettings()


def armed_stretches(events: Iterable[tuple[float, bool]], span: Stretch) -> list[Stretch]:
    """Parts of a span in which the vehicle is armed, by the times at which that changed.

    Before the first event it was what that event ended; without events it is taken to be armed.
    """
    ordered = sorted(events)
    if not ordered:
        return [span]
    states = [(span[0], not ordered[0][1]), *ordered, (span[1], False)]
    parts = [(a[0], b[0]) for a, b in pairwise(states) if a[1] and b[0] > a[0]]
    joined: list[Stretch] = []
    for first, last in parts:
        if joined and joined[-1][1] == first:
            first = joined.pop()[0]
        joined.append((first, last))
    return joined


def used_stretches(
    span: Stretch,
    armed: Sequence[Stretch],
    outputs: tuple[Array, Array] | None,
    resets: Iterable[float],
    held: Sequence[Stretch] = (),
) -> tuple[tuple[Stretch, ...], list[str]]:
    """The parts of a log to be used, cut where the estimator was reset, and what is said of the others.

    All times in s; `outputs` are times and commands of motors from -1 to 1; `held` is when the estimator held
    its place for want of aid.
    """
    moving = [part for stretch in armed for part in _moving(stretch, outputs)]
    notes = []
    if not armed:
        notes.append("the vehicle is never armed: all of the log is used")
    elif not moving:
        notes.append("armed, but no motor leaves its rest: all of the armed time is used")
    # No command is known before the first message on them.
    begin = float(outputs[0][0]) if outputs is not None and len(outputs[0]) else span[0]
    kept = long_enough((max(a, begin), b) for a, b in moving or armed or [span])
    inside = [r for r in resets if any(a < r < b for a, b in kept)]
    notes += [f"cut at {_times(inside)} s, where the estimator was reset"] if inside else []
    pieces = long_enough(cut_at(kept, [*inside, *(edge for stretch in held for edge in stretch)]))
    aided = [p for p in pieces if not _within(sum(p) / 2, held)]
    if len(aided) < len(pieces) and aided:
        notes.append("left out where the estimator held its position without an aid")
    pieces = aided or long_enough(cut_at(kept, inside))
    return tuple(pieces), [*notes, *_left_out(span, pieces, armed)]


def long_enough(stretches: Iterable[Stretch]) -> list[Stretch]:
    """Those that have something to tell."""
    return [s for s in stretches if s[1] - s[0] >= SETTINGS.shortest]


def _moving(stretch: Stretch, outputs: tuple[Array, Array] | None) -> list[Stretch]:
    if outputs is None:
        return [stretch]
    t, commands = outputs
    off = np.any(np.abs(commands) > SETTINGS.off_rest, axis=1) & (t >= stretch[0]) & (t <= stretch[1])
    if not off.any():
        return []
    return [(float(t[off][0]), min(float(t[off][-1]) + SETTINGS.coast, stretch[1]))]


def _within(t: float, stretches: Iterable[Stretch]) -> bool:
    return any(a <= t <= b for a, b in stretches)


def _left_out(span: Stretch, used: Sequence[Stretch], armed: Sequence[Stretch]) -> list[str]:
    """One line on the parts of a span that are not used."""
    edges = [span[0], *(edge for stretch in used for edge in stretch), span[1]]
    said = []
    for first, last in zip(edges[::2], edges[1::2], strict=True):
        switched = [edge for stretch in armed for edge in stretch if first < edge < last]
        for a, b in pairwise([first, *switched, last]):
            why = "motors at rest, or estimator without an aid" if _within((a + b) / 2, armed) else "disarmed"
            said += [f"{a:.1f} to {b:.1f} s ({why})"] if b - a >= SETTINGS.reported else []
    return [f"left out: {', '.join(said)}"] if said else []


def _times(moments: Sequence[float]) -> str:
    return ", ".join(f"{t:.1f}" for t in moments)


def runs_of(t: Array, flags: Flags) -> list[Stretch]:
    """From where to where flags of samples are set, s."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(int)))
    return [(float(t[a]), float(t[min(b, len(t) - 1)])) for a, b in edges.reshape(-1, 2)]


def cut_at(
    stretches: Iterable[tuple[float, float]], resets: Iterable[float]
) -> tuple[tuple[float, float], ...]:
    """Cut stretches where an estimator was reset; the sample of the reset begins a new one."""
    cuts = sorted(set(resets))
    pieces: list[tuple[float, float]] = []
    for first, last in stretches:
        inside = [c for c in cuts if first < c <= last]
        ends = [*(float(np.nextafter(c, first)) for c in inside), last]
        pieces += zip([first, *inside], ends, strict=True)
    return tuple(piece for piece in pieces if piece[1] > piece[0])
