"""One mass, one centre: what a vehicle file states in one table holds in every table that needs it."""

from __future__ import annotations

import logging
import tomllib
from collections.abc import Callable
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.saving import save_vehicle
from undertow.model.symbols import symbol
from undertow.model.vehicle import Value, Vehicle

SHARED = Path(__file__).parents[3] / "shared" / "data"
Load = Callable[..., Vehicle]

ROV = """\
schema = "undertow/vehicle/1"
name = "rov"
degrees_of_freedom = ["surge", "sway", "heave", "roll", "pitch", "yaw"]
signs = "sname"
gravity = "9.81 m/s^2"

[effects.rigid_body]
m = 11.5
I_x = 0.16
I_y = 0.16
I_z = 0.16
{centre}

[effects.restoring]
{restoring}
"""


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def from_tables(centre: str = "", restoring: str = "B = 112.815") -> Vehicle:
        file = tmp_path / "rov.toml"
        file.write_text(ROV.format(centre=centre, restoring=restoring), encoding="utf-8")
        return load_vehicle(file)

    return from_tables


def _moment(vehicle: Vehicle, phi: float) -> float:
    """Roll moment of the weight and buoyancy of a vehicle that is heeled by `phi`, at rest, N m."""
    parameters = {symbol(n): vehicle.value_of(n).value for n in vehicle.parameter_names}
    c = vehicle.composition
    still = dict.fromkeys([*c.eta, *c.nu, *c.signals.actuation], 0.0)
    return float(vehicle.forcing[3].subs({**parameters, **still, symbol("phi"): phi}))


# --- what one table leaves open, the other says ---------------------------------------------------
def test_weight_and_centre_of_gravity_come_from_the_rigid_body(load: Load) -> None:
    vehicle = load("x_g = 0.01\ny_g = -0.02\nz_g = 0.08", "B = 112.815\nz_b = -0.01")
    assert vehicle.values["W"].value == pytest.approx(11.5 * 9.81, rel=1e-14)
    weight, buoyancy = 11.5 * 9.81, 112.815
    assert vehicle.values["S_x"].value == pytest.approx(0.01 * weight)
    assert vehicle.values["S_y"].value == pytest.approx(-0.02 * weight)
    assert vehicle.values["S_z"].value == pytest.approx(0.08 * weight + 0.01 * buoyancy)
    assert vehicle.values["W"].source == "taken from [effects.rigid_body]"


def test_a_mass_that_is_to_be_found_leaves_the_righting_moment_to_be_found(
    load: Load, tmp_path: Path
) -> None:
    """Of a weight known to 5% the moment is known no better; with a weight that is stated it is known."""

    def moment(restoring: str) -> Value:
        text = ROV.format(centre="z_g = 0.08", restoring=restoring)
        text = text.replace("m = 11.5", "m = { value = 11.5, estimate = true, sigma = 0.6 }")
        head, body, water = text.split("[effects.")
        file = tmp_path / "guessed.toml"
        found = []
        for tables in ((body, water), (water, body)):
            file.write_text("\n[effects.".join((head, *tables)))
            found.append(load_vehicle(file).values["S_z"])
        assert found[0] == found[1]
        return found[0]

    guessed = moment("B = 112.815")
    assert guessed.estimate
    assert guessed.sigma == pytest.approx(0.08 * 0.6 * 9.81)
    weighed = moment("W = 112.815\nB = 112.815")
    assert not weighed.estimate
    assert weighed.sigma is None
    assert not load("z_g = 0.08").values["S_z"].estimate


def test_static_moments_tell_the_centre_too(load: Load) -> None:
    assert load("mz_g = 0.92").values["S_z"].value == pytest.approx(0.08 * 11.5 * 9.81)


def test_a_centre_that_only_restoring_states_is_that_of_the_mass_too(load: Load) -> None:
    vehicle = load(restoring="B = 112.815\nz_g = 0.08")
    assert vehicle.values["mz_g"].value == pytest.approx(11.5 * 0.08)
    assert vehicle.mass_matrix.subs({symbol("mz_g"): 0.92})[0, 4] == pytest.approx(0.92)


