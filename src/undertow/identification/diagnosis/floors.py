"""Two floors: sensor noise, and the disturbance of the motion that no sensor's noise explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline

from undertow.errors import listed
from undertow.identification.doctor.sampling import was_filtered
from undertow.identification.estimation.data import WeakData
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.test_functions import DEGREE
from undertow.identification.logs.opening import stated_noise
from undertow.identification.logs.reading import stated_disturbance
from undertow.identification.logs.run import UNITS
from undertow.model.symbols import FORCE, FORCE_UNITS
from undertow.typing import Array

from .associations import Clock
from .force_rows import ForceRow, ForceRows
from .result import ChannelNoise, DisturbanceLevel, Floors, Predictability
from .settings import DEFAULT


@dataclass(frozen=True)
class FloorSettings:
    """Numbers of the estimate of a disturbance from its autocorrelation."""

    most_lags: int = 240  # test functions up to which it is estimated
    share_of_log: float = 0.25  # of the longest segment, beyond which there are too few pairs
    shortest: float = 0.2  # correlation times tried, from this many distances of test functions
    # Relative uncertainty of the variance of sensor noise.
    noise_uncertainty: float = DEFAULT.noise_uncertainty
    quadrature: int = 40  # samples of a test function between two knots
    steps: int = 60  # up to as many as there are lags, evenly on a logarithmic scale


SETTINGS = FloorSettings()


def noise_floors(fit: Fitted, data: WeakData) -> Floors:
    """Noise of every measured channel and disturbance in every force equation of a fit.

    The disturbance is first-order noise whose autocorrelation is that of the residual force minus the known
    one of sensor noise.
    """
    vehicle, rows = fit.model.functions.vehicle, ForceRows(fit, data)
    stated = [stated_disturbance(run.mapping) for run in data.runs if run.mapping is not None]
    disturbances = []
    for i, place in enumerate(vehicle.dof_indices):
        rms, seconds = disturbance_of(rows.row(i), Clock.of(data).step)
        expected = [s[FORCE[place]] for s in stated if FORCE[place] in s]
        disturbances.append(
            DisturbanceLevel(
                degree_of_freedom=vehicle.degrees_of_freedom[i],
                unit=FORCE_UNITS[place],
                rms=rms,
                correlation_time=seconds,
                stated=max(expected) if expected else None,
            )
        )
    return Floors(sensors=_channel_noise(data), disturbances=disturbances)


def _channel_noise(data: WeakData) -> list[ChannelNoise]:
    measured = [n for n in data.names if all(r.has(n) for r in data.runs)]
    cut_offs = was_filtered(data.runs, measured)
    return [
        ChannelNoise(
            channel=n,
            unit=UNITS[n],
            sigma=float(sigma),
            stated=any(n in stated_noise(r) and n not in r.derived for r in data.runs),
            cut_off=cut_offs.get(n),
        )
        for n, sigma in zip(data.names, data.sigma, strict=True)
        if n in measured
    ]


def disturbance_of(row: ForceRow, step: float) -> tuple[float, float | None]:
    """Rms, N, and correlation time, s, of what is left in a force beyond noise; `step` is between rows, s."""
    if row.is_noise:
        return 0.0, None
    found, certainty = _autocovariance(row)
    times = np.geomspace(SETTINGS.shortest, max(len(found), 2), SETTINGS.steps)
    model = np.array([_test_function_autocovariance(len(found), time) for time in times])
    square = np.maximum((model * certainty) @ found / np.sum(certainty * model**2, axis=1), 0.0)
    misfit = np.sum(certainty * (found - square[:, None] * model) ** 2, axis=1)
    best = int(np.argmin(misfit))
    return float(np.sqrt(square[best])), float(times[best]) * step


def _autocovariance(row: ForceRow) -> tuple[Array, Array]:
    """That of the force beyond the sensors' noise, N^2, by lag in rows, and the inverse of its variance."""
    longest = max(len(p.r) for p in row.parts)
    lags = int(np.clip(SETTINGS.share_of_log * longest, 1, SETTINGS.most_lags))
    total, noise, pairs = np.zeros((3, lags))
    for part, sensors in zip(row.parts, row.sensor_noise, strict=True):
        for lag in range(min(lags, len(part.r))):
            count = len(part.r) - lag
            total[lag] += part.r[:count] @ part.r[lag:]
            noise[lag] += np.sum(sensors.covariance.diagonal(lag))
            pairs[lag] += count
    total, noise = (a / np.maximum(pairs, 1.0) / row.weight**2 for a in (total, noise))
    variance = total[0] ** 2 / np.maximum(pairs, 1.0) + (SETTINGS.noise_uncertainty * noise) ** 2
    return total - noise, 1.0 / np.maximum(variance, 1e-300)


def _test_function_autocovariance(lags: int, time: float) -> Array:
    """Autocovariance of averages under test functions, of first-order noise of unit variance.

    `time` is its correlation time in distances of test functions.
    """
    knots = np.arange(2 * DEGREE + 3) - (DEGREE + 1.0)  # the product of two splines, shifted: a spline again
    places = np.linspace(knots[0], knots[-1], SETTINGS.quadrature * (2 * DEGREE + 2) + 1)
    weight = BSpline.basis_element(knots)(places)
    apart = np.abs(np.arange(lags)[:, None] + places)
    return np.asarray(np.exp(-apart / time) @ (weight / np.sum(weight)))


def predictable_in_words(
    left: float,
    found: Sequence[Predictability],
    at_limit: Sequence[str] = (),
    helps: Sequence[str] = (),
    with_help: float = 1.0,
    *,
    correlates: bool = False,
) -> str:
    """How much of a residual can be predicted, as a sentence.

    Parameters
    ----------
    left : float
        The residual, as a share of the motion.
    found : sequence of Predictability
        How much of it depends on logged signals other than position and time.
    at_limit : sequence of str
        Parameters that would have gone beyond what is physical; what they stood for is in the rest.
    helps : sequence of str
        Effects that lower the residual without being named, if any, also by position or time.
    with_help : float
        The residual with those.
    correlates : bool
        Whether the residual force correlates with something, which may be position or time.
    """
    shares = [f"{p.at_most:.0%} in {p.degree_of_freedom}" for p in found if p.significant]
    rest = [
        f"{p.disturbance_rms:.2g} {p.unit} rms in {p.degree_of_freedom}" for p in found if p.disturbance_rms
    ]
    signals = "velocities, attitude and commands" if helps else "the logged signals"
    # Two errors that are compared need the digits in which they differ.
    sizes = [f"{100 * e:.{int(bool(helps) and e < 0.1)}f}%" for e in (left, with_help)]
    head = f"an error of {sizes[0]} remains"
    if helps:
        head += f" ({sizes[1]} with {listed(helps)}, not established as the cause)"
    head += (
        f"; of that at most {listed(shares)} can be predicted from {signals}"
        if shares
        else f"; {signals} predict no more of it than chance"
    )
    if not rest:
        return f"{head}; the rest is sensor noise"
    why = f", or what drove {listed(at_limit)} to a physical limit" if at_limit else ""
    others = [*helps, *(["what the residual correlates with"] if correlates else [])]
    other = f", or {listed(others)}" if others else ""
    return f"{head}; the rest is disturbance{other}{why}: {listed(rest)}"
