"""Vehicles as systems of python-control: linear at a trim, and nonlinear."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence

import control as ct
import numpy as np

from undertow.errors import UndertowError
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .numeric import Numeric, in_direction
from .trim import Trim, find_trim

_log = logging.getLogger(__name__)


def linearize(vehicle: Vehicle, trim: Trim | Mapping[str, float], *, pade: int = 0) -> ct.StateSpace:
    """The vehicle near a steady motion, as a linear system with names.

    States are deviations from the trim: pose (m, rad, NED), velocity (m/s, rad/s, body), then states of the
    vehicle's effects. Inputs are deviations of the commands, outputs of the reported pose and velocity. In a
    turn x and y are left out: their slopes change with the heading.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    trim : Trim or mapping
        The steady motion, or what it holds (see `find_trim`).
    pade : int
        Order of the approximation of dead times between command and thrust and of reports; 0 leaves them out.

    Raises
    ------
    UndertowError
        If there is no such steady motion, or the trim is of another vehicle.
    """
    found = trim if isinstance(trim, Trim) else find_trim(vehicle, trim)
    numeric = Numeric(in_direction(vehicle, found.direction))
    if tuple(found.states) != numeric.states or tuple(found.commands) != numeric.commands:
        raise UndertowError(
            f"the trim is of another vehicle than '{vehicle.name}': find it again for this one"
        )
    return linear_with_delays(numeric, found, pade)


def linear_with_delays(numeric: Numeric, trim: Trim, pade: int) -> ct.StateSpace:
    """The linear system at a trim with Padé approximations of its dead times, of order zero without them."""
    system = linear_at(numeric, trim)
    late = {n: s for n, s in numeric.report_delays.items() if n in system.output_labels}
    if not numeric.dead_time and not late:
        return system
    if not pade:
        _log.warning(
            "%s of '%s'; the linear system is without it, --pade 3 (pade=3) has it approximately",
            ", ".join(_lateness(numeric.dead_time, late)),
            numeric.vehicle.name,
        )
        return system
    commanded = _late(system, numeric.dead_time, pade) if numeric.dead_time else system
    return _late_reports(commanded, late, pade) if late else commanded


def linear_at(numeric: Numeric, trim: Trim, p: Array | None = None) -> ct.StateSpace:
    """The linear system at a trim for values of the parameters, without dead time."""
    _, a, b, _ = numeric.slopes(trim.x, trim.u, p)
    c, d = numeric.report_slopes(trim.x, trim.u, p)
    gone = ("x", "y") if trim.turning else ()
    kept = [i for i, name in enumerate(numeric.states) if name not in gone]
    shown = [i for i, name in enumerate(numeric.outputs) if name not in gone]
    return ct.ss(
        a[np.ix_(kept, kept)] + 0.0,  # no -0.0
        b[kept],
        c[np.ix_(shown, kept)],
        d[shown],
        states=[numeric.states[i] for i in kept],
        inputs=list(numeric.commands),
        outputs=[numeric.outputs[i] for i in shown],
        name=_name(numeric.vehicle),
    )


def as_nlsys(vehicle: Vehicle, *, direction: Mapping[str, int] | None = None) -> ct.NonlinearIOSystem:
    """The vehicle as a nonlinear system that calls the compiled equations of motion.

    States, inputs and outputs are those of `linearize`, but the values themselves and not deviations. The
    parameter ``p`` of the system replaces the values of the vehicle's parameters. A dead time is left out.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    direction : mapping, optional
        1 or -1 by velocity: one set of parameters for both ways, so that the equations are smooth there.
    """
    numeric = Numeric(in_direction(vehicle, direction or {}))
    if numeric.dead_time:
        _log.warning(
            "commands of '%s' act %g s late; as_nlsys is without it", vehicle.name, numeric.dead_time
        )

    def rate(t: float, x: Array, u: Array, params: Mapping[str, Array]) -> Array:
        return numeric.rate(t, x, u, params.get("p"))

    def report(t: float, x: Array, u: Array, params: Mapping[str, Array]) -> Array:
        return numeric.report(t, x, u, params.get("p"))

    return ct.nlsys(
        rate,
        report,
        states=list(numeric.states),
        inputs=list(numeric.commands),
        outputs=list(numeric.outputs),
        name=_name(vehicle),
    )


def _name(vehicle: Vehicle) -> str:
    """The vehicle's name without the dot, which python-control puts between a system and its signals."""
    return vehicle.name.replace(".", "_")


def _late(system: ct.StateSpace, seconds: float, order: int) -> ct.StateSpace:
    """The system behind a Padé approximation of a dead time in each input."""
    delay = ct.ss(ct.tf(*ct.pade(seconds, order)))
    names = system.input_labels
    late = ct.append(*[delay] * len(names))
    states = [f"late_{name}_{k}" for name in names for k in range(order)]
    return named(system * late, (*states, *system.state_labels), names, system.output_labels, system.name)


def _lateness(commands: float, reports: Mapping[str, float]) -> list[str]:
    """Dead times in words."""
    acting = [f"commands act {commands:g} s late"] if commands else []
    return acting + [f"{name} is reported {late:g} s late" for name, late in reports.items()]


def _late_reports(system: ct.StateSpace, late: Mapping[str, float], order: int) -> ct.StateSpace:
    """The system before a Padé approximation of the age of each report."""
    names = system.output_labels
    through = [ct.ss(ct.tf(*ct.pade(late[n], order))) if n in late else ct.ss([], [], [], 1.0) for n in names]
    states = [f"late_{name}_{k}" for name in names if name in late for k in range(order)]
    whole = ct.append(*through) * system
    return named(whole, (*system.state_labels, *states), system.input_labels, names, system.name)


def named(
    system: ct.StateSpace, states: Sequence[str], inputs: Sequence[str], outputs: Sequence[str], name: str
) -> ct.StateSpace:
    """The same system with these names."""
    return ct.ss(
        system.A,
        system.B,
        system.C,
        system.D,
        states=list(states),
        inputs=list(inputs),
        outputs=list(outputs),
        name=name,
    )
