"""Reading published tables of estimates; every number stays as it was printed."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any

# Inertia comes first; the others are damping, but for a constant force.
_QUANTITIES = {
    "surge": ("m_x", "X_u", "X_uabsu"),
    "heave": ("m_z", "Z_w", "Z_g"),
    "yaw": ("I_zz", "N_r"),
}
_FREE_SIGN = ("Z_g",)


@dataclass(frozen=True)
class PublishedTable:
    """One table: a column for each case.

    Attributes
    ----------
    name : str
        Its number in the paper.
    motion, direction : str
        What was estimated.
    samples : int
        Rows of the regression.
    selected : str
        Case that the paper takes for this motion.
    adopted : str or None
        Which set of Table 4 came out of it; None where no set did.
    printed : mapping
        Text of every cell by quantity and case; quantities are parameters, ``variance`` and ``sd_`` of each.
    """

    name: str
    motion: str
    direction: str
    samples: int
    selected: str
    adopted: str | None
    printed: Mapping[str, Mapping[str, str]]

    @property
    def quantities(self) -> tuple[str, ...]:
        """The parameters, the inertia first."""
        return _QUANTITIES[self.motion]

    @property
    def cases(self) -> tuple[str, ...]:
        """Names of the cases."""
        return tuple(self.printed["variance"])

    def value(self, quantity: str, case: str) -> float:
        """A printed number."""
        return float(self.printed[quantity][case])

    def cells(self, case: str) -> tuple[str, ...]:
        """All that is printed for a case."""
        return tuple(row[case] for row in self.printed.values())

    def physical(self, case: str, body: float) -> bool:
        """Whether the inertia exceeds that of the body and all damping takes energy, as printed."""
        inertia, *others = self.quantities
        damping = (q for q in others if q not in _FREE_SIGN)
        return self.value(inertia, case) > body and all(self.value(q, case) > 0.0 for q in damping)


Adopted = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True)
class Appendix:
    """Tables that belong together.

    Attributes
    ----------
    tables : tuple of PublishedTable
        In their order.
    body : mapping
        What is known of the body: its own part of each inertia, kg or kg m^2; volume, m^3; water density,
        kg/m^3; gravity, m/s^2.
    adopted : mapping
        What the paper took over into Table 4, as printed: added inertia, damping, force by direction.
    """

    tables: tuple[PublishedTable, ...]
    body: Mapping[str, float]
    adopted: Adopted


@cache
def appendix() -> Appendix:
    """Tables A1 to A6 of the paper on the mini-AUV with its Table 4."""
    folder = files("undertow.identification.published")
    meta = tomllib.loads(folder.joinpath("appendix_a.toml").read_text(encoding="utf-8"))
    numbers = _numbers(folder.joinpath("appendix_a.csv").read_text(encoding="utf-8"))
    tables = tuple(_table(name, about, numbers[name]) for name, about in meta["tables"].items())
    return Appendix(tables, meta["body"], meta["adopted"])


def _table(name: str, about: Mapping[str, Any], printed: Mapping[str, Mapping[str, str]]) -> PublishedTable:
    return PublishedTable(
        name,
        about["motion"],
        about["direction"],
        about["samples"],
        about["selected"],
        about.get("adopted"),
        printed,
    )


def _numbers(text: str) -> dict[str, dict[str, dict[str, str]]]:
    found: dict[str, dict[str, dict[str, str]]] = {}
    for row in csv.DictReader(text.splitlines()):
        table, quantity = row.pop("table"), row.pop("quantity")
        found.setdefault(table, {})[quantity] = row
    return found
