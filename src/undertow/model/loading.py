"""From a vehicle file to a vehicle: units, sign convention, physical bounds."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

from undertow.errors import UndertowError

from .catalogue import Catalogue, catalogue, load_effects, lookup, merge, nearest
from .effect import Effect
from .parameter import Parameter, printed
from .plausibility import check_vehicle
from .symbols import DOFS
from .taken import Statements
from .units import si_of
from .vehicle import Thruster, Value, Vehicle
from .vehicle_schema import ParameterTable, ThrusterTable, VehicleTable
from .vehicle_toml import read_vehicle_table

_LOG = logging.getLogger(__name__)


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

    Returns
    -------
    Vehicle
        Values are in SI and SNAME signs, whatever the convention of the file.

    Raises
    ------
    UndertowError
        If the file is missing, is not a valid vehicle file, or holds an impossible value.

    Examples
    --------
    >>> import undertow as ut
    >>> ut.load_vehicle("bluerov2").velocity_names
    ('u', 'v', 'w', 'p', 'q', 'r')
    """
    path = resolve_vehicle(source)
    table = read_vehicle_table(path)
    known = _known_effects(table, path, list(effect_files), trust_effects)
    try:
        vehicle, remarks = _vehicle_and_remarks(table, known)
    except UndertowError as error:
        raise UndertowError(f"{path}: {error}") from error
    for line in remarks:
        _LOG.warning("%s: %s", path, line)
    return vehicle


def resolve_vehicle(source: str | Path) -> Path:
    """The path that a user means by a path or the name of a bundled vehicle."""
    path = Path(source)
    bundled = bundled_vehicles()
    if is_file(path):
        return path
    if str(source) in bundled:
        return bundled[str(source)]
    raise UndertowError(
        f"vehicle '{source}' is neither a file nor a bundled vehicle{nearest(str(source), bundled)}; "
        f"bundled are {', '.join(bundled) or 'none'}"
    )


def is_file(path: Path) -> bool:
    """Whether there is such a file; no for what no file can be called."""
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name that is too long for the system, or unreadable folders on the way
        return False


def _known_effects(table: VehicleTable, path: Path, named: list[Path], trust: bool) -> Catalogue:
    wanted = [path.parent / name for name in table.effects_from]
    if wanted and not (named or trust):
        raise UndertowError(
            f"{path}: effects_from names {', '.join(table.effects_from)}, Python code that is not run "
            f"by itself: pass --effects {wanted[0]} if you trust it"
        )
    # The same file under two paths is one file.
    chosen = {file.resolve(): file for file in [*named, *(wanted if trust else [])]}.values()
    return merge(catalogue(), [cls for file in chosen for cls in load_effects(file)])


def vehicle_from_table(table: VehicleTable, known: Catalogue) -> Vehicle:
    """Build the vehicle that a validated file describes.

    Raises
    ------
    UndertowError
        If it holds a value that cannot be.
    """
    return _vehicle_and_remarks(table, known)[0]


def _vehicle_and_remarks(table: VehicleTable, known: Catalogue) -> tuple[Vehicle, list[str]]:
    thrusters = tuple(_thruster(t) for t in table.thrusters)
    names = tuple(t.name for t in thrusters)
    effects = tuple(_chosen(effect_id, known)(names) for effect_id in table.effects)
    environment = {
        "rho": si_of("water_density", table.water_density, "kg/m^3"),
        "g": si_of("gravity", table.gravity, "m/s^2"),
    }
    statements = Statements(effects, table.effects, environment, table.signs)
    tables, values = statements.completed(), dict[str, Value]()
    for effect in effects:
        values |= _effect_values(effect, tables[effect.id], table.signs)
    vehicle = Vehicle(
        name=table.name,
        degrees_of_freedom=tuple(sorted(table.degrees_of_freedom, key=DOFS.index)),
        effects=effects,
        values=values,
        thrusters=thrusters,
        force_channels=tuple(table.generalised_forces),
        signs=table.signs,
        environment=environment,
    )
    check_vehicle(vehicle)
    return vehicle, list(statements.differing())


