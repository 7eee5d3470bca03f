"""The weak residual of a model on prepared logs, with its derivative in the free parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import casadi as ca
import numpy as np

from undertow.codegen.engine import at_samples
from undertow.codegen.functions import Functions
from undertow.errors import UndertowError
from undertow.identification.logs.run import Run, between
from undertow.typing import Array, Flags, Index

from .data import Segment, WeakData, residual_covariance
from .inputs import Actuation, ActuatorStates, DrivenSignal, Memory
from .pointwise import Cut, Pointwise, largest_values, positive_matrices
from .test_functions import Entries, Supports, Whitening, overlap, weighted_sums, weights_and_equation

# --- parameters that have a value of their own in every run ---------------------------------------
# A free parameter V_N@dive2 is the value of V_N in the run "dive2". All parameters of a model stand in one
# vector p: first those of the vehicle, as the equations have them, then the values by run. Residuals and
# simulations take the parameters of one run at a time, `RunValues.of_run`; derivatives go back to the columns
# of the free parameters, `RunValues.columns`.

_AT = "@"


def base_name(name: str) -> str:
    """The parameter behind a free one: V_N for V_N@dive2."""
    return name.partition(_AT)[0]


def run_of(name: str) -> str:
    """Run that a free parameter belongs to; empty for one of all runs."""
    return name.partition(_AT)[2]


def value_name(name: str, run: str) -> str:
    """Name of the value of a parameter in one run."""
    return f"{name}{_AT}{run}"


def origins(runs: Sequence[Run]) -> tuple[str, ...]:
    """Names of these runs, or of the runs of which they are segments, each once."""
    return tuple(dict.fromkeys(run.origin for run in runs))


def with_values_by_run(free: Sequence[str], names: Sequence[str], runs: Sequence[str]) -> tuple[str, ...]:
    """Free parameters of which some have a value in every run; of a single run they are what they were."""
    if len(runs) < 2:
        return tuple(free)
    split = [value_name(n, run) for n in free if n in names for run in runs]
    return (*(n for n in free if n not in names), *split)


class RunValues:
    """Where the values of the free parameters of a model are, for each run.

    `known` are values, by names such as V_N@dive2, in runs that are not fitted.
    """

    def __init__(
        self, functions: Functions, free: Sequence[str], known: Mapping[str, float] | None = None
    ) -> None:
        self.known = dict(known or {})
        self.free, self.size = tuple(free), len(functions.parameter_names)
        #: Free parameters as the equations have them, each once.
        self.names = tuple(dict.fromkeys(map(base_name, self.free)))
        self._place = {name: i for i, name in enumerate(functions.parameter_names)}
        #: Values by run, in the order in which they stand in p.
        self.split = tuple(n for n in self.free if _AT in n)
        tied = [n for n in self.by_run if n in functions.equal or functions.followers(n)]
        if tied:
            raise UndertowError(
                f"{tied[0]} is tied to another parameter and also has a value in every run: drop the tie, "
                f"or write per_run = false for {tied[0]}"
            )

    @cached_property
    def by_run(self) -> dict[str, list[str]]:
        """Names of the values by run of every parameter that has them."""
        found: dict[str, list[str]] = {}
        for name in self.split:
            found.setdefault(base_name(name), []).append(name)
        return found

    @cached_property
    def name_index(self) -> Index:
        """Place among `names` of the parameter behind every free one."""
        return np.array([self.names.index(base_name(n)) for n in self.free], dtype=np.intp)

    @cached_property
    def places(self) -> tuple[int, ...]:
        """Places of the free parameters in p."""
        after = {name: self.size + i for i, name in enumerate(self.split)}
        return tuple(after[n] if n in after else self._place[n] for n in self.free)

    @cached_property
    def local(self) -> tuple[int, ...]:
        """Places, among the parameters of one run, of those that are free."""
        return tuple(self._place[n] for n in self.names)

    def initial_p(self, stated: Array, start: Mapping[str, float]) -> Array:
        """All parameters with these starting values; a run without one has that of the others."""
        p = np.concatenate([stated, np.zeros(len(self.split))])
        for name, value in start.items():
            if name in self._place:
                p[self._place[name]] = value
        given: dict[str, list[float]] = {}
        for name, value in start.items():
            if _AT in name and base_name(name) in self._place:
                given.setdefault(base_name(name), []).append(value)
        for name, values in given.items():
            if name not in start:
                p[self._place[name]] = float(np.mean(values))
        for i, name in enumerate(self.split):
            p[self.size + i] = start.get(name, p[self._place[base_name(name)]])
        return p

    def of_run(self, p: Array, run: Run) -> Array:
        """Parameters of the vehicle in one run; a run without values of its own has the means of the others.

        p: (n_parameters + values by run,). Returns (n_parameters,).
        """
        if not (self.split or self.known):
            return p
        found, values = p[: self.size].copy(), dict(zip(self.split, p[self.size :].tolist(), strict=True))
        for name, there in self.by_run.items():
            found[self._place[name]] = float(np.mean([values[n] for n in there]))
        for name, value in (self.known | values).items():
            if run_of(name) == run.origin:
                found[self._place[base_name(name)]] = value
        return found

    def columns(self, run: Run) -> Index:
        """Column among the free parameters of each that the equations have; -1 for what is not free there."""
        names = [value_name(n, run.origin) if n in self.by_run else n for n in self.names]
        return np.array([self.free.index(n) if n in self.free else -1 for n in names], dtype=np.intp)

    def expanded(self, J: Array, run: Run) -> Array:
        """Derivatives (..., n_names) in the parameters of one run, in those of all (..., n_free)."""
        if not self.split:
            return J
        columns = self.columns(run)
        found = np.zeros((*J.shape[:-1], len(self.free)))
        found[..., columns[columns >= 0]] = J[..., columns >= 0]
        return found


class JointLimits:
    """Joint constraints on parameters: matrices that have to be positive, in every run that has values."""

    def __init__(self, functions: Functions, values: RunValues, *, dissipative: bool) -> None:
        self._all = positive_matrices(functions, values.local, dissipative=dissipative)
        self._matrices = [matrix for matrix in self._all if matrix.varies]
        self._values = values
        # Without values by run, a run without a name has those of all.
        names = dict.fromkeys(run_of(n) for n in values.split) or [""]
        self._runs = [Run(name, np.zeros(0), {}) for name in names]

    def _by_run(self, p: Array) -> list[Array]:
        return [self._values.of_run(p, run) for run in self._runs]

    def cuts(self, p: Array) -> list[Cut]:
        """Inequalities on a step from p for every matrix to be positive; empty if all are."""
        pairs = zip(self._runs, self._by_run(p), strict=True)
        found = ((run, cut) for run, own in pairs for matrix in self._matrices for cut in matrix.cuts(own))
        return [Cut(self._values.expanded(cut.slope, run), cut.limit) for run, cut in found]

    def violated(self, p: Array) -> bool:
        """Whether a matrix is not positive at p."""
        return any(matrix.is_negative(own) for own in self._by_run(p) for matrix in self._matrices)

    def impossible(self, p: Array) -> list[str]:
        """Names of all matrices that are not positive at p, including those without free parameters."""
        found = (m.described(own) for own in self._by_run(p) for m in self._all if m.is_negative(own))
        return list(dict.fromkeys(found))

    def active(self, p: Array) -> list[str]:
        """Names of the active limits, with the motions that they concern."""
        found = (m.described(own) for own in self._by_run(p) for m in self._matrices if m.is_at_limit(own))
        return list(dict.fromkeys(found))

    def after_step(self, p: Array, step: Array) -> Array:
        """All parameters after a step of the free ones."""
        found = p.copy()
        found[list(self._values.places)] += step
        return found


# --- the residual ---------------------------------------------------------------------------------
@dataclass(frozen=True)
class ResidualSettings:
    """Numbers of sensor delays, dead times and spikes in the weak residual."""

    # Samples to either side of an instant. A kernel with a gain below one would reduce the noise as well, and
    # favour a delay for that reason alone: with four the gain is within 0.001 of 1 up to 0.15 of the sampling
    # rate, with three it is not.
    interpolation: int = 4
    # Sum of squared weights from which uneven samples amplify noise instead of interpolating.
    most_amplified: float = 2.0
    delay_step: float = 1e-3  # of finite differences, relative to a sampling interval
    # Rows of which nothing is known that are projected out; of a longer dead time the rest counts as it is.
    most_directions: int = 240
    # Influence of a start that has decayed, in units of the noise, and relative to the largest one.
    decayed: float = 1e-9
    # Neighbours on each side that a sample is held against, by the cubic through them.
    neighbours: int = 2
    reports: int = 4  # reports of a channel that is examined are more than so many times the neighbours
    # Standard deviations from which a sample is a spike: noise alone gets there once in two million samples.
    spike: float = 5.0
    # Share of the change to the next sample that a cubic may miss: a kink where thrust jumps is not a spike.
    bend: float = 0.25
    spike_rounds: int = 30


SETTINGS = ResidualSettings()


class SensorDelay:
    """Age of every measured channel, and a segment corrected for it."""

    def __init__(self, functions: Functions, free: tuple[int, ...] = ()) -> None:
        self._functions, self._free = functions, free

    @cached_property
    def present(self) -> bool:
        """Whether any channel can be late."""
        return bool(self._functions.report_age.nnz())

    def seconds(self, p: Array) -> Array:
        """How old each of the 2n channels is when it is reported, s."""
        return np.asarray(self._dead_time(p)[0]).ravel()

    def aligned_signals(self, t: Array, measured: Array, p: Array) -> Array:
        """Reported signals (N, 2n), each when it was true; the same array where nothing is late."""
        return _delayed(t, measured, self.seconds(p)) if self.present else measured

    def in_time(self, s: Segment, p: Array) -> Segment:
        """The segment with each channel at the time that it was true; itself where nothing is late."""
        if not self.present:
            return s
        seconds = self.seconds(p)
        return _moved(s, seconds) if _usable_functions(s, seconds) else s

    def residuals(
        self, segments: list[Segment], p: Sequence[Array], of: Callable[[list[Segment]], list[Linearised]]
    ) -> list[Linearised]:
        """Residuals `of` segments at their true times, and their derivatives in the delays as well.

        p: parameters for each segment. Test functions that reach beyond the last true value are marked as
        unknown.
        """
        if not self.present:
            return of(segments)
        seconds = [self.seconds(q) for q in p]
        functions = [_usable_functions(s, late) for s, late in zip(segments, seconds, strict=True)]
        moved = [_moved(s, late) if n else s for s, late, n in zip(segments, seconds, functions, strict=True)]
        parts = of(moved)
        slopes = np.array([self._slopes(q) * (n > 0) for q, n in zip(p, functions, strict=True)])
        # From the smoothed rate: differentiated noise would suggest a precision that does not exist.
        rates = [_delayed(s.t, s.rate, late) for s, late in zip(segments, seconds, strict=True)]
        J = [part.J.copy() for part in parts]
        for k in np.flatnonzero(np.any(slopes, axis=(0, 1))).tolist():
            steps = [SETTINGS.delay_step * float(np.median(np.diff(s.t))) for s in segments]
            each = zip(moved, rates, slopes, steps, strict=True)
            changed = of([replace(s, measured=s.measured + h * own[:, k] * rate) for s, rate, own, h in each])
            for own, part, other, h in zip(J, parts, changed, steps, strict=True):
                own[:, k] += (other.r - part.r) / h
        found = (replace(part, J=own) for part, own in zip(parts, J, strict=True))
        every = zip(found, segments, functions, strict=True)
        return [_of_functions(part, s, n) if n else part for part, s, n in every]

    def _slopes(self, p: Array) -> Array:
        """Derivative of the delay of every channel in the free parameters, (2n, n_free)."""
        return np.asarray(self._dead_time(p)[1])

    @cached_property
    def _dead_time(self) -> ca.Function:
        f = self._functions
        free = ca.vertcat(*[f.p[i] for i in self._free]) if self._free else ca.SX(0, 1)
        slope = ca.jacobian(f.report_age, free)
        return ca.Function("report_age", [f.p], [ca.densify(f.report_age), ca.densify(slope)])


def _usable_functions(s: Segment, seconds: Array) -> int:
    """How many test functions lie before the last instant at which all channels are known, or none.

    A segment hardly longer than the delay does not show it and is used as measured. If it dropped out, long
    delays would look good because little data remain.
    """
    beyond = s.t + np.max(seconds) > s.t[-1]
    lost = int(np.count_nonzero(abs(s.functions.value) @ beyond > 1e-12))
    return s.functions.count - lost if 2 * lost < s.functions.count else 0


def _of_functions(part: Linearised, s: Segment, count: int) -> Linearised:
    """A residual of which only the first test functions are known."""
    known = count * (len(part.r) // s.functions.count)
    inside = np.arange(len(part.r)) < known
    r, J, start = part.r * inside, part.J * inside[:, None], part.start * inside[:, None]
    return replace(part, r=r, J=J, start=start, known=known)


def _moved(s: Segment, seconds: Array) -> Segment:
    return replace(s, measured=_delayed(s.t, s.measured, seconds))


def _delayed(t: Array, signals: Array, seconds: Array) -> Array:
    """Each signal at the times t plus its own delay."""
    found = signals.copy()
    for delay in np.unique(seconds[seconds != 0]):
        columns = np.flatnonzero(seconds == delay)
        found[:, columns] = interpolated(t, signals[:, columns], t + delay)
    return found


def interpolated(t: Array, y: Array, when: Array) -> Array:
    """Sampled signals (N, k) at other instants, by the polynomial through the eight samples around.

    After the last sample its value is held.
    """
    if len(t) < 2:
        return np.repeat(y, len(when), axis=0)
    index, weight = stencil(t, when)
    return np.asarray(np.einsum("mj,mjk->mk", weight, y[index]))


def stencil(t: Array, when: Array) -> tuple[Index, Array]:
    """Samples around each instant and their weights, both of shape (M, 8).

    Near the ends, and where intervals differ so much that noise would be amplified, fewer samples are used.
    """
    when = np.minimum(when, t[-1])
    left = np.clip(np.searchsorted(t, when, side="right") - 1, 0, len(t) - 2)
    most = SETTINGS.interpolation
    index = np.clip(left[:, None] + np.arange(1 - most, 1 + most), 0, len(t) - 1)
    weight = np.zeros(index.shape)
    pending = np.ones(len(when), dtype=bool)
    for reach in range(most, 0, -1):
        rows = np.flatnonzero(pending & (left + 1 >= reach) & (left + reach < len(t)))
        columns = slice(most - reach, most + reach)
        found = lagrange(t[index[rows, columns]], when[rows])
        good = (np.sum(found**2, axis=1) <= SETTINGS.most_amplified) | (reach == 1)
        weight[rows[good], columns] = found[good]
        pending[rows[good]] = False
    return index, weight


def lagrange(nodes: Array, when: Array) -> Array:
    """Weights of the polynomial through values at `nodes` (M, k)."""
    weight = np.ones(nodes.shape)
    for j in range(nodes.shape[1]):
        for k in range(nodes.shape[1]):
            if k != j:
                weight[:, j] *= (when - nodes[:, k]) / (nodes[:, j] - nodes[:, k])
    return weight


@dataclass(frozen=True)
class Linearised:
    """A residual and its derivatives."""

    r: Array  # (m,) residual
    J: Array  # (m, n_free) derivative in the free parameters
    start: Array  # (m, n_states) derivative in the effects' own states at the start of the segment
    # Number of rows before the first that needs reports from after the segment; those have no weight
    known: int | None = None
    unknown: int = 0  # How many of the last columns of `start` each stand for an unknown row

    def split(self, counts: Sequence[int]) -> list[Linearised]:
        """Parts of so many rows."""
        edges = np.cumsum(counts)[:-1]
        tables = (np.split(a, edges) for a in (self.r, self.J, self.start))
        return [Linearised(*arrays) for arrays in zip(*tables, strict=True)]


class _LastLinearisation(NamedTuple):
    """The last linearisation on some data: a fit, its score and its noise need it at the same parameters."""

    data: WeakData
    p: Array
    parts: list[Linearised]


class WeakModel:
    """Weak residuals of one vehicle for a choice of free parameters, some of them values in one run."""

    def __init__(
        self,
        functions: Functions,
        free: Sequence[str],
        *,
        dissipative: bool = False,
        known: Mapping[str, float] | None = None,
    ) -> None:
        self.functions, self._dissipative = functions, dissipative
        self.free, self.values = tuple(free), RunValues(functions, free, known)
        self.places, local = self.values.places, self.values.local
        self._chain = ActuatorStates(functions, local)
        self._points = Pointwise(functions, local, actuators_vary=self._chain.varies)
        self._memory = Memory(functions, local, self._points.measured, self._points.true_motion)
        self._sensor_delay = SensorDelay(functions, local)
        self._cache: dict[int, _LastLinearisation] = {}

    @cached_property
    def limits(self) -> JointLimits:
        """What the parameters can be together."""
        return JointLimits(self.functions, self.values, dissipative=self._dissipative)

    @cached_property
    def largest(self) -> Array:
        """Largest magnitude of every free parameter that a vehicle of this size allows."""
        own = largest_values(self.functions, self.values.names)
        return own[self.values.name_index]

    def with_free(self, free: Sequence[str]) -> WeakModel:
        """The same equations and constraints with other free parameters."""
        return WeakModel(self.functions, free, dissipative=self._dissipative, known=self.values.known)

    def with_known_values(self, values: Mapping[str, float]) -> WeakModel:
        """The same model with values, by names such as V_N@dive2, in runs that are not fitted."""
        other = copy(self)
        other.values, other._cache = RunValues(self.functions, self.free, values), {}
        return other

    def initial_p(self, start: Mapping[str, float]) -> Array:
        """All parameters: the vehicle's, those in `start` replaced."""
        return self.values.initial_p(np.array(self.functions.values(), dtype=float), start)

    def linearise(self, data: WeakData, p: Array) -> list[Linearised]:
        """Residual and derivative of every segment, rows ordered by test function, then by equation."""
        known = self._cache.get(id(data))
        if known is None or known.data is not data or not np.array_equal(known.p, p):
            parts = self._linearised(data, p)
            for array in (a for part in parts for a in (part.r, part.J, part.start)):
                array.setflags(write=False)  # it is shared
            known = self._cache[id(data)] = _LastLinearisation(data, p.copy(), parts)
        return list(known.parts)

    def require_defined(self, data: WeakData, p: Array) -> None:
        """Refuse a model whose residual is not finite somewhere along the logs."""
        for part, s in zip(self.linearise(data, p), data.segments, strict=True):
            if not (np.isfinite(part.r).all() and np.isfinite(part.J).all()):
                name, run = self.functions.vehicle.name, data.runs[s.run].name
                raise UndertowError(
                    f"vehicle '{name}' has no finite force somewhere in run '{run}' from {s.t[0]:.4g} to "
                    f"{s.t[-1]:.4g} s: an effect is not defined in that motion, or a value is too large; "
                    f"'undertow effects check' tries an effect of your own"
                )

    def _linearised(self, data: WeakData, p: Array) -> list[Linearised]:
        own = [self.values.of_run(p, run) for run in data.runs]
        driven = self._driven(data, own)
        along = [_SegmentInputs(s, _in_segment(driven[s.run], s), own[s.run]) for s in data.segments]
        batches = (self._in_batch(along[part], windows, data.rows) for part, windows in data.batches)
        parts = list(chain.from_iterable(batches))
        found = []
        for one, part in zip(along, parts, strict=True):
            run = data.runs[one.s.run]
            expanded = replace(part, J=self.values.expanded(part.J, run))
            known = run.t[0] + self._chain.dead_time(one.p)
            found.append(_without_past_commands(known, expanded, one.s, data.rows, self._points.size))
        return found

    def _in_batch(
        self, along: Sequence[_SegmentInputs], windows: Supports, rows: tuple[int, ...]
    ) -> list[Linearised]:
        def of(segments: list[Segment]) -> list[Linearised]:
            given = [one._replace(s=s) for one, s in zip(along, segments, strict=True)]
            return self._evaluated(given, windows, rows)

        return self._sensor_delay.residuals([one.s for one in along], [one.p for one in along], of)

    def _driven(self, data: WeakData, own: list[Array]) -> list[Actuation]:
        each = zip(data.runs, data.held, own, strict=True)
        return self._chain.along_each([(r.t, u, q) for r, u, q in each])

    def _evaluated(
        self, along: Sequence[_SegmentInputs], windows: Supports, rows: tuple[int, ...]
    ) -> list[Linearised]:
        """Residual of segments at once: many are short, and a call takes as long as hundreds of samples."""
        memories = self._memory.along_each([(s.t, s.measured, a.value, s.u, p) for s, a, p in along])
        each = list(zip(along, memories, strict=True))
        actuation, memory = Actuation.along_all([a for _, a, _ in along]), DrivenSignal.joined(memories)
        inputs = _stacked([self._inputs(s, a, m.value, p) for (s, a, p), m in each])
        entries = self._entries(self._points.value_and_derivatives, inputs, actuation, memory)
        if self._points.held_depends_on_motion:
            later = (
                self._inputs(replace(s, measured=_following(s.measured)), a, _following(m.value), p)
                for (s, a, p), m in each
            )
            others = self._entries(self._points.held_after, _stacked(list(later)), actuation, memory)
            entries += [e.moved_down(self._points.held_rows.start) for e in others]
        sums = self._weak_sums(entries, windows, rows)
        return sums.split([s.functions.count * len(rows) for s, _, _ in along])

    def _inputs(self, s: Segment, actuation: Actuation, memory: Array, p: Array) -> list[Array]:
        forces = s.u[:, actuation.value.shape[1] :]
        before = np.hstack([actuation.before.value, np.vstack([forces[:1], forces[:-1]])])
        inverse, t = self._points.mass_inverse(p), s.t[:, None]
        return [s.measured, actuation.value, memory, s.u, inverse, before, s.kink_delay, p, t]

    def _entries(
        self, function: ca.Function, inputs: list[Array], actuation: Actuation, memory: DrivenSignal
    ) -> list[Entries]:
        """Rows at the samples with their total derivatives in the free parameters and first states."""
        value, free, *by_driven = at_samples(function, inputs, len(inputs[0]))
        first, last = 1, 1 + len(self.values.names)
        pattern, direct, *patterns = (function.sparsity_out(i) for i in range(function.n_out()))
        entries = [Entries.of(value, pattern, 0), Entries.of(free, direct, first)]
        starts = (last, last, last + actuation.start.shape[2])
        for slopes, where, driven, start in zip(
            by_driven, patterns, (actuation, actuation.before, memory), starts, strict=True
        ):
            if not where.size2():
                continue
            entries += [
                Entries.chained(slopes, where, driven.slope, first),
                Entries.chained(slopes, where, driven.start, start),
            ]
        return entries

    def _weak_sums(self, entries: list[Entries], windows: Supports, rows: tuple[int, ...]) -> Linearised:
        width, last = max(e.width for e in entries), 1 + len(self.values.names)
        place = np.full(2 * self._points.size, -1)
        place[list(rows)] = np.arange(len(rows))
        met = [weights_and_equation(e.row, self._points.size) for e in entries]
        target = [
            np.where(place[equation] >= 0, place[equation] * width + e.column, -1)
            for e, (_, equation) in zip(entries, met, strict=True)
        ]
        table = weighted_sums(windows, entries, [kind for kind, _ in met], target, len(rows) * width)
        stacked = table.reshape(-1, width)
        return Linearised(stacked[:, 0].copy(), stacked[:, 1:last].copy(), stacked[:, last:].copy())

    def whitening(self, data: WeakData, p: Array) -> list[Whitening]:
        """Whitening of every segment under the noise of the channels, at parameters p."""
        own = [self.values.of_run(p, run) for run in data.runs]
        driven = self._driven(data, own)
        pairs = ((s, own[s.run]) for s in data.segments)
        return [
            self._segment_whitening(self._sensor_delay.in_time(s, q), _in_segment(driven[s.run], s), data, q)
            for s, q in pairs
        ]

    def _segment_whitening(self, s: Segment, actuation: Actuation, data: WeakData, p: Array) -> Whitening:
        memory = self._memory.along(s.t, s.measured, actuation.value, s.u, p)
        inputs = self._inputs(s, actuation, memory.value, p)
        function = self._points.noise
        (slope,) = at_samples(function, inputs, len(s.t))
        slopes = Entries.of(slope, function.sparsity_out(0), 0)
        sigma = s.noise(data.sigma)
        noise = residual_covariance(s.functions, slopes, sigma, data.rows, data.derived, s.t)
        rows = len(data.rows)
        return Whitening(noise, overlap(s.functions, s.t, rows), np.zeros(rows * s.functions.count))


