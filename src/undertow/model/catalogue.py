"""Discovery of effects: the catalogue folder, entry points, and files named by the user."""

from __future__ import annotations

import importlib
import importlib.util
import inspect
import pkgutil
import sys
from collections.abc import Callable, Iterable, Mapping
from functools import cache, wraps
from importlib.machinery import SourceFileLoader
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from traceback import extract_tb
from types import MappingProxyType, ModuleType
from typing import Any
from zlib import crc32

from undertow.errors import UndertowError, nearest

from . import effects
from .effect import Effect
from .parameter import LoggedOnly, logged

Catalogue = Mapping[str, type[Effect]]


@cache
def catalogue() -> Catalogue:
    """All known effects by id: those of undertow, then those of installed packages.

    Returns
    -------
    mapping
        Effect classes by id, read-only.

    Raises
    ------
    UndertowError
        If two effects have the same id.

    Examples
    --------
    >>> import undertow as ut
    >>> print(ut.catalogue()["ocean_current"].about())
    Water that moves steadily and uniformly over ground.
    """
    names = [f"{effects.__name__}.{m.name}" for m in pkgutil.iter_modules(effects.__path__)]
    own = [cls for name in names for cls in effects_in(importlib.import_module(name))]
    added = [_installed(point) for point in entry_points(group="undertow.effects")]
    return MappingProxyType(merge({}, [*own, *added]))


def _installed(point: EntryPoint) -> type[Effect]:
    place = f"'{point.name}' of an installed package"
    try:
        cls = point.load()
    except Exception as error:  # a broken package must be named, it is not ours to mend
        why = f"{type(error).__name__}: {error}"
        raise UndertowError(
            f"effect {place} cannot be loaded from {point.value}: {why}; repair or uninstall it"
        ) from error
    if not (inspect.isclass(cls) and issubclass(cls, Effect)):
        raise UndertowError(
            f"entry point {place}, {point.value}, is not an effect class: repair or uninstall it"
        )
    return cls


def effects_in(module: ModuleType) -> list[type[Effect]]:
    """Concrete effect classes that a module defines itself."""
    members = [m for _, m in inspect.getmembers(module, inspect.isclass) if issubclass(m, Effect)]
    return [m for m in members if not inspect.isabstract(m) and m.__module__ == module.__name__]


def merge(known: Catalogue, added: Iterable[type[Effect]]) -> dict[str, type[Effect]]:
    """The catalogue with more effects in it; an id that is taken is refused."""
    result = dict(known)
    for cls in added:
        if not isinstance(getattr(cls, "id", None), str):
            raise UndertowError(
                f"effect class {cls.__name__} has no id: give it a class attribute id = '...'"
            )
        if result.get(cls.id, cls) is not cls:
            raise UndertowError(f"effect id '{cls.id}' of {cls.__name__} is taken already: choose another id")
        result[cls.id] = cls
    return result


def with_effects(files: Iterable[Path]) -> Catalogue:
    """The catalogue with the effects of the files of a user, which are run."""
    return merge(catalogue(), [cls for file in files for cls in load_effects(file)])


class _Uncached(SourceFileLoader):
    """Runs a file without writing its bytecode."""

    def set_data(self, path: str, data: Any, *, _mode: int = 0) -> None:
        pass


def load_effects(path: Path) -> list[type[Effect]]:
    """Run a user's effect file and return the effect classes in it.

    The file is Python and is executed: call this only for a file that the user has named on purpose.
    """
    if not path.is_file():
        raise UndertowError(f"effect file '{path}' does not exist: check the path")
    name = f"undertow_user_effects_{path.stem}_{crc32(str(path.resolve()).encode()):08x}"
    loader = _Uncached(name, str(path))
    spec = importlib.util.spec_from_file_location(name, path, loader=loader)
    if spec is None or path.suffix != ".py":
        raise UndertowError(f"effect file '{path}' is not a Python file: name it *.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look their module up there
    try:
        loader.exec_module(module)
    except (Exception, SystemExit) as error:  # whatever a user's file raises is the user's to mend
        del sys.modules[name]
        raise UndertowError(f"{_location(path, error)} cannot be run: {_error_text(error)}") from error
    for _, cls in inspect.getmembers(module, inspect.isclass):
        if issubclass(cls, Effect) and cls.__module__ == name:
            _guard(cls, path)
    found = effects_in(module)
    if not found:
        raise UndertowError(
            f"effect file '{path}' holds no effect: define a class derived from undertow.Wrench"
        )
    return found


def _guard(cls: type[Effect], path: Path) -> None:
    """Turn exceptions in the methods of a user's effect into a one-line error with the location."""
    for name, member in list(vars(cls).items()):
        if inspect.isfunction(member):
            setattr(cls, name, _guarded(member, cls, path))
        elif isinstance(member, property) and member.fget is not None:
            setattr(cls, name, property(_guarded(member.fget, cls, path)))
        elif isinstance(member, classmethod):
            setattr(cls, name, classmethod(_guarded(member.__func__, cls, path)))


def _guarded(method: Callable[..., Any], cls: type[Effect], path: Path) -> Callable[..., Any]:
    @wraps(method)
    def called(*args: Any, **kwargs: Any) -> Any:
        try:
            return method(*args, **kwargs)
        except UndertowError:
            raise
        except Exception as error:
            effect = getattr(cls, "id", cls.__name__)
            raise UndertowError(
                f"{_location(path, error)}: {method.__name__}() of effect '{effect}' fails with "
                f"{_error_text(error)}: correct that line"
            ) from error

    return called


def _location(path: Path, error: BaseException) -> str:
    """The file of a user and, where an error comes from a line of it, the line."""
    frames = [(f.filename, f.lineno) for f in extract_tb(error.__traceback__)]
    if isinstance(error, SyntaxError):
        frames.append((error.filename or "", error.lineno))
    lines = [line for file, line in frames if Path(file).resolve() == path.resolve()]
    return f"effect file '{path}'" + (f", line {lines[-1]}" if lines else "")


def _error_text(error: BaseException) -> str:
    return f"{type(error).__name__}: {error}"


def lookup(effect_id: str, known: Catalogue) -> type[Effect]:
    """The effect class of this id."""
    if effect_id not in known:
        raise UndertowError(
            f"effect '{effect_id}' is not known{nearest(effect_id, known)}; 'undertow effects' lists them"
        )
    return known[effect_id]


def logged_quantities(known: Catalogue) -> dict[str, str]:
    """Units of the quantities that effects can take from a log, by name."""
    return {d.name: d.unit for cls in known.values() for d in logged(cls)}


def companions(known: Catalogue) -> dict[str, str]:
    """Quantities that a log has to contain if it contains another one: name to name of the other."""
    found = (d for cls in known.values() for d in logged(cls) if isinstance(d, LoggedOnly))
    return {d.name: d.with_log for d in found if d.with_log}
