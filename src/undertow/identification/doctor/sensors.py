"""Errors of real velocity sensors; whether pose rates and velocities agree."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from undertow.identification.findings import Finding
from undertow.identification.logs import mapping
from undertow.identification.logs.mapping import Edit, Edits, LogMapping
from undertow.identification.logs.run import UNITS, Run
from undertow.model.symbols import POSE, VELOCITY
from undertow.model.vehicle import Vehicle
from undertow.typing import Array

from .kinematics import Kinematics, Mismatch, Rates, Samples, Segment, rms
from .mistakes import (
    PLAUSIBLE,
    SPEEDS,
    UNITS_OF_MOTION,
    Mistake,
    changed_axes,
    changed_channels,
    combined,
    heading_off_by,
    with_channels,
)

LATE_COURSE = "velocities and heading late against the position"
"""A clock, no effect: `latencies` looks for it, and other explanations have to do better."""
_EQUIVALENT_EFFECTS = {
    "velocity_misalignment": ("attitude_bias",),
    "velocity_lever_arm": ("position_lever_arm",),
}


@dataclass(frozen=True)
class SensorSettings:
    """Thresholds for disagreement of pose rates and velocities, and for sensor errors."""

    # Neighbouring test functions overlap, and what is left is no white noise: so many count as one, here, of
    # clocks and of forces.
    cluster: int = 8
    # Share of the motion below which a mismatch is left to the effects that describe real sensors.
    least_mismatch: float = 0.02
    over_noise: float = 4.0  # mismatch over that by noise alone from which it counts
    decisive: float = 4.0  # factor that undoing a mistake must take off the mean square
    worse: float = 1.25  # factor by which a pose rate may get worse where a mistake is undone
    worse_by: float = 0.01  # and by how much on top of that
    # Explanations that leave no more than this many times the best one's excess are as good as it.
    as_good: float = 2.0
    negligible: float = 3e-3  # excess that is none beside it
    gross: float = 0.3  # mismatch from which pairs of mistakes are looked for: hardly anything in common
    few_samples: int = 800  # samples in which they are looked for
    certain: float = 6.0  # standard errors from which a parameter of a sensor is accepted
    explains: float = 0.5  # share of the mismatch that it may leave
    reported: float = 5e-4  # mismatch below which it is not reported
    least_water: float = 2e-3  # the same for the velocity of the water
    sensor_as_good: float = 2.0  # as `as_good`, of a sensor beside a mistake
    sensor_as_good_by: float = 0.02  # and the share of the mismatch by which it may be worse on top of that
    scale_error: float = 0.3  # standard error from which the scale of a velocity is not determined
    unexplained: float = 0.05  # mismatch that is reported where nothing explains it
    misaligned: float = 0.5  # largest angle by which a sensor is misaligned, rad
    # Of real sensors, at most: bias of a rate, rad/s, error of its scale, delay, s, and distance from the
    # origin, m.
    rate_bias: float = 0.2
    rate_scale: float = 0.5
    delay: float = 3.0
    lever_arm: float = 5.0
    signature: int = 50  # samples of a run, about, that tell whether two readings are the same
    quarter: float = 0.1  # angle from a quarter turn within which that is meant, rad
    no_signal: float = 1e-3  # share of the other below which a pose rate, or a velocity, measures nothing


SETTINGS = SensorSettings()


@dataclass(frozen=True)
class Sensor:
    """One kind of deviation of velocity sensors."""

    id: str  # id of the effect of the catalogue that describes it; "water" for velocities through the water
    names: tuple[str, ...]  # its parameters, with units
    # From samples to the change of J(eta) nu that each parameter makes, (n, 6, k).
    columns: Callable[[Samples, Segment], Array]
    largest: float = np.inf  # parameters beyond this are rejected

    @property
    def effects(self) -> tuple[str, ...]:
        """Effects of the catalogue that would leave the same mismatch."""
        return (self.id, *_EQUIVALENT_EFFECTS.get(self.id, ()))

    def parameters(self, value: Array) -> Array:
        """Parameters of the effect from what was fitted, a share of the reading in the case of a scale."""
        return value / (1.0 - value) if self.id == "sensor_scale" else value


@dataclass(frozen=True)
class SensorFit:
    """A sensor's deviation as fitted."""

    sensor: Sensor
    # value, error: (k,) its parameters and their standard errors.
    value: Array
    error: Array
    after: Mismatch

    @property
    def plausible(self) -> bool:
        """Whether the parameters are such as real sensors have."""
        return bool(np.all(np.abs(self.value) <= self.sensor.largest))

    def shares(self, before: Mismatch) -> tuple[float, float]:
        """Mismatch of the pose rates that the deviation changes, without it and with it."""
        changed = np.abs(self.after.excess - before.excess) > SETTINGS.reported
        return float(np.sum(before.excess[changed])), float(np.sum(self.after.excess[changed]))

    def explains(self, before: Mismatch) -> bool:
        """Whether a plausible deviation, well determined, explains most of a mismatch."""
        certain = np.max(np.abs(self.value) / self.error) > SETTINGS.certain
        share, left = self.shares(before)
        return self.plausible and bool(certain) and left < SETTINGS.explains * share

    def description(self) -> str:
        """Id and parameters."""
        parts = [
            f"{n.split(' ')[0]} = {v:.3g} ± {e:.1g} {' '.join(n.split(' ')[1:])}".rstrip()
            for n, v, e in zip(self.sensor.names, self.sensor.parameters(self.value), self.error, strict=True)
        ]
        return f"{self.sensor.id}: {', '.join(parts)}"


