"""What a vehicle file leaves open: parameters that are missing, assumed, or without influence."""

from __future__ import annotations

from collections.abc import Iterator

from .effect import Effect
from .parameter import DerivativeMatrix, declared
from .symbols import DOFS
from .vehicle import Vehicle


def hints(vehicle: Vehicle) -> list[str]:
    """One line for everything that a reader of the vehicle should know is not there.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle as its file has it.

    Returns
    -------
    list of str
        For instance "added_mass has no Y_vdot although sway is a degree of freedom: it counts as zero".
    """
    sources = (_missing_entries, _undamped, _absent_companions, _without_influence, _assumed)
    return [line for source in sources for line in source(vehicle)]


def diagonal_entries(effect: Effect) -> dict[int, str]:
    """Names of the coefficients that an effect has for the force of each motion on itself, by motion."""
    found = {}
    for declaration in declared(type(effect)):
        if isinstance(declaration, DerivativeMatrix):
            pairs = zip(declaration.entries, declaration.expand(()), strict=True)
            found.update({i: p.name for (i, j), p in pairs if i == j})
    return found


def _given(vehicle: Vehicle, name: str) -> bool:
    return bool(vehicle.values_of(vehicle.declared_parameters[name]))


def _missing_entries(vehicle: Vehicle) -> Iterator[str]:
    for effect in vehicle.effects:
        entries = diagonal_entries(effect)
        missing = [i for i in vehicle.dof_indices if i in entries and not _given(vehicle, entries[i])]
        if missing:
            names, motions = ", ".join(entries[i] for i in missing), ", ".join(DOFS[i] for i in missing)
            are, they = ("is a degree", "it counts") if len(missing) == 1 else ("are degrees", "they count")
            yield f"{effect.id} has no {names} although {motions} {are} of freedom: {they} as zero"


def _undamped(vehicle: Vehicle) -> Iterator[str]:
    damped = {
        i
        for effect in vehicle.effects
        if effect.family == "damping"
        for i, name in diagonal_entries(effect).items()
        if _given(vehicle, name)
    }
    for i in vehicle.dof_indices:
        if i not in damped:
            yield f"nothing damps {DOFS[i]}"


def _absent_companions(vehicle: Vehicle) -> Iterator[str]:
    present = {e.id for e in vehicle.effects}
    turns = bool({3, 4, 5} & set(vehicle.dof_indices)) and len(vehicle.dof_indices) > 1
    for inertia in ("rigid_body", "added_mass"):
        if turns and inertia in present and f"{inertia}_coriolis" not in present:
            yield f"{inertia}_coriolis is absent although the vehicle turns: forces in turns are left out"
    tilts = [DOFS[i] for i in (3, 4) if i in vehicle.dof_indices]
    if tilts and "restoring" not in present:
        yield f"restoring is absent: nothing brings {' and '.join(tilts)} back to level"
    if 2 in vehicle.dof_indices and not present & {"restoring", "net_buoyancy"}:
        yield "neither restoring nor net_buoyancy is there: weight and buoyancy count as equal"


def _without_influence(vehicle: Vehicle) -> Iterator[str]:
    silent = [n for n, v in vehicle.values.items() if n not in vehicle.parameter_names and v.value]
    if silent:
        yield f"without influence in these degrees of freedom: {', '.join(silent)}"


def _assumed(vehicle: Vehicle) -> Iterator[str]:
    names = [n for n, v in vehicle.values.items() if v.assumed]
    if names:
        yield f"assumed, without a source of their own: {', '.join(names)}"
