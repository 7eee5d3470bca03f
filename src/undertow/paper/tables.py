"""Published tables of estimates as they were printed, and what does not fit in them."""

from __future__ import annotations

import csv
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal
from functools import cache
from importlib.resources import files
from itertools import combinations

# Inertia comes first; the others are damping, but for a constant force.
_QUANTITIES = {
    "surge": ("m_x", "X_u", "X_uabsu"),
    "heave": ("m_z", "Z_w", "Z_g"),
    "yaw": ("I_zz", "N_r"),
}
_FREE_SIGN = ("Z_g",)


@dataclass(frozen=True)
class PublishedTable:
    """One table: a column for each case."""

    name: str  # its number in the paper
    # motion, direction: what was estimated
    motion: str
    direction: str
    samples: int  # rows of the regression
    selected: str  # case that the paper takes for this motion
    # text of every cell by quantity and case; quantities are parameters, ``variance`` and ``sd_`` of each
    printed: Mapping[str, Mapping[str, str]]
    adopted: str | None = None  # which set of Table 4 came out of it; None where no set did

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
    """Tables that belong together."""

    tables: tuple[PublishedTable, ...]  # in their order
    # what is known of the body: its own part of each inertia, kg or kg m^2; volume, m^3; water density,
    # kg/m^3; gravity, m/s^2
    body: Mapping[str, float]
    # what the paper took over into Table 4, as printed: added inertia, damping, force by direction
    adopted: Adopted


@cache
def appendix() -> Appendix:
    """Tables A1 to A6 of the paper on the mini-AUV with its Table 4."""
    folder = files("undertow.paper")
    meta = tomllib.loads(folder.joinpath("appendix_a.toml").read_text(encoding="utf-8"))
    numbers = _numbers(folder.joinpath("appendix_a.csv").read_text(encoding="utf-8"))
    tables = (PublishedTable(name=n, printed=numbers[n], **about) for n, about in meta["tables"].items())
    return Appendix(tuple(tables), meta["body"], meta["adopted"])


def _numbers(text: str) -> dict[str, dict[str, dict[str, str]]]:
    found: dict[str, dict[str, dict[str, str]]] = {}
    for row in csv.DictReader(text.splitlines()):
        table, quantity = row.pop("table"), row.pop("quantity")
        found.setdefault(table, {})[quantity] = row
    return found


KINDS = {
    "repeated": "two cases that were filtered differently have the same numbers",
    "sign": "a value changes its sign between the table and the value adopted from it",
    "outlier": "a value lies far from the trend of the cases before it",
    "copied": "a value has the digits of another table",
    "selection": "the selected case is not the one that the stated rule selects",
    "sum": "numbers that should add up do not",
    "insignificant": "an adopted value is within its error of zero",
    "invalid": "estimates are not physical: inertia below that of the body, or damping that feeds energy in",
}
#: Cases with one filter of growing frame, in this order.
FAMILIES = (("2", "3", "4"), ("6", "7", "8"))
RULE = "lowest variance"


@dataclass(frozen=True)
class TableLimits:
    """From where on numbers of a table do not fit."""

    outlier: float = 5.0  # standard deviations off the trend of the cases before
    significant: float = 2.0  # standard deviations from zero
    digits: int = 7  # that two numbers have in common if one is copied
    rounding: float = 1e-4  # share by which a sum may be off: what goes into it is printed to six digits


_LIMITS = TableLimits()


@dataclass(frozen=True)
class Remark:
    """One thing that does not fit."""

    kind: str  # one of `KINDS`
    where: str  # tables, cases and quantities
    text: str  # the numbers, and what is wrong about them


def audit(tables: Appendix) -> list[Remark]:
    """Everything in published tables that does not fit, in the order of `KINDS`."""
    found = [*_each(tables), *_copied(tables), *_sums(tables)]
    return sorted(found, key=lambda remark: list(KINDS).index(remark.kind))


def _each(tables: Appendix) -> Iterator[Remark]:
    for table in tables.tables:
        for first, second in combinations(table.cases, 2):
            if table.cells(first) == table.cells(second):
                text = f"all {len(table.cells(first))} numbers of case {second} are those of case {first}"
                yield Remark("repeated", f"{table.name}, cases {first} and {second}", text)
        yield from _signs(table, tables)
        yield from _outliers(table)
        yield from _selection(table)
        yield from _insignificant(table)
        yield from _invalid(table, tables.body[table.quantities[0]])