def sensors(kinematics: Kinematics) -> list[Sensor]:
    """All kinds that the channels of a comparison can show."""
    linear = [n for n in VELOCITY[:3] if n in kinematics.channels]
    angular = [n for n in VELOCITY[3:] if n in kinematics.channels]
    kinds = []
    if linear and kinematics.rows and kinematics.rows[0] in ("x", "y", "z"):
        kinds += _of_linear(linear, angular)
    if angular and kinematics.rows[-1] in ("phi", "theta", "psi"):
        biases, scales = tuple(f"b_{n} rad/s" for n in angular), tuple(f"s_{n}" for n in angular)
        kinds.append(Sensor("sensor_bias", biases, _columns_of(_bias, angular), SETTINGS.rate_bias))
        kinds.append(Sensor("sensor_scale", scales, _columns_of(_scale, angular), SETTINGS.rate_scale))
    return kinds


def _of_linear(linear: list[str], angular: list[str]) -> list[Sensor]:
    found = [
        Sensor("sensor_bias", tuple(f"b_{n} m/s" for n in linear), _columns_of(_bias, linear)),
        # A Doppler log set for another speed of sound is some percent off; knots are half of what they say.
        Sensor("sensor_scale", ("s",), _common_scale, PLAUSIBLE.scale),
        Sensor("sensor_delay", ("delay s",), _delay, SETTINGS.delay),
        Sensor(LATE_COURSE, ("delay s",), _course_delay),
        Sensor("water", ("north m/s", "east m/s", "down m/s")[: 3 if "w" in linear else 2], _water(linear)),
    ]
    if "u" in linear and "v" in linear:
        found.append(Sensor("velocity_misalignment", ("alpha rad",), _misalignment, SETTINGS.misaligned))
    arms = {"x_s": "r" in angular or "q" in angular, "y_s": "r" in angular or "p" in angular}
    arms["z_s"] = "p" in angular or "q" in angular
    names = [n for n, seen in arms.items() if seen]
    if names:
        places = ["xyz".index(n[0]) for n in names]
        found.append(
            Sensor(
                "velocity_lever_arm", tuple(f"{n} m" for n in names), _lever_arm(places), SETTINGS.lever_arm
            )
        )
    return found


# --- columns ----------------------------------------------------------------------------------
def _columns_of(
    columns: Callable[[Samples], Array], names: Sequence[str]
) -> Callable[[Samples, Segment], Array]:
    places = [VELOCITY.index(n) for n in names]
    return lambda at, _: columns(at)[:, :, places]


def _bias(at: Samples) -> Array:
    """A reading with a constant offset: the true value is smaller."""
    return -at.jacobian


