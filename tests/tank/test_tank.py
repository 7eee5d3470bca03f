"""The virtual towing tank: cases, runs with a stand-in for the solver, and what comes out of the logs."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.shape.hulls import box_mesh, cylinder_mesh, spheroid_mesh
from benchmarks.tank.__main__ import RESULTS
from benchmarks.tank.bodies import made, results
from benchmarks.tank.page import known_drag, page
from tests.tank.stand_ins import ADDED, LINEAR, QUADRATIC, stand_ins
from undertow.errors import UndertowError
from undertow.model.loading import load_vehicle
from undertow.shape.bodies import prolate_spheroid, sphere
from undertow.shape.mesh import Mesh, read_hull, stl_bytes
from undertow.tank.case import TankPlan, case_files, make_tank, write_tank
from undertow.tank.coefficients import (
    Record,
    coefficients,
    convergence,
    observed_order,
    read_record,
    tank_vehicle,
    write_record,
)
from undertow.tank.pictures import picture, read_section
from undertow.tank.run import read_forces, read_motion, read_results, run_tank
from undertow.tank.settings import (
    Case,
    Tank,
    duration,
    folder_of,
    log_of,
    motion,
    read_signal,
    read_tank,
    signal,
)

BOX = box_mesh((0.60, 0.42, 0.24))
PUSHED = TankPlan(60.48, profiles=("push", "step"), prescribed=True)


def _tank(orders: TankPlan, hull: Mesh | None = None) -> Tank:
    return _of_box(orders) if hull is None else make_tank(hull, orders, "hull.stl", "0" * 64)[0]


@cache
def _of_box(orders: TankPlan) -> Tank:
    return make_tank(BOX, orders, "hull.stl", "0" * 64)[0]


def _bent() -> Mesh:
    """A box whose bow leans forward: no mirror image of itself along or upright."""
    bow = (BOX.vertices[:, [0]] > 0) * (BOX.vertices[:, [2]] > 0)
    return Mesh(BOX.vertices + np.array([0.02, 0, 0]) * bow, BOX.faces)


# --- cases ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("prescribed", [True, False])
@pytest.mark.parametrize("speed", [0.3, 1.2])
def test_water_is_as_turbulent_as_the_speed_asks_for(speed: float, prescribed: bool) -> None:
    """k = 3/2 (I U)^2 with an intensity I of one per cent, whether the hull is moved or free."""
    orders = TankPlan(60.48, motions=("surge", "yaw"), profiles=("step",), prescribed=prescribed, speed=speed)
    for case in (tank := _tank(orders)).cases:
        k = re.search(r"internalField uniform (\S+);", case_files(tank, case, 1)["0/k"])
        assert k is not None
        assert float(k[1]) == pytest.approx(1.5 * (0.01 * speed) ** 2)


def test_the_files_of_a_case_are_whole_and_fit_together() -> None:
    tank = _tank(replace(PUSHED, motions=("surge", "yaw")))
    for case in tank.cases:
        for grid in (1, 2, 3):
            files = case_files(tank, case, grid)
            for name, text in files.items():
                assert text.count("{") == text.count("}"), name
                assert text.count("(") == text.count(")"), name
                assert "{{" not in text, name
            fields = {name for name in files if name.startswith("0/")}
            assert fields == ({"0/U", "0/p", "0/k", "0/omega", "0/nut"} if case.turbulent else {"0/U", "0/p"})
            # Every field has a condition on every boundary of the block, and on the hull.
            patches = {"hull", "far", '"cut.*"'}
            for name in fields:
                assert set(re.findall(r"^    (\S+) \{ type", files[name], re.M)) == patches, name
            block = files["system/blockMeshDict"]
            faces = re.findall(r"\((\d \d \d \d)\)", block)
            assert len(set(faces)) == 6  # all sides of the block, each once
            assert len(faces) == 6


def test_finer_grids_have_finer_cells_and_steps() -> None:
    tank = _tank(PUSHED)
    counts = []
    for grid in (1, 2, 3):
        block = case_files(tank, tank.cases[0], grid)["system/blockMeshDict"]
        counts.append(np.prod([int(w) for w in re.findall(r"\((\d+ \d+ \d+)\)", block)[0].split()]))
    assert counts[2] / counts[0] == pytest.approx(8, rel=0.05)
    assert tank.step_of(tank.cases[0], 3) == pytest.approx(tank.cases[0].step / 2)
    assert tank.cell == pytest.approx(0.03)


def test_layers_lie_where_the_law_of_the_wall_holds_on_all_grids() -> None:
    """The middle of the first is at y+ = 30 by the friction line of the ITTC: what wall functions ask for."""
    tank = _tank(replace(PUSHED, motions=("surge", "yaw")), box_mesh((0.6, 0.17, 0.11)))
    push, step, turn = (c for c in tank.cases if c.name in ("surge-push", "surge-step", "yaw-step"))
    assert push.layers is None
    assert step.layers is not None
    assert turn.layers == step.layers  # its ends go as fast
    friction = 0.075 / (np.log10(0.3 * 0.6 / 1e-6) - 2) ** 2
    first = step.layers.first
    assert first / 2 * 0.3 * np.sqrt(friction / 2) / 1e-6 == pytest.approx(30.0)
    thick = first * (step.layers.growth**step.layers.count - 1) / (step.layers.growth - 1)
    assert thick == pytest.approx(tank.cell, rel=0.15)
    # The cells at the hull are as large as in a push, all others twice as large.
    assert _cells(tank, step) == pytest.approx([2 * c for c in _cells(tank, push)])
    for grid in (1, 3):
        text = case_files(tank, step, grid)["system/snappyHexMeshDict"]
        assert f"nSurfaceLayers {step.layers.count};" in text
        assert f"firstLayerThickness {first};" in text
        assert f"level ({tank.level + 1} {tank.level + 1});" in text
    assert "addLayers false;" in case_files(tank, push, 1)["system/snappyHexMeshDict"]


def _cells(tank: Tank, case: Case) -> list[float]:
    """Sides of the cells far away on the coarsest grid, m."""
    block = case_files(tank, case, 1)["system/blockMeshDict"]
    corners = np.array([v.split() for v in re.findall(r"^    \(([^)]*)\)$", block, re.M)], dtype=float)
    counts = np.array(re.findall(r"\((\d+) (\d+) (\d+)\)", block)[0], dtype=float)
    return list(np.ptp(corners, axis=0) / counts)


def test_layers_are_as_thin_as_the_flow_and_the_cells_want() -> None:
    """None at a Reynolds number of 120, where the boundary layer is several cells thick; at 1.8e7 no thinner
    than an eighth of a cell, for thinner ones cannot follow a curved hull."""
    (slow,) = _tank(replace(PUSHED, profiles=("step",), viscosity=0.0015)).cases
    assert slow.layers is None
    tank = _tank(replace(PUSHED, profiles=("step",), viscosity=1e-8))
    assert tank.cases[0].layers is not None
    assert tank.cases[0].layers.first == pytest.approx(tank.cell / 8)


def test_water_is_cut_at_planes_of_symmetry_only() -> None:
    both = _tank(replace(PUSHED, motions=("surge", "yaw"), profiles=("push",)))
    assert [c.planes for c in both.cases] == [("y", "z"), ("z",)]
    one = _tank(replace(PUSHED, profiles=("push",)), _bent())
    assert [(c.name, c.planes) for c in one.cases] == [
        ("surge-push-forward", ("y",)),
        ("surge-push-backward", ("y",)),
    ]
    assert np.allclose(one.cases[0].signal, -np.array(one.cases[1].signal))


def test_a_hull_without_ends_has_walls_along_its_span() -> None:
    across = cylinder_mesh(2.0, 0.5, 48)
    hull = Mesh(across.vertices[:, [1, 0, 2]], across.faces[:, ::-1])  # along y
    tank = _tank(replace(PUSHED, profiles=("push",), span="y"), hull)
    assert tank.cases[0].planes == ("z",)
    assert tank.cell == pytest.approx(0.5 / 20)  # of the thickness, not of the length
    assert tank.share == pytest.approx(2 * tank.half[1] / 2.0)
    assert min(tank.half[0], tank.half[2]) >= 12 * 0.5  # plane flow fades slowly
    block = case_files(tank, tank.cases[0], 1)["system/blockMeshDict"]
    assert re.findall(r"\((\d+) (\d+) (\d+)\)", block)[0][1] == "1"  # one cell thick
    # Planes that meet are patches of their own: points of layers at their edge would slide off both.
    walls = dict(re.findall(r"(cut\w) \{[^}]*faces \(([^;]*)\);", block))
    assert walls == {"cuty": "(0 1 5 4) (3 7 6 2)", "cutz": "(0 3 2 1)"}
    with pytest.raises(UndertowError, match="sway is not in the plane normal to --span y"):
        _tank(replace(PUSHED, motions=("sway",), span="y"), hull)
    with pytest.raises(UndertowError, match="--span q is not an axis"):
        _tank(replace(PUSHED, span="q"), hull)


def test_the_surface_has_no_pressure_in_pushes_and_is_a_lid_else() -> None:
    orders = replace(PUSHED, depth=0.3)
    tank = _tank(orders)
    assert [c.planes for c in tank.cases] == [("y",), ("y",)]  # a surface leaves no mirror of up and down
    top, patches = "0 3 2 1", []
    for case in tank.cases:
        block = case_files(tank, case, 1)["system/blockMeshDict"]
        heights = {v.split()[2] for v in re.findall(r"^    \(([^)]*)\)$", block, re.M)}
        assert "-0.3" in heights  # z points down
        found = dict(re.findall(r"(\w+) \{ type patch; faces \(([^;]*)\);", block))
        patches.append(next(name for name, faces in found.items() if f"({top})" in faces))
    assert patches == ["far", "cutz"]
    both = _tank(replace(orders, motions=("heave",), profiles=("push",)))
    assert [c.direction for c in both.cases] == [1, -1]


@pytest.mark.parametrize(
    ("orders", "words"),
    [
        (TankPlan(60.48, depth=0.14), r"--depth 0.14 m: at least 0.15 m"),
        (TankPlan(60.48, depth=0.2, speed=1.0), r"surge-step at 1 m/s makes waves .* below 0.7 m/s"),
        (TankPlan(60.48, depth=0.3, motions=("heave",)), "longer heave than a push would leave the water"),
        (TankPlan(60.48, depth=0.3, span="z"), "--span z would leave the water"),
    ],
)
def test_hulls_that_leave_the_water_or_make_waves_are_refused(orders: TankPlan, words: str) -> None:
    with pytest.raises(UndertowError, match=words):
        _tank(orders)


def test_a_free_hull_is_forced_as_asked() -> None:
    tank = _tank(TankPlan(60.48, motions=("surge", "yaw"), profiles=("step",), force=5.0, inertia=2.0))
    surge, yaw = (case_files(tank, case, 1)["constant/dynamicMeshDict"] for case in tank.cases)
    assert "joint { type Px; }" in surge
    assert "mass 15.12;" in surge  # a quarter of the water, a quarter of the hull
    assert "(1.25 0 0)" in surge
    assert "(-1.25 0 0)" in surge
    assert "joint { type Rz; }" in yaw
    assert "inertia (1 0 0 1 0 1);" in yaw  # half of it
    # A force along y at x = 1 m is a moment about z.
    assert "location (1 0 0)" in yaw
    assert "(0 2.5 0)" in yaw
    # The added mass of a light hull asks for smaller corrections of the acceleration.
    light = _tank(TankPlan(7.5, profiles=("step",)))
    assert light.cases[0].relaxation == pytest.approx(7.5 / (7.5 + 20.6), rel=0.1)


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    tank, centred = make_tank(BOX.moved((1.0, 0, 0)), PUSHED, "hull.stl", "0" * 64)
    write_tank(tmp_path, tank, centred)
    again = read_tank(tmp_path)
    assert again.model_dump(exclude={"rules"}) == tank.model_dump(exclude={"rules"})
    assert again.rules["reach"] == 3.0
    hull = read_hull(tmp_path / "hull.stl").mesh
    assert hull.volume == pytest.approx(BOX.volume)
    assert np.allclose(hull.bounds, BOX.bounds, atol=1e-7)
    (tmp_path / "tank.toml").write_text(
        (tmp_path / "tank.toml").read_text().replace("density = 1000", "density = -1")
    )
    with pytest.raises(UndertowError, match="density"):
        read_tank(tmp_path)


# --- profiles -------------------------------------------------------------------------------------
@pytest.mark.parametrize("profile", ["push", "step", "sine"])
def test_a_prescribed_motion_starts_from_rest_and_is_smooth(profile: str) -> None:
    scale = 2.0
    end = duration(profile, scale)
    times, values = signal(profile, True, end, scale)
    at = np.linspace(0, end, 500)
    x, v, a = motion(times, 0.3 * values, at)
    assert v[0] == 0.0
    assert 0.29 < np.abs(v).max() <= 0.3 + 1e-9
    assert np.abs(np.gradient(x, at) - v)[1:-1].max() < 0.003
    assert np.abs(np.cumsum(a) * at[1] - v).max() < 0.03
    if profile == "push":
        assert x[-1] == pytest.approx(0.02 * 0.3 * scale, rel=1e-4)
        assert v[-1] == pytest.approx(0.0, abs=1e-9)


def test_the_profile_of_the_paper() -> None:
    times, values = signal("paper", False, 30.0, 2.0)
    force = 0.48 * np.interp([0.5, 10.0, 20.0, 29.0], times, values)
    assert force == pytest.approx([0.0, 0.32, -0.48, 0.22])


def test_a_users_profile(tmp_path: Path) -> None:
    path = tmp_path / "my.csv"
    path.write_text("t,force\n0,0\n1,2\n3,-1\n")
    tank = _tank(TankPlan(60.48, profiles=(str(path),)))
    assert (tank.cases[0].name, tank.cases[0].end, tank.cases[0].peak) == ("surge-my", 3.0, 2.0)
    assert tank.cases[0].signal == (0.0, 1.0, -0.5)
    path.write_text("0,0\n2,1\n1,1\n")
    with pytest.raises(UndertowError, match="times must increase"):
        read_signal(path)


# --- grid convergence -----------------------------------------------------------------------------
def test_grid_convergence_of_published_examples() -> None:
    # Pressure recovery of an inlet, NPARC Alliance (NASA), "Examining spatial (grid) convergence".
    found = convergence([0.97050, 0.96854, 0.96178], [1, 2, 4])
    assert found.order == pytest.approx(1.78618, abs=2e-5)
    assert found.extrapolated == pytest.approx(0.97130, abs=5e-6)
    assert found.index / found.value == pytest.approx(0.00103083, rel=1e-4)
    # Celik et al. (2008), Table 1, reattachment length.
    found = convergence([6.063, 5.972, 5.863], [1, 1.5, 1.5 * 1.333])
    assert found.order == pytest.approx(1.53, abs=0.01)
    assert found.extrapolated == pytest.approx(6.1685, abs=0.001)
    assert found.index / found.value == pytest.approx(0.022, abs=0.0005)


def test_grid_convergence_of_an_exact_power() -> None:
    sizes = np.array([1.0, 1.3, 2.1])
    assert observed_order(list(5 + 0.2 * sizes**1.7), list(sizes)) == pytest.approx(1.7, abs=1e-6)


def test_what_does_not_converge_gets_no_small_index() -> None:
    apart = convergence([1.0, 1.2, 1.3], [1, 2, 4])
    assert apart.kind == "running apart"
    assert apart.index == pytest.approx(0.9)
    waving = convergence([1.0, 1.2, 0.8], [1, 2, 4])
    assert waving.kind == "oscillating"
    assert waving.index >= 0.2
    assert convergence([2.0], [1]).index == pytest.approx(0.2)
    assert convergence([2.0], [1], drag=True).index == pytest.approx(1.6)
    assert convergence([2.0, 2.1], [1, 2]).index == pytest.approx(0.3)


# --- runs -----------------------------------------------------------------------------------------
@pytest.fixture
def solver(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A stand-in for OpenFOAM on the PATH."""
    folder = stand_ins(tmp_path / "bin", copies=4)
    monkeypatch.setenv("PATH", f"{folder}:/usr/bin:/bin")


