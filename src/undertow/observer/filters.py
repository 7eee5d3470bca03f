"""Extended and unscented Kalman filters of a process, and the Rauch-Tung-Striebel smoother of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from math import log, pi, remainder
from typing import Any, Literal

import casadi as ca
import numpy as np

from undertow.codegen.compiler import Evaluator, compiled_or_virtual, load
from undertow.codegen.functions import wrapped
from undertow.codegen.simulate import runge_kutta
from undertow.errors import UndertowError
from undertow.typing import Array, Flags, Progress

from .process import Process

Method = Literal["ekf", "ukf"]


@dataclass(frozen=True)
class FilterSettings:
    """Numbers of the filters."""

    # Terms of the series of the discrete process noise: with five, chains of three integrators are exact.
    terms: int = 5
    # Squared innovation over its variance beyond which a report is not believed: one in a million.
    gate: float = 23.9
    # Sigma points (Wan and van der Merwe 2000): as wide as the square root of the number of states, beta for
    # a Gaussian. The centre has then no weight in the mean, and covariances stay positive.
    alpha: float = 1.0
    beta: float = 2.0
    kappa: float = 0.0
    # Rows in one call: some tenths of a second, during which Ctrl-C has no effect.
    rows_per_call: int = 500
    # Rows that are held in memory with their covariances.
    most_rows: int = 200_000
    # Share of the largest eigenvalue, in standard deviations, that counts as a state without uncertainty.
    rounding: float = 1e-13


SETTINGS = FilterSettings()


@dataclass(frozen=True)
class Reports:
    """What a filter is given; row k has what was true at t[k]."""

    t: Array  # (n,): times, s, rising
    u: Array  # (n, nu): commands, held from their row to the next
    y: Array  # (n, m): reports by channel, NaN where there is none
    variance: Array  # (m,): of the noise of a report

    def __post_init__(self) -> None:
        if len(self.t) > SETTINGS.most_rows:
            raise UndertowError(
                f"{len(self.t)} rows are more than an observer holds ({SETTINGS.most_rows}): give a part of "
                "the log (--from, --to), or every so many-th row (`every` in the mapping file)"
            )

    @property
    def there(self) -> Flags:
        """Which reports there are, shape (n, m)."""
        return np.isfinite(self.y)

    def first(self, rows: int) -> Reports:
        """The first rows."""
        return replace(self, t=self.t[:rows], u=self.u[:rows], y=self.y[:rows])


@dataclass(frozen=True)
class Estimate:
    """States over time."""

    t: Array  # (n,):
    names: tuple[str, ...]  # of the states
    # mean, covariance: (n, nx): given the reports up to each row; of all rows after `smoothed`
    mean: Array
    covariance: Array
    # predicted, predicted_covariance: given the reports before each row
    predicted: Array
    predicted_covariance: Array
    cross: Array  # (n, nx, nx): covariance of the state of the row before with the predicted one
    # innovation, variance: (n, m): report less prediction, given all reports before in the order of the
    # channels, and its variance, so that normalised innovations are independent; NaN where there is no report
    innovation: Array
    variance: Array
    used: Flags  # (n, m): reports that were believed

    @property
    def deviation(self) -> Array:
        """Standard deviation of every state, shape (n, nx)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))

    def state(self, name: str) -> Array:
        """One state, shape (n,)."""
        return self.mean[:, self.names.index(name)]

    @property
    def log_likelihood(self) -> float:
        """Log of the density of the reports; one that is not believed counts as at the gate."""
        there = np.isfinite(self.innovation)
        square = np.minimum(self.innovation[there] ** 2 / self.variance[there], SETTINGS.gate)
        return float(-0.5 * np.sum(square + np.log(2 * pi * self.variance[there])))


# --- expressions ----------------------------------------------------------------------------------
def _symmetric(matrix: ca.SX) -> ca.SX:
    return ca.triu2symm(ca.triu(matrix))


