"""One run told in 27 ways (units, frames, and how the file is written): the fit is the same."""

from __future__ import annotations

import gzip
from itertools import product
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from benchmarks.hidden_effects import Case, make_case
from tests.identification.logs_of import vehicle_of
from tests.quick import first_quick
from undertow.identification.api import Estimator
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.reading import read_log
from undertow.model.vehicle import Vehicle

Columns = dict[str, np.ndarray]
Reported = tuple[Columns, dict[str, object]]

DOFS = ("surge", "sway", "yaw")
KINDS = {"x": "length", "y": "length", "psi": "angle", "u": "speed", "v": "speed", "r": "rate"}
# Of each kind: the unit, and how many of it make one in SI.
UNITS = {
    "SI": {},
    "degrees": {"angle": ("deg", 180 / np.pi), "rate": ("deg/s", 180 / np.pi), "force": ("kN", 1e-3)},
    "imperial": {
        "length": ("ft", 1 / 0.3048),
        "angle": ("deg", 180 / np.pi),
        "speed": ("knot", 3600 / 1852),
        "rate": ("deg/min", 60 * 180 / np.pi),
        "force": ("lbf", 1 / 4.4482216152605),
    },
}
TIMES = {"SI": ("s", 1.0), "degrees": ("ms", 1e3), "imperial": ("min", 1 / 60)}


@pytest.fixture(scope="module")
def case() -> Case:
    """A surface vehicle without anything hidden, 20 s at 20 Hz."""
    return make_case("usv", (), 4, duration=20.0, runs=("multisine",))


@pytest.fixture(scope="module")
def vehicle(case: Case) -> Vehicle:
    return vehicle_of(case)


@pytest.fixture(scope="module")
def columns(case: Case, vehicle: Vehicle) -> Columns:
    """What is logged, in SI, NED and forward-starboard-down."""
    names = ("t", *KINDS, *vehicle.command_names)
    return {name: np.asarray(case.runs["multisine"][name]) for name in names}


# --- axes, written down again ---------------------------------------------------------------------
def ned(columns: Columns) -> Reported:
    return columns, {}


def enu(columns: Columns) -> Reported:
    """East, north; heading from east, anticlockwise; forward, port, up."""
    turned = {"x": columns["y"], "y": columns["x"], "psi": np.pi / 2 - columns["psi"]}
    port = {"v": -columns["v"], "r": -columns["r"]}
    return columns | turned | port, {"position": "ENU", "body": "FLU"}


def over_ground(columns: Columns) -> Reported:
    """East, north, but headings of a compass; velocities along north and east."""
    u, v, psi = columns["u"], columns["v"], columns["psi"]
    turned = {"x": columns["y"], "y": columns["x"]}
    along = {"u": u * np.cos(psi) - v * np.sin(psi), "v": u * np.sin(psi) + v * np.cos(psi)}
    return columns | turned | along, {"position": "ENU", "attitude": "NED", "velocity": "NED"}


FRAMES = {"NED": ned, "ENU": enu, "over ground": over_ground}


# --- files ----------------------------------------------------------------------------------------
def csv(table: pl.DataFrame, path: Path, mapping: dict[str, object]) -> Path:
    """In the usual order, with a column that nobody needs."""
    path = path.with_suffix(".csv")
    table.with_columns(battery=pl.lit(12.5)).write_csv(path)
    return path


def csv_gz(table: pl.DataFrame, path: Path, mapping: dict[str, object]) -> Path:
    """Packed, with semicolons and decimal commas, columns from the last to the first."""
    path = path.with_suffix(".csv.gz")
    text = table.select(table.columns[::-1]).write_csv(separator=";").replace(".", ",")
    path.write_bytes(gzip.compress(text.encode()))
    mapping |= {"delimiter": ";", "decimal": ","}
    return path


def parquet(table: pl.DataFrame, path: Path, mapping: dict[str, object]) -> Path:
    """At three times the rate, of which every third row is asked for; columns in any order."""
    path = path.with_suffix(".parquet")
    between = table.with_columns(pl.all().exclude("clock") + 0.125)  # something else between the rows
    steps = table["clock"].diff().fill_null(1e-3)
    rows = [table, *(between.with_columns(clock=pl.col("clock") + k * 1e-3 * steps.min()) for k in (1, 2))]
    names = sorted(table.columns)
    pl.concat(rows).sort("clock").select(names).write_parquet(path)
    mapping["time"] = {**mapping["time"], "every": 3}
    return path


