"""C code of a vehicle for use without undertow, and a manifest of what it was made from."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from importlib.resources import files
from itertools import chain
from math import isclose, isfinite
from pathlib import Path
from typing import Any

import casadi as ca
from pydantic import TypeAdapter

from undertow.errors import UndertowError
from undertow.files import make_folder, read_json, together, write_whole
from undertow.model.symbols import FORCE, FORCE_UNITS, POSE, VELOCITY, VELOCITY_UNITS
from undertow.model.tables import Printable
from undertow.model.vehicle import Vehicle
from undertow.version import __version__

from .compiler import find_compiler
from .functions import Functions
from .plain import plain_c, signature

SCHEMA = "undertow/codegen/1"
_POINTS = 5
_UNITS = {
    **dict.fromkeys(POSE[:3], "m"),
    **dict.fromkeys(POSE[3:], "rad"),
    **dict(zip(VELOCITY, VELOCITY_UNITS, strict=True)),
    **{f"tau_{f}": unit for f, unit in zip(FORCE, FORCE_UNITS, strict=True)},
    "rho": "kg/m^3",
    "g": "m/s^2",
}


@dataclass(frozen=True)
class Entry:
    """One state, input or parameter.

    Attributes
    ----------
    name, unit : str
        What it is and what it is measured in.
    value : float, optional
        Value of a parameter in the vehicle file, SI and SNAME signs.
    """

    name: Printable
    unit: Printable
    value: float | None = None


@dataclass(frozen=True)
class Manifest:
    """A model as its generated code stands for it.

    Attributes
    ----------
    vehicle : str
        Name of the vehicle.
    effects : tuple of str
        Ids of the effects.
    states, inputs, parameters : tuple of Entry
        Entries of x, u and p in order.
    input_delay : float
        Dead time of the inputs, s, which the caller has to provide.
    output_delay : mapping
        Dead time of the outputs that are reported late, s, by name, which the caller has to provide, too.
    rows : mapping
        Values of every row of the equations of motion at fixed points. They tell an equation from another one
        whatever way it is written, and do not change when a parameter moves to another place in p.
    """

    vehicle: Printable
    effects: tuple[Printable, ...]
    states: tuple[Entry, ...]
    inputs: tuple[Entry, ...]
    parameters: tuple[Entry, ...]
    input_delay: float
    output_delay: Mapping[Printable, float]
    rows: Mapping[Printable, tuple[float, ...]]

    def to_json(self, files: Mapping[str, str], compiler: str) -> str:
        """Text of the manifest file.

        Parameters
        ----------
        files : mapping
            Text of every generated file by name.
        compiler : str
            Compiler of this machine, for the record.
        """
        hashes = {name: sha256(text) for name, text in files.items()}
        versions = {"undertow": __version__, "casadi": ca.__version__, "compiler": compiler}
        content = {"schema": SCHEMA, **versions, "model": hashes["model.c"], **asdict(self), "files": hashes}
        return json.dumps(_in_json(content), indent=1, allow_nan=False) + "\n"

    @classmethod
    def from_json(cls, text: str) -> tuple[Manifest, dict[str, str]]:
        """The manifest and the hashes of the files beside it.

        Raises
        ------
        UndertowError
            If the text is not a manifest.
        """
        try:
            content = json.loads(text)
            if content["schema"] != SCHEMA:
                raise UndertowError(f"schema '{content['schema']}' is not {SCHEMA}: generate the code again")
            # Code from before sensors could be late has none that are.
            found = TypeAdapter(cls).validate_python({"output_delay": {}, **content})
            return found, TypeAdapter(dict[Printable, str]).validate_python(content["files"])
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
            raise UndertowError(f"not a manifest of generated code ({error}): generate it again") from error


def _in_json(content: Any) -> Any:
    """Content without what JSON has no number for: a thrust without a limit is limited by the word "inf"."""
    if isinstance(content, dict):
        return {k: _in_json(v) for k, v in content.items()}
    if isinstance(content, list | tuple):
        return [_in_json(v) for v in content]
    return str(content) if isinstance(content, float) and not isfinite(content) else content


def sha256(text: str) -> str:
    """SHA-256 of a text, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