def _scale(at: Samples) -> Array:
    return -at.jacobian * at.velocity[:, None, :]


def _common_scale(at: Samples, _: Segment) -> Array:
    return _scale(at)[:, :, :3].sum(axis=2, keepdims=True)


def _delay(at: Samples, s: Segment) -> Array:
    """Velocities of a while ago: the change of J nu is the delay times J d(nu)/dt."""
    change = np.gradient(at.velocity[:, :3], s.times, axis=0)
    return np.einsum("nij,nj->ni", at.jacobian[:, :, :3], change)[:, :, None]


def _course_delay(at: Samples, s: Segment) -> Array:
    """Velocities and heading of a while ago, as of a receiver that smooths speed and course."""
    rates = np.einsum("nij,nj->ni", at.jacobian[:, :3, :3], at.velocity[:, :3])
    change = np.gradient(rates, s.times, axis=0)
    return np.concatenate([change, np.zeros_like(change)], axis=1)[:, :, None]


def _misalignment(at: Samples, _: Segment) -> Array:
    """A sensor turned by alpha reads (u + alpha v, v - alpha u)."""
    u, v = at.velocity[:, 0], at.velocity[:, 1]
    real = np.stack([-v, u, np.zeros_like(u)], axis=1)
    return np.einsum("nij,nj->ni", at.jacobian[:, :, :3], real)[:, :, None]


def _lever_arm(places: list[int]) -> Callable[[Samples, Segment], Array]:
    """A sensor at r_s reads v + omega x r_s."""

    def columns(at: Samples, _: Segment) -> Array:
        omega = at.velocity[:, 3:]
        crossed = np.stack([np.cross(omega, np.eye(3)[i]) for i in places], axis=2)
        return -np.einsum("nij,njk->nik", at.jacobian[:, :, :3], crossed)

    return columns


def _water(linear: list[str]) -> Callable[[Samples, Segment], Array]:
    size = 3 if "w" in linear else 2
    return lambda at, _: np.broadcast_to(np.eye(6)[:, :size], (len(at.pose), 6, size))


# --- fit --------------------------------------------------------------------------------------
def fit_sensor(
    kinematics: Kinematics, runs: Sequence[Run], rates: Rates, sensor: Sensor, others: Sequence[Sensor] = ()
) -> SensorFit:
    """Fit one kind of deviation, with others beside it, to what pose rates and velocities differ by."""
    columns = [regressor_of(kinematics, runs, one) for one in (sensor, *others)]
    regressor, own = np.concatenate(columns, axis=2), columns[0].shape[2]
    # What differs in pose rates that the deviation does not change says nothing of it.
    used = np.any(regressor != 0.0, axis=(0, 2))
    used |= not used.any()
    weight = rates.weight[:, used]
    table = (regressor[:, used] * weight[:, :, None]).reshape(-1, regressor.shape[2])
    target = ((rates.pose - rates.velocity)[:, used] * weight).ravel()
    value, error = clustered_least_squares(table, target, SETTINGS.cluster * int(used.sum()))
    fitted = Rates(rates.pose, rates.velocity + regressor @ value, rates.variance)
    return SensorFit(sensor, value[:own], error[:own], kinematics.mismatch_of(fitted))


def regressor_of(kinematics: Kinematics, runs: Sequence[Run], sensor: Sensor) -> Array:
    """Change of J(eta) nu that each parameter makes, as means over test functions, (K, rows, k)."""
    parts = []
    for s in kinematics.segments:
        columns = sensor.columns(kinematics.samples(runs[s.run], s), s)[:, kinematics.places]
        flat = np.asarray(s.functions.value @ columns.reshape(len(columns), -1))
        parts.append(flat.reshape(-1, *columns.shape[1:]) / s.length[:, None, None])
    return np.concatenate(parts)