def _written(tmp_path: Path, orders: TankPlan = PUSHED) -> tuple[Path, Tank]:
    tank, centred = make_tank(BOX, orders, "hull.stl", "0" * 64)
    write_tank(tmp_path / "tank", tank, centred)
    return tmp_path / "tank", tank


@pytest.mark.usefixtures("solver")
def test_logs_and_coefficients(tmp_path: Path) -> None:
    root, tank = _written(tmp_path)
    reported: list[tuple[float, str]] = []
    written = run_tank(root, tank, grids=2, progress=lambda done, words: reported.append((done, words)))
    assert len(written) == 4
    assert reported[-1][0] == pytest.approx(1.0)
    assert any("Courant" in words for _, words in reported)
    assert run_tank(root, tank, grids=2) == []  # all is there
    found = {c.name: c for c in coefficients(root, tank)}
    # The stand-in takes differences of the place, which are not quite the acceleration.
    assert found["X_udot"].value == pytest.approx(ADDED, rel=0.02)
    assert found["X_u"].value == pytest.approx(LINEAR, rel=0.05)
    assert found["X_uabsu"].value == pytest.approx(QUADRATIC, rel=0.02)
    assert all(c.sigma >= c.grid.index / 2 for c in found.values())
    path = tmp_path / "my.toml"
    path.write_text(tank_vehicle(tank, list(found.values()), "my"))
    vehicle = load_vehicle(path)
    assert vehicle.degrees_of_freedom == ("surge",)
    assert vehicle.values["X_udot"].value == pytest.approx(-found["X_udot"].value, rel=1e-5)
    assert vehicle.values["m"].value == pytest.approx(60.48)


