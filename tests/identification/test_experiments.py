"""Logs of a towing tank or a planar motion mechanism: motions that a rig holds, and what comes of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import undertow as ut
from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.api import combine_fits
from undertow.identification.diagnose import experiments
from undertow.identification.logs.mapping import read_mapping
from undertow.identification.logs.reading import read_logs
from undertow.identification.logs.run import Run
from undertow.model.loading import load_vehicle
from undertow.model.symbols import DOFS, FORCE, POSE, VELOCITY
from undertow.model.vehicle import Value, Vehicle

NOISE = 2e-4  # m/s, rad/s
AXES = ("surge", "sway", "heave", "yaw")
TRUTH = {
    "X_udot": -1.2, "Y_vdot": -5.5, "Z_wdot": -9.0, "N_rdot": -0.08,
    "X_u": -0.9, "Y_v": -3.0, "Z_w": -4.0, "N_r": -0.06,
    "X_uabsu": -3.5, "Y_vabsv": -24.0, "Z_wabsw": -30.0, "N_rabsr": -0.15,
}  # fmt: skip
FILE = """
schema = "undertow/vehicle/1"
name = "small"
degrees_of_freedom = ["surge", "sway", "heave", "yaw"]
signs = "sname"
generalised_forces = ["tau_X", "tau_Y", "tau_Z", "tau_N"]
[effects.rigid_body]
m = "7.5 kg"
I_z = "0.17 kg m^2"
[effects.rigid_body_coriolis]
[effects.added_mass]
X_udot = { value = "-1.2 kg", estimate = true }
Y_vdot = { value = "-5.5 kg", estimate = true }
Z_wdot = { value = "-9 kg", estimate = true }
N_rdot = { value = "-0.08 kg m^2", estimate = true }
[effects.added_mass_coriolis]
[effects.linear_damping]
X_u = { value = "-0.9 kg/s", estimate = true }
Y_v = { value = "-3 kg/s", estimate = true }
Z_w = { value = "-4 kg/s", estimate = true }
N_r = { value = "-0.06 kg m^2/s", estimate = true }
[effects.quadratic_damping]
X_uabsu = { value = "-3.5 kg/m", estimate = true }
Y_vabsv = { value = "-24 kg/m", estimate = true }
Z_wabsw = { value = "-30 kg/m", estimate = true }
N_rabsr = { value = "-0.15 kg m^2", estimate = true }
"""
INERTIA = {"surge": 7.5 + 1.2, "sway": 7.5 + 5.5, "heave": 7.5 + 9.0, "yaw": 0.17 + 0.08}
PEAK = {"surge": 1.2, "sway": 5.0, "heave": 6.0, "yaw": 0.08}


@pytest.fixture
def vehicle(tmp_path: Path) -> Vehicle:
    (tmp_path / "small.toml").write_text(FILE, encoding="utf-8")
    return load_vehicle(tmp_path / "small.toml")


def _force(axis: str, t: np.ndarray) -> np.ndarray:
    """Steps that push ahead, let go and push back."""
    return PEAK[axis] * np.array([0.6, 1.0, 0.0, -0.8, -0.4, 0.9])[(t / 5.0).astype(int) % 6]


def _towed(axis: str, seed: int, quadratic: float = 1.0) -> tuple[np.ndarray, ...]:
    """Time, force, place and speed of one motion by itself, m v' = F - d v - q |v| v; 30 s at 20 Hz."""
    place, t = DOFS.index(axis), np.arange(0.0, 30.0, 0.05)
    speed, force = VELOCITY[place], FORCE[place]
    d, q = -TRUTH[f"{force}_{speed}"], -quadratic * TRUTH[f"{force}_{speed}abs{speed}"]
    push, fine = _force(axis, t), 20
    v, x, rows = 0.0, 0.0, []
    for f in push:
        rows.append((x, v))
        for _ in range(fine):
            h = 0.05 / fine
            middle = v + h / 2 * (f - d * v - q * abs(v) * v) / INERTIA[axis]
            x, v = x + h * middle, v + h * (f - d * middle - q * abs(middle) * middle) / INERTIA[axis]
    x_true, v_true = np.array(rows).T
    rng = np.random.default_rng(seed)
    return t, push, x_true + NOISE * rng.standard_normal(len(t)), v_true + NOISE * rng.standard_normal(len(t))


