"""Trims and linear systems, against the equations of motion, closed forms and the numbers of the paper."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import control as ct
import numpy as np
import pytest
from scipy.linalg import expm

from tests.quick import first_quick
from undertow.codegen import Functions, Simulator
from undertow.control import (
    as_controller,
    as_nlsys,
    close_loop,
    find_trim,
    in_current,
    in_direction,
    linearize,
)
from undertow.control.closed_loop import ClosedLoop, Scenario
from undertow.control.gains import ScheduleTable, load_gains
from undertow.control.linear.analysis import controllability, gramian, margins, minimal, modes, observability
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle


@pytest.fixture(scope="module")
def auv() -> Vehicle:
    return load_vehicle("mini-auv")


@pytest.fixture(scope="module")
def rov() -> Vehicle:
    return load_vehicle("bluerov2")


# --- trims ----------------------------------------------------------------------------------------
def test_thrust_of_a_steady_speed_is_the_drag(auv: Vehicle) -> None:
    trim = find_trim(auv, {"u": 0.5})
    drag = 0.142306 * 0.5 + 5.153776 * 0.25
    assert trim.commands["f2"] == pytest.approx(drag / 2, rel=1e-9)
    assert trim.commands["f2"] == pytest.approx(trim.commands["f4"], rel=1e-12)
    assert trim.commands["f1"] + trim.commands["f3"] == pytest.approx(-14.309872, rel=1e-9)
    assert find_trim(auv, {"u": -0.5}).commands["f2"] == pytest.approx(
        -(0.091036 * 0.5 + 5.868182 * 0.25) / 2, rel=1e-9
    )


def test_a_turn_drifts_as_far_as_sway_damping_lets_it(auv: Vehicle) -> None:
    trim = find_trim(auv, {"u": 0.5, "r": 0.1})
    assert trim.turning
    assert trim.states["v"] == pytest.approx(-(7.5 + 1.630825) * 0.5 * 0.1 / 7.157339, rel=1e-9)


def test_hovering_in_a_current_turns_into_it(auv: Vehicle) -> None:
    trim = find_trim(in_current(auv, 0.2, 0.1))
    assert np.tan(trim.states["psi"]) == pytest.approx(0.5, rel=1e-9)
    speed = np.hypot(0.2, 0.1)
    assert trim.commands["f2"] * 2 == pytest.approx(-(0.091036 * speed + 5.868182 * speed**2), rel=1e-9)


def test_hovering_in_a_current_with_sway_thrust_keeps_the_heading(rov: Vehicle) -> None:
    water = in_current(rov, 0.3, 0.2)
    trim = find_trim(water)
    assert trim.states["psi"] == trim.states["phi"] == trim.states["theta"] == 0.0
    rates = as_nlsys(water).dynamics(0.0, trim.x, trim.u)
    np.testing.assert_allclose(rates, 0.0, atol=1e-9)


def test_commands_may_be_held_instead_of_motions(auv: Vehicle) -> None:
    trim = find_trim(auv, {"f2": 0.5, "f4": 0.45}, free=["r"])
    assert trim.states["r"] < 0 < trim.states["u"]
    rates = as_nlsys(auv, direction=trim.direction).dynamics(0.0, trim.x, trim.u)
    np.testing.assert_allclose(rates[4:], 0.0, atol=1e-9)


def test_attitude_may_be_held(rov: Vehicle) -> None:
    trim = find_trim(rov, {"u": 0.5, "theta": 0.2})
    assert trim.states["w"] == pytest.approx(0.5 * np.tan(0.2), rel=1e-9)  # depth does not change


def test_a_glider_glides_as_its_source_says_once_speed_and_sinking_are_free() -> None:
    """Graver's steady glide: 0.3 m/s along a path 25 degrees down, without a command."""
    with pytest.raises(UndertowError, match="leave one of u, w free"):
        find_trim(load_vehicle("glider"))
    states = find_trim(load_vehicle("glider"), free=("u", "w")).states
    assert np.hypot(states["u"], states["w"]) == pytest.approx(0.3, rel=0.01)
    path = states["theta"] - np.arctan2(states["w"], states["u"])
    assert np.degrees(path) == pytest.approx(-25.0, abs=0.1)


