"""Thrusters may be called as one likes: directions and roles belong to structure, never to names."""

from __future__ import annotations

import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from undertow.codegen.functions import Functions
from undertow.codegen.simulate import Simulator
from undertow.control.linear.numeric import motion_of, reversing
from undertow.identification.diagnosis.addition import add_effects, set_up_addition
from undertow.identification.diagnosis.candidates import candidates
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.plausibility import hints
from undertow.model.saving import save_vehicle
from undertow.model.vehicle import Value, Vehicle

PLAIN = ("a", "b", "c")
ODD = [
    ("port_forward", "aft_backward", "port"),
    ("f1", "f1_forward", "f1_backward"),
    ("gain_f1", "gain_error_f1", "f1"),
    ("forward", "backward", "forward_forward"),
    ("X_u_forward", "X_u", "command_X_u"),
]
VEHICLE = """\
schema = "undertow/vehicle/1"
name = "trio"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"

[effects.rigid_body]
m = 20.0
I_z = 1.5

[effects.linear_damping]
X_u = {{ forward = -4.0, backward = -6.0, estimate = true }}
Y_v = {{ value = -12.0, estimate = true }}
N_r = {{ value = -1.5, estimate = true }}

[[thrusters]]
name = "{}"
wrench = [1, 0, 0, 0, 0, 0.2]

[[thrusters]]
name = "{}"
wrench = [1, 0, 0, 0, 0, -0.2]

[[thrusters]]
name = "{}"
wrench = [0, 1, 0, 0, 0, 0.3]
"""
Load = Callable[[tuple[str, ...]], Vehicle]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def with_thrusters(names: tuple[str, ...]) -> Vehicle:
        (tmp_path / "trio.toml").write_text(VEHICLE.format(*names))
        return load_vehicle(tmp_path / "trio.toml")

    return with_thrusters


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, np.ndarray]]:
    """Two runs of 40 s in which the second thruster gives 60% of what it is told; noise of 1 cm/s."""
    file = tmp_path_factory.mktemp("truth") / "trio.toml"
    file.write_text(VEHICLE.format(*PLAIN) + "\n[effects.thruster_gain]\ngain_error_b = -0.4\n")
    truth = Functions(load_vehicle(file))
    rng, found = np.random.default_rng(11), []
    for _ in range(2):
        t = np.arange(0.0, 40.0, 0.1)
        u = np.repeat(rng.uniform(-6, 6, (20, 3)), 20, axis=0)
        x = Simulator(truth, compiled=False).run(np.zeros(6), t, u, truth.values(), max_step=0.1)
        noisy = x + rng.normal(size=x.shape) * [0.01, 0.01, 0.003, 0.01, 0.01, 0.002]
        columns = dict(zip(("x", "y", "psi", "u", "v", "r"), noisy.T, strict=True))
        found.append({"t": t, **columns, **dict(zip(PLAIN, u.T, strict=True))})
    return found


def _as_runs(columns: list[dict[str, np.ndarray]], names: tuple[str, ...]) -> list[Run]:
    other = dict(zip(PLAIN, names, strict=True))
    reported = [{other.get(k, k): v for k, v in c.items() if k != "t"} for c in columns]
    return [Run(f"run{i}", c["t"], t) for i, (c, t) in enumerate(zip(columns, reported, strict=True))]


# --- in the model ---------------------------------------------------------------------------------
@pytest.mark.parametrize("names", ODD, ids=str)
def test_only_what_a_declaration_says_has_directions(names: tuple[str, ...], load: Load) -> None:
    vehicle = load(names).with_effect(
        catalogue()["thruster_gain"], {f"gain_error_{n}": Value(0.1, True) for n in names}
    )
    for thruster in names:
        parameter = vehicle.declaration(f"gain_error_{thruster}")
        assert parameter.name == f"gain_error_{thruster}"
        assert parameter.motion is None
    assert vehicle.declaration("X_u_backward").name == "X_u"
    assert vehicle.sides["X_u_forward"][1] == "forward"
    assert {str(x) for x in vehicle.composition.split} == {"X_u"}
    assert reversing(vehicle) == ("u",)
    assert motion_of(vehicle, f"gain_error_{names[0]}") is None
    assert hints(vehicle)


@pytest.mark.parametrize("names", ODD, ids=str)
def test_the_equations_are_those_of_plain_names(names: tuple[str, ...], load: Load) -> None:
    x, u = [0.1, 0.2, 0.3, 0.4, -0.5, 0.6], [1.0, -2.0, 3.0]
    gains = catalogue()["thruster_gain"]

    def rates(thrusters: tuple[str, ...]) -> np.ndarray:
        values = {f"gain_error_{n}": Value(g) for n, g in zip(thrusters, (0.1, -0.2, 0.3), strict=True)}
        functions = Functions(load(thrusters).with_effect(gains, values))
        return np.array(functions.dynamics(x, u, functions.values(), 0.0)).ravel()

    np.testing.assert_allclose(rates(names), rates(PLAIN), rtol=1e-14)


@pytest.mark.parametrize("names", ODD, ids=str)
def test_a_file_keeps_every_gain_to_its_thruster(names: tuple[str, ...], load: Load, tmp_path: Path) -> None:
    values = {f"gain_error_{n}": Value(0.01 * (i + 1), True, 0.001) for i, n in enumerate(names)}
    vehicle = load(names).with_effect(catalogue()["thruster_gain"], values)
    save_vehicle(vehicle, tmp_path / "trio.toml", tmp_path / "out.toml")
    table = tomllib.loads((tmp_path / "out.toml").read_text())["effects"]["thruster_gain"]
    assert {n: entry["value"] for n, entry in table.items()} == {n: v.value for n, v in values.items()}
    again = load_vehicle(tmp_path / "out.toml")
    assert {n: v.value for n, v in again.values.items()} == {n: v.value for n, v in vehicle.values.items()}


# --- with logs ------------------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.parametrize(
    "names", [ODD[0], *(pytest.param(n, marks=pytest.mark.slow) for n in ODD[1:])], ids=str
)
def test_the_weak_thruster_is_found_whatever_it_is_called(
    names: tuple[str, ...], load: Load, runs: list[dict[str, np.ndarray]]
) -> None:
    vehicle, (train, test) = load(names), _as_runs(runs, names)
    known = catalogue()
    gain = next(c for c in candidates(vehicle, known) if c.id == "thruster_gain")
    assert [p.name for p in gain.parameters] == [f"gain_error_{n}" for n in names]
    added = add_effects([known["thruster_gain"]], set_up_addition(vehicle, [train], [test]))
    assert added.helps
    assert added.kept == (f"gain_error_{names[1]}",)
    assert added.fit.values[added.kept[0]] == pytest.approx(-0.4, abs=0.02)


def test_a_fit_moves_the_gain_of_an_oddly_named_thruster(
    load: Load, runs: list[dict[str, np.ndarray]]
) -> None:
    names = ODD[0]
    values = {f"gain_error_{n}": Value(0.0, True) for n in names}
    vehicle = load(names).with_effect(catalogue()["thruster_gain"], values)
    data = prepare(_as_runs(runs, names), vehicle)
    found = fit_weak(vehicle, data).values
    assert found["gain_error_aft_backward"] == pytest.approx(-0.4, abs=0.02)
    assert found["X_u_forward"] == pytest.approx(-4.0, rel=0.05)
    assert found["X_u_backward"] == pytest.approx(-6.0, rel=0.05)
