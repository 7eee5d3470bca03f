"""Every effect keeps the contract, and every way to break it is found and named."""

from __future__ import annotations

import re
from functools import cache
from importlib.metadata import EntryPoint
from pathlib import Path

import pytest
import sympy as sm

from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue, load_effects, merge
from undertow.model.contract import ContractCheck, check_effect, positive_semidefinite
from undertow.model.effect import Effect
from undertow.model.parameter import logged
from undertow.model.units import dimension, dimension_of, require_unit, short_unit, unit_text

IDS_OF_ISSUE_2 = {
    *("rigid_body", "rigid_body_coriolis", "added_mass", "added_mass_coupling", "added_mass_coriolis"),
    *("linear_damping", "linear_damping_coupling", "quadratic_damping", "cubic_damping", "lift"),
    *("net_buoyancy", "restoring", "trim_offset", "constant_force", "dry_friction", "drag_asymmetry"),
    *("ocean_current", "thruster_gain", "thruster_deadband", "thruster_lag", "actuation_delay"),
    *("velocity_lever_arm", "radiation_memory"),
}
EVERY = {"id", "documentation", "requires", "names", "bounds", "claims"}
EVERY |= {"shape", "symbols", "parameters", "units", "zero", "linearity"}


# --- the catalogue ------------------------------------------------------------------------------
@cache
def _findings(effect_id: str) -> tuple[ContractCheck, ...]:
    return tuple(check_effect(catalogue()[effect_id]))


@pytest.mark.parametrize("effect_id", sorted(catalogue()))
def test_effect_keeps_the_contract(effect_id: str) -> None:
    findings = _findings(effect_id)
    assert [f.message for f in findings if not f.ok] == []
    assert {f.check for f in findings} >= EVERY


@pytest.mark.parametrize(
    ("effect_id", "inputs"),
    [
        ("wind", ("wind_speed", "wind_from")),
        ("wind", ("apparent_wind_speed", "apparent_wind_angle")),
        ("supply_droop", ("voltage",)),
        ("ocean_current", ("V_N", "V_E")),
        ("tether_drag", ("tether_length",)),
        ("boundary_proximity", ("altitude",)),
        ("net_buoyancy", ("B_net",)),
    ],
)
def test_effect_keeps_the_contract_where_the_log_has_more(effect_id: str, inputs: tuple[str, ...]) -> None:
    cls = catalogue()[effect_id]
    assert {d.name for d in logged(cls)} >= {*inputs}
    findings = check_effect(cls, inputs=inputs)
    assert [f.message for f in findings if not f.ok] == []
    assert not {p.name for p in cls.specimen(inputs).parameters} & {*inputs}


def test_catalogue_has_the_effects_of_the_first_version() -> None:
    assert set(catalogue()) >= IDS_OF_ISSUE_2


@pytest.mark.parametrize(
    ("check", "effects"),
    [
        ("inertia", {"rigid_body", "added_mass"}),
        ("symmetry", {"rigid_body", "added_mass", "added_mass_coupling"}),
        ("workless", {"rigid_body_coriolis", "added_mass_coriolis"}),
        ("dissipative", {"linear_damping", "quadratic_damping", "cubic_damping", "dry_friction"}),
        ("rate", {"ocean_current"}),
        ("rest", {"thruster_gain", "thruster_deadband", "thruster_lag", "actuation_delay"}),
        ("affine", {"velocity_lever_arm", "sensor_delay"}),
        ("dead_time", {"actuation_delay", "sensor_delay", "velocity_lever_arm"}),
    ],
)
def test_laws_are_tried_where_they_apply(check: str, effects: set[str]) -> None:
    for effect_id in effects:
        assert check in {f.check for f in _findings(effect_id)}


