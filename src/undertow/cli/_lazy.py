"""Commands that are known by name and one line of help, and imported when they run.

Discovery reads the first line of each module's docstring without importing it: ``undertow --help`` must not
wait for SymPy or CasADi, and a new command must cost one file.
"""

from __future__ import annotations

import ast
import pkgutil
from collections.abc import Sequence
from importlib import import_module
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

import typer
from typer.core import TyperCommand

import undertow.cli as package

_ENTRY = "main"
_TAKING_SEVERAL = {"--holdout"}


def commands() -> dict[str, str]:
    """Name and first docstring line of every command, sorted by name (``a_b.py`` is the command ``a-b``)."""
    names = sorted(module.name for module in pkgutil.iter_modules(package.__path__))
    public = [name for name in names if name[0] != "_" and name != _ENTRY]
    return {_command(name): _first_line(name) for name in public}


def load(name: str) -> Any:
    """Import the module of a command and build the command from it.

    The module holds a ``typer.Typer`` called ``app`` (a command with sub-commands) or a function called like
    the module. The module's docstring is the text of ``--help``; indented paragraphs of it keep their lines.
    """
    module = import_module(f"{package.__name__}.{_module(name)}")
    command = _command_of(module, name)
    command.name = name
    command.help = _paragraphs(module.__doc__ or "")
    return command


class LazyCommand(TyperCommand):
    """Stands for a command in the list; the real one takes over when a context is made for it."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        assert self.name is not None
        return load(self.name).make_context(info_name, each_named(args), parent, **extra)


def each_named(words: Sequence[str]) -> list[str]:
    """``--holdout a b`` as ``--holdout a --holdout b``: no log may slip in among those to fit."""
    result: list[str] = []
    option = ""
    for i, word in enumerate(words):
        if word == "--":
            return [*result, *words[i:]]
        if word.startswith("-") and word != "-":
            option = word if word in _TAKING_SEVERAL else ""
        elif option and result[-1] != option:
            result.append(option)
        result.append(word)
    return result


def _command_of(module: ModuleType, name: str) -> Any:
    app = getattr(module, "app", None)
    if app is None:
        app = typer.Typer(add_completion=False)
        app.command()(getattr(module, _module(name)))
    app.rich_markup_mode = None  # plain text everywhere: quick to import, readable in a log
    return typer.main.get_group(app) if hasattr(module, "app") else typer.main.get_command(app)


def _first_line(name: str) -> str:
    spec = PathFinder.find_spec(f"{package.__name__}.{name}", package.__path__)
    source = Path(spec.origin).read_text(encoding="utf-8") if spec and spec.origin else ""
    text = ast.get_docstring(ast.parse(source)) or ""
    return text.partition("\n")[0]


def _command(module: str) -> str:
    return module.replace("_", "-")


def _module(command: str) -> str:
    return command.replace("-", "_")


def _paragraphs(text: str) -> str:
    """Mark the indented paragraphs so that the help keeps their lines (Click's ``\\b``)."""
    parts = text.strip().split("\n\n")
    return "\n\n".join(f"\b\n{part}" if part.startswith(" ") else part for part in parts)
