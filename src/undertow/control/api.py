"""The control part of `import undertow`; the commands call the same functions."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

from undertow.codegen.library import Library
from undertow.codegen.manifest import Report as Written
from undertow.codegen.spelling import slug
from undertow.errors import UndertowError
from undertow.files import check_folder, read_json, together, write_whole
from undertow.model.vehicle import Vehicle
from undertow.observer.design import Design, load_observer
from undertow.observer.observer_c import observer_c
from undertow.typing import Progress

from .conditions.check import Uncertain
from .conditions.problem import Uncertainty
from .conditions.result import Report
from .conditions.whole import certify, verdicts
from .controller import Controller, controller_c
from .gains import GainSet, load_gains
from .guidance.mission import Mission

if TYPE_CHECKING:
    import control as ct
    from matplotlib.figure import Figure

    from .linear.report import Snapshot

_log = logging.getLogger(__name__)
_STATE, _OWN, _PICTURES = "update.json", "vehicle", "figures"


def check_gains(
    vehicle: Vehicle,
    gains: str | Path | GainSet,
    *,
    confidence: float = 0.95,
    covariance: tuple[Sequence[str], Any] = ((), ()),
    forms: Sequence[str] = (),
    iota: float | None = None,
    tilt: float = 60.0,
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
        Covariance of parameters, as `undertow.model.saving.last_covariance` reads it from a vehicle file.
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
        fraction of their values (0.1 is 10 %), some by name within their own fractions, or those with a
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
    uncertainty = Uncertainty(vehicle, confidence, covariance)
    options = {"forms": forms, "iota": iota, "tilt": radians(tilt), "start": start, "uncertain": uncertain}
    design = None if observer is None else load_observer(observer, vehicle)
    return certify(chosen, uncertainty, observer=design, progress=progress, **options)


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


# --- bringing up to date what follows from a vehicle ------------------------------------------------
@dataclass(frozen=True)
class Update:
    """The result of an update: C code, plots, and the state before (if any) and now."""

    old: Snapshot | None
    new: Snapshot
    written: Written
    pictures: list[Path]


def last_update(vehicle: Vehicle, out: Path) -> Snapshot | None:
    """State left by the last update of a vehicle in its folder below `out`; None if there was none."""
    from .linear.report import Snapshot

    folder = out / slug(vehicle.name)
    check_folder(folder)
    path = folder / _STATE
    if not path.is_file():
        return None
    try:
        return Snapshot.from_json(read_json(path, "state file"))
    except UndertowError as error:
        _log.warning("%s is ignored: %s", path, error)
        return None


def update(
    vehicle: Vehicle,
    out: Path,
    gains: Sequence[str] = (),
    at: Mapping[str, float] | None = None,
    *,
    at_words: Sequence[str] = (),
    old: Snapshot | None = None,
    progress: Progress = lambda done, words: None,
) -> Update:
    """Write everything derived from a vehicle and its gain files: C code, controllers, plots, state.

    `out` gets a folder for the vehicle. `at` is a motion besides hovering whose eigenvalues are tracked, SI,
    `at_words` the same in words; `old` what `last_update` found. If something cannot be read, stated in C or
    written, nothing is written.
    """
    from undertow.figures import save_pictures

    from .linear.numeric import as_input_error
    from .linear.report import snapshot

    with as_input_error():
        sets = {name: load_gains(name, vehicle) for name in gains}
        _check_apart(gains)
        library = library_of(vehicle, list(sets.values()))
        assert library.texts  # what cannot be stated in C is refused before anything is written
        progress(0.3, "eigenvalues, margins and conditions")
        new = snapshot(vehicle, sets, at, at_words, verdicts)
        progress(0.6, "pictures")
        drawn = _pictures(vehicle, sets, at, new)
        with together():
            written = library.write(out)
            paths = save_pictures(drawn, written.folder / _PICTURES)
            # Last, so that an interrupted update is made again.
            write_whole(written.folder / _STATE, new.to_json())
        return Update(old, new, written, paths)


def library_of(
    vehicle: Vehicle,
    gains: Sequence[GainSet] = (),
    observers: Sequence[Design] = (),
    mission: Mission | None = None,
) -> Library:
    """The C library of a vehicle with observers and controllers, which follow the mission if there is one."""
    controllers = [Controller(g, mission.reference(g) if mission else None) for g in gains]
    parts = [(c.gains.name, partial(controller_c, c)) for c in controllers]
    return Library(vehicle, [*parts, *((d.name, partial(observer_c, d)) for d in observers)])


def _check_apart(gains: Sequence[str]) -> None:
    """Refuse gain files whose pictures would be written over others, or over those of the vehicle."""
    owners = {_OWN: "the vehicle"}
    for name in gains:
        place = Path(name).stem
        owner = owners.setdefault(place.lower(), name)
        if owner != name:
            raise UndertowError(
                f"gain file {name} would have the name of pictures '{place}', which is that of {owner}: "
                "give the file another name"
            )


def _pictures(
    vehicle: Vehicle,
    gains: Mapping[str, GainSet],
    at: Mapping[str, float] | None,
    new: Snapshot,
) -> dict[str, Figure]:
    """Plots by file name, of systems that can be linearised."""
    from .linear.pictures import picture
    from .linear.report import Analysis
    from .linear.trim import find_trim

    own = Analysis(vehicle, find_trim(vehicle, at))
    kinds = ("poles", "bode") if own.main_channels else ("poles",)
    drawn = {f"{_OWN}-{kind}": picture(kind, own, own.main_channels) for kind in kinds}
    hover = find_trim(vehicle)
    for name, one in gains.items():
        if any(of.startswith(f"{name}, ") for of in new.eigenvalues):
            closed = Analysis(vehicle, hover, one)
            for kind in ("poles", "bode", "step"):
                drawn[f"{Path(name).stem}-{kind}"] = picture(kind, closed, closed.main_channels)
    return drawn
