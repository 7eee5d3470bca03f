"""What a diagnosis means, in words for somebody who has to decide something, and numbers with their units."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import floor, isfinite, log10

from ..diagnosis.result import Diagnosis, Estimate, Verdict
from .style import unit_text


@dataclass(frozen=True)
class Meaning:
    """A verdict explained: its title, what it says, and what it does not."""

    title: str
    says: str
    not_shown: tuple[str, ...]


_LIMITS = (
    "Anything about speeds, turns, depths or loads that do not occur in these logs.",
    "Effects that are not in the catalogue, or that these manoeuvres do not excite.",
)
_MEANINGS: dict[Verdict, Meaning] = {
    "adequate": Meaning(
        "Nothing is missing",
        "On data that the fit has not seen, no effect of the catalogue lowers the error by more than chance "
        "would. What the model leaves over looks like the noise of the sensors.",
        ("That the model is right: only that these logs do not show it wrong.", *_LIMITS),
    ),
    "missing_effect": Meaning(
        "An effect is missing",
        "The model fails by more than the noise, and adding the effect named here lowers the error on data "
        "that the fit has not seen by more than chance would, and more than any other effect of the "
        "catalogue does.",
        (
            "That the named effect is the physical cause: something outside the catalogue that acts alike on "
            "these logs would be named the same.",
            *_LIMITS,
        ),
    ),
    "indistinguishable": Meaning(
        "Something is missing, and these logs cannot say which effect",
        "The model fails by more than the noise. Several effects repair it equally well on data that the fit "
        "has not seen, so they are reported together instead of one of them being picked by luck.",
        (
            "Which effect of the set is at work; a manoeuvre in which they act differently can show it.",
            *_LIMITS,
        ),
    ),
    "unexplained": Meaning(
        "Something is missing that the catalogue does not explain",
        "The model fails by more than the noise, and what is left after the best effects of the catalogue "
        "still stands above it. The section on what remains says where to look.",
        (
            "What the cause is. Mistakes in the log (clock, units, frames, a sensor) look like this as well.",
            *_LIMITS,
        ),
    ),
    "not_identifiable": Meaning(
        "These logs cannot say",
        "The model fails by more than the noise, and so many effects repair it equally well that these logs "
        "do not say what is missing.",
        ("Which of the effects it is.", *_LIMITS),
    ),
}


_OTHER_VALUES = Meaning(
    "No effect is missing, but values that are held fixed do not fit",
    "With other values in place of some that the vehicle file holds fixed, what the model leaves over on "
    "data that the fit has not seen looks like the noise of the sensors, and no effect of the catalogue "
    "lowers the error by more than chance would.",
    (
        "That those values themselves are wrong: whatever acts like another value would look the same.",
        *_LIMITS,
    ),
)


def meaning(diagnosis: Diagnosis) -> Meaning:
    """What the verdict of a diagnosis says, and what it does not."""
    changed = diagnosis.verdict == "adequate" and diagnosis.freed
    found = _OTHER_VALUES if changed else _MEANINGS[diagnosis.verdict]
    more = []
    if any(run.role == "blocks" for run in diagnosis.runs):
        more.append(
            "How the model does on another day: the data kept aside are blocks of the same runs, not whole "
            "runs (give some with --holdout)."
        )
    return Meaning(found.title, found.says, (*found.not_shown, *more))


def parameter_text(name: str) -> str:
    """A parameter as tables print it: ``X_uabsu`` gives ``X_u|u|``."""
    return re.sub(r"^([XYZKMN]_\w)abs(\w)", r"\1|\2|", name)


def quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """A number with its unit; an en dash where there is none."""
    if value is None:
        return "–"
    number = f"{value:.{digits}g}" if isfinite(value) else "not finite"
    shown = unit_text(unit)
    return (number if shown in ("", "1") else f"{number} {shown}").replace("-", "−", 1 if value < 0 else 0)


def with_error(value: float, error: float | None, unit: str) -> str:
    """A value and its standard error, which has two digits: ``5.124 ± 0.012 kg``."""
    if error is None or not isfinite(error) or not isfinite(value) or error <= 0:
        return quantity(value, unit)
    places = max(0, 1 - floor(log10(error)))
    if places > 8 or error >= 1e5:
        number = f"{value:.4g} ± {error:.2g}"
    else:
        number = f"{value:.{places}f} ± {error:.{places}f}"
    shown = unit_text(unit)
    return (number if shown in ("", "1") else f"({number}) {shown}").replace("-", "−")


def estimate_text(estimate: Estimate) -> str:
    """A parameter with value, standard error and unit."""
    number = with_error(estimate.value, estimate.standard_error, estimate.unit)
    return f"{parameter_text(estimate.name)} = {number}"


def prior_text(estimate: Estimate) -> str:
    """The value that the vehicle file states."""
    if estimate.prior is None:
        return "–"
    return with_error(estimate.prior, estimate.prior_sigma, estimate.unit)


def percent(share: float | None) -> str:
    """A share as per cent."""
    if share is None or not isfinite(share):
        return "–"
    return f"{100 * share:.3g} %".replace("-", "−")
