"""The terminal: streams, warnings, progress, tables, findings and JSON, Ctrl-C."""

from __future__ import annotations

import codecs
import json
import logging
import os
import re
import signal
import sys
import textwrap
import threading
import unicodedata
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock, Timer
from time import monotonic
from types import FrameType
from typing import TYPE_CHECKING, Any

import typer

from undertow.errors import printable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from undertow.identification.findings import Finding


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


def hide_warnings() -> None:
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

# A blank that ties a sign or a comparison to its number.
_TIED = "\u00a0"
_TIES = re.compile(r"(?<=[<>=≤≥≻±]) (?=[-+\d.])|(?<=\+-) (?=\d)| (?=(?:±|\+-|[<>=≤≥≻]) [-+\d.])")
# Between columns, and between cells that share a line without being columns.
_GAP, _APART = "  ", "   "
# In ASCII a subscript has its line, and what is tied to a number is as short as on paper.
_NAMES = {"λmin": "lambda_min", "λmax": "lambda_max", "±": "+-"}


@dataclass(frozen=True)
class Layout:
    """When a table that is too wide keeps its columns, in letters; chosen for the tables of the commands.

    A column wider than `prose` holds sentences, which may be wrapped (numbers are shorter), but not into less
    than `least`: the cells of a row then stand below each other.
    """

    prose: int = 30
    least: int = 24


LAYOUT = Layout()


def print_json(content: Any) -> None:
    """Print plain data as JSON on stdout."""
    typer.echo(json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False))


class Printer:
    """The terminal, or whatever stdout is at the moment: nothing is cut, and no number is broken."""

    def __init__(self) -> None:
        from rich.console import Console

        self._console = Console(highlight=False)

    def print(self, content: Any = "", *, soft_wrap: bool = False) -> None:
        """Print what `text` or `table` made; with `soft_wrap` a text stays one line in files."""
        from rich.text import Text

        if isinstance(content, Text) and (self._console.is_terminal or not soft_wrap):
            content = Text("\n").join(_wrapped_text(content, self._console.width))
        self._console.print(content, no_wrap=True, overflow="ignore", crop=False)


def console() -> Printer:
    """The terminal, or whatever stdout is at the moment."""
    return Printer()


def text(content: str, style: str = "") -> Any:
    """Text without markup; control characters out of files are shown and not sent to the terminal.

    Where stdout cannot have a letter, its name stands there (lambda, iota), or its number.
    """
    from rich.text import Text

    return Text(_encodable(printable(content)), style=style)


def _encoding() -> str:
    return getattr(sys.stdout, "encoding", None) or "utf-8"


def _encodable(shown: str) -> str:
    encoding = _encoding()
    try:
        shown.encode(encoding)
    except UnicodeEncodeError:
        for letter, name in _NAMES.items():
            shown = shown.replace(letter, name)
    return shown.encode(encoding, _READABLE).decode(encoding)


def wrapped(words: str, width: int) -> list[str]:
    """Lines of at most so many columns, broken between words but not between a sign and its number."""
    lines = textwrap.wrap(
        _TIES.sub(_TIED, words), max(width, 1), break_long_words=False, break_on_hyphens=False
    )
    return [line.replace(_TIED, " ") for line in lines] or [""]


def _wrapped_text(content: Any, width: int) -> list[Any]:
    """The same for a `text`; further lines begin where the first does."""
    if content.cell_len <= width:
        return [content]
    indent = " " * (len(content.plain) - len(content.plain.lstrip(" ")))
    lines = wrapped(content.plain.strip(), width - len(indent))
    return [text(indent + line, content.style) for line in lines]


def say(line: str, style: str = "") -> None:
    """Print a line that the terminal may wrap, and files may not."""
    console().print(text(line, style), soft_wrap=True)


def write_files(
    *files: tuple[Path | None, Callable[[Path], Any] | str | Figure], silent: bool = False
) -> None:
    """Write files that are asked for, all or none, and say where they are, unless `silent`.

    With each path stands its text or picture, what makes its text, bytes or picture, or what writes it; with
    a folder what makes its pictures by name, whose number is said in any case.
    """
    from undertow.files import together, write_whole

    wanted = [(path, make) for path, make in files if path is not None]
    said = []
    with progress("writing", None), together():
        for path, make in wanted:
            content = make(path) if callable(make) else make
            if isinstance(content, dict):
                from undertow.figures import save_pictures

                said.append(f"{len(save_pictures(content, path))} pictures in {path}")
                continue
            if isinstance(content, str | bytes):
                write_whole(path, content)
            elif content is not None:
                from undertow.figures import save_png

                save_png(content, path)
            said += [] if silent else [f"wrote {path}"]
    for line in said:
        console().print(text(line))


def section(title: str, content: Any = None) -> None:
    """Print a heading, and what stands below it."""
    out = console()
    out.print()
    out.print(text(title, "bold"))
    if content is not None:
        out.print(content)


