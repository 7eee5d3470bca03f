"""What generated code was made from, and what has changed since."""

from __future__ import annotations

import json
import logging
import re
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from itertools import chain
from math import isclose
from pathlib import Path

import casadi as ca
from pydantic import TypeAdapter

from undertow.errors import UndertowError
from undertow.files import json_ready
from undertow.model.symbols import FORCE, FORCE_UNITS, MOTION_UNITS
from undertow.model.tables import Printable
from undertow.version import __version__

from .functions import Functions
from .source import digest

_log = logging.getLogger(__name__)
SCHEMA = "undertow/codegen/2"


@dataclass(frozen=True)
class EquivalenceSettings:
    """How functions are compared with those of another version, and dead times with whole samples."""

    points: int = 5
    least: float = 0.2  # size of a coordinate of a point, SI; the largest is 1
    same: float = 1e-9  # difference of values, relative to the largest, that is rounding
    whole_samples: float = 1e-9  # share by which a dead time may miss whole samples


EQUIVALENCE = EquivalenceSettings()
UNITS = MOTION_UNITS | {f"tau_{f}": unit for f, unit in zip(FORCE, FORCE_UNITS, strict=True)}
"""Of pose, velocity and forces by name."""
_UNITS = UNITS | {"rho": "kg/m^3", "g": "m/s^2"}


@dataclass(frozen=True)
class Entry:
    """One state, input or parameter."""

    # name, unit: what it is and what it is measured in
    name: Printable
    unit: Printable
    value: float | None = None  # value of a parameter in the vehicle file, SI and SNAME signs


