"""What a simulation is given, as arrays of a batch of runs."""

from __future__ import annotations

import numpy as np

from undertow.errors import UndertowError
from undertow.typing import Array

from .functions import Functions


def checked_runs(
    functions: Functions, x0: Array, t: Array, u: Array, p: Array
) -> tuple[Array, Array, Array, Array]:
    """The same with a leading size of the batch, or of one where the runs share it.

    Raises
    ------
    UndertowError
        If a shape does not fit, or the times are not finite or decrease.
    """
    start = _checked("x0", x0, (len(functions.state_names),))
    batch = len(start)
    times = _checked("t", t, (None,), batch)
    samples = times.shape[1]
    if not samples:
        raise UndertowError("t holds no samples: give at least the time of the initial state")
    inputs = _checked("u", u, (samples, functions.u.numel()), batch)
    parameters = _checked("p", p, (functions.p.numel(),), batch)
    if not (np.isfinite(times).all() and (np.diff(times, axis=1) >= 0).all()):
        raise UndertowError(
            "times of the samples are not finite or go back: sort the log, drop samples without time"
        )
    return start, times, inputs, parameters


def _checked(name: str, array: Array, shape: tuple[int | None, ...], batch: int | None = None) -> Array:
    """The array as contiguous floats with a leading size of one or of the batch."""
    values = np.ascontiguousarray(array, dtype=float)
    if values.ndim == len(shape):
        values = values[None]
    fits = values.ndim == len(shape) + 1 and all(
        wanted in (None, size) for size, wanted in zip(values.shape[1:], shape, strict=True)
    )
    if not fits or (batch is not None and values.shape[0] not in (1, batch)):
        wanted = ", ".join("n" if s is None else str(s) for s in shape)
        runs = "" if batch is None else f" for each of {batch} runs"
        raise UndertowError(f"{name} has shape {np.shape(array)}: give ({wanted}){runs}")
    return values
