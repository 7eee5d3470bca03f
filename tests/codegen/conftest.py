"""Compilers of the machine, and fresh caches."""

from __future__ import annotations

from pathlib import Path

import pytest

from undertow.codegen import compiler
from undertow.codegen.compiler import Compiler, find_compiler


@pytest.fixture
def c_compiler() -> Compiler:
    """The C compiler of this machine; without one the test is skipped."""
    found = find_compiler()
    if found is None:
        pytest.skip("no C compiler on this machine")
    return found


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder of the test's own; what the program has said once it may say again."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    # Private: they remember for the whole process, which a user never begins anew within.
    compiler._log_backend.cache_clear()
    compiler._private_folder.cache_clear()
    return tmp_path / "cache" / "undertow"
