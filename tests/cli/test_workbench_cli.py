"""`undertow workbench` on the command line: what is refused before the page is served."""

from __future__ import annotations

import importlib.util
import socket
from pathlib import Path

import pytest

import undertow
from undertow.cli.main import main
from undertow.errors import UndertowError
from undertow.workbench.bench import require_nicegui, require_port

DEMO = Path(undertow.__file__).parent / "demo_data" / "auv"
Capture = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def _refused(capsys: Capture, *words: str) -> str:
    assert main(["workbench", *words, "--no-browser"]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    return line


def test_a_missing_library_is_one_line_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("undertow.workbench.bench.find_spec", lambda name: None)
    with pytest.raises(UndertowError, match=r'not installed: pip install "undertow\[workbench\]"$'):
        require_nicegui()


def test_a_port_in_use_is_refused() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        taken = other.getsockname()[1]
        with pytest.raises(UndertowError, match=f"port {taken} is taken: choose another one with --port"):
            require_port(taken)
    require_port(taken)


@pytest.mark.skipif(importlib.util.find_spec("nicegui") is None, reason="NiceGUI is not installed")
def test_what_cannot_be_read_is_refused_before_the_page_is_served(capsys: Capture, tmp_path: Path) -> None:
    vehicle, log = str(DEMO / "vehicle.toml"), str(DEMO / "holdout.csv.gz")
    free = ["--port", str(_free_port())]
    assert "log" in _refused(capsys, vehicle, "nowhere.csv", *free)
    assert "nowhere.toml" in _refused(capsys, "nowhere.toml", log, *free)
    assert not list(tmp_path.iterdir())  # no folder was made
    kept = tmp_path / "kept"
    kept.mkdir()
    (kept / "session.json").write_text("{}")
    line = _refused(capsys, vehicle, log, "--session", "kept", *free)
    assert "name another folder with --session" in line
    (tmp_path / "file").write_text("")
    assert "file" in _refused(capsys, vehicle, log, "--session", "file", *free)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
