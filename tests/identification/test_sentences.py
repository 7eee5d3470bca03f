"""The first sentence of a diagnosis, the command after it, and words that follow from numbers."""

from __future__ import annotations

import math
import shlex
from math import inf
from types import SimpleNamespace
from typing import Any

import pytest

from undertow.cli.identification.diagnose import show
from undertow.identification.diagnosis.result import (
    NO_EVIDENCE,
    Dependence,
    Diagnosis,
    Indistinguishable,
    Predictability,
    Ranked,
    Remaining,
    Role,
    RunInfo,
    Step,
    Verdict,
)
from undertow.identification.findings import Finding
from undertow.identification.report.sentences import (
    CommandLine,
    as_stated,
    changes,
    first_sentence,
    next_command,
    percentage,
    refit_is_worse,
    rises,
    step_changes,
    summarised,
    useless,
)

REFITTED = Step(added=[], error=9.0, ahead={"5 s": 0.040, "20 s": 0.090, "free run": 0.3})
BETTER = Step(added=["lift"], error=2.0, ahead={"5 s": 0.016, "20 s": 0.0334, "free run": 0.1})
LINE = CommandLine(
    "my rov.toml", ("a.csv", "b.csv"), ("c.csv",), ("--map", "log.toml", "--trust-log"), "found.json"
)


def _run(role: Role) -> RunInfo:
    return RunInfo(name="a", source="a.csv", sha256="", role=role, samples=9, duration=1.0, notes=[])


def _left(**more: Any) -> Remaining:
    numbers = {"normalised_error": 4.0, "residual_rms": 2.0, "noise_rms": 0.5, "excess_rms": 1.9}
    return Remaining(degree_of_freedom="sway", unit="N", note="", **{**numbers, **more})


def _diagnosis(verdict: Verdict, **more: Any) -> Diagnosis:
    named, helps = verdict in ("missing_effect", "indistinguishable"), verdict == "helps_prediction"
    usual: dict[str, Any] = {
        "undertow": "0",
        "vehicle": "v",
        "degrees_of_freedom": ["sway"],
        "signs": "sname",
        "runs": [_run("train"), _run("holdout")],
        "verdict": verdict,
        "headline": "What was tried.",
        "effects": ["lift"] if named else [],
        "ranking": [],
        "helps": ["lift"] if helps else [],
        "steps": [REFITTED, BETTER] if named or helps else [REFITTED],
        "indistinguishable": [],
        "warnings": [],
        "remaining": [_left()],
        "parameters": [],
        "false_alarm_rate": 0.01,
        "noise": {},
        "seconds": 1.0,
    }
    return Diagnosis(**{**usual, **more})


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (0.040, 0.016, "lowers the 5-s error from 4.0 to 1.6%"),
        (0.67, 0.84, "raises the 5-s error from 67 to 84%"),
        (0.2549, 0.2546, "leaves the 5-s error at 25%"),
        (0.02849, 0.02851, "leaves the 5-s error at 2.9%"),
        (0.126, 0.134, "raises the 5-s error from 12.6 to 13.4%"),
        (0.114, 0.1054, "lowers the 5-s error from 11.4 to 10.5%"),
        (0.1301, 0.1299, "leaves the 5-s error at 13%"),
        (None, 0.05, "lowers the 5-s error from diverging to 5.0%"),
        (0.05, None, "raises the 5-s error from 5.0 to diverging"),
    ],
)
def test_words_follow_from_the_numbers(before: float | None, after: float | None, said: str) -> None:
    pair = [{} if share is None else {"5 s": share} for share in (before, after)]
    assert changes(*pair) == said
    assert rises(before, after) == said.startswith("raises")


def test_what_falls_and_what_rises_are_said_apart() -> None:
    before, after = {"5 s": 0.688, "20 s": 0.582, "free run": 2.0}, {"5 s": 0.5, "20 s": 0.843}
    assert changes(before, after) == (
        "lowers the 5-s error from 69 to 50% and raises the 20-s error from 58 to 84%"
    )
    assert changes({"free run": 0.4}, {"free run": 0.2}) == "lowers the free-run error from 40 to 20%"


