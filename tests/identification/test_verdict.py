"""What may be named: the rules between the evidence and the verdict."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from undertow.identification.diagnosis.result import Indistinguishable, how_sure
from undertow.identification.diagnosis.settings import DEFAULT

# Private: by its input each of these rules would take a search of its own.
from undertow.identification.diagnosis.verdict import Remainder, _doubt, _named

ONE, TWO = ["lift"], ["lift", "actuation_delay"]
TWICE = ["thruster_gain", "thruster_gain"]


@pytest.mark.parametrize(
    ("ids", "share", "quiet", "confirmed", "doubt"),
    [
        (ONE, 0.5, True, True, ""),
        (ONE, DEFAULT.named_share + 0.01, False, True, ""),
        (ONE, DEFAULT.named_share - 0.01, False, True, "too little to be named"),
        (ONE, 0.99, True, False, "simulation"),
        (TWO, 0.99, True, True, ""),
        (TWO, 0.99, False, True, "several effects are named only where next to nothing else is left"),
        (TWICE, 0.99, False, True, ""),
    ],
)
def test_what_stands_against_naming(
    ids: list[str], share: float, quiet: bool, confirmed: bool, doubt: str
) -> None:
    """A second effect can make up for a first one that is wrong, so two have to explain all."""
    winners = [SimpleNamespace(id=i) for i in ids]
    said = _doubt(winners, share, Remainder(residual_is_noise=quiet, confirmed=confirmed), DEFAULT)
    assert doubt in said
    assert bool(said) is bool(doubt)


def test_a_size_that_changes_stands_against_naming_unless_only_noise_is_left() -> None:
    winners, words = [SimpleNamespace(id="net_buoyancy")], "its size would have to go from 0% to 120%"
    assert words in _doubt(
        winners, 0.93, Remainder(residual_is_noise=False, confirmed=True, change=words), DEFAULT
    )
    assert (
        _doubt(winners, 0.93, Remainder(residual_is_noise=True, confirmed=True, change=words), DEFAULT) == ""
    )


def test_several_effects_that_leave_next_to_nothing_are_named() -> None:
    """The weak form leaves a little even of the truth where a force changes quickly between two samples."""
    winners = [SimpleNamespace(id=i) for i in TWO]
    assert (
        _doubt(winners, 0.96, Remainder(residual_is_noise=False, confirmed=True, nearly=True), DEFAULT) == ""
    )
    assert "too little" in _doubt(
        winners, 0.7, Remainder(residual_is_noise=False, confirmed=True, nearly=True), DEFAULT
    )


def test_the_headline_names_what_is_certain_beside_what_is_not() -> None:
    winners = [SimpleNamespace(id=i) for i in TWO]
    alike = [Indistinguishable(effects=["actuation_delay", "thruster_lag"], reason="")]
    both = _named(winners, alike, 0.99, True)
    assert both.startswith(
        "Missing: lift. Beside it these data cannot tell: actuation_delay or thruster_lag."
    )
    alone = _named(winners[1:], alike, 0.99, True)
    assert alone.startswith("These data cannot tell: actuation_delay or thruster_lag.")
    assert _named(winners, [], 0.93, False) == (
        "Missing: lift and actuation_delay; together they explain 93% of what exceeds the noise."
    )


@pytest.mark.parametrize(
    ("significant", "before", "after", "sure"),
    [(True, 3.0, 2.0, "yes"), (False, 3.0, 2.0, "no"), (True, 3.0, 3.2, "in part"), (False, 3.0, 3.2, "no")],
)
def test_an_effect_with_which_the_error_rises_helps_in_part_at_the_most(
    significant: bool, before: float, after: float, sure: str
) -> None:
    assert how_sure(significant, before, after) == sure


def test_no_share_below_zero_is_told() -> None:
    winners = [SimpleNamespace(id="lift")]
    doubt = _doubt(winners, -0.21, Remainder(residual_is_noise=False, confirmed=True), DEFAULT)
    assert doubt == "explains none of what exceeds the noise, too little to be named as what is missing"
