"""The deviation of a compass: found in velocities that it turned, told from current, wind and turning."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.cli.bad import text_of
from undertow.errors import UndertowError
from undertow.identification.doctor.compass import Deviation, deviation
from undertow.identification.doctor.examine import examine
from undertow.identification.logs.mapping import LogMapping, edited, read_edits
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.reading import read_log
from undertow.identification.logs.run import Run, with_heading_corrected
from undertow.model.loading import load_vehicle
from undertow.typing import Array

IRON = (0.0, np.radians(2.0), np.radians(8.0))
NONE = (0.0, 0.0, 0.0)
Sideways = Callable[[Array, Array, Array], Array]
"""From true heading, speed and rate of turn to the sideways velocity."""


def _at_rest(psi: Array, u: Array, r: Array) -> Array:
    return np.zeros_like(psi)


def _turning(psi: Array, u: Array, r: Array) -> Array:
    """A hull that skids in turns, with a log ahead of its pivot."""
    return -0.4 * u * r + 0.1 * r


def _current(psi: Array, u: Array, r: Array) -> Array:
    return 0.3 * np.cos(psi - 1.0)


def _wind(psi: Array, u: Array, r: Array) -> Array:
    """A boat that drifts across the wind at rest, and less the faster water flows past its keel."""
    return 0.3 * np.cos(psi - 1.0) / (1.0 + 1.5 * np.abs(u))


def _boat(
    iron: tuple[float, float, float], *sideways: Sideways, seed: int = 1, steady: bool = False
) -> dict[str, Array]:
    """Columns of a boat that is steered by hand for five minutes, as the compass shows them."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 300.0, 0.1)
    u = np.full_like(t, 1.5) if steady else 0.8 + 0.9 * np.sin(0.21 * t + seed)
    shown = np.cumsum(0.1 * (0.15 * np.sin(0.11 * t) + 0.12 * np.sin(0.31 * t + 2.0 * seed)))
    more = iron[0] + iron[1] * np.sin(shown) + iron[2] * np.cos(shown)
    psi = shown + more
    r = np.gradient(psi, t)
    v = sum(part(psi, u, r) for part in sideways)
    east_north = np.exp(1j * psi) * (u + 1j * v)
    place = np.cumsum(0.1 * east_north)
    turned = np.exp(-1j * shown) * east_north + 0.01 * (
        rng.normal(size=len(t)) + 1j * rng.normal(size=len(t))
    )
    commands = {"port": 40.0 * u + 30.0 * r, "starboard": 40.0 * u - 30.0 * r}
    motion = {"x": place.real, "y": place.imag, "psi": shown, "u": turned.real, "v": turned.imag, "r": r}
    return {"t": t, **motion, **commands, "true_psi": psi, "true_v": np.asarray(v)}


def _run(columns: dict[str, Array]) -> Run:
    channels = {n: c for n, c in columns.items() if n != "t" and not n.startswith("true")}
    return Run("boat", columns["t"], channels)


def _found(*columns: dict[str, Array]) -> Deviation | None:
    return deviation(load_vehicle("otter"), [_run(c) for c in columns])


@pytest.mark.parametrize("others", [(_at_rest,), (_turning,), (_current,), (_turning, _current)])
def test_the_deviation_is_found_whatever_else_moves_the_boat_sideways(others: tuple[Sideways, ...]) -> None:
    found = _found(_boat(IRON, *others))
    assert found is not None
    assert np.degrees(found.value) == pytest.approx([2.0, 8.0], abs=0.4)


def test_runs_in_other_currents_share_the_compass() -> None:
    other = _boat(IRON, lambda psi, u, r: 0.4 * np.sin(psi), seed=5)
    found = _found(_boat(IRON, _current, seed=3), other)
    assert found is not None
    assert np.degrees(found.value) == pytest.approx([2.0, 8.0], abs=0.4)


