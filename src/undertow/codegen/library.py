"""The functions of a vehicle from compiled libraries, or from the virtual machine without a compiler."""

from __future__ import annotations

from functools import cached_property

import casadi as ca

from undertow.errors import UndertowError

from .buffers import Direct, Evaluator
from .cache import library_for
from .compiler import Compiler, compiled_or_virtual
from .functions import Functions
from .source import c_source, with_unique_symbols


class Compiled:
    """The functions of a vehicle, each compiled when it is first asked for.

    Parameters
    ----------
    functions : Functions
        The model.
    compiled : bool, optional
        True compiles (and fails without a C compiler), False uses CasADi's virtual machine; by default
        compiled code is used where a compiler is found, and one logged line says so where none is.

    Raises
    ------
    UndertowError
        On access, if `compiled` is True and there is no C compiler or it fails.
    """

    def __init__(self, functions: Functions, *, compiled: bool | None = None) -> None:
        self._functions = functions
        self._wish = compiled

    @cached_property
    def dynamics(self) -> ca.Function:
        """`x_dot = dynamics(x, u, p, t)`."""
        return self._ready(self._functions.dynamics)

    @cached_property
    def jacobians(self) -> ca.Function:
        """`(x_dot, A, B, P) = jacobians(x, u, p, t)`."""
        return self._ready(self._functions.jacobians)

    @cached_property
    def regressor(self) -> ca.Function:
        """`Y = regressor(x, nu_dot, u, p, t)`."""
        return self._ready(self._functions.regressor)

    @cached_property
    def residual(self) -> ca.Function:
        """`r = residual(x, nu_dot, u, p, t)`."""
        return self._ready(self._functions.residual_function)

    @cached_property
    def outputs(self) -> ca.Function:
        """`y = outputs(x, u, p, t)`."""
        return self._ready(self._functions.outputs)

    def evaluator(self, name: str, batch: int = 1) -> Evaluator:
        """One of the functions for NumPy arrays, `batch` evaluations in a call, through its buffer."""
        return Evaluator(getattr(self, name), batch)

    def direct(self, name: str) -> Direct:
        """One of the functions on fixed arrays: the cheapest call from Python."""
        return Direct(getattr(self, name))

    def _ready(self, function: ca.Function) -> ca.Function:
        return compiled_or_virtual(self._wish, lambda compiler: load(function, compiler), lambda: function)


def load(function: ca.Function, compiler: Compiler) -> ca.Function:
    """The same function from a compiled library.

    Raises
    ------
    UndertowError
        If the compiler fails.
    """
    # CasADi's declarations export a symbol from a library that hides the others only where this is defined.
    text = "#define GCC_HASCLASSVISIBILITY\n" + c_source(function)
    source, prefix = with_unique_symbols(text, [function.name()])
    try:
        return ca.external(f"{prefix}{function.name()}", str(library_for(source, compiler)))
    except RuntimeError as error:
        raise UndertowError(f"compiled code cannot be loaded: {str(error).splitlines()[-1]}") from error
