"""Runs as files that read back as what they were."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import polars as pl

from undertow.files import together, write_whole

from .mapping import Column, Held, LogMapping, mapping_text, turned_name
from .run import Run


def save_log(run: Run, out: Path) -> Path | None:
    """Write a run as CSV with the channel names and SI units of undertow; the path of its mapping file.

    Of a channel that does not report in every row only the reports are written, and nothing that was derived
    from other channels: whoever reads the file derives it again. Noise of sensors and disturbance that were
    stated go into a mapping file beside it, called the same but for its ending.
    """
    measured = {name: run.reports(name) for name in run.channels if name not in run.derived}
    table = pl.DataFrame({"t": run.t, **measured}).fill_nan(None)
    stated, beside = _stated(run), out.with_suffix(".toml")
    with together():
        write_whole(out, table.write_csv())
        if stated is not None:
            write_whole(beside, mapping_text(stated))
    return beside if stated is not None else None


def _stated(run: Run) -> LogMapping | None:
    """The mapping file that states noise, disturbance and rig of a run; None where none is stated."""
    given = run.mapping or LogMapping()
    if run.mapping is None:
        named = set(run.sigma)
    else:  # that of slow channels is estimated where it is not stated
        told = (c.channel for c in given.columns.values() if c.noise is not None)
        named = {turned_name(channel, given.frames.position) for channel in told}
    noise = {name: sigma for name, sigma in run.sigma.items() if name in named and run.has(name)}
    if not (noise or given.disturbance or run.held):
        return None
    columns = {name: Column(channel=name, noise=sigma, optional=True) for name, sigma in noise.items()}
    held = cast("Held", run.held)
    return LogMapping(columns=columns, disturbance=given.disturbance, held=held)
