"""`undertow map new`: a first mapping file for a log, from names, units, ranges and what the motion says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from undertow.cli.main import main
from undertow.identification.logs.guess import Name, guess_mapping
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.reading import read_log
from undertow.model.loading import load_vehicle

DEGREES = 180 / np.pi


def _read(case: Path, log: str) -> dict[str, np.ndarray]:
    commands = load_vehicle(case / "usv.toml").command_names
    run = read_log(case / log, read_mapping(case / "log.toml"), commands)
    return {"t": run.t, **run.channels}


def _renamed(case: Path, **columns: pl.Expr) -> None:
    table = pl.read_csv(case / "train.csv")
    kept = load_vehicle(case / "usv.toml").command_names
    table.select(*(e.alias(n) for n, e in columns.items()), *kept).write_csv(case / "own.csv")


def test_names_units_and_ranges_are_understood(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _renamed(
        case,
        **{
            "timestamp": 1.6e12 + 1000 * pl.col("t"),
            "North [m]": pl.col("x"),
            "east_mm": 1000 * pl.col("y"),
            "Heading": (DEGREES * pl.col("psi")) % 360,
            "surgeVelocity_kn": pl.col("u") / 0.514444,
            "v_des_mps": 0 * pl.col("u"),
            "v_meas_mps": pl.col("v"),
            "yawRate": DEGREES * pl.col("r"),
            "note": pl.lit("calm"),
        },
    )
    assert main(["map", "new", "own.csv", "--vehicle", "usv.toml", "--out", "log.toml"]) == 0
    found, true = _read(case, "own.csv"), read_log(case / "train.csv")
    np.testing.assert_allclose(found["t"] - found["t"][0], true.t - true.t[0], atol=1e-3)
    for name in ("x", "y", "u", "v", "r"):
        np.testing.assert_allclose(found[name], true.channels[name], atol=1e-4 * np.ptp(true.channels[name]))
    turn = found["psi"] - true.channels["psi"]
    np.testing.assert_allclose(turn, 2 * np.pi * round(turn[0] / (2 * np.pi)), atol=1e-6)
    out = capsys.readouterr().out
    assert "timestamp: 50 from row to row: that is 20 rows a second if it is in ms; is it?" in " ".join(
        out.split()
    )
    text = (case / "log.toml").read_text()
    assert '"v_des_mps"' in text.partition("[time]")[0], "what was wanted is left out"
    assert '"note"' in text.partition("[time]")[0]


@pytest.mark.parametrize(
    ("columns", "frames"),
    [
        ({}, {"position": "NED", "body": "FRD"}),
        (
            {"x": pl.col("y"), "y": pl.col("x")},
            {"position": "ENU", "body": "FRD", "attitude": "NED"},
        ),
        ({"v": -pl.col("v")}, {"position": "NED", "body": "FLU", "attitude": "NED"}),
        (
            {
                "u": pl.col("u") * pl.col("psi").cos() - pl.col("v") * pl.col("psi").sin(),
                "v": pl.col("u") * pl.col("psi").sin() + pl.col("v") * pl.col("psi").cos(),
            },
            {"position": "NED", "body": "FRD", "velocity": "NED"},
        ),
    ],
)
def test_axes_are_those_in_which_position_and_velocity_agree(
    case: Path, columns: dict[str, pl.Expr], frames: dict[str, str]
) -> None:
    plain = {name: pl.col(name) for name in ("t", "x", "y", "psi", "u", "v", "r")}
    _renamed(case, **{**plain, **columns})
    guessed = guess_mapping(case / "own.csv")
    assert guessed.axes.entry == frames
    assert "Hence these axes" in guessed.axes.questions[0]


def test_a_flag_tells_a_sensor_that_is_slower_than_its_log(case: Path) -> None:
    table = pl.read_csv(case / "train.csv").with_row_index("k")
    held = pl.when(pl.col("k") % 8 == 0).then(pl.col("u")).forward_fill().alias("u")
    flag = (pl.col("k") % 8 == 0).cast(pl.Int8).alias("dvl_new")
    table.with_columns(held, flag).drop("k").write_csv(case / "own.csv")
    guessed = guess_mapping(case / "own.csv")
    (entry,) = [g.entry for g in guessed.columns if g.channel == "u"]
    assert entry["fresh"] == "dvl_new"
    assert not [g for g in guessed.columns if g.channel == "v" and "fresh" in g.entry]


def test_what_cannot_be_known_is_asked(case: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = {name: pl.col(name) for name in ("t", "psi", "u")}
    off = pl.when(pl.col("t") < 1.0).then(0.0)  # no pulse before the vehicle is armed
    _renamed(case, **plain, pwm_bow=off.otherwise(1500 + 300 * pl.col("u").sin()))
    (case / "own.csv").write_text((case / "own.csv").read_text().replace(",", ";"))
    assert main(["map", "new", "own.csv", "--out", "log.toml"]) == 0
    text = (case / "log.toml").read_text()
    assert 'delimiter = ";"' in text
    assert "# ? pulses from" in text
    assert "scale = 0.0025, offset = -3.75, off = 0.0" in text
    assert "are not both logged" in text
    read_mapping(case / "log.toml")
    assert main(["map", "new", "own.csv", "--out", "log.toml"]) == 2
    assert "exists already" in capsys.readouterr().err


def test_a_table_without_a_clock_is_refused_in_one_line(
    case: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (case / "own.csv").write_text("u,v\n1,2\n0,1\n1,1\n")
    assert main(["map", "new", "own.csv", "--out", "log.toml"]) == 2
    assert "no column counts the time" in capsys.readouterr().err
    assert not (case / "log.toml").exists()


@pytest.mark.parametrize(
    ("column", "channel", "unit"),
    [
        ("N_meas_m", "x", "m"),
        ("gyro_z [rad/s]", "r", "rad/s"),
        ("roll_rate_dps", "p", "deg/s"),
        ("vel.y", "v", ""),
        ("depth", "z", ""),
        ("psi_des_rad", "", "rad"),
        ("acc_x", "", ""),
        ("u1", "", ""),
    ],
)
def test_a_name_is_taken_apart(column: str, channel: str, unit: str) -> None:
    name = Name.of(column)
    assert (name.motion(), name.unit) == (channel, unit)
