"""Whose and which day's log a file is."""

from __future__ import annotations

from datetime import date, datetime
from pathlib import Path

import polars as pl
import pytest

from undertow.errors import UndertowError
from undertow.fleet.partitions import Partition, duplicates, find, partition_of
from undertow.identification.logs.mapping import LogMapping
from undertow.identification.logs.table import flat_table

PLAIN = {"t": [0.0, 0.1], "u": [1.0, 2.0]}


def written(path: Path, **more: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    pl.DataFrame({**PLAIN, **more}).write_parquet(path)
    return path


@pytest.mark.parametrize(
    ("path", "columns", "vehicle", "day"),
    [
        ("vehicle=a%20b/day=2026-02-03/part.parquet", {}, "a b", date(2026, 2, 3)),
        ("day=20260203/vehicle=v/x.parquet", {"vehicle": ["other"] * 2}, "v", date(2026, 2, 3)),
        ("some/x.parquet", {"vehicle": ["v"] * 2, "day": ["2026-02-03"] * 2}, "v", date(2026, 2, 3)),
        ("some/x.parquet", {"day": [date(2026, 2, 3)] * 2}, "some", date(2026, 2, 3)),
        ("rov7/log_2026-02-03.parquet", {}, "rov7", date(2026, 2, 3)),
        ("rov7/x.parquet", {"t": [1770076800.0, 1770076801.0]}, "rov7", date(2026, 2, 3)),
        ("rov7/x.parquet", {"t": [datetime(2026, 2, 3, 4)] * 2}, "rov7", date(2026, 2, 3)),
        ("rov7/x.parquet", {"t": ["2026-02-03T04:00:00Z"] * 2}, "rov7", date(2026, 2, 3)),
    ],
)
def test_folders_columns_names_and_clocks(
    tmp_path: Path, path: str, columns: dict[str, object], vehicle: str, day: date
) -> None:
    found = partition_of(written(tmp_path / path, **columns), LogMapping())
    assert (found.vehicle, found.day) == (vehicle, day)


@pytest.mark.parametrize(
    ("path", "columns", "words"),
    [
        ("v/x.parquet", {}, "does not give its date"),
        ("v/2026-13-03.parquet", {}, "is not a date"),
        ("vehicle=v/day=monday/x.parquet", {}, "does not give its date"),
        ("v/2026-02-03.parquet", {"vehicle": ["a", "b"]}, "more than one vehicle"),
        ("vehicle=/2026-02-03.parquet", {}, "has an empty vehicle name"),
        ("v/2026-02-03.parquet", {"vehicle": [None, None]}, "has an empty vehicle name"),
    ],
)
def test_what_does_not_say_it_is_refused(
    tmp_path: Path, path: str, columns: dict[str, object], words: str
) -> None:
    with pytest.raises(UndertowError, match=words):
        partition_of(written(tmp_path / path, **columns), LogMapping())


def test_what_is_no_parquet_file_is_refused(tmp_path: Path) -> None:
    csv, broken = tmp_path / "2026-02-03.parquet", tmp_path / "2026-02-04.parquet"
    csv.write_text("t,u\n0,1\n")
    broken.write_bytes(b"PAR1 and no more")
    with pytest.raises(UndertowError, match="neither a Parquet file"):
        partition_of(csv, LogMapping())
    with pytest.raises(UndertowError, match="cannot be read"):
        partition_of(broken, LogMapping())


def test_patterns_and_folders_find_each_file_once(tmp_path: Path) -> None:
    paths = [written(tmp_path / f"logs/v/2026-02-0{i}.parquet") for i in (2, 1)]
    patterns = [str(tmp_path / "logs"), str(tmp_path / "logs/**/*.parquet"), str(paths[0])]
    assert find(patterns) == sorted(paths)
    with pytest.raises(UndertowError, match="no file matches"):
        find([*patterns, str(tmp_path / "*.nothing")])


def test_a_copy_counts_once() -> None:
    one, copy, other = (Partition("v", date(2026, 2, i), Path(f"{i}")) for i in (1, 2, 3))
    assert duplicates([(copy, "h"), (one, "h"), (other, "g")]) == {copy: one}


def test_names_with_brackets_are_names(tmp_path: Path) -> None:
    """Neither a folder nor a file with [1] in its name stands for another."""
    first = written(tmp_path / "logs [1]" / "v" / "x[1].parquet", day=[date(2026, 2, 3)] * 2)
    decoy = written(tmp_path / "logs [1]" / "v" / "x1.parquet", day=[date(2026, 5, 5)] * 2, w=[1.0, 2.0])
    assert find([str(tmp_path / "logs [1]")]) == sorted([first, decoy])
    assert find([str(first)]) == [first]
    assert partition_of(first, LogMapping()).day == date(2026, 2, 3)
    assert flat_table(first, "log").collect().columns == ["t", "u", "day"]


def test_a_clock_counts_in_the_unit_of_the_mapping(tmp_path: Path) -> None:
    ms = LogMapping.model_validate({"time": {"column": "t", "unit": "ms"}})
    path = written(tmp_path / "rov7/x.parquet", t=[1770076800000, 1770076800100])
    assert partition_of(path, ms).day == date(2026, 2, 3)
    with pytest.raises(
        UndertowError, match=r"1\.77008e\+12 s after 1970, which is not a date: give the unit"
    ):
        partition_of(path, LogMapping())
    two_days = written(tmp_path / "rov7/y.parquet", t=[172800000.0, 172800000.1])
    with pytest.raises(UndertowError, match="does not give its date"):
        partition_of(two_days, ms)
