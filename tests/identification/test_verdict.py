"""What may be named: the rules between the evidence and the verdict."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from undertow.identification import result_builder
from undertow.identification.diagnosis.evidence import Comparison, FoundEffect
from undertow.identification.diagnosis.result import Indistinguishable, Ranked
from undertow.identification.diagnosis.settings import DEFAULT

# Private: by its input each of these rules would take a search of its own.
# Private: sentences for remainders and winners that no log here has.
from undertow.identification.diagnosis.verdict import Remainder, _doubt, _headline, error_of_sensors
from undertow.identification.result_builder import ResultBuilder
from undertow.model.catalogue import catalogue

ONE, TWO = ["lift"], ["lift", "actuation_delay"]


@pytest.mark.parametrize(
    ("share", "left", "doubt"),
    [
        (0.0, Remainder(residual_is_noise=True, confirmed=True, explained=0.51), ""),
        (0.99, Remainder(residual_is_noise=True, confirmed=True, explained=0.14), "explains only 14% of the"),
        (0.99, Remainder(residual_is_noise=True, confirmed=False), "simulation"),
        (DEFAULT.named_share + 0.01, Remainder(False, confirmed=True, nearly=True), ""),
        (DEFAULT.named_share - 0.01, Remainder(False, confirmed=True, nearly=True), "too little to be named"),
        (0.999, Remainder(residual_is_noise=False, confirmed=True), "leaves a residual above the noise"),
    ],
)
def test_what_stands_against_naming(share: float, left: Remainder, doubt: str) -> None:
    """If the residual clearly exceeds the noise, the weak form names nothing, however much it explains."""
    said = _doubt(share, left, DEFAULT)
    assert doubt in said
    assert bool(said) is bool(doubt)


def test_the_headline_names_what_is_certain_beside_what_is_not() -> None:
    winners = [SimpleNamespace(id=i) for i in TWO]
    alike = [Indistinguishable(effects=["actuation_delay", "thruster_lag"], reason="")]
    both = _headline(winners, [], alike, 0.99, True)
    assert both.startswith(
        "Missing: lift. In addition, these data cannot tell which is missing: actuation_delay or "
        "thruster_lag."
    )
    alone = _headline(winners[1:], [], alike, 0.99, True)
    assert alone.startswith("These data cannot tell which is missing: actuation_delay or thruster_lag.")
    assert _headline(winners, [], [], 0.93, False) == (
        "Missing: lift and actuation_delay; together they explain 93% of the excess over noise."
    )
    # The noise that remains is that of the model with all effects, also those that only help to predict.
    assert _headline(winners[:1], winners[1:], [], 0.99, True) == (
        "Missing: lift; with actuation_delay as well, only noise remains."
    )


def test_the_share_that_named_effects_explain_is_without_those_that_only_help(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(result_builder, "judge_selection", lambda found, scores, *_: scores)
    bench = SimpleNamespace(score=lambda fit: fit, noise_level=None)
    builder = SimpleNamespace(bench=bench, found=None, _weak=["none", "lift", "lift and wind"])
    builder._scores = lambda count: ResultBuilder._scores(builder, count)  # type: ignore[arg-type]
    for named, model in ((1, "lift"), (0, "lift and wind")):
        selection = SimpleNamespace(established=[None] * named)
        assert ResultBuilder._judged(builder, selection) == ("none", model)  # type: ignore[arg-type]


def test_a_chosen_effect_has_one_error_and_the_values_that_are_handed_on() -> None:
    """Those of the steps and of the model that `add` would write, not of the fit that found it."""
    first, second, helping, other, rival = (
        SimpleNamespace(id=i, trial=SimpleNamespace(fit=f"fit of {i}")) for i in "abcde"
    )
    builder = SimpleNamespace(
        judgement=SimpleNamespace(effects=[first, second], helps=[helping]),
        fits=["none", "a", "a b", "a b c"],
        validator=SimpleNamespace(predicting_fit=lambda fit: fit),
        _alike={"e": (rival, "a e")},
    )
    builder._place = lambda f: ResultBuilder._place(builder, f)  # type: ignore[arg-type]
    builder._error = builder._normalised = lambda fit: fit
    all_five = (first, second, helping, other, rival)
    errors = [ResultBuilder._error_with(builder, f) for f in all_five]  # type: ignore[arg-type]
    values = [ResultBuilder._model_for_values(builder, f) for f in all_five]  # type: ignore[arg-type]
    assert errors == ["a", "a b", "a b c", "fit of d", "a e"]
    assert values == ["a b", "a b", "a b c", "fit of d", "fit of e"]


@pytest.mark.parametrize(
    ("significant", "before", "after", "sure"),
    [(True, 3.0, 2.0, "yes"), (False, 3.0, 2.0, "no"), (True, 3.0, 3.2, "in part"), (False, 3.0, 3.2, "no")],
)
def test_an_effect_with_which_the_error_rises_helps_in_part_at_the_most(
    significant: bool, before: float, after: float, sure: str
) -> None:
    candidate = Ranked.model_construct(significant=significant, error_before=before, error_after=after)
    assert candidate.sure == sure


def test_no_share_below_zero_is_reported() -> None:
    doubt = _doubt(-0.21, Remainder(residual_is_noise=False, confirmed=True, nearly=True), DEFAULT)
    assert doubt == "explains none of the excess over noise, too little to be named as the missing effect"


@pytest.mark.parametrize(
    ("effect", "significant", "share", "error", "said"),
    [
        ("water_speed_log", True, 0.57, 0.01, True),
        ("water_speed_log", True, 0.57, 10.0, False),
        ("water_speed_log", True, 0.02, 0.01, False),
        ("water_speed_log", False, 0.57, 0.01, False),
        ("ocean_current", True, 0.57, 0.01, False),
    ],
)
def test_no_disturbance_acts_between_pose_and_velocity(
    effect: str, *, significant: bool, share: float, error: float, said: bool
) -> None:
    """Forces that nobody knows may be behind an excess in the forces, not behind one between two sensors."""
    fit = SimpleNamespace(model=SimpleNamespace(free=("V",)), values={"V": 0.1}, standard_errors={"V": error})
    candidate = SimpleNamespace(effect=catalogue()[effect], parameters=[SimpleNamespace(name="V")])
    trial = SimpleNamespace(candidate=candidate, id=effect, fit=fit)
    finding = FoundEffect(trial, Comparison(0.1, (0.0, 0.2), 0.001), share, 0.001, significant)
    judgement, alone = (error_of_sensors([finding], compared) for compared in (True, False))
    assert (judgement is not None) == said
    if judgement is not None:
        assert judgement.verdict == "unexplained"
        assert "contradict each other. water_speed_log removes 57% of the excess" in judgement.headline
        assert alone is not None
        assert alone.verdict == "unexplained"
        assert "contradict" not in alone.headline
        assert "a missing force look alike" in alone.headline
