"""Bringing up to date what follows from a vehicle and its gain files: C code, pictures, the state before."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from undertow.codegen.library import Library
from undertow.codegen.manifest import Report as Written
from undertow.codegen.spelling import slug
from undertow.errors import UndertowError
from undertow.files import check_folder, read_json, together, write_whole
from undertow.model.vehicle import Vehicle
from undertow.observer.design import Design
from undertow.observer.observer_c import observer_c
from undertow.typing import Progress

from .conditions.full_loop import verdicts
from .controller import Controller
from .controller_c import controller_c
from .gains import GainSet, load_gains
from .guidance.mission import Mission

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .linear.report import Snapshot

_log = logging.getLogger(__name__)
_STATE, _OWN, _PICTURES = "update.json", "vehicle", "figures"


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
        _check_names(gains)
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


def _check_names(gains: Sequence[str]) -> None:
    """Refuse gain files whose pictures would be written over others, or over those of the vehicle."""
    owners = {_OWN: "the vehicle"}
    for name in gains:
        stem = Path(name).stem
        owner = owners.setdefault(stem.lower(), name)
        if owner != name:
            raise UndertowError(
                f"gain file {name} would have the name of pictures '{stem}', which is that of {owner}: "
                "give the file another name"
            )


def _pictures(
    vehicle: Vehicle, gains: Mapping[str, GainSet], at: Mapping[str, float] | None, new: Snapshot
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
