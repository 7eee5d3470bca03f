"""The entry point of the command ``undertow``."""

from __future__ import annotations

import ast
import os
import pkgutil
import sys
from collections.abc import Callable, Iterator, Sequence
from importlib import import_module
from importlib.machinery import ModuleSpec, PathFinder
from keyword import iskeyword
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

import undertow.cli as package
from undertow.cli._terminal import hide_warnings, open_streams
from undertow.errors import UndertowError, one_line
from undertow.version import __version__

from ._terminal import repeated_interrupts

_TAKING_SEVERAL = {"--validation", "--holdout"}
# Commands that stand in the file of another one, which is about the same; their help is the function's.
_IN_FILE_OF = {"audit-tables": "audit"}


def commands() -> dict[str, str]:
    """Name and first docstring line of every command, sorted by name.

    ``a_b.py`` is the command ``a-b``, ``import_.py`` the command ``import``; its folder only sorts it.
    """
    return {name: _first_line(name) for name in _names()}


def _names() -> list[str]:
    return sorted([*_specs(), *_IN_FILE_OF])


def load(name: str) -> Any:
    """Import the module of a command and build the command from it.

    The module holds a ``typer.Typer`` called ``app`` (a command with sub-commands) or a function called like
    the command. The module's docstring is the text of ``--help``; indented paragraphs of it keep their lines.
    """
    module = import_module(_spec(name).name)
    command = _command_of(module, name)
    command.name = name
    command.help = _paragraphs(_help(name))
    return command


class LazyCommand(TyperCommand):
    """Stands for a command in the list; the real one takes over when a context is made for it."""

    def make_context(self, info_name: str | None, args: list[str], parent: Any = None, **extra: Any) -> Any:
        assert self.name is not None
        return load(self.name).make_context(info_name, each_named(args), parent, **extra)

    def get_short_help_str(self, limit: int = 45) -> str:
        # Only the list of commands asks: to parse the files of all of them takes longer than all else here.
        assert self.name is not None
        return _first_line(self.name)


def each_named(words: Sequence[str]) -> list[str]:
    """``--validation a b`` as ``--validation a --validation b``: no log may slip in among those to fit."""
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
    several = name not in _IN_FILE_OF and hasattr(module, "app")
    app = module.app if several else typer.Typer(add_completion=False)
    if not several:
        app.command()(getattr(module, _module(name)))
    app.rich_markup_mode = None  # plain text everywhere: quick to import, readable in a log
    return typer.main.get_group(app) if several else typer.main.get_command(app)


def _first_line(name: str) -> str:
    return _help(name).partition("\n")[0]


def _help(name: str) -> str:
    """What a command says of itself, read without importing it."""
    tree = ast.parse(Path(_spec(name).origin or "").read_text(encoding="utf-8"))
    functions = [node for node in tree.body if isinstance(node, ast.FunctionDef)]
    own = next((f for f in functions if name in _IN_FILE_OF and f.name == _module(name)), None)
    # The lines of a module's text are kept as they are, indented paragraphs among them.
    text = ast.get_docstring(tree, clean=False) if own is None else ast.get_docstring(own)
    return text or ""


def _spec(name: str) -> ModuleSpec:
    return _specs()[_IN_FILE_OF.get(name, name)]


def _specs() -> dict[str, ModuleSpec]:
    """The module of every command, found without importing any."""
    public = [spec for spec in _found(package.__name__, package.__path__) if spec.name != __name__]
    return {_command(spec.name.rpartition(".")[2]): spec for spec in public}


def _found(parent: str, path: Sequence[str]) -> Iterator[ModuleSpec]:
    for module in pkgutil.iter_modules(path):
        name = f"{parent}.{module.name}"
        spec = PathFinder.find_spec(name, path)
        if module.name[0] == "_" or spec is None:
            continue
        if module.ispkg:
            yield from _found(name, spec.submodule_search_locations or [])
        else:
            yield spec


def _command(module: str) -> str:
    return module.rstrip("_").replace("_", "-")


def _module(command: str) -> str:
    return f"{command}_" if iskeyword(command) else command.replace("-", "_")


def _paragraphs(text: str) -> str:
    """Mark the indented paragraphs so that the help keeps their lines (Click's ``\\b``)."""
    parts = text.strip().split("\n\n")
    return "\n\n".join(f"\b\n{part}" if part.startswith(" ") else part for part in parts)


