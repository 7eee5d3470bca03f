"""A disk that fails."""

from __future__ import annotations

import builtins
from pathlib import Path


class HalfWritten:
    """A file that takes half of the data before something happens."""

    def __init__(self, path: Path, failure: BaseException) -> None:
        self._stream, self._failure = builtins.open(path, "xb"), failure  # noqa: SIM115

    def __enter__(self) -> HalfWritten:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def write(self, data: bytes) -> None:
        self._stream.write(data[: len(data) // 2])
        self._stream.flush()
        raise self._failure
