"""`undertow update`: what it writes, and what it says has changed."""

from __future__ import annotations

import io
import re
import shutil
from contextlib import chdir, redirect_stdout
from pathlib import Path

import pytest

from tests.cli.bad import refusal
from undertow.cli.main import main
from undertow.control.gains import bundled_gains
from undertow.model.loading import bundled_vehicles

Capture = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A folder after the first update of auv.toml with a law and a motion, and what that printed."""
    made, out = tmp_path_factory.mktemp("first"), io.StringIO()
    (made / "auv.toml").write_text(bundled_vehicles()["mini-auv"].read_text())
    with chdir(made), redirect_stdout(out):
        assert main(["update", "auv.toml", "--gains", "paper-pid", "--at", "u=0.5"]) == 0
    return made, out.getvalue()


def _edit(old: str, new: str) -> None:
    text = Path("auv.toml").read_text()
    assert old in text
    Path("auv.toml").write_text(text.replace(old, new))


def test_an_update_tells_what_an_edit_changes(folder: Path, first: tuple[Path, str], capsys: Capture) -> None:
    shutil.copytree(first[0], folder, dirs_exist_ok=True)
    assert "first time" in first[1]
    made = {p.name for p in Path("build/mini-auv").rglob("*") if p.is_file()}
    assert {"mini_auv_vehicle.c", "mini_auv_paper_pid.c", "update.json"} <= made
    assert {"vehicle-bode.png", "paper-pid-step.png"} <= made
    _edit('X_u = { forward = "0.142306 kg/s"', 'X_u = { forward = "0.4 kg/s"')
    assert main(["update", "auv.toml"]) == 0
    out = capsys.readouterr().out
    assert re.search(r"X_u_forward +0\.142306 N/\(m/s\) +0\.4 N/\(m/s\)", out)
    assert re.search(r"vehicle, u=0\.5: u +-0\.580022 +-0\.608245", out)
    assert re.search(r"0\.00319834 ± 0\.0380541i +-0\.00513736 ± 0\.0306214i", out)
    assert re.search(r"paper-pid, hovering forward, force_surge: delay +0 s +9\.127 s", out)
    assert re.search(r"paper-pid, hovering forward +unstable +stable", out)
    assert "0.4" in Path("build/mini-auv/src/mini_auv_vehicle.c").read_text()


@pytest.mark.slow
def test_a_second_update_finds_nothing_new(folder: Path, capsys: Capture) -> None:
    assert main(["update", "auv.toml", "--at", "u=0.3"]) == 0
    before = {p: p.read_bytes() for p in Path("build").rglob("*") if p.is_file()}
    capsys.readouterr()
    assert main(["update", "auv.toml"]) == 0
    assert capsys.readouterr().out.count("none has changed") == 4
    assert {p: p.read_bytes() for p in before} == before
    assert '"at": [\n  "u=0.3"\n ]' in Path("build/mini-auv/update.json").read_text()


@pytest.mark.slow
def test_an_effect_that_is_added_is_reported(folder: Path, capsys: Capture) -> None:
    assert main(["update", "auv.toml"]) == 0
    _edit(
        "[effects.quadratic_damping]",
        '[effects.constant_force]\nX_0 = "0.1 N"\n\n[effects.quadratic_damping]',
    )
    capsys.readouterr()
    assert main(["update", "auv.toml"]) == 0
    out = capsys.readouterr().out
    assert "effects added: constant_force" in out
    assert re.search(r"X_0 +\(none\) +0\.1 N", out)


def test_a_bad_edit_changes_nothing(folder: Path, first: tuple[Path, str], capsys: Capture) -> None:
    shutil.copytree(first[0], folder, dirs_exist_ok=True)
    _edit('m = { value = "7.5 kg"', 'm = { value = "-7.5 kg"')
    assert "m" in refusal(["update", "auv.toml"], capsys, folder)


def _gains(path: str, name: str) -> str:
    text = bundled_gains()["paper-pd"].read_text()
    Path(path).parent.mkdir(exist_ok=True)
    Path(path).write_text(re.sub(r'(?m)^name = ".*"', f'name = "{name}"', text))
    return path


@pytest.mark.parametrize(
    ("one", "other", "words"),
    [
        (("a.toml", "soft PD"), ("b.toml", "Soft-pd"), r"'Soft-pd' .* mini_auv_soft_pd\.c, .* taken"),
        (("a.toml", "soft"), ("b.toml", "Vehicle"), r"'Vehicle' .* mini_auv_vehicle\.c, .* taken"),
        (("a.toml", "soft"), ("b/a.toml", "hard"), r"b/a\.toml .* pictures 'a', .* of a\.toml"),
        (("a.toml", "soft"), ("vehicle.toml", "hard"), "pictures 'vehicle', which is that of the vehicle"),
    ],
)
def test_nothing_is_written_over_something_else(
    folder: Path, capsys: Capture, one: tuple[str, str], other: tuple[str, str], words: str
) -> None:
    files = [word for pair in (one, other) for word in ("--gains", _gains(*pair))]
    assert re.search(words, refusal(["update", "auv.toml", *files], capsys, folder))


@pytest.mark.slow
def test_a_spoilt_state_file_counts_as_none(folder: Path, capsys: Capture) -> None:
    assert main(["update", "auv.toml"]) == 0
    Path("build/mini-auv/update.json").write_text(
        '{"schema": "undertow/update/2", "vehicle": 3, "margins": []}'
    )
    assert main(["update", "auv.toml"]) == 0
    captured = capsys.readouterr()
    assert "is ignored" in captured.err
    assert "first time: from now on" in captured.out