def test_each_coordinate_is_taken_by_itself(load: Load) -> None:
    vehicle = load("x_g = 0.01", "B = 112.815\nz_g = 0.08")
    assert vehicle.values["mx_g"].value == pytest.approx(0.115)
    assert vehicle.values["S_x"].value == pytest.approx(0.01 * 11.5 * 9.81)
    assert vehicle.values["mz_g"].value == pytest.approx(0.92)


def test_gravity_of_the_file_makes_the_weight(load: Load, tmp_path: Path) -> None:
    text = ROV.format(centre="", restoring="B = 112.815").replace("9.81", "9.78")
    (tmp_path / "equator.toml").write_text(text)
    assert load_vehicle(tmp_path / "equator.toml").values["W"].value == pytest.approx(11.5 * 9.78)


def test_a_stated_moment_leaves_nothing_to_be_taken(load: Load) -> None:
    vehicle = load("z_g = 0.08", "B = 112.815\nS_z = 5.0")
    assert vehicle.values["S_z"].value == 5.0
    assert vehicle.values["mz_g"].value == pytest.approx(0.92)


def test_the_same_said_twice_is_the_same_vehicle(
    load: Load, caplog: pytest.LogCaptureFixture, tmp_path: Path
) -> None:
    once = load("z_g = 0.08").values
    twice = load("z_g = 0.08", "W = 112.815\nB = 112.815\nz_g = 0.08").values
    assert {n: v.value for n, v in once.items()} == pytest.approx({n: v.value for n, v in twice.items()})
    assert caplog.messages == []


# --- another value --------------------------------------------------------------------------------
def test_another_centre_is_taken_with_a_warning(load: Load, caplog: pytest.LogCaptureFixture) -> None:
    vehicle = load("z_g = 0.08", "B = 112.815\nz_g = 0.0")
    assert vehicle.values["S_z"].value == 0.0
    [line] = caplog.messages
    assert "[effects.restoring] z_g = 0 m, but z_g = 0.08 m by [effects.rigid_body]" in line
    assert "remove it" in line
    assert "override = true" in line
    assert line.isprintable()


@pytest.mark.parametrize("own", ["z_g = { value = 0.0, override = true }", "S_z = 0.0"])
def test_a_stated_override_is_silent_and_holds_for_restoring_alone(
    own: str, load: Load, caplog: pytest.LogCaptureFixture
) -> None:
    vehicle = load("z_g = 0.08", f"B = 112.815\n{own}")
    assert vehicle.values["S_z"].value == 0.0
    assert vehicle.values["mz_g"].value == pytest.approx(0.92)
    assert caplog.messages == []


def test_an_override_does_not_move_the_mass(load: Load) -> None:
    vehicle = load(restoring="B = 112.815\nz_g = { value = 0.08, override = true }")
    assert "mz_g" not in vehicle.values
    assert vehicle.values["S_z"].value == pytest.approx(0.08 * 11.5 * 9.81)


@pytest.mark.parametrize(("weight", "warned"), [(112.8, False), (114.9, False), (118.0, True), (90.0, True)])
def test_a_weight_beyond_two_per_cent_of_m_g_is_warned_of(
    weight: float, warned: bool, load: Load, caplog: pytest.LogCaptureFixture
) -> None:
    assert load(restoring=f"W = {weight}\nB = 112.815").values["W"].value == weight
    assert len(caplog.messages) == warned
    assert not warned or f"W = {weight:g} N, but m g = 112.815 N" in caplog.text


@pytest.mark.parametrize("weight", [20.0, 50.0, 240.0])
def test_a_weight_far_from_m_g_is_refused(weight: float, load: Load) -> None:
    with pytest.raises(UndertowError, match=rf"W = {weight:g} N, but m g = 112.815 N.*factor of 2"):
        load(restoring=f"W = {weight}\nB = {weight}")


def test_an_override_of_nothing_is_refused(load: Load) -> None:
    with pytest.raises(UndertowError, match=r"rigid_body\] z_g overrides nothing.*remove 'override'"):
        load("z_g = { value = 0.08, override = true }")


