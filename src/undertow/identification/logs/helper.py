"""Another process that tries what may break down or hang with a damaged file."""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
import threading
from dataclasses import dataclass, field
from typing import Any

_LIMITED = """
import sys
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, 2 * (int(sys.argv[1]),))
except (ImportError, ValueError, OSError):
    pass
"""


@dataclass
class Helper:
    """A process that answers one question after the other; a new one where it has ended with a question.

    `program` is Python that answers every line of JSON with a line of JSON; `memory` are the bytes of address
    space that it may have.
    """

    program: str
    memory: int = 6_000_000_000  # what a table of the most cells needs, three times over
    _process: subprocess.Popen[str] | None = None
    _owner: int = 0
    _turn: threading.Lock = field(default_factory=threading.Lock)

    def __post_init__(self) -> None:
        atexit.register(self.close)

    def answer(self, question: Any, without: Any, broken: Any) -> Any:
        """The answer; `without` where no helper can be started, and `broken` where the question ended it."""
        with self._turn:
            try:
                process = self._started()
                assert process.stdin is not None
                assert process.stdout is not None
                process.stdin.write(json.dumps(question) + "\n")
                process.stdin.flush()
                answer = process.stdout.readline()
            except OSError:
                return without
            if not answer:
                process.communicate()
                return broken
            return json.loads(answer)

    def _started(self) -> subprocess.Popen[str]:
        # A process that was forked off has the helper of its parent, whose answers are not its own.
        if self._process is None or self._process.poll() is not None or self._owner != os.getpid():
            self._owner = os.getpid()
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", f"{_LIMITED}{self.program}", str(self.memory)],
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
