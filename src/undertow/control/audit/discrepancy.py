"""One thing that an audit found."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Discrepancy:
    """Something that does not fit, or that is left open.

    Attributes
    ----------
    kind : str
        "wrong", or "open" for what is missing or only assumed.
    where : str
        Equation, matrix or effect.
    text : str
        What it is.
    evidence : str
        The computation that shows it.
    """

    kind: str
    where: str
    text: str
    evidence: str


WRONG, OPEN = "wrong", "open"