def test_what_the_file_itself_predicts_is_said_and_compared() -> None:
    """A refit that is worse on validation data than the file makes whatever is added to it look good."""
    after = Step(added=["tether"], error=2.0, ahead={"2.2 s": 0.485, "8.9 s": 0.482, "free run": 0.4})
    file = Step(added=[], error=9.0, ahead={"2.2 s": 0.471, "8.9 s": 0.477, "free run": 0.6})
    assert as_stated(file, after, "with it") == (
        "With the values of the vehicle file, the model has a 2.2-s error of 47% and an 8.9-s error of 48%"
        "; with it, it predicts no better."
    )
    assert as_stated(REFITTED, BETTER, "with it").endswith("a 20-s error of 9.0%.")
    assert "diverges" in as_stated(Step(added=[], error=9.0), after, "with it")


def test_the_position_is_said_where_it_gains_most() -> None:
    before = Step(added=[], error=9.0, ahead={"5 s": 0.040}, position={"5 s": 0.5, "free run": 4.0})
    sensor = Step(added=["a"], error=1.0, ahead={"5 s": 0.040}, position={"5 s": 0.02, "free run": inf})
    force = Step(added=["b"], error=1.0, ahead={"5 s": 0.010}, position={"5 s": 0.25})
    assert step_changes(before, sensor) == (
        "lowers the position error over 5 s from 0.5 to 0.02 m and leaves the 5-s error at 4.0%"
    )
    assert step_changes(before, force) == "lowers the 5-s error from 4.0 to 1.0%"
    assert "free run" not in sensor.position  # what diverges has no size


def test_the_residual_is_said_where_sensor_noise_hides_what_predictions_gain() -> None:
    before = Step(added=[], error=1.37, ahead={"5 s": 0.0241, "20 s": 0.0221})
    after = Step(added=["wind"], error=1.0, ahead={"5 s": 0.0240, "20 s": 0.0220})
    assert step_changes(before, after) == (
        "lowers the residual from 1.37 to 1 times the noise and leaves the 5-s error at 2.4% and the 20-s "
        "error at 2.2%"
    )
    assert step_changes(after, before).startswith("leaves the 5-s error")


def test_the_position_is_said_over_the_horizon_that_counts_for_it() -> None:
    """A lever arm may improve the position over 30 s by enough to be named, and no other prediction."""
    same = {"8 s": 0.030, "30 s": 0.047, "70 s": 0.05}
    before = Step(added=[], error=9.0, ahead=same, position={"8 s": 0.08, "30 s": 0.34, "70 s": 1.33})
    after = Step(added=["arm"], error=9.0, ahead=same, position={"8 s": 0.02, "30 s": 0.28, "70 s": 1.31})
    assert step_changes(before, after).startswith("lowers the position error over 30 s from 0.34 to 0.28 m")


def test_shares_have_two_digits() -> None:
    assert [percentage(s) for s in (0.0401, 0.0996, 0.5, 1.234, 0.0, float("inf"))] == [
        "4.0",
        "10.0",
        "50",
        "123",
        "0",
        "diverging",
    ]
    assert percentage(0.2546, 3) == "25.5"


def test_a_missing_effect_is_said_first_with_the_command_that_adds_it() -> None:
    found = _diagnosis("missing_effect")
    said = (
        "Adding lift lowers the 5-s error from 4.0 to 1.6% and the 20-s error from 9.0 to 3.3% on "
        "validation runs."
    )
    assert first_sentence(found) == said
    of_what = said.replace("1.6%", "1.6% of the motion")
    assert summarised(found).headline == f"{of_what} What was tried."
    nothing = _diagnosis("unexplained").model_copy(update={"headline": NO_EVIDENCE})
    assert summarised(nothing).headline.count("effect in the catalogue") == 1
    doubted = nothing.model_copy(update={"headline": "Unexplained: the sensors contradict each other."})
    assert summarised(doubted).headline.endswith(". The sensors contradict each other.")
    useless_one = BETTER.model_copy(update={"channels": {"u": 0.5, "r": 2.0}})
    poor = found.model_copy(update={"steps": [*found.steps[:-1], useless_one]})
    assert summarised(poor).headline.startswith("Worse than no model at all in yaw (200%): first check the s")
    note = Finding(id="jitter", severity="note", text="a: sampling is irregular", evidence={})
    looked_at = poor.model_copy(update={"doctor": [note]})
    assert "(200%): undertow doctor finds no mistake in the logs, so check" in summarised(looked_at).headline
    command = next_command(found, LINE)
    assert shlex.split(command) == [
        *("undertow", "add", "lift", "my rov.toml", "a.csv", "b.csv", "--validation", "c.csv"),
        *("--map", "log.toml", "--trust-log", "--out", "my rov-lift.toml"),
    ]


