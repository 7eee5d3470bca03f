"""How much of the residual of a model could be predicted at all: a flexible function of the logged signals.

False alarms on simulated vehicles, three training runs of a minute and one for validation: in 0 of
48 motions where nothing is missing, in 1 of 60 with gusts. Of a missing current, 93% of the excess over
noise (median) was predicted, of a missing lift 60%, and on 2 of 8 ships nothing significant: a lower bound.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import nnls
from scipy.stats import t as student
from threadpoolctl import threadpool_limits

from undertow.identification.estimation.data import Segment, WeakData, measured_pose
from undertow.identification.estimation.fitted import Fitted
from undertow.identification.estimation.inputs import without_gaps
from undertow.identification.estimation.step import search_prior
from undertow.identification.logs.run import ACCELERATION
from undertow.model.symbols import FORCE_UNITS, POSE
from undertow.typing import Array, Flags, Index

from .associations import WAVE, Clock, Column, Trajectory, command_of, terms_of, without_bars
from .force_rows import SETTINGS as FORCE
from .force_rows import ForceRow, ForceRows, sliding_sums, weak_integrals
from .result import Predictability


@dataclass(frozen=True)
class PredictabilitySettings:
    """Settings of the estimate, chosen on simulated vehicles for computing time and false alarms."""

    detectable_ratio: float = 2.0  # mean square over that of noise from which no longer means are needed
    # Time constants of the lags by which commands are filtered as well, in distances of test functions. Past
    # velocities together with present ones would give the acceleration, and so any disturbance.
    lags: tuple[float, ...] = (1.0, 4.0, 16.0)
    folds: int = 5  # segments of the training data, each of which is predicted from the others
    # Weights of the squared coefficients of standardised columns, per row of data.
    penalties: tuple[float, ...] = tuple(np.logspace(-4, 3, 11))
    bins: int = 63  # that a signal is divided into for the trees
    # Boosting: trees, their leaves, the fewest rows in a leaf, and the share of each tree that is added.
    trees: int = 60
    leaves: int = 6
    fewest_in_leaf: int = 20
    learning_rate: float = 0.1
    most_rows: int = 5000  # largest number of rows for training; longer logs are decimated
    level: float = 0.95  # of the intervals
    least_share: float = 0.05  # predicted share from which the prediction is reported
    least_lost: float = 0.01  # share of the mean square lost without a signal from which it is named
    # Spread of a signal over its largest value up to which it is constant.
    constant: float = 1e-6
    rank_tolerance: float = 1e-9  # singular values, relative, below which parameters count as undetermined
    # End of the interval up to which nothing is missing that the signals could show: without that share of
    # the mean square the error would be a tenth less, which is the gain required of an effect.
    largest_undetected: float = 0.19


SETTINGS = PredictabilitySettings()
_Fold = tuple[Flags, Index]  # rows to learn from, and those that are held out
_LAGGED = re.compile(r" filtered over .* s$")


def variable_of(factor: str) -> str:
    """The logged signal in a factor: ``psi`` of ``sin(2 psi)``, ``port`` of ``|command port|``."""
    wave = WAVE.fullmatch(factor)
    return wave[3] if wave else command_of(factor) or _LAGGED.sub("", without_bars(factor))


def predictable(
    fit: Fitted, train: WeakData, test: WeakData, variables: Sequence[str] | None = None
) -> list[Predictability]:
    """How much of the residual force of every degree of freedom depends on the logged signals.

    Ridge regressions on the signals and their products, and boosted trees on their residual, as far as they
    predict held-out segments of the training data; scored on the validation data. The part that other values
    of the model parameters would predict as well does not count.

    Parameters
    ----------
    fit : Fitted
        The model.
    train, test : WeakData
        Training and validation data.
    variables : sequence of str, optional
        Signals that may be used: velocities, pose, commands, further channels; by default all except position
        and time, on which a hydrodynamic force does not depend.

    Returns
    -------
    list of Predictability
        In the order of the vehicle's degrees of freedom.
    """
    with _one_thread():
        forces, change = _forces(fit, train, test, variables)
        return [force.result(change) for force in forces]


def _forces(
    fit: Fitted, train: WeakData, test: WeakData, variables: Sequence[str] | None
) -> tuple[list[_Force], Array]:
    """The residual force of every degree of freedom, and the best common change of the parameters."""
    logs = _logs(fit, train, test)
    signals = _Signals.common(logs, variables)
    forces = [_Force(logs, signals, i) for i in range(len(logs[0].vehicle.dof_indices))]
    return forces, _parameter_change(fit, [force.training for force in forces])


def is_disturbance(found: Sequence[Predictability], noise_only: Container[str]) -> bool:
    """Whether the signals predict nothing, and these logs are long enough to say so.

    noise_only: degrees of freedom whose residual is sensor noise: nothing can be hidden there.
    """
    hidden = (p for p in found if p.interval[1] > SETTINGS.largest_undetected)
    return not any(p.significant for p in found) and all(p.degree_of_freedom in noise_only for p in hidden)


def share_of_predictable(
    base: Fitted, fit: Fitted, train: WeakData, test: WeakData, variables: Sequence[str]
) -> float:
    """Fraction explained by an effect of what a flexible function of some variables explains.

    One if the remaining residual does not depend on them; less if the effect makes a residual larger and no
    other one smaller. Degrees of freedom are weighted by how much the effect explains in them: other things
    missing elsewhere do not matter here.

    Parameters
    ----------
    base, fit : Fitted
        The model without the effect and with it.
    train, test : WeakData
        Training and validation data.
    variables : sequence of str
        Variables of the effect.
    """
    with _one_thread():
        forces, change = _forces(fit, train, test, variables)
        without = ForceRows(base, test)
        before = np.array([force.mean_square_of(without) for force in forces])
        after = np.array([force.validation.mean_square for force in forces])
        lost = np.array([force.share(change).interval[0] for force in forces]) * after
    gained = np.maximum(before - after, 0.0)
    if not gained.any():
        return 0.0 if lost.any() else float(np.min(before / np.maximum(after, 1e-300)))
    shares = gained / np.maximum(gained + lost, 1e-300)
    return float(np.average(shares, weights=gained / np.maximum(before, 1e-300)))


@contextmanager
def _one_thread() -> Iterator[None]:
    """Small trees lose more time waiting for other threads than they gain."""
    import sklearn.ensemble  # noqa: F401  takes long to import, and brings the threads that are limited

    with threadpool_limits(1):
        yield


@dataclass(frozen=True)
class _Signals:
    """Columns to learn from, and subsets of them; the first are the individual signals."""

    columns: list[Column]
    subsets: tuple[Index, ...]

    @classmethod
    def common(cls, logs: Sequence[_Log], variables: Sequence[str] | None) -> _Signals:
        """Columns of what all logs have."""
        further = [n for n in logs[0].further if all(n in log.further for log in logs)]
        pose = measured_pose(logs[1].vehicle, logs[1].rows.data.runs)
        terms = [c for t in terms_of(logs[0].vehicle, pose) for c in t.columns if c and "t" not in c]
        lagged = [_lagged(n, log) for n in logs[0].rows.data.commands for log in logs[0].lags]
        through_water = [
            (f"{wave}({angle})", factor)
            for wave, angle in product(("sin", "cos"), ("psi",) if "psi" in pose else ())
            for name in logs[0].vehicle.velocity_names
            for factor in (name, f"|{name}|")
        ]
        columns = [*terms, *through_water, *_angles(further), *((n,) for n in (*further, *lagged))]
        allowed = set(variables) if variables is not None else None
        kept = [c for c in dict.fromkeys(columns) if _uses(c, allowed)]
        smaller = {*kept} - {*through_water}
        subsets = ([_is_single(c) for c in kept], [c in smaller for c in kept], [True] * len(kept))
        return cls(kept, tuple(np.flatnonzero(c) for c in subsets))


def _angles(names: Sequence[str]) -> list[Column]:
    return [(f"{f}({n})",) for n in names if n in POSE[3:] for f in ("sin", "cos")]


def _uses(column: Column, allowed: set[str] | None) -> bool:
    used = {variable_of(f) for f in column}
    return not used & {"x", "y"} if allowed is None else used <= allowed


def _is_single(column: Column) -> bool:
    return len(column) == 1 and not column[0].startswith("|")


def _lagged(name: str, seconds: float) -> str:
    return f"{name} filtered over {seconds:.3g} s"


class _Log:
    """Force equations along logs with the signals that they may depend on."""

    def __init__(self, fit: Fitted, data: WeakData) -> None:
        self.rows = ForceRows(fit, data)
        self.vehicle = fit.model.functions.vehicle
        self.clock = Clock.of(data)
        self.lags = [lag * self.clock.step for lag in SETTINGS.lags]
        self._tables: dict[int, list[Array]] = {}

    @property
    def further(self) -> list[str]:
        """Logged channels that are not part of the model."""
        data = self.rows.data
        known = {*data.names, *data.commands, *ACCELERATION}
        first, *others = data.runs
        return [n for n in first.channels if n not in known and all(r.has(n) for r in others)]

    def table(self, signals: _Signals, width: int) -> list[Array]:
        """Columns averaged like the forces, (K - width + 1, q) in every segment."""
        if width not in self._tables:
            self._tables[width] = [
                (
                    sliding_sums(s.functions.count, width)
                    @ weak_integrals(s, self._with_lags(s, trajectory), signals.columns)
                )
                for s, trajectory, _ in self.rows.trajectories
            ]
        return self._tables[width]

    def _with_lags(self, s: Segment, trajectory: Trajectory) -> Trajectory:
        """The signals with the further ones, and with the lagged commands."""
        run = self.rows.data.runs[s.run]
        values = trajectory.values | {n: without_gaps(run.matrix([n]))[s.samples, 0] for n in self.further}
        step = float(np.median(np.diff(s.t)))
        for name, command in trajectory.commands.items():
            values |= {_lagged(name, lag): _filtered(command, step / lag) for lag in self.lags}
        return Trajectory(values, trajectory.commands)


def _logs(fit: Fitted, train: WeakData, test: WeakData) -> list[_Log]:
    """Training and validation data, with the same lags whatever their sampling."""
    training, validation = (_Log(fit, data) for data in (train, test))
    validation.lags = training.lags
    return [training, validation]


def _filtered(signal: Array, rate: float) -> Array:
    """A signal after a lag, `rate` being the step over the time constant."""
    from scipy.signal import lfilter  # slow to import, and not needed to compare

    keep = float(np.exp(-rate))
    return np.asarray(lfilter([1 - keep], [1, -keep], signal, zi=[keep * signal[0]])[0])


@dataclass(frozen=True)
class _Table:
    """A residual force with the signals it may depend on."""

    force: Array  # (K,) N or N m
    noise: float  # mean square that the sensors give to it
    inertia: Array  # (K,) mass times acceleration
    signals: Array  # (K, q)
    J: Array  # (K, n_free) derivative in the parameters of the model
    row: Index  # (K,) place of the middle among the rows of the data

    @property
    def mean_square(self) -> float:
        return float(np.mean(self.force**2)) if len(self.force) else 0.0


class _Share(NamedTuple):
    """Share of the mean square of a force that can be predicted."""

    share: float
    interval: tuple[float, float]
    left: float  # mean square that is left at best


class _Force:
    """The residual force of one degree of freedom, and its predictors."""

    def __init__(self, logs: Sequence[_Log], signals: _Signals, dof: int) -> None:
        self._logs, self._signals, self._dof = logs, signals, dof
        self._rows = [log.rows.row(dof) for log in logs]
        self._width = self._averaging_width()

    def _averaging_width(self) -> int:
        """Number of test functions to average over: from there on the force exceeds the noise.

        In short logs it is the longest that training and validation data have room for.
        """
        room = min(max(len(part.r) for part in row.parts) for row in self._rows)
        for width in (w for w in FORCE.widths if w <= max(room, 1)):
            force, variance = (np.concatenate(c) for c in zip(*self._rows[0].averaged(width), strict=True))
            if np.mean(force**2) > SETTINGS.detectable_ratio * np.mean(variance):
                break
        return width

    def _table(self, log: _Log, row: ForceRow) -> _Table:
        width, weight = self._width, row.weight * self._width
        parts, first = [], 0
        tables = (
            log.rows.trajectories,
            row.parts,
            row.averaged(width),
            log.table(self._signals, width),
            log.rows.mass,
        )
        for (s, _, _), part, (force, noise), signals, mass in zip(*tables, strict=True):
            groups = sliding_sums(len(mass), width) / weight
            moved = np.sum(mass[:, self._dof] * -(s.functions.rate @ s.measured[:, mass.shape[1] :]), axis=1)
            place = first + width // 2 + np.arange(len(force))
            parts.append((-force, noise, groups @ moved, signals / weight, -(groups @ part.J), place))
            first += len(mass)
        force, noise, inertia, signals, J, place = (np.concatenate(c) for c in zip(*parts, strict=True))
        return _Table(force, float(np.mean(noise)), inertia, signals, J, place)

    def mean_square_of(self, rows: ForceRows) -> float:
        """Mean square of another model's residual, averaged over the same time as this one's."""
        parts = [force for force, _ in rows.row(self._dof).averaged(self._width)]
        return float(np.mean(np.concatenate(parts) ** 2))

    @cached_property
    def training(self) -> _Table:
        """The residual force on the training data."""
        return self._table(self._logs[0], self._rows[0])

    @cached_property
    def validation(self) -> _Table:
        """The residual force on the validation data."""
        return self._table(self._logs[1], self._rows[1])

    @cached_property
    def _predict(self) -> Callable[[Array], Array]:
        learner = Learner(self._signals.subsets, self._width)
        return learner.fit(self.training)

    def share(self, change: Array) -> _Share:
        """Share that can be predicted in addition to a change (n_free,) of the parameters."""
        validation = self.validation
        refitted = validation.force - validation.J @ change
        before = min(validation.force, refitted, key=lambda force: float(np.sum(force**2)))
        return self._share(before, validation.force - self._predict(validation.signals))

    def result(self, change: Array) -> Predictability:
        """What can be predicted on the validation data, in addition to a change (n_free,) of parameters."""
        validation, (share, interval, left) = self.validation, self.share(change)
        mean_square = max(validation.mean_square, 1e-300)
        vehicle = self._logs[0].vehicle
        significant = interval[0] > 0.0 and share > SETTINGS.least_share
        reached = max(interval[1], detectable_share(self._training_blocks))
        return Predictability(
            degree_of_freedom=vehicle.degrees_of_freedom[self._dof],
            unit=FORCE_UNITS[vehicle.dof_indices[self._dof]],
            averaged_over=self._width * self._logs[1].clock.step,
            residual_rms=float(np.sqrt(validation.mean_square)),
            share=share,
            interval=(interval[0], reached),
            significant=significant,
            noise_share=min(validation.noise / mean_square, 1.0),
            disturbance_rms=float(np.sqrt(max(left - validation.noise, 0.0))),
            relative_to_inertia=mean_square / max(float(np.mean(validation.inertia**2)), 1e-300),
            variables=self._variable_importance() if significant else {},
        )

    def _share(self, before: Array, after: Array) -> _Share:
        """Share of the mean square that is predicted, with its interval from independent blocks.

        A single block says nothing about it.
        """
        validation, number = self.validation, _blocks(self.validation, self._logs[1])
        whole, fall = (np.bincount(number, a) for a in (validation.force**2, before**2 - after**2))
        total, others = max(float(np.sum(whole)), 1e-300), max(len(whole) - 1, 1)
        share = float(np.sum(fall)) / total
        error = float(np.sqrt(len(whole) / others * np.sum((fall - share * whole) ** 2))) / total
        reach = float(student.ppf(0.5 + SETTINGS.level / 2, others)) * error if len(whole) > 1 else 1.0
        low, middle, high = np.clip([share - reach, share, share + reach], 0.0, 1.0).tolist()
        left = min(float(np.mean(before**2)), float(np.mean(after**2)))
        return _Share(middle, (low, high), left)

    @property
    def _training_blocks(self) -> int:
        return 1 + int(_blocks(self.training, self._logs[0]).max(initial=-1))

    def _variable_importance(self) -> dict[str, float]:
        """Permutation importance: share of the mean square that is lost if a signal is permuted in time."""
        validation, predict = self.validation, self._predict
        permuted = np.random.default_rng(0).permutation(len(validation.force))
        without = np.mean((validation.force - predict(validation.signals)) ** 2)
        used = [{variable_of(f) for f in c} for c in self._signals.columns]
        found = {}
        for name in sorted(set().union(*used)):
            signals = validation.signals.copy()
            chosen = np.array([name in names for names in used])
            signals[:, chosen] = signals[permuted][:, chosen]
            lost = np.mean((validation.force - predict(signals)) ** 2) - without
            found[name] = float(lost / validation.mean_square)
        ordered = sorted(found.items(), key=lambda item: -item[1])
        return {name: lost for name, lost in ordered if lost > SETTINGS.least_lost}


def _blocks(table: _Table, log: _Log) -> Index:
    """Number of the independent block of time of every row."""
    block = log.clock.blocks(log.rows.data.uncorrelated_seconds(table.force))[table.row]
    return np.asarray(np.unique(block, return_inverse=True)[1])


def detectable_share(blocks: int) -> float:
    """Least share of a force that a signal has to explain for its correlation to be significant.

    It is one with fewer than three independent blocks of training data. A regression that finds nothing in
    few of them does not show that there is nothing to find.
    """
    if blocks < 3:
        return 1.0
    square = float(student.ppf(0.5 + SETTINGS.level / 2, blocks - 2)) ** 2
    return square / (square + blocks - 2)


def _parameter_change(fit: Fitted, tables: Sequence[_Table]) -> Array:
    """Change of the model's parameters, (n_free,), that fits the training data best in all equations.

    Each is weighted by its residual, so that none is ignored; priors apply.
    """
    centre, weight = search_prior(fit.model)
    scale = [1.0 / max(np.sqrt(table.mean_square), 1e-300) for table in tables]
    rows = [table.J * s for table, s in zip(tables, scale, strict=True)]
    wanted = [table.force * s for table, s in zip(tables, scale, strict=True)]
    stacked = np.vstack([*rows, np.diag(weight)])
    size = np.maximum(np.linalg.norm(stacked, axis=0), 1e-300)
    right = np.concatenate([*wanted, weight * (centre - fit.p[list(fit.model.places)])])
    return np.asarray(np.linalg.lstsq(stacked / size, right, rcond=SETTINGS.rank_tolerance)[0] / size)


class Learner:
    """Ridge regressions, and boosted trees on their residual, as far as they predict held-out segments.

    The regressions on few columns and on many are combined with the non-negative weights that predict the
    held-out segments best (stacking; Breiman, Machine Learning 24, 1996, 49-64).
    """

    def __init__(self, subsets: Sequence[Index], width: int) -> None:
        self._choices, self._gap = subsets, width + 3
        self._single = subsets[0]

    def fit(self, table: _Table) -> Callable[[Array], Array]:
        """Function from signals (K, q) to the force (K,)."""
        step = -(-len(table.force) // SETTINGS.most_rows)
        y, X = table.force[::step], table.signals[::step]
        if len(y) < 2 * SETTINGS.folds * SETTINGS.fewest_in_leaf or not X.shape[1]:
            mean = float(np.mean(y)) if len(y) else 0.0
            return lambda signals: np.full(len(signals), mean)
        folds = [*self._folds(len(y), -(-self._gap // step))]
        found = [self._ridge(X[:, columns], y, folds) for columns in self._choices]
        # For every held-out segment, predictions of all rows by the regressions fitted without it.
        predictions = np.array([each for _, each in found])
        held_out = np.column_stack([predictions[:, i, out] for i, (_, out) in enumerate(folds)]).T
        weights = nnls(held_out, y)[0]
        trees = self._trees(X, y - np.tensordot(weights, predictions, 1), folds)
        regressions = [(w, ridge, c) for w, (ridge, _), c in zip(weights, found, self._choices, strict=True)]

        def combined(signals: Array) -> Array:
            return np.asarray(sum(w * ridge(signals[:, c]) for w, ridge, c in regressions))

        if not trees:
            return combined
        boosted = self._boosted(X[:, self._single], y - combined(X), trees)
        return lambda signals: combined(signals) + boosted.predict(signals[:, self._single])

    def _ridge(self, X: Array, y: Array, folds: Sequence[_Fold]) -> tuple[Callable[[Array], Array], Array]:
        """Ridge regression with the best penalty, and its out-of-fold predictions of all rows."""
        without = [Ridge(X[kept], y[kept]) for kept, _ in folds]

        def held_out_error(penalty: float) -> float:
            """Sum of squared out-of-fold residuals with this penalty."""
            pairs = zip(without, folds, strict=True)
            return sum(float(np.sum((y[out] - r.predict(X[out], penalty)) ** 2)) for r, (_, out) in pairs)

        penalty = min(SETTINGS.penalties, key=held_out_error)
        whole = Ridge(X, y)
        return lambda table: whole.predict(table, penalty), np.array([r.predict(X, penalty) for r in without])

    def _trees(self, X: Array, residuals: Array, folds: Sequence[_Fold]) -> int:
        """Trees that predict held-out segments best, or none.

        `residuals` (folds, K) are those of the regressions fitted without the fold.
        """
        errors = np.zeros(SETTINGS.trees + 1)
        for y, (kept, out) in zip(residuals, folds, strict=True):
            boosted = self._boosted(X[kept][:, self._single], y[kept], SETTINGS.trees)
            stages = np.array([*boosted.staged_predict(X[out][:, self._single])])
            errors[0] += np.sum(y[out] ** 2)
            errors[1:] += np.sum((y[out] - stages) ** 2, axis=1)
        return int(np.argmin(errors))

    def _boosted(self, X: Array, y: Array, trees: int) -> Any:
        from sklearn.ensemble import HistGradientBoostingRegressor

        s = SETTINGS
        return HistGradientBoostingRegressor(
            max_iter=trees,
            learning_rate=s.learning_rate,
            max_leaf_nodes=s.leaves,
            min_samples_leaf=s.fewest_in_leaf,
            max_bins=s.bins,
            early_stopping=False,
        ).fit(X, y)

    def _folds(self, count: int, gap: int) -> Iterator[_Fold]:
        """Rows to learn from and segment to be predicted, which no average overlaps."""
        edges = np.linspace(0, count, SETTINGS.folds + 1).astype(int)
        place = np.arange(count)
        for low, high in pairwise(edges.tolist()):
            yield (place < low - gap) | (place >= high + gap), place[low:high]


class Ridge:
    """Ridge regression on standardised columns, for any penalty."""

    def __init__(self, X: Array, y: Array) -> None:
        self._middle, spread = X.mean(axis=0), X.std(axis=0)
        size = np.maximum(np.abs(X).max(axis=0, initial=0.0), 1e-300)
        self._scale = np.where(spread > SETTINGS.constant * size, 1.0 / np.maximum(spread, 1e-300), 0.0)
        self._mean = float(np.mean(y))
        Z = (X - self._middle) * self._scale
        self._value, self._vector = np.linalg.eigh(Z.T @ Z / len(y))
        self._product = self._vector.T @ (Z.T @ (y - self._mean)) / len(y)

    def predict(self, X: Array, penalty: float) -> Array:
        """Prediction (K,) with a penalty on the squared coefficients."""
        coefficients = self._vector @ (self._product / (np.maximum(self._value, 0.0) + penalty))
        return np.asarray(self._mean + ((X - self._middle) * self._scale) @ coefficients)
