"""Expressions with like terms collected, and all that depends on parameters alone taken out of them.

Every value is a sum of terms, each a coefficient that depends on parameters alone times a product of atoms
(inputs, functions of other values, sums that are used more than once). Coefficients of like terms add up
before the motion is known, so what is left to be done for each evaluation is little.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca

Product = tuple[int, ...]
Sum = dict[Product, ca.SX]
_ONE: Product = ()
_UNIT = ca.SX(1)


@dataclass(frozen=True)
class Atom:
    """A value that is looked into no further: an input, a function of sums, or (operation None) a sum."""

    operation: int | None
    arguments: tuple[Sum, ...] = ()
    symbol: ca.SX | None = None


class Atoms:
    """The atoms of some expressions, none of them twice."""

    def __init__(self, fixed: ca.SX, moving: ca.SX) -> None:
        self._fixed, self._moving = ca.vertsplit(fixed), ca.vertsplit(moving)
        self._place: dict[object, int] = {}
        self._kept: list[ca.SX] = []
        self.listed: list[Atom] = []

    def input(self, group: int, entry: int) -> Sum:
        """A fixed symbol (group 0) or a moving one."""
        if group == 0:
            return {_ONE: self._fixed[entry]}
        return self._atom(("input", entry), Atom(ca.OP_INPUT, symbol=self._moving[entry]))

    def function(self, operation: int, *arguments: Sum) -> Sum:
        """A function of one or two values."""
        if all(map(is_fixed, arguments)):
            return {_ONE: apply(operation, [a.get(_ONE, ca.SX(0)) for a in arguments])}
        return self._atom((operation, *map(self._signature, arguments)), Atom(operation, arguments))

    def whole(self, terms: Sum) -> Sum:
        """A sum as one atom; a single term stays what it is."""
        if len(terms) <= 1:
            return terms
        return self._atom(("sum", self._signature(terms)), Atom(None, (terms,)))

    def _atom(self, key: object, atom: Atom) -> Sum:
        if key not in self._place:
            self._place[key] = len(self.listed)
            self.listed.append(atom)
        return {(self._place[key],): _UNIT}

    def _signature(self, terms: Sum) -> object:
        return tuple(sorted((product, self._identity(c)) for product, c in terms.items()))

    def _identity(self, coefficient: ca.SX) -> float:
        if coefficient.is_constant():
            return float(coefficient)
        self._kept.append(coefficient)  # a hash belongs to a node only while the node lives
        return coefficient.element_hash()

    # --- arithmetic -------------------------------------------------------------------------------
    def times(self, a: Sum, b: Sum, *, shared: bool) -> Sum:
        """Product of two values; `shared` sums stay whole, so that they are computed once."""
        if not a or not b:
            return {}
        a, b = (a, b) if len(a) <= len(b) else (b, a)
        one = self.whole(a)
        ((product, coefficient),) = one.items()
        if product == _ONE:
            return self._scaled(b, coefficient, shared=shared)
        ((other, factor),) = self.whole(b).items()
        return {tuple(sorted((*product, *other))): coefficient * factor}

    def _scaled(self, terms: Sum, by: ca.SX, *, shared: bool) -> Sum:
        if len(terms) == 1 or by.is_constant():
            return {product: by * c for product, c in terms.items()}
        plain = {product: c for product, c in terms.items() if c.is_constant()}
        rest = {product: c for product, c in terms.items() if product not in plain}
        if shared:
            plain, rest = terms, {}
        # A coefficient goes to terms that have one already; to the others it goes once, as to a sum.
        return total(self._scaled(self.whole(plain), by, shared=False) if plain else {}, scaled(rest, by))

    def over(self, a: Sum, b: Sum, *, shared: bool) -> Sum:
        """Quotient of two values."""
        return self.times(a, self.inverse(b), shared=shared)

    def inverse(self, a: Sum) -> Sum:
        """One over a value; what is fixed is divided by in advance."""
        ((product, coefficient),) = self.whole(a).items() or {_ONE: ca.SX(0)}.items()
        under: Sum = {_ONE: 1 / coefficient}
        for atom in product:
            under = self.times(under, self.function(ca.OP_INV, {(atom,): _UNIT}), shared=False)
        return under


def is_fixed(terms: Sum) -> bool:
    """Whether a value depends on fixed symbols alone."""
    return all(product == _ONE for product in terms)


def scaled(terms: Sum, by: ca.SX | float) -> Sum:
    """Every coefficient multiplied."""
    return {product: by * c for product, c in terms.items()}


def total(*sums: Sum) -> Sum:
    """Sum of values, like terms collected."""
    result: Sum = {}
    for terms in sums:
        for product, c in terms.items():
            result[product] = result[product] + c if product in result else c
    return {product: c for product, c in result.items() if not c.is_zero()}


def apply(operation: int, arguments: Sequence[ca.SX]) -> ca.SX:
    return (ca.SX.unary if len(arguments) == 1 else ca.SX.binary)(operation, *arguments)


class Reading:
    """A function read instruction by instruction, every value as a sum of terms."""

    def __init__(self, function: ca.Function, to: Atoms) -> None:
        self._function, self._to = function, to
        self._register: dict[int, int] = {}
        self._values: list[Sum] = []
        self._steps = [self._step(k) for k in range(function.n_instructions())]
        self._uses = Counter(v for _, _, operands in self._steps for v in operands)
        self._angles = self._sines_and_cosines()
        self.results: dict[int, Sum] = {}
        for k, (operation, _, operands) in enumerate(self._steps):
            self._values.append(self._value(k, operation, operands))

    def _step(self, k: int) -> tuple[int, int, list[int]]:
        """Operation, its own number, and the numbers of the instructions that made its operands."""
        f, operation = self._function, self._function.instruction_id(k)
        into = f.instruction_output(k)
        made = operation in (ca.OP_INPUT, ca.OP_CONST)
        operands = [] if made else [self._register[i] for i in f.instruction_input(k)]
        if operation != ca.OP_OUTPUT:
            self._register[into[0]] = k
        return operation, k, operands

    def _sines_and_cosines(self) -> set[int]:
        """Instructions of which both the sine and the cosine are needed."""
        found = {o: {v[0] for q, _, v in self._steps if q == o} for o in (ca.OP_SIN, ca.OP_COS)}
        return found[ca.OP_SIN] & found[ca.OP_COS]

    def _value(self, k: int, operation: int, operands: list[int]) -> Sum:
        to, f = self._to, self._function
        if operation == ca.OP_INPUT:
            return to.input(*f.instruction_input(k))
        if operation == ca.OP_CONST:
            value = f.instruction_constant(k)
            return {_ONE: ca.SX(value)} if value else {}
        if operation == ca.OP_OUTPUT:
            self.results[f.instruction_output(k)[1]] = self._values[operands[0]]
            return {}
        values = [self._operand(v) for v in operands]
        if operation in _LINEAR:
            return _LINEAR[operation](*values)
        shared = any(self._uses[v] > 1 for v in operands)
        return self._nonlinear(operation, operands, values, shared=shared)

    def _operand(self, v: int) -> Sum:
        """A value that others use, too, is one atom; what is fixed never is."""
        terms = self._values[v]
        return self._to.whole(terms) if self._uses[v] > 1 and not is_fixed(terms) else terms

    def _nonlinear(self, operation: int, operands: list[int], values: list[Sum], *, shared: bool) -> Sum:
        to = self._to
        if operation == ca.OP_MUL:
            return to.times(*values, shared=shared)
        if operation == ca.OP_SQ:
            return to.times(values[0], values[0], shared=True)
        if operation == ca.OP_DIV:
            return to.over(*values, shared=shared)
        if operation == ca.OP_INV:
            return to.inverse(values[0])
        if operation == ca.OP_TAN and operands[0] in self._angles:
            sine, cosine = (to.function(o, values[0]) for o in (ca.OP_SIN, ca.OP_COS))
            return to.over(sine, cosine, shared=False)
        return to.function(operation, *values)


_LINEAR: dict[int, Callable[..., Sum]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: total,
    ca.OP_SUB: lambda a, b: total(a, scaled(b, -1)),
    ca.OP_NEG: lambda a: scaled(a, -1),
    ca.OP_TWICE: lambda a: scaled(a, 2),
}