# --- effects of a user, good and bad --------------------------------------------------------------
HEAD = """
import sympy as sm
from undertow.model.effect import Actuation, Effect, Flow, Measurement, Wrench
from undertow.model.effects.added_mass import AddedMass
from undertow.model.symbols import coriolis, rotation
from undertow.model.parameter import Parameter, PerThruster, Place, logged
"""
NOTES = """
    reference = "Hoerner (1965), Fluid-Dynamic Drag"
    signature = "too fast at high speed"
"""
KEEL = f'''
class KeelDrag(Wrench):
    """Drag of a keel below the origin."""
    id = "keel_drag"
    family = "damping"
    dissipative = True
{NOTES}
    C_keel = Parameter("1", "drag coefficient", (0, 5))
    keel_area = Parameter("m^2", "its area", (1e-3, 10), linear=False, default=0.1, neutral=None)

    def wrench(self, s):
        force = -s.rho / 2 * self.keel_area * self.C_keel * sm.Abs(s.nu_r[1]) * s.nu_r[1]
        return sm.Matrix([0, force, 0, 0, 0, 0])
'''
TANK = f'''
class FloodedTank(Wrench):
    """Water in a flooded tank above or below the origin."""
    id = "flooded_tank"
    family = "inertia"
{NOTES}
    tank_m = Parameter("kg", "mass of the water", (0, 100))
    tank_z = Parameter("m", "its place, down", (-1, 1), linear=False, starts=(0.1,), neutral=None)

    def wrench(self, s):
        m, z = self.tank_m, self.tank_z
        surge = m * (s.nu_dot[0] + z * s.nu_dot[4])
        sway = m * (s.nu_dot[1] - z * s.nu_dot[3])
        return -sm.Matrix([surge, sway, m * s.nu_dot[2], -z * sway, z * surge, 0])
'''
SPIN = f'''
class Gyroscope(Wrench):
    """A wheel that turns about the body's x axis."""
    id = "gyroscope"
    family = "inertia"
    workless = True
{NOTES}
    H_wheel = Parameter("kg m^2/s", "its angular momentum")

    def wrench(self, s):
        return sm.Matrix([0, 0, 0, *-sm.Matrix(s.nu[3:]).cross(sm.Matrix([self.H_wheel, 0, 0]))])
'''
SHARE = f'''
class WallAddedMass(Wrench):
    """A share of the surge added mass that a wall adds."""
    id = "wall_added_mass"
    family = "inertia"
    requires = ("added_mass",)
{NOTES}
    wall_share = Parameter("1", "share of the added mass in open water", (0, 1))

    def wrench(self, s):
        added = AddedMass(self.thrusters).matrix()[0, 0]
        return sm.Matrix([-self.wall_share * added * s.nu_r_dot[0], 0, 0, 0, 0, 0])
'''
SHEAR = f'''
class ShearCurrent(Flow):
    """A current to the north that grows with depth."""
    id = "shear_current"
{NOTES}
    shear = Parameter("1/s", "growth of the current per depth", (-1, 1), linear=False, starts=(0.01,))

    def velocity(self, s):
        return sm.Matrix([self.shear * s.eta[2], 0, 0])

    def acceleration(self, s):
        down = (rotation(sm.Matrix(s.eta[3:])) * sm.Matrix(s.nu[:3]))[2]
        return sm.Matrix([self.shear * down, 0, 0])
'''
SLUGGISH = f'''
class WeakAndSlow(Actuation):
    """Every thruster is weak and slow."""
    id = "weak_and_slow"
    stage = 40
{NOTES}
    loss = PerThruster("1", "share lost", (-1, 1), linear=False, starts=(0.1,))
    T_slow = Parameter("s", "time constant", (0.01, 10), linear=False, starts=(0.5,), neutral=None)

    @property
    def states(self):
        return tuple(f"slow_{{n}}" for n in self.thrusters)

    def output(self, upstream, s):
        return self.state_symbols

    def rates(self, upstream, s):
        return (self.rest_state(upstream) - self.state_symbols) / self.T_slow

    def rest_state(self, upstream):
        return upstream - upstream.multiply_elementwise(self.loss)
'''
LIMIT = f'''
class Ceiling(Actuation):
    """Commands beyond a limit give no more."""
    id = "ceiling"
    stage = 30
{NOTES}
    ceiling = Parameter("command", "the limit", (0, 1e6), linear=False, starts=(1.0,), neutral=float("inf"))

    def output(self, upstream, s):
        return upstream.applyfunc(lambda c: sm.Max(-self.ceiling, sm.Min(c, self.ceiling)))
'''
SCALE = f'''
class LogScale(Measurement):
    """The speed log reads too much in surge."""
    id = "log_scale"
{NOTES}
    log_gain = Parameter("1", "read over true, minus one", (-0.5, 0.5), linear=False, starts=(0.0,))

    def reported(self, eta, nu, s):
        return eta, sm.Matrix([nu[0] * (1 + self.log_gain), *nu[1:]])
'''
POST = f'''
class RubbingPost(Wrench):
    """A post that the hull rubs along."""
    id = "rubbing_post"
    family = "tether"
{NOTES}
    rubbing = Parameter("N s/m^2", "drag per speed and distance", (0, 1e6))
    place = Place("post", "where it stands", "ned", 1e4)

    @classmethod
    def starts_near(cls, seen):
        return [{{"x_post": seen.get("x", (0.0, 0.0))[0], "y_post": 0.0, "z_post": 0.0}}]

    def wrench(self, s):
        return sm.Matrix([-self.rubbing * s.nu[0] * sm.Symbol("gap_of_post", real=True), 0, 0, 0, 0, 0])

    def abbreviations(self, s):
        away = sum((sm.Abs(a - b) for a, b in zip(s.eta[:3], self.place)), sm.Integer(0))
        return {{sm.Symbol("gap_of_post", real=True): away}}
'''
GOOD = {"keel": KEEL, "tank": TANK, "spin": SPIN, "share": SHARE, "shear": SHEAR, "post": POST}
GOOD |= {"sluggish": SLUGGISH, "limit": LIMIT, "scale": SCALE}


