"""The floors of the package: who may import whom."""

from __future__ import annotations

import ast
import importlib.util
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.quick import first_quick

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "undertow"
CONTRACTS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
FLOORS = {
    container: {room.strip(" ()") for layer in contract["layers"] for room in layer.split("|")}
    for contract in CONTRACTS
    if contract["type"] == "layers"
    for container in contract["containers"]
}


def _check(folder: Path, config: Path) -> subprocess.CompletedProcess[str]:
    """Run import-linter on the package `undertow` of a folder."""
    code = "import sys; from importlinter import cli; sys.exit(cli.lint_imports(sys.argv[1], no_cache=True))"
    command = [sys.executable, "-c", code, str(config)]
    return subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder)},
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_contracts_are_kept() -> None:
    done = _check(ROOT / "src", ROOT / "pyproject.toml")
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_module_stands_on_a_floor() -> None:
    modules = [path.relative_to(SOURCE).with_suffix("").parts for path in SOURCE.rglob("*.py")]
    homeless = sorted({parts[0] for parts in modules} - FLOORS["undertow"] - {"__init__"})
    assert not homeless, f"not in the floors of pyproject.toml: {homeless}"


@pytest.mark.parametrize(
    ("module", "line", "complaint"),
    first_quick(
        [
            ("model", "import undertow.codegen", "undertow.model is not allowed to import undertow.codegen"),
            ("model", "import numpy", "undertow.model is not allowed to import numpy"),
            ("model", "def late():\n    import casadi", "undertow.model is not allowed to import casadi"),
            (
                "identification",
                "import undertow.control",
                "undertow.identification is not allowed to import undertow.control",
            ),
            ("cli", "import control", "not allowed to import control"),
            ("cli", "import distributed", "not allowed to import distributed"),
            ("fleet", "import undertow.cli", "undertow.fleet is not allowed to import undertow.cli"),
            ("control", "import undertow.fleet", "undertow.control is not allowed to import undertow.fleet"),
            (
                "identification.doctor",
                "from undertow.identification import diagnosis",
                "undertow.identification.doctor is not allowed to import undertow.identification.diagnosis",
            ),
            (
                "identification.report",
                "import typing\nif typing.TYPE_CHECKING:\n    import undertow.identification.planning",
                "undertow.identification.report is not allowed to import undertow.identification.planning",
            ),
            (
                "fleet.night",
                "from undertow.fleet import day",
                "No cycles are allowed in undertow.fleet",
            ),
            ("attic", "", "undertow.attic"),
        ],
        3,
    ),
)
def test_a_breach_is_seen(tmp_path: Path, module: str, line: str, complaint: str) -> None:
    package = tmp_path / "undertow"
    rooms = {f"{container}.{room}" for container, rooms in FLOORS.items() for room in rooms}
    for name in sorted({*rooms, "undertow.fleet.day", f"undertow.{module}"}):
        folder = tmp_path.joinpath(*name.split("."))
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "__init__.py").touch()
    (package / "__init__.py").write_text("")
    (package / "control" / "__init__.py").write_text("import control\n")
    (package / "fleet" / "day" / "__init__.py").write_text(
        "import undertow.fleet.night\n" * (module == "fleet.night")
    )
    assert _check(tmp_path, ROOT / "pyproject.toml").returncode == (module == "attic")
    package.joinpath(*module.split("."), "__init__.py").write_text(line)
    done = _check(tmp_path, ROOT / "pyproject.toml")
    assert done.returncode == 1
    assert complaint in " ".join(done.stdout.split()), done.stdout


def test_benchmarks_and_pages_import_what_there_is() -> None:
    """They run seldom; a name that has moved would show late."""
    missing = []
    for path in [*(ROOT / "benchmarks").rglob("*.py"), *(ROOT / "docs" / "_ext").glob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("undertow"):
                missing += [
                    f"{path.name}:{node.lineno} {n.name}" for n in node.names if not _is_there(node, n)
                ]
    assert not missing, missing


def _is_there(node: ast.ImportFrom, name: ast.alias) -> bool:
    try:
        module = importlib.import_module(str(node.module))
    except ModuleNotFoundError:
        return False
    return hasattr(module, name.name) or importlib.util.find_spec(f"{node.module}.{name.name}") is not None
