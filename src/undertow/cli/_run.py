"""From exceptions to one line and an exit code."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable

import typer

from undertow import __version__
from undertow.errors import UndertowError

from ._interrupting import insisting

INPUT_ERROR = 2
INTERRUPTED = 130
_BUG = 1


def run(action: Callable[[], object]) -> int:
    """Run a command line and turn what it raises into a message on stderr and an exit code.

    Parameters
    ----------
    action
        Runs the command; an int it returns is the exit code, anything else means 0.

    Returns
    -------
    int
        2 for a foreseeable failure (one line ``error: ...``), 130 for Ctrl-C, 1 for a bug (with traceback).
    """
    try:
        with insisting():
            answer = action()
        code = _code(answer)
        sys.stdout.flush()
    except BrokenPipeError:  # `undertow effects | head`: the reader has seen enough
        code = 1
    except (Exception, KeyboardInterrupt) as failure:
        code = _tell(failure)
    _drop_unwritable_output()
    return code


def _code(answer: object) -> int:
    code = answer if isinstance(answer, int) and not isinstance(answer, bool) else 0
    if code == INTERRUPTED:  # typer has already turned Ctrl-C into this code
        _line("interrupted")
    return code


def _tell(failure: BaseException) -> int:
    if isinstance(failure, KeyboardInterrupt | typer.Abort):
        return _line("interrupted", INTERRUPTED)
    if isinstance(failure, UndertowError):
        return _line(f"error: {_one_line(str(failure))}", INPUT_ERROR)
    if isinstance(failure, typer.TyperException):
        return _usage(failure)
    if isinstance(failure, OSError) and failure.strerror:
        return _line(_one_line(f"error: {_place(failure)}{failure.strerror.lower()}"), INPUT_ERROR)
    return _bug(failure)


def _usage(failure: typer.TyperException) -> int:
    message = failure.format_message()
    if not message.startswith("Usage:"):  # a bare group asks for its help to be shown
        context = getattr(failure, "ctx", None)
        path = context.command_path if context else "undertow"
        message = f"error: {_one_line(message).rstrip('.')}; see {path} --help"
    return _line(message, INPUT_ERROR)


def _place(failure: OSError) -> str:
    return f"'{failure.filename}': " if failure.filename else ""


def _bug(failure: BaseException) -> int:
    import platform
    import traceback

    traceback.print_exception(failure)
    where = f"undertow {__version__}, Python {platform.python_version()}, {platform.system()}"
    return _line(f"This is a bug in undertow: please report it with the lines above ({where}).", _BUG)


def _one_line(text: str) -> str:
    """Text in one line; control characters, which names in files may hold, do not reach the terminal."""
    line = " ".join(text.split())
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in line)


def _line(text: str, code: int = 0) -> int:
    print(text, file=sys.stderr)
    return code


def _drop_unwritable_output() -> None:
    try:
        sys.stdout.flush()
    except OSError:  # Python would flush once more at its end and complain a second time
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