def test_the_command_after_a_diagnosis_is_not_refused() -> None:
    """`add` asks for a tenth over all horizons together; the search may have named what brings less."""
    step = Step(added=["lift"], error=2.0, ahead={"5 s": 0.039, "20 s": 0.085, "free run": 0.1})
    small = _diagnosis("missing_effect", steps=[REFITTED, step])
    assert next_command(small, LINE) == next_command(_diagnosis("missing_effect"), LINE) + " --force"


def test_each_verdict_says_what_to_do() -> None:
    several = _diagnosis("missing_effect", effects=["lift", "wind"])
    assert "undertow add lift,wind 'my rov.toml'" in next_command(several, LINE)
    assert next_command(several, LINE).endswith("--out 'my rov-better.toml'")
    equals = [Indistinguishable(effects=["lift", "wind"], reason="")]
    either = _diagnosis("indistinguishable", indistinguishable=equals)
    assert "but wind would achieve the same" in first_sentence(either)
    assert "--goal separate --between lift,wind --out plan.csv" in next_command(either, LINE)
    hopeless = [Indistinguishable(effects=["lift", "wind"], reason="", separable=False)]
    never = _diagnosis("indistinguishable", indistinguishable=hopeless, effects=["lift"])
    assert "no run is known that would tell them apart" in first_sentence(never)
    assert "undertow add lift" in next_command(never, LINE)
    beside = _diagnosis("indistinguishable", indistinguishable=equals, effects=["slosh", "lift"])
    assert "but wind would achieve the same as lift, or most of it" in first_sentence(beside)
    two = [*equals, Indistinguishable(effects=["slosh", "wind"], reason="")]
    both = _diagnosis("indistinguishable", indistinguishable=two, effects=["lift", "slosh"])
    assert "but wind would achieve the same" in first_sentence(both)  # once
    helped = _diagnosis("missing_effect", helps=["wind", "slosh"])
    also = "; adding wind and slosh as well improves predictions further, without establishing a cause."
    assert first_sentence(helped).endswith(f"on validation runs{also}")
    useful = _diagnosis("helps_prediction")
    assert "from 9.0 to 3.3% on validation runs, but it is not established" in first_sentence(useful)
    assert "undertow add lift" in next_command(useful, LINE)
    enough = _diagnosis("adequate", runs=[_run("blocks")])
    assert first_sentence(enough) == (
        "These logs show nothing missing: the refitted model has a 5-s error of 4.0% and a "
        "20-s error of 9.0% on segments of the logs that were not fitted, and can be used as it is."
    )
    assert "undertow fit" in next_command(enough, LINE)
    open_ = _diagnosis("not_identifiable", effects=[])
    assert next_command(open_, LINE).startswith("undertow plan 'my rov.toml' a.csv")
    # Of a buoy without a thruster, or a model that is towed, no manoeuvre can be planned.
    assert next_command(open_, LINE, plannable=False).startswith("undertow doctor 'my rov.toml' a.csv")
    assert "undertow add lift" in next_command(
        either.model_copy(update={"effects": ["lift"]}), LINE, plannable=False
    )
    freed = REFITTED.model_copy(update={"ahead": BETTER.ahead, "freed": ["N_r"]})
    others = _diagnosis("adequate", steps=[REFITTED, freed])
    assert first_sentence(others).startswith("Fitting N_r as well lowers the 5-s error from 4.0 to 1.6%")
    assert "--apply" in next_command(others, LINE)
    still = first_sentence(_diagnosis("unexplained", steps=[REFITTED, freed]))
    assert still.startswith("Fitting N_r as well lowers the 5-s error from 4.0 to 1.6%")
    assert "No effect in the catalogue" in still