def effect_from(folder: Path, source: str) -> type[Effect]:
    file = folder / "my_effects.py"
    file.write_text(HEAD + source, encoding="utf-8")
    (cls,) = load_effects(file)
    return cls


@pytest.mark.parametrize("source", GOOD.values(), ids=GOOD)
def test_a_users_good_effect_passes(source: str, tmp_path: Path) -> None:
    findings = check_effect(effect_from(tmp_path, source))
    assert [f.message for f in findings if not f.ok] == []


# Each line: effect, what stands in it, what is written instead, the checks that must fail, what one must say.
BROKEN = [
    # the declaration
    ("keel", '"keel_drag"', '"keel drag"', "id", "'keel drag' is not an identifier"),
    ("keel", '"keel_drag"', '"lift"', "id", "belongs to Lift already"),
    ("keel", '"""Drag of a keel below the origin."""', "pass", "documentation", "meaning is missing"),
    ("keel", '"Hoerner (1965), Fluid-Dynamic Drag"', '""', "documentation", "reference is missing"),
    ("keel", 'reference = "Hoerner', '_unused = "Hoerner', "documentation", "reference is missing"),
    ("keel", '"too fast at high speed"', '" "', "documentation", "signature is missing"),
    ("keel", 'family = "damping"', "", "documentation", "family is missing"),
    ("share", '("added_mass",)', '("added_mas",)', "requires", "'added_mas', which is not a known effect"),
    ("tank", "tank_m", "I_z", "names", "'I_z' is taken by effect 'rigid_body'"),
    ("keel", "C_keel", "w", "names", "'w' is taken by a signal"),
    ("keel", "C_keel", "X_u_forward", "names", "'X_u_forward' is taken by effect 'linear_damping'"),
    ("sluggish", 'f"slow_{n}"', '"slow"', "names", "'slow' is declared twice"),
    ("keel", "(0, 5)", "(5, 0)", "bounds", "bounds of 'C_keel' are 5 to 0"),
    ("keel", "default=0.1", "default=-0.1", "bounds", "default -0.1 of 'keel_area' is outside"),
    ("shear", "starts=(0.01,)", "starts=(2.0,)", "bounds", "start 2 of 'shear' is outside"),
    ("post", '{"x_post"', '{"rubbing": 1.0, "x_post"', "bounds", "'rubbing', which is not a shape parameter"),
    ("post", '0.0, "z_post"', '1e5, "z_post"', "bounds", "100000 for 'y_post', outside"),
    (
        "post",
        'seen.get("x", (0.0, 0.0))[0]',
        'seen["x"][0]',
        "bounds",
        r"my_effects.py', line \d+: starts_near\(\) of effect 'rubbing_post' fails with KeyError: 'x'",
    ),
    ("post", '"gap_of_post"', '"z_post"', "names", "abbreviation 'z_post' is also a parameter"),
    ("shear", ", starts=(0.01,)", "", "bounds", "neither starts nor a default"),
    ("keel", '"its area"', '""', "bounds", "'keel_area' has no meaning"),
    ("keel", '"m^2"', '"m^2^2"', "bounds", "'keel_area'.*not understood"),
    ("keel", "dissipative = True", "dissipative = workless = True", "claims", "keep one of the two"),
    # the form of the statement
    ("keel", "force, 0, 0, 0, 0]", "force, 0, 0, 0]", "shape", r"wrench\(\) has the shape \(5, 1\).*6 rows"),
    ("keel", "sm.Matrix([0, force", "list([0, force", "shape", "returns list: return a sympy.Matrix"),
    (
        "keel",
        "s.nu_r[1]) *",
        "s.nu_r[9]) *",
        "shape",
        r"line \d+: wrench\(\) of effect .* fails with IndexError",
    ),
    ("keel", "s.rho / 2", 's.rho * sm.Symbol("half")', "symbols", "'half', neither a signal nor a parameter"),
    ("share", 'requires = ("added_mass",)', "", "symbols", "'X_udot'.*the effect that has it in requires"),
    (
        "shear",
        "s.eta[2]",
        "s.nu_r[2] * s.t",
        "symbols",
        "the signal 'w_r', which does not exist at that place",
    ),
    ("keel", "self.keel_area * self.C_keel", "self.C_keel", "parameters units", "'keel_area' does not occur"),
    # units
    ("keel", '"m^2"', '"m"', "units", r"Y: the term .* is in kg/s\^2 where N is wanted"),
    (
        "keel",
        "[0, force, 0, 0,",
        "[0, force, 0, force,",
        "units dissipative",
        "K: the term .* is in N where N m is wanted",
    ),
    (
        "keel",
        "sm.Abs(s.nu_r[1]) *",
        "sm.tanh(s.nu_r[1]) *",
        "units dissipative",
        "number but 'v_r' is in m/s",
    ),
    (
        "keel",
        "sm.Abs(s.nu_r[1]) *",
        "(sm.Abs(s.nu_r[1]) + s.nu[5]) *",
        "units dissipative",
        "is in 1/s but .* is in m/s",
    ),
    ("shear", '"1/s"', '"m/s"', "units", r"water north: the term 'shear\*z' is in .* where m/s is wanted"),
    (
        "sluggish",
        'Parameter("s"',
        'Parameter("1"',
        "units",
        r"d\(slow_port\)/dt: .* where command/s is wanted",
    ),
    ("limit", '"command"', '"N"', "units", "'ceiling' is in N but 'command_port' is in command"),
    ("scale", 'log_gain = Parameter("1"', 'log_gain = Parameter("m/s"', "units", "reported u"),
    # absent at neutral values
    ("keel", "self.C_keel *", "(1 + self.C_keel) *", "zero", "Y does not vanish where C_keel = 0"),
    ("keel", "self.keel_area * self.C_keel", "self.C_keel / self.keel_area", "units", "where N is wanted"),
    (
        "tank",
        "(0, 100)",
        "(0, 100), neutral=None",
        "zero",
        "X does not vanish although no parameter can switch",
    ),
    (
        "spin",
        "[self.H_wheel, 0, 0]",
        "[self.H_wheel / self.H_wheel**2, 0, 0]",
        "zero units linearity",
        "is not defined",
    ),
    (
        "sluggish",
        "return self.state_symbols",
        "return 2 * self.state_symbols",
        "zero",
        "output_port does not vanish",
    ),
    ("limit", ', neutral=float("inf")', "", "zero", "output_port does not vanish where ceiling = 0"),
    (
        "scale",
        "(1 + self.log_gain)",
        "self.log_gain",
        "zero",
        "reported u does not vanish where log_gain = 0",
    ),
    # linearity
    ("keel", "self.C_keel *", "self.C_keel**2 *", "linearity", "Y is not linear in 'C_keel'"),
    (
        "keel",
        "self.C_keel *",
        "sm.Abs(self.C_keel - 1) * self.C_keel *",
        "linearity",
        "not linear in 'C_keel'",
    ),
    ("keel", "(0, 5))", "(0, 5), linear=False, starts=(1.0,))", "linearity", "'C_keel' enters linearly"),
    ("keel", "linear=False, default", "default", "linearity", "'C_keel', 'keel_area' multiply each other"),
    ("shear", "linear=False, ", "", "linearity", "'shear' of a flow effect is not a regressor column"),
    ("scale", "linear=False, ", "", "linearity", "of a measurement effect is not a regressor column"),
    ("sluggish", "(0.01, 10), linear=False", "(0.01, 10)", "linearity", "'T_slow' acts through a state"),
    # inertia
    (
        "tank",
        "m * s.nu_dot[2], -z",
        "m * (s.nu_dot[2] + z * s.nu_dot[5]), -z",
        "symmetry",
        r"M\[yaw, heave\] = 0 but",
    ),
    ("tank", "s.nu_dot[2], -z", "s.nu_dot[2]**2 / s.g, -z", "symmetry", "not linear in the acceleration"),
    ("tank", "(0, 100)", "(-1, 100)", "inertia", "inertia in surge can be negative"),
    (
        "tank",
        "sway, z * surge, 0",
        "sway, z * surge - m * z**2 * s.nu_dot[4] / 2, 0",
        "inertia",
        "not positive semi",
    ),
    # energy
    ("keel", "force = -s.rho", "force = s.rho", "dissipative", "it feeds .* W into the vehicle at v = "),
    ("keel", "sm.Abs(s.nu_r[1]) * s.nu_r[1]", "s.nu_r[1]**2", "dissipative", "it feeds .* at v = -"),
    ("keel", "[0, force, 0", "[force, 0, 0", "dissipative", "it feeds"),
    (
        "spin",
        ".cross(sm.Matrix([self.H_wheel, 0, 0]))",
        " * self.H_wheel",
        "workless",
        "its power is -H_wheel",
    ),
    # flow and measurement
    ("shear", "def acceleration", "def accelerations", "rate", r"row 1: return .*shear"),
    (
        "shear",
        "self.shear * down",
        "-self.shear * down",
        "rate",
        "acceleration.. is not the rate of velocity",
    ),
    (
        "scale",
        "nu[0] * (1 + self.log_gain)",
        "nu[0] + self.log_gain * sm.Abs(nu[0])",
        "affine",
        "reported u is not",
    ),
    (
        "scale",
        "return eta, ",
        "return eta + sm.Matrix([0] * 5 + [self.log_gain * eta[5]**2]), ",
        "affine",
        "reported psi is not affine in attitude",
    ),
    (
        "scale",
        "return eta, ",
        "return eta + sm.Matrix([0] * 5 + [self.log_gain * sm.atan2(nu[1], nu[0])]), ",
        "affine",
        "reported psi depends on more than the attitude",
    ),
    ("sluggish", "(self.rest_state(upstream) -", "(upstream -", "rest", "'slow_port' still moves"),
]


