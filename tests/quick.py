"""Of cases that show the same property `make test` runs the first ones; the others are marked slow."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def first_quick(cases: Iterable[Any], count: int = 1) -> list[Any]:
    """The cases for `pytest.mark.parametrize`, all but the first `count` marked slow."""
    found = list(cases)
    rest = [case if isinstance(case, tuple) else (case,) for case in found[count:]]
    return [*found[:count], *(pytest.param(*case, marks=pytest.mark.slow) for case in rest)]
