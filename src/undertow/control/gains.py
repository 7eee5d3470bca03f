"""Gain files: a control law with numbers, checked against the vehicle it is for; thrust allocation."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import sympy as sm
from pydantic import Field, StrictStr

from undertow.errors import UndertowError, refuse_unknown
from undertow.model.symbols import DOFS, POSE
from undertow.model.tables import FileTable, Identifier, Quantity, file_or_bundled, read_table
from undertow.model.units import si_of
from undertow.model.vehicle import Vehicle

from .laws import LAWS, GainMatrix, Law, LawSignals
from .plant import WITH_MOTION, Plant, remedy_for_curves

Coordinate = Literal[POSE]  # type: ignore[valid-type]
Diagonal = dict[Coordinate, Quantity] | list[Quantity] | Quantity
"""One gain for each pose coordinate by name, in the vehicle's order, or the same one for all."""


class ScheduleTable(FileTable):
    """Order in which the coordinates are driven to their set-points."""

    # With "yaw-first" x and y wait until the heading has come within `gate`, rad, once.
    order: Literal["together", "yaw-first"] = "together"
    gate: Quantity = "1 deg"
    # How the heading to a set-point without psi is worked out; "atan", as (42) of the mini-AUV paper prints
    # it, drives backwards to what lies behind.
    heading: Literal["atan2", "atan"] = "atan2"
    integrators: Literal["gate", "start"] = "gate"  # when the integrals of x and y begin


class AllocationTable(FileTable):
    """How a wanted force is shared among the thrusters."""

    weights: dict[Identifier, float] = Field(default_factory=dict)  # price of the squared command, else 1
    limits: dict[Identifier, Quantity] = Field(default_factory=dict)  # of a command, else the vehicle file's
    anti_windup: Literal["hold", "none"] = "hold"  # stop an integral that pushes further into a limit
    # Speed ahead at which forces of fins and rudders are taken, m/s; they are not commanded without one.
    speed: Quantity | None = None


class GainTable(FileTable):
    """The whole file."""

    schema_: Annotated[Literal["undertow/gains/1"], Field(alias="schema")]
    name: Annotated[StrictStr, Field(min_length=1, max_length=80)]
    description: StrictStr = ""
    source: StrictStr = ""
    law: StrictStr
    gains: dict[Identifier, Diagonal]
    # Degrees of freedom whose force, if the law wants one, is knowingly left out for want of a thruster.
    unactuated: list[Literal[DOFS]] = Field(default_factory=list)  # type: ignore[valid-type]
    schedule: ScheduleTable = Field(default_factory=ScheduleTable)
    allocation: AllocationTable = Field(default_factory=AllocationTable)


@dataclass(frozen=True)
class GainLimits:
    """Limits beyond which a unit or a power of ten is wrong, and sums of products lose digits."""

    gains: tuple[float, float] = (1e-12, 1e12)  # SI
    weights: tuple[float, float] = (1e-9, 1e9)
    speed: tuple[float, float] = (0.01, 50.0)  # m/s: what steers by fins makes way, and no vehicle is as fast


LIMITS = GainLimits()


@dataclass(frozen=True)
class GainSet:
    """A control law with its numbers for one vehicle."""

    name: str  # name of the set
    law: Law
    plant: Plant  # the vehicle as the law knows it
    # gain by name (K_P_x ...), SI; zero where a degree of freedom is unactuated and no gain is stated
    values: Mapping[str, float]
    unactuated: tuple[str, ...] = ()  # degrees of freedom whose force is knowingly left out
    # schedule, allocation: the tables of the file
    schedule: ScheduleTable = field(default_factory=ScheduleTable)
    allocation: AllocationTable = field(default_factory=AllocationTable)

    @cached_property
    def signals(self) -> LawSignals:
        """The symbols that the law is stated in, at a set-point."""
        return LawSignals(self.plant, self.law)

    @cached_property
    def tracking(self) -> LawSignals:
        """The same on a reference that moves."""
        return LawSignals(self.plant, self.law, moving=True)

    @property
    def numbers(self) -> dict[sm.Symbol, sm.Expr]:
        """Value of every gain by its symbol, SI."""
        symbols = (g.symbol(c) for g in type(self.law).gains for c in self.signals.coordinates)
        return {s: sm.Float(self.values[str(s)]) for s in symbols}

    def matrix(self, name: str) -> sm.Matrix:
        """A gain matrix with its numbers, shape (n, n), SI."""
        return getattr(self.signals, name).xreplace(self.numbers)


