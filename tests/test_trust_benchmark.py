"""The program that measures how often the diagnosis is right: plan, grades, counting, page."""

from __future__ import annotations

import json
import os
import sys
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.hidden_effects import EFFECTS, make_case
from benchmarks.hidden_effects.vehicles import NOMINAL
from benchmarks.hidden_effects.world import plain_world
from benchmarks.trust import sizing
from benchmarks.trust.__main__ import main
from benchmarks.trust.ablation import (
    Recording,
    ablation_page,
    chosen,
    recording,
    sample,
    still_to_run,
)
from benchmarks.trust.cases import COMPLETE, FAINT, HARD, OTHER_FORMS, SINGLES, SIZES, Planned, part, plan
from benchmarks.trust.failures import failures, why
from benchmarks.trust.goals import goals
from benchmarks.trust.grade import HIDDEN, grade_of, oracle_refit
from benchmarks.trust.material import simulated, varied, written_and_read, written_to_memory
from benchmarks.trust.measure import measured
from benchmarks.trust.peers import stepwise
from benchmarks.trust.report import page
from benchmarks.trust.run import records, run
from benchmarks.trust.sizing import sized
from benchmarks.trust.tally import Share, scored
from benchmarks.trust.terms import filled, make_terms
from benchmarks.trust.verdicts import Answer, accepted
from undertow.identification.diagnosis.parallel import jobs
from undertow.identification.diagnosis.settings import Settings
from undertow.identification.logs.run import Run

pytestmark = pytest.mark.docs

ABLE = [(name, vehicle) for name, effect in EFFECTS.items() for vehicle in effect.vehicles]


# --- the plan ----------------------------------------------------------------------------------------------


def test_the_plan_is_the_same_every_time_and_its_cases_differ() -> None:
    first, second = plan(3, 5), plan(3, 5)
    assert first == second
    assert len({case.id for case in first}) == len(first)
    assert plan(2, 5) == first[: len(plan(2, 5))]
    assert not {case.id for case in first} & {case.id for case in plan(3, 6)}


def test_every_id_reads_back() -> None:
    assert all(Planned.read(case.id) == case for case in plan(2))
    with pytest.raises(ValueError, match="ids look like"):
        Planned.read("usv:lift")
    with pytest.raises(ValueError, match="ids look like"):
        Planned.read("usv:lifft:x1:n1:open:plain:17")


def test_every_round_has_every_effect_uncatalogued_one_and_complete_model() -> None:
    for cases in (plan(1), plan(2)[len(plan(1)) :]):
        plain = [case for case in cases if not case.aim]
        hidden = Counter(case.hidden[0] for case in plain if case.kind in ("single", "uncatalogued"))
        aliens = [name for name, e in EFFECTS.items() if e.kind == "alien"]
        assert hidden == Counter([*SINGLES, *aliens])
        faint = [case for case in cases if case.aim]
        assert Counter(case.hidden[0] for case in faint) == Counter(SINGLES)
        assert all(FAINT[0] <= case.aim <= FAINT[1] for case in faint)
        assert "thruster_deadband" in SINGLES
        assert "thruster_deadband_jump" not in SINGLES
        assert {case.label for case in cases if case.kind == "complete"} == {*COMPLETE, *HARD}
        hard = Counter(case.label for case in cases if case.kind == "hard")
        assert hard == Counter([*HARD, *OTHER_FORMS])
        assert all(case.vehicle in EFFECTS[name].vehicles for case in cases for name in case.hidden)


def test_three_rounds_have_every_effect_at_every_size() -> None:
    whole = [case for case in plan(3) if case.kind == "single" and not case.aim]
    sizes = Counter((case.hidden[0], case.strength) for case in whole)
    assert set(sizes.values()) == {1}
    assert {size for _, size in sizes} == set(SIZES)


