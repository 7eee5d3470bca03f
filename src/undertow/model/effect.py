"""A physical effect: its parameters, one symbolic statement of its physics, and the hardware it acts on."""

from __future__ import annotations

import abc
import copy
import math
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import Any, ClassVar, Literal, Self

import sympy as sm

from undertow.errors import UndertowError

# An effect is declared with the names of this module alone.
from .parameter import (  # noqa: F401
    DIAGONAL,
    OFF_DIAGONAL,
    UPPER_TRIANGLE,
    DerivativeMatrix,
    Limits,
    LoggedOnly,
    Parameter,
    PerSurface,
    PerThruster,
    Place,
    SharedQuantity,
    declared,
    logged,
)
from .symbols import DOFS, FASTEST, FORCE, VELOCITY, Signals, column, spelled_out, symbol  # noqa: F401


@lru_cache(maxsize=1024)
def _parameters_of(
    cls: type[Effect], thrusters: tuple[str, ...], surfaces: tuple[str, ...], inputs: tuple[str, ...]
) -> tuple[Parameter, ...]:
    found = (p for d in declared(cls) for p in d.expand(thrusters, surfaces))
    return tuple(p for p in found if p.name not in inputs and p.usable(inputs))


@dataclass(frozen=True)
class VehicleSize:
    """How large a vehicle is, by its mass and inertia."""

    mass: float  # kg
    length: float  # edge of a cube of water of this mass, m
    gyration: float  # largest radius of gyration that the file states, m; zero where it states none