class _SegmentInputs(NamedTuple):
    """A segment, the actuation along it, and the parameters of its run."""

    s: Segment
    actuation: Actuation
    p: Array


def _stacked(inputs: Sequence[list[Array]]) -> list[Array]:
    """Inputs of segments one after the other; one that is the same for all samples stays so if it can."""
    counts = [len(each[0]) for each in inputs]
    return [_stacked_or_shared(same, counts) for same in zip(*inputs, strict=True)]


def _stacked_or_shared(arrays: Sequence[Array], counts: Sequence[int]) -> Array:
    first = arrays[0]
    if first.ndim > 1:
        return np.concatenate(arrays)
    if all(a is first or np.array_equal(a, first) for a in arrays):
        return first
    return np.repeat(np.stack(arrays), counts, axis=0)


def _following(values: Array) -> Array:
    """The values at the samples after; of the last one that of itself."""
    return np.vstack([values[1:], values[-1:]])


def _in_segment(driven: Actuation, s: Segment) -> Actuation:
    parts = [
        DrivenSignal(d.value[s.samples], d.slope[s.samples], d.start[s.samples])
        for d in (driven, driven.before)
    ]
    return Actuation.of(*parts)


def _without_past_commands(
    begin: float, part: Linearised, s: Segment, rows: tuple[int, ...], n: int
) -> Linearised:
    """A residual whose equations of force have no weight where commands from before the log are at work.

    They are in no log: each row that depends on them has a direction of its own among the first states.
    A segment hardly longer than the delay is kept: if it dropped out, long delays would look good because
    little data remain.
    """
    lost = int(np.searchsorted(s.t[s.functions.supports.first], begin))
    if not 0 < 2 * lost < s.functions.count:
        return part
    forces = [k for k, row in enumerate(rows) if row < n]
    lost = min(lost, SETTINGS.most_directions // max(len(forces), 1))
    places = (np.arange(lost)[:, None] * len(rows) + forces).ravel()
    directions = np.zeros((len(part.r), len(places)))
    directions[places, np.arange(len(places))] = 1.0
    return replace(part, start=np.hstack([part.start, directions]), unknown=len(places))


def whitened(
    parts: list[Linearised], whitening: list[Whitening], reference: Array | None = None
) -> Linearised:
    """All segments together, in units of their noise, without the part due to unknown initial states.

    `reference` (m,) is the whitened residual of a model that this one is compared with. The part removed by
    unknown initial states is taken from there, so that they bring no advantage.
    """
    lengths = np.cumsum([len(part.r) for part in parts])[:-1]
    others = [None] * len(parts) if reference is None else np.split(reference, lengths)
    tables = [_without_start(*triple) for triple in zip(parts, whitening, others, strict=True)]
    table = np.vstack(tables)
    return Linearised(table[:, 0], table[:, 1:], np.zeros((len(table), 0)))


def _without_start(part: Linearised, whitening: Whitening, reference: Array | None) -> Array:
    """Project out the directions of the first states: the rest of the residual does not depend on them."""
    table = whitening(np.column_stack([part.r, part.J, part.start]))
    if part.known is not None:
        # Whitened rows depend on none that come later. The known ones represent the lost ones as well.
        table[part.known :] = 0.0
        table *= np.sqrt(len(table) / part.known)
    last = 1 + part.J.shape[1]
    kept, start = table[:, :last], table[:, last:]
    size = np.linalg.norm(start, axis=0)
    # The influence of a distant start has decayed, and would underflow in the product below.
    present = size > SETTINGS.decayed * max(size[: len(size) - part.unknown].max(initial=0.0), 1.0)
    if not present.any():
        return kept
    if reference is None:
        # The known rows represent the rest: else, the more is unknown, the better a model would look.
        kept = kept * np.sqrt(len(kept) / (len(kept) - part.unknown))
    start = start[:, present] / size[present]
    moved = kept.copy()
    if reference is not None:
        moved[:, 0] -= reference
    return np.asarray(kept - start @ (np.linalg.pinv(start.T @ start, hermitian=True) @ (start.T @ moved)))


def without_spikes(data: WeakData) -> WeakData:
    """The same data with spikes replaced by the cubic through their neighbours, and down-weighted.

    Angles and velocities that were derived from others are left alone.
    """
    return replace(data, segments=tuple(_despiked(s, data.sigma, data.derived) for s in data.segments))


def _despiked(segment: Segment, sigma: Array, derived: Sequence[int]) -> Segment:
    measured, downweighted = segment.measured.copy(), np.zeros(segment.measured.shape, dtype=bool)
    for k in range(measured.shape[1]):
        own = segment.reports(k)
        if not (sigma[k] > 0 and k not in derived and len(own) > SETTINGS.reports * SETTINGS.neighbours):
            continue
        measured[own, k], downweighted[own, k] = despiked(segment.t[own], measured[own, k], float(sigma[k]))
        if downweighted[:, k].any() and len(own) < len(segment.t):
            along = between(segment.t, segment.t[own], measured[own, k])
            spiked = np.interp(segment.t, segment.t[own], downweighted[own, k].astype(float))
            measured[:, k] = np.where(np.isnan(along), measured[:, k], along)
            downweighted[:, k] = spiked > 0.0
    return replace(segment, measured=measured, downweighted=downweighted) if downweighted.any() else segment


def despiked(t: Array, y: Array, sigma: float) -> tuple[Array, Flags]:
    """A signal with noise `sigma`, its spikes replaced by interpolation; and where they were."""
    index, weight = _neighbours(t)
    spread = np.sqrt(1.0 + np.sum(weight**2, axis=1))
    clean, spike = y.copy(), np.zeros(len(y), dtype=bool)
    for _ in range(SETTINGS.spike_rounds):
        guess = np.sum(weight * clean[index], axis=1)
        bend = SETTINGS.bend * np.median(np.abs(np.diff(clean[index], axis=1)), axis=1)
        distance = np.where(spike, 0.0, np.abs(clean - guess) / (spread * sigma + bend))
        # A spike makes its neighbours look odd as well: the worst of each neighbourhood goes first.
        worst = (distance > SETTINGS.spike) & (distance >= np.max(distance[index], axis=1))
        clean[spike | worst] = guess[spike | worst]
        if not worst.any():
            break
        spike |= worst
    return clean, spike


def _neighbours(t: Array) -> tuple[Index, Array]:
    """The samples beside each one without itself, and the weights of the cubic through them there."""
    count, width = len(t), 2 * SETTINGS.neighbours + 1
    first = np.clip(np.arange(count) - SETTINGS.neighbours, 0, count - width)
    whole = first[:, None] + np.arange(width)
    index = whole[whole != np.arange(count)[:, None]].reshape(count, width - 1)
    return index, lagrange(t[index], t)