def test_damping_of_a_turn_is_read_after_three_lengths_of_its_ends(tmp_path: Path) -> None:
    """Until the ends have gone three lengths (6 rad) the moment is not that of a steady turn."""
    root, tank = _written(tmp_path, replace(PUSHED, motions=("yaw",), profiles=("step",), grids=1))
    (case,) = tank.cases
    at = np.linspace(0.0, case.end, 600)
    psi, r, acceleration = motion(np.array(case.times), case.peak * np.array(case.signal), at)
    turned = psi - np.where(at < 2 / 3 * case.end, 0.0, np.interp(2 / 3 * case.end, at, psi))
    early = np.where(turned < 6.0, 1.5, 1.0)
    water = -0.6 * acceleration - 0.9 * early * np.abs(r) * r
    record = Record(at, np.zeros(600), psi, r, acceleration, water, 1, 1000, 1.0)
    write_record(log_of(root, case, 1), record, tank, case)
    write_record(
        log_of(root, case.model_copy(update={"name": "yaw-push"}), 1),
        Record(at, np.zeros(600), psi, r, acceleration, -0.6 * acceleration, 1, 1000, 1.0),
        tank,
        case,
    )
    push = case.model_copy(update={"name": "yaw-push", "profile": "push"})
    found = {c.name: c for c in coefficients(root, tank.model_copy(update={"cases": (case, push)}))}
    assert found["N_rabsr"].value == pytest.approx(0.9, rel=0.01)
    assert found["N_r"].value == pytest.approx(0.0, abs=0.01)


