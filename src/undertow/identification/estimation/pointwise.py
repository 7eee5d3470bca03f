"""Terms of the weak form at one sample, and bounds on parameters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite, sqrt

import casadi as ca
import numpy as np

from undertow.codegen.engine import call
from undertow.codegen.functions import Functions, solve_symmetric
from undertow.model.effect import VehicleSize, Wrench
from undertow.model.parameter import Limits, Parameter
from undertow.model.units import dimension
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

# --- natural sizes of parameters ------------------------------------------------------------------
_LIMITS = Limits()


def largest_values(functions: Functions, names: Sequence[str]) -> Array:
    """Largest magnitude of parameters for a vehicle of this size, SI; infinite if unlimited.

    That is `Parameter.within` times the natural size: the product of powers of the vehicle's mass, length
    and the time sqrt(length / g) that has the parameter's unit. The length is the edge of a cube of water as
    heavy as the vehicle or its radius of gyration, whichever is larger; for a coefficient of moments alone
    the square of the length is that of the radius of gyration about these axes. A larger stated value counts
    as the size itself; a fitted one does not, or every fit could go ten times as far.
    """
    vehicle = functions.vehicle
    known = {n: v.value for n, v in vehicle.values.items()} | dict(vehicle.environment)
    size = next((b for e in vehicle.effects if (b := e.vehicle_size(known)) is not None), None)
    if size is None or not names:
        return np.full(len(names), inf)
    acts = _affected_motions(functions, names)
    return np.array([_largest(vehicle, n, size, known, rows) for n, rows in zip(names, acts, strict=True)])


def scale_directions(functions: Functions, names: Sequence[str], p: Array) -> dict[str, Array]:
    """By degree of freedom, the change of free parameters that scales all of its forces by one factor.

    Its inertia grows with them, so that the motion stays the same, unless a force in it is known. Degrees of
    freedom whose inertia is known are left out. Entries of a direction (k,) are in the order of `names`.
    """
    f = functions
    places = [f.parameter_names.index(n) for n in names]
    acts = _affected_motions(f, names) if names else []
    inertia = ca.diag(f.mass_matrix)
    at_rest = [ca.SX.zeros(x.shape) for x in (f.eta, f.nu, f.t)]
    inertia = ca.substitute(inertia, ca.vertcat(f.eta, f.nu, f.t), ca.vertcat(*at_rest))
    outputs = [ca.densify(inertia), ca.densify(ca.jacobian(inertia, f.p))]
    mass, slope = (np.asarray(v) for v in ca.Function("inertia", [f.p], outputs)(p))
    found = {}
    for i, (dof, place) in enumerate(zip(f.vehicle.degrees_of_freedom, f.vehicle.dof_indices, strict=True)):
        own = np.array([rows == {place} for rows in acts], dtype=float)
        share = slope[i, places] * own
        if np.any(share):
            still = np.where(share != 0.0, 0.0, p[places]) * own
            found[dof] = still + share * mass[i, 0] / float(share @ share)
    return found


def _affected_motions(functions: Functions, names: Sequence[str]) -> list[set[int]]:
    """Which motions, of the six, each parameter acts on directly."""
    free = ca.vertcat(*[functions.p[functions.parameter_names.index(n)] for n in names])
    pattern = ca.jacobian_sparsity(functions.residual, free)
    found: list[set[int]] = [set() for _ in names]
    for row, column in zip(pattern.row(), pattern.get_col(), strict=True):
        found[column].add(functions.vehicle.dof_indices[row])
    return found


def _largest(
    vehicle: Vehicle, name: str, size: VehicleSize, known: dict[str, float], rows: set[int]
) -> float:
    parameter, stated = vehicle.declaration(name), abs(vehicle.value_of(name).value)
    natural = _natural_size(parameter, size, known, rows)
    if not natural or not isfinite(stated):
        return inf
    if parameter.arm_of:  # the vehicle is no longer for a value that is stated or was fitted
        return max(_LIMITS.aboard * natural, stated)
    within = parameter.within
    return max(within * natural, stated) if name in vehicle.fitted_to else within * max(natural, stated)


def _natural_size(parameter: Parameter, size: VehicleSize, known: dict[str, float], rows: set[int]) -> float:
    """Natural size of a parameter; zero if the vehicle does not determine it."""
    length = max(size.length, size.gyration)
    if parameter.arm_of:
        return length * (1.0 if parameter.arm_of == "1" else known.get(parameter.arm_of, 0.0))
    # A parameter with starting values or two bounds is a shape parameter: its declaration gives its range.
    if not parameter.linear or all(map(isfinite, parameter.bounds)):
        return 0.0
    powers = {str(base): float(str(power)) for base, power in dimension(parameter.unit).items()}
    if set(powers) - {"[mass]", "[length]", "[time]"}:
        return 0.0
    seconds = sqrt(length / known["g"])
    mass, arm, time = (powers.get(f"[{base}]", 0.0) for base in ("mass", "length", "time"))
    whole = size.mass**mass * length**arm * seconds**time
    return whole * (_gyration(size.mass, known, rows) / length) ** 2 if rows and min(rows) > 2 else whole


def _gyration(mass: float, known: dict[str, float], rows: set[int]) -> float:
    """Largest radius of gyration about the axes of these moments, m."""
    return sqrt(max(known.get(f"I_{'xyz'[row - 3]}", 0.0) for row in rows) / mass)


# --- terms at a sample ----------------------------------------------------------------------------
class Pointwise:
    """Terms of the weak form at a sample, for one vehicle.

    The measured pose and velocity are first turned back into the true ones (inverse of the measurement
    effects). Rows: velocity, acceleration by all forces but the commands, pose, pose rate, acceleration by
    the commands; n rows each. The equations of motion are divided by the mass matrix: their noise then hardly
    depends on the parameters, and least squares is not biased to small inertia, as it is if the noise is
    multiplied by estimated parameters.

    `free` holds the places in p of the parameters that derivatives are taken in; `actuators_vary` says
    whether what reaches the thrusters depends on any of these, or on states.
    """

    def __init__(self, functions: Functions, free: tuple[int, ...], *, actuators_vary: bool = True) -> None:
        self.functions, self.free, self.actuators_vary = functions, free, actuators_vary
        self.size = len(functions.vehicle.dof_indices)
        self.measured = ca.SX.sym("measured", 2 * self.size)
        self.jump = ca.SX.sym("jump", self.size)
        self.delay = ca.SX.sym("delay")
        # Every segment of a log asks for the same one.
        self._last_inverse: tuple[bytes, Array] = (b"", np.zeros(0))

    @cached_property
    def inverse(self) -> ca.SX:
        """Inverse of the mass matrix: a number from outside where it does not depend on the motion."""
        if self.mass_is_constant:
            return ca.SX.sym("inverse", self._inverse_pattern)
        return solve_symmetric(self._true(self.functions.mass_matrix), ca.SX.eye(self.size))

    @cached_property
    def mass_is_constant(self) -> bool:
        """Whether the mass matrix is the same at all samples."""
        f = self.functions
        return not ca.depends_on(ca.vec(f.mass_matrix), ca.vertcat(f.eta, f.nu, f.t))

    @cached_property
    def _inverse_pattern(self) -> ca.Sparsity:
        """Where the inverse of the mass matrix can differ from zero: between motions that inertia couples."""
        one = ca.DM(self.functions.mass_matrix.sparsity(), 1)
        reach = ca.DM.eye(self.size) + one + one.T
        for _ in range(self.size):
            reach = reach @ reach > 0
        return ca.sparsify(ca.DM(reach)).sparsity()

    def mass_inverse(self, p: Array) -> Array:
        """Nonzeros of `inverse` at parameters p; empty where it varies from sample to sample."""
        if not self.mass_is_constant:
            return np.zeros(0)
        key = p.tobytes()
        if self._last_inverse[0] != key:
            (mass,) = call(self._mass, [p])
            inverse = np.linalg.inv(mass.reshape(self.size, self.size))
            self._last_inverse = key, inverse[self._inverse_pattern.row(), self._inverse_pattern.get_col()]
        return self._last_inverse[1]

    @cached_property
    def _mass(self) -> ca.Function:
        return ca.Function("mass", [self.functions.p], [ca.densify(self.functions.mass_matrix)])

    def _true(self, expression: ca.SX, change: ca.SX | None = None) -> ca.SX:
        """An expression at the true motion, or at one that is faster by so much."""
        f, motion = self.functions, self.true_motion
        if change is not None:
            motion = ca.vertcat(motion[: self.size], motion[self.size :] + change)
        return ca.substitute(expression, ca.vertcat(f.eta, f.nu), motion)

    @cached_property
    def _uncommanded(self) -> tuple[ca.SX, ca.SX]:
        """Forcing without the commands, and pose rate, at the velocity that quadrature wants.

        Where the commands jump, velocity has a kink, and so has what depends on it. A sum over samples h
        apart is off by h^2/12 times the jump of the slope there, and right again if the value there is that
        at a velocity which is more by h/12 times the jump of the acceleration.
        """
        f, change = self.functions, self.delay * self.jump
        uncommanded = ca.substitute(f.forcing, self._drive, ca.SX.zeros(self._drive.shape))
        return self._true(uncommanded, change), self._true(f.pose_rate, change)

    @cached_property
    def _commanded(self) -> ca.SX:
        """Forcing by the commands."""
        return self._true(self._by_commands)

    @cached_property
    def _rows(self) -> ca.SX:
        f, (uncommanded, rate) = self.functions, self._uncommanded
        velocity, pose = self._true(f.nu), self._true(f.eta)
        rows = ca.vertcat(velocity, self.inverse @ uncommanded, pose, rate, self.inverse @ self._commanded)
        return ca.cse(self._with_jump(rows))

    @cached_property
    def _force_jump(self) -> ca.SX:
        """Jump of the force of the commands since what the drive was before."""
        return self._commanded - ca.substitute(self._commanded, self._drive, self.previous)

    def _with_jump(self, expression: ca.SX) -> ca.SX:
        """An expression with the jump of the acceleration put in its place."""
        return ca.substitute(expression, self.jump, ca.densify(self.inverse @ self._force_jump))

    def _slope(self, variables: ca.SX) -> ca.SX:
        """Derivative of the rows: that of an acceleration M^-1 h is M^-1 (dh - dM M^-1 h)."""
        f, (uncommanded, rate) = self.functions, self._uncommanded
        velocity, pose = (ca.jacobian(self._true(e), variables) for e in (f.nu, f.eta))
        jump = self._slope_of(self._force_jump, variables)
        force = (
            self._slope_of(uncommanded, variables) + self.inverse @ ca.jacobian(uncommanded, self.jump) @ jump
        )
        rates = ca.jacobian(rate, variables) + ca.jacobian(rate, self.jump) @ jump
        driven = self._slope_of(self._commanded, variables)
        return self._with_jump(ca.vertcat(velocity, force, pose, rates, driven))

    def _slope_of(self, force: ca.SX, variables: ca.SX) -> ca.SX:
        """Derivative of M^-1 h."""
        acceleration = ca.SX.sym("acceleration", self.size)
        slope = ca.jacobian(force - self._true(self.functions.mass_matrix) @ acceleration, variables)
        # Without commands, a force may be empty.
        return self.inverse @ ca.substitute(slope, acceleration, ca.densify(self.inverse @ force))

    @cached_property
    def previous(self) -> ca.SX:
        """The drive before the sample."""
        return ca.SX.sym("previous", self._drive.shape[0])

    @cached_property
    def _drive(self) -> ca.SX:
        f = self.functions
        return ca.vertcat(f.actuation, f.u[f.actuation.shape[0] :, :])  # a single entry [1:] is a row

    @cached_property
    def _by_commands(self) -> ca.SX:
        """Part of the forcing due to the commands."""
        f = self.functions
        slope = ca.jacobian(f.forcing, self._drive)
        if not ca.depends_on(slope, ca.vertcat(self._drive, f.eta, f.nu)):
            return slope @ self._drive
        return f.forcing - ca.substitute(f.forcing, self._drive, ca.SX.zeros(self._drive.shape))

    @cached_property
    def true_motion(self) -> ca.SX:
        """Pose and velocity from sensor reports: the attitude first, since all else may depend on it."""
        f = self.functions
        motion, places = ca.vertcat(f.eta, f.nu), range(2 * self.size)
        turned = [i for i, dof in enumerate(f.vehicle.dof_indices) if dof > 2]
        others = [i for i in places if i not in turned]
        attitude = _solved(f.reported[turned], motion[turned], self.measured[turned])
        report = ca.substitute(f.reported[others], motion[turned], attitude)
        true = ca.SX.zeros(motion.shape)
        true[turned] = attitude
        true[others] = _solved(report, motion[others], self.measured[others])
        return true

    @cached_property
    def true_motion_at(self) -> ca.Function:
        """`true_motion` as a function of measured motion, actuation, memory, commands, p and t."""
        f = self.functions
        inputs = [self.measured, f.actuation, f.memory, f.u, f.p, f.t]
        return ca.Function("true_motion", inputs, [ca.densify(self.true_motion)])

    @cached_property
    def _inputs(self) -> list[ca.SX]:
        f = self.functions
        constant = ca.vertcat(*self.inverse.nonzeros()) if self.mass_is_constant else ca.SX(0, 1)
        return [self.measured, f.actuation, f.memory, f.u, constant, self.previous, self.delay, f.p, f.t]

    @cached_property
    def value_and_derivatives(self) -> ca.Function:
        """The rows, and their (sparse) derivatives in the free parameters, the actuation, what it was before,
        and the memory.

        Where the force of the commands depends on the motion, half of it: the other half is `held_after`.
        """
        return self._values("weak_derivatives", slice(0, 5 * self.size))

    @cached_property
    def held_after(self) -> ca.Function:
        """Half of the rows of the commands alone, with the same derivatives, for the motion at the end of the
        interval over which a command is held.
        """
        return self._values("weak_held", self.held_rows)

    @property
    def held_rows(self) -> slice:
        """Rows of the acceleration by the commands."""
        return slice(4 * self.size, 5 * self.size)

    def _values(self, name: str, rows: slice) -> ca.Function:
        value, *derivatives = (table[rows, :] for table in self._tables)
        return ca.Function(name, self._inputs, ca.cse([value, *map(ca.sparsify, derivatives)]))

    @cached_property
    def _tables(self) -> list[ca.SX]:
        """The rows and their derivatives, of those of the commands half where there is another half."""
        f = self.functions
        free = ca.vertcat(*[f.p[i] for i in self.free])
        # An actuator chain without free parameters does not depend on them.
        chain = f.actuation if self.actuators_vary else f.actuation[:0]
        before = self.previous[: chain.shape[0]]
        tables = [ca.densify(self._rows), *(self._slope(v) for v in (free, chain, before, f.memory))]
        if not self.held_depends_on_motion:
            return tables
        others = slice(0, self.held_rows.start)
        return [ca.vertcat(table[others, :], 0.5 * table[self.held_rows, :]) for table in tables]

    @cached_property
    def noise(self) -> ca.Function:
        """Derivative of the rows in the measured pose and velocity, shape (5n, 2n), sparse."""
        return ca.Function("weak_noise", self._inputs, [ca.sparsify(self._slope(self.measured))])

    @cached_property
    def held_depends_on_motion(self) -> bool:
        """Whether the force of the commands depends on the motion."""
        motion = ca.vertcat(self.functions.eta, self.functions.nu)
        return bool(ca.depends_on(ca.vertcat(self._by_commands, ca.vec(self.functions.mass_matrix)), motion))


def _solved(report: ca.SX, motion: ca.SX, measured: ca.SX) -> ca.SX:
    """The motion that makes a report, affine in it, equal what was measured."""
    zero = ca.SX.zeros(motion.shape)
    slope = ca.jacobian(report, motion)
    rest = measured - ca.substitute(report, motion, zero)
    return rest if slope.is_eye() else ca.solve(ca.substitute(ca.densify(slope), motion, zero), rest)


@dataclass(frozen=True)
class LimitSettings:
    """Tolerances for positive matrices."""

    least_mass: float = 1e-3  # least eigenvalue of the mass matrix, as a share of the stated inertias
    # Share of the scale of a matrix by which a least eigenvalue may miss its limit, and still counts as at
    # it.
    rounding: float = 1e-7
    at_limit: float = 1e-5
    # Share of the largest part of a direction from which the motions that it is made of are named.
    named: float = 0.1


SETTINGS = LimitSettings()


@dataclass(frozen=True)
class Cut:
    """Linear inequality slope' step >= limit on a step of the free parameters."""

    slope: Array
    limit: float


