"""Log files, their vehicle and day, and their fingerprints."""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime
from glob import escape, glob
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from undertow.errors import UndertowError
from undertow.files import sha256_of
from undertow.identification.estimation.residual import WeakModel
from undertow.identification.estimation.step import bounds_of, prior_of, step_limits
from undertow.model.composition import Composition
from undertow.model.loading import resolve_vehicle
from undertow.version import __version__

if TYPE_CHECKING:
    import polars as pl

    from undertow.identification.logs.mapping import LogMapping


_KEY = re.compile(r"(vehicle|day)=(.*)")
_DATE = re.compile(r"(?<!\d)(\d{4})-?(\d\d)-?(\d\d)(?!\d)")


@dataclass(frozen=True, order=True)
class Partition:
    """The log of one vehicle and day, or a part of it."""

    vehicle: str
    day: date  # of which day
    path: Path  # where, absolute

    @property
    def name(self) -> str:
        """What reports call it."""
        return f"{self.vehicle} {self.day} ({self.path.name})"


def find(patterns: Sequence[str]) -> list[Path]:
    """Files that fit any of the patterns; a folder stands for all Parquet files below it."""
    found: list[Path] = []
    for pattern in patterns:
        files = [p for p in map(Path, glob(_pattern(pattern), recursive=True)) if p.is_file()]
        if not files:
            raise UndertowError(
                f"no file matches '{pattern}': give Parquet files, such as 'logs/**/*.parquet' (quoted, so "
                "that the shell does not expand it)"
            )
        found += files
    return sorted({p.absolute() for p in found})


def _pattern(given: str) -> str:
    """The pattern that is meant: a file or a folder that is there may have brackets in its name."""
    path = Path(given)
    if path.is_dir():
        return f"{escape(given)}/**/*.parquet"
    return escape(given) if path.is_file() else given


def partition_of(path: Path, mapping: LogMapping) -> Partition:
    """Vehicle and day of a log file.

    The path says so (`vehicle=V/day=D/part.parquet`), or columns `vehicle` and `day` do, or the folder (the
    vehicle) with a date in the file's name or a time that counts from 1970 (the day). Of a vehicle's own log
    (.bin, .ulg, ...) the path does.
    """
    from undertow.identification.logs.formats.fieldlog import format_of
    from undertow.identification.logs.table import is_parquet

    own = format_of(path) is not None
    with path.open("rb") as stream:
        if not own and not is_parquet(stream.read(4)):
            raise UndertowError(
                f"{path} is neither a Parquet file nor a vehicle log: write the table as Parquet"
            )
    keys = {m[1]: unquote(m[2]) for part in path.parent.parts if (m := _KEY.fullmatch(part))}
    head = {} if own or len(keys) == 2 else _from_columns(path, mapping)
    vehicle = keys.get("vehicle", head.get("vehicle", path.parent.name))
    if vehicle is None or not str(vehicle).strip():
        raise UndertowError(f"{path} has an empty vehicle name: name its folder, such as vehicle=rov7")
    return Partition(str(vehicle), _day(path, keys.get("day"), head), path)


def _clock(time: Any, mapping: LogMapping) -> Any:
    """A number of a clock in seconds; anything else as it is."""
    from undertow.model.units import scale_offset

    if not isinstance(time, int | float) or mapping.time.unit == "iso":
        return time
    return scale_offset(mapping.time.unit, "s", of=f"time unit {mapping.time.unit!r}")[0] * time


def _from_columns(path: Path, mapping: LogMapping) -> dict[str, Any]:
    import polars as pl

    from undertow.identification.logs.table import flat_table

    table = flat_table(path, str(path))
    try:
        columns = table.collect_schema().names()
        stated: dict[str, Any] = {n: _only(table, n, path) for n in ("vehicle", "day") if n in columns}
        clock = mapping.time.column
        if clock in columns:
            stated["time"] = _clock(table.select(clock).head(1).collect().item(), mapping)
        return stated
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError) as error:
        raise UndertowError(f"{path} cannot be read: {str(error).splitlines()[0]}") from error


def _only(table: pl.LazyFrame, name: str, path: Path) -> Any:
    values = table.select(name).unique().head(2).collect()[name].to_list()
    if len(values) != 1:
        raise UndertowError(
            f"{path} holds {'no' if not values else 'more than one'} {name}: write one file for each"
        )
    return values[0]


def _day(path: Path, key: str | None, head: dict[str, Any]) -> date:
    stated = key if key is not None else head.get("day")
    if isinstance(stated, date):
        return stated.date() if isinstance(stated, datetime) else stated
    from undertow.identification.logs.table import WHOLE

    time = head.get("time")
    texts = [str(stated)] if stated is not None else [path.stem, *([time] if isinstance(time, str) else [])]
    match = next((found for text in texts if (found := _DATE.search(text))), None)
    if match:
        try:
            return date(*map(int, match.groups()))
        except ValueError as error:
            raise UndertowError(f"{path}: '{match[0]}' is not a date: {error}") from error
    if stated is None and isinstance(time, datetime):
        return time.date()
    if stated is None and isinstance(time, int | float) and time > WHOLE.own_clock:
        return _date_of(path, time)
    raise UndertowError(
        f"{path} does not give its date: name the folder day=2026-05-01, the file 2026-05-01{path.suffix}, "
        "or give the table a column day"
    )


def _date_of(path: Path, time: float) -> date:
    try:
        return datetime.fromtimestamp(time, UTC).date()
    except (ValueError, OverflowError, OSError) as error:
        raise UndertowError(
            f"{path}: its time begins at {time:.6g} s after 1970, which is not a date: give the unit of the "
            'time column in a mapping file (--map), such as [time] unit = "ms"'
        ) from error


def duplicates(hashes: Iterable[tuple[Partition, str]]) -> dict[Partition, Partition]:
    """Partitions with the content of an earlier one, and that one: the same data would count twice."""
    pairs = sorted(hashes)
    first: dict[str, Partition] = {}
    for partition, sha256 in pairs:
        first.setdefault(sha256, partition)
    count = Counter(sha256 for _, sha256 in pairs)
    return {p: first[h] for p, h in pairs if count[h] > 1 and first[h] != p}


def digest(content: Any) -> str:
    """SHA-256 of plain data, and of the version of undertow."""
    return hashlib.sha256(json.dumps([__version__, content], sort_keys=True).encode()).hexdigest()


def files_digest(vehicle: str, effects: Sequence[str]) -> str:
    """Hash of the bytes of a vehicle file and of files with effects."""
    return digest([sha256_of(resolve_vehicle(vehicle)), *map(sha256_of, effects)])


def content_of(model: WeakModel) -> list[Any]:
    """All of a model that its residual, and a step from where it is, follow from; plain data."""
    functions = model.functions
    names = functions.parameter_names
    limits = (*bounds_of(model), *prior_of(model), step_limits(model))
    return [
        _equations(functions.vehicle.composition),
        [[n, *_exact([v])] for n, v in zip(names, functions.values(), strict=True)],
        [*model.free],
        [_exact(values) for values in limits],
    ]


def _equations(of: Composition) -> list[str]:
    """Everything that parameters may occur in: wrenches, the chain from commands to thrust, and sensors."""
    motion = (of.residual, of.wrench_states, of.pose_rate)
    return [str(part) for part in (*motion, *of.chain, of.dead_time, *of.reported, of.report_age)]


def _exact(values: Iterable[float]) -> list[str]:
    return [float(v).hex() for v in values]