class Effect(abc.ABC):
    """One physical effect of a marine vehicle; subclass `Wrench`, `Flow`, `Actuation`, `Measurement` or two.

    The docstring's first line is the effect's meaning. Parameters are class attributes
    (`Parameter`, `PerThruster`, `DerivativeMatrix`) and read as symbols on an instance.

    Attributes
    ----------
    id : str
        The name in vehicle files; the module-wide unique id of the catalogue.
    family : str
        Group in the catalogue: inertia, damping, statics, water, tether, actuation, measurement, memory.
    reference : str
        Book or paper that the statement follows.
    signature : str
        How the effect shows itself in a log.
    requires : tuple of str
        Ids of effects whose parameters this one shares; it can be used only in a vehicle that has them.
    shares : tuple of str
        Ids of effects whose parameters it shares where the vehicle has them, and takes as zero where not.
    series_of : tuple of str
        Ids of effects for whose forces this one is a polynomial with a coefficient for each term: it may fit
        better than the physics without being another cause.
    built_in : bool
        True for effects that come with a vehicle's hardware; never a candidate.
    of_shape : bool
        True for effects computed from the shape of a hull, with more parameters than a log could determine;
        never a candidate.
    known_by_design : bool
        True if the values come from weighing and drawings, and errors in them are separate effects (water in
        the hull, net buoyancy, a shifted centre of buoyancy).
    scales_with : str
        "drag" or "inertia" if all its coefficients grow by a common factor as the hull becomes rough, fouled
        or damaged, which fleet analysis looks for; else empty.
    shared_quantities : tuple of SharedQuantity
        Keys of its table that another effect states as well: the mass of one is the weight of the other.
    former_keys : tuple of str
        Keys of `file_units` that used to be parameters: if marked for estimation, so are those they become.
    allocation : Matrix, shape (6, n_thrusters)
        Force and moment of one newton of thrust of each thruster, body frame, 1 and m; zero without a
        vehicle.
    laws : tuple of Propeller, Curve or None
        How the command of each thruster becomes thrust; None where it is in proportion.
    surfaces : tuple of Surface
        Control surfaces of the vehicle.
    inputs : tuple of str
        Logged quantities that the vehicle takes as inputs; a parameter of that name is then the input.
    """

    id: ClassVar[str]
    family: ClassVar[str]
    reference: ClassVar[str]
    signature: ClassVar[str] = ""
    requires: ClassVar[tuple[str, ...]] = ()
    shares: ClassVar[tuple[str, ...]] = ()
    series_of: ClassVar[tuple[str, ...]] = ()
    built_in: ClassVar[bool] = False
    of_shape: ClassVar[bool] = False
    known_by_design: ClassVar[bool] = False
    scales_with: ClassVar[Literal["", "drag", "inertia"]] = ""
    shared_quantities: ClassVar[tuple[SharedQuantity, ...]] = ()
    former_keys: ClassVar[tuple[str, ...]] = ()

    def __init__(
        self,
        thrusters: tuple[str, ...] = (),
        surfaces: tuple[Surface, ...] = (),
        inputs: tuple[str, ...] = (),
    ) -> None:
        self.thrusters = tuple(thrusters)
        self.surfaces = tuple(surfaces)
        self.inputs = tuple(inputs)
        self.allocation = sm.zeros(6, len(thrusters))
        self.laws: tuple[Law, ...] = (None,) * len(thrusters)

    def __eq__(self, other: object) -> bool:
        """The same effect on the same hardware: what is derived from one serves for the other."""
        if type(self) is not type(other) or not isinstance(other, Effect):
            return False
        own, others = vars(self), vars(other)
        hardware = ("thrusters", "allocation", "laws", "surfaces", "inputs")
        return own.keys() == others.keys() and all(
            own[n] == others[n] if n in hardware else own[n] is others[n] for n in own
        )

    def __hash__(self) -> int:
        return hash((type(self), self.thrusters))

    def __repr__(self) -> str:
        return f"{self.id}: {self.about()}"

    @property
    def surface_names(self) -> tuple[str, ...]:
        """Names of the control surfaces."""
        return tuple(surface.name for surface in self.surfaces)

    def placed(
        self,
        allocation: sm.Matrix,
        surfaces: tuple[Surface, ...] = (),
        inputs: tuple[str, ...] = (),
        laws: tuple[Law, ...] = (),
    ) -> Self:
        """The effect on a vehicle whose thrusters press on it like this, `allocation` of shape (6, n)."""
        there = copy.copy(self)
        there.allocation, there.surfaces, there.inputs = allocation, surfaces, inputs
        there.laws = laws or self.laws
        return there

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The scalar parameters of this effect on its vehicle."""
        return _parameters_of(type(self), self.thrusters, self.surface_names, self.inputs)

    @classmethod
    def from_file(cls, entries: dict[str, float]) -> dict[str, float]:
        """Convert alternative parameters of a file (`x_g` for `mx_g`) to the parameters."""
        return entries

    @classmethod
    def file_units(cls) -> dict[str, str]:
        """Units of the keys that `from_file` accepts besides the parameters."""
        return {}

    @classmethod
    def reconciled(cls, values: Mapping[str, float], shared: Mapping[str, float]) -> dict[str, float]:
        """Fitted `values` rewritten, with the same physics, to agree with values stated in other tables.

        Parameters
        ----------
        values : mapping
            Parameters by name; missing ones were found to be zero.
        shared : mapping
            What other tables of the file state, by key.
        """
        return dict(values)

    @classmethod
    def impossible(
        cls, values: Mapping[str, float], limits: Limits, moved: Set[str] = frozenset()
    ) -> Iterator[str]:
        """One line for each impossible value of a vehicle.

        Parameters
        ----------
        values : mapping
            Parameters that the vehicle states and uses, of all its effects, with `rho` and `g`.
        limits : Limits
            What numbers can be.
        moved : set of str
            Parameters that a fit may have moved to compensate for a missing effect: a file must accept them.
        """
        yield from ()

    @classmethod
    def vehicle_size(cls, values: Mapping[str, float]) -> VehicleSize | None:
        """How large a vehicle with these values is; None where the effect does not say."""
        return None

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states that the effect owns."""
        return ()

    @property
    def state_units(self) -> tuple[str, ...]:
        """Unit of each of the effect's own states."""
        return ("1",) * len(self.states)

    @property
    def state_symbols(self) -> sm.Matrix:
        """Symbols of the effect's own states, shape (n, 1)."""
        return column(self.states)

    def abbreviations(self, s: Signals) -> dict[sm.Symbol, sm.Expr]:
        """Symbols that stand for longer expressions in a wrench or a flow; later may use earlier ones."""
        return {}

    def spelled_out(self, stated: sm.Matrix, s: Signals) -> sm.Matrix:
        """The result of a method of a wrench or a flow, with abbreviations expanded."""
        meanings = [{name: meaning} for name, meaning in self.abbreviations(s).items()]
        return stated.xreplace(spelled_out(meanings)) if meanings else stated

    @property
    def constants(self) -> dict[sm.Symbol, str]:
        """Symbols, with units, that stand for numbers of the hardware on a `specimen`, and its inputs."""
        units = {x: "1" if str(x).startswith("e_") else "m" for x in self.allocation.free_symbols}
        propellers = [law for law in self.laws if isinstance(law, Propeller)]
        for found in (part.symbols for parts in (self.surfaces, propellers) for part in parts):
            units |= found
        return units | {symbol(d.name): d.unit for d in logged(type(self)) if d.name in self.inputs}

    @classmethod
    def starts_near(cls, seen: Mapping[str, tuple[float, float]]) -> list[dict[str, float]]:
        """Starting points of a search, given the range of the logs.

        Parameters
        ----------
        seen : mapping
            Least and greatest value of each pose coordinate that the vehicle has, m and rad, and, as
            `dominant_frequency`, of the dominant angular frequency of the residual, rad/s.

        Returns
        -------
        list of dict
            Values of shape parameters by name; empty if the parameters' own `starts` are suitable.
        """
        return []

    @classmethod
    def observable_in(cls, dofs: tuple[str, ...]) -> bool:
        """Whether a vehicle with these degrees of freedom (surge, sway, ...) can show the effect at all."""
        return True

    @classmethod
    def specimen(cls, inputs: tuple[str, ...] = ()) -> Self:
        """An instance for display and checks, as on a vehicle with two thrusters.

        It has a rudder in the slipstream of one of them. `inputs` are the quantities that its log holds.
        """
        names = ("port", "starboard")
        columns = [[*(f"e_{a}_{n}" for a in "xyz"), *(f"lever_{a}_{n}" for a in "xyz")] for n in names]
        surfaces = (Surface.specimen("rudder", names[0]),)
        return cls(names).placed(sm.Matrix.hstack(*map(column, columns)), surfaces, inputs)

    @classmethod
    def about(cls) -> str:
        """The meaning of the effect: the first line of its docstring."""
        return (cls.__doc__ or "").strip().split("\n")[0]


