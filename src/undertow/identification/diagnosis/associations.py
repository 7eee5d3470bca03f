"""What a residual force correlates with: variables, a period, time, the run. Associations, not causes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, permutations
from typing import NamedTuple

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as f_ratio

from undertow.identification.estimation.data import WeakData, blocks_of_time, inverse_of
from undertow.identification.estimation.prediction_error import AutoregressiveNoise
from undertow.identification.logs.run import UNITS
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Index

Column = tuple[str, ...]
_COMMAND = "command "
_ANGLES = ("psi", "phi", "theta")
WAVE = re.compile(r"(sin|cos)\((2 )?(psi|phi|theta)\)")
STEP = re.compile(r"step\(t - (-?\d+(?:\.\d+)?)\)")


@dataclass(frozen=True)
class AssociationSettings:
    """Settings of the search for terms that a residual force correlates with."""

    step_times: int = 24  # times at which a step is tried, evenly over the logs: within 2% of their length
    patterns: int = 1999  # sign patterns for the chance of the best term: shows 0.05%
    independent_share: float = 1e-4  # least share of a column that is linearly independent of the model
    alike_share: float = 0.9  # share of the fall by the best term from which another is named with it
    step_width: float = 0.125  # how long a step takes in a fit, as a share of the time between two of them
    fewest_blocks: int = 4  # blocks of a run that is compared with others
    # Share of the information on the best determined coefficient below which one counts as undetermined.
    rank_tolerance: float = 1e-9
    oversampling: int = 8  # frequencies tried per one that the longest run resolves
    fewest_periods: float = 3.0  # periods in the shortest run above which a frequency is not a trend
    band: float = 0.1  # half width of a line, as a share of its frequency
    least_band: float = 1.5  # and at least, in frequencies that the log resolves
    confirmed: float = 0.05  # p-value on validation data alone from which these do not show a frequency
    neighbours: float = 2.0  # factor in frequency within which the power of noise is much the same
    draws: float = 3.0  # independent powers within the width of a line, about


SETTINGS = AssociationSettings()


@dataclass(frozen=True)
class Term:
    """Columns that are tested together.

    label: what the term is called.
    columns: factors of each column.
    """

    label: str
    columns: tuple[Column, ...]

    @property
    def is_step(self) -> bool:
        """Whether it is a step in time, to which those at neighbouring times are alike."""
        return step_time(self.columns[0]) is not None

    def is_part_of(self, other: Term) -> bool:
        """Whether it has some of the columns of another term, and no others."""
        return {*self.columns} < {*other.columns}


def terms_of(vehicle: Vehicle, pose: tuple[str, ...]) -> list[Term]:
    """All terms made of the motions, the measured pose and the commands of a vehicle."""
    velocities, commands = vehicle.velocity_names, [_COMMAND + n for n in vehicle.command_names]
    columns: list[Column] = [(), ("t",)]
    for a in velocities:
        columns += [(a,), (f"|{a}|", a), (a, a), ("t", a), ("t", f"|{a}|", a)]
    columns += combinations(velocities, 2)
    columns += [(f"|{a}|", b) for a, b in permutations(velocities, 2)]
    columns += _command_columns(commands, velocities)
    columns += [(n,) for n in pose if n in ("x", "y", "z")] + [
        (f"sin({n})",) for n in pose if n in _ANGLES[1:]
    ]
    turns = [_sin_and_cos("psi"), _sin_and_cos("2 psi")] if "psi" in pose else []
    if {"psi", "z"} <= set(pose):
        turns.append(_sin_and_cos("psi", "z"))
    jointly = _times_each_command([c for c in commands if command_of(c) not in vehicle.inputs], velocities)
    return [*(Term(label_of(c), (c,)) for c in columns), *jointly, *turns]


def _times_each_command(commands: list[str], velocities: tuple[str, ...]) -> Iterator[Term]:
    """Each command times a velocity, all together: a law that all actuators obey is no single one's."""
    if len(commands) > 1:
        for a in velocities:
            yield Term(f"{a} times each command", tuple((c, a) for c in commands))
            yield Term(f"{a} times each |command|", tuple((f"|{c}|", a) for c in commands))


