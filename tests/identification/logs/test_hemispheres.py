"""Latitude and longitude: hemispheres by letters beside them, names in other languages, several vehicles."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from undertow.identification.logs.guess import guess_mapping
from undertow.identification.logs.guess_frames import GuessedMapping
from undertow.identification.logs.guess_names import latitude_and_longitude
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run

T = np.arange(0.0, 60.0, 0.5)
SOUTH, WEST = 33.5 - 1e-5 * T, 70.6 - 2e-5 * T  # on the way north and east, off Chile
# Metres that are an arc of so many degrees there.
NORTH, EAST = 110913.0 * 1e-5 * T, 92922.0 * 2e-5 * T


def _minutes(degrees: np.ndarray) -> np.ndarray:
    whole = np.floor(degrees)
    return np.asarray(100.0 * whole + 60.0 * (degrees - whole))


def _read(table: pl.DataFrame, path: Path) -> tuple[GuessedMapping, Run]:
    table.write_parquet(path) if path.suffix == ".parquet" else table.write_csv(path)
    guessed = guess_mapping(path)
    return guessed, read_log(path, guessed.meaning)


@pytest.mark.parametrize(
    "names",
    [
        ("lat", "ns", "lon", "ew"),
        ("Latitude", "N/S", "Longitude", "E/W"),
        ("gps_latitude", "lat_ref", "gps_longitude", "lon_ref"),
        ("lat", "a", "lon", "b"),  # by their place alone
    ],
)
@pytest.mark.parametrize("minutes", [True, False])
@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_letters_in_a_column_of_their_own_are_signs(
    tmp_path: Path, names: tuple[str, str, str, str], ending: str, *, minutes: bool
) -> None:
    written = [_minutes(place) if minutes else place for place in (SOUTH, WEST)]
    lat, south, lon, west = names
    columns = {"t": T, lat: written[0], south: ["S"] * len(T), lon: written[1], west: ["W"] * len(T)}
    guessed, run = _read(pl.DataFrame(columns), tmp_path / f"log.{ending}")
    np.testing.assert_allclose(run.channels["x"], NORTH, rtol=1e-3, atol=0.01)
    np.testing.assert_allclose(run.channels["y"], EAST, rtol=1e-3, atol=0.01)
    signs = f"south and west by the letters in '{south}' and '{west}'"
    assert any(signs in g.doubt for g in guessed.columns)
    assert f"signs of {lat}, {lon} by the letters in {south}, {west}" in run.notes
    assert not guessed.meaning.ignore


def test_a_sign_that_is_there_stays_and_north_and_east_have_none(tmp_path: Path) -> None:
    table = pl.DataFrame({"t": T, "lat": -SOUTH, "ns": "S", "lon": -WEST, "ew": "W"})
    run = _read(table, tmp_path / "log.csv")[1]
    np.testing.assert_allclose(run.channels["x"], NORTH, rtol=1e-3, atol=0.01)
    north = pl.DataFrame({"t": T, "lat": SOUTH, "ns": "N", "lon": WEST, "ew": "E"})
    run = _read(north, tmp_path / "north.csv")[1]
    np.testing.assert_allclose(run.channels["x"], -NORTH, rtol=1e-3, atol=0.01)


def test_a_state_of_one_letter_is_no_hemisphere(tmp_path: Path) -> None:
    """The mode of an autopilot behind a latitude, with no such column behind the longitude."""
    table = pl.DataFrame({"t": T, "lon": -WEST, "lat": SOUTH, "mode": "S"})
    run = _read(table, tmp_path / "log.csv")[1]
    np.testing.assert_allclose(run.channels["x"], -NORTH, rtol=1e-3, atol=0.01)


@pytest.mark.parametrize(
    "names",
    [
        ("Latitudine", "Longitudine"),
        ("latitud", "longitud"),
        ("Latitude (deg)", "Longitude (deg)"),
        ("Breite [°]", "Länge [°]"),
        ("Breitengrad", "Laengengrad"),
    ],
)
def test_latitude_and_longitude_in_other_languages(tmp_path: Path, names: tuple[str, str]) -> None:
    table = pl.DataFrame({"t": T, names[0]: -SOUTH, names[1]: -WEST})
    run = _read(table, tmp_path / "log.csv")[1]
    np.testing.assert_allclose(run.channels["x"], NORTH, rtol=1e-3, atol=0.01)
    np.testing.assert_allclose(run.channels["y"], EAST, rtol=1e-3, atol=0.01)


@pytest.mark.parametrize(("away", "asked"), [(1e-3, True), (1e-5, False)])
def test_the_place_of_another_vehicle_is_a_question_and_a_second_receiver_none(
    tmp_path: Path, away: float, *, asked: bool
) -> None:
    table = {"t": T, "lat_1": -SOUTH, "lon_1": -WEST, "lat_2": -SOUTH + away, "lon_2": -WEST}
    guessed, run = _read(pl.DataFrame(table), tmp_path / "log.csv")
    questions = [q for q in guessed.asked if "which are those of the vehicle?" in q]
    assert bool(questions) is asked
    assert all("lat_1 and lon_1 give the place; so do lat_2 and lon_2, 111 m away" in q for q in questions)
    np.testing.assert_allclose(run.channels["x"], NORTH, rtol=1e-3, atol=0.01)


def test_a_latitude_goes_with_the_longitude_of_the_same_name() -> None:
    assert latitude_and_longitude(["lon_b", "lat_a", "lat_b", "lon_a"]) == ("lat_a", "lon_a")
    assert latitude_and_longitude(["lat", "gps_lon"]) == ("lat", "gps_lon")
    assert latitude_and_longitude(["origin_lat", "origin_lon", "lat", "lon"]) == ("lat", "lon")


def test_letters_are_no_ignored_columns_of_a_mapping_that_is_given(tmp_path: Path) -> None:
    columns = {"t": T, "lat": SOUTH, "ns": "S", "lon": WEST, "ew": "W", "u": 1.0 + 0.1 * np.sin(T)}
    pl.DataFrame(columns).write_csv(tmp_path / "log.csv")
    given = {"columns": {"u": {"channel": "u", "unit": "m/s"}}, "ignore": ["lat", "lon"]}
    run = read_log(tmp_path / "log.csv", LogMapping.model_validate(given))
    assert not any("columns not used" in note for note in run.notes)


@pytest.mark.parametrize(("away", "asked"), [(80.0, True), (0.3, False)])
def test_positions_of_several_vehicles_are_a_question(tmp_path: Path, away: float, *, asked: bool) -> None:
    table = {"t": T, "x_1": 0.9 * T, "y_1": 0.2 * T, "x_2": 0.9 * T + away, "y_2": 0.2 * T}
    questions = [q for q in _read(pl.DataFrame(table), tmp_path / "log.csv")[0].asked if "which are" in q]
    assert bool(questions) is asked
    assert all("x_1 and y_1 give the place; so do x_2 and y_2: which are those" in q for q in questions)
