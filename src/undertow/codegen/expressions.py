"""Expressions: from SymPy to CasADi, and the dynamics rewritten for few operations."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, reduce
from itertools import combinations

import casadi as ca
import numpy as np
import sympy as sm

from undertow.errors import UndertowError
from undertow.model.symbols import Signals

# --- from SymPy to CasADi -------------------------------------------------------------------------
_FUNCTIONS: dict[type[sm.Basic], Callable[..., ca.SX]] = {
    sm.sin: ca.sin,
    sm.cos: ca.cos,
    sm.tan: ca.tan,
    sm.asin: ca.asin,
    sm.acos: ca.acos,
    sm.atan: ca.atan,
    sm.atan2: ca.atan2,
    sm.sinh: ca.sinh,
    sm.cosh: ca.cosh,
    sm.tanh: ca.tanh,
    sm.exp: ca.exp,
    sm.log: ca.log,
    sm.Abs: ca.fabs,
    sm.sign: ca.sign,
    sm.Min: lambda *a: reduce(ca.fmin, a),
    sm.Max: lambda *a: reduce(ca.fmax, a),
}


# CasADi's operators try one type of operand after the other, which takes ten times as long.
def plus(a: ca.SX, b: ca.SX) -> ca.SX:
    """a + b."""
    return ca.SX.binary(ca.OP_ADD, a, b)


def times(a: ca.SX, b: ca.SX) -> ca.SX:
    """The product of a and b, entry by entry."""
    return ca.SX.binary(ca.OP_MUL, a, b)


class Converter:
    """Turns SymPy expressions into CasADi ones; equal subexpressions become one node."""

    def __init__(self, symbols: Mapping[sm.Symbol, ca.SX]) -> None:
        self._known: dict[sm.Basic, ca.SX] = dict(symbols)

    def define(self, symbols: Mapping[sm.Symbol, sm.Expr]) -> None:
        """Let symbols stand for expressions in the symbols known so far."""
        converted = {s: self(e) for s, e in symbols.items()}
        self._known.update(converted)

    def matrix(self, matrix: sm.Matrix) -> ca.SX:
        """Convert a matrix; entries that are zero stay structurally zero."""
        result = ca.SX(matrix.rows, matrix.cols)
        for (i, j), entry in matrix.todok().items():
            converted = self(entry)
            if not converted.is_zero():
                result[i, j] = converted
        return result

    def __call__(self, expression: sm.Expr) -> ca.SX:
        found = self._known.get(expression)
        if found is None:
            found = self._known[expression] = self._convert(sm.sympify(expression, strict=True))
        return found

    def _convert(self, e: sm.Expr) -> ca.SX:
        if e.is_Number or e.is_NumberSymbol:
            return ca.SX(float(e))
        if e.is_Add:
            return reduce(plus, map(self, e.args))
        if e.is_Mul:
            return self._product(e)
        if e.is_Pow:
            return self._power(*e.args)
        if isinstance(e, sm.Piecewise):
            return self._piecewise(e)
        if e.func not in _FUNCTIONS:
            raise UndertowError(
                f"'{e}' has no C counterpart: use one of {', '.join(sorted(map(str, _FUNCTIONS)))}"
            )
        return _FUNCTIONS[e.func](*map(self, e.args))

    def _product(self, e: sm.Expr) -> ca.SX:
        numerator, denominator = sm.fraction(e, exact=True)
        if denominator != 1 and denominator != e:
            return self(numerator) / self(denominator)
        return reduce(times, map(self, e.args))

    def _power(self, base: sm.Expr, exponent: sm.Expr) -> ca.SX:
        if exponent == sm.Rational(1, 2):
            return ca.sqrt(self(base))
        if exponent.is_Integer and 0 < abs(exponent) <= 6:
            power = reduce(times, [self(base)] * int(abs(exponent)))
            return power if exponent > 0 else 1 / power
        return self(base) ** self(exponent)

    def _piecewise(self, e: sm.Piecewise) -> ca.SX:
        result = ca.SX(0)
        for value, condition in reversed(e.args):
            result = (
                self(value)
                if condition == sm.true
                else ca.if_else(self._relation(condition), self(value), result)
            )
        return result

    def _relation(self, condition: sm.Basic) -> ca.SX:
        left, right = map(self, condition.args)
        relations = {
            sm.StrictLessThan: ca.lt,
            sm.LessThan: ca.le,
            sm.StrictGreaterThan: ca.gt,
            sm.GreaterThan: ca.ge,
        }
        return relations[condition.func](left, right)


# --- for few operations: inertial wrenches by their momentum, like terms collected ----------------
# Cross products of Kirchhoff's equations: row, sign, component of the velocity, component of the momentum.
_CROSS = tuple(
    (row + i, sign, velocity + (i + a) % 3, momentum + (i + b) % 3)
    for row, velocity, momentum in ((0, 3, 0), (3, 0, 0), (3, 3, 3))
    for i in range(3)
    for sign, a, b in ((1, 1, 2), (-1, 2, 1))
)
Entry = tuple[int, int]
Terms = list[tuple[int, Entry]]


@dataclass(frozen=True)
class IdentitySettings:
    """How two expressions are compared at random points."""

    points: int = 3
    seed: int = 0  # of the random points
    rounding: float = 1e-12  # difference, relative to the largest entry, that is rounding


IDENTITY = IdentitySettings()


@dataclass(frozen=True)
class Inertia:
    """Inertial wrenches in rows and columns of the degrees of freedom."""

    ids: tuple[str, ...]  # the effects
    # mass, water_mass: (6, 6): what multiplies nu_dot and, apart from that, the translations of nu_r_dot
    mass: ca.SX
    water_mass: ca.SX
    # momentum, water_momentum: (6, 6): A for the velocity over ground, and for the velocity through the water
    momentum: ca.SX
    water_momentum: ca.SX


def kirchhoff(momentum: ca.SX, nu: ca.SX) -> ca.SX:
    """(omega x h_1, v x h_1 + omega x h_2), shape (6, 1)."""
    h, v, w = momentum @ nu, nu[:3], nu[3:]
    return ca.vertcat(ca.cross(w, h[:3]), ca.cross(v, h[:3]) + ca.cross(w, h[3:]))


def find_inertia(
    wrenches: Mapping[str, sm.Matrix],
    s: Signals,
    known: Converter,
    p: ca.SX,
    dofs: tuple[int, ...],
    prescribed: tuple[str, ...] = (),
) -> Inertia:
    """The inertial ones among some wrenches; `prescribed` are inputs that the log holds."""
    search = _Search(s, known, p, dofs, prescribed)
    found = {i: parts for i, w in wrenches.items() if (parts := search.parts(w)) is not None}
    total = [sum(parts, ca.SX(6, 6)) for parts in zip(*found.values(), strict=True)] or [ca.SX(6, 6)] * 4
    return Inertia(tuple(found), *total)


def is_galilean(inertia: Inertia, p: ca.SX, dofs: tuple[int, ...]) -> bool:
    """Whether what moves over ground feels no difference between still water and a steady flow.

    For water of velocity w in body axes, that is M (omega x w, 0) + K(A, nu - (w, 0)) = K(A, nu): a rigid
    body with all of its Coriolis forces does not know whether the ground moves.
    """
    nu, water = ca.SX.sym("nu", 6), ca.SX.sym("water", 3)
    moving = [int(i in dofs) for i in range(6)]
    turned = ca.vertcat(ca.cross(nu[3:], water), ca.SX.zeros(3)) * moving
    velocity = nu * moving
    relative = (nu - ca.vertcat(water, ca.SX.zeros(3))) * moving
    left = inertia.mass @ ca.substitute(turned, nu, velocity) + kirchhoff(inertia.momentum, relative)
    right, rows = kirchhoff(inertia.momentum, velocity), list(dofs)
    return identical(left[rows], right[rows], ca.vertcat(p, nu, water))


class _Search:
    """Decides for one wrench after the other."""

    def __init__(
        self, s: Signals, known: Converter, p: ca.SX, dofs: tuple[int, ...], prescribed: tuple[str, ...]
    ) -> None:
        self._known, self._p, self._dofs = known, p, dofs
        self._ground, self._pushed = ca.SX.sym("nu", len(dofs)), ca.SX.sym("nu_dot", len(dofs))
        # The water does not rotate: through it only the translations are different.
        moves = tuple(i for i in dofs if i < 3)
        self._water, self._water_pushed = ca.SX.sym("nu_r", len(moves)), ca.SX.sym("nu_r_dot", len(moves))
        self._relative = ca.vertcat(self._water, *ca.vertsplit(self._ground)[len(moves) :])
        self._meaning: dict[sm.Symbol, ca.SX] = {
            x: ca.SX(0) for m in (s.nu, s.nu_r, s.nu_dot, s.nu_r_dot) for x in m
        }
        for stated, symbols, places in (
            (s.nu_r, self._water, moves),
            (s.nu_r_dot, self._water_pushed, moves),
            (s.nu, self._ground, dofs),
            (s.nu_dot, self._pushed, dofs),
        ):
            self._meaning.update({stated[i]: symbols[k] for k, i in enumerate(places)})
        # What is prescribed by the log is no motion of the model's own.
        for i in (i for i, x in enumerate(s.nu) if str(x) in prescribed):
            self._meaning = {x: e for x, e in self._meaning.items() if x not in (s.nu[i], s.nu_r[i])}
        self._motion = ca.vertcat(self._ground, self._pushed, self._water, self._water_pushed)

    def parts(self, wrench: sm.Matrix) -> tuple[ca.SX, ca.SX, ca.SX, ca.SX] | None:
        """What a wrench adds to each matrix of `Inertia`, or None if it is not inertial."""
        w = self._converted(wrench)
        if w is None:
            return None
        masses = [-ca.jacobian(w, a) for a in (self._pushed, self._water_pushed)]
        if ca.depends_on(ca.horzcat(*masses), self._motion):
            return None
        momenta = self._momenta(_at_zero(w, ca.vertcat(self._pushed, self._water_pushed)))
        return None if momenta is None else (*(self._embedded(m) for m in masses), *momenta)

    def _converted(self, wrench: sm.Matrix) -> ca.SX | None:
        """The wrench in motion and parameters, or None if it depends on more."""
        rows = wrench.extract(list(self._dofs), [0])
        parameters = {x: self._known(x) for x in rows.free_symbols if x not in self._meaning}
        fixed = {e.element_hash() for e in ca.vertsplit(self._p)}
        used = ca.symvar(ca.vertcat(ca.SX(0, 1), *parameters.values()))
        if not fixed.issuperset(e.element_hash() for e in used):
            return None
        return Converter(parameters | self._meaning).matrix(rows)

    def _embedded(self, matrix: ca.SX) -> ca.SX:
        result = ca.SX(6, 6)
        result[list(self._dofs), list(self._dofs[: matrix.size2()])] = matrix
        return result

    def _momenta(self, still: ca.SX) -> tuple[ca.SX, ca.SX] | None:
        """A for the velocity over ground and A for that through the water, one of them zero."""
        none = ca.SX(6, 6)
        if not ca.depends_on(still, self._water):
            a = self._momentum(still, self._ground)
            return None if a is None else (a, none)
        a = self._momentum(still, self._relative)
        return None if a is None else (none, a)

    def _momentum(self, still: ca.SX, nu: ca.SX) -> ca.SX | None:
        """The matrix A with still = -K(A, nu), or None if there is none."""
        slope = ca.jacobian(still, nu)
        curvature = ca.jacobian(ca.vec(slope), nu)
        resting = _at_zero(ca.horzcat(still, slope), nu)
        if ca.depends_on(curvature, self._motion) or ca.sparsify(resting).nnz():
            return None
        # By Taylor's theorem the coefficients of nu_j nu_k say all.
        coefficients: dict[tuple[int, int, int], ca.SX] = {}
        rows, columns = curvature.sparsity().get_triplet()
        for place, k, value in zip(rows, columns, curvature.nonzeros(), strict=True):
            j, i = divmod(place, len(self._dofs))
            if j <= k:
                key = self._dofs[i], self._dofs[j], self._dofs[k]
                coefficients[key] = (-0.5 if j == k else -1) * value
        known = _solved(coefficients, self._dofs)
        return _symmetric(known) if self._gives(known, coefficients) else None

    def _gives(
        self, known: Mapping[Entry, ca.SX], coefficients: Mapping[tuple[int, int, int], ca.SX]
    ) -> bool:
        equations, zero = _equations(self._dofs), ca.SX(0)
        places = {*equations, *coefficients}
        left = [_signed_sum(equations.get(c, []), known) for c in places]
        return identical(ca.vertcat(*left), ca.vertcat(*(coefficients.get(c, zero) for c in places)), self._p)


def _at_zero(expression: ca.SX, symbols: ca.SX) -> ca.SX:
    return ca.substitute(expression, symbols, ca.SX.zeros(symbols.shape))


@cache
def _equations(dofs: tuple[int, ...]) -> dict[tuple[int, int, int], Terms]:
    """Coefficient of nu_j nu_k (j <= k) in row i of K(A, nu), as a sum of entries of the symmetric A."""
    found = defaultdict(list)
    for i, sign, j, b in _CROSS:
        for k in dofs:
            if i in dofs and j in dofs:
                found[i, min(j, k), max(j, k)].append((sign, (min(b, k), max(b, k))))
    return dict(found)


def _solved(coefficients: Mapping[tuple[int, int, int], ca.SX], dofs: tuple[int, ...]) -> dict[Entry, ca.SX]:
    """Entries of a matrix A whose K has these coefficients if there is one; what K does not show is zero."""
    zero, known = ca.SX(0), dict[Entry, ca.SX]()
    for entry, sign, place, others in _elimination(dofs):
        shown = coefficients.get(place, zero) - _signed_sum(others, known) if sign else zero
        known[entry] = -shown if sign < 0 else shown
    return known


@cache
def _elimination(dofs: tuple[int, ...]) -> list[tuple[Entry, int, tuple[int, int, int], Terms]]:
    """Entries of A in an order in which each follows from those before.

    With its sign in the equation of a place (0 where K does not show it) and the other terms there.
    """
    equations, known, found = _equations(dofs), set[Entry](), []
    while unknown := {m for terms in equations.values() for _, m in terms} - known:
        open_ = {c: [(s, m) for s, m in terms if m not in known] for c, terms in equations.items()}
        place = next((c for c, terms in open_.items() if len(terms) == 1), None)
        entry, sign, others = min(unknown), 0, Terms()
        if place is not None:
            ((sign, entry),) = open_[place]
            others = [(s, m) for s, m in equations[place] if m != entry]
        found.append((entry, sign, place or (0, 0, 0), others))
        known.add(entry)
    return found


def _signed_sum(terms: Terms, known: Mapping[Entry, ca.SX]) -> ca.SX:
    return reduce(plus, (known[m] if sign > 0 else -known[m] for sign, m in terms), ca.SX(0))


def _symmetric(known: Mapping[Entry, ca.SX]) -> ca.SX:
    result = ca.SX(6, 6)
    for (j, k), value in known.items():
        if not value.is_zero():
            result[j, k] = result[k, j] = value
    return result


def identical(left: ca.SX, right: ca.SX, symbols: ca.SX) -> bool:
    """Whether two expressions are identical: equal at random points but for rounding."""
    both = ca.Function("both", [symbols], [ca.densify(left), ca.densify(right)])
    random = np.random.default_rng(IDENTITY.seed)
    for _ in range(IDENTITY.points):
        a, b = (np.asarray(e) for e in both(random.uniform(0.5, 2, symbols.numel())))
        scale = max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0))
        if not np.abs(a - b).max(initial=0.0) <= IDENTITY.rounding * scale:
            return False
    return True


Product = tuple[int, ...]
Sum = dict[Product, ca.SX]
_ONE: Product = ()
_UNIT, _TWO, _MINUS = map(ca.SX, (1, 2, -1))


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
        return {tuple(sorted((*product, *other))): times(coefficient, factor)}

    def _scaled(self, terms: Sum, by: ca.SX, *, shared: bool) -> Sum:
        if len(terms) == 1 or by.is_constant():
            return scaled(terms, by)
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


def scaled(terms: Sum, by: ca.SX) -> Sum:
    """Every coefficient multiplied."""
    return {product: times(by, c) for product, c in terms.items()}


def total(*sums: Sum) -> Sum:
    """Sum of values, like terms collected."""
    result: Sum = {}
    for terms in sums:
        for product, c in terms.items():
            result[product] = plus(result[product], c) if product in result else c
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
        self._uses = Counter(v for _, operands in self._steps for v in operands)
        self._angles = self._sines_and_cosines()
        self.results: dict[int, Sum] = {}
        for k, (operation, operands) in enumerate(self._steps):
            self._values.append(self._value(k, operation, operands))

    def _step(self, k: int) -> tuple[int, list[int]]:
        """Operation, and the numbers of the instructions that made its operands."""
        f, operation = self._function, self._function.instruction_id(k)
        made = operation in (ca.OP_INPUT, ca.OP_CONST)
        operands = [] if made else [self._register[i] for i in f.instruction_input(k)]
        if operation != ca.OP_OUTPUT:
            self._register[f.instruction_output(k)[0]] = k
        return operation, operands

    def _sines_and_cosines(self) -> set[int]:
        """Instructions of which both the sine and the cosine are needed."""
        found = {o: {v[0] for q, v in self._steps if q == o} for o in (ca.OP_SIN, ca.OP_COS)}
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
    ca.OP_SUB: lambda a, b: total(a, scaled(b, _MINUS)),
    ca.OP_NEG: lambda a: scaled(a, _MINUS),
    ca.OP_TWICE: lambda a: scaled(a, _TWO),
}


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
            return reduce(plus, [self._term(*t) for t in ordered]) if terms else ca.SX(0)
        inner = {_less(p, factor): c for p, c in terms.items() if self._divisible(p, factor)}
        outer = {p: c for p, c in terms.items() if not self._divisible(p, factor)}
        product = times(self.sum(inner), self._atom(factor))
        return plus(self.sum(outer), product) if outer else product

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
        return times(stored, self._product(product)) if product else stored

    def _product(self, product: Product) -> ca.SX:
        """A product of atoms, from the partial product that the most products have."""
        if len(product) == 1:
            return self._atom(product[0])
        if product not in self._products:
            last = max(product, key=lambda a: self._parts[_less(product, a)])
            self._products[product] = times(self._product(_less(product, last)), self._atom(last))
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
