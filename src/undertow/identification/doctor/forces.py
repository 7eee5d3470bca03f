"""The force that a motion requires against that of the commands; impossible forces and speeds."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import casadi as ca
import numpy as np

from undertow.codegen.engine import at_samples
from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.estimation.inputs import ActuatorStates, without_gaps
from undertow.identification.estimation.test_functions import TestFunctions, knot_spacing
from undertow.identification.findings import Finding, percent
from undertow.identification.logs.guess_rows import are_degrees
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.run import Run
from undertow.model.effect import Curve, Propeller
from undertow.model.effects.thruster_saturation import ThrusterSaturation
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .dynamics import in_other_unit, other_units, rederived
from .kinematics import Kinematics, cached_test_functions, most_active, rms
from .mistakes import (
    PLAUSIBLE,
    RATES,
    SPEEDS,
    UNITS_OF_MOTION,
    Explanation,
    Mistake,
    PlausibilitySettings,
    degrees_of_the_globe,
    likely_time_units,
    names_with_verb,
    reading_mistakes,
    rescaled,
)
from .sensors import SETTINGS as SENSORS
from .sensors import clustered_least_squares, still_good


@dataclass(frozen=True)
class ForceSettings:
    """How forces are compared."""

    # Of test functions, in the narrowest that the sampling allows: what is faster is noise.
    width: float = 2.0
    # Commands that differ by less than this (squared, as a share) count as one: an allocation makes some
    # follow from others.
    distinct: float = 1e-4


FORCES = ForceSettings()


def allocation(vehicle: Vehicle) -> Array:
    """Wrench of one unit of every command in the vehicle's degrees of freedom, shape (n, k), nominal.

    Of a thruster with a curve: of one newton on its curve.
    """
    rows = list(vehicle.dof_indices)
    # What a propeller by revolutions gives depends on the flow, too.
    gains = [0.0 if isinstance(t.law, Propeller) else t.thrust_per_command.value for t in vehicle.thrusters]
    columns = [np.array(t.wrench)[rows] * k for t, k in zip(vehicle.thrusters, gains, strict=True)]
    # What a surface gives depends on the flow, and an input such as the wind is no force.
    columns += [np.zeros(len(rows))] * len(vehicle.surfaces)
    columns += [np.eye(6)["XYZKMN".index(channel[-1])][rows] for channel in vehicle.force_channels]
    columns += [np.zeros(len(rows))] * len(vehicle.inputs)
    return np.array(columns).T.reshape(len(rows), -1)


def thrust_on_curve(curve: Curve, command: Array) -> Array:
    """Thrust of a curve at commands (N,), N."""
    pieces = ((np.clip(command, begin, end) - begin, (0.0, *c)) for begin, end, c in curve.pieces)
    return np.asarray(curve.start + sum(np.polynomial.polynomial.polyval(x, c) for x, c in pieces))


@dataclass(frozen=True)
class ForceTable:
    """Means over test functions: inertial force (K, n), of each command (K, n, c), and the rest (K, k)."""

    force: Array
    commanded: Array
    others: Array


class Forces:
    """Inertial force and that of the commands along logs; actuation that depends on the motion is refused."""

    def __init__(self, vehicle: Vehicle) -> None:
        self.vehicle, self.functions = vehicle, Functions(vehicle)
        self.p = np.array(self.functions.values(), dtype=float)
        self._mass_at = _mass_matrix(self.functions)
        self.mass = self._mass_at(self.p)
        self.chain = ActuatorStates(self.functions, ())

    @cached_property
    def _spread_of_inertia(self) -> Array:
        """Standard deviation of the inertia of every motion by what the file says of its parameters, (n,)."""
        total = np.zeros(len(self.mass))
        for place, name in enumerate(self.functions.parameter_names):
            if sigma := self.vehicle.value_of(name).sigma:
                other = self.p.copy()
                other[place] += sigma
                total += np.diag(self._mass_at(other) - self.mass) ** 2
        return np.sqrt(total)

    def known_within(self, row: int, acting: Sequence[int]) -> tuple[float, float]:
        """Inertia over force of a unit command, at least and at most, as shares of what the file has."""
        vehicle, stated = self.vehicle, PLAUSIBLE.stated
        body = vehicle.values[_INERTIA[vehicle.dof_indices[row]]]
        own, off = self.mass[row, row], stated * self._spread_of_inertia[row]
        # Added mass does not make a body lighter.
        least = max(own - off, body.value - stated * (body.sigma or 0.0))
        gains = [vehicle.thrusters[k].thrust_per_command for k in acting if k < len(vehicle.thrusters)]
        thrust = max((stated * (g.sigma or 0.0) / abs(g.value) for g in gains if g.value), default=0.0)
        most = (own + off) / own / (1.0 - thrust) if thrust < 1.0 else np.inf
        return float(np.clip(least / own, 0.0, 1.0) / (1.0 + thrust)), float(most)

    def table(self, runs: Sequence[Run], samples: int) -> ForceTable | None:
        """The table of so many samples of logs, the most active; None where they are too short."""
        parts = [part for i, run in enumerate(runs) for part in self._parts(run, i, len(runs), samples)]
        return ForceTable(*(np.concatenate(c) for c in zip(*parts, strict=True))) if parts else None

    def _parts(self, run: Run, index: int, count: int, samples: int) -> Iterator[tuple[Array, Array, Array]]:
        velocities, commands = self.vehicle.velocity_names, self.vehicle.command_names
        angles = [n for n in ("phi", "theta") if n in self.vehicle.pose_names and run.has(n)]
        active, force = most_active(run, velocities, samples // count), self.commanded(run)
        for piece in run.segments([*velocities, *commands, *angles]):
            part = slice(max(piece.start, active.start), min(piece.stop, active.stop))
            t = run.t[part]
            functions = (
                cached_test_functions(t, FORCES.width * knot_spacing(run.clock)) if len(t) > 2 else None
            )
            if functions is not None:
                motion = run.matrix([*velocities, *angles])[part]
                yield _means(functions, motion, len(velocities), force[part], self.mass, (index, count))

    def commanded(self, run: Run) -> Array:
        """Force of every command at every sample, (N, n, n_commands); NaN where a command is missing."""
        u = run.matrix(self.vehicle.command_names)
        missing = np.isnan(u)
        actuation = self.chain.along(run.t, without_gaps(u), self.p).value.copy()
        for k, thruster in enumerate(self.vehicle.thrusters):
            if isinstance(thruster.law, Curve):
                actuation[:, k] = thrust_on_curve(thruster.law, actuation[:, k])
        table = np.column_stack([actuation, u[:, len(self.vehicle.actuator_names) :]])
        table = np.where(missing, np.nan, table)
        return np.einsum("Nc,nc->Nnc", table, allocation(self.vehicle))


class StatedForces(Forces):
    """The same with what the whole model says that every command gives: propellers, surfaces, curves, too."""

    def commanded(self, run: Run) -> Array:
        """Force of every command beside those before it, (N, n, n_commands); all inputs count as the last.

        Surfaces come first, in the slipstream that there is: what that does to a rudder is the rudder's.
        """
        u, vehicle = run.matrix(self.vehicle.command_names), self.vehicle
        first, last = len(vehicle.thrusters), len(vehicle.actuator_names)
        own = u.shape[1] - len(vehicle.inputs)
        groups = [[k] for k in (*range(first, last), *range(first), *range(last, own))]
        groups += [list(range(own, u.shape[1]))] if vehicle.inputs else []
        present = without_gaps(u)
        actuation = self.chain.along(run.t, present, self.p).value.copy()
        given = np.zeros((len(u), len(vehicle.dof_indices), u.shape[1]))
        before = self._forcing(run, present, actuation)
        for group in groups:
            present[:, group] = 0.0
            actuation[:, [k for k in group if k < last]] = 0.0
            after = self._forcing(run, present, actuation)
            given[:, :, group[-1]], before = before - after, after
        given[~np.isfinite(u).all(axis=1)] = np.nan
        return given

    def _forcing(self, run: Run, u: Array, actuation: Array) -> Array:
        """Force at rest of the acceleration, (N, n); pose that the log lacks is zero."""
        pose, velocity = run.known(self.vehicle.pose_names), run.matrix(self.vehicle.velocity_names)
        memory = np.zeros((len(run.t), self.functions.memory.shape[0]))
        columns = [pose, velocity, memory, u, self.p, run.t[:, None], actuation]
        return at_samples(self._evaluated, columns, len(run.t))[0]

    @cached_property
    def _evaluated(self) -> ca.Function:
        f = self.functions
        arguments = [f.eta, f.nu, f.memory, f.u, f.p, f.t, f.actuation]
        return ca.Function("forcing", arguments, [ca.densify(f.forcing)])


def _means(
    functions: TestFunctions, motion: Array, n: int, force: Array, mass: Array, run: tuple[int, int]
) -> tuple[Array, Array, Array]:
    """One segment: inertial force, force of the commands, and what else may act."""
    length = np.asarray(functions.value.sum(axis=1)).ravel()
    some = length > 0.0  # with a sample within
    length = length[some, None]
    velocity = motion[:, :n]
    inertial = -(functions.rate @ velocity)[some] / length @ mass.T
    commanded = (functions.held @ force.reshape(len(force), -1))[some] / length
    products = [velocity[:, i] * velocity[:, j] for i, j in combinations(range(n), 2)]
    columns = np.column_stack([motion, np.abs(velocity) * velocity, *products])
    steady = np.zeros((len(length), run[1]))
    steady[:, run[0]] = 1.0
    others = np.column_stack([(functions.value @ columns)[some] / length, steady])
    return inertial, commanded.reshape(len(length), *force.shape[1:]), others


def orthogonal_to(others: Array, columns: Array) -> Array:
    """Columns orthogonalised against others."""
    size = np.linalg.norm(others, axis=0)
    scaled = others[:, size > 0] / size[size > 0]
    return np.asarray(columns - scaled @ np.linalg.lstsq(scaled, columns, rcond=1e-10)[0])


def _mass_matrix(functions: Functions) -> Callable[[Array], Array]:
    """M by the parameters, in the vehicle's upright pose where it depends on that."""
    arguments = [functions.x, functions.u, functions.p, functions.t, functions.actuation]
    evaluate = ca.Function("mass", arguments, [functions.mass_matrix], {"allow_free": False})
    zeros = [np.zeros(a.shape) for a in arguments]
    return lambda p: np.array(evaluate(*zeros[:2], p, *zeros[3:]), dtype=float)


