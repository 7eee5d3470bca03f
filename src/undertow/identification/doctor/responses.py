"""How the motion answers the commands: the acceleration that they bring, against mass and thrust of the file.

By the weak form, force = M d(nu)/dt is held against what each command gives, as the vehicle file has it;
damping, Coriolis, restoring and steady forces are left free, whatever the file says of them. A gain of one is
a log that is read as it should be. A gain of 1000 is a velocity in mm/s, of 57 an angular rate in degrees, of
0.001 a command a thousand times too large. Noise stands in the acceleration only, which leaves the gain free
of bias; what delays and lags do to it is little against a factor of a unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import casadi as ca
import numpy as np

from undertow.codegen.functions import Functions
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from ..logs import Run
from ..weak.drive import ActuatorStates
from ..weak.held import without_gaps
from ..weak.testfunctions import TestFunctions, knot_spacing, test_functions
from .kinematics import liveliest
from .mistake import Settings
from .sensors import clustered_least_squares

_INERTIA = ("m", "m", "m", "I_x", "I_y", "I_z")


@dataclass(frozen=True)
class Response:
    """How one motion answers one command, or all of them together.

    Attributes
    ----------
    degree_of_freedom : str
        The motion.
    command : str
        The command; empty for all together.
    gain, error : float
        Inertial force found per force commanded, 1 as the vehicle file has it, and its standard error.
    share : float
        Share that the command explains of what nothing else does.
    needed, given : float
        Inertial and commanded force or moment, rms, N or N m.
    """

    degree_of_freedom: str
    command: str
    gain: float
    error: float
    share: float
    needed: float
    given: float

    def sure(self, errors: float, share: float) -> bool:
        """Whether the gain stands out of its error, and the command explains a share of the motion."""
        return abs(self.gain) > errors * self.error and self.share > share


@dataclass(frozen=True)
class _Table:
    """Means over test functions: inertial force (K, n), of each command (K, n, c), and the rest (K, k)."""

    force: Array
    commanded: Array
    beside: Array


class Responses:
    """Where and how motion is held against commands; the same for a log as given and as mended.

    Parameters
    ----------
    vehicle : Vehicle
        Mass matrix and thrusters as its file has them.
    settings : Settings
        How much of the logs is looked at, and how.

    Raises
    ------
    UndertowError
        If what a command gives depends on the motion.
    """

    def __init__(self, vehicle: Vehicle, settings: Settings) -> None:
        self.vehicle, self.settings = vehicle, settings
        self._functions = Functions(vehicle)
        self._p = np.array(self._functions.values(), dtype=float)
        self._mass = _mass_matrix(self._functions, self._p)
        self._chain = ActuatorStates(self._functions, ())

    def of(self, runs: Sequence[Run]) -> list[Response]:
        """Responses of every motion whose inertia is known to every command and to all together."""
        parts = [part for i, run in enumerate(runs) for part in self._parts(run, i, len(runs))]
        if not parts:
            return []
        table = _Table(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))
        return [r for row in range(len(self._mass)) if self._known(row) for r in self._row(table, row)]

    def _known(self, row: int) -> bool:
        """Whether the vehicle file knows the inertia: what is to be estimated is no witness."""
        name = _INERTIA[self.vehicle.dof_indices[row]]
        return name in self.vehicle.values and not self.vehicle.values[name].estimate

    def _row(self, table: _Table, row: int) -> Iterator[Response]:
        given = table.commanded[:, row]
        acting = [k for k in range(given.shape[1]) if np.any(given[:, k]) and not self._open(k)]
        rest = np.delete(given, acting, axis=1)
        beside = np.column_stack([table.beside, rest[:, np.any(rest != 0, axis=0)]])
        if len(table.force) < 2 * (beside.shape[1] + len(acting)):
            return
        names = [(self.vehicle.command_names[k], k) for k in acting]
        if len(acting) != 1:
            yield from self._responses(table, row, beside, [("", given[:, acting].sum(axis=1))])
        yield from self._responses(table, row, beside, [(name, given[:, k]) for name, k in names])

    def _open(self, command: int) -> bool:
        """Whether thrust per command is to be estimated: then any unit of the command will do."""
        thrusters = self.vehicle.thrusters
        return command < len(thrusters) and thrusters[command].thrust_per_command.estimate

    def _responses(
        self, table: _Table, row: int, beside: Array, commands: list[tuple[str, Array]]
    ) -> Iterator[Response]:
        force = table.force[:, row]
        if not commands or not np.any(force):
            return
        own = _without(beside, np.column_stack([force, *(data for _, data in commands)]))
        gains, errors, shares = _fitted(own[:, 1:], own[:, 0], self.settings)
        dof = self.vehicle.degrees_of_freedom[row]
        for (name, data), *found in zip(commands, gains, errors, shares, strict=True):
            sizes = (float(np.sqrt(np.mean(a**2))) for a in (force, data))
            yield Response(dof, name, *map(float, found), *sizes)

    def _parts(self, run: Run, index: int, count: int) -> Iterator[tuple[Array, Array, Array]]:
        velocities, commands = self.vehicle.velocity_names, self.vehicle.command_names
        angles = [n for n in ("phi", "theta") if n in self.vehicle.pose_names and run.has(n)]
        lively, force = liveliest(run, velocities, self.settings.samples // count), self._commanded(run)
        for piece in run.segments([*velocities, *commands, *angles]):
            part = slice(max(piece.start, lively.start), min(piece.stop, lively.stop))
            t = run.t[part]
            functions = test_functions(t, self.settings.width * knot_spacing(t)) if len(t) > 2 else None
            if functions is not None:
                motion = run.matrix([*velocities, *angles])[part]
                yield _tested(functions, motion, len(velocities), force[part], self._mass, (index, count))

    def _commanded(self, run: Run) -> Array:
        """Force of every command at every sample, (N, n, n_commands); NaN where a command is missing."""
        rows = list(self.vehicle.dof_indices)
        u = run.matrix(self.vehicle.command_names)
        missing = np.isnan(u)
        actuation = self._chain.along(run.t, without_gaps(u), self._p).value
        thrusters = self.vehicle.thrusters
        gains = [np.array(t.wrench)[rows] * t.thrust_per_command.value for t in thrusters]
        known = [np.eye(6)["XYZKMN".index(n[-1])][rows] for n in self.vehicle.force_channels]
        table = np.column_stack([actuation, u[:, len(thrusters) :]])
        table = np.where(missing, np.nan, table)
        return np.einsum("Nc,cn->Nnc", table, np.array([*gains, *known]).reshape(-1, len(rows)))


def _tested(
    functions: TestFunctions, motion: Array, n: int, force: Array, mass: Array, run: tuple[int, int]
) -> tuple[Array, Array, Array]:
    """One stretch: inertial force, force of the commands, and what else may act."""
    length = np.asarray(functions.value.sum(axis=1)).ravel()[:, None]
    velocity = motion[:, :n]
    inertial = -(functions.rate @ velocity) / length @ mass.T
    commanded = (functions.held @ force.reshape(len(force), -1)) / length
    products = [velocity[:, i] * velocity[:, j] for i, j in combinations(range(n), 2)]
    columns = np.column_stack([motion, np.abs(velocity) * velocity, *products])
    steady = np.zeros((len(length), run[1]))
    steady[:, run[0]] = 1.0
    beside = np.column_stack([functions.value @ columns / length, steady])
    return inertial, commanded.reshape(len(length), *force.shape[1:]), beside


def _without(beside: Array, columns: Array) -> Array:
    """What columns have beside others."""
    size = np.linalg.norm(beside, axis=0)
    scaled = beside[:, size > 0] / size[size > 0]
    return np.asarray(columns - scaled @ np.linalg.lstsq(scaled, columns, rcond=1e-10)[0])


def _fitted(columns: Array, force: Array, settings: Settings) -> tuple[Array, Array, Array]:
    """Gains of columns by least squares, their errors, and what share each explains that no other does."""
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    scaled = columns / size
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=settings.distinct, hermitian=True)
    value = inverse @ (scaled.T @ force)
    left = float(np.sum((force - scaled @ value) ** 2))
    more = np.divide(value**2, np.diag(inverse), out=np.zeros_like(value), where=np.diag(inverse) > 0)
    spread = max(np.sqrt(left / len(force)), 1e-9 * float(np.max(np.abs(force))))
    value, error = clustered_least_squares(
        scaled / spread, force / spread, settings.cluster, settings.distinct
    )
    return value / size, error / size, more / np.maximum(left + more, 1e-300)


def _mass_matrix(functions: Functions, p: Array) -> Array:
    """M at the values of the file, in the vehicle's upright pose where it depends on that."""
    arguments = [functions.x, functions.u, functions.p, functions.t, functions.actuation]
    evaluate = ca.Function("mass", arguments, [functions.mass_matrix], {"allow_free": False})
    zeros = [np.zeros(a.shape) for a in arguments]
    zeros[2] = p
    return np.array(evaluate(*zeros), dtype=float)