@pytest.mark.parametrize(("effect", "before", "after", "checks", "message"), BROKEN)
def test_a_broken_effect_fails_these_checks_and_no_other(
    effect: str, before: str, after: str, checks: str, message: str, tmp_path: Path
) -> None:
    assert before in GOOD[effect]
    findings = check_effect(effect_from(tmp_path, GOOD[effect].replace(before, after)))
    failed = [f for f in findings if not f.ok]
    assert {f.check for f in failed} == set(checks.split()), failed
    assert any(re.search(message, f.message) for f in failed), failed
    assert all("\n" not in f.message for f in failed)


def test_what_is_reported_before_it_happens_is_found(tmp_path: Path) -> None:
    source = f'''
class Echo(Measurement):
    """A log on the sea bed hears of the position late."""
    id = "echo"
{NOTES}
    echo_time = Parameter("s", "way of the sound", (0, 2), linear=False, starts=(0.1,))

    def reported(self, eta, nu, s):
        return eta, nu

    def age(self):
        return sm.Matrix([self.echo_time] * 3 + [0] * 9)
'''
    assert all(f.ok for f in check_effect(effect_from(tmp_path, source)))
    early = check_effect(effect_from(tmp_path, source.replace("(0, 2)", "(-1, 2)")))
    assert [f.check for f in early if not f.ok] == ["dead_time"]
    assert "age of reported x can be negative" in next(f.message for f in early if not f.ok)


