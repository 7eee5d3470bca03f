"""C source of CasADi functions, as text that depends on nothing but the model."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence

import casadi as ca

_UNUSED = re.compile(
    r"^((?:static |CASADI_SYMBOL_EXPORT )?int \w+\(const casadi_real\*\* .*int mem\) ?\{)$", re.MULTILINE
)
_RELEASE = re.compile(r"^(CASADI_SYMBOL_EXPORT void \w+_release\(int mem\) \{)$", re.MULTILINE)


def c_source(function: ca.Function) -> str:
    """C source of one function, without compiler warnings."""
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


def with_entry(text: str, macro: str, ending: str) -> tuple[str, str]:
    """The source with its entry point, which it calls by a macro, named by its own hash, and that name."""
    name = f"undertow_{digest(text)[:16]}_{ending}"
    return f"#define {macro} {name}\n{text}", name


def integers(name: str, values: Sequence[int]) -> str:
    """A constant array in C, which has no empty ones."""
    return f"static const int {name}[] = {{{', '.join(map(str, values or [0]))}}};"


def digest(text: str) -> str:
    """SHA-256 of a text, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()


EXPORTED = """\
#if defined(_WIN32)
#define EXPORTED __declspec(dllexport)
#elif defined(__GNUC__)
#define EXPORTED __attribute__((visibility("default")))
#else
#define EXPORTED
#endif
"""
"""What stands before a function that a library offers."""

SEPARATE = """\
#if defined(__GNUC__)
#define SEPARATE __attribute__((noinline))
#else
#define SEPARATE
#endif
"""
"""What stands before a model: in its only caller it takes twice as long to compile and runs no faster."""