# --- what is impossible, whatever the physics -----------------------------------------------------
_INERTIA = ("m", "m", "m", "I_x", "I_y", "I_z")


@dataclass(frozen=True)
class Response:
    """Response of one motion to one command, or to all of them together."""

    degree_of_freedom: str
    command: str  # the command; empty for all together
    # gain, error: inertial force found per force commanded, 1 as the vehicle file has it, and its standard
    # error.
    gain: float
    error: float
    share: float  # share that the command explains of what nothing else does
    # needed, given: inertial and commanded force or moment, rms, N or N m.
    needed: float
    given: float
    # The gain may be this much smaller or larger for what is not known of inertia and thrust.
    known_within: tuple[float, float] = (1.0, 1.0)

    def is_certain(self, errors: float, share: float) -> bool:
        """Whether the gain exceeds its error, and the command explains part of the motion."""
        return abs(self.gain) > errors * self.error and self.share > share


def _responses(forces: Forces, runs: Sequence[Run]) -> Iterator[Response]:
    """Responses of every motion whose inertia is known to every command and to all together."""
    vehicle, table = forces.vehicle, forces.table(runs, PLAUSIBLE.samples)
    if table is None:
        return
    for row, dof in enumerate(vehicle.dof_indices):
        inertia = vehicle.values.get(_INERTIA[dof])
        if inertia is None or inertia.estimate:  # one that is to be estimated is no evidence
            continue
        given = table.commanded[:, row]
        # Where thrust per command is to be estimated, any unit of the command will do.
        free = {k for k, t in enumerate(vehicle.thrusters) if t.thrust_per_command.estimate}
        acting = [k for k in range(given.shape[1]) if np.any(given[:, k]) and k not in free]
        rest = np.delete(given, acting, axis=1)
        others = np.column_stack([table.others, rest[:, np.any(rest != 0, axis=0)]])
        force = table.force[:, row]
        if len(force) < 2 * (others.shape[1] + len(acting)) or not acting or not np.any(force):
            continue
        motion, known = vehicle.degrees_of_freedom[row], forces.known_within(row, acting)
        if len(acting) > 1:
            yield from _compared(motion, force, others, {"": given[:, acting].sum(axis=1)}, known)
        each = {vehicle.command_names[k]: given[:, k] for k in acting}
        yield from _compared(motion, force, others, each, known)


