"""CasADi functions against the symbolic model: every bundled vehicle, every effect of the catalogue."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from tests.codegen.support import (
    BUNDLED,
    DIGITS,
    EFFECTS,
    SPREAD,
    Point,
    assert_close,
    derivative,
    doubles,
    exact,
    functions_of,
    random_point,
    reference_of,
)
from tests.quick import first_quick, quick_if

STATE, _, INPUT, PARAMETER = range(4)
VEHICLES = [*BUNDLED, *EFFECTS]


@pytest.fixture(autouse=True)
def _digits():
    with mpmath.workdps(DIGITS):
        yield


@pytest.fixture(params=VEHICLES)
def name(request: pytest.FixtureRequest) -> str:
    return request.param


DERIVED = quick_if([*BUNDLED, *SPREAD].__contains__, VEHICLES)


def _at(point: Point) -> tuple:
    return point.x, point.u, point.p, point.t


@pytest.mark.parametrize("seed", first_quick([1, 2, 3]))
def test_dynamics(name: str, seed: int) -> None:
    functions, point = functions_of(name), random_point(functions_of(name), seed)
    found = np.array(functions.dynamics(*_at(point))).ravel()
    assert_close(found, doubles(reference_of(name).x_dot(*exact(point))))


@pytest.mark.parametrize("seed", first_quick([1, 2, 3]))
def test_residual_and_outputs(name: str, seed: int) -> None:
    functions, point = functions_of(name), random_point(functions_of(name), seed)
    reference = reference_of(name)
    residual = functions.residual_function(point.x, point.nu_dot, point.u, point.p, point.t)
    assert_close(np.array(residual).ravel(), doubles(reference.residual(*exact(point))))
    outputs = functions.outputs(*_at(point))
    assert_close(np.array(outputs).ravel(), doubles(reference.outputs(*exact(point))))


def test_regressor(name: str) -> None:
    functions, point = functions_of(name), random_point(functions_of(name), 4)
    found = functions.regressor(point.x, point.nu_dot, point.u, point.p, point.t)
    expected = derivative(reference_of(name).residual, exact(point), PARAMETER)
    assert_close(np.array(found), expected)


@pytest.mark.parametrize("name", DERIVED)
def test_jacobians(name: str) -> None:
    functions, point = functions_of(name), random_point(functions_of(name), 5)
    x_dot, *found = functions.jacobians(*_at(point))
    assert_close(np.array(x_dot), np.array(functions.dynamics(*_at(point))))
    for group, matrix in zip((STATE, INPUT, PARAMETER), found, strict=True):
        assert_close(np.array(matrix), derivative(reference_of(name).x_dot, exact(point), group))


@pytest.mark.slow
def test_the_derivatives_of_the_full_vehicle_are_those_of_its_effects() -> None:
    """Every effect at once, so that states of actuators and of the fluid meet the flow and each other."""
    functions, reference = functions_of("full"), reference_of("full")
    point = random_point(functions, 6)
    x_dot, a, b, _ = functions.jacobians(*_at(point))
    assert_close(np.array(x_dot).ravel(), doubles(reference.x_dot(*exact(point))))
    assert_close(np.array(a), derivative(reference.x_dot, exact(point), STATE))
    assert_close(np.array(b), derivative(reference.x_dot, exact(point), INPUT))