def test_a_direction_in_which_a_hull_hardly_went_is_left_out(tmp_path: Path) -> None:
    tank, hull = make_tank(_bent(), TankPlan(60.48, profiles=("paper",), grids=1), "hull.stl", "0" * 64)
    ahead = tank.model_copy(update={"cases": tank.cases[:1]})
    two = ahead.model_copy(update={"cases": (*ahead.cases, tank.cases[1].model_copy(update={"name": "b"}))})
    write_tank(tmp_path, two, hull)
    at = np.linspace(0.1, 30.0, 100)
    u = np.sin(at / 9.5)  # ahead but for the last two samples
    a = np.cos(at / 9.5) / 9.5
    water = -20.0 * a - 40.0 * np.abs(u) * u
    for case in two.cases:
        write_record(log_of(tmp_path, case, 1), Record(at, at, at, u, a, water, 1, 9, 1.0), two, case)
    found = coefficients(tmp_path, two)
    assert {c.way for c in found} == {"forward"}
    assert found[0].value == pytest.approx(20.0, rel=0.01)
    still = Record(at, at, at, 0 * u, a, water, 1, 9, 1.0)
    for case in two.cases:
        write_record(log_of(tmp_path, case, 1), still, two, case)
    with pytest.raises(UndertowError, match="0 samples are too few for damping"):
        coefficients(tmp_path, two)