def _compared(
    motion: str, force: Array, others: Array, commands: dict[str, Array], known: tuple[float, float]
) -> Iterator[Response]:
    """Force of one motion against that of commands, beside what else may act."""
    own = orthogonal_to(others, np.column_stack([force, *commands.values()]))
    found = zip(*_fitted(own[:, 1:], own[:, 0]), strict=True)
    for k, (name, (gain, error, share)) in enumerate(zip(commands, found, strict=True), 1):
        yield Response(motion, name, float(gain), float(error), float(share), *_sizes(own, k), known)


def _sizes(own: Array, command: int) -> tuple[float, float]:
    """What the motion needs and one command gives, rms, beside the other commands.

    So their ratio is no less than the gain, as that of the whole columns may be where others work against it.
    """
    pair, rest = own[:, [0, command]], np.delete(own, [0, command], axis=1)
    alone = orthogonal_to(rest, pair) if rest.any() else pair
    distinct = np.sum(alone[:, 1] ** 2) > FORCES.distinct * np.sum(pair[:, 1] ** 2)
    needed, given = np.sqrt(np.mean((alone if distinct else pair) ** 2, axis=0))
    return float(needed), float(given)


def _fitted(columns: Array, force: Array) -> tuple[Array, Array, Array]:
    """Gains of columns by least squares, their errors, and what share each explains that no other does."""
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    scaled = columns / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=FORCES.distinct, hermitian=True)
    value = inverse @ (scaled.T @ force)
    left = float(np.sum((force - scaled @ value) ** 2))
    more = np.divide(value**2, np.diag(inverse), out=np.zeros_like(value), where=np.diag(inverse) > 0)
    spread = max(np.sqrt(left / len(force)), 1e-9 * float(np.max(np.abs(force))))
    value, error = clustered_least_squares(scaled / spread, force / spread, SENSORS.cluster, FORCES.distinct)
    return value / size, error / size, more / np.maximum(left + more, 1e-300)


