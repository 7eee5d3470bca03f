"""From a CasADi function to a shared library: its C, the compiler, and libraries kept between runs."""

from __future__ import annotations

import atexit
import ctypes
import hashlib
import json
import logging
import math
import os
import re
import shlex
import shutil
import stat
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import TypeVar

import casadi as ca
import numpy as np

from undertow.errors import UndertowError

from .source import (
    CALLS,
    FORMS,
    LIBRARY_SUFFIX,
    TWO_OPERANDS,
    c_source,
    digest,
    engine_file,
    with_unique_symbols,
)

# --- C99 of a function, one statement for each operation: plain, or for lanes side by side --------
_LANE_CALL = {
    **{"OP_LT": "less", "OP_LE": "at_most", "OP_EQ": "equal", "OP_NE": "unequal"},
    **{"OP_AND": "and", "OP_OR": "or", "OP_NOT": "not", "OP_SIGN": "sign", "OP_IF_ELSE_ZERO": "if"},
}
_ANGLES = ("OP_SIN", "OP_COS", "OP_TAN")
# As many angles as lanes.h turns into sines and cosines at once.
_SHARED_ANGLES = 4
_OPERATION = {v: k for k, v in vars(ca).items() if k.startswith("OP_")}


@dataclass(frozen=True)
class Words:
    """How C is spelled."""

    real: str  # type of a number
    from_double: str  # how a double becomes one
    operations: Mapping[str, str]  # the expression of every operation, operands as {0} and {1}
    # whether sine and cosine of an angle are computed together, and those of several angles, and whether what
    # divides several values is inverted once
    share_work: bool


PLAIN = Words("double", "{}", FORMS, share_work=False)
_CALLED = {**{k: v for k, v in CALLS.items() if k not in _ANGLES}, **_LANE_CALL}
_OF_TWO = {*TWO_OPERANDS, *_LANE_CALL} - {"OP_NOT", "OP_SIGN"}
LANES = Words(
    "Real",
    "real({})",
    {
        **{k: FORMS[k] for k in ("OP_ADD", "OP_SUB", "OP_MUL", "OP_DIV", "OP_NEG", "OP_SQ")},
        **{"OP_TWICE": "2.0 * {0}", "OP_INV": "1.0 / {0}"},
        **{k: f"real_{v}({{0}}, {{1}})" if k in _OF_TWO else f"real_{v}({{0}})" for k, v in _CALLED.items()},
    },
    share_work=True,
)
"""The words of lanes.h: the same text for any number of lanes."""

Structs = Mapping[str, tuple[str, Sequence[str]]]
"""Inputs that are structs in C: type and names of the members in order, by name of the input."""


def signature(
    function: ca.Function,
    name: str,
    *,
    words: Words = PLAIN,
    shared: Collection[str] = (),
    structs: Structs | None = None,
    by_value: Collection[str] = ("t",),
) -> str:
    """`void name(const double *x, ..., double t, double *out)`; matrices are stored row by row."""
    types = {n: "double" if n in shared else words.real for n in function.name_in()}
    types |= {n: of for n, (of, _) in (structs or {}).items()}
    inputs = [f"{of} {n}" if n in by_value else f"const {of} *{n}" for n, of in types.items()]
    return f"void {name}({', '.join([*inputs, *(f'{words.real} *{n}' for n in function.name_out())])})"


def plain_c(
    function: ca.Function,
    name: str,
    *,
    packed: Collection[str] = (),
    prefix: str = "",
    words: Words = PLAIN,
    shared: Collection[str] = (),
    structs: Structs | None = None,
    by_value: Collection[str] = ("t",),
) -> str:
    """C99 source of a CasADi function with dense inputs, called `name`, with `prefix` before the signature.

    Of `packed` outputs only the structural nonzeros are written, column by column (compressed columns).
    `shared` inputs are doubles, the same in all lanes; inputs in `structs` are structs (type and members);
    those in `by_value` are numbers and no pointers to them.
    """
    flat = function if function.is_a("SXFunction") else function.expand()
    body = _Body(flat, packed, words, shared, structs or {}, by_value)
    # All is computed before anything is written: an output may lie where an input was.
    lines = [*body.unused(), *body.statements, *body.cleared(), *body.results]
    head = signature(flat, name, words=words, shared=shared, structs=structs, by_value=by_value)
    return f"{prefix}{head} {{\n" + "".join(f"  {line}\n" for line in lines) + "}\n"