@pytest.mark.usefixtures("solver")
def test_a_direction_counts_when_its_own_cases_are_done(tmp_path: Path) -> None:
    tank, hull = make_tank(_bent(), PUSHED, "hull.stl", "0" * 64)
    write_tank(tmp_path / "tank", tank, hull)
    run_tank(tmp_path / "tank", tank)
    log_of(tmp_path / "tank", tank.cases[3], 1).unlink()  # surge-step-backward
    found = coefficients(tmp_path / "tank", tank)
    assert [c.name for c in found] == ["X_udot", "X_u", "X_uabsu"]
    assert {c.direction for c in found} == {1}
    text = tank_vehicle(tank, found, "my")
    assert "forward only" in re.findall("X_uabsu = .*", text)[0]
    back = tank.model_copy(update={"cases": tuple(c for c in tank.cases if c.name == "surge-push-backward")})
    assert [(c.name, c.way) for c in coefficients(tmp_path / "tank", back)] == [("X_udot", "backward")]


@pytest.mark.usefixtures("solver")
def test_a_run_that_was_cut_off_goes_on(tmp_path: Path) -> None:
    root, tank = _written(tmp_path, replace(PUSHED, profiles=("push",)))
    case = tank.cases[0]
    (folder_of(root, case, 1) / "cut").touch()
    with pytest.raises(UndertowError, match=r"was killed .* .signal 9; .* again to resume"):
        run_tank(root, tank)
    assert not log_of(root, case, 1).exists()
    assert run_tank(root, tank) == ["surge-push-grid1.csv"]
    record = read_record(log_of(root, case, 1), 1)
    step = tank.step_of(case, 1)
    assert np.allclose(np.diff(record.time), step)  # nothing twice, nothing missing
    assert record.time[-1] == pytest.approx(case.end)
    assert record.cells == 1234
    assert record.push == pytest.approx(case.inertia * record.acceleration - record.water, abs=1e-4)
    assert len(list(folder_of(root, case, 1).glob("postProcessing/forces/*"))) == 2