def doubtful_unit(
    vehicle: Vehicle, runs: Sequence[Run], mapping: LogMapping, kinematics: Kinematics
) -> Explanation | None:
    """A motion that requires a few times the commanded force, as in a wrong unit; None if none does.

    Parameters are those of `impossible`. Lags and dead times make a motion need less, never more.
    """
    milder = replace(PLAUSIBLE, strongest=PLAUSIBLE.doubtful, near=PLAUSIBLE.unit_tolerance)
    return _PlausibilityCheck(vehicle, list(runs), mapping, kinematics, milder).by_force()


def impossible(
    vehicle: Vehicle, runs: Sequence[Run], mapping: LogMapping, kinematics: Kinematics
) -> Explanation | None:
    """Motion that no vehicle of this mass, thrust and size can have; None if there is none."""
    check = _PlausibilityCheck(vehicle, list(runs), mapping, kinematics, PLAUSIBLE)
    return (
        check.by_place()
        or check.by_curves()
        or check.by_force()
        or check.by_size()
        or check.by_angles()
        or check.by_limits()
    )


_ByKey = dict[tuple[str, str], Response]
"""Responses by motion and command."""


@dataclass(frozen=True)
class _PlausibilityCheck:
    vehicle: Vehicle
    runs: list[Run]
    mapping: LogMapping
    kinematics: Kinematics
    settings: PlausibilitySettings

    # --- force -----------------------------------------------------------------------------------
    def by_force(self) -> Explanation | None:
        """The force that the motion needs, against what the commands give."""
        try:
            forces = Forces(self.vehicle)
        except UndertowError:  # actuation that depends on the motion does not follow from the log alone
            return None
        before = self._certain(_responses(forces, self.runs))
        beyond = {key: r for key, r in before.items() if not self._possible(r)}
        if not beyond:
            return None
        worst = max(beyond.values(), key=lambda r: abs(np.log(abs(r.gain))))
        found = self._explanations(forces, before, beyond)
        if not found:
            return None
        text = f"{found[0].clause}: {_force_text(worst, self.settings)}"
        names = ("gain", "error", "needed", "given")
        return Explanation(found[0], text, {n: getattr(worst, n) for n in names}, found[1:])

    def _certain(self, found: Iterable[Response]) -> _ByKey:
        s = self.settings
        return {(r.degree_of_freedom, r.command): r for r in found if r.is_certain(s.errors, s.share)}

    def _explanations(self, forces: Forces, before: _ByKey, beyond: _ByKey) -> list[Mistake]:
        """Mistakes without which force and motion agree, the simplest first, then the best."""
        found = []
        for place, mistake in enumerate([*self._units_of_motion(), *self._units_of_commands(beyond)]):
            all_after = [*_responses(forces, self.without(mistake))]
            after = self._certain(all_after)
            # Significant responses must remain so: a motion that is scaled away would agree with anything.
            near = all(key in after and _within(after[key].gain, self.settings.near) for key in beyond)
            agree = near and all(key in after for key in before) and all(map(self._possible, after.values()))
            if agree and self._consistent(mistake):
                score = float(np.mean([abs(np.log(abs(after[key].gain))) for key in before]))
                seen = sum(r.is_certain(self.settings.errors / 2, 0.0) for r in all_after)
                found.append(((mistake.count, -seen, round(score, 1), place), mistake))
        return [mistake for _, mistake in sorted(found, key=lambda pair: pair[0])]

    def _possible(self, r: Response) -> bool:
        least, most = r.known_within
        return self.settings.weakest < abs(r.gain) * most and abs(r.gain) * least < self.settings.strongest

    def without(self, mistake: Mistake) -> list[Run]:
        return [rederived(run, mistake.undo) for run in self.runs]

    def _consistent(self, mistake: Mistake) -> bool:
        """Whether pose rates and velocities agree as well without a mistake as with it."""
        if not self.kinematics:
            return True
        given = self.kinematics.mismatch(self.runs).total
        return bool(self.kinematics.mismatch(self.without(mistake)).total < still_good(given))

    def _units_of_motion(self) -> Iterator[Mistake]:
        """Units of what was measured."""
        # Pose rates have been compared with velocities, and so has the clock.
        yield from () if self.kinematics else (m for m, _ in likely_time_units(self.runs, self.mapping))
        known = reading_mistakes(self.mapping, self.runs)
        yield from (m for m in known if m.id in UNITS_OF_MOTION or "degrees" in m.id)

    def _units_of_commands(self, beyond: _ByKey) -> Iterator[Mistake]:
        """Units of commands: those that are known, one command, or all of them times a factor."""
        yield from other_units(self.vehicle, self.runs)
        by_name: dict[str, list[float]] = {}
        for (_, name), r in beyond.items():
            by_name.setdefault(name, []).append(r.gain)
        factors = {name: float(np.median(np.abs(gains))) for name, gains in by_name.items()}
        one = {(name,): factor for name, factor in factors.items() if name}
        everything = {self.vehicle.command_names: float(np.median([*factors.values()]))}
        for names, factor in (one | everything).items():
            if _within(factor, self.settings.command):
                yield scaled_commands(names, factor)

    # --- place -----------------------------------------------------------------------------------
    def by_place(self) -> Explanation | None:
        """A place that hardly changes in m, as one in degrees does; the vehicle heads where it moves."""
        known = [*degrees_of_the_globe(self.mapping, self.runs)]
        if not known or not all(are_degrees(run.t, run.channels) for run in self.runs):
            return None
        found = sorted(known, key=lambda m: sum(rms(run.known(["v"])) for run in self.without(m)))
        return Explanation(found[0], f"{found[0].clause}: in m, the vehicle would hardly move", {}, found[1:])

    # --- size ------------------------------------------------------------------------------------
    def by_size(self) -> Explanation | None:
        """Speeds that a vehicle of this size cannot reach."""
        size = size_of(self.vehicle)
        if size is None:
            return None
        turning = float(np.sqrt(self.settings.turning * self.vehicle.environment["g"] / size))
        limits = {SPEEDS: fastest_speed(self.vehicle, size), RATES: turning}
        for names, limit in limits.items():
            if (fastest := self._fastest(self.runs, names)) > limit:
                return self._too_fast(names, fastest, limit, self.vehicle.values["m"].value)
        return None

    def _fastest(self, runs: Sequence[Run], names: tuple[str, ...]) -> float:
        """Speed, or rate of turn, that the usual share of the samples exceeds."""
        own = [n for n in names if n in self.vehicle.velocity_names]
        if not own:
            return 0.0
        total = np.concatenate([np.sqrt(np.sum(run.matrix(own) ** 2, axis=1)) for run in runs])
        present = total[np.isfinite(total)]
        return float(np.quantile(present, 1.0 - PLAUSIBLE.exceeding)) if len(present) else 0.0

    def _too_fast(
        self, names: tuple[str, ...], value: float, limit: float, mass: float
    ) -> Explanation | None:
        units = (m for m in self._units_of_motion() if self._fastest(self.without(m), names) <= limit)
        found = [m for m in units if self._consistent(m)]
        if not found:
            return None
        unit = "m/s" if names == SPEEDS else "rad/s"
        own = ", ".join(n for n in names if n in self.vehicle.velocity_names)
        why = f"{own} reach {value:.3g} {unit}, but no vehicle of {mass:.4g} kg exceeds {limit:.3g} {unit}"
        return Explanation(found[0], f"{found[0].clause}: {why}", {"value": value, "limit": limit}, found[1:])

    # --- size of the commands --------------------------------------------------------------------
    def by_angles(self) -> Explanation | None:
        """Rudder and fin angles too large for radians: in degrees."""
        limit = self.settings.angle
        sizes = {n: _rms(self.runs, n) for n in self.vehicle.angle_names}
        beyond = {n: size for n, size in sizes.items() if size > limit}
        if not beyond:
            return None
        worst = max(beyond, key=lambda n: beyond[n])
        size, factors = beyond[worst], dict.fromkeys(beyond, float(np.radians(1.0)))
        clause = f"{names_with_verb(tuple(beyond))} in degrees, read as radians"
        mistake = rescaled("command_unit", clause, factors, len(beyond))
        why = f"{worst} is {size:.4g} rad rms, but no rudder or fin turns by more than {limit:.4g} rad"
        return Explanation(mistake, f"{mistake.clause}: {why}", {"value": size, "limit": limit}, [])

    def by_curves(self) -> Explanation | None:
        """Commands as the files of the thrusters' curves have them, and not normalised."""
        known = {t.name: t.normalised_by for t in self.vehicle.thrusters if t.normalised_by is not None}
        most = self.settings.beyond_full_share
        beyond = {n: by for n, by in known.items() if _share_beyond(self.runs, n) > most}
        if not beyond:
            return None
        scales = {n: (1.0 / span, -neutral / span) for n, (neutral, span) in beyond.items()}
        mistake = in_other_unit(f"commands {', '.join(beyond)} are not normalised", scales)
        undone = [mistake.undo(run) for run in self.runs]
        if any(_share_beyond(undone, n) > PLAUSIBLE.over_limit_share for n in beyond):
            return None
        worst = max(beyond, key=lambda n: float(np.ptp(_logged(self.runs, n))))
        logged, neutral = _logged(self.runs, worst), beyond[worst][0]
        span = f"{np.min(logged):.4g} to {np.max(logged):.4g}"
        why = f"{worst} is {span}, as in the file of its curve, whose neutral is {neutral:g}"
        return Explanation(mistake, f"{mistake.clause}: {why}", {"neutral": neutral}, [])

    def by_limits(self) -> Explanation | None:
        """Commands far beyond their limit in the vehicle file."""
        limits = self.vehicle.largest_commands
        beyond = {n: _rms(self.runs, n) / limit for n, limit in limits.items()}
        beyond = {n: ratio for n, ratio in beyond.items() if ratio > self.settings.limit}
        if not beyond:
            return None
        worst = max(beyond, key=lambda n: beyond[n])
        known = []
        for mistake in other_units(self.vehicle, self.runs):
            undone = [mistake.undo(run) for run in self.runs]
            if all(_rms(undone, n) <= self.settings.limit_undone * limit for n, limit in limits.items()):
                known.append(mistake)
        known = known or [scaled_commands(tuple(beyond), float(1.0 / np.median([*beyond.values()])))]
        value, limit = beyond[worst] * limits[worst], limits[worst]
        why = f"{worst} is {value:.4g} rms, but its limit in the vehicle file is {limit:.4g}"
        return Explanation(known[0], f"{known[0].clause}: {why}", {"value": value, "limit": limit}, known[1:])


