"""A vehicle file out of the coefficients of a tank."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from undertow.model.symbols import DOFS
from undertow.shape.first import EffectTable, entry_line, vehicle_text

from .coefficients import EFFECTS, Coefficient
from .settings import Tank


def tank_vehicle(tank: Tank, found: Sequence[Coefficient], name: str) -> str:
    """The text of a vehicle file with the motions that were tested.

    Mass and moments of inertia are those of the tank; values of both directions stand in it where the hull
    was tested in both.
    """
    motions = tuple(d for d in DOFS if any(c.motion == d for c in found))
    turns = [EffectTable("rigid_body_coriolis", []), EffectTable("added_mass_coriolis", [])]
    tables = [EffectTable("rigid_body", list(_rigid_body(tank, motions))), *tested(found)]
    return vehicle_text(
        made_from=f"a virtual towing tank with {tank.hull} (sha256 {tank.sha256})",
        about=[
            "The hull was moved in one motion at a time: couplings between motions were not tested.",
            "Weight and buoyancy are taken as equal; thrusters and all other forces are missing.",
        ],
        name=name,
        description=f"{name} as tested in a virtual towing tank, {', '.join(motions)}",
        source=f"virtual towing tank, {tank.hull}",
        degrees_of_freedom=motions,
        density=tank.density,
        tables=[t for t in tables if t.entries] + (turns if len(motions) > 1 else []),
    )


def tested(found: Sequence[Coefficient]) -> list[EffectTable]:
    """Added mass and damping that were found, one table for each effect."""
    return [EffectTable(effect, list(_entries(found, effect))) for effect in EFFECTS]


def _rigid_body(tank: Tank, motions: Sequence[str]) -> Iterator[str]:
    yield entry_line("m", tank.mass, "kg", source="as stated")
    for motion, axis in (("roll", "x"), ("pitch", "y"), ("yaw", "z")):
        if motion in motions:
            inertia = next(case.inertia for case in tank.cases if case.motion == motion)
            yield entry_line(f"I_{axis}", inertia, "kg m^2", source="as in the tank")


def _entries(found: Sequence[Coefficient], effect: str) -> Iterator[str]:
    own = [c for c in found if c.effect == effect]
    for name in dict.fromkeys(c.name for c in own):
        first, *others = [c for c in own if c.name == name]
        yield entry_line(
            name,
            -first.value,
            first.unit,
            backward=-others[0].value if others else None,
            sigma=max(c.sigma for c in (first, *others)),
            estimate=True,
            source=first.source + (f"; {first.way} only" if first.direction and not others else ""),
        )