def _command_columns(commands: list[str], velocities: tuple[str, ...]) -> Iterator[Column]:
    for c in commands:
        yield from ((c,), (f"|{c}|", c), (c, c), ("t", c), ("t", f"|{c}|", c))
        yield from ((c, a) for a in velocities)
        yield from ((f"|{c}|", a) for a in velocities)
    for c, d in combinations(commands, 2):
        yield from ((c, d), (f"|{c}|", f"|{d}|"))


def step_terms(t: Array) -> list[Term]:
    """Steps, at times that all runs have in common, evenly over the times t (K,) of the logs, s."""
    times = np.linspace(t.min(), t.max(), SETTINGS.step_times + 2)[1:-1]
    decimals = max(0, int(np.ceil(1.0 - np.log10(times[1] - times[0]))))
    # A step at zero would have no time that it could be a share of (see the effect that is made of it).
    names = [f"{time:.{decimals}f}" for time in times if abs(time) > 10.0**-decimals]
    columns = [(f"step(t - {name})",) for name in names]
    return [Term(label_of(c), (c,)) for c in columns]


def onset_terms(column: Sequence[str], steps: Sequence[Term]) -> list[Term]:
    """Terms that grow with time (``t |u| u``), replaced by ones that set in at each of the steps."""
    rest = tuple(f for f in column if f != "t")
    columns = [(*step.columns[0], *rest) for step in steps] if rest and "t" in column else []
    return [Term(label_of(c), (c,)) for c in columns]


def _sin_and_cos(angle: str, *factors: str) -> Term:
    both = tuple((*factors, f"{f}({angle})") for f in ("sin", "cos"))
    return Term(" ".join([*factors, f"sin and cos of {angle}"]), both)


def step_time(column: Sequence[str]) -> str | None:
    """Time of a step column, s, as written in it; None for all others."""
    step = STEP.fullmatch(column[0]) if column else None
    return None if step is None else step[1]


def label_of(column: Column) -> str:
    """A column in readable form: ``|r| u``, ``u^2``, ``a step at 35 s``, ``|u| u from 35 s on``."""
    if (time := step_time(column)) is not None:
        return f"{label_of(column[1:])} from {time} s on" if column[1:] else f"a step at {time} s"
    factors = Counter(f.replace(_COMMAND, "") for f in column)
    return " ".join(f if times == 1 else f"{f}^{times}" for f, times in factors.items()) or "a constant"


def without_bars(factor: str) -> str:
    """A factor without magnitude bars: ``|r|`` gives ``r``."""
    return factor[1:-1] if factor.startswith("|") and factor.endswith("|") else factor


def command_of(factor: str) -> str | None:
    """Name of the command in a factor, or None if there is none."""
    plain = without_bars(factor)
    return plain.removeprefix(_COMMAND) if plain.startswith(_COMMAND) else None


def unit_of(factor: str) -> str:
    """SI unit of a factor; that of a thruster's command is ``command``."""
    name = command_of(factor)
    if name is not None:
        return UNITS.get(name, "command")
    if WAVE.fullmatch(factor) or STEP.fullmatch(factor):
        return "1"
    plain = without_bars(factor)
    return "s" if factor == "t" else {**UNITS, "t": ""}[plain]


def coefficient_unit(force: str, column: Column) -> str:
    """Unit of the coefficient of a column that gives a force in `force`: ``N/((m/s)^2 s)``."""
    count = Counter(u for u in map(unit_of, column) if u != "1")
    below = " ".join(_power(f"({u})" if "/" in u or " " in u else u, n) for u, n in count.items())
    return f"{force}/({below})" if len(count) > 1 else f"{force}/{below}" if count else force


def _power(unit: str, exponent: int) -> str:
    return unit if exponent == 1 else f"{unit}^{exponent}"


