"""From a vehicle back to its file: changes are rewritten, all else is left untouched."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isclose
from os.path import relpath
from pathlib import Path
from typing import Any

import tomlkit
from pydantic import ValidationError
from tomlkit.exceptions import TOMLKitError
from tomlkit.items import AoT, InlineTable, Table, Whitespace

from undertow.errors import UndertowError
from undertow.files import write_whole

from .effect import Effect
from .loading import Statements, read_vehicle_table, resolve_vehicle, vehicle_from_table
from .parameter import Parameter, printed
from .symbols import ENVIRONMENT
from .tables import (
    PROPELLER_KEYS,
    SURFACE_KEYS,
    VehicleTable,
    bundled_curves,
    propeller_values,
    surface_values,
)
from .units import si_of, si_unit, unit_of
from .vehicle import Value, Vehicle


def safe(value: Any) -> Any:
    """A value that can be written: undecodable characters become question marks."""
    if isinstance(value, str):
        return str(value).encode("utf-8", "replace").decode("utf-8")
    return value


def append(table: Any, key: str, item: Any) -> None:
    """Add a key at the end of a table, before the comment that belongs to what follows the table."""
    tail = _detach_tail(table)
    table.append(key, item)
    if tail:
        table.value.body.extend(tail)


def append_table(document: Any, parent: str, key: str, table: Any) -> None:
    """Add a table ``[parent.key]`` after the last one of its kind."""
    parents = document[parent]
    if isinstance(parents, InlineTable):
        parents.append(key, table)
    elif isinstance(parents, Table):
        tail = _detach_tail(_last(parents))
        parents.append(key, table)
        if isinstance(table, Table):
            table.value.body.extend(tail or [(None, Whitespace("\n"))])
    else:  # several places of the file add to it
        outer = tomlkit.table(is_super_table=True)
        outer.append(key, table)
        document.append(parent, outer)


def _last(table: Any) -> Any:
    """The table that stands last inside a table, or the table itself."""
    inner = [v for _, v in table.value.body if isinstance(v, Table)]
    return _last(inner[-1]) if inner else table


def _detach_tail(table: Any) -> list[Any]:
    """Take off what stands after the first blank line behind the last key."""
    if not isinstance(table, Table):
        return []
    body = table.value.body
    end = max((i + 1 for i, (key, _) in enumerate(body) if key is not None), default=0)
    blank = next((i for i in range(end, len(body)) if isinstance(body[i][1], Whitespace)), len(body))
    tail = body[blank:]
    del body[blank:]
    return tail


def array_of_tables(document: Any, key: str) -> Any:
    """The array ``[[key]]`` of a document, made at its end where there is none."""
    if key not in document:
        document.append(None, Whitespace("\n"))
        document.append(key, AoT([]))
    return document[key]


@dataclass(frozen=True)
class SavingSettings:
    """How vehicle files are written."""

    # Relative difference of numbers that are the same when written. Ten significant digits are written, which
    # is half of this at worst.
    rounding: float = 1e-9
    named_logs: int = 3  # that the source of a fitted value names
    covariance_digits: int = 6  # significant digits of a covariance


SETTINGS = SavingSettings()
_ORDER = (
    *("value", "forward", "backward", "assumed", "estimate", "per_run"),
    *("sigma", "sigma_forward", "sigma_backward", "allow_sign", "override", "source"),
)
# Files say "kg m^2" where an effect declares "N m/((rad/s)^2)".
_RADIANS = re.compile(r"/rad(\^\d)?")
_QUANTITIES = ("value", "forward", "backward", "sigma", "sigma_forward", "sigma_backward")


@dataclass(frozen=True)
class Entry:
    """Content of an entry, SI and in the signs of the file."""

    numbers: Mapping[str, float]  # the value by its key: "value", or "forward" and "backward"
    sigmas: Mapping[str, float]  # standard deviations by the same keys
    unit: str  # SI unit of the parameter
    estimate: bool = False
    assumed: bool = False
    per_run: bool | None = None  # whether it has a value in every run; None: the file need not say
    override: bool = False  # whether it has to say that another table states something else
    source: str = ""

    def fitted(self, source: str) -> Entry:
        """The same with a new source, which is no assumption."""
        return replace(self, source=source, assumed=False)

    def quantities(self) -> dict[str, float]:
        """Numbers and standard deviations by their keys in the file."""
        if len({*self.sigmas.values()}) == 1 and len(self.sigmas) == len(self.numbers):
            return {**self.numbers, "sigma": next(iter(self.sigmas.values()))}
        own = {"sigma" if key == "value" else f"sigma_{key}": v for key, v in self.sigmas.items()}
        return {**self.numbers, **own}

    def differs(self, raw: Any, place: str) -> bool:
        """Whether an entry of the file says other numbers."""
        old, new = _fields(raw), self.quantities()
        present = {k for k in _QUANTITIES if k in old}
        return present != set(new) or not all(_same_number(old[k], new[k], self.unit, place) for k in new)


def update_entry(raw: Any, wanted: Entry, place: str) -> Any:
    """The new entry in place of the one in the file (None if there is none), or None if it can stay.

    A table is changed in place and keeps whatever else it says.
    """
    old, changed = _fields(raw), wanted.differs(raw, place)
    fields = _changed_fields(old, wanted, place) if changed else {}
    if wanted.estimate != bool(old.get("estimate", False)):
        fields["estimate"] = wanted.estimate or None
    if wanted.per_run != old.get("per_run"):
        fields["per_run"] = wanted.per_run
    if raw is not None and not fields:
        return None
    if isinstance(raw, Mapping):
        return _updated(raw, fields)
    fields = {k: v for k, v in (old | fields).items() if v is not None}
    return fields["value"] if set(fields) == {"value"} else _inline(fields)


def _changed_fields(old: Mapping[str, Any], wanted: Entry, place: str) -> dict[str, Any]:
    """Keys with their new values, None for those that go."""
    like = _style_of(old, wanted.unit)
    new = wanted.quantities()
    gone = {k: None for k in _QUANTITIES if k in old and k not in new}
    written = {
        k: stated(number, wanted.unit, old.get(k, like))
        for k, number in new.items()
        if k not in old or not _same_number(old[k], number, wanted.unit, place)
    }
    numbers = {k: v for k, v in written.items() if k in wanted.numbers}
    estimate = {"estimate": True} if wanted.estimate else {}
    sigmas = {k: v for k, v in written.items() if k not in numbers}
    source = {"source": wanted.source} if wanted.source else {}
    assumed = {"assumed": True if wanted.assumed else None} if wanted.assumed or "assumed" in old else {}
    override = {"override": True} if wanted.override else {}
    return gone | numbers | estimate | sigmas | source | assumed | override


def _fields(raw: Any) -> dict[str, Any]:
    if raw is None:
        return {}
    return dict(raw) if isinstance(raw, Mapping) else {"value": raw}


def _same_number(raw: Any, number: float, unit: str, place: str) -> bool:
    return isclose(si_of(place, raw, unit), number, rel_tol=SETTINGS.rounding / 2)


def _style_of(old: Mapping[str, Any], unit: str) -> Any:
    """A quantity whose style a new one follows: one of the same entry, or the SI unit."""
    first = next((old[k] for k in _QUANTITIES if k in old), None)
    if first is not None:
        return first
    if unit == "1" or "command" in unit:
        return 1.0
    return f"1 {_RADIANS.sub('', si_unit(unit)).replace('*', ' ') if '(' in unit else unit}"


def stated(number: float, unit: str, like: Any) -> str | float:
    """A number in the SI unit `unit` with ten digits, as the quantity `like` is written."""
    if not isinstance(like, str):
        return float(f"{number:.10g}")
    found = unit_of(like)
    return f"{number / si_of(like, f'1{found}', unit):.10g}{found}"


def _updated(entry: Any, fields: Mapping[str, Any]) -> Any:
    if isinstance(entry, InlineTable):  # made anew: taking keys out of one leaves its spaces behind
        return _inline({k: v for k, v in {**entry, **fields}.items() if v is not None})
    for key, value in fields.items():
        if value is not None:
            entry[key] = safe(value)
        elif key in entry:
            entry.remove(key)
    return entry


def _inline(fields: Mapping[str, Any]) -> Any:
    ordered = sorted(fields, key=lambda k: _ORDER.index(k) if k in _ORDER else len(_ORDER))
    texts = (f"{k} = {tomlkit.item(safe(fields[k])).as_string()}" for k in ordered)
    return tomlkit.value(f"{{ {', '.join(texts)} }}")


_BEFORE = "; before: "
_FITTED = re.compile(r"(fit to .* on \S+|fitted)", re.DOTALL)


def fit_source(history: Mapping[str, object] | None, before: str, *, mean: bool = False) -> str:
    """Source text of a fitted value: logs and date, and the source of the value before.

    `mean` says that it is the mean of values by run, which stand in the history.
    """
    text = "fitted"
    if history and history.get("logs"):
        whole = " (mean of the runs)" if mean else ""
        text = f"fit to {_log_names(history)}{whole} on {history.get('date', 'an unknown date')}"
    return f"{text}{_BEFORE}{before}" if before else text


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
    most = SETTINGS.named_logs
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


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


def _covariance(vehicle: Vehicle, stated: Mapping[str, Any], signs: str) -> dict[str, Any]:
    names = [str(n) for n in stated["parameters"]]
    turn = [printed(vehicle.declaration(name), 1.0, signs) for name in names]
    rows = [
        [float(f"{turn[i] * turn[j] * float(v):.{SETTINGS.covariance_digits}g}") for j, v in enumerate(row)]
        for i, row in enumerate(stated["matrix"])
    ]
    return {"parameters": names, "matrix": rows}


def save_vehicle(
    vehicle: Vehicle, template: str | Path, out: Path, *, history: Mapping[str, object] | None = None
) -> None:
    """Write a vehicle file that differs from `template` only in what has changed.

    Comments, order, units and the sign convention of the template are kept. A value that has changed and is
    marked as estimated counts as fitted: it becomes ``{ value, estimate, sigma, source }`` with its standard
    error as sigma. Effects and parameters that the template lacks are added.

    `history` records the origin of the values, appended as a table ``[[history]]``: `command`, `date`, `logs`
    (list of tables with `name`, `sha256`, `role`), `added`, `error_before`, `error_after` ... A `covariance`
    (table of `parameters` and `matrix`, SI and SNAME signs) is turned into the file's signs. Without `logs`
    it is not from a fit: values keep the source that the vehicle gives.
    """
    write_whole(out, rewritten(vehicle, template, out, history=history))


def rewritten(
    vehicle: Vehicle, template: str | Path, out: Path, *, history: Mapping[str, object] | None = None
) -> str:
    """The text that `save_vehicle` writes, with its refusals: for trying before the work is done."""
    path = resolve_vehicle(template)
    table = read_vehicle_table(path)  # also: nothing is changed in a file that is not understood
    vehicle = _reconciled(vehicle, table)
    if out != path and out.exists() and out.samefile(path):
        raise UndertowError(
            f"'{out}' is the file {path} itself: choose another name, or give that path to replace it"
        )
    text = _file_text(vehicle, table, path, history, out.parent)
    _check(text, vehicle, path, out.parent)
    return text


def _reconciled(vehicle: Vehicle, table: VehicleTable) -> Vehicle:
    """The same vehicle; values in new effects that no fit can determine agree with its other tables."""
    stated = Statements(vehicle.effects, table.effects, vehicle.environment, table.signs)
    for effect in (e for e in vehicle.effects if e.id not in table.effects):
        own = {p.name: vehicle.value_of(p.name) for p in effect.parameters if p.name in vehicle.values}
        old = {n: v.value for n, v in own.items()}
        new = effect.reconciled(old, stated.shared(effect))
        changed = {n: v for n, v in new.items() if old.get(n) != v}
        vehicle = vehicle.with_values({n: replace(own.get(n, Value(v)), value=v) for n, v in changed.items()})
    return vehicle


def _file_text(
    vehicle: Vehicle, table: VehicleTable, path: Path, history: Mapping[str, object] | None, folder: Path
) -> str:
    try:
        document = tomlkit.parse(path.read_bytes().decode("utf-8-sig"))
    except TOMLKitError as error:
        raise UndertowError(f"{path}: cannot be edited ({error}); rewrite it in plain TOML 1.0") from error
    _write_head(document, vehicle)
    _write_effects(document, vehicle, table.signs, history)
    _write_thrusters(document, vehicle, history)
    for thruster in document.get("thrusters", []):
        own = isinstance(thruster.get("curve"), str) and thruster["curve"] not in bundled_curves()
        if own and folder.resolve() != path.parent.resolve():
            thruster["curve"] = relpath(path.parent / thruster["curve"], folder)
    _write_hardware(document, vehicle, table, history)
    if history is not None:
        append_history(document, vehicle, history, table.signs)
    return tomlkit.dumps(document)


def _check(text: str, vehicle: Vehicle, path: Path, folder: Path) -> None:
    """Check that the text to be written describes the vehicle."""
    known = {e.id: type(e) for e in vehicle.effects}
    try:
        table = VehicleTable.model_validate(tomllib.loads(text))
        again = vehicle_from_table(table, known, folder, vehicle.inputs)
    except (UndertowError, ValidationError, tomllib.TOMLDecodeError) as error:
        raise UndertowError(f"{path} cannot carry the new values: {error}") from error
    for name in sorted({*vehicle.values, *again.values, *(f"thrust_{t.name}" for t in vehicle.thrusters)}):
        value, written = vehicle.value_of(name).value, again.value_of(name).value
        if not isclose(value, written, rel_tol=SETTINGS.rounding, abs_tol=1e-300):
            raise UndertowError(
                f"{path} cannot carry {name} = {value:.10g}: it would read {written:.10g}; "
                f"write the parameter by hand"
            )


def _write_head(document: Any, vehicle: Vehicle) -> None:
    if document["name"] != vehicle.name:
        document["name"] = vehicle.name
    for key, name, unit, default in (
        ("water_density", "rho", "kg/m^3", ENVIRONMENT.density),
        ("gravity", "g", "m/s^2", ENVIRONMENT.gravity),
    ):
        raw = document.get(key, default)
        if not isclose(si_of(key, raw, unit), vehicle.environment[name], rel_tol=SETTINGS.rounding / 2):
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
    shared = stated.shared(effect)
    derived = _derived_elsewhere(table, effect, vehicle, shared)
    for parameter in effect.parameters:
        values = vehicle.values_of(parameter)
        if values and parameter.name not in derived:
            wanted = _entry_of(parameter, values, stated.signs)
            wanted = replace(wanted, override=parameter.name in shared)
            _write(table, parameter.name, wanted, f"[effects.{effect.id}] {parameter.name}", history)


def _entry_of(parameter: Parameter, values: Mapping[str, Value], signs: str) -> Entry:
    sigmas = {key: v.sigma for key, v in values.items() if v.sigma is not None}
    return Entry(
        numbers={key: printed(parameter, v.value, signs) for key, v in values.items()},
        sigmas={key: s for key, s in sigmas.items() if 0 < s < inf},  # exact data give zero, no data inf
        unit=parameter.unit,
        estimate=any(v.estimate for v in values.values()),
        assumed=any(v.assumed for v in values.values()),
        per_run=next((v.per_run for v in values.values()), None),
        source="; ".join(dict.fromkeys(v.source for v in values.values() if v.source)),
    )


def _write(table: Any, key: str, wanted: Entry, place: str, history: Mapping[str, object] | None) -> None:
    fitted = history is None or "logs" in history
    if fitted and wanted.estimate and wanted.differs(table.get(key), place):
        before = source_before(wanted.source)
        wanted = wanted.fitted(fit_source(history, before, mean=bool(wanted.per_run)))
    entry = update_entry(table.get(key), wanted, place)
    if entry is None:
        return
    if key in table:
        table[key] = entry
    else:
        append(table, key, entry)


def _derived_elsewhere(table: Any, effect: Effect, vehicle: Vehicle, shared: Mapping[str, float]) -> set[str]:
    """Parameters that the file rightly states by other keys (`x_g` for `mx_g`); wrong keys are taken out."""
    units = effect.file_units()
    place = f"[effects.{effect.id}]"
    raw = {k: v if not isinstance(v, Mapping) else v["value"] for k, v in table.items() if k in units}
    own = {k: si_of(f"{place} {k}", v, units[k]) for k, v in raw.items()}
    aliases = own | {k: v for k, v in shared.items() if k in units}
    known = {*table, *shared}
    direct = {p.name: vehicle.value_of(p.name).value for p in effect.parameters if p.name in known}
    found = effect.from_file(direct | aliases) if aliases else {}
    derived = {n: v for n, v in found.items() if n not in known}
    derived |= {k: v for k, v in shared.items() if k not in units}
    wrong = set()
    for name, number in derived.items():
        value = vehicle.value_of(name)
        same = isclose(value.value, number, rel_tol=SETTINGS.rounding / 2)
        if not same or value.estimate or value.sigma is not None:
            wrong.add(name)
    for key in own:
        moved = effect.from_file(direct | aliases | {key: aliases[key] + 1.0})
        touched = {n for n in derived if n in found and moved.get(n) != found[n]}
        if touched & wrong:
            wrong |= touched
            table.remove(key)
    return set(derived) - wrong


def _write_thrusters(document: Any, vehicle: Vehicle, history: Mapping[str, object] | None) -> None:
    tables = {t["name"]: t for t in document.get("thrusters", [])}
    names = [t.name for t in vehicle.thrusters]
    if list(tables) != names:
        raise UndertowError(
            f"the thrusters of the file are {', '.join(tables) or 'none'}, those of the vehicle "
            f"{', '.join(names) or 'none'}: choose the file that the vehicle came from"
        )
    for thruster in vehicle.thrusters:
        parameter = vehicle.declaration(f"thrust_{thruster.name}")
        wanted = _entry_of(parameter, {"value": thruster.thrust_per_command}, "sname")
        place = f"thruster '{thruster.name}' thrust_per_command"
        if "thrust_per_command" in tables[thruster.name] or wanted.differs(1.0, place):
            _write(tables[thruster.name], "thrust_per_command", wanted, place, history)


def _write_hardware(
    document: Any, vehicle: Vehicle, file: VehicleTable, history: Mapping[str, object] | None
) -> None:
    """Changed parameters that the tables of propellers and control surfaces state."""
    elsewhere = {p.name for effect in vehicle.effects for p in effect.parameters}
    known = vehicle.declared_parameters
    parts: list[tuple[Any, str, dict[str, str], dict[str, Value]]] = []
    for table, propelled in zip(document.get("thrusters", []), file.thrusters, strict=True):
        keys = dict(zip(PROPELLER_KEYS, PROPELLER_KEYS, strict=True)) if propelled.propeller else {}
        stated = propeller_values(propelled, known, file.signs)
        parts.append((table.get("propeller"), propelled.name, keys, stated))
    for table, surface in zip(document.get("surfaces", []), file.surfaces, strict=True):
        parts.append((table, surface.name, SURFACE_KEYS, surface_values(surface, known, file.signs)))
    for table, owner, keys, stated in parts:
        for key, short in keys.items():
            name = f"{short}_{owner}"
            value = vehicle.values.get(name)
            if value is not None and name not in elsewhere and value != stated.get(name):
                wanted = _entry_of(vehicle.declaration(name), {"value": value}, file.signs)
                _write(table, key, wanted, f"{key} of '{owner}'", history)
