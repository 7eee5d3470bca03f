"""Cases on disk: CSV logs, the vehicle file (TOML) and the truth (JSON)."""

from __future__ import annotations

import gzip
import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from .cases import Case

#: Run -> file, as in the other hidden-effect data sets.
FILES = {"steps": "train_1", "cruise": "train_2", "multisine": "train_3", "holdout": "holdout"}


def write_case(case: Case, folder: str | Path, *, compress: bool = False) -> Path:
    """Write the runs as train_1.csv, train_2.csv, train_3.csv and holdout.csv, vehicle.toml and truth.json.

    With `compress` the logs are .csv.gz, the same bytes every time. The folder is made if needed.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    for run, columns in case.runs.items():
        write_log(folder / f"{FILES[run]}.csv", csv_text(columns), compress=compress)
    (folder / "vehicle.toml").write_text(toml_text(case.vehicle), encoding="utf-8", newline="\n")
    truth = json.dumps(case.truth, indent=1) + "\n"
    (folder / "truth.json").write_text(truth, encoding="utf-8", newline="\n")
    return folder


def write_log(path: Path, text: str, *, compress: bool) -> Path:
    """Write text as it is, or as path + ".gz" without name and time in it: equal text, equal bytes."""
    data = text.encode()
    if not compress:
        path.write_bytes(data)
        return path
    packed = io.BytesIO()
    with gzip.GzipFile(filename="", mode="wb", fileobj=packed, mtime=0, compresslevel=9) as stream:
        stream.write(data)
    target = path.with_name(path.name + ".gz")
    target.write_bytes(packed.getvalue())
    return target


def csv_text(columns: dict[str, np.ndarray]) -> str:
    """One run as CSV with five decimals, at least 200 times finer than the noise."""
    table = np.column_stack([np.round(column, 5) + 0.0 for column in columns.values()])
    rows = [",".join([f"{value:.10g}" for value in row]) for row in table.tolist()]
    return "\n".join([",".join(columns), *rows]) + "\n"


def toml_text(vehicle: dict[str, Any]) -> str:
    """A vehicle dictionary as TOML: plain keys first, one table per effect, one entry per thruster."""
    lines = [
        f"{key} = {_value(value)}" for key, value in vehicle.items() if key not in ("effects", "thrusters")
    ]
    for name, table in vehicle["effects"].items():
        lines += ["", f"[effects.{name}]", *(f"{key} = {_value(value)}" for key, value in table.items())]
    for thruster in vehicle["thrusters"]:
        lines += ["", "[[thrusters]]", *(f"{key} = {_value(value)}" for key, value in thruster.items())]
    return "\n".join(lines) + "\n"


def _value(value: Any) -> str:
    """One TOML value: inline tables, arrays, booleans, strings, numbers."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return json.dumps(value) if isinstance(value, str) else repr(float(value))
