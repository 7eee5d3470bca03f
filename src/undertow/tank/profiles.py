"""Signals by which a hull is moved: pushes, steps, sines, the paper's, or a user's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.interpolate import PchipInterpolator

from undertow.errors import UndertowError
from undertow.typing import Array

from .settings import RULES

PROFILES = ("paper", "step", "sine", "push")
# Times, s, and forces, N, of the mini-AUV paper as its Figure 3 shows them; it ends at 30 s.
_PAPER = ((0.65, 0.32), (18.45, -0.48), (21.95, 0.22))
_PAPER_END, _PAPER_PEAK = 30.0, 0.48
_SAMPLES = 400  # of the table of a smooth signal


def duration(profile: str, scale: float) -> float:
    """How long a profile lasts, s; `scale` is the time in which the hull travels its length, s."""
    if profile == "push":
        return 2 * RULES.push * scale
    if profile == "paper":
        return _PAPER_END
    if profile == "sine":
        return RULES.periods * 2 * np.pi * RULES.sine * scale
    return RULES.travel * scale


def signal(profile: str, prescribed: bool, end: float, scale: float) -> tuple[Array, Array]:
    """Times, s, and values from -1 to 1 of a profile, at rest before it; in between it is linear.

    `scale`: time in which the hull travels its length, s.
    """
    ramp = (RULES.ramp if prescribed else RULES.force_ramp) * scale
    times = np.linspace(0.0, end, _SAMPLES + 1)
    if profile == "push":
        # The hull is at rest again at the end either way: then drag does not pass for added mass.
        return times, np.sin(np.pi * times / end) ** 2 if prescribed else np.sin(2 * np.pi * times / end)
    if profile == "sine":
        period = end / RULES.periods
        return times, np.sin(2 * np.pi * times / period) * _smooth(2 * times / period)
    if profile == "paper":
        return _levels([(t, f / _PAPER_PEAK) for t, f in _PAPER], ramp, end, prescribed)
    if prescribed:
        return _levels([(0.0, 0.5), (2 / 3 * end, 1.0)], ramp, end, prescribed)
    return _levels([(0.0, 1.0), (end / 3, 0.0), (2 * end / 3, -1.0)], ramp, end, prescribed)


def _smooth(share: Array) -> Array:
    """From 0 to 1 with no jump of the slope."""
    s = np.clip(share, 0.0, 1.0)
    return np.asarray(s * s * (3 - 2 * s))


def _levels(levels: list[tuple[float, float]], ramp: float, end: float, smooth: bool) -> tuple[Array, Array]:
    """A signal that goes from one level to the next; forces may have corners, speeds may not."""
    count = _SAMPLES if smooth else 2
    edges = [np.linspace(t, t + ramp, count) for t, _ in levels]
    times = np.unique(np.concatenate([[0.0], *edges, [end]]))
    values, before = np.zeros_like(times), 0.0
    for t, level in levels:
        share = (times - t) / ramp
        values += (level - before) * (_smooth(share) if smooth else np.clip(share, 0.0, 1.0))
        before = level
    kept = times <= end
    return times[kept], values[kept]


def read_signal(path: Path) -> tuple[Array, Array]:
    """A user's signal: a CSV file with time, s, and speed or force in SI units, with or without a head."""
    try:
        rows = np.genfromtxt(path, delimiter=",", comments="#", invalid_raise=True)
    except (OSError, ValueError) as error:
        raise UndertowError(
            f"profile {path}: neither {', '.join(PROFILES)} nor a CSV file that can be read: give one with "
            "two columns, time and speed or force"
        ) from error
    rows = np.atleast_2d(rows)
    rows = rows[1:] if np.isnan(rows[0]).all() else rows
    if rows.shape[1] != 2 or len(rows) < 2 or not np.isfinite(rows).all():
        raise UndertowError(
            f"profile {path}: needs two columns of numbers (time, value) and two rows at least"
        )
    times, values = rows.T
    if not (np.diff(times) > 0).all() or times[0] < 0 or not np.abs(values).max() > 0:
        raise UndertowError(f"profile {path}: times must increase from 0, and some value must differ from 0")
    return (times, values) if times[0] == 0 else (np.r_[0.0, times], np.r_[0.0, values])


def motion(times: Array, speeds: Array, at: Array) -> Array:
    """Place, speed and acceleration, shape (3, n), of a speed that is given at times, at other times."""
    # Monotone between the points: a spline would overshoot where a long even stretch begins.
    speed = PchipInterpolator(times, speeds)
    return np.array([speed.antiderivative()(at), speed(at), speed.derivative()(at)])
