"""How long every command takes from the shell: its help, and a small call with real work in it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

import undertow
from undertow.cli.main import commands

from .conftest import Speed

HELP, CALL = "start-up: --help", "start-up: a small call"
PACKAGE = Path(undertow.__file__).parent
AUV = PACKAGE / "demo_data" / "auv"
_LOG = f"{AUV / 'vehicle.toml'} {AUV / 'train_1.csv.gz'}"
_ERRORS = "--error x=0.5,z=0.2,psi=0.2 --force surge=1,heave=2,yaw=0.1"
CALLS = {
    "effects": "effects",
    "effects show": "effects show lift",
    "vehicles": "vehicles",
    "vehicles show": "vehicles show mini-auv",
    "audit-tables": "audit-tables",
    "audit": "audit mini-auv",
    "added-mass": "added-mass sphere --diameter 0.3",
    "export c": "export c mini-auv --out built",
    "gains": "gains mini-auv paper-pd",
    "linearize": "linearize mini-auv",
    "design": f"design mini-auv {_ERRORS}",
    "simulate, 1 s": "simulate mini-auv paper-pd --to -1,1,1 --for 1",
    "update": "update mini-auv",
    "doctor, 100 s at 20 Hz": f"doctor {_LOG}",
    "compare, 100 s at 20 Hz": f"compare {_LOG}",
    "fit, 100 s at 20 Hz": f"fit {_LOG}",
}
ROUNDS = 2
# The answer no (conditions that do not hold) is an answer.
_DONE = (0, 1)


def _processor_seconds(action: Callable[[], object]) -> float:
    """Time that children of this process spend: less shaken by what else the machine does."""

    def spent() -> float:
        used = os.times()
        return used.children_user + used.children_system

    before = spent()
    action()
    return spent() - before


def _time(speed: Speed, what: str, who: str, folder: Path, *words: str) -> None:
    def action() -> None:
        _run(*words, folder=folder)

    speed(what, who, action, rounds=ROUNDS, more={"CPU time, s": _processor_seconds(action)})


def _run(*words: str, folder: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(PACKAGE.parent)}
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, env=environment, capture_output=True, check=False, text=True
    )
    assert done.returncode in _DONE, done.stderr


@pytest.mark.parametrize("what", [HELP, CALL])
def time_python_itself(speed: Speed, what: str, tmp_path: Path) -> None:
    _time(speed, what, "python -c pass", tmp_path, "-c", "pass")


@pytest.mark.parametrize("name", ["", *commands()])
def time_help(speed: Speed, name: str, tmp_path: Path) -> None:
    words = ("-m", "undertow", *name.split(), "--help")
    _time(speed, HELP, f"undertow {name}".strip(), tmp_path, *words)


@pytest.mark.parametrize("name", CALLS)
def time_small_call(speed: Speed, name: str, tmp_path: Path) -> None:
    words = ("-m", "undertow", *CALLS[name].split())
    _time(speed, CALL, f"undertow {name}", tmp_path, *words)
