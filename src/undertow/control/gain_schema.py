"""The gain file as pydantic sees it."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, StrictStr

from undertow.model.symbols import DOFS, POSE
from undertow.model.vehicle_schema import FileTable, Identifier, Quantity

Coordinate = Literal[POSE]  # type: ignore[valid-type]
Diagonal = dict[Coordinate, Quantity] | list[Quantity] | Quantity
"""One gain for each pose coordinate by name, in the vehicle's order, or the same one for all."""


class ScheduleTable(FileTable):
    """In which order the coordinates are driven to their set-points.

    Attributes
    ----------
    order : str
        "together", or "yaw-first": x and y wait until the heading has come within `gate` once.
    gate : quantity
        Error of the heading that opens the gate, rad.
    heading : str
        How the heading to a set-point without psi is worked out: by "atan2", or by "atan" as (42) of the
        mini-AUV paper prints it, which drives backwards to what lies behind.
    integrators : str
        When the integrals of x and y begin: at the "gate", or at the "start".
    """

    order: Literal["together", "yaw-first"] = "together"
    gate: Quantity = "1 deg"
    heading: Literal["atan2", "atan"] = "atan2"
    integrators: Literal["gate", "start"] = "gate"


class AllocationTable(FileTable):
    """How a wanted force is shared among the thrusters.

    Attributes
    ----------
    weights : dict of str
        Price of the squared command of a thruster beside the others, 1 unless stated.
    limits : dict of str
        Largest magnitude of a thruster's command; the vehicle file's unless stated.
    anti_windup : str
        "hold" stops an integral that pushes further into a limit; "none" lets it run.
    """

    weights: dict[Identifier, float] = Field(default_factory=dict)
    limits: dict[Identifier, Quantity] = Field(default_factory=dict)
    anti_windup: Literal["hold", "none"] = "hold"


class GainTable(FileTable):
    """The whole file.

    Attributes
    ----------
    unactuated : list of str
        Degrees of freedom whose force, if the law wants one, is knowingly left out for want of a thruster.
    """

    schema_: Annotated[Literal["undertow/gains/1"], Field(alias="schema")]
    name: Annotated[StrictStr, Field(min_length=1, max_length=80)]
    description: StrictStr = ""
    source: StrictStr = ""
    law: StrictStr
    gains: dict[Identifier, Diagonal]
    unactuated: list[Literal[DOFS]] = Field(default_factory=list)  # type: ignore[valid-type]
    schedule: ScheduleTable = Field(default_factory=ScheduleTable)
    allocation: AllocationTable = Field(default_factory=AllocationTable)
