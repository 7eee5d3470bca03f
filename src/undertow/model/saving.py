"""From a vehicle back to its file: what has changed is rewritten, all else stays as the user wrote it."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from math import inf, isclose
from pathlib import Path
from typing import Any

import tomlkit
from pydantic import ValidationError
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import InlineTable

from undertow.errors import UndertowError
from undertow.files import write_whole

from .effect import Effect
from .entries import Wanted, stated, update_entry
from .history import append_history, fit_source, source_before
from .loading import resolve_vehicle, vehicle_from_table
from .parameter import Parameter, printed
from .taken import Statements
from .tomltext import append, append_table
from .units import si_of
from .vehicle import Value, Vehicle
from .vehicle_schema import VehicleTable
from .vehicle_toml import read_vehicle_table

_ROUND_TRIP = 1e-9


def save_vehicle(
    vehicle: Vehicle, template: str | Path, out: Path, *, history: Mapping[str, object] | None = None
) -> None:
    """Write a vehicle file that differs from `template` only in what has changed.

    Comments, order, units and the sign convention of the template are kept. A value that has changed and is
    marked as estimated counts as fitted: it becomes ``{ value, estimate, sigma, source }`` with its standard
    error as sigma. Effects and parameters that the template lacks are added.

    Parameters
    ----------
    vehicle : Vehicle
        What the file is to describe.
    template : str or Path
        The file that the vehicle came from, or the name of a bundled vehicle.
    out : Path
        The file to write; the template itself only if this is the very same path.
    history : mapping, optional
        How the values came about, appended as a table ``[[history]]``: `command`, `date`, `logs` (list of
        tables with `name`, `sha256`, `role`), `added`, `error_before`, `error_after` ... A `covariance`
        (table of `parameters` and `matrix`, SI and SNAME signs) is turned into the file's signs. One without
        `logs` is of no fit: values keep the source that the vehicle gives.

    Raises
    ------
    UndertowError
        If the template cannot be read or does not fit the vehicle, or `out` cannot be written.
    """
    path = resolve_vehicle(template)
    vehicle = _settled(vehicle, path)
    if out != path and out.exists() and out.samefile(path):
        raise UndertowError(
            f"'{out}' is the file {path} itself: choose another name, or give that path to replace it"
        )
    text = _text(vehicle, path, history)
    _check(text, vehicle, path)
    write_whole(out, text)


def _settled(vehicle: Vehicle, path: Path) -> Vehicle:
    """The same vehicle, in whose new effects what a fit cannot show is what the file tells elsewhere."""
    table = read_vehicle_table(path)
    stated = Statements(vehicle.effects, table.effects, vehicle.environment, table.signs)
    for effect in (e for e in vehicle.effects if e.id not in table.effects):
        own = {p.name: vehicle.value_of(p.name) for p in effect.parameters if p.name in vehicle.values}
        old = {n: v.value for n, v in own.items()}
        new = effect.settled(old, stated.taken(effect))
        changed = {n: v for n, v in new.items() if old.get(n) != v}
        vehicle = vehicle.with_values({n: replace(own.get(n, Value(v)), value=v) for n, v in changed.items()})
    return vehicle


def _text(vehicle: Vehicle, path: Path, history: Mapping[str, object] | None) -> str:
    signs = read_vehicle_table(path).signs  # also: nothing is changed in a file that is not understood
    try:
        document = tomlkit.parse(path.read_bytes().decode("utf-8-sig"))
    except TOMLKitError as error:
        raise UndertowError(f"{path}: cannot be edited ({error}); rewrite it in plain TOML 1.0") from error
    _write_head(document, vehicle)
    _write_effects(document, vehicle, signs, history)
    _write_thrusters(document, vehicle, history)
    if history is not None:
        append_history(document, vehicle, history, signs)
    return tomlkit.dumps(document)


def _check(text: str, vehicle: Vehicle, path: Path) -> None:
    """What is about to be written must say what the vehicle is."""
    known = {e.id: type(e) for e in vehicle.effects}
    try:
        again = vehicle_from_table(VehicleTable.model_validate(tomllib.loads(text)), known)
    except (UndertowError, ValidationError, tomllib.TOMLDecodeError) as error:
        raise UndertowError(f"{path} cannot carry the new values: {error}") from error
    for name in sorted({*vehicle.values, *again.values, *(f"thrust_{t.name}" for t in vehicle.thrusters)}):
        value, written = vehicle.value_of(name).value, again.value_of(name).value
        if not isclose(value, written, rel_tol=_ROUND_TRIP, abs_tol=1e-300):
            raise UndertowError(
                f"{path} cannot carry {name} = {value:.10g}: it would read {written:.10g}; "
                f"write the parameter by hand"
            )


def _write_head(document: Any, vehicle: Vehicle) -> None:
    if document["name"] != vehicle.name:
        document["name"] = vehicle.name
    for key, name, unit, default in (
        ("water_density", "rho", "kg/m^3", 1000.0),
        ("gravity", "g", "m/s^2", 9.81),
    ):
        raw = document.get(key, default)
        if not isclose(si_of(key, raw, unit), vehicle.environment[name], rel_tol=_ROUND_TRIP / 2):
            document[key] = stated(vehicle.environment[name], unit, raw)


def _write_effects(document: Any, vehicle: Vehicle, signs: str, history: Mapping[str, object] | None) -> None:
    tables = document["effects"]
    for gone in [i for i in tables if i not in {e.id for e in vehicle.effects}]:
        tables.remove(gone)
    for effect in vehicle.effects:
        if effect.id not in tables:
            new = tomlkit.inline_table() if isinstance(tables, InlineTable) else tomlkit.table()
            append_table(document, "effects", effect.id, new)
    # Twice: what an effect takes from one that comes later is known only when that one is written.
    for effect in (*vehicle.effects, *vehicle.effects):
        stated = Statements(vehicle.effects, document["effects"], vehicle.environment, signs)
        _write_effect(document["effects"][effect.id], effect, vehicle, stated, history)


def _write_effect(
    table: Any, effect: Effect, vehicle: Vehicle, stated: Statements, history: Mapping[str, object] | None
) -> None:
    taken = stated.taken(effect)
    told = _told_otherwise(table, effect, vehicle, taken)
    for parameter in effect.parameters:
        values = vehicle.values_of(parameter)
        if values and parameter.name not in told:
            wanted = _wanted(parameter, values, stated.signs)
            wanted = replace(wanted, override=parameter.name in taken)
            _write(table, parameter.name, wanted, f"[effects.{effect.id}] {parameter.name}", history)


def _sigmas(values: Mapping[str, Value]) -> dict[str, float]:
    """Standard deviations that say something: exact data give none, no data an endless one."""
    found = {key: v.sigma for key, v in values.items() if v.sigma is not None}
    return {key: sigma for key, sigma in found.items() if 0 < sigma < inf}


def _wanted(parameter: Parameter, values: Mapping[str, Value], signs: str) -> Wanted:
    return Wanted(
        numbers={key: printed(parameter, v.value, signs) for key, v in values.items()},
        sigmas=_sigmas(values),
        unit=parameter.unit,
        estimate=any(v.estimate for v in values.values()),
        assumed=any(v.assumed for v in values.values()),
        source="; ".join(dict.fromkeys(v.source for v in values.values() if v.source)),
    )


def _write(table: Any, key: str, wanted: Wanted, place: str, history: Mapping[str, object] | None) -> None:
    fitted = history is None or "logs" in history
    if fitted and wanted.estimate and wanted.differs(table.get(key), place):
        wanted = wanted.fitted(fit_source(history, source_before(wanted.source)))
    entry = update_entry(table.get(key), wanted, place)
    if entry is None:
        return
    if key in table:
        table[key] = entry
    else:
        append(table, key, entry)


def _told_otherwise(table: Any, effect: Effect, vehicle: Vehicle, taken: Mapping[str, float]) -> set[str]:
    """Parameters that the file rightly tells by other keys (`x_g` for `mx_g`); wrong keys are taken out."""
    units = effect.file_units()
    place = f"[effects.{effect.id}]"
    raw = {k: v if not isinstance(v, Mapping) else v["value"] for k, v in table.items() if k in units}
    own = {k: si_of(f"{place} {k}", v, units[k]) for k, v in raw.items()}
    aliases = own | {k: v for k, v in taken.items() if k in units}
    known = {*table, *taken}
    direct = {p.name: vehicle.value_of(p.name).value for p in effect.parameters if p.name in known}
    found = effect.from_file(direct | aliases) if aliases else {}
    told = {n: v for n, v in found.items() if n not in known}
    told |= {k: v for k, v in taken.items() if k not in units}
    wrong = {n for n, v in told.items() if not _still(vehicle.value_of(n), v)}
    for key in own:
        moved = effect.from_file(direct | aliases | {key: aliases[key] + 1.0})
        touched = {n for n in told if n in found and moved.get(n) != found[n]}
        if touched & wrong:
            wrong |= touched
            table.remove(key)
    return set(told) - wrong


def _still(value: Value, told: float) -> bool:
    same = isclose(value.value, told, rel_tol=_ROUND_TRIP / 2)
    return same and not value.estimate and value.sigma is None


def _write_thrusters(document: Any, vehicle: Vehicle, history: Mapping[str, object] | None) -> None:
    tables = {t["name"]: t for t in document.get("thrusters", [])}
    names = [t.name for t in vehicle.thrusters]
    if list(tables) != names:
        raise UndertowError(
            f"the thrusters of the file are {', '.join(tables) or 'none'}, those of the vehicle "
            f"{', '.join(names) or 'none'}: choose the file that the vehicle came from"
        )
    for thruster in vehicle.thrusters:
        value = thruster.thrust_per_command
        sigmas = _sigmas({"value": value})
        wanted = Wanted(
            {"value": value.value}, sigmas, "N/command", value.estimate, value.assumed, source=value.source
        )
        place = f"thruster '{thruster.name}' thrust_per_command"
        if "thrust_per_command" in tables[thruster.name] or wanted.differs(1.0, place):
            _write(tables[thruster.name], "thrust_per_command", wanted, place, history)
