"""Budgets on the length of functions and modules, and calls that must not be there."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from statistics import median
from typing import NamedTuple

import pytest

SOURCE = Path(__file__).parents[1] / "src" / "undertow"

MEDIAN, MOST, LONGEST, MODULE = 8, 25, 60, 600
FORBIDDEN_CALLS = {"eval", "exec", "builtins.eval", "builtins.exec", "os.system"}
STRING_READERS = {"sympify", "parse_expr"}  # SymPy evaluates text as Python
FORBIDDEN_MODULES = {"pickle", "dill", "cloudpickle", "marshal", "shelve"}
FORBIDDEN_FLAGS = {"shell", "allow_pickle"}


class Body(NamedTuple):
    lines: int
    where: str


@cache
def _modules() -> dict[str, tuple[str, ast.Module]]:
    texts = {str(path.relative_to(SOURCE)): path.read_text(encoding="utf-8") for path in SOURCE.rglob("*.py")}
    return {name: (text, ast.parse(text)) for name, text in sorted(texts.items())}


@cache
def _bodies() -> list[Body]:
    """Every function, the longest first; docstring and blank lines are not counted."""
    found = []
    for name, (text, tree) in _modules().items():
        lines = text.splitlines()
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                found.append(Body(_length(node, lines), f"{name}:{node.lineno} {node.name}"))
    return sorted(found, reverse=True)


def _length(function: ast.FunctionDef | ast.AsyncFunctionDef, lines: list[str]) -> int:
    body = function.body[1:] if ast.get_docstring(function, clean=False) is not None else function.body
    if not body:
        return 0
    return sum(bool(line.strip()) for line in lines[body[0].lineno - 1 : function.end_lineno])


def _listed(bodies: list[Body]) -> str:
    return "".join(f"\n  {body.lines:3d} lines  {body.where}" for body in bodies)


def test_no_function_is_long() -> None:
    long = [body for body in _bodies() if body.lines > LONGEST]
    assert not long, f"longer than {LONGEST} lines:{_listed(long)}"


def test_nine_functions_in_ten_are_short() -> None:
    bodies = _bodies()
    long = [body for body in bodies if body.lines > MOST]
    allowed = len(bodies) // 10
    assert len(long) <= allowed, (
        f"{len(long)} functions have more than {MOST} lines, {allowed} may:{_listed(long)}"
    )


def test_the_usual_function_is_a_few_lines() -> None:
    bodies = _bodies()
    middle = median(body.lines for body in bodies)
    assert middle <= MEDIAN, f"median {middle} lines, at most {MEDIAN}; the longest:{_listed(bodies[:20])}"


def test_no_module_is_long() -> None:
    sizes = {
        name: sum(bool(line.strip()) for line in text.splitlines()) for name, (text, _) in _modules().items()
    }
    long = {name: size for name, size in sizes.items() if size > MODULE}
    assert not long, f"modules with more than {MODULE} lines that are not blank: {long}"


def _offences(tree: ast.Module) -> Iterator[tuple[int, str]]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names if _is_banned(alias.name))
        elif isinstance(node, ast.ImportFrom) and _is_banned(node.module or ""):
            yield node.lineno, node.module or ""
        elif isinstance(node, ast.Call):
            yield from ((node.lineno, what) for what in _call_offences(node))


def _is_banned(module: str) -> bool:
    return module.partition(".")[0] in FORBIDDEN_MODULES


def _call_offences(call: ast.Call) -> Iterator[str]:
    name = ast.unparse(call.func)
    flags = {str(keyword.arg): ast.unparse(keyword.value) for keyword in call.keywords}
    if name in FORBIDDEN_CALLS:
        yield f"{name}(...)"
    if name.rpartition(".")[2] in STRING_READERS and flags.get("strict") != "True":
        yield f"{name}(...) without strict=True, which refuses text"
    yield from (f"{flag}={flags[flag]}" for flag in FORBIDDEN_FLAGS & {*flags} if flags[flag] != "False")


def test_nothing_from_a_file_can_be_executed() -> None:
    found = [
        f"{name}:{line} {what}" for name, (_, tree) in _modules().items() for line, what in _offences(tree)
    ]
    assert not found, "not allowed in undertow: " + "; ".join(found)


@pytest.mark.parametrize(
    "code",
    [
        "eval(text)",
        "builtins.exec(text)",
        "sympy.sympify(text)",
        "from pickle import loads",
        "import marshal as m",
        "subprocess.run(line, shell=True)",
        "subprocess.run(line, shell=flag)",
        "np.load(path, allow_pickle=True)",
        "os.system(line)",
    ],
)
def test_the_check_sees_what_it_should(code: str) -> None:
    assert len(list(_offences(ast.parse(code)))) == 1


@pytest.mark.parametrize(
    "code",
    [
        "expression.eval()",
        "run(line, shell=False)",
        "def exec(): pass",
        "platform.system()",
        "sympify(3, strict=True)",
    ],
)
def test_the_check_lets_other_things_pass(code: str) -> None:
    assert not list(_offences(ast.parse(code)))