# --- describing -----------------------------------------------------------------------------------


def describe(functions: Functions) -> Manifest:
    """The manifest of a model."""
    vehicle = functions.vehicle
    return Manifest(
        vehicle=vehicle.name,
        effects=tuple(e.id for e in vehicle.effects),
        states=tuple(Entry(n, _state_unit(functions, n)) for n in functions.state_names),
        inputs=tuple(Entry(n, unit) for n, unit in vehicle.command_units.items()),
        parameters=tuple(
            Entry(n, _parameter_unit(functions, n), v)
            for n, v in zip(functions.parameter_names, functions.values(), strict=True)
        ),
        input_delay=dead_time(functions),
        output_delay=output_delay(functions),
        rows=_rows(functions),
    )


def dead_time(functions: Functions) -> float:
    """Dead time of the inputs for the vehicle's values, s."""
    return float(functions.dead_time(functions.values()))


def output_delay(functions: Functions) -> dict[str, float]:
    """Dead time of the outputs that come late for the vehicle's values, s, by name."""
    evaluate = ca.Function("report_age", [functions.p], [ca.densify(functions.report_age)])
    seconds = evaluate(functions.values()).full().ravel().tolist()
    names = (*functions.vehicle.pose_names, *functions.vehicle.velocity_names)
    return {n: s for n, s in zip(names, seconds, strict=True) if s}


def _state_unit(functions: Functions, name: str) -> str:
    if name in _UNITS:
        return _UNITS[name]
    owned = chain.from_iterable(
        zip(e.states, e.state_units, strict=True) for e in functions.vehicle.all_effects
    )
    return dict(owned).get(name, "")


def _parameter_unit(functions: Functions, name: str) -> str:
    found = functions.vehicle.parameter_of(name)
    return found.unit if found else _UNITS.get(name, "")


def _rows(functions: Functions) -> dict[str, tuple[float, ...]]:
    arguments = [functions.x, functions.nu_dot, functions.u, functions.p, functions.t]
    evaluate = ca.Function("balance", arguments, [ca.densify(functions.balance)])
    vehicle = functions.vehicle
    accelerations = [f"{n}_dot" for n in vehicle.velocity_names]
    moving = [functions.state_names, accelerations, vehicle.command_names, functions.parameter_names, ["t"]]
    columns = [
        evaluate(*([_coordinate(n, k, signed=i < 3) for n in names] for i, names in enumerate(moving)))
        for k in range(_POINTS)
    ]
    table = ca.horzcat(*columns).full()
    return {f"{n}_dot": tuple(map(float, row)) for n, row in zip(functions.state_names, table, strict=True)}


def _coordinate(name: str, point: int, *, signed: bool) -> float:
    """A number between 0.2 and 1 that belongs to a name; motions and commands go both ways."""
    share = int(hashlib.sha256(f"{name}/{point}".encode()).hexdigest()[:12], 16) / 16**12
    return (0.2 + 0.8 * share) * (-1 if signed and point % 2 else 1)


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
    late = [(n, old.output_delay.get(n, 0.0), new.output_delay.get(n, 0.0)) for n in _outputs(old, new)]
    lines += [f"output delay of {n}: {a:g} -> {b:g} s" for n, a, b in late if a != b]
    rows = [n for n, values in new.rows.items() if n in old.rows and not _same(old.rows[n], values)]
    return lines + ([f"rows changed: {', '.join(rows)} ({len(rows)} of {len(new.rows)})"] if rows else [])


def _outputs(old: Manifest, new: Manifest) -> tuple[str, ...]:
    return tuple(dict.fromkeys((*old.output_delay, *new.output_delay)))


def _names(entries: Iterable[Entry]) -> tuple[str, ...]:
    return tuple(e.name for e in entries)


def _membership(what: str, old: tuple[str, ...], new: tuple[str, ...]) -> list[str]:
    added, removed = [n for n in new if n not in old], [n for n in old if n not in new]
    lines = [f"{what} added: {', '.join(added)}"] if added else []
    lines += [f"{what} removed: {', '.join(removed)}"] if removed else []
    moved = not lines and old != new
    return [f"{what} in another order"] if moved else lines


