"""C libraries for boards: compiled strictly, run, and compared with the model and the controller."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.quick import first_quick
from undertow import UndertowError
from undertow.cli.main import main
from undertow.codegen import Functions
from undertow.control.allocation import allocation_of
from undertow.control.controller import Controller, thruster_commands
from undertow.control.gains import load_gains
from undertow.export.library import Library, sizes
from undertow.model.actuators import bundled_curves
from undertow.model.hardware import Curve
from undertow.model.loading import bundled_vehicles, load_vehicle

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror", "-ffp-contract=off")
ARM = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
SINGLE = "-DMINI_AUV_SINGLE"
PARTS = ("vehicle", "controller", "allocation")


def needs(*programs: str) -> pytest.MarkDecorator:
    missing = [p for p in programs if shutil.which(p) is None]
    return pytest.mark.skipif(bool(missing), reason=f"needs {', '.join(missing)}")


def _run(command: list[str], folder: Path) -> str:
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@cache
def _auv() -> Library:
    vehicle = load_vehicle("mini-auv")
    return Library(vehicle, load_gains("paper-pid", vehicle))


def _built(library: Library, folder: Path, *flags: str) -> Any:
    library.write(folder)
    sources = [str(p.relative_to(folder)) for p in sorted((folder / "src").glob("*.c"))]
    _run(["cc", *STRICT, *flags, "-O1", "-fPIC", "-shared", *sources, "-lm", "-o", "it.so"], folder)
    return ctypes.CDLL(str(folder / "it.so"))


def _array(values: Any, single: bool = False) -> np.ndarray:
    return np.array(values, dtype=np.float32 if single else np.float64)


def _pointer(a: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(a.ctypes.data)


@pytest.mark.parametrize(
    ("compiler", "flags"),
    first_quick([("gcc", ()), ("gcc", (SINGLE,)), ("clang", ()), ("clang", (SINGLE,))]),
)
def test_compilers_have_nothing_to_say_and_the_examples_run(
    compiler: str, flags: tuple[str, ...], tmp_path: Path
) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"needs {compiler}")
    _auv().write(tmp_path)
    for part in PARTS:
        sources = [f"examples/{part}/main.c", f"src/mini_auv_{part}.c"]
        _run([compiler, *STRICT, *flags, "-Isrc", *sources, "-lm", "-o", part], tmp_path)
        assert _run([f"./{part}"], tmp_path).split()


@pytest.mark.slow
@needs("cc")
@pytest.mark.parametrize("name", bundled_vehicles())
def test_every_bundled_vehicle_is_clean_in_both_precisions(name: str, tmp_path: Path) -> None:
    library = Library(load_vehicle(name))
    for k, flags in enumerate(((), (f"-D{library.name.upper()}_SINGLE",))):
        _built(library, tmp_path / str(k), *flags)


@needs("cc")
@pytest.mark.parametrize("single", [False, True])
def test_the_vehicle_moves_as_the_model_and_parameters_are_those_of_the_struct(
    single: bool, tmp_path: Path
) -> None:
    library = _auv()
    built = _built(library, tmp_path, *([SINGLE] if single else []))
    f = Functions(library.vehicle)
    real = ctypes.c_float if single else ctypes.c_double
    tolerance = 3e-5 if single else 1e-12
    rng = np.random.default_rng(2)
    p = np.array(f.values())
    stated = np.array((real * len(p)).in_dll(built, "mini_auv_parameters_default"), dtype=float)
    np.testing.assert_allclose(stated, p, rtol=1e-7 if single else 0)
    for changed in (p, p * rng.uniform(0.9, 1.1, p.size)):
        x, u = rng.normal(size=f.x.numel()), rng.normal(size=f.u.numel())
        given = [_array(a, single) for a in (x, u, changed)]
        found = _array(np.zeros(x.size), single)
        built.mini_auv_dynamics(*map(_pointer, given), real(0), _pointer(found))
        expected = f.dynamics(x, u, changed, 0).full().ravel()
        np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)


@needs("cc")
def test_the_controller_is_the_one_of_python_and_its_plant_is_in_a_struct(tmp_path: Path) -> None:
    library = _auv()
    built = _built(library, tmp_path)
    controller = Controller(load_gains("paper-pid", library.vehicle))
    function, numbers = controller.with_numbers()
    assert "B_net" in numbers
    rng = np.random.default_rng(4)
    states = np.zeros(len(controller.state_names))
    s = _array(states)
    built.mini_auv_control_start(_pointer(s))
    np.testing.assert_array_equal(s, controller.initial_states())
    n = len(library.vehicle.pose_names)
    gains, dt = _array(controller.gain_values()), _array([0.05])
    for scale in (1.0, 1.0, 1.3):
        m = _array(list(numbers.values())) * scale
        y, r = _array(rng.normal(size=2 * n)), _array(rng.normal(size=n))
        u, tau = _array(np.zeros(len(controller.command_names))), _array(np.zeros(n))
        exact = function(y, r, s, gains, dt, m)
        if scale == 1.0:  # the numbers as literals give the same
            for a, b in zip(exact, controller.sampled(y, r, s, gains, dt), strict=True):
                np.testing.assert_allclose(a.full(), b.full(), rtol=1e-12, atol=1e-12)
        built.mini_auv_control(*map(_pointer, (y, r, s, gains, dt, m, u, s, tau)))
        for found, expected in zip((u, s, tau), exact, strict=True):
            np.testing.assert_allclose(found, expected.full().ravel(), rtol=1e-12, atol=1e-12)


@needs("cc")
def test_newtons_become_commands_and_pulses(tmp_path: Path) -> None:
    vehicle = load_vehicle("mini-auv")
    lines = bundled_curves()["t200-16v"].read_text().splitlines()
    rows = np.loadtxt([line for line in lines if line[:1] in "-0123456789"], delimiter=",")
    curve = Curve.through([tuple(row) for row in rows[::10]])
    thrusters = tuple(replace(t, law=curve, limit=1.0) for t in vehicle.thrusters)
    library = Library(replace(vehicle, thrusters=thrusters), load_gains("paper-pid", vehicle))
    built = _built(library, tmp_path)
    built.mini_auv_command.restype = built.mini_auv_pulse.restype = ctypes.c_double
    least, most = curve.at(-1), curve.at(1)
    pulses = ctypes.byref((ctypes.c_double * 3).in_dll(built, "mini_auv_pulses_default"))
    for thrust in np.linspace(least, most, 41):
        command = built.mini_auv_command(0, ctypes.c_double(thrust))
        assert curve.at(command) == pytest.approx(thrust, abs=0.01 * (most - least))
        pulse = built.mini_auv_pulse(ctypes.c_double(command), pulses)
        assert pulse == pytest.approx(1500 + 400 * command)
    for beyond, end in ((2 * least, 1100), (2 * most, 1900)):
        command = built.mini_auv_command(0, ctypes.c_double(beyond))
        assert built.mini_auv_pulse(ctypes.c_double(command), pulses) == pytest.approx(end)
    tau = np.array([3.0, 0.0, -2.0, 0.5])
    found = np.zeros(4)
    built.mini_auv_allocate(_pointer(tau), _pointer(found))
    exact = thruster_commands(allocation_of(load_gains("paper-pid", vehicle)), ca.SX(tau))
    np.testing.assert_allclose(found, np.array(ca.DM(exact)).ravel(), rtol=1e-12)


def test_a_propeller_by_revolutions_has_no_inverse() -> None:
    from undertow.model.hardware import Propeller

    vehicle = load_vehicle("mini-auv")
    thrusters = tuple(replace(t, law=Propeller(0.1, 1.0)) for t in vehicle.thrusters)
    library = Library(replace(vehicle, thrusters=thrusters), load_gains("paper-pid", vehicle))
    with pytest.raises(UndertowError, match="revolutions: the inverse needs a curve"):
        assert library.texts


@pytest.mark.slow
@needs("cmake", "cc")
def test_cmake_installs_a_package_that_others_find(tmp_path: Path) -> None:
    _auv().write(tmp_path / "lib")
    _run(["cmake", "-B", "build", "-D", f"CMAKE_INSTALL_PREFIX={tmp_path}/there"], tmp_path / "lib")
    _run(["cmake", "--build", "build", "--target", "install"], tmp_path / "lib")
    user = tmp_path / "user"
    user.mkdir()
    (user / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.10)\nproject(user C)\nfind_package(mini_auv REQUIRED)\n"
        "add_executable(user main.c)\ntarget_link_libraries(user mini_auv)\n"
    )
    shutil.copy(tmp_path / "lib/examples/vehicle/main.c", user / "main.c")
    _run(["cmake", "-B", "build", "-D", f"CMAKE_PREFIX_PATH={tmp_path}/there"], user)
    _run(["cmake", "--build", "build"], user)
    assert len(_run(["build/user"], user).split()) == 8


@needs("arm-none-eabi-gcc")
def test_it_fits_a_cortex_m4(tmp_path: Path) -> None:
    flags = (*STRICT, *ARM, SINGLE, "-Wdouble-promotion")
    flash, stacks = sizes(_auv(), "arm-none-eabi-gcc", *flags)
    assert set(flash) == {f"mini_auv_{part}.c" for part in PARTS}
    assert 0 < sum(flash.values()) < 8_000
    assert {"mini_auv_dynamics", "mini_auv_control", "mini_auv_allocate"} <= {s.function for s in stacks}
    assert max(s.stack for s in stacks) < 1_000


def test_the_command_writes_a_folder_and_prints_sizes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["export", "c", "mini-auv", "--controller", "paper-pid", "--out", str(tmp_path / "auv")]
    assert main(words) == 0
    assert "README.md" in {p.name for p in (tmp_path / "auv").iterdir()}
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([*words, "--force", "--sizes", "no-such-compiler"]) == 2
    assert "'no-such-compiler' is not there" in capsys.readouterr().err
    text = (tmp_path / "auv/library.properties").read_text()
    assert "includes=mini_auv_vehicle.h,mini_auv_controller.h,mini_auv_allocation.h" in text
