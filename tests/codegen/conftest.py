"""Fresh caches."""

from __future__ import annotations

from pathlib import Path

import pytest

from undertow.codegen import compiler


@pytest.fixture
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache folder of the test's own; what the program has said once it may say again."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    # Private: they remember for the whole process, which a user never begins anew within.
    compiler._log_backend.cache_clear()
    compiler._private_folder.cache_clear()
    return tmp_path / "cache" / "undertow"
