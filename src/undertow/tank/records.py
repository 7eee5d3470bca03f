"""Logs of a tank: tables in SI units, each with a mapping file that says what its columns are."""

from __future__ import annotations

from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import numpy as np
import tomlkit

from undertow.errors import UndertowError
from undertow.files import read_toml, together, write_whole
from undertow.identification.logs.mapping import SCHEMA
from undertow.model.symbols import DOFS, FORCE, VELOCITY
from undertow.typing import Array

from .settings import Case, Tank

_POSITION = ("x", "y", "z", "phi", "theta", "psi")


@dataclass(frozen=True)
class Record:
    """What happened in one case on one grid; all arrays have shape (n,), SI units, along the motion."""

    time: Array  # s
    push: Array  # force or moment on the hull from outside, N or N m
    place: Array  # m or rad
    speed: Array  # m/s or rad/s
    acceleration: Array  # m/s^2 or rad/s^2: by Newton from the forces where the hull is free
    water: Array  # force or moment of the water on the hull, N or N m
    grid: int
    cells: int
    seconds: float  # of one processor that the solver took


def columns(motion: str) -> tuple[str, ...]:
    """Names of the columns of a log, with units."""
    turns = DOFS.index(motion) > 2
    force, angle = ("moment", "rad") if turns else ("force", "m")
    unit = "Nm" if turns else "N"
    return (
        "t_s",
        f"applied_{force}_{unit}",
        f"place_{angle}",
        f"speed_{angle}_s",
        f"acceleration_{angle}_s2",
        f"water_{force}_{unit}",
    )


def write_record(path: Path, record: Record, tank: Tank, case: Case) -> None:
    """Write a log and, beside it, its mapping file with the grid and the settings of the solver."""
    table = np.column_stack(
        [record.time, record.push, record.place, record.speed, record.acceleration, record.water]
    )
    text = StringIO()
    np.savetxt(text, table, fmt="%.9g", delimiter=",", header=",".join(columns(case.motion)), comments="")
    with together():
        write_whole(path, text.getvalue())
        write_whole(path.with_suffix(".toml"), _mapping(record, tank, case))


def _mapping(record: Record, tank: Tank, case: Case) -> str:
    place = DOFS.index(case.motion)
    turns = place > 2
    names = columns(case.motion)
    kind = "prescribed motion, force measured" if case.prescribed else "force given, one motion free"
    flow = "k-omega SST with wall functions" if case.turbulent else "laminar"
    document = tomlkit.document()
    for line in (
        f"Virtual towing tank: {case.name} of {tank.hull}; {kind}; no measurement noise.",
        f"grid {record.grid}: {record.cells} cells, {tank.cell_of(record.grid):.4g} m at the hull, "
        f"{case.copies} times mirrored",
        f"OpenFOAM pimpleFoam, {flow}, time step {tank.step_of(case, record.grid):.4g} s, "
        f"{record.seconds:.0f} s of a processor",
    ):
        document.add(tomlkit.comment(line))
    mark = "rad" if turns else "m"
    mapping = {
        "schema": SCHEMA,
        "description": f"Towing tank, {case.name}, grid {record.grid} of {record.cells} cells; {flow}",
        "ignore": list(names[4:]),
        "held": "unlogged",
        "time": {"column": names[0], "unit": "s"},
        "columns": {
            names[1]: {"channel": f"tau_{FORCE[place]}", "unit": "N m" if turns else "N"},
            names[2]: {"channel": _POSITION[place], "unit": mark},
            names[3]: {"channel": VELOCITY[place], "unit": f"{mark}/s"},
        },
    }
    document.update(mapping)
    return tomlkit.dumps(document)


def read_record(path: Path, grid: int) -> Record:
    """Read a log of the tank."""
    try:
        table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    except (OSError, ValueError) as error:
        raise UndertowError(
            f"{path}: not a log of the tank ({error}): remove it and run the tank again"
        ) from error
    if table.shape[1] != 6 or len(table) < 4:
        raise UndertowError(f"{path}: not a log of the tank (six columns): remove it and run the tank again")
    description = str(read_toml(path.with_suffix(".toml"), "mapping file").get("description", ""))
    digits = description.rpartition(" of ")[2].split(" cells")[0]
    cells = int(digits) if digits.isdigit() else 0
    t, push, place, speed, acceleration, water = table.T
    return Record(t, push, place, speed, acceleration, water, grid, cells, 0.0)