def bundled_gains() -> dict[str, Path]:
    """Bundled gain files, by name."""
    folder = Path(str(files("undertow") / "vehicles" / "gains"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_gains(
    source: str | Path, vehicle: Vehicle, change: Callable[[GainTable], GainTable] | None = None
) -> GainSet:
    """Read a gain file, or a bundled one by its name (paper-pd, paper-pid, paper-smc), for a vehicle.

    `change` is applied to the table of the file before it is checked against the vehicle. A gain that is
    missing, of the wrong size or unit, negative or not finite is refused, as is a law that needs a force that
    no thruster gives, unless the file declares it.
    """
    otherwise = f"gains '{source}' are neither a file nor a bundled set"
    path = file_or_bundled(source, bundled_gains(), otherwise)
    table = read_table(path, GainTable, "gain file")
    try:
        return gains_from_table(change(table) if change else table, vehicle)
    except UndertowError as error:
        raise UndertowError(f"{source}: {error}") from error


def gains_from_table(table: GainTable, vehicle: Vehicle) -> GainSet:
    """The gain set that a validated file describes, for a vehicle."""
    refuse_unknown([table.law], LAWS, "law ", " is not known", "laws are")
    law = LAWS[table.law]()
    plant = Plant(vehicle, _speed(table.allocation))
    _check_axes(table, plant, bool(vehicle.surfaces) or WITH_MOTION in plant.left_out.values())
    values: dict[str, float] = {}
    for gain in _gain_matrices(table, type(law)):
        values |= _values(gain, table.gains[gain.name], vehicle, table.unactuated)
    _check_thrusters(table.allocation, vehicle)
    return GainSet(table.name, law, plant, values, tuple(table.unactuated), table.schedule, table.allocation)


def _speed(allocation: AllocationTable) -> float:
    """Speed at which forces of fins are taken, m/s; zero where none is stated."""
    if allocation.speed is None:
        return 0.0
    speed = si_of("[allocation] speed", allocation.speed, "m/s")
    if not LIMITS.speed[0] <= speed <= LIMITS.speed[1]:
        low, high = LIMITS.speed
        raise UndertowError(f"[allocation] speed = {allocation.speed}: give one from {low:g} to {high:g} m/s")
    return speed


# --- gains ------------------------------------------------------------------------------------
def _gain_matrices(table: GainTable, law: type[Law]) -> Iterable[GainMatrix]:
    known = [g.name for g in law.gains]
    refuse_unknown(table.gains, known, "gain ", f" does not belong to law '{law.id}'", "it has")
    for gain in law.gains:
        if gain.name not in table.gains:
            raise UndertowError(
                f"gain '{gain.name}' of law '{law.id}' is missing: add [gains.{gain.name}] ({gain.meaning})"
            )
    return law.gains


def _values(gain: GainMatrix, stated: Diagonal, vehicle: Vehicle, unactuated: list[str]) -> dict[str, float]:
    coordinates = vehicle.pose_names
    by_coordinate = _by_coordinate(gain, stated, coordinates)
    values = {}
    for coordinate, dof in zip(coordinates, vehicle.degrees_of_freedom, strict=True):
        name = str(gain.symbol(coordinate))
        if coordinate in by_coordinate:
            values[name] = _gain_value(gain, coordinate, by_coordinate[coordinate])
        elif dof in unactuated:
            values[name] = 0.0
        else:
            raise UndertowError(
                f"gain {gain.name} has no value for {coordinate}: add {coordinate} = "
                f'"... {gain.unit(coordinate)}" to [gains.{gain.name}]'
            )
    return values


def _by_coordinate(gain: GainMatrix, stated: Diagonal, coordinates: tuple[str, ...]) -> dict[str, Quantity]:
    if isinstance(stated, list):
        if len(stated) != len(coordinates):
            raise UndertowError(
                f"gain {gain.name} has {len(stated)} values, but the vehicle has {len(coordinates)} pose "
                f"coordinates: give one for each of {', '.join(coordinates)}"
            )
        return dict(zip(coordinates, stated, strict=True))
    if not isinstance(stated, dict):
        return dict.fromkeys(coordinates, stated)
    alien = [c for c in stated if c not in coordinates]
    if alien:
        raise UndertowError(
            f"gain {gain.name} has a value for {alien[0]}, which the vehicle does not have: its pose "
            f"coordinates are {', '.join(coordinates)}"
        )
    return dict(stated)


def _gain_value(gain: GainMatrix, coordinate: str, stated: Quantity) -> float:
    value = si_of(f"gain {gain.name} for {coordinate}", stated, gain.unit(coordinate))
    if value <= 0:
        raise UndertowError(
            f"gain {gain.name} for {coordinate} is {stated}, but gains have to be positive: the law itself "
            "has the signs"
        )
    low, high = LIMITS.gains
    if not low <= value <= high:
        raise UndertowError(
            f"gain {gain.name} for {coordinate} is {stated}: give one from {low:g} to {high:g} "
            f"{gain.unit(coordinate)}"
        )
    return value


# --- what the law needs of the vehicle ----------------------------------------------------------
def _check_axes(table: GainTable, plant: Plant, steered: bool) -> None:
    """Refuse a law that needs forces which no thruster gives, unless the file declares them unactuated."""
    vehicle = plant.vehicle
    unactuated = [vehicle.degrees_of_freedom[i] for i in plant.unactuated]
    missing = [d for d in unactuated if d not in table.unactuated]
    if missing:
        idle = steered and not plant.speed
        remedy = "state [allocation] speed, at which surfaces steer" if idle else "add a thruster"
        remedy = remedy_for_curves(vehicle) or remedy
        raise UndertowError(
            f"law '{table.law}' needs a force in {', '.join(missing)}, which no thruster of "
            f"'{vehicle.name}' gives: {remedy}, or write unactuated = {json.dumps(unactuated)} to do without "
            "that force"
        )
    unexpected = [d for d in table.unactuated if d not in unactuated and not _dependent(d, table, plant)]
    if unexpected:
        raise UndertowError(
            f"unactuated names {', '.join(unexpected)}, which '{vehicle.name}' "
            f"{'can push in' if unexpected[0] in vehicle.degrees_of_freedom else 'does not have'}: remove it"
        )


def _dependent(dof: str, table: GainTable, plant: Plant) -> bool:
    """Whether actuation of one degree of freedom always acts on another one that the law uses."""
    dofs = plant.vehicle.degrees_of_freedom
    rows = plant.B.xreplace(plant.numbers)
    kept = [i for i, d in enumerate(dofs) if d not in table.unactuated]
    columns = list(range(rows.cols))
    both = [*kept, dofs.index(dof)] if dof in dofs else []
    return bool(both) and rows.extract(both, columns).rank() == rows.extract(kept, columns).rank()


def _check_thrusters(allocation: AllocationTable, vehicle: Vehicle) -> None:
    known = vehicle.actuator_names if allocation.speed is not None else [t.name for t in vehicle.thrusters]
    named = (*allocation.weights, *allocation.limits)
    refuse_unknown(named, known, "[allocation] names thruster ", "", "the vehicle has")
    low, high = LIMITS.weights
    beyond = [(k, w) for k, w in allocation.weights.items() if not low <= w <= high]
    if beyond:
        name, weight = beyond[0]
        raise UndertowError(
            f"weight of thruster '{name}' is {weight:g}: give one above zero, from {low:g} to {high:g}"
        )


# --- how a wanted force is shared among the thrusters -------------------------------------------
@dataclass(frozen=True)
class Allocation:
    """The inverse of B f = tau for the degrees of freedom that the thrusters push in."""

    matrix: np.ndarray  # (n, m): body-frame force of a unit of each command, N and N m
    rows: tuple[int, ...]  # degrees of freedom that are allocated; the others are left out
    weights: np.ndarray  # (m,): price of the squared command of each
    limits: np.ndarray  # (m,): largest magnitude of each command; infinite where there is none

    @property
    def limited(self) -> bool:
        """Whether any command has a limit."""
        return bool(np.isfinite(self.limits).any())

    @property
    def allocated(self) -> np.ndarray:
        """Rows of the matrix that are allocated, shape (k, m)."""
        return self.matrix[list(self.rows)]

    @property
    def pseudo_inverse(self) -> np.ndarray:
        """Commands of a unit of each allocated force without limits, shape (m, k)."""
        b, inverse_weights = self.allocated, 1 / self.weights[:, None]
        inverse = inverse_weights * b.T @ np.linalg.inv(b @ (inverse_weights * b.T))
        return np.where(np.abs(inverse) < 1e-14 * np.abs(inverse).max(), 0.0, inverse)

    @property
    def B_inverse(self) -> np.ndarray:
        """The same for the forces in all degrees of freedom, shape (m, n)."""
        B_inverse = np.zeros(self.matrix.T.shape)
        B_inverse[:, list(self.rows)] = self.pseudo_inverse
        return B_inverse

    @property
    def achieved(self) -> np.ndarray:
        """Force that the thrusters give, without limits, for a unit of each wanted one, shape (n, n).

        The identity in the rows that are allocated; what is left out may be pushed along with them.
        """
        return self.matrix @ self.B_inverse


def allocation_of(gains: GainSet) -> Allocation:
    """The allocation that a gain set asks for on the vehicle that it knows."""
    vehicle = gains.plant.vehicle
    matrix = gains.plant.thrust_matrix
    dofs = vehicle.degrees_of_freedom
    rows = tuple(i for i, d in enumerate(dofs) if d not in gains.unactuated)
    if not rows:
        raise UndertowError(
            f"a controller has no actuators: no thruster of '{vehicle.name}' pushes in "
            f"{', '.join(dofs)}; add [[thrusters]] to the vehicle file"
        )
    if np.linalg.matrix_rank(matrix[list(rows)]) < len(rows):
        raise UndertowError(
            f"thrusters of '{vehicle.name}' cannot push in {', '.join(dofs[i] for i in rows)} independently: "
            "list under unactuated in the gain file what is not to be controlled"
        )
    # Refuse thrusters with less thrust astern than ahead: the allocation assumes symmetric limits.
    one_sided = [
        t.name for t in vehicle.thrusters if t.lowest is not None and t.lowest != -(t.limit or np.inf)
    ]
    if one_sided:
        raise UndertowError(
            f"thruster '{one_sided[0]}' of '{vehicle.name}' has its own lowest command, and control "
            "laws allocate forces to thrusters with symmetric limits only: remove `lowest` from the "
            "file for the controller, and choose set-points that keep its thrust positive"
        )
    own, units = vehicle.command_limits, vehicle.command_units
    stated = {name: _limit(name, limit, units[name]) for name, limit in gains.allocation.limits.items()}
    names = vehicle.command_names
    limits = [stated.get(n, own.get(n, np.inf)) for n in names]
    weights = np.array([gains.allocation.weights.get(n, 1.0) for n in names])
    return Allocation(matrix, rows, weights, np.array(limits))


def _limit(name: str, stated: Quantity, unit: str) -> float:
    """A limit as vehicle files state it: an angle, or in N where the command is the thrust itself."""
    newtons = isinstance(stated, str) and "N" in stated
    counted = "rad" if unit == "rad" else "N" if newtons else "command"
    value = si_of(f"[allocation] limit of '{name}'", stated, counted)
    if value <= 0:
        raise UndertowError(f"[allocation] limit of '{name}' is {stated}: give one above zero")
    return value
