"""Peers that predict: what an hour's work gives on the same logs, and black boxes.

All of them are fitted to smoothed accelerations of the training runs, but the state-space model, which is
fitted to the velocities, and simulate the windows of the validation runs from the same starts as ours.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, combinations_with_replacement
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmarks.hidden_effects.plant import euler_rates, rotation
from benchmarks.trust.terms import filled, smoothed
from undertow.identification.estimation.windows import Prediction, Windows, cut, prediction_error
from undertow.identification.logs.run import Run
from undertow.model.vehicle import Vehicle

Array = NDArray[np.float64]
#: Delays of the commands that are tried, s.
DELAYS = np.arange(0.0, 2.01, 0.1)
#: Shortest stretch without gaps that is fitted to, s: its ends are lost to the smoothing.
SHORTEST = 4.0
#: Up to so many velocities and commands the polynomial has all products of three of them.
FEW = 5
#: Ridges of the least squares that are tried, in units of the columns: the first only against columns alike,
#: the others because a model that fits accelerations best may be unstable when it is simulated.
RIDGES = (1e-8, 1e-3, 1e-2, 0.1)
#: Thresholds of STLSQ that are tried, in units of the rms acceleration; share of the logs that chooses.
THRESHOLDS = np.geomspace(0.003, 0.3, 12)
CHOOSES = 0.3
#: Sampling interval of the state-space model, s, its block rows and the orders that are tried, per velocity.
INTERVAL, BLOCK_ROWS, ORDERS = 0.2, 15, (1, 2, 3, 4)
# Beyond so many times the largest training velocity a simulation has diverged.
_DIVERGED = 100.0


class NotApplicable(Exception):
    """A method that has no model for such logs."""


class Peer(Protocol):
    """A fitted model."""

    def predicted(self, windows: Windows) -> Prediction:
        """The windows, simulated from their starts."""


# --- what is fitted to --------------------------------------------------------------------------
@dataclass(frozen=True)
class Samples:
    """Smoothed motion of the training runs.

    state: (m, 2n), pose and velocity. rate: (m, n), accelerations. commands: (m, k).
    """

    state: Array
    rate: Array
    commands: Array

    def part(self, rows: slice) -> Samples:
        """Some of the samples."""
        return Samples(self.state[rows], self.rate[rows], self.commands[rows])


def samples(vehicle: Vehicle, runs: Sequence[Run], delay: float = 0.0) -> Samples:
    """All stretches without gaps, smoothed; commands act so many seconds late."""
    found = [
        smoothed(piece, vehicle)[:3] for run in runs for piece in pieces(_late(run, vehicle, delay), vehicle)
    ]
    if not found:
        raise NotApplicable(f"no stretch without gaps lasts {SHORTEST:g} s")
    return Samples(*(np.concatenate(parts) for parts in zip(*found, strict=True)))


def pieces(run: Run, vehicle: Vehicle) -> list[Run]:
    """Stretches without gaps that are long enough."""
    needed = [*_posed(run, vehicle), *vehicle.velocity_names, *vehicle.command_names]
    whole = [(run.t[piece.start], run.t[piece.stop - 1]) for piece in run.segments(needed)]
    return [_with_pose(run.slice(a, b), vehicle) for a, b in whole if b - a > SHORTEST]


def _posed(run: Run, vehicle: Vehicle) -> list[str]:
    return [n for n in vehicle.pose_names if run.has(n)]


def _with_pose(run: Run, vehicle: Vehicle) -> Run:
    """The run with zeros for the pose that it lacks."""
    lacking = {n: np.zeros(len(run.t)) for n in vehicle.pose_names if not run.has(n)}
    return replace(run, channels={**run.channels, **lacking})


def _late(run: Run, vehicle: Vehicle, delay: float) -> Run:
    """The run with commands as they act where they are late; each holds until the next."""
    if not delay or not vehicle.command_names:
        return run
    place = _held_at(run, run.t - delay)
    late = {n: run.channels[n][place] for n in vehicle.command_names}
    return replace(run, channels={**run.channels, **late})


def _held_at(run: Run, when: Array) -> NDArray[np.intp]:
    """Sample whose command holds at each instant."""
    return np.clip(np.searchsorted(run.t, when + 1e-9, side="right") - 1, 0, len(run.t) - 1)


# --- terms --------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Terms:
    """Columns of a regression of accelerations.

    of: from states (m, 2n) and commands (m, k) to columns (m, f).
    allowed: (f, n), which column may be in the equation of which degree of freedom.
    part: (f,), 0 for columns that are always there, 1 and 2 for two kinds that may be left out.
    """

    of: Callable[[Array, Array], Array]
    allowed: NDArray[np.bool_]
    part: NDArray[np.intp]

    def variants(self) -> list[NDArray[np.bool_]]:
        """`allowed` with both kinds, with either, and with none."""
        without = [[], [1], [2], [1, 2]]
        return [self.allowed & ~np.isin(self.part, gone)[:, None] for gone in without]


def _tilts(vehicle: Vehicle, state: Array) -> list[Array]:
    """Sine of roll and pitch, where the vehicle has them: what rights it."""
    names = vehicle.pose_names
    return [np.sin(state[:, names.index(n)]) for n in ("phi", "theta") if n in names]


def grey_terms(vehicle: Vehicle) -> Terms:
    """A constant, velocities, their magnitudes times themselves, products of two, tilts, and the commands."""
    n = len(vehicle.velocity_names)

    def of(state: Array, commands: Array) -> Array:
        nu = state[:, n:]
        cross = [nu[:, i] * nu[:, j] for i, j in combinations(range(n), 2)]
        own = [np.ones(len(nu)), *nu.T, *(np.abs(nu) * nu).T]
        return np.column_stack([*own, *cross, *_tilts(vehicle, state), *commands.T])

    part = np.zeros(_width(of, vehicle), dtype=np.intp)
    part[1 + n : 1 + 2 * n], part[1 + 2 * n : 1 + 2 * n + n * (n - 1) // 2] = 1, 2
    return Terms(of, np.ones((len(part), n), dtype=bool), part)


def polynomial_terms(vehicle: Vehicle, *, symmetric: bool = True) -> Terms:
    """Abkowitz: products of up to three velocities and commands, as a hull with two like sides has them.

    With many commands products of the velocities alone, and of each command with one of them or itself.
    """
    n, m = len(vehicle.velocity_names), len(vehicle.command_names)
    powers = _powers(n, m)
    tilts = len(_tilts(vehicle, np.zeros((1, 2 * n))))

    def of(state: Array, commands: Array) -> Array:
        own = np.column_stack([state[:, n:], commands])
        products = [np.prod(own[:, list(p)], axis=1) for p in powers]
        squares = [np.abs(c) * c for c in commands.T]
        return np.column_stack([np.ones(len(state)), *products, *squares, *_tilts(vehicle, state)])

    sides = _sides(vehicle)
    parity = [0, *(int(np.prod([sides[i] for i in p])) for p in powers), *sides[n:], *[0] * tilts]
    equations = np.array(sides[:n])
    table = np.array(parity)[:, None]
    part = np.array([0, *(len(p) - 1 for p in powers), *[1] * m, *[0] * tilts])
    return Terms(of, (table == 0) | (table == equations[None]) | (not symmetric), part)


def _powers(n: int, m: int) -> list[tuple[int, ...]]:
    if n + m <= FEW:
        return [p for d in (1, 2, 3) for p in combinations_with_replacement(range(n + m), d)]
    own = [p for d in (1, 2, 3) for p in combinations_with_replacement(range(n), d)]
    return own + [(c,) for c in range(n, n + m)] + [(i, c) for i in range(n) for c in range(n, n + m)]


def _sides(vehicle: Vehicle) -> list[int]:
    """1 for what is alike on both sides (surge), -1 for what is mirrored (sway), 0 for what is neither."""
    motions = [1 if i in (0, 2, 4) else -1 for i in vehicle.dof_indices]
    forward = (1.0, 0.0, 0.0)
    turned = {s.name: tuple(np.cross(forward, np.array(s.axis, dtype=float))) for s in vehicle.surfaces}
    wrenches = {t.name: t.wrench for t in vehicle.thrusters} | turned
    commands = []
    for name in vehicle.actuator_names + vehicle.force_channels:
        wrench = (*(wrenches.get(name) or _of_force(name)), 0.0, 0.0, 0.0)
        ahead, across = (any(wrench[i] for i in own) for own in ((0, 2, 4), (1, 3, 5)))
        commands.append(0 if ahead and across else 1 if ahead else -1)
    return [*motions, *commands, *[0] * len(vehicle.inputs)]


def _of_force(name: str) -> tuple[float, ...]:
    return tuple(float(name[-1] == axis) for axis in "XYZKMN")


def _width(of: Callable[[Array, Array], Array], vehicle: Vehicle) -> int:
    return of(
        np.zeros((1, 2 * len(vehicle.velocity_names))), np.zeros((1, len(vehicle.command_names)))
    ).shape[1]


def _least_squares(
    columns: Array, rate: Array, allowed: NDArray[np.bool_], ridge: float = RIDGES[0]
) -> Array:
    """Coefficients (f, n) of each equation, of its own columns only."""
    size = np.sqrt(np.mean(columns**2, axis=0)) + 1e-300
    out = np.zeros(allowed.shape)
    for i, own in enumerate(allowed.T):
        a = columns[:, own] / size[own]
        rows = np.sqrt(ridge * len(a)) * np.eye(a.shape[1])
        y = np.concatenate([rate[:, i], np.zeros(len(rows))])
        out[own, i] = np.linalg.lstsq(np.vstack([a, rows]), y, rcond=None)[0] / size[own]
    return out


# --- models of the acceleration -----------------------------------------------------------------
@dataclass(frozen=True)
class Accelerating:
    """A model of the acceleration, simulated.

    rate: from states (m, 2n) and commands (m, k) to accelerations (m, n).
    delay: of the commands, s.
    limit: (n,), velocities beyond which a simulation has diverged.
    """

    vehicle: Vehicle
    rate: Callable[[Array, Array], Array]
    delay: float
    limit: Array

    def predicted(self, windows: Windows) -> Prediction:
        """The midpoint rule from sample to sample; what is predicted of the pose is not judged."""
        n = len(self.limit)
        commands = self._commands(windows)
        state = np.nan_to_num(windows.start)
        found = [state[:, n:]]
        for k, step in enumerate(np.diff(windows.t, axis=1).T[..., None]):
            middle = state + step / 2 * self._slope(state, commands[:, k])
            state = self._checked(state + step * self._slope(middle, commands[:, k]))
            found.append(state[:, n:])
        return with_velocities(windows, np.stack(found, axis=1))

    def _slope(self, state: Array, commands: Array) -> Array:
        n, places = len(self.limit), list(self.vehicle.dof_indices)
        eta, nu = np.zeros((6, len(state))), np.zeros((6, len(state)))
        eta[places], nu[places] = state[:, :n].T, state[:, n:].T
        turn = rotation(eta[3:])
        rates = np.vstack([np.einsum("ijr,jr->ir", turn, nu[:3]), euler_rates(turn, nu[3:])])
        return np.hstack([rates[places].T, self.rate(state, commands)])

    def _checked(self, state: Array) -> Array:
        n = len(self.limit)
        lost = ~(np.abs(state[:, n:]) < self.limit).all(axis=1)
        state[lost] = np.nan
        return state

    def _commands(self, windows: Windows) -> Array:
        held = [filled(r, windows.commands) for r in windows.runs]
        rows = zip(windows.run, windows.t, strict=True)
        return np.stack([held[i][_held_at(windows.runs[i], t - self.delay)] for i, t in rows])


def with_velocities(windows: Windows, velocities: Array) -> Prediction:
    """A prediction of velocities (b, k, n); of the pose what was measured."""
    half = velocities.shape[2]
    predicted = np.nan_to_num(windows.measured[..., :half])
    predicted = np.concatenate([predicted, velocities], axis=2)
    predicted[~windows.inside] = np.nan
    return Prediction(windows, predicted)


def _linear(
    vehicle: Vehicle, terms: Terms, coefficients: Array, delay: float, known: Samples
) -> Accelerating:
    return Accelerating(vehicle, lambda x, c: terms.of(x, c) @ coefficients, delay, _limit(known))


def _limit(known: Samples) -> Array:
    n = known.rate.shape[1]
    return np.asarray(_DIVERGED * np.abs(known.state[:, n:]).max(axis=0))


def delay_of(vehicle: Vehicle, runs: Sequence[Run]) -> float:
    """The delay of the commands with which the linear thrusters explain most of the accelerations."""
    if not vehicle.command_names:
        return 0.0
    terms = grey_terms(vehicle)
    size = np.sqrt(np.mean(samples(vehicle, runs).rate ** 2, axis=0))

    def left(delay: float) -> float:
        known = samples(vehicle, runs, delay)
        columns = terms.of(known.state, known.commands)
        rest = known.rate - columns @ _least_squares(columns, known.rate, terms.allowed)
        return float(np.sum(np.log(np.mean((rest / size) ** 2, axis=0))))

    return float(min(DELAYS, key=left))


def _regressed(vehicle: Vehicle, runs: Sequence[Run], horizon: float, terms: Terms) -> Accelerating:
    """Least squares with the terms and the ridge that simulate the training runs best."""
    delay = delay_of(vehicle, runs)
    known = samples(vehicle, runs, delay)
    columns = terms.of(known.state, known.commands)
    windows = cut(runs, vehicle, horizon)
    found = [
        _linear(vehicle, terms, _least_squares(columns, known.rate, allowed, ridge), delay, known)
        for allowed in terms.variants()
        for ridge in RIDGES
    ]
    return min(found, key=lambda model: prediction_error(model.predicted(windows)))


def grey_box(vehicle: Vehicle, runs: Sequence[Run], horizon: float) -> Accelerating:
    """Least squares with linear thrusters, their delay and cross terms."""
    return _regressed(vehicle, runs, horizon, grey_terms(vehicle))


def abkowitz(vehicle: Vehicle, runs: Sequence[Run], horizon: float) -> Accelerating:
    """Least squares with the polynomial of Abkowitz."""
    return _regressed(vehicle, runs, horizon, polynomial_terms(vehicle))


def sindy(vehicle: Vehicle, runs: Sequence[Run], horizon: float) -> Accelerating:
    """STLSQ of PySINDy on all products, its threshold chosen on the last part of the training logs."""
    from pysindy.optimizers import STLSQ

    delay, terms = delay_of(vehicle, runs), polynomial_terms(vehicle, symmetric=False)
    known = samples(vehicle, runs, delay)
    columns = terms.of(known.state, known.commands)
    size, target = np.sqrt(np.mean(columns**2, axis=0)) + 1e-300, np.sqrt(np.mean(known.rate**2, axis=0))
    a, y, edge = columns / size, known.rate / target, round((1.0 - CHOOSES) * len(columns))

    def fitted(threshold: float, rows: slice) -> Array:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            optimizer = STLSQ(threshold=threshold, alpha=1e-6, max_iter=20)
            return np.asarray(optimizer.fit(a[rows], y[rows]).coef_).T

    def aside(threshold: float) -> float:
        return float(np.mean((y[edge:] - a[edge:] @ fitted(threshold, slice(edge))) ** 2))

    found = fitted(min(THRESHOLDS, key=aside), slice(None)) * target / size[:, None]
    return _linear(vehicle, terms, found, delay, known)


def boosting(vehicle: Vehicle, runs: Sequence[Run], horizon: float) -> Accelerating:
    """Gradient-boosted trees of scikit-learn on velocities, tilts and commands, one for each acceleration."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    delay, n = delay_of(vehicle, runs), len(vehicle.velocity_names)
    known = samples(vehicle, runs, delay)

    def seen(state: Array, commands: Array) -> Array:
        return np.column_stack([state[:, n:], commands, *_tilts(vehicle, state)])

    table = seen(known.state, known.commands)
    trees = [HistGradientBoostingRegressor(random_state=0).fit(table, y) for y in known.rate.T]

    def rate(state: Array, commands: Array) -> Array:
        return np.column_stack([t.predict(seen(state, commands)) for t in trees])

    return Accelerating(vehicle, rate, delay, _limit(known))


