"""Extended and unscented Kalman filters of a process, and the Rauch-Tung-Striebel smoother of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from math import log, pi
from typing import Any, Literal

import casadi as ca
import numpy as np

from undertow.codegen.compiler import compiled_or_virtual, load
from undertow.codegen.functions import wrapped
from undertow.codegen.simulate import runge_kutta
from undertow.errors import UndertowError
from undertow.typing import Array, Flags, Progress

from .process import Process

Method = Literal["ekf", "ukf"]


@dataclass(frozen=True)
class FilterSettings:
    """Numbers of the filters."""

    # Terms of the series of the transition in the discrete process noise, and nodes of its integral:
    # with four each, chains of four integrators are exact (acceleration of a turn to position).
    terms: int = 4
    nodes: int = 4
    # Squared innovation over its variance beyond which the gate rejects a report: one in a million.
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

    def reach(self, n: int) -> float:
        """Squared distance of the sigma points of n states from their mean, in standard deviations."""
        return self.alpha**2 * (n + self.kappa)

    def weights(self, n: int) -> tuple[float, float, float]:
        """Of the centre in means, of any other point, and of the centre in covariances."""
        share = 0.5 / self.reach(n)
        centre = 1 - 2 * n * share
        return centre, share, centre + 1 - self.alpha**2 + self.beta


SETTINGS = FilterSettings()


@dataclass(frozen=True)
class Reports:
    """Input of a filter; row k has the values measured at t[k]."""

    t: Array  # (n,): times, s, rising
    u: Array  # (n, nu): commands, held from their row to the next
    y: Array  # (n, m): reports by channel, NaN where there is none
    variance: Array  # (m,): of the noise of a report

    def __post_init__(self) -> None:
        if len(self.t) > SETTINGS.most_rows:
            raise UndertowError(
                f"{len(self.t)} rows are more than an observer holds ({SETTINGS.most_rows}): give a part of "
                "the log (--from, --to), or every n-th row (`every` in the mapping file)"
            )

    @property
    def present(self) -> Flags:
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
    used: Flags  # (n, m): reports that the gate accepted

    @property
    def deviation(self) -> Array:
        """Standard deviation of every state, shape (n, nx)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))

    def state(self, name: str) -> Array:
        """One state, shape (n,)."""
        return self.mean[:, self.names.index(name)]

    @property
    def log_likelihood(self) -> float:
        """Log of the density of the reports; one that is rejected counts as at the gate."""
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


def added_noise(process: Process, x: ca.SX, u: ca.SX, p: ca.SX, q: ca.SX, t: ca.SX, dt: ca.SX) -> ca.SX:
    """Covariance that white noise of spectral densities q adds in dt, shape (nx, nx).

    The integral of e^{As} Q e^{A's} over dt by Gauss-Legendre quadrature: a sum of squares with positive
    weights is a covariance however fast the vehicle moves; a series of the product, cut off, is not.
    """
    _, a, _, _ = process.system(x, u, p, t)
    parts = [ca.SX.eye(process.x.numel())[:, process.driven]]
    for k in range(1, SETTINGS.terms):
        parts.append(a @ parts[-1] * dt / k)
    total = ca.SX(process.x.numel(), process.x.numel())
    for node, weight in zip(*np.polynomial.legendre.leggauss(SETTINGS.nodes), strict=True):
        reached = sum(part * (0.5 * (node + 1.0)) ** k for k, part in enumerate(parts))
        total += 0.5 * weight * dt * reached @ ca.diag(q) @ reached.T
    return total


def predicted(
    process: Process,
    x: ca.SX,
    P: ca.SX,
    u: ca.SX,
    p: ca.SX,
    q: ca.SX,
    t: ca.SX,
    dt: ca.SX,
    method: Method = "ekf",
) -> tuple[ca.SX, ca.SX, ca.SX]:
    """State and covariance after dt, and the covariance of the state before with it."""
    if method == "ukf":
        before = sigma_points(x, P)
        after = at_points(propagated_point(process), before, u, p, t, dt)
        new, spread = mean_and_deviations(after)
        grown, cross = covariance(spread, spread), covariance(mean_and_deviations(before)[1], spread)
    else:
        new, phi = propagate(process, x, u, p, t, dt)
        cross = P @ phi.T
        grown = phi @ cross
    return new, _symmetric(grown + added_noise(process, x, u, p, q, t, dt)), cross


@dataclass(frozen=True)
class Updated:
    """State after a report, its innovation and variance, and whether the gate accepted it."""

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
    method: Method = "ekf",
) -> Updated:
    """State after one report, by an extended filter in Joseph's form, which keeps a covariance positive."""
    if method == "ukf":
        points = sigma_points(x, P)
        seen = at_points(reported_point(process, channel), points, u, p, t)
        return updated_by_points(x, points, seen, y, r, there, gate, wraps=bool(process.angles[channel]))
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
    return Updated(x + gain * error, _symmetric(rest @ P @ rest.T + gain @ gain.T * r), error, variance, used)


