"""From a vehicle file to a vehicle: reading, keys and types, units, sign convention, shared values."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.resources import files
from itertools import chain
from math import inf, isclose
from pathlib import Path
from typing import Any

import sympy as sm

from undertow.errors import UndertowError, nearest, of_stated_kinds

from .catalogue import Catalogue, companions, logged_quantities, lookup, with_effects
from .effect import Effect, Surface
from .effects.control_surfaces import ControlSurfaces
from .effects.propellers import Propellers
from .effects.steering_gear import SteeringGear
from .parameter import SharedQuantity, printed
from .plausibility import SETTINGS as CHECKS
from .plausibility import check_vehicle
from .symbols import DOFS, MOTION_UNITS, POSE, VELOCITY, symbol
from .tables import (
    ParameterTable,
    VehicleTable,
    as_table,
    file_or_bundled,
    parameter_values,
    propeller_values,
    read_table,
    surface_of,
    surface_values,
    thruster_of,
)
from .units import si_of
from .vehicle import Value, Vehicle


def read_vehicle_table(path: Path) -> VehicleTable:
    """Read and validate a vehicle file."""
    return read_table(path, VehicleTable, "vehicle file")


@dataclass(frozen=True)
class Statements:
    """The numbers that the effect tables of a vehicle file state."""

    effects: Sequence[Effect]  # the effects of the file
    tables: Mapping[str, Mapping[str, Any]]  # their tables by id, as they stand in the file
    environment: Mapping[str, float]  # `rho`, kg/m^3, and `g`, m/s^2
    signs: str  # convention of the file

    @cached_property
    def _own(self) -> dict[str, dict[str, float]]:
        """Numbers that hold for the whole vehicle, SI and SNAME signs, by effect and key."""
        return {e.id: self._numbers(e) for e in self.effects if e.id in self.tables}

    def _numbers(self, effect: Effect) -> dict[str, float]:
        parameters = {p.name: p for p in effect.parameters}
        units = {n: p.unit for n, p in parameters.items()} | effect.file_units()
        found = {}
        for key, entry in self.tables[effect.id].items():
            raw = field_of(entry, "value")
            if key in units and raw is not None and not field_of(entry, "override"):
                number = si_of(f"[effects.{effect.id}] {key}", raw, units[key])
                found[key] = printed(parameters[key], number, self.signs) if key in parameters else number
        return found

    def shared(self, effect: Effect) -> dict[str, float]:
        """Values of an effect that other tables state and its own does not, by key, SI."""
        own = self.tables.get(effect.id, {})
        stated = {
            t.key: self._from_owner(t)
            for t in effect.shared_quantities
            if not {t.key, *t.unless} & own.keys()
        }
        return {k: v for k, v in stated.items() if v is not None}

    def completed(self) -> dict[str, dict[str, Any]]:
        """The tables with what each takes from others."""
        tables = {}
        for effect in self.effects:
            tables[effect.id], shared = dict(self.tables[effect.id]), self.shared(effect)
            for t in effect.shared_quantities:
                if t.key in shared:
                    source = f"taken from [effects.{t.owner}]"
                    tables[effect.id][t.key] = ParameterTable(value=shared[t.key], source=source)
        return tables

    def _from_owner(self, quantity: SharedQuantity) -> float | None:
        formula = self._formula(quantity)
        if formula is None:
            return None
        return float(formula.subs(_in_symbols({**self.environment, **self._own[quantity.owner]})))

    def _formula(self, quantity: SharedQuantity) -> sm.Expr | None:
        """The first formula whose keys are all stated; None also where the owner is not there."""
        stated = self._own.get(quantity.owner)
        if stated is None:
            return None
        known = set(map(symbol, {**self.environment, **stated}))
        return next((f for f in quantity.formulas if f.free_symbols <= known), None)

    def multiples(self) -> dict[str, tuple[str, float]]:
        """Parameters taken from others that are a multiple of one, with its name and the factor: W = g m."""
        return dict(pair for effect in self.effects for pair in self._multiples_of(effect))

    def _multiples_of(self, effect: Effect) -> Iterator[tuple[str, tuple[str, float]]]:
        open_ = {p.name for p in effect.parameters} & self.shared(effect).keys()
        for quantity in (t for t in effect.shared_quantities if t.key in open_):
            formula = self._formula(quantity)
            if formula is None:
                continue
            scaled = formula.subs(_in_symbols(self.environment))
            for other in scaled.free_symbols:
                if (factor := scaled / other).is_number:
                    yield quantity.key, (str(other), float(factor))

    def errors_of_shared(self, effect: Effect, values: Mapping[str, Value]) -> dict[str, float]:
        """Standard deviations of what an effect takes from quantities that are to be found: the weight."""
        owners = {key: (values.get(other), factor) for key, (other, factor) in self._multiples_of(effect)}
        return {
            k: abs(f) * v.sigma for k, (v, f) in owners.items() if v and v.estimate and v.sigma is not None
        }

    def differing(self) -> Iterator[str]:
        """One line for every value that another table states differently, unless marked as override."""
        for effect in self.effects:
            for key, entry in self.tables[effect.id].items():
                yield from self._difference(effect, key, entry)

    def _difference(self, effect: Effect, key: str, entry: Any) -> Iterator[str]:
        place = f"[effects.{effect.id}] {key}"
        quantity = next((t for t in effect.shared_quantities if t.key == key), None)
        meant = bool(field_of(entry, "override"))
        if quantity is None or quantity.only_if_missing:
            if meant:
                raise UndertowError(
                    f"{place} overrides nothing, since no other table states it: remove 'override'"
                )
            return
        elsewhere, raw = self._from_owner(quantity), field_of(entry, "value")
        if meant or elsewhere is None or raw is None:
            return
        value = si_of(place, raw, quantity.unit)
        if not isclose(value, elsewhere, rel_tol=quantity.rounding, abs_tol=CHECKS.zero):
            # What a fit found must fit into a file, and it may have moved what the owner states.
            names = {str(x) for formula in quantity.formulas for x in formula.free_symbols}
            entries = [entry, *(e for n, e in self.tables.get(quantity.owner, {}).items() if n in names)]
            fitted = any(field_of(e, "estimate") for e in entries)
            yield _difference_text(place, value, elsewhere, quantity, most=inf if fitted else quantity.most)


def _in_symbols(values: Mapping[str, float]) -> dict[sm.Symbol, sm.Float]:
    return {symbol(n): sm.Float(v) for n, v in values.items()}


def _difference_text(
    place: str, value: float, elsewhere: float, quantity: SharedQuantity, most: float
) -> str:
    other = f"{quantity.words or quantity.key} = {elsewhere:g} {quantity.unit} by [effects.{quantity.owner}]"
    line = f"{place} = {value:g} {quantity.unit}, but {other}"
    override = "write { value = ..., override = true } if the difference is intended"
    how = f"remove it to use the latter, or {override}"
    if max(abs(value), abs(elsewhere)) > most * min(abs(value), abs(elsewhere)):
        raise UndertowError(
            f"{line}: that is impossible for one vehicle (limit: a factor of {most:g}); {how}"
        )
    return f"{line}: {how}"


def field_of(entry: Any, name: str) -> Any:
    """A field of a parameter's entry, which is a quantity or a table; a plain quantity is its value."""
    if isinstance(entry, ParameterTable):
        return getattr(entry, name)
    if isinstance(entry, Mapping):
        return entry.get(name)
    return entry if name == "value" else None


