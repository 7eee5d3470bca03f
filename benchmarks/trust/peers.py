"""Other methods on the same data."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

PEERS: dict[str, Callable[..., dict[str, Any]]] = {}
