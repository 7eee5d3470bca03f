"""The errors of models over all of long logs that no model was fitted to, a piece at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.files import json_ready
from undertow.identification.estimation.adaptation import adapted
from undertow.identification.estimation.predictor import Predictor, predict_each
from undertow.identification.estimation.windows import Prediction, cut
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Progress

from .choosing import Chosen
from .result import LongLogs, ModelOnTheRest, Rest
from .thinning import without


@dataclass(frozen=True)
class CheckSettings:
    """Numbers of the check."""

    rows: int = 20_000  # of a piece; what is in memory at a time
    horizon: float = 5.0  # s that are predicted from each measured start, as by `undertow compare`


CHECK = CheckSettings()


@dataclass
class _Tally:
    """Squares of the errors of one model, by piece and velocity."""

    predictor: Predictor
    squares: list[Array] = field(default_factory=list)
    counts: list[Array] = field(default_factory=list)
    diverged: int = 0

    def add(self, vehicle: Vehicle, prediction: Prediction) -> None:
        """Take a piece up."""
        residual = _velocities(prediction, prediction.residual)
        whole = np.isfinite(prediction.predicted).all(axis=2) | ~prediction.windows.inside
        good = whole.all(axis=1)
        self.diverged += int(np.sum(~good))
        self.squares.append(np.nansum(residual[good] ** 2, axis=(0, 1)))
        self.counts.append(np.isfinite(residual[good]).sum(axis=(0, 1)))


def checked(
    chosen: Chosen,
    models: Mapping[str, Vehicle],
    *,
    horizon: float = CHECK.horizon,
    progress: Progress = lambda done, words: None,
) -> LongLogs:
    """The result of a choice, with the errors of models, by name, over all that was not chosen.

    What belongs to each run (``per_run = true``) is estimated from the first third of every piece.
    """
    tallies = {name: _Tally(Predictor(Functions(vehicle))) for name, vehicle in models.items()}
    motion: list[tuple[Array, Array]] = []
    seconds, samples, windows = 0.0, 0, 0
    pieces = list(without(chosen.spools, chosen.used, CHECK.rows))
    for done, piece in enumerate(pieces):
        progress(done / len(pieces), "checking the rest")
        try:
            run = velocities_from_pose(
                chosen.spools[piece.log].run(piece.first, piece.stop), chosen.vehicle.degrees_of_freedom
            )
            predictions = _predicted(run, models, tallies, horizon)
        except UndertowError:  # a piece too short or too full of gaps to be simulated
            continue
        for name, prediction in predictions.items():
            tallies[name].add(models[name], prediction)
        first = next(iter(predictions.values()))
        measured = _velocities(first, first.windows.measured)
        motion.append((np.nansum(measured**2, axis=(0, 1)), np.isfinite(measured).sum(axis=(0, 1))))
        seconds, samples = seconds + float(run.t[-1] - run.t[0]), samples + len(run.t)
        windows += len(first.windows)
    if not motion:
        return chosen.result
    size = _rms(*(np.sum(column, axis=0) for column in zip(*motion, strict=True)))
    names = chosen.vehicle.velocity_names
    rest = Rest(
        seconds=seconds,
        samples=samples,
        horizon=horizon,
        windows=windows,
        models=[_errors(name, tally, size, names) for name, tally in tallies.items()],
    )
    return chosen.result.model_copy(update={"rest": rest})


def _predicted(
    run: Run, models: Mapping[str, Vehicle], tallies: Mapping[str, _Tally], horizon: float
) -> dict[str, Prediction]:
    """Windows of a piece predicted by every model."""
    own = {name: adapted(vehicle, run) for name, vehicle in models.items()}
    begin = max(float(rest.t[0]) for _, rest in own.values())
    windows = cut([run.slice(begin)], next(iter(models.values())), horizon)
    return {
        name: predict_each([vehicle], windows, tallies[name].predictor) for name, (vehicle, _) in own.items()
    }


def _velocities(prediction: Prediction, values: Array) -> Array:
    """Values of the velocities, without the samples that the windows begin with."""
    return values[:, 1:, len(prediction.names) // 2 :]


def _errors(name: str, tally: _Tally, motion: Array, names: tuple[str, ...]) -> ModelOnTheRest:
    whole = _rms(np.sum(tally.squares, axis=0), np.sum(tally.counts, axis=0)) / motion
    pieces = [
        _mean(_rms(square, count) / motion)
        for square, count in zip(tally.squares, tally.counts, strict=True)
        if np.any(count)
    ]
    return ModelOnTheRest(
        model=name,
        error=json_ready(_mean(whole)),
        channels={n: json_ready(float(e)) for n, e in zip(names, whole, strict=True)},
        diverged=tally.diverged,
        lowest=json_ready(min(pieces, default=np.nan)),
        highest=json_ready(max(pieces, default=np.nan)),
    )


def _rms(squares: Array, counts: Array) -> Array:
    """Root mean squares; NaN of nothing."""
    return np.sqrt(np.divide(squares, counts, out=np.full(len(squares), np.nan), where=counts > 0))


def _mean(shares: Array) -> float:
    """Geometric mean of the errors of the velocities that there are."""
    known = shares[np.isfinite(shares)]
    return float(np.exp(np.mean(np.log(np.maximum(known, 1e-12))))) if len(known) else float("nan")
