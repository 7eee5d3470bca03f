"""Clock and samples of a log, and what happened in every degree of freedom."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from undertow.identification.estimation.data import channel_noise, noise_by_order
from undertow.identification.findings import DofExcitation, Finding
from undertow.identification.logs.mapping import Edit, Edits, LogMapping, as_toml, column_edit
from undertow.identification.logs.run import FORCES, MEASURABLE, UNITS, Run, with_report_noise, with_reports
from undertow.model.catalogue import catalogue, logged_quantities
from undertow.model.symbols import FORCE
from undertow.model.vehicle import Vehicle
from undertow.typing import Array, Flags, Index


@dataclass(frozen=True)
class SamplingSettings:
    """From where on sampling and excitation are reported."""

    jitter: float = 0.05  # spread of the steps, as a share of the usual one, up to which it does no harm
    # rounded, whole_digit: times that are rounded are within half of their last digit of what they were; a
    # time counts as a whole number of digits if it is as near as this, of one digit.
    rounded: float = 0.6
    whole_digit: float = 1e-3
    gap: float = 5.0  # steps of this many usual ones are gaps: nothing is integrated across them
    missing: float = 0.02  # share of rows or cells that are missing
    # Times that share, of rows and of cells, from which a note is a warning.
    many_rows: float = 5.0
    many_cells: float = 10.0
    most_time: float = 0.5  # share of the time in gaps, many of them, from which rows come in bursts
    # Where rows are lost from an even clock, this share of the longer steps is a whole number of usual ones,
    # as near as this; an irregular clock has steps of any length.
    whole_share: float = 0.7
    whole_tolerance: float = 0.2
    held: float = 1.8  # rows per new value from which a sensor counts as slower than its log
    irregular: float = 0.35  # share of its intervals that may be irregular
    # By that share of the usual one, or by one row; and the fewest intervals that show it.
    regular: float = 0.2
    intervals: int = 10
    excited: float = 3.0  # rms over noise below which a motion is not informative
    moving_share: float = 0.1  # share of its usual largest value from which a velocity is motion
    usual_largest: float = 0.98  # share of the samples that stay below that value
    over_noise: float = 3.0  # times its noise from which a velocity is motion
    one_way: float = 0.05  # share of the motion below which a direction was not excited
    # Squared correlation of speed and its square beyond which drag laws cannot be told apart.
    indistinct_laws: float = 0.985
    periodic: float = 0.9  # share of the power of a motion in one line of its spectrum: one period only
    periods: int = 10  # of that line in the longest log; below, a line is a step or a drift as well
    reversals: int = 2  # changes of direction that dead band and dry friction need
    headings: float = np.radians(60.0)  # span that tells a current from a constant force, rad
    # Noise by differences of the highest order over that by lower ones below which it is not white: of white
    # noise all of them agree within a few per cent.
    not_white: float = 0.5
    # Noise that no sensor is below, in the unit of its channel: a tenth of that of the best tracking systems
    # (10^-4 m, 10^-5 rad), Doppler logs (10^-4 m/s) and fibre-optic gyros (10^-6 rad/s).
    least_noise: tuple[tuple[str, float], ...] = (("m", 1e-5), ("rad", 1e-6), ("m/s", 1e-5), ("rad/s", 1e-7))
    line_bins: int = 5  # bins of the spectrum that a line takes up, through a Hann window
    spectrum_samples: int = 256  # samples of a segment whose spectrum is taken
    cut_offs: int = 40  # frequencies that are tried for the place where it is cut off
    # Share of the steepest fall of the spectrum over half an octave, in decibel, from which it is cut off.
    cut_off_slope: float = 0.7
    # Share of the usual slope below which a change of slope is rounding, and above which it is a new sample;
    # share of the moving rows that lie on a straight line from which a channel was interpolated.
    straight: tuple[float, float] = (1e-6, 1e-3)
    on_lines: float = 0.5
    fewest: int = 20  # new samples that show it
    names: int = 5  # runs that are named where many show the same
    multiple: float = 0.01  # distance from a whole number of steps within which a reading is coarse
    repeats: float = 0.3  # share of rows that repeat the one before, from which a channel is held or coarse


SETTINGS = SamplingSettings()


DROP = (Edit("time", "disorder", "drop"),)


def sampling(runs: Sequence[Run], channels: Sequence[str], mapping: LogMapping) -> list[Finding]:
    """Everything about the clock of runs."""
    found = list(_worst_of_runs(runs, channels, mapping))
    slow = [f for name in channels if (f := _held(runs, name, mapping)) is not None]
    return [*found, *_filtered(runs, channels), *slow, *_interpolated(runs, channels, mapping)]


def _worst_of_runs(runs: Sequence[Run], channels: Sequence[str], mapping: LogMapping) -> Iterator[Finding]:
    """Findings in runs; if several agree, the worst one with the names of the others."""
    found = [(run.name, f) for run in runs for f in _findings_of_run(run, channels, mapping)]
    kinds: dict[tuple[str, str], list[tuple[str, Finding]]] = {}
    for name, f in found:
        kinds.setdefault((f.id, f.severity), []).append((name, f))
    for same_kind in kinds.values():
        name, worst = max(same_kind, key=lambda pair: next(iter(pair[1].evidence.values())))
        others = [other for other, _ in same_kind if other != name]
        text = f"{name}: {worst.text}" + (f"; less so in {_first_names(others)}" if others else "")
        yield worst.model_copy(update={"text": text})


def _first_names(names: Sequence[str]) -> str:
    shown = SETTINGS.names
    return ", ".join(names[:shown]) + (f" and {len(names) - shown} more" if len(names) > shown else "")


def _findings_of_run(run: Run, channels: Sequence[str], mapping: LogMapping) -> Iterator[Finding]:
    """Findings whose first number says how bad it is, with texts that do not name the run."""
    step = np.diff(run.clock)
    usual = float(np.median(step))
    yield from _disorder(run, mapping)
    yield from _bursts(step, usual) or _lost_rows(run, step, usual)
    yield from _irregular(run.clock, usual)
    yield from _dense(usual, mapping)
    yield from _missing_samples(run, channels)


def _irregular(clock: Array, usual: float) -> Iterator[Finding]:
    """Steps that vary, and whether the times are those of an even clock with too few digits."""
    jitter = jitter_of(clock)
    if jitter <= SETTINGS.jitter:
        return
    evidence, digits = {"jitter": jitter, "step": usual}, _digits(clock)
    row = np.arange(len(clock))
    interval, start = np.polyfit(row, clock, 1)
    off = float(np.max(np.abs(clock - start - interval * row)))
    irregular = f"sampling is irregular: steps of {usual:.4g} s vary by {jitter:.0%}"
    if not off < SETTINGS.rounded * digits:
        yield Finding(
            id="jitter", severity="note", text=f"{irregular} (times are used as they are)", evidence=evidence
        )
        return
    yield Finding(
        id="rounded_times",
        severity="warning",
        text=f"times are rounded to {digits:g} s: {irregular}, but rows {interval:.5g} s apart are within "
        f'{off:.2g} s of them; if the log is that even, write interval = "{interval:.6g} s" under [time] in '
        "the mapping file, in place of the unit, or else log more digits",
        evidence=evidence | {"interval": float(interval)},
        mapping=as_toml([Edit("time", "interval", f"{interval:.6g} s")]),
    )


def _digits(clock: Array) -> float:
    """Place of the last digit that the times have, s; 0 from a microsecond down."""
    for place in 10.0 ** np.arange(1, -6, -1):
        if np.all(np.abs(clock / place - np.round(clock / place)) < SETTINGS.whole_digit):
            return float(place)
    return 0.0


def jitter_of(clock: Array) -> float:
    """Spread of the steps of a clock, without its gaps, as a share of the usual one."""
    step = np.diff(clock)
    if not len(step):
        return 0.0
    usual = float(np.median(step))
    return float(np.std(step[step < 1.5 * usual]) / usual)


def _disorder(run: Run, mapping: LogMapping) -> Iterator[Finding]:
    if run.dropped:
        known = mapping.time.disorder == "drop"
        yield Finding(
            id="disorder",
            severity="note" if known else "mistake",
            text=f"{run.dropped} of {run.dropped + len(run.t)} rows are not later than an earlier row "
            "(repeated or backward time stamps); they were left out",
            evidence={"rows": float(run.dropped)},
            mapping="" if known else as_toml(DROP),
        )


def _bursts(step: Array, usual: float) -> list[Finding]:
    """Rows that arrive in bursts: the time between them is not time in which the vehicle moved."""
    gaps = step[step > SETTINGS.gap * usual]
    share = float(np.sum(gaps) / np.sum(step))
    if share <= SETTINGS.most_time or len(gaps) < SETTINGS.missing * len(step):
        return []
    if _usual_spell(step, step > SETTINGS.gap * usual) > np.median(gaps):
        return []  # a log of several sessions, or with outages
    return [
        Finding(
            id="bursts",
            severity="mistake",
            text=f"rows come in bursts, {usual:.3g} s apart, and {share:.0%} of the time is in {len(gaps)} "
            f"steps of more than {SETTINGS.gap:g} times that: these are times of arrival or of writing, not "
            "of measurement, and no rate of change can be computed from them: use the time stamped by the "
            "vehicle as the column of [time]",
            evidence={"share": share, "gaps": float(len(gaps))},
        )
    ]


def _usual_spell(step: Array, gap: Flags) -> float:
    """How long the spell between two gaps lasts in which half of the rows are, or in longer ones, s."""
    last = np.flatnonzero(np.append(gap, True))
    first = np.append(0, last[:-1] + 1)
    clock = np.append(0.0, np.cumsum(step))
    lasts, rows = clock[last] - clock[first], last - first + 1
    order = np.argsort(lasts)
    return float(lasts[order][np.searchsorted(np.cumsum(rows[order]), np.sum(rows) / 2.0)])


def _lost_rows(run: Run, step: Array, usual: float) -> Iterator[Finding]:
    gaps, few = step[step > SETTINGS.gap * usual], step[(step > 1.5 * usual) & (step <= SETTINGS.gap * usual)]
    # Of an even clock with rows left out, steps are a whole number of usual ones.
    off = np.abs(few / usual - np.round(few / usual))
    even = len(few) and np.mean(off < SETTINGS.whole_tolerance) > SETTINGS.whole_share
    few = few if even else few[:0]
    lost = float(sum(np.sum(np.round(long / usual) - 1.0) for long in (gaps, few)))
    share = lost / (lost + len(run.clock))
    if not len(gaps) and share < SETTINGS.missing:
        return
    place = run.clock[int(np.argmax(step))]
    longest = f", the longest of {gaps.max():.4g} s at t = {place:.5g} s" if len(gaps) else ""
    yield Finding(
        id="gaps",
        severity="warning" if share > SETTINGS.many_rows * SETTINGS.missing else "note",
        text=f"{share:.1%} of the rows are missing at a usual step of {usual:.4g} s "
        f"({len(few)} short spells, {len(gaps)} gaps{longest}); nothing is interpolated",
        evidence={"share": share, "gaps": float(len(gaps)), "longest": float(step.max())},
    )


def _dense(usual: float, mapping: LogMapping) -> Iterator[Finding]:
    """A log that has far more rows than the motion of a vehicle needs."""
    if usual * MEASURABLE.fast < 1.0:
        every = mapping.time.every * round(1.0 / (usual * MEASURABLE.enough))
        yield Finding(
            id="dense",
            severity="note",
            text=f"{1.0 / usual:.3g} rows a second are more than the motion of a vehicle needs: for a first "
            f"look, set every = {every} under [time] in the mapping file",
            evidence={"rate": 1.0 / usual},
            mapping=as_toml([Edit("time", "every", every)]),
        )


def _missing_samples(run: Run, channels: Sequence[str]) -> Iterator[Finding]:
    """Cells without a value, in the worst channel."""
    shares = {n: float(np.mean(np.isnan(run.channels[n]))) for n in channels if run.has(n)}
    worst = max(shares, key=lambda n: shares[n], default=None)
    if worst is None or shares[worst] < SETTINGS.missing:
        return
    several = sorted((n for n in shares if shares[n] >= SETTINGS.missing), key=lambda n: -shares[n])
    others, removed = ", ".join(n for n in several if n != worst), run.outliers.get(worst)
    yield Finding(
        id="missing_samples",
        severity="warning" if shares[worst] > SETTINGS.many_cells * SETTINGS.missing else "note",
        text=f"{worst} has no value in {shares[worst]:.1%} of the rows"
        + (f", with {removed} outliers that were removed" if removed else "")
        + (f" (missing samples also in {others})" if others else ""),
        evidence={n: shares[n] for n in several},
    )


# --- held values ------------------------------------------------------------------------------
def _held(runs: Sequence[Run], name: str, mapping: LogMapping) -> Finding | None:
    """A channel that repeats its last value until the sensor reports again."""
    periods = [p for run in runs if run.has(name) and name not in run.derived and (p := _period(run, name))]
    if len(periods) < len(runs):
        return None
    rows, seconds = (float(np.median([p[i] for p in periods])) for i in (0, 1))
    return Finding(
        id="held_values",
        severity="warning",
        text=f"{name} has a new value only every {rows:.1f} rows ({seconds:.3g} s) and repeats the last one "
        f"in between: rows are up to {seconds:.2g} s late",
        evidence={"rows": rows, "seconds": seconds},
        mapping=as_toml(_fresh(name, mapping)),
    )


def _fresh(name: str, mapping: LogMapping) -> Edits:
    """What lets a channel report when its value changes; nothing of a formula in several columns."""
    edit = column_edit(mapping, name)
    computed = mapping.channels.get(name) if edit.table == "channels" else None
    columns = [edit.key] if computed is None else computed.formula.columns
    return (column_edit(mapping, name, fresh=columns[0]),) if len(columns) == 1 else ()


def held_channels(runs: Sequence[Run], channels: Sequence[str], mapping: LogMapping) -> dict[str, Edits]:
    """Channels that repeat their values in between, and the changes of a mapping file that end that."""
    held = [name for name in channels if _held(runs, name, mapping) is not None]
    return {name: edits for name in held if (edits := _fresh(name, mapping))}


def read_when_new(run: Run, names: Iterable[str]) -> Run:
    """A run whose channels report only where their values change, as `fresh` in a mapping file says."""
    reports = {}
    for name in (n for n in names if run.has(n)):
        there = _reports(run, name)
        new = there[np.diff(run.channels[name][there], prepend=np.nan) != 0.0]
        reports[name] = np.full(len(run.t), np.nan)
        reports[name][new] = run.channels[name][new]
    reported = {**run.reported, **{n: np.isfinite(values) for n, values in reports.items()}}
    return with_report_noise(with_reports(replace(run, reported=reported), reports))


def _reports(run: Run, name: str) -> Index:
    """Rows in which a channel was reported; in between it lies on a smooth curve."""
    there = np.isfinite(run.channels[name])
    return np.flatnonzero(there & run.reported.get(name, there))


def _period(run: Run, name: str) -> tuple[float, float] | None:
    """Usual number of rows, and seconds, between changes; None where every row is new or nothing changes."""
    there = _reports(run, name)
    y, t = run.channels[name][there], run.t[there]
    at = np.flatnonzero(np.diff(y) != 0.0)
    if len(at) < SETTINGS.intervals:
        return None
    # A coarse reading at rest repeats itself, too, but not at regular intervals.
    between = np.diff(at)
    usual = float(np.median(between))
    near = np.abs(between - usual) <= np.maximum(1.0, SETTINGS.regular * usual)
    regular = float(np.mean(near)) > 1 - SETTINGS.irregular
    # Where the sensor moves by many of its steps from row to row, or by no whole number of them, repeats are
    # no coarse readings.
    steps = np.abs(y[at + 1] - y[at])
    steps = steps / np.min(steps)
    coarse = np.median(steps) < 2 and np.median(np.abs(steps - np.round(steps))) < SETTINGS.multiple
    if usual < SETTINGS.held or not regular or coarse:
        return None
    return usual, float(np.median(np.diff(t[at])))


# --- interpolated before they were logged -------------------------------------------------------
def _interpolated(runs: Sequence[Run], channels: Sequence[str], mapping: LogMapping) -> Iterator[Finding]:
    """Channels whose rows lie on straight lines between the samples of a slower sensor."""
    rows = {n: period for n in channels if (period := _interpolated_rows(runs, n)) is not None}
    if not rows:
        return
    usual = float(np.median(list(rows.values())))
    logged = [n for n in channels if any(r.has(n) and n not in r.derived for r in runs)]
    # A row in so many is as good as the samples only if no other sensor is faster.
    every = mapping.time.every * round(usual) if len(rows) == len(logged) else 0
    remedy = f"set every = {every}" if every else "leave the cells between its samples blank"
    yield Finding(
        id="interpolated",
        severity="warning",
        text=f"{', '.join(rows)} {'are' if len(rows) > 1 else 'is'} interpolated linearly: only one row in "
        f"{usual:.2g} has a new sample, the others lie on straight lines, so their noise is not that of the "
        f"sensor and corners look like forces; {remedy}, and state the noise of the sensor",
        evidence={f"rows_{n}": period for n, period in rows.items()},
        mapping=as_toml([Edit("time", "every", every)]) if every else "",
    )


def _interpolated_rows(runs: Sequence[Run], name: str) -> float | None:
    """Rows per new sample of a channel that was interpolated linearly in all runs; None for others."""
    periods = [_rows_per_sample(r, name) for r in runs if r.has(name) and name not in r.derived]
    found = [p for p in periods if p is not None]
    return float(np.median(found)) if found and len(found) == len(periods) else None


def _rows_per_sample(run: Run, name: str) -> float | None:
    there = np.flatnonzero(np.isfinite(run.channels[name]))
    slope = np.diff(run.channels[name][there]) / np.diff(run.t[there])
    moving = (slope[1:] != 0.0) & (slope[:-1] != 0.0)
    if np.sum(moving) < SETTINGS.fewest:
        return None
    rounding, new = SETTINGS.straight
    slope = slope / np.median(np.abs(slope[slope != 0.0]))
    bend = np.abs(np.diff(slope))
    corner = moving & (bend > rounding)
    # A sample between two rows bends the line at both.
    samples = np.flatnonzero(corner & ~np.concatenate([[False], corner[:-1]]))
    if len(samples) < SETTINGS.fewest or np.median(bend[corner]) < new:
        return None
    # Each line between samples has a slope of its own, while a coarse reading goes up and down by the same
    # few steps: those of each power of ten, if it is written with so many digits.
    coarse = 2 * len(np.unique(np.round(slope[:-1][moving & ~corner] / rounding))) < len(samples)
    if coarse or np.mean(bend[moving] <= rounding) < SETTINGS.on_lines:
        return None
    return float(np.median(np.diff(samples)))


# --- filtered before they were logged -----------------------------------------------------------
def was_filtered(runs: Sequence[Run], names: Sequence[str]) -> dict[str, float]:
    """Channels that were filtered before they were logged (or computed), with their apparent cut-off, Hz."""
    # Differences of increasing order probe ever higher frequencies. For white noise they agree; for a
    # filtered record each finds less than the one before, down to less than any sensor has. Channels that
    # were derived from others, that a mapping file states the noise of, or that repeat their values are not
    # looked at.
    found = {}
    for name in names:
        own = [r for r in runs if r.has(name) and name not in r.derived and name not in r.sigma]
        cut_offs = [c for c in (_cut_off(r, name) for r in own) if c is not None]
        if own and 2 * len(cut_offs) > len(own):
            found[name] = float(np.median(cut_offs))
    return found


def _cut_off(run: Run, name: str) -> float | None:
    """Frequency above which the spectrum of a channel falls off, or None where white noise is in it."""
    segment = max(run.segments([name]), key=lambda s: s.stop - s.start, default=slice(0))
    t, y = run.t[segment], run.channels[name][segment]
    noise = noise_by_order(t, y)
    moving = np.any(np.diff(y)) and np.mean(np.diff(y) == 0.0) < SETTINGS.repeats
    if len(t) < SETTINGS.spectrum_samples or not noise or not moving:
        return None
    white = noise[-1] > SETTINGS.not_white * noise[len(noise) // 2]
    credible = min(noise) > dict(SETTINGS.least_noise).get(UNITS.get(name, ""), 0.0)
    return None if white and credible else _cut_off_frequency(t, y)


def _cut_off_frequency(t: Array, y: Array) -> float:
    """Lowest frequency, Hz, from which the spectrum of a signal falls nearly as steeply as it ever does."""
    from scipy.signal import welch  # slow to import, and few logs come this far

    step = float(np.median(np.diff(t)))
    # Differences: else the leakage of the slow motion, which is far larger, hides the rest.

    f, power = welch(np.diff(y), 1 / step, "blackmanharris", SETTINGS.spectrum_samples, detrend="linear")
    level = 10 * np.log10(power[1:] / np.sin(np.pi * f[1:] * step) ** 2 + 1e-300)
    grid = np.geomspace(f[4], f[-1] / np.sqrt(2), SETTINGS.cut_offs)
    fall = np.interp(grid, f[1:], level) - np.interp(np.sqrt(2) * grid, f[1:], level)
    return float(grid[np.argmax(fall >= SETTINGS.cut_off_slope * np.max(fall))])


def _filtered(runs: Sequence[Run], channels: Sequence[str]) -> Iterator[Finding]:
    cut_offs = was_filtered(runs, channels)
    if cut_offs:
        shown = ", ".join(f"{n} above {f:.2g} Hz" for n, f in cut_offs.items())
        yield Finding(
            id="filtered_record",
            severity="warning",
            text=f"no sensor noise is left in {shown}: filtered before it was logged, or computed; errors in "
            "units of the noise are meaningless there: use the simulation error, or state the noise of the "
            'sensor in the mapping file (noise = "...")',
            evidence=cut_offs,
        )


@dataclass(frozen=True)
class _Motion:
    """A velocity of all runs, its noise, the samples of a second, and where it moves."""

    parts: list[Array]
    noise: float
    rate: int

    @property
    def all(self) -> Array:
        data = np.concatenate(self.parts)
        return data[np.isfinite(data)]

    @property
    def threshold(self) -> float:
        return max(
            SETTINGS.over_noise * self.noise,
            SETTINGS.moving_share * float(np.quantile(np.abs(self.all), SETTINGS.usual_largest)),
        )

    @property
    def means(self) -> Array:
        """Means over a second: in them, noise is smaller by the root of the number of samples."""
        whole = self.all[: len(self.all) // self.rate * self.rate]
        return np.asarray(whole.reshape(-1, self.rate).mean(axis=1))

    @property
    def moving(self) -> Array:
        return self.all[np.abs(self.all) > self.threshold]

    @property
    def single_period(self) -> float | None:
        """Period, in samples, of a motion that has only one; None of any other."""
        longest = max(map(len, self.parts))
        spectra = [np.abs(np.fft.rfft(_windowed(part), longest)) ** 2 for part in self.parts]
        power = np.sum(spectra, axis=0)
        width = SETTINGS.line_bins
        lines = np.convolve(power, np.ones(width), mode="valid")
        first, bins = int(np.argmax(lines)), np.arange(width)
        only = first >= SETTINGS.periods and lines[first] > SETTINGS.periodic * np.sum(power)
        return longest / (first + bins @ power[first : first + width] / lines[first]) if only else None

    @property
    def reversals(self) -> int:
        """Changes of direction, of speeds that stand out only."""
        fast = (part[np.abs(part) > self.threshold] for part in self.parts)
        return sum(int(np.sum(np.diff(np.sign(part)) != 0)) for part in fast)


def _windowed(part: Array) -> Array:
    there = np.isfinite(part)
    mean = np.mean(part[there]) if there.any() else 0.0
    return np.asarray(np.hanning(len(part)) * np.where(there, part - mean, 0.0))


def excitation(vehicle: Vehicle, runs: Sequence[Run]) -> list[DofExcitation]:
    """What happened in each degree of freedom."""
    names = vehicle.velocity_names
    noise = channel_noise(runs, names)
    return [
        _excitation_of(vehicle, i, _Motion([r.channels[n] for r in runs], float(noise[i]), _rate(runs)), runs)
        for i, n in enumerate(names)
    ]


def _rate(runs: Sequence[Run]) -> int:
    """Samples of a second, at least one, and no more than a tenth of the shortest log has."""
    usual = 1.0 / float(np.median(np.diff(runs[0].t)))
    return int(np.clip(round(usual), 1, max(1, min(len(r.t) for r in runs) // 10)))


def _excitation_of(vehicle: Vehicle, place: int, motion: _Motion, runs: Sequence[Run]) -> DofExcitation:
    name = vehicle.velocity_names[place]
    moving = motion.moving
    span = _command_range(vehicle, vehicle.dof_indices[place], runs)
    return DofExcitation(
        degree_of_freedom=vehicle.degrees_of_freedom[place],
        velocity=name,
        unit=UNITS[name],
        rms=float(np.sqrt(np.mean(motion.all**2))) if len(motion.all) else 0.0,
        noise=motion.noise,
        moving=len(moving) / max(len(motion.all), 1),
        positive=float(np.mean(moving > 0)) if len(moving) else 0.0,
        reversals=motion.reversals,
        command_range=span,
        cannot=list(_cannot(motion, runs[0].step, bool(_acting_on(vehicle, vehicle.dof_indices[place])))),
    )


def _command_range(vehicle: Vehicle, row: int, runs: Sequence[Run]) -> float | None:
    """Span of the commanded force over the largest span that limits allow."""
    gains = {t.name: t.wrench[row] * t.thrust_per_command.value for t in vehicle.thrusters}
    gains = {name: gain for name, gain in gains.items() if gain}  # a rudder or a fin gives none at rest
    limits, lowest = vehicle.command_limits, vehicle.lowest_commands
    largest = sum(abs(g) * (limits[n] - lowest[n] if n in limits else np.inf) for n, g in gains.items())
    if not gains or not np.isfinite(largest) or any(vehicle.laws):
        return None
    force = np.concatenate([sum(g * r.channels[n] for n, g in gains.items()) for r in runs])
    return float((np.nanmax(force) - np.nanmin(force)) / largest)


def _cannot(motion: _Motion, step: float, driven: bool) -> Iterator[str]:
    """What a motion, sampled every `step` s, cannot identify; `driven`: whether a command acts on it."""
    moving, means, noise = motion.moving, motion.means, float(motion.noise / np.sqrt(motion.rate))
    if not len(moving) or not len(means) or np.sqrt(np.mean(means**2)) < SETTINGS.excited * noise:
        yield "anything: the motion does not exceed its noise"
        return
    if np.std(means) < SETTINGS.excited * noise:
        yield "added mass (the velocity hardly changes)"
    if min(np.mean(moving > 0), np.mean(moving < 0)) < SETTINGS.one_way:
        yield "drag in the other direction"
    speed, square = np.abs(moving), moving**2
    left = square - speed * (speed @ square) / (speed @ speed)  # by a straight line through zero
    if left @ left < (1 - SETTINGS.indistinct_laws) * (square @ square):
        yield "linear and quadratic drag separately (one speed only)"
    if (period := motion.single_period) is not None:
        # A sine has two numbers, its size and its phase, to be explained.
        wave = "" if driven else ", nor tell these from a wave that keeps it swinging"
        only = f"(one period only, {period * step:.3g} s)"
        yield f"more than two of inertia, damping and stiffness{wave} {only}"
    if motion.reversals < SETTINGS.reversals:
        yield "dead band and dry friction (hardly any reversals)"


def excitation_findings(
    rows: Sequence[DofExcitation], vehicle: Vehicle, runs: Sequence[Run]
) -> Iterator[Finding]:
    """Degrees of freedom that were not excited, and parameters that the motion cannot identify."""
    for row in rows:
        if row.cannot:
            unexcited = not _is_excited(row)
            yield Finding(
                id="excitation",
                severity="warning" if unexcited else "note",
                text=f"{row.degree_of_freedom} ({row.velocity}: rms {row.rms:.3g}, noise {row.noise:.2g} "
                f"{row.unit}; {row.reversals} reversals) cannot show {'; '.join(row.cannot)}",
                evidence={"rms": row.rms, "noise": row.noise, "reversals": float(row.reversals)},
            )
    yield from _headings(vehicle, runs)
    yield from _constant_commands(rows, vehicle, runs)
    yield from _unused_inputs(vehicle, runs)
    yield from _unused_forces(vehicle, runs)


def _constant_commands(
    rows: Sequence[DofExcitation], vehicle: Vehicle, runs: Sequence[Run]
) -> Iterator[Finding]:
    """Commands that never change: they cannot be identified, and the column may be the wrong one."""
    still = {n for n in vehicle.command_names if all(_is_constant(run.channels[n]) for run in runs)}
    if not still:
        return
    moving = [
        row.degree_of_freedom
        for row, place in zip(rows, vehicle.dof_indices, strict=True)
        if _is_excited(row) and (acting := _acting_on(vehicle, place)) and still.issuperset(acting)
    ]
    names = [n for n in vehicle.command_names if n in still]
    clause = f"what {'they do' if len(names) > 1 else 'it does'} cannot be seen in this log"
    if moving:
        clause = (
            f"nothing that acts on {', '.join(moving)} changes although the vehicle moves there, so the "
            "model must attribute the motion to something else"
        )
    yield Finding(
        id="still_commands",
        severity="warning" if moving else "note",
        text=f"{', '.join(names)} never change{'' if len(names) > 1 else 's'}: {clause}; is this the right "
        "column?",
        evidence={"commands": float(len(still))},
    )


def _unused_inputs(vehicle: Vehicle, runs: Sequence[Run]) -> Iterator[Finding]:
    """Quantities that the mapping file names, that effects can take, and that the vehicle file does not."""
    known = (n for n in logged_quantities(catalogue()) if n not in vehicle.inputs)
    names = [n for n in known if all(r.has(n) for r in runs)]
    if names:
        listed = ", ".join(f'"{n}"' for n in (*vehicle.inputs, *names))
        yield Finding(
            id="unused_inputs",
            severity="note",
            text=f"the log holds {', '.join(names)}, which effects can use: inputs = [{listed}] in the "
            "vehicle file",
            evidence={"inputs": float(len(names))},
        )


def _unused_forces(vehicle: Vehicle, runs: Sequence[Run]) -> Iterator[Finding]:
    """Forces that the log holds, of a vehicle that nothing drives."""
    rows = [FORCES[place] for place in vehicle.dof_indices]
    names = [n for n in rows if any(r.has(n) and not _is_constant(r.channels[n]) for r in runs)]
    if names and not (vehicle.actuator_names or vehicle.force_channels):
        listed = ", ".join(f'"{n}"' for n in names)
        yield Finding(
            id="unused_forces",
            severity="warning",
            text=f"the log holds {', '.join(names)}, and the vehicle file has neither thrusters nor forces, "
            f"so nothing drives the model: generalised_forces = [{listed}] in the vehicle file",
            evidence={"forces": float(len(names))},
        )


def _is_constant(data: Array) -> bool:
    there = data[np.isfinite(data)]
    return not len(there) or bool(np.max(there) == np.min(there))


def _is_excited(row: DofExcitation) -> bool:
    return not any(text.startswith("anything") for text in row.cannot)


def _acting_on(vehicle: Vehicle, place: int) -> set[str]:
    """Commands of the thrusters that push along a degree of freedom, or its force itself."""
    pushing = {t.name for t in vehicle.thrusters if t.wrench[place]}
    return pushing | ({f"tau_{FORCE[place]}"} & {*vehicle.command_names})


def _headings(vehicle: Vehicle, runs: Sequence[Run]) -> Iterator[Finding]:
    if not {"surge", "yaw"} <= set(vehicle.degrees_of_freedom) or not all(r.has("psi") for r in runs):
        return
    headings = np.concatenate([r.channels["psi"] for r in runs])
    span = float(np.nanmax(headings) - np.nanmin(headings))
    if span < SETTINGS.headings:
        yield Finding(
            id="headings",
            severity="note",
            text=f"headings span {np.degrees(span):.0f} degrees: a current cannot be distinguished from a "
            "constant force, nor a velocity sensor error from a compass error",
            evidence={"span": span},
        )
