"""Types that many modules name in their signatures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from undertow.errors import UndertowError

Array = NDArray[np.float64]
Integers = NDArray[np.int64]
Flags = NDArray[np.bool_]
#: Places in another array.
Index = NDArray[np.intp]
#: Told how much of a piece of work is done, 0 to 1, and in words what is being done.
Progress = Callable[[float, str], None]


def number_array(name: str, values: ArrayLike) -> Array:
    """Values as an array, or a refusal that names them."""
    try:
        return np.array(values, dtype=float, ndmin=1)
    except (TypeError, ValueError) as error:
        raise UndertowError(
            f"{name} is given as {type(values).__name__}: give an array of numbers"
        ) from error
