"""Fast calls of CasADi functions from NumPy arrays."""

from __future__ import annotations

import casadi as ca
import numpy as np


class Direct:
    """A CasADi function on fixed arrays: write into `inputs`, call, read `outputs`; nothing is copied.

    Each array holds the nonzeros, column by column, of the input or output of that name.

    Parameters
    ----------
    function : casadi.Function
        The function.

    Attributes
    ----------
    inputs, outputs : dict of ndarray
        The arrays by name.
    run : callable
        Evaluates the function; calling it costs less than calling the object.
    """

    def __init__(self, function: ca.Function) -> None:
        self._buffer, self.run = function.buffer()
        self.inputs = {n: np.zeros(function.nnz_in(i)) for i, n in enumerate(function.name_in())}
        self.outputs = {n: np.zeros(function.nnz_out(i)) for i, n in enumerate(function.name_out())}
        for i, array in enumerate(self.inputs.values()):
            self._buffer.set_arg(i, memoryview(array.data))  # type: ignore[call-arg]
        for i, array in enumerate(self.outputs.values()):
            self._buffer.set_res(i, memoryview(array.data))  # type: ignore[call-arg]

    def __call__(self) -> None:
        self.run()


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
        direct = Direct(function.map(batch) if batch > 1 else function)
        self._call = direct
        # CasADi stores columns one after the other, so a run is a row of these arrays.
        self._inputs = [a.reshape(batch, a.size // batch) for a in direct.inputs.values()]
        self._outputs = [a.reshape(batch, a.size // batch) for a in direct.outputs.values()]
        self._places = [_Places(function.sparsity_out(i)) for i in range(function.n_out())]

    def __call__(self, *inputs: np.ndarray | float) -> list[np.ndarray]:
        """Outputs of shape (batch, rows, columns) for inputs of shape (batch or 1, size)."""
        for array, given in zip(self._inputs, inputs, strict=True):
            array[:] = given
        self._call()
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
