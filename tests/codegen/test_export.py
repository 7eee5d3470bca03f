"""Generated code for use without undertow: compiled as a user would, run, compared; changes and --check."""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.codegen.support import (
    BUNDLED,
    assert_close,
    functions_of,
    named_vehicle,
    random_point,
    vehicle_with,
)
from tests.quick import first_quick
from undertow import UndertowError
from undertow.cli.main import main
from undertow.codegen import Functions, Simulator
from undertow.codegen.compiler import Compiler
from undertow.codegen.library import Library
from undertow.codegen.source import digest
from undertow.model.effect import Curve
from undertow.model.loading import bundled_vehicles
from undertow.model.vehicle import Thruster, Value, Vehicle

STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-ffp-contract=off")
SANITIZERS = ("-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g")
posix = pytest.mark.skipif(sys.platform == "win32", reason="compiles with options of cc")
pytestmark = posix


def _compile(compiler: Compiler, folder: Path, *flags: str) -> None:
    command = [*compiler.command, *STRICT, *flags, *_vehicle_sources(folder), "-lm", "-o", "example"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def _vehicle_sources(folder: Path) -> list[str]:
    name = next((folder / "src").glob("*_vehicle.c")).name
    return ["-Isrc", f"src/{name}", "examples/vehicle/main.c"]


def _table(folder: Path) -> tuple[list[str], np.ndarray]:
    """What the example prints: its columns and numbers."""
    # A runtime that was preloaded for something else must not come before that of the sanitizers.
    environment = {k: v for k, v in os.environ.items() if k != "LD_PRELOAD"}
    done = subprocess.run(["./example"], cwd=folder, capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stderr) == (0, "")
    head, *rows = done.stdout.split()
    return head.split(","), np.array([row.split(",") for row in rows], dtype=float)


def _export(name: str, out: Path) -> Path:
    return Library(named_vehicle(name)).write(out).folder


# --- the code -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", BUNDLED)
def test_the_example_steps_the_model(name: str, c_compiler: Compiler, tmp_path: Path) -> None:
    folder = _export(name, tmp_path)
    _compile(c_compiler, folder, "-O1")
    columns, table = _table(folder)
    functions = functions_of(name)
    assert columns == ["t", *functions.state_names]
    t = 0.02 * np.arange(501)
    inputs = [float(f"{1 / (i + 1):.3g}") for i in range(functions.u.numel())]
    x0 = np.zeros(len(functions.state_names))
    x = Simulator(functions, compiled=False).run(
        x0, t, np.tile(inputs, (501, 1)), np.array(functions.values())
    )
    np.testing.assert_array_equal(table[:, 0], t[::25])
    np.testing.assert_allclose(table[:, 1:], x[::25], rtol=1e-11, atol=1e-13 * max(1.0, np.abs(x).max()))
    assert np.abs(table[-1, 1:]).max() > 0.1


@pytest.mark.parametrize("name", first_quick([*BUNDLED, "full"], 2))
def test_every_function_equals_the_virtual_machine(name: str, c_compiler: Compiler, tmp_path: Path) -> None:
    folder = _export(name, tmp_path)
    identifier = folder.name.replace("-", "_")
    sources = [f"src/{identifier}_{part}.c" for part in ("vehicle", "jacobians")]
    command = [*c_compiler.command, *STRICT, "-O1", "-shared", "-fPIC", *sources, "-lm", "-o", "model.so"]
    subprocess.run(command, cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "model.so"))
    functions = Functions(named_vehicle(name), named=True)
    point = random_point(functions, 8)
    values = {"x": point.x, "nu_dot": point.nu_dot, "u": point.u, "p": point.p, "t": point.t}
    for kind in ("dynamics", "jacobians", "residual_function", "regressor", "outputs"):
        function = getattr(functions, kind)
        results = [np.full(function.size_out(i), np.nan) for i in range(function.n_out())]
        arguments = [
            ctypes.c_double(point.t) if n == "t" else ctypes.c_void_p(values[n].ctypes.data)
            for n in function.name_in()
        ]
        called = getattr(library, f"{identifier}_{kind.removesuffix('_function')}")
        called(*arguments, *(ctypes.c_void_p(r.ctypes.data) for r in results))
        for found, expected in zip(
            results, function.call([values[n] for n in function.name_in()]), strict=True
        ):
            assert_close(found, np.array(expected))


