"""A plan as the table of commands that is flown."""

from __future__ import annotations

import math

import numpy as np

from .parameters import Planned

_DIGITS = 6


def command_csv(planned: Planned) -> str:
    """The commands as CSV: t in s, then each command in its unit, named as in the vehicle file.

    Numbers are cut off towards zero, so that none passes its limit.
    """
    commands, flight = planned.plan.commands, planned.flight
    columns = [[f"{t:.9g}" for t in flight.t]]
    for i, command in enumerate(commands):
        places = max(_DIGITS - 1 - math.floor(math.log10(command.limit)), 0)
        cut = np.trunc(flight.u[:, i] * 10.0**places) / 10.0**places
        columns.append([f"{value:.{places}f}" for value in (cut + 0.0).tolist()])
    head = ",".join(["t", *(c.name for c in commands)])
    return "\n".join([head, *(",".join(row) for row in zip(*columns, strict=True))]) + "\n"
