"""What undertow says beside its answers: warnings always, what is going on with ``-v``."""

from __future__ import annotations

import logging
import sys


class _ToStderr(logging.Handler):
    """Prints to the stderr of the moment, so that a progress bar on the terminal can step aside for it."""

    def emit(self, record: logging.LogRecord) -> None:
        prefix = "" if record.levelno < logging.WARNING else f"{record.levelname.lower()}: "
        print(f"{prefix}{self.format(record)}", file=sys.stderr)


def talk(verbose: bool) -> None:
    """Send the log of undertow to stderr: warnings, with `verbose` also what is going on."""
    logger = logging.getLogger("undertow")
    for handler in [handler for handler in logger.handlers if isinstance(handler, _ToStderr)]:
        logger.removeHandler(handler)
    logger.addHandler(_ToStderr())
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    # It says in several lines where it keeps its list of fonts when the home cannot be written.
    logging.getLogger("matplotlib").setLevel(logging.WARNING if verbose else logging.ERROR)