def test_all_findings_come_at_once(tmp_path: Path) -> None:
    source = KEEL.replace("self.C_keel *", "(1 + self.C_keel) *").replace("force = -s.rho", "force = s.rho")
    failed = {f.check for f in check_effect(effect_from(tmp_path, source)) if not f.ok}
    assert failed == {"zero", "dissipative"}


def test_a_class_without_id_is_reported(tmp_path: Path) -> None:
    cls = effect_from(tmp_path, KEEL.replace('id = "keel_drag"', ""))
    assert [(f.check, f.message[:13]) for f in check_effect(cls) if not f.ok] == [("id", "id is missing")]


@pytest.mark.parametrize(
    ("before", "after", "check", "message"),
    [
        (
            "class KeelDrag(Wrench)",
            "class KeelDrag(Effect)",
            "id",
            "KeelDrag is of no kind: derive it from Wrench",
        ),
        (
            "dissipative = True",
            'requires = "added_mass"',
            "requires",
            r"write a tuple, such as \('added_mass',\)",
        ),
        ("dissipative = True", "states = property(lambda self: 1 / 0)", "names", "ZeroDivisionError"),
        ("dissipative = True", "def __init__(self): pass", "names", "TypeError"),
    ],
)
def test_a_declaration_that_cannot_be_used_is_a_finding_and_no_crash(
    before: str, after: str, check: str, message: str, tmp_path: Path
) -> None:
    cls = effect_from(tmp_path, KEEL.replace(before, after))
    failed = {f.check: f.message for f in check_effect(cls) if not f.ok}
    assert re.search(message, failed[check])


