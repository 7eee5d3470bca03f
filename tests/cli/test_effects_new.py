"""`undertow effects new`: a file that passes the check as written and lowers the error."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sm

from benchmarks.hidden_effects import make_case
from benchmarks.hidden_effects.files import toml_text
from tests.cli.bad import Undertow
from tests.identification.logs_of import prepared, runs_of
from undertow.identification.diagnosis.bench import noise_ratio, open_bench
from undertow.identification.diagnosis.candidates import Candidate
from undertow.identification.diagnosis.residual import remaining
from undertow.identification.diagnosis.result import (
    BetweenRuns,
    Dependence,
    Diagnosis,
    Remaining,
    RunInfo,
    Spectrum,
)
from undertow.identification.diagnosis.trial import screen, try_candidate
from undertow.identification.report.scaffold import effect_file, suggested
from undertow.model.catalogue import catalogue, load_effects
from undertow.model.contract import check_effect
from undertow.model.loading import load_vehicle
from undertow.model.symbols import signals, symbol

EVIL = 'x"""\nimport os\nos.system("rm")\n"""\\'


def _reported(columns: list[list[str]], term: str = "term", **more: Any) -> Dependence:
    size = len(columns)
    values = {"coefficients": [-2.5] * size, "standard_errors": [0.1] * size, "units": ["N"] * size}
    return Dependence(term=term, columns=columns, share=0.7, chance=0.001, alike=[], **{**values, **more})


def _left(degree_of_freedom: str = "surge", **found: Any) -> Remaining:
    return Remaining(
        degree_of_freedom=degree_of_freedom,
        normalised_error=3.0,
        residual_rms=0.9,
        noise_rms=0.4,
        unit="N",
        note="",
        summary=f"{degree_of_freedom}: 0.8 N rms remains above the noise",
        **found,
    )


def _diagnosis(*left: Remaining, vehicle: str = "usv", effects: tuple[str, ...] = ()) -> Diagnosis:
    run = RunInfo(name="a", source="a.csv", sha256="ab", role="train", samples=600, duration=60.0, notes=[])
    return Diagnosis(
        undertow="0.1.0",
        vehicle=vehicle,
        degrees_of_freedom=["surge", "sway", "yaw"],
        signs="sname",
        runs=[run],
        verdict="unexplained",
        headline="",
        effects=list(effects),
        ranking=[],
        steps=[],
        indistinguishable=[],
        warnings=[],
        remaining=list(left),
        parameters=[],
        false_alarm_rate=0.01,
        noise={},
        seconds=1.0,
    )


@pytest.fixture
def found(tmp_path: Path) -> Path:
    file = tmp_path / "found.json"
    file.write_text(_diagnosis(_left(depends_on=[_reported([["|r|", "u"]], "|r| u")])).model_dump_json())
    return file


def _effect(file: Path) -> Any:
    (cls,) = load_effects(file)
    return cls


# --- a simulated vehicle ------------------------------------------------------------------------------
def test_a_suggestion_takes_the_error_away(undertow: Undertow, tmp_path: Path) -> None:
    case = make_case("usv", ("turning_drag", "periodic_side_force"), 1, duration=50.0)
    (tmp_path / "usv.toml").write_text(toml_text(case.vehicle))
    vehicle = load_vehicle(tmp_path / "usv.toml")
    runs = runs_of(case)
    bench = open_bench(vehicle, *prepared(vehicle, runs[:3], runs[3:]))
    left = remaining(bench.base, bench.train, bench.test)
    (tmp_path / "found.json").write_text(_diagnosis(*left).model_dump_json())

    code, out, _ = undertow("effects", "new", "two_forces", "--from", "found.json")
    assert code == 0
    assert out.startswith("wrote two_forces.py\n")
    code, out, _ = undertow("effects", "check", "two_forces.py")
    assert code == 0, out
    assert "all checks passed" in out

    candidate = Candidate(_effect(tmp_path / "two_forces.py"), vehicle)
    trial = try_candidate(candidate, bench, screen(candidate, bench)[0].values)
    truth = case.truth["values"]
    assert trial.fit.values["X_absr_u"] == pytest.approx(-truth["turning_drag"]["k"], rel=0.1)
    period = 2 * np.pi / trial.fit.values["omega_Y"]
    assert period == pytest.approx(truth["periodic_side_force"]["P"], rel=0.01)
    before, after = noise_ratio(bench.base, bench.test), noise_ratio(trial.fit, bench.test)
    assert before.max() > 50
    assert after.max() < 3


# --- what stands in the file --------------------------------------------------------------------------
def test_the_file_says_where_its_terms_come_from(undertow: Undertow, found: Path, tmp_path: Path) -> None:
    code, out, _ = undertow("effects", "new", "turning_drag", "--from", found)
    assert code == 0
    assert "X_absr_u: surge force per |r| u; found -2.5 with standard error 0.1" in out
    cls = _effect(tmp_path / "turning_drag.py")
    assert cls.__name__ == "TurningDrag"
    assert cls.id == "turning_drag"
    words = " ".join(cls.__doc__.split())
    assert words.startswith(
        "Force that varies with |r| u. Suggested by 'undertow effects new' from found.json"
    )
    assert "vehicle usv, logs a, undertow 0.1.0" in words
    assert "surge: 0.8 N rms remains above the noise" in words
    assert "These are associations. State here what causes the force" in words
    assert "found.json" in cls.reference
    assert cls.specimen().parameters[0].unit == "N/((rad/s) (m/s))"
    text = (tmp_path / "turning_drag.py").read_text()
    assert max(map(len, text.splitlines())) <= 110
    assert not re.search(r"TODO|FIXME|XXX", text)


def test_an_example_without_a_diagnosis(undertow: Undertow, tmp_path: Path) -> None:
    code, out, _ = undertow("effects", "new", "my_effect", "--out", "mine.py")
    assert code == 0
    assert out.startswith("wrote mine.py\n")
    assert _effect(tmp_path / "mine.py").id == "my_effect"
    assert undertow("effects", "check", "mine.py")[0] == 0
    assert "my_effect" in undertow("effects", "--effects", "mine.py")[1]


def test_a_file_that_could_not_be_loaded_is_not_written(undertow: Undertow, tmp_path: Path) -> None:
    code, _, err = undertow("effects", "new", "my_effect", "--out", "mine.txt")
    assert code == 2
    assert "'mine.txt' does not end in .py, as the file of an effect has to: --out my_effect.py" in err
    assert not (tmp_path / "mine.txt").exists()


def _checked(tmp_path: Path, *left: Remaining, effect_id: str = "mine") -> Any:
    file = tmp_path / f"{effect_id}.py"
    file.write_text(effect_file(effect_id, file.name, suggested(_diagnosis(*left), "found.json")))
    cls = _effect(file)
    assert [f.message for f in check_effect(cls, catalogue()) if not f.ok] == []
    return cls


@pytest.mark.parametrize(
    "columns",
    [
        [[]],
        [["u"]],
        [["t", "|u|", "u"]],
        [["u", "u"]],
        [["z", "sin(psi)"], ["z", "cos(psi)"]],
        [["sin(phi)"]],
        [["x"]],
        [["command f1"]],
        [["|command f1|", "|command f2|"]],
        [["command my thruster", "u"]],
        [["command u_r", "command 2nd"]],
        [["command tau_X", "|r|"]],
    ],
)
def test_every_kind_of_term_passes_the_check(columns: list[list[str]], tmp_path: Path) -> None:
    _checked(tmp_path, _left(depends_on=[_reported(columns)]), _left("yaw", depends_on=[_reported(columns)]))


def test_the_wrench_is_the_sum_of_the_terms(tmp_path: Path) -> None:
    cls = _checked(
        tmp_path,
        _left(depends_on=[_reported([["|r|", "u"]]), _reported([["sin(2 psi)"], ["cos(2 psi)"]])]),
        _left("yaw", depends_on=[_reported([["t", "command f2"]])]),
    )
    s = signals(("f1", "f2"))
    effect = cls(("f1", "f2"))
    k = {p.name: sm.Symbol(p.name, real=True) for p in effect.parameters}
    psi, r, u, f2 = s.eta[5], s.nu_r[5], s.nu_r[0], s.actuation[1]
    surge = k["X_absr_u"] * sm.Abs(r) * u
    surge += k["X_sin2psi"] * sm.sin(2 * psi) + k["X_cos2psi"] * sm.cos(2 * psi)
    assert sm.simplify(effect.wrench(s) - sm.Matrix([surge, 0, 0, 0, 0, k["N_t_f2"] * s.t * f2])) == sm.zeros(
        6, 1
    )


def test_a_vehicle_without_the_thruster_is_reported(tmp_path: Path) -> None:
    cls = _checked(tmp_path, _left(depends_on=[_reported([["command f9"]])]))
    from undertow.errors import UndertowError

    with pytest.raises(UndertowError, match="effect 'mine' needs a thruster or surface called 'f9'"):
        cls(("f1",)).wrench(signals(("f1",)))


def test_a_term_of_a_rudder_takes_its_angle(tmp_path: Path) -> None:
    ship = load_vehicle("kvlcc2")
    cls = _checked(tmp_path, _left("sway", depends_on=[_reported([["command rudder", "u"]])]))
    effect = cls(ship.composition.thrusters, ship.surfaces)
    s = signals(effect.thrusters, effect.surface_names)
    assert effect.wrench(s)[1] == symbol("Y_rudder_u") * s.deflection[0] * s.nu_r[0]


def test_a_period_becomes_a_wave_whose_frequency_is_searched(tmp_path: Path) -> None:
    line = Spectrum(period=10.0, amplitude=0.3, share=0.9, chance=1e-9, in_step=True)
    cls = _checked(tmp_path, _left("sway", spectrum=line))
    omega = next(p for p in cls.specimen().parameters if p.name == "omega_Y")
    assert not omega.linear
    assert omega.starts[1] == pytest.approx(2 * np.pi / 10.0, rel=1e-4)
    assert omega.starts[2] - omega.starts[1] == pytest.approx(np.pi / 120.0, rel=1e-2)
    assert {p.name for p in cls.specimen().parameters} == {"Y_cos", "Y_sin", "omega_Y"}


def test_a_step_in_time_becomes_a_force_whose_beginning_is_searched(tmp_path: Path) -> None:
    steps = [_reported([[f"step(t - {t})"]], f"a step at {t} s") for t in ("24.0", "36.0")]
    cls = _checked(tmp_path, _left("heave", depends_on=steps))
    effect = cls.specimen()
    assert {p.name for p in effect.parameters} == {"Z_step_240", "Z_step_360", "t_Z_240", "t_Z_360"}
    time = next(p for p in effect.parameters if p.name == "t_Z_360")
    assert (time.unit, time.linear) == ("s", False)
    low, high = time.bounds
    assert low < min(time.starts) < 36.0 < max(time.starts) < high
    s = signals()
    values = {"Z_step_240": 1.0, "Z_step_360": 10.0, "t_Z_240": 24.0, "t_Z_360": 36.0}
    force = effect.wrench(s).subs({sm.Symbol(n, real=True): v for n, v in values.items()})[2]
    at = [float(sm.sympify(force).subs(s.t, t)) for t in (20.0, 30.0, 40.0)]
    assert at == pytest.approx([0.0, 1.0, 11.0], abs=0.2)


def test_a_drag_that_comes_suddenly_becomes_one_that_begins(tmp_path: Path) -> None:
    column = ["step(t - 24.0)", "|u|", "u"]
    effect = _checked(tmp_path, _left(depends_on=[_reported([column], "|u| u from 24.0 s on")])).specimen()
    assert {p.name: p.unit for p in effect.parameters} == {"X_step_240_absu_u": "N/(m/s)^2", "t_X_240": "s"}
    s = signals()
    values = {"X_step_240_absu_u": -3.0, "t_X_240": 24.0}
    force = effect.wrench(s).subs({sm.Symbol(n, real=True): v for n, v in values.items()})[0]
    at = [float(force.subs({s.t: t, s.nu_r[0]: u})) for t, u in ((12.0, 1.0), (40.0, 1.0), (40.0, -2.0))]
    assert at == pytest.approx([0.0, -3.0, 12.0], abs=0.1)


def test_names_that_are_taken_are_not_taken_again(tmp_path: Path) -> None:
    cls = _checked(tmp_path, _left("sway", depends_on=[_reported([["u", "v"]]), _reported([["v"]])]))
    names = [p.name for p in cls.specimen().parameters]
    assert len(set(names)) == 2
    assert not set(names) & {p.name for c in catalogue().values() for p in c.specimen().parameters}


def test_what_differs_from_run_to_run_has_a_value_in_every_run(undertow: Undertow, tmp_path: Path) -> None:
    line = Spectrum(period=6.3, amplitude=0.3, share=0.2, chance=1e-9, in_step=False)
    runs = [
        BetweenRuns(of=of, values={"a": [1.0], "b": [-1.0]}, unit="N", chance=1e-9)
        for of in ("mean force", "force that turns with the heading")
    ]
    common = [_reported([["|r|", "u"]]), _reported([[]], "a constant")]
    left = _left(depends_on=common, spectrum=line, between_runs=runs)
    (tmp_path / "found.json").write_text(_diagnosis(left, effects=("lift",)).model_dump_json())
    assert undertow("effects", "new", "mine", "--from", "found.json")[0] == 0
    code, out, _ = undertow("effects", "check", "mine.py")
    assert code == 0, out
    cls = _effect(tmp_path / "mine.py")
    by_run = {p.name: p.per_run for p in cls.specimen().parameters}
    assert by_run == {
        "X_absr_u": False,
        "X_cos": True,
        "X_sin": True,
        "X_constant": True,
        "X_sinpsi": True,
        "X_cospsi": True,
        "omega_X": False,
    }
    assert "vehicle usv with lift added" in " ".join(cls.__doc__.split())


# --- mistakes -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "bad", ["Turning", "turning-drag", "2nd", "_x", "a__b", "", "class", "../x", "x" * 61, "é"]
)
def test_an_id_that_is_no_snake_case_is_refused(bad: str, undertow: Undertow, tmp_path: Path) -> None:
    code, out, err = undertow("effects", "new", bad)
    assert (code, out) == (2, "")
    assert "cannot be an id" in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_id_of_the_catalogue_is_refused(undertow: Undertow) -> None:
    code, _, err = undertow("effects", "new", "lift")
    assert code == 2
    assert "effect 'lift' is in the catalogue already: choose another id" in err


@pytest.mark.parametrize("word", ["wrench", "parameter", "signals", "none", "true"])
def test_ids_that_python_or_the_file_needs_elsewhere(word: str, undertow: Undertow) -> None:
    assert undertow("effects", "new", word)[0] == 0
    assert undertow("effects", "check", f"{word}.py")[0] == 0


def test_a_file_is_replaced_only_on_demand(undertow: Undertow, tmp_path: Path) -> None:
    file = tmp_path / "mine.py"
    file.write_text("hours of work")
    code, _, err = undertow("effects", "new", "mine")
    assert code == 2
    assert "'mine.py' exists already: name another file with --out, or give --force" in err
    assert file.read_text() == "hours of work"
    code, out, _ = undertow("effects", "new", "mine", "--force")
    assert code == 0
    assert out.startswith("replaced mine.py\n")
    assert undertow("effects", "check", file)[0] == 0


def test_the_diagnosis_itself_is_not_replaced(undertow: Undertow, found: Path) -> None:
    code, _, err = undertow("effects", "new", "mine", "--from", found, "--out", found, "--force")
    assert code == 2
    assert "is the input" in err
    assert json.loads(found.read_text())["vehicle"] == "usv"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "cannot be read"),
        ("no json", "is not a diagnosis (Invalid JSON"),
        ("[]", "is not a diagnosis"),
        ("{}", "is not a diagnosis (undertow: Field required)"),
        ('{"schema_id": "undertow/comparison/1"}', "is not a diagnosis"),
        (b"\xff\xfe\x00", "not UTF-8 text"),
    ],
)
def test_what_is_no_diagnosis(
    content: str | bytes | None, message: str, undertow: Undertow, tmp_path: Path
) -> None:
    if content is not None:
        (tmp_path / "x.json").write_bytes(content if isinstance(content, bytes) else content.encode())
    code, out, err = undertow("effects", "new", "mine", "--from", "x.json")
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "mine.py").exists()


def test_a_diagnosis_without_a_term(undertow: Undertow, tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text(_diagnosis(_left()).model_dump_json())
    code, _, err = undertow("effects", "new", "mine", "--from", "x.json")
    assert code == 2
    assert "has no term that an effect could state; its verdict is unexplained" in err


@pytest.mark.parametrize(
    "left",
    [
        _left(EVIL, depends_on=[_reported([["u"]])]),
        _left(depends_on=[_reported([["u", EVIL]])]),
        _left(depends_on=[_reported([["__import__('os')"]])]),
        _left(spectrum=Spectrum(period=-1.0, amplitude=1.0, share=1.0, chance=0.0, in_step=True)),
    ],
)
def test_what_no_diagnosis_could_say_is_refused(left: Remaining, undertow: Undertow, tmp_path: Path) -> None:
    (tmp_path / "x.json").write_text(_diagnosis(left).model_dump_json())
    code, _, err = undertow("effects", "new", "mine", "--from", "x.json")
    assert code == 2
    assert "is this a diagnosis?" in err
    assert err.count("\n") == 1


def test_texts_out_of_a_diagnosis_stay_texts(tmp_path: Path) -> None:
    left = _left(depends_on=[_reported([["u"]], EVIL), _reported([[f"command {EVIL}"]], EVIL)])
    left.summary = EVIL
    diagnosis = _diagnosis(left, vehicle=EVIL, effects=(EVIL,))
    diagnosis.runs[0].name = EVIL
    diagnosis.undertow = EVIL
    text = effect_file("mine", "mine.py", suggested(diagnosis, EVIL))
    compiled = compile(text, "mine.py", "exec")
    assert "os" not in compiled.co_names
    assert "import os" not in [line.strip() for line in text.splitlines()]
    file = tmp_path / "mine.py"
    file.write_text(text)
    assert [f.message for f in check_effect(_effect(file), catalogue()) if not f.ok] == []
