"""Parts of docs/results.md that other programs fill in: `benchmarks.trust` and `benchmarks.speed`."""

from __future__ import annotations

HEADING = "## How often the diagnosis is right\n"
SPEED = "## How fast it is\n"
_ABOUT = """\
Simulated vehicles with something hidden, nothing hidden, or an effect outside the catalogue. All tables, the
other methods on the same data, and every failure: [trust.md](trust.md).
"""
EMPTY = f"{HEADING}\nNot measured yet: `python -m benchmarks.trust run`, then `report`.\n"
NOT_TIMED = f"{SPEED}\nNot measured yet: `make bench`.\n"


def summary_of(page: str) -> str:
    """The part on the diagnosis as it stands in a page; what says that there is none if it is not there."""
    return _parts(page, HEADING)[1] or EMPTY


def speed_of(page: str) -> str:
    """The part on speed as it stands in a page; what says that there is none if it is not there."""
    return _parts(page, SPEED)[1] or NOT_TIMED


def with_summary(page: str, table: str) -> str:
    """The page with goals and measured numbers of the diagnosis in their part.

    Raises
    ------
    ValueError
        If the page has no such part.
    """
    return with_part(page, HEADING, f"{_ABOUT}\n{table}")


def with_part(page: str, heading: str, body: str) -> str:
    """The page with what stands under a heading replaced.

    Raises
    ------
    ValueError
        If the page has no such part.
    """
    before, old, after = _parts(page, heading)
    if not old:
        raise ValueError(
            f"the page has no part {heading.strip()!r}: make it with python -m benchmarks.results"
        )
    return f"{before}{heading}\n{body}\n{after}"


def _parts(page: str, heading: str) -> tuple[str, str, str]:
    """What comes before the part, the part, and what comes after it."""
    start = page.find(heading)
    if start < 0:
        return page, "", ""
    end = page.find("\n## ", start)
    end = len(page) if end < 0 else end + 1
    return page[:start], page[start:end], page[end:]
