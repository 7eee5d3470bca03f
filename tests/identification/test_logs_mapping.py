"""Mapping files: strict, told in one line, and the frames they ask for."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from undertow.errors import UndertowError
from undertow.identification.logs import mapping
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import FORCES
from undertow.model.symbols import POSE, VELOCITY

TOP = 'schema = "undertow/mapping/1"\n'
EXAMPLES = Path(__file__).parents[2] / "examples"
DEMO_DATA = Path(__file__).parents[2] / "src" / "undertow" / "demo_data"


@pytest.fixture
def read(tmp_path):
    """Return a function that writes a mapping file and reads it."""

    def reader(text):
        path = tmp_path / "log.toml"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_mapping(path)

    return reader


def test_short_and_long_columns_mean_the_same(read):
    short, long = read(TOP + 'columns.north = "x"'), read(TOP + '[columns]\nnorth = { channel = "x" }')
    assert short == long
    assert short.columns["north"].channel == "x"
    assert short.time.column == "t"


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["schema None", 'schema = "undertow/mapping/1"'.replace('"', "'")]),
        ('schema = "undertow/vehicle/1"', ["undertow/vehicle/1"]),
        (TOP + "delimeter = ';'", ["key 'delimeter' is not known", "did you mean 'delimiter'?"]),
        (
            TOP + "[time]\nunits = 's'",
            ["key 'time.units' is not known", "did you mean 'unit'?", "column, unit, nanoseconds, offset"],
        ),
        (TOP + "[frames]\nposition = 'NWU'", ["frames.position", "'NWU'", "'NED' or 'ENU'"]),
        (
            TOP + "[columns]\na = {chanel = 'x'}",
            ["key 'columns.a.chanel' is not known", "did you mean 'channel'?"],
        ),
        (TOP + "[columns]\na = {unit = 'm'}", ["'columns.a.channel' is missing: add it"]),
        (TOP + "[columns]\na = {channel = 'x', scale = nan}", ["columns.a.scale", "finite"]),
        (TOP + "[columns]\na = 3", ["columns.a"]),
        (TOP + "[columns]\na = 'x'\nb = 'x'", ["'a' and 'b' both become channel 'x'"]),
        (TOP + "missing_commands = 'guess'", ["missing_commands", "'guess'", "'hold'"]),
        (TOP + "delimiter = 'ab'", ["delimiter"]),
        (TOP + "[time", ["not valid TOML"]),
        (TOP + f"[time]\nevery = {2**63 - 1}", ["time.every", "less than or equal to 1000000"]),
        (TOP + f"[time]\nevery = {2**63}", ["time.every is an integer of 64 bits"]),
        (TOP.encode() + b"# \xff", ["not UTF-8"]),
        (TOP + "ignore = " + "[" * 5000, ["nested too deeply"]),
    ],
)
def test_bad_mappings_are_one_clear_line(read, text, parts):
    with pytest.raises(UndertowError) as caught:
        read(text)
    message = str(caught.value)
    assert "\n" not in message
    for part in ["log.toml", *parts]:
        assert part in message, message


def test_a_mapping_that_is_not_there(tmp_path):
    with pytest.raises(UndertowError, match="No such file"):
        read_mapping(tmp_path / "none.toml")


PLACE = "position = 'ENU'\nbody = 'FRD'\nattitude = 'NED'"


@pytest.mark.parametrize(
    ("column", "frames", "sigma"),
    [
        ("{ channel = 'x', noise = '2 cm' }", "", {"x": 0.02}),
        ("{ channel = 'x', unit = 'mm', noise = 5 }", "", {"x": 0.005}),
        ("{ channel = 'x', noise = '2 cm' }", f"[frames]\n{PLACE}", {"y": 0.02}),
        ("{ channel = 'psi', unit = 'deg', noise = '1 deg' }", "", {"psi": np.pi / 180}),
        ("'x'", "", {}),
    ],
)
def test_the_noise_of_a_sensor_is_stated_in_any_unit(read, tmp_path, column, frames, sigma):
    log = tmp_path / "log.csv"
    log.write_text("t,a\n0,1\n1,2\n2,4\n")
    run = read_log(log, read(f"{TOP}[columns]\na = {column}\n{frames}"))
    assert run.sigma == pytest.approx(sigma)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("[columns]\na = { channel = 'x', noise = '2 s' }", "noise of column 'a': '2 s' has the dimension"),
        ("[columns]\na = { channel = 'x', noise = 0 }", "noise of column 'a' is '0.0 m': give a value"),
        ("[columns]\na = 'x'\n[disturbance]\nX = '2 m'", "disturbance X: '2 m' has the dimension"),
    ],
)
def test_a_noise_or_disturbance_that_is_none_is_refused(read, tmp_path, text, complaint):
    log = tmp_path / "log.csv"
    log.write_text("t,a\n0,1\n1,2\n2,4\n")
    with pytest.raises(UndertowError, match=re.escape(complaint)):
        read_log(log, read(TOP + text))


@pytest.mark.parametrize("folder", [EXAMPLES / "cse1", DEMO_DATA / "cfd-surge"])
def test_the_mappings_that_are_shipped_are_valid(folder):
    assert read_mapping(folder / "log.toml").columns


@given(arrays(float, (len(POSE + VELOCITY + FORCES), 4), elements=st.floats(-100, 100)))
def test_turning_frames_twice_changes_nothing(values):
    channels = dict(zip(POSE + VELOCITY + FORCES, values, strict=True))
    for turn in (mapping.swap_position, mapping.swap_attitude, mapping.swap_body):
        twice = turn(turn(channels))
        assert twice.keys() == channels.keys()
        for name, data in channels.items():
            np.testing.assert_allclose(twice[name], data, atol=1e-13)


def _rotation(phi, theta, psi):
    (cf, sf), (ct, st_), (cp, sp) = ((np.cos(a), np.sin(a)) for a in (phi, theta, psi))
    about_x = np.array([[1, 0, 0], [0, cf, -sf], [0, sf, cf]])
    about_y = np.array([[ct, 0, st_], [0, 1, 0], [-st_, 0, ct]])
    return np.array([[cp, -sp, 0], [sp, cp, 0], [0, 0, 1]]) @ about_y @ about_x


@given(st.floats(-3, 3), st.floats(-1.5, 1.5), st.floats(-3, 3))
def test_the_attitude_is_the_same_rotation_seen_from_other_axes(phi, theta, psi):
    turned = mapping.swap_attitude({"phi": np.array(phi), "theta": np.array(theta), "psi": np.array(psi)})
    ned_of_enu = np.array([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
    expected = ned_of_enu @ _rotation(phi, theta, psi) @ np.diag([1, -1, -1])
    actual = _rotation(*(float(turned[name]) for name in ("phi", "theta", "psi")))
    np.testing.assert_allclose(actual, expected, atol=1e-12)


def _attitude_and_velocity(rng):
    angles = dict(zip(("phi", "theta", "psi"), rng.uniform(-1, 1, (3, 5)), strict=True))
    return angles, rng.normal(size=(3, 5))


@pytest.mark.parametrize("axes", ["NED", "ENU"])
def test_velocities_along_the_earth_become_body_velocities(axes):
    angles, body = _attitude_and_velocity(np.random.default_rng(1))
    ned = np.array([_rotation(*(a[i] for a in angles.values())) @ body[:, i] for i in range(5)]).T
    given = ned if axes == "NED" else np.array([ned[1], ned[0], -ned[2]])
    turned = mapping.velocity_to_body({**angles, **dict(zip("uvw", given, strict=True))}, axes)
    np.testing.assert_allclose([turned[n] for n in "uvw"], body, atol=1e-12)
    level = {name: angles[name] for name in ("psi",)} | dict(zip("uv", given, strict=False))
    assert "w" not in mapping.velocity_to_body(level, axes)


def test_the_velocity_of_the_water_is_added_along_the_earth():
    angles, body = _attitude_and_velocity(np.random.default_rng(2))
    found = mapping.over_ground({**angles, **dict(zip("uvw", body, strict=True))}, (0.3, -0.2, 0.1))
    for i in range(5):
        moved = _rotation(*(a[i] for a in angles.values())) @ [
            found[n][i] - body[k, i] for k, n in enumerate("uvw")
        ]
        np.testing.assert_allclose(moved, [0.3, -0.2, 0.1], atol=1e-12)