def positive_matrices(
    functions: Functions, places: Sequence[int], *, dissipative: bool
) -> list[PositiveMatrix]:
    """Matrices that have to be positive; `places` are those of the free parameters.

    Dissipative linear damping, D + D' >= 0, is required only on request: at speed, the coefficients of a hull
    include lift and the Munk moment, which need not dissipate energy.
    """
    free = ca.vertcat(*[functions.p[i] for i in places]) if places else ca.SX(0, 1)
    stated = np.array(functions.values(), dtype=float)
    found = [
        PositiveMatrix("mass matrix M > 0", m, free, functions, stated, SETTINGS.least_mass)
        for m in _masses(functions)
    ]
    if dissipative and (damping := _linear_damping(functions)) is not None:
        found.append(PositiveMatrix("linear damping D + D' >= 0", damping, free, functions, stated, 0.0))
    return found


class PositiveMatrix:
    """One symmetric matrix with the least eigenvalue that it may have, relative to its stated diagonal."""

    def __init__(
        self, name: str, expression: ca.SX, free: ca.SX, functions: Functions, stated: Array, least: float
    ) -> None:
        self.name, self._least = name, least
        self._motions = functions.vehicle.degrees_of_freedom
        self._size = expression.shape[0]
        symmetric = ca.densify((expression + expression.T) / 2)
        slope = ca.jacobian(ca.vec(symmetric), free)
        self.varies = slope.nnz() > 0
        self._function = ca.Function("limit", [functions.p], [symmetric, ca.densify(slope)])
        diagonal = np.diag(self._values(stated)[0])
        self._scale = 1.0 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))

    def _values(self, p: Array) -> tuple[Array, Array]:
        matrix, slope = call(self._function, [p])
        return matrix.reshape(self._size, self._size), slope.reshape(-1, self._size, self._size)

    def _directions(self, p: Array) -> tuple[Array, Array]:
        matrix = self._values(p)[0]
        weights, vectors = np.linalg.eigh(matrix * np.outer(self._scale, self._scale))
        return weights - self._least, vectors

    def is_negative(self, p: Array) -> bool:
        """Whether it is not positive, beyond rounding."""
        return self._least_eigenvalue(p) < -SETTINGS.rounding

    def is_at_limit(self, p: Array) -> bool:
        """Whether it is hardly positive, or not at all."""
        return self._least_eigenvalue(p) < SETTINGS.at_limit

    def _least_eigenvalue(self, p: Array) -> float:
        """Least eigenvalue above its limit, in shares of the stated inertia or damping."""
        return float(self._directions(p)[0][0])

    def cuts(self, p: Array) -> Iterator[Cut]:
        """Inequalities on a step from p for the matrix to be positive."""
        over, vectors = self._directions(p)
        if over[0] >= -SETTINGS.rounding:
            return
        slope = self._values(p)[1]
        for excess, vector in zip(over, vectors.T, strict=True):
            if excess < -SETTINGS.rounding:
                motion = vector * self._scale
                yield Cut(np.einsum("i,kij,j->k", motion, slope, motion), -float(excess))

    def described(self, p: Array) -> str:
        """Its name, with the motions that its least eigenvalue concerns."""
        direction = self._directions(p)[1][:, 0]
        part = np.abs(direction) > SETTINGS.named * np.max(np.abs(direction))
        return f"{self.name} ({', '.join(m for m, there in zip(self._motions, part, strict=True) if there)})"


