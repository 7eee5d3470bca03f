"""Reading small files within limits, writing files whole or not at all, and hashing them."""

from __future__ import annotations

import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from math import isfinite
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

from undertow.errors import UndertowError

if TYPE_CHECKING:
    from jinja2 import Environment

_REMEDIES = {
    errno.ENOSPC: "free some space there or write to another disk",
    errno.EDQUOT: "free some space of your quota or write to another disk",
    errno.EACCES: "choose a folder you may write to",
    errno.EPERM: "choose a folder you may write to",
    errno.EROFS: "choose a folder you may write to",
    errno.ENAMETOOLONG: "choose a shorter name",
}


# --- reading ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TextLimits:
    """What a file of statements (vehicle, gains, mapping, diagnosis) may be before it is parsed."""

    # Bytes. The largest honest one, a vehicle of 60 effects with its history, has a twentieth of it.
    size: int = 2_000_000
    # Parts of a dotted key, and brackets within each other. A parser needs time in the square of the first
    # and stack for the second; an honest file has four.
    depth: int = 32
    # keys and headings with dots: tomlkit, which keeps comments, takes time in the square of their number (1
    # s for these)
    dotted_keys: int = 4_000
    integer: int = 2**63  # largest magnitude of an integer, that of 64 bits, which TOML promises


STATEMENTS = TextLimits()
RESULTS = TextLimits(size=100_000_000)
"""Results that undertow wrote itself hold samples: the JSON of a diagnosis of ten long logs has 5 MB."""

# A string that does not end is taken to the end of the text: a parser gives up there as well.
_QUOTED = re.compile(
    r""" \"{3}(?:[^"\\]++|\\.|"(?!""))*+"{0,5} | '{3}(?:[^']++|'(?!''))*+'{0,5}
       | "(?:[^"\\\n]++|\\.)*+"? | '[^'\n]*+'? | \#[^\n]*+ """,
    re.DOTALL | re.VERBOSE,
)
_DECIMAL = re.compile(r"(?<![\w.-])[+-]?\d+\.\d+(?:[eE][+-]?\d+)?(?![\w.])")
_DOTTED = re.compile(r"(?<![\w-])[\w-]++(?:[ \t]*+\.[ \t]*+[\w-]++)+")
_BRACKET = re.compile(r"[\[\]{}]")


