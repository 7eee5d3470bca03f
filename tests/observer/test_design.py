"""Observers on board: their C against Python, in a simulated loop and in its linear form."""

from __future__ import annotations

import ctypes
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import control as ct
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.linalg import solve_continuous_lyapunov

from benchmarks.observer_log import auv
from tests.quick import first_quick
from undertow.codegen.compiler import find_compiler, pointer
from undertow.codegen.library import Library
from undertow.codegen.spelling import identifier, slug
from undertow.control.closed_loop import ClosedLoop, Scenario
from undertow.control.conditions.full_loop import observed_loop
from undertow.control.gains import load_gains
from undertow.control.linear.systems import SteadyStateFilter, close_loop
from undertow.control.linear.trim import find_trim
from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value
from undertow.observer.design import Design, ObserverTable, design, load_observer
from undertow.observer.filters import Method, Observer, Reports
from undertow.observer.observer_c import observer_c
from undertow.observer.process import AT_REST

SENSORS = {
    "x": {"noise": "5 cm", "period": "1 s"},
    "y": {"noise": "5 cm", "period": "1 s"},
    "z": {"noise": "1 cm", "period": "0.2 s"},
    "psi": {"noise": "0.5 deg", "period": "0.1 s"},
    "r": {"noise": "0.3 deg/s"},
}
DISTURBANCE = {"u": 0.01, "v": 0.01, "w": 0.01, "r": 0.02}
WALK = {"V_N": 0.003, "V_E": 0.003}


def table(**more: object) -> ObserverTable:
    content = {
        "schema": "undertow/observer/1",
        "name": "usbl",
        "sensors": SENSORS,
        "disturbance": DISTURBANCE,
    }
    return ObserverTable.model_validate(content | more)


def behind(method: Method = "ekf", period: str = "0.2 s") -> Design:
    """An observer whose velocities are 0.3 s late, beside positions on time."""
    sensors = {n: SENSORS[n] for n in ("x", "y", "z", "psi")} | {"u": {"noise": "1 cm/s"}}
    sensors["w"] = {"noise": "1 cm/s", "period": period}
    return design(table(name=f"late {method}", filter=method, sensors=sensors), auv(velocity_delay=0.3))


@pytest.mark.parametrize(
    ("sensors", "words"),
    [
        ({"x": {"noise": "5 cm", "period": "-1 s"}}, "period of x = -1 s"),
        ({"x": {"noise": "0 m"}}, "noise of x = 0 m"),
    ],
)
def test_numbers_of_sensors_that_cannot_be_are_refused(
    sensors: dict[str, dict[str, str]], words: str
) -> None:
    with pytest.raises(UndertowError, match=words):
        design(table(sensors=sensors), load_vehicle("mini-auv"))


def test_an_infinite_disturbance_is_refused() -> None:
    with pytest.raises(ValidationError, match="finite number"):
        table(disturbance=DISTURBANCE | {"u": float("inf")})


def test_a_sampling_interval_over_which_the_prediction_grows_is_refused() -> None:
    """One step of Runge-Kutta of fourth order grows beyond 2.78 time constants; the lag here has 0.02 s."""
    vehicle = load_vehicle("mini-auv").with_effect(catalogue()["thruster_lag"], {"T_lag": Value(0.02)})
    loop = ClosedLoop(
        load_gains("paper-pd", vehicle), vehicle, observer=design(table(), vehicle), compiled=False
    )
    to = (0.5, 0.0, 0.5)
    assert loop.run(Scenario(to, 2.0, 0.05)).result.diverged is None
    with pytest.raises(UndertowError, match=r"time constant of 0.02 s: stay below 0.05 s"):
        loop.run(Scenario(to, 2.0, 0.1))


def with_current(method: Method = "ekf") -> Design:
    more = {"estimate": ["V_N", "V_E"], "disturbance": DISTURBANCE | WALK}
    return design(table(name=f"usbl {method}", filter=method, **more), load_vehicle("mini-auv"))


def compiled(observer: Design, folder: Path) -> tuple[ctypes.CDLL, str]:
    """The C of an observer as a library, and the beginning of its names."""
    compiler = find_compiler()
    if compiler is None:
        pytest.skip("no C compiler on this machine")
    name = slug(observer.name)
    folder = (
        Library(observer.process.vehicle, [(name, lambda c: observer_c(observer, c))]).write(folder).folder
    )
    own = f"mini_auv_{identifier(name)}"
    strict = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-O1")
    shared = ("-ffp-contract=off", "-Isrc", "-fPIC", "-shared", f"src/{own}.c", "-lm", "-o", "observer.so")
    command = [*compiler.command, *strict, *shared]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(folder / "observer.so")), own


