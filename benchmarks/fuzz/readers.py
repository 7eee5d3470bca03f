"""Every reader of a file that somebody else may have written, and what is sound of what it gives back."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from undertow.codegen.library import Library
from undertow.codegen.manifest import Report
from undertow.control.gains import load_gains
from undertow.control.linear.report import Snapshot, changes
from undertow.errors import UndertowError
from undertow.fleet.diagnose import Store
from undertow.fleet.partitions import partition_of
from undertow.identification.diagnosis.result import Diagnosis, read_diagnosis
from undertow.identification.logs.chunks import LongLog
from undertow.identification.logs.mapping import LogMapping, read_mapping
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run
from undertow.identification.planning.rivals import Diagnosed
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle
from undertow.shape.mesh import read_hull

COMMANDS = ("f1", "f2", "f3", "f4")


@dataclass(frozen=True)
class Reader:
    """A way to read a file.

    Attributes
    ----------
    suffix : str
        How the file is called at its end.
    read : callable
        Reads it, and raises AssertionError where what comes out is not sound.
    """

    suffix: str
    read: Callable[[Path], Any]


def refusal(reader: Reader, path: Path) -> str:
    """Why a file is refused, in one line; empty where it is read.

    Raises
    ------
    AssertionError
        If the words are not one printable line, or what was read is not sound.
    """
    try:
        reader.read(path)
    except UndertowError as error:
        words = str(error)
        assert words, "refused without a word"
        assert words.isprintable(), f"not one printable line: {words!r}"
        return words
    return ""


# --- logs and mapping files -----------------------------------------------------------------------
def sound_run(run: Run) -> Run:
    """The run, of which times increase and every value is a number or missing."""
    assert len(run.t) > 1, "a run of less than two samples"
    assert np.isfinite(run.t).all(), "a time that is no number"
    assert (np.diff(run.t) > 0).all(), "times that do not increase"
    for name, values in run.channels.items():
        assert values.shape == run.t.shape, f"{name} has {values.shape}, the time {run.t.shape}"
        assert values.dtype == np.float64, f"{name} is {values.dtype}"
        assert not np.isinf(values).any(), f"{name} is infinite"
    return run


def _log(path: Path) -> Run:
    return sound_run(read_log(path, also=COMMANDS, missing_commands="gap"))


def _parts(path: Path) -> list[Run]:
    log = LongLog(path, LogMapping(), COMMANDS, missing_commands="gap")
    return [sound_run(part.run) for part in log.parts(60, 10)]


def _mapping(path: Path) -> LogMapping:
    mapping = read_mapping(path)
    assert LogMapping.model_validate_json(mapping.model_dump_json(by_alias=True)) == mapping, (
        "not what it says"
    )
    return mapping


def read_both(mapping: Path, log: Path) -> Run:
    """A log as a mapping file says."""
    return sound_run(read_log(log, _mapping(mapping), also=COMMANDS, missing_commands="gap"))


# --- vehicles and gains ---------------------------------------------------------------------------
def _vehicle(path: Path) -> Vehicle:
    vehicle = load_vehicle(path)
    for name, value in vehicle.values.items():
        assert math.isfinite(value.value), f"{name} = {value.value}"
        assert value.sigma is None or 0 < value.sigma < math.inf, f"sigma of {name} = {value.sigma}"
    for thruster in vehicle.thrusters:
        assert all(map(math.isfinite, thruster.wrench)), f"{thruster.name} has wrench {thruster.wrench}"
    return vehicle


@cache
def _paper() -> Vehicle:
    return load_vehicle("mini-auv")


def _gains(path: Path) -> Any:
    gains = load_gains(path, _paper())
    assert all(0 <= v < math.inf for v in gains.values.values()), f"gains {gains.values}"
    return gains


# --- what undertow itself has written -------------------------------------------------------------
def _diagnosis(path: Path) -> Any:
    found = read_diagnosis(path, Diagnosis)
    assert type(found).model_validate_json(found.model_dump_json()) == found, "not what it says"
    return found


def _for_plan(path: Path) -> Any:
    found = read_diagnosis(path, Diagnosed)
    assert found.rivals is not None
    assert len(found.in_every_rival) <= len(found.effects)
    return found


def _snapshot(path: Path) -> Snapshot:
    """What `undertow update` remembers, and what it then says has changed."""
    found = Snapshot.from_json(path.read_text(encoding="utf-8", errors="surrogateescape"))
    assert Snapshot.from_json(found.to_json()) == found, "not what it says"
    others = changes(found, Snapshot("mini-auv", eigenvalues={n: {"u": "-1"} for n in found.eigenvalues}))
    assert all(isinstance(change.what, str) for kind in others.values() for change in kind)
    return found


@cache
def _export() -> Library:
    return Library(load_vehicle("box-hull"))


def _manifest(path: Path) -> Report:
    """The manifest of generated code as `export c --check` meets it, which calls a damaged one stale."""
    folder = path.parent / _export().folder_name
    folder.mkdir(exist_ok=True)
    (folder / "manifest.json").write_bytes(path.read_bytes())
    report = _export().check(path.parent)
    assert all(line.isprintable() for line in report.changes), f"not printable: {report.changes}"
    return report


def _stored(path: Path) -> Any:
    """A small table of a fleet; a damaged one counts as not there."""
    store = Store(path.parent)
    place = store._path("", "")  # its name comes from a hash
    place.write_bytes(path.read_bytes())
    found = store.get("", "")
    assert found is None or np.isfinite(found.factor).all(), "numbers that are none"
    return found


# --- hulls, and files of a fleet ------------------------------------------------------------------
def _hull(path: Path) -> Any:
    hull = read_hull(path)
    mesh = hull.mesh
    assert np.isfinite(mesh.vertices).all(), "a vertex that is no number"
    assert mesh.faces.min() >= 0, "a face without a vertex"
    assert mesh.faces.max() < len(mesh.vertices), "a face without a vertex"
    assert 0 < mesh.volume < math.inf, f"a volume of {mesh.volume} m^3"
    return hull


def _partition(path: Path) -> Any:
    return partition_of(path, LogMapping())


READERS = {
    "log": Reader(".csv", _log),
    "parts of a log": Reader(".csv", _parts),
    "mapping": Reader(".toml", _mapping),
    "vehicle": Reader(".toml", _vehicle),
    "gains": Reader(".toml", _gains),
    "diagnosis": Reader(".json", _diagnosis),
    "diagnosis for a plan": Reader(".json", _for_plan),
    "snapshot": Reader(".json", _snapshot),
    "manifest": Reader(".json", _manifest),
    "STL": Reader(".stl", _hull),
    "OBJ": Reader(".obj", _hull),
    "MSH": Reader(".msh", _hull),
    "partition": Reader(".parquet", _partition),
    "store": Reader(".npz", _stored),
}