def read_text(path: str | os.PathLike[str], kind: str, limits: TextLimits = STATEMENTS) -> str:
    """Read a text file (UTF-8) that is no longer than such a file may be."""
    try:
        with Path(path).open("rb") as stream:
            data = stream.read(limits.size + 1)  # a device or a pipe has no size
    except (OSError, ValueError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or str(error)
        raise UndertowError(
            f"{kind} {path}: cannot be read: {reason}: give the path of a readable file"
        ) from error
    if len(data) > limits.size:
        size = max(len(data), os.stat(path).st_size)
        raise UndertowError(
            f"{path}: {size} bytes are too many for a {kind} (limit {limits.size}): check that it is one"
        )
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UndertowError(
            f"{path}: not UTF-8 text (byte {error.start} is 0x{data[error.start]:02x}): save it as UTF-8"
        ) from error


def files_beside(path: Path) -> list[str]:
    """Names of the files in the folder of a path that need not exist."""
    try:
        return [p.name for p in path.parent.iterdir() if p.is_file()]
    except (OSError, ValueError):  # no such folder, one that may not be read, an impossible name
        return []


def read_toml(path: str | os.PathLike[str], kind: str) -> dict[str, Any]:
    """Read a TOML file; what would make a parser work for minutes is refused before it is parsed."""
    text, where = read_text(path, kind), os.fspath(path)
    _refuse_depth(text, where, kind)
    try:
        content = tomllib.loads(text)
    except ValueError as error:  # TOMLDecodeError; integers of thousands of digits; days that are none
        reason = str(error).partition("; use sys.")[0]  # the remedy of Python is for programmers
        raise UndertowError(f"{where}: not valid TOML: {reason}") from error
    _refuse_integers(content, "", where)
    return content


def read_json(path: str | os.PathLike[str], kind: str) -> str:
    """Read the text of a JSON file of reasonable size and depth; what it holds is for the caller to check."""
    text = read_text(path, kind, RESULTS)
    if _depth(_QUOTED.sub("_", text)) > RESULTS.depth:
        raise UndertowError(_too_deep(os.fspath(path), kind, RESULTS.depth))
    return text


def json_ready(content: Any, not_finite: Callable[[float], Any] = lambda _: None) -> Any:
    """Content as JSON has it: sequences and arrays as lists, complex numbers as [real, imaginary].

    Numbers that are not finite become what `not_finite` makes of them.
    """
    if isinstance(content, Mapping):
        return {str(k): json_ready(v, not_finite) for k, v in content.items()}
    if isinstance(content, list | tuple):
        return [json_ready(v, not_finite) for v in content]
    if isinstance(content, complex):
        return json_ready([content.real, content.imag], not_finite)
    if isinstance(content, float):
        return float(content) if isfinite(content) else not_finite(content)
    return json_ready(content.tolist(), not_finite) if hasattr(content, "tolist") else content


def _refuse_depth(text: str, where: str, kind: str) -> None:
    bare, limits = _DECIMAL.sub("0", _QUOTED.sub("_", text)), STATEMENTS
    dots = [key.count(".") for key in _DOTTED.findall(bare)]
    if max(dots, default=0) >= limits.depth:
        raise UndertowError(
            f"{where}: a key with so many dots ({max(dots)}, limit {limits.depth - 1}) does not belong in a "
            f"{kind}: shorten it"
        )
    if len(dots) > limits.dotted_keys:
        raise UndertowError(
            f"{where}: {len(dots)} keys with dots are too many for a {kind} (limit {limits.dotted_keys}): "
            "write tables such as [columns]"
        )
    if _depth(bare) > limits.depth:
        raise UndertowError(_too_deep(where, kind, limits.depth))


def _too_deep(where: str, kind: str, most: int) -> str:
    return f"{where}: values are nested too deeply for a {kind} (limit {most} brackets): write them flat"


def _depth(bare: str) -> int:
    """How many brackets are open at most, in a text without strings and comments."""
    now = most = 0
    for bracket in _BRACKET.findall(bare):
        now = now + 1 if bracket in "[{" else max(now - 1, 0)
        most = max(most, now)
    return most


def _refuse_integers(value: object, key: str, where: str) -> None:
    """Refuse integers that neither a float nor 64 bits hold: 0xfff... of any length is one."""
    if isinstance(value, dict):
        for name, inner in value.items():
            _refuse_integers(inner, f"{key}.{name}" if key else name, where)
    elif isinstance(value, list):
        for inner in value:
            _refuse_integers(inner, key, where)
    elif isinstance(value, int) and not -STATEMENTS.integer <= value < STATEMENTS.integer:
        raise UndertowError(
            f"{where}: not valid TOML: {key} is an integer of {value.bit_length()} bits (limit 64): write it "
            "as a decimal number"
        )


# --- writing ------------------------------------------------------------------------------------


def write_whole(path: str | os.PathLike[str], data: str | bytes) -> None:
    """Write a file so that either all of it stands there or nothing has changed.

    The data go to a temporary file in the same folder, are flushed to the disk and then take the place of the
    target in one step. Whatever interrupts this (a full disk, Ctrl-C), the temporary file is removed and an
    older target is left as it was. The permission bits of an existing target are kept; a link is followed; a
    device or pipe is simply written to.

    `data`: text (written as UTF-8, line ends unchanged) or bytes.
    """
    target = Path(path)
    payload = data.encode("utf-8") if isinstance(data, str) else data
    with together() as files:
        try:
            files.add(target, payload)
        except OSError as failure:
            raise UndertowError(_refusal(target, failure)) from failure


def make_folder(path: str | os.PathLike[str]) -> None:
    """Make a folder, and those above it, where they are missing."""
    folder = Path(path)
    with together() as files:
        try:
            missing = [p for p in (folder, *folder.parents) if not p.exists()]
            folder.mkdir(parents=True, exist_ok=True)
            files.folders += reversed(missing)
        except OSError as failure:
            reason = f"cannot make folder '{folder}': {_reason(failure)}"
            remedy = _REMEDIES.get(failure.errno or 0, "choose another place")
            raise UndertowError(f"{reason}; {remedy}") from failure


@contextmanager
def together() -> Iterator[FileSet]:
    """All files that are written within the block appear at its end, or none of them.

    Until then they stand under temporary names beside their targets. Whatever ends the block early, those
    are removed, and so are the folders made in it. A block within another is part of it.
    """
    outer = _OPEN.get()
    if outer is not None:
        yield outer
        return
    files = FileSet()
    token = _OPEN.set(files)
    try:
        yield files
        files.appear()
    except BaseException:  # Ctrl-C too must leave nothing behind
        files.remove()
        raise
    finally:
        _OPEN.reset(token)


@dataclass
class FileSet:
    """Files that appear together."""

    staged: list[tuple[Path, Path]] = field(default_factory=list)  # files on the disk under temporary names
    streams: list[tuple[Path, bytes]] = field(default_factory=list)  # what goes to devices and pipes
    folders: list[Path] = field(default_factory=list)  # folders made for them, the outer ones first

    def add(self, target: Path, payload: bytes) -> None:
        """Put a file on the disk under a temporary name."""
        _check_target(target)
        mode = target.stat().st_mode if target.exists() else None
        if mode is not None and not stat.S_ISREG(mode):
            self.streams.append((target, payload))  # /dev/stdout, a pipe: there is nothing to replace
            return
        target = target.resolve()  # replace what a link points to, not the link
        temporary = _beside(target)
        self.staged.append((temporary, target))
        with open(temporary, "xb") as stream:
            stream.write(payload)
            stream.flush()
            os.fsync(stream.fileno())
        if mode is not None:
            temporary.chmod(stat.S_IMODE(mode))

    def place_of(self, target: Path) -> Path:
        """Where a file stands now that was written within the block, for reading it again."""
        now = {staged: temporary for temporary, staged in self.staged}
        return now.get(target.resolve(), target)

    def appear(self) -> None:
        """Give all files their names; where one cannot have it, the others are as they were."""
        now, replaced = Path(), list[tuple[Path, Path | None]]()
        try:
            for now, payload in self.streams:
                now.write_bytes(payload)
            for temporary, now in self.staged:
                replaced.append((now, _kept(now) if len(self.staged) > 1 else None))
                os.replace(temporary, now)
        except BaseException as failure:
            for target, old in reversed(replaced[:-1]):
                target.unlink() if old is None else os.replace(old, target)
            if isinstance(failure, OSError):
                raise UndertowError(_refusal(now, failure)) from failure
            raise
        finally:
            _remove(old for _, old in replaced if old is not None)

    def remove(self) -> None:
        """Remove what has not appeared."""
        _remove(temporary for temporary, _ in self.staged)
        for folder in reversed(self.folders):
            with suppress(OSError):
                folder.rmdir()


_OPEN: ContextVar[FileSet | None] = ContextVar("_OPEN", default=None)


def _beside(target: Path) -> Path:
    return target.with_name(f".undertow-{secrets.token_hex(8)}.tmp")


def _kept(target: Path) -> Path | None:
    """A second name for a file that is about to be replaced; None where there is none yet."""
    if not target.exists():
        return None
    old = _beside(target)
    try:
        os.link(target, old)
    except OSError:  # a file system without second names
        shutil.copy2(target, old)
    return old


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        with suppress(OSError):
            path.unlink()


def check_writable(
    *paths: str | os.PathLike[str] | None, inputs: Iterable[str | os.PathLike[str]] = ()
) -> None:
    """Refuse, before the work is done, outputs that could not be written after it."""
    outputs = [Path(path) for path in paths if path is not None]
    read = [Path(path) for path in inputs]
    for i, path in enumerate(outputs):
        _check_target(path)
        if not _is_special(path):
            _try_folder(path)
        taken = next((other for other in read if other.is_file() and _same(path, other)), None)
        if taken is not None:
            raise UndertowError(f"output '{path}' is the input '{taken}': choose another name for it")
        if any(_same(path, other) for other in outputs[:i] if not _is_special(other)):
            raise UndertowError(f"'{path}' is named for two outputs: choose another name for one of them")


def check_folder(path: str | os.PathLike[str]) -> None:
    """Refuse, before the work is done, a folder that could not be made or written into after it."""
    folder = Path(path)
    existing = next(p for p in (folder, *folder.parents) if p.exists())
    if not existing.is_dir():
        raise UndertowError(
            f"cannot write into '{folder}': '{existing}' is not a folder; choose another place"
        )
    _refuse_closed(existing, f"into '{folder}'")


def _refuse_closed(folder: Path, place: str) -> None:
    if not os.access(folder, os.W_OK):
        raise UndertowError(f"cannot write {place}: permission denied: {_REMEDIES[errno.EACCES]}")


def _check_target(path: Path) -> None:
    folder = path.parent
    if not folder.exists():
        raise UndertowError(f"cannot write '{path}': the folder '{folder}' does not exist; create it first")
    if not folder.is_dir():
        raise UndertowError(f"cannot write '{path}': '{folder}' is not a folder; choose another place")
    if path.is_dir():
        raise UndertowError(f"cannot write '{path}': it is a folder; give the name of a file")
    if path.exists() and not os.access(path, os.W_OK):
        raise UndertowError(f"cannot write '{path}': it is write-protected; choose another name")


def _try_folder(path: Path) -> None:
    """Make a file without a name there: where no file can be (/proc), permissions do not show it."""
    _refuse_closed(path.parent, f"'{path}'")
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


def templates(package: str, *, html: bool = False) -> Environment:
    """The templates of a package: names that nobody gave are errors, and lines of tags leave no blank ones.

    html: whether every text is escaped for HTML; the caller makes others harmless.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # slow to import

    return Environment(
        loader=PackageLoader(package),
        autoescape=html,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=not html,
    )


def sha256_of(path: str | os.PathLike[str]) -> str:
    """The SHA-256 of a file's bytes as 64 hexadecimal digits."""
    try:
        with open(path, "rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except OSError as failure:
        raise UndertowError(f"cannot read '{os.fspath(path)}': {_reason(failure)}") from failure


def file_hash(path: Path) -> str:
    """SHA-256 of the bytes of a file, or of all files of a folder in the order of their names."""
    if not path.is_dir():
        return sha256_of(path)
    return hash_of(file for file in sorted(path.rglob("*")) if file.is_file())


def hash_of(files: Iterable[Path]) -> str:
    """SHA-256 of the bytes of several files, in their order."""
    hashes = (sha256_of(file) for file in files)
    return hashlib.sha256(b"".join(map(bytes.fromhex, hashes))).hexdigest()


def _reason(failure: OSError) -> str:
    return (failure.strerror or str(failure) or type(failure).__name__).lower()


def _refusal(target: Path, failure: OSError) -> str:
    remedy = _REMEDIES.get(failure.errno or 0, "choose another place")
    return f"cannot write '{target}': {_reason(failure)}; nothing was written; {remedy}"
