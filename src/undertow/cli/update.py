"""Bring everything that follows from a vehicle file up to date after an edit, and say what has changed.

Written into build/NAME/: the model's C code, and pictures of its poles, of the loops and of their steps; for
each gain file its controller in C, in a folder of its own beside. The conditions on gains are checked again.
What has changed since the last time is printed: parameters, eigenvalues, margins, verdicts.

    undertow update rov.toml --gains pd.toml --gains pid.toml --at u=0.5

The gain files and the motion are remembered: after the next edit the name of the vehicle is enough.

    undertow update rov.toml

Nothing is written if a file is no good. What was there the last time stands in build/NAME/update.json.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from undertow.cli._vehicle_and_logs import EffectsOption, VehicleArgument
from undertow.codegen.export import Export
from undertow.codegen.export import Report as Written
from undertow.control.conditions.result import HOLDS
from undertow.control.conditions.whole import verdicts
from undertow.control.controller import PICTURES, Controller, ControllerExport
from undertow.control.gains import GainSet, load_gains
from undertow.control.linear.report import Analysis, Change, Snapshot, changes, snapshot
from undertow.errors import UndertowError
from undertow.files import check_folder, make_folder, read_json, together, write_whole
from undertow.identification.figures import save_png
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

from ._terminal import Report, console, section, table, text
from .linearize import Wish, picture

_GAINS = typer.Option(
    "--gains",
    metavar="GAINS",
    help="Gain file, or name of a bundled one; may be repeated.",
    show_default="those of the last time",
)
_AT = typer.Option(
    "--at",
    metavar="NAME=VALUE",
    help="A motion besides hovering, whose eigenvalues are watched.",
    show_default="that of the last time",
)
_OUT = typer.Option("--out", metavar="FOLDER", help="Folder that gets a folder NAME for the vehicle.")


def update(
    vehicle: VehicleArgument,
    gains: Annotated[list[str] | None, _GAINS] = None,
    at: Annotated[list[str] | None, _AT] = None,
    out: Annotated[Path, _OUT] = Path("build"),
    effects: EffectsOption = None,
) -> None:
    from undertow.control.linear.numeric import told

    from ._terminal import progress

    with progress("updating") as tell, told():
        done = Update(vehicle, gains, at, out, effects or []).run(tell)
    show(done)


_log = logging.getLogger(__name__)
_STATE, _OWN = "update.json", "vehicle"


@dataclass(frozen=True)
class Done:
    """What came of an update.

    Attributes
    ----------
    old : Snapshot or None
        What was there the last time.
    new : Snapshot
        What is there now.
    written : list of Written
        C code, by folder.
    pictures : list of Path
        Pictures.
    """

    old: Snapshot | None
    new: Snapshot
    written: list[Written]
    pictures: list[Path]


class Update:
    """An update of one vehicle.

    Parameters
    ----------
    vehicle : str
        Vehicle file, or name of a bundled one.
    gains, at : list of str or None
        Gain files and motion; those of the last time if None.
    out : Path
        Folder that gets a folder for the vehicle.
    effects : sequence of Path
        Files with effects of the user.
    """

    def __init__(
        self,
        vehicle: str,
        gains: list[str] | None,
        at: list[str] | None,
        out: Path,
        effects: Sequence[Path] = (),
    ) -> None:
        self._vehicle = load_vehicle(vehicle, effect_files=effects)
        self._export, self._out = Export(self._vehicle), out
        self._folder = out / self._export.folder_name
        check_folder(self._folder)
        self.old = self._before()
        self._names = gains if gains is not None else self.old.gains if self.old else []
        self._at = at if at is not None else self.old.at if self.old else []
        self._wish = Wish(vehicle, self._at, [], None, [], effects=effects)

    def _before(self) -> Snapshot | None:
        path = self._folder / _STATE
        if not path.is_file():
            return None
        try:
            return Snapshot.from_json(read_json(path, "state file"))
        except UndertowError as error:
            _log.warning("%s counts as not there: %s", path, error)
            return None

    def run(self, tell: Report) -> Done:
        """Work out everything, then write it."""
        gains = {name: load_gains(name, self._vehicle) for name in self._names}
        controllers = {name: ControllerExport(Controller(g)) for name, g in gains.items()}
        _check_apart({name: export.folder.name for name, export in controllers.items()}, "folder", {})
        _check_apart({n: Path(n).stem for n in gains}, "name of pictures", {_OWN: "the vehicle"})
        exports: list[Export | ControllerExport] = [self._export, *controllers.values()]
        for export in exports:
            assert export.texts  # what cannot be stated in C is refused before anything is written
        tell(0.3, "eigenvalues, margins and conditions")
        motion = self._wish.held()
        new, loops = snapshot(self._vehicle, gains, motion, self._at, verdicts)
        tell(0.6, "pictures")
        drawn = _pictures(self._vehicle, gains, self._wish, loops)
        with together():
            written = [export.write(self._out) for export in exports]
            return Done(self.old, new, written, self._write(new, drawn))

    def _write(self, new: Snapshot, drawn: Mapping[str, object]) -> list[Path]:
        folder = self._folder / PICTURES
        make_folder(folder)
        paths = [folder / f"{name}.png" for name in drawn]
        for path, one in zip(paths, drawn.values(), strict=True):
            save_png(one, path)  # type: ignore[arg-type]
        # Last, so that an interrupted update is made again.
        write_whole(self._folder / _STATE, new.to_json())
        return paths


def _check_apart(wanted: Mapping[str, str], what: str, taken: Mapping[str, str]) -> None:
    """Refuse gain files of which one would be written over another, or over what is `taken`."""
    owners = dict(taken)
    for name, place in wanted.items():
        owner = owners.setdefault(place.lower(), name)
        if owner != name:
            raise UndertowError(
                f"gain file {name} would have the {what} '{place}', which is that of {owner}: give "
                f"{'the set' if what == 'folder' else 'the file'} another name"
            )


def _pictures(
    vehicle: Vehicle, gains: Mapping[str, GainSet], wish: Wish, loops: Mapping[str, object]
) -> dict[str, object]:
    """Pictures by file name, of what has a linear form."""
    trim = wish.trim(vehicle)
    own = Analysis(vehicle, trim)
    kinds = ("poles", "bode") if own.main_channels else ("poles",)
    drawn: dict[str, object] = {f"{_OWN}-{kind}": picture(kind, own, own.main_channels) for kind in kinds}
    hover = Wish(wish.vehicle, [], [], None, [], effects=wish.effects).trim(vehicle)
    for name, one in gains.items():
        if any(loop.startswith(f"{name}, ") for loop in loops):
            closed = Analysis(vehicle, hover, one)
            drawn |= {
                f"{Path(name).stem}-{kind}": picture(kind, closed, closed.main_channels)
                for kind in ("poles", "bode", "step")
            }
    return drawn


# --- printing -----------------------------------------------------------------------------------
_TITLES = {
    "parameters": "Parameters",
    "eigenvalues": "Eigenvalues, rad/s",
    "margins": "Margins",
    "verdicts": "Verdicts",
}


def show(done: Done) -> None:
    """Print what was written, and what has changed."""
    out = console()
    for report in done.written:
        out.print(text(f"{report.folder}: written"), soft_wrap=True)
        for line in _of_equations(report):
            out.print(text(f"  {line}"), soft_wrap=True)
    out.print(text(f"{done.pictures[0].parent}: {', '.join(p.name for p in done.pictures)}"), soft_wrap=True)
    if done.old is None:
        out.print(text("first time: from now on, changes are told"))
        _show_verdicts(done.new)
        return
    found = changes(done.old, done.new)
    for kind, title in _TITLES.items():
        _show_changes(title, found[kind])


def _of_equations(report: Written) -> list[str]:
    """Changes of the code besides those of values, which are told below."""
    if report.first:
        return ["first time"]
    kept = [line for line in report.changes if not line.startswith("parameters changed")]
    return [line.replace("is not as it would be generated", "has changed") for line in kept]


def _show_changes(title: str, found: Sequence[Change]) -> None:
    if not found:
        section(f"{title}: none has changed")
        return
    rows = [(c.what, c.old or "(none)", c.new or "(none)") for c in found]
    section(title, table(("", "old", "new"), rows))


def _show_verdicts(new: Snapshot) -> None:
    conditions = {name: v for name, v in new.verdicts.items() if " condition " in name}
    rows = [(name, v) for name, v in new.verdicts.items() if name not in conditions]
    for gains in new.gains:
        own = [v for name, v in conditions.items() if name.startswith(f"{gains}, ")]
        failing = sum(v != HOLDS for v in own)
        told = f"{len(own) - failing} hold, {failing} fail (undertow gains tells which)"
        rows.append((f"{gains}, conditions one by one", told))
    section("Verdicts", table(("", ""), rows))
