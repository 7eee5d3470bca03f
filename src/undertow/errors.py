"""The one exception that a user is meant to see."""

from __future__ import annotations


class UndertowError(Exception):
    """A foreseeable failure: one line that names the thing, the value, the limit and the remedy.

    The command line prints the message and ends with exit code 2. Messages may contain names
    from files: line breaks and control characters are escaped, and a long message is cut in the middle.
    """

    def __init__(self, message: str) -> None:
        super().__init__(_one_line(message))


_LONGEST = 1500


def _one_line(message: str) -> str:
    spaced = " ".join(message.split())
    plain = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in spaced)
    half = _LONGEST // 2
    return plain if len(plain) <= _LONGEST else f"{plain[:half]} ... {plain[-half:]}"
