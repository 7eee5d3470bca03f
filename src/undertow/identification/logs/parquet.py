"""Parquet files, which are decoded elsewhere first.

A damaged file can make polars panic, or end the process without a word (a run length of 2^61 is an
allocation that aborts), and a small one can hold any number of equal rows. So its footer is looked at before
its data, and a helper process with limited memory decodes it before this one does.
"""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from pathlib import Path

import polars as pl

from undertow.errors import UndertowError

# Of one column after the other nothing is kept but a number; columns of lists are never read.
_DECODE = """
import json, sys
import polars as pl
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, 2 * (int(sys.argv[1]),))
except (ImportError, ValueError, OSError):
    pass
for line in sys.stdin:
    try:
        table = pl.scan_parquet(json.loads(line), glob=False, hive_partitioning=False)
        flat = [name for name, kind in table.collect_schema().items() if not kind.is_nested()]
        table.select(pl.col(flat).hash().max()).collect(engine="streaming")
        told = ""
    except BaseException as error:
        told = (str(error).split("\\n")[0] or type(error).__name__).strip()
    print(json.dumps(told), flush=True)
"""
_UNREADABLE = (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError)


def flat_table(path: Path, where: str, most_cells: int | None = None) -> pl.LazyFrame:
    """A Parquet file that can be decoded, not yet read; columns of lists or structures have no value in it.

    Parameters
    ----------
    path : Path
        The file.
    where : str
        What it is called in messages.
    most_cells : int, optional
        Rows times columns that it may have.

    Raises
    ------
    UndertowError
        If it cannot be decoded, or has more cells.
    """
    try:
        table = pl.scan_parquet(path, glob=False, hive_partitioning=False)
        kinds = table.collect_schema()
        rows = table.select(pl.len()).collect().item()
    except _UNREADABLE as error:
        raise UndertowError(_unreadable(where, str(error))) from error
    if most_cells is not None and rows * len(kinds) > most_cells:
        raise UndertowError(too_many_cells(where, rows, len(kinds), most_cells))
    told = _HELPER.trouble_with(path)
    if told is not None:
        raise UndertowError(_unreadable(where, told))
    return table.with_columns(
        pl.lit(None).cast(kind).alias(n) for n, kind in kinds.items() if kind.is_nested()
    )


def too_many_cells(where: str, rows: int, columns: int, most: int) -> str:
    """What to say of a table that memory is not meant for."""
    return (
        f"{where} has {rows} rows of {columns} columns or more, at most {most // max(columns, 1)} such rows "
        "are read as a whole: leave out columns and rows, or split it"
    )


def _unreadable(where: str, reason: str) -> str:
    line = reason.split("\n")[0].strip() or "the reader breaks down"
    return f"{where} cannot be read as a table: {line}: check that it is whole, or export it again"


@dataclass
class _Helper:
    """A process that decodes one file after the other; a new one where it has ended with a file.

    Attributes
    ----------
    memory : int
        Bytes of address space that it may have: what a table of the most cells needs, three times over.
    """

    memory: int = 6_000_000_000
    _process: subprocess.Popen[str] | None = None
    _owner: int = 0
    _turn: threading.Lock = field(default_factory=threading.Lock)

    def trouble_with(self, path: Path) -> str | None:
        """Why a file cannot be decoded; None where it can, or no helper can be started."""
        with self._turn:
            try:
                process = self._started()
                assert process.stdin is not None
                assert process.stdout is not None
                process.stdin.write(json.dumps(str(path.absolute())) + "\n")
                process.stdin.flush()
                answer = process.stdout.readline()
            except OSError:
                return None
            if not answer:
                process.communicate()
                return "the reader breaks down, for the file is damaged or needs too much memory"
            return str(json.loads(answer)) or None

    def _started(self) -> subprocess.Popen[str]:
        # A process that was forked off has the helper of its parent, whose answers are not its own.
        if self._process is None or self._process.poll() is not None or self._owner != os.getpid():
            self._owner = os.getpid()
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", _DECODE, str(self.memory)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                encoding="utf-8",
                # Threads reserve address space, on a large machine more than there is to be.
                env={**os.environ, "POLARS_MAX_THREADS": "2", "PYTHONIOENCODING": "utf-8"},
            )
        return self._process

    def close(self) -> None:
        """End the process that this one has started, if there is one."""
        if self._process is not None and self._owner == os.getpid():
            self._process.terminate()
            self._process.communicate()


_HELPER = _Helper()
atexit.register(_HELPER.close)