def size_of(vehicle: Vehicle) -> float | None:
    """Length of the edge of a cube of water of the vehicle's mass, m; None where that mass is not known."""
    known = vehicle.values.get("m")
    if known is None or known.estimate or not known.value > 0:
        return None
    return float(np.cbrt(known.value / vehicle.environment["rho"]))


def fastest_speed(vehicle: Vehicle, size: float) -> float:
    """Speed that no vehicle of that size exceeds, m/s."""
    reached = PLAUSIBLE.froude * np.sqrt(vehicle.environment["g"] * size)
    return float(np.clip(reached, PLAUSIBLE.slowest, PLAUSIBLE.fastest))


def exceeded_limits(vehicle: Vehicle, runs: Sequence[Run]) -> Iterator[Finding]:
    """Commands beyond the limit of their thruster, which the model does not cut off."""
    cut = {t.name for t in vehicle.thrusters if isinstance(t.law, Curve)} | {s.name for s in vehicle.surfaces}
    if any(isinstance(effect, ThrusterSaturation) for effect in vehicle.effects):
        return
    limits = {n: limit for n, limit in vehicle.command_limits.items() if n not in cut}
    over = {n: np.abs(_logged(runs, n)) / limit for n, limit in limits.items()}
    beyond = {n: float(np.mean(ratio > PLAUSIBLE.over_limit)) for n, ratio in over.items() if len(ratio)}
    beyond = {n: share for n, share in beyond.items() if share > PLAUSIBLE.over_limit_share}
    if not beyond:
        return
    worst = max(beyond, key=lambda n: beyond[n])
    most, limit = limits[worst] * float(np.max(over[worst])), limits[worst]
    yield Finding(
        id="limits_exceeded",
        severity="warning",
        text=f"commands exceed the limit in the vehicle file and the model does not cut them off: {worst} in "
        f"{percent(beyond[worst])} of the samples, up to {most:.4g}, limit {limit:.4g}"
        + (f" (also {', '.join(n for n in beyond if n != worst)})" if len(beyond) > 1 else "")
        + "; if the thruster cuts them off, undertow add thruster_saturation, else correct the limit, or the "
        "scale in the mapping file",
        evidence={"share": beyond[worst], "limit": limit},
    )