@pytest.mark.skipif(sys.platform == "win32", reason="compiles with options of cc")
@pytest.mark.parametrize("method", ["ekf", "ukf"])
def test_the_filter_in_c_is_that_of_python(method: Method, tmp_path: Path) -> None:
    observer = with_current(method)
    library, own = compiled(observer, tmp_path)
    n, rows, dt = observer.process.x.numel(), 40, 0.1
    x, P = np.zeros(n), np.zeros((n, n))
    p = ctypes.c_void_p(ctypes.addressof(ctypes.c_double.in_dll(library, f"{own}_parameters_default")))
    getattr(library, f"{own}_start")(pointer(x), pointer(P), p)
    np.testing.assert_allclose(P, AT_REST.covariance(observer.process), rtol=1e-15)
    t, rng = dt * np.arange(rows), np.random.default_rng(5)
    u = np.column_stack([np.full(rows, -7.15), np.sin(t), np.full(rows, -7.15), np.cos(t)])
    y = np.full((rows, 8), np.nan)
    for k, i in enumerate(observer.channels):
        y[:: k + 1, i] = 0.1 * rng.standard_normal(len(y[:: k + 1]))
    variance = np.ones(8)
    variance[list(observer.channels)] = observer.variance
    python = Observer(observer.process, observer.densities).run(Reports(t, u, y, variance), x, P, method)
    for k in range(rows):
        held = np.ascontiguousarray(u[max(k - 1, 0)])
        if k:
            now, step = ctypes.c_double(t[k - 1]), ctypes.c_double(t[k] - t[k - 1])
            new = pointer(x), pointer(P)
            getattr(library, f"{own}_predict")(*new, pointer(held), p, now, step, *new)
        for name, i in zip(observer.sensors, observer.channels, strict=True):
            if np.isfinite(y[k, i]):
                update = getattr(library, f"{own}_update_{name}")
                update.restype = ctypes.c_double
                report = ctypes.c_double(y[k, i])
                nis = update(pointer(x), pointer(P), pointer(held), p, ctypes.c_double(t[k]), report)
                assert nis == pytest.approx(python.innovation[k, i] ** 2 / python.variance[k, i], rel=1e-9)
        np.testing.assert_allclose(x, python.mean[k], rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(P, python.covariance[k], rtol=1e-10, atol=1e-12)


@pytest.mark.skipif(sys.platform == "win32", reason="compiles with options of cc")
@pytest.mark.parametrize("method", first_quick(["ekf", "ukf"]))
def test_late_reports_in_c_are_used_when_they_were_true(method: Method, tmp_path: Path) -> None:
    """Velocities 0.3 s late, beside positions on time: Python has all that came in at the rows of truth."""
    late, dt, rows, sensors = 3, 0.1, 40, {n: SENSORS[n] for n in ("x", "psi")} | {"u": {"noise": "1 cm/s"}}
    observer = design(table(name=f"late {method}", filter=method, sensors=sensors), auv(velocity_delay=0.3))
    assert observer.late == {"u": pytest.approx(0.3)}
    library, own = compiled(observer, tmp_path)
    n, rng = observer.process.x.numel(), np.random.default_rng(6)
    t = dt * np.arange(rows)
    u = np.column_stack([np.full(rows, -7.15), np.sin(t), np.full(rows, -7.15), np.cos(t)])
    y = np.full((rows, 8), np.nan)
    for k, i in enumerate(observer.channels):
        y[:: k + 1, i] = 0.1 * rng.standard_normal(len(y[:: k + 1]))
    variance = np.ones(8)
    variance[list(observer.channels)] = observer.variance
    x, P, memory = np.zeros(n), np.zeros((n, n)), np.zeros(100_000)
    p = ctypes.c_void_p(ctypes.addressof(ctypes.c_double.in_dll(library, f"{own}_parameters_default")))
    state = pointer(x), pointer(P)
    getattr(library, f"{own}_start")(*state, p)
    first, covariance = x.copy(), P.copy()
    getattr(library, f"{own}_begin")(pointer(memory), *state, ctypes.c_double(0.0))
    for k in range(rows):
        if k:
            held = np.ascontiguousarray(u[k - 1])
            getattr(library, f"{own}_step")(pointer(memory), *state, pointer(held), p, ctypes.c_double(dt))
        for name, i in zip(observer.sensors, observer.channels, strict=True):
            row = k - late * (name == "u")
            if row >= 0 and np.isfinite(y[row, i]):
                report = getattr(library, f"{own}_report_{name}")
                report.restype = ctypes.c_double
                assert report(pointer(memory), *state, p, ctypes.c_double(y[row, i])) >= 0
        if k in (2, 3, 17, rows - 1):
            known = y[: k + 1].copy()
            known[max(k + 1 - late, 0) :, observer.channels[-1]] = np.nan
            reports = Reports(t[: k + 1], u[: k + 1], known, variance)
            python = Observer(observer.process, observer.densities).run(reports, first, covariance, method)
            np.testing.assert_allclose(x, python.mean[-1], rtol=1e-9, atol=1e-12)
            np.testing.assert_allclose(P, python.covariance[-1], rtol=1e-9, atol=1e-12)
    # Steps shorter than was foreseen: the time of the report is not kept any more.
    for _ in range(10):
        getattr(library, f"{own}_step")(pointer(memory), *state, pointer(held), p, ctypes.c_double(0.01))
    before = x.copy()
    assert report(pointer(memory), *state, p, ctypes.c_double(0.1)) == -1
    assert np.array_equal(x, before)


@pytest.fixture(scope="module")
def record():
    """To a depth and a heading, in a current that the observer finds."""
    gains = load_gains("paper-pd", load_vehicle("mini-auv"))
    moving = auv(V_N=0.05, V_E=-0.03)
    loop = ClosedLoop(gains, moving, observer=with_current(), compiled=False)
    return loop.run(Scenario((0.0, 0.0, 1.0, 0.5), 40.0, 0.1))


def test_the_controller_sees_the_estimate(record) -> None:
    t, late = record.t, slice(200, -1)
    assert t[1] == pytest.approx(0.1)
    for name, size in {"x": 0.05, "u": 0.02, "z": 0.01, "psi": 0.01, "r": 0.005}.items():
        error = record.estimated[name][late] - record.state[name][200:][1:]  # is of the next sample
        assert np.std(error) < size, name
    assert record.estimated["V_N"][-1] == pytest.approx(0.05, abs=0.02)
    assert record.estimated["V_E"][-1] == pytest.approx(-0.03, abs=0.02)
    assert record.state["z"][-1] == pytest.approx(1.0, abs=0.05)
    assert record.state["psi"][-1] == pytest.approx(0.5, abs=0.05)
    # Sensors have the noise of the file where the scenario states none.
    assert np.std(record.reported["x"] - record.state["x"]) == pytest.approx(0.05, rel=0.15)


@pytest.mark.parametrize(
    "observer", first_quick([design(table(), load_vehicle("mini-auv")), behind()]), ids=["", "late"]
)
def test_compiled_loops_with_an_observer_are_those_of_the_virtual_machine(observer: Design) -> None:
    if find_compiler() is None:
        pytest.skip("no C compiler on this machine")
    gains, moving = load_gains("paper-pd", load_vehicle("mini-auv")), observer.process.vehicle
    scenario = Scenario((0.2, 0.0, 0.3, 0.5), 2.0, 0.1)
    loops = [ClosedLoop(gains, moving, observer=observer, compiled=c) for c in (True, False)]
    runs = [loop.run(scenario) for loop in loops]
    for name, values in runs[0].estimated.items():
        np.testing.assert_allclose(values, runs[1].estimated[name], rtol=1e-8, atol=1e-10)
    several = loops[0].run_many(scenario, starts={"z": np.linspace(0.0, 0.2, 5)})
    for name, values in runs[0].state.items():
        np.testing.assert_allclose(several.state(name)[0], values, rtol=1e-8, atol=1e-10)


@pytest.mark.parametrize("method", first_quick(["ekf", "ukf"]))
def test_a_loop_uses_late_reports_when_they_were_true(method: Method) -> None:
    """Python has the reports that had come in at a sample, in the rows of when they were true."""
    observer, dt, lags = behind(method), 0.1, (0, 0, 0, 0, 3, 3)
    process = observer.process
    gains = load_gains("paper-pd", load_vehicle("mini-auv"))
    loop = ClosedLoop(gains, process.vehicle, observer=observer, compiled=False)
    record = loop.run(Scenario((0.2, 0.1, 0.5, 0.3), 3.0, dt))
    u = np.column_stack([record.commands[n] for n in process.vehicle.command_names])
    variance, n = np.ones(len(process.channels)), process.x.numel()
    variance[list(observer.channels)] = observer.variance
    for k in (0, 1, 2, 3, 4, 17, 29):
        y = np.full((k + 2, len(process.channels)), np.nan)
        for i, period, lag in zip(observer.channels, observer.period, lags, strict=True):
            for came in range(0, k + 1, max(round(period / dt), 1)):
                if came >= lag:
                    y[came - lag, i] = record.reported[process.channels[i]][came]
        given = Reports(dt * np.arange(k + 2), u[: k + 2], y, variance)
        found = Observer(process, observer.densities).run(
            given, np.zeros(n), AT_REST.covariance(process), method
        )
        estimated = [record.estimated[name][k] for name in process.state_names]
        np.testing.assert_allclose(estimated, found.mean[-1], rtol=1e-9, atol=1e-12)


def test_a_loop_with_sigma_points_finds_the_current() -> None:
    gains = load_gains("paper-pd", load_vehicle("mini-auv"))
    loop = ClosedLoop(gains, auv(V_N=0.05, V_E=-0.03), observer=with_current("ukf"), compiled=False)
    record = loop.run(Scenario((0.0, 0.0, 1.0, 0.5), 20.0, 0.1))
    assert record.estimated["V_N"][-1] == pytest.approx(0.05, abs=0.02)
    assert record.estimated["V_E"][-1] == pytest.approx(-0.03, abs=0.02)


def test_poles_of_the_loop_are_those_of_the_law_and_of_the_filter() -> None:
    vehicle = load_vehicle("mini-auv")
    observer, trim = design(table(), vehicle), find_trim(vehicle)
    gains = load_gains("paper-pid", vehicle)
    alone = close_loop(vehicle, gains, trim)
    loop = close_loop(vehicle, gains, trim, observer=observer)
    filter = SteadyStateFilter(observer, trim)
    of_the_error = np.linalg.eigvals(filter.a - filter.gain @ filter.c)
    both = np.concatenate([np.linalg.eigvals(alone.closed.A), of_the_error])
    found = np.linalg.eigvals(loop.closed.A)
    for pole in both:
        assert np.abs(found - pole).min() < 1e-6
    # Characteristic polynomials agree, so that no pole is missing either.
    at = 0.3 + 0.7j
    assert np.prod(at - found) == pytest.approx(np.prod(at - both), rel=1e-8)


def test_a_filter_that_settles_has_the_gain_of_the_loop() -> None:
    """Sampled quickly, the covariance of the extended filter becomes that of the Riccati equation."""
    vehicle = load_vehicle("mini-auv")
    quick = {n: {"noise": s["noise"], "period": "0.01 s"} for n, s in SENSORS.items()}
    quick["r"]["noise"] = "3 deg/s"  # slow beside the samples
    observer, trim = design(table(sensors=quick), vehicle), find_trim(vehicle)
    settled = SteadyStateFilter(observer, trim)
    n, p = 4000, observer.process
    y, variance = np.full((n, 8), np.nan), np.ones(8)
    y[:, list(observer.channels)], variance[list(observer.channels)] = 0.0, observer.variance
    u = np.tile([trim.commands[c] for c in p.vehicle.command_names], (n, 1))
    given = Reports(0.01 * np.arange(n), u, y, variance)
    found = Observer(p, observer.densities).run(given, np.zeros(8), 0.01 * np.eye(8))
    c = settled.c
    gain = found.covariance[-1] @ c.T / (observer.variance * 0.01)
    np.testing.assert_allclose(gain[[0, 3, 7]], settled.gain[[0, 3, 7]], rtol=0.05, atol=1e-4)


def test_late_reports_leave_the_poles_of_law_and_filter_apart() -> None:
    """A filter that knows Padé's approximation of the delays obeys the separation principle with it."""
    observer, order = behind(), 3
    vehicle = observer.process.vehicle
    gains, trim = load_gains("paper-pid", vehicle), find_trim(vehicle)
    loop = close_loop(vehicle, gains, trim, observer=observer, pade=order)
    filter = SteadyStateFilter(observer, trim, order)
    of_the_error = np.linalg.eigvals(filter.a - filter.gain @ filter.c)
    of_a_delay = np.linalg.eigvals(ct.ss(ct.tf(*ct.pade(0.3, order))).A)
    on_time = close_loop(load_vehicle("mini-auv"), gains, find_trim(load_vehicle("mini-auv")))
    both = np.concatenate([np.linalg.eigvals(on_time.closed.A), of_the_error, *[of_a_delay] * 3])
    found = np.linalg.eigvals(loop.closed.A)
    at = 0.3 + 0.7j
    assert np.prod(at - found) == pytest.approx(np.prod(at - both), rel=1e-6)


@pytest.mark.parametrize("delay", [0.03, 0.3, 3.0])
def test_the_filter_of_late_reports_converges_with_the_order_of_the_approximation(delay: float) -> None:
    sensors = {n: SENSORS[n] for n in ("x", "y", "z", "psi")} | {n: {"noise": "1 cm/s"} for n in ("u", "w")}
    observer = design(table(sensors=sensors), auv(velocity_delay=delay))
    trim, n = find_trim(observer.process.vehicle), observer.process.x.numel()
    six, eight = (SteadyStateFilter(observer, trim, order).gain[:n] for order in (6, 8))
    np.testing.assert_allclose(six, eight, rtol=1e-4, atol=1e-9)


def test_gains_are_judged_with_late_reports() -> None:
    observer = behind()
    assert observed_loop(load_gains("paper-pd", observer.process.vehicle), observer).verdict == "stable"


def test_a_settled_filter_of_late_reports_is_as_sure_as_the_one_in_a_loop() -> None:
    """Quickly sampled, with velocities 0.3 s late, against Padé's approximation of fourth order."""
    observer, dt, lag, rows = behind(period="0.02 s"), 0.02, 15, 3000
    observer = replace(observer, period=np.full(6, dt), variance=np.full(6, 1e-2))
    process, trim = observer.process, find_trim(observer.process.vehicle)
    settled = SteadyStateFilter(observer, trim, 4)
    noise = np.zeros_like(settled.a)
    noise[process.driven, process.driven] = observer.densities
    noise += dt * settled.gain @ np.diag(observer.variance) @ settled.gain.T
    P = solve_continuous_lyapunov(settled.a - settled.gain @ settled.c, -noise)
    y, variance = np.full((rows, 8), np.nan), np.ones(8)
    y[:, list(observer.channels)], variance[list(observer.channels)] = 0.0, observer.variance
    y[-lag:, list(observer.channels)[4:]] = np.nan
    u = np.tile([trim.commands[c] for c in process.vehicle.command_names], (rows, 1))
    given = Reports(dt * np.arange(rows), u, y, variance)
    found = Observer(process, observer.densities).run(given, np.zeros(8), 0.01 * np.eye(8))
    for name in process.state_names:
        i = process.index(name)
        assert found.covariance[-1, i, i] == pytest.approx(P[i, i], rel=0.05), name


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"sensors": {"q": {"noise": 0.1}}}, "sensor 'q' does not exist"),
        ({"disturbance": {"u": 0.1}}, r"\[disturbance\] lacks v"),
        ({"sensors": {}}, r"\[sensors\] is empty"),
        ({"sensors": {"x": {"noise": 0.0}}}, "give a standard deviation above zero"),
        ({"estimate": ["V_X"]}, "cannot be estimated as a state"),
    ],
)
def test_files_that_do_not_fit_are_refused(more, words) -> None:
    with pytest.raises(UndertowError, match=words):
        design(table(**more), load_vehicle("mini-auv"))


