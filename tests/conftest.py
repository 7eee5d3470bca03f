"""What holds for every test: repeatable random examples, no window, caches inside the checkout."""

from __future__ import annotations

import os
import re
from pathlib import Path

import hypothesis
import pytest


def pytest_configure(config: pytest.Config) -> None:
    hypothesis.settings.register_profile("undertow", deadline=None, derandomize=True, database=None)
    hypothesis.settings.load_profile("undertow")
    os.environ["MPLBACKEND"] = "Agg"
    # Workers that each take all processors for small matrices wait for each other.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # The tests themselves run on all cores.
    os.environ.setdefault("UNDERTOW_JOBS", "1")
    # Compiled code of the tests is kept from one run to the next, but not in the user's own cache.
    plugin = getattr(config, "cache", None)
    cache = plugin.mkdir("undertow") if plugin else None
    if cache is not None:
        cache.chmod(0o700)
        os.environ["XDG_CACHE_HOME"] = str(cache)


#: A module all of whose tests have this mark.
_WHOLLY = re.compile(r"^pytestmark = (\[\s*)?pytest\.mark\.(docs|slow)\b", re.MULTILINE)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Modules that `make test` would collect and then leave out are not imported by it."""
    if config.option.markexpr != "not slow and not docs" or not collection_path.name.startswith("test_"):
        return None
    return True if collection_path.is_file() and _WHOLLY.search(collection_path.read_text()) else None
