"""Instructions run over blocks of samples give what CasADi gives, digit for digit."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from undertow import UndertowError
from undertow.codegen import Functions
from undertow.codegen.compiler import Compiler

# Private: the size of a block and its code have edges that the result hides.
from undertow.codegen.engine import Blockwise, blockwise, carried, engine
from undertow.model.loading import bundled_vehicles, load_vehicle

from .test_plain import OPERATIONS, A, B

# Samples that the engine takes together.
BLOCK = 64


def _one_by_one(function: ca.Function, arguments: list[np.ndarray], count: int) -> list[np.ndarray]:
    """Nonzeros of the outputs, one call of CasADi for each sample."""
    rows = [function(*(a[i] if a.ndim > 1 else a for a in arguments)) for i in range(count)]
    rows = [r if isinstance(r, tuple) else (r,) for r in rows]
    return [np.array([r[k].nonzeros() for r in rows]) for k in range(function.n_out())]


@pytest.mark.parametrize("count", [1, BLOCK - 1, BLOCK, 2 * BLOCK + 3])
def test_every_operation_is_casadis(count: int, c_compiler: Compiler) -> None:
    function = ca.Function("f", [ca.vertcat(A, B)], [ca.vertcat(*OPERATIONS.values())])
    x = np.random.default_rng(3).uniform(-2.5, 2.5, (count, 2))
    x[0] = 0.4, 0.4
    (found,) = Blockwise(function, engine())([x], count)
    (wanted,) = _one_by_one(function, [x], count)
    np.testing.assert_array_equal(found, wanted)


def test_shared_arguments_sparse_and_empty_outputs(c_compiler: Compiler) -> None:
    p = ca.SX.sym("p", 2)
    sparse = ca.SX(3, 2)
    sparse[2, 0], sparse[0, 1] = A * p[0], B + p[1]
    function = ca.Function("f", [ca.vertcat(A, B), p], [sparse, ca.SX(0, 3), A])
    x = np.random.default_rng(4).normal(size=(70, 2))
    shared = np.array([3.0, -2.0])
    found = Blockwise(function, engine())([x, shared], 70)
    np.testing.assert_array_equal(found[0], np.column_stack([x[:, 0] * 3.0, x[:, 1] - 2.0]))
    assert found[1].shape == (70, 0)
    np.testing.assert_array_equal(found[2], x[:, :1])


def test_a_sample_without_a_value_spoils_no_other(c_compiler: Compiler) -> None:
    function = ca.Function("f", [A], [ca.sqrt(A) + ca.if_else(A > 2, 1, 0)])
    x = np.full((BLOCK + 2, 1), 4.0)
    x[5], x[BLOCK + 1] = -1.0, np.nan
    (found,) = Blockwise(function, engine())([x], len(x))
    assert np.flatnonzero(np.isnan(found[:, 0])).tolist() == [5, BLOCK + 1]
    assert set(found[np.isfinite(found)]) == {3.0}


@pytest.mark.parametrize("name", sorted(bundled_vehicles()))
def test_the_dynamics_of_every_bundled_vehicle(name: str, c_compiler: Compiler) -> None:
    functions = Functions(load_vehicle(name))
    function, count = functions.dynamics, 5
    random = np.random.default_rng(7)
    x, u = (random.uniform(-0.5, 0.5, (count, function.size1_in(i))) for i in range(2))
    arguments = [x, u, np.array(functions.values()), np.zeros((count, 1))]
    (found,) = Blockwise(function, engine())(arguments, count)
    (wanted,) = _one_by_one(function, arguments, count)
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("chains", [1, 2, 16, 19])
@pytest.mark.parametrize("compiler", [True, False])
def test_states_carried_on_side_by_side_are_those_of_one_step_after_the_other(
    chains: int, compiler: bool, c_compiler: Compiler, monkeypatch: pytest.MonkeyPatch
) -> None:
    z, u, dt, p = (ca.SX.sym(n, k) for n, k in (("z", 2), ("u", 3), ("dt", 1), ("p", 2)))
    rate = ca.vertcat(ca.sin(z[1]) - p[0] * z[0] + u[0], u[1] * u[2] - p[1] * z[1])
    step = ca.Function("step", [z, u, dt, p], [z + dt * rate])
    if not compiler:
        monkeypatch.setattr("undertow.codegen.engine.blockwise", lambda function: None)
    random = np.random.default_rng(5)
    start, commands, p_all = (random.normal(size=k) for k in ((chains, 2), (7, chains, 3), 2))
    length = random.uniform(0.0, 0.2, (7, chains, 1))
    # A view whose last axis is not whole in memory, and commands that all chains share.
    for columns in (commands[:, :, ::-1], commands[:, :1]):
        found = carried(step, start, [columns, length, p_all], 7)
        each = np.broadcast_to(columns, commands.shape)
        for i in range(chains):
            state = start[i]
            for k in range(7):
                np.testing.assert_array_equal(found[k, i], state)
                state = np.array(step(state, each[k, i], length[k, i], p_all)).ravel()
            np.testing.assert_array_equal(found[7, i], state)
    assert carried(step, start, [commands[:0], length[:0], p_all], 0).shape == (1, chains, 2)


def test_what_c_lacks_is_refused_and_matrices_are_left_alone(
    c_compiler: Compiler,
) -> None:
    with pytest.raises(UndertowError, match="has no counterpart in C"):
        Blockwise(ca.Function("f", [A], [ca.erf(A)]), engine())
    matrices = ca.MX.sym("m", 2)
    assert blockwise(ca.Function("f", [matrices], [ca.mtimes(matrices.T, matrices)])) is None
