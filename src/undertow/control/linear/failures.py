"""Failures of linear algebra on numbers that span too much, told in one line."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import control as ct
import numpy as np

from undertow.errors import UndertowError

_LOOK = "look for a value in the vehicle, the gains or the options that is off by powers of ten"


@contextmanager
def told(
    what: str = "linear algebra fails on these numbers", remedy: str = _LOOK, *more: type[Exception]
) -> Iterator[None]:
    """Tell failures of NumPy, SciPy and python-control as one of the input.

    Parameters
    ----------
    what, remedy : str
        Beginning and end of the line.
    more : type
        Exceptions that count, too.

    Raises
    ------
    UndertowError
        If something fails.
    """
    try:
        yield
    except (np.linalg.LinAlgError, ct.ControlArgument, *more) as failure:
        raise UndertowError(f"{what}: {str(failure).rstrip('.')}; {remedy}") from failure
