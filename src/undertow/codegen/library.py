"""The functions of a vehicle from compiled libraries, or from the virtual machine without a compiler."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from undertow.errors import UndertowError

from .cache import library_for
from .compiler import Compiler, compiled_or_virtual
from .functions import Functions
from .source import c_source, with_unique_symbols


# --- fast calls from NumPy arrays -----------------------------------------------------------------
class Evaluator:
    """A CasADi function evaluated through its buffer for a fixed number of runs at once.

    Parameters
    ----------
    function : casadi.Function
        The function.
    batch : int
        Number of evaluations in one call.
    """

    def __init__(self, function: ca.Function, batch: int = 1) -> None:
        mapped = function.map(batch) if batch > 1 else function
        # The buffer has the arrays' addresses: nothing is copied between it and them.
        self._buffer, self._run = mapped.buffer()
        # CasADi stores columns one after the other, so a run is a row of these arrays.
        self._inputs = [np.zeros((batch, function.nnz_in(i))) for i in range(function.n_in())]
        self._outputs = [np.zeros((batch, function.nnz_out(i))) for i in range(function.n_out())]
        for i, array in enumerate(self._inputs):
            self._buffer.set_arg(i, memoryview(array.ravel().data))  # type: ignore[call-arg]
        for i, array in enumerate(self._outputs):
            self._buffer.set_res(i, memoryview(array.ravel().data))  # type: ignore[call-arg]
        self._places = [_Places(function.sparsity_out(i)) for i in range(function.n_out())]

    def __call__(self, *inputs: np.ndarray | float) -> list[np.ndarray]:
        """Outputs of shape (batch, rows, columns) for inputs of shape (batch or 1, size)."""
        for array, given in zip(self._inputs, inputs, strict=True):
            array[:] = given
        self._run()
        return [place.dense(values) for place, values in zip(self._places, self._outputs, strict=True)]


class _Places:
    """Where the nonzeros of an output belong."""

    def __init__(self, sparsity: ca.Sparsity) -> None:
        self._shape = sparsity.shape
        self._full = sparsity.is_dense()
        self._rows, self._columns = sparsity.get_triplet()

    def dense(self, nonzeros: np.ndarray) -> np.ndarray:
        rows, columns = self._shape
        if self._full:
            return nonzeros.reshape(len(nonzeros), columns, rows).transpose(0, 2, 1).copy()
        result = np.zeros((len(nonzeros), rows, columns))
        result[:, self._rows, self._columns] = nonzeros
        return result


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