def clustered_least_squares(
    table: Array, target: Array, size: int, rcond: float = 1e-10
) -> tuple[Array, Array]:
    """Least squares with standard errors from clusters of `size` neighbouring rows (sandwich estimator).

    Rows are in units of their noise; errors are never less than independent rows of that noise would give,
    since few clusters say little. Combinations of columns whose share of the whole is below `rcond` (squared)
    are left at zero.
    """
    scale = np.linalg.norm(table, axis=0)
    seen = scale > 0
    value, error = np.zeros(len(scale)), np.full(len(scale), np.inf)
    scaled = table[:, seen] / scale[seen]
    inverse = np.linalg.pinv(scaled.T @ scaled, rcond=rcond, hermitian=True)
    solution = inverse @ (scaled.T @ target)
    left = target - scaled @ solution
    scores = scaled * left[:, None]
    groups = np.add.reduceat(scores, np.arange(0, len(scores), size), axis=0)
    value[seen] = solution / scale[seen]
    plain = max(1.0, float(left @ left) / max(len(left) - len(solution), 1)) * np.diag(inverse)
    clustered = np.diag(inverse @ (groups.T @ groups) @ inverse)
    error[seen] = np.sqrt(np.maximum(plain, clustered)) / scale[seen]
    return value, error


@dataclass(frozen=True)
class Explained:
    """A mistake with what undoing it does."""

    mistake: Mistake  # the best explanation
    rivals: list[Mistake]  # others that leave as little
    # before, after: of the log with the mistake, and without.
    before: Mismatch
    after: Mismatch


def inconsistent(mismatch: Mismatch, least: float = SETTINGS.least_mismatch) -> np.ndarray:
    """Blocks in which pose rates and velocities disagree by more than noise and small sensor errors."""
    return (mismatch.excess > least) & (mismatch.share > SETTINGS.over_noise * mismatch.floor)


def explains(before: Mismatch, after: Mismatch) -> bool:
    """Whether a mismatch vanishes decisively, and none appears elsewhere."""
    wrong, gone = inconsistent(before), _vanishes(before, after)
    worse = after.excess > still_good(before.excess)
    return bool(np.any(wrong & gone) and not np.any(worse))


def spoils(before: Mismatch, after: Mismatch) -> np.ndarray:
    """Blocks in which pose rates and velocities agree clearly less than before, if still well."""
    shows = (after.excess > SETTINGS.reported) & (after.share > SETTINGS.over_noise * after.floor)
    return shows & (after.excess > SETTINGS.decisive * before.excess)


def still_good(excess: float | Array) -> float | Array:
    """The mismatch up to which nothing got worse, by that before."""
    return SETTINGS.worse * excess + SETTINGS.worse_by


def contradicts(found: Explained, chosen: Mistake) -> bool:
    """Whether pose rates and velocities are too far apart for any sensor where a mistake explains them."""
    # It has to explain them wherever it has an influence: the remainder is due to a sensor, and perhaps more.
    before, after = found.before, found.after
    changed = np.abs(after.share - before.share) > SETTINGS.least_mismatch
    if np.any(inconsistent(before) & changed & ~_vanishes(before, after)):
        return False
    return _explained(before, after) > possible_mismatch(chosen)


def possible_mismatch(chosen: Mistake) -> float:
    """Share of the motion by which sensors let pose rates and velocities disagree where this explains it."""
    return PLAUSIBLE.other_unit if chosen.id in UNITS_OF_MOTION else PLAUSIBLE.contradiction


def _explained(before: Mismatch, after: Mismatch) -> float:
    """Largest mismatch that has gone."""
    return float(np.max(before.excess[_vanishes(before, after)], initial=0.0))


def _vanishes(before: Mismatch, after: Mismatch) -> np.ndarray:
    """Blocks whose mismatch vanishes, so that pose rates and velocities agree more than they differ."""
    # Otherwise noise scaled away together with its motion would count as explained.
    return (after.excess <= before.excess / SETTINGS.decisive) & (after.share < PLAUSIBLE.agreement)


