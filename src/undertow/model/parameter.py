"""Parameters of effects: name, unit and plausible range of a number."""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, field
from functools import lru_cache
from math import inf
from typing import Any, Self

import sympy as sm

from .symbols import DOFS, FORCE, VELOCITY, symbol

Range = tuple[float, float]


@dataclass(frozen=True)
class Limits:
    """Plausible ranges of vehicle parameters: beyond them a unit or a digit is wrong."""

    gravity: Range = (9.7, 9.9)  # m/s^2; on the surface of the Earth it lies between 9.76 and 9.84
    water_density: Range = (900.0, 1300.0)  # kg/m^3: hot fresh water has 958, the Dead Sea 1240
    mass: Range = (1e-6, 1e10)  # kg: from a milligram to ten times the largest ship
    command: Range = (1e-9, 1e12)  # limit of a command, in whatever unit it has: counts, rpm, N or shares
    # thrust per command, N; the largest propellers give some 10^7 N, per count it may be little
    thrust: Range = (1e-12, 1e12)
    sigma: Range = (1e-30, 1e30)  # standard deviations, whose squares are still numbers
    # magnitude of any number in SI: the quadratic yaw damping of the largest ship is some 10^13 N m s^2
    largest: float = 1e18
    # m/s^2, by the thrust of one thruster at its limit, or at a command of one; a torpedo has 100
    acceleration: float = 1e4
    # radius of gyration by the length of the displacement: a rod with L/D = 100 has 0.08 and 6.7
    gyration: Range = (0.02, 30.0)
    # share by which moments of inertia may miss what a body can have: tables have two or three digits
    rounding: float = 0.02
    # Largest ratio of buoyancy to weight, either way. An empty hull may have a displacement of several times
    # its weight; newtons taken for kilograms are off by 9.81.
    buoyancy: float = 8.0
    # Places aboard, by the length of the vehicle's displacement (a cube of water as heavy as it) or its
    # radius of gyration, whichever is larger. The ends of a ship are at 2.5 of them, those of a glider with
    # L/D = 20 at 4. Where a fit may put a place:
    aboard: float = 10.0
    # Where a file may put it; a length in cm or mm taken for m is off by 100.
    farthest: float = 20.0


