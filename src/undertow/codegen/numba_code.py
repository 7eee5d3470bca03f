"""Functions that numba compiles, kept in the user's own cache folder."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from undertow.errors import UndertowError

from .cache import cache_folder
from .source import digest

F = TypeVar("F", bound=Callable[..., object])
_LOG = logging.getLogger("undertow")
_HERE = Path(__file__).parent


def by_numba(function: F) -> F:
    """The function, compiled when it is first called; divisions by zero give infinity as in C.

    Numba takes code from its cache if the function's own file is unchanged; whatever that file may use is in
    the name of the folder.
    """
    from numba import config, njit

    ours, theirs = cache_folder() / f"numba-{_sources(function)}", config.CACHE_DIR
    config.CACHE_DIR = str(ours)
    try:
        compiled: F = njit(error_model="numpy", nogil=True, cache=True)(function)
    finally:
        config.CACHE_DIR = theirs
    return compiled


def tried(action: Callable[[], object]) -> None:
    """Have everything compiled by calling it once.

    Raises
    ------
    UndertowError
        If the cache folder cannot take it.
    """
    _LOG.info("numba takes some seconds to compile an interpreter where its cache does not hold it")
    try:
        action()
    except OSError as error:
        raise UndertowError(
            f"cannot keep what numba compiled: {error}; make room or set XDG_CACHE_HOME"
        ) from error


def _sources(function: Callable[..., object]) -> str:
    own = Path(function.__code__.co_filename)
    files = {own, *(_HERE / name for name in ("instructions.py", "interpreter.py", "interpreted.py"))}
    return digest("".join(path.read_text(encoding="utf-8") for path in sorted(files)))[:16]
