"""The convention of a heading beside a position without velocities."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.identification.logs_of import run_of
from undertow.identification.doctor import examine as examine_module
from undertow.identification.doctor.dynamics import reversed_commands
from undertow.identification.doctor.headings import heading_findings
from undertow.identification.doctor.mistakes import Explanation
from undertow.identification.findings import Finding
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.model.loading import load_vehicle

DOFS = ("surge", "sway", "yaw")
Columns = dict[str, np.ndarray]


def _log(drift: float = 0.0, turns: float = 2.0) -> Columns:
    """A boat at 1 m/s that weaves to the north-east, its course `drift` rad beside its heading."""
    t = np.arange(0.0, 200.0, 0.5)
    psi = 0.7 + turns * np.sin(0.05 * t)
    course = psi + drift
    x, y = (0.5 * np.cumsum(part) for part in (np.cos(course), np.sin(course)))
    noise = np.random.default_rng(3).normal(size=(3, len(t)))
    return {"t": t, "x": x + 0.01 * noise[0], "y": y + 0.01 * noise[1], "psi": psi + 0.002 * noise[2]}


def _found(columns: Columns, vehicle: str = "bluerov2") -> list[Finding]:
    run = velocities_from_pose(run_of("log", columns), DOFS)
    return list(heading_findings(load_vehicle(vehicle), LogMapping(), [run]))


def test_a_boat_that_moves_where_it_heads_is_read_rightly() -> None:
    assert _found(_log()) == []
    assert _found(_log(drift=0.3)) == []
    assert _found(_log(drift=0.5)) == []


@pytest.mark.parametrize(
    ("wrong", "mapping"),
    [
        (lambda c: {**c, "psi": np.pi / 2 - c["psi"]}, '[frames]\nattitude = "ENU"'),
        (lambda c: {**c, "psi": -c["psi"]}, "scale = -1.0"),
    ],
)
def test_a_mirrored_heading_shows_in_the_course(wrong: Callable[[Columns], Columns], mapping: str) -> None:
    (found,) = _found(wrong(_log()))
    assert found.severity == "warning"
    assert mapping in found.mapping
    assert found.evidence["ahead"] < 0.5
    assert "vehicle moves where it heads only then" in found.text


def test_a_mirrored_position_is_said_to_be_possible_too() -> None:
    (found,) = _found({**_log(), **{n: _log()[o] for n, o in (("x", "y"), ("y", "x"))}})
    assert any("x and y are swapped" in clause for clause in found.alternatives)


def test_a_vehicle_that_moves_sideways_or_on_one_heading_tells_nothing() -> None:
    steady = _log(turns=0.1)
    for columns in (_log(drift=1.5), {**steady, "psi": -steady["psi"]}):
        (found,) = _found(columns)
        assert found.id == "heading_unchecked"
        assert "judged by the fit of the model alone" in found.text


def test_measured_velocities_need_no_course() -> None:
    columns = _log()
    run = run_of(
        "log", {**columns, "u": np.ones(400), "v": np.zeros(400), "r": np.gradient(columns["psi"], 0.5)}
    )
    assert list(heading_findings(load_vehicle("bluerov2"), LogMapping(), [run])) == []


def test_a_boat_that_nothing_pushes_sideways_has_a_heading_that_counts_from_elsewhere() -> None:
    (found,) = _found(_log(drift=-2.6), "otter")
    assert (found.id, found.severity) == ("heading_offset", "warning")
    assert "no command pushes it sideways" in found.text
    offset = float(found.mapping.split("offset = ")[1].split()[0].rstrip(","))
    assert offset == pytest.approx(-2.6, abs=0.02)
    assert "moves astern" in found.alternatives[0]
    assert not _found(_log(drift=1.5), "otter")[0].alternatives


def test_a_boat_on_one_heading_may_drift_with_the_water() -> None:
    (found,) = _found(_log(drift=1.5, turns=0.1), "otter")
    assert found.id == "heading_unchecked"


@pytest.mark.parametrize(("drift", "severity"), [(0.0, "mistake"), (-2.6, "warning")])
def test_commands_are_not_reversed_for_certain_where_the_heading_may_be_off(
    drift: float, severity: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    vehicle = load_vehicle("otter")
    reversed_port = Explanation(reversed_commands(vehicle)[0], "a command is reversed", {})
    monkeypatch.setattr(examine_module._Examiner, "_model_mistake", lambda self, at: reversed_port)
    commands = {n: 50.0 + 20.0 * np.sin(0.05 * _log()["t"]) for n in vehicle.command_names}
    run = velocities_from_pose(run_of("log", {**_log(drift), **commands}), DOFS)
    found = examine_module.examine(vehicle, [run]).result.findings
    one, *_ = [f for f in found if f.id == "reversed_thruster"]
    assert one.severity == severity
    assert one.alternatives == ([] if severity == "mistake" else ["psi is off by -149 degrees"])