@pytest.mark.usefixtures("solver")
def test_what_diverges_is_refused_with_the_reason(tmp_path: Path) -> None:
    root, tank = _written(tmp_path)
    (folder_of(root, tank.cases[0], 1) / "diverge").touch()
    with pytest.raises(UndertowError, match=r"diverged at t = .*Courant number 900, limit 50.*--time-step"):
        run_tank(root, tank)
    assert not list((root / "logs").iterdir())


@pytest.mark.usefixtures("solver")
def test_what_the_solver_refuses_is_not_called_diverged(tmp_path: Path) -> None:
    root, tank = _written(tmp_path)
    (folder_of(root, tank.cases[0], 1) / "fatal").touch()
    with pytest.raises(UndertowError, match="pimpleFoam stopped: Entry 'sigma' not found"):
        run_tank(root, tank)


def test_motion_and_forces_of_runs_that_were_taken_up_again(tmp_path: Path) -> None:
    def state(t: float, x: float, v: float) -> str:
        return (
            f"Time = {t}\n\nRigid-body motion of the hull\n    Centre of rotation: ({x} 0 0)\n"
            f"    Orientation: (1 0 0 0 1 0 0 0 1)\n    Linear velocity: ({v} 0 0)\n"
            "    Angular velocity: (0 0 0)\n"
        )

    rows = [(0.1, 1, 1), (0.2, 2, 2), (0.3, 9, 9), (0.2, 3, 3), (0.3, 4, 4)]
    (tmp_path / "log.pimpleFoam").write_text("".join(state(*row) for row in rows))
    assert read_motion(tmp_path, 0).T.tolist() == [[0.1, 1, 1], [0.2, 3, 3], [0.3, 4, 4]]
    for begun, text in (
        ("0", "# Time\n0.1 (1 2 3) (0 0 0)\n0.2 (9 9 9) (0 0 0)\n"),
        ("0.1", "0.2 (4 5 6) (0 0 0)\n"),
    ):
        folder = tmp_path / "postProcessing" / "forces" / begun
        folder.mkdir(parents=True)
        (folder / "force.dat").write_text(text)
    times, force = read_forces(tmp_path, 1)
    assert times.tolist() == [0.1, 0.2]
    assert force.tolist() == [2, 5]