def _altered(what: str, old: tuple[Entry, ...], new: tuple[Entry, ...]) -> list[str]:
    before = {e.name: e for e in old}
    pairs = [(before[e.name], e) for e in new if e.name in before and before[e.name] != e]
    return [f"{what} changed: {a.name} {_shown(a)} -> {_shown(b)}" for a, b in pairs]


def _shown(entry: Entry) -> str:
    return f"{'' if entry.value is None else repr(entry.value)} {entry.unit}".strip()


def _same(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    tolerance = 1e-9 * max((abs(v) for v in (*a, *b)), default=0.0)
    return len(a) == len(b) and all(isclose(v, w, abs_tol=tolerance) for v, w in zip(a, b, strict=True))


_TEMPLATES = ("model.h", "main.c", "CMakeLists.txt")
_EDITABLE = "main.c"
_MANIFEST = "manifest.json"


@dataclass(frozen=True)
class Report:
    """What came of an export or of a check.

    Attributes
    ----------
    folder : Path
        Where the generated code lies.
    first : bool
        True where no code was there before.
    changes : tuple of str
        What has changed since, in words.
    """

    folder: Path
    first: bool
    changes: tuple[str, ...]

    def with_line(self, line: str) -> Report:
        """The report with one more change."""
        return Report(self.folder, self.first, (*self.changes, line))


class Export:
    """The generated files of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        The model.

    Raises
    ------
    UndertowError
        If the vehicle's name holds neither a letter nor a digit.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._functions = Functions(vehicle)
        self.folder_name = slug(vehicle.name)
        self._name = identifier(self.folder_name)

    @cached_property
    def manifest(self) -> Manifest:
        """What the code is made from."""
        return describe(self._functions)

    # --- writing and checking -----------------------------------------------------------------
    def write(self, out: Path) -> Report:
        """Write the files to a folder of the vehicle's own in `out`, and say what has changed.

        An example (main.c) that somebody has edited is kept.

        Raises
        ------
        UndertowError
            If the folder cannot be written.
        """
        report, recorded = self._compare(out)
        compiler, texts = find_compiler(), self.texts
        # Last, so that a run that was killed leaves no manifest that claims to be current.
        texts_and_record = {
            **texts,
            _MANIFEST: self.manifest.to_json(texts, compiler.version if compiler else "none"),
        }
        with together():
            make_folder(report.folder)
            for name, text in texts_and_record.items():
                path = report.folder / name
                if (
                    name == _EDITABLE
                    and path.is_file()
                    and _edited(path, recorded.get(name, ""), sha256(text))
                ):
                    report = report.with_line(f"{name} was edited and is kept")
                else:
                    write_whole(path, text)
        return report

    def check(self, out: Path) -> Report:
        """Compare what lies in `out` with the vehicle; without changes it is current. Nothing is written."""
        report, recorded = self._compare(out)
        for name, found in recorded.items():
            if name != _EDITABLE and _edited(report.folder / name, found):
                report = report.with_line(f"{name} is not as it was generated")
        return report

    def _compare(self, out: Path) -> tuple[Report, dict[str, str]]:
        folder = out / self.folder_name
        if not (folder / _MANIFEST).is_file():
            return Report(folder, True, ()), {}
        try:
            old, recorded = Manifest.from_json(read_json(folder / _MANIFEST, "manifest"))
        except UndertowError as error:
            return Report(folder, False, (f"{_MANIFEST}: {error}",)), {}
        return Report(folder, False, tuple(changes(old, self.manifest))), recorded

    # --- the files ----------------------------------------------------------------------------
    @cached_property
    def texts(self) -> dict[str, str]:
        """Text of every file but the manifest, by name."""
        folder = files("undertow.codegen") / "templates"
        templates = {name: (folder / name).read_text(encoding="utf-8") for name in _TEMPLATES}
        return {"model.c": self._source(), **{name: self._filled(text) for name, text in templates.items()}}

    @property
    def _exported(self) -> dict[str, ca.Function]:
        f = self._functions
        return {
            "dynamics": f.dynamics,
            "jacobians": f.jacobians,
            "residual": f.residual_function,
            "regressor": f.regressor,
            "outputs": f.outputs,
        }

    def _source(self) -> str:
        manifest = self.manifest
        names = {"state": manifest.states, "input": manifest.inputs, "parameter": manifest.parameters}
        lines = [f"/* Model of '{comment(manifest.vehicle)}', generated by undertow; see model.h. */"]
        lines += ['#include "model.h"', "", "#include <math.h>", ""]
        lines += [strings(f"{self._name}_{what}_names", entries) for what, entries in names.items()]
        values = [_number(e.value) for e in manifest.parameters]
        lines += [f"const double {self._name}_parameters[] = {{{', '.join(values) or '0'}}};", ""]
        return "\n".join([*lines, *(plain_c(f, f"{self._name}_{n}") for n, f in self._exported.items())])

    def _filled(self, template: str) -> str:
        manifest = self.manifest
        fields = {
            "TITLE": comment(manifest.vehicle),
            "VERSION": __version__,
            "LOWER": self._name,
            "UPPER": self._name.upper(),
            "NX": len(manifest.states),
            "NU": len(manifest.inputs),
            "NP": len(manifest.parameters),
            "ND": len(self._functions.vehicle.degrees_of_freedom),
            "STATES": listing(manifest.states),
            "INPUTS": listing(manifest.inputs),
            "PARAMETERS": listing(manifest.parameters),
            "DELAY": _delays(manifest),
            "EXAMPLE_INPUT": ", ".join(f"{1 / (i + 1):.3g}" for i in range(len(manifest.inputs))) or "0",
            **{n.upper(): signature(f, f"{self._name}_{n}") for n, f in self._exported.items()},
        }
        return filled(template, fields)


def _delays(manifest: Manifest) -> str:
    """Words on what the caller has to delay, which equations of motion cannot."""
    lines = []
    if manifest.input_delay:
        lines.append(f"   The inputs act {manifest.input_delay:g} s late: the caller has to delay them.")
    for seconds in sorted(set(manifest.output_delay.values())):
        names = ", ".join(n for n, s in manifest.output_delay.items() if s == seconds)
        lines.append(f"   The outputs {names} are reported {seconds:g} s late: the caller has to delay them.")
    return "".join(f"\n{line}\n" for line in lines)


def _edited(path: Path, *generated: str) -> bool:
    """Whether a file is none of those with the given hashes."""
    try:
        return sha256(path.read_text(encoding="utf-8")) not in generated
    except (OSError, UnicodeDecodeError):
        return True


# --- names from files in C --------------------------------------------------------------------


def slug(name: str) -> str:
    """A folder name for a vehicle or a controller.

    Raises
    ------
    UndertowError
        If the name holds neither a letter nor a digit.
    """
    slug = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60].strip("-")
    if not slug:
        raise UndertowError(f"the name '{name}' gives no folder name: use letters and digits")
    return slug


def identifier(folder: str) -> str:
    """The name of a folder as one in C."""
    name = folder.replace("-", "_")
    return name if name[0].isalpha() else f"v_{name}"


def filled(template: str, fields: Mapping[str, object]) -> str:
    """A template with its @FIELDS@ filled in."""
    return re.sub(r"@([A-Z_]+)@", lambda match: str(fields[match[1]]), template)


def comment(text: str) -> str:
    """Text that ends neither a comment nor a line of a comment."""
    return re.sub(r"[^\w .,:;()+=-]", "_", text, flags=re.ASCII)


def _number(value: float | None) -> str:
    """A constant in C; a limit that is never reached is infinite."""
    return repr(value).replace("inf", "INFINITY")


def strings(name: str, entries: Sequence[Entry]) -> str:
    """An array of the names of entries in C."""
    quoted = ", ".join(f'"{comment(e.name)}"' for e in entries) or '""'
    return f"const char *const {name}[] = {{{quoted}}};"


def listing(entries: Iterable[Entry]) -> str:
    """Entries as lines of a comment in C: index, name, value and unit."""
    lines = []
    for i, e in enumerate(entries):
        value = "" if e.value is None else f" = {e.value!r}"
        unit = re.sub(r"[^\w ()^/.-]", "_", e.unit, flags=re.ASCII)
        lines.append(f"     [{i}] {comment(e.name)}{value} {unit}".rstrip())
    return "\n".join(lines) or "     none"