@dataclass(frozen=True)
class Parameter:
    """One number of an effect; declared as a class attribute, read on an instance as its symbol.

    Parameters
    ----------
    unit : str
        SI unit; "command" stands for the unit of a thruster's command.
    about : str
        Meaning, in one line.
    bounds : (float, float)
        Values that are physically possible, in SNAME signs; outside is refused.
    linear : bool
        True for a regressor column, False for a shape parameter (delay, width, time constant).
    default : float, optional
        Value, taken as known, if the vehicle file states none.
    starts : tuple of float
        Where a search over a shape parameter begins.
    required : bool
        True where a vehicle file must give the value, since every vehicle has one.
    motion : int, optional
        Velocity whose sign selects the forward or the backward value, where the two may differ.
    neutral : float, optional
        Value at which the effect is absent; None for a parameter that cannot switch the effect off (a time
        constant, a smoothing width).
    on_left_side : bool
        True for a derivative that tables print as a positive magnitude (added mass and damping).
    alone : bool
        False for a parameter that is no evidence of the effect without the others (a constant part).
    per_run : bool
        True for parameters that vary from run to run (a current, a trim): the value may differ between runs
        unless a vehicle file says ``per_run = false``.
    arm_of : str
        For a position on board, from the body origin: "1" if the parameter is a length, the name of a mass or
        force if it is that times a length; empty for all others.
    logged : bool
        Whether a log may contain it: if `inputs` of a vehicle file names it, it is an input, held between
        samples, instead of a parameter.
    with_log, without_log : str
        Input without which, or with which, the parameter has no meaning and does not exist.
    earth_axis : bool
        True for a component of a vector along north, east or down. Which of them is zero says nothing of the
        vehicle: a model has all components or none.
    step_width : bool
        True for the velocity over which a step is smoothed; wider than the motion it is not a step.
    asymmetric : bool
        True for a term that only a body whose port and starboard sides differ has (X_r, N_u): a vehicle file
        may state it, but it is not proposed, since a current, a trim or a sensor off its axis acts alike.
    within : float
        Largest magnitude in natural units of the vehicle (powers of its mass, its length and the time
        sqrt(length / g)) that a fit allows if the file states no standard deviation. Positions on board have
        `Limits.aboard` instead.
    """

    unit: str
    about: str
    bounds: tuple[float, float] = (-inf, inf)
    linear: bool = True
    default: float | None = None
    starts: tuple[float, ...] = ()
    required: bool = False
    motion: int | None = None
    neutral: float | None = 0.0
    on_left_side: bool = False
    alone: bool = True
    per_run: bool = False
    arm_of: str = ""
    logged: bool = False
    with_log: str = ""
    without_log: str = ""
    earth_axis: bool = False
    step_width: bool = False
    asymmetric: bool = False
    within: float = 100.0
    name: str = field(default="", kw_only=True)

    @classmethod
    def with_default(cls, unit: str, about: str, bounds: Range, default: float, **more: Any) -> Self:
        """A shape parameter that cannot switch its effect off, taken as known where no file states it."""
        return cls(unit, about, bounds, linear=False, default=default, neutral=None, **more)

    @classmethod
    def with_starts(
        cls, unit: str, about: str, bounds: Range, starts: tuple[float, ...], **more: Any
    ) -> Self:
        """A shape parameter that cannot switch its effect off, with where a search for it begins."""
        return cls(unit, about, bounds, linear=False, starts=starts, neutral=None, **more)

    def __set_name__(self, owner: type, name: str) -> None:
        if not self.name:
            object.__setattr__(self, "name", name)

    def __get__(self, effect: Any, owner: type | None = None) -> Any:
        if effect is None:
            return self
        return symbol(self.name) if self.usable(effect.inputs) else sm.Integer(0)

    def usable(self, inputs: Container[str]) -> bool:
        """Whether it has a meaning where the log holds these inputs."""
        return self.without_log not in inputs and (not self.with_log or self.with_log in inputs)

    def expand(self, thrusters: tuple[str, ...], surfaces: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
        """The scalar parameters that this declaration stands for on a vehicle with this hardware."""
        return (self,)

    @property
    def assumed(self) -> bool:
        """Whether the declaration has a value of its own for it, other than that of no effect."""
        return self.default is not None and self.default != self.neutral

    @property
    def shown_unit(self) -> str:
        """Unit as it is printed behind a value: empty for a plain number."""
        return "" if self.unit == "1" else self.unit

    @property
    def must_be_given(self) -> bool:
        """Whether a vehicle file has to state it: neither its default nor its neutral value is possible."""
        low, high = self.bounds
        return self.required or not low <= self.effective_default <= high

    @property
    def effective_default(self) -> float:
        """Value where nothing gives one: the default, else that at which the effect is absent, else zero."""
        return next((v for v in (self.default, self.neutral) if v is not None), 0.0)


@dataclass(frozen=True)
class PerThruster(Parameter):
    """A parameter that every thruster has for itself; reads as a column of symbols."""

    def __get__(self, effect: Any, owner: type | None = None) -> Any:
        if effect is None:
            return self
        names = [p.name for p in self.expand(effect.thrusters, effect.surface_names)]
        return sm.Matrix(len(names), 1, [symbol(n) for n in names])

    def expand(self, thrusters: tuple[str, ...], surfaces: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
        return tuple(self.of("thruster", t) for t in thrusters)

    def of(self, kind: str, owner: str) -> Parameter:
        """The parameter of one piece of hardware."""
        fields = {k: v for k, v in vars(self).items() if k not in ("name", "about")}
        return Parameter(**fields, name=f"{self.name}_{owner}", about=f"{self.about}, {kind} {owner}")


@dataclass(frozen=True)
class PerSurface(PerThruster):
    """A parameter that every control surface has for itself; reads as a column of symbols."""

    def expand(self, thrusters: tuple[str, ...], surfaces: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
        return tuple(self.of("surface", s) for s in surfaces)


@dataclass(frozen=True)
class LoggedOnly(Parameter):
    """A quantity that only a log can provide, an input if a vehicle file names it under `inputs`."""

    logged: bool = True

    def expand(self, thrusters: tuple[str, ...], surfaces: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
        return ()


DIRECTIONS = ("forward", "backward")
DIAGONAL = tuple((i, i) for i in range(6))
OFF_DIAGONAL = tuple((i, j) for i in range(6) for j in range(6) if i != j)
UPPER_TRIANGLE = tuple((i, j) for i in range(6) for j in range(i + 1, 6))


@dataclass(frozen=True)
class DerivativeMatrix:
    """A matrix of SNAME derivatives, named by a pattern such as ``{F}_{m}dot``; reads as symbols, (6, 6)."""

    pattern: str  # name of an entry from its force letter F and motion letter m
    motion_unit: tuple[str, str]  # of what the entry multiplies, for a translation and for a rotation
    entries: tuple[tuple[int, int], ...]  # row and column of entries that are not zero
    about: str  # meaning, with ``{force}`` and ``{motion}`` filled in
    bounds: tuple[float, float] = (-inf, inf)
    symmetric: bool = False  # whether entries are mirrored below the diagonal
    directional: bool = False  # whether an entry may differ between forward and backward motion
    within: float = 100.0  # that of every entry, see `Parameter`

    def __get__(self, effect: Any, owner: type | None = None) -> Any:
        if effect is None:
            return self
        matrix = sm.zeros(6)
        for i, j in self.entries:
            matrix[i, j] = symbol(self._name(i, j))
            if self.symmetric:
                matrix[j, i] = matrix[i, j]
        return matrix

    def _name(self, i: int, j: int) -> str:
        return self.pattern.format(F=FORCE[i], m=VELOCITY[j])

    def expand(self, thrusters: tuple[str, ...], surfaces: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
        """One parameter for each entry."""
        return tuple(self._entry(i, j) for i, j in self.entries)

    def _entry(self, i: int, j: int) -> Parameter:
        force, unit, per = *(("force", "N") if i < 3 else ("moment", "N m")), self.motion_unit[j > 2]
        return Parameter(
            unit=unit if per == "1" else f"{unit}/({per})",
            about=self.about.format(force=f"{DOFS[i]} {force}", motion=DOFS[j]),
            bounds=self.bounds,
            motion=j if self.directional else None,
            on_left_side=True,
            # Surge, heave and pitch keep their signs in a mirror at the plane of symmetry, the others do not.
            asymmetric=i % 2 != j % 2,
            within=self.within,
            name=self._name(i, j),
        )


_WAYS = {"ned": ("north", "east", "down"), "body": ("forward", "to starboard", "down")}


@dataclass(frozen=True)
class Place:
    """Coordinates of a point that a search has to find; reads as a column of symbols, shape (3, 1), m."""

    name: str  # what stands behind x_, y_ and z_ in the names of the coordinates
    about: str  # meaning of the point
    axes: str  # "ned" or "body"
    farthest: float  # largest magnitude of a coordinate, m
    without_log: str = ""  # input beside which the point has no meaning

    def __get__(self, effect: Any, owner: type | None = None) -> Any:
        return self if effect is None else sm.Matrix([symbol(f"{axis}_{self.name}") for axis in "xyz"])

    def expand(self, thrusters: tuple[str, ...], surfaces: tuple[str, ...] = ()) -> tuple[Parameter, ...]:
        """One parameter for each coordinate; none of them can switch an effect off."""
        return tuple(
            Parameter(
                "m",
                f"{self.about}, {way}",
                (-self.farthest, self.farthest),
                linear=False,
                starts=(0.0,),
                neutral=None,
                arm_of="1" if self.axes == "body" else "",
                earth_axis=self.axes == "ned",
                without_log=self.without_log,
                name=f"{axis}_{self.name}",
            )
            for axis, way in zip("xyz", _WAYS[self.axes], strict=True)
        )


Declaration = Parameter | DerivativeMatrix | Place


@dataclass(frozen=True)
class SharedQuantity:
    """A quantity shared with another effect's table, so that a file need not state it twice."""

    key: str  # the quantity in the effect's own table
    owner: str  # id of the other effect
    # the quantity in keys of the owner's table, `rho` and `g`; the first counts whose keys are all stated
    formulas: tuple[sm.Expr, ...]
    unit: str  # SI unit of the quantity
    unless: tuple[str, ...] = ()  # keys of the effect's own table that say all that this one would
    # relative difference up to which a value of the effect's own is the same one, rounded
    rounding: float = 1e-3
    most: float = inf  # largest ratio of the two, either way, unless the file says ``override = true``
    words: str = ""  # the formula as people write it; the key where it is empty
    # true for the way back: the owner has the first word, and is asked only about what it leaves open
    only_if_missing: bool = False


@lru_cache(maxsize=1024)
def declared(owner: type) -> tuple[Declaration, ...]:
    """Parameter declarations of an effect class, base classes first, in the order written."""
    found: dict[str, Declaration] = {}
    for cls in reversed(owner.__mro__):
        found.update({k: v for k, v in vars(cls).items() if isinstance(v, Declaration)})
    return tuple(found.values())


def logged(owner: type) -> list[Parameter]:
    """Quantities that an effect class can take from a log, parameters of it or not."""
    return [d for d in declared(owner) if isinstance(d, Parameter) and d.logged]


def printed(parameter: Parameter, value: float, signs: str) -> float:
    """A value in SNAME signs as a file or a table of the convention `signs` has it, and the way back as well.

    `value`: the number, SI; under "magnitudes" a derivative on the left-hand side changes its sign.
    """
    # A difference, because -value would turn zero into -0.0.
    return 0.0 - value if signs == "magnitudes" and parameter.on_left_side else value