def _masses(functions: Functions) -> list[ca.SX]:
    """The mass matrix at rest, or ahead and astern where it depends on the motion."""
    f, mass = functions, functions.mass_matrix
    around = ca.vertcat(f.eta, f.nu, f.memory, f.actuation, f.t)
    if not ca.depends_on(ca.vec(mass), around):
        return [mass]
    others = ca.SX.zeros(around.shape[0] - f.nu.shape[0])
    rest = ca.vertcat(f.eta, f.memory, f.actuation, f.t)
    still = ca.substitute(ca.densify(mass), rest, others)
    return [ca.substitute(still, f.nu, sign * ca.SX.ones(f.nu.shape)) for sign in (1.0, -1.0)]


def added_mass_at_zero_frequency(functions: Functions, p: Array) -> Array | None:
    """Added mass of slow motion, (n, n), with contributions of effect states; None if there are none.

    With z' = A z + B nu at rest, slow motion has z = -A^-1 B nu - A^-2 B nu', so that a force C z is one of
    the damping -C A^-1 B and of the inertia C A^-2 B. Of potential flow that inertia is positive: the free
    surface is a rigid wall at frequency zero, and the water has the kinetic energy of the flow about the body
    and its image.
    """
    f = functions
    rates = ca.jacobian(f.memory_rates, f.nu)
    if not rates.nnz():
        return None
    solid = {e.id for e in f.vehicle.all_effects if e.known_by_design}
    water = sum((w for i, w in f.wrenches.items() if i not in solid), ca.SX(len(f.vehicle.dof_indices), 1))
    wanted = [
        ca.jacobian(f.memory_rates, f.memory),
        rates,
        ca.jacobian(f.residual, f.memory),
        -ca.jacobian(water, f.nu_dot),
    ]
    around = ca.vertcat(f.eta, f.nu, f.nu_dot, f.memory, f.actuation, f.t)
    still = [ca.substitute(ca.densify(e), around, ca.SX.zeros(around.shape)) for e in wanted]
    found = call(ca.Function("slow", [f.p], still), [p])
    own, given, force, inertia = (a.reshape(e.shape, order="F") for a, e in zip(found, wanted, strict=True))
    return inertia + force @ np.linalg.solve(own, np.linalg.solve(own, given))


def _linear_damping(functions: Functions) -> ca.SX | None:
    """Matrix of linear damping at a standstill; None for a vehicle without coupling between motions."""
    f = functions
    stating = {e.id: e.damping_matrix for e in f.vehicle.effects if isinstance(e, Wrench)}
    # The diagonal first, whatever the order in the file: a sum of the same terms in the same order.
    parts = [f.wrenches[i] for kind in ("diagonal", "coupling") for i, own in stating.items() if own == kind]
    if "coupling" not in stating.values():
        return None
    damping = -ca.jacobian(sum(parts[1:], parts[0]), f.nu)
    around = ca.vertcat(f.eta, f.nu, f.memory, f.actuation, f.t)
    return ca.substitute(ca.densify(damping), around, ca.SX.zeros(around.shape))
