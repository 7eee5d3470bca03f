"""No effect without a number: what has no neutral value must be given, and what loads gives finite rates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.quick import quick_if
from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.comparison import compare
from undertow.identification.estimation.data import prepare
from undertow.identification.estimation.weak_form import fit_weak
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue, lookup
from undertow.model.loading import load_vehicle
from undertow.model.parameter import Parameter
from undertow.model.vehicle import Vehicle

# One that all effects show on: it moves in six ways, and its thrusters push in all of them.
HEAD = """\
schema = "undertow/vehicle/1"
name = "any"
degrees_of_freedom = ["surge", "sway", "heave", "roll", "pitch", "yaw"]
signs = "sname"
"""
BODY = {"rigid_body": {"m": 20.0, "I_x": 0.5, "I_y": 0.6, "I_z": 0.6}}
HARDWARE = """
[[thrusters]]
name = "port_forward"
position = [-0.2, -0.1, 0.1]
direction = [0.6, 0.0, 0.8]

[[thrusters]]
name = "aft_backward"
position = [-0.2, 0.1, -0.1]
direction = [0.6, 0.8, 0.0]

[[surfaces]]
name = "rudder"
position = [-0.4, 0.1, 0.0]
axis = "rudder"
area = 0.01
aspect_ratio = 1.5
slipstream_of = "aft_backward"
propeller_diameter = 0.1
"""
OFFERED = sorted(e for e, cls in catalogue().items() if not cls.built_in)
NAMES = ("port_forward", "aft_backward")
MOTIONS = [0.0, 0.3, -0.3, 1.0, -1.0]


def _needed(effect_id: str) -> list[Parameter]:
    return [p for p in lookup(effect_id, catalogue())(NAMES).parameters if p.must_be_given]


def _possible(parameter: Parameter) -> float:
    low, high = parameter.bounds
    if parameter.starts:
        return parameter.starts[0]
    return 100.0 if np.isinf(high) else (low + high) / 2


def _tables(effect_id: str) -> dict[str, dict[str, float]]:
    cls = lookup(effect_id, catalogue())
    beside = [r for r in cls.requires if not catalogue()[r].built_in]
    found = dict(BODY)
    for one in (*beside, *cls.shares, effect_id):
        found.setdefault(one, {p.name: _possible(p) for p in _needed(one)})
    if "restoring" in found:
        found["restoring"] = {"B": 200.0}
    return found


def _load(tables: dict[str, dict[str, float]], folder: Path) -> Vehicle:
    text = "".join(
        f"\n[effects.{name}]\n" + "".join(f"{k} = {v}\n" for k, v in table.items())
        for name, table in tables.items()
    )
    file = folder / "any.toml"
    file.write_text(HEAD + text + HARDWARE)
    return load_vehicle(file)


@pytest.mark.parametrize("effect_id", quick_if(OFFERED[1::3].__contains__, OFFERED))
def test_rates_are_finite_with_only_what_must_be_given(effect_id: str, tmp_path: Path) -> None:
    vehicle = _load(_tables(effect_id), tmp_path)
    functions = Functions(vehicle)
    p = functions.values()
    for motion in MOTIONS:
        x = [motion] * len(functions.state_names)
        for command in (0.0, 2.0, -2.0):
            rates = functions.dynamics(x, [command] * 3, p, 1.0)
            assert np.isfinite(np.array(rates, dtype=float)).all(), (motion, command)


@pytest.mark.parametrize(
    ("effect_id", "name"), [(e, p.name) for e in OFFERED for p in _needed(e) if e != "rigid_body"]
)
def test_what_must_be_given_is_asked_for(effect_id: str, name: str, tmp_path: Path) -> None:
    tables = _tables(effect_id)
    if name == "W":  # the rigid body tells it
        assert _load(tables, tmp_path).values["W"].value == pytest.approx(20.0 * 9.81)
        return
    del tables[effect_id][name]
    parameter = next(p for p in _needed(effect_id) if p.name == name)
    with pytest.raises(UndertowError) as caught:
        _load(tables, tmp_path)
    line = str(caught.value)
    assert f"[effects.{effect_id}] lacks {name} ({parameter.about}): give it in {parameter.unit}" in line
    assert all(f"{bound:g}" in line for bound in parameter.bounds if np.isfinite(bound))


@pytest.mark.parametrize("effect_id", OFFERED)
def test_what_may_be_left_out_stands_within_its_bounds(effect_id: str) -> None:
    for p in lookup(effect_id, catalogue())(NAMES).parameters:
        assert p.must_be_given or p.bounds[0] <= p.effective_default <= p.bounds[1], p.name


@pytest.mark.parametrize("effect_id", OFFERED)
def test_values_beyond_their_bounds_do_not_load(effect_id: str, tmp_path: Path) -> None:
    for p in lookup(effect_id, catalogue())(NAMES).parameters:
        low, high = p.bounds
        outside = [v for v in (low - abs(low) - 1.0, high + abs(high) + 1.0) if np.isfinite(v)]
        for value in outside:
            tables = _tables(effect_id)
            tables[effect_id] = tables[effect_id] | {p.name: value}
            with pytest.raises(UndertowError, match=rf"{p.name} = .* is impossible"):
                _load(tables, tmp_path)


def test_a_time_constant_is_asked_for_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(UndertowError, match=r"lacks T_lag \(time constant\): give it in s, from 0.01 to 20$"):
        _load(BODY | {"thruster_lag": {}}, tmp_path)


# --- effects of one's own -------------------------------------------------------------------------
ROOT = '''
import sympy as sm
from undertow.model.effect import Wrench
from undertow.model.parameter import Parameter

class Root(Wrench):
    """A force that has no value below some speed."""
    id = "root"
    family = "damping"
    reference = "none"
    signature = "none"
    X_root = Parameter("N", "force")
    u_least = Parameter("m/s", "speed at which it ends", default=1.0)

    def wrench(self, s):
        return sm.Matrix([self.X_root * sm.sqrt(s.nu_r[0] + self.u_least), 0, 0, 0, 0, 0])
'''
OWN = """\
schema = "undertow/vehicle/1"
name = "own"
degrees_of_freedom = ["surge"]
signs = "sname"
generalised_forces = ["tau_X"]
[effects.rigid_body]
m = 10.0
[effects.linear_damping]
X_u = { value = -3.0, estimate = true }
[effects.root]
X_root = 1.0
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    (tmp_path / "root.py").write_text(ROOT)
    (tmp_path / "own.toml").write_text(OWN)
    return tmp_path


def test_equations_without_a_value_at_rest_do_not_load(own: Path) -> None:
    (own / "own.toml").write_text(OWN + "u_least = -0.5\n")
    with pytest.raises(UndertowError, match="the force of root of vehicle 'own' has no finite value at rest"):
        load_vehicle(own / "own.toml", effect_files=[own / "root.py"])


def test_a_log_that_the_model_has_no_value_on_is_refused_and_not_answered_with_nan(own: Path) -> None:
    """A sailing astern at 1.5 m/s, below which the root has none."""
    vehicle = load_vehicle(own / "own.toml", effect_files=[own / "root.py"])
    t = np.arange(0.0, 30.0, 0.1)
    u = 1.5 * np.sin(0.7 * t)
    run = Run("astern", t, {"x": np.cumsum(u) * 0.1, "u": u, "tau_X": 10 * np.cos(0.7 * t)})
    with pytest.raises(UndertowError, match="vehicle 'own' has no finite force somewhere in run 'astern'"):
        compare(vehicle, [run], compiled=False)
    with pytest.raises(UndertowError, match="vehicle 'own' has no finite force somewhere in run 'astern'"):
        fit_weak(vehicle, prepare([run], vehicle))
