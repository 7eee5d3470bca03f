"""C code of a vehicle for use without undertow: source, header, an example, and a manifest."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files
from pathlib import Path

import casadi as ca

from undertow.errors import UndertowError
from undertow.files import make_folder, read_json, together, write_whole
from undertow.model.vehicle import Vehicle
from undertow.version import __version__

from .compiler import find_compiler
from .functions import Functions
from .manifest import Entry, Manifest, changes, describe, sha256
from .plain import plain_c, signature

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
