"""From a vehicle file to a vehicle: units, sign convention, physical bounds."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from undertow.errors import UndertowError

from .catalogue import Catalogue, catalogue, load_effects, lookup, merge, nearest
from .effect import Effect
from .parameter import Parameter
from .symbols import DOFS
from .units import to_si
from .vehicle import Thruster, Value, Vehicle
from .vehicle_schema import ParameterTable, ThrusterTable, VehicleTable

_LARGEST_FILE = 2_000_000


def bundled_vehicles() -> dict[str, Path]:
    """Vehicle files that come with the program, by name."""
    folder = Path(str(files("undertow") / "vehicles"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_vehicle(
    source: str | Path, *, effect_files: Iterable[Path] = (), trust_effects: bool = False
) -> Vehicle:
    """Read a vehicle file, or a bundled vehicle by its name.

    Parameters
    ----------
    source : str or Path
        Path of a vehicle file, or the name of a bundled vehicle.
    effect_files : iterable of Path
        Python files with further effects; they are executed.
    trust_effects : bool
        Execute the files that the vehicle file names in `effects_from`, too.

    Raises
    ------
    UndertowError
        If the file is missing, is not a valid vehicle file, or holds a value that cannot be.
    """
    path = resolve_vehicle(source)
    table = _parsed(path)
    known = _known_effects(table, path, list(effect_files), trust_effects)
    try:
        return vehicle_from_table(table, known)
    except UndertowError as error:
        raise UndertowError(f"{path}: {error}") from error


def resolve_vehicle(source: str | Path) -> Path:
    """The path that a user means by a path or the name of a bundled vehicle."""
    path = Path(source)
    bundled = bundled_vehicles()
    if path.is_file():
        return path
    if str(source) in bundled:
        return bundled[str(source)]
    raise UndertowError(
        f"vehicle '{source}' is neither a file nor a bundled vehicle{nearest(str(source), bundled)}; "
        f"bundled are {', '.join(bundled) or 'none'}"
    )


def _parsed(path: Path) -> VehicleTable:
    if path.stat().st_size > _LARGEST_FILE:
        raise UndertowError(f"{path}: {path.stat().st_size} bytes are too many for a vehicle file (limit {_LARGEST_FILE})")
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise UndertowError(f"{path}: not valid TOML: {error}") from error
    try:
        return VehicleTable.model_validate(content)
    except ValidationError as error:
        raise UndertowError(f"{path}: {_first_complaint(error)}") from error


def _first_complaint(error: ValidationError) -> str:
    """One line for what pydantic found first, with the nearest known key."""
    # Union members complain twice; a key that is too much is the more telling complaint.
    complaints = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    first = complaints[0]
    place = ".".join(str(p) for p in first["loc"] if p not in ("ParameterTable", "float", "int", "str"))
    place = place.replace(".schema_", ".schema")
    if first["type"] == "extra_forbidden":
        table = next((m for m in (ParameterTable, ThrusterTable) if m.__name__ in first["loc"]), None)
        if table is None:
            table = ThrusterTable if first["loc"][0] == "thrusters" else VehicleTable
        keys = [f.alias or n for n, f in table.model_fields.items()]
        return f"key '{place}' is not known{nearest(str(first['loc'][-1]), keys)}; known are {', '.join(keys)}"
    more = f" ({len(complaints) - 1} more complaints)" if len(complaints) > 1 else ""
    return f"'{place}': {first['msg']}, found {str(first['input'])[:60]!r}{more}"


def _known_effects(table: VehicleTable, path: Path, named: list[Path], trust: bool) -> Catalogue:
    wanted = [path.parent / name for name in table.effects_from]
    if wanted and not (named or trust):
        raise UndertowError(
            f"{path}: effects_from names {', '.join(table.effects_from)}, which is Python code and is not run by itself: "
            f"pass --effects {wanted[0]} if you trust it"
        )
    chosen = list(dict.fromkeys([*named, *(wanted if trust else [])]))
    return merge(catalogue(), [cls for file in chosen for cls in load_effects(file)])


def vehicle_from_table(table: VehicleTable, known: Catalogue) -> Vehicle:
    """Build the vehicle that a validated file describes."""
    thrusters = tuple(_thruster(t) for t in table.thrusters)
    names = tuple(t.name for t in thrusters)
    if len(set(names)) < len(names):
        raise UndertowError(f"two thrusters have the same name: {', '.join(names)}; rename one")
    effects = tuple(lookup(effect_id, known)(names) for effect_id in table.effects)
    values: dict[str, Value] = {}
    for effect in effects:
        values |= _effect_values(effect, table.effects[effect.id], table.signs)
    vehicle = Vehicle(
        name=table.name,
        degrees_of_freedom=tuple(d for d in DOFS if d in table.degrees_of_freedom),
        effects=effects,
        values=values,
        thrusters=thrusters,
        force_channels=tuple(table.generalised_forces),
        signs=table.signs,
        environment={"rho": to_si(table.water_density, "kg/m^3"), "g": to_si(table.gravity, "m/s^2")},
    )
    _check_complete(vehicle)
    return vehicle


def _check_complete(vehicle: Vehicle) -> None:
    for name in vehicle.parameter_names:
        parameter = vehicle.declared_parameters.get(name)
        if parameter is not None and parameter.required and name not in vehicle.values:
            owner = next(e.id for e in vehicle.effects if any(p.name == name for p in e.parameters))
            raise UndertowError(f"[effects.{owner}] lacks {name} ({parameter.about}): give it in {parameter.unit}")
    if not vehicle.mass_matrix.free_symbols:
        raise UndertowError("the vehicle has no inertia: add [effects.rigid_body]")
    for i, dof in enumerate(vehicle.degrees_of_freedom):
        if vehicle.mass_matrix[i, i] == 0:
            raise UndertowError(f"nothing has inertia in {dof}: add it to [effects.rigid_body] or leave {dof} out")


def _effect_values(effect: Effect, table: Mapping[str, Any], signs: str) -> dict[str, Value]:
    parameters = {p.name: p for p in effect.parameters}
    aliases = effect.file_units()
    values: dict[str, Value] = {}
    for key, entry in table.items():
        if key in parameters:
            values |= _parameter_values(effect.id, parameters[key], entry, signs)
        elif key not in aliases:
            known = [*parameters, *aliases]
            raise UndertowError(
                f"[effects.{effect.id}] has no parameter '{key}'{nearest(key, known)}; it has {_listing(known)}"
            )
    return values | _alias_values(effect, table, values)


def _listing(names: list[str]) -> str:
    return ", ".join(names[:12]) + (" ..." if len(names) > 12 else "") if names else "none"


def _alias_values(effect: Effect, table: Mapping[str, Any], values: Mapping[str, Value]) -> dict[str, Value]:
    aliases = {k: v for k, v in table.items() if k in effect.file_units()}
    if not aliases:
        return {}
    plain = {n: v.value for n, v in values.items()}
    sources = [e.source for e in aliases.values() if isinstance(e, ParameterTable)]
    for key, entry in aliases.items():
        if isinstance(entry, ParameterTable) and (entry.estimate or entry.sigma is not None):
            raise UndertowError(f"[effects.{effect.id}] '{key}' cannot be estimated: estimate the static moment instead")
        raw = entry.value if isinstance(entry, ParameterTable) else entry
        plain[key] = to_si(raw if raw is not None else math.nan, effect.file_units()[key])
    converted = effect.from_file(plain)
    return {n: Value(v, source="; ".join(sources)) for n, v in converted.items() if n not in values}


def _parameter_values(owner: str, parameter: Parameter, entry: Any, signs: str) -> dict[str, Value]:
    table = entry if isinstance(entry, ParameterTable) else ParameterTable(value=entry)
    given = {k: getattr(table, k) for k in ("value", "forward", "backward") if getattr(table, k) is not None}
    if set(given) == {"value"}:
        return {parameter.name: _value(owner, parameter, parameter.name, given["value"], table, signs)}
    if set(given) != {"forward", "backward"}:
        raise UndertowError(
            f"[effects.{owner}] {parameter.name} needs either 'value' or both 'forward' and 'backward', found "
            f"{' and '.join(given) or 'none'}"
        )
    if parameter.motion is None:
        raise UndertowError(f"[effects.{owner}] {parameter.name} cannot differ forward and backward: give one value")
    return {
        f"{parameter.name}_{way}": _value(owner, parameter, f"{parameter.name}_{way}", raw, table, signs)
        for way, raw in given.items()
    }


def _value(owner: str, parameter: Parameter, name: str, raw: Any, table: ParameterTable, signs: str) -> Value:
    place = f"[effects.{owner}] {name}"
    unit = "1" if parameter.unit == "command" else parameter.unit.replace("command", "1")
    try:
        printed = to_si(raw, unit)
        sigma = None if table.sigma is None else to_si(table.sigma, unit)
    except UndertowError as error:
        raise UndertowError(f"{place}: {error}") from error
    if sigma is not None and sigma <= 0:
        raise UndertowError(f"{place}: sigma = {sigma:g} is not a standard deviation: give a positive number")
    number = -printed if signs == "magnitudes" and parameter.on_left_side else printed
    _check_bounds(place, parameter, number, printed, table, signs)
    return Value(number, table.estimate, sigma, table.source, table.assumed)


def _check_bounds(
    place: str, parameter: Parameter, number: float, printed: float, table: ParameterTable, signs: str
) -> None:
    low, high = parameter.bounds
    if low <= number <= high:
        return
    one_sided = 0.0 in (low, high)
    if one_sided and table.allow_sign:
        return
    limit = f"{low:g} to {high:g} {parameter.unit} in SNAME signs"
    remedy = "correct the value"
    if one_sided:
        other = "magnitudes" if signs == "sname" else "sname"
        remedy = f"correct the sign, write signs = \"{other}\" if the whole file is meant so, or allow_sign = true"
    raise UndertowError(f"{place} = {printed:g} cannot be under signs = \"{signs}\" (possible: {limit}); {remedy}")


def _thruster(table: ThrusterTable) -> Thruster:
    place = f"thruster '{table.name}'"
    if (table.wrench is None) == (table.position is None or table.direction is None):
        raise UndertowError(f"{place} needs either 'wrench' or 'position' and 'direction'")
    wrench = tuple(float(v) for v in table.wrench) if table.wrench else _wrench_of(place, table)
    entry = table.thrust_per_command
    spec = entry if isinstance(entry, ParameterTable) else ParameterTable(value=entry)
    if spec.value is None:
        raise UndertowError(f"{place}: thrust_per_command needs a 'value'")
    per_command = Value(to_si(spec.value, "N"), spec.estimate, _sigma(spec), spec.source, spec.assumed)
    limit = None if table.limit is None else _plain(table.limit)
    return Thruster(table.name, wrench, per_command, limit)


def _sigma(spec: ParameterTable) -> float | None:
    return None if spec.sigma is None else to_si(spec.sigma, "N")


def _plain(limit: Any) -> float:
    return to_si(limit, "N") if isinstance(limit, str) and "N" in limit else to_si(limit, "1")


def _wrench_of(place: str, table: ThrusterTable) -> tuple[float, ...]:
    assert table.position is not None and table.direction is not None
    x, y, z = (to_si(v, "m") for v in table.position)
    a, b, c = (float(v) for v in table.direction)
    length = math.sqrt(a * a + b * b + c * c)
    if abs(length - 1) > 1e-3:
        raise UndertowError(f"{place}: direction has length {length:g}; give a unit vector")
    return (a, b, c, y * c - z * b, z * a - x * c, x * b - y * a)
