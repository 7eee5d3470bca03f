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

from tests.observer.test_design import with_current as usbl
from tests.quick import first_quick
from undertow.cli.main import main
from undertow.codegen import Functions
from undertow.codegen.compiler import pointer
from undertow.codegen.library import Library, sizes, usual_compilers
from undertow.control.controller import Controller, SymbolicAllocation, thruster_commands
from undertow.control.gains import load_gains
from undertow.control.update import library_of
from undertow.model.effect import Curve, Propeller
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.tables import bundled_curves

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Werror", "-ffp-contract=off")
ARM = ("-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16")
SINGLE = "-DMINI_AUV_SINGLE"
NEEDED = {"vehicle": (), "jacobians": ("vehicle",), "thrusters": (), "paper_pid": ()}
NEEDED |= {"usbl_ekf": (), "usbl_ukf": ()}
PARTS = tuple(NEEDED)


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
    limits = {"limits": {"f2": "3 N"}}
    change = lambda t: t.model_copy(update={"allocation": t.allocation.model_copy(update=limits)})  # noqa: E731
    return library_of(vehicle, [load_gains("paper-pid", vehicle, change)], [usbl("ekf"), usbl("ukf")])


def _built(library: Library, place: Path, *flags: str) -> Any:
    folder = library.write(place).folder
    sources = [str(p.relative_to(folder)) for p in sorted((folder / "src").glob("*.c"))]
    _run(["cc", *STRICT, *flags, "-O1", "-fPIC", "-shared", *sources, "-lm", "-o", "it.so"], folder)
    return ctypes.CDLL(str(folder / "it.so"))


def _array(values: Any, single: bool = False) -> np.ndarray:
    return np.array(values, dtype=np.float32 if single else np.float64)


@pytest.mark.parametrize(
    ("compiler", "flags"), first_quick([("gcc", ()), ("gcc", (SINGLE,)), ("clang", ()), ("clang", (SINGLE,))])
)
def test_compilers_have_nothing_to_say_and_the_examples_run(
    compiler: str, flags: tuple[str, ...], tmp_path: Path
) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"needs {compiler}")
    folder = _auv().write(tmp_path).folder
    for part in PARTS:
        sources = [f"examples/{part}/main.c", *(f"src/mini_auv_{p}.c" for p in {part, *NEEDED[part]})]
        _run([compiler, *STRICT, *flags, "-Isrc", *sources, "-lm", "-o", part], folder)
        assert _run([f"./{part}"], folder).split()


@pytest.mark.slow
@needs("cc")
@pytest.mark.parametrize("name", bundled_vehicles())
def test_every_bundled_vehicle_is_clean_in_both_precisions(name: str, tmp_path: Path) -> None:
    library = Library(load_vehicle(name))
    for k, flags in enumerate(((), (f"-D{library.name.upper()}_SINGLE",))):
        _built(library, tmp_path / str(k), *flags)


@needs("cc")
@pytest.mark.parametrize("single", first_quick([False, True]))
def test_the_vehicle_moves_as_the_model_and_parameters_are_those_of_the_struct(
    single: bool, tmp_path: Path
) -> None:
    library = _auv()
    built = _built(library, tmp_path, *([SINGLE] if single else []))
    f = Functions(library.vehicle, named=True)
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
        built.mini_auv_dynamics(*map(pointer, given), real(0), pointer(found))
        expected = f.dynamics(x, u, changed, 0).full().ravel()
        np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)


@needs("cc")
def test_newtons_become_commands_and_pulses(tmp_path: Path) -> None:
    vehicle = load_vehicle("mini-auv")
    lines = bundled_curves()["t200-16v"].read_text().splitlines()
    rows = np.loadtxt([line for line in lines if line[:1] in "-0123456789"], delimiter=",")
    curve = Curve.through([tuple(row) for row in rows[::20]])
    thrusters = tuple(replace(t, law=curve, limit=1.0) for t in vehicle.thrusters)
    built = _built(Library(replace(vehicle, thrusters=thrusters)), tmp_path)
    built.mini_auv_command.restype = built.mini_auv_pulse.restype = ctypes.c_double
    least, most = curve.at(-1), curve.at(1)
    numbers = (ctypes.c_double * (4 * 33 * 2 + 3)).in_dll(built, "mini_auv_thrusters_default")
    given = ctypes.byref(numbers)
    for thrust in np.linspace(least, most, 41):
        command = built.mini_auv_command(0, ctypes.c_double(thrust), given)
        assert curve.at(command) == pytest.approx(thrust, abs=0.01 * (most - least))
        assert built.mini_auv_pulse(ctypes.c_double(command), given) == pytest.approx(1500 + 400 * command)
    for beyond, end in ((2 * least, 1100), (2 * most, 1900)):
        command = built.mini_auv_command(0, ctypes.c_double(beyond), given)
        assert built.mini_auv_pulse(ctypes.c_double(command), given) == pytest.approx(end)
    mine = (ctypes.c_double * len(numbers))(*[2 * v for v in numbers[:-3]], 1500.0, 300.0, 1.0)
    command = built.mini_auv_command(0, ctypes.c_double(most), given)
    doubled = built.mini_auv_command(0, ctypes.c_double(2 * most), ctypes.byref(mine))
    assert doubled == pytest.approx(2 * command)  # the struct is the caller's own
    assert built.mini_auv_pulse(ctypes.c_double(1.0), ctypes.byref(mine)) == pytest.approx(1800)


