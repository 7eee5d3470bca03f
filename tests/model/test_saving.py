"""A vehicle written back into its file: nothing lost, nothing changed that need not be, nothing executed."""

from __future__ import annotations

import difflib
import tomllib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.parameter import printed
from undertow.model.saving import save_vehicle
from undertow.model.vehicle import Value, Vehicle

FITTED = {
    "command": "undertow fit",
    "date": "2026-03-04",
    "logs": [{"name": "run1", "sha256": "ab", "role": "train"}],
}

SMALL = """\
schema = "undertow/vehicle/1"
name = "float"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "{signs}"

[effects.rigid_body]
m = "7500 g" # weighed
x_g = {{ value = "2 cm", source = "plumb line" }}
I_z = 0.3

[effects.linear_damping]
X_u = {{ value = {sign}1.5, estimate = true, source = "tank" }}
Y_v = {{ forward = {sign}3.0, backward = {sign}4.0, estimate = true, sigma = 0.5 }}
N_r = "{sign}0.2 kg m^2/s"

# The only thruster.
[[thrusters]]
name = "aft"
position = [-0.5, 0, 0]
direction = [1, 0, 0]
"""


@pytest.fixture(params=["sname", "magnitudes"])
def small(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    path = tmp_path / "float.toml"
    path.write_text(SMALL.format(signs=request.param, sign="-" if request.param == "sname" else ""))
    return path


def _saved(vehicle: Vehicle, template: Path, **kwargs: object) -> Vehicle:
    out = template.parent / "out.toml"
    save_vehicle(vehicle, template, out, **kwargs)
    return load_vehicle(out)


def _changed_lines(old: Path, new: Path) -> list[str]:
    lines = difflib.ndiff(old.read_text().splitlines(), new.read_text().splitlines())
    return [line for line in lines if line[0] in "+-"]


def _tables(path: Path) -> dict:
    return tomllib.loads(path.read_text())


@pytest.mark.parametrize("name", sorted(bundled_vehicles()))
def test_an_unchanged_vehicle_gives_the_same_file(name: str, tmp_path: Path) -> None:
    out = tmp_path / "same.toml"
    save_vehicle(load_vehicle(name), name, out)
    assert out.read_bytes() == bundled_vehicles()[name].read_bytes()


def test_only_the_fitted_line_changes(small: Path) -> None:
    vehicle = load_vehicle(small)
    fitted = vehicle.with_values({"X_u": Value(-1.625, True, 0.0125, "tank")})
    _saved(fitted, small, history=FITTED)
    sign = "-" if vehicle.signs == "sname" else ""
    before = f'X_u = {{ value = {sign}1.5, estimate = true, source = "tank" }}'
    after = (
        f"X_u = {{ value = {sign}1.625, estimate = true, sigma = 0.0125, "
        'source = "fit to run1 on 2026-03-04; before: tank" }'
    )
    lines = [line for line in _changed_lines(small, small.parent / "out.toml") if "X_u" in line]
    assert lines == [f"- {before}", f"+ {after}"]
    removed = [line for line in _changed_lines(small, small.parent / "out.toml") if line[0] == "-"]
    assert removed == [f"- {before}"]


def test_values_keep_the_units_and_comments_of_the_file(small: Path) -> None:
    vehicle = load_vehicle(small).with_values({"m": Value(8.25), "mx_g": Value(8.25 * 0.02)})
    _saved(vehicle, small)
    assert 'm = "8250 g" # weighed\n' in (small.parent / "out.toml").read_text()
    assert len(_changed_lines(small, small.parent / "out.toml")) == 2


def test_a_fitted_text_with_a_unit_has_its_sigma_in_that_unit(small: Path) -> None:
    vehicle = load_vehicle(small).with_values({"m": Value(8.0, True, 0.05)})
    again = _saved(vehicle.with_values({"mx_g": Value(0.16)}), small)
    entry = _tables(small.parent / "out.toml")["effects"]["rigid_body"]["m"]
    assert (entry["value"], entry["sigma"]) == ("8000 g", "50 g")
    assert again.values["m"].sigma == pytest.approx(0.05, rel=1e-9)
    assert again.values["m"].estimate


def test_forward_and_backward_keep_their_own_standard_errors(small: Path) -> None:
    new = {"Y_v_forward": Value(-3.5, True, 0.1), "Y_v_backward": Value(-4.5, True, 0.2)}
    again = _saved(load_vehicle(small).with_values(new), small)
    assert [again.values[n].value for n in new] == [-3.5, -4.5]
    assert [again.values[n].sigma for n in new] == [0.1, 0.2]
    # A second fit that gives both the same error needs one key only.
    third = _saved(again.with_values({n: Value(-5.0, True, 0.3) for n in new}), small.parent / "out.toml")
    assert _tables(small.parent / "out.toml")["effects"]["linear_damping"]["Y_v"]["sigma"] == 0.3
    assert [third.values[n].sigma for n in new] == [0.3, 0.3]


@pytest.mark.parametrize("sigma", [0.0, float("inf"), float("nan")])
def test_a_standard_error_that_says_nothing_is_left_out(small: Path, sigma: float) -> None:
    new = {"X_u": Value(-2.0, True, sigma), "thrust_aft": Value(2.0, True, sigma)}
    again = _saved(load_vehicle(small).with_values(new), small)
    assert (again.value_of("X_u").value, again.value_of("X_u").sigma) == (-2.0, None)
    assert again.value_of("thrust_aft").sigma is None


def test_an_effect_without_parameters_is_added(small: Path) -> None:
    vehicle = load_vehicle(small).with_effect(catalogue()["rigid_body_coriolis"], {})
    assert [e.id for e in _saved(vehicle, small).effects][-1] == "rigid_body_coriolis"


def test_a_value_may_be_split_into_forward_and_backward(small: Path) -> None:
    vehicle = load_vehicle(small)
    values = {k: v for k, v in vehicle.values.items() if k != "X_u"}
    values |= {"X_u_forward": Value(-1.0, True, 0.1), "X_u_backward": Value(-2.0, True, 0.1)}
    again = _saved(Vehicle(**{**vars_of(vehicle), "values": values}), small)
    assert again.value_of("X_u_backward").value == -2.0
    assert "X_u" not in again.values


def vars_of(vehicle: Vehicle) -> dict:
    return {name: getattr(vehicle, name) for name in vehicle.__dataclass_fields__}


def test_a_new_effect_stands_behind_the_others(small: Path) -> None:
    vehicle = load_vehicle(small).with_effect(
        catalogue()["quadratic_damping"], {"X_uabsu": Value(-5.0, True, 0.2)}
    )
    again = _saved(vehicle, small, history=FITTED)
    assert again.value_of("X_uabsu").value == -5.0
    text = (small.parent / "out.toml").read_text()
    shown = "-5" if vehicle.signs == "sname" else "5"
    new = (
        f'[effects.quadratic_damping]\nX_uabsu = {{ value = "{shown} kg/m", estimate = true, '
        'sigma = "0.2 kg/m", '
        'source = "fit to run1 on 2026-03-04" }\n\n# The only thruster.\n[[thrusters]]\n'
    )
    assert new in text
    assert not [line for line in _changed_lines(small, small.parent / "out.toml") if line[0] == "-"]


def test_a_partial_effect_gets_its_other_parameters(small: Path) -> None:
    vehicle = load_vehicle(small).with_effect(
        catalogue()["linear_damping_coupling"], {"Y_r": Value(-0.1, True, 0.01)}
    )
    first = _saved(vehicle, small)
    second = first.with_effect(catalogue()["linear_damping_coupling"], {"N_v": Value(-0.3, True, 0.01)})
    out = small.parent / "out.toml"
    again = _saved(second, out)
    assert {n: again.value_of(n).value for n in ("Y_r", "N_v")} == {"Y_r": -0.1, "N_v": -0.3}
    assert list(_tables(out)["effects"]["linear_damping_coupling"]) == ["Y_r", "N_v"]


def test_a_thruster_gets_its_fitted_thrust(small: Path) -> None:
    vehicle = load_vehicle(small).with_values({"thrust_aft": Value(1.75, True, 0.05)})
    again = _saved(vehicle, small, history=FITTED)
    assert again.thrusters[0].thrust_per_command == Value(1.75, True, 0.05, "fit to run1 on 2026-03-04")


def test_a_fitted_static_moment_replaces_the_arm(small: Path) -> None:
    vehicle = load_vehicle(small)
    assert vehicle.value_of("mx_g").value == pytest.approx(0.15)
    again = _saved(vehicle.with_values({"mx_g": Value(0.2, True, 0.01, "plumb line")}), small)
    entries = _tables(small.parent / "out.toml")["effects"]["rigid_body"]
    assert "x_g" not in entries
    assert entries["mx_g"]["source"] == "fitted; before: plumb line"
    assert again.value_of("mx_g") == Value(0.2, True, 0.01, "fitted; before: plumb line")


def test_a_fitted_mass_does_not_move_the_static_moment(small: Path) -> None:
    vehicle = load_vehicle(small)
    again = _saved(vehicle.with_values({"m": Value(10.0, True, 0.1)}), small)
    assert again.value_of("mx_g").value == pytest.approx(0.15, rel=1e-9)


def test_an_assumed_value_is_none_any_more_once_it_is_fitted(tmp_path: Path) -> None:
    vehicle = load_vehicle("mini-auv")
    assert vehicle.values["Y_v"].assumed
    save_vehicle(
        vehicle.with_values({"Y_v": Value(-5.0, True, 0.3, "guess", True)}), "mini-auv", tmp_path / "a.toml"
    )
    fitted = load_vehicle(tmp_path / "a.toml").values["Y_v"]
    assert (fitted.assumed, fitted.source) == (False, "fitted; before: guess")


def test_sources_do_not_grow_from_fit_to_fit(small: Path) -> None:
    out = small.parent / "out.toml"
    first = _saved(
        load_vehicle(small).with_values({"X_u": Value(-2.0, True, 0.1, "tank")}), small, history=FITTED
    )
    source = first.values["X_u"].source
    later = {**FITTED, "date": "2027-01-01"}
    second = _saved(first.with_values({"X_u": Value(-2.5, True, 0.1, source)}), out, history=later)
    assert second.values["X_u"].source == "fit to run1 on 2027-01-01; before: tank"


def test_kept_aside_logs_are_not_what_was_fitted_to(small: Path) -> None:
    logs = [{"name": f"run{i}", "role": "holdout" if i == 0 else "train"} for i in range(6)]
    vehicle = load_vehicle(small).with_values({"X_u": Value(-2.0, True, 0.1)})
    again = _saved(vehicle, small, history={"date": "today", "logs": logs})
    assert again.values["X_u"].source == "fit to run1, run2, run3 and 2 more on today"


def test_history_grows_and_covariance_has_the_signs_of_the_file(small: Path) -> None:
    vehicle = load_vehicle(small)
    matrix = [[1.23456789e-4, 5e-6], [5e-6, 2e-4]]
    entry = {**FITTED, "error_before": 3.0, "covariance": {"parameters": ["X_u", "m"], "matrix": matrix}}
    out = small.parent / "out.toml"
    save_vehicle(vehicle, small, out, history=entry)
    save_vehicle(load_vehicle(out), out, out, history={"command": "second", "note": None})
    first, second = _tables(out)["history"]
    sign = -1 if vehicle.signs == "magnitudes" else 1
    assert first["covariance"]["parameters"] == ["X_u", "m"]
    assert first["covariance"]["matrix"] == [[1.23457e-4, sign * 5e-6], [sign * 5e-6, 2e-4]]
    assert first["logs"] == FITTED["logs"]
    assert second == {"command": "second"}
    assert "\n\n[[history]]\n" in out.read_text()


def test_an_effect_that_the_vehicle_lacks_is_taken_out(small: Path) -> None:
    vehicle = load_vehicle(small)
    effects = tuple(e for e in vehicle.effects if e.id != "linear_damping")
    values = {n: v for n, v in vehicle.values.items() if n[0] in "mI"}
    again = _saved(Vehicle(**{**vars_of(vehicle), "effects": effects, "values": values}), small)
    assert [e.id for e in again.effects] == ["rigid_body"]


def test_name_density_and_gravity_are_written(small: Path) -> None:
    vehicle = load_vehicle(small)
    changed = Vehicle(**{**vars_of(vehicle), "name": 'a "b"', "environment": {"rho": 1025.0, "g": 9.8}})
    again = _saved(changed, small)
    assert (again.name, again.environment) == ('a "b"', {"rho": 1025.0, "g": 9.8})


LAYOUTS = {
    "parameter tables": "[effects.linear_damping.X_u]\nvalue = -1.5 # slow\nestimate = true\n",
    "dotted keys": "[effects.linear_damping]\nX_u.value = -1.5\nX_u.estimate = true\n",
    "scattered": "[[thrusters]]\nname = 'aft'\nwrench = [1, 0, 0, 0, 0, 0]\n\n"
    "[effects.linear_damping]\nX_u = -1.5",
    "windows": "[effects.linear_damping]\r\nX_u = -1.5 # slow\r\n\r\n# end\r\n",
}
HEAD = 'schema = "undertow/vehicle/1"\nname = "f"\ndegrees_of_freedom = ["surge"]\nsigns = "sname"\n'
BODY = "[effects.rigid_body]\nm = 7.5\n\n"


WHOLE_FILES = {
    **{name: HEAD + BODY + text for name, text in LAYOUTS.items()},
    "one line": HEAD + "[effects]\nrigid_body = { m = 7.5 }\nlinear_damping = { X_u = -1.5 }\n",
    "dotted all the way": HEAD + "effects.rigid_body.m = 7.5\neffects.linear_damping.X_u = -1.5\n",
    "inline": HEAD + "effects = { rigid_body = { m = 7.5 }, linear_damping = { X_u = -1.5 } }\n",
    "inline history": HEAD + "history = []\n" + BODY + "[effects.linear_damping]\nX_u = -1.5\n",
}


@pytest.mark.parametrize("text", WHOLE_FILES.values(), ids=WHOLE_FILES)
def test_every_way_to_lay_out_the_file_can_be_edited(text: str, tmp_path: Path) -> None:
    template = tmp_path / "layout.toml"
    template.write_bytes(text.encode())
    vehicle = load_vehicle(template).with_values({"X_u": Value(-2.5, True, 0.25)})
    vehicle = vehicle.with_effect(catalogue()["quadratic_damping"], {"X_uabsu": Value(-4.0, True, 0.5)})
    vehicle = vehicle.with_effect(catalogue()["ocean_current"], {"V_N": Value(0.1, True, 0.01)})
    again = _saved(vehicle, template, history=FITTED)
    assert {n: v.value for n, v in again.values.items()} == {
        "m": 7.5,
        "X_u": -2.5,
        "X_uabsu": -4.0,
        "V_N": 0.1,
    }
    twice = _saved(again, tmp_path / "out.toml", history=FITTED)
    assert twice.values == again.values
    assert len(_tables(tmp_path / "out.toml")["history"]) == 2
    out = (tmp_path / "out.toml").read_text()
    assert all(line in out for line in ("# slow", "# end") if line in text)


NUMBERS = st.floats(1e-12, 1e12, allow_nan=False)


@settings(max_examples=20)
@given(
    numbers=st.tuples(st.floats(1e-4, 1e5), *5 * [NUMBERS]), signs=st.sampled_from(["sname", "magnitudes"])
)
def test_values_come_back_whatever_they_are(
    numbers: tuple[float, ...], signs: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    folder = tmp_path_factory.mktemp("saved")
    template = folder / "v.toml"
    template.write_text(SMALL.format(signs=signs, sign="-" if signs == "sname" else ""))
    m, x_u, ahead, astern, n_r, thrust = numbers
    new = {
        "m": Value(m, True, m / 3),
        "I_z": Value(0.15 * m * (m / 1000) ** (2 / 3)),
        "X_u": Value(-x_u, True, x_u / 7),
        "Y_v_forward": Value(-ahead, True, ahead),
        "Y_v_backward": Value(-astern, True, astern),
        "N_r": Value(-n_r),
        "mx_g": Value(0.0),
        "thrust_aft": Value(thrust, True, thrust),
    }
    vehicle = load_vehicle(template).with_values(new)
    once = _saved(vehicle, template)
    twice = _saved(once, folder / "out.toml")
    for name, value in new.items():
        assert once.value_of(name).value == pytest.approx(value.value, rel=1e-9, abs=0)
        assert twice.value_of(name) == once.value_of(name)
        if value.sigma:
            assert once.value_of(name).sigma == pytest.approx(value.sigma, rel=1e-9, abs=0)


TEXTS = st.text(max_size=40) | st.sampled_from(
    [
        '"',
        "'''",
        '"""',
        "\\",
        "\n[effects.evil]\n",
        "]]",
        "#",
        "<script>",
        "\x00\x7f\x1b",
        "\ud800",
        "\r",
        "\u2028",
    ]
)


@settings(max_examples=30)
@given(name=TEXTS, source=TEXTS, key=TEXTS)
def test_names_stay_data(name: str, source: str, key: str, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("saved")
    template = folder / "v.toml"
    template.write_text(SMALL.format(signs="sname", sign="-"))
    history = {"date": "2026", "logs": [{"name": name, "sha256": source}], key: {key: name}, "list": [[name]]}
    vehicle = load_vehicle(template).with_values(
        {"X_u": Value(-2.0, True, 0.1, source), "N_r": Value(-9.0, source=name)}
    )
    again = _saved(vehicle, template, history=history)
    written = _tables(folder / "out.toml")
    assert [*written] == [*_tables(template), "history"]
    assert [*written["effects"]] == [*_tables(template)["effects"]]
    assert written["history"][0]["logs"][0]["name"] == name.encode("utf-8", "replace").decode()
    assert again.values["X_u"].value == -2.0


def test_the_template_is_replaced_only_on_purpose(small: Path) -> None:
    before = small.read_bytes()
    alias = small.parent / "alias.toml"
    alias.symlink_to(small)
    changed = load_vehicle(small).with_values({"X_u": Value(-9.0)})
    with pytest.raises(UndertowError, match=r"alias\.toml' is the file .* itself"):
        save_vehicle(changed, small, alias)
    assert small.read_bytes() == before
    save_vehicle(changed, small, small)
    assert load_vehicle(small).values["X_u"].value == -9.0


def test_a_template_of_another_vehicle_is_refused(small: Path) -> None:
    with pytest.raises(UndertowError, match="thrusters of the file are aft, those of the vehicle f1"):
        save_vehicle(load_vehicle("mini-auv"), small, small.parent / "out.toml")
    assert not (small.parent / "out.toml").exists()


def test_a_value_that_the_file_may_not_hold_is_refused_before_anything_is_written(small: Path) -> None:
    with pytest.raises(UndertowError, match=r"cannot carry the new values: .*m = -1"):
        save_vehicle(load_vehicle(small).with_values({"m": Value(-1.0)}), small, small.parent / "out.toml")
    assert not (small.parent / "out.toml").exists()


def test_printed_turns_left_hand_derivatives_only_and_is_its_own_inverse() -> None:
    parameters = {p.name: p for e in load_vehicle("mini-auv").effects for p in e.parameters}
    assert printed(parameters["X_u"], -1.5, "magnitudes") == 1.5
    assert printed(parameters["X_u"], -1.5, "sname") == -1.5
    assert printed(parameters["m"], 7.5, "magnitudes") == 7.5
    assert str(printed(parameters["X_u"], 0.0, "magnitudes")) == "0.0"
    assert printed(parameters["X_u"], printed(parameters["X_u"], 2.0, "magnitudes"), "magnitudes") == 2.0