_LOG = logging.getLogger(__name__)


def bundled_vehicles() -> dict[str, Path]:
    """Bundled vehicle files, by name."""
    folder = Path(str(files("undertow") / "vehicles"))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


@of_stated_kinds
def load_vehicle(
    source: str | Path, *, effect_files: Sequence[str | Path] = (), trust_effects: bool = False
) -> Vehicle:
    """Read a vehicle file, or a bundled vehicle by its name.

    Parameters
    ----------
    source : str or Path
        Path of a vehicle file, or the name of a bundled vehicle.
    effect_files : sequence of path
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
    known = _known_effects(table, path, [*map(Path, effect_files)], trust_effects)
    try:
        for name in table.excluded_effects:
            lookup(name, known)
        vehicle, remarks = _vehicle_and_remarks(table, known, path.parent, {})
    except UndertowError as error:
        raise UndertowError(f"{source}: {error}") from error
    for line in remarks:
        _LOG.warning("%s: %s", source, line)
    return vehicle


def resolve_vehicle(source: str | Path) -> Path:
    """The path that a user means by a path or the name of a bundled vehicle."""
    otherwise = f"vehicle '{source}' is neither a file nor a bundled vehicle"
    return file_or_bundled(source, bundled_vehicles(), otherwise)


def _known_effects(table: VehicleTable, path: Path, named: list[Path], trust: bool) -> Catalogue:
    wanted = [path.parent / name for name in table.effects_from]
    if wanted and not (named or trust):
        raise UndertowError(
            f"{path}: effects_from names {', '.join(table.effects_from)}, Python code, which undertow does "
            f"not run without your consent: pass --effects {wanted[0]} if you trust it"
        )
    # The same file under two paths is one file.
    chosen = {file.resolve(): file for file in [*named, *(wanted if trust else [])]}.values()
    return with_effects(chosen)


def vehicle_from_table(
    table: VehicleTable, known: Catalogue, folder: Path = Path(), logged: Mapping[str, str] | None = None
) -> Vehicle:
    """Build the vehicle that a validated file in a folder describes.

    `logged`: units of inputs that none of the `known` effects has to take.
    """
    return _vehicle_and_remarks(table, known, folder, logged or {})[0]


def _vehicle_and_remarks(
    table: VehicleTable, known: Catalogue, folder: Path, logged: Mapping[str, str]
) -> tuple[Vehicle, list[str]]:
    thrusters = tuple(thruster_of(t, folder) for t in table.thrusters)
    names = tuple(t.name for t in thrusters)
    surfaces = tuple(surface_of(t, names) for t in table.surfaces)
    inputs = _inputs(table.inputs, table.degrees_of_freedom, known, logged)
    found = []
    for effect_id in table.effects:
        found.append(lookup(effect_id, known)(names, surfaces, tuple(inputs)))
        if found[-1].built_in:
            where = "[[thrusters]], [[surfaces]] or generalised_forces"
            raise UndertowError(f"[effects.{effect_id}] comes with {where}: remove it")
    effects = tuple(found)
    environment = {
        "rho": si_of("water_density", table.water_density, "kg/m^3"),
        "g": si_of("gravity", table.gravity, "m/s^2"),
    }
    statements = Statements(effects, table.effects, environment, table.signs)
    tables, values = statements.completed(), dict[str, Value]()
    for effect in effects:
        values |= _effect_values(effect, tables[effect.id], table.signs)
    for effect in effects:  # tables come in any order
        if known_to := statements.errors_of_shared(effect, values):
            values |= _effect_values(effect, tables[effect.id], table.signs, known_to)
    values |= _hardware_values(table, names, surfaces, values)
    vehicle = Vehicle(
        name=table.name,
        degrees_of_freedom=tuple(sorted(table.degrees_of_freedom, key=DOFS.index)),
        effects=effects,
        values=values,
        thrusters=thrusters,
        force_channels=tuple(table.generalised_forces),
        signs=table.signs,
        environment=environment,
        surfaces=surfaces,
        inputs=inputs,
        follows=statements.multiples(),
        excluded_effects=tuple(table.excluded_effects),
    )
    vehicle = replace(vehicle, fitted_to=_fitted_to(table.history, vehicle))
    check_vehicle(vehicle)
    return vehicle, list(statements.differing())


def _inputs(
    names: Sequence[str], dofs: Sequence[str], known: Catalogue, logged: Mapping[str, str]
) -> dict[str, str]:
    """Units of the logged quantities that a file takes as inputs: those of effects, and motions left out."""
    motions = dict(zip((*POSE, *VELOCITY), (*DOFS, *DOFS), strict=True))
    left_out = {n: MOTION_UNITS[n] for n, dof in motions.items() if dof not in dofs}
    units = logged_quantities(known) | left_out | dict(logged)
    for name in names:
        if motions.get(name) in dofs:
            dof = motions[name]
            raise UndertowError(
                f"inputs names '{name}', but {dof} is a degree of freedom: remove one of them"
            )
        if name not in units:
            raise UndertowError(
                f"inputs names '{name}', which no effect reads from a log{nearest(name, units)}; "
                f"known are {', '.join(units)}"
            )
    for name, companion in companions(known).items():
        if companion in names and name not in names:
            raise UndertowError(f"inputs names '{companion}' without '{name}': name both, or neither")
    return {name: units[name] for name in names}


def _hardware_values(
    table: VehicleTable, names: tuple[str, ...], surfaces: tuple[Surface, ...], others: Mapping[str, Value]
) -> dict[str, Value]:
    """Parameters stated in the tables of propellers and surfaces."""
    effects = [cls(names, surfaces) for cls in (Propellers, ControlSurfaces, SteeringGear)]
    parameters = {p.name: p for effect in effects for p in effect.parameters}
    found: dict[str, Value] = {}
    for thruster in table.thrusters:
        found |= propeller_values(thruster, parameters, table.signs)
    for surface in table.surfaces:
        found |= surface_values(surface, parameters, table.signs)
    for name in found.keys() & others.keys():
        raise UndertowError(
            f"[[surfaces]] and [effects.{SteeringGear.id}] both state {name}: keep one of them"
        )
    return found


def _fitted_to(history: Sequence[Mapping[str, Any]], vehicle: Vehicle) -> dict[str, frozenset[str]]:
    """Hashes of the logs that values come from, by the last fit in the history that has them."""
    # A value whose source no longer names a fit was edited since.
    found: dict[str, frozenset[str]] = {}
    for entry in history:
        logs, covariance = entry.get("logs"), entry.get("covariance")
        names = covariance.get("parameters") if isinstance(covariance, Mapping) else None
        if isinstance(logs, list) and isinstance(names, list):
            read = (log for log in logs if isinstance(log, Mapping) and log.get("role") != "holdout")
            found |= dict.fromkeys(map(str, names), frozenset(str(log.get("sha256", "")) for log in read))
    known = {n for n in found if vehicle.parameter_of(n) is not None}
    return {n: found[n] for n in known if vehicle.value_of(n).source.startswith("fit to ")}


def _effect_values(
    effect: Effect, table: Mapping[str, Any], signs: str, known_to: Mapping[str, float] | None = None
) -> dict[str, Value]:
    """Values of an effect; `known_to` has standard deviations of what it takes from other tables."""
    parameters = {p.name: p for p in effect.parameters}
    aliases = effect.file_units()
    values: dict[str, Value] = {}
    for key, entry in table.items():
        if key in parameters:
            values |= parameter_values(f"[effects.{effect.id}]", parameters[key], entry, signs)
        elif key not in aliases:
            known = [*parameters, *aliases]
            listed = (", ".join(known[:12]) or "none") + (" ..." if len(known) > 12 else "")
            raise UndertowError(
                f"[effects.{effect.id}] has no parameter '{key}'{nearest(key, known)}; it has {listed}"
            )
    return values | _alias_values(effect, table, values, known_to or {})


def _alias_values(
    effect: Effect, table: Mapping[str, Any], values: Mapping[str, Value], known_to: Mapping[str, float]
) -> dict[str, Value]:
    aliases = {k: as_table(v) for k, v in table.items() if k in effect.file_units()}
    if not aliases:
        return {}
    plain = {n: v.value for n, v in values.items()}
    plain |= {k: _alias(effect, k, entry) for k, entry in aliases.items()}
    converted = effect.from_file(plain)
    source = "; ".join(dict.fromkeys(e.source for e in aliases.values() if e.source))
    assumed = any(e.assumed for e in aliases.values())
    estimated = {n: v.sigma for n, v in values.items() if v.estimate and v.sigma is not None}
    estimated |= {n: sigma for n, sigma in known_to.items() if n in values}
    sought = {
        n for k in aliases if aliases[k].estimate for n in _affected_parameters(effect, plain, converted, k)
    }
    # A mass that is to be found, at a known place, leaves its static moment to be found, too, and so does
    # its weight the righting moment.
    sought |= _propagated_sigmas(effect, plain, converted, estimated).keys()
    units, place = effect.file_units(), f"[effects.{effect.id}] sigma of"
    stated = {k: si_of(f"{place} {k}", e.sigma, units[k]) for k, e in aliases.items() if e.sigma is not None}
    sigma = _propagated_sigmas(effect, plain, converted, estimated | stated)
    new = {
        n: Value(v, estimate=n in sought, sigma=sigma.get(n), source=source, assumed=assumed)
        for n, v in converted.items()
        if n not in values
    }
    twice = [n for n, v in converted.items() if n in values and v != values[n].value]
    if twice:
        given = f"{twice[0]} and {', '.join(aliases)}"
        raise UndertowError(
            f"[effects.{effect.id}] states the same quantity twice, {given}: keep one of them"
        )
    return new


def _propagated_sigmas(
    effect: Effect, plain: Mapping[str, float], converted: Mapping[str, float], errors: Mapping[str, float]
) -> dict[str, float]:
    """Standard deviations of stated quantities, propagated from the parameters with these errors."""
    found: dict[str, float] = {}
    for name, error in errors.items():
        moved = effect.from_file({**plain, name: plain[name] + error})
        for n in converted.keys() - plain.keys():
            found[n] = math.hypot(found.get(n, 0.0), moved[n] - converted[n])
    return {n: s for n, s in found.items() if s > 0.0}


def _affected_parameters(
    effect: Effect, plain: Mapping[str, float], converted: Mapping[str, float], key: str
) -> list[str]:
    """Parameters that a key stands for among others."""
    moved = effect.from_file({**plain, key: plain[key] + 1.0})
    return [n for n, v in converted.items() if moved[n] != v]


def _alias(effect: Effect, key: str, entry: ParameterTable) -> float:
    place = f"[effects.{effect.id}] {key}"
    if entry.estimate and key not in effect.former_keys:
        ones = dict.fromkeys([*(p.name for p in effect.parameters), key], 1.0)
        base = _affected_parameters(effect, ones, effect.from_file(dict(ones)), key)
        shown = ", ".join(f"{p.name} ({p.about})" for p in effect.parameters if p.name in base)
        lines = ", ".join(f"{name} = {{ value = ..., estimate = true }}" for name in base)
        raise UndertowError(
            f"{place} cannot be estimated by itself: motion only shows {shown}; state {lines} instead"
        )
    if entry.value is None:
        raise UndertowError(f"{place} needs one 'value'")
    return si_of(place, entry.value, effect.file_units()[key])


_NO_COVARIANCE = (
    "the covariance in [[history]] is not a square matrix of finite numbers for parameters of the vehicle: "
    "correct or remove it"
)


def last_covariance(history: Sequence[Mapping[str, Any]], vehicle: Vehicle) -> tuple[list[str], Any]:
    """Parameters of the last covariance that a file's history holds, and the matrix, SI and SNAME signs.

    Empty where the file has none.
    """
    stated = next((h["covariance"] for h in reversed(history) if "covariance" in h), None)
    if stated is None:
        return [], []
    try:
        names = [str(n) for n in stated["parameters"]]
        rows = [[float(v) for v in row] for row in stated["matrix"]]
        signs = [printed(vehicle.declaration(n), 1.0, vehicle.signs) for n in names]
    except (KeyError, TypeError, ValueError) as error:
        raise UndertowError(_NO_COVARIANCE) from error
    if {len(rows), *map(len, rows)} != {len(names)} or not all(map(math.isfinite, chain(*rows))):
        raise UndertowError(_NO_COVARIANCE)
    turned = [
        [a * b * v for b, v in zip(signs, row, strict=True)] for a, row in zip(signs, rows, strict=True)
    ]
    return names, turned
