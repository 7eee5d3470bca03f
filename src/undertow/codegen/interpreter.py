"""Evaluation of a tape of instructions, compiled by numba: import this only where numba is installed."""

from __future__ import annotations

import math

import numpy as np

from .instructions import ARITHMETIC, CIRCULAR, LOGIC, OPERATIONS
from .numba_code import by_numba

# Numba takes these numbers for constants and makes a table of jumps of the comparisons.
ADD, SUB, MUL, DIV, NEG, SQ, TWICE, INV, FABS, SQRT, *_REST = range(len(OPERATIONS))
LT, LE, EQ, NE, AND, OR, NOT, SIGN, IF_ELSE_ZERO, FMIN, FMAX, FLOOR, *_REST = _REST
SIN, COS, TAN, ASIN, ACOS, ATAN, ATAN2, *_REST = _REST
SINH, COSH, TANH, EXP, LOG, POW, CONSTPOW = _REST
_LOGIC = len(ARITHMETIC)
_CIRCULAR = _LOGIC + len(LOGIC)
_EXPONENTIAL = _CIRCULAR + len(CIRCULAR)


@by_numba
def _arithmetic(operation: int, a: float, b: float) -> float:
    if operation == ADD:
        return a + b
    if operation == SUB:
        return a - b
    if operation == MUL:
        return a * b
    if operation == DIV:
        return a / b
    if operation == NEG:
        return -a
    if operation == SQ:
        return a * a
    if operation == TWICE:
        return 2 * a
    if operation == INV:
        return 1 / a
    if operation == FABS:
        return abs(a)
    return math.sqrt(a)


@by_numba
def _logic(operation: int, a: float, b: float) -> float:
    if operation == LT:
        return 1.0 if a < b else 0.0
    if operation == LE:
        return 1.0 if a <= b else 0.0
    if operation == EQ:
        return 1.0 if a == b else 0.0
    if operation == NE:
        return 1.0 if a != b else 0.0
    if operation == AND:
        return 1.0 if a != 0 and b != 0 else 0.0
    if operation == OR:
        return 1.0 if a != 0 or b != 0 else 0.0
    if operation == NOT:
        return 1.0 if a == 0 else 0.0
    if operation == SIGN:
        return 1.0 if a > 0 else -1.0 if a < 0 else a
    if operation == IF_ELSE_ZERO:
        return b if a != 0 else 0.0
    if operation == FMIN:
        return a if a < b or b != b else b
    if operation == FMAX:
        return a if a > b or b != b else b
    return np.floor(a)


@by_numba
def _circular(operation: int, a: float, b: float) -> float:
    if operation == SIN:
        return math.sin(a)
    if operation == COS:
        return math.cos(a)
    if operation == TAN:
        return math.tan(a)
    if operation == ASIN:
        return math.asin(a)
    if operation == ACOS:
        return math.acos(a)
    if operation == ATAN:
        return math.atan(a)
    return math.atan2(a, b)


@by_numba
def _exponential(operation: int, a: float, b: float) -> float:
    if operation == SINH:
        return math.sinh(a)
    if operation == COSH:
        return math.cosh(a)
    if operation == TANH:
        return math.tanh(a)
    if operation == EXP:
        return math.exp(a)
    if operation == LOG:
        return math.log(a)
    return math.pow(a, b)


@by_numba
def evaluate(code: np.ndarray, memory: np.ndarray) -> None:
    """Carry out the instructions of a `Tape` in its memory, inputs written already."""
    for k in range(len(code)):
        operation, a, b = code[k, 0], memory[code[k, 2]], memory[code[k, 3]]
        if operation < _LOGIC:
            memory[code[k, 1]] = _arithmetic(operation, a, b)
        elif operation < _CIRCULAR:
            memory[code[k, 1]] = _logic(operation, a, b)
        elif operation < _EXPONENTIAL:
            memory[code[k, 1]] = _circular(operation, a, b)
        else:
            memory[code[k, 1]] = _exponential(operation, a, b)


@by_numba
def call(tape: tuple[np.ndarray, ...], found: np.ndarray) -> None:
    """Evaluate and write the outputs, one after the other, into `found`.

    The tape is (code, memory, results, inputs) of a `Tape`.
    """
    code, memory, results, _ = tape
    evaluate(code, memory)
    for i in range(len(results)):
        found[i] = memory[results[i]]


@by_numba
def put(tape: tuple[np.ndarray, ...], which: int, values: np.ndarray) -> None:
    """Write input number `which` of a tape."""
    memory, begin = tape[1], tape[3][which]
    for i in range(len(values)):
        memory[begin + i] = values[i]
