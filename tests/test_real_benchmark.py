"""The benchmark on real logs: injections are exact, grades are what they say, peers find what is there."""

from __future__ import annotations

import json
import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.examples.calls import ROOT, Judged
from benchmarks.hidden_effects.plant import rotation
from benchmarks.hidden_effects.world import to_body
from benchmarks.real import peers
from benchmarks.real.__main__ import main
from benchmarks.real.cases import Case, plan, without
from benchmarks.real.injections import INJECTIONS, TOWARDS
from benchmarks.real.logs import SETS, LogSet, improved, log_sets
from benchmarks.real.measure import ahead, cut_all, worker
from benchmarks.real.page import page, why
from benchmarks.real.tally import Graded, goals, graded, predictions
from benchmarks.real.unsaid import KNOWN, unsaid_page
from benchmarks.trust.verdicts import Answer
from undertow.codegen.simulate import compile as compiled
from undertow.identification.diagnosis.splitting import training_and_validation
from undertow.identification.estimation.predictor import Predictor
from undertow.identification.estimation.windows import cut, prediction_error
from undertow.identification.logs.run import Run
from undertow.model.catalogue import catalogue
from undertow.model.loading import load_vehicle
from undertow.model.vehicle import Value, Vehicle

DATA = ROOT.parent / "shared" / "data"

pytestmark = pytest.mark.docs

STEP, SAMPLES, STILL = 0.05, 500, 40


@pytest.fixture(scope="module")
def ship() -> Vehicle:
    return load_vehicle("cybership2")


