"""One dive in every format: fits and diagnoses have the same answers."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from tests.quick import quick_if
from undertow.identification import api
from undertow.identification.diagnose import diagnose
from undertow.identification.logs.formats.registry import read_field_log
from undertow.identification.logs.reading import read_logs
from undertow.identification.logs.run import Run

from .dive import MISSING, dive
from .written import BAGS, bag, in_newtons, mat, mat73, netcdf, ulog

_DOUBLES = ["dive.mat", "dive-73.mat", "dive.nc", *sorted(BAGS)]


def _read(folder: Path, name: str) -> Run:
    """The dive from a file of a format, without being told what its columns mean."""
    library = {".ulg": "pyulog", ".nc": "netCDF4", ".mat": "h5py"}.get(Path(name).suffix, "rosbags")
    pytest.importorskip(library)
    path, vehicle = folder / name, dive().vehicle
    if name == "dive.ulg":
        path = ulog(dive()).write(path)
        mapping = in_newtons(read_field_log(path).mapping_for(vehicle.command_names))
        return read_logs([path], vehicle, mapping)[0]
    write = {"dive.mat": mat, "dive-73.mat": mat73, "dive.nc": netcdf}.get(name, bag)
    return read_logs([write(path, dive())], vehicle)[0]


@cache
def _fitted_to_the_dive() -> dict[str, float]:
    return _values(dive().run)


def _values(run: Run) -> dict[str, float]:
    """Values that a fit to two thirds of the dive has; it is cut between two samples."""
    refitted = api.fit(dive().vehicle, [run.slice(None, 40.025)], [run.slice(40.025, None)], method="weak")
    return dict(zip(refitted.parameters["parameter"], refitted.parameters["value"], strict=True))


@pytest.mark.parametrize("name", quick_if(min(BAGS).__eq__, _DOUBLES))
def test_a_fit_has_the_same_values_from_every_format_with_doubles(tmp_path: Path, name: str) -> None:
    assert _values(_read(tmp_path, name)) == pytest.approx(_fitted_to_the_dive(), rel=1e-6)


def test_a_fit_has_the_same_values_from_floats_to_their_precision(tmp_path: Path) -> None:
    found = _values(_read(tmp_path, "dive.ulg"))
    assert found == pytest.approx(_fitted_to_the_dive(), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["dive.mcap", "dive.ulg"])
def test_the_diagnosis_finds_the_current_from_a_log_of_the_vehicle(tmp_path: Path, name: str) -> None:
    train, test = slice(None, 40.025), slice(40.025, None)  # between two samples
    logs = {"told": dive().run, "found": _read(tmp_path, name)}
    results = {
        what: diagnose(dive().vehicle, *([run.slice(part.start, part.stop)] for part in (train, test)))
        for what, run in logs.items()
    }
    told, found = results["told"], results["found"]
    assert list(found.effects) == [MISSING] == list(told.effects)
    assert found.verdict == told.verdict
    current, expected = (
        {n: float(one.after.values[n].value) for n in ("V_N", "V_E")} for one in (found, told)
    )
    assert current == pytest.approx(expected, rel=1e-6 if name == "dive.mcap" else 1e-3)
    assert np.hypot(*current.values()) == pytest.approx(np.hypot(0.25, 0.15), rel=0.1)
