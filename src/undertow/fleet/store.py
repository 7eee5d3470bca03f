"""What was worked out of partitions, kept by the content of their files."""

from __future__ import annotations

import hashlib
import io
import zipfile
import zlib
from pathlib import Path

import numpy as np

from undertow.errors import UndertowError
from undertow.files import check_folder, write_whole

from .reduction import Reduced

_KINDS = ("samples", "seconds", "entries")
# What reading a damaged file raises: its packing, its list of contents, or a flag for what is not supported.
_DAMAGED = (
    OSError,
    ValueError,
    KeyError,
    EOFError,
    RuntimeError,  # "encrypted", or NotImplementedError
    zipfile.BadZipFile,
    zlib.error,
)


class Store:
    """A folder with one small file for each partition that is done.

    Its name comes from the hash of the log's bytes and of all that decides what is made of them: a log that
    was moved or renamed is found again, one that was changed is not.

    Parameters
    ----------
    folder : Path
        Where; made if it is not there.

    Raises
    ------
    UndertowError
        If nothing can be written there.
    """

    def __init__(self, folder: Path) -> None:
        check_folder(folder)
        self.folder = folder / "partitions"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UndertowError(f"cannot make '{self.folder}': {error.strerror}; choose another") from error

    def _path(self, fingerprint: str, sha256: str) -> Path:
        return self.folder / f"{hashlib.sha256(f'{fingerprint}{sha256}'.encode()).hexdigest()}.npz"

    def get(self, fingerprint: str, sha256: str) -> Reduced | None:
        """What is known of a log; None where nothing is, or the file is damaged."""
        path = self._path(fingerprint, sha256)
        try:
            return _read(path.read_bytes()) if path.is_file() else None
        except _DAMAGED:
            return None

    def put(self, fingerprint: str, sha256: str, reduced: Reduced) -> None:
        """Keep what was worked out of a log."""
        stream = io.BytesIO()
        np.savez_compressed(
            stream,
            factor=reduced.factor,
            names=np.array(reduced.names),
            samples=np.array(reduced.samples),
            seconds=np.array(reduced.seconds),
            entries=np.array(reduced.entries),
        )
        write_whole(self._path(fingerprint, sha256), stream.getvalue())


def _read(data: bytes) -> Reduced | None:
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        if packed.testzip() is not None:  # NumPy reads on without the checksum
            return None
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:
        samples, seconds, entries = (stored[kind].item() for kind in _KINDS)
        names = tuple(str(n) for n in stored["names"])
        return Reduced(names, stored["factor"], samples, seconds, entries)
