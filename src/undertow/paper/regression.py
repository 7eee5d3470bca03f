"""The regression at the samples of a log: one motion by itself, eleven ways of smoothing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Literal

import casadi as ca
import numpy as np
from scipy.signal import savgol_filter

from undertow.codegen.compiler import compiled_or_virtual
from undertow.codegen.functions import Functions
from undertow.codegen.gram import CompiledRows, Sums, VirtualRows, layout
from undertow.errors import UndertowError
from undertow.identification.estimation.fitted import TriangularFactor
from undertow.identification.estimation.weak_form import free_parameters
from undertow.identification.logs.opening import constant_channels
from undertow.identification.logs.run import Run
from undertow.model.effect import Measurement
from undertow.model.symbols import DOFS, FORCE, VELOCITY
from undertow.model.vehicle import Value, Vehicle
from undertow.typing import Array

Direction = Literal["forward", "backward", "both"]


@dataclass(frozen=True)
class RegressionSettings:
    """Which logs a regression takes, and how its rows are reduced."""

    # Share of the way in the lesser direction from which a log is one of both directions.
    both_ways: float = 0.05
    # Share of the sampling interval by which the clock may waver for a filter that counts samples.
    largest_jitter: float = 0.02
    # Condition number of the scaled regressor up to which a Cholesky factor of the products is good to 1e-10.
    largest_cholesky_condition: float = 300.0
    # Samples in a block of rows, which then has less than a quarter of a megabyte for six rows of thirty.
    block: int = 128


SETTINGS = RegressionSettings()


@dataclass(frozen=True)
class Axis:
    """One motion in one direction."""

    motion: str  # degree of freedom
    direction: Direction  # ``forward``, ``backward``, or ``both`` where the vehicle does not tell them apart
    vehicle: Vehicle  # the vehicle with this motion only, and the values of this direction

    @property
    def place(self) -> int:
        """Place of the motion among the six."""
        return DOFS.index(self.motion)

    @property
    def velocity(self) -> str:
        """Channel of its velocity."""
        return VELOCITY[self.place]

    @property
    def rate(self) -> str:
        """Channel of its acceleration."""
        return f"{self.velocity}_dot"

    @property
    def inertia(self) -> str:
        """What the sum of mass and added mass is called, as in the paper."""
        return ("m_x", "m_y", "m_z", "I_xx", "I_yy", "I_zz")[self.place]

    def name_of(self, parameter: str) -> str:
        """Name that a parameter of this motion has in the whole vehicle."""
        return parameter if self.direction == "both" else f"{parameter}_{self.direction}"

    def __str__(self) -> str:
        return self.motion if self.direction == "both" else f"{self.motion}, {self.direction}"


def moving(vehicle: Vehicle, run: Run) -> list[str]:
    """Motions of a vehicle that a run holds a velocity of which changes, and a force."""
    names = dict(zip(vehicle.degrees_of_freedom, vehicle.velocity_names, strict=True))
    still = constant_channels(run, names.values())
    moved = (m for m, name in names.items() if run.has(name) and name not in still)
    return [m for m in moved if _forced(vehicle, m, run)]


def _forced(vehicle: Vehicle, motion: str, run: Run) -> bool:
    pushed = bool(vehicle.thrusters) and all(run.has(t.name) for t in vehicle.thrusters)
    return pushed or run.has(f"tau_{FORCE[DOFS.index(motion)]}")


def axis_of(vehicle: Vehicle, motion: str, run: Run) -> Axis:
    """One motion of a vehicle, in the direction in which a run goes.

    The log's own force `tau_X` ... is used where it has one; else the thrusters push.
    """
    place = DOFS.index(motion)
    own = f"tau_{FORCE[place]}"
    alone = vehicle.constrained([motion], pushed=run.has(own))
    kept = tuple(e for e in alone.effects if not isinstance(e, Measurement))
    alone = replace(alone, effects=kept, force_channels=(own,) if run.has(own) else ())
    if not any(n in alone.sides for n in alone.parameter_names):
        return Axis(motion, "both", alone)
    direction = _direction(run, VELOCITY[place], vehicle.name)
    # The vehicle with the values of one direction for both.
    values: dict[str, Value] = {}
    for name, value in alone.values.items():
        parameter, way = alone.sides.get(name, (None, direction))
        if way == direction:
            values[name if parameter is None else parameter.name] = value
    return Axis(motion, direction, replace(alone, values=values))


def _direction(run: Run, name: str, vehicle: str) -> Direction:
    way = run.channels[name]
    total = float(np.nansum(np.abs(way)))
    ahead = float(np.nansum(np.maximum(way, 0.0))) / total
    if SETTINGS.both_ways < ahead < 1.0 - SETTINGS.both_ways:
        raise UndertowError(
            f"run '{run.name}' goes forward for {ahead:.0%} of its way in {name} and backward for the rest, "
            f"but vehicle '{vehicle}' has a value for each direction: give the two parts by themselves "
            "(--from, --to)"
        )
    return "forward" if ahead > 0.5 else "backward"


def known_states(vehicle: Vehicle, states: Iterable[str], whole: Sequence[str]) -> None:
    """Refuse a model with states that no sample holds."""
    hidden = [s for s in states if s not in whole]
    if hidden:
        raise UndertowError(
            f"vehicle '{vehicle.name}' has states that no sample of a log holds ({', '.join(hidden)}): least "
            "squares on samples cannot follow them; use undertow fit, or leave the effect out"
        )


Edges = Literal["interp", "drop", "nearest", "mirror", "constant", "wrap"]


@dataclass(frozen=True)
class Smoother:
    """One Savitzky–Golay filter."""

    order: int  # degree of the polynomials (k of the paper's tables, N in Table 3)
    frame: int  # samples that each is fitted to, odd (f, F in Table 3)

    def __call__(self, signal: Array, edges: Edges, derivative: int = 0, step: float = 1.0) -> Array:
        """Smooth an evenly sampled signal, or differentiate it.

        `signal` (n,): samples; `step`: sampling interval, s.
        """
        mode = "interp" if edges == "drop" else edges
        smooth = savgol_filter(signal, self.frame, self.order, deriv=derivative, delta=step, mode=mode)
        if edges == "drop":
            half = self.frame // 2
            smooth[:half] = smooth[-half:] = np.nan
        return np.asarray(smooth, dtype=float)

    def __str__(self) -> str:
        return f"({self.order}, {self.frame})"


@dataclass(frozen=True)
class Case:
    """One way to get velocity and acceleration from what was logged."""

    name: str  # number in the paper
    velocity: Smoother | None  # for the velocity
    acceleration: tuple[Smoother, ...]  # for the acceleration, one after the other
    # whether the acceleration is the derivative of the velocity by its filter, not the one that was logged
    differentiated: bool

    def needs(self, edges: Edges) -> int:
        """Samples without a gap that the filters need; with dropped edges each leaves the next one fewer."""
        first = [self.velocity] if self.velocity else []
        longest = max((f.frame for f in [*first, *self.acceleration]), default=2)
        chain = [*(first if self.differentiated else []), *self.acceleration]
        dropped = sum(f.frame - 1 for f in chain) + 1
        return max(longest, dropped) if edges == "drop" else longest

    def __str__(self) -> str:
        first = f"velocity {self.velocity}" if self.velocity else "nothing filtered"
        then = " then ".join(map(str, self.acceleration))
        parts = [first, *(["acceleration from it"] if self.differentiated else [])]
        return ", ".join([*parts, *([f"acceleration {then}"] if then else [])])

    def smoothed(
        self, velocity: Array, acceleration: Array | None, step: float, edges: Edges
    ) -> tuple[Array, Array]:
        """Velocity and acceleration of one motion after the filters, (n,) each.

        `velocity` (n,): as logged, evenly sampled; `acceleration` (n,): as logged; central differences of the
        velocity where the log has none; `step`: sampling interval, s.
        """
        if self.differentiated:
            assert self.velocity is not None
            rate = self.velocity(velocity, edges, 1, step)
        else:
            rate = np.gradient(velocity, step) if acceleration is None else acceleration
        for smoother in self.acceleration:
            known = np.isfinite(rate)
            rate = rate.copy()
            rate[known] = smoother(rate[known], edges)
        return velocity if self.velocity is None else self.velocity(velocity, edges), rate


def _independent(number: int, *smoothers: Smoother) -> Case:
    """A case of Tables 1 and 2: velocity and acceleration are filtered each by itself."""
    return Case(str(number), smoothers[0], smoothers, False)


_BOTH = {2: Smoother(1, 3), 3: Smoother(1, 5), 4: Smoother(1, 7), 5: Smoother(3, 7)}
_AGAIN = Smoother(1, 7)
_METHOD = Smoother(4, 11)
CASES: dict[str, Case] = {
    case.name: case
    for case in (
        Case("1", None, (), False),  # of Table 1
        *(_independent(n, s) for n, s in _BOTH.items()),
        *(_independent(n + 4, s, _AGAIN) for n, s in _BOTH.items()),
        Case("10", _METHOD, (), True),  # of Table 3
        Case("11", _METHOD, (_AGAIN,), True),
    )
}


def chosen_cases(words: str) -> list[Case]:
    """The cases that a list such as ``all`` or ``2,8,11`` names."""
    if words == "all":
        return list(CASES.values())
    names = [word.strip() for word in words.split(",")]
    unknown = [name for name in names if name not in CASES]
    if unknown:
        raise UndertowError(
            f"--cases {words}: {unknown[0]!r} is not a case; give all, or some of {', '.join(CASES)}, "
            "as in 2,8,11"
        )
    return [CASES[name] for name in dict.fromkeys(names)]


class Regression:
    """The regressor of one motion."""

    def __init__(self, axis: Axis) -> None:
        self.axis = axis
        self.functions = Functions(axis.vehicle)
        vehicle = axis.vehicle
        known_states(vehicle, self.functions.state_names, (*vehicle.pose_names, *vehicle.velocity_names))
        _no_dead_time(axis, self.functions)
        self.free = free_parameters(vehicle)
        _must_be_linear(axis, self.free)
        self._fit = LinearFit(self.functions, self.free)
        self._places = [self.functions.parameter_names.index(n) for n in self.free]

    def add_run(self, triangle: TriangularFactor, run: Run, case: Case, edges: Edges) -> None:
        """Take in a run whose velocity and acceleration are smoothed as a case says."""
        self._add_samples(triangle, run, self._required_pieces(run, case, edges), case, edges)

    def add_part(
        self, triangle: TriangularFactor, run: Run, case: Case, edges: Edges, after: float, until: float
    ) -> None:
        """The same of a part of a log, which may have no segment that is long enough: after < t <= until."""
        self._add_samples(triangle, run, self._pieces(run, case, edges), case, edges, after, until)

    def signals(self, run: Run, case: Case, edges: Edges) -> tuple[Array, Array, Array]:
        """Time, velocity and acceleration as a case smooths them, shape (n,) each; NaN between segments."""
        names = ("t", self.axis.velocity, self.axis.rate)
        found = [self._samples(run, p, case, edges) for p in self._required_pieces(run, case, edges)]
        columns = ([np.append(part[name], np.nan) for part in found] for name in names)
        t, velocity, rate = (np.concatenate(column)[:-1] for column in columns)
        return t, velocity, rate

    def _add_samples(
        self,
        triangle: TriangularFactor,
        run: Run,
        pieces: list[slice],
        case: Case,
        edges: Edges,
        after: float = -np.inf,
        until: float = np.inf,
    ) -> None:
        for piece in pieces:
            samples = self._samples(run, piece, case, edges)
            # Times do not go back: what is kept is one segment.
            first, last = np.searchsorted(run.t[piece], (after, until), side="right")
            kept = {name: column[first:last] for name, column in samples.items()}
            triangle.add(*self._fit.triangle(kept))

    def _samples(self, run: Run, piece: slice, case: Case, edges: Edges) -> dict[str, Array]:
        """Columns of a segment; NaN where a filter gives nothing."""
        t = run.t[piece]
        logged = run.channels[self.axis.rate][piece] if run.has(self.axis.rate) else None
        step = _step(run, piece, even=case.velocity is not None or logged is None)
        velocity, rate = case.smoothed(run.channels[self.axis.velocity][piece], logged, step, edges)
        pose = {self._pose: run.channels[self._pose][piece]} if self._depends_on_pose else {}
        commands = {name: run.channels[name][piece] for name in self.axis.vehicle.command_names}
        # A model may do without one of them; a sample counts only if both are known.
        used = np.isfinite(velocity) & np.isfinite(rate)
        motion = {
            self.axis.velocity: np.where(used, velocity, np.nan),
            self.axis.rate: np.where(used, rate, np.nan),
        }
        return {"t": t, **pose, **commands, **motion}

    def _pieces(self, run: Run, case: Case, edges: Edges) -> list[slice]:
        """Stretches without gaps that are long enough for the filters."""
        if self._depends_on_pose and not run.has(self._pose):
            raise UndertowError(
                f"run '{run.name}' has no channel '{self._pose}', which the {self.axis.motion} of "
                f"'{self.axis.vehicle.name}' depends on: name its column in a mapping file (--map)"
            )
        needed = case.needs(edges)
        return [p for p in run.segments(self._needed(run, case)) if p.stop - p.start >= needed]

    def _needed(self, run: Run, case: Case) -> list[str]:
        names = [self.axis.velocity, *self.axis.vehicle.command_names]
        names += [self._pose] if self._depends_on_pose else []
        return names + ([self.axis.rate] if run.has(self.axis.rate) and not case.differentiated else [])

    def _required_pieces(self, run: Run, case: Case, edges: Edges) -> list[slice]:
        """The same; a run without any is refused."""
        pieces = self._pieces(run, case, edges)
        if not pieces:
            raise UndertowError(
                f"run '{run.name}': no stretch without gaps in {', '.join(self._needed(run, case))} has the "
                f"{case.needs(edges)} samples that case {case.name} needs: fill the gaps, or choose other "
                "cases (--cases)"
            )
        return pieces

    @property
    def depends_on_time(self) -> bool:
        """Whether the equations contain the time itself."""
        return bool(ca.depends_on(self.functions.driven_residual, self.functions.t))

    @property
    def _pose(self) -> str:
        return self.axis.vehicle.pose_names[0]

    @cached_property
    def _depends_on_pose(self) -> bool:
        return bool(ca.depends_on(self.functions.driven_residual, self.functions.eta))

    @property
    def _at_zero(self) -> Array:
        """Parameters with those that are sought at zero."""
        p = np.array(self.functions.values(), dtype=float)
        p[self._places] = 0.0
        return p

    def inertia(self, theta: Array, covariance: Array) -> tuple[float, float]:
        """Mass with added mass and its standard error at an estimate."""
        p = self._at_zero
        p[self._places] = theta
        value, slope = (np.asarray(v, dtype=float) for v in self._mass(p))
        slope = slope[0, self._places]
        return float(value[0, 0]), float(np.sqrt(slope @ covariance @ slope))

    @cached_property
    def _mass(self) -> ca.Function:
        f = self.functions
        return ca.Function("mass", [f.p], [f.mass_matrix, ca.jacobian(f.mass_matrix, f.p)])

    @cached_property
    def inertial(self) -> tuple[str, ...]:
        """Sought parameters that are part of the inertia."""
        f = self.functions
        felt = ca.jacobian_sparsity(f.mass_matrix, f.p)
        places = set(felt.get_col())
        return tuple(n for n, k in zip(self.free, self._places, strict=True) if k in places)


def _must_be_linear(axis: Axis, free: Sequence[str]) -> None:
    declared = axis.vehicle.declared_parameters
    if not free:
        raise UndertowError(
            f"no parameter of the {axis.motion} of '{axis.vehicle.name}' is marked for estimation: write, "
            "for instance, X_u = { value = ..., estimate = true }"
        )
    shaped = [n for n in free if not declared[n].linear]
    if shaped:
        raise UndertowError(
            f"{shaped[0]} does not enter the equations linearly, which least squares on samples needs: state "
            "it as known, or use undertow fit"
        )


def _step(run: Run, piece: slice, *, even: bool) -> float:
    steps = np.diff(run.t[piece])
    step = float(np.median(steps))
    if len(steps) and np.max(np.abs(steps - step)) <= SETTINGS.largest_jitter * step:
        # Of an even clock the mean is known better: late in a long log, times are rounded to 1e-10 s.
        step = float((run.t[piece][-1] - run.t[piece][0]) / len(steps))
    worst = float(np.max(np.abs(steps - step)))
    if even and worst > SETTINGS.largest_jitter * step:
        raise UndertowError(
            f"run '{run.name}' is sampled unevenly (steps of {step:g} s, off by up to {worst:g} s), but "
            "Savitzky-Golay filters count samples: resample it on an even clock, or use undertow fit"
        )
    return step


def _no_dead_time(axis: Axis, functions: Functions) -> None:
    seconds = float(functions.dead_time(functions.values()))
    if seconds:
        raise UndertowError(
            f"vehicle '{axis.vehicle.name}' responds to its commands {seconds:g} s late, which least squares "
            "on samples does not follow: use undertow fit, or log the force itself"
        )


class LinearFit:
    """Rows H theta = target of a model at the samples of logs, for parameters `names` that enter linearly.

    `needed` are the channels that the rows depend on: states, accelerations ("u_dot"), commands, "t".
    """

    def __init__(self, functions: Functions, names: Sequence[str], *, compiled: bool | None = None) -> None:
        self.names = tuple(names)
        self._p = np.array(functions.values(), dtype=float)
        rows = layout(functions, [functions.parameter_names.index(n) for n in names])
        vehicle = functions.vehicle
        rates = (f"{n}_dot" for n in vehicle.velocity_names)
        inputs = (*functions.state_names, *rates, *vehicle.command_names, "t")
        self.used_inputs = tuple(inputs[i] for i in rows.used_inputs)
        self._rows = compiled_or_virtual(compiled, partial(CompiledRows, rows), partial(VirtualRows, rows))

    def triangle(self, samples: Mapping[str, Array]) -> tuple[Array, int]:
        """Few rows with the same products as those of all samples without a gap, and the count of these.

        The last of the k + 1 columns is that of the target. It is good to 1e-10 whatever the condition.
        """
        columns = self._columns(samples)
        sums = Sums(np.zeros((len(self.names) + 1, len(self.names) + 1)))
        self._rows.gram(columns, self._p, sums)
        factor = _cholesky(sums.total)
        if factor is not None and _condition(factor) <= SETTINGS.largest_cholesky_condition:
            return factor, sums.count
        return self._by_reflections(columns)

    def _columns(self, samples: Mapping[str, Array]) -> list[Array]:
        missing = [n for n in self.used_inputs if n not in samples]
        if missing:
            raise UndertowError(f"the samples lack channel '{missing[0]}', which the rows depend on: add it")
        columns = [np.ascontiguousarray(samples[n], dtype=float) for n in self.used_inputs]
        if len({c.shape for c in columns}) > 1:
            raise UndertowError(
                f"the columns {', '.join(self.used_inputs)} differ in length: give equal ones"
            )
        return columns

    def _by_reflections(self, columns: list[Array]) -> tuple[Array, int]:
        triangle = TriangularFactor(len(self.names))
        for first in range(0, len(columns[0]) if columns else 0, SETTINGS.block):
            triangle.add(*self._rows.build([c[first : first + SETTINGS.block] for c in columns], self._p))
        return triangle.factor, triangle.count


def _cholesky(upper: Array) -> Array | None:
    """The triangular factor of a matrix of products by its upper triangle; None if there is none."""
    size = np.sqrt(np.diag(upper))
    if not (np.isfinite(upper).all() and (size > 0).all()):
        return None
    scaled = upper / np.outer(size, size)
    try:
        return np.asarray(np.linalg.cholesky(np.triu(scaled) + np.triu(scaled, 1).T).T * size)
    except np.linalg.LinAlgError:
        return None


def _condition(factor: Array) -> float:
    """Condition number with columns scaled to unit length."""
    size = np.linalg.norm(factor, axis=0)
    return float(np.linalg.cond(factor / size)) if size.all() and np.isfinite(size).all() else np.inf
