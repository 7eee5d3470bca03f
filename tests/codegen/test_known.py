"""Models that were simulated before are simulated again without being derived."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
import sympy as sm

from tests.codegen.support import (
    BASE,
    assert_close,
    functions_of,
    named_vehicle,
    random_parameters,
    random_point,
    vehicle_with,
)
from undertow import UndertowError
from undertow.codegen import Functions, Simulator, cache, compiler, known
from undertow.codegen.compiler import Compiler
from undertow.codegen.known import KnownFunctions
from undertow.model.effect import Wrench
from undertow.model.parameter import Parameter
from undertow.model.symbols import Signals
from undertow.model.vehicle import Value, Vehicle

VEHICLES = ["mini-auv", "cybership2", "thruster_lag", "radiation_memory"]


def _is_derived(functions: Functions) -> bool:
    return "convert" in vars(functions)


def _twice(name: str) -> KnownFunctions:
    """The functions as another process would find them."""
    assert _is_derived(KnownFunctions(named_vehicle(name)))
    return KnownFunctions(dataclasses.replace(named_vehicle(name)))


def _run(functions: Functions, p: np.ndarray) -> np.ndarray:
    t, u = np.array([0.0, 0.1, 0.2]), np.full((3, functions.u.numel()), 0.3)
    x0 = np.full(len(functions.state_names), 0.1)
    return Simulator(functions, compiled=True).run(x0, t, u, p)


@pytest.mark.parametrize("name", VEHICLES)
def test_a_known_model_is_simulated_without_being_derived(
    name: str, c_compiler: Compiler, own_cache: Path
) -> None:
    plain, again = functions_of(name), _twice(name)
    p = random_parameters(plain, 1)
    found = _run(again, p)
    assert not _is_derived(again)
    assert again.state_names == plain.state_names
    assert again.parameter_names == plain.parameter_names
    assert np.isfinite(found).all()
    assert np.array_equal(found, _run(plain, p))
    u = np.ones(plain.u.numel())
    assert np.array_equal(np.array(again.rest(u, p, 0.0)), np.array(plain.rest(u, p, 0.0)))
    assert not _is_derived(again)


def test_who_asks_for_more_has_the_model_derived(own_cache: Path) -> None:
    plain, again = functions_of("thruster_lag"), _twice("thruster_lag")
    x, quickest = again.x, again.quickest
    point = random_point(plain, 1)
    at = point.x, point.u, point.p, point.t
    assert_close(np.array(again.dynamics(*at)), np.array(plain.dynamics(*at)))
    assert _is_derived(again)
    assert ca.is_equal(again.x, x, 2)
    assert_close(np.array(quickest(*at)), np.array(plain.quickest(*at)))
    for found, expected in zip(again.jacobians(*at), plain.jacobians(*at), strict=True):
        assert_close(np.array(found), np.array(expected))
    assert_close(np.array(again.prepared.prepare(point.p)), np.array(plain.prepared.prepare(point.p)))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        again.nonsense  # noqa: B018


def test_values_of_a_known_model(own_cache: Path) -> None:
    again = _twice("mini-auv")
    assert again.values() == functions_of("mini-auv").values()
    assert not _is_derived(again)


def test_sensitivities_of_a_known_model(c_compiler: Compiler, own_cache: Path) -> None:
    plain, again = functions_of("mini-auv"), _twice("mini-auv")
    arguments = (
        np.zeros(8),
        np.array([0.0, 0.1]),
        np.ones((2, plain.u.numel())),
        np.array(plain.values()),
        [0, 1],
    )
    expected = Simulator(plain, compiled=True).run_with_sensitivities(*arguments)
    for a, b in zip(
        Simulator(again, compiled=True).run_with_sensitivities(*arguments), expected, strict=True
    ):
        assert np.array_equal(a, b)


def test_every_part_of_the_model_is_in_the_question() -> None:
    base = vehicle_with("quadratic_damping")
    first, *others = base.thrusters
    moved = dataclasses.replace(first, wrench=(np.nextafter(first.wrench[0], 2), *first.wrench[1:]))
    forward = {"X_u_forward": Value(-1.0), "X_u_backward": Value(-2.0)}
    different = [
        base,
        dataclasses.replace(base, degrees_of_freedom=base.degrees_of_freedom[:5]),
        dataclasses.replace(base, effects=base.effects[:-1]),
        dataclasses.replace(base, effects=base.effects[::-1]),
        dataclasses.replace(base, thrusters=(moved, *others)),
        dataclasses.replace(base, force_channels=("tau_X",)),
        dataclasses.replace(base, values=forward),
    ]
    questions = {known._question(v, {}) for v in different}
    questions.add(known._question(base, {"Y_v": ("X_u", 2.0)}))
    questions.add(known._question(base, {"Y_v": ("X_u", 3.0)}))
    assert None not in questions
    assert len(questions) == len(different) + 2


def test_values_and_names_are_not_in_the_question() -> None:
    base = vehicle_with("quadratic_damping")
    other = dataclasses.replace(base, name="other", values={"m": Value(3.0)})
    assert known._question(base, {}) == known._question(other, {})


class _Own(Wrench):
    """A user's effect, which may depend on anything."""

    id = "own"
    family = "statics"
    reference = "none"
    push = Parameter("N", "its size")

    def wrench(self, s: Signals) -> sm.Matrix:
        return sm.Matrix([self.push, 0, 0, 0, 0, 0])


