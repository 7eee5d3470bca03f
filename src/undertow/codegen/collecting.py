"""Expressions rewritten with like terms collected, and what is fixed taken out of them as coefficients."""

from __future__ import annotations

from collections import Counter
from functools import reduce
from itertools import combinations
from operator import add

import casadi as ca

from .terms import Atom, Atoms, Product, Reading, Sum, apply


class Collector:
    """Rewrites expressions so that they use few coefficients in the place of many fixed symbols.

    Fixed are those that stay the same for many evaluations; of these, what is `ready` is as good as a
    coefficient, which are called `name` and a number.
    """

    def __init__(self, fixed: ca.SX, moving: ca.SX, *, ready: ca.SX, name: str) -> None:
        self._fixed, self._moving, self._name = fixed, moving, name
        self._ready = {e.element_hash() for e in ca.vertsplit(ready)}
        self._place: dict[int, int] = {}
        self._symbols: list[ca.SX] = []
        self._coefficients: list[ca.SX] = []

    @property
    def symbols(self) -> ca.SX:
        """The coefficients as they stand in what was rewritten."""
        return ca.vertcat(ca.SX(0, 1), *self._symbols)

    @property
    def coefficients(self) -> ca.SX:
        """What the coefficients are."""
        return ca.densify(ca.cse(ca.vertcat(ca.SX(0, 1), *self._coefficients)))

    def rewrite(self, expression: ca.SX) -> ca.SX:
        """The same in terms of the coefficients."""
        function = ca.Function("it", [self._fixed, self._moving], [ca.cse(expression)])
        atoms = Atoms(self._fixed, self._moving)
        results = Reading(function, atoms).results
        writing = _Writing(self, atoms.listed, list(results.values()))
        entries = [ca.SX(0)] * expression.numel()
        places = function.sparsity_out(0).find()
        for entry, terms in results.items():
            entries[places[entry]] = writing.sum(terms)
        return ca.cse(ca.reshape(ca.vertcat(*entries), *expression.shape))

    def stored(self, coefficient: ca.SX) -> ca.SX:
        """What stands for a coefficient; the negative of one that is there already is not kept again."""
        if coefficient.is_constant() or coefficient.element_hash() in self._ready:
            return coefficient
        negative = coefficient.dep(0) if coefficient.is_op(ca.OP_NEG) else None
        if negative is not None and negative.element_hash() in {*self._ready, *self._place}:
            return -self.stored(negative)
        key = coefficient.element_hash()
        if key not in self._place:
            self._place[key] = len(self._symbols)
            self._symbols.append(ca.SX.sym(f"{self._name}_{len(self._symbols)}"))
            self._coefficients.append(coefficient)
        return self._symbols[self._place[key]]


class _Writing:
    """Sums of terms written out; a factor that several terms have is multiplied by once.

    That is only done with products that nobody else needs.
    """

    def __init__(self, collector: Collector, atoms: list[Atom], results: list[Sum]) -> None:
        self._collector, self._atoms = collector, atoms
        self._written: dict[int, ca.SX] = {}
        self._products: dict[Product, ca.SX] = {}
        self._depths: dict[int, int] = {}
        self._uses: Counter[Product] = Counter()
        self._seen: set[int] = set()
        for terms in results:
            self._count(terms)
        # Products are short; of long ones only the longest parts are looked at.
        self._parts = Counter(part for p in self._uses for n in (2, 3) for part in combinations(p, n))

    def _count(self, terms: Sum) -> None:
        self._uses.update(terms.keys())
        for number in {a for product in terms for a in product} - self._seen:
            self._seen.add(number)
            for argument in self._atoms[number].arguments:
                self._count(argument)

    def sum(self, terms: Sum) -> ca.SX:
        """A sum of terms."""
        factor = self._common_factor(terms)
        if factor is None:
            # What is ready early is added first: less to wait for.
            ordered = sorted(terms.items(), key=lambda t: max(map(self._depth, t[0]), default=0))
            return reduce(add, [self._term(*t) for t in ordered]) if terms else ca.SX(0)
        inner = {_less(p, factor): c for p, c in terms.items() if self._divisible(p, factor)}
        outer = {p: c for p, c in terms.items() if not self._divisible(p, factor)}
        product = self.sum(inner) * self._atom(factor)
        return self.sum(outer) + product if outer else product

    def _common_factor(self, terms: Sum) -> int | None:
        """The atom that the most terms of their own have."""
        found = Counter(a for product in terms for a in set(product) if self._divisible(product, a))
        longer = {a for product in terms if len(product) > 1 for a in product if self._divisible(product, a)}
        often = [(n, -a) for a, n in found.items() if n > 1 and a in longer]
        return -max(often)[1] if often else None

    def _divisible(self, product: Product, atom: int) -> bool:
        return atom in product and (len(product) == 1 or self._uses[product] <= 1)

    def _depth(self, number: int) -> int:
        """How many atoms one after the other have to be known before this one."""
        if number not in self._depths:
            before = (a for terms in self._atoms[number].arguments for product in terms for a in product)
            self._depths[number] = 1 + max(map(self._depth, before), default=0)
        return self._depths[number]

    def _term(self, product: Product, coefficient: ca.SX) -> ca.SX:
        stored = self._collector.stored(coefficient)
        return stored * self._product(product) if product else stored

    def _product(self, product: Product) -> ca.SX:
        """A product of atoms, from the partial product that the most products have."""
        if len(product) == 1:
            return self._atom(product[0])
        if product not in self._products:
            last = max(product, key=lambda a: self._parts[_less(product, a)])
            self._products[product] = self._product(_less(product, last)) * self._atom(last)
        return self._products[product]

    def _atom(self, number: int) -> ca.SX:
        if number not in self._written:
            self._written[number] = self._new(self._atoms[number])
        return self._written[number]

    def _new(self, atom: Atom) -> ca.SX:
        if atom.symbol is not None:
            return atom.symbol
        values = [self.sum(a) for a in atom.arguments]
        return values[0] if atom.operation is None else apply(atom.operation, values)


def _less(product: Product, atom: int) -> Product:
    """A product without one of its factors."""
    place = product.index(atom)
    return (*product[:place], *product[place + 1 :])