def table(columns: Sequence[str], rows: Iterable[Sequence[Any]], indent: int = 2) -> Any:
    """A table without lines; without a head where all columns are nameless.

    Where it is wider than the terminal, a column of sentences is wrapped; if that is not enough, the cells of
    each row stand below each other, each with its head. Cells are strings, taken as they stand, or `text`;
    `indent` is the number of blanks at the left.
    """
    cells = [[text(cell) if isinstance(cell, str) else cell for cell in row] for row in rows]
    return _Table(columns, cells, indent)


class _Table:
    """A table that is laid out for the terminal it is printed on."""

    def __init__(self, columns: Sequence[str], rows: list[list[Any]], indent: int) -> None:
        self._heads = [text(c, "dim") for c in columns]
        self._rows, self._indent = rows, indent

    def __rich_console__(self, console: Any, options: Any) -> Iterator[Any]:
        room = options.max_width - self._indent
        widths = self._widths(room)
        lines = self._grid(widths) if widths else self._records(room)
        yield from (_indented(line, self._indent) for line in lines)

    def _shown(self) -> list[list[Any]]:
        return [self._heads, *self._rows] if any(h.plain for h in self._heads) else self._rows

    def _widths(self, room: int) -> list[int]:
        """Width of each column; nothing where they do not fit, even with heads of several lines."""
        cells = [max((row[i].cell_len for row in self._rows), default=0) for i in range(len(self._heads))]
        widths = [max(cell, head.cell_len) for cell, head in zip(cells, self._heads, strict=True)]
        gaps = len(_GAP) * (len(widths) - 1)
        if sum(widths) + gaps <= room:
            return widths
        widths = [max(cell, _longest_word(head)) for cell, head in zip(cells, self._heads, strict=True)]
        over = sum(widths) + gaps - room
        if over <= 0:
            return self._spread(widths, -over)
        widest = widths.index(max(widths))
        left = widths[widest] - over
        if widths[widest] < LAYOUT.prose or left < LAYOUT.least:
            return []
        widths[widest] = left
        return widths

    def _spread(self, widths: list[int], spare: int) -> list[int]:
        """Give what is left to the heads that need it, from the left."""
        for i, head in enumerate(self._heads):
            more = min(spare, max(0, head.cell_len - widths[i]))
            widths[i], spare = widths[i] + more, spare - more
        return widths

    def _grid(self, widths: list[int]) -> Iterator[Any]:
        for row in self._shown():
            cells = [_wrapped_text(c, w) for c, w in zip(row, widths, strict=True)]
            for k in range(max(map(len, cells), default=0)):
                yield _side_by_side([c[k] if k < len(c) else text("") for c in cells], widths)

    def _records(self, room: int) -> Iterator[Any]:
        if self._heads and self._heads[0].plain:
            yield from _wrapped_text(self._heads[0], room)
        for row in self._rows:
            yield from self._record(row, room)

    def _record(self, row: list[Any], room: int) -> Iterator[Any]:
        """A row as lines: its first cell, and below it the others with their heads, packed into lines."""
        from rich.text import Text

        first, *others = row
        yield from _wrapped_text(first, room)
        room -= len(_GAP)
        line = Text()
        for head, cell in zip(self._heads[1:], others, strict=True):
            named = Text.assemble(f"{head.plain}: " if head.plain else "", cell)
            if not cell.plain:
                continue
            if line.plain and line.cell_len + len(_APART) + named.cell_len > room:
                yield from (_indented(part, len(_GAP)) for part in _wrapped_text(line, room))
                line = Text()
            line = Text(_APART).join([line, named]) if line.plain else named
        yield from (_indented(part, len(_GAP)) for part in _wrapped_text(line, room) if line.plain)


def _longest_word(content: Any) -> int:
    return max(map(len, wrapped(content.plain, 1)))


def _side_by_side(cells: Sequence[Any], widths: Sequence[int]) -> Any:
    from rich.text import Text

    padded = [Text.assemble(c, " " * (w - c.cell_len)) for c, w in zip(cells, widths, strict=True)]
    line = Text(_GAP).join(padded)
    line.rstrip()
    return line


def _indented(line: Any, by: int) -> Any:
    from rich.text import Text

    return Text.assemble(" " * by, line)


@dataclass(frozen=True)
class TerminalSettings:
    """When progress is shown, and an interruption is repeated, s."""

    delay: float = 2.0  # before a bar appears
    interval: float = 30.0  # between two lines where there is no bar
    # After which an interruption that came to nothing is repeated: short against the time that a command
    # takes after its last call of a library, or the result would be written in spite of it.
    repetition: float = 0.05


SETTINGS = TerminalSettings()


@contextmanager
def progress(description: str, total: float | None = 1.0) -> Iterator[Callable[[float, str], None]]:
    """Show a bar on the terminal while the block runs, if that takes more than two seconds.

    Nothing is printed for shorter work. The bar disappears at the end; where stderr is no terminal, as in a
    continuous integration, there is none, but a line from time to time.
    What is yielded is the `undertow.typing.Progress` of library code; `total` is reported when all is done,
    None for work that reports nothing on its way.
    """
    if not sys.stderr.isatty():
        yield _Lines(description, total).report
        return
    bar = _Bar(description, total)
    timer = Timer(SETTINGS.delay, bar.show)
    timer.daemon = True
    timer.start()
    try:
        yield bar.report
    finally:
        timer.cancel()
        bar.close()