def test_a_dead_band_does_not_hide_the_trim(auv: Vehicle) -> None:
    from undertow.model.effects.thruster_deadband import ThrusterDeadband

    names = [p.name for p in ThrusterDeadband(tuple(t.name for t in auv.thrusters)).parameters]
    sticky = auv.with_effect(ThrusterDeadband, {name: Value(0.3) for name in names})
    trim, ideal = find_trim(sticky), find_trim(auv)
    assert trim.commands["f1"] == pytest.approx(ideal.commands["f1"] - 0.3, abs=0.02)
    assert controllability(linearize(sticky, trim)).missing == ("x", "y", "psi", "u", "v", "r")


@pytest.mark.parametrize("speed", [0.2, 1.0, -0.5])
def test_revolutions_are_found_at_which_a_propeller_balances_the_drag(speed: float) -> None:
    """(1 - t) rho D^4 n^2 (K_T0 + K_T1 J) = |X_u|u|| u^2, J = (1 - w) u/(n D); at rest it has no slope."""
    turns = find_trim(load_vehicle("kvlcc2"), {"u": speed}).commands["propeller"]
    advance = (1 - 0.40) * speed / (turns * 0.216)
    thrust = (1 - 0.22) * 1000 * 0.216**4 * turns**2 * (0.2986 - 0.3307 * advance)
    assert turns * speed > 0
    assert thrust == pytest.approx(35.04 * speed**2, rel=1e-6)


def test_a_flat_part_of_a_thrust_curve_hides_no_trim_and_is_named(tmp_path: Path) -> None:
    """Thrust 4 c beyond a flat part of 0.1: at 0.5 m/s two propellers bear a drag of 16 u |u|."""
    (tmp_path / "t.csv").write_text("command,N\n-1,-4\n-0.1,0\n0,0\n0.5,2\n1,4\n")
    sides = "".join(
        f'[[thrusters]]\nname = "{name}"\nposition = [0, {y}, 0]\ndirection = [1, 0, 0]\ncurve = "t.csv"\n'
        for name, y in (("port", -0.3), ("starboard", 0.3))
    )
    (tmp_path / "boat.toml").write_text(
        'schema = "undertow/vehicle/1"\nname = "boat"\ndegrees_of_freedom = ["surge", "yaw"]\n'
        'signs = "magnitudes"\n[effects.rigid_body]\nm = 30\nI_z = 3\n[effects.linear_damping]\nN_r = 10\n'
        f"[effects.quadratic_damping]\nX_uabsu = 16\n{sides}"
    )
    boat = load_vehicle(str(tmp_path / "boat.toml"))
    ahead = find_trim(boat, {"u": 0.5})
    assert ahead.commands == pytest.approx({"port": 0.5, "starboard": 0.5})
    assert ahead.remarks == ()
    rest = find_trim(boat)
    assert rest.ineffective == ("port", "starboard")
    assert "small changes of port, starboard have no effect here" in rest.remarks[0]


@pytest.mark.parametrize(
    ("held", "free", "words"),
    [
        ({"uu": 0.5}, (), "'uu' is not a velocity, pose or command of 'mini-auv' (did you mean 'u'?)"),
        ({"u": float("nan")}, (), "u = nan is not a value"),
        ({"x": 1.0}, (), "x cannot be held"),
        ({"r": 0.5}, ("r",), "r is both held and free"),
    ],
)
def test_what_is_no_trim_is_refused(auv: Vehicle, held: dict[str, float], free: tuple, words: str) -> None:
    with pytest.raises(UndertowError) as caught:
        find_trim(auv, held, free=free)
    assert words in str(caught.value)