FILES = {"CSV": csv, "CSV.gz": csv_gz, "Parquet": parquet}


# --- the same fit ---------------------------------------------------------------------------------
def written(columns: Columns, units: str, frames: str, file: str, folder: Path) -> tuple[Path, LogMapping]:
    """A run as a file, with the mapping that says how."""
    reported, spec = FRAMES[frames](columns)
    unit, per_second = TIMES[units]
    table, named = {"clock": reported["t"] * per_second}, {}
    for name, values in reported.items():
        if name != "t":
            unit_of, factor = UNITS[units].get(KINDS.get(name, "force"), (None, 1.0))
            table[f"my {name}"] = values * factor
            named[f"my {name}"] = {"channel": name, "unit": unit_of}
    mapping = {"columns": named, "frames": spec, "time": {"column": "clock", "unit": unit}}
    path = FILES[file](pl.DataFrame(table), folder / "run", mapping)
    return path, LogMapping.model_validate(mapping)


def fitted(vehicle: Vehicle, path: Path, mapping: LogMapping) -> tuple[np.ndarray, np.ndarray]:
    """Values and standard errors of the free parameters by the weak form."""
    found = Estimator("weak").fit(vehicle, [read_log(path, mapping, vehicle.command_names)])
    names = found.model.free
    return np.array([found.values[n] for n in names]), np.array([found.standard_errors[n] for n in names])


@pytest.fixture(scope="module")
def as_it_is(
    vehicle: Vehicle, columns: Columns, tmp_path_factory: pytest.TempPathFactory
) -> tuple[np.ndarray, np.ndarray]:
    """The fit of the run in undertow's own channels, without a mapping."""
    path = tmp_path_factory.mktemp("plain") / "run.csv"
    pl.DataFrame(columns).write_csv(path)
    return fitted(vehicle, path, LogMapping())


_TOGETHER = [*zip(UNITS, FRAMES, FILES, strict=True)]  # every unit, frame and file once


@pytest.mark.parametrize(
    ("units", "frames", "file"),
    first_quick([*_TOGETHER, *(way for way in product(UNITS, FRAMES, FILES) if way not in _TOGETHER)], 3),
)
def test_the_fit_does_not_depend_on_how_the_run_is_represented(
    units: str, frames: str, file: str, vehicle: Vehicle, columns: Columns, as_it_is, tmp_path: Path
) -> None:
    values, errors = fitted(vehicle, *written(columns, units, frames, file, tmp_path))
    np.testing.assert_allclose(values, as_it_is[0], rtol=1e-8)
    np.testing.assert_allclose(errors, as_it_is[1], rtol=1e-6)


def test_what_is_the_same_27_times_is_also_right(case: Case, vehicle: Vehicle, as_it_is) -> None:
    truth = case.truth["parameters"]
    names = [n for n in vehicle.parameter_names if vehicle.value_of(n).estimate]
    away = (as_it_is[0] - [truth[n] for n in names]) / as_it_is[1]
    assert np.sqrt(np.mean(away**2)) < 2.0


def test_half_the_rate_gives_the_same_values_within_their_errors(
    vehicle: Vehicle, columns: Columns, as_it_is, tmp_path: Path
) -> None:
    """Every second sample of the motion, and the mean of the commands in between."""
    slow = {name: values[: len(values) // 2 * 2 : 2] for name, values in columns.items()}
    for name in vehicle.command_names:
        slow[name] = columns[name][: 2 * len(slow[name])].reshape(-1, 2).mean(axis=1)
    values, errors = fitted(vehicle, *written(slow, "SI", "NED", "CSV", tmp_path))
    away = (values - as_it_is[0]) / np.hypot(errors, as_it_is[1])
    assert np.abs(away).max() < 3.0
    assert np.abs(away).max() > 1e-3  # they are other samples
