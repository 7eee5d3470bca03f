"""Logs for a diagnosis: training and validation data, kept apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from undertow.errors import UndertowError
from undertow.identification.doctor.examine import refuse_impossible
from undertow.identification.estimation.data import channel_noise
from undertow.identification.logs.opening import check_fit
from undertow.identification.logs.pose_velocity import as_reported, velocities_from_pose
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

from .settings import DEFAULT, Settings


@dataclass(frozen=True)
class PieceSettings:
    """Where a log is cut into pieces, in shares of a piece's length but for the last."""

    longest_pause: float = 0.5  # length of a pause that counts, at most, where `piece_gap` is longer
    least_pause: float = 0.1  # and at least
    longest_gap: float = 0.1  # time that is left out after a piece, at most
    before: float = 0.25  # how far an edge lies before a sample, in steps


PIECES = PieceSettings()
Runs = Run | Sequence[Run]
"""One run or several."""


def repeats(
    vehicle: Vehicle, train: Sequence[Run], test: Sequence[Run], settings: Settings = DEFAULT
) -> list[tuple[str, str]]:
    """Validation runs that repeat the commands of a training run, with that run.

    An overfitted model does as well on them as the right one.
    """
    names = tuple(n for n in vehicle.command_names if n not in vehicle.inputs)
    pairs = ((kept, fitted) for kept in test for fitted in train)
    return [
        (kept.name, fitted.name)
        for kept, fitted in pairs
        if names and _same_commands(kept, fitted, names, settings)
    ]


def _same_commands(one: Run, other: Run, names: Sequence[str], settings: Settings) -> bool:
    """Whether two runs have the same commands, each counted from its own beginning."""
    first, second = one.t - one.t[0], other.t - other.t[0]
    common = first[first <= second[-1]]
    if common[-1] < settings.same_length * min(first[-1], second[-1]):
        return False
    kept_commands = np.nan_to_num(one.matrix(names)[: len(common)])
    place = np.searchsorted(second, common, side="right") - 1
    fitted_commands = np.nan_to_num(other.matrix(names)[place])
    # A constant command, as of the propeller in a zigzag, is the same in different manoeuvres.
    size = np.std(kept_commands, axis=0)
    changing = size > settings.changed_command * np.max(np.abs(kept_commands), axis=0)
    if not np.any(changing):
        return False
    difference = (kept_commands - fitted_commands)[:, changing] / size[changing]
    return float(np.sqrt(np.mean(difference**2))) < settings.same_commands


def normalised(vehicle: Vehicle, runs: Runs, validation: Runs) -> tuple[Vehicle, list[Run], list[Run]]:
    """A vehicle without priors from these logs, and runs as lists, from any accepted argument.

    Raises
    ------
    UndertowError
        If there is no run, or the time of one does not increase.
    """
    train, test = ([given] if isinstance(given, Run) else list(given) for given in (runs, validation))
    if not train:
        raise UndertowError("there is no training log: give at least one run (undertow.read_log)")
    for run in [*train, *test]:
        if (stays := np.flatnonzero(~(np.diff(run.t) > 0))).size:
            raise UndertowError(
                f"run {run.name!r}: time does not increase after {run.t[stays[0]]:g} s: sort the samples and "
                "drop those without a time of their own"
            )
    return as_reported(vehicle.without_priors_from(run.sha256 for run in train), train), train, test


def with_velocities(vehicle: Vehicle, runs: Sequence[Run]) -> list[Run]:
    """Runs with the velocities for which they have only a pose."""
    for run in runs:
        if held := [d for d in vehicle.degrees_of_freedom if d in run.held]:
            raise UndertowError(
                f"in run '{run.name}' a rig holds {', '.join(held)} of '{vehicle.name}': use undertow fit "
                "or diagnose, or sort the logs with undertow.identification.diagnose.experiments"
            )
    return [velocities_from_pose(run, vehicle.degrees_of_freedom) for run in runs]


def training_and_validation(
    vehicle: Vehicle,
    runs: Sequence[Run],
    validation: Sequence[Run],
    settings: Settings = DEFAULT,
    *,
    trust_log: bool = False,
) -> tuple[list[Run], list[Run]]:
    """Training and validation runs: as given, or pieces of `runs` if there are none for validation.

    Velocities that a run lacks are taken from its pose.
    """
    runs, validation = with_velocities(vehicle, runs), with_velocities(vehicle, validation)
    check_fit(runs, validation, vehicle)
    refuse_impossible(vehicle, [*runs, *validation], trust_log=trust_log)
    train, test = (list(runs), list(validation)) if validation else split_into_pieces(runs, settings)
    check_excitation(vehicle, train, settings)
    return train, test


def split_into_pieces(runs: Sequence[Run], settings: Settings = DEFAULT) -> tuple[list[Run], list[Run]]:
    """Cut every run into six pieces and set the second and the fifth aside.

    A run that is short compared with the longest is fitted whole: predictions over pieces mean nothing.
    """
    enough = settings.whole_below * max(float(run.t[-1] - run.t[0]) for run in runs)
    short = [run for run in runs if float(run.t[-1] - run.t[0]) < enough]
    runs = [run for run in runs if run not in short]
    for run in runs:
        if len(run.t) < settings.fewest_samples:
            raise UndertowError(
                f"run {run.name!r} has {len(run.t)} samples, too few to set segments of it aside for "
                f"validation (at least {settings.fewest_samples}): give longer logs, or a validation run "
                "with --validation"
            )
    pieces = [(i, piece) for run in runs for i, piece in enumerate(_pieces(run, settings))]
    train = [piece for i, piece in pieces if i not in settings.validation_pieces]
    return [*short, *train], [piece for i, piece in pieces if i in settings.validation_pieces]


def _pieces(run: Run, settings: Settings) -> list[Run]:
    count = settings.pieces
    # A long pause counts as a small part of a piece: one that lies in a pause would have no sample.
    steps = np.diff(run.t)
    length = float(np.sum(np.minimum(steps, settings.piece_gap))) / count
    longest = max(min(settings.piece_gap, PIECES.longest_pause * length), PIECES.least_pause * length)
    recorded = np.cumsum([0.0, *np.minimum(steps, longest)])
    # Edges lie between samples, so that no rounding of a time moves a sample into another piece.
    edges = np.interp(np.linspace(0.0, recorded[-1], count + 1), recorded, run.t)
    edges[1:-1] -= PIECES.before * run.step
    gap = min(settings.piece_gap, PIECES.longest_gap * length)
    return [
        replace(
            run.slice(a, b if i == count - 1 else b - gap),
            name=f"{run.name} [{a:.0f}-{b:.0f} s]",
            part_of=run.origin,
        )
        for i, (a, b) in enumerate(pairwise(edges))
    ]


def check_excitation(vehicle: Vehicle, runs: Sequence[Run], settings: Settings = DEFAULT) -> None:
    """Refuse logs in which no velocity of the vehicle exceeds its noise."""
    names = [n for n in vehicle.velocity_names if all(r.has(n) for r in runs)]
    noise = dict(zip(names, channel_noise(runs, names), strict=True))
    largest = {n: max(float(np.nanstd(r.channels[n])) for r in runs) for n in names}
    if names and all(largest[n] < settings.excitation_ratio * noise[n] or largest[n] == 0.0 for n in names):
        seen = ", ".join(f"{n} {v:.2g} (noise {noise[n]:.2g})" for n, v in largest.items())
        raise UndertowError(
            f"nothing moves in these logs: standard deviation of {seen}; "
            "log a manoeuvre in which the vehicle moves"
        )
