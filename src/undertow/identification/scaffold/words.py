"""Names and texts that go into a Python file: nothing out of a diagnosis may become code."""

from __future__ import annotations

import json
import keyword
import re
from functools import cache

from undertow.errors import UndertowError
from undertow.model.catalogue import catalogue
from undertow.model.symbols import signal_units, signals

_ID = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", re.ASCII)
_LONGEST = 60
# Names that the file needs for something else.
_RESERVED = {"Wrench", "Parameter", "Signals", "UndertowError"}
_LONGEST_TEXT = 400


def check_id(effect_id: str) -> None:
    """Refuse an id that no new effect can have.

    Raises
    ------
    UndertowError
        If it is no word in snake case, a word of Python, or the id of an effect of the catalogue.
    """
    if not _ID.fullmatch(effect_id) or len(effect_id) > _LONGEST or keyword.iskeyword(effect_id):
        raise UndertowError(
            f"'{effect_id[: 2 * _LONGEST]}' is no id for an effect: write small letters, digits and single "
            f"underscores, at most {_LONGEST} of them, such as 'turning_drag'"
        )
    if effect_id in catalogue():
        raise UndertowError(f"effect '{effect_id}' is in the catalogue already: choose another id")


def class_name(effect_id: str) -> str:
    """Name of the class of an effect: ``turning_drag`` gives ``TurningDrag``."""
    name = "".join(part.capitalize() for part in effect_id.split("_"))
    return f"{name}Effect" if name in _RESERVED or keyword.iskeyword(name) else name


@cache
def taken_names() -> frozenset[str]:
    """Names of signals, and of parameters and states of the catalogue."""
    specimens = [cls.specimen() for cls in catalogue().values()]
    own = {n for e in specimens for n in (*(p.name for p in e.parameters), *e.states)}
    return frozenset(own | {str(x) for x in signal_units(signals())})


def plain(text: str) -> str:
    """Text that may stand in a docstring: printable, on one line, without quotes and backslashes."""
    line = " ".join(text.split()).replace('"', "'").replace("\\", "/")
    return "".join(c if c.isprintable() else "?" for c in line)[:_LONGEST_TEXT]


def literal(text: str) -> str:
    """A text as a Python literal in double quotes."""
    return json.dumps(plain(text), ensure_ascii=False)


def identifier(text: str) -> str:
    """Letters, digits and underscores of a text."""
    return re.sub(r"[^A-Za-z0-9_]", "", text)
