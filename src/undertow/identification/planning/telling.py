"""From what a search found to what a plan says."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from undertow.model.parameter import Parameter, printed
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .flight import Flight
from .information import Knowledge
from .limits import extremes
from .result import Channel, Command, Known
from .setting import Ground

# A standard error above this share of the value is nothing to build on.
_BADLY = 0.3
_SMALL = 0.3


def command_unit(vehicle: Vehicle, name: str) -> str:
    """Unit of a command: N (N m) where one unit of it is one of thrust, else "command"."""
    if name in vehicle.force_channels:
        return "N" if name[-1] in "XYZ" else "N m"
    thruster = next(t for t in vehicle.thrusters if t.name == name)
    return "N" if thruster.thrust_per_command.value == 1.0 else "command"


def commands_of(ground: Ground, flight: Flight) -> list[Command]:
    """Every command with its limit and what the manoeuvre makes of it."""
    limits = ground.commands
    return [
        Command(
            name=name,
            unit=command_unit(ground.vehicle, name),
            limit=float(limits.value[i]),
            limit_from=limits.source[i],
            trim=float(ground.trim.commands[i]),
            lowest=float(flight.u[:, i].min()),
            highest=float(flight.u[:, i].max()),
        )
        for i, name in enumerate(ground.vehicle.command_names)
    ]


def channels_of(ground: Ground) -> list[Channel]:
    """Noise that was counted with."""
    n = ground.noise
    return [
        Channel(name=name, sigma=float(s) if np.isfinite(s) else None, source=source)
        for name, s, source in zip(n.names, n.sigma, n.source, strict=True)
    ]


def extremes_of(ground: Ground, flight: Flight) -> dict[str, float]:
    """Largest motions by any of the models, SI."""
    found = [extremes(y, ground.space.names) for y in flight.y]
    return {what: max(one[what] for one in found) for what in found[0]}


def finite(limits: Mapping[str, float]) -> dict[str, float | None]:
    """Limits with None where there is none."""
    return {name: value if np.isfinite(value) else None for name, value in limits.items()}


def table_of(known: Knowledge, stated: Vehicle, after: Array, hopeless: list[list[str]]) -> list[Known]:
    """Every free parameter with its standard errors before and after."""
    now, then = known.errors(known.now), known.errors(after)
    lost = {name for group in hopeless for name in group}
    return [
        _known(known.vehicle, stated.signs, name, now[i], then[i], name in lost)
        for i, name in enumerate(known.free)
    ]


def parameter_of(vehicle: Vehicle, name: str) -> Parameter:
    """The declaration of a parameter, which may have a value for each direction."""
    return vehicle.declaration(name)


def _known(vehicle: Vehicle, signs: str, name: str, now: float, then: float, lost: bool) -> Known:
    parameter, value = parameter_of(vehicle, name), vehicle.value_of(name).value
    # A prior that is all there is does not become knowledge of the manoeuvre.
    silent = lost and not then < _SMALL * now
    verdict = "not determined" if silent else "badly known" if not then < _BADLY * abs(value) else ""
    return Known(
        name=name,
        unit="" if parameter.unit == "1" else parameter.unit,
        about=parameter.about,
        value=printed(parameter, value, signs),
        error_now=float(now) if np.isfinite(now) else None,
        error_after=float(then) if np.isfinite(then) else None,
        verdict=verdict,  # type: ignore[arg-type]
    )


def safety_remarks(ground: Ground, flight: Flight, spread: float | None) -> list[str]:
    """What to mind before the manoeuvre is flown."""
    lines = [
        f"the actuators cannot balance {value:.3g} {'N' if dof == 'heave' else 'N m'} in {dof} at rest: "
        "the vehicle does not keep its depth and attitude"
        for dof, value in ground.trim.left.items()
    ]
    rise = _rise(ground, flight)
    if rise > ground.depth:
        lines.append(f"the vehicle rises up to {rise:.2g} m above where it starts: begin deeper than that")
    depth = extremes_of(ground, flight).get("depth", 0.0)
    if spread is not None and depth + spread > ground.request.motion.depth:
        lines.append(
            f"flown open loop, the depth may be {spread:.2g} m off the prediction by the end, going by what "
            "is known now: hold it by hand or with a controller, and log the commands"
        )
    return lines


def _rise(ground: Ground, flight: Flight) -> float:
    if "z" not in ground.space.names:
        return 0.0
    column = ground.space.names.index("z")
    return max(float(np.max(y[0, column] - y[:, column])) for y in flight.y)
