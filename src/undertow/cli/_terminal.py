"""Standard streams that are there and take any text, and what Python itself says on them."""

from __future__ import annotations

import codecs
import os
import sys
import unicodedata
import warnings

_STREAMS = (("stdin", "r"), ("stdout", "w"), ("stderr", "w"))
_READABLE = "undertow.readable"
# What decomposition and the names of letters do not give.
_IN_ASCII = {
    "≤": "<=",
    "≥": ">=",
    "≠": "!=",
    "≈": "~",
    "≻": ">",
    "±": "+/-",
    "−": "-",
    "–": "-",
    "—": "-",
    "·": "*",
    "×": "x",
    "→": "->",
    "√": "sqrt",
    "∞": "inf",
    "°": " deg",
    "²": "^2",
    "³": "^3",
    "λ": "lambda",
    "Λ": "Lambda",
}


def open_streams() -> None:
    """Give a process that was started without stdin, stdout or stderr (``>&-``) ones that lead nowhere.

    Otherwise the first file that is opened would have the number of the missing one, and what a library
    prints would go into it. What the encoding of a stream cannot hold (Greek letters in the locale C) is
    written in ASCII.
    """
    for name, mode in _STREAMS:
        stream = getattr(sys, name)
        if stream is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115
        elif mode == "w" and hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=_READABLE)


def readable(shown: str, encoding: str) -> str:
    """The same text with what an encoding cannot hold written in ASCII."""
    return shown.encode(encoding, _READABLE).decode(encoding)


def keep_warnings_back() -> None:
    """Python's warnings speak of lines of code: they are shown only where -W or PYTHONWARNINGS ask for them.

    Processes started from this one keep them back, too.
    """
    if not sys.warnoptions:
        warnings.simplefilter("ignore")
        os.environ["PYTHONWARNINGS"] = "ignore"


def _readable(failure: UnicodeError) -> tuple[str, int]:
    if not isinstance(failure, UnicodeEncodeError):
        raise failure
    return "".join(map(_in_ascii, failure.object[failure.start : failure.end])), failure.end


def _in_ascii(letter: str) -> str:
    """A letter in ASCII: its like, its name if it is Greek, a line if it is one, its number otherwise."""
    if letter in _IN_ASCII:
        return _IN_ASCII[letter]
    name = unicodedata.name(letter, "")
    if name.startswith(("GREEK SMALL LETTER ", "GREEK CAPITAL LETTER ")):
        word = name.split()[3].lower()
        return word.capitalize() if letter.isupper() else word
    if name.startswith("BOX DRAWINGS"):
        return "-" if "HORIZONTAL" in name and "VERTICAL" not in name else "|"
    like = unicodedata.normalize("NFKD", letter).encode("ascii", "ignore").decode()
    return like or letter.encode("ascii", "backslashreplace").decode()


codecs.register_error(_READABLE, _readable)
