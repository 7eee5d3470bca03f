"""Writing files whole or not at all, and hashing them."""

from __future__ import annotations

import errno
import hashlib
import os
import secrets
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile

from undertow.errors import UndertowError

_REMEDIES = {
    errno.ENOSPC: "free some space there or write to another disk",
    errno.EDQUOT: "free some space of your quota or write to another disk",
    errno.EACCES: "choose a folder you may write to",
    errno.EPERM: "choose a folder you may write to",
    errno.EROFS: "choose a folder you may write to",
    errno.ENAMETOOLONG: "choose a shorter name",
}


def write_whole(path: str | os.PathLike[str], data: str | bytes) -> None:
    """Write a file so that either all of it stands there or nothing has changed.

    The data go to a temporary file in the same folder, are flushed to the disk and then take the place of the
    target in one step. Whatever interrupts this (a full disk, Ctrl-C), the temporary file is removed and an
    older target is left as it was. The permission bits of an existing target are kept; a link is followed; a
    device or pipe is simply written to.

    Parameters
    ----------
    path
        The file to write. Its folder must exist.
    data
        Text (written as UTF-8, line ends unchanged) or bytes.

    Raises
    ------
    UndertowError
        The folder is missing or not a folder, the target is a folder or write-protected, or the system
        refuses (no space, no permission, ...).
    """
    target = Path(path)
    payload = data.encode("utf-8") if isinstance(data, str) else data
    try:
        _write(target, payload)
    except OSError as failure:
        raise UndertowError(_refusal(target, failure)) from failure


def check_writable(
    *paths: str | os.PathLike[str] | None, inputs: Iterable[str | os.PathLike[str]] = ()
) -> None:
    """Refuse, before the work is done, outputs that could not be written after it.

    Parameters
    ----------
    paths
        Files that are going to be written; None is passed over.
    inputs
        What is read in the same work; no output may be one of these files.

    Raises
    ------
    UndertowError
        If a folder is missing or write-protected, a target is a folder, write-protected or an input, or two
        outputs are the same file.
    """
    outputs = [Path(path) for path in paths if path is not None]
    read = [Path(path) for path in inputs]
    for i, path in enumerate(outputs):
        _check_target(path)
        taken = next((other for other in read if other.is_file() and _same(path, other)), None)
        if taken is not None:
            raise UndertowError(f"output '{path}' is the input '{taken}': choose another name for it")
        if any(_same(path, other) for other in outputs[:i] if not _is_special(other)):
            raise UndertowError(f"'{path}' is named for two outputs: choose another name for one of them")


def check_folder(path: str | os.PathLike[str]) -> None:
    """Refuse, before the work is done, a folder that could not be made or written into after it.

    Raises
    ------
    UndertowError
        If it, or the nearest folder above it that exists, is write-protected or no folder.
    """
    folder = Path(path)
    existing = next(p for p in (folder, *folder.parents) if p.exists())
    if not existing.is_dir():
        raise UndertowError(f"cannot write into '{folder}': '{existing}' is no folder; choose another place")
    if not os.access(existing, os.W_OK):
        raise UndertowError(f"cannot write into '{folder}': permission denied: {_REMEDIES[errno.EACCES]}")


def _check_target(path: Path) -> None:
    if not path.parent.is_dir():
        raise UndertowError(f"cannot write '{path}': folder '{path.parent}' does not exist: make it first")
    if path.is_dir():
        raise UndertowError(f"cannot write '{path}': it is a folder: name a file in it")
    if not os.access(path if _is_special(path) else path.parent, os.W_OK):
        raise UndertowError(f"cannot write '{path}': permission denied: {_REMEDIES[errno.EACCES]}")
    if path.is_file() and not os.access(path, os.W_OK):
        raise UndertowError(f"cannot write '{path}': it is write-protected; choose another name")
    if not _is_special(path):
        _try_folder(path)


def _try_folder(path: Path) -> None:
    """Make a file without a name there: where no file can be (/proc), permissions do not tell."""
    try:
        with TemporaryFile(dir=path.resolve().parent):
            pass
    except OSError as failure:
        raise UndertowError(_refusal(path, failure)) from failure


def _is_special(path: Path) -> bool:
    """Whether this is a device or a pipe: nothing is replaced there, and it may be named twice."""
    return path.exists() and not path.is_file()


def _same(one: Path, other: Path) -> bool:
    return one.resolve() == other.resolve() or (one.exists() and other.exists() and one.samefile(other))


def sha256_of(path: str | os.PathLike[str]) -> str:
    """The SHA-256 of a file's bytes as 64 hexadecimal digits.

    Raises
    ------
    UndertowError
        The file cannot be read.
    """
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as failure:
        raise UndertowError(f"cannot read '{os.fspath(path)}': {_reason(failure)}") from failure


def _write(target: Path, payload: bytes) -> None:
    mode = _mode_of(target)
    if mode is not None and not stat.S_ISREG(mode):
        target.write_bytes(payload)  # /dev/stdout, a pipe: there is nothing to replace
        return
    target = target.resolve()  # replace what a link points to, not the link
    temporary = target.with_name(f".undertow-{secrets.token_hex(8)}.tmp")
    try:
        _fill(temporary, payload)
        if mode is not None:
            temporary.chmod(stat.S_IMODE(mode))
        os.replace(temporary, target)
    except BaseException:  # Ctrl-C too must leave nothing behind
        with suppress(OSError):
            temporary.unlink()
        raise


def _mode_of(target: Path) -> int | None:
    """The mode of an existing target that may be written, None for a new one."""
    folder = target.parent
    if not folder.exists():
        raise UndertowError(f"cannot write '{target}': the folder '{folder}' does not exist; create it first")
    if not folder.is_dir():
        raise UndertowError(f"cannot write '{target}': '{folder}' is not a folder; choose another place")
    if not target.exists():
        return None
    if target.is_dir():
        raise UndertowError(f"cannot write '{target}': it is a folder; give the name of a file")
    if not os.access(target, os.W_OK):
        raise UndertowError(f"cannot write '{target}': it is write-protected; choose another name")
    return target.stat().st_mode


def _fill(temporary: Path, payload: bytes) -> None:
    with open(temporary, "xb") as stream:
        stream.write(payload)
        stream.flush()
        os.fsync(stream.fileno())


def _reason(failure: OSError) -> str:
    return (failure.strerror or str(failure) or type(failure).__name__).lower()


def _refusal(target: Path, failure: OSError) -> str:
    remedy = _REMEDIES.get(failure.errno or 0, "choose another place")
    return f"cannot write '{target}': {_reason(failure)}; nothing was written; {remedy}"
