"""C99 of a CasADi function, one statement for each operation: plain, or for lanes that run side by side."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from undertow.errors import UndertowError

from .source import CALLS, FORMS, TWO_OPERANDS

_LANE_CALL = {
    **{"OP_LT": "less", "OP_LE": "at_most", "OP_EQ": "equal", "OP_NE": "unequal"},
    **{"OP_AND": "and", "OP_OR": "or", "OP_NOT": "not", "OP_SIGN": "sign", "OP_IF_ELSE_ZERO": "if"},
}
_ANGLES = ("OP_SIN", "OP_COS", "OP_TAN")
# As many angles as lanes.h turns into sines and cosines at once.
_TOGETHER = 4
_OPERATION = {v: k for k, v in vars(ca).items() if k.startswith("OP_")}


@dataclass(frozen=True)
class Words:
    """How C is spelled."""

    real: str  # type of a number
    spread: str  # how a double becomes one
    form: Mapping[str, str]  # the expression of every operation, operands as {0} and {1}
    # whether sine and cosine of an angle are computed together, and those of several angles, and whether what
    # divides several values is inverted once
    together: bool


PLAIN = Words("double", "{}", FORMS, together=False)
_CALLED = {**{k: v for k, v in CALLS.items() if k not in _ANGLES}, **_LANE_CALL}
_OF_TWO = {*TWO_OPERANDS, *_LANE_CALL} - {"OP_NOT", "OP_SIGN"}
LANES = Words(
    "Real",
    "real({})",
    {
        **{k: FORMS[k] for k in ("OP_ADD", "OP_SUB", "OP_MUL", "OP_DIV", "OP_NEG", "OP_SQ")},
        **{"OP_TWICE": "2.0 * {0}", "OP_INV": "1.0 / {0}"},
        **{k: f"real_{v}({{0}}, {{1}})" if k in _OF_TWO else f"real_{v}({{0}})" for k, v in _CALLED.items()},
    },
    together=True,
)
"""The words of lanes.h: the same text for any number of lanes."""


Structs = Mapping[str, tuple[str, Sequence[str]]]
"""Inputs that are structs in C: type and names of the members in order, by name of the input."""


def signature(
    function: ca.Function,
    name: str,
    *,
    words: Words = PLAIN,
    shared: Collection[str] = (),
    structs: Structs | None = None,
    by_value: Collection[str] = ("t",),
) -> str:
    """`void name(const double *x, ..., double t, double *out)`; matrices are stored row by row."""
    types = {n: "double" if n in shared else words.real for n in function.name_in()}
    types |= {n: of for n, (of, _) in (structs or {}).items()}
    inputs = [f"{of} {n}" if n in by_value else f"const {of} *{n}" for n, of in types.items()]
    return f"void {name}({', '.join([*inputs, *(f'{words.real} *{n}' for n in function.name_out())])})"


def plain_c(
    function: ca.Function,
    name: str,
    *,
    packed: Collection[str] = (),
    prefix: str = "",
    words: Words = PLAIN,
    shared: Collection[str] = (),
    structs: Structs | None = None,
    by_value: Collection[str] = ("t",),
) -> str:
    """C99 source of a CasADi function with dense inputs, called `name`, with `prefix` before the signature.

    Of `packed` outputs only the structural nonzeros are written, column by column (compressed columns).
    `shared` inputs are doubles, the same in all lanes; inputs in `structs` are structs (type and members);
    those in `by_value` are numbers and no pointers to them.
    """
    flat = function if function.is_a("SXFunction") else function.expand()
    body = _Body(flat, packed, words, shared, structs or {}, by_value)
    # All is computed before anything is written: an output may lie where an input was.
    lines = [*body.unused(), *body.statements, *body.cleared(), *body.results]
    head = signature(flat, name, words=words, shared=shared, structs=structs, by_value=by_value)
    return f"{prefix}{head} {{\n" + "".join(f"  {line}\n" for line in lines) + "}\n"


class _Body:
    """The instructions of a function, one after the other, as C statements."""

    def __init__(
        self,
        function: ca.Function,
        packed: Collection[str],
        words: Words,
        shared: Collection[str],
        structs: Structs,
        by_value: Collection[str],
    ) -> None:
        self._structs, self._by_value = structs, by_value
        self._function, self._words, self._shared = function, words, shared
        self._inputs, self._outputs = function.name_in(), function.name_out()
        self._place = [_places(function.sparsity_out(n), n in packed) for n in self._outputs]
        self._register: dict[int, str] = {}
        self._read: set[str] = set()
        self._written: dict[str, int] = dict.fromkeys(self._outputs, 0)
        self._count = 0
        self._zero = self._spread("0.0")
        self._sines: dict[str, tuple[str, str]] = {}
        self._inverses: dict[str, str] = {}
        self._ahead, self._divisors = self._look_ahead() if words.together else ([], set())
        self.statements: list[str] = []
        self.results: list[str] = []
        for k in range(function.n_instructions()):
            self._instruction(k)

    def _spread(self, value: str) -> str:
        return self._words.spread.format(value)

    def unused(self) -> list[str]:
        """Inputs without a use and outputs without an entry, declared to the compiler."""
        empty = [n for n, (size, _) in zip(self._outputs, self._place, strict=True) if not size]
        return [f"(void){n};" for n in [*self._inputs, *empty] if n not in self._read]

    def cleared(self) -> list[str]:
        """Outputs with entries that are always zero are zeroed first."""
        sizes = zip(self._outputs, self._place, strict=True)
        partly = {n: size for n, (size, _) in sizes if self._written[n] < size}
        return [
            f"for (int i = 0; i < {size}; i++) {{ {n}[i] = {self._spread('0')}; }}"
            for n, size in partly.items()
        ]

    def _instruction(self, k: int) -> None:
        f = self._function
        operation = _OPERATION[f.instruction_id(k)]
        into, operands = f.instruction_output(k), f.instruction_input(k)
        special: dict[str, Callable[[int, list[int], list[int]], None]] = {
            "OP_INPUT": self._input,
            "OP_OUTPUT": self._output,
            "OP_CONST": self._constant,
            "OP_ASSIGN": self._copy,
        }
        if operation in special:
            special[operation](k, into, operands)
            return
        values = [self._register[i] for i in operands]
        if operation in _ANGLES and self._words.together:
            self._register[into[0]] = self._of_angle(operation, values[0])
            return
        if k in self._divisors:
            self._register[into[0]] = self._quotient(*values)
            return
        if operation not in self._words.form:
            raise UndertowError(
                f"operation {operation} of a model has no counterpart in C: restate the effect"
            )
        self._register[into[0]] = self._local(self._words.form[operation].format(*values))

    def _local(self, expression: str) -> str:
        name = f"a{self._count}"
        self._count += 1
        self.statements.append(f"const {self._words.real} {name} = {expression};")
        return name

    # --- what is computed together --------------------------------------------------------------
    def _look_ahead(self) -> tuple[list[str], set[int]]:
        """Inputs that are angles: they can be turned at once. Divisions by what divides others, too."""
        f = self._function
        made: dict[int, int] = {}
        angles: dict[int, None] = {}
        divisions = defaultdict(list)
        for k in range(f.n_instructions()):
            operation, operands = _OPERATION[f.instruction_id(k)], f.instruction_input(k)
            if operation in _ANGLES:
                angles[made[operands[0]]] = None
            elif operation == "OP_DIV":
                divisions[made[operands[1]]].append(k)
            if operation != "OP_OUTPUT":
                made[f.instruction_output(k)[0]] = k
        inputs = [k for k in angles if _OPERATION[f.instruction_id(k)] == "OP_INPUT"]
        several = {k for found in divisions.values() if len(found) > 1 for k in found}
        return [self._element(f.instruction_input(k)) for k in inputs], several

    def _quotient(self, above: str, below: str) -> str:
        if below not in self._inverses:
            self._inverses[below] = self._local(f"1.0 / {below}")
        return self._local(f"{above} * {self._inverses[below]}")

    def _of_angle(self, operation: str, angle: str) -> str:
        if angle not in self._sines:
            together = [a for a in self._ahead if a not in self._sines] if angle in self._ahead else [angle]
            self._turn([angle, *(a for a in together if a != angle)][:_TOGETHER])
        sine, cosine = self._sines[angle]
        if operation == "OP_TAN":
            return self._local(f"{sine} / {cosine}")
        return sine if operation == "OP_SIN" else cosine

    def _turn(self, angles: list[str]) -> None:
        k, n, real = self._count, len(angles), self._words.real
        self._count += 1
        self.statements += [
            f"const {real} angle{k}[] = {{{', '.join(angles)}}};",
            f"{real} sine{k}[{n}], cosine{k}[{n}];",
            f"real_sincos({n}, angle{k}, sine{k}, cosine{k});",
        ]
        self._sines |= {a: (f"sine{k}[{i}]", f"cosine{k}[{i}]") for i, a in enumerate(angles)}

    # --- in and out -----------------------------------------------------------------------------
    def _input(self, k: int, into: list[int], operands: list[int]) -> None:
        self._read.add(self._inputs[operands[0]])
        self._register[into[0]] = self._element(operands)

    def _element(self, operands: list[int]) -> str:
        name = self._inputs[operands[0]]
        element = name if name in self._by_value else f"{name}[{operands[1]}]"
        if name in self._structs:
            element = f"{name}->{self._structs[name][1][operands[1]]}"
        return self._spread(element) if name in self._shared else element

    def _output(self, k: int, into: list[int], operands: list[int]) -> None:
        value = self._register[operands[0]]
        if value == self._zero:
            return
        if "[" in value:  # an input that is handed on, and may be overwritten by then
            value = self._register[operands[0]] = self._local(value)
        name = self._outputs[into[0]]
        self._written[name] += 1
        self.results.append(f"{name}[{self._place[into[0]][1][into[1]]}] = {value};")

    def _constant(self, k: int, into: list[int], operands: list[int]) -> None:
        self._register[into[0]] = self._spread(_number(self._function.instruction_constant(k)))

    def _copy(self, k: int, into: list[int], operands: list[int]) -> None:
        self._register[into[0]] = self._register[operands[0]]


def _number(value: float) -> str:
    if math.isnan(value):
        return "NAN"
    if math.isinf(value):
        return "INFINITY" if value > 0 else "(-INFINITY)"
    return f"({value!r})" if math.copysign(1, value) < 0 else repr(value)


def _places(sparsity: ca.Sparsity, packed: bool) -> tuple[int, list[int]]:
    """Size of an output in C and the place of every nonzero in it."""
    if packed:
        return sparsity.nnz(), list(range(sparsity.nnz()))
    rows, columns = sparsity.get_triplet()
    return sparsity.numel(), [i * sparsity.size2() + j for i, j in zip(rows, columns, strict=True)]
