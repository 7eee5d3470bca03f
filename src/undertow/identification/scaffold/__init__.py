"""Effect files to begin with: written from what a diagnosis left unexplained, or with one example term."""

from __future__ import annotations

from .suggestion import Suggestion, check_id, example, read_diagnosis, suggested
from .text import effect_file

__all__ = ["Suggestion", "check_id", "effect_file", "example", "read_diagnosis", "suggested"]