def test_generated_code_is_clean_under_the_sanitizers(c_compiler: Compiler, tmp_path: Path) -> None:
    (tmp_path / "probe.c").write_text("int main(void) { return 0; }\n")
    probe = [*c_compiler.command, *SANITIZERS, "probe.c", "-o", "probe"]
    if subprocess.run(probe, cwd=tmp_path, capture_output=True).returncode:
        pytest.skip(f"{c_compiler.command[0]} has no address and undefined-behaviour sanitizers")
    folder = _export("mini-auv", tmp_path)
    _compile(c_compiler, folder, "-O1")
    plain = _table(folder)[1]
    _compile(c_compiler, folder, "-O1", *SANITIZERS)
    np.testing.assert_allclose(_table(folder)[1], plain, rtol=1e-12, atol=1e-13)


TANGENTS_MAIN = """
int main(void) {
  enum { RUNS = 2, SAMPLES = 5, ROWS = RUNS * SAMPLES, MOST = 16 };
  static double t[ROWS], u[ROWS * (NU + 1)], p[1000], x[ROWS * NX], s[ROWS * NX * COLUMNS];
  static double measured[ROWS * MOST], weight[ROWS * MOST], table[RUNS * (COLUMNS + 1) * (COLUMNS + 1)];
  static double squares[RUNS * MOST];
  int64_t steps[RUNS * (SAMPLES - 1)], group[ROWS] = {0};
  for (int i = 0; i < 1000; i++) p[i] = 1;
  for (int i = 0; i < ROWS * MOST; i++) weight[i] = 1;
  for (int i = 0; i < ROWS; i++) t[i] = 0.1 * (i % SAMPLES);
  for (int i = 0; i < RUNS * (SAMPLES - 1); i++) steps[i] = 1 + i % 3;
  for (int i = 0; i < ROWS * NU; i++) u[i] = 0.1;
  Logs logs = {SAMPLES, 0, SAMPLES - 1, SAMPLES, SAMPLES * NU, 0, SAMPLES - 1, SAMPLES * NX,
               t, u, p, steps, x, s, 1, 0, 0, 0, 0, 0};
  if (SIMULATE(&logs, RUNS) < 0) return 1;
  logs.x_stride = NX; /* and of the sensitivities, too, only those at the start of each run are read */
  logs.measured = measured, logs.weight = weight, logs.group = group;
  logs.table = table, logs.squares = squares;
  return SIMULATE(&logs, RUNS) < 0;
}
"""


ROLLOUT_MAIN = """
int main(void) {
  enum { GROUPS = 2, SAMPLES = 5 };
  static double t[SAMPLES * LANES], u[SAMPLES * NU * LANES], p[NP * LANES], x[GROUPS * SAMPLES * NX * LANES];
  static double count[SAMPLES * LANES];
  for (int i = 0; i < NP * LANES; i++) p[i] = 1;
  for (int i = 0; i < SAMPLES * LANES; i++) t[i] = 0.1 * (i / LANES), count[i] = 1 + i % 3;
  for (int i = 0; i < SAMPLES * NU * LANES; i++) u[i] = 0.1;
  const Logs logs = {SAMPLES, 0, 0, 0, 0, t, count, u, p, x};
  RUN(&logs, GROUPS);
  return 0;
}
"""