class _Body:
    """The instructions of a function, one after the other, as C statements."""

    def __init__(
        self,
        function: ca.Function,
        packed: Collection[str],
        words: Words,
        shared: Collection[str],
        structs: Structs,
        by_value: Collection[str],
    ) -> None:
        self._structs, self._by_value = structs, by_value
        self._function, self._words, self._shared = function, words, shared
        self._inputs, self._outputs = function.name_in(), function.name_out()
        self._place = [_places(function.sparsity_out(n), n in packed) for n in self._outputs]
        self._register: dict[int, str] = {}
        self._read: set[str] = set()
        self._written: dict[str, int] = dict.fromkeys(self._outputs, 0)
        self._count = 0
        self._zero = self._spread("0.0")
        self._sines: dict[str, tuple[str, str]] = {}
        self._inverses: dict[str, str] = {}
        self._ahead, self._divisors = self._shared_work() if words.share_work else ([], set())
        self.statements: list[str] = []
        self.results: list[str] = []
        for k in range(function.n_instructions()):
            self._instruction(k)

    def _spread(self, value: str) -> str:
        return self._words.from_double.format(value)

    def unused(self) -> list[str]:
        """Inputs without a use and outputs without an entry, declared to the compiler."""
        empty = [n for n, (size, _) in zip(self._outputs, self._place, strict=True) if not size]
        return [f"(void){n};" for n in [*self._inputs, *empty] if n not in self._read]

    def cleared(self) -> list[str]:
        """Outputs with entries that are always zero are zeroed first."""
        sizes = zip(self._outputs, self._place, strict=True)
        partly = {n: size for n, (size, _) in sizes if self._written[n] < size}
        return [
            f"for (int i = 0; i < {size}; i++) {{ {n}[i] = {self._spread('0')}; }}"
            for n, size in partly.items()
        ]

    def _instruction(self, k: int) -> None:
        f = self._function
        operation = _OPERATION[f.instruction_id(k)]
        into, operands = f.instruction_output(k), f.instruction_input(k)
        special: dict[str, Callable[[int, list[int], list[int]], None]] = {
            "OP_INPUT": self._input,
            "OP_OUTPUT": self._output,
            "OP_CONST": self._constant,
            "OP_ASSIGN": self._copy,
        }
        if operation in special:
            special[operation](k, into, operands)
            return
        values = [self._register[i] for i in operands]
        if operation in _ANGLES and self._words.share_work:
            self._register[into[0]] = self._of_angle(operation, values[0])
            return
        if k in self._divisors:
            self._register[into[0]] = self._quotient(*values)
            return
        if operation not in self._words.operations:
            raise UndertowError(
                f"operation {operation} of a model has no counterpart in C: restate the effect"
            )
        self._register[into[0]] = self._local(self._words.operations[operation].format(*values))

    def _local(self, expression: str) -> str:
        name = f"a{self._count}"
        self._count += 1
        self.statements.append(f"const {self._words.real} {name} = {expression};")
        return name

    # --- what is computed together --------------------------------------------------------------
    def _shared_work(self) -> tuple[list[str], set[int]]:
        """Inputs that are angles: they can be turned at once. Divisions by what divides others, too."""
        f = self._function
        made: dict[int, int] = {}
        angles: dict[int, None] = {}
        divisions = defaultdict(list)
        for k in range(f.n_instructions()):
            operation, operands = _OPERATION[f.instruction_id(k)], f.instruction_input(k)
            if operation in _ANGLES:
                angles[made[operands[0]]] = None
            elif operation == "OP_DIV":
                divisions[made[operands[1]]].append(k)
            if operation != "OP_OUTPUT":
                made[f.instruction_output(k)[0]] = k
        inputs = [k for k in angles if _OPERATION[f.instruction_id(k)] == "OP_INPUT"]
        several = {k for found in divisions.values() if len(found) > 1 for k in found}
        return [self._element(f.instruction_input(k)) for k in inputs], several

    def _quotient(self, above: str, below: str) -> str:
        if below not in self._inverses:
            self._inverses[below] = self._local(f"1.0 / {below}")
        return self._local(f"{above} * {self._inverses[below]}")

    def _of_angle(self, operation: str, angle: str) -> str:
        if angle not in self._sines:
            together = [a for a in self._ahead if a not in self._sines] if angle in self._ahead else [angle]
            self._turn([angle, *(a for a in together if a != angle)][:_SHARED_ANGLES])
        sine, cosine = self._sines[angle]
        if operation == "OP_TAN":
            return self._local(f"{sine} / {cosine}")
        return sine if operation == "OP_SIN" else cosine

    def _turn(self, angles: list[str]) -> None:
        k, n, real = self._count, len(angles), self._words.real
        self._count += 1
        self.statements += [
            f"const {real} angle{k}[] = {{{', '.join(angles)}}};",
            f"{real} sine{k}[{n}], cosine{k}[{n}];",
            f"real_sincos({n}, angle{k}, sine{k}, cosine{k});",
        ]
        self._sines |= {a: (f"sine{k}[{i}]", f"cosine{k}[{i}]") for i, a in enumerate(angles)}

    # --- in and out -----------------------------------------------------------------------------
    def _input(self, k: int, into: list[int], operands: list[int]) -> None:
        self._read.add(self._inputs[operands[0]])
        self._register[into[0]] = self._element(operands)

    def _element(self, operands: list[int]) -> str:
        name = self._inputs[operands[0]]
        element = name if name in self._by_value else f"{name}[{operands[1]}]"
        if name in self._structs:
            element = f"{name}->{self._structs[name][1][operands[1]]}"
        return self._spread(element) if name in self._shared else element

    def _output(self, k: int, into: list[int], operands: list[int]) -> None:
        value = self._register[operands[0]]
        if value == self._zero:
            return
        if "[" in value:  # an input that is handed on, and may be overwritten by then
            value = self._register[operands[0]] = self._local(value)
        name = self._outputs[into[0]]
        self._written[name] += 1
        self.results.append(f"{name}[{self._place[into[0]][1][into[1]]}] = {value};")

    def _constant(self, k: int, into: list[int], operands: list[int]) -> None:
        self._register[into[0]] = self._spread(_number(self._function.instruction_constant(k)))

    def _copy(self, k: int, into: list[int], operands: list[int]) -> None:
        self._register[into[0]] = self._register[operands[0]]