# --- sigma points ---------------------------------------------------------------------------------
def sigma_points(x: ca.SX, P: ca.SX) -> ca.SX:
    """Points with mean x and covariance P, by the columns of its Cholesky factor, shape (2 n + 1, n)."""
    n = x.numel()
    root = ca.SX.zeros(n, n)
    for j in range(n):
        rest = P[j:, j] - root[j:, :j] @ root[j, :j].T
        root[j:, j] = ca.if_else(rest[0] > SETTINGS.rounding * P[j, j], rest / ca.sqrt(rest[0]), 0)
    off = float(np.sqrt(SETTINGS.reach(n))) * root.T
    return ca.repmat(x.T, 2 * n + 1, 1) + ca.vertcat(ca.SX.zeros(1, n), off, -off)


def at_points(function: ca.Function, points: ca.SX, *given: ca.SX) -> ca.SX:
    """Values of a function at all points, shape (2 n + 1, k)."""
    return ca.vertcat(*[function(points[i, :], *given).T for i in range(points.size1())])


def mean_and_deviations(points: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Mean of points, shape (k, 1), and their deviations from it, shape (2 n + 1, k)."""
    n = points.size1() // 2
    centre, share, _ = SETTINGS.weights(n)
    mean = share * ca.sum1(points[1:, :]) + centre * points[0, :]
    return mean.T, points - ca.repmat(mean, 2 * n + 1, 1)


def covariance(a: ca.SX, b: ca.SX) -> ca.SX:
    """Of deviations of points, shape (2 n + 1, k) each."""
    n = a.size1() // 2
    _, share, spread = SETTINGS.weights(n)
    return share * a[1:, :].T @ b[1:, :] + spread * a[0, :].T @ b[0, :]


@lru_cache(maxsize=8)
def propagated_point(process: Process) -> ca.Function:
    """`xn = moved(x, u, p, t, dt)`: one state after dt."""
    given, dt = (process.x, process.u, process.p, process.t), ca.SX.sym("dt")
    new = propagate(process, *given, dt)[0]
    return ca.Function("moved", [*given, dt], [ca.densify(new)], ["x", "u", "p", "t", "dt"], ["xn"])


@lru_cache(maxsize=64)
def reported_point(process: Process, channel: int) -> ca.Function:
    """`z = reported(x, u, p, t)`: what a sensor reports of one state."""
    given = [process.x, process.u, process.p, process.t]
    seen = ca.densify(process.reports[channel])
    return ca.Function("reported", given, [seen], ["x", "u", "p", "t"], ["z"])


def updated_by_points(
    x: ca.SX, points: ca.SX, seen: ca.SX, y: ca.SX, r: ca.SX, there: ca.SX, gate: ca.SX, *, wraps: bool
) -> Updated:
    """State after one report (an angle if it wraps), given the sigma points and what is seen at them."""
    centre, off = mean_and_deviations(seen)
    error = wrapped(y - centre) if wraps else y - centre
    variance = covariance(off, off) + r
    used = there * (error**2 <= gate * variance)
    apart = points - ca.repmat(x.T, points.size1(), 1)
    gain = used * covariance(apart, off) / variance
    # As in Joseph's form: P less what was learnt is a difference of large numbers, lost in single precision.
    rest = apart - off @ gain.T
    P = _symmetric(covariance(rest, rest) + gain @ gain.T * r)
    return Updated(x + gain * error, P, error, variance, used)


# --- filters --------------------------------------------------------------------------------------
class Observer:
    """The filters of a process.

    `densities` are the spectral densities of the white noise on the rates of the driven states, (unit of the
    rate)^2 s. Compiling the extended filter takes seconds, once: for many rows that are filtered many times.
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
        """Filter; the first row is corrected from the given mean (nx,) and covariance (nx, nx)."""
        row = _row_of(self.process, method, self._compiled and method == "ekf")
        found = self._run_rows(row, reports, np.asarray(mean, float), np.asarray(covariance, float), progress)
        lost = ~np.isfinite(found.mean).all(axis=1)
        if lost.any():
            when = reports.t[int(np.argmax(lost))]
            raise UndertowError(
                f"the estimate of '{self.process.vehicle.name}' diverges at t = {when:g} s: look for wrong "
                "units or commands (undertow doctor), or estimate with kinematics (--process kinematics)"
            )
        there = reports.present
        innovation, variance = (np.where(there, a, np.nan) for a in (found.innovation, found.variance))
        return replace(found, innovation=innovation, variance=variance)

    def _run_rows(
        self, row: ca.Function, reports: Reports, x: Array, P: Array, progress: Progress
    ) -> Estimate:
        n, total = len(x), len(reports.t)
        blocks = []
        steps = np.diff(reports.t, prepend=reports.t[0])
        y, there = np.nan_to_num(reports.y), reports.present.astype(float)
        # Commands act on the way to a row: those that were held from the row before.
        u = np.vstack([reports.u[:1], reports.u[:-1]])
        for begin in range(0, total, SETTINGS.rows_per_call):
            rows = slice(begin, min(begin + SETTINGS.rows_per_call, total))
            count = rows.stop - rows.start
            given = [u[rows].T, self.process.values, self.densities, reports.t[rows][None], steps[rows][None]]
            given += [y[rows].T, reports.variance, there[rows].T]
            found = [np.asarray(o) for o in _mapped_rows(row, count)(x, P, *given)]
            blocks.append([o.reshape(len(o), count, -1).transpose(1, 0, 2) for o in found])
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


@lru_cache(maxsize=8)
def _row_of(process: Process, method: Method, compiled: bool) -> ca.Function:
    """From one row to the next: predict, then correct by every report that is there."""
    n, m, k = process.x.numel(), len(process.channels), len(process.driven)
    sizes = {"x": n, "u": process.u.numel(), "q": k, "p": process.p.numel(), "t": 1, "dt": 1}
    s = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
    full = ca.SX.sym("P", n, n)
    more = [ca.SX.sym(name, m) for name in ("y", "r", "there")]
    before = s["x"], full, s["u"], s["p"], s["q"], s["t"] - s["dt"], s["dt"]
    x0, P0, cross = predicted(process, *before, method)
    x, P, done = x0, P0, []
    for i in range(m):
        y, r, there = (v[i] for v in more)
        gate = ca.SX(SETTINGS.gate)
        got = corrected(process, i, x, P, s["u"], s["p"], s["t"], y, r, there, gate, method)
        x, P = got.x, got.P
        done.append(ca.horzcat(got.innovation, got.variance, got.used))
    inputs = [s["x"], full, s["u"], s["p"], s["q"], s["t"], s["dt"], *more]
    outputs = [x, P, x0, P0, cross, ca.vertcat(*done)]
    row = ca.Function("row", inputs, [ca.densify(o) for o in outputs])
    wish = None if compiled else False
    return compiled_or_virtual(wish, lambda compiler: load(row, compiler), lambda: row)


@lru_cache(maxsize=8)
def _mapped_rows(row: ca.Function, count: int) -> ca.Function:
    """The rows one after the other in one call; state and covariance are carried on."""
    return row.mapaccum(f"rows_{count}", count, 2)


# --- smoothing ------------------------------------------------------------------------------------
def smoothed(found: Estimate) -> Estimate:
    """The estimate given all reports (Rauch, Tung and Striebel 1965; for sigma points Sarkka 2008)."""
    mean, covariance = found.mean.copy(), found.covariance.copy()
    gain = smoother_gains(found)
    for k in range(len(mean) - 2, -1, -1):
        mean[k] += gain[k] @ (mean[k + 1] - found.predicted[k + 1])
        more = gain[k] @ (covariance[k + 1] - found.predicted_covariance[k + 1]) @ gain[k].T
        covariance[k] += 0.5 * (more + more.T)
    return replace(found, mean=mean, covariance=covariance)


def smoother_gains(found: Estimate) -> Array:
    """Gains of the smoother from each row to the one before it, shape (n - 1, nx, nx).

    Cross-covariance times the inverse of the predicted covariance, of correlations: units differ.
    """
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

    `start`, shape (k,), is the first guess; densities that are not `free` stay.
    """
    from scipy.optimize import minimize

    at = np.flatnonzero(free)
    base, tried = np.asarray(start, dtype=float), 0

    def within(decades: Array) -> Array:
        return np.clip(decades, -SEARCH.decades, SEARCH.decades)

    def cost(decades: Array) -> float:
        nonlocal tried
        tried += 1
        progress(min(tried / (SEARCH.tries * max(len(at), 1)), 1.0), "process noise")
        q = base.copy()
        q[at] *= 10.0 ** within(decades)
        try:
            found = -Observer(process, q, compiled=True).run(reports, mean, covariance).log_likelihood
        except UndertowError:
            found = np.nan
        return found if np.isfinite(found) else -log(np.finfo(float).tiny) * len(reports.t)

    # With too little noise a filter loses its track and rejects all that follows: less noise is then cheaper
    # still. So a common factor comes first, and then a descent that brackets and so never ends higher.
    factors = np.linspace(-SEARCH.decades, SEARCH.decades, SEARCH.factors)
    first = min(factors, key=lambda decades: cost(np.full(len(at), decades)))
    options = {"xtol": SEARCH.step, "ftol": SEARCH.change, "maxfev": SEARCH.tries * len(at)}
    done = minimize(cost, np.full(len(at), first), method="Powell", options=options)
    found = base.copy()
    found[at] *= 10.0 ** within(np.atleast_1d(done.x))
    return found


@dataclass(frozen=True)
class SearchSettings:
    """Settings of the search for process noise."""

    decades: float = 6.0  # to either side of the first guess
    factors: int = 9  # of all densities at once, in these decades, that are tried first
    step: float = 0.05  # decades that do not matter
    change: float = 1e-7  # of the log likelihood, relative, that does not
    tries: int = 40  # filters for each density
    rows: int = 1000  # of the log that are filtered, at most


SEARCH = SearchSettings()