def test_a_command_beyond_its_limit_is_named(auv: Vehicle) -> None:
    weak = replace(auv, thrusters=tuple(replace(t, limit=8.0) for t in auv.thrusters))
    assert find_trim(weak, {"u": 0.5}).commands["f2"] < 8.0
    with pytest.raises(UndertowError, match=r"needs f2 = 10\.\d+, but its limit is 8"):
        find_trim(weak, {"u": 2.0})


def test_a_direction_that_cannot_be_is_refused(auv: Vehicle) -> None:
    for direction in ({"u": 0}, {"k": 1}):
        with pytest.raises(UndertowError, match="give 1 or -1"):
            find_trim(auv, direction=direction)


# --- linear systems -------------------------------------------------------------------------------
MOTIONS = {
    "mini-auv": {"u": 0.5},
    "mini-auv turning": {"u": 0.4, "r": 0.2},
    "bluerov2": {"u": 0.4, "theta": 0.1},
    "bluerov2 turning": {"u": 0.4, "r": 0.3},
    "cybership2": {"u": 0.3},
}


@pytest.mark.parametrize("case", first_quick(MOTIONS, 2))
def test_slopes_are_those_of_the_simulation(case: str) -> None:
    """A second of the nonlinear simulation, started a bit to either side, against exp(A t).

    A bit is very little: across the kink of |v| v the difference errs by as much as the step.
    """
    vehicle, held = load_vehicle(case.partition(" ")[0]), MOTIONS[case]
    trim = find_trim(vehicle, held)
    vehicle = in_direction(vehicle, trim.direction)
    system, functions = linearize(vehicle, trim), Functions(vehicle)
    seconds, h, n = 1.0, 2e-8, len(trim.x)
    starts, commands = [], []
    for i in range(n + len(trim.u)):
        for sign in (1, -1):
            step = np.zeros(n + len(trim.u))
            step[i] = sign * h
            starts.append(trim.x + step[:n])
            commands.append(np.tile(trim.u + step[n:], (2, 1)))
    t, p = np.array([0.0, seconds]), np.array(functions.values())
    ends = Simulator(functions).run(np.array(starts), t, np.array(commands), p, max_step=0.005)[:, -1]
    slopes = ((ends[0::2] - ends[1::2]) / (2 * h)).T
    kept = [functions.state_names.index(name) for name in system.state_labels]
    nu = len(trim.u)
    block = np.block([[system.A, system.B], [np.zeros((nu, len(kept) + nu))]])
    expected = expm(block * seconds)[: len(kept)]
    columns = [*kept, *range(n, n + nu)]
    np.testing.assert_allclose(slopes[np.ix_(kept, columns)], expected, atol=1e-6 * np.abs(expected).max())


def test_names_and_outputs(auv: Vehicle) -> None:
    system = linearize(auv, {"u": 0.5})
    assert isinstance(system, ct.StateSpace)
    assert system.state_labels == ["x", "y", "z", "psi", "u", "v", "w", "r"] == system.output_labels
    assert system.input_labels == ["f1", "f2", "f3", "f4"]
    assert linearize(auv, {"u": 0.5, "r": 0.1}).state_labels == ["z", "psi", "u", "v", "w", "r"]


def test_the_nonlinear_system_is_the_vehicle(rov: Vehicle) -> None:
    system, functions = as_nlsys(rov), Functions(rov)
    random = np.random.default_rng(1)
    x, u = random.normal(size=12), random.normal(size=8)
    expected = functions.dynamics(x, u, functions.values(), 0.0).full().ravel()
    np.testing.assert_allclose(system.dynamics(0.0, x, u), expected, rtol=1e-12)
    np.testing.assert_allclose(system.output(0.0, x, u), x, rtol=1e-12)
    heavy = np.array(functions.values())
    heavy[functions.parameter_names.index("m")] *= 2
    changed = system.dynamics(0.0, x, u, params={"p": heavy})
    np.testing.assert_allclose(changed, functions.dynamics(x, u, heavy, 0.0).full().ravel(), rtol=1e-12)


