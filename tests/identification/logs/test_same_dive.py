"""One dive in every format: fits and diagnoses have the same answers."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest

from tests.quick import quick_if
from undertow.identification import api
from undertow.identification.diagnose import DiagnosisResult, diagnose
from undertow.identification.logs.formats.fieldlog import read_field_log
from undertow.identification.logs.reading import read_logs
from undertow.identification.logs.run import Run

from .ardusub import write_bin
from .dive import CURRENT, MISSING, dive
from .written import BAGS, bag, by_pyulog, in_newtons, mat, mat73, netcdf, ulog

_DOUBLES = ["dive.mat", "dive-73.mat", "dive.nc", *sorted(BAGS)]
_FLOATS = ["dive.bin", "dive.ulg"]
"""Formats of autopilots: their numbers have 32 bits."""


def _written(path: Path) -> Path:
    library = {".bin": "pymavlink", ".ulg": "pyulog", ".nc": "netCDF4", ".mat": "matio"}
    pytest.importorskip(library.get(path.suffix, "rosbags"))
    if path.suffix == ".bin":
        return write_bin(path)
    if path.suffix == ".ulg":
        return by_pyulog(ulog(dive()).write(path))
    return {"dive.mat": mat, "dive-73.mat": mat73, "dive.nc": netcdf}.get(path.name, bag)(path, dive())


def _read(folder: Path, name: str) -> Run:
    """The dive from a file of a format, without being told what its columns mean; thrust in N."""
    path, vehicle, mapping = _written(folder / name), dive().vehicle, None
    if name in _FLOATS:  # they have shares of the full output
        mapping = in_newtons(read_field_log(path).mapping_for(vehicle.command_names))
    (run,) = read_logs([path], vehicle, mapping)
    return run


@cache
def _fitted_to_the_dive() -> dict[str, float]:
    return _values(dive().run)


def _values(run: Run) -> dict[str, float]:
    """Values that a fit to two thirds of the dive has."""
    refitted = api.fit(dive().vehicle, *_parts(run), method="weak")
    return dict(zip(refitted.parameters["parameter"], refitted.parameters["value"], strict=True))


def _parts(run: Run) -> tuple[list[Run], list[Run]]:
    """To fit to and to judge by; the dive is cut between two samples of any clock."""
    cut = run.t[0] + 40.025
    return [run.slice(None, cut)], [run.slice(cut, None)]


@pytest.mark.parametrize("name", quick_if(min(BAGS).__eq__, _DOUBLES))
def test_a_fit_has_the_same_values_from_every_format_with_doubles(tmp_path: Path, name: str) -> None:
    assert _values(_read(tmp_path, name)) == pytest.approx(_fitted_to_the_dive(), rel=1e-6)


def test_a_fit_has_the_same_values_from_floats_to_their_precision(tmp_path: Path) -> None:
    found = _values(_read(tmp_path, "dive.ulg"))
    assert found == pytest.approx(_fitted_to_the_dive(), rel=1e-3)


@cache
def _reported() -> DiagnosisResult:
    return diagnose(dive().vehicle, *_parts(dive().run))


@pytest.mark.slow
@pytest.mark.parametrize("name", [*_DOUBLES, *_FLOATS])
def test_the_diagnosis_is_the_same_from_every_format(tmp_path: Path, name: str) -> None:
    found = diagnose(dive().vehicle, *_parts(_read(tmp_path, name)))
    assert found.verdict == _reported().verdict
    assert list(found.effects) == [MISSING] == list(_reported().effects)
    one, other = (_estimates(result) for result in (found, _reported()))
    assert one == pytest.approx(other, rel=1e-3 if name in _FLOATS else 1e-6)
    assert {n: one[n] for n in CURRENT} == pytest.approx(CURRENT, abs=0.02)


def _estimates(result: DiagnosisResult) -> dict[str, float]:
    """Values of the model with what was found."""
    return {n: float(value.value) for n, value in result.after.values.items() if value.estimate}