@dataclass(frozen=True)
class Trajectory:
    """Motion and commands at N samples, from which columns are computed.

    values: (N,), velocities through the water, pose and time.
    commands: (N,), command that reaches each thruster, and known forces; held between samples.
    """

    values: dict[str, Array]
    commands: dict[str, Array]

    def motion_product(self, column: Column) -> Array:
        """Product of the factors that are no commands, shape (N,)."""
        factors = [self._value(f) for f in column if command_of(f) is None]
        return np.prod([np.ones_like(self.values["t"]), *factors], axis=0)

    def command_product(self, column: Column) -> Array | None:
        """Product of the factors that are commands, shape (N,); None where there is none."""
        names = [(f, command_of(f)) for f in column]
        found = [
            np.abs(self.commands[n]) if f[0] == "|" else self.commands[n] for f, n in names if n is not None
        ]
        return np.prod(found, axis=0) if found else None

    def _value(self, factor: str) -> Array:
        wave = WAVE.fullmatch(factor)
        if wave:
            angle = (2 if wave[2] else 1) * self.values[wave[3]]
            return np.asarray(np.sin(angle) if wave[1] == "sin" else np.cos(angle))
        if step := STEP.fullmatch(factor):
            return np.asarray(self.values["t"] >= float(step[1]), dtype=float)
        value = self.values[without_bars(factor)]
        return np.abs(value) if factor.startswith("|") else value


def is_factor(text: str) -> bool:
    """Whether a text is a factor."""
    if WAVE.fullmatch(text) or STEP.fullmatch(text) or text in ("t", *POSE[:3]):
        return True
    return without_bars(text) in VELOCITY or command_of(text) is not None


@dataclass(frozen=True)
class Sample:
    """A residual in units of its noise.

    r: (m,), residual.
    J: (m, k), its derivative with respect to the model's free parameters.
    columns: (m, q), its derivative with respect to the coefficients of all terms.
    block: (m,), block of time of each entry.
    """

    r: Array
    J: Array
    columns: Array
    block: Index

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.block.max(initial=-1)) + 1

    @property
    def square(self) -> float:
        """Sum of squares."""
        return float(np.sum(self.r**2))

    def innovations(self, noise: AutoregressiveNoise, lengths: Sequence[int]) -> Sample:
        """One-step prediction errors of the entries under a noise model; `lengths` are those of segments."""
        table = np.column_stack([self.r, self.J, self.columns])
        pieces = np.split(table, np.cumsum(lengths)[:-1])
        errors = np.vstack([noise.innovations(piece) for piece in pieces])
        own = 1 + self.J.shape[1]
        return replace(self, r=errors[:, 0], J=errors[:, 1:own], columns=errors[:, own:])

    def by_block(self, products: Array) -> Array:
        """Sums over blocks, shape (blocks, ...)."""
        total = np.zeros((self.blocks, *products.shape[1:]))
        np.add.at(total, self.block, products)
        return total


class Samples(NamedTuple):
    """The same residual on three bases.

    fitted, validation: on the training and validation data, with the remainder counted as noise.
    under_sensor_noise: on validation data, in units of sensor noise alone.
    """

    fitted: Sample
    validation: Sample
    under_sensor_noise: Sample

    def mapped(self, change: Callable[[Sample], Sample]) -> Samples:
        """The same change of all three."""
        return Samples(*map(change, self))


@dataclass(frozen=True)
class AssociatedTerm:
    """A term with its evidence.

    term: the term.
    coefficients, errors: (k,), coefficient of each of its columns, and standard errors.
    fall: fall of the sum of squares on validation data.
    chance: fraction of sign patterns for which the best of all terms explains as much.
    alike: labels of terms that explain nearly as much.
    """

    term: Term
    coefficients: Array
    errors: Array
    fall: float
    chance: float
    alike: tuple[str, ...]


@dataclass(frozen=True)
class _TermProducts:
    """One term: products of its columns with the residual in each block, and with each other."""

    term: Term
    fitted: Array
    validation: Array
    inverse: Array
    gram: Array

    def fall(self, fitted: Array, validation: Array) -> Array:
        """Fall of the validation sum of squares for signs of the blocks, (patterns, blocks) each."""
        step = -(fitted @ self.fitted) @ self.inverse
        quadratic = np.einsum("si,ij,sj->s", step, self.gram, step)
        return np.asarray(-2 * np.einsum("si,si->s", step, validation @ self.validation) - quadratic)