def towing_log(folder: Path, axis: str, seed: int, quadratic: float = 1.0) -> Path:
    place = DOFS.index(axis)
    head = ",".join(["t", f"tau_{FORCE[place]}", POSE[place], VELOCITY[place]])
    path = folder / f"{axis}.csv"
    table = np.column_stack(_towed(axis, seed, quadratic))
    np.savetxt(path, table, delimiter=",", header=head, comments="", fmt="%.9g")
    return path


def _off(vehicle: Vehicle, by: float) -> Vehicle:
    return vehicle.with_values({n: Value(by * value, True, 0.6 * abs(value)) for n, value in TRUTH.items()})


@pytest.mark.slow
def test_all_axes_come_back_from_logs_of_one_motion_each(tmp_path: Path, vehicle: Vehicle) -> None:
    paths = [towing_log(tmp_path, axis, seed) for seed, axis in enumerate(AXES)]
    start = _off(vehicle, 0.6)
    runs = read_logs(paths, start, held="unlogged")
    parts = experiments(start, runs)
    assert [part.vehicle.degrees_of_freedom for part in parts] == [(axis,) for axis in AXES]
    assert str(parts[0]) == (
        "surge free; sway, heave and yaw held at rest; driven by external forces (surge)"
    )
    together = combine_fits(start, [ut.fit(part.vehicle, part.train) for part in parts])
    assert set(together.names) == set(TRUTH)
    assert not list(together.disagreements())
    found, errors = together.vehicle, together.errors
    assert found.degrees_of_freedom == AXES
    for name, value in TRUTH.items():
        assert abs(found.values[name].value - value) < 4 * errors[name] + 0.002 * abs(value), name
        assert errors[name] < 0.1 * abs(value), name


def test_a_log_that_says_nothing_of_a_motion_is_refused_unless_it_is_held(
    tmp_path: Path, vehicle: Vehicle
) -> None:
    path = towing_log(tmp_path, "surge", 0)
    with pytest.raises(UndertowError, match="no command channel 'tau_Y'"):
        read_logs([path], vehicle)
    (run,) = read_logs([path], vehicle, held=("sway", "heave", "yaw"))
    assert run.held == ("sway", "heave", "yaw")
    with pytest.raises(UndertowError, match="in run 'surge' a rig holds sway, heave, yaw of 'small'"):
        ut.fit(vehicle, [run])
    bare = replace(run, channels={n: v for n, v in run.channels.items() if n != "tau_X"})
    with pytest.raises(UndertowError, match=r"run 'surge' has neither the forces tau_X of what is free"):
        experiments(vehicle, [bare])
    with pytest.raises(UndertowError, match="no free motion of 'small'"):
        experiments(vehicle, [replace(run, held=AXES)])
    with pytest.raises(
        UndertowError, match="no training log has the free motions of this validation log: surge"
    ):
        experiments(vehicle, [replace(run, held=())], [run])


def test_the_mapping_beside_a_log_says_what_is_held(tmp_path: Path, vehicle: Vehicle) -> None:
    path = towing_log(tmp_path, "yaw", 3)
    (tmp_path / "yaw.toml").write_text('schema = "undertow/mapping/1"\nheld = "unlogged"\n', encoding="utf-8")
    assert read_mapping(tmp_path / "yaw.toml").held == "unlogged"
    (run,) = read_logs([path], vehicle)
    assert set(run.held) == {"surge", "sway", "heave", "roll", "pitch"}
    # A vehicle file of the same name is none.
    (tmp_path / "yaw.toml").write_text(FILE, encoding="utf-8")
    with pytest.raises(UndertowError, match="no command channel"):
        read_logs([path], vehicle)


