"""A model beside logs: where it fails, in which regime, and how much of that is noise."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from undertow import __version__
from undertow.codegen.functions import Functions
from undertow.identification.logs import Run
from undertow.identification.logs.run import UNITS
from undertow.model.symbols import FORCE_UNITS
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from ..doctor import refuse_impossible
from ..weak.data import WeakData, prepare
from .forces import Forces, residual_forces
from .profiles import CORRELATED, Profile, profiles
from .regimes import Regime, regimes
from .result import (
    BudgetShare,
    Cell,
    ChannelResult,
    ComparedRun,
    ComparisonResult,
    DofResult,
    finite,
)
from .windows import Prediction, Predictor, cut, predict, prediction_error

HORIZON = 5.0
# Test functions that a field of the error map needs.
_FEWEST = 20
# Standard deviations by which the mean square of a field must exceed that of noise to be called a failure.
_CLEAR = 4.0


@dataclass(frozen=True)
class Comparison:
    """A comparison with what its pictures are drawn from.

    Attributes
    ----------
    result : ComparisonResult
        Numbers and words.
    vehicle : Vehicle
        The model.
    ahead, free_run : Prediction
        Predictions over the horizon, and over whole stretches without gaps.
    forces : Forces
        Force that the model lacks, along the logs.
    profiles : list of Profile
        The same against every variable.
    """

    result: ComparisonResult
    vehicle: Vehicle
    ahead: Prediction
    free_run: Prediction
    forces: Forces
    profiles: list[Profile]

    def to_json(self) -> str:
        """The result as JSON."""
        return self.result.model_dump_json(indent=1) + "\n"


def compare(
    vehicle: Vehicle,
    runs: Sequence[Run],
    *,
    horizon: float = HORIZON,
    compiled: bool | None = None,
    progress: Progress = lambda done, words: None,
    trust_log: bool = False,
) -> Comparison:
    """Compare a model, as it is, with logs.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    runs : sequence of Run
        Logs with the velocities and commands of the vehicle.
    horizon : float
        How far ahead is predicted from each measured start, s; shorter where the logs are.
    compiled : bool, optional
        As for `Simulator`.
    progress : callable
        Told what share is done, and what is being done.
    trust_log : bool
        Take logs as they are, also those that `undertow.identification.doctor.refuse_impossible` refuses.

    Raises
    ------
    UndertowError
        If a channel is missing, a log cannot be, or no stretch without gaps is long enough.
    """
    began = time.perf_counter()
    refuse_impossible(vehicle, runs, trust_log=trust_log)
    functions = Functions(vehicle)
    progress(0.0, "residual force")
    data = prepare(runs, vehicle)
    forces = residual_forces(functions, runs, data)
    progress(0.4, "simulating")
    predictor = Predictor(functions, compiled=compiled)
    horizon = _possible(horizon, data)
    ahead = predict(predictor, cut(runs, vehicle, horizon))
    free_run = predict(predictor, cut(runs, vehicle, None))
    progress(0.9, "error map")
    pose = tuple(n for n in vehicle.pose_names if all(r.has(n) for r in runs))
    cells = _cells(forces, vehicle, data.sigma)
    worst = _worst(cells)
    result = ComparisonResult(
        undertow=__version__,
        vehicle=vehicle.name,
        degrees_of_freedom=list(vehicle.degrees_of_freedom),
        runs=[_compared(r) for r in runs],
        horizon=horizon,
        headline=headline(worst),
        prediction_error=finite(prediction_error(ahead)),
        windows=len(ahead.windows),
        diverged=free_run.diverged,
        channels=_channels(ahead, free_run),
        dofs=_dofs(forces, vehicle),
        cells=cells,
        worst=worst,
        budget=_budget(forces, vehicle),
        seconds=time.perf_counter() - began,
    )
    return Comparison(result, vehicle, ahead, free_run, forces, profiles(forces, vehicle, pose))


def _possible(horizon: float, data: WeakData) -> float:
    """The horizon, or half of the longest stretch where no stretch holds two horizons."""
    longest = max(float(s.t[-1] - s.t[0]) for s in data.segments)
    return min(horizon, longest / 2)


def _compared(run: Run) -> ComparedRun:
    return ComparedRun(
        name=run.name,
        source=run.source,
        sha256=run.sha256,
        samples=len(run.t),
        duration=float(run.t[-1] - run.t[0]),
        notes=list(run.notes),
    )


# --- channels ---------------------------------------------------------------------------------
def _channels(ahead: Prediction, free_run: Prediction) -> list[ChannelResult]:
    noise = dict(zip(ahead.names, ahead.windows.sigma, strict=True))
    fits = free_run.fit
    return [
        ChannelResult(
            channel=name,
            unit=UNITS[name],
            noise=float(noise[name]),
            ahead_rms=finite(rms),
            ahead_normalised=finite(ahead.normalised[name]) if noise[name] > 0 else None,
            ahead_relative=finite(ahead.relative.get(name)),
            free_run_rms=finite(free_run.rms[name]),
            free_run_fit=finite(fits.get(name)),
        )
        for name, rms in ahead.rms.items()
    ]


# --- degrees of freedom -----------------------------------------------------------------------
def _dofs(forces: Forces, vehicle: Vehicle) -> list[DofResult]:
    return [_dof(forces, vehicle, i) for i in range(len(vehicle.dof_indices))]


def _dof(forces: Forces, vehicle: Vehicle, i: int) -> DofResult:
    missing, noise = _rms(forces.missing[:, i]), _rms(forces.noise[:, i])
    test = whiteness(forces.whitened[:, i], forces.segment)
    inputs = zip(vehicle.command_names, forces.commands.T, strict=True)
    return DofResult(
        degree_of_freedom=vehicle.degrees_of_freedom[i],
        unit=FORCE_UNITS[vehicle.dof_indices[i]],
        residual_rms=missing,
        noise_rms=noise,
        explained_by_noise=_share(missing, noise),
        normalised=_ratio(missing, noise),
        autocorrelation=test.autocorrelation.tolist(),
        ljung_box=test.statistic,
        p_value=test.p_value,
        inputs={name: correlation(forces.missing[:, i], u) for name, u in inputs},
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _share(missing: float, noise: float) -> float:
    return min(1.0, (noise / missing) ** 2) if missing > 0 else 1.0


def _ratio(missing: float, noise: float) -> float | None:
    return finite(missing / noise) if noise > 0 else None


# --- error map --------------------------------------------------------------------------------
def _cells(forces: Forces, vehicle: Vehicle, sigma: Array) -> list[Cell]:
    found = regimes(forces, vehicle, sigma)
    return [_cell(forces, vehicle, i, r) for i in range(len(vehicle.dof_indices)) for r in found]


def _cell(forces: Forces, vehicle: Vehicle, i: int, regime: Regime) -> Cell:
    inside = regime.inside[:, i]
    cell = Cell(
        degree_of_freedom=vehicle.degrees_of_freedom[i],
        group=regime.group,
        regime=regime.name,
        phrase=regime.phrase,
        samples=int(inside.sum()),
    )
    if cell.samples < _FEWEST:
        return cell
    missing, noise = _rms(forces.missing[inside, i]), _rms(forces.noise[inside, i])
    numbers = {
        "residual_rms": missing,
        "noise_rms": noise,
        "explained_by_noise": _share(missing, noise),
        "normalised": _ratio(missing, noise),
    }
    return cell.model_copy(update=numbers)


def _worst(cells: Sequence[Cell]) -> Cell | None:
    return max(
        (c for c in cells if c.normalised is not None), key=lambda c: c.normalised or 0.0, default=None
    )


def headline(worst: Cell | None) -> str:
    """One sentence: where the model fails most, or that it does not."""
    if worst is None or worst.normalised is None or worst.explained_by_noise is None:
        return "too few samples to say where the model fails"
    unit = "N" if worst.degree_of_freedom in ("surge", "sway", "heave") else "N m"
    percent = 100 * worst.explained_by_noise
    told = "under 1" if percent < 1 else f"{percent:.0f}"
    share = f"residual {worst.residual_rms:.3g} {unit}, noise explains {told} %"
    place = f"in {worst.degree_of_freedom} {worst.phrase}"
    if worst.normalised**2 < 1.0 + _CLEAR * np.sqrt(2 * CORRELATED / worst.samples):
        return f"nothing stands out from the noise; the most is {place}: {share}"
    return f"fails most {place}: {share}"


# --- force budget -----------------------------------------------------------------------------
def _budget(forces: Forces, vehicle: Vehicle) -> list[BudgetShare]:
    rows = []
    for i, dof in enumerate(vehicle.degrees_of_freedom):
        sizes = {k: _rms(w[:, i]) for k, w in forces.wrenches.items()}
        sizes["unexplained"] = _rms(forces.missing[:, i])
        total = sum(sizes.values()) or 1.0
        parts = {k: size for k, size in sizes.items() if size > 0}
        rows += [
            BudgetShare(degree_of_freedom=dof, effect=k, rms=size, share=size / total)
            for k, size in parts.items()
        ]
    return rows


# --- whether what is left is noise ----------------------------------------------------------------
LAGS = 20


@dataclass(frozen=True)
class Whiteness:
    """Autocorrelation of a series and the test of Ljung and Box (1978) on it.

    Attributes
    ----------
    autocorrelation : (lags,) array
        At lags 1, 2 ...
    statistic : float
        Q = n (n + 2) sum of autocorrelation^2 / (n - lag).
    p_value : float
        Chance of a Q at least as large if the series is white.
    """

    autocorrelation: Array
    statistic: float
    p_value: float


def whiteness(r: Array, segment: NDArray[np.intp], lags: int = LAGS) -> Whiteness:
    """Test a series for whiteness; products never reach across a gap.

    Parameters
    ----------
    r : (K,) array
        Series.
    segment : (K,) array of int
        Stretch without gaps that each entry belongs to.
    lags : int
        Lags that are looked at, at most a quarter of the series.
    """
    count = len(r)
    lags = min(lags, count // 4)
    centred = r - r.mean()
    power = float(np.sum(centred**2))
    if lags < 1 or power == 0.0:
        return Whiteness(np.zeros(0), 0.0, 1.0)
    rho = np.array([_product(centred, segment, k) for k in range(1, lags + 1)]) / power
    q = float(count * (count + 2) * np.sum(rho**2 / (count - np.arange(1, lags + 1))))
    return Whiteness(rho, q, float(chdtrc(lags, q)))


def _product(r: Array, segment: NDArray[np.intp], lag: int) -> float:
    return float(np.sum((r[lag:] * r[:-lag])[segment[lag:] == segment[:-lag]]))


def correlation(a: Array, b: Array) -> float:
    """Correlation coefficient of two series; zero where one is constant."""
    x, y = a - a.mean(), b - b.mean()
    power = float(np.sqrt(np.sum(x**2) * np.sum(y**2)))
    return float(np.sum(x * y)) / power if power > 0 else 0.0
