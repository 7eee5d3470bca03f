"""Vehicle files: what they say reaches the model, and what cannot be is refused in one line that helps."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from undertow.errors import UndertowError
from undertow.model.loading import bundled_vehicles, load_vehicle
from undertow.model.vehicle import Value, Vehicle

FILE = """\
schema = "undertow/vehicle/1"
name = "tug"
degrees_of_freedom = ["surge", "sway", "yaw"]
signs = "sname"
generalised_forces = ["tau_X"]

[effects.rigid_body]
m = "10 kg"
x_g = "5 cm"
I_z = { value = "1 kg m^2", source = "CAD", assumed = true }

[effects.added_mass]
X_udot = { value = "-1 kg", estimate = true, sigma = "200 g" }

[effects.linear_damping]
X_u = { forward = "-1 N/(m/s)", backward = "-2 kg/s", estimate = true }

[effects.thruster_deadband]
deadband_width = 0.1

[[thrusters]]
name = "bow"
position = ["40 cm", 0, 0]
direction = [0, 1, 0]
thrust_per_command = { value = "2.5 N", sigma = "0.1 N", source = "bollard pull" }
limit = 1.0

[[thrusters]]
name = "main"
wrench = [1, 0, 0, 0, 0, 0.25]
"""


@pytest.fixture
def load(tmp_path: Path) -> Callable[[str], Vehicle]:
    def from_text(text: str) -> Vehicle:
        file = tmp_path / "vehicle.toml"
        file.write_bytes(text.encode())
        return load_vehicle(file)

    return from_text


# --- what a good file says ------------------------------------------------------------------------
def test_values_are_in_si_with_what_is_known_of_them(load: Callable[[str], Vehicle]) -> None:
    vehicle = load(FILE)
    assert vehicle.values["m"] == Value(10.0)
    assert vehicle.values["mx_g"].value == pytest.approx(0.5)
    assert vehicle.values["I_z"] == Value(1.0, source="CAD", assumed=True)
    assert vehicle.values["X_udot"] == Value(-1.0, estimate=True, sigma=0.2)
    assert vehicle.values["X_u_forward"] == Value(-1.0, estimate=True)
    assert vehicle.values["X_u_backward"] == Value(-2.0, estimate=True)
    assert vehicle.values["deadband_width"].value == 0.1


def test_thrusters(load: Callable[[str], Vehicle]) -> None:
    bow, main = load(FILE).thrusters
    assert bow.wrench == pytest.approx((0, 1, 0, 0, 0, 0.4))
    assert bow.thrust_per_command == Value(2.5, sigma=0.1, source="bollard pull")
    assert bow.limit == 1.0
    assert main.wrench == (1, 0, 0, 0, 0, 0.25)
    assert main.thrust_per_command == Value(1.0)
    assert main.limit is None
    assert bow.lowest is main.lowest is None
    assert load(FILE).lowest_commands == {"bow": -1.0}


def test_a_thruster_may_be_unable_to_reverse(load: Callable[[str], Vehicle]) -> None:
    vehicle = load(FILE.replace("limit = 1.0", "limit = 1.0\nlowest = 0"))
    assert vehicle.thrusters[0].lowest == 0.0
    assert vehicle.lowest_commands == {"bow": 0.0}


def test_position_and_direction_give_the_moment(load: Callable[[str], Vehicle]) -> None:
    text = FILE.replace('["40 cm", 0, 0]', '["1 m", "2 m", "3 m"]').replace("[0, 1, 0]", "[0.6, 0, 0.8]")
    # r x F = (1, 2, 3) x (0.6, 0, 0.8), by hand
    assert load(text).thrusters[0].wrench == pytest.approx((0.6, 0, 0.8, 1.6, 1.0, -1.2))


def test_signs_names_and_environment(load: Callable[[str], Vehicle]) -> None:
    vehicle = load('water_density = "1.025 g/cm^3"\ngravity = "9.83 m/s^2"\n' + FILE)
    assert vehicle.environment == pytest.approx({"rho": 1025.0, "g": 9.83})
    assert vehicle.command_names == ("bow", "main", "tau_X")
    assert vehicle.degrees_of_freedom == ("surge", "sway", "yaw")
    assert vehicle.velocity_names == ("u", "v", "r")


def test_degrees_of_freedom_come_in_the_order_of_sname(load: Callable[[str], Vehicle]) -> None:
    vehicle = load(FILE.replace('["surge", "sway", "yaw"]', '["yaw", "surge", "sway"]'))
    assert vehicle.degrees_of_freedom == ("surge", "sway", "yaw")


def test_magnitudes_turn_the_left_side_only(load: Callable[[str], Vehicle]) -> None:
    positive = FILE.replace('"sname"', '"magnitudes"').replace('"-', '"')
    assert load(positive).values == load(FILE).values


@pytest.mark.parametrize("text", ['"0.1 command"', '"0.1"', "0.1"])
def test_what_is_counted_in_commands_is_a_plain_number(text: str, load: Callable[[str], Vehicle]) -> None:
    vehicle = load(FILE.replace("deadband_width = 0.1", f"deadband_width = {text}"))
    assert vehicle.values["deadband_width"].value == 0.1


def test_a_sign_that_is_meant_can_be_allowed(load: Callable[[str], Vehicle]) -> None:
    text = FILE.replace('{ value = "-1 kg",', '{ value = "0.2 kg", allow_sign = true,')
    assert load(text).values["X_udot"].value == 0.2


def test_byte_order_mark_and_windows_line_ends(load: Callable[[str], Vehicle]) -> None:
    assert load("\ufeff" + FILE.replace("\n", "\r\n")).values == load(FILE).values


@pytest.mark.parametrize("name", sorted(bundled_vehicles()))
def test_bundled_vehicles_load_by_name(name: str) -> None:
    vehicle = load_vehicle(name)
    assert vehicle.name == name
    unsourced = [n for n, v in vehicle.values.items() if not v.source]
    assert unsourced == [], "every number of a bundled vehicle has a source"


# --- what is refused: what stands in the file, what is written instead, what the line must say ------
REFUSED = [
    # keys
    ("name =", "nam =", r"key 'nam' is not known \(did you mean 'name'\?\); known are schema, name"),
    (
        "estimate = true, sigma",
        "estimat = true, sigma",
        r"key 'effects.added_mass.X_udot.estimat'.*'estimate'\?",
    ),
    ("direction =", "directon =", r"key 'thrusters.#1.directon' is not known \(did you mean 'direction'\?\)"),
    (
        "[effects.linear_damping]",
        "[effects.linear_dampin]",
        r"effect 'linear_dampin' is not.*'linear_damping'\?",
    ),
    (
        "X_udot",
        "X_uddot",
        r"\[effects.added_mass\] has no parameter 'X_uddot' \(did you mean 'X_udot'\?\); it has",
    ),
    ('name = "tug"\n', "", "'name' is missing: add it"),
    ("vehicle/1", "vehicle/2", "'schema'.*'undertow/vehicle/1', found 'undertow/vehicle/2'"),
    (
        '"surge", "sway"',
        '"surg", "sway"',
        r"'degrees_of_freedom.#1'.*found 'surg' \(did you mean 'surge'\?\)",
    ),
    ('["surge", "sway", "yaw"]', "[]", "'degrees_of_freedom'.*at least 1"),
    ('"sname"', '"snam"', r"'signs'.*found 'snam' \(did you mean 'sname'\?\)"),
    (
        "[[thrusters]]",
        "[effects.thrusters]\n[[thrusters]]",
        r"\[effects.thrusters\] comes with \[\[thrusters\]\]",
    ),
    ('m = "10 kg"', 'm = "10 kg"\nm = "11 kg"', "not valid TOML.*line 9"),
    # quantities
    (
        '"10 kg"',
        '"10 m"',
        r"rigid_body\] m: '10 m' has the dimension \[length\], but kg \(\[mass\]\) is needed",
    ),
    ('"10 kg"', '"ten kg"', r"rigid_body\] m: 'ten kg' is not a number with a unit"),
    ('"10 kg"', "nan", r"rigid_body\] m: 'nan' is not a finite quantity: give a number in kg"),
    ('"10 kg"', "-inf", r"rigid_body\] m: '-inf' is not a finite quantity"),
    ('"10 kg"', "1e999", r"rigid_body\] m: 'inf' is not a finite quantity"),
    (
        '"10 kg"',
        "true",
        "'effects.rigid_body.m' = True is not a quantity: write a number in SI or a text such as",
    ),
    ('"10 kg"', "[1, 2]", r"'effects.rigid_body.m' = \[1, 2\] is not a quantity"),
    ('"10 kg"', "2024-01-01", "'effects.rigid_body.m' = datetime.* is not a quantity"),
    ('"10 kg"', "0x" + "f" * 6000, r"rigid_body.m is an integer of 24000 bits \(limit 64\)"),
    ('"10 kg"', "9" * 6000, "not valid TOML: Exceeds the limit"),
    ('"200 g"', '"-200 g"', r"added_mass\] X_udot sigma = -0.2 is impossible"),
    ('"200 g"', '"1 m"', r"added_mass\] X_udot sigma: '1 m' has the dimension"),
    (
        "deadband_width = 0.1",
        'deadband_width = "0.1 kg"',
        r"deadband_width: '0.1 kg' has the dimension \[mass\]",
    ),
    # signs and bounds
    ('"-1 kg"', '"1 kg"', r'= 1 is impossible under signs = "sname".*signs = "magnitudes".*allow_sign'),
    ('"sname"', '"magnitudes"', r'X_udot = -1 is impossible under signs = "magnitudes".*signs = "sname"'),
    ('"-2 kg/s"', '"2 kg/s"', r"linear_damping\] X_u_backward = 2 is impossible"),
    ('"10 kg"', '"-10 kg"', r"rigid_body\] m = -10 is impossible"),
    ("deadband_width = 0.1", "deadband_width = -0.1", "deadband_width = -0.1 is impossible"),
    # forward and backward
    (
        ', backward = "-2 kg/s"',
        "",
        r"X_u needs either 'value' or both 'forward' and 'backward', found forward",
    ),
    ("{ forward", "{ value = -1, forward", "found value and forward and backward"),
    (
        '{ value = "1 kg m^2",',
        "{ forward = 1, backward = 2,",
        "I_z cannot differ forward and backward: give one",
    ),
    ('x_g = "5 cm"', "x_g = { forward = 1, backward = 2 }", r"rigid_body\] x_g needs one 'value'"),
    ('x_g = "5 cm"', "x_g = { value = 1, estimate = true }", r"x_g cannot be estimated.*mx_g = \{ value"),
    ('x_g = "5 cm"', 'x_g = "5 kg"', r"rigid_body\] x_g: '5 kg' has the dimension"),
    ('x_g = "5 cm"', "x_g = 0.05\nmx_g = 2.0", "states the same quantity twice, mx_g and x_g"),
    # the vehicle as a whole
    ('m = "10 kg"\nx_g = "5 cm"\n', "", r"\[effects.rigid_body\] lacks m \(mass\): give it in kg"),
    ('m = "10 kg"\n', "", "x_g, y_g, z_g need the mass m"),
    ('I_z = { value = "1 kg m^2", source = "CAD", assumed = true }\n', "", "lacks I_z.*kg m"),
    ("5 cm", "50 cm", r"I_z = 1 kg m\^2 about the body origin leaves -1.5 about the centre of gravity"),
    (
        "[effects.rigid_body]",
        "[effects.rigid_body_coriolis]\n[effects.rigid_bod]",
        "'rigid_bod' is not known",
    ),
    (
        "[[thrusters]]",
        "[effects.trim_offset]\n[[thrusters]]",
        r"'trim_offset' shares parameters of 'restoring'.*add",
    ),
    ('["tau_X"]', '["tau_Z"]', "generalised_forces has tau_Z, but heave is not a degree of freedom"),
    ('["tau_X"]', '["tau_Q"]', "'generalised_forces.#1'.*found 'tau_Q'"),
    ("signs =", "water_density = -1\nsigns =", r"water_density = -1 kg/m\^3 is impossible"),
    ("signs =", 'gravity = "9.81 m/s"\nsigns =', r"gravity: '9.81 m/s' has the dimension"),
    ("signs =", 'excluded_effects = ["tether_drg"]\nsigns =', "'tether_drg' is not known.*tether_drag"),
    (
        "signs =",
        'excluded_effects = ["added_mass"]\nsigns =',
        r"excluded_effects of vehicle 'tug' names 'added_mass': remove it there, or remove \[eff",
    ),
    # thrusters
    ('"main"', '"bow"', "two thrusters are called 'bow': rename one"),
    ('"main"', '"u"', "thruster 'u' has the name of a measured channel"),
    ('"main"', '"tau_X"', "thruster 'tau_X' has the name of a measured channel"),
    ('"main"', '"a b"', "'thrusters.#2.name': a name must be a letter, then.*found 'a b'"),
    ('"main"', '"\\u0430"', "'thrusters.#2.name': a name must be a letter"),
    ('"main"', '"x; rm -rf /"', "'thrusters.#2.name': a name must be"),
    ("[0, 1, 0]", "[1, 1, 0]", "thruster 'bow': direction has length 1.41421; give a unit vector"),
    ("[0, 1, 0]", "[nan, 1, 0]", "thruster 'bow' direction: 'nan' is not a finite quantity"),
    ("[0, 1, 0]", "[1" + "0" * 400 + ", 1, 0]", "direction is an integer of 13.. bits"),
    ("direction = [0, 1, 0]\n", "", "thruster 'bow' needs either 'wrench' or 'position' and 'direction'"),
    ("direction = [0, 1, 0]", "direction = [0, 1, 0]\nwrench = [0, 1, 0, 0, 0, 0]", "'bow' needs either"),
    ('"40 cm"', '"40 N"', "thruster 'bow' position: '40 N' has the dimension"),
    ("0, 0, 0.25]", "0, 0.25]", "'thrusters.#2.wrench': List should have at least 6"),
    ("0, 0, 0.25]", "0, 0, inf]", "thruster 'main' wrench: 'inf' is not a finite quantity"),
    ("[1, 0, 0, 0, 0, 0.25]", "[0, 0, 0, 0, 0, 0]", "thruster 'main' wrench is zero"),
    ('"2.5 N"', '"-2.5 N"', "'bow' thrust_per_command = -2.5 N is not a thrust.*reverse the direction"),
    ('"2.5 N"', '"2.5 kg"', "thruster 'bow' thrust_per_command: '2.5 kg' has the dimension"),
    ('value = "2.5 N"', "forward = 1, backward = 2", "thruster 'bow' thrust_per_command needs a 'value'"),
    ("limit = 1.0", "limit = -1", "thruster 'bow' limit = -1 is impossible"),
    (
        "limit = 1.0",
        "limit = 1\nlowest = -2",
        "thruster 'bow' lowest = -2 is not between -1 and 0: give 0 for",
    ),
    ("limit = 1.0", "limit = 1\nlowest = 0.1", "thruster 'bow' lowest = 0.1 is not between -1 and 0"),
]


@pytest.mark.parametrize(("before", "after", "message"), REFUSED, ids=[str(i) for i in range(len(REFUSED))])
def test_refused(
    before: str, after: str, message: str, load: Callable[[str], Vehicle], tmp_path: Path
) -> None:
    assert before in FILE
    with pytest.raises(UndertowError) as caught:
        load(FILE.replace(before, after, 1))
    line = str(caught.value)
    assert re.search(message, line), line
    assert line.startswith(str(tmp_path / "vehicle.toml")), "the file is named"
    assert line.isprintable()


def test_a_vehicle_without_inertia_is_refused(load: Callable[[str], Vehicle]) -> None:
    text = re.sub(r"\[effects.rigid_body\](.|\n)*?\n\n", "", FILE)
    with pytest.raises(UndertowError, match=r"nothing has inertia in sway.*leave sway out"):
        load(text)
    text = re.sub(r"\[effects.added_mass\](.|\n)*?\n\n", "", text)
    with pytest.raises(UndertowError, match=r"no inertia: add \[effects.rigid_body\]"):
        load(text)


def test_inertia_is_checked_backward_too(load: Callable[[str], Vehicle]) -> None:
    text = FILE.replace('value = "-1 kg"', "forward = -1.0, backward = 11.0, allow_sign = true")
    with pytest.raises(
        UndertowError, match="not positive definite in backward motion: its entry for surge, -1"
    ):
        load(text)


# --- nothing in a file is executed, however it is made ---------------------------------------------
MARKER = "from pathlib import Path\nPath(__file__).with_suffix('.ran').touch()\n"
KEEL = '''
import sympy as sm
from undertow.model.effect import Wrench
from undertow.model.parameter import Parameter

class Keel(Wrench):
    """Drag of a keel."""
    id = "keel"
    family = "damping"
    reference = "none"
    Y_keel = Parameter("N/(m/s)", "drag")

    def wrench(self, s):
        return sm.Matrix([0, self.Y_keel * s.nu_r[1], 0, 0, 0, 0])
'''


@pytest.fixture
def with_effects(tmp_path: Path) -> Path:
    (tmp_path / "mine.py").write_text(MARKER + KEEL, encoding="utf-8")
    text = FILE.replace("signs", 'effects_from = ["mine.py"]\nsigns', 1)
    file = tmp_path / "vehicle.toml"
    file.write_text(text.replace("[[thr", "[effects.keel]\nY_keel = -3.0\n\n[[thr", 1), encoding="utf-8")
    return file


def test_effects_of_a_file_do_not_run_by_themselves(with_effects: Path) -> None:
    with pytest.raises(
        UndertowError, match=r"effects_from names mine.py.*pass --effects .*mine.py if you trust"
    ):
        load_vehicle(with_effects)
    assert not (with_effects.parent / "mine.ran").exists()


def test_effects_run_where_the_user_names_the_file(with_effects: Path) -> None:
    vehicle = load_vehicle(with_effects, effect_files=[with_effects.parent / "mine.py"])
    assert vehicle.values["Y_keel"].value == -3.0
    assert (with_effects.parent / "mine.ran").exists()


def test_effects_run_where_the_user_trusts_the_vehicle(with_effects: Path) -> None:
    assert "Y_keel" in load_vehicle(with_effects, trust_effects=True).parameter_names


def test_a_file_that_is_named_twice_runs_once(with_effects: Path) -> None:
    same = [
        with_effects.parent / "mine.py",
        with_effects.parent / ".." / with_effects.parent.name / "mine.py",
    ]
    assert "Y_keel" in load_vehicle(with_effects, effect_files=same, trust_effects=True).parameter_names


def test_only_the_named_file_runs(with_effects: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.py"
    other.write_text(KEEL, encoding="utf-8")
    assert "Y_keel" in load_vehicle(with_effects, effect_files=[other]).parameter_names
    assert not (tmp_path / "mine.ran").exists()


@pytest.mark.parametrize(
    "expression", ["__import__('os').system('touch ran')", "9**9**9**9", "open('ran', 'w')", "1 kg; x = 1"]
)
def test_quantities_are_read_and_not_worked_out(
    expression: str, load: Callable[[str], Vehicle], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UndertowError, match=r"rigid_body\] m: .*(not a number|not understood)"):
        load(FILE.replace("10 kg", expression))
    assert [p.name for p in tmp_path.iterdir()] == ["vehicle.toml"]


@pytest.mark.parametrize("name", ["../../etc/passwd", "<script>alert(1)</script>", "a'b\\\"c", "naïve ψ"])
def test_names_of_vehicles_are_only_text(name: str, load: Callable[[str], Vehicle]) -> None:
    vehicle = load(FILE.replace('"tug"', f'"{name}"'))
    assert vehicle.name == name.replace('\\"', '"')


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('"tug"', '"a\\u001b[31mb"', "'name'.*printable"),
        ('"tug"', '"a\\nb"', "'name'.*printable"),
        ('"tug"', '"' + "a" * 81 + '"', "'name'.*at most 80"),
        (
            "[effects.added_mass]",
            '[effects."a\\u001b]0;\\n\\u202e"]',
            r"effect 'a\\x1b\]0; \\u202e' is not known",
        ),
        ("[effects.added_mass]", '[effects."' + "a" * 100_000 + '"]', r"effect 'aaaa.* \.\.\. .*lists them$"),
        ("X_udot", '"X_\\u001b[2J"', r"has no parameter 'X_\\x1b\[2J'"),
    ],
)
def test_unprintable_names_do_not_reach_the_terminal(
    before: str, after: str, message: str, load: Callable[[str], Vehicle]
) -> None:
    with pytest.raises(UndertowError, match=message) as caught:
        load(FILE.replace(before, after, 1))
    assert str(caught.value).isprintable()
    assert len(str(caught.value)) < 2000


@pytest.mark.parametrize(
    ("after", "message"),
    [
        ("[" * 50_000 + "]" * 50_000, "nested too deeply"),
        ("{a=" * 20_000 + "1" + "}" * 20_000, "nested too deeply"),
        ("{" + ".".join("a" * 30_000) + " = 1}", "so many dots"),
        ("{" + " . ".join("1.1" for _ in range(5_000)) + " = 1}", "so many dots"),
        ("[" + "1," * 100_000 + "]", r"'effects.rigid_body.m' = \[1, 1.*\.\.\. is not a quantity"),
        ('"' + "9" * 1_000_000 + ' kg"', "rigid_body. m: '9{80}' is not a number with a unit"),
        ('"' + "kg " * 600_000 + '"', "rigid_body. m: .*not a number"),
        ('"1 kg"\n#' + "#" * 2_000_000, "bytes are too many for a vehicle file"),
    ],
)
def test_deep_and_huge_files_end_in_one_line(
    after: str, message: str, load: Callable[[str], Vehicle]
) -> None:
    with pytest.raises(UndertowError, match=message) as caught:
        load(FILE.replace('"10 kg"', after, 1))
    assert len(str(caught.value)) < 2000


def test_long_rows_of_numbers_are_no_dotted_key(load: Callable[[str], Vehicle]) -> None:
    covariance = "[" + ", ".join(f"[{', '.join(['-0.0012345e-3'] * 40)}]" for _ in range(40)) + "]"
    assert load(FILE + f"\n[[history]]\ncovariance = {covariance}\n").name == "tug"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "'schema' is missing"),
        (b"<xml/>", "not valid TOML: Invalid statement"),
        (b"\xff\xfe\x00", "not UTF-8 text"),
        (b"name = ", "not valid TOML"),
        (b"\x00", "not valid TOML"),
    ],
)
def test_files_that_are_no_vehicle(content: bytes, message: str, tmp_path: Path) -> None:
    file = tmp_path / "vehicle.toml"
    file.write_bytes(content)
    with pytest.raises(UndertowError, match=message):
        load_vehicle(file)


@pytest.mark.parametrize("source", ["mini-auw", "", ".", "x" * 5000, "a\x00b", "/proc/self/mem/x"])
def test_what_is_neither_a_file_nor_bundled(source: str) -> None:
    with pytest.raises(UndertowError, match="neither a file nor a bundled vehicle"):
        load_vehicle(source)


def test_an_unreadable_file_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def denied(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    file = tmp_path / "vehicle.toml"
    file.write_text(FILE, encoding="utf-8")
    monkeypatch.setattr(Path, "open", denied)
    with pytest.raises(UndertowError, match=r"vehicle.toml: cannot be read: Permission denied"):
        load_vehicle(file)
