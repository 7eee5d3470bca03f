"""Plausibility of a whole vehicle, and what is missing or assumed in its file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import hypot, inf, isfinite

import sympy as sm

from undertow.errors import UndertowError

from .catalogue import catalogue
from .effect import Effect, VehicleSize
from .parameter import DerivativeMatrix, Limits, Range, declared, logged
from .symbols import CHANNELS, DOFS, FORCE, failing_pivot, symbol
from .vehicle import Thruster, Value, Vehicle

_LIMITS = Limits()


@dataclass(frozen=True)
class CheckSettings:
    """How the statements and equations of a vehicle are checked."""

    # Share of the trace of a mass matrix down to which a negative pivot is rounding.
    rounding: float = 1e-12
    zero: float = 1e-9  # m or N, below which two statements that should be zero are
    # Velocities at which every vehicle must have equations, m/s and rad/s: at rest, and creeping either way.
    creeping: tuple[float, ...] = (0.0, 0.1, -0.1)


SETTINGS = CheckSettings()


def check_vehicle(vehicle: Vehicle) -> None:
    """Refuse a vehicle that is physically impossible, or whose equations have no value."""
    _check_environment(vehicle)
    _check_forces(vehicle)
    _check_complete(vehicle)
    _check_defined(vehicle)
    for complaint in _complaints(vehicle):
        raise UndertowError(complaint)
    _check_inertia(vehicle)


def _complaints(vehicle: Vehicle) -> Iterator[str]:
    # What the file states and the equations use, and water and gravity; SI and SNAME signs.
    used, values = set(vehicle.parameter_names), vehicle.values
    known = {n: v.value for n, v in values.items() if n in used or v.value != 0.0} | dict(vehicle.environment)
    size = next((b for e in vehicle.effects if (b := e.vehicle_size(known)) is not None), None)
    for name, value in values.items():
        yield from _out_of_range(_place(vehicle, name), value.value, (0.0, _LIMITS.largest))
        yield from _sigma(_place(vehicle, name), value)
    moved = {n for n, v in values.items() if v.estimate}
    for effect in vehicle.effects:
        for complaint in effect.impossible(known, _LIMITS, moved):
            yield f"[effects.{effect.id}] {complaint}"
    yield from _thrusters(vehicle, size)
    if size is not None:
        yield from _places(vehicle, size)


def _check_environment(vehicle: Vehicle) -> None:
    for key, name, unit, hint in (
        ("water_density", "rho", "kg/m^3", "1 g/cm^3 is 1000 kg/m^3"),
        ("gravity", "g", "m/s^2", "981 cm/s^2 is 9.81 m/s^2"),
    ):
        value, (low, high) = vehicle.environment[name], getattr(_LIMITS, key)
        if not low <= value <= high:
            raise UndertowError(
                f"{key} = {value:g} {unit} is impossible (possible: {low:g} to {high:g}): correct the "
                f"number or its unit; {hint}"
            )


# --- numbers --------------------------------------------------------------------------------------
def _place(vehicle: Vehicle, name: str) -> str:
    return f"{_table(vehicle, name)} {name}"


def _table(vehicle: Vehicle, name: str) -> str:
    parameter = vehicle.parameter_of(name)
    owners = (e.id for e in vehicle.effects if parameter in e.parameters)
    return f"[effects.{next(owners, 'none')}]"


def _out_of_range(place: str, value: float, limits: Range, unit: str = "") -> Iterator[str]:
    low, high = limits
    if not (isfinite(value) and low <= abs(value) <= high):
        yield (
            f"{place} = {f'{value:g} {unit}'.strip()} is impossible (possible: {low:g} to {high:g} in "
            "size): correct the number or its unit"
        )


def _sigma(place: str, value: Value) -> Iterator[str]:
    # None: not stated. A fit to data without noise finds zero, one to no data infinity.
    if value.sigma is not None and 0 < value.sigma < inf:
        yield from _out_of_range(f"{place} sigma", value.sigma, _LIMITS.sigma)


# --- thrusters ------------------------------------------------------------------------------------
def _thrusters(vehicle: Vehicle, size: VehicleSize | None) -> Iterator[str]:
    for thruster in vehicle.thrusters:
        place, thrust = f"thruster '{thruster.name}'", thruster.thrust_per_command
        # Rounding leaves 1e-17 where a cosine is zero, so it is the largest entry that cannot be small.
        yield from _out_of_range(
            f"{place} wrench, its largest entry", max(thruster.wrench, key=abs), _LIMITS.thrust
        )
        if thrust.value:  # none at rest is right for a rudder or a fin: what it gives is rudder_force
            yield from _out_of_range(f"{place} thrust_per_command", thrust.value, _LIMITS.thrust, "N")
        yield from _sigma(f"{place} thrust_per_command", thrust)
        if thruster.limit is not None:
            yield from _out_of_range(f"{place} limit", thruster.limit, _LIMITS.command)
        if size is not None and thruster.law is None:
            yield from _excessive_thrust(thruster, size.mass)


def _excessive_thrust(thruster: Thruster, mass: float) -> Iterator[str]:
    command = 1.0 if thruster.limit is None else thruster.limit
    force = hypot(*thruster.wrench[:3]) * thruster.thrust_per_command.value * command
    if force / mass > _LIMITS.acceleration and not thruster.thrust_per_command.estimate:
        yield (
            f"thruster '{thruster.name}' pushes with {force:g} N at a command of {command:g}, which is "
            f"{force / mass:.3g} m/s^2 for {mass:g} kg (possible: up to {_LIMITS.acceleration:g}): correct "
            f"its wrench, thrust_per_command or limit"
        )


# --- places ---------------------------------------------------------------------------------------
def _places(vehicle: Vehicle, size: VehicleSize) -> Iterator[str]:
    extent = max(size.length, size.gyration)
    for place, arm in _lever_arms(vehicle):
        if abs(arm) > _LIMITS.farthest * extent:
            yield (
                f"{place} is {abs(arm):.3g} m off the body origin of a vehicle of {size.mass:g} kg (limit "
                f"{_LIMITS.farthest * extent:.3g} m): lengths are in m, or have a unit, such as '160 mm'"
            )


def _lever_arms(vehicle: Vehicle) -> Iterator[tuple[str, float]]:
    """Distances from the body origin that the file states, m; a fitted one may be anywhere."""
    for thruster in vehicle.thrusters:
        force, moment = hypot(*thruster.wrench[:3]), hypot(*thruster.wrench[3:])
        if force:
            yield f"thruster '{thruster.name}'", moment / force
    for surface in vehicle.surfaces:
        yield f"surface '{surface.name}'", hypot(*surface.position)
    for name, value in vehicle.values.items():
        of = getattr(vehicle.parameter_of(name), "arm_of", "")
        whole = 1.0 if of == "1" else vehicle.value_of(of).value if of else 0.0
        if whole and not value.estimate:
            yield _place(vehicle, name), value.value / whole


def _check_forces(vehicle: Vehicle) -> None:
    for channel in vehicle.force_channels:
        dof = DOFS[FORCE.index(channel.removeprefix("tau_"))]
        if dof not in vehicle.degrees_of_freedom:
            raise UndertowError(
                f"generalised_forces has {channel}, but {dof} is not a degree of freedom: add {dof} or "
                "remove it"
            )


def _check_complete(vehicle: Vehicle) -> None:
    for name in vehicle.parameter_names:
        parameter = vehicle.declared_parameters.get(name)
        if parameter is not None and parameter.must_be_given and name not in vehicle.values:
            pairs = zip(("from", "to"), parameter.bounds, strict=True)
            limits = " ".join(f"{word} {v:g}" for word, v in pairs if isfinite(v))
            raise UndertowError(
                f"{_table(vehicle, name)} lacks {name} ({parameter.about}): give it in {parameter.unit}"
                f"{f', {limits}' if limits else ''}"
            )
    if not vehicle.mass_matrix.free_symbols:
        raise UndertowError("the vehicle has no inertia: add [effects.rigid_body]")


def _check_defined(vehicle: Vehicle) -> None:
    """Refuse equations without a finite value: division by zero, the root of a negative velocity."""
    known = {symbol(n): sm.Float(vehicle.value_of(n).value) for n in vehicle.parameter_names}
    nu = set(vehicle.composition.nu)
    creeping = {speed: known | dict.fromkeys(nu, sm.Float(speed)) for speed in SETTINGS.creeping}
    for what, part in _equation_parts(vehicle):
        # What no velocity is in is the same at all of them.
        for speed in SETTINGS.creeping if nu & part.free_symbols else SETTINGS.creeping[:1]:
            if not all(isfinite(_number(row, creeping[speed])) for row in part):
                moving = f"with all velocities at {speed:g}" if speed else "at rest"
                raise UndertowError(
                    f"{what} of vehicle '{vehicle.name}' has no finite value {moving}: look for a division "
                    "by a parameter of zero, or run 'undertow effects check' on an effect of your own"
                )


def _equation_parts(vehicle: Vehicle) -> Iterator[tuple[str, sm.Matrix]]:
    c = vehicle.composition
    output, rates, _ = c.chain
    yield from ((f"the force of {effect.id}", wrench) for effect, wrench in c.wrenches.items())
    yield "the commands that reach thrusters and surfaces", output
    states = {**rates, **c.wrench_states}
    yield from ((f"the rate of {state}", sm.Matrix([rate])) for state, rate in states.items())
    yield from ((f"the reported {what}", m) for what, m in zip(("pose", "velocity"), c.reported, strict=True))


def _number(expression: sm.Expr, known: Mapping[sm.Symbol, sm.Expr]) -> float:
    zero = sm.Float(0)
    try:
        return float(expression.xreplace({x: known.get(x, zero) for x in expression.free_symbols}))
    except TypeError:  # complex infinity, or a complex number
        return inf


def _check_inertia(vehicle: Vehicle) -> None:
    """Static moments and products of inertia have no bounds of their own; the whole matrix has."""
    for direction, way in ((1, "forward"), (-1, "backward")):
        rows = mass_matrix_at(vehicle, direction)
        trace = sum(rows[i][i] for i in range(len(rows)))
        pivot = failing_pivot(rows, -SETTINGS.rounding * abs(trace))
        if pivot is not None:
            dof, value = vehicle.degrees_of_freedom[pivot], rows[pivot][pivot]
            if value == 0:
                raise UndertowError(
                    f"nothing has inertia in {dof}: add it to [effects.rigid_body] or leave {dof} out"
                )
            raise UndertowError(
                f"the mass matrix is not positive definite in {way} motion: its entry for {dof}, {value:g}, "
                "is too small for its couplings; check centre of gravity, inertias and added mass"
            )


def mass_matrix_at(vehicle: Vehicle, direction: int = 1) -> list[list[float]]:
    """Mass matrix (kg, kg m, kg m^2) at the values, upright, moving at `direction` m/s, rad/s on all axes."""
    matrix = vehicle.mass_matrix
    values = {symbol(n): sm.Float(vehicle.value_of(n).value) for n in vehicle.parameter_names}
    values |= dict.fromkeys(vehicle.composition.nu, sm.Integer(direction))
    values |= {x: sm.Integer(0) for x in matrix.free_symbols if x not in values}
    # In one go, where `subs` would put in one symbol after the other.
    return [[float(x) for x in row] for row in matrix.xreplace(values).tolist()]


def hints(vehicle: Vehicle) -> list[str]:
    """One line for each missing or assumed item that a reader of the vehicle should know.

    For instance "added_mass has no Y_vdot although sway is a degree of freedom: it counts as zero".
    """
    sources = (_missing_entries, _undamped, _absent_companions)
    lines = [line for source in sources for line in source(vehicle)]
    values = vehicle.values
    silent = [n for n, v in values.items() if n not in vehicle.parameter_names and v.value]
    lines += [f"has no influence in these degrees of freedom: {', '.join(silent)}"] if silent else []
    assumed = [n for n, v in values.items() if v.assumed]
    source = [f"assumed, without a source: {', '.join(assumed)}"] if assumed else []
    return [*lines, *_unused_inputs(vehicle), *source]


def diagonal_entries(effect: Effect) -> dict[int, str]:
    """Names of the coefficients that an effect has for the force of each motion on itself, by motion."""
    found = {}
    for declaration in declared(type(effect)):
        if isinstance(declaration, DerivativeMatrix):
            pairs = zip(declaration.entries, declaration.expand(()), strict=True)
            found.update({i: p.name for (i, j), p in pairs if i == j})
    return found


def _is_stated(vehicle: Vehicle, name: str) -> bool:
    return bool(vehicle.values_of(vehicle.declared_parameters[name]))


def _missing_entries(vehicle: Vehicle) -> Iterator[str]:
    for effect in vehicle.effects:
        entries = diagonal_entries(effect)
        missing = [i for i in vehicle.dof_indices if i in entries and not _is_stated(vehicle, entries[i])]
        if missing:
            names, motions = ", ".join(entries[i] for i in missing), ", ".join(DOFS[i] for i in missing)
            are, they = ("is a degree", "it counts") if len(missing) == 1 else ("are degrees", "they count")
            yield f"{effect.id} has no {names} although {motions} {are} of freedom: {they} as zero"


def _undamped(vehicle: Vehicle) -> Iterator[str]:
    damping, damped = [e for e in vehicle.effects if e.family == "damping"], set[int]()
    for effect in damping:
        damped |= {i for i, name in diagonal_entries(effect).items() if _is_stated(vehicle, name)}
    for effect, wrench in vehicle.composition.wrenches.items():
        if effect.family == "damping" and not diagonal_entries(effect):  # of strips, or by lift
            own = {symbol(p.name) for p in effect.parameters if p.name in vehicle.values}
            rows = zip(vehicle.dof_indices, wrench, strict=True)
            damped |= {i for i, row in rows if row.free_symbols & own}
    for i in vehicle.dof_indices:
        if i not in damped:
            yield f"nothing damps {DOFS[i]}"


def _absent_companions(vehicle: Vehicle) -> Iterator[str]:
    present = {e.id for e in vehicle.effects}
    turns = bool({3, 4, 5} & set(vehicle.dof_indices)) and len(vehicle.dof_indices) > 1
    for inertia in ("rigid_body", "added_mass"):
        if turns and inertia in present and f"{inertia}_coriolis" not in present:
            yield f"{inertia}_coriolis is absent although the vehicle turns: Coriolis forces are missing"
    tilts = [DOFS[i] for i in (3, 4) if i in vehicle.dof_indices]
    if tilts and "restoring" not in present:
        yield f"restoring is absent: nothing returns {' and '.join(tilts)} back to level"
    if 2 in vehicle.dof_indices and not present & {"restoring", "net_buoyancy"}:
        yield "neither restoring nor net_buoyancy is present: weight and buoyancy are taken as equal"


def _unused_inputs(vehicle: Vehicle) -> Iterator[str]:
    taken = {d.name for effect in vehicle.all_effects for d in logged(type(effect))} | CHANNELS
    for name in (n for n in vehicle.inputs if n not in taken):
        takers = [e for e, cls in catalogue().items() if name in {d.name for d in logged(cls)}]
        would = f" ({' or '.join(takers)} would)" if takers else ""
        yield f"input {name} is used by no effect of the vehicle{would}; logs still have to contain it"
