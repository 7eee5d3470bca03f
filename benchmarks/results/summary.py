"""The part of docs/results.md that `benchmarks.trust` fills in."""

from __future__ import annotations

HEADING = "## How often the diagnosis is right\n"
_TOLD = """\
Simulated vehicles with something hidden, nothing hidden, or what no catalogue lists. Every table, the other
methods on the same data, and every failure: [trust.md](trust.md).
"""
EMPTY = f"{HEADING}\nNot measured yet: `python -m benchmarks.trust run`, then `report`.\n"


def summary_of(page: str) -> str:
    """The part as it stands in a page; what says that there is none if it is not there."""
    return _parts(page)[1] or EMPTY


def with_summary(page: str, table: str) -> str:
    """The page with goals and measured numbers in that part.

    Raises
    ------
    ValueError
        If the page has no such part.
    """
    before, old, after = _parts(page)
    if not old:
        raise ValueError(
            f"the page has no part {HEADING.strip()!r}: make it with python -m benchmarks.results"
        )
    return f"{before}{HEADING}\n{_TOLD}\n{table}\n{after}"


def _parts(page: str) -> tuple[str, str, str]:
    """What comes before the part, the part, and what comes after it."""
    start = page.find(HEADING)
    if start < 0:
        return page, "", ""
    end = page.find("\n## ", start)
    end = len(page) if end < 0 else end + 1
    return page[:start], page[start:end], page[end:]
