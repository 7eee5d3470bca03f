"""C source as text: of CasADi functions, of operations, and of the engine that runs instructions as data.

The build of a wheel reads this module alone: it needs nothing but Python's own library.
"""

from __future__ import annotations

import hashlib
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import casadi as ca

_UNUSED = re.compile(
    r"^((?:static |CASADI_SYMBOL_EXPORT )?int \w+\(const casadi_real\*\* .*int mem\) ?\{)$", re.MULTILINE
)
_INFIX = {
    **{"OP_ADD": "+", "OP_SUB": "-", "OP_MUL": "*", "OP_DIV": "/"},
    **{"OP_LT": "<", "OP_LE": "<=", "OP_EQ": "==", "OP_NE": "!=", "OP_AND": "&&", "OP_OR": "||"},
}
CALLS = {
    **{"OP_SIN": "sin", "OP_COS": "cos", "OP_TAN": "tan", "OP_ASIN": "asin", "OP_ACOS": "acos"},
    **{"OP_ATAN": "atan", "OP_ATAN2": "atan2", "OP_SINH": "sinh", "OP_COSH": "cosh", "OP_TANH": "tanh"},
    **{"OP_EXP": "exp", "OP_LOG": "log", "OP_SQRT": "sqrt", "OP_POW": "pow", "OP_CONSTPOW": "pow"},
    **{"OP_FABS": "fabs", "OP_FMIN": "fmin", "OP_FMAX": "fmax", "OP_FLOOR": "floor"},
}
TWO_OPERANDS = ("OP_ATAN2", "OP_POW", "OP_CONSTPOW", "OP_FMIN", "OP_FMAX")
FORMS: dict[str, str] = {
    "OP_NEG": "-{0}",
    "OP_SQ": "{0} * {0}",
    "OP_TWICE": "2 * {0}",
    "OP_INV": "1 / {0}",
    "OP_NOT": "!{0}",
    "OP_SIGN": "{0} != {0} ? {0} : ({0} > 0) - ({0} < 0)",
    "OP_IF_ELSE_ZERO": "{0} != 0 ? {1} : 0",
    **{k: f"{{0}} {v} {{1}}" for k, v in _INFIX.items()},
    **{k: f"{v}({{0}}, {{1}})" if k in TWO_OPERANDS else f"{v}({{0}})" for k, v in CALLS.items()},
}
"""C expression of every operation by CasADi's name for it, with {0} and {1} for the operands."""

LIBRARY_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
_UNDERTOW = Path(__file__).parents[1]
_INCLUDE = re.compile(r'^#include "(.+)"$', re.MULTILINE)
_RELEASE = re.compile(r"^(CASADI_SYMBOL_EXPORT void \w+_release\(int mem\) \{)$", re.MULTILINE)


def c_source(function: ca.Function) -> str:
    """C source of one function, without compiler warnings."""
    import casadi as ca  # the build of a wheel has none

    generator = ca.CodeGenerator("undertow_model.c", {"verbose": False})
    generator.add(function)
    text = generator.dump()
    text = _UNUSED.sub(r"\1\n  (void)iw;\n  (void)w;\n  (void)mem;", text)
    return _RELEASE.sub(r"\1\n  (void)mem;", text)


def with_unique_symbols(source: str, names: Sequence[str]) -> tuple[str, str]:
    """The source with the exported `names` prefixed by its own hash, and the prefix.

    Two libraries in one process may then hold functions of the same kind without meeting.
    """
    prefix = f"undertow_{digest(source)[:16]}_"
    exported = "|".join(map(re.escape, names))
    return re.sub(rf"\b(?=(?:{exported})(?:_[a-z]+)*\b)", prefix, source), prefix


def with_entries(text: str, *names: str) -> tuple[str, str]:
    """The source with its entry points, called by macros in capitals, and what their names begin with."""
    prefix = f"undertow_{digest(text)[:16]}_"
    return "".join(f"#define {name.upper()} {prefix}{name}\n" for name in names) + text, prefix


def integers(name: str, values: Sequence[int]) -> str:
    """A constant array in C, which has no empty ones."""
    return f"static const int {name}[] = {{{', '.join(map(str, values or [0]))}}};"


def digest(text: str) -> str:
    """SHA-256 of a text, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


def c_file(name: str, package: str = "undertow.codegen") -> str:
    """One of our C files, with those of this package that it includes."""
    folder = _UNDERTOW.joinpath(*package.split(".")[1:])
    text = (folder / name).read_text(encoding="utf-8")
    return _INCLUDE.sub(lambda found: c_file(found[1]), text)


EXPORTED = c_file("portable.h")
"""What stands before a function that a library offers."""

# --- the engine -----------------------------------------------------------------------------------
INSTRUCTIONS = {name: k for k, name in enumerate([*FORMS, "OP_ASSIGN", "OP_INPUT", "OP_OUTPUT", "OP_CONST"])}
"""The engine's own number of everything that CasADi has a name for."""


#: States of logs that the engine carries on side by side: more would mostly be done for nothing, since logs
#: differ in length.
CHAINS = 4


def engine_source() -> tuple[str, str]:
    """C source of what runs the instructions of any model, and what its entry points begin with."""
    names = {"INPUT": "OP_INPUT", "OUTPUT": "OP_OUTPUT", "CONSTANT": "OP_CONST"}
    special = [f"#define {name} {INSTRUCTIONS[code]}" for name, code in names.items()]
    cases = " ".join(
        f"case {INSTRUCTIONS[code]}: "
        f"for (int l = 0; l < block; l++) r[l] = {form.format('a[l]', 'b[l]')}; break;"
        for code, form in {**FORMS, "OP_ASSIGN": "{0}"}.items()
    )
    parts = [
        *special,
        f"#define CASES {cases}",
        f"#define CHAINS {CHAINS}",
        "#define INTERPRETED",
        c_file("tape.c"),
        c_file("tangents.c"),
    ]
    return with_entries("\n".join(parts), "at_samples", "carry", "simulate")


def engine_file() -> Path:
    """Where a wheel that was built with a compiler brings the engine along."""
    return Path(__file__).with_name(f"_engine{LIBRARY_SUFFIX}")