@pytest.mark.parametrize("wobble", [0.0, 0.1])
def test_a_free_hull_whose_speed_is_not_that_of_the_forces_is_refused(tmp_path: Path, wobble: float) -> None:
    """Added mass is 20 kg; `wobble` of the force is what an iteration has left over."""
    tank = _tank(replace(PUSHED, prescribed=False, profiles=("push",)))
    (case,) = tank.cases
    t = np.linspace(0.0, case.end, 41)
    push = np.interp(t, case.times, case.peak * np.array(case.signal))
    a = push / (case.inertia + 20.0)
    v = np.concatenate([[0.0], np.cumsum((a[1:] + a[:-1]) / 2 * np.diff(t))])
    water = (-20.0 * a + wobble * case.peak) / case.copies
    moved = "".join(
        f"Time = {now}\n    Centre of rotation: (0 0 0)\n    Orientation: (1 0 0 0 1 0 0 0 1)\n"
        f"    Linear velocity: ({speed} 0 0)\n    Angular velocity: (0 0 0)\n"
        for now, speed in zip(t, v, strict=True)
    )
    (tmp_path / "log.pimpleFoam").write_text(moved)
    (tmp_path / "postProcessing" / "forces" / "0").mkdir(parents=True)
    rows = [f"{now} ({force} 0 0) (0 0 0) (0 0 0)" for now, force in zip(t, water, strict=True)]
    (tmp_path / "postProcessing" / "forces" / "0" / "force.dat").write_text("\n".join(rows))
    if wobble:
        with pytest.raises(UndertowError, match="away from that of its forces"):
            read_results(tank, case, 1, tmp_path, 1000)
    else:
        assert read_results(tank, case, 1, tmp_path, 1000).acceleration == pytest.approx(a)


def test_a_rotation_is_read_from_its_matrix(tmp_path: Path) -> None:
    c, s = np.cos(0.3), np.sin(0.3)
    (tmp_path / "log.pimpleFoam").write_text(
        "Time = 0.1\n    Centre of rotation: (0 0 0)\n"
        f"    Orientation: ({c} {s} 0 {-s} {c} 0 0 0 1)\n    Linear velocity: (0 0 0)\n"
        "    Angular velocity: (0 0 0.5)\n"
    )
    assert read_motion(tmp_path, 5)[:, 0] == pytest.approx([0.1, 0.3, 0.5])


# --- with OpenFOAM --------------------------------------------------------------------------------
def needs_openfoam(test: Callable[..., None]) -> Callable[..., None]:
    without = shutil.which("pimpleFoam") is None
    return pytest.mark.slow(pytest.mark.skipif(without, reason="OpenFOAM is not installed")(test))


def _measured(root: Path, hull: Mesh, orders: TankPlan) -> float:
    """The coefficient that the first case of a tank gives."""
    tank, centred = make_tank(hull, orders, "hull.stl", "0" * 64)
    one = tank.model_copy(update={"cases": tank.cases[:1]})
    write_tank(root, one, centred)
    run_tank(root, one)
    (found,) = coefficients(root, one)
    return found.value


@needs_openfoam
@pytest.mark.parametrize("prescribed", [True, False])
def test_added_mass_of_a_sphere_though_interrupted(tmp_path: Path, prescribed: bool) -> None:
    hull = spheroid_mesh(0.5, 0.5, 4)
    orders = TankPlan(1000 * hull.volume, profiles=("push",), prescribed=prescribed, grids=1)
    tank, centred = make_tank(hull, orders, "sphere.stl", "0" * 64)
    write_tank(tmp_path, tank, centred)

    def interrupt(done: float, words: str) -> None:
        if done > 0.6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_tank(tmp_path, tank, progress=interrupt)
    log = log_of(tmp_path, tank.cases[0], 1)
    assert not log.exists()
    run_tank(tmp_path, tank)
    rows = read_record(log, 1)
    assert np.allclose(np.diff(rows.time), tank.step_of(tank.cases[0], 1))  # nothing twice, nothing missing
    (found,) = coefficients(tmp_path, tank)
    assert found.value == pytest.approx(sphere(0.25).matrix[0, 0], rel=0.03)


@needs_openfoam
def test_added_mass_of_a_cylinder_without_ends(tmp_path: Path) -> None:
    across = cylinder_mesh(2.0, 0.5, 96)
    hull = Mesh(across.vertices[:, [1, 0, 2]], across.faces[:, ::-1])
    orders = TankPlan(393.0, profiles=("push",), prescribed=True, grids=1, span="y")
    lamb = 1000 * np.pi * 0.25**2 * 2.0  # of 2 m
    assert _measured(tmp_path, hull, orders) == pytest.approx(lamb, rel=0.03)