class Wrench(Effect):
    """A force and moment on the vehicle.

    Attributes
    ----------
    dissipative : bool
        Claims that the effect never feeds power into the vehicle in still water.
    workless : bool
        Claims that its power is identically zero (Coriolis terms).
    damping_matrix : str
        Entries of the linear damping matrix D that its coefficients are: "diagonal", "coupling" or none.

    Examples
    --------
    >>> import sympy
    >>> import undertow as ut
    >>> class SteadyPull(ut.Wrench):
    ...     '''A pull ahead of one newton.'''
    ...
    ...     id = "steady_pull"
    ...
    ...     def wrench(self, s):
    ...         return sympy.Matrix([1, 0, 0, 0, 0, 0])
    >>> SteadyPull().id
    'steady_pull'
    """

    dissipative: ClassVar[bool] = False
    workless: ClassVar[bool] = False
    damping_matrix: ClassVar[Literal["", "diagonal", "coupling"]] = ""

    @abc.abstractmethod
    def wrench(self, s: Signals) -> sm.Matrix:
        """Force and moment in body axes, shape (6, 1), N and N m."""

    def rates(self, s: Signals) -> sm.Matrix:
        """Time derivative of the effect's own states, shape (n, 1)."""
        return sm.zeros(len(self.states), 1)