@dataclass(frozen=True)
class Association:
    """A residual from which terms are removed one by one.

    terms: what it may correlate with; their columns stand side by side in the samples.
    samples: the residual.
    stiffness: (k, k), information on the free parameters of the model from elsewhere (other equations,
    priors).
    removed: labels of the terms removed.
    """

    terms: tuple[Term, ...]
    samples: Samples
    stiffness: Array
    removed: frozenset[str] = frozenset()

    def strongest(self) -> AssociatedTerm | None:
        """The term that removes most of the validation residual; None if none removes any."""
        products = self._products
        counts = self.samples.fitted.blocks, self.samples.validation.blocks
        falls = np.array([t.fall(*(np.ones((1, n)) for n in counts))[0] for t in products])
        if not np.any(falls > 0):
            return None
        rng = np.random.default_rng(0)
        signs = [rng.choice([-1.0, 1.0], size=(SETTINGS.patterns, n)) for n in counts]
        by_chance = np.max([t.fall(*signs) for t in products], axis=0)
        terms = [t.term for t in products]
        near = [i for i in np.argsort(-falls) if falls[i] > SETTINGS.alike_share * falls.max()]
        first = next((i for i in near if terms[i].is_part_of(terms[near[0]])), near[0])
        others = (terms[i] for i in near if i != first)
        alike = tuple(t.label for t in others if not (t.is_step and terms[first].is_step))
        chance = (1 + int(np.sum(by_chance >= falls[first]))) / (1 + SETTINGS.patterns)
        return self._found(products[first], float(falls[first]), chance, alike)

    def chance_in_autoregressive_noise(
        self, found: AssociatedTerm, lengths: Sequence[Sequence[int]]
    ) -> float:
        """P-value of a term under autoregressive noise, estimated from what remains without it.

        lengths: of the segments of each of the three samples. Where a strong term is removed, far less noise
        is left than was counted with: that holds for what the other equations say of the parameters, too.
        """
        rest = self.without(found).samples.fitted.r
        noise = AutoregressiveNoise.of(np.split(rest, np.cumsum(lengths[0])[:-1]))
        place = self.slices[found.term.label]
        samples = (
            replace(s, columns=s.columns[:, place]).innovations(noise, each)
            for s, each in zip(self.samples, lengths, strict=True)
        )
        stiffness = self.stiffness / max(noise.scale, 1e-12) ** 2
        alone = Association((found.term,), Samples(*samples), stiffness).strongest()
        return 1.0 if alone is None else alone.chance

    def excluding(self, found: AssociatedTerm) -> Association:
        """The same residual, of which a term, and those like it, are no longer thought to be a part."""
        return replace(self, removed=self.removed | {found.term.label, *found.alike})

    def without(self, found: AssociatedTerm) -> Association:
        """The residual without a term; its coefficients remain free."""
        place = self.slices[found.term.label]
        rest = self.samples.mapped(lambda s: self._without_term(s, place, found.coefficients))
        more = len(found.coefficients)
        stiffness = np.pad(self.stiffness, ((0, more), (0, more)))
        return replace(self, samples=rest, stiffness=stiffness, removed=self.removed | {found.term.label})

    def _without_term(self, s: Sample, place: slice, coefficients: Array) -> Sample:
        J = np.column_stack([s.J, s.columns[:, place]])
        return replace(s, r=s.r + self._orthogonal(s)[:, place] @ coefficients, J=J)

    def _orthogonal(self, sample: Sample) -> Array:
        """The columns less the part that the free parameters of the model take over."""
        return sample.columns - sample.J @ self._parameter_response

    @cached_property
    def _parameter_response(self) -> Array:
        return _response(self.samples.fitted, self.samples.fitted.columns, self.stiffness)

    @cached_property
    def slices(self) -> dict[str, slice]:
        """Column indices of each term."""
        slices, first = {}, 0
        for term in self.terms:
            slices[term.label] = slice(first, first := first + len(term.columns))
        return slices

    @cached_property
    def _products(self) -> list[_TermProducts]:
        fitted, validation = self.samples.fitted, self.samples.validation
        first, second = self._orthogonal(fitted), self._orthogonal(validation)
        gram, whole = first.T @ fitted.columns, np.sum(fitted.columns**2, axis=0)
        a, b = fitted.by_block(first * fitted.r[:, None]), validation.by_block(second * validation.r[:, None])
        independent = np.diag(gram) > SETTINGS.independent_share * whole
        return [
            _TermProducts(t, a[:, c], b[:, c], _inverse(gram[c, c]), second[:, c].T @ second[:, c])
            for t in self.terms
            for c in [self.slices[t.label]]
            if t.label not in self.removed and np.all(independent[c])
        ]

    def _found(self, t: _TermProducts, fall: float, chance: float, alike: tuple[str, ...]) -> AssociatedTerm:
        fitted = self.samples.fitted
        coefficients = -t.inverse @ t.fitted.sum(axis=0)
        column = self._orthogonal(fitted)[:, self.slices[t.term.label]]
        scores = fitted.by_block(column * (fitted.r + column @ coefficients)[:, None])
        spread = t.inverse @ (scores.T @ scores) @ t.inverse
        return AssociatedTerm(t.term, coefficients, np.sqrt(np.diag(spread)), fall, chance, alike)


