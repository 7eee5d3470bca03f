"""Sampled linear systems, labels with units, and disk margins of several loops at once."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import control as ct
import numpy as np
import pytest

from tests.cli.bad import refusal
from tests.control.loops import AUV, loop
from tests.quick import first_quick
from undertow import UndertowError
from undertow.cli.main import main
from undertow.codegen import Functions, Simulator
from undertow.control import as_controller, as_nlsys, close_loop, find_trim, in_direction, linearize
from undertow.control.closed_loop.interconnection import SampledLoop
from undertow.control.gains import load_gains
from undertow.control.linear import analysis
from undertow.control.linear.analysis import margins, minimal, modes, multiloop_disk_margin, sampled_gramian
from undertow.model.effects.actuation_delay import ActuationDelay
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle


@pytest.fixture(scope="module")
def auv() -> Vehicle:
    return load_vehicle("mini-auv")


def test_a_held_command_moves_the_sampled_system_as_the_nonlinear_vehicle(auv: Vehicle) -> None:
    trim = find_trim(auv, {"u": 0.5})
    system, small, dt = linearize(auv, trim, dt=0.2), 1e-5, 0.2
    assert (system.dt, system.state_labels[-1], system.input_labels[1]) == (0.2, "r", "f2")
    rng = np.random.default_rng(2)
    steps = small * rng.normal(size=(10, 4))
    functions = Functions(in_direction(auv, trim.direction))
    t, p = dt * np.arange(11), np.array(functions.values())
    commands = trim.u + np.vstack([steps, steps[-1:]])
    ends = Simulator(functions).run(trim.x[None], t, commands[None], p, max_step=0.005)[0]
    linear = np.zeros(8)
    for step in steps:
        linear = system.A @ linear + system.B @ step
    gone = np.array([0.5 * t[-1], *np.zeros(7)])  # the steady motion itself
    np.testing.assert_allclose(ends[-1] - trim.x - gone, linear, atol=1e-4 * np.abs(linear).max())


def test_poles_are_exponentials_of_the_continuous_ones(auv: Vehicle) -> None:
    trim = find_trim(auv, {"u": 0.5})
    for a, b in zip(modes(linearize(auv, trim)), modes(linearize(auv, trim, dt=0.1)), strict=True):
        assert b.pole == pytest.approx(np.exp(0.1 * a.pole), rel=1e-12)
        assert b.magnitude == pytest.approx(abs(np.exp(0.1 * a.pole)))
        assert (b.states, b.stable) == (a.states, a.stable)
        assert b.time_constant == pytest.approx(a.time_constant)


def test_dead_time_is_whole_samples(auv: Vehicle, caplog: pytest.LogCaptureFixture) -> None:
    late = auv.with_effect(ActuationDelay, {"delay": Value(0.4)})
    system, plain = linearize(late, {"u": 0.5}, dt=0.1), linearize(auv, {"u": 0.5}, dt=0.1)
    assert not caplog.text
    z = np.exp(0.3j)
    np.testing.assert_allclose(system(z), plain(z) * z**-4, rtol=1e-9, atol=1e-12)
    assert len([m for m in modes(system) if m.time_constant == 0]) == 16  # four shifts for each of four
    linearize(late, {"u": 0.5}, dt=0.15)
    assert "a dead time of 0.4 s is taken as 3 samples of 0.15 s" in caplog.text
    with pytest.raises(UndertowError, match=r"4000 samples of 0\.0001 s, but 1000 is the limit"):
        linearize(late, {"u": 0.5}, dt=1e-4)
    with pytest.raises(UndertowError, match=r"pade = 9 is not an order .*: give 0 to 8"):
        linearize(late, {"u": 0.5}, pade=9)
    with pytest.raises(UndertowError, match="leave out one of the two"):
        linearize(late, {"u": 0.5}, dt=0.1, pade=2)
    with pytest.raises(UndertowError, match="dt = -1 s is impossible"):
        linearize(late, {"u": 0.5}, dt=-1.0)


def test_the_sampled_loop_is_the_one_that_simulations_check() -> None:
    parts, goal = loop("paper-pd").parts, np.zeros(4)
    for side, way in ((0, 1), (1, -1)):
        expected = SampledLoop(parts, goal, goal).sampled_rates(0.3, side)
        trim = find_trim(AUV, direction={"u": way, "w": way})
        closed = close_loop(AUV, load_gains("paper-pd", AUV), trim, dt=0.3).closed
        found = np.log(closed.poles().astype(complex)) / 0.3
        assert max(min(abs(expected - rate)) for rate in found) < 1e-6  # besides, it has the gate's


def test_margins_of_a_sampled_integrator_are_the_closed_forms() -> None:
    k, dt = 3.0, 0.1
    found = margins(ct.ss([[1.0]], [[dt]], [[k]], 0.0, dt=dt))  # k dt/(z - 1)
    crossover = 2 / dt * np.arcsin(k * dt / 2)
    assert found.gain == pytest.approx(2 / (k * dt))  # at z = -1
    assert found.crossover == pytest.approx(crossover, rel=1e-4)
    assert found.phase == pytest.approx(90 - np.degrees(crossover * dt / 2), rel=1e-4)
    assert found.distance == pytest.approx(1 - k * dt / 2)
    assert not margins(ct.ss([[1.0]], [[dt]], [[2.1 / dt]], 0.0, dt=dt)).stable


def test_sampled_gramian_is_its_sum() -> None:
    rng = np.random.default_rng(4)
    a, b = 0.5 * rng.normal(size=(3, 3)), rng.normal(size=(3, 2))
    expected = sum(p @ b @ b.T @ p.T for p in (np.linalg.matrix_power(a, k) for k in range(11)))
    np.testing.assert_allclose(sampled_gramian(a, b, 10.3), expected, rtol=1e-12)


def test_labels_may_say_units(auv: Vehicle) -> None:
    system = linearize(auv, {"u": 0.5}, units=True)
    assert (system.state_labels[3], system.input_labels[1], system.output_labels[-1]) == (
        "psi [rad]",
        "f2 [N]",
        "r [rad/s]",
    )
    plain = linearize(auv, {"u": 0.5})
    assert system["r [rad/s]", "f2 [N]"](0.1j) == plain["r", "f2"](0.1j)
    assert as_nlsys(auv, units=True).output_labels[:2] == ["x [m]", "y [m]"]


def test_vehicle_and_law_connect_by_labels_with_units(auv: Vehicle) -> None:
    gains, references = load_gains("paper-pid", auv), (("x", "m"), ("y", "m"), ("z", "m"), ("psi", "rad"))
    plain, labelled = (
        ct.interconnect(
            [as_nlsys(auv, units=units), as_controller(gains, units=units)],
            inputs=[f"{n}_ref [{own}]" if units else f"{n}_ref" for n, own in references],
            outputs=["u [m/s]", "f1 [N]"] if units else ["u", "f1"],
        )
        for units in (False, True)
    )
    assert {"law_integral_x [m s]", "mini-auv_r [rad/s]"} <= set(labelled.state_labels)
    x = np.random.default_rng(3).uniform(-0.3, 0.3, plain.nstates)
    np.testing.assert_array_equal(
        labelled.dynamics(0.0, x, [1.0, 0.2, 0.1, 0.3]), plain.dynamics(0.0, x, [1.0, 0.2, 0.1, 0.3])
    )
    np.testing.assert_array_equal(
        labelled.output(0.0, x, [1.0, 0.2, 0.1, 0.3]), plain.output(0.0, x, [1.0, 0.2, 0.1, 0.3])
    )


@pytest.mark.parametrize("name", ["remus100", "kvlcc2"])
def test_every_label_of_a_vehicle_with_surfaces_has_its_unit(name: str) -> None:
    system = as_nlsys(load_vehicle(name), units=True)
    labels = [*system.state_labels, *system.input_labels, *system.output_labels]
    assert [label for label in labels if not label.endswith("]")] == []


# --- several loops at once --------------------------------------------------------------------------
needs_slycot = pytest.mark.skipif(find_spec("slycot") is None, reason="needs slycot")


def _satellite() -> ct.StateSpace:
    """The spinning satellite of Seiler, Packard and Gahinet (2020), as python-control's manual has it."""
    plant = ct.ss([[0, 10], [-10, 0]], np.eye(2), [[1, 10], [-10, 1]], np.zeros((2, 2)))
    return plant * ct.ss([], [], [], [[1, -2], [0, 1]])


