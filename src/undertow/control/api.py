"""What `import undertow` gives of control."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import control as ct

from undertow.model.vehicle import Vehicle

from .conditions.problem import Uncertainty
from .conditions.result import Report
from .conditions.whole import certify
from .gains import GainSet, load_gains
from .linear import systems


def check_gains(vehicle: Vehicle, gains: str | Path | GainSet, *, confidence: float = 0.95) -> Report:
    """Check the conditions on the gains of a control law, without simulating.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    gains : path or GainSet
        A gain file, or the name of a bundled one (paper-pd, paper-pid, paper-smc).
    confidence : float
        Probability of the interval of each parameter.

    Returns
    -------
    Report
        `ok` says whether the loop is certified, `rows` holds every condition.

    Raises
    ------
    UndertowError
        If the gains cannot be read or do not fit the vehicle.

    Examples
    --------
    >>> import undertow as ut
    >>> ut.check_gains(ut.load_vehicle("mini-auv"), "paper-pid").conditions_hold
    False
    """
    chosen = gains if isinstance(gains, GainSet) else load_gains(gains, vehicle)
    return certify(chosen, Uncertainty(vehicle, confidence))


def linearize(vehicle: Vehicle, at: Mapping[str, float] | None = None, *, pade: int = 0) -> ct.StateSpace:
    """The linear system of python-control at a steady motion.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    at : mapping, optional
        Velocities, attitude, depth or commands that are held, SI; hovering by default.
    pade : int
        Order of the approximation of dead times; 0 leaves them out.

    Returns
    -------
    control.StateSpace
        States are pose, velocities and those of the effects; inputs are the commands, outputs pose and
        velocities.

    Raises
    ------
    UndertowError
        If there is no such steady motion.

    Examples
    --------
    >>> import undertow as ut
    >>> vehicle = ut.load_vehicle("mini-auv")
    >>> system = ut.linearize(vehicle, at={"u": 0.5})
    >>> system.input_labels == list(vehicle.command_names)
    True
    """
    return systems.linearize(vehicle, {"u": 0.0, "v": 0.0, "w": 0.0} if at is None else at, pade=pade)