def _signs(table: PublishedTable, tables: Appendix) -> Iterator[Remark]:
    for quantity in table.quantities[1:] if table.adopted else ():
        printed = table.printed[quantity][table.selected]
        taken = tables.adopted[table.adopted][quantity]  # type: ignore[index]
        if float(printed) * float(taken) < 0.0:
            where = f"{table.name}, case {table.selected}, {quantity}"
            yield Remark(
                "sign", where, f"{printed} in the table, {taken} in Table 4; the text does not mention it"
            )


def _outliers(table: PublishedTable) -> Iterator[Remark]:
    for quantity in table.quantities:
        for first, second, third in FAMILIES:
            trend = 2 * table.value(quantity, second) - table.value(quantity, first)
            value, spread = table.value(quantity, third), table.value(f"sd_{quantity}", third)
            away = abs(value - trend) / spread
            if away > _LIMITS.outlier:
                text = (
                    f"{table.printed[quantity][third]}, but cases {first} and {second} lead to {trend:.5g}: "
                    f"{away:.1f} standard deviations away"
                )
                yield Remark("outlier", f"{table.name}, case {third}, {quantity}", text)


def _selection(table: PublishedTable) -> Iterator[Remark]:
    least = min(table.cases, key=lambda case: table.value("variance", case))
    if least != table.selected:
        text = (
            f"case {table.selected} is taken for its {RULE} ({table.printed['variance'][table.selected]}), "
            f"but case {least} has {table.printed['variance'][least]}"
        )
        yield Remark("selection", f"{table.name}, case {table.selected}", text)


def _insignificant(table: PublishedTable) -> Iterator[Remark]:
    for quantity in table.quantities if table.adopted else ():
        value, spread = (table.value(q, table.selected) for q in (quantity, f"sd_{quantity}"))
        if abs(value) < _LIMITS.significant * spread:
            text = f"{value:.6g} with a standard deviation of {spread:.6g}: t = {abs(value) / spread:.2f}"
            yield Remark("insignificant", f"{table.name}, case {table.selected}, {quantity}", text)


def _invalid(table: PublishedTable, body: float) -> Iterator[Remark]:
    bad = [case for case in table.cases if not table.physical(case, body)]
    if bad:
        text = f"{len(bad)} of {len(table.cases)} cases as printed: {', '.join(bad)}"
        yield Remark("invalid", table.name, text)


def _copied(tables: Appendix) -> Iterator[Remark]:
    for first, second in combinations(tables.tables, 2):
        for quantity in [q for q in first.quantities if q in second.quantities]:
            for case in first.cases:
                one, other = (t.printed[quantity][case] for t in (first, second))
                # Whether two numbers agree in all digits that both were printed with, and these are many.
                places = min(-int(Decimal(x).as_tuple().exponent) for x in (one, other))
                digits = min(len(x.lstrip("-").replace(".", "").lstrip("0")) for x in (one, other))
                shorter = Decimal(1).scaleb(-places)
                if digits >= _LIMITS.digits and abs(Decimal(one) - Decimal(other)) < shorter:
                    where = f"{second.name}, case {case}, {quantity}"
                    yield Remark("copied", where, f"{other}, as {one} in {first.name}, another experiment")


def _sums(tables: Appendix) -> Iterator[Remark]:
    for table in tables.tables:
        if table.adopted is None:
            continue
        inertia = table.quantities[0]
        total, own = table.value(inertia, table.selected), tables.body[inertia]
        taken = float(tables.adopted[table.adopted][inertia])
        yield from _sum(
            f"{table.name}, case {table.selected}, {inertia}",
            f"{table.printed[inertia][table.selected]} - {own} = {total - own:.9g}",
            taken,
            total - own,
        )
    yield from _buoyancy(tables)


def _buoyancy(tables: Appendix) -> Iterator[Remark]:
    body = tables.body
    expected = (body["water_density"] * body["volume"] - body["m_z"]) * body["gravity"]
    taken = {float(values["Z_g"]) for values in tables.adopted.values()}
    for value in sorted(taken):
        words = f"buoyancy less weight of section 2 is {expected:.6g} N"
        yield from _sum("Table 4, Z_g", words, value, expected)


def _sum(where: str, words: str, taken: float, expected: float) -> Iterator[Remark]:
    share = abs(taken - expected) / abs(expected)
    if share > _LIMITS.rounding:
        yield Remark("sum", where, f"{words}, but Table 4 has {taken:.9g}, {share:.2%} away")