@pytest.mark.parametrize("lanes", first_quick([0, 1, 4, 8]))
def test_the_loops_are_clean_too(lanes: int, c_compiler: Compiler, tmp_path: Path) -> None:
    """Zero lanes: simulation with sensitivities."""
    from undertow.codegen.engine import rollout_source, tangents_source

    functions = functions_of("mini-auv")
    source = (
        rollout_source(functions, lanes)[0] if lanes else tangents_source(functions, [0, 3, *[-1] * 12])[0]
    )
    (tmp_path / "driver.c").write_text(source + (ROLLOUT_MAIN if lanes else TANGENTS_MAIN))
    for flags in ((), SANITIZERS):
        options = [*STRICT, "-Wno-psabi", "-O1", *flags]
        command = [*c_compiler.command, *options, "driver.c", "-lm", "-o", "driver"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        if flags and done.returncode:
            pytest.skip(f"{c_compiler.command[0]} has no address and undefined-behaviour sanitizers")
        assert done.returncode == 0, done.stderr
        environment = {k: v for k, v in os.environ.items() if k != "LD_PRELOAD"}
        run = subprocess.run(["./driver"], cwd=tmp_path, capture_output=True, text=True, env=environment)
        assert (run.returncode, run.stderr) == (0, "")


def test_the_code_that_casadi_loads_has_no_warnings(c_compiler: Compiler, tmp_path: Path) -> None:
    from undertow.codegen.source import c_source

    functions = functions_of("mini-auv")
    for function in (functions.dynamics, functions.jacobians, functions.regressor):
        (tmp_path / "it.c").write_text(c_source(function))
        command = [*c_compiler.command, *STRICT, "-c", "it.c"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


def test_the_header_serves_c_plus_plus(tmp_path: Path) -> None:
    compiler = shutil.which("c++")
    if compiler is None:
        pytest.skip("no C++ compiler on this machine")
    folder = _export("mini-auv", tmp_path)
    text = '#include "mini_auv_jacobians.h"\nint main() { return MINI_AUV_STATES - 8; }\n'
    (folder / "user.cpp").write_text(text)
    subprocess.run(
        [compiler, "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Isrc", "user.cpp"], cwd=folder, check=True
    )
    assert subprocess.run(["./a.out"], cwd=folder).returncode == 0


def test_cmake_builds_the_example(c_compiler: Compiler, tmp_path: Path) -> None:
    cmake = shutil.which("cmake")
    if cmake is None:
        pytest.skip("no cmake on this machine")
    folder = _export("box-hull", tmp_path)
    subprocess.run([cmake, "-S", folder, "-B", folder / "out"], check=True, capture_output=True)
    subprocess.run([cmake, "--build", folder / "out"], check=True, capture_output=True)
    assert (folder / "out" / "box_hull_vehicle").is_file()


def test_a_vehicle_without_inputs_is_valid_c(c_compiler: Compiler, tmp_path: Path) -> None:
    base = vehicle_with(dofs=("surge",), thrusters=0)
    vehicle = Vehicle("adrift", ("surge",), base.effects, {"m": Value(3.0), "X_u": Value(-1.0)})
    folder = Library(vehicle).write(tmp_path).folder
    _compile(c_compiler, folder)
    assert np.array_equal(_table(folder)[1][-1], [10, 0, 0])


@pytest.mark.parametrize(
    ("name", "folder"),
    [
        ('evil */ int x; /* "\n#error "\\', "evil-int-x-error"),
        ("../../etc/passwd", "etc-passwd"),
        ("7 Seas (Nr. 3)", "7-seas-nr-3"),
        ("Ünder-töw", "nder-t-w"),
        ("x" * 80, "x" * 60),
    ],
)
def test_any_name_gives_valid_c_in_its_own_folder(
    name: str, folder: str, c_compiler: Compiler, tmp_path: Path
) -> None:
    base = vehicle_with(dofs=("surge",), thrusters=0)
    found = Library(Vehicle(name, ("surge",), base.effects, {"m": Value(3.0)})).write(tmp_path).folder
    assert found == tmp_path / folder
    _compile(c_compiler, found)


def test_a_name_without_letters_is_reported() -> None:
    with pytest.raises(UndertowError, match="folder name"):
        Library(replace(named_vehicle("box-hull"), name="///"))


# --- manifest and changes -----------------------------------------------------------------------


def test_the_manifest_records_the_model(tmp_path: Path) -> None:
    vehicle = vehicle_with("lift", "actuation_delay", "thruster_lag", "radiation_memory", thrusters=2)
    vehicle = replace(vehicle, values={"m": Value(12.5), "delay": Value(0.3)})
    folder = Library(vehicle).write(tmp_path).folder
    content = json.loads((folder / "manifest.json").read_text())
    assert content["effects"] == [e.id for e in vehicle.effects]
    own = ("e_x", "e_y", "e_z", "lever_x", "lever_y", "lever_z")
    hardware = [f"{what}_{t.name}" for t in vehicle.thrusters for what in own]
    assert [p["name"] for p in content["parameters"]] == [*vehicle.parameter_names, *hardware]
    values = {p["name"]: (p["value"], p["unit"]) for p in content["parameters"]}
    assert values["m"] == (12.5, "kg")
    assert values["thrust_T1"] == (1.0, "N/command")
    units = {s["name"]: s["unit"] for s in content["states"]}
    assert (units["phi"], units["r"], units["memory_u"], units["lagged_T1"]) == (
        "rad",
        "rad/s",
        "m",
        "command",
    )
    assert [i["unit"] for i in content["inputs"]] == ["command", "command", "N", "N m"]
    assert content["input_delay"] == 0.3
    header = next((folder / "src").glob("*_vehicle.h"))
    assert content["files"][f"src/{header.name}"] == digest(header.read_text())
    assert "0.3 s late" in header.read_text()


def test_outputs_that_come_late_are_reported(tmp_path: Path) -> None:
    prompt = vehicle_with("linear_damping", thrusters=0)
    late = vehicle_with("linear_damping", "sensor_delay", thrusters=0)
    late = replace(late, values=late.values | {"velocity_delay": Value(0.15)})
    reported = _changes(prompt, late, tmp_path)
    assert "output delay of u: 0 -> 0.15 s" in reported
    assert not any(line.startswith("rows changed") for line in reported)
    folder = tmp_path / Library(late).folder_name
    assert json.loads((folder / "manifest.json").read_text())["output_delay"] == dict.fromkeys("uvw", 0.15)
    assert (
        "outputs u, v, w are reported 0.15 s late" in next((folder / "src").glob("*_vehicle.h")).read_text()
    )
    assert Library(late).check(tmp_path).changes == ()


def _changes(before: Vehicle, after: Vehicle, out: Path) -> tuple[str, ...]:
    Library(before).write(out)
    return Library(after).write(out).changes


def test_the_same_model_has_no_changes(tmp_path: Path) -> None:
    vehicle = named_vehicle("mini-auv")
    assert Library(vehicle).write(tmp_path).first
    report = Library(vehicle).write(tmp_path)
    assert (report.first, report.changes) == (False, ())
    assert Library(vehicle).check(tmp_path).changes == ()


def test_a_new_effect_is_reported_with_its_parameters_and_rows(tmp_path: Path) -> None:
    before = vehicle_with("linear_damping", thrusters=0)
    after = vehicle_with("linear_damping", "lift", thrusters=0)
    reported = _changes(before, after, tmp_path)
    assert reported[0] == "effects added: lift"
    assert reported[1] == "parameters added: Y_uv, N_uv, Y_ur, N_ur, Z_uw, M_uw, Z_uq, M_uq"
    assert reported[2] == "rows changed: v_dot, w_dot, q_dot, r_dot (4 of 12)"
    back = _changes(after, before, tmp_path)
    assert back[0] == "effects removed: lift"
    assert back[1].startswith("parameters removed: Y_uv")


def test_an_effect_of_backward_motion_is_seen(tmp_path: Path) -> None:
    before, after = vehicle_with(thrusters=0), vehicle_with("drag_asymmetry", thrusters=0)
    assert _changes(before, after, tmp_path)[-1] == "rows changed: u_dot, v_dot, w_dot (3 of 12)"


def test_a_new_value_is_reported(tmp_path: Path) -> None:
    before = named_vehicle("cybership2")
    after = before.with_values({"X_u": Value(-0.8)})
    assert _changes(before, after, tmp_path) == ("parameters changed: X_u -0.72253 N/(m/s) -> -0.8 N/(m/s)",)


def test_a_thruster_that_moved_has_another_place_in_the_struct(tmp_path: Path) -> None:
    before = named_vehicle("cybership2")
    first, *others = before.thrusters
    moved = replace(first, wrench=(*first.wrench[:5], 0.178), position=(-0.499, -0.178, 0.0))
    assert _changes(before, replace(before, thrusters=(moved, *others)), tmp_path) == (
        "parameters changed: place_y_T1 -0.078 m -> -0.178 m",
    )
    # A file that states the moment itself has that in the place of a position.
    stated = Thruster(first.name, first.wrench)
    report = _changes(before, replace(before, thrusters=(stated, *others)), tmp_path)
    assert report[:2] == (
        "parameters added: lever_z_T1",
        "parameters removed: place_x_T1, place_y_T1",
    )


def test_a_curve_of_thrust_comes_and_goes_as_one(tmp_path: Path) -> None:
    before = named_vehicle("cybership2")
    first, *others = before.thrusters
    bent = replace(first, law=Curve.through([(-1.0, -3.0), (0.0, 0.0), (1.0, 5.0)]))
    added, *_ = _changes(before, replace(before, thrusters=(bent, *others)), tmp_path)
    assert added.startswith(f"parameters added: curve_{first.name}")
    assert "curve_1_1" not in added


def test_another_order_and_another_vehicle_are_reported(tmp_path: Path) -> None:
    before = named_vehicle("cybership2")
    after = replace(before, name="CyberShip2", effects=tuple(reversed(before.effects)))
    reported = _changes(before, after, tmp_path)
    assert reported[0] == "vehicle: cybership2 -> CyberShip2"
    assert "effects in another order" in reported
    assert "parameters in another order" in reported


def test_a_damaged_manifest_is_reported_and_replaced(tmp_path: Path) -> None:
    vehicle = named_vehicle("box-hull")
    folder = Library(vehicle).write(tmp_path).folder
    for text in ("{", "[]", '{"schema": "undertow/codegen/9"}', '{"schema": "undertow/codegen/2"}', "\xff"):
        (folder / "manifest.json").write_text(text, encoding="latin-1")
        assert "manifest.json" in Library(vehicle).check(tmp_path).changes[0]
    Library(vehicle).write(tmp_path)
    assert Library(vehicle).check(tmp_path).changes == ()


def test_an_edited_example_is_kept_and_edited_code_is_not(tmp_path: Path) -> None:
    vehicle = named_vehicle("box-hull")
    folder = Library(vehicle).write(tmp_path).folder
    example, source = "examples/vehicle/main.c", "src/box_hull_vehicle.c"
    for name in (example, source):
        (folder / name).write_text("/* mine */")
    assert Library(vehicle).check(tmp_path).changes == (f"{source} is not as it was generated",)
    for _ in range(2):
        assert Library(vehicle).write(tmp_path).changes == (f"{example} was edited and is kept",)
    assert (folder / example).read_text() == "/* mine */"
    assert Library(vehicle).check(tmp_path).changes == ()
    (folder / example).unlink()
    assert Library(vehicle).write(tmp_path).changes == ()
    assert (folder / example).is_file()


def test_files_that_were_not_generated_are_not_overwritten(tmp_path: Path) -> None:
    (tmp_path / "box-hull").mkdir()
    (tmp_path / "box-hull" / "README.md").write_text("mine")
    with pytest.raises(UndertowError, match=r"README\.md' was there before and was not generated"):
        Library(named_vehicle("box-hull")).write(tmp_path)


def test_a_folder_that_cannot_be_made_is_reported(tmp_path: Path) -> None:
    (tmp_path / "build").write_text("a file")
    with pytest.raises(UndertowError, match="cannot make folder"):
        Library(named_vehicle("box-hull")).write(tmp_path / "build")


# --- the command --------------------------------------------------------------------------------


def test_the_command_writes_and_checks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "hull.toml"
    file.write_text(bundled_vehicles()["box-hull"].read_text())
    out = str(tmp_path / "build")
    folder = tmp_path / "build" / "box-hull"

    def run(*options: str) -> tuple[int, str]:
        code = main(["export", "c", str(file), "--out", out, *options])
        return code, capsys.readouterr().out.partition("\nSizes by")[0]

    assert run("--check") == (1, f"{folder}: missing; run undertow export c {file}\n")
    assert not folder.exists()
    assert run() == (0, f"{folder}: written\n  first time\n")
    assert run("--check") == (0, f"{folder}: current\n")
    assert run() == (0, f"{folder}: written\n  nothing has changed since the last time\n")
    file.write_text(file.read_text().replace("60.48 kg", "61 kg"))
    stale = "  parameters changed: m 60.48 kg -> 61.0 kg\n"
    before = {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    assert run("--check") == (1, f"{folder}: stale; run undertow export c {file}\n{stale}")
    assert {p: p.read_bytes() for p in folder.rglob("*") if p.is_file()} == before
    assert run() == (0, f"{folder}: written\n{stale}")


EFFECT = '''
import sympy as sm
from undertow.model.effect import Wrench
from undertow.model.parameter import Parameter

class Rope(Wrench):
    """A rope that pulls back."""
    id = "rope"
    family = "tether"
    reference = "none: for a test"
    k_rope = Parameter("N/m", "stiffness")

    def wrench(self, s):
        return sm.Matrix([-self.k_rope * s.eta[0], 0, 0, 0, 0, 0])
'''


def test_the_command_takes_effects_of_the_user_only_when_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "rope.py").write_text(EFFECT)
    file = tmp_path / "hull.toml"
    text = (
        bundled_vehicles()["box-hull"]
        .read_text()
        .replace('signs = "sname"', 'signs = "sname"\neffects_from = ["rope.py"]')
    )
    file.write_text(text + '\n[effects.rope]\nk_rope = "2 N/m"\n')
    assert main(["export", "c", str(file), "--out", str(tmp_path / "build")]) == 2
    assert "--effects" in capsys.readouterr().err
    effects = str(tmp_path / "rope.py")
    assert main(["export", "c", str(file), "--out", str(tmp_path / "build"), "--effects", effects]) == 0
    assert "k_rope; /* N/m */" in (tmp_path / "build/box-hull/src/box_hull_vehicle.h").read_text()


def test_the_command_needs_no_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNDERTOW_NO_COMPILER", "1")
    assert main(["export", "c", "box-hull", "--out", str(tmp_path)]) == 0
    assert json.loads((tmp_path / "box-hull" / "manifest.json").read_text())["compiler"] == "none"


def test_an_unknown_vehicle_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", "c", "boxhull", "--out", str(tmp_path)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())
