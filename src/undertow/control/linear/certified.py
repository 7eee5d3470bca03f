"""What the conditions on gains say of a gain set, for designs and for updates."""

from __future__ import annotations

from undertow.control.conditions.check import check
from undertow.control.conditions.result import HOLDS, Report
from undertow.control.conditions.uncertain import Uncertainty
from undertow.control.gains import GainSet

_DERIVED = "derived"


def checked(gains: GainSet) -> Report:
    """The conditions on a gain set with the stated parameters of its vehicle."""
    return check(gains, Uncertainty(gains.plant.vehicle))


def certified(gains: GainSet) -> bool:
    """Whether every condition that is derived from the model holds, with one iota for all."""
    report = check(gains, Uncertainty(gains.plant.vehicle), forms=[_DERIVED], whole=False)
    rows = all(r.verdict == HOLDS for r in report.rows)
    return rows and all(a.verdict == HOLDS for a in report.agreements)


def told(gains: GainSet) -> dict[str, tuple[str, float | None]]:
    """Verdict and margin by condition; the margin only of what is derived from the model."""
    report = checked(gains)
    found: dict[str, tuple[str, float | None]] = {}
    for r in report.rows:
        where = " ".join(filter(None, (r.scope, r.signs)))
        found[f"{r.form} condition {r.condition}, {where}"] = (
            r.verdict,
            r.margin if r.form == _DERIVED else None,
        )
    for a in report.agreements:
        found[f"{a.form} conditions with one iota"] = (a.verdict, None)
    found["certified region"] = (report.region.kind, report.region.level)
    if report.whole is not None:
        found["whole loop"] = (report.whole.verdict, None)
    return found