def best_explanation(
    kinematics: Kinematics, runs: Sequence[Run], known: Iterable[Mistake], vehicle: Vehicle
) -> Explained | None:
    """The mistake that explains most of a mismatch; None where there is none, or nothing explains it."""
    # Single mistakes are tried first; pairs only where none helps and the mismatch is gross.
    before = kinematics.mismatch(runs)
    if not np.any(inconsistent(before)):
        return None
    distinct = _distinct(kinematics, runs, known)
    found = _decisive(kinematics, runs, before, distinct)
    if not found and np.max(before.excess) > SETTINGS.gross:
        found = _pairs(kinematics, runs, before, distinct, vehicle)
    if not found:
        return None
    least = min(after.total for _, after in found)
    limit = SETTINGS.as_good * least + SETTINGS.negligible
    equals = sorted((m.count, i) for i, (m, after) in enumerate(found) if after.total <= limit)
    order = [found[i] for _, i in equals]
    return Explained(order[0][0], [m for m, _ in order[1:]], before, order[0][1])


def _pairs(
    kinematics: Kinematics, runs: Sequence[Run], before: Mismatch, distinct: list[Mistake], vehicle: Vehicle
) -> list[tuple[Mistake, Mismatch]]:
    """Pairs of mistakes that explain a mismatch, looked for in few samples and confirmed in all."""
    few_samples = Kinematics(runs, vehicle, most=SETTINGS.few_samples)
    if not few_samples:
        return []
    likely = [m for m in distinct if m.id not in UNITS_OF_MOTION or _nearer(few_samples, runs, m)]
    pairs = [combined(a, b) for a, b in combinations(likely, 2) if a.id != b.id]
    found = _decisive(few_samples, runs, few_samples.mismatch(runs), pairs)
    wrong = inconsistent(before)
    certain = _decisive(kinematics, runs, before, [m for m, _ in found])
    # Of so many pairs one may do something by chance: they have to explain all there is.
    return [(m, after) for m, after in certain if np.all(_vanishes(before, after)[wrong])]


def _nearer(kinematics: Kinematics, runs: Sequence[Run], mistake: Mistake) -> bool:
    """Whether pose rates and velocities are nearer in size without a mistake, whatever their directions."""
    now, then = (_size_differences(kinematics, of) for of in (runs, [mistake.undo(run) for run in runs]))
    return bool(np.any(then < now - np.log(1.0 + PLAUSIBLE.ratio)))


def _size_differences(kinematics: Kinematics, runs: Sequence[Run]) -> Array:
    """How far pose rates and velocities are apart in size, as a logarithm, for each block."""
    pose, velocity = kinematics.powers(kinematics.rates(runs))
    return np.abs(np.log(np.maximum(pose, 1e-300) / np.maximum(velocity, 1e-300))) / 2


def _decisive(
    kinematics: Kinematics, runs: Sequence[Run], before: Mismatch, known: Iterable[Mistake]
) -> list[tuple[Mistake, Mismatch]]:
    given, found = kinematics.rates(runs), []
    for mistake in known:
        rates = kinematics.rates([mistake.undo(run) for run in runs])
        after = kinematics.mismatch_of(rates)
        # Where a mismatch remains although a mistake is involved, that is not the cause there.
        wrong = inconsistent(before) & (kinematics.changed(given, rates) > SETTINGS.least_mismatch)
        remains = np.any(after.excess[wrong] > before.excess[wrong] / SETTINGS.worse)
        units = [m for m in mistake.combined or (mistake,) if m.id in _UNITS]
        # Exchanged for an axis along which nothing moves, any motion would agree; a unit may be that large.
        compared = units or not np.any(kinematics.still(given, rates)[wrong])
        if remains or not compared or not explains(before, after):
            continue
        if all(_shows_unit(kinematics, runs, unit, mistake, (before, after)) for unit in units):
            found.append((mistake, after))
    return found


_UNITS = UNITS_OF_MOTION | {"degrees_for_radians"}


def _shows_unit(
    kinematics: Kinematics,
    runs: Sequence[Run],
    unit: Mistake,
    whole: Mistake,
    change: tuple[Mismatch, Mismatch],
) -> bool:
    """Whether a mismatch that a mistake, or both of a pair, removes is evidence of another unit."""
    # A small reduction does not, if a sensor error may be as large. Nor does one also achieved with the
    # channels set to zero: in their own unit they agree with the rest.
    before, after = change
    if whole.id in UNITS_OF_MOTION and not _explained(before, after) > PLAUSIBLE.other_unit:
        return False
    silent = kinematics.mismatch([_zeroed(unit, whole, run) for run in runs])
    return _explained(silent, after) > 0.0


