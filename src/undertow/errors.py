"""The one exception that a user is meant to see."""

from __future__ import annotations


class UndertowError(Exception):
    """A foreseeable failure, told in one line that names the thing, the value, the limit and the remedy.

    The command line prints the message and ends with exit code 2.
    """
