"""The one exception that a user is meant to see, and refusals of names and of arguments."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache, wraps
from inspect import signature
from numbers import Integral, Real
from types import SimpleNamespace, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints


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


# --- arguments of the public functions ------------------------------------------------------------
P = ParamSpec("P")
T = TypeVar("T")
_Part = tuple[str, Any, Any]
"""Where a part of an argument is, the part, and the kind that it has to be of."""

_LISTS = (Sequence, Collection, tuple)  # of which an array may be any
_COUNTING_AS: dict[Any, type] = {float: Real, int: Integral, **dict.fromkeys(_LISTS, Collection)}
_REMEDIES = {
    "float": "give a number in SI",
    "int": "give a whole number",
    "bool": "give True or False",
    "str": "give a text",
    "Path": "give a path",
    "Mapping": "give a mapping by name",
    "Sequence": "give a list",
    "Collection": "give a list",
    "tuple": "give a list",
    "Callable": "give a function",
    "Vehicle": "read it with undertow.load_vehicle first",
    "Run": "read it with undertow.read_log first",
}


def of_stated_kinds(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function that checks its arguments by its annotations, for a user has no type checker."""

    @cache
    def kinds() -> dict[str, Any]:
        stated = {name: kind for name, kind in function.__annotations__.items() if name != "return"}
        return get_type_hints(SimpleNamespace(__annotations__=stated), function.__globals__)

    @wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> T:
        for name, value in signature(function).bind(*args, **kwargs).arguments.items():
            if wrong := _wrong(name, value, kinds().get(name, Any)):
                where, part, remedy = wrong
                raise UndertowError(f"{where} is given as {type(part).__name__} ({part!r:.60}): {remedy}")
        return function(*args, **kwargs)

    return checked


def _wrong(name: str, value: Any, kind: Any) -> tuple[str, Any, str] | None:
    """The part of a value that is not of its kind, where it is, and what to give instead."""
    plain, args = get_origin(kind) or kind, get_args(kind)
    if plain in (Union, UnionType):
        found = [_wrong(name, value, one) for one in args if one is not type(None) or value is None]
        inside = [wrong for wrong in found if wrong and wrong[0] != name]
        remedies = [*dict.fromkeys(wrong[2] for wrong in found if wrong)]
        remedies[1:] = [remedy.removeprefix("give ") for remedy in remedies[1:]]
        return None if None in found else (*inside, (name, value, " or ".join(remedies)))[0]
    if plain is Literal:
        known = isinstance(value, str) and value in args
        return None if known else (name, value, f"give {' or '.join(map(repr, args))}")
    if plain is Any:
        return None
    counts = callable(value) if plain is Callable else isinstance(value, _COUNTING_AS.get(plain, plain))
    if not counts or (plain in _LISTS and isinstance(value, str | bytes | Mapping)):
        return name, value, _REMEDIES.get(plain.__name__, f"give a {plain.__name__}")
    if plain is tuple and len(value) != len(args):
        return name, value, f"give {len(args)} values"
    return next(filter(None, (_wrong(*part) for part in _parts(name, value, plain, args))), None)


def _parts(name: str, value: Any, plain: Any, args: Sequence[Any]) -> Iterator[_Part]:
    if plain is Mapping:
        for key, item in value.items():
            yield f"a name in {name}", key, args[0]
            yield f"{name}: {key}", item, args[1]
    elif plain in _LISTS:
        each = args if plain is tuple else [args[0]] * len(value)
        for i, (item, kind) in enumerate(zip(value, each, strict=True)):
            yield f"{name}[{i}]", item, kind
