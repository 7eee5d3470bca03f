"""The frequency at which what a model leaves swings most, for effects that have a frequency to find."""

from __future__ import annotations

import numpy as np

from undertow.typing import Array

from ..weak.data import WeakData

# A swing is looked for from so many periods in a run on: fewer are a trend.
_FEWEST_PERIODS = 3.0
# Frequencies per resolution cell of the longest run, and cells on either side that a peak is held against.
_FINE = 4
_BESIDE = 12
# Half width, in resolution cells, of where the frequency may lie: moving vehicles meet waves Doppler-shifted.
_SPREAD = 1.0


def beat(r: Array, data: WeakData) -> tuple[float, float] | None:
    """Least and greatest angular frequency around the sharpest line in a residual, rad/s.

    Parameters
    ----------
    r : (m,) array
        Whitened residual.
    data : WeakData
        Data that it belongs to.

    Returns
    -------
    (float, float) or None
        None where the runs are too short for three periods of anything.
    """
    cell = 2 * np.pi / max(float(s.t[-1] - s.t[0]) for s in data.segments)
    # A stretch between two gaps may hold a single test function.
    spacings = [float(np.median(np.diff(s.functions.centre))) for s in data.segments if s.functions.count > 1]
    if not spacings:
        return None
    spacing = max(spacings)
    grid = np.arange(_FEWEST_PERIODS * cell, 0.5 * np.pi / spacing, cell / _FINE)
    if len(grid) <= 2 * _BESIDE * _FINE:
        return None
    slow = np.arange(0.0, _FEWEST_PERIODS + 0.5) * cell
    power = _power(_turned(_without(r, data, slow), data), data, grid)
    best = float(grid[np.argmax(power / _beside(power))])
    return max(best - _SPREAD * cell, 0.5 * cell), best + _SPREAD * cell


def _without(r: Array, data: WeakData, slow: Array) -> Array:
    """The residual without slow swings in body axes: seen from the earth they beat with the turning."""
    table, kept, first = r.reshape(-1, len(data.rows)), [], 0
    for s in data.segments:
        part = table[first : first + s.functions.count]
        first += s.functions.count
        phase = np.outer(s.functions.centre, slow)
        trend = np.hstack([np.cos(phase), np.sin(phase[:, 1:])])
        kept.append(part - trend @ np.linalg.lstsq(trend, part, rcond=None)[0])
    return np.vstack(kept).ravel()


def _turned(r: Array, data: WeakData) -> Array:
    """The residual with its horizontal part seen from the earth: waves do not turn with the vehicle."""
    half = len(data.names) // 2
    places = [data.names.index(n) for n in ("u", "v", "psi") if n in data.names]
    if len(places) < 3:
        return r
    ahead, across, heading = places[0] - half, places[1] - half, places[2]
    psi = np.concatenate([np.interp(s.functions.centre, s.t, s.measured[:, heading]) for s in data.segments])
    table = r.copy().reshape(len(psi), -1)
    x, y = (table[:, data.rows.index(i)].copy() for i in (ahead, across))
    table[:, data.rows.index(ahead)] = np.cos(psi) * x - np.sin(psi) * y
    table[:, data.rows.index(across)] = np.sin(psi) * x + np.cos(psi) * y
    return np.asarray(table.ravel())


def _power(r: Array, data: WeakData, grid: Array) -> Array:
    """Power at each frequency, summed over segments and equations of motion."""
    table, power, first = r.reshape(-1, len(data.rows)), np.zeros(len(grid)), 0
    forces = [k for k, row in enumerate(data.rows) if row < len(data.names) // 2]
    for s in data.segments:
        part = table[first : first + s.functions.count, forces]
        first += s.functions.count
        power += np.sum(np.abs(np.exp(-1j * np.outer(grid, s.functions.centre)) @ part) ** 2, axis=1)
    return power


def _beside(power: Array) -> Array:
    """Median power around each frequency."""
    wide = _BESIDE * _FINE
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(power, wide, mode="reflect"), 2 * wide + 1)
    return np.asarray(np.median(windows, axis=1))
