"""Functions of numbers from expressions: the one place that calls SymPy's printer of Python code."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import sympy as sm

__all__ = ["function_of"]


def function_of(
    names: Sequence[sm.Symbol], expressions: Any, functions: str | Mapping[str, Callable[..., Any]] = "math"
) -> Callable[..., Any]:
    """A function of the named symbols that returns the values of expressions, nested as they are.

    Parameters
    ----------
    names : sequence of sympy.Symbol
        Arguments of the function, in order.
    expressions : sympy.Expr, or lists of them to any depth
        What it returns. Text is refused: it would be run.
    functions : str or mapping, default "math"
        "math" for floats, "numpy" for arrays, or what stands for sin, cos, tan.

    Raises
    ------
    TypeError
        Something is not an expression of SymPy.
    """
    _check([*names, expressions])
    modules = functions if isinstance(functions, str) else [dict(functions)]
    found: Callable[..., Any] = sm.lambdify(list(names), expressions, modules, cse=modules == "math")
    return found


def _check(found: Any) -> None:
    if isinstance(found, list | tuple):
        for part in found:
            _check(part)
    elif not isinstance(found, sm.Basic):
        raise TypeError(f"{found!r} is not an expression of SymPy")