def _chosen(effect_id: str, known: Catalogue) -> type[Effect]:
    cls = lookup(effect_id, known)
    if cls.built_in:
        raise UndertowError(
            f"[effects.{effect_id}] comes with [[thrusters]] and generalised_forces: remove the table"
        )
    return cls


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
                f"[effects.{effect.id}] has no parameter '{key}'{nearest(key, known)}; "
                f"it has {_listing(known)}"
            )
    return values | _alias_values(effect, table, values)


def _listing(names: list[str]) -> str:
    return ", ".join(names[:12]) + (" ..." if len(names) > 12 else "") if names else "none"


def _alias_values(effect: Effect, table: Mapping[str, Any], values: Mapping[str, Value]) -> dict[str, Value]:
    aliases = {k: _as_table(v) for k, v in table.items() if k in effect.file_units()}
    if not aliases:
        return {}
    plain = {n: v.value for n, v in values.items()}
    plain |= {k: _alias(effect, k, entry) for k, entry in aliases.items()}
    converted = effect.from_file(plain)
    source = "; ".join(dict.fromkeys(e.source for e in aliases.values() if e.source))
    assumed = any(e.assumed for e in aliases.values())
    sigma = _carried_over(effect, plain, converted, values)
    new = {
        n: Value(v, estimate=n in sigma, sigma=sigma.get(n), source=source, assumed=assumed)
        for n, v in converted.items()
        if n not in values
    }
    twice = [n for n, v in converted.items() if n in values and v != values[n].value]
    if twice:
        given = f"{twice[0]} and {', '.join(aliases)}"
        raise UndertowError(f"[effects.{effect.id}] says the same thing twice, by {given}: keep one of them")
    return new


def _carried_over(
    effect: Effect,
    plain: Mapping[str, float],
    converted: Mapping[str, float],
    values: Mapping[str, Value],
) -> dict[str, float]:
    """Standard deviations of what a file tells by way of others.

    A mass that is to be found, at a known place, leaves its static moment to be found, too.
    """
    found: dict[str, float] = {}
    for name, value in values.items():
        if value.estimate and value.sigma is not None:
            moved = effect.from_file({**plain, name: value.value + value.sigma})
            for n in set(converted) - set(values):
                found[n] = math.hypot(found.get(n, 0.0), moved[n] - converted[n])
    return {n: s for n, s in found.items() if s > 0.0}


def _alias(effect: Effect, key: str, entry: ParameterTable) -> float:
    place = f"[effects.{effect.id}] {key}"
    if entry.estimate or entry.sigma is not None:
        raise UndertowError(f"{place} cannot be estimated: estimate the static moment instead")
    if entry.value is None:
        raise UndertowError(f"{place} needs one 'value'")
    return si_of(place, entry.value, effect.file_units()[key])


def _as_table(entry: Any) -> ParameterTable:
    return entry if isinstance(entry, ParameterTable) else ParameterTable(value=entry)


def _parameter_values(owner: str, parameter: Parameter, entry: Any, signs: str) -> dict[str, Value]:
    table = _as_table(entry)
    given = {k: getattr(table, k) for k in ("value", "forward", "backward") if getattr(table, k) is not None}
    _refuse_idle_sigmas(f"[effects.{owner}] {parameter.name}", table, len(given))
    if set(given) == {"value"}:
        return {parameter.name: _value(owner, parameter, parameter.name, given["value"], table, signs)}
    if set(given) != {"forward", "backward"}:
        raise UndertowError(
            f"[effects.{owner}] {parameter.name} needs either 'value' or both 'forward' and 'backward', "
            f"found {' and '.join(given) or 'none'}"
        )
    if parameter.motion is None:
        raise UndertowError(
            f"[effects.{owner}] {parameter.name} cannot differ forward and backward: give one value"
        )
    return {
        f"{parameter.name}_{way}": _value(
            owner, parameter, f"{parameter.name}_{way}", raw, table.one_way(way), signs
        )
        for way, raw in given.items()
    }


