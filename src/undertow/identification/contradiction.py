"""What in the forces speaks against effects that would be named where more than noise is left."""

from __future__ import annotations

from collections.abc import Sequence

from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.weak_form import WeakFit
from undertow.model.vehicle import Vehicle

from .diagnosis.consistency import knows_time, own_variables, states_time
from .diagnosis.evidence import FoundEffect
from .diagnosis.residual import remaining, unknown_to
from .diagnosis.result import Remaining
from .diagnosis.rounds import try_all
from .diagnosis.selection import size_beside
from .diagnosis.trial import Bench
from .diagnosis.validation import SimulationValidator
from .diagnosis.verdict import ONLY_SIMULATIONS, share_explained
from .report.scaffold import effect_of


def contradiction(
    found: Sequence[FoundEffect],
    fits: tuple[WeakFit, WeakFit],
    bench: Bench,
    validator: SimulationValidator,
) -> str:
    """Why effects are not established as the cause, in words; empty where no force speaks against them.

    Of the sensors forces say nothing.

    fits: the models without them and with them.
    """
    if all(f.of_sensors for f in found):
        return ""
    without, with_them = (bench.judge(f) for f in fits)
    if share_explained((without, with_them), bench.noise_level, bench) <= 0.0:
        return ONLY_SIMULATIONS
    return _hardly_there(found, validator.final(fits[0])[0], bench, validator)


def _unknown_to(found: Sequence[FoundEffect], left: list[Remaining], vehicle: Vehicle) -> list[Remaining]:
    """What of residual forces depends on more than effects know."""
    grown = [(f.trial.candidate, vehicle, f.trial.fit.model.functions.vehicle) for f in found]
    own = {name for of in grown for name in own_variables(*of)}
    own |= {"t"} if any(knows_time(*of) for of in grown) else set()
    return unknown_to(own, left, vehicle, periodic=any(states_time(*vehicles) for _, *vehicles in grown))


def _hardly_there(
    found: Sequence[FoundEffect], before: Fitted, bench: Bench, validator: SimulationValidator
) -> str:
    """Whether effects lose their size beside a force made of what the model leaves, in words; empty if not.

    It is the force that `undertow effects new` makes, of what the effects do not know, found on the training
    data. What only stood in for such a force is hardly there beside it, what is the cause stays.
    """
    left = _unknown_to(found, remaining(before, bench.train, bench.train), before.model.functions.vehicle)
    if not left:
        return ""
    effect = effect_of(left, max(float(r.t[-1] - r.t[0]) for r in bench.train.runs))
    other = try_all(bench, {effect.id: effect}, lambda done, words: None).findings[0]
    size = size_beside(found, other, bench, validator) if other.trial.kept else 1.0
    if size >= 1.0 - bench.settings.size_spread:
        return ""
    return (
        f"beside {effect.about().rstrip('.')} its size would drop to {max(size, 0.0):.0%} of the fitted "
        "value (undertow effects new makes an effect of that force)"
    )