def test_late_reports_are_refused_without_an_approximation_and_where_they_are_too_many() -> None:
    observer, vehicle = behind(), behind().process.vehicle
    with pytest.raises(UndertowError, match=r"u is reported 0\.3 s late, .*: give the order .*--pade 3"):
        close_loop(vehicle, load_gains("paper-pid", vehicle), find_trim(vehicle), observer=observer)
    loop = ClosedLoop(load_gains("paper-pd", vehicle), observer=observer, compiled=False)
    with pytest.raises(UndertowError, match=r"3000 samples of 0\.0001 s late, .* keeps 500: lengthen dt to"):
        loop.run(Scenario((1, 1, 1, 0), 1.0, 1e-4))


def test_laws_without_samples_and_unknown_keys_are_refused(tmp_path: Path) -> None:
    vehicle = load_vehicle("mini-auv")
    loop = ClosedLoop(load_gains("paper-pd", vehicle), observer=design(table(), vehicle), compiled=False)
    with pytest.raises(UndertowError, match="needs a sampled law"):
        loop.run(Scenario((1, 1, 1, 0), 1.0, 0.1, continuous=True))
    (tmp_path / "bad.toml").write_text('schema = "undertow/observer/1"\nname = "x"\nsensor = 1\n')
    with pytest.raises(UndertowError, match="key 'sensor' is not known"):
        load_observer(tmp_path / "bad.toml", vehicle)