@needs_slycot
def test_disk_margin_of_all_is_the_scaled_norm() -> None:
    satellite = _satellite()
    found = multiloop_disk_margin(satellite)
    # Of two loops the bound is exact: the least norm over the scaling diag(d, 1).
    omega = np.geomspace(0.01, 300, 150)  # the worst is at rest
    scales = np.geomspace(0.05, 20, 200)
    norms = []
    for w in omega:
        gain = satellite(1j * w)
        m = np.linalg.solve(np.eye(2) + gain, np.eye(2)) - np.eye(2) / 2
        norms.append(min(np.linalg.norm(np.diag([d, 1]) @ m @ np.diag([1 / d, 1]), 2) for d in scales))
    assert found == pytest.approx(1 / max(norms), rel=2e-3)
    apart = ct.append(ct.ss(ct.tf([1.0], [1.0, 2.0, 1.0, 0.0])), ct.ss(ct.tf([3.0], [1.0, 1.0, 0.0])))
    alone = [margins(minimal(ct.ss(apart[i, i]))).disk for i in (0, 1)]
    assert multiloop_disk_margin(apart) == pytest.approx(min(alone), rel=1e-4)


@needs_slycot
def test_all_forces_together_have_no_more_room_than_one(auv: Vehicle) -> None:
    closed = close_loop(auv, load_gains("paper-pd", auv), find_trim(auv))
    assert 0 < closed.disk <= min(m.disk for m in closed.margins.values()) + 1e-6
    sampled = close_loop(auv, load_gains("paper-pd", auv), find_trim(auv), dt=0.02)
    assert sampled.disk == pytest.approx(closed.disk, rel=0.02)
    assert close_loop(auv, load_gains("paper-pid", auv), find_trim(auv)).disk == 0.0


