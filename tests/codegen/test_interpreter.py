"""The interpreter that numba compiles: every operation, every bundled vehicle, and who says that it runs."""

from __future__ import annotations

import logging
import re
import sys
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

from tests.codegen.support import BUNDLED, assert_close, functions_of, random_parameters
from tests.codegen.test_plain import OPERATIONS as EXPRESSIONS
from tests.codegen.test_plain import A, B
from tests.quick import first_quick
from undertow import UndertowError
from undertow.codegen import Simulator
from undertow.codegen.compiler import Compiler, compiled_or_virtual
from undertow.codegen.instructions import OPERATIONS, Tape, ready, tape_of

AWKWARD = [-2.5, -1.0, -0.3, -0.0, 0.0, 0.4, 1.0, 1.7, np.inf, -np.inf, np.nan]
MORE = [ca.floor(A), ca.sign(A * B), ca.sqrt(A), ca.log(A), ca.logic_not(A), A**B, A != B, A**4.5, 1 / B]


@pytest.fixture
def numba(monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba instead of a C compiler; without numba the test is skipped."""
    pytest.importorskip("numba", reason="numba is not installed")
    monkeypatch.setenv("UNDERTOW_NO_COMPILER", "1")


def _evaluated(tape: Tape, *inputs: np.ndarray) -> np.ndarray:
    from undertow.codegen.interpreter import call, put

    own, found = ready(tape), np.full(len(tape.results), np.nan)
    for which, values in enumerate(inputs):
        put(own, which, values)
    call(own, found)
    return found


def test_the_expressions_have_every_operation_that_the_interpreter_knows() -> None:
    tape = tape_of(ca.Function("f", [A, B], [ca.vertcat(*EXPRESSIONS.values(), *MORE)]))
    assert {OPERATIONS[k] for k in tape.code[:, 0]} == set(OPERATIONS)


def test_every_operation_is_casadis(numba: None) -> None:
    outputs = {**EXPRESSIONS, **{str(e): e for e in MORE}}
    function = ca.Function("f", [A, B], [ca.vertcat(*outputs.values())])
    tape = tape_of(function)
    for x in (np.array([a, b]) for a in AWKWARD for b in AWKWARD):
        found = _evaluated(tape, x[:1], x[1:])
        for name, value, wanted in zip(outputs, found, np.array(function(*x)).ravel(), strict=True):
            assert value == pytest.approx(wanted, rel=1e-14, abs=0, nan_ok=True), (name, x)


def test_sparse_outputs_inputs_handed_on_and_constants(numba: None) -> None:
    matrix = ca.SX(2, 2)
    matrix[1, 0], matrix[0, 1] = B, 7
    function = ca.Function("f", [ca.vertcat(A, B), ca.SX.sym("c", 2)], [A, ca.SX(2, 1), matrix, A + B])
    tape = tape_of(function)
    assert tape.inputs == (0, 2, 4)
    assert tape.outputs == (0, 1, 1, 3, 4)
    assert np.array_equal(_evaluated(tape, np.array([2.0, 3.0])), [2, 3, 7, 5])


def test_an_operation_that_is_not_known_is_named() -> None:
    with pytest.raises(UndertowError, match="OP_ERF"):
        tape_of(ca.Function("f", [A], [ca.erf(A)]))


@pytest.mark.parametrize("name", first_quick([*BUNDLED, "full"], 2))
def test_numba_compiled_code_and_the_virtual_machine_agree(
    name: str, c_compiler: Compiler, numba: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    from undertow.codegen.interpreted import InterpretedStepper

    functions, rng = functions_of(name), np.random.default_rng(3)
    p = random_parameters(functions, 1)
    x0 = 0.2 * rng.normal(size=(3, len(functions.state_names)))
    t, u = np.cumsum(rng.uniform(0, 0.2, 12)), rng.normal(size=(12, functions.u.numel()))
    differentiated = {"wrt": range(0, p.size, 3), "initial": [0, x0.shape[1] - 1]}
    simulator = Simulator(functions)
    assert isinstance(simulator._steppers[False], InterpretedStepper)  # private: the numbers are the same
    found = [simulator.run(x0, t, u, p), *simulator.run_with_sensitivities(x0, t, u, p, **differentiated)]
    monkeypatch.delenv("UNDERTOW_NO_COMPILER")
    for other in (Simulator(functions, compiled=c) for c in (True, False)):
        x, s = other.run_with_sensitivities(x0, t, u, p, **differentiated)
        assert np.isfinite(s).all()
        for one, expected in zip(found, (x, x, s), strict=True):
            assert_close(one.reshape(3, -1), expected.reshape(3, -1))


def test_arrays_that_may_not_be_written_are_no_other_problem(numba: None) -> None:
    functions = functions_of("box-hull")
    given = [np.zeros(2), np.arange(3.0), np.ones((3, 1)), np.array(functions.values())]
    expected = Simulator(functions).run(*given)
    for array in given:
        array.flags.writeable = False
    assert np.array_equal(Simulator(functions).run(*given), expected)
    assert expected[2, 1] > 0


# --- who runs -----------------------------------------------------------------------------------


def test_one_line_says_that_numba_runs(
    numba: None, own_cache: Path, caplog: pytest.LogCaptureFixture
) -> None:
    functions = functions_of("box-hull")
    for _ in range(2):
        simulator = Simulator(functions)
    simulator.run_with_sensitivities(
        np.zeros(2), np.arange(3.0), np.ones((3, 1)), np.array(functions.values()), [0]
    )
    (line,) = [r.getMessage() for r in caplog.records if r.levelno == logging.WARNING]
    assert line.startswith("no C compiler found: install one, or name one in UNDERTOW_CC. numba runs")


@pytest.mark.parametrize("error", [UndertowError("no room"), ImportError("numba wants another NumPy")])
def test_where_numba_fails_the_virtual_machine_runs_and_says_why(
    error: Exception,
    own_cache: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    def fails() -> str:
        raise error

    monkeypatch.setenv("UNDERTOW_NO_COMPILER", "1")
    monkeypatch.setitem(sys.modules, "numba", SimpleNamespace(__spec__=SimpleNamespace()))  # as if installed
    assert compiled_or_virtual(None, lambda _: "C", lambda: "virtual machine", fails) == "virtual machine"
    assert str(error) in caplog.text
    assert "The CasADi virtual machine runs" in caplog.text


def _twice(value: float) -> float:
    return value + value


def test_what_numba_compiled_is_kept_in_the_users_own_folder(numba: None, own_cache: Path) -> None:
    from numba import config

    from undertow.codegen.numba_code import by_numba

    before = config.CACHE_DIR
    assert by_numba(_twice)(1.5) == 3.0
    assert before == config.CACHE_DIR
    (kept,) = own_cache.rglob("*.nbi")
    assert re.fullmatch(r"numba-[0-9a-f]{16}", kept.relative_to(own_cache).parts[0])
