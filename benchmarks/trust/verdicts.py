"""What counts as right."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

NAMING = ("missing_effect", "indistinguishable", "not_identifiable")


@dataclass(frozen=True)
class Answer:
    """What a diagnosis said.

    verdict: its verdict.
    named: effects that it says are missing.
    sets: effects that it says cannot be told apart.
    ranking: its candidates, best first.
    """

    verdict: str
    named: list[str] = field(default_factory=list)
    sets: list[list[str]] = field(default_factory=list)
    ranking: list[str] = field(default_factory=list)

    @property
    def reported(self) -> set[str]:
        """All effects it names, alone or in a set."""
        return {*self.named, *(effect for group in self.sets for effect in group)}

    @property
    def claims(self) -> bool:
        """Whether it says of any effect that it is missing."""
        return bool(self.named)

    def only(self, accepted: Collection[str]) -> bool:
        """Whether it names what is accepted and nothing else, be it as a set of equivalent effects."""
        return self.verdict in NAMING and bool(self.named) and self.reported <= set(accepted)

    def place(self, accepted: Collection[str]) -> int | None:
        """Place in the ranking of the first accepted effect, from 1."""
        return next((i for i, effect in enumerate(self.ranking, 1) if effect in accepted), None)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def accepted(effect: str, motions: Sequence[str], parameters: Collection[str] = ()) -> set[str]:
    """An effect and those that are, for this vehicle, the very same equations.

    Without roll and pitch the body's z axis is that of NED: net buoyancy is a constant heave force. There,
    and in still water, water in the hull (m_w at x_w) is the same inertia and Coriolis force as added mass
    with the coupling Y_rdot = -m_w x_w, once X_udot, Y_vdot, Z_wdot and N_rdot are refitted.
    """
    level = not {"roll", "pitch"} & set(motions)
    if level and effect == "entrained_water":
        return {effect, *holding(effect, motions)}
    if level and effect == "added_mass_coupling" and set(parameters) == {"Y_rdot"}:
        return {effect, "entrained_water"}
    upright = "heave" in motions and level
    if upright and effect == "net_buoyancy":
        return {effect, "constant_force"}
    if upright and effect == "constant_force" and set(parameters) == {"Z_0"}:
        return {effect, "net_buoyancy"}
    return {effect}


def holding(effect: str, motions: Sequence[str]) -> set[str]:
    """Effects of which this one is a special case, so that no data let it be told from them.

    Water in the hull has a symmetric inertia matrix and the Coriolis force that goes with it, in still water
    as added mass has: its diagonal is that of X_udot and the like, the rest that of `added_mass_coupling`.
    """
    coupled = {"sway", "yaw"} <= set(motions)
    return {"added_mass_coupling"} if coupled and effect == "entrained_water" else set()