@dataclass(frozen=True)
class Manifest:
    """A model as its generated code stands for it."""

    vehicle: Printable  # name of the vehicle
    effects: tuple[Printable, ...]  # ids of the effects
    # states, inputs, parameters: entries of x, u and p in order
    states: tuple[Entry, ...]
    inputs: tuple[Entry, ...]
    parameters: tuple[Entry, ...]
    input_delay: float  # dead time of the inputs, s, which the caller has to provide
    # dead time of the outputs that are reported late, s, by name, which the caller has to provide, too
    output_delay: Mapping[Printable, float]
    # Values of every row of the equations of motion at fixed points. They tell an equation from another one
    # whatever way it is written, and do not change when a parameter moves to another place in p.
    rows: Mapping[Printable, tuple[float, ...]]

    def to_json(self, files: Mapping[str, str], compiler: str) -> str:
        """Text of the manifest file, with hashes of the generated files, and the compiler for the record."""
        hashes = {name: digest(text) for name, text in files.items()}
        versions = {"undertow": __version__, "casadi": ca.__version__, "compiler": compiler}
        content = {"schema": SCHEMA, **versions, **asdict(self), "files": hashes}
        # A thrust without a limit is limited by the word "inf": JSON has no such number.
        return json.dumps(json_ready(content, str), indent=1, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> tuple[Manifest, dict[str, str]]:
        """The manifest and the hashes of the files beside it."""
        try:
            content = json.loads(text)
            if content["schema"] != SCHEMA:
                raise UndertowError(f"schema '{content['schema']}' is not {SCHEMA}: generate the code again")
            found = TypeAdapter(cls).validate_python(content)
            return found, TypeAdapter(dict[Printable, str]).validate_python(content["files"])
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise UndertowError(f"not a manifest of generated code ({error}): generate it again") from error


# --- describing -----------------------------------------------------------------------------------


def describe(functions: Functions) -> Manifest:
    """The manifest of a model."""
    vehicle, (input_delay, output_delay) = functions.vehicle, functions.late()
    return Manifest(
        vehicle=vehicle.name,
        effects=tuple(e.id for e in vehicle.effects),
        states=tuple(Entry(n, _state_unit(functions, n)) for n in functions.state_names),
        inputs=tuple(Entry(n, unit) for n, unit in vehicle.command_units.items()),
        parameters=numbers_of(functions),
        input_delay=input_delay,
        output_delay=output_delay,
        rows=_rows(functions),
    )


def numbers_of(functions: Functions) -> tuple[Entry, ...]:
    """What functions are given as p, with the values of the vehicle."""
    pairs = zip(functions.number_names, functions.values(), strict=True)
    return tuple(Entry(n, _parameter_unit(functions, n), v) for n, v in pairs)


def whole_samples(seconds: float, dt: float) -> int:
    """The samples nearest to a dead time, with a warning where they are not the same time."""
    count = round(seconds / dt)
    if abs(count * dt - seconds) > EQUIVALENCE.whole_samples * seconds:
        _log.warning("a dead time of %g s is taken as %d samples of %g s", seconds, count, dt)
    return count


def _state_unit(functions: Functions, name: str) -> str:
    if name in _UNITS:
        return _UNITS[name]
    owned = chain.from_iterable(
        zip(e.states, e.state_units, strict=True) for e in functions.vehicle.all_effects
    )
    return dict(owned).get(name, "")


def _parameter_unit(functions: Functions, name: str) -> str:
    found = functions.vehicle.parameter_of(name)
    units = _UNITS | {n.name: n.unit for n in functions.hardware}
    return found.unit if found else units.get(name, "")


def _rows(functions: Functions) -> dict[str, tuple[float, ...]]:
    arguments = [functions.x, functions.nu_dot, functions.u, functions.numbers, functions.t]
    evaluate = ca.Function("balance", arguments, [ca.densify(functions.balance)])
    vehicle = functions.vehicle
    accelerations = [f"{n}_dot" for n in vehicle.velocity_names]
    moving = [functions.state_names, accelerations, vehicle.command_names, functions.number_names, ["t"]]
    columns = [
        evaluate(*([_coordinate(n, k, signed=i < 3) for n in names] for i, names in enumerate(moving)))
        for k in range(EQUIVALENCE.points)
    ]
    table = ca.horzcat(*columns).full()
    return {f"{n}_dot": tuple(map(float, row)) for n, row in zip(functions.state_names, table, strict=True)}


def _coordinate(name: str, point: int, *, signed: bool) -> float:
    """A number between 0.2 and 1 that belongs to a name; motions and commands go both ways."""
    share = int(digest(f"{name}/{point}")[:12], 16) / 16**12
    return (EQUIVALENCE.least + (1 - EQUIVALENCE.least) * share) * (-1 if signed and point % 2 else 1)


# --- comparing ------------------------------------------------------------------------------------


def changes(old: Manifest, new: Manifest) -> list[str]:
    """What has changed, a line for each kind of thing; nothing where generated code may stay."""
    lines = [f"vehicle: {old.vehicle} -> {new.vehicle}"] if old.vehicle != new.vehicle else []
    lines += _membership("effects", old.effects, new.effects)
    for what in ("states", "inputs", "parameters"):
        before, after = getattr(old, what), getattr(new, what)
        lines += _membership(what, _names(before), _names(after)) + _altered(what, before, after)
    if old.input_delay != new.input_delay:
        lines.append(f"input delay: {old.input_delay:g} -> {new.input_delay:g} s")
    delayed = dict.fromkeys((*old.output_delay, *new.output_delay))
    late = [(n, old.output_delay.get(n, 0.0), new.output_delay.get(n, 0.0)) for n in delayed]
    lines += [f"output delay of {n}: {a:g} -> {b:g} s" for n, a, b in late if a != b]
    rows = [n for n, values in new.rows.items() if n in old.rows and not _same(old.rows[n], values)]
    return lines + ([f"rows changed: {', '.join(rows)} ({len(rows)} of {len(new.rows)})"] if rows else [])


def _names(entries: Iterable[Entry]) -> tuple[str, ...]:
    return tuple(e.name for e in entries)


def _membership(what: str, old: tuple[str, ...], new: tuple[str, ...]) -> list[str]:
    added, removed = [n for n in new if n not in old], [n for n in old if n not in new]
    lines = [f"{what} added: {', '.join(_without_points(added))}"] if added else []
    lines += [f"{what} removed: {', '.join(_without_points(removed))}"] if removed else []
    moved = not lines and old != new
    return [f"{what} in another order"] if moved else lines


def _without_points(names: list[str]) -> list[str]:
    """The names without the dozens of numbers of a thrust curve that has come or gone as a whole."""
    found = [(n, re.fullmatch(r"curve_(?:begin|end_\d+|\d+_\d+)_(.+)", n)) for n in names]
    return [n for n, part in found if part is None or f"curve_{part[1]}" not in names]


def _altered(what: str, old: tuple[Entry, ...], new: tuple[Entry, ...]) -> list[str]:
    before = {e.name: e for e in old}
    pairs = [(before[e.name], e) for e in new if e.name in before and before[e.name] != e]
    return [f"{what} changed: {a.name} {_shown(a)} -> {_shown(b)}" for a, b in pairs]


def _shown(entry: Entry) -> str:
    return f"{'' if entry.value is None else repr(entry.value)} {entry.unit}".strip()


def _same(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    tolerance = EQUIVALENCE.same * max((abs(v) for v in (*a, *b)), default=0.0)
    return len(a) == len(b) and all(isclose(v, w, abs_tol=tolerance) for v, w in zip(a, b, strict=True))


@dataclass(frozen=True)
class Report:
    """What came of an export or of a check."""

    folder: Path  # where the generated code lies
    first: bool  # True where no code was there before
    changes: tuple[str, ...]  # what has changed since, in words

    def with_line(self, line: str) -> Report:
        """The report with one more change."""
        return Report(self.folder, self.first, (*self.changes, line))
