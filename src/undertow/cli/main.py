"""The entry point of the command ``undertow``."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from undertow import __version__
from undertow.cli._lazy import LazyCommand, commands
from undertow.cli._run import run
from undertow.cli._terminal import keep_warnings_back, open_streams

_ABOUT = "Shows where a model of a vehicle in water fails on real logs, names the missing effect and adds it."
_VERBOSE = ("-v", "--verbose")

_app = typer.Typer(help=_ABOUT, rich_markup_mode=None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    Parameters
    ----------
    arguments
        The words after ``undertow``; those of the process if None.

    Returns
    -------
    int
        0 done; 1 the answer is no (``codegen --check``), or a bug; 2 a mistake in the input; 130 interrupted.
    """
    # Matrices are small here: threads of the linear algebra only get into each other's way.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    open_streams()
    if arguments is None:  # the process is ours
        keep_warnings_back()
    return run(lambda: _root().main(_verbose_first(arguments), prog_name="undertow", standalone_mode=False))


def _root() -> Any:
    group: Any = typer.main.get_command(_app)  # a group, because there is a callback
    for name, line in commands().items():
        group.add_command(LazyCommand(name, short_help=line))
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


_VERBOSE_OPTION = typer.Option(*_VERBOSE, help="Say what is going on (anywhere on the line).")
_VERSION_OPTION = typer.Option(
    "--version", callback=_show_version, is_eager=True, help="Print the version and exit."
)


@_app.callback(invoke_without_command=True)
def _options(
    context: typer.Context,
    verbose: Annotated[bool, _VERBOSE_OPTION] = False,
    version: Annotated[bool, _VERSION_OPTION] = False,
) -> None:
    from undertow.cli._talk import talk

    talk(verbose)
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
