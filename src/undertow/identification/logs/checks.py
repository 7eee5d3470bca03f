"""What a log must be before anything is computed from it; a refusal is one line with place and remedy."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from undertow.errors import UndertowError
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.run import Run
from undertow.identification.logs.series import last_known
from undertow.model.actuators import TURNS
from undertow.model.vehicle import Vehicle
from undertow.typing import Array


@dataclass(frozen=True)
class Measurable:
    """What can be in a log."""

    # Largest magnitude of a value or time, SI. Values that stand for a missing one (1e20, 9.97e36, 1e308) are
    # larger, distances on Earth in nm are not; its powers up to the tenth are numbers.
    largest: float = 1e15
    # Samples that a fit takes: four hours at 20 Hz. In surge alone, 10^6 take five minutes and 1.4 GB.
    samples: int = 300_000
    # Lines of a file per sample, at most: some are blank or comments. Only used to stop reading early.
    rows_per_sample: int = 2
    # Samples a second beyond which a vehicle moves more slowly than it is logged, and as many as will do.
    fast: float = 50.0
    enough: float = 20.0
    # quick, slow: steps, s, between which vehicles are usually logged: at 0.2 to 250 Hz. Of two units of a
    # clock the one in which its steps are nearer to these is the likelier.
    quick: float = 0.004
    slow: float = 5.0


MEASURABLE = Measurable()


def far_from_usual(step: float) -> float:
    """Factor, as a logarithm, by which a step, s, is shorter or longer than those of vehicles; 0 if usual."""
    return float(max(0.0, np.log(MEASURABLE.quick) - np.log(step), np.log(step) - np.log(MEASURABLE.slow)))


def check_time(t: Array, column: str, where: str) -> None:
    """Refuse times that are missing, infinite, too few, doubled or out of order."""
    thing = f"{where}: time column {column!r}"
    if len(t) < 2:
        found = "no sample" if len(t) == 0 else f"one sample (t = {t[0]:g} s)"
        raise UndertowError(f"{where} has {found}, at least 2 are needed: check that the log is complete")
    bad = np.flatnonzero(~np.isfinite(t))
    if len(bad):
        value = "missing" if np.isnan(t[bad[0]]) else "infinite"
        raise UndertowError(
            f"{thing} is {value} in {len(bad)} of {len(t)} rows, first in row {bad[0] + 1}: remove them"
        )
    late = np.flatnonzero(np.abs(t) > MEASURABLE.largest)
    if len(late):
        raise UndertowError(
            f"{thing} is {t[late[0]]:g} s in row {late[0] + 1}, beyond {MEASURABLE.largest:g} s: check its "
            "unit and offset in the mapping file"
        )
    step = np.diff(t)
    back, same = np.flatnonzero(step < 0), np.flatnonzero(step == 0)
    if len(back):
        at = back[0]
        raise UndertowError(
            f"{thing} goes back from {t[at]:.9g} to {t[at + 1]:.9g} s at row {at + 2} ({len(back)} times in "
            "all): "
            "sort the file by time, or split it where the clock was restarted"
        )
    if len(same):
        at = same[0]
        raise UndertowError(
            f"{thing} has {len(same)} duplicate stamps, first {t[at]:.9g} s at row {at + 2}: keep one row "
            "per time"
        )


def in_order(t: Array) -> NDArray[np.bool_]:
    """Tell which times are later than all before them; a missing one counts as in order."""
    latest = np.fmax.accumulate(np.concatenate([[-np.inf], t]))
    return np.asarray((t > latest[:-1]) | np.isnan(t))


def disorder(t: Array, later: NDArray[np.bool_]) -> list[str]:
    """One note on rows that are not in order, none where all are."""
    at = np.flatnonzero(~later)
    if not len(at):
        return []
    return [
        f"{len(at)} rows left out, not later than an earlier row: first t = {t[at[0]]:.9g} s, row {at[0] + 1}"
    ]


def check_channel(name: str, t: Array, data: Array, where: str) -> None:
    """Refuse a channel with an infinite value or without any value."""
    check_finite(name, t, data, where)
    if np.isnan(data).all():
        raise UndertowError(empty(name, len(data), where))


def check_finite(name: str, t: Array, data: Array, where: str) -> None:
    """Refuse a channel with an infinite value, or one that no sensor of any unit reports."""
    infinite = np.flatnonzero(np.isinf(data))
    if len(infinite):
        raise UndertowError(
            f"{where}: channel {name!r} is infinite in {len(infinite)} of {len(data)} samples, first at t = "
            f"{t[infinite[0]]:g} s: leave such cells empty, or name the value under `missing` in a mapping "
            "file"
        )
    beyond = np.flatnonzero(np.abs(data) > MEASURABLE.largest)
    if len(beyond):
        raise UndertowError(
            f"{where}: channel {name!r} is {data[beyond[0]]:g} at t = {t[beyond[0]]:g} s and beyond "
            f"{MEASURABLE.largest:g} in {len(beyond)} of {len(data)} samples, which is impossible: name the "
            "value under `missing` in a mapping file, or correct unit, scale and power there"
        )


def empty(name: str, samples: int, where: str) -> str:
    """What to say of a channel without any value."""
    return (
        f"{where}: channel {name!r} has no value in any of {samples} samples: remove the column, or name it "
        "under `ignore` in a mapping file"
    )


def fill_commands(
    name: str, t: Array, data: Array, policy: str, where: str, before: float = np.nan
) -> tuple[Array, str]:
    """Deal with missing samples of a command; return the command and a note, empty where none was missing.

    The policy is "refuse", "hold" (the last value stays, as of a thruster; before the first sample it is
    `before`) or "gap" (left missing).
    """
    missing = np.flatnonzero(np.isnan(data))
    if not len(missing):
        return data, ""
    spell = f"t = {t[missing[0]]:g} to {t[missing[-1]]:g} s"
    text = f"command {name!r} is missing in {len(missing)} of {len(t)} rows ({spell})"
    remedy = (
        'set missing_commands = "hold" or "gap" in the mapping file, or take a part of the log without them '
        "(--from, --to)"
    )
    if policy == "refuse":
        raise UndertowError(f"{where}: {text}: {remedy}")
    if policy == "gap":
        return data, f"{text}; left missing"
    data = np.concatenate([[before if np.isnan(data[0]) else data[0]], data[1:]])
    held = last_known(data)
    if np.isnan(held[0]):
        raise UndertowError(
            f"{where}: {text}, and there is none before t = {t[0]:g} s to hold: begin later (--from)"
        )
    return held, f"{text}; the last value was held"


def constant_channels(run: Run, names: Iterable[str] | None = None) -> dict[str, float]:
    """Return the channels (of `names`, or all) that never change, with their value."""
    asked = run.channels if names is None else {name: run.channels[name] for name in names if run.has(name)}
    present = {name: data[np.isfinite(data)] for name, data in asked.items()}
    return {name: float(data[0]) for name, data in present.items() if len(data) > 1 and np.ptp(data) == 0}


def refuse_constant(run: Run, names: Iterable[str]) -> None:
    """Refuse a run in which one of the channels never changes."""
    dead = constant_channels(run, names)
    if dead:
        text = ", ".join(f"{name} = {value:g}" for name, value in dead.items())
        raise UndertowError(
            f"run {run.name!r}: {text} over all {len(run.t)} samples (dead sensor, or motion not excited): "
            "leave the channel out of the log, or the degree of freedom out of the vehicle"
        )


def refuse_twins(runs: Iterable[Run]) -> None:
    """Refuse the same data twice: they would be judged by what they were fitted to, or weigh double."""
    seen: dict[tuple[str, float], str] = {}
    for run in runs:
        what = run.sha256, float(run.t[0])  # several stretches of a log are not the same data
        if run.sha256 and what in seen:
            raise UndertowError(
                f"logs {seen[what]} and {run.source} have the same content: give each only once, for "
                "fitting or for validation"
            )
        seen[what] = run.source


def refuse_too_many(samples: int, log: str | Path) -> None:
    """Refuse more samples than a fit takes; `log` is the one with which they are too many."""
    if samples > MEASURABLE.samples:
        raise UndertowError(
            f"log {log}: with it there are {samples} samples, a fit takes at most {MEASURABLE.samples}: take "
            "a part of the logs with --from and --to, or thin them out (10 to 20 samples per second are "
            "enough)"
        )


def refuse_other_speeds(run: Run, vehicle: Vehicle) -> None:
    """Refuse speeds of propellers that were read in rad/s where the vehicle counts them otherwise."""
    counted = {t.name: t.unit for t in vehicle.thrusters if t.unit in TURNS and t.unit != "rad/s"}
    mapping = run.mapping or LogMapping()
    stated = [(name, column.channel, column.unit) for name, column in mapping.columns.items()]
    stated += [(name, name, formula.unit) for name, formula in mapping.channels.items()]
    for name, command, unit in stated:
        if command in counted and unit is not None:
            raise UndertowError(
                f"log {run.source or run.name}: column {name!r} was read in rad/s, since its mapping states "
                f"the unit {unit!r}, and the vehicle counts command {command!r} in "
                f'{counted[command]}: write revolutions = "rad/s" into the vehicle file, or a scale '
                "in place of the unit into the mapping"
            )


def check_fit(runs: Sequence[Run], validation: Sequence[Run], vehicle: Vehicle) -> None:
    """Refuse logs that nothing can be fitted to: given twice, too long, with a velocity that never changes.

    Such a velocity would be explained by parameters that make the vehicle heavy or stiff.
    """
    total = 0
    for run in (*runs, *validation):
        total += len(run.t)
        refuse_too_many(total, run.source or run.name)
        refuse_other_speeds(run, vehicle)
    refuse_twins([*runs, *validation])
    dead = [constant_channels(run, vehicle.velocity_names) for run in runs]
    if dead:
        refuse_constant(runs[0], [name for name in dead[0] if all(name in found for found in dead)])


def with_distinct_names(runs: list[Run]) -> list[Run]:
    """Runs with names that tell them apart: ending or folder are added where file names are the same."""
    count = Counter(run.name for run in runs)
    ended = Counter((run.name, _ending(run)) for run in runs)

    def longer_name(run: Run) -> Run:
        if ended[run.name, _ending(run)] == 1:
            return replace(run, name=f"{run.name} ({_ending(run)})")
        return replace(run, name=f"{Path(run.source).resolve().parent.name}/{run.name}")

    longer = [longer_name(run) if count[run.name] > 1 else run for run in runs]
    again = Counter(run.name for run in longer)
    return [
        replace(r, name=f"{r.name} ({i})") if again[r.name] > 1 else r for i, r in enumerate(longer, start=1)
    ]


def _ending(run: Run) -> str:
    return "".join(Path(run.source).suffixes)