def _number(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return f"({value!r})" if math.copysign(1, value) < 0 else repr(value)


def _places(sparsity: ca.Sparsity, packed: bool) -> tuple[int, list[int]]:
    """Size of an output in C and the place of every nonzero in it."""
    if packed:
        return sparsity.nnz(), list(range(sparsity.nnz()))
    rows, columns = sparsity.get_triplet()
    return sparsity.numel(), [i * sparsity.size2() + j for i, j in zip(rows, columns, strict=True)]


# --- where compiled libraries are kept, and when one is trusted -----------------------------------
_LOG = logging.getLogger("undertow")
_OURS = re.compile(r"[0-9a-f]{24}(\.json|-[0-9a-f]{16}\.\w+)|build-\w+")


@dataclass(frozen=True)
class LibrarySettings:
    """How long compiled libraries are kept, s."""

    unused_library: float = 90 * 86400.0  # since its last use
    abandoned_build: float = 3600.0  # since the last change of its folder; a build may last ten minutes


LIBRARIES = LibrarySettings()


def library_for(source: str, compiler: Compiler, folder: Path | None = None) -> Path:
    """Path of the shared library of a C source, from the cache or compiled now.

    A library is taken from the cache only if the manifest beside it names this source and this compiler,
    and the library's own hash fits; otherwise it is built again. Processes may race: files appear whole,
    under names that carry their hashes.
    """
    place = folder or cache_folder()
    _remove_old(place)
    expected = {"source": digest(source), "compiler": compiler.identity}
    manifest = place / f"{digest(json.dumps(expected))[:24]}.json"
    known = _trusted(manifest, expected)
    if known is None:
        _LOG.info("compiling %d lines of C with %s", source.count("\n"), compiler.command[0])
        known = _build(source, compiler, manifest, expected)
    return known


def _trusted(manifest: Path, expected: dict[str, str]) -> Path | None:
    """The library of a manifest, if both are what they should be."""
    try:
        found = json.loads(manifest.read_text(encoding="utf-8"))
        library = manifest.parent / f"{manifest.stem}-{str(found['library'])[:16]}{LIBRARY_SUFFIX}"
        fits = {k: found[k] for k in expected} == expected and _sha256(library) == found["library"]
        for used in (manifest, library):
            os.utime(used)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return library if fits else None


def _build(source: str, compiler: Compiler, manifest: Path, expected: dict[str, str]) -> Path:
    try:
        with TemporaryDirectory(prefix="build-", dir=manifest.parent, ignore_cleanup_errors=True) as name:
            place = Path(name)
            (place / "model.c").write_text(source, encoding="utf-8")
            built = place / f"model{LIBRARY_SUFFIX}"
            compiler.build(place / "model.c", built)
            found = _sha256(built)
            library = manifest.parent / f"{manifest.stem}-{found[:16]}{LIBRARY_SUFFIX}"
            os.replace(built, library)
            content = json.dumps({**expected, "library": found})
            (place / "manifest.json").write_text(content, encoding="utf-8")
            os.replace(place / "manifest.json", manifest)
    except OSError as error:
        raise UndertowError(
            f"cannot keep compiled code in '{manifest.parent}': {error}; make room or set XDG_CACHE_HOME"
        ) from error
    return library


@cache
def _remove_old(folder: Path) -> None:
    """Remove what has not been used for months, and what killed builds have left; once in a process."""
    now = time.time()
    with suppress(OSError):
        for path in [p for p in folder.iterdir() if _OURS.fullmatch(p.name)]:
            with suppress(OSError):
                is_build = path.name.startswith("build-")
                kept_for = LIBRARIES.abandoned_build if is_build else LIBRARIES.unused_library
                if path.lstat().st_mtime < now - kept_for:
                    shutil.rmtree(path) if path.is_dir() else path.unlink()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


# --- the folder ---------------------------------------------------------------------------------


def cache_folder() -> Path:
    """The user's own folder for compiled libraries, or a private temporary one if that is not safe.

    Links on the way to it are followed first, so that what is checked is what is used.
    """
    configured = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME", "")
    # The XDG specification has relative paths ignored. Without a home this one is relative, too.
    place = Path(configured if os.path.isabs(configured) else os.path.expanduser("~/.cache"))
    wanted = Path(os.path.realpath(place), "undertow")
    reason = _unsafe(wanted) if place.is_absolute() else "has no place of its own, as the user has no home"
    if reason is None:
        return wanted
    return _private_folder(f"cache folder '{wanted}' {reason}")


def _unsafe(folder: Path) -> str | None:
    """Why nothing in this folder can be trusted, or None; the folder is made if it is missing."""
    try:
        folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        return f"cannot be used ({error.strerror})"
    if not stat.S_ISDIR(found.st_mode):
        return "is not a folder of its own"
    if sys.platform == "win32":
        return None
    if found.st_uid != os.geteuid():
        return f"belongs to user {found.st_uid}"
    if found.st_mode & 0o022:
        return f"can be written by others (mode {stat.S_IMODE(found.st_mode):o})"
    if not os.access(folder, os.W_OK):
        return "cannot be written"
    return next(filter(None, map(_replaceable, folder.parents)), None)


def _replaceable(parent: Path) -> str | None:
    """Why somebody else could put another folder in the place of one in `parent`, or None."""
    found = parent.stat()
    if found.st_mode & 0o002 and not found.st_mode & stat.S_ISVTX:
        return f"lies in '{parent}', which is world-writable"
    if found.st_uid not in (0, os.geteuid()):
        return f"lies in '{parent}', which belongs to user {found.st_uid}"
    return None


@cache
def _private_folder(reason: str) -> Path:
    try:
        folder = Path(mkdtemp(prefix="undertow-"))
    except OSError as error:
        raise UndertowError(
            f"{reason}, and no temporary folder can be made ({error.strerror}): set XDG_CACHE_HOME or TMPDIR "
            "to a folder of your own"
        ) from error
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    _LOG.warning("%s: compiled code is kept in a private folder for this run only", reason)
    return folder


# --- the compiler ---------------------------------------------------------------------------------
T = TypeVar("T")
U = TypeVar("U")
_CANDIDATES = ("cl",) if sys.platform == "win32" else ("cc", "gcc", "clang")
# No -ffast-math and no contraction: compiled code and the virtual machine have to agree to the last digits.
# -O1: -O2 costs half as much time again to compile and gains nothing that could be measured.
_GNU_FLAGS = (
    *("-std=c99", "-O1", "-ftree-vectorize", "-ffp-contract=off", "-w"),
    *("-fPIC", "-shared", "-fvisibility=hidden"),
)
_MSVC_FLAGS = ("/nologo", "/std:c11", "/O1", "/fp:precise", "/LD", "/w")
# For loops on this machine alone: exported code never has them. Multiply and add may be fused: what these
# loops run is not the expressions of the virtual machine anyway, but a form that agrees to rounding.
_LOCAL_FLAGS = ("-O2", "-march=native", "-ffp-contract=fast")


@dataclass(frozen=True)
class CompilerSettings:
    """How a C compiler is used."""

    # Macro that is defined where the processor has vectors of so many doubles, and how many runs then are
    # fastest side by side. Measured on x86-64: 8 lanes in narrower vectors are slower than 4, and 4 without
    # AVX than one.
    lanes: tuple[tuple[str, int], ...] = (("__AVX512F__", 8), ("__AVX__", 4), ("__aarch64__", 4))
    time_limit: float = 600.0  # s that one call of the compiler may last


SETTINGS = CompilerSettings()


@dataclass(frozen=True)
class Compiler:
    """A C compiler on this machine."""

    command: tuple[str, ...]  # how it is called
    version: str  # first line of what it says about itself
    more: tuple[str, ...] = ()  # options beyond the usual ones

    def for_this_machine(self, *options: str) -> Compiler:
        """The same compiler, using all that this processor can do; what it builds may not run elsewhere."""
        known = _processor(self.command)
        if self.is_msvc or not known:
            return self
        return replace(
            self,
            version=f"{self.version}, processor {digest(known)[:12]}",
            more=(*_LOCAL_FLAGS, *_at_most_256_bits(_macros(known)), *options),
        )

    @property
    def lanes(self) -> int:
        """How many runs are simulated fastest side by side; one without the vector extensions of GCC."""
        known = set() if self.is_msvc else _macros(_processor(self.command))
        return next((n for macro, n in SETTINGS.lanes if macro in known and "__GNUC__" in known), 1)

    @property
    def is_msvc(self) -> bool:
        """Whether it takes the options of Microsoft's compiler."""
        return Path(self.command[0]).stem.lower() == "cl"

    @property
    def identity(self) -> str:
        """Compiler and options, as a text; libraries of another identity are not used."""
        return " | ".join([" ".join(self.command), self.version, " ".join(self._flags)])

    @property
    def _flags(self) -> tuple[str, ...]:
        return (*(_MSVC_FLAGS if self.is_msvc else _GNU_FLAGS), *self.more)

    def build(self, source: Path, library: Path) -> None:
        """Compile `source` to the shared library `library`; both lie in one folder."""
        target = [f"/Fe{library.name}"] if self.is_msvc else ["-o", library.name]
        libraries = [] if self.is_msvc else ["-lm"]
        done = _run([*self.command, *self._flags, *target, source.name, *libraries], source.parent)
        if done.returncode or not library.is_file():
            log = (done.stderr or done.stdout).strip().splitlines() or ["no message"]
            raise UndertowError(
                f"the C compiler '{' '.join(self.command)}' failed, code {done.returncode}: {log[0][:200]}; "
                "repair it or set UNDERTOW_NO_COMPILER=1"
            )


def find_compiler() -> Compiler | None:
    """The C compiler to use, or None.

    UNDERTOW_CC names one ("ccache gcc"); UNDERTOW_NO_COMPILER=1 says that there is none.
    """
    if os.environ.get("UNDERTOW_NO_COMPILER", "0") not in ("", "0"):
        return None
    return _found(os.environ.get("UNDERTOW_CC", ""), os.environ.get("PATH", ""))


@cache
def _found(wanted: str, path: str) -> Compiler | None:
    commands = [tuple(shlex.split(wanted))] if wanted else [(c,) for c in _CANDIDATES]
    for command in commands:
        version = _version(command, path)
        if version:
            return Compiler(command, version)
    if wanted:
        raise UndertowError(f"UNDERTOW_CC = '{wanted}' is not a C compiler that runs: correct it or unset it")
    return None


def _version(command: tuple[str, ...], path: str) -> str:
    if not command or shutil.which(command[0], path=path) is None:
        return ""
    question = [] if Path(command[0]).stem.lower() == "cl" else ["--version"]
    try:
        answer = _run([*command, *question], Path.cwd())
    except UndertowError:
        return ""
    lines = (answer.stdout or answer.stderr).splitlines()
    return lines[0].strip() if lines and answer.returncode == 0 else ""


@cache
def _processor(command: tuple[str, ...]) -> str:
    """What the compiler defines for this processor, a macro on each line; empty where it cannot tell."""
    try:
        answer = _run([*command, *_LOCAL_FLAGS, "-dM", "-E", "-x", "c", os.devnull], Path.cwd())
    except UndertowError:
        return ""
    return "" if answer.returncode else "\n".join(sorted(answer.stdout.splitlines()))


def _macros(known: str) -> dict[str, str]:
    """What the compiler defines, by name."""
    return {line.split()[1]: line.split(maxsplit=2)[-1] for line in known.splitlines()}


def _at_most_256_bits(macros: dict[str, str]) -> tuple[str, ...]:
    """Options that keep the compiler from 512-bit vectors where the source has none; results stay the same.

    Intel's processors join two of their three vector ports into one for 512-bit instructions, and scalar
    arithmetic has only that one while a 512-bit instruction is in flight. One such store among the statements
    of a model, or a copy of its state, nearly doubles the time: 288 scalar multiply-adds take 40 ns, with one
    512-bit store among them 75 ns. GCC avoids it on the processors that it knows, and on no others.
    Lanes are vectors in the source and stay as wide as they are.
    """
    if "__AVX512F__" not in macros:
        return ()
    # Clang, which says that it is GCC 4, copies no wider than it computes; so did GCC before these options.
    copies = ("-mmove-max=256", "-mstore-max=256") if int(macros.get("__GNUC__", 0)) >= 12 else ()
    return ("-mprefer-vector-width=256", *copies)


def _run(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            command,
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=SETTINGS.time_limit,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise UndertowError(f"the C compiler '{command[0]}' cannot be run: {error}") from error


def compiled_or_virtual(
    requested: bool | None, build: Callable[[Compiler], T], otherwise: Callable[[], U]
) -> T | U:
    """Compiled code if wished for (True) or possible (None); else what runs without, and a logged line."""
    if requested is False:
        return otherwise()
    try:
        compiler = find_compiler()
        if compiler is None:
            raise UndertowError("no C compiler found: install one, or name one in UNDERTOW_CC")
        return build(compiler)
    except UndertowError as error:
        if requested:
            raise
        _log_backend(str(error))
    return otherwise()


@cache
def _log_backend(reason: str) -> None:
    """Say it once for each reason."""
    who = "The CasADi virtual machine runs"
    if engine_file().is_file():
        who = "The engine of this installation runs simulations, the CasADi virtual machine the rest,"
    _LOG.warning("%s. %s instead of compiled code: same results, slower", reason, who)


def loaded(library: Path) -> ctypes.CDLL:
    """A compiled library, ready to be called."""
    try:
        return ctypes.CDLL(str(library))
    except OSError as error:
        raise UndertowError(f"compiled code cannot be loaded: {error}; set UNDERTOW_NO_COMPILER=1") from error


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Address of a contiguous array."""
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


# --- fast calls from NumPy arrays -----------------------------------------------------------------
class Bound:
    """A function that reads the nonzeros of its inputs from arrays and writes those of its outputs.

    CasADi stores columns one after the other, so each of `count` evaluations is a row of these arrays.
    """

    def __init__(self, function: ca.Function, count: int = 1) -> None:
        self._buffer, self.run = (_map_over(function, count) if count > 1 else function).buffer()
        self.inputs = [np.zeros((count, function.nnz_in(i))) for i in range(function.n_in())]
        self.outputs = [np.zeros((count, function.nnz_out(i))) for i in range(function.n_out())]
        for i, array in enumerate(self.inputs):
            self._buffer.set_arg(i, memoryview(array.ravel().data))  # type: ignore[call-arg]
        for i, array in enumerate(self.outputs):
            self._buffer.set_res(i, memoryview(array.ravel().data))  # type: ignore[call-arg]


@lru_cache(maxsize=256)
def _map_over(function: ca.Function, count: int) -> ca.Function:
    """The function over `count` samples in one call; made once."""
    return function.map(count)


class Evaluator:
    """A CasADi function with dense outputs for NumPy arrays, through its buffer."""

    def __init__(self, function: ca.Function) -> None:
        self._bound = Bound(function)
        self._shapes = [function.size_out(i) for i in range(function.n_out())]

    def __call__(self, *inputs: np.ndarray | float) -> list[np.ndarray]:
        """Outputs of shape (rows, columns) for inputs of shape (size,)."""
        for array, given in zip(self._bound.inputs, inputs, strict=True):
            array[:] = given
        self._bound.run()
        # CasADi is column-major.
        return [
            a.reshape(shape[::-1]).T.copy()
            for a, shape in zip(self._bound.outputs, self._shapes, strict=True)
        ]


def load(function: ca.Function, compiler: Compiler) -> ca.Function:
    """The same function from a compiled library."""
    # CasADi's declarations export a symbol from a library that hides the others only where this is defined.
    text = "#define GCC_HASCLASSVISIBILITY\n" + c_source(function)
    source, prefix = with_unique_symbols(text, [function.name()])
    try:
        return ca.external(f"{prefix}{function.name()}", str(library_for(source, compiler)))
    except RuntimeError as error:
        raise UndertowError(f"compiled code cannot be loaded: {str(error).splitlines()[-1]}") from error
