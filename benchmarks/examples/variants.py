"""Vehicle files with effects added by hand, and runs read as the command line reads them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle

from .calls import ROOT, Judged

#: Effect to its parameters: a number is a start value to be estimated, a text is a value that is known.
Tables = Mapping[str, Mapping[str, float | str]]


def variant(template: str, tables: Tables, out: Path) -> Path:
    """Write a vehicle file with further effects."""
    out.write_text((ROOT / template).read_text(encoding="utf-8") + "\n" + added(tables), encoding="utf-8")
    return out


def added(tables: Tables) -> str:
    """The tables as TOML."""
    parts = [
        [f"[effects.{effect}]", *(_entry(n, v) for n, v in values.items())]
        for effect, values in tables.items()
    ]
    return "\n\n".join("\n".join(lines) for lines in parts) + "\n"


def _entry(name: str, value: float | str) -> str:
    if isinstance(value, str):
        return f'{name} = "{value}"'
    return f"{name} = {{ value = {value:g}, assumed = true, estimate = true }}"


def vehicle_of(path: str | Path) -> Vehicle:
    """A vehicle file, from the root of the repository, or a bundled vehicle."""
    file = ROOT / path
    return load_vehicle(str(file if file.is_file() else path))


def logs_of(what: Judged, data: Path, vehicle: Vehicle, *, held: bool = False) -> list[Run]:
    """The logs that are identified on, or those to validate on, with the channels that they have."""
    mapping = read_mapping(ROOT / what.mapping)
    names = what.holdout if held else what.logs
    return [read_log(data / n, mapping, vehicle.command_names, window=what.window) for n in names]


def runs_of(what: Judged, data: Path, vehicle: Vehicle, *, held: bool = False) -> list[Run]:
    """The same as the command line reads them: velocities that a log lacks are taken from its pose."""
    runs = logs_of(what, data, vehicle, held=held)
    return [velocities_from_pose(run, vehicle.degrees_of_freedom) for run in runs]