@needs("cc")
def test_allocation_is_that_of_python_and_of_the_struct(tmp_path: Path) -> None:
    """Also with another matrix and another limit, as on a vehicle with its thrusters moved."""
    built, vehicle = _built(_auv(), tmp_path), load_vehicle("mini-auv")
    gains = load_gains("paper-pid", vehicle)
    names = Controller(gains).parametrised().values
    limits = gains.allocation.model_copy(update={"limits": {"f2": "3 N"}})
    controller = Controller(replace(gains, allocation=limits))
    values = controller.parametrised().values
    assert set(values) - set(names) == {"limit_f2"}
    own = SymbolicAllocation.with_names(controller.allocation, controller.command_names, ["X", "Z", "N"])
    assert len(own.numbers()) == sum(k.startswith(("tau_", "weight_", "limit_")) for k in values)
    for arm, limit in ((1.0, 3.0), (1.3, 2.0)):
        changed = {k: v * arm if k.startswith("tau_N") else v for k, v in values.items()} | {
            "limit_f2": limit
        }
        matrix = controller.allocation.matrix.copy()
        matrix[3] *= arm
        stated = replace(controller.allocation, matrix=matrix)
        stated = replace(stated, limits=np.where(np.isfinite(stated.limits), limit, np.inf))
        p = _array(list(changed.values()))
        for tau in ([3.0, 0.0, -2.0, 0.5], [9.0, 0.0, 1.0, -0.8]):
            found, wanted = np.zeros(4), _array(tau)
            built.mini_auv_paper_pid_allocate(pointer(wanted), pointer(p), pointer(found))
            exact = thruster_commands(SymbolicAllocation.of(stated), ca.SX(wanted))
            np.testing.assert_allclose(found, np.array(ca.DM(exact)).ravel(), rtol=1e-12, atol=1e-12)
    assert abs(found[1]) == pytest.approx(2.0)  # at its limit


def test_a_propeller_by_revolutions_has_no_module_of_commands() -> None:
    vehicle = load_vehicle("mini-auv")
    thrusters = tuple(replace(t, law=Propeller(0.1, 1.0)) for t in vehicle.thrusters)
    library = Library(replace(vehicle, thrusters=thrusters))
    assert "src/mini_auv_thrusters.c" not in library.texts
    assert "'f1' has no one command" in library.losses[0]


@pytest.mark.slow
@needs("cmake", "cc")
def test_cmake_installs_a_package_that_others_find(tmp_path: Path) -> None:
    folder = _auv().write(tmp_path).folder
    _run(["cmake", "-B", "build", "-D", f"CMAKE_INSTALL_PREFIX={tmp_path}/there"], folder)
    _run(["cmake", "--build", "build", "--target", "install"], folder)
    user = tmp_path / "user"
    user.mkdir()
    (user / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.10)\nproject(user C)\nfind_package(mini_auv REQUIRED)\n"
        "add_executable(user main.c)\ntarget_link_libraries(user mini_auv)\n"
    )
    shutil.copy(folder / "examples/vehicle/main.c", user / "main.c")
    _run(["cmake", "-B", "build", "-D", f"CMAKE_PREFIX_PATH={tmp_path}/there"], user)
    _run(["cmake", "--build", "build"], user)
    assert len(_run(["build/user"], user).split()) == 22


@needs("arm-none-eabi-gcc")
def test_it_fits_a_cortex_m4(tmp_path: Path) -> None:
    flags = (*STRICT, *ARM, SINGLE, "-Wdouble-promotion")
    flash, stacks = sizes(_auv(), "arm-none-eabi-gcc", *flags)
    assert set(flash) == {f"mini_auv_{part}.c" for part in PARTS}
    on_board = [flash[f"mini_auv_{part}.c"] for part in ("vehicle", "thrusters", "paper_pid")]
    assert 0 < sum(on_board) < 8_000
    stack = {s.function: s.stack for s in stacks}
    assert {"mini_auv_dynamics", "mini_auv_paper_pid_step", "mini_auv_usbl_ukf_predict"} <= set(stack)
    assert stack["mini_auv_paper_pid_step"] < 1_000


def test_the_command_prints_sizes_and_several_controllers_are_one_library(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["export", "c", "mini-auv", "--controller", "paper-pid", "--out", str(tmp_path)]
    assert main([*words, "--sizes", "no-such-compiler"]) == 2
    assert "'no-such-compiler' is not there" in capsys.readouterr().err
    assert main([*words, "--controller", "paper-pd"]) == 0
    said = capsys.readouterr().out
    assert "src/mini_auv_paper_pd.c is new" in said
    installed = [what for what, command in usual_compilers(_auv()) if shutil.which(command[0])]
    assert [what for what, _ in usual_compilers(_auv()) if f"Sizes by {what}, -Os" in said] == installed[:1]
    text = (tmp_path / "mini-auv/library.properties").read_text()
    parts = ("vehicle", "jacobians", "thrusters", "paper_pid", "paper_pd")
    assert "includes=" + ",".join(f"mini_auv_{p}.h" for p in parts) in text
    assert main([*words, "--controller", "paper-pid"]) == 2
    assert "'paper-pid' would be written as mini_auv_paper_pid.c, which is taken" in capsys.readouterr().err