def propagate(process: Process, x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX, dt: ca.SX) -> list[ca.SX]:
    """State after dt and its Jacobian Phi, by one Runge-Kutta step of rates and variational equations."""
    system = process.system

    def rates(parts: Sequence[Any], reach: float) -> Sequence[Any]:
        x_dot, a, _, _ = system(parts[0], u, p, t + reach * dt)
        return [x_dot, a @ parts[1]]

    return runge_kutta(rates, [x, ca.SX.eye(x.numel())], [dt, dt])


def discrete_noise(process: Process, a: ca.SX, q: ca.SX, dt: ca.SX) -> ca.SX:
    """Covariance that white noise of spectral densities q adds in dt, shape (nx, nx).

    The integral of e^{As} Q e^{A's} over dt as a series: its terms follow from L -> A L + L A'.
    """
    n = process.x.numel()
    term = ca.SX(n, n)
    for k, i in enumerate(process.driven):
        term[i, i] = q[k]
    total = term * dt
    for k in range(1, SETTINGS.terms):
        half = a @ term
        term = _symmetric(half + half.T) * dt / (k + 1)
        total += term * dt
    return total


def predicted(
    process: Process, x: ca.SX, P: ca.SX, u: ca.SX, p: ca.SX, q: ca.SX, t: ca.SX, dt: ca.SX
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """State and covariance after dt, and the covariance of the state before with it."""
    new, phi = propagate(process, x, u, p, t, dt)
    _, a, _, _ = process.system(x, u, p, t)
    cross = P @ phi.T
    return new, _symmetric(phi @ cross + discrete_noise(process, a, q, dt)), cross


@dataclass(frozen=True)
class Believed:
    """State after a report, its innovation and variance, and whether it was believed."""

    x: ca.SX
    P: ca.SX
    innovation: ca.SX
    variance: ca.SX
    used: ca.SX


def corrected(
    process: Process,
    channel: int,
    x: ca.SX,
    P: ca.SX,
    u: ca.SX,
    p: ca.SX,
    t: ca.SX,
    y: ca.SX,
    r: ca.SX,
    there: ca.SX,
    gate: ca.SX,
) -> Believed:
    """State after one report, in Joseph's form, which keeps a covariance positive."""
    _, _, seen, slopes = process.system(x, u, p, t)
    h = slopes[channel, :]
    error = y - seen[channel]
    if process.angles[channel]:
        error = wrapped(error)
    along = P @ h.T
    variance = ca.densify(h @ along) + r
    used = there * (error**2 <= gate * variance)
    gain = used * along / variance
    rest = ca.SX.eye(x.numel()) - gain @ h
    return Believed(
        x + gain * error, _symmetric(rest @ P @ rest.T + gain @ gain.T * r), error, variance, used
    )


# --- filters --------------------------------------------------------------------------------------
class Observer:
    """The filters of a process.

    Parameters
    ----------
    process : Process
        What moves, and what sensors report.
    densities : ndarray, shape (len(process.driven),)
        Spectral density of the white noise on the rates of the driven states, (unit of the rate)^2 s.
    compiled : bool
        Whether the extended filter is worth compiling (seconds, once): many rows are filtered many times.
    """

    def __init__(self, process: Process, densities: Array, *, compiled: bool = False) -> None:
        self.process, self._compiled = process, compiled
        self.densities = np.asarray(densities, dtype=float)
        if self.densities.shape != (len(process.driven),) or not (self.densities >= 0).all():
            raise UndertowError(
                f"process noise has {np.size(densities)} spectral densities: give one, zero or above, for "
                f"each of {', '.join(process.driven_names)}"
            )

    def run(
        self,
        reports: Reports,
        mean: Array,
        covariance: Array,
        method: Method = "ekf",
        progress: Progress = lambda done, words: None,
    ) -> Estimate:
        """Filter; the first row is corrected from the given mean (nx,) and covariance (nx, nx).

        Raises
        ------
        UndertowError
            If the state is no finite number any more.
        """
        passing = self._extended if method == "ekf" else self._unscented
        found = passing(reports, np.asarray(mean, float), np.asarray(covariance, float), progress)
        lost = ~np.isfinite(found.mean).all(axis=1)
        if lost.any():
            when = reports.t[int(np.argmax(lost))]
            raise UndertowError(
                f"the estimate of '{self.process.vehicle.name}' diverges at t = {when:g} s: look for wrong "
                "units or commands (undertow doctor), or estimate with kinematics (--process kinematics)"
            )
        there = reports.there
        innovation, variance = (np.where(there, a, np.nan) for a in (found.innovation, found.variance))
        return replace(found, innovation=innovation, variance=variance)

    # --- extended -----------------------------------------------------------------------------
    def _extended(self, reports: Reports, x: Array, P: Array, progress: Progress) -> Estimate:
        n, total = len(x), len(reports.t)
        blocks = []
        steps = np.diff(reports.t, prepend=reports.t[0])
        y, there = np.nan_to_num(reports.y), reports.there.astype(float)
        # Commands act on the way to a row: those that were held from the row before.
        u = np.vstack([reports.u[:1], reports.u[:-1]])
        for begin in range(0, total, SETTINGS.rows_per_call):
            rows = slice(begin, min(begin + SETTINGS.rows_per_call, total))
            count = rows.stop - rows.start
            given = [u[rows].T, self.process.values, self.densities, reports.t[rows][None], steps[rows][None]]
            given += [y[rows].T, reports.variance, there[rows].T]
            found = [
                np.asarray(o) for o in _rolled(_row_of(self.process, self._compiled), count)(x, P, *given)
            ]
            blocks.append([_by_row(o, count) for o in found])
            x, P = blocks[-1][0][-1, :, 0], blocks[-1][1][-1]
            progress(rows.stop / total, "filtering")
        mean, after, x0, before, cross, done = (np.concatenate(parts) for parts in zip(*blocks, strict=True))
        return Estimate(
            reports.t,
            self.process.state_names,
            mean.reshape(total, n),
            after,
            x0.reshape(total, n),
            before,
            cross,
            done[:, :, 0],
            done[:, :, 1],
            done[:, :, 2] > 0,
        )

    # --- unscented ----------------------------------------------------------------------------
    @cached_property
    def _of_points(self) -> tuple[Evaluator, Evaluator, Evaluator]:
        """States after a step and reports of all sigma points at once; the process noise of a step."""
        f = self.process
        q, dt, count = ca.SX.sym("q", len(f.driven)), ca.SX.sym("dt"), 2 * f.x.numel() + 1
        given = [f.x, f.u, f.p, f.t]
        step = ca.Function("step", [*given, dt], [ca.densify(propagate(f, f.x, f.u, f.p, f.t, dt)[0])])
        see = ca.Function("see", given, [ca.densify(f.reports)])
        added = discrete_noise(f, f.system(*given)[1], q, dt)
        noise = ca.Function("noise", [*given, q, dt], [ca.densify(added)])
        return Evaluator(step, count), Evaluator(see, count), Evaluator(noise)

    def _unscented(self, reports: Reports, x: Array, P: Array, progress: Progress) -> Estimate:
        n, m, total = len(x), len(self.process.channels), len(reports.t)
        points = SigmaPoints.of(n)
        step, see, noise = self._of_points
        shapes = ((n,), (n, n), (n,), (n, n), (n, n), (m,), (m,), (m,))
        out = [np.zeros((total, *shape)) for shape in shapes]
        p, q = self.process.values, self.densities
        for k in range(total):
            dt = reports.t[k] - reports.t[max(k - 1, 0)]
            u, now = reports.u[max(k - 1, 0)], reports.t[k]
            before = points.around(x, P)
            after = step(before, u, p, now - dt, dt)[0][:, :, 0]
            x0 = points.mean @ after
            P0 = points.covariance(after - x0, after - x0) + noise(x, u, p, now - dt, q, dt)[0][0]
            cross = points.covariance(before - x, after - x0)
            x, P = x0, P0
            done = np.zeros((m, 3))
            for i in map(int, np.flatnonzero(reports.there[k])):
                spread = points.around(x, P)
                seen = see(spread, u, p, now)[0][:, i, 0]
                x, P, done[i] = self._believe(i, points, spread, seen, x, P, reports, k)
            for place, value in zip(out, (x, P, x0, P0, cross, *done.T), strict=True):
                place[k] = value
            if k % SETTINGS.rows_per_call == 0:
                progress(k / total, "filtering")
        mean, after, x0, before, cross, error, variance, used = out
        names = self.process.state_names
        return Estimate(reports.t, names, mean, after, x0, before, cross, error, variance, used > 0)

    def _believe(
        self,
        channel: int,
        points: SigmaPoints,
        spread: Array,
        seen: Array,
        x: Array,
        P: Array,
        reports: Reports,
        row: int,
    ) -> tuple[Array, Array, tuple[float, float, bool]]:
        """State, covariance, and innovation, its variance and whether it was believed, after one report."""
        centre = points.mean @ seen
        off = (seen - centre)[:, None]
        error = float(reports.y[row, channel] - centre)
        error = remainder(error, 2 * pi) if self.process.angles[channel] else error
        variance = float(points.covariance(off, off)[0, 0] + reports.variance[channel])
        used = error**2 <= SETTINGS.gate * variance
        gain = points.covariance(spread - x, off)[:, 0] / variance
        if not used:
            return x, P, (error, variance, False)
        return x + gain * error, P - np.outer(gain, gain) * variance, (error, variance, True)


@dataclass(frozen=True)
class SigmaPoints:
    """Points that have a mean and a covariance, and their weights, shape (2 n + 1,)."""

    scale: float
    mean: Array
    spread: Array

    @classmethod
    def of(cls, n: int) -> SigmaPoints:
        """Points for n states."""
        s = SETTINGS
        extra = s.alpha**2 * (n + s.kappa) - n
        mean = np.full(2 * n + 1, 0.5 / (n + extra))
        mean[0] = extra / (n + extra)
        spread = mean.copy()
        spread[0] += 1 - s.alpha**2 + s.beta
        return cls(float(np.sqrt(n + extra)), mean, spread)

    def around(self, x: Array, P: Array) -> Array:
        """The points, shape (2 n + 1, n)."""
        size = np.sqrt(np.maximum(np.diagonal(P), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(P / np.outer(size, size))
        root = self.scale * (vectors * np.sqrt(np.maximum(values, 0.0))).T * size
        return np.vstack([x, x + root, x - root])

    def covariance(self, a: Array, b: Array) -> Array:
        """Of deviations, shape (2 n + 1, k) each."""
        return (a * self.spread[:, None]).T @ b


@lru_cache(maxsize=8)
def _row_of(process: Process, compiled: bool) -> ca.Function:
    """From one row to the next: predict, then correct by every report that is there."""
    n, m, k = process.x.numel(), len(process.channels), len(process.driven)
    sizes = {"x": n, "u": process.u.numel(), "q": k, "p": process.p.numel(), "t": 1, "dt": 1}
    s = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    full = ca.SX.sym("P", n, n)
    more = [ca.SX.sym(name, m) for name in ("y", "r", "there")]
    before = s["x"], full, s["u"], s["p"], s["q"], s["t"] - s["dt"], s["dt"]
    x0, P0, cross = predicted(process, *before)
    x, P, done = x0, P0, []
    for i in range(m):
        y, r, there = (v[i] for v in more)
        got = corrected(process, i, x, P, s["u"], s["p"], s["t"], y, r, there, ca.SX(SETTINGS.gate))
        x, P = got.x, got.P
        done.append(ca.horzcat(got.innovation, got.variance, got.used))
    inputs = [s["x"], full, s["u"], s["p"], s["q"], s["t"], s["dt"], *more]
    outputs = [x, P, x0, P0, cross, ca.vertcat(*done)]
    row = ca.Function("row", inputs, [ca.densify(o) for o in outputs])
    wish = None if compiled else False
    return compiled_or_virtual(wish, lambda compiler: load(row, compiler), lambda: row)


@lru_cache(maxsize=8)
def _rolled(row: ca.Function, count: int) -> ca.Function:
    """The rows one after the other in one call; state and covariance are carried on."""
    return row.mapaccum(f"rows_{count}", count, 2)


def _by_row(stacked: Array, count: int) -> Array:
    """Matrices that stand side by side, shape (count, rows, columns)."""
    return stacked.reshape(len(stacked), count, -1).transpose(1, 0, 2)


# --- smoothing ------------------------------------------------------------------------------------
def smoothed(found: Estimate) -> Estimate:
    """The estimate given all reports (Rauch, Tung and Striebel 1965; for sigma points Sarkka 2008)."""
    mean, covariance = found.mean.copy(), found.covariance.copy()
    gain = _gains(found)
    for k in range(len(mean) - 2, -1, -1):
        mean[k] += gain[k] @ (mean[k + 1] - found.predicted[k + 1])
        more = gain[k] @ (covariance[k + 1] - found.predicted_covariance[k + 1]) @ gain[k].T
        covariance[k] += 0.5 * (more + more.T)
    return replace(found, mean=mean, covariance=covariance)


def _gains(found: Estimate) -> Array:
    """Cross-covariance times the inverse of the predicted covariance, of correlations: units differ."""
    ahead = found.predicted_covariance[1:]
    size = np.sqrt(np.maximum(np.diagonal(ahead, axis1=1, axis2=2), np.finfo(float).tiny))
    scaled = ahead / (size[:, :, None] * size[:, None, :])
    inverse = np.linalg.pinv(scaled, rcond=SETTINGS.rounding, hermitian=True)
    return (found.cross[1:] / size[:, None, :]) @ inverse / size[:, None, :]


# --- process noise --------------------------------------------------------------------------------
def most_likely(
    process: Process,
    reports: Reports,
    mean: Array,
    covariance: Array,
    start: Array,
    free: Flags,
    progress: Progress = lambda done, words: None,
) -> Array:
    """Spectral densities for which the reports are likeliest, by their innovations (Ljung 1999, section 7.4).

    Parameters
    ----------
    start : ndarray, shape (k,)
        First guess; densities that are not `free` stay.
    """
    from scipy.optimize import minimize

    at = np.flatnonzero(free)
    base, tried = np.asarray(start, dtype=float), 0

    def cost(decades: Array) -> float:
        nonlocal tried
        tried += 1
        progress(min(tried / (SEARCH.tries * max(len(at), 1)), 1.0), "process noise")
        q = base.copy()
        q[at] *= 10.0**decades
        try:
            return -Observer(process, q, compiled=True).run(reports, mean, covariance).log_likelihood
        except UndertowError:
            return -log(np.finfo(float).tiny) * len(reports.t)

    limits = [(-SEARCH.decades, SEARCH.decades)] * len(at)
    options = {"xtol": SEARCH.step, "ftol": 1e-7, "maxfev": SEARCH.tries * len(at)}
    done = minimize(cost, np.zeros(len(at)), method="Powell", bounds=limits, options=options)
    found = base.copy()
    found[at] *= 10.0 ** np.atleast_1d(done.x)
    return found


@dataclass(frozen=True)
class SearchSettings:
    """How process noise is looked for."""

    decades: float = 6.0  # to either side of the first guess
    step: float = 0.05  # decades that do not matter
    tries: int = 40  # filters for each density
    rows: int = 1000  # of the log that are filtered, at most


SEARCH = SearchSettings()