def _inverse(gram: Array) -> Array:
    """Inverse of the products of columns; equal columns (two thrusters with one command) share what is found.

    A ridge would give them coefficients of any size that cancel.
    """
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(size, size)
    return np.asarray(
        np.linalg.pinv((scaled + scaled.T) / 2, rcond=SETTINGS.rank_tolerance, hermitian=True)
        / np.outer(size, size)
    )


def _response(sample: Sample, columns: Array, stiffness: Array) -> Array:
    """Change of the free parameters of the model that takes over most of columns (m, q), shape (k, q)."""
    return np.asarray(inverse_of(sample.J.T @ sample.J + stiffness) @ (sample.J.T @ columns))


@dataclass(frozen=True)
class Difference:
    """Coefficients of the same columns in every run that is long enough.

    runs: (g,), numbers of these runs.
    values: (g, k), the coefficients; those that a run does not determine are the values of all runs.
    chance: p-value of the differences if all runs are alike.
    """

    runs: Index
    values: Array
    chance: float


def difference(sample: Sample, columns: slice, stiffness: Array, run: Index) -> Difference | None:
    """Fit columns to a residual separately in every run that is long enough; None unless two are.

    The free parameters of the model are fitted at the same time: an error of a drag coefficient changes
    the mean force on a run at one speed.

    sample: the residual; `columns` are the place of its columns.
    stiffness: (k, k), information on the free parameters of the model from elsewhere.
    run: (m,), run of each entry.
    """
    enough = [len(np.unique(sample.block[run == i])) >= SETTINGS.fewest_blocks for i in np.unique(run)]
    runs = np.unique(run)[enough]
    if len(runs) < 2:
        return None
    each, size = sample.columns[:, columns], columns.stop - columns.start
    apart = np.column_stack([each * (run == i)[:, None] for i in runs])
    values, spread, weight = _coefficients(sample, apart, stiffness)
    same = np.tile(np.eye(size), (len(runs), 1))
    mean = inverse_of(same.T @ weight @ same) @ same.T @ weight @ values
    deviation = values - same @ mean
    distance, freedom = float(deviation @ weight @ deviation), (len(runs) - 1) * size
    between = _variance_between_runs(weight, max(distance - freedom, 0.0), size) * np.eye(size)
    slices = [slice(k * size, (k + 1) * size) for k in range(len(runs))]
    own = np.array([between @ inverse_of(between + spread[p, p]) @ deviation[p] for p in slices])
    return Difference(runs, mean + own, float(chi2.sf(distance, freedom)))


def _variance_between_runs(weight: Array, excess: float, size: int) -> float:
    """Variance between runs, as DerSimonian and Laird (1986) estimate it.

    A run on one heading carries no information on the force across it.
    """
    own = [weight[k : k + size, k : k + size] for k in range(0, len(weight), size)]
    total = np.sum(own, axis=0)
    scale = np.trace(total) - np.trace(inverse_of(total) @ np.sum([w @ w for w in own], axis=0))
    return excess / max(float(scale), 1e-300)


