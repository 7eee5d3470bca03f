"""Arguments of the public functions: of the kinds that their annotations state, or refused in one line."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cache, wraps
from inspect import signature
from numbers import Integral, Real
from types import SimpleNamespace, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

from undertow.errors import UndertowError

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