@needs_openfoam
def test_added_mass_of_a_sphere_below_the_surface(tmp_path: Path) -> None:
    """31.3 kg by panels below a free surface at high frequency; 32.7 kg far from it."""
    hull = spheroid_mesh(0.5, 0.5, 4)
    orders = TankPlan(1000 * hull.volume, motions=("heave",), profiles=("push",), prescribed=True, depth=0.5)
    assert _measured(tmp_path, hull, replace(orders, grids=1)) == pytest.approx(31.3, rel=0.03)


@needs_openfoam
def test_added_mass_of_a_spheroid_across(tmp_path: Path) -> None:
    hull = spheroid_mesh(0.6, 0.2, 4)
    orders = TankPlan(1000 * hull.volume, motions=("sway",), profiles=("push",), prescribed=True, grids=1)
    expected = prolate_spheroid(0.6, 0.2).matrix[1, 1]
    assert _measured(tmp_path, hull, orders) == pytest.approx(expected, rel=0.03)


@needs_openfoam
def test_steady_drag_of_a_cylinder(tmp_path: Path) -> None:
    """Water that moves with the body and flows in again at the outer boundary takes 5 to 9% off it."""
    run_tank(tmp_path / "cylinder-drag", made("cylinder-drag", tmp_path), grids=1)
    found = results("cylinder-drag", tmp_path / "cylinder-drag")
    assert [round(row["reynolds"]) for row in found] == [20, 40]
    for row in found:
        assert row["value"] == pytest.approx(known_drag(row), rel=0.02)


def test_a_section_is_read_and_drawn(tmp_path: Path) -> None:
    root, tank = _written(tmp_path, replace(PUSHED, profiles=("push",)))
    for time, speed in (("0.01", 1), ("0.02", 4)):
        folder = folder_of(root, tank.cases[0], 1) / "postProcessing" / "section" / time
        folder.mkdir(parents=True)
        (folder / "plane.vtk").write_text(
            "# vtk DataFile Version 2.0\nplane\nASCII\nDATASET POLYDATA\nPOINTS 4 float\n"
            "0.4 0 0.2 0.5 0 0.2 0.5 0 0.3\n0.4 0 0.3\n\nPOLYGONS 2 8\n3 0 1 2\n3 0 2 3\n"
            f"CELL_DATA 2\nFIELD FieldData 1\nU 3 2 float\n3 0 {speed}\n0 0 2\n"
        )
    time, points, triangles, speeds = read_section(folder_of(root, tank.cases[0], 1))
    assert (time, points.shape, triangles.tolist()) == (0.02, (4, 3), [[0, 1, 2], [0, 2, 3]])
    assert speeds.tolist() == [5.0, 2.0]
    assert read_section(folder_of(root, tank.cases[0], 1), at=0.012)[0] == 0.01
    drawn = picture(root, tank, tank.cases[0], 1, [])
    (cells, lines, *_) = drawn.axes[0].collections
    assert len(cells.get_paths()) == 4  # and their mirror images
    assert len(lines.get_paths()) == 2
    assert drawn.axes[0].get_ylim()[0] > drawn.axes[0].get_ylim()[1]  # z points down


def test_stl_is_read_back(tmp_path: Path) -> None:
    (tmp_path / "hull.stl").write_bytes(stl_bytes(spheroid_mesh(0.6, 0.2, 4)))
    assert read_hull(tmp_path / "hull.stl").mesh.volume == pytest.approx(
        spheroid_mesh(0.6, 0.2, 4).volume, rel=1e-6
    )


@pytest.mark.docs
def test_the_page_says_what_was_measured() -> None:
    rows = json.loads(RESULTS.read_text(encoding="utf-8"))
    assert page(rows) == Path("docs/tank.md").read_text(encoding="utf-8")
    known = {(r["body"], r["name"]): r["value"] / r["truth"] - 1 for r in rows if r.get("truth")}
    for body in ("box-forced", "box-bare"):
        del known[body, "X_udot"]  # the page says why
    for (body, name), off in known.items():
        # The AUV's panels are known to 2%.
        assert abs(off) < (0.05 if body.startswith("auv") else 0.03), (body, name)
    drag = {
        (r["body"], r["speed"]): r["value"] / k - 1
        for r in rows
        if r["name"] == "Cd" and (k := known_drag(r))
    }
    assert len(drag) == 6
    assert max(map(abs, drag.values())) < 0.03, drag
