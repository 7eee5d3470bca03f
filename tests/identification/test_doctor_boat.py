"""The doctor on a boat whose file has no sway: positions, speed and course of a satellite receiver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from undertow.identification.doctor.examine import examine
from undertow.identification.doctor.kinematics import SETTINGS, Kinematics
from undertow.identification.doctor.sensors import LATE_COURSE, sensor_fits
from undertow.identification.findings import Finding
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run, with_reports
from undertow.identification.report.pictures import rates_picture
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

_FILE = """
schema = "undertow/vehicle/1"
name = "boat"
degrees_of_freedom = ["surge", "yaw"]
signs = "magnitudes"
[effects.rigid_body]
m = 70
I_z = 9
[effects.linear_damping]
X_u = { value = 20, estimate = true }
N_r = { value = 9, estimate = true }
[[thrusters]]
name = "port"
position = [0, -0.4, 0]
direction = [1, 0, 0]
[[thrusters]]
name = "starboard"
position = [0, 0.4, 0]
direction = [1, 0, 0]
"""


@pytest.fixture(scope="module")
def boat(tmp_path_factory: pytest.TempPathFactory) -> Vehicle:
    """Surge and yaw, two thrusters."""
    path = tmp_path_factory.mktemp("boat") / "boat.toml"
    path.write_text(_FILE)
    return load_vehicle(path)


def _boat(
    late: float = 0.0, drift: float = 0.0, every: int = 1, seconds: float = 160.0, swing: float = 0.1
) -> Run:
    """A turn of some 110 degrees in which speed and course are `late` s, or the boat drifts by `drift` r.

    Of the position, every so many rows have a new value.
    """
    rng = np.random.default_rng(3)
    fine = np.arange(-20.0, seconds, 0.01)
    u = 0.35 + swing * np.sin(fine / 11)
    psi = 1.4 + 0.95 * np.tanh((fine - seconds / 2) / 25) + 0.1 * np.sin(fine / 5)
    v = drift * np.gradient(psi, fine)
    north, east = u * np.cos(psi) - v * np.sin(psi), u * np.sin(psi) + v * np.cos(psi)
    t = np.arange(0.0, seconds, 0.5)

    def fix(rate: Array) -> Array:
        place = np.interp(t, fine, np.cumsum(rate) * 0.01) + 0.01 * rng.standard_normal(len(t))
        return np.repeat(place[::every], every)[: len(t)]

    pushed = {n: 5 + np.sin(t / k) for n, k in (("port", 7), ("starboard", 9))}
    own = {"psi": np.interp(t - late, fine, psi), "u": np.interp(t - late, fine, u)}
    own = {n: c + 0.003 * rng.standard_normal(len(t)) for n, c in own.items()}
    return velocities_from_pose(
        Run("boat", t, {"x": fix(north), "y": fix(east)} | own | pushed), ("surge", "yaw")
    )


def _findings(boat: Vehicle, run: Run) -> dict[str, Finding]:
    return {f.id: f for f in examine(boat, [run]).result.findings}


def test_surge_and_heading_are_compared_with_north_and_east(boat: Vehicle) -> None:
    """North alone would fit as well to exchanged axes."""
    assert Kinematics([_boat()], boat).rows[:2] == ["x", "y"]
    assert not [f for f in _findings(boat, _boat()).values() if f.severity != "note"]


def test_a_receiver_that_smooths_speed_and_course_explains_most_and_is_no_mistake(boat: Vehicle) -> None:
    late = _boat(late=2.0)
    best = sensor_fits(Kinematics([late], boat), [late])[0]
    assert best.sensor.id == LATE_COURSE
    assert best.value[0] == pytest.approx(2.0, rel=0.1)
    assert not [f for f in _findings(boat, late).values() if f.severity == "mistake"]


def test_a_drift_in_turns_is_said_where_the_vehicle_has_no_sway(boat: Vehicle) -> None:
    found = _findings(boat, _boat(drift=-2.0))
    assert "has no sway in its file" in found["velocity_sensor"].text


def test_wider_test_functions_are_taken_only_while_there_are_some(boat: Vehicle) -> None:
    short = _boat(seconds=60.0)
    assert len(Kinematics([short], boat).rates([short]).pose) >= SETTINGS.fewest


def test_rates_are_drawn_where_a_slow_position_is_read_when_new(boat: Vehicle) -> None:
    examined = examine(boat, [_boat(every=4)])
    assert examined.edits
    titles = [axis.get_title(loc="left") for axis in rates_picture(examined, boat).axes]
    assert [t.split(":")[0] for t in titles] == ["as given", "mistakes corrected"] * 2


def test_repeats_are_seen_among_the_reports_of_a_sensor_on_a_clock_of_its_own(boat: Vehicle) -> None:
    """A receiver logged twice as often as it has a fix, among rows in which it lies on a curve."""
    whole = _boat()
    at = np.arange(len(whole.t)) % 2 == 0
    reports = {n: np.where(at, np.repeat(whole.channels[n][::4], 4)[: len(at)], np.nan) for n in ("x", "y")}
    run = with_reports(replace(whole, reported={n: at for n in reports}), reports)
    found = [f.text for f in examine(boat, [run]).result.findings if f.id == "held_values"]
    assert [text.split(" ")[0] for text in found] == ["x", "y"]
    assert "every 2.0 rows (2 s)" in found[0]


def test_what_a_log_cannot_tell_is_no_number(boat: Vehicle) -> None:
    """A speed that hardly changes leaves its scale and its offset open."""
    assert "agreement" in _findings(boat, _boat())
    assert "agreement" not in _findings(boat, _boat(seconds=60.0, swing=0.0))


def test_commands_beyond_the_limit_that_the_file_states_are_reported(boat: Vehicle) -> None:
    """The model takes such commands as they are: what the thruster does with them is for the owner to say."""
    run = _boat()
    largest = float(np.nanmax(np.abs(run.channels["port"])))
    limited = [replace(t, limit=0.8 * largest if t.name == "port" else 2.0 * largest) for t in boat.thrusters]
    vehicle = replace(boat, thrusters=tuple(limited))
    (found,) = [f for f in examine(vehicle, [run]).result.findings if f.id == "limits_exceeded"]
    beyond = np.abs(run.channels["port"]) > 1.02 * 0.8 * largest
    assert found.evidence == pytest.approx({"share": float(np.mean(beyond)), "limit": 0.8 * largest})
    assert "does not cut them off: port in " in found.text
    assert "starboard" not in found.text
    enough = replace(boat, thrusters=tuple(replace(t, limit=largest) for t in boat.thrusters))
    assert not [f for f in examine(enough, [run]).result.findings if f.id == "limits_exceeded"]
