"""Calls into compiled libraries."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np

from undertow.errors import UndertowError


def loaded(library: Path) -> ctypes.CDLL:
    """A compiled library, ready to be called.

    Raises
    ------
    UndertowError
        If the system cannot load it.
    """
    try:
        return ctypes.CDLL(str(library))
    except OSError as error:
        raise UndertowError(f"compiled code cannot be loaded: {error}; set UNDERTOW_NO_COMPILER=1") from error


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    """Address of a contiguous array."""
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)
