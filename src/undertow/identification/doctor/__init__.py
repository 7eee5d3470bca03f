"""Mistakes in logs, and in how they are read, before physics is blamed for them."""

from __future__ import annotations

from undertow.identification.doctor.examine import Examined, examine, refuse_impossible
from undertow.identification.doctor.findings import Examination, Excited, Finding

__all__ = ["Examination", "Examined", "Excited", "Finding", "examine", "refuse_impossible"]