def test_what_is_unexplained_says_where_to_look() -> None:
    nothing = _diagnosis("unexplained")
    place = "the residual exceeds the noise most in sway, and no logged variable clearly explains it"
    assert place in first_sentence(nothing)
    assert next_command(nothing, LINE) == ("undertow doctor 'my rov.toml' a.csv b.csv c.csv --map log.toml")
    term = Dependence(
        term="v|v|", columns=[["v"]], coefficients=[1.0], standard_errors=[0.1], units=["N"], share=0.5,
        chance=0.01, alike=[],
    )  # fmt: skip
    some = _diagnosis("unexplained", remaining=[_left(depends_on=[term])])
    said = "in sway; 50% of it in sway correlates with v|v|; undertow effects new turns that into an effect"
    assert said in first_sentence(some)
    assert next_command(some, LINE) == "undertow effects new my_force --from found.json"
    assert "&& undertow effects new" in next_command(some, CommandLine())


@pytest.mark.parametrize(("share", "said"), [(0.9, True), (0.6, False)])
def test_what_explains_more_than_an_effect_in_doubt_comes_first(share: float, said: bool) -> None:
    """A weight that was dropped, and buoyancy that makes up for a part of it."""
    term = Dependence(
        term="a step at 55.8 s", columns=[["step(t - 55.8)"]], coefficients=[1.4], standard_errors=[0.1],
        units=["N"], share=share, chance=0.0005, alike=[],
    )  # fmt: skip
    lift = Ranked(
        effect="lift", family="hull", about="", parameters=[], error_before=9.0, error_after=5.0,
        explained=0.7, improvement=1.0, interval=(0.5, 1.5), significant=True,
    )  # fmt: skip
    doubted = _diagnosis(
        "helps_prediction", effects=[], helps=["lift"], remaining=[_left(depends_on=[term])],
        ranking=[lift],
    )  # fmt: skip
    headline = summarised(doubted).headline
    words = "Other terms explain more of the residual: 90% of it in sway correlates with a step at 55.8 s"
    assert (words in headline) is said
    command = next_command(summarised(doubted), LINE)
    assert command.startswith("undertow effects new" if said else "undertow add lift")


def test_a_residual_that_may_be_a_disturbance_is_not_called_missing() -> None:
    signal = Predictability(
        degree_of_freedom="sway", unit="N", averaged_over=1.0, residual_rms=2.0, share=0.1,
        interval=(0.0, 0.54), significant=False, noise_share=0.2, disturbance_rms=1.6,
        relative_to_inertia=0.1, variables={},
    )  # fmt: skip
    nothing = {"headline": NO_EVIDENCE, "predictable": [signal]}
    short = first_sentence(_diagnosis("unexplained", **nothing))
    assert "do not show if any is missing" in short
    assert "up to 54% of it in sway may do so" in short
    # Nor is it said beside effects that improve the model, or sensors that contradict each other.
    shown = Ranked(
        effect="wind", family="water", about="", parameters=[], error_before=9.0, error_after=8.0,
        explained=0.2, improvement=0.1, interval=(0.05, 0.15), significant=True,
        not_named="improves predictions in only 75% of the resamples",
    )  # fmt: skip
    beside = first_sentence(_diagnosis("unexplained", **nothing, ranking=[shown]))
    assert "improves the model" not in beside
    assert "do not show if any is missing" not in beside
    words = "wind lowers the residual from 9 to 8 times the noise, by more than chance, but is not added: "
    assert words + shown.not_named in beside
    assert words in first_sentence(_diagnosis("adequate", predictable=[signal], ranking=[shown]))
    sensors = _diagnosis("unexplained", **{**nothing, "headline": "Unexplained: the sensors contradict"})
    assert "improves the model" not in first_sentence(sensors)
    known = signal.model_copy(update={"significant": True, "share": 0.7, "variables": {"v": 2.0, "r": 1.0}})
    together = first_sentence(_diagnosis("unexplained", predictable=[known]))
    assert "explains what is missing" in together
    assert "several together predict 70% of it in sway (from v and r)" in together


