"""Names, comments, constants, structs and functions of files as generated C spells them."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import isinf

import casadi as ca

from undertow.errors import UndertowError

from .compiler import Structs, Words, plain_c, signature
from .manifest import Entry
from .source import CALLS, FORMS, TWO_OPERANDS

# Words of C that no member of a struct may have as its name.
_TAKEN = frozenset(
    """auto break case char const continue default do double else enum extern float for goto if inline int
    long register return short signed sizeof static struct switch typedef union unsigned void volatile while
    restrict""".split()  # noqa: SIM905
)
_COMPARED = {"OP_LT": "<", "OP_LE": "<=", "OP_EQ": "==", "OP_NE": "!="}
# Scalars that functions of a library take by value.
_SCALARS = ("t", "dt", "y")


# --- names from files in C --------------------------------------------------------------------
def slug(name: str) -> str:
    """A folder name for a vehicle or a controller."""
    slug = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-")[:60].strip("-")
    if not slug:
        raise UndertowError(f"the name '{name}' gives no folder name: use letters and digits")
    return slug


def identifier(folder: str) -> str:
    """The name of a folder as one in C."""
    name = folder.replace("-", "_")
    return name if name[0].isalpha() else f"v_{name}"


def fill(template: str, fields: Mapping[str, object]) -> str:
    """A template with its @FIELDS@ filled in."""
    return re.sub(r"@([A-Z_]+)@", lambda match: str(fields[match[1]]), template)


def comment(text: str) -> str:
    """Text that ends neither a comment nor a line of a comment."""
    return re.sub(r"[^\w .,:;()+=-]", "_", text, flags=re.ASCII)


def listing(entries: Iterable[Entry]) -> str:
    """Entries as lines of a comment in C: index, name, value and unit."""
    lines = []
    for i, e in enumerate(entries):
        value = "" if e.value is None else f" = {e.value!r}"
        lines.append(f"     [{i}] {comment(e.name)}{value} {_unit(e)}".rstrip())
    return "\n".join(lines) or "     none"


def _unit(entry: Entry) -> str:
    return re.sub(r"[^\w ()^/.-]", "_", entry.unit, flags=re.ASCII)


# --- a library's C ------------------------------------------------------------------------------
@dataclass(frozen=True)
class Struct:
    """A struct of numbers: its type and members, what declares it in a header, and its default values."""

    type: str
    members: tuple[str, ...]
    declarations: str
    definitions: str


class Dialect:
    """C of one library, whose names begin with its own; every constant has the type of its numbers."""

    def __init__(self, library: str) -> None:
        self.library, self.real, self.call = library, f"{library}_real", f"{library.upper()}_CALL"
        self._words = _words(self.real, self.call)

    def constant(self, value: float) -> str:
        """A number; one without a bound is infinite."""
        if isinf(value):
            return f"({self.real}){'-' if value < 0 else ''}INFINITY"
        return f"({self.real}){float(value)!r}"

    def struct(self, name: str, entries: Sequence[Entry]) -> Struct:
        """A struct of entries with values, and `NAME_default` with these."""
        members = _members(e.name for e in entries) or ("unused",)
        entries = entries or [Entry("unused", "", 0.0)]
        lines = [
            f"  {self.real} {m};" + (f" /* {_unit(e)} */" if e.unit else "")
            for m, e in zip(members, entries, strict=True)
        ]
        values = ",\n  ".join(self.constant(e.value or 0.0) for e in entries)
        declared = (
            f"typedef struct {{\n{chr(10).join(lines)}\n}} {name};\nextern const {name} {name}_default;\n"
        )
        return Struct(name, members, declared, f"const {name} {name}_default = {{\n  {values}}};\n")

    def prototype(self, function: ca.Function, name: str, structs: Mapping[str, Struct]) -> str:
        """The prototype of a function in C."""
        return (
            signature(function, name, words=self._words, structs=_typed(structs), by_value=_scalars(function))
            + ";"
        )

    def definition(
        self, function: ca.Function, name: str, structs: Mapping[str, Struct], *, static: bool = False
    ) -> str:
        """The function itself; inputs of which a struct is given are pointers to one."""
        prefix = "static " if static else ""
        typed, scalars = _typed(structs), _scalars(function)
        return plain_c(function, name, words=self._words, prefix=prefix, structs=typed, by_value=scalars)


def _typed(structs: Mapping[str, Struct]) -> Structs:
    return {n: (s.type, s.members) for n, s in structs.items()}


def _scalars(function: ca.Function) -> tuple[str, ...]:
    return tuple(n for n in function.name_in() if n in _SCALARS and function.numel_in(n) == 1)


def _words(real: str, call: str) -> Words:
    one, zero = f"({real})1", f"({real})0"
    calls = {k: f"{call}({v})({'{0}, {1}' if k in TWO_OPERANDS else '{0}'})" for k, v in CALLS.items()}
    truth = {k: f"({{0}} {sign} {{1}}) ? {one} : {zero}" for k, sign in _COMPARED.items()}
    forms = {
        **{k: FORMS[k] for k in ("OP_ADD", "OP_SUB", "OP_MUL", "OP_DIV", "OP_NEG", "OP_SQ")},
        **calls,
        **truth,
        "OP_TWICE": f"({real})2 * {{0}}",
        "OP_INV": f"{one} / {{0}}",
        "OP_NOT": f"({{0}} == {zero}) ? {one} : {zero}",
        "OP_AND": f"(({{0}} != {zero}) && ({{1}} != {zero})) ? {one} : {zero}",
        "OP_OR": f"(({{0}} != {zero}) || ({{1}} != {zero})) ? {one} : {zero}",
        "OP_SIGN": f"({{0}} > {zero}) ? {one} : (({{0}} < {zero}) ? ({real})-1 : {{0}})",
        "OP_IF_ELSE_ZERO": f"({{0}} != {zero}) ? {{1}} : {zero}",
    }
    return Words(real, f"({real}){{}}", forms, share_work=False)


def _members(names: Iterable[str]) -> tuple[str, ...]:
    """Names as members of a struct, each once."""
    found: list[str] = []
    for name in names:
        plain = re.sub(r"\W", "_", name, flags=re.ASCII)
        plain = f"p_{plain}" if plain in _TAKEN or not plain[:1].isalpha() else plain
        while plain in found:
            plain += "_"
        found.append(plain)
    return tuple(found)


# --- modules of a library --------------------------------------------------------------------------
@dataclass(frozen=True)
class Part:
    """One module of the library: a header, a source and an example."""

    title: str  # what it is, for the first line of the header
    notes: Mapping[str, Sequence[Entry]]  # entries that the header lists, by what they are
    # declared, defined: lines of header and source
    declarations: Sequence[str]
    definitions: Sequence[str]
    example: str  # body of the main function that shows how it is used
    # whether its source says what the manifest's rows and parameters say; otherwise text is compared
    about_model: bool = False


Writer = Callable[[Dialect], Part]