def test_models_with_effects_of_users_are_not_kept(own_cache: Path) -> None:
    base = vehicle_with(*BASE)
    names = tuple(t.name for t in base.thrusters)
    model = Vehicle("own", base.degrees_of_freedom, (*base.effects, _Own(names)), {}, base.thrusters)
    for _ in range(2):
        functions = KnownFunctions(model)
        assert "push" in functions.parameter_names
        Simulator(functions, compiled=False)
        assert _is_derived(functions)


# --- notes --------------------------------------------------------------------------------------


def test_a_note_is_found_again(own_cache: Path) -> None:
    asked: list[int] = []

    def answer() -> str:
        asked.append(1)
        return "yes\n"

    assert [cache.noted("is it?", answer) for _ in range(3)] == ["yes\n"] * 3
    assert len(asked) == 1
    assert cache.noted("is it not?", lambda: "no") == "no"


@pytest.mark.parametrize("spoiled", ["", "yes", "0" * 64 + "\nyes", "\xff"])
def test_a_spoiled_note_is_not_believed(spoiled: str, own_cache: Path) -> None:
    cache.noted("is it?", lambda: "yes")
    (note,) = own_cache.glob("*.note")
    note.write_text(spoiled, encoding="latin-1")
    assert cache.noted("is it?", lambda: "after all") == "after all"
    assert cache.noted("is it?", lambda: "no") == "after all"


def test_without_room_there_is_an_answer_all_the_same(
    own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise UndertowError("no space left")

    monkeypatch.setattr(cache, "write_whole", full)
    assert [cache.noted("is it?", lambda: "yes") for _ in range(2)] == ["yes", "yes"]
    assert not list(own_cache.glob("*.note"))


def test_an_empty_answer_is_not_kept(own_cache: Path) -> None:
    assert cache.noted("is it?", lambda: "") == ""
    assert cache.noted("is it?", lambda: "yes") == "yes"


# --- the processor ------------------------------------------------------------------------------


def test_a_library_for_this_processor_has_a_key_of_its_own(
    c_compiler: Compiler, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here = c_compiler.for_this_machine()
    if here == c_compiler:
        pytest.skip("this compiler does not tell what the processor can do")
    compiler._processor.cache_clear()
    monkeypatch.setattr(compiler, "_processor", lambda command: "#define __ANOTHER__ 1")
    there = c_compiler.for_this_machine()
    assert len({c.identity for c in (c_compiler, here, there)}) == 3
    assert "-march=native" in here.identity
    assert "-march=native" not in c_compiler.identity


def test_what_the_compiler_says_of_the_processor_is_asked_once(
    c_compiler: Compiler, own_cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compiler._processor.cache_clear()
    first = compiler._processor(c_compiler.command)
    if not first:
        pytest.skip("this compiler does not tell what the processor can do")
    compiler._processor.cache_clear()
    monkeypatch.setattr(compiler, "_run", lambda *_: pytest.fail("asked again"))
    assert compiler._processor(c_compiler.command) == first
    compiler._processor.cache_clear()
