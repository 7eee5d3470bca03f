"""The instructions of a CasADi function as arrays of numbers, for an interpreter that is not CasADi's."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate

import casadi as ca
import numpy as np

from undertow.errors import UndertowError

ARITHMETIC = ("ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE", "INV", "FABS", "SQRT")
LOGIC = ("LT", "LE", "EQ", "NE", "AND", "OR", "NOT", "SIGN", "IF_ELSE_ZERO", "FMIN", "FMAX", "FLOOR")
CIRCULAR = ("SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "ATAN2")
EXPONENTIAL = ("SINH", "COSH", "TANH", "EXP", "LOG", "POW", "CONSTPOW")
OPERATIONS = (*ARITHMETIC, *LOGIC, *CIRCULAR, *EXPONENTIAL)
"""The place of a name is the number of the operation."""

_NUMBER = {getattr(ca, f"OP_{name}"): k for k, name in enumerate(OPERATIONS)}
_NAME = {v: k for k, v in vars(ca).items() if k.startswith("OP_")}


@dataclass(frozen=True)
class Tape:
    """Instructions and the memory that they work in.

    Attributes
    ----------
    code : ndarray of uint32, shape (n, 4)
        Operation, place of its result and of its operands (a single one twice).
    memory : ndarray
        The inputs one after the other, constants, and a place for every result. Whoever evaluates writes the
        inputs into a copy.
    inputs : tuple of int
        Where each input begins, and where the last one ends.
    results : ndarray of uint32
        Places of the structural nonzeros of the outputs, one output after the other, column by column.
    outputs : tuple of int
        Where each output begins in `results`, and where the last one ends.
    """

    code: np.ndarray
    memory: np.ndarray
    inputs: tuple[int, ...]
    results: np.ndarray
    outputs: tuple[int, ...]


def tape_of(function: ca.Function) -> Tape:
    """The instructions of a function.

    Parameters
    ----------
    function : casadi.Function
        The function.

    Raises
    ------
    UndertowError
        If it has an operation that the interpreter does not know.
    """
    return _Reader(function if function.is_a("SXFunction") else function.expand()).tape()


def ready(tape: Tape) -> tuple[np.ndarray, ...]:
    """(code, memory of its own, results, inputs) of a tape, as compiled functions take it."""
    return tape.code, tape.memory.copy(), tape.results, np.array(tape.inputs)


class _Reader:
    """Follows the instructions; a place of the virtual machine stands for one value after the other."""

    def __init__(self, function: ca.Function) -> None:
        self._function = function
        self._inputs = (0, *accumulate(function.nnz_in(i) for i in range(function.n_in())))
        self._outputs = (0, *accumulate(function.nnz_out(i) for i in range(function.n_out())))
        self._operations = [function.instruction_id(k) for k in range(function.n_instructions())]
        constants = [k for k, o in enumerate(self._operations) if o == ca.OP_CONST]
        self._first = self._inputs[-1]
        self._constants = [function.instruction_constant(k) for k in constants]
        self._next_constant, self._next = self._first, self._first + len(constants)
        self._place: dict[int, int] = {}
        self._code: list[tuple[int, int, int, int]] = []
        self._results = [0] * self._outputs[-1]

    def tape(self) -> Tape:
        for k, operation in enumerate(self._operations):
            self._follow(k, operation)
        memory = np.zeros(self._next)
        memory[self._first : self._first + len(self._constants)] = self._constants
        code = np.array(self._code, dtype=np.uint32).reshape(-1, 4)
        return Tape(code, memory, self._inputs, np.array(self._results, dtype=np.uint32), self._outputs)

    def _follow(self, k: int, operation: int) -> None:
        into, operands = self._function.instruction_output(k), self._function.instruction_input(k)
        if operation == ca.OP_OUTPUT:
            self._results[self._outputs[into[0]] + into[1]] = self._place[operands[0]]
        elif operation == ca.OP_INPUT:
            self._place[into[0]] = self._inputs[operands[0]] + operands[1]
        elif operation == ca.OP_CONST:
            self._place[into[0]] = self._next_constant
            self._next_constant += 1
        elif operation == ca.OP_ASSIGN:
            self._place[into[0]] = self._place[operands[0]]
        else:
            self._add(operation, into[0], operands)

    def _add(self, operation: int, into: int, operands: list[int]) -> None:
        if operation not in _NUMBER:
            raise UndertowError(
                f"operation {_NAME[operation]} of a model is unknown to the interpreter: restate the effect"
            )
        first, second = self._place[operands[0]], self._place[operands[-1]]
        self._code.append((_NUMBER[operation], self._next, first, second))
        self._place[into] = self._next
        self._next += 1
