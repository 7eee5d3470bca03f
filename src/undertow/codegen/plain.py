"""Plain C99 of a CasADi function: one statement for each operation, no library behind it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection

import casadi as ca

from undertow.errors import UndertowError

_INFIX = {
    **{"OP_ADD": "+", "OP_SUB": "-", "OP_MUL": "*", "OP_DIV": "/"},
    **{"OP_LT": "<", "OP_LE": "<=", "OP_EQ": "==", "OP_NE": "!=", "OP_AND": "&&", "OP_OR": "||"},
}
_CALL = {
    **{"OP_SIN": "sin", "OP_COS": "cos", "OP_TAN": "tan", "OP_ASIN": "asin", "OP_ACOS": "acos"},
    **{"OP_ATAN": "atan", "OP_ATAN2": "atan2", "OP_SINH": "sinh", "OP_COSH": "cosh", "OP_TANH": "tanh"},
    **{"OP_EXP": "exp", "OP_LOG": "log", "OP_SQRT": "sqrt", "OP_POW": "pow", "OP_CONSTPOW": "pow"},
    **{"OP_FABS": "fabs", "OP_FMIN": "fmin", "OP_FMAX": "fmax", "OP_FLOOR": "floor"},
}
_TWO_OPERANDS = ("OP_ATAN2", "OP_POW", "OP_CONSTPOW", "OP_FMIN", "OP_FMAX")
_FORM: dict[str, str] = {
    "OP_NEG": "-{0}",
    "OP_SQ": "{0} * {0}",
    "OP_TWICE": "2 * {0}",
    "OP_INV": "1 / {0}",
    "OP_NOT": "!{0}",
    "OP_SIGN": "({0} > 0) - ({0} < 0)",
    "OP_IF_ELSE_ZERO": "{0} != 0 ? {1} : 0",
    **{k: f"{{0}} {v} {{1}}" for k, v in _INFIX.items()},
    **{k: f"{v}({{0}}, {{1}})" if k in _TWO_OPERANDS else f"{v}({{0}})" for k, v in _CALL.items()},
}
_OPERATION = {v: k for k, v in vars(ca).items() if k.startswith("OP_")}


def operation_forms() -> dict[int, str]:
    """C expression of every operation by CasADi's code for it, with {0} and {1} for the operands."""
    return {code: _FORM[name] for code, name in _OPERATION.items() if name in _FORM}


def signature(function: ca.Function, name: str) -> str:
    """`void name(const double *x, ..., double t, double *out)`; matrices are stored row by row."""
    inputs = [f"double {n}" if n == "t" else f"const double *{n}" for n in function.name_in()]
    return f"void {name}({', '.join([*inputs, *(f'double *{n}' for n in function.name_out())])})"


def plain_c(function: ca.Function, name: str, *, packed: Collection[str] = (), prefix: str = "") -> str:
    """C99 source of a CasADi function with dense inputs.

    Parameters
    ----------
    function : casadi.Function
        The function; an input called t is passed by value.
    name : str
        Name in C.
    packed : collection of str
        Outputs of which only the structural nonzeros are written, column by column (compressed columns).
    prefix : str
        What stands before the signature ("static ").

    Raises
    ------
    UndertowError
        If the function has an operation without a counterpart in C.
    """
    flat = function if function.is_a("SXFunction") else function.expand()
    body = _Body(flat, packed)
    # All is computed before anything is written: an output may lie where an input was.
    lines = [*body.unused(), *body.statements, *body.cleared(), *body.results]
    return f"{prefix}{signature(flat, name)} {{\n" + "".join(f"  {line}\n" for line in lines) + "}\n"


class _Body:
    """The instructions of a function, one after the other, as C statements."""

    def __init__(self, function: ca.Function, packed: Collection[str]) -> None:
        self._function = function
        self._inputs, self._outputs = function.name_in(), function.name_out()
        self._place = [_places(function.sparsity_out(n), n in packed) for n in self._outputs]
        self._register: dict[int, str] = {}
        self._read: set[str] = set()
        self._written: dict[str, int] = dict.fromkeys(self._outputs, 0)
        self._count = 0
        self.statements: list[str] = []
        self.results: list[str] = []
        for k in range(function.n_instructions()):
            self._instruction(k)

    def unused(self) -> list[str]:
        """Inputs without a use and outputs without an entry, told to the compiler."""
        empty = [n for n, (size, _) in zip(self._outputs, self._place, strict=True) if not size]
        return [f"(void){n};" for n in [*self._inputs, *empty] if n not in self._read]

    def cleared(self) -> list[str]:
        """Outputs with entries that are always zero are zeroed first."""
        sizes = zip(self._outputs, self._place, strict=True)
        partly = {n: size for n, (size, _) in sizes if self._written[n] < size}
        return [f"for (int i = 0; i < {size}; i++) {n}[i] = 0;" for n, size in partly.items()]

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
        if operation not in _FORM:
            raise UndertowError(
                f"operation {operation} of a model has no counterpart in C: restate the effect"
            )
        expression = _FORM[operation].format(*(self._register[i] for i in operands))
        self._register[into[0]] = self._local(expression)

    def _local(self, expression: str) -> str:
        name = f"a{self._count}"
        self._count += 1
        self.statements.append(f"const double {name} = {expression};")
        return name

    def _input(self, k: int, into: list[int], operands: list[int]) -> None:
        name = self._inputs[operands[0]]
        self._read.add(name)
        self._register[into[0]] = name if name == "t" else f"{name}[{operands[1]}]"

    def _output(self, k: int, into: list[int], operands: list[int]) -> None:
        value = self._register[operands[0]]
        if value == "0.0":
            return
        if "[" in value:  # an input that is handed on, and may be overwritten by then
            value = self._register[operands[0]] = self._local(value)
        name = self._outputs[into[0]]
        self._written[name] += 1
        self.results.append(f"{name}[{self._place[into[0]][1][into[1]]}] = {value};")

    def _constant(self, k: int, into: list[int], operands: list[int]) -> None:
        self._register[into[0]] = _number(self._function.instruction_constant(k))

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
