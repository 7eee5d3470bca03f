"""Deviation of a compass: what has to be added to its heading, by that heading."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from undertow.typing import Array

from .run import Run, unwrapped

Coefficients = tuple[float, float, float]
"""A, B and C, rad: constant, and the semicircular deviation of hard iron, A + B sin psi + C cos psi."""


def corrected(
    channels: Mapping[str, Array], coefficients: Coefficients, *, velocities: bool
) -> dict[str, Array]:
    """Channels with the deviation added to the heading.

    With `velocities`, u and v were turned into body axes by the heading of the compass, and are turned on.
    """
    if "psi" not in channels:
        return dict(channels)
    (a, b, c), psi = coefficients, channels["psi"]
    more = a + b * np.sin(psi) + c * np.cos(psi)  # Bowditch
    found = {**channels, "psi": psi + more}
    if velocities:
        zero = np.zeros_like(more)
        u, v = channels.get("u", zero), channels.get("v", zero)
        turned = {"u": u * np.cos(more) + v * np.sin(more), "v": v * np.cos(more) - u * np.sin(more)}
        found |= {n: turned[n] for n in turned if n in channels}
    return found


def without_deviation(run: Run, coefficients: Coefficients, *, velocities: bool) -> Run:
    """A run with the deviation of its compass added to the heading."""
    channels = corrected(run.channels, coefficients, velocities=velocities)
    given = corrected(run.wrapped, coefficients, velocities=False)
    channels |= {"psi": unwrapped(channels["psi"])} if "psi" in run.wrapped else {}
    return replace(run, channels=channels, wrapped=given)
