"""Simulation of windows with sensitivities, and the elimination of their unknown starts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from undertow.codegen.engine import Products, at_samples, products_of
from undertow.codegen.functions import Functions
from undertow.identification.logs.run import Run
from undertow.typing import Array, Flags, Index, Integers

from .data import inverse_of
from .predictor import Predictor, reported_late
from .residual import RunValues
from .windows import WindowCommands, Windows


@dataclass(frozen=True)
class ShootingSettings:
    """Numbers of the fit of the starts of windows."""

    # Keeps a start bounded in directions that its window does not show, relative to those that it shows.
    regularisation: float = 1e-12
    # First part of a window, s, to which its start is fitted before twice as much is taken; steps for each.
    first_part: float = 1.0
    steps: int = 3
    # Mean square of a window, in units of that of the middle one, from which its start may be a wrong one.
    wrong_start: float = 2.0
    # Share of the mean square of a window that a step has to gain for another to follow.
    least_gain: float = 0.01
    block: float = 5.0  # s; parts of a window that are so long count as independent of each other
    batch: int = 5_000_000  # numbers in the sensitivities of one batch of windows: 40 MB
    # Steps of finite differences: relative to a parameter, and for dead times to a sampling interval.
    difference: float = 1e-3
    least_size: float = 1e-3  # that a parameter counts as having then
    delay_difference: float = 0.25


SETTINGS = ShootingSettings()


@dataclass(frozen=True)
class Reduced:
    """The linearised problem of all windows with their starts eliminated."""

    # (m,) what is left of the residual, m = n_free + 1: the square of its norm is the cost at the best
    # starts
    r: Array
    J: Array  # (m, n_free) its derivative in the free parameters
    cost: float  # Sum of squares at the present starts; inf if a simulation diverged
    squares: Array  # (2n,) sum of squares by channel, and number of samples in it
    counts: Array
    # (groups, n_free) J' r of groups of residuals that count as independent: windows, or parts of long
    # ones
    scores: Array
    start_step: Array  # (b, k) best change of every start, and its derivative in the parameters
    start_slope: Array

    @cached_property
    def inflation(self) -> float:
        """Mean factor, at least 1, by which correlated residuals within groups increase variances.

        The trace of J^-1 B over the number of parameters, with the information J and the covariance B of the
        scores; 1 where all residuals are independent (Takeuchi's information criterion).
        """
        product = inverse_of(self.J.T @ self.J) @ (self.scores.T @ self.scores)
        return max(1.0, float(np.trace(product)) / max(len(product), 1))


def eliminated(parts: list[Products], counts: Array, n: int) -> Reduced:
    """The problem that remains with every window at its best start.

    `parts` are sums over windows, batch by batch, with derivatives in the n free parameters first.
    """
    windows, size = sum(len(p.squares) for p in parts), len(counts)
    with np.errstate(over="ignore"):
        squares = np.sum([p.squares.sum(axis=0) for p in parts], axis=0)
    # The squares of a simulation that nearly diverged may overflow.
    whole = all(np.all(np.isfinite(p.table)) for p in parts) and np.all(np.isfinite(squares))
    if any(p.diverged for p in parts) or not whole:
        return _diverged(windows, n, size)
    back = np.concatenate([_starts(p.table.sum(axis=1), n) for p in parts])
    first = np.cumsum([0, *(len(p.squares) for p in parts)])
    scores, gram = [], np.zeros((n + 1, n + 1))
    for part, begin in zip(parts, first, strict=False):
        left = _projected(part.table, back[begin : begin + len(part.squares)], n)
        scores.append(left[:, :, :n, n].reshape(left.shape[0] * left.shape[1], n))
        gram += left.sum(axis=(0, 1))
    condensed = _condensed(gram)
    return Reduced(
        r=condensed[:, n],
        J=condensed[:, :n],
        cost=float(squares.sum()),
        squares=squares,
        counts=counts,
        scores=np.concatenate(scores),
        start_step=-back[:, :, n],
        start_slope=-back[:, :, :n],
    )


def _starts(table: Array, n: int) -> Array:
    """Least squares on the starts, window by window: solution for every free column and the error.

    Normal equations: the columns of a start are few and well conditioned once they are scaled.
    """
    gram, right = table[:, n:-1, n:-1], _coupling(table, n)
    scale = np.sqrt(np.diagonal(gram, axis1=1, axis2=2))
    scale = np.where(scale > 0, scale, 1.0)[:, :, None]
    scaled = gram / (scale * np.swapaxes(scale, 1, 2)) + SETTINGS.regularisation * np.eye(gram.shape[1])
    return np.asarray(np.linalg.solve(scaled, right / scale) / scale)


def _coupling(table: Array, n: int) -> Array:
    """Products of the starts with the free columns and the error."""
    return np.concatenate([table[..., n:-1, :n], table[..., n:-1, -1:]], axis=-1)


def _projected(table: Array, back: Array, n: int) -> Array:
    """Products of the free columns and the error once their shares of the starts are taken off."""
    kept = [*range(n), table.shape[-1] - 1]
    own = table[..., kept, :][..., :, kept]
    across = np.swapaxes(back, 1, 2)[:, None]
    shared = across @ _coupling(table, n)
    # All four terms: an error of the solution then has no effect of first order.
    return np.asarray(
        own - shared - np.swapaxes(shared, -1, -2) + across @ table[..., n:-1, n:-1] @ back[:, None]
    )


def _condensed(gram: Array) -> Array:
    """Few rows with these products of their columns."""
    diagonal = np.diag(gram)
    # A column spanned by the starts is zero up to rounding, which may be negative.
    there = diagonal > 0.0
    scale = np.sqrt(np.where(there, diagonal, 1.0))
    cosines = np.where(np.outer(there, there), gram / scale / scale[:, None], 0.0)
    weight, vectors = np.linalg.eigh(np.clip(cosines, -1.0, 1.0))
    return np.asarray(np.sqrt(np.maximum(weight, 0.0))[:, None] * vectors.T * scale)


def _diverged(windows: int, n: int, size: int) -> Reduced:
    nothing = np.zeros((1, n))
    steps = np.zeros((windows, size)), np.zeros((windows, size, n))
    return Reduced(np.zeros(1), nothing, float("inf"), np.zeros(size), np.zeros(size), nothing, *steps)


class OneRun(NamedTuple):
    """The windows of one run."""

    rows: Index  # their places among all windows
    run: Run
    shooting: Shooting


class Shooting:
    """Windows of logs simulated by one model, with derivatives in the parameters `free`.

    `weight` (2n,) is one over the noise of each channel, zero for one that is not used.
    `sample_weights` (b, k, 2n) weight samples in the sum of squares in addition; None: all equal. `values`
    says where values by run are in p if these are not among the free parameters.
    """

    def __init__(
        self,
        functions: Functions,
        windows: Windows,
        free: Sequence[str],
        weight: Array,
        *,
        compiled: bool | None = None,
        values: RunValues | None = None,
    ) -> None:
        self.functions, self.windows, self.free, self.weight = functions, windows, tuple(free), weight
        self.sample_weights: Array | None = None
        self._starts_only = False  # derivatives in parameters are of no use
        self._columns = RunValues(functions, free)
        self.values = self._columns if values is None else values
        self.places = list(self._columns.local)
        self.predictor = Predictor(functions, compiled=compiled)
        self._size = len(windows.names)
        self.by_run = self._runs() if self.values.split else []

    def _runs(self) -> list[OneRun]:
        """The windows of every run with a model of their own."""
        found = []
        for place in np.unique(self.windows.run).tolist():
            rows, windows = self.windows.of_run(place)
            shooting = copy(self)
            shooting.windows, shooting.free = windows, self._columns.names
            shooting.predictor, shooting.by_run = self.predictor.for_other_windows(), []
            found.append(OneRun(rows, self.windows.runs[place], shooting))
        return found

    def _of_run(self, one: OneRun, p: Array) -> tuple[Shooting, Array]:
        """The windows of one run with the weights of now, and its parameters."""
        one.shooting.weight = self.weight
        one.shooting.sample_weights = None if self.sample_weights is None else self.sample_weights[one.rows]
        return one.shooting, self.values.of_run(p, one.run)

    def _gathered(self, by_run: Callable[[OneRun], Array]) -> Array:
        """The values of the windows of every run, (b, ...), in their order."""
        parts = [by_run(one) for one in self.by_run]
        found = np.empty((len(self.windows), *parts[0].shape[1:]))
        for one, part in zip(self.by_run, parts, strict=True):
            found[one.rows] = part
        return found

    def reports(self, p: Array, starts: Array) -> Array:
        """What the sensors would report in every window, shape (b, k, 2n); NaN in the padding."""

        def of(one: OneRun) -> Array:
            shooting, own = self._of_run(one, p)
            return shooting.reports(own, starts[one.rows])

        return self._gathered(of) if self.by_run else self.predictor.reports(self.windows, p, starts)

    def measured_starts(self, p: Array) -> Array:
        """True pose and velocity at the start of every window as measured, shape (b, 2n)."""
        if self.by_run:
            return self._gathered(lambda one: one.shooting.measured_starts(self.values.of_run(p, one.run)))
        return self.predictor.start_and_commands(self.windows, p)[0][:, : self._size]

    def fitted_starts(self, p: Array) -> Array:
        """Starts of the windows that fit these parameters best, shape (b, 2n).

        A start read from the log at one sample is inaccurate, and a window may diverge from there: then its
        beginning is fitted first, then twice as much, and so on, until the whole window is.
        """
        first, length = self.measured_starts(p), self.windows.t.shape[1]
        every = np.arange(len(self.windows))
        # In a velocity that was derived from the pose every sample is far off.
        if any(run.derived for run in self.windows.runs):
            return self._fitted_progressively(every, p, first)[0]
        starts, squares = self._subset(every, length, p)._stepped(p, first)
        wrong = np.flatnonzero(squares > SETTINGS.wrong_start * np.median(squares))
        if len(wrong):
            opened, after = self._fitted_progressively(wrong, p, first[wrong])
            starts[wrong] = np.where((after < squares[wrong])[:, None], opened, starts[wrong])
        return starts

    def better_starts(self, p: Array, first: Array, second: Array) -> tuple[Array, float]:
        """Of two starts of every window, (b, 2n) each, those that fit better, and their sum of squares."""
        squares, others = self.squares(p, first), self.squares(p, second)
        better = others < squares
        return np.where(better[:, None], second, first), float(np.where(better, others, squares).sum())

    def _fitted_progressively(self, rows: Index, p: Array, starts: Array) -> tuple[Array, Array]:
        """Starts of some windows, fitted to more and more of each, and the mean square of each with them."""
        windows = self.windows.take(rows, self.windows.t.shape[1])
        elapsed, part = windows.t - windows.t[:, :1], SETTINGS.first_part
        while part < np.max(elapsed):
            within = windows.inside & (elapsed <= part)
            beginning = self._subset(rows, int(within.sum(axis=1).max()), p)
            weight = 1.0 if beginning.sample_weights is None else beginning.sample_weights
            beginning.sample_weights = np.where(within[:, : beginning.windows.t.shape[1], None], weight, 0.0)
            starts, part = beginning._stepped(p, starts)[0], 2.0 * part
        return self._subset(rows, windows.t.shape[1], p)._stepped(p, starts)

    def _subset(self, rows: Index, most: int, p: Array) -> Shooting:
        """Some of the windows, each with its first samples, to fit their starts for these parameters."""
        some = copy(self)
        for cached in ("used", "_reports_states"):
            vars(some).pop(cached, None)
        some.windows, some._starts_only = self.windows.take(rows, most), True
        some.sample_weights = None if self.sample_weights is None else self.sample_weights[rows, :most]
        if self.by_run:
            some.by_run = some._runs()
        else:
            some.predictor = self.predictor.for_first_samples(self.windows, rows, some.windows, p)
        return some

    def _stepped(self, p: Array, starts: Array) -> tuple[Array, Array]:
        """Starts after Gauss-Newton steps of their own, and the mean square of each window with them.

        A window accepts only steps that reduce its cost.
        """
        squares = self.mean_squares(p, starts)
        for _ in range(SETTINGS.steps):
            at = self.linearise(p, starts)
            if not np.isfinite(at.cost):
                break
            tried = starts + at.start_step
            found = self.mean_squares(p, tried)
            better = found < squares
            gained = np.any(found < (1.0 - SETTINGS.least_gain) * squares)
            starts, squares = np.where(better[:, None], tried, starts), np.minimum(found, squares)
            if not gained:
                break
        return starts, squares

    def cost(self, p: Array, starts: Array) -> float:
        """Weighted sum of squares of the simulation error; inf if a simulation diverged."""
        r = self._residual(self.reports(p, starts))
        with np.errstate(over="ignore"):
            total = float(np.sum(r**2))
        return total if np.isfinite(total) else float("inf")

    def mean_squares(self, p: Array, starts: Array) -> Array:
        """Weighted mean square of the simulation error by window, shape (b,); inf where one diverged."""
        return self.squares(p, starts) / np.maximum(self.used.sum(axis=(1, 2)), 1)

    def squares(self, p: Array, starts: Array) -> Array:
        """Weighted sum of squares of the simulation error by window, shape (b,); inf where one diverged."""
        r = self._residual(self.reports(p, starts))
        with np.errstate(over="ignore"):
            total = np.sum(r**2, axis=(1, 2))
        return np.where(np.isfinite(total), total, np.inf)

    def linearise(self, p: Array, starts: Array) -> Reduced:
        """Simulate with sensitivities and eliminate the starts window by window."""
        parts = self._products(p, starts)
        counts = np.count_nonzero(self._all_weights(slice(None)), axis=(0, 1)).astype(float)
        return eliminated(parts, counts, len(self.free))

    def _products(self, p: Array, starts: Array) -> list[Products]:
        """Sums over windows, batch by batch, in the order of the windows."""
        if self.by_run:
            return [part for one in self.by_run for part in self._products_of_run(one, p, starts[one.rows])]
        finite = self.delay_slopes(
            p, lambda moved: self.predictor.reports(self.windows, moved, starts, near=p)
        )
        inherited = self.inherited_slopes(p, starts)
        start, commands = self.predictor.start_and_commands(self.windows, p, starts)
        return [
            self._batch_products(rows, p, start[rows], commands[rows], inherited[rows], finite)
            for rows in self._batches()
        ]

    def _products_of_run(self, one: OneRun, p: Array, starts: Array) -> Iterator[Products]:
        """Sums over the windows of one run, with a row and a column for every free parameter."""
        shooting, own = self._of_run(one, p)
        columns, more = self._columns.columns(one.run), len(self.free) - len(self._columns.names)
        for part in shooting._products(own, starts):
            size = part.table.shape[-1]
            places = np.concatenate([columns, np.arange(len(columns), size) + more])
            kept = np.flatnonzero(places >= 0)
            table = np.zeros((*part.table.shape[:-2], size + more, size + more))
            table[..., places[kept][:, None], places[kept]] = part.table[..., kept[:, None], kept]
            yield replace(part, table=table)

    # --- simulation ---------------------------------------------------------------------------
    def _residual(self, reported: Array, rows: slice = slice(None)) -> Array:
        """Weighted simulation error, shape (b, k, 2n); zero where nothing was measured."""
        with np.errstate(over="ignore", invalid="ignore"):  # a simulation on its way to infinity
            error = (reported - self.windows.measured[rows]) * self._weights(rows)
        return np.where(self.used[rows], error, 0.0)

    def _weights(self, rows: slice) -> Array:
        """Weights of errors, of a shape that broadcasts to (b, k, 2n)."""
        samples = self.sample_weights
        return self.weight if samples is None else self.weight * np.sqrt(samples[rows])

    def errors(self, p: Array, starts: Array) -> Array:
        """Simulation error over the noise of its channel, whatever its trust; NaN where there is none."""
        reported = self.reports(p, starts)
        return np.where(self.used, (reported - self.windows.measured) * self.weight, np.nan)

    @cached_property
    def used(self) -> Flags:
        """Which samples of which channels count, shape (b, k, 2n)."""
        return np.isfinite(self.windows.measured) & (self.weight > 0)

    def _batches(self) -> Iterator[slice]:
        columns = len(self.free) + self._size
        one = self.windows.t.shape[1] * len(self.functions.state_names) * columns
        size = max(1, SETTINGS.batch // one)
        return (slice(i, i + size) for i in range(0, len(self.windows), size))

    # --- derivatives --------------------------------------------------------------------------
    @cached_property
    def _delays(self) -> list[int]:
        """Which free parameters delay commands or sensors."""
        influential = set(ca.jacobian_sparsity(self._dead_times, self.functions.p).get_col())
        return [k for k, place in enumerate(self.places) if place in influential]

    @cached_property
    def _acting_before(self) -> list[int]:
        """Which of the others act on the states of its own that a model has at the start of a window."""
        f = self.functions
        inherited = [f.actuator_rates, f.actuator_rest] if f.actuator_states.shape[0] else []
        inherited += [f.memory_rates] if f.memory.shape[0] else []
        influential = set(ca.jacobian_sparsity(ca.vertcat(ca.SX(0, 1), *inherited), f.p).get_col())
        return [k for k, place in enumerate(self.places) if place in influential and k not in self._delays]

    @property
    def _dead_times(self) -> ca.SX:
        f = self.functions
        return ca.vertcat(f.convert(f.vehicle.composition.dead_time), f.report_age)

    def delay_slopes(self, p: Array, of: Callable[[Array], Array]) -> dict[int, Array]:
        """Derivatives in those free parameters that delay commands or sensors, by finite differences."""
        sample = float(np.median(np.diff(self.windows.runs[0].t)))
        delays = [] if self._starts_only else self._delays
        return {k: self._difference(p, of, k, SETTINGS.delay_difference * sample, 0.0) for k in delays}

    def inherited_slopes(self, p: Array, starts: Array) -> Array:
        """Derivatives of the states at the starts in the free parameters, shape (b, nx, n_free).

        A model's own states there (actuators, memory) are results of what was logged before.
        """
        slopes = np.zeros((len(starts), len(self.functions.state_names), len(self.free)))
        if self._starts_only:
            return slopes

        def own(moved: Array) -> Array:
            start, _ = self.predictor.start_and_commands(self.windows, moved, starts, near=p)
            return start[:, self._size :]

        for k in self._acting_before:
            step = SETTINGS.difference * max(abs(p[self.places[k]]), SETTINGS.least_size)
            slopes[:, self._size :, k] = self._difference(p, own, k, step)
        return slopes

    def _difference(
        self, p: Array, of: Callable[[Array], Array], k: int, step: float, least: float = -np.inf
    ) -> Array:
        place = self.places[k]
        high, low = p[place] + step, max(p[place] - step, least)  # no dead time is negative
        ends = []
        for value in (high, low):
            moved = p.copy()
            moved[place] = value
            ends.append(of(moved))
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging simulation is rejected by its cost
            return np.asarray((ends[0] - ends[1]) / (high - low))

    def _batch_products(
        self,
        rows: slice,
        p: Array,
        start: Array,
        commands: WindowCommands,
        inherited: Array,
        finite: dict[int, Array],
    ) -> Products:
        t = self.windows.t[rows]
        measured, weight = self.windows.measured[rows], self._all_weights(rows)
        if self._reports_states:
            known = (commands.zero_filled(measured), commands.zero_filled(weight), self._groups(commands.t))
            return self.predictor.simulator.products(
                *(start, commands.t, commands.held, p, self.places, *known),
                start_slopes=inherited,
                max_step=commands.longest_step,
            )
        x, s = self.sensitivities(start, commands, p, inherited)
        reported, slope = self._reported_late(*self.report_slopes(x, s, commands.u, t, p), rows, p)
        for k, values in finite.items():
            slope[..., k] = values[rows]
        return products_of(reported, slope, measured, weight, self._groups(t))

    def sensitivities(
        self, start: Array, commands: WindowCommands, p: Array, inherited: Array
    ) -> tuple[Array, Array]:
        """States at the samples, (b, k, nx), and their derivatives in the free parameters and the starts.

        `inherited` are those of the states at the starts, as of `inherited_slopes`.
        """
        x, s = self.predictor.simulator.run_with_sensitivities(
            start,
            commands.t,
            commands.held,
            p,
            self.places,
            initial=range(self._size),
            start_slopes=inherited,
            max_step=commands.longest_step,
        )
        return commands.at_samples(x), commands.at_samples(s)

    @cached_property
    def _reports_states(self) -> bool:
        """Whether all that is compared are states of the simulation, and no delay is estimated."""
        sensor_delay = self.predictor.sensor_delay
        direct = self._starts_only or not self._delays
        return self.predictor.ideal_sensors and not sensor_delay.present and direct

    def _all_weights(self, rows: slice) -> Array:
        """Weight of every error, shape (b, k, 2n); zero where nothing was measured."""
        return np.where(self.used[rows], self._weights(rows), 0.0)

    def _groups(self, t: Array) -> Integers:
        """Part of its window that a sample belongs to, shape (b, k); parts count as independent."""
        parts = np.floor((t - t[:, :1]) / SETTINGS.block)
        return np.minimum(parts, np.maximum((t[:, -1:] - t[:, :1]) / SETTINGS.block - 0.5, 0)).astype(
            np.int64
        )

    def _reported_late(self, reported: Array, slope: Array, rows: slice, p: Array) -> tuple[Array, Array]:
        """Report and slopes at the time that they come; what was before a window moves with nothing."""
        if not self.predictor.sensor_delay.present:
            return reported, slope
        t, before = self.windows.t[rows], self.windows.start[rows]
        seconds = self.predictor.sensor_delay.seconds(p)
        still = np.zeros((*before.shape, slope.shape[3]))
        return reported_late(reported, t, seconds, before), reported_late(slope, t, seconds, still)

    def report_slopes(self, x: Array, s: Array, u: Array, t: Array, p: Array) -> tuple[Array, Array]:
        """Report (b, k, 2n) and its derivative in free parameters and starts (b, k, 2n, n_free + 2n)."""
        if self.predictor.ideal_sensors:
            return x[..., : self._size], s[..., : self._size, :].copy()
        b, k, nx = x.shape
        rows = [x.reshape(b * k, nx), u.reshape(b * k, -1), p, t.reshape(b * k, 1)]
        y, by_x, by_p = at_samples(self._report, rows, b * k)
        patterns = (self._report.sparsity_out(i) for i in (1, 2))
        through, direct = (zip(a.row(), a.get_col(), strict=True) for a in patterns)
        carried = s.reshape(b * k, nx, -1)
        slope = carried[:, : self._size].copy()
        slope[:, self._altered] = 0.0
        for (i, j), factor in zip(through, by_x.T, strict=True):
            if i in self._altered:
                slope[:, i] += factor[:, None] * carried[:, j]
        for (i, j), factor in zip(direct, by_p.T, strict=True):
            slope[:, i, j] += factor
        return y.reshape(b, k, -1), slope.reshape(b, k, self._size, -1)

    @cached_property
    def _altered(self) -> list[int]:
        """Channels that are not reported as they are."""
        f = self.functions
        states = f.x[: self._size]
        return [i for i in range(self._size) if not ca.is_equal(f.reported[i], states[i], 2)]

    @cached_property
    def _report(self) -> ca.Function:
        """Report, and its (sparse) derivatives in states and free parameters."""
        f = self.functions
        free = ca.vertcat(*[f.p[i] for i in self.places])
        slopes = [ca.sparsify(ca.jacobian(f.reported, variables)) for variables in (f.x, free)]
        return ca.Function("report", [f.x, f.u, f.p, f.t], [ca.densify(f.reported), *slopes])
