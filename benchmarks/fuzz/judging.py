"""Whether a reader or a command did what it has to do with a damaged file."""

from __future__ import annotations

import io
import os
import re
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import chdir, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from undertow.cli.main import main

from .cases import Case
from .readers import READERS, Reader, read_both, refusal

_NO_NUMBER = re.compile(r"(?<![\w./'\"-])-?nan(?![\w'\"])", re.IGNORECASE)
_CODES = {0: "answered yes", 1: "answered no", 2: "refused"}


class Outcome(NamedTuple):
    """What came of a case; `words` says what is wrong with it, if anything is."""

    said: str
    words: str = ""


@dataclass
class Heard:
    """What was said meanwhile: printed, printed as errors, by libraries beneath Python, and warned of."""

    out: str = ""
    err: str = ""
    beneath: str = ""
    warned: list[str] = field(default_factory=list)

    @property
    def aside(self) -> str:
        """What no user is to see; empty where there is none."""
        reported = [f"a warning of a library: {self.warned[0]}"] if self.warned else []
        reported += [f"a library prints: {self.beneath.strip()[:160]!r}"] if self.beneath else []
        return "; ".join(reported)


@contextmanager
def hearing() -> Iterator[Heard]:
    """All that is said in the block."""
    heard, out, err = Heard(), io.StringIO(), io.StringIO()
    try:
        with _beneath(heard), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            with redirect_stdout(out), redirect_stderr(err):
                yield heard
    finally:
        heard.out, heard.err = out.getvalue(), err.getvalue()
        heard.warned = [f"{Path(w.filename).name}:{w.lineno} {w.message!s:.160}" for w in caught]


@contextmanager
def _beneath(heard: Heard) -> Iterator[None]:
    """What goes to the process's own stdout and stderr: LAPACK and Rust know nothing of Python's."""
    kept = os.dup(1), os.dup(2)
    with tempfile.TemporaryFile() as file:
        try:
            os.dup2(file.fileno(), 1)
            os.dup2(file.fileno(), 2)
            yield
        finally:
            for place, old in zip((1, 2), kept, strict=True):
                os.dup2(old, place)
                os.close(old)
            file.seek(0)
            heard.beneath = file.read().decode("utf-8", "replace")


def outcome(case: Case, folder: Path) -> Outcome:
    """Let the reader or the command have the file, in a folder that is empty before."""
    try:
        with chdir(folder):
            return _command(case, folder) if case.command else _read(case, folder)
    except BaseException as error:  # a panic of a library is no Exception
        if isinstance(error, KeyboardInterrupt):
            raise
        return Outcome("failed", reported(error))


def reported(error: BaseException) -> str:
    """Kind, words and place of what was raised, in one line."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "site-packages" not in f.filename]
    place = f"{Path(frames[-1].filename).name}:{frames[-1].lineno} {frames[-1].name}" if frames else ""
    return f"{type(error).__name__} at {place}: {' '.join(str(error).split())[:160]}"


def _read(case: Case, folder: Path) -> Outcome:
    reader = READERS[case.reader]
    path = folder / f"damaged{reader.suffix}"
    path.write_bytes(case.content)
    with hearing() as heard:
        words = refusal(reader, path)
        if case.reader == "mapping" and not words:
            (folder / "log.csv").write_bytes(case.beside["log.csv"])
            words = _with_log(path, folder / "log.csv")
    if heard.aside or heard.out or heard.err:
        return Outcome("failed", heard.aside or f"a reader speaks: {(heard.out + heard.err)[:160]!r}")
    return Outcome("refused" if words else "read")


def _with_log(mapping: Path, log: Path) -> str:
    return refusal(Reader(".toml", lambda path: read_both(path, log)), mapping)


def _command(case: Case, folder: Path) -> Outcome:
    for name, content in {**case.beside, case.file: case.content}.items():
        (folder / name).write_bytes(content)
    before = _files(folder)
    with hearing() as heard:
        code = main(case.command.format(case.file).split())
    words = _fault(code, heard.out, heard.err) or heard.aside or _left(code, _files(folder) - before)
    return Outcome("failed", words) if words else Outcome(_CODES[code])


def _files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def _left(code: int, new: set[str]) -> str:
    """What a command that refused has left behind."""
    half = [name for name in new if os.path.basename(name).startswith(".undertow-")]
    left = sorted(new) if code == 2 else half
    return f"exit code {code}, and left behind {', '.join(left)}" if left else ""


def _fault(code: int, out: str, err: str) -> str:
    lines = [line for line in err.splitlines() if line.strip()]
    if code not in _CODES:
        return f"exit code {code}"
    if "Traceback" in err:
        return f"traceback: {_innermost(lines)}"
    if code == 2 and [line.startswith("error: ") for line in lines].count(True) != 1:
        return f"exit code 2 without one line of error: {lines!r:.160}"
    if code == 0 and _NO_NUMBER.search(out):
        return f"exit code 0 with nan: {next(li for li in out.splitlines() if _NO_NUMBER.search(li))[:160]!r}"
    return ""


def _innermost(lines: list[str]) -> str:
    """Last frame of ours and last line of a traceback."""
    frames = [line.strip() for line in lines if line.lstrip().startswith('File "')]
    own = [frame for frame in frames if "site-packages" not in frame] or frames or [""]
    place = re.sub(r'File ".*?([^/]+)", line (\d+), in (.*)', r"\1:\2 \3", own[-1])
    said = [line for line in lines if re.match(r"[A-Za-z_.]+(Error|Exception|Warning|Interrupt)\b", line)]
    return f"{(said or lines)[-1][:160]} at {place}"
