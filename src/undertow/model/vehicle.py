"""A vehicle: a set of effects whose wrenches sum to zero, and everything derived from the sum."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import sympy as sm

from undertow.errors import UndertowError
from undertow.notebook import html

from .composition import Composition
from .effect import Actuation, Curve, Effect, Law, Measurement, Propeller, Surface, exact
from .effects.control_surfaces import ControlSurfaces
from .effects.generalised_force import GeneralisedForce
from .effects.propellers import Propellers
from .effects.steering_gear import SteeringGear
from .effects.thrusters import Thrusters
from .parameter import DIRECTIONS, Parameter
from .symbols import CHANNELS, DOFS, ENVIRONMENT, FORCE, FORCE_UNITS, MOTION_UNITS, POSE, VELOCITY, symbol
from .units import short_unit


@dataclass(frozen=True)
class Value:
    """Value of a parameter in SI and SNAME signs, with its uncertainty."""

    value: float
    estimate: bool = False  # whether a fit may change it
    sigma: float | None = None  # standard deviation of the number as stated (prior) or as fitted
    source: str = ""  # where it comes from
    assumed: bool = False  # true where no source gives the number
    # true: it has a value of its own in every run; false: never; None: as runs and effect show
    per_run: bool | None = None


@dataclass(frozen=True)
class Thruster:
    """One thruster: the log column of its command and the wrench of one newton of its thrust."""

    name: str
    wrench: tuple[float, ...]  # force and moment per unit of thrust, body frame, (1, 1, 1, m, m, m)
    thrust_per_command: Value = Value(1.0)  # thrust per unit of command, N
    limit: float | None = None  # largest magnitude of the command
    lowest: float | None = None  # lowest command of one that cannot do as much in reverse; None: -limit
    law: Law = None  # how the command becomes thrust; None: in proportion
    command_unit: str = "command"  # unit of the command
    # where it is, body frame, m; none where the file states the wrench itself
    position: tuple[float, float, float] | None = None
    # neutral and span, in the commands of the file of its curve, by which these are normalised to -1 ... 1
    # about neutral; none where the neutral command is zero
    normalised_by: tuple[float, float] | None = None

    @property
    def unit(self) -> str:
        """The same, N where one unit of the command is one newton of thrust."""
        return "N" if self.law is None and self.thrust_per_command.value == 1.0 else self.command_unit

    @property
    def is_moment(self) -> bool:
        """Whether one unit of its thrust is a moment of 1 N m about one axis, and no force."""
        return not any(self.wrench[:3]) and sorted(map(abs, self.wrench[3:])) == [0.0, 0.0, 1.0]

    @property
    def idle(self) -> bool:
        """Whether its command gives no thrust, as that of a fin at rest."""
        gain = self.thrust_per_command
        return self.law is None and gain.value == 0.0 and not gain.estimate


# Where a vehicle file states the hardware that an effect stands for.
_HARDWARE_TABLES = {Thrusters.id: "[[thrusters]]", ControlSurfaces.id: "[[surfaces]]"}


def _refuse_twice(names: Iterable[str], complaint: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise UndertowError(complaint.format(name))
        seen.add(name)


# Vehicles that differ in their values alone, as those of a fit do, have their equations in common.
_composed = lru_cache(maxsize=128)(Composition)


@dataclass(frozen=True, repr=False)
class Vehicle:
    """A marine vehicle as a sum of effects, for any subset of the six degrees of freedom.

    Attributes
    ----------
    name : str
        Name of the vehicle.
    degrees_of_freedom : tuple of str
        Subset of surge, sway, heave, roll, pitch, yaw, in this order.
    effects : tuple of Effect
        The effects, without those that come with the thrusters.
    values : mapping
        Value of every parameter, by name.
    thrusters : tuple of Thruster
        Thrusters in the order of their commands.
    force_channels : tuple of str
        Log channels with forces known directly (tau_X ...).
    signs : str
        Convention of the vehicle's file: "sname" or "magnitudes".
    environment : mapping
        `rho` in kg/m^3 and `g` in m/s^2.
    surfaces : tuple of Surface
        Control surfaces in the order of their commands, which follow those of the thrusters.
    inputs : mapping
        Logged quantities that effects take as inputs (wind, voltage ...), with their SI units.
    fitted_to : mapping
        Hashes (sha256) of the logs that values with their standard deviations were fitted to, by name.
    follows : mapping
        Parameters that follow from another one, with its name and the factor, SI: W = 9.81 m.
    velocity_along_earth : bool
        Whether the logged body velocity was reported along earth axes and rotated by the reported attitude,
        so that an attitude error rotates the velocity, too.
    derived_velocities : tuple of str
        Velocities that were not measured but derived from the reported pose, so that its errors are in them
        and those of velocity sensors are not.
    excluded_effects : tuple of str
        Ids of effects that this vehicle cannot have, such as those of a tether: no diagnosis tries them.
    """

    name: str
    degrees_of_freedom: tuple[str, ...]
    effects: tuple[Effect, ...]
    values: Mapping[str, Value]
    thrusters: tuple[Thruster, ...] = ()
    force_channels: tuple[str, ...] = ()
    signs: str = "sname"
    environment: Mapping[str, float] = field(
        default_factory=lambda: {"rho": ENVIRONMENT.density, "g": ENVIRONMENT.gravity}
    )
    surfaces: tuple[Surface, ...] = ()
    inputs: Mapping[str, str] = field(default_factory=dict)
    fitted_to: Mapping[str, frozenset[str]] = field(default_factory=dict, compare=False)
    follows: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    velocity_along_earth: bool = False
    derived_velocities: tuple[str, ...] = ()
    excluded_effects: tuple[str, ...] = ()

    def __repr__(self) -> str:
        parts = {
            "thrusters": [t.name for t in self.thrusters],
            "surfaces": [s.name for s in self.surfaces],
            "inputs": [*self.inputs],
            "effects": [e.id for e in self.effects],
        }
        listed = (f"{what} {', '.join(names)}" for what, names in parts.items() if names)
        return "; ".join([f"Vehicle {self.name}: {', '.join(self.degrees_of_freedom)}", *listed])

    def _repr_html_(self) -> str:
        head = ("parameter", "value (SNAME signs)", "unit", "std. deviation", "estimated", "source")
        return html(repr(self), head, (self._shown(name) for name in self.values))

    def _shown(self, name: str) -> tuple[object, ...]:
        """Row of a parameter for a notebook."""
        value, parameter = self.values[name], self.parameter_of(name)
        unit = short_unit(parameter.unit) if parameter else ""
        return name, value.value, unit, value.sigma, "yes" if value.estimate else "", value.source

    def __post_init__(self) -> None:
        self._check_names()
        self._check_requirements()

    def _check_names(self) -> None:
        _refuse_twice(self.degrees_of_freedom, "degrees_of_freedom has '{}' twice: keep one")
        _refuse_twice(self.force_channels, "generalised_forces has '{}' twice: keep one")
        thrusters, surfaces = [t.name for t in self.thrusters], [s.name for s in self.surfaces]
        for kind, names in (("thruster", thrusters), ("surface", surfaces)):
            _refuse_twice(names, f"two {kind}s are called '{{}}': rename one")
            for name in (CHANNELS | {*self.inputs}).intersection(names):
                raise UndertowError(f"{kind} '{name}' has the name of a measured channel: rename it")
        _refuse_twice(self.actuator_names, "a thruster and a surface are called '{}': rename one")
        _refuse_twice(self._quantities(), "two quantities of the vehicle are called '{}': rename one")

    def _quantities(self) -> Iterator[str]:
        """Names of states and parameters, and of both directions of those that may differ."""
        for effect in self.effects:
            yield from effect.states
            for p in effect.parameters:
                yield from (p.name, *(f"{p.name}_{way}" for way in DIRECTIONS if p.motion is not None))

    def _check_requirements(self) -> None:
        for effect in self.effects:
            if effect.id in self.excluded_effects:
                raise UndertowError(
                    f"excluded_effects of vehicle '{self.name}' names '{effect.id}': remove it there, "
                    f"or remove [effects.{effect.id}]"
                )
            missing = self.lacks(effect)
            if missing:
                table = _HARDWARE_TABLES.get(missing[0], f"[effects.{missing[0]}]")
                raise UndertowError(
                    f"effect '{effect.id}' shares parameters of '{missing[0]}', which vehicle '{self.name}' "
                    f"lacks: add {table} to the vehicle file"
                )

    def lacks(self, effect: Effect | type[Effect]) -> list[str]:
        """Ids of the effects that `effect` requires and the vehicle does not have; thrusters count as one."""
        present = {e.id for e in self.all_effects}
        return [r for r in effect.requires if r not in present]

    @property
    def dof_indices(self) -> tuple[int, ...]:
        """Places of the degrees of freedom among the six."""
        return tuple(DOFS.index(d) for d in self.degrees_of_freedom)

    @property
    def pose_names(self) -> tuple[str, ...]:
        """Names of the pose coordinates that the vehicle has."""
        return tuple(POSE[i] for i in self.dof_indices)

    @property
    def velocity_names(self) -> tuple[str, ...]:
        """Names of the body velocities that the vehicle has."""
        return tuple(VELOCITY[i] for i in self.dof_indices)

    @property
    def actuator_names(self) -> tuple[str, ...]:
        """Names of the thrusters, then of the control surfaces."""
        return (*(t.name for t in self.thrusters), *(s.name for s in self.surfaces))

    @property
    def command_names(self) -> tuple[str, ...]:
        """Log columns that drive the model: thruster commands, angles of surfaces, known forces, inputs."""
        return (*self.actuator_names, *self.force_channels, *self.inputs)

    @property
    def command_units(self) -> dict[str, str]:
        """Unit of each of `command_names`; "command" is the thruster's own."""
        forces = dict(zip((f"tau_{f}" for f in FORCE), FORCE_UNITS, strict=True))
        units = {t.name: t.command_unit for t in self.thrusters} | dict.fromkeys(self.angle_names, "rad")
        return units | {n: forces[n] for n in self.force_channels} | dict(self.inputs)

    @property
    def input_units(self) -> dict[str, str]:
        """The same, N where one unit of a command is one newton of thrust."""
        return self.command_units | {t.name: "N" for t in self.thrusters if t.unit == "N"}

    @property
    def angle_names(self) -> tuple[str, ...]:
        """Commands that are angles: of surfaces, and of actuators that push by `rudder_force` alone."""
        fins = (t.name for t in self.thrusters if t.idle and f"rudder_{t.name}" in self.values)
        return (*fins, *(s.name for s in self.surfaces))

    @property
    def command_limits(self) -> dict[str, float]:
        """Largest magnitude of the commands for which a limit is stated."""
        limits = {t.name: t.limit for t in self.thrusters} | {s.name: s.limit for s in self.surfaces}
        return {name: float(limit) for name, limit in limits.items() if limit is not None}

    @property
    def lowest_commands(self) -> dict[str, float]:
        """Lowest commands: as stated, zero where a curve of thrust begins there, or minus the limit."""
        curves = {t.name: t.law.pieces[0][0] for t in self.thrusters if isinstance(t.law, Curve)}
        one_sided = {name: begin for name, begin in curves.items() if begin == 0.0}
        stated = {t.name: t.lowest for t in self.thrusters if t.lowest is not None}
        return {name: -most for name, most in self.largest_commands.items()} | one_sided | stated

    @property
    def largest_commands(self) -> dict[str, float]:
        """The same, and for commands without one the end of their curve, if that holds zero."""
        curves = {t.name: t.law for t in self.thrusters if isinstance(t.law, Curve)}
        ends = {n: c.largest for n, c in curves.items() if c.pieces[0][0] <= 0.0 <= c.pieces[-1][1]}
        return ends | self.command_limits

    @cached_property
    def all_effects(self) -> tuple[Effect, ...]:
        """The effects with those that the hardware brings in."""
        present = {e.id for e in self.effects}
        # A file may state the parameters of the steering gear with the surfaces themselves.
        gear = self.equipped(SteeringGear).parameters
        geared = SteeringGear.id not in present and any(p.name in self.values for p in gear)
        hardware = {
            Thrusters: bool(self.thrusters),
            Propellers: any(isinstance(law, Propeller) for law in self.laws),
            ControlSurfaces: bool(self.surfaces),
            SteeringGear: geared,
            GeneralisedForce: bool(self.force_channels),
        }
        effects = (*self.effects, *(self.equipped(cls) for cls, there in hardware.items() if there))
        allocation, inputs = self.allocation, tuple(self.inputs)
        return tuple(e.placed(allocation, self.surfaces, inputs, self.laws) for e in effects)

    @property
    def laws(self) -> tuple[Law, ...]:
        """How the command of each thruster becomes thrust; None where it is in proportion."""
        return tuple(t.law for t in self.thrusters)

    def equipped(self, cls: type[Effect]) -> Effect:
        """An effect with the hardware of this vehicle."""
        return cls(tuple(t.name for t in self.thrusters), self.surfaces, tuple(self.inputs))

    @cached_property
    def allocation(self) -> sm.Matrix:
        """Force and moment of one newton of thrust of each thruster, shape (6, n_thrusters), 1 and m."""
        columns = [[exact(v) for v in t.wrench] for t in self.thrusters]
        return sm.Matrix(columns).T if columns else sm.zeros(6, 0)

    @cached_property
    def composition(self) -> Composition:
        """The effects put together, symbolically."""
        split = ((name, tuple(symbol(f"{name}_{way}") for way in DIRECTIONS)) for name in self._directional)
        return _composed(
            self.all_effects,
            self.dof_indices,
            tuple(t.name for t in self.thrusters),
            tuple(f"tau_{n[-1]}" for n in self.force_channels),
            tuple(split),
            tuple(s.name for s in self.surfaces),
            tuple(self.inputs),
            velocity_along_earth=self.velocity_along_earth,
            derived=tuple(VELOCITY.index(n) for n in self.derived_velocities),
        )

    @cached_property
    def _directional(self) -> tuple[str, ...]:
        given = (self.sides[n] for n in self.values if n in self.sides)
        return tuple(parameter.name for parameter, way in given if way == "forward")

    @cached_property
    def declared_parameters(self) -> dict[str, Parameter]:
        """Every scalar parameter that the effects of the vehicle declare, by name."""
        return {p.name: p for e in self.all_effects for p in e.parameters}

    @cached_property
    def sides(self) -> dict[str, tuple[Parameter, str]]:
        """Parameter and direction, "forward" or "backward", of every name that a value for one may have."""
        declared = self.declared_parameters
        split = [p for p in declared.values() if p.motion is not None]
        named = {f"{p.name}_{way}": (p, way) for p in split for way in DIRECTIONS}
        return {name: side for name, side in named.items() if name not in declared}

    def parameter_of(self, name: str) -> Parameter | None:
        """The declaration behind the name of a value, which may be for one direction; None without any."""
        known = name in self.sides or name in self.declared_parameters
        return self.declaration(name) if known else None

    def declaration(self, name: str) -> Parameter:
        """The declaration behind the name of a value that the vehicle has.

        Raises
        ------
        KeyError
            If none of its effects declares it.
        """
        return self.sides[name][0] if name in self.sides else self.declared_parameters[name]

    def values_of(self, parameter: Parameter) -> dict[str, Value]:
        """Stated value of a parameter: its "value", or "forward" and "backward"; or nothing."""
        ways = {f"{parameter.name}_{way}": way for way in DIRECTIONS if parameter.motion is not None}
        named = {parameter.name: "value"} | ways
        return {key: self.values[name] for name, key in named.items() if name in self.values}

    def value_of(self, name: str) -> Value:
        """Value of a parameter: as stated, or for thrust its thruster's, or the default of the effect."""
        if name in self.values:
            return self.values[name]
        for thruster in self.thrusters:
            if name == f"thrust_{thruster.name}":
                return thruster.thrust_per_command
        if name in self.environment:
            return Value(self.environment[name])
        return Value(self.declared_parameters[name].effective_default)

    def differs_between_runs(self, name: str) -> bool:
        """Whether a parameter may have another value in every run: by its file, or else by its effect."""
        stated, parameter = self.value_of(name).per_run, self.parameter_of(name)
        return stated if stated is not None else parameter is not None and parameter.per_run

    @cached_property
    def parameter_names(self) -> tuple[str, ...]:
        """Parameters that the equations of this vehicle contain, in order of the effects."""
        return self.composition.parameter_names

    # --- the model, derived -------------------------------------------------------------------
    @cached_property
    def residual(self) -> sm.Matrix:
        """Sum of all wrenches in the vehicle's degrees of freedom, zero for the true motion, N and N m."""
        return self.composition.residual

    @cached_property
    def mass_matrix(self) -> sm.Matrix:
        """M = -d(residual)/d(nu_dot), shape (n, n)."""
        return self.composition.mass_matrix

    @cached_property
    def forcing(self) -> sm.Matrix:
        """Residual at nu_dot = 0, so that M nu_dot = forcing."""
        return self.composition.forcing

    def power(self) -> dict[str, sm.Expr]:
        """Power nu' tau of every wrench at nu_dot = 0, W, by effect id."""
        nu = self.composition.nu
        rest = {a: sm.Integer(0) for a in self.composition.nu_dot}
        return {e.id: (nu.T * w.xreplace(rest))[0] for e, w in self.composition.wrenches.items()}

    # --- other vehicles -----------------------------------------------------------------------
    def with_values(self, values: Mapping[str, Value]) -> Vehicle:
        """The same vehicle with some values replaced, and what follows them.

        Thrust per command goes to its thruster.
        """
        thrusters = tuple(
            replace(t, thrust_per_command=values.get(f"thrust_{t.name}", t.thrust_per_command))
            for t in self.thrusters
        )
        hardware = {f"thrust_{t.name}" for t in thrusters}
        changed = dict(self.values) | {k: v for k, v in values.items() if k not in hardware}
        for name, (other, factor) in self.follows.items():
            if other in values and name in changed and name not in values:
                changed[name] = replace(changed[name], value=factor * values[other].value)
        return replace(self, values=changed, thrusters=thrusters)

    @property
    def tied(self) -> dict[str, tuple[str, float]]:
        """Parameters in the equations that follow one that a fit may move."""
        names = set(self.parameter_names)
        return {
            name: (other, factor)
            for name, (other, factor) in self.follows.items()
            if {name, other} <= names and self.values[other].estimate
        }

    def constrained(self, free: Iterable[str], moved: Iterable[str] = (), *, pushed: bool = False) -> Vehicle:
        """The vehicle on a rig (towing carriage, planar motion mechanism) that leaves some motions free.

        The others are at rest, except for the channels in `moved`, which are in the log. `pushed`: the rig
        drives the free motions by known forces and measures them; its actuators and sensors are off.
        """
        motions = tuple(d for d in self.degrees_of_freedom if d in set(free))
        own = [f"tau_{FORCE[DOFS.index(d)]}" for d in motions]
        inputs = dict(self.inputs) | {name: MOTION_UNITS[name] for name in moved}
        forces = tuple(n for n in own if pushed or n in self.force_channels)
        alone = replace(self, degrees_of_freedom=motions, inputs=inputs, force_channels=forces)
        if not pushed:
            return alone
        hardware = {*_HARDWARE_TABLES, Propellers.id}
        effects = (e for e in self.effects if not isinstance(e, Actuation | Measurement))
        kept = tuple(e for e in effects if not hardware.intersection(e.requires))
        return replace(alone, thrusters=(), surfaces=(), effects=kept)

    def without_priors_from(self, logs: Iterable[str]) -> Vehicle:
        """The vehicle without standard deviations of values that were fitted to one of these logs (sha256).

        A value fitted to a log is not a prior for another fit to the same log, only a starting value.
        """
        read = {sha256 for sha256 in logs if sha256}
        known = [name for name, own in self.fitted_to.items() if own & read]
        return self.with_values({n: replace(self.value_of(n), sigma=None) for n in known})

    def with_effect(self, cls: type[Effect], values: Mapping[str, Value]) -> Vehicle:
        """The vehicle with one more effect (or more parameters of one that it has)."""
        present = any(e.id == cls.id for e in self.effects)
        effects = self.effects if present else (*self.effects, self.equipped(cls))
        return replace(self, effects=effects, values=dict(self.values) | dict(values))
