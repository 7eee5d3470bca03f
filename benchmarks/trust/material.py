"""What the diagnosis is given: files as a user would have them, read by the program's own readers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.signal import butter, sosfiltfilt

from benchmarks.hidden_effects import Case, make_case, write_case
from benchmarks.hidden_effects.files import FILES
from benchmarks.hidden_effects.plant import RATE
from benchmarks.hidden_effects.simulation import CHANNELS, stream
from benchmarks.results.reading import read
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

from .cases import Planned

#: Seconds of a run.
LENGTH = {"60s": 60.0, "20min": 1200.0}
USUAL_LENGTH = 100.0
MASS_SPREAD = 0.05
#: Corner and order of what records were filtered with, forward and backward, before they were published.
CORNER, ORDER = 1.0, 2
# A drawn size with which the vehicle runs away is taken smaller.
_MILDER = (1.0, 0.7, 0.5, 0.35, 0.25)
_VELOCITY = ("u", "v", "w", "p", "q", "r")


def simulated(case: Planned) -> Case:
    """Logs, prior model and truth; the truth tells the strength with which the vehicle did not run away."""
    for share in _MILDER:
        try:
            made = _made(case, share * case.strength)
        except ValueError as error:
            failed = error
        else:
            return varied(made, case)
    raise failed


def without(case: Planned) -> Planned:
    """The same vehicle, commands and noise with nothing hidden."""
    return replace(case, hidden=())


def _made(case: Planned, strength: float) -> Case:
    return make_case(
        case.vehicle,
        case.hidden,
        case.seed,
        strength=strength,
        noise=case.noise,
        duration=LENGTH.get(case.variant, USUAL_LENGTH),
        closed_loop=case.closed_loop,
    )


def varied(made: Case, case: Planned) -> Case:
    """The case as its variant has it: without velocities, filtered, or with a mass that is a guess."""
    if case.variant == "filtered":
        return replace(made, runs={name: _filtered(run) for name, run in made.runs.items()})
    if case.variant == "pose-only":
        runs = {name: {c: v for c, v in run.items() if c not in _VELOCITY} for name, run in made.runs.items()}
        return replace(made, runs=runs)
    if case.variant == "mass-5":
        return replace(made, vehicle=_mass_guessed(made.vehicle, case.seed))
    return made


def _filtered(run: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The readings of all sensors through a low-pass filter without delay; commands as they were."""
    low = butter(ORDER, CORNER, fs=RATE, output="sos")
    return {name: sosfiltfilt(low, v) if name in CHANNELS else v for name, v in run.items()}


def _mass_guessed(vehicle: dict[str, Any], seed: int) -> dict[str, Any]:
    """The vehicle file with a mass that is a guess, wrong by up to 5%."""
    body = vehicle["effects"]["rigid_body"]
    value = float(f"{body['m'] * stream(seed, 'mass').uniform(1 - MASS_SPREAD, 1 + MASS_SPREAD):.4g}")
    sigma = float(f"{MASS_SPREAD * value:.3g}")
    guess = {"value": value, "estimate": True, "sigma": sigma, "source": "guess, good to 5%"}
    return vehicle | {"effects": vehicle["effects"] | {"rigid_body": body | {"m": guess}}}


def written_to_memory(made: Case) -> tuple[Vehicle, list[Run], list[Run]]:
    """The same without files that stay."""
    with TemporaryDirectory() as folder:
        return written_and_read(made, Path(folder))


def written_and_read(made: Case, folder: Path) -> tuple[Vehicle, list[Run], list[Run]]:
    """The vehicle, the runs to fit to and the run to judge by, through files in `folder`."""
    write_case(made, folder)
    vehicle = load_vehicle(str(folder / "vehicle.toml"))
    logs = [folder / f"{name}.csv" for name in FILES.values()]
    runs = read(logs, vehicle)
    return vehicle, runs[:-1], runs[-1:]
