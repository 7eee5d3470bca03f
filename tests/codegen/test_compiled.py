"""Compiled functions against CasADi's virtual machine."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.codegen.support import BUNDLED, assert_close, functions_of, random_point
from tests.quick import quick_if
from undertow.codegen.compiler import Compiler, Evaluator, load

KINDS = ("dynamics", "jacobians", "regressor", "residual_function", "outputs")


@pytest.mark.parametrize("name", quick_if(("cybership2", "mini-auv").__contains__, [*BUNDLED, "full"]))
def test_compiled_functions_equal_the_virtual_machine(name: str, c_compiler: Compiler) -> None:
    functions = functions_of(name)
    for kind in KINDS:
        function = load(getattr(functions, kind), c_compiler)
        assert function.is_a("External")
        for seed in range(3):
            point = random_point(functions, seed)
            values = {"x": point.x, "nu_dot": point.nu_dot, "u": point.u, "p": point.p, "t": point.t}
            arguments = [values[n] for n in function.name_in()]
            expected = getattr(functions, kind).call(arguments)
            for a, b in zip(function.call(arguments), expected, strict=True):
                assert_close(np.array(a), np.array(b))


def test_the_evaluator_gives_matrices() -> None:
    functions = functions_of("mini-auv")
    point = random_point(functions, 1)
    given = point.x, point.u, point.p, point.t
    for found, expected in zip(
        Evaluator(functions.jacobians)(*given), functions.jacobians(*given), strict=True
    ):
        assert np.array_equal(found, np.array(expected))


def test_earlier_results_survive_the_next_call() -> None:
    functions = functions_of("box-hull")
    evaluate = Evaluator(functions.dynamics)
    point = random_point(functions, 1)
    first = evaluate(point.x, point.u, point.p, 0.0)[0]
    kept = first.copy()
    evaluate(2 * point.x, point.u, point.p, 0.0)
    assert np.array_equal(first, kept)


def test_a_model_without_inputs_has_an_evaluator() -> None:
    function = ca.Function("f", [ca.SX.sym("x", 2), ca.SX.sym("u", 0)], [ca.SX(0, 1)], ["x", "u"], ["y"])
    assert Evaluator(function)(np.zeros(2), np.zeros(0))[0].shape == (0, 1)
