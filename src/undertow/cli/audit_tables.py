"""Check the paper's printed tables of estimates for numbers that contradict each other.

Tables A1 to A6 of the paper on the mini-AUV come with undertow as they were printed, with what its Table 4
took from them. Found are repeated rows, values that change their sign on the way, values far from the trend
of the other cases, digits of another table, a case that its own rule does not take, sums that do not add up,
values within their error of zero, and estimates that are not physical.

The exit code is 1 where something is found, as that of audit is, so that a pipeline stops.
"""

from __future__ import annotations

from ._options import JsonOption
from ._terminal import console, print_json, progress, say, section, text


def audit_tables(json: JsonOption = False) -> int:
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
