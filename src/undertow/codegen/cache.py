"""Where compiled libraries are kept between runs, and when one is trusted."""

from __future__ import annotations

import atexit
import hashlib
import json
import logging
import os
import re
import shutil
import stat
import sys
import time
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import Protocol

from undertow.errors import UndertowError

from .source import LIBRARY_SUFFIX, digest

_LOG = logging.getLogger("undertow")
_OURS = re.compile(r"[0-9a-f]{24}(\.json|-[0-9a-f]{16}\.\w+)|build-\w+")
# Seconds that an unused library is kept.
_KEPT_FOR = 90 * 86400.0
# Seconds after which the folder of a build, which may last ten minutes, counts as left.
_LEFT_FOR = 3600.0


class LibraryBuilder(Protocol):
    """What makes a library out of a source: a command with its options."""

    @property
    def command(self) -> tuple[str, ...]: ...

    @property
    def identity(self) -> str: ...

    def build(self, source: Path, library: Path) -> None: ...


def library_for(source: str, compiler: LibraryBuilder, folder: Path | None = None) -> Path:
    """Path of the shared library of a C source, from the cache or compiled now.

    A library is taken from the cache only if the manifest beside it names this source and this compiler,
    and the library's own hash fits; otherwise it is built again. Processes may race: files appear whole,
    under names that carry their hashes.
    """
    place = folder or cache_folder()
    _forget_old(place)
    expected = {"source": digest(source), "compiler": compiler.identity}
    manifest = place / f"{digest(json.dumps(expected))[:24]}.json"
    known = _trusted(manifest, expected)
    if known is None:
        _LOG.info("compiling %d lines of C with %s", source.count("\n"), compiler.command[0])
        known = _build(source, compiler, manifest, expected)
    return known


def _trusted(manifest: Path, expected: dict[str, str]) -> Path | None:
    """The library of a manifest, if both are what they should be."""
    try:
        found = json.loads(manifest.read_text(encoding="utf-8"))
        library = manifest.parent / f"{manifest.stem}-{str(found['library'])[:16]}{LIBRARY_SUFFIX}"
        fits = {k: found[k] for k in expected} == expected and _sha256(library) == found["library"]
        for used in (manifest, library):
            os.utime(used)
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return library if fits else None


def _build(source: str, compiler: LibraryBuilder, manifest: Path, expected: dict[str, str]) -> Path:
    try:
        with TemporaryDirectory(prefix="build-", dir=manifest.parent, ignore_cleanup_errors=True) as name:
            place = Path(name)
            (place / "model.c").write_text(source, encoding="utf-8")
            built = place / f"model{LIBRARY_SUFFIX}"
            compiler.build(place / "model.c", built)
            found = _sha256(built)
            library = manifest.parent / f"{manifest.stem}-{found[:16]}{LIBRARY_SUFFIX}"
            os.replace(built, library)
            content = json.dumps({**expected, "library": found})
            (place / "manifest.json").write_text(content, encoding="utf-8")
            os.replace(place / "manifest.json", manifest)
    except OSError as error:
        raise UndertowError(
            f"cannot keep compiled code in '{manifest.parent}': {error}; make room or set XDG_CACHE_HOME"
        ) from error
    return library


@cache
def _forget_old(folder: Path) -> None:
    """Remove what has not been used for months, and what killed builds have left; once in a process."""
    now = time.time()
    with suppress(OSError):
        for path in [p for p in folder.iterdir() if _OURS.fullmatch(p.name)]:
            with suppress(OSError):
                kept_for = _LEFT_FOR if path.name.startswith("build-") else _KEPT_FOR
                if path.lstat().st_mtime < now - kept_for:
                    shutil.rmtree(path) if path.is_dir() else path.unlink()


def _sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


# --- the folder ---------------------------------------------------------------------------------


def cache_folder() -> Path:
    """The user's own folder for compiled libraries, or a private temporary one if that is not safe.

    Links on the way to it are followed first, so that what is checked is what is used.
    """
    place = _user_cache()
    wanted = Path(os.path.realpath(place), "undertow")
    reason = _unsafe(wanted) if place.is_absolute() else "has no place of its own, as the user has no home"
    if reason is None:
        return wanted
    return _private_folder(f"cache folder '{wanted}' {reason}")


def _user_cache() -> Path:
    configured = os.environ.get("LOCALAPPDATA" if sys.platform == "win32" else "XDG_CACHE_HOME", "")
    # The XDG specification has relative paths ignored. Without a home this one is relative, too.
    return Path(configured if os.path.isabs(configured) else os.path.expanduser("~/.cache"))


def _unsafe(folder: Path) -> str | None:
    """Why nothing in this folder can be trusted, or None; the folder is made if it is missing."""
    try:
        folder.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError as error:
        return f"cannot be used ({error.strerror})"
    if not stat.S_ISDIR(found.st_mode):
        return "is not a folder of its own"
    if sys.platform == "win32":
        return None
    if found.st_uid != os.geteuid():
        return f"belongs to user {found.st_uid}"
    if found.st_mode & 0o022:
        return f"can be written by others (mode {stat.S_IMODE(found.st_mode):o})"
    if not os.access(folder, os.W_OK):
        return "cannot be written"
    return next(filter(None, map(_replaceable, folder.parents)), None)


def _replaceable(parent: Path) -> str | None:
    """Why somebody else could put another folder in the place of one in `parent`, or None."""
    found = parent.stat()
    if found.st_mode & 0o002 and not found.st_mode & stat.S_ISVTX:
        return f"lies in '{parent}', which everybody can write"
    if found.st_uid not in (0, os.geteuid()):
        return f"lies in '{parent}', which belongs to user {found.st_uid}"
    return None


@cache
def _private_folder(reason: str) -> Path:
    try:
        folder = Path(mkdtemp(prefix="undertow-"))
    except OSError as error:
        raise UndertowError(
            f"{reason}, and no temporary folder can be made ({error.strerror}): set XDG_CACHE_HOME or TMPDIR "
            "to a folder of your own"
        ) from error
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    _LOG.warning("%s: compiled code is kept in a private folder for this run only", reason)
    return folder