@pytest.mark.parametrize("others", [(_turning,), (_current,), (_wind,), (_turning, _wind, _current)])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_what_moves_a_boat_by_its_heading_is_no_deviation(others: tuple[Sideways, ...], seed: int) -> None:
    assert _found(_boat(NONE, *others, seed=seed)) is None


def test_at_a_constant_speed_a_current_does_the_same_as_a_deviation() -> None:
    assert _found(_boat(IRON, _at_rest, steady=True)) is None
    assert _found(_boat(NONE, _current, steady=True)) is None


def test_two_degrees_are_what_a_compass_may_have() -> None:
    small = (0.0, np.radians(0.5), np.radians(1.5))
    assert _found(_boat(small, _turning)) is None


@pytest.mark.parametrize(("iron", "found"), [(20.0, True), (55.0, False)])
def test_no_iron_turns_a_compass_by_a_radian(iron: float, found: bool) -> None:
    columns = _boat((0.0, 0.0, np.radians(iron)), _at_rest)
    assert (_found(columns) is not None) is found


@pytest.mark.parametrize(("across", "certain"), [(1.0, True), (16.0, False)])
def test_headings_within_a_sector_tell_no_deviation_from_a_turned_sensor(
    across: float, certain: bool
) -> None:
    """Certain for the headings of the log, and as uncertain as it is large for all others."""
    along = np.array([[0.9, -0.44], [0.44, 0.9]])
    covariance = along @ np.diag(np.radians([0.4, across]) ** 2) @ along.T
    assert Deviation(np.radians([16.9, 9.1]), covariance, 0.5, derived=True).is_certain is certain


def test_the_doctor_says_it_and_its_lines_mend_the_log(tmp_path: Path) -> None:
    columns = {n: c[::3] for n, c in _boat(IRON, _turning, _current).items()}
    path = tmp_path / "boat.csv"
    path.write_text(text_of({n: c for n, c in columns.items() if not n.startswith("true")}))
    vehicle = load_vehicle("otter")
    run = read_log(path, channels=vehicle.command_names)
    (finding,) = [f for f in examine(vehicle, [run]).result.findings if f.id == "compass_deviation"]
    assert finding.severity == "mistake"
    mapping = edited(LogMapping(), read_edits(finding.mapping))
    assert mapping.compass is not None
    assert mapping.compass.velocities
    mended = read_log(path, mapping, vehicle.command_names)
    assert mended.channels["psi"] == pytest.approx(columns["true_psi"], abs=0.01)
    assert mended.channels["v"] == pytest.approx(columns["true_v"], abs=0.06)
    assert deviation(vehicle, [mended]) is None


def test_velocities_of_the_pose_follow_a_corrected_heading() -> None:
    run = _run(_boat(IRON, _turning)).without(("u", "v", "r"))
    vehicle = load_vehicle("otter")
    found = deviation(vehicle, [velocities_from_pose(run, vehicle.degrees_of_freedom)])
    assert found is not None
    assert found.derived
    edits = found.edits(LogMapping())
    assert {e.key for e in edits} == {"B", "C"}


@pytest.mark.parametrize("dead", ["u", "v", "psi"])
def test_a_channel_that_never_changes_shows_no_deviation(dead: str) -> None:
    columns = _boat(IRON, _turning)
    assert _found({**columns, dead: np.zeros_like(columns["t"])}) is None


def test_too_few_samples_show_no_deviation() -> None:
    assert _found({n: c[:5] for n, c in _boat(IRON, _turning).items()}) is None


# --- the mapping file -------------------------------------------------------------------------------------
def _compass(**entries: object) -> LogMapping:
    return LogMapping.model_validate({"compass": {"A": "1 deg", "B": "2 deg", "C": "8 deg", **entries}})


def _read(tmp_path: Path, mapping: LogMapping, columns: dict[str, Array]) -> Run:
    path = tmp_path / "log.csv"
    path.write_text(text_of(columns))
    return read_log(path, mapping)


