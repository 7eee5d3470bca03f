"""Curves of linear systems as plain arrays: frequency responses, steps and root loci."""

from __future__ import annotations

from dataclasses import dataclass

import control as ct
import numpy as np
from numpy.typing import NDArray

from undertow.typing import Array

from .analysis import modes

_POINTS = 600
_DECADES = 1.5
_CONSTANTS = 5.0
_LONGEST = 600.0


@dataclass(frozen=True)
class Line:
    """One curve.

    Attributes
    ----------
    name : str
        What it is.
    x, y : ndarray, shape (n,)
        rad/s and complex values, or s and values.
    """

    name: str
    x: Array
    y: NDArray[np.complex128]


def frequencies(systems: list[ct.StateSpace]) -> Array:
    """Frequencies around the poles of systems, rad/s, shape (n,)."""
    sizes = [abs(p) for s in systems for p in s.poles() if abs(p) > 1e-4]
    low, high = min(sizes, default=0.1), max(sizes, default=10.0)
    return np.geomspace(low * 10**-_DECADES, high * 10**_DECADES, _POINTS)


def response(name: str, system: ct.StateSpace, omega: Array) -> Line:
    """The frequency response of a system with one input and one output."""
    return Line(name, omega, np.asarray(system(1j * omega)).ravel())


def duration(systems: list[ct.StateSpace]) -> float:
    """How long a step is worth looking at: some of the slowest time constants, s."""
    reals = [abs(m.pole.real) for s in systems for m in modes(s) if abs(m.pole.real) > 1e-6]
    return float(min(_CONSTANTS / min(reals, default=1.0), _LONGEST))


def step(name: str, system: ct.StateSpace, seconds: float) -> Line:
    """The answer of a system with one input and one output to a step of one."""
    t, y = ct.step_response(system, np.linspace(0.0, seconds, _POINTS), squeeze=True)
    return Line(name, np.asarray(t), np.asarray(y).ravel())


def locus(system: ct.StateSpace) -> tuple[Array, NDArray[np.complex128]]:
    """Poles of a loop closed with a gain times the system: gains (n,), and poles (n, order)."""
    gains = np.concatenate([[0.0], np.geomspace(1e-4, 1e4, 2 * _POINTS)])
    found = ct.root_locus_map(system, gains=gains)
    return np.asarray(found.gains), np.asarray(found.loci)