def test_a_users_file_may_hold_dataclasses(tmp_path: Path) -> None:
    helper = "from __future__ import annotations\nfrom dataclasses import dataclass\n"
    (tmp_path / "mine.py").write_text(
        helper + HEAD + "@dataclass\nclass Foil:\n    span: float\n" + KEEL, encoding="utf-8"
    )
    assert [cls.__name__ for cls in load_effects(tmp_path / "mine.py")] == ["KeelDrag"]


def test_an_expression_that_no_rule_knows_is_a_finding_and_no_crash(tmp_path: Path) -> None:
    cls = effect_from(tmp_path, KEEL.replace("sm.Abs(s.nu_r[1])", "sm.Function('drag')(s.nu_r[1])"))
    failed = {f.check: f.message for f in check_effect(cls) if not f.ok}
    assert "'drag(v_r)' has no rule for units" in failed["units"]
    assert "cannot be worked out" in failed["linearity"]


# --- dimensional analysis ---------------------------------------------------------------------------
x, v, t, c = sm.symbols("x v t c", real=True)
UNITS = {x: "m", v: "m/s", t: "s", c: "command"}


@pytest.mark.parametrize(
    ("expression", "unit"),
    [
        (x + v * t, "m"),
        (sm.sqrt(x * v * t), "m"),
        (sm.Abs(v) * v, "m^2/s^2"),
        (sm.sign(v) * x, "m"),
        (sm.atan2(x, v * t), "rad"),
        (sm.tanh(v * t / x), "1"),
        (sm.exp(x / (v * t)), "1"),
        (sm.pi * x, "m"),
        (sm.Max(x, 0, v * t), "m"),
        (sm.Piecewise((x, v > 0), (0, True)), "m"),
        (c * x, "command m"),
        (2 ** (x / (v * t)), "1"),
    ],
)
def test_unit_of_an_expression(expression: sm.Expr, unit: str) -> None:
    assert dimension_of(expression, UNITS) == dimension(unit)
    require_unit(expression, unit, UNITS)


