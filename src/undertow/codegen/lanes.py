"""Runs side by side in the lanes of a vector register: how many, and the C that they need."""

from __future__ import annotations

from importlib.resources import files

LANES_HEADER = (files("undertow.codegen") / "lanes.h").read_text(encoding="utf-8")
