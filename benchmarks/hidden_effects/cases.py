"""One case: a vehicle, its hidden effects, the logs of its runs, and what a user would believe beforehand."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from . import actuation, hull, not_listed, sensors, statics, water  # noqa: F401  (they fill the registry)
from .belief import hydrodynamic_values, prior_vehicle
from .drawing import Vehicle
from .manoeuvres import MANOEUVRES
from .plant import RATE
from .registry import EFFECTS, NOTHING_HIDDEN, Draw, Values
from .simulation import RUNS, Conduct, simulate, stream
from .vehicles import NOMINAL, real_vehicle
from .world import World, plain_world

from . import hardships  # noqa: F401  isort: skip  (last, so that the order of all others is as it was)


@dataclass(frozen=True)
class Case:
    """Logs with a hidden effect.

    Attributes
    ----------
    runs : run name -> column -> (n,) values; columns are t, the twelve channels and the thruster commands
    vehicle : the prior model, ready to be written as an undertow vehicle file
    truth : class, effects, the values drawn for them, and the vehicle's true parameters
    """

    runs: dict[str, dict[str, np.ndarray]]
    vehicle: dict[str, Any]
    truth: dict[str, Any]


def make_case(
    vehicle: str,
    effects: tuple[str, ...],
    seed: int,
    *,
    strength: float = 1.0,
    noise: float = 1.0,
    duration: float = 100.0,
    closed_loop: bool = False,
    runs: tuple[str, ...] = RUNS,
) -> Case:
    """Simulate a vehicle with hidden effects.

    True values, guesses, commands, noise and the size of each effect have their own random stream: with the
    same seed another effect, strength or set of runs leaves all the rest as it was.

    Parameters
    ----------
    vehicle : str
        "mini-auv", "rov" or "usv".
    effects : tuple of str
        Names from `EFFECTS`; empty for a case in which nothing is hidden.
    seed : int
        Not negative.
    strength : float
        Multiplies the drawn sizes; 0 takes the effects away.
    noise : float
        Multiplies all noise.
    duration : float
        Seconds, sampled at 20 Hz.
    closed_loop : bool
        Hold heading and depth by feedback of the noisy readings.
    runs : tuple of str
        Which of "steps", "cruise", "multisine", "holdout".

    Raises
    ------
    ValueError
        For an unknown vehicle, effect or run, an effect that the vehicle cannot have, or a strength with
        which the vehicle runs away.
    """
    conduct = Conduct(noise, duration, closed_loop, runs)
    _refuse_nonsense(vehicle, effects, conduct)
    real = real_vehicle(vehicle, stream(seed, "truth"))
    world, values = hidden_world(real, effects, seed, strength)
    truth = {"vehicle": vehicle, **_verdict(effects), "values": values, "left_out": sorted(world.left_out)}
    truth |= {"seed": seed, "strength": strength, **asdict(conduct), "parameters": _true_parameters(world)}
    return Case(simulate(world, seed, conduct), prior_vehicle(world, stream(seed, "guess")), truth)


def hidden_world(
    real: Vehicle, effects: Iterable[str], seed: int, strength: float
) -> tuple[World, dict[str, Values]]:
    """The world with its effects, and the values that were drawn for each of them.

    They act in the order in which they are declared, whatever the order given: between command and thrust
    first what the drive does to the command, then what the propeller makes of it.
    """
    world, values = plain_world(real), {}
    for name in sorted(effects, key=list(EFFECTS).index):
        drawn = EFFECTS[name].apply(world, Draw(stream(seed, "effect " + name), strength))
        values[name] = {parameter: float(value) for parameter, value in drawn.items()}
    return world, values


def _verdict(effects: tuple[str, ...]) -> dict[str, Any]:
    """Class and catalogue ids: null, library, alien (any that no catalogue lists) or double."""
    hidden = [EFFECTS[name] for name in effects if EFFECTS[name].kind not in NOTHING_HIDDEN]
    ids = [effect.catalogue or effect.name for effect in hidden]
    if any(effect.kind == "alien" for effect in hidden):
        return {"class": "alien", "effects": ids}
    return {"class": ("null", "library", "double")[min(len(ids), 2)], "effects": ids}


def _true_parameters(world: World) -> dict[str, float]:
    """True values of the parameters that the prior model may hold, by name (SNAME signs)."""
    tables = hydrodynamic_values(world).values()
    return {name: float(value) for table in tables for name, value in table.items()}


def _refuse_nonsense(vehicle: str, effects: tuple[str, ...], conduct: Conduct) -> None:
    """Raise a one-line ValueError for anything that cannot be simulated."""
    _known("vehicle", [vehicle], NOMINAL)
    _known("effect", effects, EFFECTS)
    _known("run", conduct.runs, MANOEUVRES)
    for name in effects:
        able = EFFECTS[name].vehicles
        if vehicle not in able:
            raise ValueError(f"{vehicle} cannot have the effect {name}: choose one of {', '.join(able)}")
    if not conduct.runs or conduct.duration < 1.0 / RATE:
        raise ValueError(f"a case needs a run and a sample: got {conduct.runs} of {conduct.duration} s")


def _known(what: str, names: Iterable[str], table: dict[str, Any]) -> None:
    for name in names:
        if name not in table:
            raise ValueError(f"unknown {what} {name!r}: choose from {', '.join(table)}")
