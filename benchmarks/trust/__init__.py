"""How often the diagnosis is right, measured on an independent simulator.

A seeded plan of cases, their diagnoses as JSON lines, other methods on the same data, and a page of tables.
"""

from __future__ import annotations