def _zeroed(unit: Mistake, whole: Mistake, run: Run) -> Run:
    """A mended run with zeros in the velocities that a unit is about, or else in all its channels."""
    for part in whole.combined or (whole,):
        names = changed_channels(part, run) if part is unit else set()
        zeros = {n: np.zeros(len(run.t)) for n in names & set(SPEEDS) or names}
        run = with_channels(part.undo(run), zeros)
    return run


def _distinct(kinematics: Kinematics, runs: Sequence[Run], known: Iterable[Mistake]) -> list[Mistake]:
    """Mistakes that change something that is looked at, each change once."""
    seen: list[Array] = [_some_samples(kinematics, runs[0])]
    result = []
    for mistake in known:
        now = _some_samples(kinematics, mistake.undo(runs[0]))
        if not any(np.allclose(now, other, rtol=1e-9, atol=1e-12, equal_nan=True) for other in seen):
            seen.append(now)
            result.append(mistake)
    return result


def _some_samples(kinematics: Kinematics, run: Run) -> Array:
    """A few samples of the channels that take part."""
    step = max(1, len(run.t) // SETTINGS.signature)
    return np.array([run.channels[n][::step] for n in kinematics.channels])


def sensor_fits(kinematics: Kinematics, runs: Sequence[Run]) -> list[SensorFit]:
    """Every kind of deviation of a sensor, fitted alone; the one that leaves least comes first."""
    rates = kinematics.rates(runs)
    fits = [fit_sensor(kinematics, runs, rates, s) for s in sensors(kinematics)]
    return sorted((f for f in fits if f.plausible), key=lambda f: f.after.total)


def as_good_as(explained: Explained, fits: Sequence[SensorFit]) -> list[SensorFit]:
    """Sensors' deviations that explain a mismatch as well as a mistake does, wherever that explains it."""
    before, after = explained.before.excess, explained.after.excess
    gone = inconsistent(explained.before) & (after <= before / SETTINGS.decisive)
    limit = SETTINGS.sensor_as_good * after + SETTINGS.sensor_as_good_by * before
    return [f for f in fits if f.sensor.id != "water" and np.all((f.after.excess <= limit)[gone])]


# --- through the water ------------------------------------------------------------------------
def through_water(kinematics: Kinematics, before: Mismatch, fits: Sequence[SensorFit]) -> Explained | None:
    """Velocities through the water: a mismatch that is constant north and east."""
    if kinematics.rows[0] != "x":
        return None
    water = next((f for f in fits if f.sensor.id == "water"), None)
    if (
        water is None
        or before.excess[0] < SETTINGS.least_water
        or before.share[0] < SETTINGS.over_noise * before.floor[0]
    ):
        return None
    certain = np.max(np.abs(water.value) / water.error) > SETTINGS.certain
    if not certain or water.after.excess[0] > before.excess[0] / SETTINGS.decisive:
        return None
    return Explained(_in_water(water.value), [], before, water.after)


def with_rivals(water: Explained, other: Explained | None) -> Explained:
    """Velocities through the water, with the mistakes that explain the mismatch about as well."""
    limit = SETTINGS.as_good * water.after.total + SETTINGS.negligible
    if other is None or other.after.total > limit:
        return water
    return replace(water, rivals=[other.mistake, *other.rivals])


def _in_water(current: Array) -> Mistake:
    speeds = tuple(round(float(v), 4) for v in [*current, 0.0, 0.0][:3])

    def edits(mapping: LogMapping) -> Edits:
        given = mapping.water.velocity if mapping.water else (0.0, 0.0, 0.0)
        return (Edit("water", "velocity", [round(a + b, 4) for a, b in zip(given, speeds, strict=True)]),)

    return Mistake(
        "velocity_through_water",
        "u, v, w are velocities through the water, read as velocities over ground: the water moves with "
        f"{speeds[0]:+.3g} m/s north and {speeds[1]:+.3g} m/s east",
        changed_axes(lambda channels: mapping.over_ground(channels, speeds)),
        edits,
        vehicle="[effects.water_speed_log] describes velocities through the water as they are",
    )


# --- a heading from any direction --------------------------------------------------------------
def heading_offset(kinematics: Kinematics, runs: Sequence[Run], mapping: LogMapping) -> Iterator[Mistake]:
    """A heading off by a constant that is too large for a misaligned sensor, as one zeroed at the start."""
    horizontal = [i for i, name in enumerate(kinematics.rows) if name in ("x", "y")]
    if len(horizontal) < 2 or "psi" not in kinematics.channels:
        return
    rates = kinematics.rates(runs)
    pose, velocity = (table[:, horizontal] @ np.array([1.0, 1.0j]) for table in (rates.pose, rates.velocity))
    angle = float(np.angle(np.vdot(velocity, pose)))
    beside_quarter = abs(np.angle(np.exp(4j * angle))) / 4
    if abs(angle) < SETTINGS.misaligned or beside_quarter < SETTINGS.quarter:
        return
    # Some angle always fits best: what it leaves must be too small to be reported.
    mistake = heading_off_by(angle, mapping)
    after = kinematics.mismatch([mistake.undo(run) for run in runs]).excess
    if all(after[k] < SETTINGS.unexplained for k, b in enumerate(kinematics.blocks) if {*b} & {*horizontal}):
        yield mistake


# --- what a sensor does -----------------------------------------------------------------------
def sensor_findings(kinematics: Kinematics, runs: Sequence[Run]) -> Iterator[Finding]:
    """Deviations of velocity sensors that explain a mismatch, and what no deviation explains."""
    rates = kinematics.rates(runs)
    known = [s for s in sensors(kinematics) if s.id not in ("water", "sensor_delay", LATE_COURSE)]
    for _ in known:
        before = kinematics.mismatch_of(rates)
        fits = [fit_sensor(kinematics, runs, rates, s) for s in known]
        best = min((f for f in fits if f.explains(before)), key=lambda f: f.after.total, default=None)
        if best is None or before.total <= SETTINGS.reported:
            break
        yield _sensor_finding(best, best.shares(before)[0], drifts="v" not in kinematics.channels)
        change = regressor_of(kinematics, runs, best.sensor) @ best.value
        rates = Rates(rates.pose, rates.velocity + change, rates.variance)
    left = kinematics.mismatch_of(rates)
    parts = zip(kinematics.blocks, left.excess, inconsistent(left, SETTINGS.unexplained), strict=True)
    for block, excess, differs in parts:
        if differs:
            names = ", ".join(kinematics.rows[i] for i in block)
            yield _measures_nothing(kinematics, rates, block) or Finding(
                id="inconsistent",
                severity="warning",
                text=f"the rate of {names} and the velocities disagree by {excess:.0%} of the motion (mean "
                "square), and neither a usual mistake nor a sensor error explains it",
                evidence={"share": float(excess)},
            )


def contradicted(kinematics: Kinematics, runs: Sequence[Run]) -> bool:
    """Whether some pose rate and the velocities differ by more than is called consistent."""
    return bool(np.any(inconsistent(kinematics.mismatch(runs), SETTINGS.unexplained)))


def without_measurement(kinematics: Kinematics, runs: Sequence[Run]) -> Finding | None:
    """Velocities that stay zero while the pose moves; None if there are none."""
    rates = kinematics.rates(runs)
    differ = inconsistent(kinematics.mismatch_of(rates), SETTINGS.unexplained)
    blocks = (b for b, differs in zip(kinematics.blocks, differ, strict=True) if differs)
    found = (_measures_nothing(kinematics, rates, block) for block in blocks)
    return next((f for f in found if f is not None and f.severity == "mistake"), None)


def _measures_nothing(kinematics: Kinematics, rates: Rates, block: list[int]) -> Finding | None:
    """Velocities that are zero while the pose moves, or the reverse; None where both move."""
    pose_rms, velocity_rms = (rms(table[:, block]) for table in (rates.pose, rates.velocity))
    if min(pose_rms, velocity_rms) > SETTINGS.no_signal * max(pose_rms, velocity_rms):
        return None
    pose = [kinematics.rows[i] for i in block]
    velocities = [VELOCITY[POSE.index(n)] for n in pose]
    silent = velocity_rms < pose_rms
    dead, remedy = (velocities, "; it is then derived from the pose") if silent else (pose, "")
    verb, unit = "measures" if len(dead) == 1 else "measure", UNITS[velocities[0]]
    return Finding(
        id="measures_nothing",
        severity="mistake" if silent else "warning",
        text=f"{', '.join(dead)} {verb} nothing: {', '.join(pose)} changes by {pose_rms:.2g} {unit} rms, and "
        f"{', '.join(velocities)} is {velocity_rms:.2g} {unit}; put it into `ignore` of the mapping "
        f"file{remedy}",
        evidence={"pose": pose_rms, "velocity": velocity_rms},
    )


def _sensor_finding(fit: SensorFit, share: float, *, drifts: bool) -> Finding:
    """What a sensor explains, a mismatch of this share of the motion.

    drifts: the vehicle may go sideways in turns, which nothing measured and its model leaves out.
    """
    names = (n.split(" ")[0] for n in fit.sensor.names)
    turns = drifts and fit.sensor.id == "velocity_lever_arm"
    drift = "or the vehicle drifts in turns, and has no sway in its file; " if turns else ""
    effects = " or ".join(fit.sensor.effects)
    return Finding(
        id="velocity_sensor",
        severity="warning",
        text=f"pose rates and velocities disagree by {share:.1%} of the motion (mean square), as "
        f"with {fit.description()}; {drift}undertow add {effects} adds it to the model",
        evidence=dict(zip(names, fit.sensor.parameters(fit.value).tolist(), strict=True)),
    )


# --- what was not looked at ---------------------------------------------------------------------
def not_compared(kinematics: Kinematics, vehicle: Vehicle) -> Iterator[Finding]:
    """Degrees of freedom whose pose rate and velocity were not both measured: a frame or sign shows less."""
    pairs = zip(vehicle.pose_names, vehicle.velocity_names, strict=True)
    alone = [f"{v} with the rate of {p}" for p, v in pairs if p not in kinematics.rows]
    if not alone:
        return
    what = "no pose rate could be compared" if not kinematics.rows else f"not compared: {', '.join(alone)}"
    yield Finding(
        id="not_compared",
        severity="note",
        text=f"{what} (pose and velocity were not both measured, or one never changes): units, frames and "
        "signs there can only be judged from the fit of the model",
        evidence={"degrees_of_freedom": float(len(alone))},
    )


# --- agreement --------------------------------------------------------------------------------
def agreement(kinematics: Kinematics, runs: Sequence[Run]) -> Iterator[Finding]:
    """Scale and offset of every measured velocity against the rate of the pose, as far as they show."""
    kinds = ((VELOCITY[:3], POSE[:3]), (VELOCITY[3:], POSE[3:]))
    seen = [v for v, pose in kinds if {*pose} & {*kinematics.rows}]
    own = {*kinematics.channels}.difference(*(run.derived for run in runs))
    names = [n for group in seen for n in group if n in own]
    if not names:
        return
    size, places = len(names), [VELOCITY.index(n) for n in names]

    def columns(at: Samples, _: object) -> Array:
        j = at.jacobian[:, :, places]
        return np.concatenate([j * at.velocity[:, None, places], j], axis=2)

    labels = tuple(f"{kind}_{n}" for kind in ("scale", "offset") for n in names)
    fit = fit_sensor(kinematics, runs, kinematics.rates(runs), Sensor("agreement", labels, columns))
    scale, offset = 1.0 + fit.value[:size], fit.value[size:]
    lines = [
        f"{n} {s:.3f} ± {e:.1g}, offset {o:+.2g} {UNITS[n]}"
        for n, s, e, o in zip(names, scale, fit.error, offset, strict=False)
        if e < SETTINGS.scale_error
    ]
    if lines:
        values = [*scale.tolist(), *offset.tolist()]
        yield Finding(
            id="agreement",
            severity="note",
            text=f"pose rate over velocity: {'; '.join(lines)}",
            evidence=dict(zip(labels, values, strict=True)),
        )
