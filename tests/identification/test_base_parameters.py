"""Combinations of parameters that data determine."""

from __future__ import annotations

import numpy as np
import pytest

from undertow.identification.estimation.fitted import base_parameters, undetermined


def test_groups_of_what_is_undetermined() -> None:
    gram = np.zeros((5, 5))
    gram[:2, :2] = [[4.0, 2.0], [2.0, 1.0]]
    gram[3:, 3:] = [[2.0, 1.0], [1.0, 3.0]]
    assert undetermined(gram, ["a", "b", "c", "d", "e"]) == [["a", "b"], ["c"]]
    # 2 a + b is seen; c is not; d and e are known by themselves.
    assert [str(c) for c in base_parameters(gram, ["a", "b", "c", "d", "e"])] == ["a + 0.5 b"]


def test_combinations_leave_out_what_the_data_cannot_see() -> None:
    """Changing the parameters along the null space changes no combination."""
    rng = np.random.default_rng(6)
    names = list("abcdefg")
    H = rng.standard_normal((200, 4)) @ rng.standard_normal((4, 7)) * np.logspace(-3, 3, 7)
    found = base_parameters(H.T @ H, names)
    assert len(found) == 4
    table = np.array([[c.coefficients.get(n, 0.0) for n in names] for c in found])
    size = np.linalg.norm(H, axis=0)
    null = (np.linalg.svd(H / size)[2][4:] / size).T
    assert np.all(np.abs(table @ null) < 1e-6 * (np.abs(table) @ np.abs(null)))
    # Each begins with a parameter that is in no other.
    for name in (next(iter(c.coefficients)) for c in found):
        assert sum(name in c.coefficients for c in found) == 1


def test_a_parameter_that_the_data_feel_but_little_is_still_in_its_combination() -> None:
    scale = np.diag([1e4, 1e-1, 1.0])
    gram = scale @ np.array([[1.0, -1.0, 0.0], [-1.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) @ scale
    (found,) = base_parameters(gram, ["m", "X_udot", "X_u"])
    assert found.coefficients == pytest.approx({"m": 1.0, "X_udot": -1e-5}, rel=1e-6)


def test_what_is_determined_is_no_combination() -> None:
    assert base_parameters(np.array([[2.0, 1.0], [1.0, 3.0]]), ["a", "b"]) == []
