"""Propellers by their revolutions, and thrust over the command by a curve from a test bench."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

import undertow as ut
from undertow.codegen.functions import Functions
from undertow.identification.logs.mapping import Channel, Column, LogMapping
from undertow.identification.logs.reading import read_logs
from undertow.model.effect import Curve, Propeller
from undertow.model.loading import load_vehicle
from undertow.model.saving import save_vehicle
from undertow.model.vehicle import Value, Vehicle

BODY = """
schema = "undertow/vehicle/1"
name = "craft"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"

[effects.rigid_body]
m = "100 kg"
I_z = "20 kg m^2"

[effects.linear_damping]
X_u = "-10 kg/s"
Y_v = "-50 kg/s"
N_r = "-20 kg m^2/s"

[[thrusters]]
name = "prop"
position = ["-1 m", "0.2 m", "0 m"]
direction = [1, 0, 0]
"""
PROPELLER = """
[thrusters.propeller]
diameter = "20 cm"
K_T0 = { value = 0.45, estimate = true }
K_T1 = -0.4
wake_fraction = 0.2
thrust_deduction = 0.1
revolutions = "rpm"
"""
# A T200 at 16 V, by its data sheet, thinned: pulse width in us over thrust in N.
T200 = [(1100, -40.0), (1200, -26.6), (1300, -14.2), (1400, -4.6), (1472, 0.0), (1528, 0.0)]
T200 += [(1600, 5.9), (1700, 18.1), (1800, 34.0), (1900, 51.5)]


def _load(folder: Path, text: str) -> Vehicle:
    file = folder / "craft.toml"
    file.write_text(BODY + text)
    return load_vehicle(file)


def _thrust(vehicle: Vehicle, command: float, nu: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> np.ndarray:
    """Force and moment of the thrusters: the residual less that without a command."""
    f = Functions(vehicle)
    x = np.concatenate([np.zeros(3), nu])
    given, idle = (f.residual_function(x, np.zeros(3), [u], f.values(), 0.0) for u in (command, 0.0))
    return np.array(given - idle, dtype=float)[:, 0]


@pytest.mark.parametrize(("rpm", "u", "r"), [(600.0, 0.0, 0.0), (600.0, 1.5, 0.3), (-400.0, 0.5, 0.0)])
def test_thrust_follows_revolutions_and_advance(tmp_path: Path, rpm: float, u: float, r: float) -> None:
    vehicle, n = _load(tmp_path, PROPELLER), rpm / 60
    advance = 0.8 * (u - 0.2 * r)
    thrust = 0.9 * 1000.0 * 0.2**4 * (0.45 * abs(n) * n - 0.4 * abs(n) * advance / 0.2)
    found = _thrust(vehicle, rpm, (u, 0.0, r))
    np.testing.assert_allclose(found, [thrust, 0.0, -0.2 * thrust], rtol=1e-9, atol=1e-9)
    assert vehicle.command_units == {"prop": "rpm"}
    assert "thrust_prop" not in vehicle.parameter_names


def _with_revolutions(folder: Path, unit: str) -> tuple[Vehicle, Path]:
    """The craft with its command in a unit, and a log with 600 revolutions a minute in column n."""
    log = folder / "run.csv"
    log.write_text("t,x,y,psi,u,v,r,n\n" + "".join(f"{k / 10},0,0,0,{k % 3},1,0,600\n" for k in range(20)))
    return _load(folder, PROPELLER.replace('"rpm"', f'"{unit}"')), log


@pytest.mark.parametrize(("unit", "speed"), [("rpm", 600.0), ("rev/s", 10.0), ("rad/s", 20 * np.pi)])
def test_a_speed_with_its_unit_becomes_what_the_vehicle_counts(
    tmp_path: Path, unit: str, speed: float
) -> None:
    vehicle, log = _with_revolutions(tmp_path, unit)
    for columns, channels in (
        ({"n": Column(channel="prop", unit="rpm")}, {}),
        ({}, {"prop": Channel(expression="n / 60", unit="rev/s")}),
    ):
        mapping = LogMapping(columns=columns, channels=channels)
        (run,) = read_logs([log], vehicle, mapping)
        for read in (run, ut.read_log(log, mapping, vehicle=vehicle)):
            np.testing.assert_allclose(read.channels["prop"], speed, rtol=1e-12)


def test_a_log_whose_motions_a_rig_holds_needs_no_commands_but_has_them_if_it_can(tmp_path: Path) -> None:
    vehicle, log = _with_revolutions(tmp_path, "rev/s")
    mapping = LogMapping(columns={"n": Column(channel="prop", unit="rpm")}, held=("yaw",))
    assert ut.read_log(log, mapping, vehicle=vehicle).has("prop")
    towed = LogMapping(columns={"n": Column(channel="speed_of_the_carriage")}, held=("yaw",))
    assert not ut.read_log(log, towed, vehicle=vehicle).has("prop")
    plain = tmp_path / "plain.csv"
    plain.write_text(log.read_text().replace("r,n", "r,prop"))
    assert ut.read_log(plain, LogMapping(held=("yaw",)), vehicle=vehicle).has("prop")


def test_a_speed_in_newtons_or_read_without_the_vehicle_is_refused(tmp_path: Path) -> None:
    vehicle, log = _with_revolutions(tmp_path, "rev/s")
    wrong = LogMapping(columns={"n": Column(channel="prop", unit="N")})
    with pytest.raises(ut.UndertowError, match="unit 'N' of 'n', speed of a propeller"):
        read_logs([log], vehicle, wrong)
    pushed = _load(tmp_path, PROPELLER[: PROPELLER.index("[thrusters.propeller]")])
    for speed in (
        LogMapping(columns={"n": Column(channel="prop", unit="rev/s")}),
        LogMapping(channels={"prop": Channel(expression="n", unit="rev/s")}),
    ):
        for read in (lambda m: read_logs([log], pushed, m), lambda m: ut.read_log(log, m, vehicle=pushed)):
            with pytest.raises(ut.UndertowError, match=r"'rev/s' of .* but N .* needed.*thrust_per_command"):
                read(speed)
    for name, mapping in (
        ("n", LogMapping(columns={"n": Column(channel="prop", unit="rpm")})),
        ("prop", LogMapping(channels={"prop": Channel(expression="n / 60", unit="rev/s")})),
    ):
        alone = ut.read_log(log, mapping, commands=["prop"])
        with pytest.raises(ut.UndertowError, match=rf"'{name}' was read in rad/s.* command 'prop' in rev/s"):
            ut.fit(vehicle, [alone])


def test_a_fitted_thrust_coefficient_goes_back_into_its_table(tmp_path: Path) -> None:
    vehicle = _load(tmp_path, PROPELLER).with_values({"K_T0_prop": Value(0.5, estimate=True, sigma=0.01)})
    save_vehicle(vehicle, tmp_path / "craft.toml", tmp_path / "out.toml")
    again = load_vehicle(tmp_path / "out.toml")
    assert again.value_of("K_T0_prop").value == 0.5
    assert again.laws == (Propeller(0.2, 1 / 60),)


def test_a_curve_is_that_of_fritsch_and_carlson() -> None:
    curve, ours = Curve.through(T200), PchipInterpolator(*zip(*T200, strict=True))
    pulses = np.linspace(1200, 1800, 301)  # their rule for the end points is another one
    np.testing.assert_allclose([curve.at(p) for p in pulses], ours(pulses), rtol=1e-9, atol=1e-9)
    assert (curve.at(1000), curve.at(2000)) == (-40.0, pytest.approx(51.5)), "constant beyond the ends"


def test_a_curve_file_may_begin_with_full_thrust_ahead(tmp_path: Path) -> None:
    rows = [f"{p},{f}" for p, f in T200]
    (tmp_path / "up.csv").write_text("\n".join(rows))
    (tmp_path / "down.csv").write_text("\n".join(rows[::-1]))
    up, down = (_load(tmp_path, f'curve = "{name}.csv"\n').laws for name in ("up", "down"))
    assert up == down


def test_the_inverse_gives_the_command_of_a_thrust() -> None:
    curve = Curve.through(T200)
    for thrust in (-30.0, -1.0, 2.0, 45.0):
        assert curve.at(curve.inverse(thrust)) == pytest.approx(thrust, abs=1e-6)
    assert curve.inverse(1e3) == pytest.approx(1900)
    with pytest.raises(ut.UndertowError, match="falls with the command"):
        Curve.through([(0, 0), (1, 2), (2, 1)]).inverse(1.5)


def test_a_curve_beside_the_vehicle_file_is_in_the_model_and_its_slopes(tmp_path: Path) -> None:
    rows = "\n".join(f"{p},{f}" for p, f in T200)
    (tmp_path / "t200.csv").write_text(f"# bench\npwm_us,thrust_N\n{rows}\n")
    vehicle = _load(tmp_path, 'curve = "t200.csv"\n')
    curve = Curve.through(T200)
    f = Functions(vehicle)
    for pulse in (1150.0, 1500.0, 1650.0, 1900.0):
        x_dot, _, slope, _ = f.jacobians(np.zeros(6), [(pulse - 1500.0) / 400.0], f.values(), 0.0)
        assert float(x_dot[3]) * 100 == pytest.approx(curve.at(pulse), abs=0.15)
        rise = (curve.at(pulse + 0.01) - curve.at(pulse - 0.01)) / 0.02
        assert float(slope[3]) / 400 * 100 == pytest.approx(rise, abs=0.03) or pulse == 1900.0
    (tmp_path / "other").mkdir()
    save_vehicle(vehicle, tmp_path / "craft.toml", tmp_path / "other" / "out.toml")
    assert load_vehicle(tmp_path / "other" / "out.toml").laws == vehicle.laws


def test_a_polynomial_holds_up_to_the_limit(tmp_path: Path) -> None:
    vehicle = _load(tmp_path, "curve = [2.0, 0.5, 3.0]\nlimit = 2\n")
    for command in (-1.5, 0.3, 2.0):
        expected = 2 * command + 0.5 * command**2 + 3 * command**3
        assert _thrust(vehicle, command)[0] == pytest.approx(expected, abs=1e-9)
    assert _thrust(vehicle, 5.0)[0] == pytest.approx(2 * 2 + 0.5 * 4 + 3 * 8)


def test_a_table_of_two_hundred_rows_keeps_few_points(tmp_path: Path) -> None:
    pulses = np.arange(1100, 1901, 4)
    table = PchipInterpolator(*zip(*T200, strict=True))(pulses)
    (tmp_path / "t200.csv").write_text("\n".join(f"{p} {f:.6g}" for p, f in zip(pulses, table, strict=True)))
    (curve,) = _load(tmp_path, 'curve = "t200.csv"\n').laws
    assert isinstance(curve, Curve)
    assert len(curve.pieces) < 30
    off = max(abs(curve.at((p - 1500.0) / 400.0) - f) for p, f in zip(pulses, table, strict=True))
    assert off < 0.003 * 91.5 + 1e-6


def test_a_bench_with_an_offset_rests_at_zero(tmp_path: Path) -> None:
    (tmp_path / "own.csv").write_text("-10,-40\n-1,-3\n0,-1.5\n1,1\n10,45\n")
    (thruster,) = _load(tmp_path, 'curve = "own.csv"\n').thrusters
    assert thruster.normalised_by is None


@pytest.mark.parametrize(
    ("points", "normalised_by"),
    [
        (T200, (1500.0, 400.0)),
        ([(1000, -50.0), (1400, -2.0), (1490, 0.0), (1505, 0.0), (2000, 60.0)], (1500.0, 400.0)),
        ([(0, -30.0), (100, 0.0), (200, 40.0)], (100.0, 100.0)),
        ([(1000, 0.0), (1100, 0.0), (1900, 50.0)], (1000.0, 900.0)),
        ([(0.5, -8.0), (2.0, -1.0), (3.0, 1.0), (4.5, 9.0)], (2.5, 2.0)),
        ([(-100, -30.0), (-5, 0.0), (5, 0.0), (100, 40.0)], None),
        ([(0, 0.0), (10, 40.0)], None),
    ],
    ids=["us", "to 2000 us", "0 to 200", "one way", "volts", "percent", "from zero"],
)
def test_a_command_of_zero_is_rest_however_the_curve_counts(
    tmp_path: Path, points: list[tuple[float, float]], normalised_by: tuple[float, float] | None
) -> None:
    (tmp_path / "own.csv").write_text("\n".join(f"{c},{f}" for c, f in points))
    vehicle = _load(tmp_path, 'curve = "own.csv"\n')
    (thruster,), (rest, way) = vehicle.thrusters, normalised_by or (0.0, 1.0)
    assert thruster.normalised_by == (normalised_by and pytest.approx(normalised_by))
    assert _thrust(vehicle, 0.0)[0] == pytest.approx(0.0, abs=1e-9)
    for command, force in points:
        assert _thrust(vehicle, (command - rest) / way)[0] == pytest.approx(force, abs=0.15)


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('curve = "none.csv"\n', "cannot be read"),
        ("curve = [1.0]\n", "a polynomial curve needs a 'limit'"),
        ('curve = "bad.csv"\n', "neither rise nor fall from row to row"),
        (
            "thrust_per_command = 2\n" + PROPELLER,
            "states its push in several ways, propeller and thrust_per_command",
        ),
        (PROPELLER.replace('"20 cm"', '"20 kg"'), "diameter"),
        ('curve = "pulses.csv"\nlimit = 1900\n', "1500 in its file is 0, and 1900 is 1; give 1"),
    ],
)
def test_what_cannot_be_is_refused(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "bad.csv").write_text("1,2\n0,1\n3,4\n")
    (tmp_path / "pulses.csv").write_text("1100,-40\n1500,0\n1900,50\n")
    with pytest.raises(ut.UndertowError) as caught:
        _load(tmp_path, text)
    assert complaint in str(caught.value)
