"""The panel method capytaine, brought in when it is needed and kept from talking."""

from __future__ import annotations

import importlib
import logging
from importlib.util import find_spec
from typing import Any

from undertow.errors import UndertowError

INSTALL = 'pip install "undertow[bem]"'


def has_capytaine() -> bool:
    """Whether the package is installed."""
    return find_spec("capytaine") is not None


def quiet_capytaine() -> Any:
    """The package capytaine, which speaks up for errors only.

    Raises
    ------
    UndertowError
        If it is not installed.
    """
    root, silent = logging.getLogger(), logging.NullHandler()
    # On import it gives the root logger a handler to stdout, unless there is one.
    root.addHandler(silent)
    try:
        package = importlib.import_module("capytaine")
    except ImportError as error:
        raise UndertowError(
            f"added mass by panels needs capytaine, which is not installed ({error}): {INSTALL}"
        ) from error
    finally:
        root.removeHandler(silent)
    logging.getLogger("capytaine").setLevel(logging.ERROR)
    return package
