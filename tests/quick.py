"""Of cases that show the same property `make test` runs a few; the others are marked slow."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import pytest


def quick_if(quick: Callable[[Any], bool], cases: Iterable[Any]) -> list[Any]:
    """The cases for `pytest.mark.parametrize`, marked slow where `quick` does not hold."""
    return [case if quick(case) else _slow(case) for case in cases]


def first_quick(cases: Iterable[Any], count: int = 1) -> list[Any]:
    """The cases for `pytest.mark.parametrize`, all but the first `count` marked slow."""
    return [case if i < count else _slow(case) for i, case in enumerate(cases)]


def _slow(case: Any) -> Any:
    return pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
