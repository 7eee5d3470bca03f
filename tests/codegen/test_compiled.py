"""Compiled functions against CasADi's virtual machine."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from tests.codegen.support import BUNDLED, assert_close, functions_of, random_point
from tests.quick import quick_if
from undertow.codegen import Compiled
from undertow.codegen.compiler import Compiler, Evaluator

KINDS = ("dynamics", "jacobians", "regressor", "residual_function", "outputs")


@pytest.mark.parametrize("name", quick_if(("cybership2", "mini-auv").__contains__, [*BUNDLED, "full"]))
def test_compiled_functions_equal_the_virtual_machine(name: str, c_compiler: Compiler) -> None:
    functions = functions_of(name)
    compiled = Compiled(functions, compiled=True)
    for kind in KINDS:
        function = compiled.function(kind)
        assert function.is_a("External")
        for seed in range(3):
            point = random_point(functions, seed)
            values = {"x": point.x, "nu_dot": point.nu_dot, "u": point.u, "p": point.p, "t": point.t}
            arguments = [values[n] for n in function.name_in()]
            expected = getattr(functions, kind).call(arguments)
            for a, b in zip(function.call(arguments), expected, strict=True):
                assert_close(np.array(a), np.array(b))


def test_without_compiled_code_the_functions_are_the_models_own() -> None:
    functions = functions_of("box-hull")
    assert Compiled(functions, compiled=False).function("dynamics") is functions.dynamics


def test_the_evaluator_takes_many_points_in_one_call(c_compiler: Compiler) -> None:
    functions = functions_of("mini-auv")
    evaluate = Compiled(functions, compiled=True).evaluator("jacobians", batch=4)
    points = [random_point(functions, seed) for seed in range(4)]
    x, u = (np.array([getattr(point, n) for point in points]) for n in ("x", "u"))
    p = points[0].p
    a = evaluate(x, u, p, 0.0)[1]
    assert a.shape == (4, x.shape[1], x.shape[1])
    for k, point in enumerate(points):
        assert_close(a[k], np.array(functions.jacobians(point.x, point.u, p, 0.0)[1]))


def test_the_evaluator_gives_sparse_outputs_in_full() -> None:
    functions = functions_of("mini-auv")
    tangents = functions.tangents("x", "p")
    point = random_point(functions, 1)
    dense = Evaluator(tangents)(point.x, point.u, point.p, point.t)
    for found, expected in zip(dense, tangents(point.x, point.u, point.p, point.t), strict=True):
        assert np.array_equal(found[0], np.array(expected.full()))


def test_earlier_results_survive_the_next_call() -> None:
    functions = functions_of("box-hull")
    evaluate = Compiled(functions, compiled=False).evaluator("dynamics")
    point = random_point(functions, 1)
    first = evaluate(point.x, point.u, point.p, 0.0)[0]
    kept = first.copy()
    evaluate(2 * point.x, point.u, point.p, 0.0)
    assert np.array_equal(first, kept)


def test_a_model_without_inputs_has_an_evaluator() -> None:
    function = ca.Function("f", [ca.SX.sym("x", 2), ca.SX.sym("u", 0)], [ca.SX(0, 1)], ["x", "u"], ["y"])
    assert Evaluator(function, 3)(np.zeros((3, 2)), np.zeros((3, 0)))[0].shape == (3, 0, 1)
