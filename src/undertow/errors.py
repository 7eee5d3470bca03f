"""The one exception that a user is meant to see."""

from __future__ import annotations


class UndertowError(Exception):
    """A foreseeable failure, told in one line that names the thing, the value, the limit and the remedy.

    The command line prints the message and ends with exit code 2. Names out of files stand in messages: line
    breaks and control characters are made harmless, and what is very long is cut in its middle.
    """

    def __init__(self, message: str) -> None:
        super().__init__(_one_line(message))


_LONGEST = 1500


def _one_line(message: str) -> str:
    spaced = " ".join(message.split())
    plain = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in spaced)
    half = _LONGEST // 2
    return plain if len(plain) <= _LONGEST else f"{plain[:half]} ... {plain[-half:]}"
