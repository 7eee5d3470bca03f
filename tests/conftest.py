"""What holds for every test: repeatable random examples, no window, caches inside the checkout."""

from __future__ import annotations

import os

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
