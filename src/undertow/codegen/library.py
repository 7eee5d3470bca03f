"""A vehicle as a C99 library for use without undertow, with its controllers and observers."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterable, Mapping
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from undertow.errors import UndertowError
from undertow.files import make_folder, read_json, together, write_whole
from undertow.model.vehicle import Vehicle
from undertow.version import __version__

from .compiler import find_compiler
from .functions import Functions
from .manifest import Manifest, Report, changes, describe
from .source import digest
from .spelling import Dialect, Part, Writer, comment, fill, identifier, listing, slug
from .vehicle_c import has_inverse, jacobians_c, thrusters_c, vehicle_c

_MANIFEST = "manifest.json"
_REAL = "real"  # the module with the type of the numbers


class Library:
    """The generated files of a vehicle, with further parts (controllers, observers) by name."""

    def __init__(self, vehicle: Vehicle, more: Iterable[tuple[str, Writer]] = ()) -> None:
        self.vehicle, self._functions = vehicle, Functions(vehicle, named=True)
        self.folder_name = slug(vehicle.name)
        self.name = identifier(self.folder_name)
        self._dialect = Dialect(self.name)
        self._writers = self._own()
        for name, writer in more:
            self._write_part(name, writer)

    def _own(self) -> dict[str, Writer]:
        own: dict[str, Writer] = {
            "vehicle": lambda c: vehicle_c(c, self._functions, self.manifest),
            "jacobians": lambda c: jacobians_c(c, self._functions, self.manifest),
        }
        if self.vehicle.thrusters and all(has_inverse(t) for t in self.vehicle.thrusters):
            own["thrusters"] = lambda c: thrusters_c(c, self.vehicle)
        return own

    def _write_part(self, name: str, writer: Writer) -> None:
        part = identifier(slug(name))
        if part in self._writers or part == _REAL:
            raise UndertowError(
                f"'{name}' would be written as {self.name}_{part}.c, which is taken: give it another name"
            )
        self._writers[part] = writer

    @property
    def losses(self) -> list[str]:
        """What of the vehicle the library lacks, a line each."""
        without = [t.name for t in self.vehicle.thrusters if not has_inverse(t)]
        if not without:
            return []
        return [
            f"thruster '{without[0]}' has no one command for a thrust (revolutions, or a curve that falls): "
            "no commands from newtons and no pulses"
        ]

    @cached_property
    def manifest(self) -> Manifest:
        """What the code is made from."""
        return describe(self._functions)

    # --- writing and checking -----------------------------------------------------------------
    def write(self, out: Path) -> Report:
        """Write the files to a folder of the vehicle's own in `out`, and say what has changed.

        Examples that somebody has edited are kept.
        """
        report, recorded = self._compare(out)
        compiler = find_compiler()
        record = self.manifest.to_json(self.texts, compiler.version if compiler else "none")
        if report.first:
            _refuse_foreign(report.folder, self.texts)
        # Last, so that a run that was killed leaves no manifest that claims to be current.
        with together():
            for name, text in {**self.texts, _MANIFEST: record}.items():
                path = report.folder / name
                make_folder(path.parent)
                if (
                    _is_example(name)
                    and path.is_file()
                    and _edited(path, recorded.get(name, ""), digest(text))
                ):
                    report = report.with_line(f"{name} was edited and is kept")
                else:
                    write_whole(path, text)
        return report

    def check(self, out: Path) -> Report:
        """Compare what lies in `out` with the vehicle; without changes it is current. Nothing is written."""
        report, recorded = self._compare(out)
        for name, found in recorded.items():
            if not _is_example(name) and _edited(report.folder / name, found):
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
        return Report(folder, False, (*changes(old, self.manifest), *self._changed(recorded))), recorded

    def _changed(self, recorded: Mapping[str, str]) -> list[str]:
        """Parts besides those of the model that are new, left out or different."""
        sources = [f"src/{self.name}_{n}.c" for n, p in self._parts.items() if not p.about_model]
        lines = [f"{n} is new" for n in sources if n not in recorded]
        lines += [
            f"{n} has changed"
            for n in sources
            if recorded.get(n, digest(self.texts[n])) != digest(self.texts[n])
        ]
        gone = [n for n in recorded if n.endswith(".c") and n.startswith("src/") and n not in self.texts]
        return lines + [f"{n} is no longer part of it" for n in gone]

    # --- the files ----------------------------------------------------------------------------
    @cached_property
    def _parts(self) -> dict[str, Part]:
        return {name: writer(self._dialect) for name, writer in self._writers.items()}

    @cached_property
    def texts(self) -> dict[str, str]:
        """Text of every file but the manifest, by name."""
        sources = [f"src/{self.name}_{part}.c" for part in self._parts]
        examples = " ".join(self._parts)
        found = {}
        for name, part in self._parts.items():
            found[f"src/{self.name}_{name}.h"] = self._header(name, part)
            found[f"src/{self.name}_{name}.c"] = self._source(name, part)
            found[f"examples/{name}/main.c"] = self._example(name, part)
        return {
            **found,
            f"src/{self.name}_real.h": self._filled("real.h"),
            "CMakeLists.txt": self._filled("library.cmake", SOURCES=" ".join(sources), EXAMPLES=examples),
            "library.properties": self._properties(),
            "README.md": self._readme(),
        }

    def _filled(self, template: str, **more: object) -> str:
        text = (files("undertow.codegen") / "templates" / template).read_text(encoding="utf-8")
        fields = {"TITLE": comment(self.vehicle.name), "VERSION": __version__}
        return fill(text, {**fields, "LOWER": self.name, "UPPER": self.name.upper(), **more})

    def _header(self, name: str, part: Part) -> str:
        lists = "".join(f"\n   {what}:\n{listing(entries)}\n" for what, entries in part.notes.items())
        guard, declared = f"{self.name}_{name}".upper(), "\n".join(part.declarations)
        fields = {"WHAT": part.title, "LISTS": lists, "DECLARATIONS": declared, "GUARD": guard}
        return self._filled("library.h", DELAY=_delays(self.manifest), **fields)

    def _source(self, name: str, part: Part) -> str:
        head = f"/* {comment(self.vehicle.name)}: see {self.name}_{name}.h; generated by undertow. */"
        return "\n".join([head, f'#include "{self.name}_{name}.h"', "", *part.definitions])

    def _example(self, name: str, part: Part) -> str:
        head = f"/* {comment(self.vehicle.name)}: how {name} is used; this file is yours to change. */"
        includes = f'#include <stdio.h>\n\n#include "{self.name}_{name}.h"'
        return f"{head}\n{includes}\n\nint main(void) {{\n{part.example}\n  return 0;\n}}\n"

    def _properties(self) -> str:
        # Arduino and PlatformIO read this; a version has three numbers there.
        includes = ",".join(f"{self.name}_{part}.h" for part in self._parts)
        return (
            f"name={self.name}\nversion={__version__}\nauthor=undertow\nmaintainer=undertow\n"
            f"sentence={comment(self.vehicle.name)} in C\nparagraph=Generated from a vehicle file.\n"
            f"category=Device Control\nurl=\narchitectures=*\nincludes={includes}\n"
        )

    def _readme(self) -> str:
        listed = (
            f"- {comment(part.title)}: `src/{self.name}_{name}.h`, `examples/{name}/main.c`"
            for name, part in self._parts.items()
        )
        return self._filled("library.md", PARTS="\n".join(listed), LATE=_delays(self.manifest))


def _delays(manifest: Manifest) -> str:
    """Words on what the caller has to delay, which equations of motion cannot."""
    lines = []
    if manifest.input_delay:
        lines.append(f"   The inputs act {manifest.input_delay:g} s late: the caller has to delay them.")
    for seconds in sorted(set(manifest.output_delay.values())):
        names = ", ".join(n for n, s in manifest.output_delay.items() if s == seconds)
        lines.append(f"   The outputs {names} are reported {seconds:g} s late: the caller has to delay them.")
    return "".join(f"\n{line}\n" for line in lines)


def _is_example(name: str) -> bool:
    return name.startswith("examples/")


def _edited(path: Path, *generated: str) -> bool:
    """Whether a file is none of those with the given hashes."""
    try:
        return digest(path.read_text(encoding="utf-8")) not in generated
    except (OSError, UnicodeDecodeError):
        return True


def _refuse_foreign(folder: Path, names: Mapping[str, str]) -> None:
    taken = [name for name in names if (folder / name).exists()]
    if taken:
        raise UndertowError(
            f"'{folder / taken[0]}' was there before and was not generated: name another folder with --out"
        )


# --- what it takes on a board --------------------------------------------------------------------------
class Size(NamedTuple):
    """Bytes of stack of one function."""

    function: str
    stack: int


def usual_compilers(library: Library) -> list[tuple[str, list[str]]]:
    """Compilers whose sizes are of interest, the first first: what they compile for, and their commands."""
    cortex = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
    single = f"-D{library.name.upper()}_SINGLE"
    return [
        ("arm-none-eabi-gcc for a Cortex-M4, float", ["arm-none-eabi-gcc", *cortex, single]),
        ("gcc for this machine, double", ["gcc"]),
    ]


def sizes(library: Library, compiler: str, *flags: str) -> tuple[dict[str, int], list[Size]]:
    """Bytes of code and constants of each module, and of stack of each function, with -Os."""
    if shutil.which(compiler) is None:
        raise UndertowError(f"compiler '{compiler}' is not there: install it (Debian: gcc-arm-none-eabi)")
    with TemporaryDirectory() as place:
        folder = library.write(Path(place)).folder
        modules: dict[str, int] = {}
        stacks: list[Size] = []
        for source in sorted((folder / "src").glob("*.c")):
            command = [compiler, "-std=c99", "-Os", "-fstack-usage", *flags, "-c", source.name]
            done = subprocess.run(command, cwd=source.parent, capture_output=True, text=True, check=False)
            if done.returncode:
                raise UndertowError(
                    f"{compiler} fails on {source.name}: {done.stderr.strip().splitlines()[0]}"
                )
            modules[source.name] = _flash(compiler, source.with_suffix(".o"))
            for line in source.with_suffix(".su").read_text().splitlines():
                where, size, _ = line.split("\t")
                stacks.append(Size(where.rpartition(":")[2], int(size)))
    return modules, stacks


def _flash(compiler: str, module: Path) -> int:
    """Bytes of code and constants of an object file."""
    tool = f"{compiler.removesuffix('gcc')}size" if compiler.endswith("gcc") else "size"
    done = subprocess.run([tool, str(module)], capture_output=True, text=True, check=True)
    text, data = done.stdout.splitlines()[1].split()[:2]
    return int(text) + int(data)