class Flow(Effect):
    """A motion of the water; it acts on every effect that is stated in `nu_r`."""

    family = "water"

    @abc.abstractmethod
    def velocity(self, s: Signals) -> sm.Matrix:
        """Velocity of the water where the vehicle is, shape (3, 1), NED, m/s."""

    def acceleration(self, s: Signals) -> sm.Matrix:
        """Its rate along the vehicle's path, shape (3, 1), NED, m/s^2."""
        return sm.zeros(3, 1)


class Actuation(Effect):
    """A step between a command and the thrust that is delivered.

    Attributes
    ----------
    stage : int
        Place in the chain, whatever the order in a vehicle file: 10 wiring and gain, 14 and 16 dead band and
        limit of the drive, 20 and 22 curve and reverse loss of the propeller, 35 supply, 40 dynamics,
        50 dead time. Two that do not commute need different places.
    of_surfaces : bool
        Whether it is on the way from the command of a control surface to its angle, not to thrusters.
    """

    family = "actuation"
    stage: ClassVar[int] = 10
    of_surfaces: ClassVar[bool] = False

    @property
    def state_units(self) -> tuple[str, ...]:
        """Unit of each of the step's own states: that of the command, unless the step says otherwise."""
        return (self.command_unit,) * len(self.states)

    @property
    def command_unit(self) -> str:
        """Unit of its input and output."""
        return "rad" if self.of_surfaces else "command"

    @property
    def acts_on(self) -> tuple[str, ...]:
        """Names of the thrusters, or of the surfaces, on which it acts."""
        return self.surface_names if self.of_surfaces else self.thrusters

    @abc.abstractmethod
    def output(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        """Output of this step, shape (n_thrusters, 1), in units of the command."""

    def rates(self, upstream: sm.Matrix, s: Signals) -> sm.Matrix:
        """Time derivative of the step's own states, shape (n, 1)."""
        return sm.zeros(len(self.states), 1)

    def rest_state(self, upstream: sm.Matrix) -> sm.Matrix:
        """States that belong to an `upstream` that has been held for a long time, shape (n, 1)."""
        return sm.zeros(len(self.states), 1)

    def dead_time(self) -> sm.Expr:
        """Pure delay of this step, s."""
        return sm.Integer(0)


class Measurement(Effect):
    """A difference between the true motion and what the sensors report.

    Attributes
    ----------
    of_velocity_sensor : bool
        Whether only a velocity sensor can have it; it is not tried where velocities were taken from the pose.
    by_pose : bool
        Whether only the pose beside a velocity can show it; it is not tried where no pose was measured.
    stage : int
        Place in the chain, whatever the order in a vehicle file: 10 lever arm, 20 rotation, 30 scale,
        40 bias, 50 delay.
    """

    family = "measurement"
    of_velocity_sensor: ClassVar[bool] = False
    by_pose: ClassVar[bool] = False
    stage: ClassVar[int] = 20

    @abc.abstractmethod
    def reported(self, eta: sm.Matrix, nu: sm.Matrix, s: Signals) -> tuple[sm.Matrix, sm.Matrix]:
        """Pose and body velocity that the sensors report.

        The reported attitude is affine in the attitude, all else affine in position and velocity at a given
        attitude, so that the true motion can be computed from the readings.
        """

    def age(self) -> sm.Matrix:
        """How old each reported pose coordinate and body velocity is, shape (12, 1), s; never negative."""
        return sm.zeros(12, 1)


KINDS: dict[str, type[Effect]] = {
    "flow": Flow,
    "wrench": Wrench,
    "actuation": Actuation,
    "measurement": Measurement,
}


def kinds_of(effect: Effect | type[Effect]) -> tuple[str, ...]:
    """Kinds of an effect, of four; a wave moves the water and exerts pressure on the hull, so it is two."""
    cls = effect if isinstance(effect, type) else type(effect)
    return tuple(kind for kind, base in KINDS.items() if issubclass(cls, base))


def kind_of(effect: Effect | type[Effect]) -> str:
    """The kinds of an effect in words."""
    return " and ".join(kinds_of(effect))


# --- hardware as effects see it -------------------------------------------------------------------
Number = Any  # a float, or a symbol on a specimen


@dataclass(frozen=True)
class ActuatorSettings:
    """Numbers by which directions of thrusters and surfaces, and curves of thrust, are judged."""

    # Part of its thrust ahead up to which a thruster is across the hull, as directions are rounded in files.
    # It chooses between two equations, and a thruster that stands a little oblique is none across the hull.
    largest_part_ahead: float = 1e-6
    # How far the axis of a surface may miss a unit vector across the x axis, and the direction of a thruster
    # a unit vector, and is then a rounded one. It refuses only: three decimals, as people write, are enough.
    unit_error: float = 1e-3
    # Difference of a stated moment and that of the position and direction beside it, relative or in m, up to
    # which they are the same: rounding.
    same_moment: float = 1e-9
    curve_points: int = 400  # commands at which a curve is tried for a fall, but for the first one
    rounding_fall: float = 1e-9  # fall of a curve, as a share of its rise, that is rounding
    halvings: int = 60  # of the range of a curve in search of a command: they leave nothing of it


ACTUATORS = ActuatorSettings()


@dataclass(frozen=True)
class Surface:
    """A rudder, a fin or a plane that is turned about an axis."""

    name: str  # name, and log column of its angle in rad
    position: tuple[Number, Number, Number]  # centre of pressure in body axes, m
    # unit vector about which a positive angle turns it by the right hand, across the x axis: at zero the
    # chord points ahead
    axis: tuple[Number, Number, Number]
    area: Number  # m^2
    limit: Number | None = None  # largest magnitude of the angle, rad
    propeller: str = ""  # name of the thruster in whose slipstream it stands; empty without one
    diameter: Number = 0.0  # diameter of that propeller, m

    @classmethod
    def specimen(cls, name: str, propeller: str) -> Surface:
        """One whose numbers are symbols, but for its axis, which is upright as that of a rudder."""
        place, other = [symbol(f"place_{a}_{name}") for a in "xyz"], f"diameter_{propeller}"
        upright = (sm.Integer(0), sm.Integer(0), sm.Integer(-1))
        return cls(name, (*place,), upright, symbol(f"area_{name}"), None, propeller, symbol(other))

    @property
    def place(self) -> sm.Matrix:
        """The position as a column, shape (3, 1), m."""
        return sm.Matrix([exact(v) for v in self.position])

    @property
    def turned_about(self) -> sm.Matrix:
        """The axis as a column, shape (3, 1)."""
        return sm.Matrix([exact(v) for v in self.axis])

    @property
    def symbols(self) -> dict[sm.Symbol, str]:
        """Symbols among its numbers, with their units."""
        stated = [*((v, "m") for v in (*self.position, self.diameter)), (self.area, "m^2")]
        return {v: unit for v, unit in stated if isinstance(v, sm.Symbol)}


@dataclass(frozen=True)
class Propeller:
    """A propeller whose command is its speed of revolution."""

    diameter: Number  # m
    per_command: Number  # revolutions per second and unit of command

    @classmethod
    def specimen(cls, name: str) -> Propeller:
        """One whose numbers are symbols."""
        return cls(symbol(f"diameter_{name}"), symbol(f"turns_{name}"))

    @property
    def symbols(self) -> dict[sm.Symbol, str]:
        """Symbols among its numbers, with their units."""
        stated = ((self.diameter, "m"), (self.per_command, "1/(s command)"))
        return {v: unit for v, unit in stated if isinstance(v, sm.Symbol)}


@dataclass(frozen=True)
class Curve:
    """Thrust at rest over the command: cubic pieces with continuous slope, constant beyond the ends."""

    start: Number  # thrust at the first command and below, N
    # commands between which a piece holds, and what it adds to the thrust at its begin: coefficients of the
    # first, second ... power of the command beyond the begin, N
    pieces: tuple[tuple[Number, Number, tuple[Number, ...]], ...]

    @classmethod
    def through(cls, points: Sequence[tuple[float, float]]) -> Curve:
        """The monotone curve through points in the order of their commands.

        Slopes are those of Fritsch and Carlson (1980) and Butland: a harmonic mean on either side, zero at an
        extremum.
        """
        steps = [(b[0] - a[0], (b[1] - a[1]) / (b[0] - a[0])) for a, b in pairwise(points)]
        inner = (_slope_between(*one, *other) for one, other in pairwise(steps))
        slopes = [steps[0][1], *inner, steps[-1][1]]
        pieces = []
        for (x, _), (end, _), (h, rise), a, b in zip(
            points, points[1:], steps, slopes, slopes[1:], strict=False
        ):
            pieces.append((x, end, (a, (3 * rise - 2 * a - b) / h, (a + b - 2 * rise) / h**2)))
        return cls(points[0][1], tuple(pieces))

    @classmethod
    def polynomial(cls, coefficients: Sequence[float], limit: float) -> Curve:
        """Coefficients of the first, second ... power of a command up to a limit, N; none at zero."""
        shifted = [
            sum(math.comb(n, k) * c * (-limit) ** (n - k) for n, c in enumerate(coefficients, 1) if n >= k)
            for k in range(len(coefficients) + 1)
        ]
        return cls(shifted[0], ((-limit, limit, tuple(shifted[1:])),))

    @property
    def largest(self) -> float:
        """Largest magnitude of a command beyond which the curve is constant."""
        return max(abs(self.pieces[0][0]), abs(self.pieces[-1][1]))

    def thrust(self, command: sm.Expr) -> sm.Expr:
        """Thrust at a command, N: what every piece adds up to there."""
        return _thrust(self, command)

    def at(self, command: float) -> float:
        """The same for a number."""
        clipped = ((max(b, min(command, e)) - b, c) for b, e, c in self.pieces)
        return self.start + sum(c * x**n for x, cs in clipped for n, c in enumerate(cs, 1))

    @cached_property
    def _falls(self) -> bool:
        low, high = self.pieces[0][0], self.pieces[-1][1]
        points = ACTUATORS.curve_points
        thrusts = [self.at(low + (high - low) * k / points) for k in range(points + 1)]
        rounding = ACTUATORS.rounding_fall * abs(thrusts[-1] - thrusts[0])
        return any(b < a - rounding for a, b in pairwise(thrusts))

    def inverse(self, thrust: float) -> float:
        """The command that gives a thrust, N, or the nearest thrust on the curve.

        Refused where the curve falls somewhere: then several commands give the same thrust.
        """
        if self._falls:
            raise UndertowError("the thrust falls with the command somewhere: no command belongs to a thrust")
        low, high = self.pieces[0][0], self.pieces[-1][1]
        for _ in range(ACTUATORS.halvings):
            middle = (low + high) / 2
            low, high = (low, middle) if self.at(middle) >= thrust else (middle, high)
        return (low + high) / 2


@lru_cache(maxsize=64)
def _thrust(curve: Curve, command: sm.Expr) -> sm.Expr:
    """Kept, as SymPy orders the ends of every piece anew, and several effects ask for the same thrust."""
    total = _number(curve.start)
    for begin, end, coefficients in curve.pieces:
        beyond = sm.Max(_number(begin), sm.Min(command, _number(end))) - _number(begin)
        powers = sm.Integer(0)
        for c in reversed(coefficients):
            powers = (powers + _number(c)) * beyond
        total += powers
    return total


def _slope_between(h: float, rise: float, after: float, next_rise: float) -> float:
    """Slope at a point between two steps, of lengths h and `after`."""
    if rise * next_rise <= 0:
        return 0.0
    share = (h + 2 * after) / (3 * (h + after))
    return rise * next_rise / (share * next_rise + (1 - share) * rise)


Law = Propeller | Curve | None


def _number(number: Number) -> sm.Expr:
    return number if isinstance(number, sm.Basic) else sm.Float(number)


def exact(number: Number) -> sm.Expr:
    """A number as an expression, a whole one without a decimal point: zeros and ones vanish from products."""
    if isinstance(number, sm.Basic):
        return number
    return sm.Float(number) if number % 1 else sm.Integer(int(number))
