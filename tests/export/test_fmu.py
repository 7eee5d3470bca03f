"""Functional mock-up units, built and run by FMPy and compared with the model they come from."""

from __future__ import annotations

import shutil
import zipfile
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.quick import first_quick
from undertow.cli.main import main
from undertow.codegen import Functions, Simulator
from undertow.export.fmu import Fmu, Version
from undertow.model.loading import bundled_vehicles, load_vehicle

fmpy = pytest.importorskip("fmpy")
fmpy_build = pytest.importorskip("fmpy.build")
fmpy_validation = pytest.importorskip("fmpy.validation")
built = pytest.mark.skipif(
    not (shutil.which("cmake") and shutil.which("cc")), reason="FMPy builds with CMake and a C compiler"
)
VERSIONS: list[Version] = ["3.0", "2.0"]
CASES = [("mini-auv", "3.0"), ("mini-auv", "2.0")]
CASES += [(n, v) for n in bundled_vehicles() for v in VERSIONS if n != "mini-auv"]


def _unit(name: str, version: Version, folder: Path) -> tuple[Fmu, Path]:
    unit = Fmu(load_vehicle(name), version)
    path = folder / "unit.fmu"
    path.write_bytes(unit.archive())
    return unit, path


def _compiled(path: Path, folder: Path) -> Path:
    unpacked = Path(fmpy.extract(str(path), unzipdir=str(folder / "unit")))
    build = folder / "build"
    build.mkdir()
    fmpy_build.build_platform_binary(unpacked, build)
    return unpacked