# --- a linear state-space model -----------------------------------------------------------------
@dataclass(frozen=True)
class StateSpace:
    """x+ = A x + B u, y = C x + D u with Kalman gain K, in deviations from the means; y are the velocities.

    centre: means of the commands and velocities; scale: their sizes.
    """

    matrices: tuple[Array, Array, Array, Array, Array]
    centre: tuple[Array, Array]
    scale: tuple[Array, Array]
    names: tuple[tuple[str, ...], tuple[str, ...]]

    def predicted(self, windows: Windows) -> Prediction:
        """From the state that the filter has at the start of a window; what is measured in it is not used."""
        found = [self._window(windows, i) for i in range(len(windows))]
        return with_velocities(windows, np.stack(found))

    def _window(self, windows: Windows, i: int) -> Array:
        run, n = windows.runs[windows.run[i]], len(self.names[1])
        start, end = windows.t[i, 0], windows.t[i, -1]
        before = np.arange(run.t[windows.segment[i]], start, INTERVAL)
        state = np.zeros(len(self.matrices[0]))
        for u, y in zip(*self.sampled(run, before), strict=True):
            state = self._stepped(state, u, y)
        # The filter ends less than a step before the window; the first velocities are those measured.
        times = np.arange(start, end + INTERVAL, INTERVAL)
        first = (windows.start[i, n:] - self.centre[1]) / self.scale[1]
        state = self._corrected(state, self.sampled(run, times[:1])[0][0], first)
        simulated = self.simulated(state, self.sampled(run, times)[0]) * self.scale[1] + self.centre[1]
        return np.column_stack([np.interp(windows.t[i], times, column) for column in simulated.T])

    def _stepped(self, state: Array, u: Array, y: Array) -> Array:
        a, b, c, d, k = self.matrices
        return np.asarray(a @ state + b @ u + k @ (y - c @ state - d @ u))

    def _corrected(self, state: Array, u: Array, y: Array) -> Array:
        """The nearest state that gives the velocities y."""
        _, _, c, d, _ = self.matrices
        return np.asarray(state + np.linalg.pinv(c) @ (y - c @ state - d @ u))

    def simulated(self, state: Array, commands: Array) -> Array:
        """Velocities, scaled, at every step from a state on."""
        a, b, c, d, _ = self.matrices
        found = []
        for u in commands:
            found.append(c @ state + d @ u)
            state = a @ state + b @ u
        return np.array(found)

    def sampled(self, run: Run, times: Array) -> tuple[Array, Array]:
        """Commands and velocities at even steps, scaled."""
        at = [np.column_stack([np.interp(times, run.t, c) for c in filled(run, n).T]) for n in self.names]
        u, y = ((values - m) / s for values, m, s in zip(at, self.centre, self.scale, strict=True))
        return u, y


