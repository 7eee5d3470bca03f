"""The axes of a log without a velocity, by the course of a vehicle that goes where its heading points."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from undertow.identification.logs.guess import guess_table
from undertow.identification.logs.guess_frames import GuessedMapping
from undertow.identification.logs.reading import read_log

T = np.arange(0.0, 120.0, 0.1)
PSI = 0.4 + 1.5 * np.sin(0.05 * T) + 0.4 * np.sin(0.31 * T)
"""Heading clockwise from north, rad."""


def _log(names: str, heading: np.ndarray, drift: float = 0.0) -> pl.DataFrame:
    """A vehicle at 1.5 m/s; its columns of the way to the north and to the east have these names."""
    way = np.cumsum(0.15 * np.exp(1j * (PSI + drift)))
    north, east = names.split()
    rng = np.random.default_rng(3)
    noisy = {
        name: values + 0.02 * rng.normal(size=len(T))
        for name, values in ((north, way.real), (east, way.imag))
    }
    return pl.DataFrame({"t": T, **noisy, "heading_rad": heading})


def _asked(guessed: GuessedMapping) -> str:
    return " ".join(guessed.axes.questions)


@pytest.mark.parametrize(
    ("names", "compass", "axes"),
    [
        ("x_m y_m", True, {"position": "NED", "body": "FRD"}),
        ("northing_m easting_m", True, {"position": "NED", "body": "FRD"}),
        ("y_m x_m", True, {"position": "ENU", "body": "FRD", "attitude": "NED"}),
        ("northing_m easting_m", False, {"position": "NED", "body": "FRD"}),
    ],
)
def test_the_course_shows_the_axes(names: str, compass: bool, axes: dict[str, str]) -> None:
    """Names that say north and east are believed, and then leave no doubt how the heading grows."""
    guessed = guess_table(_log(names, PSI if compass else np.pi / 2 - PSI), Path("log.csv"))
    assert guessed.axes.entry == axes
    assert ("clockwise seen from above" in _asked(guessed)) == (names == "x_m y_m")
    assert ("anticlockwise?" in _asked(guessed)) == (not compass)


def test_what_is_asked_of_a_heading_that_grows_the_other_way_puts_it_right(tmp_path: Path) -> None:
    table = _log("northing_m easting_m", np.pi / 2 - PSI)
    table.write_csv(tmp_path / "log.csv")
    meaning = guess_table(table, Path("log.csv")).meaning
    columns = {
        name: column.model_copy(update={"channel": {"x": "y", "y": "x"}.get(column.channel, column.channel)})
        for name, column in meaning.columns.items()
    }
    frames = meaning.frames.model_copy(update={"position": "ENU", "attitude": "ENU"})
    run = read_log(tmp_path / "log.csv", meaning.model_copy(update={"columns": columns, "frames": frames}))
    np.testing.assert_allclose(np.cos(run.channels["psi"] - PSI), 1.0, atol=1e-9)
    np.testing.assert_allclose(run.channels["x"], table["northing_m"].to_numpy())


@pytest.mark.parametrize("drift", [np.pi / 2, np.pi])
def test_a_vehicle_that_goes_elsewhere_shows_no_axes(drift: float) -> None:
    assert "not decisive" in _asked(guess_table(_log("x_m y_m", PSI, drift), Path("log.csv")))