def _driven(functions: Functions, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Commands that change every half second, and a slow start."""
    rng = np.random.default_rng(3)
    limits = functions.vehicle.command_limits
    largest = np.array([min(limits.get(n, 5.0), 5.0) for n in functions.vehicle.command_names])
    values = rng.uniform(-1, 1, (samples // 10 + 1, largest.size)) * largest
    start = np.zeros(len(functions.state_names))
    n = len(functions.vehicle.velocity_names)
    start[n : 2 * n] = rng.uniform(0.1, 0.3, n)
    return np.repeat(values, 10, axis=0)[:samples], start


@built
@pytest.mark.parametrize(("name", "version"), first_quick(CASES, 2))
def test_a_unit_is_valid_and_moves_as_the_model_does(name: str, version: Version, tmp_path: Path) -> None:
    unit, path = _unit(name, version, tmp_path)
    assert fmpy_validation.validate_fmu(str(path)) == []
    folder = _compiled(path, tmp_path)
    functions = Functions(unit.vehicle)
    t = 0.05 * np.arange(401)
    u, start = _driven(functions, len(t))
    expected = Simulator(functions).run(start, t, u, np.array(functions.values()))
    inputs = [v.name for v in unit.variables if v.causality == "input"]
    names = list(functions.state_names)
    found = fmpy.simulate_fmu(
        folder,
        fmi_type="CoSimulation",
        stop_time=t[-1],
        step_size=0.05,
        output_interval=0.05,
        start_values=dict(zip(names, start, strict=True)),
        input=np.array([(a, *b) for a, b in zip(t, u, strict=True)], [(n, float) for n in ("time", *inputs)])
        if inputs
        else None,
        output=names,
    )
    states = np.array([found[n] for n in names]).T
    assert np.isfinite(expected).all()
    assert np.abs(expected[-1]).max() > 0.05
    np.testing.assert_allclose(states, expected, rtol=1e-9, atol=1e-9)


@built
@pytest.mark.parametrize("version", first_quick(VERSIONS))
def test_model_exchange_gives_the_rates_forces_and_slopes_of_the_model(
    version: Version, tmp_path: Path
) -> None:
    unit, path = _unit("mini-auv", version, tmp_path)
    functions = Functions(unit.vehicle)
    model, setter, getter, slope = _exchange(unit, _compiled(path, tmp_path), version)
    rng = np.random.default_rng(5)
    place = {v.name: i for i, v in enumerate(unit.variables)}
    names = [*functions.state_names, *functions.vehicle.command_names]
    rates = [place[f"der({n})"] for n in functions.state_names]
    p = np.array(functions.values())
    for _ in range(5):
        x, u = rng.normal(size=len(functions.state_names)), rng.normal(size=functions.u.numel())
        setter([place[n] for n in names], [*x, *u])
        x_dot, a, b, by_p = (m.full() for m in functions.jacobians(x, u, p, 0))
        np.testing.assert_allclose(getter(rates), x_dot.ravel(), rtol=1e-12, atol=1e-13)
        # Thrust by B f, written out: the thrusters of this vehicle push in proportion to the command.
        force = np.array(unit.vehicle.allocation, float)[list(unit.vehicle.dof_indices)] @ u
        found = getter([i for n, i in place.items() if n.startswith("actuators_")])
        np.testing.assert_allclose(found, force, atol=1e-12)
        seed = rng.normal(size=3)
        known = [place["u"], place[unit.vehicle.command_names[0]], place["Y_v"]]
        column = functions.parameter_names.index("Y_v")
        expected = (
            seed[0] * a[:, names.index("u")] + seed[1] * b[:, 0] + seed[2] * by_p[:, column]
        )  # columns of A, B and P
        np.testing.assert_allclose(slope(rates, known, seed.tolist()), expected, rtol=1e-10, atol=1e-12)
    model.terminate()
    model.freeInstance()


@built
def test_a_thruster_of_a_unit_may_be_moved(tmp_path: Path) -> None:
    unit, path = _unit("mini-auv", "3.0", tmp_path)
    first, second, *others = unit.vehicle.thrusters
    moved = replace(second, wrench=(*second.wrench[:5], 0.4), position=(0.0, -0.4, 0.0))
    functions = Functions(replace(unit.vehicle, thrusters=(first, moved, *others)))
    t = 0.05 * np.arange(101)
    u = np.tile([-7.2, 0.5, -7.2, 0.3], (len(t), 1))
    start = np.zeros(len(functions.state_names))
    expected = Simulator(functions).run(start, t, u, np.array(functions.values()))
    inputs = [v.name for v in unit.variables if v.causality == "input"]
    found = fmpy.simulate_fmu(
        _compiled(path, tmp_path),
        fmi_type="CoSimulation",
        stop_time=t[-1],
        step_size=0.05,
        output_interval=0.05,
        start_values=dict(zip(inputs, u[0], strict=True)) | {"place_y_f2": -0.4},
        output=list(functions.state_names),
    )
    states = np.array([found[n] for n in functions.state_names]).T
    assert abs(expected[-1][3]) > 0.1  # it turns
    np.testing.assert_allclose(states, expected, rtol=1e-9, atol=1e-9)


def _exchange(unit: Fmu, folder: Path, version: Version) -> tuple[Any, ...]:
    """An instance for model exchange in continuous-time mode, with one way to talk to both versions."""
    from fmpy.fmi2 import FMU2Model
    from fmpy.fmi3 import FMU3Model

    third = version == "3.0"
    options = {"guid": unit.token, "unzipDirectory": str(folder), "modelIdentifier": unit.name}
    model = (FMU3Model if third else FMU2Model)(**options, instanceName="one")
    model.instantiate()
    if not third:
        model.setupExperiment()
    model.enterInitializationMode()
    model.exitInitializationMode()
    if third:
        return model, model.setFloat64, model.getFloat64, model.getDirectionalDerivative
    return model, model.setReal, model.getReal, model.getDirectionalDerivative


@built
def test_a_unit_steps_back_and_refuses_what_is_not_there(tmp_path: Path) -> None:
    from fmpy.fmi1 import FMICallException
    from fmpy.fmi3 import FMU3Slave

    unit, path = _unit("mini-auv", "3.0", tmp_path)
    folder = _compiled(path, tmp_path)
    options = SimpleNamespace(unzipDirectory=str(folder), modelIdentifier=unit.name, instanceName="one")
    model = FMU3Slave(guid=unit.token, **vars(options))
    model.instantiate()
    model.enterInitializationMode()
    model.exitInitializationMode()
    place = {v.name: i for i, v in enumerate(unit.variables)}
    command = place[unit.vehicle.command_names[0]]
    model.setFloat64([command], [3.0])
    model.doStep(0.0, 0.5)
    snapshot, before = model.getFMUState(), model.getFloat64([place["w"], place["z"]])
    model.doStep(0.5, 0.5)
    after = model.getFloat64([place["w"], place["z"]])
    assert after != before
    model.setFMUState(snapshot)
    assert model.getFloat64([place["w"], place["z"]]) == before
    model.doStep(0.5, 0.5)
    assert model.getFloat64([place["w"], place["z"]]) == after
    for refused in (place["der(u)"], len(unit.variables), place["time"]):
        with pytest.raises(FMICallException):
            model.setFloat64([refused], [1.0])
    with pytest.raises(FMICallException):
        model.setInt32([command], [1])
    model.freeFMUState(snapshot)
    model.freeInstance()
    other = FMU3Slave(guid="of another unit", **vars(options))
    with pytest.raises(Exception, match="nstantiate"):
        other.instantiate()


def test_the_command_writes_the_same_bytes_and_replaces_only_with_force(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    target = tmp_path / "auv.fmu"
    words = ["export", "fmu", "mini-auv", "--out", str(target)]
    assert main(words) == 0
    assert "4 inputs, 12 outputs" in capsys.readouterr().out
    first = target.read_bytes()
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
    assert main([*words, "--force"]) == 0
    assert target.read_bytes() == first
    with zipfile.ZipFile(target) as archive:
        assert set(archive.namelist()) == {
            "modelDescription.xml",
            "sources/buildDescription.xml",
            "sources/fmi3.c",
            "sources/fmu.h",
            "documentation/index.html",
        }


def test_what_the_unit_leaves_to_the_importer_is_said() -> None:
    from undertow.model.catalogue import catalogue
    from undertow.model.vehicle import Value

    vehicle = load_vehicle("mini-auv")
    late = vehicle.with_effect(catalogue()["actuation_delay"], {"delay": Value(0.2)})
    assert Fmu(late).losses == ["the commands act 0.2 s late: delay the inputs of the unit"]