def test_a_residual_that_is_noise_in_every_motion_exceeds_it_in_none() -> None:
    nowhere = first_sentence(_diagnosis("unexplained", remaining=[_left(excess_rms=0.0)]))
    assert "exceeds the noise most" not in nowhere
    assert nowhere.endswith("check the logs with undertow doctor.")


def test_an_effect_that_shows_but_hardly_changes_predictions_is_mentioned_and_not_named() -> None:
    """A tether that came taut once explains most of the residual force, and little of the motion."""

    def said(after: float, fall: float) -> str:
        taut = Ranked(
            effect="tether_tension", family="tether", about="", parameters=[], error_before=3.0,
            error_after=after, explained=0.0, improvement=0.1, interval=(0.05, 0.15), significant=True,
            falls={"5 s": 0.01, "20 s": fall},
        )  # fmt: skip
        return first_sentence(_diagnosis("unexplained", ranking=[taut]))

    assert said(1.5, 0.02).endswith(
        "tether_tension lowers the residual from 3 to 1.5 times the noise, but no prediction error by more "
        "than 2%, too little to establish it: record runs in which it would act more."
    )
    assert "tether_tension" not in said(2.9, 0.02)  # a small part of the residual
    assert "tether_tension" not in said(1.5, 0.2)  # not named for another reason


def test_a_model_worse_than_none_is_called_so() -> None:
    """A share of 1 is the error of a model whose vehicle never moves."""
    assert useless({"u": 0.4, "v": 1.0}) == ""
    assert useless({"u": 0.4, "v": 3.5, "r": 2.02}) == (
        "Worse than no model at all in sway and yaw (350%, 202%): first check the signs of commands and "
        "axes (undertow doctor)."
    )
    assert useless({"w": None}).startswith("Worse than no model at all in heave (diverging):")


def test_what_the_doctor_doubts_is_not_called_free_of_mistakes() -> None:
    doubt = Finding(id="swapped", severity="warning", text="perhaps f1 and f2 are swapped: yaw shows it")
    note = Finding(id="gaps", severity="note", text="2 gaps")
    assert "undertow doctor finds no mistake in the logs" in useless({"r": 1.1}, [note])
    assert useless({"r": 1.1}, [note, doubt]).endswith(
        "undertow doctor is not sure of the logs (perhaps f1 and f2 are swapped): try that first."
    )


def test_a_refit_that_predicts_worse_than_the_file_is_said_to() -> None:
    stated, refitted = {"5 s": 0.48, "20 s": 0.6}, {"5 s": 0.55, "20 s": 0.7}
    words = refit_is_worse(stated, refitted, 1.025)
    assert "a 5-s error of 48% and a 20-s error of 60% as stated" in words
    assert "a 5-s error of 55% and a 20-s error of 70% refitted" in words
    assert refit_is_worse(stated, refitted | {"20 s": 0.61}, 1.025) == ""
    assert refit_is_worse({"5 s": math.inf}, refitted, 1.025) == ""


def test_where_no_candidate_helps_no_empty_table_stands(capsys: pytest.CaptureFixture[str]) -> None:
    useless = Ranked(
        effect="wind", family="water", about="", parameters=[], error_before=9.0, error_after=9.0,
        explained=0.0, improvement=0.0, interval=(0.0, 0.0), significant=False,
    )  # fmt: skip
    show(SimpleNamespace(diagnosis=_diagnosis("unexplained", ranking=[useless] * 3)))  # type: ignore[arg-type]
    said = capsys.readouterr().out
    assert "3 effects were tried, and none of them improves predictions" in said
    assert "Candidates" not in said
    assert "fitted values" not in said