INPUT_ERROR = 2
INTERRUPTED = 130
_BUG = 1


def run(action: Callable[[], object]) -> int:
    """Run a command line and turn what it raises into a message on stderr and an exit code.

    An int that `action` returns is the exit code, anything else means 0. 2 for a foreseeable failure (one
    line ``error: ...``), 130 for Ctrl-C, 1 for a bug (with traceback).
    """
    try:
        with repeated_interrupts():
            answer = action()
        code = _code(answer)
        sys.stdout.flush()
    except BrokenPipeError:  # `undertow effects | head`: the reader has seen enough
        code = 1
    except (Exception, KeyboardInterrupt) as failure:
        code = _report_failure(failure)
    _drop_unwritable_output()
    return code


def _code(answer: object) -> int:
    code = answer if isinstance(answer, int) and not isinstance(answer, bool) else 0
    if code == INTERRUPTED:  # typer has already turned Ctrl-C into this code
        _line("interrupted")
    return code


def _report_failure(failure: BaseException) -> int:
    if isinstance(failure, KeyboardInterrupt | typer.Abort):
        return _line("interrupted", INTERRUPTED)
    if isinstance(failure, UndertowError):
        return _line(f"error: {failure}", INPUT_ERROR)
    if isinstance(failure, typer.TyperException):
        return _usage(failure)
    if isinstance(failure, OSError) and failure.strerror:
        return _line(one_line(f"error: {_place(failure)}{failure.strerror.lower()}"), INPUT_ERROR)
    return _bug(failure)


def _usage(failure: typer.TyperException) -> int:
    message = failure.format_message().replace("Value error, ", "", 1)  # pydantic's, in front of the cause
    if not message.startswith("Usage:"):  # a bare group asks for its help to be shown
        context = getattr(failure, "ctx", None)
        path = context.command_path if context else "undertow"
        message = f"error: {one_line(message).rstrip('.')}; see {path} --help"
    return _line(message, INPUT_ERROR)


def _place(failure: OSError) -> str:
    return f"'{failure.filename}': " if failure.filename else ""


def _bug(failure: BaseException) -> int:
    import platform
    import traceback

    traceback.print_exception(failure)
    where = f"undertow {__version__}, Python {platform.python_version()}, {platform.system()}"
    return _line(f"This is a bug in undertow: please report it with the lines above ({where}).", _BUG)


def _line(text: str, code: int = 0) -> int:
    print(text, file=sys.stderr)
    return code


def _drop_unwritable_output() -> None:
    try:
        sys.stdout.flush()
    except OSError:  # Python would flush once more at its end and complain a second time
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


_ABOUT = "Show where the model of a marine vehicle fails on real logs, name the missing effect, and add it."
_VERBOSE = ("-v", "--verbose")

_app = typer.Typer(help=_ABOUT, rich_markup_mode=None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, by default that of the process, and return its exit code.

    0 done; 1 the answer is no (``export c --check``) or a bug; 2 a mistake in the input; 130 interrupted.
    """
    # Matrices are small here: threads of the linear algebra only get into each other's way.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    open_streams()
    if arguments is None:  # the process is ours
        hide_warnings()
    words = _verbose_first(arguments)
    return run(lambda: _root().main(words, prog_name="undertow", standalone_mode=False))


def _root() -> Any:
    group: Any = typer.main.get_command(_app)  # a group, because there is a callback
    for name in _names():
        group.add_command(LazyCommand(name))
    return group


def _verbose_first(arguments: Sequence[str] | None) -> list[str] | None:
    """``undertow fit -v ...`` means ``undertow -v fit ...``."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    end = words.index("--") if "--" in words else len(words)
    flags = [word for word in words[:end] if word in _VERBOSE]
    return flags + [word for word in words[:end] if word not in _VERBOSE] + words[end:]


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"undertow {__version__}")
        raise typer.Exit


_VERBOSE_OPTION = typer.Option(*_VERBOSE, help="Print progress and details (anywhere on the line).")
_VERSION_OPTION = typer.Option(
    "--version", callback=_show_version, is_eager=True, help="Print the version and exit."
)


@_app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    verbose: Annotated[bool, _VERBOSE_OPTION] = False,
    version: Annotated[bool, _VERSION_OPTION] = False,
) -> None:
    from ._terminal import log_to_stderr

    log_to_stderr(verbose)
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