_SHOWN = np.radians([0.0, 90.0, 180.0, 260.0])
_MORE = np.radians(1.0 + 2.0 * np.sin(_SHOWN) + 8.0 * np.cos(_SHOWN))


def test_the_deviation_is_added_to_the_heading_and_turns_velocities(
    tmp_path: Path,
) -> None:
    columns = {"t": np.arange(4.0), "psi": _SHOWN, "u": np.full(4, 2.0), "v": np.full(4, 0.5)}
    plain = _read(tmp_path, _compass(), columns)
    assert plain.channels["psi"] == pytest.approx(_SHOWN + _MORE)
    assert plain.channels["v"] == pytest.approx(0.5)
    turned = _read(tmp_path, _compass(velocities=True), columns)
    over_ground = (2.0 + 0.5j) * np.exp(1j * _SHOWN)
    along = over_ground * np.exp(-1j * (_SHOWN + _MORE))
    assert turned.channels["u"] == pytest.approx(along.real)
    assert turned.channels["v"] == pytest.approx(along.imag)
    assert any("deviation of the compass, 1 + 2 sin psi + 8 cos psi deg" in note for note in turned.notes)


def test_velocities_along_the_earth_are_turned_by_the_corrected_heading(tmp_path: Path) -> None:
    columns = {"t": np.arange(4.0), "psi": _SHOWN, "u": np.full(4, 2.0), "v": np.full(4, 0.5)}
    spec = _compass(velocities=True).model_dump(exclude_defaults=True) | {"frames": {"velocity": "NED"}}
    run = _read(tmp_path, LogMapping.model_validate(spec), columns)
    along = (2.0 + 0.5j) * np.exp(-1j * (_SHOWN + _MORE))
    assert run.channels["u"] == pytest.approx(along.real)
    assert run.channels["v"] == pytest.approx(along.imag)


def test_a_heading_that_jumps_is_corrected_before_and_after_its_jump(tmp_path: Path) -> None:
    whole = np.linspace(6.0, 7.0, 12)
    columns = {"t": np.arange(12.0), "psi": np.mod(whole, 2 * np.pi)}
    run = _read(tmp_path, _compass(), columns)
    more = np.radians(1.0 + 2.0 * np.sin(whole) + 8.0 * np.cos(whole))
    assert run.channels["psi"] == pytest.approx(whole + more)
    assert np.mod(run.wrapped["psi"], 2 * np.pi) == pytest.approx(np.mod(whole + more, 2 * np.pi))


def test_a_deviation_needs_a_heading_and_angles(tmp_path: Path) -> None:
    with pytest.raises(UndertowError, match=r"channel, which \[compass\] corrects, 'psi'"):
        _read(tmp_path, _compass(), {"t": np.arange(3.0), "u": np.ones(3)})
    with pytest.raises(UndertowError, match="compass: B: "):
        _read(tmp_path, _compass(B="2 m"), {"t": np.arange(3.0), "psi": np.ones(3)})


def test_a_second_deviation_is_added_to_the_first() -> None:
    mapping = LogMapping.model_validate(tomllib.loads('[compass]\nB = "1 deg"\nvelocities = true'))
    found = Deviation(np.radians([2.0, 8.0]), np.diag([1e-6, 1e-6]), 0.6, derived=False)
    mended = edited(mapping, found.edits(mapping)).compass
    assert mended is not None
    assert np.degrees(mended.coefficients) == pytest.approx([0.0, 3.0, 8.0])


def test_a_run_without_a_heading_stays_as_it_is() -> None:
    columns = {"u": np.ones(3)}
    assert with_heading_corrected(columns, IRON, velocities=True) == columns
    run = replace(_run(_boat(NONE, _turning)), wrapped={})
    assert deviation(load_vehicle("otter"), [run.without(("psi",))]) is None