def _share_beyond(runs: Sequence[Run], name: str) -> float:
    """Share of the samples of a command that are far beyond full power."""
    logged = _logged(runs, name)
    return float(np.mean(np.abs(logged) > PLAUSIBLE.beyond_full)) if len(logged) else 0.0


def _logged(runs: Sequence[Run], name: str) -> Array:
    """A command where it was logged."""
    data: Array = np.concatenate([run.channels[name] for run in runs])
    return data[np.isfinite(data)]


def _within(gain: float, factor: float) -> bool:
    return 1.0 / factor < abs(gain) < factor


def _rms(runs: Sequence[Run], name: str) -> float:
    present = _logged(runs, name)
    return float(np.sqrt(np.mean(present**2))) if len(present) else 0.0


def scaled_commands(names: tuple[str, ...], found: float) -> Mistake:
    """Commands too large or too small by a factor, rounded if near a power of ten."""
    ten = 10.0 ** round(np.log10(found))
    factor = ten if max(found / ten, ten / found) < PLAUSIBLE.power_of_ten else float(f"{found:.2g}")

    which = f"command {names[0]} is" if len(names) == 1 else f"commands {', '.join(names)} are"
    size = f"{1 / factor:.4g} times too large" if factor < 1 else f"{factor:.4g} times too small"
    clause = f"{which} {size}"
    # It explains whatever one of the known units would, which comes first.
    return rescaled("command_unit", clause, dict.fromkeys(names, factor), 1 + len(names))


def _force_text(r: Response, settings: PlausibilitySettings) -> str:
    what = f"command {r.command} gives" if r.command else "the commands give"
    unit = "N" if r.degree_of_freedom in ("surge", "sway", "heave") else "N m"
    least, most = settings.weakest / r.known_within[1], settings.strongest / r.known_within[0]
    ratio, limit = f"{abs(r.gain):.3g} of what {what}", f"at least {least:.3g}"
    if abs(r.gain) > 1:
        ratio, limit = f"{abs(r.gain):.3g} times what {what}", f"at most {most:.3g}"
    forces = f"{r.needed:.3g} {unit} against {r.given:.3g} {unit} rms"
    return f"the {r.degree_of_freedom} of the log needs {ratio} ({forces}; {limit} can be)"