def test_a_motion_that_the_rig_moves_acts_on_what_is_free(vehicle: Vehicle) -> None:
    """A planar motion mechanism: surge at a given speed; forces in sway and yaw are those of all motions."""
    t = np.arange(0.0, 1.0, 0.1)
    names = ("u", "v", "r", "y", "psi", "tau_Y", "tau_N")
    run = Run("pmm", t, dict.fromkeys(names, np.ones_like(t)), held=("surge", "heave"))
    (part,) = experiments(vehicle, [run])
    assert part.moved == ("u",)
    assert part.held == ("heave",)
    assert part.vehicle.command_names == ("tau_Y", "tau_N", "u")
    whole, reduced = Functions(vehicle), Functions(part.vehicle)
    u, v, r, v_dot, r_dot = 0.9, 0.2, -0.4, 0.3, 0.5
    force = whole.residual_function(
        [0, 0, 0, 0, u, v, 0, r], [0, v_dot, 0, r_dot], [1, 2, 3, 4], whole.values(), 0
    )
    alone = reduced.residual_function([0, 0, v, r], [v_dot, r_dot], [2, 4, u], reduced.values(), 0)
    assert np.array(alone).ravel() == pytest.approx(np.array(force).ravel()[[1, 3]], rel=1e-12)
    # It does act: Munk's moment (X_udot - Y_vdot) u v is in it.
    still = reduced.residual_function([0, 0, v, r], [v_dot, r_dot], [2, 4, 0], reduced.values(), 0)
    assert np.array(alone - still).ravel()[1] == pytest.approx((5.5 - 1.2) * u * v * -1, rel=1e-9)


def test_the_vehicles_own_actuators_are_off_where_the_rig_gives_forces() -> None:
    auv = load_vehicle("mini-auv")
    t = np.arange(0.0, 1.0, 0.1)
    run = Run("towed", t, {"u": t, "x": t, "tau_X": t}, held=("sway", "heave", "roll", "pitch", "yaw"))
    (part,) = experiments(auv, [run])
    assert part.vehicle.command_names == ("tau_X",)
    assert part.pushed
    own = Run("own", t, {n: t for n in ("u", "x", *auv.command_names)}, held=run.held)
    (part,) = experiments(auv, [own])
    assert part.vehicle.actuator_names == auv.actuator_names
    assert not part.pushed


def test_experiments_that_disagree_are_reported(vehicle: Vehicle) -> None:
    """The mass is shared: the truth has another one in heave, which added mass cannot take up."""
    names = {"m": Value(7.5, True, 1.0)}
    shared = vehicle.with_values({n: replace(v, estimate=False) for n, v in vehicle.values.items()} | names)
    runs = []
    for axis, mass in (("surge", 7.5), ("heave", 9.0)):
        place, t = DOFS.index(axis), np.arange(0.0, 30.0, 0.05)
        own = shared.constrained([axis]).with_values({"m": Value(mass)})
        model = ut.compile(own)
        force = _force(axis, t)
        states = model.simulate(np.zeros(2), force[:, None], 0.05)[: len(t)]
        rng = np.random.default_rng(place)
        speed = states[:, 1] + NOISE * rng.standard_normal(len(t))
        channels = {VELOCITY[place]: speed, POSE[place]: states[:, 0], f"tau_{FORCE[place]}": force}
        held = tuple(d for d in AXES if d != axis)
        runs.append(Run(axis, t, channels, held=held))
    parts = experiments(shared, runs)
    together = combine_fits(shared, [ut.fit(part.vehicle, part.train, method="weak") for part in parts])
    (line,) = together.disagreements()
    assert line.startswith("m is 7.5")
    assert "by surge and 9" in line
    assert 7.5 < together.values["m"] < 9.0
    one, other = (fit.standard_errors["m"] for fit in together.fits)
    assert together.errors["m"] == pytest.approx((one**-2 + other**-2) ** -0.5, rel=1e-3)
