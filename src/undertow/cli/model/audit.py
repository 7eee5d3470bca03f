"""Find errors in the equations of the mini-AUV paper, or of a vehicle.

Without a vehicle, the equations of the paper are compared with those that follow from the effects: the sign
of the Coriolis matrix (11), the power balance, (8) against (9), the units of the conditions on PID gains, and
parameters that are needed but not given. Every finding comes with the computation that shows it. For the
paper's tables of estimates, use audit-tables.

With a vehicle, its own equations are checked: a symmetric and positive definite mass matrix, Coriolis forces
that do no work, damping that dissipates energy, effects without their counterpart, assumed values.

    undertow audit
    undertow audit rov.toml

The exit code is 1 if something is wrong, so that a pipeline stops; items that are only missing or assumed
("open") do not count.
"""

from __future__ import annotations

from typing import Annotated

import typer

from .._options import EffectsOption, JsonOption
from .._terminal import console, print_json, progress, say, section, text

_VEHICLE = typer.Argument(
    metavar="VEHICLE",
    help="Vehicle file (TOML), or the name of a bundled vehicle; the paper's equations without one.",
)


def audit(
    vehicle: Annotated[str | None, _VEHICLE] = None,
    json: JsonOption = False,
    effects: EffectsOption = None,
) -> int:
    from dataclasses import asdict

    from undertow.model.loading import load_vehicle
    from undertow.paper.equations import audit_paper, audit_vehicle

    with progress("auditing the equations", None):
        found = audit_vehicle(load_vehicle(vehicle, effect_files=effects or [])) if vehicle else audit_paper()
    wrong = sum(finding.kind == "wrong" for finding in found)
    if json:
        print_json([asdict(finding) for finding in found])
        return int(wrong > 0)
    for kind, title in (("wrong", "Wrong"), ("open", "Open")):
        own = [finding for finding in found if finding.kind == kind]
        if own:
            section(title)
        for finding in own:
            say(f"  {finding.where}: {finding.text}")
            say(f"    {finding.evidence}", "dim")
    what = vehicle or "the equations of the paper (its tables: undertow audit-tables)"
    say(f"{wrong} wrong, {len(found) - wrong} open in {what}")
    return int(wrong > 0)


def audit_tables(json: JsonOption = False) -> int:
    """Check the paper's printed tables of estimates for numbers that contradict each other.

    Tables A1 to A6 of the mini-AUV paper are bundled as printed, with the values that its Table 4 takes from
    them. The check finds repeated rows, values whose sign changes between tables, values far from the trend
    of the other cases, digits of another table, a case that the stated rule does not select, sums that do not
    add up, values within their error of zero, and unphysical estimates.

    As with audit, the exit code is 1 if something is found, so that a pipeline stops.
    """
    from dataclasses import asdict

    from undertow.paper.tables import KINDS, appendix, audit

    with progress("auditing the tables", None):
        found = audit(appendix())
    if json:
        print_json([asdict(remark) for remark in found])
        return int(bool(found))
    for kind, meaning in KINDS.items():
        own = [remark for remark in found if remark.kind == kind]
        if own:
            section(meaning)
            for remark in own:
                say(f"  {remark.where}: {remark.text}")
    console().print(text(f"{len(found)} remarks on {len(appendix().tables)} tables"))
    return int(bool(found))
