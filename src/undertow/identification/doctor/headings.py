"""The convention of a heading beside a position without velocities: a vehicle mostly moves ahead."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.identification.findings import Finding
from undertow.identification.logs.mapping import LogMapping, as_toml
from undertow.identification.logs.run import Run

from .dynamics import rederived
from .mistakes import reading_mistakes


@dataclass(frozen=True)
class HeadingSettings:
    """Thresholds for the course over ground beside the heading."""

    # Mean cosine of the angle between course and heading, weighted by the squared speed, from which a vehicle
    # moves ahead: boats, torpedoes and gliders, in currents up to a third of their speed.
    ahead: float = 0.9
    # The same below which it does not; half of it is 60 degrees.
    off_course: float = 0.5
    # Length of the mean of the heading's direction from which it is too steady to be informative.
    steady: float = 0.9


SETTINGS = HeadingSettings()
_MIRRORED = ("frame", "swapped_position", "flipped_axis")


def heading_findings(mapping: LogMapping, runs: Sequence[Run]) -> Iterator[Finding]:
    """A heading or position whose convention makes a vehicle move ahead, if it does not as the log is read.

    Only where the velocities were derived from the pose: measured ones show more.
    """
    if not all({"u", "v"} <= run.derived and run.has("psi") for run in runs):
        return
    ahead = _ahead(runs)
    if ahead > SETTINGS.ahead:
        return
    known = [m for m in reading_mistakes(mapping, runs) if m.id in _MIRRORED and m.count == 1]
    psi = np.concatenate([run.channels["psi"] for run in runs])
    steadiness = float(np.abs(np.nanmean(np.exp(1j * psi))))  # one where it is constant
    turns = steadiness < SETTINGS.steady and ahead < SETTINGS.off_course
    found = [m for m in known if turns and _ahead([rederived(r, m.undo) for r in runs]) > SETTINGS.ahead]
    if not found:
        yield Finding(
            id="heading_unchecked",
            severity="note",
            text="whether the heading counts clockwise from north or anticlockwise from east is judged by "
            "the fit of the model alone: no velocity along the body was measured, and by its position the "
            f"vehicle does not move where it heads (mean cosine between course and heading {ahead:.2f})",
            evidence={"ahead": ahead},
        )
        return
    first, *others = found
    yield Finding(
        id=first.id,
        severity="warning",
        text=f"perhaps {first.clause}: by the change of its position the vehicle moves where it heads only "
        f"then (mean cosine between course and heading {ahead:.2f} as read)",
        evidence={"ahead": ahead},
        mapping=as_toml(first.edits(mapping)),
        alternatives=[m.clause for m in others],
    )


def _ahead(runs: Sequence[Run]) -> float:
    """Mean cosine of the angle between course and heading, weighted by the squared speed."""
    u, v = (np.concatenate([run.channels[n] for run in runs]) for n in ("u", "v"))
    speed = np.hypot(u, v)
    return float(np.nansum(speed * u) / max(np.nansum(speed**2), 1e-30))
