"""Channels as formulas in the columns of a log: read as arithmetic, never run as code."""

from __future__ import annotations

import ast
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from undertow.errors import UndertowError, nearest
from undertow.typing import Array


@dataclass(frozen=True)
class FormulaLimits:
    """What a formula can be: more is a program, or a mistake."""

    characters: int = 500
    parts: int = 200  # numbers, names and operations


_LIMITS = FormulaLimits()
_OPERATIONS: dict[type[ast.AST], Callable[..., Any]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
}
_FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    **{n: (getattr(np, n), 1) for n in ("sqrt", "exp", "log", "sin", "cos", "tan", "sign", "floor")},
    "abs": (np.abs, 1),
    "atan2": (np.arctan2, 2),
    "hypot": (np.hypot, 2),
    "min": (np.minimum, 2),
    "max": (np.maximum, 2),
    "clip": (np.clip, 3),
}
_NUMBERS = {"pi": np.pi}
_COLUMN = "column"  # column("any name") stands for a column whose name is no identifier


@dataclass(frozen=True)
class Formula:
    """An arithmetic expression in columns.

    Numbers, names of columns, ``+ - * / **``, parentheses, `column("a name")` and the functions above;
    anything else is refused.
    """

    text: str

    def __post_init__(self) -> None:
        _ = self.columns

    @cached_property
    def _tree(self) -> ast.expr:
        if len(self.text) > _LIMITS.characters:
            start, most = self.text[:40], _LIMITS.characters
            raise UndertowError(f"formula {start!r}... is longer than {most} characters: shorten it")
        try:
            tree = ast.parse(self.text.strip(), mode="eval")
        except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
            raise UndertowError(f"formula {self.text!r} is no arithmetic: {error}") from error
        if sum(1 for _ in ast.walk(tree)) > _LIMITS.parts:
            raise UndertowError(f"formula {self.text!r} has more than {_LIMITS.parts} parts: shorten it")
        return tree.body

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns in it."""
        found: dict[str, None] = {}
        self._walk(self._tree, lambda name: found.setdefault(name) or np.nan)
        return tuple(found)

    def of(self, cells: Mapping[str, Array]) -> Array:
        """Its values at cells, shape (n,) each; what has no value (a division by zero) is NaN or infinite."""
        with np.errstate(all="ignore"):
            values = self._walk(self._tree, lambda name: cells[name])
        shape = np.shape(next(iter(cells.values()), np.zeros(())))
        return np.array(np.broadcast_to(np.asarray(values, dtype=float), shape))

    def _walk(self, node: ast.expr, column: Callable[[str], Any]) -> Any:
        """Value of a part of the tree."""
        match node:
            case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
                return float(number)
            case ast.Name(id=name):
                return _NUMBERS[name] if name in _NUMBERS else column(name)
            case ast.UnaryOp(op=op, operand=inner) if type(op) in _OPERATIONS:
                return _OPERATIONS[type(op)](self._walk(inner, column))
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
                return _OPERATIONS[type(op)](self._walk(left, column), self._walk(right, column))
            case ast.Call(func=ast.Name(id=name), args=[ast.Constant(value=str(text))], keywords=[]) if (
                name == _COLUMN
            ):
                return column(text)
            case ast.Call(func=ast.Name(id=name), args=arguments, keywords=[]):
                return self._function(name, len(arguments))(*(self._walk(a, column) for a in arguments))
        part = ast.unparse(node)
        raise UndertowError(f"formula {self.text!r} has {part!r}, which is no arithmetic: {_HOW}")

    def _function(self, name: str, count: int) -> Callable[..., Any]:
        if name not in _FUNCTIONS:
            hint = nearest(name, _FUNCTIONS)
            raise UndertowError(f"formula {self.text!r}: function {name!r} is not known{hint}: {_HOW}")
        function, wanted = _FUNCTIONS[name]
        if count != wanted:
            raise UndertowError(f"formula {self.text!r}: {name} takes {wanted} numbers, found {count}")
        return function


_HOW = f"write numbers, columns, + - * / ** and {', '.join(_FUNCTIONS)}"
