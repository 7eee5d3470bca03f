"""Tables from what pytest-benchmark stored."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from .goals import GOALS, OURS, Goal

NOT_MEASURED = "–"


@dataclass(frozen=True)
class Timing:
    """One measurement; seconds of the fastest round, since all else on the machine only adds."""

    what: str
    who: str
    seconds: float
    apart: float | None
    limit: float | None
    size: float | None
    more: dict[str, Any]


_OWN = ("what", "who", "calls", "seconds", "apart", "limit", "size")


def read(path: Path) -> tuple[list[Timing], dict[str, Any]]:
    """Measurements, and the machine."""
    stored = json.loads(path.read_text(encoding="utf-8"))
    return [_timing(b) for b in stored["benchmarks"] if "what" in b["extra_info"]], stored["machine_info"]


def _timing(stored: dict[str, Any]) -> Timing:
    reported = stored["extra_info"]
    more = {k: v for k, v in reported.items() if k not in _OWN}
    if "seconds" not in reported and stored["options"]["timer"] == "process_time":
        more["clock"] = "CPU time"
    seconds = reported.get("seconds", stored["stats"]["min"] / reported.get("calls", 1))
    return Timing(
        reported["what"],
        reported["who"],
        seconds,
        reported.get("apart"),
        reported.get("limit"),
        reported.get("size"),
        more,
    )


def goals(by_processor: dict[str, list[str]]) -> str:
    """Every goal with what each processor reached."""
    lines = [
        f"| | what | beside | command | goal | {' | '.join(by_processor)} |",
        "| ---: | --- | --- | --- | ---: |" + " ---: |" * len(by_processor),
        *(
            f"| {k} | {_goal(goal)} | {' | '.join(values)} |"
            for k, (goal, values) in enumerate(
                zip(GOALS, zip(*by_processor.values(), strict=True), strict=True), start=1
            )
        ),
    ]
    return "\n".join(lines) + "\n"


def _goal(goal: Goal) -> str:
    wanted = f"≥ {goal.at_least:.3g} ×" if goal.peer else f"≤ {duration(goal.at_least)}"
    what = goal.what if goal.who == OURS else f"{goal.what}: {goal.who}"
    return f"{what} | {goal.peer or '–'} | {goal.commands} | {wanted}"


def measured(goal: Goal, timings: list[Timing]) -> str:
    """Seconds, or how many times as fast as the peer; bold where the goal is missed."""
    ours, peer = _of(goal.what, goal.who, timings), _of(goal.what, goal.peer, timings)
    if ours is None or (goal.peer and peer is None):
        return NOT_MEASURED
    if peer is None:
        value, met = duration(ours.seconds), ours.seconds <= goal.at_least
    else:
        value, met = f"{peer.seconds / ours.seconds:.3g} ×", ours.seconds * goal.at_least <= peer.seconds
    return value if met else f"**{value}**"


def _of(what: str, who: str, timings: list[Timing]) -> Timing | None:
    return next((t for t in timings if (t.what, t.who) == (what, who) and t.size is None), None)


def times(timings: list[Timing]) -> str:
    """What everybody needed, and how far the results are apart."""
    return "\n".join(_table(what, rows) for what, rows in _grouped(t for t in timings if t.size is None))


def _table(what: str, rows: list[Timing]) -> str:
    best = next((t.seconds for t in rows if t.who.startswith("undertow")), rows[0].seconds)
    lines = [
        f"**{what}**\n",
        "| who | time | times ours | apart (limit) | |",
        "| --- | ---: | ---: | ---: | --- |",
    ]
    for t in sorted(rows, key=lambda t: t.seconds):
        apart = "–" if t.apart is None else f"{t.apart:.1e}" + (f" ({t.limit:.0e})" if t.limit else "")
        more = ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in t.more.items())
        lines.append(f"| {t.who} | {duration(t.seconds)} | {t.seconds / best:.3g} | {apart} | {more} |")
    return "\n".join(lines) + "\n"


def growth(timings: list[Timing]) -> str:
    """How costs grow, with the exponent of the last doubling or so."""
    return "\n".join(_series(what, rows) for what, rows in _grouped(t for t in timings if t.size is not None))


def _series(what: str, rows: list[Timing]) -> str:
    whos = list(dict.fromkeys(t.who for t in rows))
    sizes = sorted({t.size for t in rows if t.size is not None})
    known = {(t.who, t.size): t.seconds for t in rows}
    lines = [f"**{what}**\n", "| | " + " | ".join(whos) + " |", "| ---: |" + " ---: |" * len(whos)]
    for size in sizes:
        cells = [duration(known[w, size]) if (w, size) in known else "–" for w in whos]
        lines.append(f"| {size:g} | " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _grouped(timings: Iterable[Timing]) -> Iterator[tuple[str, list[Timing]]]:
    rows = list(timings)
    order = list(dict.fromkeys(t.what for t in rows))
    rows.sort(key=lambda t: order.index(t.what))
    for what, group in groupby(rows, key=lambda t: t.what):
        yield what, list(group)


def duration(seconds: float) -> str:
    """A time with three digits and a unit that suits it."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def machine(info: dict[str, Any]) -> str:
    """The machine in one line."""
    cpu = info.get("cpu", {})
    brand = cpu.get("brand_raw", info.get("processor", "unknown processor"))
    wide = next(
        (f for f in ("avx512f", "avx2", "asimd") if f in cpu.get("flags", [])), "no wide vectors known"
    )
    return (
        f"{brand}, {cpu.get('count', '?')} cores, {wide}, {info.get('system')} {info.get('release')}, "
        f"Python {info.get('python_version')}"
    )
