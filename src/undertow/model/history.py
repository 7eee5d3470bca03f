"""How the values of a vehicle file came about, as the file itself tells it."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any

import tomlkit
from tomlkit.items import AoT

from undertow.errors import UndertowError

from .parameter import printed
from .tomltext import array_of_tables, safe
from .vehicle import Vehicle

_BEFORE = "; before: "
_FITTED = re.compile(r"(fit to .* on \S+|fitted)", re.DOTALL)
_SHOWN_LOGS = 3
_COVARIANCE_DIGITS = 6
_NO_COVARIANCE = (
    "the covariance in [[history]] is not a square matrix of finite numbers for parameters of the vehicle: "
    "correct or remove it"
)


def fit_source(history: Mapping[str, object] | None, before: str) -> str:
    """What a fitted value gives as its source: logs and date, and where the value before came from."""
    told = "fitted"
    if history and history.get("logs"):
        told = f"fit to {_log_names(history)} on {history.get('date', 'an unknown date')}"
    return f"{told}{_BEFORE}{before}" if before else told


def source_before(source: str) -> str:
    """The source of the value that was there before any fit."""
    fitted, mark, before = source.partition(_BEFORE)
    if not _FITTED.fullmatch(fitted):
        return source
    return before if mark else ""


def _log_names(history: Mapping[str, object]) -> str:
    logs = history["logs"]
    assert isinstance(logs, Sequence)
    used = [log for log in logs if not isinstance(log, Mapping) or log.get("role") != "holdout"]
    names = [str(log["name"] if isinstance(log, Mapping) else log) for log in used]
    more = f" and {len(names) - _SHOWN_LOGS} more" if len(names) > _SHOWN_LOGS else ""
    return ", ".join(names[:_SHOWN_LOGS]) + more


def append_history(document: Any, vehicle: Vehicle, entry: Mapping[str, object], signs: str) -> None:
    """Append a ``[[history]]`` table; see `save_vehicle` for what it may hold."""
    entry = dict(entry)
    covariance = entry.get("covariance")
    plain = _plain(entry)
    if isinstance(covariance, Mapping) and {"parameters", "matrix"} <= covariance.keys():
        plain["covariance"] = _covariance(vehicle, covariance, signs)
    histories = array_of_tables(document, "history")
    if isinstance(histories, AoT):
        table = _table(plain)
        table.trivia.indent = "\n" if len(histories) else ""
        histories.append(table)
    else:
        histories.append(plain)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(safe(str(k))): _plain(v) for k, v in value.items() if v is not None}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, bool | int | str):
        return safe(value)
    return float(f"{value:.10g}") if isinstance(value, float) else safe(str(value))


def _item(value: Any) -> Any:
    """Lists of lists or tables get one line for each row."""
    if isinstance(value, list) and any(isinstance(v, list | dict) for v in value):
        rows = tomlkit.array().multiline(True)
        rows.extend(_row(v) for v in value)
        return rows
    if isinstance(value, dict):
        return _table(value)
    return tomlkit.item(value)


def _table(content: Mapping[str, Any]) -> Any:
    table = tomlkit.table()
    for key, value in content.items():
        table.append(key, _item(value))
    return table


def _row(value: Any) -> Any:
    if not isinstance(value, dict):
        return tomlkit.item(value)
    row = tomlkit.inline_table()
    row.update(value)
    return row


def _covariance(vehicle: Vehicle, told: Mapping[str, Any], signs: str) -> dict[str, Any]:
    names = [str(n) for n in told["parameters"]]
    turn = [_turn(vehicle, name, signs) for name in names]
    rows = [
        [float(f"{turn[i] * turn[j] * float(v):.{_COVARIANCE_DIGITS}g}") for j, v in enumerate(row)]
        for i, row in enumerate(told["matrix"])
    ]
    return {"parameters": names, "matrix": rows}


def _turn(vehicle: Vehicle, name: str, signs: str) -> float:
    return printed(vehicle.declaration(name), 1.0, signs)


def last_covariance(history: Sequence[Mapping[str, Any]], vehicle: Vehicle) -> tuple[list[str], Any]:
    """Parameters of the last covariance that a file's history holds, and the matrix, SI and SNAME signs.

    Parameters
    ----------
    history : sequence of mapping
        The ``[[history]]`` tables.
    vehicle : Vehicle
        The vehicle of the file.

    Returns
    -------
    list of str, list of list of float
        Empty where the file has none.

    Raises
    ------
    UndertowError
        If it is no square matrix of finite numbers for parameters that the vehicle has.
    """
    told = next((h["covariance"] for h in reversed(history) if "covariance" in h), None)
    if told is None:
        return [], []
    try:
        names = [str(n) for n in told["parameters"]]
        rows = [[float(v) for v in row] for row in told["matrix"]]
        signs = [_turn(vehicle, n, vehicle.signs) for n in names]
    except (KeyError, TypeError, ValueError) as error:
        raise UndertowError(_NO_COVARIANCE) from error
    if {len(rows), *map(len, rows)} != {len(names)} or not all(isfinite(v) for row in rows for v in row):
        raise UndertowError(_NO_COVARIANCE)
    turned = [
        [a * b * v for b, v in zip(signs, row, strict=True)] for a, row in zip(signs, rows, strict=True)
    ]
    return names, turned