def test_dead_time_is_approximated_when_asked_for(auv: Vehicle, caplog: pytest.LogCaptureFixture) -> None:
    from undertow.model.effects.actuation_delay import ActuationDelay

    late = auv.with_effect(ActuationDelay, {"delay": Value(0.4)})
    plain = linearize(late, {"u": 0.5})
    assert "act 0.4 s late" in caplog.text
    system = linearize(late, {"u": 0.5}, pade=4)
    assert system.state_labels[:2] == ["late_f1_0", "late_f1_1"]
    assert system.state_labels[-8:] == plain.state_labels
    s = 0.7j
    expected = plain(s)[4, 1] * np.exp(-0.4 * s)
    assert system(s)[4, 1] == pytest.approx(expected, rel=1e-6)


# --- closed loops ---------------------------------------------------------------------------------
@pytest.mark.parametrize(("way", "damping"), [(1, 0.792650), (-1, 0.761194)])
def test_damping_of_the_paper_pd_in_surge(auv: Vehicle, way: int, damping: float) -> None:
    loop = close_loop(auv, load_gains("paper-pd", auv), find_trim(auv, direction={"u": way}))
    (surge,) = [m for m in modes(loop.closed) if m.pole.imag]
    assert set(surge.states) == {"x", "u"}
    assert surge.damping == pytest.approx(damping, abs=5e-7)
    assert surge.frequency == pytest.approx(
        np.sqrt(0.2 / (7.5 + (1.630825 if way > 0 else 1.932838))), rel=1e-9
    )


@pytest.mark.parametrize(("way", "root"), [(1, 0.003198 + 0.038054j), (-1, 0.005482 + 0.038392j)])
def test_the_paper_pid_is_unstable_in_surge(auv: Vehicle, way: int, root: complex) -> None:
    loop = close_loop(auv, load_gains("paper-pid", auv), find_trim(auv, direction={"u": way}))
    (growing,) = [m for m in modes(loop.closed) if not m.stable]
    assert set(growing.states) == {"x", "u", "integral_x"}
    assert growing.pole == pytest.approx(root, abs=7e-7)


def test_margins_say_what_would_make_the_pid_stable(auv: Vehicle) -> None:
    """All gains times k: the border is where Routh's (k k_v + X_u) k_p = M k_i."""
    loop = close_loop(auv, load_gains("paper-pid", auv), find_trim(auv))
    surge = loop.margins["force_surge"]
    assert not surge.stable
    assert surge.delay == 0.0
    assert surge.gain == pytest.approx((9.130825 * 0.0003 / 0.012 - 0.142306) / 0.005, rel=1e-6)
    assert loop.margins["force_yaw"].stable


def test_a_law_keeps_what_the_trim_needs(auv: Vehicle) -> None:
    """In a current the integral carries the drag, and the linear loop has the slope of drag at that speed."""
    water = in_current(auv, 0.3, 0.0)
    trim = find_trim(water)
    loop = close_loop(water, load_gains("paper-pd", water), trim)
    assert trim.states["psi"] == 0.0  # the water comes from astern: the vehicle goes backwards through it
    surge = [m.pole.real for m in modes(loop.closed) if set(m.states) <= {"x", "u"}]
    assert sum(surge) == pytest.approx(-(2 + 0.091036 + 2 * 5.868182 * 0.3) / 9.432838, rel=1e-6)
    assert np.prod(surge) == pytest.approx(0.2 / 9.432838, rel=1e-6)