def state_space(vehicle: Vehicle, runs: Sequence[Run], horizon: float) -> StateSpace:
    """N4SID of the package nfoursid on the longest stretch, its order chosen by simulation of that."""
    if not vehicle.command_names:
        raise NotApplicable("nothing is commanded")
    run = max((p for r in runs for p in pieces(r, vehicle)), key=lambda p: p.t[-1] - p.t[0])
    names = (vehicle.command_names, vehicle.velocity_names)
    tables = [filled(run, n) for n in names]
    centre = tuple(t.mean(axis=0) for t in tables)
    scale = tuple(t.std(axis=0) + 1e-9 for t in tables)
    empty = StateSpace((np.zeros((0, 0)),) * 5, centre, scale, names)  # type: ignore[arg-type]
    u, y = empty.sampled(run, np.arange(run.t[0], run.t[-1], INTERVAL))
    found = [replace(empty, matrices=m) for m in _identified(u, y)]

    def left(model: StateSpace) -> float:
        start = np.linalg.pinv(model.matrices[2]) @ (y[0] - model.matrices[3] @ u[0])
        with np.errstate(over="ignore", invalid="ignore"):
            error = float(np.mean((y - model.simulated(start, u)) ** 2))
        return error if np.isfinite(error) else float("inf")

    return min(found, key=left)


