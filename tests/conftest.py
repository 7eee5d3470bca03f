"""What holds for every test: repeatable examples, no window, caches in the checkout, little garbage."""

from __future__ import annotations

import gc
import os
from collections.abc import Iterator
from typing import TYPE_CHECKING

import hypothesis
import pytest

if TYPE_CHECKING:
    from undertow.codegen.compiler import Compiler


def pytest_configure(config: pytest.Config) -> None:
    hypothesis.settings.register_profile("undertow", deadline=None, derandomize=True, database=None)
    hypothesis.settings.load_profile("undertow")
    os.environ["MPLBACKEND"] = "Agg"
    # Workers that each take all processors for small matrices wait for each other.
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    # SymPy keeps what it has worked out of more expressions than it does by itself.
    os.environ.setdefault("SYMPY_CACHE_SIZE", "20000")
    # The tests themselves run on all cores.
    os.environ.setdefault("UNDERTOW_JOBS", "1")
    # No test outlives the machine: what is written need not be on the disk before it goes on.
    os.fsync = lambda descriptor: None
    # Compiled code of the tests is kept from one run to the next, but not in the user's own cache.
    plugin = getattr(config, "cache", None)
    cache = plugin.mkdir("undertow") if plugin else None
    if cache is not None:
        cache.chmod(0o700)
        os.environ["XDG_CACHE_HOME"] = str(cache)


@pytest.fixture
def c_compiler() -> Compiler:
    """The C compiler of this machine; without one the test is skipped."""
    from undertow.codegen.compiler import find_compiler

    found = find_compiler()
    if found is None:
        pytest.skip("no C compiler on this machine")
    return found


# What is imported, and what the tests of a file have worked out and kept, stays until the process ends. To
# look for garbage in it again and again takes a tenth of the time of all tests, and most of that of the pages
# of NiceGUI, which collects garbage twice in each test.
def _keep_what_is_there() -> None:
    gc.collect()
    gc.freeze()


def pytest_collection_finish() -> None:
    gc.set_threshold(10_000, 10, 10)
    _keep_what_is_there()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    yield
    if nextitem is not None and nextitem.path != item.path:
        _keep_what_is_there()
