"""The doctor on signs of commands and on clocks: all runs together, and all that does as well."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.hidden_effects import Case, make_case
from tests.identification import broken
from tests.identification.broken import Break
from tests.identification.logs_of import run_of, runs_of, true_vehicle
from tests.quick import first_quick
from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.identification.doctor.clocks import Latency, _confirmed, latencies
from undertow.identification.doctor.dynamics import (
    dynamics_of,
    reversed_commands,
    swapped_commands,
    wiring_mistakes,
)
from undertow.identification.doctor.examine import examine
from undertow.identification.doctor.kinematics import Kinematics
from undertow.identification.doctor.mistakes import Explanation, other_frames
from undertow.identification.doctor.signs import SETTINGS, Signs, by_signs, suspected
from undertow.identification.logs.guess_names import position_axes
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.pose_velocity import velocities_from_pose
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle, vehicle_from_table
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.tables import VehicleTable
from undertow.model.vehicle import Vehicle
from undertow.shape.types import MainDimensions, typed_vehicle


@cache
def _case(name: str) -> Case:
    return make_case(name, ("ocean_current",), 4, duration=60.0, runs=("multisine", "steps", "holdout"))


def _wrong_by_two(case: Case, factor: float, parts: tuple[str, ...]) -> Vehicle:
    """A complete vehicle whose damping, or added mass, was guessed wrongly."""
    vehicle = true_vehicle(case)
    names = [n for n, v in vehicle.values.items() if v.value and n.startswith(parts)]
    return vehicle.with_values(
        {n: replace(vehicle.values[n], value=factor * vehicle.values[n].value) for n in names}
    )


DAMPING = ("X_u", "Y_v", "Z_w", "K_p", "M_q", "N_r")
ADDED_MASS = ("X_udot", "Y_vdot", "Z_wdot", "K_pdot", "M_qdot", "N_rdot")


def _known(vehicle: Vehicle) -> list:  # type: ignore[type-arg]
    return [*swapped_commands(vehicle), *reversed_commands(vehicle)]


def _broken(case: Case, wrong: Break) -> list[Run]:
    return [run_of(name, wrong(columns)) for name, columns in case.runs.items()]


@pytest.mark.parametrize("name", first_quick(["usv", "mini-auv"]))
@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_wrong_damping_and_added_mass_reverse_no_command(name: str, factor: float) -> None:
    case = _case(name)
    for parts in (DAMPING, ADDED_MASS):
        vehicle = _wrong_by_two(case, factor, parts)
        assert Signs(vehicle, runs_of(case)).given.total < SETTINGS.certain**2
        assert by_signs(Signs(vehicle, runs_of(case)), None, lambda v=vehicle: _known(v)) is None  # type: ignore[misc]


@pytest.mark.parametrize(
    ("wrong", "clause"),
    [
        (broken.scaled("f1", by=-1), "command f1 is reversed"),
        (broken.swapped("f2", "f3"), "commands f2 and f3 are swapped"),
    ],
    ids=["reversed", "swapped"],
)
def test_a_wrong_sign_shows_in_all_runs_although_the_model_is_wrong(wrong: Break, clause: str) -> None:
    case = _case("usv")
    vehicle = _wrong_by_two(case, 2.0, DAMPING)
    found = by_signs(Signs(vehicle, _broken(case, wrong)), None, lambda: _known(vehicle))
    assert found is not None
    assert found.mistake.clause == clause
    assert not found.rivals
    assert all(v < 0 for n, v in found.evidence.items() if not n.endswith("error"))


def test_two_propellers_that_only_turn_the_vehicle_leave_open_which_mistake_it_is() -> None:
    """Without surge, two swapped propellers and two reversed ones turn it alike; with surge they do not."""
    vehicle, t = load_vehicle("otter"), np.arange(0.0, 120.0, 0.1)
    port, starboard = vehicle.command_names[:2]
    assert {port, starboard} == {v.name for v in vehicle.thrusters}
    ahead, turn = 20.0 * np.sin(0.3 * t) ** 3, 10.0 * np.sign(np.sin(0.45 * t + 0.2))
    mass = {"u": 85.0, "r": 40.0}

    def run(push: float) -> Run:
        forces = {port: push * ahead + turn, starboard: push * ahead - turn}
        given = {n: np.zeros(len(t)) for n in ("x", "y", "psi", "u", "v", "r")}
        rows = dict(zip(vehicle.degrees_of_freedom, range(len(vehicle.dof_indices)), strict=True))
        for channel, dof in (("u", "surge"), ("r", "yaw")):
            total = sum(
                np.array(th.wrench)[vehicle.dof_indices[rows[dof]]] * forces[th.name]
                for th in vehicle.thrusters
            )
            drag, speed = 2.0, np.zeros(len(t))
            for k in range(len(t) - 1):
                speed[k + 1] = speed[k] + 0.1 * (total[k] / mass[channel] - drag * speed[k] / 4)
            given[channel] = speed + 1e-3 * np.random.default_rng(3).normal(size=len(t))
        return Run("turns", t, given | {port: forces[starboard], starboard: forces[port]})

    found = by_signs(Signs(vehicle, [run(0.0)]), None, lambda: _known(vehicle))
    assert found is not None
    clauses = [m.clause for m in (found.mistake, *found.rivals)]
    assert f"commands {port} and {starboard} are swapped" in clauses
    assert f"commands {port}, {starboard} are reversed" in clauses
    assert all(c in found.text for c in clauses)
    swapped = found.mistake.clause
    other = by_signs(Signs(vehicle, [run(0.0)]), None, lambda: _known(vehicle), lambda m: m.clause != swapped)
    assert other is not None  # what a fit rejects gives way to the next
    assert [m.clause for m in (other.mistake, *other.rivals)] == [c for c in clauses if c != swapped]
    assert swapped not in other.text
    wrong = next(m for m in _known(vehicle) if m.count == 2)
    named = Explanation(wrong, f"{wrong.clause}: undone, much is left", {})
    for given in (None, named):  # whatever a fit found, surge excludes that both are reversed
        sure = by_signs(Signs(vehicle, [run(0.0), run(1.0)]), given, lambda: _known(vehicle))
        assert sure is not None
        assert sure.mistake.clause == f"commands {port} and {starboard} are swapped"
        assert not sure.rivals


def test_a_mistake_that_a_fit_found_is_none_where_the_signs_as_they_are_do_as_well() -> None:
    """Whatever a fit makes of commands that nothing follows, from all signs alike no wiring follows."""
    case = _case("usv")
    vehicle = true_vehicle(case)
    for wrong in reversed_commands(vehicle):
        named = Explanation(wrong, f"{wrong.clause}: undone, much is left", {})
        assert by_signs(Signs(vehicle, runs_of(case)), named, lambda: _known(vehicle)) is None


def test_the_sign_of_a_command_that_rests_is_not_asked_for() -> None:
    case = _case("usv")
    vehicle = true_vehicle(case)
    first, *others = (t.name for t in vehicle.thrusters)
    runs = [replace(r, channels={**r.channels, first: np.zeros(len(r.t))}) for r in runs_of(case)]
    at = dynamics_of(vehicle, runs)
    assert at is not None
    clauses = [m.clause for m in wiring_mistakes(vehicle, at, Kinematics(runs, vehicle), runs, LogMapping())]
    assert f"command {first} is reversed" not in clauses
    assert {f"command {name} is reversed" for name in others} <= {*clauses}


@pytest.mark.parametrize(("logged", "named"), [(10.0, True), (0.1, False)])
def test_commands_that_are_alike_are_not_called_swapped(logged: float, *, named: bool) -> None:
    """Thrusts of 20 N that differ by one percent: what turns the boat the other way is not their wiring."""
    names = ("u", "v", "r", "psi", "port", "starboard")
    text = typed_vehicle("asv", MainDimensions(2.0, 1.08, 0.1341, 55.0), "cat", ("surge", "sway", "yaw"))
    vehicle = vehicle_from_table(VehicleTable.model_validate(tomllib.loads(text)), catalogue())
    t, noise = np.arange(0.0, 120.0, 0.1), np.random.default_rng(3)
    turn = np.sign(np.sin(0.45 * t + 0.2))
    given, said = (np.column_stack([20.0 + k * turn, 20.0 - k * turn]) for k in (-10.0, logged))
    functions = Functions(vehicle)
    x = Simulator(functions).run(np.zeros(6), t, given, np.array(functions.values()))
    measured = x[:, [3, 4, 5, 2]].T + 1e-4 * noise.normal(size=(4, len(t)))
    run = Run("boat", t, dict(zip(names, [*measured, *said.T], strict=True)))
    assert any("swapped" in f.text for f in examine(vehicle, [run]).result.findings) is named


def test_without_a_position_a_mirrored_heading_may_be_exchanged_commands() -> None:
    """A log of speed and heading has no side of its own: what turns the wrong way may be either."""
    names = ("u", "psi", "port", "starboard")
    text = typed_vehicle("asv", MainDimensions(2.0, 1.08, 0.1341, 55.0), "cat", ("surge", "yaw"))
    vehicle = vehicle_from_table(VehicleTable.model_validate(tomllib.loads(text)), catalogue())
    t, noise = np.arange(0.0, 120.0, 0.1), np.random.default_rng(3)
    turn = 10.0 * np.sign(np.sin(0.45 * t + 0.2))
    commands = np.column_stack([20.0 + turn, 20.0 - turn])
    functions = Functions(vehicle)
    x = Simulator(functions).run(np.zeros(4), t, commands, np.array(functions.values()))
    measured = [x[:, 2], -x[:, 1]] + 1e-3 * noise.normal(size=(2, len(t)))
    run = Run("boat", t, dict(zip(names, [*measured, *commands.T], strict=True)))
    result = examine(vehicle, [velocities_from_pose(run, ("surge", "yaw"))]).result
    (mistake,) = result.mistakes
    said = " ".join([mistake.text, *mistake.alternatives])
    assert "commands port and starboard are swapped" in said
    assert "psi has the opposite sign" in said


def _in_gusts(seed: int) -> Run:
    """A light boat that an autopilot steers by its heading, logged anticlockwise."""
    rng, step, n = np.random.default_rng(seed), 0.1, 900
    u, r, psi, gust, thrust, rows = 0.5, 0.0, 0.0, 0.0, np.zeros(2), []
    for k in range(n):
        turn = np.clip(1.5 * (0.8 * np.sign(np.sin(0.03 * k + seed)) - psi) - r, -0.7, 0.7)
        ahead = 0.3 + 0.2 * np.sin(0.05 * k)
        commands = np.array([ahead + turn, ahead - turn])
        rows.append([u, -psi, *commands])
        thrust += step * (12.0 * commands - thrust)
        gust += -step * gust + 7.0 * np.sqrt(step) * rng.normal()
        u += step * (thrust.sum() - 4.0 * u - 10.0 * u * abs(u)) / 35.0
        r += step * (0.36 * (thrust[0] - thrust[1]) + gust - 3.2 * r - 10.0 * r * abs(r)) / 2.5
        psi += step * r
    names = ("u", "psi", "port", "starboard")
    table = np.array(rows) + rng.normal(size=(n, 4)) * [2e-3, 1e-5, 0.0, 0.0]
    run = Run(f"run{seed}", step * np.arange(n), dict(zip(names, table.T, strict=True)))
    return velocities_from_pose(run, ("surge", "yaw"))


def test_a_boat_that_is_lighter_than_its_file_has_no_worse_model_for_that() -> None:
    """Read the wrong way, gusts make it heavy: what is left is small beside the noise that this makes."""
    text = typed_vehicle("asv", MainDimensions(1.35, 0.98, 0.1, 29.0), "cat", ("surge", "yaw"))
    free = "thrust_per_command = { value = 15.0, estimate = true, sigma = 10.0 }"
    text = text.replace('name = "port"', f'name = "port"\n{free}')
    text = text.replace('name = "starboard"', f'name = "starboard"\n{free}')
    vehicle = vehicle_from_table(VehicleTable.model_validate(tomllib.loads(text)), catalogue())
    (mistake,) = examine(vehicle, [_in_gusts(seed) for seed in range(1, 7)]).result.mistakes
    said = " ".join([mistake.text, *mistake.alternatives])
    assert "commands port and starboard are swapped" in said
    assert "psi has the opposite sign" in said


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("x_ned", "y_ned"), "NED"),
        (("lat_m", "lon_m"), "NED"),
        (("pos.north", "pos.east"), "NED"),
        (("x_enu", "y_enu"), "ENU"),
        (("easting", "northing"), "ENU"),
        (("x_ned", "y"), ""),
        (("px", "py"), ""),
    ],
)
def test_a_mirrored_log_whose_names_say_its_axes_needs_one_thing_more_to_be_wrong(
    names: tuple[str, str], said: str
) -> None:
    """A boat with two propellers turns the other way if it is mirrored, or if they are exchanged."""
    columns = {name: {"channel": c} for name, c in zip(names, "xy", strict=True)}
    mapping = LogMapping.model_validate({"columns": columns})
    assert position_axes(mapping) == said
    whole = [m for m in other_frames(mapping, {*POSE, *VELOCITY}) if "ENU and FLU" in m.clause]
    assert [m.count for m in whole] == [2 if said == "NED" else 1]


def test_names_in_a_formula_say_the_axes_too() -> None:
    formulas = {"x": "(lat - 63.4) * 111400", "y": "(column('gps lon') - 10.3) * 49700"}
    assert position_axes(LogMapping.model_validate({"channels": formulas})) == "NED"


def test_the_remedy_for_a_reversed_rudder_is_in_its_own_table() -> None:
    vehicle = load_vehicle("kvlcc2")
    (surface, *_) = vehicle.surfaces
    mistake = next(m for m in reversed_commands(vehicle) if m.clause == f"command {surface.name} is reversed")
    assert mistake.vehicle == f"[[surfaces]] {surface.name}: axis with the opposite sign"


# --- clocks ----------------------------------------------------------------------------------------------
def test_a_lateness_that_makes_the_mismatch_worse_is_not_said() -> None:
    case = _case("usv")
    (columns, *_), vehicle = case.runs.values(), true_vehicle(case)
    runs = [run_of("late", broken.late(0.4, names=("u", "v"))(columns))]
    kinematics = Kinematics(runs, vehicle)
    true = Latency(("u", "v"), ("x", "y"), 0.4, 0.01)
    false = Latency(("psi", "r"), ("x", "y", "u", "v"), 3.4, 0.5)
    assert _confirmed(kinematics, runs, [true, false]) == [true]
    (found,) = [one for one in latencies(kinematics, runs) if one.clear(runs[0].step)]
    assert found.names == ("u", "v")
    assert found.delay == pytest.approx(0.4, abs=0.05)


def test_no_clock_is_late_where_velocities_are_of_another_motion() -> None:
    case = _case("usv")
    (columns, *_), vehicle = case.runs.values(), true_vehicle(case)
    other = {n: column[::-1].copy() if n in ("u", "v", "r") else column for n, column in columns.items()}
    runs = [run_of("other", other)]
    kinematics = Kinematics(runs, vehicle)
    assert np.all(kinematics.mismatch(runs).excess > 1.0)
    delays = np.arange(0.5, 5.0, 0.5)
    said = [_confirmed(kinematics, runs, [Latency(("psi",), ("r",), d, 0.01)]) for d in delays]
    assert not any(said)


@cache
def _minute() -> Case:
    return make_case("usv", (), 4, duration=60.0, runs=("multisine",))


@pytest.mark.parametrize(
    ("early", "names"), first_quick([(True, {"x", "y"}), (False, {"psi", "u", "v", "r"})])
)
def test_commands_say_which_of_two_clocks_is_wrong(early: bool, names: set[str]) -> None:
    """Positions a second early look like all the rest late; only one follows the commands."""
    case = _minute()
    (columns,) = case.runs.values()
    seconds = -1.0 if early else 1.0
    shifted = broken.late(seconds, names=tuple(names))(columns)
    inside = slice(25, -25)
    kept = {n: c[inside] for n, c in shifted.items()}
    result = examine(true_vehicle(case), [run_of("shifted", kept)]).result
    found = [f for f in result.findings if f.id in ("late_velocity", "late_pose")]
    named = {n for n in ("x", "y", "psi", "u", "v", "r") for f in found if f"\n{n} = " in f.mapping}
    assert named == names, [f.text for f in found]
    assert all(abs(f.evidence["delay"] - seconds) < 0.1 for f in found)
    assert not any("precedes the commands" in f.text for f in result.findings)


@pytest.mark.parametrize("seed", first_quick([1, 3]))
def test_a_wiring_that_signs_contradict_short_of_certain_is_doubted(seed: int) -> None:
    """Half a minute of one run: too little to undo anything, too much to say nothing."""
    case = make_case("usv", ("ocean_current",), seed, duration=60.0, runs=("multisine",))
    vehicle, (columns,) = true_vehicle(case), case.runs.values()
    known = _known(vehicle)
    wrong, right = (run_of("half", c) for c in (broken.swapped("f2", "f3")(columns), columns))
    wrong, right = (run.slice(run.t[0] + 20, run.t[0] + 55) for run in (wrong, right))
    assert by_signs(Signs(vehicle, [wrong]), None, lambda: known) is None
    doubt = suspected(Signs(vehicle, [wrong]), lambda: known)
    assert doubt is not None
    assert doubt.mistake.clause == "commands f2 and f3 are swapped"
    assert all(abs(error) < 1.0 for name, error in doubt.evidence.items() if name.endswith("_error"))
    assert suspected(Signs(vehicle, [right]), lambda: known) is None
