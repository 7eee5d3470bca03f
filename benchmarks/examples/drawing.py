"""What the pictures of several pages share."""

from __future__ import annotations

from collections.abc import Container

from undertow.identification.report.pictures import RunTraces, Trace


def part(run: RunTraces, start: float, stop: float, channels: Container[str]) -> RunTraces:
    """Some channels of a run between two times, s."""
    return RunTraces(
        run.run, tuple(_cut(t, start, stop) for t in run.traces if t.channel in channels), run.caption
    )


def _cut(trace: Trace, start: float, stop: float) -> Trace:
    inside = (trace.t >= start) & (trace.t <= stop)
    after = None if trace.after is None else trace.after[inside]
    cut = trace.t[inside], trace.measured[inside], trace.before[inside]
    return Trace(trace.channel, trace.unit, *cut, after)
