"""The whole loop, with what no condition knows, linearised at rest."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace

from undertow.control.gains import GainSet
from undertow.errors import UndertowError

from .problem import Problem
from .result import Report, WholeLoop

_PADE = 4
_ZERO = 1e-6


def with_whole_loop(report: Report, gains: GainSet) -> Report:
    """A report with the verdict on the whole loop, where effects are left out of the conditions."""
    return replace(report, whole=whole_loop(gains)) if report.left_out else report


def whole_loop(gains: GainSet) -> WholeLoop:
    """The linear loop of a law and everything in its vehicle at rest, dead time as a Padé approximation.

    Where the gains of x and y differ it is looked at for a vehicle that heads north and for one that heads
    east; all directions of motion that have parameters of their own count. Poles at zero, which belong to
    what nothing pushes, do not count as unstable.

    Returns
    -------
    WholeLoop
        Its fastest growing poles; without a verdict where the loop has no linear form at rest.
    """
    from undertow.control.linear.loop import close_loop
    from undertow.control.linear.trim import find_trim

    vehicle, found = gains.plant.vehicle, []
    try:
        for held, direction in _cases(gains):
            trim = find_trim(vehicle, held, direction=direction)
            poles = close_loop(vehicle, gains, trim, pade=_PADE).closed.poles()
            found.append((max(map(complex, poles), key=lambda p: (p.real, p.imag)), held, direction))
    except UndertowError as error:
        return WholeLoop(None, None, f"not judged: {error}")
    worst, held, direction = max(found, key=lambda case: case[0].real)
    return WholeLoop(worst.real <= _ZERO, worst, _where(held, direction))


def _cases(gains: GainSet) -> Iterator[tuple[Mapping[str, float], Mapping[str, int]]]:
    from undertow.control.linear.numeric import reversing

    vehicle = gains.plant.vehicle
    rest = dict.fromkeys(vehicle.velocity_names, 0.0)
    headings = (0.0, math.pi / 2) if Problem(gains).heading_counts else (0.0,)
    for heading in headings if "psi" in vehicle.pose_names else (None,):
        for way in (1, -1) if reversing(vehicle) else (1,):
            held = rest if heading is None else {**rest, "psi": heading}
            yield held, dict.fromkeys(reversing(vehicle), way)


def _where(held: Mapping[str, float], direction: Mapping[str, int]) -> str:
    heading = f"heading {math.degrees(held['psi']):.0f} deg" if "psi" in held else ""
    way = {1: "forward", -1: "backward"}.get(next(iter(direction.values()), 0), "")
    return ", ".join(filter(None, (heading, way)))
