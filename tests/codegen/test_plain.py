"""Plain C of single operations, and of functions with awkward shapes."""

from __future__ import annotations

import ctypes
import math
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from undertow import UndertowError
from undertow.codegen.compiler import Compiler, plain_c

A, B = ca.SX.sym("a"), ca.SX.sym("b")
OPERATIONS = {
    "arithmetic": A + B * A - A / B,
    "powers": ca.sqrt(ca.fabs(A)) + A**2 + A**3 + ca.fabs(A) ** B + 2 * A + 1 / A,
    "trigonometry": ca.sin(A) + ca.cos(B) + ca.tan(A) + ca.atan2(A, B) + ca.atan(A),
    "inverse": ca.asin(ca.tanh(A)) + ca.acos(ca.tanh(B)),
    "hyperbolic": ca.sinh(A) + ca.cosh(B) + ca.tanh(A),
    "exponential": ca.exp(A) + ca.log(ca.fabs(B)),
    "kinks": ca.fabs(A) + ca.sign(B) * 3 + ca.fmin(A, B) * 5 - ca.fmax(A, B),
    "choice": ca.if_else(A < B, A, -B) + ca.if_else(ca.logic_or(A <= 0, B <= 0), 2, 3),
    "logic": ca.if_else(ca.logic_and(A > 0, ca.logic_not(B > 0)), 5, 7) + ca.if_else(A == B, 1, 2),
    "constants": A * 1e-300 + B * -0.1 + 1e22 - 3,
}


def _library(source: str, compiler: Compiler, folder: Path) -> ctypes.CDLL:
    (folder / "it.c").write_text('#include <math.h>\n__attribute__((visibility("default")))\n' + source)
    compiler.build(folder / "it.c", folder / "it.so")
    return ctypes.CDLL(str(folder / "it.so"))


def _array(values: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(values.ctypes.data)


def test_every_operation_is_casadis(c_compiler: Compiler, tmp_path: Path) -> None:
    function = ca.Function("f", [ca.vertcat(A, B)], [ca.vertcat(*OPERATIONS.values())], ["x"], ["y"])
    library = _library(plain_c(function, "f"), c_compiler, tmp_path)
    values = [-2.5, -1.0, -0.3, 0.4, 1.0, 1.7]
    for x in (np.array([a, b]) for a in values for b in values):
        y = np.empty(len(OPERATIONS))
        library.f(_array(x), _array(y))
        expected = np.array(function(x)).ravel()
        for name, found, wanted in zip(OPERATIONS, y, expected, strict=True):
            assert found == pytest.approx(wanted, rel=1e-14, abs=0, nan_ok=True), (name, x)


def test_the_sign_of_what_is_no_number_is_none(c_compiler: Compiler, tmp_path: Path) -> None:
    library = _library(plain_c(ca.Function("f", [A], [ca.sign(A)], ["x"], ["y"]), "f"), c_compiler, tmp_path)
    for x, expected in ((math.nan, math.nan), (-3.0, -1.0), (0.0, 0.0), (math.inf, 1.0)):
        y = np.empty(1)
        library.f(_array(np.array([x])), _array(y))
        assert y[0] == pytest.approx(expected, abs=0, nan_ok=True)


def test_matrices_are_stored_row_by_row_and_zeros_are_written(c_compiler: Compiler, tmp_path: Path) -> None:
    matrix = ca.SX(3, 2)
    matrix[0, 1], matrix[2, 0] = A, B
    function = ca.Function("f", [ca.vertcat(A, B)], [ca.densify(matrix)], ["x"], ["y"])
    library = _library(plain_c(function, "f"), c_compiler, tmp_path)
    y = np.full((3, 2), np.nan)
    library.f(_array(np.array([5.0, 7.0])), _array(y))
    assert np.array_equal(y, [[0, 5], [0, 0], [7, 0]])


def test_packed_outputs_hold_the_nonzeros_of_the_columns(c_compiler: Compiler, tmp_path: Path) -> None:
    matrix = ca.SX(3, 2)
    matrix[0, 1], matrix[2, 0], matrix[1, 1] = A, B, A * B
    function = ca.Function("f", [ca.vertcat(A, B)], [matrix], ["x"], ["y"])
    library = _library(plain_c(function, "f", packed=["y"]), c_compiler, tmp_path)
    y = np.full(3, np.nan)
    library.f(_array(np.array([5.0, 7.0])), _array(y))
    assert np.array_equal(y, [7, 5, 35])


def test_outputs_may_lie_where_inputs_were(c_compiler: Compiler, tmp_path: Path) -> None:
    function = ca.Function("f", [ca.vertcat(A, B)], [ca.vertcat(B, 0, A + B)], ["x"], ["y"])
    library = _library(plain_c(function, "f"), c_compiler, tmp_path)
    x = np.array([1.0, 2.0, 9.0])
    library.f(_array(x), _array(x))
    assert np.array_equal(x, [2, 0, 3])


def test_numbers_that_are_not_finite() -> None:
    function = ca.Function("f", [A], [ca.vertcat(A * math.inf, A * -math.inf, A * math.nan)], ["x"], ["y"])
    text = plain_c(function, "f")
    assert "x[0] * INFINITY" in text or "INFINITY * x[0]" in text
    assert "(-INFINITY)" in text
    assert "NAN" in text


def test_an_operation_that_c_lacks_is_reported() -> None:
    with pytest.raises(UndertowError, match="OP_ERF"):
        plain_c(ca.Function("f", [A], [ca.erf(A)], ["x"], ["y"]), "f")