def test_zero_fits_every_unit() -> None:
    assert dimension_of(sm.Integer(0), UNITS) is None
    require_unit(sm.Integer(0), "N", UNITS)


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        (x + v, r"in 'v \+ x' the term '.' is in (m but 'v' is in m/s|m/s but 'x' is in m)$"),
        (1 + c, "the term '1' is without a unit but 'c' is in command"),
        (sm.sin(x), r"'sin\(x\)' needs a pure number but 'x' is in m"),
        (sm.exp(t), r"'exp\(t\)' needs a pure number"),
        (x**t, "needs a pure number but 't' is in s"),
        (x ** (x / (v * t)), "raises a term in m to a power that is not a number"),
        (sm.Max(x, t), "is in s but 'x' is in m"),
        (sm.Piecewise((x, v > x), (0, True)), "in 'v > x' the term 'v' is in m/s but 'x' is in m"),
        (sm.Piecewise((x, v > 0), (t, True)), "is in m but 't' is in s"),
        (sm.Symbol("stranger") * x, "symbol stranger has no unit"),
        (sm.Heaviside(x), "has no rule for units"),
    ],
)
def test_expressions_without_a_unit_are_named(expression: sm.Expr, message: str) -> None:
    with pytest.raises(UndertowError, match=message):
        dimension_of(expression, UNITS)


def test_units_in_words() -> None:
    texts = [unit_text(dimension(u)) for u in ("kg m/s^2", "N m", "rad", "command/s", "kg s^-2")]
    assert texts == ["in N", "in N m", "without a unit", "in command/s", "in kg/s^2"]


@pytest.mark.parametrize(
    ("declared", "shown"),
    [
        ("N/(m/s^2)", "kg"),
        ("N m/((rad/s)^2)", "kg m^2"),
        ("N m/(rad/s)", "kg m^2/s"),
        ("N/((m/s)^3)", "kg s/m^2"),
        ("N/(m)", "kg/s^2"),
        ("1/(m s)", "1/(m s)"),
        ("rad/s", "rad/s"),
        ("N/command", "N/command"),
    ],
)
def test_units_as_short_as_files_have_them(declared: str, shown: str) -> None:
    assert short_unit(declared) == shown
    assert dimension(declared) == dimension(shown)


@pytest.mark.parametrize(
    ("rows", "answer"),
    [
        ([[2.0, 1.0], [1.0, 2.0]], True),
        ([[1.0, 1.0], [1.0, 1.0]], True),
        ([[1.0, 2.0], [2.0, 1.0]], False),
        ([[0.0, 0.0], [0.0, 0.0]], True),
        ([[1.0, 0.0], [0.0, -1e-3]], False),
    ],
)
def test_positive_semidefinite(rows: list[list[float]], answer: bool) -> None:
    assert positive_semidefinite(rows) is answer


# --- discovery --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("gone.py", None, "does not exist"),
        ("empty.py", "x = 1", "holds no effect"),
        ("abstract.py", HEAD + "class Half(Wrench):\n    id = 'half'", "holds no effect"),
        ("syntax.py", "class", "cannot be run: SyntaxError"),
        ("raises.py", "raise RuntimeError('no')", "cannot be run: RuntimeError: no"),
        ("exits.py", "import sys\nsys.exit(0)", "cannot be run: SystemExit"),
        ("text.txt", "", "is not a Python file"),
    ],
)
def test_files_without_effects_are_refused(
    name: str, content: str | None, message: str, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(UndertowError, match=message):
        load_effects(tmp_path / name)


def test_an_id_that_is_taken_is_refused(tmp_path: Path) -> None:
    cls = effect_from(tmp_path, KEEL.replace('"keel_drag"', '"lift"'))
    with pytest.raises(UndertowError, match="effect id 'lift' of KeelDrag is taken already"):
        merge(catalogue(), [cls])


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("undertow.model.effects.lift:Missing", "'keel' of an installed package cannot be loaded"),
        ("undertow.model.effects.lift:Signals", "is not an effect class"),
    ],
)
def test_broken_plugins_are_named(value: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("keel", value, "undertow.effects")
    monkeypatch.setattr("undertow.model.catalogue.entry_points", lambda group: [point])
    with pytest.raises(UndertowError, match=message):
        catalogue.__wrapped__()


def test_installed_effects_join_the_catalogue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "keel_plugin.py").write_text(HEAD + KEEL, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    point = EntryPoint("keel", "keel_plugin:KeelDrag", "undertow.effects")
    monkeypatch.setattr("undertow.model.catalogue.entry_points", lambda group: [point])
    assert "keel_drag" in catalogue.__wrapped__()
