"""Files are written whole or not at all."""

from __future__ import annotations

import builtins
import errno
import hashlib
import os
import stat
import threading
from pathlib import Path

import pytest

from undertow import files
from undertow.errors import UndertowError
from undertow.files import sha256_of, write_whole


class _Stream:
    """A file whose write puts half of the data on the disk and then fails."""

    def __init__(self, path: Path, failure: BaseException) -> None:
        self._stream = builtins.open(path, "xb")  # noqa: SIM115
        self._failure = failure

    def __enter__(self) -> _Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def write(self, payload: bytes) -> None:
        self._stream.write(payload[: len(payload) // 2])
        self._stream.flush()
        raise self._failure


def _fail_with(monkeypatch: pytest.MonkeyPatch, failure: BaseException) -> None:
    monkeypatch.setattr(files, "open", lambda path, mode: _Stream(path, failure), raising=False)


def _contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize(
    ("data", "bytes_"), [("h = 2 m\r\nφ\n", "h = 2 m\r\nφ\n".encode()), (b"\0\xff", b"\0\xff"), ("", b"")]
)
def test_the_bytes_are_those_given_and_nothing_else_is_left(
    tmp_path: Path, data: str | bytes, bytes_: bytes
) -> None:
    write_whole(tmp_path / "a", data)
    assert _contents(tmp_path) == {"a": bytes_}


def test_an_existing_file_is_replaced_and_keeps_its_permission_bits(tmp_path: Path) -> None:
    target = tmp_path / "a.toml"
    target.write_text("old and longer")
    target.chmod(0o640)
    write_whole(str(target), "new")
    assert target.read_text() == "new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_a_new_file_gets_the_permission_bits_of_any_new_file(tmp_path: Path) -> None:
    (tmp_path / "usual").write_text("")
    write_whole(tmp_path / "ours", "")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_a_link_stays_a_link_and_its_destination_is_written(tmp_path: Path) -> None:
    (tmp_path / "real").write_text("old")
    link = tmp_path / "link"
    link.symlink_to("real")
    write_whole(link, "new")
    assert link.is_symlink()
    assert (tmp_path / "real").read_text() == "new"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
def test_a_pipe_is_written_to_and_not_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    got: list[bytes] = []
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    write_whole(pipe, "through")
    reader.join()
    assert got == [b"through"]
    assert stat.S_ISFIFO(pipe.stat().st_mode)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (errno.ENOSPC, "free some space"),
        (errno.EROFS, "choose a folder you may write to"),
        (errno.EIO, "choose another place"),
    ],
)
def test_a_failing_disk_leaves_everything_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: int, words: str
) -> None:
    (tmp_path / "a").write_text("old")
    _fail_with(monkeypatch, OSError(code, os.strerror(code)))
    with pytest.raises(UndertowError) as caught:
        write_whole(tmp_path / "a", "a long new text")
    assert _contents(tmp_path) == {"a": b"old"}
    message = str(caught.value)
    assert message.startswith(f"cannot write '{tmp_path / 'a'}': {os.strerror(code).lower()}")
    assert "nothing was written" in message
    assert words in message
    assert "\n" not in message


@pytest.mark.parametrize("failure", [KeyboardInterrupt(), MemoryError()])
def test_an_interruption_leaves_nothing_half_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failure: BaseException
) -> None:
    _fail_with(monkeypatch, failure)
    with pytest.raises(type(failure)):
        write_whole(tmp_path / "new", "a long new text")
    assert _contents(tmp_path) == {}


def test_ctrl_c_at_the_last_moment_removes_the_temporary_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_whole(tmp_path / "new", "text")
    assert _contents(tmp_path) == {}


def test_a_folder_that_refuses_is_named_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(path: Path, mode: str) -> None:  # what a read-only folder answers; root would be let through
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(files, "open", refused, raising=False)
    with pytest.raises(UndertowError, match=r"permission denied.*choose a folder you may write to"):
        write_whole(tmp_path / "a", "text")


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder(tmp_path: Path) -> None:
    tmp_path.chmod(0o555)
    with pytest.raises(UndertowError, match="permission denied"):
        write_whole(tmp_path / "a", "text")
    tmp_path.chmod(0o755)


def test_a_write_protected_file_is_not_overwritten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a").write_text("old")
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(UndertowError, match="write-protected"):
        write_whole(tmp_path / "a", "new")
    assert _contents(tmp_path) == {"a": b"old"}


def test_places_where_no_file_can_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(UndertowError, match=r"'.*nowhere' does not exist; create it first"):
        write_whole(tmp_path / "nowhere" / "a", "")
    with pytest.raises(UndertowError, match="is not a folder"):
        write_whole(tmp_path / "file" / "a", "")
    with pytest.raises(UndertowError, match="it is a folder"):
        write_whole(tmp_path, "")
    with pytest.raises(UndertowError, match=r"name too long.*choose a shorter name"):
        write_whole(tmp_path / ("a" * 300), "")
    assert _contents(tmp_path) == {"file": b""}


def test_the_hash_is_that_of_the_bytes(tmp_path: Path) -> None:
    data = bytes(range(256)) * 4096
    write_whole(tmp_path / "a", data)
    assert sha256_of(tmp_path / "a") == hashlib.sha256(data).hexdigest()


def test_hashing_what_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(UndertowError, match=r"cannot read '.*missing': no such file"):
        sha256_of(tmp_path / "missing")
    with pytest.raises(UndertowError, match="cannot read"):
        sha256_of(tmp_path)
