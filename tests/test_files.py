"""Small files are read within limits; files are written whole or not at all."""

from __future__ import annotations

import builtins
import errno
import hashlib
import os
import stat
import threading
from pathlib import Path

import pytest

from tests.failing import HalfWritten
from tests.quick import first_quick
from undertow import files
from undertow.cli.main import main
from undertow.errors import UndertowError
from undertow.files import make_folder, read_json, read_toml, sha256_of, together, write_whole


def _fail_with(monkeypatch: pytest.MonkeyPatch, failure: BaseException) -> None:
    monkeypatch.setattr(files, "open", lambda path, mode: HalfWritten(path, failure), raising=False)


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


# --- reading within limits ----------------------------------------------------------------------

_BOMBS = {
    "a key with many dots": (b"a" + b".a" * 60_000 + b".b = 1", "so many dots (60001, limit 31)"),
    "a heading with many dots": (b"[" + b".".join([b"a"] * 1_000) + b"]", "so many dots (999, limit 31)"),
    "dots with blanks and quotes": (b'"a"' + b" . 'a'" * 40 + b" = 1", "so many dots (40, limit 31)"),
    "numbers as keys": (b"1.5" + b" . 1.5" * 40 + b" = 1", "so many dots (40, limit 31)"),
    "many keys with dots": (b"".join(b"a.k%d = 1\n" % i for i in range(5_000)), "5000 keys with dots"),
    "brackets": (b"a = " + b"[" * 50_000, "nested too deeply"),
    "inline tables": (b"x = " + b"{a=" * 50_000, "nested too deeply"),
    "brackets behind a text with brackets": (b'a = "\\"]]]" # ]]\nb = ' + b"[" * 40, "nested too deeply"),
    "texts that do not end": (b'a = "' + b'\\"' * 900_000, "not valid TOML: Unterminated string"),
    "hexadecimal": (
        b"[t]\na = [1, 0x" + b"f" * 100_000 + b"]",
        "t.a is an integer of 400000 bits (limit 64)",
    ),
    "decimal": (b"a = 1" + b"0" * 30, "a is an integer of 100 bits (limit 64)"),
    "thousands of digits": (b"a = " + b"9" * 10_000, "not valid TOML: Exceeds the limit (4300 digits)"),
    "large": (b"#" * 2_000_001, "2000001 bytes are too many for a mapping file (limit 2000000)"),
    "no text": (b"a = 1 # \xff", "not UTF-8 text (byte 8 is 0xff): save it as UTF-8"),
}


@pytest.mark.parametrize("name", _BOMBS)
def test_toml_that_would_stall_a_parser_is_refused_in_one_line(name: str, tmp_path: Path) -> None:
    content, reported = _BOMBS[name]
    path = tmp_path / "log.toml"
    path.write_bytes(content)
    with pytest.raises(UndertowError) as caught:
        read_toml(path, "mapping file")
    assert reported in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert len(str(caught.value)) < 400


def test_texts_and_comments_may_hold_dots_and_brackets(tmp_path: Path) -> None:
    text = (
        "# "
        + "a." * 99
        + "[" * 99
        + "\na.b = '"
        + "[{." * 99
        + '\'\nc = """\n""[[['
        + "x." * 99
        + '\\""""\nn = ['
        + "1.5, " * 9_000
        + "]\n"
    )
    (tmp_path / "a.toml").write_text(text)
    found = read_toml(tmp_path / "a.toml", "vehicle file")
    assert (found["a"], len(found["n"])) == ({"b": "[{." * 99}, 9_000)
    assert found["c"].endswith('x."')


def test_deep_json_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "d.json").write_text('{"a\\"]": ' + "[" * 100_000)
    with pytest.raises(UndertowError, match=r"d.json: values are nested too deeply for a diagnosis"):
        read_json(tmp_path / "d.json", "diagnosis")


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="needs /dev/zero")
def test_a_file_without_an_end_is_not_read_to_it() -> None:
    with pytest.raises(UndertowError, match="bytes are too many for a vehicle file"):
        read_toml("/dev/zero", "vehicle file")


# --- files that belong together -----------------------------------------------------------------


class _SmallDisk:
    """A disk that takes so many more bytes."""

    def __init__(self, room: int, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room = room
        monkeypatch.setattr(files, "open", self.open, raising=False)

    def open(self, path: Path, mode: str) -> _Full | object:
        return _Full(self, path) if mode == "xb" else builtins.open(path, mode)


class _Full:
    """A file on it."""

    def __init__(self, disk: _SmallDisk, path: Path) -> None:
        self._disk = disk
        self._stream = builtins.open(path, "xb")  # noqa: SIM115

    def __enter__(self) -> _Full:
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.close()

    def write(self, payload: bytes) -> None:
        self._stream.write(payload[: self._disk.room])
        self._disk.room -= len(payload)
        if self._disk.room < 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def flush(self) -> None:
        self._stream.flush()

    def fileno(self) -> int:
        return self._stream.fileno()


def _write(folder: Path, *names: str, content: str) -> None:
    with together():
        for name in names:
            make_folder((folder / name).parent)
            write_whole(folder / name, content)


@pytest.mark.parametrize("room", [0, 10, 1500, 2999])
def test_a_full_disk_leaves_none_of_the_files_that_belong_together(
    room: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "b").write_text("old")
    _SmallDisk(room, monkeypatch)
    with pytest.raises(UndertowError, match=r"no space left.*nothing was written"):
        _write(tmp_path, "new/folder/a", "b", "c", content="x" * 1000)
    assert _contents(tmp_path) == {"b": b"old"}


def test_files_that_belong_together_appear_at_the_end(tmp_path: Path) -> None:
    with together() as written:
        make_folder(tmp_path / "new")
        for name in ("a", "new/b"):
            write_whole(tmp_path / name, name)
            assert not (tmp_path / name).exists()
            assert written.place_of(tmp_path / name).read_text() == name
    assert [(tmp_path / name).read_text() for name in ("a", "new/b")] == ["a", "new/b"]
    assert len(list(tmp_path.rglob("*"))) == 3


@pytest.mark.parametrize("failure", [OSError(errno.EIO, "input/output error"), KeyboardInterrupt()])
def test_a_file_that_cannot_take_its_place_takes_the_others_back(
    failure: BaseException, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a").write_text("old")
    real = os.replace

    def replace(old: Path, new: Path) -> None:
        if new.name == "c":
            raise failure
        real(old, new)

    monkeypatch.setattr(os, "replace", replace)
    with pytest.raises((UndertowError, KeyboardInterrupt)):
        _write(tmp_path, "a", "b", "c", content="new")
    assert _contents(tmp_path) == {"a": b"old"}


_WRITERS = {
    "export": ["export", "c", "mini-auv", "--controller", "paper-pd"],
    "simulate": ["simulate", "mini-auv", "paper-pd", "--to", "0,0,0.1", "--for", "1"],
    "update": ["update", "mini-auv", "--gains", "paper-pd"],
}
_WRITERS["simulate"] += ["--figures", "figures", "--json", "r.json"]


@pytest.mark.parametrize("command", first_quick(_WRITERS))
def test_a_command_on_a_full_disk_leaves_nothing(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    _SmallDisk(40_000, monkeypatch)
    assert main(_WRITERS[command]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "no space left on device; nothing was written; free some space" in line
    assert list(tmp_path.rglob("*")) == []