def _identified(u: Array, y: Array) -> list[tuple[Array, Array, Array, Array, Array]]:
    """A, B, C, D and K of all orders."""
    import pandas
    from nfoursid.nfoursid import NFourSID

    inputs, outputs = ([f"{name}{i}" for i in range(t.shape[1])] for name, t in (("u", u), ("y", y)))
    frame = pandas.DataFrame(np.column_stack([u, y]), columns=[*inputs, *outputs])
    method = NFourSID(frame, output_columns=outputs, input_columns=inputs, num_block_rows=BLOCK_ROWS)
    method.subspace_identification()
    return [_matrices(method, order * y.shape[1], y.shape[1]) for order in ORDERS]


def _matrices(method: Any, order: int, size: int) -> tuple[Array, Array, Array, Array, Array]:
    from scipy.linalg import solve_discrete_are

    model, noise = method.system_identification(rank=order)
    a, b, c, d = (np.asarray(m) for m in (model.a, model.b, model.c, model.d))
    r, s, q = noise[:size, :size], noise[size:, :size], noise[size:, size:]
    try:
        p = solve_discrete_are(a.T, c.T, q + 1e-9 * np.eye(order), r + 1e-9 * np.eye(size), s=s)
        gain = (a @ p @ c.T + s) @ np.linalg.inv(c @ p @ c.T + r)
    except (np.linalg.LinAlgError, ValueError):  # no steady filter: the start is all that is known
        gain = np.zeros((order, size))
    return a, b, c, d, gain


#: Of a vehicle, training runs, and the length of windows (s) by whose simulation a method may choose.
Method = Callable[[Vehicle, Sequence[Run], float], Peer]
#: Grey boxes, which somebody could write down in an hour, and black ones.
GREY: dict[str, Method] = {
    "linear thrusters, delay, cross terms": grey_box,
    "Abkowitz polynomial": abkowitz,
    "PySINDy": sindy,
}
BLACK: dict[str, Method] = {"gradient boosting": boosting, "N4SID": state_space}
METHODS: dict[str, Method] = {**GREY, **BLACK}