def test_without_slycot_the_remedy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(analysis, "find_spec", lambda name: None)
    with pytest.raises(UndertowError, match=r"pip install 'undertow\[slycot\]'"):
        multiloop_disk_margin(_satellite())


# --- the command --------------------------------------------------------------------------------
def test_the_command_prints_poles_in_z(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    assert main(["linearize", "mini-auv", "--at", "u=0.5", "--dt", "100 ms"]) == 0
    out = capsys.readouterr().out
    assert "Poles, sampled every 0.1 s" in out
    assert "1.05834   1.058335" in out  # exp(0.1 s * 0.56697/s)
    assert main(["linearize", "mini-auv", "--gains", "paper-pd", "--dt", "0.1", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["dt"] == 0.1
    assert all(m["magnitude"] == pytest.approx(np.hypot(*m["pole"])) for m in content["modes"])
    assert content["stable"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--dt", "0"], "--dt 0 is not a sampling time"),
        (["--dt", "1 m"], "--dt: "),
        (["--dt", "0.1", "--family", "3"], "--family draws continuous systems"),
        (["--together"], "--together is for the loops of a law"),
    ],
)
def test_what_cannot_be_sampled_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    assert said in refusal(["linearize", "mini-auv", *words], capsys, tmp_path)


@pytest.mark.parametrize("kind", first_quick(["poles", "step", "root-locus"]))
def test_pictures_of_the_sampled_form_are_written(kind: str, tmp_path: Path) -> None:
    target = tmp_path / "a.png"
    words = ["linearize", "mini-auv", "--gains", "paper-pd", "--dt", "0.3", "--plot", kind]
    assert main([*words, "--out", str(target)]) == 0
    assert target.read_bytes().startswith(b"\x89PNG")