def _coefficients(sample: Sample, columns: Array, stiffness: Array) -> tuple[Array, Array, Array]:
    """Coefficients, fitted together with the model, covariance (at least that from noise) and its inverse.

    A combination of columns that the parameters of the model can reproduce gets the value zero.
    """
    orthogonal = columns - sample.J @ _response(sample, columns, stiffness)
    gram = orthogonal.T @ columns
    inverse = np.linalg.pinv((gram + gram.T) / 2, rcond=SETTINGS.rank_tolerance, hermitian=True)
    value = -inverse @ (orthogonal.T @ sample.r)
    summed = sample.by_block(orthogonal * (sample.r + orthogonal @ value)[:, None])
    nominal = np.diag(inverse)
    scattered = np.diag(inverse @ (summed.T @ summed) @ inverse) / np.where(nominal > 0.0, nominal, 1.0)
    inflation = np.sqrt(np.maximum(1.0, scattered))
    both = np.outer(inflation, inflation)
    return value, inverse * both, gram / both


# Median over mean of a power that is scattered like that of noise.
_MEDIAN_OVER_MEAN = float(np.log(2.0))
# Variance of that median, as a multiple of that of the mean: relative to each, and for many values.
_MEDIAN_VARIANCE = float(np.log(2.0)) ** -2


@dataclass(frozen=True)
class Series:
    """A series with the times of its runs.

    t, r: (K,), time, s, and value, in units of its noise.
    run: (K,), run of each entry.
    """

    t: Array
    r: Array
    run: Index

    @property
    def runs(self) -> list[Series]:
        """Every run by itself."""
        chosen = [self.run == i for i in np.unique(self.run)]
        return [Series(self.t[k], self.r[k], self.run[k]) for k in chosen]

    @property
    def length(self) -> float:
        """Length of the longest run, s."""
        return max(float(np.ptp(s.t)) for s in self.runs)


@dataclass(frozen=True)
class Peak:
    """A frequency that stands out.

    frequency: hz.
    excess: sum of squares of the validation series in its band, above that of the neighbouring frequencies.
    chance: p-value of its power in all runs, for as many frequencies as were tried; on validation data alone,
        if these do not show it.
    """

    frequency: float
    excess: float
    chance: float


def highest_peak(fitted: Series, validation: Series, fastest: float) -> Peak | None:
    """The frequency that stands out most from its neighbours in all runs; None where these are too short."""
    slowest = SETTINGS.fewest_periods / min(fitted.length, validation.length)
    if slowest >= 0.5 * fastest:
        return None
    cell = 1.0 / max(fitted.length, validation.length)
    # Neighbours on both sides of the slowest frequency, too: slow forces have more power there than above.
    grid = np.arange(slowest / SETTINGS.neighbours, fastest, cell / SETTINGS.oversampling)
    training, validating = fitted.runs, validation.runs
    runs, judging = [*training, *validating], slice(len(training), None)
    powers = np.array([_power_of_run(run, grid) for run in runs])
    own = np.array([_log_p_values(run, p, grid) for run, p in zip(runs, powers, strict=True)])
    chances = _combined(own)
    place = int(np.argmin(np.where(grid < slowest, 1.0, chances)))
    frequency = _peak_frequency(grid, powers.sum(axis=0), place)
    tried = SETTINGS.draws * (fastest - slowest) / cell
    excess = _band_excess(powers[judging].sum(axis=0), frequency, grid, validation.length)
    chance, confirmed = tried * chances[place], _combined(own[judging])[place]
    chance = chance if confirmed < SETTINGS.confirmed else max(chance, confirmed)
    return Peak(frequency, excess, min(1.0, float(chance)))


def _log_p_values(run: Series, power: Array, grid: Array) -> Array:
    """Logarithm of the p-value of the power at each frequency, by the background in the same run.

    The background is itself an estimate from a few neighbours: the ratio of both has an F distribution.
    """
    low, high = _neighbourhoods(grid, grid)
    independent = (grid[high - 1] - grid[low]) * np.ptp(run.t) / _MEDIAN_VARIANCE
    ratio = power / _background(power, grid)
    # A run of one sample has none, and shows nothing.
    return np.asarray(f_ratio.logsf(ratio, 2, 2 * np.maximum(independent, 1e-3)))