def test_a_run_that_is_cut_off_is_a_balanced_sample() -> None:
    whole = plan(1)
    shares = Counter(case.kind for case in whole)
    begun = Counter(case.kind for case in whole[: len(whole) // 3])
    for kind, count in shares.items():
        # The hard cases, of two kinds, are in random order.
        assert begun[kind] == pytest.approx(count / 3, abs=2.0)
    vehicles = Counter(case.vehicle for case in plan(12))
    assert set(vehicles) == set(NOMINAL)
    assert max(vehicles.values()) < 2.5 * min(vehicles.values())


def test_parts_make_the_whole() -> None:
    cases = plan(1)
    parts = [part(cases, f"{i}/3") for i in (1, 2, 3)]
    assert sorted(c.id for p in parts for c in p) == sorted(c.id for c in cases)
    with pytest.raises(ValueError, match="give i/n"):
        part(cases, "4/3")


def test_a_faint_case_is_as_faint_as_it_aims_to_be() -> None:
    case = Planned.read("box:constant_force:r1.5:n1:open:60s:17")
    found = sized(case)
    assert found.strength < 1.0
    vehicle, train, test = written_to_memory(simulated(found))
    assert oracle_refit(vehicle, train, test, ["constant_force"], {}).ratio == pytest.approx(1.5, rel=0.12)
    assert sized(Planned.read("box:constant_force:x2.5:n1:open:60s:17")).strength == 2.5


def test_no_effect_is_made_larger_than_a_vehicle_of_its_kind_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sizing, "_worth", lambda case: 1.0 + 1e-4 * case.strength)
    hardly_sways = Planned.read("ship:crossflow_drag:r2.73:n3:open:60s:17")
    assert sized(hardly_sways).strength == sizing.LARGEST


# --- the simulator -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("vehicle", NOMINAL)
def test_every_vehicle_bears_every_effect_that_it_can_have(vehicle: str) -> None:
    for name in [name for name, able in ABLE if able == vehicle]:
        case = make_case(vehicle, (name,), 11, strength=SIZES[-1], duration=0.4, runs=("steps",))
        columns = case.runs["steps"]
        assert all(np.all(np.isfinite(values)) for values in columns.values()), name


def test_vehicles_have_one_to_six_motions_and_are_sound() -> None:
    assert {len(v.dofs) for v in NOMINAL.values()} == {1, 3, 4, 6}
    for vehicle in NOMINAL.values():
        own = list(vehicle.dofs)
        assert np.all(vehicle.added[own] < 0), vehicle.name
        assert np.all(vehicle.linear[own] < 0), vehicle.name
        world = plain_world(vehicle)
        assert np.linalg.eigvalsh((world.rigid_mass + world.added_mass)[np.ix_(own, own)]).min() > 0
        for i in own:  # what is asked for can be pushed, and leads to speeds of the size that is stated
            speed = vehicle.pace[i] * np.linspace(0, 4, 401)
            drag = -vehicle.linear[i] * speed - vehicle.quadratic[i] * speed**2
            assert vehicle.reach[i] < drag[-1], (vehicle.name, i)
            assert not vehicle.reach[i] or vehicle.reach[i] > 0.3 * vehicle.drag_at_pace(i), (vehicle.name, i)


def test_a_pose_only_log_has_no_velocities_and_a_guessed_mass_is_estimated(tmp_path: Path) -> None:
    short = make_case("box", (), 3, duration=10.0)
    blind = varied(short, Planned("box", (), 1.0, 1.0, False, "pose-only", 3))
    assert not {"u", "r"} & set(blind.runs["steps"])
    vehicle, train, test = written_and_read(blind, tmp_path)
    assert all("u" in run.derived for run in [*train, *test])
    guessed = varied(short, Planned("box", (), 1.0, 1.0, False, "mass-5", 3))
    heavy = guessed.vehicle["effects"]["rigid_body"]["m"]
    true = NOMINAL["box"].mass
    assert heavy["estimate"] is True
    assert heavy["value"] == pytest.approx(true, rel=0.051)
    assert heavy["value"] != true
    assert heavy["sigma"] == pytest.approx(0.05 * heavy["value"], rel=0.01)
    assert vehicle.value_of("m").value == true


# --- grades and verdicts -----------------------------------------------------------------------------------


def test_grades() -> None:
    assert [grade_of(r) for r in (1.0, 1.1, 1.5, 2.9, 3.0)] == [HIDDEN, "weak", "medium", "medium", "strong"]


@pytest.fixture(scope="module")
def pushed(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """A box that is pushed by a constant force, 30 s."""
    made = make_case("box", ("constant_force",), 4, duration=30.0)
    folder = tmp_path_factory.mktemp("pushed")
    return (*written_and_read(made, folder), made.truth["values"]["constant_force"])


def test_the_refit_that_is_told_the_truth_reaches_the_noise(pushed: Any) -> None:
    vehicle, train, test, values = pushed
    truth = oracle_refit(vehicle, train, test, ["constant_force"], values)
    assert truth.error == pytest.approx(1.0, abs=0.15)
    assert truth.fit.values["X_0"] == pytest.approx(values["X_0"], rel=0.05)
    assert truth.ratio == pytest.approx(truth.before / truth.error)
    assert truth.ratio > 3
    assert truth.error_of(truth.fit) == pytest.approx(truth.error)


def test_stepwise_selection_finds_a_constant_force(pushed: Any) -> None:
    terms = make_terms(*pushed[:3])
    assert {"constant_force", "dry_friction", "cubic_damping"} <= set(terms.effects)
    answer = stepwise(terms)
    assert answer.ranking[0] == "constant_force"
    assert answer.named == ["constant_force"]


def test_what_counts_as_the_truth() -> None:
    upright = ("surge", "sway", "heave", "yaw")
    assert accepted("net_buoyancy", upright) == {"net_buoyancy", "constant_force"}
    assert accepted("net_buoyancy", (*upright, "roll", "pitch")) == {"net_buoyancy"}
    assert accepted("constant_force", upright, {"Z_0"}) == {"net_buoyancy", "constant_force"}
    assert accepted("constant_force", upright, {"Z_0", "X_0"}) == {"constant_force"}
    assert accepted("lift", upright) == {"lift"}
    assert accepted("entrained_water", upright) == {"entrained_water", "added_mass_coupling"}
    assert accepted("added_mass_coupling", upright, {"Y_rdot"}) == {"entrained_water", "added_mass_coupling"}
    assert accepted("added_mass_coupling", upright, {"X_vdot"}) == {"added_mass_coupling"}
    assert accepted("entrained_water", (*upright, "roll")) == {"entrained_water"}


@pytest.mark.parametrize(
    ("named", "expected"),
    [
        (("entrained_water",), True),
        (("entrained_water", "added_mass_coupling"), True),
        (("added_mass_coupling",), False),
        (("entrained_water", "added_mass_coupling", "lift"), False),
    ],
)
def test_what_the_truth_is_a_special_case_of_may_stand_beside_it(
    named: tuple[str, ...], expected: bool
) -> None:
    case, truth = "heavy-rov:entrained_water:x1:n1:open:plain:1", ("entrained_water",)
    more = {"sets": [list(named)], "motions": ["surge", "sway", "heave", "roll", "pitch", "yaw"]}
    (told_case,) = scored([record(case, "indistinguishable", named[0], truth=truth, grade="strong", **more)])
    assert told_case.only is expected


def test_named_and_nothing_else() -> None:
    assert Answer("missing_effect", ["lift"]).only({"lift"})
    assert not Answer("missing_effect", ["lift", "waves"]).only({"lift"})
    assert not Answer("indistinguishable", ["lift"], [["lift", "waves"]]).only({"lift"})
    assert not Answer("unexplained", []).only({"lift"})
    assert not Answer("unexplained", ["lift"]).only({"lift"})


# --- counting ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("k", "n", "low", "high"),
    # Wilson (1927); Agresti and Coull (1998) print the interval of 0 of 10 and 5 of 10.
    [(0, 10, 0.0, 0.2775), (5, 10, 0.2366, 0.7634), (10, 10, 0.7225, 1.0), (81, 263, 0.2553, 0.3662)],
)
def test_wilson_interval(k: int, n: int, low: float, high: float) -> None:
    assert Share(k, n).interval == (pytest.approx(low, abs=1e-4), pytest.approx(high, abs=1e-4))


def test_a_share_of_nothing_says_so() -> None:
    assert str(Share(0, 0)) == "no cases"
    assert str(Share(9, 10)) == "9 of 10: 90% (59.6 to 98.2)"


def record(case: str, verdict: str, *named: str, truth: tuple[str, ...] = (), **more: Any) -> dict[str, Any]:
    planned = Planned.read(case)
    answer = Answer(verdict, list(named), more.pop("sets", []), more.pop("ranking", [*named, "waves", "lag"]))
    values = {
        "motions": ["surge", "sway", "yaw"],
        "values": {},
        "seconds": 3.0,
        "cpu": 2.0,
        "known": True,
        "commit": "a",
    }
    own = {"id": planned.id, "kind": planned.kind, "label": planned.label, "vehicle": planned.vehicle}
    return values | own | {"truth": list(truth), "answer": answer.as_dict()} | more


LIFT, LOST = "usv:lift:x1:n1:open:plain:1", "usv:lift:x0.4:n1:open:plain:2"
BY_HAND = [
    record(LIFT, "missing_effect", "lift", truth=("lift",), grade="strong", ratio=9.0, after=1.1, oracle=1.0),
    record(LOST, "adequate", truth=("lift",), grade="weak", ratio=1.2, after=1.2, oracle=1.0,
           ranking=["waves", "lift"]),
    record("usv:nothing:x1:n1:open:plain:3", "adequate"),
    record("usv:nothing:x1:n2:open:plain:4", "missing_effect", "waves"),
    record("usv:growing_drag:x1:n1:open:plain:5", "unexplained", truth=("growing_drag",), known=False,
           grade="strong", ratio=5.0),
    record("usv:lift+thruster_lag:x1:n1:open:plain:6", "indistinguishable", "lift",
           truth=("lift", "thruster_lag"), sets=[["thruster_lag", "actuation_delay"]], grade="medium",
           ratio=2.0, after=1.0, oracle=1.0),
    {"id": "usv:waves:x1:n1:open:plain:7", "kind": "single", "failure": "ValueError: no", "commit": "a"},
]  # fmt: skip


def test_scores_of_records_made_by_hand() -> None:
    strong, weak, quiet, alarm, uncatalogued, pair = scored(BY_HAND)
    assert (strong.first, strong.in_three, strong.reported, strong.only) == (True,) * 4
    assert (weak.first, weak.in_three, weak.reported, weak.only) == (False, True, False, False)
    assert (quiet.answer.claims, alarm.answer.claims) == (False, True)
    assert uncatalogued.kind == "uncatalogued"
    assert pair.reported
    assert not pair.only
    assert failures(scored(BY_HAND)) == [weak, alarm]
    assert why(weak) == "taken for noise or a disturbance"


def test_goals_of_records_made_by_hand() -> None:
    found = {g.name: g for g in goals(scored(BY_HAND))}
    assert found["strong: truth ranked first"].met is True
    assert found["weak: truth in the reported set"].met is False
    assert found["medium: truth ranked first"].met is None
    assert found["complete models: false alarms"].measured == "1 of 2: 50% (9.45 to 90.5)"
    assert found["– 2 x noise"].met is False
    assert found["– as drawn"].met is True
    assert found["outside the catalogue: unexplained"].met is True
    assert found["error after adding over that of the oracle refit, median"].measured == "1.150 of 2 cases"


def test_an_effect_that_no_catalogue_has_yet_is_uncatalogued() -> None:
    (case,) = scored([record(LIFT, "unexplained", truth=("lift",), known=False, grade="strong")])
    assert case.kind == "uncatalogued"
    assert failures([case]) == []


def test_the_page_tells_all(tmp_path: Path) -> None:
    source, out = tmp_path / "run.jsonl", tmp_path / "page.md"
    source.write_text("\n".join(map(json.dumps, BY_HAND)) + '\n{"id": "cut o', encoding="utf-8")
    assert main(["report", str(source), "--out", str(out)]) == 0
    text = out.read_text(encoding="utf-8")
    assert text == page(BY_HAND)
    assert "7 cases: 1 with" not in text
    assert "7 cases: 2 with one effect hidden, 1 with two, 2 complete models, 1 with" in text
    assert f"`{LOST}`" in text
    assert "ValueError: no" in text
    few = "no failure (29 cases are needed to show it)"
    assert f"strong: truth ranked first | 1 of 1: 100% (20.7 to 100) | 100% | {few}" in text


@pytest.mark.parametrize(
    ("cases", "said"), [(19, "no failure (20 cases are needed to show it)"), (20, "met")]
)
def test_a_goal_is_met_from_as_many_cases_on_as_show_it(cases: int, said: str) -> None:
    one = record(LIFT, "unexplained", truth=("lift",), known=False, grade="strong")
    found = {g.name: g for g in goals(scored([one] * cases))}
    assert found["outside the catalogue: unexplained"].row[-1] == said


# --- ablation ----------------------------------------------------------------------------------------------


def test_only_numbers_that_are_read_and_have_changed_no_answer_are_switched_off() -> None:
    case = sample()[0]
    assert {case.kind for case in sample()} == {"complete", "single", "pair", "uncatalogued"}
    same = {"verdict": "adequate", "named": [], "sets": []}
    other = same | {"verdict": "unexplained"}
    assert [one.number for one in still_to_run(case, chosen(), [])] == [""]
    records = [{"id": f"{case.id}:default", "number": "", "answer": same, "read": ["named_share", "worth"]}]
    assert [one.number for one in still_to_run(case, chosen(), records)] == ["worth", "named_share"]
    records += [{"id": "c:default", "number": "", "answer": same, "read": ["worth"]}]
    records += [{"id": "c:worth", "number": "worth", "answer": other}]
    (one,) = still_to_run(case, chosen(), records)
    assert [n for n in Settings.about() if getattr(one.settings, n) != getattr(Settings(), n)] == [
        "named_share"
    ]
    with pytest.raises(ValueError, match="cannot be switched off"):
        chosen(["seed"])


def test_what_is_read_of_settings_is_known() -> None:
    settings = recording(Settings(worth=0.2))
    assert Recording.seen == set()
    assert replace(settings, false_alarm_rate=0.05).worth == 0.2
    assert "worth" in Recording.seen


def test_the_page_of_numbers_says_what_changed_and_what_was_not_run() -> None:
    names = {"default": ["lift"], "named_share": ["lift"], "output_error_reach": []}
    records = [
        {
            **({"read": ["named_share", "output_error_reach"]} if n == "default" else {}),
            "id": f"{LIFT}:{n}",
            "number": "" if n == "default" else n,
            "answer": {"verdict": "missing_effect" if found else "unexplained", "named": found, "sets": []},
        }
        for n, found in names.items()
    ]
    rows = {line.split("|")[1].strip(): line for line in ablation_page(records).splitlines() if "|" in line}
    assert [c.strip() for c in rows["`named_share`"].split("|")[-4:-1]] == ["1", "0", "0"]
    assert [c.strip() for c in rows["`output_error_reach`"].split("|")[-4:-1]] == ["1", "0", "1"]
    assert [c.strip() for c in rows["`excitation_ratio`"].split("|")[-4:-1]] == ["–", "1", "not run"]
    assert f"- `output_error_reach` off, `{LIFT}`: missing_effect lift becomes unexplained" in ablation_page(
        records
    )


def test_the_page_of_numbers_has_every_number_as_it_is_now() -> None:
    def rows(text: str) -> list[list[str]]:
        return [line.split(" | ")[:-3] for line in text.splitlines() if line.startswith("| `")]

    stored = (Path(__file__).parents[1] / "docs" / "ablation.md").read_text(encoding="utf-8")
    assert rows(stored) == rows(ablation_page([]))
    assert len(rows(stored)) == len(Settings.about())


# --- running -----------------------------------------------------------------------------------------------


def crooked(case: Planned) -> dict[str, Any]:
    """Answers for most cases; some crash, vanish or never end."""
    if case.seed == 1:
        raise ValueError("no luck")
    if case.seed == 2:
        os._exit(3)
    if case.seed == 3:
        time.sleep(30)
    return {"id": case.id, "kind": case.kind}


@pytest.mark.skipif(sys.platform == "win32", reason="cases run in forked processes")
def test_no_case_is_lost_and_none_is_run_twice(tmp_path: Path) -> None:
    out = tmp_path / "run.jsonl"
    cases = [Planned("box", (), 1.0, 1.0, False, "plain", seed) for seed in range(5)]
    assert run(cases, out, crooked, jobs=2, limit=1.5) == 3
    kept = {r["id"]: r for r in records(out)}
    assert set(kept) == {case.id for case in cases}
    assert kept[cases[1].id]["failure"] == "ValueError: no luck"
    assert kept[cases[2].id]["failure"] == "the process ended with code 3"
    assert kept[cases[3].id]["failure"] == "took more than 1.5 s"
    with out.open("a", encoding="utf-8") as stream:
        stream.write('{"id": "cut o')
    assert run([*cases, Planned("box", (), 1.0, 1.0, False, "plain", 9)], out, crooked, limit=1.5) == 0
    assert len(records(out)) == 6
    assert run([Planned("box", (), 1.0, 1.0, False, "plain", 10)], out, crooked, minutes=0.0) == 0
    assert len(records(out)) == 6


def cores(case: Planned) -> dict[str, Any]:
    return {"id": case.id, "kind": case.kind, "cores": jobs()}


@pytest.mark.skipif(sys.platform != "linux", reason="processes share memory on Linux only")
@pytest.mark.parametrize(("beside", "taken"), [(1, 3), (2, 1)])
def test_a_case_alone_takes_all_cores(
    beside: int, taken: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UNDERTOW_JOBS", "3")
    out = tmp_path / "run.jsonl"
    run([Planned("box", (), 1.0, 1.0, False, "plain", 1)], out, cores, jobs=beside)
    (found,) = records(out)
    assert found["cores"] == taken


def test_seconds_are_those_on_most_cores_and_of_the_processor_on_one() -> None:
    six = {"motions": ["surge", "sway", "heave", "roll", "pitch", "yaw"], "cpu": 30.0}
    beside, alone = ({**six, "seconds": s, "cores": c} for s, c in ((50.0, 1), (20.0, 2)))
    for cases, said in (([beside, alone], ("2", "20")), ([beside], ("1", "30"))):
        rows = [g.row for g in goals(scored([record(LIFT, "adequate", **one) for one in cases]))]
        (row,) = [r for r in rows if "six degrees" in r[0]]
        assert row[0].endswith(f"cores: {said[0]}")
        assert row[1].startswith(said[1])


def test_nonsense_is_one_line_and_exit_code_2(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for words in (["one", "usv:lift"], ["report", str(tmp_path / "absent.jsonl")], ["list", "--part", "3/2"]):
        assert main(words) == 2
        assert capsys.readouterr().err.count("\n") == 1


def test_list_prints_the_plan(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "--plan", "quick", "--kind", "complete"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == sum(case.kind == "complete" for case in plan(1))


def test_other_methods_get_straight_lines_where_a_channel_has_gaps() -> None:
    t = np.arange(0.0, 20.0, 0.05)
    nan = np.isin(np.arange(len(t)), [0, 1, 150, 151, len(t) - 1])
    run = Run("gaps", t, {"u": np.where(nan, np.nan, 0.3 * t)}, sha256="")
    whole = filled(run, ["u"])[:, 0]
    np.testing.assert_allclose(whole[2:-1], 0.3 * t[2:-1], atol=1e-12)
    assert np.isfinite(whole).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "differs"),
    [
        # a side force twice per turn, in closed loop: thrust astern goes along with it (was propeller_walk)
        ("usv:heading_force:x1:n0.3:closed:plain:79367349", "have to vary from"),
        # a drag that grows with time, while the vehicle moves away (was tether_drag)
        ("rov:growing_drag:x0.4:n0.3:closed:plain:68673538", "drop to"),
    ],
)
def test_what_no_catalogue_knows_does_not_get_the_name_of_what_goes_along_with_it(
    case: str, differs: str
) -> None:
    said = measured(Planned.read(case), peers=False)[0]
    assert said["answer"]["verdict"] == "helps_prediction"
    assert f"its size would {differs}" in said["headline"]
