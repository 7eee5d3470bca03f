"""Clock and samples of a log: irregular, missing, out of order, or slower than the log itself."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from undertow.typing import Array

from ..logs import Mapping, Run
from .findings import Finding
from .mending import Edit, as_toml, column_edit

_JITTER = 0.05
_LONG = 5.0  # steps of this many usual ones are gaps: nothing is integrated across them
_MISSING = 0.02
_HELD = 1.8  # rows per new value from which a sensor counts as slower than its log
_REGULAR = 0.35
DROP = (Edit("time", "disorder", "drop"),)


def sampling(runs: Sequence[Run], channels: Sequence[str], mapping: Mapping) -> list[Finding]:
    """Everything about the clock of runs.

    Parameters
    ----------
    runs : sequence of Run
        Logs.
    channels : sequence of str
        Measured channels that matter; commands may be held as they please.
    mapping : Mapping
        How the logs were read.
    """
    found = [f for run in runs for f in _of_run(run, mapping)]
    slow = [f for name in channels if (f := _held(runs, name, mapping)) is not None]
    return [*found, *slow, *(f for run in runs if (f := _absent(run, channels)) is not None)]


def _of_run(run: Run, mapping: Mapping) -> Iterator[Finding]:
    step = np.diff(run.t)
    usual = float(np.median(step))
    yield from _disorder(run, mapping)
    yield from _lost_rows(run, step, usual)
    jitter = float(np.std(step[step < 1.5 * usual]) / usual)
    if jitter > _JITTER:
        yield Finding(
            id="jitter",
            severity="note",
            text=f"{run.name}: sampling is irregular: steps of {usual:.4g} s vary by {jitter:.0%} "
            "(times are taken as they are)",
            evidence={"step": usual, "jitter": jitter},
        )


def _disorder(run: Run, mapping: Mapping) -> Iterator[Finding]:
    if run.dropped:
        known = mapping.time.disorder == "drop"
        yield Finding(
            id="disorder",
            severity="note" if known else "mistake",
            text=f"{run.name}: {run.dropped} of {run.dropped + len(run.t)} rows are not later than a row "
            "before (a repeated or backward time stamp); they were left out",
            evidence={"rows": float(run.dropped)},
            mapping="" if known else as_toml(DROP),
        )


def _lost_rows(run: Run, step: Array, usual: float) -> Iterator[Finding]:
    gaps, few = step[step > _LONG * usual], step[(step > 1.5 * usual) & (step <= _LONG * usual)]
    lost = float(np.sum(np.round(step / usual)[step > 1.5 * usual] - 1.0))
    share = lost / (lost + len(run.t))
    if not len(gaps) and share < _MISSING:
        return
    longest = (
        f", the longest of {gaps.max():.3g} s at t = {run.t[int(np.argmax(step))]:.5g} s" if len(gaps) else ""
    )
    yield Finding(
        id="gaps",
        severity="warning" if share > 5 * _MISSING else "note",
        text=f"{run.name}: {share:.1%} of the rows are missing at a usual step of {usual:.4g} s "
        f"({len(few)} short spells, {len(gaps)} gaps{longest}); nothing is interpolated",
        evidence={"share": share, "gaps": float(len(gaps)), "longest": float(step.max())},
    )


def _absent(run: Run, channels: Sequence[str]) -> Finding | None:
    """Cells without a value, in the worst channel."""
    shares = {n: float(np.mean(np.isnan(run.channels[n]))) for n in channels if run.has(n)}
    worst = max(shares, key=lambda n: shares[n], default=None)
    if worst is None or shares[worst] < _MISSING:
        return None
    several = [n for n in shares if shares[n] > _MISSING]
    return Finding(
        id="missing_samples",
        severity="warning" if shares[worst] > 10 * _MISSING else "note",
        text=f"{run.name}: {worst} has no value in {shares[worst]:.1%} of the rows"
        + (
            f" (missing samples also in {', '.join(n for n in several if n != worst)})"
            if len(several) > 1
            else ""
        ),
        evidence={n: shares[n] for n in several},
    )


# --- held values ------------------------------------------------------------------------------
def _held(runs: Sequence[Run], name: str, mapping: Mapping) -> Finding | None:
    """A channel that repeats its last value until the sensor reports again."""
    periods = [p for run in runs if run.has(name) and name not in run.derived and (p := _period(run, name))]
    if len(periods) < len(runs):
        return None
    rows, seconds = (float(np.median([p[i] for p in periods])) for i in (0, 1))
    edit = column_edit(mapping, name)
    edit = column_edit(mapping, name, fresh=edit.key)
    return Finding(
        id="held_values",
        severity="warning",
        text=f"{name} has a new value only every {rows:.1f} rows ({seconds:.3g} s) and repeats the last one "
        f"in between: most rows are up to {seconds:.2g} s late",
        evidence={"rows": rows, "seconds": seconds},
        mapping=as_toml([edit]),
    )


def _period(run: Run, name: str) -> tuple[float, float] | None:
    """Usual number of rows, and seconds, between changes; None where every row is new or nothing changes."""
    there = np.flatnonzero(np.isfinite(run.channels[name]))
    y, t = run.channels[name][there], run.t[there]
    at = np.flatnonzero(np.diff(y) != 0.0)
    if len(at) < 10:
        return None
    # A coarse reading at rest repeats itself, too, but not at regular intervals.
    between = np.diff(at)
    usual = float(np.median(between))
    regular = float(np.mean(np.abs(between - usual) <= np.maximum(1.0, 0.2 * usual))) > 1 - _REGULAR
    # Where the sensor moves by many of its steps from row to row, repeats are no coarse readings.
    coarse = np.median(np.abs(y[at + 1] - y[at])) < 2 * np.min(np.abs(y[at + 1] - y[at]))
    if usual < _HELD or not regular or coarse:
        return None
    return usual, float(np.median(np.diff(t[at])))