class _Lines:
    """How far the work is, in lines on stderr: a bar could not be read in a file."""

    def __init__(self, description: str, total: float | None) -> None:
        self._words, self._total, self._last = description, total or 1.0, monotonic()

    def report(self, done: float, words: str = "") -> None:
        self._words = words or self._words
        if monotonic() - self._last > SETTINGS.interval:
            self._last = monotonic()
            print(f"{self._words}: {done / self._total:.0%}", file=sys.stderr, flush=True)


class _Bar:
    """The state of the work and, once another thread has called `show`, its picture."""

    def __init__(self, description: str, total: float | None) -> None:
        self._words, self._total, self._done = description, total, 0.0
        self._picture: Any = None
        self._closed = False
        self._lock = Lock()

    def report(self, done: float, words: str = "") -> None:
        with self._lock:
            self._done, self._words = done, words or self._words
            self._draw()

    def show(self, console: Any = None) -> None:
        from rich.console import Console  # slow to import, and mostly not needed
        from rich.progress import Progress

        with self._lock:
            if self._closed:
                return
            # The time left is estimated from all that was done: minutes may pass between reports.
            every = 3600.0
            self._picture = Progress(
                console=console or Console(stderr=True), transient=True, speed_estimate_period=every
            )
            self._task = self._picture.add_task(self._words, total=self._total)
            self._picture.start()
            self._draw()

    def close(self) -> None:
        with self._lock:
            self._closed = True
            if self._picture is not None:
                self._picture.stop()

    def _draw(self) -> None:
        if self._picture is not None:
            from rich.markup import escape  # names out of files are not markup

            self._picture.update(self._task, completed=self._done, description=escape(self._words))


class _ToStderr(logging.Handler):
    """Prints to the stderr of the moment, so that a progress bar on the terminal can step aside for it."""

    def emit(self, record: logging.LogRecord) -> None:
        prefix = "" if record.levelno < logging.WARNING else f"{record.levelname.lower()}: "
        print(f"{prefix}{self.format(record)}", file=sys.stderr)


def log_to_stderr(verbose: bool) -> None:
    """Send the log of undertow to stderr: warnings, with `verbose` also what is going on."""
    logger = logging.getLogger("undertow")
    for handler in [handler for handler in logger.handlers if isinstance(handler, _ToStderr)]:
        logger.removeHandler(handler)
    logger.addHandler(_ToStderr())
    logger.setLevel(logging.INFO if verbose else logging.WARNING)
    # It says in several lines where it keeps its list of fonts when the home cannot be written.
    logging.getLogger("matplotlib").setLevel(logging.WARNING if verbose else logging.ERROR)


@contextmanager
def repeated_interrupts() -> Iterator[None]:
    """While the block runs, repeat KeyboardInterrupt after Ctrl-C until it has ended the block.

    CasADi clears whatever is raised while it looks at the arguments of a call, an interruption as well: once
    in ten times a diagnosis would otherwise go on to its end. Nothing is changed outside the main thread,
    where signals are handled otherwise already, and on systems without timers.
    """
    if not _free():
        yield
        return
    signal.signal(signal.SIGINT, _raise)
    signal.signal(signal.SIGALRM, _repeat)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _free() -> bool:
    if threading.current_thread() is not threading.main_thread() or not hasattr(signal, "setitimer"):
        return False
    usual = signal.getsignal(signal.SIGINT) is signal.default_int_handler
    return usual and signal.getsignal(signal.SIGALRM) == signal.SIG_DFL


def _raise(number: int, frame: FrameType | None) -> None:
    signal.setitimer(signal.ITIMER_REAL, SETTINGS.repetition)
    raise KeyboardInterrupt


def _repeat(number: int, frame: FrameType | None) -> None:
    if _under_way(sys.exception()):
        signal.setitimer(signal.ITIMER_REAL, SETTINGS.repetition)  # what tidies up is left to finish
    else:
        _raise(number, frame)


def _under_way(failure: BaseException | None) -> bool:
    while failure is not None and not isinstance(failure, KeyboardInterrupt):
        failure = failure.__context__
    return failure is not None


# --- findings of the doctor -----------------------------------------------------------------------
_STYLES = {"mistake": "bold red", "warning": "yellow", "note": "dim"}

_INDENT = "    "


def show_finding(finding: Finding, map: Path | None) -> None:
    """Print one finding with what mends it; `map` is the mapping file in use."""
    line = text(f"{finding.severity}: ", _STYLES[finding.severity])
    line.append(finding.text)
    console().print(line, soft_wrap=True)
    if finding.mapping:
        where = f"in {map}" if map else "in a mapping file (--map; undertow doctor --mend writes it)"
        say(f"{_INDENT}{where}:", "green")
        for row in finding.mapping.splitlines():
            say(f"{2 * _INDENT}{row}")
    if finding.vehicle:
        either = "or in" if finding.mapping else "in"
        say(f"{_INDENT}{either} the vehicle file: {finding.vehicle}", "green")
    for other in finding.alternatives:
        say(f"{_INDENT}not excluded: {other}")
