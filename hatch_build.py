"""Puts the engine, compiled, into the wheel where there is a C compiler: machines without one then run it."""

from __future__ import annotations

import importlib.util
import os
import shlex
import shutil
import subprocess
import sysconfig
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

SOURCE = Path(__file__).parent / "src" / "undertow" / "codegen" / "source.py"
# For any processor of this kind; multiply and add are not fused, so that all machines find the same numbers.
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-w", "-fPIC", "-shared", "-fvisibility=hidden")


class EngineHook(BuildHookInterface):
    """Called by hatchling before it packs a wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile the engine and tag the wheel for this platform; without a compiler it stays pure Python."""
        if version == "editable":  # who works on the sources compiles the engine when it is needed
            return
        self._folder = tempfile.mkdtemp(prefix="undertow-engine-")
        library = compiled_engine(Path(self._folder))
        if library is None:
            self.app.display_warning("no C compiler: the wheel carries no engine")
            return
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        build_data["force_include"][str(library)] = f"undertow/codegen/{library.name}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was compiled."""
        shutil.rmtree(getattr(self, "_folder", ""), ignore_errors=True)


def compiled_engine(folder: Path) -> Path | None:
    """The engine as a shared library in a folder, or None where no compiler builds it."""
    source = _source_module()
    library = folder / source.engine_file().name
    (folder / "engine.c").write_text(source.engine_source()[0], encoding="utf-8")
    for command in _compilers():
        try:
            subprocess.run([*command, *FLAGS, "engine.c", "-o", library.name, "-lm"], cwd=folder, check=True)
        except (OSError, subprocess.CalledProcessError):
            continue
        return library
    return None


def _compilers() -> list[list[str]]:
    """Commands to try: that of the environment, or those that are found."""
    named = os.environ.get("CC", "")
    if named:
        return [shlex.split(named)]
    return [[command] for command in ("cc", "gcc", "clang") if shutil.which(command)]


def _source_module() -> ModuleType:
    """The module that writes the engine's source; the package around it needs what a build does not have."""
    spec = importlib.util.spec_from_file_location("undertow_source", SOURCE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