@pytest.fixture(scope="module")
def sailed(ship: Vehicle) -> Run:
    """The ship, simulated without noise; the first commands are zero, so that late ones are known."""
    rng = np.random.default_rng(7)
    commands = np.repeat(rng.uniform(-2.0, 2.0, (SAMPLES // 20, len(ship.command_names))), 20, axis=0)
    commands[:STILL] = 0.0
    x = compiled(ship).simulate([1.0, -2.0, 0.4, 0.3, 0.05, 0.02], commands, STEP)
    names = (*ship.pose_names, *ship.velocity_names, *ship.command_names)
    channels = dict(zip(names, np.column_stack([x, commands]).T, strict=True))
    return Run("sailed", STEP * np.arange(SAMPLES), channels)


def reported(vehicle: Vehicle, run: Run, motion: Any) -> tuple[Any, Any]:
    """What a model reports from a true motion at the start, and what the run has."""
    windows = cut([run], vehicle, None)
    predictor = Predictor(vehicle)
    return predictor.reports(windows, predictor.values, np.array([motion]))[0], windows.measured[0]


def with_effect(vehicle: Vehicle, effect: str, values: dict[str, float]) -> Vehicle:
    return vehicle.with_effect(catalogue()[effect], {k: Value(v) for k, v in values.items()})


def test_a_current_leaves_the_motion_through_the_water_as_it_was(sailed: Run) -> None:
    moved = INJECTIONS["current"].applied(load_vehicle("cybership2"), [sailed], 0.2)[1][0]
    water = 0.2 * np.array([[np.cos(TOWARDS)], [np.sin(TOWARDS)], [0.0]])
    turn = rotation(np.vstack([np.zeros((2, SAMPLES)), moved.channels["psi"]]))
    through = to_body(turn, water)
    for i, name in enumerate("uv"):
        np.testing.assert_allclose(moved.channels[name] - through[i], sailed.channels[name], atol=1e-12)
    for i, name in enumerate("xy"):
        back = moved.channels[name] - water[i] * sailed.t
        np.testing.assert_allclose(back, sailed.channels[name], atol=1e-12)
    kept = ("psi", "r", *load_vehicle("cybership2").command_names)
    assert all(np.array_equal(moved.channels[n], sailed.channels[n]) for n in kept)


#: Injection to a size, and the effect of the catalogue with the values that it has then.
EXPLAINED: dict[str, tuple[float, str, dict[str, float]]] = {
    "current": (
        0.1, "ocean_current", {"V_N": 0.1 * np.cos(TOWARDS), "V_E": 0.1 * np.sin(TOWARDS)},
    ),
    "water-log": (
        0.1, "water_speed_log", {"V_N_log": 0.1 * np.cos(TOWARDS), "V_E_log": 0.1 * np.sin(TOWARDS)},
    ),
    "compass": (0.15, "attitude_bias", {"b_psi": 0.15}),
    "antenna": (
        0.4, "position_lever_arm", {"x_fix": 0.4 * np.cos(TOWARDS), "y_fix": -0.4 * np.sin(TOWARDS)},
    ),
    "lever-arm": (
        0.4, "velocity_lever_arm", {"x_s": 0.4 * np.cos(TOWARDS), "y_s": -0.4 * np.sin(TOWARDS)},
    ),
    "misalignment": (0.2, "velocity_misalignment", {"turn_z": 0.2}),
    "bias": (0.1, "sensor_bias", {"b_u": 0.1, "b_v": -0.05}),
    "gyro": (0.02, "sensor_bias", {"b_r": 0.02}),
    "scale": (0.2, "sensor_scale", {"scale_velocity": 0.2}),
    "sensor-delay": (0.5, "sensor_delay", {"velocity_delay": 0.5}),
    "gain": (0.3, "thruster_gain", {"gain_error_T3": 0.3}),
    "dead-band": (0.2, "thruster_deadband", {"deadband_width": 0.2}),
    "asymmetry": (0.3, "thruster_asymmetry", {"reverse_loss": 0.3}),
    "curve": (0.4, "thruster_curve", {"curve_square": 0.4}),
    "droop": (0.01, "supply_droop", {"droop_rate": 0.01}),
    "command-delay": (1.0, "actuation_delay", {"delay": 1.0}),
    "mass": (0.25, "entrained_water", {"m_w": 0.25 * 23.8, "mx_w": 0.25 * 23.8 * 0.046}),
    "centre": (0.1, "entrained_water", {"mx_w": -0.1 * 23.8}),
}  # fmt: skip


@pytest.mark.parametrize("name", EXPLAINED)
def test_the_effect_that_was_put_in_explains_all(name: str, ship: Vehicle, sailed: Run) -> None:
    size, effect, values = EXPLAINED[name]
    values = {k.replace("T3", ship.command_names[-1]): v for k, v in values.items()}
    vehicle, (run,) = INJECTIONS[name].applied(ship, [sailed], size)
    first = int(np.searchsorted(sailed.t, run.t[0] - 1e-9))
    true = sailed.matrix([*ship.pose_names, *ship.velocity_names])[first].copy()
    if name in ("current", "water-log"):
        # The true motion over ground, whatever is read of it.
        moved = INJECTIONS["current"].applied(ship, [sailed], size)[1][0]
        true = moved.matrix([*ship.pose_names, *ship.velocity_names])[0]
    assert effect in INJECTIONS[name].right(ship.degrees_of_freedom)
    late = round(size / STEP) + 1 if name == "sensor-delay" else 0
    said, measured = reported(with_effect(vehicle, effect, values), run, true)
    # A supply that droops within a step is taken at its middle.
    np.testing.assert_allclose(said[late:], measured[late:], atol=1e-5 if name == "droop" else 2e-7)
    # And without it something is to be explained.
    said, measured = reported(vehicle, run, true)
    assert np.nanmax(np.abs(said - measured)[late:]) > 1e-3


def test_commands_come_back_through_what_distorts_them(sailed: Run) -> None:
    names = load_vehicle("cybership2").command_names
    c = sailed.matrix(names)

    def given(name: str, size: float) -> Any:
        return INJECTIONS[name].run(sailed, size, names).matrix(names)  # type: ignore[misc]

    wide, weak, bent = given("dead-band", 0.3), given("asymmetry", 0.4), given("curve", 0.7)
    np.testing.assert_allclose(wide - np.clip(wide, -0.3, 0.3), c, atol=1e-12)
    np.testing.assert_allclose(np.where(weak < 0, 0.6 * weak, weak), c, atol=1e-12)
    np.testing.assert_allclose(bent + 0.7 * np.abs(bent) * bent, c, atol=1e-12)
    uneven = Run("uneven", sailed.t**1.1, sailed.channels)
    with pytest.raises(ValueError, match="uneven steps"):
        INJECTIONS["command-delay"].run(uneven, 0.5, names)  # type: ignore[misc]


def test_tilts_and_files_are_changed_as_they_say() -> None:
    t = np.arange(10.0)
    run = Run("roll", t, {"phi": 0.1 * t, "psi": t}, wrapped={"psi": (t + np.pi) % (2 * np.pi) - np.pi})
    roll = load_vehicle(str(ROOT / "examples/kvlcc2/vehicle.toml"))
    changed = INJECTIONS["inclinometer"].run(run, 0.02, ())  # type: ignore[misc]
    np.testing.assert_allclose(changed.channels["phi"], 0.1 * t + 0.02)
    turned = INJECTIONS["compass"].run(run, 0.5, ())  # type: ignore[misc]
    np.testing.assert_allclose(np.cos(turned.wrapped["psi"]), np.cos(turned.channels["psi"]))
    assert np.abs(turned.wrapped["psi"]).max() <= np.pi
    file = INJECTIONS["righting-arm"].file
    assert file is not None
    assert file(roll, 0.4).value_of("S_z").value == pytest.approx(0.6 * roll.value_of("S_z").value)
    assert INJECTIONS["inclinometer"].right(["roll"])[0] == "attitude_bias"


def test_an_effect_goes_with_its_values_and_with_what_needs_it(ship: Vehicle) -> None:
    less = without(ship, "added_mass")
    assert {"added_mass", "added_mass_coriolis"}.isdisjoint(e.id for e in less.effects)
    assert "X_udot" not in less.values
    assert "X_u" in less.values
    with pytest.raises(ValueError, match="has no effect 'lift'"):
        without(ship, "lift")


# --- the plan -----------------------------------------------------------------------------------
def test_the_plan_has_enough_injections_and_every_id_reads_back() -> None:
    cases = plan(SETS)
    assert sum(c.kind == "injection" for c in cases) >= 120
    assert len({c.id for c in cases}) == len(cases)
    assert all(Case.read(c.id, SETS) == c for c in cases)
    assert [c.kind for c in cases[: 2 * len(SETS)]] == ["baseline"] * len(SETS) + ["prediction"] * len(SETS)
    assert all(set(s.injections) <= set(INJECTIONS) for s in log_sets(Path()).values())
    with pytest.raises(ValueError, match="ids look like"):
        Case.read("cse1-joystick:currant:0.25", SETS)


def test_every_beginning_of_the_injections_has_all_kinds_logs_and_sizes_alike() -> None:
    cases = [c for c in plan(SETS) if c.kind == "injection"]
    kinds, logs = {c.change for c in cases}, {c.logs for c in cases}
    beginning = cases[: 2 * len(kinds)]
    assert {c.change for c in beginning} == kinds
    assert {c.logs for c in beginning} == logs
    places = Counter(INJECTIONS[c.change].sizes.index(c.size) for c in beginning)
    assert max(places.values()) - min(places.values()) <= 2


def test_in_surge_alone_water_in_the_hull_is_the_inertia_of_added_mass() -> None:
    box = without(load_vehicle("box-hull"), "added_mass")
    added = (
        with_effect(box, "added_mass", {"X_udot": -7.0}),
        with_effect(box, "entrained_water", {"m_w": 7.0}),
    )
    one, other = (
        v.residual.subs({s: v.value_of(str(s)).value for s in v.residual.free_symbols if str(s) in v.values})
        for v in added
    )
    assert (one - other).expand().is_zero_matrix
    assert all("entrained_water" in SETS[n].also["added_mass"] for n in ("box-step", "box-multistep"))


# --- grades -------------------------------------------------------------------------------------
def record(kind: str, said: Answer, before: float | None = 0.4, after: float | None = 0.2) -> dict[str, Any]:
    errors = {"stated": [0.5, 0.5], "refitted": [0.1, before], "found": [0.1, 0.2], "true": [0.1, after]}
    return {
        "id": f"logs:{kind}", "kind": kind, "label": "current", "vehicle": "logs", "title": "some logs",
        "horizons": [5.0, 30.0], "errors": errors, "answer": said.as_dict(), "headline": "It is so.",
        "truth": ["ocean_current"], "seconds": 3.0, "value": 0.1, "motions": ["surge"],
    }  # fmt: skip


def case(said: Answer, known: Answer | None = None, **errors: float | None) -> Graded:
    return Graded(record("injection", said, **errors), known)


def test_named_is_alone_or_in_a_set_of_two() -> None:
    ranking = ["ocean_current", "wind"]
    alone = case(Answer("missing_effect", ["ocean_current"], [], ranking))
    assert alone.first
    assert alone.named
    assert not alone.new
    assert not alone.failed
    two = case(Answer("indistinguishable", ["wind"], [["wind", "ocean_current"]], ranking[::-1]))
    assert two.place == 2
    assert two.named
    assert not two.new
    assert not two.wrong
    many = case(Answer("indistinguishable", ["wind"], [["wind", "lift", "ocean_current"]], ranking))
    assert not many.named
    assert many.new == {"wind", "lift"}
    assert not many.wrong
    assert "among too many" in why(many)


def test_a_cause_is_wrong_unless_it_is_named_for_the_log_as_it_is() -> None:
    said = Answer("missing_effect", ["wind"], [], ["wind"])
    assert case(said).wrong
    assert case(said).new == {"wind"}
    assert not case(said, known=said).wrong
    assert not case(said, known=said).new
    beside = case(Answer("missing_effect", ["ocean_current", "wind"], [], ["ocean_current"]))
    assert beside.named
    assert not beside.wrong
    assert beside.new == {"wind"}
    # What helps to predict is not said to be the cause.
    helping = case(Answer("helps_prediction", ["wind"], [], ["wind"]))
    assert not helping.wrong
    assert not helping.new
    assert not helping.named


def test_an_effect_counts_where_it_lowers_the_error_far_ahead() -> None:
    nothing = Answer("unexplained", [], [], [])
    assert case(nothing).counts
    assert case(nothing).failed
    assert not case(nothing, after=0.36).counts
    assert case(nothing, before=None).counts
    assert not case(nothing, after=None).counts


def test_goals_and_page_count_what_was_stored(tmp_path: Path) -> None:
    found = Answer("missing_effect", ["ocean_current"], [], ["ocean_current"])
    peers_said = record("prediction", found) | {"errors": {
        "linear thrusters, delay, cross terms": [0.2, None],
        "gradient boosting": [0.05, 0.5]}}  # fmt: skip
    records = [record("baseline", Answer("unexplained")), record("injection", found), peers_said]
    assert all(goal.met for goal in goals(graded(records)))
    near, far = predictions(records, peers.GREY, peers.BLACK)
    assert near.error == 0.1
    assert near.met
    assert near.over(near.black) == 2.0
    assert far.met
    assert far.over(far.black) == pytest.approx(0.4)
    stored, out = tmp_path / "real.jsonl", tmp_path / "real.md"
    lost = {"id": "logs:lost", "kind": "injection", "vehicle": "logs", "failure": "took more than 9 s"}
    stored.write_text("".join(json.dumps(r) + "\n" for r in [*records, lost]))
    assert main(["page", str(stored), "--out", str(out)]) == 0
    text = out.read_text()
    assert "1 of 1: 100%" in text
    assert "took more than 9 s" in text
    assert "gradient boosting leaves 5%" in text
    assert page(records).count("It is so.") == 1


def test_the_page_says_how_much_of_the_plan_was_run() -> None:
    done = [{"id": c.id, "kind": c.kind, "vehicle": c.logs} for c in plan(SETS) if c.kind == "prediction"]
    lost = done[0] | {"failure": "took more than 9 s"}
    planned = [c for c in plan(SETS) if c.kind == "prediction"]
    assert "Not all of the plan" not in page(done, planned=planned)
    text = page([lost, *done[1:]], planned=plan(SETS))
    assert f"{len(done) - 1} of {len(done)} (prediction)" in text
    assert f"0 of {len(SETS)} (baseline)" in text


def test_what_could_not_be_said_has_the_reason_and_what_would_tell() -> None:
    said = record("baseline", Answer("helps_prediction", [], [], ["slosh"])) | {
        "vehicle": "box-step",
        "headline": "Adding slosh lowers the 1.9-s error from 5.3 to 2%. Take it to predict.",
        "helps": ["slosh"],
        "not_named": {"drag_asymmetry": "raises the error", "slosh": "its size would have to change"},
        "remaining": ["surge: 0.74 N rms is left"],
        "predictable": "the model leaves 14%",
        "tell": ["Random steps of surge"],
    }
    lost = {"id": "x", "kind": "baseline", "vehicle": "sf30k-4", "failure": "took more than 9 s"}
    text = unsaid_page([said, lost])
    assert "1 sets of logs: 1 helps_prediction." in text
    assert "**helps_prediction**: Adding slosh lowers the 1.9-s error from 5.3 to 2%.\n" in text
    assert "Take it to predict" not in text
    assert text.index("`slosh`: its size would have to change.") < text.index("`drag_asymmetry`: raises")
    assert "What remains: surge: 0.74 N rms is left." in text
    assert "Not answered: took more than 9 s." in text
    assert "Random steps of surge." in text
    old = record("baseline", Answer("unexplained")) | {"vehicle": "tanker", "source": "a page at abc"}
    text = unsaid_page([said, lost], [old, old | {"vehicle": "box-step"}])
    assert "1 more were not rerun" in text
    assert "Not rerun. Earlier (a page at abc): **unexplained**: It is so." in text
    beginnings = [known["logs"] for known in tomllib.loads(KNOWN.read_text()).values()]
    owned = [logs for logs in log_sets(Path()) for start in beginnings if logs.startswith(start)]
    assert sorted(owned) == sorted(log_sets(Path()))


def test_bad_requests_end_in_one_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["page", str(tmp_path / "none.jsonl")]) == 2
    assert main(["run", "--data", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 2


# --- peers --------------------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "most"), [
    ("linear thrusters, delay, cross terms", 0.15), ("Abkowitz polynomial", 0.15),
    ("gradient boosting", 1.5), ("N4SID", 1.5),
])  # fmt: skip
def test_peers_predict_a_simulated_ship(name: str, most: float, ship: Vehicle, sailed: Run) -> None:
    pytest.importorskip("nfoursid" if name == "N4SID" else "sklearn" if "boost" in name else "numpy")
    windows = cut_all(ship, [sailed], [2.0, 5.0])
    model = peers.METHODS[name](ship, [sailed], 5.0)
    errors = [prediction_error(model.predicted(w)) for w in windows]
    assert max(errors) < most


# --- one case -----------------------------------------------------------------------------------
def test_a_term_that_is_taken_out_is_measured() -> None:
    logs = ROOT / "src/undertow/demo_data/cfd-surge"
    what = Judged(
        "box", "box-hull", str(logs / "log.toml"), ("surge_step_coarse.csv.gz",),
        ("surge_multistep_coarse.csv.gz",),
    )  # fmt: skip
    sets = {"box": LogSet(what, str(logs), (1.0, 5.0, 20.0))}
    found = worker(sets, Path())(Case("box", "without-linear_damping"))
    assert found["truth"] == ("linear_damping",)
    assert found["answer"]["ranking"]
    assert all(len(e) == 3 for e in found["errors"].values())
    assert found["errors"]["true"][-1] < found["errors"]["refitted"][-1]


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="no real logs: ../shared/data is absent")
def test_a_compass_error_in_a_real_log_is_never_called_something_else_alone() -> None:
    """Turned by its compass, the model ship seems to be pushed aside by its propellers."""
    case = Case("cse1-joystick", "compass", 0.35)
    answer = worker(SETS, DATA)(case)["answer"]
    assert answer["named"] == [] or "attitude_bias" in {
        e for s in [answer["named"], *answer["sets"]] for e in s
    }


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="no real logs: ../shared/data is absent")
def test_a_set_can_have_what_was_found_in_it_in_its_vehicle_file() -> None:
    logs = SETS["roll-37-38"]
    (plain, *_), (richer, train, test) = logs.read(DATA), improved(logs).read(DATA)
    assert {e.id for e in richer.effects} > {e.id for e in plain.effects}
    _, judged = training_and_validation(plain, train, test)
    windows = cut_all(plain, judged, logs.horizons)
    errors = [ahead(v, judged, windows) for v in (plain, richer)]
    assert errors[1] < errors[0]


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="no real logs: ../shared/data is absent")
def test_a_righting_arm_too_short_is_named_although_other_values_take_up_most_of_its_force() -> None:
    """With a longer arm at large angles the refit has nearly the same force, but another period."""
    logs = {"roll-38-37": improved(SETS["roll-38-37"])}
    assert worker(logs, DATA)(Case("roll-38-37", "righting-arm", 0.2))["answer"]["named"] == ["trim_offset"]


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="no real logs: ../shared/data is absent")
def test_an_effect_that_led_the_fit_to_another_local_minimum_does_not_lead_the_candidates() -> None:
    """Its fit predicts better than that without it, and as well with the effect set to zero."""
    found = worker({"box-step": improved(SETS["box-step"])}, DATA)(Case("box-step", "scale", 0.05))
    assert "another local minimum" in found["not_named"]["boundary_proximity"]
    assert found["answer"]["ranking"][0] == "sensor_scale"
