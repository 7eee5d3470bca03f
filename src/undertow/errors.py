"""The one exception that a user is meant to see."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterable


class UndertowError(Exception):
    """A foreseeable failure: one line that names the thing, the value, the limit and the remedy.

    The command line prints the message and ends with exit code 2. Messages may contain names
    from files: line breaks and control characters are escaped, and a long message is cut in the middle.
    """

    def __init__(self, message: str) -> None:
        line = one_line(message)
        half = _LONGEST // 2
        super().__init__(line if len(line) <= _LONGEST else f"{line[:half]} ... {line[-half:]}")


_LONGEST = 1500


def one_line(text: str) -> str:
    """Text in one line; control characters, which names in files may hold, do not reach the terminal."""
    return printable(" ".join(text.split()))


def printable(text: str) -> str:
    """Text with control characters and line breaks as their escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def listed(parts: Iterable[str]) -> str:
    """Return ``"a"``, ``"a and b"`` or ``"a, b and c"``; nothing where there is no part."""
    *others, last = [*parts] or [""]
    return f"{', '.join(others)} and {last}" if others else last


def nearest(name: str, known: Iterable[str]) -> str:
    """Return ``" (did you mean 'abc'?)"`` for the known name most like `name`, or an empty text."""
    names = list(known)
    alike = [other for other in names if other.lower() == name.lower()]
    alike = alike or difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    alike = alike or [other for other in names if other.lower().startswith(name.lower())]
    return f" (did you mean {alike[0]!r}?)" if alike else ""


def refuse_unknown(
    names: Iterable[str], known: Collection[str], before: str, after: str, all_are: str
) -> None:
    """Refuse a name that is not known: ``before'name'after``, the most like one, and all that are known."""
    for name in names:
        if name not in known:
            listing = ", ".join(known) or "none"
            raise UndertowError(f"{before}'{name}'{after}{nearest(name, known)}: {all_are} {listing}")