def _combined(log_p: Array) -> Array:
    """p-values of several runs together (Fisher's method): none speaks for all by its power alone."""
    return np.asarray(chi2.sf(-2.0 * np.sum(log_p, axis=0), 2 * len(log_p)))


def _power_of_run(s: Series, grid: Array) -> Array:
    """Sum of squares removed by a sine of each frequency, with a free phase."""
    wave = np.exp(-2j * np.pi * np.outer(grid, s.t - s.t[0]))
    return np.asarray(2.0 / len(s.t) * np.abs(wave @ s.r) ** 2)


def _background(power: Array, grid: Array) -> Array:
    """Mean power that the neighbourhood suggests: from the median around each frequency."""
    coarse = grid[:: SETTINGS.oversampling]
    medians = [np.median(power[a:b]) for a, b in zip(*_neighbourhoods(grid, coarse), strict=True)]
    return np.asarray(np.interp(grid, coarse, medians) / _MEDIAN_OVER_MEAN)


def _neighbourhoods(grid: Array, frequencies: Array) -> tuple[Index, Index]:
    """Where in a grid the neighbourhood of each frequency begins and ends."""
    low = np.searchsorted(grid, frequencies / SETTINGS.neighbours)
    return low, np.searchsorted(grid, frequencies * SETTINGS.neighbours)


def _peak_frequency(grid: Array, power: Array, place: int) -> float:
    """Highest point of both data sets together within the width of the line."""
    near = slice(max(place - SETTINGS.oversampling, 0), place + SETTINGS.oversampling + 1)
    return float(grid[near][np.argmax(power[near])])


def _band_excess(power: Array, frequency: float, grid: Array, length: float) -> float:
    """Sum of squares in the band around a frequency, above that of the neighbours."""
    excess = power - _background(power, grid)
    wide = max(SETTINGS.band * frequency, SETTINGS.least_band / length)
    return max(float(np.sum(excess[np.abs(grid - frequency) < wide])) / SETTINGS.oversampling, 0.0)


def without_waves(r: Array, waves: Array, run: Index) -> tuple[Array, Array]:
    """A series without a fitted cosine and sine in every run, and their coefficients.

    r: (K,), series.
    waves: (K, 2), what a cosine and a sine of unit amplitude add to it.
    run: (K,), run of each entry.
    Returns (K,): what is left, and the coefficients in each run.
    """
    left, found = r.copy(), []
    for i in np.unique(run):
        k = run == i
        coefficients = -np.linalg.lstsq(waves[k], r[k], rcond=None)[0]
        left[k] += waves[k] @ coefficients
        found.append(coefficients)
    return left, np.array(found)


@dataclass(frozen=True)
class Clock:
    """Time and log of each test function.

    t: (K,), middle of the test function, s.
    log: (K,), place of the log in `names`; pieces of one log count as one.
    start: (K,), first time in the piece, s.
    names: what the logs are called.
    """

    t: Array
    log: Index
    start: Array
    names: tuple[str, ...]

    @classmethod
    def of(cls, data: WeakData) -> Clock:
        """Clock of the rows of one force equation."""
        row = data.equation == data.rows[0]
        run = data.run_of[row]
        sources = [r.source or r.name for r in data.runs]
        known = list(dict.fromkeys(sources))
        names = [data.runs[sources.index(s)].name.partition(" [")[0] for s in known]
        log = np.array([known.index(s) for s in sources], dtype=np.intp)
        first = np.array([r.t[0] for r in data.runs])
        return cls(data.time[row], log[run], first[run], tuple(names))

    @property
    def step(self) -> float:
        """Time from one test function to the next, s; of a single one, from the start to its middle."""
        steps = np.diff(self.t) if len(self.t) > 1 else self.t - self.start
        return float(np.median(steps))

    def blocks(self, seconds: float) -> Index:
        """Index of the time block of each entry; blocks never span two pieces."""
        return blocks_of_time(self.t - self.start, seconds, self.log, self.start)

    def series(self, r: Array) -> Series:
        """A residual on this clock."""
        return Series(self.t, r, self.log)