def test_warnings_go_through_the_log_of_undertow(load: Load, caplog: pytest.LogCaptureFixture) -> None:
    load("z_g = 0.08", "B = 112.815\nz_g = 0.02")
    [record] = caplog.records
    assert record.levelno == logging.WARNING
    assert record.name.startswith("undertow.")


# --- files of others ------------------------------------------------------------------------------
@pytest.mark.skipif(not SHARED.exists(), reason="../shared/data is not there")
def test_the_rov_that_lost_its_righting_moment_has_it_again(tmp_path: Path) -> None:
    file = SHARED / "hidden-effects/rov-no-righting/vehicle.toml"
    whole = load_vehicle(file)
    assert whole.values["S_z"].value == pytest.approx(0.08 * 112.8)
    assert _moment(whole, 0.1) == pytest.approx(-0.08 * 112.8 * 0.0998334, rel=1e-6)
    text = file.read_text().replace("[effects.restoring]", "[effects.restoring]\nz_g = 0.0")
    (tmp_path / "without.toml").write_text(text)
    assert _moment(load_vehicle(tmp_path / "without.toml"), 0.1) == 0.0


@pytest.mark.skipif(not SHARED.exists(), reason="../shared/data is not there")
@pytest.mark.parametrize(
    "file",
    [
        p.relative_to(SHARED)
        for p in [
            *sorted(SHARED.glob("gain-counterexamples/*.toml")),
            SHARED / "hidden-effects/rov-no-righting/vehicle.toml",
        ]
        if p.exists() and "undertow/vehicle/1" in p.read_text()
    ],
    ids=str,
)
def test_vehicles_of_earlier_days_load_without_a_word(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    load_vehicle(SHARED / file)
    assert caplog.messages == []


# --- and back into a file -------------------------------------------------------------------------
def _saved(vehicle: Vehicle, folder: Path) -> tuple[Vehicle, dict]:
    out = folder / "out.toml"
    save_vehicle(vehicle, folder / "rov.toml", out)
    return load_vehicle(out), tomllib.loads(out.read_text())["effects"]


def test_what_is_taken_is_not_written(load: Load, tmp_path: Path) -> None:
    vehicle = load("z_g = 0.08")
    again, _ = _saved(vehicle, tmp_path)
    assert (tmp_path / "out.toml").read_text() == (tmp_path / "rov.toml").read_text()
    assert again.values == vehicle.values


def test_a_refitted_mass_has_its_weight_and_leaves_the_moment_as_it_was(
    load: Load, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    vehicle = load("z_g = 0.08")
    moved = vehicle.with_values({"m": Value(13.0, True), "mz_g": Value(13.0 * 0.08, True)})
    again, tables = _saved(moved, tmp_path)
    assert "W" not in tables["restoring"]
    assert again.values["W"].value == pytest.approx(13.0 * 9.81)
    assert again.values["S_z"].value == pytest.approx(vehicle.values["S_z"].value)
    assert again.values["m"].value == 13.0
    assert caplog.messages == []


def test_a_mass_that_a_fit_moved_far_is_written_and_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """The mass makes up for something that is missing: the reader has to see it."""
    text = ROV.format(centre="", restoring="W = 112.8\nB = 112.8")
    (tmp_path / "rov.toml").write_text(text.replace("m = 11.5", "m = { value = 11.5, estimate = true }"))
    vehicle = load_vehicle(tmp_path / "rov.toml")
    again, _ = _saved(vehicle.with_values({"m": Value(30.0, True, 1.0)}), tmp_path)
    assert again.values["m"].value == 30.0
    assert again.values["W"].value == 112.8
    assert "W = 112.8 N, but m g = 294.3 N" in caplog.text


def test_a_refitted_moment_leaves_the_centre_of_the_mass(load: Load, tmp_path: Path) -> None:
    """The file has the centre in `restoring` only, from which the refitted moment takes it away."""
    vehicle = load(restoring="B = 112.815\nz_g = 0.08")
    again, tables = _saved(vehicle.with_values({"S_z": Value(7.0, True, 0.1)}), tmp_path)
    assert again.values["S_z"].value == 7.0
    assert again.values["mz_g"].value == pytest.approx(0.92)
    assert "z_g" not in tables["restoring"]


def test_restoring_that_a_fit_found_has_the_weight_of_the_mass(tmp_path: Path) -> None:
    """Motion shows W - B and the moment only: a fit may find B alone, and the file must be a vehicle."""
    text = ROV.format(centre="", restoring="").replace("[effects.restoring]\n", "")
    (tmp_path / "rov.toml").write_text(text)
    found = {"B": Value(2.0, True, 0.1), "S_z": Value(9.0, True, 0.2)}
    vehicle = load_vehicle(tmp_path / "rov.toml").with_effect(catalogue()["restoring"], found)
    again, tables = _saved(vehicle, tmp_path)
    assert again.values["W"].value == pytest.approx(112.815)
    assert again.values["B"].value - again.values["W"].value == pytest.approx(2.0)
    assert again.values["B"].sigma == pytest.approx(0.1)
    assert "W" not in tables["restoring"]
    assert _moment(again, 0.1) == pytest.approx(_moment(vehicle, 0.1))


# --- what a fit moves -----------------------------------------------------------------------------
GUESS = "{ value = 11.5, estimate = true, sigma = 0.6 }"


def test_the_weight_follows_a_mass_that_is_estimated(load: Load, tmp_path: Path) -> None:
    """W = m g in values and equations: half a kilogram is 4.9 N, and the file need not say it."""
    file = tmp_path / "guessed.toml"
    file.write_text(ROV.format(centre="", restoring="B = 112.815").replace("m = 11.5", f"m = {GUESS}"))
    vehicle = load_vehicle(file)
    assert vehicle.tied == {"W": ("m", 9.81)}
    heavier = vehicle.with_values({"m": Value(12.0, estimate=True)})
    assert heavier.values["W"].value == pytest.approx(12.0 * 9.81, rel=1e-14)
    assert vehicle.with_values({"W": Value(100.0)}).values["W"].value == 100.0
    save_vehicle(heavier, file, tmp_path / "saved.toml")
    saved = tomllib.loads((tmp_path / "saved.toml").read_text())
    assert "W" not in saved["effects"]["restoring"]
    assert load_vehicle(tmp_path / "saved.toml").values["W"].value == pytest.approx(12.0 * 9.81, rel=1e-14)


def test_a_stated_weight_or_a_known_mass_is_tied_to_nothing(load: Load) -> None:
    assert load().tied == {}
    assert load("", "W = 112.8\nB = 112.815").follows == {}


def test_equations_have_the_weight_of_the_mass_that_is_estimated(load: Load, tmp_path: Path) -> None:
    """The heave force at rest changes by g with a kilogram of m, and by nothing with W's own entry."""
    file = tmp_path / "guessed.toml"
    file.write_text(ROV.format(centre="", restoring="B = 112.815").replace("m = 11.5", f"m = {GUESS}"))
    vehicle = load_vehicle(file)
    functions = Functions(vehicle)
    forcing = ca.Function("f", [functions.x, functions.u, functions.p], [functions.forcing])
    still = np.zeros(functions.x.shape[0]), np.zeros(functions.u.shape[0])
    p = np.array(functions.values(), dtype=float)
    m, W = (vehicle.parameter_names.index(n) for n in ("m", "W"))
    more, other = p.copy(), p.copy()
    more[m] += 1.0
    other[W] += 50.0
    before, heavier, unmoved = (np.array(forcing(*still, q))[:, 0] for q in (p, more, other))
    np.testing.assert_allclose(heavier - before, 9.81 * np.eye(6)[2], atol=1e-9)
    np.testing.assert_array_equal(unmoved, before)


def test_the_error_of_a_place_is_that_of_its_static_moment(load: Load) -> None:
    vehicle = load('z_g = { value = 0.08, assumed = true, sigma = "1 cm" }', "B = 112.815")
    stated = vehicle.values["mz_g"]
    assert (stated.value, stated.sigma) == pytest.approx((0.92, 11.5 * 0.01))
    assert not stated.estimate, "a place with an error is not one that is to be found"
