"""What a closed loop is made of, where that is not as the files say."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from undertow.control.gains import GainTable, load_gains
from undertow.errors import UndertowError, nearest
from undertow.model.catalogue import catalogue
from undertow.model.vehicle import Value, Vehicle
from undertow.typing import Progress

from .record import Record
from .scenario import Scenario
from .simulate import ClosedLoop

_SWAY_FORCE = "tau_Y"


@dataclass(frozen=True)
class Choices:
    """Changes to what the vehicle file and the gain file say; None leaves what they say.

    Attributes
    ----------
    order, heading, integrators : str, optional
        As in [schedule] of a gain file.
    gate : str, optional
        Error of the heading that opens the gate, with its unit.
    sway : str, optional
        "actuated" gives the vehicle an ideal sway force, "unactuated" leaves that force out.
    current : tuple of float, optional
        Velocity of the water to the north and to the east, m/s; the controller does not know of it.
    """

    order: Literal["together", "yaw-first"] | None = None
    heading: Literal["atan", "atan2"] | None = None
    integrators: Literal["gate", "start"] | None = None
    gate: str | None = None
    sway: Literal["actuated", "unactuated"] | None = None
    current: tuple[float, float] | None = None

    def loop(
        self,
        gains: str | Path,
        vehicle: Vehicle,
        plant: Vehicle | None = None,
        *,
        compiled: bool | None = None,
    ) -> ClosedLoop:
        """A closed loop with these choices.

        Parameters
        ----------
        gains : str or Path
            Gain file, or the name of a bundled set.
        vehicle : Vehicle
            The vehicle that the controller knows.
        plant : Vehicle, optional
            The vehicle that moves; by default the same.
        compiled : bool, optional
            As for `ClosedLoop`.

        Raises
        ------
        UndertowError
            If a file is none, or vehicle, gains and choices do not fit.
        """
        known = self.with_sway(vehicle)
        moving = self.in_current(self.with_sway(plant) if plant else known)
        return ClosedLoop(load_gains(gains, known, self.changed), moving, compiled=compiled)

    def changed(self, table: GainTable) -> GainTable:
        """A gain file with these choices."""
        names = ("order", "heading", "integrators", "gate")
        wanted = {n: getattr(self, n) for n in names if getattr(self, n) is not None}
        left_out = [d for d in table.unactuated if d != "sway" or self.sway is None]
        if self.sway == "unactuated":
            left_out.append("sway")
        schedule = table.schedule.model_copy(update=wanted)
        return table.model_copy(update={"schedule": schedule, "unactuated": left_out})

    def with_sway(self, vehicle: Vehicle) -> Vehicle:
        """The vehicle with a sway force if there is to be one.

        Raises
        ------
        UndertowError
            If it does not move sideways.
        """
        if self.sway != "actuated" or _SWAY_FORCE in vehicle.force_channels:
            return vehicle
        if "sway" not in vehicle.degrees_of_freedom:
            raise UndertowError(f"vehicle '{vehicle.name}' has no sway that could be actuated")
        return replace(vehicle, force_channels=(*vehicle.force_channels, _SWAY_FORCE))

    def in_current(self, vehicle: Vehicle) -> Vehicle:
        """The vehicle in the current if there is to be one."""
        if self.current is None:
            return vehicle
        values = dict(zip(("V_N", "V_E"), map(Value, self.current), strict=True))
        return vehicle.with_effect(catalogue()["ocean_current"], values)


def without(vehicle: Vehicle, ids: Sequence[str]) -> Vehicle:
    """The vehicle with some of its effects left out.

    Raises
    ------
    UndertowError
        If it does not have one of them, or another one needs it.
    """
    present = [e.id for e in vehicle.effects]
    for wanted in ids:
        if wanted not in present:
            raise UndertowError(
                f"effect '{wanted}' cannot be left out, '{vehicle.name}' does not have it"
                f"{nearest(wanted, present)}: it has {', '.join(present)}"
            )
    return replace(vehicle, effects=tuple(e for e in vehicle.effects if e.id not in ids))


def simulate(
    vehicle: Vehicle,
    gains: Sequence[str],
    scenario: Scenario,
    choices: Choices,
    *,
    plant: Vehicle | None = None,
    progress: Progress = lambda done, words: None,
) -> list[Record]:
    """A run with every gain file; `progress` is told the seconds that are done, all runs together."""

    def run(place: int, name: str) -> Record:
        before = place * scenario.duration
        loop = choices.loop(name, vehicle, plant)
        return loop.run(scenario, lambda done, words: progress(before + done, words))

    return [run(i, name) for i, name in enumerate(gains)]
