"""The control part of `import undertow`; the commands call the same functions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from undertow.errors import UndertowError, of_stated_kinds
from undertow.model.vehicle import Vehicle
from undertow.observer.design import load_observer
from undertow.typing import Progress

from .conditions.check import Uncertain
from .conditions.full_loop import certify
from .conditions.problem import SEARCH, Uncertainty
from .conditions.result import Report
from .gains import GainSet, load_gains

if TYPE_CHECKING:
    import control as ct


@of_stated_kinds
def check_gains(
    vehicle: Vehicle,
    gains: str | Path | GainSet,
    *,
    confidence: float = SEARCH.confidence,
    covariance: tuple[Sequence[str], Any] = ((), ()),
    forms: Sequence[str] = (),
    iota: float | None = None,
    tilt: float = SEARCH.tilt,
    start: Mapping[str, float] | None = None,
    uncertain: Uncertain = None,
    observer: str | Path | None = None,
    progress: Progress = lambda done, words: None,
) -> Report:
    """Check the conditions on the gains of a control law, without simulating.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    gains : path or GainSet
        A gain file, or the name of a bundled one (paper-pd, paper-pid, paper-smc).
    confidence : float
        Confidence level of the parameter intervals.
    covariance : (names, matrix)
        Covariance of parameters, as `undertow.model.loading.last_covariance` reads it from a vehicle file.
    forms : sequence of str
        Conditions to check: "printed", "units", "derived"; all by default.
    iota : float, optional
        The constant of the PID conditions, 1/s; searched for by default.
    tilt : float
        Largest roll and pitch that the check covers, degrees.
    start : mapping, optional
        Largest errors by coordinate, m and rad, at rest, that the certified region has to contain.
    uncertain : float, mapping or "stated", optional
        Inertia and damping parameters over whose whole range the certified region has to hold: all within a
        fraction of their values (0.1 is 10%), some by name within their own fractions, or those with a
        standard deviation within their intervals at `confidence`; the values of the file by default.
    observer : str or Path, optional
        Observer file; the loop with this observer is linearised, too.
    progress : callable
        Called with the fraction done and a description of the current step.

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
    if chosen.plant.vehicle != vehicle:
        raise UndertowError(
            f"gains '{chosen.name}' are for '{chosen.plant.vehicle.name}' with other values, not for this "
            f"'{vehicle.name}': read their file for it"
        )
    uncertainty = Uncertainty(vehicle, confidence, covariance)
    options = {"forms": forms, "iota": iota, "tilt": radians(tilt), "start": start, "uncertain": uncertain}
    design = None if observer is None else load_observer(observer, vehicle)
    return certify(chosen, uncertainty, observer=design, progress=progress, **options)


@of_stated_kinds
def linearize(
    vehicle: Vehicle, at: Mapping[str, float] | None = None, *, pade: int = 0, dt: float = 0.0
) -> ct.StateSpace:
    """The linear system of python-control at a steady motion.

    Parameters
    ----------
    vehicle : Vehicle
        The model.
    at : mapping, optional
        Velocities, attitude, depth or commands that are held, SI; hovering by default.
    pade : int
        Order of the approximation of dead times; 0 leaves them out.
    dt : float
        Sampling time, s: commands are held, dead times are whole samples; 0 is continuous time.

    Returns
    -------
    control.StateSpace
        States are pose, velocities and those of the effects; inputs are commands, outputs pose and
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
    from .linear import systems  # brings python-control

    held = {"u": 0.0, "v": 0.0, "w": 0.0} if at is None else at
    return systems.linearize(vehicle, held, pade=pade, dt=dt)
