"""From the search to a verdict, in words that claim no more than was shown."""

from __future__ import annotations

from dataclasses import dataclass

from undertow.typing import Array

from .evidence import explained
from .finding import Finding
from .result import Indistinguishable, Verdict
from .search import Search
from .trial import Score, told_apart

# An effect is named only where it (with those named before it) explains this share of what exceeds the noise:
# a wrong effect often takes half of a residual, seldom four fifths of it.
NAMED_SHARE = 0.8
# Of more effects than this that do equally well, none is in evidence.
_MANY = 4


@dataclass(frozen=True)
class Judgement:
    """The verdict with its reasons.

    Attributes
    ----------
    verdict : str
        One of `Verdict`.
    headline : str
        One sentence.
    effects : list of Finding
        The effects that are named.
    sets : list of Indistinguishable
        Effects that the data cannot tell apart.
    share : float
        Share of the excess over the noise that the added effects explain.
    """

    verdict: Verdict
    headline: str
    effects: list[Finding]
    sets: list[Indistinguishable]
    share: float


@dataclass(frozen=True)
class Left:
    """What the final model leaves, and what speaks against it.

    Attributes
    ----------
    quiet : bool
        Whether the noise explains what is left.
    confirmed : bool
        Whether the model does not simulate the kept-aside runs worse than the incomplete one.
    nearly : bool
        Whether less than twice the noise is left in every equation.
    change : str
        How the size of the effect would have to change in the course of the kept-aside data, if it would.
    """

    quiet: bool
    confirmed: bool
    nearly: bool = False
    change: str = ""


def judge(found: Search, scores: tuple[Score, Score], noise: Array, left: Left) -> Judgement:
    """Decide.

    Parameters
    ----------
    found : Search
        What the search did.
    scores : (Score, Score)
        The incomplete and the final model under the final noise model.
    noise : (2n,) array
        Mean square that the noise of the sensors has under that noise model.
    left : Left
        What the final model leaves.
    """
    winners = found.winners
    share = explained(*told_apart(*scores, found.bench.test), noise)
    sets = _sets(found)
    if not winners:
        return _without_effect(left.quiet, share)
    if doubt := _doubt(winners, share, left):
        return _unexplained(winners, share, doubt)
    verdict: Verdict = "indistinguishable" if sets else "missing_effect"
    if any(len(s.effects) > _MANY for s in sets):
        verdict = "not_identifiable"
    return Judgement(verdict, _named(winners, sets, share, left.quiet), winners, sets, share)


def _without_effect(quiet: bool, share: float) -> Judgement:
    if quiet:
        text = "Nothing is missing: what the refitted model leaves is the noise of the sensors."
        return Judgement("adequate", text, [], [], share)
    text = (
        "Unexplained: the refitted model leaves more than the noise of the sensors, and for no effect "
        "of the catalogue is there enough evidence on kept-aside data."
    )
    return Judgement("unexplained", text, [], [], share)


def _doubt(winners: list[Finding], share: float, left: Left) -> str:
    """Why nothing can be named, or nothing where it can.

    Where more than noise is left, a later effect may only make up for an earlier one that is wrong or poorly
    fitted: several are named together only where they explain all but very little.
    """
    if not left.confirmed:
        return "makes the simulation of the kept-aside runs worse, so it is not what is missing"
    if left.quiet:
        return ""
    if share < NAMED_SHARE:
        much = f"only {share:.0%}" if share > 0.0 else "none"
        return f"explains {much} of what exceeds the noise, too little to be named as what is missing"
    if len(unique_ids(winners)) > 1 and not left.nearly:
        return "leaves more than noise, and several effects are named only where next to nothing else is left"
    if left.change:
        return f"leaves more than noise, and {left.change} in the course of the kept-aside data"
    return ""


def _unexplained(winners: list[Finding], share: float, reason: str) -> Judgement:
    names = " and ".join(unique_ids(winners))
    text = f"Unexplained: adding {names} fits the kept-aside data better by more than chance, but {reason}."
    return Judgement("unexplained", text, [], [], share)


def _named(winners: list[Finding], sets: list[Indistinguishable], share: float, quiet: bool) -> str:
    open_ = {e for s in sets for e in s.effects}
    how = "it explains" if len(unique_ids(winners)) == 1 else "together they explain"
    rest = "what remains is noise" if quiet else f"{how} {share:.0%} of what exceeds the noise"
    names = " and ".join(n for n in unique_ids(winners) if n not in open_)
    if not sets:
        return f"Missing: {names}; {rest}."
    choice = "; ".join(" or ".join(s.effects) for s in sets)
    certain = f"Missing: {names}. Beside it these data cannot tell" if names else "These data cannot tell"
    return f"{certain}: {choice}. Any of them brings the error down alike; {rest}."


def unique_ids(findings: list[Finding]) -> list[str]:
    """Ids in order; an effect may come twice, when a second parameter of it shows only once others are in."""
    return list(dict.fromkeys(f.id for f in findings))


def _sets(found: Search) -> list[Indistinguishable]:
    return [
        Indistinguishable(effects=[best.id, *(c.findings[i].id for c in rivals)], reason=_reason(best))
        for i, (best, rivals) in enumerate(zip(found.winners, found.rivals, strict=True))
        if rivals
    ]


def _reason(best: Finding) -> str:
    return (
        "their predictions of the kept-aside data differ by less than the noise lets one see "
        f"(the best of them improves the mean square by {best.evidence.mean:.3g})"
    )