def _refuse_idle_sigmas(place: str, table: ParameterTable, values: int) -> None:
    """A standard deviation that another one makes idle, or that belongs to a value that is not there."""
    own = [s for s in (table.sigma_forward, table.sigma_backward) if s is not None]
    if own and (values < 2 or (len(own) == 2 and table.sigma is not None)):
        raise UndertowError(
            f"{place} has a sigma that holds for nothing: give 'sigma', or with 'forward' and 'backward' "
            f"'sigma_forward' and 'sigma_backward'"
        )


def _value(owner: str, parameter: Parameter, name: str, raw: Any, table: ParameterTable, signs: str) -> Value:
    place = f"[effects.{owner}] {name}"
    stated = si_of(place, raw, parameter.unit)
    sigma = None if table.sigma is None else _positive(f"{place} sigma", table.sigma, parameter.unit)
    number = printed(parameter, stated, signs)
    _check_bounds(place, parameter, number, stated, table, signs)
    return Value(number, table.estimate, sigma, table.source, table.assumed)


def _check_bounds(
    place: str, parameter: Parameter, number: float, stated: float, table: ParameterTable, signs: str
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
        remedy = (
            f'correct the sign, write signs = "{other}" if the whole file is meant so, or allow_sign = true'
        )
    raise UndertowError(
        f'{place} = {stated:g} cannot be under signs = "{signs}" (possible: {limit}); {remedy}'
    )


def _thruster(table: ThrusterTable) -> Thruster:
    place = f"thruster '{table.name}'"
    given = table.wrench is not None
    if {table.position is not None, table.direction is not None} != {not given}:
        raise UndertowError(f"{place} needs either 'wrench' or 'position' and 'direction', not both")
    wrench = _numbers(f"{place} wrench", table.wrench) if given else _wrench_of(place, table)
    if not any(wrench):
        raise UndertowError(f"{place} wrench is zero: give the force and moment of one newton of thrust")
    return Thruster(table.name, wrench, _thrust_per_command(place, table), _limit(place, table.limit))


def _thrust_per_command(place: str, table: ThrusterTable) -> Value:
    place = f"{place} thrust_per_command"
    spec = _as_table(table.thrust_per_command)
    if spec.value is None:
        raise UndertowError(f"{place} needs a 'value'")
    value = si_of(place, spec.value, "N/command")
    if value < 0:  # none at rest is right for a rudder or a fin: what it gives is rudder_force
        raise UndertowError(f"{place} = {value:g} N cannot be: give a positive thrust and turn the direction")
    sigma = None if spec.sigma is None else _positive(f"{place} sigma", spec.sigma, "N/command")
    return Value(value, spec.estimate, sigma, spec.source, spec.assumed)


def _limit(place: str, limit: Any) -> float | None:
    if limit is None:
        return None
    # Where the command is the thrust itself, its limit is naturally written in N.
    in_newton = isinstance(limit, str) and "N" in limit
    return _positive(f"{place} limit", limit, "N" if in_newton else "command")


def _positive(place: str, raw: Any, unit: str) -> float:
    value = si_of(place, raw, unit)
    if value <= 0:
        raise UndertowError(f"{place} = {value:g} cannot be: give a positive number")
    return value


def _numbers(place: str, entries: Iterable[Any] | None) -> tuple[float, ...]:
    return tuple(si_of(place, entry, "1") for entry in entries or ())


def _wrench_of(place: str, table: ThrusterTable) -> tuple[float, ...]:
    assert table.position is not None
    assert table.direction is not None
    x, y, z = (si_of(f"{place} position", v, "m") for v in table.position)
    a, b, c = _numbers(f"{place} direction", table.direction)
    length = math.hypot(a, b, c)
    if abs(length - 1) > 1e-3:
        raise UndertowError(f"{place}: direction has length {length:g}; give a unit vector")
    return (a, b, c, y * c - z * b, z * a - x * c, x * b - y * a)
