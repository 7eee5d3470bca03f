"""One sentence on what would tell models apart, for a diagnosis that cannot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from undertow.model.catalogue import Catalogue
from undertow.model.vehicle import Vehicle

from ..logs import Run
from .rivals import RivalSpec
from .separate import SEPARATED, plan_separation
from .setting import Request

# Little: a look at every family and some refinement of the best.
_TRIES = 60


def suggest(
    vehicle: Vehicle,
    ids: Sequence[str],
    runs: Sequence[Run],
    values: Mapping[str, Mapping[str, float]] | None = None,
    *,
    known: Catalogue | None = None,
    tries: int = _TRIES,
) -> str:
    """Say which kind of manoeuvre would tell effects apart, within the commands and motions of the logs.

    Parameters
    ----------
    vehicle : Vehicle
        The model without the effects.
    ids : sequence of str
        Effects (joined by + where a model has several); "none" is the model without any.
    runs : sequence of Run
        Logs that cannot tell.
    values : mapping, optional
        Values found for the parameters of each effect, by id, SNAME signs: where the fits begin.
    known : mapping, optional
        Effects by id.
    tries : int
        Manoeuvres that are looked at.

    Raises
    ------
    UndertowError
        If there are fewer than two models, or no manoeuvre is within the limits.
    """
    specs = [RivalSpec(name, (values or {}).get(name, {})) for name in ids]
    plan = plan_separation(vehicle, specs, runs, Request(tries=tries), known=known).plan
    apart = min(plan.separations, key=lambda s: s.deviations)
    between = " and ".join(apart.pair)
    if apart.deviations < SEPARATED:
        return (
            f"No manoeuvre of {plan.duration:g} s that was tried would tell {between} apart: the best leaves "
            f"them {apart.deviations:.2g} standard deviations from each other."
        )
    now = "" if apart.deviations_now is None else f" (these logs: {_plainly(apart.deviations_now)})"
    return (
        f"{plan.manoeuvre[0].upper()}{plan.manoeuvre[1:]} for {plan.duration:g} s would set {between} "
        f"{_plainly(apart.deviations)} standard deviations apart{now}; write it with undertow plan "
        f"--goal separate --between {','.join(ids)}."
    )


def _plainly(value: float) -> str:
    return f"{value:.2g}" if value < 10 else f"{value:.0f}"