@pytest.mark.parametrize("name", first_quick(["paper-pd", "paper-pid"]))
def test_the_loop_of_python_control_is_the_compiled_one(auv: Vehicle, name: str) -> None:
    """Sixty seconds of the continuous law, with one set of parameters so that the equations are smooth."""
    vehicle = in_direction(auv, {"u": 1, "w": 1})
    gains = replace(load_gains(name, vehicle), schedule=ScheduleTable(order="together"))
    to = (0.8, 0.3, 0.4, 0.6)
    run = ClosedLoop(gains, vehicle).run(
        Scenario(to=to, duration=60.0, dt=0.002, continuous=True, log_interval=1.0)
    )
    plant, law = as_nlsys(vehicle), as_controller(gains)
    references = [f"{n}_ref" for n in vehicle.pose_names]
    loop = ct.interconnect([plant, law], inputs=references, outputs=plant.output_labels)
    done = ct.input_output_response(
        loop,
        run.t,
        np.tile(np.array(to)[:, None], len(run.t)),
        np.zeros(loop.nstates),
        solve_ivp_method="DOP853",
        solve_ivp_kwargs={"rtol": 1e-12, "atol": 1e-13},
    )
    assert run.t[-1] >= 59.0
    assert abs(run.state["x"][-1] - 0.0) > 0.1  # it has gone somewhere
    for name, values in zip(plant.output_labels, done.outputs, strict=True):
        np.testing.assert_allclose(values, run.state[name], atol=1e-8, err_msg=name)


# --- what a linear system tells -------------------------------------------------------------------
def test_sway_cannot_be_moved_at_rest_but_under_way(auv: Vehicle) -> None:
    rest = controllability(linearize(auv, find_trim(auv)))
    assert (rest.rank, rest.of, rest.missing) == (6, 8, ("y", "v"))
    assert controllability(linearize(auv, {"u": 0.5})).rank == 8


def test_heading_cannot_be_seen_from_rates(auv: Vehicle) -> None:
    plant = linearize(auv, find_trim(auv))
    seen = ct.ss(plant.A, plant.B, plant.C[4:], plant.D[4:], states=plant.state_labels)
    assert observability(seen).missing == ("x", "y", "z", "psi")
    assert observability(plant).rank == 8


def test_gramian_of_a_decay_in_closed_form() -> None:
    a, b = np.diag([-0.5, -20.0]), np.array([[1.0], [2.0]])
    found = gramian(a, b, 30.0)
    np.testing.assert_allclose(found, [[1.0 * (1 - np.exp(-30.0)), 2 / 20.5], [2 / 20.5, 4 / 40]], rtol=1e-9)


def test_margins_of_a_known_loop() -> None:
    """1/(s (s + 1)^2): phase -180 degrees at 1 rad/s, where the gain is a half."""
    found = margins(ct.ss(ct.tf([1.0], [1.0, 2.0, 1.0, 0.0])))
    assert found.stable
    assert found.gain == pytest.approx(2.0, rel=1e-6)
    crossing = found.crossover
    assert crossing * (1 + crossing**2) == pytest.approx(1.0, rel=1e-6)
    assert found.phase == pytest.approx(90 - 2 * np.degrees(np.arctan(crossing)), rel=1e-6)
    assert found.delay == pytest.approx(np.radians(found.phase) / crossing, rel=1e-6)


def test_modes_of_known_poles() -> None:
    system = ct.ss(
        [[0, 1, 0], [-4, -2, 0], [1, 0, 0]], [[0], [1], [0]], np.eye(3), 0, states=["q", "q_dot", "integral"]
    )
    place, swing = modes(system)
    assert place.pole == 0j
    assert place.states == ("integral",)
    assert place.stable
    assert (swing.frequency, swing.damping, swing.time_constant) == pytest.approx((2.0, 0.5, 1.0))


def test_minimal_leaves_out_what_cancels() -> None:
    system = ct.ss(np.diag([-1.0, -2.0, -3.0]), [[1.0], [0.0], [1.0]], [[1.0, 1.0, 0.0]], 0)
    assert minimal(system).poles() == pytest.approx([-1.0])


@pytest.mark.slow
def test_python_control_is_imported_late() -> None:
    code = "import undertow.control, sys; assert 'control' not in sys.modules; undertow.control.linearize"
    subprocess.run([sys.executable, "-c", code], check=True)
