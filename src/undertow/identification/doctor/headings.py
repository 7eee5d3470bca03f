"""The convention of a heading beside a position without velocities: a vehicle mostly moves ahead."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from undertow.identification.findings import Finding
from undertow.identification.logs.mapping import LogMapping, as_toml
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

from .dynamics import rederived
from .mistakes import Mistake, heading_off_by, reading_mistakes


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
    # Mean resultant length of the course seen from the heading, weighted by the squared speed, from which the
    # angle between them is constant: 0.94 and 0.82 with a compass that nobody had adjusted, 0.2 and
    # less where the heading counts the other way round.
    resultant_length: float = 0.8


SETTINGS = HeadingSettings()
_MIRRORED = ("frame", "swapped_position", "flipped_axis")


def heading_findings(vehicle: Vehicle, mapping: LogMapping, runs: Sequence[Run]) -> Iterator[Finding]:
    """A heading or position whose convention makes a vehicle move ahead, if it does not as the log is read.

    Only where the velocities were derived from the pose: measured ones show more. A vehicle that its commands
    can push sideways may move so all the time.
    """
    if not _is_derived(runs):
        return
    course = _course(runs)
    if course.real > SETTINGS.resultant_length:
        return
    known = [m for m in reading_mistakes(mapping, runs) if m.id in _MIRRORED and m.count == 1]
    turns = _turns(runs) and course.real < SETTINGS.off_course
    found = [m for m in known if turns and _ahead([rederived(r, m.undo) for r in runs]) > SETTINGS.ahead]
    offset = None if found else heading_off(vehicle, mapping, runs)
    if offset is not None:
        yield _offset_finding(offset, course, mapping)
        return
    if not found:
        yield Finding(
            id="heading_unchecked",
            severity="note",
            text="whether the heading counts clockwise from north or anticlockwise from east is judged by "
            "the fit of the model alone: no velocity along the body was measured, and by its position the "
            "vehicle does not move where it heads (mean cosine between course and heading "
            f"{course.real:.2f})",
            evidence={"ahead": course.real},
        )
        return
    first, *others = found
    yield Finding(
        id=first.id,
        severity="warning",
        text=f"perhaps {first.clause}: by the change of its position the vehicle moves where it heads only "
        f"then (mean cosine between course and heading {course.real:.2f} as read)",
        evidence={"ahead": course.real},
        mapping=as_toml(first.edits(mapping)),
        alternatives=[m.clause for m in others],
    )


def heading_off(vehicle: Vehicle, mapping: LogMapping, runs: Sequence[Run]) -> Mistake | None:
    """A heading off by the angle at which the course always lies beside it; None if it does not, or may so.

    A vehicle that its commands can push sideways may move so, and one on a steady heading may drift.
    """
    if not _is_derived(runs) or _pushed_aside(vehicle) or not _turns(runs):
        return None
    course = _course(runs)
    if course.real > SETTINGS.off_course or abs(course) < SETTINGS.resultant_length:
        return None
    return heading_off_by(float(np.angle(course)), mapping)


def _is_derived(runs: Sequence[Run]) -> bool:
    """Whether the velocities follow from the pose, with a heading."""
    return all({"u", "v"} <= run.derived and run.has("psi") for run in runs)


def _turns(runs: Sequence[Run]) -> bool:
    """Whether the heading changes enough to be informative."""
    psi = np.concatenate([run.channels["psi"] for run in runs])
    return float(np.abs(np.nanmean(np.exp(1j * psi)))) < SETTINGS.steady


def _offset_finding(mistake: Mistake, course: complex, mapping: LogMapping) -> Finding:
    """A heading that counts from elsewhere than north, of a vehicle that moves ahead or astern."""
    astern = "a vehicle that moves astern: then commands that drive it are negative"
    return Finding(
        id=mistake.id,
        severity="warning",
        text=f"perhaps {mistake.clause}: by the change of its position the vehicle always moves at the same "
        f"angle to where it heads (mean cosine of course and heading {course.real:.2f} as read, "
        f"{abs(course):.2f} with that angle), and no command pushes it sideways",
        evidence={"ahead": course.real, "resultant_length": abs(course)},
        mapping=as_toml(mistake.edits(mapping)),
        alternatives=[astern] if course.real < -SETTINGS.off_course else [],
    )


def _pushed_aside(vehicle: Vehicle) -> bool:
    """Whether commands push a vehicle in every direction and turn it, each without the others."""
    gains = [t.thrust_per_command.value * np.array(t.wrench) for t in vehicle.thrusters]
    return bool(gains) and int(np.linalg.matrix_rank(np.array(gains)[:, [0, 1, 5]])) == 3


def _ahead(runs: Sequence[Run]) -> float:
    """Mean cosine of the angle between course and heading, weighted by the squared speed."""
    return _course(runs).real


def _course(runs: Sequence[Run]) -> complex:
    """Mean direction of the course, seen from the heading, weighted by the squared speed."""
    velocity = np.concatenate([run.channels["u"] + 1j * run.channels["v"] for run in runs])
    speed = np.abs(velocity)
    return complex(np.nansum(speed * velocity) / max(np.nansum(speed**2), 1e-30))
